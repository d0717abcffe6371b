"""What is known of a thermocouple's bias before a flight: a check at ambient, the error of its calibration."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from sim_heating.base.errors import InputError
from sim_heating.base.files import check
from sim_heating.estimation.fit import estimate
from sim_heating.estimation.record_fit import sensor_definition, sensor_errors
from sim_heating.inputs.record import Record, RecordedSensor, load_record
from sim_heating.live.filtering.parameters import default_prior
from sim_heating.simulation.predict import predict
from sim_heating.thermal.stack import Sensor
from tests.support.paths import PRACTICE

CHECK = {"reading_K": 296.4, "T_K": 295.2, "sigma_K": 0.3}


def sensor(**keys: Any) -> RecordedSensor:
    return RecordedSensor.model_validate({"name": "a", "column": "a_K", "depth_m": 0.0, **keys})


@pytest.fixture(scope="module")
def record() -> Record:
    return load_record(PRACTICE / "p02")


def checked(record: Record, **keys: Any) -> Record:
    """The record whose first sensor states these keys."""
    first, *others = record.sensors
    return record.with_sensors([RecordedSensor.model_validate(first.model_dump() | keys), *others])


def test_a_check_tells_the_bias_within_its_thermometer_and_the_word() -> None:
    word = sensor(bits=8, range_K=[255.0, 1530.0], noise_sigma_K=0.4, ambient_check=CHECK)
    assert word.bias_prior_K == pytest.approx((1.2, math.sqrt(0.3**2 + 0.4**2 + 5.0**2 / 12.0)))
    curve = sensor(noise_sigma_K=0.4, calibration=[2.0, 1.01], ambient_check=CHECK, calibration_sigma_K=2.0)
    mean_K = (296.4 - (2.0 + 1.01 * 295.2)) / 1.01
    assert curve.bias_prior_K == pytest.approx((mean_K, math.sqrt(0.3**2 + 0.4**2 + 2.0**2)))


def test_the_error_of_a_calibration_is_the_prior_of_a_bias() -> None:
    assert sensor(calibration_sigma_K=2.5).bias_prior_K == (0.0, 2.5)
    assert sensor().bias_prior_K is None


def test_a_check_is_the_prior_of_the_fit_and_of_the_running_one(record: Record) -> None:
    first = record.used_sensors[0]
    name = f"sensor.{first.name}.bias"
    stated = checked(record, ambient_check=CHECK, calibration_sigma_K=1.5)
    mean_K, sigma_K = stated.sensors[0].bias_prior_K or (0.0, 0.0)
    definition = sensor_definition(stated, name)
    assert definition is not None
    assert (definition.value, definition.sigma) == (mean_K, sigma_K)
    live = default_prior(None, name, stated.sensors)  # type: ignore[arg-type]  # no model has part in it
    assert (live.mean, live.sigma) == (mean_K, sigma_K)
    names = ["ratio.scale", name]
    of_check = estimate([stated], parameters=names)
    of_prior = estimate([record], parameters=names, priors={name: (mean_K, sigma_K)})
    for label, parameter in of_check.parameters.items():
        assert parameter.value == pytest.approx(of_prior.parameters[label].value, rel=1e-9)
        assert parameter.sigma == pytest.approx(of_prior.parameters[label].sigma, rel=1e-9)


def test_a_known_bias_is_in_predictions_and_in_fits_that_do_not_ask_for_it(record: Record) -> None:
    stated = checked(record, ambient_check=CHECK)
    np.testing.assert_allclose(predict(stated).indicated_K[0] - predict(record).indicated_K[0], 1.2, atol=1e-9)
    assert sensor_errors(stated.sensors[0], {}).bias_K == pytest.approx(1.2)


def test_a_check_is_of_a_record_and_knows_an_error() -> None:
    keys = {"name": "a", "column": "a_K", "depth_m": 0.0, "ambient_check": CHECK}
    with pytest.raises(InputError, match="ambient_check"):
        check(keys, Sensor, "control_points/p.toml")
    with pytest.raises(InputError, match="states no error, and would fix the bias exactly; add `sigma_K`"):
        check(keys | {"ambient_check": CHECK | {"sigma_K": 0.0}}, RecordedSensor, "record.toml")
