"""The calibration of findings that the package states: complete, and probabilities that follow the evidence."""

from __future__ import annotations

import numpy as np
import pytest

from sim_heating.closure.verdict.adequacy import p_value
from sim_heating.closure.verdict.calibration import (
    FEATURES,
    STATED,
    calibration,
    false_alarm_statement,
    features,
    probability,
    true_statistics,
)
from sim_heating.closure.verdict.policy import POLICY


def test_the_shipped_calibration_is_of_these_features_and_of_enough_records():
    known = calibration()
    assert tuple(known["features"]) == FEATURES
    assert len(known["coefficients"]) == len(FEATURES)
    assert len(true_statistics()) >= 60
    assert f"of {known['records']} synthetic records" in false_alarm_statement()


@pytest.mark.parametrize("finding", STATED)
def test_a_finding_that_states_something_has_a_probability_and_one_that_does_not_has_none(finding):
    stated = probability(finding, features(finding, rival=100.0, p_value=0.5, explained=1.0, effects=1))
    assert stated is not None
    assert 0.0 < stated < 1.0
    for undecided in ("partly", "unknown"):
        of_it = features(undecided, rival=100.0, p_value=0.5, explained=1.0, effects=1)
        assert probability(undecided, of_it) is None


def test_a_nearer_rival_and_a_worse_fit_do_not_make_a_finding_more_probable():
    def found(rival: float, p: float) -> float:
        return probability("found", features("found", rival, p, explained=1.0, effects=1)) or 0.0

    assert found(6.0, 0.5) <= found(1000.0, 0.5)
    assert found(100.0, 0.02) <= found(100.0, 0.5)


def test_features_are_bounded_whatever_the_evidence():
    extreme = features("found", np.inf, 0.0, -3.0, 0, disqualified=np.inf)
    assert np.all(np.isfinite(extreme))


def test_the_p_value_of_the_middle_of_true_models_is_a_half_and_falls_beyond_all_of_them():
    known = true_statistics()
    assert p_value(float(np.median(known))) == pytest.approx(0.5, abs=0.02)
    assert p_value(1.5 * float(known[-1])) < 1.0 / len(known)
    share_called_inadequate = np.mean([p_value(float(s)) < POLICY.adequate_p for s in known])
    assert share_called_inadequate <= 2.0 * POLICY.adequate_p
