"""The soak after a flight: heat goes on inwards to the bondline while nothing heats from outside."""

from __future__ import annotations

import numpy as np

from sim_heating.base.conditions import Conditions
from sim_heating.heating.atmosphere import SEA_LEVEL_PA
from sim_heating.inputs.vehicle import ControlPoint
from sim_heating.thermal.faces import SIGMA
from sim_heating.thermal.stack import Construction, pairs

COLD_K = 290.0
"""Temperature of the surroundings in the soak [K]."""
FIRST_S, EVERY_S = 1.0, 10.0
"""The first sample of the soak, and the interval between the others [s]."""


def still_air(construction: Construction) -> dict[str, float]:
    """What a point's conditions are in the soak, by column: no film, air at sea level in the insulation, surroundings
    at 290 K, whose radiation is an added flux."""
    emissivity = construction.layer_materials()[0].emissivity or [[COLD_K, 1.0]]
    absorbed = float(np.interp(COLD_K, *pairs(emissivity))) * SIGMA * COLD_K**4
    return {"h_ref_kg_m2_s": 0.0, "p_surface_Pa": SEA_LEVEL_PA, "q_add_W_m2": absorbed}


def soaked(flown: Conditions, point: ControlPoint, soak_s: float) -> Conditions:
    """A point's conditions and a soak."""
    if soak_s <= 0.0:
        return flown
    still = still_air(point.construction)
    after = flown.time_s[-1] + np.append(np.arange(FIRST_S, soak_s, EVERY_S), soak_s)
    columns = flown.with_columns(q_add_W_m2=0.0).columns
    return Conditions({
        name: np.concatenate((v, after if name == "time_s" else np.full(len(after), still.get(name, v[-1]))))
        for name, v in columns.items()
    })  # fmt: skip
