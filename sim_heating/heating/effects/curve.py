"""Curve: a smooth factor on the heating ratio against one variable, of no physical form; the candidate of last resort.

    f = 1 + s(v),    s a cubic spline through its values at seven even knots from `low` to `high`, constant outside

The slope at a knot is that of the parabola through it and its neighbours, so that s is smooth, local and linear in its
values. The prior of every value is 0 with a standard deviation of SCATTER: where a flight does not inform it, the curve
returns to 1. docs/reference/effects.md, equation 29.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import Conditions
from sim_heating.base.errors import InputError
from sim_heating.base.kernels.jit import njit
from sim_heating.base.parameters import Parameter
from sim_heating.heating.effects import Effect, SearchStart, flight

CURVE = "curve"
"""Name of the effect."""
KNOTS = 7
"""Number of knots: with fewer a kink is lost, with more a flight seldom informs them."""
VARIABLE, LOW, HIGH, FIRST = range(4)
SCATTER = 0.2
"""Standard deviation of the prior of a value [-]."""
VARIABLES = ("alpha_deg", "log10_re", "elevon_deg", "bodyflap_deg", "beta_deg", "wall_K", "time_s")
"""Variables in the order of their number, the value of `variable`."""
UNITS = ("deg", "1", "deg", "deg", "deg", "K", "s")
"""Unit of each variable."""
LABELS = (
    "angle of attack",
    "log10 of the Reynolds number",
    "elevon deflection",
    "body-flap deflection",
    "sideslip angle",
    "wall temperature",
    "time",
)
"""Each variable in words."""
ALPHA, LOG10_RE, ELEVON, BODYFLAP, BETA, WALL, TIME = range(len(VARIABLES))
HOT = 0.1
"""Heating of a cold wall, over the largest of the flight, from which on the knots have to reach."""
LEAST_RANGE = (0.5, 0.05, 0.5, 0.5, 0.5, 50.0, 20.0)
"""Range of each variable, in its unit, below which it cannot carry a curve."""
WALL_RANGE_K = (300.0, 1700.0)
"""Wall temperatures of the knots, 233 K apart [K]: those of reusable walls."""


@njit
def spline(B: FloatArray, p: int, u: float, level_ends: bool) -> float:
    """The spline [-] at u = (v - low) / (high - low) (KNOTS - 1), constant below 0 and above KNOTS - 1.

    B, p : the values at the knots are B[p + FIRST] and those behind it
    level_ends : whether it is level at the ends; else it has the slope there of the parabola through three knots
    Between two knots it is Hermite's cubic with the slopes of the parabolas through three knots (Catmull and Rom 1974).
    """
    last = KNOTS - 1.0
    # In this order a place that is no number becomes 0: it is to be an index.
    u = u if u > 0.0 else 0.0
    u = u if u < last else last
    i = min(int(u), KNOTS - 2)
    x, y = u - i, p + FIRST + i
    a, b = B[y], B[y + 1]
    slope_a, slope_b = 0.0, 0.0
    if i > 0:
        slope_a = 0.5 * (b - B[y - 1])
    elif not level_ends:
        slope_a = -1.5 * a + 2.0 * b - 0.5 * B[y + 2]
    if i < KNOTS - 2:
        slope_b = 0.5 * (B[y + 2] - a)
    elif not level_ends:
        slope_b = 1.5 * b - 2.0 * a + 0.5 * B[y - 1]
    rest = 1.0 - x
    return a * rest * rest * (1.0 + 2.0 * x) + b * x * x * (3.0 - 2.0 * x) + x * rest * (slope_a * rest - slope_b * x)


@njit
def knot_place(B: FloatArray, c: int, p: int, wall_K: float) -> float:
    """Where the present conditions lie among the knots of a curve, u = (v - low) / (high - low) (KNOTS - 1) [-].

    B       : block of the lane group; B[c] flight conditions, B[p] number of the variable, low, high, values of s [-]
    wall_K  : wall temperature [K], the variable where its number is WALL

    An empirical form, docs/reference/effects.md, equation 29.
    """
    number = B[p + VARIABLE]
    if number == ALPHA:
        v = B[c + flight.alpha_deg]
    elif number == LOG10_RE:
        v = B[c + flight.log10_re]
    elif number == ELEVON:
        v = B[c + flight.elevon_deg]
    elif number == BODYFLAP:
        v = B[c + flight.bodyflap_deg]
    elif number == BETA:
        v = B[c + flight.beta_deg]
    elif number == WALL:
        v = wall_K
    else:
        v = B[c + flight.time_s]
    return (v - B[p + LOW]) / (B[p + HIGH] - B[p + LOW]) * (KNOTS - 1.0)


@njit
def curve_factor(B: FloatArray, c: int, p: int, wall_K: float) -> float:
    """Factor of a curve on the heating ratio [-], f = 1 + s(v), not below 0.

    B, c, p, wall_K : as in `knot_place`

    An empirical form, docs/reference/effects.md, equation 29.
    """
    return max(1.0 + spline(B, p, knot_place(B, c, p, wall_K), True), 0.0)


def search_starts(flown: Conditions) -> Sequence[SearchStart]:
    """Search starts for a curve (docs/reference/effects.md, equation 29), still equal to 1.

    flown   : conditions of the flight
    returns : one for each variable that varies, with knots over its range while the flight heats, in its unit; wall
              temperatures of 300 to 1700 [K]; time last
    """
    heating = flown["h_ref_kg_m2_s"] * flown["H_r_J_kg"]
    hot, starts = heating >= HOT * np.max(heating), []
    for number, name in enumerate(VARIABLES):
        if number == WALL:
            low, high = WALL_RANGE_K
        elif number == TIME:
            low, high = float(flown.time_s[hot][0]), float(flown.time_s[hot][-1])
        elif name in flown:
            low, high = float(np.min(flown[name][hot])), float(np.max(flown[name][hot]))
        else:
            continue
        if high - low >= LEAST_RANGE[number]:
            values = {"variable": float(number), "low": low, "high": high}
            starts.append(SearchStart(VALUES, values))
    return starts


VALUES = tuple(f"s_{k + 1}" for k in range(KNOTS))
"""Names of the values at the knots."""

PLACE = (
    Parameter("variable", "1", 0.0, 0.0, 0.0, len(VARIABLES) - 1.0, f"number of the variable: {', '.join(VARIABLES)}"),
    Parameter("low", "1", 30.0, 0.0, -1e5, 1e5, "first knot, in the unit of the variable"),
    Parameter("high", "1", 45.0, 0.0, -1e5, 1e5, "last knot"),
)
"""Parameters of a curve that are not estimated."""


def value_parameters(sigma: float, lower: float, upper: float, text: str) -> tuple[Parameter, ...]:
    """Parameters of the values at the knots [-]; sigma, lower, upper : of each;  text : what a value is.

    Source: docs/reference/effects.md, equation 29.
    """
    return tuple(Parameter(n, "1", 0.0, sigma, lower, upper, f"{text} at knot {k + 1}") for k, n in enumerate(VALUES))


EFFECT = Effect(
    name=CURVE,
    mode="multiply",
    parameters=(*PLACE, *value_parameters(SCATTER, -0.95, 5.0, "relative change of the ratio")),
    kernel=curve_factor,
    needs_wall=True,
    neutral=dict.fromkeys(VALUES, 0.0),
    search_starts=search_starts,
    last_resort=True,
    physics="None: what a residual follows, where no form of the other effects explains it.",
    source="Catmull & Rom, in Computer Aided Geometric Design (1974) 317",
)


@dataclass(frozen=True, eq=False, repr=False)
class CurveBand:
    """A fitted curve with its band.

    variable : column or `wall_K`;  label : in words;  unit : of the variable
    at       : (point,) values of the variable, in its unit
    value    : (point,) relative change of the heating ratio s [-];  sigma : (point,) its standard deviation [-]
    """

    variable: str
    label: str
    unit: str
    at: FloatArray
    value: FloatArray
    sigma: FloatArray

    def __repr__(self) -> str:
        return f"<CurveBand against {self.label}: {np.min(self.value):+.3f} to {np.max(self.value):+.3f}>"


def curve_band(
    values: Sequence[float], covariance: npt.ArrayLike, at: npt.ArrayLike | None = None, about: float | None = None
) -> CurveBand:
    """A fitted curve and its standard deviation along its variable.

        s(v) = w(v) . s_knots,    sigma(v)^2 = w^T C w

    values     : all parameters of the effect in their order, the estimated ones at their estimates
    covariance : (KNOTS, KNOTS) covariance of the values at the knots [-]
    at         : (point,) values of the variable, in its unit; by default the knots
    about      : value of the variable at which the curve is to be 0: w(v) - w(about) takes the place of w(v). The level
                 of a curve is also that of the table's magnitude, and so known less well than its shape
    raises     : InputError where a shape is wrong, or the covariance is not one of finite numbers

    The spline is linear in its values, so that the band is exact for a normal distribution of them.

    Source: docs/reference/effects.md, equation 29.
    """
    B, C = np.asarray(values, dtype=float), np.asarray(covariance, dtype=float)
    if B.shape != (FIRST + KNOTS,) or C.shape != (KNOTS, KNOTS) or not np.all(np.isfinite(C)):
        raise InputError(
            f"curve: {len(B)} values and a covariance of shape {C.shape}; it takes {FIRST + KNOTS} values and a finite "
            f"covariance of shape ({KNOTS}, {KNOTS})"
        )
    low, high, number = B[LOW], B[HIGH], int(B[VARIABLE])
    v = np.linspace(low, high, KNOTS) if at is None else np.asarray(at, dtype=float)
    unit_values = np.column_stack([np.zeros((KNOTS, FIRST)), np.eye(KNOTS)])
    w = np.array([[spline(row, 0, (x - low) / (high - low) * (KNOTS - 1.0), True) for row in unit_values] for x in v])
    if about is not None:
        w -= [spline(row, 0, (about - low) / (high - low) * (KNOTS - 1.0), True) for row in unit_values]
    sigma = np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", w, C, w), 0.0))
    return CurveBand(VARIABLES[number], LABELS[number], UNITS[number], v, w @ B[FIRST:], sigma)
