"""Starts of a fit at a time after entry interface: temperatures there, and their uncertainty.

circuit   the founding paper's approximation: every node follows the outermost thermocouple as a capacitor does through
          a resistor, dT/dt = (T_thermocouple - T) / tau, with tau = TIME_CONSTANT s^2 and s = int dx / sqrt(a)
          [s^(1/2)] the square root of the time that heat takes to the node; then shifted to the readings of the
          thermocouples, linearly in s between them
profile   conduction with the surface at the readings of the outermost thermocouple; its error is estimated
          with the fit, a smooth function of depth: the largest directions of a Gaussian process in
          log(1 s^(1/2) + s). For an outermost thermocouple under a coating; a deeper one gives a poor first guess and
          a wide prior
filter    by the Kalman filter from all readings since the first row of the conditions (filter/records.py)
lost      the declared model up to a time before which readings were lost; the heating until then is unknown, and so is
          an error smooth in depth (unknown_heating.py)

Equations 2 to 6 of docs/theory/clocks_and_starts.md, with a comparison of the first three.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache, partial

import numpy as np

from sim_heating.base.arrays import FloatArray, IntArray
from sim_heating.base.errors import InputError
from sim_heating.base.parallel.threads import one_thread
from sim_heating.estimation.filter.records import filtered_start
from sim_heating.estimation.record_fit import Start, StartMaker, march_times, start_unknowns
from sim_heating.estimation.unknown_heating import after_unknown_heating, largest_directions, temperatures_at
from sim_heating.inputs.points import conditions_of_record
from sim_heating.inputs.record import Record
from sim_heating.march.ensemble import Ensemble, condition_history
from sim_heating.march.point import PointModel, initial_temperatures
from sim_heating.thermal.mesh import Mesh, diffusion_depths, halve_elements
from sim_heating.thermal.stack import Sensor

TIME_CONSTANT = 1.0
"""tau over s^2 [-]."""
READINGS = 3
"""Number of readings that are averaged for the temperature at a thermocouple."""
IMPOSING_FILM = 10.0
"""Film coefficient [kg/(m2 s)] that imposes a surface temperature, some hundred times that of an entry."""
IMPOSING_CP = 1000.0
"""Specific heat [J/(kg K)] of the wall enthalpy with it."""
START_SIGMA_K = 10.0
"""Least standard deviation [K] of the profile at a start."""
START_LENGTH = 0.7
"""Correlation length of that error in log(1 + s): a factor of two in depth, four in time."""
DIRECTIONS = 10
"""Number of directions; the next would add less than a twentieth of START_SIGMA_K."""


def _read_before(record: Record, sensor: Sensor, time_s: float) -> tuple[FloatArray, FloatArray]:
    """Times [s] and readings [K] of a sensor up to a time, the last reading extended to it."""
    read = record.thermocouples[sensor.column]
    before = np.isfinite(read) & (record.time_s <= time_s)
    if np.count_nonzero(before) < 2:
        raise InputError(
            f"{record.name}, sensor {sensor.name}: fewer than two readings before {time_s:g} s to start from; start "
            "later, or use the declared start"
        )
    return np.append(record.time_s[before], time_s), np.append(read[before], read[before][-1])


def _check_within(record: Record, time_s: float) -> None:
    begin, end = record.conditions.time_s[[0, -1]]
    if not begin < time_s <= end:
        raise InputError(f"{record.name}: a start at {time_s:g} s lies outside the conditions ({begin:g} to {end:g} s)")


def circuit_profile(record: Record, model: PointModel, mesh: Mesh, time_s: float) -> FloatArray:
    """Temperatures at a time from the readings before it, by the circuit analogy of the founding paper.

        dT/dt = (T_tc - T) / tau,   tau = s^2

    record  : readings and sensor depths;  mesh : its nodes
    time_s  : time of the profile [s]
    returns : (node,) temperatures [K], shifted to the mean of the last readings at the thermocouples, linearly in s
    raises  : InputError where a used sensor has fewer than two readings before that time, or the time lies outside the
              conditions

    Integrated from the declared temperatures, exactly for a constant T_tc between readings.
    Source: "Trends in Shuttle Entry Heating from the Correlation of Flight Test Maneuvers";
    docs/theory/clocks_and_starts.md, equation 3.
    """
    sensors = sorted(record.used_sensors, key=lambda s: s.depth_m)
    t, read = _read_before(record, sensors[0], time_s)
    _check_within(record, time_s)
    s = diffusion_depths(model.construction, mesh)
    # the surface node has s = 0: it follows at once
    rates = 1.0 / np.maximum(TIME_CONSTANT * s**2, 1e-9)
    profile = initial_temperatures(model.construction, mesh)
    for k in range(1, len(t)):
        # exact for a constant T_tc: stable however small tau is at the outer nodes
        decay = np.exp(-(t[k] - t[k - 1]) * rates)
        profile = 0.5 * (read[k] + read[k - 1]) * (1.0 - decay) + profile * decay
    nodes, now = (np.array(column) for column in zip(*_readings_now(record, mesh, time_s), strict=True))
    return shifted_to_readings(profile, s, nodes, now)


def shifted_to_readings(profile: FloatArray, s: FloatArray, nodes: IntArray, read_K: FloatArray) -> FloatArray:
    """(node,) temperatures shifted to pass through readings, linearly in diffusion depth between them [K].

    profile : (node,) [K];  s : (node,) diffusion depth [s^(1/2)]
    nodes   : (sensor,) nodes that are read, outermost first;  read_K : (sensor,) their readings [K]

    The readings at a start are better known than any analogy. Source: docs/theory/clocks_and_starts.md, equation 3.
    """
    return profile + np.interp(s, s[nodes], read_K - profile[nodes])


def _readings_now(record: Record, mesh: Mesh, time_s: float) -> list[tuple[int, float]]:
    """Node of each used sensor, outermost first, and the mean of its last readings before a time [K]."""
    sensors = sorted(record.used_sensors, key=lambda sensor: sensor.depth_m)
    nodes = [mesh.sensors[record.sensors.index(sensor)] for sensor in sensors]
    last = [_read_before(record, sensor, time_s)[1][:-1][-READINGS:] for sensor in sensors]
    return [(node, float(np.mean(read))) for node, read in zip(nodes, last, strict=True)]


def circuit_start(record: Record, model: PointModel, mesh: Mesh, time_s: float) -> Start:
    """Start at the temperatures of the circuit analogy, none of them estimated.

    time_s  : [s]
    returns : temperatures [K] without unknowns; a covariance [K2] smooth in depth, of the largest difference [K] from
              the conducted profile and at least 10 K, which fits with process noise and of segments use
    raises  : InputError as circuit_profile

    Source: docs/theory/clocks_and_starts.md, equations 3 and 4.
    """
    profile = circuit_profile(record, model, mesh, time_s)
    # conduction is nearer to the truth by an order of magnitude: the difference is the error of the analogy
    error = float(np.max(np.abs(profile - conducted_profile(record, model, mesh, time_s))))
    root = max(START_SIGMA_K, error) * smooth_directions(diffusion_depths(model.construction, mesh))
    return Start(time_s, profile, np.zeros((mesh.nodes, 0)), covariance_K2=root @ root.T)


def conducted_profile(record: Record, model: PointModel, mesh: Mesh, time_s: float) -> FloatArray:
    """Temperatures at a time of the wall whose surface has followed the outermost thermocouple.

    The declared stack is marched with its surface forced to the readings by a film coefficient of 10 kg/(m2 s), without
    radiation or other heating.

    time_s  : time of the profile [s]
    returns : (node,) temperatures [K]
    raises  : InputError where that sensor has fewer than two readings before that time, or it is outside the conditions

    A thermocouple under a coating counts as the surface. Source: docs/theory/clocks_and_starts.md, profile start;
    conduction as in docs/theory/equations.md, section 3.
    """
    t, read = _read_before(record, min(record.used_sensors, key=lambda sensor: sensor.depth_m), time_s)
    flown = conditions_of_record(record)
    _check_within(record, time_s)
    begin, declared = flown.time_s[0], initial_temperatures(model.construction, mesh)
    steps = march_times(flown, begin, time_s)
    steps = np.append(steps[steps < time_s], time_s)
    later = t > begin
    surface = np.interp(steps, np.append(begin, t[later]), np.append(declared[0], read[later]))
    imposed = flown.at(steps).with_columns(
        h_ref_kg_m2_s=np.full(len(steps), IMPOSING_FILM),
        H_r_J_kg=IMPOSING_CP * surface,
        q_add_W_m2=np.zeros(len(steps)),
    )
    ensemble = Ensemble([with_imposed_surface(model)], [mesh])
    ensemble.march(steps, condition_history(imposed)[np.newaxis], keep=np.zeros(0, dtype=np.int64))
    return ensemble.node_temperatures(0)


def with_imposed_surface(model: PointModel) -> PointModel:
    """The wall of a model without radiation and effects, and with a heating ratio of 1: the film alone heats it.

    A film coefficient of IMPOSING_FILM [kg/(m2 s)] sets its surface to T = H_r / IMPOSING_CP [K], for a recovery
    enthalpy H_r [J/kg]. Source: docs/theory/clocks_and_starts.md, profile start.
    """
    thermal = {name: value for name, value in model.parameters.items() if not name.startswith("ratio.")}
    return replace(
        model,
        ratio=None,
        wall_enthalpy=IMPOSING_CP,
        effects=(),
        parameters={**thermal, "ratio.d0": 1.0, "stack.emissivity_factor": 0.0, "stack.gap.fraction": 0.0},
    )


def smooth_directions(s: FloatArray) -> FloatArray:
    """Largest directions of a Gaussian process of unit variance over depth.

        cov = (1 + x + x^2 / 3) exp(-x),   x = sqrt(5) |log(1 + s) - log(1 + s')| / 0.7

    s       : (node,) diffusion depth [s^(1/2)], square root of the time that heat takes to a node
    returns : (node, direction) eigenvectors times the root of their eigenvalues [-], largest first, 10 at most

    Matern covariance of order 5/2. Source: Rasmussen and Williams (2006), chapter 4; docs/theory/clocks_and_starts.md,
    equation 4.
    """
    return _smooth_directions(s.tobytes()).copy(order="K")


@lru_cache(maxsize=64)
def _smooth_directions(depths: bytes) -> FloatArray:
    """(node, direction) directions [-] of the process over diffusion depths in bytes; points of one wall share them."""
    # profiles bend near the surface and are smooth deep in the wall: in the logarithm they are alike
    z = np.log1p(np.frombuffer(depths))
    x = np.sqrt(5.0) * np.abs(z[:, np.newaxis] - z) / START_LENGTH
    with one_thread():
        values, vectors = np.linalg.eigh((1.0 + x + x**2 / 3.0) * np.exp(-x))
    return vectors[:, ::-1][:, :DIRECTIONS] * np.sqrt(np.maximum(values[::-1][:DIRECTIONS], 0.0))


def filter_start(record: Record, model: PointModel, mesh: Mesh, time_s: float) -> Start:
    """Start at the temperatures and covariance of the Kalman filter from all readings before a time.

    time_s  : [s], within the conditions
    returns : temperatures [K] and covariance [K2], no unknowns
    raises  : InputError where the time is outside the conditions, or there is no reading before it

    Comparison with the other starts: docs/theory/clocks_and_starts.md, section "Starts"; the disturbance,
    docs/theory/estimation_statistics.md, equation 34.
    """
    _check_within(record, time_s)
    return filtered_start(record, model, mesh, time_s)


def profile_start(record: Record, model: PointModel, mesh: Mesh, time_s: float) -> Start:
    """Start whose temperatures are estimated: those of the conducting wall plus a smooth error in depth.

    time_s  : [s]
    returns : temperatures [K] with unknowns `initial.1` ... of unit prior; the prior of the error is 10 K, or the
              largest difference from the last readings of a thermocouple where that is more
    raises  : InputError where a used sensor has fewer than two readings before that time, or the time lies outside the
              conditions

    Source: docs/theory/clocks_and_starts.md, equation 4.
    """
    profile = conducted_profile(record, model, mesh, time_s)
    # a deeper thermocouple that contradicts the conducted profile measures its error, and widens the prior
    largest = max(abs(now - profile[node]) for node, now in _readings_now(record, mesh, time_s))
    return free_start(time_s, profile, model, mesh, max(START_SIGMA_K, largest))


def free_start(
    time_s: float, profile: FloatArray, model: PointModel, mesh: Mesh, sigma_K: float = START_SIGMA_K
) -> Start:
    """Start from a profile with an estimated error that is smooth in depth.

        T = profile + sigma_K sum_k b_k theta_k

    time_s  : [s];  profile : (node,) temperatures [K]
    sigma_K : standard deviation of the error at every node [K]
    returns : profile, (node, k) columns [K], and unknowns theta_k with mean 0 and sigma 1 [-]

    Source: docs/theory/clocks_and_starts.md, equation 4.
    """
    columns = sigma_K * smooth_directions(diffusion_depths(model.construction, mesh))
    return Start(time_s, profile, columns, start_unknowns(columns.shape[1]))


def lost_start(record: Record, model: PointModel, mesh: Mesh, time_s: float) -> Start:
    """Start at a time before which the readings were lost: the heating until then is unknown.

    time_s  : [s]
    returns : temperatures of the declared model there, with unknowns `initial.1` ... of unit prior: the largest
              directions of the unknown heating and of an error of 10 K that is smooth in depth
    raises  : InputError where the time lies outside the conditions, RunError where the declared model fails before it

    Source: docs/theory/clocks_and_starts.md, equations 4 and 6.
    """
    _check_within(record, time_s)
    flown = conditions_of_record(record)
    steps = march_times(flown, float(flown.time_s[0]), time_s)
    profile, heating = after_unknown_heating(model, mesh, flown, steps, None, time_s)
    smooth = START_SIGMA_K * smooth_directions(diffusion_depths(model.construction, mesh))
    columns, _ = largest_directions(np.hstack([heating, smooth]), DIRECTIONS)
    refined = temperatures_at(model, halve_elements(mesh), [condition_history(flown.at(steps))], steps, None, time_s)[0]
    return Start(time_s, profile, columns, start_unknowns(columns.shape[1]), refined)


def with_estimated_profile(start: Start) -> Start:
    """A start whose temperatures are estimated: those of a circuit or of a filter, with their covariance as the prior.

    returns : the start with unknowns `initial.1` ... in place of its covariance [K2]; itself where it has unknowns, or
              temperatures that are exactly known

    Source: docs/theory/clocks_and_starts.md, equation 5.
    """
    if start.unknowns or start.covariance_K2 is None:
        return start
    values, vectors = np.linalg.eigh(start.covariance_K2)
    columns, _ = largest_directions(vectors * np.sqrt(np.maximum(values, 0.0)), DIRECTIONS)
    return replace(start, columns=columns, unknowns=start_unknowns(columns.shape[1]), covariance_K2=None)


STARTS = {"circuit": circuit_start, "profile": profile_start, "filter": filter_start, "lost": lost_start}
"""Kinds of start at a given time, by the name that a command takes."""


def start_at(kind: str, time_s: float) -> StartMaker:
    """What makes a start of a kind, a key of STARTS, at a time [s]."""
    return partial(STARTS[kind], time_s=time_s)
