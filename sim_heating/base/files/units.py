"""Units by name, as pint knows them, and conversions between them.

    value in base units = factor * value + offset

rad counts as a base unit, so an angle is not a plain number.
"""

from __future__ import annotations

import math
import re
from functools import cache
from typing import Any, NamedTuple

import pint

SAME_FACTOR = 1e-12
"""Relative difference below which factors are equal: definitions are written with fifteen digits."""
NO_DIMENSION = ("", "1", "-")

SUPERSCRIPTS = str.maketrans("·⁻⁰¹²³⁴⁵⁶⁷⁸⁹", ".-0123456789")
"""Characters of printed units, and the ASCII form that FMUs use."""
LONGEST = 100
"""Most characters of a unit; matching a text of 100,000 letters takes minutes."""
POWER = r"(?:(?:\*\*|\^)?[+-]?[0-9]{1,2}|(?:\*\*|\^)\([+-]?[0-9]{1,2}\))(?!\w|\.[0-9])"
UNIT_SYNTAX = re.compile(rf"(?:(?:[^\W\d]|[°%])++(?:{POWER})?|\)(?:{POWER})?|(?<![\w.])1(?![\w.])|[ .*/(])+")
"""Names with powers of at most two digits, parentheses, products, quotients, and 1: the only texts passed to pint."""
AMBIGUOUS = re.compile(r"/ *[^()/ .*]+ *[ .*] *[^ /]")
"""A product after a quotient, `1/s.m`, which may belong to the numerator or the denominator."""


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

    def inverse(self, value: float) -> float:
        """The inverse conversion."""
        return value if self == (1.0, 0.0) else (value - self.offset) / self.factor


@cache
def _registry() -> pint.UnitRegistry[Any]:
    return pint.UnitRegistry(cache_folder=None)


def _pint_syntax(name: str) -> str:
    """A unit as FMUs write it (`kg.m-3`, `m/s2`) as pint reads it (`kg*m**-3`, `m/s**2`)."""
    return re.sub(r"(?<=[^\W\d_])\^?([+-]?\d+)", r"**\1", name.replace(".", "*"))


@cache
def known_unit(name: str) -> Scale | None:
    """The unit of a name according to pint; None where it is unknown or ambiguous."""
    if name in NO_DIMENSION:
        return Scale((), 1.0)
    plain = name.translate(SUPERSCRIPTS)
    # A plain grammar before pint, which takes `m,s` for a millisecond and fails on `m.` in its tokenizer.
    if len(plain) > LONGEST:
        return None
    if UNIT_SYNTAX.fullmatch(plain) is None or AMBIGUOUS.search(plain.replace("**", "^")) is not None:
        return None
    registry = _registry()
    try:
        unit = registry.parse_units(_pint_syntax(plain))
        zero, one = (registry.Quantity(v, unit).to_base_units() for v in (0.0, 1.0))
        factor, offset = float(one.magnitude - zero.magnitude), float(zero.magnitude)
        scale = Scale(dimension_of(dict(one.unit_items())), factor, offset)
    except Exception:  # pint raises its own, Python's tokenizer others
        return None
    return scale if is_usable(scale) else None


def is_usable(scale: Scale) -> bool:
    """Whether factor and offset are finite and the factor is not 0."""
    return math.isfinite(scale.factor) and math.isfinite(scale.offset) and scale.factor != 0.0


def dimension_of(exponents: dict[str, Any]) -> tuple[tuple[str, float], ...]:
    """Exponents by base unit, those of 0 left out, in the order of their names."""
    return tuple(sorted((k, float(v)) for k, v in exponents.items() if v))


def conversion(given: Scale, required: Scale) -> Conversion | None:
    """The conversion between two units, None where their dimensions differ."""
    if given.dimension != required.dimension:
        return None
    factor, offset = given.factor / required.factor, (given.offset - required.offset) / required.factor
    # A factor of 1 but for rounding must leave every bit as it is.
    return Conversion(1.0 if abs(factor - 1.0) < SAME_FACTOR else factor, offset)
