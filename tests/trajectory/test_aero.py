"""Aerodynamic tables agree with the data book, trim the vehicle, and are refused by name where damaged."""

from __future__ import annotations

import math
import shutil
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim_heating.base.errors import InputError
from sim_heating.trajectory.aero import Aero, load_aero
from sim_heating.trajectory.jsbsim.host import open_vehicle
from tests.support.paths import ORBITER
from tests.support.verification.trim import PUBLISHED_TRIM

approx = pytest.approx


@pytest.fixture(scope="module")
def orbiter() -> Aero:
    return load_aero(ORBITER)


# Aerodynamics and trim


def test_lift_and_drag_are_those_of_the_data_book_at_mach_10_and_40_deg(orbiter: Aero) -> None:
    lift, drag, _ = orbiter.coefficients(10.0, 40.0)
    a = math.radians(40.0)  # data book: CN 1.205, CA 0.0608
    assert lift == approx(1.205 * math.cos(a) - 0.0608 * math.sin(a))
    assert drag == approx(1.205 * math.sin(a) + 0.0608 * math.cos(a))


def test_flown_and_predicted_body_flap_both_trim_near_zero_elevon(orbiter: Aero) -> None:
    # NASA CP-2283 (Griffith et al.): 14-16 deg flown, 7-8 deg predicted, at a centre of gravity of 66.7 %.
    assert abs(orbiter.with_changes(cm_shift=True).trim_elevon_deg(15.0, 40.0, 16.0)) < 1.0
    assert abs(orbiter.trim_elevon_deg(15.0, 40.0, 7.0)) < 1.0


@given(mach=st.floats(2.0, 28.0), alpha=st.floats(10.0, 45.0), flap=st.floats(-11.7, 22.5), cg=st.floats(0.66, 0.675))
def test_nothing_pitches_in_trim(orbiter: Aero, mach: float, alpha: float, flap: float, cg: float) -> None:
    aero = orbiter.with_changes(cg_fraction=cg)
    elevon = aero.trim_elevon_deg(mach, alpha, flap)
    low, high = aero.file.elevon.range_deg
    moment = aero.coefficients(mach, alpha, elevon, flap)[2]
    assert moment == approx(0.0, abs=1e-12) or (elevon == low and moment < 0.0) or (elevon == high and moment > 0.0)


def test_a_centre_of_gravity_further_aft_pitches_up_by_normal_force_times_arm(orbiter: Aero) -> None:
    aft = orbiter.with_changes(cg_fraction=0.672)
    CN, _, _ = orbiter.body_coefficients(8.0, 35.0)
    arm = 0.005 * 32.77362 / 12.05992
    assert aft.coefficients(8.0, 35.0)[2] - orbiter.coefficients(8.0, 35.0)[2] == approx(CN * arm, rel=1e-12)


def test_flight_found_moment_comes_in_from_mach_5_to_12(orbiter: Aero) -> None:
    shifted = orbiter.with_changes(cm_shift=True)
    gain = [shifted.coefficients(m, 30.0)[2] - orbiter.coefficients(m, 30.0)[2] for m in (4.0, 5.0, 8.5, 12.0, 25.0)]
    assert gain == approx([0.0, 0.0, 0.015, 0.03, 0.03])


def test_body_flap_schedule_keeps_the_elevon_where_it_is_scheduled(orbiter: Aero) -> None:
    aero = orbiter.with_changes(cm_shift=True)
    schedule = aero.bodyflap_schedule([(12.0, 40.0), (6.0, 27.0)])
    assert all(
        aero.trim_elevon_deg(m, np.interp(m, [6, 12], [27, 40]), flap) == approx(1.0)
        for m, flap in schedule
        if -11.7 < flap < 22.5
    )


# A damaged vehicle


def damaged(tmp_path: Path, name: str, old: str, new: str) -> Path:
    """A copy of the Orbiter's aerodynamics in which a text is replaced."""
    shutil.copytree(ORBITER / "aero", tmp_path / "aero")
    file = tmp_path / "aero" / name
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, new, 1))
    return tmp_path


@pytest.mark.parametrize(
    ("name", "old", "new", "expected"),
    [
        ("longitudinal.csv", "\n5,25,", "\n5,20,", "longitudinal.csv, row 40: this point"),
        ("longitudinal.csv", "10,50,", "10,49,", "longitudinal.csv: Mach"),
        ("elevon.csv", "10,30,-20,", "10,30,-21,", "elevon.csv: Mach"),
        ("elevon.csv", "CN,CA,Cm", "CN,CA,Cmm", "there is no column `Cm`"),
        ("aero.toml", "area_m2 = 2", "area_m2 = -2", "area_m2"),
        ("aero.toml", "mass_kg = ", "mas_kg = ", "mass_kg"),
        ("aero.toml", '"bodyflap.csv"', '"missing.csv"', "missing.csv"),
    ],
)
def test_damaged_aerodynamics_are_refused_by_name(tmp_path: Path, name: str, old: str, new: str, expected: str) -> None:
    with pytest.raises(InputError) as refused:
        load_aero(damaged(tmp_path, name, old, new))
    assert expected in str(refused.value)


def test_a_centre_of_gravity_outside_the_allowed_range_is_refused(orbiter: Aero) -> None:
    with pytest.raises(InputError, match=r"0\.7 is outside 0\.65 to 0\.675"):
        orbiter.with_changes(cg_fraction=0.7)


def test_a_vehicle_without_attitude_control_is_refused(tmp_path: Path) -> None:
    shutil.copytree(ORBITER / "aero", tmp_path / "aero")
    with pytest.raises(InputError, match=r"attitude_control\.xml: not found"):
        open_vehicle(tmp_path)


@pytest.mark.parametrize(("cg", "shift", "flap"), PUBLISHED_TRIM)
def test_trim_has_the_source_s_points_every_5_deg(orbiter: Aero, cg: float, shift: float, flap: float) -> None:
    aero = orbiter.with_changes(cg_fraction=cg, cm_shift=shift)
    found = [aero.trim_elevon_deg(12.0, alpha, flap) for alpha in (30.0, 35.0, 40.0, 45.0)]
    # interpolated between 10 deg, those at 35 and 45 deg were up to 0.46 deg off
    assert found == approx(PUBLISHED_TRIM[cg, shift, flap], abs=0.06)
