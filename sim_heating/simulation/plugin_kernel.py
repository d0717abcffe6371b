"""The plug-in's two compiled calls: one checks every frame of a host, the other advances the temperatures.

The thermal model takes its own steps. `watch_frame` extrapolates the temperatures that a host reads to the time of
each frame, along a parabola through the start, the middle stage and the end of the last thermal step,

    T(t) = T_h + s (t - h) + c (t - h)^2,       h the time that the thermal model is at.

A thermocouple that lags follows the temperature of its place (base/kernels/lag.py), linear over a thermal step and from
the last one to the frame. The kernel asks for a thermal step when

- the wait is over: the least of LONGEST_WAIT, LARGEST_GROWTH dt and dt (TARGET_SHARE TOLERANCE_K / e)^(1/3), with e
  the largest error of the parabola at the end of the last step, of length dt (it grows with the cube of the time);
- or the conditions bend: a value leaves the straight line of the last step by more than BEND_TOLERANCE. The thermal
  model then steps to the frame before and from there to this one, so that the corner of the conditions stays at the
  frame where it was.

`heat_points` derives the conditions of a frame and takes the step. Within it conditions are linear in time. They end at
the frame plus the mean distance of the frames of the wait from their chord: a deflection that is commanded ten times a
second is a staircase, and of its stairs a step at every n-th frame would always meet the same ones.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from sim_heating.base.arrays import FloatArray, IntArray
from sim_heating.base.conditions import FRAME, LINE_TOLERANCE, LINE_TOLERANCE_SHARE
from sim_heating.base.kernels import block
from sim_heating.base.kernels.block import LANES
from sim_heating.base.kernels.jit import njit
from sim_heating.base.kernels.lag import lag_step
from sim_heating.base.kernels.operations import pointer
from sim_heating.base.limits import LIMITS
from sim_heating.heating.atmosphere import HIGHEST_M, free_stream_kernel
from sim_heating.heating.edge_flow import FLOW_WIDTH, KIND, LAMINAR_AT, LARGEST, NO_EDGE, edge_flow_kernel
from sim_heating.heating.interface import upstream_enthalpy
from sim_heating.heating.ratio.lookup import table_ratio
from sim_heating.heating.reference.models import is_dense, reference_film_kernel, surface_angle, total_enthalpy_kernel
from sim_heating.heating.reference.rarefied import bridged_film, free_molecular_film
from sim_heating.heating.reference.recovery import NO_INCIDENCE, Incidence, incidence_at, point_recovery_kernel
from sim_heating.heating.reference.stagnation import COLD_WALL_K, SLOWEST_M_S, stagnation_kernel
from sim_heating.heating.surface_pressure import PRESSURE_WIDTH, pressure_below_rise, stagnation_rise
from sim_heating.heating.surroundings import still_air_kernel, surroundings_kernel
from sim_heating.march.frames import BLOCK_START, END_STAGE, LaneGroups, advance_groups, begin_groups

F_TIME, F_ALTITUDE, F_VELOCITY, F_ALPHA, F_BETA, F_ELEVON, F_BODYFLAP, F_RHO, F_JETS = range(len(FRAME))
CODE, LENGTH, RADIUS, SWEEP, LONGEST_STEP, LONGEST_WAIT, FASTEST, BY_ALTITUDE, AROUND = range(9)
STARTED, SPIKES, LAST_SPIKE, TOO_FAST, TOO_HIGH, LONGEST_FRAME, WAIT, LAST_FRAME = range(9, 17)
THERMAL_FRAME, SLOPE, AREA, HOST_SIZE = (LAST_FRAME + k * len(FRAME) for k in (1, 2, 3, 4))
"""Places in the host array. Constant: reference model, reference length [m], nose radius [m], sweep [deg], longest
thermal step and longest wait for one [s], speed to which the reference heating holds [m/s], 1 where surroundings follow
from altitude. Changing: surroundings that the host states [K], 0 without; 1 after the first frame, number of density
spikes, time of the last one [s], frames above that speed and above the atmosphere's table, the longest frame [s], wait
for the next thermal step [s], the last frame, the frame that the thermal model is at, the rates of change of the
frame's values over the last thermal step [1/s], and their integrals over time since then [s]."""
RUNNING_LENGTH = PRESSURE_WIDTH
FLOW_AT = RUNNING_LENGTH + 1
RECOVERY_AT = FLOW_AT + KIND
UPSTREAM_PLACE = FLOW_AT + FLOW_WIDTH
UPSTREAM_CP = UPSTREAM_PLACE + 1
GROUND_VIEW = UPSTREAM_CP + 1
POINT_WIDTH = GROUND_VIEW + 1
"""Numbers of a control point: its pressure model, the running length of its reference heating [m], what its declared
effects ask of the flow at its edge, of which the last ones, from RECOVERY_AT on, are its recovery enthalpy; place in
the state of the wall upstream of its interface, below 0 without one, and cp of its enthalpy [J/(kg K)], 0 for air;
view factor of the ground [-]."""


class PointConstants(NamedTuple):
    """What the conditions of control points follow from.

    numbers : (point, POINT_WIDTH) of each point
    tables  : its laminar ratio table, and its turbulent one where it has declared transition (heating/edge_flow.py)
    """

    numbers: FloatArray
    tables: FloatArray


CURRENT, VALUE, LINEAR, QUADRATIC, TAU, LAGGED = range(6)
PUBLISHED_ROWS = 6
"""Rows of the published array: the temperatures now [K], and their parabola: T_h [K], s [K/s], c [K/s2]; time constant
of a thermocouple [s], 0 without a lag, and its temperature at the last thermal step [K]."""

TOLERANCE_K = 0.01
"""Tolerated error of the temperatures between thermal steps [K]."""
TARGET_SHARE = 0.5
"""Share of TOLERANCE_K that the next wait is chosen for."""
LARGEST_GROWTH = 2.0
"""Largest ratio of the next wait to the last step."""
# With these distances and TOLERANCE_K (decision 0007) temperatures stay within 0.02 K of those of a step with every
# frame over an entry.
BEND_SHARE = 0.6
"""How far a frame may lie off the line of the last step, over how far samples of a flight may lie off theirs [-]."""
BEND_TOLERANCE = np.array([BEND_SHARE * LINE_TOLERANCE.get(name, np.inf) for name in FRAME])
"""Distance of a value from its line that counts as a bend; altitude acts through density."""
BEND_TOLERANCE_SHARE = np.array([LINE_TOLERANCE_SHARE.get(name, 0.0) for name in FRAME])
"""Further distance that is tolerated, as a share of the value itself."""

_LOWEST, _HIGHEST = (np.array([LIMITS[name][i] for name in FRAME]) for i in (0, 1))
GOOD, HEAT, BEND, CLOCK, NOT_CONVERGED, NOT_STARTED = -1, -2, -3, -4, -5, -6
"""Outcomes of a frame: temperatures extrapolated; one thermal step needed, or two; the clock went back or jumped; a
thermal step did not converge; `reset` was not called. 0 and above: the column whose value is out of range."""
LONGEST_FRAME_S = 60.0
"""A longer step forward is a jump of the host's clock, not a frame."""
LONGEST_LINE_S = 1.0
"""Longest frame [s] over which derived conditions are linear; a longer one is heated in parts."""
LONGEST_PART_S = 0.5
"""Longest part [s] of a frame that is heated in parts."""
CLOCK_ROUNDING_S = 1e-9
"""Tolerance of times: three frames of 1/60 s count as 0.05 s although the difference of their times is rounded."""
SPIKE = 0.5
"""Change of ln(rho) from frame to frame, beyond what the change of altitude explains, that counts as a spike."""
SCALE_HEIGHT_M = 5000.0
"""Smallest scale height of the atmosphere below 120 km, for the density change that altitude explains."""


# Every frame -------------------------------------------------------------------------------------------------------


@njit
def implausible(frame: FloatArray) -> int:
    """Place of the first value of a frame that is NaN or out of range, GOOD where all are plausible."""
    for i in range(len(frame)):
        if not _LOWEST[i] <= frame[i] <= _HIGHEST[i]:
            return i
    return GOOD


@njit
def _count_spike(host: FloatArray, frame: FloatArray) -> None:
    change = abs(math.log(frame[F_RHO] / host[LAST_FRAME + F_RHO]))
    explained = abs(frame[F_ALTITUDE] - host[LAST_FRAME + F_ALTITUDE]) / SCALE_HEIGHT_M
    if change > SPIKE + explained:
        host[SPIKES] += 1.0
        host[LAST_SPIKE] = frame[F_TIME]


@njit
def _count_beyond(host: FloatArray, frame: FloatArray) -> None:
    """Count a frame beyond the speed of the reference heating or above the table of the atmosphere."""
    host[TOO_FAST] += 1.0 if frame[F_VELOCITY] > host[FASTEST] else 0.0
    host[TOO_HIGH] += 1.0 if frame[F_ALTITUDE] > HIGHEST_M else 0.0


@njit
def _is_bent(host: FloatArray, frame: FloatArray, since: float) -> bool:
    """Whether a value has left the line of the last thermal step."""
    for i in range(len(frame)):
        away = abs(frame[i] - host[THERMAL_FRAME + i] - host[SLOPE + i] * since)
        if away > BEND_TOLERANCE[i] + BEND_TOLERANCE_SHARE[i] * frame[i]:
            return True
    return False


@njit
def watch_frame(host: FloatArray, published: FloatArray, frame: FloatArray) -> int:
    """Check a frame and extrapolate the temperatures to its time; its outcome.

    host      : (HOST_SIZE,); unchanged by a frame that is refused
    published : (PUBLISHED_ROWS, temperature), rows CURRENT to LAGGED
    frame     : values in the order of conditions.FRAME
    returns   : GOOD, or HEAT or BEND where thermal steps are needed (`heat_points`), or why the frame is refused
    """
    invalid = implausible(frame)
    if invalid != GOOD:
        return invalid
    if host[STARTED] == 0.0:
        return NOT_STARTED
    elapsed = frame[F_TIME] - host[LAST_FRAME + F_TIME]
    # A host that is paused repeats its frame.
    if elapsed == 0.0:
        return GOOD
    # `not` in front, so that a time that is NaN is refused as well.
    if not 0.0 < elapsed <= LONGEST_FRAME_S:
        return CLOCK
    _count_spike(host, frame)
    _count_beyond(host, frame)
    host[LONGEST_FRAME] = max(host[LONGEST_FRAME], elapsed)
    since = frame[F_TIME] - host[THERMAL_FRAME + F_TIME]
    if _is_bent(host, frame, since):
        return BEND
    if since >= host[WAIT] - CLOCK_ROUNDING_S:
        return HEAT
    for i in range(len(frame)):
        host[AREA + i] += 0.5 * elapsed * (host[LAST_FRAME + i] + frame[i])
        host[LAST_FRAME + i] = frame[i]
    _extrapolate(published, since)
    return GOOD


@njit
def _extrapolate(published: FloatArray, since: float) -> None:
    """Extrapolate published temperatures to a time after the last thermal step [s]; lagging ones follow their own."""
    for i in range(published.shape[1]):
        published[CURRENT, i] = published[VALUE, i] + since * (published[LINEAR, i] + since * published[QUADRATIC, i])
    # A loop of its own: without a branch the one above vectorises.
    for i in range(published.shape[1]):
        if published[TAU, i] > 0.0:
            published[CURRENT, i] = lag_step(
                published[LAGGED, i], published[VALUE, i], published[CURRENT, i], since / published[TAU, i]
            )


# Thermal steps -----------------------------------------------------------------------------------------------------


@njit
def _film_at_point(
    code: int,
    h_ref: float,
    rho: float,
    V: float,
    T_inf: float,
    x: FloatArray,
    sweep_deg: float,
    point: FloatArray,
    tables: FloatArray,
    incidence: Incidence,
) -> float:
    """Reference film coefficient [kg/(m2 s)] of a point, bridged in thin air (heating/reference/rarefied.py).

    h_ref     : in continuum flow;  x : conditions of the point, its ratio variables and recovery enthalpy among them
    incidence : of a surface, this one perhaps
    """
    angle = surface_angle(code, x[block.ALPHA], x[block.ELEVON], x[block.BODYFLAP], sweep_deg, point, RECOVERY_AT)
    # Most of an entry ends here, without the look-up of the ratio.
    if h_ref == 0.0 or is_dense(rho, V, incidence_at(angle, incidence).sine, point[FLOW_AT + LARGEST] * h_ref):
        return h_ref
    at = int(point[FLOW_AT + LAMINAR_AT])
    ratio = table_ratio(tables, at, x, 0) if at != block.NO_TABLE else 1.0
    speed = max(V, SLOWEST_M_S)
    return bridged_film(h_ref, free_molecular_film(rho, speed, T_inf, angle, x[block.RECOVERY_ENTHALPY]), ratio)


@njit
def derive_conditions(
    frame: FloatArray, host: FloatArray, points: PointConstants, lanes: IntArray, vectors: FloatArray
) -> None:
    """Derive the conditions of all lanes from one frame of the host.

    host    : (HOST_SIZE,), of which the reference model, reference length and nose radius are read
    points  : pressure model, edge and running length of each point, and the tables of its declared transition
    lanes   : the point in each lane; a lane that fills a group up repeats the one before it
    vectors : (lane, condition), filled
    """
    rho, V, alpha, beta = frame[F_RHO], frame[F_VELOCITY], frame[F_ALPHA], frame[F_BETA]
    code = int(host[CODE])
    T_inf, p_inf, mach, log10_re = free_stream_kernel(frame[F_ALTITUDE], V, rho, host[LENGTH])
    radius, length = host[RADIUS], -1.0
    h_ref, H_0 = 0.0, total_enthalpy_kernel(V, T_inf)
    # One shock for the surface pressures, the reference heating and the edges of the points.
    state = stagnation_kernel(rho, max(V, SLOWEST_M_S), T_inf)
    rise, cos_beta, edge = stagnation_rise(state), math.cos(math.radians(beta)), NO_EDGE
    incidence = NO_INCIDENCE
    for i in range(len(lanes)):
        # Lanes that fill a group repeat its last point.
        if i > 0 and lanes[i] == lanes[i - 1]:
            for c in range(block.N_CONDITIONS):
                vectors[i, c] = vectors[i - 1, c]
            continue
        # Pointers: an array goes to each kernel as seven numbers.
        point, vector = pointer(points.numbers[lanes[i]]), pointer(vectors[i])
        # The reference heating is the largest part of a frame; it differs between points by their running length alone.
        if point[RUNNING_LENGTH] != length:
            length = point[RUNNING_LENGTH]
            h_ref = reference_film_kernel(code, rho, V, T_inf, alpha, radius, length, COLD_WALL_K, state, host[SWEEP])
        vector[block.ALPHA], vector[block.BETA], vector[block.LOG10_RE] = alpha, beta, log10_re
        vector[block.ELEVON], vector[block.BODYFLAP] = frame[F_ELEVON], frame[F_BODYFLAP]
        vector[block.P_SURFACE], incidence = pressure_below_rise(
            p_inf, rise, alpha, cos_beta, frame[F_ELEVON], frame[F_BODYFLAP], point, incidence
        )
        vector[block.RECOVERY_ENTHALPY], vector[block.RECOVERY_RISE], incidence = point_recovery_kernel(
            H_0, V, alpha, frame[F_ELEVON], frame[F_BODYFLAP], point, RECOVERY_AT, incidence
        )
        vector[block.H_REF] = _film_at_point(
            code, h_ref, rho, V, T_inf, vector, host[SWEEP], point, pointer(points.tables), incidence
        )
        vector[block.SURROUNDINGS] = host[AROUND]
        if host[BY_ALTITUDE] > 0.0:
            vector[block.STILL_AIR], vector[block.AIR_K] = still_air_kernel(V, p_inf), T_inf
            if host[AROUND] == 0.0:
                vector[block.SURROUNDINGS] = surroundings_kernel(T_inf, p_inf, point[GROUND_VIEW])
        vector[block.JETS], vector[block.MACH], vector[block.TIME] = frame[F_JETS], mach, frame[F_TIME]
        vector[block.TURBULENT_RATIO], vector[block.LOG10_RE_THETA_M], vector[block.DISSOCIATION], edge = (
            edge_flow_kernel(state, V, vector, point, FLOW_AT, pointer(points.tables), edge)
        )


@njit
def follow_upstream_walls(
    state: FloatArray, points: PointConstants, lanes: IntArray, vectors: FloatArray, first: int, last: int
) -> None:
    """Write the enthalpy of air at the walls upstream of interfaces into the conditions of lanes behind them.

    state       : of the ensemble, with the walls upstream at the time of the vectors
    vectors     : (lane, condition)
    first, last : the lanes, from `first` to before `last`
    """
    for i in range(first, last):
        offset = int(points.numbers[lanes[i], UPSTREAM_PLACE])
        if offset >= 0:
            vectors[i, block.UPSTREAM] = upstream_enthalpy(
                state[offset], vectors[i, block.P_SURFACE], points.numbers[lanes[i], UPSTREAM_CP]
            )


@njit
def advance_behind_walls(
    state: FloatArray,
    ints: IntArray,
    table: FloatArray,
    dispatcher,
    advance,
    groups: IntArray,
    points: PointConstants,
    lanes: IntArray,
    vectors: FloatArray,
    then: FloatArray,
    dt: float,
    steps: int,
) -> None:
    """Advance all lane groups by dt [s], those behind interfaces with the walls upstream; as `advance_groups`.

    vectors : (lane, condition) at the end, overwritten;  then : a copy of them, of the same shape

    A wall upstream is in an earlier group (march/lanes.py): its temperature at the end of a step is known when the
    step of the walls behind it is taken, and its enthalpy is linear over the step, as in a march.
    """
    behind = False
    for i in range(len(lanes)):
        behind = behind or points.numbers[lanes[i], UPSTREAM_PLACE] >= 0.0
    if not behind:
        advance_groups(state, ints, table, dispatcher, advance, groups, vectors, dt, steps)
        return
    for k in range(steps):
        fraction = 1.0 / (steps - k)
        for g in range(len(groups)):
            first = g * LANES
            for i in range(first, first + LANES):
                now = groups[g, BLOCK_START] + END_STAGE + (i - first) * block.N_CONDITIONS
                for c in range(block.N_CONDITIONS):
                    # c + 1 (then - c) need not be `then` in floating point.
                    change = fraction * (then[i, c] - state[now + c])
                    vectors[i, c] = state[now + c] + change if fraction < 1.0 else then[i, c]
            follow_upstream_walls(state, points, lanes, vectors, first, first + LANES)
            group, of_lanes = groups[g : g + 1], vectors[first : first + LANES]
            advance_groups(state, ints, table, dispatcher, advance, group, of_lanes, dt / steps, 1)


@njit
def derive_history(
    frames: FloatArray, host: FloatArray, points: PointConstants, lanes: IntArray, histories: FloatArray
) -> None:
    """Derive the conditions of all lanes along a flight; arguments as for `derive_conditions`.

    frames    : (time, len(FRAME))
    histories : (lane, time, condition), filled
    """
    vectors = np.zeros((len(lanes), block.N_CONDITIONS))
    for k in range(len(frames)):
        derive_conditions(frames[k], host, points, lanes, vectors)
        histories[:, k] = vectors


@njit
def _update_parabolas(state: FloatArray, offsets: IntArray, published: FloatArray, dt: float) -> float:
    """Publish the parabolas of the last step, of dt [s]; the largest error [K] of the previous ones at its end."""
    largest = 0.0
    for i in range(len(offsets)):
        end = state[offsets[i]]
        expected = published[VALUE, i] + dt * (published[LINEAR, i] + dt * published[QUADRATIC, i])
        largest = max(largest, abs(end - expected))
        sensed = end
        if published[TAU, i] > 0.0:
            sensed = lag_step(published[LAGGED, i], published[VALUE, i], end, dt / published[TAU, i])
        published[CURRENT, i], published[VALUE, i], published[LAGGED, i] = sensed, end, sensed
        published[LINEAR, i] = state[offsets[i] + (block.RATE - block.T) * LANES]
        published[QUADRATIC, i] = state[offsets[i] + (block.CURVE - block.T) * LANES]
    return largest


@njit
def _heat_to(
    all_lanes: LaneGroups,
    points: PointConstants,
    lanes: IntArray,
    vectors: FloatArray,
    offsets: IntArray,
    host: FloatArray,
    published: FloatArray,
    frame: FloatArray,
) -> None:
    """Advance from the frame that the model is at to another, in thermal steps of at most LONGEST_STEP."""
    dt = frame[F_TIME] - host[THERMAL_FRAME + F_TIME]
    # Without the 1e-9, rounding would add a step to a wait that is a multiple of the longest one.
    steps = max(math.ceil(dt / host[LONGEST_STEP] - 1e-9), 1)
    elapsed, end = frame[F_TIME] - host[LAST_FRAME + F_TIME], frame.copy()
    # Without a frame between there is no distance from the chord, where rounding would leave one.
    if host[LAST_FRAME + F_TIME] > host[THERMAL_FRAME + F_TIME]:
        for i in range(F_TIME + 1, len(frame)):
            area = host[AREA + i] + 0.5 * elapsed * (host[LAST_FRAME + i] + frame[i])
            end[i] += area / dt - 0.5 * (host[THERMAL_FRAME + i] + frame[i])
    derive_conditions(end, host, points, lanes, vectors)
    e = all_lanes
    advance_behind_walls(
        e.state, e.ints, e.table, e.dispatcher, e.advance, e.groups, points, lanes, vectors, vectors.copy(), dt, steps
    )
    error = _update_parabolas(all_lanes.state, offsets, published, dt)
    # A parabola carried on errs with the cube of the time: hence the cube root. Steps at every n-th frame were tried
    # and rejected: they meet a ripple of the elevon at the rate of commands always in the same phase, and a cold wall
    # in full heating is far from any parabola.
    longer = math.pow(TARGET_SHARE * TOLERANCE_K / max(error, 1e-9), 1.0 / 3.0)
    host[WAIT] = min(host[LONGEST_WAIT], dt / steps * min(longer, LARGEST_GROWTH))
    for i in range(len(frame)):
        host[SLOPE + i] = (frame[i] - host[THERMAL_FRAME + i]) / dt
        host[THERMAL_FRAME + i] = frame[i]
        host[LAST_FRAME + i] = frame[i]
        host[AREA + i] = 0.0


@njit
def parts_of_frame(dt: float) -> int:
    """Number of parts [-] in which a frame of dt [s] is heated, 1 up to LONGEST_LINE_S."""
    return math.ceil(dt / LONGEST_PART_S - 1e-9) if dt > LONGEST_LINE_S + CLOCK_ROUNDING_S else 1


@njit
def write_frame_between(first: FloatArray, frame: FloatArray, fraction: float, between: FloatArray) -> None:
    """Write the frame a share [-] of the way from one to another: linear in time, ln(rho) for the density.

    first, frame, between : (len(FRAME),) values in the order of conditions.FRAME
    """
    for i in range(len(FRAME)):
        between[i] = first[i] + fraction * (frame[i] - first[i])
    between[F_RHO] = first[F_RHO] * math.pow(frame[F_RHO] / first[F_RHO], fraction)


@njit
def _heat_through(
    all_lanes: LaneGroups,
    points: PointConstants,
    lanes: IntArray,
    vectors: FloatArray,
    offsets: IntArray,
    host: FloatArray,
    published: FloatArray,
    frame: FloatArray,
) -> None:
    """Advance to a frame, a long one in parts.

    Within a part the reference heating is linear in time, which over 10 s of an entry is up to 16 K off, and in ten
    parts 0.25 K. Frames of a wait are known: the model goes to the last of them first, with their mean, and the parts
    begin there.
    """
    first = host[LAST_FRAME : LAST_FRAME + len(frame)].copy()
    elapsed = frame[F_TIME] - first[F_TIME]
    parts = parts_of_frame(elapsed)
    if parts > 1 and first[F_TIME] > host[THERMAL_FRAME + F_TIME]:
        _heat_to(all_lanes, points, lanes, vectors, offsets, host, published, first)
    between = frame.copy()
    for k in range(1, parts):
        write_frame_between(first, frame, k / parts, between)
        _heat_to(all_lanes, points, lanes, vectors, offsets, host, published, between)
    _heat_to(all_lanes, points, lanes, vectors, offsets, host, published, frame)


@njit
def heat_points(
    all_lanes: LaneGroups,
    points: PointConstants,
    lanes: IntArray,
    vectors: FloatArray,
    offsets: IntArray,
    host: FloatArray,
    published: FloatArray,
    frame: FloatArray,
    outcome: int,
) -> int:
    """Advance all points to a frame, or start with it where it is the first.

    all_lanes : lane groups of the ensemble
    outcome   : of `watch_frame`; BEND steps to the frame before first, NOT_STARTED starts
    offsets   : (temperature,) places in the state of the published temperatures
    returns   : GOOD, or NOT_CONVERGED where a step did not converge
    """
    if outcome == NOT_STARTED:
        derive_conditions(frame, host, points, lanes, vectors)
        e = all_lanes
        follow_upstream_walls(e.state, points, lanes, vectors, 0, len(lanes))
        begin_groups(e.state, e.ints, e.table, e.dispatcher, e.advance, e.groups, vectors)
        host[STARTED] = 1.0
        _count_beyond(host, frame)
        for i in range(len(frame)):
            host[THERMAL_FRAME + i] = frame[i]
            host[LAST_FRAME + i] = frame[i]
            host[AREA + i] = 0.0
        for i in range(len(offsets)):
            published[CURRENT, i] = published[VALUE, i] = published[LAGGED, i] = all_lanes.state[offsets[i]]
            published[LINEAR, i] = published[QUADRATIC, i] = 0.0
        return GOOD
    if outcome == BEND and host[LAST_FRAME + F_TIME] > host[THERMAL_FRAME + F_TIME]:
        # First to the frame before the bend, so that a jump of the conditions stays within its own frame. A copy, since
        # `_heat_to` writes the last frame.
        before = host[LAST_FRAME : LAST_FRAME + len(frame)].copy()
        _heat_to(all_lanes, points, lanes, vectors, offsets, host, published, before)
    _heat_through(all_lanes, points, lanes, vectors, offsets, host, published, frame)
    failed = 0.0
    for g in range(len(all_lanes.groups)):
        for lane in range(LANES):
            failed += all_lanes.state[all_lanes.groups[g, BLOCK_START] + block.FAILED * LANES + lane]
    return GOOD if failed == 0.0 else NOT_CONVERGED
