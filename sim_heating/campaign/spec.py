"""A campaign as a file: flights, the control points and manoeuvres that are fitted, and what becomes of the fits.

format = "campaign/1"
title = "..."
vehicle = "orbiter"                 # whose tables are revised: a name, or a directory relative to the campaign
control_points = ["V09T9527"]       # all that the flights have records of where absent
[[flight]]                          # a scenario that is flown and measured, once a seed
scenario = "../sts2.toml"
seeds = [8, 108]
[[flight]]                          # or records: one, or a directory that holds them
records = "flown/sts4"
check = true                        # revises no table; its temperatures are predicted before and after
[fit]                               # of each manoeuvre, from before_s before it to after_s after it
[[fit_of]]                          # other settings for some: flight, control_point, manoeuvre, and keys of [fit]
[joint]                             # one fit of all flights that flew a manoeuvre at the same speed
[ageing]                            # parameters that walk from flight to flight, and how far in one [1 sigma]
"stack.emissivity_factor" = 0.01
close_loop = true                   # what the declared model lacks, from each whole record
update_tables = true
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, model_validator

from sim_heating.base import files
from sim_heating.campaign.flights import Manoeuvre, with_seed
from sim_heating.inputs.fit_settings import ParameterSettings, dotted
from sim_heating.inputs.scenario import Scenario, load_scenario
from sim_heating.inputs.vehicle import Vehicle, load_vehicle, vehicle_place


class FlightSource(files.Declared):
    """Where a flight comes from: a scenario, flown and measured, or records."""

    scenario: str | None = Field(default=None, description="a scenario file, relative to the campaign")
    seeds: list[int] | None = Field(default=None, min_length=1, description="of the measurements, a flight for each")
    records: str | None = Field(default=None, description="a record, or a directory that holds records")
    check: bool = Field(default=False, description="true: revises no table, and is predicted before and after")

    @model_validator(mode="after")
    def _has_one_source(self) -> FlightSource:
        if (self.scenario is None) == (self.records is None):
            raise ValueError("give either `scenario` or `records`, not both and not neither")
        if self.seeds is not None:
            if self.records is not None:
                raise files.LocatedError((("seeds",), "are of a scenario; remove them"))
            if files.repeated_name([str(s) for s in self.seeds]) is not None or min(self.seeds) < 0:
                raise files.LocatedError((("seeds",), f"{self.seeds} must be different whole numbers, 0 or above"))
        return self


class ManoeuvreSettings(ParameterSettings):
    """How a manoeuvre is fitted; what is absent is as in [fit], and there as stated here.

    before_s, after_s : times that are fitted before and after the manoeuvre [s], 20 and 40
    start             : temperatures at the start of the fit: declared, or of a circuit, a profile, a filter; `profile`

    By default the magnitude and the derivatives that the record can tell are estimated.
    """

    before_s: float | None = Field(default=None, ge=0.0, le=1000.0)
    after_s: float | None = Field(default=None, ge=0.0, le=1000.0)
    start: Literal["declared", "circuit", "profile", "filter"] | None = None

    def over(self, other: ManoeuvreSettings) -> ManoeuvreSettings:
        """These settings, and those of `other` where these are absent; tables are merged name by name."""
        stated = {n: getattr(self, n) for n in self.model_fields_set if n in ManoeuvreSettings.model_fields}
        merged = {n: {**getattr(other, n), **v} if isinstance(v, dict) else v for n, v in stated.items()}
        return other.model_copy(update=merged)


STANDARD = ManoeuvreSettings(before_s=20.0, after_s=40.0, start="profile")
"""What [fit] does not state."""


class SelectedFit(ManoeuvreSettings):
    """Settings of the fits of one flight, control point or manoeuvre; of all where it is absent.

    flight : name of the flight
    """

    flight: str | None = None
    control_point: str | None = None
    manoeuvre: str | None = Field(default=None, description="kind and speed, as `popu-mach20`")

    def selects(self, flight: str, control_point: str, manoeuvre: str) -> bool:
        """Whether it is meant for this fit."""
        pairs = ((self.flight, flight), (self.control_point, control_point), (self.manoeuvre, manoeuvre))
        return all(selected is None or selected == value for selected, value in pairs)


class Joint(files.Declared):
    """Joint fits of all flights that flew one kind of manoeuvre at nearly the same speed."""

    fitted: bool = Field(default=True, description="false: every flight by itself alone")
    speed_tolerance: float = Field(default=0.03, gt=0.0, lt=1.0, description="largest relative difference of speeds")


class CampaignFile(files.Declared):
    """Contents of a campaign file.

    close_loop : false: no search for missing effects
    update_tables : false: the tables stay as they are
    """

    format: str = Field(pattern="^campaign/1$", description='"campaign/1"')
    title: str
    vehicle: str
    note: str = ""
    control_points: list[str] | None = Field(default=None, min_length=1)
    flight: list[FlightSource] = Field(min_length=1, description="[[flight]], at least one")
    fit: ManoeuvreSettings = ManoeuvreSettings()
    fit_of: list[SelectedFit] = Field(default=[])
    joint: Joint = Joint()
    ageing: Annotated[dict[str, float], dotted(float)] = Field(
        default_factory=dict, description="name = standard deviation of its change from one flight to the next"
    )
    close_loop: bool = True
    update_tables: bool = True

    @model_validator(mode="after")
    def _check_flights(self) -> CampaignFile:
        problems: list[tuple[files.Location, str]] = []
        if all(f.check for f in self.flight):
            problems.append((("flight",), "all are `check`; one at least must be fitted and revise the tables"))
        for name, sigma in self.ageing.items():
            if not sigma >= 0.0:
                problems.append((("ageing", name), f"{sigma} must be a standard deviation, 0 or above"))
            if name not in (self.fit.parameters or []):
                problems.append((("ageing", name), "no fit estimates it; add it to `parameters` of [fit]"))
            if name in self.fit.prior or name in self.fit.fix:
                problems.append((("ageing", name), "has a value beforehand in [fit], which every flight would count"))
        files.raise_located(problems)
        return self


@dataclass(frozen=True, eq=False)
class FlightInput:
    """One flight of a campaign before it is flown or read.

    scenarios : the scenario with each of its seeds; empty for records
    seeds     : of the scenarios, None for the scenario's own
    records   : directory of the records; None for a scenario
    check     : whether it only checks the tables
    """

    scenarios: tuple[Scenario, ...]
    seeds: tuple[int | None, ...]
    records: Path | None
    check: bool


@dataclass(frozen=True, eq=False)
class Campaign:
    """A checked campaign.

    path, declared : its file
    vehicle        : whose tables are revised
    flights        : in order
    root           : folder that its files may name others in, as it was given
    """

    path: Path
    declared: CampaignFile
    vehicle: Vehicle
    flights: tuple[FlightInput, ...]
    root: Path | None = None

    def __repr__(self) -> str:
        return f"<Campaign {self.title!r}: {self.vehicle.name}, {len(self.flights)} sources of flights>"

    @property
    def title(self) -> str:
        """Title of the campaign."""
        return self.declared.title

    @property
    def files(self) -> tuple[Path, ...]:
        """Files and directories that it is made from; no results may replace them."""
        scenarios = (path for f in self.flights for s in f.scenarios[:1] for path in s.files)
        records = (f.records for f in self.flights if f.records is not None)
        return (self.path, self.vehicle.directory, *scenarios, *records)

    def settings(self, flight: str, control_point: str, manoeuvre: Manoeuvre) -> ManoeuvreSettings:
        """Settings of one fit; of several [[fit_of]] that mean it, a later one takes precedence."""
        settings = self.declared.fit.over(STANDARD)
        for selected in self.declared.fit_of:
            if selected.selects(flight, control_point, manoeuvre.name):
                settings = selected.over(settings)
        return settings


def load_campaign(path: str | os.PathLike[str] | Campaign, *, root: str | os.PathLike[str] | None = None) -> Campaign:
    """Read and check a campaign, its vehicle and its scenarios; records are read when they are fitted.

    path   : of the campaign's TOML file; a campaign that has been loaded is returned as it is
    root   : folder that it may name files in; by default the nearest above it that holds `scenarios`
    raises : InputError with one line a problem
    """
    if isinstance(path, Campaign):
        return path
    campaign_path = Path(path)
    declared = files.read_toml(campaign_path, CampaignFile)
    vehicle = load_vehicle(vehicle_place(campaign_path, declared.vehicle, root=root), root=root)
    roots = files.roots_of(campaign_path, root, vehicle.directory)
    files.raise_problems(_repeated_flights(declared, files.display_path(campaign_path)))
    flights, problems = _flight_inputs(campaign_path, declared, vehicle.name, roots, root)
    problems += [
        f"{files.display_path(campaign_path)}: `control_points`: {vehicle.name} has no {name}"
        for name in declared.control_points or ()
        if name not in vehicle.control_points
    ]
    names = [s.flight for f in flights for s in f.scenarios]
    if (name := files.repeated_name(names)) is not None:
        problems.append(
            f"{files.display_path(campaign_path)}: two flights are named {name}; give each scenario its own `flight`"
        )
    files.raise_problems(problems)
    return Campaign(campaign_path, declared, vehicle, tuple(flights), None if root is None else Path(root).absolute())


def _flight_inputs(
    path: Path, declared: CampaignFile, vehicle: str, roots: files.Roots, root: str | os.PathLike[str] | None
) -> tuple[list[FlightInput], list[str]]:
    """Flights of a campaign whose files exist, and a line for each that has none or flies another vehicle."""
    read = cache(partial(load_scenario, root=root))
    flights, problems = [], []
    for i, source in enumerate(declared.flight, start=1):
        key = "scenario" if source.scenario is not None else "records"
        source_path = roots.named(source.scenario or source.records or "", f"[[flight]] {i}: `{key}`")
        where = f"{files.display_path(path)}, [[flight]] {i}: "
        if not os.path.exists(source_path):  # false for a path that is too long as well
            problems.append(f"{where}`{key}`: there is no {files.display_path(source_path)}")
            continue
        if source.scenario is None:
            flights.append(FlightInput((), (), source_path, source.check))
            continue
        scenario = read(source_path)
        flights.append(_seeded(scenario, source))
        if scenario.vehicle.name != vehicle:
            problems.append(
                f"{where}{files.display_path(source_path)} flies {scenario.vehicle.name}, the campaign revises "
                f"the tables of {vehicle}; they must be one vehicle"
            )
    return flights, problems


def _seeded(scenario: Scenario, source: FlightSource) -> FlightInput:
    """A scenario with each seed of its source, or with its own."""
    scenarios = (scenario,) if source.seeds is None else tuple(with_seed(scenario, s) for s in source.seeds)
    return FlightInput(scenarios, tuple(source.seeds or [None]), None, source.check)


def _repeated_flights(declared: CampaignFile, file: str) -> list[str]:
    """The first flight that is stated again: one scenario with one seed, or one directory of records."""
    first: dict[tuple[str, int | None], int] = {}
    for i, source in enumerate(declared.flight, start=1):
        name = os.path.normpath(source.scenario or source.records or "")
        for seed in source.seeds or (None,):
            k = first.setdefault((name, seed), i)
            if k != i:
                title = name if seed is None else f"{name} with seed {seed}"
                return [f"{file}, [[flight]] {i}: {title} is that of [[flight]] {k}; remove one, or give other `seeds`"]
    return []
