"""Where a fit starts that does not start at entry interface: temperatures at a later time, and how sure they are.

circuit   the founding paper's approximation: every node follows the outermost thermocouple as a capacitor does through
          a resistor, dT/dt = (T_thermocouple - T) / tau, with tau = TIME_CONSTANT s^2 and s = int dx / sqrt(a)
          [s^(1/2)] the square root of the time that heat takes to the node; then moved to what the thermocouples read,
          linear in s between them
profile   the same, with the temperatures at KNOTS depths estimated besides, linear in s between them
filter    by the Kalman filter from all readings since the first row of the conditions (filtering.py)
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sim_heating.ensemble import PointModel, initial_temperatures
from sim_heating.errors import InputError
from sim_heating.estimation.filtering import filtered_start
from sim_heating.estimation.problem import Start
from sim_heating.parameters import Parameter
from sim_heating.record import Record
from sim_heating.thermal.declare import Sensor
from sim_heating.thermal.mesh import Mesh, diffusion_depths

FloatArray = NDArray[np.float64]

TIME_CONSTANT = 1.0
"""tau over s^2; `python -m benchmarks initial` shows what others do."""
READINGS = 3
"""Readings that are averaged for the temperature at a thermocouple."""
KNOTS = 5
KNOT_SIGMA_K = 100.0
"""How far the temperatures of the circuit may be off at a knot [K]."""


def _read_before(record: Record, sensor: Sensor, time_s: float) -> tuple[FloatArray, FloatArray]:
    """Times [s] and readings [K] of a sensor up to a time, the last reading held to it."""
    read = record.thermocouples[sensor.column]
    held = np.isfinite(read) & (record.time_s <= time_s)
    if np.count_nonzero(held) < 2:
        raise InputError(
            f"{record.name}, sensor {sensor.name}: no readings before {time_s:g} s to start from; start later, or as "
            "declared"
        )
    return np.append(record.time_s[held], time_s), np.append(read[held], read[held][-1])


def circuit_profile(record: Record, model: PointModel, mesh: Mesh, time_s: float) -> FloatArray:
    """(node,) temperatures [K] at a time from the readings before it, by the circuit analogy.

    raises : InputError where a sensor has no reading before that time
    """
    sensors = sorted(record.used_sensors, key=lambda s: s.depth_m)
    t, read = _read_before(record, sensors[0], time_s)
    s = diffusion_depths(model.construction, mesh)
    rates = 1.0 / np.maximum(TIME_CONSTANT * s**2, 1e-9)
    profile = initial_temperatures(model.construction, mesh)
    for k in range(1, len(t)):
        kept = np.exp(-(t[k] - t[k - 1]) * rates)
        profile = 0.5 * (read[k] + read[k - 1]) * (1.0 - kept) + profile * kept
    nodes = [mesh.sensors[record.sensors.index(sensor)] for sensor in sensors]
    now = [float(np.mean(_read_before(record, sensor, time_s)[1][-READINGS:])) for sensor in sensors]
    return profile + np.interp(s, s[nodes], np.array(now) - profile[nodes])


def circuit_start(record: Record, model: PointModel, mesh: Mesh, time_s: float) -> Start:
    """A start at the temperatures of the circuit, nothing of them estimated."""
    profile = circuit_profile(record, model, mesh, time_s)
    return Start(time_s, profile, np.zeros((mesh.nodes, 0)))


def profile_start(record: Record, model: PointModel, mesh: Mesh, time_s: float) -> Start:
    """A start whose temperatures are estimated: those of the circuit, and what is added to them at KNOTS depths."""
    s = diffusion_depths(model.construction, mesh)
    knots = np.linspace(0.0, s[-1], KNOTS)
    columns = np.column_stack([np.interp(s, knots, hat) for hat in np.eye(KNOTS)])
    unknowns = tuple(
        Parameter(f"initial.{k + 1}", "K", 0.0, KNOT_SIGMA_K, text="added to the temperature at a knot of the start")
        for k in range(KNOTS)
    )
    return Start(time_s, circuit_profile(record, model, mesh, time_s), columns, unknowns)


STARTS = {"circuit": circuit_start, "profile": profile_start, "filter": filtered_start}
"""How a fit that starts at a time comes by its temperatures there, by name."""
