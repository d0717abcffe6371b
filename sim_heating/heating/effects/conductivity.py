"""Conductivity of the insulation over its declared table: a factor, its slope in temperature, and with pressure."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sim_heating.base.conditions import Conditions
from sim_heating.heating.effects import Effect, SearchStart, model_parameter

LEAST_DECADES = 0.5
"""Range of pressure [decades] from which on a change with pressure is searched for."""


def search_starts(flown: Conditions) -> Sequence[SearchStart]:
    """Search starts for conductivity (docs/reference/effects.md, equation 7), with the table as declared.

    flown   : conditions of the flight, whose range of pressure [Pa] decides whether a change with pressure is tried
    returns : the factor alone, with a slope in temperature, and with a change with pressure as well: each is a special
              case of the next
    """
    names = ("conductivity_factor", "conductivity_slope", "conductivity_decade")
    pressure = np.maximum(flown["p_surface_Pa"], 1.0)
    varied = float(np.log10(np.max(pressure) / np.min(pressure))) > LEAST_DECADES
    return [SearchStart(names[:n]) for n in ((1, 2, 3) if varied else (1, 2))]


EFFECT = Effect(
    name="conductivity",
    mode="model",
    parameters=(
        model_parameter(
            "conductivity_factor", "stack.rsi.conductivity_factor", "of the insulation, over the declared one"
        ),
        model_parameter("conductivity_slope", "stack.rsi.conductivity_slope", "relative change per kelvin, 0 at 700 K"),
        model_parameter(
            "conductivity_decade", "stack.rsi.conductivity_decade", "relative change per decade of pressure, 0 at 1 kPa"
        ),
    ),
    search_starts=search_starts,
    search_bounds={"conductivity_factor": (0.2, 5.0)},
    physics="The conductivity of fibrous insulation scatters from lot to lot and rises with use. Its part in the gas "
    "depends on pressure, its radiative part on temperature; either may be off by itself.",
    source="Williams & Curry, NASA RP-1289 (1992)",
)
