"""Coating thickness: the effective first layer is thicker or thinner than declared.

docs/reference/effects.md, equation 6.
"""

from __future__ import annotations

from sim_heating.heating.effects import Effect, model_parameter

EFFECT = Effect(
    name="coating-thickness",
    mode="model",
    parameters=(
        model_parameter(
            "coating_factor", "stack.coating.thickness_factor", "thickness of the first layer over the declared one"
        ),
    ),
    search_bounds={"coating_factor": (0.2, 5.0)},
    physics="Sprayed coatings vary in thickness from tile to tile, and so does the lag of the thermocouple beneath.",
    source="'Trends in Shuttle Entry Heating from the Correlation of Flight Test Maneuvers': 10 to 21 mil",
)
