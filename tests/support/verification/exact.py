"""Exact solutions of heat conduction and of surface balances, for constant properties unless a name states otherwise.

Symbols: k conductivity [W/(m K)], a = k / (rho c) diffusivity [m2/s], e = sqrt(k rho c) effusivity [J/(m2 K s^(1/2))],
q flux [W/m2], x depth [m], t time [s] above 0. Temperatures are rises over the initial one unless stated otherwise.
Sources: Carslaw & Jaeger, Conduction of Heat in Solids, 2nd ed. (1959), sections 2.4 to 2.9, 3.8 and 12.8.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.special import erfc, erfcx

FloatArray = NDArray[np.float64]
SIGMA = 5.670374419e-8
"""Stefan-Boltzmann constant [W/(m2 K4)], CODATA 2018."""


def ierfc(u: FloatArray) -> FloatArray:
    """Integral of erfc from u to infinity."""
    return np.exp(-(u**2)) / math.sqrt(math.pi) - u * erfc(u)


def semi_infinite_flux(q: float, k: float, a: float, x: float, t: FloatArray) -> FloatArray:
    """Half space under a constant flux: (2 q / k) sqrt(a t) ierfc(x / (2 sqrt(a t)))."""
    return 2.0 * q / k * np.sqrt(a * t) * ierfc(x / (2.0 * np.sqrt(a * t)))


def semi_infinite_linear_flux(slope: float, k: float, a: float, t: FloatArray) -> FloatArray:
    """Surface of a half space under a flux slope * t [W/m2]: 4 slope t^(3/2) sqrt(a) / (3 k sqrt(pi))."""
    return 4.0 * slope * t**1.5 * math.sqrt(a) / (3.0 * k * math.sqrt(math.pi))


def semi_infinite_film(h: float, k: float, a: float, x: float, t: FloatArray) -> FloatArray:
    """(T - T_0) / (T_g - T_0) of a half space with film coefficient h [W/(m2 K)] to gas at T_g.

    erfc(z) - exp(h x / k + h^2 a t / k^2) erfc(z + h sqrt(a t) / k), z = x / (2 sqrt(a t)), the product as
    exp(-z^2) erfcx(z + h sqrt(a t) / k), which cannot overflow.
    """
    z = x / (2.0 * np.sqrt(a * t))
    return erfc(z) - np.exp(-(z**2)) * erfcx(z + h * np.sqrt(a * t) / k)


def slab_flux(q: float, k: float, a: float, length: float, depth: float, t: FloatArray, terms: int = 200) -> FloatArray:
    """Slab heated at depth 0, insulated at its back.

    (q L / k) [Fo + (3 xi^2 - 1) / 6 - (2 / pi^2) sum (-1)^n / n^2 exp(-n^2 pi^2 Fo) cos(n pi xi)], xi = 1 - depth / L.
    """
    fo, xi = a * t / length**2, 1.0 - depth / length
    n = np.arange(1, terms + 1)[:, np.newaxis]
    series = np.sum((-1.0) ** n / n**2 * np.exp(-(n**2) * math.pi**2 * fo) * np.cos(n * math.pi * xi), axis=0)
    return q * length / k * (fo + (3.0 * xi**2 - 1.0) / 6.0 - 2.0 / math.pi**2 * series)


def coated_surface(q: float, e_coat: float, a_coat: float, e_below: float, delta: float, t: FloatArray) -> FloatArray:
    """Surface of a coating of thickness delta on a half space, constant flux.

    (2 q sqrt(t) / e_1) [1 / sqrt(pi) + 2 sum b^n ierfc(n delta / sqrt(a_1 t))], b = (e_1 - e_2) / (e_1 + e_2); as many
    terms as still matter: hundreds where e_2 << e_1.
    """
    b = (e_coat - e_below) / (e_coat + e_below)
    n = np.arange(1, int(8.0 * math.sqrt(a_coat * float(np.max(t))) / delta) + 2)[:, np.newaxis]
    series = np.sum(b**n * ierfc(n * delta / np.sqrt(a_coat * t)), axis=0)
    return 2.0 * q * np.sqrt(t) / e_coat * (1.0 / math.sqrt(math.pi) + 2.0 * series)


def cosine_decay(a: float, length: float, mode: int, x: FloatArray, t: float) -> FloatArray:
    """cos(n pi x / L) exp(-n^2 pi^2 a t / L^2): a mode of a slab with both faces insulated."""
    wave = mode * math.pi / length
    return np.cos(wave * x) * math.exp(-(wave**2) * a * t)


def radiating_mass_time(theta: FloatArray, theta_0: float, heat_capacity: float, eps: float, T_r: float) -> FloatArray:
    """Time [s] at which a lumped wall of rho c delta [J/(m2 K)] has risen from theta_0 to theta = T / T_r.

    (rho c delta / (eps sigma T_r^3)) [(atanh u + atan u) / 2] between theta_0 and theta, T_r = (q / (eps sigma))^(1/4).
    """

    def rise(u: FloatArray | float) -> FloatArray:
        return 0.5 * (np.arctanh(u) + np.arctan(u))

    return heat_capacity / (eps * SIGMA * T_r**3) * (rise(theta) - rise(theta_0))


def radiation_equilibrium(q: float, eps: float, surroundings: float = 0.0) -> float:
    """Temperature [K] of a surface that gives back all of a flux: eps sigma (T^4 - T_sur^4) = q."""
    return (q / (eps * SIGMA) + surroundings**4) ** 0.25
