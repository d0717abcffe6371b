"""From a record that its declared model does not explain to the effect that does.

The declared model's magnitude and derivatives are fitted first. Then every candidate is fitted together with them
(stages.py) and weighed (weighing.py). The best is added where it is weighed below none by more than GAIN and it
explains a good part of what noise does not; that is repeated until nothing is. Where a further effect was added, each
earlier one is weighed anew beside it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from sim_heating.base.progress import Progress, quiet
from sim_heating.closure.search.candidates import candidates
from sim_heating.closure.search.ranking import SearchRound, count_forms, delta_bic, model_bic, score_round
from sim_heating.closure.search.screening import fit_in_stages, predicted_gains, select_candidates
from sim_heating.closure.search.trial_fit import (
    QUICK,
    TrialFit,
    base_trial,
    fitted_values,
    held_out_problem_with,
    problem_with,
    sample_count,
    start_values,
)
from sim_heating.estimation.fit import FitResult, estimate
from sim_heating.estimation.side_by_side import maximise_together
from sim_heating.inputs.points import conditions_of_record
from sim_heating.inputs.record import Record

MIN_BIC_GAIN = 10.0
"""How much lower the BIC of an effect has to be than that of none."""
SHARE, FIRST_SHARE = 0.5, 0.3
"""Part of what noise does not explain that an effect has to explain; the first of several may leave more to others."""
BESIDE = 0.1
"""What a further effect has to explain, over what the first one did: less is left by a first one whose form differs."""
EXPLAINED = 0.8
"""And what all effects together have to explain to be named at all: a form of our own fits anything a little."""
LASTING = 0.5
"""Mean product of neighbouring normalised residuals from which on something is missing though no candidate touches it;
a recorder's own coloured noise has a fifth of its variance in common between neighbours."""
MOST_EFFECTS = 3


@dataclass(frozen=True, eq=False)
class SearchResult:
    """What was found in one record.

    before  : the declared model's fit, its magnitude and derivatives;  rounds : the passes
    added   : the attempts whose effects were added, in order
    unknown : whether something significant is left that no candidate explains
    """

    record: Record
    before: FitResult
    rounds: tuple[SearchRound, ...]
    added: tuple[TrialFit, ...]
    unknown: bool

    @property
    def names(self) -> tuple[str, ...]:
        """What is named: the added effects; `unknown`; or `none`."""
        return tuple(a.name for a in self.added) or (("unknown",) if self.unknown else ("none",))


def search_effects(record: Record, *, progress: Progress = quiet) -> SearchResult:
    """Look for what the declared model of a record lacks.

    raises : InputError, RunError where not even the declared model can be fitted
    """
    progress(0.02, "declared model")
    before = estimate([record])
    base = base_trial(before)
    rounds: list[SearchRound] = []
    added: list[TrialFit] = []
    while len(added) < MOST_EFFECTS:
        begin = 0.1 + 0.9 * len(added) / MOST_EFFECTS

        def tell(fraction: float, text: str, begin: float = begin, number: int = len(added) + 1) -> None:
            progress(begin + 0.9 * fraction / MOST_EFFECTS, f"effect {number}: {text}")

        rounds.append(search_round(added[-1] if added else base, [a.name for a in added], tell))
        best = _worth_adding(rounds, added)
        if best is None:
            break
        added = _reconsidered(base, [*added, best], tell)
        if added[-1].excess < BESIDE * _by_first(rounds, added):
            break  # less is left than a further effect has to explain
    return SearchResult(record, before, tuple(rounds), *_judged(rounds, added))


def _worth_adding(rounds: Sequence[SearchRound], added: Sequence[TrialFit]) -> TrialFit | None:
    """The best attempt of the last round where it explains enough to be added."""
    found = rounds[-1]
    best = found.attempts[0] if found.attempts else None
    if best is None or best.weighed > -MIN_BIC_GAIN:
        return None
    least = max(SHARE * found.excess, BESIDE * _by_first(rounds, added)) if added else FIRST_SHARE * found.excess
    return best if found.excess - best.excess >= least else None


def _by_first(rounds: Sequence[SearchRound], added: Sequence[TrialFit]) -> float:
    """What the first effect explained of the excess."""
    return rounds[0].excess - added[0].excess


def _reconsidered(base: TrialFit, added: list[TrialFit], progress: Progress) -> list[TrialFit]:
    """The effects with each earlier one weighed anew beside the others: where two act, the first found may be one that
    comes near to both."""
    for earlier in added[:-1]:
        others = [a for a in added if a is not earlier]
        without = _stacked(base, others, fitted_values(added[-1]))
        found = search_round(without[-1], [a.name for a in others], progress)
        best = next(iter(found.attempts), None)
        if (
            best is not None
            and best.name != earlier.name
            and model_bic(best, best) < model_bic(added[-1], best) - MIN_BIC_GAIN
        ):
            return [*without, best]
    return added


def _stacked(base: TrialFit, effects: Sequence[TrialFit], values: Mapping[str, float]) -> list[TrialFit]:
    """Effects one on top of the other on the base, each fitted from the values given."""
    stack = [base]
    for one in effects:
        below, own = stack[-1], {n: values[n] for n in one.candidate.names}
        problem, held_out = problem_with(below, one.candidate), held_out_problem_with(below, one.candidate)
        fit = maximise_together([problem], [start_values(problem, {**fitted_values(below), **own})], QUICK)[0]
        stack.append(replace(one, problem=problem, held_out=held_out, fit=fit))
    return stack[1:]


def _judged(rounds: Sequence[SearchRound], added: Sequence[TrialFit]) -> tuple[tuple[TrialFit, ...], bool]:
    """What of the attempts stands, and whether what is left is unknown: they explain the residual, or nothing does."""
    first = rounds[0]
    touched = bool(first.attempts) and first.attempts[0].weighed <= -MIN_BIC_GAIN
    significant = touched or first.base.lasting > LASTING
    left = added[-1].excess if added else first.excess
    if added and first.excess - left >= EXPLAINED * first.excess:
        return tuple(added), False
    return (), significant


def search_round(base: TrialFit, taken: Sequence[str], progress: Progress) -> SearchRound:
    """Weigh every candidate on top of a model, fit the promising ones, keep the best attempt of each effect."""
    progress(0.0, "weighing candidates")
    record = base.problem.record_fits[0].record
    flown = conditions_of_record(record)
    tried = candidates(record, flown.at(flown.time_s[record.fit_mask(flown.time_s)]), taken)
    gains = predicted_gains(base, tried)
    chosen = sorted(select_candidates(tried, gains, sample_count(base.problem)))
    problems, start = [problem_with(base, tried[i]) for i in chosen], fitted_values(base)
    firsts = [start_values(p, {**start, **tried[i].start}) for p, i in zip(problems, chosen, strict=True)]
    progress(0.3, f"fitting {len(chosen)} of {len(tried)} candidates")
    fits = fit_in_stages(problems, firsts, base.fit.log_likelihood, [gains[i] for i in chosen])
    best: dict[str, TrialFit] = {}
    for i, problem, fit in zip(chosen, problems, fits, strict=True):
        name, delta = tried[i].name, delta_bic(base, fit, tried[i], 1.0)
        if np.isfinite(fit.log_likelihood) and (name not in best or delta < best[name].delta_bic):
            best[name] = TrialFit(name, tried[i], problem, None, fit, delta)
    attempts = [replace(a, held_out=held_out_problem_with(base, a.candidate)) for a in best.values()]
    passed: dict[str, float] = {}
    for one, gain in zip(tried, gains, strict=True):
        if one.name not in best:
            promised = -2.0 * gain + len(one.names) * float(np.log(sample_count(base.problem)))
            passed[one.name] = min(promised, passed.get(one.name, np.inf))
    return score_round(base, attempts, passed, count_forms(tried))
