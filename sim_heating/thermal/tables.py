"""Property tables as the kernel reads them: bins of BIN_K kelvin, columns of pressure, one flat float64 array.

A property that is linear between the points of its file is sampled at the bin edges and is linear between those, with
its integral (heat content, Kirchhoff's variable) exact for the sampled property (docs/equations_thermal_step.md,
equation 9). Where the points of the file are on bin edges this is exact; otherwise a corner is cut within the 5 K bin
that contains it. Neighbouring bins without a change of slope in any property of a material form one piece with one
polynomial.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from sim_heating.base.arrays import FloatArray
from sim_heating.heating.reference.gas import wall_enthalpy_grid
from sim_heating.thermal.assembly import BIN_K, BINS, FAR
from sim_heating.thermal.stack import Material, pairs

EDGES_K = BIN_K * np.arange(BINS + 1)
"""Edges of the bins [K]."""
STRAIGHT = 1e-11
"""Relative change of a property [-] by a change of slope over one bin, below which the two bins form one piece."""
KEPT = 256
"""Number of tables that are cached from one ensemble to the next."""
ENTHALPY_PRESSURES_PA = np.logspace(0.0, 6.0, 7)
"""Pressures at which the enthalpy of equilibrium air is tabulated [Pa]."""

WallEnthalpy = float | str
"""A constant specific heat [J/(kg K)], or the name of a gas model of reference_heating.gas."""


@dataclass(frozen=True)
class PointTables:
    """Offsets of one point's tables in the flat array.

    columns   : number of pressure columns, two or more
    pressures : offset of log10 of their pressures [Pa]
    materials : offset for each layer, the contact's last
    emissivity, enthalpy : offsets of those of the surface
    """

    columns: int
    pressures: int
    materials: tuple[int, ...]
    emissivity: int
    enthalpy: int


class TableStore:
    """Tables of many points in one flat array, each table made once.

    A point's tables have columns at the pressures of its own materials, so that they do not depend on its neighbours.
    """

    def __init__(self) -> None:
        self._parts: list[FloatArray] = []
        self._end = 0
        self._offsets: dict[Hashable, int] = {}
        self._points: dict[Hashable, PointTables] = {}

    @property
    def values(self) -> FloatArray:
        """The flat array that the kernel reads: all tables joined in the order in which they were placed."""
        return np.concatenate(self._parts)

    def place(self, key: Hashable, make: Callable[[], FloatArray]) -> int:
        """Offset of the table of a key in the flat array; the table is made where the key is new.

        key  : hashable identity of the table
        make : called once, for the table [any shape, stored flat]
        """
        if key not in self._offsets:
            table = np.ascontiguousarray(make()).ravel()
            self._offsets[key] = self._end
            self._parts.append(table)
            self._end += len(table)
        return self._offsets[key]

    def add_point(self, layers: Sequence[Material], contact: Material, wall_enthalpy: WallEnthalpy) -> PointTables:
        """Offsets of the tables of a point, made where they are new.

        layers        : material of each layer, outermost first; known by identity, so one object is one table
        contact       : material of contact resistances, whose offset comes last
        wall_enthalpy : constant specific heat [J/(kg K)], or the name of a gas model
        returns       : offsets in `values`

        Layout and interpolation: docs/equations_thermal_step.md, section 2.
        """
        key = (*(id(m) for m in layers), wall_enthalpy)
        if key not in self._points:
            self._points[key] = self._add(layers, contact, wall_enthalpy)
        return self._points[key]

    def _add(self, layers: Sequence[Material], contact: Material, wall_enthalpy: WallEnthalpy) -> PointTables:
        log10_p = _pressure_columns(layers, wall_enthalpy)
        grid = log10_p.tobytes()
        outer = layers[0].emissivity or [[0.0, 1.0]]
        return PointTables(
            len(log10_p),
            self.place(("pressures", grid), lambda: log10_p),
            tuple(
                self.place((id(m), grid), lambda m=m: _known_table(m.model_dump_json(), grid))  # type: ignore[misc]
                for m in (*layers, contact)
            ),
            self.place(("emissivity", str(outer)), lambda: _point_table(outer)),
            self.place(("enthalpy", wall_enthalpy, grid), lambda: _known_enthalpy(wall_enthalpy, grid)),
        )


@lru_cache(KEPT)
def _known_table(material: str, grid: bytes) -> FloatArray:
    """The table of a material (its JSON) at pressures (the bytes of their log10)."""
    return _material_table(Material.model_validate_json(material), np.frombuffer(grid))


@lru_cache(KEPT)
def _known_enthalpy(wall_enthalpy: WallEnthalpy, grid: bytes) -> FloatArray:
    return _enthalpy_table(wall_enthalpy, np.frombuffer(grid))


def _point_table(table: list[list[float]]) -> FloatArray:
    """Number of points, their temperatures, their values."""
    T_K, values = pairs(table)
    return np.concatenate([[float(len(T_K))], T_K, values])


def _pieces(at_edges: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Integral from 0 K, value and slope at the foot of each bin of a property given at the bin edges (equation 9)."""
    integral = np.concatenate(([0.0], np.cumsum(0.5 * BIN_K * (at_edges[1:] + at_edges[:-1]))))
    slope = np.diff(at_edges) / BIN_K
    # The last bin has no upper edge: the property is constant in it.
    slope[-1] = 0.0
    return integral[:-1], at_edges[:-1], slope


def _material_table(material: Material, log10_p: FloatArray) -> FloatArray:
    """Index of the piece of each bin, then each piece: its ends and foot; h, c, slope of c; theta, k, slope of k.

    The last three are repeated for each pressure; all values are those at the foot of the piece.
    """
    table = np.empty((BINS, 3 + 3 * len(log10_p)))
    table[:, 0], table[:, 1], table[:, 2] = _pieces(np.interp(EDGES_K, *pairs(material.specific_heat_J_kgK)))
    p_Pa, T_K, k = material.conductivity_grid()
    for j, x in enumerate(log10_p):
        at_p = np.array([np.interp(x, np.log10(p_Pa), row) for row in k])
        columns = slice(3 + 3 * j, 6 + 3 * j)
        table[:, columns] = np.column_stack(_pieces(np.interp(EDGES_K, T_K, at_p)))
    first = _first_of_pieces(table[:, 1::3], table[:, 2::3])
    piece = np.cumsum(np.isin(np.arange(BINS), first)) - 1.0
    low = np.where(first == 0, -FAR, BIN_K * first)
    high = np.append(BIN_K * first[1:], FAR)
    return np.concatenate([piece, np.column_stack([low, high, BIN_K * first, table[first]]).ravel()])


def _first_of_pieces(values: FloatArray, slopes: FloatArray) -> NDArray[np.int64]:
    """First bins of the pieces: those whose slope differs from that of the bin before."""
    bent = np.abs(np.diff(slopes, axis=0)) * BIN_K > STRAIGHT * np.abs(values[1:])
    return np.concatenate(([0], np.flatnonzero(np.any(bent, axis=1)) + 1))


def _enthalpy_at_edges(wall_enthalpy: WallEnthalpy, log10_p: FloatArray) -> FloatArray:
    """(BINS + 1, P) enthalpy of air at the wall temperature [J/kg], zero at 0 K."""
    if not isinstance(wall_enthalpy, str):
        return np.repeat((wall_enthalpy * EDGES_K)[:, np.newaxis], len(log10_p), axis=1)
    above_zero = wall_enthalpy_grid(wall_enthalpy, EDGES_K[1:], ENTHALPY_PRESSURES_PA)
    given = np.log10(ENTHALPY_PRESSURES_PA)
    at_p = np.array([np.interp(log10_p, given, row) for row in above_zero])
    return np.vstack([np.zeros(len(log10_p)), at_p])


def _enthalpy_table(wall_enthalpy: WallEnthalpy, log10_p: FloatArray) -> FloatArray:
    """(BINS, P, 2): H_w at the foot of a bin and cp within it, for each pressure."""
    enthalpy = _enthalpy_at_edges(wall_enthalpy, log10_p)
    return np.stack([enthalpy[:-1], np.diff(enthalpy, axis=0) / BIN_K], axis=2)


def _pressure_columns(materials: Sequence[Material], wall_enthalpy: WallEnthalpy) -> FloatArray:
    """log10 of all pressures at which any property has a point; every property is linear between them."""
    grids = [m.conductivity_grid()[0] for m in materials]
    points = [np.log10(p) for p in grids if len(p) > 1]
    if isinstance(wall_enthalpy, str):
        points.append(np.log10(ENTHALPY_PRESSURES_PA))
    # Two columns always: the kernel interpolates between a pair, and equal columns give a constant.
    if not points:
        return np.array([0.0, 1.0])
    # Rounded, so that one pressure in two tables is one column.
    return np.unique(np.round(np.concatenate(points), 12))
