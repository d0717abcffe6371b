"""Where a fit starts that does not start at entry interface: temperatures at a later time, and how sure they are.

circuit   the founding paper's approximation: every node follows the outermost thermocouple as a capacitor does through
          a resistor, dT/dt = (T_thermocouple - T) / tau, with tau = TIME_CONSTANT s^2 and s = int dx / sqrt(a)
          [s^(1/2)] the square root of the time that heat takes to the node; then moved to what the thermocouples read,
          linear in s between them
profile   the wall conducts, its surface held at what the outermost thermocouple reads; what that misses is estimated
          besides, a smooth function of depth: a Gaussian process in log(1 s^(1/2) + s), the largest directions of it.
          For an outermost thermocouple under a coating; a deeper one makes for a poor first guess and a wide prior
filter    by the Kalman filter from all readings since the first row of the conditions (filtering.py)
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.base.errors import InputError
from sim_heating.base.parameters import Parameter
from sim_heating.estimation.filter.records import filtered_start
from sim_heating.estimation.record_fit import Start, march_times
from sim_heating.inputs.points import conditions_of_record
from sim_heating.inputs.record import Record
from sim_heating.march.ensemble import Ensemble, condition_history
from sim_heating.march.point import PointModel, initial_temperatures
from sim_heating.thermal.mesh import Mesh, diffusion_depths
from sim_heating.thermal.stack import Sensor

TIME_CONSTANT = 1.0
"""tau over s^2; `python -m benchmarks initial` shows what others do."""
READINGS = 3
"""Readings that are averaged for the temperature at a thermocouple."""
HOLDING_FILM = 10.0
"""Film coefficient [kg/(m2 s)] that holds the surface at a temperature, some hundred times that of an entry."""
HOLDING_CP = 1000.0
OFF_K = 10.0
"""How far the circuit and the conducting wall may be off [K], if deeper thermocouples do not say more of the wall."""
OFF_LENGTH = 0.7
"""Correlation length of that in log(1 + s): a factor of two in depth, four in time."""
DIRECTIONS = 10
"""Directions that are kept; what the next would add is below a twentieth of OFF_K."""


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


def _check_within(record: Record, time_s: float) -> None:
    begin, end = record.conditions.time_s[[0, -1]]
    if not begin < time_s <= end:
        raise InputError(f"{record.name}: a start at {time_s:g} s lies outside the conditions ({begin:g} to {end:g} s)")


def circuit_profile(record: Record, model: PointModel, mesh: Mesh, time_s: float) -> FloatArray:
    """(node,) temperatures [K] at a time from the readings before it, by the circuit analogy.

    raises : InputError where a sensor has no reading before that time
    """
    sensors = sorted(record.used_sensors, key=lambda s: s.depth_m)
    t, read = _read_before(record, sensors[0], time_s)
    _check_within(record, time_s)
    s = diffusion_depths(model.construction, mesh)
    rates = 1.0 / np.maximum(TIME_CONSTANT * s**2, 1e-9)
    profile = initial_temperatures(model.construction, mesh)
    for k in range(1, len(t)):
        kept = np.exp(-(t[k] - t[k - 1]) * rates)
        profile = 0.5 * (read[k] + read[k - 1]) * (1.0 - kept) + profile * kept
    nodes, now = (np.array(column) for column in zip(*_readings_now(record, mesh, time_s), strict=True))
    return profile + np.interp(s, s[nodes], now - profile[nodes])


def _readings_now(record: Record, mesh: Mesh, time_s: float) -> list[tuple[int, float]]:
    """Node of each used sensor, outermost first, and the mean of its last readings before a time [K]."""
    sensors = sorted(record.used_sensors, key=lambda sensor: sensor.depth_m)
    nodes = [mesh.sensors[record.sensors.index(sensor)] for sensor in sensors]
    last = [_read_before(record, sensor, time_s)[1][:-1][-READINGS:] for sensor in sensors]
    return [(node, float(np.mean(read))) for node, read in zip(nodes, last, strict=True)]


def circuit_start(record: Record, model: PointModel, mesh: Mesh, time_s: float) -> Start:
    """A start at the temperatures of the circuit, nothing of them estimated; how far a filter takes them to be off."""
    profile = circuit_profile(record, model, mesh, time_s)
    off = OFF_K * smooth_directions(diffusion_depths(model.construction, mesh))
    return Start(time_s, profile, np.zeros((mesh.nodes, 0)), covariance_K2=off @ off.T)


def conducted_profile(record: Record, model: PointModel, mesh: Mesh, time_s: float) -> FloatArray:
    """(node,) temperatures [K] at a time of the wall whose surface has been what the outermost thermocouple read.

    raises : InputError where that sensor has no reading before that time, or the conditions do not reach it
    """
    t, read = _read_before(record, min(record.used_sensors, key=lambda sensor: sensor.depth_m), time_s)
    flown = conditions_of_record(record)
    _check_within(record, time_s)
    begin, declared = flown.time_s[0], initial_temperatures(model.construction, mesh)
    steps = march_times(flown, begin, time_s)
    steps = np.append(steps[steps < time_s], time_s)
    later = t > begin
    surface = np.interp(steps, np.append(begin, t[later]), np.append(declared[0], read[later]))
    held = flown.at(steps).with_columns(
        h_ref_kg_m2_s=np.full(len(steps), HOLDING_FILM), H_r_J_kg=HOLDING_CP * surface, q_add_W_m2=np.zeros(len(steps))
    )
    thermal = {name: value for name, value in model.parameters.items() if not name.startswith("ratio.")}
    wall = replace(
        model, ratio=None, wall_enthalpy=HOLDING_CP, effects=(),
        parameters={**thermal, "ratio.d0": 1.0, "stack.emissivity_factor": 0.0, "stack.gap.fraction": 0.0},
    )  # fmt: skip
    ensemble = Ensemble([wall], [mesh])
    ensemble.march(steps, condition_history(held)[np.newaxis], keep=np.zeros(0, dtype=np.int64))
    return ensemble.node_temperatures(0)


def smooth_directions(s: FloatArray) -> FloatArray:
    """(node, DIRECTIONS) largest directions of a Gaussian process of unit variance over the depths s [s^(1/2)].

    Matern covariance of order 5/2, (1 + x + x^2 / 3) exp(-x) with x = sqrt(5) times the distance over OFF_LENGTH.
    """
    z = np.log1p(s)
    x = np.sqrt(5.0) * np.abs(z[:, np.newaxis] - z) / OFF_LENGTH
    values, vectors = np.linalg.eigh((1.0 + x + x**2 / 3.0) * np.exp(-x))
    return vectors[:, ::-1][:, :DIRECTIONS] * np.sqrt(np.maximum(values[::-1][:DIRECTIONS], 0.0))


def filter_start(record: Record, model: PointModel, mesh: Mesh, time_s: float) -> Start:
    """The start of `filtered_start`, at a time within the conditions."""
    _check_within(record, time_s)
    return filtered_start(record, model, mesh, time_s)


def profile_start(record: Record, model: PointModel, mesh: Mesh, time_s: float) -> Start:
    """A start whose temperatures are estimated: those of the conducting wall, and what it misses."""
    profile = conducted_profile(record, model, mesh, time_s)
    off = max(abs(now - profile[node]) for node, now in _readings_now(record, mesh, time_s))
    return free_start(time_s, profile, model, mesh, max(OFF_K, off))


def free_start(time_s: float, profile: FloatArray, model: PointModel, mesh: Mesh, off_K: float = OFF_K) -> Start:
    """A start from a profile (node,) [K] that may be off by so much [K], smoothly in depth: unknowns say how."""
    columns = off_K * smooth_directions(diffusion_depths(model.construction, mesh))
    unknowns = tuple(
        Parameter(f"initial.{k + 1}", "1", 0.0, 1.0, text="along a direction of the temperatures at the start")
        for k in range(columns.shape[1])
    )
    return Start(time_s, profile, columns, unknowns)


STARTS = {"circuit": circuit_start, "profile": profile_start, "filter": filter_start}
"""How a fit that starts at a time comes by its temperatures there, by name."""
