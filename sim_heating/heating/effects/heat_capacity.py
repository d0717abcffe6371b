"""Heat capacity of insulation or coating over the declared table, docs/effects.md, equation 11."""

from __future__ import annotations

from collections.abc import Sequence

from sim_heating.base.conditions import Conditions
from sim_heating.heating.effects import Effect, SearchStart, model_parameter


def search_starts(flown: Conditions) -> Sequence[SearchStart]:
    """Search starts for heat capacity (docs/effects.md, equation 11): the factor [-] of insulation or coating alone."""
    return [SearchStart(("heat_capacity_factor",)), SearchStart(("coating_heat_capacity_factor",))]


EFFECT = Effect(
    name="heat-capacity",
    mode="model",
    parameters=(
        model_parameter(
            "heat_capacity_factor", "stack.rsi.heat_capacity_factor", "of the insulation, over the declared one"
        ),
        model_parameter(
            "coating_heat_capacity_factor",
            "stack.coating.heat_capacity_factor",
            "of the coating, over the declared one",
        ),
    ),
    search_starts=search_starts,
    physics="Density and specific heat scatter from lot to lot, and waterproofing adds mass.",
    source="Williams & Curry, NASA RP-1289 (1992)",
)
