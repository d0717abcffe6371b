"""Numbers with units as people type them, `0.4 mm`, `2 kW/m2`, `21 degC`, in SI units."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

from sim_heating.base.conditions import DESCRIPTIONS
from sim_heating.base.errors import InputError
from sim_heating.base.files import display_path, plain_number, suggestion
from sim_heating.base.files.units import converted, known_unit
from sim_heating.base.limits import quantity as range_of
from sim_heating.heating.recorded.fields import ConditionField, column_unit

NUMBER = r"[+-]?(?:\d+(?:[.,]\d*)?|[.,]\d+)(?:[eE][+-]?\d+)?"
"""Pattern of a number, with a decimal point or a decimal comma."""


def quantity(text: str, unit: str, option: str, example: str, key: str = "") -> float:
    """A number with a unit in SI units. Only a 0 may stand without one, where it is the same in all units.

    unit    : SI unit of the result, as `m`, `K`, `W/m2`
    option  : what the number is of, for messages
    example : how it may be written, for messages
    key     : of a declared file, whose range holds for the number, as `initial_K`; that of a standard deviation of a
              temperature, `noise_sigma_K`, is of differences: 1 degC is 1 K
    raises  : InputError, one line, where it is no number, its unit is absent, unknown or of another quantity, or it is
              out of the range of its key
    """
    match = re.fullmatch(rf"\s*({NUMBER})\s*(.*?)\s*", text)
    if match is None:
        raise InputError(f"{option}: `{text}` is not a number with a unit; write {example}")
    value = plain_number(match[1].replace(",", "."))
    is_difference = key.endswith("sigma_K")
    if not match[2] and (value != 0.0 or (unit == "K" and not is_difference)):
        raise InputError(f"{option}: `{text.strip()}` has no unit; write {example}")
    scale = converted(match[2] or unit, unit)
    if scale is None:
        raise InputError(f"{option}: `{match[2]}` is not a unit that converts to {unit}; write {example}")
    # rounded to what a person types: 21 degC is 294.15 K, not 294.15000000000003 K
    si = float(f"{scale.factor * value + (0.0 if is_difference else scale.offset):.12g}")
    limits = range_of(key)
    if limits is not None and (problem := limits.problem(si)) is not None:
        raise InputError(f"{option}: `{text.strip()}`: {problem}")
    return si


def stated_fields(texts: Mapping[str, str]) -> dict[str, ConditionField]:
    """What options `--field COLUMN=TEXT` state by column: a field, `NAME:UNIT`, or a constant with its unit, `0deg`.

    raises : InputError, one line, for a column that is none and a constant of another quantity
    """
    return {column: _stated_field(column, text) for column, text in texts.items()}


def _stated_field(column: str, text: str) -> ConditionField:
    if column not in DESCRIPTIONS:
        raise InputError(f"--field {column}: unknown column of flight conditions{suggestion(column, DESCRIPTIONS)}")
    name, colon, unit = text.rpartition(":")
    if colon and name and known_unit(unit) is not None:
        return ConditionField(field=name, unit=unit)
    if re.fullmatch(rf"{NUMBER}\s*\S*", text) is None:
        return ConditionField(field=text)
    plain = column_unit(column)
    if not plain:
        return ConditionField(constant=plain_number(text.replace(",", ".")))
    return ConditionField(constant=quantity(text, plain, f"--field {column}", f"--field {column}=0{plain}", column))


def require_known(names: dict[str, str], columns: list[str], option: str, path: Path) -> None:
    """Refuse names of an option that no column of a file has.

    raises : InputError with the file and the nearest known name
    """
    for name in names:
        if name not in columns:
            where = f"in {display_path(path)}"
            raise InputError(f"{option} {name}: there is no such column {where}{suggestion(name, columns)}")
