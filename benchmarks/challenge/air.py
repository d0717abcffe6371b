"""Air: US Standard Atmosphere 1976, viscosity, enthalpy at the wall, stagnation heating, surface pressure.

    T, p of the seven layers below 86 km from lapse rates; above them the published table, linear in log rho and log p
    mu  = 1.458e-6 T^1.5 / (T + 110.4)                              Sutherland, as the record format states
    H_w = (0.79 H_N2 + 0.21 H_O2) / M            molar enthalpies of NIST-JANAF, zero at 0 K, linear between their rows
    q   = 1.7415e-4 sqrt(rho / R_n) V^3,  h = q / H_r,  H_r = V^2 / 2 + cp T     Sutton and Graves, cold wall
    p_s = p + 1.84 q_dyn sin^2(angle)                                            modified Newtonian

Composition frozen: H_w is that of equilibrium air up to 1500 K at 10 Pa and 1700 K at 1 kPa, within 0.2 %.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

G0 = 9.80665
R_AIR = 287.053
CP = 1004.5
EARTH_M = 6_356_766.0
LAYERS = (
    (0.0, 288.15, 101325.0, -6.5e-3), (11e3, 216.65, 22632.06, 0.0), (20e3, 216.65, 5474.889, 1e-3),
    (32e3, 228.65, 868.0187, 2.8e-3), (47e3, 270.65, 110.9063, 0.0), (51e3, 270.65, 66.93887, -2.8e-3),
    (71e3, 214.65, 3.956420, -2e-3),
)  # fmt: skip
"""Geopotential altitude [m], temperature [K], pressure [Pa], lapse rate [K/m]."""

HIGH_M = np.array([86e3, 90e3, 95e3, 100e3, 105e3, 110e3, 115e3, 120e3, 125e3])
HIGH_K = np.array([186.87, 186.87, 188.42, 195.08, 208.84, 240.0, 300.0, 360.0, 417.23])
HIGH_LOG_PA = np.log(
    [3.7338e-1, 1.8359e-1, 7.5966e-2, 3.2011e-2, 1.4477e-2, 7.1042e-3, 4.0096e-3, 2.5382e-3, 1.7354e-3]
)
HIGH_LOG_RHO = np.log([6.958e-6, 3.416e-6, 1.393e-6, 5.604e-7, 2.325e-7, 9.708e-8, 4.289e-8, 2.222e-8, 1.291e-8])
NOSE_RADIUS_M = 0.3048
LENGTH_M = 32.77362
"""Reference length of the Orbiter."""
WALL_K = np.arange(0.0, 3001.0, 5.0)
JANAF_K = [
    0,
    100,
    200,
    298.15,
    400,
    500,
    600,
    700,
    800,
    900,
    1000,
    1100,
    1200,
    1300,
    1400,
    1500,
    1600,
    1700,
    1800,
    2000,
]
N2_KJ_MOL = [0, 2.902, 5.813, 8.670, 11.641, 14.581, 17.564, 20.607, 23.716, 26.893, 30.133, 33.430, 36.779, 40.173,
             43.606, 47.075, 50.574, 54.099, 57.648, 64.807]  # fmt: skip
O2_KJ_MOL = [0, 2.904, 5.815, 8.683, 11.708, 14.767, 17.927, 21.182, 24.518, 27.924, 31.386, 34.895, 38.444, 42.027,
             45.640, 49.282, 52.949, 56.641, 60.356, 67.858]  # fmt: skip


def standard_air(altitude_m: float) -> tuple[float, float, float]:
    """Temperature [K], pressure [Pa] and density [kg/m3]."""
    if altitude_m >= HIGH_M[0]:
        T = float(np.interp(altitude_m, HIGH_M, HIGH_K))
        p = math.exp(np.interp(altitude_m, HIGH_M, HIGH_LOG_PA))
        return T, p, math.exp(np.interp(altitude_m, HIGH_M, HIGH_LOG_RHO))
    h = altitude_m * EARTH_M / (EARTH_M + altitude_m)
    base, T_base, p_base, lapse = next(layer for layer in reversed(LAYERS) if h >= layer[0] or layer is LAYERS[0])
    T = T_base + lapse * (h - base)
    if lapse:
        p = p_base * (T / T_base) ** (-G0 / (R_AIR * lapse))
    else:
        p = p_base * math.exp(-G0 * (h - base) / (R_AIR * T_base))
    return T, p, p / (R_AIR * T)


def viscosity(T_K: FloatArray) -> FloatArray:
    """Viscosity [Pa s] by Sutherland."""
    return np.asarray(1.458e-6 * T_K**1.5 / (T_K + 110.4))


def wall_enthalpy(cp_J_kgK: float | None) -> FloatArray:
    """Enthalpy of air [J/kg] at WALL_K: of constant cp, or (None) of nitrogen and oxygen."""
    if cp_J_kgK is not None:
        return cp_J_kgK * WALL_K
    molar = [np.interp(WALL_K, JANAF_K, np.array(H) * 1e3) for H in (N2_KJ_MOL, O2_KJ_MOL)]
    return np.asarray((0.79 * molar[0] + 0.21 * molar[1]) / (0.79 * 28.0134e-3 + 0.21 * 31.9988e-3))


def reference_heating(rho: FloatArray, V: FloatArray, T_inf: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Film coefficient [kg/(m2 s)] of the reference sphere, and total enthalpy [J/kg]."""
    H_r = 0.5 * V**2 + CP * T_inf
    return 1.7415e-4 * np.sqrt(rho / NOSE_RADIUS_M) * V**3 / H_r, H_r
