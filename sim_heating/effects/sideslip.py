"""Sideslip: heating grows with its magnitude, on whichever side the wind comes from."""

from __future__ import annotations

from collections.abc import Sequence

from sim_heating.conditions import Conditions, FloatArray
from sim_heating.effects import Effect
from sim_heating.jit import njit
from sim_heating.layout import BETA
from sim_heating.parameters import Parameter

SLOPE = 0


@njit
def added_by_sideslip(B: FloatArray, c: int, p: int, wall_K: float) -> float:
    """slope |beta| [-]."""
    return B[p + SLOPE] * abs(B[c + BETA])


def starts(flown: Conditions) -> Sequence[dict[str, float]]:
    """No dependence yet."""
    return [{"slope_abs_beta": 0.0}]


EFFECT = Effect(
    name="sideslip",
    mode="add",
    parameters=(Parameter("slope_abs_beta", "1/deg", 0.0, 0.01, -1.0, 1.0, "rise of the ratio with |beta|"),),
    kernel=added_by_sideslip,
    starts=starts,
    physics="A vortex or an attachment line moves onto a point with sideslip of either sign.",
    source="Sideslip on OMS pods and side fuselage: founding paper; NASA TM-86032",
)
