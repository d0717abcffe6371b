"""Property tables as the kernel reads them: pieces between declared points, columns of pressure, one flat array.

Between two points of its file a property is linear, and its integral (heat content, Kirchhoff's variable) is a
parabola, exact to rounding (docs/theory/equations_thermal_step.md, equation 9). A piece of a material lies between two
neighbouring points of either property, wherever these are. Bins of BIN_K kelvin hold the number of the piece at their
foot, from which the kernel steps to the piece of a temperature.

Insulation has a second table, with finer pieces, in which each property is followed by the same property weighted with
its temperature: the parameters `stack.rsi.*_slope` add the second to the first (equation 10b).
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from sim_heating.base.arrays import FloatArray
from sim_heating.heating.reference.gas import wall_enthalpy_grid
from sim_heating.thermal.assembly import BEND_LOG10_PA, BIN_K, BINS, FAR, NO_BENT_TABLE
from sim_heating.thermal.stack import Material, pairs

EDGES_K = BIN_K * np.arange(BINS + 1)
"""Edges of the bins [K]."""
BEND_FROM_K, BEND_AT_K, BEND_TO_K = 0.0, 700.0, 1700.0
"""Temperatures [K] between which the slope of a property acts, and where it leaves the property as declared."""
BEND_STEP_K = 100.0
"""Largest distance [K] between points of a table with a slope, within its range: f(T) k(T) is linear between them."""
STRAIGHT = 1e-11
"""Relative change of a property at a point [-] below which the point is on the line through its neighbours."""
KEPT = 256
"""Number of tables that are cached from one ensemble to the next."""
AIR_PER_DECADE = 8
"""Columns of the enthalpy of equilibrium air in a decade of pressure: linear in log10 p between them it is within
0.05 % of the equilibrium; one a decade is 2.8 % off where oxygen dissociates (docs/theory/equations_thermal_step.md,
section 2)."""
AIR_LOG10_PA = np.linspace(0.0, 6.0, 6 * AIR_PER_DECADE + 1)
"""log10 of the pressures [Pa] at which the enthalpy of equilibrium air is tabulated."""

WallEnthalpy = float | str
"""A constant specific heat [J/(kg K)], or the name of a gas model of reference_heating.gas."""


@dataclass(frozen=True)
class PointTables:
    """Offsets of one point's tables in the flat array.

    columns   : number of pressure columns, two or more
    pressures : offset of log10 of their pressures [Pa]
    materials : offset for each layer, the contact's last; at the one before, the distance to the table with a slope
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
    The enthalpy of air has an axis of its own.
    """

    def __init__(self) -> None:
        self._parts: list[FloatArray] = []
        self._end = 0
        self._offsets: dict[Hashable, int] = {}
        self._points: dict[Hashable, PointTables] = {}

    @property
    def values(self) -> FloatArray:
        """The flat array that the kernel reads ([K], [J/kg], [W/m] ...): all tables joined in the order in which they
        were placed."""
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

        Layout and interpolation: docs/theory/equations_thermal_step.md, section 2.
        """
        # Insulation has a table of its own, even where another layer is of its material: their properties may differ.
        key = (*(id(m) for m in layers), wall_enthalpy)
        if key not in self._points:
            self._points[key] = self._add(layers, contact, wall_enthalpy)
        return self._points[key]

    def _add(self, layers: Sequence[Material], contact: Material, wall_enthalpy: WallEnthalpy) -> PointTables:
        log10_p = _pressure_columns(layers)
        grid = log10_p.tobytes()
        outer, insulation = layers[0].emissivity or [[0.0, 1.0]], min(1, len(layers) - 1)
        return PointTables(
            len(log10_p),
            self.place(("pressures", grid), lambda: log10_p),
            tuple(self._place_material(m, grid, i == insulation) for i, m in enumerate((*layers, contact))),
            self.place(("emissivity", str(outer)), lambda: _point_table(outer)),
            self.place(("enthalpy", wall_enthalpy), lambda: _enthalpy_table(wall_enthalpy)),
        )

    def _place_material(self, material: Material, grid: bytes, bends: bool) -> int:
        """Offset of the table of a material, behind the distance to its table with slopes."""
        key = (id(material), grid, bends)
        return self.place(key, lambda: _known_table(material.model_dump_json(), grid, bends)) + 1


@lru_cache(KEPT)
def _known_table(material: str, grid: bytes, bends: bool) -> FloatArray:
    """Tables of a material (its JSON) at pressures (the bytes of their log10), behind the distance to the second one.

    bends : whether it has the second one, with slopes
    """
    declared, log10_p = Material.model_validate_json(material), np.frombuffer(grid)
    plain = _material_table(declared, log10_p)
    if not bends:
        return np.concatenate([[NO_BENT_TABLE], plain])
    return np.concatenate([[float(len(plain))], plain, _bent_table(declared, log10_p)])


def _point_table(table: list[list[float]]) -> FloatArray:
    """Number of points, their temperatures, their values."""
    T_K, values = pairs(table)
    return np.concatenate([[float(len(T_K))], T_K, values])


def _material_table(material: Material, log10_p: FloatArray) -> FloatArray:
    """Piece at the foot of each bin, then each piece: its ends and foot; h, c, slope of c; theta, k, slope of k.

    The last three are repeated for each pressure; all values are those at the foot of the piece.
    """
    points = _declared_points(material)
    properties = _properties_at(material, log10_p, points)
    bent = _bends(points, properties)
    return _piece_table(points[bent], properties[bent])


def _bent_table(material: Material, log10_p: FloatArray) -> FloatArray:
    """As `_material_table`, each piece followed by the same properties weighted with T - BEND_AT_K [K].

    Source: docs/theory/equations_thermal_step.md, equation 10b.
    """
    fine = np.arange(BEND_FROM_K, BEND_TO_K + BEND_STEP_K, BEND_STEP_K)
    points = np.union1d(_declared_points(material), fine)
    properties = _properties_at(material, log10_p, points)
    weight = np.clip(points, BEND_FROM_K, BEND_TO_K) - BEND_AT_K
    return _piece_table(points, np.column_stack([properties, weight[:, np.newaxis] * properties]))


def _declared_points(material: Material) -> FloatArray:
    """(point,) temperatures at which a property of a material has a point, and 0 K."""
    _, k_at_K, _ = material.conductivity_grid()
    return np.unique(np.concatenate([[0.0], pairs(material.specific_heat_J_kgK)[0], k_at_K]))


def _properties_at(material: Material, log10_p: FloatArray, points: FloatArray) -> FloatArray:
    """(point, property) specific heat [J/(kg K)], and conductivity [W/(m K)] at each pressure."""
    c_at_K, c = pairs(material.specific_heat_J_kgK)
    p_Pa, k_at_K, k = material.conductivity_grid()
    columns = [np.interp(points, c_at_K, c)]
    for x in log10_p:
        at_p = np.array([np.interp(x, np.log10(p_Pa), row) for row in k])
        columns.append(np.interp(points, k_at_K, at_p))
    return np.column_stack(columns)


def _piece_table(foot: FloatArray, properties: FloatArray) -> FloatArray:
    """Piece at the foot of each bin, then each piece: ends and foot [K]; integral, value, slope of each property."""
    table = [np.append(-FAR, foot[1:]), np.append(foot[1:], FAR), foot]
    for values in properties.T:
        table += _integrals(foot, values)
    piece = np.searchsorted(foot, EDGES_K[:-1], side="right") - 1.0
    return np.concatenate([piece, np.column_stack(table).ravel()])


def _bends(T_K: FloatArray, properties: FloatArray) -> NDArray[np.bool_]:
    """(point,) whether a point is needed: 0 K, and where a property (point, property) leaves its line."""
    slope = np.diff(properties, axis=0, append=properties[-1:]) / np.append(np.diff(T_K), 1.0)[:, np.newaxis]
    width = np.diff(T_K)
    # Without the point, the line between its neighbours misses it by the change of slope times this length.
    arm = width * np.append(width[1:] / (width[1:] + width[:-1]), 1.0)
    missed = np.abs(np.diff(slope, axis=0)) * arm[:, np.newaxis]
    return np.append(True, np.any(missed > STRAIGHT * np.abs(properties[1:]), axis=1))


def _integrals(T_K: FloatArray, values: FloatArray) -> list[FloatArray]:
    """Integral from 0 K, value and slope at each foot of a property, constant beyond the last (equation 9)."""
    width = np.diff(T_K)
    integral = np.concatenate(([0.0], np.cumsum(0.5 * width * (values[1:] + values[:-1]))))
    return [integral, values, np.append(np.diff(values) / width, 0.0)]


@lru_cache(KEPT)
def _enthalpy_table(wall_enthalpy: WallEnthalpy) -> FloatArray:
    """Axis of pressure (faces.AIR_HEAD), then (bin, pressure, 2): H_w at the foot of a bin and cp within it."""
    if isinstance(wall_enthalpy, str):
        log10_p, per_decade = AIR_LOG10_PA, float(AIR_PER_DECADE)
        above_zero = wall_enthalpy_grid(wall_enthalpy, EDGES_K[1:], 10.0**log10_p)
        enthalpy = np.vstack([np.zeros(len(log10_p)), above_zero])
    else:
        # The kernel interpolates between a pair of columns, and equal ones at one place give a constant.
        log10_p, per_decade = np.zeros(2), 0.0
        enthalpy = np.repeat((wall_enthalpy * EDGES_K)[:, np.newaxis], 2, axis=1)
    last = np.nextafter(len(log10_p) - 1.0, 0.0)
    head = np.array([log10_p[0], per_decade, last, len(log10_p)])
    return np.append(head, np.stack([enthalpy[:-1], np.diff(enthalpy, axis=0) / BIN_K], axis=2))


def _pressure_columns(materials: Sequence[Material]) -> FloatArray:
    """log10 of all pressures at which any conductivity has a point; each is linear between them."""
    grids = [m.conductivity_grid()[0] for m in materials]
    points = [np.log10(p) for p in grids if len(p) > 1]
    # Two columns always: the kernel interpolates between a pair, and equal columns give a constant. They are those
    # between which a change with pressure acts (equation 10b).
    if not points:
        return np.array([BEND_LOG10_PA[0], BEND_LOG10_PA[-1]])
    # Rounded, so that one pressure in two tables is one column.
    return np.unique(np.round(np.concatenate(points), 12))
