"""A bow shock that passes over a control point at a Mach number: an example of an effect of one's own.

As an entry slows down the bow shock moves over the wing, and a point that it crosses is heated more for a while. The
bell over Mach number is a form for showing how an effect is written, not a correlation from a source.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import Conditions
from sim_heating.base.kernels.jit import njit
from sim_heating.base.parameters import Parameter
from sim_heating.heating import flight_variables as flight
from sim_heating.heating.effects import Effect, SearchStart

RISE, MACH_THERE, WIDTH = range(3)


@njit
def passing(B: FloatArray, c: int, p: int, wall_K: float) -> float:
    """1 + rise exp(-u^2 / 2), u = (Mach - mach_there) / width [-]; multiplies the ratio."""
    u = (B[c + flight.mach] - B[p + MACH_THERE]) / B[p + WIDTH]
    return 1.0 + B[p + RISE] * math.exp(-0.5 * u * u)


def search_starts(flown: Conditions) -> Sequence[SearchStart]:
    """Mach numbers spread over those flown, no rise yet."""
    places = np.quantile(flown["mach"], [0.1, 0.3, 0.5, 0.7, 0.9])
    return [SearchStart(("rise", "mach_there", "width"), {"mach_there": float(m)}) for m in places]


EFFECT = Effect(
    name="shock-passage",
    mode="multiply",
    parameters=(
        Parameter("rise", "1", 0.0, 0.3, -0.5, 5.0, "heating with the shock on the point over that without, less 1"),
        Parameter("mach_there", "1", 12.0, 4.0, 1.0, 30.0, "Mach number at which it is there"),
        Parameter("width", "1", 1.5, 1.0, 0.2, 6.0, "how far in Mach number it is felt"),
    ),
    kernel=passing,
    neutral={"rise": 0.0},
    search_starts=search_starts,
    physics="The bow shock moves over the point as the flight slows down.",
    source="an example; the form is a bell, nothing measured",
)
