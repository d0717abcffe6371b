"""Residuals of in-depth thermocouples as heat deposited in depth and time.

A source s(x, t) [W/m3] in the wall changes its temperatures by R s, R being the response of conduction linearised about
the temperatures of the fitted model (implicit Euler, finite volumes). Given residuals r of noise N, and for s a
Gaussian process of covariance P = a^2 exp(-(dx / l)^2 / 2 - (dt / tau)^2 / 2),

    s = P R' (R P R' + N)^-1 r,    cov = P - P R' (R P R' + N)^-1 R P,

a, l, tau by the largest likelihood of r, so that the data choose the smoothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve, solve_banded

FloatArray = NDArray[np.float64]

DEPTH_BINS, TIME_BIN_S = 14, 5.0
AMPLITUDES_W_M3 = np.geomspace(1e4, 1e6, 9)
LENGTHS_M = (1.5e-3, 3e-3, 6e-3)
TIMES_S = (5.0, 10.0, 20.0, 40.0)


@dataclass(frozen=True, eq=False)
class Slab:
    """A wall of one material on equal elements.

    depth_m : (node,);  temperature_K : (time, node) of the fitted model each second
    conductivity_W_mK : (time, element);  capacity_J_m3K : heat capacity of volume
    sensors : (sensor,) nodes of the thermocouples
    """

    depth_m: FloatArray
    temperature_K: FloatArray
    conductivity_W_mK: FloatArray
    capacity_J_m3K: float
    sensors: Sequence[int]
    loss_W_m2K: FloatArray


@dataclass(frozen=True, eq=False)
class Deposit:
    """Source and its sigma (depth bin, time bin) [W/m3], middles of the bins, the remaining residual [K], and
    the likeliest values of amplitude [W/m3], length [m], time [s]."""

    source_W_m3: FloatArray
    sigma_W_m3: FloatArray
    depth_m: FloatArray
    time_s: FloatArray
    left_K: FloatArray
    chosen: tuple[float, float, float]


def deposited_heat(slab: Slab, residual_K: FloatArray, sigma_K: FloatArray) -> Deposit:
    """The source that explains residuals (sensor, time) each second, of noise sigma_K (sensor,)."""
    count = residual_K.shape[1]
    depth = (np.arange(DEPTH_BINS) + 0.5) * slab.depth_m[-1] / DEPTH_BINS
    time = np.arange(0.5 * TIME_BIN_S, count - 1, TIME_BIN_S)
    R = response(slab, len(time), count).reshape(len(depth) * len(time), -1).T
    r, N = residual_K.ravel(), np.repeat(sigma_K**2, count)
    dx2 = (depth[:, np.newaxis] - depth) ** 2
    dt2 = (time[:, np.newaxis] - time) ** 2
    best: tuple[float, tuple[float, float, float]] = (-np.inf, (0.0, 0.0, 0.0))
    for length, tau in product(LENGTHS_M, TIMES_S):
        unit = np.kron(np.exp(-0.5 * dx2 / length**2), np.exp(-0.5 * dt2 / tau**2))
        spread = R @ unit @ R.T
        for a in AMPLITUDES_W_M3:
            factor = cho_factor(a**2 * spread + np.diag(N), lower=True)
            value = -0.5 * float(r @ cho_solve(factor, r)) - float(np.sum(np.log(np.diag(factor[0]))))
            best = max(best, (value, (float(a), length, tau)))
    a, length, tau = best[1]
    P = a**2 * np.kron(np.exp(-0.5 * dx2 / length**2), np.exp(-0.5 * dt2 / tau**2))
    factor = cho_factor(R @ P @ R.T + np.diag(N), lower=True)
    s = P @ R.T @ cho_solve(factor, r)
    variance = np.diag(P) - np.einsum("ij,ji->i", P @ R.T, cho_solve(factor, R @ P))
    shape = (len(depth), len(time))
    left = (r - R @ s).reshape(residual_K.shape)
    return Deposit(s.reshape(shape), np.sqrt(np.maximum(variance, 0.0)).reshape(shape), depth, time, left, best[1])


def response(slab: Slab, bins: int, count: int) -> FloatArray:
    """(depth bin, time bin, sensor, time) temperatures [K] per unit source [W/m3] in each bin."""
    x = slab.depth_m
    dx = x[1] - x[0]
    cell = np.full(len(x), dx)
    cell[[0, -1]] *= 0.5
    member = np.minimum((x / x[-1] * DEPTH_BINS).astype(int), DEPTH_BINS - 1)
    shape = (member == np.arange(DEPTH_BINS)[:, np.newaxis]) * cell
    T = np.zeros((len(x), DEPTH_BINS * bins))
    found = np.zeros((DEPTH_BINS, bins, len(slab.sensors), count))
    for n in range(1, count):
        g = slab.conductivity_W_mK[n] / dx
        C = slab.capacity_J_m3K * cell
        band = np.zeros((3, len(x)))
        band[0, 1:], band[2, :-1] = -g, -g
        band[1] = C + np.append(g, 0.0) + np.append(0.0, g)
        band[1, 0] += slab.loss_W_m2K[n]
        right = C[:, np.newaxis] * T
        now = min(int((n - 0.5) / TIME_BIN_S), bins - 1)
        right[:, now::bins] += shape.T
        T = solve_banded((1, 1), band, right)
        found[:, :, :, n] = T[list(slab.sensors)].reshape(len(slab.sensors), DEPTH_BINS, bins).transpose(1, 2, 0)
    return found
