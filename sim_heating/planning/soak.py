"""The soak after a flight: heat flows inwards to the bondline while nothing heats the surface from outside."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from sim_heating.base.conditions import Conditions
from sim_heating.heating.atmosphere import SEA_LEVEL_PA

SURROUNDINGS_K = 290.0
"""Temperature of the surroundings in the soak [K]."""
FIRST_S, EVERY_S = 1.0, 10.0
"""The first sample of the soak, and the interval between the others [s]."""


SOAK: Mapping[str, float] = {
    "h_ref_kg_m2_s": 0.0,
    "p_surface_Pa": SEA_LEVEL_PA,
    "T_surroundings_K": SURROUNDINGS_K,
}
"""Conditions of a point in the soak, by column: no film, air at sea-level pressure, and surroundings to radiate to."""


def with_soak(flown: Conditions, soak_s: float) -> Conditions:
    """Conditions of a point along its flight and a soak of soak_s [s] after it."""
    if soak_s <= 0.0:
        return flown
    after = flown.time_s[-1] + np.append(np.arange(FIRST_S, soak_s, EVERY_S), soak_s)
    # Surroundings of 0 K are those that the stack declares; a schedule of the scenario's own goes on as it ended.
    soak = {**SOAK, "q_add_W_m2": 0.0}
    if "T_surroundings_K" in flown and "still_air_W_m2K43" not in flown:
        del soak["T_surroundings_K"]
    columns = flown.columns if "T_surroundings_K" in flown else flown.with_columns(T_surroundings_K=0.0).columns
    return Conditions(
        {
            name: np.concatenate((v, after if name == "time_s" else np.full(len(after), soak.get(name, v[-1]))))
            for name, v in columns.items()
        }
    )
