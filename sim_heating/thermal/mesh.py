"""Nodes through the thickness: fine at the surface, coarser inward, one on every interface and sensor.

Thickness is measured by diffusion: s = int dx / sqrt(a) [s^(1/2)] is the square root of the time that heat takes, the
same for all materials. The density of nodes in s is (docs/theory/equations_thermal_step.md, equation 38)

    1 / (s_0 + GROWTH s)  +  UNIFORM / S,      s_0 = SURFACE sqrt(max(dt, 1 s)),

S chosen so that UNIFORM is the share of evenly spaced nodes to graded ones: the graded part serves the surface, the
even one the steep gradients in depth. Halving every element keeps the grading, so that the difference between two
such meshes is an estimate of the error (equation 40, march/mesh_choice.py).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim_heating.base.arrays import FloatArray
from sim_heating.base.errors import InputError
from sim_heating.thermal.stack import Construction, pairs

SURFACE, GROWTH, UNIFORM = 0.4, 0.6, 0.6
"""Depth of an element at the surface over that which heat reaches in a step, growth of elements over their depth, and
share of evenly spaced nodes [-]. Of 18 sets tried (0.1 to 1, 0.3 to 2, 0.4 to 2) on tiles, felt, bare and skinned
insulation and hot structures, this one needed the fewest nodes for an error of 0.3 K on entries with steps of heating,
or nearly so, in all.
"""
CURVE_POINTS = 400
"""Points at which the node density is inverted in each piece of a layer."""
DIFFUSIVITY_AT_K, DIFFUSIVITY_AT_PA = 700.0, 1000.0
"""Temperature [K] and pressure [Pa] of the diffusivity that grades the mesh. Another choice moves nodes a little and
hardly the temperatures."""


@dataclass(frozen=True)
class Mesh:
    """Elements of one construction, outermost first.

    length_m : (n - 1,) length of an element [m], or its resistance [m2 K/W] where layer is -1 (a contact)
    layer    : (n - 1,) index of the layer of an element, -1 for a contact
    depth_m  : (n,) depth of a node [m]; equal on both sides of a contact
    sensors  : node at each depth of a sensor
    bondline : node at the outer face of the last layer
    gas      : layers of gas: each is one element, whose two nodes are the faces that radiate at each other
    """

    length_m: FloatArray
    layer: NDArray[np.int64]
    depth_m: FloatArray
    sensors: tuple[int, ...]
    bondline: int
    gas: tuple[int, ...] = ()

    @property
    def nodes(self) -> int:
        """Number of nodes [-], one more than elements."""
        return len(self.depth_m)


@dataclass(frozen=True)
class _Segment:
    """A piece of a layer between two depths that must be nodes; root_a is the square root of its diffusivity [m2/s]."""

    layer: int
    length_m: float
    root_a: float


def layer_diffusivities(construction: Construction) -> list[float]:
    """Thermal diffusivity a = k / (rho c) [m2/s] of each layer, outermost first, at 700 K and 1000 Pa.

    construction : the layers and their materials

    Beyond its table a property is constant. Source: docs/theory/equations_thermal_step.md, equation 37.
    """
    values = []
    for material in construction.layer_materials():
        p_Pa, T_K, k = material.conductivity_grid()
        at_p = [np.interp(np.log10(DIFFUSIVITY_AT_PA), np.log10(p_Pa), row) for row in k]
        c = np.interp(DIFFUSIVITY_AT_K, *pairs(material.specific_heat_J_kgK))
        values.append(float(np.interp(DIFFUSIVITY_AT_K, T_K, at_p) / (material.density_kg_m3 * c)))
    return values


def diffusion_depths(construction: Construction, mesh: Mesh) -> FloatArray:
    """Depth of each node measured by diffusion, s = int dx / sqrt(a).

    construction : layers, for the diffusivity a [m2/s] of each;  mesh : nodes and element lengths [m]
    returns      : (node,) [s^(1/2)] from the surface: the square root of the time [s] that heat takes

    Contacts add nothing. Source: docs/theory/equations_thermal_step.md, equation 37.
    """
    root_a = np.sqrt(np.array([*layer_diffusivities(construction), np.inf]))[mesh.layer]
    return np.concatenate(([0.0], np.cumsum(mesh.length_m / root_a)))


def _segments(construction: Construction, depths_m: FloatArray) -> list[_Segment]:
    interfaces = construction.stack.interfaces_m
    # A sensor this close to an interface, or to another sensor, shares its node instead of cutting off a sliver.
    closest = 1e-6 * interfaces[-1]
    segments = []
    for i, a in enumerate(layer_diffusivities(construction)):
        top, bottom = interfaces[i], interfaces[i + 1]
        inner = np.unique(depths_m[(depths_m > top + closest) & (depths_m < bottom - closest)])
        cuts = np.concatenate(([top], inner[np.diff(inner, prepend=-1.0) > closest], [bottom]))
        segments += [_Segment(i, float(d), float(np.sqrt(a))) for d in np.diff(cuts)]
    return segments


def _node_measure(s: FloatArray, depth: float, step_s: float) -> FloatArray:
    """Integral of the node density from the surface to s, not normalised (equation 39)."""
    s_0 = SURFACE * np.sqrt(max(step_s, 1.0))
    graded, all_graded = np.log1p(GROWTH * s / s_0), np.log1p(GROWTH * depth / s_0)
    return graded + UNIFORM * all_graded * s / depth


def _element_counts(weights: FloatArray, elements: int) -> NDArray[np.int64]:
    """Elements of each segment: one or more, in proportion to the shares, exactly `elements` in all."""
    counts = np.ones(len(weights), dtype=np.int64)
    for _ in range(elements - len(weights)):
        counts[np.argmax(weights / counts)] += 1
    return counts


def fewest_nodes(construction: Construction, depths_m: FloatArray) -> int:
    """Smallest possible number of nodes [-]: one on every interface and sensor, and two elements in the first layer.

    depths_m : (sensor,) depths that must be nodes [m]

    Rules of the mesh: docs/theory/equations_thermal_step.md, section 8.
    """
    contacts = sum(layer.contact_m2K_W > 0.0 for layer in construction.stack.layer)
    return len(_segments(construction, depths_m)) + contacts + 2


def build_mesh(construction: Construction, depths_m: FloatArray, nodes: int, step_s: float = 1.0) -> Mesh:
    """Mesh of exactly `nodes` nodes, graded for a time step.

    depths_m : (sensor,) depths from the surface that must be nodes [m]
    nodes    : number of nodes; `fewest_nodes` or more
    step_s   : longest time step to come [s]; elements at the surface are about as deep as heat reaches in it
    returns  : the mesh; every layer keeps its thickness to rounding
    raises   : InputError where there are fewer nodes than interfaces and sensors need

    Source: docs/theory/equations_thermal_step.md, equations 37 to 39.
    """
    fewest = fewest_nodes(construction, depths_m)
    if nodes < fewest:
        raise InputError(f"mesh: {nodes} nodes are too few for all interfaces and sensors; use {fewest} or more")
    segments = _segments(construction, depths_m)
    contacts = [layer.contact_m2K_W for layer in construction.stack.layer]
    s = np.concatenate(([0.0], np.cumsum([seg.length_m / seg.root_a for seg in segments])))
    measure = _node_measure(s, s[-1], step_s)
    # A gas layer stays one element: its faces are the two nodes between which it radiates.
    weights = np.where([seg.layer in construction.gas_layers for seg in segments], 0.0, np.diff(measure))
    counts = _element_counts(weights, nodes - 1 - int(np.count_nonzero(np.greater(contacts, 0.0))))
    # A coating of one element would have no node between its faces.
    if counts[0] < 2:
        counts[np.argmax(counts)] -= 1
        counts[0] += 1
    lengths, layers = [], []
    for i, segment in enumerate(segments):
        at = np.linspace(measure[i], measure[i + 1], counts[i] + 1)
        curve = np.linspace(s[i], s[i + 1], CURVE_POINTS)
        pieces = np.diff(np.interp(at, _node_measure(curve, s[-1], step_s), curve))
        # The numerical inverse of the measure does not sum up exactly; a layer keeps its thickness.
        lengths.append(segment.length_m * pieces / pieces.sum())
        layers.append(np.full(counts[i], segment.layer))
        last_of_layer = i + 1 == len(segments) or segments[i + 1].layer != segment.layer
        if last_of_layer and contacts[segment.layer] > 0.0:
            lengths.append(np.array([contacts[segment.layer]]))
            layers.append(np.array([-1]))
    return _place_nodes(construction, np.concatenate(lengths), np.concatenate(layers), depths_m)


def _place_nodes(
    construction: Construction, length_m: FloatArray, layer: NDArray[np.int64], depths_m: FloatArray
) -> Mesh:
    depth = np.concatenate(([0.0], np.cumsum(np.where(layer < 0, 0.0, length_m))))
    sensors = tuple(int(np.argmin(np.abs(depth - d))) for d in depths_m)
    last = len(construction.stack.layer) - 1
    bondline = int(np.flatnonzero(layer == last)[0])
    return Mesh(length_m, layer.astype(np.int64), depth, sensors, bondline, construction.gas_layers)


def halve_elements(mesh: Mesh) -> Mesh:
    """Mesh with every element halved; contacts, gas layers, and the depths of sensors and bondline, are unchanged.

    Two such meshes give the error estimate [K] of docs/theory/equations_thermal_step.md, equation 40.
    """
    times = np.where((mesh.layer < 0) | np.isin(mesh.layer, mesh.gas), 1, 2)
    first = np.concatenate(([0], np.cumsum(times)))
    length = np.repeat(mesh.length_m / times, times)
    layer = np.repeat(mesh.layer, times)
    depth = np.concatenate(([0.0], np.cumsum(np.where(layer < 0, 0.0, length))))
    return Mesh(length, layer, depth, tuple(int(first[i]) for i in mesh.sensors), int(first[mesh.bondline]), mesh.gas)


def interpolate_profile(profile: FloatArray, mesh: Mesh, other: Mesh) -> FloatArray:
    """Temperatures of one mesh on another, linear between nodes.

    profile : (node,) temperatures [K] on `mesh`
    other   : mesh of the same elements, or of parts of them
    returns : (node,) temperatures [K] on `other`; exact where it refines the mesh, as the elements are linear

    The interpolation is that of the linear elements of docs/theory/equations.md, section 3.
    """
    node_positions, positions = (np.concatenate(([0.0], np.cumsum(m.length_m))) for m in (mesh, other))
    return np.interp(positions, node_positions, profile)
