"""One cause sought jointly in several records: is what one record hints at common to all of them?

Every record is searched by itself first. The leading causes of each - effects, errors of the table, changes of the wall
where all records are of one control point - are then fitted to all records together, from what each record found alone.
For the leading ones it is tried which parameters every record, or every point, has of its own, and whether a record is
better explained without the cause. The conclusion follows from the joint scores by the rules of one record
(search/hypothesis.py). Causes of one flight or of one thermocouple are never common.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2

from sim_heating.base.progress import Progress, no_progress
from sim_heating.closure.search.changes.record_change import NO_EFFECT
from sim_heating.closure.search.hypothesis import MIN_BIC_GAIN, Conclusion, Hypothesis, conclude
from sim_heating.closure.search.search import SearchResult
from sim_heating.closure.search.trials.candidates import Candidate
from sim_heating.closure.search.trials.trial_fit import TrialFit, fitted_values
from sim_heating.closure.several.common_parameters import narrower_levels
from sim_heating.closure.several.joint_fit import (
    Cause,
    JointHypothesis,
    JointModel,
    fit_models,
    joint_hypothesis,
    joint_model,
    rated,
)
from sim_heating.estimation.inference.newton import Fit
from sim_heating.heating.effects import effects
from sim_heating.inputs.points import conditions_of_record

LEADING, MOST_CAUSES, FORMS, STARTS = 4, 8, 2, 3
"""Causes that a record puts forward, causes that are fitted jointly, forms of each, and starts of each form."""
RICHER, LEFT_OUT = 3, 2
"""Leading causes of which parameters are freed by record, and of which records are left out."""


@dataclass(frozen=True)
class Evidence:
    """What one record adds to a joint finding.

    record     : its name;  point : its control point
    alone      : the finding of its own search;  named : what that named, in words
    member     : whether the record has the cause in the best joint hypothesis
    for_cause  : score of its declared model minus that with the cause [BIC]: above 0 it speaks for the cause
    over_rival : score of the best other cause minus that of the cause in this record; None without another one
    own        : values and standard deviations of the cause's parameters that this record alone gives
    agreement  : probability of values as far from the common ones, by chance; None where it has no common parameter
    """

    record: str
    point: str
    alone: str
    named: str
    member: bool
    for_cause: float
    over_rival: float | None
    own: Mapping[str, tuple[float, float]]
    agreement: float | None

    @property
    def verdict(self) -> str:
        """What it says of the cause, in a word or two."""
        if not self.member:
            return "contradicts it"
        if self.agreement is not None and self.agreement < DISAGREES:
            return "other values"
        if self.for_cause > MIN_BIC_GAIN:
            return "supports it"
        return "contradicts it" if self.for_cause < -MIN_BIC_GAIN else "does not tell"


DISAGREES = 1e-3
"""Probability below which a record's own values contradict the common ones."""


@dataclass(frozen=True, eq=False, repr=False)
class JointSearch:
    """The result of a joint search.

    alone      : each record's own search
    none       : the declared models of all records
    hypotheses : the best of each cause, best first; those that may not be named come last
    conclusion : what follows from them
    rival      : the best hypothesis of another cause than the first; None without one
    evidence   : what each record adds to the first
    """

    alone: tuple[SearchResult, ...]
    none: JointHypothesis
    hypotheses: tuple[JointHypothesis, ...]
    conclusion: Conclusion
    rival: JointHypothesis | None
    evidence: tuple[Evidence, ...]

    @property
    def best(self) -> JointHypothesis:
        """The hypothesis that the evidence is about: the first one, whether it is named or not."""
        return self.hypotheses[0] if self.hypotheses else self.none

    @property
    def explained(self) -> bool:
        """Whether a common cause was found."""
        return self.conclusion.finding in ("found", "one of")

    def __repr__(self) -> str:
        names = ", ".join(r.record.name for r in self.alone)
        return f"<JointSearch of {names}: {self.conclusion!r}>"


def search_jointly(alone: Sequence[SearchResult], *, progress: Progress = no_progress) -> JointSearch:
    """Search for one cause that is common to several records.

    alone  : the search of each record by itself, two at least
    raises : RunError where a model that was fitted cannot be marched
    """
    bases = [result.none.last for result in alone]
    declared = [(base, 0.0) for base in bases]
    none = JointHypothesis((bases[0],), by_record=tuple(bases), alone=(0.0,) * len(bases))
    progress(0.05, "causes in all records together")
    found = [joint_hypothesis(m, f, bases, declared) for m, f in _fitted(leading_causes(alone), bases)]
    ranked = _best_of_each(none, found)
    progress(0.5, "parameters of each record's own")
    for k in range(min(RICHER, len(ranked))):
        ranked[k] = _with_own_parameters(none, ranked[k], bases)
    ranked = _best_of_each(none, ranked)
    progress(0.75, "records without the cause")
    explanations = [_own_explanation(result) for result in alone]
    for k in range(min(LEFT_OUT, len(ranked))):
        ranked[k] = _without_records(none, ranked[k], bases, explanations)
    ranked = _best_of_each(none, ranked)
    conclusion = conclude(none, ranked)
    rival = next((h for h in ranked[1:] if h.admissible), ranked[1] if len(ranked) > 1 else None)
    evidence = _evidence(alone, ranked[0], rival) if ranked else ()
    return JointSearch(tuple(alone), none, tuple(ranked), conclusion, rival, tuple(evidence))


# Causes ---------------------------------------------------------------------------------------------------------------


def leading_causes(alone: Sequence[SearchResult]) -> list[Cause]:
    """The causes that lead in any record, the likeliest over all records first.

    Those that a record alone may not name are among them: what one record cannot tell, several may.
    """
    one_point = len({result.record.declared.control_point for result in alone}) == 1
    causes: dict[tuple[object, ...], Cause] = {}
    known: dict[frozenset[str], dict[int, float]] = {}
    for i, result in enumerate(alone):
        proposed = [c for h in result.hypotheses if (c := _cause_of(h, one_point)) is not None]
        proposed = [(c, score, values) for c, score, values in proposed if np.isfinite(score)]
        leading = sorted(proposed, key=lambda p: p[1])[:LEADING]
        leading += [p for p in proposed if p not in leading][:LEADING]  # those that may be named come first
        for trial in result.rounds[0].trials[:LEADING]:
            price = 2.0 * math.log(max(result.rounds[0].forms.get(trial.name, 1), 1))
            cause = Cause((trial.name,), "table" if trial.candidate.uses == () and trial.name == "table" else "effect",
                          (trial.candidate,), price)  # fmt: skip
            leading.append((cause, trial.score, fitted_values(trial)))
        for cause, score, values in leading:
            names = frozenset(cause.names)
            scores = known.setdefault(names, {})
            scores[i] = min(score, scores.get(i, math.inf))
            key = (names, *sorted(cause.candidate.names), cause.candidate.form.fixed)
            first = causes.setdefault(key, cause)
            causes[key] = replace(first, price=max(first.price, cause.price), found={i: values, **first.found})
    order = sorted(known, key=lambda names: sum(known[names].values()))[:MOST_CAUSES]
    return [c for names in order for c in [c for c in causes.values() if frozenset(c.names) == names][:FORMS]]


def _cause_of(h: Hypothesis, one_point: bool) -> tuple[Cause, float, dict[str, float]] | None:
    """A hypothesis on one record as a cause that others may share, its score, and its values; None for causes of one
    flight or one thermocouple, and for those of a wall that the others do not have."""
    values = fitted_values(h.last)
    if h.change is None:
        return Cause(h.names, h.kind, tuple(t.candidate for t in h.trials), h.price), h.score, values
    change, price = h.change.change, h.price - h.change.deviation**2
    if change.kind != "wall" or not one_point or (change.parameter is not None and not change.in_model):
        return None
    if change.parameter is None:
        return Cause(h.names, "wall", (NO_EFFECT,), price, change), h.score, values
    name = change.parameter.name
    candidate = Candidate(change.what, (), (name,), {name: h.change.value}, active=(name,), with_prior=(name,))
    return Cause(h.names, "wall", (candidate,), price), h.score, values


def _applies(cause: Cause, base: TrialFit) -> bool:
    """Whether a record can have a cause: its thermocouples, and the columns that its effects read."""
    record = base.problem.record_fits[0].record
    flown, sensors = conditions_of_record(record), {s.name for s in record.sensors}
    needed = [column for name in cause.names if name in effects() for column in effects()[name].needs]
    named = [n.split(".", 1)[1].rpartition(".")[0] for n in cause.candidate.names if n.startswith("sensor.")]
    return all(column in flown for column in needed) and sensors.issuperset(named)


def _fitted(causes: Sequence[Cause], bases: Sequence[TrialFit]) -> list[tuple[JointModel, Fit]]:
    """The best fit of each cause, its parameters as common as they may be."""
    models, starts = [], []
    for cause in causes:
        members = [i for i, base in enumerate(bases) if _applies(cause, base)]
        if len(members) < 2:
            continue
        for i in [i for i in members if i in cause.found][:STARTS]:
            # another problem each time: side by side, none may occur twice
            model = joint_model(cause, bases, members, cause.widest)
            common = {n: v for n, v in cause.found[i].items() if n in cause.candidate.names}
            own = {j: common if j != i else {} for j in members}
            models.append(model)
            starts.append(model.start({**own, i: cause.found[i]}))
    best: dict[int, tuple[JointModel, Fit]] = {}
    for model, fit in zip(models, fit_models(models, starts), strict=True):
        key = id(model.cause)
        if np.isfinite(fit.log_likelihood) and (key not in best or fit.log_likelihood > best[key][1].log_likelihood):
            best[key] = model, fit
    return list(best.values())


def _best_of_each(none: JointHypothesis, found: Sequence[JointHypothesis]) -> list[JointHypothesis]:
    """The best hypothesis of each cause, best first."""
    best: dict[frozenset[str], JointHypothesis] = {}
    for h in rated(none, found):
        best.setdefault(frozenset(h.names), h)
    return rated(none, list(best.values()))


# Own parameters, and records without the cause ------------------------------------------------------------------------


def _with_own_parameters(none: JointHypothesis, h: JointHypothesis, bases: Sequence[TrialFit]) -> JointHypothesis:
    """The hypothesis with those parameters narrower that gain more than they cost: one of them or all, then more.

    Choosing among n forms costs 2 log n, as everywhere.
    """
    assert h.model is not None
    best, declared = h, [(base, 0.0) for base in bases]
    for _ in h.model.levels:
        assert best.model is not None
        forms = _narrower(best.model, bases)
        if not forms:
            break
        model = best.model
        joint = [{u.parameter.name: float(v) for u, v in zip(t.problem.unknowns, t.fit.values, strict=True)}
                 for t in (best.by_record[i] for i in model.members)]  # fmt: skip
        models, starts = [], []
        for levels in forms:
            for from_alone in (False, True):
                narrower = joint_model(model.cause, bases, model.members, levels)
                values = dict(zip(model.members, joint, strict=True))
                if from_alone:
                    values |= {i: {**values[i], **own} for i, own in model.cause.found.items() if i in values}
                models.append(narrower)
                starts.append(narrower.start(values))
        fits = fit_models(models, starts)
        price = best.price + 2.0 * math.log(len(forms) + 1)
        tried = [
            replace(joint_hypothesis(m, f, bases, declared), price=price)
            for m, f in zip(models, fits, strict=True)
            if np.isfinite(f.log_likelihood)
        ]
        first = rated(none, [best, *tried])[0]
        if first.model is best.model or not first.score < math.inf:
            break
        best = first
    return best


def _narrower(model: JointModel, bases: Sequence[TrialFit]) -> list[dict[str, str]]:
    """Levels with one parameter narrower, and with all of them as narrow as they can be."""
    records = [bases[i].problem.record_fits[0].record for i in model.members]
    steps = {n: narrower_levels(level, records) for n, level in model.levels.items()}
    free = {n: s for n, s in steps.items() if s}
    forms = [{**model.levels, n: s[0]} for n, s in free.items()]
    if len(free) > 1:
        forms.append({**model.levels, **{n: s[-1] for n, s in free.items()}})
    return forms


def _own_explanation(result: SearchResult) -> tuple[TrialFit, float]:
    """The trial of what a record's own search found and its score; the declared model where it found nothing."""
    best = result.conclusion.best
    return (best.last, best.score) if result.explained else (result.none.last, 0.0)


def _without_records(
    none: JointHypothesis,
    h: JointHypothesis,
    bases: Sequence[TrialFit],
    explanations: Sequence[tuple[TrialFit, float]],
) -> JointHypothesis:
    """The hypothesis without the records that are better explained by what their own search found, one after another.

    A record is left out only where the score is lower by MIN_BIC_GAIN without it.
    """
    best = h
    while best.model is not None and len(best.members) > 1:
        model, models = best.model, []
        for i in model.members:
            rest = [j for j in model.members if j != i]
            models.append(joint_model(model.cause, bases, rest, model.levels))
        values = {
            i: dict(zip((u.parameter.name for u in t.problem.unknowns), t.fit.values.tolist(), strict=True))
            for i, t in enumerate(best.by_record)
            if i in model.members
        }
        # from what the remaining records found alone too: the one left out may have pulled the common values away
        again = [joint_model(m.cause, bases, m.members, m.levels) for m in models]
        starts = [m.start(values) for m in models] + [m.start(m.cause.found) for m in again]
        tried = [
            replace(joint_hypothesis(m, f, bases, explanations), price=best.price)
            for m, f in zip([*models, *again], fit_models([*models, *again], starts), strict=True)
            if np.isfinite(f.log_likelihood)
        ]
        ranked = rated(none, [best, *tried])
        kept = next(r for r in ranked if r.model is best.model)
        if ranked[0] is kept or not ranked[0].score < kept.score - MIN_BIC_GAIN:
            return kept
        best = ranked[0]
    return best


# What each record adds ------------------------------------------------------------------------------------------------


def _evidence(alone: Sequence[SearchResult], best: JointHypothesis, rival: JointHypothesis | None) -> list[Evidence]:
    """What each record adds to the best hypothesis."""
    assert best.model is not None
    model = best.model
    singles = [joint_model(model.cause, [r.none.last for r in alone], [i], model.levels) for i in range(len(alone))]
    singles = [m for m in singles if _applies(model.cause, alone[m.members[0]].none.last)]
    values = [
        {n: float(v) for n, v in fitted_values(best.by_record[m.members[0]]).items()}
        if m.members[0] in best.members
        else dict(_common_values(best))
        for m in singles
    ]
    fits = fit_models(singles, [m.start({m.members[0]: v}) for m, v in zip(singles, values, strict=True)])
    own = {m.members[0]: m.split(f)[0] for m, f in zip(singles, fits, strict=True) if np.isfinite(f.log_likelihood)}
    return [_evidence_of(i, result, best, rival, own.get(i)) for i, result in enumerate(alone)]


def _common_values(h: JointHypothesis) -> dict[str, float]:
    """Values of the cause's parameters that are common to several records."""
    assert h.model is not None
    names = h.model.cause.candidate.names
    pairs = zip(h.model.problem.unknowns, h.last.fit.values, strict=True)
    return {u.parameter.name: float(v) for u, v in pairs if u.parameter.name in names}


def _evidence_of(
    i: int, result: SearchResult, best: JointHypothesis, rival: JointHypothesis | None, own: TrialFit | None
) -> Evidence:
    assert best.model is not None
    names = best.model.cause.candidate.names
    member = i in best.members
    at_own: dict[str, tuple[float, float]] = {}
    agreement = None
    if own is not None:
        sigma = dict(zip(own.fit.names, own.fit.sigma.tolist(), strict=True))
        at_own = {n: (v, sigma[n]) for n, v in fitted_values(own).items() if n in names}
        common = [
            u for u in best.model.problem.unknowns
            if u.parameter.name in names and len(u.records) > 1
            and any(best.model.members[k] == i for k in u.records)
        ]  # fmt: skip
        if member and common:
            scale = max(1.0, 1.0 + own.excess_chi2)
            lost = max(own.fit.log_likelihood - best.by_record[i].fit.log_likelihood, 0.0)
            agreement = float(chi2.sf(2.0 * lost / scale, len(common)))
    return Evidence(
        record=result.record.name,
        point=result.record.declared.control_point,
        alone=result.conclusion.finding,
        named=" + ".join(" or ".join(names) for names in result.conclusion.alternatives),
        member=member,
        for_cause=-best.shares[i] if member else best.alone[i],
        over_rival=None if rival is None else rival.shares[i] - best.shares[i],
        own=at_own,
        agreement=agreement,
    )
