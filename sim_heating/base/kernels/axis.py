"""Cell of a table's axis that contains a value, for arrays and for kernels.

Cell i lies between the nodes i and i + 1; a value on an inner node belongs to the cell above it. Values beyond the ends
belong to the first and to the last cell, so that each caller decides whether to extrapolate or to use the edge.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from sim_heating.base.arrays import FloatArray, IntArray
from sim_heating.base.kernels.jit import njit


def cells_of(axis: FloatArray, values: ArrayLike) -> IntArray:
    """Cell of an increasing axis for each of many values.

    axis    : (n,) increasing nodes;  values : any shape, in the unit of the axis
    returns : index of the lower node, 0 to n - 2, in the shape of the values; 0 for an axis of one node
    """
    return np.clip(np.searchsorted(axis, values, side="right") - 1, 0, max(len(axis) - 2, 0))


@njit
def cell_of(block: FloatArray, first: int, n: int, value: float) -> int:
    """Cell of an increasing axis, of n nodes from block[first] on; by a linear search, as axes of tables are short.

    returns : index of the lower node, 0 to n - 2; 0 for an axis of one node and for a value that is not a number
    """
    i = 0
    while i < n - 2 and value >= block[first + i + 1]:
        i += 1
    return i
