"""What a compiled model shares with the C wrapper: two arrays, and a function of them.

All numbers of a model stand in one float64 array `R`, all integers in one int64 array `N`. The wrapper (fmu/ at the
top of the repository) knows their first entries, below, and the place of each variable; everything behind them is the
model's own. A model is one function, as most of what its two deeds consist of is the same,

    move(R, N, A) -> outcome      where N[BEGINS] is 1, the initial state at R[NOW], from parameters and inputs;
                                  else from R[NOW] to R[NEXT], inputs linear from INPUTS_NOW to INPUTS_NEXT

with A the addresses of further compiled functions that it calls. An outcome is GOOD or a problem of the image
(image.py) by its number; after a problem the state is as it was.
"""

from __future__ import annotations

from typing import Any

import numba.extending
from numba import types

from sim_heating.jit import source_digest

__all__ = ["FUNCTION", "GOOD", "at", "source_digest"]

GOOD = -1
"""Outcome of a function that has no problem."""

# First numbers of R.
NOW, NEXT = 0, 1
"""Time that the state is at, and the end of the step asked for [s]."""
R_HEAD = 8

# First integers of N: where the inputs stand in R, how many there are; where their values at the start and at the end
# of a step stand, and their slopes; whether a parameter has been set since the last step; what a given input means;
# whether the model begins.
INPUTS, N_INPUTS, INPUTS_NOW, INPUTS_NEXT, INPUT_SLOPES, CHANGED, TIMING, BEGINS = range(8)
I_HEAD = 8
HELD, REACHED = 1, 2
"""An input is given as it is at the start of the step, and held unless its host says more; or as it is at the end, and
reached along a straight line."""

FUNCTION = types.int64(types.CPointer(types.float64), types.CPointer(types.int64), types.CPointer(types.int64))
"""A model as C sees it."""


@numba.extending.intrinsic
def _at(_typing_context, pointer, first):  # type: ignore[no-untyped-def]

    def codegen(_context, builder, _signature, args):  # type: ignore[no-untyped-def]
        return builder.gep(args[0], [args[1]])

    return pointer(pointer, types.int64), codegen


at: Any = _at
"""at(pointer, first): the pointer to a later number of an array."""
