"""Optimal entries: Betts' published optima, flights confirmed by another integrator, limits met by marched peaks."""

from __future__ import annotations

import subprocess
import sys
import tomllib
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from sim_heating.base.errors import InputError, RunError
from sim_heating.base.files import check
from sim_heating.heating.atmosphere import standard_speed_of_sound, us76
from sim_heating.inputs.points import conditions_at_point, point_of_vehicle
from sim_heating.inputs.vehicle import load_vehicle
from sim_heating.march.history import march_points
from tests.support.paths import SCENARIOS

pytest.importorskip("casadi", reason="optimal entries need CasADi: pip install 'sim-heating[plan]'")

from benchmarks.optimal import peaks_with_drawn_tables
from sim_heating.planning.optimal import dynamics as od
from sim_heating.planning.optimal import search, tables
from sim_heating.planning.optimal.collocation import Transcription, refined_mesh
from sim_heating.planning.optimal.search import fly_optimal
from sim_heating.planning.optimal.spec import OptimalStudyFile, load_optimal_study, optimal_study
from tests.support import betts

STUDIES = SCENARIOS / "studies"
BEND = np.array([0.1, 0.5])


def study_of(text="", **changes):
    """The shipped study with keys replaced, and only the limits of `text`."""
    data = tomllib.loads((STUDIES / "optimal_entry.toml").read_text())
    data["limit"] = tomllib.loads(text).get("limit", [])
    return optimal_study(check(data | changes, OptimalStudyFile, "study"), load_vehicle("orbiter"))


@pytest.fixture(scope="module")
def betts_flights():
    """Free and limited: on 30 intervals, then refined once."""
    problem = betts.betts_problem()
    flights = {}
    for case in ("free", "limited"):
        bounds = betts.betts_bounds(case == "limited")
        coarse = Transcription(problem, np.linspace(0.0, 1.0, 31)).solve(betts.betts_guess(problem), bounds)
        fine = Transcription(problem, refined_mesh(coarse, 1e-6, BEND)).solve(coarse, bounds)
        flights[case] = (coarse, fine)
    return problem, flights


COLD_LIMIT = """
[[limit]]
control_point = "NOSECAP"
surface_K = 1900.0
"""


@cache
def limited(**change):
    """The optimal entry with the cold limit on a coarse mesh, with keys of its study changed."""
    return fly_optimal(study_of(COLD_LIMIT, intervals=25, mesh_tolerance=1e-3, **change))


@pytest.fixture
def limited_flight():
    return limited()


@pytest.mark.thorough
@pytest.mark.parametrize("change", [{"tolerance_K": 25.0}, {"probability": 0.9}])
def test_another_tolerance_or_probability_is_another_entry(limited_flight, change):
    assert [p.bondline_K for p in limited(**change).peaks] != [p.bondline_K for p in limited_flight.peaks]


@pytest.mark.sample(1)
@pytest.mark.parametrize("case", ["free", "limited"])
def test_betts_published_cross_range_is_found_within_a_thousandth(betts_flights, case):
    latitude_deg, time_s = betts.PUBLISHED[case]
    fine = betts_flights[1][case][1]
    assert np.degrees(fine.goal) == pytest.approx(latitude_deg, rel=1e-3)
    assert fine.duration_s == pytest.approx(time_s, rel=5e-3)


@pytest.mark.parametrize("case", ["free", "limited"])
def test_a_finer_mesh_has_less_error(betts_flights, case):
    coarse, fine = betts_flights[1][case]
    assert np.max(fine.errors) < 0.1 * np.max(coarse.errors)


def test_the_heating_limit_costs_cross_range_and_is_kept(betts_flights):
    problem, flights = betts_flights
    heating = {
        case: np.array(problem.model.map(m.states.shape[1])(m.states, m.controls_at(m.time_s))[1]).ravel()
        for case, (_, m) in flights.items()
    }
    assert np.max(heating["free"]) > 1.5
    assert np.max(heating["limited"][1:]) == pytest.approx(1.0, abs=1e-6)
    assert flights["limited"][1].goal < flights["free"][1].goal


@pytest.mark.thorough
@pytest.mark.parametrize("share", [0.97, 1.03])
def test_no_other_duration_reaches_farther(betts_flights, share):
    problem, flights = betts_flights
    best = flights["free"][1]
    time_s = share * best.duration_s
    other = Transcription(replace(problem, duration_s=(time_s, time_s)), best.mesh).solve(best)
    assert other.duration_s == pytest.approx(time_s)
    assert other.goal < best.goal


def cartesian(motion, accelerations, planet):
    """Integrate the controls of a motion with the vector form of the equations; altitude, speed, latitude at the end.

    accelerations : altitude, speed, alpha -> lift, drag [m/s2]
    """
    spin = np.array([0.0, 0.0, planet.rotation_rad_s])
    h, lon, lat, V, gamma, heading = motion.states[:6, 0]
    up = np.array([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)])
    east = np.array([-np.sin(lon), np.cos(lon), 0.0])
    level = np.cos(heading) * np.cross(up, east) + np.sin(heading) * east
    first = np.concatenate(((planet.radius_m + h) * up, V * (np.cos(gamma) * level + np.sin(gamma) * up)))

    def rates(t, y):
        r, v = y[:3], y[3:]
        distance, speed = np.linalg.norm(r), np.linalg.norm(v)
        alpha, bank = motion.controls_at(t)
        lift, drag = accelerations(distance - planet.radius_m, speed, alpha)
        along = v / speed
        right = np.cross(along, r)
        right /= np.linalg.norm(right)
        b = np.radians(bank)
        force = lift * (np.cos(b) * np.cross(right, along) + np.sin(b) * right) - drag * along
        apparent = -2.0 * np.cross(spin, v) - np.cross(spin, np.cross(spin, r))
        return np.concatenate((v, force + apparent - planet.mu_m3_s2 * r / distance**3))

    y = solve_ivp(rates, (0.0, motion.duration_s), first, method="DOP853", rtol=1e-9, atol=1e-3, max_step=5.0).y[:, -1]
    distance = np.linalg.norm(y[:3])
    return distance - planet.radius_m, np.linalg.norm(y[3:]), np.arcsin(y[2] / distance)


@pytest.mark.thorough
def test_betts_controls_integrated_independently_end_at_the_same_state(betts_flights):
    def accelerations(altitude_m, speed_m_s, alpha_deg):
        force = 0.5 * float(betts.density_slug_ft3(altitude_m / betts.FT_M)) * (speed_m_s / betts.FT_M) ** 2
        per_mass = force * betts.AREA_FT2 / betts.MASS_SLUG * betts.FT_M
        CL, CD = betts.lift_drag(alpha_deg)
        return per_mass * CL, per_mass * CD

    motion = betts_flights[1]["limited"][1]
    altitude_m, speed_m_s, latitude = cartesian(motion, accelerations, betts.PLANET)
    assert altitude_m == pytest.approx(motion.states[od.ALTITUDE, -1], abs=100.0)
    assert speed_m_s == pytest.approx(motion.states[od.SPEED, -1], abs=3.0)
    assert np.degrees(latitude) == pytest.approx(np.degrees(motion.goal), abs=0.003)


@pytest.mark.thorough
def test_optimal_entry_integrated_with_the_tables_ends_close_by(limited_flight):
    aero = tables.aerodynamics(limited_flight.study)

    def accelerations(altitude_m, speed_m_s, alpha_deg):
        rho, sound = us76(altitude_m)[2], standard_speed_of_sound(altitude_m)
        CL, CD, *_ = aero.at(float(speed_m_s / sound), float(alpha_deg), float(speed_m_s))
        per_mass = 0.5 * float(rho) * speed_m_s**2 * aero.area_m2 / aero.mass_kg
        return per_mass * CL, per_mass * CD

    altitude_m, speed_m_s, latitude = cartesian(limited_flight.motion, accelerations, tables.PLANET)
    assert np.degrees(latitude) == pytest.approx(limited_flight.cross_range_deg, rel=0.01)
    assert speed_m_s == pytest.approx(900.0, rel=0.05)
    assert altitude_m == pytest.approx(26000.0, abs=1500.0)


@pytest.mark.thorough
def test_an_active_limit_is_met_by_the_marched_temperature(limited_flight):
    point = limited_flight.study.points[0].point
    vehicle, flown = limited_flight.study.vehicle, limited_flight.conditions
    (history,) = march_points([point_of_vehicle(vehicle, point)], [conditions_at_point(vehicle, point, flown)])
    assert 1899.0 <= np.max(history.surface_K) <= 1900.0
    assert "NOSECAP surface" in limited_flight.status


@pytest.mark.thorough
def test_a_limit_costs_cross_range(limited_flight):
    free = fly_optimal(study_of(COLD_LIMIT.replace("1900.0", "3400.0"), intervals=25, mesh_tolerance=1e-3))
    assert free.peaks[0].surface_K > 1900.0
    assert free.cross_range_deg > limited_flight.cross_range_deg + 0.3


@pytest.mark.thorough
def test_a_bondline_is_hottest_in_the_soak_after_the_entry():
    peaks = []
    for soak_s in (0.0, 1800.0):
        searched = search.EntrySearch(study_of('[[limit]]\ncontrol_point = "V07T9730"', soak_s=soak_s))
        flown = searched.conditions(searched.guess())
        peaks.append(searched.peaks(searched.march(flown, searched.models))[0])
    assert peaks[1].surface_K == peaks[0].surface_K
    assert peaks[1].bondline_K > peaks[0].bondline_K + 5.0


@pytest.mark.thorough
def test_tables_drawn_from_their_sigma_keep_the_limit_as_often_as_asked():
    entry = limited(probability=0.9)
    inside = np.mean(peaks_with_drawn_tables(entry, 150, 7, 4.0)[0] <= 1900.0)
    assert inside == pytest.approx(0.9, abs=3.0 * np.sqrt(0.9 * 0.1 / 150))
    assert entry.nominal[0].surface_K < entry.peaks[0].surface_K - 10.0


@pytest.mark.thorough
def test_wall_without_heat_storage_has_the_settled_temperature():
    study = study_of(COLD_LIMIT)
    aero, point = tables.aerodynamics(study), study.points[0].point
    model = point_of_vehicle(study.vehicle, point)
    wall = tables.wall_temperatures(study, aero, [model])
    state = np.array([70e3, 0.0, 0.0, 6500.0, 0.0, 0.0])
    time = np.array([0.0, 36000.0])
    held = tables.conditions_along(study, aero, time, np.tile(state, (2, 1)).T, np.array([[35.0, 35.0], [0.0, 0.0]]))
    (history,) = march_points([model], [conditions_at_point(study.vehicle, point, held)], longest_step_s=20.0)
    assert 1e3 * float(wall([70e3, 6500.0, 35.0])) == pytest.approx(history.surface_K[-1], abs=3.0)


def glide(**changes):
    """A study of the last minutes without limits, whose intervals are soon as short as they may be."""
    initial = {"altitude_m": 36e3, "velocity_m_s": 1600.0, "gamma_deg": -2.0, "heading_deg": 90.0, "latitude_deg": 0.0}
    return study_of(initial=initial, duration_s=[50.0, 600.0], intervals=10, **changes)


def test_limits_of_a_study_take_the_place_of_those_of_its_vehicle():
    study = study_of(flight_limits={"dynamic_pressure_Pa": 5000.0})
    of_vehicle = study.vehicle.declared.flight_limits
    assert study.flight_limits.dynamic_pressure_Pa == 5000.0 != of_vehicle.dynamic_pressure_Pa
    assert study.flight_limits.normal_load_g == of_vehicle.normal_load_g


@pytest.mark.thorough
def test_a_mesh_that_cannot_be_refined_further_ends_the_search_with_a_note():
    asked, entry = fly_optimal(glide(mesh_tolerance=1e-4)), fly_optimal(glide(mesh_tolerance=1e-15))
    assert asked.notes == ()
    (note,) = entry.notes
    assert "above mesh_tolerance 1e-15 in" in note
    assert "which are not divided further" in note
    assert np.max(np.diff(entry.motion.mesh)) * entry.motion.duration_s <= 4.0  # halves would be below 2 s
    assert [r.intervals for r in entry.rounds] == sorted({r.intervals for r in entry.rounds})  # none twice
    assert entry.cross_range_deg == pytest.approx(asked.cross_range_deg, rel=1e-4)


@pytest.mark.thorough
def test_a_mesh_that_stays_too_coarse_is_refused_in_one_line(monkeypatch):
    monkeypatch.setattr(search, "COARSEST", 1e-14)
    with pytest.raises(
        RunError, match=r"mesh error \S+ at \d+ s, above mesh_tolerance 1e-15 .*; relax a limit"
    ) as error:
        fly_optimal(glide(mesh_tolerance=1e-15))
    assert "\n" not in str(error.value)


@pytest.mark.thorough
def test_an_entry_across_180_deg_of_longitude_reaches_as_far_as_any():
    data = tomllib.loads((STUDIES / "optimal_entry.toml").read_text())["initial"]
    reached = [
        fly_optimal(study_of(initial=data | {"longitude_deg": lon}, intervals=20, mesh_tolerance=0.09)).cross_range_deg
        for lon in (0.0, 170.0)
    ]
    assert reached[1] == pytest.approx(reached[0], rel=1e-5)


@pytest.mark.thorough
def test_a_limit_that_no_flight_can_keep_is_reported_in_one_line():
    cold = COLD_LIMIT.replace("1900.0", "700.0")
    with pytest.raises(
        RunError, match=r"no flight was found.*NOSECAP at \d+ K at the surface, whose limit is 700 K"
    ) as error:
        fly_optimal(study_of(cold, intervals=5, mesh_tolerance=0.05))
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ('"NOSECAP"', "no control point `NOSECAPS`; did you mean `NOSECAP`"),
        ("gamma_deg = -5.0", "unknown key `gamma_deq`; did you mean `gamma_deg`"),
        ("velocity_m_s = 900.0", "`velocity_m_s`: 9000 must be below that of [initial], 7450"),
        ("altitude_m = 26000.0", "`altitude_m`: 326000 must be below that of [initial], 121920"),
        ("[10.0, 45.0]", "the lower limit 45 must be below the upper limit 10"),
        ("= [10.0,", "10 to 145 goes beyond the aerodynamic tables of orbiter, 0 to 50 deg"),
        ("alpha_limits_deg", "`bank_limits_deg`: -200 to 0 must lie within -180 to 180 deg"),
    ],
)
def test_an_impossible_study_is_refused(tmp_path, change, message):
    new = {
        '"NOSECAP"': '"NOSECAPS"', "gamma_deg = -5.0": "gamma_deq = -5.0", "velocity_m_s = 900.0": "velocity_m_s = 9e3",
        "altitude_m = 26000.0": "altitude_m = 326e3", "[10.0, 45.0]": "[45.0, 10.0]",
        "= [10.0,": "= [10.0, 145.0] #", "alpha_limits_deg": "bank_limits_deg = [-200.0, 0.0]\nalpha_limits_deg",
    }[change]  # fmt: skip
    path = tmp_path / "study.toml"
    path.write_text((STUDIES / "optimal_entry.toml").read_text().replace(change, new))
    with pytest.raises(InputError) as error:
        load_optimal_study(path)
    assert message in str(error.value)


@pytest.mark.parametrize("name", ["optimal_entry.toml", "optimal_entry_sure.toml"])
def test_shipped_optimal_entries_can_be_read(name):
    assert load_optimal_study(STUDIES / name).points


@pytest.mark.thorough
def test_without_casadi_one_line_states_what_to_install():
    code = (
        "import sys; sys.modules['casadi'] = None\n"
        "from sim_heating.planning.optimal.search import fly_optimal\n"
        "from sim_heating.planning.optimal.spec import load_optimal_study\n"
        f"fly_optimal(load_optimal_study({str(STUDIES / 'optimal_entry.toml')!r}))"
    )
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert "InputError: optimal entry: CasADi is not installed: pip install 'sim-heating[plan]'" in ran.stderr
