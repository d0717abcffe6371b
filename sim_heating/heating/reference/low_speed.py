"""Low speed: where the correlations of stagnation heating end, and Fay-Riddell takes over.

Sutton-Graves and Detra-Kemp-Riddell are fits to hypersonic flow, from about 2 km/s on. Continued below they have no
subsonic limit: Sutton-Graves gives 1.4 times the film coefficient of Fay-Riddell at 1 km/s and 2.0 times at 300 m/s,
Detra-Kemp-Riddell 1.2 and 1.4 times. Below 2 km/s they therefore hand over to Fay-Riddell, whole below 1.5 km/s.
Equation: docs/theory/equations_reference_heating.md, equation 12.
"""

from __future__ import annotations

from sim_heating.base.kernels.jit import njit
from sim_heating.heating.reference.stagnation import smooth_share

CORRELATION_M_S = 2000.0
"""Speed [m/s] from which a correlation holds alone; 2.3 MJ/kg, the lowest enthalpy of NASA TR R-376, is 2.05 km/s."""
FAY_RIDDELL_M_S = 1500.0
"""Speed [m/s] below which Fay-Riddell alone is used in its place."""


@njit
def correlation_share(velocity_m_s: float) -> float:
    """Share [-] of a correlation in the film coefficient at a speed [m/s]: 0 below 1.5 km/s, 1 from 2 km/s on.

        h_ref = w h_correlation + (1 - w) h_Fay-Riddell,   w = 3 s^2 - 2 s^3,   s = (V - 1500) / 500

    Value and slope of h_ref are continuous. Source: docs/theory/equations_reference_heating.md, equation 12 (a choice).
    """
    return smooth_share(velocity_m_s, FAY_RIDDELL_M_S, CORRELATION_M_S)
