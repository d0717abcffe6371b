"""Stagnation line of a swept cylinder, as a leading edge is one: film coefficient over its own recovery enthalpy.

The flow along an infinite cylinder does not change along it. The component normal to the axis passes a shock and comes
to rest at the stagnation line; the component along the axis heats by friction, with the recovery factor sqrt(Pr).
Sweep L of the edge at alpha 0 and an angle of attack turn the axis against the flow by an angle whose sine is
sin L cos alpha.

The film coefficient is that of plane stagnation flow with the constant 0.57 of Fay and Riddell (1958). In place of
their factor (rho_w mu_w / rho_e mu_e)^0.1, which makes it 2 to 8 % high at a wall of 300 K, it has one that was fitted
to similarity solutions of equilibrium air: a gas whose enthalpy is proportional to p/rho needs none, and dissociation
adds 7 % at most.
Equations: docs/theory/equations_reference_heating.md, equations 33 and 33a.
"""

from __future__ import annotations

import math

from sim_heating.base.kernels.jit import njit
from sim_heating.heating.reference.gas import PRANDTL, air_density_kernel, air_kernel, air_state_kernel
from sim_heating.heating.reference.recovery import recovery_factor, spanwise_speed
from sim_heating.heating.reference.stagnation import (
    CYLINDER,
    SLOWEST_M_S,
    mach_of_table_gas,
    stagnation_kernel,
    velocity_gradient,
)

FAY_RIDDELL_CYLINDER = 0.57
"""Constant of the stagnation line of a cylinder, in place of the sphere's 0.763 (Fay and Riddell 1958)."""
DISSOCIATED = 0.05
"""Exponent of rho_e h_e / (rho_w h_w), fitted to similarity solutions from 1.2 to 8 km/s, 0 to 60 deg, walls of 300 to
1200 K, which it meets within 1.5 %."""
LINE_RECOVERY = 0.855
"""Recovery factor of the spanwise flow in the same solutions, 0.853 to 0.856; sqrt(Pr) is 0.843."""


@njit
def line_angle(alpha_deg: float, sweep_deg: float) -> float:
    """Angle [deg] of a swept cylinder's stagnation line against the flow, 90 without sweep.

    alpha_deg, sweep_deg : angle of attack, sweep L of the edge at alpha 0 [deg];  cos(angle) = sin L cos alpha
    Source: docs/theory/equations_reference_heating.md, equation 33.
    """
    return math.degrees(math.acos(abs(math.sin(math.radians(sweep_deg)) * math.cos(math.radians(alpha_deg)))))


@njit
def swept_cylinder_film(
    rho_kg_m3: float,
    velocity_m_s: float,
    T_inf_K: float,
    alpha_deg: float,
    sweep_deg: float,
    radius_m: float,
    T_w_K: float,
) -> float:
    """Film coefficient h_ref [kg/(m2 s)] of a swept cylinder's stagnation line, for use with its recovery enthalpy.

        h_n = 0.57 Pr^-0.6 (rho_e mu_e du_e/dx)^1/2 [rho_e h_e / (rho_w h_w)]^0.05,    e at rest behind V_n
        h_ref = h_n [1 + (0.855 - sqrt(Pr)) (w^2/2) / max(H_r - h_w, H_r/2)]

    rho_kg_m3, velocity_m_s, T_inf_K : free-stream density [kg/m3], speed [m/s], temperature [K]
    alpha_deg, sweep_deg             : angle of attack, sweep L of the edge at alpha 0 [deg]
    radius_m, T_w_K                  : radius of the cylinder [m], wall temperature [K], 300 in the reference model

    V_n^2 = V^2 - w^2, w = V sin L cos alpha, H_r = h_e + sqrt(Pr) w^2/2. The second factor gives the flux to the
    reference wall that the recovery factor of the solutions gives. Within 1.5 % of them; laminar.
    Source: Fay and Riddell (1958); independence of the normal flow as in Beckwith and Gallagher, NASA TR R-104 (1961);
    docs/theory/equations_reference_heating.md, equations 33 and 33a.
    """
    V = max(velocity_m_s, SLOWEST_M_S)
    w = spanwise_speed(V, alpha_deg, sweep_deg)
    normal = max(math.sqrt(max(V * V - w * w, 0.0)), SLOWEST_M_S)
    p_0, h_e, rho_0, p = stagnation_kernel(rho_kg_m3, normal, T_inf_K)
    gradient = velocity_gradient(p_0, rho_0, p, normal, mach_of_table_gas(normal, T_inf_K), radius_m, CYLINDER)
    _, mu_0 = air_state_kernel(h_e, p_0)
    h_w, rho_w = air_kernel(T_w_K, p_0)[0], air_density_kernel(T_w_K, p_0)
    film = FAY_RIDDELL_CYLINDER * PRANDTL**-0.6 * math.sqrt(rho_0 * mu_0 * gradient)
    film *= (rho_0 * h_e / (rho_w * h_w)) ** DISSOCIATED
    laminar, spanwise = recovery_factor(False), 0.5 * w * w
    H_r = h_e + laminar * spanwise
    return film * (1.0 + (LINE_RECOVERY - laminar) * spanwise / max(H_r - h_w, 0.5 * H_r))
