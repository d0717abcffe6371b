"""A study made ready: its problem for the optimiser, and the march that judges what the optimiser found."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from statistics import NormalDist

import numpy as np

from sim_heating.conditions import Conditions
from sim_heating.planning import optimal_dynamics as od
from sim_heating.planning import optimal_tables as tables
from sim_heating.planning.optimal_collocation import (
    FloatArray,
    Motion,
    Problem,
    ca,
    require_casadi,
    straight_guess,
)
from sim_heating.planning.optimal_spec import LimitedPoint, OptimalStudy
from sim_heating.planning.soak import COLD_K, soaked
from sim_heating.point_model import PointModel
from sim_heating.points import conditions_at_point, point_of_vehicle
from sim_heating.temperatures import PointHistory, march_points, outside_table
from sim_heating.trajectory.trimmed_aero import ELEVON_HIGH, ELEVON_LOW

SAMPLE_S = 1.0
LOAD_SCALE = 1e6
"""Typical integral of T_e over time [K s]."""


@dataclass(frozen=True)
class Peak:
    """Marched peak temperatures of a point [K] beside its limits; `bondline_limit_K` None where there is no limit."""

    point: str
    surface_K: float
    surface_limit_K: float
    bondline_K: float
    bondline_limit_K: float | None

    def margins(self) -> list[float]:
        """What is left to each limit [K]."""
        bondline = [] if self.bondline_limit_K is None else [self.bondline_limit_K - self.bondline_K]
        return [self.surface_limit_K - self.surface_K, *bondline]


class Search:
    """A study with its splines, ready to be optimised and marched."""

    def __init__(self, study: OptimalStudy) -> None:
        require_casadi()
        self.study = study
        self.aero = tables.aerodynamics(study)
        self.loaded = [i for i, p in enumerate(study.points) if p.bondline_K is not None]
        self.z = _quantile(study)
        self.models = [_shifted(study, p, self.z) for p in study.points]
        self.nominal = [_shifted(study, p, 0.0) for p in study.points]
        limited = any(np.isfinite(p.surface_K) for p in study.points)
        self.wall = tables.wall_temperatures(study, self.aero, self.models) if limited else None
        self.problem = self._problem()

    def _problem(self) -> Problem:
        file, points = self.study.declared, len(self.loaded)
        x, u = ca.MX.sym("x", od.STATES + points), ca.MX.sym("u", 2)
        air = tables.air()
        h, V, alpha = x[od.ALTITUDE], x[od.SPEED], u[od.ALPHA]
        coefficients = tables.lift_drag(self.study, self.aero)(ca.vertcat(V / air.sound(h), alpha))
        force = 0.5 * ca.exp(air.ln_density(h)) * V**2 * self.aero.area_m2 / self.aero.mass_kg
        wall = ca.MX(0, 1) if self.wall is None else self.wall(ca.vertcat(h, V, alpha))
        rates = od.motion_rates(x, force * coefficients[0], force * coefficients[1], u[od.BANK], tables.PLANET)
        load_rates = [1e3 * wall[i] - COLD_K for i in self.loaded]
        start = np.concatenate((_start(self.study), np.zeros(points)))
        loads = np.full(points, LOAD_SCALE)
        return Problem(
            model=ca.Function("model", [x, u], [ca.vertcat(*rates, *load_rates), wall]),
            goal=od.cross_range_function(start, self.side),
            scale=np.concatenate((od.SCALE, loads)), control_scale=od.CONTROL_SCALE,
            lower=np.concatenate((self._lowest(), -10.0 * loads)),
            upper=np.concatenate((self._highest(), 10.0 * loads)),
            control_lower=np.array([file.alpha_limits_deg[0], file.bank_limits_deg[0]]),
            control_upper=np.array([file.alpha_limits_deg[1], file.bank_limits_deg[1]]),
            start=start,
            end={
                od.ALTITUDE: file.end.altitude_m, od.SPEED: file.end.velocity_m_s,
                od.GAMMA: np.radians(file.end.gamma_deg),
            },
            duration_s=(file.duration_s[0], file.duration_s[1]),
        )  # fmt: skip

    @property
    def side(self) -> float:
        """1 where bank leans to the left, -1 to the right."""
        return 1.0 if sum(self.study.declared.bank_limits_deg) <= 0.0 else -1.0

    def _lowest(self) -> FloatArray:
        low, end = od.LOWEST.copy(), self.study.declared.end
        low[od.ALTITUDE], low[od.SPEED] = 0.7 * end.altitude_m, 0.6 * end.velocity_m_s
        return low

    def _highest(self) -> FloatArray:
        high, start = od.HIGHEST.copy(), self.study.declared.initial
        high[od.ALTITUDE], high[od.SPEED] = 1.05 * start.altitude_m, 1.08 * start.velocity_m_s
        return high

    def guess(self) -> Motion:
        """Straight lines to an end some 20 deg aside."""
        file = self.study.declared
        end = self.problem.start.copy()
        for i, value in self.problem.end.items():
            end[i] = value
        turn = -self.side * np.radians(70.0)
        end[od.HEADING] += turn
        end[od.LONGITUDE] += np.radians(60.0) * np.sin(self.problem.start[od.HEADING])
        end[od.LATITUDE] += np.radians(20.0) * np.cos(self.problem.start[od.HEADING] + turn)
        low, high = file.alpha_limits_deg
        alpha = min(max(18.0, low), high)
        bank = np.clip(np.array([-70.0 * self.side, 0.0]), file.bank_limits_deg[0], file.bank_limits_deg[1])
        duration = min(max(2000.0, file.duration_s[0]), file.duration_s[1])
        return straight_guess(self.problem, end, np.array([[alpha, alpha], bank]), duration)

    def conditions(self, motion: Motion) -> Conditions:
        """The flight every second, its end included."""
        time = np.unique(np.append(np.arange(0.0, motion.duration_s, SAMPLE_S), motion.duration_s))
        return tables.conditions_along(
            self.study, self.aero, time, motion.states_at(time)[: od.STATES], motion.controls_at(time)
        )

    def march(self, flown: Conditions, models: Sequence[PointModel]) -> list[PointHistory]:
        """Temperatures along the flight and the soak after it."""
        if not models:
            return []
        vehicle, soak_s = self.study.vehicle, self.study.declared.soak_s
        points = [p.point for p in self.study.points]
        flights = [soaked(conditions_at_point(vehicle, p, flown), p, soak_s) for p in points]
        return march_points(models, flights)

    def peaks(self, histories: Sequence[PointHistory]) -> tuple[Peak, ...]:
        """Peaks beside the limits."""
        return tuple(
            Peak(p.point.name, float(np.max(h.surface_K)), p.surface_K, float(np.max(h.bondline_K)), p.bondline_K)
            for p, h in zip(self.study.points, histories, strict=True)
        )

    def notes(self, flown: Conditions) -> list[str]:
        """Where the flight leaves the ratio tables, and how long the elevon is at the end of its travel."""
        found = [
            f"{m.name}: {o.variable} up to {o.farthest:.3g} outside the ratio table, {o.duration_s:.0f} s in all, "
            f"first at {o.first_s:.0f} s"
            for m in self.models
            for o in outside_table(m, flown)
        ]
        low, high = self.aero.entry.flight[[ELEVON_LOW, ELEVON_HIGH]]
        ended = (flown["elevon_deg"] <= low) | (flown["elevon_deg"] >= high)
        if np.any(ended):
            lasts = float(np.sum(np.gradient(flown.time_s)[ended]))
            found.append(
                f"elevon at the end of its travel for {lasts:.0f} s from {flown.time_s[ended][0]:.0f} s: not in trim"
            )
        return found

    def hottest(self, motion: Motion) -> FloatArray:
        """Highest T_e of each point along a motion [K]."""
        if self.wall is None:
            return np.zeros(len(self.study.points))
        _, walls = self.problem.model.map(motion.states.shape[1])(motion.states, motion.controls_at(motion.time_s))
        return np.asarray(np.max(1e3 * np.array(walls), axis=1), dtype=float)

    def loads(self, motion: Motion) -> FloatArray:
        """Integral of T_e of each point at the end [K s]; 0 where its bondline has no limit."""
        loads = np.zeros(len(self.study.points))
        loads[self.loaded] = motion.states[od.STATES :, -1]
        return loads


def _start(study: OptimalStudy) -> FloatArray:
    first = study.declared.initial
    angles = np.radians([first.longitude_deg, first.latitude_deg, first.gamma_deg, first.heading_deg])
    return np.array([first.altitude_m, angles[0], angles[1], first.velocity_m_s, angles[2], angles[3]])


def _quantile(study: OptimalStudy) -> float:
    """Sigmas above the tables that the limits are kept with; 0 where no probability is asked for."""
    P = study.declared.probability
    return 0.0 if P is None or not study.points else NormalDist().inv_cdf(1.0 - (1.0 - P) / len(study.points))


def _shifted(study: OptimalStudy, limited: LimitedPoint, z: float) -> PointModel:
    """The model of a point with its table z sigma higher."""
    model = point_of_vehicle(study.vehicle, limited.point)
    table = limited.point.ratio
    if z == 0.0 or table.sigma is None:
        return model
    return replace(model, ratio=replace(table, ratio=table.ratio + z * table.sigma))
