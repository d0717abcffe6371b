"""Remarks on estimates that are not what nature has, or that mean less than their sigma or their errors say.

Each states the parameters, if it is about any, what is remarkable, and what it usually means. They change no estimate.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from itertools import combinations
from typing import Any

import numpy as np

from sim_heating.base.parameters import AT, EFFECT_PREFIX
from sim_heating.estimation.fit import FitResult
from sim_heating.estimation.inference.noise import noise_of_readings
from sim_heating.estimation.record_fit import RecordFit
from sim_heating.estimation.report.estimate_file import Estimate, Remark
from sim_heating.heating.effects.added_curve import ADDED_CURVE
from sim_heating.march.history import PointHistory, negative_ratio_s
from sim_heating.march.point import PointModel

FAR_FROM_PRIOR = 3.0
"""Distance of an estimate from the mean of its prior, in sigmas of the prior, above which it is remarked."""
CORRELATED = 0.95
"""Magnitude of a correlation [-] above which it is remarked."""
SHOWN_PAIRS = 4
"""Correlated pairs that a remark names; of the others it gives the number."""
ROUNDING = 1e-3
"""Excess of an emittance over 1 [-] that is not remarked."""
MISFIT = 1.15
"""Noise found from a misfit over that of neighbouring readings [-] above which it is remarked."""
BEYOND_RANGE = 4.0
"""Distance of a prediction from a reading at the end of its range, in noise floors, above which it is remarked."""

EMITTANCE, NEGATIVE_RATIO, NEGATIVE_CONDUCTIVITY = "emittance above 1", "negative ratio", "negative conductivity"
PRIOR, CORRELATION, BOUND = "far from prior", "correlated", "on its bound"
NOISE, RANGE_END = "misfit as noise", "end of range"
MEANINGS = {
    EMITTANCE: "no surface has an emittance above 1; usually the heating of the model is too large (ratio table, "
    "recovery enthalpy), or the thermocouple is not where the record says",
    NEGATIVE_RATIO: "a hotter gas does not cool a wall; usually derivatives reach beyond the conditions that they were "
    "fitted over, or a thermocouple reads too little",
    NEGATIVE_CONDUCTIVITY: "radiation in depth conducts heat and never takes conductivity away; usually the declared "
    "conductivity of the hot layer is too large",
    PRIOR: "usually it takes up another error of the model: keep the declared value by --fix and let close-loop look "
    "for the cause; or the prior is narrower than what is known",
    CORRELATION: "the readings identify a combination of these and none alone: fix one, give it a prior, or "
    "measure what tells them apart",
    BOUND: "the readings ask for more than the bound allows, and it has no sigma; usually another cause is at work",
    NOISE: "RMSE and noise floor agree whatever the model lacks: let close-loop look, or declare noise_sigma_K",
    RANGE_END: "the fit takes such a reading as `at least` or `at most`, and an RMSE takes it as it stands, which makes"
    " it larger than the misfit",
}
"""What each kind of remark usually means."""

EMITTANCE_FACTOR = "stack.emissivity_factor"
EMITTANCE_EFFECT = f"{EFFECT_PREFIX}emissivity."
RADIATIVE = "stack.rsi.radiative_conductivity"


def remarks(fitted: FitResult) -> list[Remark]:
    """What is remarkable about the estimates of a fit, the impossible first; empty where nothing is.

    fitted : values, each in its unit, with priors, bounds and covariance

    The thresholds are 3 sigmas of the prior, a correlation of 0.95 [-], 1.15 times the noise of neighbouring readings,
    and 4 noise floors: rules of this program.
    """
    return [
        *_impossible_values(fitted),
        *_on_bounds(fitted),
        *_far_from_priors(fitted),
        *_correlations(fitted),
        *_misfits_as_noise(fitted),
        *_ends_of_ranges(fitted),
    ]


def floor_in_words(estimate: Estimate) -> str:
    """The noise floor of a fit [K], and whether it is only the misfit of the fit itself; empty without one."""
    if estimate.noise_floor_K is None:
        return ""
    circular = any(r.kind == NOISE for r in estimate.remarks)
    return f"{estimate.noise_floor_K:.2f} K{', from the misfit itself' if circular else ''}"


def samples_in_words(samples: Mapping[str, Any]) -> str:
    """How many readings of the fit segments count, and why the others do not; empty where all do.

    samples : `fit`, and `left_out` by the reason

    >>> from sim_heating.estimation.report.remarks import samples_in_words
    >>> samples_in_words({"fit": 45, "holdout": 0, "left_out": {"slack of the clock": 4}})
    '45 of 49 readings of the fit segments are fitted; left out: 4 (slack of the clock)'
    """
    left_out = samples.get("left_out", {})
    if not left_out:
        return ""
    total = samples["fit"] + sum(left_out.values())
    reasons = ", ".join(f"{count} ({reason})" for reason, count in left_out.items())
    return f"{samples['fit']} of {total} readings of the fit segments are fitted; left out: {reasons}"


def further_warnings(warnings: Sequence[str], fit_remarks: Sequence[Remark]) -> list[str]:
    """Warnings on a fit that no remark repeats."""
    return [line for line in warnings if line not in {r.message for r in fit_remarks}]


def short_remarks(fit_remarks: Sequence[Remark], parameter: str) -> str:
    """The kinds of the remarks on a parameter, for a cell of a table."""
    return ", ".join(dict.fromkeys(r.kind for r in fit_remarks if parameter in r.parameters))


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
            message = f"{name}: the radiative conductivity is {model.value(RADIATIVE):.3g} W/(m K)"
            yield _remark(NEGATIVE_CONDUCTIVITY, radiative, message)


def _labels(fitted: FitResult, record_fit: RecordFit, *beginnings: str) -> list[str]:
    """Labels of the estimated parameters of a record whose names begin so."""
    unknowns = [fitted.problem.unknowns[k] for k in record_fit.index]
    return [u.label for u in unknowns if u.parameter.name.partition(AT)[0].startswith(beginnings)]


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
            values = used.by_name
            emittance *= np.maximum(values["emissivity_factor"] + values["emissivity_slope"] * (T - 1000.0), 0.0)
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
            message = f"{unknown.label} is {abs(distance):.1f} sigmas of its prior from its mean ({stated})"
            yield _remark(PRIOR, [unknown.label], message)


def _correlations(fitted: FitResult) -> Iterator[Remark]:
    """Values of a curve are left out: they belong together, and their level is that of the magnitude."""
    rho, labels = fitted.correlation, fitted.labels
    single = [k for k, name in enumerate(labels) if not name.startswith(f"{EFFECT_PREFIX}{ADDED_CURVE}.")]
    pairs = sorted((p for p in combinations(single, 2) if abs(rho[p]) > CORRELATED), key=lambda p: -abs(rho[p]))
    if len(pairs) == 1:
        (i, j) = pairs[0]
        message = f"{labels[i]} and {labels[j]} have a correlation of {rho[i, j]:+.3f}"
        yield _remark(CORRELATION, [labels[i], labels[j]], message)
    elif pairs:
        listed = ", ".join(f"{labels[i]} and {labels[j]} {rho[i, j]:+.3f}" for i, j in pairs[:SHOWN_PAIRS])
        unlisted = f", and {len(pairs) - SHOWN_PAIRS} more" * (len(pairs) > SHOWN_PAIRS)
        message = f"{len(pairs)} pairs have a correlation beyond {CORRELATED:g}: {listed}{unlisted}"
        yield _remark(CORRELATION, list(dict.fromkeys(labels[k] for pair in pairs for k in pair)), message)


def _misfits_as_noise(fitted: FitResult) -> Iterator[Remark]:
    """Remarks on sensors without a declared noise, where the readings scatter by less than what the fit left."""
    for record_fit in fitted.problem.record_fits:
        record = record_fit.record
        for channel in record_fit.channels:
            sensor, assumed_K = channel.sensor, record_fit.sigma_K[channel.number]
            own_K = noise_of_readings(record.time_s, record.temperatures_K([sensor])[0], sensor.lsb_K)
            if sensor.noise_sigma_K is not None or own_K is None:
                continue
            # readings that stay on one code of a recorder for long hide up to half a step of noise
            if sensor.noise_floor_K(assumed_K) > MISFIT * math.hypot(own_K, sensor.lsb_K / 2.0):
                message = (
                    f"{record.name}, sensor {sensor.name}: no noise is declared, and {assumed_K:.2g} K is the misfit "
                    f"of the model; neighbouring readings scatter by {own_K:.2g} K"
                )
                yield _remark(NOISE, [], message)


def _ends_of_ranges(fitted: FitResult) -> Iterator[Remark]:
    """Remarks on sensors whose readings stay at an end of their range while the model goes on."""
    for s in fitted.samples():
        intervals, sensor, record = s.channel.intervals, s.channel.sensor, s.record_fit.record
        if sensor.range_K is None:
            continue
        for at, end_K, side in (
            (np.isposinf(intervals.upper_K), sensor.range_K[1], "upper"),
            (np.isneginf(intervals.lower_K), sensor.range_K[0], "lower"),
        ):
            if not at.any():
                continue
            beyond_K = float(np.max(np.abs(s.mean_K[at] - end_K)))
            if beyond_K > BEYOND_RANGE * sensor.noise_floor_K(s.sigma_K):
                times = s.time_s[at]
                message = (
                    f"{record.name}, sensor {sensor.name}: {len(times)} readings from {times[0]:.0f} to "
                    f"{times[-1]:.0f} s are at the {side} end of its range, {end_K:.0f} K; the model differs from it "
                    f"by up to {beyond_K:.0f} K"
                )
                yield _remark(RANGE_END, [], message)


def _remark(kind: str, parameters: Sequence[str], message: str) -> Remark:
    return Remark(kind=kind, parameters=list(parameters), message=message, meaning=MEANINGS[kind])
