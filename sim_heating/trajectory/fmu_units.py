"""Units of FMU variables: what an FMU defines, what pint knows by name, and the way from one unit to another.

An FMU defines a unit by exponents of the seven SI base units and rad, a factor and an offset,

    value in base units = factor * value + offset        FMI 3.0.2, 2.4.4 (FMI 2.0.4, 2.2.2)

and pint knows the same of a name. rad counts as a base unit in both, so that an angle is no plain number.
"""

from __future__ import annotations

import math
import re
from functools import cache
from typing import Any, NamedTuple

import pint
from fmpy.model_description import BaseUnit

from sim_heating.errors import InputError

SAME = 1e-12
"""Factors this close are one: definitions are written with fifteen digits."""
AGREES = 1e-4
"""An FMU's definition of a known name may be this far off: many are written with few digits."""
BASE = {
    "kg": "kilogram", "m": "meter", "s": "second", "A": "ampere", "K": "kelvin", "mol": "mole", "cd": "candela",
    "rad": "radian",
}  # fmt: skip
"""FMI's base units and pint's names of them."""
NO_DIMENSION = ("", "1", "-")


class Scale(NamedTuple):
    """A unit: value in base units = factor * value + offset; dimension is ((pint's base unit, exponent), ...)."""

    dimension: tuple[tuple[str, float], ...]
    factor: float
    offset: float = 0.0


class Conversion(NamedTuple):
    """Converted value = factor * value + offset; (1, 0) leaves every bit as it is."""

    factor: float
    offset: float

    def __call__(self, value: float) -> float:
        """The converted value."""
        return value if self == (1.0, 0.0) else self.factor * value + self.offset

    def back(self, value: float) -> float:
        """The value that is converted into this one."""
        return value if self == (1.0, 0.0) else (value - self.offset) / self.factor


@cache
def _registry() -> pint.UnitRegistry[Any]:
    return pint.UnitRegistry(cache_folder=None)


def _in_words(name: str) -> str:
    """A unit as FMUs write it (`kg.m-3`, `m/s2`) as pint reads it (`kg*m**-3`, `m/s**2`)."""
    product = re.sub(r"(?<!\d)\.|\.(?!\d)", "*", name)
    return re.sub(r"(?<=[A-Za-z])\^?(-?\d+)", r"**\1", product)


@cache
def known_unit(name: str) -> Scale | None:
    """What pint knows of a unit's name, None where it knows none."""
    if name in NO_DIMENSION:
        return Scale((), 1.0)
    registry = _registry()
    try:
        unit = registry.parse_units(_in_words(name))
        zero, one = (registry.Quantity(v, unit).to_base_units() for v in (0.0, 1.0))
    except (pint.errors.PintError, ValueError, TypeError, AttributeError, ArithmeticError):
        return None
    return Scale(_dimension(dict(one.unit_items())), float(one.magnitude - zero.magnitude), float(zero.magnitude))


def defined_unit(base: BaseUnit) -> Scale:
    """What an FMU defines."""
    exponents = {long: getattr(base, short) for short, long in BASE.items()}
    return Scale(_dimension(exponents), float(base.factor), float(base.offset))


def _dimension(exponents: dict[str, Any]) -> tuple[tuple[str, float], ...]:
    return tuple(sorted((k, float(v)) for k, v in exponents.items() if v))


def unit_of_fmu(name: str, definition: BaseUnit | None) -> Scale:
    """The scale of a unit that an FMU names, by its own definition where it gives one.

    raises : InputError where nobody knows the unit, or where the definition contradicts the name
    """
    known = known_unit(name)
    if definition is None:
        if known is None:
            raise InputError(f"unit `{name}` is defined neither by the FMU nor by pint; give `unit`")
        return known
    own = defined_unit(definition)
    if known is not None and not _agree(own, known):
        raise InputError(
            f"the FMU defines `{name}` as {_told(own)}, which by its name is {_told(known)}; give `unit` to settle it"
        )
    return own


def _agree(a: Scale, b: Scale) -> bool:
    close = math.isclose(a.factor, b.factor, rel_tol=AGREES) and math.isclose(a.offset, b.offset, rel_tol=AGREES)
    return a.dimension == b.dimension and close


def _told(scale: Scale) -> str:
    short = {long: s for s, long in BASE.items()}
    units = " ".join(short.get(k, k) + ("" if e == 1.0 else f"{e:g}") for k, e in scale.dimension) or "1"
    return f"{scale.factor:.6g} {units}" + (f" + {scale.offset:g}" if scale.offset else "")


def conversion(given: Scale, wanted: Scale) -> Conversion | None:
    """The way from one unit to another, None where they measure different things."""
    if given.dimension != wanted.dimension:
        return None
    factor, offset = given.factor / wanted.factor, (given.offset - wanted.offset) / wanted.factor
    return Conversion(1.0 if abs(factor - 1.0) < SAME else factor, offset)
