"""Changes of a record's flight, wall or sensors: causes that are no aerothermal effect, or are one by another name."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

from sim_heating.base.parameters import Parameter
from sim_heating.inputs.record import Record

Span = tuple[float, float]
"""Begin and end of a part of a flight, of the air, or of a table."""


def moved_ends(span: Span, fraction: float, shortest: float, limits: Span) -> list[Span]:
    """A span with either end, or both, moved by a fraction of its length; within limits, and not too short."""
    low, high = span
    by = fraction * (high - low)
    moves = ((-by, 0.0), (by, 0.0), (0.0, -by), (0.0, by), (-by, -by), (by, by))
    spans = [(max(low + a, limits[0]), min(high + b, limits[1])) for a, b in moves]
    return [(a, b) for a, b in dict.fromkeys(spans) if b - a >= shortest and (a, b) != span]


def off_by(factor: float, above: str, below: str) -> str:
    """A factor of the true over the stated value in words, such as "12 % above"."""
    percent = 100.0 * abs(factor - 1.0)
    return f"{percent:{'.0f' if percent >= 10.0 else '.2g'}} % {above if factor > 1.0 else below}"


@dataclass(frozen=True, eq=False)
class RecordChange:
    """A change of a record's flight, wall or sensors that may explain it.

    kind      : of the cause: "flight", "wall" or "sensor"
    what      : the change in words, without a value: "density of the flight conditions"
    parameter : its unknown: neutral value, standard deviation that is usual (finite), bounds; None for a change without
    apply     : the changed record at a value (0 where there is no parameter). The times of conditions and measurements
                stay as they are; where readings change with the value, their sensor has no recorder word any more
    describe  : the change in words, with its value: "density of the flight conditions 8 % too low"
    starts    : further values that a fit may start from, where the neutral one is too far away
    effect    : the effect of a closure report that it is, such as "time-skew", whose parameter has the name of its own;
                empty where no name covers it
    form      : in words, what it has in common with changes of which one alone is fitted, such as layers of density
                between other altitudes; by default `what`
    near      : changes of the same form whose ends in time or altitude are moved by a fraction of its span; None where
                it has no ends. Both ends are searched, and count as unknowns
    known_log_likelihood : of readings that the changed record lacks because the change explains them by itself, such as
                those of a stuck thermocouple: of fitted ones, and of those held out
    in_model  : whether the unknown is a parameter of the point's model or of a sensor by its dotted name, such as
                `stack.al2024.heat_capacity_factor`: it is then estimated with the others, with its exact derivative
    free      : dotted names of parameters of the point's model that are estimated with it
    ends      : of a change with ends that is an effect, by their names in a closure report: value and unit
    broken    : thermocouples of which it leaves out all readings
    """

    kind: Literal["flight", "wall", "sensor"]
    what: str
    parameter: Parameter | None
    apply: Callable[[Record, float], Record]
    describe: Callable[[float], str]
    starts: tuple[float, ...] = ()
    in_model: bool = False
    effect: str = ""
    form: str = ""
    near: Callable[[float], Sequence[RecordChange]] | None = None
    known_log_likelihood: tuple[float, float] = (0.0, 0.0)
    free: tuple[str, ...] = ()
    ends: Mapping[str, tuple[float, str]] = field(default_factory=dict)
    broken: tuple[str, ...] = ()

    @property
    def neutral(self) -> float:
        """Value at which the record is as declared; 0 for a change without a parameter, which has none."""
        return 0.0 if self.parameter is None else self.parameter.value

    @property
    def name(self) -> str:
        """Its name among causes: that of the effect that it is, else the change in words, without a value."""
        return self.effect or self.what

    @property
    def family(self) -> str:
        """What shares one prior probability, as the forms of an effect do.

        Changes of one form, all of the sensors, or all properties of the layers; else the change by itself.
        """
        group = self.kind if self.kind == "sensor" or self.in_model else self.what
        return self.form or group

    @property
    def unknowns(self) -> int:
        """Number of unknowns that it adds to a model: its parameter, those estimated with it, and its ends."""
        return (0 if self.parameter is None else 1) + len(self.free) + (0 if self.near is None else 2)
