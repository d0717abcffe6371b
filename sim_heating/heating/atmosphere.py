"""Free stream: US Standard Atmosphere 1976 to 200 km, viscosity, speed of sound, and what follows from a host's state.

A host gives altitude, density and velocity. Temperature, pressure, Mach and Reynolds number are derived here and
nowhere else, because hosts get them wrong where it matters (a frozen temperature above 86 km).

Source: US Standard Atmosphere 1976, NOAA-S/T 76-1562 ("US76"; equation and table numbers are its own).
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from sim_heating.base.arrays import FloatArray
from sim_heating.base.errors import InputError
from sim_heating.base.files.package import read_package_table
from sim_heating.base.kernels.jit import njit

G0_M_S2 = 9.80665
"""Gravity at sea level, US76 table 2."""
EARTH_RADIUS_M = 6356766.0
"""Effective Earth radius of the geopotential, US76 section 1.2.4."""
MOLAR_GAS_CONSTANT = 8314.32
"""R* of US76 table 2 [J/(kmol K)]; not today's value."""
MOLAR_MASS = 28.9644
"""Mean molar mass of air at sea level, US76 [kg/kmol]."""
R_AIR = 287.05287
"""Gas constant of air, R*/M [J/(kg K)]."""
GAMMA = 1.4
"""Ratio of specific heats of cold air."""
CP_AIR = 1004.5
"""Specific heat of cold air [J/(kg K)]: the cp of H_r = V^2/2 + cp T_inf."""
SUTHERLAND_PA_S = 1.458e-6
SUTHERLAND_K = 110.4
"""Constants of Sutherland's law, US76 table 2 [Pa s K^-1/2], [K]; the contract's too."""
SEA_LEVEL_K = 288.15
SEA_LEVEL_PA = 101325.0

LOWEST_M = -5000.0
HIGHEST_M = 200000.0
UPPER_BASE_M = 86000.0

SLOWEST_RE = 1.0e-3
"""Reynolds number below which log10_re stays at -3, so that a body at rest has a finite one."""


@njit
def gravity(altitude_m: float) -> float:
    """Acceleration of gravity [m/s2] at a geometric altitude, US76 eq. 17."""
    ratio = EARTH_RADIUS_M / (EARTH_RADIUS_M + altitude_m)
    return G0_M_S2 * ratio * ratio


@njit
def geopotential(altitude_m: float) -> float:
    """Geopotential height [m'] of a geometric altitude [m], US76 eq. 18."""
    return EARTH_RADIUS_M * altitude_m / (EARTH_RADIUS_M + altitude_m)


@njit
def geometric(geopotential_m: float) -> float:
    """Geometric altitude [m] of a geopotential height [m'], US76 eq. 19."""
    return EARTH_RADIUS_M * geopotential_m / (EARTH_RADIUS_M - geopotential_m)


@njit
def upper_temperature(altitude_m: float) -> float:
    """Kinetic temperature [K] from 86 km up, US76 eqs. 25, 27, 29, 31: isothermal, elliptic, linear, exponential."""
    z_km = altitude_m * 1.0e-3
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
    """Pressure at a height [m'] above a layer's base, US76 eqs. 33a and 33b."""
    c = G0_M_S2 * MOLAR_MASS / MOLAR_GAS_CONSTANT
    if gradient == 0.0:
        return p_base * math.exp(-c * height / T_base)
    return p_base * (T_base / (T_base + gradient * height)) ** (c / gradient)


def _layer_bases(base: FloatArray, gradient: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Molecular-scale temperature and pressure at the foot of each layer, carried up from sea level."""
    T, p = np.full(len(base), SEA_LEVEL_K), np.full(len(base), SEA_LEVEL_PA)
    for i in range(1, len(base)):
        height = base[i] - base[i - 1]
        T[i] = T[i - 1] + gradient[i - 1] * height
        p[i] = _layer_pressure(p[i - 1], T[i - 1], gradient[i - 1], height)
    return T, p


@njit
def cell(x: FloatArray, at: float) -> tuple[int, float]:
    """Cell of an increasing table that holds a value, and the fraction of the way through it; beyond the end, the end.

    A plain search: numpy's, compiled, would take seconds to compile.
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
    T_base, p_base = _layer_bases(base, gradient)
    z_mass, mass_ratio = masses["altitude_m"], masses["molar_mass_ratio"]

    @njit
    def lower(altitude_m: float) -> tuple[float, float, float]:
        h = geopotential(altitude_m)
        i = 0
        while i + 1 < len(base) and h >= base[i + 1]:
            i += 1
        T_molecular = T_base[i] + gradient[i] * (h - base[i])
        p = _layer_pressure(p_base[i], T_base[i], gradient[i], h - base[i])
        ratio = 1.0
        if altitude_m > z_mass[0]:
            k, f = cell(z_mass, altitude_m)
            ratio = mass_ratio[k] + f * (mass_ratio[k + 1] - mass_ratio[k])
        return T_molecular * ratio, p, p * MOLAR_MASS / (MOLAR_GAS_CONSTANT * T_molecular)

    return lower


# A table inside a closure is part of the key of the compiled cache: an edited CSV recompiles. A module global is not.
lower_atmosphere = _make_lower_kernel()
"""Scalar kernel below 86 km: kinetic temperature [K], pressure [Pa], density [kg/m3]; US76 eqs. 22, 23, 33, 42."""


def _node_slopes(x: FloatArray, y: FloatArray) -> FloatArray:
    """Slopes of the parabola through each node and its neighbours."""
    return np.gradient(y, x, edge_order=2)


def _upper_table() -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """Altitude, ln p, ln rho and their slopes.

    The slope of ln p is the table's own, not -g rho/p: between 98 and 102 km the published pressures follow the
    species equations and leave hydrostatic balance by up to 2 %.
    """
    table = read_package_table("heating/data/us76_above_86km.csv")
    z, p, rho = table["altitude_m"], table["p_Pa"], table["rho_kg_m3"]
    # The lowest row is the layer equations' own value, unrounded: no jump at 86 km.
    _, p[0], rho[0] = lower_atmosphere(UPPER_BASE_M)
    return z, np.log(p), _node_slopes(z, np.log(p)), np.log(rho), _node_slopes(z, np.log(rho))


@njit
def _hermite(s: float, step: float, y0: float, y1: float, d0: float, d1: float) -> float:
    """Cubic through y0, y1 with slopes d0, d1 over a step, at the fraction s."""
    t = 1.0 - s
    return y0 * (1.0 + 2.0 * s) * t * t + y1 * s * s * (3.0 - 2.0 * s) + step * s * t * (d0 * t - d1 * s)


def _make_upper_kernel() -> Callable[[float], tuple[float, float, float]]:
    z, ln_p, slope_p, ln_rho, slope_rho = _upper_table()

    @njit
    def upper(altitude_m: float) -> tuple[float, float, float]:
        i, s = cell(z, altitude_m)
        step = z[i + 1] - z[i]
        p = math.exp(_hermite(s, step, ln_p[i], ln_p[i + 1], slope_p[i], slope_p[i + 1]))
        rho = math.exp(_hermite(s, step, ln_rho[i], ln_rho[i + 1], slope_rho[i], slope_rho[i + 1]))
        return upper_temperature(altitude_m), p, rho

    return upper


upper_atmosphere = _make_upper_kernel()
"""Scalar kernel from 86 to 200 km: kinetic temperature [K], and p [Pa], rho [kg/m3] cubic in the table's logarithms."""


@njit
def us76_kernel(altitude_m: float) -> tuple[float, float, float]:
    """US76 at one geometric altitude [m]: kinetic temperature [K], pressure [Pa], density [kg/m3].

    Exact layer equations below 86 km, tabulated above. Outside -5 km and 200 km the edge is held; `us76` refuses.
    """
    z = min(max(altitude_m, LOWEST_M), HIGHEST_M)
    if z < UPPER_BASE_M:
        return lower_atmosphere(z)
    return upper_atmosphere(z)


@njit
def sutherland_kernel(T_K: float) -> float:
    """Sutherland's viscosity of air [Pa s], US76 eq. 51: 1.458e-6 T^1.5 / (T + 110.4); T [K] above 0."""
    return SUTHERLAND_PA_S * T_K * math.sqrt(T_K) / (T_K + SUTHERLAND_K)


@njit
def speed_of_sound_kernel(T_K: float) -> float:
    """Speed of sound of cold air [m/s], sqrt(gamma R T), with gamma 1.4 and the gas constant of sea level."""
    return math.sqrt(GAMMA * R_AIR * T_K)


@njit
def derive_kernel(
    altitude_m: float, velocity_m_s: float, rho_kg_m3: float, reference_length_m: float
) -> tuple[float, float, float, float]:
    """One frame of `derive`: T_inf [K], p_inf [Pa], Mach [-], log10 Re [-]. The altitude is held at US76's ends."""
    T, p_standard, rho_standard = us76_kernel(altitude_m)
    p = rho_kg_m3 * p_standard / rho_standard
    mach = velocity_m_s / speed_of_sound_kernel(T)
    re = rho_kg_m3 * velocity_m_s * reference_length_m / sutherland_kernel(T)
    return T, p, mach, math.log10(max(re, SLOWEST_RE))


@njit
def _us76_loop(altitude_m: FloatArray, T: FloatArray, p: FloatArray, rho: FloatArray) -> None:
    for i in range(len(altitude_m)):
        T[i], p[i], rho[i] = us76_kernel(altitude_m[i])


@njit
def _sutherland_loop(T: FloatArray, mu: FloatArray) -> None:
    for i in range(len(T)):
        mu[i] = sutherland_kernel(T[i])


@njit
def _derive_loop(z: FloatArray, V: FloatArray, rho: FloatArray, length: float, out: FloatArray) -> None:
    for i in range(len(z)):
        out[0, i], out[1, i], out[2, i], out[3, i] = derive_kernel(z[i], V[i], rho[i], length)


def _checked_altitude(altitude_m: ArrayLike) -> FloatArray:
    z = np.asarray(altitude_m, dtype=float)
    bad = ~((z >= LOWEST_M) & (z <= HIGHEST_M))
    if np.any(bad):
        raise InputError(
            f"altitude_m, sample {int(np.flatnonzero(bad)[0]) + 1}: {z[bad].flat[0]} lies outside the US Standard "
            f"Atmosphere as tabulated ({LOWEST_M:.0f} to {HIGHEST_M:.0f} m)"
        )
    return z


def us76(altitude_m: ArrayLike) -> tuple[FloatArray, FloatArray, FloatArray]:
    """US Standard Atmosphere 1976.

    altitude_m : geometric altitude [m], any shape, -5000 to 200000
    returns    : kinetic temperature [K], pressure [Pa], density [kg/m3], in that shape
    raises     : InputError outside that range or where not a number

    Below 86 km exact; above, the published table's 4 digits between nodes 1 to 10 km apart.
    """
    z = _checked_altitude(altitude_m)
    T, p, rho = np.empty(z.size), np.empty(z.size), np.empty(z.size)
    _us76_loop(z.ravel(), T, p, rho)
    return T.reshape(z.shape), p.reshape(z.shape), rho.reshape(z.shape)


def _checked_positive(name: str, values: ArrayLike, *, zero_allowed: bool = False) -> FloatArray:
    a = np.asarray(values, dtype=float)
    bad = ~(np.isfinite(a) & ((a >= 0.0) if zero_allowed else (a > 0.0)))
    if np.any(bad):
        rule = "must be finite and not negative" if zero_allowed else "must be finite and above 0"
        raise InputError(f"{name}, sample {int(np.flatnonzero(bad)[0]) + 1}: {a[bad].flat[0]} ({rule})")
    return a


def sutherland_viscosity(T_K: ArrayLike) -> FloatArray:
    """Sutherland's viscosity of air [Pa s]; T [K] above 0, good from 100 to about 1000 K (3 % low there).

    The Reynolds number of a record is defined with it whatever the temperature. For hot gas take
    `reference_heating.gas.viscosity`. raises InputError where T is not a positive number.
    """
    T = _checked_positive("T_K", T_K)
    mu = np.empty(T.size)
    _sutherland_loop(T.ravel(), mu)
    return mu.reshape(T.shape)


def speed_of_sound(T_K: ArrayLike) -> FloatArray:
    """Speed of sound of cold air [m/s], sqrt(1.4 x 287.05287 T); raises InputError where T is not positive."""
    return np.sqrt(GAMMA * R_AIR * _checked_positive("T_K", T_K))


def derive(
    altitude_m: ArrayLike, velocity_m_s: ArrayLike, rho_kg_m3: ArrayLike, reference_length_m: float
) -> dict[str, FloatArray]:
    """What a flight condition lacks, from what a host gives.

        T = T_US76(z);  p = rho R T, R of US76's mean molar mass at z;  M = V / sqrt(gamma R T);  Re = rho V L / mu(T)

    altitude_m, velocity_m_s, rho_kg_m3 : (time,) [m], [m/s], [kg/m3]; the density is kept as given (dispersions)
    reference_length_m : L [m], the vehicle's
    returns : T_inf_K, p_inf_Pa, mach, log10_re, each (time,); log10_re is not below -3 (a body at rest)
    raises  : InputError outside US76's altitudes, for a density that is not positive, a negative velocity
    """
    checked = (
        np.atleast_1d(_checked_altitude(altitude_m)),
        _checked_positive("velocity_m_s", velocity_m_s, zero_allowed=True),
        _checked_positive("rho_kg_m3", rho_kg_m3),
    )
    _checked_positive("reference_length_m", [reference_length_m])
    # Copies: a read-only view would be another type to the compiler.
    z, V, rho = (np.array(a) for a in np.broadcast_arrays(*checked))
    out = np.empty((4, z.size))
    _derive_loop(z, V, rho, float(reference_length_m), out)
    return {"T_inf_K": out[0], "p_inf_Pa": out[1], "mach": out[2], "log10_re": out[3]}
