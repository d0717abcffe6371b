"""The plug-in's two compiled calls: one that looks at every frame of a host, one that moves the temperatures.

The thermal model takes its own steps. `watch_frame` carries the temperatures that a host reads to the time of each
frame along a parabola through the last thermal step,

    T(t) = T_h + s (t - h) + c (t - h)^2,       h the time that the thermal model is at,

through its start, its middle stage and its end. It asks for a thermal step when

- the wait is over: the least of LONGEST_WAIT, LONGER dt and dt (GOAL PUBLISHED_K / e)^(1/3), with e the largest
  distance of the parabola from what the last step, of dt, then found (the parabola is wrong by the cube of the time);
- or the conditions bend: a value leaves the line that it kept to over the last step by more than BENT. Then the frame
  before is heated to first, so that the bend stays where it was, and that frame's heating is known when its own
  temperatures are.

`heat_points` derives the conditions of a frame and takes the step. Within it conditions are linear in time.
"""

from __future__ import annotations

import math

import numpy as np

from sim_heating.base.arrays import FloatArray, IntArray
from sim_heating.base.conditions import FRAME
from sim_heating.base.kernels.block import (
    ALPHA,
    BETA,
    BODYFLAP,
    CURVE,
    ELEVON,
    FAILED,
    H_REF,
    JETS,
    LANES,
    LOG10_RE,
    MACH,
    N_CONDITIONS,
    P_SURFACE,
    RATE,
    RECOVERY_ENTHALPY,
    TIME,
    T,
)
from sim_heating.base.kernels.jit import njit
from sim_heating.base.limits import LIMITS
from sim_heating.heating.atmosphere import derive_kernel
from sim_heating.heating.reference.models import reference_kernel
from sim_heating.heating.reference.stagnation import COLD_WALL_K
from sim_heating.heating.surface_pressure import pressure_below_rise, stagnation_pressure_coefficient
from sim_heating.march.frames import BLOCK_START, advance_groups, begin_groups

F_TIME, F_ALTITUDE, F_VELOCITY, F_ALPHA, F_BETA, F_ELEVON, F_BODYFLAP, F_RHO, F_JETS = range(len(FRAME))
CODE, LENGTH, RADIUS, LONGEST_STEP, LONGEST_WAIT, STARTED, SPIKES, LAST_SPIKE, WAIT, SEEN = range(10)
HEATED, CHANGE, HOST_SIZE = (SEEN + k * len(FRAME) for k in (1, 2, 3))
"""Places in the host array: reference model, reference length [m], nose radius [m], longest thermal step and longest
wait for one [s]; then what changes: whether there was a frame, spikes counted and the time of the last one, the wait
for the next thermal step [s], the last frame, the frame that the thermal model is at, and what changed over its last
step, a second."""
PRESSURE_WIDTH = 4
"""Numbers of a pressure model; a point's array holds them and its running length [m]."""
SHOWN, VALUE, LINEAR, QUADRATIC = range(4)
"""Rows of what a host reads: the temperatures now [K], and their parabola: T_h, s [K/s], c [K/s2]."""

PUBLISHED_K = 0.01
"""Error of the temperatures between thermal steps that the wait is chosen for [K]."""
GOAL = 0.5
"""Share of PUBLISHED_K that the next wait aims at."""
LONGER = 2.0
"""Largest wait over the last step."""
_BENT_BY = {"velocity_m_s": 0.0, "alpha_deg": 0.02, "beta_deg": 0.02, "elevon_deg": 0.05, "bodyflap_deg": 0.05,
            "rho_kg_m3": 0.0, "jets": 0.02}  # fmt: skip
BENT = np.array([_BENT_BY.get(name, np.inf) for name in FRAME])
"""Distance from its line at which a value counts as bent; altitude acts through density."""
BENT_SHARE = np.array([0.002 if name in ("velocity_m_s", "rho_kg_m3") else 0.0 for name in FRAME])
"""The same as a share of the value itself, in addition."""

_LOWEST, _HIGHEST = (np.array([LIMITS[name][i] for name in FRAME]) for i in (0, 1))
GOOD, HEAT, BEND, CLOCK, STUCK, NO_START = -1, -2, -3, -4, -5, -6
"""Outcomes of a frame: temperatures carried on; a thermal step wanted, or two of them; a clock that goes back or jumps;
a step that did not converge; no first frame. 0 and above name the column that cannot be."""
LONGEST_FRAME_S = 60.0
"""A longer step forward is a jump of the host's clock, not a frame."""
CLOCK_ROUNDING_S = 1e-9
"""Three frames of 1/60 s are 0.05 s, whatever the difference of their rounded times."""
SPIKE = 0.5
"""Change of ln(rho) from frame to frame, over that which the change of altitude explains, that is flagged as a
spike."""
SCALE_HEIGHT_M = 5000.0
"""Smallest scale height of the atmosphere below 120 km, for the density change that altitude explains."""


# Every frame -------------------------------------------------------------------------------------------------------


@njit
def implausible(frame: FloatArray) -> int:
    """Place of the first value that is no number or out of range, GOOD where there is none."""
    for i in range(len(frame)):
        if not _LOWEST[i] <= frame[i] <= _HIGHEST[i]:
            return i
    return GOOD


@njit
def _count_spike(host: FloatArray, frame: FloatArray) -> None:
    change = abs(math.log(frame[F_RHO] / host[SEEN + F_RHO]))
    explained = abs(frame[F_ALTITUDE] - host[SEEN + F_ALTITUDE]) / SCALE_HEIGHT_M
    if change > SPIKE + explained:
        host[SPIKES] += 1.0
        host[LAST_SPIKE] = frame[F_TIME]


@njit
def _bent(host: FloatArray, frame: FloatArray, since: float) -> bool:
    """Whether a value has left the line of the last thermal step."""
    for i in range(len(frame)):
        away = abs(frame[i] - host[HEATED + i] - host[CHANGE + i] * since)
        if away > BENT[i] + BENT_SHARE[i] * frame[i]:
            return True
    return False


@njit
def watch_frame(host: FloatArray, shown: FloatArray, frame: FloatArray) -> int:
    """Check a frame and carry the temperatures to its time, or say (HEAT, BEND) that it is time for a thermal step.

    host  : (HOST_SIZE,); unchanged by a frame that is refused
    shown : (4, temperature)
    """
    bad = implausible(frame)
    if bad != GOOD:
        return bad
    if host[STARTED] == 0.0:
        return NO_START
    passed = frame[F_TIME] - host[SEEN + F_TIME]
    if passed == 0.0:
        return GOOD
    if not 0.0 < passed <= LONGEST_FRAME_S:
        return CLOCK
    _count_spike(host, frame)
    since = frame[F_TIME] - host[HEATED + F_TIME]
    if _bent(host, frame, since):
        return BEND
    if since >= host[WAIT] - CLOCK_ROUNDING_S:
        return HEAT
    for i in range(len(frame)):
        host[SEEN + i] = frame[i]
    for i in range(shown.shape[1]):
        shown[SHOWN, i] = shown[VALUE, i] + since * (shown[LINEAR, i] + since * shown[QUADRATIC, i])
    return GOOD


# Now and then ------------------------------------------------------------------------------------------------------


@njit
def derive_conditions(
    frame: FloatArray, host: FloatArray, points: FloatArray, lanes: IntArray, then: FloatArray
) -> None:
    """Condition vectors of all lanes (lane, condition) from one frame of the host.

    points : (point, PRESSURE_WIDTH + 1) pressure model and running length of each point
    lanes  : the point in each lane; a lane that fills a group up repeats the one before it
    """
    rho, V, alpha, beta = frame[F_RHO], frame[F_VELOCITY], frame[F_ALPHA], frame[F_BETA]
    code = int(host[CODE])
    T_inf, p_inf, mach, log10_re = derive_kernel(frame[F_ALTITUDE], V, rho, host[LENGTH])
    radius, length = host[RADIUS], -1.0
    h_ref, H_r = 0.0, 0.0
    rise, cos_beta = 0.5 * rho * V * V * stagnation_pressure_coefficient(mach), math.cos(math.radians(beta))
    for i in range(len(lanes)):
        if i > 0 and lanes[i] == lanes[i - 1]:
            for c in range(N_CONDITIONS):
                then[i, c] = then[i - 1, c]
            continue
        point = points[lanes[i]]
        if point[PRESSURE_WIDTH] != length:
            length = point[PRESSURE_WIDTH]
            h_ref, H_r = reference_kernel(code, rho, V, T_inf, alpha, radius, length, COLD_WALL_K)
        then[i, ALPHA], then[i, BETA], then[i, LOG10_RE] = alpha, beta, log10_re
        then[i, ELEVON], then[i, BODYFLAP] = frame[F_ELEVON], frame[F_BODYFLAP]
        then[i, P_SURFACE] = pressure_below_rise(
            p_inf, rise, alpha, cos_beta, frame[F_ELEVON], frame[F_BODYFLAP], point[0], point[1], point[2], point[3]
        )
        then[i, H_REF], then[i, RECOVERY_ENTHALPY] = h_ref, H_r
        then[i, JETS], then[i, MACH], then[i, TIME] = frame[F_JETS], mach, frame[F_TIME]


@njit
def _take_parabola(state: FloatArray, places: IntArray, shown: FloatArray, dt: float) -> float:
    """Show the parabolas that the last step left; the largest distance [K] of the old ones, dt [s] on, from its end."""
    largest = 0.0
    for i in range(len(places)):
        end = state[places[i]]
        expected = shown[VALUE, i] + dt * (shown[LINEAR, i] + dt * shown[QUADRATIC, i])
        largest = max(largest, abs(end - expected))
        shown[SHOWN, i], shown[VALUE, i] = end, end
        shown[LINEAR, i] = state[places[i] + (RATE - T) * LANES]
        shown[QUADRATIC, i] = state[places[i] + (CURVE - T) * LANES]
    return largest


@njit
def _heat_to(
    state: FloatArray, ints: IntArray, table: FloatArray, chain, move, groups: IntArray, points: FloatArray,  # type: ignore[no-untyped-def]
    lanes: IntArray, then: FloatArray, places: IntArray, host: FloatArray, shown: FloatArray, frame: FloatArray,
) -> None:  # fmt: skip
    """One thermal step, or several of LONGEST_STEP, from the frame that the model is at to another."""
    dt = frame[F_TIME] - host[HEATED + F_TIME]
    steps = max(math.ceil(dt / host[LONGEST_STEP] - 1e-9), 1)
    derive_conditions(frame, host, points, lanes, then)
    advance_groups(state, ints, table, chain, move, groups, then, dt, steps)
    error = _take_parabola(state, places, shown, dt)
    longer = math.pow(GOAL * PUBLISHED_K / max(error, 1e-9), 1.0 / 3.0)
    host[WAIT] = min(host[LONGEST_WAIT], dt / steps * min(longer, LONGER))
    for i in range(len(frame)):
        host[CHANGE + i] = (frame[i] - host[HEATED + i]) / dt
        host[HEATED + i] = frame[i]
        host[SEEN + i] = frame[i]


@njit
def heat_points(
    state: FloatArray, ints: IntArray, table: FloatArray, chain, move, groups: IntArray,  # type: ignore[no-untyped-def]
    points: FloatArray, lanes: IntArray, then: FloatArray, places: IntArray, host: FloatArray, shown: FloatArray,
    frame: FloatArray, outcome: int,
) -> int:  # fmt: skip
    """Heat all points to a frame, or begin with it where it is the first; STUCK where a step did not converge.

    outcome : of `watch_frame`; BEND heats to the frame before first
    places  : (temperature,) places in the state of what `shown` holds
    """
    if outcome == NO_START:
        derive_conditions(frame, host, points, lanes, then)
        begin_groups(state, ints, table, chain, move, groups, then)
        host[STARTED] = 1.0
        for i in range(len(frame)):
            host[HEATED + i] = frame[i]
            host[SEEN + i] = frame[i]
        for i in range(len(places)):
            shown[SHOWN, i] = shown[VALUE, i] = state[places[i]]
            shown[LINEAR, i] = shown[QUADRATIC, i] = 0.0
        return GOOD
    if outcome == BEND and host[SEEN + F_TIME] > host[HEATED + F_TIME]:
        before = host[SEEN : SEEN + len(frame)].copy()
        _heat_to(state, ints, table, chain, move, groups, points, lanes, then, places, host, shown, before)
    _heat_to(state, ints, table, chain, move, groups, points, lanes, then, places, host, shown, frame)
    failed = 0.0
    for g in range(len(groups)):
        for lane in range(LANES):
            failed += state[groups[g, BLOCK_START] + FAILED * LANES + lane]
    return GOOD if failed == 0.0 else STUCK
