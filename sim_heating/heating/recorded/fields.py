"""Fields of a file or of a message -> columns of flight conditions, by the names and units that they state.

A field states its unit in its name, `Altitude (ft)`, `rho [slug/ft3]`, `vel_ft_s`, `alt/km`, or in a row of units
below the names. What states none, or one that is not known, is asked for; nothing is converted by a guess.

    column = factor field + offset                    by the units (sim_heating.base.files.units)

Names are those of ranges and of the exports of JSBSim, OpenRocket and RocketPy. One vocabulary serves every reader of
conditions: `new record --conditions`, recorded trajectories, records, soundings, and live links.
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

from pydantic import Field, model_validator

from sim_heating.base.conditions import DESCRIPTIONS
from sim_heating.base.errors import InputError
from sim_heating.base.files import Declared, LocatedError, Location, raise_located, raise_problems, suggestion
from sim_heating.base.files.units import NO_DIMENSION, Conversion, conversion, converted, known_unit, name_and_unit

_QUOTIENTS = {"m_s": "m/s", "kg_m3": "kg/m3", "W_m2": "W/m2", "kg_m2_s": "kg/(m2.s)", "J_kg": "J/kg"}
UNITS = {**{unit: unit for unit in ("s", "m", "deg", "K", "Pa")}, **_QUOTIENTS, "g": "", "": ""}
"""Ending of a column's name -> its unit for pint; what has no unit is a plain number."""
REYNOLDS, SOUND, GEOPOTENTIAL = "reynolds", "sound_m_s", "geopotential_m"
"""What a file may state in place of a column: Reynolds number [-], speed of sound [m/s], geopotential height [m]."""
VOCABULARY: dict[str, tuple[str, ...]] = {
    "time_s": ("time", "t", "elapsed time", "mission time", "flight time", "met", "seconds", "clock", "sim time"),
    "altitude_m": (
        "altitude", "alt", "altitude asl", "altitude msl", "alt msl", "alt asl", "altitude above sea level",
        "geometric altitude", "geodetic altitude", "gps altitude", "h", "h sl", "height", "height above sea level",
        "geometric height", "z",
    ),
    GEOPOTENTIAL: ("geopotential height", "geopotential altitude", "geopotential alt", "geopotential", "hght", "gph"),
    "velocity_m_s": (
        "velocity", "vel", "speed", "v", "total velocity", "velocity total", "v total", "vtotal", "vt", "airspeed",
        "air speed", "true airspeed", "true air speed", "tas", "vtas", "v tas", "vtrue", "v true", "v rel",
        "relative velocity", "velocity relative", "air relative velocity", "velocity magnitude",
        "speed velocity magnitude", "freestream speed", "free stream speed", "freestream velocity", "v inf",
    ),
    "mach": ("mach", "mach number", "mach no", "ma", "m", "m inf"),
    "alpha_deg": ("alpha", "aoa", "angle of attack", "attack angle"),
    "beta_deg": ("beta", "aos", "sideslip", "sideslip angle", "angle of sideslip", "angle of side slip"),
    REYNOLDS: ("reynolds number", "reynolds", "re", "reynolds no"),
    "log10_re": ("log10 re", "log re", "log10 reynolds number"),
    "rho_kg_m3": (
        "rho", "density", "air density", "atmospheric density", "atmosphere density", "density of air",
        "ambient density", "mass density", "total mass density", "rho inf", "freestream density",
    ),
    "T_inf_K": (
        "temperature", "temp", "t", "air temperature", "air temp", "ambient temperature", "static temperature",
        "atmospheric temperature", "atmosphere temperature", "t inf", "t static", "t air", "oat",
        "temperature neutral", "neutral temperature",
    ),
    "p_inf_Pa": (
        "pressure", "press", "pres", "p", "air pressure", "ambient pressure", "static pressure", "p ambient",
        "p static", "atmospheric pressure", "atmosphere pressure", "p inf", "baro", "barometric pressure",
    ),
    SOUND: ("speed of sound", "sound speed", "a inf"),
    "q_Pa": ("q", "q bar", "qbar", "dynamic pressure", "q inf", "dyn press"),
    "p_surface_Pa": ("surface pressure", "p surface", "wall pressure", "local pressure"),
    "elevon_deg": ("elevon", "elevon deflection", "elevon position"),
    "bodyflap_deg": ("bodyflap", "body flap", "body flap deflection", "bodyflap position"),
    "q_add_W_m2": ("q add",),
    "h_ref_kg_m2_s": ("h ref",),
    "H_r_J_kg": ("recovery enthalpy",),
}  # fmt: skip
"""Column -> names of it in small letters, words apart; a name of several columns is the one that its unit fits."""
PLAIN = ("mach", "log10_re", "jets", REYNOLDS)
"""Columns that are numbers without a unit."""
AS_IT_IS = Conversion(1.0, 0.0)
CLOSING = ")]>"
NAUTICAL = "nm"
"""A nanometre, and in flights a nautical mile: asked for."""
FACTOR = r"(?i)(.*?\S) ?[x*\u00d7] ?(?:10+|1e[+-]?\d+|10\^[+-]?\d+)"
"""A name that ends in the factor of its numbers, `rho x 1e6`."""
MACH_UNITS = ("mach", "Mach", "MACH", "Ma")


class ConditionField(Declared):
    """A column of flight conditions: the field that holds it with its unit, or a constant in the column's unit."""

    quantities: ClassVar = {"constant": None}

    field: str | None = Field(default=None, min_length=1, description="name of the field")
    unit: str | None = Field(
        default=None, description="unit of the field; that of its name, else that of the column, where absent"
    )
    constant: float | None = Field(default=None, description="value at all times, in the unit of the column")

    @model_validator(mode="after")
    def _check_one(self) -> ConditionField:
        if (self.field is None) == (self.constant is None):
            raise ValueError("give either `field` or `constant`, not both and not neither")
        if self.constant is not None and self.unit is not None:
            raise LocatedError((("unit",), "is that of a field; a constant is in the unit of its column"))
        return self


def field_or_table(value: Any) -> str:
    """Which of the two forms a declared field has: the name of it, or a table."""
    return "field" if isinstance(value, str) else "table"


def check_columns(fields: dict[str, Any], of_time: str = "") -> dict[str, Any]:
    """Declared fields whose columns all are flight conditions.

    of_time : rule of a message about `time_s`, where that is not declared here
    raises  : LocatedError for a column that is none
    """
    names = [name for name in DESCRIPTIONS if name != "time_s" or not of_time]
    problems: list[tuple[Location, str]] = [
        ((name,), of_time if name == "time_s" else f"unknown column of flight conditions{suggestion(name, names)}")
        for name in fields
        if name not in names
    ]
    raise_located(problems)
    return fields


@dataclass(frozen=True)
class FlightField:
    """A field that is a column of flight conditions.

    name    : of the field in the file
    column  : of flight conditions
    unit    : as stated; None where none is, and the field is asked for
    convert : to the unit of the column
    """

    name: str
    column: str
    unit: str | None
    convert: Conversion

    @property
    def is_plain(self) -> bool:
        """Whether it is a column by name and unit already."""
        return self.name == self.column and self.convert == AS_IT_IS


def column_unit(column: str) -> str:
    """Unit of a column of flight conditions, such as [m/s], by the end of its name, as pint reads it; "" for a plain
    number.

    >>> column_unit("h_ref_kg_m2_s"), column_unit("mach"), column_unit("alpha_deg")
    ('kg/(m2.s)', '', 'deg')
    """
    parts = column.split("_")
    for first in range(1, len(parts)):
        if (ending := "_".join(parts[first:])) in UNITS:
            return UNITS[ending]
    return ""


QUANTITIES = tuple(dict.fromkeys(unit for column in VOCABULARY if (unit := column_unit(column))))
"""Units of the columns: what the end of a name has to convert to, to be a unit."""


def unit_conversion(unit: str, required: str, location: str) -> Conversion:
    """The conversion from a unit to another one, such as [ft] to [m].

    location : for the message, as `popu.toml, [conditions]: altitude_m`
    raises   : InputError where pint does not know the unit, or it measures something else
    """
    scale, target = known_unit(unit), known_unit(required)
    if scale is None or target is None:
        raise InputError(f"{location}: unknown unit `{unit}`; give one that pint knows, such as `{required or '1'}`")
    result = conversion(scale, target)
    if result is None:
        raise InputError(f"{location}: unit `{unit}` does not convert to `{required or '1'}`; correct the unit")
    return result


def unit_of_name(name: str, column: str) -> str | None:
    """The unit, such as [ft], that a field's name states for a column, None where it states none that fits.

    >>> unit_of_name("h_ft", "altitude_m"), unit_of_name("V [kts]", "velocity_m_s"), unit_of_name("v", "velocity_m_s")
    ('ft', 'kts', None)
    """
    unit = _name_and_unit(name)[1]
    return unit if unit and _conversion(unit, column) is not None else None


def field_of_name(name: str, unit: str | None = None) -> FlightField | None:
    """The column of flight conditions that a field is by its name and unit; None where it is none.

    unit : of a row of units below the names, None without one

    >>> field_of_name("vel_ft_s").column, round(field_of_name("V_{Total} (ft/s)").convert.factor, 12)
    ('velocity_m_s', 0.3048)
    >>> field_of_name("Velocity (Mach)").column, field_of_name("Altitude").unit, field_of_name("Gear Position (deg)")
    ('mach', None, None)
    """
    if name in DESCRIPTIONS and unit is None:
        return FlightField(name, name, column_unit(name), AS_IT_IS)
    base, stated = _name_and_unit(name) if unit is None else (name, unit)
    if factor := re.fullmatch(FACTOR, base):
        of_factor = field_of_name(factor[1])
        return None if of_factor is None else replace(of_factor, name=name, unit=None, convert=AS_IT_IS)
    columns = _columns(base)
    if (with_unit := _field_with_unit(name, columns, stated)) is not None:
        return with_unit
    is_ending = unit is None and name.rstrip()[-1:] not in CLOSING
    columns = _columns(_visible(name)) if stated and is_ending else columns
    return _field_without_unit(name, columns, stated)


def _field_with_unit(name: str, columns: Sequence[str], unit: str) -> FlightField | None:
    """The first of several columns that a unit converts to; None where it converts to none."""
    if unit in MACH_UNITS and "velocity_m_s" in columns:
        return FlightField(name, "mach", unit, AS_IT_IS)
    of_column = {column: _conversion(unit, column) for column in columns if unit}
    return next((FlightField(name, c, unit, convert) for c, convert in of_column.items() if convert is not None), None)


def _field_without_unit(name: str, columns: Sequence[str], stated: str) -> FlightField | None:
    """The first of several columns; its unit is asked for, but of a plain number with which no other unit stands."""
    if not columns:
        return None
    return FlightField(name, columns[0], "" if columns[0] in PLAIN and not stated else None, AS_IT_IS)


def _conversion(unit: str, column: str) -> Conversion | None:
    """The conversion from a unit to that of a column; None where the unit is not known, or of something else."""
    target = "" if column in PLAIN else column_unit(column)
    if (unit in NO_DIMENSION) != (target == "") or unit == NAUTICAL:
        return None
    return converted(unit, target)


def _name_and_unit(text: str) -> tuple[str, str]:
    """Name and unit of a field; the unit is empty where none is stated."""
    return name_and_unit(_visible(text), QUANTITIES)


def _visible(text: str) -> str:
    """A text without characters that have no glyph, such as the blank of no width that OpenRocket has for a unit."""
    return "".join(c for c in text if unicodedata.category(c) != "Cf").strip().strip("\"'")


def _columns(base: str) -> list[str]:
    """Columns that a name without its unit may be, in the order of the vocabulary."""
    if base.strip() == "T":  # a time is written small
        return ["T_inf_K"]
    apart = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", base)
    spelled = {" ".join(re.findall(r"[a-z]+|\d+", text.lower())).replace("log 10", "log10") for text in (base, apart)}
    return [column for column, names in VOCABULARY.items() if spelled & set(names)]


def columns_of_fields(
    names: Sequence[str], units: Mapping[str, str], stated: Mapping[str, ConditionField | str]
) -> dict[str, list[FlightField]]:
    """Fields of a file by the column that each of them is; several of one column are in the order of the file.

    names  : of all fields
    units  : field -> its unit in a row of units
    stated : column -> field, or field with unit, that prevails over the names
    raises : InputError, one line a problem, for a unit that does not fit and a field that is not there
    """
    by_column = {column: [field] for column, field in _stated_fields(names, units, stated).items()}
    used = {f.name for fields in by_column.values() for f in fields}
    for name in names:
        named_field = None if name in used else field_of_name(name, units.get(name))
        if named_field is not None and named_field.column not in stated:
            by_column.setdefault(named_field.column, []).append(named_field)
    return by_column


def _stated_fields(
    names: Sequence[str], units: Mapping[str, str], stated: Mapping[str, ConditionField | str]
) -> dict[str, FlightField]:
    """Column -> the field of a file that is stated to be it, constants aside.

    raises : InputError, one line a problem, for a unit that does not fit and a field that is not there
    """
    fields: dict[str, FlightField] = {}
    problems: list[str] = []
    for column, declared in stated.items():
        named = ConditionField(field=declared) if isinstance(declared, str) else declared
        if named.field is None:
            continue
        if named.field not in names:
            problems.append(f"`{column}`: there is no field `{named.field}`; the file has {', '.join(names)}")
            continue
        unit = named.unit or units.get(named.field) or unit_of_name(named.field, column) or column_unit(column)
        try:
            convert = unit_conversion(unit, column_unit(column), f"`{column}`")
        except InputError as error:
            problems += error.problems
            continue
        fields[column] = FlightField(named.field, column, unit, convert)
    raise_problems(problems)
    return fields
