"""Stagnation heating as a film coefficient: Fay-Riddell on a sphere or cylinder, Detra-Kemp-Riddell, Sutton-Graves.

The film coefficient is h_ref = q_ref / (h_0 - h_w) [kg/(m2 s)] for a cold wall of 300 K; it is used with the recovery
enthalpy H_r = V^2/2 + cp T_inf. The three models differ by about 12 % in q between 6 and 7.5 km/s, so that a heating
ratio is valid only with the model over which it was formed.

Each function here is a published formula in continuum flow. `low_speed` says where the two correlations end and
Fay-Riddell takes over, `rarefied` bridges all of them to free-molecular flow; `models` applies both.
Fay-Riddell holds from rest on: its velocity gradient is that of Newtonian pressure in supersonic flow and that of
potential flow in subsonic flow. A body at rest is heated as at 1 m/s: natural convection is not modelled.
Equations: docs/theory/equations_reference_heating.md, equations 9 to 14 and 31.
"""

from __future__ import annotations

import math

from sim_heating.base.kernels.jit import njit
from sim_heating.heating.atmosphere import CP_AIR, GAMMA
from sim_heating.heating.reference.gas import (
    PRANDTL,
    R_TABLE,
    air_density_of_enthalpy_kernel,
    air_kernel,
    air_state_kernel,
    air_temperature_kernel,
    air_transport_kernel,
)

COLD_WALL_K = 300.0
"""Wall temperature of the reference heat flux [K]."""
SLOWEST_M_S = 1.0
"""Speed [m/s] below which a body is heated as at this speed."""
SUTTON_GRAVES = 1.7415e-4
"""K of q = K sqrt(rho/R) V^3 in SI; Sutton & Graves, NASA TR R-376 (1971), for air."""
DKR_W_M2 = 1.1035e8
DKR_RHO_KG_M3 = 1.225
DKR_V_M_S = 7924.8
DKR_EXPONENT = 3.15
"""Detra, Kemp & Riddell (1957): 17 600 Btu/(ft2 s) at 26 000 ft/s and sea-level density on R = 1 ft."""
FAY_RIDDELL = 0.763
"""Constant of Fay & Riddell (1958), eq. 63, axisymmetric, equilibrium boundary layer."""

SPHERE = (1.5, 0.252, 0.0175, 1.0, 1.4)
CYLINDER = (2.0, 0.416, 0.164, 0.8, 1.1)
"""Velocity gradient of a body in subsonic flow, R/V du_e/dx = K (1 - a M^2 - b M^4), as K, a, b, and the Mach numbers
between which it gives way to that of Newtonian pressure. Source: White, Viscous Fluid Flow (1991), section 7-4."""
LEWIS_EXPONENT = 0.52
NO_LEWIS = 1.0
"""Lewis number of the reference model: 1, the diffusion term left out (1.4 adds 12 to 13 % at 7 km/s)."""

STRONG_SHOCK = 0.08
"""Density ratio [-] that the search for a shock starts at: it is 0.06 to 0.1 in most of an entry."""
SECANT_STEPS = 12
NARROWEST, WIDEST = 0.01, 0.999
"""Density ratios [-] between which a shock is searched for; a weaker one counts as no shock."""
SHOCK_STEPS = 40
SHOCK_TOLERANCE = 1.0e-10


@njit
def _over_cold_wall(q_W_m2: float, V: float, T_inf_K: float) -> float:
    """q / (h_0 - h_w) [kg/(m2 s)], h_0 - h_w = V^2/2 + cp (T_inf - 300 K), positive above 650 m/s at 100 K and more."""
    return q_W_m2 / (0.5 * V * V + CP_AIR * (T_inf_K - COLD_WALL_K))


@njit
def sutton_graves_kernel(rho_kg_m3: float, velocity_m_s: float, T_inf_K: float, nose_radius_m: float) -> float:
    """Film coefficient h_ref [kg/(m2 s)] of Sutton and Graves, q = 1.7415e-4 (rho/R)^0.5 V^3 [W/m2], cold wall.

    rho_kg_m3, velocity_m_s, T_inf_K : free-stream density [kg/m3], speed [m/s], temperature [K], above 100
    nose_radius_m                    : R of the sphere [m]
    Valid for equilibrium air, 2.3 to 116 MJ/kg, which is 2 to 15 km/s. Not for use below 1 km/s.
    Source: Sutton and Graves, NASA TR R-376 (1971); docs/theory/equations_reference_heating.md, equation 10.
    """
    V = velocity_m_s
    return _over_cold_wall(SUTTON_GRAVES * math.sqrt(rho_kg_m3 / nose_radius_m) * V * V * V, V, T_inf_K)


@njit
def detra_kemp_riddell_kernel(rho_kg_m3: float, velocity_m_s: float, T_inf_K: float, nose_radius_m: float) -> float:
    """Film coefficient h_ref [kg/(m2 s)] of Detra, Kemp and Riddell, cold wall.

        q = 1.1035e8 R^-0.5 (rho / 1.225)^0.5 (V / 7924.8)^3.15 [W/m2]

    rho_kg_m3, velocity_m_s, T_inf_K : free-stream density [kg/m3], speed [m/s], temperature [K], above 100
    nose_radius_m                    : R of the sphere [m]
    Valid from 2 to 8 km/s. Not for use below 1 km/s.
    Source: Detra, Kemp and Riddell (1957), Jet Propulsion 27, 1256; docs/theory/equations_reference_heating.md,
    equation 11.
    """
    V = velocity_m_s
    q = DKR_W_M2 * math.sqrt(rho_kg_m3 / (DKR_RHO_KG_M3 * nose_radius_m)) * (V / DKR_V_M_S) ** DKR_EXPONENT
    return _over_cold_wall(q, V, T_inf_K)


@njit
def _behind_shock(eps: float, rho: float, V: float, p: float, h: float) -> tuple[float, float]:
    """Pressure [Pa], enthalpy [J/kg] behind a normal shock of density ratio rho_1/rho_2, from momentum and energy."""
    return p + rho * V * V * (1.0 - eps), h + 0.5 * V * V * (1.0 - eps * eps)


@njit
def _shock_residual(eps: float, rho: float, V: float, p: float, h: float) -> float:
    """Zero at the shock's density ratio [-]; the trivial root (no shock, eps = 1) is divided out."""
    p_2, h_2 = _behind_shock(eps, rho, V, p, h)
    return (eps - rho / air_density_of_enthalpy_kernel(h_2, p_2)) / (1.0 - eps)


@njit
def shock_density_ratio(rho_kg_m3: float, velocity_m_s: float, p_Pa: float, h_J_kg: float) -> float:
    """Density ratio eps = rho_1/rho_2 [-] across a normal shock in equilibrium air; 1 where there is no shock.

        p_2 = p + rho V^2 (1 - eps),   h_2 = h + V^2/2 (1 - eps^2),   eps = rho / rho_air(h_2, p_2)

    rho_kg_m3, velocity_m_s, p_Pa, h_J_kg : free stream [kg/m3], [m/s], [Pa], [J/kg]

    Secants from a strong shock: three or four of them in an entry. Where one leaves the bracket 0.01 to 0.999, or they
    do not converge to 1e-10, regula falsi (Illinois) in a shrinking bracket, never more than 40 steps.
    Source: docs/theory/equations_reference_heating.md, equation 13.
    """
    eps, before, f_before = STRONG_SHOCK, 0.0, 0.0
    for k in range(SECANT_STEPS):
        f = _shock_residual(eps, rho_kg_m3, velocity_m_s, p_Pa, h_J_kg)
        if abs(f) < SHOCK_TOLERANCE:
            return eps
        # No second point for a secant yet: a fixed-point step, as (1 - eps) f is eps less the ratio that eps leads to.
        change = (1.0 - eps) * f if k == 0 else f * (eps - before) / (f - f_before)
        before, f_before, eps = eps, f, eps - change
        if not NARROWEST < eps < WIDEST:
            break
    low, high = NARROWEST, WIDEST
    f_high = _shock_residual(high, rho_kg_m3, velocity_m_s, p_Pa, h_J_kg)
    # No sign change below the trivial root: the flow is too slow for a shock. Also where f_high is not a number.
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
            f_low *= 0.5 if side == 1 else 1.0  # Illinois: without halving, one end of the bracket can stay fixed
            side = 1
        else:
            low, f_low = eps, f
            f_high *= 0.5 if side == -1 else 1.0
            side = -1
    return eps


@njit
def stagnation_kernel(rho_kg_m3: float, velocity_m_s: float, T_inf_K: float) -> tuple[float, float, float, float]:
    """Stagnation pressure [Pa], enthalpy [J/kg], density [kg/m3] in equilibrium air, and free-stream pressure [Pa].

    rho_kg_m3, velocity_m_s, T_inf_K : free-stream density [kg/m3], speed [m/s], temperature [K]

    Normal shock where the flow is supersonic, then isentropic compression to rest: dh = (p/rho) dln p by the
    trapezoidal rule, three passes. The free-stream pressure is rho R T of the table's own gas, for consistency.
    Source: docs/theory/equations_reference_heating.md, equation 13.
    """
    p = rho_kg_m3 * R_TABLE * T_inf_K
    h = air_kernel(T_inf_K, p)[0]
    h_0 = h + 0.5 * velocity_m_s * velocity_m_s
    p_2, h_2, rho_2 = p, h, rho_kg_m3
    # gamma 1.4 only decides whether there is a shock: near Mach 1 it is weak, and both branches give nearly one state.
    if mach_of_table_gas(velocity_m_s, T_inf_K) > 1.0:
        eps = shock_density_ratio(rho_kg_m3, velocity_m_s, p, h)
        p_2, h_2 = _behind_shock(eps, rho_kg_m3, velocity_m_s, p, h)
        rho_2 = rho_kg_m3 / eps
    p_0, rho_0 = p_2, rho_2
    # Three passes: behind a strong shock ln(p_0/p_2) is small, and each pass lowers its error a thousandfold.
    for _ in range(3):
        p_0 = p_2 * math.exp(2.0 * (h_0 - h_2) / (p_2 / rho_2 + p_0 / rho_0))
        rho_0 = air_density_of_enthalpy_kernel(h_0, p_0)
    return p_0, h_0, rho_0, p


@njit
def smooth_share(x: float, low: float, high: float) -> float:
    """Share 3 s^2 - 2 s^3 [-] of a blend, s the place of x between low and high: 0 and 1 with zero slope at the ends.

    Source: the cubic step of docs/theory/equations_reference_heating.md, equation 12; a choice.
    """
    s = min(max((x - low) / (high - low), 0.0), 1.0)
    return s * s * (3.0 - 2.0 * s)


@njit
def velocity_gradient(
    p_0: float,
    rho_0: float,
    p_inf: float,
    velocity_m_s: float,
    mach: float,
    radius_m: float,
    body: tuple[float, float, float, float, float],
) -> float:
    """Gradient du_e/dx [1/s] of the edge speed at a sphere's stagnation point or a cylinder's stagnation line.

        supersonic  du_e/dx = (1/R) sqrt(2 (p_0 - p_inf) / rho_0)       (Newtonian pressure)
        subsonic    du_e/dx = (V/R) K (1 - a M^2 - b M^4)               (potential flow; K 3/2 sphere, 2 cylinder)

    p_0, rho_0, p_inf  : stagnation pressure [Pa] and density [kg/m3], free-stream pressure [Pa]
    velocity_m_s, mach : of the free stream [m/s], [-];  radius_m : R [m];  body : SPHERE or CYLINDER
    The two cross near Mach 1.2 (sphere) and 1 (cylinder), where one gives way to the other with a continuous slope.
    Source: docs/theory/equations_reference_heating.md, equations 14 and 31 (Fay and Riddell 1958; White 1991).
    """
    K, a, b, low, high = body
    weight = smooth_share(mach, low, high)
    slow = fast = 0.0
    if weight < 1.0:
        m2 = mach * mach
        slow = velocity_m_s * K * (1.0 - m2 * (a + b * m2))
    if weight > 0.0:
        fast = math.sqrt(2.0 * (p_0 - p_inf) / rho_0)
    return (slow + weight * (fast - slow)) / radius_m


@njit
def fay_riddell_film(p_0: float, h_0: float, rho_0: float, gradient_1_s: float, T_w_K: float, lewis: float) -> float:
    """Film coefficient of Fay and Riddell [kg/(m2 s)] from the stagnation state of equilibrium air, axisymmetric.

        h = 0.763 Pr^-0.6 (rho_w mu_w)^0.1 (rho_e mu_e)^0.4 [1 + (Le^0.52 - 1) h_D/h_0] (du_e/dx)^0.5

    p_0, h_0, rho_0 : stagnation pressure [Pa], enthalpy [J/kg], density [kg/m3]
    gradient_1_s    : du_e/dx [1/s];  T_w_K : wall temperature [K];  lewis : Lewis number Le [-]
    Source: Fay and Riddell (1958), J. Aero. Sci. 25, 73, eq. 63; docs/theory/equations_reference_heating.md,
    equation 14.
    """
    _, mu_0 = air_state_kernel(h_0, p_0)
    rho_w, mu_w = air_transport_kernel(T_w_K, p_0)
    film = FAY_RIDDELL * PRANDTL**-0.6 * (rho_w * mu_w) ** 0.1 * (rho_0 * mu_0) ** 0.4 * math.sqrt(gradient_1_s)
    # The reference model, without the table lookup that h_D takes.
    if lewis == NO_LEWIS:
        return film
    return film * (1.0 + (lewis**LEWIS_EXPONENT - 1.0) * air_kernel(air_temperature_kernel(h_0, p_0), p_0)[2] / h_0)


@njit
def mach_of_table_gas(velocity_m_s: float, T_inf_K: float) -> float:
    """Mach number V / sqrt(1.4 R T) [-] of the undissociated gas of the equilibrium table, for branches and blends.

    velocity_m_s, T_inf_K : of the free stream [m/s], [K]
    Source: docs/theory/equations_reference_heating.md, equation 2.
    """
    return velocity_m_s / math.sqrt(GAMMA * R_TABLE * T_inf_K)


@njit
def fay_riddell_of_state(
    state: tuple[float, float, float, float],
    velocity_m_s: float,
    T_inf_K: float,
    nose_radius_m: float,
    T_w_K: float,
    lewis: float,
) -> float:
    """Film coefficient of Fay and Riddell [kg/(m2 s)] on a sphere, from the result of `stagnation_kernel`.

    state : stagnation pressure [Pa], enthalpy [J/kg], density [kg/m3], free-stream pressure [Pa]
    velocity_m_s, T_inf_K, nose_radius_m, T_w_K, lewis : as `fay_riddell_kernel` takes them; speed above 0
    Source: docs/theory/equations_reference_heating.md, equations 14 and 31.
    """
    p_0, h_0, rho_0, p = state
    mach = mach_of_table_gas(velocity_m_s, T_inf_K)
    gradient = velocity_gradient(p_0, rho_0, p, velocity_m_s, mach, nose_radius_m, SPHERE)
    return fay_riddell_film(p_0, h_0, rho_0, gradient, T_w_K, lewis)


@njit
def fay_riddell_kernel(
    rho_kg_m3: float, velocity_m_s: float, T_inf_K: float, nose_radius_m: float, T_w_K: float, lewis: float
) -> float:
    """Film coefficient h_ref [kg/(m2 s)] of Fay and Riddell on a sphere in a given free stream, continuum.

    rho_kg_m3, velocity_m_s, T_inf_K : free-stream density [kg/m3], speed [m/s], temperature [K]
    nose_radius_m, T_w_K             : radius of the sphere [m], wall temperature [K], 300 in the reference model
    lewis                            : Lewis number [-], 1 in the reference model

    Stagnation state of equilibrium air behind a normal shock; viscosity of `gas.transport`; Pr = 0.71, so that
    0.763 Pr^-0.6 = 0.937. Valid for an equilibrium boundary layer (or a frozen one with a fully catalytic wall), from
    rest to 8 km/s; continued above.
    Source: Fay and Riddell (1958), J. Aero. Sci. 25, 73; docs/theory/equations_reference_heating.md, equations 13, 14
    and 31.
    """
    V = max(velocity_m_s, SLOWEST_M_S)
    return fay_riddell_of_state(stagnation_kernel(rho_kg_m3, V, T_inf_K), V, T_inf_K, nose_radius_m, T_w_K, lewis)
