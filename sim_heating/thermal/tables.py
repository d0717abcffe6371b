"""Property tables as the kernel reads them: bins of BIN_K kelvin, columns of pressure, one flat float64 array.

A property that is linear between the points of its file is resampled at the bin edges and is linear between those, its
integral (heat content, Kirchhoff's variable) exact for the resampled property. With the points on bin edges that is the
file itself; otherwise a corner is cut within the 5 K bin that holds it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim_heating.reference_heating.gas import wall_enthalpy_grid
from sim_heating.thermal.declare import Material, pairs
from sim_heating.thermal.kernel import BIN_K, BINS

FloatArray = NDArray[np.float64]
EDGES_K = BIN_K * np.arange(BINS + 1)
ENTHALPY_PRESSURES_PA = np.logspace(0.0, 6.0, 7)
"""Pressures at which the enthalpy of equilibrium air is tabulated."""

WallEnthalpy = float | str
"""A constant specific heat [J/(kg K)], or the name of a gas model of reference_heating.gas."""


@dataclass(frozen=True)
class PropertyTables:
    """All tables of an ensemble in one array, with the offsets at which the kernel finds them.

    log10_p : (P,) pressures of the columns, two or more
    values  : flat array that the kernel reads, log10_p first
    """

    log10_p: FloatArray
    values: FloatArray
    material_offset: dict[int, int]
    surface_offset: dict[tuple[int, WallEnthalpy], int]


def _pieces(at_edges: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Integral from 0 K, value and slope at the foot of each bin of a property given at the bin edges."""
    integral = np.concatenate(([0.0], np.cumsum(0.5 * BIN_K * (at_edges[1:] + at_edges[:-1]))))
    slope = np.diff(at_edges) / BIN_K
    slope[-1] = 0.0
    return integral[:-1], at_edges[:-1], slope


def _material_table(material: Material, log10_p: FloatArray) -> FloatArray:
    """(BINS, 3 + 3 P): enthalpy, c, its slope; then theta, k, its slope for each pressure."""
    table = np.empty((BINS, 3 + 3 * len(log10_p)))
    table[:, 0], table[:, 1], table[:, 2] = _pieces(np.interp(EDGES_K, *pairs(material.specific_heat_J_kgK)))
    p_Pa, T_K, k = material.conductivity_grid()
    for j, x in enumerate(log10_p):
        at_p = np.array([np.interp(x, np.log10(p_Pa), row) for row in k])
        columns = slice(3 + 3 * j, 6 + 3 * j)
        table[:, columns] = np.column_stack(_pieces(np.interp(EDGES_K, T_K, at_p)))
    return table


def _enthalpy_at_edges(wall_enthalpy: WallEnthalpy, log10_p: FloatArray) -> FloatArray:
    """(BINS + 1, P) enthalpy of air at the wall temperature [J/kg], zero at 0 K."""
    if isinstance(wall_enthalpy, str):
        above_zero = wall_enthalpy_grid(wall_enthalpy, EDGES_K[1:], 10.0**log10_p)
        return np.vstack([np.zeros(len(log10_p)), above_zero])
    return np.repeat((wall_enthalpy * EDGES_K)[:, np.newaxis], len(log10_p), axis=1)


def _surface_table(material: Material, wall_enthalpy: WallEnthalpy, log10_p: FloatArray) -> FloatArray:
    """(BINS, 2 + 3 P): emittance and its slope; then H_w, cp and 0 for each pressure."""
    table = np.zeros((BINS, 2 + 3 * len(log10_p)))
    emissivity = material.emissivity or [[0.0, 1.0]]
    _, table[:, 0], table[:, 1] = _pieces(np.interp(EDGES_K, *pairs(emissivity)))
    enthalpy = _enthalpy_at_edges(wall_enthalpy, log10_p)
    for j in range(len(log10_p)):
        table[:, 2 + 3 * j] = enthalpy[:-1, j]
        table[:, 3 + 3 * j] = np.diff(enthalpy[:, j]) / BIN_K
    return table


def _pressure_columns(materials: Sequence[Material], enthalpies: Sequence[WallEnthalpy]) -> FloatArray:
    """All pressures at which any property has a point; every property is linear in log10(p) between them."""
    grids = [m.conductivity_grid()[0] for m in materials]
    points = [np.log10(p) for p in grids if len(p) > 1]
    if any(isinstance(e, str) for e in enthalpies):
        points.append(np.log10(ENTHALPY_PRESSURES_PA))
    if not points:
        return np.array([0.0, 1.0])
    return np.unique(np.round(np.concatenate(points), 12))


def tabulate(materials: Sequence[Material], surfaces: Sequence[tuple[Material, WallEnthalpy]]) -> PropertyTables:
    """Tables of all materials and surfaces; offsets are found by the identity of a material."""
    log10_p = _pressure_columns(materials, [e for _, e in surfaces])
    parts: list[FloatArray] = [log10_p]
    place = _placer(parts)
    material_offset = {id(m): place(_material_table(m, log10_p)) for m in _distinct(materials)}
    surface_offset: dict[tuple[int, WallEnthalpy], int] = {}
    for material, enthalpy in surfaces:
        if (id(material), enthalpy) not in surface_offset:
            surface_offset[id(material), enthalpy] = place(_surface_table(material, enthalpy, log10_p))
    return PropertyTables(log10_p, np.concatenate(parts), material_offset, surface_offset)


def _distinct(materials: Sequence[Material]) -> list[Material]:
    return list({id(m): m for m in materials}.values())


def _placer(parts: list[FloatArray]) -> Callable[[FloatArray], int]:
    def place(table: FloatArray) -> int:
        offset = sum(len(p) for p in parts)
        parts.append(np.ascontiguousarray(table).ravel())
        return offset

    return place
