"""Rarefied flow: the film of a point bridged from continuum to free-molecular flow.

In free-molecular flow every molecule that meets the wall gives up its energy (accommodation 1), and none meets another
one before. What a surface receives then follows from the Maxwellian of the free stream and from the angle of the
surface alone. Matting's relation joins it to the continuum film of the point, r h_ref, which it leaves exponentially.
Both films are of the point, so that it does not matter which sphere its ratio r is stated over.
Equations: docs/theory/equations_reference_heating.md, equations 32 and 32a.
"""

from __future__ import annotations

import math

from sim_heating.base.kernels.jit import njit
from sim_heating.heating.atmosphere import R_AIR

NORMAL_DEG = 90.0
"""Angle [deg] of a point whose surface states none: normal to the flow, as a stagnation point is."""
DENSE = 37.0
"""Exponent h_fm / h_c [-] above which the bridging takes off less than a double number resolves."""


@njit
def free_molecular_film(
    rho_kg_m3: float, velocity_m_s: float, T_inf_K: float, angle_deg: float, H_r_J_kg: float
) -> float:
    """Film coefficient h_fm [kg/(m2 s)] of free-molecular flow at a surface, accommodation 1: h_fm = q / H_r.

        q = rho RT sqrt(RT / 2 pi) [(s^2 + 3) exp(-s_n^2) + sqrt(pi) (s^2 + 7/2) s_n (1 + erf s_n)]
        s = V / sqrt(2 R T),   s_n = s sin(angle)

    rho_kg_m3, velocity_m_s, T_inf_K : free-stream density [kg/m3], speed [m/s], temperature [K]
    angle_deg                        : of the surface against the flow [deg], negative on a lee surface
    H_r_J_kg                         : recovery enthalpy that the film is used with [J/kg]

    q [W/m2] is what the molecules bring to a wall: the energy of their motion and R T of rotation. Normal to fast
    flow it is rho V H_0. A wall at T_w gives 3 R T_w back with each kilogram, where the film subtracts h_w:
    below 1 % of q in an entry.
    Source: Bird, Molecular Gas Dynamics (1994), section 7.3; docs/theory/equations_reference_heating.md, equation 32a.
    """
    RT = R_AIR * T_inf_K
    s = velocity_m_s / math.sqrt(2.0 * RT)
    normal = s * math.sin(math.radians(angle_deg))
    # erfc keeps the digits of a lee surface, where 1 + erf is small.
    arriving = math.sqrt(math.pi) * normal * math.erfc(-normal)
    energy = (s * s + 3.0) * math.exp(-normal * normal) + (s * s + 3.5) * arriving
    return rho_kg_m3 * RT * math.sqrt(RT / (2.0 * math.pi)) * energy / H_r_J_kg


@njit
def bridged_film(film: float, free_molecular: float, ratio: float) -> float:
    """Reference film coefficient h_ref [kg/(m2 s)] of a point from continuum to free-molecular flow.

        h_ref = h_c (1 - exp(-h_fm / (r h_c)))

    film           : h_c, that of the reference in continuum flow [kg/(m2 s)], above 0
    free_molecular : h_fm of the point [kg/(m2 s)], of `free_molecular_film`
    ratio          : r, heating ratio of the point in continuum flow [-]; where it is not above 0 nothing is bridged

    r h_ref tends to h_fm in thin air whatever h_c the ratio is over. Matting's relation is for a stagnation point; that
    it holds at other points is assumed.
    Source: Matting, J. Spacecraft and Rockets 8 (1971) 35, eq. 18 with n = 1;
    docs/theory/equations_reference_heating.md, equation 32.
    """
    continuum = ratio * film
    if not continuum > 0.0 or free_molecular > DENSE * continuum:
        return film
    # expm1 keeps the digits of the free-molecular limit, in which the argument is small.
    return -film * math.expm1(-free_molecular / continuum)
