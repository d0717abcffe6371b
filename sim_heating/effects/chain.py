"""The effects of an ensemble as one compiled function of a code, which the kernels call through a pointer.

The kernels are compiled once for any effects: what changes with them is this function alone.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache
from typing import Any

import numba
from numba import types

from sim_heating.effects import Effect

SIGNATURE = types.float64(
    types.int64, types.CPointer(types.float64), types.int64, types.int64, types.float64
)
"""value = chain(code, B, c, p, wall_K)"""

Chain = Callable[..., float]


def _nothing(code: int, B: Any, c: int, p: int, wall_K: float) -> float:
    """The chain of an ensemble without effects; never called."""
    return 0.0


def _join(kernels: Sequence[Any]) -> Callable[..., float]:
    """One function that calls the kernel of a code; nested, so that any number of kernels can be compiled into it."""
    last = len(kernels) - 1
    kernel = kernels[last]
    if last == 0:
        return lambda code, B, c, p, wall_K: kernel(B, c, p, wall_K)
    rest = numba.njit(error_model="numpy")(_join(kernels[:last]))

    def joined(code, B, c, p, wall_K):  # type: ignore[no-untyped-def]
        if code == last:
            return kernel(B, c, p, wall_K)
        return rest(code, B, c, p, wall_K)

    return joined


@cache
def no_effects() -> Chain:
    """The chain of an ensemble that has none."""
    if numba.config.DISABLE_JIT:
        return _nothing
    return numba.cfunc(SIGNATURE, cache=True)(_nothing)


@cache
def compiled_chain(effects: tuple[Effect, ...]) -> Chain:
    """The chain of these effects; the code of an effect is its place among them."""
    if not effects:
        return no_effects()
    joined = _join([e.kernel for e in effects])
    return joined if numba.config.DISABLE_JIT else numba.cfunc(SIGNATURE, error_model="numpy")(joined)
