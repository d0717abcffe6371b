"""The compiled loops over frames: one frame of all groups, and the whole history of one group."""

from __future__ import annotations

import numpy as np

from sim_heating.base.arrays import FloatArray, IntArray
from sim_heating.base.kernels.block import C_STAGES, LANES, N_CONDITIONS
from sim_heating.base.kernels.jit import call_step, njit, raw
from sim_heating.thermal.step import BEGIN, hold

BLOCK_START, BLOCK_END, INTS_START, INTS_END = range(4)
"""Columns of the group array: where a group's numbers and integers stand."""
END_STAGE = C_STAGES * LANES + 2 * LANES * N_CONDITIONS
"""First of a group's condition vectors at the end of a frame."""


@njit
def set_conditions(B: FloatArray, vectors: FloatArray, first: int, share: float) -> None:
    """Move a group's conditions a share of the way to the vectors (lane, condition) from row `first` on."""
    for lane in range(LANES):
        at = END_STAGE + lane * N_CONDITIONS
        if share >= 1.0:
            for c in range(N_CONDITIONS):
                B[at + c] = vectors[first + lane, c]
        else:
            for c in range(N_CONDITIONS):
                B[at + c] += share * (vectors[first + lane, c] - B[at + c])


@njit
def begin_groups(
    state: FloatArray, ints: IntArray, table: FloatArray, chain, move, groups: IntArray, now: FloatArray
) -> None:  # type: ignore[no-untyped-def]
    """Set the conditions that hold now, (group * LANES, condition), without moving in time."""
    for g in range(len(groups)):
        B = state[groups[g, BLOCK_START] : groups[g, BLOCK_END]]
        set_conditions(B, now, g * LANES, 1.0)
        call_step(move, raw(B), raw(ints[groups[g, INTS_START] : groups[g, INTS_END]]), raw(table), chain, BEGIN)


@njit
def advance_groups(
    state: FloatArray, ints: IntArray, table: FloatArray, chain, move, groups: IntArray, then: FloatArray,  # type: ignore[no-untyped-def]
    dt: float, steps: int,
) -> None:  # fmt: skip
    """A frame of dt [s] in equal steps for all groups, to the conditions `then` (group * LANES, condition), linear
    between."""
    for g in range(len(groups)):
        B = state[groups[g, BLOCK_START] : groups[g, BLOCK_END]]
        b, j, t = raw(B), raw(ints[groups[g, INTS_START] : groups[g, INTS_END]]), raw(table)
        for s in range(steps):
            hold(b)
            set_conditions(B, then, g * LANES, 1.0 / (steps - s))
            call_step(move, b, j, t, chain, dt / steps)


@njit
def march_group(
    B: FloatArray, J: IntArray, table: FloatArray, chain, move, time_s: FloatArray, histories: FloatArray,  # type: ignore[no-untyped-def]
    which: IntArray, longest_step_s: float, kept: IntArray, out: FloatArray,
) -> None:  # fmt: skip
    """March one group through its flights; conditions are linear between samples.

    move      : handle of the compiled step (thermal/step.py)
    histories : (flight, time, condition)
    which     : (LANES,) the flight of each lane
    kept      : (m,) places in the block whose numbers are kept at every sample
    out       : (time, m), or no rows where no history is kept
    """
    b, j, t = raw(B), raw(J), raw(table)
    m_kept = len(kept) if len(out) > 0 else 0
    for lane in range(LANES):
        for c in range(N_CONDITIONS):
            B[END_STAGE + lane * N_CONDITIONS + c] = histories[which[lane], 0, c]
    call_step(move, b, j, t, chain, BEGIN)
    for m in range(m_kept):
        out[0, m] = B[kept[m]]
    for k in range(1, len(time_s)):
        span = time_s[k] - time_s[k - 1]
        steps = int(np.ceil(span / longest_step_s - 1e-9))
        for s in range(1, steps + 1):
            hold(b)
            f = s / steps
            for lane in range(LANES):
                for c in range(N_CONDITIONS):
                    now, then = histories[which[lane], k - 1, c], histories[which[lane], k, c]
                    B[END_STAGE + lane * N_CONDITIONS + c] = then if s == steps else now + f * (then - now)
            call_step(move, b, j, t, chain, span / steps)
        for m in range(m_kept):
            out[k, m] = B[kept[m]]
