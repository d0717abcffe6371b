"""Non-isothermal wall: behind an upstream step of wall temperature heating lags, overshoots, and decays."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sim_heating.arithmetic import exp
from sim_heating.conditions import Conditions, FloatArray
from sim_heating.effects import Effect
from sim_heating.jit import njit
from sim_heating.layout import TIME
from sim_heating.parameters import Parameter

LAG, FRACTION, OVERSHOOT, DECAY, BEGIN = range(5)


@njit
def overshoot_factor(B: FloatArray, c: int, p: int, wall_K: float) -> float:
    """1 + overshoot exp(-max(t - begin, 0) / decay) [-]; the lag itself is the model's (surface_heating.py)."""
    return 1.0 + B[p + OVERSHOOT] * exp(-max(B[c + TIME] - B[p + BEGIN], 0.0) / B[p + DECAY])


def starts(flown: Conditions) -> Sequence[dict[str, float]]:
    """Short and long lags, excess and want of heating, decaying from where the heating is half its greatest."""
    film = flown["h_ref_kg_m2_s"] if "h_ref_kg_m2_s" in flown else flown["rho_kg_m3"] ** 0.5
    begin = float(flown.time_s[int(np.argmax(film >= 0.5 * np.max(film)))])
    return [
        {"lag_s": lag, "lag_fraction": 0.0, "overshoot": 0.0, "decay_s": decay, "decay_begin_s": begin}
        for lag in (2.0, 6.0)
        for decay in (60.0, 250.0)
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
    variants=(("lag_s", "lag_fraction"), ("lag_s", "lag_fraction", "overshoot", "decay_s")),
    starts=starts,
    physics="A wall that is colder upstream gives more heat behind the step, less so as both warm: larger, lagging.",
    source="Chapman & Rubesin, J. Aero. Sci. 16 (1949) 547; Kays & Crawford, Convective Heat and Mass Transfer",
)
