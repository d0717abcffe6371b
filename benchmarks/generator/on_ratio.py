"""Effects on the heating ratio as histories: of conditions, controls, jets and time.

Several forms each; the first is the one of the record format's table. x is the history that drives it.

    transition         1 + (factor - 1) g,  g logistic | step | Dhawan & Narasimha's intermittency | random telegraph
    impingement-onset  slope f(alpha - alpha_onset),  f ramp | soft ramp | saturating | starting as a square
    curvature          d2 x^2 | d2 s^2 2 (cosh(x/s) - 1) | d2 x^2 (1 + tanh(x/s)/4)
    interaction        d x y | d s tanh(x y / s)
    sideslip           slope |beta| | slope (sqrt(beta^2 + w^2) - w) | d_beta2 beta^2
    nonisothermal-wall ratio behind a lag, first order | second order | dead time, and an overshoot that decays
    jet-interaction    1 + gain jets | with a tail | a derived density that the jets disturb
    unknown            sine | bumps | wander | chirp
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d
from scipy.signal import lfilter
from scipy.special import expit, ndtr

from benchmarks.challenge.deviation import Deviation
from benchmarks.challenge.form import Family, Generator, Parameters, Unsuitable, sign
from benchmarks.challenge.point import VARIABLES
from benchmarks.generator.case import STEP_S, Case

FloatArray = NDArray[np.float64]

ALPHA, BETA, LOG_RE, ELEVON, FLAP = range(5)
ALPHA_0 = 40.0
"""Angle of attack that a transition's onset is given at [deg]."""


def departure(case: Case, variable: int) -> FloatArray:
    """A variable less its reference condition."""
    return np.asarray(case.x[variable] - case.point.ratio.reference[variable])


def lagged(values: FloatArray, tau_s: float) -> FloatArray:
    """A history behind a first-order lag, at rest to begin with."""
    keep = float(np.exp(-STEP_S / max(tau_s, 1e-6)))
    return np.asarray(lfilter([1.0 - keep], [1.0, -keep], values - values[0]) + values[0])


def noise(case: Case, seed: int, correlation_s: float) -> FloatArray:
    """A smooth random history of unit variance."""
    raw = gaussian_filter1d(np.random.default_rng(seed).normal(size=len(case.time_s)), correlation_s / STEP_S)
    return np.asarray(raw / np.std(raw))


# Transition ----------------------------------------------------------------------------------------------------------


def _draw_transition(rng: Generator, case: Case, form: str) -> dict[str, Any]:
    hot = np.flatnonzero(case.hot)
    at = hot[int(rng.uniform(0.45, 0.85) * (len(hot) - 1))]
    drawn = {
        "log10_re_onset": float(case.x[LOG_RE, at]),
        "alpha_sens": float(rng.uniform(0.0, 0.03)),
        "factor": float(rng.uniform(1.6, 4.5)),
    }
    if form != "sharp":
        drawn["width"] = float(rng.uniform(0.01, 0.06))
    if form == "intermittent":
        drawn |= {"seed": int(rng.integers(1, 10**6)), "burst_s": float(rng.uniform(0.5, 3.0))}
    return drawn


def _transition(case: Case, form: str, p: Parameters) -> Deviation:
    past = case.x[LOG_RE] - p["log10_re_onset"] + p["alpha_sens"] * (case.x[ALPHA] - ALPHA_0)
    if form == "sharp":
        turbulent = (past > 0.0).astype(float)
    elif form == "dhawan-narasimha":
        turbulent = -np.expm1(-0.412 * (np.maximum(past, 0.0) / p["width"]) ** 2)
    elif form == "intermittent":
        turbulent = (expit(past / p["width"]) > ndtr(noise(case, p["seed"], p["burst_s"]))).astype(float)
    else:
        turbulent = expit(past / p["width"])
    return Deviation(multiply=1.0 + (p["factor"] - 1.0) * turbulent)


# Angle of attack, deflections, sideslip -----------------------------------------------------------------------------


def _draw_impingement(rng: Generator, case: Case, form: str) -> dict[str, Any]:
    alpha = case.x[ALPHA][case.hot]
    middle, top = float(np.median(alpha)), float(np.max(alpha))
    if top - middle < 1.5:
        raise Unsuitable
    onset = middle + rng.uniform(0.2, 0.6) * (top - middle)
    drawn = {"alpha_onset_deg": float(onset), "slope": float(case.r_0 * rng.uniform(0.02, 0.15))}
    return drawn if form == "ramp" else drawn | {"blend_deg": float(rng.uniform(0.3, 1.0))}


def _impingement(case: Case, form: str, p: Parameters) -> Deviation:
    past = case.x[ALPHA] - p["alpha_onset_deg"]
    w = p.get("blend_deg", 0.0)
    if form == "soft":
        rise = w * np.logaddexp(0.0, past / w)
    elif form == "saturating":
        rise = 6.0 * w * np.tanh(np.maximum(past, 0.0) / (6.0 * w))
    elif form == "square-start":
        rise = np.maximum(past, 0.0) ** 2 / (np.maximum(past, 0.0) + w)
    else:
        rise = np.maximum(past, 0.0)
    return Deviation(add=p["slope"] * rise)


def _curvature(name: str, variable: int, manoeuvre: str, kinds: tuple[str, ...]) -> Family:
    """Second-order term in one variable."""
    key = {ALPHA: "d_alpha2", ELEVON: "d_elevon2", FLAP: "d_bodyflap2"}[variable]

    def draw(rng: Generator, case: Case, form: str) -> dict[str, Any]:
        if np.ptp(case.x[variable][case.hot]) < 4.0:
            raise Unsuitable
        drawn = {key: float(sign(rng) * case.r_0 * rng.uniform(0.002, 0.01))}
        return drawn if form == "quadratic" else drawn | {"scale_deg": float(rng.uniform(6.0, 15.0))}

    def act(case: Case, form: str, p: Parameters) -> Deviation:
        x, s = departure(case, variable), p.get("scale_deg", 0.0)
        if form == "cosh":
            return Deviation(add=p[key] * 2.0 * s * s * (np.cosh(np.clip(x / s, -1.5, 1.5)) - 1.0))
        if form == "skewed":
            return Deviation(add=p[key] * x * x * (1.0 + 0.25 * np.tanh(x / s)))
        return Deviation(add=p[key] * x * x)

    return Family(name, ("quadratic", "cosh", "skewed"), draw, act, {key: (0.0, -0.05, 0.05)}, (manoeuvre,), kinds)


PRODUCTS = {"d_alpha_elevon": (ALPHA, ELEVON), "d_alpha_bodyflap": (ALPHA, FLAP), "d_elevon_bodyflap": (ELEVON, FLAP)}


def _draw_interaction(rng: Generator, case: Case, form: str) -> dict[str, Any]:
    key = str(rng.choice(list(PRODUCTS)))
    drawn = {key: float(sign(rng) * case.r_0 * rng.uniform(0.003, 0.015))}
    return drawn if form == "product" else drawn | {"scale_deg2": float(rng.uniform(25.0, 60.0))}


def _interaction(case: Case, form: str, p: Parameters) -> Deviation:
    key = next(k for k in PRODUCTS if k in p)
    first, second = (departure(case, v) for v in PRODUCTS[key])
    product = first * second
    if form == "saturating":
        product = p["scale_deg2"] * np.tanh(product / p["scale_deg2"])
    return Deviation(add=p[key] * product)


def _draw_sideslip(rng: Generator, case: Case, form: str) -> dict[str, Any]:
    if form == "quadratic":
        return {"d_beta2": float(sign(rng) * case.r_0 * rng.uniform(0.005, 0.03))}
    drawn = {"slope_abs_beta": float(sign(rng) * case.r_0 * rng.uniform(0.01, 0.08))}
    return drawn | ({"round_deg": float(rng.uniform(0.3, 1.0))} if form == "rounded" else {})


def _sideslip(case: Case, form: str, p: Parameters) -> Deviation:
    beta = case.x[BETA]
    if form == "quadratic":
        return Deviation(add=p["d_beta2"] * beta * beta)
    w = p.get("round_deg", 0.0)
    return Deviation(add=p["slope_abs_beta"] * (np.hypot(beta, w) - w))


# Lags, jets, and what is in no library --------------------------------------------------------------------------------


def _draw_nonisothermal(rng: Generator, case: Case, form: str) -> dict[str, Any]:
    return {
        "lag_s": float(rng.uniform(1.5, 6.0)),
        "lag_fraction": float(rng.uniform(0.4, 1.0)),
        "overshoot": float(rng.uniform(0.05, 0.3)),
        "decay_s": float(rng.uniform(80.0, 400.0)),
        "start_s": float(case.time_s[np.flatnonzero(case.hot)[0]] - rng.uniform(0.0, 60.0)),
    }


def _nonisothermal(case: Case, form: str, p: Parameters) -> Deviation:
    r = case.point.ratio.true(case.x, case.point.ratio.scale, case.point.ratio.d)
    if form == "second-order":
        behind = lagged(lagged(r, 0.5 * p["lag_s"]), 0.5 * p["lag_s"])
    elif form == "dead-time":
        behind = np.interp(case.time_s - p["lag_s"], case.time_s, r)
    else:
        behind = lagged(r, p["lag_s"])
    since = np.maximum(case.time_s - p["start_s"], 0.0) / p["decay_s"]
    decay = 1.0 / (1.0 + since) ** 2 if form == "second-order" else np.exp(-since)
    return Deviation(add=p["lag_fraction"] * (behind - r), multiply=1.0 + p["overshoot"] * decay)


def _draw_jets(rng: Generator, case: Case, form: str) -> dict[str, Any]:
    if "jets" not in case.recorded or float(np.sum(case.fine["jets"][case.hot])) < 100.0:
        raise Unsuitable
    drawn = {"jet_gain": float(rng.uniform(0.05, 0.5) * (sign(rng) if form != "derived-density" else 1.0))}
    return drawn | ({"tail_s": float(rng.uniform(1.5, 5.0))} if form == "tail" else {})


def _jets(case: Case, form: str, p: Parameters) -> Deviation:
    jets = case.fine["jets"]
    if form == "tail":
        return Deviation(multiply=1.0 + p["jet_gain"] * np.maximum(jets, lagged(jets, p["tail_s"])))
    if form == "derived-density":  # recorded density too high by 1 + gain: film coefficient too high by its root
        return Deviation(multiply=1.0 / np.sqrt(1.0 + p["jet_gain"] * jets))
    return Deviation(multiply=1.0 + p["jet_gain"] * jets)


def _draw_unknown(rng: Generator, case: Case, form: str) -> dict[str, Any]:
    drawn: dict[str, Any] = {"amplitude": float(rng.uniform(0.03, 0.12))}
    if form in ("sine", "chirp"):
        return drawn | {"period_s": float(rng.uniform(40.0, 150.0)), "phase": float(rng.uniform(0.0, 2.0 * np.pi))}
    return drawn | {"seed": int(rng.integers(1, 10**6)), "correlation_s": float(rng.uniform(8.0, 30.0))}


def _unknown(case: Case, form: str, p: Parameters) -> Deviation:
    t, size = case.time_s, p["amplitude"]
    if form == "sine":
        shape = np.sin(2.0 * np.pi * t / p["period_s"] + p["phase"])
    elif form == "chirp":
        shape = np.sin(2.0 * np.pi * t / p["period_s"] * (1.0 + 0.5 * t / t[-1]) + p["phase"])
    elif form == "bumps":
        shape = 2.0 * np.maximum(noise(case, p["seed"], p["correlation_s"]) - 0.8, 0.0)
    else:
        shape = noise(case, p["seed"], p["correlation_s"])
    return Deviation(multiply=np.maximum(1.0 + size * shape, 0.05))


WINDWARD = ("lower", "elevon", "flap")

ON_RATIO = (
    Family(
        "transition", ("logistic", "sharp", "dhawan-narasimha", "intermittent"), _draw_transition, _transition,
        {"factor": (1.0, 1.6, 5.0)}, points=(*WINDWARD, "standoff"),
        residual=(8.0, 60.0),
    ),
    Family(
        "impingement-onset", ("ramp", "soft", "saturating", "square-start"), _draw_impingement, _impingement,
        {"slope": (0.0, 0.0, 0.05)}, ("popu",),
    ),
    _curvature("alpha-curvature", ALPHA, "popu", ()),
    _curvature("elevon-curvature", ELEVON, "elevon", WINDWARD),
    _curvature("bodyflap-curvature", FLAP, "flap", WINDWARD),
    Family(
        "interaction", ("product", "saturating"), _draw_interaction, _interaction,
        dict.fromkeys(PRODUCTS, (0.0, -0.02, 0.02)), ("combined",), WINDWARD,
    ),
    Family(
        "sideslip", ("magnitude", "rounded", "quadratic"), _draw_sideslip, _sideslip,
        {"slope_abs_beta": (0.0, -0.05, 0.05), "d_beta2": (0.0, -0.03, 0.03)}, ("sideslip",),
    ),
    Family(
        "nonisothermal-wall", ("first-order", "second-order", "dead-time"), _draw_nonisothermal, _nonisothermal,
        {"lag_s": (0.0, 0.5, 6.0), "overshoot": (0.0, 0.02, 0.4)}, ("popu",),
    ),
    Family(
        "jet-interaction", ("gain", "tail", "derived-density"), _draw_jets, _jets,
        {"jet_gain": (0.0, -0.7, 1.5)}, ("jets",),
    ),
    Family(
        "unknown", ("sine", "bumps", "wander", "chirp"), _draw_unknown, _unknown, {"amplitude": (0.0, 0.0, 0.3)}
    ),
)  # fmt: skip
assert VARIABLES[LOG_RE] == "log10_re"
