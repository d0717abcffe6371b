"""First-order lag that all thermocouples of a record have in common, docs/reference/effects.md, equation 25."""

from __future__ import annotations

from sim_heating.heating.effects import Effect, model_parameter

EFFECT = Effect(
    name="sensor-lag",
    mode="model",
    parameters=(model_parameter("tau_s", "sensors.tau_s"),),
    physics="A junction takes its heat from the wall through a bond, and follows it with a time constant.",
    source="Manual on the Use of Thermocouples in Temperature Measurement, ASTM MNL 12 (1993)",
)
