"""Heating ratio of one control point, compiled: table lookup and the linear model about a reference condition.

    r = r_table(x) (1 + scale) + d0 + sum_i d_i (x_i - x_i0) + sum_(i<=j) d_ij (x_i - x_i0) (x_j - x_j0)

with x = alpha, beta [deg], log10 Re, elevon, body flap [deg]; no factor 1/2. Source: "Trends in Shuttle Entry
Heating from the Correlation of Flight Test Maneuvers", eq. 2, and its second-order terms.

A table is stored as five axis lengths, the axes one after the other, and the ratios with the last variable fastest.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sim_heating.heating_ratio.table import RatioTable
from sim_heating.jit import njit
from sim_heating.layout import CURVED, D0, FIRST, NO_TABLE, REFERENCE, SCALE, SECOND

FloatArray = NDArray[np.float64]
VARIABLES = 5


def pack_table(table: RatioTable) -> FloatArray:
    """The flat form of a ratio table that the kernel reads."""
    lengths = np.array([float(len(axis)) for axis in table.axes])
    return np.concatenate([lengths, *table.axes, np.ascontiguousarray(table.ratio).ravel()])


@njit
def _cell(axis: FloatArray, first: int, n: int, x: float) -> tuple[int, float]:
    """Cell of an increasing axis that holds x and the fraction of the way through it; the edge value holds outside."""
    if n == 1 or not x > axis[first]:
        return 0, 0.0
    if x >= axis[first + n - 1]:
        return n - 1, 0.0
    i = 0
    while x >= axis[first + i + 1]:
        i += 1
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
    """Multilinear ratio [-] of the table at an offset, for the five variables from x[at] on; edges hold outside."""
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
    node = first + i1 * s1 + i2 * s2 + i3 * s3 + i4 * s4 + i5
    low = _along_2(table, node, s2, s3, s4, f2, f3, f4, f5)
    return low if f1 == 0.0 else low + f1 * (_along_2(table, node + s1, s2, s3, s4, f2, f3, f4, f5) - low)


@njit
def axes_outside(table: FloatArray, offset: int, x: FloatArray, at: int) -> int:
    """How many of the five variables lie outside the axes of a table (an axis of one value has no outside)."""
    if offset == NO_TABLE:
        return 0
    first = offset + VARIABLES
    outside = 0
    for i in range(VARIABLES):
        n = int(table[offset + i])
        if n > 1 and not table[first] <= x[at + i] <= table[first + n - 1]:
            outside += 1
        first += n
    return outside


@njit
def linear_ratio(B: FloatArray, p: int, c: int, table: FloatArray, offset: int) -> float:
    """Ratio [-] before effects; parameters from B[p] on, conditions from B[c] on (layout.py)."""
    r = 0.0
    if offset != NO_TABLE:
        r = table_ratio(table, offset, B, c) * (1.0 + B[p + SCALE])
    r += B[p + D0]
    for i in range(VARIABLES):
        r += B[p + FIRST + i] * (B[c + i] - B[p + REFERENCE + i])
    if B[p + CURVED] != 0.0:
        k = p + SECOND
        for i in range(VARIABLES):
            for j in range(i, VARIABLES):
                r += B[k] * (B[c + i] - B[p + REFERENCE + i]) * (B[c + j] - B[p + REFERENCE + j])
                k += 1
    return r
