"""Compiled time loops: one frame of all lane groups, as a host steps them, and the whole flight of one group.

Conditions are linear in time between samples: docs/theory/equations_march.md, equations 1 to 3.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from sim_heating.base.arrays import FloatArray, IntArray
from sim_heating.base.kernels.block import C_STAGES, LANES, N_CONDITIONS
from sim_heating.base.kernels.jit import force_inline, njit
from sim_heating.base.kernels.operations import call_step, pointer
from sim_heating.thermal.frame import EVALUATE_START, shift_conditions
from sim_heating.thermal.step import LaneGroup

BLOCK_START, BLOCK_END, INTS_START, INTS_END = range(4)
"""Columns of the group array: offsets of a group's block and integers."""
END_STAGE = C_STAGES * LANES + 2 * LANES * N_CONDITIONS
"""First of a group's condition vectors at the end of a frame."""


class LaneGroups(NamedTuple):
    """All lane groups of an ensemble, as a compiled loop over groups takes them.

    state, ints : blocks and integers of all groups, one after the other
    table       : property and ratio tables
    dispatcher, advance : addresses of the compiled effects and of the compiled step, as in LaneGroup
    groups      : (group, 4) where each begins and ends, BLOCK_START to INTS_END
    """

    state: FloatArray
    ints: IntArray
    table: FloatArray
    dispatcher: Any
    advance: Any
    groups: IntArray


class Flights(NamedTuple):
    """Flights along which the lanes of a group are marched.

    time_s    : (time,) samples [s], common to all flights
    histories : (flight, time, condition) conditions, in the units of their columns
    of_lane   : (LANES,) flight of each lane
    """

    time_s: FloatArray
    histories: FloatArray
    of_lane: IntArray


@force_inline
def set_flight_conditions(B: FloatArray, flights: Flights, k: int) -> None:
    """Write the conditions of sample k of each lane's flight as those at the end of a frame.

    B       : block of the lane group, changed
    flights : conditions in the units of their columns ([deg], [Pa], [J/kg] ...);  k : number of the sample

    Source: docs/theory/equations_march.md, equation 1.
    """
    for lane in range(LANES):
        for c in range(N_CONDITIONS):
            B[END_STAGE + lane * N_CONDITIONS + c] = flights.histories[flights.of_lane[lane], k, c]


@njit
def set_conditions(B: FloatArray, vectors: FloatArray, first: int, fraction: float) -> None:
    """Move the conditions at the end of a frame part of the way to new ones: c <- c + share (c_then - c).

    B        : pointer to the block of a lane group, which changes
    vectors  : (row, condition) new flight conditions, in the units of their columns
    first    : row of the group's first lane
    fraction : part of the way [-]; from 1 on the new conditions are set exactly, without rounding

    Derived in docs/theory/equations_march.md, equation 3.
    """
    then, span = pointer(vectors[first : first + LANES]), LANES * N_CONDITIONS
    # c + 1 (then - c) need not be `then` in floating point; a host must find the conditions that it set.
    if fraction >= 1.0:
        for k in range(span):
            B[END_STAGE + k] = then[k]
    else:
        for k in range(span):
            B[END_STAGE + k] += fraction * (then[k] - B[END_STAGE + k])


@njit
def begin_groups(
    state: FloatArray, ints: IntArray, table: FloatArray, dispatcher, advance, groups: IntArray, now: FloatArray
) -> None:
    """Set the flight conditions at the present time and evaluate heat contents and heat flows [W/m2] with them.

    state ... groups : all lane groups, as in LaneGroups; the state changes
    now              : (group * LANES, condition) conditions, in the units of their columns

    Time does not advance. Needed at the start and after any change of temperatures or parameters from outside, because
    a step reuses the net heat that the step before left. Derived in docs/theory/equations_march.md, section 1.
    """
    for g in range(len(groups)):
        B = state[groups[g, BLOCK_START] : groups[g, BLOCK_END]]
        b, j, t = pointer(B), pointer(ints[groups[g, INTS_START] : groups[g, INTS_END]]), pointer(table)
        set_conditions(b, now, g * LANES, 1.0)
        call_step(advance, b, j, t, dispatcher, EVALUATE_START)


@njit
def advance_groups(
    state: FloatArray,
    ints: IntArray,
    table: FloatArray,
    dispatcher,
    advance,
    groups: IntArray,
    then: FloatArray,
    dt: float,
    steps: int,
) -> None:
    """Advance all lane groups by one frame of a host, its conditions linear between the present and the new ones.

    state ... groups : all lane groups, as in LaneGroups; the state changes
    then             : (group * LANES, condition) conditions at the end of the frame, in the units of their columns
    dt               : length of the frame [s];  steps : number of equal TR-BDF2 steps in it

    A step that does not converge is counted in its lane and raises nothing. Arguments one by one: a named tuple costs a
    call from Python 1 us, a tenth of a frame. Derived in docs/theory/equations_march.md, equation 3.
    """
    for g in range(len(groups)):
        B = state[groups[g, BLOCK_START] : groups[g, BLOCK_END]]
        b, j, t = pointer(B), pointer(ints[groups[g, INTS_START] : groups[g, INTS_END]]), pointer(table)
        for s in range(steps):
            shift_conditions(b)
            set_conditions(b, then, g * LANES, 1.0 / (steps - s))
            call_step(advance, b, j, t, dispatcher, dt / steps)


@njit
def march_group(group: LaneGroup, flights: Flights, longest_step_s: float, stored: IntArray, out: FloatArray) -> None:
    """March one lane group through its flights, the conditions linear between samples.

    group          : the lane group, whose block changes
    longest_step_s : an interval between samples that is longer is divided into equal steps no longer than this [s]
    stored         : (m,) offsets in the block of the numbers that are stored at every sample
    out            : (time, m) the numbers stored, temperatures [K] for instance; no rows where none are stored

    Derived in docs/theory/equations_march.md, equations 1 and 2.
    """
    B, advance, dispatcher = group.B, group.advance, group.dispatcher
    b, j, t = pointer(B), pointer(group.J), pointer(group.table)
    time_s, histories, of_lane = flights.time_s, flights.histories, flights.of_lane
    m_stored = len(stored) if len(out) > 0 else 0
    set_flight_conditions(B, flights, 0)
    call_step(advance, b, j, t, dispatcher, EVALUATE_START)
    for m in range(m_stored):
        out[0, m] = B[stored[m]]
    for k in range(1, len(time_s)):
        span = time_s[k] - time_s[k - 1]
        # Without the 1e-9 an interval that is a multiple of the longest step but for rounding would take a step more.
        steps = max(int(np.ceil(span / longest_step_s - 1e-9)), 1)
        for s in range(1, steps + 1):
            shift_conditions(b)
            f = s / steps
            for lane in range(LANES):
                for c in range(N_CONDITIONS):
                    # The last step takes the sample itself: f (then - now) would leave a rounding error in it.
                    now, then = histories[of_lane[lane], k - 1, c], histories[of_lane[lane], k, c]
                    B[END_STAGE + lane * N_CONDITIONS + c] = then if s == steps else now + f * (then - now)
            call_step(advance, b, j, t, dispatcher, span / steps)
        for m in range(m_stored):
            out[k, m] = B[stored[m]]
