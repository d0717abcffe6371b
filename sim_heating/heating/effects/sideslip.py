"""Sideslip: heating grows with the magnitude of the sideslip angle, for both signs, equally or leaning to one."""

from __future__ import annotations

from collections.abc import Sequence

from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import Conditions
from sim_heating.base.kernels.jit import njit
from sim_heating.base.parameters import Parameter
from sim_heating.heating.effects import Effect, SearchStart, flight

SLOPE, CURVATURE, LEAN = range(3)


@njit
def sideslip_ratio(B: FloatArray, c: int, p: int, wall_K: float) -> float:
    """Ratio that sideslip adds [-].

        f = slope |beta| + d_beta2 beta^2 + lean beta

    B       : block of the lane group; B[c] flight conditions with beta [deg], B[p] slope [1/deg], d_beta2 [1/deg2],
              lean [1/deg]
    wall_K  : wall temperature [K], not used

    Source: the observation, NASA TM-86032 and the founding paper; the form, docs/reference/effects.md, equation 21.
    """
    beta = B[c + flight.beta_deg]
    return B[p + SLOPE] * abs(beta) + B[p + CURVATURE] * beta * beta + B[p + LEAN] * beta


def search_starts(flown: Conditions) -> Sequence[SearchStart]:
    """Search starts for sideslip (docs/reference/effects.md, equation 21), beta in [deg]: |beta| or beta^2 alone,
    |beta| with a lean to one side."""
    return [SearchStart(("slope_abs_beta",)), SearchStart(("d_beta2",)), SearchStart(("slope_abs_beta", "lean"))]


EFFECT = Effect(
    name="sideslip",
    mode="add",
    parameters=(
        Parameter("slope_abs_beta", "1/deg", 0.0, 0.01, -1.0, 1.0, "rise of the ratio with the magnitude of beta"),
        Parameter("d_beta2", "1/deg2", 0.0, 0.01, -1.0, 1.0, "rise of the ratio with beta^2"),
        Parameter("lean", "1/deg", 0.0, 0.01, -1.0, 1.0, "rise of the ratio with beta, by which its two sides differ"),
    ),
    kernel=sideslip_ratio,
    needs=("beta_deg",),
    search_starts=search_starts,
    physics="A vortex or an attachment line moves onto a point with sideslip of either sign.",
    source="Sideslip on OMS pods and side fuselage: founding paper; NASA TM-86032",
)
