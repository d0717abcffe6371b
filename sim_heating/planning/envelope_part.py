"""The parts `envelope` and `next_flight` of a study, as `sim-heating plan` runs them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from sim_heating.batches import Progress
from sim_heating.errors import InputError, RunError
from sim_heating.planning import envelope_files as files
from sim_heating.planning.envelope import (
    FOLDER,
    MIDDLE,
    SURE,
    Flights,
    FlownBoundary,
    Informed,
    fly_boundary,
    fly_map,
)
from sim_heating.planning.envelope_spec import Envelope
from sim_heating.planning.next_flight import Prospect, Ranked, prospect, rank
from sim_heating.planning.plan import Engine, Found, Picture, Table
from sim_heating.planning.study import Study, load_study
from sim_heating.table_update.posterior import Evidence

NOT_TESTABLE = (
    "lateral_cg_m: sideslip cannot be held long enough by a manoeuvre: the lateral centre of gravity is evaluated from the "
    "tables alone and is not testable by manoeuvre"
)


def envelope_part(study: Study, folder: Path, engine: Engine, progress: Progress) -> Found:
    """Maps and boundaries of a study, and where it names a vehicle `before`, of that one beside it."""
    asked = _asked(study)
    flights = Flights(study, engine, progress, _informed(_prospects(study)))
    (folder / FOLDER).mkdir()
    tables, pictures, data = [], [], dict[str, Any](maps={}, boundaries={})
    for declared in asked.map:
        flown = fly_map(declared, flights)
        name, title = f"map_{declared.name}", declared.title or declared.name
        files.write_map(folder / FOLDER / f"{name}.csv", study, flown)
        pictures.append(
            _picture(
                study, folder, name, title, lambda path, head, f=flown: _plots().draw_map(path, head, f, asked.sigmas)
            )
        )
        tables.append(files.map_table(flown))
        data["maps"][declared.name] = files.map_data(flown)
    boundaries = [fly_boundary(declared, asked, flights) for declared in asked.boundary]
    for found in boundaries:
        name, title = f"boundary_{found.declared.name}", found.declared.title or found.declared.name
        files.write_boundary(folder / FOLDER / f"{name}.csv", study, found, asked.sigmas)
        pictures.append(
            _picture(
                study,
                folder,
                name,
                title,
                lambda path, head, b=found: _plots().draw_boundaries(path, head, {"": b}, asked.sigmas),
            )
        )
        tables.append(files.boundary_table(found))
        data["boundaries"][found.declared.name] = files.boundary_data(found)
    notes = list(files.notes_of(flights.flown))
    if any(f.case.lateral_cg_m != 0.0 for f in flights.flown):
        notes.append(NOT_TESTABLE)
    if asked.before is not None:
        compared = _compared(study, asked, boundaries, folder, engine, progress)
        tables += compared.tables
        pictures += compared.pictures
        notes += compared.notes
        data["before"] = compared.data
    data |= {"sigmas": asked.sigmas, "revision": files.revision_of(study), "notes": notes}
    return Found(data, tuple(tables), tuple(pictures), tuple(notes))


def next_flight_part(study: Study, folder: Path, engine: Engine, progress: Progress) -> Found:
    """Candidates for the next flight, ranked; needs the boundaries of an [envelope], whose flights are flown once."""
    asked, prospects = _asked(study), _prospects(study)
    flights = Flights(study, engine, progress, _informed(prospects))
    boundaries = [fly_boundary(declared, asked, flights) for declared in asked.boundary]
    if not boundaries:
        raise RunError(f"{study.path}, [next_flight]: needs an [[envelope.boundary]] whose uncertainty it is to shrink")
    ranked = rank(prospects, boundaries, asked.sigmas)
    (folder / FOLDER).mkdir(exist_ok=True)
    title = "What the next flight would tell"
    picture = _picture(
        study, folder, "next_flight", title, lambda path, head: _plots().draw_ranking(path, head, ranked)
    )
    notes = tuple(line for p in prospects for line in p.notes)
    return Found(_ranking_data(ranked), (_ranking_table(ranked),), (picture,), notes)


def _plots() -> Any:
    from sim_heating.planning import envelope_plots  # matplotlib is slow to import, and wanted only here

    return envelope_plots


def _picture(study: Study, folder: Path, name: str, title: str, draw: Any) -> Picture:
    file = f"{FOLDER}/{name}.png"
    draw(folder / file, f"{study.title}: {title}\n{files.stamp_of(study)}")
    return Picture(file, title)


def _asked(study: Study) -> Envelope:
    if study.declared.envelope is None:
        raise RunError(f"{study.path}, [next_flight]: needs an [envelope] whose uncertainty it is to shrink")
    return study.declared.envelope


# Two revisions -------------------------------------------------------------------------------------------------------


def _compared(
    study: Study, asked: Envelope, after: list[FlownBoundary], folder: Path, engine: Engine, progress: Progress
) -> Found:
    """The same boundaries with another vehicle, and how much was opened or closed since."""
    assert asked.before is not None
    beside = study.path.parent / asked.before
    other = load_study(study.path, beside if (beside / "vehicle.toml").is_file() else asked.before)
    if other.hash == study.hash:
        return Found({}, notes=(f"before: {asked.before} is the vehicle of the study itself; nothing to compare",))
    flights = Flights(other, engine, progress)
    rows, pictures, data = [], [], dict[str, Any]()
    for later in after:
        earlier = fly_boundary(later.declared, asked, flights)
        name = later.declared.name
        files.write_boundary(folder / FOLDER / f"before_{name}.csv", other, earlier, asked.sigmas)
        sides = {f"before: {files.revision_of(other)}": earlier, f"after: {files.revision_of(study)}": later}
        title = f"{later.declared.title or name}, before and after"
        pictures.append(_picture(
            study, folder, f"before_after_{name}", title,
            lambda path, head, s=sides: _plots().draw_boundaries(path, f"{head}, before: study {other.hash}", s, asked.sigmas),
        ))  # fmt: skip
        rows += comparison_rows(earlier, later)
        data[name] = {"study": other.hash, **files.boundary_data(earlier)}
    heads = ("boundary", "allowed", "before", "after", "opened", "limits before", "limits after")
    table = Table("Before and after: areas of what is allowed", heads, tuple(rows))
    return Found(data, (table,), tuple(pictures))


def comparison_rows(before: FlownBoundary, after: FlownBoundary) -> list[tuple[str, ...]]:
    """For a boundary: area before, after, and the change, as the tables stand and with them so many sigma hotter."""
    rows = []
    for which in (MIDDLE, SURE):
        a, b = before.area(which), after.area(which)
        change = f"{b - a:+.3g}" if a == 0.0 else f"{b - a:+.3g} ({100.0 * (b / a - 1.0):+.0f} %)"
        limits = [
            ", ".join(sorted({n for s in x.stretches for n in files.limits_of(s, which)} - {""}))
            for x in (before, after)
        ]
        said = "as the tables stand" if which == MIDDLE else "surely"
        rows.append((after.declared.name, said, f"{a:.4g}", f"{b:.4g}", change, *limits))
    return rows


# Next flight ---------------------------------------------------------------------------------------------------------


def _prospects(study: Study) -> list[Prospect]:
    asked = study.declared.next_flight
    if asked is None:
        return []
    unknown = [n for c in asked.manoeuvre for n in c.control_points if n not in study.base.names]
    if unknown:
        raise InputError(f"{study.path}, [next_flight]: `{unknown[0]}` is not among the study's control points; add it")
    return [prospect(study, candidate) for candidate in asked.manoeuvre]


def _informed(prospects: list[Prospect]) -> Informed:
    told: dict[str, dict[str, Evidence]] = {}
    for p in prospects:
        for point, evidence in p.evidence.items():
            told.setdefault(point, {})[p.candidate.name] = evidence
    return told


def _ranking_table(ranked: list[Ranked]) -> Table:
    names = list(ranked[0].band)
    heads = ("manoeuvre", "read at", "band taken away", *(f"{n}: surely allowed, now -> after" for n in names))
    rows = tuple(
        (
            r.prospect.candidate.name, ", ".join(r.prospect.evidence) or "-", f"{100.0 * r.shrunk:.0f} %",
            *(f"{r.sure[n][0]:.4g} -> {r.sure[n][1]:.4g}" for n in names),
        )
        for r in ranked
    )  # fmt: skip
    return Table("Next flight: manoeuvres by how much of the boundaries' bands they would take away", heads, rows)


def _ranking_data(ranked: list[Ranked]) -> dict[str, Any]:
    return {"manoeuvres": [
        {
            "name": r.prospect.candidate.name, "shrunk": r.shrunk, "band_area": r.band, "sure_area": r.sure,
            "sigma": {p: dict(s) for p, s in r.prospect.sigma.items()}, "notes": list(r.prospect.notes),
        }
        for r in ranked
    ]}  # fmt: skip
