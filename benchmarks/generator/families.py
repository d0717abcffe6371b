"""All effects by name, in the order of the record format's table."""

from __future__ import annotations

from benchmarks.challenge.deviation import NOTHING
from benchmarks.challenge.form import Family
from benchmarks.generator.on_ratio import ON_RATIO
from benchmarks.generator.on_wall import ON_WALL

NONE = Family("none", ("",), lambda rng, case, form: {}, lambda case, form, parameters: NOTHING)

FAMILIES: dict[str, Family] = {family.name: family for family in (NONE, *ON_RATIO, *ON_WALL)}
