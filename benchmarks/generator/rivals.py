"""Which other effects would explain a record as well as its own.

A rival's signals are those of DRAWS draws of its parameters, its forms in turn; the remainder of the effect's change
after least squares with scale, slopes and those signals is its chi-square above the truth. That is linear in the
rival's magnitudes and coarse in the rest: a rival that only a fit of all its parameters would bring close can be
missed, and one that profits from three free magnitudes can be listed.
"""

from __future__ import annotations

from contextlib import suppress

import numpy as np

from benchmarks.challenge.form import Family, Unsuitable, draw
from benchmarks.generator.families import FAMILIES
from benchmarks.generator.visibility import Bench, Seen, remainder

DRAWS = 3
INSEPARABLE = 10.0
"""Chi-square below which two effects are not separable; a difference of BIC of 10 is very strong evidence."""

CONFUSABLE = {
    "transition": ("catalysis", "impingement-onset", "emissivity", "alpha-curvature"),
    "impingement-onset": ("alpha-curvature", "transition", "interaction", "catalysis"),
    "alpha-curvature": ("impingement-onset", "interaction", "catalysis", "transition"),
    "elevon-curvature": ("interaction", "bodyflap-curvature", "alpha-curvature"),
    "bodyflap-curvature": ("interaction", "elevon-curvature", "alpha-curvature"),
    "interaction": ("alpha-curvature", "elevon-curvature", "bodyflap-curvature", "impingement-onset"),
    "sideslip": ("alpha-curvature", "interaction", "jet-interaction"),
    "nonisothermal-wall": ("time-skew", "coating-thickness", "catalysis", "emissivity", "transition"),
    "jet-interaction": ("impingement-onset", "sideslip", "alpha-curvature"),
    "unknown": ("transition", "catalysis", "emissivity", "nonisothermal-wall"),
    "time-skew": ("coating-thickness", "nonisothermal-wall", "heat-capacity"),
    "coating-thickness": ("time-skew", "heat-capacity", "nonisothermal-wall", "conductivity"),
    "conductivity": ("heat-capacity", "radiative-conduction", "backface-cooling", "gap-flow", "sensor-bias"),
    "heat-capacity": ("conductivity", "coating-thickness", "time-skew", "moisture", "gap-flow"),
    "emissivity": ("catalysis", "nonisothermal-wall", "transition", "conductivity"),
    "sensor-bias": ("conductivity", "gap-flow", "backface-cooling", "heat-capacity"),
    "catalysis": ("emissivity", "transition", "nonisothermal-wall", "alpha-curvature"),
    "backface-cooling": ("conductivity", "heat-capacity", "sensor-bias", "gap-flow"),
    "gap-flow": ("conductivity", "radiative-conduction", "heat-capacity", "moisture", "sensor-bias"),
    "moisture": ("heat-capacity", "conductivity", "gap-flow", "sensor-bias"),
    "radiative-conduction": ("conductivity", "gap-flow", "heat-capacity"),
}
"""The effects that can resemble each one."""


def rivals(rng: np.random.Generator, on: Bench, name: str, seen: Seen) -> dict[str, float]:
    """Chi-square that `none` and each rival leave of an effect, which itself leaves 0."""
    left = {"none": _square(remainder(seen.slopes, seen.change))}
    for rival in CONFUSABLE[name]:
        signals = _signals(rng, on, FAMILIES[rival])
        if signals:
            left[rival] = _square(remainder(np.column_stack([seen.slopes, *signals]), seen.change))
    return left


def _signals(rng: np.random.Generator, on: Bench, family: Family) -> list[np.ndarray]:
    """(reading,) of each of DRAWS draws of a rival, its forms in turn; fewer where the case cannot show one."""
    drawn = []
    for i in range(DRAWS):
        with suppress(Unsuitable):
            drawn.append(draw(rng, family, on.case, family.forms[i % len(family.forms)]))
    return [on.change(effect.deviation(on.case)) for effect in drawn]


def accepted(name: str, left: dict[str, float]) -> list[str]:
    """The effect, and the names that are not separable from it."""
    return [name, *(rival for rival, chi_square in left.items() if chi_square < INSEPARABLE)]


def _square(values: np.ndarray) -> float:
    return round(float(values @ values), 2)
