"""Likelihood of samples, rounded or not, against exact arithmetic, its derivatives and the statistics it implies."""

from __future__ import annotations

import math
from typing import Any

import mpmath
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim_heating.base.errors import InputError
from sim_heating.estimation.filter.kernel import innovation
from sim_heating.estimation.inference.likelihood import (
    Likelihood,
    ReadingIntervals,
    expected_information,
    likelihood,
    log_likelihood,
    quantile_residuals,
    reading_intervals,
)
from sim_heating.inputs.sensor_model import quantise
from sim_heating.thermal.stack import Sensor

approx = pytest.approx


def sensor(**keys: Any) -> Sensor:
    """A surface thermocouple with the keys of a test."""
    return Sensor.model_validate({"name": "s", "column": "s_K", "depth_m": 0.0, **keys})


WORD = sensor(bits=8, range_K=[255.0, 1530.0])
"""Steps of 5 K."""


def interval(lower: float, upper: float) -> ReadingIntervals:
    """One sample known to an interval."""
    return ReadingIntervals(np.array([lower]), np.array([upper]))


def exact_moments(alpha: float, beta: float) -> list[mpmath.mpf]:
    """log Z and E x^k, k = 1 .. 4, of a standard normal variable in [alpha, beta], by recursion with 80 digits."""
    with mpmath.workdps(80):
        a, b, root = mpmath.mpf(alpha), mpmath.mpf(beta), mpmath.sqrt(2)
        Z = (mpmath.erfc(a / root) - mpmath.erfc(b / root)) / 2
        end = [0 if mpmath.isinf(x) else mpmath.npdf(x) for x in (a, b)]
        power = [[0 if p == 0 else x**k * p for k in range(4)] for x, p in zip((a, b), end, strict=True)]
        E = [mpmath.mpf(1), (end[0] - end[1]) / Z]
        for k in (2, 3, 4):
            E.append((k - 1) * E[k - 2] - (power[1][k - 1] - power[0][k - 1]) / Z)
        return [mpmath.log(Z), *E[1:]]


def exact(lower: float, upper: float, mean: float, sigma: float) -> dict[str, float]:
    """Log likelihood and derivatives from exact moments, the second ones by Louis's identity."""
    with mpmath.workdps(80):
        s = mpmath.mpf(sigma)
        log_z, *E = exact_moments((mpmath.mpf(lower) - mean) / s, (mpmath.mpf(upper) - mean) / s)
        return {
            "log_likelihood": float(log_z),
            "score": float(E[0] / s),
            "information": float((1 - E[1] + E[0] ** 2) / s**2),
            "score_log_sigma": float(E[1] - 1),
            "information_log_sigma": float(2 * E[1] - E[3] + E[1] ** 2),
            "information_cross": float((2 * E[0] - E[2] + E[0] * E[1]) / s),
        }


INTERVALS = [
    (-0.5, 0.5), (-2.5, 2.5), (-7.0, 5.0), (0.0, 3.0), (2.0, 2.5), (9.0, 14.0), (50.0, 50.01), (50.0, 60.0),
    (30.0, 1e3), (0.3, 0.3 + 2**-30), (-(2**-20), 2**-21), (50.0, 50.0 + 2**-20), (0.0, math.inf), (4.0, math.inf),
    (50.0, math.inf),
]  # fmt: skip
"""In sigma from the mean: about it, next to it, remote, narrow, open."""


@pytest.mark.parametrize("ends", INTERVALS)
@pytest.mark.parametrize("sigma", [1.0, 0.25])
def test_a_rounded_sample_agrees_with_exact_arithmetic(ends: tuple[float, float], sigma: float) -> None:
    lower, upper = ends[0] * sigma, ends[1] * sigma
    found = likelihood(interval(lower, upper), 0.0, sigma)
    for name, value in exact(lower, upper, 0.0, sigma).items():
        assert getattr(found, name)[0] == approx(value, rel=1e-12, abs=1e-13), name


def test_mirrored_intervals_have_the_same_likelihood_and_opposite_scores() -> None:
    for lower, upper in INTERVALS:
        right, left = likelihood(interval(lower, upper), 0.0, 1.0), likelihood(interval(-upper, -lower), 0.0, 1.0)
        for name in ("log_likelihood", "information", "score_log_sigma", "information_log_sigma"):
            assert getattr(right, name)[0] == getattr(left, name)[0]
        for name in ("score", "information_cross"):
            assert getattr(right, name)[0] == approx(-getattr(left, name)[0], rel=0.0, abs=1e-16)


@given(st.floats(-60.0, 60.0), st.floats(1e-6, 100.0), st.floats(1e-3, 30.0))
def test_information_is_positive_and_at_most_that_of_an_unrounded_sample(
    centre: float, width: float, sigma: float
) -> None:
    found = likelihood(interval((centre - 0.5 * width) * sigma, (centre + 0.5 * width) * sigma), 0.0, sigma)
    assert np.isfinite(found.log_likelihood[0])
    assert found.log_likelihood[0] <= 1e-15
    assert 0.0 <= found.information[0] <= (1.0 + 1e-12) / sigma**2
    assert found.score[0] * centre >= -1e-14
    assert (abs(centre) - 0.5 * width - 1e-9) / sigma <= abs(found.score[0]) <= (abs(centre) + 0.5 * width) / sigma


@given(st.floats(-8.0, 8.0), st.floats(0.01, 20.0), st.floats(0.3, 3.0))
def test_score_and_information_are_the_derivatives_of_the_log_likelihood(m: float, width: float, sigma: float) -> None:
    """Central differences of the quantity one order below."""
    samples, d = interval(-0.5 * width, 0.5 * width), 1e-5
    at = likelihood(samples, m, sigma)

    def slope(name: str, along_mean: float, along_log_sigma: float) -> float:
        ends = [likelihood(samples, m + k * along_mean, sigma * math.exp(k * along_log_sigma)) for k in (-d, d)]
        return float((getattr(ends[1], name)[0] - getattr(ends[0], name)[0]) / (2.0 * d))

    near = {"rel": 1e-6, "abs": 1e-6}
    assert at.score[0] == approx(slope("log_likelihood", 1.0, 0.0), **near)
    assert at.score_log_sigma[0] == approx(slope("log_likelihood", 0.0, 1.0), **near)
    assert -at.information[0] == approx(slope("score", 1.0, 0.0), **near)
    assert -at.information_cross[0] == approx(slope("score", 0.0, 1.0), **near)
    assert -at.information_log_sigma[0] == approx(slope("score_log_sigma", 0.0, 1.0), **near)


def test_an_unrounded_sample_has_the_normal_density() -> None:
    found = likelihood(reading_intervals(sensor(), [303.0]), 300.0, 2.0)
    assert found.log_likelihood[0] == approx(-0.5 * 1.5**2 - math.log(2.0 * math.sqrt(2.0 * math.pi)))
    assert found.score[0] == approx(1.5 / 2.0)
    assert found.information[0] == approx(1.0 / 4.0)
    assert found.score_log_sigma[0] == approx(1.5**2 - 1.0)
    assert found.information_log_sigma[0] == approx(2.0 * 1.5**2)
    assert found.information_cross[0] == approx(2.0 * 1.5 / 2.0)


def test_fine_word_converges_to_an_unrounded_sample_to_second_order() -> None:
    """log P - log step is log density of the middle, and its error falls by four when the step is halved."""
    density = likelihood(reading_intervals(sensor(), [1.3]), 0.0, 1.0)
    for name in ("log_likelihood", "score", "information", "information_log_sigma"):
        errors = []
        for step in (0.2, 0.1, 0.05):
            found = likelihood(interval(1.3 - step / 2, 1.3 + step / 2), 0.0, 1.0)
            gained = -math.log(step) if name == "log_likelihood" else 0.0
            errors.append(getattr(found, name)[0] + gained - getattr(density, name)[0])
        assert np.divide(errors[:-1], errors[1:]) == approx([4.0, 4.0], rel=0.02), name


def test_the_words_of_a_recorder_share_all_probability() -> None:
    words = reading_intervals(WORD, 255.0 + 5.0 * np.arange(256))
    for mean in (200.0, 256.0, 700.3, 1529.0, 1600.0):
        p = np.exp(log_likelihood(words, mean, 3.0))
        assert p.sum() == approx(1.0, abs=1e-13)
        terms = likelihood(words, mean, 3.0)
        assert p @ terms.score == approx(0.0, abs=1e-13)
        assert p @ terms.information == approx(p @ terms.score**2, abs=1e-13)
        assert p @ terms.information_log_sigma == approx(p @ terms.score_log_sigma**2, abs=1e-12)


@given(st.floats(200.0, 1600.0))
def test_a_word_is_the_interval_that_its_sensor_rounds_to_it(T: float) -> None:
    word = reading_intervals(WORD, quantise(WORD, np.array([T])))
    assert word.lower_K[0] - 1e-9 <= T <= word.upper_K[0] + 1e-9


def test_the_ends_of_a_words_span_are_open() -> None:
    ends = reading_intervals(WORD, [255.0, 260.0, 1530.0])
    assert ends.lower_K.tolist() == [-math.inf, 257.5, 1527.5]
    assert ends.upper_K.tolist() == [257.5, 262.5, math.inf]


def test_lost_sample_has_no_information_and_lost_prediction_is_nan() -> None:
    samples = reading_intervals(WORD, [500.0, math.nan])
    found = likelihood(samples, [500.0, 500.0], 1.0)
    for name in Likelihood.__dataclass_fields__:
        assert getattr(found, name)[1] == 0.0
    assert log_likelihood(samples, math.nan, 1.0).tolist() == approx([math.nan, 0.0], nan_ok=True)
    assert np.isnan(likelihood(samples, math.nan, 1.0).information[0])


def test_candidates_of_a_line_search_broadcast_against_the_samples() -> None:
    samples = reading_intervals(WORD, [500.0, 505.0, 510.0])
    means = np.array([[500.0, 505.0, 510.0], [501.0, 506.0, 511.0]])
    both = log_likelihood(samples, means, 2.0)
    assert both.shape == (2, 3)
    np.testing.assert_array_equal(both[1], likelihood(samples, means[1], 2.0).log_likelihood)


@pytest.mark.parametrize("sigma", [0.0, -1.0, math.nan])
def test_noise_that_is_not_positive_is_refused(sigma: float) -> None:
    with pytest.raises(InputError, match="must be above 0"):
        likelihood(reading_intervals(WORD, [500.0]), 500.0, sigma)


@pytest.mark.parametrize(("mean", "sigma"), [(702.0, 1.0), (700.0, 5.0), (702.5, 0.2), (257.0, 3.0), (1540.0, 2.0)])
def test_expected_information_is_the_mean_over_the_words_that_may_be_read(mean: float, sigma: float) -> None:
    words = reading_intervals(WORD, 255.0 + 5.0 * np.arange(256))
    terms = likelihood(words, mean, sigma)
    mean_information = np.exp(terms.log_likelihood) @ terms.score**2
    assert expected_information(WORD, mean, sigma) == approx(mean_information, rel=1e-12)


def test_fine_words_add_a_twelfth_of_the_step_squared_to_the_noise() -> None:
    """Rounding adds step^2 / 12 to the variance (Sheppard), on either side of where the code takes the closed form."""
    for bits in (16, 17, 20, 32):
        fine = sensor(bits=bits, range_K=[255.0, 1530.0])
        expected = 1.0 / (1.0 + fine.lsb_K**2 / 12.0)
        assert expected_information(fine, 700.0, 1.0) == approx(expected, rel=1e-11)
    assert expected_information(sensor(), [700.0], 2.0) == approx(0.25)


def test_a_sample_at_the_end_of_a_fine_word_is_half_lost() -> None:
    """Mean on the last edge: what lies beyond is one reading with the mean phi(0) / Phi(0) of a half normal."""
    fine = sensor(bits=20, range_K=[255.0, 1530.0])
    expected = 0.5 * (1.0 - fine.lsb_K**2 / 12.0) + 0.5 * (2.0 / math.pi)
    assert expected_information(fine, 1530.0 - 0.5 * fine.lsb_K, 1.0) == approx(expected, rel=1e-9)


@pytest.mark.parametrize("ends", INTERVALS)
def test_an_interval_updates_a_normal_prior_to_the_truncated_normal(ends: tuple[float, float]) -> None:
    """A mean that covaries with the reading by c changes by c nu / S, its variance by -c^2 / S."""
    nu, S, _ = innovation(700.0 + 2.0 * ends[0], 700.0 + 2.0 * ends[1], 700.0, 4.0)
    shifted = [(700.0 + 2.0 * e - 700.0) / 2.0 for e in ends]
    with mpmath.workdps(80):
        _, first, second, *_ = exact_moments(*shifted)
        gained = float(1 - (second - first**2))
    assert nu / S == approx(float(first) / 2.0, rel=1e-12)
    assert approx(gained / 4.0, rel=1e-12, abs=1e-15) == 1.0 / S


def test_an_unrounded_sample_updates_to_itself() -> None:
    nu, S, _ = innovation(712.0, 712.0, 700.0, 4.0)
    assert (nu, S) == (12.0, 4.0)


@pytest.mark.parametrize(("bits", "sigma"), [(8, 0.5), (8, 3.0), (4, 10.0), (None, 1.0)])
def test_quantile_residuals_of_rounded_noise_are_standard_normal(bits: int | None, sigma: float) -> None:
    from scipy.stats import kstest

    rng = np.random.default_rng(3)
    recorder = sensor() if bits is None else sensor(bits=bits, range_K=[255.0, 1530.0])
    mean = np.linspace(280.0, 1500.0, 5000)
    read = quantise(recorder, mean + rng.normal(0.0, sigma, mean.size))
    residual = quantile_residuals(reading_intervals(recorder, read), mean, sigma, rng)
    assert kstest(residual, "norm").pvalue > 1e-3


def test_quantile_residuals_stay_within_their_interval_however_remote() -> None:
    rng = np.random.default_rng(4)
    for lower, upper in [(40.0, 40.5), (-40.5, -40.0), (5.0, 5.0 + 1e-9), (-1.0, 2.0), (38.0, math.inf)]:
        r = quantile_residuals(interval(lower, upper), np.zeros(50)[:, None], 1.0, rng)
        assert np.all((r >= lower) & (r <= upper))
    assert np.isnan(quantile_residuals(interval(math.nan, math.nan), 0.0, 1.0, rng)[0])
