"""Radiation in depth: conductivity grows faster with temperature than declared.

docs/reference/effects.md, equation 20.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sim_heating.base.conditions import Conditions
from sim_heating.heating.effects import Effect, SearchStart, model_parameter


def search_starts(flown: Conditions) -> Sequence[SearchStart]:
    """Search starts for radiative conduction (docs/reference/effects.md, equation 20), with nothing added yet.

    flown   : conditions of the flight, not used
    returns : radiation at all temperatures, or above 400 to 1200 [K], up to which the declared table holds
    """
    return [
        SearchStart(("k_rad",), {"from_K": 0.0}),
        *(SearchStart(("k_rad", "from_K"), {"from_K": float(T)}) for T in np.arange(400.0, 1300.0, 200.0)),
    ]


EFFECT = Effect(
    name="radiative-conduction",
    mode="model",
    parameters=(
        model_parameter("k_rad", "stack.rsi.radiative_conductivity", "conductivity added at 1000 K; it grows with T^3"),
        model_parameter(
            "from_K", "stack.rsi.radiation_from_K", "temperature up to which the declared conductivity holds"
        ),
    ),
    neutral={"k_rad": 0.0},
    search_starts=search_starts,
    # Radiation adds to a conductivity; one that is declared too high when hot is a slope of `conductivity`.
    search_bounds={"k_rad": (0.0, 1.0), "from_K": (0.0, 2000.0)},
    physics="In fibres that are optically thick radiation diffuses: its conductivity is proportional to T^3. "
    "A declared conductivity includes it up to the temperature of the measurement.",
    source="Rosseland diffusion; Howell, Siegel & Menguc, Thermal Radiation Heat Transfer, 5th ed., ch. 12",
)
