"""Heat capacity of insulation or coating over the declared table, docs/effects.md, equation 11."""

from __future__ import annotations

from collections.abc import Sequence

from sim_heating.base.conditions import Conditions
from sim_heating.base.parameters import Parameter
from sim_heating.heating.effects import Effect, Try


def tries(flown: Conditions) -> Sequence[Try]:
    """Search starts for heat capacity (docs/effects.md, equation 11): the factor [-] of insulation or coating alone."""
    return [Try(("heat_capacity_factor",)), Try(("coating_heat_capacity_factor",))]


EFFECT = Effect(
    name="heat-capacity",
    mode="model",
    parameters=(
        Parameter("heat_capacity_factor", "1", 1.0, 0.1, 1e-3, 10.0, "of the insulation, over the declared one"),
        Parameter("coating_heat_capacity_factor", "1", 1.0, 0.3, 1e-3, 10.0, "of the coating, over the declared one"),
    ),
    places=("stack.rsi.heat_capacity_factor", "stack.coating.heat_capacity_factor"),
    tries=tries,
    physics="Density and specific heat scatter from lot to lot, and waterproofing adds mass.",
    source="Williams & Curry, NASA RP-1193 (1992)",
)
