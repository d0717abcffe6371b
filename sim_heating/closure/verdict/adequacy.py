"""Whether a model explains a record to its noise: residuals normalised by what noise and rounding give, and a p-value.

For the true model the reduced chi-square is 1 over any part of the record, and neighbouring residuals are uncorrelated
but for the colour of the recorder's noise. Each part's excess is compared with its own scatter,

    t = (chi2 - 1) / (a + sqrt(2 (1 + rho^2) / ((1 - rho^2) n))),

n samples with lag-1 autocorrelation rho (variance of a sum of squares of a first-order autoregressive process), a the
error that meshes and steps leave. So are the autocorrelation itself and the number of sign changes, which for white
noise is half the number of pairs (Wald and Wolfowitz 1940). The largest t over the whole fit, the segments held out,
the sensors and eight consecutive parts of the record is compared with its distribution over records of known truth,
fitted with the true effect (closure_calibration.json): the share of those with a larger one is the p-value.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.closure.verdict.calibration import true_statistics
from sim_heating.closure.verdict.policy import POLICY
from sim_heating.estimation.inference.likelihood import likelihood
from sim_heating.estimation.record_fit import PredictedSamples

FEWEST = 12
"""Least number of samples of a part that is judged by itself."""


@dataclass(frozen=True)
class Adequacy:
    """How well a model explains a record.

    p_value      : share of records of known truth that look worse when fitted with the true effect
    chi2_fit     : reduced chi-square of the fitted samples [-];  chi2_holdout : of those held out, None where none are
    lag1         : lag-1 autocorrelation of the normalised residuals [-]
    sign_changes : share of neighbouring residuals with different signs [-], half for white noise
    by_sensor, by_phase : reduced chi-square of each sensor, and of consecutive parts by their times
    statistic    : the largest excess over its scatter
    noise_scale  : noise over the declared one [-] that the p-value is for: above 1 where the residuals are white noise
                   of one size, larger than declared. A recorder may be noisier, and no model error has this form
    """

    p_value: float
    chi2_fit: float
    chi2_holdout: float | None
    lag1: float
    sign_changes: float
    by_sensor: Mapping[str, float]
    by_phase: Mapping[str, float]
    statistic: float
    noise_scale: float = 1.0

    def as_json(self) -> dict[str, Any]:
        """Its entry in closure.json."""
        return {
            "p_value": self.p_value, "chi2_fit": self.chi2_fit, "chi2_holdout": self.chi2_holdout, "lag1": self.lag1,
            "sign_changes": self.sign_changes, "by_sensor": dict(self.by_sensor), "by_phase": dict(self.by_phase),
        }  # fmt: skip


@dataclass(frozen=True)
class _Scores:
    """Squared scores and information of samples, in the order of time; of several records where there is a last axis.

    time_s : (sample,);  square, information : (sample,) or (sample, record)
    """

    time_s: FloatArray
    square: FloatArray
    information: FloatArray

    def chi2(self) -> FloatArray:
        """() or (record,) reduced chi-square [-]; 1 where no sample has any information."""
        total, square = np.sum(self.information, axis=0), np.sum(self.square, axis=0)
        return np.asarray(np.divide(square, total, out=np.ones_like(total), where=total > 0.0))

    def select(self, chosen: Any) -> _Scores:
        """The chosen samples."""
        return _Scores(self.time_s[chosen], self.square[chosen], self.information[chosen])


@dataclass(frozen=True)
class _Judged:
    """What is judged of one record, or of several that have the channels and times in common.

    by_sensor, by_phase, held_out : their scores, the last empty where nothing is held out
    lag1, sign_changes : () or (record,), as of `Adequacy`
    """

    everything: _Scores
    by_sensor: Mapping[str, _Scores]
    by_phase: Mapping[str, _Scores]
    held_out: Mapping[str, _Scores]
    lag1: FloatArray
    sign_changes: FloatArray

    def with_noise(self, variance: float) -> _Judged:
        """With noise of this variance over the declared one [-]."""

        def scaled(parts: Mapping[str, _Scores]) -> dict[str, _Scores]:
            return {n: replace(s, square=s.square / variance) for n, s in parts.items()}

        everything = replace(self.everything, square=self.everything.square / variance)
        parts = scaled(self.by_sensor), scaled(self.by_phase), scaled(self.held_out)
        return _Judged(everything, *parts, self.lag1, self.sign_changes)

    @property
    def is_white(self) -> bool:
        """Whether residuals of one record are white noise of one size, whatever its size."""
        return bool(self.colour <= 1.0) and all(_is_even(s, self.everything) for s in self.parts.values())

    @property
    def parts(self) -> dict[str, _Scores]:
        """All that is judged by its chi-square, by what it is of."""
        by_sensor = {f"sensor {n}": s for n, s in self.by_sensor.items()}
        return {"": self.everything, **by_sensor, **self.by_phase, **self.held_out}

    @property
    def colour(self) -> FloatArray:
        """() or (record,) autocorrelation over what the colours of recorders and chance give [-]."""
        return self.lag1 / (POLICY.noise_colour + self._scatter)

    @property
    def statistic(self) -> FloatArray:
        """() or (record,) the largest excess over its scatter [-]."""
        rho = np.clip(self.lag1, 0.0, POLICY.max_lag1)
        runs = (0.5 - self.sign_changes) / (0.5 * POLICY.noise_colour + 0.5 * self._scatter)
        judged = [_excess(s, rho) for s in self.parts.values() if len(s.time_s) >= FEWEST]
        return np.max(np.stack([*judged, self.colour, runs]), axis=0)

    @property
    def _scatter(self) -> float:
        return 1.0 / math.sqrt(max(len(self.everything.time_s), 1))


def statistics(fitted: Sequence[PredictedSamples], held_out: Sequence[PredictedSamples] = ()) -> FloatArray:
    """(record,) statistics of the adequacy of several records, as `assess` has that of one.

    fitted, held_out : as there, with readings and predictions (sample, record)
    """
    return _judged(fitted, held_out).statistic


def assess(fitted: Sequence[PredictedSamples], held_out: Sequence[PredictedSamples] = ()) -> Adequacy:
    """Adequacy of a model.

    fitted   : channels at the values found;  held_out : channels of the segments held out, at the same values
    """
    judged = _judged(fitted, held_out)
    statistic, chi2_fit = float(judged.statistic), float(judged.everything.chi2())
    p, noise_scale = p_value(statistic), 1.0
    if p < POLICY.adequate_p and chi2_fit > 1.0 and judged.is_white:
        p, noise_scale = p_value(float(judged.with_noise(chi2_fit).statistic)), math.sqrt(chi2_fit)
    by_sensor, by_phase, others = (
        {n: float(s.chi2()) for n, s in parts.items()} for parts in (judged.by_sensor, judged.by_phase, judged.held_out)
    )
    return Adequacy(
        p_value=p,
        chi2_fit=chi2_fit,
        chi2_holdout=next(iter(others.values()), None),
        lag1=float(judged.lag1),
        sign_changes=float(judged.sign_changes),
        by_sensor=by_sensor,
        by_phase=by_phase,
        statistic=statistic,
        noise_scale=noise_scale,
    )


def pooled(by_record: Mapping[str, Adequacy], counts: Sequence[int]) -> Adequacy:
    """Whether one model explains several records: chi-squares pooled, the p-value that of the worst record.

    by_record : name of a record -> adequacy of the model there;  counts : (record,) numbers of fitted samples

    The smallest of n independent p-values is below p with the probability 1 - (1 - p)^n (Sidak 1967).
    """
    adequacies = list(by_record.values())

    def mean(quantity: str) -> float:
        return float(np.average([getattr(a, quantity) for a in adequacies], weights=np.array(counts, dtype=float)))

    def by_record_and(what: str) -> dict[str, float]:
        return {f"{n}, {k}": v for n, a in by_record.items() for k, v in getattr(a, what).items()}

    held_out = [a.chi2_holdout for a in adequacies if a.chi2_holdout is not None]
    return Adequacy(
        p_value=-math.expm1(len(adequacies) * math.log1p(-min(a.p_value for a in adequacies))),
        chi2_fit=mean("chi2_fit"),
        chi2_holdout=float(np.mean(held_out)) if held_out else None,
        lag1=mean("lag1"),
        sign_changes=mean("sign_changes"),
        by_sensor=by_record_and("by_sensor"),
        by_phase=by_record_and("by_phase"),
        statistic=max(a.statistic for a in adequacies),
        noise_scale=max(a.noise_scale for a in adequacies),
    )


def p_value_text(p: float) -> str:
    """A p-value in words, with two digits, or as many as distinguish it from `Policy.adequate_p`."""
    if p < POLICY.min_p_value:
        return f"below {POLICY.min_p_value:g}"
    texts = (f"{p:.{digits}g}" for digits in range(2, 18))
    return next(t for t in texts if (float(t) >= POLICY.adequate_p) == (p >= POLICY.adequate_p))


def p_value(statistic: float, statistics: FloatArray | None = None) -> float:
    """Share of records of known truth whose statistic is larger, (k + 1) / (n + 1) of n, linear between them.

    statistics : (record,) their statistics, ascending; by default those of the calibration

    Beyond the largest it falls exponentially, at the mean rate of the largest tenth of them.
    """
    statistics = true_statistics() if statistics is None else statistics
    largest = statistics[-1]
    if statistic <= largest:
        larger = float(np.interp(statistic, statistics, np.arange(len(statistics) - 1.0, -1.0, -1.0)))
        return (larger + 1.0) / (len(statistics) + 1.0)
    tail = statistics[-max(len(statistics) // 10, 2) :]
    return math.exp(-(statistic - largest) / float(np.mean(tail - tail[0]))) / (len(statistics) + 1.0)


def _judged(fitted: Sequence[PredictedSamples], held_out: Sequence[PredictedSamples]) -> _Judged:
    """What is judged of the channels of one record or of several."""
    by_sensor = {s.channel.sensor.name: _scores(s) for s in fitted}
    scored = {n: scores for n, (scores, _) in by_sensor.items()}
    everything = _joined(list(scored.values()))
    others = {"held out": _joined([_scores(s)[0] for s in held_out])} if held_out else {}
    neighbours = _neighbours(fitted, [z for _, z in by_sensor.values()])
    return _Judged(everything, scored, _parts(everything), others, *neighbours)


def _scores(samples: PredictedSamples) -> tuple[_Scores, FloatArray]:
    """Squared scores of a channel, and its normalised residuals in the shape of the predictions [-]."""
    spread_K = samples.spread_K.reshape(-1, *[1] * (samples.mean_K.ndim - 1))
    scored = likelihood(samples.channel.intervals, samples.mean_K, spread_K)
    known = np.where(scored.information > 0.0, scored.information, np.inf)
    return _Scores(np.asarray(samples.time_s), scored.score**2, scored.information), scored.score / np.sqrt(known)


def _joined(scores: Sequence[_Scores]) -> _Scores:
    time_s = np.concatenate([s.time_s for s in scores])
    order = np.argsort(time_s, kind="stable")
    square, information = (np.concatenate([getattr(s, f) for s in scores]) for f in ("square", "information"))
    return _Scores(time_s[order], square[order], information[order])


def _parts(everything: _Scores) -> dict[str, _Scores]:
    """Consecutive parts with as many samples each, by their times."""
    part_count = 8  # consecutive parts of a record that are judged by themselves
    phases = {}
    for index in np.array_split(np.arange(len(everything.time_s)), part_count):
        if len(index) >= FEWEST:
            phase = everything.select(index)
            phases[f"{phase.time_s[0]:.0f} to {phase.time_s[-1]:.0f} s"] = phase
    return phases


def _excess(scores: _Scores, rho: FloatArray) -> FloatArray:
    """Excess chi-square over its scatter."""
    n = max(len(scores.time_s), 1)
    scatter = np.sqrt(2.0 * (1.0 + rho**2) / ((1.0 - rho**2) * n))
    return np.asarray((scores.chi2() - 1.0) / (POLICY.model_error_chi2 + scatter))


def _is_even(scores: _Scores, everything: _Scores) -> bool:
    """Whether the chi-square of a part is not far above that of the whole record."""
    n = len(scores.time_s)
    largest = float(everything.chi2()) * (1.0 + POLICY.uneven_chi2 + 3.0 * math.sqrt(2.0 / max(n, 1)))
    return n < FEWEST or float(scores.chi2()) <= largest


def _neighbours(fitted: Sequence[PredictedSamples], residuals: Sequence[FloatArray]) -> tuple[FloatArray, FloatArray]:
    """Autocorrelation of neighbouring normalised residuals within each channel, and the share that changes sign [-].

    residuals : by channel, (sample,) or (sample, record)
    """
    products = np.sum([np.sum(z[1:] * z[:-1], axis=0) for z in residuals], axis=0)
    squares = np.sum([np.sum(z**2, axis=0) for z in residuals], axis=0)
    lag1 = np.divide(products, squares, out=np.zeros_like(squares), where=squares > 0.0)
    # the sign of a coarse word's residual is that of the place within the word, for many samples
    fine = [z for s, z in zip(fitted, residuals, strict=True) if s.channel.sensor.lsb_K <= s.sigma_K]
    pairs = sum(len(z) - 1 for z in fine)
    if pairs <= 0:
        return lag1, np.full_like(lag1, 0.5)
    return lag1, np.sum([np.count_nonzero(z[1:] * z[:-1] < 0.0, axis=0) for z in fine], axis=0) / pairs
