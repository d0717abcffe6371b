"""Run a study, as `sim-heating plan` does: its parts one after the other, and their results as files.

A part computes a `PartResult` from a study: plain data for study.json, tables and pictures for the page. A part that
fails is reported in one line, and the results of the others are kept. Linear algebra uses one thread, here and in the
batches: a study gives the same bytes whatever the number of cores, and whatever the process did before.
"""

from __future__ import annotations

import os
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from sim_heating.base.errors import InputError, RunError
from sim_heating.base.files import output_directory, write_json
from sim_heating.base.files.package import package_version
from sim_heating.base.parallel.batches import require_scheduler
from sim_heating.base.parallel.threads import one_thread
from sim_heating.base.progress import Progress, no_progress
from sim_heating.base.report.page import Page, SavedPicture, Section, write_page
from sim_heating.credibility.facts.of_flight import facts_of_study
from sim_heating.credibility.section import credibility_section
from sim_heating.credibility.statement import NOT_LOOKED_AT, Facts, Statement, assess
from sim_heating.planning.dispersion.report import DISPERSION, with_dispersion
from sim_heating.planning.envelope.case import BASE_ENTRY
from sim_heating.planning.envelope.report import ENVELOPE, NEXT_FLIGHT
from sim_heating.planning.optimal.report import OPTIMAL
from sim_heating.planning.part import Engine, PartResult, StudyPart
from sim_heating.planning.study import Study, load_study
from sim_heating.simulation.run import run

FORMAT = "study-report/1"
SUMMARY, PAGE = "study.json", "report.html"
LEDGER = "batches"
"""Folder of finished batches below the results."""


@dataclass(frozen=True, repr=False)
class Plan:
    """A study with the results of its parts.

    results : of each part that succeeded, by the name of its table in the study
    failed  : why a part failed, one line each, by the name of its table
    files   : names of the files that were written
    """

    study: Study
    results: dict[str, PartResult] = field(default_factory=dict)
    failed: dict[str, str] = field(default_factory=dict)
    files: tuple[str, ...] = ()

    @cached_property
    def credibility(self) -> Statement:
        """What supports the results, factor by factor."""
        samples = [s for result in self.results.values() for s in result.samples]
        topics = [t for result in self.results.values() for t in result.topics]
        facts = facts_of_study(self.study.base, self.study.files, samples, topics)
        if not samples:
            facts = self._with_base_entry(facts)
        dispersion = self.results.get("dispersion")
        return assess(facts if dispersion is None else with_dispersion(facts, dispersion.data))

    def _with_base_entry(self, facts: Facts) -> Facts:
        """Facts with the conditions and temperatures of the base entry, which is flown once; as they are where it
        cannot be flown."""
        try:
            flown = run(self.study.base).facts()
        except (InputError, RunError):
            return facts
        # The maps of a study state margins of other entries beside these.
        stated, kept = flown.uncertainty, flown.holds
        return replace(
            facts,
            samples=flown.samples,
            mesh_error_K=flown.mesh_error_K,
            uncertainty=None if stated is None else replace(stated, quantity=f"{stated.quantity} in the {BASE_ENTRY}"),
            holds=kept if kept == NOT_LOOKED_AT else replace(kept, text=f"{BASE_ENTRY}, as `run` has it: {kept.text}"),
        )

    def __repr__(self) -> str:
        failed = f", failed: {', '.join(self.failed)}" if self.failed else ""
        return f"<Plan {self.study.title!r}: {', '.join(self.results) or 'no result'}{failed}>"


def parts_of(study: Study) -> dict[str, StudyPart]:
    """The parts that a study asks for, by the names of its tables."""
    parts = {"dispersion": DISPERSION, "envelope": ENVELOPE, "next_flight": NEXT_FLIGHT, "optimal": OPTIMAL}
    return {name: study_part for name, study_part in parts.items() if getattr(study.declared, name) is not None}


def _files_in(folder: Path) -> list[str]:
    return [p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_file()]


def plan(
    study: Study | str | os.PathLike[str],
    out: str | os.PathLike[str],
    *,
    vehicle: str | os.PathLike[str] | None = None,
    scheduler: str | None = None,
    workers: int | None = None,
    progress: Progress = no_progress,
) -> Plan:
    """Compute all parts of a study and write their files.

    study     : a study, or the path of its file
    out       : directory for the results; finished batches are kept below it and are not computed again
    vehicle   : name or directory of a vehicle to fly instead of the study's own
    scheduler : address of a Dask scheduler; otherwise local processes
    workers   : number of local processes; one a core where not given
    progress  : called with the fraction done, from 0 to 1, and a line of text
    returns   : the result of each part, or why it failed
    raises    : InputError where the study has no part, a directory or scheduler cannot be used, or its only part
                fails for its input

    >>> from tempfile import TemporaryDirectory
    >>> import sim_heating as sh
    >>> with TemporaryDirectory() as folder:
    ...     planned = sh.plan("scenarios/studies/small_envelope.toml", f"{folder}/plan", workers=1)
    >>> planned
    <Plan 'A small envelope, for a first look': envelope, next_flight>
    """
    study, out = load_study(study, vehicle), Path(out)
    engine = Engine(out / LEDGER, scheduler, workers)
    parts = parts_of(study)
    if not parts:
        raise InputError(f"{study.path}: has no table that asks for a result; add one, such as [dispersion]")
    done = Plan(study)
    expected = [SUMMARY, PAGE, *(name for study_part in parts.values() for name in study_part.files(study))]
    # One thread for linear algebra: its split among threads changes last digits, and results are to be the same bytes
    # on any number of cores.
    seed = None if study.declared.dispersion is None else study.declared.dispersion.seed
    with (
        output_directory(out, "plan", expected=expected, inputs=study.files, seed=seed) as folder,
        one_thread(),
    ):
        if engine.scheduler is not None:
            require_scheduler(engine.scheduler)
        for i, (name, study_part) in enumerate(parts.items()):
            try:
                done.results[name] = study_part.run(study, folder, engine, _within(progress, name, i, len(parts)))
            except (InputError, RunError) as error:
                # A part that fails does not take the results of the others with it.
                if isinstance(error, InputError) and len(parts) == 1:
                    raise
                done.failed[name] = str(error)
        # The same object is written and returned: its credibility flies the base entry, once.
        done = replace(done, files=tuple(sorted({*_files_in(folder), SUMMARY, PAGE})))
        write_json(folder / SUMMARY, summary(done))
        write_page(folder / PAGE, lambda: page_of(done, folder))
    return done


def _within(progress: Progress, name: str, i: int, parts: int) -> Progress:
    def report(fraction: float, text: str) -> None:
        progress((i + fraction) / parts, f"{name}: {text}")

    return report


def summary(plan: Plan) -> dict[str, Any]:
    """Contents of study.json."""
    study = plan.study
    return {
        "format": FORMAT,
        "program": f"sim-heating {package_version()}",
        "title": study.title,
        "vehicle": study.vehicle.name,
        "revision": study.vehicle.revision,
        "study": study.hash,
        **{name: dict(result.data) for name, result in plan.results.items()},
        "failed": plan.failed,
        "credibility": plan.credibility.as_json(),
    }


def page_of(plan: Plan, folder: Path) -> Page:
    """The page of a study whose files are in a folder."""
    study = plan.study
    sections = [
        Section(
            name.replace("_", " ").capitalize(),
            points=result.notes,
            tables=result.tables,
            pictures=[SavedPicture(folder / p.file, p.caption) for p in result.pictures],
            charts=result.charts,
        )
        for name, result in plan.results.items()
    ]
    about = Section("Study", text=[line for line in (study.declared.note.strip(), limit_sentence(study)) if line])
    warnings = [f"{name}: {why}" for name, why in plan.failed.items()]
    last = credibility_section(plan.credibility.as_json())
    return Page(study.title, study.stamp, [about, *sections, last], warnings=warnings)


def limit_sentence(study: Study) -> str:
    """The temperature limits of a study's control points in a sentence."""
    limits = [
        f"{p.point.name} {p.surface_K:.0f} K" + ("" if p.bondline_K is None else f", bondline {p.bondline_K:.0f} K")
        for p in study.points
    ]
    return f"Limits: {'; '.join(limits)}."
