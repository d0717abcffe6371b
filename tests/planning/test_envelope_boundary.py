"""Edges of an envelope from margins along an axis: known lines, known answers."""

from __future__ import annotations

import numpy as np
import pytest

from sim_heating.planning.envelope.boundary import AERODYNAMICS, END_OF_STUDY, NOT_FLOWN, allowed, greatest, scan
from sim_heating.planning.envelope.case import Case
from sim_heating.planning.envelope.margins import Evaluated, Margin

X = [-8.0, -4.0, 0.0, 4.0, 8.0]
HOT, COLD, SIGMA_K = 3.0, -5.0, 20.0
"""The pod is at its limit at HOT, the nose at COLD; both by 10 K a degree."""


def flight(x: float, **other: float) -> Evaluated:
    """A pod that is hotter at a higher angle of attack, a nose that is hotter at a lower one."""
    margins = {
        "POD surface": Margin("surface", "POD", 0.0, 0.0, 10.0 * (HOT - x), "K", SIGMA_K, {"popu": 5.0}),
        "NOSE surface": Margin("surface", "NOSE", 0.0, 0.0, 10.0 * (x - COLD), "K", SIGMA_K),
    }
    margins |= {n: Margin("table", "POD", 0.0, 0.0, m, "deg") for n, m in other.items()}
    return Evaluated(Case(alpha_offset_deg=x), margins, cross_range_km=100.0 - x**2)


def test_the_envelope_ends_where_each_limit_is_met_and_names_it() -> None:
    found = allowed(scan(X, [flight(x) for x in X]), inside=0.0)
    assert found.low is not None
    assert found.high is not None
    assert (found.low.limit, found.high.limit) == ("NOSE surface", "POD surface")
    assert (found.low.at, found.high.at) == pytest.approx((COLD, HOT), abs=1e-9)


@pytest.mark.parametrize("z", [1.0, -1.0])
def test_the_band_of_an_edge_is_sigma_over_the_slope_of_the_margin(z: float) -> None:
    found = allowed(scan(X, [flight(x) for x in X], z), inside=0.0)
    assert found.low is not None
    assert found.high is not None
    assert found.high.at == pytest.approx(HOT - z * SIGMA_K / 10.0, abs=1e-9)
    assert found.low.at == pytest.approx(COLD + z * SIGMA_K / 10.0, abs=1e-9)


def test_a_manoeuvre_shrinks_the_band_of_the_limit_that_it_tells_of_alone() -> None:
    found = allowed(scan(X, [flight(x) for x in X], 1.0, "popu"), inside=0.0)
    assert found.low is not None
    assert found.high is not None
    assert found.high.at == pytest.approx(HOT - 0.5, abs=1e-9)
    assert found.low.at == pytest.approx(COLD + 2.0, abs=1e-9)


def test_where_nothing_is_allowed_the_limit_that_closes_it_is_named() -> None:
    found = allowed(scan(X, [flight(x) for x in X], 4.5), inside=0.0)
    assert found.low is None
    assert found.width == 0.0
    assert found.least_bad is not None
    assert found.least_bad.at == pytest.approx(0.5 * (HOT + COLD), abs=0.05)


def test_outside_a_table_nothing_is_allowed_however_cool() -> None:
    flights = [flight(x, **{"POD ratio table, alpha_deg below 0": x + 2.0}) for x in X]
    found = allowed(scan(X, flights), inside=0.0)
    assert found.low is not None
    assert found.low.at == pytest.approx(-2.0, abs=1e-9)
    assert found.low.limit == "POD ratio table, alpha_deg below 0"


def test_next_to_a_flight_that_failed_nothing_is_allowed() -> None:
    flights = [Evaluated(Case(alpha_offset_deg=x), {}, error="fell") if x == -4.0 else flight(x) for x in X]
    found = allowed(scan(X, flights), inside=0.0)
    assert found.low is not None
    assert (found.low.at, found.low.limit) == (0.0, NOT_FLOWN)


def test_an_edge_that_the_study_does_not_reach_is_said_to_be_none() -> None:
    x = [-4.0, 0.0, 2.0]
    found = allowed(scan(x, [flight(v) for v in x]), inside=0.0)
    assert found.low is not None
    assert found.high is not None
    assert (found.low.limit, found.high.limit) == (END_OF_STUDY, END_OF_STUDY)


def test_of_two_intervals_the_one_about_the_base_entry_is_meant() -> None:
    def ripple(x: float) -> Evaluated:
        margin = Margin("surface", "POD", 0.0, 0.0, 10.0 * np.cos(np.pi * x / 4.0), "K")
        return Evaluated(Case(alpha_offset_deg=x), {"POD surface": margin})

    x = np.linspace(-8.0, 8.0, 65)
    flights = [ripple(v) for v in x]
    for inside, middle in ((0.0, 0.0), (7.0, 7.0)):
        found = allowed(scan(x, flights), inside)
        assert found.low is not None
        assert found.high is not None
        assert 0.5 * (found.low.at + found.high.at) == pytest.approx(middle, abs=0.02)


def test_the_greatest_value_is_held_back_by_aerodynamics_or_by_the_limit_beside_it() -> None:
    flights = [flight(x) for x in X]
    values = [f.cross_range_km for f in flights]
    free = greatest(scan(X, flights), X, values)
    assert free is not None
    assert (free.at, free.limit) == (pytest.approx(0.0, abs=0.05), AERODYNAMICS)
    rising = greatest(scan(X, flights), X, [x + 10.0 for x in X])
    assert rising is not None
    assert (rising.value, rising.limit) == (pytest.approx(10.0 + HOT, abs=0.05), "POD surface")
    assert greatest(scan(X, flights, 4.5), X, values) is None
