"""The effects of an ensemble as one compiled function of a code, which the kernels call through a pointer.

The kernels are compiled once for any effects: what changes with them is this function alone.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numba
from numba import types

from sim_heating.effects import Effect
from sim_heating.jit import handle

SIGNATURE = types.float64(types.int64, types.CPointer(types.float64), types.int64, types.int64, types.float64)
"""value = chain(code, B, c, p, wall_K)"""


@dataclass(frozen=True)
class Chain:
    """The compiled effects: `handle` is what kernels take, `function` keeps it alive."""

    function: Callable[..., float]

    @property
    def handle(self) -> Any:
        """Address of the compiled function; the function itself where nothing is compiled."""
        return handle(self.function)


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


_COMPILED: dict[tuple[Effect, ...], Chain] = {}


def compiled_chain(effects: tuple[Effect, ...]) -> Chain:
    """The chain of these effects; the code of an effect is its place among them."""
    if effects not in _COMPILED:
        function = _join([e.kernel for e in effects]) if effects else _nothing
        interpreted = numba.config.DISABLE_JIT  # type: ignore[attr-defined]
        compiled = function if interpreted else numba.cfunc(SIGNATURE, cache=not effects, error_model="numpy")(function)
        _COMPILED[effects] = Chain(compiled)
    return _COMPILED[effects]


def held(effects: tuple[Effect, ...]) -> tuple[Effect, ...]:
    """Effects of a chain that has been compiled and holds these; these themselves where there is none."""
    return next((known for known in _COMPILED if set(effects) <= set(known)), effects) if effects else effects
