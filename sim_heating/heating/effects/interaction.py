"""Interaction: a product term of two ratio variables, docs/reference/effects.md, equation 13."""

from __future__ import annotations

from collections.abc import Sequence

from sim_heating.base.conditions import Conditions
from sim_heating.base.parameters import SECOND_ORDER, SHORT_NAMES
from sim_heating.heating.effects import Effect, SearchStart, model_parameter

PAIRS = tuple((SHORT_NAMES[i], SHORT_NAMES[j]) for i, j in SECOND_ORDER if i != j)
"""Every two ratio variables, as they stand in parameter names."""


def search_starts(flown: Conditions) -> Sequence[SearchStart]:
    """Search starts for interaction (docs/reference/effects.md, equation 13): each mixed derivative alone."""
    return [SearchStart((f"d_{first}_{second}",)) for first, second in PAIRS]


EFFECT = Effect(
    name="interaction",
    mode="model",
    parameters=tuple(
        model_parameter(
            f"d_{first}_{second}",
            f"ratio.d_{first}_{second}",
            f"product term of {first} and {second}",
            sigma=1e-3,
            lower=-10.0,
            upper=10.0,
        )
        for first, second in PAIRS
    ),
    search_starts=search_starts,
    physics="The derivative against one variable changes with another: a flap heats more at higher angle of attack.",
    source="Eq. 2 of 'Trends in Shuttle Entry Heating from the Correlation of Flight Test Maneuvers'",
)
