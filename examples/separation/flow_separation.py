"""Flow that separates before a deflected elevon: an example of a user-defined effect with a source.

A laminar boundary layer separates before a wedge of more than theta_i degrees, M theta_i = 80 sqrt(M^3 / sqrt(Re)) with
Mach number and Reynolds number of the free stream. Within a separated laminar layer heating falls to 0.56 of the
attached one; where the flow comes back to the surface it rises above it.

Source: Needham and Stollery (1966), "Boundary layer separation in hypersonic flow", AIAA 66-455; Chapman (1956), NACA
TN 3792.
"""

import math

from sim_heating import Effect, Parameter, flight, njit

RISE, ONSET, WIDTH = range(3)


@njit
def separation_factor(B, c, p, wall_K):
    """1 + rise / (1 + exp(-u)), u = (elevon - onset theta_i) / width [-]; multiplies the ratio."""
    theta_i = 80.0 * math.sqrt(max(B[c + flight.mach], 0.0)) * 10.0 ** (-0.25 * B[c + flight.log10_re])
    u = (B[c + flight.elevon_deg] - B[p + ONSET] * theta_i) / B[p + WIDTH]
    return 1.0 + B[p + RISE] / (1.0 + math.exp(-min(max(u, -50.0), 50.0)))


EFFECT = Effect(
    name="flow-separation",
    mode="multiply",
    parameters=(
        Parameter("rise", "1", 0.0, 0.5, -0.44, 5.0, "relative change of the heating where the flow has separated"),
        Parameter("onset", "1", 1.0, 0.25, 0.2, 3.0, "deflection of separation over that of Needham and Stollery"),
        Parameter("width", "deg", 0.5, 0.25, 0.05, 3.0, "deflection within which the flow separates"),
    ),
    kernel=separation_factor,
    needs=("mach", "log10_re", "elevon_deg"),
    neutral={"rise": 0.0},
    physics="The boundary layer separates before the elevon, and the flow comes back to the surface behind.",
    source="Needham and Stollery (1966), AIAA 66-455; Chapman (1956), NACA TN 3792",
)
