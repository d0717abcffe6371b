"""Bounds, identifiability, noise and residual tests: exact cases, and what repetitions with known noise show."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import lfilter
from scipy.special import ndtri
from scipy.stats import binom, kstest

from sim_heating.base.errors import InputError
from sim_heating.estimation.inference.bounds import (
    ChannelResiduals,
    CramerRaoBounds,
    cramer_rao_bounds,
    spectral_density,
)
from sim_heating.estimation.inference.identifiability import correlation, covariance, directions
from sim_heating.estimation.inference.likelihood import ReadingIntervals, likelihood, reading_intervals
from sim_heating.estimation.inference.noise import estimate_noise, noise_of_readings
from sim_heating.estimation.inference.residual_tests import chi_square, normality, sensor_residuals, whiteness
from sim_heating.inputs.sensor_model import quantise
from sim_heating.thermal.stack import Sensor

FloatArray = NDArray[np.float64]
approx = pytest.approx


def sensor(**keys: Any) -> Sensor:
    """A surface thermocouple with the keys of a test."""
    return Sensor.model_validate({"name": "s", "column": "s_K", "depth_m": 0.0, **keys})


WORD = sensor(bits=8, range_K=[255.0, 1530.0])
"""Steps of 5 K."""
NAMES = ("ratio.d0", "ratio.d_alpha", "ratio.d_elevon")


def autoregressive(n: int, phi: float, rng: np.random.Generator) -> FloatArray:
    """First-order autoregressive noise of unit variance."""
    return np.asarray(lfilter([math.sqrt(1.0 - phi**2)], [1.0, -phi], rng.normal(size=n + 300))[300:])


def slow_design(n: int) -> FloatArray:
    """(sample, 3): a constant, a slow wave and a slope, as coloured noise hides most."""
    t = np.arange(n) / n
    return np.stack([np.ones(n), np.sin(3.0 * np.pi * t), t - 0.5], axis=1)


def fitted(time: FloatArray, data: FloatArray, design: FloatArray) -> tuple[FloatArray, CramerRaoBounds]:
    """Least squares with unit noise, and its bounds."""
    values = np.linalg.lstsq(design, data)[0]
    ones = np.ones(len(time))
    return values, cramer_rao_bounds([ChannelResiduals("s", time, data - design @ values, ones, design)])


def likely(hits: int, trials: int, probability: float = 0.95) -> bool:
    """Whether a count of hits is within its binomial limits, 1 in 1000 outside."""
    low, high = binom.interval(0.999, trials, probability)
    return bool(low <= hits <= high)


# Bounds --------------------------------------------------------------------------------------------------------------


@pytest.mark.thorough
@pytest.mark.parametrize(("phi", "lost"), [(0.0, 0.0), (0.6, 0.0), (0.6, 0.2)])
def test_bounds_cover_the_truth_at_their_rate_with_coloured_noise(phi: float, lost: float) -> None:
    rng, n, trials = np.random.default_rng(11), 300, 200
    time, design = np.arange(n, dtype=float), slow_design(n)
    hits = np.zeros(3, dtype=int)
    for _ in range(trials):
        present = rng.random(n) >= lost
        values, found = fitted(time[present], autoregressive(n, phi, rng)[present], design[present])
        hits += np.abs(values) < found.half_width()
    assert all(likely(h, trials) for h in hits)


def test_bounds_for_white_noise_are_overconfident_where_noise_is_coloured() -> None:
    rng, n, trials = np.random.default_rng(12), 300, 100
    design = slow_design(n)
    sigma = np.sqrt(np.diag(covariance(design.T @ design)))
    hits = sum(np.abs(np.linalg.lstsq(design, autoregressive(n, 0.6, rng))[0]) < 1.96 * sigma for _ in range(trials))
    assert not any(likely(h, trials) for h in hits)


def test_the_mean_of_autoregressive_noise_has_the_bound_of_its_spectrum() -> None:
    """Variance of the mean is (1 + phi) / (1 - phi) / n for long records, determined to sqrt(2 / dof) of itself."""
    n, phi = 5000, 0.7
    data = autoregressive(n, phi, np.random.default_rng(13))
    _, found = fitted(np.arange(n, dtype=float), data, np.ones((n, 1)))
    assert found.sigma[0] ** 2 * n == approx((1.0 + phi) / (1.0 - phi), rel=3.0 * math.sqrt(2.0 / found.dof))
    assert found.white[0, 0] * n == approx(1.0)


@pytest.mark.thorough
def test_a_slow_change_is_told_from_the_spectrum_of_the_noise_at_rest() -> None:
    n, phi, rng = 20000, 0.6, np.random.default_rng(5)
    time, bare = np.arange(n, dtype=float), np.zeros((n, 0))
    for noise, expected in ((rng.normal(size=n), 1.0), (autoregressive(n, phi, rng), (1.0 + phi) / (1.0 - phi))):
        found = spectral_density(ChannelResiduals("T", time, noise, np.ones(n), bare))
        assert found == pytest.approx(expected, rel=0.1)


def test_the_fit_does_not_hide_colour_that_it_took_up() -> None:
    """Mean of two successive white samples: 1 at lag 0, 1/2 at lag 1, nothing beyond; the fit takes a seventh of it."""
    rng, n, trials = np.random.default_rng(14), 200, 100
    design = np.polynomial.legendre.legvander(np.linspace(-1.0, 1.0, n), 14)
    plain, corrected = np.zeros(trials), np.zeros((trials, 2))
    for i in range(trials):
        white = rng.normal(size=n + 1)
        data = (white[1:] + white[:-1]) / math.sqrt(2.0)
        values, found = fitted(np.arange(n, dtype=float), data, design)
        plain[i] = np.mean((data - design @ values) ** 2)
        c = found.autocovariance["s"][:2]
        corrected[i, : len(c)] = c
    assert plain.mean() < 0.85
    error = corrected.std(axis=0) / math.sqrt(trials)
    assert np.all(np.abs(corrected.mean(axis=0) - [1.0, 0.5]) < 3.0 * error)


def test_noise_above_the_declared_widens_bounds_but_no_prior() -> None:
    rng, n = np.random.default_rng(15), 4000
    data = 3.0 * rng.normal(size=n)
    design = np.stack([np.ones(n), np.zeros(n)], axis=1)
    channel = ChannelResiduals("s", np.arange(n, dtype=float), data - data.mean(), np.ones(n), design)
    found = cramer_rao_bounds([channel], np.array([0.0, 1.0 / 0.2**2]))
    assert found.sigma[0] == approx(3.0 / math.sqrt(n), rel=0.05)
    assert found.sigma[1] == approx(0.2)


def test_two_sensors_bound_a_parameter_like_one_with_all_their_samples() -> None:
    rng, n = np.random.default_rng(16), 1000
    t, ones = np.arange(n, dtype=float), np.ones(n)
    data = rng.normal(size=(2, n))
    residual = data - data.mean()
    both = cramer_rao_bounds(
        [ChannelResiduals(name, t, r, ones, ones[:, None]) for name, r in zip("ab", residual, strict=True)]
    )
    assert both.sigma[0] == approx(1.0 / math.sqrt(2 * n), rel=0.05)
    assert set(both.autocovariance) == {"a", "b"}
    assert both.dof == approx(2 * n - 1)


def test_sensor_with_a_large_misfit_leaves_every_combination_a_variance() -> None:
    n, rng = 40, np.random.default_rng(0)
    time = np.arange(n, dtype=float)
    cosines = np.stack([np.cos(np.pi * k * (time + 0.5) / n) for k in range(6)], axis=1)
    designs = [cosines, cosines @ rng.normal(scale=0.7, size=(6, 6))]
    design = np.concatenate(designs)
    readings = np.concatenate([40.0 * np.sin(2.0 * np.pi * time / 11.0), rng.normal(scale=0.3, size=n)])
    residuals = readings - design @ np.linalg.lstsq(design, readings)[0]
    parts = zip("ab", np.split(residuals, 2), designs, strict=True)
    found = cramer_rao_bounds([ChannelResiduals(name, time, e, np.ones(n), d) for name, e, d in parts])
    assert all(c[0] > 0.0 for c in found.autocovariance.values())
    assert np.linalg.eigvalsh(found.covariance)[0] > 0.0


def test_coarsely_rounded_samples_have_bounds_that_cover() -> None:
    """Mean of a slow ramp, steps five times the noise: score and information of the words take part, not residuals."""
    rng, n, trials = np.random.default_rng(17), 100, 100
    ramp, time = np.linspace(700.0, 760.0, n), np.arange(n, dtype=float)
    hits = 0
    for _ in range(trials):
        words = reading_intervals(WORD, quantise(WORD, ramp + rng.normal(size=n)))
        shift = 0.0
        for _ in range(6):
            terms = likelihood(words, ramp + shift, 1.0)
            shift += terms.score.sum() / terms.information.sum()
        terms = likelihood(words, ramp + shift, 1.0)
        found = cramer_rao_bounds([ChannelResiduals("s", time, terms.score, terms.information, np.ones((n, 1)))])
        hits += abs(shift) < found.half_width()[0]
    assert likely(hits, trials)


def test_bounds_of_more_parameters_than_samples_are_refused() -> None:
    channel = ChannelResiduals("s", np.arange(3.0), np.zeros(3), np.ones(3), np.eye(3))
    with pytest.raises(InputError, match="3 samples for 3 parameters"):
        cramer_rao_bounds([channel])


def test_sample_times_that_go_back_are_refused() -> None:
    channel = ChannelResiduals("s", np.array([0.0, 2.0, 1.0]), np.ones(3), np.ones(3), np.ones((3, 1)))
    with pytest.raises(InputError, match="do not increase"):
        cramer_rao_bounds([channel])


# Identifiability -----------------------------------------------------------------------------------------------------


def test_covariance_is_the_inverse_information_whatever_the_units() -> None:
    J = np.random.default_rng(18).normal(size=(30, 4)) * [1e-6, 1.0, 1e3, 1e9]
    M = J.T @ J
    s = np.sqrt(np.diag(M))
    np.testing.assert_allclose(covariance(M) * np.outer(s, s), np.linalg.inv(M / np.outer(s, s)), rtol=1e-9)


def test_elevon_that_follows_alpha_is_described_as_a_common_direction() -> None:
    alpha = np.linspace(-5.0, 5.0, 40)
    J = np.stack([np.ones(40), alpha, 0.4 * alpha + 1e-5 * np.sin(alpha)], axis=1)
    (found,) = directions(J.T @ J, NAMES)
    assert set(found.members) == {"ratio.d_alpha", "ratio.d_elevon"}
    assert found.describe().endswith("they may change in opposite directions")
    assert found.change[2] / found.change[1] == approx(-1.0 / 0.4, rel=1e-3)
    assert np.linalg.norm(J @ found.change) < 1e-4 * np.linalg.norm(J[:, 1] * found.change[1])


def test_parameters_that_cancel_move_together() -> None:
    J = np.stack([np.ones(9), np.arange(9.0), -np.arange(9.0)], axis=1)
    (found,) = directions(J.T @ J, NAMES)
    assert found.describe() == "the data do not separate ratio.d_alpha and ratio.d_elevon: they may change together"


def test_unidentified_parameter_has_no_finite_bound_and_others_keep_theirs() -> None:
    J = np.stack([np.ones(9), np.arange(9.0) - 4.0, 2.0 * (np.arange(9.0) - 4.0)], axis=1)
    C = covariance(J.T @ J)
    assert np.sqrt(np.diag(C)).tolist() == approx([1.0 / 3.0, math.inf, math.inf])
    assert np.isnan(C[1, 2])
    assert np.isnan(correlation(C)[0, 1])


def test_correlated_but_identified_parameters_are_no_singular_direction() -> None:
    """Coating and skew of correlation -0.96: eigenvalues 1 -+ 0.96."""
    M = np.array([[1.0, 0.96], [0.96, 1.0]]) * np.outer([3.0, 50.0], [3.0, 50.0])
    assert directions(M, ["coating", "skew"]) == []
    (near,) = directions(M, ["coating", "skew"], threshold=0.1)
    assert near.eigenvalue == approx(0.04)
    assert correlation(covariance(M))[0, 1] == approx(-0.96)


# Noise ---------------------------------------------------------------------------------------------------------------


def test_unrounded_noise_is_the_sum_of_squares_over_degrees_of_freedom() -> None:
    r = np.random.default_rng(19).normal(0.0, 2.0, 50)
    found = estimate_noise(ReadingIntervals(r, r), np.zeros(50), fitted=4)
    assert found.sigma_K == approx(math.sqrt(r @ r / 46.0), rel=1e-6)
    assert found.lower_K < found.sigma_K < found.upper_K


@pytest.mark.sample(1)
@pytest.mark.parametrize("sigma", [1.0, 2.0, 8.0])
def test_noise_on_either_side_of_a_word_step_is_within_its_limits(sigma: float) -> None:
    rng, trials = np.random.default_rng(20), 80
    mean = np.linspace(600.0, 900.0, 200)
    found = [
        estimate_noise(reading_intervals(WORD, quantise(WORD, mean + rng.normal(0.0, sigma, 200))), mean)
        for _ in range(trials)
    ]
    assert likely(sum(f.lower_K <= sigma <= f.upper_K for f in found), trials)
    assert np.mean([f.sigma_K for f in found]) == approx(sigma, rel=0.05)
    assert all(f.is_bounded_below for f in found)


def test_noise_hidden_by_rounding_is_bounded_from_above_alone() -> None:
    mean = np.linspace(600.0, 900.0, 60)
    found = estimate_noise(reading_intervals(WORD, quantise(WORD, mean)), mean)
    assert not found.is_bounded_below
    assert found.sigma_K == approx(0.5)
    assert found.sigma_K < found.upper_K < 5.0
    assert "hidden by rounding" in found.describe("T1")


def test_lost_samples_take_no_part_in_noise() -> None:
    r = np.random.default_rng(21).normal(size=40)
    holed = np.concatenate([r, np.full(10, np.nan)])
    assert estimate_noise(ReadingIntervals(holed, holed), np.zeros(50)) == estimate_noise(
        ReadingIntervals(r, r), np.zeros(40)
    )


@pytest.mark.parametrize(
    ("read", "message"),
    [([700.0, 700.0, 700.0], "agree in every digit"), ([700.0], "too few")],
)
def test_noise_that_the_samples_do_not_determine_is_refused(read: list[float], message: str) -> None:
    with pytest.raises(InputError, match=message):
        estimate_noise(reading_intervals(sensor(), read), np.full(len(read), 700.0))


def test_samples_at_the_end_of_a_word_determine_no_noise() -> None:
    with pytest.raises(InputError, match="end of its word"):
        estimate_noise(reading_intervals(WORD, np.full(20, 1530.0)), np.full(20, 1600.0))


# Residual tests ------------------------------------------------------------------------------------------------------


def test_whiteness_is_ljung_and_boxs_statistic_where_no_sample_is_lost() -> None:
    r, n = np.random.default_rng(22).normal(size=80), 80
    rho = np.array([r[k:] @ r[:-k] for k in range(1, 6)]) / (r @ r)
    found = whiteness(np.arange(80.0), r, lags=5)
    # their n_k rho_k is over n, not over the pairs: the two weights n - k and 1 / (n - k)^2 leave 1 / (n - k)
    assert found.statistic == approx(n * (n + 2) * np.sum(rho**2 / (n - np.arange(1, 6))))
    assert found.dof == 5


def test_whiteness_of_white_noise_with_lost_samples_and_a_gap_is_uniform() -> None:
    rng, time = np.random.default_rng(23), np.arange(200.0)
    p = []
    for _ in range(400):
        r = rng.normal(size=200)
        r[(rng.random(200) < 0.3) | ((time > 60.0) & (time < 90.0))] = np.nan
        p.append(whiteness(time, r).p_value)
    assert kstest(p, "uniform").pvalue > 1e-3


def test_colour_is_seen_through_lost_samples() -> None:
    rng, time = np.random.default_rng(24), np.arange(200.0)
    r = autoregressive(200, 0.6, rng)
    r[rng.random(200) < 0.3] = np.nan
    assert whiteness(time, r).p_value < 1e-6


def test_a_gap_is_a_time_and_no_neighbourhood() -> None:
    """Noise that repeats after 50 s: without the samples between, a lag of one would find it."""
    r = np.random.default_rng(25).normal(size=10)
    time = np.concatenate([np.arange(0.0, 5.0), np.arange(50.0, 55.0), [100.0, 101.0]])
    noise = np.concatenate([r[:5], r[:5], r[5:7]])
    pairs = np.array([r[:4] @ r[1:5]] * 2 + [r[5] * r[6]])
    power = noise @ noise / 12.0
    assert whiteness(time, noise, lags=1).statistic == approx((pairs.sum() / 9.0 / power) ** 2 * 9.0 * 14.0 / 12.0)


def test_normality_test_tells_gaussian_from_uniform_and_thins_long_series() -> None:
    rng = np.random.default_rng(26)
    assert normality(rng.normal(size=300)).p_value > 0.01
    assert normality(rng.uniform(size=300)).p_value < 1e-4
    assert normality(rng.normal(size=12_000)).dof == 4000


def test_a_sample_that_is_as_normal_as_can_be_has_the_largest_p_value() -> None:
    samples = 30
    values = ndtri((np.arange(1, samples + 1) - 0.375) / (samples + 0.25))
    assert normality(values).p_value == approx(1.0, abs=1e-3)


def test_chi_square_rejects_noise_declared_too_small_and_too_large() -> None:
    r = np.random.default_rng(27).normal(size=400)
    r[:20] = np.nan
    right = chi_square(r, fitted=0)
    assert right.dof == 380
    assert right.statistic == approx(np.nansum(r**2))
    assert right.p_value > 0.01
    assert chi_square(1.3 * r).p_value < 1e-6
    assert chi_square(0.7 * r).p_value < 1e-6


def test_chi_square_of_repetitions_is_uniform() -> None:
    rng = np.random.default_rng(28)
    p = [chi_square(rng.normal(size=30)).p_value for _ in range(500)]
    assert kstest(p, "uniform").pvalue > 1e-3


def test_coarse_word_residuals_pass_tests_that_rounding_errors_fail() -> None:
    """Slow ramp, step of 5 K, noise 0.5 K: rounding makes a saw of the plain residual."""
    rng, time = np.random.default_rng(29), np.arange(300.0)
    mean = 700.0 + 0.6 * time
    read = quantise(WORD, mean + rng.normal(0.0, 0.5, 300))
    found = sensor_residuals("T1", time, reading_intervals(WORD, read), mean, 0.5, rng)
    assert found.n == 300
    assert found.rms == approx(1.0, abs=0.15)
    assert found.whiteness is not None
    assert found.normality is not None
    assert min(found.whiteness.p_value, found.normality.p_value, chi_square(found.residual).p_value) > 0.01
    assert whiteness(time, read - mean).p_value < 1e-6
    assert normality(read - mean).p_value < 1e-3


def test_too_few_samples_are_refused_and_all_lost_are_named() -> None:
    with pytest.raises(InputError, match="5 samples are too few"):
        whiteness(np.arange(5.0), np.ones(5))
    with pytest.raises(InputError, match="leave no degree of freedom"):
        chi_square(np.ones(3), fitted=3)
    with pytest.raises(InputError, match="sensor T1: every sample"):
        sensor_residuals(
            "T1", np.arange(3.0), reading_intervals(WORD, np.full(3, np.nan)), np.ones(3), 1.0, np.random.default_rng()
        )
    few = sensor_residuals(
        "T1", np.arange(3.0), reading_intervals(WORD, [700.0] * 3), np.full(3, 700.0), 1.0, np.random.default_rng()
    )
    assert few.whiteness is None


def test_residuals_that_are_all_the_same_have_no_noise_to_test() -> None:
    with pytest.raises(InputError, match="residuals are all 2"):
        normality(np.full(20, 2.0))
    with pytest.raises(InputError, match="all 0"):
        whiteness(np.arange(20.0), np.zeros(20))


@pytest.mark.parametrize("sigma", [0.05, 0.3, 2.0])
def test_the_noise_of_readings_is_found_without_a_model(sigma: float) -> None:
    """A plate that is heated from 10 to 130 s and cools, at intervals that are not all alike, with two spikes."""
    rng = np.random.default_rng(11)
    t = np.sort(rng.uniform(0.0, 300.0, 400))
    T = 300.0 + 1.5 * np.clip(t - 10.0, 0.0, 120.0) - 0.2 * np.clip(t - 130.0, 0.0, None)
    reading = T + rng.normal(0.0, sigma, len(t))
    reading[[50, 200]] += 100.0
    reading[120:130] = np.nan
    assert noise_of_readings(t, reading) == pytest.approx(sigma, rel=0.25)


def test_averaging_recorder_has_more_noise_than_its_neighbours_show() -> None:
    white = np.random.default_rng(12).normal(0.0, 1.0, 4004)
    averaged = np.convolve(white, np.full(5, 0.2), "valid")
    found = noise_of_readings(np.arange(4000.0), averaged)
    assert 0.8 * np.std(averaged) < found < 1.2 * np.std(averaged)


def test_a_coarse_word_hides_the_noise_and_few_readings_have_none() -> None:
    t = np.arange(200.0)
    assert noise_of_readings(t, np.round(t / 50.0) * 5.0, 5.0) == pytest.approx(0.5)
    assert noise_of_readings(t[:15], t[:15]) is None
