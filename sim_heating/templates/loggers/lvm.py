"""Measurement files of LabVIEW (.lvm): a header, then segments, each with a header and rows.

source : NI, Specification for the LabVIEW Measurement File (.lvm)
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from datetime import datetime
from functools import partial
from pathlib import Path

from sim_heating.base.errors import InputError
from sim_heating.base.files import display_path
from sim_heating.heating.recorded.cells.block import Block
from sim_heating.heating.recorded.cells.numbers import shown_cell
from sim_heating.heating.recorded.cells.text import SEPARATORS, Row, split_lines
from sim_heating.templates.loggers.files import chosen_name
from sim_heating.templates.loggers.layout_file import LoggerLayout

END = "***End_of_Header***"
HEADER_KEYS = re.compile(r"Channels|Samples|Date|Time|[XY]_(Unit_Label|Dimension)|X0|Delta_X|Notes|(Test|UUT)_\w+")
"""Keys of the header of a segment."""
CLOCK_JITTER = 0.05
"""Most difference of the stamps of two segments from X values that go on, as a part of the time between them."""
Segment = tuple[Block, float | None]
"""Its columns, the first one of time where there is one, and the seconds at which it begins by its date and time."""
Header = Mapping[str, Sequence[str]]
"""Cells of the rows of a segment's header, by key."""


def is_lvm(text: str) -> bool:
    """Whether a text is a measurement file of LabVIEW."""
    return text.lstrip().startswith("LabVIEW Measurement")


def lvm_block(path: Path, text: str, layout: LoggerLayout) -> Block:
    """The block of a measurement file: one column of time, one a channel, its segments one below the other.

    layout : its `sheet` is the number of a segment, `1` the first; None for all of them
    raises : InputError, one line, where a header does not end, or nothing states how the segments follow each other
    """
    lines = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
    numbered = [(i, line) for i, line in enumerate(lines, 1) if line.strip(" \t,;")]
    sign = _separator(line for _, line in numbered[:10])
    rows = split_lines(numbered, sign)
    ends = [k for k, (_, cells) in enumerate(rows) if cells[0] == END]
    if len(ends) < 2 or any(cells[0] == "Channels" for _, cells in rows[ends[-1] :]):
        raise InputError(f"{display_path(path)}: the header of the LabVIEW file does not end; it may have been cut off")
    segments = _segments(path, rows, ends, sign)
    if layout.sheet is None:
        return _joined(segments)
    chosen = chosen_name(path, "segment", list(map(str, range(1, len(segments) + 1))), layout)
    block = segments[int(chosen) - 1][0]
    return replace(block, about=f"{block.about}, segment {chosen}")


def _separator(lines: Iterable[str]) -> str:
    return "," if any(re.match(r"Separator[\t,]\s*Comma", line) for line in lines) else "\t"


def _segments(path: Path, rows: Sequence[Row], ends: Sequence[int], sign: str) -> list[Segment]:
    """All segments of a file; ends : rows at which the header of the file and those of its segments end."""
    header = {cells[0]: cells[1] for _, cells in rows[: ends[0]] if len(cells) > 1}
    begins = [_header_begin(rows, end) for end in ends[1:]]
    return [
        _segment(path, {cells[0]: cells for _, cells in rows[begin:end]}, rows[end + 1 : next_one], header, sign)
        for begin, end, next_one in zip(begins, ends[1:], [*begins[1:], len(rows)], strict=True)
    ]


def _header_begin(rows: Sequence[Row], end: int) -> int:
    while HEADER_KEYS.fullmatch(rows[end - 1][1][0]):
        end -= 1
    return end


def _segment(path: Path, stated: Header, below: Sequence[Row], header: dict[str, str], sign: str) -> Segment:
    """A segment of the rows of its names and readings.

    stated : by its own header;  header : of the file
    raises : InputError, one line, where there are no readings
    """
    if len(below) < 2:
        raise InputError(f"{display_path(path)}: no rows of numbers below the header; it may have been cut off")
    (names_line, names), *body = below
    x_columns, decimal = header.get("X_Columns", "One"), header.get("Decimal_Separator") or "."
    if x_columns == "No":
        names, body = _with_x_column(names, body)
    columns = _named_columns(names, body)
    is_time = "X_Value" if x_columns == "Multi" else None
    channels = [k for k in range(1, len(columns)) if names[k] != is_time]
    block = Block(
        path,
        tuple(names[k] or f"column{k + 1}" for k in channels),
        tuple(map(partial(_cell, stated, "Y_Unit_Label"), channels)),
        tuple(columns[k] for k in channels),
        next(zip(*body, strict=True)),
        sign,
        decimal,
        names_line,
        f"LabVIEW LVM, cells separated by {SEPARATORS[sign]}",
    )
    return _with_times(block, stated, columns, channels, x_columns)


def _with_x_column(names: Sequence[str], body: list[Row]) -> tuple[Sequence[str], list[Row]]:
    """Names and rows with a column of X values, empty where the file has none."""
    if names[0] == "X_Value":
        return names, body
    return ["X_Value", *names], [(i, ["", *cells]) for i, cells in body]


def _with_times(
    block: Block, stated: Header, columns: Sequence[Sequence[str]], channels: Sequence[int], x_columns: str
) -> Segment:
    """Channels with their column of time, where X values are times or the header states a step.

    columns   : cells of all columns of the file, of which `channels` are those of the block
    x_columns : how many columns of times the file has: `No`, `One`, `Multi`
    """
    begin = {k: _seconds(_cell(stated, "Date", k), _cell(stated, "Time", k), block.decimal) for k in channels}
    if _cell(stated, "X_Dimension", 1) not in ("Time", ""):
        return block, None
    if x_columns == "One":
        lines, cells = block.lines, [list(columns[0]), *block.cells]
    elif x_columns == "Multi" or _cell(stated, "Delta_X", 1):
        shift_s = {k: _apart_s(begin[channels[0]], s) for k, s in begin.items()}
        of_channel = _even_times if x_columns == "No" else _times_beside
        lines, cells = _by_time(block, {k: of_channel(block, stated, columns, k, s) for k, s in shift_s.items()})
    else:
        return block, None
    return replace(
        block,
        names=("X_Value", *block.names),
        units=(_cell(stated, "X_Unit_Label", 1) or "s", *block.units),
        cells=tuple(cells),
        lines=lines,
    ), begin[channels[0]]


def _cell(stated: Header, key: str, k: int) -> str:
    """What a header states under a key of column k; empty where it states nothing."""
    return next(iter(stated.get(key, ())[k : k + 1]), "")


def _named_columns(names: Sequence[str], body: Sequence[Row]) -> list[list[str]]:
    """Cells by column: without the comments, and without the columns at the end that have no name."""
    width = len(names) - (names[-1] == "Comment")
    while width > 1 and not names[width - 1]:
        width -= 1
    return [[cells[k] if k < len(cells) else "" for _, cells in body] for k in range(width)]


def _even_times(block: Block, stated: Header, columns: Sequence[Sequence[str]], k: int, shift_s: float) -> list[float]:
    """Times of the rows of a channel that has a first one and a step."""
    x0, step = (_number(block, 0, _cell(stated, key, k) or "0") for key in ("X0", "Delta_X"))
    return [x0 + step * j + shift_s for j in range(len(block.lines))]


def _times_beside(
    block: Block, stated: Header, columns: Sequence[Sequence[str]], k: int, shift_s: float
) -> list[float]:
    """Times of the rows of a channel that has its own column of them; NaN where it has no reading."""
    return [
        shift_s + _number(block, j, cell) if reading else math.nan
        for j, (cell, reading) in enumerate(zip(columns[k - 1], columns[k], strict=True))
    ]


def _by_time(block: Block, times: Mapping[int, Sequence[float]]) -> tuple[tuple[int, ...], list[list[str]]]:
    """Line of each row and cells by column, time first, of channels that are read at different times.

    times : of the rows, by channel, in the order of the block's columns [s]
    """
    readings: dict[float, dict[int, tuple[int, str]]] = {}
    for (k, clock), texts in zip(times.items(), block.cells, strict=True):
        for t, line, cell in zip(clock, block.lines, texts, strict=True):
            if cell:
                readings.setdefault(t, {})[k] = line, cell
    rows = sorted(readings.items())
    lines = tuple(min(row.values())[0] for _, row in rows)
    texts_of = ([row.get(k, (0, ""))[1] for _, row in rows] for k in times)
    return lines, [[_text(x, block.decimal) for x, _ in rows], *texts_of]


def _joined(segments: Sequence[Segment]) -> Block:
    """Segments one below the other, with times counted from the first.

    X values that begin again count from the date and time of their segment, those that go on from those of the first.

    raises : InputError, one line with the option that chooses a segment, where neither fits or the channels differ
    """
    first, begin = segments[0]
    end = last = x_first = math.nan
    blocks: list[Block] = []
    if len(segments) == 1:
        return first
    for block, stamp in segments:
        if not block.lines:
            return block
        where = f"{display_path(block.path)}, row {block.names_line}"
        remedy = f"choose one segment, --sheet 1 to --sheet {len(segments)}"
        if (block.names, block.units) != (first.names, first.units) or block.units[0] != "s":
            raise InputError(f"{where}: a segment begins whose columns or unit of time differ; {remedy}")
        x = [_number(block, j, cell) for j, cell in enumerate(block.cells[0])]
        if not blocks:
            x_first = x[0]
        shift = _shift_s(x[0], last, x[0] - x_first, _apart_s(begin, stamp))
        if shift is None:
            raise InputError(f"{where}: X_Value and the date and time of the segment state different times; {remedy}")
        if x[0] + shift <= end:
            raise InputError(f"{where}: a segment begins before the one above ends; {remedy}")
        end, last = x[-1] + shift, x[-1]
        blocks.append(_shifted(block, x, shift))
    return _stacked(blocks)


def _apart_s(begin: float | None, stamp: float | None) -> float:
    """Time from the date and time of the first segment to those of another [s]; 0 where one has none."""
    return 0.0 if stamp is None or begin is None else stamp - begin


def _shift_s(x: float, last: float, counted: float, apart: float) -> float | None:
    """What is added to the times of a segment [s]; None where they go on and do not fit its date and time.

    x : its first one;  last : of the segment above;  counted, apart : from the first segment, by X and by the dates
    """
    if x <= last:
        return apart
    return None if apart and abs(counted - apart) > CLOCK_JITTER * apart else 0.0


def _shifted(block: Block, x: Sequence[float], shift_s: float) -> Block:
    """A segment whose times, x in numbers [s], are later by a shift."""
    if not shift_s:
        return block
    return replace(block, cells=([_text(t + shift_s, block.decimal) for t in x], *block.cells[1:]))


def _stacked(blocks: Sequence[Block]) -> Block:
    """The rows of blocks of the same columns, one below the other."""
    columns = zip(*(b.cells for b in blocks), strict=True)
    return replace(
        blocks[0],
        cells=tuple([c for cells in column for c in cells] for column in columns),
        lines=tuple(line for b in blocks for line in b.lines),
        about=f"{blocks[0].about}, {len(blocks)} segments",
    )


def _seconds(date: str, time: str, decimal: str) -> float | None:
    """Seconds of a date and time of day, `2023/09/21` and `14:41:45.51`; None where they are none."""
    clock, _, fraction = time.replace(decimal, ".").partition(".")
    try:
        at = datetime.strptime(f"{date} {clock}", "%Y/%m/%d %H:%M:%S")
    except ValueError:
        return None
    return (at - datetime(1904, 1, 1)).total_seconds() + (float(f"0.{fraction}") if fraction.isdigit() else 0.0)


def _number(block: Block, row: int, cell: str) -> float:
    """The number of a cell; InputError with the row where there is none."""
    try:
        return float(cell.replace(block.decimal, "."))
    except ValueError:
        raise InputError(f"{block.at(row, 'X_Value')}: `{shown_cell(cell)}` is not a number; mend it") from None


def _text(x: float, decimal: str) -> str:
    return repr(round(x, 9)).replace(".", decimal)
