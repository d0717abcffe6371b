"""Hypotheses that are no aerothermal effect: the record itself is other than declared.

A wrong density, a layer of another thickness or two swapped thermocouples are a change of the record's flight, wall or
sensors. A change has one continuous unknown or none, such as a swap.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from sim_heating.base.parameters import Parameter
from sim_heating.inputs.record import Record


@dataclass(frozen=True, eq=False)
class RecordChange:
    """A change of a record's flight, wall or sensors that may explain it.

    kind      : of the cause: "flight", "wall" or "sensor"
    what      : the change in words, without a value: "density of the flight conditions"
    parameter : its unknown: neutral value, standard deviation that is usual, bounds; None for a change without one
    apply     : the changed record at a value; times and number of samples are those of the record given
    describe  : the change in words, with its value: "density of the flight conditions 8 % too low"
    starts    : values that a fit starts from where the neutral one is too far away
    in_model  : whether the unknown is a parameter of the point's model by its dotted name, such as
                `stack.al2024.heat_capacity_factor`: it is then estimated with the others, with its exact derivative
    """

    kind: Literal["flight", "wall", "sensor"]
    what: str
    parameter: Parameter | None
    apply: Callable[[Record, float], Record]
    describe: Callable[[float], str]
    starts: tuple[float, ...] = ()
    in_model: bool = False

    @property
    def neutral(self) -> float:
        """Value at which the record is as declared; 0 for a change without a parameter, which has none."""
        return 0.0 if self.parameter is None else self.parameter.value
