"""Heat at the outer surface of a control point along its flight, from what its march keeps of every sample.

    convected - radiated - conducted + added = 0,    heat load = int convected dt
    heat stored in the wall = int (conducted - back) dt

The march keeps what enters the wall and the fourth power of the surroundings' temperature; the radiated flux follows
from the wall's temperature and emittance, the convected one from the balance (docs/theory/equations.md, equation 1).
What hot gas leaves along a gap is convected and conducted as well.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import Conditions
from sim_heating.heating.effects.compiled import values_along
from sim_heating.march.ensemble import condition_history
from sim_heating.march.point import PointModel
from sim_heating.thermal.faces import SIGMA


@dataclass(frozen=True, eq=False)
class SurfaceHeat:
    """Heat at the surface of a control point along a flight, (time,) each: fluxes [W/m2] and their integral [J/m2].

    convected_W_m2 : r h_ref (H_r - H_w), into the wall;  radiated_W_m2 : eps sigma (T^4 - T_sur^4), away from it
    conducted_W_m2 : -k dT/dx at the surface, into the wall;  added_W_m2 : q_add, of a lamp or the sun, into the wall
    back_W_m2      : that leaves at the back face, by convection and radiation
    heat_load_J_m2 : time integral of the convected flux since the start, linear between the samples
    """

    convected_W_m2: FloatArray
    radiated_W_m2: FloatArray
    conducted_W_m2: FloatArray
    added_W_m2: FloatArray
    back_W_m2: FloatArray
    heat_load_J_m2: FloatArray

    def columns(self) -> dict[str, FloatArray]:
        """Fluxes [W/m2] of docs/theory/equations.md, equation 1, and heat load [J/m2], by the name of their column."""
        return {f.name: getattr(self, f.name) for f in fields(self)}


def surface_heat(
    model: PointModel,
    flown: Conditions,
    surface_K: FloatArray,
    entering_W_m2: FloatArray,
    leaving_W_m2: FloatArray,
    surroundings_K4: FloatArray,
) -> SurfaceHeat:
    """Heat at the surface of a control point.

    flown           : conditions on the samples of the march
    surface_K       : (time,) temperature of the surface [K]
    entering_W_m2   : (time,) heat that enters the wall [W/m2]
    leaving_W_m2    : (time,) heat that leaves at the back [W/m2]
    surroundings_K4 : (time,) fourth power of the temperature of the surroundings [K4]
    returns         : fluxes [W/m2], the convected one from the balance of the others, and heat load [J/m2]

    Source: docs/theory/equations.md, equation 1; the emittance of effects, docs/reference/effects.md, equation 9.
    """
    points = np.array(model.construction.layer_materials()[0].emissivity or [[0.0, 1.0]], dtype=float)
    emittance = np.interp(surface_K, *points.T) * model.values[model.places["stack.emissivity_factor"]]
    emittance = emittance * _factor_of_effects(model, flown, surface_K)
    radiated = emittance * SIGMA * (surface_K**4 - surroundings_K4)
    added = flown["q_add_W_m2"] if "q_add_W_m2" in flown else np.zeros(len(flown))
    convected = entering_W_m2 + radiated - added
    load = np.append(0.0, np.cumsum(0.5 * (convected[1:] + convected[:-1]) * np.diff(flown.time_s)))
    return SurfaceHeat(convected, radiated, entering_W_m2, added, leaving_W_m2, load)


def _factor_of_effects(model: PointModel, flown: Conditions, surface_K: FloatArray) -> FloatArray:
    """(time,) factor of the effects on the emittance [-]."""
    factor, uses = np.ones(len(flown)), [used for used in model.effects if used.effect.mode == "emittance"]
    if not uses:
        return factor
    rows = condition_history(flown)
    for used in uses:
        factor *= values_along(used, rows, surface_K)
    return factor
