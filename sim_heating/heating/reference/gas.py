"""Equilibrium air: enthalpy, density, viscosity and speed of sound of hot air, and the enthalpy of air at the wall.

The enthalpies are zero at 0 K. The table is `data/equilibrium_air.csv` (its source is in the file): 200 to 12000 K,
1 Pa to 1 MPa, linear in T and in log10 p. Outside in pressure the composition of the edge is kept (the density still
follows p); below 200 K the enthalpy runs linearly to zero at 0 K; above 12000 K the edge value is returned. Between
its points the table is within 0.4 % in h, 0.2 % in Z and 15 K in T(h, p) of the equilibrium it was computed from.
Viscosity is Sutherland's up to 700 K; above, it is Sutherland's times the table's ratio to it. The speed of sound is
tabulated against h and p: as a derivative of the lines between the points of the table it would fall by 0.6 % at every
one of them. It is within 0.05 % of the equilibrium to 8000 K, 0.1 % above.
Equations: docs/theory/equations_reference_heating.md, equations 5 to 8.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import cache, partial
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from sim_heating.base.arrays import FloatArray
from sim_heating.base.errors import InputError
from sim_heating.base.files.package import read_package_table
from sim_heating.base.kernels.jit import njit, njit_of
from sim_heating.base.kernels.operations import pointer
from sim_heating.heating.atmosphere import MOLAR_GAS_CONSTANT, sutherland_kernel, sutherland_viscosity

MOLAR_MASS_N2_O2 = 28.85064
"""Molar mass of the table's undissociated 79/21 mixture [kg/kmol]; 0.4 % below that of air with argon."""
R_TABLE = MOLAR_GAS_CONSTANT / MOLAR_MASS_N2_O2
"""Gas constant of the undissociated mixture [J/(kg K)]."""
PRANDTL = 0.71
"""Prandtl number of air in the reference heatings [-]: that of Fay and Riddell's correlation. Published frozen values
scatter about it, 0.68 to 0.78 from 1000 to 6000 K (docs/theory/equations_reference_heating.md, section 2)."""
ENTHALPY_BIN, ENTHALPY_BINS = 2.5e5, 160
"""Width [J/kg] and number of the bins of enthalpy that start the search for a temperature; the last has no end."""
SOUND_STEP = 25.0
"""Step [m/s] of the axis sqrt(h) of the speed of sound."""
SOUND_REFINED = 10
"""Points between two temperatures of the table from which that axis is filled."""
JOIN_K = 700.0
"""Temperature [K] up to which the viscosity is Sutherland's; the table's differs from it by 0.2 % there."""


class Grid(NamedTuple):
    """The table of equilibrium air: axes log10 p [Pa] and T [K], and columns as (pressure, temperature).

    h, Z, dissociation : enthalpy above 0 K [J/kg], compressibility [-], dissociation enthalpy [J/kg]
    viscosity_ratio    : viscosity over Sutherland's [-], 1 up to JOIN_K
    viscosity_sigma, prandtl, prandtl_sigma : relative sigma of the viscosity, frozen Prandtl number, its sigma [-]
    sound_m_s          : speed of sound [m/s]
    """

    log_p: FloatArray
    T: FloatArray
    h: FloatArray
    Z: FloatArray
    dissociation: FloatArray
    viscosity_ratio: FloatArray
    viscosity_sigma: FloatArray
    prandtl: FloatArray
    prandtl_sigma: FloatArray
    sound_m_s: FloatArray


@cache
def _grid() -> Grid:
    """The table, read when it is first asked for."""
    table = read_package_table("heating/data/equilibrium_air.csv")
    log_p, T = np.unique(table["log10_p_Pa"]), np.unique(table["T_K"])
    table["viscosity_ratio"] = np.where(
        table["T_K"] > JOIN_K, table["viscosity_Pa_s"] / sutherland_viscosity(table["T_K"]), 1.0
    )
    names = ("h_J_kg", "Z", "dissociation_J_kg", *Grid._fields[5:])
    return Grid(log_p, T, *(table[name].reshape(len(log_p), len(T)) for name in names))


@njit
def _uniform_cell(x: float, first: float, step: float, count: int) -> tuple[int, float]:
    """Interval of a uniform axis and the fraction within it [-]; values outside count as the nearest end.

    The fraction of a value that is not a number is none either, in the first interval: no index leaves the table.
    """
    s = min(max((x - first) / step, 0.0), count - 1.0)
    i = min(int(s) if s >= 0.0 else 0, count - 2)
    return i, s - i


@njit
def _blend(f: FloatArray, length: int, i: int, w: float, j: int, s: float) -> float:
    """Bilinear value of a table f in cell (i, j), fractions w and s of the way through it; f in rows of a length."""
    a = i * length + j
    b = a + length
    return (1.0 - w) * ((1.0 - s) * f[a] + s * f[a + 1]) + w * ((1.0 - s) * f[b] + s * f[b + 1])


def _make_pressure_cell() -> Callable[[float], tuple[int, float]]:
    log_p = _grid().log_p
    first, step, count = log_p[0], log_p[1] - log_p[0], len(log_p)

    def cell(p_Pa: float) -> tuple[int, float]:
        return _uniform_cell(math.log10(p_Pa), first, step, count)

    return cell


def _make_temperature_cell() -> Callable[[float], tuple[int, float]]:
    T_axis = _grid().T
    first, step, count = T_axis[0], T_axis[1] - T_axis[0], len(T_axis)

    def cell(T_K: float) -> tuple[int, float]:
        return _uniform_cell(T_K, first, step, count)

    return cell


def _make_column(name: str) -> Callable[[int, float, int, float], float]:
    grid = getattr(_grid(), name)
    flat, length = grid.ravel(), grid.shape[1]

    def column(i: int, w: float, j: int, s: float) -> float:
        return _blend(pointer(flat), length, i, w, j, s)

    return column


def _make_enthalpy() -> Callable[[float, int, float, int, float], float]:
    T_first, h_flat, length = _grid().T[0], _grid().h.ravel(), len(_grid().T)

    def enthalpy(T_K: float, i: int, w: float, j: int, s: float) -> float:
        # Below the table h is proportional to T, which keeps cp positive for cold walls and wind-tunnel streams.
        return _blend(pointer(h_flat), length, i, w, j, s) * min(T_K / T_first, 1.0)

    return enthalpy


def _make_inverse() -> Callable[[float, int, float], tuple[float, int, float]]:
    T_axis, h_grid = _grid()[1:3]
    T_first, T_step, last = T_axis[0], T_axis[1] - T_axis[0], len(T_axis) - 1
    # First temperature of the search for each bin of enthalpy: not above the answer at either pressure of the cell.
    feet = ENTHALPY_BIN * np.arange(ENTHALPY_BINS)
    below = np.array([np.maximum(np.searchsorted(row, feet, side="right") - 1, 0) for row in h_grid])
    begin = np.minimum(below[:-1], below[1:]).ravel()
    h_flat, length = h_grid.ravel(), len(T_axis)

    def inverse(h_J_kg: float, i: int, w: float) -> tuple[float, int, float]:
        # Pointers: no index is counted from the end.
        h, start, here = pointer(h_flat), pointer(begin), i * length
        above = here + length
        h_first = (1.0 - w) * h[here] + w * h[above]
        # Below the table the straight line to 0 K of the lookup, of which this is the inverse.
        if h_J_kg <= h_first:
            return T_first * h_J_kg / h_first, 0, 0.0
        bin_ = h_J_kg * (1.0 / ENTHALPY_BIN)
        # From the foot of its bin a temperature is a few cells away; bisection over the whole axis takes eight steps.
        low = start[i * ENTHALPY_BINS + (int(bin_) if bin_ < ENTHALPY_BINS else ENTHALPY_BINS - 1)]
        while low < last - 1 and (1.0 - w) * h[here + low + 1] + w * h[above + low + 1] <= h_J_kg:
            low += 1
        h_low = (1.0 - w) * h[here + low] + w * h[above + low]
        h_high = (1.0 - w) * h[here + low + 1] + w * h[above + low + 1]
        s = min((h_J_kg - h_low) / (h_high - h_low), 1.0)
        return T_first + T_step * (low + s), low, s

    return inverse


def _make_sound() -> Callable[[float, int, float], float]:
    log_p, T_axis, h = _grid()[:3]
    # The ratio a / sqrt(h) changes slowly: cubic in sqrt(h), linear in log10 p. Its axis begins and ends one step early
    # and late, for the cubic's neighbours; it is filled by cubics in T, as dissociation begins within a few points.
    T = np.linspace(T_axis[0], T_axis[-1], SOUND_REFINED * (len(T_axis) - 1) + 1)
    weights = _cubic_weights(T, T_axis).T
    root, ratio = np.sqrt(h @ weights), (_grid().sound_m_s / np.sqrt(h)) @ weights
    count = math.ceil(np.max(root) / SOUND_STEP) + 1
    axis, length = SOUND_STEP * np.arange(-1, count + 1), count + 2
    flat = np.concatenate([np.interp(axis, root[i], ratio[i]) for i in range(len(log_p))])

    def sound(h_J_kg: float, i: int, w: float) -> float:
        root_h, f = math.sqrt(h_J_kg), pointer(flat)
        j, s = _uniform_cell(root_h, 0.0, SOUND_STEP, count)
        # Catmull and Rom's cubic: through two points with the slopes of parabolas through three.
        before, after = -0.5 * s * (1.0 - s) * (1.0 - s), -0.5 * s * s * (1.0 - s)
        here, there = 1.0 - s * s * (2.5 - 1.5 * s), s * (0.5 + s * (2.0 - 1.5 * s))
        a = i * length + j
        b = a + length
        ratio = (1.0 - w) * (before * f[a] + here * f[a + 1] + there * f[a + 2] + after * f[a + 3])
        return root_h * (ratio + w * (before * f[b] + here * f[b + 1] + there * f[b + 2] + after * f[b + 3]))

    return sound


# They close over arrays and numbers only: a compiled kernel in one would change the cache key at every start.
pressure_cell = njit_of(_make_pressure_cell)
"""pressure_cell(p_Pa) -> i, w: cell of the table in log10 p and fraction of it [-]; all at one pressure shares it."""
_temperature_cell = njit_of(_make_temperature_cell)
"""_temperature_cell(T_K) -> j, s: cell of the table in T and fraction of it [-]."""
_enthalpy = njit_of(_make_enthalpy)
_air_inverse = njit_of(_make_inverse)
"""_air_inverse(h_J_kg, i, w) -> T [K], j, s: exact inverse of the table's h(T, p); 12000 K above the table."""
sound_in_cell = njit_of(_make_sound)
"""sound_in_cell(h_J_kg, i, w) -> speed of sound of equilibrium air [m/s] at an enthalpy above 0 K, with i, w of
`pressure_cell`. docs/theory/equations_reference_heating.md, equation 34."""
_compressibility = njit_of(partial(_make_column, "Z"))
_dissociation = njit_of(partial(_make_column, "dissociation"))
_viscosity_ratio = njit_of(partial(_make_column, "viscosity_ratio"))
_viscosity_sigma = njit_of(partial(_make_column, "viscosity_sigma"))
_prandtl = njit_of(partial(_make_column, "prandtl"))
_prandtl_sigma = njit_of(partial(_make_column, "prandtl_sigma"))


@njit
def air_kernel(T_K: float, p_Pa: float) -> tuple[float, float, float]:
    """Enthalpy h [J/kg], compressibility Z [-] and dissociation enthalpy [J/kg] of equilibrium air.

    T_K : temperature [K];  p_Pa : pressure [Pa], above 0
    Source: docs/theory/equations_reference_heating.md, equation 5.
    """
    i, w = pressure_cell(p_Pa)
    j, s = _temperature_cell(T_K)
    return _enthalpy(T_K, i, w, j, s), _compressibility(i, w, j, s), _dissociation(i, w, j, s)


@njit
def air_temperature_kernel(h_J_kg: float, p_Pa: float) -> float:
    """Temperature of equilibrium air [K] at an enthalpy and a pressure, the exact inverse of the table's h(T, p).

    h_J_kg : enthalpy above 0 K [J/kg], 0 or more;  p_Pa : pressure [Pa], above 0
    The result is 12000 K above the table; below 200 K it is proportional to h.
    Source: docs/theory/equations_reference_heating.md, equation 6.
    """
    i, w = pressure_cell(p_Pa)
    return _air_inverse(h_J_kg, i, w)[0]


@njit
def _density(p_Pa: float, Z: float, T_K: float) -> float:
    return p_Pa / (Z * R_TABLE * T_K)


@njit
def air_density_of_enthalpy_kernel(h_J_kg: float, p_Pa: float) -> float:
    """Density of equilibrium air rho = p / (Z R T) [kg/m3] at an enthalpy and a pressure.

    h_J_kg : enthalpy above 0 K [J/kg];  p_Pa : pressure [Pa], above 0
    Equal to `air_density_kernel` at the temperature of h, with one table search instead of two.
    Source: docs/theory/equations_reference_heating.md, equations 5 and 6.
    """
    i, w = pressure_cell(p_Pa)
    T_K, j, s = _air_inverse(h_J_kg, i, w)
    return _density(p_Pa, _compressibility(i, w, j, s), T_K)


@njit
def air_density_kernel(T_K: float, p_Pa: float) -> float:
    """Density of equilibrium air rho = p / (Z R T) [kg/m3], Z the compressibility of the table, R = 288.2 [J/(kg K)].

    T_K : temperature [K], above 0;  p_Pa : pressure [Pa], above 0
    Source: docs/theory/equations_reference_heating.md, equation 5.
    """
    return _density(p_Pa, air_kernel(T_K, p_Pa)[1], T_K)


@njit
def _cell_viscosity(T_K: float, i: int, w: float, j: int, s: float) -> float:
    if T_K <= JOIN_K:
        return sutherland_kernel(T_K)
    return sutherland_kernel(T_K) * _viscosity_ratio(i, w, j, s)


@njit
def air_transport_kernel(T_K: float, p_Pa: float) -> tuple[float, float]:
    """Density [kg/m3] and viscosity [Pa s] of equilibrium air at a temperature and a pressure.

    T_K : temperature [K], above 0;  p_Pa : pressure [Pa], above 0; nothing is checked. `transport` states the accuracy.
    Source: docs/theory/equations_reference_heating.md, equations 5 and 7.
    """
    i, w = pressure_cell(p_Pa)
    j, s = _temperature_cell(T_K)
    return _density(p_Pa, _compressibility(i, w, j, s), T_K), _cell_viscosity(T_K, i, w, j, s)


@njit
def enthalpy_in_cell(T_K: float, i: int, w: float) -> float:
    """Enthalpy above 0 K [J/kg] of air at a temperature T_K [K], where `pressure_cell` (i, w) is known.

    Source: docs/theory/equations_reference_heating.md, equation 5.
    """
    j, s = _temperature_cell(T_K)
    return _enthalpy(T_K, i, w, j, s)


@njit
def state_in_cell(h_J_kg: float, p_Pa: float, i: int, w: float) -> tuple[float, float, float]:
    """Density [kg/m3], viscosity [Pa s] and temperature [K] of air, where the cell of the pressure is known.

    h_J_kg, p_Pa : enthalpy above 0 K [J/kg], pressure [Pa];  i, w : `pressure_cell` of this pressure
    Source: docs/theory/equations_reference_heating.md, equations 5 to 7.
    """
    T_K, j, s = _air_inverse(h_J_kg, i, w)
    return _density(p_Pa, _compressibility(i, w, j, s), T_K), _cell_viscosity(T_K, i, w, j, s), T_K


@njit
def dissociation_in_cell(T_K: float, i: int, w: float) -> float:
    """Dissociation enthalpy [J/kg] of air at a temperature T_K [K], where `pressure_cell` (i, w) is known.

    Source: docs/theory/equations_reference_heating.md, equation 5.
    """
    j, s = _temperature_cell(T_K)
    return _dissociation(i, w, j, s)


@njit
def air_dissociation_kernel(h_J_kg: float, p_Pa: float) -> float:
    """Dissociation enthalpy [J/kg] of equilibrium air at an enthalpy above 0 K [J/kg] and a pressure [Pa], above 0.

    Source: docs/theory/equations_reference_heating.md, equations 5 and 6.
    """
    i, w = pressure_cell(p_Pa)
    return dissociation_in_cell(_air_inverse(h_J_kg, i, w)[0], i, w)


@njit
def air_state_kernel(h_J_kg: float, p_Pa: float) -> tuple[float, float]:
    """Density [kg/m3] and viscosity [Pa s] of equilibrium air at an enthalpy and a pressure, with one table search.

    h_J_kg : enthalpy above 0 K [J/kg];  p_Pa : pressure [Pa], above 0
    Source: docs/theory/equations_reference_heating.md, equations 5 to 7.
    """
    i, w = pressure_cell(p_Pa)
    rho, mu, _ = state_in_cell(h_J_kg, p_Pa, i, w)
    return rho, mu


FROZEN_HOTTEST_K = 3000.0
"""Temperature [K] up to which the polynomial of frozen air is used, which is a fit to 2200 K; linear above."""


@njit
def frozen_enthalpy(T_K: float) -> float:
    """Enthalpy above 0 K [J/kg] of air at a temperature [K] without dissociation, within 0.34 % from 200 to 2200 K.

        h = 0.00655 + 0.96674 x + 0.04828 x^2 + 0.04626 x^3 - 0.01460 x^4 [MJ/kg],    x = T / 1000 K

    Source: fit to NASA-9 polynomials of N2 and O2 (NASA/TP-2002-211556);
    docs/theory/equations_reference_heating.md, equation 8a.
    """
    x = min(T_K, FROZEN_HOTTEST_K) * 1e-3
    h = 0.00655 + x * (0.96674 + x * (0.04828 + x * (0.04626 - x * 0.01460)))
    return 1e6 * h * (T_K * 1e-3 / x)


@njit
def _transport_grid(T_K: FloatArray, p_Pa: FloatArray, out: FloatArray) -> None:
    for m in range(len(T_K)):
        for n in range(len(p_Pa)):
            i, w = pressure_cell(p_Pa[n])
            j, s = _temperature_cell(T_K[m])
            out[0, m, n] = _cell_viscosity(T_K[m], i, w, j, s)
            out[1, m, n] = _viscosity_sigma(i, w, j, s)
            out[2, m, n] = _prandtl(i, w, j, s)
            out[3, m, n] = _prandtl_sigma(i, w, j, s)


def _positive_row(name: str, values: ArrayLike) -> FloatArray:
    a = np.atleast_1d(np.asarray(values, dtype=float))
    if a.ndim != 1 or a.size == 0:
        raise InputError(f"{name}: give one row of values, not an array of shape {a.shape}")
    if not np.all(np.isfinite(a) & (a > 0.0)):
        raise InputError(f"{name}: {a[~(np.isfinite(a) & (a > 0.0))][0]} must be finite and above 0")
    return np.ascontiguousarray(a)


class AirTransport(NamedTuple):
    """Transport properties of equilibrium air on a grid (T, p): viscosity [Pa s], its relative sigma [-], frozen
    Prandtl number [-], its relative sigma [-].
    """

    viscosity_Pa_s: FloatArray
    viscosity_sigma: FloatArray
    prandtl: FloatArray
    prandtl_sigma: FloatArray


def transport(T_K: ArrayLike, p_Pa: ArrayLike) -> AirTransport:
    """Viscosity and frozen Prandtl number of equilibrium air, with sigma, on a grid of temperatures and pressures.

    T_K     : (T,) temperature [K]; Sutherland's viscosity to 700, the table to 12000, continued above
    p_Pa    : (p,) pressure [Pa], 1 to 1e6; outside, the composition of the edge
    returns : (T, p) viscosity [Pa s] and Prandtl number [-], each with the relative standard deviation of the two sets
              of data that it is the mean of
    raises  : InputError where T or p is not positive, or not one row of values

    Viscosity is within 3 % (one sigma) where at most 1 % of the particles are electrons; above, air is ionised, and the
    sigma grows to 50 %. The Prandtl number leaves electrons and reactions out.
    Source: docs/theory/equations_reference_heating.md, equation 7: CEA (NASA RP-1311) and Blottner et al.
    (SC-RR-70-754).
    """
    T, p = _positive_row("T_K", T_K), _positive_row("p_Pa", p_Pa)
    out = np.empty((4, len(T), len(p)))
    _transport_grid(T, p, out)
    return AirTransport(*out)


def wall_enthalpy_grid(
    kind: str | float | Mapping[str, float], T_grid_K: ArrayLike, p_grid_Pa: ArrayLike
) -> FloatArray:
    """Enthalpy of air at the wall temperature, H_w(T, p) [J/kg], zero at 0 K.

    kind      : "equilibrium-air", or a constant cp as a number [J/(kg K)] or {"cp_J_kgK": number}: then cp T, exactly
    T_grid_K  : (T,) wall temperatures [K]
    p_grid_Pa : (p,) pressures at the wall [Pa]; without effect on a constant cp
    returns   : (T, p) enthalpy [J/kg], of equilibrium air within 0.02 % of the equilibrium
    raises    : InputError for another kind, a cp that is not positive, a temperature or pressure that is not positive

    Cubic through the points of the table, which on straight lines between them is 0.4 % off where oxygen dissociates.
    Source: docs/theory/equations_reference_heating.md, equation 8.
    """
    cp = None if kind == "equilibrium-air" else _constant_cp(kind)
    T, p = _positive_row("T_grid_K", T_grid_K), _positive_row("p_grid_Pa", p_grid_Pa)
    if cp is not None:
        return np.repeat((cp * T)[:, None], len(p), axis=1)
    log_p, T_axis, h = _grid()[:3]
    smooth = _cubic_weights(T, T_axis) @ h.T @ _cubic_weights(np.log10(p), log_p).T
    # As everywhere below the table h is proportional to T.
    return smooth * np.minimum(T / T_axis[0], 1.0)[:, None]


def _cubic_weights(x: FloatArray, axis: FloatArray) -> FloatArray:
    """(x, node) weights of Lagrange's cubic through the four nearest nodes of an even axis; edge values outside."""
    s = np.clip((x - axis[0]) / (axis[1] - axis[0]), 0.0, len(axis) - 1.0)
    first = np.clip(np.floor(s).astype(int) - 1, 0, len(axis) - 4)
    weights = np.zeros((len(x), len(axis)))
    for k in range(4):
        others = np.array([m for m in range(4) if m != k])
        weights[np.arange(len(x)), first + k] = np.prod(((s - first)[:, None] - others) / (k - others), axis=1)
    return weights


def _constant_cp(kind: str | float | Mapping[str, float]) -> float:
    cp = kind.get("cp_J_kgK") if isinstance(kind, Mapping) else kind
    # To Python a bool is an int: `true` in a file would be cp = 1.
    if isinstance(cp, bool) or not isinstance(cp, int | float):
        raise InputError(f'heating.wall_enthalpy: {kind!r} is neither "equilibrium-air" nor {{ cp_J_kgK = 1004.5 }}')
    if not (math.isfinite(cp) and cp > 0.0):
        raise InputError(f"heating.wall_enthalpy, cp_J_kgK: {cp} is not a specific heat (must be above 0)")
    return float(cp)
