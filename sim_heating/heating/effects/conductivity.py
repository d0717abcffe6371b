"""Conductivity of the insulation over its declared table, one factor for all T and p, docs/effects.md, equation 7."""

from __future__ import annotations

from sim_heating.base.parameters import Parameter
from sim_heating.heating.effects import Effect

EFFECT = Effect(
    name="conductivity",
    mode="model",
    parameters=(
        Parameter("conductivity_factor", "1", 1.0, 0.18, 1e-3, 10.0, "of the insulation, over the declared one"),
    ),
    places=("stack.rsi.conductivity_factor",),
    physics="The conductivity of fibrous insulation scatters from lot to lot and rises with use.",
    source="Williams & Curry, NASA RP-1193 (1992)",
)
