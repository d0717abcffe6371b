"""Compiled time loops: one frame of all lane groups, as a host steps them, and the whole flight of one group.

Conditions are linear in time between samples: docs/equations_march.md, equations 1 to 3.
"""

from __future__ import annotations

import numpy as np

from sim_heating.base.arrays import FloatArray, IntArray
from sim_heating.base.kernels.block import C_STAGES, LANES, N_CONDITIONS
from sim_heating.base.kernels.jit import call_step, njit, pointer
from sim_heating.thermal.step import BEGIN, shift_conditions

BLOCK_START, BLOCK_END, INTS_START, INTS_END = range(4)
"""Columns of the group array: where a group's numbers and integers stand."""
END_STAGE = C_STAGES * LANES + 2 * LANES * N_CONDITIONS
"""First of a group's condition vectors at the end of a frame."""


@njit
def set_conditions(B: FloatArray, vectors: FloatArray, first: int, share: float) -> None:
    """Move the conditions at the end of a frame part of the way to new ones: c <- c + share (c_then - c).

    B       : block of a lane group, changed
    vectors : (row, condition) new flight conditions, in the units of their columns
    first   : row of the group's first lane
    share   : part of the way [-]; from 1 on the new conditions are set exactly, without rounding

    Derived in docs/equations_march.md, equation 3.
    """
    for lane in range(LANES):
        at = END_STAGE + lane * N_CONDITIONS
        # c + 1 (then - c) need not be `then` in floating point; a host must find the conditions that it set.
        if share >= 1.0:
            for c in range(N_CONDITIONS):
                B[at + c] = vectors[first + lane, c]
        else:
            for c in range(N_CONDITIONS):
                B[at + c] += share * (vectors[first + lane, c] - B[at + c])


@njit
def begin_groups(
    state: FloatArray, ints: IntArray, table: FloatArray, dispatcher, advance, groups: IntArray, now: FloatArray
) -> None:  # type: ignore[no-untyped-def]
    """Set the flight conditions at the present time and evaluate heat contents and heat flows [W/m2] with them.

    state, ints : blocks and integers of all lane groups, changed;  groups : (group, 4) where each begins and ends
    table       : property and ratio tables;  dispatcher, advance : addresses of the compiled effects and step
    now         : (group * LANES, condition) conditions, in the units of their columns

    Time does not advance. Needed at the start and after any change of temperatures or parameters from outside, because
    a step reuses the net heat that the step before left. Derived in docs/equations_march.md, section 1.
    """
    for g in range(len(groups)):
        B = state[groups[g, BLOCK_START] : groups[g, BLOCK_END]]
        set_conditions(B, now, g * LANES, 1.0)
        call_step(
            advance,
            pointer(B),
            pointer(ints[groups[g, INTS_START] : groups[g, INTS_END]]),
            pointer(table),
            dispatcher,
            BEGIN,
        )


@njit
def advance_groups(
    state: FloatArray, ints: IntArray, table: FloatArray, dispatcher, advance, groups: IntArray, then: FloatArray,  # type: ignore[no-untyped-def]
    dt: float, steps: int,
) -> None:  # fmt: skip
    """Advance all lane groups by one frame of a host, its conditions linear between the present and the new ones.

    state, ints : blocks and integers of all lane groups, changed;  groups : (group, 4) where each begins and ends
    table       : property and ratio tables;  dispatcher, advance : addresses of the compiled effects and step
    then        : (group * LANES, condition) conditions at the end of the frame, in the units of their columns
    dt          : length of the frame [s];  steps : number of equal TR-BDF2 steps in it

    A step that does not converge is counted in its lane and raises nothing. Derived in docs/equations_march.md,
    equation 3.
    """
    for g in range(len(groups)):
        B = state[groups[g, BLOCK_START] : groups[g, BLOCK_END]]
        b, j, t = pointer(B), pointer(ints[groups[g, INTS_START] : groups[g, INTS_END]]), pointer(table)
        for s in range(steps):
            shift_conditions(b)
            set_conditions(B, then, g * LANES, 1.0 / (steps - s))
            call_step(advance, b, j, t, dispatcher, dt / steps)


@njit
def march_group(
    B: FloatArray, J: IntArray, table: FloatArray, dispatcher, advance, time_s: FloatArray, histories: FloatArray,  # type: ignore[no-untyped-def]
    which: IntArray, longest_step_s: float, kept: IntArray, out: FloatArray,
) -> None:  # fmt: skip
    """March one lane group through its flights, the conditions linear between samples.

    B, J           : block and integers of the group, changed
    table          : property and ratio tables;  dispatcher, advance : addresses of the compiled effects and step
    time_s         : (time,) samples [s];  histories : (flight, time, condition), in the units of their columns
    which          : (LANES,) flight of each lane
    longest_step_s : an interval between samples that is longer is divided into equal steps no longer than this [s]
    kept           : (m,) places in the block whose numbers are stored at every sample
    out            : (time, m) the numbers stored, temperatures [K] for instance; no rows where none are wanted

    Derived in docs/equations_march.md, equations 1 and 2.
    """
    b, j, t = pointer(B), pointer(J), pointer(table)
    m_kept = len(kept) if len(out) > 0 else 0
    for lane in range(LANES):
        for c in range(N_CONDITIONS):
            B[END_STAGE + lane * N_CONDITIONS + c] = histories[which[lane], 0, c]
    call_step(advance, b, j, t, dispatcher, BEGIN)
    for m in range(m_kept):
        out[0, m] = B[kept[m]]
    for k in range(1, len(time_s)):
        span = time_s[k] - time_s[k - 1]
        # Without the 1e-9 an interval that is a multiple of the longest step but for rounding would take a step more.
        steps = int(np.ceil(span / longest_step_s - 1e-9))
        for s in range(1, steps + 1):
            shift_conditions(b)
            f = s / steps
            for lane in range(LANES):
                for c in range(N_CONDITIONS):
                    # The last step takes the sample itself: f (then - now) would leave a rounding error in it.
                    now, then = histories[which[lane], k - 1, c], histories[which[lane], k, c]
                    B[END_STAGE + lane * N_CONDITIONS + c] = then if s == steps else now + f * (then - now)
            call_step(advance, b, j, t, dispatcher, span / steps)
        for m in range(m_kept):
            out[k, m] = B[kept[m]]
