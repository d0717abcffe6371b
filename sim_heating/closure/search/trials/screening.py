"""Screening of candidates: which are fitted on top of a model, and how far.

Candidates start where they have no effect yet. There the gain of a candidate follows from its sensitivities alone; the
best starts of each are then fitted side by side, and those that fall behind are stopped after some steps.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from sim_heating.base.arrays import BoolArray, FloatArray
from sim_heating.base.parallel.processes import in_shares
from sim_heating.base.parameters import EFFECT_PREFIX, Parameter
from sim_heating.closure.search.trials import trial_fit
from sim_heating.closure.search.trials.candidates import Candidate, Form
from sim_heating.closure.search.trials.trial_fit import TrialFit, delta_bic
from sim_heating.closure.verdict.policy import EFFORT, POLICY
from sim_heating.estimation.inference.error_likelihood import ScoredReadings, scored_readings
from sim_heating.estimation.inference.identifiability import covariance, predicted_gain
from sim_heating.estimation.inference.likelihood import likelihood
from sim_heating.estimation.inference.newton import Evaluation, Fit, NewtonSettings, Status
from sim_heating.estimation.problem import FitProblem
from sim_heating.estimation.side_by_side import JointMarch, maximise_together


def predicted_gains(base: TrialFit, candidates: Sequence[Candidate]) -> list[float]:
    """Gain in log likelihood that a linearisation at each candidate's start predicts, the base's parameters adjusted.

    returns : minus infinity where the model cannot be marched at the start

    The base's own sensitivities are used for all of them, since a candidate has no or little effect at its start, and
    its priors: what a candidate gains is gained of likelihood and prior density together.
    """
    sensitivity = np.concatenate([s.sensitivity for s in base.problem.samples(base.fit.values)])
    limit = _largest_gain(base)
    return in_shares(
        lambda chosen: _predicted_gains(base, [candidates[k] for k in chosen], sensitivity, limit), len(candidates)
    )


def _predicted_gains(
    base: TrialFit, candidates: Sequence[Candidate], sensitivity: FloatArray, limit: float
) -> list[float]:
    """Predicted gain of each candidate.

    sensitivity : (sample, parameter) sensitivities of the base [K over the unit]
    limit       : largest gain of any model [-]
    """
    record_fit, start = base.record_fit, trial_fit.fitted_values(base)
    fixed = {n: start[n] for n in record_fit.march_names if not n.startswith(EFFECT_PREFIX)}
    problems = [
        trial_fit.candidate_problem(
            base, record_fit, c, tuple(dict.fromkeys((*record_fit.sensor_names, *c.active))), fixed=fixed
        )
        for c in candidates
    ]
    firsts = [trial_fit.start_values(p, {**start, **c.start}) for p, c in zip(problems, candidates, strict=True)]
    to_mean = trial_fit.declared_values(base.problem) - base.fit.values
    # at their starts many candidates predict the same, which is scored once
    marched, scored = JointMarch(problems).march(firsts), dict[bytes, ScoredReadings]()
    gains = []
    for candidate, problem, first, done in zip(candidates, problems, firsts, marched, strict=True):
        # a parameter of the base that a candidate frees of its prior is the candidate's own
        outer = {*record_fit.sensor_names, *candidate.active}
        inner = [k for k, n in enumerate(record_fit.names) if n not in outer]
        of_base = sensitivity[:, inner], base.fit.prior_information[inner], to_mean[inner]
        begin, reached = _predicted_likelihoods(problem, first, of_base, scored) if done else (-np.inf, -np.inf)
        gains.append(min(reached - base.fit.log_likelihood, limit + min(begin - base.fit.log_likelihood, 0.0)))
    return gains


def gains_from(base: TrialFit, candidates: Sequence[Candidate]) -> list[float]:
    """Gain in log likelihood that one Gauss-Newton step predicts from starts where candidates have an effect already.

    returns : minus infinity where the model cannot be marched there

    The gain that the start has made already counts, where it is more; of starts that promise the same, those that have
    gained most come first.
    """
    tie = 1e-6  # weight of the gain that a start has made already where several promise the same
    problems = [trial_fit.problem_with(base, c) for c in candidates]
    firsts = [
        trial_fit.start_values(p, {**trial_fit.fitted_values(base), **c.start})
        for p, c in zip(problems, candidates, strict=True)
    ]
    limit, gains = _largest_gain(base), []
    for problem, first, here in zip(problems, firsts, JointMarch(problems).evaluate(firsts), strict=True):
        gained = here.log_likelihood - base.fit.log_likelihood
        if not np.isfinite(gained):
            gains.append(-np.inf)
            continue
        promised = gained + gain_of_step(problem.parameters, first, here)
        gains.append(max(gained, min(promised, limit)) + tie * gained)
    return gains


def gain_of_step(parameters: Sequence[Parameter], vector: FloatArray, evaluation: Evaluation) -> float:
    """Gain in log likelihood that a Gauss-Newton step predicts, the priors of the parameters included [-].

    vector : (parameter,) values that were evaluated;  evaluation : log likelihood there, with gradient and information

    Parameters on a bound that the gradient pushes beyond it stay there.
    """
    prior = np.array([p.sigma**-2.0 for p in parameters])
    gradient = evaluation.gradient + prior * (np.array([p.value for p in parameters]) - vector)
    lower, upper = (np.array([getattr(p, end) for p in parameters]) for end in ("lower", "upper"))
    free = ~(((vector <= lower) & (gradient <= 0.0)) | ((vector >= upper) & (gradient >= 0.0)))
    information = (evaluation.information + np.diag(prior))[np.ix_(free, free)]
    return predicted_gain(gradient[free], covariance(information))


def _largest_gain(base: TrialFit) -> float:
    """Gain in log likelihood of a model that predicts every reading as it is: more is predicted only beyond the linear
    range.

    A declared transition is started from onsets all over the flight, where it may change temperatures by hundreds of
    kelvin; the prediction of such a start knows no bounds. What a start loses is taken off as well, so that of many
    such starts those near the readings are fitted.
    """
    largest = 0.0
    for s in base.problem.samples(base.fit.values):
        readings = s.channel.intervals
        middle = np.where(readings.is_finite, readings.centre_K, s.mean_K)
        largest += float(np.sum(likelihood(readings, middle, s.spread_K).log_likelihood))
    return max(largest - base.fit.log_likelihood, 0.0) + POLICY.gain_margin


def _predicted_likelihoods(
    problem: FitProblem,
    first: FloatArray,
    of_base: tuple[FloatArray, FloatArray, FloatArray],
    scored: dict[bytes, ScoredReadings],
) -> tuple[float, float]:
    """Log likelihood at the start, and after a Gauss-Newton step with what the base gains of its prior density.

    of_base : of its parameters, (sample, k) sensitivities, prior information, and distance to the means of the priors
    scored  : readings scored so far, by their predictions
    """
    channels = problem.samples(first)
    key = b"".join(s.mean_K.tobytes() for s in channels)
    if key not in scored:
        scored[key] = scored_readings(channels[0].record_fit, [s.mean_K for s in channels])
    readings = scored[key]
    sensitivity = np.concatenate([s.sensitivity for s in channels])
    gradient, information = readings.score @ sensitivity, readings.weight @ sensitivity**2
    lower = np.array([p.lower for p in problem.parameters])
    upper = np.array([p.upper for p in problem.parameters])
    # A parameter that starts on its bound and is pushed beyond it cannot contribute to the gain.
    on_bound = ((first <= lower) & (gradient <= 0.0)) | ((first >= upper) & (gradient >= 0.0))
    base_sensitivity, prior_information, to_mean = of_base
    J = np.column_stack([base_sensitivity, sensitivity[:, ~on_bound & (information > 0.0)]])
    M, g = readings.information(J), J.T @ readings.score
    count = len(prior_information)
    M[range(count), range(count)] += prior_information
    g[:count] += prior_information * to_mean
    return readings.log_likelihood, readings.log_likelihood + predicted_gain(g, covariance(M))


def select_candidates(
    candidates: Sequence[Candidate], gains: Sequence[float], n: int, *, every_effect: bool = False
) -> list[int]:
    """Indices of the candidates that are fitted: the most promising starts of each form.

    Left out are candidates that predict much less gain than the best, or less than their parameters cost.
    gains : predicted gain of each;  n : number of samples
    every_effect : whether the best start of each effect is fitted, however much more another one predicts
    """
    best = max(gains, default=0.0)
    count: dict[Form, int] = {}
    selected = []
    effects = set[str]()
    for i in sorted(range(len(candidates)), key=lambda i: -gains[i]):
        form, name = candidates[i].form, candidates[i].name
        # A weak candidate is not worth a second start.
        allowed = EFFORT.starts if gains[i] > POLICY.min_of_best * best else 1
        least = 0.0 if every_effect and name not in effects else POLICY.min_promised * best
        promising = gains[i] > max(least, 0.5 * np.log(n) * len(candidates[i].names) - POLICY.gain_margin)
        if promising and count.get(form, 0) < allowed:
            count[form] = count.get(form, 0) + 1
            effects.add(name)
            selected.append(i)
    return selected


class Stage(NamedTuple):
    """A stage of a staged fit.

    settings : of the fits in it
    enters   : from the (fit,) gains after each stage so far [-] and the fits, (fit,) which of them go on
    """

    settings: NewtonSettings
    enters: Callable[[Sequence[FloatArray], Sequence[Fit]], BoolArray]


def fit_staged(
    maximise: Callable[[Sequence[int], Sequence[FloatArray], NewtonSettings], list[Fit]],
    starts: Sequence[FloatArray],
    settings: NewtonSettings,
    stages: Sequence[Stage],
    reached: float,
) -> list[Fit]:
    """Fit all models a few steps, and the promising ones further in each stage.

    maximise : fits of models, by their numbers, from (parameter,) vectors, side by side
    starts   : (model,) vectors to start from;  settings : of the first steps, which all models take
    reached  : log likelihood that gains are over [-]

    A hundred starts screened by their sensitivities cost about as much as one fit; most of the time of a search goes
    into the fits that follow, hence their stages.
    """
    fits = maximise(range(len(starts)), starts, settings)
    history = [gains_over(fits, reached)]
    for stage in stages:
        chosen = [int(k) for k in np.flatnonzero(stage.enters(history, fits))]
        for k, fit in zip(chosen, maximise(chosen, [fits[k].values for k in chosen], stage.settings), strict=True):
            fits[k] = fit
        history.append(gains_over(fits, reached))
    return fits


def fit_in_stages(
    bases: Sequence[TrialFit],
    candidates: Sequence[Candidate],
    predicted: Sequence[float],
    reached: float,
    *,
    by_effect: bool = False,
) -> list[TrialFit]:
    """Fit all candidates a few steps, the promising ones further, and to the end those that can still be the best.

    bases     : by candidate, the model that it is fitted on top of, from the values of that and its own start
    predicted : gain in log likelihood of each, predicted at its start
    reached   : log likelihood that gains are over: of the likeliest base
    by_effect : whether the best fit of each effect goes on with half the gain of the best of all
    returns   : by candidate, its trial, without samples held out
    """
    # of the best gain, that a candidate has to have reached to enter each stage after the first
    fractions = (0.9, 0.5, 0.8)
    # a candidate also enters the second stage with a gain, predicted at its start, of this part of the best
    min_predicted = 0.8
    problems = [trial_fit.problem_with(b, c) for b, c in zip(bases, candidates, strict=True)]
    starts = [{**trial_fit.fitted_values(b), **c.start} for b, c in zip(bases, candidates, strict=True)]
    names = [c.name for c in candidates] if by_effect else []

    def promising(history: Sequence[FloatArray], fits: Sequence[Fit]) -> BoolArray:
        # Patience at first: on a curved ridge between the size of an effect and the magnitude of the table the first
        # steps gain little.
        gains, best = history[-1], _best(history)
        enters = (gains >= fractions[0] * best) | (np.array(predicted) >= min_predicted * best)
        enters |= gains_ahead(gains, fits) >= best
        for name in set(names):
            leads = max((k for k, n in enumerate(names) if n == name), key=lambda k: gains[k])
            enters[leads] |= gains[leads] >= POLICY.min_of_best * best
        return enters & _unfinished(fits)

    def near(history: Sequence[FloatArray], fits: Sequence[Fit]) -> BoolArray:
        gains, best = history[-1], _best(history)
        leading = (gains >= fractions[1] * best) & (gains_ahead(gains, fits) >= best - POLICY.gain_margin)
        return np.asarray(leading & _unfinished(fits))

    def can_be_best(history: Sequence[FloatArray], fits: Sequence[Fit]) -> BoolArray:
        gains, best = history[-1], _best(history)
        ends = np.minimum(_extrapolated(history), gains_ahead(gains, fits, steps=1.0))
        leading = (gains >= fractions[2] * best) & (ends >= best - POLICY.gain_margin)
        return np.asarray(leading & _unfinished(fits))

    def maximise(numbers: Sequence[int], vectors: Sequence[FloatArray], settings: NewtonSettings) -> list[Fit]:
        return maximise_together([problems[k] for k in numbers], vectors, settings)

    few, more_steps = replace(trial_fit.QUICK, iterations=4), replace(trial_fit.QUICK, iterations=8)
    stages = [Stage(more_steps, promising), Stage(more_steps, near), Stage(trial_fit.QUICK, can_be_best)]
    vectors = [trial_fit.start_values(*p) for p in zip(problems, starts, strict=True)]
    fits = fit_staged(maximise, vectors, few, stages, reached)
    return [
        TrialFit(c.name, c, p, None, f, delta_bic(b, f, c, 1.0))
        for b, c, p, f in zip(bases, candidates, problems, fits, strict=True)
    ]


def _best(history: Sequence[FloatArray]) -> float:
    """Largest gain after the last stage, 0 at least [-]."""
    return float(np.max(history[-1], initial=0.0))


def _unfinished(fits: Sequence[Fit]) -> BoolArray:
    """(fit,) whether a fit ended for the number of its steps alone."""
    return np.array([f.status is Status.ITERATIONS for f in fits], dtype=bool)


def gains_ahead(gains: FloatArray, fits: Sequence[Fit], *, steps: float = 3.0) -> FloatArray:
    """(fit,) gains after a number of further steps like the next one [-]."""
    return np.asarray(gains + steps * np.array([f.predicted_gain for f in fits]))


def gains_over(fits: Sequence[Fit], base: float) -> FloatArray:
    """(fit,) log likelihood gained over the base; minus infinity where a fit could not be marched."""
    return np.nan_to_num([f.log_likelihood - base for f in fits], nan=-np.inf)


def _extrapolated(history: Sequence[FloatArray]) -> FloatArray:
    """(fit,) where gains end if each stage adds the same fraction of the one before it, with twice that allowed."""
    with np.errstate(invalid="ignore", divide="ignore"):
        before, last = history[-2] - history[-3], history[-1] - history[-2]
        remaining = np.where(last < before, last**2 / (before - last), np.where(last > 0.0, np.inf, 0.0))
    return history[-1] + 2.0 * np.nan_to_num(remaining, nan=np.inf, posinf=np.inf)
