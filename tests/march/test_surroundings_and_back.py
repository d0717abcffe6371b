"""Temperatures around and behind a wall that change in time, natural convection behind it, and a venting lag."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from sim_heating.base.conditions import FRAME, Conditions
from sim_heating.base.errors import InputError
from sim_heating.heating.atmosphere import SEA_LEVEL_PA, free_stream, us76
from sim_heating.inputs.points import conditions_at_point, point_of_vehicle
from sim_heating.inputs.record import make_record
from sim_heating.inputs.scenario import load_scenario
from sim_heating.inputs.vehicle import load_vehicle
from sim_heating.march.history import march_points
from sim_heating.march.linearised import LinearMarch, Track
from sim_heating.march.mesh_choice import choose_meshes
from sim_heating.march.point import PointModel
from sim_heating.planning.soak import with_soak
from sim_heating.simulation.plugin import HeatingPlugin
from sim_heating.simulation.run import fly_scenario
from tests.support.paths import SCENARIOS
from tests.support.verification.exact import SIGMA
from tests.support.walls import flight, heat, material, practice_record, wall

EPS, THICK_M = 0.8, 1e-3
HEAT_J_M2K = 1000.0 * 1000.0 * THICK_M
"""Heat capacity of the thin wall: rho c L."""
CONDUCTING = {"k": 1e4}
"""A wall without a difference of temperature across it."""
T_S = np.linspace(0.0, 2000.0, 2001)
RAMP_K = 300.0 + 200.0 * np.sin(T_S / 300.0) ** 2
VERTICAL_TURBULENT = 1.31
"""h / dT^(1/3) of a vertical plate in air at sea level [W/(m2 K^(4/3))], McAdams (Holman, Heat Transfer, table 7-2)."""


def thin(emissivity=EPS, **stack):
    return wall((material(emissivity=emissivity, **CONDUCTING), THICK_M), **stack)


def solved(rate, initial_K=300.0):
    """Temperature of the thin wall [K] at T_S by LSODA; rate in W/m2."""
    found = solve_ivp(
        lambda t, T: rate(t, T[0]) / HEAT_J_M2K, T_S[[0, -1]], [initial_K], "LSODA", t_eval=T_S, rtol=1e-9, atol=1e-7
    )
    return found.y[0]


def test_a_wall_radiates_to_surroundings_whose_temperature_changes():
    _, out = heat(thin(), flight(T_S, T_surroundings_K=RAMP_K, q_add_W_m2=500.0), nodes=14)
    expected = solved(lambda t, T: 500.0 + EPS * SIGMA * (np.interp(t, T_S, RAMP_K) ** 4 - T**4))
    np.testing.assert_allclose(out[:, 0], expected, atol=0.01)


def test_constant_columns_are_what_the_stack_declares():
    back = {"h_W_m2K": 20.0, "T_K": 350.0, "emissivity": 0.5}
    declared = thin(surroundings_K=400.0, back=back)
    other = thin(surroundings_K=100.0, back=back | {"T_K": 900.0})
    _, stated = heat(declared, flight(T_S, q_add_W_m2=2e3), nodes=14)
    _, columns = heat(other, flight(T_S, q_add_W_m2=2e3, T_surroundings_K=400.0, T_back_K=350.0), nodes=14)
    np.testing.assert_allclose(columns, stated, rtol=1e-12)


def test_a_back_face_follows_the_temperature_behind_it():
    back = {"h_W_m2K": 15.0, "T_K": 300.0, "emissivity": 0.3}
    _, out = heat(thin(1e-9, back=back), flight(T_S, T_back_K=RAMP_K), nodes=14)
    behind = lambda t: np.interp(t, T_S, RAMP_K)  # noqa: E731
    expected = solved(lambda t, T: 15.0 * (behind(t) - T) + 0.3 * SIGMA * (behind(t) ** 4 - T**4))
    np.testing.assert_allclose(out[:, 0], expected, atol=0.01)


@pytest.mark.parametrize(("n", "p_Pa"), [(1.0 / 3.0, SEA_LEVEL_PA), (0.25, SEA_LEVEL_PA), (1.0 / 3.0, 3e4)])
def test_natural_convection_cools_a_hot_wall_by_its_power_law(n, p_Pa):
    back = {"T_K": 300.0, "natural_h_W_m2K": VERTICAL_TURBULENT, "natural_exponent": n}
    _, out = heat(thin(1e-9, back=back, initial_K=400.0), flight(T_S, p_surface_Pa=p_Pa), nodes=14)
    film = VERTICAL_TURBULENT * (p_Pa / SEA_LEVEL_PA) ** (2.0 * n)
    # film |dT|^n dT integrates to dT = dT_0 (1 + n film dT_0^n t / C)^(-1/n)
    expected = 300.0 + 100.0 * (1.0 + n * film * 100.0**n * T_S / HEAT_J_M2K) ** (-1.0 / n)
    np.testing.assert_allclose(out[:, 0], expected, atol=0.01)


def test_mcadams_is_churchill_and_chu_of_a_vertical_plate_of_a_metre():
    """Properties of air at a film temperature of 325 K (Holman, table A-5)."""
    nu, k, Pr, dT, T_f, L = 18.2e-6, 0.0281, 0.702, 50.0, 325.0, 1.0
    Ra = 9.81 / T_f * dT * L**3 / nu**2 * Pr
    Nu = (0.825 + 0.387 * Ra ** (1.0 / 6.0) / (1.0 + (0.492 / Pr) ** (9.0 / 16.0)) ** (8.0 / 27.0)) ** 2
    assert VERTICAL_TURBULENT * dT ** (1.0 / 3.0) == pytest.approx(Nu * k / L, rel=0.15)


def test_sensitivities_with_natural_convection_and_a_temperature_behind_are_those_of_differences():
    back = {"T_K": 300.0, "h_W_m2K": 2.0, "natural_h_W_m2K": VERTICAL_TURBULENT}
    walls = wall((material(k=1.0, emissivity=EPS), 0.002), (material(k=0.1), 0.02), back=back)
    model = PointModel("wall", walls, (0.022,), nodes=20)
    history = flight(T_S, q_add_W_m2=1e4, T_back_K=RAMP_K, T_surroundings_K=RAMP_K, p_surface_Pa=SEA_LEVEL_PA)
    mesh = choose_meshes([model])[0][0]
    names = ("stack.rsi.conductivity_factor", "back.h_W_m2K", "stack.emissivity_factor")
    found = LinearMarch([Track(model, mesh, names, T_S[::200])], T_S, history).march()[0]
    for k, name in enumerate(names):
        step = 1e-3 * max(abs(model.value(name)), 1.0)
        sides = [model.with_parameters({name: model.value(name) + s}) for s in (step, -step)]
        above, below = (LinearMarch([Track(m, mesh, (), T_S[::200])], T_S, history).march()[0] for m in sides)
        difference = (above.temperature_K - below.temperature_K) / (2.0 * step)
        np.testing.assert_allclose(found.sensitivity[..., k], difference, atol=1e-4 * np.max(np.abs(difference)))


# The soak -------------------------------------------------------------------------------------------------------------


def bondline_peak_K(**back):
    """Peak of a tile's bondline in the soak after the recorded entry of STS-107, with this back face [K]."""
    scenario = load_scenario(SCENARIOS / "recorded_sts107.toml")
    point = scenario.vehicle.control_point("V09T9527")
    flown = conditions_at_point(scenario.vehicle, point, fly_scenario(scenario).conditions)
    model = point_of_vehicle(scenario.vehicle, point)
    if back:
        data = model.construction.model_dump()
        data["stack"]["back"] = back
        model = replace(model, construction=type(model.construction).model_validate(data))
    return float(march_points([model], [with_soak(flown, 5400.0)], longest_step_s=5.0)[0].bondline_K.max())


@pytest.mark.thorough
def test_natural_convection_after_landing_lowers_the_peak_of_the_bondline():
    adiabatic, cooled = bondline_peak_K(), bondline_peak_K(T_K=295.0, natural_h_W_m2K=VERTICAL_TURBULENT)
    assert 3.0 < adiabatic - cooled < 60.0


# Venting --------------------------------------------------------------------------------------------------------------


POROUS = {"p_Pa": [1.0, 1e2, 1e4, 1e5], "T_K": [200.0, 2000.0], "k": [[0.02, 0.03, 0.06, 0.1], [0.1, 0.12, 0.2, 0.3]]}
FALLING_PA = np.interp(T_S, [0.0, 200.0, 800.0, 2000.0], [1e5, 1e2, 5e1, 8e4])


def porous(**stack):
    return wall((material(k=1.0, emissivity=EPS), 0.001), (material(k=POROUS, rho=150.0), 0.04), **stack)


def test_pressure_in_a_vented_insulation_follows_that_of_the_surface():
    """Against the wall without a lag under a pressure that LSODA lets lag."""
    tau = 90.0
    lagging = solve_ivp(
        lambda t, p: (np.interp(t, T_S, FALLING_PA) - p) / tau, T_S[[0, -1]], FALLING_PA[:1], "LSODA", t_eval=T_S,
        rtol=1e-9, atol=1e-6, max_step=20.0,
    ).y[0]  # fmt: skip
    heated = {"q_add_W_m2": 3e4}
    _, vented = heat(porous(venting_tau_s=tau), flight(T_S, p_surface_Pa=FALLING_PA, **heated), nodes=40)
    _, imposed = heat(porous(), flight(T_S, p_surface_Pa=lagging, **heated), nodes=40)
    _, at_once = heat(porous(), flight(T_S, p_surface_Pa=FALLING_PA, **heated), nodes=40)
    np.testing.assert_allclose(vented, imposed, atol=0.02)
    assert np.max(np.abs(at_once[:, 1] - vented[:, 1])) > 3.0


def test_plugin_vents_as_the_march_does():
    vehicle = load_vehicle("orbiter")
    point = vehicle.control_point("V09T9527")
    data = point.construction.model_dump()
    data["stack"]["venting_tau_s"] = 60.0
    slow = replace(point, construction=type(point.construction).model_validate(data))
    changed = replace(vehicle, control_points={**vehicle.control_points, point.name: slow})
    t = np.arange(0.0, 300.0, 0.5)
    # from where heating is low: a cold wall in full heating shows the mesh, not the pressure
    z, V = 100e3 - 150.0 * t, 6500.0 - 2.0 * t
    rho = us76(z)[2]
    frame = {"time_s": t, "altitude_m": z, "velocity_m_s": V, "alpha_deg": 40.0 + 0.0 * t, "rho_kg_m3": rho}
    frame |= {name: np.zeros(len(t)) for name in FRAME if name not in frame}
    plugin = HeatingPlugin(changed, [point.name])
    rows = np.column_stack([frame[name] for name in FRAME])
    plugin.reset(rows[0])
    surface = []
    for row in rows[1:]:
        plugin.step(row)
        surface.append(plugin.surface_K[point.name])
    flown = Conditions(frame | free_stream(z, V, rho, vehicle.reference_length_m))
    at_point = conditions_at_point(changed, slow, flown)
    marched, at_once = (
        march_points([point_of_vehicle(changed, p)], [at_point])[0].surface_K[1:] for p in (slow, point)
    )
    apart = np.max(np.abs(np.array(surface) - marched))
    assert apart < 0.05
    assert np.max(np.abs(at_once - marched)) > 0.2


def test_a_time_constant_that_is_negative_is_refused():
    with pytest.raises(ValueError, match="venting_tau_s"):
        porous(venting_tau_s=-1.0)


def test_a_temperature_behind_an_adiabatic_wall_is_refused_in_a_record():
    record, _ = practice_record("p06")
    with pytest.raises(InputError, match="T_back_K: has no effect behind an adiabatic wall"):
        make_record(
            record.declared, record.conditions.with_columns(T_back_K=300.0), record.thermocouples, record.ratio_table
        )
