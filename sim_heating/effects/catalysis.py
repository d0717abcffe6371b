"""Surface recombination: a hotter wall is more catalytic and takes more heat than a cooler one."""

from __future__ import annotations

from collections.abc import Sequence

from sim_heating.arithmetic import logistic
from sim_heating.conditions import Conditions, FloatArray
from sim_heating.effects import Effect, Try
from sim_heating.jit import njit
from sim_heating.parameters import Parameter

STEP, MIDDLE_K, WIDTH_K = range(3)


@njit
def catalysis_factor(B: FloatArray, c: int, p: int, wall_K: float) -> float:
    """1 + step / (1 + exp(-(T_w - T_c) / width)) [-]."""
    return 1.0 + B[p + STEP] * logistic((wall_K - B[p + MIDDLE_K]) / B[p + WIDTH_K])


def tries(flown: Conditions) -> Sequence[Try]:
    """Rises at several wall temperatures, none yet."""
    names = ("catalysis_step", "catalysis_K", "catalysis_width_K")
    return [
        Try(names, {"catalysis_step": 0.0, "catalysis_K": T, "catalysis_width_K": width})
        for T in (500.0, 700.0, 900.0, 1100.0, 1300.0)
        for width in (60.0, 200.0)
    ]


EFFECT = Effect(
    name="catalysis",
    mode="multiply",
    parameters=(
        Parameter("catalysis_step", "1", 0.2, 0.2, -0.9, 3.0, "relative rise of the ratio from cold to hot wall"),
        Parameter("catalysis_K", "K", 1100.0, 150.0, 300.0, 2500.0, "wall temperature of half the rise"),
        Parameter("catalysis_width_K", "K", 60.0, 40.0, 1.0, 1000.0, "width of the rise"),
    ),
    kernel=catalysis_factor,
    needs_wall=True,
    tries=tries,
    physics="Recombination of atoms at the wall grows with its temperature and gives up the energy of dissociation.",
    source="Scott, 'Effects of nonequilibrium and wall catalysis on Shuttle heat transfer', in NASA CP-2283",
)
