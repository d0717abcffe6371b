"""Heating ratio of one control point, compiled: table lookup and the linear model about a reference condition.

    r = r_table(x) (1 + scale) + d0 + sum_i d_i (x_i - x_i0) + sum_(i<=j) d_ij (x_i - x_i0) (x_j - x_j0)

with x = alpha, beta [deg], log10 Re [-], elevon, body flap [deg]; no factor 1/2. Source: "Trends in Shuttle Entry
Heating from the Correlation of Flight Test Maneuvers", eq. 2, and its second-order terms; docs/theory/equations.md,
equations 5 and 7.

A table is stored as five axis lengths, the axes one after the other, and the ratios with the last variable fastest.
"""

from __future__ import annotations

import numpy as np

from sim_heating.base.arrays import FloatArray, IntArray
from sim_heating.base.kernels import block as k
from sim_heating.base.kernels.axis import cell_of
from sim_heating.base.kernels.block import LANES
from sim_heating.base.kernels.elementary import lanes_outside
from sim_heating.base.kernels.jit import force_inline, inline_always, njit
from sim_heating.heating.ratio.table import RatioTable

VARIABLES = 5
FAR = 1e300
"""Bound of a cell that extends to infinity."""
NODE_SLACK = 0.05
"""Distance from the node of an axis of one value [deg], log10 Re [-], within which a flight is at that node."""


def pack_table(table: RatioTable) -> FloatArray:
    """Flat form of a ratio table that the kernels read.

    returns : five axis lengths, the nodes of the axes [deg] and [-], then the ratios [-] with the last variable fastest

    Source: docs/theory/equations.md, equation 7.
    """
    lengths = np.array([float(len(axis)) for axis in table.axes])
    return np.concatenate([lengths, *table.axes, np.ascontiguousarray(table.ratio).ravel()])


@njit
def _cell(axis: FloatArray, first: int, n: int, x: float) -> tuple[int, float]:
    """Cell of an increasing axis that contains x, and the fraction of the way through it [-]; outside, the edge."""
    if n == 1 or not x > axis[first]:
        return 0, 0.0
    if x >= axis[first + n - 1]:
        return n - 1, 0.0
    i = cell_of(axis, first, n, x)
    low = axis[first + i]
    return i, (x - low) / (axis[first + i + 1] - low)


@njit
def _along_5(r: FloatArray, at: int, f: float) -> float:
    return r[at] if f == 0.0 else r[at] + f * (r[at + 1] - r[at])


@njit
def _along_4(r: FloatArray, at: int, s4: int, f4: float, f5: float) -> float:
    low = _along_5(r, at, f5)
    return low if f4 == 0.0 else low + f4 * (_along_5(r, at + s4, f5) - low)


@njit
def _along_3(r: FloatArray, at: int, s3: int, s4: int, f3: float, f4: float, f5: float) -> float:
    low = _along_4(r, at, s4, f4, f5)
    return low if f3 == 0.0 else low + f3 * (_along_4(r, at + s3, s4, f4, f5) - low)


@njit
def _along_2(r: FloatArray, at: int, s2: int, s3: int, s4: int, f2: float, f3: float, f4: float, f5: float) -> float:
    low = _along_3(r, at, s3, s4, f3, f4, f5)
    return low if f2 == 0.0 else low + f2 * (_along_3(r, at + s2, s3, s4, f3, f4, f5) - low)


@njit
def table_ratio(table: FloatArray, offset: int, x: FloatArray, at: int) -> float:
    """Multilinear heating ratio [-] of a packed table at one condition; outside its axes the nearest edge value.

    table  : flat array of tables as `pack_table` makes them;  offset : where this one begins
    x, at  : array with alpha, beta [deg], log10 Re [-], elevon, body flap [deg] from x[at] on
    Source: docs/theory/equations.md, equation 7.
    """
    n1, n2, n3 = int(table[offset]), int(table[offset + 1]), int(table[offset + 2])
    n4, n5 = int(table[offset + 3]), int(table[offset + 4])
    first = offset + VARIABLES
    i1, f1 = _cell(table, first, n1, x[at])
    first += n1
    i2, f2 = _cell(table, first, n2, x[at + 1])
    first += n2
    i3, f3 = _cell(table, first, n3, x[at + 2])
    first += n3
    i4, f4 = _cell(table, first, n4, x[at + 3])
    first += n4
    i5, f5 = _cell(table, first, n5, x[at + 4])
    first += n5
    s4 = n5
    s3 = n4 * s4
    s2 = n3 * s3
    s1 = n2 * s2
    # Node by node instead of 32 corners: `f == 0` cuts the branches, so that an axis of one value costs nothing and
    # nothing is read beyond its end.
    node = first + i1 * s1 + i2 * s2 + i3 * s3 + i4 * s4 + i5
    low = _along_2(table, node, s2, s3, s4, f2, f3, f4, f5)
    return low if f1 == 0.0 else low + f1 * (_along_2(table, node + s1, s2, s3, s4, f2, f3, f4, f5) - low)


@njit
def largest_ratio(table: FloatArray, offset: int) -> float:
    """Largest heating ratio [-] at the nodes of a packed table, which its interpolation does not exceed.

    table : flat array of tables as `pack_table` makes them;  offset : where this one begins
    Source: docs/theory/equations.md, equation 7.
    """
    nodes, first = 1, offset + VARIABLES
    for a in range(VARIABLES):
        n = int(table[offset + a])
        nodes, first = nodes * n, first + n
    largest = table[first]
    for i in range(first + 1, first + nodes):
        largest = max(largest, table[i])
    return largest


def table_ratios_at(table: RatioTable, x: FloatArray) -> FloatArray:
    """Heating ratio of a table at many conditions; outside its axes the nearest edge value.

    x       : (sample, 5) alpha, beta [deg], log10 Re [-], elevon, body flap [deg]
    returns : (sample,) ratio [-], multilinear (docs/theory/equations.md, equation 7)
    """
    ratio = np.empty(len(x))
    _write_ratios(pack_table(table), np.array(x, dtype=float, order="C"), ratio)
    return ratio


@njit
def _write_ratios(table: FloatArray, x: FloatArray, ratio: FloatArray) -> None:
    for i in range(len(x)):
        ratio[i] = table_ratio(table, 0, x[i], 0)


@njit
def linear_ratio(B: FloatArray, p: int, c: int, tabulated: float) -> float:
    """Heating ratio [-] before effects: scale and offset on the tabulated one, first and second derivatives.

        r = r_table (1 + scale) + d0 + sum_i d_i (x_i - x_i0) + sum_(i<=j) d_ij (x_i - x_i0) (x_j - x_j0)

    B         : block of a lane group; parameters and reference condition from B[p] on, conditions from B[c] on
    tabulated : ratio of the table at the conditions [-]
    Source: docs/theory/equations.md, equation 5 (NASA CP-2283, equation 2, with second-order terms).
    """
    r = tabulated * (1.0 + B[p + k.SCALE]) + B[p + k.D0]
    # Most points have no derivatives: ORDER saves up to 20 terms a stage.
    if B[p + k.ORDER] >= 1.0:
        for i in range(VARIABLES):
            r += B[p + k.FIRST + i] * (B[c + i] - B[p + k.REFERENCE + i])
    if B[p + k.ORDER] >= 2.0:
        term = p + k.SECOND
        for i in range(VARIABLES):
            for j in range(i, VARIABLES):
                r += B[term] * (B[c + i] - B[p + k.REFERENCE + i]) * (B[c + j] - B[p + k.REFERENCE + j])
                term += 1
    return r


@njit
def linear_ratio_derivative(B: FloatArray, p: int, c: int, tabulated: float, parameter: int) -> float:
    """Derivative of `linear_ratio` with respect to one of its parameters, exact as the model is linear in them.

    B, p, c   : as in `linear_ratio`;  tabulated : ratio of the table [-]
    parameter : its offset from B[p]: SCALE, D0, or one from FIRST or SECOND on
    returns   : r_table, 1, dx_i or dx_i dx_j; [-], [deg] or their product
    Source: docs/theory/equations.md, equation 9.
    """
    if parameter == k.SCALE:
        return tabulated
    if parameter == k.D0:
        return 1.0
    if parameter < k.SECOND:
        return B[c + parameter - k.FIRST] - B[p + k.REFERENCE + parameter - k.FIRST]
    i, beyond = 0, parameter - k.SECOND
    while beyond >= VARIABLES - i:
        beyond -= VARIABLES - i
        i += 1
    j = i + beyond
    return (B[c + i] - B[p + k.REFERENCE + i]) * (B[c + j] - B[p + k.REFERENCE + j])


@njit
def write_order(B: FloatArray, p: int) -> None:
    """Write the highest order (0, 1 or 2) of the linear model with a derivative that is not 0 into B[p + ORDER].

    B, p : block of a lane group and where a lane's parameters begin
    `linear_ratio` omits the sums above that order (docs/theory/equations.md, equation 5).
    """
    B[p + k.ORDER] = 0.0
    for parameter in range(k.FIRST, k.REFERENCE):
        if B[p + parameter] != 0.0:
            # Second derivatives come last in the block, so that the last one that is not 0 decides.
            B[p + k.ORDER] = 2.0 if parameter >= k.SECOND else 1.0


@njit
def invalidate_cells(B: FloatArray) -> None:
    """Invalidate the table cells that all lanes cache, after tables or temperatures of a group were set from outside.

    B : block of the lane group. The bounds of every cached cell are made empty, so that the next lookup searches.

    Source: docs/theory/equations.md, equation 7.
    """
    for a in range(k.CELL_AXES):
        for lane in range(LANES):
            B[(k.CELL_LOW + a) * LANES + lane] = FAR
            B[(k.CELL_HIGH + a) * LANES + lane] = -FAR


@njit
def cache_axis_cell(B: FloatArray, table: FloatArray, lane: int, a: int, first: int, n: int) -> int:
    """Find and cache the cell of one axis that contains a lane's variable, [deg] or [-].

    B, lane  : block of the lane group and number of the lane; its variable is in row CELL_X + a, in the axis's unit
    table    : flat array; the n nodes of axis number a begin at `first`
    returns  : index of the cell, 0 for an axis of one value
    Bounds, lower node and inverse width are written into B; cells at the ends extend to infinity.

    Source: docs/theory/equations.md, equation 7.
    """
    i, low, high, foot, inverse = 0, -FAR, FAR, 0.0, 0.0
    if n > 1:
        i = cell_of(table, first, n, B[(k.CELL_X + a) * LANES + lane])
        foot = table[first + i]
        inverse = 1.0 / (table[first + i + 1] - foot)
        # Unbounded at the ends of the axis: a variable off the table does not start a search at every stage.
        low = foot if i > 0 else -FAR
        high = table[first + i + 1] if i < n - 2 else FAR
    B[(k.CELL_LOW + a) * LANES + lane] = low
    B[(k.CELL_HIGH + a) * LANES + lane] = high
    B[(k.CELL_FOOT + a) * LANES + lane] = foot
    B[(k.CELL_INVERSE + a) * LANES + lane] = inverse
    return i


@inline_always
def _cache_cell(B: FloatArray, table: FloatArray, offset: int, lane: int) -> None:
    """Cache the cell that contains a lane's variables, and the ratios at its 32 corners, 0 for a lane without table."""
    first, node, constant = offset + VARIABLES, 0, 0
    for a in range(VARIABLES):
        constant += 1 if offset == k.NO_TABLE or table[offset + a] == 1.0 else 0
    for a in range(VARIABLES):
        n = 1 if offset == k.NO_TABLE else int(table[offset + a])
        node = node * n + cache_axis_cell(B, table, lane, a, first, n)
        if n == 1 and offset != k.NO_TABLE:
            # Both corners are this node: the fraction says only whether the flight is at it.
            B[(k.CELL_FOOT + a) * LANES + lane] = table[first] - NODE_SLACK
            # A table of one node in all is a constant, which has no outside.
            B[(k.CELL_INVERSE + a) * LANES + lane] = 0.5 / NODE_SLACK if constant < VARIABLES else 0.0
        first += n
    for corner in range(32):
        at, stride = first + node, 1
        for a in range(VARIABLES - 1, -1, -1):
            n = 1 if offset == k.NO_TABLE else int(table[offset + a])
            at += stride if (corner >> a) & 1 == 1 and n > 1 else 0
            stride *= n
        B[(k.CORNERS + corner) * LANES + lane] = 0.0 if offset == k.NO_TABLE else table[at]


@njit
def _interpolate_along(B: FloatArray, corners: int, into: int, half: int, a: int) -> None:
    """Interpolate the corners along variable a, whose fraction is in its CELL_X row; half as many values remain."""
    for c in range(half):
        for lane in range(LANES):
            low = B[(corners + c) * LANES + lane]
            f = B[(k.CELL_X + a) * LANES + lane]
            B[(into + c) * LANES + lane] = low + f * (B[(corners + half + c) * LANES + lane] - low)


@force_inline
def lanes_outside_cell(B: FloatArray, a: int) -> int:
    """Number of pairs of lanes [-] of which at least one has left the cached cell of axis a.

    B : block of the lane group; rows CELL_X + a, CELL_LOW + a and CELL_HIGH + a, in the unit of the axis

    Source: docs/theory/equations.md, equation 7.
    """
    return lanes_outside(B, (k.CELL_X + a) * LANES, (k.CELL_LOW + a) * LANES, (k.CELL_HIGH + a) * LANES)


@force_inline
def fraction(B: FloatArray, a: int, lane: int) -> float:
    """Position of a lane's variable in its cached cell of axis a [-]: 0 at the lower node, 1 at the upper one.

    B : block of the lane group. Below 0 or above 1 only off the ends of the axis; of one value, off its node.
    It is f_v of docs/theory/equations.md, equation 7, before it is limited to 0 to 1.
    """
    x, foot = B[(k.CELL_X + a) * LANES + lane], B[(k.CELL_FOOT + a) * LANES + lane]
    return (x - foot) * B[(k.CELL_INVERSE + a) * LANES + lane]


@njit
def _interpolate(B: FloatArray, J: IntArray, table: FloatArray) -> None:
    """Ratio of all lanes from the variables in CELL_X, and the number of these variables off the axes of the table."""
    # All lanes are searched when one has left: rare in a flight, and the test stays free of branches.
    lanes_to_search = 0
    for a in range(VARIABLES):
        lanes_to_search += lanes_outside_cell(B, a)
    if lanes_to_search > 0:
        for lane in range(LANES):
            _cache_cell(B, table, J[k.RATIO_TABLE + lane], lane)
    for lane in range(LANES):
        B[k.OFF_AXES * LANES + lane] = 0.0
    for a in range(VARIABLES):
        for lane in range(LANES):
            f = fraction(B, a, lane)
            # `&` and not `and`: without a branch the loop over lanes vectorises.
            B[k.OFF_AXES * LANES + lane] += 0.0 if (f >= 0.0) & (f <= 1.0) else 1.0
            B[(k.CELL_X + a) * LANES + lane] = min(max(f, 0.0), 1.0)
    # Variable 4 first: bit a of a corner's number belongs to variable a, so that both halves are contiguous rows.
    # The table's own corners are kept; from four values on the work rows are overwritten in place.
    _interpolate_along(B, k.CORNERS, k.CELL_WORK + 8, 16, 4)
    _interpolate_along(B, k.CELL_WORK + 8, k.CELL_WORK, 8, 3)
    _interpolate_along(B, k.CELL_WORK, k.CELL_WORK, 4, 2)
    _interpolate_along(B, k.CELL_WORK, k.CELL_WORK, 2, 1)
    _interpolate_along(B, k.CELL_WORK, k.CELL_WORK, 1, 0)


@njit
def table_ratios(B: FloatArray, J: IntArray, table: FloatArray, stage: int) -> None:
    """Tabulated ratio [-] of all lanes at one stage, written into the first row of CELL_WORK.

    B, J  : block of the lane group and its integers;  table : flat array of tables
    stage : 0 start, 1 middle, 2 end of the time step, whose conditions are read
    Row OFF_AXES gets how many of the five variables lie outside the table (off an axis of one value: more than
    NODE_SLACK from it).
    The corners of a lane's cell are cached until it leaves the cell. Source: docs/theory/equations.md, equation 7.
    """
    c = k.C_STAGES * LANES + stage * LANES * k.N_CONDITIONS
    for a in range(VARIABLES):
        for lane in range(LANES):
            B[(k.CELL_X + a) * LANES + lane] = B[c + (lane * k.N_CONDITIONS + a)]
    _interpolate(B, J, table)
