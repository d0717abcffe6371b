"""Radiation in depth: conductivity grows faster with temperature than declared, docs/effects.md, equation 20."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sim_heating.base.conditions import Conditions
from sim_heating.base.parameters import Parameter
from sim_heating.heating.effects import Effect, Try


def tries(flown: Conditions) -> Sequence[Try]:
    """Search starts for radiative conduction (docs/effects.md, equation 20), with nothing added yet.

    flown   : conditions of the flight, not used
    returns : radiation at all temperatures, or above 400 to 1200 [K], up to which the declared table holds
    """
    return [
        Try(("k_rad",), {"from_K": 0.0}),
        *(Try(("k_rad", "from_K"), {"from_K": float(T)}) for T in np.arange(400.0, 1300.0, 200.0)),
    ]


EFFECT = Effect(
    name="radiative-conduction",
    mode="model",
    parameters=(
        Parameter("k_rad", "W/(m K)", 0.0, 0.05, -1.0, 10.0, "conductivity added at 1000 K; it grows with T^3"),
        Parameter("from_K", "K", 0.0, 200.0, 0.0, 3000.0, "temperature up to which the declared conductivity holds"),
    ),
    places=("stack.rsi.radiative_conductivity", "stack.rsi.radiation_from_K"),
    neutral={"k_rad": 0.0},
    tries=tries,
    physics="In fibres that are optically thick radiation diffuses: its conductivity is proportional to T^3. "
    "A declared conductivity holds it as far as it was measured.",
    source="Rosseland diffusion; Howell, Siegel & Menguc, Thermal Radiation Heat Transfer, 5th ed., ch. 12",
)
