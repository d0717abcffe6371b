"""Heat capacity: insulation or coating take up more or less heat than their tables say."""

from __future__ import annotations

from collections.abc import Sequence

from sim_heating.base.conditions import Conditions
from sim_heating.base.parameters import Parameter
from sim_heating.heating.effects import Effect, Try


def tries(flown: Conditions) -> Sequence[Try]:
    """One at a time."""
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
