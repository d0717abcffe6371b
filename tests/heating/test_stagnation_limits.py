"""Limits of stagnation heating: the real-gas stagnation pressure, low speed, and free-molecular flow."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import brentq

from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import Conditions
from sim_heating.heating.atmosphere import R_AIR, sutherland_viscosity, us76_kernel
from sim_heating.heating.reference.gas import R_TABLE
from sim_heating.heating.reference.models import beyond_range, reference_heating
from sim_heating.heating.reference.rarefied import free_molecular_film
from sim_heating.heating.reference.recovery import Recovery
from sim_heating.heating.reference.stagnation import (
    CYLINDER,
    SPHERE,
    detra_kemp_riddell_kernel,
    fay_riddell_kernel,
    stagnation_kernel,
    sutton_graves_kernel,
    velocity_gradient,
)
from sim_heating.heating.surface_pressure import stagnation_rise

ct = pytest.importorskip("cantera", reason="no wheel of Cantera for this Python")

ONE_FOOT_M = 0.3048
SPHERES = ("sutton-graves", "detra-kemp-riddell", "fay-riddell")


def stream(rho: float, V: float, T_inf: float, **columns: FloatArray) -> Conditions:
    state = {"rho_kg_m3": rho, "velocity_m_s": V, "T_inf_K": T_inf}
    return Conditions({"time_s": np.zeros(1)} | {name: np.full(1, value) for name, value in state.items()} | columns)


def film(name: str, rho: float, V: float, T_inf: float, radius_m: float = ONE_FOOT_M) -> float:
    return float(reference_heating(name, stream(rho, V, T_inf), nose_radius_m=radius_m)[0][0])


def coefficient(rho: float, V: float, T_inf: float) -> float:
    """cp_max, the pressure rise at the stagnation point over the dynamic pressure."""
    return stagnation_rise(stagnation_kernel(rho, V, T_inf)) / (0.5 * rho * V * V)


# --- Stagnation pressure ---------------------------------------------------------------------------------------------


def equilibrium_coefficient(rho: float, V: float, T_inf: float) -> float:
    """cp_max of equilibrium air from Cantera: a normal shock, then isentropic compression to rest."""
    gas = ct.Solution("airNASA9.yaml")
    gas.TPX = T_inf, 1e5, {"N2": 0.79, "O2": 0.21}
    gas.TD = T_inf, rho
    p, h = gas.P, gas.enthalpy_mass

    def mass_defect(eps: float) -> float:
        gas.HP = h + 0.5 * V**2 * (1 - eps**2), p + rho * V**2 * (1 - eps)
        gas.equilibrate("HP")
        return rho / gas.density - eps

    eps = brentq(mass_defect, 0.02, 0.6, xtol=1e-7)
    mass_defect(eps)
    p_2, s_2 = gas.P, gas.entropy_mass

    def energy_defect(p_0: float) -> float:
        gas.SP = s_2, p_0
        gas.equilibrate("SP")
        return gas.enthalpy_mass - h - 0.5 * V**2

    p_0 = brentq(energy_defect, p_2, 2.0 * p_2, rtol=1e-7)
    return (p_0 - p) / (0.5 * rho * V**2)


@pytest.mark.parametrize(("altitude_m", "speed_m_s"), [(28e3, 1000.0), (51e3, 3000.0), (63e3, 5000.0), (75e3, 7500.0)])
def test_stagnation_pressure_is_that_of_equilibrium_air_computed_independently(altitude_m, speed_m_s):
    T, _, rho = us76_kernel(altitude_m)
    # 0.3 %: linear interpolation in the table of equilibrium air, and the trapezoid of the compression
    assert coefficient(rho, speed_m_s, T) == pytest.approx(equilibrium_coefficient(rho, speed_m_s, T), rel=3e-3)


def test_stagnation_pressure_of_cold_flow_is_that_of_naca_report_1135():
    # NACA 1135, table II: p_t2 / p_1 at Mach 0.5, 1, 2 and 3 is 1.186, 1.893, 5.640 and 12.06 (gamma 1.4)
    for mach, ratio in ((0.5, 1.1862), (1.0, 1.8929), (2.0, 5.6404), (3.0, 12.061)):
        V = mach * math.sqrt(1.4 * R_TABLE * 220.0)
        # 0.5 %: the table's cp of cold air is 1007.5, and rises by 4 % behind the shock of Mach 3
        assert 1.0 + 0.7 * mach**2 * coefficient(1e-2, V, 220.0) == pytest.approx(ratio, rel=5e-3)


def test_dissociation_raises_the_stagnation_pressure_by_5_percent_over_gamma_1_4():
    T, _, rho = us76_kernel(67.5e3)
    assert coefficient(rho, 6000.0, T) / 1.839 == pytest.approx(1.05, abs=0.005)  # 1.839: gamma 1.4, Mach to infinity


def test_a_body_almost_at_rest_has_the_dynamic_pressure():
    assert coefficient(1.2, 20.0, 288.0) == pytest.approx(1.0, abs=2e-3)


# --- Low speed -------------------------------------------------------------------------------------------------------


def test_a_correlation_continued_to_1_km_s_would_be_far_above_fay_riddell():
    T, _, rho = us76_kernel(28e3)
    own = sutton_graves_kernel(rho, 1000.0, T, ONE_FOOT_M)
    assert own / fay_riddell_kernel(rho, 1000.0, T, ONE_FOOT_M, 300.0, 1.0) == pytest.approx(1.37, abs=0.02)


@pytest.mark.parametrize("name", ["sutton-graves", "detra-kemp-riddell"])
def test_a_correlation_hands_over_to_fay_riddell_between_2_and_1_5_km_s(name):
    own = {"sutton-graves": sutton_graves_kernel, "detra-kemp-riddell": detra_kemp_riddell_kernel}[name]
    T, _, rho = us76_kernel(36e3)
    for V in (2000.0, 3000.0):
        assert film(name, rho, V, T) == pytest.approx(own(rho, V, T, ONE_FOOT_M), rel=1e-6)
    for V in (3.0, 300.0, 1000.0, 1500.0):
        assert film(name, rho, V, T) == pytest.approx(fay_riddell_kernel(rho, V, T, ONE_FOOT_M, 300.0, 1.0), rel=1e-6)


@pytest.mark.parametrize("name", SPHERES)
def test_film_coefficients_are_smooth_through_every_change_of_form(name):
    # Speeds of hand-over, and Mach 1 and 1.4 of the velocity gradient
    a = math.sqrt(1.4 * R_TABLE * 230.0)
    for V in (1500.0, 2000.0, 1.4 * a):
        h = np.array([film(name, 1e-2, V + dv, 230.0) for dv in (-4.0, -2.0, 0.0, 2.0, 4.0)])
        slopes = np.diff(h)
        assert slopes[2] == pytest.approx(slopes[1], rel=0.03)  # kinks of the linear gas table, no step in slope
    h = np.array([film(name, 1e-2, V, 230.0) for V in np.arange(1.0, 2600.0, 5.0)])
    assert np.all(np.abs(np.diff(np.log(h[10:]))) < 0.1 * 5.0 / 50.0 + 0.06)  # no jump anywhere
    assert np.all(h > 0.0)


def test_a_slow_sphere_has_the_heat_transfer_of_incompressible_stagnation_flow():
    # Sibulkin (1952): Nu = 0.763 Pr^0.4 sqrt(du/dx rho / mu) x, with du/dx = 3/2 V/R of potential flow
    rho, V, T = 1.2, 30.0, 290.0
    mu = float(sutherland_viscosity(T))
    expected = 0.763 * 0.71**-0.6 * math.sqrt(rho * mu * 1.5 * V / ONE_FOOT_M)
    assert film("fay-riddell", rho, V, T) == pytest.approx(expected, rel=0.01)


@pytest.mark.parametrize("body", [SPHERE, CYLINDER])
def test_the_velocity_gradient_is_potential_flow_when_slow_and_newtonian_when_fast(body):
    def gradient(mach: float) -> float:
        V = mach * math.sqrt(1.4 * R_TABLE * 220.0)
        p_0, _, rho_0, p = stagnation_kernel(1e-2, V, 220.0)
        return velocity_gradient(p_0, rho_0, p, V, mach, 1.0, body) / V

    assert gradient(0.01) == pytest.approx(body[0], rel=1e-3)
    p_0, _, rho_0, p = stagnation_kernel(1e-2, 600.0, 220.0)
    mach = 600.0 / math.sqrt(1.4 * R_TABLE * 220.0)
    assert gradient(mach) * 600.0 == pytest.approx(math.sqrt(2.0 * (p_0 - p) / rho_0))


def test_subsonic_compressibility_of_a_cylinder_is_that_of_janzen_and_rayleigh():
    # Second order in Mach: u/V = 2 sin x + M^2 (2/3 sin x - 1/2 sin 3x), whose slope at x = 0 is 2 - 5/6 M^2
    mach = 0.2
    V = mach * math.sqrt(1.4 * R_TABLE * 220.0)
    p_0, _, rho_0, p = stagnation_kernel(1e-2, V, 220.0)
    gradient = velocity_gradient(p_0, rho_0, p, V, mach, 1.0, CYLINDER) / V
    assert gradient == pytest.approx(2.0 - 5.0 / 6.0 * mach**2, abs=1e-3)


# --- Rarefied flow ---------------------------------------------------------------------------------------------------


def test_without_bridging_sutton_graves_is_2_and_4_times_the_free_molecular_limit_at_110_and_120_km():
    for altitude_m, times in ((110e3, 2.0), (120e3, 4.2)):
        T, _, rho = us76_kernel(altitude_m)
        continuum = sutton_graves_kernel(rho, 7500.0, T, ONE_FOOT_M)
        assert continuum / (rho * 7500.0) == pytest.approx(times, rel=0.02)
        # The flux of the bridged one stays below every molecule's energy.
        q = film("sutton-graves", rho, 7500.0, T) * 0.5 * 7500.0**2
        assert q < 0.5 * rho * 7500.0**3


@pytest.mark.parametrize("name", SPHERES)
def test_thin_air_leads_to_the_flux_of_free_molecular_flow_and_dense_air_to_the_continuum(name):
    # 200 km: every molecule gives up its energy, q = 0.5 rho V^3
    T, _, rho = us76_kernel(200e3)
    assert film(name, rho, 7700.0, T) * 0.5 * 7700.0**2 == pytest.approx(0.5 * rho * 7700.0**3, rel=0.02)
    T, _, rho = us76_kernel(70e3)
    own = {
        "sutton-graves": sutton_graves_kernel(rho, 7000.0, T, ONE_FOOT_M),
        "detra-kemp-riddell": detra_kemp_riddell_kernel(rho, 7000.0, T, ONE_FOOT_M),
        "fay-riddell": fay_riddell_kernel(rho, 7000.0, T, ONE_FOOT_M, 300.0, 1.0),
    }[name]
    assert film(name, rho, 7000.0, T) == pytest.approx(own, rel=1e-4)


@settings(deadline=None)  # the first example waits for the compiler
@given(st.floats(-9.5, -2.0), st.floats(2500.0, 9000.0), st.floats(0.02, 5.0))
def test_bridged_heating_is_below_continuum_and_free_molecular_heating_and_falls_with_density(log_rho, V, radius_m):
    rho = 10.0**log_rho
    h = film("sutton-graves", rho, V, 230.0, radius_m)
    assert h <= sutton_graves_kernel(rho, V, 230.0, radius_m) * (1 + 1e-12)
    # the thermal motion of the molecules adds (V_thermal / V)^2 to rho V
    assert h <= rho * V * (1 + 1e-3)
    assert film("sutton-graves", 1.1 * rho, V, 230.0, radius_m) > h


def test_what_the_bridging_takes_off_a_shuttle_entry_is_what_the_documents_say():
    found = {}
    for km in (70, 75, 80, 90, 100, 120):
        T, _, rho = us76_kernel(1e3 * km)
        found[km] = 1.0 - film("fay-riddell", rho, 7500.0, T) / fay_riddell_kernel(
            rho, 7500.0, T, ONE_FOOT_M, 300.0, 1.0
        )
    assert found[70] < 1e-5
    assert found[75] < 2e-4
    assert [found[km] for km in (80, 90, 100, 120)] == pytest.approx([0.0024, 0.073, 0.342, 0.804], rel=0.02)


ANGLES_DEG = (-60.0, -20.0, -5.0, 0.0, 3.0, 40.0, 90.0)


@pytest.mark.parametrize("altitude_m", [90e3, 150e3])
def test_free_molecular_film_is_the_integral_over_the_maxwellian(altitude_m):
    T, _, rho = us76_kernel(altitude_m)
    RT, V, H_r = R_AIR * T, 7500.0, 0.5 * 7500.0**2
    for angle in np.radians(ANGLES_DEG):
        towards, along = V * np.sin(angle), V * np.cos(angle)
        c = np.linspace(max(0.0, towards - 9.0 * np.sqrt(2.0 * RT)), max(towards, 0.0) + 9.0 * np.sqrt(2.0 * RT), 40001)
        f = np.exp(-((c - towards) ** 2) / (2.0 * RT)) / np.sqrt(2.0 * np.pi * RT)
        # tangential motion along**2 + 2 R T, rotation R T of two degrees of freedom
        q = rho * np.trapezoid(c * f * (0.5 * (c**2 + along**2 + 2.0 * RT) + RT), c)
        assert free_molecular_film(rho, V, T, np.degrees(angle), H_r) * H_r == pytest.approx(q, rel=1e-5)


@pytest.mark.parametrize("altitude_m", [75e3, 90e3, 105e3, 120e3])
def test_heating_does_not_depend_on_the_size_of_the_reference_sphere(altitude_m):
    T, _, rho = us76_kernel(altitude_m)
    flown = stream(rho, 7500.0, T, alpha_deg=np.array([40.0]))
    films = [
        r
        * reference_heating(
            "fay-riddell", flown, nose_radius_m=R, recovery=Recovery("edge-laminar"), ratio=np.array([r])
        ).h_ref_kg_m2_s[0]
        for R, r in ((ONE_FOOT_M, 0.1096), (10.0 * ONE_FOOT_M, 0.1096 * np.sqrt(10.0)))
    ]
    assert films[1] == pytest.approx(films[0], rel=1e-12)


def test_lee_surface_in_thin_air_is_heated_by_the_thermal_motion():
    T, _, rho = us76_kernel(150e3)
    for angle in (-30.0, 0.0):
        flown = stream(rho, 7500.0, T, alpha_deg=np.array([angle]))
        h = reference_heating("fay-riddell", flown, recovery=Recovery("edge-laminar"))[0][0]
        H_r = reference_heating("fay-riddell", flown, recovery=Recovery("edge-laminar"))[1][0]
        expected = rho * np.sqrt(R_AIR * T / (2.0 * np.pi)) * (0.5 * 7500.0**2 + 3.0 * R_AIR * T) / H_r
        assert h == pytest.approx(expected, rel=0.01)


def test_given_film_coefficient_is_not_bridged():
    T, _, rho = us76_kernel(120e3)
    given = stream(
        rho, 7500.0, T, alpha_deg=np.array([40.0]), h_ref_kg_m2_s=np.array([0.03]), H_r_J_kg=np.array([2.5e7])
    )
    heated = reference_heating("columns", given, recovery=Recovery("edge-laminar"), ratio=np.array([0.1]))
    assert heated.h_ref_kg_m2_s[0] == 0.03


# --- Range -----------------------------------------------------------------------------------------------------------


def test_a_flight_faster_than_the_formula_holds_is_reported_with_its_time():
    V = np.array([11000.0, 9000.0, 7000.0])
    flown = Conditions(
        {"time_s": np.arange(3.0), "velocity_m_s": V, "rho_kg_m3": np.full(3, 1e-5), "T_inf_K": np.full(3, 220.0)}
    )
    assert beyond_range("sutton-graves", flown) is None
    line = beyond_range("fay-riddell", flown)
    assert line is not None
    assert "holds to 8 km/s" in line
    assert "11.00 km/s from 0 s" in line
    assert np.all(np.isfinite(reference_heating("fay-riddell", flown)[0]))
