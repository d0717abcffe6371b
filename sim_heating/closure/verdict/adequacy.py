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
from dataclasses import dataclass
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
    unstructured : whether the residuals are as white noise of one size, whatever its size: the recorder may be noisier
                   than declared, but no model error has this form
    """

    p_value: float
    chi2_fit: float
    chi2_holdout: float | None
    lag1: float
    sign_changes: float
    by_sensor: Mapping[str, float]
    by_phase: Mapping[str, float]
    statistic: float
    unstructured: bool

    def as_json(self) -> dict[str, Any]:
        """Its entry in closure.json."""
        return {
            "p_value": self.p_value, "chi2_fit": self.chi2_fit, "chi2_holdout": self.chi2_holdout, "lag1": self.lag1,
            "sign_changes": self.sign_changes, "by_sensor": dict(self.by_sensor), "by_phase": dict(self.by_phase),
        }  # fmt: skip


@dataclass(frozen=True)
class _Scores:
    """Squared scores and information of samples, in the order of time."""

    time_s: FloatArray
    square: FloatArray
    information: FloatArray

    def chi2(self) -> float:
        """Reduced chi-square [-]; 1 where no sample has any information."""
        total = float(np.sum(self.information))
        return float(np.sum(self.square)) / total if total > 0.0 else 1.0

    def select(self, chosen: Any) -> _Scores:
        """The chosen samples."""
        return _Scores(self.time_s[chosen], self.square[chosen], self.information[chosen])


def assess(fitted: Sequence[PredictedSamples], held_out: Sequence[PredictedSamples] = ()) -> Adequacy:
    """Adequacy of a model.

    fitted   : channels at the values found;  held_out : channels of the segments held out, at the same values
    """
    by_sensor = {s.channel.sensor.name: _scores(s) for s in fitted}
    everything = _joined(list(by_sensor.values()))
    lag1, sign_changes = _neighbours(fitted)
    rho = min(max(lag1, 0.0), POLICY.max_lag1)
    parts = _parts(everything)
    chi2 = {"": everything, **{f"sensor {n}": s for n, s in by_sensor.items()}, **parts}
    if held_out:
        chi2["held out"] = _joined([_scores(s) for s in held_out])
    scatter = 1.0 / math.sqrt(max(len(everything.time_s), 1))
    judged = [_excess(s, rho) for s in chi2.values() if len(s.time_s) >= FEWEST]
    statistic = max(
        [
            *judged,
            lag1 / (POLICY.noise_colour + scatter),
            (0.5 - sign_changes) / (0.5 * POLICY.noise_colour + 0.5 * scatter),
        ]
    )
    return Adequacy(
        p_value=p_value(statistic),
        chi2_fit=everything.chi2(),
        chi2_holdout=chi2["held out"].chi2() if held_out else None,
        lag1=lag1,
        sign_changes=sign_changes,
        by_sensor={n: s.chi2() for n, s in by_sensor.items()},
        by_phase={n: s.chi2() for n, s in parts.items()},
        statistic=statistic,
        unstructured=lag1 <= POLICY.noise_colour + scatter and all(_is_even(s, everything) for s in chi2.values()),
    )


def pooled(by_record: Mapping[str, Adequacy], counts: Sequence[int]) -> Adequacy:
    """Whether one model explains several records: chi-squares pooled, the p-value that of the worst record.

    by_record : name of a record -> adequacy of the model there;  counts : (record,) numbers of fitted samples

    The smallest of n independent p-values is below p with the probability 1 - (1 - p)^n (Sidak 1967).
    """
    adequacies = list(by_record.values())

    def mean(values: Sequence[float]) -> float:
        return float(np.average(values, weights=np.array(counts, dtype=float)))

    held_out = [a.chi2_holdout for a in adequacies if a.chi2_holdout is not None]
    return Adequacy(
        p_value=-math.expm1(len(adequacies) * math.log1p(-min(a.p_value for a in adequacies))),
        chi2_fit=mean([a.chi2_fit for a in adequacies]),
        chi2_holdout=float(np.mean(held_out)) if held_out else None,
        lag1=mean([a.lag1 for a in adequacies]),
        sign_changes=mean([a.sign_changes for a in adequacies]),
        by_sensor={f"{n}, {k}": v for n, a in by_record.items() for k, v in a.by_sensor.items()},
        by_phase={f"{n}, {k}": v for n, a in by_record.items() for k, v in a.by_phase.items()},
        statistic=max(a.statistic for a in adequacies),
        unstructured=all(a.unstructured for a in adequacies),
    )


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


def _scores(samples: PredictedSamples) -> _Scores:
    scored = likelihood(samples.channel.intervals, samples.mean_K, samples.spread_K)
    return _Scores(np.asarray(samples.time_s), scored.score**2, scored.information)


def _joined(scores: Sequence[_Scores]) -> _Scores:
    time_s = np.concatenate([s.time_s for s in scores])
    order = np.argsort(time_s, kind="stable")
    square, information = (np.concatenate([getattr(s, f) for s in scores]) for f in ("square", "information"))
    return _Scores(time_s[order], square[order], information[order])


def _parts(everything: _Scores, *, part_count: int = 8) -> dict[str, _Scores]:
    """Consecutive parts with as many samples each, by their times.

    part_count : consecutive parts of a record that are judged by themselves
    """
    phases = {}
    for index in np.array_split(np.arange(len(everything.time_s)), part_count):
        if len(index) >= FEWEST:
            phase = everything.select(index)
            phases[f"{phase.time_s[0]:.0f} to {phase.time_s[-1]:.0f} s"] = phase
    return phases


def _excess(scores: _Scores, rho: float) -> float:
    """Excess chi-square over its scatter."""
    n = max(len(scores.time_s), 1)
    scatter = math.sqrt(2.0 * (1.0 + rho**2) / ((1.0 - rho**2) * n))
    return (scores.chi2() - 1.0) / (POLICY.model_error_chi2 + scatter)


def _is_even(scores: _Scores, everything: _Scores) -> bool:
    """Whether the chi-square of a part is not far above that of the whole record."""
    n = len(scores.time_s)
    return n < FEWEST or scores.chi2() <= everything.chi2() * (1.0 + POLICY.uneven_chi2 + 3.0 * math.sqrt(2.0 / n))


def _neighbours(everything: Sequence[PredictedSamples]) -> tuple[float, float]:
    """Autocorrelation of neighbouring normalised residuals within each channel, and the share that changes sign [-]."""
    products, squares, changes, pairs = 0.0, 0.0, 0, 0
    for s in everything:
        score = likelihood(s.channel.intervals, s.mean_K, s.spread_K)
        z = score.score / np.sqrt(np.where(score.information > 0.0, score.information, np.inf))
        products, squares = products + float(z[1:] @ z[:-1]), squares + float(z @ z)
        if s.channel.sensor.lsb_K > s.sigma_K:
            continue  # the sign of a coarse word's residual is that of the place within the word, for many samples
        changes, pairs = changes + int(np.count_nonzero(z[1:] * z[:-1] < 0.0)), pairs + len(z) - 1
    return products / squares if squares > 0.0 else 0.0, changes / pairs if pairs > 0 else 0.5
