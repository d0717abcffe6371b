"""Noise of the conditions as white noise of the heating: its size, its spectrum, and what it does to an estimate."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from sim_heating.closure.search.search import search_effects
from sim_heating.closure.search.trials.trial_fit import base_trial, declared_fit
from sim_heating.estimation.fit import FitResult, estimate, rms_normalised_residual
from sim_heating.estimation.inference.conditions_noise import conditions_noise
from sim_heating.estimation.inference.model_error import HeatingNoise
from sim_heating.inputs.record import FlightNoise, Record, load_record
from tests.support.paths import PRACTICE, RECORDS

ALPHA_DEG = 0.5
NAMES = ["ratio.scale", "ratio.d_alpha"]


def noisy(record: Record, seed: int = 3) -> Record:
    """The record with noise in the angle of attack that it states; the readings are those of the flight without."""
    rng, flown = np.random.default_rng(seed), record.conditions
    alpha = flown["alpha_deg"] + rng.normal(0.0, ALPHA_DEG, len(flown.time_s))
    return replace(record, conditions=flown.with_columns(alpha_deg=alpha))


def stating(record: Record, **changes: object) -> Record:
    conditions = record.declared.conditions.model_copy(update=changes)
    return replace(record, declared=record.declared.model_copy(update={"conditions": conditions}))


@cache
def fits() -> tuple[FitResult, FitResult]:
    """Without and with the noise stated."""
    record = noisy(load_record(PRACTICE / "p06"))
    return estimate(record, NAMES), estimate(stating(record, noise=FlightNoise(alpha_deg=ALPHA_DEG)), NAMES)


def test_noise_at_knots_has_the_spectrum_of_the_rows() -> None:
    t = np.arange(0.0, 400.1, 1.0)
    relative = 0.02 * (1.0 + t / 400.0)
    noise = HeatingNoise(t, relative)
    for spacing_s in (1.0, 4.0, 20.0):
        knots = np.arange(0.0, 400.1, spacing_s)
        load = np.sum((noise.at_knots(knots) * spacing_s)[1:-1] ** 2)
        rows = np.sum((relative * noise.share_s)[1:-1] ** 2)
        assert load == pytest.approx(rows, rel=2.0 * spacing_s / 400.0)


def test_columns_of_a_measured_flight_tell_their_own_noise() -> None:
    smooth = load_record(RECORDS / "sts96_597")
    assert smooth.declared.measured
    assert conditions_noise(smooth) is None
    found = conditions_noise(noisy(smooth))
    assert found is not None
    assert found.alpha_deg == pytest.approx(ALPHA_DEG, rel=0.1)
    assert found.density_relative == 0.0


def test_a_generated_flight_has_only_the_noise_that_it_states() -> None:
    record = load_record(PRACTICE / "p06")
    assert conditions_noise(noisy(record)) is None
    stated = FlightNoise(density_relative=0.02, velocity_relative=0.001)
    assert conditions_noise(stating(record, noise=stated)) == stated


@pytest.mark.thorough
def test_stated_noise_explains_what_noise_of_the_sensors_does_not() -> None:
    without, stated = fits()
    before, after = (rms_normalised_residual(f.samples()) for f in (without, stated))
    assert before > 1.05
    assert abs(after - 1.0) < abs(before - 1.0)
    assert stated.fit.log_likelihood > without.fit.log_likelihood + 10.0
    assert stated.fit.converged


@pytest.mark.thorough
def test_stated_noise_of_the_conditions_is_no_missing_cause() -> None:
    record = noisy(load_record(PRACTICE / "p06"))
    found = search_effects(stating(record, noise=FlightNoise(alpha_deg=ALPHA_DEG)))
    assert found.conclusion.finding == "none"
    assert found.none.excess_chi2 < base_trial(declared_fit(record)).excess_chi2


@pytest.mark.thorough
def test_bounds_with_stated_noise_are_wider_than_those_of_readings_alone() -> None:
    without, stated = fits()
    white = np.sqrt(np.diag(stated.bounds.white))
    assert np.all(white > np.sqrt(np.diag(without.bounds.white)))
    exact = estimate(load_record(PRACTICE / "p06"), NAMES)
    assert np.all(np.abs(stated.fit.values - exact.fit.values) < 4.0 * stated.bounds.sigma)
