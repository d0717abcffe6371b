"""What single parts of the physics of the gas change in temperatures: flights marched with one of them switched off.

The demo entry, STS-96 and the capsule are flown once each. Their control points are marched as the program has them,
and with the reference heating or the surface pressure of before: stagnation heating not bridged to free-molecular flow;
Fay-Riddell with the Newtonian velocity gradient at subsonic speed as well, and Sutton-Graves at all speeds; surface
pressure with the stagnation pressure of gamma 1.4. Differences are those of the part less those without it. The kelvins
of the changelog.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.measure import Figure, save
from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import Conditions
from sim_heating.heating.reference.stagnation import (
    COLD_WALL_K,
    NO_LEWIS,
    SLOWEST_M_S,
    fay_riddell_film,
    fay_riddell_of_state,
    stagnation_kernel,
    sutton_graves_kernel,
)
from sim_heating.heating.surface_pressure import pressure_below_rise
from sim_heating.inputs.scenario import Scenario, load_scenario
from sim_heating.inputs.vehicle import ControlPoint
from sim_heating.march.history import PointHistory, march_points
from sim_heating.simulation.run import fly_scenario, models_of

SCENARIOS = Path(__file__).resolve().parent.parent / "scenarios"
FLIGHTS = {"demo": "popu_mach20", "STS-96": "sts96", "capsule": "capsule"}
GAMMA = 1.4
Changed = Callable[[Scenario, ControlPoint, Conditions], dict[str, FloatArray]]


def _film(scenario: Scenario, flown: Conditions, kernel: Callable[..., float]) -> FloatArray:
    """(time,) film coefficient [kg/(m2 s)] of kernel(state, rho, V, T_inf, nose radius) along a flight."""
    radius = scenario.vehicle.heating.nose_radius_m or 1.0
    rows = zip(flown["rho_kg_m3"], np.maximum(flown["velocity_m_s"], SLOWEST_M_S), flown["T_inf_K"], strict=True)
    return np.array([kernel(stagnation_kernel(rho, V, T), rho, V, T, radius) for rho, V, T in rows])


def not_bridged(scenario: Scenario, point: ControlPoint, flown: Conditions) -> dict[str, FloatArray]:
    """Fay-Riddell of continuum flow at all densities."""

    def film(state: tuple[float, float, float, float], rho: float, V: float, T: float, radius: float) -> float:
        return fay_riddell_of_state(state, V, T, radius, COLD_WALL_K, NO_LEWIS)

    return {"h_ref_kg_m2_s": _film(scenario, flown, film)}


def newtonian_gradient(scenario: Scenario, point: ControlPoint, flown: Conditions) -> dict[str, FloatArray]:
    """Fay-Riddell with du_e/dx = sqrt(2 (p_0 - p_inf) / rho_0) / R at all speeds."""

    def film(state: tuple[float, float, float, float], rho: float, V: float, T: float, radius: float) -> float:
        p_0, h_0, rho_0, p = state
        gradient = math.sqrt(2.0 * max(p_0 - p, 0.0) / rho_0) / radius
        return fay_riddell_film(p_0, h_0, rho_0, gradient, COLD_WALL_K, NO_LEWIS)

    return {"h_ref_kg_m2_s": _film(scenario, flown, film)}


def sutton_graves_alone(scenario: Scenario, point: ControlPoint, flown: Conditions) -> dict[str, FloatArray]:
    """Sutton-Graves at all speeds."""

    def film(state: tuple[float, float, float, float], rho: float, V: float, T: float, radius: float) -> float:
        return sutton_graves_kernel(rho, V, T, radius)

    return {"h_ref_kg_m2_s": _film(scenario, flown, film)}


def pressure_of_perfect_gas(scenario: Scenario, point: ControlPoint, flown: Conditions) -> dict[str, FloatArray]:
    """Surface pressure with the stagnation pressure of gamma 1.4: Rayleigh's pitot formula, isentropic below Mach 1."""
    m2 = np.maximum(flown["mach"], 1e-6) ** 2
    isentropic = (1.0 + 0.5 * (GAMMA - 1.0) * m2) ** (GAMMA / (GAMMA - 1.0))
    fast = np.maximum(m2, 1.0)
    pitot = ((GAMMA + 1.0) ** 2 * fast / (4.0 * GAMMA * fast - 2.0 * (GAMMA - 1.0))) ** (GAMMA / (GAMMA - 1.0))
    pitot *= (1.0 - GAMMA + 2.0 * GAMMA * fast) / (GAMMA + 1.0)
    rise = flown["p_inf_Pa"] * (np.where(m2 > 1.0, pitot, isentropic) - 1.0)
    columns = (flown[name] for name in ("alpha_deg", "beta_deg", "elevon_deg", "bodyflap_deg"))
    rows = zip(flown["p_inf_Pa"], rise, *columns, strict=True)
    model = point.pressure.parameters()
    return {"p_surface_Pa": np.array([
        pressure_below_rise(p, r, alpha, math.cos(math.radians(beta)), elevon, flap, model)
        for p, r, alpha, beta, elevon, flap in rows
    ])}  # fmt: skip


PARTS: Mapping[str, tuple[Changed, tuple[str, ...]]] = {
    "bridging to free-molecular flow": (not_bridged, ("demo", "STS-96")),
    "subsonic velocity gradient": (newtonian_gradient, ("STS-96",)),
    "Fay-Riddell below 2 km/s": (sutton_graves_alone, ("capsule",)),
    "stagnation pressure of equilibrium air": (pressure_of_perfect_gas, ("demo", "STS-96")),
}
"""Part -> what was in its place, and the flights."""


def _largest(with_part: list[PointHistory], without: list[PointHistory], name: str) -> tuple[float, str]:
    """Difference of largest size [K] over all points and times, and where it is."""
    found = []
    for a, b in zip(with_part, without, strict=True):
        change = getattr(a, name) - getattr(b, name)
        i = int(np.argmax(np.abs(change)))
        found.append((float(change[i]), f"{a.name} at {a.time_s[i]:.0f} s"))
    return max(found, key=lambda f: abs(f[0]))


def _peak_K(name: str, history: PointHistory) -> float:
    return float(np.max(getattr(history, name)))


def _last_K(name: str, history: PointHistory) -> float:
    return float(getattr(history, name)[-1])


def _surface_K(time_s: float, history: PointHistory) -> float:
    return float(np.interp(time_s, history.time_s, history.surface_K))


def _greatest(
    with_part: list[PointHistory], without: list[PointHistory], value: Callable[[PointHistory], float]
) -> tuple[float, str]:
    """Difference of largest size of a value of a history [K] over all points, and the point."""
    changes = [(value(a) - value(b), a.name) for a, b in zip(with_part, without, strict=True)]
    return max(changes, key=lambda c: abs(c[0]))


def _figures(part: str, flight: str, with_part: list[PointHistory], without: list[PointHistory]) -> list[Figure]:
    """Largest differences, at any time, at peaks, and at the end of the flight."""
    figures = []
    for name, what in (("surface_K", "surface"), ("bondline_K", "bondline")):
        largest, where = _largest(with_part, without, name)
        figures.append(Figure(f"{flight}, {part}: largest change of a {what}", largest, "K", note=where))
        value, point = _greatest(with_part, without, partial(_peak_K, name))
        figures.append(Figure(f"{flight}, {part}: change of the peak of a {what}", value, "K", note=point))
        value, point = _greatest(with_part, without, partial(_last_K, name))
        figures.append(Figure(f"{flight}, {part}: change of a {what} at the end", value, "K", note=point))
    at_s = [t for t in (200.0, 351.0, 1800.0) if t < with_part[0].time_s[-1]]
    for t in at_s if flight == "STS-96" else ():
        value, point = _greatest(with_part, without, partial(_surface_K, t))
        figures.append(Figure(f"{flight}, {part}: change of a surface at {t:.0f} s", value, "K", note=point))
    return figures


def run() -> list[Figure]:
    """Changes of surface and bondline temperatures by each part, on each flight."""
    figures = []
    for flight, file in FLIGHTS.items():
        scenario = load_scenario(SCENARIOS / f"{file}.toml")
        models, flights = models_of(scenario, fly_scenario(scenario).conditions)
        points = [scenario.vehicle.control_point(name) for name in scenario.names]
        step_s = scenario.declared.heating.longest_step_s
        with_part = march_points(models, flights, longest_step_s=step_s)
        for part, (changed, where) in PARTS.items():
            if flight not in where:
                continue
            without = [c.with_columns(**changed(scenario, p, c)) for p, c in zip(points, flights, strict=True)]
            figures += _figures(part, flight, with_part, march_points(models, without, longest_step_s=step_s))
    save("switched_off", figures)
    return figures
