"""Sideslip: heating grows with its magnitude, on whichever side the wind comes from."""

from __future__ import annotations

from collections.abc import Sequence

from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import Conditions
from sim_heating.base.kernels.block import BETA
from sim_heating.base.kernels.jit import njit
from sim_heating.base.parameters import Parameter
from sim_heating.heating.effects import Effect, Try

SLOPE, CURVATURE = range(2)


@njit
def added_by_sideslip(B: FloatArray, c: int, p: int, wall_K: float) -> float:
    """slope |beta| + d_beta2 beta^2 [-]."""
    return B[p + SLOPE] * abs(B[c + BETA]) + B[p + CURVATURE] * B[c + BETA] * B[c + BETA]


def tries(flown: Conditions) -> Sequence[Try]:
    """One form at a time."""
    return [Try(("slope_abs_beta",)), Try(("d_beta2",))]


EFFECT = Effect(
    name="sideslip",
    mode="add",
    parameters=(
        Parameter("slope_abs_beta", "1/deg", 0.0, 0.01, -1.0, 1.0, "rise of the ratio with |beta|"),
        Parameter("d_beta2", "1/deg2", 0.0, 0.01, -1.0, 1.0, "and with beta^2"),
    ),
    kernel=added_by_sideslip,
    tries=tries,
    physics="A vortex or an attachment line moves onto a point with sideslip of either sign.",
    source="Sideslip on OMS pods and side fuselage: founding paper; NASA TM-86032",
)
