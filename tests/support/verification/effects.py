"""Transition and finite-rate recombination: settled walls against the same balances, written down again."""

from __future__ import annotations

import math

import numpy as np
from scipy.optimize import brentq

from sim_heating.base.conditions import Conditions
from sim_heating.heating.edge_flow import EdgeFlow, edge_flow_columns
from sim_heating.heating.effects import Window, use
from sim_heating.heating.reference.recovery import Recovery
from sim_heating.march.mesh_choice import pack
from sim_heating.march.point import PointModel
from tests.support.verification.boundary_layer import isobar
from tests.support.verification.conduction import CP_J_KGK, RATIO_ONE
from tests.support.verification.exact import SIGMA
from tests.support.verification.gas import cantera_air, equilibrium, shock_by_cantera, sound_by_cantera
from tests.support.verification.row import Row, within
from tests.support.walls import flight, heat, material, wall

EPS, FILM, H_R, P_PA = 0.85, 0.012, 2.0e7, 1500.0
"""Emittance, film coefficient [kg/(m2 s)], recovery enthalpy [J/kg] and pressure [Pa] at the wall."""
LONG_S = np.linspace(0.0, 4000.0, 401)
SETTLED = "settled after 4000 s; Newton's last update"


def settled(effect: str, parameters: dict[str, float], window: Window | None = None, **columns: float) -> float:
    """Surface temperature [K] of a thin radiating wall with an effect, after more than an hour."""
    w = wall((material(emissivity=EPS), 0.001))
    held = {"h_ref_kg_m2_s": FILM, "H_r_J_kg": H_R, "p_surface_Pa": P_PA} | columns
    used = (use(effect, parameters, window),)
    return float(heat(w, flight(LONG_S, **held), nodes=14, parameters=RATIO_ONE, effects=used)[1][-1, 0])


def goulard(T: float, h_D: float, efficiency: float) -> float:
    """Heat flux over that of a fully catalytic wall [-]: atoms of a frozen layer that meet a wall of finite rate.

    1 - [(1 - phi_O) h_O + (1 - phi_N) h_N] / (H_r - h_w), phi = 1 / (1 + Le^(2/3) film / (rho_w k_w)), Le 1.4, oxygen
    first, k_w = gamma sqrt(R T / (2 pi M)). Goulard (1958); gamma: Scott, AIAA 80-1477 (1980).
    """
    moles = 1.0 / 0.02885064
    h_O = min(h_D, 0.42 * moles * 246.790e3)
    h_N = h_D - h_O
    # Moles of a kg of the dissociated mixture, each heat of dissociation over that of a mole of atoms, halved
    mixed = moles + 0.5 * h_O / 246.790e3 + 0.5 * h_N / 470.818e3
    density = P_PA / (mixed * 8.314462618 * T)
    lost = 0.0
    for h, A, T_A, M in ((h_O, 16.0, 10271.0, 0.015999), (h_N, 0.0734, 2219.0, 0.014007)):
        gamma = min(efficiency * A * math.exp(-T_A / T), 1.0)
        rate = density * gamma * math.sqrt(8.314462618 * T / (2.0 * math.pi * M))
        lost += h * (1.0 - rate / (rate + 1.4 ** (2.0 / 3.0) * FILM))
    x = 1e-3 * T
    frozen = 1e6 * (0.00655 + 0.96674 * x + 0.04828 * x**2 + 0.04626 * x**3 - 0.01460 * x**4)
    return 1.0 - lost / (H_R - frozen)


def recombination() -> list[Row]:
    """Walls of no, finite and large recombination in dissociated flow, oxygen alone and with nitrogen."""
    rows = []
    cases = (
        ("noncatalytic", 8.0e6, 0.0),
        ("coated tile", 8.0e6, 1.0),
        ("coated tile, oxygen alone", 2.5e6, 1.0),
        ("a thousand times its coefficients", 8.0e6, 1e3),
    )
    for name, h_D, efficiency in cases:

        def excess(T: float, h_D: float = h_D, efficiency: float = efficiency) -> float:
            return FILM * goulard(T, h_D, efficiency) * (H_R - CP_J_KGK * T) - EPS * SIGMA * T**4

        T = float(brentq(excess, 400.0, 1649.0, xtol=1e-9))
        got = settled("recombination", {"efficiency": efficiency}, dissociation_J_kg=h_D)
        row = f"recombination, {h_D / 1e6:g} MJ/kg of dissociation, {name}: wall"
        source = "Goulard (1958), coefficients of Scott (1980)"
        rows.append(Row(row, T, got, 0.01, "K", source, "digits of R and of molar masses"))
    return rows


def oscillators(T: float) -> float:
    """Enthalpy of frozen 79/21 N2/O2 [J/kg] from rigid rotors and harmonic oscillators of 3393 and 2274 K."""
    vibration = sum(x * theta / math.expm1(theta / T) for x, theta in ((0.79, 3393.0), (0.21, 2274.0)))
    return 8.314462618 / 0.02885064 * (3.5 * T + vibration)


def noncatalytic() -> list[Row]:
    """Flux to a hot wall at which no atom recombines: fully catalytic flux less film times heat of dissociation."""
    rows = []
    for T, h_D in ((300.0, 8e6), (1200.0, 8e6), (1600.0, 1.2e7)):
        stack = wall((material(), 0.01), initial_K=T)
        used = (use("recombination", {"efficiency": 0.0}),)
        ensemble = pack([PointModel("p", stack, nodes=14, parameters=RATIO_ONE, effects=used)])
        held = {"h_ref_kg_m2_s": FILM, "H_r_J_kg": H_R, "p_surface_Pa": P_PA, "dissociation_J_kg": h_D}
        ensemble.begin(flight([0.0], **held)[:, 0])
        driving = H_R - oscillators(T)
        got = float(ensemble.film_kg_m2_s[0]) * driving / 1e3
        name = f"noncatalytic wall at {T:g} K, {h_D / 1e6:g} of {H_R / 1e6:g} MJ/kg of dissociation: flux"
        source, is_ = "film (H_r - h_w - h_D), Le = 1, h_w of rotors and oscillators", "0.34 % of h_w"
        limit = 3.4e-3 * oscillators(T) * FILM / 1e3
        rows.append(Row(name, FILM * (driving - h_D) / 1e3, got, limit, "kW/m2", source, is_))
    return rows


def momentum_criterion(V: float, rho: float, T_inf: float, angle_deg: float, length_m: float) -> float:
    """Re_theta / M_e [-] of a laminar layer at 1100 K with properties, shock and speed of sound of Cantera.

    Beyond 57.5 deg, where the shock of a cone detaches, M_e is the one there; it is at least 1.
    """

    def edge(deg: float) -> tuple[float, float, float, float]:
        p, p_0 = rho * 8314.462618 / 28.85064 * T_inf, shock_by_cantera(rho, V, T_inf)[2]
        u_e, p_e = V * math.cos(math.radians(deg)), p + (p_0 - p) * math.sin(math.radians(deg)) ** 2
        h_e = equilibrium(T_inf, p)[0] + 0.5 * (V * V - u_e * u_e)
        T_e = float(brentq(lambda T: equilibrium(T, p_e)[0] - h_e, 200.0, 11000.0, xtol=0.01))
        return p_e, h_e, u_e, T_e

    p_e, h_e, u_e, T_e = edge(angle_deg)
    bound_p, _, bound_u, bound_T = edge(min(angle_deg, 57.5))
    mach = max(bound_u / sound_by_cantera(bound_T, bound_p), 1.0)
    air = isobar(p_e, T_e + 1500.0)
    star = 0.28 * h_e + 0.5 * air.enthalpy(1100.0) + 0.22 * (h_e + 0.5 * math.sqrt(0.71) * u_e * u_e)
    rho_mu = float(air.density(np.array(star)) * air.viscosity(np.array(star)))
    re_theta = 0.664 * math.sqrt(rho_mu * u_e * length_m / 3.0) / float(air.viscosity(np.array(h_e)))
    return re_theta / mach


def criterion() -> list[Row]:
    """Criterion of transition on windward and steep surfaces, and on a flap behind a windward surface."""
    rows = []
    V, rho, T_inf, length = 3870.0, 5.09e-4, 262.0, 29.8
    for alpha, flap in ((40.0, 0.0), (40.0, 15.0), (57.5, 0.0), (80.0, 0.0), (89.5, 0.0)):
        state = Conditions({"time_s": np.zeros(1)}).with_columns(
            rho_kg_m3=rho, velocity_m_s=V, T_inf_K=T_inf, alpha_deg=alpha, beta_deg=0.0, log10_re=6.6, elevon_deg=0.0,
            bodyflap_deg=flap,
        )  # fmt: skip
        flow = EdgeFlow(Recovery("edge-laminar", bodyflap_factor=1.0), length, True)
        got = float(10.0 ** edge_flow_columns(flow, state)["log10_re_theta_m"][0])
        expected = momentum_criterion(V, rho, T_inf, alpha, length)
        name = f"Re_theta/M_e at {V:g} m/s, surface at {alpha:g} deg" + (f", flap {flap:g} deg" if flap else "")
        source, is_ = "Eckert's layer, Cantera; flap: the layer ahead of it", "15 K of T(h, p), 0.4 % of h: 1 %"
        rows.append(within(0.01, name, expected, got, "", source, is_))
    return rows


def transition() -> list[Row]:
    """Heating and recovery enthalpy at the onset and far beyond it."""
    rows = []
    rise, factor = 6e5, 3.0
    for name, decades, share in (("at its onset", 0.0, 0.5), ("a decade beyond", 1.0, 1.0)):
        ratio, H_r = 1.0 + (factor - 1.0) * share, H_R + share * rise
        T = float(brentq(lambda T, r=ratio, H=H_r: FILM * r * (H - CP_J_KGK * T) - EPS * SIGMA * T**4, 400.0, 3000.0))
        parameters = {"log10_re_onset": 6.5, "width": 0.03, "factor": factor}
        got = settled("transition", parameters, log10_re=6.5 + decades, H_r_rise_J_kg=rise, alpha_deg=40.0)
        source = "ratio and recovery enthalpy by intermittency 1/2 and 1"
        rows.append(Row(f"transition, factor 3, {name}: wall", T, got, 1e-5, "K", source, SETTLED))
    return rows


def windowed() -> list[Row]:
    """A factor of 1.3 within Mach 18 to 30, over a ramp of 2 at either end: all, half and nothing of it."""
    rows, fast = [], Window("fast", "mach", 18.0, 30.0, ramp=2.0)
    for mach, factor in ((25.0, 1.3), (19.0, 1.15), (16.0, 1.0)):

        def excess(T: float, factor: float = factor) -> float:
            return factor * FILM * (H_R - CP_J_KGK * T) - EPS * SIGMA * T**4

        expected = float(brentq(excess, 500.0, 6000.0, xtol=1e-10))
        got = settled("jet-interaction", {"jet_gain": 0.3}, fast, mach=mach, jets=1.0)
        name = f"factor of 1.3 within Mach 18 to 30, ramp 2, at Mach {mach:g}"
        rows.append(Row(name, expected, got, 1e-5, "K", "radiation balance", SETTLED))
    return rows


def rows() -> list[Row]:
    """All of this subject."""
    with_cantera = criterion() if cantera_air() is not None else []
    return [*recombination(), *noncatalytic(), *transition(), *windowed(), *with_cantera]
