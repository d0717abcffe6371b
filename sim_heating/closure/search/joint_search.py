"""One cause sought jointly in several records: is what one record hints at common to all of them?

Every record is searched by itself first. The leading causes of each - effects, errors of the table, changes of the wall
where all records are of one control point - are then fitted to all records together, from what each record found alone.
For the leading ones it is tried which parameters every record, or every point, has of its own, and whether a record is
better explained without the cause. The conclusion follows from the joint scores by the rules of one record
(hypothesis.py). Causes of one flight or of one thermocouple are never common.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from sim_heating.base.parameters import EFFECT_PREFIX
from sim_heating.base.progress import Progress, no_progress
from sim_heating.closure.prior.model_error import flight_scales
from sim_heating.closure.search.evidence import Evidence, applies, evidence_of_records, evidence_without_cause
from sim_heating.closure.search.hypothesis import Compared, Conclusion, Hypothesis, conclude, joint_hypothesis, scored
from sim_heating.closure.search.joint_model import (
    NO_CAUSE,
    RECORD,
    Cause,
    JointModel,
    fit_models,
    joined,
    joint_model,
    narrower_levels,
    refit_models,
)
from sim_heating.closure.search.ranking import scatter_price
from sim_heating.closure.search.search import SearchResult
from sim_heating.closure.search.table_candidates import TABLE
from sim_heating.closure.search.trials.candidates import NO_EFFECT, Candidate
from sim_heating.closure.search.trials.trial_fit import TrialFit, fitted_values, over_both, sample_count, with_error
from sim_heating.closure.verdict.policy import EFFORT, POLICY
from sim_heating.estimation.inference.newton import Fit
from sim_heating.heating.effects import effects


@dataclass(frozen=True, eq=False, repr=False)
class JointSearch(Compared):
    """The result of a joint search.

    alone      : each record's own search
    none, hypotheses, conclusion : of all records; the best hypothesis of each cause
    rival      : the best hypothesis of another cause than the first that has the same members; None without one
    evidence   : what each record adds to the first
    """

    alone: tuple[SearchResult, ...]
    none: Hypothesis
    hypotheses: tuple[Hypothesis, ...]
    conclusion: Conclusion
    rival: Hypothesis | None
    evidence: tuple[Evidence, ...]

    @property
    def best(self) -> Hypothesis:
        """The hypothesis that the evidence is about: the first one, whether it is named or not."""
        return self.hypotheses[0] if self.hypotheses else self.none

    def __repr__(self) -> str:
        names = ", ".join(r.record.name for r in self.alone)
        return f"<JointSearch of {names}: {self.conclusion!r}>"


def search_jointly(alone: Sequence[SearchResult], *, progress: Progress = no_progress) -> JointSearch:
    """Search for one cause that is common to several records.

    alone  : the search of each record by itself, two at least
    raises : RunError where a model that was fitted cannot be marched
    """
    bases = with_common_flights(alone)
    none = Hypothesis((bases[0],), each=tuple(bases), alone=(0.0,) * len(bases))
    progress(0.05, "causes in all records together")
    fits = _fitted(leading_causes(alone), bases)
    ranked = _best_of_each(none, [joint_hypothesis(none, model, fit) for model, fit in fits])
    progress(0.5, "parameters of each record's own")
    ranked = _best_of_each(none, [*_with_own_parameters(none, ranked[: EFFORT.rivals]), *ranked[EFFORT.rivals :]])
    progress(0.75, "records without the cause")
    explanations = [_own_explanation(result) for result in alone]
    without = [_without_records(none, h, explanations) for h in ranked[: EFFORT.starts]]
    if without:
        best = scored(none, [*without, *ranked])[0]
        # the others are compared over all records: what one of them leaves out may be explained by the best itself
        ranked = _best_of_each(none, [best, *(h for h in ranked if h.names != best.names)])
    # one that the same records have, where there is one: by record, both are then judged alike
    others = sorted(ranked[1:], key=lambda h: (not h.admissible, h.members != ranked[0].members, h.score))
    rival = others[0] if others else None
    evidence = evidence_of_records(alone, none, ranked[0], rival) if ranked else evidence_without_cause(alone)
    return JointSearch(tuple(alone), none, tuple(ranked), conclude(none, ranked), rival, tuple(evidence))


def with_common_flights(alone: Sequence[SearchResult]) -> list[TrialFit]:
    """The declared models of records that were searched by themselves, those of one flight with one error of it.

    The error of a record's heating is as large as with the best model of its own search, that of a flight as all its
    records say.
    """
    bases = [_with_size(result, _flight_scale(result.record.flight, alone)) for result in alone]
    flights = [b.record_fit.record.flight for b in bases]
    shared = [
        b if flights.count(flight) < 2 else over_both(b, lambda problem: problem.with_flight_unknowns())
        for b, flight in zip(bases, flights, strict=True)
    ]
    members = [i for i, b in enumerate(shared) if b.record_fit.flight_names]
    if not members:
        return bases
    trials = tuple(shared[i] for i in members)
    model = JointModel(NO_CAUSE, tuple(members), {}, trials, joined([t.problem for t in trials], {}))
    fit = fit_models([model], [model.start({})])[0]
    if not np.isfinite(fit.log_likelihood):
        return bases
    for i, trial in zip(members, model.split(fit), strict=True):
        shared[i] = trial
    return shared


def _flight_scale(flight: str, alone: Sequence[SearchResult]) -> float:
    """Most probable factor on the standard deviations that are stated of a flight, by the best models of its records.

    Each record speaks for itself, and the prior counts once. Records that state different things are believed.
    """
    of_flight = [r for r in alone if r.record.flight == flight]
    prior = flight_scales(of_flight[0].record)
    sizes = [size for r in of_flight if (size := r.compared.last.size) is not None]
    if any(size.scales.tolist() != list(prior) for size in sizes):
        return 1.0
    total = np.log(list(prior.values())) + sum(size.log_likelihood_of_scale for size in sizes)
    return list(prior)[int(np.argmax(total))]


def _with_size(result: SearchResult, flight_scale: float) -> TrialFit:
    """The declared model with the error as large as with the best model of a record's own search.

    flight_scale : factor on the standard deviations that are stated of its flight [-]
    """
    base, size = result.base, result.compared.last.size
    error = base.record_fit.model_error
    if size is None or error is None:
        return base
    sigma, correlation, _ = size.likeliest
    return replace(with_error(base, error.of_size(sigma, correlation, flight_scale)), size=size)


def _best_of_each(none: Hypothesis, hypotheses: Sequence[Hypothesis]) -> list[Hypothesis]:
    """The best hypothesis of each cause, best first."""
    best: dict[frozenset[str], Hypothesis] = {}
    for h in scored(none, hypotheses):
        best.setdefault(frozenset(h.names), h)
    return scored(none, list(best.values()))


# Causes that several records may have in common -----------------------------------------------------------------------


def leading_causes(alone: Sequence[SearchResult]) -> list[Cause]:
    """The causes that lead in any record, the likeliest over all records first.

    Those that a record alone may not name are among them: what one record cannot tell, several may. A cause is left out
    where the sum of its scores in each record alone, less what common parameters save, is far above that of the best.
    """
    causes, scores = _proposed_causes(alone)
    by_names = {names: [c for c in causes if frozenset(c.names) == names][: EFFORT.starts] for names in scores}
    log_n = math.log(sample_count(alone[0].none.last.problem))

    def reached(i: int, names: frozenset[str]) -> float:
        # several effects explain at least what each of them does
        return scores[names].get(i, min((scores[n].get(i, 0.0) for n in scores if n < names), default=0.0))

    def bound(names: frozenset[str]) -> float:
        common = max(sum(level != RECORD for level in c.widest.values()) for c in by_names[names])
        return sum(reached(i, names) for i in range(len(alone))) - (len(alone) - 1) * common * log_n

    order = sorted(scores, key=bound)
    best = bound(order[0]) if order else 0.0
    worst = max(POLICY.min_of_best * best, best + POLICY.rival_margin)
    return [c for names in order[: EFFORT.compared] if bound(names) <= worst for c in by_names[names]]


def _proposed_causes(alone: Sequence[SearchResult]) -> tuple[list[Cause], dict[frozenset[str], dict[int, float]]]:
    """The causes that any record proposes, in each form once, and by their names the score in each record."""
    one_point = len({result.record.declared.control_point for result in alone}) == 1
    causes: dict[tuple[object, ...], Cause] = {}
    scores: dict[frozenset[str], dict[int, float]] = {}
    for i, result in enumerate(alone):
        proposed = [c for h in result.hypotheses if (c := _cause_of(i, h, one_point)) is not None]
        proposed += [_cause_of_trial(trial, result.first.forms) for trial in result.first.trials]
        for cause, score, values in sorted(proposed, key=lambda p: p[1]):
            names = frozenset(cause.names)
            scores.setdefault(names, {}).setdefault(i, score)
            key = (names, *sorted(cause.candidate.names), cause.candidate.form.fixed)
            first = causes.setdefault(key, cause)
            causes[key] = replace(
                first, price=max(first.price, cause.price), values={i: values} | dict(first.values),
                changed={**cause.changed, **first.changed},
            )  # fmt: skip
    for form, cause in causes.items():  # what a record found in another form is nearer than what another one found
        same = (cause.names, cause.candidate.names)
        forms = [c.values for c in causes.values() if (c.names, c.candidate.names) == same]
        elsewhere = {i: values for by_record in reversed(forms) for i, values in by_record.items()}
        causes[form] = replace(cause, values=elsewhere | dict(cause.values))
    return list(causes.values()), scores


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


def _fitted(causes: Sequence[Cause], bases: Sequence[TrialFit]) -> list[tuple[JointModel, Fit]]:
    """The best fit of each cause, its parameters as common as they may be."""
    models, starts = [], []
    for cause in causes:
        members = [i for i, base in enumerate(bases) if applies(cause, base)]
        if len(members) < 2:
            continue
        for start in _starts(cause, members):
            # another problem each time: side by side, none may occur twice
            models.append(joint_model(cause, bases, members, cause.widest))
            starts.append(models[-1].start(start))
    best: dict[int, tuple[JointModel, Fit]] = {}
    for model, fit in zip(models, fit_models(models, starts), strict=True):
        key = id(model.cause)
        if np.isfinite(fit.log_likelihood) and (key not in best or fit.log_likelihood > best[key][1].log_likelihood):
            best[key] = model, fit
    return list(best.values())


def _starts(cause: Cause, members: Sequence[int]) -> list[dict[int, Mapping[str, float]]]:
    """Values to start a cause from, by member: what one found by itself, its parameters of the cause in the others."""
    finders = [i for i in members if i in cause.values]
    common = {i: {n: v for n, v in cause.values[i].items() if n in cause.candidate.names} for i in finders}
    starts = [dict.fromkeys(members, common[i]) | {i: cause.values[i]} for i in finders[: EFFORT.rivals]]
    if len(finders) > 1:  # what is a point's own, as an onset, is nowhere near that of another point
        starts.append({j: cause.values.get(j, common[finders[0]]) for j in members})
    return starts


# Parameters of each record, and records without the cause -------------------------------------------------------------


def _with_own_parameters(none: Hypothesis, ranked: Sequence[Hypothesis]) -> list[Hypothesis]:
    """Hypotheses with those parameters narrower that gain more than they cost.

    With all of them as narrow as they can be the likelihood is largest. Where that gains less than one more parameter
    costs, or does not bring a hypothesis near the best, it is left as it is; else they are tried one by one.
    """
    models = [_narrowed(none, h, None) for h in ranked]
    narrowed = {k: _fit_narrower(none, ranked[k], [m])[0] for k, m in enumerate(models) if m is not None}
    every = scored(none, [*ranked, *narrowed.values()])
    results, best = [], every[0].score if every else 0.0
    for k, h in enumerate(ranked):
        if k not in narrowed:
            results.append(h)
            continue
        wide, narrow = _first_of(every, h), _first_of(every, narrowed[k])
        assert wide.model is not None
        assert narrow.model is not None
        extra_cost = narrow.model.parameter_cost - wide.model.parameter_cost
        gained = wide.score - wide.price - (narrow.score - narrow.price) + extra_cost
        costs = math.log(sample_count(none.last.problem))
        near = wide.score - gained < best + POLICY.rival_margin
        results.append(_one_by_one(none, h, narrowed[k]) if gained > costs and near else h)
    return results


def _one_by_one(none: Hypothesis, h: Hypothesis, narrowest: Hypothesis) -> Hypothesis:
    """The best of a hypothesis, of it with all parameters as narrow as they can be, and with one after the other."""
    best, at = scored(none, [h, narrowest])[0], h
    fitted = narrowest.model and narrowest.model.levels
    while at.model is not None:
        narrower = [_narrowed(none, at, name) for name in at.model.levels]
        models = [m for m in narrower if m is not None and m.levels != fitted]
        if not models:
            break
        price = 2.0 * math.log(len(models) + 1)
        tried = [replace(x, price=x.price + price) for x in _fit_narrower(none, at, models)]
        ranked = scored(none, [best, at, *tried])
        best = ranked[0]
        following = _first_of(ranked, *tried)
        if not following.score < _first_of(ranked, at).score:
            break
        at = following
    return best


def _first_of(ranked: Sequence[Hypothesis], *hypotheses: Hypothesis) -> Hypothesis:
    """The first of the ranked hypotheses that is one of these, as it is scored among the ranked."""
    return next(r for r in ranked if any(r.model is h.model for h in hypotheses))


def _fit_narrower(none: Hypothesis, wider: Hypothesis, models: Sequence[JointModel]) -> list[Hypothesis]:
    """Narrower models of a cause fitted from the values of a wider one, and from those that records found alone; of
    each the better, or the wider one where neither can be marched."""
    hypotheses = []
    pairs = [(m, joint_model(m.cause, none.each, m.members, m.levels)) for m in models]
    values = {i: fitted_values(wider.each[i]) for i in wider.members}
    alone = {i: {**v, **wider.model.cause.values.get(i, {})} for i, v in values.items() if wider.model}
    starts = [m.start(v) for pair in pairs for m, v in zip(pair, (values, alone), strict=True)]
    fitted = refit_models([m for pair in pairs for m in pair], starts)
    for pair in pairs:
        either = [x for x in fitted if x[0] in pair]
        best = max(either, key=lambda x: x[1].log_likelihood, default=None)
        hypotheses.append(wider if best is None else joint_hypothesis(none, *best))
    return hypotheses


def _narrowed(none: Hypothesis, h: Hypothesis, name: str | None) -> JointModel | None:
    """The model with one parameter a level narrower, or with all as narrow as they can be; None where none can."""
    if h.model is None:
        return None
    records = [none.each[i].record_fit.record for i in h.model.members]
    steps = {n: narrower_levels(level, records) for n, level in h.model.levels.items() if name in (None, n)}
    narrower = {n: s[-1] if name is None else s[0] for n, s in steps.items() if s}
    levels = {**h.model.levels, **narrower}
    return joint_model(h.model.cause, none.each, h.model.members, levels) if narrower else None


def _own_explanation(result: SearchResult) -> tuple[TrialFit, float]:
    """The trial of what a record's own search found and its score; the declared model where it found nothing."""
    best = result.conclusion.best
    return (best.last, best.score) if result.explained else (result.none.last, 0.0)


def _without_records(none: Hypothesis, h: Hypothesis, explanations: Sequence[tuple[TrialFit, float]]) -> Hypothesis:
    """The hypothesis without the records that are better explained by what their own search found, one after another.

    A record is left out only where the score is lower by `Policy.min_gain` without it, and none where they have the
    error of a flight in common: all of them inform that.
    """
    if any(base.record_fit.flight_names for base in none.each):
        return h
    best = h
    while best.model is not None and len(best.members) > 1:
        model, fitted = best.model, _fits_of_rest(none, best, best.model)
        tried = [replace(joint_hypothesis(none, m, f, explanations), price=best.price) for m, f in fitted]
        ranked = scored(none, [best, *tried])
        kept, without = _first_of(ranked, best), ranked[0]
        left_out = next((k for k, i in enumerate(model.members) if i not in without.members), None)
        if left_out is None or not without.score < kept.score - _needed_gain(model, left_out):
            return kept
        best = without
    return best


def _fits_of_rest(none: Hypothesis, h: Hypothesis, model: JointModel) -> list[tuple[JointModel, Fit]]:
    """The model of a hypothesis fitted without each of its members in turn, from its values.

    From what the remaining records found alone too: the one left out may have pulled the common values away.
    """
    values = {i: fitted_values(h.each[i]) for i in model.members}
    rests = [[j for j in model.members if j != i] for i in model.members]
    # another problem each time: side by side, none may occur twice
    models = [joint_model(model.cause, none.each, rest, model.levels) for rest in (*rests, *rests)]
    from_both = [values] * len(rests) + [model.cause.values] * len(rests)
    return refit_models(models, [m.start(v) for m, v in zip(models, from_both, strict=True)])


def _needed_gain(model: JointModel, member: int) -> float:
    """By how much the score has to be lower without a member for it to be left out [BIC].

    Nothing where the member has a magnitude of its own, or another parameter that it could have in common: a magnitude
    near none, or an onset beyond what was flown, then takes the cause away from the record.
    """
    names = {u.parameter.name for u in model.problem.unknowns if u.records == (member,)} & set(model.levels)
    magnitudes = {n for c in model.cause.candidates for n in _magnitudes(c)}
    narrower = any(model.levels[n] != model.cause.widest[n] for n in names)
    return 0.0 if narrower or (magnitudes and magnitudes <= names) else POLICY.min_gain


def _magnitudes(candidate: Candidate) -> list[str]:
    """Dotted names of an effect's parameters without which it does nothing; all of them where it has no others."""
    effect = effects().get(candidate.name)
    neutral = {f"{EFFECT_PREFIX}{candidate.name}.{n}" for n in effect.neutral} if effect else set()
    neutral |= {n for n in candidate.names if effect and effect.own_name(n) in effect.neutral}
    return [n for n in candidate.names if n in neutral] or list(candidate.names)
