"""Curvature in elevon deflection: r += d_elevon2 (elevon - elevon_0)^2, docs/effects.md, equation 8."""

from __future__ import annotations

from sim_heating.base.parameters import Parameter
from sim_heating.heating.effects import Effect

EFFECT = Effect(
    name="elevon-curvature",
    mode="model",
    parameters=(Parameter("d_elevon2", "1/deg2", 0.0, 1e-3, -1.0, 1.0, "second-order term, no factor 1/2"),),
    places=("ratio.d_elevon2",),
    needs=("elevon_deg",),
    physics="The ratio has a second-order term in elevon deflection that a linear model about one condition lacks.",
    source="Eq. 2 of 'Trends in Shuttle Entry Heating from the Correlation of Flight Test Maneuvers'",
)
