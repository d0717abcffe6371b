"""Causes that several records may have in common: those that lead in any of them by itself."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

from sim_heating.base.parameters import SENSOR_PREFIX
from sim_heating.closure.search.hypothesis import Hypothesis
from sim_heating.closure.search.ranking import scatter_price
from sim_heating.closure.search.search import SearchResult
from sim_heating.closure.search.table_candidates import TABLE
from sim_heating.closure.search.trials.candidates import NO_EFFECT, Candidate
from sim_heating.closure.search.trials.trial_fit import TrialFit, fitted_values, sample_count
from sim_heating.closure.several.joint_fit import RECORD, Cause
from sim_heating.closure.verdict.policy import EFFORT, POLICY
from sim_heating.heating.effects import effects
from sim_heating.inputs.points import conditions_of_record


def leading_causes(alone: Sequence[SearchResult]) -> list[Cause]:
    """The causes that lead in any record, the likeliest over all records first.

    Those that a record alone may not name are among them: what one record cannot tell, several may. A cause is left out
    where the sum of its scores in each record alone, less what common parameters save, is far above that of the best.
    """
    one_point = len({result.record.declared.control_point for result in alone}) == 1
    causes: dict[tuple[object, ...], Cause] = {}
    known: dict[frozenset[str], dict[int, float]] = {}
    for i, result in enumerate(alone):
        proposed = [c for h in result.hypotheses if (c := _cause_of(i, h, one_point)) is not None]
        proposed += [_cause_of_trial(trial, result.rounds[0].forms) for trial in result.rounds[0].trials]
        for cause, score, values in sorted(proposed, key=lambda p: p[1]):
            names = frozenset(cause.names)
            known.setdefault(names, {}).setdefault(i, score)
            key = (names, *sorted(cause.candidate.names), cause.candidate.form.fixed)
            first = causes.setdefault(key, cause)
            changed = {**cause.changed, **first.changed}
            found = {i: values} | dict(first.found)
            causes[key] = replace(first, price=max(first.price, cause.price), found=found, changed=changed)
    for of_form, cause in causes.items():  # what a record found in another form is nearer than what another one found
        same = (cause.names, cause.candidate.names)
        others = [c.found for c in causes.values() if (c.names, c.candidate.names) == same]
        elsewhere = {i: values for found in reversed(others) for i, values in found.items()}
        causes[of_form] = replace(cause, found=elsewhere | dict(cause.found))
    forms = {names: [c for c in causes.values() if frozenset(c.names) == names][: EFFORT.starts] for names in known}
    log_n = math.log(sample_count(alone[0].none.last.problem))

    def reached(i: int, names: frozenset[str]) -> float:
        # several effects explain at least what each of them does
        return known[names].get(i, min((known[n].get(i, 0.0) for n in known if n < names), default=0.0))

    def bound(names: frozenset[str]) -> float:
        common = max(sum(level != RECORD for level in c.widest.values()) for c in forms[names])
        return sum(reached(i, names) for i in range(len(alone))) - (len(alone) - 1) * common * log_n

    order = sorted(known, key=bound)
    best = bound(order[0]) if order else 0.0
    worst = max(POLICY.min_of_best * best, best + POLICY.rival_margin)
    return [c for names in order[: EFFORT.compared] if bound(names) <= worst for c in forms[names]]


def _cause_of_trial(trial: TrialFit, forms: Mapping[str, int]) -> tuple[Cause, float, dict[str, float]]:
    """A candidate of the first round as a cause that others may share, its score, and its values."""
    kind = "table" if trial.name == TABLE else "effect"
    cause = Cause((trial.name,), kind, (trial.candidate,), 2.0 * math.log(max(forms.get(trial.name, 1), 1)))
    return cause, trial.score, fitted_values(trial)


def _cause_of(i: int, h: Hypothesis, one_point: bool) -> tuple[Cause, float, dict[str, float]] | None:
    """A hypothesis on record i as a cause that others may share, its score, and its values; None for causes of one
    flight or one thermocouple, and for those of a wall that the others do not have."""
    values = fitted_values(h.last)
    if h.change is None or h.changed is None:
        return Cause(h.names, h.kind, tuple(t.candidate for t in h.trials), h.price), h.score, values
    change, price = h.change, h.price - scatter_price(h.changed.deviation)
    if change.kind != "wall" or not one_point or (change.parameter is not None and not change.in_model):
        return None
    if change.parameter is None:
        return Cause(h.names, "wall", (NO_EFFECT,), price, change, changed={i: h.last}), h.score, values
    name = change.parameter.name
    candidate = Candidate(change.what, (), (name,), {name: h.changed.value}, active=(name,), with_prior=(name,))
    return Cause(h.names, "wall", (candidate,), price), h.score, values


def applies(cause: Cause, base: TrialFit) -> bool:
    """Whether a record can have a cause: its thermocouples, and the columns that its effects read."""
    record = base.problem.record_fits[0].record
    flown, sensors = conditions_of_record(record), {s.name for s in record.sensors}
    needed = [column for name in cause.names if name in effects() for column in effects()[name].needs]
    named = [n.split(".", 1)[1].rpartition(".")[0] for n in cause.candidate.names if n.startswith(SENSOR_PREFIX)]
    return all(column in flown for column in needed) and sensors.issuperset(named)
