"""Boundary-layer transition: past a Reynolds number, which falls with angle of attack, heating turns turbulent."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import Conditions
from sim_heating.base.kernels.elementary import exp, logistic
from sim_heating.base.kernels.jit import njit
from sim_heating.base.parameters import Parameter
from sim_heating.heating.effects import Effect, SearchStart, flight

ONSET, ALPHA_SENSITIVITY, WIDTH, FACTOR, ALPHA_0, SPOTS = range(6)
NARASIMHA = 0.412
"""Constant of the intermittency 1 - exp(-0.412 x^2) [-], with which `width` is the distance between a quarter and three
quarters of the rise (Dhawan and Narasimha 1958)."""


@njit
def transition_factor(B: FloatArray, c: int, p: int, wall_K: float) -> float:
    """Factor of boundary-layer transition on the heating ratio [-], from 1 (laminar) to `factor` (turbulent).

        f = 1 + (factor - 1) Gamma(x),    x = (log10_re - onset + alpha_sens (alpha - alpha_0)) / width
        Gamma = (1 - spots) / (1 + exp(-x)) + spots (1 - exp(-0.412 max(x, 0)^2))

    B       : block of the lane group; B[c] flight conditions with alpha [deg] and log10_re [-], B[p] the parameters
    wall_K  : wall temperature [K], not used
    returns : factor [-]; Gamma is the fraction of the time that the flow is turbulent

    Source: `spots`, Dhawan and Narasimha (1958), J. Fluid Mech. 3, 418, there in distance; docs/effects.md,
    equations 23 and 24.
    """
    past = B[c + flight.log10_re] - B[p + ONSET] + B[p + ALPHA_SENSITIVITY] * (B[c + flight.alpha_deg] - B[p + ALPHA_0])
    x = past / B[p + WIDTH]
    turbulent = logistic(x)
    if B[p + SPOTS] > 0.0:
        from_onset = max(x, 0.0)
        turbulent += B[p + SPOTS] * (1.0 - exp(-NARASIMHA * from_onset * from_onset) - turbulent)
    return 1.0 + (B[p + FACTOR] - 1.0) * turbulent


def search_starts(flown: Conditions) -> Sequence[SearchStart]:
    """Search starts for transition (docs/effects.md, equations 23 and 24), still laminar.

    flown   : conditions of the flight
    returns : onsets at 14 quantiles of the log10 Reynolds number flown [-], in either form, first independent of angle
              of attack: a flight that crosses its onset once cannot separate alpha_sens from the onset
    """
    at_any_alpha = ("log10_re_onset", "width", "factor")
    names = (*at_any_alpha, "alpha_sens")
    onsets = np.quantile(flown["log10_re"], np.linspace(0.05, 0.98, 14))
    starts = [
        {"log10_re_onset": float(x), "width": width, "spots": spots}
        for x in onsets
        for width, spots in ((0.02, 0.0), (0.1, 0.0), (0.1, 1.0))
    ]
    return [
        *(SearchStart(at_any_alpha, start | {"alpha_sens": 0.0}) for start in starts),
        *(SearchStart(names, start | {"alpha_sens": 0.01}) for start in starts),
    ]


EFFECT = Effect(
    name="transition",
    mode="multiply",
    parameters=(
        Parameter(
            "log10_re_onset", "1", 6.7, 0.4, 4.0, 9.0, "log10 Re of half the rise, with spots of its start, at alpha_0"
        ),
        Parameter("alpha_sens", "1/deg", 0.0, 0.05, -0.5, 0.5, "fall of the onset log10 Re with angle of attack"),
        Parameter("width", "1", 0.03, 0.03, 1e-4, 1.0, "width of the rise in log10 Re"),
        Parameter("factor", "1", 3.5, 1.0, 1.0, 20.0, "turbulent over laminar heating ratio"),
        Parameter("alpha_0_deg", "deg", 40.0, 0.0, -90.0, 90.0, "angle of attack of the onset"),
        Parameter("spots", "1", 0.0, 0.0, 0.0, 1.0, "1 for the form of turbulent spots, which begins at the onset"),
    ),
    kernel=transition_factor,
    needs=("log10_re",),
    neutral={"factor": 1.0},
    search_starts=search_starts,
    physics="The boundary layer turns turbulent past a Reynolds number, earlier at higher angle of attack.",
    source="STS-4 Mach 12 manoeuvre in 'Trends in Shuttle Entry Heating from the Correlation of Flight Test "
    "Maneuvers'; spots: Dhawan & Narasimha, J. Fluid Mech. 3 (1958) 418",
)
