"""Free stream: US Standard Atmosphere 1976 to 200 km, viscosity, speed of sound, and the conditions derived from them.

A host simulation gives altitude, density and velocity. Temperature, pressure, Mach and Reynolds number are derived here
only: the atmospheres of hosts are wrong where it matters (a temperature that is constant above 86 km).

Sources: US Standard Atmosphere 1976, NOAA-S/T 76-1562 ("US76"; its own equation and table numbers are cited);
docs/theory/equations_reference_heating.md, equations 1 to 4.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from sim_heating.base.arrays import FloatArray
from sim_heating.base.errors import InputError
from sim_heating.base.files.package import read_package_table
from sim_heating.base.kernels.jit import for_values, interpreted, njit, njit_of

# The constants are those of 1976, not today's: with them the printed tables come out to their last digit.
G0_M_S2 = 9.80665
"""Gravity at sea level [m/s2], US76 table 2."""
EARTH_RADIUS_M = 6356766.0
"""Effective Earth radius of the geopotential [m], US76 section 1.2.4."""
MOLAR_GAS_CONSTANT = 8314.32
"""R* of US76 table 2 [J/(kmol K)]; not today's value."""
MOLAR_MASS = 28.9644
"""Mean molar mass of air at sea level, US76 [kg/kmol]."""
R_AIR = 287.05287
"""Gas constant of air, R*/M [J/(kg K)]."""
GAMMA = 1.4
"""Ratio of specific heats of cold air [-]."""
CP_AIR = 1004.5
"""Specific heat of cold air [J/(kg K)]: the cp of H_r = V^2/2 + cp T_inf."""
SUTHERLAND_PA_S = 1.458e-6
SUTHERLAND_K = 110.4
"""Constants of Sutherland's law, US76 table 2 [Pa s K^-1/2], [K]; they also define the Reynolds number."""
SEA_LEVEL_K = 288.15
SEA_LEVEL_PA = 101325.0

LOWEST_M = -5000.0
HIGHEST_M = 200000.0
UPPER_BASE_M = 86000.0

SLOWEST_RE = 1.0e-3
"""Reynolds number [-] below which log10_re stays at -3, so that a body at rest has a finite one."""


@njit
def gravity(altitude_m: float) -> float:
    """Acceleration of gravity g = g_0 (r_0 / (r_0 + z))^2 [m/s2].

    altitude_m : geometric altitude z [m];  g_0 = 9.80665 [m/s2], r_0 = 6356766 [m]
    Source: US Standard Atmosphere 1976, eq. 17.
    """
    ratio = EARTH_RADIUS_M / (EARTH_RADIUS_M + altitude_m)
    return G0_M_S2 * ratio * ratio


@njit
def geopotential(altitude_m: float) -> float:
    """Geopotential height H = r_0 z / (r_0 + z) [m].

    altitude_m : geometric altitude z [m];  r_0 = 6356766 [m]
    Source: US Standard Atmosphere 1976, eq. 18.
    """
    return EARTH_RADIUS_M * altitude_m / (EARTH_RADIUS_M + altitude_m)


@njit
def geometric(geopotential_m: float) -> float:
    """Geometric altitude z = r_0 H / (r_0 - H) [m], the inverse of `geopotential`.

    geopotential_m : geopotential height H [m], below r_0 = 6356766 [m]
    Source: US Standard Atmosphere 1976, eq. 19.
    """
    return EARTH_RADIUS_M * geopotential_m / (EARTH_RADIUS_M - geopotential_m)


@njit
def upper_temperature(altitude_m: float) -> float:
    """Kinetic temperature [K] of the standard atmosphere from 86 km up.

        86 to 91 km    186.8673
        to 110 km      263.1905 - 76.3232 sqrt(1 - ((z - 91) / 19.9429)^2)
        to 120 km      240 + 12 (z - 110)
        above          1000 - 640 exp(-0.01875 xi),   xi = (z - 120) (r_0 + 120) / (r_0 + z)

    altitude_m : geometric altitude [m]; z and r_0 above are in km. Not for use below 86 km.
    Source: US Standard Atmosphere 1976, eqs. 25, 27, 29 and 31.
    """
    z_km = altitude_m * 1.0e-3
    # Constants of the printed equations, in their unit, km.
    if z_km <= 91.0:
        return 186.8673
    if z_km <= 110.0:
        x = (z_km - 91.0) / 19.9429
        return 263.1905 - 76.3232 * math.sqrt(1.0 - x * x)
    if z_km <= 120.0:
        return 240.0 + 12.0 * (z_km - 110.0)
    radius_km = EARTH_RADIUS_M * 1.0e-3
    xi = (z_km - 120.0) * (radius_km + 120.0) / (radius_km + z_km)
    return 1000.0 - 640.0 * math.exp(-0.01875 * xi)


@njit
def _layer_pressure(p_base: float, T_base: float, gradient: float, height: float) -> float:
    """Pressure [Pa] at a height [m] of geopotential above the base of a layer, US76 eqs. 33a and 33b."""
    c = G0_M_S2 * MOLAR_MASS / MOLAR_GAS_CONSTANT
    if gradient == 0.0:
        return p_base * math.exp(-c * height / T_base)
    return p_base * (T_base / (T_base + gradient * height)) ** (c / gradient)


def _layer_bases(base: FloatArray, gradient: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Molecular-scale temperature [K] and pressure [Pa] at the base of each layer, integrated up from sea level."""
    T, p = np.full(len(base), SEA_LEVEL_K), np.full(len(base), SEA_LEVEL_PA)
    for i in range(1, len(base)):
        height = base[i] - base[i - 1]
        T[i] = T[i - 1] + gradient[i - 1] * height
        p[i] = interpreted(_layer_pressure)(p[i - 1], T[i - 1], gradient[i - 1], height)
    return T, p


@njit
def cell_by_bisection(x: FloatArray, at: float) -> tuple[int, float]:
    """Cell of an increasing table that contains a value, and the fraction of the way through it [-].

    x       : (n,) increasing nodes, n at least 2;  at : the value, in the unit of x
    returns : index of the cell's lower node, fraction (at - x_i) / (x_(i+1) - x_i)
    Above the last node the fraction is 1; below the first one it is negative, so that the caller extrapolates.
    Bisection in plain Python: numpy's own search takes seconds to compile.
    """
    low, high = 0, len(x) - 1
    while high - low > 1:
        middle = (low + high) // 2
        if at >= x[middle]:
            low = middle
        else:
            high = middle
    return low, min((at - x[low]) / (x[low + 1] - x[low]), 1.0)


def _make_lower_kernel() -> Callable[[float], tuple[float, float, float]]:
    layers = read_package_table("heating/data/us76_layers.csv")
    masses = read_package_table("heating/data/us76_molar_mass_80_86km.csv")
    base, gradient = layers["base_geopotential_m"], layers["gradient_K_m"]
    # Bases are integrated here instead of copied from the printed table: rounded ones would leave steps of pressure.
    T_base, p_base = _layer_bases(base, gradient)
    z_mass, mass_ratio = masses["altitude_m"], masses["molar_mass_ratio"]

    def lower(altitude_m: float) -> tuple[float, float, float]:
        h = geopotential(altitude_m)
        i = 0
        while i + 1 < len(base) and h >= base[i + 1]:
            i += 1
        T_molecular = T_base[i] + gradient[i] * (h - base[i])
        p = _layer_pressure(p_base[i], T_base[i], gradient[i], h - base[i])
        # Below 80 km the molar mass is constant, and molecular-scale and kinetic temperature are the same.
        ratio = 1.0
        if altitude_m > z_mass[0]:
            k, f = cell_by_bisection(z_mass, altitude_m)
            ratio = mass_ratio[k] + f * (mass_ratio[k + 1] - mass_ratio[k])
        return T_molecular * ratio, p, p * MOLAR_MASS / (MOLAR_GAS_CONSTANT * T_molecular)

    return lower


# A table inside a closure is part of the key of the compiled cache: an edited CSV recompiles. A module global is not.
lower_atmosphere = njit_of(_make_lower_kernel)
"""Scalar kernel below 86 km: kinetic temperature [K], pressure [Pa], density [kg/m3]; US76 eqs. 22, 23, 33, 42."""


def _node_slopes(x: FloatArray, y: FloatArray) -> FloatArray:
    """Slopes of the parabola through each node and its neighbours, one-sided at both ends."""
    return np.gradient(y, x, edge_order=2)


def _upper_table() -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """Altitude [m], ln p, ln rho and their slopes [1/m] at the nodes of US76 Table I.

    The slope of ln p is the table's own, not -g rho/p: between 98 and 102 km the published pressures follow the
    species equations and depart from hydrostatic balance by up to 2 %.
    """
    table = read_package_table("heating/data/us76_above_86km.csv")
    z, p, rho = table["altitude_m"], table["p_Pa"], table["rho_kg_m3"]
    # The lowest row is the layer equations' own value, unrounded: no jump at 86 km.
    _, p[0], rho[0] = interpreted(lower_atmosphere)(UPPER_BASE_M)
    return z, np.log(p), _node_slopes(z, np.log(p)), np.log(rho), _node_slopes(z, np.log(rho))


@njit
def _hermite(s: float, step: float, y0: float, y1: float, d0: float, d1: float) -> float:
    """Cubic through y0, y1 with slopes d0, d1 over a step, at the fraction s of it.

    Source: docs/theory/equations_reference_heating.md, equation 4.
    """
    t = 1.0 - s
    return y0 * (1.0 + 2.0 * s) * t * t + y1 * s * s * (3.0 - 2.0 * s) + step * s * t * (d0 * t - d1 * s)


def _make_upper_kernel() -> Callable[[float], tuple[float, float, float]]:
    z, ln_p, slope_p, ln_rho, slope_rho = _upper_table()

    def upper(altitude_m: float) -> tuple[float, float, float]:
        i, s = cell_by_bisection(z, altitude_m)
        step = z[i + 1] - z[i]
        p = math.exp(_hermite(s, step, ln_p[i], ln_p[i + 1], slope_p[i], slope_p[i + 1]))
        rho = math.exp(_hermite(s, step, ln_rho[i], ln_rho[i + 1], slope_rho[i], slope_rho[i + 1]))
        return upper_temperature(altitude_m), p, rho

    return upper


upper_atmosphere = njit_of(_make_upper_kernel)
"""Scalar kernel from 86 to 200 km: kinetic temperature [K], and p [Pa], rho [kg/m3] cubic in the table's logarithms."""


@njit
def us76_kernel(altitude_m: float) -> tuple[float, float, float]:
    """Kinetic temperature [K], pressure [Pa] and density [kg/m3] of the standard atmosphere at one altitude.

    altitude_m : geometric altitude [m]; outside -5 km and 200 km the value at the nearest end (`us76` raises an error)
    Layer equations below 86 km; above, Table I by docs/theory/equations_reference_heating.md, equation 4.
    Source: US Standard Atmosphere 1976, eqs. 22 to 42 and Table I.
    """
    z = min(max(altitude_m, LOWEST_M), HIGHEST_M)
    if z < UPPER_BASE_M:
        return lower_atmosphere(z)
    return upper_atmosphere(z)


@njit
def sutherland_kernel(T_K: float) -> float:
    """Sutherland's viscosity of air, mu = 1.458e-6 T^1.5 / (T + 110.4) [Pa s].

    T_K : temperature [K], above 0; good from 100 to about 1000 K (3 % low there), continued outside
    Source: US Standard Atmosphere 1976, eq. 51.
    """
    return SUTHERLAND_PA_S * T_K * np.sqrt(T_K) / (T_K + SUTHERLAND_K)  # of arrays too, when interpreted


@njit
def speed_of_sound_kernel(p_Pa: float, rho_kg_m3: float) -> float:
    """Speed of sound a = sqrt(gamma p / rho) [m/s], gamma = 1.4; p / rho = R* T / M has the mean molar mass M in it.

    p_Pa, rho_kg_m3 : pressure [Pa] and density [kg/m3], above 0
    The standard defines the speed of sound to 86 km. It is continued above, as Mach number needs it. There gamma
    neglects atomic oxygen, with which the speed of sound would be 1 % higher at 120 km.
    Source: US Standard Atmosphere 1976, eq. 50; docs/theory/equations_reference_heating.md, equation 2.
    """
    return math.sqrt(GAMMA * p_Pa / rho_kg_m3)


@njit
def standard_sound_kernel(altitude_m: float) -> float:
    """Speed of sound of the standard atmosphere [m/s] at a geometric altitude [m].

    Source: US Standard Atmosphere 1976, eq. 50, continued above 86 km as in `speed_of_sound_kernel`.
    """
    _, p, rho = us76_kernel(altitude_m)
    return speed_of_sound_kernel(p, rho)


@njit
def free_stream_kernel(
    altitude_m: float, velocity_m_s: float, rho_kg_m3: float, reference_length_m: float
) -> tuple[float, float, float, float]:
    """Free-stream temperature [K], pressure [Pa], Mach number [-] and log10 Re [-] of one frame.

        T = T_US76(z),  p = rho p_US76(z) / rho_US76(z),  M = V / sqrt(gamma p / rho),  Re = rho V L / mu(T)

    altitude_m, velocity_m_s, rho_kg_m3 : of the frame [m], [m/s], [kg/m3]; density above 0
    reference_length_m                  : L [m]
    Nothing is checked; an altitude outside -5 to 200 km counts as the nearest end, and log10 Re is not below -3.
    Source: docs/theory/equations_reference_heating.md, equations 1 to 3.
    """
    T, p_standard, rho_standard = us76_kernel(altitude_m)
    # The ratio of the standard has the mean molar mass at this altitude in it, so that none has to be tabulated.
    p = rho_kg_m3 * p_standard / rho_standard
    mach = velocity_m_s / speed_of_sound_kernel(p_standard, rho_standard)
    re = rho_kg_m3 * velocity_m_s * reference_length_m / sutherland_kernel(T)
    return T, p, mach, math.log10(max(re, SLOWEST_RE))


@njit
def _us76_loop(altitude_m: FloatArray, T: FloatArray, p: FloatArray, rho: FloatArray) -> None:
    for i in range(len(altitude_m)):
        T[i], p[i], rho[i] = us76_kernel(altitude_m[i])


@njit
def _free_stream_loop(z: FloatArray, V: FloatArray, rho: FloatArray, length: float, out: FloatArray) -> None:
    for i in range(len(z)):
        out[0, i], out[1, i], out[2, i], out[3, i] = free_stream_kernel(z[i], V[i], rho[i], length)


def _checked_altitude(altitude_m: ArrayLike) -> FloatArray:
    # Negated, so that a value that is not a number is bad too.
    z = np.asarray(altitude_m, dtype=float)
    bad = ~((z >= LOWEST_M) & (z <= HIGHEST_M))
    if np.any(bad):
        raise InputError(
            f"altitude_m, sample {int(np.flatnonzero(bad)[0]) + 1}: {z[bad].flat[0]} lies outside the US Standard "
            f"Atmosphere as tabulated ({LOWEST_M:.0f} to {HIGHEST_M:.0f} m)"
        )
    return z


def us76(altitude_m: ArrayLike) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Temperature, pressure and density of the US Standard Atmosphere 1976.

    altitude_m : geometric altitude [m], any shape, -5000 to 200000
    returns    : kinetic temperature [K], pressure [Pa], density [kg/m3], in that shape
    raises     : InputError outside that range or where not a number

    The layer equations below 86 km; above, 4 digits of Table I, whose nodes are 0.5 to 10 km apart.
    Source: US Standard Atmosphere 1976, eqs. 22, 23, 33, 42 and Table I.
    """
    z = _checked_altitude(altitude_m)
    T, p, rho = np.empty(z.size), np.empty(z.size), np.empty(z.size)
    # The scalar kernel in a loop, not array expressions: a frame of a host and a whole flight get equal bits.
    for_values(_us76_loop, z.size)(z.ravel(), T, p, rho)
    return T.reshape(z.shape), p.reshape(z.shape), rho.reshape(z.shape)


def _checked_positive(name: str, values: ArrayLike, *, zero_allowed: bool = False) -> FloatArray:
    a = np.asarray(values, dtype=float)
    bad = ~(np.isfinite(a) & ((a >= 0.0) if zero_allowed else (a > 0.0)))
    if np.any(bad):
        rule = "must be finite and not negative" if zero_allowed else "must be finite and above 0"
        raise InputError(f"{name}, sample {int(np.flatnonzero(bad)[0]) + 1}: {a[bad].flat[0]} ({rule})")
    return a


def sutherland_viscosity(T_K: ArrayLike) -> FloatArray:
    """Sutherland's viscosity of air, mu = 1.458e-6 T^1.5 / (T + 110.4) [Pa s].

    T_K     : temperature [K], any shape; good from 100 to about 1000 K (3 % low there), continued outside
    returns : viscosity [Pa s], in that shape
    raises  : InputError where T is not a number above 0

    The Reynolds number of a record is defined with this law at every temperature. For hot gas use
    `heating.reference.gas.transport`. Source: US Standard Atmosphere 1976, eq. 51.
    """
    T = _checked_positive("T_K", T_K)
    return np.asarray(interpreted(sutherland_kernel)(T))


def standard_speed_of_sound(altitude_m: ArrayLike) -> FloatArray:
    """Speed of sound of the US Standard Atmosphere 1976, a = sqrt(gamma p / rho) [m/s], gamma = 1.4.

    altitude_m : geometric altitude [m], any shape, -5000 to 200000
    returns    : speed of sound [m/s], in that shape
    raises     : InputError outside that range or where not a number
    Source: US Standard Atmosphere 1976, eq. 50, continued above 86 km with the mean molar mass there.
    """
    _, p, rho = us76(altitude_m)
    return np.sqrt(GAMMA * p / rho)


def free_stream(
    altitude_m: ArrayLike, velocity_m_s: ArrayLike, rho_kg_m3: ArrayLike, reference_length_m: float
) -> dict[str, FloatArray]:
    """Free-stream temperature, pressure, Mach and Reynolds number from altitude, velocity and density.

        T = T_US76(z);  p = rho R T, R of US76's mean molar mass at z;  M = V / sqrt(gamma p / rho);  Re = rho V L / mu

    altitude_m, velocity_m_s, rho_kg_m3 : (time,) [m], [m/s], [kg/m3]; the density is kept as given (dispersions)
    reference_length_m : L [m], of the vehicle
    returns : T_inf_K [K], p_inf_Pa [Pa], mach [-], log10_re [-], each (time,); log10_re is at least -3 (a body at rest)
    raises  : InputError outside the altitudes of `us76`, for a density that is not positive, a negative velocity
    Source: docs/theory/equations_reference_heating.md, equations 1 to 3.
    """
    checked = (
        np.atleast_1d(_checked_altitude(altitude_m)),
        _checked_positive("velocity_m_s", velocity_m_s, zero_allowed=True),
        _checked_positive("rho_kg_m3", rho_kg_m3),
    )
    _checked_positive("reference_length_m", [reference_length_m])
    # Copies: to numba a read-only view is another type, for which the loop would be compiled a second time.
    z, V, rho = (np.array(a) for a in np.broadcast_arrays(*checked))
    out = np.empty((4, z.size))
    for_values(_free_stream_loop, z.size)(z, V, rho, float(reference_length_m), out)
    return {"T_inf_K": out[0], "p_inf_Pa": out[1], "mach": out[2], "log10_re": out[3]}
