"""Cooling behind the wall by convection or radiation inside the structure, docs/reference/effects.md, equation 3."""

from __future__ import annotations

from collections.abc import Sequence

from sim_heating.base.conditions import Conditions
from sim_heating.heating.effects import Effect, SearchStart, model_parameter


def search_starts(flown: Conditions) -> Sequence[SearchStart]:
    """Search starts for backface cooling (docs/reference/effects.md, equation 3), with no cooling yet.

    flown   : conditions of the flight, not used
    returns : a film, or radiation, towards structure at 250, 300 and 400 [K]
    """
    return [
        SearchStart(names, {"back_K": T})
        for names in (("back_h_W_m2K", "back_K"), ("back_emissivity", "back_K"))
        for T in (250.0, 300.0, 400.0)
    ]


EFFECT = Effect(
    name="backface-cooling",
    mode="model",
    parameters=(
        model_parameter("back_h_W_m2K", "back.h_W_m2K"),
        model_parameter("back_K", "back.T_K"),
        model_parameter("back_emissivity", "back.emissivity"),
    ),
    neutral={"back_h_W_m2K": 0.0, "back_emissivity": 0.0},
    search_starts=search_starts,
    # Film coefficients of gases, and temperatures of a structure that survives.
    search_bounds={"back_h_W_m2K": (0.0, 500.0), "back_K": (150.0, 700.0)},
    physics="Air from the vents late in the entry, and radiation to cooler structure, limit the skin's peak.",
    source="Ko, Quinn & Gong, NASA TM-86043 and its successors (structure temperatures of STS-1 to STS-5)",
)
