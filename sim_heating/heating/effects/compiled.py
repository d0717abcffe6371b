"""Dispatcher of effects: one compiled function of an effect's code, which the time step calls through a pointer.

The step is compiled once, for any effects. In this process each effect is compiled by itself, and cached; its code is
the address of its kernel. An exported library has a single dispatcher, `indexed_dispatcher`, in which the code of an
effect is its index.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numba
from numba import types

from sim_heating.base.errors import InputError
from sim_heating.base.files import display_path
from sim_heating.base.kernels.jit import address_of, c_function
from sim_heating.base.kernels.numba_private import call_effect_at, can_raise
from sim_heating.heating.effects import Effect

SIGNATURE = types.float64(types.int64, types.CPointer(types.float64), types.int64, types.int64, types.float64)
"""value [-] = dispatcher(code, B, c, p, wall_K), wall_K [K]."""
KERNEL = types.float64(types.CPointer(types.float64), types.int64, types.int64, types.float64)
"""value [-] = kernel(B, c, p, wall_K), wall_K [K]."""


@dataclass(frozen=True)
class EffectDispatcher:
    """Dispatcher of a set of effects, and their codes.

    function : value = function(code, B, c, p, wall_K), value [-] and wall_K [K]; a reference that keeps it alive
    codes    : code of each effect, in the order in which the effects were given: an address, or an index
    """

    function: Callable[..., float]
    codes: tuple[int, ...]

    @property
    def address(self) -> Any:
        """The dispatcher as kernels take it: its address; the function itself where compilation is disabled."""
        return address_of(self.function)


def _nothing(code: int, B: Any, c: int, p: int, wall_K: float) -> float:
    """Dispatcher of an ensemble without effects; it is never called."""
    return 0.0


def _join(kernels: Sequence[Any]) -> Callable[..., float]:
    """One function that calls the kernel of a code: nested, two branches a level, for any number of kernels."""
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
def indexed_dispatcher(effects: tuple[Effect, ...]) -> EffectDispatcher:
    """Dispatcher with these effects compiled into it, for an exported library; the code of an effect is its index."""
    function = _join([e.kernel for e in effects]) if effects else _nothing
    return EffectDispatcher(c_function(SIGNATURE, function, cache=not effects), tuple(range(len(effects))))


def effect_dispatcher(effects: tuple[Effect, ...]) -> EffectDispatcher:
    """Dispatcher of these effects for this process; the code of an effect is the address of its kernel.

    effects : those with a kernel, in the order of their codes
    returns : compiled function that calls an effect by its code, and the codes
    raises  : InputError naming the effect that cannot be compiled
    """
    if numba.config.DISABLE_JIT or not effects:  # type: ignore[attr-defined]
        return indexed_dispatcher(effects)
    return EffectDispatcher(_compiled_call(), tuple(compiled_kernel(e).address for e in effects))


def _call(code, B, c, p, wall_K):  # type: ignore[no-untyped-def]
    """Dispatcher to kernels by their addresses."""
    return call_effect_at(code, B, c, p, wall_K)


@cache
def _compiled_call() -> Any:
    return c_function(SIGNATURE, _call)


def kernel_file(effect: Effect) -> Path:
    """Python file that an effect's kernel comes from, compiled or not."""
    kernel: Any = effect.kernel
    return Path(inspect.getfile(getattr(kernel, "py_func", kernel)))


def effect_context(effect: Effect) -> str:
    """`effect NAME (file)`, the beginning of a message."""
    return f"effect `{effect.name}` ({display_path(kernel_file(effect))})"


def compiled_kernel(effect: Effect) -> Any:
    """The kernel of an effect as a C function, compiled when first asked for.

    raises : InputError with file and line where it cannot be compiled, or where it can raise an exception (so can
             printing and allocating): a kernel called from C has no caller that could catch one
    """
    try:
        made, raises = _compiled(effect.kernel)
    except Exception as error:  # whatever the compiler finds in a user's kernel
        lines = [line.strip(' "') for line in str(error).splitlines()]
        reason = next((line for line in lines if line and not line.startswith("Failed in")), repr(error))
        number = re.search(r"line (\d+)", str(error))
        at = f", line {number[1]}" if number else ""
        raise InputError(f"{effect_context(effect)}{at}: cannot be compiled: {reason}") from error
    if raises:
        raise InputError(
            f"{effect_context(effect)}: raises, prints or allocates memory, which a time step cannot; "
            "return a number for every input"
        )
    return made


@cache
def _compiled(kernel: Any) -> tuple[Any, bool]:
    """A kernel as a C function, and whether it can raise."""
    made = c_function(KERNEL, kernel.py_func)
    return made, can_raise(made)
