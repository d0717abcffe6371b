"""Dispatcher of effects: one compiled function of an effect's code, which the time step calls through a pointer.

The step is compiled once, for any effects. In this process each effect is compiled by itself, and cached; its code is
the address of its kernel. An exported library has a single dispatcher, `indexed_dispatcher`, in which the code of an
effect is its index.
"""

from __future__ import annotations

import inspect
import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.base.errors import InputError
from sim_heating.base.files import display_path, suggestion
from sim_heating.base.kernels.jit import address_of, c_function, is_interpreted, njit
from sim_heating.base.kernels.operations import call_dispatcher, call_effect, pointer
from sim_heating.heating import flight_variables
from sim_heating.heating.effects import Effect, EffectUse

SIGNATURE = "float64(int64, CPointer(float64), int64, int64, float64)"
"""value [-] = dispatcher(code, B, c, p, wall_K), wall_K [K]."""
KERNEL = "float64(CPointer(float64), int64, int64, float64)"
"""value [-] = kernel(B, c, p, wall_K), wall_K [K]."""

FLOWN = tuple(name for name, index in vars(flight_variables).items() if isinstance(index, int))
"""Names of the flight conditions that a kernel reads."""
CONDITIONS = 1 + max(getattr(flight_variables, name) for name in FLOWN)
"""Flight conditions before the parameters, where a kernel is run by itself."""
PROBED_WALL_K = 300.0
PROBED_WALLS_K = (300.0, 600.0, 1000.0, 1500.0, 2000.0)
"""Wall temperatures at which values of an effect that depends on it are looked at [K]."""


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
    import numba  # slow to import

    rest = numba.njit(error_model="numpy")(_join(kernels[:last]))

    def joined(code, B, c, p, wall_K):
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
    if is_interpreted() or not effects:
        return indexed_dispatcher(effects)
    return EffectDispatcher(_compiled_call(), tuple(compiled_kernel(e).address for e in effects))


def _call(code, B, c, p, wall_K):
    """Dispatcher to kernels by their addresses."""
    return call_effect(code, B, c, p, wall_K)


@cache
def _compiled_call() -> Any:
    return c_function(SIGNATURE, _call)


class EffectAlong:
    """An effect along a flight, evaluated at any values of its parameters.

    use    : an effect with a kernel
    rows   : (row, condition) flight conditions in the order and the units of `flight`;  wall_K : (row,) walls [K]
    raises : InputError where the kernel cannot be compiled
    """

    def __init__(self, use: EffectUse, rows: FloatArray, wall_K: FloatArray) -> None:
        dispatcher = effect_dispatcher((use.effect,))
        self._address, self._code = dispatcher.address, dispatcher.codes[0]
        self._rows, self._wall_K = (np.ascontiguousarray(a, dtype=float) for a in (rows, wall_K))

    def at(self, values: FloatArray) -> FloatArray:
        """What the effect adds to the heating ratio, or its factor, at values of its parameters.

        values  : (parameter,) or (set, parameter) values, each in its unit
        returns : (row,) or (set, row) [-]

        Each is that of the effect's own equation (docs/reference/effects.md, equations 1 to 19).
        """
        sets = np.ascontiguousarray(np.atleast_2d(values), dtype=float)
        block = np.zeros(self._rows.shape[1] + sets.shape[1])
        rows = np.empty((len(sets), len(self._rows)))
        _fill_values(self._address, self._code, self._rows, block, self._wall_K, sets, rows)
        return rows if np.ndim(values) == 2 else rows[0]


def values_along(use: EffectUse, rows: FloatArray, wall_K: FloatArray) -> FloatArray:
    """(row,) values of an effect along a flight as of `EffectAlong`, at the values of its parameters [-].

    use : an effect with a kernel;  rows : (row, condition) flight conditions;  wall_K : (row,) wall temperatures [K]

    Each value is that of the effect's own equation (docs/reference/effects.md, equations 1 to 19).
    """
    return EffectAlong(use, rows, wall_K).at(np.array(use.values))


@njit
def _fill_values(
    dispatcher: Any,
    code: int,
    rows: FloatArray,
    block: FloatArray,
    wall_K: FloatArray,
    sets: FloatArray,
    values: FloatArray,
) -> None:
    """Values [-] of the effect of a code: block has room for one of the rows, and for parameters behind it."""
    conditions = rows.shape[1]
    for s in range(len(sets)):
        for q in range(sets.shape[1]):
            block[conditions + q] = sets[s, q]
        for k in range(len(rows)):
            for c in range(conditions):
                block[c] = rows[k, c]
            values[s, k] = call_dispatcher(dispatcher, code, pointer(block), 0, conditions, wall_K[k])


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
    if not hasattr(effect.kernel, "py_func"):
        name = getattr(effect.kernel, "__name__", "the kernel")
        raise InputError(f"{effect_context(effect)}: {name} is not compiled; write @njit in the line above its `def`")
    try:
        c_kernel, raises = _compiled(effect.kernel)
    except Exception as error:  # whatever the compiler finds in a user's kernel
        number = re.search(r"line (\d+)", str(error))
        at = f", line {number[1]}" if number else ""
        raise InputError(f"{effect_context(effect)}{at}: cannot be compiled: {_reason(error)}") from error
    if raises:
        raise InputError(
            f"{effect_context(effect)}: raises, prints or allocates memory, which a time step cannot; "
            "return a number for every input"
        )
    _check_places(effect)
    return c_kernel


def _reason(error: Exception) -> str:
    """What the compiler says of a kernel, in a line; in the user's words where it speaks of its own."""
    text = str(error)
    if unknown := re.search(rf"module '{flight_variables.__name__}' has no attribute '(\w+)'", text):
        return f"flight has no `{unknown[1]}`{suggestion(unknown[1], FLOWN)}"
    if kind := re.search(r"No conversion from (.+) to float64 for '\$\S*return_value", text):
        returned = "nothing" if kind[1] == "none" else f"a value of another kind, {kind[1]},"
        return f"it returns {returned} where a number is needed"
    lines = [line.strip(' "') for line in text.splitlines()]
    return next((line for line in lines if line and not line.startswith("Failed in")), repr(error))


def _check_places(effect: Effect) -> None:
    """Run a user's kernel once by the interpreter, which knows where its numbers end: a compiled one reads on.

    raises : InputError where it reads beyond the flight conditions and the parameters of the effect
    """
    if effect.built_in:
        return
    try:
        with np.errstate(all="ignore"):
            nominal = _numbers([p.value for p in effect.parameters])
            effect.kernel.py_func(nominal, 0, CONDITIONS, PROBED_WALL_K)  # type: ignore[union-attr]
    except IndexError:
        raise InputError(
            f"{effect_context(effect)}: reads beyond its numbers: those of the flight are B[c + flight.NAME], its "
            f"parameters B[p] to B[p + {len(effect.parameters) - 1}], in the order in which they are declared"
        ) from None
    except Exception:  # such as a logarithm of 0: conditions of 0 are of no flight
        return


def _numbers(values: Sequence[float], conditions: Sequence[float] = ()) -> FloatArray:
    """What a kernel reads by itself: conditions, (CONDITIONS,), zeros where none are given, then its parameters."""
    flown = np.zeros(CONDITIONS)
    flown[: len(conditions)] = conditions
    return np.concatenate([flown, values])


def _interpreted_value(function: Callable[..., Any], numbers: FloatArray, wall_K: float) -> float:
    """Value of a kernel by the interpreter [-]; nan where that raises, as a compiled kernel returns it; wall_K [K]."""
    try:
        with np.errstate(all="ignore"):
            return float(function(numbers, 0, CONDITIONS, wall_K))
    except (ArithmeticError, TypeError, ValueError):
        return math.nan


def unusable_value(use: EffectUse, time_s: FloatArray, history: FloatArray) -> str:
    """Where a user's effect has a value that no thermal step can use, by the interpreter; for a march that failed.

    use     : the effect and the values of its parameters
    time_s  : (time,) samples of the flight [s];  history : (time, condition) in the units of their columns
    returns : a line with effect, file, time and value; empty where all values are usable, or the effect is no user's
    """
    effect = use.effect
    if effect.kernel is None or effect.built_in:
        return ""
    function = getattr(effect.kernel, "py_func", effect.kernel)
    for t, conditions in zip(time_s, history, strict=True):
        for wall_K in PROBED_WALLS_K:  # a kernel may depend on the wall without a word of it
            value = _interpreted_value(function, _numbers(use.values, conditions), wall_K)
            if math.isfinite(value) and (value >= 0.0 or effect.mode == "add"):
                continue
            wall = f" at a wall of {wall_K:g} K" if effect.needs_wall or wall_K != PROBED_WALLS_K[0] else ""
            rule = "a finite number" if effect.mode == "add" else "a factor of 0 or above"
            return f"{effect_context(effect)}: is {value:g} at time_s {t:g}{wall}; return {rule} for every input"
    return ""


@cache
def _compiled(kernel: Any) -> tuple[Any, bool]:
    """A kernel as a C function, and whether it can raise."""
    from sim_heating.base.kernels.numba_private import can_raise  # numba is slow to import

    c_kernel = c_function(KERNEL, kernel.py_func, cache=kernel.py_func.__closure__ is None)
    return c_kernel, can_raise(c_kernel)
