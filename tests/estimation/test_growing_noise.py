"""Noise of a thermocouple that grows with temperature: in readings, in the floor, in the likelihood of a fit."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from sim_heating.base.errors import InputError
from sim_heating.base.files import check
from sim_heating.estimation.filter.process_noise import ProcessNoise
from sim_heating.estimation.fit import FitResult, estimate, rms_normalised_residual
from sim_heating.estimation.inference.likelihood import likelihood, reading_intervals, scores
from sim_heating.inputs.record import Record, load_record
from sim_heating.inputs.sensor_model import measure
from sim_heating.thermal.stack import Sensor
from tests.support.paths import PRACTICE

PER_K = 0.004
NAMES = ["ratio.scale", *(f"ratio.d_{v}" for v in ("alpha", "logre", "elevon", "bodyflap"))]


def loud_when_hot(record: Record) -> Record:
    """The record with further noise of its first sensor, 0.004 of what it reads."""
    column, rng = record.used_sensors[0].column, np.random.default_rng(2)
    read = record.thermocouples[column]
    noise = rng.normal(0.0, 1.0, len(read)) * PER_K * np.nan_to_num(read)
    return replace(record, thermocouples={**record.thermocouples, column: read + noise})


def stating(record: Record) -> Record:
    first, *others = record.sensors
    return record.with_sensors([first.model_copy(update={"noise_per_K": PER_K}), *others])


def sensor(**keys: object) -> Sensor:
    return Sensor.model_validate({"name": "a", "column": "a_K", "depth_m": 0.0} | keys)


def test_readings_scatter_more_where_it_is_hot() -> None:
    noisy, rng = sensor(noise_sigma_K=1.0, noise_per_K=PER_K), np.random.default_rng(1)
    for T in (300.0, 1200.0):
        read = measure(noisy, np.full(100_000, T), rng)
        assert np.std(read) == pytest.approx(math.hypot(1.0, PER_K * T), rel=0.01)


def test_growing_noise_needs_the_part_that_it_grows_from() -> None:
    with pytest.raises(InputError, match="noise_per_K"):
        check({"name": "a", "column": "a_K", "depth_m": 0.0, "noise_per_K": PER_K}, Sensor, "record.toml")


def test_a_noise_for_each_reading_gives_the_sums_of_one_for_all() -> None:
    word = sensor(bits=8, range_K=[255.0, 1644.0], noise_sigma_K=2.0)
    read = reading_intervals(word, [400.0, 800.0, 1300.0, 1700.0])
    mean = np.array([402.0, 790.0, 1301.0, 1650.0])
    one, each = scores(read, mean, 2.0), scores(read, mean, np.full(4, 2.0))
    assert each[0] == pytest.approx(one[0])
    np.testing.assert_allclose(each[1], one[1])
    np.testing.assert_allclose(each[2], one[2])
    assert each[0] == pytest.approx(float(np.sum(likelihood(read, mean, 2.0).log_likelihood)))


def test_the_floor_of_a_record_has_the_growing_part() -> None:
    record = load_record(PRACTICE / "p06")
    first = record.used_sensors[0]
    read = record.temperatures_K([first])[0][record.fit_mask()]
    read = read[np.isfinite(read)]
    alone = record.with_sensors([first])
    expected = math.sqrt(first.noise_floor_K(first.noise_sigma_K) ** 2 + float(np.mean((PER_K * read) ** 2)))
    assert stating(alone).noise_floor_K() == pytest.approx(expected)


FILTER = pytest.param(ProcessNoise(node_K_sqrt_s=0.05), id="filter", marks=pytest.mark.thorough)


@pytest.mark.thorough
@pytest.mark.parametrize("noise", [pytest.param(None, id="march"), FILTER])
def test_stated_growing_noise_is_all_that_a_fit_leaves(noise: ProcessNoise | None) -> None:
    record = loud_when_hot(load_record(PRACTICE / "p06"))

    def misfit(one: Record) -> float:
        fit: FitResult = estimate(one, NAMES, process_noise=noise)
        assert fit.fit.converged
        return rms_normalised_residual(fit.samples())

    assert misfit(stating(record)) == pytest.approx(1.0, abs=0.06)
    if noise is None:
        assert misfit(record) > 1.5
