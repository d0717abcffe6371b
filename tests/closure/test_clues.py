"""A residual heating is traced to the variable that made it, and to none where there is only noise."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.stats import kstest

from sim_heating.closure.clues.axial_force import axial_steps
from sim_heating.closure.clues.correlation import ResidualEvidence, residual_evidence
from sim_heating.closure.clues.residual_heating import ResidualHeating, residual_heating
from sim_heating.closure.clues.shapes import candidate_shapes, p_value, profiled_information, trials_factor
from sim_heating.closure.verdict.policy import POLICY
from sim_heating.estimation.problem import FitOptions, FitProblem, joint_reference
from sim_heating.heating.effects import EffectUse, use
from sim_heating.inputs.record import Record
from tests.support.missing import record_with

FITTED = ["ratio.scale", "ratio.d_alpha", "ratio.d_logre", "ratio.d_elevon", "ratio.d_bodyflap"]
ONSET_DEG = 41.0


def residual_after_newton(record: Record) -> ResidualHeating:
    """The residual heating of a record after three Newton steps of its derivatives."""
    problem = FitProblem([record], FITTED, joint_reference([record]), FitOptions(prior_scale=np.inf))
    values = np.zeros(len(FITTED))
    for _ in range(3):
        found = problem.evaluate(values)
        values = values + np.linalg.solve(found.information, found.gradient)
    return residual_heating(problem, values)


@cache
def residual_with(what: str) -> tuple[ResidualHeating, ResidualEvidence]:
    uses: dict[str, list[EffectUse]] = {
        "nothing": [],
        "onset": [use("impingement-onset", {"alpha_onset_deg": ONSET_DEG, "slope": 0.002})],
        "skew": [],
    }
    record, _ = record_with(uses[what], 5, skew_s=2.0 if what == "skew" else 0.0)
    residual = residual_after_newton(record)
    return residual, residual_evidence(residual)


@pytest.mark.thorough
def test_heating_above_an_onset_angle_is_recognised_as_such():
    _, found = residual_with("onset")
    best = found.shape_fits[0]
    assert (best.shape.variable, best.shape.form) in {("alpha_deg", "above"), ("alpha_deg", "square")}
    assert abs(best.shape.lag_s) <= 2.0
    assert best.share > 0.7
    assert found.p_value < 1e-6
    assert "alpha_deg" in found.proposal()[0]


@pytest.mark.thorough
def test_an_error_of_the_table_makes_no_hysteresis_and_a_clock_error_does():
    _, onset = residual_with("onset")
    _, skew = residual_with("skew")
    assert not any(loop.significant for loop in onset.loops)
    assert any(loop.significant and loop.variable == "alpha_deg" for loop in skew.loops)
    assert any("thermal model, a clock or a lag" in line for line in skew.proposal())
    assert skew.shape_fits[0].shape.form == "rate"


def test_nothing_is_proposed_where_nothing_is_missing():
    _, found = residual_with("nothing")
    assert found.p_value > POLICY.significance
    assert found.active == ()
    assert found.proposal() == ["As heating, the residual is no more than noise: it follows no variable of the flight."]
    assert not any(loop.significant for loop in found.loops)
    assert all(c.p_value_all > POLICY.significance for c in found.correlations)


def test_active_spans_are_those_with_the_angle_beyond_the_onset():
    residual, found = residual_with("onset")
    alpha = residual.record.conditions.at(residual.time_s)["alpha_deg"]
    for span in found.active[:2]:
        own = (residual.time_s > span.start_s - 10.0) & (residual.time_s < span.end_s + 10.0)
        assert np.max(alpha[own]) > ONSET_DEG - 1.0


def test_a_history_that_removes_more_than_all_heating_is_reported_as_negative():
    residual, _ = residual_with("onset")
    ratio = np.full(len(residual.time_s), 0.05)
    sound = residual_evidence(residual, ratio)
    assert sound.negative_s == 0.0
    taken = replace(residual, input=replace(residual.input, delta_ratio=np.where(residual.fitted, -0.1, 0.0)))
    assert residual_evidence(taken, ratio).negative_s > 500.0


def test_the_p_value_of_the_best_of_many_shapes_is_uniform_on_noise():
    residual, _ = residual_with("nothing")
    profiled = profiled_information(residual)
    _, columns = candidate_shapes(
        residual.time_s, {"alpha_deg": residual.record.conditions.at(residual.time_s)["alpha_deg"]}
    )
    trials = trials_factor(profiled, columns, seed=1)
    values, vectors = np.linalg.eigh(profiled.information)
    rng = np.random.default_rng(2)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    power = np.einsum("ij,ij->j", columns, profiled.information @ columns)
    drawn = columns.T @ (root @ rng.normal(size=(len(values), 300))) / np.sqrt(power)[:, np.newaxis]
    p_values = [p_value(float(z), trials) for z in np.max(np.abs(drawn), axis=0)]
    assert kstest(p_values, "uniform").pvalue > 1e-3


def with_axial(relative: float, at_s: float) -> Record:
    """A record with an axial acceleration that steps by a part at a time, with noise of a thousandth."""
    record = residual_with("nothing")[0].record
    flown = record.conditions
    C = 1e-4 * (1.0 + 0.02 * (flown["alpha_deg"] - 40.0))
    C = C * (1.0 + relative * (flown.time_s > at_s) + np.random.default_rng(1).normal(0.0, 1e-3, len(flown)))
    return replace(
        record, conditions=flown.with_columns(axial_accel_g=C * flown["rho_kg_m3"] * flown["velocity_m_s"] ** 2)
    )


@pytest.mark.thorough
def test_an_axial_force_without_noise_has_a_step_of_probability_one() -> None:
    """Coefficients that are constant to rounding: a step improves the fit by less than rounding, or worsens it."""
    record = residual_with("nothing")[0].record
    flown = record.conditions
    for begun_s in np.arange(1000.0, 1200.0, 5.0):
        measured = (flown.time_s > begun_s) & (flown.time_s < begun_s + 100.0)
        a = measured * 1e-4 * flown["rho_kg_m3"] * flown["velocity_m_s"] ** 2
        steps = axial_steps(replace(record, conditions=flown.with_columns(axial_accel_g=a))) or ()
        assert all(0.0 <= step.p_value <= 1.0 for step in steps)


def test_a_step_in_axial_acceleration_is_found_in_time_and_size():
    found = axial_steps(with_axial(0.03, 1100.3))
    assert found is not None
    assert found[0].time_s == pytest.approx(1100.3, abs=2.0)
    assert found[0].relative == pytest.approx(0.03, rel=0.1)
    assert found[0].p_value < 1e-6


@pytest.mark.thorough
def test_a_step_of_a_simulated_flight_too_small_for_a_transition_is_no_evidence_of_one():
    """Columns without an accelerometer's noise make any kink of a simulation certain."""
    found = axial_steps(with_axial(0.006, 1100.3))
    assert found is not None
    assert found[0].p_value < 1e-3
    assert not found[0].as_of_transition
    large = axial_steps(with_axial(0.03, 1100.3))
    assert large is not None
    assert large[0].as_of_transition


def test_no_step_is_found_in_noise_or_without_the_column():
    found = axial_steps(with_axial(0.0, 1100.3))
    assert found is not None
    assert all(step.p_value > 1e-3 for step in found)
    assert axial_steps(residual_with("nothing")[0].record) is None
