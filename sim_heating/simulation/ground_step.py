"""A ground step test: a lamp's step of known flux on an installed thermocouple, as a flight record.

There is no flow: `heating.reference = "none"`, h_ref is 0, and the known absorbed flux is the column `q_add_W_m2`.
Stack and clock are estimated before a manoeuvre is flown, as the founding paper suggests. A test is planned with the
records that this module makes; measured records have the same form.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from sim_heating.base.conditions import STATE, Conditions
from sim_heating.base.errors import InputError
from sim_heating.base.files import check
from sim_heating.inputs.points import point_of_record
from sim_heating.inputs.record import Record, RecordFile, make_record
from sim_heating.inputs.sensor_model import SensorErrors, measure, sample_times
from sim_heating.inputs.vehicle import ControlPoint, Vehicle
from sim_heating.simulation.predict import predict
from sim_heating.simulation.synthesize import point_declaration

AT_REST = {"rho_kg_m3": 1.225, "T_inf_K": 288.15, "p_inf_Pa": 101325.0, "p_surface_Pa": 101325.0}
"""Air around a vehicle on the ground, U.S. Standard Atmosphere at sea level."""
BEFORE_S = 10.0
"""Time of the record before the lamp is lit [s]; longer than any clock skew."""
RISE_S = 0.1
"""Time in which the lamp's shutter opens or closes [s]."""
TRUE_NODES, TRUE_STEP_S = 160, 0.1
"""Nodes of the mesh and spacing of conditions [s] for synthetic readings, finer than those of a fit."""


def step_record(
    vehicle: Vehicle,
    point: ControlPoint,
    flux_W_m2: float,
    *,
    lit_s: float = 60.0,
    after_s: float = 240.0,
    parameters: Mapping[str, float] | None = None,
    skew_s: float = 0.0,
    errors: Mapping[str, SensorErrors] | None = None,
    seed: int = 1,
) -> Record:
    """Synthetic record of a step of absorbed flux on a control point, with its declared stack.

    flux_W_m2      : flux that the surface absorbs [W/m2]
    lit_s, after_s : time that the lamp is on, and that is recorded after it [s]
    parameters     : dotted model parameters in which the truth differs from the declaration
    skew_s         : lag of the thermocouples' clock [s]
    errors         : gain and bias errors of sensors, by name
    seed           : of the noise
    raises         : InputError where the point has no sensor
    """
    if not point.sensors:
        raise InputError(f"control point {point.name}: has no sensor to test; choose one that has")
    end_s = BEFORE_S + lit_s + after_s
    clock = sample_times(point.sensors, 0.0, end_s)
    declared = check(_declaration(vehicle, point, flux_W_m2), RecordFile, f"ground step test of {point.name}")
    empty = {"time_s": clock} | {s.column: np.full(len(clock), 300.0) for s in point.sensors}
    # The readings come from a finer mesh and step than any fit uses: with the same ones the errors of both would
    # cancel, and the test would be of noise alone.
    fine = make_record(declared, _conditions(flux_W_m2, lit_s, end_s, TRUE_STEP_S), empty, None, point.name)
    model = replace(point_of_record(fine, parameters), nodes=TRUE_NODES)
    faults, rng = errors or {}, np.random.default_rng([seed, *point.name.encode()])
    true = predict(fine, model, skew_s=skew_s).history.sensors_K
    columns = {"time_s": clock}
    for sensor, T in zip(point.sensors, true, strict=True):
        columns[sensor.column] = measure(sensor, np.nan_to_num(T, nan=300.0), rng, faults.get(sensor.name), np.isnan(T))
    return make_record(declared, _conditions(flux_W_m2, lit_s, end_s, 1.0), columns, None, point.name)


def _conditions(flux_W_m2: float, lit_s: float, end_s: float, spacing_s: float) -> Conditions:
    on, off = BEFORE_S, BEFORE_S + lit_s
    edges = [on, on + RISE_S, off, off + RISE_S]
    # Rounded, so that an edge of the lamp that falls on a sample is one time and not two.
    time = np.union1d(np.round(np.arange(0.0, end_s + 0.5 * spacing_s, spacing_s), 6), np.round(edges, 6))
    constant = {name: np.zeros(len(time)) for name in STATE} | {n: np.full(len(time), v) for n, v in AT_REST.items()}
    flux = np.interp(time, edges, [0.0, flux_W_m2, flux_W_m2, 0.0])
    return Conditions(constant | {"time_s": time, "q_add_W_m2": flux})


def _declaration(vehicle: Vehicle, point: ControlPoint, flux_W_m2: float) -> dict[str, Any]:
    initial_K = AT_REST["T_inf_K"]
    title = f"Ground step test, {flux_W_m2 / 1e3:g} kW/m2: {point.title}"
    data = point_declaration(vehicle, point, title, point.sensors)
    return data | {
        "stack": data["stack"] | {"surroundings_K": initial_K, "initial": "uniform", "initial_K": initial_K},
        "heating": {"reference": "none", "wall_enthalpy": vehicle.heating.model_dump()["wall_enthalpy"]},
    }
