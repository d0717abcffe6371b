"""Hypotheses that are no aerothermal effect: the record itself is other than declared.

A wrong density, a layer of another thickness or two swapped thermocouples are a change of the record's flight, wall or
sensors. A change has one continuous unknown v or none, such as a swap. The model of a trial fit is fitted to the
changed record together with v: its parameters have the sensitivities of the march, v has that of the difference

    dT/dv = (T(v + h) - T(v)) / h

of two marches side by side, and Newton's iteration is that of every other fit. Likelihoods can be compared with those
of effects on the same model: samples, noise and mesh correction are the same. Before a fit, one such step predicts what
it can gain; changes that predict little are not fitted.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cached_property, partial
from itertools import groupby

import numpy as np

from sim_heating.base.arrays import BoolArray, FloatArray, IntArray
from sim_heating.base.errors import InputError, RunError
from sim_heating.base.parallel.processes import in_processes, in_shares, in_turn
from sim_heating.base.parameters import Parameter
from sim_heating.closure.search.trials import trial_fit
from sim_heating.closure.search.trials.candidates import NO_EFFECT
from sim_heating.closure.search.trials.change import RecordChange
from sim_heating.closure.search.trials.screening import Stage, fit_staged, gain_of_step, gains_ahead, gains_over
from sim_heating.closure.search.trials.trial_fit import TrialFit
from sim_heating.closure.verdict.policy import EFFORT, POLICY
from sim_heating.estimation.fit import FitResult
from sim_heating.estimation.inference.error_likelihood import scored_readings
from sim_heating.estimation.inference.newton import Evaluation, Fit, NewtonSettings, iteration
from sim_heating.estimation.problem import FitProblem
from sim_heating.estimation.record_fit import FittedChannel
from sim_heating.estimation.side_by_side import JointMarch, iterate_together
from sim_heating.inputs.record import Record

ENDS_MOVED = (0.5, 0.5, 0.25, 0.25, 0.12, 0.12, 0.06, 0.06)
"""Parts of the span of a change by which its ends are moved, one after the other, each time to where it gains most."""
CANNOT_BE = (InputError, RunError)
"""What a record raises that a change makes impossible: such a change explains nothing, and ends no search."""


class _ChangedModel:
    """A trial fit's model on a changed record: a problem of the base's parameters and, last, that of the change.

    Such is a change without a parameter, and one whose parameter is of the point's model or of a sensor: the problem
    has its exact sensitivity.

    raises : InputError where the change has a parameter without a finite standard deviation
    """

    def __init__(self, base: TrialFit, change: RecordChange) -> None:
        self.base, self.change = base, change
        self.parameters, self.names = list(base.problem.parameters), base.record_fit.names
        if change.parameter is not None:
            if not 0.0 < change.parameter.sigma < np.inf:
                raise InputError(f"{change.what}: its parameter needs a finite sigma above 0")
            self.parameters.append(replace(change.parameter, sigma=trial_fit.WIDENED * change.parameter.sigma))
            if change.in_model:
                self.names = (*self.names, change.parameter.name)

    def start(self, value: float, *, declared: bool = False) -> FloatArray:
        """Vector of the base's estimates, or of its declared values, and a value of the change."""
        first = trial_fit.declared_values(self.base.problem) if declared else self.base.fit.values
        return first if self.change.parameter is None else np.append(first, value)

    def split(self, vector: FloatArray) -> tuple[FloatArray, float]:
        """Parameters of the base's model, and value of the change."""
        return (vector, 0.0) if self.change.parameter is None else (vector[:-1], float(vector[-1]))

    def changed(self, record: Record, value: float) -> Record:
        """A record changed by a value; as it is where the value is a parameter of its model."""
        return record if self.change.in_model else self.change.apply(record, value)

    def problem(self, value: float) -> FitProblem:
        """The base's problem on the record changed by a value; one for all values here."""
        return self._problem

    @cached_property
    def _problem(self) -> FitProblem:
        return self._problem_at(self.change.neutral)

    def _problem_at(self, value: float) -> FitProblem:
        record_fit = self.base.record_fit
        record = self.changed(record_fit.record, value)
        problem = trial_fit.candidate_problem(self.base, record_fit, NO_EFFECT, self.names, record)
        problem.record_fits[0].known_log_likelihood += self.change.known_log_likelihood[0]
        return problem

    @cached_property
    def _order(self) -> IntArray:
        """(parameter,) places in a vector of the problem's parameters: those of clock and sensors follow the march's,
        one of a change among them."""
        names = self.problem(self.change.neutral).record_fits[0].names
        return np.array([self.names.index(n) for n in names], dtype=np.int64)

    def marches(self, vector: FloatArray) -> list[tuple[FitProblem, FloatArray]]:
        """Problems, each with its vector, that an evaluation needs marched."""
        return [(self._problem, vector[self._order])]

    def evaluate(self, vector: FloatArray) -> Evaluation:
        """Log likelihood, gradient and information at a vector whose marches are made (FitProblem.evaluate)."""
        evaluation, back = self._problem.evaluate(vector[self._order]), np.argsort(self._order)
        return Evaluation(
            evaluation.log_likelihood, evaluation.gradient[back], evaluation.information[np.ix_(back, back)]
        )

    def log_likelihoods(self, vectors: FloatArray) -> FloatArray:
        """(candidate,) log likelihoods of several vectors; NaN where a march fails."""
        return self._problem.log_likelihoods(vectors[:, self._order])

    def trial(self, fit: Fit) -> TrialFit:
        """The base's model on the record as changed by the value that was fitted."""
        value = self.split(fit.values)[1]
        held_out = trial_fit.held_out_problem_with(self.base, NO_EFFECT, self.names, lambda r: self.changed(r, value))
        if held_out is not None:
            held_out.record_fits[0].known_log_likelihood += self.change.known_log_likelihood[1]
        selected = fit.select(self._order, [fit.names[k] for k in self._order])
        return replace(self.base, problem=self.problem(value), held_out=held_out, fit=selected)


class _DifferencedModel(_ChangedModel):
    """A change whose parameter no model has: its sensitivity is the difference of two marches."""

    def __init__(self, base: TrialFit, change: RecordChange, parameter: Parameter) -> None:
        super().__init__(base, change)
        self.step, self.largest = 0.1 * parameter.sigma, parameter.upper  # h of the sensitivity, bound of the value
        self._problems: dict[float, FitProblem] = {}
        self._moved = base.problem

    def problem(self, value: float) -> FitProblem:
        """The base's problem on the record changed by a value."""
        if value == self.change.neutral:
            return self.base.problem
        if value not in self._problems:
            self._problems[value] = self._problem_at(value)
        return self._problems[value]

    def marches(self, vector: FloatArray) -> list[tuple[FitProblem, FloatArray]]:
        """The problem at the value, and the one that is a step away, each with its vector."""
        values, value = self.split(vector)
        self._problems = {v: p for v, p in self._problems.items() if v == value}
        problem = self.problem(value)
        record_fit = problem.record_fits[0]
        changed = self.change.apply(self.base.record_fit.record, self._stepped(value))
        # its temperatures alone are needed: the march has no sensitivities
        self._moved = trial_fit.candidate_problem(self.base, record_fit, NO_EFFECT, record_fit.sensor_names, changed)
        moved = self._moved.record_fits[0]
        # of the changed wall, at the same parameters
        moved.model = moved.model.with_parameters(
            dict(zip(record_fit.march_names, values[record_fit.index], strict=False))
        )
        return [(problem, values), (self._moved, values[len(record_fit.march_names) :])]

    def _stepped(self, value: float) -> float:
        """A value one step away, within the bounds."""
        return value + self.step if value + self.step <= self.largest else value - self.step

    def evaluate(self, vector: FloatArray) -> Evaluation:
        """Log likelihood, gradient and information at a vector whose marches are made."""
        values, value = self.split(vector)
        samples, m, step = self.problem(value).samples(values), len(self.parameters), self._stepped(value) - value
        moved = self._moved.samples(values[len(samples[0].record_fit.march_names) :])
        record_fit, by_channel = self.problem(value).record_fits[0], []
        for s, t in zip(samples, moved, strict=True):
            jacobian = np.zeros((len(s.mean_K), m))
            jacobian[:, s.record_fit.index] = s.sensitivity
            jacobian[:, -1] = _moved_K(s.mean_K, s.channel, t.mean_K, t.channel) / step
            by_channel.append(jacobian)
        sensitivity, scored = np.concatenate(by_channel), scored_readings(record_fit, [s.mean_K for s in samples])
        total = record_fit.known_log_likelihood + scored.log_likelihood
        return Evaluation(total, scored.score @ sensitivity, scored.information(sensitivity))

    def log_likelihoods(self, vectors: FloatArray) -> FloatArray:
        """(candidate,) log likelihoods of several vectors; NaN where a march fails."""
        return np.array([self._log_likelihood(*self.split(v)) for v in vectors])

    def _log_likelihood(self, values: FloatArray, value: float) -> float:
        try:
            return float(self.problem(value).log_likelihoods(values[np.newaxis])[0])
        except CANNOT_BE:
            return np.nan


def _with_free(base: TrialFit, names: Sequence[str]) -> TrialFit:
    """A trial with more parameters of its model free, at their nominal values; itself where they are free already."""
    fitted = base.record_fit.names
    if all(name in fitted for name in names):
        return base

    freed = trial_fit.unfitted(base, names=(*fitted, *names))
    parameters = freed.problem.parameters
    values = trial_fit.start_values(freed.problem, trial_fit.fitted_values(base))
    return replace(freed, fit=replace(base.fit, names=tuple(p.name for p in parameters), values=values))


def _model(base: TrialFit, change: RecordChange) -> _ChangedModel:
    """The model of a trial fit on a changed record."""
    base = _with_free(base, change.free)
    if change.parameter is None or change.in_model:
        return _ChangedModel(base, change)
    return _DifferencedModel(base, change, change.parameter)


def _moved_K(mean_K: FloatArray, channel: FittedChannel, moved_K: FloatArray, moved: FittedChannel) -> FloatArray:
    """(sample,) by how much predictions rise more than readings do, from one channel to another [K]."""
    with np.errstate(invalid="ignore"):
        risen_K = moved.intervals.centre_K - channel.intervals.centre_K
    return np.asarray(moved_K - mean_K - np.nan_to_num(risen_K, nan=0.0))


def _evaluate_together(models: Sequence[_ChangedModel], vectors: Sequence[FloatArray]) -> list[Evaluation]:
    """Evaluation of each model at its own vector, all marched side by side; NaN likelihood where a march failed."""
    needed = [_marches(model, vector) for model, vector in zip(models, vectors, strict=True)]
    failed = _failed_marches([pair for pairs in needed for pair in pairs or ()])
    return [
        _failed(len(model.parameters))
        if pairs is None or any(id(p) in failed for p, _ in pairs)
        else model.evaluate(vector)
        for model, vector, pairs in zip(models, vectors, needed, strict=True)
    ]


def _failed_marches(needed: Sequence[tuple[FitProblem, FloatArray]]) -> set[int]:
    """Ids of the problems whose marches at their vectors fail; those that are not made yet are made side by side."""
    # several models may need the same march: that of the record as declared
    distinct = {id(p): (p, v) for p, v in needed if not p.marches.has(v)}
    if not distinct:
        return set()
    problems, vectors = zip(*distinct.values(), strict=True)
    marched = JointMarch(problems).march(vectors)
    return {key for key, done in zip(distinct, marched, strict=True) if not done}


def _marches(model: _ChangedModel, vector: FloatArray) -> list[tuple[FitProblem, FloatArray]] | None:
    """The marches that an evaluation needs; None where there is no such record, as with a wall that has no mesh."""
    try:
        return model.marches(vector)
    except CANNOT_BE:
        return None


def _failed(parameters: int) -> Evaluation:
    """Evaluation where a march failed."""
    return Evaluation(np.nan, np.zeros(parameters), np.zeros((parameters, parameters)))


def _predicted(models: Sequence[_ChangedModel], vectors: Sequence[FloatArray]) -> list[tuple[float, float]]:
    """Log likelihood that one Gauss-Newton step from a vector predicts for each model, and that at the vector itself;
    minus infinity where a march failed."""

    def of_share(chosen: Sequence[int]) -> list[tuple[float, float]]:
        shared, starts = [models[k] for k in chosen], [vectors[k] for k in chosen]
        gains = []
        for model, at, here in zip(shared, starts, _evaluate_together(shared, starts), strict=True):
            reached = here.log_likelihood
            step = gain_of_step(model.parameters, at, here)
            gains.append((reached + step, reached) if np.isfinite(reached) else (-np.inf, -np.inf))
        return gains

    return in_shares(of_share, len(models))


def best_starts(base: TrialFit, changes: Sequence[RecordChange]) -> list[tuple[float, _ChangedModel, FloatArray]]:
    """Gain in log likelihood that one Gauss-Newton step predicts for each change, its model, and where that starts.

    base    : the model that the changes are tried with
    returns : by change, gain [-], model and vector, of the best of the neutral value and its starts; a gain of minus
              infinity where the changed record cannot be marched
    """
    starts = [(k, v) for k, c in enumerate(changes) for v in dict.fromkeys((c.neutral, *c.starts))]
    # one march as declared for all changes with the same free parameters
    freed = {free: _with_free(base, free) for free in {c.free for c in changes}}
    models = [_model(freed[changes[k].free], changes[k]) for k, _ in starts]
    vectors = [m.start(value) for m, (_, value) in zip(models, starts, strict=True)]
    predicted = _predicted(models, vectors)
    # A swap distorts the estimates: where the declared values are likelier with the change, it starts from these.
    for i, vector, reached in _from_declared(base, models, [value for _, value in starts]):
        if reached[1] > predicted[i][1]:
            vectors[i], predicted[i] = vector, reached
    of_changes = groupby(range(len(starts)), key=lambda i: starts[i][0])
    best = [max(of_change, key=lambda i: predicted[i][0]) for _, of_change in of_changes]
    return [(predicted[i][0] - base.fit.log_likelihood, models[i], vectors[i]) for i in best]


def _from_declared(
    base: TrialFit, models: Sequence[_ChangedModel], values: Sequence[float]
) -> list[tuple[int, FloatArray, tuple[float, float]]]:
    """Numbers of the models of a wrong sensor, their starts at the declared values, and what a step there predicts.

    values : of the change, by model;  returns : none where the model is not far from the record
    """
    gross_excess = 10.0  # excess chi-square from which on the estimates of a model may be distorted by a wrong sensor
    if not base.excess_chi2 > gross_excess:
        return []
    numbers = [i for i, m in enumerate(models) if m.change.kind == "sensor" and not m.change.in_model]
    starts = [models[i].start(values[i], declared=True) for i in numbers]
    predicted = _predicted([models[i] for i in numbers], starts)
    return list(zip(numbers, starts, predicted, strict=True))


def fit_changes(
    base: TrialFit,
    changes: Sequence[RecordChange],
    best_gain: float = 0.0,
    *,
    share: float = POLICY.min_promised,
    near_share: float = POLICY.min_promised,
    most: int | None = None,
) -> list[TrialFit]:
    """Fit a model to its record with each change that promises enough, all side by side.

    base      : the model, fitted to the record as declared
    best_gain : best gain in log likelihood that is known of other explanations [-]
    share     : part of that gain, or of what the best change predicts, below which a change is not fitted. Nor is one
                that predicts less than its unknowns cost
    near_share: the same for a change with ends, which gains more where they are moved
    most      : how many without ends are fitted, those that predict most; all by default
    returns   : fits, the lowest BIC first, one of each form; changes that cannot be marched are left out
    raises    : InputError where a change has a parameter without a finite standard deviation
    """

    def least_share(change: RecordChange) -> float:
        if change.parameter is None:
            return min(share, POLICY.min_of_best)
        return share if change.near is None else near_share

    chosen = _worth_fitting(base, best_starts(base, changes), best_gain, least_share, most)
    models, vectors = [model for model, _ in chosen], [start for _, start in chosen]
    fractions = np.array([least_share(m.change) for m in models])

    def promising(history: Sequence[FloatArray], fits: Sequence[Fit]) -> BoolArray:
        # Predictions are linear and promise too much: after some steps those that stay far behind are not fitted on.
        return np.asarray(gains_ahead(history[-1], fits) > fractions * max([best_gain, *history[-1]]))

    def maximise(numbers: Sequence[int], vectors: Sequence[FloatArray], settings: NewtonSettings) -> list[Fit]:
        return _maximise([models[k] for k in numbers], vectors, settings)

    nearly = 0.95  # part of the best gain from which on the ends of a change are searched further, each time with a fit
    few = replace(trial_fit.QUICK, iterations=5)
    fits = fit_staged(maximise, vectors, few, [Stage(trial_fit.QUICK, promising)], base.fit.log_likelihood)
    gains = gains_over(fits, base.fit.log_likelihood)
    reached = max([best_gain, *gains])
    with_ends = [k for k, m in enumerate(models) if m.change.near is not None]
    _move_ends(models, fits, [k for k in with_ends if gains[k] > near_share * reached])
    gains = gains_over(fits, base.fit.log_likelihood)
    largest = max([share * best_gain, *gains])
    _move_ends(models, fits, [k for k in with_ends if gains[k] > nearly * largest], EFFORT.rivals)
    trials = [_change_fit(m, f) for m, f in zip(models, fits, strict=True) if np.isfinite(f.log_likelihood)]
    return sorted((f for f in trials if f is not None), key=lambda f: f.delta_bic)


def _worth_fitting(
    base: TrialFit,
    predicted: Sequence[tuple[float, _ChangedModel, FloatArray]],
    best_gain: float,
    least_share: Callable[[RecordChange], float],
    most: int | None,
) -> list[tuple[_ChangedModel, FloatArray]]:
    """The model of one change of each form that promises enough, with its start.

    predicted   : by change, as `best_starts` gives it
    least_share : part of the best gain that a change has to promise
    """
    n, largest = trial_fit.sample_count(base.problem), max([best_gain, *(gain for gain, _, _ in predicted)])
    best: dict[str, tuple[float, _ChangedModel, FloatArray]] = {}
    for gain, model, start in predicted:
        change, form = model.change, model.change.form or model.change.what
        # what an effect names competes with it under that name: a step ahead promises too little of a shift in time
        least = min(least_share(change), POLICY.min_of_best if change.effect else 1.0) * largest
        promises = gain > max(least, 0.5 * np.log(n) * change.unknowns - POLICY.gain_margin)
        if promises and (form not in best or gain > best[form][0]):
            best[form] = gain, model, start
    leading = sorted((gain for gain, model, _ in best.values() if model.change.near is None), reverse=True)[:most]
    return [(m, start) for gain, m, start in best.values() if m.change.near is not None or gain in leading]


def with_own_corrections(baseline: FitResult, base: TrialFit, fits: Sequence[TrialFit]) -> list[TrialFit]:
    """Fits of changes, the leading ones with the mesh correction of their own record.

    baseline : the declared model fitted to the whole record;  base : the same for the search, which `fits` began with
    returns  : the lowest BIC first; as given where the declared model is near the record

    The correction at the declared model is of another wall, or at estimates that a wrong sensor distorts.
    """
    # excess chi-square of the declared model from which on the leading changes have the mesh correction of their own
    # record; those with a parameter where they gain the part `nearly` of the best
    min_excess = 1.0
    nearly = 0.95
    if base.excess_chi2 < min_excess:
        return list(fits)
    best = min((f.delta_bic for f in fits), default=0.0)
    leading = [f for f in fits[: EFFORT.rivals] if f.delta_bic < nearly * best or not f.estimates]
    trials = [f if f not in leading else _recorrected(baseline, base, f) for f in fits]
    return sorted(trials, key=lambda f: f.delta_bic)


def _recorrected(baseline: FitResult, base: TrialFit, trial: TrialFit) -> TrialFit:
    """The fit of a change with the mesh correction of the changed record, fitted on from there.

    The fit as it is where the whole record cannot be marched there.
    """
    change, fit, record_fit = trial.change, trial.whole_fit, trial.record_fit
    assert change is not None
    assert fit is not None
    names = [n for n in record_fit.names if n not in trial.estimates]
    try:
        record = change.apply(baseline.problem.record_fits[0].record, trial.value)
        thin = record_fit.record if not change.in_model else change.apply(record_fit.record, trial.value)
        correction = trial_fit.own_thinning_error(trial, record, thin, names)
    except CANNOT_BE:
        return trial
    if change.parameter is not None:
        model = _model(trial_fit.corrected(base, correction), change)
        return _change_fit(model, _maximise([model], [fit.values])[0]) or trial
    again = trial_fit.fitted_on(trial_fit.corrected(trial, correction), trial_fit.QUICK)
    return replace(again, whole_fit=again.fit)


def _move_ends(models: list[_ChangedModel], fits: list[Fit], chosen: Sequence[int], searches: int = 1) -> None:
    """Put the ends of some changes where the likelihood is largest, and renew these models and fits.

    chosen   : indices of the changes, which have ends
    searches : how often at most; a last one in finer steps follows where it is more than one
    """
    searched = [partial(_best_ends, models[k], fits[k], searches) for k in chosen]
    for k, (moves, fit) in zip(chosen, in_processes(searched), strict=True):
        for move in moves:
            models[k] = _model(models[k].base, _neighbours(models[k].change, move[0])[move[1]])
        fits[k] = fit


def _neighbours(change: RecordChange, fraction: float) -> list[RecordChange]:
    """The change with its ends moved by a fraction of its span; none of a change without ends."""
    return [] if change.near is None else list(change.near(fraction))


def _best_ends(model: _ChangedModel, fit: Fit, searches: int) -> tuple[list[tuple[float, int]], Fit]:
    """Moves of the ends of a change to where the likelihood is largest, each a fraction of the span and the number of a
    neighbour there, and the fit at the ends.

    A pattern search at the values of the fit, a fit at the ends found, and again from there while that gains.
    """
    # further on, where the change leads: some seconds of a large error are far above the noise
    finely = (0.06, 0.03, 0.015, 0.007, 0.06, 0.03, 0.015, 0.007)
    steps, moves = [ENDS_MOVED] * searches + [finely] * (searches > 1), list[tuple[float, int]]()
    while steps:
        moved, further = _pattern_search(model, fit, steps.pop(0))
        gained = 0.0
        if further:
            refitted = _maximise([moved], [fit.values])[0]
            gained = refitted.log_likelihood - fit.log_likelihood
            if gained > 0.0:
                model, fit, moves = moved, refitted, [*moves, *further]
        if not gained > POLICY.gain_margin:
            steps = [s for s in steps if s is not ENDS_MOVED]
    return moves, fit


def _pattern_search(
    model: _ChangedModel, fit: Fit, fractions: Sequence[float]
) -> tuple[_ChangedModel, list[tuple[float, int]]]:
    """The change with the ends that predict most from the values of a fit, and the moves to them.

    fractions : of the span by which the ends are moved, one after the other
    """
    best, reached, moves = model, fit.log_likelihood, list[tuple[float, int]]()
    for fraction in fractions:
        models = [_model(model.base, change) for change in _neighbours(best.change, fraction)]
        predicted = [gain for gain, _ in _predicted(models, [fit.values] * len(models))]
        k = int(np.argmax(predicted)) if models else 0
        if models and predicted[k] > reached:
            best, reached = models[k], predicted[k]
            moves.append((fraction, k))
    return best, moves


def _maximise(
    models: Sequence[_ChangedModel], starts: Sequence[FloatArray], settings: NewtonSettings = trial_fit.QUICK
) -> list[Fit]:
    """The fit of each model, iterated side by side."""

    searches = [iteration(m.parameters, first, settings) for m, first in zip(models, starts, strict=True)]

    def evaluate(vectors: Mapping[int, FloatArray]) -> list[Evaluation]:
        return _evaluate_together([models[k] for k in vectors], list(vectors.values()))

    def of_fractions(vectors: Mapping[int, FloatArray]) -> list[FloatArray]:
        return [models[k].log_likelihoods(v) for k, v in vectors.items()]  # one after another: models share a problem

    def of_some(numbers: Iterator[int], count: int) -> dict[int, Fit]:
        return iterate_together(searches, numbers, count, evaluate, of_fractions)

    return in_turn(of_some, len(models))


def _change_fit(model: _ChangedModel, fit: Fit) -> TrialFit | None:
    """The trial of a fit, with the model on the changed record; None where the samples held out cannot be predicted, as
    where a change leaves none of them: it could not be compared."""
    change, base, value = model.change, model.base, model.split(fit.values)[1]
    gained = fit.log_likelihood - base.fit.log_likelihood
    delta = float(-2.0 * gained + change.unknowns * np.log(trial_fit.sample_count(base.problem)))
    sigma = 0.0 if change.parameter is None else float(fit.sigma[-1])
    try:
        trial = model.trial(fit)
    except CANNOT_BE:
        return None
    return replace(trial, delta_bic=delta, change=change, value=value, sigma=sigma, whole_fit=fit)
