"""p-value of a model with an error: its statistic among those of records that are made with it.

The calibrated distribution of the statistic (adequacy.py) is that of exact models. With an error, a coarse recorder
word or slow noise it is another one. So records are made with the model: sizes of the heating's and the flight's error
from what the readings say of them, an error, noise and rounding drawn, and judged as the record itself is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.special import betaincinv

from sim_heating.base.arrays import FloatArray
from sim_heating.closure.search.trials.trial_fit import TrialFit
from sim_heating.closure.verdict.adequacy import Adequacy, assess
from sim_heating.closure.verdict.policy import POLICY
from sim_heating.estimation.inference.error_likelihood import innovations_of_several
from sim_heating.estimation.inference.likelihood import reading_intervals
from sim_heating.estimation.inference.model_error import ModelError
from sim_heating.estimation.record_fit import PredictedSamples, RecordFit


def with_simulated_p_value(
    trial: TrialFit, adequacy: Adequacy, members: int = 1, *, batch: int = 200, most: int = 2000
) -> Adequacy:
    """The adequacy of a trial's model with its p-value from records made with it; as it is for an exact model.

    adequacy : of the record itself, with its statistic
    members  : records that have the model in common;  batch, most : records that are made at once and at most for each

    Records are made until the 95 % interval of the p-value is on one side of `Policy.adequate_p` (Besag and Clifford
    1991: sequential Monte Carlo tests). Noise above the declared one is no explanation here: the filter that takes up
    the error leaves innovations without structure where a model is wrong, too.
    """
    if trial.record_fit.model_error is None or trial.size is None:
        return adequacy
    rng, larger, made = np.random.default_rng(20261128), 0, 0
    while made < most * members and _may_be(POLICY.adequate_p, larger, made):
        statistics = _statistics(trial, batch * members, rng)
        made, larger = made + len(statistics), larger + int(np.count_nonzero(statistics >= adequacy.statistic))
    return replace(adequacy, p_value=(larger + 1.0) / (made + 1.0), unstructured=False)


def _may_be(p: float, larger: int, made: int) -> bool:
    """Whether the 95 % interval of a share, `larger` of `made`, holds p (Clopper and Pearson 1934)."""
    low = 0.0 if larger == 0 else betaincinv(larger, made - larger + 1.0, 0.025)
    high = 1.0 if larger == made else betaincinv(larger + 1.0, made - larger, 0.975)
    return bool(low <= p <= high)


def _statistics(trial: TrialFit, count: int, rng: np.random.Generator) -> FloatArray:
    """(record,) statistics of the adequacy of records made with a trial's model, which has an error."""
    record_fit, size = trial.record_fit, trial.size
    assert record_fit.model_error is not None  # the caller's model has one
    assert size is not None
    probability = size.posterior
    drawn = rng.choice(probability.size, size=count, p=probability.ravel())
    indices = zip(*np.unravel_index(drawn, probability.shape), strict=True)
    errors = [
        record_fit.model_error.of_size(float(size.sizes[k]), float(size.times_s[i]), float(size.scales[j]))
        for j, i, k in indices
    ]
    unknowns = record_fit.error_responses_K[1].shape[1] + len(record_fit.model_error.time_s)
    u = rng.standard_normal((count, unknowns))
    fitted = _read(record_fit, trial.problem.samples(trial.fit.values), errors, u, rng)
    predicted, state = innovations_of_several(record_fit, fitted)
    others: list[list[PredictedSamples]] = [[] for _ in errors]
    if trial.held_out is not None and trial.held_out_chi2 > 0.0:
        there = trial.held_out.record_fits[0]
        read = _read(there, trial.held_out.samples(trial.fit.values), errors, u, rng)
        others, _ = innovations_of_several(there, read, state)
    return np.array([assess(*pair).statistic for pair in zip(predicted, others, strict=True)])


def _read(
    record_fit: RecordFit,
    samples: Sequence[PredictedSamples],
    errors: Sequence[ModelError],
    u: FloatArray,
    rng: np.random.Generator,
) -> list[list[PredictedSamples]]:
    """By error, channels with readings made with it, with noise and as the recorder rounds them.

    u : (error, unknown) in standard deviations [-]
    """
    (S, F), own = record_fit.error_responses_K, record_fit.model_error
    assert own is not None  # the caller's record has one
    ends, readings, directions = np.cumsum([len(s.mean_K) for s in samples])[:-1], [], own.flight_K.shape[-1]
    for error, unknowns in zip(errors, u, strict=True):
        others = unknowns[len(error.time_s) :].copy()
        others[:directions] *= error.flight_scale / own.flight_scale
        moved = np.split(S @ error.heating(unknowns) + F @ others, ends)
        channels = []
        for s, d in zip(samples, moved, strict=True):
            read = s.mean_K + d + s.sigma_K * rng.standard_normal(len(s.mean_K))
            channels.append(replace(s, channel=replace(s.channel, intervals=reading_intervals(s.channel.sensor, read))))
        readings.append(channels)
    return readings
