"""Heat capacity of insulation or coating over the declared table, docs/reference/effects.md, equation 11."""

from __future__ import annotations

from collections.abc import Sequence

from sim_heating.base.conditions import Conditions
from sim_heating.heating.effects import Effect, SearchStart, model_parameter


def search_starts(flown: Conditions) -> Sequence[SearchStart]:
    """Search starts for heat capacity (docs/reference/effects.md, equation 11), with the tables as declared.

    flown   : conditions of the flight, not used
    returns : the factor [-] of the insulation alone, and with a slope in temperature; that of the coating
    """
    names = ("heat_capacity_factor", "heat_capacity_slope")
    return [SearchStart(names[:1]), SearchStart(names), SearchStart(("coating_heat_capacity_factor",))]


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
        model_parameter(
            "heat_capacity_slope", "stack.rsi.heat_capacity_slope", "relative change per kelvin, 0 at 700 K"
        ),
    ),
    search_starts=search_starts,
    search_bounds={"heat_capacity_factor": (0.2, 5.0), "coating_heat_capacity_factor": (0.2, 5.0)},
    physics="Density and specific heat scatter from lot to lot, and waterproofing adds mass.",
    source="Williams & Curry, NASA RP-1289 (1992)",
)
