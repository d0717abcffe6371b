"""Which values a variable of an FMU takes: any number, whole ones of its type's range, an item, or true and false."""

from __future__ import annotations

import re

from fmpy.model_description import ModelVariable

from sim_heating.errors import InputError

Value = bool | int | float | str


def fitting(variable: ModelVariable, value: Value) -> bool | int | float:
    """A scenario's value as a variable takes it.

    raises : InputError where it takes no such value, with those that it takes
    """
    told = str(value).lower() if isinstance(value, bool) else str(value)
    if variable.type == "Boolean":
        if value in (0, 1):
            return bool(value)
        raise InputError(f"`{told}` is neither true nor false")
    if items := _items(variable):
        if value in items and not isinstance(value, bool):
            return int(value)
        raise InputError(f"`{told}` is none of its items: {', '.join(f'{k} ({n})' for k, n in items.items())}")
    if isinstance(value, bool | str):
        raise InputError(f"`{told}` is not a number, and `{variable.name}` is a {variable.type}")
    if str(variable.type).startswith(("Real", "Float")):
        return value
    lowest, highest = _range(str(variable.type))
    if not lowest <= value <= highest or value != int(value):
        raise InputError(f"`{told}` is no whole number from {lowest} to {highest}, as `{variable.name}` takes")
    return int(value)


def item_named(variable: ModelVariable, name: str) -> int | None:
    """The number of an enumeration's item."""
    return next((number for number, own in _items(variable).items() if own == name), None)


def _items(variable: ModelVariable) -> dict[int, str]:
    return {} if variable.declaredType is None else {int(i.value): i.name for i in variable.declaredType.items}


def _range(kind: str) -> tuple[int, int]:
    """Least and greatest value of FMI 3's Int8 to UInt64; FMI 2's Integer and an enumeration have 32 bits."""
    unsigned, bits = kind.startswith("U"), int((re.search(r"\d+", kind) or ["32"])[0])
    return (0, 2**bits - 1) if unsigned else (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1)
