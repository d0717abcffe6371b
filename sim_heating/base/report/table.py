"""A table of results: values under named columns, rendered by the console, HTML pages and CSV alike.

    Table(
        "Peak temperatures",
        [Column("control point"), Column("peak surface", "surface_K", ".0f", "K")],
        [("V09T9527", 1234.5)],
    )

Rows hold plain values; each writer formats them, for a reader in the console and pages (`texts`), for programs in CSV
(`columns_by_key`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any
from urllib.parse import quote

import numpy as np
from numpy.typing import NDArray

from sim_heating.base.files.csv_table import csv_text

MISSING = "-"
"""Text of a missing value (None or NaN)."""
SORTABLE = 8
"""Rows above which it helps to sort and filter them."""


@dataclass(frozen=True)
class Column:
    """One column of a table.

    head    : heading
    key     : its name in CSV; the head where not given
    format  : format specification of its numbers, as `.2f`; text and missing values are not formatted
    unit    : written after each number in texts
    is_text : left-aligned; numbers are right-aligned
    """

    head: str
    key: str = ""
    format: str = ""
    unit: str = ""
    is_text: bool = False

    def text(self, value: Any) -> str:
        """A value formatted for a reader."""
        if value is None or (isinstance(value, float) and math.isnan(value)):
            return MISSING
        if isinstance(value, str):
            return value
        number = format(value, self.format)
        return f"{number} {self.unit}" if self.unit else number


@dataclass(frozen=True)
class Table:
    """Rows of values under columns; a column may be given by its head alone. The first column is text.

    title    : what the table shows
    strong   : indices of the highlighted rows
    sortable : whether the reader of a page can sort its rows, and filter them by a text
    choices  : heads of columns by whose values the rows are filtered, too
    links    : of each row, the page that its first cell leads to, relative to the page; None for no page
    """

    title: str
    columns: Sequence[Column | str]
    rows: Sequence[Sequence[Any]]
    strong: Sequence[int] = ()
    sortable: bool = False
    choices: Sequence[str] = ()
    links: Sequence[str | None] = ()

    @property
    def layout(self) -> list[Column]:
        """The columns, each with its head, key and alignment."""
        columns = [Column(c) if isinstance(c, str) else c for c in self.columns]
        return [Column(c.head, c.key or c.head, c.format, c.unit, c.is_text or i == 0) for i, c in enumerate(columns)]

    @property
    def texts(self) -> list[list[str]]:
        """The cells of each row, formatted for a reader."""
        return [[c.text(v) for c, v in zip(self.layout, row, strict=True)] for row in self.rows]

    @property
    def sort_values(self) -> list[list[str]]:
        """What the cells of each row are sorted by: a number in full; empty for a text, and for a missing value."""
        return [[_sort_value(value) for value in row] for row in self.rows]

    @property
    def addresses(self) -> list[str | None]:
        """Address of the page of each row, percent-encoded and relative; None where it has none."""
        links = [*self.links, *[None] * (len(self.rows) - len(self.links))]
        return [None if link is None else f"./{quote(link)}" for link in links]

    def columns_by_key(self) -> dict[str, NDArray[Any]]:
        """One array a column, by its key; a missing number is NaN."""
        values = {c.key: [row[i] for row in self.rows] for i, c in enumerate(self.layout)}
        return {k: np.array([math.nan if x is None else x for x in v]) for k, v in values.items()}

    def lines(self) -> list[str]:
        """The table as lines of text, one a row below the heads; columns are padded to one width."""
        rows = [[c.head for c in self.layout], *self.texts]
        widths = [max(map(len, cells)) for cells in zip(*rows, strict=True)]
        return [
            "  ".join(
                cell.ljust(width) if c.is_text else cell.rjust(width)
                for cell, width, c in zip(row, widths, self.layout, strict=True)
            ).rstrip()
            for row in rows
        ]

    def csv(self, formats: Mapping[str, str] | str | None = None, header: Mapping[str, object] | None = None) -> str:
        """The table as CSV text; formats and header as `csv_text` takes them."""
        return csv_text(self.columns_by_key(), formats, header)


def _sort_value(value: Any) -> str:
    number = isinstance(value, (int, float, np.number)) and not isinstance(value, bool)
    return repr(float(value)) if number and math.isfinite(value) else ""
