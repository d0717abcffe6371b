"""What `sim-heating plan` does: the parts of a study one after the other, and everything they found as files.

A part takes a study and gives a `Found`: plain data for study.json, tables and pictures for the page. A part that fails
is told in one line; what the others found is kept. Linear algebra takes one thread, here and in the batches: the same
study gives the same bytes whatever the number of cores, and whatever the process did before.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from sim_heating.base.errors import InputError, RunError
from sim_heating.base.files import output_directory, write_json
from sim_heating.base.files.package import package_version
from sim_heating.base.parallel import require_scheduler
from sim_heating.base.progress import Progress, quiet
from sim_heating.base.report.page import Page, SavedPicture, Section, write_page
from sim_heating.base.threads import one_thread
from sim_heating.planning.part import Engine, Found, Part
from sim_heating.planning.study import Study

FORMAT = "study-report/1"
SUMMARY, PAGE = "study.json", "report.html"


@dataclass(frozen=True)
class Plan:
    """A study with what its parts found, and which of them failed, in one line each."""

    study: Study
    found: dict[str, Found] = field(default_factory=dict)
    failed: dict[str, str] = field(default_factory=dict)


def parts_of(study: Study) -> dict[str, Part]:
    """The parts that a study asks for, by the names of its tables."""
    from sim_heating.planning.dispersion.report import DISPERSION  # parts know of plans
    from sim_heating.planning.envelope.report import ENVELOPE, NEXT_FLIGHT
    from sim_heating.planning.optimal.report import OPTIMAL

    parts = {"dispersion": DISPERSION, "envelope": ENVELOPE, "next_flight": NEXT_FLIGHT, "optimal": OPTIMAL}
    return {name: part for name, part in parts.items() if getattr(study.declared, name) is not None}


def run_study(study: Study, out: Path, engine: Engine, *, progress: Progress = quiet) -> tuple[Plan, list[str]]:
    """Compute all parts of a study and write their files, all together; gives the files' names as well.

    raises : InputError where the study asks for nothing, a place or scheduler cannot be used, or the one part there is
             says so
    """
    parts = parts_of(study)
    if not parts:
        raise InputError(f"{study.path}: asks for nothing; give it a table such as [dispersion]")
    plan = Plan(study)
    expected = [SUMMARY, PAGE, *(name for part in parts.values() for name in part.files(study))]
    with output_directory(out, expected) as folder, one_thread():
        if engine.scheduler is not None:
            require_scheduler(engine.scheduler)
        for i, (name, part) in enumerate(parts.items()):
            try:
                plan.found[name] = part.run(study, folder, engine, _within(progress, name, i, len(parts)))
            except (InputError, RunError) as error:
                if isinstance(error, InputError) and len(parts) == 1:
                    raise
                plan.failed[name] = str(error)
        write_json(folder / SUMMARY, summary(plan))
        write_page(folder / PAGE, page_of(plan, folder))
        names = sorted(p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_file())
    return plan, names


def _within(progress: Progress, name: str, i: int, parts: int) -> Progress:
    def tell(fraction: float, text: str) -> None:
        progress((i + fraction) / parts, f"{name}: {text}")

    return tell


def summary(plan: Plan) -> dict[str, Any]:
    """study.json."""
    study = plan.study
    return {
        "format": FORMAT,
        "program": f"sim-heating {package_version()}",
        "title": study.title,
        "vehicle": study.vehicle.name,
        "revision": study.vehicle.revision,
        "study": study.hash,
        **{name: dict(found.data) for name, found in plan.found.items()},
        "failed": plan.failed,
    }


def page_of(plan: Plan, folder: Path) -> Page:
    """The page of a study whose files are in a folder."""
    study = plan.study
    sections = [
        Section(
            name.replace("_", " ").capitalize(),
            points=found.notes,
            tables=found.tables,
            pictures=[SavedPicture(folder / p.file, p.caption) for p in found.pictures],
        )
        for name, found in plan.found.items()
    ]
    about = Section(
        "What was asked", text=[line for line in (study.declared.note.strip(), limits_in_words(study)) if line]
    )
    warnings = [f"{name}: {why}" for name, why in plan.failed.items()]
    return Page(study.title, study.stamp, [about, *sections], warnings=warnings)


def limits_in_words(study: Study) -> str:
    """The limits of a study's control points in a sentence."""
    words = [
        f"{p.point.name} {p.surface_K:.0f} K" + ("" if p.bondline_K is None else f", bondline {p.bondline_K:.0f} K")
        for p in study.points
    ]
    return f"Limits: {'; '.join(words)}."
