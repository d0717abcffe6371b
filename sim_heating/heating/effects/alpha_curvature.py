"""Curvature in angle of attack: r += d_alpha2 (alpha - alpha_0)^2, docs/reference/effects.md, equation 2."""

from __future__ import annotations

from sim_heating.heating.effects import Effect, model_parameter

EFFECT = Effect(
    name="alpha-curvature",
    mode="model",
    parameters=(model_parameter("d_alpha2", "ratio.d_alpha2", sigma=1e-3, lower=-1.0, upper=1.0),),
    needs=("alpha_deg",),
    physics="The ratio has a second-order term in angle of attack that a linear model about one condition lacks.",
    source="Eq. 2 of 'Trends in Shuttle Entry Heating from the Correlation of Flight Test Maneuvers'",
)
