"""How the truth of a record deviates from what the record declares."""

from __future__ import annotations

from collections.abc import Callable
from copy import deepcopy
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
Weights = Callable[[FloatArray], FloatArray]

HOT_K = np.arange(100.0, 2601.0, 5.0)
"""Wall temperatures at which a change of the heating with wall temperature is tabulated."""


@dataclass(frozen=True)
class Deviation:
    """How the truth deviates from the declared model with the right scale and slopes.

    add, multiply : (time,) to the heating ratio, in this order
    eps_factor    : (time,) on the emissivity
    hot, hot_share: relative rise of the ratio with wall temperature on HOT_K, (time,) share of it that acts
    walls         : changes made to a copy of the declared stack and materials
    shifts_m      : thermocouple -> how much deeper it is than declared
    back          : film coefficient, temperature, emissivity, exponent
    deposit       : weights of a depth, share of the convective flux, share of it that the surface lacks
    added         : (time,) flux into the surface besides convection [W/m2]
    side          : weights of a depth: G of what is lost sideways [W/(m3 K)]
    water         : content of a depth [kg/m3]; latent heat, boiling and width [K], time [s], share condensing inward
    read, after   : on (time, sensor) temperatures before noise and word, and after them
    skew_s        : (time,) by which the clock of the thermocouples lags
    """

    add: FloatArray | float = 0.0
    multiply: FloatArray | float = 1.0
    eps_factor: FloatArray | float = 1.0
    hot: FloatArray | float = 0.0
    hot_share: FloatArray | float = 1.0
    walls: tuple[Callable[[dict[str, Any], dict[str, Any]], None], ...] = ()
    shifts_m: tuple[tuple[int, float], ...] = ()
    back: tuple[float, ...] | None = None
    deposit: tuple[Weights, float, float] | None = None
    added: FloatArray | float = 0.0
    side: Weights | None = None
    water: tuple[Weights, FloatArray] | None = None
    read: tuple[Callable[[FloatArray, FloatArray], FloatArray], ...] = ()
    after: tuple[Callable[[FloatArray, FloatArray], FloatArray], ...] = ()
    skew_s: FloatArray | float = 0.0

    def of_wall(self, stack: dict[str, Any], materials: dict[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
        """The true stack and materials in place of the declared ones, which stay as they are."""
        if not self.walls:
            return stack, materials
        stack, materials = deepcopy(stack), deepcopy(materials)
        for change in self.walls:
            change(stack, materials)
        return stack, materials

    def __add__(self, other: Deviation) -> Deviation:
        """Both at once."""
        return Deviation(
            add=self.add + other.add,
            multiply=self.multiply * other.multiply,
            eps_factor=self.eps_factor * other.eps_factor,
            hot=(1.0 + self.hot) * (1.0 + other.hot) - 1.0,
            hot_share=self.hot_share * other.hot_share,
            walls=self.walls + other.walls,
            shifts_m=self.shifts_m + other.shifts_m,
            back=self.back or other.back,
            deposit=self.deposit or other.deposit,
            added=self.added + other.added,
            side=self.side or other.side,
            water=self.water or other.water,
            read=self.read + other.read,
            after=self.after + other.after,
            skew_s=self.skew_s + other.skew_s,
        )


NOTHING = Deviation()
