"""The soak after an entry: heat goes on inward while the surface cools in still air at sea level among surroundings at
290 K, no longer heated by the flow."""

from __future__ import annotations

import numpy as np

from sim_heating.atmosphere import SEA_LEVEL_PA
from sim_heating.thermal.declare import Construction, pairs
from sim_heating.thermal.faces import SIGMA

SURROUNDINGS_K = 290.0


def still_air(construction: Construction) -> dict[str, float]:
    """Conditions of a control point in the soak, by column; what its surroundings radiate is an added flux."""
    emissivity = construction.layer_materials()[0].emissivity or [[SURROUNDINGS_K, 1.0]]
    absorbed = float(np.interp(SURROUNDINGS_K, *pairs(emissivity))) * SIGMA * SURROUNDINGS_K**4
    return {"h_ref_kg_m2_s": 0.0, "p_surface_Pa": SEA_LEVEL_PA, "q_add_W_m2": absorbed}
