"""A thermocouple and its recorder: calibration, noise, recorder word, lost samples."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim_heating.base.errors import InputError
from sim_heating.base.files import check
from sim_heating.inputs.sensor_model import (
    SensorErrors,
    indicated_temperature,
    lost_samples,
    measure,
    quantise,
    sample_times,
)
from sim_heating.thermal.sampling import RateInManoeuvres, sample_instants
from sim_heating.thermal.stack import Sensor

approx = pytest.approx


def sensor(**keys: Any) -> Sensor:
    """A surface thermocouple with the keys of a test."""
    return Sensor.model_validate({"name": "s", "column": "s_K", "depth_m": 0.0, **keys})


WORD = sensor(bits=8, range_K=[255.0, 1530.0])
"""LSB 5 K: 1275 K over 255 steps."""


def test_the_lsb_of_a_word_is_its_span_over_the_number_of_steps() -> None:
    assert WORD.lsb_K == approx(5.0)
    assert sensor(bits=1, range_K=[300.0, 400.0]).lsb_K == approx(100.0)


@given(st.floats(255.0, 1530.0))
def test_a_word_is_never_more_than_half_a_step_off_within_its_range(T: float) -> None:
    read = quantise(WORD, np.array([T]))[0]
    assert abs(read - T) <= 2.5 + 1e-9
    assert (read - 255.0) / 5.0 == approx(round((read - 255.0) / 5.0), abs=1e-9)


def test_a_word_clips_at_both_ends_of_its_range() -> None:
    assert quantise(WORD, np.array([0.0, 254.0, 1531.0, 9000.0])).tolist() == [255.0, 255.0, 1530.0, 1530.0]


def test_quantising_twice_changes_nothing() -> None:
    once = quantise(WORD, np.linspace(200.0, 1600.0, 777))
    np.testing.assert_array_equal(quantise(WORD, once), once)


def test_without_a_word_the_indicated_temperature_is_read() -> None:
    T = np.array([290.123456789])
    assert quantise(sensor(), T)[0] == T[0]


def test_calibration_is_a_polynomial_of_the_temperature_with_gain_and_bias() -> None:
    T = np.array([300.0, 1000.0])
    bent = sensor(calibration=[1.0, 0.99, 1e-6])
    np.testing.assert_allclose(indicated_temperature(bent, T), 1.0 + 0.99 * T + 1e-6 * T**2)
    np.testing.assert_allclose(indicated_temperature(sensor(), T, SensorErrors(bias_K=4.0, gain=1.02)), 1.02 * T + 4.0)


def test_noise_has_the_declared_sigma_and_no_mean() -> None:
    T = np.full(20_000, 800.0)
    read = measure(sensor(noise_sigma_K=2.0), T, np.random.default_rng(1))
    assert np.std(read) == approx(2.0, rel=0.02)  # 4 sigma of the estimate
    assert np.mean(read) == approx(800.0, abs=4 * 2.0 / np.sqrt(20_000))


def test_quantisation_noise_of_a_moving_temperature_is_lsb_over_root_12() -> None:
    T = np.linspace(300.0, 1500.0, 10_000)
    assert np.std(measure(WORD, T, np.random.default_rng(1)) - T) == approx(5.0 / np.sqrt(12.0), rel=0.01)


def test_bias_is_applied_before_the_word_clips() -> None:
    read = measure(WORD, np.array([1528.0]), np.random.default_rng(1), SensorErrors(bias_K=50.0))
    assert read.tolist() == [1530.0]


def test_lost_samples_are_empty_and_gaps_include_both_ends() -> None:
    t = np.arange(10.0)
    lost = lost_samples(t, np.random.default_rng(1), 0.0, [[2.0, 4.0]])
    assert t[lost].tolist() == [2.0, 3.0, 4.0]
    read = measure(sensor(), np.full(10, 300.0), np.random.default_rng(1), None, lost)
    assert np.isnan(read).tolist() == lost.tolist()


def test_the_declared_fraction_of_samples_is_lost() -> None:
    lost = lost_samples(np.arange(10_000.0), np.random.default_rng(1), 0.05, [])
    assert np.mean(lost) == approx(0.05, abs=4 * np.sqrt(0.05 * 0.95 / 10_000))


def test_samples_begin_at_the_offset_and_go_to_the_end() -> None:
    late = sensor(rate_hz=2.0, sample_offset_s=0.25)
    np.testing.assert_allclose(sample_times([late], 10.0, 11.3), [10.25, 10.75, 11.25])
    np.testing.assert_allclose(sample_times([sensor()], 0.0, 3.0), [0.0, 1.0, 2.0, 3.0])
    np.testing.assert_allclose(sample_times([sensor()], 0.0, 1.0, rate_hz=4.0, offset_s=0.5), [0.5, 0.75, 1.0])
    assert len(sample_times([sensor(sample_offset_s=9.0)], 0.0, 3.0)) == 0


def test_sensors_of_one_recorder_must_share_a_rate() -> None:
    with pytest.raises(InputError, match="one rate_hz"):
        sample_times([sensor(rate_hz=1.0), sensor(rate_hz=2.0)], 0.0, 3.0)


def test_a_schedule_of_rates_holds_each_from_its_time_on() -> None:
    changing = sensor(rate_hz=[[0.0, 1.0], [2.0, 4.0], [3.0, 0.5]])
    expected = [0.0, 1.0, 2.0, 2.25, 2.5, 2.75, 3.0, 5.0, 7.0]
    np.testing.assert_allclose(sample_times([changing], 0.0, 8.0), expected)


def test_a_recorder_is_faster_from_start_to_end_of_a_manoeuvre() -> None:
    rate = {"manoeuvres_hz": 2.0, "elsewhere_hz": 1.0}
    times = sample_times([sensor(rate_hz=rate)], 0.0, 6.0, manoeuvres_s=[(2.0, 4.0)])
    np.testing.assert_allclose(times, [0.0, 1.0, 2.0, 2.5, 3.0, 3.5, 4.0, 5.0, 6.0])
    np.testing.assert_allclose(sample_times([sensor(rate_hz=rate)], 0.0, 2.0), [0.0, 1.0, 2.0])


RATES_HZ = st.floats(0.1, 50.0)


@given(st.floats(-5.0, 5.0), st.lists(st.tuples(st.floats(0.1, 9.0), RATES_HZ), min_size=1, max_size=5))
def test_the_integral_of_the_rate_counts_the_samples(first_s: float, rows: list[tuple[float, float]]) -> None:
    """By a sum over the spans between the changes, of which the samples know nothing."""
    starts = np.cumsum([length for length, _ in rows])
    rates = np.array([hz for _, hz in rows])
    times = sample_instants([[float(t), hz] for t, (_, hz) in zip(starts, rows, strict=True)], first_s, 40.0)
    ends = np.append(starts[1:], np.inf)

    def count(t: float) -> float:
        before = rates[0] * (min(t, starts[0]) - first_s) if first_s < starts[0] else 0.0
        return before + float(np.sum(rates * np.clip(np.minimum(ends, t) - np.maximum(starts, first_s), 0.0, None)))

    assert [count(t) for t in times] == approx(list(range(len(times))), abs=1e-6)
    assert count(40.0) - (len(times) - 1) < 1.0 + 1e-6


def test_rows_of_a_schedule_are_refused_by_their_number() -> None:
    keys = {"name": "s", "column": "s_K", "depth_m": 0.0}
    for rate_hz, problem in (
        ([[0.0, 1.0], [0.0, 2.0]], "`rate_hz`, row 2, item 1: 0 does not come after 0"),
        ([[0.0, 1.0, 3.0]], "`rate_hz`, row 1: "),
        ([[0.0, 0.0]], "`rate_hz`, row 1, item 2: 0 is not a sample rate"),
        ({"manoeuvres_hz": 0.0}, "`manoeuvres_hz`: 0.0 must be above 0"),
        (0.0, "`rate_hz`: 0.0 must be above 0"),
    ):
        with pytest.raises(InputError, match=problem):
            check(keys | {"rate_hz": rate_hz}, Sensor, "point.toml")


def test_the_words_of_a_rate_in_manoeuvres_state_both() -> None:
    assert str(RateInManoeuvres(manoeuvres_hz=10.0)) == "10 Hz in manoeuvres, 1 Hz elsewhere"
