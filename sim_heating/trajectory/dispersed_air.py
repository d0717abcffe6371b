"""Air of a flight: the US Standard Atmosphere 1976 with a factor on its density, and winds, both over altitude."""

from __future__ import annotations

from sim_heating.base.arrays import FloatArray
from sim_heating.base.kernels.jit import njit
from sim_heating.heating.atmosphere import us76_kernel
from sim_heating.trajectory.schedules import pack, scheduled
from sim_heating.trajectory.spec import Dispersions

DENSITY_FACTOR, WIND_NORTH, WIND_EAST = 0, 2, 4
"""Places of the schedules in the block, see `schedules`."""


@njit
def air_kernel(altitude_m: float, dispersions: FloatArray) -> tuple[float, float, float, float, float]:
    """Temperature [K], pressure [Pa], density [kg/m3] and wind to north and east [m/s] at an altitude.

    Source: US Standard Atmosphere 1976.
    """
    T, p, rho = us76_kernel(altitude_m)
    factor = scheduled(dispersions, DENSITY_FACTOR, altitude_m)
    north, east = scheduled(dispersions, WIND_NORTH, altitude_m), scheduled(dispersions, WIND_EAST, altitude_m)
    return T, factor * p, factor * rho, north, east


def dispersion_block(d: Dispersions) -> FloatArray:
    """Density factor [-] and winds [m/s] over altitude [m] as `air_kernel` reads them.

    Source: US Standard Atmosphere 1976.
    """
    return pack((), d.schedules)
