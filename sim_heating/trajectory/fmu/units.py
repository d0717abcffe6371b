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

from sim_heating.base.errors import InputError

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

RAISED = str.maketrans("·⁻⁰¹²³⁴⁵⁶⁷⁸⁹", ".-0123456789")
"""Signs of printed units and how FMUs write them."""
POWER = r"(?:(?:\*\*|\^)?[+-]?[0-9]{1,2}|(?:\*\*|\^)\([+-]?[0-9]{1,2}\))(?!\w|\.[0-9])"
WRITTEN = re.compile(rf"(?:(?:[^\W\d]|[°%])++(?:{POWER})?|\)(?:{POWER})?|(?<![\w.])1(?![\w.])|[ .*/(])+")
"""Names with powers of at most two digits, parentheses, products, quotients, and 1: all that pint is given to read."""
UNCLEAR = re.compile(r"/ *[^()/ .*]+ *[ .*] *[^ /]")
"""A product after a quotient, `1/s.m`, of which nobody knows where it stands."""


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
    return re.sub(r"(?<=[^\W\d_])\^?([+-]?\d+)", r"**\1", name.replace(".", "*"))


@cache
def known_unit(name: str) -> Scale | None:
    """What pint knows of a unit's name, None where it knows none or nobody can tell how it is to be read."""
    if name in NO_DIMENSION:
        return Scale((), 1.0)
    plain = name.translate(RAISED)
    if WRITTEN.fullmatch(plain) is None or UNCLEAR.search(plain.replace("**", "^")) is not None:
        return None
    registry = _registry()
    try:
        unit = registry.parse_units(_in_words(plain))
        zero, one = (registry.Quantity(v, unit).to_base_units() for v in (0.0, 1.0))
        scale = Scale(_dimension(dict(one.unit_items())), float(one.magnitude - zero.magnitude), float(zero.magnitude))
    except Exception:  # pint raises its own, Python's tokenizer others
        return None
    return scale if _measures(scale) else None


def defined_unit(base: BaseUnit) -> Scale:
    """What an FMU defines."""
    exponents = {long: getattr(base, short) for short, long in BASE.items()}
    return Scale(_dimension(exponents), float(base.factor), float(base.offset))


def _measures(scale: Scale) -> bool:
    return math.isfinite(scale.factor) and math.isfinite(scale.offset) and scale.factor != 0.0


def _dimension(exponents: dict[str, Any]) -> tuple[tuple[str, float], ...]:
    return tuple(sorted((k, float(v)) for k, v in exponents.items() if v))


def unit_of_fmu(name: str, definition: BaseUnit | None) -> Scale:
    """The scale of a unit that an FMU names, by its own definition where it gives one.

    raises : InputError where nobody knows the unit, or where the definition measures nothing or contradicts the name
    """
    known = known_unit(name)
    if definition is None:
        if known is None:
            raise InputError(f"unit `{name}` is defined neither by the FMU nor by pint; give `unit`")
        return known
    own = defined_unit(definition)
    if not _measures(own):
        raise InputError(
            f"the FMU defines `{name}` by factor {own.factor:g} and offset {own.offset:g}, which measures nothing; "
            "give `unit`"
        )
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
