"""The entry of largest cross-range whose control points stay below their temperature limits.

The optimiser bounds, at each point, the temperature of a wall that stores no heat (T_e) along the flight, and its
integral over time; the thermal model proper is then marched along what it found, soak after the end included, and each
bound is moved by what the marched peak lacks to its limit (for the bondline, along the secant), until every limit that
binds is met. The mesh is refined on the way.

With a probability P, tables are taken as ratio + z sigma, z the normal quantile of 1 - (1 - P)/n for n limited points.
A point's table is taken to be wrong by the same number of sigma everywhere, and points to be wrong together in any way
(Bonferroni): all stay inside with P at least.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from sim_heating.conditions import Conditions
from sim_heating.errors import RunError
from sim_heating.planning import optimal_dynamics as od
from sim_heating.planning import optimal_tables as tables
from sim_heating.planning.optimal_collocation import Bounds, FloatArray, Motion, Transcription, refined_mesh
from sim_heating.planning.optimal_search import Peak, Search
from sim_heating.planning.optimal_spec import OptimalStudy
from sim_heating.planning.soak import COLD_K
from sim_heating.temperatures import PointHistory

ROUNDS = 25
"""Optimisations at most, with their marches."""
BEND = np.array([0.1, 0.5])
"""How far alpha and bank [deg] may be from a straight line within an interval."""
Progress = Callable[[str], None]


@dataclass(frozen=True)
class Round:
    """One optimisation: what it found, with which bounds, and what the march said."""

    cross_range_deg: float
    duration_s: float
    intervals: int
    mesh_error: float
    iterations: int
    peaks: tuple[Peak, ...]


@dataclass(frozen=True)
class OptimalEntry:
    """An optimal entry.

    conditions   : the flight, every second, in the contract's columns
    histories    : marched temperatures of the limited points, soak included, tables as the limits were kept with
    peaks        : of these;  nominal : the same flight with the tables as they stand
    rounds       : how it converged
    status       : in words;  notes : where the flight leaves a ratio table or the elevon its travel, a line each
    """

    study: OptimalStudy
    motion: Motion
    conditions: Conditions
    cross_range_km: float
    histories: tuple[PointHistory, ...]
    peaks: tuple[Peak, ...]
    nominal: tuple[Peak, ...]
    rounds: tuple[Round, ...]
    status: str
    notes: tuple[str, ...] = ()

    @property
    def cross_range_deg(self) -> float:
        """Angle from the great circle along which the flight began."""
        return float(np.degrees(self.motion.goal))

    @property
    def binding(self) -> list[str]:
        """Limits that hold the flight back, in words."""
        near = 2.0 * self.study.declared.tolerance_K
        found = []
        for p in self.peaks:
            margins = zip(("surface", "bondline"), p.margins(), strict=False)
            found += [f"{p.point} {where}" for where, margin in margins if margin < near]
        return found


@dataclass
class _Steering:
    """Bounds that the optimiser is given: T_e [K] of each point, and its integral [K s], infinite where free."""

    wall_K: FloatArray
    load_K_s: FloatArray
    loaded: list[int]
    limited: bool
    seen: list[tuple[FloatArray, FloatArray]]

    def bounds(self) -> Bounds:
        """As a transcription takes them."""
        return Bounds(
            tuple(self.wall_K / 1e3) if self.limited else (),
            {od.STATES + k: self.load_K_s[i] for k, i in enumerate(self.loaded)},
        )


def fly_optimal(study: OptimalStudy, *, progress: Progress = lambda _: None) -> OptimalEntry:
    """The entry of largest cross-range within a study's limits.

    progress : told each round in a line
    raises   : InputError where CasADi is not installed; RunError where no flight is found that keeps the limits
    """
    search = Search(study)
    points = study.points
    steering = _Steering(
        np.full(len(points), np.inf), np.full(len(points), np.inf), search.loaded, search.wall is not None, []
    )
    motion, rounds = search.guess(), list[Round]()
    mesh = np.linspace(0.0, 1.0, study.declared.intervals + 1)
    transcription = Transcription(search.problem, mesh)
    for _ in range(ROUNDS):
        try:
            motion = transcription.solve(motion, steering.bounds())
        except RunError as error:
            raise RunError(_told(study, rounds, str(error))) from None
        peaks = search.peaks(search.march(search.conditions(motion), search.models))
        worst = float(np.max(motion.errors))
        rounds.append(Round(
            float(np.degrees(motion.goal)), motion.duration_s, len(motion.mesh) - 1, worst, motion.iterations, peaks
        ))  # fmt: skip
        progress(_line(rounds[-1]))
        steered = _steer(steering, search, motion, peaks, study.declared.tolerance_K)
        finer = refined_mesh(motion, study.declared.mesh_tolerance, BEND)
        fine = worst <= study.declared.mesh_tolerance
        if not steered and fine:
            return _entry(search, motion, rounds)
        if not fine:
            transcription = Transcription(search.problem, finer)
    why = f"limits and mesh did not settle in {ROUNDS} rounds, mesh error {worst:.1e} (mesh_tolerance, tolerance_K)"
    raise RunError(_told(study, rounds, why))


def _steer(s: _Steering, search: Search, motion: Motion, peaks: Sequence[Peak], tolerance_K: float) -> bool:
    """Move the bounds towards what the march lacks; False where nothing needs to move.

    Limits that bind are met from below: by no more than the tolerance, aimed at its middle.
    """
    within = 0.5 * tolerance_K
    hottest, loads = search.hottest(motion), search.loads(motion)
    s.seen.append((loads, np.array([p.bondline_K for p in peaks])))
    moved = False
    for i, peak in enumerate(peaks):
        lacking = peak.surface_limit_K - within - peak.surface_K
        binds = hottest[i] > s.wall_K[i] - 1.0
        if lacking < -within or (binds and lacking > within):
            s.wall_K[i] = min(s.wall_K[i], hottest[i]) + lacking
            moved = True
        if peak.bondline_limit_K is None:
            continue
        lacking = peak.bondline_limit_K - within - peak.bondline_K
        binds = loads[i] > s.load_K_s[i] * (1.0 - 1e-4)
        if lacking < -within or (binds and lacking > within):
            s.load_K_s[i] = loads[i] + lacking * _load_per_K(s, i, peak.bondline_K)
            moved = True
    return moved


def _load_per_K(s: _Steering, i: int, bondline_K: float) -> float:
    """Slope of the load against the bondline peak: by the last two rounds where they tell, else in proportion."""
    plain = float(s.seen[-1][0][i] / max(bondline_K - COLD_K, 1.0))
    if len(s.seen) > 1:
        (y0, T0), (y1, T1) = ((y[i], T[i]) for y, T in s.seen[-2:])
        if abs(T1 - T0) > 0.2 and 0.2 * plain < (y1 - y0) / (T1 - T0) < 5.0 * plain:
            return float((y1 - y0) / (T1 - T0))
    return plain


def _entry(search: Search, motion: Motion, rounds: Sequence[Round]) -> OptimalEntry:
    flown = search.conditions(motion)
    histories = search.march(flown, search.models)
    peaks = search.peaks(histories)
    nominal = search.peaks(search.march(flown, search.nominal))
    entry = OptimalEntry(
        search.study, motion, flown, float(motion.goal) * tables.PLANET.radius_m / 1e3,
        tuple(histories), peaks, nominal, tuple(rounds), "", tuple(search.notes(flown)),
    )  # fmt: skip
    return replace(entry, status=_status(entry))


def _status(entry: OptimalEntry) -> str:
    if not any(np.isfinite(m) for p in entry.peaks for m in p.margins()):
        kept = "no limit was asked for"
    elif entry.binding:
        kept = f"all limits are kept; held back by {', '.join(entry.binding)}"
    else:
        kept = "all limits are kept and none holds it back"
    sure = entry.study.declared.probability
    chance = "" if sure is None else f", with a probability of {sure:g} at least"
    return f"optimal after {len(entry.rounds)} rounds: {kept}{chance}"


def _line(r: Round) -> str:
    margins = [m for p in r.peaks for m in p.margins() if np.isfinite(m)]
    least = f", least margin {min(margins):.1f} K" if margins else ""
    return (
        f"{r.cross_range_deg:.3f} deg in {r.duration_s:.0f} s, {r.intervals} intervals, error {r.mesh_error:.1e}{least}"
    )


def _told(study: OptimalStudy, rounds: Sequence[Round], why: str) -> str:
    """Why no flight was found, and which limit the last one that was found passed most."""
    if not rounds or not rounds[-1].peaks:
        return f"optimal entry `{study.title}`: {why}"
    peak = min(rounds[-1].peaks, key=lambda p: min(p.margins()))
    where, hot, limit = "surface", peak.surface_K, peak.surface_limit_K
    if peak.bondline_limit_K is not None and peak.bondline_limit_K - peak.bondline_K < limit - hot:
        where, hot, limit = "bondline", peak.bondline_K, peak.bondline_limit_K
    return (
        f"optimal entry `{study.title}`: {why}. The last flight found takes {peak.point} to {hot:.0f} K at the "
        f"{where}, against {limit:.0f} K"
    )
