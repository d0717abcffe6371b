"""Parameters and temperatures of a control point, written into all its lanes of a block; compiled."""

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

    B, J              : block of the lane group and its integers, changed
    layer .. bondline : elements of the point, lengths [m] and densities [kg/m3], as elements.set_elements takes them
    stack             : values of parameters.STACK, each in its unit
    heating           : (N_PARAMETERS,) its vector of heating parameters (layout.py)

    Heat contents are left as they were: the next frame has to be one of kernel.BEGIN.
    Source: docs/equations_thermal_step.md, equation 8; docs/equations.md, section 2.
    """
    for lane in range(first, last):
        set_elements(B, J, lane, layer, length_m, density, insulation, bondline, stack)
        p = PARAMETERS * LANES + lane * N_PARAMETERS
        for k in range(N_PARAMETERS):
            B[p + k] = heating[k]
        mark_order(B, p)


@njit
def set_temperatures(B: FloatArray, first: int, last: int, nodes: int, temperature_K: FloatArray) -> None:
    """Set the node temperatures of a point in its lanes, and forget the rate and curvature of its last step.

    first, last   : its lanes, `first` to before `last`
    nodes         : node count of the group
    temperature_K : (node,) [K]; padding nodes behind the back get the temperature of the back

    The parabola of docs/equations_thermal_step.md, equation 23, becomes constant, so that the first guess is the start.
    """
    for i in range(nodes):
        at = (HEAD_ROWS + i * NODE_ROWS) * LANES
        for lane in range(first, last):
            B[at + T * LANES + lane] = temperature_K[min(i, len(temperature_K) - 1)]
            B[at + RATE * LANES + lane] = 0.0
            B[at + CURVE * LANES + lane] = 0.0
            # The polynomials about the old temperature may not hold for the new one.
            B[at + HIGH * LANES + lane] = NOWHERE
