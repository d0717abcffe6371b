"""Effects that a ratio table can hold: those that add to the ratio by the variables of the table alone.

An onset in angle of attack, a curvature, a product of two variables, an addition with sideslip: with nodes where they
bend they are a table's business, and their uncertainty is then in its sigma. What multiplies the ratio by the state of
the boundary layer or of the wall, what lags, and what a thermal model or a clock has is not.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.base.kernels.block import N_CONDITIONS
from sim_heating.base.parameters import EFFECT_PREFIX
from sim_heating.heating.effects import EffectUse, ModelParameter, flight
from sim_heating.heating.effects.compiled import values_along
from sim_heating.heating.ratio.uncertainty import basis

PLACES = (flight.alpha_deg, flight.beta_deg, flight.log10_re, flight.elevon_deg, flight.bodyflap_deg)
"""Where the variables of a table are among the conditions."""


def is_of_table(used: EffectUse, x: FloatArray) -> bool:
    """Whether an effect adds a function of the variables of a ratio table.

    x      : (m, 5) conditions that were flown, [deg] and [-]
    """
    # values of all other conditions, and of the wall temperature in 1000 K, between which it does not change
    others = (1.0, 3.0)
    effect = used.effect
    if effect.mode == "model":
        return all(isinstance(p, ModelParameter) and p.stands_for.startswith("ratio.") for p in effect.parameters)
    if effect.mode != "add" or effect.lags or effect.kernel is None:
        return False
    first, other = (_kernel_values(used, x, value) for value in others)
    return bool(np.array_equal(first, other))


def added_ratio(used: EffectUse, x: FloatArray, reference: FloatArray) -> FloatArray:
    """(m,) ratio that an effect of `is_of_table` adds [-].

    x : (m, 5) alpha, beta [deg], log10 Re [-], elevon, body flap [deg];  reference : (5,) of second-order terms
    """
    if used.effect.mode == "model":
        names = [p.stands_for for p in used.effect.parameters if isinstance(p, ModelParameter)]
        return basis(names, x, reference, np.zeros(len(x))) @ np.array(used.values)
    return _kernel_values(used, x, 1.0)


def derivatives(used: EffectUse, names: Sequence[str], x: FloatArray, reference: FloatArray) -> FloatArray:
    """(m, k) derivative of the added ratio with respect to parameters of the effect, by central differences.

    names : of the parameters within the effect;  x, reference : as `added_ratio` takes them
    """
    difference = 1e-4  # step of a derivative, over the scale of the parameter
    columns = []
    for name in names:
        i = next(i for i, p in enumerate(used.effect.parameters) if p.name == name)
        p = used.effect.parameters[i]
        step = difference * max(abs(used.values[i]), p.sigma, difference)
        ends = [
            added_ratio(EffectUse(used.effect, (*used.values[:i], v, *used.values[i + 1 :])), x, reference)
            for v in (used.values[i] - step, used.values[i] + step)
        ]
        columns.append((ends[1] - ends[0]) / (2.0 * step))
    return np.stack(columns, axis=1) if columns else np.zeros((len(x), 0))


def label(used: EffectUse, name: str) -> str:
    """Dotted name of a parameter of an effect."""
    return f"{EFFECT_PREFIX}{used.effect.name}.{name}"


def _kernel_values(used: EffectUse, x: FloatArray, other: float) -> FloatArray:
    rows = np.full((len(x), N_CONDITIONS), other)
    rows[:, PLACES] = x
    return values_along(used, rows, np.full(len(x), 1000.0 * other))
