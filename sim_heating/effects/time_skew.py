"""Time skew: the clock of the thermocouples leads or lags that of the flight conditions."""

from __future__ import annotations

from sim_heating.effects import Effect
from sim_heating.parameters import Parameter

EFFECT = Effect(
    name="time-skew",
    mode="model",
    parameters=(Parameter("skew_s", "s", 0.0, 0.5, -10.0, 10.0, "recorded T(t) = true T(t - skew): above 0, it lags"),),
    places=("clock.skew",),
    physics="Recorders of different systems are seldom on one clock; a second is worth mils of coating.",
    source="'Trends in Shuttle Entry Heating from the Correlation of Flight Test Maneuvers'",
)
