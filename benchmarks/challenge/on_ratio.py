"""Effects on the heating ratio: histories of conditions, controls, jets and time. x is the variable that drives one.

transition          1 + (factor - 1) g(s), s = log10_re - onset + alpha_sens (alpha - 40):
                    logistic | sharp | intermittency 1 - exp(-0.412 s^2) | erf | hysteresis (back at onset - gap)
                    | re-theta (s falls with Mach / 20) | peaked (overshoots by a third just after onset)
impingement-onset   slope f(alpha - onset): ramp | soft | saturating | root | step of a plateau
*-curvature         d2 x^2 | cosh | skewed | kink d2 |x| * 4 deg
interaction         d x y | saturating | one-sided (x y where x > 0)
sideslip            slope |beta| | rounded | quadratic | windward (one side alone)
nonisothermal-wall  lag of the ratio and a decaying overshoot: first | second order | dead time | power decay
jet-interaction     1 + gain jets | with a tail | proportional to 1 / q | only with alpha above its mean
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import erf, expit

from benchmarks.challenge.case import Case, History
from benchmarks.challenge.deviation import Deviation
from benchmarks.challenge.form import Family, Generator, Parameters, Unsuitable, sign
from benchmarks.challenge.point import FELTS, FLAPS, OWN, TILES

FloatArray = NDArray[np.float64]

ALPHA, BETA, LOG_RE, ELEVON, FLAP = range(5)
LOWER = (*TILES, *FLAPS, "own-plug")
STEP = 1.0


def departure(history: History, variable: int) -> FloatArray:
    """A variable less its reference condition."""
    return np.asarray(history.x[variable] - history.case.ratio.reference[variable])


def spread(case: Case, variable: int) -> FloatArray:
    """A variable while the vehicle is hot."""
    history = case.at(STEP)
    return np.asarray(history.x[variable][history.hot])


# Transition ----------------------------------------------------------------------------------------------------------


def _draw_transition(rng: Generator, case: Case, form: str) -> dict[str, Any]:
    history = case.at(STEP)
    hot = np.flatnonzero(history.hot)
    at = hot[int(rng.uniform(0.4, 0.85) * (len(hot) - 1))]
    drawn = {
        "log10_re_onset": float(history.x[LOG_RE, at]),
        "alpha_sens": float(rng.choice([0.0, rng.uniform(0.0, 0.03)])),
        "factor": float(rng.uniform(1.4, 4.0)),
    }
    if form != "sharp":
        drawn["width"] = float(rng.uniform(0.008, 0.06))
    if form == "hysteresis":
        drawn["gap"] = float(rng.uniform(0.02, 0.1))
    return drawn


def _transition(history: History, form: str, p: Parameters) -> Deviation:
    s = history.x[LOG_RE] - p["log10_re_onset"] + p["alpha_sens"] * (history.x[ALPHA] - 40.0)
    if form == "re-theta":
        mach = history.columns["mach"]
        s = s - 0.5 * np.log10(mach / float(np.interp(p["log10_re_onset"], history.x[LOG_RE], mach)))
    w = p.get("width", 0.01)
    if form == "sharp":
        g = (s > 0.0).astype(float)
    elif form == "intermittency":
        g = -np.expm1(-0.412 * (np.maximum(s, 0.0) / w) ** 2)
    elif form == "erf":
        g = 0.5 * (1.0 + erf(s / (2.0 * w)))
    elif form == "hysteresis":
        g = relay(expit(s / w), expit((s + p["gap"]) / w))
    elif form == "peaked":
        g = expit(s / w) * (1.0 + 0.33 * np.exp(-np.maximum(s, 0.0) / (4.0 * w)))
    else:
        g = expit(np.clip(s / w, -60.0, 60.0))
    return Deviation(multiply=1.0 + (p["factor"] - 1.0) * g)


def relay(up: FloatArray, down: FloatArray) -> FloatArray:
    """The lower branch while it rises, the upper one on the way back."""
    found, state = np.empty_like(up), 0.0
    for i in range(len(up)):
        state = min(max(state, up[i]), down[i])
        found[i] = state
    return found


# Angle of attack, deflections, sideslip -----------------------------------------------------------------------------


def _draw_impingement(rng: Generator, case: Case, form: str) -> dict[str, Any]:
    alpha = spread(case, ALPHA)
    middle, top = float(np.median(alpha)), float(np.max(alpha))
    if top - middle < 1.5:
        raise Unsuitable
    onset = float(middle + rng.uniform(-0.4, 0.6) * (top - middle))
    return {
        "alpha_onset_deg": onset,
        "slope": float(case.r_0 * rng.uniform(0.01, 0.1)),
        "blend_deg": float(rng.uniform(0.3, 1.2)),
    }


def _impingement(history: History, form: str, p: Parameters) -> Deviation:
    past, w = history.x[ALPHA] - p["alpha_onset_deg"], p["blend_deg"]
    above = np.maximum(past, 0.0)
    rise = {
        "ramp": above,
        "soft": w * np.logaddexp(0.0, past / w),
        "saturating": 5.0 * w * np.tanh(above / (5.0 * w)),
        "root": 2.0 * np.sqrt(above),
        "plateau": 3.0 * expit(past / (0.3 * w)),
    }[form]
    return Deviation(add=p["slope"] * rise)


def _curvature(name: str, variable: int, needs: str, points: tuple[str, ...]) -> Family:
    key = {ALPHA: "d_alpha2", ELEVON: "d_elevon2", FLAP: "d_bodyflap2"}[variable]

    def draw(rng: Generator, case: Case, form: str) -> dict[str, Any]:
        if np.ptp(spread(case, variable)) < 4.0:
            raise Unsuitable
        return {
            key: float(sign(rng) * case.r_0 * rng.uniform(0.001, 0.008)),
            "scale_deg": float(rng.uniform(5.0, 14.0)),
        }

    def act(history: History, form: str, p: Parameters) -> Deviation:
        x, s = departure(history, variable), p["scale_deg"]
        if form == "cosh":
            return Deviation(add=p[key] * 2.0 * s * s * (np.cosh(np.clip(x / s, -1.5, 1.5)) - 1.0))
        if form == "skewed":
            return Deviation(add=p[key] * x * x * (1.0 + 0.3 * np.tanh(x / s)))
        return Deviation(add=p[key] * (4.0 * np.abs(x) if form == "kink" else x * x))

    # |x| = 2 max(x, 0) - x, and a slope of the table takes up -x
    same = {"kink": "impingement-onset"} if variable == ALPHA else {}
    forms = ("quadratic", "cosh", "skewed", "kink")
    return Family(name, forms, draw, act, {key: (0.0, -0.05, 0.05)}, (needs,), points, same=same)


PRODUCTS = {"d_alpha_elevon": (ALPHA, ELEVON), "d_alpha_bodyflap": (ALPHA, FLAP), "d_elevon_bodyflap": (ELEVON, FLAP)}


def _draw_interaction(rng: Generator, case: Case, form: str) -> dict[str, Any]:
    key = str(rng.choice(list(PRODUCTS)))
    return {key: float(sign(rng) * case.r_0 * rng.uniform(0.001, 0.008)), "scale_deg2": float(rng.uniform(20.0, 50.0))}


def _interaction(history: History, form: str, p: Parameters) -> Deviation:
    key = next(k for k in PRODUCTS if k in p)
    x, y = (departure(history, v) for v in PRODUCTS[key])
    product = np.maximum(x, 0.0) * y if form == "one-sided" else x * y
    if form == "saturating":
        product = p["scale_deg2"] * np.tanh(product / p["scale_deg2"])
    return Deviation(add=p[key] * product)


def _draw_sideslip(rng: Generator, case: Case, form: str) -> dict[str, Any]:
    if np.max(np.abs(spread(case, BETA))) < 1.0:
        raise Unsuitable
    key = "d_beta2" if form == "quadratic" else "slope_abs_beta"
    return {key: float(sign(rng) * case.r_0 * rng.uniform(0.01, 0.06)), "round_deg": float(rng.uniform(0.2, 0.8))}


def _sideslip(history: History, form: str, p: Parameters) -> Deviation:
    beta, w = history.x[BETA], p["round_deg"]
    if form == "quadratic":
        return Deviation(add=p["d_beta2"] * beta * beta)
    shape = {"magnitude": np.abs(beta), "rounded": np.hypot(beta, w) - w, "windward": 2.0 * np.maximum(beta, 0.0)}[form]
    return Deviation(add=p["slope_abs_beta"] * shape)


# Lags and jets --------------------------------------------------------------------------------------------------------


def _draw_nonisothermal(rng: Generator, case: Case, form: str) -> dict[str, Any]:
    history = case.at(STEP)
    start = float(history.t[np.flatnonzero(history.hot)[0]] - rng.uniform(0.0, 50.0))
    return {
        "lag_s": float(rng.uniform(2.0, 9.0)),
        "lag_fraction": float(rng.uniform(0.4, 1.0)),
        "overshoot": float(rng.uniform(0.04, 0.3)),
        "decay_s": float(rng.uniform(80.0, 400.0)),
        "start_s": start,
    }


def _nonisothermal(history: History, form: str, p: Parameters) -> Deviation:
    r, tau = history.true_ratio, p["lag_s"]
    if form == "second-order":
        behind = history.lagged(history.lagged(r, 0.5 * tau), 0.5 * tau)
    elif form == "dead-time":
        behind = np.interp(history.t - tau, history.t, r)
    else:
        behind = history.lagged(r, tau)
    since = np.maximum(history.t - p["start_s"], 0.0) / p["decay_s"]
    decay = 1.0 / (1.0 + since) if form == "power" else np.exp(-since)
    return Deviation(add=p["lag_fraction"] * (behind - r), multiply=1.0 + p["overshoot"] * decay)


def _draw_jets(rng: Generator, case: Case, form: str) -> dict[str, Any]:
    history = case.at(STEP)
    if "jets" not in history.columns or float(np.sum(history.columns["jets"][history.hot])) < 6.0:
        raise Unsuitable
    return {"jet_gain": float(sign(rng) * rng.uniform(0.05, 0.4)), "tail_s": float(rng.uniform(1.5, 6.0))}


def _jets(history: History, form: str, p: Parameters) -> Deviation:
    jets = history.columns["jets"]
    if form == "tail":
        jets = np.maximum(jets, history.lagged(jets, p["tail_s"]))
    elif form == "over-q":
        q = history.columns["rho_kg_m3"] * history.columns["velocity_m_s"] ** 2
        jets = jets * float(np.mean(q[jets > 0.5])) / np.maximum(q, 1.0)
    return Deviation(multiply=1.0 + p["jet_gain"] * jets)


ON_RATIO = (
    Family(
        "transition",
        ("logistic", "sharp", "intermittency", "erf", "hysteresis", "re-theta", "peaked"),
        _draw_transition,
        _transition,
        {"factor": (1.0, 1.15, 5.0)},
        points=LOWER,
    ),
    Family(
        "impingement-onset",
        ("ramp", "soft", "saturating", "root", "plateau"),
        _draw_impingement,
        _impingement,
        {"slope": (0.0, 0.0, 0.05)},
        ("popu",),
        (*FELTS, *OWN, "V09T9527"),
    ),
    _curvature("alpha-curvature", ALPHA, "popu", ()),
    _curvature("elevon-curvature", ELEVON, "elevon", (*FLAPS, "own-plug", "LOWER_AFT")),
    _curvature("bodyflap-curvature", FLAP, "bodyflap", (*FLAPS, "LOWER_AFT")),
    Family(
        "interaction",
        ("product", "saturating", "one-sided"),
        _draw_interaction,
        _interaction,
        dict.fromkeys(PRODUCTS, (0.0, -0.02, 0.02)),
        ("popu", "bodyflap", "elevon"),
        (*FLAPS, "LOWER_AFT", "own-plug"),
    ),
    Family(
        "sideslip",
        ("magnitude", "rounded", "quadratic", "windward"),
        _draw_sideslip,
        _sideslip,
        {"slope_abs_beta": (0.0, -0.05, 0.05), "d_beta2": (0.0, -0.03, 0.03)},
        ("sideslip",),
    ),
    Family(
        "nonisothermal-wall",
        ("first-order", "second-order", "dead-time", "power"),
        _draw_nonisothermal,
        _nonisothermal,
        {"lag_s": (0.0, 0.5, 10.0), "overshoot": (0.0, 0.02, 0.4)},
        ("popu",),
        (*TILES, *FLAPS, *OWN),
    ),
    Family("jet-interaction", ("gain", "tail", "over-q"), _draw_jets, _jets, {"jet_gain": (0.0, -0.7, 1.5)}, ("jets",)),
)
