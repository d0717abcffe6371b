"""Flow impingement above an onset angle of attack, as on the side of the OMS pod."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import Conditions
from sim_heating.base.kernels.block import ALPHA
from sim_heating.base.kernels.jit import njit
from sim_heating.base.parameters import Parameter
from sim_heating.heating.effects import Effect, Try

ONSET, SLOPE = range(2)


@njit
def impingement(B: FloatArray, c: int, p: int, wall_K: float) -> float:
    """slope max(0, alpha - alpha_onset) [-], added to the ratio."""
    return B[p + SLOPE] * max(0.0, B[c + ALPHA] - B[p + ONSET])


def tries(flown: Conditions) -> Sequence[Try]:
    """Onsets spread over the angles of attack flown, no rise yet."""
    onsets = np.quantile(flown["alpha_deg"], [0.3, 0.6, 0.8, 0.9, 0.96, 0.99])
    return [Try(("alpha_onset_deg", "slope"), {"alpha_onset_deg": float(x)}) for x in onsets]


EFFECT = Effect(
    name="impingement-onset",
    mode="add",
    parameters=(
        Parameter(
            "alpha_onset_deg", "deg", 37.0, 4.0, 0.0, 60.0, "angle of attack at which the flow reaches the point"
        ),
        Parameter("slope", "1/deg", 0.002, 0.002, -0.1, 0.1, "rise of the ratio above it"),
    ),
    kernel=impingement,
    neutral={"slope": 0.0},
    tries=tries,
    physics="Above an angle of attack the flow impinges on the point and the ratio rises with angle of attack.",
    source="OMS pod of STS-2, fig. 14 of 'Trends in Shuttle Entry Heating from the Correlation of Flight Test ...'",
)
