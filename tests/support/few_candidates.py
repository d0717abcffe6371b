"""The search of a record for a missing effect, among a few effects alone: what a search leads to, in a moment."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

import pytest

from sim_heating.closure.search import search
from sim_heating.closure.search.changes.record_change import fit_changes
from sim_heating.closure.search.hypothesis import conclude, hypothesis, scored
from sim_heating.closure.search.ranking import SearchRound, count_forms, scored_trials
from sim_heating.closure.search.search import SearchResult
from sim_heating.closure.search.trials.candidates import Candidate, candidates
from sim_heating.closure.search.trials.change import RecordChange
from sim_heating.closure.search.trials.screening import predicted_gains
from sim_heating.closure.search.trials.trial_fit import (
    CONVERGE,
    TrialFit,
    base_trial,
    declared_fit,
    delta_bic,
    fitted_values,
    held_out_problem_with,
    problem_with,
    start_values,
)
from sim_heating.estimation.side_by_side import maximise_together
from sim_heating.inputs.points import conditions_of_record
from sim_heating.inputs.record import Record
from sim_heating.live.watch import missing


def search_among(monkeypatch: pytest.MonkeyPatch, *names: str) -> None:
    """Let the search itself try effects of these names alone, and of the changes of the record those without ends in
    time, altitude or temperature, which are many; `python -m benchmarks closure` searches among all.
    """

    def few(*given: Any, **options: Any) -> list[Candidate]:
        return [c for c in candidates(*given, **options) if c.name in names]

    def without_ends(base: TrialFit, changes: Sequence[RecordChange], *given: Any, **options: Any) -> list[TrialFit]:
        return fit_changes(base, [c for c in changes if c.near is None], *given, **options)

    monkeypatch.setattr(search, "candidates", few)
    monkeypatch.setattr(search, "fit_changes", without_ends)


def weighing_among(monkeypatch: pytest.MonkeyPatch, *names: str) -> None:
    """Let the process that weighs candidates for a link try effects of these names alone."""
    monkeypatch.setattr(missing, "weigh", partial(_weigh_among, names))


def _weigh_among(names: Sequence[str], *given: Any) -> missing.Weighed:
    """What the other process does: it is spawned, and has nothing of what this one has set."""
    with pytest.MonkeyPatch.context() as here:
        search_among(here, *names)
        return _weigh(*given)


_weigh = missing.weigh


def searched_among(record: Record, names: Sequence[str]) -> SearchResult:
    """The search of one record among effects of these names, the best start of each fitted to convergence."""
    before = declared_fit(record)
    base = base_trial(before)
    on_samples = conditions_of_record(record)
    tried = [c for c in candidates(record, on_samples) if c.name in names]
    gains = predicted_gains(base, tried)
    best = [max((k for k, c in enumerate(tried) if c.name == n), key=lambda k: gains[k]) for n in names]
    problems = [problem_with(base, tried[k]) for k in best]
    starts = [start_values(p, {**fitted_values(base), **tried[k].start}) for p, k in zip(problems, best, strict=True)]
    trials = [
        TrialFit(
            tried[k].name, tried[k], p, held_out_problem_with(base, tried[k]), f, delta_bic(base, f, tried[k], 1.0)
        )
        for k, p, f in zip(best, problems, maximise_together(problems, starts, CONVERGE), strict=True)
    ]
    forms = count_forms(tried)
    first = SearchRound(base, scored_trials(base, trials, forms), {}, forms=forms)
    none = hypothesis([base], {})
    found = scored(none, [hypothesis([t], forms) for t in trials])
    return SearchResult(record, before, first, none, tuple(found), conclude(none, found))
