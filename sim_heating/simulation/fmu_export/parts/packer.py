"""What the packing of any model into an image begins with: the numbers that the C wrapper knows, time, and inputs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from sim_heating.simulation.fmu_export.parts import library
from sim_heating.simulation.fmu_export.parts.image import Image, Kind, Role, Variable


class Input(NamedTuple):
    """An input of an FMU, with the limits that a host has to keep."""

    name: str
    unit: str
    nominal: float
    text: str
    lower: float
    upper: float


class ImagePacker:
    """Packs a model into an image, whose variables and arrays grow with each call.

    image      : empty at first
    n_integers : first integers of N that the model and the C wrapper use

    Attribute `head`: values of those integers by their index, written at the end with `Image.set_integers`.
    """

    def __init__(self, image: Image, n_integers: int) -> None:
        self.image = image
        self.head: dict[int, int] = {}
        first = np.zeros(library.R_HEAD)
        first[library.LONGEST] = library.LONGEST_COMMUNICATION_S
        image.keep_numbers(first)
        image.add_integers(np.zeros(n_integers))
        image.kept_integers += [(offset, 1) for offset in (library.CHANGED, library.TIMING, library.TIMING_INTEGER)]
        self.add_number("time", Role.INDEPENDENT, 0, "time", "s")

    def add_number(
        self,
        name: str,
        role: Role,
        offset: int,
        text: str,
        unit: str = "1",
        lower: float = -np.inf,
        upper: float = np.inf,
        nominal: float | None = None,
        depends: tuple[str, ...] = (),
        parameters: tuple[str, ...] = (),
    ) -> None:
        """Add a variable for a number at an offset of R."""
        limits = (lower, upper, nominal)
        variable = Variable(
            name, Kind.NUMBER, role, offset, text, unit, *limits, depends=depends, parameters=parameters
        )
        self.image.variables.append(variable)

    def add_array(
        self,
        name: str,
        role: Role,
        offset: int,
        text: str,
        unit: str,
        shape: tuple[int, ...],
        lower: float = -np.inf,
        upper: float = np.inf,
    ) -> None:
        """Add a variable for an array at an offset of T, of the table whose path was added last."""
        self.image.variables.append(Variable(name, Kind.SHARED, role, offset, text, unit, lower, upper, shape=shape))

    def add_choice(self, name: str, role: Role, offset: int, text: str, choices: tuple[tuple[str, str], ...]) -> None:
        """Add a variable for an integer at an offset of N, from 1 to the number of choices."""
        self.image.variables.append(
            Variable(name, Kind.INTEGER, role, offset, text, lower=1, upper=len(choices), choices=choices)
        )

    def add_integer(self, name: str, role: Role, offset: int, text: str, lower: int, upper: int) -> None:
        """Add a variable for an integer at an offset of N."""
        self.image.variables.append(Variable(name, Kind.INTEGER, role, offset, text, lower=lower, upper=upper))

    def add_inputs(self, inputs: Sequence[Input], starts: ArrayLike) -> None:
        """Add the inputs, and room for their values at the start and at the end of a step.

        starts : (input,) values before a host sets them
        """
        offset = self.image.keep_numbers(starts)
        for i, (name, unit, nominal, text, lower, upper) in enumerate(inputs):
            self.add_number(name, Role.INPUT, offset + i, text, unit, lower, upper, nominal)
        self.head |= {library.INPUTS: offset, library.N_INPUTS: len(inputs)}
        self.head[library.INPUT_SLOPES] = self.image.keep_numbers(np.zeros(len(inputs)))
        self.head |= {copy: self.image.keep_numbers(starts) for copy in (library.INPUTS_NOW, library.INPUTS_NEXT)}
