"""Numbers in cells: the decimal and the thousands sign, decided once over all cells of a file, and units in cells."""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain, islice

import numpy as np
import pandas as pd

from sim_heating.base.arrays import FloatArray
from sim_heating.base.errors import InputError
from sim_heating.base.files.text import abbreviated
from sim_heating.base.files.units import converted, known_unit
from sim_heating.heating.recorded.cells.block import Block

BLANKS = "\u00a0\u202f'"
"""Thousands signs that are no decimal sign."""
TORN = re.compile(r"(?i)(?:(?:#?n/?an?|null|none|ov?l|over\w*|open(?: tc)?|-+)\s+)?\(?[+-]?[.,]?\d")
"""How a cell begins that holds a number, or several, also behind a lost one or in brackets, but not in the layout of
the file."""
PLAIN_CHARACTERS = set("0123456789.+-eE")
WITH_UNIT = re.compile(r"([+-]?[\d.,'\u00a0\u202f]*\d[.,]?(?:[eE][+-]?\d+)?)\s*([^\d\s.,;:+-].*)")
GROUPED = r"[+-]?[1-9]\d{{0,2}}(?:{0}\d{{3}})+"
EITHER = re.compile(r"[+-]?[1-9]\d{0,2}([.,])\d{3}")
"""A number whose sign may be that of decimals or of thousands."""
EITHER_LINES = tuple(re.compile(rf"^[+-]?[1-9]\d{{0,2}}{sign}\d{{3}}$", re.MULTILINE) for sign in ("\\.", ","))
OTHER_LINE = re.compile(rf"^(?!{EITHER.pattern}$).+$", re.MULTILINE)
"""Cells in lines of a text: such a number by its sign, and all others; one search of all is fast."""
LEAST_WHOLE = 3
"""Different whole numbers of three digits that show a sign of thousands; one or two may be codes of lost samples."""
EXPONENT = r"(?:[eE][+-]?\d+)?"


@dataclass(frozen=True)
class Signs:
    """Decimal and thousands sign of a file; the latter is empty where there is none."""

    decimal: str
    thousands: str = ""

    @property
    def words(self) -> str:
        """As in `decimal comma, thousands point`."""
        name = {".": "point", ",": "comma", "": ""}
        thousands = f", thousands {name.get(self.thousands, 'blank')}" if self.thousands else ""
        return f"decimal {name[self.decimal]}{thousands}"

    @property
    def pattern(self) -> re.Pattern[str]:
        """Pattern of a number that is written with these signs."""
        point, comma = re.escape(self.decimal), re.escape(self.thousands)
        integer = rf"(?:\d+|[1-9]\d{{0,2}}(?:{comma}\d{{3}})+)" if self.thousands else r"\d+"
        return re.compile(rf"[+-]?(?:{integer}(?:{point}\d*)?|{point}\d+){EXPONENT}")


def number_signs(block: Block, columns: Sequence[int], decimal: str | None) -> Signs:
    """The signs of all numbers of a file.

    columns : those of numbers, not of clocks
    decimal : the decimal sign, where it is stated
    raises  : InputError that names a cell where both readings hold, or cells contradict each other
    """
    stated = decimal or block.decimal
    evidence, open_cells, blank = _shown_signs(block, columns)
    if not stated and len(evidence) > 1:
        raise _contradiction(block, evidence)
    sign = stated or next(iter(evidence), "")
    if sign:
        return Signs(sign, blank or _thousands(block, columns, sign))
    if len(open_cells) == 1 and _shows_thousands(block, columns, thousands := next(iter(open_cells))):
        return Signs(_other_sign(thousands), thousands)
    _refuse_open_cells(block, columns, open_cells)
    return Signs(".", blank)


def _contradiction(block: Block, evidence: Mapping[str, tuple[int, int]]) -> InputError:
    """The message of a file whose cells show both decimal signs."""
    (row, k), (first_row, first_k) = max(evidence.values()), min(evidence.values())
    two = f"`{block.cells[k][row]}`" + (f" and `{block.cells[first_k][first_row]}`" if first_row >= 0 else "")
    rule = "do not have one decimal sign; state it, --decimal . or --decimal ,"
    return InputError(f"{block.at(row, block.names[k])}: {two} {rule}")


def _refuse_open_cells(block: Block, columns: Sequence[int], open_cells: Mapping[str, tuple[int, int]]) -> None:
    """Refuse a cell whose sign may be that of decimals or of thousands.

    raises : InputError with both numbers that it may be
    """
    for either, (row, k) in open_cells.items():
        if either == "," or _may_be_thousands(block, columns):
            cell = block.cells[k][row]
            integer, fraction = re.sub(r"[.,]", "", cell), cell.replace(",", ".")
            raise InputError(
                f"{block.at(row, block.names[k])}: `{cell}` may be {integer} or {fraction}; state the decimal "
                f"sign, --decimal {_other_sign(either)} for {integer}, --decimal {either} for {fraction}"
            )


def _other_sign(sign: str) -> str:
    return "," if sign == "." else "."


def _shown_signs(
    block: Block, columns: Sequence[int]
) -> tuple[dict[str, tuple[int, int]], dict[str, tuple[int, int]], str]:
    """Signs of numbers with the row and column of the first cell that has them, and the blank between thousands.

    returns : decimal signs that a cell shows; single signs before three digits, which may be either; the blank
    """
    evidence: dict[str, tuple[int, int]] = {}
    open_cells: dict[str, tuple[int, int]] = {}
    blank = ""
    for k in columns:
        cells = block.column(k)
        joined = "".join(cells)
        blank = next((b for b in BLANKS if b in joined), blank)
        for row, is_shown, sign in _column_signs(cells, {sign for sign in ".," if sign in joined}):
            (evidence if is_shown else open_cells).setdefault(sign, (row, k))
    return evidence, open_cells, blank


def _column_signs(cells: Sequence[str], signs: Collection[str]) -> Iterator[tuple[int, bool, str]]:
    """Row of each telling cell of a column, whether it decides the decimal sign, and its sign.

    signs : those that stand in the column
    """
    for row, cell in _telling(cells) if signs else ():
        if (shown := _sign_of(cell)) is not None:
            yield row, *shown
            if shown[0] and len(signs) == 1:
                return  # no other cell of the column has another sign


def _telling(cells: Sequence[str]) -> Iterator[tuple[int, str]]:
    """Row and text of the cells that may tell a sign: of numbers that may be either, the first ones of each sign."""
    text = "\n".join(cells)
    if text.count("\n") >= len(cells):  # cells of a sheet may hold line breaks
        yield from enumerate(cells)
        return
    row, counted_to = 0, 0
    for match in chain(*(islice(pattern.finditer(text), 1) for pattern in EITHER_LINES), OTHER_LINE.finditer(text)):
        if match.start() < counted_to:
            row, counted_to = 0, 0
        row += text.count("\n", counted_to, match.start())
        counted_to = match.start()
        yield row, cells[row]


def _sign_of(cell: str) -> tuple[bool, str] | None:
    """Whether a cell decides the decimal sign, and the sign; None where it has no sign."""
    match = WITH_UNIT.fullmatch(cell)
    text = (match[1] if match else cell).translate(str.maketrans("", "", BLANKS))
    if not re.fullmatch(rf"[+-]?[\d.,]*\d[.,]?{EXPONENT}|[+-]?[.,]\d+{EXPONENT}", text):
        return None
    text = re.sub(r"[eE].*", "", text)
    signs = re.findall(r"[.,]", text)
    if not signs:
        return None
    last = signs[-1]
    if len(set(signs)) == 2:
        is_grouped = re.fullmatch(r"[+-]?\d{1,3}(?:[.,]\d{3})+[.,]\d*", text)
        return (True, last) if signs.count(last) == 1 and is_grouped else None
    is_grouped = re.fullmatch(GROUPED.format(re.escape(last)), text)
    if len(signs) > 1:
        return (True, _other_sign(last)) if is_grouped else None
    return not is_grouped, last


def _thousands(block: Block, columns: Sequence[int], decimal: str) -> str:
    """The thousands sign that cells show beside a decimal sign."""
    other = _other_sign(decimal)
    grouped = re.compile(GROUPED.format(re.escape(other)) + rf"(?:{re.escape(decimal)}\d*)?{EXPONENT}")
    written = [block.column(k) for k in columns if other in "".join(block.column(k))]
    return other if any(other in c and grouped.fullmatch(_bare(c)) for cells in written for c in cells) else ""


def _bare(cell: str) -> str:
    match = WITH_UNIT.fullmatch(cell)
    return (match[1] if match else cell).strip()


def _shows_thousands(block: Block, columns: Sequence[int], sign: str) -> bool:
    """Whether a sign as in `1,100` is that of thousands by the whole numbers of three digits in the same column: with a
    fixed number of decimals, as the zero at an end shows, none would be written without them."""
    for k in columns:
        cells = {c for c in map(_bare, block.column(k)) if c}
        hundreds = sum(re.fullmatch(r"[+-]?[1-9]\d\d", c) is not None for c in cells)
        if hundreds >= LEAST_WHOLE and any(sign in c and c.endswith("0") for c in cells):
            return True
    return False


def _may_be_thousands(block: Block, columns: Sequence[int]) -> bool:
    """Whether points with three digits behind them may be those of thousands: whole numbers of hundreds stand beside
    them, or all are of one to nine thousand, where the separator is not that of countries with a decimal point."""
    return any(_may_group(list(filter(None, map(_bare, block.column(k)))), block.separator) for k in columns)


def _may_group(cells: Sequence[str], separator: str) -> bool:
    """Whether the points in the cells of one column may be signs of thousands."""
    pointed = [c for c in cells if "." in c]
    integers = [abs(float(c)) for c in cells if re.fullmatch(r"[+-]?\d{1,9}", c)]
    if not pointed or max(integers, default=0.0) >= 100.0:
        return bool(pointed)
    return separator != "," and all(re.fullmatch(r"[+-]?[1-9]\.\d{3}", c) for c in pointed)


@dataclass(frozen=True)
class Numbers:
    """Numbers of a column.

    values : (row,) NaN where the cell holds none
    unit   : that stands in the cells; empty where none does
    texts  : in place of numbers, each once; empty cells aside
    torn   : row of the first cell that is neither a number in this layout nor a word; -1 where there is none
    """

    values: FloatArray
    unit: str
    texts: tuple[str, ...]
    torn: int


def numbers_of(cells: Sequence[str], signs: Signs) -> Numbers:
    """The numbers that the cells of a column hold."""
    if signs == Signs(".") and set("".join(cells)) <= PLAIN_CHARACTERS:
        return _plain_numbers(cells)
    pattern, drop = signs.pattern, str.maketrans("", "", signs.thousands + BLANKS)
    read = {cell: _read(cell, pattern, drop, signs.decimal) for cell in dict.fromkeys(filter(None, cells))}
    numbers = {cell: number for cell, number in read.items() if not math.isnan(number[0])}
    texts = {cell: None for cell in read if cell not in numbers}
    values = np.array([numbers.get(cell, (math.nan, ""))[0] for cell in cells])
    units = _units_of(numbers.values())
    torn = _torn_row(cells, texts, numbers, units)
    return Numbers(values, units.pop() if len(units) == 1 else "", tuple(texts), torn)


def _units_of(numbers: Collection[tuple[float, str]]) -> set[str]:
    """Units of numbers; the code of a lost sample states none."""
    units = {unit for _, unit in numbers}
    if len(units) == 2 and all(_is_code(value) for value, unit in numbers if not unit):
        units.discard("")
    return units


def _torn_row(
    cells: Sequence[str], texts: Collection[str], numbers: Mapping[str, tuple[float, str]], units: Collection[str]
) -> int:
    """Row of the first text that begins as a number, else of the first number in another unit; -1 without either."""
    torn = next((i for i, cell in enumerate(cells) if cell in texts and TORN.match(cell)), -1)
    if torn >= 0 or len(units) < 2:
        return torn
    first = next(iter(numbers.values()))[1]
    return next(i for i, cell in enumerate(cells) if cell in numbers and numbers[cell][1] != first)


def _plain_numbers(cells: Sequence[str]) -> Numbers:
    """Numbers of cells without units, thousands and decimal commas, read all at once."""
    try:
        values = np.fromiter(map(float, cells), dtype=float, count=len(cells))
    except ValueError:  # a cell is empty or torn
        values = np.asarray(pd.to_numeric(pd.Series(cells, dtype=object), errors="coerce"), dtype=float)
    bad = [int(i) for i in np.flatnonzero(np.isnan(values)) if cells[int(i)]]
    torn = next((i for i in bad if any(c.isdigit() for c in cells[i])), -1)
    return Numbers(np.where(np.isfinite(values), values, np.nan), "", tuple({cells[i] for i in bad}), torn)


def _is_code(value: float) -> bool:
    """Whether a number may be a recorder's code of a lost sample: an overload, or a row of nines."""
    return math.isnan(value) or abs(value) >= 1e30 or re.fullmatch(r"-9{2,5}(?:\.9{1,2}|\.0)?", f"{value}") is not None


def _read(cell: str, pattern: re.Pattern[str], drop: dict[int, int | None], decimal: str) -> tuple[float, str]:
    """The number of a cell and the unit behind it; NaN where it is none in this layout."""
    text, unit = cell, ""
    plain = text.replace("\u2212", "-").translate({ord(b): None for b in BLANKS})
    if pattern.fullmatch(plain) is None:
        match = WITH_UNIT.fullmatch(cell)
        if match is None or known_unit(match[2]) is None:
            return math.nan, ""
        plain, unit = match[1].translate({ord(b): None for b in BLANKS}), match[2]
        if pattern.fullmatch(plain) is None:
            return math.nan, ""
    value = float(plain.translate(drop).replace(decimal, "."))
    return (value, unit) if math.isfinite(value) else (math.nan, "")


def require_one_unit(block: Block, k: int, numbers: Numbers, stated: str, quantities: Sequence[str]) -> None:
    """Refuse a column that states another unit than its cells.

    stated     : unit of the name or of a row of units; one of no quantity, such as `Avg`, is none
    quantities : SI units that both convert to
    raises     : InputError with the first such cell
    """
    of_column, of_cells = ([converted(unit, si) for si in quantities] for unit in (stated, numbers.unit))
    if numbers.unit and stated and any(of_column) and of_column != of_cells:
        i = int(np.argmax(np.isfinite(numbers.values)))
        rule = f"has another unit than the column states, `{stated}`; write one unit"
        raise InputError(f"{block.at(i, block.names[k])}: `{shown_cell(block.column(k)[i])}` {rule}")


def shown_cell(cell: str) -> str:
    """A cell for a message."""
    return abbreviated(cell).strip('"')
