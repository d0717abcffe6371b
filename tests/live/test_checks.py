"""Sensors that fail are taken out, and reported; healthy ones, and a model that is wrong, are left alone."""

from __future__ import annotations

import numpy as np
import pytest

from sim_heating.live.filtering.estimates import Innovation
from sim_heating.live.watch.checks import Failure, SensorChecks
from sim_heating.thermal.stack import Sensor

NAMES = ("surface", "middle", "deep", "bondline")
NOISE_K = 1.5


def flown(count: int = 240) -> dict[str, np.ndarray]:
    """(reading,) temperatures of four sensors through a pushover-pullup, one reading a second [K]."""
    t = np.arange(count, dtype=float)
    swing = np.sin(2.0 * np.pi * t / 90.0)
    return {
        "surface": 1100.0 + 0.3 * t - 60.0 * swing,
        "middle": 800.0 + 0.4 * t - 25.0 * swing,
        "deep": 500.0 + 0.3 * t - 5.0 * swing,
        "bondline": 320.0 + 0.1 * t,
    }


def sensors(**recorder: object) -> dict[tuple[str, str], Sensor]:
    """The sensors, with their recorder where one is given."""
    return {
        ("NOSE", n): Sensor.model_validate(
            {"name": n, "column": f"{n}_K", "depth_m": 1e-4 + 0.005 * k, "noise_sigma_K": NOISE_K} | recorder
        )
        for k, n in enumerate(NAMES)
    }


Readings = dict[str, np.ndarray]


def checked(indicated: Readings, expected: Readings, doubted_from: int = 1000) -> SensorChecks:
    checks = SensorChecks(sensors(), lateness_s=2.0)
    for i in range(len(expected["surface"])):
        for n in NAMES:
            y, m = float(indicated[n][i]), float(expected[n][i])
            checks.take(Innovation(float(i), "NOSE", n, y - m, NOISE_K**2, m, NOISE_K**2, y), i >= doubted_from)
    return checks


def failures(indicated: dict[str, np.ndarray], expected: dict[str, np.ndarray]) -> list[Failure]:
    return checked(indicated, expected).failures


def measured(seed: int) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    rng, truth = np.random.default_rng(seed), flown()
    return {n: T + rng.normal(0.0, NOISE_K, len(T)) for n, T in truth.items()}, truth


@pytest.mark.parametrize("seed", range(5))
def test_healthy_sensors_stay(seed: int) -> None:
    assert failures(*measured(seed)) == []


def test_coarse_words_that_stay_while_little_changes_are_not_stuck() -> None:
    indicated, truth = measured(1)
    indicated = {n: 8.0 * np.round(y / 8.0) for n, y in indicated.items()}
    checks = SensorChecks(sensors(bits=8, range_K=[256.0, 2296.0]))
    for i in range(240):
        n = "bondline"
        y, m = float(indicated[n][i]), float(truth[n][i])
        # nu and S of the interval: within it nothing is known but that
        checks.take(Innovation(float(i), "NOSE", n, y - m, 64.0 / 12.0 + NOISE_K**2, m, NOISE_K**2, y))
    assert checks.failures == []


def test_stuck_sensor_is_removed_at_a_time_independent_of_arrival() -> None:
    indicated, truth = measured(2)
    indicated["middle"][100:] = indicated["middle"][100]
    (failure,) = failures(indicated, truth)
    assert (failure.sensor, failure.found_s < 135.0) == ("middle", True)
    assert failure.from_s == failure.found_s + 3.0
    assert "stuck at" in failure.why
    assert "since 100.0 s" in failure.why


def test_a_clipped_sensor_is_called_clipped() -> None:
    indicated, truth = measured(3)
    indicated["surface"] = np.minimum(indicated["surface"], 1130.0)
    found = failures(indicated, truth)
    assert [f.sensor for f in found] == ["surface"]
    assert "clips at 1130.0 K" in found[0].why


def test_a_flickering_sensor_is_taken_out_and_a_single_spike_is_not() -> None:
    indicated, truth = measured(4)
    indicated["deep"][50] += 80.0
    assert failures(indicated, truth) == []
    indicated["deep"][120:160:4] -= 60.0
    (failure,) = failures(indicated, truth)
    assert failure.sensor == "deep"
    assert failure.found_s < 145.0
    assert "flickers" in failure.why


def test_a_sensor_that_drifts_away_from_its_neighbours_is_taken_out() -> None:
    indicated, truth = measured(5)
    indicated["deep"][80:] += 0.15 * np.arange(160)
    (failure,) = failures(indicated, truth)
    assert failure.sensor == "deep"
    assert "+" in failure.why
    assert "neighbours" in failure.why


def test_all_sensors_off_together_is_a_wrong_model_and_takes_none_out() -> None:
    indicated, truth = measured(6)
    for n, by_K in zip(NAMES, (12.0, 9.0, 7.0, 6.0), strict=True):
        indicated[n][100:] += by_K
    assert failures(indicated, truth) == []


def test_sensor_away_from_neighbours_after_an_alarm_is_undecided() -> None:
    indicated, truth = measured(5)
    indicated["surface"][80:160] += 8.0
    whole = {n: T[:240] for n, T in indicated.items()}
    then = {n: T[:160] for n, T in indicated.items()}
    during, after = (
        checked(T, truth_of, doubted_from=85)
        for T, truth_of in ((then, {n: T[:160] for n, T in truth.items()}), (whole, truth))
    )
    assert during.failures == after.failures == []
    assert "neighbours" in during.undecided["NOSE", "surface"]
    assert not after.undecided


def test_sensor_stuck_after_an_alarm_is_removed_where_the_model_was_right() -> None:
    indicated, truth = measured(2)
    indicated["middle"][100:] = indicated["middle"][100]
    (failure,) = checked(indicated, truth, doubted_from=0).failures
    assert failure.sensor == "middle"


def test_a_reading_that_stays_where_the_model_is_far_off_is_undecided() -> None:
    # a coarse word at the top of a swing, of which the model knows nothing
    indicated, truth = measured(7)
    indicated["middle"] = truth["middle"] + 60.0
    indicated["middle"][100:130] = 900.0
    checks = checked(indicated, truth, doubted_from=0)
    assert "middle" not in {f.sensor for f in checks.failures}
    assert ("NOSE", "middle") in checks.undecided
