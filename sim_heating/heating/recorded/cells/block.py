"""A table of cells in text, with the lines of the file that they stand in."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path

import pandas as pd

from sim_heating.base.errors import InputError
from sim_heating.base.files import display_path


@dataclass(frozen=True)
class Block:
    """The rows of data of a file.

    path      : for messages
    names     : of the columns, as in the file; `column1` and so on where it has none
    units     : of a row of units, empty where there is none
    cells     : of each column, (row,) texts
    lines     : (row,) line of each row in the file
    separator : between cells; empty for a table that is no text
    decimal   : decimal sign that the file itself declares; empty where it does not
    names_line : line of the names; 0 where the file has none
    about     : what was recognised, in words
    notes     : what was left out, in words
    """

    path: Path
    names: tuple[str, ...]
    units: tuple[str, ...]
    cells: tuple[list[str], ...]
    lines: tuple[int, ...]
    separator: str = ""
    decimal: str = ""
    names_line: int = 1
    about: str = ""
    notes: tuple[str, ...] = field(default=())

    @property
    def has_names(self) -> bool:
        """Whether the file names its columns."""
        return self.names_line > 0

    def column(self, k: int) -> list[str]:
        """Texts of a column."""
        return self.cells[k]

    def at(self, row: int, name: str) -> str:
        """`file, row 14, column x`, the row as an editor counts it."""
        return f"{display_path(self.path)}, row {self.lines[row]}, column {name}"


def of_frame(path: Path, frame: pd.DataFrame, units: dict[str, str], about: str, first_line: int = 2) -> Block:
    """The block of a table with types, such as Parquet has.

    units      : column -> unit that the file states
    first_line : number of the first row, for messages
    raises     : InputError for a table without rows
    """
    if not len(frame.columns) or not len(frame):
        raise InputError(f"{display_path(path)}: the table has no rows")
    cells = tuple([cell_text(v) for v in frame.iloc[:, k]] for k in range(frame.shape[1]))
    names = tuple(str(c) for c in frame.columns)
    return Block(
        path,
        names,
        tuple(units.get(n, "") for n in names),
        cells,
        tuple(range(first_line, first_line + len(frame))),
        decimal=".",
        about=about,
    )


def cell_text(value: object) -> str:
    """A value as text that reads back equal; empty for a missing one."""
    if value is None or value is pd.NaT or (isinstance(value, float) and math.isnan(value)):
        return ""
    if isinstance(value, pd.Timestamp):
        return value.isoformat()
    if isinstance(value, pd.Timedelta):
        return repr(value.total_seconds())
    if hasattr(value, "isoformat"):
        return str(value.isoformat())
    return str(value).strip()
