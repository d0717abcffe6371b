"""The curve of last resort: its values, its band, and what a search may do with it."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.interpolate import CubicHermiteSpline

from sim_heating.base.errors import InputError
from sim_heating.closure.search.trials.candidates import candidates
from sim_heating.heating.effects import EffectUse, use
from sim_heating.heating.effects.curve import KNOTS, VALUES, VARIABLES, curve_band
from sim_heating.inputs.points import conditions_of_record
from tests.support.walls import flight, practice_record

HEIGHTS = (0.1, -0.2, 0.05, 0.3, 0.25, 0.0, -0.1)
COVARIANCE = 0.01 * np.exp(-0.5 * np.subtract.outer(np.arange(KNOTS), np.arange(KNOTS)) ** 2)


def curve(variable: str = "alpha_deg", low: float = 30.0, high: float = 45.0) -> EffectUse:
    number = float(VARIABLES.index(variable))
    return use("curve", {"variable": number, "low": low, "high": high} | dict(zip(VALUES, HEIGHTS, strict=True)))


def expected(v: np.ndarray, low: float = 30.0, high: float = 45.0) -> np.ndarray:
    """The spline by scipy: Hermite's, with the slopes of parabolas, level at both ends and constant outside."""
    knots = np.linspace(low, high, KNOTS)
    slopes = np.gradient(HEIGHTS, knots)
    slopes[[0, -1]] = 0.0
    return CubicHermiteSpline(knots, HEIGHTS, slopes)(np.clip(v, low, high))


def factor(used: EffectUse, wall_K: float = 300.0, **conditions: float) -> float:
    lane = flight([conditions.pop("time_s", 0.0)], **conditions)[0, 0]
    return used.effect.kernel(np.concatenate([lane, used.values]), 0, len(lane), wall_K)


def test_a_curve_is_the_cubic_spline_through_its_values_and_constant_outside():
    alpha = np.linspace(25.0, 50.0, 101)
    found = [factor(curve(), alpha_deg=float(a)) for a in alpha]
    np.testing.assert_allclose(found, 1.0 + expected(alpha), rtol=1e-13)


@given(
    st.floats(-0.02, 0.02),
    st.floats(-2e-3, 2e-3),
    st.floats(-2e-4, 2e-4),
    st.lists(st.floats(30.0, 45.0), min_size=1, max_size=5),
)
def test_an_added_curve_contains_every_parabola(constant, slope, bend, alpha):
    def parabola(v: np.ndarray) -> np.ndarray:
        return constant + slope * (v - 40.0) + bend * (v - 40.0) ** 2

    heights = parabola(np.linspace(30.0, 45.0, KNOTS))
    used = use("added-curve", {"low": 30.0, "high": 45.0} | dict(zip(VALUES, heights.tolist(), strict=True)))
    found = [factor(used, alpha_deg=a) for a in alpha]
    np.testing.assert_allclose(found, parabola(np.array(alpha)), atol=1e-12)


@pytest.mark.parametrize("variable", VARIABLES)
def test_a_curve_follows_the_variable_of_its_number(variable):
    at = {variable: 38.0}
    found = factor(curve(variable), **at) if variable != "wall_K" else factor(curve(variable), 38.0)
    assert found == pytest.approx(1.0 + float(expected(np.array(38.0))), rel=1e-13)


@pytest.mark.thorough
def test_the_band_is_the_spread_of_curves_drawn_with_the_covariance():
    alpha = np.linspace(28.0, 47.0, 20)
    band = curve_band(curve().values, COVARIANCE, alpha)
    drawn = np.random.default_rng(4).multivariate_normal(HEIGHTS, COVARIANCE, 4000)
    curves = [curve_band((0.0, 30.0, 45.0, *s), np.zeros((KNOTS, KNOTS)), alpha).value for s in drawn]
    np.testing.assert_allclose(band.value, expected(alpha), atol=1e-13)
    np.testing.assert_allclose(band.sigma, np.std(curves, axis=0), rtol=0.06)
    assert (band.variable, band.unit) == ("alpha_deg", "deg")


def test_at_its_knots_a_band_is_values_and_sigmas_as_estimated():
    band = curve_band(curve().values, COVARIANCE)
    assert band.at.tolist() == np.linspace(30.0, 45.0, KNOTS).tolist()
    np.testing.assert_allclose(band.value, HEIGHTS, atol=1e-15)
    np.testing.assert_allclose(band.sigma, np.sqrt(np.diag(COVARIANCE)), rtol=1e-12)


def test_a_covariance_of_another_shape_is_refused():
    with pytest.raises(InputError, match=r"a covariance of shape \(2, 2\); it takes 10 values"):
        curve_band(curve().values, np.eye(2))


def test_curves_are_candidates_of_last_resort_only_and_time_is_the_last():
    record, _ = practice_record("p06")
    flown = conditions_of_record(record)
    assert "curve" not in {c.name for c in candidates(record, flown)}
    tried = candidates(record, flown, last_resort=True)
    numbers = [c.uses[0].values[0] for c in tried if c.name == "curve"]
    assert {c.name for c in tried} == {"curve", "added-curve"}
    assert numbers == sorted(numbers)
    assert VARIABLES[int(numbers[0])] == "alpha_deg"
    assert VARIABLES[int(numbers[-1])] == "time_s"
    assert candidates(record, flown, ["curve", "added-curve"], last_resort=True) == []
