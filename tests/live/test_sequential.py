"""The sequential test keeps its stated rate of false alarms, and finds what is missing soon."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.signal import lfilter

from sim_heating.estimation.filter.kernel import innovation
from sim_heating.estimation.inference.truncated_normal import truncated_normal
from sim_heating.live.watch.sequential import SequentialTest, score_of_word


def first_alarm_s(scores: np.ndarray, every_s: float, rate: float) -> float:
    """Time [s] of the first alarm of one sensor; infinite for none."""
    test = SequentialTest(rate)
    for i, z in enumerate(scores):
        test.take(every_s * i, "NOSE", "surface", float(z))
        if test.alarm is not None:
            return test.alarm.time_s
    return math.inf


@pytest.mark.thorough
def test_mean_time_to_a_false_alarm_is_at_least_the_stated_one() -> None:
    # 20 alarms an hour: 180 s. Alarms within t of the start have at most the probability t / 180 s.
    rate, every_s, rng = 20.0, 1.0, np.random.default_rng(20)
    times = [first_alarm_s(rng.normal(size=400), every_s, rate) for _ in range(60)]
    assert np.mean(np.minimum(times, 400.0)) > 180.0
    assert np.mean(np.array(times) < 90.0) < 0.5


@pytest.mark.parametrize("every_s", [0.1, 2.0])
def test_null_flight_of_fifteen_minutes_raises_no_alarm_at_any_rate(every_s: float) -> None:
    rng = np.random.default_rng(3)
    assert first_alarm_s(rng.normal(size=int(900 / every_s) // 4), every_s, 0.01) == math.inf


@pytest.mark.parametrize(
    ("wrong", "kind"),
    [
        (lambda z: z + 1.5, "mean"),
        (lambda z: z - 1.5, "mean"),
        (lambda z: 2.5 * z, "variance"),
    ],
)
def test_what_is_missing_is_found_within_a_minute(wrong, kind: str) -> None:
    rng, rate = np.random.default_rng(7), 0.01
    z = rng.normal(size=600)
    z[300:] = wrong(z[300:])
    test = SequentialTest(rate)
    for i, value in enumerate(z):
        test.take(float(i), "NOSE", "surface", float(value))
    assert test.alarm is not None
    assert 300.0 <= test.alarm.time_s < 360.0
    assert test.alarm.kind == kind
    assert "NOSE" in test.alarm.text


def test_correlated_innovations_raise_an_alarm_at_the_right_variance() -> None:
    rng = np.random.default_rng(11)
    z = np.zeros(900)
    for i in range(1, len(z)):
        z[i] = 0.8 * z[i - 1] + 0.6 * rng.normal()
    assert first_alarm_s(z, 1.0, 0.01) < 300.0


@pytest.mark.thorough
@pytest.mark.sample(1)
@pytest.mark.parametrize(("share", "tau_s"), [(0.15, 3.0), (0.25, 5.0)])
def test_slightly_coloured_noise_raises_no_more_alarms_than_stated(share: float, tau_s: float) -> None:
    # as of white noise: 20 alarms an hour
    rate, rng, keeps, times = 20.0, np.random.default_rng(12), math.exp(-1.0 / tau_s), []
    for _ in range(40):
        correlated = lfilter([math.sqrt(1.0 - keeps**2)], [1.0, -keeps], rng.normal(size=800))[400:]
        z = math.sqrt(share) * correlated + math.sqrt(1.0 - share) * rng.normal(size=400)
        times.append(first_alarm_s(z, 1.0, rate))
    assert np.mean(np.minimum(times, 400.0)) > 180.0
    assert np.mean(np.array(times) < 90.0) < 0.5


def test_a_clock_that_goes_back_leaves_a_test_that_works() -> None:
    rng, test = np.random.default_rng(4), SequentialTest(0.01)
    for i in range(300):
        test.take(float(i % 150), "NOSE", "surface", float(rng.normal()))
    assert test.alarm is None
    for i in range(60):
        test.take(150.0 + i, "NOSE", "surface", float(rng.normal()) + 3.0)
    assert test.alarm is not None


def test_a_small_common_shift_is_found_sooner_with_more_sensors() -> None:
    rng, alone, together = np.random.default_rng(5), SequentialTest(0.01), SequentialTest(0.01)
    for i in range(900):
        for k in range(5):
            z = float(rng.normal() + 0.35)
            together.take(float(i), "NOSE", f"tc{k}", z)
            if k == 0:
                alone.take(float(i), "NOSE", "tc0", z)
    assert together.alarm is not None
    assert alone.alarm is not None
    assert together.alarm.time_s < 0.6 * alone.alarm.time_s


def test_score_of_a_word_is_the_expected_innovation_within_it() -> None:
    variance = 9.0
    nu, against, _ = innovation(500.0, 510.0, 503.0, variance)
    low, high = (500.0 - 503.0) / 3.0, (510.0 - 503.0) / 3.0
    x = truncated_normal(low, high, high - low)[1]
    assert score_of_word(nu, against, variance) == pytest.approx(x, rel=1e-9)
    exact, same, _ = innovation(505.0, 505.0, 503.0, variance)
    assert score_of_word(exact, same, variance) == pytest.approx(2.0 / 3.0)


@pytest.mark.thorough
def test_coarse_words_raise_fewer_false_alarms_than_exact_readings() -> None:
    # words of four standard deviations: nearly all is lost, and no alarm may come of it
    rng, rate, times = np.random.default_rng(2), 20.0, []
    for _ in range(25):
        test = SequentialTest(rate)
        for i in range(300):
            mean = float(rng.uniform(0.0, 4.0))
            low = 4.0 * math.floor((mean + rng.normal()) / 4.0)
            nu, against, _ = innovation(low, low + 4.0, mean, 1.0)
            if math.isfinite(against):
                test.take(float(i), "NOSE", "surface", score_of_word(nu, against, 1.0))
        times.append(300.0 if test.alarm is None else test.alarm.time_s)
    assert np.mean(times) > 180.0


def test_a_gap_is_no_time_of_test_and_a_sensor_taken_out_is_forgotten() -> None:
    test = SequentialTest(0.01)
    test.take(0.0, "NOSE", "surface", 0.0)
    test.take(1.0, "NOSE", "surface", 0.0)
    before = test.statistic
    assert before is not None
    test.take(36_000.0, "NOSE", "surface", 0.0)
    after = test.statistic
    assert after is not None
    assert math.exp(after) < 120.0 / 3600.0
    test.leave_out("NOSE", "surface")
    assert test.statistic is None
