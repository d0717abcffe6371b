"""Offsets in the flat float64 block of one lane group, and in its integers.

A group holds LANES control points (of one flight or of many). Its block is made of rows of LANES
numbers: SCALAR_ROWS rows, one ghost node, the nodes, one ghost node, NODE_ROWS rows a node. The last of the scalar rows
are taken lane by lane instead: a vector of flight conditions at the start, at the middle stage and at the end of a
step, and a vector of heating parameters.

Equations in these quantities: docs/theory/equations_thermal_step.md.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim_heating.base.conditions import DERIVED, RATIO_VARIABLES

LANES = 8
"""Control points side by side: eight float64 numbers are two AVX2 vectors or one of AVX-512."""
END: Any = np.int64(2)
"""Stage at the end of a step [-]. A plain 2 would be a type of its own to numba, and every kernel that takes a stage
would be compiled a second time."""
NO: Any = np.bool_(False)
"""An option of a kernel that is off, likewise of the type of one that is worked out."""

# Flight conditions of a lane, in contract units (base/conditions.py); the first five are the variables of a ratio
# table.
ALPHA, BETA, LOG10_RE, ELEVON, BODYFLAP = 0, 1, 2, 3, 4
P_SURFACE, H_REF, RECOVERY_ENTHALPY, Q_ADD, JETS, MACH, TIME, RECOVERY_RISE = 5, 6, 7, 8, 9, 10, 11, 12
TURBULENT_RATIO, LOG10_RE_THETA_M, DISSOCIATION, SURROUNDINGS, BEHIND = 13, 14, 15, 16, 17
STILL_AIR, AIR_K, UPSTREAM = 18, 19, 20
N_CONDITIONS = 21
_OF_FLIGHT = ("p_surface_Pa", "h_ref_kg_m2_s", "H_r_J_kg", "q_add_W_m2", "jets", "mach", "time_s")
_OF_SURROUNDINGS = ("T_surroundings_K", "T_back_K", "still_air_W_m2K43", "T_inf_K", "H_upstream_J_kg")
CONDITION_COLUMNS = (*RATIO_VARIABLES, *_OF_FLIGHT, *DERIVED[:4], *_OF_SURROUNDINGS)

# Heating parameters of a lane: the linear model about a reference condition (docs/theory/equations.md, section 2: 5
# first and 15 second derivatives, the reference, the highest order in use), then the parameters of its effects, slot by
# slot.
SCALE, D0, FIRST, SECOND, REFERENCE, ORDER = 0, 1, 2, 7, 22, 27
EFFECT_PARAMETERS = 28
EFFECT_SLOTS, EFFECT_WIDTH = 6, 10
N_PARAMETERS = EFFECT_PARAMETERS + EFFECT_SLOTS * EFFECT_WIDTH

# Scalar rows. The first six have one row a stage, at t_n, t_n + gamma dt, t_n + dt: film coefficient [kg/(m2 s)],
# recovery enthalpy [J/kg], added flux [W/m2], pressure column and fraction [-], ratio before the effects that depend on
# the wall temperature [-]. Then declared T_sur^4 [K4], back face and emittance factor; whether a lane iterates, its
# failures and iterations, the pressure column of its polynomials, samples outside a table and with a negative ratio;
# heat [W/m2] and energy [J/m2] at the faces.
FILM, RECOVERY, ADDED, PCOL, PFRAC, R_BASE = 0, 3, 6, 9, 12, 15
SURROUNDINGS4, BACK_H, BACK_T, BACK_EPS, FACTOR_EPS = 18, 19, 20, 21, 22
ACTIVE, FAILED, ITERATIONS, COLUMN, OUTSIDE, NEGATIVE = 23, 24, 25, 26, 27, 28
STAGE_IN, STAGE_OUT, ENERGY_IN, ENERGY_OUT = 29, 30, 31, 32
# The lag of a ratio, one row a stage: its value m and the ratio that it follows (docs/reference/effects.md,
# equation 19); whether it has a past. Fraction of the film that is spent at the surface, not in gaps. The length of the
# last step [s].
LAG_VALUE, LAG_INPUT, LAG_PAST, SURFACE_SHARE, LAST_STEP = 33, 36, 39, 40, 41
# Place of the pressure on the axis of the enthalpy of air, one row a stage [-]: column and fraction to the next. The
# ratio that an effect which multiplies it finds [-].
AIR_PLACE, RATIO_FOUND = 42, 45
# Control of the time step (thermal/frame.py): tolerated error of a step [K]; steps taken; whether a lane takes part in
# the step and whether its error is tolerated; the part of the frame that it has done [1/FINEST]. What a lane that
# repeats a step returns to: heat and energy at the faces in the order of STAGE_IN to ENERGY_OUT, failures, the lag at
# the end of the step. Samples outside a table at the end of a frame. Slope of the ratio against the wall temperature,
# of effects that depend on it [1/K].
TOLERANCE, STEPS, STEPPING, TOLERATED, DONE = 46, 47, 48, 49, 50
BEFORE_FACES, BEFORE_FAILED, BEFORE_LAG, COUNTED, WALL_SLOPE = 51, 55, 56, 58, 59
# Surroundings and back face, one row a stage: T_sur^4 [K4], temperature behind the wall [K], film coefficient of
# natural convection there at a difference of 1 K [W/(m2 K)]. Of that film: declared coefficient at sea level, exponent.
STAGE_SURROUNDINGS4, STAGE_BACK_T, STAGE_NATURAL, NATURAL, NATURAL_EXPONENT = 60, 63, 66, 69, 70
# Pressure in the insulation where it lags [Pa], one row a stage, and its time constant [s].
VENTED, VENTING_TAU = 71, 74
# Distance past the onset of transition with its hysteresis [-], one row a stage (heating/effects/transition.py).
PAST_ONSET = 75
# Change of the insulation's tables: conductivity with temperature [1/K] and with a decade of pressure [-], specific
# heat with temperature [1/K] (docs/theory/equations_thermal_step.md, equation 10b).
BEND_K, BEND_P, BEND_C = 78, 79, 80
# Factor F of the film behind a step of wall temperature [-], one row a stage, 1 without one; F of the laminar and of
# the turbulent boundary layer (heating/interface.py).
STEP_FACTOR, STEP_LAMINAR, STEP_TURBULENT = 81, 84, 85
C_STAGES = 86
# After the conditions of the three stages those at the start and at the end of a frame that is divided.
FRAME_START, FRAME_END = 3, 4
PARAMETERS = C_STAGES + 5 * N_CONDITIONS
# The cell that each lane is in, of its ratio table and of the pressures of its property tables: the five variables and
# log10 of the pressure [Pa], the ends of the cell (infinite at the edges of the table), its foot and the reciprocal of
# its width, the ratio at its 32 corners, the work of the interpolation between them, the number of variables outside
# their axes; the pressure column. Kept from step to step, since conditions seldom leave a cell.
CELL_AXES = 6
CELL_X = PARAMETERS + N_PARAMETERS
CELL_LOW, CELL_HIGH, CELL_FOOT, CELL_INVERSE = (CELL_X + k * CELL_AXES for k in range(1, 5))
CORNERS = CELL_X + 5 * CELL_AXES
CELL_WORK = CORNERS + 32
OFF_AXES, CELL_COLUMN = CELL_WORK + 24, CELL_WORK + 25
# Surface properties about the wall temperature, valid from WALL_LOW to WALL_HIGH [K] in the column WALL_COLUMN of the
# enthalpy of air: emittance at a foot [-] and its slope [1/K]; at another foot enthalpy of air [J/kg] and specific heat
# [J/(kg K)], in two pressure columns.
WALL_LOW, WALL_HIGH, WALL_COLUMN = (CELL_COLUMN + k for k in range(1, 4))
EPS_FOOT, EPS_AT_FOOT, EPS_SLOPE = (WALL_COLUMN + k for k in range(1, 4))
AIR_FOOT, AIR = EPS_SLOPE + 1, EPS_SLOPE + 2
SCALAR_ROWS = AIR + 4

_STAGES_OF_FILM = (FILM, RECOVERY, ADDED, PCOL, PFRAC, AIR_PLACE, R_BASE, LAG_VALUE, LAG_INPUT)
_STAGES_OF_SURROUNDINGS = (STAGE_SURROUNDINGS4, STAGE_BACK_T, STAGE_NATURAL, VENTED, PAST_ONSET, STEP_FACTOR)
STAGE_ROWS = (*_STAGES_OF_FILM, *_STAGES_OF_SURROUNDINGS)
"""First rows of the quantities that have one row for each of the three stages."""
COUNTERS = (FAILED, ITERATIONS, STEPS, OUTSIDE, NEGATIVE, ENERGY_IN, ENERGY_OUT)
"""Rows that count, or integrate, over a march."""
_KEPT_OF_FACES = (SURROUNDINGS4, BACK_H, BACK_T, BACK_EPS, FACTOR_EPS, FAILED, ITERATIONS, OUTSIDE, NEGATIVE)
_KEPT_OF_HEAT = (STAGE_IN, STAGE_OUT, ENERGY_IN, ENERGY_OUT, LAG_PAST, SURFACE_SHARE, LAST_STEP, STEPS)
KEPT_ROWS = (*(row + 2 for row in STAGE_ROWS), *_KEPT_OF_FACES, *_KEPT_OF_HEAT)
"""Scalar rows that belong to the state: of a quantity with one row a stage that of the end of the step. The conditions
of that stage are kept as well; all of them of the first lane of each point."""

# Rows of a node. The nodes of a group are to fit the processor's innermost cache: one row serves several quantities
# that are not needed at the same time. Temperature [K], rate at the end of the last step [K/s], temperature at the
# start of the step [K]; half masses of the elements on either side [kg/m2], conductance of that to the right [1/m] ...
T, RATE, T_START, M_LEFT, M_RIGHT, G = 0, 1, 2, 3, 4, 5
# ... heat content [J/m2] and capacity [J/(m2 K)] of the half elements on either side, heat that enters from outside
# [W/m2] and its slope [W/(m2 K)] ...
E_LEFT, E_RIGHT, C_LEFT, C_RIGHT, SOURCE, SLOPE = 6, 7, 8, 9, 10, 11
# ... heat content at the start of the step [J/m2]; net heat there [W/m2]; heat contents of a converged stage ...
E_START, NET, STAGE_LEFT, STAGE_RIGHT = 12, 13, 14, 15
# ... Kirchhoff's variable [W/m], until the right neighbour is assembled; then the matrix entry right of the diagonal (u
# in docs/theory/equations_thermal_step.md, equation 27); then the largest update of this node and those behind it, or
# the largest excess of the error over its bound of this node and those before it. The entry
# left of the diagonal in the row of the right neighbour (l) ...
THETA_RIGHT, ENTRY, LARGEST, EXCESS, LOWER = 16, 16, 16, 16, 17
# ... diagonal and residual of the row of the linear system, then the eliminated row (equation 29); the fraction between
# pressure columns, then whether a lane is updated, then the square of the time over which its curvature is extrapolated
# [s2], all passed from node to node ...
DIAGONAL, UPPER, RESIDUAL, DELTA, FRACTION, MOVES, BEND2 = 18, 18, 19, 19, 20, 20, 20
# ... and the property polynomials about its temperature, valid from LOW to HIGH [K] (equation 9): foot of the piece,
# then h, c, half its slope, theta, k, half its slope in one pressure column, and the differences of the last three to
# the next column, for the element to the right and to the left.
LOW, HIGH, FOOT, FOOT_LEFT = 21, 22, 23, 33
# Temperature at the middle stage [K], radiative conductivity at 1000 K of the element to the right [W/(m K)], half mass
# of insulation that takes up moisture, on either side [kg/m2], and the fraction of the film spent here [-].
T_STAGE, K_RAD, WET_LEFT, WET_RIGHT, GAP = 43, 44, 45, 46, 47
# Equal in all nodes of a lane (equations 11 to 13): temperature above which radiation adds to the tabulated
# conductivity [K]; latent heat of moisture [J/kg] taken up about a temperature [K], heat given off about another, the
# reciprocal of the width of both [1/K]. Not equal: the integral V of the vapour's conductivity in the element to the
# right [W/m].
RADIATES_FROM, LATENT, BOIL, DEPOSIT, CONDENSE, PHASE_RATE, VAPOUR = 48, 49, 50, 51, 52, 53, 54
# Curvature of the parabola through the last step, half its second derivative [K/s2]; RATE is its slope at the end.
CURVE = 55
# E* of the stage [J/m2], and its copy while the error of a step is found.
E_STAR, STAR_COPY = 56, 57
# Radiation between the two faces of a gas layer, which is one element: Stefan-Boltzmann constant over the resistance of
# the faces, of the element to the right [W/(m2 K4)] (docs/theory/equations_thermal_step.md, equation 11a).
BETWEEN_FACES = 58
NODE_ROWS = 59
HEAD_ROWS = SCALAR_ROWS + NODE_ROWS
"""A ghost node of zeros before the first and one behind the last end the recurrences along the nodes."""
INVALID_HIGH_K = -1e30
"""A HIGH [K] below every temperature: the polynomials have to be gathered."""

# Integers of a group: node count; then one a lane: number of pressure columns of its property tables, offsets of
# their pressures, of its emissivity, wall-enthalpy and ratio tables, number of its effects that add and of all on the
# ratio, the first of those that are evaluated again at each wall temperature, the code of each, the node at the back
# face (nodes behind it are padding, to the node count of the group: they have heat capacity and exchange no heat),
# number of effects on the emittance (their codes follow those of the ratio), the slots of the effect that lags and of
# transition, or NONE; then four flags of the group, whether any lane has moisture or radiation in depth or between
# faces, gaps, natural convection behind, or a venting lag.
# Then for each node two flags, whether its two elements differ in material in any lane and whether heat enters it from
# outside in any lane, and the material-table offset of the element to its right in each lane.
N_NODES = 0
N_PRESSURES = 1
PRESSURE_TABLE = N_PRESSURES + LANES
EMISSIVITY_TABLE = PRESSURE_TABLE + LANES
ENTHALPY_TABLE = EMISSIVITY_TABLE + LANES
RATIO_TABLE = ENTHALPY_TABLE + LANES
N_ADDING = RATIO_TABLE + LANES
N_EFFECTS = N_ADDING + LANES
FIRST_AT_WALL = N_EFFECTS + LANES
EFFECT_CODES = FIRST_AT_WALL + LANES
BACK_NODE = EFFECT_CODES + EFFECT_SLOTS * LANES
N_EMITTING = BACK_NODE + LANES
LAG_SLOT = N_EMITTING + LANES
TRANSITION_SLOT = LAG_SLOT + LANES
IN_DEPTH = TRANSITION_SLOT + LANES
GAPS = IN_DEPTH + 1
CONVECTS = GAPS + 1
VENTS = CONVECTS + 1
NODE_INTS = VENTS + 1
IS_INTERFACE, IS_FACE, MATERIAL_TABLE = 0, 1, 2
INTS_PER_NODE = MATERIAL_TABLE + LANES

NONE = -1
"""LAG_SLOT of a lane without an effect that lags, TRANSITION_SLOT of one without transition."""
NO_TABLE = -1
"""Ratio-table offset of a lane without a table; its tabulated ratio is 0 [-]."""


def block_size(nodes: int) -> int:
    """Number of float64 in the block of a group with this many nodes, its two ghost nodes included."""
    return (HEAD_ROWS + (nodes + 1) * NODE_ROWS) * LANES


def integers_size(nodes: int) -> int:
    """Number of integers of a group with this many nodes."""
    return NODE_INTS + nodes * INTS_PER_NODE


def conditions_at(stage: int, lane: int) -> int:
    """Offset in the block of a lane's condition vector (CONDITION_COLUMNS) at a stage: 0 start, 1 middle, 2 end."""
    return C_STAGES * LANES + (stage * LANES + lane) * N_CONDITIONS


def parameters_at(lane: int) -> int:
    """Offset in the block of a lane's vector of heating parameters (SCALE to the effects')."""
    return PARAMETERS * LANES + lane * N_PARAMETERS


def node_row(node: int, row: int) -> slice:
    """Slice of a block that holds one row (T, RATE, ...) of a node for all lanes; node 0 is at the surface."""
    first = (HEAD_ROWS + node * NODE_ROWS + row) * LANES
    return slice(first, first + LANES)


def node_rows(B: NDArray[np.float64]) -> NDArray[np.float64]:
    """(node, row, lane) all rows of the nodes of a block, padding included and ghosts left out, as a view."""
    return B[HEAD_ROWS * LANES :].reshape(-1, NODE_ROWS, LANES)[:-1]


def node_integers(J: NDArray[np.int64]) -> NDArray[np.int64]:
    """(node, integer) flags and material-table offsets of the nodes of a group, as a view."""
    return J[NODE_INTS:].reshape(-1, INTS_PER_NODE)


def scalar_row(row: int) -> slice:
    """Slice of a block that holds one scalar row (FILM, RECOVERY, ...) for all lanes."""
    return slice(row * LANES, (row + 1) * LANES)
