"""Run a campaign: fly or read its flights, close the loop on each record, fit each manoeuvre, alone and jointly, revise
the tables, and report.

    DIR/records/FLIGHT/POINT           records of the scenarios that were flown
    DIR/closed/FLIGHT/POINT            what close-loop found in each record
    DIR/fits/FLIGHT/POINT/MANOEUVRE    the fit of each manoeuvre
    DIR/joint/POINT/MANOEUVRE          the fit of all flights that flew it
    DIR/tables/VEHICLE                 the vehicle with its revised tables
    DIR/campaign.json, .csv, report.html
    DIR/next_flight.toml               what is known before the next flight of parameters that age

Every finished part is kept in a ledger: a campaign that was interrupted goes on where it stopped, and one whose inputs
have changed repeats what depends on them.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

from sim_heating.base import files
from sim_heating.base.conditions import RATIO_VARIABLES
from sim_heating.base.errors import RunError
from sim_heating.base.files.package import package_version
from sim_heating.base.parallel.batches import Job, Outcome, run_batches
from sim_heating.base.progress import Progress, no_progress
from sim_heating.campaign.ageing import next_flight_settings
from sim_heating.campaign.carried import Carried, agreed, mean_estimates, read_carried
from sim_heating.campaign.flights import CampaignFlight, flights_of_records, record_directories, with_seed
from sim_heating.campaign.joint import Group, agreement, groups_of
from sim_heating.campaign.manoeuvre_fits import FitTask, FittedSpan, fit_job, fitted_span, run_fit, usable
from sim_heating.campaign.report import FILES, NEXT_FLIGHT, PAGE, SUMMARY, write_campaign_page, write_csvs
from sim_heating.campaign.result import CampaignResult
from sim_heating.campaign.spec import Campaign, FlightInput, ManoeuvreSettings, load_campaign
from sim_heating.campaign.tables import revise_tables
from sim_heating.closure.batch import close_all, results_are_there
from sim_heating.estimation.problem import joint_reference
from sim_heating.inputs.record import Record, load_record
from sim_heating.inputs.scenario import load_scenario
from sim_heating.inputs.vehicle import add_vehicle_files
from sim_heating.simulation.run import fly_scenario
from sim_heating.simulation.synthesize import synthesize, write_records

COMMAND = "campaign"
RECORDS, CLOSED, FITS, JOINT, TABLES = "records", "closed", "fits", "joint", "tables"
LEDGER = "finished"
"""Folder of finished parts below the results."""
NO_MANOEUVRE = (
    "no flight has a manoeuvre: nothing is fitted, and no table revised; name its manoeuvres in [[manoeuvre]] of the "
    "records, or fly one with [[trajectory.manoeuvre]] of the scenario"
)
STAGES = {"flights": 0.1, "close-loop": 0.55, "fits": 0.75, "joint fits": 0.9, "tables": 1.0}
"""Part of the time by which each stage has ended."""


@dataclass(frozen=True)
class Engine:
    """Where jobs run: a Dask scheduler at an address, or local processes."""

    out: Path
    scheduler: str | None = None
    workers: int | None = None

    def run(
        self,
        stage: str,
        jobs: Sequence[Job],
        work: Callable[[Any], bytes],
        is_current: Callable[[Job, bytes], bool],
        progress: Progress,
    ) -> Outcome:
        """Run the jobs of a stage that are not finished yet."""
        try:
            return run_batches(
                jobs,
                work,
                self.out / LEDGER / stage,
                scheduler=self.scheduler,
                workers=self.workers,
                is_current=is_current,
                progress=progress,
            )
        except KeyboardInterrupt:  # processes that were ended leave what they had begun to write
            files.settle_below(self.out)
            raise


@dataclass(frozen=True)
class FlyTask:
    """A scenario to be flown once and measured once a seed; picklable.

    seeds : None for the scenario's own;  folders : of the records, one a seed
    """

    scenario: str
    seeds: tuple[int | None, ...]
    folders: tuple[str, ...]
    root: Path | None


def run_campaign(
    campaign: Campaign | str | os.PathLike[str],
    out: str | os.PathLike[str],
    *,
    scheduler: str | None = None,
    workers: int | None = None,
    progress: Progress = no_progress,
) -> CampaignResult:
    """Run a campaign and write its results into a directory.

    campaign  : a campaign, or the path of its file
    out       : directory of the results; what is finished there and still current is not done again
    scheduler : address of a Dask scheduler; None for local processes
    workers   : number of local processes; None for one a core
    progress  : called with the fraction done and a line of text
    returns   : the flights, what was found in them, the fits and the revised tables
    raises    : InputError where an input or the directory cannot be used, or a [[fit_of]] means no fit; RunError where
                no flight could be flown
    """
    campaign, out = load_campaign(campaign), Path(out)
    engine = Engine(out, scheduler, workers)
    with files.exclusive(out):
        files.require_writable(out, COMMAND, expected=FILES, inputs=campaign.files)
        flights, checks = _flights(campaign, engine, _stage(progress, "flights"))
        groups = groups_of(flights, campaign.declared.joint.speed_tolerance)
        files.raise_problems(_idle_settings(campaign, flights) if groups else [])
        result = CampaignResult(campaign, out, tuple(flights), frozenset(checks), tuple(groups))
        if not groups:
            result.omitted.append(NO_MANOEUVRE)
        if campaign.declared.close_loop:
            result.closed.extend(_close(result, engine, _stage(progress, "close-loop")))
        carried = _carried(result)
        _fit_singles(result, carried, engine, _stage(progress, "fits"))
        if campaign.declared.joint.fitted:
            _fit_jointly(result, carried, engine, _stage(progress, "joint fits"))
        if campaign.declared.update_tables:
            revise_tables(result, _doubts(result, carried), out / TABLES, _stage(progress, "tables"))
        progress(1.0, "writing")
        with files.output_directory(out, COMMAND, inputs=campaign.files) as folder:
            files.write_json(folder / SUMMARY, result.as_json())
            write_csvs(folder, result)
            if result.walks:
                files.write_text_atomic(folder / NEXT_FLIGHT, next_flight_settings(result.walks))
            write_campaign_page(folder / PAGE, result)
    return result


def _stage(progress: Progress, name: str) -> Progress:
    """Progress of one stage within that of the campaign."""
    ends = [0.0, *STAGES.values()]
    k = list(STAGES).index(name)
    return lambda done, text: progress(ends[k] + (ends[k + 1] - ends[k]) * done, f"{name}: {text}")


# Flights --------------------------------------------------------------------------------------------------------------


def _flights(campaign: Campaign, engine: Engine, progress: Progress) -> tuple[list[CampaignFlight], list[str]]:
    """All flights with their records, and the names of those that only check.

    raises : RunError where a scenario could not be flown
    """
    sources = [f for f in campaign.flights if f.scenarios]
    jobs = [_fly_job(campaign, source, engine.out) for source in sources]
    outcome = engine.run("flights", jobs, _fly, _records_are_there, progress)
    if outcome.failed:
        raise RunError("; ".join(outcome.failed.values()))
    folders = iter(jobs)
    flights, checks = [], []
    for source in campaign.flights:
        directories = next(folders).task.folders if source.scenarios else (str(source.records),)
        read = _read_flights(campaign, directories)
        flights += read
        checks += [f.name for f in read if source.check]
    return flights, checks


def _read_flights(campaign: Campaign, directories: Iterable[str]) -> list[CampaignFlight]:
    """Flights of the records in directories that a campaign selects."""
    paths = [p for directory in directories for p in record_directories(Path(directory))]
    records = [load_record(p, root=campaign.root) for p in paths]
    return flights_of_records([r for r in records if _is_selected(campaign, r)])


def _idle_settings(campaign: Campaign, flights: Sequence[CampaignFlight]) -> list[str]:
    """A line for each [[fit_of]] that means no fit."""
    fits = [(f.name, point, m.name) for f in flights for point in f.records for m in f.manoeuvres]
    names = map(sorted, map(set, zip(*fits, strict=True)))
    known = dict(zip(("flight", "control_point", "manoeuvre"), names, strict=True))
    lines = []
    for i, settings in enumerate(campaign.declared.fit_of, start=1):
        if any(settings.selects(*fit) for fit in fits):
            continue
        stated = {key: name for key in known if (name := getattr(settings, key)) is not None}
        where = f"{files.display_path(campaign.path)}, [[fit_of]] {i}"
        lines += [f"{where}: {reason}" for reason in _reasons_of_no_fit(stated, known)]
    return lines


def _reasons_of_no_fit(stated: Mapping[str, str], known: Mapping[str, Sequence[str]]) -> list[str]:
    """Why no fit has what is stated; known : names that there are, by key."""
    absent = [
        f"`{key}`: there is no {name}{files.suggestion(name, known[key])}"
        for key, name in stated.items()
        if name not in known[key]
    ]
    return absent or [f"{', '.join(f'`{key}`' for key in stated)}: no fit has them together"]


def _is_selected(campaign: Campaign, record: Record) -> bool:
    named = campaign.declared.control_points
    return named is None or record.declared.control_point in named


def _fly_job(campaign: Campaign, source: FlightInput, out: Path) -> Job:
    first = source.scenarios[0]
    digest = hashlib.sha256(package_version().encode())
    for scenario in source.scenarios:
        digest.update(scenario.declared.model_dump_json().encode())
    add_vehicle_files(digest, first.vehicle.directory)
    folders = tuple(str(out / RECORDS / s.flight) for s in source.scenarios)
    task = FlyTask(str(first.path), source.seeds, folders, campaign.root)
    return Job(f"{first.path.stem}-{digest.hexdigest()[:16]}.json", task)


def _fly(task: FlyTask) -> bytes:
    """Fly a scenario and write its records, one folder a seed; the digests of the folders as JSON."""
    scenario = load_scenario(task.scenario, root=task.root)
    flown = fly_scenario(scenario)
    for seed, folder in zip(task.seeds, task.folders, strict=True):
        seeded = scenario if seed is None else with_seed(scenario, seed)
        write_records(seeded, synthesize(seeded, flight=flown), folder)
    return json.dumps([files.results_digest(folder) for folder in task.folders]).encode()


def _records_are_there(job: Job, finished: bytes) -> bool:
    try:
        return bool(json.loads(finished) == [files.results_digest(folder) for folder in job.task.folders])
    except ValueError:
        return False


# Closing the loop -----------------------------------------------------------------------------------------------------


def _close(result: CampaignResult, engine: Engine, progress: Progress) -> list[dict[str, Any]]:
    """Close the loop on every record of the flights that revise tables."""
    rows = []
    for flight in result.fitted_flights:
        paths = [record.directory for record in flight.records.values()]
        closed = close_all(
            paths,
            engine.out / CLOSED / flight.name,
            root=result.campaign.root,
            scheduler=engine.scheduler,
            workers=engine.workers,
            progress=_of_flight(progress, flight, result),
        )
        rows += [
            {**row, "flight": flight.name, "control_point": p} for row, p in zip(closed, flight.records, strict=True)
        ]
    return rows


def _of_flight(progress: Progress, flight: CampaignFlight, result: CampaignResult) -> Progress:
    fitted = result.fitted_flights
    k = fitted.index(flight)
    return lambda done, text: progress((k + done) / len(fitted), f"{flight.name}, {text}")


def _carried(result: CampaignResult) -> dict[tuple[str, str], Carried]:
    """What closing the loop adds to the fits of each (flight, control point)."""
    by_record = {}
    for row in result.closed:
        key = (row["flight"], row["control_point"])
        by_record[key] = (
            Carried() if "failed" in row else read_carried(result.out / CLOSED / row["flight"] / row["record"])
        )
    for point in result.points:
        keys = [key for key in by_record if key[1] == point]
        by_record.update(zip(keys, agreed([by_record[key] for key in keys]), strict=True))
    return by_record


def _doubts(result: CampaignResult, carried: Mapping[tuple[str, str], Carried]) -> dict[tuple[str, str], str]:
    """Why a record should revise no table, by (flight, control point)."""
    return {key: c.doubt for key, c in carried.items() if c.doubt}


# Fits -----------------------------------------------------------------------------------------------------------------


def _segments_of(
    result: CampaignResult, flights: Mapping[str, CampaignFlight], point: str, group: Group
) -> list[tuple[CampaignFlight, Any, FittedSpan | str]]:
    """Flights of a group with a record of a point: each with its manoeuvre and what is fitted, or why nothing is."""
    flown = [(flights[name], m) for name, m in group.members if name in flights]
    return [(f, m, _segment(result, f, m, point)) for f, m in flown if point in f.records]


def _fit_singles(
    result: CampaignResult, carried: Mapping[tuple[str, str], Carried], engine: Engine, progress: Progress
) -> None:
    """Fit every manoeuvre of every flight at every control point."""
    tasks = []
    flights = {f.name: f for f in result.fitted_flights}
    for point in result.points:
        for group in result.groups:
            chosen = []
            for f, m, s in _segments_of(result, flights, point, group):
                if isinstance(s, str):
                    result.omitted.append(f"{f.name}, {point}, {m.name}: {s}")
                else:
                    chosen.append((f, m, s))
            if not chosen:
                continue
            condition = joint_reference([f.records[point].with_fit([[s.begin_s, s.end_s]]) for f, _, s in chosen])
            reference = dict(zip(RATIO_VARIABLES, map(float, condition), strict=True))
            for f, m, span in chosen:
                record, estimates = f.records[point], carried.get((f.name, point), Carried()).estimates
                task = FitTask(
                    point,
                    m.name,
                    group.name,
                    flights=(f.name,),
                    records=(str(record.directory),),
                    segments=((span.begin_s, span.end_s),),
                    out=str(engine.out / FITS / f.name / point / m.name),
                    starts=(span.start,),
                    settings=_as_data(result.campaign.settings(f.name, point, m)),
                    reference=reference,
                    carried=estimates,
                    root=result.campaign.root,
                )
                tasks.append((task, [record]))
    result.fits.extend(_run_fits("fits", tasks, engine, progress))


def _as_data(settings: ManoeuvreSettings) -> dict[str, Any]:
    return settings.model_dump(exclude_unset=True)


def _segment(result: CampaignResult, flight: CampaignFlight, manoeuvre: Any, point: str) -> FittedSpan | str:
    settings = result.campaign.settings(flight.name, point, manoeuvre)
    return fitted_span(flight, flight.records[point], manoeuvre, settings)


def _good_fits(
    result: CampaignResult, point: str, group: Group, carried: Mapping[tuple[str, str], Carried]
) -> list[dict[str, Any]]:
    """Fits of the flights of a group at a control point that are good, of records without a doubt."""
    singles = [r for r in result.fits if r["control_point"] == point and r["group"] == group.name]
    return [r for r in singles if not usable(r) and not carried.get((r["flights"][0], point), Carried()).doubt]


def _joint_task(
    result: CampaignResult,
    point: str,
    group: Group,
    good: Sequence[Mapping[str, Any]],
    carried: Mapping[tuple[str, str], Carried],
    engine: Engine,
) -> tuple[FitTask, list[Record]] | None:
    """The joint fit of good fits of a group and its records; None where a parameter changes from flight to flight."""
    flights = {f.name: f for f in result.flights}
    names = tuple(r["flights"][0] for r in good)
    common = mean_estimates([carried.get((name, point), Carried()).estimates for name in names])
    records = [flights[name].records[point] for name in names]
    first = next(m for name, m in group.members if name == names[0])
    settings = result.campaign.settings(names[0], point, first)
    if ageing := [n for n in settings.parameters or () if n in result.campaign.declared.ageing]:
        result.omitted.append(f"{point}, {group.name}: not fitted jointly, since {', '.join(ageing)} changes")
        return None
    task = FitTask(
        point,
        group.name,
        group.name,
        flights=names,
        records=tuple(str(r.directory) for r in records),
        segments=tuple((s[0], s[1]) for r in good for s in r["segments"]),
        out=str(engine.out / JOINT / point / group.name),
        starts=tuple(s for r in good for s in r["starts"]),
        settings=_as_data(settings),
        reference=good[0]["reference_condition"],
        carried=common,
        root=result.campaign.root,
    )
    return task, records


def _fit_jointly(
    result: CampaignResult, carried: Mapping[tuple[str, str], Carried], engine: Engine, progress: Progress
) -> None:
    """Fit the flights of each group together at every control point, those whose own fit is good."""
    tasks, members = [], []
    for point, group in product(result.points, result.groups):
        good = _good_fits(result, point, group, carried)
        joint = None if len(good) < 2 else _joint_task(result, point, group, good, carried, engine)
        if joint is not None:
            tasks.append(joint)
            members.append(good)
    for row, good in zip(_run_fits("joint fits", tasks, engine, progress), members, strict=True):
        found_agreement = None if "failed" in row else agreement(good, row)
        result.joint.append({**row, "agreement": None if found_agreement is None else vars(found_agreement)})


def _run_fits(
    stage: str, tasks: Sequence[tuple[FitTask, Sequence[Record]]], engine: Engine, progress: Progress
) -> list[dict[str, Any]]:
    """Rows of the fits, in the order of their tasks; one that failed has the reason."""
    jobs = [fit_job(task, records) for task, records in tasks]
    outcome = engine.run(stage, jobs, run_fit, results_are_there, progress)
    rows = []
    for job, (task, _) in zip(jobs, tasks, strict=True):
        identity = {"control_point": task.point, "manoeuvre": task.manoeuvre, "group": task.group}
        row = (
            json.loads(outcome.done[job.id].read_text(encoding="utf-8"))["row"]
            if job.id in outcome.done
            else {"failed": outcome.failed[job.id], "segments": [list(s) for s in task.segments]}
        )
        rows.append({**identity, "flights": list(task.flights), **row, "folder": os.path.relpath(task.out, engine.out)})
    return rows
