"""Flight conditions checked against themselves: what is put into them is found where it is, and nothing else."""

from __future__ import annotations

import numpy as np
import pytest

from sim_heating.base.conditions import Conditions
from sim_heating.closure.clues.flight_consistency import Discrepancy, flight_discrepancies
from sim_heating.closure.search.changes.flight_changes import DENSITY_LAYER, VELOCITY_DRIFT
from sim_heating.inputs.record import load_record
from tests.support.paths import PRACTICE, RECORDS
from tests.support.walls import practice_record

CLEAN = practice_record("p06")[0]
FLIGHTS = [PRACTICE / f"p{k:02d}" for k in range(1, 11)] + [RECORDS / "sts96_468"]


def by_relation(conditions: Conditions) -> dict[str, Discrepancy]:
    """The clearest discrepancy of each relation."""
    return {d.relation: d for d in reversed(flight_discrepancies(conditions))}


def recorded(conditions: Conditions) -> Conditions:
    """Conditions as trackers measure them: 3 m/s, 30 m and 0.2 deg of noise."""
    rng = np.random.default_rng(1)
    sizes = {"velocity_m_s": 3.0, "altitude_m": 30.0, "alpha_deg": 0.2}
    return conditions.with_columns(
        **{name: conditions[name] + rng.normal(0.0, sigma, len(conditions)) for name, sigma in sizes.items()}
    )


@pytest.mark.parametrize("directory", FLIGHTS, ids=lambda d: d.name)
def test_no_shipped_flight_contradicts_itself(directory):
    assert flight_discrepancies(load_record(directory).conditions) == []


def test_noise_and_coarse_words_of_a_recorder_are_no_contradiction():
    c = CLEAN.conditions
    words = {"velocity_m_s": 30.0, "altitude_m": 100.0}
    coarse = c.with_columns(**{name: step * np.round(c[name] / step) for name, step in words.items()})
    assert flight_discrepancies(recorded(c)) == []
    assert flight_discrepancies(coarse) == []


def test_shears_of_the_atmosphere_along_the_whole_flight_are_no_contradiction():
    c, rng = CLEAN.conditions, np.random.default_rng(2)
    kernel = np.exp(-0.5 * (np.arange(-90, 91) / 30.0) ** 2)
    shear = np.convolve(rng.normal(size=len(c) + 180), kernel / np.sqrt(np.sum(kernel**2)), mode="valid")
    factor = np.exp(0.03 * shear)
    sheared = c.with_columns(rho_kg_m3=c["rho_kg_m3"] * factor, p_inf_Pa=c["p_inf_Pa"] * factor)
    sheared = sheared.with_columns(log10_re=c["log10_re"] + np.log10(factor))
    assert flight_discrepancies(sheared) == []


def test_a_layer_of_wrong_density_shows_in_drag_and_in_the_weight_of_the_air():
    found = by_relation(DENSITY_LAYER.between(62e3, 67e3).apply(CLEAN, 0.85).conditions)
    assert set(found) == {"drag", "hydrostatics"}
    drag = found["drag"]
    assert (drag.lowest_m, drag.highest_m) == (pytest.approx(62e3, abs=500.0), pytest.approx(67e3, abs=500.0))
    assert drag.size == pytest.approx(1.0 / 0.85 - 1.0, abs=0.02)
    assert drag.message == (
        "deceleration over dynamic pressure is 18 % above the rest of the flight from "
        f"{drag.begin_s:.0f} to {drag.end_s:.0f} s, 62.0 to 67.0 km ({drag.sigmas:.0f} sigma)"
    )


def test_a_density_that_is_changed_alone_is_that_of_no_gas():
    c = CLEAN.conditions
    layer = (c["altitude_m"] > 62e3) & (c["altitude_m"] < 67e3)
    found = by_relation(c.with_columns(rho_kg_m3=np.where(layer, 0.85, 1.0) * c["rho_kg_m3"]))
    assert {"gas", "Mach number", "Reynolds number", "drag"} <= set(found)
    assert found["gas"].size == pytest.approx(-0.15, abs=0.005)


@pytest.mark.parametrize("measured", [lambda c: c, recorded], ids=["exact", "recorded"])
def test_a_velocity_that_falls_against_all_drag_is_found_when_it_falls(measured):
    drag = by_relation(measured(VELOCITY_DRIFT.between(500.0, 600.0).apply(CLEAN, 0.95).conditions))["drag"]
    assert (drag.begin_s, drag.end_s) == (pytest.approx(500.0, abs=10.0), pytest.approx(600.0, abs=10.0))
    assert drag.size > 0.5


def test_an_altitude_apart_from_the_path_angle():
    c = load_record(RECORDS / "sts96_468").conditions
    part = (c.time_s > 600.0) & (c.time_s < 700.0)
    path = [
        d
        for d in flight_discrepancies(c.with_columns(altitude_m=c["altitude_m"] + 1500.0 * part))
        if d.relation == "path"
    ]
    assert [round(0.5 * (d.begin_s + d.end_s), -1) for d in sorted(path, key=lambda d: d.begin_s)] == [600.0, 700.0]


def test_axial_acceleration_apart_from_dynamic_pressure():
    c = load_record(RECORDS / "sts96_468").conditions
    part = (c.time_s > 800.0) & (c.time_s < 850.0)
    axial = by_relation(c.with_columns(axial_accel_g=c["axial_accel_g"] * np.where(part, 0.8, 1.0)))["axial force"]
    assert (axial.begin_s, axial.end_s) == (pytest.approx(800.0, abs=3.0), pytest.approx(850.0, abs=3.0))
    assert axial.size == pytest.approx(-0.2, abs=0.01)


def test_a_ground_test_has_no_flight_to_check():
    assert flight_discrepancies(load_record(RECORDS / "kaowool_board").conditions) == []
