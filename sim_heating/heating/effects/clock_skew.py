"""Time skew between the clocks of thermocouples and flight conditions, docs/effects.md, equation 22."""

from __future__ import annotations

from sim_heating.base.parameters import Parameter
from sim_heating.heating.effects import Effect

EFFECT = Effect(
    name="time-skew",
    mode="model",
    parameters=(Parameter("skew_s", "s", 0.0, 0.5, -10.0, 10.0, "recorded T(t) = true T(t - skew): above 0, it lags"),),
    places=("clock.skew",),
    physics="Recorders of different systems are seldom on one clock; a second is worth mils of coating.",
    source="'Trends in Shuttle Entry Heating from the Correlation of Flight Test Maneuvers'",
)
