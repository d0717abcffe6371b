"""Curvature in body-flap deflection: r += d_bodyflap2 (bodyflap - bodyflap_0)^2.

docs/reference/effects.md, equation 4.
"""

from __future__ import annotations

from sim_heating.heating.effects import Effect, model_parameter

EFFECT = Effect(
    name="bodyflap-curvature",
    mode="model",
    parameters=(model_parameter("d_bodyflap2", "ratio.d_bodyflap2", sigma=1e-3, lower=-1.0, upper=1.0),),
    needs=("bodyflap_deg",),
    physics="The ratio has a second-order term in body-flap deflection that a linear model about one condition lacks.",
    source="Eq. 2 of 'Trends in Shuttle Entry Heating from the Correlation of Flight Test Maneuvers'",
)
