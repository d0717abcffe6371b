"""Coating thickness: the effective first layer is thicker or thinner than declared, docs/effects.md, equation 6."""

from __future__ import annotations

from sim_heating.base.parameters import Parameter
from sim_heating.heating.effects import Effect

EFFECT = Effect(
    name="coating-thickness",
    mode="model",
    parameters=(
        Parameter("coating_factor", "1", 1.0, 0.3, 1e-3, 10.0, "thickness of the first layer over the declared one"),
    ),
    places=("stack.coating.thickness_factor",),
    physics="Sprayed coatings vary in thickness from tile to tile, and so does the lag of the thermocouple beneath.",
    source="'Trends in Shuttle Entry Heating from the Correlation of Flight Test Maneuvers': 10 to 21 mil",
)
