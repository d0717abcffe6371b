"""Columns and units of a file from a data logger or a spreadsheet: what the file states is used or refused.

Text, Parquet, Excel and TDMS become rows of cells (`loggers`); here they become a time, temperatures and heat fluxes,
with the reason of each choice. What a file does not state at all, such as a unit, is guessed with a warning where the
readings tell it, and asked for where they do not.
"""

from __future__ import annotations

import math
import re
import warnings
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import combinations, islice
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from sim_heating.base.arrays import FloatArray
from sim_heating.base.errors import InputError
from sim_heating.base.files import COLDEST_K, display_path, plain_number, suggestion
from sim_heating.base.files.csv_table import RUNS_BACK, runs_back
from sim_heating.base.files.text import and_more_rows, listed
from sim_heating.base.files.units import converted, known_unit, name_and_unit
from sim_heating.base.limits import HOTTEST_K, LIMITS
from sim_heating.base.report.table import Column, Table
from sim_heating.heating.recorded.cells import clocks
from sim_heating.heating.recorded.cells import text as cell_text
from sim_heating.heating.recorded.cells.block import Block
from sim_heating.heating.recorded.cells.lists import wide_columns
from sim_heating.heating.recorded.cells.numbers import (
    Numbers,
    Signs,
    number_signs,
    numbers_of,
    require_one_unit,
    shown_cell,
)
from sim_heating.templates.loggers.files import kind_of_file, read_table
from sim_heating.templates.loggers.layout_file import (
    FLUX,
    SI_UNITS,
    TEMPERATURE,
    TIME,
    LayoutColumn,
    LoggerLayout,
    unit_problem,
)
from sim_heating.templates.loggers.lvm import is_lvm, lvm_block
from sim_heating.templates.loggers.readings import OPEN, far_off, fault_codes, lost_codes
from sim_heating.templates.loggers.thermocouples import EXAMPLE as THERMOCOUPLE_EXAMPLE
from sim_heating.templates.loggers.thermocouples import EmfColumn, is_emf, temperatures_K
from sim_heating.templates.quantities import quantity

UNUSED = "not used"
"""Kind of a column that is none of those of a layout."""
SAYS_NOTHING = "name and unit say nothing"
OF_FLOW = "a temperature of the flow"
FEW_NUMBERS, NO_CELLS = "most cells hold no number", "all cells are empty"
UNIT_KEYS = {TIME: "time_unit", TEMPERATURE: "temperature_unit", FLUX: "flux_unit"}
UNIT_OPTIONS = {TIME: "--time-unit s", TEMPERATURE: "--temperature-unit degC", FLUX: "--flux-unit W/m2"}
HEADS = (
    (
        TIME,
        r"(?i)(^|[^a-z])((?:unix)?time(?:s|seconds)?|zeit|uhrzeit|elapsed|timestamp|datetime|clock|date|datum|utc|gmt|tow|epoch)([^a-z]|$)"
        rf"|{cell_text.EAST_ASIAN_TIME}|(?-i:^t$)|^x_value$",
    ),
    (
        TIME,
        r"(?i)^(seconds?|secs?|minutes?|hours?|m?s|msecs?|millis|milliseconds?|us|micros|h|min|sek.*"
        r"|tiempo|tempo|tijd)([^a-z].*)?$",
    ),
    (FLUX, r"(?i)flux|lamp|irradian|^q([^a-z].*)?$|heat.?(load|rate|input)"),
    (
        TEMPERATURE,
        rf"(?i)temp|{cell_text.EAST_ASIAN_TEMPERATURE}|^tc|thermo|surface|bondline|back.?face|joint|plate|sensor|^ch\d*|chan|pyro|^k\d+$",
    ),
    (TEMPERATURE, r"^T([^a-z]{1,2}|[A-Z]{1,2}[\d_].*|[^A-Za-z].*)?$|_K$"),
)
"""Patterns of the names of columns, without their units; the first that fits holds."""
COUNTER = (
    r"(?i)^(#|no\.?|nr\.?|n|num(ber)?|scan|sweep|record|rec|rn|index|idx|sample|row|line|count(er)?|point|id|messung|"
    r"(?:time.?)?step|iter(?:ation)?|alarm.*|lfd.*)( ?(#|no\.?|nr\.?|number))?$"
)
"""Pattern of the names of counters, which are no time, and of alarms."""
CHANNEL = r"(?i)(?:chan(nel)?|ch|kanal|sensor(?=.))[ _]?(#|no\.?|nr\.?|number|id)?"
"""Pattern of the name of a column of numbers of channels."""
NO_READING = r"(?i)alarm|status|flag|valid|quality|batt|volt|humid|^rh|counter"
"""Pattern of the names of columns that accompany readings."""
FREE_STREAM = r"(?i)T_?inf(ty|inity)?|T_?\u221e|(?:free.?stream|static|total)[ _-]?(?:air[ _-]?)?temp(?:erature)?"
"""Pattern of the name of a temperature of the flow, which is no sensor of the wall."""
LOST_WORD = re.compile(r"(?i)#?n/?an?|null|none|ov?l|over\w*|open(?: tc| circuit)?|fault|err(?:or)?|[+-]?inf|-+|\*+")
"""What loggers write in place of a reading that is lost."""
UNCERTAIN = r"(?i)^(sigma|std|stdev|uncert|unc[^a-z]|error|err[^a-z]|u2?_)|(sigma|uncertainty|stdev|std)$"
"""Pattern of the names of columns that hold the uncertainty of others."""
DIFFERENCE = r"(?i)(^|[^a-z])(delta|diff(erence)?|rise|change)([^a-z]|$)|[Δ∆]|^d[Tt]([^a-z].*)?$"
"""Pattern of the names of columns that hold differences of temperatures, which have no zero."""
REDUCED = (
    r"(?i)(?P<stem>.*?)(?:[ _.(-]+|(?<=\d)|(?<=^t))(?P<how>{how})\.?\)?(?P<index>(?:[ _]?[(\[]\d+[)\]])?)",
    r"(?i)(?P<how>{how})\.?(?:[ _-]+(?P<stem>.*?))?(?P<index>)",
)
"""Patterns of names that state how the samples of a channel were reduced, such as `TC1_Avg`, `CH001 Max`."""
AVERAGE, EXTREME = "avg|ave|average|mean|mittel(?:wert)?|smp|sample|last", "min(?:imum)?|max(?:imum)?"
UNIT_COLUMN = r"(?i)(.*[ _.])?(?:units?|einheit)"
"""Pattern of the name of a column of units; `Ch1_Unit` is that of `Ch1_Value`."""
FACTOR = r"(?i)(.*?) ?([x*\u00d7] ?10+)"
"""Pattern of a name that ends in the factor of its numbers, which is a part of its unit."""
REMARK = r"(?i)utc.*|gmt.*|z|[a-z]{2,4}t|local.*|[dhmsy:/ .,\-]{4,}(ms|am/pm)?|ts|rn|avg|smp|min|max|last|ave\.?"
"""What stands in brackets and is no unit: time zones, layouts of clocks, how samples were reduced."""
RAW = (
    r"(?i)(.+?)[_ ]([muµ]v|volts?|[mk]?ohms?|ma|counts?|cts|raw|adc|bits?|deg|[hkm]?pa|m?bara?|psia?|torr)",
    r"(?i)(.*(?:lamp|flux).*?)[_ ]([km]?w|v|a|%|percent)",
)
"""Patterns of names that end in the unit of a signal, of a pressure, or of a lamp's supply, which is no temperature."""
ROOM_K, ROOM_C = (278.15, 313.15), (5.0, 40.0)
"""First readings that are taken for those of a room, in K and in degC, where no unit is stated."""
UNIX_S, LABVIEW_S = (9.4e8, 2.9e9), (3.0e9, 4.3e9)
"""Times from 2000 on in seconds since 1970, in ms, us and ns by their sizes; in seconds since 1904, as of LabVIEW."""
FROM_1904_S = 2082844800.0
"""From the beginning of 1904 to that of 1970."""
DAY_NUMBERS = (36526.0, 73050.0)
"""Days of a spreadsheet, 2000 to 2099."""
SHORTEST_STEP_S = 1e-3
EXAMPLE = "--time COLUMN"
DIGITS, TINY = 12, 1e-300
"""Digits of a converted number; the least magnitude that is not taken for 0."""
SHOWN_ROWS = 5
PROBED_CELLS = 200
"""Cells at each end of a column by which it is found what it holds."""
NAMED_ROWS = 5
"""Rows that a message about several readings names."""


@dataclass(frozen=True)
class CsvColumn:
    """A column of the file, what it is taken for, and why.

    name   : in the file, without the unit
    kind   : TIME, TEMPERATURE, FLUX or UNUSED
    unit   : of the file, as `degC`
    values : (row,) as in the file, times of day in s; NaN where the cell holds no number
    reason : why it is taken for this kind and unit
    guess  : what is assumed without a word of the file, for a warning; empty where nothing is
    declared : what the layout of the recorder declares of it; None where it declares nothing
    """

    name: str
    kind: str
    unit: str
    values: FloatArray
    reason: str
    guess: str = ""
    declared: LayoutColumn | None = None

    @cached_property
    def si(self) -> FloatArray:
        """(row,) values in s, K or W/m2, without the digits that a conversion adds."""
        scale = converted(self.unit, SI_UNITS[self.kind])
        assert scale is not None  # a unit is checked when it is chosen
        if scale == (1.0, 0.0):
            return self.values
        values = scale.factor * self.values + scale.offset
        # tens are exact in this range: the quotient is the number nearest to the one with twelve digits
        magnitude = np.floor(np.log10(np.maximum(np.abs(values), TINY)))
        tens = 10.0 ** np.clip(DIGITS - 1.0 - magnitude, 0.0, 22.0)
        return np.rint(values * tens) / tens


@dataclass(frozen=True)
class MeasuredCsv:
    """A file whose columns are recognised.

    layout : how the file is written: separator, decimal sign, line of the names
    rows   : (row,) line of each row in the file
    zero_s : instant of time 0 [s], None where the file does not state it
    zero   : since when that counts: `1970`, or `midnight` for a clock without a date; empty for a time in numbers
    stated : the layout as it was read, to be kept for other files of the recorder
    notes  : what was left out, in words
    """

    path: Path
    columns: tuple[CsvColumn, ...]
    rows: tuple[int, ...]
    layout: str
    zero_s: float | None = None
    zero: str = ""
    stated: LoggerLayout = field(default_factory=LoggerLayout)
    notes: tuple[str, ...] = ()

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

    def first_rows(self) -> Table:
        """The first rows as they were read, in SI units, by the line of the file."""
        used = [c for kind in SI_UNITS for c in self.of_kind(kind)]
        heads = [Column("row"), *(Column(f"{c.name} [{SI_UNITS[c.kind]}]", format=".6g") for c in used)]
        shown = [(str(self.rows[i]), *(float(c.si[i]) for c in used)) for i in range(min(SHOWN_ROWS, len(self.rows)))]
        return Table("First rows as read", heads, shown)

    def name_of(self, text: str) -> str:
        """The name of the column that a text names with its unit, `TC1` for `TC1 (C)`; another text as it is."""
        k = _index_of(self.columns, text)
        return text if k is None else self.columns[k].name

    def line(self, row: int) -> str:
        """`file, row 14`, the row as an editor counts it."""
        return f"{display_path(self.path)}, row {self.rows[row]}"


@dataclass(frozen=True)
class _Head:
    """Name, unit and cells of a column before it is known what it holds.

    stated : unit in the file, known or not; empty where there is none
    emf    : what the readings were converted from, `mV of type K`; empty where they are as in the file
    """

    name: str
    stated: str
    numbers: Numbers
    clock: clocks.Clock | None
    cells: list[str]
    emf: str = ""

    @property
    def unit(self) -> str:
        """Unit that is stated, else that of the cells."""
        is_remark = re.fullmatch(REMARK, self.stated.strip()) is not None  # `Avg` says how a sample was reduced
        return (self.numbers.unit if is_remark else self.stated) or self.numbers.unit or self.stated


def read_measured_csv(
    path: Path,
    *,
    time: str | None = None,
    time_unit: str | None = None,
    temperatures: tuple[str, ...] = (),
    temperature_unit: str | None = None,
    flux: str | None = None,
    flux_unit: str | None = None,
    thermocouple: str | None = None,
    reference_junction: str | None = None,
    period_s: float | None = None,
    separator: str | None = None,
    decimal: str | None = None,
    dates: str | None = None,
    lost: Sequence[float] = (),
    repeated: str | None = None,
    sheet: str | None = None,
    layout: LoggerLayout | None = None,
    kinds: Sequence[str] = (TEMPERATURE, FLUX),
) -> MeasuredCsv:
    """Read a file and recognise its columns; what is given prevails over what is guessed.

    time, temperatures : names of columns, without or with their units
    flux      : what states the flux of a lamp; where it names a column, that is a heat flux
    time_unit, temperature_unit, flux_unit : units in place of the guessed ones; `hh:mm` or `mm:ss` for a clock
    thermocouple : type, `K`, whose emf the file holds; columns in mV or V are then temperatures
    reference_junction : temperature of its terminals with its unit, or the name of a column of it
    period_s  : time between rows [s], where the file has no time that increases
    separator, decimal, dates : between cells; decimal sign; order of dates, `day-first`, `month-first`, `year-first`
    lost      : readings that stand for a lost sample
    repeated  : `spread` or `first`: what is done with several rows of one time
    sheet     : of a workbook, group of a TDMS file, or segment of an LVM file by its number
    layout    : what other files of the recorder had in common; the arguments prevail over it
    kinds     : kinds of columns that are needed beside the time; those of others are not checked
    raises    : InputError, one line, where the file cannot be read so, with the option that helps
    """
    base = layout or LoggerLayout()
    stated: dict[str, object] = {
        "time": time,
        "time_unit": time_unit,
        "temperature_unit": temperature_unit,
        "flux_unit": flux_unit,
        "thermocouple": thermocouple,
        "reference_junction": reference_junction,
        "period_s": period_s,
        "separator": separator,
        "decimal": decimal,
        "dates": dates,
        "repeated": repeated,
        "sheet": sheet,
        "lost": [*base.lost, *lost] or None,
    }
    chosen = base.with_options(stated)
    if time_unit is not None and (problem := unit_problem(time_unit, TIME)):
        raise InputError(f"{chosen.place('time_unit')}: {problem}")
    block = _long_as_wide(_with_unit_column(_block(path, chosen)))
    heads, signs = _heads(block, chosen)
    heads = _joined_dates(heads)
    heads, junction = _emf_as_temperature(block, heads, chosen)
    columns = _without_extremes(_unused([_column(h) for h in heads], {junction}, "reference junction"))
    columns = _as_declared(path, columns, base)
    columns = _as_chosen(path, columns, chosen, temperatures, flux)
    if TEMPERATURE in kinds and not (*temperatures, *base.column):
        _require_one_reading(path, columns)
    columns, zero_s, notes = _timed(block, heads, columns, chosen)
    columns = _readings(block, columns, heads, chosen, kinds)
    if not base.column:
        _tell_of_one_name(block, columns, kinds, are_named=bool(temperatures))
    columns, rows, row_notes = _rows_kept(block, columns, kinds)
    measured = MeasuredCsv(
        path,
        tuple(columns),
        rows,
        f"{block.about}, {signs.words}, {_names_in_words(block)}, {len(rows)} rows",
        zero_s,
        _zero_of(columns[0]),
        _stated(chosen, block, signs, columns, heads),
        (*block.notes, *notes, *row_notes),
    )
    measured = _with_distinct_times(measured, chosen)
    _warn_of_guesses(measured, kinds)
    if TEMPERATURE in kinds:
        _warn_of_silent_sensors(measured)
        _name_far_off(measured)
    return measured


def _timed(
    block: Block, heads: list[_Head], columns: list[CsvColumn], chosen: LoggerLayout
) -> tuple[list[CsvColumn], float | None, list[str]]:
    """Columns of which the first one is the time and no other, the instant of its zero, and notes.

    raises : InputError where no column is a time, or the one that is called so is not read
    """
    if chosen.period_s is None:
        clock, zero_s, notes = _time(block, heads, columns, chosen)
    else:
        clock, zero_s, notes = _counted_time(block, chosen, chosen.period_s), None, []
    others = [c for c in columns if c.name != clock.name]
    others = _unused(others, {c.name for c in others if c.kind == TIME}, "another column is the time")
    return [clock, *others], zero_s, notes


def _names_in_words(block: Block) -> str:
    return f"names in line {block.names_line}" if block.has_names else "no names"


def _zero_of(clock: CsvColumn) -> str:
    """Since when a time counts, `1970` or `midnight`; empty for a time in numbers."""
    if "counted from" not in clock.reason:
        return ""
    return "midnight" if clock.reason.startswith("clock") else "1970"


def _tell_of_one_name(block: Block, columns: Sequence[CsvColumn], kinds: Sequence[str], *, are_named: bool) -> None:
    """Warn of columns that have one name in the file, of which at least one is read.

    are_named : whether a person names the temperatures that are read
    raises    : InputError where two of them hold the same readings, and nobody names one
    """
    names, bare = _names_and_units(block)[0], _bare_names_and_units(block)[0]
    read = {c.name: c for c in columns if c.kind in kinds}
    for name in Counter(bare) - Counter(set(bare)):
        called = {k: n for k, (n, other) in enumerate(zip(names, bare, strict=True), 1) if other == name}
        used = [read[n] for n in called.values() if n in read]
        where = f"{display_path(block.path)}: columns {listed(list(map(str, called)))} are named `{name}`"
        if not are_named:
            _require_no_twins(where, used, list(read.values()))
        _warn_of_one_name(where, list(called.values()), used)


def _warn_of_one_name(where: str, names: Sequence[str], used: Sequence[CsvColumn]) -> None:
    """Warn of columns of one name; names : by which they are told apart here;  used : those that are read, if any."""
    if not used:
        return
    count = f"read as {len(used)} sensors" if len(used) > 1 else f"`{used[0].name}` is read"
    warnings.warn(f"{where}: {listed([f'`{name}`' for name in names])} here, {count}", stacklevel=4)


def _require_no_twins(where: str, used: Sequence[CsvColumn], read: Sequence[CsvColumn]) -> None:
    """Refuse two columns of one name that hold the same readings.

    where : the file and the columns of one name, in words;  read : all columns that are read
    """
    twins = next(((a, b) for a, b in combinations(used, 2) if _read_alike(a, b)), None)
    if twins is None:
        return
    others = [c.name for c in read if c.kind == TEMPERATURE and c is not twins[1]]
    options = " ".join(f'--temperature "{name}"' if " " in name else f"--temperature {name}" for name in others)
    rule = f"and {twins[0].name} and {twins[1].name} hold the same readings"
    raise InputError(f"{where}, {rule}; a sensor would count twice: name those that are read, {options}")


def _read_alike(a: CsvColumn, b: CsvColumn) -> bool:
    """Whether two columns have the same readings in SI units: to the rounding of their numbers where these are in other
    units or of other digits."""
    both = np.isfinite(a.values) & np.isfinite(b.values)
    if a.kind != b.kind or not np.any(both) or np.any(np.isfinite(a.values) != np.isfinite(b.values)):
        return False
    steps = [_rounding(c) for c in (a, b)]
    tolerance = 0.0 if a.unit == b.unit and steps[0] == steps[1] else 0.5 * sum(steps)
    return bool(np.max(np.abs(a.si[both] - b.si[both])) <= tolerance * (1.0 + 1e-6))


def _rounding(column: CsvColumn) -> float:
    """Step of the numbers of a column as they are written, in SI units."""
    scale, values = converted(column.unit, SI_UNITS[column.kind]), column.values[np.isfinite(column.values)]
    assert scale is not None  # of a column with readings
    digits = next((d for d in range(DIGITS) if np.allclose(np.round(values, d), values, rtol=1e-12, atol=0.0)), DIGITS)
    return float(abs(scale.factor) * 10.0**-digits)


def _unused(columns: Sequence[CsvColumn], names: Collection[str], reason: str) -> list[CsvColumn]:
    """Columns of which those of some names are not used."""
    return [replace(c, kind=UNUSED, reason=reason) if c.name in names else c for c in columns]


def _readings(
    block: Block,
    columns: list[CsvColumn],
    heads: Sequence[_Head],
    chosen: LoggerLayout,
    kinds: Sequence[str],
) -> list[CsvColumn]:
    """Columns with units, and without lost samples, of the kinds that are needed."""
    by_name = {h.name: h for h in heads}
    columns = [_with_unit(block, c, by_name[c.name], chosen) if c.kind in kinds else c for c in columns]
    columns = _guessed(block, _without_counters(columns), kinds)
    emfs = {h.name for h in heads if h.emf}  # without lost codes already; a time made of a period is no column
    lost = {c.name: () if c.name in emfs else chosen.lost for c in columns}
    return [_without_lost(block, c, lost[c.name]) if c.kind in kinds else c for c in columns]


def _block(path: Path, chosen: LoggerLayout) -> Block:
    """The rows of data of a file of any kind."""
    kind = kind_of_file(path)
    if not kind:
        text = cell_text.decoded(path)
        return lvm_block(path, text, chosen) if is_lvm(text) else cell_text.text_block(path, text, chosen.separator)
    table = read_table(path, kind, chosen)
    if isinstance(table, Block):
        return table
    rows = [(i, cells) for i, cells in enumerate(table, 1) if any(cells)]
    if not rows:
        raise InputError(f"{display_path(path)}: the sheet has no cells")
    return replace(cell_text.rows_block(path, rows, "", recorder="Excel"), decimal=".")


def _with_unit_column(block: Block) -> Block:
    """A table whose units stand in a column of their own, or in one behind each reading, as one with units of its
    columns.

    raises : InputError where such a column holds several units
    """
    called = {k: m[1] or "" for k, n in enumerate(block.names) if (m := re.fullmatch(UNIT_COLUMN, n.strip()))}
    stated = list(block.units)
    for k, stem in called.items():
        unit = _unit_in_cells(block, k)
        readings = _called_alike(block.names, k, stem)
        if not readings:
            readings = [k - 1] if len(called) > 1 else _without_unit(block, unit)
        for j in readings:
            stated[j] = stated[j] or unit
    return replace(block, units=tuple(stated))


def _called_alike(names: Sequence[str], k: int, stem: str) -> list[int]:
    """The first column but k whose name begins with a stem; none for an empty stem."""
    return [j for j, name in enumerate(names) if stem and j != k and name.strip().startswith(stem)][:1]


def _without_unit(block: Block, unit: str) -> list[int]:
    """Columns of readings whose names state no unit; none where the unit is not of temperatures."""
    return [j for j, name in enumerate(block.names) if converted(unit, "K") and _lacks_unit(name)]


def _unit_in_cells(block: Block, k: int) -> str:
    """The unit that all cells of a column are; empty where they are none, or several of which none is a temperature.

    raises : InputError where they are several
    """
    units = list(dict.fromkeys(c for c in block.column(k) if c))
    if len(units) > 1 and any(converted(u, "K") for u in units):
        i = block.column(k).index(units[1])
        raise InputError(
            f"{block.at(i, block.names[k])}: `{units[1]}` is another unit than `{units[0]}`; write one unit"
        )
    return units[0] if len(units) == 1 else ""


def _lacks_unit(name: str) -> bool:
    """Whether a column is one of readings by its name, which states no unit."""
    readings = rf"{HEADS[3][1]}|{HEADS[4][1]}|[Vv]alue|[Rr]eading"
    if re.fullmatch(COUNTER, name) or re.fullmatch(CHANNEL, name):
        return False
    return not name_and_unit(name, list(SI_UNITS.values()))[1] and re.search(readings, name) is not None


def _long_as_wide(block: Block) -> Block:
    """A table with one row a sensor as one with a column a sensor; another one as it is.

    raises : InputError where a sensor has two readings at one time
    """
    columns = _columns_of_a_long_table(block)
    if columns is None:
        return block
    times, label, value = columns
    stamps = list(zip(*(block.column(k) for k in times), strict=True))
    if len(set(stamps)) == len(stamps):
        return block
    readings = zip(block.lines, stamps, block.column(label), block.column(value), strict=True)
    sensors, columns_of_sensors, lines = wide_columns(block.path, readings)
    _, unit = name_and_unit(block.names[value], list(SI_UNITS.values()))
    names = [f"{s} [{unit}]" for s in sensors] if unit else sensors
    columns_of_time = map(list, zip(*dict.fromkeys(stamps), strict=True))
    return replace(
        block,
        names=(*(block.names[k] for k in times), *names),
        units=(*(block.units[k] for k in times), *[block.units[value]] * len(sensors)),
        cells=(*columns_of_time, *columns_of_sensors),
        lines=lines,
        about=f"{block.about}, one row a sensor",
    )


def _columns_of_a_long_table(block: Block) -> tuple[list[int], int, int] | None:
    """Columns of the time, of the names of sensors, and of their readings; None where these are not one each."""
    times, labels, numbers = [], [], []
    for k, name in enumerate(block.names):
        holds = _cells_hold(name, block.column(k)[:200])
        if holds == "text":
            labels += [k] if _may_name_sensors(block, k) else []
        elif holds == "clock" or _is_called_time(name):
            times.append(k)
        elif holds == "number" and not re.fullmatch(COUNTER, name):
            numbers.append(k)
    numbers = _called_readings(block, numbers)
    return (times, labels[0], numbers[0]) if len(labels) == len(numbers) == 1 and times else None


def _called_readings(block: Block, columns: list[int]) -> list[int]:
    """Columns that are called so; all where none is: beside a reading may stand the number of its table."""
    return [k for k in columns if re.fullmatch(r"(?i)_?(values?|readings?)", _bare(block.names[k]))] or columns


def _cells_hold(name: str, cells: Sequence[str]) -> str:
    """What cells of a column hold: `clock`, `number`, `text` (numbers of channels as well), or nothing."""
    if any(map(cell_text.is_clock, cells)):
        return "clock"
    if any(map(cell_text.is_number, cells)):
        return "text" if re.fullmatch(CHANNEL, name) else "number"
    return "text" if any(cells) else ""


def _may_name_sensors(block: Block, k: int) -> bool:
    words = r"(?i)sensor|channel|name|id|probe|series|field|metric|tc|thermo|point|location|signal|variable|tag"
    names = set(block.column(k))
    may_be_one = not block.has_names or re.search(words, block.names[k]) is not None
    return may_be_one and 2 <= len(names) <= max(2, len(block.lines) // 3)


def _bare(name: str) -> str:
    return name_and_unit(name, list(SI_UNITS.values()))[0]


# Heads and cells -----------------------------------------------------------------------------------------------------


def _heads(block: Block, chosen: LoggerLayout) -> tuple[list[_Head], Signs]:
    """Names, units and cells of the columns, by one layout of numbers for the file."""
    names, stated = _names_and_units(block)
    if (layout := chosen.time_unit) in clocks.CLOCKS:
        times = {*filter(_is_called_time, names), chosen.time}
        as_clock = [clocks.with_colons(c, layout) if n in times else c for n, c in zip(names, block.cells, strict=True)]
        block = replace(block, cells=tuple(as_clock))
    of_clocks = {k for k in range(len(names)) if _mostly(block.column(k), cell_text.is_clock)}
    signs = number_signs(block, sorted({*range(len(names))} - of_clocks), chosen.decimal)
    heads = []
    for k, (name, unit) in enumerate(zip(names, stated, strict=True)):
        cells = block.column(k)
        may_be_clock = k in of_clocks or (_is_called_time(name) and _mostly(cells, _is_all_digits))
        clock = _clock_of_column(block, k, names, unit, chosen) if may_be_clock else None
        head = _Head(name, unit, numbers_of(cells, signs), clock, cells)
        require_one_unit(block, k, head.numbers, unit, list(SI_UNITS.values()))
        heads.append(head)
    return heads, signs


def _names_and_units(block: Block) -> tuple[list[str], list[str]]:
    """Name of each column, no two alike, and the unit that the row of units or the name states."""
    names: list[str] = []
    bare, stated = _bare_names_and_units(block)
    for k, name in enumerate(bare):
        names.append(name if name not in names else f"{name} {k + 1}")
    return names, stated


def _bare_names_and_units(block: Block) -> tuple[list[str], list[str]]:
    """Name of each column as the file has it, without its unit, and the unit of the row of units or of the name."""
    split = [_split_name(head or f"column{k + 1}") for k, head in enumerate(block.names)]
    stated = [unit.strip("-") or in_name for unit, (_, in_name) in zip(block.units, split, strict=True)]
    return [name for name, _ in split], stated


def _split_name(head: str) -> tuple[str, str]:
    """The name of a column without its unit, and the unit that the name states; empty where it states none."""
    name, unit = name_and_unit(head, list(SI_UNITS.values()))
    may_be_index = not re.search(r"[\[(<,/]", head) and not _is_called_time(name)
    if unit and may_be_index and converted(unit, "s"):
        name, unit = head, ""  # T_s is a surface, and no time
    if not unit and (raw := next(filter(None, (re.fullmatch(p, name) for p in RAW)), None)):
        name, unit = raw[1], raw[2]
    if factor := re.fullmatch(FACTOR, name):
        name, unit = factor[1], f"{unit} {factor[2]}".strip()
    return name, unit


def _is_called_time(name: str) -> bool:
    """Whether a column is one of times by its name."""
    return re.search(HEADS[0][1], name) is not None


def _clock_of_column(
    block: Block, k: int, names: Sequence[str], unit: str, chosen: LoggerLayout
) -> clocks.Clock | None:
    """Times of a column of clocks; None where another one is the time.

    raises : InputError where its layout is not clear, and it is the time
    """
    name, its_names = names[k], (names[k], block.names[k])
    is_another = chosen.time not in (None, *its_names)
    if chosen.period_s is not None or (is_another and not _is_partner(name)):
        return None
    try:
        location = f"{display_path(block.path)}, column {name}"
        layout = _clock_word(unit) or chosen.time_unit
        return clocks.clock_of(block.column(k), location, chosen.dates, layout, chosen.option("dates"))
    except InputError:
        is_called = _is_called_time(name) or not any(map(_is_called_time, names))
        if not is_another and (chosen.time is not None or is_called):
            raise
        return None  # another column is the time


def _is_partner(name: str) -> bool:
    return re.search(rf"(?i)date|datum|time|zeit|{cell_text.EAST_ASIAN_TIME}", name) is not None


def _is_all_digits(cell: str) -> bool:
    return re.fullmatch(r"(?:19|20)\d{12}", cell) is not None


def _clock_word(unit: str) -> str | None:
    """The layout of a clock that a head states, as `hh:mm`."""
    text = unit.strip().lower()
    return text if text in clocks.CLOCKS else None


def _mostly(cells: Sequence[str], holds: object) -> bool:
    few = len(cells) <= 2 * PROBED_CELLS
    ends = (cells,) if few else (cells, reversed(cells))
    probe = [cell for end in ends for cell in islice(filter(None, end), None if few else PROBED_CELLS)]
    if not callable(holds) or not probe:
        return False
    return sum(bool(holds(c)) for c in probe) > 0.5 * len(probe)


def _joined_dates(heads: list[_Head]) -> list[_Head]:
    """Columns in which a date and a time of day of the same rows are one clock, with its milliseconds."""
    return _with_milliseconds(_with_date(heads))


def _with_date(heads: list[_Head]) -> list[_Head]:
    timed = [(h, h.clock) for h in heads if h.clock is not None]
    days = [(h, c) for h, c in timed if c.day_s is not None and not c.has_time]
    hours = [(h, c) for h, c in timed if c.day_s is None]
    if not (days and hours):
        return heads
    (of_day, day), (of_time, time) = days[0], hours[0]
    clock = clocks.Clock(day.seconds + time.seconds, day.day_s, True, f"{day.layout} in `{of_day.name}`, {time.layout}")
    return _with_clocks(heads, {of_time.name: clock, of_day.name: None})


def _with_clocks(heads: list[_Head], others: Mapping[str, clocks.Clock | None]) -> list[_Head]:
    """Columns of which some have other clocks; others : by the names of the columns, of which no two are alike."""
    return [replace(h, clock=others.get(h.name, h.clock)) for h in heads]


def _with_milliseconds(heads: list[_Head]) -> list[_Head]:
    called = [h for h in heads if h.name.lower() in ("ms", "msec", "millisecond", "milliseconds")]
    timed, clock = next(((h.name, h.clock) for h in heads if h.clock is not None and h.clock.has_time), ("", None))
    if not called or clock is None:
        return heads
    ms = called[0]
    part_s = ms.numbers.values / 1e3
    if not (_are_repeated_seconds(clock.seconds) and np.all((part_s >= 0.0) & (part_s < 1.0))):
        return heads
    finer = replace(clock, seconds=clock.seconds + part_s, layout=f"{clock.layout}, ms in `{ms.name}`")
    return _with_clocks(heads, {timed: finer})


def _are_repeated_seconds(seconds: FloatArray) -> bool:
    """Whether times are whole seconds of which some stand in several rows."""
    return bool(np.all(np.mod(seconds, 1.0) == 0.0) and np.any(np.diff(seconds) == 0.0))


def _column(head: _Head) -> CsvColumn:
    """A column with what its name, its unit and its cells say about it."""
    name, values = head.name, head.numbers.values
    if head.clock is not None:
        return CsvColumn(name, TIME, "s", head.clock.seconds, head.clock.layout)
    if empty := _reason_of_few_numbers(head):
        return CsvColumn(name, UNUSED, "", values, empty)
    kind, unit, reason = _kind_of(head)
    lost = len(values) - int(np.count_nonzero(np.isfinite(values)))
    texts = ", ".join(sorted(head.numbers.texts)[:2])
    note = f"; {lost} lost samples{f' ({texts})' if texts else ''}" if lost else ""
    return CsvColumn(name, kind, unit, values, reason + note)


def _kind_of(head: _Head) -> tuple[str, str, str]:
    """Kind of a column, its unit where the kind follows from it, and why."""
    name, unit = head.name, head.unit
    by_unit, by_name = _kind_by_unit(unit), _kind_by_name(name)
    if other := _other_quantity(head, by_unit):
        return UNUSED, unit if other == OF_FLOW else "", f"{other}, by its name"
    may_be_a_minimum = (by_unit, by_name) == (TIME, TEMPERATURE) and unit.strip().lower() == "min"
    if by_unit != UNUSED and not may_be_a_minimum:
        return by_unit, unit, head.emf or f"unit {unit}"
    return _kind_without_unit(name, unit, by_name)


def _kind_without_unit(name: str, unit: str, by_name: str) -> tuple[str, str, str]:
    """Kind of a column whose unit is none of a kind, no unit, and why."""
    if unit and (converted(unit, "Pa") or (by_name == FLUX and known_unit(unit))):
        return UNUSED, "", f"unit {unit}, of another quantity"
    if by_name == UNUSED:
        return UNUSED, "", SAYS_NOTHING
    if by_name != TIME and re.search(NO_READING, name):
        return UNUSED, "", "accompanies readings, by its name"
    return by_name, "", f"name `{name}`"


def _other_quantity(head: _Head, by_unit: str) -> str:
    """What a column holds by its name where that is neither a time nor a reading; empty where it may be one."""
    for pattern, meaning in ((UNCERTAIN, "an uncertainty"), (DIFFERENCE, "a difference")):
        if re.search(pattern, head.name):
            return meaning
    if re.fullmatch(FREE_STREAM, head.name):
        return OF_FLOW
    if re.fullmatch(COUNTER, head.name) and by_unit not in (TEMPERATURE, FLUX):
        return "a counter"
    is_called = re.fullmatch(CHANNEL, head.name) and by_unit == UNUSED
    return "numbers of channels" if is_called and _are_channels(head.numbers.values) else ""


def _channel(column: CsvColumn) -> tuple[str, bool]:
    """Name of the channel of a column, and whether the column is its minimum or maximum."""
    for how in (EXTREME, AVERAGE):
        for pattern in REDUCED:
            if match := re.fullmatch(pattern.format(how=how), column.name):
                return (match["stem"] or "") + match["index"], how == EXTREME
    return column.name, False


def _without_extremes(columns: Sequence[CsvColumn]) -> list[CsvColumn]:
    """Columns without the minimum and the maximum of a channel of which one column is the reading, or its average."""
    channels = {c.name: _channel(c) for c in columns}
    read = Counter((c.kind, channels[c.name][0]) for c in columns if not channels[c.name][1])
    return [
        replace(c, kind=UNUSED, reason=f"an extreme of {channels[c.name][0]}, of which another column is the reading")
        if channels[c.name][1] and c.kind in (TEMPERATURE, FLUX) and read[c.kind, channels[c.name][0]] == 1
        else c
        for c in columns
    ]


def _require_one_reading(path: Path, columns: Sequence[CsvColumn]) -> None:
    """Refuse several temperatures of one channel, such as its minimum and its maximum.

    raises : InputError with the option that names one
    """
    channels: dict[str, list[CsvColumn]] = {}
    for column in columns:
        channel, is_extreme = _channel(column)
        if column.kind == TEMPERATURE or (is_extreme and column.reason == SAYS_NOTHING):
            channels.setdefault(channel, []).append(column)
    for readings in channels.values():
        if len(readings) > 1 and any(c.kind == TEMPERATURE for c in readings):
            rule = "are readings of one channel; name the column of each channel that is read, --temperature"
            names = [c.name for c in readings]
            raise InputError(f'{display_path(path)}: {", ".join(names)} {rule} "{names[-1]}"')


def _are_channels(values: FloatArray) -> bool:
    """Whether numbers are whole, and few different ones, as those of channels are."""
    return bool(np.all(values % 1.0 == 0.0)) and len(np.unique(values)) <= max(1, len(values) // 3)


def _kind_by_unit(unit: str) -> str:
    return next((kind for kind, si in SI_UNITS.items() if unit and converted(unit, si)), UNUSED)


def _kind_by_name(name: str) -> str:
    return next((kind for kind, pattern in HEADS if re.search(pattern, name)), UNUSED)


def _reason_of_few_numbers(head: _Head) -> str:
    """Why a column is not read, where most of its cells hold no number; empty for others, and for a time."""
    count = int(np.count_nonzero(np.isfinite(head.numbers.values)))
    full = len(head.cells) - head.cells.count("")
    named = {kind for kind, pattern in HEADS if re.search(pattern, head.name)}
    is_burnt_out = count and all(map(LOST_WORD.fullmatch, head.numbers.texts))
    if 2 * count >= max(full, 1) or TIME in named or (named and (is_burnt_out or head.numbers.torn >= 0)):
        return ""
    return FEW_NUMBERS if full else NO_CELLS


def _emf_as_temperature(block: Block, heads: list[_Head], chosen: LoggerLayout) -> tuple[list[_Head], str]:
    """Columns of a thermocouple's emf as temperatures [K], and the name of the column of its reference junction.

    raises : InputError where one of the options lacks the other, or no column is an emf
    """
    letter, junction = chosen.thermocouple, chosen.reference_junction
    if letter is None:
        if junction is not None:
            raise InputError(
                f"{chosen.place('reference_junction')}: needs the type of the thermocouple; add --thermocouple K"
            )
        return heads, ""
    if junction is None:
        rule = "needs the temperature of the terminals, or its column; add --reference-junction 25degC"
        raise InputError(f"{chosen.place('thermocouple')}: {rule}")
    file = display_path(block.path)
    reference_K, column = _reference_junction_K(block, heads, junction, chosen)
    converted_heads = []
    for head in heads:
        unit = head.unit
        if head.name != column and is_emf(unit) and not re.search(NO_READING, head.name):
            read = _without_codes(block, CsvColumn(head.name, TEMPERATURE, unit, head.numbers.values, ""), chosen.lost)
            emf = EmfColumn(f"{file}, column {head.name}", unit, read.values, block.lines)
            T_K = temperatures_K(letter, emf, reference_K, chosen.option("reference_junction"))
            numbers = replace(head.numbers, values=T_K, unit="")
            head = replace(head, stated="K", numbers=numbers, emf=f"{unit} of type {letter}")
        converted_heads.append(head)
    if all(new is old for new, old in zip(converted_heads, heads, strict=True)):
        raise InputError(
            f"{chosen.place('thermocouple')}: no column of {file} states a voltage, such as `TC1 (mV)`; leave it out"
        )
    return converted_heads, column


def _reference_junction_K(
    block: Block, heads: Sequence[_Head], junction: str, chosen: LoggerLayout
) -> tuple[FloatArray | float, str]:
    """Temperature of the reference junction [K], for each row with the name of its column, or one for all."""
    head = next((h for h in heads if junction in (h.name, f"{h.name} ({h.stated})", f"{h.name} [{h.stated}]")), None)
    if head is None:
        names = [h.name for h in heads]
        try:
            return quantity(junction, "K", chosen.option("reference_junction"), "25degC"), ""
        except InputError as error:
            raise InputError(f"{error}{suggestion(junction, names)}") from None
    unit = head.unit
    to_K = converted(unit, "K")
    if not unit or to_K is None:
        rule = f"states `{unit}`, no unit of temperature" if unit else "states no unit of temperature"
        raise InputError(
            f"{chosen.place('reference_junction')}: the column in {display_path(block.path)} {rule}; name it with one, "
            f"such as `{head.name} (degC)`, or give a temperature"
        )
    return to_K.factor * head.numbers.values + to_K.offset, head.name


# Choices -------------------------------------------------------------------------------------------------------------


def _index_of(columns: Sequence[CsvColumn], name: str) -> int | None:
    """Index of a column by its name, with or without its unit; None where there is none."""
    bare, _ = name_and_unit(name, list(SI_UNITS.values()))
    return next((k for spelling in (name, bare) for k, c in enumerate(columns) if c.name == spelling), None)


def _named(path: Path, columns: list[CsvColumn], name: str, place: str) -> int:
    """Index of a column by its name, with or without its unit; `place` states it, for messages."""
    if (k := _index_of(columns, name)) is not None:
        return k
    hint = suggestion(name, [c.name for c in columns])
    raise InputError(f"{place}: there is no such column in {display_path(path)}{hint}")


def _as_kind(column: CsvColumn, kind: str, reason: str) -> CsvColumn:
    """A column of another kind, without its unit where that is none of this kind."""
    unit = column.unit if column.unit and converted(column.unit, SI_UNITS[kind]) else ""
    return replace(column, kind=kind, unit=unit, reason=reason)


def _as_declared(path: Path, columns: list[CsvColumn], layout: LoggerLayout) -> list[CsvColumn]:
    """Columns of the kinds that a stated layout declares; others are not used."""
    if not layout.column:
        return columns
    columns_of_layout = [
        replace(c, kind=UNUSED, reason="not in the layout") if c.kind in (TEMPERATURE, FLUX) else c for c in columns
    ]
    for declared in layout.column:
        k = _named(path, columns, declared.name, declared.place("name"))
        columns_of_layout[k] = replace(_as_kind(columns[k], declared.kind, "--layout"), declared=declared)
    return columns_of_layout


def _as_chosen(
    path: Path, columns: list[CsvColumn], chosen: LoggerLayout, temperatures: tuple[str, ...], flux: str | None
) -> list[CsvColumn]:
    """Columns of the kinds that options state; where temperatures are named, others are not used."""
    choices = [] if chosen.time is None else [(TIME, chosen.place("time"), chosen.time)]
    choices += [(TEMPERATURE, f"--temperature {t}", t) for t in temperatures]
    exclusive = {kind for kind, *_ in choices}
    used = [replace(c, kind=UNUSED, reason="not named") if c.kind in exclusive else c for c in columns]
    lamp = None if flux is None else _index_of(columns, flux)
    if lamp is not None and columns[lamp].kind != FLUX:
        used[lamp] = _as_kind(columns[lamp], FLUX, f"--lamp {flux}")
    for kind, place, name in choices:
        k = _named(path, columns, name, place)
        used[k] = _as_kind(columns[k], kind, place)
    return used


# Time ----------------------------------------------------------------------------------------------------------------


def _time(
    block: Block, heads: list[_Head], columns: list[CsvColumn], chosen: LoggerLayout
) -> tuple[CsvColumn, float | None, list[str]]:
    """The time of the rows, the instant of its zero, and notes.

    raises : InputError where no column is a time, or the one that is called so is not read
    """
    by_name = {h.name: h for h in heads}
    called = [c for c in columns if c.kind == TIME]
    readable = [c for c in called if _is_read(by_name[c.name])]
    if readable:
        column = _best_time(readable, by_name)
        read = _number_time if by_name[column.name].clock is None else _clock_time
        return read(block, by_name[column.name], column, chosen)
    if called:
        raise _no_time(block, by_name[called[0].name])
    first = columns[0]
    if not _may_be_time(block, first):
        raise _no_time(block, None)
    assumed = replace(first, kind=TIME, reason="no column is called time; this one increases")
    return _number_time(block, by_name[first.name], assumed, chosen)


def _counted_time(block: Block, chosen: LoggerLayout, period_s: float) -> CsvColumn:
    """The time of rows that are a period apart."""
    reason = f"{chosen.option('period_s')} {period_s:g} s, from row 1"
    return CsvColumn("time", TIME, "s", np.round(period_s * np.arange(len(block.lines)), 9), reason)


def _may_be_time(block: Block, column: CsvColumn) -> bool:
    """Whether a column of which nothing is known, and no name, increases from row to row."""
    says_nothing = not block.has_names and column.kind == UNUSED and column.reason.startswith(SAYS_NOTHING)
    return says_nothing and bool(np.all(np.diff(column.values) > 0.0))


def _no_time(block: Block, called: _Head | None) -> InputError:
    """The error of a file of which no column is a time that is read.

    called : a column that is called so
    """
    period = "--period 0.1s between rows"
    if called is None:
        return InputError(f"{display_path(block.path)}: no column is a time; give {EXAMPLE}, or {period}")
    i = next((i for i, c in enumerate(called.cells) if c), 0)
    return InputError(
        f"{block.at(i, called.name)}: `{shown_cell(called.cells[i])}` is in no layout of a time that is read; write "
        f"it as 2024-05-03T10:45:00 or in seconds, or give {period}"
    )


def _best_time(readable: Sequence[CsvColumn], by_name: Mapping[str, _Head]) -> CsvColumn:
    """The first column of times that states a time of day and changes from row to row, as far as there is one."""
    clock_of_column = {c.name: by_name[c.name].clock for c in readable}
    with_time = [c for c in readable if (clock := clock_of_column[c.name]) is None or clock.has_time] or readable
    return next((c for c in with_time if _moves(by_name[c.name])), with_time[0])


def _moves(head: _Head) -> bool:
    """Whether a time is not one and the same in all rows, as that of a start is."""
    values = head.numbers.values if head.clock is None else head.clock.seconds
    return len(np.unique(values[np.isfinite(values)])) > 1


def _is_read(head: _Head) -> bool:
    """Whether most cells of a column called time are numbers, or a clock in a layout that is read."""
    if head.clock is not None:
        return True
    return int(np.count_nonzero(np.isfinite(head.numbers.values))) > 0.5 * max(
        len(head.cells) - head.cells.count(""), 1
    )


def _clock_time(
    block: Block, head: _Head, column: CsvColumn, chosen: LoggerLayout
) -> tuple[CsvColumn, float | None, list[str]]:
    clock = head.clock
    assert clock is not None
    seconds, notes = clock.seconds, []
    _require_times(block, head, seconds)
    if clock.day_s is None:
        seconds, note = clocks.over_midnight(clock)
        if note:
            notes.append(f"`{head.name}` {note}")
    first = float(seconds[np.flatnonzero(np.isfinite(seconds))[0]])
    zero = first if clock.day_s is None else None if clocks.ANY_ORDER in clock.layout else clock.day_s + first
    t = np.round(seconds - first, 6)
    _warn_of_an_hour(block, head.name, t)
    elapsed = replace(column, values=t, unit="s", reason=f"{clock.layout}, counted from the first")
    return elapsed, zero, notes


def _warn_of_an_hour(block: Block, name: str, t: FloatArray) -> None:
    """Warn where a clock that is even otherwise jumps by an hour, as summer time begins."""
    steps = np.diff(t)
    if len(steps) < 4:
        return
    usual = float(np.median(steps))
    jumps = np.flatnonzero(np.abs(steps - usual - 3600.0) < 1e-3 * max(usual, 1.0))
    if len(jumps) == 1 and usual < 600.0 and np.sum(np.abs(steps - usual) > 0.1 * usual) == 1:
        warnings.warn(
            f"{block.at(int(jumps[0]) + 1, name)}: the clock jumps by an hour, as where summer time begins; "
            "correct the stamps "
            "where it does",
            stacklevel=2,
        )


def _number_time(
    block: Block, head: _Head, column: CsvColumn, chosen: LoggerLayout
) -> tuple[CsvColumn, float | None, list[str]]:
    """A time in numbers: in the unit that is stated, as stamps of 1970, as days of a spreadsheet, or in s."""
    values = head.numbers.values
    if head.numbers.torn >= 0:
        i = head.numbers.torn
        raise InputError(
            f"{block.at(i, head.name)}: `{shown_cell(head.cells[i])}` is no time in the layout of the others; mend the "
            "cell, or give --period"
        )
    _require_times(block, head, values)
    stated = head.unit
    if not stated and re.search(HEADS[1][1], head.name) and converted(head.name, "s") is not None:
        stated = head.name  # `millis`, not `uhr`, which a parser of units takes for micro-hours
    time_unit, guess, reason = _unit_of_time(block, head, column, stated, chosen)
    scale = converted(time_unit, "s")
    assert scale is not None
    finite = np.flatnonzero(np.isfinite(values))
    first = float(values[finite[0]])
    is_stamp, zero = _instant_of_stamp(first, time_unit, scale(first))
    if is_stamp:
        # whole digits first: seconds since 1970 leave few behind the point
        t = np.round((values - first) * scale.factor, 6)
        column = replace(column, values=t, unit="s", reason=f"{reason}, counted from the first", guess=guess)
        return column, zero, []
    low, high, rule = LIMITS["time_s"]
    bad = finite[(scale.factor * values[finite] < low) | (scale.factor * values[finite] > high)]
    if len(bad):
        i = int(bad[0])
        raise InputError(
            f"{block.at(i, head.name)}: `{head.cells[i]}` in {time_unit} {rule}; state its unit, --time-unit ms"
        )
    return replace(column, kind=TIME, values=values, unit=time_unit, reason=reason, guess=guess), None, []


def _unit_of_time(
    block: Block, head: _Head, column: CsvColumn, stated: str, chosen: LoggerLayout
) -> tuple[str, str, str]:
    """Unit of a time in numbers, what is assumed by it, and why: the chosen one, of the file, or of the size.

    stated : by the file; empty where it states none
    raises : InputError where the chosen one is a clock, or the file states a unit that is not known
    """
    unit = chosen.time_unit
    location = f"{display_path(block.path)}, column {head.name}"
    if unit in clocks.CLOCKS:
        cell = next(c for c in head.cells if c)
        place = chosen.place("time_unit")
        raise InputError(f"{place}: `{cell}` in {location} is no such clock; give s, ms, min or h")
    is_time = bool(stated) and converted(stated, "s") is not None
    if unit is not None:
        timed, option = replace(column, kind=TIME, unit=stated if is_time else ""), chosen.option("time_unit")
        _warn_of_other_unit(block.path, timed, unit, option)
        return unit, "", f"{column.reason}; {option}"
    if is_time:
        return stated, "", column.reason
    if stated and not re.fullmatch(REMARK, stated.strip()):
        raise InputError(f"{location}: `{stated}` is not a unit of time that is known; state it, --time-unit s")
    return _unit_of_stamps(block, head, column)


def _instant_of_stamp(value: float, unit: str, value_s: float) -> tuple[bool, float | None]:
    """Whether a time counts from an epoch, by its size, and its instant since 1970 [s]; None where not known."""
    if unit == "day":
        # days of Julian and of MATLAB are larger than those of a spreadsheet
        return value >= DAY_NUMBERS[0], (value - 25569.0) * 86400.0 if value <= DAY_NUMBERS[1] else None
    if UNIX_S[0] <= value_s <= UNIX_S[1]:
        return True, value_s
    return unit == "s" and LABVIEW_S[0] <= value <= LABVIEW_S[1], value - FROM_1904_S


def _unit_of_stamps(block: Block, head: _Head, column: CsvColumn) -> tuple[str, str, str]:
    """Unit of a time that states none, what is assumed by it, and why."""
    values = head.numbers.values[np.isfinite(head.numbers.values)]
    for unit, size in (("s", 1.0), ("ms", 1e3), ("us", 1e6), ("ns", 1e9)):
        if _are_within(values, UNIX_S[0] * size, UNIX_S[1] * size):
            return unit, "", f"{column.reason}; {unit} since 1970 by the size"
    if _are_within(values, *LABVIEW_S):
        return "s", "", f"{column.reason}; s since 1904 by the size"
    step = float(np.median(np.diff(values))) if len(values) > 1 else 1.0
    if len(values) > 1 and (clock := clocks.possible_clock(values)):
        raise InputError(
            f"{display_path(block.path)}, column {head.name}: `{head.cells[0]}` may be a time of day or seconds; state "
            f"--time-unit {clock} or --time-unit s"
        )
    if _are_days(values) and step < 0.05:
        return "day", "", f"{column.reason}; days of a spreadsheet by the size"
    if not SHORTEST_STEP_S <= step <= clocks.LONGEST_STEP_S:
        raise InputError(
            f"{display_path(block.path)}, column {head.name}: states no unit, and steps of {step:g} are hardly s; "
            f"state it, --time-unit {_likely_unit(values, step)}"
        )
    return "s", "no unit is stated: s assumed (--time-unit)", f"{column.reason}; no unit: s assumed"


def _likely_unit(values: FloatArray, step: float) -> str:
    """Unit of times whose step is hardly one in seconds."""
    if step > clocks.LONGEST_STEP_S:
        return "us" if step > 5e5 else "ms"
    return "day" if values.min() >= DAY_NUMBERS[0] else "s"


def _are_within(values: FloatArray, low: float, high: float) -> bool:
    return bool(low <= values.min() and values.max() <= high)


def _are_days(values: FloatArray) -> bool:
    """Whether numbers may be days of a spreadsheet of this century, with their fractions."""
    return _are_within(values, *DAY_NUMBERS) and bool(np.any(values % 1.0))


def _require_times(block: Block, head: _Head, values: FloatArray) -> None:
    """Refuse a row in which a reading stands and no time.

    raises : InputError with the first such row of the file
    """
    bad = np.flatnonzero(np.isnan(values))
    if len(bad):
        i = int(bad[0])
        cell = head.cells[i]
        problem = f"`{shown_cell(cell)}` is no time in the layout of the others" if cell else "holds no time"
        rule = f"{problem}; remove the row, or give --period{and_more_rows(bad.size)}"
        raise InputError(f"{block.at(i, head.name)}: {rule}")


def _with_the_newest_last(measured: MeasuredCsv) -> MeasuredCsv:
    """A file that begins with its newest row as one in the order of time, with a note; another one as it is."""
    clock = measured.of_kind(TIME)[0]
    if not runs_back(clock.values):
        return measured
    counted_s = float(clock.values[-1]) if "counted from the first" in clock.reason else 0.0
    columns = tuple(
        replace(c, values=c.values[::-1] - counted_s if c is clock else c.values[::-1]) for c in measured.columns
    )
    zero_s = None if measured.zero_s is None else measured.zero_s + counted_s
    return replace(
        measured, columns=columns, rows=measured.rows[::-1], zero_s=zero_s, notes=(*measured.notes, RUNS_BACK)
    )


def _with_distinct_times(measured: MeasuredCsv, chosen: LoggerLayout) -> MeasuredCsv:
    """A file whose times increase; rows of one time as `repeated` of the layout states.

    raises : InputError with the first row of the file that does not come later, and the options that help
    """
    measured = _with_the_newest_last(measured)
    clock = measured.of_kind(TIME)[0]
    t = clock.si
    steps = np.diff(t)
    if len(t) < 2:
        raise InputError(f"{display_path(measured.path)}: has {len(t)} row of readings; it needs two or more")
    back = np.flatnonzero(steps < 0.0) + 1
    if len(back):
        step_s = steps[back[0] - 1]
        deed = _deed_about_a_step_back(clock, step_s)
        raise InputError(
            f"{measured.line(int(back[0]))}, column {clock.name}: does not come after the row above, {-step_s:g} s "
            f"earlier; {deed}, or give --period{and_more_rows(back.size)}"
        )
    repeats = np.flatnonzero(steps == 0.0) + 1
    if not len(repeats):
        return measured
    if chosen.repeated is None:
        raise InputError(
            f"{measured.line(int(repeats[0]))}, column {clock.name}: does not come after the row above, but has "
            "its time; state --repeated spread (even until the next time) or --repeated first (keep the first), or "
            f"give --period{and_more_rows(repeats.size)}"
        )
    option = f"{chosen.option('repeated')} {chosen.repeated}"
    note = f"{len(repeats)} rows have the time of the row above ({option})"
    return _without_repeats(replace(measured, notes=(*measured.notes, note)), chosen.repeated, option)


def _without_repeats(measured: MeasuredCsv, repeated: str, option: str) -> MeasuredCsv:
    """A file with the first row of each time alone, or with its rows spread even until the next time.

    raises : InputError where all rows have one time
    """
    clock = measured.of_kind(TIME)[0]
    t = clock.si
    begins = np.flatnonzero(np.concatenate(([True], np.diff(t) > 0.0)))
    if repeated == "first":
        columns = tuple(replace(c, values=c.values[begins]) for c in measured.columns)
        return replace(measured, columns=columns, rows=tuple(measured.rows[i] for i in begins))
    if len(begins) < 2 or t[begins[-1]] <= t[begins[-2]]:
        raise InputError(f"{display_path(measured.path)}, column {clock.name}: all times are one; give --period")
    reason = f"{clock.reason}; {option}"
    even = replace(clock, values=np.round(_spread(t, begins), 9), unit="s", reason=reason)
    return replace(measured, columns=tuple(even if c is clock else c for c in measured.columns))


def _deed_about_a_step_back(clock: CsvColumn, step_s: float) -> str:
    """What to do about a time that goes back by a step [s]."""
    if clock.reason.startswith(("clock", "dates")):
        if abs(step_s + 3600.0) < 1800.0:
            return "as where summer time ends: write UTC offsets"
        if abs(step_s + 43200.0) < 1800.0:
            return "as on a clock of 12 hours: write AM and PM"
    return "sort the rows"


def _spread(t: FloatArray, begins: NDArray[np.intp]) -> FloatArray:
    """Times of which several rows have one each, spread evenly until the next time [s].

    begins : first row of each time, two at least; rows of the last time keep the spacing of those before them
    """
    ends = np.append(begins[1:], len(t))
    last = t[begins[-1]] - t[begins[-2]]
    count_before = ends[-2] - begins[-2]
    spread = t.copy()
    for a, b in zip(begins, ends, strict=True):
        after = t[b] if b < len(t) else t[a] + last * (b - a) / count_before
        spread[a:b] = t[a] + (after - t[a]) * np.arange(b - a) / (b - a)
    return spread


# Units and readings --------------------------------------------------------------------------------------------------


def _warn_of_other_unit(path: Path, column: CsvColumn, unit: str, option: str) -> None:
    """Warn where a column states another unit than the option that prevails over it."""
    si = SI_UNITS[column.kind]
    if column.unit and converted(column.unit, si) != converted(unit, si):
        warnings.warn(
            f"{display_path(path)}, column {column.name}: the file says {column.unit}, {option} says {unit}; read as "
            f"{unit}. Leave {option} out where the file is right",
            stacklevel=2,
        )


def _with_unit(block: Block, column: CsvColumn, head: _Head, chosen: LoggerLayout) -> CsvColumn:
    """A temperature or a flux with its unit: the one stated by an option, the file, or told by the first readings.

    raises : InputError where the file states a unit that is not known, or a cell is in another layout
    """
    if head.numbers.torn >= 0:
        i = head.numbers.torn
        raise InputError(
            f"{block.at(i, head.name)}: `{shown_cell(head.cells[i])}` is no number in the layout of the "
            "file; mend the cell, "
            "state --decimal or --separator, or name the columns that are read, --temperature COLUMN"
        )
    if (column.declared and column.declared.unit) or getattr(chosen, UNIT_KEYS[column.kind]):
        return _with_stated_unit(block.path, column, chosen)
    if head.unit and not column.unit and not re.fullmatch(REMARK, head.unit.strip()):
        raise InputError(
            f"{display_path(block.path)}, column {column.name}: `{head.unit}` is not a unit of {column.kind} that is "
            f"known; {_remedy(head.unit, column.kind)}, or name the columns that are read, --temperature COLUMN"
        )
    return column


def _remedy(unit: str, kind: str) -> str:
    """What to do about an unknown unit of a column."""
    is_voltage = is_emf(unit) and kind == TEMPERATURE
    state = f"{THERMOCOUPLE_EXAMPLE} for an emf" if is_voltage else UNIT_OPTIONS[kind]
    has_factor = re.search(r"^[\d.]+ ?\D|[x*\u00d7] ?10", unit)
    return f"write the numbers times their factor, and {state}" if has_factor else f"state it, {state}"


def _without_counters(columns: list[CsvColumn]) -> list[CsvColumn]:
    """Columns without those that count the rows, such as `TC run` with 1, 2, 3, beside a temperature that states its
    unit."""
    if not any(c.kind == TEMPERATURE and c.unit for c in columns):
        return columns
    return [
        replace(c, kind=UNUSED, reason="it counts the rows")
        if c.kind == TEMPERATURE and not c.unit and len(c.values) > 2 and np.all(np.diff(c.values) == 1.0)
        else c
        for c in columns
    ]


def _with_stated_unit(path: Path, column: CsvColumn, chosen: LoggerLayout) -> CsvColumn:
    """A temperature or a flux in the unit that the layout declares of its column, or states of all.

    raises : InputError where it is none of this kind, or the declared one is not that of the file
    """
    kind, si, declared = column.kind, SI_UNITS[column.kind], column.declared
    if declared is not None and declared.unit:
        if column.unit and converted(column.unit, si) != converted(declared.unit, si):
            rule = f"and {display_path(path)} says {column.unit}; correct one of the two"
            raise InputError(f"{declared.place('unit')}, {rule}")
        return replace(column, unit=declared.unit, reason=f"{column.reason}; --layout")
    key = UNIT_KEYS[kind]
    unit, option = getattr(chosen, key), chosen.option(key)
    if problem := unit_problem(unit, kind):
        raise InputError(f"{chosen.place(key)}: {problem}")
    _warn_of_other_unit(path, column, unit, option)
    return replace(column, unit=unit, reason=f"{column.reason}; {option}")


def _guessed(block: Block, columns: list[CsvColumn], kinds: Sequence[str]) -> list[CsvColumn]:
    """Columns with the units that their readings tell where none is stated, for a warning: one for all temperatures.

    raises : InputError where they tell none
    """
    open_ = [c for c in columns if c.kind in kinds and not c.unit]
    starts = {c.name: _start(c) for c in open_ if c.kind == TEMPERATURE}
    unit = _unit_of_starts(list(filter(math.isfinite, starts.values())))
    if starts and not unit:
        odd = max(starts, key=lambda name: not ROOM_C[0] <= starts[name] <= ROOM_C[1])  # the first one, if any
        raise InputError(
            f"{display_path(block.path)}, column {odd}: begins at {starts[odd]:g}, in no unit that is known; state it, "
            "--temperature-unit degC, or name the columns that are read, --temperature COLUMN"
        )
    return [_with_guess(c, unit, starts.get(c.name)) if c in open_ else c for c in columns]


def _unit_of_starts(starts: Sequence[float]) -> str:
    """Unit in which one of several first readings is that of a room, and none is colder; empty where there is none."""
    if any(ROOM_K[0] <= x <= ROOM_K[1] for x in starts) and min(starts) >= ROOM_K[0]:
        return "K"
    return "degC" if any(ROOM_C[0] <= x <= ROOM_C[1] for x in starts) and max(starts) < ROOM_K[0] else ""


def _start(column: CsvColumn) -> float:
    read = column.values[np.isfinite(column.values)]
    return float(np.median(read[:5])) if read.size else float("nan")


def _warn_of_guesses(measured: MeasuredCsv, kinds: Sequence[str]) -> None:
    """Warn of what is assumed without a word of the file: of fluxes where they are used."""
    guesses: dict[str, list[str]] = {}
    for column in measured.columns:
        if column.guess and (column.kind == TIME or (column.kind == TEMPERATURE and TEMPERATURE in kinds)):
            guesses.setdefault(column.guess, []).append(column.name)
    for guess, names in guesses.items():
        named = f"column{'s' if len(names) > 1 else ''} {', '.join(names)}"
        warnings.warn(f"{display_path(measured.path)}, {named}: {guess}", stacklevel=3)


def _warn_of_silent_sensors(measured: MeasuredCsv) -> None:
    """Warn of columns that are temperatures by their names and hold no reading at all."""
    silent = [c for c in measured.columns if c.reason in (FEW_NUMBERS, NO_CELLS) and not np.any(np.isfinite(c.values))]
    names = [c.name for c in silent if _kind_by_name(c.name) == TEMPERATURE]
    if names:
        named = f"column{'s' if len(names) > 1 else ''} {', '.join(names)}"
        warnings.warn(f"{display_path(measured.path)}, {named}: not used, no cell holds a reading", stacklevel=3)


def _with_guess(column: CsvColumn, unit: str, start: float | None) -> CsvColumn:
    if column.kind == TEMPERATURE:
        guess = f"no unit is stated, and readings begin as in a room: {unit} assumed (--temperature-unit)"
        return replace(column, unit=unit, reason=f"{column.reason}; begins at {start:g}: {unit} assumed", guess=guess)
    largest = float(np.nanmax(np.abs(column.values))) if np.any(np.isfinite(column.values)) else 0.0
    unit, why = ("W/m2", "above 1000") if largest > 1000.0 else ("kW/m2", "up to 1000")
    guess = f"no unit is stated, and values are {why}: {unit} assumed (--flux-unit)"
    return replace(column, unit=unit, reason=f"{column.reason}; no unit, values {why}: {unit}", guess=guess)


def _without_lost(block: Block, column: CsvColumn, codes: Sequence[float]) -> CsvColumn:
    """A column without readings that are codes: those stated, overloads, what no temperature can be.

    raises : InputError where several different readings are no temperature: the unit is another one
    """
    column = _without_codes(block, column, codes)
    if column.kind != TEMPERATURE:
        return column
    column = _without_faults(block, _without_impossible(block, column))
    read = np.unique(column.values[np.isfinite(column.values)])
    if len(read) == 1 and float(read[0]) in OPEN:
        raise InputError(
            f"{display_path(block.path)}, column {column.name}: reads {read[0]:g} throughout, as a converter in "
            "fault; name the columns that are read, --temperature COLUMN"
        )
    return column


def _left_out(column: CsvColumn, rows: NDArray[np.intp], reason: str) -> CsvColumn:
    """A column without the readings of some rows, and why."""
    values = column.values.copy()
    values[rows] = np.nan
    return replace(column, values=values, reason=f"{column.reason}; {reason}")


def _without_codes(block: Block, column: CsvColumn, codes: Sequence[float]) -> CsvColumn:
    """A column without the stated codes of a lost sample, and without overloads."""
    values = column.values
    coded = lost_codes(values, codes)
    if not coded.any():
        return column
    overload = np.flatnonzero(coded & ~lost_codes(np.where(np.abs(values) >= 1e30, 0.0, values), codes))
    _warn_of_rows(block, column.name, overload, values, "is the overload of a recorder: left out")
    shown = Counter(f"{v:g}" for v in values[coded])
    return _left_out(column, np.flatnonzero(coded), "lost: " + ", ".join(f"{n} of {code}" for code, n in shown.items()))


def _without_impossible(block: Block, column: CsvColumn) -> CsvColumn:
    """A temperature without one or two readings that no wall can have: codes of a lost sample.

    raises : InputError where there are more: the unit is another one
    """
    values, si = column.values, column.si
    wrong = np.flatnonzero((si < COLDEST_K) | (si > HOTTEST_K))
    kinds = sorted({float(values[i]) for i in wrong})
    if len(kinds) > 2 or len(wrong) > 0.5 * max(int(np.count_nonzero(np.isfinite(si))), 1):
        i = int(wrong[0])
        raise InputError(
            f"{block.at(i, column.name)}: {values[i]:g} {column.unit} is {si[i]:g} K and no temperature "
            "of a wall; state the "
            f"unit, --temperature-unit, or the readings of a lost sample, --lost={values[i]:g}"
        )
    if not len(wrong):
        return column
    rule = "is no temperature and taken for the code of a lost sample: left out"
    _warn_of_rows(block, column.name, wrong, values, rule)
    counts = ", ".join(f"{int(np.sum(values[wrong] == k))} of {k:g}" for k in kinds)
    return _left_out(column, wrong, f"lost: {counts}")


def _without_faults(block: Block, column: CsvColumn) -> CsvColumn:
    """A temperature without readings that are codes of recorders in fault."""
    faults = np.flatnonzero(fault_codes(column.values))
    if not len(faults):
        return column
    rule = "lies far off its neighbours and is a code of recorders in fault: left out"
    _warn_of_rows(block, column.name, faults, column.values, rule)
    return _left_out(column, faults, f"{len(faults)} readings of a fault left out")


def _warn_of_rows(block: Block, name: str, rows: NDArray[np.intp], values: FloatArray, rule: str) -> None:
    """Warn of the readings of some rows, if there are any."""
    if not len(rows):
        return
    shown = ", ".join(dict.fromkeys(f"{values[i]:g}" for i in rows))
    where = _rows_in_words(block.lines, rows)
    warnings.warn(f"{display_path(block.path)}, {where}, column {name}: {shown} {rule}", stacklevel=2)


def _rows_in_words(lines: Sequence[int], rows: NDArray[np.intp]) -> str:
    """`rows 3, 4, 5, 8, 9 (and 7 more)`."""
    where = ", ".join(str(lines[i]) for i in rows[:NAMED_ROWS])
    rest = f" (and {len(rows) - NAMED_ROWS} more)" if len(rows) > NAMED_ROWS else ""
    return f"{'rows' if len(rows) > 1 else 'row'} {where}{rest}"


def _name_far_off(measured: MeasuredCsv) -> None:
    """Warn of single readings far off their neighbours, which stay in the record."""
    for column in measured.of_kind(TEMPERATURE):
        rows = np.flatnonzero(far_off(column.values))
        if len(rows):
            shown = ", ".join(f"{column.values[i]:g}" for i in rows[:NAMED_ROWS])
            where = f"{display_path(measured.path)}, {_rows_in_words(measured.rows, rows)}"
            warnings.warn(
                f"{where}, column {column.name}: {shown} {column.unit} lies far off its "
                f"neighbours and stays; leave it out by --lost={column.values[rows[0]]:g} where it is no reading",
                stacklevel=2,
            )


def _rows_kept(
    block: Block, columns: list[CsvColumn], kinds: Sequence[str]
) -> tuple[list[CsvColumn], tuple[int, ...], list[str]]:
    """Rows in which a column that is used has a reading; others say nothing, such as those that mark an event."""
    out = _empty_ends(block, [c for c in columns if c.kind in kinds])
    if not out:
        return columns, block.lines, []
    stay = np.setdiff1d(np.arange(len(block.lines)), out)
    note = f"{len(out)} rows without a reading at the ends left out"
    return [replace(c, values=c.values[stay]) for c in columns], tuple(block.lines[i] for i in stay), [note]


def _empty_ends(block: Block, used: Sequence[CsvColumn]) -> list[int]:
    """Rows before the first reading and after the last one that are empty in all columns that are used.

    A lost sample of all sensors between others is kept as such.
    """
    rows = np.flatnonzero(np.any([np.isfinite(c.values) for c in used], axis=0)) if used else np.zeros(0)
    if not len(rows):
        return []
    ends = (*range(rows[0]), *range(rows[-1] + 1, len(used[0].values)))
    cells = [block.cells[k] for k in range(len(block.names)) if _is_used(block, k, used)]
    return [i for i in ends if not any(of_column[i] for of_column in cells)]


def _is_used(block: Block, k: int, used: Sequence[CsvColumn]) -> bool:
    bare, _ = name_and_unit(block.names[k], list(SI_UNITS.values()))
    return any(c.name in (bare, block.names[k]) for c in used)


def _stated(
    chosen: LoggerLayout, block: Block, signs: Signs, columns: Sequence[CsvColumn], heads: Sequence[_Head]
) -> LoggerLayout:
    """The layout as it was read: units where the file states none itself, which each file may state again.

    columns : the time first
    """
    clock = columns[0]
    kind_of_unit = {h.name: _kind_by_unit(h.unit) for h in heads}
    used = _layout_columns(columns, kind_of_unit)
    states_unit = "counted from" in clock.reason or kind_of_unit.get(clock.name) == TIME
    return chosen.model_copy(
        update={
            "separator": block.separator or None,
            "decimal": signs.decimal if block.separator else None,
            "dates": chosen.dates or _order_of_dates(clock),
            "time": clock.name if chosen.period_s is None else None,
            "time_unit": chosen.time_unit or (None if states_unit else clock.unit),
            "column": used,
            "temperature_unit": None,
            "flux_unit": None,
        }
    )


def _layout_columns(columns: Sequence[CsvColumn], kind_of_unit: Mapping[str, str]) -> list[LayoutColumn]:
    """What a layout declares of readings; kind_of_unit : by the name of a column, of the unit that the file states."""
    readings = [c for c in columns if c.kind in (TEMPERATURE, FLUX) and c.unit]
    return [_layout_column(c, c.kind == kind_of_unit[c.name]) for c in readings]


def _layout_column(column: CsvColumn, states_unit: bool) -> LayoutColumn:
    kind: Literal["temperature", "heat flux"] = "temperature" if column.kind == TEMPERATURE else "heat flux"
    declared = column.declared or LayoutColumn(name=column.name, kind=kind)
    return declared if states_unit or declared.unit else declared.model_copy(update={"unit": column.unit})


def _order_of_dates(clock: CsvColumn) -> str | None:
    """Order of the dates of a clock; None where there are none, or the year stands first, which says it itself."""
    order = next((o for o, order_text in clocks.ORDERS.items() if f"dates {order_text}" in clock.reason), None)
    return None if order == "year-first" else order


def lost_values(text: str) -> tuple[float, ...]:
    """Readings of a lost sample that an option states, `-9999,9.9E37`.

    raises : InputError, one line, where one is no number
    """
    try:
        return tuple(plain_number(number.strip()) for number in text.split(",") if number.strip())
    except ValueError:
        raise InputError(f"--lost {text}: write numbers, such as --lost=-9999,9.9E37") from None
