"""What would tell the causes of a set apart: each measurement's or manoeuvre's expected odds, from the fitted models.

Both models of a pair predict the readings of another flight, mean m and sensitivities S to their parameters, of which
the present record has the information M (priors included). Where the first is true and the second is fitted to both
flights, its log likelihood is expected to fall behind by

    D = min over x of  (d - S x)' W (d - S x) / 2 + x' M x / 2,    d = m_1 - m_2,

W the inverse squares of the noise, rounding included, over the scale of the residuals where that is above 1. The odds
are exp(D), of either model as the true one the smaller. Source: docs/theory/findings_judged.md, section "Sets".

Flights are the present one again, with a change: another thermocouple, another recorder, or one manoeuvre more.
Density, velocity and reference heating stay as they are in a manoeuvre, which is short against the flight.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import RATIO_VARIABLES
from sim_heating.closure.search.changes.record_change import CANNOT_BE
from sim_heating.closure.search.hypothesis import Hypothesis
from sim_heating.closure.search.trials.trial_fit import THINNED_STEPS, TrialFit, fitted_effects
from sim_heating.closure.verdict.policy import EFFORT
from sim_heating.estimation.design.instruments import extra_sensors
from sim_heating.estimation.problem import FitOptions, FitProblem
from sim_heating.estimation.side_by_side import JointMarch
from sim_heating.inputs.record import Record

REPEATED = "the same flight again"
REPEATED_TEST = "the same test again"
"""The same of a record without flow, as under a lamp."""
MANOEUVRES = {
    "alpha_deg": (30.0, 5.0, "a push-over pull-up"), "beta_deg": (20.0, 2.0, "a sideslip doublet"),
    "elevon_deg": (20.0, 5.0, "an elevon pulse"), "bodyflap_deg": (20.0, 5.0, "a body-flap pulse"),
}  # fmt: skip
"""By variable, duration of a manoeuvre [s], which is the founding paper's, its amplitude [deg], and its name."""
LONGEST_S = max(period_s for period_s, _, _ in MANOEUVRES.values())


@dataclass(frozen=True)
class Experiment:
    """A flight, or measurement, and how well it is expected to tell causes apart.

    what     : in words
    log_odds : natural logarithm of the odds that it is expected to give between them [-], of the closest pair
    """

    what: str
    log_odds: float

    def in_words(self) -> str:
        """What it is, and its odds."""
        if self.log_odds > math.log(1000.0):
            return f"{self.what}: odds above 1000 to 1"
        odds = math.exp(self.log_odds)
        return f"{self.what}: odds of {odds:.{1 if odds < 10.0 else 0}f} to 1"


@dataclass(frozen=True, eq=False)
class _Flight:
    """A change of the present flight: what it is, its name among others of its kind, and its record."""

    what: str
    kind: str
    record: Record


@dataclass(frozen=True, eq=False)
class _Predicted:
    """Predictions of one model for a flight, all samples of its channels, which are in the order of their columns.

    mean_K   : (sample,);  jacobian : (sample, parameter) [K] per unit of each parameter
    weight   : (sample,) inverse square of noise and rounding [1/K2]
    """

    mean_K: FloatArray
    jacobian: FloatArray
    weight: FloatArray


def tell_apart(none: Hypothesis, best: Hypothesis, rivals: Sequence[Hypothesis], most: int = 2) -> list[Experiment]:
    """The experiments that are expected to tell the likeliest cause from its rivals best, with their odds.

    none    : the declared model, on the record as declared
    best    : the likeliest cause;  rivals : those that the record cannot tell from it
    most    : how many are returned
    returns : the best first, those that do little more than the same flight again left out; none where a cause is a
              change of the readings
    """
    models = [best, *rivals[: EFFORT.rivals]]
    record_fit = none.last.record_fit
    if len(models) < 2 or any(_changes_readings(h, record_fit.record) for h in models):
        return []
    flights = list(_flights(record_fit.record, recorders=best.adequate))
    predicted = _predict(none.last, models, flights)
    scale = max(1.0, 1.0 + best.excess_chi2)
    kinds: dict[str, Experiment] = {}
    for flight, of_models in zip(flights, predicted, strict=True):
        marched = [p for p in of_models if p is not None]
        if len(marched) < len(models):
            continue
        experiment = Experiment(flight.what, _least_odds(models, marched, scale))
        best_of_kind = kinds.get(flight.kind, experiment)
        kinds[flight.kind] = max(best_of_kind, experiment, key=lambda e: e.log_odds)
    again = kinds.pop(REPEATED, Experiment(REPEATED, 0.0))
    # What hardly does more than the same flight again is not worth its cost.
    better = [e for e in kinds.values() if e.log_odds > again.log_odds + math.log(2.0)]
    return [*sorted(better, key=lambda e: -e.log_odds), again][:most]


def _least_odds(models: Sequence[Hypothesis], predicted: Sequence[_Predicted], scale: float) -> float:
    """Log odds that a flight is expected to give between the first model and the rival that is closest to it [-].

    predicted : by model;  scale : of the residuals, a reduced chi-square
    """
    return min(
        _expected(truth, fitted, model, scale)
        for other, rival in zip(predicted[1:], models[1:], strict=True)
        for truth, fitted, model in ((predicted[0], other, rival), (other, predicted[0], models[0]))
    )


def _changes_readings(hypothesis: Hypothesis, record: Record) -> bool:
    """Whether a cause is a change of the readings themselves, which no model predicts."""
    if hypothesis.changed is None or hypothesis.change is None or hypothesis.change.in_model:
        return False
    changed = hypothesis.change.apply(record, hypothesis.changed.value)
    return any(
        not np.array_equal(column, changed.thermocouples[name], equal_nan=True)
        for name, column in record.thermocouples.items()
    )


# Flights --------------------------------------------------------------------------------------------------------------


def _flights(record: Record, *, recorders: bool) -> Iterator[_Flight]:
    """The record's flight again, and with one change each.

    recorders : whether other recorders are among them, which average noise and no error of a model
    """
    yield _Flight(REPEATED if record.has_flow else REPEATED_TEST, REPEATED, record)
    if recorders:
        yield from _recorders(record)
    for position, sensor in extra_sensors(record.declared.stack, record.used_sensors):
        columns = {**record.thermocouples, sensor.column: record.thermocouples[record.used_sensors[0].column]}
        changed = replace(record.with_sensors([*record.sensors, sensor]), thermocouples=columns)
        where = "at the bondline" if position == "bondline" else position
        yield _Flight(f"a thermocouple {where}", position, changed)
    yield from _manoeuvres(record)


def _recorders(record: Record) -> Iterator[_Flight]:
    """The readings in finer words, and more often."""
    finer_bits, more_often = 12, 5  # bits of finer recorder words, and readings in place of one
    finer = [
        s.model_copy(update={"bits": finer_bits}) if s.bits is not None and s.bits < finer_bits else s
        for s in record.sensors
    ]
    if finer != list(record.sensors):
        yield _Flight(f"recorder words of {finer_bits} bits", "words", record.with_sensors(finer))
    t = record.time_s
    between = (t[:-1, np.newaxis] + np.diff(t)[:, np.newaxis] * np.arange(more_often) / more_often).ravel()
    often = np.append(between, t[-1])
    columns = {n: np.interp(often, t, column) for n, column in record.thermocouples.items() if n != "time_s"}
    interval = float(np.median(np.diff(often)))
    changed = replace(record, thermocouples={"time_s": often, **columns})
    yield _Flight(f"readings every {interval:.2g} s", "rate", changed)


def _manoeuvres(record: Record) -> Iterator[_Flight]:
    """One manoeuvre more at each of some times; none where nothing flows, or in what the flight does not state."""
    begins = (0.2, 0.5, 0.8)  # where a manoeuvre begins, as parts of the time that is read
    flown, read = record.conditions, record.time_s[record.fit_mask() | record.holdout_mask()]
    begin, end = max(float(read[0]), flown.time_s[0]), min(float(read[-1]), flown.time_s[-1])
    if not record.has_flow or end - begin < 3.0 * LONGEST_S:
        return
    starts = [begin + fraction * (end - begin) for fraction in begins]
    # One grid for all, so that all are marched side by side.
    fine = [t + s for t in starts for s in np.arange(0.0, LONGEST_S + 1.0)]
    flown = flown.at(np.union1d(flown.time_s, np.clip(fine, flown.time_s[0], flown.time_s[-1])))
    for variable, (period, amplitude_deg, name) in MANOEUVRES.items():
        for t in starts:
            excursion = amplitude_deg * _wave(variable, (flown.time_s - t) / period)
            columns = {variable: _within_table(record, variable, flown[variable] + excursion)}
            changed = replace(record, conditions=flown.with_columns(**columns))
            yield _Flight(f"{name} of {amplitude_deg:g} deg at {t:.0f} s", variable, changed)


def _wave(variable: str, phase: FloatArray) -> FloatArray:
    """A manoeuvre of size 1 over phases 0 to 1: down and up for the angles of the vehicle, a pulse for flaps."""
    inside = (phase > 0.0) & (phase < 1.0)
    wave = np.sin(np.pi * phase) ** 2 if variable in ("elevon_deg", "bodyflap_deg") else -np.sin(2.0 * np.pi * phase)
    return np.where(inside, wave, 0.0)


def _within_table(record: Record, variable: str, values: FloatArray) -> FloatArray:
    """Values of a ratio variable within the record's table, beyond which it says nothing."""
    table = record.ratio_table
    if table is None:
        return values
    axis = table.axes[RATIO_VARIABLES.index(variable)]
    return np.clip(values, axis[0], axis[-1]) if len(axis) > 1 else values


# Predictions ----------------------------------------------------------------------------------------------------------


def _predict(base: TrialFit, models: Sequence[Hypothesis], flights: Sequence[_Flight]) -> list[list[_Predicted | None]]:
    """By flight and model, its predictions; None where it cannot be marched there."""
    needed = [[_marches(base, h, f.record) for h in models] for f in flights]
    flat = list(chain.from_iterable(chain.from_iterable(needed)))
    done = JointMarch([p for p, _ in flat]).march([v for _, v in flat])
    marched = {id(p) for (p, _), succeeded in zip(flat, done, strict=True) if succeeded}

    def predicted(h: Hypothesis, marches: Sequence[tuple[FitProblem, FloatArray]]) -> _Predicted | None:
        return _predicted(h, marches) if marches and all(id(p) in marched for p, _ in marches) else None

    return [[predicted(h, marches) for h, marches in zip(models, row, strict=True)] for row in needed]


def _marches(base: TrialFit, model: Hypothesis, record: Record) -> list[tuple[FitProblem, FloatArray]]:
    """Problems, each with its vector: a model over a record, and one step away in a change that has no exact
    derivative. None where the change does not exist there."""
    value = 0.0 if model.changed is None else model.changed.value
    values = [value, value + _step(model)] if _step(model) else [value]
    try:
        return [(_problem(base, model.last, _changed(model, record, at)), model.last.fit.values) for at in values]
    except CANNOT_BE:
        return []


def _step(model: Hypothesis) -> float:
    """Step in a change whose value is an unknown without exact derivative; 0 for any other model.

    The value of a change that an effect was added to stays as it was found.
    """
    step = 0.1  # step in a change without exact derivative, over the usual standard deviation of its parameter
    change = None if model.added else model.change
    return 0.0 if change is None or change.in_model or change.parameter is None else step * change.parameter.sigma


def _changed(model: Hypothesis, record: Record, value: float) -> Record:
    """A record with the change of a hypothesis, where it has one that is no parameter of the model."""
    if model.change is None or model.change.in_model:
        return record
    return model.change.apply(record, value)


def _problem(base: TrialFit, trial: TrialFit, record: Record) -> FitProblem:
    """The model of a trial over all samples of a record that are fitted or held out, with the noise of its own."""
    fitted = trial.record_fit
    options = FitOptions(
        effects=fitted_effects(trial),
        priors=trial.problem.priors,
        sample_masks=[record.fit_mask() | record.holdout_mask()],
        **THINNED_STEPS,
    )
    problem = FitProblem([record], fitted.names, base.problem.reference, options)
    record_fit = problem.record_fits[0]
    for channel in record_fit.channels:
        if channel.sensor.noise_sigma_K is None:
            record_fit.sigma_K[channel.number] = fitted.sigma_K.get(channel.number, max(fitted.sigma_K.values()))
    return problem


def _predicted(model: Hypothesis, marches: Sequence[tuple[FitProblem, FloatArray]]) -> _Predicted:
    """The predictions of a model whose marches are made."""
    by_march = [sorted(p.samples(v), key=lambda s: s.channel.sensor.column) for p, v in marches]
    mean = [np.concatenate([s.mean_K for s in samples]) for samples in by_march]
    jacobian = np.concatenate([s.jacobian for s in by_march[0]])
    if len(mean) == 2:
        jacobian = np.column_stack([jacobian, (mean[1] - mean[0]) / _step(model)])
    weight = [np.full(len(s.mean_K), s.channel.sensor.noise_floor_K(s.sigma_K) ** -2.0) for s in by_march[0]]
    return _Predicted(mean[0], jacobian, np.concatenate(weight))


def _expected(truth: _Predicted, fitted: _Predicted, model: Hypothesis, scale: float) -> float:
    """By how much the log likelihood of a model falls behind that of the true one, its parameters adjusted [-].

    fitted : predictions of the model;  scale : of the residuals, a reduced chi-square
    """
    if len(truth.mean_K) != len(fitted.mean_K):
        return 0.0
    # that of a change last where it is no parameter of the model
    whole_fit = None if model.changed is None or not _step(model) else model.changed.whole_fit
    fit = whole_fit or model.last.fit
    free = ~fit.on_bound
    J, w, d = fitted.jacobian[:, free], truth.weight / scale, truth.mean_K - fitted.mean_K
    information = fit.information[np.ix_(free, free)] / scale + np.diag(fit.prior_information[free])
    A, b = (J * w[:, np.newaxis]).T @ J + information, J.T @ (w * d)
    s = 1.0 / np.sqrt(np.maximum(np.diag(A), np.finfo(float).tiny))
    adjusted = s * (np.linalg.pinv(A * np.outer(s, s), rcond=1e-12, hermitian=True) @ (s * b))
    return max(0.5 * float(d @ (w * d)) - 0.5 * float(b @ adjusted), 0.0)
