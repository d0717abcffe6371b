"""Units of FMU variables: definitions of the FMU, names known to pint, and conversions between them.

An FMU defines a unit by exponents of the seven SI base units and rad, a factor and an offset,

    value in base units = factor * value + offset        FMI 3.0.2, 2.4.4 (FMI 2.0.4, 2.2.2)

and pint provides the same for a name. rad counts as a base unit in both, so an angle is not a plain number.

Source: Modelica Association (2022), "Functional Mock-up Interface Specification 3.0".
"""

from __future__ import annotations

import math

from fmpy.model_description import BaseUnit

from sim_heating.base.errors import InputError
from sim_heating.base.files.units import LETTERS, Scale, dimension_of, is_usable, known_unit

DEFINITION_TOLERANCE = 1e-4
"""Relative tolerance of an FMU's definition of a known unit: many are written with few digits."""
BASE = {
    "kg": "kilogram",
    "m": "meter",
    "s": "second",
    "A": "ampere",
    "K": "kelvin",
    "mol": "mole",
    "cd": "candela",
    "rad": "radian",
}
"""FMI's base units and their names in pint."""


def defined_unit(base: BaseUnit) -> Scale:
    """The unit that an FMU defines, such as [m/s]. Source: FMI 2.0.4, section 2.2.2; FMI 3.0.2, section 2.4.4."""
    exponents = {long: getattr(base, short) for short, long in BASE.items()}
    return Scale(dimension_of(exponents), float(base.factor), float(base.offset))


def unit_of_fmu(name: str, definition: BaseUnit | None) -> Scale:
    """The scale of a unit that an FMU names, such as [ft], by its own definition where it gives one.

    raises : InputError where the unit is unknown, or its definition is unusable or contradicts the name

    Source: FMI 2.0.4, section 2.2.2; FMI 3.0.2, section 2.4.4.
    """
    usual = known_unit(name)
    if definition is None:
        if usual is None:
            raise InputError(f"unit `{name}` is defined neither by the FMU nor by pint; give `unit`")
        return usual
    defined = defined_unit(definition)
    if not is_usable(defined):
        raise InputError(
            f"the FMU defines `{name}` by factor {defined.factor:g} and offset {defined.offset:g}, which is not a "
            "unit; give `unit`"
        )
    # a letter means a temperature to a logger, and may well be a charge to a tool: its definition decides
    if usual is not None and name not in LETTERS and not _agree(defined, usual):
        raise InputError(
            f"the FMU defines `{name}` as {_scale_text(defined)}, but the name means {_scale_text(usual)}; give `unit`"
        )
    return defined


def _agree(a: Scale, b: Scale) -> bool:
    pairs = ((a.factor, b.factor), (a.offset, b.offset))
    return a.dimension == b.dimension and all(math.isclose(x, y, rel_tol=DEFINITION_TOLERANCE) for x, y in pairs)


def _scale_text(scale: Scale) -> str:
    short = {long: s for s, long in BASE.items()}
    units = " ".join(short.get(k, k) + ("" if e == 1.0 else f"{e:g}") for k, e in scale.dimension) or "1"
    return f"{scale.factor:.6g} {units}" + (f" + {scale.offset:g}" if scale.offset else "")
