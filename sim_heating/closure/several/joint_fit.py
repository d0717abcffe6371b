"""One cause fitted to several records at once, and the hypothesis that it is common to them.

Each record keeps what the search of one record fits it with: its magnitude and derivatives, clock, noise, mesh
correction and segments held out. The likelihoods add up (FitProblem.joined). The score is that of ranking.py, summed
over the records: a parameter of one record costs the logarithm of its number of samples, a common one that of all
records that have it, so that one common value is cheaper than two own ones.

| parameter | may be common to |
|---|---|
| of the flow around the vehicle (`Effect.of_flow`), such as an onset | all records, of neighbouring points too |
| of a wall, of a table, of any other property of a point | the records of a control point |
| of a flight (`Effect.of_flight`), of a clock, of a thermocouple | none |

This is the widest that a parameter may be; the records decide how wide it is (joint_search.py).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.base.parameters import CLOCK_SKEW, EFFECT_PREFIX, RECORD_PARAMETERS, SENSOR_PREFIX
from sim_heating.closure.prior.model_error import flight_error
from sim_heating.closure.search.admissibility import objections
from sim_heating.closure.search.changes.record_change import problem_over
from sim_heating.closure.search.hypothesis import Hypothesis, adequacy_of
from sim_heating.closure.search.ranking import scatter_price
from sim_heating.closure.search.search import SearchResult
from sim_heating.closure.search.simulated_records import RECORDS
from sim_heating.closure.search.trials.candidates import Candidate
from sim_heating.closure.search.trials.change import RecordChange
from sim_heating.closure.search.trials.trial_fit import (
    CONVERGE,
    OF_TABLE,
    TrialFit,
    fitted_values,
    held_out_problem_with,
    is_of_table,
    problem_with,
    sample_count,
    table_log_prior,
    with_error,
)
from sim_heating.closure.verdict.adequacy import Adequacy
from sim_heating.estimation.inference.model_error import FLIGHT_PREFIX
from sim_heating.estimation.inference.newton import Fit
from sim_heating.estimation.problem import FitProblem
from sim_heating.estimation.record_fit import RecordFit, sensor_definition
from sim_heating.estimation.side_by_side import maximise_together
from sim_heating.heating.effects import effects
from sim_heating.inputs.record import Record

ALL, POINT, RECORD = LEVELS = ("all", "point", "record")
"""Whose one value of a parameter is, the widest first."""


@dataclass(frozen=True, eq=False)
class Cause:
    """What several records may have in common.

    names      : of its effects; of a change of the wall, the change in words
    kind       : "effect", "wall" or "table"
    candidates : what each effect adds to a model; for a change without a parameter one that adds nothing
    price      : of the number of forms that were tried, in units of BIC
    change     : of the wall, where it is one that has no parameter, such as another material
    found      : index of a record -> values of all parameters of its model that were found in this record alone
    changed    : index of a record -> its trial on the changed record, where it was fitted alone: it has the mesh
                 correction of that wall
    """

    names: tuple[str, ...]
    kind: str
    candidates: tuple[Candidate, ...]
    price: float = 0.0
    change: RecordChange | None = None
    found: Mapping[int, Mapping[str, float]] = field(default_factory=dict)
    changed: Mapping[int, TrialFit] = field(default_factory=dict)

    @property
    def candidate(self) -> Candidate:
        """All of it as one candidate."""
        several = self.candidates
        return several[0] if len(several) == 1 else Candidate(
            " + ".join(self.names),
            tuple(u for c in several for u in c.uses),
            tuple(dict.fromkeys(n for c in several for n in c.names)),
            {n: v for c in several for n, v in c.start.items()},
            tuple(n for c in several for n in c.active),
            tuple(n for c in several for n in c.with_prior),
            {n: p for c in several for n, p in c.priors.items()},
        )  # fmt: skip

    @property
    def widest(self) -> dict[str, str]:
        """Widest level of each of its parameters, by dotted name."""
        return {n: widest_level(n) for n in self.candidate.names}

    def __repr__(self) -> str:
        return f"<Cause {' + '.join(self.names)}: {', '.join(self.candidate.names)}>"


NO_CAUSE = Cause((), "", ())
"""Of the declared models, which have the error of their flight in common."""


@dataclass(frozen=True, eq=False)
class JointModel:
    """A cause in some of the records, with its parameters at some levels.

    members : indices of the records that have it;  levels : dotted name of each of its parameters -> level
    parts   : by member, its model's trial with the values of its base, not fitted
    problem : of all members
    """

    cause: Cause
    members: tuple[int, ...]
    levels: Mapping[str, str]
    parts: tuple[TrialFit, ...]
    problem: FitProblem

    def start(self, values: Mapping[int, Mapping[str, float]]) -> FloatArray:
        """(parameter,) values to start from; those of the cause's candidate and of the bases where none are given.

        values : index of a record -> values by dotted name; a common parameter has that of the first of its records
        """
        own = [
            {
                **dict(zip(p.fit.names, p.fit.values.tolist(), strict=True)),
                **self.cause.candidate.start,
                **values.get(i, {}),
            }
            for i, p in zip(self.members, self.parts, strict=True)
        ]
        return np.array([
            next((own[k][u.parameter.name] for k in u.records if u.parameter.name in own[k]), u.parameter.value)
            for u in self.problem.unknowns
        ])  # fmt: skip

    def split(self, fit: Fit) -> list[TrialFit]:
        """By member, the trial of its own model at the values of a joint fit, with the joint bounds."""
        trials = []
        for part, joined in zip(self.parts, self.problem.record_fits, strict=True):
            own = part.problem.record_fits[0]
            at = np.empty(len(own.index), dtype=np.int64)
            at[own.index] = joined.index
            selected = fit.select(at, [u.parameter.name for u in part.problem.unknowns])
            likelihood = part.problem.evaluate(selected.values).log_likelihood
            trials.append(replace(part, fit=replace(selected, log_likelihood=likelihood)))
        return trials


def joint_model(
    cause: Cause, bases: Sequence[TrialFit], members: Sequence[int], levels: Mapping[str, str]
) -> JointModel:
    """The model of a cause in some of the records.

    bases : by record, the declared model;  members : indices of records that have the cause
    """
    parts = [cause.changed[i] if i in cause.changed else _part(cause, bases[i]) for i in members]
    return JointModel(cause, tuple(members), levels, tuple(parts), joined([p.problem for p in parts], levels))


def joined(parts: Sequence[FitProblem], levels: Mapping[str, str]) -> FitProblem:
    """The problem of several records, whose points of one flight have its error in common.

    parts : of one record each;  levels : dotted name of each common parameter -> level
    """
    fits = [p.record_fits[0] for p in parts]
    one_point = len({f.record.declared.control_point for f in fits}) == 1
    owners = [
        {n: owner(level, f.record, one_point) for n, level in levels.items()}
        | dict.fromkeys((*f.flight_names, *_clock_of_flight(f)), f.record.flight)
        for f in fits
    ]
    return FitProblem.joined(parts, owners)


def _clock_of_flight(part: RecordFit) -> tuple[str, ...]:
    """The name of the clock, where its shift is an error of the flight that the record has in common with others."""
    error = flight_error(part.record) if part.flight_names else None
    return (CLOCK_SKEW.name,) if error is not None and error.has_one_clock and CLOCK_SKEW.name in part.names else ()


def with_common_flights(alone: Sequence[SearchResult]) -> list[TrialFit]:
    """The declared models of records that were searched by themselves, those of one flight with one error of it.

    The error of a record's heating is as large as with the best model of its own search.
    """
    bases = [_with_size(result) for result in alone]
    flights = [b.problem.record_fits[0].record.flight for b in bases]
    shared = [
        b if flights.count(flight) < 2 else replace(
            b, problem=b.problem.with_flight_unknowns(), held_out=b.held_out and b.held_out.with_flight_unknowns()
        )
        for b, flight in zip(bases, flights, strict=True)
    ]  # fmt: skip
    members = [i for i, b in enumerate(shared) if b.problem.record_fits[0].flight_names]
    if not members:
        return bases
    parts = tuple(shared[i] for i in members)
    model = JointModel(NO_CAUSE, tuple(members), {}, parts, joined([p.problem for p in parts], {}))
    fit = fit_models([model], [model.start({})])[0]
    if not np.isfinite(fit.log_likelihood):
        return bases
    for i, trial in zip(members, model.split(fit), strict=True):
        shared[i] = trial
    return shared


def _with_size(result: SearchResult) -> TrialFit:
    """The declared model with the error as large as with the best model of a record's own search."""
    base, size = result.base, result.compared.last.size
    error = base.problem.record_fits[0].model_error
    if size is None or error is None:
        return base
    return replace(with_error(base, error.of_size(*size.likeliest)), size=size)


def _part(cause: Cause, base: TrialFit) -> TrialFit:
    """The trial of a cause in one record, its fit still that of the declared model."""
    if cause.change is None:
        problem, held_out = problem_with(base, cause.candidate), held_out_problem_with(base, cause.candidate)
        return replace(base, candidate=cause.candidates[-1], problem=problem, held_out=held_out)
    change = cause.change

    def over(problem: FitProblem) -> FitProblem:
        part = problem.record_fits[0]
        held_out = problem is base.held_out
        return problem_over(base, part, change.apply(part.record, 0.0), part.names, held_out=held_out)

    return replace(base, problem=over(base.problem), held_out=base.held_out and over(base.held_out))


FEW_STEPS = 15
"""Steps of a fit that begins near its end, unless the record does not determine a parameter."""


def fit_models(
    models: Sequence[JointModel], starts: Sequence[FloatArray], *, iterations: int = CONVERGE.iterations
) -> list[Fit]:
    """The fit of each model, all marched side by side; `iterations` is the largest number of steps."""
    problems = [m.problem for m in models]
    of_tables = {u.label for p in problems for u in p.unknowns if u.parameter.name in OF_TABLE}
    settings = replace(CONVERGE, iterations=iterations, unlimited=tuple(sorted(of_tables)))
    return maximise_together(problems, starts, settings)


# Hypotheses -----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False, repr=False)
class JointHypothesis(Hypothesis):
    """The hypothesis that a cause is common to some of the records.

    model     : of the members; None for the declared model of all records
    by_record : each record's trial: of a member with the common values, of another one with what it shows alone
    alone     : score of each record's own explanation, where it is no member; else 0
    shares    : score of each record relative to its declared model; with `common` they add up to the score
    common    : what common parameters, priors and forms add to the score
    """

    model: JointModel | None = None
    by_record: tuple[TrialFit, ...] = ()
    alone: tuple[float, ...] = ()
    shares: tuple[float, ...] = ()
    common: float = 0.0

    @property
    def kind(self) -> str:
        """Kind of its cause; empty for the declared models."""
        return "" if self.model is None else self.model.cause.kind

    @property
    def members(self) -> tuple[int, ...]:
        """Indices of the records that have the cause; all for the declared models."""
        return tuple(range(len(self.by_record))) if self.model is None else self.model.members

    @cached_property
    def adequacy_by_record(self) -> tuple[Adequacy, ...]:
        """Whether it explains each record to its noise.

        Of models with an error each p-value is from as many records more as there are members, so that the smallest of
        them can be as small as that of one record.
        """
        return tuple(adequacy_of(trial, RECORDS * len(self.members)) for trial in self.by_record)

    @cached_property
    def adequacy(self) -> Adequacy:
        """Whether it explains its members to their noise: chi-squares pooled, the p-value that of the worst record.

        The smallest of n independent p-values is below p with the probability 1 - (1 - p)^n (Sidak 1967).
        """
        names = [self.by_record[i].problem.record_fits[0].record.name for i in self.members]
        of_members = [self.adequacy_by_record[i] for i in self.members]
        counts = np.array([sample_count(self.by_record[i].problem) for i in self.members], dtype=float)

        def mean(values: Sequence[float]) -> float:
            return float(np.average(values, weights=counts))

        held_out = [a.chi2_holdout for a in of_members if a.chi2_holdout is not None]
        return Adequacy(
            p_value=-math.expm1(len(of_members) * math.log1p(-min(a.p_value for a in of_members))),
            chi2_fit=mean([a.chi2_fit for a in of_members]),
            chi2_holdout=float(np.mean(held_out)) if held_out else None,
            lag1=mean([a.lag1 for a in of_members]),
            sign_changes=mean([a.sign_changes for a in of_members]),
            by_sensor={f"{n}, {k}": v for n, a in zip(names, of_members, strict=True) for k, v in a.by_sensor.items()},
            by_phase={f"{n}, {k}": v for n, a in zip(names, of_members, strict=True) for k, v in a.by_phase.items()},
            statistic=max(a.statistic for a in of_members),
            unstructured=all(a.unstructured for a in of_members),
        )

    @cached_property
    def excess_chi2(self) -> float:
        """Reduced chi-square of the fitted samples of all records less one."""
        counts = [sample_count(t.problem) for t in self.by_record]
        return float(np.average([t.excess_chi2 for t in self.by_record], weights=counts))

    def delta_bic(self, none: JointHypothesis) -> float:
        """BIC minus that of the declared models, residuals taken as noise, without segments held out."""
        gained = sum(
            self.by_record[i].fit.log_likelihood + table_log_prior(self.by_record[i].fit)
            - none.by_record[i].fit.log_likelihood - table_log_prior(none.by_record[i].fit)
            for i in self.members
        )  # fmt: skip
        others = sum(score for i, score in enumerate(self.alone) if i not in self.members)
        return parameter_cost(self) - 2.0 * gained + others

    @property
    def log_likelihood(self) -> float:
        """Log likelihood of the fitted samples of all records [-]."""
        return sum(t.fit.log_likelihood for t in self.by_record)


def joint_hypothesis(
    model: JointModel, fit: Fit, bases: Sequence[TrialFit], alone: Sequence[tuple[TrialFit, float]]
) -> JointHypothesis:
    """The hypothesis of a fitted model, with the objections to it; `rated` gives its score.

    alone : by record, the trial of its own explanation and the score of that, for records that are no members
    """
    by_record = [trial for trial, _ in alone]
    split = model.split(fit)
    gained = sum(t.fit.log_likelihood - bases[i].fit.log_likelihood for i, t in zip(model.members, split, strict=True))
    against: list[tuple[str, ...]] = []
    judged = model.cause.candidates
    if model.cause.kind == "wall":  # far from its declared scatter a wall is fined, as in the search of one record
        judged = tuple(replace(c, with_prior=()) for c in judged)
    for i, trial in zip(model.members, split, strict=True):
        # of several effects together it is not known what the last one gained
        gain = gained if len(model.cause.names) == 1 else 0.0
        delta = len(trial.candidate.names) * float(np.log(sample_count(trial.problem))) - 2.0 * gain
        by_record[i] = replace(trial, name=model.cause.names[-1], delta_bic=delta)
        against.append(objections(replace(by_record[i], candidate=judged[-1]), judged))
    # what may be named in one of the records, with the values common to all, may be named
    fewest = min(against, key=len)
    joint = [TrialFit(n, model.cause.candidates[-1], model.problem, None, fit) for n in model.cause.names]
    own = tuple(0.0 if i in model.members else float(score) for i, (_, score) in enumerate(alone))
    return JointHypothesis(
        tuple(joint), None, fewest, model.cause.price, model=model, by_record=tuple(by_record), alone=own
    )


def rated(none: JointHypothesis, others: Sequence[JointHypothesis]) -> list[JointHypothesis]:
    """Hypotheses with their scores relative to the declared models, best first; inadmissible ones come last.

    The scale of a record's residuals is that of the best admissible hypothesis in this record.
    """
    admissible = [h for h in others if h.admissible]
    best = max(admissible, key=lambda h: h.log_likelihood, default=none)
    scale = [max(1.0, 1.0 + t.excess_chi2) for t in best.by_record]
    held_out = [max(1.0, t.held_out_chi2) for t in best.by_record]
    zero = [_record_bic(t, None, c, h) for t, c, h in zip(none.by_record, scale, held_out, strict=True)]

    def scored(h: JointHypothesis) -> JointHypothesis:
        shares = [
            _record_bic(t, h.model, c, o) - z if i in h.members else h.alone[i]
            for i, (t, c, o, z) in enumerate(zip(h.by_record, scale, held_out, zero, strict=True))
        ]
        common = h.price + _common_cost(h) + _flight_cost(h) - _flight_cost(none)
        return replace(h, shares=tuple(shares), common=common, score=sum(shares) + common)

    return sorted((scored(h) for h in others), key=lambda h: (not h.admissible, h.score))


def _record_bic(trial: TrialFit, model: JointModel | None, c: float, c_held_out: float) -> float:
    """BIC of one record with its segments held out; parameters that it has in common with others are not counted."""
    record = trial.problem.record_fits[0].record
    common = {
        u.parameter.name
        for u in (model.problem.unknowns if model else ())
        if len(u.records) > 1
        and model is not None
        and any(model.problem.record_fits[k].record.name == record.name for k in u.records)
    }
    common |= set(trial.problem.record_fits[0].flight_names)
    own = [u for u in trial.problem.unknowns if not is_of_table(u.parameter) and u.parameter.name not in common]
    log_posterior = trial.fit.log_likelihood / c + trial.held_out_log_likelihood / c_held_out
    log_posterior += table_log_prior(trial.fit)
    return -2.0 * log_posterior + len(own) * math.log(sample_count(trial.problem))


def _flight_cost(h: JointHypothesis) -> float:
    """Cost of the errors of the flights by their priors [BIC], each flight once."""
    flights = {}
    for i in h.members:
        part = h.by_record[i].problem.record_fits[0]
        values = fitted_values(h.by_record[i])
        flights[part.record.flight] = [values[n] for n in part.flight_names]
    return float(sum(np.sum(np.square(f)) for f in flights.values()))


def _common_cost(h: JointHypothesis) -> float:
    """Cost of common parameters, and of the distances of the cause's values from their priors [BIC]."""
    if h.model is None:
        return 0.0
    model, fit, total = h.model, h.last.fit, 0.0
    counts = [sample_count(p.problem) for p in model.parts]
    for k, u in enumerate(model.problem.unknowns):
        name = u.parameter.name
        if len(u.records) > 1 and not name.startswith(FLIGHT_PREFIX):
            total += math.log(sum(counts[i] for i in u.records))
        if name in model.cause.candidate.with_prior:
            part = model.problem.record_fits[u.records[0]]
            p = sensor_definition(part.record, name) or part.model.definition(name)
            total += scatter_price(abs(float(fit.values[k]) - p.value) / p.sigma)
    return total


def parameter_cost(h: JointHypothesis) -> float:
    """What the number of the cause's parameters costs, own and common ones, in units of BIC."""
    if h.model is None:
        return 0.0
    counts = [sample_count(p.problem) for p in h.model.parts]
    names = h.model.cause.candidate.names
    unknowns = [u for u in h.model.problem.unknowns if u.parameter.name in names]
    return sum(math.log(sum(counts[i] for i in u.records)) for u in unknowns)


# Whose one value of a parameter is ------------------------------------------------------------------------------------


def widest_level(name: str) -> str:
    """The widest level at which records may have a parameter in common.

    name : dotted name of a parameter of the model, a record or an effect
    """
    if name in RECORD_PARAMETERS or name.startswith(SENSOR_PREFIX):
        return RECORD
    for effect in effects().values():
        prefix = f"{EFFECT_PREFIX}{effect.name}."
        own = name.removeprefix(prefix) if name.startswith(prefix) else effect.own_name(name)
        if own is not None:
            return RECORD if own in effect.of_flight else ALL if own in effect.of_flow else POINT
    return POINT


def owner(level: str, record: Record, one_point: bool) -> str:
    """Owner of a parameter in a record, as `FitProblem.joined` takes it: empty for all records.

    one_point : whether all records are of one control point
    """
    if level == RECORD:
        return record.name
    return "" if level == ALL or one_point else record.declared.control_point


def narrower_levels(level: str, records: Sequence[Record]) -> list[str]:
    """Levels below one at which more values of a parameter are estimated; none where every record has its own."""
    points = [r.declared.control_point for r in records]
    levels, one_point = [], len(set(points)) == 1
    owners = {owner(level, r, one_point) for r in records}
    for narrower in LEVELS[LEVELS.index(level) + 1 :]:
        own = {owner(narrower, r, one_point) for r in records}
        if len(own) > len(owners):
            levels.append(narrower)
            owners = own
    return levels
