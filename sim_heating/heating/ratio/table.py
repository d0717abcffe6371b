"""Heating-ratio table of a control point as a CSV file: long form, one row per node of a full rectangular grid.

    # source: ...            optional `# key: value` lines: source, confidence, revision, reference, recovery
    alpha_deg,beta_deg,log10_re,elevon_deg,bodyflap_deg,ratio[,sigma]
    10,-4,4.5,-10,-10,0.0033

Between nodes the ratio is multilinear, outside the grid the edge value is used (docs/theory/equations.md, equation 7).
An axis may have one value.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sim_heating.base import files
from sim_heating.base.arrays import BoolArray, FloatArray
from sim_heating.base.conditions import RATIO_VARIABLES, SURFACES
from sim_heating.base.errors import InputError, tell
from sim_heating.base.files import CsvTable, display_path, raise_problems, suggestion
from sim_heating.base.limits import QUANTITIES, Quantity, usual_remark
from sim_heating.heating.reference.models import recovery_name
from sim_heating.heating.reference.recovery import RECOVERIES

LARGEST_SIGMA, SMALLEST_SIGMA = 10.0, 1e-5
"""Largest sigma over the largest ratio of a table, and smallest median of sigma over ratio."""
NEGATIVE_SIGMAS = 3.0
"""A node that is negative by more than this many of its sigma is no estimate of a film coefficient, which is not."""
LEAST_RATIO, MOST_RATIO = 1e-5, 1e3
"""Largest ratio of a table, at least: sheltered places have 1e-3 of the stagnation point's. Largest constant ratio of a
record: shocks that meet give 20, and a reference of a few metres is a tenth of one of centimetres."""
TABLES_KEPT = 256
"""Tables that stay in memory once read: planning and joint fits read those of a vehicle again and again."""
SPIKE = 100.0
"""Factor between a ratio and those at all nodes next to it that no flow has: shocks that meet give 20."""


@dataclass(frozen=True)
class RatioTable:
    """Heating ratio on a rectangular grid of the five variables.

    axes   : increasing node values of alpha_deg, beta_deg [deg], log10_re [-], elevon_deg, bodyflap_deg [deg]
    ratio  : (alpha, beta, log10_re, elevon, bodyflap) film coefficient over the reference film coefficient [-]
    sigma  : one standard deviation of the ratio [-], same shape, or None where the file gives none
    header : source, confidence, revision, reference, recovery and other entries of the file's header
    raises : InputError where shapes disagree, an axis does not increase, or a ratio is not finite
    """

    axes: tuple[FloatArray, ...]
    ratio: FloatArray
    sigma: FloatArray | None = None
    header: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        shape = tuple(map(len, self.axes))
        if len(self.axes) != len(RATIO_VARIABLES) or self.ratio.shape != shape:
            raise InputError(f"ratio table: ratio has shape {self.ratio.shape}, its axes {shape}; they must agree")
        if self.sigma is not None and self.sigma.shape != shape:
            raise InputError(f"ratio table: sigma has shape {self.sigma.shape}, its axes {shape}; they must agree")
        for name, axis in zip(RATIO_VARIABLES, self.axes, strict=True):
            if not (len(axis) and np.all(np.isfinite(axis)) and np.all(np.diff(axis) > 0.0)):
                raise InputError(f"ratio table: {name} must be finite and increase from node to node")
        if not np.all(np.isfinite(self.ratio)):
            raise InputError("ratio table: every ratio must be a finite number")

    @property
    def reference(self) -> str | None:
        """Name of the reference heating that the ratio [-] is over; None where the file states none."""
        return self.header.get("reference") or None

    @property
    def recovery(self) -> str | None:
        """Name of the recovery enthalpy [J/kg] that the ratio is reduced with, a key of RECOVERIES; None where the file
        states none (`models.recovery_name` then says which)."""
        return self.header.get("recovery") or None

    def recovery_problem(self, expected: str, reference: str) -> str | None:
        """Why the ratio [-] does not belong to a recovery enthalpy [J/kg], as the end of a message; None where it does.

        expected  : the recovery enthalpy that it is used with, a key of RECOVERIES
        reference : the reference heating that it is used with, for a table that states no recovery enthalpy
        """
        recovery = recovery_name(self.recovery, reference)
        if recovery == expected:
            return None
        stated = f"is `{recovery}`" if self.recovery else f"is not stated, which means `{recovery}`"
        return f"header `recovery`: {stated}; it must agree with `{expected}`"


def read_ratio_table(path: str | os.PathLike[str]) -> RatioTable:
    """Read and check a heating-ratio table; rows may be in any order.

    path    : CSV file; columns alpha_deg, beta_deg, log10_re, elevon_deg, bodyflap_deg, ratio [-], optionally sigma
              [-]; without a deflection the table has one node in it, at 0 deg
    returns : the table on its grid, header included
    raises  : InputError with row and column: not a number, a value outside the limits of its column, a negative sigma,
              a ratio below 0 by more than its uncertainty, an unknown column, a repeated or missing node; nodes, ratios
              or sigma in another unit
    """
    return table_of_text(Path(path), files.read_text(path))


def table_of_text(path: Path, text: str) -> RatioTable:
    """The table, ratios [-] over angles [deg] and log10 Re [-], in the text of a CSV file, made from a file of
    another format; checks and errors as `read_ratio_table`.

    path : of that file, for messages
    """
    table = _table_of(path, text)
    tell(_remarks(table, display_path(path)))
    return table


LEAST_LAST_LOG_RE, RATIOS = 4.0, (1e-3, 5.0)
"""Last node of log10 Re of a flight's tables, and the largest ratio of one, of leeward points to small radii."""


def log_re_remark(nodes: Sequence[float]) -> str | None:
    """What is unusual about several nodes of log10 Re [-] that end below those of any entry; None where they do not."""
    if len(nodes) < 2 or nodes[-1] >= LEAST_LAST_LOG_RE:
        return None
    return f"ends at {nodes[-1]:g}, and entries reach 6 and more; is it the base-10 logarithm?"


def _remarks(table: RatioTable, where: str) -> list[str]:
    """What is possible and unusual about the nodes and ratios of a table."""
    remarks = []
    for name, axis in zip(RATIO_VARIABLES, table.axes, strict=True):
        remark = next((text for value in axis[[0, -1]] if (text := usual_remark(name, float(value)))), None)
        if remark is None and name == "log10_re":
            remark = log_re_remark(axis.tolist())
        remarks += [] if remark is None else [f"{where}, column {name}: {remark}"]
    largest = float(np.max(table.ratio))
    if largest > 0.0 and not RATIOS[0] <= largest <= RATIOS[1]:
        remarks.append(f"{where}, column ratio: the largest is {largest:g} ({RATIOS[0]:g} to {RATIOS[1]:g} is usual)")
    if negative := int(np.count_nonzero(table.ratio < 0.0)):
        least = int(np.argmin(table.ratio))
        remarks.append(
            f"{where}, column ratio: {negative} of {table.ratio.size} nodes are negative, down to "
            f"{table.ratio.flat[least]:g} ({node_in_words(table, least)}); no film coefficient is"
        )
    return remarks


def node_in_words(table: RatioTable, node: int) -> str:
    """A node of a table by its angles [deg] and log10 Re [-], `alpha_deg 35, log10_re 6`; its place in the raveled grid
    is given."""
    at = np.unravel_index(node, table.ratio.shape)
    axes = zip(RATIO_VARIABLES, table.axes, at, strict=True)
    return ", ".join(f"{name} {axis[i]:g}" for name, axis, i in axes if len(axis) > 1)


def is_below_zero(ratio: FloatArray, sigma: FloatArray) -> BoolArray:
    """Whether ratios [-] are negative by more than their uncertainty, which a film coefficient is not; same shapes."""
    return ratio < -NEGATIVE_SIGMAS * np.abs(sigma)


@lru_cache(maxsize=TABLES_KEPT)
def _table_of(path: Path, text: str) -> RatioTable:
    """The table that a file with this text holds; its arrays are shared by all who read it, and cannot be written."""
    required = tuple(name for name in RATIO_VARIABLES if name not in SURFACES)
    table = files.read_csv_columns(path, (*required, "ratio"), (*SURFACES, "sigma"), content=text)
    table = table.with_columns({name: np.zeros(len(table)) for name in SURFACES if name not in table.columns})
    raise_problems([*_header_problems(table), *_column_problems(table)])
    axes = tuple(np.unique(table[name]) for name in RATIO_VARIABLES)
    index = tuple(np.searchsorted(axis, table[name]) for axis, name in zip(axes, RATIO_VARIABLES, strict=True))
    # Repeated nodes first: with one of them the number of missing nodes would mislead.
    raise_problems(_repeated_nodes(table, index) or _missing_nodes(table, axes, index))
    ratio = _on_grid(table, "ratio", axes, index)
    raise_problems(_spikes(table, ratio, index))
    sigma = _sigma(table, axes, index)
    for array in (*axes, ratio, *(() if sigma is None else (sigma,))):
        array.setflags(write=False)
    return RatioTable(axes, ratio, sigma, table.header)


def depends_on(variable: str, *tables: RatioTable | None) -> bool:
    """Whether any of some tables has several nodes in a ratio variable [deg], or log10_re [-]."""
    axis = RATIO_VARIABLES.index(variable)
    return any(table is not None and len(table.axes[axis]) > 1 for table in tables)


def write_ratio_table(
    path: str | os.PathLike[str], table: RatioTable, formats: Mapping[str, str] | None = None
) -> None:
    """Write a heating-ratio table in long form, atomically: the file is complete or unchanged.

    path    : CSV file to write;  table : angles [deg], log10_re and ratios [-]
    formats : column name -> format, such as `.4g`; see `ratio_table_text`
    """
    files.write_text_atomic(path, ratio_table_text(table, formats))


def ratio_table_text(table: RatioTable, formats: Mapping[str, str] | None = None) -> str:
    """Text of a heating-ratio table in long form, angles [deg], log10_re and ratios [-], last variable fastest.

    formats : column name -> format, such as `.4g`; without formats the text reads back equal
    """
    grid = np.meshgrid(*table.axes, indexing="ij")
    columns = {name: g.ravel() for name, g in zip(RATIO_VARIABLES, grid, strict=True)} | {"ratio": table.ratio.ravel()}
    if table.sigma is not None:
        columns["sigma"] = table.sigma.ravel()
    return files.csv_text(columns, formats, table.header)


def _header_problems(table: CsvTable) -> list[str]:
    """Message about a recovery enthalpy that there is not."""
    stated = table.header.get("recovery")
    if not stated or stated in RECOVERIES:
        return []
    text = f"unknown recovery enthalpy `{stated}`{suggestion(stated, RECOVERIES)}"
    return [f"{display_path(table.path)}, header `recovery`: {text}"]


def _column_problems(table: CsvTable) -> list[str]:
    """Messages about unknown columns, implausible angles or Reynolds numbers, and negative sigma."""
    names = (*RATIO_VARIABLES, "ratio", "sigma")
    problems = [
        f"{display_path(table.path)}: unknown column `{name}`{suggestion(name, names)}"
        for name in table.columns
        if name not in names
    ]
    for name in RATIO_VARIABLES:
        problems += range_problems(table, name, QUANTITIES[name])
    highest = QUANTITIES["heating_ratio"].highest
    rule = f"is not a ratio of film coefficients (to {highest:g})"
    problems += table.problems_where_not("ratio", table["ratio"] <= highest, rule)
    least, largest = float(table["ratio"].min()), float(table["ratio"].max())
    sigma = table.columns.get("sigma", np.zeros(len(table)))
    if least < 0.0 < largest:
        rule = "is not a ratio of film coefficients, which are not negative; check the sign (or sigma, near 0)"
        problems += table.problems_where_not("ratio", ~is_below_zero(table["ratio"], sigma), rule)
    if least < 0.0 and largest <= 0.0:
        text = f"no ratio is above 0, and the least is {least:g}; film coefficients are not negative, check the sign"
        problems.append(f"{display_path(table.path)}, column ratio: {text}")
    if 0.0 < largest < LEAST_RATIO:
        text = f"the largest ratio is {largest:g}, below that of any place on a vehicle; check its unit"
        problems.append(f"{display_path(table.path)}, column ratio: {text}")
    if "sigma" in table.columns:
        problems += table.problems_where_not("sigma", table["sigma"] >= 0.0, "is not a standard deviation (0 or above)")
    return problems or _sigma_problems(table)


def range_problems(table: CsvTable, name: str, measured: Quantity) -> list[str]:
    """Problems of a column of nodes, [deg] or [-]: a value outside the range of its quantity, or nodes too close
    together."""
    x = table[name]
    inside = (x >= measured.lowest) & (x <= measured.highest)
    if not np.all(inside):
        return table.problems_where_not(name, inside, measured.rule)
    text = measured.axis_problem(float(x.min()), float(x.max()))
    return [] if text is None else [f"{display_path(table.path)}, column {name}: {text}"]


def _sigma_problems(table: CsvTable) -> list[str]:
    """Problems of a sigma that is no uncertainty of the ratios next to it."""
    if "sigma" not in table.columns:
        return []
    largest = float(np.max(np.abs(table["ratio"])))
    rule = f"is more than {LARGEST_SIGMA:g} times the largest ratio, {largest:g}; give sigma in the unit of the ratio"
    problems = table.problems_where_not("sigma", (table["sigma"] <= LARGEST_SIGMA * largest) | (largest == 0.0), rule)
    used = (table["sigma"] > 0.0) & (table["ratio"] > 0.0)
    if problems or not np.any(used):
        return problems
    median = float(np.median(table["sigma"][used] / table["ratio"][used]))
    if median >= SMALLEST_SIGMA:
        return []
    text = f"is {median:.2g} of the ratio, and no heating is known so well; give sigma in the unit of the ratio"
    return [f"{display_path(table.path)}, column sigma: {text}"]


def _spikes(table: CsvTable, values: FloatArray, index: tuple[NDArray[np.intp], ...]) -> list[str]:
    """A problem where a ratio is far above, or far below, the ratios at all of the nodes next to it.

    values : ratio on the grid;  index : node of each row
    """
    positive = values > 0.0
    log = np.log(np.where(positive, values, 1.0))
    count = np.zeros(values.shape, dtype=np.int64)
    low, high = np.full(values.shape, np.inf), np.full(values.shape, np.inf)
    for axis, size in enumerate(values.shape):
        before = [slice(None)] * values.ndim
        after = [slice(None)] * values.ndim
        before[axis], after[axis] = slice(0, size - 1), slice(1, size)
        step = np.diff(log, axis=axis)
        for here, rise in ((tuple(before), -step), (tuple(after), step)):
            count[here] += 1
            high[here] = np.minimum(high[here], rise)
            low[here] = np.minimum(low[here], -rise)
    far = positive & (count >= 2) & (np.maximum(low, high) > np.log(SPIKE))
    rows = np.flatnonzero(far[index])
    if not np.all(positive) or rows.size == 0:
        return []
    rule = f"is more than {SPIKE:g} times off the ratios at all nodes next to it; correct the row"
    return [table.problem(int(rows[0]), "ratio", rule)]


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
    size = math.prod(shape)
    if len(table) == size:
        return []
    # A mistyped axis value makes a whole plane of nodes look missing; the value is the better message.
    rare_value = _rare_value(table, shape, index)
    if rare_value:
        return [rare_value]
    have = set(zip(*(i.tolist() for i in index), strict=True))
    node = next(n for n in np.ndindex(*shape) if n not in have)
    at = ", ".join(f"{name} {axis[i]:g}" for name, axis, i in zip(RATIO_VARIABLES, axes, node, strict=True))
    return [f"{display_path(table.path)}: {size - len(table)} of {size} nodes of the grid missing; add a row for {at}"]


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
