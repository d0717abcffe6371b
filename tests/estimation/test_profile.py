"""Interval of a parameter by the profile of the likelihood: a parabola, a bound, an onset that is reported or not."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from sim_heating.base.errors import InputError
from sim_heating.estimation.filter.process_noise import ProcessNoise
from sim_heating.estimation.fit import FitResult, estimate
from sim_heating.heating.effects import use
from sim_heating.inputs.record import load_record
from tests.support.missing import record_with
from tests.support.paths import PRACTICE

SCALE = "ratio.scale"
ONSET, SLOPE = (f"effect.impingement-onset.{n}" for n in ("alpha_onset_deg", "slope"))
LARGEST_DEG = 60.0
NAMES = [SCALE, *(f"ratio.d_{v}" for v in ("alpha", "logre", "elevon", "bodyflap"))]


@cache
def fitted() -> FitResult:
    return estimate(load_record(PRACTICE / "p06"), NAMES, profiles=[SCALE])


def test_the_interval_of_a_parabola_is_that_of_sigma() -> None:
    found = fitted().profiles[SCALE]
    value, sigma = fitted().parameters[SCALE]
    assert (found.lower_open, found.upper_open) == (False, False)
    np.testing.assert_allclose([found.lower, found.upper], [value - 1.96 * sigma, value + 1.96 * sigma], rtol=0.05)
    assert found.gain == pytest.approx(0.0, abs=1e-3)
    near = np.abs(found.values - value) < 3.0 * sigma
    parabola = ((found.values[near] - value) / sigma) ** 2
    np.testing.assert_allclose(found.deviance[near], parabola, atol=0.3)


def test_an_interval_that_reaches_a_bound_ends_there_and_is_open() -> None:
    value, sigma = fitted().parameters[SCALE]
    bound = value - 0.5 * sigma
    fit = estimate(load_record(PRACTICE / "p06"), NAMES, bounds={SCALE: (bound, 1.0)})
    found = fit.profile(SCALE)
    assert (found.lower, found.lower_open) == (pytest.approx(bound), True)
    assert found.upper == pytest.approx(value + 1.96 * sigma, abs=0.3 * sigma)
    assert f"its bound {bound:.5g} to" in found.in_words()
    assert found.as_json()["lower_open"] is True


@pytest.mark.thorough
def test_an_onset_that_was_flown_has_an_interval_that_holds_it() -> None:
    record, _ = record_with([use("impingement-onset", {"alpha_onset_deg": 41.0, "slope": 0.002})], 5)
    fit = estimate(record, [SCALE, ONSET, SLOPE], profiles=[ONSET])
    found = fit.profiles[ONSET]
    assert fit.fit.converged
    assert found.lower < 41.0 < found.upper
    assert found.upper - found.lower < 1.0
    assert (found.lower_open, found.upper_open) == (False, False)


@pytest.mark.thorough
def test_an_onset_beyond_the_angles_flown_has_no_upper_end() -> None:
    priors = {ONSET: (45.0, np.inf)}
    fit = estimate(load_record(PRACTICE / "p06"), [SCALE, ONSET], priors=priors, fixed={SLOPE: 0.002}, profiles=[ONSET])
    found = fit.profiles[ONSET]
    assert (found.upper, found.upper_open) == (LARGEST_DEG, True)
    assert not found.lower_open
    assert found.lower > 35.0


def test_a_profile_is_of_an_estimated_parameter_without_process_noise() -> None:
    record = load_record(PRACTICE / "p06")
    with pytest.raises(InputError, match=r"`ratio.d_beta`: is not estimated"):
        fitted().profile("ratio.d_beta")
    with pytest.raises(InputError, match="without process noise"):
        estimate(record, [SCALE], profiles=[SCALE], process_noise=ProcessNoise(node_K_sqrt_s=0.1))
