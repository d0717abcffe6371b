"""Where everything stands in the flat float64 block of one lane group, and in the integers beside it.

A group holds LANES control points (of one flight or of many). Its block is made of rows of LANES
numbers: SCALAR_ROWS rows, one ghost node, the nodes, one ghost node, NODE_ROWS rows a node. The last of the scalar rows
are taken lane by lane instead: a vector of flight conditions at the start, at the middle stage and at the end of a
step, and a vector of heating parameters.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

LANES = 8
END: Any = np.int64(2)
"""Stage at the end of a step. A plain 2 would have what takes a stage compiled a second time, for 2 alone."""

# Flight conditions of a lane, in contract units (base/conditions.py); the first five are the variables of a ratio
# table.
ALPHA, BETA, LOG10_RE, ELEVON, BODYFLAP = 0, 1, 2, 3, 4
P_SURFACE, H_REF, RECOVERY_ENTHALPY, Q_ADD, JETS, MACH, TIME = 5, 6, 7, 8, 9, 10, 11
N_CONDITIONS = 12
CONDITION_COLUMNS = (
    "alpha_deg", "beta_deg", "log10_re", "elevon_deg", "bodyflap_deg",
    "p_surface_Pa", "h_ref_kg_m2_s", "H_r_J_kg", "q_add_W_m2", "jets", "mach", "time_s",
)  # fmt: skip

# Heating parameters of a lane: the linear model about a reference condition, then the parameters of its effects.
SCALE, D0, FIRST, SECOND, REFERENCE, ORDER = 0, 1, 2, 7, 22, 27
EFFECT_PARAMETERS = 28
EFFECT_SLOTS, EFFECT_WIDTH = 4, 10
N_PARAMETERS = EFFECT_PARAMETERS + EFFECT_SLOTS * EFFECT_WIDTH

# Scalar rows. The first six hold one row a stage: at t_n, t_n + gamma dt, t_n + dt.
FILM, RECOVERY, ADDED, PCOL, PFRAC, R_BASE = 0, 3, 6, 9, 12, 15
SURROUNDINGS4, BACK_H, BACK_T, BACK_EPS, FACTOR_EPS = 18, 19, 20, 21, 22
ACTIVE, FAILED, ITERATIONS, COLUMN, OUTSIDE, NEGATIVE = 23, 24, 25, 26, 27, 28
STAGE_IN, STAGE_OUT, ENERGY_IN, ENERGY_OUT = 29, 30, 31, 32
# The lag of a ratio, one row a stage: its value and what it follows; whether it has a past. Part of the film that the
# surface has, the rest being spent in gaps. The length of the last step [s].
LAG_VALUE, LAG_INPUT, LAG_PAST, SURFACE_SHARE, LAST_STEP = 33, 36, 39, 40, 41
C_STAGES = 42
PARAMETERS = C_STAGES + 3 * N_CONDITIONS
# The cell that each lane is in, of its ratio table and of the pressures of its property tables: the five variables and
# log10 of the pressure [Pa], where the cell ends (for ever at the edges of the table), its foot and the reciprocal of
# its width, the ratio at its 32 corners, what is left of them, how many variables are off the axes; the column of the
# pressures.
CELL_AXES = 6
CELL_X = PARAMETERS + N_PARAMETERS
CELL_LOW, CELL_HIGH, CELL_FOOT, CELL_INVERSE = (CELL_X + k * CELL_AXES for k in range(1, 5))
CORNERS = CELL_X + 5 * CELL_AXES
CELL_WORK = CORNERS + 32
OFF_AXES, CELL_COLUMN = CELL_WORK + 24, CELL_WORK + 25
# What the surface is made of about its temperature, from WALL_LOW to WALL_HIGH [K] in the pressure column WALL_COLUMN:
# emittance at a foot, and its slope; enthalpy of air at another foot [J/kg] and specific heat, in two columns.
WALL_LOW, WALL_HIGH, WALL_COLUMN = (CELL_COLUMN + k for k in range(1, 4))
EPS_FOOT, EPS_AT_FOOT, EPS_SLOPE = (WALL_COLUMN + k for k in range(1, 4))
AIR_FOOT, AIR = EPS_SLOPE + 1, EPS_SLOPE + 2
SCALAR_ROWS = AIR + 4

# Rows of a node. The nodes of a group are to fit the processor's innermost cache: a row serves several numbers whose
# times do not overlap. What the node is and where it stands in time ...
T, RATE, T_START, M_LEFT, M_RIGHT, G = 0, 1, 2, 3, 4, 5
# ... heat content and capacity of the half elements on either side, heat that enters from outside ...
E_LEFT, E_RIGHT, C_LEFT, C_RIGHT, SOURCE, SLOPE = 6, 7, 8, 9, 10, 11
# ... the time step at work on it: heat content at its start; net heat there, then the explicit part; contents of a
# converged stage ...
E_START, NET, E_STAR, STAGE_LEFT, STAGE_RIGHT = 12, 13, 13, 14, 15
# ... Kirchhoff's variable, until the right neighbour is assembled; then how what crosses the element between grows with
# that one's temperature; then the largest update behind. How it grows with this one's ...
THETA_RIGHT, ENTRY, LARGEST, LOWER = 16, 16, 16, 17
# ... diagonal and residual of the row of the linear system, then the reduced row; the fraction between pressures,
# then whether a lane moves, both handed along ...
DIAGONAL, UPPER, RESIDUAL, DELTA, FRACTION, MOVES = 18, 18, 19, 19, 20, 20
# ... and the property polynomials about its temperature, which hold from LOW to HIGH: foot of the bin, then h, c, half
# its slope, theta, k, half its slope in one pressure column, and how much more these are in the next, for the element
# to the right and to the left.
LOW, HIGH, FOOT, FOOT_LEFT = 21, 22, 23, 33
# the temperature at the middle stage of the last step, radiative conductivity at 1000 K of the element to the right
# [W/(m K)], density times length that moisture sits in, on either side [kg/m2], and the part of the film spent here.
T_STAGE, K_RAD, WET_LEFT, WET_RIGHT, GAP = 43, 44, 45, 46, 47
# What the nodes of a lane share in depth: temperature from which on radiation adds to the conductivity of the tables
# [K]; heat content of moisture, taken up [J/kg] about a temperature [K], given off about another, over a width, here
# its reciprocal [1/K]. Heat that vapour carries in the element to the right from where moisture boils to where it has
# not yet [W/m].
RADIATES_FROM, LATENT, BOIL, DEPOSIT, CONDENSE, PHASE_RATE, VAPOUR = 48, 49, 50, 51, 52, 53, 54
# Of the parabola through the last step, beside RATE, its slope at the end [K/s]: its curvature, half the second
# derivative [K/s2].
CURVE = 55
NODE_ROWS = 56
HEAD_ROWS = SCALAR_ROWS + NODE_ROWS
"""A ghost node of zeros before the first and one behind the last end the recurrences along the nodes."""
NOWHERE = -1e30
"""A HIGH that no temperature is below: the polynomials have to be gathered."""

# Integers of a group: node count; one a lane: number of pressure columns of its property tables, offsets of their
# pressures, of its emissivity, wall-enthalpy and ratio tables, how many of its effects add and how many it has,
# whether any of them asks for the wall temperature, the code of each, the node at the back face (nodes behind it
# are padding, to the node count of the group: they hold heat and exchange none), how many effects act on the emittance
# (their codes follow those of the ratio) and the slot of the effect that lags, or NONE; two of the group, whether any
# lane has moisture or radiation in depth and whether any has gaps. Then for each node two flags,
# whether its two elements differ in material in any lane and whether it is a face of the stack in any lane, and the
# material-table offset of the element to its right in each lane.
N_NODES = 0
N_PRESSURES = 1
PRESSURE_TABLE = N_PRESSURES + LANES
EMISSIVITY_TABLE = PRESSURE_TABLE + LANES
ENTHALPY_TABLE = EMISSIVITY_TABLE + LANES
RATIO_TABLE = ENTHALPY_TABLE + LANES
N_ADDING = RATIO_TABLE + LANES
N_EFFECTS = N_ADDING + LANES
WALL_EFFECTS = N_EFFECTS + LANES
EFFECT_CODES = WALL_EFFECTS + LANES
BACK_NODE = EFFECT_CODES + EFFECT_SLOTS * LANES
N_EMITTING = BACK_NODE + LANES
LAG_SLOT = N_EMITTING + LANES
IN_DEPTH = LAG_SLOT + LANES
GAPS = IN_DEPTH + 1
NODE_INTS = GAPS + 1
IS_INTERFACE, IS_FACE, MATERIAL_TABLE = 0, 1, 2
INTS_PER_NODE = MATERIAL_TABLE + LANES

NONE = -1
"""Slot of a lane without an effect that lags."""
NO_TABLE = -1
"""Ratio-table offset of a lane without one: its tabulated ratio is 0."""


def block_size(nodes: int) -> int:
    """Numbers in the block of a group of so many nodes."""
    return (HEAD_ROWS + (nodes + 1) * NODE_ROWS) * LANES


def integers_size(nodes: int) -> int:
    """Integers of a group of so many nodes."""
    return NODE_INTS + nodes * INTS_PER_NODE


def conditions_at(stage: int, lane: int) -> int:
    """First number of a lane's condition vector at a stage."""
    return C_STAGES * LANES + (stage * LANES + lane) * N_CONDITIONS


def parameters_at(lane: int) -> int:
    """First number of a lane's parameter vector."""
    return PARAMETERS * LANES + lane * N_PARAMETERS


def node_row(node: int, row: int) -> slice:
    """The numbers of one row of a node, all lanes."""
    first = (HEAD_ROWS + node * NODE_ROWS + row) * LANES
    return slice(first, first + LANES)


def node_rows(B: NDArray[np.float64]) -> NDArray[np.float64]:
    """(node, row, lane) all rows of the nodes of a block, padding included, as a view."""
    return B[HEAD_ROWS * LANES :].reshape(-1, NODE_ROWS, LANES)[:-1]


def node_integers(J: NDArray[np.int64]) -> NDArray[np.int64]:
    """(node, integer) flags and material tables of the nodes of a group, as a view."""
    return J[NODE_INTS:].reshape(-1, INTS_PER_NODE)


def scalar_row(row: int) -> slice:
    """The numbers of one scalar row, all lanes."""
    return slice(row * LANES, (row + 1) * LANES)
