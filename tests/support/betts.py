"""Betts' entry problem: the Shuttle's maximum cross-range, free or with the heating of its wing leading edge bounded.

Source: Betts, "Practical Methods for Optimal Control and Estimation Using Nonlinear Programming", 2nd ed., SIAM 2010,
section 6.1, whose units are ft, slug, Btu; his formulas and numbers are the problem. Bank from -89 to 1 deg, as in its
published repetitions.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from sim_heating.planning.optimal import dynamics as od
from sim_heating.planning.optimal.collocation import (
    Motion,
    OptimalControlProblem,
    Transcription,
    UpperBounds,
    ca,
    refined_mesh,
    require_casadi,
    straight_guess,
)

FT_M = 0.3048
MASS_SLUG = 203000.0 / 32.174
AREA_FT2 = 2690.0
PLANET = od.Planet(20902900.0 * FT_M, 1.4076539e16 * FT_M**3)
MESH_TOLERANCE = 1e-6
"""Error of every interval of the last mesh."""
FIRST_INTERVALS = 30
BEND = np.array([0.05, 0.3])
HEATING_LIMIT = 70.0
"""Heating of the wing leading edge [Btu/(ft2 s)]."""
PUBLISHED = {"free": (34.1412, 2008.59), "limited": (30.6255, 2198.67)}
"""Betts' final latitude [deg] and time [s], as also quoted by the Dymos documentation's tests."""


def density_slug_ft3(altitude_ft: Any) -> Any:
    """Density [slug/ft3]: rho = 0.002378 exp(-h / 23800), h in ft."""
    return 0.002378 * ca.exp(-altitude_ft / 23800.0)


def lift_drag(alpha_deg: Any) -> tuple[Any, Any]:
    """CL and CD over the angle of attack."""
    return -0.20704 + 0.029244 * alpha_deg, 0.07854 - 0.0061592 * alpha_deg + 0.000621408 * alpha_deg**2


def heating_Btu_ft2_s(rho_slug_ft3: Any, speed_ft_s: Any, alpha_deg: Any) -> Any:
    """Heating of the wing leading edge [Btu/(ft2 s)]: q_r(rho, V) q_a(alpha)."""
    by_alpha = 1.0672181 - 0.019213774 * alpha_deg + 2.1286289e-4 * alpha_deg**2 - 1.0117249e-6 * alpha_deg**3
    return 17700.0 * ca.sqrt(rho_slug_ft3) * (1e-4 * speed_ft_s) ** 3.07 * by_alpha


def betts_problem() -> OptimalControlProblem:
    """Betts' problem; its path is the heating over HEATING_LIMIT."""
    require_casadi()
    x, u = ca.SX.sym("x", od.STATES), ca.SX.sym("u", 2)
    speed, rho = x[od.SPEED] / FT_M, density_slug_ft3(x[od.ALTITUDE] / FT_M)
    force = 0.5 * rho * speed**2 * AREA_FT2 / MASS_SLUG * FT_M
    CL, CD = lift_drag(u[od.ALPHA])
    rates = od.motion_rates(x, force * CL, force * CD, u[od.BANK], PLANET)
    start = np.array([260e3 * FT_M, 0.0, 0.0, 25600.0 * FT_M, np.radians(-1.0), np.radians(90.0)])
    heating = heating_Btu_ft2_s(rho, speed, u[od.ALPHA]) / HEATING_LIMIT
    return OptimalControlProblem(
        model=ca.Function("model", [x, u], [ca.vertcat(*rates), heating]),
        goal=od.cross_range_function(start, 1.0),
        scale=od.SCALE, control_scale=od.CONTROL_SCALE, lower=od.LOWEST, upper=od.HIGHEST,
        control_lower=np.array([-90.0, -89.0]), control_upper=np.array([90.0, 1.0]),
        start=start,
        end={od.ALTITUDE: 80e3 * FT_M, od.SPEED: 2500.0 * FT_M, od.GAMMA: np.radians(-5.0)},
        duration_s=(1000.0, 4000.0),
    )  # fmt: skip


def betts_guess(problem: OptimalControlProblem) -> Motion:
    """Straight lines from the start to the end state, 17.4 deg, bank from -75 deg to 0."""
    end = np.array([80e3 * FT_M, np.radians(75.0), np.radians(25.0), 2500.0 * FT_M, np.radians(-5.0), np.radians(10.0)])
    return straight_guess(problem, end, np.array([[17.4, 17.4], [-75.0, 0.0]]), 2000.0)


def betts_bounds(limited: bool) -> UpperBounds:
    """Heating up to its limit, or free."""
    return UpperBounds(path=(1.0 if limited else np.inf,))


def solve_betts(case: str) -> list[Motion]:
    """Betts' problem, "free" or "limited", on one mesh after another until every interval's error is small."""
    problem = betts_problem()
    mesh, motions = np.linspace(0.0, 1.0, FIRST_INTERVALS + 1), [betts_guess(problem)]
    while len(motions) == 1 or np.max(motions[-1].errors) > MESH_TOLERANCE:
        motions.append(Transcription(problem, mesh).solve(motions[-1], betts_bounds(case == "limited")))
        mesh = refined_mesh(motions[-1], MESH_TOLERANCE, BEND)
    return motions[1:]
