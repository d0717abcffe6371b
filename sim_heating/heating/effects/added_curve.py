"""Added curve: a smooth addition to the heating ratio against one variable, of no physical form.

    f = s(v),    the spline of `curve` (curve.py) as a ratio of its own, with the slopes of parabolas at its ends too

What deflections, sideslip and impinging flow add to a ratio follows neither the ratio nor a form that is known in
advance. `close-loop` fits it where the form of such an effect explains most of a residual, and not all of it.
docs/reference/effects.md, equation 29.
"""

from __future__ import annotations

from sim_heating.base.arrays import FloatArray
from sim_heating.base.kernels.jit import njit
from sim_heating.heating.effects import Effect
from sim_heating.heating.effects.curve import PLACE, VALUES, knot_place, search_starts, spline, value_parameters

ADDED_CURVE = "added-curve"
"""Name of the effect."""


@njit
def added_curve_ratio(B: FloatArray, c: int, p: int, wall_K: float) -> float:
    """Ratio that a curve adds [-], f = s(v).

    B       : block of the lane group; B[c] flight conditions, B[p] number of the variable, low, high, values of s [-]
    wall_K  : wall temperature [K], the variable where its number is that

    An empirical form, docs/reference/effects.md, equation 29.
    """
    return spline(B, p, knot_place(B, c, p, wall_K), False)


EFFECT = Effect(
    name=ADDED_CURVE,
    mode="add",
    parameters=(*PLACE, *value_parameters(0.05, -2.0, 2.0, "addition to the ratio")),
    kernel=added_curve_ratio,
    needs_wall=True,
    neutral=dict.fromkeys(VALUES, 0.0),
    search_starts=search_starts,
    last_resort=True,
    physics="None: what an effect on the ratio adds where its form differs from those of the library.",
    source="Catmull & Rom, in Computer Aided Geometric Design (1974) 317",
)
