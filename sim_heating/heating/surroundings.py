"""Surroundings of a vehicle by altitude: what a surface radiates to, and natural convection at rest.

A surface sees the ground with the view factor F = (1 + cos i) / 2 of a plane that is inclined by i against the ground
that it faces, and the clear sky with the rest (docs/theory/equations.md, section 4a):

    T_sur^4 = F T_ground^4 + (1 - F) T_sky^4
    T_ground^4 = s T_0^4 + (1 - s) (255 K)^4,    T_sky^4 = s 9.365e-6 K^-2 T_air^6,    s = p / p_0

9.365e-6 T^2 is the emittance of a clear sky over the ground (Swinbank, Q. J. R. Meteorol. Soc. 89 (1963) 339:
5.31e-13 T^6 W/m2); 255 K is the temperature at which the Earth emits to space. Between ground and space both are
taken in proportion to the air above, a guess. At rest in still air

    q = C f (p / p_0)^(2/3) |T - T_air|^(1/3) (T - T_air),    C = 1.31 W/(m2 K^(4/3)),    f = max(1 - V / 10 m/s, 0)

(McAdams, Heat Transmission (1954), vertical plate, turbulent). A hot plate that faces upward has 1.52 in place of 1.31,
one that faces downward less; the fall with speed is a guess between rest and the films of flight.
"""

from __future__ import annotations

import math

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import Conditions
from sim_heating.base.kernels.jit import njit
from sim_heating.heating.atmosphere import SEA_LEVEL_K, SEA_LEVEL_PA
from sim_heating.heating.surface_pressure import NEWTONIAN

EARTH_K = 255.0
"""Temperature at which the Earth emits to space [K]."""
SKY_PER_K2 = 9.365e-6
"""Emittance of a clear sky over the square of the temperature of the air at the ground [1/K2]."""
STILL_AIR = 1.31
"""Film of natural convection at 1 K and sea level [W/(m2 K^(4/3))]."""
AT_REST_M_S = 10.0
"""Speed at which natural convection has ended [m/s]."""


@njit
def ground_view(kind: float, inclination_deg: float) -> float:
    """View factor of the ground [-] of a surface: 1 of a lower one, 0 of one that faces upward.

    kind : of its pressure model, windward surfaces are those that face the ground;  inclination_deg : against the axis

    The attitude of the vehicle is left out. Source: plane over an infinite plane, docs/theory/equations.md, section 4a.
    """
    return 0.5 * (1.0 + math.cos(math.radians(inclination_deg))) if kind == NEWTONIAN else 0.0


@njit
def surroundings_kernel(T_air: float, p: float, view: float) -> float:
    """Temperature [K] of what a surface radiates to, at an air temperature [K] and a pressure [Pa].

    view : of the ground [-]. Source: docs/theory/equations.md, section 4a.
    """
    density_fraction = min(p / SEA_LEVEL_PA, 1.0)
    ground = density_fraction * SEA_LEVEL_K**4 + (1.0 - density_fraction) * EARTH_K**4
    sky = density_fraction * min(SKY_PER_K2 * T_air * T_air, 1.0) * T_air**4
    return math.sqrt(math.sqrt(view * ground + (1.0 - view) * sky))


@njit
def still_air_kernel(V: float, p: float) -> float:
    """Film of natural convection at 1 K [W/(m2 K^(4/3))], 0 in flight, at a speed [m/s] and a pressure [Pa].

    Source: docs/theory/equations.md, section 4a.
    """
    if V >= AT_REST_M_S:
        return 0.0
    return STILL_AIR * (1.0 - V / AT_REST_M_S) * (p / SEA_LEVEL_PA) ** (2.0 / 3.0)


def surroundings_columns(flown: Conditions, pressure_parameters: FloatArray) -> dict[str, FloatArray]:
    """Columns T_surroundings_K [K], where the flight has none of its own, and still_air_W_m2K43 of a control point.

    flown : conditions;  pressure_parameters : kind and inclination [deg] of its pressure model

    Source: docs/theory/equations.md, section 4a.
    """
    view = ground_view(pressure_parameters[0], pressure_parameters[1])
    pairs = list(zip(flown["T_inf_K"], flown["p_inf_Pa"], strict=True))
    columns = {
        "still_air_W_m2K43": np.array(
            [still_air_kernel(V, p) for V, p in zip(flown["velocity_m_s"], flown["p_inf_Pa"], strict=True)]
        )
    }
    if "T_surroundings_K" not in flown:
        columns["T_surroundings_K"] = np.array([surroundings_kernel(T, p, view) for T, p in pairs])
    return columns
