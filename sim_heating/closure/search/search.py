"""Search for the effects that the declared model of a record lacks.

The declared model's magnitude and derivatives are fitted first. Then every candidate is screened (screening.py), the
promising ones are fitted together with these (trial_fit.py), and all are ranked (ranking.py). The best is added where
its score is below that of none by more than MIN_BIC_GAIN and it explains a good part of the excess chi-square. This is
repeated until no candidate is added. Where a further effect was added, each earlier one is reconsidered with it in the
model.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from sim_heating.base.progress import Progress, no_progress
from sim_heating.closure.search.candidates import candidates
from sim_heating.closure.search.ranking import SearchRound, count_forms, delta_bic, model_bic, score_round
from sim_heating.closure.search.screening import fit_in_stages, predicted_gains, select_candidates
from sim_heating.closure.search.trial_fit import (
    QUICK,
    TrialFit,
    base_trial,
    declared_fit,
    fitted_values,
    held_out_problem_with,
    problem_with,
    sample_count,
    start_values,
)
from sim_heating.estimation.fit import FitResult
from sim_heating.estimation.side_by_side import maximise_together
from sim_heating.inputs.points import conditions_of_record
from sim_heating.inputs.record import Record

MIN_BIC_GAIN = 10.0
"""How much lower the score of an effect has to be than that of none."""
MIN_SHARE, MIN_FIRST_SHARE = 0.5, 0.3
"""Part of the excess chi-square that an effect has to explain; the first of several may leave more to the others."""
MIN_OVER_FIRST = 0.1
"""Least chi-square that a further effect explains, over that of the first: a first one of another form leaves less."""
MIN_EXPLAINED = 0.8
"""Part of the excess that all effects together have to explain to be named: any form fits anything a little."""
MAX_LAG1 = 0.5
"""Lag-1 autocorrelation above which something is missing although no candidate explains it; the coloured noise of a
recorder has a fifth of its variance in common between neighbours."""
MAX_EFFECTS = 3


@dataclass(frozen=True, eq=False, repr=False)
class SearchResult:
    """The result of the search for missing effects in one record.

    before  : the declared model's fit, its magnitude and derivatives
    rounds  : passes over the candidates
    added   : trial fits whose effects were added, in order
    unknown : whether a significant residual remains that no candidate explains
    """

    record: Record
    before: FitResult
    rounds: tuple[SearchRound, ...]
    added: tuple[TrialFit, ...]
    unknown: bool

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the added effects; else `unknown` or `none`."""
        return tuple(t.name for t in self.added) or (("unknown",) if self.unknown else ("none",))

    def __repr__(self) -> str:
        return f"<SearchResult of {self.record.name}: {' + '.join(self.names)}, {len(self.rounds)} round(s)>"


def search_effects(record: Record, *, progress: Progress = no_progress) -> SearchResult:
    """Search for the effects that the declared model of a record lacks.

    raises : InputError, RunError where not even the declared model can be fitted
    """
    progress(0.02, "declared model")
    before = declared_fit(record)
    base = base_trial(before)
    rounds: list[SearchRound] = []
    added: list[TrialFit] = []
    while len(added) < MAX_EFFECTS:
        begin = 0.1 + 0.9 * len(added) / MAX_EFFECTS

        def report(fraction: float, text: str, begin: float = begin, number: int = len(added) + 1) -> None:
            progress(begin + 0.9 * fraction / MAX_EFFECTS, f"effect {number}: {text}")

        rounds.append(search_round(added[-1] if added else base, [t.name for t in added], report))
        best = _worth_adding(rounds, added)
        if best is None:
            break
        # With two effects in a record the best single one may be a third that resembles both.
        added = _reconsider(base, [*added, best], report)
        if added[-1].excess_chi2 < MIN_OVER_FIRST * _explained_by_first(rounds, added):
            break  # a further effect would have to explain more than remains
    return SearchResult(record, before, tuple(rounds), *_conclusion(rounds, added))


def _worth_adding(rounds: Sequence[SearchRound], added: Sequence[TrialFit]) -> TrialFit | None:
    """The best trial of the last round where it explains enough to be added."""
    last = rounds[-1]
    best = last.trials[0] if last.trials else None
    if best is None or best.score > -MIN_BIC_GAIN:
        return None
    if added:
        # More than for the first: an effect whose form in nature differs from that of the library leaves some per cent,
        # which is not a second effect.
        least = max(MIN_SHARE * last.excess_chi2, MIN_OVER_FIRST * _explained_by_first(rounds, added))
    else:
        least = MIN_FIRST_SHARE * last.excess_chi2
    return best if last.excess_chi2 - best.excess_chi2 >= least else None


def _explained_by_first(rounds: Sequence[SearchRound], added: Sequence[TrialFit]) -> float:
    """Part of the excess chi-square that the first effect explained."""
    return rounds[0].excess_chi2 - added[0].excess_chi2


def _reconsider(base: TrialFit, added: list[TrialFit], progress: Progress) -> list[TrialFit]:
    """The effects, one of the earlier ones replaced where another is better now that the last is in the model.

    Where two effects act, the first one found may be a third that resembles both together.
    """
    for earlier in added[:-1]:
        others = [t for t in added if t is not earlier]
        without = _stack_effects(base, others, fitted_values(added[-1]))
        trials = search_round(without[-1], [t.name for t in others], progress).trials
        best = next(iter(trials), None)
        if best is None or best.name == earlier.name:
            continue
        if model_bic(best, best) < model_bic(added[-1], best) - MIN_BIC_GAIN:
            return [*without, best]
    return added


def _stack_effects(base: TrialFit, effects: Sequence[TrialFit], values: Mapping[str, float]) -> list[TrialFit]:
    """Effects one on top of the other on the base, each fitted from the values given."""
    stack = [base]
    for trial in effects:
        below, own = stack[-1], {n: values[n] for n in trial.candidate.names}
        problem, held_out = problem_with(below, trial.candidate), held_out_problem_with(below, trial.candidate)
        fit = maximise_together([problem], [start_values(problem, {**fitted_values(below), **own})], QUICK)[0]
        stack.append(replace(trial, problem=problem, held_out=held_out, fit=fit))
    return stack[1:]


def _conclusion(rounds: Sequence[SearchRound], added: Sequence[TrialFit]) -> tuple[tuple[TrialFit, ...], bool]:
    """The trials whose effects are named, and whether the residual is unknown: significant, and not explained."""
    first = rounds[0]
    explicable = bool(first.trials) and first.trials[0].score <= -MIN_BIC_GAIN
    # A residual correlated from sample to sample is not noise even where no candidate explains it. Of 210 records
    # without an effect none exceeds 0.22.
    significant = explicable or first.base.lag1_autocorrelation > MAX_LAG1
    remaining = added[-1].excess_chi2 if added else first.excess_chi2
    if added and first.excess_chi2 - remaining >= MIN_EXPLAINED * first.excess_chi2:
        return tuple(added), False
    return (), significant


def search_round(base: TrialFit, taken: Sequence[str], progress: Progress) -> SearchRound:
    """Screen every candidate on top of a model, fit the promising ones, keep the best trial of each effect.

    taken : names of the effects that are no candidates
    """
    progress(0.0, "screening candidates")
    record = base.problem.record_fits[0].record
    flown = conditions_of_record(record)
    tried = candidates(record, flown.at(flown.time_s[record.fit_mask(flown.time_s)]), taken)
    gains = predicted_gains(base, tried)
    selected = sorted(select_candidates(tried, gains, sample_count(base.problem)))
    problems, start = [problem_with(base, tried[i]) for i in selected], fitted_values(base)
    firsts = [start_values(p, {**start, **tried[i].start}) for p, i in zip(problems, selected, strict=True)]
    progress(0.3, f"fitting {len(selected)} of {len(tried)} candidates")
    fits = fit_in_stages(problems, firsts, base.fit.log_likelihood, [gains[i] for i in selected])
    best: dict[str, TrialFit] = {}
    for i, problem, fit in zip(selected, problems, fits, strict=True):
        name, delta = tried[i].name, delta_bic(base, fit, tried[i], 1.0)
        if np.isfinite(fit.log_likelihood) and (name not in best or delta < best[name].delta_bic):
            best[name] = TrialFit(name, tried[i], problem, None, fit, delta)
    trials = [replace(t, held_out=held_out_problem_with(base, t.candidate)) for t in best.values()]
    screened_out: dict[str, float] = {}
    for candidate, gain in zip(tried, gains, strict=True):
        if candidate.name not in best:
            predicted = -2.0 * gain + len(candidate.names) * float(np.log(sample_count(base.problem)))
            screened_out[candidate.name] = min(predicted, screened_out.get(candidate.name, np.inf))
    return score_round(base, trials, screened_out, count_forms(tried))
