"""Files of flight conditions as tools write them: CSV, JSON lines, lists in columns, with their names and units.

Read are commas, semicolons, tabs and blanks between cells, names in the last comment line (OpenRocket), comments
between the rows, units in a row below the names, and one JSON object a line or a list of them. A column that holds
texts is no condition; an empty cell or `NaN` is no number.
"""

from __future__ import annotations

import csv
import json
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim_heating.base.arrays import FloatArray
from sim_heating.base.errors import InputError, error_context
from sim_heating.base.files import CsvTable, display_path, read_text
from sim_heating.base.files.csv_table import header_entry
from sim_heating.base.files.text import and_more_rows, repeated_name
from sim_heating.base.files.units import NO_DIMENSION, known_unit
from sim_heating.heating.recorded.fields import ConditionField, FlightField, columns_of_fields, field_of_name

SAME = 2e-3
"""Relative difference of two fields of one column that are the same but for rounding."""
DERIVABLE = {"T_inf_K", "p_inf_Pa", "rho_kg_m3", "mach", "log10_re", "p_surface_Pa"}
"""Columns that may follow from others."""
RULE = re.compile(r"^[\s|+\-=]{3,}$")
"""A line of dashes, which separates the names of a list from its rows."""


@dataclass(frozen=True)
class FlightFields:
    """The fields of a file that are flight conditions.

    path                : of the file
    columns             : column -> (row,) in its unit; NaN where a cell holds no number
    fields              : column -> the field that it comes from
    fields_without_unit : column -> field whose unit is not known
    unused              : fields that are no condition
    empty               : fields of conditions without any number
    header              : `# key: value` lines above the names
    lines               : (row,) line of the file
    numbers             : field -> (row,) as in the file; NaN where a cell holds no number
    """

    path: Path
    columns: Mapping[str, FloatArray]
    fields: Mapping[str, FlightField]
    fields_without_unit: Mapping[str, FlightField]
    unused: tuple[str, ...]
    empty: tuple[str, ...]
    header: dict[str, str]
    lines: NDArray[np.int64]
    numbers: Mapping[str, FloatArray] = field(default_factory=dict)

    @property
    def without_unit(self) -> list[str]:
        """Fields of conditions whose unit, such as [m/s], is not known."""
        return [f.name for f in self.fields_without_unit.values()]

    @property
    def notes(self) -> list[str]:
        """One line on the fields that have other names or units than the columns that they are."""
        renamed = [
            f"{column} from `{f.name}`{'' if column_has(f) else f', in {f.unit}'}"
            for column, f in self.fields.items()
            if not f.is_plain
        ]
        return [f"read {', '.join(renamed)}"] if renamed else []

    def replaced(
        self,
        columns: Mapping[str, FloatArray],
        fields: Mapping[str, FlightField],
        fields_without_unit: Mapping[str, FlightField],
    ) -> FlightFields:
        """The fields of the file, in the units of the contract ([m], [m/s], [deg] ...), with other columns, and other
        fields that are asked for."""
        return replace(self, columns=columns, fields=fields, fields_without_unit=fields_without_unit)

    def table(self, columns: Mapping[str, FloatArray]) -> CsvTable:
        """Columns, in the units of the contract ([m], [m/s], [deg] ...), as a table whose rows are those of the
        file."""
        return CsvTable(dict(columns), self.header, self.path, self.lines)


def states_columns(path: Path, required: Sequence[str], one_of: Sequence[Sequence[str]] = ()) -> bool:
    """Whether a file is CSV with the columns of the contract, by their names, so that nothing is to be derived.

    required : columns, all of which have to be there
    one_of   : groups of columns, one of each has to be there
    """
    names = _first_names(path)
    return set(required) <= names and all(names & set(group) for group in one_of)


def lacks_only_derived(path: Path, required: Sequence[str]) -> bool:
    """Whether what a file lacks may follow from what it has, or fields of it have other names than the columns."""
    names = _first_names(path)
    renamed = any((f := field_of_name(name)) is not None and not f.is_plain for name in names)
    return renamed or not names or set(required) - names <= DERIVABLE


def _first_names(path: Path) -> set[str]:
    """Names in the first line that is no comment; of a file that cannot be read none."""
    if not path.is_file():  # a pipe would be waited for
        return set()
    try:
        with path.open(encoding="utf-8-sig") as file:
            first = next((line for line in file if line.strip() and not line.startswith("#")), "")
    except (OSError, UnicodeDecodeError):
        return set()
    names = {name.strip().strip('"') for name in first.split(",")}
    return names if not any(re.fullmatch(r"[-+\d.eE]+", name) for name in names) else set()


def column_has(f: FlightField) -> bool:
    """Whether the name of a field states its unit, such as [ft], so that a note need not."""
    return not f.unit or f.unit in f.name


def read_fields(path: Path, stated: Mapping[str, ConditionField | str] | None = None) -> FlightFields:
    """The flight conditions of a file ([m], [m/s], [deg], [kg/m3] ...), by the names and units of its fields.

    stated : column -> field, field with unit, or constant, that prevails over the names
    raises : InputError, one line a problem: no rows of numbers, two fields of one column that differ, a stated field
             that is not there
    """
    names, units, cells, lines, header = _rows(path, read_text(path))
    declared = stated or {}
    with error_context(display_path(path)):
        by_column = columns_of_fields(names, units, declared)
    numbers = {name: _numbers(cells[name]) for name in names}
    blank = {name for name, values in numbers.items() if np.all(np.isnan(values))}
    filled = {column: [f for f in fields if f.name not in blank] for column, fields in by_column.items()}
    columns: dict[str, FloatArray] = {}
    used: dict[str, FlightField] = {}
    fields_without_unit: dict[str, FlightField] = {}
    for column, fields in filled.items():
        if with_unit := [f for f in fields if f.unit is not None]:
            used[column], columns[column] = _one(path, column, with_unit, numbers)
        elif fields:
            fields_without_unit[column] = fields[0]
    columns |= {column: np.full(len(lines), constant) for column, constant in declared_constants(declared).items()}
    matched = [f.name for fields in by_column.values() for f in fields]
    unused, empty = tuple(n for n in names if n not in matched), tuple(n for n in matched if n in blank)
    rows = np.array(lines, dtype=np.int64)
    return FlightFields(path, columns, used, fields_without_unit, unused, empty, header, rows, numbers)


def _one(
    path: Path, column: str, fields: Sequence[FlightField], numbers: Mapping[str, FloatArray]
) -> tuple[FlightField, FloatArray]:
    """The field that a column is taken from, and its values.

    raises : InputError where several fields are the column and differ
    """
    values = [np.asarray(f.convert(numbers[f.name])) for f in fields]  # type: ignore[arg-type]
    plain = [k for k, f in enumerate(fields) if f.name == column]
    first = plain[0] if plain else 0
    for k, other in enumerate(values):
        apart = ~(np.abs(other - values[first]) <= SAME * np.maximum(np.abs(values[first]), 1.0))
        if not plain and np.any(apart & np.isfinite(other) & np.isfinite(values[first])):
            raise InputError(
                f"{display_path(path)}: `{fields[first].name}` and `{fields[k].name}` may both be {column}, and "
                f'differ; name one: --field {column}="{fields[first].name}"'
            )
    return fields[first], values[first]


def _numbers(cells: Sequence[Any]) -> FloatArray:
    """(row,) numbers of a column; NaN where a cell holds none."""
    try:
        return np.array(cells, dtype=np.float64)
    except (TypeError, ValueError):
        return np.array([_number(cell) for cell in cells])


def _number(cell: Any) -> float:
    if isinstance(cell, bool) or cell is None:
        return math.nan
    try:
        value = float(cell)
    except (TypeError, ValueError):
        return math.nan
    return value if math.isfinite(value) else math.nan


Rows = tuple[list[str], dict[str, str], dict[str, Sequence[Any]], list[int], dict[str, str]]
"""Names, unit by name, cells by name, line of each row, and the header."""


def _rows(path: Path, text: str) -> Rows:
    """The rows of a file.

    raises : InputError where there are no names, or no rows of numbers
    """
    if text.lstrip()[:1] in ("{", "["):
        return _json_rows(path, text)
    comments, plain = _comments_and_rows(text)
    sign = _separator([line for _, line in plain[:200]])
    split = [(i, _split(line, sign)) for i, line in plain]
    first = next((k for k, (_, c) in enumerate(split) if _is_data(c)), None)
    file = display_path(path)
    if first is None:
        raise InputError(f"{file}: no rows of numbers were found; give a file with a time and flight conditions")
    ahead = [line for i, line in comments if i < split[first][0]]
    names, units = _names_and_units(file, [c for _, c in split[:first]], ahead, sign, len(split[first][1]))
    body = _even_rows(file, split[first:], sign)
    columns: dict[str, Sequence[Any]] = dict(zip(names, zip(*_with_points(body, sign), strict=True), strict=True))
    header = dict(header_entry(line) for line in ahead if ":" in line)
    return names, units, columns, [i for i, _ in body], header


def declared_constants(declared: Mapping[str, ConditionField | str]) -> dict[str, float]:
    """Columns that are declared to be one number."""
    fields = {column: value for column, value in declared.items() if isinstance(value, ConditionField)}
    return {column: field.constant for column, field in fields.items() if field.constant is not None}


def _comments_and_rows(text: str) -> tuple[list[tuple[int, str]], list[tuple[int, str]]]:
    """Comments of a file, and its other lines, each with its number; without blank lines and ruled ones."""
    comments: list[tuple[int, str]] = []
    rows: list[tuple[int, str]] = []
    for i, line in enumerate(text.splitlines(), 1):
        if line.strip() and not RULE.match(line):
            (comments if line.lstrip().startswith("#") else rows).append((i, line))
    return comments, rows


def _names_and_units(
    file: str, rows: Sequence[list[str]], comments: Sequence[str], sign: str, width: int
) -> tuple[list[str], dict[str, str]]:
    """Names of the columns, and unit by name, from the rows and comments above the numbers.

    raises : InputError where there are no names, or a name is repeated
    """
    # else the names stand in the last comment that has as many cells
    named = [_split(line.lstrip().lstrip("#"), sign) for line in comments]
    above = [cells for cells in rows if len(cells) == width] or [c for c in named if len(c) == width][-1:]
    if not above:
        raise InputError(f"{file}: the row of column names is missing; add one, with units, as `Altitude (ft)`")
    names, units = above[-1], {}
    if len(above) > 1 and all(map(_is_unit, above[-1])):
        names = above[-2]
        units = {n: u.strip("[]() ") for n, u in zip(names, above[-1], strict=True)}
    if (twice := repeated_name(names)) is not None:
        raise InputError(f"{file}: column `{twice}` is repeated; remove one")
    return names, units


def _even_rows(file: str, body: list[tuple[int, list[str]]], sign: str) -> list[tuple[int, list[str]]]:
    """The rows that have as many cells as the first; between blanks others are left out.

    raises : InputError, naming the first row with another number of cells
    """
    width = len(body[0][1])
    ragged = [i for i, c in body if len(c) != width]
    if ragged and sign != " ":
        rule = f"does not have {width} cells as the other rows; mend or remove it{and_more_rows(len(ragged))}"
        raise InputError(f"{file}, row {ragged[0]}: {rule}")
    return [(i, c) for i, c in body if len(c) == width]


def _with_points(body: Sequence[tuple[int, list[str]]], sign: str) -> list[list[str]]:
    """Cells of rows, a decimal comma replaced by a point."""
    comma = sign != "," and any(re.fullmatch(r"[+-]?\d+,\d+(e[+-]?\d+)?", x, re.IGNORECASE) for x in body[0][1])
    return [[x.replace(",", ".") for x in c] if comma else c for _, c in body]


def _numbered_objects(text: str) -> list[tuple[int, Any]]:
    """Entries of a list in JSON with their numbers, or what each line holds with that of the line."""
    if text.lstrip().startswith("["):
        return list(enumerate(json.loads(text), 1))
    return [(i, json.loads(line)) for i, line in enumerate(text.splitlines(), 1) if line.strip()]


def _json_rows(path: Path, text: str) -> Rows:
    """Rows of JSON: one object a line, or a list of objects."""
    file = display_path(path)
    try:
        numbered = _numbered_objects(text)
    except json.JSONDecodeError as error:
        raise InputError(f"{file}, row {error.lineno}: is not JSON ({error.msg}); give one object a line") from None
    except RecursionError:
        raise InputError(f"{file}: objects or lists are nested too deeply; give one object a line") from None
    rows = [(i, row) for i, row in numbered if isinstance(row, dict)]
    if not rows or len(rows) != len(numbered):
        raise InputError(f"{file}: is no list of JSON objects; give one object a line, of a time and flight conditions")
    names = list(dict.fromkeys(name for _, row in rows for name in row))
    return names, {}, {n: [row.get(n) for _, row in rows] for n in names}, [i for i, _ in rows], {}


def _separator(lines: Sequence[str]) -> str:
    """The sign between the cells of the last lines: a tab, a semicolon, a comma, else blanks."""
    tail = lines[-20:]
    return next((s for s in ("\t", ";", ",") if tail and all(s in line for line in tail)), " ")


def _split(line: str, sign: str) -> list[str]:
    if sign == " ":
        return line.split()
    return [cell.strip() for cell in next(csv.reader([line], delimiter=sign, skipinitialspace=True))]


def _is_data(cells: Sequence[str]) -> bool:
    numbers = sum(bool(re.fullmatch(r"[+-]?(\d+[.,]?\d*|[.,]\d+)(e[+-]?\d+)?", c, re.IGNORECASE)) for c in cells)
    return numbers >= 2 and 2 * numbers >= sum(bool(c) and c.lower() != "nan" for c in cells)


def _is_unit(cell: str) -> bool:
    unit = cell.strip("[]() ")
    return unit in NO_DIMENSION or unit == "%" or known_unit(unit) is not None
