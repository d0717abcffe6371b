"""What would tell the causes of a set apart, and the odds that it is expected to give."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from sim_heating.closure.search import tell_apart as module
from sim_heating.closure.search.hypothesis import Hypothesis, hypothesis
from sim_heating.closure.search.tell_apart import REPEATED, Experiment, tell_apart
from sim_heating.closure.search.trials.candidates import candidates
from sim_heating.closure.search.trials.trial_fit import (
    QUICK,
    TrialFit,
    base_trial,
    declared_fit,
    fitted_values,
    problem_with,
    start_values,
)
from sim_heating.estimation.side_by_side import maximise_together
from sim_heating.inputs.points import conditions_of_record
from sim_heating.inputs.record import load_record
from tests.support.paths import PRACTICE


@cache
def coated() -> tuple[Hypothesis, Hypothesis, Hypothesis]:
    """The declared model of a record with a thicker coating, with that and with another heat capacity of it."""
    record = load_record(PRACTICE / "p01")
    base, flown = base_trial(declared_fit(record)), conditions_of_record(record)
    tried = {c.names: c for c in candidates(record, flown)}
    found = [hypothesis([base], {})]
    for name in ("coating-thickness.coating_factor", "heat-capacity.coating_heat_capacity_factor"):
        candidate = tried[f"effect.{name}",]
        problem = problem_with(base, candidate)
        fit = maximise_together([problem], [start_values(problem, fitted_values(base))], QUICK)[0]
        found.append(hypothesis([TrialFit(candidate.name, candidate, problem, None, fit)], {}))
    none, best, rival = found
    return none, best, rival


@pytest.mark.thorough
def test_more_readings_and_a_deeper_thermocouple_tell_coating_from_heat_capacity_better() -> None:
    none, best, rival = coated()
    odds = {e.what: e.log_odds for e in tell_apart(none, best, [rival], most=99)}
    again = odds.pop(REPEATED)
    assert again > 0.0
    assert {"a thermocouple 4 mm below the coating", "recorder words of 12 bits", "readings every 0.2 s"} <= set(odds)
    assert all(v > again for v in odds.values())
    # five readings in place of one, next to a first flight that tells as much as one of these
    assert 2.0 * again < odds["readings every 0.2 s"] < 5.0 * again
    named = tell_apart(none, best, [rival])
    assert len(named) == 2
    assert named[0].log_odds == max(odds.values()) > named[1].log_odds


def test_a_cause_is_not_told_from_itself_and_one_alone_needs_nothing() -> None:
    none, best, _ = coated()
    assert tell_apart(none, best, []) == []
    same = tell_apart(none, best, [best])
    assert [e.what for e in same] == [REPEATED]
    assert same[0].log_odds == pytest.approx(0.0, abs=1e-6)


def test_expected_log_odds_are_those_of_a_fit_to_both_flights() -> None:
    """Linear models: by how much the best fit of the wrong one falls short, with what the first flight said of it."""
    rng, (_, best, _) = np.random.default_rng(1), coated()
    n, m = 40, 3
    J, d, sigma = rng.normal(size=(n, m)), rng.normal(size=n), 0.5
    first = rng.normal(size=(20, m))
    fit = replace(
        best.last.fit, information=first.T @ first, prior_information=np.zeros(m), on_bound=np.zeros(m, dtype=bool)
    )
    wrong = replace(best, trials=(replace(best.last, fit=fit),))
    weight = np.full(n, sigma**-2)
    truth, fitted = (module._Predicted(mean, J, weight) for mean in (d, np.zeros(n)))
    both = np.concatenate([J / sigma, first]), np.concatenate([d / sigma, np.zeros(20)])
    short = 0.5 * float(np.linalg.lstsq(*both)[1][0])
    assert module._expected(truth, fitted, wrong, 1.0) == pytest.approx(short, rel=1e-9)


def test_odds_are_given_in_words_and_not_beyond_what_they_mean() -> None:
    assert Experiment("a flap pulse", np.log(2.5)).in_words() == "a flap pulse: odds of 2.5 to 1"
    assert Experiment("a flap pulse", 400.0).in_words() == "a flap pulse: odds above 1000 to 1"
