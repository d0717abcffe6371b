"""Boundary-layer transition: past a Reynolds number, which falls with angle of attack, heating turns turbulent."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import Conditions
from sim_heating.base.kernels import block
from sim_heating.base.kernels.elementary import exp, logistic
from sim_heating.base.kernels.jit import njit
from sim_heating.base.parameters import Parameter
from sim_heating.heating.effects import Effect, SearchStart, flight

TRANSITION = "transition"
"""Name of the effect; a point with it takes its recovery enthalpy by intermittency (heating/film.py)."""
ONSET, ALPHA_SENSITIVITY, WIDTH, FACTOR, ALPHA_0, SPOTS, BY_TABLE, BY_RE_THETA, HYSTERESIS = range(9)
FALLS_WITH_ALPHA, SMALLEST_HYSTERESIS = 0.02, 0.05
"""Sensitivity to angle of attack [1/deg] and fall back towards an onset [-] from which on hysteresis is looked for."""
NARASIMHA = 0.412
"""Constant of the intermittency 1 - exp(-0.412 x^2) [-], with which `width` is the distance between a quarter and three
quarters of the rise (Dhawan and Narasimha 1958)."""


@njit
def past_onset_now(B: FloatArray, c: int, p: int) -> float:
    """Distance past the onset, y = log10_re - onset + alpha_sens (alpha - alpha_0) [-], hysteresis apart.

    log10(Re_theta / M_e) takes the place of log10_re where `by_re_theta` is 1.
    B       : block of the lane group; B[c] flight conditions with alpha [deg] and log10_re [-], B[p] the parameters
    Source: docs/reference/effects.md, equation 23.
    """
    at = B[c + flight.log10_re]
    if B[p + BY_RE_THETA] != 0.0:
        at = B[c + flight.log10_re_theta_m]
    return at - B[p + ONSET] + B[p + ALPHA_SENSITIVITY] * (B[c + flight.alpha_deg] - B[p + ALPHA_0])


@njit
def held_past(before: float, now: float, hysteresis: float) -> float:
    """Distance past the onset with hysteresis [-]: that of the play operator, z = min(max(z, y), y + hysteresis).

    before     : z at the start of the step;  now : y, without hysteresis
    hysteresis : by how much the flow turns laminar again below the onset at which it turned turbulent, 0 or above
    Exact where y rises or falls all through the step. Source: Visintin, Differential Models of Hysteresis (1994),
    sec. III.2; docs/reference/effects.md, equation 24a.
    """
    return min(max(before, now), now + hysteresis)


@njit
def past_onset(B: FloatArray, c: int, p: int) -> float:
    """Distance past the onset [-] at the stage whose conditions begin at B[c], hysteresis included.

    Its value at the start of the step is read where heating/film.py keeps it; a march begins without hysteresis.
    Source: docs/reference/effects.md, equation 24a.
    """
    now, hysteresis = past_onset_now(B, c, p), B[p + HYSTERESIS]
    if hysteresis <= 0.0:
        return now
    lane = (c - block.C_STAGES * block.LANES) // block.N_CONDITIONS % block.LANES
    if B[block.LAG_PAST * block.LANES + lane] == 0.0:
        return now
    return held_past(B[block.PAST_ONSET * block.LANES + lane], now, hysteresis)


@njit
def turbulent_part(B: FloatArray, p: int, past: float) -> float:
    """Fraction of the time that the flow is turbulent at a distance past the onset, from 0 (laminar) to 1.

        Gamma = (1 - spots) / (1 + exp(-x)) + spots (1 - exp(-0.412 max(x, 0)^2)),    x = past / width

    B, p    : the parameters are B[p] and those behind it;  past : distance past the onset [-]
    returns : Gamma [-]

    Source: `spots`, Dhawan and Narasimha (1958), J. Fluid Mech. 3, 418, there in distance; docs/reference/effects.md,
    equations 23 and 24.
    """
    x = past / B[p + WIDTH]
    turbulent = logistic(x)
    if B[p + SPOTS] > 0.0:
        from_onset = max(x, 0.0)
        turbulent += B[p + SPOTS] * (1.0 - exp(-NARASIMHA * from_onset * from_onset) - turbulent)
    return turbulent


@njit
def intermittency(B: FloatArray, c: int, p: int) -> float:
    """Fraction of the time that the flow is turbulent [-] under flight conditions, hysteresis included.

    B       : block of the lane group; B[c] flight conditions with alpha [deg] and log10_re [-], B[p] the parameters
    Source: docs/reference/effects.md, equations 23 to 24a.
    """
    return turbulent_part(B, p, past_onset(B, c, p))


@njit
def transition_factor(B: FloatArray, c: int, p: int, wall_K: float) -> float:
    """Factor of boundary-layer transition on the heating ratio [-], from 1 (laminar) to turbulent over laminar.

        f = 1 + (F - 1) Gamma,    F = factor (1 + by_table (r_turbulent / r_laminar - 1))

    B       : block of the lane group; B[c] flight conditions with the ratio of the tables [-], B[p] the parameters
    wall_K  : wall temperature [K], not used
    returns : factor [-]; Gamma is that of `intermittency`

    Source: docs/reference/effects.md, equation 23.
    """
    turbulent = B[p + FACTOR]
    turbulent *= 1.0 + B[p + BY_TABLE] * (B[c + flight.turbulent_ratio] - 1.0)
    return 1.0 + (turbulent - 1.0) * intermittency(B, c, p)


def search_starts(flown: Conditions) -> Sequence[SearchStart]:
    """Search starts for transition (docs/reference/effects.md, equations 23 and 24), still laminar.

    flown   : conditions of the flight
    returns : onsets at 14 quantiles of the log10 Reynolds number flown [-], in either form, first independent of angle
              of attack: a flight that crosses its onset once cannot separate alpha_sens from the onset; seven with
              hysteresis, where the flight could turn laminar again; seven in log10 (Re_theta / M_e), where it is known
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
        *_with_hysteresis(flown, onsets[::2]),
        *_by_re_theta(flown),
    ]


def _with_hysteresis(flown: Conditions, onsets: FloatArray) -> Sequence[SearchStart]:
    """Starts with hysteresis at these onsets [-]; none where the flight never falls back towards its onset."""
    towards = flown["log10_re"] + FALLS_WITH_ALPHA * flown["alpha_deg"]
    if not np.max(np.maximum.accumulate(towards) - towards, initial=0.0) > SMALLEST_HYSTERESIS:
        return []
    names = ("log10_re_onset", "width", "factor", "alpha_sens", "hysteresis")
    rest = {"width": 0.02, "alpha_sens": 0.01, "hysteresis": 0.05}
    return [SearchStart(names, {"log10_re_onset": float(x)} | rest) for x in onsets]


def _by_re_theta(flown: Conditions) -> Sequence[SearchStart]:
    """Starts with an onset in log10 (Re_theta / M_e) [-]; none where the conditions do not have it."""
    if "log10_re_theta_m" not in flown or not np.ptp(flown["log10_re_theta_m"]) > 0.0:
        return []
    onsets = np.quantile(flown["log10_re_theta_m"], np.linspace(0.05, 0.98, 7))
    rest = {"width": 0.05, "by_re_theta": 1.0, "alpha_sens": 0.0}
    return [SearchStart(("log10_re_onset", "width", "factor"), {"log10_re_onset": float(x)} | rest) for x in onsets]


EFFECT = Effect(
    name=TRANSITION,
    mode="multiply",
    parameters=(
        Parameter(
            "log10_re_onset", "1", 6.7, 0.4, 1.0, 9.0, "log10 Re of half the rise, with spots of its start, at alpha_0"
        ),
        Parameter("alpha_sens", "1/deg", 0.0, 0.05, -0.5, 0.5, "fall of the onset log10 Re with angle of attack"),
        Parameter("width", "1", 0.03, 0.03, 1e-4, 1.0, "width of the rise in log10 Re"),
        Parameter("factor", "1", 3.5, 1.0, 0.1, 20.0, "turbulent over laminar heating ratio"),
        Parameter("alpha_0_deg", "deg", 40.0, 0.0, -90.0, 90.0, "angle of attack of the onset"),
        Parameter("spots", "1", 0.0, 0.0, 0.0, 1.0, "1 for the form of turbulent spots, which begins at the onset"),
        Parameter("by_table", "1", 0.0, 0.0, 0.0, 1.0, "1 where `factor` is on the turbulent over laminar table"),
        Parameter("by_re_theta", "1", 0.0, 0.0, 0.0, 1.0, "1 where the onset is one of log10 (Re_theta / M_e)"),
        Parameter("hysteresis", "1", 0.0, 0.1, 0.0, 1.0, "by how much it turns laminar again below its onset"),
    ),
    kernel=transition_factor,
    remembers=True,
    needs=("log10_re",),
    neutral={"factor": 1.0},
    search_starts=search_starts,
    # A declared one may heat less than its table; what is looked for as transition heats more.
    search_bounds={"factor": (1.0, 12.0), "alpha_sens": (-0.1, 0.2), "width": (1e-3, 0.5)},
    of_flow=("log10_re_onset", "alpha_sens", "width", "hysteresis"),
    physics="The boundary layer turns turbulent past a Reynolds number, earlier at higher angle of attack; it may turn "
    "laminar again at a lower one.",
    source="STS-4 Mach 12 manoeuvre in 'Trends in Shuttle Entry Heating from the Correlation of Flight Test "
    "Maneuvers'; spots: Dhawan & Narasimha, J. Fluid Mech. 3 (1958) 418",
)
