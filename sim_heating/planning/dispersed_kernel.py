"""The compiled part of dispersed entries: many flights, their conditions at control points, parameters of lanes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sim_heating.atmosphere import HIGHEST_M
from sim_heating.conditions import FRAME
from sim_heating.heating_ratio.kernel import mark_order
from sim_heating.jit import njit, raw
from sim_heating.layout import H_REF, LANES, N_CONDITIONS, N_PARAMETERS, P_SURFACE, PARAMETERS, Q_ADD, TIME
from sim_heating.plugin_kernel import PRESSURE_WIDTH, derive_conditions
from sim_heating.thermal.elements import set_elements
from sim_heating.trajectory import point_mass as pm
from sim_heating.trajectory.entry3dof import DEEPEST_M
from sim_heating.trajectory.flight import ROW
from sim_heating.trajectory.trimmed_aero import AT_CELLS, ELEVON_HIGH, ELEVON_LOW

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

WHOLE, ENDLESS, GONE = range(3)
"""How a flight went: to its stop; on beyond the longest time; out of the atmosphere or into no number."""
POINT_NUMBERS = PRESSURE_WIDTH + 1
"""Numbers of a point in `condition_kernel`: its pressure model and its running length [m]."""
_ELEVON, _FRAME = ROW.index("elevon_deg"), len(FRAME)


@njit
def scale_aero(aero: FloatArray, cn: float, ca: float, out: FloatArray) -> None:
    """A vehicle's aerodynamic block with all CN and CA times a factor."""
    cells = int(aero[AT_CELLS])
    for i in range(len(aero)):
        place = (i - cells) % 3
        out[i] = aero[i] * (1.0 if i < cells or place == 2 else cn if place == 0 else ca)


@njit
def fly_kernel(
    initial: FloatArray, flights: FloatArray, blocks: FloatArray, script: FloatArray, tables: FloatArray,
    factors: FloatArray, dt_s: float, every: int, rows: FloatArray, filled: IntArray, outcome: IntArray,
    end_s: FloatArray, untrimmed_s: FloatArray,
) -> None:  # fmt: skip
    """All flights one after the other; arrays as in `fly_many`, outputs last."""
    manoeuvres, frames = int(script[0]), rows.shape[1]
    state, work, row = np.empty(pm.STARTED + manoeuvres), np.zeros(pm.WORK), np.empty(rows.shape[2])
    aero = np.empty(len(tables))
    for f in range(len(flights)):
        scale_aero(tables, factors[f, 0], factors[f, 1], aero)
        pm.first_state_kernel(initial[f], flights[f], blocks[f], manoeuvres, state)
        outcome[f], k = ENDLESS, 0
        while k < frames * every:
            going = pm.step_kernel(
                raw(state), raw(flights[f]), raw(blocks[f]), raw(script), raw(aero), dt_s, raw(work), raw(row)
            )
            if not DEEPEST_M <= row[1] <= HIGHEST_M or not row[2] < np.inf:
                outcome[f] = GONE
                break
            if k % every == 0:
                rows[f, k // every] = row
                filled[f] = k // every + 1
            untrimmed_s[f] += dt_s if not flights[f, ELEVON_LOW] < row[_ELEVON] < flights[f, ELEVON_HIGH] else 0.0
            k += 1
            if not going:
                outcome[f] = WHOLE
                break
        end_s[f] = row[0]


@njit
def condition_kernel(
    rows: FloatArray, filled: IntArray, host: FloatArray, points: FloatArray, still: FloatArray, time_s: FloatArray,
    histories: FloatArray,
) -> None:  # fmt: skip
    """Conditions of all points along some flights, and behind the end of each those of its soak.

    host      : as plugin_kernel.derive_conditions reads it
    points    : (point, PRESSURE_WIDTH + 1);  still : (point, 3) h_ref, p_surface, q_add of the soak
    time_s    : (time,) frames of the flights, then soak
    histories : (point, flight, time, condition), filled
    """
    lanes = np.arange(len(points))
    then = np.zeros((len(points), N_CONDITIONS))
    for f in range(len(rows)):
        for k in range(len(time_s)):
            if k < filled[f]:
                derive_conditions(rows[f, k, :_FRAME], host, points, lanes, then)
            for p in range(len(points)):
                if k >= filled[f]:
                    then[p, H_REF], then[p, P_SURFACE], then[p, Q_ADD] = still[p, 0], still[p, 1], still[p, 2]
                then[p, TIME] = time_s[k]
                for c in range(N_CONDITIONS):
                    histories[p, f, k, c] = then[p, c]
        then[:, Q_ADD] = 0.0


@njit
def set_lanes(
    B: FloatArray, J: IntArray, layer: IntArray, length_m: FloatArray, density: FloatArray, insulation: int,
    bondline: int, stacks: FloatArray, heating: FloatArray,
) -> None:  # fmt: skip
    """Write thermal and heating parameters of each lane, (LANES, values), into the block of one control point."""
    for lane in range(LANES):
        set_elements(B, J, lane, layer, length_m, density, insulation, bondline, stacks[lane])
        p = PARAMETERS * LANES + lane * N_PARAMETERS
        for k in range(N_PARAMETERS):
            B[p + k] = heating[lane, k]
        mark_order(B, p)
