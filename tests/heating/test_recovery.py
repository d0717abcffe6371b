"""Recovery enthalpy of body points against boundary layers that are solved here from the equations of motion."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
import pytest
from scipy.integrate import solve_bvp

from sim_heating.base.conditions import Conditions
from sim_heating.base.errors import InputError
from sim_heating.heating.atmosphere import us76
from sim_heating.heating.ratio.table import RatioTable, read_ratio_table, write_ratio_table
from sim_heating.heating.ratio.tunnel_to_flight import FlowState, Scaling, scale_table
from sim_heating.heating.reference.flat_plate import eckert_film, windward_edge_kernel
from sim_heating.heating.reference.gas import air_kernel, air_state_kernel
from sim_heating.heating.reference.models import reference_heating
from sim_heating.heating.reference.recovery import Recovery
from sim_heating.heating.reference.stagnation import NO_LEWIS, fay_riddell_kernel

PR = 0.71
WALL_K = 1100.0
CASES = [(6300.0, 70e3, 40.0), (6300.0, 70e3, 25.0), (2000.0, 47e3, 40.0), (2000.0, 47e3, 25.0)]
"""Speed [m/s], altitude [m], angle of attack [deg] of an entry."""


def flight(V: float, z: float, alpha: float, **more: float) -> Conditions:
    T, _, rho = us76(np.array([z]))
    zero = np.zeros(1)
    columns = {"velocity_m_s": zero + V, "alpha_deg": zero + alpha, "rho_kg_m3": rho, "T_inf_K": T, "mach": zero + 20.0}
    return Conditions({"time_s": zero, **columns, **{name: zero + value for name, value in more.items()}})


def edge(V: float, z: float, alpha: float) -> tuple[float, float, float]:
    T, _, rho = us76(np.array([z]))
    return windward_edge_kernel(float(rho[0]), V, float(T[0]), alpha)


@cache
def laminar_plate(V: float, z: float, alpha: float, wall_K: float | None) -> tuple[float, float]:
    """Wall enthalpy [J/kg] and flux times sqrt(length) [W/m1.5] of a similar laminar boundary layer on a flat plate.

    Momentum (C f'')' + f f'' = 0 and energy (C/Pr h')' + f h' + C u_e^2 f''^2 = 0 in Lees' and Dorodnitsyn's variables,
    C = rho mu over that of the edge, equilibrium air; without a wall temperature the wall is adiabatic.
    """
    p_e, h_e, u_e = edge(V, z, alpha)

    def rho_mu(h: float) -> float:
        return math.prod(air_state_kernel(h, p_e))

    levels = np.linspace(1e5, 1.3 * (h_e + 0.5 * u_e**2), 400)
    products = np.array([rho_mu(h) for h in levels]) / rho_mu(h_e)
    h_w = None if wall_K is None else air_kernel(wall_K, p_e)[0]

    def slopes(_: np.ndarray, y: np.ndarray) -> np.ndarray:
        f, u, shear, h, flux = y
        C = np.interp(h * h_e, levels, products)
        return np.array([u, shear / C, -f * shear / C, flux * PR / C, -f * flux * PR / C - shear**2 / C * u_e**2 / h_e])

    def ends(wall: np.ndarray, far: np.ndarray) -> np.ndarray:
        at_wall = wall[4] if h_w is None else wall[3] - h_w / h_e
        return np.array([wall[0], wall[1], at_wall, far[1] - 1.0, far[3] - 1.0])

    eta = np.linspace(0.0, 10.0, 200)
    guess = np.array([eta, 1 - np.exp(-eta), 0.47 * np.exp(-eta), np.ones_like(eta), np.exp(-eta)])
    found = solve_bvp(slopes, ends, eta, guess, tol=1e-4, max_nodes=20000)
    assert found.success
    scale = h_e * math.sqrt(rho_mu(h_e) * u_e / 2.0)
    return float(found.y[3, 0] * h_e), float(found.y[4, 0] * scale)


# The enthalpy itself -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("V", "z", "alpha"), CASES)
def test_an_adiabatic_wall_under_a_laminar_boundary_layer_has_the_recovery_enthalpy(V, z, alpha):
    h_aw, _ = laminar_plate(V, z, alpha, None)
    H_r = reference_heating("fay-riddell", flight(V, z, alpha), recovery=Recovery("edge-laminar"))[1][0]
    _, h_e, u_e = edge(V, z, alpha)
    # 1 % of the defect; the total enthalpy of the edge has the heat of the air as the table has it, H_r has cp T_inf
    assert h_aw == pytest.approx(H_r, abs=0.01 * u_e**2 / 2 + 0.001 * H_r)
    assert h_aw < h_e + 0.85 * u_e**2 / 2


@pytest.mark.parametrize(("V", "z", "alpha"), CASES)
def test_film_times_recovery_less_wall_enthalpy_is_the_flux_of_the_boundary_layer(V, z, alpha):
    h_w, flux = laminar_plate(V, z, alpha, WALL_K)
    film = eckert_film(*edge(V, z, alpha), 1.0, WALL_K, False)
    H_r = reference_heating("fay-riddell", flight(V, z, alpha), recovery=Recovery("edge-laminar"))[1][0]
    assert film * (H_r - h_w) == pytest.approx(flux, rel=0.04)  # what Eckert's film coefficient is good for


@pytest.mark.parametrize(
    ("case", "laminar", "turbulent"), [*zip(CASES, (0.11, 0.16, 0.20, 0.31), (0.07, 0.10, 0.13, 0.19), strict=True)]
)
def test_the_total_enthalpy_heats_a_body_point_too_much(case, laminar, turbulent):
    h_w = air_kernel(WALL_K, edge(*case)[0])[0]
    for kind, excess in (("edge-laminar", laminar), ("edge-turbulent", turbulent)):
        H = [reference_heating("fay-riddell", flight(*case), recovery=Recovery(k))[1][0] for k in ("total", kind)]
        assert (H[0] - h_w) / (H[1] - h_w) - 1.0 == pytest.approx(excess, abs=0.01)


def test_the_adiabatic_wall_of_turbulent_air_at_mach_3_is_580_K():
    V = 3.0 * math.sqrt(1.4 * 287.05 * 222.5)
    flown = flight(V, 20e3, 0.0).with_columns(T_inf_K=222.5)
    wall_K = [
        reference_heating(name, flown, running_length_m=1.0)[1][0] / 1004.5
        for name in ("eckert-turbulent", "sutton-graves")
    ]
    assert wall_K == pytest.approx([580.0, 623.0], abs=0.5)  # T (1 + r 0.2 M^2), r = 0.892, and r = 1


def test_the_rise_takes_a_laminar_edge_to_the_turbulent_one():
    flown = flight(5000.0, 60e3, 32.0)
    columns = {
        kind: reference_heating("fay-riddell", flown, recovery=Recovery(kind, 3.0))
        for kind in ("edge-laminar", "edge-turbulent")
    }
    laminar, turbulent = columns["edge-laminar"], columns["edge-turbulent"]
    assert laminar.H_r_J_kg + laminar.H_r_rise_J_kg == pytest.approx(turbulent.H_r_J_kg, rel=1e-12)
    assert turbulent.H_r_rise_J_kg[0] == 0.0
    u_e = 5000.0 * math.cos(math.radians(35.0))
    assert laminar.H_r_rise_J_kg[0] == pytest.approx((PR ** (1 / 3) - PR**0.5) * u_e**2 / 2)


def test_a_deflected_flap_slows_its_edge():
    flap = Recovery("edge-laminar", -2.0, bodyflap_factor=1.0)
    for deflection in (-10.0, 0.0, 20.0):
        flown = flight(6000.0, 65e3, 38.0, bodyflap_deg=deflection)
        H = [reference_heating("fay-riddell", flown, recovery=r)[1][0] for r in (Recovery("total"), flap)]
        u_e = 6000.0 * math.cos(math.radians(36.0 + deflection))
        assert H[0] - H[1] == pytest.approx((1 - PR**0.5) * u_e**2 / 2)


def test_columns_are_those_of_the_point_and_taken_as_given():
    flown = flight(6000.0, 65e3, 38.0, h_ref_kg_m2_s=0.05, H_r_J_kg=1.6e7)
    given = reference_heating("columns", flown, recovery=Recovery("edge-laminar"))
    assert given.H_r_J_kg[0] == 1.6e7
    assert given.H_r_rise_J_kg[0] > 0.0


def test_a_missing_column_of_an_edge_is_named():
    flown = Conditions(
        {"time_s": np.zeros(1), "velocity_m_s": np.ones(1), "T_inf_K": np.ones(1), "rho_kg_m3": np.ones(1)}
    )
    with pytest.raises(InputError, match="column alpha_deg is missing; recovery `edge-laminar` needs it"):
        reference_heating("fay-riddell", flown, recovery=Recovery("edge-laminar"))


# From the tunnel -----------------------------------------------------------------------------------------------------

TUNNEL = FlowState(velocity_m_s=1160.0, T_inf_K=52.0, wall_K=310.0, length_m=0.5735, nose_radius_m=0.3048 * 0.0175)
FLIGHT = FlowState(velocity_m_s=6300.0, T_inf_K=220.0, wall_K=1100.0, length_m=32.77, nose_radius_m=0.3048)
ALPHAS = np.array([25.0, 40.0])


def plate(state: FlowState, alpha: float, turbulent: bool) -> tuple[float, float]:
    """Film coefficient [kg/(m2 s)] of Eckert's plate and flux over it [J/kg] with the plate's own adiabatic wall."""
    V, T, rho = state.velocity_m_s, state.T_inf_K, state.density(6.0)
    p_e, h_e, u_e = windward_edge_kernel(rho, V, T, alpha)
    film = eckert_film(p_e, h_e, u_e, 0.4 * state.length_m, state.wall_K, turbulent)
    r = PR ** (1 / 3) if turbulent else PR**0.5
    return film, V**2 / 2 + 1004.5 * T - (1 - r) * u_e**2 / 2 - air_kernel(state.wall_K, p_e)[0]


def sphere(state: FlowState) -> float:
    """The reference film coefficient of a state [kg/(m2 s)]."""
    V, T = state.velocity_m_s, state.T_inf_K
    return fay_riddell_kernel(state.density(6.0), V, T, state.nose_radius_m, 300.0, NO_LEWIS)


def in_tunnel(turbulent: bool, **header: str) -> RatioTable:
    """What a laboratory publishes that divides its flux by the total enthalpy less that of the wall."""
    total = TUNNEL.velocity_m_s**2 / 2 + 1004.5 * TUNNEL.T_inf_K - air_kernel(TUNNEL.wall_K, 1e3)[0]
    flux = [math.prod(plate(TUNNEL, float(alpha), turbulent)) for alpha in ALPHAS]
    ratio = np.array(flux).reshape(-1, 1, 1, 1, 1) / total / sphere(TUNNEL)
    return RatioTable((ALPHAS, np.zeros(1), np.array([6.0]), np.zeros(1), np.zeros(1)), ratio, 0.1 * ratio, header)


@pytest.mark.parametrize("turbulent", [False, True])
def test_a_tunnel_s_ratio_in_flight_gives_the_flux_of_the_plate_that_was_measured(turbulent):
    kind, regime = ("edge-turbulent", "turbulent") if turbulent else ("edge-laminar", "laminar")
    ends = {"tunnel": TUNNEL, "flight": FLIGHT.model_copy(update={"recovery": kind})}
    scaled = scale_table(in_tunnel(turbulent), Scaling(regime=regime, x_over_L=0.4, method_sigma=0.05, **ends))
    assert scaled.recovery == kind
    expected = [plate(FLIGHT, float(alpha), turbulent)[0] for alpha in ALPHAS]
    assert scaled.ratio.ravel() * sphere(FLIGHT) == pytest.approx(expected, rel=1e-5)


def test_a_tunnel_s_ratio_that_stays_with_the_total_enthalpy_is_6_to_9_per_cent_low_in_flight():
    scaling = Scaling(regime="laminar", x_over_L=0.4, method_sigma=0.05, tunnel=TUNNEL, flight=FLIGHT)
    left = scale_table(in_tunnel(False), scaling)
    assert left.recovery is None
    for alpha, ratio, share in zip(ALPHAS, left.ratio.ravel(), (0.913, 0.941), strict=True):
        film, driving = plate(FLIGHT, float(alpha), False)
        _, _, u_e = windward_edge_kernel(FLIGHT.density(6.0), 6300.0, 220.0, float(alpha))
        total = driving + (1 - PR**0.5) * u_e**2 / 2
        assert ratio * sphere(FLIGHT) * total / (film * driving) == pytest.approx(share, abs=0.005)


def test_an_enthalpy_that_the_laboratory_did_not_use_is_refused():
    scaling = Scaling(regime="laminar", x_over_L=0.4, tunnel=TUNNEL, flight=FLIGHT, method_sigma=0.05)
    with pytest.raises(InputError, match=r"is `edge-laminar`; it must agree with `total` of \[scaling.tunnel\]"):
        scale_table(in_tunnel(False, recovery="edge-laminar"), scaling)


def test_a_table_without_the_header_is_reduced_with_the_total_enthalpy(tmp_path):
    table = in_tunnel(False)
    assert table.recovery_problem("total", "fay-riddell") is None
    assert "not stated, which means `total`" in str(table.recovery_problem("edge-laminar", "fay-riddell"))
    assert table.recovery_problem("edge-turbulent", "eckert-turbulent") is None  # the plate's own wall
    write_ratio_table(tmp_path / "t.csv", in_tunnel(False, recovery="edge-laminar"))
    assert read_ratio_table(tmp_path / "t.csv").recovery == "edge-laminar"
    text = (tmp_path / "t.csv").read_text().replace("edge-laminar", "edge-laminer")
    (tmp_path / "t.csv").write_text(text)
    with pytest.raises(
        InputError, match="header `recovery`: unknown recovery enthalpy `edge-laminer`; did you mean `edge-laminar`"
    ):
        read_ratio_table(tmp_path / "t.csv")
