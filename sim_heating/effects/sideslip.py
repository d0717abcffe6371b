"""Sideslip: heating grows with its magnitude, on whichever side the wind comes from."""

from __future__ import annotations

from sim_heating.conditions import FloatArray
from sim_heating.effects import Effect
from sim_heating.jit import njit
from sim_heating.layout import BETA
from sim_heating.parameters import Parameter

SLOPE = 0


@njit
def added_by_sideslip(B: FloatArray, c: int, p: int, wall_K: float) -> float:
    """slope |beta| [-]."""
    return B[p + SLOPE] * abs(B[c + BETA])


EFFECT = Effect(
    name="sideslip",
    mode="add",
    parameters=(Parameter("slope_abs_beta", "1/deg", 0.0, 0.01, -1.0, 1.0, "rise of the ratio with |beta|"),),
    kernel=added_by_sideslip,
    physics="A vortex or an attachment line moves onto a point with sideslip of either sign.",
    source="Sideslip on OMS pods and side fuselage: founding paper; NASA TM-86032",
)
