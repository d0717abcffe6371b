"""Flat-plate heating by Eckert's reference enthalpy, laminar and turbulent, and the edge state of a windward surface.

    h* = 0.28 h_e + 0.5 h_w + 0.22 h_aw,   h_aw = h_e + r u_e^2/2,   r = Pr^1/2 laminar, Pr^1/3 turbulent
    film coefficient h = rho* u_e C_h [kg/(m2 s)],   q = h (h_aw - h_w)
    C_h = 0.332 Re*^-1/2 Pr^-2/3 laminar;  0.0296 Re*^-1/5 Pr^-2/3 turbulent, 0.185 (log10 Re*)^-2.584 Pr^-2/3 above 1e7

rho*, mu* at the temperature of h* and the edge pressure, in equilibrium air; Re* = rho* u_e x / mu*.
Source: Eckert, Trans. ASME 78 (1956) 1273; Schultz-Grunow, Luftfahrtforschung 17 (1940) 239.
Validity: attached boundary layer on a flat surface, no slip (x above some millimetres, below about 90 km); the laminar
law from Re* 1e3, the turbulent one from 5e5; both are continued outside without a warning, because a reference has to
have a value everywhere. Equations: docs/theory/equations_reference_heating.md, equations 15 to 18.
"""

from __future__ import annotations

import math

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import Conditions
from sim_heating.base.kernels.jit import njit
from sim_heating.heating.reference.gas import PRANDTL, air_kernel, air_state_kernel
from sim_heating.heating.reference.recovery import edge_speed, recovery_factor
from sim_heating.heating.reference.stagnation import SLOWEST_M_S, stagnation_kernel

LAMINAR_C = 0.332
TURBULENT_C = 0.0296
SCHULTZ_GRUNOW_C = 0.185
SCHULTZ_GRUNOW_EXPONENT = -2.584
SCHULTZ_GRUNOW_LOG_RE = 7.0
SCHULTZ_GRUNOW_FULL_LOG_RE = 7.3
"""The two turbulent laws differ by 3 % at 1e7: one blends into the other, linearly in log10 Re*, from 1e7 to 2e7."""
FRICTION_WALL_K = 1000.0
"""Wall temperature at which skin friction is estimated [K]."""
DIVERGING_LAMINAR = math.sqrt(3.0)
DIVERGING_TURBULENT = 1.176
"""Factors on h where the flow diverges from a point (a cone against a plate)."""


@njit
def windward_edge_kernel(
    rho_kg_m3: float, velocity_m_s: float, T_inf_K: float, alpha_deg: float
) -> tuple[float, float, float]:
    """Edge pressure [Pa], enthalpy [J/kg] and speed [m/s] on a flat surface at an angle of attack.

        p_e = p_inf + (p_0 - p_inf) sin^2 alpha (modified Newtonian),  u_e = V cos alpha,  h_e = h_0 - u_e^2/2

    rho_kg_m3, velocity_m_s, T_inf_K : free-stream density [kg/m3], speed [m/s], temperature [K]
    alpha_deg                        : angle of the surface against the flow [deg]

    p_0 is the stagnation pressure behind a normal shock in equilibrium air (p_0 - p_inf = 0.5 Cp_max rho V^2, with
    Cp_max about 1.94 at 6 km/s, where a gas with gamma 1.4 has 1.84). Leeward and zero incidence have p_e = p_inf.
    The edge speed is at least 1 m/s, also at 90 deg. Source: docs/theory/equations_reference_heating.md, equation 18.
    """
    V = max(velocity_m_s, SLOWEST_M_S)
    p_0, h_0, _, p = stagnation_kernel(rho_kg_m3, V, T_inf_K)
    return windward_edge(p, p_0, h_0, V, alpha_deg)


@njit
def windward_edge(
    p_inf_Pa: float, p_0_Pa: float, h_0_J_kg: float, velocity_m_s: float, angle_deg: float
) -> tuple[float, float, float]:
    """Edge pressure [Pa], enthalpy [J/kg] and speed [m/s] as `windward_edge_kernel`, from the stagnation state.

    p_inf_Pa, p_0_Pa, h_0_J_kg : free-stream and stagnation pressure [Pa], stagnation enthalpy [J/kg]
    velocity_m_s, angle_deg    : free-stream speed [m/s], angle of the surface against the flow [deg]
    Source: docs/theory/equations_reference_heating.md, equation 18.
    """
    # Newtonian pressure acts on the windward side only.
    sine, u_e = max(math.sin(math.radians(angle_deg)), 0.0), edge_speed(velocity_m_s, angle_deg)
    return p_inf_Pa + (p_0_Pa - p_inf_Pa) * sine * sine, h_0_J_kg - 0.5 * u_e * u_e, u_e


@njit
def _turbulent_c(re: float) -> float:
    """C_h Pr^2/3 [-] of the turbulent plate at a Reynolds number Re* [-]."""
    log_re = math.log10(re)
    c = TURBULENT_C * re**-0.2
    if log_re <= SCHULTZ_GRUNOW_LOG_RE:
        return c
    # A blend in place of a switch: a jump of 3 % would show up as a step of the heating ratio.
    w = min((log_re - SCHULTZ_GRUNOW_LOG_RE) / (SCHULTZ_GRUNOW_FULL_LOG_RE - SCHULTZ_GRUNOW_LOG_RE), 1.0)
    return (1.0 - w) * c + w * SCHULTZ_GRUNOW_C * log_re**SCHULTZ_GRUNOW_EXPONENT


@njit
def reference_enthalpy(h_e: float, h_w: float, u_e: float, turbulent: bool) -> float:
    """Eckert's reference enthalpy h* = 0.28 h_e + 0.5 h_w + 0.22 h_aw [J/kg], h_aw = h_e + r u_e^2/2.

    h_e, h_w  : enthalpy at the edge of the boundary layer and at the wall [J/kg];  u_e : edge speed [m/s]
    turbulent : recovery factor r = Pr^1/3 where true, Pr^1/2 otherwise
    Source: Eckert 1956 (Trans. ASME 78, 1273); docs/theory/equations_reference_heating.md, equation 15.
    """
    h_aw = h_e + 0.5 * recovery_factor(turbulent) * u_e * u_e
    return 0.28 * h_e + 0.5 * h_w + 0.22 * h_aw


@njit
def eckert_film(p_e: float, h_e: float, u_e: float, length_m: float, T_w_K: float, turbulent: bool) -> float:
    """Film coefficient h = rho* u_e C_h [kg/(m2 s)] on a flat plate, from the edge state; parallel flow.

    p_e, h_e, u_e : edge pressure [Pa], enthalpy [J/kg], speed [m/s]
    length_m      : running length from the leading edge [m];  T_w_K : wall temperature [K]
    turbulent     : 0.0296 Re*^-1/5 (Schultz-Grunow's law above 1e7) in place of 0.332 Re*^-1/2 for C_h Pr^2/3
    Laminar from Re* 1e3, turbulent from 5e5; continued below without a warning.
    Source: Eckert 1956 (Trans. ASME 78, 1273); docs/theory/equations_reference_heating.md, equations 15 to 17.
    """
    h_w = air_kernel(T_w_K, p_e)[0]
    rho, mu = air_state_kernel(reference_enthalpy(h_e, h_w, u_e, turbulent), p_e)
    re = rho * u_e * length_m / mu
    c = _turbulent_c(re) if turbulent else LAMINAR_C / math.sqrt(re)
    return rho * u_e * c * PRANDTL ** (-2.0 / 3.0)


@njit
def eckert_kernel(
    rho_kg_m3: float,
    velocity_m_s: float,
    T_inf_K: float,
    alpha_deg: float,
    length_m: float,
    T_w_K: float,
    turbulent: bool,
    diverging: bool,
) -> float:
    """Film coefficient h [kg/(m2 s)] of Eckert's flat plate on a windward surface in a given free stream.

    rho_kg_m3, velocity_m_s, T_inf_K : free-stream density [kg/m3], speed [m/s], temperature [K]
    alpha_deg                        : angle of the surface against the flow [deg]
    length_m, T_w_K                  : running length from the leading edge [m], wall temperature [K]
    turbulent                        : turbulent law, else laminar
    diverging                        : flow that diverges from a point: h times 1.176 turbulent, sqrt(3) laminar
    Source: Eckert 1956 (Trans. ASME 78, 1273); docs/theory/equations_reference_heating.md, equations 15 to 18.
    """
    p_e, h_e, u_e = windward_edge_kernel(rho_kg_m3, velocity_m_s, T_inf_K, alpha_deg)
    h = eckert_film(p_e, h_e, u_e, length_m, T_w_K, turbulent)
    if not diverging:
        return h
    return h * (DIVERGING_TURBULENT if turbulent else DIVERGING_LAMINAR)


@njit
def friction_rise_kernel(
    rho_kg_m3: float, velocity_m_s: float, T_inf_K: float, alpha_deg: float, length_m: float
) -> float:
    """Rise of the mean skin friction of a windward plate [Pa] where its boundary layer turns turbulent.

        d tau = Pr^2/3 u_e (5/4 h_turbulent(L) - 2 h_laminar(L))

    length_m : length of the plate [m]; other arguments as of `eckert_kernel`, its wall at FRICTION_WALL_K

    Reynolds' analogy, tau = rho* u_e^2 C_f/2 with C_f/2 = C_h Pr^2/3, that both laws of C_h come from; means over the
    length of what falls as x^-1/5 and x^-1/2. Source: docs/theory/equations_reference_heating.md, equation 17a.
    """
    u_e = edge_speed(max(velocity_m_s, SLOWEST_M_S), alpha_deg)
    turbulent, laminar = (
        eckert_kernel(rho_kg_m3, velocity_m_s, T_inf_K, alpha_deg, length_m, FRICTION_WALL_K, True, False),
        eckert_kernel(rho_kg_m3, velocity_m_s, T_inf_K, alpha_deg, length_m, FRICTION_WALL_K, False, False),
    )
    return PRANDTL ** (2.0 / 3.0) * u_e * (1.25 * turbulent - 2.0 * laminar)


def friction_rise(flown: Conditions, length_m: float) -> FloatArray:
    """(time,) `friction_rise_kernel` along a flight [Pa], for a plate of length_m [m]; not below 0.

    Source: docs/theory/equations_reference_heating.md, equation 17a.
    """
    rho, V, T, alpha = (flown[n] for n in ("rho_kg_m3", "velocity_m_s", "T_inf_K", "alpha_deg"))
    rise = [friction_rise_kernel(rho[i], V[i], T[i], alpha[i], length_m) for i in range(len(flown))]
    return np.maximum(rise, 0.0)
