"""Flights of a campaign: their records by control point, and the manoeuvres flown in them.

A flight is a set of records that share a clock and flight conditions, one a control point. It is read from directories
of records, or flown in a scenario and measured with its sensor model.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from sim_heating.base.conditions import SHUTTLE_MACH_M_S
from sim_heating.base.errors import InputError
from sim_heating.base.files import display_path, repeated_name
from sim_heating.base.progress import Progress, no_progress
from sim_heating.inputs.record import DECLARATION, Record, load_record
from sim_heating.inputs.scenario import Scenario, load_scenario
from sim_heating.simulation.synthesize import synthesize
from sim_heating.trajectory.flight import Flight

SCENARIO_SUFFIX = ".toml"


@dataclass(frozen=True)
class Manoeuvre:
    """A manoeuvre of one flight.

    name           : kind and speed, as `popu-mach20`; Mach as in the Shuttle's literature, in units of 1000 ft/s
    kind           : as in a scenario, `popu` or `bodyflap-sweep` and the like
    start_s, end_s : when it was flown [s]
    velocity_m_s   : at its start
    """

    name: str
    kind: str
    start_s: float
    end_s: float
    velocity_m_s: float

    @property
    def shuttle_mach(self) -> float:
        """Velocity at the start in units of 1000 ft/s, the 'Mach' number of the Shuttle's literature."""
        return self.velocity_m_s / SHUTTLE_MACH_M_S


@dataclass(frozen=True, eq=False)
class CampaignFlight:
    """One flight.

    name       : of the flight, as its records state it
    records    : control point -> record
    manoeuvres : those that its records state, in order of time
    scenario   : that it was flown in; None for records that were read
    """

    name: str
    records: Mapping[str, Record]
    manoeuvres: tuple[Manoeuvre, ...]
    scenario: Scenario | None = None

    def __repr__(self) -> str:
        flown = ", ".join(m.name for m in self.manoeuvres) or "no manoeuvre"
        return f"<CampaignFlight {self.name!r}: {len(self.records)} records; {flown}>"


def read_flights(
    paths: Iterable[str | os.PathLike[str]],
    *,
    root: str | os.PathLike[str] | None = None,
    progress: Progress = no_progress,
) -> list[CampaignFlight]:
    """Flights of scenario files, which are flown and measured, and of directories of records.

    paths   : scenario files (.toml), records, or directories that hold records at any depth
    root    : folder that the files may name others in; by default the nearest above each with `scenarios`
    returns : flights in order of their paths; records that state one flight are of one flight
    raises  : InputError where a path holds neither, or a flight has two records of one control point
    """
    sources = [Path(p) for p in paths]
    flights: list[CampaignFlight] = []
    loaded: list[Record] = []
    for i, path in enumerate(sources):
        progress(i / len(sources), f"reading {path}")
        if path.suffix == SCENARIO_SUFFIX:
            scenario = load_scenario(path, root=root)
            flights.append(flight_of_scenario(scenario, progress=_part(progress, i, len(sources))))
        else:
            loaded += [load_record(p, root=root) for p in record_directories(path)]
    flights += flights_of_records(loaded)
    if (name := repeated_name([f.name for f in flights])) is not None:
        raise InputError(f"two flights are named {name}; give one of them another `flight`")
    return flights


def _part(progress: Progress, i: int, n: int) -> Progress:
    return lambda done, text: progress((i + done) / n, text)


def record_directories(path: Path) -> list[Path]:
    """Directories of records at a path: itself, or all below it.

    raises : InputError where there is none
    """
    if (path / DECLARATION).is_file():
        return [path]
    below = sorted(p.parent for p in path.rglob(DECLARATION)) if path.is_dir() else []
    if not below:
        raise InputError(f"{display_path(path)}: is neither a scenario (.toml) nor a directory that holds records")
    return below


def flights_of_records(records: Sequence[Record]) -> list[CampaignFlight]:
    """Flights that records are of, in the order in which they come.

    raises : InputError where a flight has two records of one control point, or its records state other manoeuvres
    """
    by_flight: dict[str, dict[str, Record]] = {}
    for record in records:
        points = by_flight.setdefault(record.flight, {})
        point = record.declared.control_point
        if point in points:
            raise InputError(
                f"{display_path(record.directory)} and {display_path(points[point].directory)} are both of flight "
                f"{record.flight} and control point {point}; give one of them another `flight`"
            )
        points[point] = record
    return [CampaignFlight(name, points, _manoeuvres(name, points)) for name, points in by_flight.items()]


def flight_of_scenario(
    scenario: Scenario, *, flown: Flight | None = None, progress: Progress = no_progress
) -> CampaignFlight:
    """A scenario flown and measured.

    flown : the scenario's flight, where it has been flown already
    """
    records = synthesize(scenario, flight=flown, progress=progress)
    return CampaignFlight(scenario.flight, records, _manoeuvres(scenario.flight, records), scenario)


def with_seed(scenario: Scenario, seed: int) -> Scenario:
    """The scenario with another seed of its measurements, and a flight that is named after it."""
    measurements = scenario.declared.measurements.model_copy(update={"seed": seed})
    changed = {"measurements": measurements, "flight": f"{scenario.flight}-seed{seed}"}
    return replace(scenario, declared=scenario.declared.model_copy(update=changed))


def _manoeuvres(flight: str, records: Mapping[str, Record]) -> tuple[Manoeuvre, ...]:
    """Manoeuvres of a flight, each with a name of its own.

    raises : InputError where its records state different ones
    """
    first, *others = records.values()
    declared = first.declared.manoeuvre
    for other in others:
        if other.declared.manoeuvre != declared:
            raise InputError(
                f"flight {flight}: {display_path(first.directory)} and {display_path(other.directory)} state different "
                f"[[manoeuvre]]s; correct one, or give it another `flight`"
            )
    manoeuvres: list[Manoeuvre] = []
    for m in sorted(declared, key=lambda m: m.start_s):
        velocity = float(np.interp(m.start_s, first.conditions.time_s, first.conditions["velocity_m_s"]))
        name = numbered(f"{m.kind}-mach{velocity / SHUTTLE_MACH_M_S:.0f}", [f.name for f in manoeuvres])
        manoeuvres.append(Manoeuvre(name, m.kind, m.start_s, m.end_s, velocity))
    return tuple(manoeuvres)


def numbered(stem: str, names: Sequence[str]) -> str:
    """A name, with the number of its occurrence behind it from the second one on, as `popu-mach20-2`."""
    same = sum(name == stem or name.startswith(f"{stem}-") for name in names)
    return f"{stem}-{same + 1}" if same else stem
