"""One cause in several records, as one problem: whose each of its parameters is, what they cost, and its fit.

Each record keeps what the search of one record fits it with: its magnitude and derivatives, clock, noise, mesh
correction and segments held out. The likelihoods add up (FitProblem.joined).

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
from itertools import chain

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.base.parameters import CLOCK_SKEW, EFFECT_PREFIX, RECORD_PARAMETERS, SENSOR_PREFIX
from sim_heating.closure.prior.model_error import flight_error
from sim_heating.closure.search.ranking import scatter_price
from sim_heating.closure.search.trials.candidates import NO_EFFECT, Candidate
from sim_heating.closure.search.trials.change import RecordChange
from sim_heating.closure.search.trials.trial_fit import CONVERGE, OF_TABLE, TrialFit, sample_count, unfitted
from sim_heating.estimation.inference.model_error import FLIGHT_PREFIX
from sim_heating.estimation.inference.newton import Fit
from sim_heating.estimation.problem import FitProblem
from sim_heating.estimation.record_fit import RecordFit, parameter_definition
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
    values     : index of a record -> values of all parameters of its model, by dotted name, by this record alone
    changed    : index of a record -> its trial on the changed record, where it was fitted alone: it has the mesh
                 correction of that wall
    """

    names: tuple[str, ...]
    kind: str
    candidates: tuple[Candidate, ...]
    price: float = 0.0
    change: RecordChange | None = None
    values: Mapping[int, Mapping[str, float]] = field(default_factory=dict)
    changed: Mapping[int, TrialFit] = field(default_factory=dict)

    @property
    def candidate(self) -> Candidate:
        """All of it as one candidate."""
        first, *others = self.candidates
        join = chain.from_iterable
        return first if not others else Candidate(
            " + ".join(self.names),
            tuple(join(c.uses for c in self.candidates)),
            tuple(dict.fromkeys(join(c.names for c in self.candidates))),
            dict(join(c.start.items() for c in self.candidates)),
            tuple(join(c.active for c in self.candidates)),
            tuple(join(c.with_prior for c in self.candidates)),
            dict(join(c.priors.items() for c in self.candidates)),
        )  # fmt: skip

    @property
    def widest(self) -> dict[str, str]:
        """Widest level of each of its parameters, by dotted name."""
        return {n: widest_level(n) for n in self.candidate.names}

    def trial(self, base: TrialFit) -> TrialFit:
        """The trial of the cause in one record on top of its declared model, with the fit of that still."""
        apply = None if self.change is None else self.change.apply
        changed = None if apply is None else lambda record: apply(record, 0.0)
        return replace(unfitted(base, self.candidate, changed=changed), candidate=self.candidates[-1])

    def __repr__(self) -> str:
        return f"<Cause {' + '.join(self.names)}: {', '.join(self.candidate.names)}>"


NO_CAUSE = Cause((), "", (NO_EFFECT,))
"""Of the declared models, which have the error of their flight in common."""


@dataclass(frozen=True, eq=False)
class JointModel:
    """A cause in some of the records, with its parameters at some levels.

    members : indices of the records that have it;  levels : dotted name of each of its parameters -> level
    trials  : by member, its own trial of the cause, not fitted
    problem : of all members
    """

    cause: Cause
    members: tuple[int, ...]
    levels: Mapping[str, str]
    trials: tuple[TrialFit, ...]
    problem: FitProblem

    def start(self, values: Mapping[int, Mapping[str, float]]) -> FloatArray:
        """(parameter,) values to start from; those of the cause's candidate and of the bases where none are given.

        values : index of a record -> values by dotted name; a common parameter has that of the first of its records
        """
        by_member = [
            {
                **dict(zip(t.fit.names, t.fit.values.tolist(), strict=True)),
                **self.cause.candidate.start,
                **values.get(i, {}),
            }
            for i, t in zip(self.members, self.trials, strict=True)
        ]
        return np.array([
            next((by_member[k][name] for k in u.records if (name := u.parameter.name) in by_member[k]),
                 u.parameter.value)
            for u in self.problem.unknowns
        ])  # fmt: skip

    def split(self, fit: Fit) -> list[TrialFit]:
        """By member, the trial of its own model at the values of a joint fit, with the joint bounds."""
        trials = []
        for trial, joined in zip(self.trials, self.problem.record_fits, strict=True):
            index = trial.record_fit.index
            at = np.empty(len(index), dtype=np.int64)
            at[index] = joined.index
            selected = fit.select(at, [u.parameter.name for u in trial.problem.unknowns])
            likelihood = trial.problem.evaluate(selected.values).log_likelihood
            trials.append(replace(trial, fit=replace(selected, log_likelihood=likelihood)))
        return trials

    def common_names(self, record: Record) -> set[str]:
        """Dotted names of the parameters that a record has in common with others."""
        fits = self.problem.record_fits
        shared = (u for u in self.problem.unknowns if len(u.records) > 1)
        return {u.parameter.name for u in shared if any(fits[k].record.name == record.name for k in u.records)}

    @property
    def parameter_cost(self) -> float:
        """What the number of the cause's parameters costs, each record's and common ones, in units of BIC."""
        counts, names = self._counts, self.cause.candidate.names
        unknowns = [u for u in self.problem.unknowns if u.parameter.name in names]
        return sum(math.log(sum(counts[i] for i in u.records)) for u in unknowns)

    def common_cost(self, values: FloatArray) -> float:
        """Cost of common parameters, and of the distances of the cause's values from their priors [BIC].

        values : (parameter,) of the joint problem, each in its unit
        """
        counts, total = self._counts, 0.0
        for k, u in enumerate(self.problem.unknowns):
            name = u.parameter.name
            if len(u.records) > 1 and not name.startswith(FLIGHT_PREFIX):
                total += math.log(sum(counts[i] for i in u.records))
            if name in self.cause.candidate.with_prior:
                fit = self.problem.record_fits[u.records[0]]
                p = parameter_definition(fit.record, fit.model, name)
                total += scatter_price(abs(float(values[k]) - p.value) / p.sigma)
        return total

    @property
    def _counts(self) -> list[int]:
        """Number of samples of each member."""
        return [sample_count(t.problem) for t in self.trials]


def joint_model(
    cause: Cause, bases: Sequence[TrialFit], members: Sequence[int], levels: Mapping[str, str]
) -> JointModel:
    """The model of a cause in some of the records.

    bases : by record, the declared model;  members : indices of records that have the cause
    """
    trials = [cause.changed[i] if i in cause.changed else cause.trial(bases[i]) for i in members]
    return JointModel(cause, tuple(members), levels, tuple(trials), joined([t.problem for t in trials], levels))


def joined(problems: Sequence[FitProblem], levels: Mapping[str, str]) -> FitProblem:
    """The problem of several records, whose points of one flight have its error in common.

    problems : of one record each;  levels : dotted name of each common parameter -> level
    """
    fits = [p.record_fits[0] for p in problems]
    one_point = len({f.record.declared.control_point for f in fits}) == 1
    owners = [
        {n: owner(level, f.record, one_point) for n, level in levels.items()}
        | dict.fromkeys((*f.flight_names, *_clock_of_flight(f)), f.record.flight)
        for f in fits
    ]
    return FitProblem.joined(problems, owners)


def _clock_of_flight(fit: RecordFit) -> tuple[str, ...]:
    """The name of the clock, where its shift is an error of the flight that the record has in common with others."""
    error = flight_error(fit.record) if fit.flight_names else None
    return (CLOCK_SKEW.name,) if error is not None and error.has_one_clock and CLOCK_SKEW.name in fit.names else ()


def fit_models(
    models: Sequence[JointModel], starts: Sequence[FloatArray], *, iterations: int = CONVERGE.iterations
) -> list[Fit]:
    """The fit of each model, all marched side by side; `iterations` is the largest number of steps."""
    problems = [m.problem for m in models]
    of_tables = {u.label for p in problems for u in p.unknowns if u.parameter.name in OF_TABLE}
    settings = replace(CONVERGE, iterations=iterations, unlimited=tuple(sorted(of_tables)))
    return maximise_together(problems, starts, settings)


def refit_models(models: Sequence[JointModel], starts: Sequence[FloatArray]) -> list[tuple[JointModel, Fit]]:
    """Models that can be marched with their fits, from starts near their end."""
    iterations = 15  # steps at most, which suffice there unless a record does not determine a parameter
    fits = fit_models(models, starts, iterations=iterations)
    return [(m, f) for m, f in zip(models, fits, strict=True) if np.isfinite(f.log_likelihood)]


# Whose one value of a parameter is ------------------------------------------------------------------------------------


def widest_level(name: str) -> str:
    """The widest level at which records may have a parameter in common.

    name : dotted name of a parameter of the model, a record or an effect
    """
    if name in RECORD_PARAMETERS or name.startswith(SENSOR_PREFIX):
        return RECORD
    for effect in effects().values():
        prefix = f"{EFFECT_PREFIX}{effect.name}."
        short = name.removeprefix(prefix) if name.startswith(prefix) else effect.own_name(name)
        if short is not None:
            return RECORD if short in effect.of_flight else ALL if short in effect.of_flow else POINT
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
    one_point = len({r.declared.control_point for r in records}) == 1
    levels: list[str] = []
    owners = {owner(level, r, one_point) for r in records}
    for narrower in LEVELS[LEVELS.index(level) + 1 :]:
        more_owners = {owner(narrower, r, one_point) for r in records}
        if len(more_owners) > len(owners):
            levels.append(narrower)
            owners = more_owners
    return levels
