"""Local surface pressure of a control point, which sets the conductivity of a porous heat shield.

Two models, both tending to the free-stream pressure as the speed falls (docs/equations.md, equations 30 to 32):

    modified Newtonian, windward     p = p_inf + q_inf cp_max (cos beta sin theta)^2,  theta > 0, else p_inf
        theta = alpha + inclination + elevon_factor * elevon + bodyflap_factor * bodyflap
    fraction of stagnation, leeward  p = p_inf + fraction q_inf cp_max

with cp_max the stagnation pressure coefficient behind a normal shock (Rayleigh pitot, gamma 1.4), below Mach 1 the
isentropic one. `p_inf` is therefore the lowest value: the expansion of a leeward surface below free-stream
pressure (at most 70 % of p_inf in the limit of high Mach numbers) is not modelled.

Sign of the inclination: the slope of the local surface against the vehicle's x axis, positive where it meets the flow
more steeply at positive alpha (a lower surface that faces forward; a nose stagnation point has 90 - alpha).

Accurate to some 10 % on windward surfaces above Mach 3; elsewhere only the limits are right. Conductivity
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
from sim_heating.heating.atmosphere import GAMMA

NEWTONIAN = 0.0
FRACTION = 1.0
PRESSURE_WIDTH = 4
"""Length of the parameter block of a pressure model: kind, inclination_deg or fraction, elevon and body-flap factor."""


class ModifiedNewtonian(Declared):
    """Modified Newtonian pressure of a windward surface at an inclination (docs/equations.md, equation 30).

    inclination_deg : slope of the local surface against the vehicle's x axis [deg], -90 to 90
    elevon_factor   : part of the elevon deflection that turns the surface [-], -1 to 1
    bodyflap_factor : part of the body-flap deflection that turns the surface [-], -1 to 1
    """

    model: Literal["modified-newtonian"]
    inclination_deg: float = Field(ge=-90.0, le=90.0)
    elevon_factor: float = Field(default=0.0, ge=-1.0, le=1.0)
    bodyflap_factor: float = Field(default=0.0, ge=-1.0, le=1.0)

    def parameters(self) -> FloatArray:
        """(4,) parameter block of `surface_pressure_kernel`: kind, inclination [deg], elevon and flap factor [-]."""
        return np.array([NEWTONIAN, self.inclination_deg, self.elevon_factor, self.bodyflap_factor])


class FractionOfStagnation(Declared):
    """Pressure of a leeward or shadowed surface: a constant fraction of the rise at the stagnation point.

    fraction : part of the stagnation pressure rise [-], 0 to 1 (docs/equations.md, equation 31)
    """

    model: Literal["fraction-of-stagnation"]
    fraction: float = Field(ge=0.0, le=1.0)

    def parameters(self) -> FloatArray:
        """(4,) parameter block of `surface_pressure_kernel`: kind [-], fraction [-], and two zeros without meaning."""
        return np.array([FRACTION, self.fraction, 0.0, 0.0])


PressureModel = Annotated[ModifiedNewtonian | FractionOfStagnation, Field(discriminator="model")]


@njit
def stagnation_pressure_coefficient(mach: float) -> float:
    """Largest pressure coefficient cp_max = (p_0 / p_inf - 1) / (gamma M^2 / 2) [-] of a body in air with gamma 1.4.

    mach : free-stream Mach number [-], 0 or above
    Above Mach 1 the Rayleigh pitot formula (1.276 at Mach 1, 1.839 in the limit), below it the isentropic one
    (1 in the limit of 0); both meet at Mach 1. Dissociation would raise the limit to about 1.93.
    Source: NACA Report 1135, equation 100; docs/equations.md, equation 32.
    """
    m2 = mach * mach
    # Below Mach 0.01 the difference (ratio - 1) loses its digits; the series 1 + M^2/4 is 1 to 3e-5 there.
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
    p_inf: float,
    q_inf: float,
    mach: float,
    alpha_deg: float,
    beta_deg: float,
    elevon_deg: float,
    bodyflap_deg: float,
    model: FloatArray,
) -> float:
    """Surface pressure [Pa] of one point at one time, by modified Newtonian theory or as a fraction of stagnation.

    p_inf, q_inf             : free-stream static and dynamic pressure [Pa]
    mach                     : true Mach number [-]
    alpha_deg, beta_deg      : angle of attack and sideslip [deg]
    elevon_deg, bodyflap_deg : deflections [deg]
    model                    : `parameters()` of a pressure model, at least (PRESSURE_WIDTH,)
    Source: docs/equations.md, equations 30 to 32 (Lees 1955; NACA Report 1135, eq. 100).
    """
    rise, cos_beta = q_inf * stagnation_pressure_coefficient(mach), math.cos(math.radians(beta_deg))
    return pressure_below_rise(p_inf, rise, alpha_deg, cos_beta, elevon_deg, bodyflap_deg, model)


@njit
def pressure_below_rise(
    p_inf: float,
    rise: float,
    alpha_deg: float,
    cos_beta: float,
    elevon_deg: float,
    bodyflap_deg: float,
    model: FloatArray,
) -> float:
    """Surface pressure [Pa] of one point from the pressure rise at the stagnation point.

        p = p_inf + rise max(0, cos beta sin theta)^2,   or   p = p_inf + fraction rise

    p_inf, rise : free-stream static pressure and stagnation pressure rise q_inf cp_max [Pa]
    cos_beta    : cosine of sideslip [-]; it and `rise` are common to all points of a vehicle, so computed once
    alpha_deg, elevon_deg, bodyflap_deg : angle of attack and deflections [deg]
    model       : `parameters()` of a pressure model, at least (PRESSURE_WIDTH,)
    Source: docs/equations.md, equations 30 and 31.
    """
    # Kind as a float in the parameter block: one kernel for both models, whose blocks lie in one array.
    if model[0] == FRACTION:
        return p_inf + model[1] * rise
    angle = alpha_deg + model[1] + model[2] * elevon_deg + model[3] * bodyflap_deg
    normal = cos_beta * math.sin(math.radians(angle))
    # A surface in the shadow of the flow has free-stream pressure.
    return p_inf + rise * max(0.0, normal) ** 2


@njit
def _surface_pressures(
    p_inf: FloatArray, q_inf: FloatArray, mach: FloatArray, alpha_deg: FloatArray, beta_deg: FloatArray,
    elevon_deg: FloatArray, bodyflap_deg: FloatArray, model: FloatArray, out: FloatArray,
) -> None:  # fmt: skip
    for i in range(len(out)):
        out[i] = surface_pressure_kernel(
            p_inf[i], q_inf[i], mach[i], alpha_deg[i], beta_deg[i], elevon_deg[i], bodyflap_deg[i], model
        )


def surface_pressure(model: ModifiedNewtonian | FractionOfStagnation, conditions: Conditions) -> FloatArray:
    """Surface pressure of a control point along a flight.

    model      : pressure model of the control point
    conditions : flight conditions with the columns of `conditions.STATE`
    returns    : (time,) surface pressure [Pa]
    raises     : KeyError where a column is missing
    Source: docs/equations.md, equations 30 to 32.
    """
    c = conditions
    out = np.empty(len(c))
    _surface_pressures(
        c["p_inf_Pa"], 0.5 * c["rho_kg_m3"] * c["velocity_m_s"] ** 2, c["mach"], c["alpha_deg"], c["beta_deg"],
        c["elevon_deg"], c["bodyflap_deg"], model.parameters(), out,
    )  # fmt: skip
    return out
