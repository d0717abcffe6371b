"""p-value of a model with an error: its statistic among those of records that are made with it.

The calibrated distribution of the statistic (adequacy.py) is that of exact models. With an error, a coarse recorder
word or slow noise it is another one. So records are made with the model: sizes of the heating's and the flight's error
from what the readings say of them, an error, noise and rounding drawn, and judged as the record itself is.

An error starts anew where that of the model does. Of one that does nowhere the covariance is known: an error that
stays as it is, and in each interval dt jumps to another value with the probability 1 - exp(-dt / tau), as that of a
trajectory that was put together from arcs, has the covariance of the smooth one (docs/theory/model_error.md, equation
6b). Its innovations scatter more. The p-value is then the larger one of both.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.closure.prior.model_error import heating_error_prior
from sim_heating.closure.search.trials.trial_fit import TrialFit
from sim_heating.closure.verdict.adequacy import Adequacy, statistics
from sim_heating.closure.verdict.policy import POLICY
from sim_heating.estimation.inference.error_likelihood import innovations
from sim_heating.estimation.inference.likelihood import reading_intervals
from sim_heating.estimation.inference.model_error import Correlation, ModelError
from sim_heating.estimation.record_fit import PredictedSamples, RecordFit


def with_simulated_p_value(trial: TrialFit, adequacy: Adequacy, members: int = 1) -> Adequacy:
    """The adequacy of a trial's model with its p-value from records made with it; as it is for an exact model.

    adequacy : of the record itself, with its statistic
    members : records that have the model in common

    Of either distribution records are made until the 95 % interval of the p-value is on one side of `Policy.adequate_p`
    (Besag and Clifford 1991: sequential Monte Carlo tests). Noise above the declared one is no explanation here: the
    filter that takes up the error leaves innovations without structure where a model is wrong, too.
    """
    batch, most = 200, 2000  # records that are made at once and at most for each
    if trial.record_fit.model_error is None or trial.size is None:
        return adequacy
    rng, p_values = np.random.default_rng(20261128), []
    may_jump = not trial.record_fit.model_error.correlation.breaks_s
    for draw in (slow_errors, jumping_errors) if may_jump else (slow_errors,):
        larger = made = 0
        while made < most * members and _may_be(POLICY.adequate_p, larger, made):
            of_records = _statistics(trial, draw, batch * members, rng)
            made, larger = made + len(of_records), larger + int(np.count_nonzero(of_records >= adequacy.statistic))
        p_values.append((larger + 1.0) / (made + 1.0))
        if p_values[-1] >= POLICY.adequate_p:
            break
    return replace(adequacy, p_value=max(p_values), noise_scale=1.0)


def _may_be(p: float, larger: int, made: int) -> bool:
    """Whether the 95 % interval of a share, `larger` of `made`, holds p (Clopper and Pearson 1934)."""
    from scipy.stats import binomtest

    if made == 0:
        return True
    interval = binomtest(larger, made).proportion_ci(0.95, method="exact")
    return bool(interval.low <= p <= interval.high)


def slow_errors(error: ModelError, correlation: Correlation, count: int, rng: np.random.Generator) -> FloatArray:
    """(knot, record) Gauss-Markov errors of the heating, of size 1.

    Source: docs/theory/model_error.md, equation 1.
    """
    return np.asarray(correlation.root(error.time_s) @ rng.standard_normal((len(error.time_s), count)))


def jumping_errors(error: ModelError, correlation: Correlation, count: int, rng: np.random.Generator) -> FloatArray:
    """(knot, record) errors of the heating that jump, of size 1.

    Source: docs/theory/model_error.md, equation 6b.
    """
    values = rng.standard_normal((len(error.time_s), count))
    stays = np.exp(-np.diff(error.time_s, prepend=-np.inf) / correlation.time_s)[:, np.newaxis]
    jumps = rng.random(values.shape) >= stays
    last = np.maximum.accumulate(np.where(jumps, np.arange(len(values))[:, np.newaxis], 0), axis=0)
    return np.take_along_axis(values, last, axis=0)


def _statistics(
    trial: TrialFit,
    draw: Callable[[ModelError, Correlation, int, np.random.Generator], FloatArray],
    count: int,
    rng: np.random.Generator,
) -> FloatArray:
    """(record,) statistics of the adequacy of records made with a trial's model, which has an error.

    draw : errors of the heating of size 1: model's error, its correlation, their number, random numbers
    """
    record_fit, error, size = trial.record_fit, trial.record_fit.model_error, trial.size
    prior = heating_error_prior(record_fit.record)
    assert error is not None  # the caller's model has one
    assert size is not None
    longest_s = math.inf if prior is None else prior.longest_s  # an error that stays longer jumps at its breaks alone
    scale, kind, of_heating = np.unravel_index(
        rng.choice(size.posterior.size, size=count, p=size.posterior.ravel()), size.posterior.shape
    )
    heating = np.empty((len(error.time_s), count))
    for k, n in zip(*np.unique(kind, return_counts=True), strict=True):
        correlation = replace(size.correlations[k], breaks_s=error.correlation.breaks_s)
        drawn = slow_errors if correlation.time_s > longest_s else draw
        heating[:, kind == k] = drawn(error, correlation, int(n), rng)
    heating *= size.sizes[of_heating]
    flight = rng.standard_normal((record_fit.error_responses_K[1].shape[1], count))
    flight[: error.flight_K.shape[-1]] *= size.scales[scale] / error.flight_scale
    fitted, state = innovations(
        record_fit, _read(record_fit, trial.problem.samples(trial.fit.values), heating, flight, rng)
    )
    held_out: list[PredictedSamples] = []
    if trial.held_out is not None and trial.held_out_chi2 > 0.0:
        there = trial.held_out.record_fits[0]
        read = _read(there, trial.held_out.samples(trial.fit.values), heating, flight, rng)
        held_out, _ = innovations(there, read, state)
    return statistics(fitted, held_out)


def _read(
    record_fit: RecordFit,
    samples: Sequence[PredictedSamples],
    heating: FloatArray,
    flight: FloatArray,
    rng: np.random.Generator,
) -> list[PredictedSamples]:
    """Channels with the readings of (record,) records that are made with an error, with noise and as rounded.

    heating : (knot, record) error of the heating [-];  flight : (unknown, record) all else of the error [-]
    """
    S, F = record_fit.error_responses_K
    moved = np.split(S @ heating + F @ flight, np.cumsum([len(s.mean_K) for s in samples])[:-1])
    channels = []
    for s, d in zip(samples, moved, strict=True):
        plain_K = s.mean_K + s.channel.noise_K(s.sigma_K) * rng.standard_normal(d.shape[::-1])
        read = plain_K.T + d
        channels.append(replace(s, channel=replace(s.channel, intervals=reading_intervals(s.channel.sensor, read))))
    return channels
