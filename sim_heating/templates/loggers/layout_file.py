"""A stated layout of a recorder's files, kept in a TOML file for the next ones.

format = "logger-layout/1"
separator = ";"                     # between cells
decimal = ","                       # decimal sign
dates = "day-first"                 # or "month-first", "year-first"
time = "Time"                       # column of the time
time_unit = "ms"                    # or hh:mm, mm:ss
lost = [-9999.0, 9.9e37]            # readings that stand for a lost sample
[[column]]                          # the columns that are used
name = "TC1"
unit = "degC"
depth = "back"
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import ClassVar, Literal, Self

from pydantic import Field, PrivateAttr, ValidationInfo, field_validator

from sim_heating.base.files import Declared, display_path, read_toml, toml_text, write_text_atomic
from sim_heating.base.files.schema import schema_line
from sim_heating.base.files.units import converted
from sim_heating.heating.recorded.cells.clocks import CLOCKS

FORMAT = "logger-layout/1"
TIME, TEMPERATURE, FLUX = "time", "temperature", "heat flux"
"""Kinds of columns."""
SI_UNITS = {TIME: "s", TEMPERATURE: "K", FLUX: "W/m2"}
EXAMPLES = {
    TIME: f"one of {', '.join(('s', 'ms', 'min', 'h', 'us', *CLOCKS))}", TEMPERATURE: "K, degC or degF", FLUX: "W/m2"
}  # fmt: skip
"""Kind of a column -> units that a message names."""
KIND_OF_KEY = {"time_unit": TIME, "temperature_unit": TEMPERATURE, "flux_unit": FLUX}


def unit_problem(unit: str, kind: str) -> str:
    """Why a unit is none of a kind of column; "" where it is one, or the layout of a clock for a time."""
    is_clock = kind == TIME and unit in CLOCKS
    is_known = is_clock or converted(unit, SI_UNITS[kind]) is not None
    return "" if is_known else f"is not a unit of {kind}; give {EXAMPLES[kind]}"


def _checked(unit: str | None, kind: str) -> str | None:
    if unit is not None and (problem := unit_problem(unit, kind)):
        raise ValueError(f"`{unit}` {problem}")
    return unit


class LayoutColumn(Declared):
    """A column of the recorder's files that is a temperature or a heat flux."""

    quantities: ClassVar = {"depth": None}
    _place: str = PrivateAttr(default="layout")

    name: str = Field(min_length=1, description="name in the files, without its unit")
    kind: Literal["temperature", "heat flux"] = Field(default="temperature", description="what it holds")
    unit: str | None = Field(default=None, description="unit of its cells, as `degC`; what a file states where absent")
    depth: str | None = Field(default=None, description="depth of the sensor, as `0.4mm`, `surface` or `back`")

    @field_validator("unit")
    @classmethod
    def _is_of_its_kind(cls, unit: str | None, info: ValidationInfo) -> str | None:
        kind = info.data.get("kind")  # absent where it is wrong itself
        return _checked(unit, kind) if unit and kind else unit

    @field_validator("depth")
    @classmethod
    def _is_of_a_temperature(cls, depth: str | None, info: ValidationInfo) -> str | None:
        if depth is not None and info.data.get("kind") == FLUX:
            raise ValueError("a heat flux has no depth; leave it out")
        return depth

    def place(self, key: str) -> str:
        """What states a key, for messages: "rig.toml, [column] 1: `name`: `TC1`"."""
        return f"{self._place}: `{key}`: `{getattr(self, key)}`"


class LoggerLayout(Declared):
    """How a recorder writes its files. What is absent is recognised in each file, or refused."""

    quantities: ClassVar = {"lost": None, "period_s": None}
    _file: str = PrivateAttr(default="layout")
    _options: frozenset[str] = PrivateAttr(default=frozenset())

    format: Literal["logger-layout/1"] = "logger-layout/1"
    title: str = Field(default="", description="which recorder, in words")
    separator: str | None = Field(
        default=None, min_length=1, max_length=1, description="between cells; a blank for any number of blanks"
    )
    decimal: Literal[".", ","] | None = Field(
        default=None, description="decimal sign; the other one is that of thousands"
    )
    dates: Literal["day-first", "month-first", "year-first"] | None = Field(
        default=None, description="order of dates as 03/05/2024"
    )
    sheet: str | None = Field(default=None, description="sheet of a workbook, group of TDMS, or segment of LVM")
    time: str | None = Field(default=None, description="column of the time")
    time_unit: str | None = Field(default=None, description="unit of the time, or the layout of its clock as `hh:mm`")
    period_s: float | None = Field(default=None, gt=0.0, description="time between rows, in place of a column")
    repeated: Literal["spread", "first"] | None = Field(
        default=None, description="rows of one time are spread until the next, or the first of them is kept"
    )
    temperature_unit: str | None = Field(default=None, description="unit of temperatures that state none")
    flux_unit: str | None = Field(default=None, description="unit of heat fluxes that state none")
    thermocouple: Literal["B", "E", "J", "K", "N", "R", "S", "T"] | None = Field(
        default=None, description="type whose emf the columns in mV or V hold"
    )
    reference_junction: str | None = Field(
        default=None, description="temperature of its terminals with a unit, as `25degC`, or the name of its column"
    )
    lost: list[float] = Field(default_factory=list, description="readings that stand for a lost sample")
    column: list[LayoutColumn] = Field(default_factory=list, description="columns that are used; all where absent")

    @field_validator("time_unit", "temperature_unit", "flux_unit")
    @classmethod
    def _is_known(cls, unit: str | None, info: ValidationInfo) -> str | None:
        return _checked(unit, KIND_OF_KEY[str(info.field_name)])

    def with_options(self, options: Mapping[str, object]) -> Self:
        """The layout with keys that options state in its place; an option that is None states nothing."""
        stated = {key: value for key, value in options.items() if value is not None}
        layout = self.model_copy(update=stated)
        layout._options = self._options | set(stated)
        return layout

    def option(self, key: str) -> str:
        """What states a key, for messages: `--dates`, or "`dates` in rig.toml"."""
        return f"--{_spelled(key)}" if key in self._options else f"`{key}` in {self._file}"

    def place(self, key: str) -> str:
        """What states a key, and as what, for messages: `--dates day-first`, or "rig.toml: `dates`: `day-first`"."""
        value = getattr(self, key)
        return f"--{_spelled(key)} {value}" if key in self._options else f"{self._file}: `{key}`: `{value}`"


def _spelled(key: str) -> str:
    return key.removesuffix("_s").replace("_", "-")


def read_layout(path: Path) -> LoggerLayout:
    """The layout of a file, which messages then name; InputError, one line a problem, as `read_toml`."""
    layout = read_toml(path, LoggerLayout)
    layout._file = display_path(path)
    for k, column in enumerate(layout.column, 1):
        column._place = f"{layout._file}, [column] {k}"
    return layout


def write_layout(path: Path, layout: LoggerLayout, source: str, depths: Mapping[str, str]) -> None:
    """Keep a layout in a TOML file, for the other files of a recorder.

    source : name of the file that it was read from
    depths : column -> depth of its sensor as a person types it
    """
    columns = [c.model_copy(update={"depth": depths.get(c.name, c.depth)}) for c in layout.column]
    kept = layout.model_copy(update={"column": columns, "title": layout.title or f"as {source}"})
    data = {"format": FORMAT} | kept.model_dump(exclude_none=True, exclude_defaults=True)
    write_text_atomic(path, f"{schema_line('logger_layout')}\n{toml_text(data)}")
