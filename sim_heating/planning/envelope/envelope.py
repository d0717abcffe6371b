"""Envelope expansion: maps of peak temperatures and margins, and boundaries with the limit that makes each stretch.

Every place of a map or boundary is a flight (`case`) held against its limits (`margins`); all flights of a study go
through the one engine (`batches`), each result a file of its ledger. A boundary is found from the flights along one
axis (`boundary`), and flights are added where its edges came to lie.
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
from sim_heating.base.parallel import Job, run_batches
from sim_heating.base.progress import Progress
from sim_heating.heating.ratio.uncertainty import Evidence
from sim_heating.planning.envelope.boundary import Allowed, Greatest, Scan, allowed, greatest, scan
from sim_heating.planning.envelope.case import Base, Case
from sim_heating.planning.envelope.margins import Evaluated, Judge, Margin
from sim_heating.planning.envelope.spec import Boundary, Envelope, Map
from sim_heating.planning.part import Engine, program_digest
from sim_heating.planning.ratio_table_modes import covariance_root, informed_root
from sim_heating.planning.study import Study, load_study

FOLDER = "envelope"
PLACE_DIGITS = 4
"""Significant digits of a place at which a flight is added."""
APART = 0.02
"""Flights are not added closer than this part of an axis to one that is flown."""

Informed = Mapping[str, Mapping[str, Evidence]]
"""Control point -> manoeuvre -> what it would tell of the table."""


# Flights -------------------------------------------------------------------------------------------------------------


def base_of(study: Study) -> Base:
    """What the cases of a study start from."""
    asked = study.declared.envelope
    assert asked is not None  # else nobody asks for cases
    return Base(
        study.base.declared.trajectory, study.vehicle, station_width=asked.station_width,
        elevon_arm_m=asked.elevon_arm_m, bodyflap_above_mach=asked.bodyflap_above_mach,
    )  # fmt: skip


def judge_of(study: Study, informed: Informed | None = None) -> Judge:
    """What flies the cases of a study and holds them against its limits."""
    left = {
        point: {name: informed_root(root, evidence) for name, evidence in told.items()}
        for point, told in (informed or {}).items()
        if (root := covariance_root(study.vehicle, point)) is not None
    }
    return Judge(base_of(study), study.points, study.base, study.declared.soak_s, left)


@dataclass(frozen=True)
class _Source:
    """Where a worker finds what it needs; equal for all jobs of a run, and known by `key`."""

    path: Path
    vehicle: Path
    key: str
    informed: Informed


_JUDGES: dict[str, Judge] = {}
"""The judge of the present run, by its key: made once a process."""


def _judge(source: _Source) -> Judge:
    if source.key not in _JUDGES:
        _JUDGES.clear()
        _JUDGES[source.key] = judge_of(load_study(source.path, source.vehicle), source.informed)
    return _JUDGES[source.key]


def _evaluate(source: _Source, task: Mapping[str, Any]) -> bytes:
    """A case of a study, evaluated, as the bytes of a ledger."""
    return json_text(asdict(_judge(source).evaluate(Case(**task)))).encode()


def read_evaluated(text: str) -> Evaluated:
    """What a ledger holds of a case."""
    data = json.loads(text)
    margins = {name: Margin(**m) for name, m in data["margins"].items()}
    return Evaluated(**{**data, "case": Case(**data["case"]), "margins": margins, "outside": tuple(data["outside"])})


class Flights:
    """All flights of a study, each flown once.

    informed : what manoeuvres that may be flown next would tell
    """

    def __init__(self, study: Study, engine: Engine, progress: Progress, informed: Informed | None = None) -> None:
        self.study, self.engine, self.progress = study, engine, progress
        self.base = base_of(study)
        told = {p: {n: _digest(e) for n, e in m.items()} for p, m in (informed or {}).items()}
        key = hashlib.sha256(f"{study.hash} {program_digest()} {sorted(told.items())}".encode()).hexdigest()[:12]
        self._ledger = engine.ledger / f"{FOLDER}-{key}"
        self._source = _Source(study.path.resolve(), study.vehicle.directory.resolve(), key, informed or {})
        self._known: dict[Case, Evaluated] = {}

    def fly(self, cases: Iterable[Case]) -> list[Evaluated]:
        """Cases with their margins, in order.

        raises : RunError where one failed in an unexpected way; what is finished stays in the ledger
        """
        wanted = list(cases)
        new = {_id(case): case for case in wanted if case not in self._known}
        if new:
            jobs = [Job(name, asdict(case)) for name, case in new.items()]
            outcome = run_batches(
                jobs, partial(_evaluate, self._source), self._ledger,
                scheduler=self.engine.scheduler, workers=self.engine.workers, progress=self.progress,
            )  # fmt: skip
            for name, why in outcome.failed.items():
                raise RunError(f"{new[name].told()}: {why}")
            self._known |= {
                case: read_evaluated(outcome.done[name].read_text(encoding="utf-8")) for name, case in new.items()
            }
        return [self._known[case] for case in wanted]

    @property
    def flown(self) -> list[Evaluated]:
        """All so far."""
        return list(self._known.values())

    def require_one(self) -> None:
        """raises : RunError where none of them could be flown"""
        reasons = [f.error for f in self.flown if f.error is not None]
        if reasons and len(reasons) == len(self.flown):
            raise RunError(f"{self.study.path}: none of {len(reasons)} flights can be flown; first {reasons[0]}")


def _digest(evidence: Evidence) -> str:
    numbers = np.concatenate([a.ravel() for a in (evidence.nodes, evidence.H, evidence.covariance)])
    return hashlib.sha256(" ".join(f"{x:.6g}" for x in numbers).encode()).hexdigest()


def _id(case: Case) -> str:
    return hashlib.sha256(json.dumps(asdict(case), sort_keys=True).encode()).hexdigest()[:24] + ".json"


# Maps ----------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class FlownMap:
    """A map: its flights by their places on the axes, the last axis fastest."""

    declared: Map
    places: tuple[dict[str, float], ...]
    flights: tuple[Evaluated, ...]


def fly_map(declared: Map, flights: Flights) -> FlownMap:
    """Fly all places of a map."""
    places = [dict(zip(declared.axes, values, strict=True)) for values in product(*declared.axes.values())]
    return FlownMap(declared, tuple(places), tuple(flights.fly(declared.case(p) for p in places)))


# Boundaries ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Stretch:
    """A boundary at one place along its axis.

    inside   : about which the allowed interval is sought
    places   : of the flights on the axis across
    allowed  : at z = 0, and at `sigmas` above and below: what is surely, and what is perhaps allowed
    greatest : likewise, where the boundary asks for a greatest value; None where nothing is allowed
    """

    member: float | None
    along: float
    inside: float
    places: tuple[float, ...]
    flights: tuple[Evaluated, ...]
    allowed: dict[str, Allowed]
    greatest: dict[str, Greatest | None]

    def value(self, which: str) -> tuple[float | None, float | None]:
        """Low and high end of what is allowed, or 0 and the greatest value; None where nothing is."""
        if self.greatest:
            g = self.greatest[which]
            return (None, None) if g is None else (0.0, g.value)
        a = self.allowed[which]
        return (None, None) if a.low is None or a.high is None else (a.low.at, a.high.at)

    @property
    def speed_m_s(self) -> float | None:
        """Mean velocity at the station of its flights, where they have one."""
        speeds = [f.station_m_s for f in self.flights if f.station_m_s is not None]
        return float(np.mean(speeds)) if speeds else None

    def width(self, which: str) -> float:
        """Length of what is allowed."""
        low, high = self.value(which)
        return 0.0 if low is None or high is None else high - low


MIDDLE, SURE, PERHAPS = "middle", "sure", "perhaps"
"""A boundary as the tables stand, with them so many sigma hotter, and cooler."""


def signs(sigmas: float) -> dict[str, float]:
    """How many sigma hotter each of them is."""
    return {MIDDLE: 0.0, SURE: sigmas, PERHAPS: -sigmas}


@dataclass(frozen=True, eq=False)
class FlownBoundary:
    """A boundary with all its stretches."""

    declared: Boundary
    stretches: tuple[Stretch, ...]

    def of(self, member: float | None) -> list[Stretch]:
        """The stretches of one member of the family, along the axis."""
        return sorted((s for s in self.stretches if s.member == member), key=lambda s: s.along)

    def area(self, which: str) -> float:
        """What is allowed, integrated along the axis and summed over the family; a mean where there is one place."""
        total = 0.0
        for member in self.declared.members():
            own = self.of(member)
            x, y = np.array([s.along for s in own]), np.array([s.width(which) for s in own])
            total += float(y[0]) if len(own) == 1 else float(np.trapezoid(y, x))
        return total


def fly_boundary(declared: Boundary, envelope: Envelope, flights: Flights) -> FlownBoundary:
    """Find a boundary: fly, find the edges, fly at them, find them again."""
    rows = list(product(declared.members(), declared.at))
    places = {row: list(declared.values) for row in rows}
    for _ in range(envelope.refinements + 1):
        flights.fly(declared.case(m, a, x) for (m, a), xs in places.items() for x in xs)
        found = {row: _stretch(declared, *row, xs, flights, envelope.sigmas) for row, xs in places.items()}
        places = {row: _refined(declared, xs, found[row]) for row, xs in places.items()}
    return FlownBoundary(declared, tuple(found.values()))


def _stretch(
    declared: Boundary, member: float | None, along: float, xs: Sequence[float], flights: Flights, sigmas: float
) -> Stretch:
    flown = flights.fly(declared.case(member, along, x) for x in xs)
    inside = declared.inside
    if inside is None:
        inside = flights.base.neutral(declared.across, declared.case(member, along, xs[0]))
    if inside is None:
        inside = 0.5 * (declared.values[0] + declared.values[-1])
    return stretch(declared, member, along, inside, flown, sigmas)


def stretch(
    declared: Boundary, member: float | None, along: float, inside: float, flown: Sequence[Evaluated],
    sigmas: float, manoeuvre: str | None = None,
) -> Stretch:  # fmt: skip
    """The stretch of a boundary from its flights; with the sigma that a manoeuvre would leave where one is named."""
    xs = [getattr(f.case, declared.across) for f in flown]
    scans = {which: scan(xs, flown, z, manoeuvre) for which, z in signs(sigmas).items()}
    found = {which: allowed(s, inside) for which, s in scans.items()}
    most = {which: _most(declared, s, xs, flown) for which, s in scans.items()} if declared.greatest else {}
    return Stretch(member, along, inside, tuple(xs), tuple(flown), found, most)


def _most(declared: Boundary, found: Scan, xs: Sequence[float], flown: Sequence[Evaluated]) -> Greatest | None:
    values = [abs(f.cross_range_km) if f.error is None else np.nan for f in flown]
    return greatest(found, xs, values)


def _refined(declared: Boundary, xs: Sequence[float], found: Stretch) -> list[float]:
    """Places with those of the edges added."""
    a, g = found.allowed[MIDDLE], found.greatest.get(MIDDLE)
    wanted = [e.at for e in (a.low, a.high, a.least_bad) if e is not None] if g is None else [g.at]
    apart, places = APART * (declared.values[-1] - declared.values[0]), list(xs)
    for x in (float(f"{w:.{PLACE_DIGITS}g}") for w in wanted):
        if declared.values[0] < x < declared.values[-1] and min(abs(x - p) for p in places) > apart:
            places.append(x)
    return sorted(places)
