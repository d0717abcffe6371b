"""A bow shock that passes over a control point at a Mach number: an example of a user-defined effect.

As an entry slows down the bow shock moves over the wing, and a point that it crosses is heated more for a while. The
bell over Mach number shows how an effect is written; it is not a correlation from a source.
"""

import math

import numpy as np

from sim_heating import Effect, Parameter, SearchStart, flight, njit

RISE, CENTRE, WIDTH = range(3)


@njit
def shock_factor(B, c, p, wall_K):
    """1 + rise exp(-u^2 / 2), u = (Mach - mach_there) / width [-]; multiplies the ratio."""
    u = (B[c + flight.mach] - B[p + CENTRE]) / B[p + WIDTH]
    return 1.0 + B[p + RISE] * math.exp(-0.5 * u * u)


def search_starts(flown):
    """Mach numbers spread over those flown, with no rise yet."""
    centres = np.quantile(flown["mach"], [0.1, 0.3, 0.5, 0.7, 0.9])
    return [SearchStart(("rise", "mach_there", "width"), {"mach_there": float(m)}) for m in centres]


EFFECT = Effect(
    name="shock-passage",
    mode="multiply",
    parameters=(
        Parameter("rise", "1", 0.0, 0.3, -0.5, 5.0, "relative rise of the heating while the shock is on the point"),
        Parameter("mach_there", "1", 12.0, 4.0, 1.0, 30.0, "Mach number at which the shock is on the point"),
        Parameter("width", "1", 1.5, 1.0, 0.2, 6.0, "width of the rise in Mach number"),
    ),
    kernel=shock_factor,
    needs=("mach",),
    neutral={"rise": 0.0},
    search_starts=search_starts,
    physics="The bow shock moves over the point as the flight slows down.",
    source="an example; the form is a bell, nothing measured",
)
