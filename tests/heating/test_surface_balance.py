"""Surface heat balance: convection, radiation, and the temperature at which they are equal."""

from __future__ import annotations

import numpy as np
import pytest

from sim_heating.heating.reference.gas import wall_enthalpy_grid
from tests.support.verification.exact import SIGMA, radiating_mass_time, radiation_equilibrium
from tests.support.walls import flight, from_the_first_instant, heat, material, wall

EPS, CP_J_KGK = 0.85, 1004.5
RATIO_ONE = {"ratio.d0": 1.0}
THIN_M = 0.001
"""A wall that settles within minutes."""
LONG_S = np.linspace(0.0, 4000.0, 401)


def settled(**columns) -> float:
    """Surface temperature [K] of a thin wall after an hour of the same heating."""
    stack = columns.pop("stack", {})
    model = columns.pop("model", {})
    emissivity = columns.pop("emissivity", EPS)
    w = wall((material(emissivity=emissivity), THIN_M), **stack)
    _, out = heat(w, flight(LONG_S, **columns), nodes=14, parameters=RATIO_ONE, **model)
    return float(out[-1, 0])


@pytest.mark.parametrize("flux_W_m2", [1e3, 1e5, 1e6])
def test_insulated_wall_settles_where_it_radiates_what_it_absorbs(flux_W_m2):
    assert settled(q_add_W_m2=flux_W_m2) == pytest.approx(radiation_equilibrium(flux_W_m2, EPS), abs=1e-6)


def test_an_unheated_wall_takes_the_temperature_of_its_surroundings():
    assert settled(stack={"surroundings_K": 500.0}) == pytest.approx(500.0, abs=1e-6)


def test_absorbed_flux_adds_to_the_radiation_of_the_surroundings():
    settled_K = settled(q_add_W_m2=1e4, stack={"surroundings_K": 500.0})
    assert settled_K == pytest.approx(radiation_equilibrium(1e4, EPS, 500.0), abs=1e-6)


def test_film_and_radiation_balance_at_equilibrium():
    film, H_r = 0.01, 1.5e7
    T = settled(h_ref_kg_m2_s=film, H_r_J_kg=H_r)
    assert film * (H_r - CP_J_KGK * T) == pytest.approx(EPS * SIGMA * T**4, rel=1e-9)


def test_film_and_radiation_balance_with_the_enthalpy_of_equilibrium_air():
    film, H_r, p = 0.1, 2e7, 1000.0
    T = settled(h_ref_kg_m2_s=film, H_r_J_kg=H_r, p_surface_Pa=p, model={"wall_enthalpy": "equilibrium-air"})
    H_w = wall_enthalpy_grid("equilibrium-air", [T], [p])[0, 0]
    # H_w is linear within bins of 5 K: 1e-4 of it at the dissociating wall
    assert film * (H_r - H_w) == pytest.approx(EPS * SIGMA * T**4, rel=2e-5)


def test_without_radiation_the_wall_takes_the_recovery_temperature():
    settled_K = settled(h_ref_kg_m2_s=0.1, H_r_J_kg=CP_J_KGK * 1500.0, emissivity=1e-9)
    assert settled_K == pytest.approx(1500.0, abs=1e-5)


def test_emissivity_is_evaluated_at_the_wall_temperature():
    m = material().model_copy(update={"emissivity": [[300.0, 0.9], [1300.0, 0.6]]})
    _, out = heat(wall((m, THIN_M)), flight(LONG_S, q_add_W_m2=5e4), nodes=14)
    T = out[-1, 0]
    assert np.interp(T, [300.0, 1300.0], [0.9, 0.6]) * SIGMA * T**4 == pytest.approx(5e4, rel=1e-9)


def test_emissivity_factor_multiplies_the_declared_table():
    w = wall((material(emissivity=0.8), THIN_M))
    _, out = heat(w, flight(LONG_S, q_add_W_m2=5e4), nodes=14, parameters={"stack.emissivity_factor": 0.9})
    assert out[-1, 0] == pytest.approx(radiation_equilibrium(5e4, 0.72), abs=1e-6)


def test_heating_ratio_multiplies_the_film_alone():
    once = settled(h_ref_kg_m2_s=0.01, H_r_J_kg=1.5e7, q_add_W_m2=1e4)
    w = wall((material(emissivity=EPS), THIN_M))
    half = flight(LONG_S, h_ref_kg_m2_s=0.02, H_r_J_kg=1.5e7, q_add_W_m2=1e4)
    _, out = heat(w, half, nodes=14, parameters={"ratio.d0": 0.5})
    assert out[-1, 0] == pytest.approx(once, abs=1e-9)


def test_negative_ratio_cools_and_is_counted_without_clipping():
    w = wall((material(emissivity=EPS), THIN_M))
    t = np.linspace(0.0, 10.0, 11)
    ensemble, out = heat(w, flight(t, h_ref_kg_m2_s=0.01, H_r_J_kg=1.5e7), nodes=14, parameters={"ratio.d0": -0.01})
    assert out[-1, 0] < 300.0 - 1.0
    assert ensemble.counters.steps_of_negative_ratio[0] == len(t)


def test_thin_radiating_coating_on_an_insulator_warms_as_the_lumped_solution():
    # 0.38 mm of a well conducting coating on a layer that takes next to nothing; of a rise of 1130 K
    k, rho, c, delta, q = 1e4, 1666.0, 1200.0, 0.00038, 2e5
    w = wall((material(k, c, rho, EPS), delta), (material(1e-6, 1.0, 1.0), 0.01))
    t = from_the_first_instant(20.0, 800)
    _, out = heat(w, flight(t, q_add_W_m2=q), nodes=14)
    T_r = radiation_equilibrium(q, EPS)
    reached = out[1:, 0] < 0.999 * T_r
    exact_time = radiating_mass_time(out[1:, 0][reached] / T_r, 300.0 / T_r, rho * c * delta, EPS, T_r)
    lag_K = (exact_time - t[1:][reached]) * np.gradient(out[1:, 0], t[1:])[reached]
    assert np.max(np.abs(lag_K)) < 0.02


def test_wall_cools_by_radiation_as_one_over_the_cube_of_temperature():
    # lumped: 1/T^3 = 1/T_0^3 + 3 eps sigma t / (rho c delta)
    delta, t = 0.0005, np.linspace(0.0, 60.0, 1201)
    w = wall((material(1e4, emissivity=EPS), delta), initial_K=1500.0)
    _, out = heat(w, flight(t), nodes=14)
    exact = (1500.0**-3 + 3.0 * EPS * SIGMA * t / (1000.0 * 1000.0 * delta)) ** (-1.0 / 3.0)
    np.testing.assert_allclose(out[:, 0], exact, rtol=0.0, atol=0.05)  # steps of 0.05 s
