"""Synthetic flight records of a scenario: its truth marched, the sensor model applied, the declared tables written."""

from __future__ import annotations

import os
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import DERIVED, RATIO_VARIABLES, Conditions
from sim_heating.base.errors import InputError, failure_context
from sim_heating.base.files import check, display_path, output_directory, toml_text, write_text_atomic
from sim_heating.base.progress import Progress, no_progress
from sim_heating.credibility.facts.sources import conditions_of_scenario
from sim_heating.heating.atmosphere import G0_M_S2
from sim_heating.heating.effects.recombination import RECOMBINATION
from sim_heating.heating.effects.transition import TRANSITION
from sim_heating.heating.ratio.table import RatioTable
from sim_heating.heating.reference.flat_plate import friction_rise
from sim_heating.inputs.declared_effects import catalysis_keys, transition_keys, turbulent_recovery
from sim_heating.inputs.points import conditions_at_point, intermittency_along, mean_condition
from sim_heating.inputs.pressure_transducer import PressureTransducer, measure_pressure
from sim_heating.inputs.record import DECLARATION, Record, RecordFile, make_record, record_directory, record_texts
from sim_heating.inputs.scenario import Scenario, load_scenario
from sim_heating.inputs.sensor_model import SensorErrors, lags_s, lost_samples, measure, sample_times
from sim_heating.inputs.vehicle import ControlPoint, Vehicle
from sim_heating.march.history import PointHistory, march_points, values_at
from sim_heating.simulation.run import FLIGHT_FRACTION, fly_scenario, flying, models_of
from sim_heating.thermal.frame import STEP_TOLERANCE_K
from sim_heating.thermal.stack import Sensor
from sim_heating.trajectory.aero import flown_aero
from sim_heating.trajectory.flight import Flight, Window

TRUTH, PAGE = "truth.toml", "report.html"
AXIAL = "axial_accel_g"
SYNTHESIS_TOLERANCE_K = 0.1 * STEP_TOLERANCE_K
"""Largest error of a time step of the truth [K]: a tenth of that of the march that will fit the record."""
CONDITIONS, THERMOCOUPLES, TABLE = "conditions.csv", "thermocouples.csv", "ratio_table.csv"
TURBULENT = "ratio_table_turbulent.csv"


def synthesize(
    scenario: Scenario | str | os.PathLike[str],
    *,
    flight: Flight | None = None,
    halvings: int = 0,
    progress: Progress = no_progress,
) -> dict[str, Record]:
    """Fly a scenario with its truth and measure it: one record a control point that has sensors.

    The records hold what a flight crew would have, declared tables and stacks, and nothing of the truth.
    scenario : a scenario, or the path of its file
    flight   : the scenario's flight where it has been flown already
    halvings : number of times that the elements of the meshes are halved; the mesh error of the data remains in a fit,
               which corrects for its own only

    >>> import sim_heating as sh
    >>> records = sh.synthesize("scenarios/recorded_sts107.toml")
    >>> list(records)[:2]
    ['V09T9527', 'LOWER_FWD']
    """
    scenario = load_scenario(scenario)
    if flight is None:
        flight = fly_scenario(scenario, progress=partial(flying, progress))
    progress(FLIGHT_FRACTION, "marching the truth")
    flown = flight.conditions
    models, flights = models_of(scenario, flown, truth=True)
    flights = _with_axial_force(scenario, flights)
    measurements = scenario.declared.measurements
    points = [scenario.vehicle.control_point(name) for name in scenario.names]
    measurable = [(p, m, c) for p, m, c in zip(points, models, flights, strict=True) if p.sensors]
    clocks = [_clock(scenario, p, flight) for p, _, _ in measurable]
    # A clock skew moves the instants that are measured, not the times that are recorded.
    true_times = [_within(clock - measurements.clock_skew_s, flown) for clock in clocks]
    with failure_context(display_path(scenario.path)):
        histories = march_points(
            [m.with_lags(lags_s(p.sensors, _faults(scenario))) for p, m, _ in measurable],
            [_at_true_pressure(scenario, c) for _, _, c in measurable],
            extra_times_s=np.unique(np.concatenate(true_times)),
            longest_step_s=scenario.declared.heating.longest_step_s,
            tolerance_K=SYNTHESIS_TOLERANCE_K,
            halvings=halvings,
        )
    progress(0.9, "measuring")
    return {
        p.name: _record(scenario, p, c, h, clock, flight.windows)
        for (p, _, c), h, clock in zip(measurable, histories, clocks, strict=True)
    }


def _at_true_pressure(scenario: Scenario, conditions: Conditions) -> Conditions:
    """Conditions of a point with the surface pressure of the truth."""
    factor = scenario.declared.truth.p_surface_factor
    return conditions if factor == 1.0 else conditions.with_columns(p_surface_Pa=factor * conditions["p_surface_Pa"])


def _clock(scenario: Scenario, point: ControlPoint, flight: Flight) -> FloatArray:
    measurements, time_s = scenario.declared.measurements, flight.conditions.time_s
    return sample_times(
        point.sensors,
        time_s[0],
        time_s[-1],
        rate_hz=measurements.rate_hz,
        offset_s=measurements.sample_offset_s,
        manoeuvres_s=flight.manoeuvres_s,
    )


def _with_axial_force(scenario: Scenario, flights: Sequence[Conditions]) -> list[Conditions]:
    """Conditions whose axial acceleration has the friction of the transition in the truth.

        da = Gamma d tau S / (m g0)

    Gamma is the mean intermittency of the points that have a transition in [truth], d tau the rise of the friction of a
    plate of the reference length [Pa], S the reference area. The trajectory itself is not changed. A point on a control
    surface does not count: its flow turns by the deflection, and its area is small.
    Source: docs/reference/scenario_format.md, `[truth]`; docs/theory/equations_reference_heating.md, equation 17a.
    """
    vehicle, truth = scenario.vehicle, scenario.declared.truth.effect
    intermittencies = [
        intermittency_along(e.use(), conditions)
        for name, conditions in zip(scenario.names, flights, strict=True)
        for e in truth
        if e.name == TRANSITION and (e.control_points is None or name in e.control_points)
        if not _on_control_surface(vehicle.control_point(name))
    ]
    spec = scenario.declared.trajectory
    # Only of a flight with the vehicle's own aerodynamics is the mass known.
    if not intermittencies or AXIAL not in flights[0] or spec.source not in ("jsbsim", "entry-3dof"):
        return list(flights)
    rise, mass = friction_rise(flights[0], vehicle.reference_length_m), flown_aero(spec, vehicle.directory).mass_kg
    added = np.mean(intermittencies, axis=0) * rise * vehicle.reference_area_m2 / (mass * G0_M_S2)
    return [conditions.with_columns(**{AXIAL: conditions[AXIAL] + added}) for conditions in flights]


def _on_control_surface(point: ControlPoint) -> bool:
    """Whether elevon or body flap turn the surface of a control point."""
    return point.recovery.elevon_factor != 0.0 or point.recovery.bodyflap_factor != 0.0


def _as_measured(scenario: Scenario, point: ControlPoint, conditions: Conditions) -> Conditions:
    """Conditions as a flight crew has them: the density of a dynamic pressure that the jets disturb.

        q = (1 + f jets) rho V^2 / 2,    rho = 2 q / V^2

    The reference heating, the surface pressure and the Reynolds number follow from that density.
    Source: the pitch-jet spikes of STS-2 in the founding paper; docs/reference/effects.md, jet-interaction.
    """
    fraction = scenario.declared.measurements.jet_q_fraction
    if fraction == 0.0 or "jets" not in conditions:
        return conditions
    factor = 1.0 + fraction * conditions["jets"]
    rho = conditions["rho_kg_m3"] * factor
    disturbed = conditions.with_columns(
        rho_kg_m3=rho,
        q_Pa=0.5 * rho * conditions["velocity_m_s"] ** 2,
        log10_re=conditions["log10_re"] + np.log10(factor),
    )
    return conditions_at_point(scenario.vehicle, point, disturbed)


def _faults(scenario: Scenario) -> dict[str, SensorErrors]:
    return {
        f.sensor: SensorErrors(f.bias_K, f.gain, f.tau_s, f.drift_K_s) for f in scenario.declared.measurements.fault
    }


def _within(time_s: FloatArray, flown: Conditions) -> FloatArray:
    return time_s[(time_s >= flown.time_s[0]) & (time_s <= flown.time_s[-1])]


def _record(
    scenario: Scenario,
    point: ControlPoint,
    conditions: Conditions,
    history: PointHistory,
    clock: FloatArray,
    windows: Sequence[Window],
) -> Record:
    measurements = scenario.declared.measurements
    # Seeded by the name of the point: its record stays the same when others are added to the scenario.
    rng = np.random.default_rng([measurements.seed, *point.name.encode()])
    faults = _faults(scenario)
    true = values_at(history.time_s, history.sensors_K, clock - measurements.clock_skew_s)
    columns: dict[str, FloatArray] = {"time_s": clock}
    for sensor, temperature in zip(point.sensors, true, strict=True):
        lost = lost_samples(clock, rng, measurements.lost_fraction, measurements.gaps_s) | np.isnan(temperature)
        # Placeholders where nothing was marched: quantising NaN has no meaning, and the samples are lost anyway.
        finite = np.where(np.isnan(temperature), 0.0, temperature)
        columns[sensor.column] = measure(sensor, finite, rng, faults.get(sensor.name), lost, clock - clock[:1])
        if np.all(np.isnan(columns[sensor.column])):
            span = f"{conditions.time_s[0]:g} to {conditions.time_s[-1]:g} s"
            raise InputError(
                f"{scenario.path}, [measurements]: skew, offset, gaps and losses leave no sample of {sensor.name} "
                f"within the flight ({span}); change them"
            )
    pressure = _at_true_pressure(scenario, conditions)["p_surface_Pa"]
    at_surface = np.interp(clock - measurements.clock_skew_s, conditions.time_s, pressure)
    for transducer in point.declared.transducer:
        lost = lost_samples(clock, rng, measurements.lost_fraction, measurements.gaps_s)
        columns[transducer.column] = np.where(lost, np.nan, measure_pressure(transducer, at_surface, rng))
    declared = declaration(scenario, point, point.sensors, windows)
    table, turbulent = ratio_table_of(point), turbulent_table_of(point)
    measured = flown_columns(_as_measured(scenario, point, conditions))
    return make_record(declared, measured, columns, table, point.name, turbulent)


def flown_columns(conditions: Conditions) -> Conditions:
    """Conditions of a point without the columns that follow from what its record declares."""
    return Conditions({name: values for name, values in conditions.columns.items() if name not in DERIVED})


def ratio_table_of(point: ControlPoint) -> RatioTable:
    """Ratio table of a control point as its record holds it: it states the recovery enthalpy, which in a vehicle may
    follow from the reference heating alone."""
    if point.recovery.kind == "total":
        return point.ratio
    return replace(point.ratio, header={**point.ratio.header, "recovery": point.recovery.kind})


def point_declaration(vehicle: Vehicle, point: ControlPoint, title: str, sensors: Sequence[Sensor]) -> dict[str, Any]:
    """Entries of record.toml for synthetic data of a control point: its sensors, stack and materials."""
    return {
        "format": "flight-record/1",
        "title": title,
        "vehicle": vehicle.name,
        "control_point": point.name,
        "measured": False,
        **_pedigree(vehicle, point),
        "thermocouples": {
            "sensor": [s.model_dump(exclude_unset=True, exclude={"rate_hz", "sample_offset_s"}) for s in sensors],
        },
        "stack": point.construction.stack.model_dump(exclude_unset=True),
        "materials": {n: m.model_dump(exclude_unset=True) for n, m in point.construction.materials.items()},
    }


def _pedigree(vehicle: Vehicle, point: ControlPoint) -> dict[str, str]:
    """Source and confidence of the construction of a control point, those that its file states."""
    stated = {"source": point.declared.source, "confidence": point.declared.confidence}
    stated["source"] = stated["source"] and f"construction: {vehicle.name}, {point.name}: {stated['source']}"
    return {key: text for key, text in stated.items() if text}


def _recovery_keys(point: ControlPoint) -> dict[str, Any]:
    """Keys of [heating] that state the recovery enthalpy of a control point; none for the total enthalpy."""
    recovery = point.recovery
    if recovery.kind == "total":
        return {}
    if recovery.kind == "attachment-line":
        return {"recovery": recovery.kind, "sweep_deg": recovery.sweep_deg}
    turns = {"elevon_factor": recovery.elevon_factor, "bodyflap_factor": recovery.bodyflap_factor}
    turned = {key: factor for key, factor in turns.items() if factor != 0.0}
    return {"recovery": recovery.kind, "local_angle_deg": recovery.local_angle_deg, **turned}


def _declared_effects(point: ControlPoint) -> dict[str, Any]:
    """Keys of [heating] that state declared transition and recombination of a control point."""
    keys: dict[str, Any] = {}
    for used in point.effects:
        if used.effect.name == TRANSITION:
            keys["transition"] = transition_keys(used, TURBULENT, point.transition)
        elif used.effect.name == RECOMBINATION:
            keys["catalysis"] = catalysis_keys(used, point.flow.atoms, point.catalysis)
    if point.flow.re_theta:
        keys["running_length_m"] = point.running_length_m
    return keys


def turbulent_table_of(point: ControlPoint) -> RatioTable | None:
    """Turbulent ratio table of a control point as its record holds it; None where it has no transition, or by no
    table."""
    table = point.flow.turbulent if any(used.effect.name == TRANSITION for used in point.effects) else None
    kind = turbulent_recovery(point.recovery.kind)
    if table is None or kind == "total":
        return table
    return replace(table, header={**table.header, "recovery": kind})


def declaration(
    scenario: Scenario, point: ControlPoint, sensors: Sequence[Sensor], windows: Sequence[Window] = ()
) -> RecordFile:
    """Content of record.toml for a control point with these sensors, and the manoeuvres flown in these windows."""
    declared = record_declaration(
        scenario.vehicle, point, sensors, scenario.title, scenario.flight, windows, point.declared.transducer
    )
    return declared.model_copy(update={"conditions": declared.conditions.model_copy(update=_flight_pedigree(scenario))})


def _flight_pedigree(scenario: Scenario) -> dict[str, str]:
    """Source of the flight of a scenario; of a recorded trajectory that of the recording, with its confidence."""
    if scenario.declared.trajectory.source != "recorded":
        return {"source": f"synthetic: flown along {scenario.path.name}, {scenario.title}"}
    (recording,) = conditions_of_scenario(scenario)
    stated = f": {recording.source}" if recording.source else ""
    letter = {} if recording.worst is None else {"confidence": recording.worst}
    return {"source": f"recorded: {Path(scenario.declared.trajectory.file or '').name}{stated}", **letter}


def record_declaration(
    vehicle: Vehicle,
    point: ControlPoint,
    sensors: Sequence[Sensor],
    title: str,
    flight: str,
    windows: Sequence[Window] = (),
    transducers: Sequence[PressureTransducer] = (),
    *,
    measured: bool = False,
) -> RecordFile:
    """Content of record.toml for a vehicle's control point: its sensors, stack, materials and declared heating.

    title, flight : of what was flown
    windows       : of the manoeuvres that were flown
    transducers   : of the pressure at its surface, those that are read
    measured      : whether the readings are a measurement
    """
    data = point_declaration(vehicle, point, f"{title}: {point.title}", sensors) | {"flight": flight}
    data["measured"] = measured
    if transducers:
        data["thermocouples"]["transducer"] = [t.model_dump(exclude_unset=True) for t in transducers]
    if windows:
        data["manoeuvre"] = [vars(window) for window in windows]
    heating = {
        "reference": "columns",
        "nose_radius_m": vehicle.heating.nose_radius_m,
        "wall_enthalpy": vehicle.heating.model_dump()["wall_enthalpy"],
        "ratio_table": TABLE,
        **_recovery_keys(point),
        **_declared_effects(point),
    }
    if point.declared.interface is not None:
        heating["interface"] = point.declared.interface.model_dump(exclude_unset=True, exclude={"stack"})
    data |= {
        "conditions": {"file": CONDITIONS},
        "thermocouples": {"file": THERMOCOUPLES} | data["thermocouples"],
        "heating": {name: value for name, value in heating.items() if value is not None},
    }
    return check(data, RecordFile, f"record of {point.name}")


def files_of(scenario: Scenario) -> list[str]:
    """Names of all files of the records of a scenario."""
    measured = [name for name in scenario.names if scenario.vehicle.control_point(name).sensors]
    files = []
    for name in measured:
        folder = "" if len(measured) == 1 else f"{name}/"
        turbulent = turbulent_table_of(scenario.vehicle.control_point(name)) is not None
        names_of_record = (DECLARATION, CONDITIONS, THERMOCOUPLES, TABLE, *((TURBULENT,) if turbulent else ()))
        files += [f"{folder}{n}" for n in names_of_record]
    return [TRUTH, PAGE, *files]


def write_records(
    scenario: Scenario | str | os.PathLike[str], records: dict[str, Record], out: str | os.PathLike[str]
) -> list[str]:
    """Write the records, truth.toml and report.html; a single record goes into `out` itself.

    returns : names of the files and folders in `out`
    """
    from sim_heating.base.report.page import write_page  # matplotlib is slow to import
    from sim_heating.simulation.report.pages import records_page

    scenario = load_scenario(scenario)
    comment = f"Synthetic: {scenario.title}. Made by sim-heating synthesize."
    seed = scenario.declared.measurements.seed
    with (
        output_directory(out, "synthesize", inputs=scenario.files, seed=seed) as folder,
        ExitStack() as parts,
    ):
        for name, record in records.items():
            record_folder = parts.enter_context(record_directory(folder if len(records) == 1 else folder / name))
            for file_name, text in record_texts(record, comment=comment).items():
                write_text_atomic(record_folder / file_name, text)
        first = next(iter(records.values()))
        flown = first.conditions
        write_text_atomic(folder / TRUTH, _truth_text(scenario, flown))
        windows = [Window(w.kind, w.start_s, w.end_s) for w in first.declared.manoeuvre]
        write_page(folder / PAGE, lambda: records_page(scenario.title, records, windows))
        return sorted(p.name for p in folder.iterdir() if not p.name.startswith("."))


def _truth_text(scenario: Scenario, flown: Conditions) -> str:
    truth, measurements = scenario.declared.truth, scenario.declared.measurements
    data = {
        "scenario": scenario.title,
        "parameters": dict(truth.parameters),
        **({} if truth.p_surface_factor == 1.0 else {"p_surface_factor": truth.p_surface_factor}),
        "reference_condition": dict(zip(RATIO_VARIABLES, mean_condition(flown), strict=True)),
        "effect": [e.model_dump(exclude_none=True) for e in (*truth.effect, *scenario.declared.effect)],
        "measurements": measurements.model_dump(exclude_none=True),
    }
    return toml_text(data, "The truth that the records were made with, beyond what they declare.")
