"""Rarefied flow: stagnation heating bridged from continuum to free-molecular flow.

Every molecule that meets the stagnation point in free-molecular flow gives up its energy (accommodation 1). The flux is
q_fm = rho V (h_0 - h_w), 0.5 rho V^3 in hypersonic flow, and the film coefficient h_fm = rho V. Matting's relation
joins it to the continuum value, which it leaves exponentially: on a sphere of 1 ft at 7.5 km/s it takes less than
0.02 % off Fay-Riddell up to 75 km, 0.24 % at 80 km, 7 % at 90 km, 34 % at 100 km and 80 % at 120 km.
Equation: docs/theory/equations_reference_heating.md, equation 32.
"""

from __future__ import annotations

import math

from sim_heating.base.kernels.jit import njit


@njit
def bridged_film(film: float, rho_kg_m3: float, velocity_m_s: float) -> float:
    """Film coefficient [kg/(m2 s)] of a stagnation point from continuum to free-molecular flow.

        h = h_c (1 - exp(-h_fm / h_c)),   h_fm = rho V

    film                    : h_c, that of continuum flow [kg/(m2 s)], above 0
    rho_kg_m3, velocity_m_s : free stream [kg/m3], [m/s]; of a swept cylinder the speed normal to it

    h_fm is that of hypersonic flow and accommodation 1; below Mach 3 it is low, which matters only where the air is
    thin as well.
    Source: Matting, J. Spacecraft and Rockets 8 (1971) 35, eq. 18 with n = 1;
    docs/theory/equations_reference_heating.md, equation 32.
    """
    # expm1 keeps the digits of the free-molecular limit, in which the argument is small.
    return -film * math.expm1(-rho_kg_m3 * velocity_m_s / film)
