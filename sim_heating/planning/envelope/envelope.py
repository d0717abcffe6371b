"""Envelope expansion: maps of peak temperatures and margins, and boundaries with the limit that makes each segment.

Every place of a map or boundary is a flight (case.py) whose margins are evaluated (margins.py). All flights of a study
are computed in batches (base/parallel/batches.py), each result a file of a ledger. A boundary is found from the flights
along one axis (boundary.py), and flights are added at the edges that were found.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from sim_heating.base.errors import RunError
from sim_heating.base.files import json_text
from sim_heating.base.parallel.batches import Job, run_batches
from sim_heating.base.progress import Progress
from sim_heating.heating.ratio.uncertainty import Evidence
from sim_heating.planning.envelope import boundary
from sim_heating.planning.envelope.case import BaseEntry, Case
from sim_heating.planning.envelope.margins import EvaluatedCase, Margin, MarginEvaluator
from sim_heating.planning.envelope.spec import Envelope, EnvelopeBoundary, EnvelopeMap
from sim_heating.planning.part import Engine, program_digest
from sim_heating.planning.ratio_table_modes import covariance_root, informed_root
from sim_heating.planning.study import Study, load_study

FOLDER = "envelope"
"""Folder of the files of an envelope, and prefix of its ledger."""
PLACE_DIGITS = 4
"""Significant digits of a place at which a flight is added."""
LEAST_SPACING = 0.02
"""Flights are not added closer than this part of an axis to one that was flown."""

ForecastEvidence = Mapping[str, Mapping[str, Evidence]]
"""Control point -> manoeuvre -> evidence that it would give on the ratio table."""


# Flights -------------------------------------------------------------------------------------------------------------


def base_entry(study: Study) -> BaseEntry:
    """The entry that the cases of a study change."""
    envelope = study.declared.envelope
    assert envelope is not None  # only an envelope has cases
    return BaseEntry(
        study.base.declared.trajectory,
        study.vehicle,
        station_width=envelope.station_width,
        elevon_arm_m=envelope.elevon_arm_m,
        bodyflap_above_mach=envelope.bodyflap_above_mach,
    )


def margin_evaluator(study: Study, forecast: ForecastEvidence | None = None) -> MarginEvaluator:
    """Evaluator of the cases of a study, also with the sigma that would remain after candidate manoeuvres."""
    informed = {
        point: {name: informed_root(root, evidence) for name, evidence in by_manoeuvre.items()}
        for point, by_manoeuvre in (forecast or {}).items()
        if (root := covariance_root(study.vehicle, point)) is not None
    }
    soak_s, members = study.declared.soak_s, study.members("envelope")
    return MarginEvaluator(base_entry(study), study.points, study.base, soak_s, informed, members=members)


@dataclass(frozen=True)
class _WorkerInput:
    """Inputs of a worker process, equal for all jobs of a run and identified by `key`."""

    path: Path
    vehicle: Path
    root: Path | None
    key: str
    forecast: ForecastEvidence


_EVALUATORS: dict[str, MarginEvaluator] = {}
"""The evaluator of the present run by its key, made once a process."""


def _evaluator(worker: _WorkerInput) -> MarginEvaluator:
    if worker.key not in _EVALUATORS:
        # A worker serves one run at a time; the models of an earlier one would only take memory.
        _EVALUATORS.clear()
        study = load_study(worker.path, worker.vehicle, root=worker.root)
        _EVALUATORS[worker.key] = margin_evaluator(study, worker.forecast)
    return _EVALUATORS[worker.key]


def _evaluate(worker: _WorkerInput, task: Mapping[str, Any]) -> bytes:
    """An evaluated case of a study, as the bytes of a file of the ledger."""
    return json_text(asdict(_evaluator(worker).evaluate(Case(**task)))).encode()


def read_evaluated(text: str) -> EvaluatedCase:
    """An evaluated case from a file of the ledger."""
    data = json.loads(text)
    margins = {name: Margin(**m) for name, m in data["margins"].items()}
    case, outside = Case(**data["case"]), tuple(data["outside"])
    return EvaluatedCase(**{**data, "case": case, "margins": margins, "outside": outside})


class StudyFlights:
    """All flights of a study, each flown once.

    forecast : evidence of the candidate manoeuvres for the next flight
    """

    def __init__(
        self, study: Study, engine: Engine, progress: Progress, forecast: ForecastEvidence | None = None
    ) -> None:
        self.study, self.engine, self.progress = study, engine, progress
        self.base = base_entry(study)
        # The forecast enters the key: flights evaluated with other candidates have other sigmas after the manoeuvre.
        digests = {p: {n: _digest(e) for n, e in m.items()} for p, m in (forecast or {}).items()}
        key = hashlib.sha256(f"{study.hash} {program_digest()} {sorted(digests.items())}".encode()).hexdigest()[:12]
        self._ledger = engine.ledger / f"{FOLDER}-{key}"
        path, vehicle = study.path.absolute(), study.vehicle.directory.absolute()
        self._worker = _WorkerInput(path, vehicle, study.root, key, forecast or {})
        self._known: dict[Case, EvaluatedCase] = {}

    def fly(self, cases: Iterable[Case]) -> list[EvaluatedCase]:
        """Fly cases and evaluate their margins, in order; a case that was flown before is not flown again.

        raises : RunError where one failed in an unexpected way; finished ones stay in the ledger
        """
        requested = list(cases)
        new = {_id(case): case for case in requested if case not in self._known}
        if new:
            jobs = [Job(name, asdict(case)) for name, case in new.items()]
            outcome = run_batches(
                jobs,
                partial(_evaluate, self._worker),
                self._ledger,
                scheduler=self.engine.scheduler,
                workers=self.engine.workers,
                progress=self.progress,
            )
            for name, why in outcome.failed.items():
                raise RunError(f"{new[name].describe()}: {why}")
            self._known |= {
                case: read_evaluated(outcome.done[name].read_text(encoding="utf-8")) for name, case in new.items()
            }
        return [self._known[case] for case in requested]

    @property
    def flown(self) -> list[EvaluatedCase]:
        """All cases flown so far."""
        return list(self._known.values())

    def require_one(self) -> None:
        """Check that there is a flight; raises RunError where none of the cases could be flown."""
        reasons = [f.error for f in self.flown if f.error is not None]
        if reasons and len(reasons) == len(self.flown):
            raise RunError(f"{self.study.path}: none of {len(reasons)} flights can be flown; the first: {reasons[0]}")


def _digest(evidence: Evidence) -> str:
    numbers = np.concatenate([a.ravel() for a in (evidence.nodes, evidence.H, evidence.covariance)])
    return hashlib.sha256(" ".join(f"{x:.6g}" for x in numbers).encode()).hexdigest()


def _id(case: Case) -> str:
    return hashlib.sha256(json.dumps(asdict(case), sort_keys=True).encode()).hexdigest()[:24] + ".json"


# Maps ----------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class FlownMap:
    """A map with its flights and their positions on the axes, the last axis fastest."""

    declared: EnvelopeMap
    positions: tuple[dict[str, float], ...]
    flights: tuple[EvaluatedCase, ...]


def fly_map(declared: EnvelopeMap, flights: StudyFlights) -> FlownMap:
    """Fly all places of a map."""
    positions = [dict(zip(declared.axes, values, strict=True)) for values in product(*declared.axes.values())]
    return FlownMap(declared, tuple(positions), tuple(flights.fly(declared.case(p) for p in positions)))


# Boundaries ----------------------------------------------------------------------------------------------------------

NOMINAL, CONSERVATIVE, OPTIMISTIC = "nominal", "conservative", "optimistic"
"""A boundary with the ratio tables as declared, with them hotter by a number of sigma, and cooler."""


def sigma_offsets(sigmas: float) -> dict[str, float]:
    """Number of sigma by which the ratio tables are hotter, for each kind of boundary."""
    return {NOMINAL: 0.0, CONSERVATIVE: sigmas, OPTIMISTIC: -sigmas}


@dataclass(frozen=True, eq=False)
class BoundarySegment:
    """A boundary at one position along its axis.

    position  : value on the axis `along`
    inside    : value on the axis `across` about which the allowed interval is sought
    positions : of the flights on the axis `across`
    allowed   : nominal, conservative and optimistic interval
    greatest  : likewise, where the boundary asks for a greatest value; None where nothing is allowed
    """

    member: float | None
    position: float
    inside: float
    positions: tuple[float, ...]
    flights: tuple[EvaluatedCase, ...]
    allowed: dict[str, boundary.AllowedInterval]
    greatest: dict[str, boundary.GreatestValue | None]

    def ends(self, which: str) -> tuple[float | None, float | None]:
        """Low and high end of the allowed interval, or 0 and the greatest value; None where nothing is allowed."""
        if self.greatest:
            g = self.greatest[which]
            return (None, None) if g is None else (0.0, g.value)
        a = self.allowed[which]
        return (None, None) if a.low is None or a.high is None else (a.low.at, a.high.at)

    def width(self, which: str) -> float:
        """Distance between the ends, 0 where nothing is allowed."""
        low, high = self.ends(which)
        return 0.0 if low is None or high is None else high - low

    @property
    def speed_m_s(self) -> float | None:
        """Mean velocity at the station of its flights [m/s], where they have one."""
        speeds = [f.station_m_s for f in self.flights if f.station_m_s is not None]
        return float(np.mean(speeds)) if speeds else None


@dataclass(frozen=True, eq=False)
class FlownBoundary:
    """A boundary with all its segments."""

    declared: EnvelopeBoundary
    segments: tuple[BoundarySegment, ...]

    def segments_of(self, member: float | None) -> list[BoundarySegment]:
        """The segments of one member of the family, along the axis."""
        return sorted((s for s in self.segments if s.member == member), key=lambda s: s.position)

    def area(self, which: str) -> float:
        """Allowed width integrated along the axis and summed over the family; with one place, the width there."""
        total = 0.0
        for member in self.declared.members():
            segments = self.segments_of(member)
            x, y = np.array([s.position for s in segments]), np.array([s.width(which) for s in segments])
            total += float(y[0]) if len(segments) == 1 else float(np.trapezoid(y, x))
        return total


def fly_boundary(declared: EnvelopeBoundary, envelope: Envelope, flights: StudyFlights) -> FlownBoundary:
    """Find a boundary: fly, find the edges, add flights there, find the edges again."""
    rows = list(product(declared.members(), declared.at))
    positions = {row: list(declared.values) for row in rows}
    # All rows together in each round, so that the workers have flights of every row at once.
    for _ in range(envelope.refinements + 1):
        flights.fly(declared.case(m, a, x) for (m, a), xs in positions.items() for x in xs)
        segments = {row: _fly_segment(declared, *row, xs, flights, envelope.sigmas) for row, xs in positions.items()}
        positions = {row: _add_places(declared, xs, segments[row]) for row, xs in positions.items()}
    return FlownBoundary(declared, tuple(segments.values()))


def _fly_segment(
    declared: EnvelopeBoundary,
    member: float | None,
    position: float,
    xs: Sequence[float],
    flights: StudyFlights,
    sigmas: float,
) -> BoundarySegment:
    flown = flights.fly(declared.case(member, position, x) for x in xs)
    inside = declared.inside
    if inside is None:
        inside = flights.base.value_on(declared.across, declared.case(member, position, xs[0]))
    if inside is None:
        inside = 0.5 * (declared.values[0] + declared.values[-1])
    return boundary_segment(declared, member, position, inside, flown, sigmas)


def boundary_segment(
    declared: EnvelopeBoundary,
    member: float | None,
    position: float,
    start: float,
    flown: Sequence[EvaluatedCase],
    sigmas: float,
    manoeuvre: str | None = None,
) -> BoundarySegment:
    """The segment of a boundary from its flights; with the sigma that remains after a manoeuvre where one is named."""
    xs = [getattr(f.case, declared.across) for f in flown]
    scans = {which: boundary.scan_axis(xs, flown, z, manoeuvre) for which, z in sigma_offsets(sigmas).items()}
    allowed = {which: boundary.allowed_interval(s, start) for which, s in scans.items()}
    greatest = {which: _greatest_cross_range(s, xs, flown) for which, s in scans.items()} if declared.greatest else {}
    return BoundarySegment(member, position, start, tuple(xs), tuple(flown), allowed, greatest)


def _greatest_cross_range(
    scan: boundary.AxisScan, xs: Sequence[float], flown: Sequence[EvaluatedCase]
) -> boundary.GreatestValue | None:
    values = [abs(f.cross_range_km) if f.error is None else np.nan for f in flown]
    return boundary.greatest_value(scan, xs, values)


def _add_places(declared: EnvelopeBoundary, xs: Sequence[float], segment: BoundarySegment) -> list[float]:
    """Places of the flights with those of the edges added."""
    a, g = segment.allowed[NOMINAL], segment.greatest.get(NOMINAL)
    edges = [e.at for e in (a.low, a.high, a.least_violated) if e is not None] if g is None else [g.at]
    spacing, positions = LEAST_SPACING * (declared.values[-1] - declared.values[0]), list(xs)
    for x in (float(f"{edge:.{PLACE_DIGITS}g}") for edge in edges):
        if declared.values[0] < x < declared.values[-1] and min(abs(x - p) for p in positions) > spacing:
            positions.append(x)
    return sorted(positions)
