"""JSBSim flies the forces of the tables in the atmosphere of US76, as guidance and manoeuvres command."""

from __future__ import annotations

import math
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from jsbsim import get_default_root_dir

from sim_heating.base.conditions import FRAME
from sim_heating.base.errors import InputError, RunError
from sim_heating.heating.atmosphere import us76
from sim_heating.inputs.vehicle import load_vehicle
from sim_heating.simulation.plugin import HeatingPlugin
from sim_heating.simulation.plugin_jsbsim import JSBSimHeating
from sim_heating.trajectory import entry3dof
from sim_heating.trajectory.aero import Aero, load_aero
from sim_heating.trajectory.entry3dof import low_speed_rows
from sim_heating.trajectory.flight import Flight, Window
from sim_heating.trajectory.jsbsim import entry as jsbsim
from sim_heating.trajectory.jsbsim.host import FT_M, InitialState, JSBSimHost, PropertyRead, Read, open_vehicle
from sim_heating.trajectory.manoeuvres import polygon
from sim_heating.trajectory.spec import Dispersions, TrajectorySpec
from tests.support.paths import ORBITER

VEHICLE = load_vehicle(ORBITER)

approx = pytest.approx


ENTRY_INTERFACE = {
    "altitude_m": 122000.0, "velocity_m_s": 7250.0, "gamma_deg": -1.2, "heading_deg": 60.0, "latitude_deg": -10.0,
}  # fmt: skip
MANOEUVRES = [
    {"kind": "popu", "at_velocity_m_s": 6096.0, "rate_deg_s": 1.0},
    {"kind": "elevon-pulse", "at_velocity_m_s": 5300.0, "amplitude_deg": 4.0, "hold_s": 6.0},
    {"kind": "bodyflap-pulse", "at_velocity_m_s": 5000.0, "amplitude_deg": -6.0, "rate_deg_s": 1.5, "hold_s": 6.0},
    {"kind": "sideslip-doublet", "at_mach": 13.0, "amplitude_deg": 2.0, "hold_s": 6.0},
    {"kind": "jet-firing", "at_mach": 12.0, "on_s": 4.0},
    {"kind": "elevon-pulse", "at_mach": 9.5, "amplitude_deg": 2.0, "hold_s": 2.0, "alpha": "free"},
]


def entry(**changes: object) -> TrajectorySpec:
    """An entry from the entry interface to Mach 2.5, with the changes of a test."""
    table = {"source": "jsbsim", "initial": ENTRY_INTERFACE, "stop": {"mach": 2.5}, **changes}
    return TrajectorySpec.model_validate(table)


@pytest.fixture(scope="module")
def orbiter() -> Aero:
    return load_aero(ORBITER)


@pytest.fixture(scope="module")
def flight() -> Flight:
    return jsbsim.fly(entry(manoeuvre=MANOEUVRES), VEHICLE)


@pytest.fixture(scope="module")
def quiet_flight() -> Flight:
    return jsbsim.fly(entry(), VEHICLE)


def window(flight: Flight, kind: str, number: int = 0) -> Window:
    return [w for w in flight.windows if w.kind == kind][number]


def during(flight: Flight, w: Window, column: str) -> np.ndarray:
    time = flight.conditions.time_s
    return flight.conditions[column][(time >= w.start_s) & (time <= w.end_s)]


# The model in JSBSim


def placed(aero: Aero, mach: float, alpha_deg: float, elevon_deg: float, bodyflap_deg: float) -> JSBSimHost:
    """The Orbiter at 60 km, surfaces set directly, two frames after its start."""
    host = open_vehicle(ORBITER, aero)
    commands = {"alpha-cmd": alpha_deg, "bodyflap-cmd": bodyflap_deg, "elevon-direct": 1.0, "elevon-park": elevon_deg}
    commands |= {"elevon-direct-deg": elevon_deg} | {f"alpha-{lag}": alpha_deg for lag in ("lag1", "lag2", "ref")}
    for name, value in commands.items():
        host.node(f"control/{name}" + ("" if name.startswith("elevon-direct") else "-deg")).set_double_value(value)
    host.start(InitialState(60000.0, mach * 315.07, -0.5, 60.0, 10.0, alpha_deg=alpha_deg))
    for _ in range(2):
        host.step()
    return host


@pytest.mark.parametrize(
    "point",
    [
        (20.0, 40.0, 1.0, 15.0),
        (11.0, 36.5, -7.0, -8.0),
        (7.3, 31.2, 12.0, 3.0),
        (4.4, 21.0, -22.0, 20.0),
        (2.6, 15.5, 4.0, 0.0),
    ],
)
def test_forces_and_moment_in_jsbsim_are_those_of_the_tables(orbiter: Aero, point: tuple[float, ...]) -> None:
    aero = orbiter.with_changes(cm_shift=True, cg_fraction=0.67)
    fdm = placed(aero, *point).fdm
    mach, alpha = fdm["velocities/mach"], fdm["aero/alpha-deg"]
    CL, CD, Cm = aero.coefficients(mach, alpha, fdm["fcs/elevon-pos-deg"], fdm["fcs/bodyflap-pos-deg"])
    force = fdm["aero/qbar-psf"] * fdm["metrics/Sw-sqft"]
    damping = aero.file.damping.Cmq * fdm["velocities/q-aero-rad_sec"] * fdm["aero/ci2vel"]
    assert fdm["fcs/elevon-pos-deg"] == approx(point[2])
    assert fdm["forces/fwz-aero-lbs"] == approx(force * CL, rel=1e-9)
    assert fdm["forces/fwx-aero-lbs"] == approx(force * CD, rel=1e-9)
    assert fdm["moments/m-aero-lbsft"] == approx(force * fdm["metrics/cbarw-ft"] * (Cm + damping), rel=1e-7)


@pytest.mark.parametrize(("mach", "alpha"), [(0.5, 6.0), (1.3, 9.0)])
def test_below_mach_2_lift_and_drag_are_those_of_the_low_speed_polar(orbiter: Aero, mach: float, alpha: float) -> None:
    fdm = placed(orbiter, mach, alpha, -8.0, -5.0).fdm
    rows = low_speed_rows(ORBITER, 2.0).T
    CL_0, CL_alpha, CD_0, K = (np.interp(fdm["velocities/mach"], rows[0], column) for column in rows[1:])
    CL = CL_0 + CL_alpha * fdm["aero/alpha-deg"]
    force = fdm["aero/qbar-psf"] * fdm["metrics/Sw-sqft"]
    assert fdm["forces/fwz-aero-lbs"] / force == approx(CL, abs=0.001)
    assert fdm["forces/fwx-aero-lbs"] / force == approx(CD_0 + K * CL**2, abs=0.002)


def test_mass_inertia_and_area_in_jsbsim_are_those_of_the_scenario(orbiter: Aero) -> None:
    fdm = open_vehicle(ORBITER, orbiter.with_changes(mass_kg=100000.0)).fdm
    fdm.run_ic()
    assert fdm["inertia/mass-slugs"] * 14.59390294 == approx(100000.0, rel=1e-6)
    assert fdm["metrics/Sw-sqft"] * FT_M**2 == approx(249.9092, rel=1e-6)
    assert fdm["inertia/cg-x-in"] * 0.0254 == approx(0.667 * 32.77362, rel=1e-6)
    assert fdm["inertia/iyy-slugs_ft2"] * 1.3558179483 == approx(1.01212e7 * 100000.0 / 104916.0, rel=1e-6)


def test_loss_of_energy_is_the_work_of_drag(orbiter: Aero) -> None:
    host = placed(orbiter, 20.0, 40.0, 5.0, 0.0)
    host.node("control/elevon-direct").set_double_value(0.0)
    before, work, power = specific_energy(host), 0.0, drag_power(host)
    for _ in range(60 * 60):
        host.step()
        last, power = power, drag_power(host)
        work += 0.5 * (last + power) / host.rate_hz
    assert work > 5e5
    assert before - specific_energy(host) == approx(work, rel=2e-5)


def drag_power(host: JSBSimHost) -> float:
    fdm = host.fdm
    return fdm["forces/fwx-aero-lbs"] / fdm["inertia/mass-slugs"] * fdm["velocities/vt-fps"] * FT_M**2


def specific_energy(host: JSBSimHost) -> float:
    """Kinetic energy in the rotating frame plus WGS84 potential with J2 and the centrifugal part [J/kg]."""
    fdm = host.fdm
    r, lat = fdm["position/radius-to-vehicle-ft"] * FT_M, math.radians(fdm["position/lat-gc-deg"])
    mu, radius, j2, rotation = 3.986004418e14, 6378137.0, 1.08262982e-3, 7.292115e-5
    potential = -mu / r * (1.0 - j2 * (radius / r) ** 2 * (1.5 * math.sin(lat) ** 2 - 0.5))
    speed = fdm["velocities/vt-fps"] * FT_M
    return 0.5 * speed**2 + potential - 0.5 * (rotation * r * math.cos(lat)) ** 2


# Air and wind


@pytest.mark.thorough
def test_density_is_us76_from_122_km_down(quiet_flight: Flight) -> None:
    c = quiet_flight.conditions
    assert c["altitude_m"][0] == approx(122000.0)
    np.testing.assert_allclose(c["rho_kg_m3"], us76(c["altitude_m"])[2], rtol=1e-6)


def test_dispersed_density_is_flown_and_reported() -> None:
    thin = {"density_factor": [[0.0, 1.2], [60e3, 1.2], [100e3, 0.8]]}
    c = jsbsim.fly(entry(dispersions=thin, stop={"time_s": 260.0}), VEHICLE).conditions
    factor = np.interp(c["altitude_m"], [60e3, 100e3], [1.2, 0.8])
    np.testing.assert_allclose(c["rho_kg_m3"], factor * us76(c["altitude_m"])[2], rtol=1e-6)
    np.testing.assert_allclose(c["qbar_Pa"], 0.5 * c["rho_kg_m3"] * c["velocity_m_s"] ** 2)


def test_initial_speed_is_that_against_the_wind() -> None:
    spec = entry(dispersions={"wind_east_m_s": [[0.0, 80.0]], "wind_north_m_s": [[0.0, -40.0]]}, stop={"time_s": 1.0})
    seen: list[float] = []
    c = jsbsim.fly(spec, VEHICLE, on_frame=lambda row: seen.append(float(row[2]))).conditions
    assert seen[0] == approx(7250.0, abs=1e-6)
    assert (c["gamma_deg"][0], c["heading_deg"][0]) == approx((-1.2, 60.0), abs=1e-6)
    assert abs(c["beta_deg"][0]) < 1e-6


def test_a_tail_wind_adds_to_the_ground_speed() -> None:
    calm, windy = (
        jsbsim.JSBSimEntry(entry(initial={**ENTRY_INTERFACE, "heading_deg": 90.0}, dispersions=d), VEHICLE).host.fdm
        for d in ({}, {"wind_east_m_s": [[0.0, 80.0]]})
    )
    gain = (windy["velocities/v-east-fps"] - calm["velocities/v-east-fps"]) * FT_M
    assert gain == approx(80.0, abs=1e-6)


# The entry


@pytest.mark.thorough
def test_the_orbiter_is_captured_and_comes_down_to_mach_2_5(quiet_flight: Flight) -> None:
    c = quiet_flight.conditions
    assert c["mach"][-1] == approx(2.5, abs=0.02)
    assert 20e3 < c["altitude_m"][-1] < 30e3
    assert len(quiet_flight.windows) == 0


@pytest.mark.thorough
def test_angle_of_attack_follows_its_schedule(quiet_flight: Flight) -> None:
    c = quiet_flight.conditions
    mach = [2.5, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0, 11.0, 12.0]
    alpha = [15.0, 16.0, 19.0, 23.0, 27.0, 30.0, 34.0, 36.0, 38.0, 39.0, 40.0]
    flown = np.interp(np.where(c["altitude_m"] > 100e3, 25.0, c["mach"]), mach, alpha)
    assert np.max(np.abs(c["alpha_deg"] - flown)) < 0.5  # the schedule moves 0.15 deg/s at most, the lag is 1 s


@pytest.mark.thorough
def test_sideslip_stays_near_zero_through_bank_reversals(quiet_flight: Flight) -> None:
    c = quiet_flight.conditions
    assert np.max(np.abs(c["beta_deg"])) < 0.6
    assert np.count_nonzero(np.diff(np.sign(c["bank_deg"][400:]))) >= 3


@pytest.mark.thorough
def test_peak_heating_conditions_are_those_of_a_shuttle_entry(quiet_flight: Flight) -> None:
    c = quiet_flight.conditions
    # STS-107 (CAIB report): 70 km at 22,860 ft/s; 61 km at 18,000 ft/s, both as relative speed
    assert np.interp(6968.0, c["velocity_m_s"][:200:-1], c["altitude_m"][:200:-1]) == approx(70.2e3, abs=2e3)
    assert np.interp(5486.0, c["velocity_m_s"][:200:-1], c["altitude_m"][:200:-1]) == approx(61.2e3, abs=4e3)


def test_axial_acceleration_is_that_of_the_axial_force(flight: Flight, orbiter: Aero) -> None:
    c = flight.conditions.at(window(flight, "popu").start_s - 10.0)  # in the steady glide before it
    aero = orbiter.with_changes(cm_shift=True)
    _, CA, _ = aero.body_coefficients(c["mach"][0], c["alpha_deg"][0], c["elevon_deg"][0], c["bodyflap_deg"][0])
    wanted = CA * c["qbar_Pa"][0] * 249.9092 / (92079.0 * 9.80665)
    assert c["axial_accel_g"][0] == approx(wanted, rel=1e-4)


def test_the_same_flight_twice_is_the_same_to_the_last_bit() -> None:
    spec = entry(stop={"time_s": 120.0}, manoeuvre=[{"kind": "popu", "at_time_s": 30.0}])
    first, second = (jsbsim.fly(spec, VEHICLE).conditions for _ in range(2))
    assert all(np.array_equal(first[name], second[name]) for name in first.names)


@pytest.mark.thorough
def test_60_and_120_frames_a_second_fly_the_same_entry() -> None:
    spec = entry(stop={"velocity_m_s": 5900.0}, manoeuvre=MANOEUVRES[:1])
    slow = jsbsim.fly(spec, VEHICLE).conditions
    fast = jsbsim.fly(spec.model_copy(update={"rate_hz": 120.0}), VEHICLE).conditions
    seconds = np.arange(0.0, min(slow.time_s[-1], fast.time_s[-1]))
    slow, fast = slow.at(seconds), fast.at(seconds)
    largest = {name: np.max(np.abs(slow[name] - fast[name])) for name in slow.names}
    assert largest["altitude_m"] < 1.0  # measured 0.5 m, of 600 s of flight
    assert largest["velocity_m_s"] < 0.1  # measured 0.04 m/s
    assert largest["alpha_deg"] < 0.03  # measured 0.017 deg, in the pushover-pullup


@pytest.mark.thorough
def test_three_and_six_degrees_of_freedom_fly_the_same_entry(quiet_flight: Flight) -> None:
    six = quiet_flight.conditions
    three = entry3dof.fly(entry(source="entry-3dof", rate_hz=10.0), VEHICLE).conditions
    for velocity in (7000.0, 6000.0, 4000.0, 2000.0):
        a, b = (c.at(np.interp(-velocity, -c["velocity_m_s"][200:], c.time_s[200:])) for c in (six, three))
        assert a.time_s == approx(b.time_s, abs=3.0)  # measured 1.3 s
        assert a["altitude_m"] == approx(b["altitude_m"], abs=100.0)  # measured 50 m
        assert a["elevon_deg"] == approx(b["elevon_deg"], abs=0.1)  # measured 0.02 deg
        assert a["axial_accel_g"] == approx(b["axial_accel_g"], rel=0.02)


@pytest.mark.thorough
def test_the_orbiter_flies_on_to_the_ground() -> None:
    landed = jsbsim.fly(entry(stop={"altitude_m": 0.0}, rate_hz=20.0), VEHICLE)
    c = landed.conditions
    assert c["altitude_m"][-1] < 30.0
    assert 90.0 < c["velocity_m_s"][-1] < 140.0
    assert [text for _, text in landed.events][-2:] == ["approach", "flare"]


# Manoeuvres


def test_a_popu_is_followed_within_two_and_a_half_degrees(flight: Flight) -> None:
    w, c = window(flight, "popu"), flight.conditions
    assert c.at(w.start_s)["velocity_m_s"][0] == approx(6096.0, abs=1.0)
    time, offset = np.array(polygon(entry(manoeuvre=MANOEUVRES).manoeuvre[0])).T
    inside = (c.time_s >= w.start_s) & (c.time_s <= w.end_s + 5.0)
    wanted = 40.0 + np.interp(c.time_s[inside] - w.start_s, time, offset)
    assert np.max(np.abs(c["alpha_deg"][inside] - wanted)) < 2.5
    assert (c["alpha_deg"][inside].min(), c["alpha_deg"][inside].max()) == approx((35.0, 45.0), abs=0.3)


def test_the_trimmed_elevon_moves_against_alpha_in_a_popu(flight: Flight, orbiter: Aero) -> None:
    w, aero = window(flight, "popu"), orbiter.with_changes(cm_shift=True)
    c = flight.conditions.at(w.start_s + 15.0)  # in the steady pull-up
    trim = aero.trim_elevon_deg(c["mach"][0], c["alpha_deg"][0], c["bodyflap_deg"][0])
    assert c["elevon_deg"][0] == approx(trim, abs=0.5)


def test_the_elevon_follows_a_pulse_while_jets_hold_alpha(flight: Flight) -> None:
    w = window(flight, "elevon-pulse")
    middle = flight.conditions.at(np.arange(w.start_s + 1.0, w.end_s - 1.0, 0.5))
    before = flight.conditions.at(w.start_s - 2.0)["elevon_deg"][0]
    assert middle["elevon_deg"][2:-2] == approx(before + 4.0, abs=0.05)
    assert during(flight, w, "alpha_deg") == approx(40.0, abs=0.1)


def test_an_elevon_pulse_with_free_alpha_moves_alpha(flight: Flight) -> None:
    w = window(flight, "elevon-pulse", 1)
    c = flight.conditions.at([w.start_s, w.end_s])
    assert c["alpha_deg"][1] < c["alpha_deg"][0] - 0.3  # trailing edge down pitches down


def test_the_elevon_takes_up_the_moment_of_a_body_flap_pulse(flight: Flight, orbiter: Aero) -> None:
    w, aero = window(flight, "bodyflap-pulse"), orbiter.with_changes(cm_shift=True)
    c = flight.conditions.at(0.5 * (w.start_s + w.end_s))
    before = flight.conditions.at(w.start_s - 2.0)
    assert c["bodyflap_deg"] == approx(before["bodyflap_deg"] - 6.0, abs=0.05)
    assert c["elevon_deg"][0] == approx(aero.trim_elevon_deg(c["mach"][0], 40.0, c["bodyflap_deg"][0]), abs=0.2)
    assert c["alpha_deg"][0] == approx(40.0, abs=0.1)


def test_a_sideslip_doublet_shows_in_beta_and_leaves_alpha(flight: Flight) -> None:
    w = window(flight, "sideslip-doublet")
    beta = during(flight, w, "beta_deg")
    assert (beta.min(), beta.max()) == approx((-2.0, 2.0), abs=0.3)
    assert during(flight, w, "alpha_deg") == approx(40.0, abs=0.3)


def test_jets_fire_in_their_window_only(flight: Flight) -> None:
    w, c = window(flight, "jet-firing"), flight.conditions
    inside = (c.time_s > w.start_s + 0.5) & (c.time_s < w.start_s + 4.0)
    assert np.all(c["jets"][inside] == 1.0)
    assert np.all(c["jets"][(c.time_s < w.start_s) | (c.time_s > w.end_s + 0.2)] == 0.0)


def test_every_manoeuvre_is_an_event_and_a_window(flight: Flight) -> None:
    assert [w.kind for w in flight.windows] == [m["kind"] for m in MANOEUVRES]
    assert sum("popu" in text for _, text in flight.events) == 1


# The host


def test_each_frame_is_passed_on_once_and_in_order() -> None:
    rows: list[np.ndarray] = []
    jsbsim.fly(entry(stop={"time_s": 3.0}), VEHICLE, on_frame=lambda row: rows.append(row.copy()))
    table = np.array(rows)
    assert table.shape == (181, len(FRAME))
    assert table[:, 0] == approx(np.arange(181) / 60.0, abs=1e-12)
    assert table[-1, 7] == approx(us76(table[-1, 1])[2], rel=1e-6)


def test_a_published_property_is_visible_to_jsbsim() -> None:
    host = open_vehicle(ORBITER)
    host.publish("heating/NOSE_1/surface-K").set_double_value(1500.0)
    assert host.fdm["heating/NOSE_1/surface-K"] == 1500.0


@pytest.mark.parametrize("name", ["heating/1st/surface-K", "heating//x", "", "heating/a b"])
def test_an_invalid_property_name_is_refused(name: str) -> None:
    with pytest.raises(InputError, match="not a JSBSim property name"):
        open_vehicle(ORBITER).publish(name)


def test_a_misspelt_property_is_refused_with_the_most_similar_one() -> None:
    with pytest.raises(InputError, match=r"aero/alfa-deg: .*did you mean `aero/alpha-deg`"):
        open_vehicle(ORBITER).node("aero/alfa-deg")


def test_a_missing_aircraft_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="JSBSim cannot load it"):
        JSBSimHost(tmp_path, "nothing")


@pytest.mark.parametrize(
    ("old", "new", "hint"),
    [
        ("control/bank-rad", "control/bank-x-rad", "no such JSBSim property"),
        ("<channel", "<channel name=$", r"line \d+: is not XML"),
    ],
)
def test_an_attitude_control_that_cannot_be_flown_is_named(old: str, new: str, hint: str, tmp_path: Path) -> None:
    copy = shutil.copytree(ORBITER, tmp_path / "orbiter")
    control = copy / "jsbsim" / "attitude_control.xml"
    text = control.read_text()
    assert old in text
    control.write_text(text.replace(old, new))
    with pytest.raises(InputError, match=rf"orbiter/jsbsim/attitude_control\.xml: .*{hint}"):
        jsbsim.JSBSimEntry(entry(), load_vehicle(copy))


def test_an_aircraft_that_jsbsim_refuses_by_an_exception_of_its_library_is_refused(tmp_path: Path) -> None:
    source = Path(get_default_root_dir()) / "aircraft" / "ball" / "ball.xml"
    (tmp_path / "ball").mkdir()
    text = source.read_text().replace('<function name="', '<function name="javascript:')
    assert text != source.read_text()
    (tmp_path / "ball" / "ball.xml").write_text(text)
    with pytest.raises(InputError, match=r"ball: JSBSim cannot load it, ball\.xml, line \d+: name may contain only"):
        JSBSimHost(tmp_path, "ball")


def test_an_aircraft_with_a_wrong_number_is_refused_with_its_line_and_nothing_else_is_printed(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    source = Path(get_default_root_dir()) / "aircraft" / "ball" / "ball.xml"
    (tmp_path / "ball").mkdir()
    (tmp_path / "ball" / "ball.xml").write_text(source.read_text().replace("<y>", "<y> x", 1))
    with pytest.raises(InputError, match=r"ball: JSBSim cannot load it, ball\.xml, line \d+: Expecting a numeric"):
        JSBSimHost(tmp_path, "ball")
    assert capfd.readouterr() == ("", "")


SHIPPED = Path(get_default_root_dir()) / "aircraft"


@pytest.mark.parametrize("name", ["X15", "ball", "Shuttle"])
def test_an_aircraft_that_jsbsim_ships_is_coupled_by_default_and_leaves_no_file(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    host = JSBSimHost(SHIPPED, name, rate_hz=100.0, dispersions=Dispersions())
    heating = JSBSimHeating(host, HeatingPlugin(VEHICLE, ["V09T9527"]))
    assert host.notes == [
        "elevon_deg is read from fcs/elevator-pos-deg: this aircraft has no fcs/elevon-pos-deg",
        "bodyflap_deg is 0: this aircraft has no fcs/bodyflap-pos-deg",
        "jets is 0: this aircraft has no control/jet-firing",
    ]
    host.node("fcs/elevator-cmd-norm").set_double_value(0.2)
    host.start(InitialState(60000.0, 5000.0, -10.0, 90.0, 0.0, alpha_deg=30.0))
    for _ in range(100):
        host.step()
        heating.frame()
    frame = dict(zip(FRAME, host.read_frame(), strict=True))
    assert frame["time_s"] == 1.0
    assert frame["altitude_m"] == approx(60000.0 - 5000.0 * math.sin(math.radians(10.0)), abs=60.0)
    assert frame["elevon_deg"] == (0.0 if name == "ball" else approx(math.degrees(host.fdm["fcs/elevator-pos-rad"])))
    assert abs(frame["elevon_deg"]) > (-1.0 if name == "ball" else 5.0)
    assert (frame["bodyflap_deg"], frame["jets"]) == (0.0, 0.0)
    assert host.getter("heating/V09T9527/surface-K")() > 291.0
    assert list(tmp_path.iterdir()) == []  # some declare files of their own


def test_a_column_may_be_read_from_another_property_or_be_a_constant() -> None:
    reads = {"elevon_deg": PropertyRead("fcs/elevator-pos-rad", 180.0 / math.pi), "bodyflap_deg": -5.0}
    host = JSBSimHost(SHIPPED, "X15", reads=reads)
    assert host.notes == ["jets is 0: this aircraft has no control/jet-firing"]
    host.node("fcs/elevator-cmd-norm").set_double_value(0.2)
    host.start(InitialState(60000.0, 5000.0, -1.0, 90.0, 0.0))
    frame = dict(zip(FRAME, host.read_frame(), strict=True))
    assert frame["elevon_deg"] == approx(math.degrees(host.fdm["fcs/elevator-pos-rad"]))
    assert frame["bodyflap_deg"] == -5.0


@pytest.mark.parametrize(
    ("reads", "expected"),
    [
        ({"elevon": 0.0}, r"reads: unknown column `elevon`; did you mean `elevon_deg`"),
        ({"jets": math.nan}, r"reads, `jets`: nan is not a finite number"),
        ({"jets": PropertyRead("fcs/elevatr-pos-deg")}, r"reads, `jets`: .*did you mean `fcs/elevator-pos-deg`"),
    ],
)
def test_wrong_reads_are_refused(reads: dict[str, Read], expected: str) -> None:
    with pytest.raises(InputError, match=expected):
        JSBSimHost(SHIPPED, "X15", reads=reads)


def test_a_misspelt_aircraft_is_refused_with_the_most_similar_one() -> None:
    with pytest.raises(InputError, match=r"there is no such aircraft, JSBSim cannot load it; did you mean `X15`"):
        JSBSimHost(SHIPPED, "X-15")


def damaged_control(tmp_path: Path, old: str, new: str) -> Path:
    """The Orbiter with a text of its attitude control replaced."""
    shutil.copytree(ORBITER, tmp_path / "orbiter")
    file = tmp_path / "orbiter" / "jsbsim" / "attitude_control.xml"
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, new, 1))
    return tmp_path / "orbiter"


BOMB = '<!DOCTYPE x [<!ENTITY a "ha"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;">]><system '


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("</system>", "<a>" * 70_000 + "</a>" * 70_000 + "</system>", "more than 100 elements within each other"),
        ("<system ", BOMB, r"a document type \(<!DOCTYPE \.\.\.>\) is not allowed"),
        ("</system>", "", r"line \d+: is not XML \(no element found"),
        ("</system>", f"<!--{'x' * 2**20}--></system>", "is larger than 1 MiB"),
    ],
)
def test_an_attitude_control_made_to_do_harm_is_refused(old: str, new: str, expected: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=rf"attitude_control\.xml: .*{expected}"):
        open_vehicle(damaged_control(tmp_path, old, new))


UNRESOLVED = (
    '<channel name="x"><fcs_function name="x/y"><function name="x/z"><sum><property>no/such</property><value>1</value>'
    "</sum></function></fcs_function></channel></system>"
)


@pytest.mark.thorough
def test_a_function_of_a_missing_property_does_not_end_the_program(tmp_path: Path) -> None:
    """JSBSim evaluates its functions once more in its destructors, and ends the program where that fails."""
    vehicle = damaged_control(tmp_path, "</system>", UNRESOLVED)
    lines = [
        "import gc, sys, pathlib",
        "from sim_heating.base.errors import RunError",
        "from sim_heating.trajectory.jsbsim.host import InitialState, open_vehicle",
        "open_vehicle(pathlib.Path(sys.argv[1]))",  # never started
        "host = open_vehicle(pathlib.Path(sys.argv[1]))",
        "try: host.start(InitialState(74000.0, 6800.0, -0.1, 60.0, 10.0, alpha_deg=40.0))",
        "except RunError as error: print(error)",
        "del host",
        "gc.collect()",
        "print('alive')",
    ]
    done = subprocess.run(
        [sys.executable, "-c", "\n".join(lines), str(vehicle)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert "The property no/such does not exist" in done.stdout
    assert done.stdout.splitlines()[-1] == "alive"


def test_jsbsim_is_silent(capfd: pytest.CaptureFixture[str]) -> None:
    jsbsim.fly(entry(stop={"time_s": 1.0}), VEHICLE)
    assert capfd.readouterr() == ("", "")


def test_two_hosts_do_not_disturb_each_other(orbiter: Aero) -> None:
    alone, one, other = (
        placed(orbiter, 20.0, 40.0, 1.0, 10.0),
        placed(orbiter, 20.0, 40.0, 1.0, 10.0),
        placed(orbiter, 8.0, 30.0, 0.0, 0.0),
    )
    for _ in range(120):
        alone.step()
    for _ in range(120):
        one.step()
        other.step()
    assert np.array_equal(alone.read_frame(), one.read_frame())


# Flights that fail say so


def fly_on(flight: jsbsim.JSBSimEntry) -> None:
    while not flight.ended():
        flight.command()
        for _ in range(flight.frames_a_command):
            flight.step()


@pytest.mark.thorough
def test_an_entry_above_circular_speed_skips_out() -> None:
    fast = {**ENTRY_INTERFACE, "velocity_m_s": 7600.0}
    with pytest.raises(RunError, match=r"skipped out at \d+\.\d\d s: altitude 127"):
        jsbsim.fly(entry(initial=fast), VEHICLE)


def test_a_flight_into_the_ground_is_an_error() -> None:
    dive = {**ENTRY_INTERFACE, "altitude_m": 20e3, "velocity_m_s": 800.0, "gamma_deg": -80.0}
    with pytest.raises(RunError, match=r"hit the ground at \d+\.\d\d s"):
        jsbsim.fly(entry(initial=dive, stop={"time_s": 400.0}), VEHICLE)


def test_a_state_that_is_not_a_number_is_an_error() -> None:
    flight = jsbsim.JSBSimEntry(entry(), VEHICLE)
    flight.step()
    flight.host.node("control/yaw-frequency-rad_s").set_double_value(math.nan)
    with pytest.raises(RunError, match=r"not a number at 0\.\d\d s"):
        fly_on(flight)


def test_lost_control_is_an_error() -> None:
    flight = jsbsim.JSBSimEntry(entry(), VEHICLE)
    for axis in ("pitch", "roll", "yaw"):
        flight.host.node(f"control/jet-limit-{axis}-lbsft").set_double_value(0.0)
    flight.host.node("control/elevon-max-deg").set_double_value(-30.0)
    with pytest.raises(RunError, match="out of control"):
        fly_on(flight)


def test_an_entry_without_an_initial_state_is_refused() -> None:
    with pytest.raises(InputError, match="initial"):
        jsbsim.fly(TrajectorySpec(source="recorded", file="x.csv"), VEHICLE)
