"""What a residual goes with: the variable that made it, and no other where nothing did."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.stats import kstest

from sim_heating.closure.clues.axial_force import axial_steps
from sim_heating.closure.clues.correlation import SIGNIFICANCE_LEVEL, ResidualEvidence, residual_evidence
from sim_heating.closure.clues.residual_heating import ResidualHeating, residual_heating
from sim_heating.closure.clues.shapes import candidate_shapes, p_value, profiled_information, trials_factor
from sim_heating.estimation.problem import FitOptions, FitProblem, joint_reference
from sim_heating.heating.effects import EffectUse, use
from sim_heating.inputs.record import Record
from tests.support.missing import record_with

FITTED = ["ratio.scale", "ratio.d_alpha", "ratio.d_logre", "ratio.d_elevon", "ratio.d_bodyflap"]
ONSET_DEG = 41.0


def left_of(record: Record) -> ResidualHeating:
    """The residual heating of a record after one Newton step of its derivatives."""
    problem = FitProblem([record], FITTED, joint_reference([record]), FitOptions(prior_scale=np.inf))
    values = np.zeros(len(FITTED))
    for _ in range(3):
        found = problem.evaluate(values)
        values = values + np.linalg.solve(found.information, found.gradient)
    return residual_heating(problem, values)


@cache
def told(what: str) -> tuple[ResidualHeating, ResidualEvidence]:
    uses: dict[str, list[EffectUse]] = {
        "nothing": [],
        "onset": [use("impingement-onset", {"alpha_onset_deg": ONSET_DEG, "slope": 0.002})],
        "skew": [],
    }
    record, _ = record_with(uses[what], 5, skew_s=2.0 if what == "skew" else 0.0)
    left = left_of(record)
    return left, residual_evidence(left)


def test_heating_above_an_onset_angle_is_told_as_that():
    _, found = told("onset")
    best = found.followed[0]
    assert (best.shape.variable, best.shape.form) in {("alpha_deg", "above"), ("alpha_deg", "square")}
    assert abs(best.shape.lag_s) <= 2.0
    assert best.share > 0.7
    assert found.chance < 1e-6
    assert "alpha_deg" in found.proposal()[0]


def test_a_heating_of_the_table_makes_no_loops_and_a_clock_does():
    _, onset = told("onset")
    _, skew = told("skew")
    assert not any(loop.significant for loop in onset.loops)
    assert any(loop.significant and loop.variable == "alpha_deg" for loop in skew.loops)
    assert any("thermal model, a clock or a lag" in line for line in skew.proposal())
    assert skew.followed[0].shape.form == "rate"


def test_where_nothing_is_missing_nothing_is_proposed():
    _, found = told("nothing")
    assert found.chance > SIGNIFICANCE_LEVEL
    assert found.active == ()
    assert found.proposal() == ["Nothing is left that noise would not leave."]
    assert not any(loop.significant for loop in found.loops)
    assert all(c.chance_all > SIGNIFICANCE_LEVEL for c in found.correlations)


def test_spans_in_which_it_acts_are_those_in_which_the_angle_was_beyond_the_onset():
    left, found = told("onset")
    alpha = left.record.conditions.at(left.time_s)["alpha_deg"]
    for span in found.active[:2]:
        own = (left.time_s > span.start_s - 10.0) & (left.time_s < span.end_s + 10.0)
        assert np.max(alpha[own]) > ONSET_DEG - 1.0


def test_a_history_that_takes_more_than_all_heating_away_is_called_impossible():
    left, _ = told("onset")
    ratio = np.full(len(left.time_s), 0.05)
    sound = residual_evidence(left, ratio)
    assert sound.negative_s == 0.0
    taken = replace(left, input=replace(left.input, delta_ratio=np.where(left.fitted, -0.1, 0.0)))
    assert residual_evidence(taken, ratio).negative_s > 500.0


def test_chance_of_the_best_of_many_shapes_is_uniform_on_noise():
    left, _ = told("nothing")
    weights = profiled_information(left)
    _, columns = candidate_shapes(left.time_s, {"alpha_deg": left.record.conditions.at(left.time_s)["alpha_deg"]})
    several = trials_factor(weights, columns, seed=1)
    values, vectors = np.linalg.eigh(weights.information)
    rng = np.random.default_rng(2)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    power = np.einsum("ij,ij->j", columns, weights.information @ columns)
    drawn = columns.T @ (root @ rng.normal(size=(len(values), 300))) / np.sqrt(power)[:, np.newaxis]
    chances = [p_value(float(z), several) for z in np.max(np.abs(drawn), axis=0)]
    assert kstest(chances, "uniform").pvalue > 1e-3


def with_axial(relative: float, at_s: float) -> Record:
    """A record with an axial acceleration that steps by a part at a time, noise of a thousandth on it."""
    record, _ = told("nothing")[0].record, None
    flown = record.conditions
    C = 1e-4 * (1.0 + 0.02 * (flown["alpha_deg"] - 40.0))
    C = C * (1.0 + relative * (flown.time_s > at_s) + np.random.default_rng(1).normal(0.0, 1e-3, len(flown)))
    return replace(
        record, conditions=flown.with_columns(axial_accel_g=C * flown["rho_kg_m3"] * flown["velocity_m_s"] ** 2)
    )


def test_a_step_in_axial_acceleration_is_found_in_time_and_size():
    found = axial_steps(with_axial(0.03, 1100.3))
    assert found is not None
    assert found[0].time_s == pytest.approx(1100.3, abs=2.0)
    assert found[0].relative == pytest.approx(0.03, rel=0.1)
    assert found[0].chance < 1e-6


def test_no_step_is_found_where_there_is_none_and_none_is_looked_for_without_the_column():
    found = axial_steps(with_axial(0.0, 1100.3))
    assert found is not None
    assert all(step.chance > 1e-3 for step in found)
    assert axial_steps(told("nothing")[0].record) is None
