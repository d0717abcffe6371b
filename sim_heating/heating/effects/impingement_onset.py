"""Flow impingement above an onset angle of attack, as on the side of the OMS pod."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import Conditions
from sim_heating.base.kernels.jit import njit
from sim_heating.base.parameters import Parameter
from sim_heating.heating.effects import Effect, SearchStart, flight

ONSET, SLOPE, SATURATION = range(3)


@njit
def impingement_ratio(B: FloatArray, c: int, p: int, wall_K: float) -> float:
    """Ratio that flow impingement adds above an onset angle of attack [-].

        f = slope x / (1 + saturation x),    x = max(0, alpha - alpha_onset)

    B       : block of the lane group; B[c] flight conditions with alpha [deg], B[p] alpha_onset [deg], slope [1/deg],
              saturation [1/deg]
    wall_K  : wall temperature [K], not used
    returns : what is added to the heating ratio [-]; its slope jumps at the onset

    Source: fig. 14 of the founding paper (onset at 37 deg in flight, OMS pod of STS-2); docs/reference/effects.md,
    equation 12.
    """
    x = max(0.0, B[c + flight.alpha_deg] - B[p + ONSET])
    return B[p + SLOPE] * x / (1.0 + B[p + SATURATION] * x)


def search_starts(flown: Conditions) -> Sequence[SearchStart]:
    """Search starts for flow impingement (docs/reference/effects.md, equation 12), with no rise yet.

    flown   : conditions of the flight
    returns : onsets at six quantiles, 0.3 to 0.99, of the angle of attack flown [deg], and at nine between the lowest
              and the highest: a flight that holds its angle of attack has all quantiles in one place; a ramp, and
              one that saturates
    """
    alpha = flown["alpha_deg"]
    quantiles = np.quantile(alpha, [0.3, 0.6, 0.8, 0.9, 0.96, 0.99])
    between = np.linspace(np.min(alpha), np.max(alpha), 11)[1:-1]
    onsets = np.unique(np.round(np.append(quantiles, between), 1))
    ramp, saturated = ("alpha_onset_deg", "slope"), ("alpha_onset_deg", "slope", "saturation")
    return [
        *(SearchStart(ramp, {"alpha_onset_deg": float(x)}) for x in onsets),
        *(SearchStart(saturated, {"alpha_onset_deg": float(x), "saturation": 0.5}) for x in onsets),
    ]


EFFECT = Effect(
    name="impingement-onset",
    mode="add",
    parameters=(
        Parameter(
            "alpha_onset_deg", "deg", 37.0, 4.0, 0.0, 60.0, "angle of attack at which the flow reaches the point"
        ),
        Parameter("slope", "1/deg", 0.002, 0.002, -0.1, 0.1, "rise of the ratio above it"),
        Parameter(
            "saturation", "1/deg", 0.0, 1.0, 0.0, 20.0, "by which the rise falls off: it ends at slope / saturation"
        ),
    ),
    kernel=impingement_ratio,
    needs=("alpha_deg",),
    neutral={"slope": 0.0},
    search_starts=search_starts,
    search_bounds={"slope": (0.0, 0.1)},  # flow that reaches a point heats it
    of_flow=("alpha_onset_deg",),
    physics="Above an angle of attack the flow impinges on the point and the ratio rises with angle of attack.",
    source="OMS pod of STS-2, fig. 14 of 'Trends in Shuttle Entry Heating from the Correlation of Flight Test ...'",
)
