"""Curvature in elevon deflection: r += d_elevon2 (elevon - elevon_0)^2, docs/reference/effects.md, equation 8."""

from __future__ import annotations

from sim_heating.heating.effects import Effect, model_parameter

EFFECT = Effect(
    name="elevon-curvature",
    mode="model",
    parameters=(model_parameter("d_elevon2", "ratio.d_elevon2", sigma=1e-3, lower=-1.0, upper=1.0),),
    needs=("elevon_deg",),
    physics="The ratio has a second-order term in elevon deflection that a linear model about one condition lacks.",
    source="Eq. 2 of 'Trends in Shuttle Entry Heating from the Correlation of Flight Test Maneuvers'",
)
