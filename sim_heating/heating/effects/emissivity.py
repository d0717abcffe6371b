"""Emittance: a factor on the declared table, a change at some time, or a change with temperature."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import Conditions
from sim_heating.base.kernels.elementary import logistic
from sim_heating.base.kernels.jit import njit
from sim_heating.base.parameters import Parameter
from sim_heating.heating.effects import Effect, SearchStart, flight

FACTOR, CHANGE, SLOPE, DURATION = range(4)
REFERENCE_K = 1000.0
"""Temperature at which the slope leaves the emittance unchanged [K]."""


@njit
def emissivity_factor(B: FloatArray, c: int, p: int, wall_K: float) -> float:
    """Factor of the effect on the tabulated emittance [-], not below 0.

        f = 1 + (factor - 1) S((t - change) / duration) + slope (T_w - 1000 K),    S(x) = 1 / (1 + exp(-x))

    B       : block of the lane group; B[c] flight conditions with the time t [s], B[p] the parameters of EFFECT
    wall_K  : wall temperature T_w [K]
    returns : factor [-]; the emittance times this factor is not limited to 1

    Source: the observation, Williams and Curry, NASA RP-1289 (1992); the form, docs/reference/effects.md, equation 9.
    """
    changed = (B[p + FACTOR] - 1.0) * logistic((B[c + flight.time_s] - B[p + CHANGE]) / B[p + DURATION])
    return max(1.0 + changed + B[p + SLOPE] * (wall_K - REFERENCE_K), 0.0)


def search_starts(flown: Conditions) -> Sequence[SearchStart]:
    """Search starts for an emittance error (docs/reference/effects.md, equation 9), with the emittance as declared.

    flown   : conditions of the flight
    returns : a constant factor, a slope in temperature, or a change at five quantiles of time [s], sudden and gradual
    """
    times = np.quantile(flown.time_s, [0.2, 0.35, 0.5, 0.65, 0.8])
    return [
        SearchStart(("emissivity_factor",)),
        SearchStart(("emissivity_slope",)),
        *(
            SearchStart(("emissivity_factor", "change_s", "duration_s"), {"change_s": float(t), "duration_s": duration})
            for t in times
            for duration in (3.0, 25.0)
        ),
    ]


EFFECT = Effect(
    name="emissivity",
    mode="emittance",
    parameters=(
        Parameter("emissivity_factor", "1", 1.0, 0.1, 0.05, 2.0, "emittance over the declared one"),
        Parameter("change_s", "s", -1e4, 100.0, -1e5, 1e5, "start of the change; before the flight: always"),
        Parameter("emissivity_slope", "1/K", 0.0, 1e-4, -2e-3, 2e-3, "relative change of the emittance per kelvin"),
        Parameter("duration_s", "s", 2.0, 20.0, 0.2, 1e3, "time constant of the change"),
    ),
    kernel=emissivity_factor,
    needs_wall=True,
    neutral={"emissivity_factor": 1.0, "emissivity_slope": 0.0},
    search_starts=search_starts,
    # Declared emittances of hot coatings are 0.8 to 0.9, and none is above 1; bare metal has a third of that.
    search_bounds={"emissivity_factor": (0.3, 1.3), "emissivity_slope": (-5e-4, 5e-4)},
    of_flight=("change_s",),
    physics="Coatings age, are contaminated or blister; their emittance when hot differs from their tables.",
    source="Emittance drift of reused tiles, Williams & Curry, NASA RP-1289 (1992)",
)
