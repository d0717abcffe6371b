"""Error of the model, integrated out of the likelihood: against dense algebra, and on readings made with it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import solve_triangular
from scipy.stats import multivariate_normal

from sim_heating.closure.prior.model_error import flight_error
from sim_heating.estimation.inference.breaks import ReadError, log_prior, with_breaks
from sim_heating.estimation.inference.error_likelihood import (
    FORM_ERROR,
    form_root_K,
    innovations,
    model_error,
    parameter_root_K,
    scored_readings,
)
from sim_heating.estimation.inference.error_size import error_size
from sim_heating.estimation.inference.likelihood import log_likelihood
from sim_heating.estimation.inference.model_error import Correlation, HeatingErrorPrior
from sim_heating.estimation.problem import FitProblem
from sim_heating.inputs.record import FlightUncertainty, load_record
from tests.support.paths import ROOT

SIGMA, CORRELATION = 0.05, Correlation(150.0)
REFERENCE = (40.0, 0.0, 6.3, 0.0, 0.0)


def unrounded(record):
    """The record with sensors that state no recorder word, so that Laplace's approximation is exact."""
    sensors = [s.model_copy(update={"bits": None, "range_K": None}) for s in record.declared.thermocouples.sensor]
    thermocouples = record.declared.thermocouples.model_copy(update={"sensor": sensors})
    return replace(record, declared=record.declared.model_copy(update={"thermocouples": thermocouples}))


@pytest.fixture(scope="module")
def problem():
    record = unrounded(load_record(ROOT / "scenarios" / "records" / "practice" / "p06"))
    plain = FitProblem([record], ["ratio.scale", "ratio.d_alpha"], REFERENCE)
    error = model_error(plain.record_fits[0], np.zeros(2), SIGMA, CORRELATION)
    return plain.with_model_error(error)


AT = np.array([0.03, 1e-4])


def dense(problem, vector):
    """Residuals [K] in the order of the channels, and their covariance [K2]."""
    part, samples = problem.record_fits[0], problem.samples(vector)
    G = part.error_root_K
    residual = read_K(samples) - np.concatenate([s.mean_K for s in samples])
    return residual, G @ G.T + np.diag(part.reading_noise_K**2)


def read_K(samples):
    """Readings of all channels [K]."""
    return np.concatenate([0.5 * (s.channel.intervals.lower_K + s.channel.intervals.upper_K) for s in samples])


def test_the_likelihood_is_that_of_the_dense_covariance(problem):
    residual, covariance = dense(problem, AT)
    expected = multivariate_normal(np.zeros(len(residual)), covariance).logpdf(residual)
    assert problem.evaluate(AT).log_likelihood == pytest.approx(expected, rel=1e-9)
    assert problem.log_likelihoods(AT[np.newaxis])[0] == pytest.approx(expected, abs=1e-3)


def test_gradient_and_information_are_those_of_the_dense_covariance(problem):
    residual, covariance = dense(problem, AT)
    J = np.concatenate([s.sensitivity for s in problem.samples(AT)])
    found = problem.evaluate(AT)
    np.testing.assert_allclose(found.gradient, J.T @ np.linalg.solve(covariance, residual), rtol=1e-6)
    np.testing.assert_allclose(found.information, J.T @ np.linalg.solve(covariance, J), rtol=1e-6)


@pytest.fixture(scope="module")
def of_words(problem):
    """The same with words whose step is twice the noise."""
    record = load_record(ROOT / "scenarios" / "records" / "practice" / "p06")
    plain = FitProblem([record], ["ratio.scale", "ratio.d_alpha"], REFERENCE)
    part = plain.record_fits[0]
    part.sigma_K.update({c.number: 0.5 * c.sensor.lsb_K for c in part.channels})
    return plain.with_model_error(problem.record_fits[0].model_error)


@pytest.mark.parametrize("at", [AT, np.array([0.3, -3e-4])], ids=["near", "far off"])
def test_gradient_of_rounded_readings_is_that_of_their_likelihood(of_words, at):
    steps = np.diag([1e-4, 1e-6])
    either = [[of_words.evaluate(at + sign * d) for sign in (1.0, -1.0)] for d in steps]
    apart = 2.0 * np.diag(steps)
    gradient = [(a.log_likelihood - b.log_likelihood) / d for (a, b), d in zip(either, apart, strict=True)]
    curvature = [(b.gradient - a.gradient) / d for (a, b), d in zip(either, apart, strict=True)]
    found = of_words.evaluate(at)
    sigma = np.sqrt(np.diag(np.linalg.inv(found.information)))
    np.testing.assert_allclose(found.gradient * sigma, gradient * sigma, atol=0.05)
    assert np.all(np.linalg.eigvalsh(found.information * np.outer(sigma, sigma)) > 0.0)
    np.testing.assert_allclose(
        found.information * np.outer(sigma, sigma), curvature * np.outer(sigma, sigma), rtol=0.2, atol=0.2
    )


@pytest.mark.parametrize("width", [1.0, 6.0, 20.0])
def test_the_error_is_the_most_probable_one_whatever_the_width_of_a_word(of_words, width):
    part = replace(of_words.record_fits[0], sigma_K={})
    part.sigma_K.update({c.number: c.sensor.lsb_K / width for c in part.channels})
    found = scored_readings(part, [s.mean_K for s in of_words.samples(AT)])
    # the score of the sum in units of the standard deviations of u
    G = part.error_root_K
    scaled = G / part.reading_noise_K[:, np.newaxis]
    lower = np.linalg.cholesky(np.eye(G.shape[1]) + scaled.T @ scaled)
    left = np.linalg.solve(lower, G.T @ found.score - found.error)
    assert np.linalg.norm(left) < 0.01


def test_innovations_have_the_same_likelihood_together(problem):
    samples = problem.innovations(AT)
    each = [np.sum(log_likelihood(s.channel.intervals, s.mean_K, s.spread_K)) for s in samples]
    assert sum(each) == pytest.approx(problem.evaluate(AT).log_likelihood, rel=1e-9)


@pytest.fixture(scope="module")
def halves(problem):
    """The problem over the earlier and over the later half of its readings."""
    record = problem.record_fits[0].record
    early = record.fit_mask() & (record.time_s < np.median(record.time_s[record.fit_mask()]))
    parts = []
    for mask in (early, record.fit_mask() & ~early):
        half = FitProblem(
            [record], ["ratio.scale", "ratio.d_alpha"], REFERENCE, replace(problem.options, sample_masks=[mask])
        )
        parts.append(half.with_model_error(problem.record_fits[0].model_error))
    return parts


def test_readings_held_out_are_predicted_as_by_the_conditional_normal(problem, halves):
    first, second = halves
    _, state = innovations(first.record_fits[0], first.samples(AT))
    predicted = innovations(second.record_fits[0], second.samples(AT), state)[0]
    each = sum(float(np.sum(log_likelihood(s.channel.intervals, s.mean_K, s.spread_K))) for s in predicted)
    joint = problem.evaluate(AT).log_likelihood - first.evaluate(AT).log_likelihood
    assert each == pytest.approx(joint, abs=0.02)  # marches of two halves divide their steps each by themselves


def test_readings_held_out_are_as_uncertain_as_the_parameters_are(halves):
    first, second = halves
    fitted, others = first.samples(AT), second.samples(AT)
    variances = np.array([[4e-4, 1e-6], [1e-6, 1e-8]])
    _, state = innovations(first.record_fits[0], fitted)
    root_K = parameter_root_K(fitted, others, variances)
    predicted = innovations(second.record_fits[0], others, state, root_K)[0]
    found = sum(float(np.sum(log_likelihood(s.channel.intervals, s.mean_K, s.spread_K))) for s in predicted)
    (residual, here), (left, there) = dense(first, AT), dense(second, AT)
    across = second.record_fits[0].error_root_K @ first.record_fits[0].error_root_K.T
    J, J_there = (np.concatenate([s.sensitivity for s in samples]) for samples in (fitted, others))
    moved = J_there - across @ np.linalg.solve(here, J)
    covariance = there - across @ np.linalg.solve(here, across.T) + moved @ variances @ moved.T
    mean = across @ np.linalg.solve(here, residual)
    assert found == pytest.approx(multivariate_normal(mean, covariance).logpdf(left), rel=1e-9)


def test_without_an_error_the_likelihood_is_as_it_was():
    record = load_record(ROOT / "scenarios" / "records" / "practice" / "p06")
    plain = FitProblem([record], ["ratio.scale"], REFERENCE)
    tiny = plain.with_model_error(model_error(plain.record_fits[0], np.zeros(1), 1e-9, CORRELATION))
    at = np.array([0.05])
    expected, found = plain.evaluate(at), tiny.evaluate(at)
    assert found.log_likelihood == pytest.approx(expected.log_likelihood, abs=1e-6)
    np.testing.assert_allclose(found.information, expected.information, rtol=1e-6)


def test_the_response_is_that_of_a_march_with_other_heating(problem):
    part = problem.record_fits[0]
    error, flown = part.model_error, part.conditions
    e = 0.03 * np.sin(error.time_s / 200.0)
    scaled = flown["h_ref_kg_m2_s"] * (1.0 + np.interp(flown.time_s, error.time_s, e))
    other = FitProblem([part.record], ["ratio.scale", "ratio.d_alpha"], REFERENCE)
    other.record_fits[0].conditions = flown.with_columns(h_ref_kg_m2_s=scaled)
    moved = np.concatenate([s.mean_K for s in other.samples(AT)]) - np.concatenate(
        [s.mean_K for s in problem.samples(AT)]
    )
    linear = np.concatenate([error.at(c.number, part.sample_s[c.samples])[0] @ e for c in part.channels])
    assert np.max(np.abs(moved - linear)) < 0.03 * np.max(np.abs(moved))


@pytest.mark.thorough
@pytest.mark.parametrize("smooth", [False, True], ids=["with corners", "smooth"])
def test_the_size_of_an_error_is_found_from_readings_made_with_it(problem, smooth):
    part, rng = problem.record_fits[0], np.random.default_rng(5)
    samples, prior = problem.samples(AT), HeatingErrorPrior(0.05, 60.0, 600.0)
    towards = (np.full(2, 1e4), -AT)
    sizes = {}
    for true in (0.0, 0.02, 0.08):
        error = part.model_error.of_size(true, replace(CORRELATION, smooth=smooth))
        e = true * error.correlation_root @ rng.standard_normal(len(error.time_s))
        made = []
        for s in samples:
            c = s.channel
            read = (
                s.mean_K
                + error.at(c.number, part.sample_s[c.samples])[0] @ e
                + s.sigma_K * rng.standard_normal(len(s.mean_K))
            )
            made.append(replace(s, channel=replace(c, intervals=replace(c.intervals, lower_K=read, upper_K=read))))
        read_part = replace(part, channels=[s.channel for s in made])
        sizes[true] = error_size(read_part, made, towards, np.array([True, True]), prior)
    assert sizes[0.0].limit() < 0.012
    assert 0.01 < sizes[0.02].mean < 0.04
    assert 0.045 < sizes[0.08].mean < 0.14
    assert sizes[0.08].likeliest[1].smooth is smooth


def test_words_tell_the_size_of_an_error_as_their_likelihood_does(problem):
    """Words of 17 K, of a smooth error; the likelihood is that of each error by itself, about the same parameters."""
    record = load_record(ROOT / "scenarios" / "records" / "practice" / "p06")
    coarse = [s.model_copy(update={"range_K": [0.0, 4400.0]}) for s in record.declared.thermocouples.sensor]
    thermocouples = record.declared.thermocouples.model_copy(update={"sensor": coarse})
    record = replace(record, declared=record.declared.model_copy(update={"thermocouples": thermocouples}))
    smooth = problem.record_fits[0].model_error.of_size(0.06, Correlation(240.0, smooth=True))
    words = FitProblem([record], ["ratio.scale", "ratio.d_alpha"], REFERENCE).with_model_error(smooth)
    prior = HeatingErrorPrior(0.05, 60.0, 600.0)
    part, rng = words.record_fits[0], np.random.default_rng(3)
    e, samples = 0.06 * smooth.correlation_root @ rng.standard_normal(len(smooth.time_s)), words.samples(AT)
    for k, c in enumerate(part.channels):
        part.sigma_K[c.number] = 1.0
        true_K = samples[k].mean_K + smooth.at(c.number, part.sample_s[c.samples])[0] @ e
        word = np.round((true_K + rng.standard_normal(len(true_K))) / c.sensor.lsb_K)
        read = replace(c.intervals, lower_K=(word - 0.5) * c.sensor.lsb_K, upper_K=(word + 0.5) * c.sensor.lsb_K)
        part.channels[k] = replace(c, intervals=read)
    size = error_size(part, words.samples(AT), (np.ones(2), np.zeros(2)), np.zeros(2, dtype=bool), prior)
    expected, told = [], []
    for k, correlation in enumerate(size.correlations):
        for j in (4, 6, 8):
            other = words.with_model_error(smooth.of_size(size.sizes[j], correlation))
            expected.append(other.evaluate(AT).log_likelihood)
            told.append(size.log_likelihood[0, k, j])
    near = np.array(expected) > max(expected) - 30.0
    assert np.argmax(told) == np.argmax(expected)
    assert np.count_nonzero(near) > 10
    difference = np.array(told) - expected
    np.testing.assert_allclose(difference[near], difference[np.argmax(expected)], atol=4.0)


@pytest.fixture(scope="module")
def flown():
    """The problem of a record whose flight may be later, longer and in other air than stated."""
    record = unrounded(load_record(ROOT / "scenarios" / "records" / "practice" / "p06"))
    stated = FlightUncertainty(time_shift_s=5.0, time_stretch=0.01, density_relative=0.1)
    conditions = record.declared.conditions.model_copy(update={"uncertainty": stated})
    record = replace(record, declared=record.declared.model_copy(update={"conditions": conditions}))
    plain = FitProblem([record], ["ratio.scale"], REFERENCE)
    error = model_error(plain.record_fits[0], np.zeros(1), SIGMA, CORRELATION, flight_error(record))
    return plain.with_model_error(error)


def test_flight_error_has_one_likelihood_estimated_or_integrated_out(flown):
    unknown, scale = flown.with_flight_unknowns(), np.array([0.03])
    f = np.zeros(len(unknown.unknowns) - 1)
    for _ in range(2):  # readings are linear in it: one step finds the most probable error
        found = unknown.evaluate(np.append(scale, f))
        M = found.information[1:, 1:] + np.eye(len(f))
        f = f + np.linalg.solve(M, found.gradient[1:] - f)
    largest = unknown.evaluate(np.append(scale, f)).log_likelihood - 0.5 * f @ f
    volume = -0.5 * np.linalg.slogdet(M)[1]
    assert largest + volume == pytest.approx(flown.evaluate(scale).log_likelihood, rel=1e-9)
    np.testing.assert_allclose(flown.record_fits[0].model_error.along_flight(flown.errors(scale)[0]), f, atol=1e-6)


def test_the_gain_of_breaks_is_that_of_the_dense_covariance(problem):
    """A first-order error of the heating that starts anew at two knots, one of which is known, and not at a third."""
    part, sigma = problem.record_fits[0], 0.04
    error = part.model_error
    before = Correlation(90.0, breaks_s=(error.time_s[20], error.time_s[40]))
    white, S = np.diag(part.reading_noise_K**2), part.error_responses_K[0]
    residual = dense(problem, AT)[0] + S @ np.select(
        [error.time_s >= error.time_s[60], error.time_s >= error.time_s[40]], [0.08, -0.12]
    )

    def evidence(correlation):
        root = sigma * S @ correlation.root(error.time_s)
        price = log_prior(error.time_s, correlation.breaks_s)
        return multivariate_normal.logpdf(residual, cov=root @ root.T + white) + price

    noise = part.reading_noise_K[:, np.newaxis]
    scaled = S / noise
    read = ReadError(scaled.T @ scaled, scaled.T @ (residual / noise[:, 0]))
    gain, broken = with_breaks(read, error.time_s, before, sigma)
    assert {error.time_s[40], error.time_s[60]} <= set(broken.breaks_s)
    assert error.time_s[20] not in broken.breaks_s
    assert gain == pytest.approx(evidence(broken) - evidence(before), abs=1e-6)
    for other in error.time_s[10:60:10]:
        if other not in broken.breaks_s:
            assert evidence(replace(broken, breaks_s=tuple(sorted({*broken.breaks_s, other})))) <= evidence(broken)


SCALES = {1.0: 0.68, 2.0: 0.26, 4.0: 0.06}


def error_size_at(problem, samples, free=(False,), of_flight=(False,), sigma=0.1):
    """What readings say of the size of the errors about the middle of the prior of the one parameter."""
    towards = np.array([sigma**-2.0]), np.zeros(1)
    prior = HeatingErrorPrior(0.05, CORRELATION.time_s, CORRELATION.time_s)
    part = replace(problem.record_fits[0], channels=[s.channel for s in samples])
    return error_size(part, samples, towards, np.array(free), prior, SCALES, np.array(of_flight))


def with_form_error(problem):
    """The problem with an error of the form of a cause that warms all sensors by some kelvin."""
    error = problem.record_fits[0].model_error
    sensors, samples = error.heating_K.shape[:2]
    change_K = np.linspace(3.0, 9.0, sensors)[:, np.newaxis] * np.linspace(-1.0, 1.0, samples) ** 2
    form_K = form_root_K([change_K], error.sample_s, np.full(sensors, 0.3))
    return problem.with_model_error(replace(error, form_K=form_K)), change_K


def test_the_error_of_a_form_is_a_part_of_what_its_cause_changes(flown):
    formed, change_K = with_form_error(flown)
    error = formed.record_fits[0].model_error
    T = error.sample_s[-1] - error.sample_s[0]
    knots_s = np.linspace(error.sample_s[0], error.sample_s[-1], 12)
    at = [int(np.argmin(np.abs(error.sample_s - t))) for t in knots_s]
    change = change_K[:, at]
    expected = FORM_ERROR**2 * Correlation(T / 4.0, smooth=True).matrix(error.sample_s[at])
    for sensor, root_K in enumerate(error.form_K[:, at]):
        covariance = change[sensor, :, np.newaxis] * expected * change[sensor]
        np.testing.assert_allclose(root_K @ root_K.T, covariance, atol=0.02 * np.max(covariance))
        for other in error.form_K[sensor + 1 :, at]:
            np.testing.assert_array_equal(root_K @ other.T, 0.0)


def test_a_cause_that_changes_less_than_the_noise_has_an_exact_form():
    time_s = np.linspace(0.0, 900.0, 91)
    assert form_root_K([np.full((2, 91), 0.01)], time_s, np.ones(2)) is None
    assert form_root_K([], time_s, np.ones(2)) is None


def test_plain_marches_have_no_error_of_a_form(flown):
    exact = with_form_error(flown)[0].without_heating_error()
    assert exact.record_fits[0].model_error.form_K is None


@pytest.mark.parametrize("has_form", [False, True], ids=["exact forms", "a form with an error"])
@pytest.mark.parametrize("is_clock", [False, True], ids=["flight alone", "a parameter with it"])
def test_evidence_of_a_wider_flight_is_that_of_the_dense_covariance(flown, is_clock, has_form):
    flown = with_form_error(flown)[0] if has_form else flown
    part, at = flown.record_fits[0], np.zeros(1)
    size = error_size_at(flown, flown.samples(at), (is_clock,), (is_clock,))
    J = np.concatenate([s.sensitivity for s in flown.samples(at)])
    (S, F), count = part.error_responses_K, part.model_error.flight_K.shape[-1]
    residual, expected = read_K(flown.samples(at)) - np.concatenate([s.mean_K for s in flown.samples(at)]), []
    for c in (1.0, 4.0):
        L = size.sizes[6] * part.model_error.correlation_root
        root = np.column_stack([S @ L, c * F[:, :count], F[:, count:], *([c * 0.1 * J] if is_clock else [])])
        lower = np.linalg.cholesky(root @ root.T + np.diag(part.reading_noise_K**2))
        white = solve_triangular(lower, residual, lower=True)
        expected.append(-0.5 * white @ white - np.sum(np.log(np.diag(lower))))
    # those of equation 5 leave out what all models of a record have alike
    found = size.log_likelihood[[0, 2], 0, 6]
    np.testing.assert_allclose(np.diff(found), np.diff(expected), rtol=1e-6)


@pytest.mark.parametrize(("sigmas", "likeliest"), [(1.0, 1.0), (2.0, 2.0), (5.0, 4.0)])
def test_a_flight_further_off_than_stated_says_so(flown, sigmas, likeliest):
    part, at = flown.record_fits[0], np.zeros(1)
    F, first, made = part.error_responses_K[1], 0, []
    signs = np.resize([1.0, -1.0], F.shape[1])
    rng = np.random.default_rng(7)
    for s in flown.samples(at):
        moved_K = F[first : first + len(s.mean_K)] @ (sigmas * signs)
        first += len(s.mean_K)
        read = s.mean_K + moved_K + s.sigma_K * rng.standard_normal(len(s.mean_K))
        made.append(
            replace(s, channel=replace(s.channel, intervals=replace(s.channel.intervals, lower_K=read, upper_K=read)))
        )
    told = error_size_at(flown, made).posterior_of_scale
    assert max(told, key=told.get) == likeliest
    assert sum(told.values()) == pytest.approx(1.0)


def test_an_error_of_a_wider_flight_is_that_of_wider_sigmas(flown):
    error = flown.record_fits[0].model_error
    wider = error.of_size(error.sigma, error.correlation, 2.0)
    f = 0.3 * np.ones(len(error.flight.directions))
    for name in ("h_ref_kg_m2_s", "H_r_J_kg"):
        np.testing.assert_allclose(
            wider.flight.record(f).conditions[name], error.flight.record(2.0 * f).conditions[name], rtol=1e-12
        )
    np.testing.assert_allclose(wider.flight_K, 2.0 * error.flight_K)
    back = wider.of_size(error.sigma, error.correlation, 1.0)
    np.testing.assert_allclose(back.flight_K, error.flight_K)


def test_two_points_of_one_flight_tell_its_error_better_than_one(flown):
    alone = flown.with_flight_unknowns()
    flight = dict.fromkeys(alone.record_fits[0].flight_names, "one flight")
    both = FitProblem.joined([alone, alone], [{**flight, "ratio.scale": "A"}, {**flight, "ratio.scale": "B"}])
    assert sum(len(u.records) == 2 for u in both.unknowns) == len(flight)
    assert len(both.unknowns) == len(flight) + 2

    def sigma(problem):
        prior = np.diag([float(u.parameter.name in flight) for u in problem.unknowns])
        covariance = np.linalg.inv(problem.evaluate(np.zeros(len(problem.unknowns))).information + prior)
        at = [u.parameter.name for u in problem.unknowns].index("flight.time_stretch")
        return np.sqrt(covariance[at, at])

    assert sigma(both) < 0.9 * sigma(alone) < 0.9
