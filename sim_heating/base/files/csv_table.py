"""CSV tables: a row of column names, numbers below; problems are located by row (line of the file) and column."""

from __future__ import annotations

import csv
import io
import math
import os
import re
from collections.abc import Container, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sim_heating.base.arrays import FloatArray
from sim_heating.base.errors import InputError, RunError
from sim_heating.base.files.text import (
    abbreviated,
    and_more_rows,
    display_path,
    is_plain,
    nearest_name,
    plain_number,
    raise_problems,
    read_text,
    write_text_atomic,
)

COLDEST_K = 100.0
"""A lower temperature is taken for a value in Celsius [K]."""
RUNS_BACK = "the rows run back in time: read from the last"
LARGE_TEXT = 3_000_000
"""Characters from which a text is read as a whole, and cell by cell only where that fails."""
NUMBERS = "fiub"
"""Kinds of numpy's types that are numbers."""


@dataclass(frozen=True)
class CsvTable:
    """A CSV file by columns.

    columns : name -> (row,) float64 in the order of the file; NaN only where an empty cell is allowed
    header  : `# key: value` lines before the names
    path    : the file, for messages
    lines   : (row,) line number of each row in the file
    heads   : name -> head of its column in the file, where that is another
    """

    columns: dict[str, FloatArray]
    header: dict[str, str]
    path: Path
    lines: NDArray[np.int64]
    heads: Mapping[str, str] = field(default_factory=dict)

    def __getitem__(self, name: str) -> FloatArray:
        return self.columns[name]

    def __len__(self) -> int:
        return len(self.lines)

    def problem(self, index: int, column: str, rule: str) -> str:
        """`file, row 14, column x: value rule`."""
        return f"{self._cell(index, column)}: {self.columns[column][index]:g} {rule}"

    def _cell(self, index: int, column: str) -> str:
        return f"{display_path(self.path)}, row {self.lines[index]}, column {_in_file(column, self.heads)}"

    def problems_where_not(self, column: str, holds: ArrayLike, rule: str) -> list[str]:
        """One problem line for a column where a condition does not hold in every row, naming the first such row."""
        bad = np.flatnonzero(~np.asarray(holds, dtype=bool))
        if bad.size == 0:
            return []
        return [self.problem(int(bad[0]), column, rule) + and_more_rows(bad.size)]

    def order_problems(self) -> list[str]:
        """Problems of `time_s`, which must increase from row to row."""
        values = self.columns["time_s"]
        bad = np.flatnonzero(~(np.diff(values) > 0.0)) + 1
        if bad.size == 0:
            return []
        before = f"does not come after {values[bad[0] - 1]:.10g}; sort the rows by time_s and remove repeated ones"
        return [f"{self._cell(int(bad[0]), 'time_s')}: {values[bad[0]]:.10g} {before}"]

    def with_columns(self, columns: Mapping[str, FloatArray]) -> CsvTable:
        """Copy of the table with columns added, each (row,) in the unit that its name ends in."""
        return replace(self, columns={**self.columns, **columns})

    def celsius_problems(self, column: str) -> list[str]:
        """Problems of a temperature column [K]: values below 100 K are taken for Celsius. NaN is accepted."""
        return self.problems_where_not(column, ~(self.columns[column] < COLDEST_K), celsius_rule())


def _in_file(column: str, heads: Mapping[str, str]) -> str:
    """A column as a message names it: by its head in the file, with the column that it is read as."""
    return f"`{heads[column]}` (read as {column})" if column in heads else column


def runs_back(time_s: FloatArray) -> bool:
    """Whether times [s], three at least, go back from row to row, as where the newest row is the first."""
    return len(time_s) > 2 and bool(np.all(np.diff(time_s) < 0.0))


def celsius_rule() -> str:
    """The rule that a message states about a temperature too low to be in K."""
    return f"is below {COLDEST_K:g} K and looks like Celsius; give K (Celsius + 273.15)"


def read_csv_columns(
    path: str | os.PathLike[str],
    required: Sequence[str],
    optional: Sequence[str] = (),
    *,
    content: str | None = None,
    allow_empty: Iterable[str] = (),
    keep_other: bool = True,
    heads: Mapping[str, str] | None = None,
) -> CsvTable:
    """Read a CSV file with one row of names and numbers below it.

    required    : columns that must exist
    optional    : known columns that may be absent; a similar name in place of an absent one is an error
    content     : text of the file, where it has been read already; messages name the path all the same
    allow_empty : columns of readings: an empty cell is a lost sample (NaN)
    keep_other  : keep further columns, which must be numeric too
    heads       : column -> its head in the file, for messages, where the content has other names than the file
    raises      : InputError naming row, column and value, all problems at once
    """
    path, content = Path(path), read_text(path) if content is None else content
    lost, heads = set(allow_empty), heads or {}
    if len(content) > LARGE_TEXT:
        large = _large_table(path, content, required, optional, lost, keep_other)
        if large is not None:
            return replace(large, heads=heads)
    names, rows, lines, header = _cells(path, content)
    file = display_path(path)
    raise_problems(_name_problems(file, names, required, optional, lost))
    raise_problems(_ragged_rows(file, rows, lines, len(names)))
    raise_problems(_units_problems(file, rows, lines, bool(lost)))
    cells = dict(zip(names, zip(*rows, strict=True), strict=True))
    selected = _selected(names, required, optional, keep_other)
    columns: dict[str, FloatArray] = {}
    problems: list[str] = []
    for name in selected:
        columns[name], bad = _numbers(cells[name], name in lost)
        problems += [f"{file}, row {lines[i]}, column {_in_file(name, heads)}: {problem}" for i, problem in bad]
    raise_problems(problems)
    return CsvTable(columns, header, path, np.array(lines, dtype=np.int64), heads)


def _selected(names: Sequence[str], required: Sequence[str], optional: Sequence[str], keep_other: bool) -> list[str]:
    """Columns of a file that are read."""
    return [n for n in names if keep_other or n in {*required, *optional}]


def _large_table(
    path: Path, content: str, required: Sequence[str], optional: Sequence[str], lost: set[str], keep_other: bool
) -> CsvTable | None:
    """The table of a large text whose cells are plain numbers, or empty in columns of readings; None for any other,
    which is read cell by cell, so that messages name the cell."""
    above, head, body = _head(content)
    names = [name.strip() for name in head.split(",")]
    rows = body.count("\n") + (not body.endswith("\n"))
    if '"' in content or _name_problems("", names, required, optional, lost):
        return None
    if not _has_plain_numbers(body, rows * (len(names) - 1)):
        return None
    selected = _selected(names, required, optional, keep_other)
    values = _all_values(body, rows, list(map(names.index, selected)), bool(lost))
    if values is None:
        return None
    columns = {name: np.ascontiguousarray(values[:, k]) for k, name in enumerate(selected)}
    if not all(_is_usable(v, n in lost) for n, v in columns.items()):
        return None
    first = above.count("\n") + 2
    return CsvTable(columns, _header(above.splitlines()), path, np.arange(first, first + rows, dtype=np.int64))


def _is_usable(values: FloatArray, may_be_empty: bool) -> bool:
    """Whether all numbers of a column are finite, or NaN where cells may be empty."""
    usable = np.isfinite(values)
    return bool(np.all(usable | np.isnan(values) if may_be_empty else usable))


def _all_values(body: str, rows: int, used: Sequence[int], may_be_empty: bool) -> FloatArray | None:
    """(row, column) numbers of the columns used; NaN for an empty cell. None where a cell or a row holds none."""
    if "," in body and may_be_empty:
        body = re.sub(r",(?=[ ]*(?:,|\n|$))", ",nan", re.sub(r"(?m)^(?=[ ]*,)", "nan", body))
    try:
        values = np.loadtxt(io.StringIO(body), delimiter=",", ndmin=2, usecols=used)
    except ValueError:
        return None
    return values if len(values) == rows else None


def _header(lines: Iterable[str]) -> dict[str, str]:
    """Entries `# key: value` above the names of a file."""
    return dict(header_entry(line) for line in lines if ":" in line)


def _has_plain_numbers(body: str, commas: int) -> bool:
    """Whether rows of a table have no words, no comments, and as many commas in all as their columns need."""
    if "\r" in body or body.count(",") != commas or not is_plain(body):
        return False
    return re.search(r"[a-df-zA-DF-Z#]", body) is None  # an e is that of an exponent


def _head(content: str) -> tuple[str, str, str]:
    """Lines above the names, the line of the names, and the lines below it, without blank ones at the end."""
    start = 0
    while True:
        end = content.find("\n", start)
        line = content[start : end if end >= 0 else len(content)]
        if end < 0 or _is_of_names(line):
            return content[:start], line, content[end + 1 :].rstrip() if end >= 0 else ""
        start = end + 1


def _is_of_names(line: str) -> bool:
    """Whether a line may be that of the names: neither blank nor a comment."""
    return bool(line.strip()) and not line.startswith("#")


def names_line(lines: Sequence[str]) -> int | None:
    """Index of the line of the names; None where all are blank or comments."""
    return next((i for i, line in enumerate(lines) if _is_of_names(line)), None)


def _cells(path: Path, text: str) -> tuple[list[str], list[list[str]], list[int], dict[str, str]]:
    """Names, rows of cells, the line of each row, and the `# key: value` header."""
    content = text.replace("\r\n", "\n").replace("\r", "\n").rstrip().split("\n")
    if (first := names_line(content)) is None:
        raise InputError(f"{display_path(path)}: the row of column names is missing; the file holds comments only")
    reader = csv.reader(content[first:])
    try:
        rows = [(row, first + reader.line_num) for row in reader]
    except csv.Error as error:
        raise InputError(f"{display_path(path)}, row {first + reader.line_num}: is not CSV ({error})") from None
    names = [name.strip() for name in rows[0][0]]
    if len(rows) < 2:
        raise InputError(
            f"{display_path(path)}: there are no rows below the column names; the file may have been cut off"
        )
    blank = [f"{display_path(path)}, row {line}: the row is blank; remove it" for row, line in rows if not row]
    raise_problems(_first_and_count(blank))
    return names, [row for row, _ in rows[1:]], [line for _, line in rows[1:]], _header(content[:first])


def header_entry(line: str) -> tuple[str, str]:
    """Key and value of a line `# key: value` above the names of a file."""
    key, _, value = line.lstrip("# ").partition(":")
    return key.strip(), value.strip()


def _first_and_count(problems: list[str]) -> list[str]:
    return [problems[0] + and_more_rows(len(problems))] if problems else []


def _ragged_rows(file: str, rows: list[list[str]], lines: list[int], width: int) -> list[str]:
    """The problem of the first row with another number of cells than there are names, and the count of such rows."""
    ragged = {line: len(row) for row, line in zip(rows, lines, strict=True) if len(row) != width}
    rule = f"cells for {width} columns; the row is damaged or cut off"
    return _first_and_count([f"{file}, row {line}: {count} {rule}" for line, count in ragged.items()])


def _units_problems(file: str, rows: list[list[str]], lines: list[int], readings: bool) -> list[str]:
    """The problem of a row of units below the names: no cell of it is a number, and those of the next row are."""
    if len(rows) < 2 or any(isinstance(_number(c, False), float) for c in rows[0]):
        return []
    if not any(isinstance(_number(c, False), float) for c in rows[1]):
        return []
    shown = ", ".join(f'"{abbreviated(cell.strip()).strip(chr(34))}"' for cell in rows[0][:3])
    ellipsis = ", ..." if len(rows[0]) > 3 else ""
    convert = "; or let `sim-heating new record --csv` convert the file" if readings else ""
    return [
        f"{file}, row {lines[0]}: {shown}{ellipsis} are no numbers; units are those that the names end in: "
        f"convert to them and remove the row{convert}"
    ]


def _name_problems(
    file: str, names: list[str], required: Sequence[str], optional: Sequence[str], readings: Iterable[str]
) -> list[str]:
    """Problems of the row of names: missing, repeated, empty, misspelt; readings : columns that the user named."""
    other, missing = _without(names, {*required, *optional}), _without(required, names)
    if missing and (sign := _other_separator(names)):
        return [f"{file}, row of names: cells are separated by {sign!r}; separate them by commas"]
    problems = [f"{file}: there is no column `{n}`{_nearest_column(n, other, n in readings)}" for n in missing]
    problems += _repeated_or_empty(file, names)
    misspelt = {c: n for n in _without(optional, names) if (c := nearest_name(n, other, cutoff=0.85))}
    return problems + [f"{file}: unknown column `{c}`; did you mean `{n}`?" for c, n in misspelt.items()]


def _without(names: Iterable[str], others: Container[str]) -> list[str]:
    return [n for n in names if n not in others]


def _other_separator(names: list[str]) -> str:
    """The sign that separates the names, where it is no comma; empty where it is."""
    return next((s for s in ";\t" if s in names[0]), "") if len(names) == 1 else ""


def _repeated_or_empty(file: str, names: list[str]) -> list[str]:
    repeated = [f"{file}: column `{n}` is repeated; remove one" for n in dict.fromkeys(names) if names.count(n) > 1]
    return repeated + [f"{file}: column {i + 1} has no name; name or remove it" for i, n in enumerate(names) if not n]


def _nearest_column(name: str, other: list[str], of_readings: bool) -> str:
    """What to do about a missing column: the most similar one, or those that may be the readings looked for."""
    close = nearest_name(name, other)
    if close:
        return f"; nearest in the file: `{close}`"
    # `STS96_480_surface_K` where the file has `mine_K`: one of the two names is to be changed
    readings = [n for n in other if not n.startswith("sigma")] if of_readings else []
    return (
        f"; the file has {', '.join(f'`{n}`' for n in readings[:6])}: change one of the names"
        if readings
        else "; add it"
    )


def _numbers(cells: Sequence[str], may_be_empty: bool) -> tuple[FloatArray, list[tuple[int, str]]]:
    """Numbers of a column, and (row index, problem) of its first invalid cell with the count of the others."""
    values = _all_numbers(cells)
    if values is not None:
        return values, []
    parsed = [_number(cell, may_be_empty) for cell in cells]
    bad = [(i, p) for i, p in enumerate(parsed) if isinstance(p, str)]
    if bad:
        return np.empty(0), [(bad[0][0], bad[0][1] + and_more_rows(len(bad)))]
    return np.array(parsed, dtype=np.float64), []


def _all_numbers(cells: Sequence[str]) -> FloatArray | None:
    """All cells at once; None where one of them is not a plain finite number."""
    try:
        values = np.array(cells, dtype=np.float64)
    except ValueError:
        return None
    return values if np.all(np.isfinite(values)) and is_plain("".join(cells)) else None


def _number(cell: str, may_be_empty: bool) -> float | str:
    """The number in a cell, or the problem with it."""
    stripped = cell.strip()
    if not stripped:
        return math.nan if may_be_empty else "the cell is empty; give a number"
    hint = "; leave the cell of a lost sample empty" if may_be_empty else ""
    try:
        value = plain_number(stripped)
    except ValueError:
        return f"{abbreviated(stripped)} is not a number{hint}"
    if not math.isfinite(value):
        return f"{stripped} is not a finite number{hint}"
    return value


def csv_text(
    columns: Mapping[str, ArrayLike],
    formats: Mapping[str, str] | str | None = None,
    header: Mapping[str, object] | None = None,
) -> str:
    """Columns as CSV text: `# key: value` lines, a row of names, one row a sample; NaN becomes an empty cell.

    formats : number format by column, or one for all, as in `".2f"`; without one a number reads back equal
    raises  : RunError where a number is infinite or columns differ in length
    """
    arrays = {name: np.asarray(v) for name, v in columns.items()}
    texts = [_cell_texts(name, v, formats) for name, v in arrays.items()]
    if len(set(map(len, texts))) > 1:
        raise RunError(f"columns {', '.join(columns)} differ in length")
    stream = io.StringIO()
    stream.writelines(f"# {key}: {' '.join(str(value).split())}\n" for key, value in (header or {}).items())
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(columns)
    rows = zip(*texts, strict=True)
    # no cell to quote; an empty one that is alone in its row would be
    if {v.dtype.kind for v in arrays.values()} <= set(NUMBERS) and len(arrays) > 1:
        stream.writelines(f"{','.join(row)}\n" for row in rows)
    else:
        writer.writerows(rows)
    return stream.getvalue()


def _cell_texts(name: str, values: NDArray[Any], formats: Mapping[str, str] | str | None) -> list[str]:
    if values.dtype.kind not in NUMBERS:
        return [str(v) for v in values]
    if np.any(np.isinf(values)):
        raise RunError(f"column {name} contains an infinite number; nothing was written")
    spec = formats if isinstance(formats, str) else (formats or {}).get(name)
    cells = list(map(repr if spec is None else f"{{:{spec}}}".format, values.tolist()))
    for lost in np.flatnonzero(np.isnan(values)):
        cells[lost] = ""
    return cells


def write_csv(
    path: str | os.PathLike[str],
    columns: Mapping[str, ArrayLike],
    formats: Mapping[str, str] | str | None = None,
    header: Mapping[str, object] | None = None,
) -> None:
    """Write columns as a CSV file, whole or not at all; arguments and errors as `csv_text`."""
    write_text_atomic(path, csv_text(columns, formats, header))
