"""Heating-ratio table of a control point as a CSV file: long form, one row per node of a full rectangular grid.

    # source: ...            optional `# key: value` lines: source, confidence, revision, reference
    alpha_deg,beta_deg,log10_re,elevon_deg,bodyflap_deg,ratio[,sigma]
    10,-4,4.5,-10,-10,0.0033

Between nodes the ratio is multilinear, outside the grid the edge value is used (docs/equations.md, equation 7).
An axis may have one value.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import RATIO_VARIABLES
from sim_heating.base.errors import InputError
from sim_heating.base.files import (
    CsvTable,
    csv_text,
    display_path,
    raise_problems,
    read_csv_columns,
    suggestion,
    write_text_atomic,
)


@dataclass(frozen=True)
class RatioTable:
    """Heating ratio on a rectangular grid of the five variables.

    axes   : increasing node values of alpha_deg, beta_deg [deg], log10_re [-], elevon_deg, bodyflap_deg [deg]
    ratio  : (alpha, beta, log10_re, elevon, bodyflap) film coefficient over the reference film coefficient [-]
    sigma  : one standard deviation of the ratio [-], same shape, or None where the file gives none
    header : source, confidence, revision, reference and other entries of the file's header
    raises : InputError where shapes disagree, an axis does not increase, or a ratio is not finite
    """

    axes: tuple[FloatArray, ...]
    ratio: FloatArray
    sigma: FloatArray | None = None
    header: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        shape = tuple(len(a) for a in self.axes)
        if len(self.axes) != len(RATIO_VARIABLES) or self.ratio.shape != shape:
            raise InputError(f"ratio table: ratio has shape {self.ratio.shape}, its axes {shape}; they must agree")
        if self.sigma is not None and self.sigma.shape != shape:
            raise InputError(f"ratio table: sigma has shape {self.sigma.shape}, its axes {shape}; they must agree")
        for name, axis in zip(RATIO_VARIABLES, self.axes, strict=True):
            if len(axis) == 0 or not np.all(np.isfinite(axis)) or np.any(np.diff(axis) <= 0.0):
                raise InputError(f"ratio table: {name} must be finite and increase from node to node")
        if not np.all(np.isfinite(self.ratio)):
            raise InputError("ratio table: every ratio must be a finite number")

    @property
    def reference(self) -> str | None:
        """Name of the reference heating that the ratio is over; None where the file states none."""
        return self.header.get("reference") or None


def read_ratio_table(path: str | os.PathLike[str]) -> RatioTable:
    """Read and check a heating-ratio table; rows may be in any order.

    path    : CSV file; columns alpha_deg, beta_deg, log10_re, elevon_deg, bodyflap_deg, ratio [-], optionally sigma [-]
    returns : the table on its grid, header included
    raises  : InputError with row and column: not a number, an angle beyond 180, a log10_re beyond 20, a negative sigma,
              an unknown column, a repeated or missing node
    """
    table = read_csv_columns(path, (*RATIO_VARIABLES, "ratio"), ("sigma",))
    raise_problems(_column_problems(table))
    axes = tuple(np.unique(table[name]) for name in RATIO_VARIABLES)
    index = tuple(np.searchsorted(axis, table[name]) for axis, name in zip(axes, RATIO_VARIABLES, strict=True))
    # Repeated nodes first: with one of them the number of missing nodes would mislead.
    raise_problems(_repeated_nodes(table, index) or _missing_nodes(table, axes, index))
    return RatioTable(axes, _on_grid(table, "ratio", axes, index), _sigma(table, axes, index), table.header)


def write_ratio_table(
    path: str | os.PathLike[str], table: RatioTable, formats: Mapping[str, str] | None = None
) -> None:
    """Write a heating-ratio table in long form, atomically: the file is complete or unchanged.

    path    : CSV file to write;  table : angles [deg], log10_re and ratios [-]
    formats : column name -> format, such as `.4g`; see `ratio_table_text`
    """
    write_text_atomic(path, ratio_table_text(table, formats))


def ratio_table_text(table: RatioTable, formats: Mapping[str, str] | None = None) -> str:
    """Text of a heating-ratio table in long form, angles [deg], log10_re and ratios [-], last variable fastest.

    formats : column name -> format, such as `.4g`; without formats the text reads back equal
    """
    grid = np.meshgrid(*table.axes, indexing="ij")
    columns = {name: g.ravel() for name, g in zip(RATIO_VARIABLES, grid, strict=True)} | {"ratio": table.ratio.ravel()}
    if table.sigma is not None:
        columns["sigma"] = table.sigma.ravel()
    return csv_text(columns, formats, table.header)


def _column_problems(table: CsvTable) -> list[str]:
    """Messages about unknown columns, implausible angles or Reynolds numbers, and negative sigma."""
    known = (*RATIO_VARIABLES, "ratio", "sigma")
    problems = [
        f"{display_path(table.path)}: unknown column `{name}`{suggestion(name, known)}"
        for name in table.columns
        if name not in known
    ]
    for name in RATIO_VARIABLES:
        limit = 20.0 if name == "log10_re" else 180.0
        problems += table.problems_where_not(
            name, np.abs(table[name]) <= limit, f"must lie within -{limit:g} to {limit:g}"
        )
    if "sigma" in table.columns:
        problems += table.problems_where_not("sigma", table["sigma"] >= 0.0, "is not a standard deviation (0 or above)")
    return problems


def _repeated_nodes(table: CsvTable, index: tuple[NDArray[np.intp], ...]) -> list[str]:
    first_row: dict[tuple[int, ...], int] = {}
    for row, node in enumerate(zip(*(i.tolist() for i in index), strict=True)):
        if node in first_row:
            earlier = table.lines[first_row[node]]
            rule = f"repeats the node of row {earlier}; remove one ({_at(table, row)})"
            return [f"{display_path(table.path)}, row {table.lines[row]}: {rule}"]
        first_row[node] = row
    return []


def _at(table: CsvTable, row: int) -> str:
    return ", ".join(f"{name} {table[name][row]:g}" for name in RATIO_VARIABLES)


def _missing_nodes(table: CsvTable, axes: tuple[FloatArray, ...], index: tuple[NDArray[np.intp], ...]) -> list[str]:
    """Why the nodes do not fill the grid: an axis value that few nodes have, else the first missing node."""
    shape = tuple(len(a) for a in axes)
    whole = math.prod(shape)
    if len(table) == whole:
        return []
    # A mistyped axis value makes a whole plane of nodes look missing; the value is the better message.
    rare_value = _rare_value(table, shape, index)
    if rare_value:
        return [rare_value]
    have = set(zip(*(i.tolist() for i in index), strict=True))
    node = next(n for n in np.ndindex(*shape) if n not in have)
    at = ", ".join(f"{name} {axis[i]:g}" for name, axis, i in zip(RATIO_VARIABLES, axes, node, strict=True))
    return [
        f"{display_path(table.path)}: {whole - len(table)} of {whole} nodes of the grid missing; add a row for {at}"
    ]


def _rare_value(table: CsvTable, shape: tuple[int, ...], index: tuple[NDArray[np.intp], ...]) -> str | None:
    """Message about an axis value with fewer than half as many nodes as the others, as a mistyped one has."""
    for name, size, i in zip(RATIO_VARIABLES, shape, index, strict=True):
        counts = np.bincount(i, minlength=size)
        rarest = int(np.argmin(counts))
        if 2 * counts[rarest] < np.median(counts):
            row = int(np.flatnonzero(i == rarest)[0])
            rule = f"occurs at {counts[rarest]} nodes, other values at {np.median(counts):g}; "
            return table.problem(row, name, rule + "correct it or complete the grid")
    return None


def _on_grid(
    table: CsvTable, name: str, axes: tuple[FloatArray, ...], index: tuple[NDArray[np.intp], ...]
) -> FloatArray:
    values = np.empty(tuple(len(a) for a in axes))
    values[index] = table[name]
    return values


def _sigma(table: CsvTable, axes: tuple[FloatArray, ...], index: tuple[NDArray[np.intp], ...]) -> FloatArray | None:
    return _on_grid(table, "sigma", axes, index) if "sigma" in table.columns else None
