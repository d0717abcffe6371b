"""Interaction: two variables together do more, or less, than the sum of what each does."""

from __future__ import annotations

from sim_heating.effects import Effect
from sim_heating.parameters import SECOND_ORDER, SHORT, UNITS, Parameter, per

PAIRS = tuple((i, j) for i, j in SECOND_ORDER if i != j)

EFFECT = Effect(
    name="interaction",
    mode="model",
    parameters=tuple(
        Parameter(
            f"d_{SHORT[i]}_{SHORT[j]}", per(UNITS[i], UNITS[j]), 0.0, 1e-3, -10.0, 10.0,
            f"product term of {SHORT[i]} and {SHORT[j]}",
        )
        for i, j in PAIRS
    ),
    places=tuple(f"ratio.d_{SHORT[i]}_{SHORT[j]}" for i, j in PAIRS),
    variants=tuple((f"d_{SHORT[i]}_{SHORT[j]}",) for i, j in PAIRS),
    physics="The derivative against one variable changes with another: a flap heats more at higher angle of attack.",
    source="Eq. 2 of 'Trends in Shuttle Entry Heating from the Correlation of Flight Test Maneuvers'",
)  # fmt: skip
