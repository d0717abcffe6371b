"""The region of measured data: what a data set covers, and distances beyond it."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from sim_heating.credibility.evidence import case_as_json, case_from_json, shipped_evidence
from sim_heating.credibility.validation.own_cases import case_of_record
from sim_heating.credibility.validation.region import FLIGHT, GROUND, Samples, extrapolation
from sim_heating.simulation.predict import Prediction


def flight(mach, alpha_deg, log10_re, wall_K) -> Samples:
    values = {"mach": mach, "alpha_deg": alpha_deg, "log10_re": log10_re, "wall_K": wall_K}
    arrays = {n: np.atleast_1d(np.asarray(v, dtype=float)) for n, v in values.items()}
    return Samples(FLIGHT, arrays, np.ones(len(arrays["mach"])))


def test_a_data_set_lies_within_the_region_that_it_makes(tile: Prediction):
    case = case_from_json(case_as_json(case_of_record(tile.record, tile.residual_K)))
    t, wall = tile.record.time_s, tile.record.temperatures_K()[0]
    read = np.isfinite(wall) & (t <= tile.record.conditions.time_s[-1])
    flown = tile.record.conditions.at(t[read])
    found = extrapolation([flight(flown["mach"], flown["alpha_deg"], flown["log10_re"], wall[read])], [case])
    assert found.inside == 1.0
    assert found.outside == {}


def test_an_angle_of_attack_that_was_never_flown_at_that_speed_is_an_extrapolation_by_its_difference():
    """STS-96 flew 40 deg at Mach 22; at Mach 3 it flew 10 to 20 deg, which is no evidence for Mach 22."""
    cases = shipped_evidence().cases
    band = next(b for b in cases[0].bands if b.limits["mach"][0] <= 22.0 <= b.limits["mach"][1])
    middle = {n: 0.5 * sum(ends) for n, ends in band.limits.items()}
    found = extrapolation([flight(22.0, 25.0, middle["log10_re"], middle["wall_K"])], cases)
    assert found.inside == 0.0
    below, above, share = found.outside["alpha_deg"]
    assert below == pytest.approx(max(b.limits["alpha_deg"][0] for b in [band]) - 25.0, abs=0.5)
    assert (above, share) == (0.0, 1.0)


def test_a_mach_number_outside_by_less_than_the_last_digit_of_the_region_is_within_it():
    """Above Mach 10 the ends of a range are stated to 0.01: 0.004 beyond is no extrapolation, 0.02 is."""
    cases = shipped_evidence().cases[:1]
    fastest = max((b for b in cases[0].bands), key=lambda b: b.limits["mach"][1])
    middle = {n: 0.5 * sum(ends) for n, ends in fastest.limits.items()}
    mach = fastest.limits["mach"][1]
    within, beyond = (
        extrapolation([flight(mach + d, middle["alpha_deg"], middle["log10_re"], middle["wall_K"])], cases)
        for d in (0.004, 0.02)
    )
    assert (within.inside, within.outside) == (1.0, {})
    assert beyond.outside["mach"][1] == pytest.approx(0.02)
    assert "Mach 0.02 above" in beyond.words


def test_neighbouring_ranges_of_mach_numbers_leave_no_gap():
    bands = shipped_evidence().cases[0].bands
    ends = sorted(b.limits["mach"] for b in bands)
    assert all(high >= low for (_, high), (low, _) in pairwise(ends))


def test_time_counts_and_not_the_number_of_samples():
    band = shipped_evidence().cases[0].bands[0]
    middle = {n: 0.5 * sum(ends) for n, ends in band.limits.items()}
    samples = flight(*([middle[n], middle[n]] for n in ("mach", "alpha_deg", "log10_re")), [middle["wall_K"], 5000.0])
    found = extrapolation([replace(samples, duration_s=np.array([9.0, 1.0]))], shipped_evidence().cases)
    assert found.inside == pytest.approx(0.9)
    assert found.outside["wall_K"][2] == pytest.approx(0.1)


def test_a_hotter_lamp_test_lies_beyond_by_its_temperature():
    board = next(c for c in shipped_evidence().cases if c.kind == GROUND)
    hottest = board.bands[0].limits["wall_K"][1]
    lamp = Samples(GROUND, {"wall_K": np.array([300.0, hottest + 120.0])}, np.ones(2))
    found = extrapolation([lamp], shipped_evidence().cases)
    assert found.outside["wall_K"][:2] == pytest.approx((0.0, 120.0))
    assert "wall temperature 120 K above" in found.words


def test_without_a_data_set_of_its_kind_nothing_is_validated():
    found = extrapolation([flight(20.0, 40.0, 6.0, 1000.0)], [])
    assert (found.inside, found.share_by_case, found.error) == (0.0, {}, None)
