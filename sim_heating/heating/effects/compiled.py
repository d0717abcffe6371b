"""The effects of an ensemble as one compiled function of a code, which the kernels call through a pointer.

The kernels are compiled once for any effects. In this process each effect is compiled for itself, and cached; the code
of one is its address, and the function calls it. A library that is exported has the one function `compiled_chain`, in
which the code of an effect is its place.
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
from sim_heating.base.kernels.jit import c_function, call_effect, handle
from sim_heating.heating.effects import Effect

SIGNATURE = types.float64(types.int64, types.CPointer(types.float64), types.int64, types.int64, types.float64)
"""value = chain(code, B, c, p, wall_K)"""
KERNEL = types.float64(types.CPointer(types.float64), types.int64, types.int64, types.float64)
"""value = kernel(B, c, p, wall_K)"""


@dataclass(frozen=True)
class Chain:
    """The compiled effects: `handle` is what kernels take, `function` keeps it alive; codes of the effects."""

    function: Callable[..., float]
    codes: tuple[int, ...]

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


@cache
def compiled_chain(effects: tuple[Effect, ...]) -> Chain:
    """The chain of these effects in one function; the code of an effect is its place among them."""
    function = _join([e.kernel for e in effects]) if effects else _nothing
    return Chain(c_function(SIGNATURE, function, cache=not effects), tuple(range(len(effects))))


def chain_of(effects: tuple[Effect, ...]) -> Chain:
    """The chain of these effects in this process.

    raises : InputError naming one that cannot be compiled
    """
    if numba.config.DISABLE_JIT or not effects:  # type: ignore[attr-defined]
        return compiled_chain(effects)
    return Chain(_compiled_call(), tuple(compiled_kernel(e).address for e in effects))


def _call(code, B, c, p, wall_K):  # type: ignore[no-untyped-def]
    """The chain whose codes are addresses."""
    return call_effect(code, B, c, p, wall_K)


@cache
def _compiled_call() -> Any:
    return c_function(SIGNATURE, _call)


def file_of(effect: Effect) -> Path:
    """The file that an effect's kernel comes from, compiled or not."""
    kernel: Any = effect.kernel
    return Path(inspect.getfile(getattr(kernel, "py_func", kernel)))


def place_of(effect: Effect) -> str:
    """`effect NAME (file)`."""
    return f"effect `{effect.name}` ({display_path(file_of(effect))})"


def compiled_kernel(effect: Effect) -> Any:
    """The kernel of an effect, compiled when first asked for.

    raises : InputError where it cannot be, or has an exception (to print and to take memory are some), which nobody
             could catch
    """
    try:
        made, raises = _compiled(effect.kernel)
    except Exception as error:  # whatever the compiler finds in a user's kernel
        lines = [line.strip(' "') for line in str(error).splitlines()]
        said = next((line for line in lines if line and not line.startswith("Failed in")), repr(error))
        number = re.search(r"line (\d+)", str(error))
        at = f", line {number[1]}" if number else ""
        raise InputError(f"{place_of(effect)}{at}: cannot be compiled: {said}") from error
    if raises:
        raise InputError(f"{place_of(effect)}: raises, prints or takes memory, which no step can; always give a number")
    return made


@cache
def _compiled(kernel: Any) -> tuple[Any, bool]:
    """A kernel as a function of C, and whether an exception is left in it: numba keeps each as a constant."""
    made = c_function(KERNEL, kernel.py_func)
    constants = made._library._get_module_for_linking().global_variables
    return made, any(constant.name.startswith(".const.picklebuf") for constant in constants)
