"""A study for mission planning as a file: vehicle, base entry, temperature limits, and the results asked for.

format = "study/1"
title = "..."
vehicle = "orbiter"                 # a vehicle's name, or its directory relative to the study
revision = "1"                      # optional: refuse any other revision of the vehicle
scenario = "../entry_3dof.toml"     # the base entry: [trajectory] and [[effect]] of a scenario; or inline:
[trajectory]                        # as in a scenario
[[effect]]                          # as in a scenario
control_points = ["NOSECAP"]        # default: all
soak_s = 1800.0                     # soak after the entry, in which heat still flows to the bondline
[[limit]]                           # control_point; surface_K, bondline_K in place of the vehicle's own
[dispersion]                        # planning/dispersion/spec.py
[envelope]                          # maps and boundaries, planning/envelope/spec.py
[next_flight]                       # candidate manoeuvres for the next flight, planning/envelope/spec.py
[optimal]                           # an optimal entry, keys as in planning/optimal/spec.py

A table that is absent asks for no result. The hash of a study covers its contents and every file that it reads.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

from pydantic import Field, model_validator

from sim_heating.base.errors import InputError, error_context
from sim_heating.base.files import Declared, check, display_path, raise_problems, read_toml, roots_of
from sim_heating.estimation.report.estimate_file import estimate_path
from sim_heating.heating.effects import add_user_effects
from sim_heating.inputs.scenario import Scenario, ScenarioEffect, ScenarioFile, make_scenario
from sim_heating.inputs.vehicle import Vehicle, add_vehicle_files, load_vehicle, vehicle_place
from sim_heating.planning.bands import DECLARED, Member, read_member, require_points
from sim_heating.planning.dispersion.spec import Dispersion
from sim_heating.planning.envelope.spec import Envelope, NextFlight
from sim_heating.planning.limited_point import LimitedPoint
from sim_heating.planning.optimal.spec import Limit, OptimalStudy, OptimalStudyFile, optimal_study
from sim_heating.trajectory.spec import TrajectorySpec

HASH_LENGTH = 12
"""Characters of the hash that every figure shows."""
TABLES_WITH_MEMBERS = ("envelope", "dispersion")
"""Tables of a study that take members of a set of estimates."""


class StudyFile(Declared):
    """Contents of a study file.

    revision : revision of the vehicle's tables
    scenario : scenario file of the base entry, relative to the study
    optimal : keys of an optimal entry (`optimal-entry/1`) for the cross-range
    """

    format: str = Field(pattern="^study/1$", description='"study/1"')
    title: str
    vehicle: str
    revision: str | None = None
    note: str = ""
    scenario: str | None = None
    trajectory: TrajectorySpec | None = None
    effect: list[ScenarioEffect] = Field(default=[])
    control_points: list[str] | None = Field(default=None, min_length=1)
    soak_s: float = Field(default=0.0, ge=0.0, le=36000.0)
    limit: list[Limit] = Field(default=[])
    dispersion: Dispersion | None = None
    envelope: Envelope | None = None
    next_flight: NextFlight | None = None
    optimal: dict[str, Any] | None = None

    @model_validator(mode="after")
    def _has_one_base(self) -> StudyFile:
        if (self.scenario is None) == (self.trajectory is None):
            raise ValueError("give either `scenario` or [trajectory], not both and not neither")
        return self


@dataclass(frozen=True)
class Study:
    """A checked study.

    base   : the base entry with its vehicle
    points : its control points with their temperature limits
    hash   : of the study and all its inputs, HASH_LENGTH characters
    root   : folder that its files may name others in, as it was given
    estimates : files of the members of each table that has some, by the name of the table
    """

    path: Path
    declared: StudyFile
    base: Scenario
    points: tuple[LimitedPoint, ...]
    hash: str
    root: Path | None = None
    estimates: Mapping[str, tuple[Path, ...]] = field(default_factory=dict)

    def __repr__(self) -> str:
        return f"<Study `{self.title}`: {self.stamp}>"

    @property
    def title(self) -> str:
        """Title of the study."""
        return self.declared.title

    @property
    def vehicle(self) -> Vehicle:
        """The vehicle that flies."""
        return self.base.vehicle

    @property
    def stamp(self) -> str:
        """Vehicle, revision and hash of the study, as every figure shows them."""
        return f"{self.vehicle.name}, revision {self.vehicle.revision}, study {self.hash}"

    @property
    def files(self) -> tuple[Path, ...]:
        """Files and directories that it is made from; no results may replace them."""
        return (self.path, *self.base.files, *(p for paths in self.estimates.values() for p in paths))

    @cached_property
    def _members(self) -> dict[str, tuple[Member, ...]]:
        return {table: self._read_members(table) for table in TABLES_WITH_MEMBERS}

    def members(self, table: str) -> tuple[Member, ...]:
        """What may be true of the control points, each with its weight.

        table  : "envelope", whose margins at the band are by them, empty without bands; or "dispersion"
        raises : InputError for an estimate that cannot be read, or of no control point of the study
        """
        return self._members[table]

    def _read_members(self, table: str) -> tuple[Member, ...]:
        declared = getattr(self.declared, table)
        if declared is None or (isinstance(declared, Envelope) and not declared.bands):
            return ()
        members = []
        for i, (path, stated) in enumerate(zip(self.estimates[table], declared.member, strict=True), 1):
            member = read_member(path, stated.weight, self.root)
            with error_context(f"{display_path(self.path)}, [[{table}.member]] {i}"):
                require_points([member], self.base.names, self.vehicle.control_points)
            members.append(member)
        return tuple(members) or DECLARED

    def optimal(self) -> OptimalStudy | None:
        """The optimal entry that the study asks for; None where it has no [optimal]."""
        stated = self.declared.optimal
        if stated is None:
            return None
        where = f"{display_path(self.path)}, [optimal]"
        names = {"format": "optimal-entry/1", "title": self.title, "vehicle": self.vehicle.name}
        return optimal_study(check({**names, **stated}, OptimalStudyFile, where), self.vehicle, where)


def load_study(
    path: str | os.PathLike[str] | Study,
    vehicle: str | os.PathLike[str] | None = None,
    *,
    root: str | os.PathLike[str] | None = None,
) -> Study:
    """Read and check a study and everything that it names.

    path    : of the study's TOML file; a study that has been loaded is returned as it is
    vehicle : name or directory of a vehicle to fly instead of the study's own; any revision of it is accepted
    root    : folder that it may name files in; by default the nearest above it that holds `scenarios`
    raises  : InputError with one line a problem
    """
    if isinstance(path, Study):
        return path if vehicle is None else load_study(path.path, vehicle, root=path.root)
    study_path = Path(path)
    declared = read_toml(study_path, StudyFile)
    named = vehicle_place(study_path, declared.vehicle, root=root) if vehicle is None else vehicle
    loaded = load_vehicle(named, root=root)
    # A study of another revision would answer another question; --vehicle asks for that on purpose.
    if vehicle is None and declared.revision not in (None, loaded.revision):
        raise InputError(
            f'{display_path(study_path)}: `revision`: the study needs "{declared.revision}" and {loaded.name} is at '
            f'"{loaded.revision}"; change one of them'
        )
    base = _base(study_path, declared, loaded, root)
    points, estimates = _limited_points(study_path, declared, base), _estimates(study_path, declared, base, root)
    digest = _hash(study_path, declared, base, (path for paths in estimates.values() for path in paths))
    at = None if root is None else Path(root).absolute()
    study = Study(study_path, declared, base, points, digest, at, estimates)
    study.optimal()
    _ = study._members  # read once, so that what is wrong with an estimate is told here
    return study


def _estimates(
    study_path: Path, declared: StudyFile, base: Scenario, root: str | os.PathLike[str] | None
) -> dict[str, tuple[Path, ...]]:
    """Files of the members of each table that has some."""
    roots, estimates = roots_of(study_path, root, base.vehicle.directory), dict[str, tuple[Path, ...]]()
    for table in TABLES_WITH_MEMBERS:
        stated, paths = getattr(declared, table), list[Path]()
        for i, member in enumerate(stated.member if stated else (), 1):
            where = f"[[{table}.member]] {i}: `estimate`"
            path = estimate_path(roots.named(member.estimate, where))
            if not path.is_file():
                raise InputError(f"{display_path(study_path)}, {where}: the file {display_path(path)} does not exist")
            paths.append(path)
        estimates[table] = tuple(paths)
    return estimates


def _base(study_path: Path, declared: StudyFile, vehicle: Vehicle, root: str | os.PathLike[str] | None) -> Scenario:
    """The base entry as a scenario of the study's vehicle and control points."""
    head: dict[str, Any] = {"format": "scenario/1", "vehicle": declared.vehicle, "title": declared.title}
    contents = head | {"control_points": declared.control_points, "trajectory": declared.trajectory}
    contents["effect"] = [e.model_dump() for e in declared.effect]
    source = study_path
    if declared.scenario is not None:
        source = roots_of(study_path, root, vehicle.directory).named(declared.scenario, "`scenario`")
        if not os.path.isfile(source):
            raise InputError(f"{display_path(study_path)}: `scenario`: the file {display_path(source)} does not exist")
        flown = read_toml(source, ScenarioFile)
        if flown.heating.schedules:
            raise InputError(
                f"{display_path(source)}, [heating]: a study has no {' and '.join(flown.heating.schedules)} in time; "
                "fly a scenario without, and declare them in the stacks"
            )
        copied: dict[str, Any] = {
            "trajectory": flown.trajectory,
            "effect": [e.model_dump() for e in flown.effect],
            "heating": dict.fromkeys(flown.heating.left_out.values(), False),
        }
        # Checked by itself first, so that its own problems are reported with its path and all others with the study's.
        file = check(head | copied, ScenarioFile, display_path(source), tells=False)
        make_scenario(source, file, vehicle, root=root)
        contents |= copied | {"effect": [*copied["effect"], *contents["effect"]]}
    contents = {key: value for key, value in contents.items() if value is not None}
    file = check(contents, ScenarioFile, display_path(study_path), tells=False)
    return make_scenario(source, file, vehicle, error_file=study_path, root=root)


def _limited_points(study_path: Path, declared: StudyFile, base: Scenario) -> tuple[LimitedPoint, ...]:
    """The control points with the study's limits, or the vehicle's own where the study gives none."""
    limits = {limit.control_point: limit for limit in declared.limit}
    named = [("limit", name) for name in limits]
    candidates = declared.next_flight.manoeuvre if declared.next_flight is not None else []
    named += [("next_flight", name) for c in candidates for name in c.control_points]
    raise_problems(
        [
            f"{display_path(study_path)}, [{table}]: `{name}` is not among the study's control points; add it there"
            for table, name in dict.fromkeys(named)
            if name not in base.names
        ]
    )
    return tuple(limits.get(n, Limit(control_point=n)).limited(base.vehicle.control_point(n)) for n in base.names)


def _hash(study_path: Path, declared: StudyFile, base: Scenario, estimates: Iterable[Path]) -> str:
    """SHA-256 over the study, the base entry, all files of the vehicle, estimates, and user-defined effects."""
    digest = hashlib.sha256(declared.model_dump_json().encode())
    digest.update(base.declared.model_dump_json(exclude={"vehicle", "title"}).encode())
    add_vehicle_files(digest, base.vehicle.directory)
    for path in estimates:
        digest.update(path.read_bytes())
    add_user_effects(digest)
    return digest.hexdigest()[:HASH_LENGTH]
