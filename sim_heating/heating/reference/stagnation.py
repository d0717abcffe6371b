"""Stagnation-point heating of a sphere as a film coefficient: Fay-Riddell, Detra-Kemp-Riddell, Sutton-Graves.

The film coefficient is h_ref = q_ref / (h_0 - h_w) [kg/(m2 s)] for a cold wall of 300 K; it goes with the recovery
enthalpy H_r = V^2/2 + cp T_inf. The three differ by about 6 % in q between 6 and 7.5 km/s: a heating ratio belongs to
one of them.

In the two correlations h_0 - h_w is V^2/2 + cp (T_inf - 300 K), which changes sign at about 400 m/s in cold air. Below
850 m/s the film coefficient is therefore taken from the formula's own speed group, q_ref / (V^2/2), times a factor that
leaves its value at 850 m/s with a continuous slope and is constant below 550 m/s. Fay-Riddell has no such singularity.
A body at rest is heated as at 1 m/s: natural convection is not modelled, a positive film coefficient is.
"""

from __future__ import annotations

import math

from sim_heating.base.kernels.jit import njit
from sim_heating.heating.atmosphere import CP_AIR, GAMMA
from sim_heating.heating.reference.gas import (
    PRANDTL,
    R_TABLE,
    air_density_kernel,
    air_density_of_enthalpy_kernel,
    air_kernel,
    air_temperature_kernel,
    viscosity_kernel,
)

COLD_WALL_K = 300.0
"""Wall temperature of the reference heat flux."""
SLOWEST_M_S = 1.0
"""Speed below which a body is heated as at this speed."""
SPEED_EXACT_M_S = 850.0
"""Speed from which the film coefficient is q_ref/(h_0 - h_w) exactly."""
SPEED_HELD_M_S = 550.0
"""Speed below which the ratio (V^2/2) / (h_0 - h_w) is held."""
SPEED_HELD_AT_M_S = 0.5 * (SPEED_EXACT_M_S + SPEED_HELD_M_S)
"""Speed at which that held ratio is taken: 700 m/s joins the two with a continuous slope."""

SUTTON_GRAVES = 1.7415e-4
"""Of q = K sqrt(rho/R) V^3 in SI; Sutton & Graves, NASA TR R-376 (1971), for air."""
DKR_W_M2 = 1.1035e8
DKR_RHO_KG_M3 = 1.225
DKR_V_M_S = 7924.8
DKR_EXPONENT = 3.15
"""Detra, Kemp & Riddell (1957): 17 600 Btu/(ft2 s) at 26 000 ft/s and sea-level density on R = 1 ft."""
FAY_RIDDELL = 0.763
"""Fay & Riddell (1958), eq. 58, axisymmetric, equilibrium boundary layer."""
LEWIS_EXPONENT = 0.52
NO_LEWIS = 1.0
"""Lewis number of the reference model: 1, the diffusion term left out (1.4 adds about 10 % at 7 km/s)."""

STRONG_SHOCK = 0.08
"""Density ratio that the search for a shock begins at: that of most of an entry is 0.06 to 0.1."""
SECANT_STEPS = 12
NARROWEST, WIDEST = 0.01, 0.999
"""Density ratios between which a shock is looked for; above there is none."""
SHOCK_STEPS = 40
SHOCK_TOLERANCE = 1.0e-10


@njit
def _enthalpy_factor(V: float, T_inf_K: float) -> float:
    """(V^2/2) / (h_0 - h_w300), held smoothly at low speed."""
    v = V
    if V < SPEED_EXACT_M_S:
        above = max(V - SPEED_HELD_M_S, 0.0)
        v = SPEED_HELD_AT_M_S + 0.5 * above * above / (SPEED_EXACT_M_S - SPEED_HELD_M_S)
    kinetic = 0.5 * v * v
    return kinetic / (kinetic + CP_AIR * (T_inf_K - COLD_WALL_K))


@njit
def sutton_graves_kernel(rho_kg_m3: float, velocity_m_s: float, T_inf_K: float, nose_radius_m: float) -> float:
    """Film coefficient h_ref [kg/(m2 s)] of q = 1.7415e-4 (rho/R)^0.5 V^3.

    Source: Sutton & Graves, NASA TR R-376 (1971). Validity: equilibrium air, 2 to 8 km/s; T_inf above 100 K here.
    The speed group below 850 m/s is 2 K sqrt(rho/R) V.
    """
    V = max(velocity_m_s, SLOWEST_M_S)
    return 2.0 * SUTTON_GRAVES * math.sqrt(rho_kg_m3 / nose_radius_m) * V * _enthalpy_factor(V, T_inf_K)


@njit
def detra_kemp_riddell_kernel(rho_kg_m3: float, velocity_m_s: float, T_inf_K: float, nose_radius_m: float) -> float:
    """Film coefficient h_ref [kg/(m2 s)] of q = 1.1035e8 R^-0.5 (rho/1.225)^0.5 (V/7924.8)^3.15, cold wall.

    Source: Detra, Kemp & Riddell, Jet Propulsion 27 (1957) 1256. Validity: 2 to 8 km/s.
    """
    V = max(velocity_m_s, SLOWEST_M_S)
    q = DKR_W_M2 * math.sqrt(rho_kg_m3 / (DKR_RHO_KG_M3 * nose_radius_m)) * (V / DKR_V_M_S) ** DKR_EXPONENT
    return q / (0.5 * V * V) * _enthalpy_factor(V, T_inf_K)


@njit
def _behind_shock(eps: float, rho: float, V: float, p: float, h: float) -> tuple[float, float]:
    """Pressure and enthalpy behind a normal shock of density ratio eps = rho_1/rho_2, from momentum and energy."""
    return p + rho * V * V * (1.0 - eps), h + 0.5 * V * V * (1.0 - eps * eps)


@njit
def _shock_residual(eps: float, rho: float, V: float, p: float, h: float) -> float:
    """Zero at the shock's density ratio; the trivial root (no shock, eps = 1) is divided out."""
    p_2, h_2 = _behind_shock(eps, rho, V, p, h)
    return (eps - rho / air_density_of_enthalpy_kernel(h_2, p_2)) / (1.0 - eps)


@njit
def shock_density_ratio(rho_kg_m3: float, velocity_m_s: float, p_Pa: float, h_J_kg: float) -> float:
    """rho_1/rho_2 across a normal shock in equilibrium air, from mass, momentum and energy; 1 where there is no shock.

    Secants from a strong shock: three or four of them in an entry. Where one leaves the bracket, or they do not
    converge, regula falsi (Illinois) in a shrinking bracket, never more than 40 steps.
    """
    eps, before, f_before = STRONG_SHOCK, 0.0, 0.0
    for k in range(SECANT_STEPS):
        f = _shock_residual(eps, rho_kg_m3, velocity_m_s, p_Pa, h_J_kg)
        if abs(f) < SHOCK_TOLERANCE:
            return eps
        # The first step is what the residual itself says: (1 - eps) f is eps less the ratio that eps leads to.
        move = (1.0 - eps) * f if k == 0 else f * (eps - before) / (f - f_before)
        before, f_before, eps = eps, f, eps - move
        if not NARROWEST < eps < WIDEST:
            break
    low, high = NARROWEST, WIDEST
    f_high = _shock_residual(high, rho_kg_m3, velocity_m_s, p_Pa, h_J_kg)
    if not f_high > 0.0:
        return 1.0
    f_low = _shock_residual(low, rho_kg_m3, velocity_m_s, p_Pa, h_J_kg)
    side = 0
    for _ in range(SHOCK_STEPS):
        eps = (low * f_high - high * f_low) / (f_high - f_low)
        f = _shock_residual(eps, rho_kg_m3, velocity_m_s, p_Pa, h_J_kg)
        if abs(f) < SHOCK_TOLERANCE or high - low < SHOCK_TOLERANCE:
            return eps
        if f > 0.0:
            high, f_high = eps, f
            f_low *= 0.5 if side == 1 else 1.0  # Illinois: no end of the bracket stays for ever
            side = 1
        else:
            low, f_low = eps, f
            f_high *= 0.5 if side == -1 else 1.0
            side = -1
    return eps


@njit
def stagnation_kernel(rho_kg_m3: float, velocity_m_s: float, T_inf_K: float) -> tuple[float, float, float, float]:
    """Stagnation pressure [Pa], enthalpy [J/kg], density [kg/m3] in equilibrium air, and free-stream pressure [Pa].

    Normal shock where the flow is supersonic, then isentropic compression to rest: dh = (p/rho) dln p by the
    trapezoidal rule, three passes. The free-stream pressure is rho R T of the table's own gas, for consistency.
    """
    p = rho_kg_m3 * R_TABLE * T_inf_K
    h = air_kernel(T_inf_K, p)[0]
    h_0 = h + 0.5 * velocity_m_s * velocity_m_s
    p_2, h_2, rho_2 = p, h, rho_kg_m3
    if velocity_m_s * velocity_m_s > GAMMA * R_TABLE * T_inf_K:
        eps = shock_density_ratio(rho_kg_m3, velocity_m_s, p, h)
        p_2, h_2 = _behind_shock(eps, rho_kg_m3, velocity_m_s, p, h)
        rho_2 = rho_kg_m3 / eps
    p_0, rho_0 = p_2, rho_2
    for _ in range(3):
        p_0 = p_2 * math.exp(2.0 * (h_0 - h_2) / (p_2 / rho_2 + p_0 / rho_0))
        rho_0 = air_density_of_enthalpy_kernel(h_0, p_0)
    return p_0, h_0, rho_0, p


@njit
def fay_riddell_film(
    p_0: float, h_0: float, rho_0: float, p_inf: float, nose_radius_m: float, T_w_K: float, lewis: float
) -> float:
    """Film coefficient of Fay & Riddell (1958) eq. 58 from the stagnation state [kg/(m2 s)].

    h = 0.763 Pr^-0.6 (rho_w mu_w)^0.1 (rho_e mu_e)^0.4 [1 + (Le^0.52 - 1) h_D/h_0] (du_e/dx)^0.5
    du_e/dx = (1/R) sqrt(2 (p_e - p_inf) / rho_e)
    """
    T_0 = air_temperature_kernel(h_0, p_0)
    wall = air_density_kernel(T_w_K, p_0) * viscosity_kernel(T_w_K)
    gradient = math.sqrt(2.0 * max(p_0 - p_inf, 0.0) / rho_0) / nose_radius_m
    film = FAY_RIDDELL * PRANDTL**-0.6 * wall**0.1 * (rho_0 * viscosity_kernel(T_0)) ** 0.4 * math.sqrt(gradient)
    if lewis == NO_LEWIS:
        return film
    return film * (1.0 + (lewis**LEWIS_EXPONENT - 1.0) * air_kernel(T_0, p_0)[2] / h_0)


@njit
def fay_riddell_kernel(
    rho_kg_m3: float, velocity_m_s: float, T_inf_K: float, nose_radius_m: float, T_w_K: float, lewis: float
) -> float:
    """Film coefficient h_ref [kg/(m2 s)] of Fay & Riddell, J. Aero. Sci. 25 (1958) 73.

    Stagnation state of equilibrium air behind a normal shock; viscosity of `gas.viscosity`; Pr = 0.71, so that
    0.763 Pr^-0.6 = 0.937. The reference model has Lewis number 1 and a wall of 300 K.
    Validity: equilibrium boundary layer (or frozen with a fully catalytic wall), 1.5 to 8 km/s, continuum (below about
    90 km).
    """
    V = max(velocity_m_s, SLOWEST_M_S)
    p_0, h_0, rho_0, p = stagnation_kernel(rho_kg_m3, V, T_inf_K)
    return fay_riddell_film(p_0, h_0, rho_0, p, nose_radius_m, T_w_K, lewis)
