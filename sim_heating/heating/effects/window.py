"""An effect within a range of a flight condition, such as of Mach number: a flight shows it there and nowhere else.

    f_w = n + w (f - n),    w = min(1, max(0, min(v - low, high - v) / ramp))

n is the value of no effect, 0 of what adds to the ratio and 1 of a factor. docs/reference/effects.md, equation 30.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache

from sim_heating.base.arrays import FloatArray
from sim_heating.base.errors import InputError
from sim_heating.base.kernels.jit import njit
from sim_heating.heating import flight_variables
from sim_heating.heating.effects.definition import Effect, Window
from sim_heating.heating.effects.registry import effect as effect_named
from sim_heating.heating.effects.transition import TRANSITION


@njit
def share_within(v: float, low: float, high: float, ramp: float) -> float:
    """Part of an effect that acts at the value v of its window's variable, from 0 to 1.

    v, low, high, ramp : in the unit of the variable. Source: docs/reference/effects.md, equation 30.
    """
    inside = min(v - low, high - v)
    if inside < 0.0:
        return 0.0
    return inside / ramp if inside < ramp else 1.0


@cache
def effect_within(name: str, window: Window) -> Effect:
    """The effect of a name within a window; it is called `NAME-WINDOW`, and its parameters are those of the effect.

    name   : of an effect with a kernel and without memory
    window : range of a flight condition
    raises : InputError where the effect is unknown, or has no window

    >>> effect_within("jet-interaction", Window("fast", "mach", 18.0, 30.0, ramp=0.5)).name
    'jet-interaction-fast'
    """
    found = effect_named(name)
    if found.kernel is None:
        raise InputError(f"effect {name}: takes no window, as it sets parameters of the model; remove `window`")
    if found.lags or name == TRANSITION:
        raise InputError(f"effect {name}: takes no window, as it has a memory; remove `window`")
    kernel, neutral = found.kernel, 0.0 if found.mode == "add" else 1.0
    place, low, high, ramp = getattr(flight_variables, window.variable), window.low, window.high, window.ramp

    def within(B: FloatArray, c: int, p: int, wall_K: float) -> float:
        share = share_within(B[c + place], low, high, ramp)
        if share == 0.0:
            return neutral
        return neutral + share * (kernel(B, c, p, wall_K) - neutral)

    needs = dict.fromkeys((*found.needs, window.variable))
    return replace(
        found, name=f"{name}-{window.name}", kernel=njit(within), window=window, search_starts=None, needs=tuple(needs)
    )
