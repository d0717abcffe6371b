"""The system of ode.py in CasADi, symbolically, for CVODES; an optional dependency."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from benchmarks.ode import FloatArray, Kinked, System
from sim_heating.thermal.faces import SIGMA

casadi: Any
try:
    import casadi
except ImportError:
    casadi = None

MOST_STEPS = 10_000_000


def _property(ca: Any, T: Any, p: Kinked, fractions: list[Any]) -> tuple[Any, Any]:
    """Property and its integral from 0 K; fractions are those of the way from each pressure column to the next."""

    def at_pressure(columns: FloatArray) -> Any:
        value = columns[0]
        for j, f in enumerate(fractions if len(columns) > 1 else []):
            value = value + f * (columns[j + 1] - columns[j])
        return value

    first = at_pressure(p.value)
    value, integral = first, first * T
    for j, kink in enumerate(p.kink_K):
        above, bend = ca.fmax(0.0, T - kink), at_pressure(p.bend[:, j])
        value, integral = value + bend * above, integral + 0.5 * bend * above * above
    return value, integral


def _heating_rate(ca: Any, s: System, mixing: float) -> Any:
    """Function (T, film, recovery, pressure) -> dT/dt."""
    n = s.nodes
    T, film, recovery, pressure = ca.SX.sym("T", n), ca.SX.sym("film"), ca.SX.sym("H_r"), ca.SX.sym("p")
    x = ca.log10(ca.fmax(pressure, 1e-30))
    fractions = [ca.fmin(1.0, ca.fmax(0.0, (x - a) / (b - a))) for a, b in zip(s.log10_p, s.log10_p[1:], strict=False)]
    net, diagonal, upper, lower = [0.0] * n, [0.0] * n, [0.0] * n, [0.0] * n
    emissivity, _ = _property(ca, T[0], s.emissivity, [])
    net[0] = film * (recovery - s.cp_wall * T[0]) - emissivity * SIGMA * T[0] ** 4
    for i in range(n - 1):
        m = s.material[i]
        c_a, c_b = (_property(ca, T[i + k], s.heat_capacity[m], [])[0] for k in (0, 1))
        theta_a, theta_b = (_property(ca, T[i + k], s.conductivity[m], fractions)[1] for k in (0, 1))
        q = s.g[i] * (theta_a - theta_b)
        net[i], net[i + 1] = net[i] - q, net[i + 1] + q
        diagonal[i] += (1.0 - mixing) * s.half[i] * c_a
        diagonal[i + 1] += (1.0 - mixing) * s.half[i] * c_b
        upper[i], lower[i + 1] = mixing * s.half[i] * c_b, mixing * s.half[i] * c_a
    for i in range(1, n if mixing else 0):
        w = lower[i] / diagonal[i - 1]
        diagonal[i], net[i] = diagonal[i] - w * upper[i - 1], net[i] - w * net[i - 1]
    out = [net[n - 1] / diagonal[n - 1]]
    for i in range(n - 2, -1, -1):
        out.insert(0, (net[i] - upper[i] * out[0]) / diagonal[i] if mixing else net[i] / diagonal[i])
    return ca.Function("rate", [T, film, recovery, pressure], [ca.vertcat(*out)])


def solver(s: System, mixing: float, outputs_s: FloatArray) -> Callable[[float], FloatArray]:
    """A function of the relative tolerance that gives (output, node) temperatures; time is a state."""
    ca = casadi
    rate = _heating_rate(ca, s, mixing)
    table = np.array([s.film, s.recovery, s.pressure]).ravel(order="F").tolist()
    entry = ca.interpolant("entry", "linear", [s.time_s.tolist()], table, {"lookup_mode": ["exact"]})
    x = ca.MX.sym("x", s.nodes + 1)
    now = entry(x[-1])
    ode = ca.vertcat(rate(x[:-1], now[0], now[1], now[2]), 1.0)
    start = np.append(s.start_K, 0.0)
    made: dict[float, Any] = {}

    def solve(tolerance: float) -> FloatArray:
        if tolerance not in made:
            options = {"reltol": tolerance, "abstol": tolerance, "max_num_steps": MOST_STEPS}
            made[tolerance] = ca.integrator("entry", "cvodes", {"x": x, "ode": ode}, 0.0, outputs_s.tolist(), options)
        return np.array(made[tolerance](x0=start)["xf"])[:-1].T

    return solve
