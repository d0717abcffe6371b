"""Local surface pressure of a control point, which sets the conductivity of a porous heat shield.

Two models, both tending to the freestream pressure as the speed falls:

    modified Newtonian, windward     p = p_inf + q_inf cp_max (cos beta sin theta)^2,  theta > 0, else p_inf
        theta = alpha + inclination + elevon_factor * elevon + bodyflap_factor * bodyflap
    fraction of stagnation, leeward  p = p_inf + fraction q_inf cp_max

with cp_max the stagnation pressure coefficient behind a normal shock (Rayleigh pitot, gamma 1.4), below Mach 1 the
isentropic one. `p_inf` is therefore the lowest value: the expansion of a leeward surface below freestream
pressure (at most 70 % of p_inf in the limit of high Mach numbers) is not modelled.

Sign of the inclination: the slope of the local surface against the vehicle's x axis, positive where it meets the flow
more steeply at positive alpha (a lower surface that faces forward; a nose stagnation point has 90 - alpha).

Holds within some 10 % on windward surfaces above Mach 3; elsewhere it is a guess with the right limits. Conductivity
goes with about the fifth root of pressure, so 10 % of pressure is 2 % of conductivity.
Sources: Lees, "Hypersonic flow", 1955 (modified Newtonian); NACA Report 1135, eq. 100 (Rayleigh pitot formula).
"""

from __future__ import annotations

import math
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import Conditions
from sim_heating.base.files import Declared
from sim_heating.base.kernels.jit import njit

GAMMA = 1.4
NEWTONIAN = 0.0
FRACTION = 1.0
PRESSURE_PARAMETERS = 4
"""Length of the parameter block of a pressure model: kind, inclination_deg or fraction, elevon and body-flap factor."""


class ModifiedNewtonian(Declared):
    """Windward surface at an inclination; a control-surface point adds its deflection to the angle by a factor."""

    model: Literal["modified-newtonian"]
    inclination_deg: float = Field(ge=-90.0, le=90.0)
    elevon_factor: float = Field(default=0.0, ge=-1.0, le=1.0)
    bodyflap_factor: float = Field(default=0.0, ge=-1.0, le=1.0)

    def parameters(self) -> FloatArray:
        """(4,) parameter block of `surface_pressure_kernel`."""
        return np.array([NEWTONIAN, self.inclination_deg, self.elevon_factor, self.bodyflap_factor])


class FractionOfStagnation(Declared):
    """Leeward or shadowed surface: a fixed fraction of the stagnation pressure rise."""

    model: Literal["fraction-of-stagnation"]
    fraction: float = Field(ge=0.0, le=1.0)

    def parameters(self) -> FloatArray:
        """(4,) parameter block of `surface_pressure_kernel`."""
        return np.array([FRACTION, self.fraction, 0.0, 0.0])


PressureModel = Annotated[ModifiedNewtonian | FractionOfStagnation, Field(discriminator="model")]


@njit
def stagnation_pressure_coefficient(mach: float) -> float:
    """Largest pressure coefficient cp_max [-] of a body in perfect air (gamma 1.4), any Mach number above 0.

    Above Mach 1 the Rayleigh pitot formula (1.276 at Mach 1, 1.839 in the limit), below it the isentropic one
    (1 in the limit of 0); both meet at Mach 1. Dissociation would raise the limit to about 1.93.
    """
    m2 = mach * mach
    if m2 < 1e-4:
        return 1.0
    if m2 <= 1.0:
        ratio = (1.0 + 0.5 * (GAMMA - 1.0) * m2) ** (GAMMA / (GAMMA - 1.0))
    else:
        shock = (GAMMA + 1.0) ** 2 * m2 / (4.0 * GAMMA * m2 - 2.0 * (GAMMA - 1.0))
        ratio = shock ** (GAMMA / (GAMMA - 1.0)) * (2.0 * GAMMA * m2 - (GAMMA - 1.0)) / (GAMMA + 1.0)
    return (ratio - 1.0) / (0.5 * GAMMA * m2)


@njit
def surface_pressure_kernel(
    p_inf: float, q_inf: float, mach: float, alpha_deg: float, beta_deg: float,
    elevon_deg: float, bodyflap_deg: float, kind: float, first: float, elevon_factor: float, bodyflap_factor: float,
) -> float:  # fmt: skip
    """Surface pressure [Pa] of one point at one time; formulas at the head of the module.

    p_inf, q_inf : freestream static and dynamic pressure [Pa];  mach : true Mach number [-]
    kind, first, elevon_factor, bodyflap_factor : a pressure model's `parameters()`
    """
    rise, cos_beta = q_inf * stagnation_pressure_coefficient(mach), math.cos(math.radians(beta_deg))
    return pressure_below_rise(
        p_inf, rise, alpha_deg, cos_beta, elevon_deg, bodyflap_deg, kind, first, elevon_factor, bodyflap_factor
    )


@njit
def pressure_below_rise(
    p_inf: float, rise: float, alpha_deg: float, cos_beta: float, elevon_deg: float, bodyflap_deg: float,
    kind: float, first: float, elevon_factor: float, bodyflap_factor: float,
) -> float:  # fmt: skip
    """The same from the pressure rise at the stagnation point [Pa] and the cosine of sideslip, which all points of a
    vehicle share."""
    if kind == FRACTION:
        return p_inf + first * rise
    angle = alpha_deg + first + elevon_factor * elevon_deg + bodyflap_factor * bodyflap_deg
    normal = cos_beta * math.sin(math.radians(angle))
    return p_inf + rise * max(0.0, normal) ** 2


@njit
def _surface_pressures(
    p_inf: FloatArray, q_inf: FloatArray, mach: FloatArray, alpha_deg: FloatArray, beta_deg: FloatArray,
    elevon_deg: FloatArray, bodyflap_deg: FloatArray, parameters: FloatArray, out: FloatArray,
) -> None:  # fmt: skip
    for i in range(len(out)):
        out[i] = surface_pressure_kernel(
            p_inf[i], q_inf[i], mach[i], alpha_deg[i], beta_deg[i], elevon_deg[i], bodyflap_deg[i],
            parameters[0], parameters[1], parameters[2], parameters[3],
        )  # fmt: skip


def surface_pressure(model: ModifiedNewtonian | FractionOfStagnation, conditions: Conditions) -> FloatArray:
    """Surface pressure [Pa] of a control point along a flight, one value a sample.

    model      : the control point's pressure model
    conditions : the columns of `conditions.STATE`
    """
    c = conditions
    out = np.empty(len(c))
    _surface_pressures(
        c["p_inf_Pa"], 0.5 * c["rho_kg_m3"] * c["velocity_m_s"] ** 2, c["mach"], c["alpha_deg"], c["beta_deg"],
        c["elevon_deg"], c["bodyflap_deg"], model.parameters(), out,
    )  # fmt: skip
    return out
