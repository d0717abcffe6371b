"""The built-in 3-DOF entry: conserved quantities, closed-form entries, published flights, and the 6-DOF flight."""

from __future__ import annotations

import math
import os
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sim_heating.base.conditions import EXTRAS, FRAME, SURFACES
from sim_heating.base.errors import InputError, RunError
from sim_heating.heating.atmosphere import G0_M_S2, us76
from sim_heating.inputs.vehicle import load_vehicle
from sim_heating.trajectory import entry3dof, recorded
from sim_heating.trajectory import guidance as gd
from sim_heating.trajectory import point_mass as pm
from sim_heating.trajectory.aero import flown_aero, load_aero
from sim_heating.trajectory.entry3dof import Entry
from sim_heating.trajectory.flight import ROW, Sampler
from sim_heating.trajectory.guidance import EntryGuidance, Observation, resolve_guidance
from sim_heating.trajectory.jsbsim import entry as jsbsim
from sim_heating.trajectory.spec import GuidanceChanges, TrajectorySpec
from sim_heating.trajectory.trimmed_aero import aero_block, trimmed_kernel
from tests.support.paths import ORBITER, ROOT
from tests.support.verification.trajectories import (
    SCALE_M,
    STS107,
    VACUUM,
    allen_eggers_speed,
    ballistic_entry,
    glide,
    orbit_integrals,
    spec,
    vacuum_orbit,
)

VEHICLE = load_vehicle(ORBITER)
AERO = load_aero(ORBITER)


def crossing(c, speed, name):
    """Value of a column where the speed falls through a value, after the pull-out."""
    k = int(np.flatnonzero((c["velocity_m_s"] < speed) & (c.time_s > 250.0))[0])
    share = (c["velocity_m_s"][k - 1] - speed) / (c["velocity_m_s"][k - 1] - c["velocity_m_s"][k])
    return c[name][k - 1] + share * (c[name][k] - c[name][k - 1])


@pytest.fixture(scope="module")
def nominal():
    """The whole flight of the fitted STS-107 state to landing speed."""
    return entry3dof.fly(spec(), VEHICLE)


# ---- conserved quantities and order -------------------------------------------------------------------------------


def test_an_orbit_without_air_keeps_its_energy_and_axial_angular_momentum():
    first, last = vacuum_orbit(rate_hz=1.0, seconds=5400.0)
    energy, momentum = np.array(orbit_integrals(last)) / np.array(orbit_integrals(first)) - 1.0
    assert abs(energy) < 1e-11
    assert abs(momentum) < 1e-11
    assert np.linalg.norm(last[pm.X : pm.VX] - first[pm.X : pm.VX]) > 1e5  # it did move


def test_the_step_converges_with_the_fourth_power_of_its_length():
    reference = vacuum_orbit(4.0, 1600.0)[1][pm.X : pm.VX]
    error = [np.linalg.norm(vacuum_orbit(1.0 / dt, 1600.0)[1][pm.X : pm.VX] - reference) for dt in (32.0, 16.0, 8.0)]
    assert np.log2(np.array(error[:-1]) / error[1:]) == pytest.approx([4.0, 4.0], abs=0.1)


@settings(max_examples=200, deadline=None)
@given(st.floats(-90.0, 90.0), st.floats(-180.0, 180.0), st.floats(-5000.0, 200000.0))
def test_geodetic_position_comes_back_from_cartesian(latitude, longitude, altitude):
    flight = np.zeros(pm.DENSITY)
    flight[[pm.RADIUS, pm.FLATTENING]] = pm.WGS84_RADIUS_M, pm.WGS84_FLATTENING
    initial = np.array([altitude, 0.0, 0.0, 0.0, latitude, longitude])
    x, y, z = pm.position_kernel(initial, flight)
    found, up = pm.geodetic(x, y, z, pm.WGS84_RADIUS_M, pm.WGS84_FLATTENING)
    assert found == pytest.approx(altitude, abs=1e-6)
    assert up[2] == pytest.approx(math.sin(math.radians(latitude)), abs=1e-12)


# ---- closed-form entries -------------------------------------------------------------------------------------------


def test_a_ballistic_entry_slows_down_as_allen_and_eggers_derived():
    rows = ballistic_entry(20.0)
    high = rows[:, 1] > 2000.0
    assert rows[high, 2] == pytest.approx(allen_eggers_speed(rows[high, 1]), rel=1e-5)


def test_peak_deceleration_of_a_ballistic_entry_is_at_the_entry_speed_over_the_root_of_e():
    rows = ballistic_entry(50.0)
    drag = rows[:, ROW.index("axial_accel_g")] * G0_M_S2
    peak = int(np.argmax(drag))
    assert drag[peak] == pytest.approx(7000.0**2 / (2.0 * math.e * SCALE_M), rel=1e-4)
    assert rows[peak, 2] == pytest.approx(7000.0 * math.exp(-0.5), rel=0.01)  # a flat maximum, frames 60 m/s apart


def test_an_equilibrium_glide_has_the_range_of_saenger():
    """R = r/2 (L/D) ln((1 - V2^2/vc^2) / (1 - V1^2/vc^2)) at full lift over a sphere at rest, height counted in V^2."""
    (flown,) = glide()
    assert flown.got == pytest.approx(flown.expected, rel=0.01)


# ---- aerodynamics, atmosphere, winds -------------------------------------------------------------------------------


@pytest.mark.thorough
@settings(max_examples=60, deadline=None)
@given(st.floats(1.5, 27.0), st.floats(0.0, 50.0), st.floats(-11.7, 22.5), st.floats(0.65, 0.675), st.booleans())
def test_the_compiled_trim_is_that_of_the_tables(mach, alpha, flap, cg, shift):
    s = spec(vehicle={"cg_fraction": cg, "cm_shift": shift})
    aero = flown_aero(s, ORBITER)
    flight = entry3dof.flight_block(s, aero, resolve_guidance(s.guidance, ORBITER))
    cn, ca, elevon = trimmed_kernel(mach, alpha, flap, 0.0, flight, aero_block(aero, np.zeros((0, 5))))
    assert elevon == pytest.approx(aero.trim_elevon_deg(mach, alpha, flap), abs=1e-9)
    assert (cn, ca) == pytest.approx(aero.body_coefficients(mach, alpha, elevon, flap)[:2], abs=1e-12)


def first_row(**changes):
    """The first frame of a flight."""
    return dict(zip(ROW, Entry(spec(**changes), ORBITER).run(1)[0][0], strict=True))


def test_a_density_factor_scales_density_and_drag_alike():
    plain, dense = first_row(), first_row(dispersions={"density_factor": [[0.0, 1.0], [100e3, 1.2], [130e3, 1.2]]})
    assert dense["rho_kg_m3"] / plain["rho_kg_m3"] == pytest.approx(1.2, rel=1e-12)
    assert dense["axial_accel_g"] / plain["axial_accel_g"] == pytest.approx(1.2, rel=1e-12)


def test_a_tailwind_is_taken_off_the_speed_through_the_air():
    """Without air to act, the path over ground is the same and the speeds differ by the wind as a vector."""
    level = {"altitude_m": 1e5, "velocity_m_s": 7000.0, "gamma_deg": 0.0, "heading_deg": 90.0, "latitude_deg": 0.0}
    below = {"wind_east_m_s": [[89e3, 80.0], [90e3, 0.0]], "wind_north_m_s": [[89e3, 60.0], [90e3, 0.0]]}
    still = Entry(spec(initial=level, dispersions=VACUUM), ORBITER).run(2000)[0]
    windy = Entry(spec(initial=level, dispersions=VACUUM | below), ORBITER).run(2000)[0]
    assert windy[:, 1] == pytest.approx(still[:, 1], abs=1e-6)
    low, speed, gamma, heading = still[:, 1] < 89e3, *(still[:, i] for i in (2, 10, 11))
    across, along = np.cos(np.radians(heading)), np.sin(np.radians(heading))
    flat = speed * np.cos(np.radians(gamma))
    expected = np.sqrt((flat * along - 80.0) ** 2 + (flat * across - 60.0) ** 2 + (speed**2 - flat**2))
    assert np.count_nonzero(low) > 100
    assert windy[low, 2] == pytest.approx(expected[low], rel=1e-9)
    assert windy[still[:, 1] > 90e3, 2] == pytest.approx(speed[still[:, 1] > 90e3], rel=1e-9)


def test_initial_velocity_is_relative_to_the_air_whatever_the_wind():
    row = first_row(dispersions={"wind_east_m_s": [[0.0, 90.0]], "wind_north_m_s": [[0.0, -40.0]]})
    assert (row["velocity_m_s"], row["gamma_deg"], row["heading_deg"]) == pytest.approx((7486.0, -1.15, 63.7))


# ---- a flight ------------------------------------------------------------------------------------------------------


def test_the_coast_of_sts_107_is_reproduced_over_the_rotating_earth(nominal):
    """Rows EI+223 and EI+298 s of the STS-107 ground track; path angle is fitted, position and speed are not."""
    track = {223.0: (88066.0, 36.40, -150.85, 7519.0), 298.0: (79211.0, 37.64, -144.80, 7492.0)}
    for time, (altitude, latitude, longitude, speed) in track.items():
        c = nominal.conditions.at(time)
        assert c["altitude_m"][0] == pytest.approx(altitude, abs=1200.0)
        assert c["latitude_deg"][0] == pytest.approx(latitude, abs=0.25)
        assert c["longitude_deg"][0] == pytest.approx(longitude, abs=0.25)
        assert c["velocity_m_s"][0] == pytest.approx(speed, abs=15.0)


def test_a_shuttle_entry_keeps_the_time_of_the_measured_ones(nominal):
    """EI+601 s: 6901 m/s (STS-107). True Mach 8 about 20 min after EI, landing at about EI+1950 s (STS-96 record)."""
    c = nominal.conditions
    assert c.at(601.0)["velocity_m_s"][0] == pytest.approx(6901.0, abs=200.0)
    mach8 = c.time_s[np.flatnonzero((c["mach"] < 8.0) & (c["altitude_m"] < 80e3))[0]]
    assert 1200.0 < mach8 < 1320.0
    assert 1850.0 < c.time_s[-1] < 2050.0
    assert c["velocity_m_s"][-1] < 130.0
    assert c["altitude_m"][-1] < 100.0


def test_drag_follows_its_reference_once_it_is_tracked(nominal):
    c = nominal.conditions
    block = gd.guidance_block(resolve_guidance(GuidanceChanges(), ORBITER))
    mass, area = 105600.0, AERO.file.reference.area_m2
    for speed in (6300.0, 6000.0, 4700.0, 4200.0):  # away from reversals
        alpha, mach = crossing(c, speed, "alpha_deg"), crossing(c, speed, "mach")
        cd = AERO.coefficients(mach, alpha, crossing(c, speed, "elevon_deg"), crossing(c, speed, "bodyflap_deg"))[1]
        drag = crossing(c, speed, "qbar_Pa") * area * cd / mass
        assert drag == pytest.approx(gd.scheduled(block, gd.DRAG_SCHEDULE, speed), rel=0.08)


def test_bank_and_angle_of_attack_never_move_faster_than_their_limits():
    rows = []
    entry3dof.fly(spec(rate_hz=10.0), VEHICLE, on_frame=lambda row: rows.append(row.copy()))
    alpha = np.array(rows)[:, FRAME.index("alpha_deg")]
    assert np.abs(np.diff(alpha)).max() <= 2.0 / 10.0 + 1e-9
    c = entry3dof.fly(spec(sample_s=0.25), VEHICLE).conditions
    assert np.abs(np.diff(c["bank_deg"])).max() <= 5.0 * 0.25 + 1e-9


def test_bank_reverses_at_the_declared_velocities(nominal):
    c = nominal.conditions
    for speed in (5700.0, 3900.0, 2600.0):
        k = int(np.flatnonzero(c["velocity_m_s"] < speed)[0])
        assert c["bank_deg"][k - 5] * c["bank_deg"][k + 40] < 0.0
    assert next(text for _, text in nominal.events if "reversal" in text) == "bank reversal to the left"


def test_with_a_target_bank_turns_the_vehicle_towards_it():
    target = {"target": {"latitude_deg": 28.6, "longitude_deg": -80.7, "deadband_deg": 10.0}}
    c = entry3dof.fly(spec(guidance=target), VEHICLE).conditions
    lat, lon = np.radians(c["latitude_deg"]), np.radians(c["longitude_deg"])
    there, east = math.radians(28.6), np.radians(-80.7) - lon
    away = np.arccos(np.sin(lat) * math.sin(there) + np.cos(lat) * math.cos(there) * np.cos(east)) * 6371.0
    azimuth = np.degrees(
        np.arctan2(
            np.sin(east) * math.cos(there), np.cos(lat) * math.sin(there) - np.sin(lat) * math.cos(there) * np.cos(east)
        )
    )
    error = np.abs((c["heading_deg"] - azimuth + 180.0) % 360.0 - 180.0)
    guided = (c.time_s > 600.0) & (away > 800.0)
    assert error[guided].max() < 25.0
    assert away.min() < 300.0


def test_a_popu_in_flight_starts_at_20000_ft_s_and_moves_nothing_else():
    popu = {"kind": "popu", "at_velocity_m_s": 6096.0, "rate_deg_s": 1.0, "hold_s": 3.0}
    flight = entry3dof.fly(spec(manoeuvre=[popu], rate_hz=10.0, sample_s=0.1), VEHICLE)
    c, window = flight.conditions, flight.windows[0]
    assert np.interp(window.start_s, c.time_s, c["velocity_m_s"]) == pytest.approx(6096.0, abs=0.02)
    inside = (c.time_s > window.start_s) & (c.time_s < window.end_s)
    assert (c["alpha_deg"][inside].min(), c["alpha_deg"][inside].max()) == (pytest.approx(35.0), pytest.approx(45.0))
    assert np.abs(np.diff(c["alpha_deg"][inside])).max() == pytest.approx(0.1, rel=1e-6)
    assert window.end_s - window.start_s == pytest.approx(26.0)
    assert np.ptp(c["bodyflap_deg"][inside]) < 1e-9
    assert 2.0 < np.ptp(c["elevon_deg"][inside]) < 12.0  # alpha and trimmed elevon move together


def test_control_pulses_show_in_the_columns_and_stay_in_travel():
    manoeuvre = [
        {"kind": "elevon-pulse", "at_velocity_m_s": 6400.0, "amplitude_deg": 30.0},
        {"kind": "bodyflap-pulse", "at_velocity_m_s": 6000.0, "amplitude_deg": -6.0},
        {"kind": "sideslip-doublet", "at_velocity_m_s": 5000.0},
        {"kind": "jet-firing", "at_velocity_m_s": 4500.0},
    ]
    flight = entry3dof.fly(spec(manoeuvre=manoeuvre, stop={"mach": 10.0}), VEHICLE)
    c = flight.conditions
    assert [w.kind for w in flight.windows] == [m["kind"] for m in manoeuvre]
    assert c["elevon_deg"].max() == AERO.file.elevon.range_deg[1]
    assert (c["beta_deg"].max(), c["beta_deg"].min(), c["jets"].max()) == (2.0, -2.0, 1.0)
    w = flight.windows[1]
    during, before = c.at((w.start_s + w.end_s) / 2.0), c.at(w.start_s - 1.0)
    assert during["bodyflap_deg"][0] - before["bodyflap_deg"][0] == pytest.approx(-6.0, abs=0.2)
    assert during["elevon_deg"][0] - before["elevon_deg"][0] > 1.0  # the elevon takes up the moment


def test_the_flight_stops_at_the_first_limit_it_passes():
    for stop, name, value in (
        ({"mach": 12.0}, "mach", 12.0),
        ({"velocity_m_s": 5000.0}, "velocity_m_s", 5000.0),
        ({"altitude_m": 60e3}, "altitude_m", 60e3),
        ({"time_s": 333.0}, "time_s", 333.0),
    ):
        last = entry3dof.fly(spec(stop=stop, rate_hz=10.0, sample_s=0.1), VEHICLE).conditions[name][-1]
        assert last == pytest.approx(value, rel=2e-3)


@pytest.mark.thorough
def test_the_step_does_not_matter(nominal):
    fine = entry3dof.fly(spec(rate_hz=20.0), VEHICLE).conditions
    for speed in (7000.0, 5000.0, 3000.0, 1000.0):
        assert crossing(fine, speed, "altitude_m") == pytest.approx(
            crossing(nominal.conditions, speed, "altitude_m"), abs=60.0
        )


@pytest.mark.thorough
def test_the_point_mass_agrees_with_six_degrees_of_freedom():
    """Same guidance, tables and start; own kernel against JSBSim: altitude within 100 m at every speed, time 1 s."""
    stop = {"mach": 2.5}
    three = entry3dof.fly(spec(stop=stop), VEHICLE).conditions
    six = jsbsim.fly(spec(source="jsbsim", stop=stop), VEHICLE).conditions
    tolerance = {"altitude_m": 100.0, "time_s": 1.0, "alpha_deg": 0.2, "latitude_deg": 0.05, "longitude_deg": 0.05}
    for speed in np.arange(7400.0, 800.0, -200.0):
        for name, allowed in tolerance.items():
            assert crossing(six, speed, name) == pytest.approx(crossing(three, speed, name), abs=allowed), name


def test_a_flight_that_skips_out_is_an_error_and_not_a_number():
    fast = STS107 | {"velocity_m_s": 8600.0}
    with pytest.raises(RunError, match="outside the atmosphere"):
        entry3dof.fly(spec(initial=fast), VEHICLE)


@pytest.mark.thorough
def test_interpreted_and_compiled_flights_are_the_same_bits():
    """The kernel is its own slow reference: 40 s of flight without numba's compiler."""
    program = (
        "import json; import tests.trajectory.test_entry as t;"
        "rows, _ = t.Entry(t.spec(manoeuvre=[{'kind': 'popu', 'at_time_s': 5.0}]), t.ORBITER).run(160);"
        "print(json.dumps(rows[-1].tolist()))"
    )
    answers = [
        subprocess.run(
            [sys.executable, "-c", program], env=os.environ | {"NUMBA_DISABLE_JIT": off, "PYTHONPATH": str(ROOT)},
            cwd=ROOT, capture_output=True, text=True, check=True,
        ).stdout
        for off in ("0", "1")
    ]  # fmt: skip
    assert answers[0] == answers[1]


# ---- guidance for a host -------------------------------------------------------------------------------------------


SEEN = st.builds(
    Observation,
    time_s=st.just(0.0), altitude_m=st.floats(-100.0, 130e3), velocity_m_s=st.floats(1.0, 8000.0),
    mach=st.floats(0.0, 30.0), altitude_rate_m_s=st.floats(-500.0, 500.0), drag_m_s2=st.floats(0.0, 40.0),
    lift_m_s2=st.floats(-5.0, 40.0), net_gravity_m_s2=st.floats(-1.0, 9.8), qbar_Pa=st.floats(0.0, 5e4),
    alpha_deg=st.floats(-5.0, 60.0), heading_deg=st.floats(-180.0, 180.0), latitude_deg=st.floats(-90.0, 90.0),
    longitude_deg=st.floats(-180.0, 180.0),
)  # fmt: skip


@pytest.mark.thorough
@settings(max_examples=100, deadline=None)
@given(st.lists(SEEN, min_size=2, max_size=12), st.floats(0.01, 2.0))
def test_commands_stay_within_limits_and_rates_whatever_a_host_reports(seen, dt_s):
    guidance = EntryGuidance(resolve_guidance(GuidanceChanges(), ORBITER))
    commands = np.array([guidance.command(s._replace(time_s=i * dt_s)) for i, s in enumerate(seen)])
    assert np.all(np.isfinite(commands))
    assert np.all((commands[:, 0] >= 0.0) & (commands[:, 0] <= 50.0))
    assert np.all(np.abs(commands[:, 1]) <= 110.0)
    assert np.all(np.abs(np.diff(commands, axis=0)) <= np.array([2.0, 5.0]) * dt_s + 1e-9)


def test_a_vehicle_without_guidance_names_the_keys_that_it_needs(tmp_path):
    with pytest.raises(InputError, match="alpha_deg and drag_m_s2"):
        resolve_guidance(GuidanceChanges(), tmp_path)


# ---- frames to conditions ------------------------------------------------------------------------------------------


def row_at(time_s, **values):
    """A frame at a time with some values given and the others plausible."""
    plain = dict.fromkeys(ROW, 0.0) | {"altitude_m": 60e3, "velocity_m_s": 5000.0, "rho_kg_m3": 3e-4}
    return np.array([(plain | values | {"time_s": time_s})[name] for name in ROW])


def test_samples_between_frames_are_linear_and_angles_go_the_short_way_round():
    sampler = Sampler(0.5, 32.77)
    for k in range(5):
        longitude = (179.4 + 0.3 * k + 180.0) % 360.0 - 180.0
        sampler.add(row_at(0.3 * k, velocity_m_s=5000.0 - 3.0 * k, longitude_deg=longitude))
    c = sampler.conditions()
    assert c.time_s.tolist() == [0.0, 0.5, 1.0]
    assert c["velocity_m_s"] == pytest.approx([5000.0, 4995.0, 4990.0])
    assert c["longitude_deg"] == pytest.approx([179.4, 179.9, 180.4])


def test_every_source_gives_the_contracts_columns(nominal):
    c = nominal.conditions
    assert {*EXTRAS, "jets", "qbar_Pa"} <= set(c.names)
    assert c["qbar_Pa"] == pytest.approx(0.5 * c["rho_kg_m3"] * c["velocity_m_s"] ** 2)


# ---- recorded ------------------------------------------------------------------------------------------------------


def write_columns(path, columns):
    """A CSV file of columns."""
    rows = zip(*columns.values(), strict=True)
    path.write_text(",".join(columns) + "\n" + "".join(",".join(map(repr, map(float, r))) + "\n" for r in rows))


RECORDED = (*recorded.REQUIRED, *SURFACES, "rho_kg_m3")
"""Columns that a recording of the Orbiter needs."""


def recorded_flight(path):
    """The flight of a recorded CSV."""
    return recorded.fly(TrajectorySpec(source="recorded", file=str(path)), VEHICLE)


def test_a_recorded_flight_comes_back_as_it_was_flown(nominal, tmp_path):
    c = nominal.conditions
    write_columns(tmp_path / "c.csv", {n: c[n] for n in RECORDED})
    back = recorded_flight(tmp_path / "c.csv").conditions
    for name in ("altitude_m", "mach", "log10_re", "T_inf_K", "p_inf_Pa", "qbar_Pa"):
        assert back[name] == pytest.approx(c[name], rel=1e-12)


def test_a_recording_without_density_has_that_of_the_standard_air_and_tells(nominal, tmp_path):
    write_columns(tmp_path / "c.csv", {n: nominal.conditions[n] for n in RECORDED if n != "rho_kg_m3"})
    with pytest.warns(UserWarning, match=r"c\.csv: rho_kg_m3 of the standard atmosphere at altitude_m"):
        back = recorded_flight(tmp_path / "c.csv").conditions
    T, p, rho = us76(back["altitude_m"])
    assert (back["rho_kg_m3"] == rho).all()
    assert back["T_inf_K"] == pytest.approx(T, rel=1e-12)
    assert back["p_inf_Pa"] == pytest.approx(p, rel=1e-12)
    a = np.sqrt(1.4 * p / rho)
    assert back["mach"] == pytest.approx(back["velocity_m_s"] / a, rel=1e-9)


@pytest.mark.parametrize(
    ("damage", "expected"),
    [
        (lambda c: c.update(time_s=c["time_s"][::-1]), "row 3, column time_s"),
        (lambda c: c.update(altitude_m=c["altitude_m"] * 3.2808), "row 2, column altitude_m"),
        (lambda c: c.update(rho_kg_m3=-c["rho_kg_m3"]), "is not a density"),
        (lambda c: c.update(T_inf_K=c["rho_kg_m3"] * 0.0 - 50.0), "Celsius"),
    ],
)
def test_a_damaged_recording_is_refused_with_file_row_and_column(nominal, tmp_path, damage, expected):
    columns = {n: nominal.conditions[n][:50] for n in RECORDED}
    damage(columns)
    write_columns(tmp_path / "c.csv", columns)
    with pytest.raises(InputError, match=r"c\.csv") as refused:
        recorded_flight(tmp_path / "c.csv")
    assert expected in refused.value.problems[0]


def test_a_flight_into_the_ground_is_an_error() -> None:
    dive = {**STS107, "altitude_m": 20e3, "velocity_m_s": 800.0, "gamma_deg": -85.0}
    with pytest.raises(RunError, match=r"is at -\d+ m with \d+ m/s, outside the atmosphere \(0 to"):
        entry3dof.fly(spec(initial=dive, stop={"time_s": 900.0}), VEHICLE)
