"""Remarks on estimates that are not what nature has, or that mean less than their sigma says.

Each states the parameters, what is remarkable, and what it usually means. They change no estimate.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import combinations

import numpy as np

from sim_heating.base.parameters import AT, EFFECT_PREFIX
from sim_heating.estimation.fit import FitResult
from sim_heating.estimation.record_fit import RecordFit
from sim_heating.estimation.report.estimate_file import Remark
from sim_heating.heating.effects.added_curve import ADDED_CURVE
from sim_heating.march.history import PointHistory, negative_ratio_s
from sim_heating.march.point import PointModel

FAR_FROM_PRIOR = 3.0
"""Distance of an estimate from the mean of its prior, in sigmas of the prior, above which it is remarked."""
CORRELATED = 0.95
"""Magnitude of a correlation [-] above which it is remarked."""
ROUNDING = 1e-3
"""Excess of an emittance over 1 [-] that is not remarked."""

EMITTANCE, NEGATIVE_RATIO, NEGATIVE_CONDUCTIVITY = "emittance above 1", "negative ratio", "negative conductivity"
PRIOR, CORRELATION, BOUND = "far from prior", "correlated", "on its bound"
MEANINGS = {
    EMITTANCE: "no surface has an emittance above 1; usually the heating of the model is too large (ratio table, "
    "recovery enthalpy), or the thermocouple is not where the record says",
    NEGATIVE_RATIO: "a hotter gas does not cool a wall; usually derivatives reach beyond the conditions that they were "
    "fitted over, or a thermocouple reads too little",
    NEGATIVE_CONDUCTIVITY: "radiation in depth conducts heat and never takes conductivity away; usually the declared "
    "conductivity of the hot layer is too large",
    PRIOR: "usually it takes up another error of the model: keep the declared value by --fix and let close-loop look "
    "for the cause; or the prior is narrower than what is known",
    CORRELATION: "the readings identify a combination of the two and neither alone: fix one, give it a prior, or "
    "measure what tells them apart",
    BOUND: "the readings ask for more than the bound allows, and it has no sigma; usually another cause is at work",
}
"""What each kind of remark usually means."""

EMITTANCE_FACTOR = "stack.emissivity_factor"
EMITTANCE_EFFECT = f"{EFFECT_PREFIX}emissivity."
RADIATIVE = "stack.rsi.radiative_conductivity"


def remarks(fitted: FitResult) -> list[Remark]:
    """What is remarkable about the estimates of a fit, the impossible first; empty where nothing is.

    fitted : values, each in its unit, with priors, bounds and covariance

    The thresholds are 3 sigmas of the prior, and a correlation of 0.95 [-]: rules of this program.
    """
    return [
        *_impossible_values(fitted), *_on_bounds(fitted), *_far_from_priors(fitted), *_correlations(fitted)
    ]  # fmt: skip


def further_warnings(warnings: Sequence[str], found: Sequence[Remark]) -> list[str]:
    """Warnings on a fit that no remark repeats."""
    return [line for line in warnings if line not in {r.message for r in found}]


def short_remarks(found: Sequence[Remark], parameter: str) -> str:
    """The kinds of the remarks on a parameter, for a cell of a table."""
    return ", ".join(dict.fromkeys(r.kind for r in found if parameter in r.parameters))


def _impossible_values(fitted: FitResult) -> Iterator[Remark]:
    for record_fit, after in zip(fitted.problem.record_fits, fitted.after, strict=True):
        model = record_fit.model_at(fitted.fit.values)
        name = record_fit.record.name
        emittance, wall_K = _largest_emittance(model, after.history)
        factors = _labels(fitted, record_fit, EMITTANCE_FACTOR, EMITTANCE_EFFECT)
        if factors and emittance > 1.0 + ROUNDING:
            yield _remark(EMITTANCE, factors, f"{name}: the emittance is {emittance:.3g} at {wall_K:.0f} K")
        negative_s, ratios = negative_ratio_s(after.history), _labels(fitted, record_fit, "ratio.")
        if ratios and negative_s > 0.0:
            yield _remark(NEGATIVE_RATIO, ratios, f"{name}: the heating ratio is negative for {negative_s:.0f} s")
        radiative = _labels(fitted, record_fit, RADIATIVE, f"{EFFECT_PREFIX}radiative-conduction.")
        if radiative and model.value(RADIATIVE) < 0.0:
            found = f"{name}: the radiative conductivity is {model.value(RADIATIVE):.3g} W/(m K)"
            yield _remark(NEGATIVE_CONDUCTIVITY, radiative, found)


def _labels(fitted: FitResult, record_fit: RecordFit, *beginnings: str) -> list[str]:
    """Labels of the estimated parameters of a record whose names begin so."""
    own = [fitted.problem.unknowns[k] for k in record_fit.index]
    return [u.label for u in own if u.parameter.name.partition(AT)[0].startswith(beginnings)]


def _largest_emittance(model: PointModel, history: PointHistory) -> tuple[float, float]:
    """Largest emittance of the outer surface [-] over the wall temperatures of a history, and where it is [K]."""
    surface_K = history.surface_K[np.isfinite(history.surface_K)]
    table = np.array(model.construction.layer_materials()[0].emissivity, dtype=float)
    if not len(surface_K) or not table.size:
        return 0.0, 0.0
    T = np.linspace(surface_K.min(), surface_K.max(), 50)
    emittance = np.interp(T, *table.T) * model.value(EMITTANCE_FACTOR)
    for used in model.effects:
        if used.effect.name == "emissivity":
            own = dict(zip((p.name for p in used.effect.parameters), used.values, strict=True))
            emittance *= np.maximum(own["emissivity_factor"] + own["emissivity_slope"] * (T - 1000.0), 0.0)
    k = int(np.argmax(emittance))
    return float(emittance[k]), float(T[k])


def _on_bounds(fitted: FitResult) -> Iterator[Remark]:
    for unknown, value, bounded in zip(fitted.problem.unknowns, fitted.fit.values, fitted.fit.on_bound, strict=True):
        if bounded:
            yield _remark(BOUND, [unknown.label], f"{unknown.label} is on its bound, {value:g}")


def _far_from_priors(fitted: FitResult) -> Iterator[Remark]:
    for unknown, value in zip(fitted.problem.unknowns, fitted.fit.values, strict=True):
        prior = unknown.parameter
        distance = (value - prior.value) / prior.sigma if np.isfinite(prior.sigma) and prior.sigma > 0.0 else 0.0
        if abs(distance) > FAR_FROM_PRIOR:
            stated = f"{prior.value:g} +- {prior.sigma:g}"
            found = f"{unknown.label} is {abs(distance):.1f} sigmas of its prior from its mean ({stated})"
            yield _remark(PRIOR, [unknown.label], found)


def _correlations(fitted: FitResult) -> Iterator[Remark]:
    """Values of a curve are left out: they belong together, and their level is that of the magnitude."""
    rho, labels = fitted.correlation, fitted.labels
    single = [k for k, name in enumerate(labels) if not name.startswith(f"{EFFECT_PREFIX}{ADDED_CURVE}.")]
    for i, j in sorted((p for p in combinations(single, 2) if abs(rho[p]) > CORRELATED), key=lambda p: -abs(rho[p])):
        found = f"{labels[i]} and {labels[j]} have a correlation of {rho[i, j]:+.3f}"
        yield _remark(CORRELATION, [labels[i], labels[j]], found)


def _remark(kind: str, parameters: Sequence[str], message: str) -> Remark:
    return Remark(kind=kind, parameters=list(parameters), message=message, meaning=MEANINGS[kind])
