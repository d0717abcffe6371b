"""Measured over predicted flux of a comparison, in sigmas of the ratio table."""

from types import SimpleNamespace

import numpy as np
import pytest

from sim_heating.simulation.run import Comparison


def compared(measured_K, predicted_K, sigma):
    measured = SimpleNamespace(temperature_K=np.asarray(measured_K))
    residual = np.asarray(measured_K) - np.asarray(predicted_K)
    return Comparison(measured, None, residual, sigma)  # type: ignore[arg-type]


def test_wall_10_percent_hotter_radiates_46_percent_more():
    predicted = np.array([300.0, 1000.0, 1000.0])
    found = compared(1.1 * predicted, predicted, np.array([1.0, 0.25, 0.25])).flux
    assert found["flux_ratio"] == pytest.approx(1.1**4)
    # the cold sample, whose table is uncertain, counts for neither
    assert found["table_sigma"] == pytest.approx(0.25)
    assert found["table_sigmas"] == pytest.approx((1.1**4 - 1.0) / 0.25)


def test_table_without_sigma_gives_no_sigmas():
    found = compared([1000.0], [1000.0], None).flux
    assert (found["flux_ratio"], found["table_sigmas"]) == (1.0, None)
