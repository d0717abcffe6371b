"""Records whose model is not exact: a measured tile of STS-96, and readings made with a smooth error of the heating."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.signal import lfilter
from scipy.stats import chi2, norm

from benchmarks.challenge.record import make_and_write
from sim_heating.closure.close import close_loop
from sim_heating.closure.prior.changed_flight import shift_conditions
from sim_heating.closure.prior.model_error import clock_prior, flight_error, flight_scales, heating_error_prior
from sim_heating.closure.report.record import closure_json
from sim_heating.closure.search.heating_change import heating_change
from sim_heating.closure.search.hypothesis import NOT_PREDICTED, adequacy_of, fitted_anew, hypothesis, scored
from sim_heating.closure.search.joint_model import NO_CAUSE
from sim_heating.closure.search.joint_search import search_jointly, with_common_flights
from sim_heating.closure.search.ranking import prior_penalty, volume_penalty
from sim_heating.closure.search.refine import fit_converged
from sim_heating.closure.search.search import search_effects
from sim_heating.closure.search.simulated_records import jumping_errors, slow_errors, with_simulated_p_value
from sim_heating.closure.search.trials.candidates import candidates
from sim_heating.closure.search.trials.told_error import scale_in_words, told_error
from sim_heating.closure.search.trials.trial_fit import (
    TrialFit,
    base_trial,
    declared_fit,
    fitted_values,
    problem_with,
    sample_count,
    start_values,
    with_own_error,
)
from sim_heating.closure.verdict.policy import POLICY
from sim_heating.estimation.inference.error_likelihood import model_error
from sim_heating.estimation.inference.model_error import Correlation
from sim_heating.estimation.problem import FitProblem
from sim_heating.estimation.record_fit import SKEW_SPAN_S
from sim_heating.inputs.points import conditions_of_record
from sim_heating.inputs.record import BY_CONFIDENCE, FlightUncertainty, HeatingUncertainty, load_record
from tests.support.few_candidates import searched_among
from tests.support.paths import ROOT

RECORDS = ROOT / "scenarios" / "records"
REFERENCE = (40.0, 0.0, 6.3, 0.0, 0.0)


def as_measured(record):
    return replace(record, declared=record.declared.model_copy(update={"measured": True}))


def unrounded(record):
    sensors = [s.model_copy(update={"bits": None, "range_K": None}) for s in record.declared.thermocouples.sensor]
    thermocouples = record.declared.thermocouples.model_copy(update={"sensor": sensors})
    return replace(record, declared=record.declared.model_copy(update={"thermocouples": thermocouples}))


def with_error_of_heating(record, error_at, rng):
    """The record with the readings of its declared model whose heating has a relative error, noise added.

    error_at : from (time,) [s] to (time,) [-]
    """
    problem = FitProblem([record], [], REFERENCE)
    error = model_error(problem.record_fits[0], np.zeros(0), 1.0, Correlation(100.0))
    e, columns = error_at(error.time_s), dict(record.thermocouples)
    for s in problem.samples(np.zeros(0)):
        moved = error.at(s.channel.number, s.time_s)[0] @ e
        read = np.full(len(record.time_s), np.nan)
        read[np.isin(record.time_s, s.time_s)] = s.mean_K + moved + s.sigma_K * rng.standard_normal(len(s.mean_K))
        columns[s.channel.sensor.column] = read
    return replace(record, thermocouples=columns)


@pytest.mark.thorough
def test_transition_is_found_on_a_measured_tile():
    closed = close_loop(RECORDS / "sts96_597")
    contents = closure_json(closed.report)
    assert contents["finding"] == "found"
    assert [e["name"] for e in contents["effects"]] == ["transition"]
    assert contents["after"]["fit"]["rmse_K"] < 0.45 * contents["before"]["fit"]["rmse_K"]
    assert contents["after"]["holdout"]["rmse_K"] < 0.6 * contents["before"]["holdout"]["rmse_K"]
    error = contents["model_error"]
    assert 0.02 < error["relative_heating"]["value"] < error["relative_heating"]["limit_95"] < 0.15
    # nothing was counted on such records yet, so that no probability is stated
    assert contents["probability"] is None
    assert contents["samples"] == {"fit": 166, "holdout": 24, "left_out": {}}


@pytest.mark.thorough
def test_two_measured_tiles_have_a_transition_in_common():
    alone = [searched_among(load_record(RECORDS / name), ("transition",)) for name in ("sts96_480", "sts96_597")]
    found = search_jointly(alone)
    assert found.best.names == ("transition",)
    assert found.best.members == (0, 1)
    assert found.best.score < -POLICY.min_gain
    assert all(e.for_cause > POLICY.min_gain for e in found.evidence)


@pytest.mark.thorough
def test_a_smooth_error_of_the_heating_is_no_cause():
    rng = np.random.default_rng(11)
    record = with_error_of_heating(
        unrounded(load_record(RECORDS / "practice" / "p06")),
        lambda t: 0.04 * Correlation(200.0).root(t) @ rng.standard_normal(len(t)),
        rng,
    )
    found = search_effects(as_measured(record))
    assert found.conclusion.finding == "none", found.conclusion
    size = found.none.last.size
    assert size is not None
    assert 0.015 < size.mean < 0.08


@pytest.mark.thorough
def test_an_error_in_arcs_explains_their_innovations_and_none_that_scatter_more():
    rng = np.random.default_rng(3)
    arcs = 0.08 * rng.standard_normal(100)
    record = with_error_of_heating(
        unrounded(load_record(RECORDS / "practice" / "p06")), lambda t: arcs[((t - t[0]) // 100.0).astype(int)], rng
    )
    judged = with_own_error(base_trial(declared_fit(as_measured(record))))
    adequacy = adequacy_of(judged)
    assert adequacy.p_value > 2.0 * POLICY.adequate_p
    assert with_simulated_p_value(judged, replace(adequacy, statistic=9.0)).p_value < POLICY.adequate_p


@pytest.mark.thorough
def test_errors_that_jump_have_the_covariance_of_those_that_change_slowly():
    fit = FitProblem([load_record(RECORDS / "practice" / "p06")], [], REFERENCE).record_fits[0]
    alike = Correlation(100.0)
    error = model_error(fit, np.zeros(0), 1.0, alike)
    slow, jumping = (draw(error, alike, 20_000, np.random.default_rng(1)) for draw in (slow_errors, jumping_errors))
    np.testing.assert_allclose(np.cov(jumping), np.cov(slow), atol=0.05)  # of 20,000 pairs known to 0.007
    steps = np.diff(jumping, axis=0) / np.std(np.diff(jumping, axis=0))
    assert np.mean(steps**4) > 10.0  # 3 of normal ones


def test_a_generated_record_that_states_no_error_has_none():
    record = load_record(RECORDS / "practice" / "p06")
    assert heating_error_prior(record) is None
    assert flight_error(record) is None


def test_a_stated_uncertainty_is_used_whether_measured_or_not():
    record = load_record(RECORDS / "practice" / "p06")
    heating = record.declared.heating.model_copy(
        update={"uncertainty": HeatingUncertainty(relative=0.02, correlation_s=90.0)}
    )
    conditions = record.declared.conditions.model_copy(
        update={"uncertainty": FlightUncertainty(velocity_relative=0.003)}
    )
    declared = record.declared.model_copy(update={"heating": heating, "conditions": conditions})
    stated = replace(record, declared=declared)
    prior, flight = heating_error_prior(stated), flight_error(stated)
    assert (prior.relative, prior.shortest_s, prior.longest_s) == (0.02, 90.0, 90.0)
    believed = replace(prior, scales={1.0: 1.0})
    eight_sigmas = np.searchsorted(prior.grid()[0], 8.0 * 0.02)
    assert prior.grid()[2][0, eight_sigmas] > believed.grid()[2][0, eight_sigmas] + 20.0  # it may be too small
    assert heating_error_prior(as_measured(record)).scales == {1.0: 1.0}
    assert list(flight.directions) == [("velocity_relative", 0.003)]
    none = record.declared.heating.model_copy(update={"uncertainty": HeatingUncertainty(relative=0.0)})
    exact = replace(record, declared=record.declared.model_copy(update={"heating": none}))
    assert heating_error_prior(exact) is None
    assert heating_error_prior(as_measured(exact)).relative == 0.0  # its flight has an error


def with_flight_uncertainty(record, **stated):
    conditions = record.declared.conditions.model_copy(update={"uncertainty": FlightUncertainty(**stated)})
    return replace(record, declared=record.declared.model_copy(update={"conditions": conditions}))


def test_what_is_stated_of_a_flight_may_be_too_small_and_a_default_too_large():
    record = load_record(RECORDS / "practice" / "p06")
    stated = flight_scales(with_flight_uncertainty(record, velocity_relative=0.003))
    # a sigma with three degrees of freedom is an error of Student's t distribution, whose tails these masses have
    cut = [np.sqrt(2.0), 2.0 * np.sqrt(2.0)]
    larger = [chi2(3).cdf(3.0 / c**2) for c in cut]
    assert list(stated.values()) == pytest.approx([1.0 - larger[0], larger[0] - larger[1], larger[1]])
    assert flight_scales(record) == {1.0: 1.0}  # its flight is exact
    for judged in (as_measured(record), load_record(RECORDS / "sts96_597")):
        assert max(flight_scales(judged)) == 1.0
        assert sum(flight_scales(judged).values()) == pytest.approx(1.0)


def test_errors_by_a_confidence_are_not_told_as_stated():
    assert scale_in_words({1.0: 0.7, 2.0: 0.3}) == (
        "Its errors are as large as stated with a probability of 70 %, 2 times as large with 30 %"
    )
    assert scale_in_words({0.5: 0.6, 1.0: 0.4}) == (
        "Its errors are as large as its confidence says with a probability of 40 %, 0.5 times as large with 60 %"
    )


def test_density_error_scatters_between_its_knots_as_at_them():
    flight = flight_error(load_record(RECORDS / "sts96_597"))
    row, sigma = flight.rows["density_relative"]
    z = flight.altitudes_m
    middle = 0.5 * (row[1:] + row[:-1])  # what the line between two knots has there
    assert np.max(np.diff(z)) <= flight.uncertainty.density_scale_m / 3.0
    np.testing.assert_allclose(np.linalg.norm(row, axis=1), sigma)
    assert np.min(np.linalg.norm(middle, axis=1)) > 0.9 * sigma


@pytest.mark.thorough
def test_points_of_a_flight_that_is_stated_too_well_share_one_wider_error():
    """Two points of a flight that was four of its stated sigmas longer and in other air."""
    record = with_flight_uncertainty(
        load_record(RECORDS / "practice" / "p06"), time_shift_s=10.0, time_stretch=0.003, density_relative=0.03
    )
    flight = flight_error(record)
    alone = []
    for name in ("one", "other"):
        stated = replace(flight.record(4.0 * np.ones(len(flight.directions))), label=name)
        search = searched_among(stated, ("time-skew",))
        none = fitted_anew(search.none, with_own_error(search.none.last))
        conclusion = replace(search.conclusion, finding="none", best=none)
        alone.append(replace(search, none=none, conclusion=conclusion))
    assert all(r.none.last.size.likeliest[2] > 1.0 for r in alone)
    bases = with_common_flights(alone)
    parts = [base.record_fit for base in bases]
    assert parts[0].model_error.flight_scale == parts[1].model_error.flight_scale > 1.0
    assert parts[0].flight_names == parts[1].flight_names != ()
    # a cause is compared with the declared models by the evidence of one error
    assert all(NO_CAUSE.trial(base).size is base.size is not None for base in bases)


def test_a_clock_that_is_stated_too_well_may_be_off_by_more():
    record = with_flight_uncertainty(load_record(RECORDS / "practice" / "p06"), time_shift_s=0.6)
    clock = clock_prior(record, 0.25)
    assert clock.sigma == 0.6
    assert clock.upper > 3.0 * 2.0 * clock.sigma


@pytest.mark.parametrize("stated_s", [0.2, 20.0])
def test_a_clock_may_be_off_whatever_the_uncertainty_it_states(stated_s):
    """A skew that the record itself holds to be likely is no cause, be the flight's time besides known or not."""
    record = with_flight_uncertainty(load_record(RECORDS / "practice" / "p06"), time_shift_s=stated_s)
    base = base_trial(declared_fit(shift_conditions(record, 1.2)))
    assert fitted_values(base)["clock.skew"] == pytest.approx(-1.2, abs=0.3)
    directions = [name for name, _ in flight_error(record).directions]
    assert ("time_shift_s" in directions) is (stated_s > SKEW_SPAN_S)


def test_a_wall_may_be_cold_at_the_first_reading_of_a_flight_that_was_recorded_late():
    """The wall was heated from the first reading on, by conditions that are those of four seconds before."""
    record = with_flight_uncertainty(load_record(RECORDS / "practice" / "p06"), time_shift_s=2.0)
    whole = record.declared.segments.model_copy(update={"fit": [(0.0, 1452.0)], "holdout": []})
    record = replace(record, declared=record.declared.model_copy(update={"segments": whole}))
    base = base_trial(declared_fit(shift_conditions(record, 4.0)))
    assert fitted_values(base)["clock.skew"] == pytest.approx(-4.0, abs=0.3)
    error = base.record_fit.model_error
    f = dict(zip(error.flight_names, error.along_flight(base.problem.errors(base.fit.values)[0]), strict=True))
    assert f["flight.start_s"] * 2.0 * error.flight_scale == pytest.approx(-4.0, abs=1.5)


@pytest.mark.thorough
def test_evidence_counts_less_where_a_recorder_has_colour():
    """The same readings with first-order noise of 20 readings' memory, as large as the white noise of the recorder."""
    record = with_flight_uncertainty(load_record(RECORDS / "practice" / "p06"), velocity_relative=0.001)
    memory, rng, columns = np.exp(-1.0 / 20.0), np.random.default_rng(7), dict(record.thermocouples)
    for sensor in record.used_sensors:
        kicks = sensor.noise_sigma_K * np.sqrt(1.0 - memory**2) * rng.standard_normal(len(record.time_s))
        columns[sensor.column] = columns[sensor.column] + lfilter([1.0], [1.0, -memory], kicks)
    white, coloured = (base_trial(declared_fit(r)) for r in (record, replace(record, thermocouples=columns)))
    assert white.scale < 1.3
    assert coloured.scale > 3.0


def with_jumping_error(record, jumps):
    """The record, its heating known to 5 %, whose heating is off by some amounts from some times on."""
    heating = record.declared.heating.model_copy(update={"uncertainty": HeatingUncertainty(relative=0.05)})
    times, sizes = zip(*jumps, strict=True) if jumps else ((), ())

    def error(t):
        return np.append(0.0, sizes)[np.searchsorted(times, t, side="right")]

    made = with_error_of_heating(record, error, np.random.default_rng(3))
    return replace(made, declared=made.declared.model_copy(update={"heating": heating}))


def test_an_error_that_starts_anew_is_told_by_when_it_does():
    """The heating of a flight is off by other amounts from 600 and from 800 s on, as one of three arcs."""
    record = unrounded(load_record(RECORDS / "practice" / "p06"))
    smooth, jumping = (
        with_own_error(base_trial(declared_fit(with_jumping_error(record, jumps))))
        for jumps in ((), ((600.0, 0.06), (800.0, -0.05)))
    )
    assert smooth.record_fit.model_error.correlation.breaks_s == ()
    np.testing.assert_allclose(jumping.record_fit.model_error.correlation.breaks_s, (600.0, 800.0), atol=5.0)
    of_breaks = np.array([len(c.breaks_s) for c in jumping.size.correlations])
    posterior = jumping.size.posterior_of_heating.sum(axis=1)
    assert np.sum(posterior[of_breaks == 0]) < 1e-6


@pytest.mark.thorough
def test_a_jump_as_large_as_the_error_is_no_cause_and_a_larger_one_is():
    """The heating jumps once, by 6 % or by 60 %, and is known to 5 %: only the error of the one may be that large."""
    record = unrounded(load_record(RECORDS / "practice" / "p06"))
    small, large = (searched_among(with_jumping_error(record, [(900.0, by)]), ("transition",)) for by in (0.06, 0.6))
    assert small.conclusion.finding == "none"
    assert large.names == ("transition",)


@pytest.mark.thorough
def test_an_effect_of_a_record_with_a_late_clock_is_known_to_the_last_reading():
    """Readings of this tile go to the end of its conditions, and by a clock that is off beyond it."""
    base = base_trial(declared_fit(load_record(RECORDS / "sts96_468")))
    flown = conditions_of_record(base.record_fit.record)
    candidate = next(c for c in candidates(base.record_fit.record, flown, ()) if c.name == "transition")
    problem, changes = problem_with(base, candidate), []
    for skew_s in (-SKEW_SPAN_S, 0.0, SKEW_SPAN_S):
        values = start_values(problem, fitted_values(base) | candidate.start | {"clock.skew": skew_s})
        fit = replace(base.fit, names=problem.record_fits[0].names, values=values)
        trial = TrialFit("transition", candidate, problem, None, fit)
        changes.append(np.max(heating_change(trial, candidate)))
    assert changes[1] > 0.0
    np.testing.assert_allclose(changes, changes[1], rtol=1e-3)


@pytest.mark.thorough
def test_a_gain_beside_an_error_costs_the_part_of_its_prior_that_readings_rule_out():
    """By the integral over its prior, of which BIC has a rough estimate alone."""
    record = as_measured(load_record(RECORDS / "practice" / "p06"))
    base = base_trial(declared_fit(record))
    tried = candidates(record, conditions_of_record(record), ())
    candidate = next(c for c in tried if c.name == "sensor-bias" and len(c.names) == 1 and c.names[0].endswith("gain"))
    (trial,) = fit_converged([base], [candidate], [fitted_values(base) | candidate.start])
    (name,) = candidate.names
    k, prior = trial.fit.names.index(name), trial.definitions([name])[name]
    at, sigma = trial.fit.values[k], trial.fit.sigma[k]
    left = norm(prior.value, prior.sigma).expect(
        lambda b: np.exp(-0.5 * ((b - at) / sigma) ** 2), lb=at - 8.0 * sigma, ub=at + 8.0 * sigma
    )
    cost = prior_penalty(trial, candidate) + volume_penalty(trial, candidate) + np.log(sample_count(trial.problem))
    assert cost == pytest.approx(-2.0 * np.log(left), abs=0.05)
    exact = base_trial(declared_fit(load_record(RECORDS / "practice" / "p06")))
    assert volume_penalty(exact, candidate) == 0.0
    # what the readings do not tell at all costs nothing, and is no gain
    for factor in (1e6, np.inf):
        covariance = trial.fit.covariance.copy()
        covariance[k, k] *= factor
        untold = replace(trial, fit=replace(trial.fit, covariance=covariance))
        assert volume_penalty(untold, candidate) == pytest.approx(-np.log(sample_count(trial.problem)))


def cause_that_predicts_worse(none, lost):
    """A fit that makes the readings held out less likely by some nats than the declared model of a record does."""
    step = np.eye(len(none.last.fit.values))[none.last.fit.names.index("ratio.scale")] * 0.002

    def shifted(by):
        last = none.last
        fit = replace(last.fit, values=last.fit.values + by * step)
        return replace(last, name="catalysis", fit=fit)

    def loss(by):
        return (none.last.held_out_log_likelihood - shifted(by).held_out_log_likelihood) / none.last.held_out_scale

    return hypothesis([shifted(brentq(lambda by: loss(by) - lost, 0.1, 1000.0, xtol=1e-3))], {"catalysis": 1})


@pytest.mark.sample(1)
@pytest.mark.parametrize(("stated", "odds"), [(None, np.e), (HeatingUncertainty(relative=0.02), 20.0)])
def test_readings_held_out_speak_against_a_cause_from_stated_odds_on(stated, odds):
    """An exact model may predict them worse by a factor of e, one with an error by 20: its predictions scatter."""
    record = load_record(RECORDS / "practice" / "p06")
    heating = record.declared.heating.model_copy(update={"uncertainty": stated})
    record = replace(record, declared=record.declared.model_copy(update={"heating": heating}))
    none = hypothesis([base_trial(declared_fit(record))], {})
    as_good = hypothesis([replace(none.last, name="emissivity")], {"emissivity": 1})  # its scatter is what counts
    for worse, is_barred in ((0.9 * odds, False), (1.1 * odds, True)):
        _, judged = scored(none, [as_good, cause_that_predicts_worse(none, np.log(worse))])
        assert (NOT_PREDICTED[0] in judged.objections) is is_barred


def test_the_error_of_a_flight_follows_from_the_confidence_of_its_conditions():
    tile = load_record(RECORDS / "sts96_597")
    assert flight_error(tile).uncertainty == BY_CONFIDENCE["C"]
    board = load_record(RECORDS / "kaowool_board")
    assert flight_error(board) is None  # no air flows past it
    assert heating_error_prior(board) is None  # its flux is what was measured


def test_a_faster_flight_heats_more_and_keeps_its_angles_and_onsets():
    tile = load_record(RECORDS / "sts96_597")
    error = flight_error(tile)
    f = np.array([float(n == "velocity_relative") for n, _ in error.directions])
    before, after = (conditions_of_record(r) for r in (tile, error.record(f)))
    at = int(np.argmax(before["h_ref_kg_m2_s"] * before["H_r_J_kg"]))
    assert after["h_ref_kg_m2_s"][at] == pytest.approx(1.01 * before["h_ref_kg_m2_s"][at], rel=2e-3)
    assert after["H_r_J_kg"][at] == pytest.approx(1.01**2 * before["H_r_J_kg"][at], rel=5e-3)
    for name in ("alpha_deg", "log10_re", "mach", "velocity_m_s"):
        np.testing.assert_array_equal(after[name], before[name])


def test_a_flight_without_an_error_is_the_stated_one():
    tile = load_record(RECORDS / "sts96_597")
    error = flight_error(tile)
    before, after = (conditions_of_record(r) for r in (tile, error.record(np.zeros(len(error.directions)))))
    for name in ("h_ref_kg_m2_s", "H_r_J_kg", "p_surface_Pa"):
        np.testing.assert_allclose(after[name], before[name], rtol=1e-12)


@pytest.mark.thorough
@pytest.mark.sample(1)
@pytest.mark.parametrize("later_s", [1.9, -2.6])
def test_a_clock_within_its_uncertainty_is_an_error_of_the_flight(later_s):
    """Eight-bit readings of a POPU, whose conditions were recorded by a clock that was off."""
    record = load_record(RECORDS / "practice" / "p06")
    conditions = record.declared.conditions.model_copy(update={"uncertainty": FlightUncertainty(time_shift_s=2.0)})
    record = replace(record, declared=record.declared.model_copy(update={"conditions": conditions}))
    trial = with_own_error(base_trial(declared_fit(shift_conditions(record, later_s))))
    value, sigma = told_error(trial).flight["time_shift_s"]
    assert value == pytest.approx(-later_s, abs=max(3.0 * sigma, 0.2))
    assert sigma < 0.2


@pytest.mark.thorough
def test_what_a_form_leaves_is_no_further_cause(tmp_path):
    """Flow into a gap of a bell shape, where the library has another: without an error of its form a wrong gain and a
    lag of thermocouples follow what it leaves."""
    name, _, _ = make_and_write((791, 3, "one", tmp_path, True))
    result = search_effects(load_record(tmp_path / name))
    assert result.conclusion.finding == "found"
    assert result.names == ("gap-flow",)
    assert result.conclusion.best.last.record_fit.model_error.form_K is not None


@pytest.mark.thorough
@pytest.mark.parametrize("seed", [784, 801])
def test_an_error_of_the_heating_hides_no_second_and_third_cause(tmp_path, seed):
    """It takes up what the first cause leaves, so that this explains the record by itself.

    Of the second record the best single cause is a rival of two true ones, conductivity in place of radiation within
    the tile and catalysis: each member of the leading model is left out, and others are sought in its place.
    """
    name, answer, _ = make_and_write((seed, 0, "three", tmp_path, True))
    result = search_effects(load_record(tmp_path / name))
    single = next(h for h in result.hypotheses if len(h.names) == 1)
    assert single.adequate
    assert result.conclusion.finding == "found"
    assert set(result.names) == {*answer["effects"]}
