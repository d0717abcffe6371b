"""Surface temperature of a half space whose heating depends on it, from its integral equation.

    T(t) = T_0 + int_0^t S'(t - s) q(T(s), s) ds

S is the rise of the surface under a constant unit flux [K m2/W], so that no mesh in depth is needed: with S the series
of a coating on a half space (`exact.coated_surface`) it is exact for both layers. Duhamel's theorem, Carslaw & Jaeger
(1959), 1.14.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

FloatArray = NDArray[np.float64]


def surface_temperature(
    step_response: Callable[[FloatArray], FloatArray],
    flux: Callable[[float, float], float],
    start_K: float,
    end_s: float,
    steps: int,
) -> float:
    """Surface temperature [K] at the end, extrapolated from a number of steps and half as many.

    step_response : rise of the surface [K m2/W] at times [s] above 0;  flux : net flux [W/m2] of T [K], t [s]
    Times are those of j^2, so that the start, where q varies as the root of time, is resolved to second order.
    """

    def march(steps: int) -> float:
        t = end_s * (np.arange(steps + 1) / steps) ** 2
        # The integral of S from 0, on a fine grid: flux is linear within a step, which S' weighs by parts.
        grid = end_s * (np.arange(40 * 40 + 1) / 1600.0) ** 4
        values = np.concatenate(([0.0], step_response(grid[1:])))
        S = CubicSpline(grid**0.5, values)
        integral = CubicSpline(grid**0.5, 2.0 * values * grid**0.5).antiderivative()
        T, q = np.full(steps + 1, start_K), np.zeros(steps + 1)
        q[0] = flux(start_K, 0.0)
        for n in range(1, steps + 1):
            lag = np.sqrt(np.maximum(t[n] - t[: n + 1], 0.0))
            # Step j: flux q_(j-1) + (q_j - q_(j-1)) (s - t_(j-1)) / d gives q_(j-1) S(t_n - t_(j-1)) - q_j S(t_n - t_j)
            # plus the slope times the integral of S between.
            held, area = S(lag), integral(lag)
            slope = (area[:-1] - area[1:]) / np.diff(t[: n + 1])
            weight = np.zeros(n + 1)
            weight[:-1] += held[:-1] - slope
            weight[1:] += slope - held[1:]
            known = start_K + float(weight[:-1] @ q[:n])
            T[n] = T[n - 1]
            for _ in range(50):
                d = 1e-4
                f = known + weight[n] * flux(T[n], t[n]) - T[n]
                change = f / (weight[n] * (flux(T[n] + d, t[n]) - flux(T[n], t[n])) / d - 1.0)
                T[n] -= change
                if abs(change) < 1e-9:
                    break
            q[n] = flux(T[n], t[n])
        return float(T[-1])

    coarse, fine = march(steps // 2), march(steps)
    return fine + (fine - coarse) / 3.0
