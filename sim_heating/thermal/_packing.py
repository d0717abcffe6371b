"""What the parameters of a control point change in the block of its group, written into all its lanes; compiled."""

from __future__ import annotations

from sim_heating.base.arrays import FloatArray, IntArray
from sim_heating.base.kernels.block import (
    CURVE,
    HEAD_ROWS,
    HIGH,
    LANES,
    N_PARAMETERS,
    NODE_ROWS,
    NOWHERE,
    PARAMETERS,
    RATE,
    T,
)
from sim_heating.base.kernels.jit import njit
from sim_heating.heating.ratio.lookup import mark_order
from sim_heating.thermal.elements import set_elements


@njit
def set_point(
    B: FloatArray, J: IntArray, first: int, last: int, layer: IntArray, length_m: FloatArray, density: FloatArray,
    insulation: int, bondline: int, stack: FloatArray, heating: FloatArray,
) -> None:  # fmt: skip
    """Write the parameters of a point into its lanes, `first` to before `last`.

    layer .. bondline : as elements.set_elements takes them
    stack   : values of parameters.STACK
    heating : (N_PARAMETERS,) its vector of heating parameters (base/kernels/block.py)
    """
    for lane in range(first, last):
        set_elements(B, J, lane, layer, length_m, density, insulation, bondline, stack)
        p = PARAMETERS * LANES + lane * N_PARAMETERS
        for k in range(N_PARAMETERS):
            B[p + k] = heating[k]
        mark_order(B, p)


@njit
def set_temperatures(B: FloatArray, first: int, last: int, nodes: int, temperature_K: FloatArray) -> None:
    """Set the node temperatures of a point in its lanes; padding behind its back, to the node count of the group, has
    that of the back."""
    for i in range(nodes):
        at = (HEAD_ROWS + i * NODE_ROWS) * LANES
        for lane in range(first, last):
            B[at + T * LANES + lane] = temperature_K[min(i, len(temperature_K) - 1)]
            B[at + RATE * LANES + lane] = 0.0
            B[at + CURVE * LANES + lane] = 0.0
            B[at + HIGH * LANES + lane] = NOWHERE
