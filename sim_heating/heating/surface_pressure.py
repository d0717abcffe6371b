"""Local surface pressure of a control point, which sets the conductivity of a porous heat shield.

Two models, both tending to the free-stream pressure as the speed falls (docs/theory/equations.md, equations 30 to 32):

    modified Newtonian, windward     p = p_inf + q_inf cp_max (cos beta sin theta)^2,  theta > 0, else p_inf
        theta = alpha + inclination + elevon_factor * elevon + bodyflap_factor * bodyflap
    fraction of stagnation, leeward  p = p_inf + fraction q_inf cp_max

with cp_max the stagnation pressure coefficient behind a normal shock in equilibrium air, below Mach 1 the isentropic
one. `p_inf` is therefore the lowest value: the expansion of a leeward surface below free-stream pressure (at most
70 % of p_inf in the limit of high Mach numbers) is not modelled.

Sign of the inclination: the slope of the local surface against the vehicle's x axis, positive where it meets the flow
more steeply at positive alpha (a lower surface that faces forward; a nose stagnation point has 90 - alpha).

Accurate to some 10 % on windward surfaces above Mach 3; elsewhere only the limits are right. Conductivity
goes with about the fifth root of pressure, so 10 % of pressure is 2 % of conductivity.
Sources: Lees, "Hypersonic flow", 1955 (modified Newtonian); equilibrium shock as for the reference heating.
"""

from __future__ import annotations

import math
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import Conditions
from sim_heating.base.errors import InputError
from sim_heating.base.files import Declared
from sim_heating.base.kernels.jit import njit
from sim_heating.heating.reference.recovery import NO_INCIDENCE, Incidence, incidence_at
from sim_heating.heating.reference.stagnation import SLOWEST_M_S, stagnation_kernel

NEWTONIAN = 0.0
FRACTION = 1.0
PRESSURE_WIDTH = 4
"""Length of the parameter block of a pressure model: kind, inclination_deg or fraction, elevon and body-flap factor."""


class ModifiedNewtonian(Declared):
    """Modified Newtonian pressure of a windward surface at an inclination (docs/theory/equations.md, equation 30).

    inclination_deg : slope of the local surface against the vehicle's x axis [deg], -90 to 90
    elevon_factor   : part of the elevon deflection that turns the surface [-], -1 to 1
    bodyflap_factor : part of the body-flap deflection that turns the surface [-], -1 to 1
    model : "modified-newtonian"
    """

    model: Literal["modified-newtonian"]
    inclination_deg: float = Field(ge=-90.0, le=90.0)
    elevon_factor: float = Field(default=0.0, ge=-1.0, le=1.0)
    bodyflap_factor: float = Field(default=0.0, ge=-1.0, le=1.0)

    def parameters(self) -> FloatArray:
        """(4,) parameter block of `surface_pressure_kernel`: kind, inclination [deg], elevon and flap factor [-].

        Source: docs/theory/equations.md, equation 30.
        """
        return np.array([NEWTONIAN, self.inclination_deg, self.elevon_factor, self.bodyflap_factor])


class FractionOfStagnation(Declared):
    """Pressure of a leeward or shadowed surface: a constant fraction of the rise at the stagnation point.

    fraction : part of the stagnation pressure rise [-], 0 to 1 (docs/theory/equations.md, equation 31)
    model : "fraction-of-stagnation"
    """

    model: Literal["fraction-of-stagnation"]
    fraction: float = Field(ge=0.0, le=1.0)

    def parameters(self) -> FloatArray:
        """(4,) parameter block of `surface_pressure_kernel`: kind [-], fraction [-], and two zeros without meaning.

        Source: docs/theory/equations.md, equation 31.
        """
        return np.array([FRACTION, self.fraction, 0.0, 0.0])


PressureModel = Annotated[ModifiedNewtonian | FractionOfStagnation, Field(discriminator="model")]


@njit
def stagnation_rise(state: tuple[float, float, float, float]) -> float:
    """Pressure rise at the stagnation point, q_inf cp_max = p_0 - p_inf [Pa], not below 0.

    state : result of `stagnation_kernel`: equilibrium air behind a normal shock, isentropic below Mach 1
    cp_max is 1 at rest, 1.28 at Mach 1, 1.84 at 2 km/s, 1.91 at 4 km/s and 1.95 at 7.5 km/s; a gas with gamma 1.4 has
    1.839 in the limit. Source: docs/theory/equations.md, equation 32.
    """
    # At rest rounding can leave p_0 below p_inf.
    return max(state[0] - state[3], 0.0)


@njit
def surface_pressure_kernel(
    p_inf: float,
    rho_kg_m3: float,
    velocity_m_s: float,
    T_inf_K: float,
    alpha_deg: float,
    beta_deg: float,
    elevon_deg: float,
    bodyflap_deg: float,
    model: FloatArray,
) -> float:
    """Surface pressure [Pa] of one point at one time, by modified Newtonian theory or as a fraction of stagnation.

    p_inf                    : free-stream static pressure [Pa]
    rho_kg_m3, velocity_m_s, T_inf_K : free-stream density [kg/m3], speed [m/s], temperature [K]
    alpha_deg, beta_deg      : angle of attack and sideslip [deg]
    elevon_deg, bodyflap_deg : deflections [deg]
    model                    : `parameters()` of a pressure model, at least (PRESSURE_WIDTH,)
    Source: docs/theory/equations.md, equations 30 to 32 (Lees 1955).
    """
    rise = stagnation_rise(stagnation_kernel(rho_kg_m3, max(velocity_m_s, SLOWEST_M_S), T_inf_K))
    cos_beta = math.cos(math.radians(beta_deg))
    return pressure_below_rise(p_inf, rise, alpha_deg, cos_beta, elevon_deg, bodyflap_deg, model, NO_INCIDENCE)[0]


@njit
def pressure_below_rise(
    p_inf: float,
    rise: float,
    alpha_deg: float,
    cos_beta: float,
    elevon_deg: float,
    bodyflap_deg: float,
    model: FloatArray,
    incidence: Incidence,
) -> tuple[float, Incidence]:
    """Surface pressure [Pa] of one point from the pressure rise at the stagnation point, and its incidence.

        p = p_inf + rise max(0, cos beta sin theta)^2,   or   p = p_inf + fraction rise

    p_inf, rise : free-stream static pressure and stagnation pressure rise q_inf cp_max [Pa]
    cos_beta    : cosine of sideslip [-]; it and `rise` are common to all points of a vehicle, so computed once
    alpha_deg, elevon_deg, bodyflap_deg : angle of attack and deflections [deg]
    model       : `parameters()` of a pressure model, at least (PRESSURE_WIDTH,)
    incidence   : of the point before, or NO_INCIDENCE; returned where the model has no angle
    Source: docs/theory/equations.md, equations 30 and 31.
    """
    # Kind as a float in the parameter block: one kernel for both models, whose blocks lie in one array.
    if model[0] == FRACTION:
        return p_inf + model[1] * rise, incidence
    incidence = incidence_at(alpha_deg + model[1] + model[2] * elevon_deg + model[3] * bodyflap_deg, incidence)
    normal = cos_beta * incidence.sine
    # A surface in the shadow of the flow has free-stream pressure.
    return p_inf + rise * max(0.0, normal) ** 2, incidence


@njit
def _surface_pressures(flight: FloatArray, model: FloatArray, out: FloatArray) -> None:
    for i in range(len(out)):
        f = flight[i]
        out[i] = surface_pressure_kernel(f[0], f[1], f[2], f[3], f[4], f[5], f[6], f[7], model)


def surface_pressure(model: ModifiedNewtonian | FractionOfStagnation, conditions: Conditions) -> FloatArray:
    """Surface pressure of a control point along a flight.

    model      : pressure model of the control point
    conditions : flight conditions with the columns of `conditions.STATE`
    returns    : (time,) surface pressure [Pa]
    raises     : KeyError where a column is missing, InputError where density or temperature is not above 0
    Source: docs/theory/equations.md, equations 30 to 32.
    """
    c = conditions
    for name in ("rho_kg_m3", "T_inf_K"):
        bad = np.flatnonzero(c[name] <= 0.0)
        if bad.size:
            raise InputError(f"conditions, row {bad[0] + 1}, column {name}: {c[name][bad[0]]} (must be above 0)")
    angles = ("alpha_deg", "beta_deg", "elevon_deg", "bodyflap_deg")
    columns = ("p_inf_Pa", "rho_kg_m3", "velocity_m_s", "T_inf_K", *angles)
    flight, out = np.column_stack([c[name] for name in columns]), np.empty(len(c))
    _surface_pressures(flight, model.parameters(), out)
    return out
