"""Rows of the thermal model's linear system, for eight control points (lanes) at once; compiled.

In each layer rho c(T) dT/dt = d/dx( k(T, p) dT/dx ). Linear finite elements in Kirchhoff's variable
theta = int k dT [W/m] make the flux of an element exact for k(T) (docs/theory/equations_thermal_step.md, equations 2
and 3):

    d/dt E_i = q_(i-1) - q_i + source_i,      q_i = g_i (theta_i(T_i) - theta_i(T_(i+1))),     g_i = 1 / dx_i

The heat content [J/m2] of an element is shared between its nodes by the mean of the lumped and the consistent mass
matrix (equation 4),

    E_i = M_L h(T_i) + M_R h(T_i) + SHARE [M_R (h(T_(i+1)) - h(T_i)) - M_L (h(T_i) - h(T_(i-1)))],    M = rho dx / 2,

whose second-order errors cancel where elements are equal (Goudreau and Taylor, Comp. Meth. Appl. Mech. Eng. 2 (1973)
69). The sum over the nodes is the heat in the stack for any SHARE.

Radiation through a porous material adds k_r (T / 1000 K)^3 to its conductivity (equation 11). A gas layer is one
element, through which its two faces radiate at each other as well: sigma (T_i^4 - T_(i+1)^4) / (1/eps_o + 1/eps_i - 1)
joins q_i (equation 11a). Moisture adds

    h_m(T) = L S((T - T_boil) / w) - D S((T - T_cond) / w),    S the logistic function,

to its heat content (equation 12): latent heat L taken up about T_boil, heat D given off where vapour from hotter depths
condenses.

All values are in one flat float64 block (base/kernels/block.py). Loops over lanes touch rows of one node and its
neighbours only, at constant distances: that lets the compiler vectorise them without alias checks. What all nodes of a
lane share is passed on from node to node (FRACTION, MOVES, LARGEST).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from sim_heating.base.arrays import FloatArray, IntArray
from sim_heating.base.kernels import block
from sim_heating.base.kernels.block import LANES
from sim_heating.base.kernels.elementary import lanes_outside, logistic
from sim_heating.base.kernels.jit import force_inline, inline_always, njit

SHARE = 1.0 / 6.0
"""Share of heat content between neighbours, lambda in docs/theory/equations_thermal_step.md, equation 4: 0 is the
lumped mass matrix, 1/3 the consistent one, and 1/6 cancels the error of second order (equation 5)."""
FAR = 1e300
"""Bound of an interval that has no end [K]."""
BIN_K = 5.0
"""Width of a property-table bin [K]."""
BINS = 600
"""Bins by which a piece of a property table is found; the last one has no upper end."""
REDUCED: Any = np.bool_(True)
WHOLE_ROWS: Any = np.bool_(False)
"""Whether `assemble` eliminates the rows as well. Plain True and False would be types of their own to numba, and
`assemble` would be compiled once for each."""
BEND_LOG10_PA = (0.0, 3.0, 5.0)
"""log10 of the pressures [Pa] between which a change of conductivity with pressure acts, and where there is none."""
NO_BENT_TABLE = 0.0
"""Distance to the table with slopes [-] that stands before the table of a material without one."""
PIECE_HEAD = 3
"""Numbers before the polynomials of a piece: its lower and upper end, and its foot [K]."""


@njit
def property_bin(temperature: float) -> int:
    """Property-table bin of a temperature [K].

    returns : index [-] from 0 to BINS - 1; 0 below 0 K and for NaN, with which the step reports a failure

    Source: docs/theory/equations_thermal_step.md, section 2.
    """
    scaled = temperature * (1.0 / BIN_K)
    # Not `scaled <= 0.0`: NaN compares false, and its conversion to an integer is undefined.
    if not scaled > 0.0:
        return 0
    return int(scaled) if scaled < BINS else BINS - 1


@njit
def piece_of(table: FloatArray, offset: int, width: int, temperature: float) -> int:
    """Offset in the tables of the piece of a material's properties that contains a temperature [K].

    offset : where the table of the material begins;  width : numbers in one piece

    Source: docs/theory/equations_thermal_step.md, section 2.
    """
    # The last piece ends at FAR: an infinite temperature would leave the table. It is reported as a failure.
    t = temperature if temperature < FAR else 0.0
    row = offset + BINS + int(table[offset + property_bin(t)]) * width
    # From the piece at the foot of the bin to that of the temperature: most bins lie in one piece.
    while t >= table[row + 1]:
        row += width
    return row


@njit
def _gather_polynomials(
    B: FloatArray, J: IntArray, table: FloatArray, a: int, lane: int, offset: int, into: int
) -> int:
    """Copy the property polynomials about a node's temperature from the table into its rows, for one adjacent element.

    returns : offset of the piece in the table
    """
    slope_k, decade, slope_c = (
        B[block.BEND_K * LANES + lane],
        B[block.BEND_P * LANES + lane],
        B[block.BEND_C * LANES + lane],
    )
    if table[offset - 1] != NO_BENT_TABLE and (slope_k != 0.0 or decade != 0.0 or slope_c != 0.0):
        return _gather_bent(B, J, table, a, lane, offset + int(table[offset - 1]), into)
    row = piece_of(table, offset, PIECE_HEAD + 3 + 3 * J[block.N_PRESSURES + lane], B[a + block.T * LANES + lane])
    column = row + PIECE_HEAD + 3 + 3 * int(B[block.COLUMN * LANES + lane])
    B[a + into * LANES + lane] = table[row + 2]
    for k in range(3):
        # The third number of each property is a slope; equation 9 takes half of it.
        half = 0.5 if k == 2 else 1.0
        B[a + (into + 1 + k) * LANES + lane] = half * table[row + PIECE_HEAD + k]
        B[a + (into + 4 + k) * LANES + lane] = half * table[column + k]
        B[a + (into + 7 + k) * LANES + lane] = half * (table[column + 3 + k] - table[column + k])
    return row


@njit
def _pressure_factor(decade: float, log10_p: float) -> float:
    """Factor on conductivity at a pressure [-]: 1 + decade (log10 p - 3), between 1 Pa and 100 kPa."""
    low, middle, high = BEND_LOG10_PA
    return 1.0 + decade * (min(max(log10_p, low), high) - middle)


@njit
def _gather_bent(B: FloatArray, J: IntArray, table: FloatArray, a: int, lane: int, offset: int, into: int) -> int:
    """`_gather_polynomials` from the table with slopes (docs/theory/equations_thermal_step.md, equation 10b):

    c = (1 + s_c (T - 700 K)) c_declared,    k = (1 + s_k (T - 700 K)) (1 + d (log10 p - 3)) k_declared
    """
    weighted = 3 + 3 * J[block.N_PRESSURES + lane]
    row = piece_of(table, offset, PIECE_HEAD + 2 * weighted, B[a + block.T * LANES + lane])
    slope_k, decade, slope_c = (
        B[block.BEND_K * LANES + lane],
        B[block.BEND_P * LANES + lane],
        B[block.BEND_C * LANES + lane],
    )
    at = int(B[block.COLUMN * LANES + lane])
    first, column = row + PIECE_HEAD, row + PIECE_HEAD + 3 + 3 * at
    pressures = J[block.PRESSURE_TABLE + lane] + at
    below, above = _pressure_factor(decade, table[pressures]), _pressure_factor(decade, table[pressures + 1])
    B[a + into * LANES + lane] = table[row + 2]
    for k in range(3):
        half = 0.5 if k == 2 else 1.0
        c = table[first + k] + slope_c * table[first + weighted + k]
        low = below * (table[column + k] + slope_k * table[column + weighted + k])
        high = above * (table[column + 3 + k] + slope_k * table[column + 3 + weighted + k])
        B[a + (into + 1 + k) * LANES + lane] = half * c
        B[a + (into + 4 + k) * LANES + lane] = half * low
        B[a + (into + 7 + k) * LANES + lane] = half * (high - low)
    return row


@inline_always
def _refresh_polynomials(B: FloatArray, J: IntArray, table: FloatArray, i: int) -> None:
    """Gather the polynomials of node i again in the lanes whose temperature has left the piece they are valid in."""
    a = (block.HEAD_ROWS + i * block.NODE_ROWS) * LANES
    if lanes_outside(B, a + block.T * LANES, a + block.LOW * LANES, a + block.HIGH * LANES) == 0:
        return
    node = block.NODE_INTS + i * block.INTS_PER_NODE
    for lane in range(LANES):
        t = B[a + block.T * LANES + lane]
        if not (t >= B[a + block.LOW * LANES + lane] and t < B[a + block.HIGH * LANES + lane]):
            row = _gather_polynomials(B, J, table, a, lane, J[node + block.MATERIAL_TABLE + lane], block.FOOT)
            low, high = table[row], table[row + 1]
            if J[node + block.IS_INTERFACE] == 1:
                row = _gather_polynomials(
                    B, J, table, a, lane, J[node - block.INTS_PER_NODE + block.MATERIAL_TABLE + lane], block.FOOT_LEFT
                )
                low, high = max(low, table[row]), min(high, table[row + 1])
            B[a + block.LOW * LANES + lane] = low
            B[a + block.HIGH * LANES + lane] = high


@force_inline
def _integral(value: float, first: float, half: float, t: float) -> tuple[float, float]:
    """value + integral from 0 to t of (first + slope t), and first + slope t; `half` is half the slope."""
    bent = half * t
    return value + t * (first + bent), first + (bent + bent)


@force_inline
def heat_content(B: FloatArray, at: int, left_row: int, right_row: int) -> float:
    """Heat content of a node [J/m2], with what it shares with its neighbours.

    B                   : block of a lane group;  at : offset of the first number of the node in its lane
    left_row, right_row : rows with the heat contents of the half elements on either side [J/m2]

    Source: docs/theory/equations_thermal_step.md, equation 4.
    """
    content_left, content_right = B[at + left_row * LANES], B[at + right_row * LANES]
    next_left, last_right = at + (block.NODE_ROWS + left_row) * LANES, at + (right_row - block.NODE_ROWS) * LANES
    return content_left + content_right + SHARE * (B[next_left] - content_right - content_left + B[last_right])


class Properties(NamedTuple):
    """Properties of a material at a node: enthalpy [J/kg], specific heat [J/(kg K)], theta [W/m], k [W/(m K)]."""

    h: float
    c: float
    theta: float
    k: float


@njit
def _properties(B: FloatArray, a: int, lane: int, foot: int, f: float) -> Properties:
    """Properties at a node's temperature.

    f : fraction [-] between two pressure columns (docs/theory/equations_thermal_step.md, equations 9 and 10)
    """
    t = B[a + block.T * LANES + lane] - B[a + foot * LANES + lane]
    x = a + (foot + 1) * LANES + lane
    h, c = _integral(B[x], B[x + LANES], B[x + 2 * LANES], t)
    theta0 = B[x + 3 * LANES] + f * B[x + 6 * LANES]
    k0 = B[x + 4 * LANES] + f * B[x + 7 * LANES]
    half = B[x + 5 * LANES] + f * B[x + 8 * LANES]
    theta, k = _integral(theta0, k0, half, t)
    return Properties(h, c, theta, k)


@force_inline
def _radiation_in_depth(T_K: float, begin_K: float) -> tuple[float, float]:
    """Kirchhoff's variable [K] and conductivity [-] of radiation in depth, over its conductivity at 1000 K.

    Radiation adds (T^3 - T_0^3) / (1000 K)^3 above T_0, up to which the declared tables contain it
    (docs/theory/equations_thermal_step.md, equation 11).
    """
    above = max(T_K, begin_K)
    cube, begin_cube = above * above * above, begin_K * begin_K * begin_K
    theta = 0.25 * (cube * above - begin_cube * begin_K) - begin_cube * (above - begin_K)
    return 1e-9 * theta, 1e-9 * (cube - begin_cube)


@njit
def _write_row(B: FloatArray, a: int, lane: int, ddt: float, before: Properties, behind: Properties) -> None:
    """Row of a node from its properties on either side, and its contribution to the row of its left neighbour.

    What crosses an element, heat conducted in d dt and heat content shared, is one term
    (docs/theory/equations_thermal_step.md, equations 26 to 28).
    """
    previous = a - block.NODE_ROWS * LANES
    h_left, c_left, theta_left, k_left = before
    h, c, theta, k = behind
    m_left, m_right = B[a + block.M_LEFT * LANES + lane], B[a + block.M_RIGHT * LANES + lane]
    e_left, cap_left, e_right, cap_right = m_left * h_left, m_left * c_left, m_right * h, m_right * c
    g_left = ddt * B[previous + block.G * LANES + lane]
    across = g_left * (B[previous + block.THETA_RIGHT * LANES + lane] - theta_left)
    across += SHARE * (e_left - B[previous + block.E_RIGHT * LANES + lane])
    entry = SHARE * cap_left - g_left * k_left
    lower = SHARE * cap_right - ddt * B[a + block.G * LANES + lane] * k
    B[a + block.E_LEFT * LANES + lane] = e_left
    B[a + block.C_LEFT * LANES + lane] = cap_left
    B[a + block.E_RIGHT * LANES + lane] = e_right
    B[a + block.C_RIGHT * LANES + lane] = cap_right
    B[a + block.THETA_RIGHT * LANES + lane] = theta
    B[previous + block.RESIDUAL * LANES + lane] += across
    B[previous + block.ENTRY * LANES + lane] = entry
    B[a + block.LOWER * LANES + lane] = lower
    B[a + block.DIAGONAL * LANES + lane] = cap_left + cap_right - entry - lower
    B[a + block.RESIDUAL * LANES + lane] = e_left + e_right - B[a + block.E_STAR * LANES + lane] - across


@force_inline
def _add_in_depth(B: FloatArray, a: int, lane: int, ddt: float) -> None:
    """Add moisture, vapour and radiation to the row of a node whose left neighbour has them already.

    Separate from the row itself, as most walls have none of them; dry lanes of the group go through the same arithmetic
    (docs/theory/equations_thermal_step.md, equations 11 to 13 and 11a).
    """
    previous = a - block.NODE_ROWS * LANES
    t, rate = B[a + block.T * LANES + lane], B[a + block.PHASE_RATE * LANES + lane]
    up = logistic((t - B[a + block.BOIL * LANES + lane]) * rate)
    down = logistic((t - B[a + block.CONDENSE * LANES + lane]) * rate)
    rising, falling = up * (1.0 - up) * rate, down * (1.0 - down) * rate
    L, D = B[a + block.LATENT * LANES + lane], B[a + block.DEPOSIT * LANES + lane]
    h, c = L * up - D * down, L * rising - D * falling
    theta_rad, k_rad = _radiation_in_depth(t, B[a + block.RADIATES_FROM * LANES + lane])
    k_1_left, k_1_right = B[previous + block.K_RAD * LANES + lane], B[a + block.K_RAD * LANES + lane]
    vapour_left, vapour_right = B[previous + block.VAPOUR * LANES + lane], B[a + block.VAPOUR * LANES + lane]
    wet_left, wet_right = B[a + block.WET_LEFT * LANES + lane], B[a + block.WET_RIGHT * LANES + lane]
    g_left = ddt * B[previous + block.G * LANES + lane]
    t_left, cube = B[previous + block.T * LANES + lane], t * t * t
    faces_left, faces_right = (
        ddt * B[previous + block.BETWEEN_FACES * LANES + lane],
        ddt * B[a + block.BETWEEN_FACES * LANES + lane],
    )
    across = SHARE * wet_left * h - g_left * (k_1_left * theta_rad + vapour_left * up)
    across += faces_left * (t_left * t_left * t_left * t_left - cube * t)
    entry = SHARE * wet_left * c - g_left * (k_1_left * k_rad + vapour_left * rising) - 4.0 * faces_left * cube
    k_right = k_1_right * k_rad + vapour_right * rising
    lower = SHARE * wet_right * c - ddt * B[a + block.G * LANES + lane] * k_right - 4.0 * faces_right * cube
    B[a + block.E_LEFT * LANES + lane] += wet_left * h
    B[a + block.C_LEFT * LANES + lane] += wet_left * c
    B[a + block.E_RIGHT * LANES + lane] += wet_right * h
    B[a + block.C_RIGHT * LANES + lane] += wet_right * c
    B[a + block.THETA_RIGHT * LANES + lane] += k_1_right * theta_rad + vapour_right * up
    B[previous + block.RESIDUAL * LANES + lane] += across
    B[previous + block.ENTRY * LANES + lane] += entry
    B[a + block.LOWER * LANES + lane] += lower
    B[a + block.DIAGONAL * LANES + lane] += (wet_left + wet_right) * c - entry - lower
    B[a + block.RESIDUAL * LANES + lane] += (wet_left + wet_right) * h - across


@inline_always
def _assemble_row(B: FloatArray, J: IntArray, table: FloatArray, i: int, ddt: float) -> None:
    """Row of node i at its present temperature, heat from outside included."""
    a = (block.HEAD_ROWS + i * block.NODE_ROWS) * LANES
    previous = a - block.NODE_ROWS * LANES
    _refresh_polynomials(B, J, table, i)
    if J[block.NODE_INTS + i * block.INTS_PER_NODE + block.IS_INTERFACE] == 1:
        for lane in range(LANES):
            f = B[previous + block.FRACTION * LANES + lane]
            B[a + block.FRACTION * LANES + lane] = f
            _write_row(
                B, a, lane, ddt, _properties(B, a, lane, block.FOOT_LEFT, f), _properties(B, a, lane, block.FOOT, f)
            )
    else:
        for lane in range(LANES):
            f = B[previous + block.FRACTION * LANES + lane]
            B[a + block.FRACTION * LANES + lane] = f
            properties = _properties(B, a, lane, block.FOOT, f)
            _write_row(B, a, lane, ddt, properties, properties)
    if J[block.IN_DEPTH] == 1:
        for lane in range(LANES):
            _add_in_depth(B, a, lane, ddt)
    if J[block.NODE_INTS + i * block.INTS_PER_NODE + block.IS_FACE] == 1:
        for lane in range(LANES):
            B[a + block.RESIDUAL * LANES + lane] -= ddt * B[a + block.SOURCE * LANES + lane]
            B[a + block.DIAGONAL * LANES + lane] -= ddt * B[a + block.SLOPE * LANES + lane]


@inline_always
def _eliminate_row(B: FloatArray, i: int) -> None:
    """Eliminate row i, whose right neighbour is assembled (docs/theory/equations_thermal_step.md, equation 29)."""
    a = (block.HEAD_ROWS + i * block.NODE_ROWS) * LANES
    previous = a - block.NODE_ROWS * LANES
    for lane in range(LANES):
        # No pivoting: the diagonal dominates its column by the heat capacity of the node and the slope of its source.
        lower = B[previous + block.LOWER * LANES + lane]
        pivot = 1.0 / (B[a + block.DIAGONAL * LANES + lane] - lower * B[previous + block.UPPER * LANES + lane])
        residual = B[a + block.RESIDUAL * LANES + lane] + lower * B[previous + block.DELTA * LANES + lane]
        B[a + block.UPPER * LANES + lane] = B[a + block.ENTRY * LANES + lane] * pivot
        B[a + block.DELTA * LANES + lane] = -residual * pivot


@njit
def assemble(B: FloatArray, J: IntArray, table: FloatArray, ddt: float, reduces: bool) -> None:
    """Residuals and tridiagonal matrix of all nodes at their present temperatures, heat from outside included.

        R_i = E_i - E*_i - d dt F_i [J/m2],    A = dR/dT [J/(m2 K)]

    B       : block of the lane group; SOURCE [W/m2] and SLOPE [W/(m2 K)] are evaluated already (faces.py)
    J       : its integers
    table   : property tables
    ddt     : d dt [s], d = 1 - sqrt(2) / 2; 0 leaves the heat contents alone in R
    reduces : whether each row is eliminated as soon as its right neighbour is assembled

    Writes E_LEFT to C_RIGHT, and DIAGONAL, ENTRY, LOWER, RESIDUAL, or the reduced rows UPPER and DELTA.
    Source: docs/theory/equations_thermal_step.md, equations 25 to 29.
    """
    n = J[block.N_NODES]
    before, last = block.SCALAR_ROWS * LANES, (block.HEAD_ROWS + (n - 1) * block.NODE_ROWS) * LANES
    for lane in range(LANES):  # the ghost before takes 0 times the first node's theta, which an infinite one would mark
        B[before + block.RESIDUAL * LANES + lane] = 0.0
        B[before + block.THETA_RIGHT * LANES + lane] = 0.0
    for i in range(n):
        _assemble_row(B, J, table, i, ddt)
        if reduces and i > 0:
            _eliminate_row(B, i - 1)
    # What crosses to the ghost behind: content that padding shares with it, nothing where there is none.
    for lane in range(LANES):
        B[last + block.RESIDUAL * LANES + lane] -= SHARE * B[last + block.E_RIGHT * LANES + lane]
        # The row still holds theta: the last node has no right neighbour that would have replaced it.
        B[last + block.ENTRY * LANES + lane] = 0.0
    if reduces:
        _eliminate_row(B, n - 1)


@njit
def select_pressure(B: FloatArray, J: IntArray, stage: int) -> None:
    """Set the pressure column and fraction [-] of a stage in every lane (docs/theory/equations_thermal_step.md,
    equation 10).

    stage : 0, 1 or 2; start, middle and end of a step

    Where any lane moves to another pair of columns, the polynomials gathered for the group are invalidated.
    """
    changed = 0
    for lane in range(LANES):
        B[(block.SCALAR_ROWS + block.FRACTION) * LANES + lane] = B[(block.PFRAC + stage) * LANES + lane]
        if B[block.COLUMN * LANES + lane] != B[(block.PCOL + stage) * LANES + lane]:
            changed += 1
            B[block.COLUMN * LANES + lane] = B[(block.PCOL + stage) * LANES + lane]
    if changed > 0:
        for i in range(J[block.N_NODES]):
            for lane in range(LANES):
                B[(block.HEAD_ROWS + i * block.NODE_ROWS + block.HIGH) * LANES + lane] = block.INVALID_HIGH_K
