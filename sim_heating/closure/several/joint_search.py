"""One cause sought jointly in several records: is what one record hints at common to all of them?

Every record is searched by itself first. The leading causes of each - effects, errors of the table, changes of the wall
where all records are of one control point - are then fitted to all records together, from what each record found alone.
For the leading ones it is tried which parameters every record, or every point, has of its own, and whether a record is
better explained without the cause. The conclusion follows from the joint scores by the rules of one record
(search/hypothesis.py). Causes of one flight or of one thermocouple are never common.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sim_heating.base.parameters import EFFECT_PREFIX
from sim_heating.base.progress import Progress, no_progress
from sim_heating.closure.search.hypothesis import Conclusion, conclude
from sim_heating.closure.search.search import SearchResult
from sim_heating.closure.search.trials.candidates import Candidate
from sim_heating.closure.search.trials.trial_fit import TrialFit, fitted_values, sample_count
from sim_heating.closure.several.causes import applies, leading_causes
from sim_heating.closure.several.evidence import Evidence, evidence_of_records, evidence_without_cause
from sim_heating.closure.several.joint_fit import (
    FEW_STEPS,
    Cause,
    JointHypothesis,
    JointModel,
    fit_models,
    joint_hypothesis,
    joint_model,
    narrower_levels,
    parameter_cost,
    rated,
    with_common_flights,
)
from sim_heating.closure.verdict.policy import EFFORT, POLICY
from sim_heating.estimation.inference.newton import Fit
from sim_heating.heating.effects import effects


@dataclass(frozen=True, eq=False, repr=False)
class JointSearch:
    """The result of a joint search.

    alone      : each record's own search
    none       : the declared models of all records
    hypotheses : the best of each cause, best first; those that may not be named come last
    conclusion : what follows from them
    rival      : the best hypothesis of another cause than the first that has the same members; None without one
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
    def compared(self) -> JointHypothesis:
        """The best hypothesis that may be named and is better than the declared models, which it is without one.

        Errors after are of it, whether it is named as the cause or not.
        """
        if self.conclusion.finding == "none":
            return self.none
        return next((h for h in self.hypotheses if h.admissible and h.score < 0.0), self.none)

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
    bases = with_common_flights(alone)
    declared = [(base, 0.0) for base in bases]
    none = JointHypothesis((bases[0],), by_record=tuple(bases), alone=(0.0,) * len(bases))
    progress(0.05, "causes in all records together")
    hypotheses = [joint_hypothesis(m, f, bases, declared) for m, f in _fitted(leading_causes(alone), bases)]
    ranked = _best_of_each(none, hypotheses)
    progress(0.5, "parameters of each record's own")
    ranked = _best_of_each(
        none, [*_with_own_parameters(none, ranked[: EFFORT.rivals], bases), *ranked[EFFORT.rivals :]]
    )
    progress(0.75, "records without the cause")
    explanations = [_own_explanation(result) for result in alone]
    without = [_without_records(none, h, bases, explanations) for h in ranked[: EFFORT.starts]]
    if without:
        best = rated(none, [*without, *ranked])[0]
        # the others are compared over all records: what one of them leaves out may be explained by the best itself
        ranked = [best, *(h for h in ranked if h.names != best.names)]
        ranked = _best_of_each(none, ranked)
    conclusion = conclude(none, ranked)
    # one that the same records have, where there is one: by record, both are then judged alike
    others = sorted(ranked[1:], key=lambda h: (not h.admissible, h.members != ranked[0].members, h.score))
    rival = others[0] if others else None
    evidence = evidence_of_records(alone, none, ranked[0], rival) if ranked else evidence_without_cause(alone)
    return JointSearch(tuple(alone), none, tuple(ranked), conclusion, rival, tuple(evidence))


def _fitted(causes: Sequence[Cause], bases: Sequence[TrialFit]) -> list[tuple[JointModel, Fit]]:
    """The best fit of each cause, its parameters as common as they may be."""
    models, starts = [], []
    for cause in causes:
        members = [i for i, base in enumerate(bases) if applies(cause, base)]
        if len(members) < 2:
            continue
        finders = [i for i in members if i in cause.found]
        common = {i: {n: v for n, v in cause.found[i].items() if n in cause.candidate.names} for i in finders}
        values = [{j: cause.found[i] if j == i else common[i] for j in members} for i in finders[: EFFORT.rivals]]
        if len(finders) > 1:  # what is a point's own, as an onset, is nowhere near that of another point
            values.append({j: cause.found.get(j, common[finders[0]]) for j in members})
        for start in values:
            # another problem each time: side by side, none may occur twice
            models.append(joint_model(cause, bases, members, cause.widest))
            starts.append(models[-1].start(start))
    best: dict[int, tuple[JointModel, Fit]] = {}
    for model, fit in zip(models, fit_models(models, starts), strict=True):
        key = id(model.cause)
        if np.isfinite(fit.log_likelihood) and (key not in best or fit.log_likelihood > best[key][1].log_likelihood):
            best[key] = model, fit
    return list(best.values())


def _best_of_each(none: JointHypothesis, hypotheses: Sequence[JointHypothesis]) -> list[JointHypothesis]:
    """The best hypothesis of each cause, best first."""
    best: dict[frozenset[str], JointHypothesis] = {}
    for h in rated(none, hypotheses):
        best.setdefault(frozenset(h.names), h)
    return rated(none, list(best.values()))


# Own parameters, and records without the cause ------------------------------------------------------------------------


def _with_own_parameters(
    none: JointHypothesis, ranked: Sequence[JointHypothesis], bases: Sequence[TrialFit]
) -> list[JointHypothesis]:
    """Hypotheses with those parameters narrower that gain more than they cost.

    With all of them as narrow as they can be the likelihood is largest. Where that gains less than one more parameter
    costs, or does not bring a hypothesis near the best, it is left as it is; else they are tried one by one.
    """
    models = [_narrowed(h, bases, None) for h in ranked]
    tried = [k for k, m in enumerate(models) if m is not None]
    narrowed = dict(
        zip(tried, _fit_narrower([ranked[k] for k in tried], [models[k] for k in tried], bases), strict=True)
    )
    every = rated(none, [*ranked, *narrowed.values()])
    results, best = [], every[0].score if every else 0.0
    for k, h in enumerate(ranked):
        if k not in narrowed:
            results.append(h)
            continue
        common, own = (next(r for r in every if r.model is x.model) for x in (h, narrowed[k]))
        gained = common.score - common.price - (own.score - own.price) + _more(common, own)
        costs = math.log(sample_count(bases[0].problem))
        near = common.score - gained < best + POLICY.rival_margin
        results.append(_one_by_one(none, h, narrowed[k], bases) if gained > costs and near else h)
    return results


def _more(common: JointHypothesis, own: JointHypothesis) -> float:
    """What the parameters of a narrower hypothesis cost more than those of a wider one."""
    return parameter_cost(own) - parameter_cost(common)


def _one_by_one(
    none: JointHypothesis, h: JointHypothesis, narrowest: JointHypothesis, bases: Sequence[TrialFit]
) -> JointHypothesis:
    """The best of a hypothesis, of it with all parameters as narrow as they can be, and with one after the other."""
    best = rated(none, [h, narrowest])[0]
    at = h
    while at.model is not None:
        models = [m for name in at.model.levels if (m := _narrowed(at, bases, name)) is not None]
        models = [m for m in models if narrowest.model is None or m.levels != narrowest.model.levels]  # fitted already
        if not models:
            break
        price = 2.0 * math.log(len(models) + 1)
        tried = [replace(x, price=x.price + price) for x in _fit_narrower([at] * len(models), models, bases)]
        ranked = rated(none, [best, at, *tried])
        best = ranked[0]
        following = next(r for r in ranked if any(r.model is t.model for t in tried))
        if not following.score < next(r for r in ranked if r.model is at.model).score:
            break
        at = following
    return best


def _fit_narrower(
    wider: Sequence[JointHypothesis], models: Sequence[JointModel | None], bases: Sequence[TrialFit]
) -> list[JointHypothesis]:
    """Narrower models fitted from the values of wider ones, and from those that records found alone; the better."""
    wanted, starts = [], []
    for h, model in zip(wider, models, strict=True):
        assert model is not None
        values = {i: fitted_values(h.by_record[i]) for i in model.members}
        alone = {i: {**values[i], **model.cause.found.get(i, {})} for i in model.members}
        wanted += [model, joint_model(model.cause, bases, model.members, model.levels)]
        starts += [model.start(values), model.start(alone)]
    fits = fit_models(wanted, starts, iterations=FEW_STEPS)
    declared, hypotheses = [(base, 0.0) for base in bases], []
    for k, h in enumerate(wider):
        pairs = list(zip(wanted, fits, strict=True))[2 * k : 2 * k + 2]
        model, fit = max(pairs, key=lambda p: p[1].log_likelihood if np.isfinite(p[1].log_likelihood) else -np.inf)
        hypotheses.append(joint_hypothesis(model, fit, bases, declared) if np.isfinite(fit.log_likelihood) else h)
    return hypotheses


def _narrowed(h: JointHypothesis, bases: Sequence[TrialFit], name: str | None) -> JointModel | None:
    """The model with one parameter a level narrower, or with all as narrow as they can be; None where none can."""
    if h.model is None:
        return None
    records = [bases[i].problem.record_fits[0].record for i in h.model.members]
    steps = {n: narrower_levels(level, records) for n, level in h.model.levels.items() if name in (None, n)}
    narrower = {n: s[-1] if name is None else s[0] for n, s in steps.items() if s}
    return joint_model(h.model.cause, bases, h.model.members, {**h.model.levels, **narrower}) if narrower else None


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

    A record is left out only where the score is lower by `Policy.min_gain` without it, and none where they have the
    error of a flight in common: all of them inform that.
    """
    if any(base.problem.record_fits[0].flight_names for base in bases):
        return h
    best = h
    while best.model is not None and len(best.members) > 1:
        model, models = best.model, []
        for i in model.members:
            rest = [j for j in model.members if j != i]
            models.append(joint_model(model.cause, bases, rest, model.levels))
        values = {i: fitted_values(best.by_record[i]) for i in model.members}
        # from what the remaining records found alone too: the one left out may have pulled the common values away
        again = [joint_model(m.cause, bases, m.members, m.levels) for m in models]
        starts = [m.start(values) for m in models] + [m.start(m.cause.found) for m in again]
        tried = [
            replace(joint_hypothesis(m, f, bases, explanations), price=best.price)
            for m, f in zip([*models, *again], fit_models([*models, *again], starts, iterations=FEW_STEPS), strict=True)
            if np.isfinite(f.log_likelihood)
        ]
        ranked = rated(none, [best, *tried])
        kept = next(r for r in ranked if r.model is best.model)
        without = ranked[0]
        left_out = next((k for k, i in enumerate(model.members) if i not in without.members), None)
        if left_out is None or not without.score < kept.score - _needed_gain(model, left_out):
            return kept
        best = ranked[0]
    return best


def _needed_gain(model: JointModel, member: int) -> float:
    """By how much the score has to be lower without a member for it to be left out [BIC].

    Nothing where the member has a magnitude of its own, or another parameter that it could have in common: a magnitude
    near none, or an onset beyond what was flown, then takes the cause away from the record.
    """
    own = {u.parameter.name for u in model.problem.unknowns if u.records == (member,)}
    own &= set(model.levels)
    magnitudes = {n for c in model.cause.candidates for n in _magnitudes(c)}
    narrower = any(model.levels[n] != model.cause.widest[n] for n in own)
    return 0.0 if narrower or (magnitudes and magnitudes <= own) else POLICY.min_gain


def _magnitudes(candidate: Candidate) -> list[str]:
    """Dotted names of an effect's parameters without which it does nothing; all of them where it has no others."""
    effect = effects().get(candidate.name)
    neutral = {f"{EFFECT_PREFIX}{candidate.name}.{n}" for n in effect.neutral} if effect else set()
    neutral |= {n for n in candidate.names if effect and effect.own_name(n) in effect.neutral}
    return [n for n in candidate.names if n in neutral] or list(candidate.names)
