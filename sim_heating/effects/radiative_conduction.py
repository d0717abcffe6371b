"""Radiation in depth: conductivity grows faster with temperature than declared."""

from __future__ import annotations

from sim_heating.effects import Effect
from sim_heating.parameters import Parameter

EFFECT = Effect(
    name="radiative-conduction",
    mode="model",
    parameters=(
        Parameter("k_rad", "W/(m K)", 0.0, 0.05, -1.0, 10.0, "conductivity added at 1000 K; it grows with T^3"),
    ),
    places=("stack.rsi.radiative_conductivity",),
    physics="In fibres that are optically thick radiation diffuses: its conductivity is proportional to T^3.",
    source="Rosseland diffusion; Howell, Siegel & Menguc, Thermal Radiation Heat Transfer, 5th ed., ch. 12",
)
