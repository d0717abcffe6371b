"""The soak after a flight: heat flows inwards to the bondline while nothing heats the surface from outside."""

from __future__ import annotations

import numpy as np

from sim_heating.base.conditions import Conditions
from sim_heating.heating.atmosphere import SEA_LEVEL_PA
from sim_heating.inputs.vehicle import ControlPoint
from sim_heating.thermal.faces import SIGMA
from sim_heating.thermal.stack import Construction, pairs

SURROUNDINGS_K = 290.0
"""Temperature of the surroundings in the soak [K]."""
FIRST_S, EVERY_S = 1.0, 10.0
"""The first sample of the soak, and the interval between the others [s]."""


def soak_conditions(construction: Construction) -> dict[str, float]:
    """Conditions of a point in the soak, by column.

    There is no film, and air at sea-level pressure fills the insulation. Radiation from surroundings at SURROUNDINGS_K
    is an additional flux,

        q_add = eps(T) sigma T^4
    """
    emissivity = construction.layer_materials()[0].emissivity or [[SURROUNDINGS_K, 1.0]]
    absorbed = float(np.interp(SURROUNDINGS_K, *pairs(emissivity))) * SIGMA * SURROUNDINGS_K**4
    return {"h_ref_kg_m2_s": 0.0, "p_surface_Pa": SEA_LEVEL_PA, "q_add_W_m2": absorbed}


def with_soak(flown: Conditions, point: ControlPoint, soak_s: float) -> Conditions:
    """Conditions of a point along its flight and a soak of soak_s [s] after it."""
    if soak_s <= 0.0:
        return flown
    soak = soak_conditions(point.construction)
    after = flown.time_s[-1] + np.append(np.arange(FIRST_S, soak_s, EVERY_S), soak_s)
    columns = flown.with_columns(q_add_W_m2=0.0).columns
    return Conditions({
        name: np.concatenate((v, after if name == "time_s" else np.full(len(after), soak.get(name, v[-1]))))
        for name, v in columns.items()
    })  # fmt: skip
