"""Files of flight conditions as tools write them: CSV, JSON lines, lists in columns, with their names and units.

Texts are read as those of loggers (cells/): separators, one decimal sign and one of thousands for the whole file, lines
above the names, units in a row or in cells, dates and clocks for the time. Read as well are names in the last comment
line (OpenRocket), exponents of Fortran, and one JSON object a line or a list of them. A column that holds texts is no
condition; an empty cell or `NaN` is no number.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from sim_heating.base.arrays import FloatArray
from sim_heating.base.errors import InputError, error_context
from sim_heating.base.files import CsvTable, display_path, read_text
from sim_heating.base.files.csv_table import header_entry
from sim_heating.base.files.text import repeated_name
from sim_heating.heating.recorded.fields import (
    ConditionField,
    FlightField,
    column_unit,
    columns_of_fields,
    field_of_name,
)

if TYPE_CHECKING:
    from sim_heating.heating.recorded.cells.block import Block
    from sim_heating.heating.recorded.cells.clocks import Clock
    from sim_heating.heating.recorded.cells.numbers import Signs

SAME = 2e-3
"""Relative difference of two fields of one column that are the same but for rounding."""
DERIVABLE = {"T_inf_K", "p_inf_Pa", "rho_kg_m3", "mach", "log10_re", "p_surface_Pa"}
"""Columns that may follow from others."""


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
    text = _text(path)
    block = _block(path, text)
    names, lines = list(block.names), np.array(block.lines, dtype=np.int64)
    declared = _with_clock(block, stated or {})
    units, numbers = _units_and_numbers(block, declared)
    with error_context(display_path(path)):
        by_column = columns_of_fields(names, units, declared)
    filled = {name: values for name, values in numbers.items() if not np.all(np.isnan(values))}
    used, columns, fields_without_unit = _taken(path, by_column, filled)
    columns |= {column: np.full(len(lines), constant) for column, constant in declared_constants(declared).items()}
    matched = [f.name for f in chain.from_iterable(by_column.values())]
    unused, empty = tuple(n for n in names if n not in matched), tuple(n for n in matched if n not in filled)
    header = _header(text.split("\n")[: lines[0] - 1])
    return FlightFields(path, columns, used, fields_without_unit, unused, empty, header, lines, numbers)


def _taken(
    path: Path, fields: Mapping[str, Sequence[FlightField]], numbers: Mapping[str, FloatArray]
) -> tuple[dict[str, FlightField], dict[str, FloatArray], dict[str, FlightField]]:
    """Column -> the field that it is taken from, its values, and the field of a column that none states the unit of.

    numbers : of the fields that hold any
    """
    used: dict[str, FlightField] = {}
    columns: dict[str, FloatArray] = {}
    fields_without_unit: dict[str, FlightField] = {}
    for column, all_fields in fields.items():
        of_column = [f for f in all_fields if f.name in numbers]
        if with_unit := [f for f in of_column if f.unit is not None]:
            used[column], columns[column] = _one(path, column, with_unit, numbers)
        elif of_column:
            fields_without_unit[column] = of_column[0]
    return used, columns, fields_without_unit


def _header(lines: Sequence[str]) -> dict[str, str]:
    """The entries `# key: value` of lines above the names."""
    return dict(header_entry(line) for line in lines if line.lstrip().startswith("#") and ":" in line)


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


def _text(path: Path) -> str:
    """The text of a file in UTF-8 or UTF-16, each line ended by one sign.

    raises : InputError, as `read_text`
    """
    from sim_heating.heating.recorded.cells.text import decoded

    with suppress(OSError):
        if path.is_file() and path.read_bytes()[:2] in (b"\xff\xfe", b"\xfe\xff"):
            return decoded(path).replace("\r\n", "\n").replace("\r", "\n")
    return read_text(path).replace("\r\n", "\n").replace("\r", "\n")


def _block(path: Path, text: str) -> Block:
    """The rows of a file.

    raises : InputError where there are no names, or no rows of numbers
    """
    from sim_heating.heating.recorded.cells.text import text_block  # pandas, which a vehicle does not need

    block = text_block(path, text)
    if not block.has_names:
        raise InputError(
            f"{display_path(path)}: the row of column names is missing; add one, with units, as `Altitude (ft)`"
        )
    if (twice := repeated_name(block.names)) is not None:
        raise InputError(f"{display_path(path)}: column `{twice}` is repeated; remove one")
    return block


def _with_clock(block: Block, declared: Mapping[str, ConditionField | str]) -> Mapping[str, ConditionField | str]:
    """Declared fields, with the column of clocks as the time that is called so, else the only one, where none is
    declared."""
    if "time_s" in declared:
        return declared
    called = list(filter(_is_time, block.names))
    clocks = [name for k, name in enumerate(block.names) if _are_clocks(list(filter(None, block.column(k)[:50])))]
    times = [name for name in called or clocks if name in clocks]
    return {**declared, "time_s": times[0]} if len(times) == 1 else declared


def _is_time(name: str) -> bool:
    """Whether a field is called as a time is."""
    f = field_of_name(name)
    return f is not None and f.column == "time_s"


def _are_clocks(cells: Sequence[str]) -> bool:
    from sim_heating.heating.recorded.cells.text import is_clock

    return bool(cells) and all(map(is_clock, cells))


def _units_and_numbers(
    block: Block, declared: Mapping[str, ConditionField | str]
) -> tuple[dict[str, str], dict[str, FloatArray]]:
    """Unit of each column, where a row of units or the cells state one, and its numbers, by one layout for the file.

    raises : InputError where a cell shows that the layout is not clear
    """
    from sim_heating.heating.recorded.cells.clocks import clock_of
    from sim_heating.heating.recorded.cells.numbers import number_signs

    clocks = _clock_columns(block, declared.get("time_s"))
    signs = number_signs(block, [k for k in range(len(block.names)) if k not in clocks], None)
    units, numbers = {}, {}
    for k, name in enumerate(block.names):
        clock = clock_of(block.column(k), f"{display_path(block.path)}, column {name}") if k in clocks else None
        if clock is None:
            unit, numbers[name] = _unit_and_numbers(block, k, signs)
        else:
            unit, numbers[name] = "s", _counted_s(clock)
        if unit:
            units[name] = unit
    return units, numbers


def _clock_columns(block: Block, time: ConditionField | str | None) -> set[int]:
    """Columns of a time in which dates or times of day stand.

    time : the field that is declared to be the time
    """
    from sim_heating.heating.recorded.cells.text import is_clock

    declared = time.field if isinstance(time, ConditionField) else time
    times = set(filter(_is_time, block.names)) if time is None else {declared}
    return {k for k, name in enumerate(block.names) if name in times and any(map(is_clock, block.column(k)[:50]))}


def _unit_and_numbers(block: Block, k: int, signs: Signs) -> tuple[str, FloatArray]:
    """Unit of a column of numbers, where a row of units or the cells state one, and its numbers.

    raises : InputError where a cell of a flight condition is torn, or has another unit than the column
    """
    from sim_heating.heating.recorded.cells.numbers import numbers_of, require_one_unit, shown_cell

    cells, of_name, stated = block.column(k), field_of_name(block.names[k]), block.units[k].strip("[]() ")
    read = numbers_of(cells, signs)
    if of_name is not None:
        if read.torn >= 0:
            rule = "is no number in the layout of the file; mend the cell"
            raise InputError(f"{block.at(read.torn, block.names[k])}: `{shown_cell(cells[read.torn])}` {rule}")
        require_one_unit(block, k, read, stated or of_name.unit or "", [column_unit(of_name.column)])
    return stated or read.unit, read.values


def _counted_s(clock: Clock) -> FloatArray:
    """Times of a clock from the earliest row [s], also over midnight where it states no date."""
    from sim_heating.heating.recorded.cells.clocks import over_midnight

    seconds = over_midnight(clock)[0] if clock.day_s is None else clock.seconds
    return np.round(seconds - np.nanmin(seconds), 6)


def declared_constants(declared: Mapping[str, ConditionField | str]) -> dict[str, float]:
    """Columns that are declared to be one number."""
    fields = {column: value for column, value in declared.items() if isinstance(value, ConditionField)}
    return {column: field.constant for column, field in fields.items() if field.constant is not None}
