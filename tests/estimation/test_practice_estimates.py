"""Practice records p06 and p07, another program's flights, fitted by default and then held against what was put in."""

from __future__ import annotations

import numpy as np
import pytest

from sim_heating.estimation.fit import FitResult, estimate
from sim_heating.estimation.report.report import estimate_contents
from tests.support.walls import practice_record


@pytest.fixture(scope="module", params=["p06", "p07"])
def fitted(request: pytest.FixtureRequest) -> tuple[str, FitResult]:
    """The record's name and its fit: default parameters, derivatives about the answers' reference condition."""
    record, truth = practice_record(request.param)
    return request.param, estimate([record], reference=truth["reference_condition"])


@pytest.mark.sample(1)
def test_scale_and_derivatives_are_within_their_95_percent_bounds(fitted: tuple[str, FitResult]) -> None:
    name, fit = fitted
    truth = practice_record(name)[1]["parameters"]
    error = fit.fit.values - [truth.get(label, 0.0) for label in fit.labels]  # sideslip has none
    assert fit.fit.converged
    assert len(fit.labels) == 6
    assert np.all(np.abs(error) < fit.bounds.half_width())


@pytest.mark.sample(1)
def test_the_residual_is_the_noise_floor_in_fit_and_holdout(fitted: tuple[str, FitResult]) -> None:
    result = estimate_contents(fitted[1])
    assert result.fit is not None
    assert result.holdout is not None
    assert result.noise_floor_K is not None
    for left in (result.fit, result.holdout):
        assert abs(left.rmse_K - result.noise_floor_K) < 3.0 * result.noise_floor_K / np.sqrt(2.0 * left.n)


def test_residuals_are_of_the_declared_size_and_white(fitted: tuple[str, FitResult]) -> None:
    for sensor in estimate_contents(fitted[1]).statistics["sensors"].values():
        assert sensor["normalised_rms"] == pytest.approx(1.0, abs=3.0 / np.sqrt(2.0 * sensor["n"]))
        assert sensor["whiteness"]["p_value"] > 1e-3
