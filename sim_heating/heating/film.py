"""Heating of a wall under flight conditions, compiled: film coefficient, recovery enthalpy and pressure at each stage
of the time step.

    film = r h_ref,    r = ratio of the linear model, then effects that add, then a lag, then effects that multiply;
    H_r = H_r,laminar + Gamma H_r,rise,    Gamma the intermittency where a point has transition (equation 6b).

A lag makes the ratio r' = (1 - f) r + f m, dm/dt = (r - m) / tau, integrated exactly for a ratio that is linear in
time over a step; it starts without history, m = r (docs/theory/equations.md, equations 5 to 8).

Conditions are linear in time between samples; the ratio is evaluated at the conditions of each stage of the time
step, not interpolated itself.
"""

from __future__ import annotations

import math

from sim_heating.base.arrays import FloatArray, IntArray
from sim_heating.base.kernels import block as k
from sim_heating.base.kernels.block import LANES
from sim_heating.base.kernels.elementary import LN_10, exp, log10
from sim_heating.base.kernels.jit import force_inline, inline_always, njit
from sim_heating.base.kernels.lag import lag_step
from sim_heating.base.kernels.operations import call_dispatcher
from sim_heating.heating.atmosphere import SEA_LEVEL_PA
from sim_heating.heating.effects.transition import intermittency, past_onset
from sim_heating.heating.ratio.lookup import (
    VARIABLES,
    cache_axis_cell,
    fraction,
    lanes_outside_cell,
    linear_ratio,
    table_ratios,
)

LOG10_SEA_LEVEL_PA = math.log10(SEA_LEVEL_PA)
PRESSURE = VARIABLES
"""Index of the pressure axis among the table cells that a lane caches; the ratio table's own axes come before it."""


@force_inline
def ratio_with_effects(
    B: FloatArray, J: IntArray, dispatcher, lane: int, stage: int, r: float, wall_K: float, first: int, end: int
) -> float:
    """Heating ratio [-] of a lane after some of its effects: r = L[r_lin + sum a_k] prod m_k, L the lag.

    B, J       : block of the lane group and its integers;  dispatcher : the compiled effects
    lane       : its number;  stage : 0 start, 1 middle, 2 end of the time step
    r          : ratio before them, of the linear model where `first` is 0 [-]
    wall_K     : wall temperature that the effects are evaluated at [K]
    first, end : slots of the effects, from `first` to before `end`; from 0, or from where all that follow multiply
    The lag comes with slot 0; its state at the stage is written into B, and so is the ratio that each factor finds.
    Source: docs/theory/equations.md, equations 6 and 8.
    """
    if end == first:
        return r
    c = k.C_STAGES * LANES + (stage * LANES + lane) * k.N_CONDITIONS
    p = k.PARAMETERS * LANES + lane * k.N_PARAMETERS + k.EFFECT_PARAMETERS
    adding = J[k.N_ADDING + lane]
    for slot in range(first, min(adding, end)):
        r += call_dispatcher(
            dispatcher, J[k.EFFECT_CODES + lane * k.EFFECT_SLOTS + slot], B, c, p + slot * k.EFFECT_WIDTH, wall_K
        )
    if first == 0 and J[k.LAG_SLOT + lane] != k.NONE:
        r = _lagged_ratio(B, lane, stage, p + J[k.LAG_SLOT + lane] * k.EFFECT_WIDTH, r)
    for slot in range(max(adding, first), end):
        B[k.RATIO_FOUND * LANES + lane] = r
        r *= call_dispatcher(
            dispatcher, J[k.EFFECT_CODES + lane * k.EFFECT_SLOTS + slot], B, c, p + slot * k.EFFECT_WIDTH, wall_K
        )
    return r


@inline_always
def _lagged_ratio(B: FloatArray, lane: int, stage: int, p: int, r: float) -> float:
    """Ratio [-] with its lag at a stage; time constant [s] and lagging part [-] are B[p] and B[p + 1].

    Exact for a linear ratio: docs/theory/equations.md, equation 8.
    """
    now = k.C_STAGES * LANES + (stage * LANES + lane) * k.N_CONDITIONS + k.TIME
    start = k.C_STAGES * LANES + lane * k.N_CONDITIONS + k.TIME
    m = r
    if B[k.LAG_PAST * LANES + lane] > 0.0 and B[now] > B[start]:
        steps = (B[now] - B[start]) / B[p]
        m = lag_step(B[k.LAG_VALUE * LANES + lane], B[k.LAG_INPUT * LANES + lane], r, steps)
    B[(k.LAG_VALUE + stage) * LANES + lane] = m
    B[(k.LAG_INPUT + stage) * LANES + lane] = r
    return r + B[p + 1] * (m - r)


@inline_always
def _recovery_rise(B: FloatArray, J: IntArray, lane: int, c: int, p: int) -> float:
    """Rise of the recovery enthalpy [J/kg] of a lane by transition, Gamma (H_turbulent - H_laminar); 0 without it.

    c, p : where the conditions of the stage and the parameters of the lane begin. docs/theory/equations.md,
        equation 6b.
    """
    slot = J[k.TRANSITION_SLOT + lane]
    if slot == k.NONE or B[c + k.RECOVERY_RISE] == 0.0:
        return 0.0
    return B[c + k.RECOVERY_RISE] * intermittency(B, c, p + k.EFFECT_PARAMETERS + slot * k.EFFECT_WIDTH)


@inline_always
def _step_factor(B: FloatArray, J: IntArray, lane: int, c: int, p: int) -> float:
    """Factor F of the film of a lane behind a step of wall temperature [-], by intermittency between its two flows.

    c, p : where the conditions of the stage and the parameters of the lane begin. Source: heating/interface.py.
    """
    laminar, turbulent = B[k.STEP_LAMINAR * LANES + lane], B[k.STEP_TURBULENT * LANES + lane]
    slot = J[k.TRANSITION_SLOT + lane]
    if slot == k.NONE or laminar == turbulent:
        return laminar
    return laminar + (turbulent - laminar) * intermittency(B, c, p + k.EFFECT_PARAMETERS + slot * k.EFFECT_WIDTH)


@inline_always
def _keep_past_onset(B: FloatArray, J: IntArray, lane: int, stage: int, c: int, p: int) -> None:
    """Write the distance past the onset of transition at a stage, which hysteresis needs at the next step."""
    slot = J[k.TRANSITION_SLOT + lane]
    if slot != k.NONE:
        past = past_onset(B, c, p + k.EFFECT_PARAMETERS + slot * k.EFFECT_WIDTH)
        B[(k.PAST_ONSET + stage) * LANES + lane] = past


@njit
def emittance_factor(B: FloatArray, J: IntArray, dispatcher, lane: int, stage: int, wall_K: float) -> float:
    """Factor [-] on the emittance of a lane: the product of its effects on emittance at a wall temperature.

    B, J   : block of the lane group and its integers;  dispatcher : the compiled effects
    lane   : its number;  stage : 0 start, 1 middle, 2 end of the time step;  wall_K : wall temperature [K]
    returns : 1 without such effects. It multiplies epsilon of the surface balance (docs/theory/equations.md,
        equation 2).
    """
    c = k.C_STAGES * LANES + (stage * LANES + lane) * k.N_CONDITIONS
    p = k.PARAMETERS * LANES + lane * k.N_PARAMETERS + k.EFFECT_PARAMETERS
    # Effects on emittance come after those on the ratio in the lane's list.
    first, factor = J[k.N_EFFECTS + lane], 1.0
    for slot in range(first, first + J[k.N_EMITTING + lane]):
        factor *= call_dispatcher(
            dispatcher, J[k.EFFECT_CODES + lane * k.EFFECT_SLOTS + slot], B, c, p + slot * k.EFFECT_WIDTH, wall_K
        )
    return factor


@inline_always
def _vent(B: FloatArray, stage: int) -> None:
    """Pressure in the insulation of all lanes at a stage, as log10 in CELL_X.

        tau dp_in/dt = p_surface - p_in

    Exact for a surface pressure that is linear over the step; p_in = p_surface at the start of a march.
    Source: docs/theory/equations_thermal_step.md, equation 10a.
    """
    for lane in range(LANES):
        c_0 = k.C_STAGES * LANES + lane * k.N_CONDITIONS
        c = c_0 + stage * LANES * k.N_CONDITIONS
        tau, dt, inside = B[k.VENTING_TAU * LANES + lane], B[c + k.TIME] - B[c_0 + k.TIME], B[c + k.P_SURFACE]
        if tau > 0.0 and B[k.LAG_PAST * LANES + lane] > 0.0 and dt > 0.0:
            inside = lag_step(B[k.VENTED * LANES + lane], B[c_0 + k.P_SURFACE], inside, dt / tau)
        B[(k.VENTED + stage) * LANES + lane] = inside
        B[(k.CELL_X + PRESSURE) * LANES + lane] = inside
    _logarithms(B)


@inline_always
def _logarithms(B: FloatArray) -> None:
    """Take log10 of the pressure of each lane in CELL_X [Pa], in place."""
    for lane in range(LANES):
        B[(k.CELL_X + PRESSURE) * LANES + lane] = log10(B[(k.CELL_X + PRESSURE) * LANES + lane])


@njit
def _pressure_columns(B: FloatArray, J: IntArray, table: FloatArray, stage: int) -> None:
    """Column of the property tables below the pressure of each lane, from its log10 in CELL_X, and the fraction of the
    way to the next column; the properties are linear in log10 p between columns and constant outside them.
    """
    # Pressure changes slowly: most steps stay in the cached column and skip the search.
    if lanes_outside_cell(B, PRESSURE) > 0:
        for lane in range(LANES):
            column = cache_axis_cell(B, table, lane, PRESSURE, J[k.PRESSURE_TABLE + lane], J[k.N_PRESSURES + lane])
            B[k.CELL_COLUMN * LANES + lane] = float(column)
    for lane in range(LANES):
        B[(k.PCOL + stage) * LANES + lane] = B[k.CELL_COLUMN * LANES + lane]
        B[(k.PFRAC + stage) * LANES + lane] = min(max(fraction(B, PRESSURE, lane), 0.0), 1.0)


@inline_always
def _air_places(B: FloatArray, J: IntArray, table: FloatArray, stage: int) -> None:
    """Place [-] of the pressure of each lane on the axis of its enthalpy of air, from log10 of the pressure in CELL_X.

    The axis is even in log10 p, so that its column is found without a search; it is constant outside.
    """
    for lane in range(LANES):
        first = J[k.ENTHALPY_TABLE + lane]
        position = (B[(k.CELL_X + PRESSURE) * LANES + lane] - table[first]) * table[first + 1]
        # In this order a place that is no number becomes 0: it is to be an index.
        position = position if position > 0.0 else 0.0
        B[(k.AIR_PLACE + stage) * LANES + lane] = position if position < table[first + 2] else table[first + 2]


@njit
def heat_lanes(B: FloatArray, J: IntArray, table: FloatArray, dispatcher, stage: int) -> None:
    """Film coefficient, recovery enthalpy, added flux and pressure column of all lanes at one stage.

    B, J  : block of the lane group and its integers; rows FILM [kg/(m2 s)], RECOVERY [J/kg], ADDED [W/m2],
            PCOL, PFRAC, AIR_PLACE [-] of the stage are written, OUTSIDE counts samples off the axes of the ratio table
    table : property and ratio tables;  dispatcher : the compiled effects;  stage : 0 start, 1 middle, 2 end of the step
    FILM is without effects that depend on the wall temperature: the surface evaluates these, and writes it.
    Source: docs/theory/equations.md, equations 5 to 8.
    """
    _heat(B, J, table, dispatcher, stage, False)
    c = k.C_STAGES * LANES + stage * LANES * k.N_CONDITIONS
    for lane in range(LANES):
        B[(k.CELL_X + PRESSURE) * LANES + lane] = B[c + (lane * k.N_CONDITIONS + k.P_SURFACE)]
    _logarithms(B)
    _air_places(B, J, table, stage)
    if J[k.VENTS] == 1:
        _vent(B, stage)
    _pressure_columns(B, J, table, stage)
    # Only the end of the step is counted: it is a sample of the record, the other stages lie between two.
    if stage == 2:
        for lane in range(LANES):
            B[k.OUTSIDE * LANES + lane] += 1.0 if B[k.OFF_AXES * LANES + lane] > 0.0 else 0.0


@njit
def heat_perturbed_lanes(B: FloatArray, J: IntArray, table: FloatArray, dispatcher, stage: int) -> None:
    """Film coefficient, recovery enthalpy and added flux of perturbed lanes, whose pressure is that of the nominal one.

    B, J  : block of the lane group and its integers; rows R_BASE [-], FILM [kg/(m2 s)], RECOVERY [J/kg], ADDED [W/m2]
            of the stage are written, all effects at the present wall temperatures
    table : property and ratio tables;  dispatcher : the compiled effects;  stage : 0 start, 1 middle, 2 end of the step
    Source: docs/theory/equations.md, equations 5 to 8 and 6b, film = r h_ref.
    """
    _heat(B, J, table, dispatcher, stage, True)


@njit
def _heat(B: FloatArray, J: IntArray, table: FloatArray, dispatcher, stage: int, at_wall: bool) -> None:
    """Heating of all lanes at one stage, without pressure columns; at_wall : whether with effects that depend on it."""
    table_ratios(B, J, table, stage)
    for lane in range(LANES):
        c = k.C_STAGES * LANES + (stage * LANES + lane) * k.N_CONDITIONS
        p = k.PARAMETERS * LANES + lane * k.N_PARAMETERS
        r = linear_ratio(B, p, c, B[k.CELL_WORK * LANES + lane])
        H_r = B[c + k.RECOVERY_ENTHALPY]
        if J[k.N_EFFECTS + lane] > 0:
            wall, first = B[(k.HEAD_ROWS + k.T) * LANES + lane], J[k.FIRST_AT_WALL + lane]
            r = ratio_with_effects(B, J, dispatcher, lane, stage, r, wall, 0, first)
            # Effects that depend on the wall temperature are evaluated again, from here, at every Newton iterate.
            B[(k.R_BASE + stage) * LANES + lane] = r
            if at_wall:
                r = ratio_with_effects(B, J, dispatcher, lane, stage, r, wall, first, J[k.N_EFFECTS + lane])
            H_r += _recovery_rise(B, J, lane, c, p)
            _keep_past_onset(B, J, lane, stage, c, p)
        film, factor, upstream = r * B[c + k.H_REF], 1.0, B[c + k.UPSTREAM]
        if upstream > 0.0:
            factor = _step_factor(B, J, lane, c, p)
            film *= factor
            H_r = upstream + (H_r - upstream) / factor
        B[(k.STEP_FACTOR + stage) * LANES + lane] = factor
        B[(k.FILM + stage) * LANES + lane] = film
        B[(k.RECOVERY + stage) * LANES + lane] = H_r
        B[(k.ADDED + stage) * LANES + lane] = B[c + k.Q_ADD]
        # 0 stands for what the stack declares: no surroundings are that cold, and none are the coldest declared.
        around, behind = B[c + k.SURROUNDINGS], B[c + k.BEHIND]
        declared4, declared = B[k.SURROUNDINGS4 * LANES + lane], B[k.BACK_T * LANES + lane]
        square = around * around
        B[(k.STAGE_SURROUNDINGS4 + stage) * LANES + lane] = square * square if around > 0.0 else declared4
        B[(k.STAGE_BACK_T + stage) * LANES + lane] = behind if behind > 0.0 else declared
        if J[k.CONVECTS] == 1:
            # Nu ~ Ra^n and Ra ~ p^2 for a gas of given temperatures (docs/theory/equations_thermal_step.md,
            # equation 15a).
            n = B[k.NATURAL_EXPONENT * LANES + lane]
            decades = log10(B[c + k.P_SURFACE]) - LOG10_SEA_LEVEL_PA
            natural = B[k.NATURAL * LANES + lane] * exp(2.0 * n * LN_10 * decades)
            B[(k.STAGE_NATURAL + stage) * LANES + lane] = natural
