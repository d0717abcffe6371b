"""Units of FMU variables: definitions of the FMU, names known to pint, and conversions between them.

An FMU defines a unit by exponents of the seven SI base units and rad, a factor and an offset,

    value in base units = factor * value + offset        FMI 3.0.2, 2.4.4 (FMI 2.0.4, 2.2.2)

and pint provides the same for a name. rad counts as a base unit in both, so an angle is not a plain number.
"""

from __future__ import annotations

import math
import re
from functools import cache
from typing import Any, NamedTuple

import pint
from fmpy.model_description import BaseUnit

from sim_heating.base.errors import InputError

SAME_FACTOR = 1e-12
"""Relative difference below which factors are equal: definitions are written with fifteen digits."""
DEFINITION_TOLERANCE = 1e-4
"""Relative tolerance of an FMU's definition of a known unit: many are written with few digits."""
BASE = {
    "kg": "kilogram", "m": "meter", "s": "second", "A": "ampere", "K": "kelvin", "mol": "mole", "cd": "candela",
    "rad": "radian",
}  # fmt: skip
"""FMI's base units and their names in pint."""
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
        scale = Scale(_dimension(dict(one.unit_items())), float(one.magnitude - zero.magnitude), float(zero.magnitude))
    except Exception:  # pint raises its own, Python's tokenizer others
        return None
    return scale if _is_usable(scale) else None


def defined_unit(base: BaseUnit) -> Scale:
    """The unit that an FMU defines."""
    exponents = {long: getattr(base, short) for short, long in BASE.items()}
    return Scale(_dimension(exponents), float(base.factor), float(base.offset))


def _is_usable(scale: Scale) -> bool:
    return math.isfinite(scale.factor) and math.isfinite(scale.offset) and scale.factor != 0.0


def _dimension(exponents: dict[str, Any]) -> tuple[tuple[str, float], ...]:
    return tuple(sorted((k, float(v)) for k, v in exponents.items() if v))


def unit_of_fmu(name: str, definition: BaseUnit | None) -> Scale:
    """The scale of a unit that an FMU names, by its own definition where it gives one.

    raises : InputError where the unit is unknown, or its definition is unusable or contradicts the name
    """
    known = known_unit(name)
    if definition is None:
        if known is None:
            raise InputError(f"unit `{name}` is defined neither by the FMU nor by pint; give `unit`")
        return known
    own = defined_unit(definition)
    if not _is_usable(own):
        raise InputError(
            f"the FMU defines `{name}` by factor {own.factor:g} and offset {own.offset:g}, which is not a unit; "
            "give `unit`"
        )
    if known is not None and not _agree(own, known):
        raise InputError(
            f"the FMU defines `{name}` as {_scale_text(own)}, but the name means {_scale_text(known)}; give `unit`"
        )
    return own


def _agree(a: Scale, b: Scale) -> bool:
    pairs = ((a.factor, b.factor), (a.offset, b.offset))
    return a.dimension == b.dimension and all(math.isclose(x, y, rel_tol=DEFINITION_TOLERANCE) for x, y in pairs)


def _scale_text(scale: Scale) -> str:
    short = {long: s for s, long in BASE.items()}
    units = " ".join(short.get(k, k) + ("" if e == 1.0 else f"{e:g}") for k, e in scale.dimension) or "1"
    return f"{scale.factor:.6g} {units}" + (f" + {scale.offset:g}" if scale.offset else "")


def conversion(given: Scale, required: Scale) -> Conversion | None:
    """The conversion between two units, None where their dimensions differ."""
    if given.dimension != required.dimension:
        return None
    factor, offset = given.factor / required.factor, (given.offset - required.offset) / required.factor
    # A factor of 1 but for rounding must leave every bit as it is.
    return Conversion(1.0 if abs(factor - 1.0) < SAME_FACTOR else factor, offset)
