"""Parameters that age: a walk from flight to flight, against the joint least-squares problem that it is."""

from __future__ import annotations

import tomllib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim_heating.base.files import LocatedError
from sim_heating.campaign.ageing import next_flight_settings, walk, walks_of_fits
from sim_heating.campaign.spec import CampaignFile
from sim_heating.inputs.fit_settings import FitSettings

EMITTANCE = "stack.emissivity_factor"
ESTIMATE = st.tuples(st.floats(0.5, 1.5), st.floats(1e-3, 0.2))


def least_squares(measured: list[tuple[float, float]], sigma_per_flight: float) -> tuple[np.ndarray, np.ndarray]:
    """Values and covariance of all flights at once: readings, and differences that are 0 to the walk's sigma."""
    n = len(measured)
    rows = [np.eye(n)[k] / s for k, (_, s) in enumerate(measured)]
    rows += [(np.eye(n)[k + 1] - np.eye(n)[k]) / sigma_per_flight for k in range(n - 1)]
    G = np.array(rows)
    d = np.array([y / s for y, s in measured] + [0.0] * (n - 1))
    P = np.linalg.inv(G.T @ G)
    return P @ G.T @ d, P


@given(st.lists(ESTIMATE, min_size=1, max_size=6), st.floats(1e-2, 0.3))
def test_the_last_flight_is_known_as_by_least_squares(measured, sigma_per_flight):
    known, p_value = walk(measured, sigma_per_flight)
    values, P = least_squares(measured, sigma_per_flight)
    assert known[-1] == pytest.approx((values[-1], np.sqrt(P[-1, -1])), rel=1e-6)
    assert (p_value is None) == (len(measured) == 1)


def test_p_values_of_parameters_that_walk_so_are_uniform():
    rng = np.random.default_rng(7)
    steps = rng.normal(0.0, 0.02, (2000, 6)).cumsum(axis=1) + rng.normal(0.0, 0.05, (2000, 6))
    p_values = np.array([walk([(y, 0.05) for y in row], 0.02)[1] for row in steps])
    shares = np.histogram(p_values, bins=5, range=(0.0, 1.0))[0] / len(p_values)
    np.testing.assert_allclose(shares, 0.2, atol=0.035)


def row(flight: str, value: float, sigma: float) -> dict:
    parameters = {EMITTANCE: {"value": value, "sigma": sigma, "unit": "-"}}
    return {"control_point": "V09T9527", "flights": [flight], "parameters": parameters}


def test_the_next_flight_has_the_last_value_and_one_more_step():
    rows = [row("STS-2", 1.0, 0.02), row("STS-2", 1.02, 0.02), row("STS-4", 1.1, 0.01)]
    (emittance,) = walks_of_fits(rows, {EMITTANCE: 0.03}, ["STS-2", "STS-3", "STS-4"])
    assert emittance.flights == ("STS-2", "STS-4")
    assert emittance.measured[0] == pytest.approx((1.01, 0.02 / np.sqrt(2.0)))
    value, sigma = emittance.known[-1]
    assert emittance.next_value == value
    assert emittance.next_sigma == pytest.approx(np.hypot(sigma, 0.03))


def test_what_is_known_of_the_next_flight_is_a_file_of_settings(tmp_path):
    walks = walks_of_fits([row("STS-2", 1.01, 0.02)], {EMITTANCE: 0.03}, ["STS-2"])
    settings = FitSettings(**tomllib.loads(next_flight_settings(walks)))
    assert settings.priors == {f"{EMITTANCE}@V09T9527": pytest.approx((1.01, np.hypot(0.02, 0.03)))}


@pytest.mark.parametrize(
    ("fit", "ageing", "reason"),
    [
        ({}, {EMITTANCE: 0.01}, "no fit estimates it"),
        ({"parameters": [EMITTANCE], "prior": {EMITTANCE: [1.0, 0.1]}}, {EMITTANCE: 0.01}, "has a value beforehand"),
        ({"parameters": [EMITTANCE]}, {EMITTANCE: -0.01}, "must be a standard deviation"),
    ],
)
def test_an_ageing_that_no_fit_could_show_is_refused(fit, ageing, reason):
    base = {"format": "campaign/1", "title": "t", "vehicle": "orbiter", "flight": [{"records": "a"}]}
    with pytest.raises((ValueError, LocatedError), match=reason):
        CampaignFile(**base, fit=fit, ageing=ageing)
