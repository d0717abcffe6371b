"""Stagnation line of a swept cylinder, as a leading edge is one: film coefficient over the total enthalpy.

The flow along an infinite cylinder does not change along it. The component normal to the axis passes a shock and comes
to rest at the stagnation line, where Fay and Riddell's formula holds with the constant of plane flow; the component
along the axis heats by friction, with the recovery factor sqrt(Pr). Sweep L of the edge at alpha 0 and an angle of
attack turn the axis against the flow by an angle whose sine is sin L cos alpha.
Equation: docs/theory/equations_reference_heating.md, equation 33.
"""

from __future__ import annotations

import math

from sim_heating.base.kernels.jit import njit
from sim_heating.heating.reference.gas import PRANDTL
from sim_heating.heating.reference.stagnation import (
    CYLINDER,
    FAY_RIDDELL,
    NO_LEWIS,
    SLOWEST_M_S,
    fay_riddell_film,
    mach_of_table_gas,
    stagnation_kernel,
    velocity_gradient,
)

FAY_RIDDELL_CYLINDER = 0.57
"""Constant of the stagnation line of a cylinder, in place of the sphere's 0.763 (Fay and Riddell 1958)."""


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
    """Film coefficient h_ref [kg/(m2 s)] of a swept cylinder's stagnation line, for use with the total enthalpy.

        V_n = V sqrt(1 - sin^2 L cos^2 alpha),   w^2 = V^2 - V_n^2,   H_aw = H_0 - (1 - sqrt(Pr)) w^2/2
        h_ref = h_n H_aw / H_0,   h_n of Fay and Riddell at V_n with 0.57 for 0.763

    rho_kg_m3, velocity_m_s, T_inf_K : free-stream density [kg/m3], speed [m/s], temperature [K]
    alpha_deg, sweep_deg             : angle of attack, sweep L of the edge at alpha 0 [deg]
    radius_m, T_w_K                  : radius of the cylinder [m], wall temperature [K], 300 in the reference model

    The factor H_aw/H_0 stands for (H_aw - h_w) / (H_0 - h_w): 0.5 % more at a wall of 1200 K, 7 km/s and 45 deg. The
    heating that spanwise friction adds to the properties across the layer is neglected (up to about 60 deg). Laminar.
    Source: Fay and Riddell (1958); independence of the normal flow as in Beckwith and Gallagher, NASA TR R-104 (1961);
    docs/theory/equations_reference_heating.md, equation 33.
    """
    V = max(velocity_m_s, SLOWEST_M_S)
    normal = max(V * math.sin(math.radians(line_angle(alpha_deg, sweep_deg))), SLOWEST_M_S)
    p_0, h_e, rho_0, p = stagnation_kernel(rho_kg_m3, normal, T_inf_K)
    mach = mach_of_table_gas(normal, T_inf_K)
    gradient = velocity_gradient(p_0, rho_0, p, normal, mach, radius_m, CYLINDER)
    sphere = fay_riddell_film(p_0, h_e, rho_0, gradient, T_w_K, NO_LEWIS)
    film = FAY_RIDDELL_CYLINDER / FAY_RIDDELL * sphere
    spanwise = 0.5 * max(V * V - normal * normal, 0.0)
    return film * (h_e + math.sqrt(PRANDTL) * spanwise) / (h_e + spanwise)
