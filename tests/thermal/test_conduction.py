"""Heat conduction against exact solutions, and the orders at which the errors fall.

Tolerances are in K, on meshes of 100 nodes and steps that grow by a constant factor from the start of the heating; what
is left is the second-order error of the mesh, about 2e-4 of the rise in temperature.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

from sim_heating.march.ensemble import Ensemble, condition_history
from sim_heating.march.mesh_choice import pack
from sim_heating.march.point import PointModel
from sim_heating.thermal.frame import NOT_CONTROLLED_K
from sim_heating.thermal.mesh import build_mesh, halve_elements
from tests.support.verification.exact import (
    coated_surface,
    cosine_decay,
    semi_infinite_film,
    semi_infinite_flux,
    semi_infinite_linear_flux,
    slab_flux,
)
from tests.support.verification.numerics import cosine_error
from tests.support.walls import (
    even_mesh,
    flight,
    from_the_first_instant,
    heat,
    material,
    orders,
    practice_model,
    practice_record,
    wall,
)

K, A = 1.0, 1e-6
"""Conductivity [W/(m K)] and diffusivity [m2/s] of the default material."""
Q_W_M2 = 1e4
DEEP_M, SENSOR_M = 0.12, 0.005
"""A wall twelve diffusion lengths thick in 100 s is a half space; a depth of half a diffusion length."""
NO_DEPTHS = np.array([])
CP_J_KGK = 1004.5


def warmed(t: np.ndarray) -> np.ndarray:
    """From 1 s on: before, the heat has not yet crossed the few elements that resolve it."""
    return t >= 1.0


def test_half_space_under_constant_flux_warms_as_the_root_of_time():
    t = from_the_first_instant(100.0)
    _, out = heat(wall((material(), DEEP_M)), flight(t, q_add_W_m2=Q_W_M2), (SENSOR_M,))
    for column, depth in ((0, 0.0), (2, SENSOR_M)):
        exact = 300.0 + semi_infinite_flux(Q_W_M2, K, A, depth, t[warmed(t)])
        np.testing.assert_allclose(out[warmed(t), column], exact, rtol=0.0, atol=0.03)  # of a rise of 113 K


def test_half_space_under_a_flux_that_grows_with_time():
    t = np.linspace(0.0, 100.0, 101)
    _, out = heat(wall((material(), DEEP_M)), flight(t, q_add_W_m2=100.0 * t))
    exact = 300.0 + semi_infinite_linear_flux(100.0, K, A, t)
    np.testing.assert_allclose(out[:, 0], exact, rtol=0.0, atol=0.02)  # of 75 K, at steps of 1 s


def test_half_space_under_a_film_approaches_the_gas_temperature():
    t, h, T_gas = from_the_first_instant(100.0), 200.0, 1300.0
    history = flight(t, h_ref_kg_m2_s=h / CP_J_KGK, H_r_J_kg=CP_J_KGK * T_gas)
    _, out = heat(wall((material(), DEEP_M)), history, (SENSOR_M,), parameters={"ratio.d0": 1.0})
    for column, depth in ((0, 0.0), (2, SENSOR_M)):
        exact = 300.0 + (T_gas - 300.0) * semi_infinite_film(h, K, A, depth, t[warmed(t)])
        np.testing.assert_allclose(out[warmed(t), column], exact, rtol=0.0, atol=0.2)  # of 745 K


def test_slab_with_insulated_back_follows_its_series_to_the_steady_rise():
    t, length = from_the_first_instant(200.0), 0.01
    _, out = heat(wall((material(), length)), flight(t, q_add_W_m2=Q_W_M2), (SENSOR_M, length))
    for column, depth in ((0, 0.0), (2, SENSOR_M), (3, length)):
        exact = 300.0 + slab_flux(Q_W_M2, K, A, length, depth, t[1:], terms=2000)
        np.testing.assert_allclose(out[1:, column], exact, rtol=0.0, atol=0.02)  # of 233 K


def test_steadily_heated_slab_leads_its_insulated_back_by_q_L_over_2k():
    t, length = np.linspace(0.0, 1000.0, 101), 0.01
    _, out = heat(wall((material(), length)), flight(t, q_add_W_m2=Q_W_M2), (length,))
    assert out[-1, 0] - out[-1, 2] == pytest.approx(Q_W_M2 * length / (2.0 * K), abs=1e-6)


def test_coated_tile_follows_the_series_of_a_coating_on_a_half_space():
    coat, tile, delta = material(1.0, 1100.0, 1666.0), material(0.06, 1100.0, 144.0), 0.00038
    t = from_the_first_instant(100.0)
    _, out = heat(wall((coat, delta), (tile, 0.08)), flight(t, q_add_W_m2=Q_W_M2))
    e_coat, e_tile = (math.sqrt(k * rho * 1100.0) for k, rho in ((1.0, 1666.0), (0.06, 144.0)))
    exact = 300.0 + coated_surface(Q_W_M2, e_coat, 1.0 / (1666.0 * 1100.0), e_tile, delta, t[1:])
    np.testing.assert_allclose(out[1:, 0], exact, rtol=0.0, atol=0.3)  # of 676 K


def test_contact_resistance_drops_the_temperature_by_q_times_R():
    resistance, cooled = 2e-3, {"h_W_m2K": 50.0, "T_K": 300.0}
    t = np.linspace(0.0, 20000.0, 201)
    w = wall((material(), 0.005), (material(2.0), 0.004), contact=resistance, back=cooled)
    ensemble, _ = heat(w, flight(t, q_add_W_m2=Q_W_M2), nodes=20)
    at_contact = np.flatnonzero(ensemble.meshes[0].layer == -1)[0]
    above, below = ensemble.node_temperatures(0)[at_contact : at_contact + 2]
    assert above - below == pytest.approx(Q_W_M2 * resistance, abs=1e-6)


def test_steady_layers_add_their_resistances_down_to_the_cooled_back():
    t = np.linspace(0.0, 20000.0, 201)
    w = wall((material(), 0.005), (material(2.0), 0.004), contact=2e-3, back={"h_W_m2K": 50.0, "T_K": 300.0})
    _, out = heat(w, flight(t, q_add_W_m2=Q_W_M2), nodes=20)
    assert out[-1, 0] == pytest.approx(300.0 + Q_W_M2 * (0.005 / 1.0 + 2e-3 + 0.004 / 2.0 + 1.0 / 50.0), abs=1e-6)


def test_back_that_radiates_settles_where_it_gives_up_the_flux():
    t, T_behind = np.linspace(0.0, 20000.0, 201), 280.0
    back = {"T_K": T_behind, "emissivity": 0.8}
    _, out = heat(wall((material(), 0.005), back=back), flight(t, q_add_W_m2=Q_W_M2), (0.005,), nodes=20)
    emitted = 0.8 * 5.670374419e-8 * (out[-1, 2] ** 4 - T_behind**4)
    assert emitted == pytest.approx(Q_W_M2, rel=1e-8)  # the surface emits 2e-9 of it


def test_steady_layer_with_conductivity_in_temperature_obeys_kirchhoff():
    # k = 0.5 to 2 between 300 and 1300 K: q L = int k dT from back to surface, at any number of elements
    k, length = [[300.0, 0.5], [1300.0, 2.0]], 0.02
    t = np.linspace(0.0, 1e5, 1001)
    w = wall((material(k), length), back={"h_W_m2K": 1e4, "T_K": 300.0})
    _, out = heat(w, flight(t, q_add_W_m2=3e4), (length,), nodes=14)
    surface, back = out[-1, 0] - 300.0, out[-1, 2] - 300.0
    kirchhoff = 0.5 * (surface - back) + 0.5 * 1.5e-3 * (surface**2 - back**2)
    assert kirchhoff == pytest.approx(3e4 * length, rel=1e-8)


@pytest.mark.thorough
def test_steady_layer_with_radiation_in_depth_above_a_temperature_obeys_kirchhoff():
    # k = 1 + k_rad (T^3 - T_0^3) / 1000^3 above T_0 = 500 K
    length, k_rad, T_0 = 0.02, 1.5, 500.0
    added = {"stack.rsi.radiative_conductivity": k_rad, "stack.rsi.radiation_from_K": T_0}
    w = wall((material(), length), back={"h_W_m2K": 1e4, "T_K": 300.0})
    t = np.linspace(0.0, 1e5, 1001)
    _, out = heat(w, flight(t, q_add_W_m2=3e4), (length,), nodes=40, parameters=added)
    surface, back = out[-1, 0], out[-1, 2]
    radiated = k_rad * 1e-9 * ((surface**4 - T_0**4) / 4.0 - T_0**3 * (surface - T_0))
    assert back < T_0 < surface - 100.0
    assert surface - back + radiated == pytest.approx(3e4 * length, rel=1e-7)


def test_nodes_start_from_the_declared_profile():
    profile = [[0.0, 900.0], [0.004, 500.0], [0.01, 400.0]]
    w = wall((material(), 0.01), initial="profile", initial_profile=profile, initial_K=None)
    ensemble = pack([PointModel("wall", w, nodes=40)])
    expected = np.interp(ensemble.meshes[0].depth_m, *np.array(profile).T)
    np.testing.assert_array_equal(ensemble.node_temperatures(0), expected)


def test_profile_between_insulated_faces_evens_out_mode_by_mode():
    mesh, length, t = even_mesh(0.01, 40), 0.01, np.linspace(0.0, 20.0, 401)
    ensemble = Ensemble([PointModel("wall", wall((material(), length)))], [mesh], 0.05)

    def profile(time: float) -> np.ndarray:
        modes = [cosine_decay(A, length, n, mesh.depth_m, time) / n for n in (1, 2, 3)]
        return 800.0 + 100.0 * sum(modes)

    ensemble.set_profile(0, profile(0.0))
    ensemble.march(t, flight(t))
    np.testing.assert_allclose(ensemble.node_temperatures(0), profile(20.0), rtol=0.0, atol=1e-3)


def test_order_in_time_is_two_on_a_decaying_mode():
    errors = [cosine_error(even_mesh(0.01, 128), step) for step in (1.0, 0.5, 0.25, 0.125)]
    np.testing.assert_allclose(orders(errors), 2.0, atol=0.05)


def test_order_in_space_is_four_on_equal_elements():
    # Shared half and half between lumped and consistent masses, the second-order errors of equal neighbours cancel.
    errors = [cosine_error(even_mesh(0.01, n), 0.005) for n in (4, 8, 16)]
    np.testing.assert_allclose(orders(errors), 4.0, atol=0.1)


def test_order_in_space_is_two_on_the_graded_mesh():
    # Where neighbours differ in length the errors do not cancel, however often each is halved.
    meshes = [build_mesh(wall((material(), 0.01)), NO_DEPTHS, 14)]
    for _ in range(3):
        meshes.append(halve_elements(meshes[-1]))
    np.testing.assert_allclose(orders([cosine_error(mesh, 0.005) for mesh in meshes]), 2.0, atol=0.05)


def test_order_in_space_is_two_under_a_heated_surface():
    t = from_the_first_instant(100.0, steps=1500)
    model, mesh, errors = PointModel("wall", wall((material(), DEEP_M))), None, []
    for _ in range(3):
        mesh = build_mesh(model.construction, NO_DEPTHS, 16) if mesh is None else halve_elements(mesh)
        out = Ensemble([model], [mesh]).march(t, flight(t, q_add_W_m2=Q_W_M2))
        errors.append(abs(out[-1, 0] - 300.0 - semi_infinite_flux(Q_W_M2, K, A, 0.0, t[-1:])[0]))
    assert np.all(orders(errors) > 1.8)


def test_order_in_time_is_two_with_boundary_conditions_that_change():
    # radiating wall, flux and film from samples 8 s apart; the finest step is taken as the exact solution in time
    t = np.linspace(0.0, 400.0, 51)
    history = flight(t, q_add_W_m2=1e5 * np.sin(np.pi * t / 400.0) ** 2, h_ref_kg_m2_s=2e-5 * t, H_r_J_kg=4e6)
    model = PointModel("wall", wall((material(emissivity=0.85), 0.02)), nodes=30, parameters={"ratio.d0": 1.0})
    ends = [
        pack([model], tolerance_K=NOT_CONTROLLED_K).march(t, history, longest_step_s=step)[:, 0]
        for step in (4.0, 2.0, 1.0, 0.5, 0.0625)
    ]
    errors = [np.max(np.abs(end - ends[-1])) for end in ends[:-1]]
    np.testing.assert_allclose(orders(errors), 2.0, atol=0.15)


@pytest.fixture(scope="module")
def entry():
    record, _ = practice_record("p06")
    return practice_model("p06"), record.conditions.time_s, condition_history(record.conditions)[np.newaxis]


def test_entry_with_its_property_tables_is_second_order_in_time(entry):
    model, t, history = entry
    t, history = t[::4], history[:, ::4]
    runs = [
        pack([model], tolerance_K=NOT_CONTROLLED_K).march(t, history, longest_step_s=step)
        for step in (4.0, 2.0, 1.0, 0.0625)
    ]
    errors = np.array([np.max(np.abs(run - runs[-1])) for run in runs[:-1]])
    assert np.all(orders(errors) > 1.7)  # 1.85: corners of tables and of the flight are not smooth
    assert errors[-1] < 0.03  # K at 1 s


def test_entry_with_its_property_tables_is_second_order_in_space(entry):
    model, t, history = entry
    meshes = [pack([model]).meshes[0]]
    for _ in range(3):
        meshes.append(halve_elements(meshes[-1]))
    runs = [Ensemble([model], [mesh]).march(t, history) for mesh in meshes]
    errors = [np.max(np.abs(run - runs[-1])) for run in runs[:-1]]
    np.testing.assert_allclose(orders(errors)[0], 2.0, atol=0.15)
