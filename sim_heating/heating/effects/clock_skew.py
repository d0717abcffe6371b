"""Time skew between the clocks of thermocouples and flight conditions, docs/reference/effects.md, equation 22."""

from __future__ import annotations

from sim_heating.heating.effects import Effect, model_parameter

EFFECT = Effect(
    name="time-skew",
    mode="model",
    parameters=(model_parameter("skew_s", "clock.skew"),),
    physics="Recorders of different systems are seldom on one clock; a second is worth mils of coating.",
    source="'Trends in Shuttle Entry Heating from the Correlation of Flight Test Maneuvers'",
)
