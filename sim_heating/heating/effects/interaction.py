"""Interaction: two variables together do more, or less, than the sum of each, docs/effects.md, equation 13."""

from __future__ import annotations

from collections.abc import Sequence

from sim_heating.base.conditions import Conditions
from sim_heating.base.parameters import SECOND_ORDER, SHORT, UNITS, Parameter, per
from sim_heating.heating.effects import Effect, Try

PAIRS = tuple((i, j) for i, j in SECOND_ORDER if i != j)


def tries(flown: Conditions) -> Sequence[Try]:
    """Search starts for interaction (docs/effects.md, equation 13): each mixed derivative alone."""
    return [Try((f"d_{SHORT[i]}_{SHORT[j]}",)) for i, j in PAIRS]


EFFECT = Effect(
    name="interaction",
    mode="model",
    parameters=tuple(
        Parameter(
            f"d_{SHORT[i]}_{SHORT[j]}", per(UNITS[i], UNITS[j]), 0.0, 1e-3, -10.0, 10.0,
            f"product term of {SHORT[i]} and {SHORT[j]}",
        )
        for i, j in PAIRS
    ),
    places=tuple(f"ratio.d_{SHORT[i]}_{SHORT[j]}" for i, j in PAIRS),
    tries=tries,
    physics="The derivative against one variable changes with another: a flap heats more at higher angle of attack.",
    source="Eq. 2 of 'Trends in Shuttle Entry Heating from the Correlation of Flight Test Maneuvers'",
)  # fmt: skip
