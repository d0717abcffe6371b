"""An effect: functional forms, parameters drawn within physical bounds, and how the truth differs."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from benchmarks.generator.case import Case, Nature

Generator = np.random.Generator


class Unsuitable(Exception):
    """A flight or a wall that cannot show the effect."""


@dataclass(frozen=True)
class Family:
    """An effect with its functional forms.

    forms         : names of them
    draw          : (rng, case, form) -> parameters; raises Unsuitable
    nature        : (case, form, parameters) -> how the truth differs
    magnitude     : parameter -> its value without effect, least and greatest; what is changed to make it visible
    manoeuvres    : that a flight must contain
    kinds         : of control points that show it; empty for all
    least_sensors : least number of sensors that show it
    residual      : range that its residual over the noise floor, where it acts, is drawn from
    """

    name: str
    forms: tuple[str, ...]
    draw: Callable[[Generator, Case, str], dict[str, Any]]
    nature: Callable[[Case, str, Mapping[str, Any]], Nature]
    magnitude: Mapping[str, tuple[float, float, float]] = field(default_factory=dict)
    manoeuvres: tuple[str, ...] = ()
    kinds: tuple[str, ...] = ()
    least_sensors: int = 1
    residual: tuple[float, float] = (2.2, 16.0)


@dataclass(frozen=True)
class Drawn:
    """An effect of one form with its parameters."""

    family: Family
    form: str
    parameters: dict[str, Any]

    @property
    def name(self) -> str:
        """Name of the effect."""
        return self.family.name

    def nature(self, case: Case) -> Nature:
        """How the truth of a case differs with it."""
        return self.family.nature(case, self.form, self.parameters)

    def scaled(self, factor: float) -> Drawn:
        """The effect with another magnitude, within its bounds."""
        changed = dict(self.parameters)
        for name, (neutral, low, high) in self.family.magnitude.items():
            if name in changed:
                value = neutral + factor * (changed[name] - neutral)
                changed[name] = float(f"{np.clip(value, low, high):.6g}")
        return replace(self, parameters=changed)


def draw_effect(rng: Generator, family: Family, case: Case, form: str | None = None) -> Drawn | None:
    """An effect of a family with a random form unless one is given, or None where the case cannot show it."""
    form = str(rng.choice(family.forms)) if form is None else form
    try:
        drawn = family.draw(rng, case, form)
    except Unsuitable:
        return None
    rounded = {k: float(f"{v:.6g}") if isinstance(v, float) else v for k, v in drawn.items()}
    return Drawn(family, form, rounded)
