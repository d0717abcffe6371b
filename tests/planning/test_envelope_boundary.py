"""Edges of an envelope from margins along an axis: straight lines with known answers."""

from __future__ import annotations

import numpy as np
import pytest

from sim_heating.planning.envelope.boundary import (
    AERODYNAMICS,
    END_OF_STUDY,
    NOT_FLOWN,
    allowed_interval,
    greatest_value,
    scan_axis,
)
from sim_heating.planning.envelope.case import Case
from sim_heating.planning.envelope.margins import EvaluatedCase, Margin

X = [-8.0, -4.0, 0.0, 4.0, 8.0]
HOT, COLD, SIGMA_K = 3.0, -5.0, 20.0
"""The pod reaches its limit at HOT [deg], the nose at COLD [deg]; both change by 10 K a degree."""


def flight(x: float, **other: float) -> EvaluatedCase:
    """A pod that is hotter at a higher angle of attack, a nose that is hotter at a lower one."""
    margins = {
        "POD surface": Margin("surface", "POD", 0.0, 0.0, 10.0 * (HOT - x), "K", SIGMA_K, {"popu": 5.0}),
        "NOSE surface": Margin("surface", "NOSE", 0.0, 0.0, 10.0 * (x - COLD), "K", SIGMA_K),
    }
    margins |= {n: Margin("table", "POD", 0.0, 0.0, m, "deg") for n, m in other.items()}
    return EvaluatedCase(Case(alpha_offset_deg=x), margins, cross_range_km=100.0 - x**2)


def test_the_envelope_ends_where_each_limit_is_met_and_names_it() -> None:
    interval = allowed_interval(scan_axis(X, [flight(x) for x in X]), start=0.0)
    assert interval.low is not None
    assert interval.high is not None
    assert (interval.low.limit, interval.high.limit) == ("NOSE surface", "POD surface")
    assert (interval.low.at, interval.high.at) == pytest.approx((COLD, HOT), abs=1e-9)


@pytest.mark.parametrize("z", [1.0, -1.0])
def test_the_band_of_an_edge_is_sigma_over_the_slope_of_the_margin(z: float) -> None:
    interval = allowed_interval(scan_axis(X, [flight(x) for x in X], z), start=0.0)
    assert interval.low is not None
    assert interval.high is not None
    assert interval.high.at == pytest.approx(HOT - z * SIGMA_K / 10.0, abs=1e-9)
    assert interval.low.at == pytest.approx(COLD + z * SIGMA_K / 10.0, abs=1e-9)


def test_manoeuvre_narrows_only_the_limit_that_it_gives_evidence_on() -> None:
    interval = allowed_interval(scan_axis(X, [flight(x) for x in X], 1.0, "popu"), start=0.0)
    assert interval.low is not None
    assert interval.high is not None
    assert interval.high.at == pytest.approx(HOT - 0.5, abs=1e-9)
    assert interval.low.at == pytest.approx(COLD + 2.0, abs=1e-9)


def test_limit_that_closes_the_envelope_is_named() -> None:
    interval = allowed_interval(scan_axis(X, [flight(x) for x in X], 4.5), start=0.0)
    assert interval.low is None
    assert interval.width == 0.0
    assert interval.least_violated is not None
    assert interval.least_violated.at == pytest.approx(0.5 * (HOT + COLD), abs=0.05)


def test_outside_a_table_nothing_is_allowed_however_cool() -> None:
    flights = [flight(x, **{"POD ratio table, alpha_deg below 0": x + 2.0}) for x in X]
    interval = allowed_interval(scan_axis(X, flights), start=0.0)
    assert interval.low is not None
    assert interval.low.at == pytest.approx(-2.0, abs=1e-9)
    assert interval.low.limit == "POD ratio table, alpha_deg below 0"


def test_next_to_a_flight_that_failed_nothing_is_allowed() -> None:
    flights = [EvaluatedCase(Case(alpha_offset_deg=x), {}, error="fell") if x == -4.0 else flight(x) for x in X]
    interval = allowed_interval(scan_axis(X, flights), start=0.0)
    assert interval.low is not None
    assert (interval.low.at, interval.low.limit) == (0.0, NOT_FLOWN)


def test_an_edge_beyond_the_values_of_the_study_has_no_limit() -> None:
    x = [-4.0, 0.0, 2.0]
    interval = allowed_interval(scan_axis(x, [flight(v) for v in x]), start=0.0)
    assert interval.low is not None
    assert interval.high is not None
    assert (interval.low.limit, interval.high.limit) == (END_OF_STUDY, END_OF_STUDY)


def test_of_two_allowed_intervals_the_one_about_the_base_entry_counts() -> None:
    def ripple(x: float) -> EvaluatedCase:
        margin = Margin("surface", "POD", 0.0, 0.0, 10.0 * np.cos(np.pi * x / 4.0), "K")
        return EvaluatedCase(Case(alpha_offset_deg=x), {"POD surface": margin})

    x = np.linspace(-8.0, 8.0, 65)
    flights = [ripple(v) for v in x]
    for inside, middle in ((0.0, 0.0), (7.0, 7.0)):
        interval = allowed_interval(scan_axis(x, flights), inside)
        assert interval.low is not None
        assert interval.high is not None
        assert 0.5 * (interval.low.at + interval.high.at) == pytest.approx(middle, abs=0.02)


def test_greatest_value_is_bounded_by_aerodynamics_or_the_next_limit() -> None:
    flights = [flight(x) for x in X]
    values = [f.cross_range_km for f in flights]
    free = greatest_value(scan_axis(X, flights), X, values)
    assert free is not None
    assert (free.at, free.limit) == (pytest.approx(0.0, abs=0.05), AERODYNAMICS)
    rising = greatest_value(scan_axis(X, flights), X, [x + 10.0 for x in X])
    assert rising is not None
    assert (rising.value, rising.limit) == (pytest.approx(10.0 + HOT, abs=0.05), "POD surface")
    assert greatest_value(scan_axis(X, flights, 4.5), X, values) is None
