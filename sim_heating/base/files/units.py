"""Units by name, as loggers, ranges and tools write them, and conversions between them: pint's definitions.

    value in base units = factor * value + offset

rad counts as a base unit, so an angle is not a plain number. Every reader of the project takes units from here:
`(deg. C)`, `BTU/ft2-s`, `W per sq. m`, `W m-2`, `W/m2K`. A text that is not understood is no unit, never another one.
What stands behind a slash without a point between divides: `W/m2K` is W/(m2 K). A letter that stands for a temperature
is one (`C`, `F`, `R`), and `mil` is a length. A share (`%`, `ppm`) is a unit alone, and no factor of another one.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from functools import cache
from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    import pint

SAME_FACTOR = 1e-12
"""Relative difference below which factors are equal: definitions are written with fifteen digits."""
NO_DIMENSION = ("", "1", "-")

SUPERSCRIPTS = str.maketrans("·⋅⁻⁰¹²³⁴⁵⁶⁷⁸⁹μ\u2212", "  -0123456789µ-")
"""Characters of printed units, and the form that is parsed."""
WORDS = {
    "mils": "thou", "inches": "inch", "celcius": "degC", "celsius": "degC", "centigrade": "degC", "degc": "degC",
    "fahrenheit": "degF", "degf": "degF", "kelvin": "K", "kelvins": "K", "degk": "K", "rankine": "degR", "degr": "degR",
    "sec": "s", "secs": "s", "second": "s", "seconds": "s", "min": "min", "mins": "min", "minute": "min",
    "minutes": "min", "hr": "h", "hrs": "h", "hour": "h", "hours": "h", "day": "day", "days": "day", "msec": "ms",
    "msecs": "ms", "millis": "ms", "millisec": "ms", "milliseconds": "ms", "usec": "us", "micros": "us",
    "microseconds": "us", "btu": "BTU", "btus": "BTU", "fps": "ft/s", "kts": "knot", "psf": "lbf/ft**2",
    "pcf": "lb/ft**3", "slugs": "slug", "feet": "ft", "meters": "m", "metres": "m", "watt": "W", "watts": "W",
    "psi": "psi", "psia": "psi", "gm": "g", "lbm": "lb", "volt": "V", "volts": "V",
    "ft": "ft", "km": "km", "slug": "slug", "deg": "deg", "rad": "rad",
    "sek": "s", "sekunden": "s", "minuten": "min", "stunden": "h",
    "rev": "turn", "revs": "turn", "rpm": "rpm", "rps": "rps", "upm": "rpm", "dps": "deg/s", "lpm": "L/min",
    "slpm": "slpm", "sccm": "atm*cm**3/min", "cfm": "ft**3/min", "gpm": "gallon/min", "amp": "A", "amps": "A",
    "bar": "bar", "bara": "bar", "torr": "torr",
}  # fmt: skip
"""Words in small letters -> the name that pint knows, whatever the letters are in the file."""
SIGNS = {
    "mbara": "mbar", "mBar": "mbar", "mTorr": "mtorr", "k": "K", "S": "s", "mil": "thou", '"': "inch",
    "\u2103": "degC", "\u2109": "degF", "oC": "degC", "oF": "degF",
}  # fmt: skip
LETTERS = {"C": "degC", "c": "degC", "F": "degF", "f": "degF", "R": "degR", **SIGNS}
"""Short names that pint takes for another unit, a charge, a capacity, a gas constant or an angle, or does not know."""
DEGREES = re.compile(
    r"(?i)(?:deg(?:s|ree|rees)?\.?|grad|\u00c2?\u00b0|[\u00ba\u02da\ufffd]|(?<![\w)*])[*?])[ _]*"
    r"(C|F|K|R|celsius|fahrenheit|kelvin|rankine)(?![A-Za-z])"
)
"""A degree of a temperature; the sign is a star, a question mark or a ring where an encoding has lost it."""
SCALES = {"c": "degC", "f": "degF", "k": "K", "r": "degR"}
DIFFERENCES = {"degC": "K", "degF": "degR"}
"""A scale with an offset -> its degree as a difference, in a unit that is made of several."""
SERIAL_NUMBER = re.compile(r"\s*\((?:LGR|SEN|S/N)[^()]*\)\s*$")
"""What HOBO loggers write behind a unit."""
STATED = (
    r"([^,]*\S)\s*,\s*([^,(]+?)\s*(?:\((?:LGR|SEN|S/N).*\))?",
    r"(.*?[^\s\[])\s*\[([^\]]*)\]",
    r"(.*?[^\s<])\s*<([^>]*)>",
    r"(.*?[^\s(])\s*\(((?:[^()]|\([^()]*\))*)\)\s*(?:c:\d+)?",
)
"""Patterns of a name with its unit behind a comma or in brackets."""
SLASHED = r"(.*\S)\s*/\s*(\S+)"
LONGEST = 100
"""Most characters of a unit; matching a text of 100,000 letters takes minutes."""
POWER = r"(?:(?:\*\*|\^)?[+-]?[0-9]{1,2}|(?:\*\*|\^)\([+-]?[0-9]{1,2}\))(?!\w|\.[0-9])"
UNIT_SYNTAX = re.compile(rf"(?:(?:[^\W\d]|[°%])++(?:{POWER})?|\)(?:{POWER})?|(?<![\w.])1(?= */)|[ .*/(])+")
"""Names with powers of at most two digits, parentheses, products, quotients, 1 over one: all that pint is given."""
LATEST_PREFIXES = ("ronto", "ronna", "quecto", "quetta")
"""Prefixes of 2022, which no logger writes: `rh` is a humidity, and no time."""
OTHER_FIELDS = ("elementary_charge", "parsec", "carat", "number_meter", "enzyme_unit", "year")
"""Units whose short names a logger means otherwise: `ue` is a strain, `ct` counts, `Nm3/h` a flow of gas, `_a` air."""
SPELLINGS = (
    (r"(?<![^\W\d])(?:r|U)/(?=(?:min|s)\b)", "rev/"),  # U for Umdrehung
    (r"(?<![A-Za-z])([mkuµ]?V) ?(?:DC|dc)\b", r"\1"),
    (r"(?<![A-Za-z])([mkM]?)(?:[Oo]hms?|OHMS?|[\u03a9\u2126])(?![A-Za-z])", r"\1ohm"),
    (r"(?i)(pa|bar|psi)(?: *\((?:a|abs)\)| (?:a|abs)\b|(?<=pa)a\b)", r"\1"),
    (r"(?<![A-Za-z])([kM]?N)m(?![\w^*\u00b2\u00b3])", r"\1*m"),
    (r"(?i)% *r\.?h\.?(?!\w)|\br\.?h\.? *%", "%"),
)
"""Patterns of what loggers write in a unit -> the unit alone: kinds of voltages and pressures, a relative humidity."""
GAUGE = re.compile(r"(?i)(?:pa|bar|psi) *(?:\(g\)|g\b)")
"""A pressure over that of the air, which no factor makes one."""
AMBIGUOUS = re.compile(r"/ *[^()/ .*]+ *[.*] *[^ /]")
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
    import pint  # slow to import, and files in the units of the contract need none

    return pint.UnitRegistry(cache_folder=None)


def _pint_syntax(name: str) -> str:
    """A unit as FMUs write it (`kg.m-3`, `m/s2`) as pint reads it (`kg*m**-3`, `m/s**2`)."""
    return re.sub(r"(?<=[^\W\d_])\^?([+-]?\d+)", r"**\1", name.replace(".", "*"))


def _plain(name: str) -> str:
    """A unit as loggers write it, in names that pint knows and the syntax of FMUs."""
    text = SERIAL_NUMBER.sub("", name).strip()
    while (inner := re.fullmatch(r"\(([^()]*)\)|\[([^\[\]]*)\]|<([^<>]*)>", text)) is not None:
        text = next(group for group in inner.groups() if group is not None).strip()
    text = re.sub(r"^([CFKR])[°º]$", r"\1", text)
    for pattern, plain in SPELLINGS:
        text = re.sub(pattern, plain, text)
    text = DEGREES.sub(lambda match: SCALES[match[1][0].lower()], text.translate(SUPERSCRIPTS).replace("²", "2"))
    text = re.sub(r"(?i)(?<![a-z])(?:square +|sq\.? *)([a-z]+)", r"\g<1>2", text)
    text = re.sub(r"(?i)(?<![a-z])(?:cu\. *|cu +|cubic +)([a-z]+)", r"\g<1>3", text)
    text = re.sub(r"(?i) +per +", "/", text)
    text = re.sub(r"(?i)\b(sec|mins?|hrs?|in|ft)\.(?=$|[ /)])", r"\1", text)
    text = re.sub(r"(?<=[A-Za-z0-9])-(?=[A-Za-zµ°])", " ", text)  # BTU/ft2-s
    text = re.sub(r"(?<=[A-Za-zµ][2-4])(?=[A-Za-zµ°])", " ", text)  # W/m2K
    text = re.sub(r"[A-Za-zµ\"\u2103\u2109]+", lambda word: _word(word[0]), text)
    # blanks behind a slash divide, as print has it: W/m2 K
    text = re.sub(r"/ *((?:[^()/ .*]|\*\*)+(?: +[^()/ .*]+)+)", lambda under: f"/({under[1]})", text)
    if not re.fullmatch(r" *[A-Za-z]+ *", text):
        text = re.sub("degC|degF", lambda scale: DIFFERENCES[scale[0]], text)
    return text


def _word(word: str) -> str:
    return LETTERS.get(word) or WORDS.get(word.lower()) or word


@cache
def known_unit(name: str) -> Scale | None:
    """The unit of a name according to pint; None where it is unknown or ambiguous.

    >>> [known_unit(n) == known_unit("degC") for n in ("C", "(deg. C)", "°C (LGR S/N: 1)", "*C", "coulomb")]
    [True, True, True, True, False]
    """
    if name in NO_DIMENSION:
        return Scale((), 1.0)
    if len(name) > LONGEST or GAUGE.search(name) is not None:
        return None
    plain = _plain(name)
    # A plain grammar before pint, which takes `m,s` for a millisecond and fails on `m.` in its tokenizer.
    if UNIT_SYNTAX.fullmatch(plain) is None or AMBIGUOUS.search(plain.replace("**", "^")) is not None:
        return None
    registry = _registry()
    try:
        unit = registry.parse_units(_pint_syntax(plain))
        if not _is_written(registry, unit):
            return None
        unity = registry.Quantity(1.0, unit).to_base_units()
        offset = float(registry.Quantity(0.0, unit).to_base_units().magnitude)
        # over a long span, so that an offset takes no digits of the factor
        span = 1.0 if offset == 0.0 else 2.0**30
        factor = float(registry.Quantity(span, unit).to_base_units().magnitude - offset) / span
        scale = Scale(dimension_of(dict(unity.unit_items())), factor, offset)
    except Exception:  # pint raises its own, Python's tokenizer others
        return None
    return scale if is_usable(scale) else None


def _is_written(registry: pint.UnitRegistry[Any], unit: Any) -> bool:
    """Whether anyone writes such a unit. `%s` and `ppm K` are a share times a unit; `%/s` is a rate."""
    powers = dict(dimension_of(dict(registry.Quantity(1.0, unit).unit_items())))
    if any(map(_is_of_other_fields, powers)):
        return False
    sides = ([n for n, power in powers.items() if sign * power > 0.0] for sign in (1.0, -1.0))
    shares = {n for n in powers if not dict(registry.Quantity(1.0, n).to_base_units().unit_items())}
    return all(len(side) < 2 or shares.isdisjoint(side) for side in sides)


def _is_of_other_fields(name: str) -> bool:
    return name.startswith(LATEST_PREFIXES) or name.endswith(OTHER_FIELDS)


def is_usable(scale: Scale) -> bool:
    """Whether factor and offset are finite and the factor is not 0."""
    return math.isfinite(scale.factor) and math.isfinite(scale.offset) and scale.factor != 0.0


def dimension_of(exponents: dict[str, Any]) -> tuple[tuple[str, float], ...]:
    """Exponents by base unit, those of 0 left out, in the order of their names."""
    return tuple(sorted((k, float(v)) for k, v in exponents.items() if v))


def conversion(source: Scale, required: Scale) -> Conversion | None:
    """The conversion between two units, None where their dimensions differ."""
    if source.dimension != required.dimension:
        return None
    factor, offset = source.factor / required.factor, (source.offset - required.offset) / required.factor
    # A factor of 1 but for rounding must leave every bit as it is.
    return Conversion(1.0 if abs(factor - 1.0) < SAME_FACTOR else factor, offset)


def converted(unit: str, si: str) -> Conversion | None:
    """The conversion of a unit to another one, None where it is unknown or one of another quantity.

    >>> converted("(deg. F)", "K")(212.0), converted("W per sq. m", "W/m2"), converted("mV", "K")
    (373.15, Conversion(factor=1.0, offset=0.0), None)
    """
    source, required = known_unit(unit), known_unit(si)
    return None if source is None or required is None else conversion(source, required)


def name_and_unit(head: str, quantities: Sequence[str]) -> tuple[str, str]:
    """Name and unit of the head of a column; the unit is empty where none is stated.

    head       : `TC1 [degC]`, `Temp, °F (LGR S/N: 1)`, `Time/s`, `vel_ft_s`, `rho [slug/ft3]`, `TC1 C`
    quantities : SI units; what follows a `_` or a blank is a unit only where it converts to one of them. What is in
                 brackets, or behind a slash or a comma, is returned as it is, known or not

    >>> name_and_unit("vel_ft_s", ["m/s"]), name_and_unit("T (mV)", ["K"]), name_and_unit("TC 1", ["K"])
    (('vel', 'ft/s'), ('T', 'mV'), ('TC 1', ''))
    """
    head = head.strip()
    inside = _unit_inside(head, quantities)
    for match in filter(None, (re.fullmatch(pattern, head) for pattern in STATED)):
        stated = match[2].strip()
        if not stated.isdigit() and (inside is None or known_unit(stated) is not None):
            return match[1].rstrip("/ ").strip(), stated
    if inside is not None:
        return f"{inside[1]} {inside[3].lstrip(', ')}".strip(), inside[2]
    if ended := _name_and_ending(head, quantities):
        return ended
    slashed = re.fullmatch(SLASHED, head)
    return (slashed[1], slashed[2]) if slashed else (head, "")


def _unit_inside(head: str, quantities: Sequence[str]) -> re.Match[str] | None:
    """Name, unit in brackets, and what follows behind them, as in `T (degC) of the wall`; None without such a unit."""
    match = re.fullmatch(r"(.*?\S)\s*[\[(]([^\[\]()]+)[\])]\s*(\S.*)", head)
    return match if match is not None and _converts(match[2], quantities) else None


def _name_and_ending(head: str, quantities: Sequence[str]) -> tuple[str, str] | None:
    """Name, and what follows a `_` or a blank, where that is a unit: `ft/s` of `vel_ft_s`."""
    for first in _endings(head):
        name, ending = head[:first].rstrip("_ "), head[first:].lstrip("_ ")
        top, *under = re.split("_", ending)
        for unit in (ending, f"{top}/{' '.join(under)}" if under else ""):
            if name and unit and _converts(unit, quantities):
                return name, unit
    return None


def _converts(unit: str, quantities: Sequence[str]) -> bool:
    return any(converted(unit, si) is not None for si in quantities)


def _endings(head: str) -> list[int]:
    """Where an ending may begin: at each `_` and blank, the longest ending first."""
    return [k.start() for k in re.finditer(r"[_ ]+", head)]
