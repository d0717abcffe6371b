"""Non-isothermal wall: behind an upstream step of wall temperature heating lags, overshoots, and decays."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import Conditions
from sim_heating.base.kernels.elementary import exp
from sim_heating.base.kernels.jit import njit
from sim_heating.base.kernels.lag import lag_columns
from sim_heating.base.parameters import Parameter
from sim_heating.heating.effects import Effect, SearchStart, flight

LAG, FRACTION, OVERSHOOT, DECAY, BEGIN = range(5)
LAGS_S = (0.1, 0.2, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0)
"""Lags that a wall upstream is compared with [s]."""


@njit
def overshoot_factor(B: FloatArray, c: int, p: int, wall_K: float) -> float:
    """Factor of the decaying excess of heating behind a step of wall temperature [-].

        f = 1 + overshoot exp(-max(t - begin, 0) / decay)

    B       : block of the lane group; B[c] flight conditions with the time t [s], B[p] the parameters of EFFECT
    wall_K  : wall temperature [K], not used: the excess comes from the wall upstream, which the model does not have
    returns : factor [-], constant before `begin`; the lag of the same effect is applied by heating/film.py

    Source: the process, Chapman and Rubesin (1949); the form, docs/reference/effects.md, equation 17, its lag
    equation 18.
    """
    return 1.0 + B[p + OVERSHOOT] * exp(-max(B[c + flight.time_s] - B[p + BEGIN], 0.0) / B[p + DECAY])


def lag_of_wall(time_s: FloatArray, heating: FloatArray, wall_K: FloatArray) -> float:
    """Time constant [s] with which the radiation of a wall follows its heating, the nearest of LAGS_S.

    time_s  : (time,) [s];  heating : (time,) in any unit;  wall_K : (time,) temperature of the wall [K]
    returns : that whose lagged heating is nearest to a straight line in T^4

    Lag: docs/theory/equations.md, equation 8.
    """
    radiation = wall_K**4 - np.mean(wall_K**4)

    def distance(lag_s: float) -> float:
        lagged = lag_columns(time_s, heating[:, np.newaxis], lag_s, True)[:, 0]
        lagged -= np.mean(lagged)
        line = lagged * (lagged @ radiation) / max(float(lagged @ lagged), 1e-300)
        return float(np.sum((radiation - line) ** 2))

    return LAGS_S[int(np.argmin([distance(lag_s) for lag_s in LAGS_S]))]


def search_starts(flown: Conditions) -> Sequence[SearchStart]:
    """Search starts for a non-isothermal wall (docs/reference/effects.md, equations 17 and 18), with no lag or excess
    yet.

    flown   : conditions of the flight
    returns : lags of 1.5, 3 and 6 [s], before them that of the wall upstream where an interface is declared; excesses
              that decay in 60, 200 or 500 [s] from where h_ref H_r first reaches 0.1, or 0.5, of its maximum
    """
    heating = flown["h_ref_kg_m2_s"] * flown["H_r_J_kg"]
    begins = [float(flown.time_s[int(np.argmax(heating >= fraction * np.max(heating)))]) for fraction in (0.1, 0.5)]
    behind = [] if "T_upstream_K" not in flown else [lag_of_wall(flown.time_s, heating, flown["T_upstream_K"])]
    return [
        *(SearchStart(("lag_s", "lag_fraction"), {"lag_s": lag}) for lag in (*behind, 1.5, 3.0, 6.0)),
        *(
            SearchStart(
                ("lag_s", "lag_fraction", "overshoot", "decay_s", "decay_begin_s"),
                {"lag_s": 3.0, "decay_s": decay, "decay_begin_s": begin},
            )
            for begin in begins
            for decay in (60.0, 200.0, 500.0)
        ),
    ]


EFFECT = Effect(
    name="nonisothermal-wall",
    mode="multiply",
    parameters=(
        Parameter("lag_s", "s", 3.0, 2.0, 0.05, 100.0, "time constant of the lag"),
        Parameter("lag_fraction", "1", 0.5, 0.4, -1.0, 1.5, "part of the ratio that lags"),
        Parameter("overshoot", "1", 0.1, 0.2, -0.9, 3.0, "relative excess of heating before it decays"),
        Parameter("decay_s", "s", 200.0, 100.0, 5.0, 5000.0, "time constant of its decay"),
        Parameter("decay_begin_s", "s", 250.0, 50.0, -1e4, 1e4, "time at which it begins to decay"),
    ),
    kernel=overshoot_factor,
    lags=True,
    neutral={"lag_fraction": 0.0, "overshoot": 0.0},
    search_starts=search_starts,
    # Behind a colder wall heating is larger, and follows what changes it.
    search_bounds={"lag_fraction": (0.0, 1.5), "overshoot": (0.0, 1.5)},
    of_flight=("decay_begin_s",),
    physics="A wall that is colder upstream gives more heat behind the step, less so as both warm: larger, lagging.",
    source="Chapman & Rubesin, J. Aero. Sci. 16 (1949) 547; Kays & Crawford, Convective Heat and Mass Transfer",
)
