"""Columns and units of a CSV file from a data logger or a spreadsheet, recognised by names and values, with the reason
of each guess.

Read are: comma, semicolon, tab and blank separated cells; decimal points and decimal commas; UTF-8 with and without a
byte-order mark, UTF-16 and Windows text; lines before the names; names with units, and units in a line of their own;
time in s, ms, min, h, as hh:mm:ss or as a date; temperatures in K, degC and degF. Cells without a number are lost
samples.
"""

from __future__ import annotations

import csv
import math
import re
import warnings
from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.base.errors import InputError
from sim_heating.base.files import display_path, read_text, suggestion
from sim_heating.base.files.units import converted
from sim_heating.base.report.table import Column, Table
from sim_heating.templates.quantities import NUMBER

TIME, TEMPERATURE, FLUX, UNUSED = "time", "temperature", "heat flux", "not used"
SI_UNITS = {TIME: "s", TEMPERATURE: "K", FLUX: "W/m2"}
HEADS = (
    (TIME, r"(?i)^(time|zeit|elapsed|timestamp|clock|date|datum|seconds?|secs?|minutes?)([^a-z].*)?$"),
    (TIME, r"^t$"),
    (FLUX, r"(?i)flux|lamp|irradian|^q([^a-z].*)?$|heat.?(load|rate|input)"),
    (TEMPERATURE, r"(?i)temp|^tc|thermo|surface|bondline|back.?face|joint|plate|sensor|^ch\d*|channel|pyro|^k\d+$"),
    (TEMPERATURE, r"^T([^a-z].*)?$|^T$|_K$"),
)  # fmt: skip
"""Patterns of the names of columns, without their units; the first that fits holds."""
UNCERTAIN = r"(?i)^(sigma|std|stdev|uncert|unc[^a-z]|error|err[^a-z]|u2?_)|(sigma|uncertainty|stdev|std)$"
"""Pattern of the names of columns that hold the uncertainty of others."""
NAME_AND_UNIT = (
    r"(.*?)\s*[\[(<]\s*([^\])>]*)\s*[\])>]\s*", r"(.*\S)\s*/\s*(\S+)", r"(.*\S)\s*,\s*(\S+)", r"(.+)_([^_]+)",
    r"(.*\S)\s+(\S+)",
)  # fmt: skip
"""Patterns of a name with its unit: in brackets, behind a slash, a comma, `_` or a blank."""
DAYS, CLOCKS = ("%d.%m.%Y", "%m/%d/%Y", "%d/%m/%Y", "%Y/%m/%d"), ("%H:%M:%S.%f", "%H:%M:%S", "%H:%M")
"""Forms of dates and times of day that are read, in addition to ISO 8601."""
DURATIONS = ("s", "ms", "min", "h", "us")
LOST_SHARE = 0.5
"""Share of cells without a number from which a column is no measurement."""
ROOM_K, ROOM_C = (200.0, 450.0), (-60.0, 45.0)
"""First readings that are taken for a room, or a cold day, in K and in degC; those between are taken for degF."""
EXAMPLE = "--time COLUMN"


@dataclass(frozen=True)
class CsvColumn:
    """A column of the file, what it is taken for, and why.

    name   : in the file, without the unit
    kind   : TIME, TEMPERATURE, FLUX or UNUSED
    unit   : of the file, as `degC`
    values : (row,) as in the file, times of day in s; NaN where the cell holds no number
    reason : why it is taken for this kind and unit
    """

    name: str
    kind: str
    unit: str
    values: FloatArray
    reason: str

    @property
    def si(self) -> FloatArray:
        """(row,) values in s, K or W/m2, without the digits that a conversion adds."""
        scale = converted(self.unit, SI_UNITS[self.kind])
        assert scale is not None  # a unit is checked when it is chosen
        if scale == (1.0, 0.0):
            return self.values
        return np.array([float(f"{scale[0] * v + scale[1]:.12g}") for v in self.values])


@dataclass(frozen=True)
class MeasuredCsv:
    """A CSV file whose columns are recognised.

    layout : how the file is written: separator, decimal sign, line of the names
    rows   : (row,) line of each row in the file
    """

    path: Path
    columns: tuple[CsvColumn, ...]
    rows: tuple[int, ...]
    layout: str

    def of_kind(self, kind: str) -> list[CsvColumn]:
        """The columns that are taken for a kind."""
        return [c for c in self.columns if c.kind == kind]

    def table(self) -> Table:
        """How the file was read: column, kind, unit, range in SI units, reason."""
        rows = []
        for c in self.columns:
            values = c.values[np.isfinite(c.values)] if c.kind == UNUSED else c.si[np.isfinite(c.values)]
            unit = SI_UNITS.get(c.kind, "")
            span = f"{values.min():.6g} to {values.max():.6g} {unit}".strip() if values.size else None
            rows.append((c.name, c.kind, c.unit or None, span, c.reason))
        heads = [Column("column"), *(Column(h, is_text=True) for h in ("read as", "unit", "range", "because"))]
        return Table(f"{display_path(self.path)}: {self.layout}", heads, rows)


def read_measured_csv(
    path: Path,
    *,
    time: str | None = None,
    time_unit: str | None = None,
    temperatures: tuple[str, ...] = (),
    temperature_unit: str | None = None,
    flux: str | None = None,
    period_s: float | None = None,
) -> MeasuredCsv:
    """Read a CSV file and recognise its columns; what is given prevails over what is guessed.

    time, temperatures, flux    : names of columns, without or with their units
    time_unit, temperature_unit : units in place of the guessed ones
    period_s                    : time between rows [s], where the file has no time that increases
    raises                      : InputError, one line, where the file cannot be read so, with the option that helps
    """
    text = _decoded(path)
    heads, units, cells, rows, layout = _cells(path, text)
    names, units = _names(heads, units)
    columns = [_column(n, u, list(c)) for n, u, c in zip(names, units, zip(*cells, strict=True), strict=True)]
    columns = _as_chosen(path, columns, time, temperatures, flux)
    columns = _with_time(path, columns, time_unit, period_s, len(rows))
    columns = [_with_unit(path, c, temperature_unit) if c.kind == TEMPERATURE else c for c in columns]
    found = MeasuredCsv(path, tuple(columns), tuple(rows), layout)
    _check_time(found)
    return found


# Text and cells ------------------------------------------------------------------------------------------------------


def _decoded(path: Path) -> str:
    """The text of a file in UTF-8, UTF-16 or the code page of Windows.

    raises : as `read_text`
    """
    try:
        raw = path.read_bytes() if path.is_file() else b""
    except OSError:
        raw = b""
    if raw[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return raw.decode("utf-16", errors="replace")
    try:
        raw.decode("utf-8-sig")
    except UnicodeDecodeError:
        if b"\0" not in raw:  # a spreadsheet of Windows: the degree sign is byte 0xb0
            return raw.decode("cp1252", errors="replace")
    return read_text(path)


def _separator(lines: list[str]) -> str:
    """The separator that gives most lines the same number of cells, two or more; a comma last, as it may be a decimal
    sign."""
    best, most = ",", 0
    for sign in ("\t", ";", ",", " "):
        counts = Counter(len(_split(line, sign)) for line in lines)
        width, often = max(counts.items(), key=lambda item: (item[1], item[0]))
        if width > 1 and often > most and often >= 0.6 * len(lines):
            best, most = sign, often
            if sign in ("\t", ";"):
                break
    return best


def _split(line: str, sign: str) -> list[str]:
    cells = line.split() if sign == " " else next(csv.reader([line], delimiter=sign))
    return [cell.strip() for cell in cells]


def _cells(path: Path, text: str) -> tuple[list[str], list[str], list[list[str]], list[int], str]:
    """Names, units, cells of the rows, their lines, and a line on the layout."""
    file = display_path(path)
    numbered = [(i, line) for i, line in enumerate(text.splitlines(), 1) if line.strip(" \t\r,;")]
    tail = [line for _, line in numbered if not line.startswith("#")][-200:]
    sign = _separator(tail)
    split = [(i, _split(line.lstrip("#") if line.startswith("#") else line, sign)) for i, line in numbered]
    decimal = _decimal(sign, [cells for _, cells in split[-200:]])
    split = [(i, [_with_point(c, decimal) for c in cells]) for i, cells in split]
    width = Counter(len(cells) for _, cells in split).most_common(1)[0][0]
    while split and all(cells[-1] == "" for _, cells in split if len(cells) == width) and width > 1:
        split, width = (
            [(i, c[:-1] if len(c) == width else c) for i, c in split],
            width - 1,
        )  # a separator ends each line
    first = next((k for k, (_, c) in enumerate(split) if len(c) == width and _is_data(c)), None)
    if first is None or width < 1:
        raise InputError(f"{file}: no rows of numbers were found; give a CSV file with a time and temperatures")
    above = [cells for _, cells in split[max(0, first - 2) : first] if len(cells) == width]
    ragged = [i for i, cells in split[first:] if len(cells) != width]
    if ragged:
        raise InputError(f"{file}, row {ragged[0]}: does not have {width} cells as the other rows; mend or remove it")
    if not above:
        heads, units = [f"column{k + 1}" for k in range(width)], [""] * width
    elif len(above) == 2 and all(_is_unit_cell(c) for c in above[1]) and any(c for c in above[1]):
        heads, units = above[0], [c.strip("[]() ") for c in above[1]]
    else:
        heads, units = above[-1], [""] * width
    words = {"\t": "tabs", ";": "semicolons", ",": "commas", " ": "blanks"}[sign]
    named = (
        f"names in line {split[first - 1][0] if units == [''] * width else split[first - 2][0]}"
        if above
        else "no names"
    )
    point = "comma" if decimal == "," else "point"
    layout = f"cells separated by {words}, decimal {point}, {named}, {len(split) - first} rows"
    return heads, units, [cells for _, cells in split[first:]], [i for i, _ in split[first:]], layout


def _decimal(sign: str, rows: list[list[str]]) -> str:
    """The decimal sign: a comma where cells hold one that no separator is, and none a point."""
    cells = [c for row in rows for c in row]
    commas = sum(bool(re.fullmatch(r"[+-]?\d*,\d+(e[+-]?\d+)?", c, re.IGNORECASE)) for c in cells)
    return "," if sign != "," and commas > 0.2 * sum(bool(re.search(r"\d", c)) for c in cells) else "."


def _with_point(cell: str, decimal: str) -> str:
    plain = cell.replace(",", ".") if decimal == "," and re.fullmatch(NUMBER, cell) else cell
    return plain.replace("\u2212", "-")


def _is_data(cells: list[str]) -> bool:
    """Whether cells are those of a row of numbers: one at least, and no more texts than numbers."""
    numbers = sum(not math.isnan(_number(c)) for c in cells)
    return numbers >= 1 and numbers >= sum(bool(c) for c in cells) / 2


def _is_unit_cell(cell: str) -> bool:
    unit = cell.strip("[]() ")
    return not unit or unit in ("-", "1", "hh:mm:ss") or any(converted(unit, si) for si in SI_UNITS.values())


def _names(heads: list[str], units: list[str]) -> tuple[list[str], list[str]]:
    """Names without units and units, each name once."""
    names: list[str] = []
    found: list[str] = []
    for k, (head, unit) in enumerate(zip(heads, units, strict=True)):
        name, own = _name_and_unit(head or f"column{k + 1}")
        names.append(name if name not in names else f"{name} {k + 1}")
        found.append(unit or own)
    return names, found


def _name_and_unit(head: str) -> tuple[str, str]:
    """Name and unit of `TC1 [degC]`, `TC1 (C)`, `Time/s`, `TC1_K`, `Temp, C`; the unit is empty where there is none."""
    for pattern in NAME_AND_UNIT:
        found = re.fullmatch(pattern, head)
        if found and found[1] and any(converted(found[2], si) for si in SI_UNITS.values()):
            return found[1], found[2]
    # `q_add_W_m2` and the like, columns of this program's own files
    own = re.fullmatch(r"(.+)_W_m2", head)
    return (own[1], "W/m2") if own else (head, "")


# Values --------------------------------------------------------------------------------------------------------------


def _number(cell: str) -> float:
    """A number, or a time of day or a date in s; NaN for any other text."""
    if re.fullmatch(rf"{NUMBER}", cell):
        return float(cell.replace(",", "."))
    clock = re.fullmatch(r"(?:(\d+) )?(\d{1,3}):(\d{2})(?::(\d{2}(?:[.,]\d*)?))?", cell)
    if clock:
        days, a, b = int(clock[1] or 0), int(clock[2]), int(clock[3])
        if clock[4] is None:
            return 60.0 * a + b  # mm:ss, as of loggers that run for less than an hour
        return 86400.0 * days + 3600.0 * a + 60.0 * b + float(clock[4].replace(",", "."))
    return _date_s(cell)


def _date_s(cell: str) -> float:
    """A date with a time of day in s; NaN where it is none."""
    if not re.match(r"\d{1,4}[-/.]\d{1,2}[-/.]\d{1,4}[ T]\d", cell):
        return math.nan
    from datetime import datetime

    forms = (f"{day} {clock}" for day in DAYS for clock in CLOCKS)
    for read in (datetime.fromisoformat, *((lambda text, form=form: datetime.strptime(text, form)) for form in forms)):
        try:
            return read(cell).replace(tzinfo=None).timestamp()
        except ValueError:
            continue
    return math.nan


def _column(name: str, unit: str, cells: list[str]) -> CsvColumn:
    """A column with what its name and values say about it."""
    values = np.array([_number(c) for c in cells])
    clock = any(":" in c for c in cells)
    lost = int(np.count_nonzero(np.isnan(values)))
    if lost > LOST_SHARE * len(values):
        return CsvColumn(name, UNUSED, "", values, "most cells hold no number")
    texts = sorted({c for c, v in zip(cells, values, strict=True) if math.isnan(v) and c})[:2]
    note = f"; {lost} lost samples{' (' + ', '.join(texts) + ')' if texts else ''}" if lost else ""
    if clock:
        return CsvColumn(name, TIME, "s", values - np.nanmin(values), "clock times, counted from the first" + note)
    if re.search(UNCERTAIN, name):
        return CsvColumn(name, UNUSED, "", values, "an uncertainty, by its name" + note)
    by_unit = next((kind for kind, si in SI_UNITS.items() if unit and converted(unit, si)), None)
    if by_unit is not None:
        return CsvColumn(name, by_unit, unit, values, f"unit {unit}" + note)
    kind = next((kind for kind, pattern in HEADS if re.search(pattern, name)), UNUSED)
    if kind == UNUSED:
        return CsvColumn(name, UNUSED, "", values, "name and unit say nothing" + note)
    return CsvColumn(name, kind, "", values, f"name `{name}`" + note)


# Choices -------------------------------------------------------------------------------------------------------------


def _named(path: Path, columns: list[CsvColumn], name: str, option: str) -> int:
    """Index of a column that an option names, with or without its unit."""
    for k, column in enumerate(columns):
        if column.name in (name, _name_and_unit(name)[0]):
            return k
    hint = suggestion(name, [c.name for c in columns])
    raise InputError(f"{option} {name}: there is no such column in {display_path(path)}{hint}")


def _as_chosen(
    path: Path, columns: list[CsvColumn], time: str | None, temperatures: tuple[str, ...], flux: str | None
) -> list[CsvColumn]:
    """Columns of the kinds that options state; where temperatures are named, others are not used."""
    chosen = list(columns)
    wanted = [
        (TIME, "--time", time),
        (FLUX, "--lamp", flux),
        *((TEMPERATURE, "--temperature", t) for t in temperatures),
    ]
    if temperatures:
        chosen = [replace(c, kind=UNUSED, reason="not named") if c.kind == TEMPERATURE else c for c in chosen]
    if time is not None:
        chosen = [replace(c, kind=UNUSED, reason="not named") if c.kind == TIME else c for c in chosen]
    for kind, option, name in wanted:
        if name is not None:
            k = _named(path, columns, name, option)
            unit = columns[k].unit if columns[k].unit and converted(columns[k].unit, SI_UNITS[kind]) else ""
            chosen[k] = replace(columns[k], kind=kind, unit=unit, reason=f"{option} {name}")
    return [_flux_unit(c) if c.kind == FLUX and not c.unit else c for c in chosen]


def _flux_unit(column: CsvColumn) -> CsvColumn:
    largest = float(np.nanmax(np.abs(column.values)))
    unit, why = ("W/m2", "above 1000") if largest > 1000.0 else ("kW/m2", "up to 1000")
    return replace(column, unit=unit, reason=f"{column.reason}; no unit, values {why}: {unit}")


def _with_time(
    path: Path, columns: list[CsvColumn], unit: str | None, period_s: float | None, rows: int
) -> list[CsvColumn]:
    """Columns with one time: the named one, else the first that may be it."""
    if period_s is not None:
        others = [replace(c, kind=UNUSED, reason="--period is given") if c.kind == TIME else c for c in columns]
        clock = CsvColumn(
            "time", TIME, "s", np.round(period_s * np.arange(rows), 9), f"--period {period_s:g} s, from row 1"
        )
        return [clock, *others]
    times = [k for k, c in enumerate(columns) if c.kind == TIME]
    reason = ""
    if not times:
        rising = (k for k, c in enumerate(columns) if c.kind == UNUSED and np.all(np.diff(c.values) > 0.0))
        times, reason = (
            [k for k in (next(rising, None),) if k is not None],
            "no column is called time; this one increases",
        )
    if not times:
        raise InputError(f"{display_path(path)}: no column is a time; give {EXAMPLE}, or --period 0.1s between rows")
    at = times[0]
    found = replace(columns[at], kind=TIME, reason=reason or columns[at].reason)
    if unit is not None:
        if converted(unit, "s") is None:
            raise InputError(f"--time-unit {unit}: is not a unit of time; give one of {', '.join(DURATIONS)}")
        _warn_of_other_unit(path, found, unit, "--time-unit")
        found = replace(found, unit=unit, reason=f"{found.reason}; --time-unit")
    elif not found.unit:
        found = replace(found, unit="s", reason=f"{found.reason}; no unit: s assumed")
    others = [
        replace(c, kind=UNUSED, reason=f"`{found.name}` is the time") if k in times else c
        for k, c in enumerate(columns)
    ]
    return [found if k == at else c for k, c in enumerate(others)]


def _warn_of_other_unit(path: Path, column: CsvColumn, unit: str, option: str) -> None:
    """Warn where a column states another unit than the option that prevails over it."""
    si = SI_UNITS[column.kind]
    if column.unit and converted(column.unit, si) != converted(unit, si):
        warnings.warn(
            f"{display_path(path)}, column {column.name}: the file says {column.unit}, {option} says {unit}; read as "
            f"{unit}. Leave {option} out where the file is right",
            stacklevel=2,
        )


def _with_unit(path: Path, column: CsvColumn, unit: str | None) -> CsvColumn:
    """A temperature with its unit: the one given, that of the name, else by its first readings."""
    if unit is not None:
        if converted(unit, "K") is None:
            raise InputError(f"--temperature-unit {unit}: is not a unit of temperature; give K, degC or degF")
        _warn_of_other_unit(path, column, unit, "--temperature-unit")
        return replace(column, unit=unit, reason=f"{column.reason}; --temperature-unit")
    if column.unit:
        return column
    read = column.values[np.isfinite(column.values)]
    start = float(np.median(read[:5]))
    if ROOM_K[0] <= start:
        unit = "K"
    elif ROOM_C[0] <= start <= ROOM_C[1]:
        unit = "degC"
    elif ROOM_C[1] < start < ROOM_K[0]:
        unit = "degF"
    else:
        file = display_path(path)
        raise InputError(
            f"{file}, column {column.name}: begins at {start:g}, in no unit that is known; give --temperature-unit"
        )
    return replace(column, unit=unit, reason=f"{column.reason}; begins at {start:g}: {unit} assumed")


def _check_time(found: MeasuredCsv) -> None:
    """Refuse times that are lost or do not increase.

    raises : InputError with the first such row of the file
    """
    time = found.of_kind(TIME)[0]
    t = time.si
    for bad, rule in (
        (np.flatnonzero(np.isnan(t)), "holds no time; remove the row, or give --period"),
        (np.flatnonzero(~(np.diff(t) > 0.0)) + 1, "does not come after the row above; sort the rows, or give --period"),
    ):
        if bad.size:
            more = f" (and {bad.size - 1} more rows)" if bad.size > 1 else ""
            place = f"{display_path(found.path)}, row {found.rows[bad[0]]}, column {time.name}"
            raise InputError(f"{place}: {rule}{more}")
