"""Clocks: an unstated skew of the thermocouple is read as coating, and can be estimated itself."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from benchmarks.skew import COATING, NAMES, both_estimated, curve, fitted_factor
from sim_heating.base.parameters import CLOCK_SKEW
from sim_heating.estimation.fit import estimate
from sim_heating.estimation.starts import profile_start
from tests.support.tile import NOISE_8_BIT, Tile, record

BOUND = 3.0
"""Standard deviations."""


def off(fit, name: str, truth: float) -> float:
    """Error of an estimate over its bound."""
    k = fit.labels.index(name)
    return abs(fit.fit.values[k] - truth) / fit.bounds.sigma[k]


@pytest.mark.thorough
def test_lead_thins_the_coating_that_is_found_and_lag_thickens_it():
    lead, none, lag = (fitted_factor(Tile(skew_s=s))[0] for s in (-1.0, 0.0, 1.0))
    assert lead < 0.7 < none < 1.3 < lag
    assert none == pytest.approx(1.0, abs=1e-3)  # the truth is on a finer mesh than the fit


@pytest.mark.thorough
def test_lead_without_coating_grows_with_thickness_and_falls_when_hot():
    zero = {(mil, K): curve(Tile(mil, K)).zero_s for mil, K in ((10.0, 1300.0), (20.0, 1300.0), (10.0, 1100.0))}
    assert zero[10.0, 1300.0] < 0.6 * zero[20.0, 1300.0]
    assert zero[10.0, 1300.0] < 0.8 * zero[10.0, 1100.0]
    assert 1.0 < zero[10.0, 1300.0] < 1.5  # the paper: negative by a lead of one second


def test_lead_beyond_the_bound_is_reported_as_a_clock_error():
    fit = estimate([record(Tile(10.0, 1300.0, skew_s=-2.0, noise_K=1.0))], NAMES)
    assert any("is on its bound" in line for line in fit.warnings)
    assert any("estimate clock.skew as well" in line for line in fit.warnings)


@pytest.mark.thorough
def test_skew_and_coating_together_are_within_their_bounds_and_correlated():
    fit = both_estimated()
    assert off(fit, CLOCK_SKEW.name, 0.3) < BOUND
    assert off(fit, COATING, 1.0) < BOUND
    assert off(fit, "ratio.d_alpha", 0.001) < BOUND
    i, j = fit.labels.index(COATING), fit.labels.index(CLOCK_SKEW.name)
    assert -1.0 < fit.correlation[i, j] < -0.85


@pytest.mark.parametrize("stated", [True, False], ids=["stated", "unstated"])
def test_unknown_sample_time_within_the_interval_is_a_skew(stated):
    true = record(replace(NOISE_8_BIT, offset_s=0.4))
    time_s = true.time_s if stated else true.time_s - 0.4
    given = replace(true, thermocouples={**true.thermocouples, "time_s": time_s})
    fit = estimate([given], ("ratio.d0", "ratio.d_alpha", CLOCK_SKEW.name))
    skew = 0.0 if stated else -0.4  # what is read at t was measured 0.4 s later: the thermocouple leads
    assert off(fit, CLOCK_SKEW.name, skew) < BOUND
    assert fit.bounds.sigma[fit.labels.index(CLOCK_SKEW.name)] < 0.2
    assert off(fit, "ratio.d_alpha", 0.001) < BOUND


@pytest.mark.thorough
def test_start_at_a_later_time_can_be_fitted_with_a_clock_alone():
    start = partial(profile_start, time_s=270.0)
    fit = estimate([record(replace(NOISE_8_BIT, skew_s=0.3))], (CLOCK_SKEW.name,), starts=[start])
    assert np.all(np.isfinite(fit.bounds.sigma))
