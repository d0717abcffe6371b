"""Search for the effects that the declared model of a record lacks.

The declared model's magnitude and derivatives are fitted first. Then every candidate is screened (screening.py), the
promising ones are fitted together with these (trial_fit.py), and the leading ones are fitted to convergence in their
simplest and richest forms (refine.py). Changes of the record's flight, wall and sensors are screened and fitted in the
same way (record_change.py), and wrong derivatives of its table (table_candidates.py).

Where the best single cause explains the record to its noise the search ends, unless the model has an error, which takes
up what further causes leave: those are then sought by their odds. Otherwise a further effect is sought on
top of each of several first ones, jointly with it. A further effect has to explain a good part of the remaining excess,
and to improve the prediction of the segments held out; at the end each is left out in turn, and stays out where the
score does not suffer. All models are then compared (hypothesis.py). Where none is adequate, a smooth curve against one
variable shows what the residual follows; it is never named as a cause. Before that, one effect is sought besides the
best change of the record, where that explains half of the residual.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from sim_heating.base.parallel.processes import in_processes
from sim_heating.base.parameters import EFFECT_PREFIX
from sim_heating.base.progress import Progress, no_progress
from sim_heating.closure.clues.flight_consistency import Discrepancy, flight_discrepancies
from sim_heating.closure.curves import curve_trials
from sim_heating.closure.search.changes.flight_changes import flight_changes, judged_by_motion, lamp_changes
from sim_heating.closure.search.changes.property_shapes import shape_changes
from sim_heating.closure.search.changes.record_change import fit_changes, with_own_corrections
from sim_heating.closure.search.changes.sensor_changes import sensor_changes
from sim_heating.closure.search.changes.wall_changes import wall_changes
from sim_heating.closure.search.hypothesis import (
    Compared,
    Conclusion,
    Hypothesis,
    change_hypothesis,
    conclude,
    fitted_anew,
    hypothesis,
    least_gain,
    scored,
    told_by_fewer,
    with_one_more,
)
from sim_heating.closure.search.ranking import SearchRound, count_forms, scored_trials
from sim_heating.closure.search.refine import fit_converged, recorrected, refine
from sim_heating.closure.search.table_candidates import table_candidates
from sim_heating.closure.search.trials import trial_fit
from sim_heating.closure.search.trials.candidates import Candidate, Form, candidates
from sim_heating.closure.search.trials.change import RecordChange
from sim_heating.closure.search.trials.free_forms import free_form, has_free_form
from sim_heating.closure.search.trials.history_starts import history_starts
from sim_heating.closure.search.trials.screening import fit_in_stages, gains_from, predicted_gains, select_candidates
from sim_heating.closure.search.trials.trial_fit import TrialFit, delta_bic
from sim_heating.closure.verdict.policy import EFFORT, POLICY
from sim_heating.estimation.fit import FitResult
from sim_heating.inputs.points import conditions_of_record
from sim_heating.inputs.record import Record


@dataclass(frozen=True, eq=False, repr=False)
class SearchResult(Compared):
    """The result of the search for missing effects in one record.

    before     : the declared model's fit, its magnitude and derivatives
    first      : the pass over all candidates on top of the declared model
    hypotheses : all models that were fitted to convergence, best first; those that may not be named come last
    conclusion : what follows from them
    discrepancies : parts of the flight whose conditions contradict each other
    curve      : the best smooth curve against one variable, where nothing adequate was found
    """

    record: Record
    before: FitResult
    first: SearchRound
    none: Hypothesis
    hypotheses: tuple[Hypothesis, ...]
    conclusion: Conclusion
    discrepancies: Sequence[Discrepancy] = ()
    curve: TrialFit | None = None

    @property
    def base(self) -> TrialFit:
        """The declared model as the search began with it, where `none` has the error that the record says it has."""
        return self.first.base

    @property
    def added(self) -> tuple[TrialFit, ...]:
        """Trial fits whose effects are added to the model, in order; none where nothing is named."""
        return self.conclusion.best.added if self.explained else ()

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the added effects; else `unknown` or `none`."""
        named = self.conclusion.best.effects if self.explained else ()
        return named or (self.conclusion.effect_name,)

    def __repr__(self) -> str:
        return f"<SearchResult of {self.record.name}: {' + '.join(self.names)}>"


def search_effects(
    record: Record, names: Sequence[str] | None = None, *, progress: Progress = no_progress
) -> SearchResult:
    """Search for the effects that the declared model of a record lacks.

    names  : dotted names of the parameters of the declared model that are fitted; by default magnitude and derivatives
    raises : InputError, RunError where not even the declared model can be fitted
    """
    progress(0.02, "declared model")
    before = trial_fit.declared_fit(record, names)
    own = trial_fit.base_trial(before)
    # candidates are compared by their log likelihoods with the error of the base, until each has its own
    base = replace(own, size=None)
    first = search_round(base, [], _stage(progress, 0.1, 0.35, "one effect"))
    search = _Search(record, first, hypothesis([base], {}))
    hypotheses = [search.stack([t]) for t in _refined(first, _stage(progress, 0.35, 0.45, "one effect"))]
    discrepancies = flight_discrepancies(record.conditions)
    progress(0.45, "changes of the flight, the wall and the sensors")
    hypotheses += _changes(before, base, hypotheses, discrepancies)
    rated = scored(search.none, hypotheses)
    if search.lacks_more(rated):
        hypotheses += search.fitted_on(hypotheses)
        rated = scored(search.none, hypotheses)
    if search.lacks_more(rated) and not base.has_error:
        rated = search.further_causes(hypotheses, progress)
    none, rated = _judged(hypothesis([own], {}), rated)
    if base.has_error:
        rated = search.beside_an_error(none, rated, progress)
    if none.last.record_fit.model_error is not None:
        rated = _worth_their_causes(none, rated)
    conclusion, curve = conclude(none, rated), None
    if conclusion.finding in ("partly", "unknown"):
        progress(0.95, "a curve against the variable that the residual follows")
        curve = next(iter(curve_trials(base)), None)
    return SearchResult(record, before, first, none, tuple(rated), conclusion, discrepancies, curve)


def _judged(none: Hypothesis, rated: Sequence[Hypothesis]) -> tuple[Hypothesis, list[Hypothesis]]:
    """The declared model and the leading hypotheses, each with the error of the model that the record says it has.

    Until here all have that of the declared model, of the prior's scale at most, with the response about its values.
    """
    if none.last.record_fit.model_error is None:
        return none, list(rated)
    leading = [*_leading(rated), *[h for h in rated if not h.admissible][: EFFORT.rivals]]
    none, *judged = _with_own_errors([none, *leading])
    rated = scored(none, judged)
    best = next((h for h in rated if h.admissible), none)
    if best.score > -least_gain(none):
        return none, rated
    # the likeliest error is sought from the values of each model: that of the best may be better for the declared one
    with_its_error = trial_fit.with_own_error(none.last, best.last.size)
    if with_its_error is none.last:
        return none, rated
    none = fitted_anew(none, with_its_error)
    return none, scored(none, rated)


def _with_own_errors(hypotheses: Sequence[Hypothesis]) -> list[Hypothesis]:
    """Hypotheses with the error of the model that the record says each has, fitted on."""
    trials = in_processes([partial(trial_fit.with_own_error, h.last) for h in hypotheses])
    return [fitted_anew(h, trial) for h, trial in zip(hypotheses, trials, strict=True)]


def _leading(rated: Sequence[Hypothesis]) -> list[Hypothesis]:
    """The leading hypotheses that may be named, with the best of each number of causes among them, and these without
    each of their causes."""
    first = list(_best_by_count(rated).values())
    others = [h for h in rated if h.admissible and h not in first]
    leading = [*first, *others][: EFFORT.compared]
    without_one = ({*h.names} - {name} for h in first if len(h.names) > 1 for name in h.names)
    simpler = (next((h for h in rated if {*h.names} == names), None) for names in without_one)
    return sorted(dict.fromkeys([*leading, *(h for h in simpler if h is not None)]), key=lambda h: h.score)


def _best_by_count(rated: Sequence[Hypothesis]) -> dict[int, Hypothesis]:
    """Number of causes -> the best hypothesis with so many that may be named."""
    return {len(h.names): h for h in reversed(rated) if h.admissible}


def _worth_their_causes(none: Hypothesis, rated: Sequence[Hypothesis]) -> list[Hypothesis]:
    """Hypotheses with the objection to those whose further causes gain too little, which come last.

    Over the simplest one that explains the record they gain `Policy.min_gain_over_adequate`, as the form of its cause
    may be wrong; over others with fewer causes `Policy.min_gain_of_further`. Where no single cause is better than the
    declared model, there are none: parts of two that cancel follow an error of the heating that is larger than stated.
    """
    best = _best_by_count(rated)
    is_one_named = 1 in best and best[1].score <= -least_gain(none)

    def judged(h: Hypothesis) -> Hypothesis:
        if len(h.names) == 1:
            return h
        against = [] if is_one_named else ["none of its causes alone is better than the declared model"]
        against += [
            _gains_too_little(h, fewer) for fewer, score in _to_reach(best, len(h.names)) if not h.score <= score
        ]
        return replace(h, objections=(*h.objections, *against))

    return sorted(map(judged, rated), key=lambda h: (not h.admissible, h.score))


def _to_reach(best: Mapping[int, Hypothesis], count: int) -> list[tuple[Hypothesis, float]]:
    """Hypotheses with fewer causes than a number, and the score that one with so many has to reach over each.

    best : as `_best_by_count` has it
    """
    simplest = next((h for _, h in sorted(best.items()) if h.adequate), None)
    leasts = {h: POLICY.min_gain_over_adequate if h is simplest else POLICY.min_gain_of_further for h in best.values()}
    return [(h, h.score - leasts[h]) for n, h in best.items() if n < count]


def _gains_too_little(h: Hypothesis, fewer: Hypothesis) -> str:
    """The objection that a hypothesis gains too little over one with fewer causes."""
    gain = max(0.5 * (fewer.score - h.score), 0.0)
    return f"it gains {gain:.0f} in log evidence over {' + '.join(fewer.names)}: too little for a further cause"


def _stage(progress: Progress, begin: float, end: float, label: str = "") -> Progress:
    """Progress of a stage of the search; label : before what it is doing."""
    return lambda fraction, text: progress(begin + (end - begin) * fraction, f"{label}: {text}" if label else text)


def _changes(
    baseline: FitResult, base: TrialFit, singles: Sequence[Hypothesis], discrepancies: Sequence[Discrepancy]
) -> list[Hypothesis]:
    """Hypotheses that the record's flight, wall or sensors are other than declared.

    singles : of one effect each. Where one explains the record to its noise, it needs no further forms of that effect
    """
    # parts of the best gain in log likelihood that a change of the record has to predict to be fitted: one without
    # ends, and one whose ends can be moved, which gains more by that; the second two where an effect explains the
    # record to its noise
    change_shares, shares_beside_adequate = (0.5, 0.25), (0.8, 0.6)
    record, explained = base.record_fit.record, _explaining(singles)
    changes = [
        *flight_changes(record, discrepancies), *lamp_changes(record), *wall_changes(record), *shape_changes(record),
        *sensor_changes(base),
    ]  # fmt: skip
    changes = [c for c in changes if not _is_fitted_already(base, c, explained)]
    best = max((h.last.fit.log_likelihood - base.fit.log_likelihood for h in singles), default=0.0)
    share, near_share = shares_beside_adequate if explained else change_shares
    fits = fit_changes(base, changes, best, share=share, near_share=near_share, most=EFFORT.compared)
    stated, tried = baseline.problem.record_fits[0].record, Counter(c.family for c in changes)
    return [
        change_hypothesis(t, tried[t.change.family], *judged_by_motion(stated, t))
        for t in with_own_corrections(baseline, base, fits)
        if t.change is not None
    ]


def _is_fitted_already(base: TrialFit, change: RecordChange, explained: Collection[str]) -> bool:
    """Whether the parameters of a change are fitted, or are those of an effect that explains the record."""
    if change.in_model and change.parameter and trial_fit.is_fitted(base, change.parameter.name):
        return True
    return bool(change.free) and (
        change.effect in explained or any(trial_fit.is_fitted(base, name) for name in change.free)
    )


def _explaining(hypotheses: Sequence[Hypothesis]) -> set[str]:
    """Names of the hypotheses that may be named and explain the record to its noise."""
    return {name for h in hypotheses if h.admissible and h.adequate for name in h.names}


def _candidates(base: TrialFit, excluded: Sequence[str]) -> list[Candidate]:
    """All candidates on top of a model, over the samples that are fitted."""
    record = base.record_fit.record
    flown = conditions_of_record(record)
    fitted = [n.split(".")[1] for n in base.record_fit.march_names if n.startswith(EFFECT_PREFIX)]
    tried = candidates(record, flown.at(flown.time_s[record.fit_mask(flown.time_s)]), [*excluded, *fitted])
    return [c for c in tried if not any(trial_fit.is_fitted(base, name) for name in c.model_names)]


def _refined(of_round: SearchRound, progress: Progress) -> list[TrialFit]:
    """The leading candidates of a round, fitted to convergence."""
    progress(0.0, f"fitting the leading of {len(of_round.trials)} candidates to convergence")
    return refine(of_round.base, of_round.trials, of_round.tried, of_round.predicted)


@dataclass(frozen=True, eq=False)
class _Search:
    """What models of several causes are built from.

    record : with all samples of its conditions
    first  : the pass over all candidates on top of the declared model
    none   : the declared model
    """

    record: Record
    first: SearchRound
    none: Hypothesis

    def stack(self, trials: Sequence[TrialFit], forms: Mapping[str, int] | None = None) -> Hypothesis:
        """The hypothesis of effects, each fitted on top of those before.

        forms : number of forms of each effect that were tried, where not in the first pass alone
        """
        return hypothesis(trials, {**self.first.forms, **(forms or {})})

    def lacks_more(self, rated: Sequence[Hypothesis]) -> bool:
        """Whether something is missing that no admissible hypothesis explains to the noise.

        A curve may take up all of a second effect: it does not end the search.
        """
        if not rated or min(h.last.delta_bic for h in rated) > -POLICY.min_gain:
            return False
        best = rated[0]
        return not (best.admissible and best.adequate) or has_free_form(best.last)

    def further_causes(self, hypotheses: Sequence[Hypothesis], progress: Progress) -> list[Hypothesis]:
        """Hypotheses with those of two causes and more, as far as these are accepted, best first."""
        pairs = self.with_one_more(_first_picks(hypotheses), _stage(progress, 0.5, 0.8, "two effects"))
        rated = _accepted(self.none, [*hypotheses, *pairs])
        if self.lacks_more(rated):
            pairs += self.fitted_on(pairs)
        models = [*hypotheses, *pairs]
        rated = _accepted(self.none, models)
        if self.lacks_more(rated) and len(rated[0].names) == 2 and rated[0].change is None:
            stage = _stage(progress, 0.8, 0.9, "three effects")
            triples = self.with_one_more([list(rated[0].trials)], stage)
            models += [*triples, *self.recorrected(triples)]
        models += self.pruned(_accepted(self.none, models))
        models += self.exchanged(models, _stage(progress, 0.85, 0.9, "rivals of the causes"))
        rated = _accepted(self.none, models)
        if self.lacks_more(rated):
            models += self.on_the_best_change(rated, _stage(progress, 0.9, 0.95, "an effect besides a change"))
            rated = _accepted(self.none, models)
        return rated

    def beside_an_error(self, none: Hypothesis, rated: Sequence[Hypothesis], progress: Progress) -> list[Hypothesis]:
        """Hypotheses of a model with an error with those of one cause more at a time, and without one, best first.

        none, rated : the declared model and those of one cause, each with its own error

        The error takes up what further causes leave, so that the first one explains the record: whether there are more
        is told by the odds alone.
        """
        begin, end = 0.6, 0.9
        models, share = list(rated), (end - begin) / EFFORT.rivals
        for k in range(EFFORT.rivals):
            best = next((h for h in models if h.admissible), None)
            if best is None or best.change is not None or best.score > -least_gain(none):
                break
            stage = _stage(progress, begin + share * k, begin + share * (k + 1), "further causes, and others")
            if len(best.names) < POLICY.max_causes:
                alike = sorted((h for h in models if len(h.names) == len(best.names)), key=lambda h: h.score)
                to_reach = min(score for _, score in _to_reach(_best_by_count(models), len(best.names) + 1))
                models += self._further(none, alike, to_reach, _names(models), stage)
                models = scored(none, models)
            leading = sorted((h for h in models if h.change is None), key=lambda h: h.score)
            without_one = self.pruned(leading, _names(models))
            without_one = scored(none, _with_own_errors(without_one))
            models += without_one
            models += self._further(none, without_one, models[0].score, _names(models), stage)
            models = scored(none, models)
            models = scored(none, [told_by_fewer(h, models) for h in models])
            if {*models[0].names} == {*best.names}:
                break
        return models

    def _further(
        self,
        none: Hypothesis,
        starts: Sequence[Hypothesis],
        score: float,
        fitted: Collection[frozenset[str]],
        progress: Progress,
    ) -> list[Hypothesis]:
        """Hypotheses with one effect more on top of each of several, each with its own error.

        starts : with their own errors, best first. What may not be named for what it leaves may be named with a further
                 cause, and an error of its form would take up a part of what that explains
        score  : to be reached
        fitted : names of effects that are fitted together already
        """
        starts = _distinct([h for h in starts if h.change is None][: EFFORT.causes])
        if not starts:
            return []
        stacks = [[*h.trials[:-1], h.last.exact_forms or h.last] for h in starts]
        least = 0.5 * (min(h.score for h in starts) - score) - POLICY.gain_margin
        return _with_own_errors(scored(none, self.with_one_more(stacks, progress, least, fitted))[: EFFORT.rivals])

    def with_one_more(
        self,
        stacks: Sequence[Sequence[TrialFit]],
        progress: Progress,
        least: float = 0.0,
        fitted: Collection[frozenset[str]] = frozenset(),
    ) -> list[Hypothesis]:
        """Hypotheses with one effect more on top of each of several stacks of effects, a round of each side by side.

        stacks : effects, each fitted on top of those before
        least  : gain in log likelihood over the best stack that an effect has to promise
        fitted : names of effects that are fitted together already, and not once more
        """
        hypotheses, rounds = [], _rounds_on_top(stacks, progress, least, fitted)
        progress(0.7, "fitting the leading ones to convergence")
        leading = sorted(
            ((t.fit.log_likelihood, i, t) for i, r in enumerate(rounds) for t in r.trials), key=lambda x: -x[0]
        )
        for i, of_round in enumerate(rounds):
            trials = [t for _, j, t in leading[: EFFORT.causes] if j == i]
            refined = refine(of_round.base, trials, of_round.tried, of_round.predicted) if trials else []
            hypotheses += [self.stack([*stacks[i], t], of_round.forms) for t in _nameable_first(refined)]
        return hypotheses

    def fitted_on(self, hypotheses: Sequence[Hypothesis]) -> list[Hypothesis]:
        """Hypotheses that explain most of the excess, fitted on: with their own mesh correction, and, where none of
        these explains the record, with an effect in a free form."""
        fitted = self.recorrected(hypotheses)
        if not _explaining(fitted):
            free = self.free_forms([*hypotheses, *fitted])
            fitted += [*free, *self.recorrected(free)]
        return fitted

    def explaining_most(self, hypotheses: Sequence[Hypothesis]) -> list[Hypothesis]:
        """Hypotheses of effects that explain most of the excess of the declared model, the best first."""
        most = (1.0 - POLICY.min_explained_by_library) * self.none.excess_chi2
        explaining = [h for h in hypotheses if h.change is None and h.excess_chi2 < most]
        return sorted(explaining, key=lambda h: h.excess_chi2)

    def recorrected(self, hypotheses: Sequence[Hypothesis]) -> list[Hypothesis]:
        """The leading hypotheses that explain most of the excess, with the mesh correction at their own values."""
        most = 4  # hypotheses that get a mesh correction of their own
        leading: dict[frozenset[str], Hypothesis] = {}
        for h in self.explaining_most(hypotheses):
            if not h.adequate:
                leading.setdefault(frozenset(h.names), h)
        chosen = list(leading.values())[:most]
        return [self.stack([*h.trials[:-1], recorrected(h.last, self.record)]) for h in chosen]

    def free_forms(self, hypotheses: Sequence[Hypothesis]) -> list[Hypothesis]:
        """Hypotheses with one effect in a free form (free_forms.py), for those that explain most of the excess."""
        entries = self._freed(self.explaining_most(hypotheses)[: EFFORT.causes])
        bases, starts = [stack[-1] for stack, _, _ in entries], [start for *_, start in entries]
        fitted = fit_converged(bases, [c for _, c, _ in entries], starts)
        return [
            self.stack([*stack[1:], trial_fit.with_held_out(stack[-1], t)])
            for (stack, _, _), t in zip(entries, fitted, strict=True)
            if np.isfinite(t.fit.log_likelihood)
        ]

    def _freed(
        self, hypotheses: Sequence[Hypothesis]
    ) -> Collection[tuple[list[TrialFit], Candidate, dict[str, float]]]:
        """Models without one of their effects, the free form of that effect, and values to start from, each once."""
        tried: dict[tuple[str, ...], tuple[list[TrialFit], Candidate, dict[str, float]]] = {}
        for h, freed in [(model, effect) for model in hypotheses for effect in model.trials]:
            values, others = trial_fit.fitted_values(h.last), [t for t in h.trials if t is not freed]
            key = (freed.name, *sorted(t.name for t in others))
            candidate = None if key in tried else free_form(self.first.base, freed, values)
            if candidate is not None:
                stack = [self.first.base, *self.fitted_stack(others, values)]
                if np.isfinite(stack[-1].fit.log_likelihood):
                    tried[key] = stack, candidate, {**values, **candidate.start}
        return tried.values()

    def fitted_stack(self, effects: Sequence[TrialFit], values: Mapping[str, float]) -> list[TrialFit]:
        """Effects one on top of the other on the declared model, each fitted from the values given."""
        stack = [self.first.base]
        for trial in effects:
            below, candidate = stack[-1], trial.candidate
            start = {**trial_fit.fitted_values(below), **{n: values[n] for n in candidate.names}}
            (fitted,) = fit_converged([below], [candidate], [start])
            delta = delta_bic(self.first.base, fitted.fit, candidate, 1.0)
            stack.append(replace(trial_fit.with_held_out(below, fitted), delta_bic=delta))
        return stack[1:]

    def pruned(self, rated: Sequence[Hypothesis], fitted: Collection[frozenset[str]] = frozenset()) -> list[Hypothesis]:
        """The best hypothesis without each of its effects in turn, where it has several.

        fitted : as `with_one_more` has it
        """
        if not rated or len(rated[0].trials) < 2 or rated[0].change is not None:
            return []
        trials, values = rated[0].trials, trial_fit.fitted_values(rated[0].last)
        fewer = [[t for t in trials if t is not left_out] for left_out in trials]
        stacks = [self.fitted_stack(kept, values) for kept in fewer if frozenset(t.name for t in kept) not in fitted]
        return [self.stack(stack) for stack in stacks if np.isfinite(stack[-1].fit.log_likelihood)]

    def exchanged(self, hypotheses: Sequence[Hypothesis], progress: Progress) -> list[Hypothesis]:
        """Hypotheses in which other effects stand in place of members of the leading one.

        Effects are sought one after another: a form with many parameters may have taken up what another effect explains
        with one. So each effect of the leading model is left out, and all are put in their simplest forms, before
        another one is sought, as long as that finds a better model.
        """
        exchanged: list[Hypothesis] = []
        rated = _accepted(self.none, hypotheses)
        for k in range(EFFORT.rivals):
            if not rated or len(rated[0].names) < 2 or rated[0].change is not None:
                break
            best, values = rated[0], trial_fit.fitted_values(rated[0].last)
            stacks = [self.fitted_stack(effects, values) for effects in self._reduced(best)]
            stacks = [s for s in stacks if all(np.isfinite(t.fit.log_likelihood) for t in s)]
            exchanged += self.with_one_more(stacks, _stage(progress, k / EFFORT.rivals, (k + 1) / EFFORT.rivals))
            rated = _accepted(self.none, [*hypotheses, *exchanged])
            if set(rated[0].names) == set(best.names):
                break
        return exchanged

    def _reduced(self, best: Hypothesis) -> list[list[TrialFit]]:
        """Effects of a hypothesis without each in turn, and where a further one is possible all in their simplest
        forms, to be fitted."""
        reduced = [[t for t in best.trials if t is not left_out] for left_out in best.trials]
        if len(best.trials) < POLICY.max_causes:
            reduced.append([_in_simplest_form(t, self.first.tried) for t in best.trials])
        return reduced

    def on_the_best_change(self, rated: Sequence[Hypothesis], progress: Progress) -> list[Hypothesis]:
        """Hypotheses with one effect, or one derivative of the table, besides the best change of the record.

        None where no change that may be named explains half of the excess: what explains less is no cause of its own.
        Those that do not explain the record either are left out: with a free effect more, any change comes near many
        residuals. None besides two broken thermocouples: what is left of the readings follows many effects.
        """
        excess = self.none.excess_chi2
        best = next((h for h in rated if h.change is not None and h.admissible and len(h.names) == 1), None)
        if best is None or best.change is None or len(best.change.broken) > 1:
            return []
        if excess - best.excess_chi2 < POLICY.min_explained * excess:
            return []
        of_round = search_round(best.last, best.effects, progress)
        refined = _nameable_first(_refined(of_round, progress))
        return [h for t in refined if (h := with_one_more(best, t, of_round.forms)).adequate]


def _names(models: Sequence[Hypothesis]) -> set[frozenset[str]]:
    """What each of several models names."""
    return {frozenset(h.names) for h in models}


def _nameable_first(trials: Sequence[TrialFit]) -> list[TrialFit]:
    """The trials of a round that are kept, those that may be named first."""
    return sorted(trials, key=lambda t: (not t.admissible, t.delta_bic))[: EFFORT.starts]


def _rounds_on_top(
    stacks: Sequence[Sequence[TrialFit]], progress: Progress, least: float, fitted: Collection[frozenset[str]]
) -> list[SearchRound]:
    """By stack of effects, the pass over all candidates on top of it; of all passes together the best are fitted.

    least, fitted : as `_Search.with_one_more` has them
    """
    progress(0.0, "screening candidates")
    bases = [stack[-1] for stack in stacks]
    screened = [_screened(stack, fitted) for stack in stacks]
    reached = [b.fit.log_likelihood for b in bases]
    chosen = _promising(screened, reached, least)
    progress(0.3, f"fitting {len(chosen)} of {sum(len(tried) for tried, _ in screened)} candidates")
    tried = [screened[i][0][k] for _, i, k in chosen]
    fits = fit_in_stages([bases[i] for _, i, _ in chosen], tried, [total for total, _, _ in chosen], max(reached))
    return [
        _round_of(base, [t for t, (_, j, _) in zip(fits, chosen, strict=True) if j == i], *screened[i])
        for i, base in enumerate(bases)
    ]


def _promising(
    screened: Sequence[tuple[Sequence[Candidate], Sequence[float]]], log_likelihoods: Sequence[float], least: float
) -> list[tuple[float, int, int]]:
    """Candidates on top of stacks that are fitted, one start of a form: what each promises over the best stack, its
    stack, and its number there.

    screened : by stack, as `_screened` gives it;  log_likelihoods : by stack
    least    : what a candidate has to promise in any case
    """
    # of the most that a further effect promises, on top of any first one: the share that another has to promise to be
    # fitted, and how many are
    pair_share, most_pairs = 0.3, 24
    best = max(log_likelihoods)
    reached = [
        (log_likelihoods[i] + gain - best, i, k)
        for i, (_, gains) in enumerate(screened)
        for k, gain in enumerate(gains)
    ]
    least = max(least, pair_share * max((r for r, _, _ in reached), default=0.0))
    chosen: dict[tuple[int, Form], tuple[float, int, int]] = {}
    for total, i, k in sorted(reached, reverse=True):
        if total < least or len(chosen) == most_pairs:
            break
        chosen.setdefault((i, screened[i][0][k].form), (total, i, k))
    return list(chosen.values())


def _screened(stack: Sequence[TrialFit], fitted: Collection[frozenset[str]]) -> tuple[list[Candidate], list[float]]:
    """Candidates on top of a stack of effects, and the gain in log likelihood that each predicts.

    fitted : names of effects that are fitted together already
    """
    names = [t.name for t in stack]
    tried = [c for c in _candidates(stack[-1], names) if frozenset({*names, c.name}) not in fitted]
    return tried, predicted_gains(stack[-1], tried)


def _accepted(none: Hypothesis, hypotheses: Sequence[Hypothesis]) -> list[Hypothesis]:
    """Hypotheses best first, without those whose further effects explain too little.

    A further effect gains `Policy.min_gain_of_further` over every model with fewer effects that may be named. It
    explains a good part of what these leave, or takes the place of parameters of theirs, and predicts what is held out
    no worse.
    """
    hypotheses = scored(none, hypotheses)
    singles = [h for h in hypotheses if len(h.names) == 1]
    kept = list(singles)
    for count in range(2, POLICY.max_causes + 1):
        # What fewer effects explain, whether they may be named or not: an inadmissible one still shows how little more
        # a further effect adds.
        simpler = min(kept, key=lambda h: h.excess_chi2, default=none)
        first_explains = none.excess_chi2 - min(singles, key=lambda h: h.excess_chi2, default=none).excess_chi2
        to_beat, of_nameable = _score_to_beat(kept), _score_to_beat([h for h in kept if h.admissible])
        kept += [
            h for h in hypotheses
            if len(h.names) == count and h.score <= of_nameable and _explains_more(h, simpler, first_explains, to_beat)
        ]  # fmt: skip
    return scored(none, _distinct(kept))


def _score_to_beat(simpler: Sequence[Hypothesis]) -> float:
    """The score that a hypothesis with a further effect has to reach over these."""
    return min((h.score for h in simpler), default=0.0) - POLICY.min_gain_of_further


def _explains_more(h: Hypothesis, simpler: Hypothesis, first_explains: float, to_beat: float) -> bool:
    """Whether a further effect explains a good part of the excess, or replaces parameters, and predicts no worse.

    simpler : has the least excess chi-square with fewer effects;  first_explains : excess chi-square that the best
    single one explains;  to_beat : score of a hypothesis whose further effect takes the place of parameters
    """
    if not h.last.held_out_log_likelihood >= simpler.last.held_out_log_likelihood:
        return False
    gained = simpler.excess_chi2 - h.excess_chi2
    is_much = gained >= POLICY.min_explained_over_first * first_explains
    if gained >= POLICY.min_explained * simpler.excess_chi2 and (is_much or h.adequate):
        return True
    return h.score <= to_beat and h.adequate


def _distinct(hypotheses: Sequence[Hypothesis]) -> list[Hypothesis]:
    """The likeliest of those that have the same effects with the same free parameters."""
    best: dict[tuple[frozenset[str], frozenset[str]], Hypothesis] = {}
    for h in sorted(hypotheses, key=lambda h: (not h.admissible, -h.last.fit.log_likelihood)):
        best.setdefault((frozenset(h.names), frozenset(n for t in h.trials for n in t.candidate.names)), h)
    return list(best.values())


def _in_simplest_form(trial: TrialFit, tried: Sequence[Candidate]) -> TrialFit:
    """The trial of an effect with the fewest free parameters of those that it has, to be fitted."""
    forms = [c for c in tried if c.name == trial.name and c.form.is_special_case_of(trial.candidate.form)]
    return replace(trial, candidate=min([trial.candidate, *forms], key=lambda c: len(c.names)))


def _first_picks(hypotheses: Sequence[Hypothesis]) -> list[list[TrialFit]]:
    """The single effects that a further one is sought on top of, the likeliest of each form."""
    best: dict[tuple[str, ...], TrialFit] = {}
    for trial in sorted((h.last for h in hypotheses if h.change is None), key=lambda t: -t.fit.log_likelihood):
        best.setdefault(trial.candidate.names, trial)
    return [[trial] for trial in list(best.values())[: EFFORT.causes]]


def search_round(base: TrialFit, excluded: Sequence[str], progress: Progress) -> SearchRound:
    """Screen all candidates on top of the declared model, fit the promising ones, keep the best of each effect.

    excluded : names of the effects that are no candidates; where there are any, nor are errors of the table
    """
    progress(0.0, "screening candidates")
    tried = [*_candidates(base, excluded), *(table_candidates(base) if not excluded else [])]
    gains = predicted_gains(base, tried)
    by_history = history_starts(base, tried)
    gains += gains_from(base, by_history)
    tried += by_history
    # predictions are linear; beside an error gains are small, and one that deceives would leave no other
    selected = sorted(
        select_candidates(tried, gains, trial_fit.sample_count(base.problem), every_effect=base.has_error)
    )
    progress(0.3, f"fitting {len(selected)} of {len(tried)} candidates")
    chosen = [tried[i] for i in selected]
    fitted = fit_in_stages(
        [base] * len(chosen), chosen, [gains[i] for i in selected], base.fit.log_likelihood, by_effect=True
    )
    return _round_of(base, fitted, tried, gains)


def _round_of(
    base: TrialFit, fitted: Sequence[TrialFit], tried: Sequence[Candidate], gains: Sequence[float]
) -> SearchRound:
    """A round with the best trial of each effect.

    fitted : trials on top of the base;  tried, gains : all candidates, with their predicted gains
    """
    best: dict[str, TrialFit] = {}
    for t in fitted:
        if np.isfinite(t.fit.log_likelihood) and (t.name not in best or t.delta_bic < best[t.name].delta_bic):
            best[t.name] = t
    trials = [trial_fit.with_held_out(base, t) for t in best.values()]
    screened_out: dict[str, float] = {}
    for candidate, gain in zip(tried, gains, strict=True):
        if candidate.name not in best:
            predicted = -2.0 * gain + len(candidate.names) * float(np.log(trial_fit.sample_count(base.problem)))
            screened_out[candidate.name] = min(predicted, screened_out.get(candidate.name, np.inf))
    forms = count_forms(tried)
    return SearchRound(base, scored_trials(base, trials, forms), screened_out, tuple(tried), tuple(gains), forms)
