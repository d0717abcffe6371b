"""The leading candidates fitted to convergence: fits that fall far behind end early, and nothing else changes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from sim_heating.closure.search import refine as refining
from sim_heating.closure.search.ranking import SearchRound
from sim_heating.closure.search.refine import refine
from sim_heating.closure.search.search import search_round
from sim_heating.closure.search.trials.trial_fit import (
    CONVERGE,
    TrialFit,
    base_trial,
    declared_fit,
    delta_bic,
    needed_log_likelihood,
    sample_count,
)
from sim_heating.estimation.inference.newton import Fit, Status
from sim_heating.heating.effects import effects
from sim_heating.inputs.record import load_record
from tests.support.paths import PRACTICE

pytestmark = pytest.mark.thorough

NAME = "impingement-onset"


@pytest.fixture(scope="module")
def first_round() -> SearchRound:
    """p08 searched for its effect alone, which has a simple form that explains it and a richer one with far starts."""
    base = base_trial(declared_fit(load_record(PRACTICE / "p08")))
    return search_round(base, sorted(set(effects()) - {NAME}), lambda fraction, text: None)


class Fits:
    """The fits of `refine`, as they are made."""

    def __init__(self, patch: pytest.MonkeyPatch) -> None:
        self.made: list[Fit] = []
        self._maximise = refining.maximise_together
        patch.setattr(refining, "maximise_together", self)

    def __call__(self, *given: Any) -> list[Fit]:
        found = self._maximise(*given)
        self.made += found
        return found


def refined(found: SearchRound) -> list[TrialFit]:
    return refine(found.base, found.trials, found.tried, found.predicted)


def same(a: Sequence[TrialFit], b: Sequence[TrialFit]) -> bool:
    """Whether contenders are the same to the last bit."""
    return [k.name for k in a] == [k.name for k in b] and all(
        np.array_equal(x.fit.values, y.fit.values) and x.delta_bic == y.delta_bic and x.objections == y.objections
        for x, y in zip(a, b, strict=True)
    )


def test_a_form_far_behind_one_that_may_be_named_ends_early_and_the_contenders_are_the_same(
    first_round: SearchRound, monkeypatch: pytest.MonkeyPatch
) -> None:
    fits = Fits(monkeypatch)
    found = refined(first_round)
    behind = [fit for fit in fits.made if fit.status is Status.BEHIND]
    assert found[0].admissible
    assert behind
    assert all(fit.log_likelihood < found[0].fit.log_likelihood - 50.0 for fit in behind)

    monkeypatch.setattr(refining, "_settings", lambda *given: CONVERGE)
    early, fits.made = fits.made, []
    assert same(refined(first_round), found)
    to_the_end = {fit.history[0].tobytes(): fit for fit in fits.made}
    for fit in behind:
        whole = to_the_end[fit.history[0].tobytes()]
        assert whole.iterations > fit.iterations
        assert np.array_equal(whole.history[: fit.iterations + 1], fit.history)
        assert whole.log_likelihood < found[0].fit.log_likelihood - 50.0
    assert len(early) == len(to_the_end)


def test_where_no_form_may_be_named_in_the_end_those_that_fell_behind_are_fitted_on(
    first_round: SearchRound, monkeypatch: pytest.MonkeyPatch
) -> None:
    (led,) = first_round.trials
    monkeypatch.setattr(refining, "objections", lambda trial: () if trial is led else ("no vehicle has it",))
    fits = Fits(monkeypatch)
    refined(first_round)
    behind = [fit for fit in fits.made if fit.status is Status.BEHIND]
    assert behind
    for fit in behind:
        (further,) = [f for f in fits.made if np.array_equal(f.history[0], fit.values)]
        assert further.status is not Status.BEHIND
        assert further.log_posterior >= fit.log_posterior


def test_a_form_that_cannot_be_marched_where_it_starts_is_left_out(first_round: SearchRound) -> None:
    (led,) = first_round.trials
    unknown = {f"effect.{NAME}.slope": np.nan}
    tried = [c if c is led.candidate else replace(c, start={**c.start, **unknown}) for c in first_round.tried]
    found = refine(first_round.base, first_round.trials, tried, first_round.predicted)
    assert [k.candidate for k in found] == [led.candidate]
    assert found[0].admissible


def test_the_likelihood_that_is_needed_is_that_at_which_two_forms_cost_the_same(first_round: SearchRound) -> None:
    base, (led,) = first_round.base, first_round.trials
    needed = needed_log_likelihood(base, led.candidate, led.delta_bic)
    assert needed <= led.fit.log_likelihood + 1e-9
    assert led.delta_bic == pytest.approx(delta_bic(base, led.fit, led.candidate, 1.0))
    richer = next(c for c in first_round.tried if len(c.names) > len(led.candidate.names))
    more = len(richer.names) - len(led.candidate.names)
    assert needed_log_likelihood(base, richer, led.delta_bic) - needed == pytest.approx(
        0.5 * more * np.log(sample_count(base.problem))
    )
