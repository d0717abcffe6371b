"""Search for the entry of largest cross-range whose control points stay below their temperature limits.

The optimiser bounds, at each point, the temperature of a wall that stores no heat (T_e) along the flight, and its
integral over time. The thermal model itself is then marched along the flight found, soak after the end included, and
each bound is changed by the distance of the marched peak from its limit (for the bondline, along the secant), until
every active limit is met. The mesh is refined on the way, until its error is small enough or, where a control jumps,
no interval can be halved any more.

With a probability P, tables are ratio + z sigma, z the normal quantile of 1 - (1 - P)/n for n limited points. The error
of a table is assumed to be the same number of sigma everywhere in it, while errors of several points may be correlated
in any way (Bonferroni): all points stay below their limits with a probability of P or more.

First the problem of a study (`EntrySearch`), then the search (`fly_optimal`) and its result.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from statistics import NormalDist

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import Conditions
from sim_heating.base.errors import RunError
from sim_heating.heating.atmosphere import G0_M_S2
from sim_heating.inputs.points import conditions_behind_walls, point_of_vehicle
from sim_heating.march.history import PointHistory, march_points, table_excursions
from sim_heating.march.point import PointModel
from sim_heating.planning.limited_point import LimitedPoint
from sim_heating.planning.optimal import collocation, tables
from sim_heating.planning.optimal import dynamics as od
from sim_heating.planning.optimal.spec import OptimalStudy
from sim_heating.planning.soak import SURROUNDINGS_K, with_soak
from sim_heating.trajectory.trimmed_aero import ELEVON_HIGH, ELEVON_LOW

SAMPLE_S = 1.0
"""Interval of the conditions along the flight [s]."""
OVERSHOOT = 0.01
"""Largest part of a limit of the flight that is exceeded between the collocation points [-]."""
LOAD_SCALE = 1e6
"""Typical integral of T_e over time [K s]."""


@dataclass(frozen=True)
class PeakTemperatures:
    """Marched peak temperatures of a point and its limits [K].

    surface_limit_K  : infinite where there is no limit;  bondline_limit_K : None where there is no limit
    """

    point: str
    surface_K: float
    surface_limit_K: float
    bondline_K: float
    bondline_limit_K: float | None

    def margins(self) -> list[float]:
        """Distance to each limit [K], negative where it is violated."""
        bondline = [] if self.bondline_limit_K is None else [self.bondline_limit_K - self.bondline_K]
        return [self.surface_limit_K - self.surface_K, *bondline]


@dataclass(frozen=True)
class FlightPeak:
    """Highest value along a flight of a quantity that is limited, with its unit."""

    name: str
    unit: str
    value: float
    limit: float

    @property
    def kept(self) -> bool:
        """Whether the limit is kept, but for what a polynomial exceeds it between the points where it is bounded."""
        return self.value <= self.limit * (1.0 + OVERSHOOT)

    def __str__(self) -> str:
        return f"{self.name} {self.value:.4g} of {self.limit:.4g} {self.unit}"


class EntrySearch:
    """A study with its splines, as an optimal control problem and as the march that checks its solution.

    raises : InputError where CasADi is not installed
    """

    def __init__(self, study: OptimalStudy) -> None:
        collocation.require_casadi()
        self.study = study
        self.aero = tables.aerodynamics(study)
        self.with_bondline_limit = [i for i, p in enumerate(study.points) if p.bondline_K is not None]
        self.z = _table_sigmas(study)
        self.models = [_model_with_table(study, p, self.z) for p in study.points]
        self.nominal_models = [_model_with_table(study, p, 0.0) for p in study.points]
        # Stacks have tens of nodes and a memory, so that the thermal model is not part of the program: smooth
        # substitutes are bounded in it, and corrected by marches.
        limited = any(np.isfinite(p.surface_K) for p in study.points)
        self.wall = tables.wall_temperatures(study, self.aero, self.models) if limited else None
        self.problem = self._problem()

    def _problem(self) -> collocation.OptimalControlProblem:
        file, points = self.study.declared, len(self.with_bondline_limit)
        x, u = collocation.ca.MX.sym("x", od.STATES + points), collocation.ca.MX.sym("u", 2)
        air = tables.atmosphere_splines()
        h, V, alpha = x[od.ALTITUDE], x[od.SPEED], u[od.ALPHA]
        coefficients = tables.lift_drag(self.study, self.aero)(collocation.ca.vertcat(V / air.sound(h), alpha))
        force = 0.5 * collocation.ca.exp(air.ln_density(h)) * V**2 * self.aero.area_m2 / self.aero.mass_kg
        wall = collocation.ca.MX(0, 1) if self.wall is None else self.wall(collocation.ca.vertcat(h, V, alpha))
        limits = self.study.flight_limits
        pressure = 0.5 * collocation.ca.exp(air.ln_density(h)) * V**2
        radians = alpha * np.pi / 180.0
        normal = (
            force
            * (coefficients[0] * collocation.ca.cos(radians) + coefficients[1] * collocation.ca.sin(radians))
            / G0_M_S2
        )
        paths = [wall]
        for value, limit in ((pressure, limits.dynamic_pressure_Pa), (normal, limits.normal_load_g)):
            paths += [] if limit is None else [value / limit]
        rates = od.motion_rates(x, force * coefficients[0], force * coefficients[1], u[od.BANK], tables.PLANET)
        load_rates = [1e3 * wall[i] - SURROUNDINGS_K for i in self.with_bondline_limit]
        start = np.concatenate((_initial_state(self.study), np.zeros(points)))
        loads = np.full(points, LOAD_SCALE)
        return collocation.OptimalControlProblem(
            model=collocation.ca.Function(
                "model", [x, u], [collocation.ca.vertcat(*rates, *load_rates), collocation.ca.vertcat(*paths)]
            ),
            goal=od.cross_range_function(start, self.side),
            scale=np.concatenate((od.SCALE, loads)),
            control_scale=od.CONTROL_SCALE,
            lower=np.concatenate((self._lowest(), -10.0 * loads)),
            upper=np.concatenate((self._highest(), 10.0 * loads)),
            control_lower=np.array([file.alpha_limits_deg[0], file.bank_limits_deg[0]]),
            control_upper=np.array([file.alpha_limits_deg[1], file.bank_limits_deg[1]]),
            start=start,
            end={
                od.ALTITUDE: file.end.altitude_m,
                od.SPEED: file.end.velocity_m_s,
                od.GAMMA: np.radians(file.end.gamma_deg),
            },
            duration_s=(file.duration_s[0], file.duration_s[1]),
            control_rates=np.array([limits.alpha_rate_deg_s or np.inf, limits.bank_rate_deg_s or np.inf]),
        )

    @property
    def side(self) -> float:
        """1 where more bank is allowed to the left, -1 to the right."""
        return 1.0 if sum(self.study.declared.bank_limits_deg) <= 0.0 else -1.0

    def _lowest(self) -> FloatArray:
        low, end = od.LOWEST + self._turned(), self.study.declared.end
        low[od.ALTITUDE], low[od.SPEED] = 0.7 * end.altitude_m, 0.6 * end.velocity_m_s
        return low

    def _highest(self) -> FloatArray:
        high, start = od.HIGHEST + self._turned(), self.study.declared.initial
        high[od.ALTITUDE], high[od.SPEED] = 1.05 * start.altitude_m, 1.08 * start.velocity_m_s
        return high

    def _turned(self) -> FloatArray:
        """Initial longitude and heading, from which their bounds count: an entry may cross 180 deg."""
        angles = np.array([od.LONGITUDE, od.HEADING])
        turned = np.zeros(od.STATES)
        turned[angles] = _initial_state(self.study)[angles]
        return turned

    def guess(self) -> collocation.Motion:
        """First guess: straight lines to a final state with some 20 deg of cross-range."""
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
        return collocation.straight_guess(self.problem, end, np.array([[alpha, alpha], bank]), duration)

    def conditions(self, motion: collocation.Motion) -> Conditions:
        """Flight conditions of a motion every SAMPLE_S, its end included."""
        time = np.unique(np.append(np.arange(0.0, motion.duration_s, SAMPLE_S), motion.duration_s))
        return tables.conditions_along(
            self.study, self.aero, time, motion.states_at(time)[: od.STATES], motion.controls_at(time)
        )

    def march(self, flown: Conditions, models: Sequence[PointModel]) -> list[PointHistory]:
        """March the points along the flight and the soak after it."""
        if not models:
            return []
        vehicle, soak_s = self.study.vehicle, self.study.declared.soak_s
        points = [p.point for p in self.study.points]
        at_points = conditions_behind_walls(vehicle, points, flown, {m.name: m for m in models})
        return march_points(models, [with_soak(c, soak_s) for c in at_points])

    def peaks(self, histories: Sequence[PointHistory]) -> tuple[PeakTemperatures, ...]:
        """Peaks of marched points with their limits."""
        return tuple(
            PeakTemperatures(
                p.point.name, float(np.max(h.surface_K)), p.surface_K, float(np.max(h.bondline_K)), p.bondline_K
            )
            for p, h in zip(self.study.points, histories, strict=True)
        )

    def flight_peaks(self, motion: collocation.Motion, flown: Conditions) -> tuple[FlightPeak, ...]:
        """Highest values of the limited quantities of a flight, from the tables themselves."""
        pressure = 0.5 * flown["rho_kg_m3"] * flown["velocity_m_s"] ** 2
        seen = zip(flown["mach"].tolist(), flown["alpha_deg"].tolist(), flown["velocity_m_s"].tolist(), strict=True)
        CL, CD = np.array([self.aero.at(*at)[:2] for at in seen]).T
        alpha = np.radians(flown["alpha_deg"])
        weight = self.aero.mass_kg * G0_M_S2
        normal = pressure * self.aero.area_m2 * (CL * np.cos(alpha) + CD * np.sin(alpha)) / weight
        turns = np.abs(np.diff(motion.controls, axis=1)) / (motion.duration_s * np.diff(motion.mesh))
        limits = self.study.flight_limits
        peaks = (
            ("dynamic pressure", "Pa", pressure, limits.dynamic_pressure_Pa),
            ("normal load", "g", normal, limits.normal_load_g),
            ("rate of alpha", "deg/s", turns[od.ALPHA], limits.alpha_rate_deg_s),
            ("rate of bank", "deg/s", turns[od.BANK], limits.bank_rate_deg_s),
        )
        return tuple(FlightPeak(n, u, float(np.max(x)), limit) for n, u, x, limit in peaks if limit is not None)

    def notes(self, flown: Conditions) -> list[str]:
        """Notes on a flight: where it leaves a ratio table, and the time with the elevon at an end of its travel."""
        lines = [
            f"{m.name}: {o.variable} up to {o.farthest:.3g} outside the ratio table, {o.duration_s:.0f} s in all, "
            f"first at {o.first_s:.0f} s"
            for m in self.models
            for o in table_excursions(m, flown)
        ]
        low, high = self.aero.entry.flight[[ELEVON_LOW, ELEVON_HIGH]]
        untrimmed = (flown["elevon_deg"] <= low) | (flown["elevon_deg"] >= high)
        if low < high and np.any(untrimmed):  # a vehicle without an elevon trims by its centre of gravity
            duration = float(np.sum(np.gradient(flown.time_s)[untrimmed]))
            first = flown.time_s[untrimmed][0]
            lines.append(f"elevon at an end of its travel for {duration:.0f} s from {first:.0f} s: not in trim")
        return lines

    def hottest(self, motion: collocation.Motion) -> FloatArray:
        """Highest T_e of each point along a motion [K]."""
        if self.wall is None:
            return np.zeros(len(self.study.points))
        _, paths = self.problem.model.map(motion.states.shape[1])(motion.states, motion.controls_at(motion.time_s))
        return np.asarray(np.max(1e3 * np.array(paths)[: len(self.study.points)], axis=1), dtype=float)

    def loads(self, motion: collocation.Motion) -> FloatArray:
        """Integral of T_e - SURROUNDINGS_K of each point at the end [K s]; 0 where its bondline has no limit."""
        loads = np.zeros(len(self.study.points))
        loads[self.with_bondline_limit] = motion.states[od.STATES :, -1]
        return loads


def _initial_state(study: OptimalStudy) -> FloatArray:
    first = study.declared.initial
    angles = np.radians([first.longitude_deg, first.latitude_deg, first.gamma_deg, first.heading_deg])
    return np.array([first.altitude_m, angles[0], angles[1], first.velocity_m_s, angles[2], angles[3]])


def _table_sigmas(study: OptimalStudy) -> float:
    """Number of sigma by which the tables are raised; 0 where no probability is asked for."""
    P = study.declared.probability
    # Bonferroni: the probability is divided among the points, whatever the correlation of their tables.
    return 0.0 if P is None or not study.points else NormalDist().inv_cdf(1.0 - (1.0 - P) / len(study.points))


def _model_with_table(study: OptimalStudy, limited: LimitedPoint, z: float) -> PointModel:
    """The model of a point with its ratio table raised by z sigma."""
    model = point_of_vehicle(study.vehicle, limited.point)
    table = limited.point.ratio
    if z == 0.0 or table.sigma is None:
        return model
    return replace(model, ratio=replace(table, ratio=table.ratio + z * table.sigma))


# The search ----------------------------------------------------------------------------------------------------------

ROUNDS = 25
"""Largest number of optimisations with their marches."""
BEND = np.array([0.1, 0.5])
"""Largest distance of alpha and bank from a straight line within an interval [deg]."""
COARSEST = 4e-3
"""Largest error of an interval, over the scale of the states, with which a mesh that cannot be refined further is
accepted: 80 m, 12 m/s, 0.01 deg of path angle. Where alpha jumps by tens of degrees, the path angle is off by this."""
Progress = Callable[[str], None]
"""Called with one line after each round."""


@dataclass(frozen=True)
class OptimisationRound:
    """One optimisation and the march along its solution: the flight found, its mesh, and the marched peaks."""

    cross_range_deg: float
    duration_s: float
    intervals: int
    mesh_error: float
    iterations: int
    peaks: tuple[PeakTemperatures, ...]


@dataclass(frozen=True)
class OptimalEntry:
    """An optimal entry.

    conditions : of the flight, every second, and at its end
    histories  : marched temperatures of the limited points, soak included, with the tables of `probability`
    peaks      : of these;  nominal : of the same flight with the tables as declared
    rounds     : of the search
    status     : one line: the limits that are active
    notes      : where the flight leaves a ratio table or is not trimmed, and where its mesh is coarser than asked
    flight_peaks : of the quantities of the flight that are limited
    """

    study: OptimalStudy
    motion: collocation.Motion
    conditions: Conditions
    cross_range_km: float
    histories: tuple[PointHistory, ...]
    peaks: tuple[PeakTemperatures, ...]
    nominal: tuple[PeakTemperatures, ...]
    rounds: tuple[OptimisationRound, ...]
    status: str
    notes: tuple[str, ...] = ()
    flight_peaks: tuple[FlightPeak, ...] = ()

    def __repr__(self) -> str:
        return f"<OptimalEntry `{self.study.title}`: cross-range {self.cross_range_deg:.3f} deg, {self.status}>"

    @property
    def cross_range_deg(self) -> float:
        """Angle from the initial great circle [deg]."""
        return float(np.degrees(self.motion.goal))

    @property
    def active_limits(self) -> list[str]:
        """Limits that bound the cross-range, as `NOSECAP surface`."""
        near = 2.0 * self.study.declared.tolerance_K
        limits = []
        for p in self.peaks:
            margins = zip(("surface", "bondline"), p.margins(), strict=False)
            limits += [f"{p.point} {where}" for where, margin in margins if margin < near]
        return limits + [p.name for p in self.flight_peaks if p.value > p.limit * (1.0 - OVERSHOOT)]

    @property
    def kept_limits(self) -> list[str]:
        """Limits that are kept, each with the value reached: temperatures, then those of the flight."""
        kept = []
        for p in self.peaks:
            for where, value, limit in (
                ("surface", p.surface_K, p.surface_limit_K),
                ("bondline", p.bondline_K, p.bondline_limit_K),
            ):
                if limit is not None and np.isfinite(limit) and value <= limit:
                    kept.append(f"{p.point} {where} {value:.0f} of {limit:.0f} K")
        return kept + [str(p) for p in self.flight_peaks if p.kept]


@dataclass
class _Steering:
    """Bounds given to the optimiser.

    wall_K   : (point,) of T_e [K];  load_K_s : (point,) of its integral [K s]; infinite where free
    loaded   : numbers of the points with a bondline limit;  limited : whether any point has a surface limit
    flight_limits : number of paths behind those of the walls, each bounded by 1
    rounds   : (point,) loads [K s] and bondline peaks [K] of each round so far
    """

    wall_K: FloatArray
    load_K_s: FloatArray
    loaded: list[int]
    limited: bool
    flight_limits: int
    rounds: list[tuple[FloatArray, FloatArray]]

    def bounds(self) -> collocation.UpperBounds:
        """The bounds in the units and order of the problem."""
        return collocation.UpperBounds(
            (tuple(self.wall_K / 1e3) if self.limited else ()) + (1.0,) * self.flight_limits,
            {od.STATES + k: self.load_K_s[i] for k, i in enumerate(self.loaded)},
        )


def fly_optimal(study: OptimalStudy, *, progress: Progress = lambda _: None) -> OptimalEntry:
    """Find the entry of largest cross-range within a study's limits.

    progress : called with one line after each round
    raises   : InputError where CasADi is not installed; RunError where no flight is found that keeps the limits
    """
    search = EntrySearch(study)
    points, has_wall = study.points, search.wall is not None
    steering = _Steering(
        np.full(len(points), np.inf),
        np.full(len(points), np.inf),
        search.with_bondline_limit,
        has_wall,
        search.problem.model.size1_out(1) - has_wall * len(points),
        [],
    )
    motion, rounds = search.guess(), list[OptimisationRound]()
    mesh = np.linspace(0.0, 1.0, study.declared.intervals + 1)
    transcription = collocation.Transcription(search.problem, mesh)
    for _ in range(ROUNDS):
        try:
            motion = transcription.solve(motion, steering.bounds())
        except RunError as error:
            raise RunError(_failure(study, rounds, str(error))) from None
        peaks = search.peaks(search.march(search.conditions(motion), search.models))
        worst = float(np.max(motion.errors))
        rounds.append(
            OptimisationRound(
                float(np.degrees(motion.goal)), motion.duration_s, len(motion.mesh) - 1, worst, motion.iterations, peaks
            )
        )
        progress(_round_line(rounds[-1]))
        changed = _steer(steering, search, motion, peaks, study.declared.tolerance_K)
        finer = collocation.refined_mesh(motion, study.declared.mesh_tolerance, BEND)
        fine = worst <= study.declared.mesh_tolerance
        finest = len(finer) == len(motion.mesh)
        if not changed and (fine or finest):
            if not fine and worst > COARSEST:
                raise RunError(_failure(study, rounds, f"{_mesh_note(study, motion)}; relax a limit"))
            return _entry(search, motion, rounds)
        # A new mesh makes a new program without a previous solution; while the mesh is fine enough, or as fine as it
        # can be, the old one starts warm.
        if not fine and not finest:
            transcription = collocation.Transcription(search.problem, finer)
    why = f"no convergence in {ROUNDS} rounds, mesh error {worst:.1e}; raise mesh_tolerance or tolerance_K"
    raise RunError(_failure(study, rounds, why))


def _steer(
    s: _Steering, search: EntrySearch, motion: collocation.Motion, peaks: Sequence[PeakTemperatures], tolerance_K: float
) -> bool:
    """Change the bounds by the distances of the marched peaks from their limits; False where no bound has to change.

    Active limits are met from below within the tolerance; the target is its middle.
    """
    # Aimed at the middle of the tolerance, below the limit: a peak that scatters a little still keeps it.
    half_tolerance = 0.5 * tolerance_K
    hottest, loads = search.hottest(motion), search.loads(motion)
    s.rounds.append((loads, np.array([p.bondline_K for p in peaks])))
    changed = False
    for i, peak in enumerate(peaks):
        distance = peak.surface_limit_K - half_tolerance - peak.surface_K
        active = hottest[i] > s.wall_K[i] - 1.0
        if distance < -half_tolerance or (active and distance > half_tolerance):
            s.wall_K[i] = min(s.wall_K[i], hottest[i]) + distance
            changed = True
        if peak.bondline_limit_K is None:
            continue
        distance = peak.bondline_limit_K - half_tolerance - peak.bondline_K
        active = loads[i] > s.load_K_s[i] * (1.0 - 1e-4)
        if distance < -half_tolerance or (active and distance > half_tolerance):
            s.load_K_s[i] = loads[i] + distance * _load_per_K(s, i, peak.bondline_K)
            changed = True
    return changed


def _load_per_K(s: _Steering, i: int, bondline_K: float) -> float:
    """Slope of the load against the bondline peak [s]: from the last two rounds if they differ, else in proportion."""
    proportional = float(s.rounds[-1][0][i] / max(bondline_K - SURROUNDINGS_K, 1.0))
    if len(s.rounds) > 1:
        (y0, T0), (y1, T1) = ((y[i], T[i]) for y, T in s.rounds[-2:])
        # A secant over nearly equal peaks, or from rounds on other meshes, may have any slope.
        if abs(T1 - T0) > 0.2 and 0.2 * proportional < (y1 - y0) / (T1 - T0) < 5.0 * proportional:
            return float((y1 - y0) / (T1 - T0))
    return proportional


def _entry(search: EntrySearch, motion: collocation.Motion, rounds: Sequence[OptimisationRound]) -> OptimalEntry:
    flown = search.conditions(motion)
    histories = search.march(flown, search.models)
    notes = search.notes(flown)
    if np.max(motion.errors) > search.study.declared.mesh_tolerance:
        notes.append(_mesh_note(search.study, motion))
    entry = OptimalEntry(
        search.study,
        motion,
        flown,
        cross_range_km=float(motion.goal) * tables.PLANET.radius_m / 1e3,
        histories=tuple(histories),
        peaks=search.peaks(histories),
        nominal=search.peaks(search.march(flown, search.nominal_models)),
        rounds=tuple(rounds),
        status="",
        notes=tuple(notes),
        flight_peaks=search.flight_peaks(motion, flown),
    )
    return replace(entry, status=_status(entry))


def _mesh_note(study: OptimalStudy, motion: collocation.Motion) -> str:
    """What a mesh that cannot be refined further leaves, and where."""
    coarse = motion.errors > study.declared.mesh_tolerance
    worst = int(np.argmax(motion.errors))
    longest = float(np.max(np.diff(motion.mesh)[coarse])) * motion.duration_s
    return (
        f"mesh error {motion.errors[worst]:.1e} at {motion.mesh[worst] * motion.duration_s:.0f} s, "
        f"above mesh_tolerance {study.declared.mesh_tolerance:g} in {np.count_nonzero(coarse)} of {len(coarse)} "
        f"intervals of at most {longest:.1f} s, which are not divided further"
    )


def _status(entry: OptimalEntry) -> str:
    kept, exceeded = entry.kept_limits, [str(p) for p in entry.flight_peaks if not p.kept]
    limits = f"kept: {', '.join(kept)}" if kept else "no limit was given"
    if exceeded:
        limits += f"; exceeded between the points where it is bounded: {', '.join(exceeded)}; lower mesh_tolerance"
    if kept:
        limits += f"; active: {', '.join(entry.active_limits)}" if entry.active_limits else "; none is active"
    P = entry.study.declared.probability
    probability = "" if P is None else f", with a probability of {P:g} or more"
    return f"optimal after {len(entry.rounds)} rounds: {limits}{probability}"


def _round_line(r: OptimisationRound) -> str:
    margins = [m for p in r.peaks for m in p.margins() if np.isfinite(m)]
    least = f", least margin {min(margins):.1f} K" if margins else ""
    return (
        f"{r.cross_range_deg:.3f} deg in {r.duration_s:.0f} s, {r.intervals} intervals, error {r.mesh_error:.1e}{least}"
    )


def _failure(study: OptimalStudy, rounds: Sequence[OptimisationRound], why: str) -> str:
    """Message that states why no flight was found, and which limit the last solution violated most."""
    if not rounds or not rounds[-1].peaks:
        return f"optimal entry `{study.title}`: {why}"
    peak = min(rounds[-1].peaks, key=lambda p: min(p.margins()))
    where, peak_K, limit_K = "surface", peak.surface_K, peak.surface_limit_K
    if peak.bondline_limit_K is not None and peak.bondline_limit_K - peak.bondline_K < limit_K - peak_K:
        where, peak_K, limit_K = "bondline", peak.bondline_K, peak.bondline_limit_K
    return (
        f"optimal entry `{study.title}`: {why}. The last solution has {peak.point} at {peak_K:.0f} K at the {where}, "
        f"whose limit is {limit_K:.0f} K"
    )
