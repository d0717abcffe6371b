"""Heating behind a step of wall temperature: the film of an unheated starting length, superposed on that of one wall.

    q = h_0(x) [(H_r - H_w1) + F (H_w1 - H_w2)] = F h_0 (H_r' - H_w2),    H_r' = H_w1 + (H_r - H_w1) / F

H_w1 is the enthalpy of air at the wall upstream of the step, H_w2 at the wall behind it. F is the film behind an
unheated starting length s over that of a wall heated from the leading edge:

    F = (1 - (s/x)^(3/4))^(-1/3)  laminar,     F = (1 - (s/x)^(9/10))^(-1/9)  turbulent

Behind a hotter wall the excess over the heating of one wall is h_0 (F - 1) (H_w1 - H_w2) and above 0, as the boundary
layer has lost less heat to it; behind a colder one it is below 0. F is singular at x = s, and is averaged over a
footprint.
Source: Kays and Crawford, Convective Heat and Mass Transfer, 3rd ed., sections 10 and 13 (Eckert's laminar integral
solution; Reynolds, Kays and Kline, NASA Memo 12-1-58W, 1958, turbulent); derived in docs/theory/interfaces.md.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from sim_heating.base.errors import InputError
from sim_heating.base.kernels.jit import njit
from sim_heating.heating.reference.gas import air_kernel

InterfaceFlow = Literal["laminar", "turbulent", "declared transition"]
EXPONENTS = {"laminar": (0.75, 1.0 / 3.0), "turbulent": (0.9, 1.0 / 9.0)}
"""Exponents a and b of F = (1 - (s/x)^a)^(-b)."""
LEAST_PA = 1e-6
"""Least pressure at which the enthalpy of air is looked up [Pa]."""
NODES = 48
"""Nodes of Gauss's rule over the footprint."""


@dataclass(frozen=True)
class Interface:
    """A step of wall temperature upstream of a control point.

    step_m      : running length of the step from the leading edge, s [m]
    point_m     : running length of the point, x [m]
    footprint_m : length along the flow over which the heating is averaged [m]
    flow        : boundary layer at the point
    """

    step_m: float
    point_m: float
    footprint_m: float
    flow: InterfaceFlow

    @property
    def factors(self) -> tuple[float, float]:
        """Film factor F [-] of the laminar and of the turbulent boundary layer, equal where the flow is declared:
        docs/theory/interfaces.md, equations 2 and 3."""
        laminar, turbulent = (
            film_factor(kind, self.step_m, self.point_m, self.footprint_m) for kind in ("laminar", "turbulent")
        )
        if self.flow == "declared transition":
            return laminar, turbulent
        return (laminar, laminar) if self.flow == "laminar" else (turbulent, turbulent)


@njit
def upstream_enthalpy(T_K: float, p_Pa: float, cp_J_kgK: float) -> float:
    """Enthalpy of air at the wall upstream [J/kg]: cp T, or of equilibrium air where cp is 0.

    T_K : temperature of that wall [K];  p_Pa : pressure at the surface [Pa];  cp_J_kgK : [J/(kg K)]
    Source: docs/theory/equations_reference_heating.md, equation 5.
    """
    return cp_J_kgK * T_K if cp_J_kgK > 0.0 else air_kernel(T_K, max(p_Pa, LEAST_PA))[0]


def film_factor(flow: str, step_m: float, point_m: float, footprint_m: float = 0.0) -> float:
    """Film behind an unheated starting length over that of a wall heated from its leading edge, F [-].

    flow        : "laminar" or "turbulent"
    step_m      : running length s of the step [m];  point_m : running length x [m], above s
    footprint_m : length over which F is averaged, about the point [m]; the part ahead of the step is left out
    returns     : 1 for a step at the leading edge
    raises      : InputError where the point is not behind the step

    >>> round(film_factor("laminar", 1.0, 2.0), 4)
    1.3512

    The singularity at x = s is integrable; with x = s + u^3 the integrand is smooth.
    Source: docs/theory/interfaces.md, equations 2 and 3, there after Kays and Crawford.
    """
    if not 0.0 <= step_m < point_m:
        raise InputError(f"interface: step_m is {step_m:g} and point_m {point_m:g}; the point lies behind the step")
    a, b = EXPONENTS[flow]
    if footprint_m == 0.0:
        return float((1.0 - (step_m / point_m) ** a) ** -b)
    ends = np.maximum(np.array([-0.5, 0.5]) * footprint_m + point_m - step_m, 0.0)
    low, high = np.cbrt(ends)
    nodes, weights = np.polynomial.legendre.leggauss(NODES)
    u = low + 0.5 * (high - low) * (1.0 + nodes)
    # Written with expm1 and log1p: behind a close step the difference of the powers would cancel.
    behind = -np.expm1(-a * np.log1p(u**3 / max(step_m, 1e-300))) if step_m > 0.0 else np.ones_like(u)
    integral = np.sum(weights * behind**-b * 3.0 * u**2) * 0.5 * (high - low)
    return float(integral / (ends[1] - ends[0]))
