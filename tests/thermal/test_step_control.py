"""Control of the time step: after a jump of heating the error of time integration stays near the tolerance.

What is exact in time is the wall's own semi-discrete system, put up here and solved by scipy's Radau, to 1e-4 K.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from sim_heating.heating import flight_variables
from sim_heating.heating.effects import use
from sim_heating.march.ensemble import Ensemble, condition_history
from sim_heating.march.mesh_choice import pack
from sim_heating.march.point import PointModel
from sim_heating.thermal.frame import NOT_CONTROLLED_K, STEP_TOLERANCE_K
from sim_heating.thermal.mesh import Mesh
from tests.support.verification.exact import SIGMA, semi_infinite_flux
from tests.support.walls import flight, heat, heat_content, material, practice_model, practice_record, wall

K, C, RHO, EPS, CP = 0.06, 1100.0, 144.0, 0.85, 1004.5
"""Bare insulation, and the cp of air at its wall."""
INSULATION = wall((material(K, C, RHO, EPS), 0.05))
SENSORS_M = (0.004, 0.01)
SECONDS = np.arange(0.0, 61.0)
FLUX_W_M2 = 1e5
JUMPS = {
    "flux": {"q_add_W_m2": np.full(61, FLUX_W_M2)},
    "flux that comes within a second and goes": {"q_add_W_m2": np.where(np.abs(SECONDS - 20.0) < 15.5, FLUX_W_M2, 0.0)},
    "film": {"h_ref_kg_m2_s": np.full(61, 0.2), "H_r_J_kg": np.full(61, 1.5e6)},
}


def bare(parameters=None) -> PointModel:
    return PointModel("bare", INSULATION, SENSORS_M, nodes=40, parameters={"ratio.d0": 1.0} | (parameters or {}))


def exact_in_time(mesh: Mesh, history: np.ndarray) -> np.ndarray:
    """(time, surface | bondline | sensors) [K] of linear elements with a sixth of their heat shared, by Radau."""
    n, t = mesh.nodes, history[0, :, flight_variables.time_s]
    E, F = np.zeros((2, n, n))
    shared = np.array([[5.0, 1.0], [1.0, 5.0]]) / 6.0
    for e, length in enumerate(mesh.length_m):
        E[e : e + 2, e : e + 2] += 0.5 * RHO * C * length * shared
        F[e : e + 2, e : e + 2] += K / length * np.array([[-1.0, 1.0], [1.0, -1.0]])
    inverse = np.linalg.inv(E)
    names = (flight_variables.q_add_W_m2, flight_variables.h_ref_kg_m2_s, flight_variables.H_r_J_kg)
    given = history[0][:, names].T

    def rate(now: float, T: np.ndarray) -> np.ndarray:
        q, h, H_r = (np.interp(now, t, values) for values in given)
        net = F @ T
        net[0] += q + h * (H_r - CP * T[0]) - EPS * SIGMA * T[0] ** 4
        return inverse @ net

    def jacobian(now: float, T: np.ndarray) -> np.ndarray:
        slope = F.copy()
        slope[0, 0] -= np.interp(now, t, given[1]) * CP + 4.0 * EPS * SIGMA * T[0] ** 3
        return inverse @ slope

    out = np.full((len(t), n), 300.0)
    bends = np.any(np.abs(np.diff(given, 2)) > 0.0, axis=0)
    corners = np.concatenate(([0], np.flatnonzero(bends) + 1, [len(t) - 1]))
    for a, b in pairwise(corners):
        part = t[a : b + 1]
        solved = solve_ivp(rate, part[[0, -1]], out[a], "Radau", part, jac=jacobian, rtol=1e-7, atol=1e-5)
        out[a : b + 1] = solved.y.T
    return out[:, [0, mesh.bondline, *mesh.sensors]]


@pytest.fixture(scope="module")
def exact() -> dict[str, np.ndarray]:
    mesh = pack([bare()]).meshes[0]
    return {name: exact_in_time(mesh, flight(SECONDS, **jump)) for name, jump in JUMPS.items()}


def marched(jump: str, tolerance_K: float = STEP_TOLERANCE_K) -> tuple[Ensemble, np.ndarray]:
    ensemble = pack([bare()], tolerance_K=tolerance_K)
    return ensemble, ensemble.march(SECONDS, flight(SECONDS, **JUMPS[jump]))


@pytest.mark.parametrize("jump", JUMPS)
def test_after_a_jump_of_heating_temperatures_are_those_of_the_wall_within_a_twentieth_of_a_kelvin(jump, exact):
    _, plain = marched(jump, NOT_CONTROLLED_K)
    ensemble, controlled = marched(jump)
    assert np.max(np.abs(plain - exact[jump])) > 5.0
    assert np.max(np.abs(controlled - exact[jump])) < 0.05
    assert ensemble.counters.steps[0] < 4.0 * len(SECONDS)


def test_error_follows_the_tolerance(exact):
    jump = "flux that comes within a second and goes"
    for tolerance in (1.0, 0.1, 0.01):
        assert np.max(np.abs(marched(jump, tolerance)[1] - exact[jump])) < 3.0 * tolerance


def test_half_space_under_a_jump_of_flux_follows_its_exact_solution_at_samples_of_a_second():
    q, deep = 2e4, wall((material(K, C, RHO), 0.2))
    exact = 300.0 + semi_infinite_flux(q, K, K / (RHO * C), 0.0, SECONDS[1:])
    errors = []
    for tolerance in (NOT_CONTROLLED_K, STEP_TOLERANCE_K):
        _, out = heat(deep, flight(SECONDS, q_add_W_m2=q), nodes=100, tolerance_K=tolerance)
        errors.append(np.max(np.abs(out[1:, 0] - exact)))
    assert errors[0] > 5.0
    assert errors[1] < 0.7  # that of the mesh, of 1800 K


def test_an_entry_at_steps_of_one_second_is_divided_at_few_of_them():
    record, _ = practice_record("p06")
    ensemble = pack([practice_model("p06")])
    ensemble.march(record.conditions.time_s, condition_history(record.conditions)[np.newaxis])
    assert 0.0 < ensemble.counters.steps[0] - (len(record.conditions) - 1) < 0.02 * len(record.conditions)


def test_temperatures_do_not_depend_on_how_neighbours_divide_their_steps():
    models = [bare({"stack.emissivity_factor": 0.2 + 0.1 * i}) for i in range(8)]
    models[3] = practice_model("p06", ratio=None, nodes=40, depths_m=SENSORS_M, parameters={"ratio.d0": 0.3})
    times = np.where(SECONDS[:, np.newaxis] > 3.0 * np.arange(8), 1.0, 0.0).T
    histories = np.concatenate(
        [flight(SECONDS, q_add_W_m2=5e4 * on, h_ref_kg_m2_s=0.01 * on, H_r_J_kg=5e6) for on in times]
    )
    together = Ensemble(models, pack(models).meshes)
    out = together.march(SECONDS, histories).reshape(len(SECONDS), 8, -1)
    for i in range(8):
        alone = pack([models[i]])
        np.testing.assert_array_equal(out[:, i], alone.march(SECONDS, histories[i : i + 1]))
        assert (alone.counters.steps[0], alone.counters.iterations[0]) == (
            together.counters.steps[i],
            together.counters.iterations[i],
        )
        assert alone.counters.absorbed_J_m2[0] == together.counters.absorbed_J_m2[i]
    assert len(set(together.counters.steps)) > 4


def test_energy_closes_where_steps_are_divided():
    jump = "flux that comes within a second and goes"
    ensemble, _ = marched(jump)
    gained = heat_content(ensemble) - RHO * C * 0.05 * 300.0
    assert gained == pytest.approx(ensemble.counters.absorbed_J_m2[0] - ensemble.counters.emitted_J_m2[0], rel=1e-10)


def test_samples_outside_the_table_and_of_negative_ratio_count_once_however_their_step_is_divided():
    model = practice_model("p06", parameters={"ratio.d0": 0.0, "ratio.scale": -3.0})
    t = np.arange(0.0, 11.0)
    ensemble = pack([model])
    ensemble.march(t, flight(t, alpha_deg=80.0, log10_re=6.0, q_add_W_m2=2e5, h_ref_kg_m2_s=0.01))
    assert ensemble.counters.steps[0] > 20.0
    assert ensemble.counters.steps_outside_table[0] == 11.0  # the first sample, and ten ends of frames
    assert ensemble.counters.steps_of_negative_ratio[0] == 11.0


def test_a_lag_of_the_heating_ratio_is_that_of_steps_marched_one_by_one():
    lagging = bare()
    lagging = PointModel(
        "lag", INSULATION, SENSORS_M, nodes=40, parameters={"ratio.d0": 1.0}, effects=(use("nonisothermal-wall"),)
    )
    history = flight(SECONDS, **JUMPS["film"], alpha_deg=30.0 + SECONDS / 6.0)
    fine = pack([lagging], tolerance_K=NOT_CONTROLLED_K).march(SECONDS, history, longest_step_s=1.0 / 128.0)
    assert np.max(np.abs(pack([lagging]).march(SECONDS, history) - fine)) < 0.05


def test_a_step_that_does_not_converge_is_divided():
    # sudden loss of all heating at 2000 K within one step of 10 s
    w = wall((material(K, C, RHO, EPS), 0.05), initial_K=2000.0)
    t = np.array([0.0, 10.0, 20.0])
    model = PointModel("hot", w, nodes=40)
    plain = pack([model], tolerance_K=NOT_CONTROLLED_K)
    controlled = pack([model], 10.0)
    out = controlled.march(t, flight(t), longest_step_s=10.0)
    assert controlled.counters.failures[0] == 0.0
    fine = plain.march(t, flight(t), longest_step_s=1.0 / 512.0)
    assert np.max(np.abs(out[:, 0] - fine[:, 0])) < 0.5
