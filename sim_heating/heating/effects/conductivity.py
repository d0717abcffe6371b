"""Conductivity of the insulation over its declared table, one factor for all T and p, docs/effects.md, equation 7."""

from __future__ import annotations

from sim_heating.heating.effects import Effect, model_parameter

EFFECT = Effect(
    name="conductivity",
    mode="model",
    parameters=(
        model_parameter(
            "conductivity_factor", "stack.rsi.conductivity_factor", "of the insulation, over the declared one"
        ),
    ),
    physics="The conductivity of fibrous insulation scatters from lot to lot and rises with use.",
    source="Williams & Curry, NASA RP-1289 (1992)",
)
