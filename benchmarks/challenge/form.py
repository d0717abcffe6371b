"""What a class of deviations is: forms, parameters drawn within physical bounds, and how the truth deviates."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from benchmarks.challenge.deviation import Deviation

Generator = np.random.Generator
Parameters = Mapping[str, Any]
Draw = Callable[[Generator, Any, str], dict[str, Any]]
"""Random numbers, a case of the set, form -> parameters."""
Act = Callable[[Any, str, Parameters], Deviation]
"""The case on the steps of a march, form, parameters -> how the truth deviates."""


VISIBLE = (2.2, 16.0)
"""Residual of a deviation over the noise floor, where it acts, after a refit of scale and slopes."""


class Unsuitable(Exception):
    """A flight or a wall that cannot show it."""


@dataclass(frozen=True)
class Family:
    """An effect, or a fault of wall, flight, sensors or table, in its forms.

    name      : of the effect in a closure report; descriptive for a fault, which no name covers
    draw, act : parameters of a form; how the truth deviates on the steps of a march
    magnitude : parameter -> its value without effect, least, greatest; changed until the effect is as visible as drawn
    needs     : kinds of manoeuvres without which it cannot be seen
    points    : names or kinds of points that show it; empty for all
    recorded  : for a fault of the flight: the state as it was recorded, from the state as it was
    effects   : names of effects that report it all the same
    is_slope  : whether a refit of the slopes takes up all of it
    same      : form -> another effect that is the same function once the slopes are fitted
    kind      : "wall", "flight" or "sensor" of a fault whose class does not say it; empty where it is none of them
    """

    name: str
    forms: tuple[str, ...]
    draw: Draw
    act: Act
    magnitude: Mapping[str, tuple[float, float, float]] = field(default_factory=dict)
    needs: tuple[str, ...] = ()
    points: tuple[str, ...] = ()
    recorded: Callable[[Any, str, Parameters, dict[str, Any]], dict[str, Any]] | None = None
    effects: tuple[str, ...] = ()
    is_slope: bool = False
    kind: str = ""
    same: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Drawn:
    """A form with its parameters."""

    family: Family
    form: str
    parameters: dict[str, Any]

    def deviation(self, history: Any) -> Deviation:
        """How the truth deviates on the steps of a march."""
        return self.family.act(history, self.form, self.parameters)

    def recorded(self, case: Any) -> Any:
        """The case as recorded with it."""
        wrong = self.family.recorded
        if wrong is None:
            return case
        return case.misrecorded(lambda state: wrong(case, self.form, self.parameters, state))

    def scaled(self, factor: float) -> Drawn:
        """With another magnitude, within its bounds."""
        changed = dict(self.parameters)
        for name, (neutral, low, high) in self.family.magnitude.items():
            if name in changed:
                value = neutral + factor * (changed[name] - neutral)
                changed[name] = float(f"{np.clip(value, low, high):.6g}")
        return replace(self, parameters=changed)

    def nearby(self, rng: Generator, share: float) -> Drawn:
        """The same form with all its numbers changed by a share of themselves."""
        changed = {
            k: float(v * (1.0 + share * rng.normal())) if isinstance(v, float) else v
            for k, v in self.parameters.items()
        }
        return replace(self, parameters=changed)


def draw(rng: Generator, family: Family, case: Any, form: str | None = None) -> Drawn:
    """A form with its parameters; raises Unsuitable."""
    form = str(rng.choice(family.forms)) if form is None else form
    found = family.draw(rng, case, form)
    return Drawn(family, form, {k: float(f"{v:.6g}") if isinstance(v, float) else v for k, v in found.items()})


def sign(rng: Generator) -> float:
    """-1 or 1."""
    return float(rng.choice([-1.0, 1.0]))
