"""A control point written into its lanes of a block: elements and faces, parameters, temperatures; compiled."""

from __future__ import annotations

from typing import NamedTuple

from sim_heating.base.arrays import FloatArray, IntArray
from sim_heating.base.kernels import block
from sim_heating.base.kernels.block import LANES
from sim_heating.base.kernels.elementary import exp
from sim_heating.base.kernels.jit import inline_always, njit
from sim_heating.base.parameters import LAYER_SLOTS
from sim_heating.heating.ratio.lookup import write_order

COATING_THICKNESS, COATING_CONDUCTIVITY, COATING_CAPACITY, RSI_CONDUCTIVITY, RSI_CAPACITY = range(5)
CONDUCTIVITY_SLOPE, CONDUCTIVITY_DECADE, CAPACITY_SLOPE, EMISSIVITY, RADIATIVE, RADIATION_FROM = range(5, 11)
LATENT_HEAT, BOILS, DEPOSITED, CONDENSES, WIDTH, CARRIED, GAP_FRACTION, GAP_DEPTH, CONTACT = range(11, 20)
H_BEHIND, T_BEHIND, EPS_BEHIND = range(20, 23)
"""Indices of the parameters of parameters.STACK, in their order."""
OWN = EPS_BEHIND + 1
"""Index of the first parameter of a layer by its own name; behind those of parameters.STACK, slot by slot."""
OWN_THICKNESS, OWN_CONDUCTIVITY, OWN_CAPACITY, OWN_WIDTH = range(4)
"""Indices of the parameters of parameters.LAYER within a slot, and their number."""
STACK_WIDTH = OWN + OWN_WIDTH * LAYER_SLOTS


class Elements(NamedTuple):
    """Elements of a control point as its lanes take them.

    layer         : (element,) index of its layer, -1 for a contact
    length_m      : (element,) declared length [m] or, of a contact, resistance [m2 K/W]
    density_kg_m3 : (element,) [kg/m3], 0 for a contact
    slot          : (element,) slot of the parameters of its layer's own name, -1 where it has none
    stretch       : (element,) relative change of its length over that of its layer's thickness [-]
    insulation    : index of the layer that `stack.rsi.*` is about
    bondline      : node down to which a gap reaches
    """

    layer: IntArray
    length_m: FloatArray
    density_kg_m3: FloatArray
    slot: IntArray
    stretch: FloatArray
    insulation: int
    bondline: int


@njit
def set_elements(B: FloatArray, J: IntArray, lane: int, elements: Elements, p: FloatArray) -> None:
    """Write the elements and faces of a lane into the block of its group, with its parameters applied.

        g = f_k / l [1/m],    M = rho f_c l / 2 [kg/m2],    l = (1 + b (f_x - 1)) dx [m];
        a contact R [m2 K/W]: g = 1 / R, M = 0

    B, J     : block of the lane group and its integers, changed;  lane : number of the lane in it
    elements : elements of the point, b their stretch
    p        : (STACK_WIDTH,) values of parameters.STACK and of the layers by their own names, each in its unit

    Source: docs/theory/equations_thermal_step.md, equations 7, 8, 11 to 13 and 16.
    """
    layer, length_m, insulation = elements.layer, elements.length_m, elements.insulation
    for e in range(len(layer)):
        thickness, conductivity, capacity, radiative = 1.0, 1.0, 1.0, 0.0
        # Asked first: a stack of one layer has no coating, and its layer is the insulation.
        if layer[e] == insulation:
            conductivity, capacity, radiative = p[RSI_CONDUCTIVITY], p[RSI_CAPACITY], p[RADIATIVE]
        elif layer[e] == 0:
            thickness, conductivity, capacity = p[COATING_THICKNESS], p[COATING_CONDUCTIVITY], p[COATING_CAPACITY]
        elif layer[e] < 0:
            thickness = p[CONTACT]
        if elements.slot[e] >= 0:
            factors = OWN + OWN_WIDTH * elements.slot[e]
            thickness *= p[factors + OWN_THICKNESS]
            conductivity *= p[factors + OWN_CONDUCTIVITY]
            capacity *= p[factors + OWN_CAPACITY]
        length = (1.0 + elements.stretch[e] * (thickness - 1.0)) * length_m[e]
        half = 0.5 * elements.density_kg_m3[e] * length * capacity
        # Moisture is declared per mass of insulation, and so takes the heat-capacity factor with it.
        wet = half if layer[e] == insulation else 0.0
        here = (block.HEAD_ROWS + e * block.NODE_ROWS) * LANES + lane
        right = here + block.NODE_ROWS * LANES
        B[here + block.G * LANES] = conductivity / length
        B[here + block.K_RAD * LANES] = radiative
        B[here + block.M_RIGHT * LANES] = half
        B[right + block.M_LEFT * LANES] = half
        B[here + block.WET_RIGHT * LANES] = wet
        B[right + block.WET_LEFT * LANES] = wet
    _set_bends(B, lane, len(layer) + 1, p)
    _set_in_depth(B, J, lane, layer, insulation, p)
    _set_faces(B, lane, p)
    _set_gap(B, J, lane, layer, length_m, elements.bondline, p)


@inline_always
def _set_bends(B: FloatArray, lane: int, nodes: int, p: FloatArray) -> None:
    """Write the change of the insulation's tables of a lane; where it is new, polynomials are gathered again."""
    slope, decade, capacity = p[CONDUCTIVITY_SLOPE], p[CONDUCTIVITY_DECADE], p[CAPACITY_SLOPE]
    at_k, at_p, at_c = block.BEND_K * LANES + lane, block.BEND_P * LANES + lane, block.BEND_C * LANES + lane
    if B[at_k] != slope or B[at_p] != decade or B[at_c] != capacity:
        B[at_k], B[at_p], B[at_c] = slope, decade, capacity
        for i in range(nodes):
            B[(block.HEAD_ROWS + i * block.NODE_ROWS + block.HIGH) * LANES + lane] = block.INVALID_HIGH_K


@inline_always
def _set_in_depth(B: FloatArray, J: IntArray, lane: int, layer: IntArray, insulation: int, p: FloatArray) -> None:
    """Write moisture and radiation of a lane into every node, where loops over lanes read them; not twice the same."""
    insulated = 0
    while insulated < len(layer) - 1 and layer[insulated] != insulation:
        insulated += 1
    first, moist = block.HEAD_ROWS * LANES + lane, (block.HEAD_ROWS + insulated * block.NODE_ROWS) * LANES + lane
    rows = (block.RADIATES_FROM, block.LATENT, block.BOIL, block.DEPOSIT, block.CONDENSE, block.PHASE_RATE)
    values = (p[RADIATION_FROM], p[LATENT_HEAT], p[BOILS], p[DEPOSITED], p[CONDENSES], 1.0 / p[WIDTH])
    is_there = B[moist + block.VAPOUR * LANES] == p[CARRIED]
    for k in range(len(rows)):
        is_there = is_there and B[first + rows[k] * LANES] == values[k]
    for i in range(0 if is_there else len(layer) + 1):
        a = (block.HEAD_ROWS + i * block.NODE_ROWS) * LANES + lane
        for k in range(len(rows)):
            B[a + rows[k] * LANES] = values[k]
        B[a + block.VAPOUR * LANES] = p[CARRIED] if i < len(layer) and layer[i] == insulation else 0.0
    # One flag for the group, only ever set here: a dry lane next to a moist one computes zeros. A perturbed lane may be
    # below 0 and in a group of its own.
    if p[LATENT_HEAT] != 0.0 or p[DEPOSITED] != 0.0 or p[CARRIED] != 0.0 or p[RADIATIVE] != 0.0:
        J[block.IN_DEPTH] = 1


@inline_always
def _set_faces(B: FloatArray, lane: int, p: FloatArray) -> None:
    B[block.FACTOR_EPS * LANES + lane] = p[EMISSIVITY]
    B[block.BACK_H * LANES + lane], B[block.BACK_T * LANES + lane] = p[H_BEHIND], p[T_BEHIND]
    B[block.BACK_EPS * LANES + lane] = p[EPS_BEHIND]


@inline_always
def _set_gap(
    B: FloatArray, J: IntArray, lane: int, layer: IntArray, length_m: FloatArray, bondline: int, p: FloatArray
) -> None:
    """Fractions of the film spent along a gap, falling with depth as exp(-x / depth) down to the bondline.

    A node has what falls between the middles of its elements; the fractions sum to p[GAP_FRACTION]
    (docs/theory/equations_thermal_step.md, equation 16).
    """
    n = len(layer) + 1
    fraction, depth = p[GAP_FRACTION], p[GAP_DEPTH]
    # without a gap now and before, all fractions are 0
    if fraction == 0.0 and B[block.SURFACE_SHARE * LANES + lane] == 1.0:
        return
    B[block.SURFACE_SHARE * LANES + lane] = 1.0 - fraction
    bottom = 0.0
    # A stack of one layer has its bondline at node 0: its gaps reach the back face.
    for e in range(bondline if bondline > 0 else n - 1):
        bottom += length_m[e] if layer[e] >= 0 else 0.0
    full_decay = 1.0 - exp(-bottom / depth)
    x, above = 0.0, 1.0
    for i in range(n):
        length = length_m[i] if i < n - 1 and layer[i] >= 0 else 0.0
        edge = x + 0.5 * length
        below = exp(-min(edge, bottom) / depth)
        gap = (block.HEAD_ROWS + i * block.NODE_ROWS + block.GAP) * LANES + lane
        B[gap] = fraction * ((above - below) / full_decay)
        x, above = x + length, below
        if fraction != 0.0:
            J[block.GAPS] = 1
            J[block.NODE_INTS + i * block.INTS_PER_NODE + block.IS_FACE] = 1


@njit
def set_point(
    B: FloatArray, J: IntArray, first: int, last: int, elements: Elements, stack: FloatArray, heating: FloatArray
) -> None:
    """Write the parameters of a point into its lanes, `first` to before `last`.

    B, J     : block of the lane group and its integers, changed
    elements : elements of the point, lengths [m] and densities [kg/m3] among them
    stack    : (STACK_WIDTH,) values of parameters.STACK and of the layers by their own names, each in its unit
    heating  : (N_PARAMETERS,) its vector of heating parameters (base/kernels/block.py)

    Heat contents are left as they were: the next frame has to be one of step.EVALUATE_START.
    Source: docs/theory/equations_thermal_step.md, equation 8; docs/theory/equations.md, section 2.
    """
    for lane in range(first, last):
        set_elements(B, J, lane, elements, stack)
        p = block.PARAMETERS * LANES + lane * block.N_PARAMETERS
        for k in range(block.N_PARAMETERS):
            B[p + k] = heating[k]
        write_order(B, p)


@njit
def set_lanes(
    state: FloatArray, ints: IntArray, positions: IntArray, elements: Elements, stack: FloatArray, heating: FloatArray
) -> None:
    """Write parameters of one point into several lanes, each with its own values.

    state, ints    : blocks of lane groups, one after the other, and their integers, changed
    positions      : (lane, 5) where the block of its group begins and ends, where the integers of that do, its number
    elements       : elements of the point, lengths [m] and densities [kg/m3] among them
    stack, heating : (lane, STACK_WIDTH), (lane, N_PARAMETERS), as for `set_point`

    Source: docs/theory/equations_thermal_step.md, equation 8; docs/theory/equations.md, section 2.
    """
    for k in range(len(positions)):
        B, J = state[positions[k, 0] : positions[k, 1]], ints[positions[k, 2] : positions[k, 3]]
        set_point(B, J, positions[k, 4], positions[k, 4] + 1, elements, stack[k], heating[k])


@njit
def set_temperatures(B: FloatArray, first: int, last: int, nodes: int, temperature_K: FloatArray) -> None:
    """Set the node temperatures of a point in its lanes, and forget the rate and curvature of its last step.

    first, last   : its lanes, `first` to before `last`
    nodes         : node count of the group
    temperature_K : (node,) [K]; padding nodes behind the back get the temperature of the back

    The parabola of docs/theory/equations_thermal_step.md, equation 23, becomes constant, so that the first guess is the
    start.
    """
    for i in range(nodes):
        at = (block.HEAD_ROWS + i * block.NODE_ROWS) * LANES
        for lane in range(first, last):
            B[at + block.T * LANES + lane] = temperature_K[min(i, len(temperature_K) - 1)]
            B[at + block.RATE * LANES + lane] = 0.0
            B[at + block.CURVE * LANES + lane] = 0.0
            # The polynomials about the old temperature may not hold for the new one.
            B[at + block.HIGH * LANES + lane] = block.INVALID_HIGH_K
