"""The parts `envelope` and `next_flight` of a study, as `sim-heating plan` runs them.

The boundaries of a study on two revisions of a vehicle side by side: what flight data opened or closed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from sim_heating.base.errors import RunError
from sim_heating.base.progress import Progress
from sim_heating.base.report.table import Table
from sim_heating.heating.ratio.uncertainty import Evidence
from sim_heating.planning.envelope import tables as files
from sim_heating.planning.envelope.boundary import END_OF_STUDY
from sim_heating.planning.envelope.envelope import (
    FOLDER,
    MIDDLE,
    SURE,
    Flights,
    FlownBoundary,
    Informed,
    fly_boundary,
    fly_map,
)
from sim_heating.planning.envelope.next_flight import Prospect, Ranked, prospect, rank
from sim_heating.planning.envelope.spec import Boundary, Envelope, Map
from sim_heating.planning.part import Engine, Found, Part, Picture
from sim_heating.planning.study import Study, load_study

NOT_TESTABLE = (
    "lateral_cg_m: no manoeuvre holds sideslip long enough: what a lateral centre of gravity heats is taken from the "
    "tables alone and is not testable by manoeuvre"
)
Draw = Callable[[Path, str], None]
RANKING = "next_flight"


@dataclass
class _Pages:
    """What a part shows, as it comes."""

    study: Study
    folder: Path
    tables: list[Table] = field(default_factory=list)
    pictures: list[Picture] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        (self.folder / FOLDER).mkdir(exist_ok=True)

    def place(self, name: str) -> Path:
        """Where a file of the part goes."""
        return self.folder / FOLDER / name

    def draw(self, name: str, title: str, draw: Draw) -> None:
        """Draw a picture; its title names vehicle, revision and study."""
        what = f"{title[:1].upper()}{title[1:]}"
        draw(self.place(f"{name}.png"), f"{what}\n{self.study.title}\n{files.stamp_of(self.study)}")
        self.pictures.append(Picture(f"{FOLDER}/{name}.png", title))

    def found(self, data: dict[str, Any]) -> Found:
        """All of it."""
        return Found(data, tuple(self.tables), tuple(self.pictures), tuple(dict.fromkeys(self.notes)))


def _asked(study: Study) -> Envelope:
    if study.declared.envelope is None:
        raise RunError(f"{study.path}, [next_flight]: needs an [envelope] whose uncertainty it is to shrink")
    return study.declared.envelope


def envelope_part(study: Study, folder: Path, engine: Engine, progress: Progress) -> Found:
    """Maps and boundaries of a study, and where it names a vehicle `before`, of that one beside it."""
    from sim_heating.planning.envelope import plots  # matplotlib is slow to import

    asked, pages = _asked(study), _Pages(study, folder)
    flights = Flights(study, engine, progress, _informed(_prospects(study)))
    data: dict[str, Any] = {"sigmas": asked.sigmas, "revision": files.revision_of(study), "maps": {}, "boundaries": {}}
    maps = [fly_map(declared, flights) for declared in asked.map]
    boundaries = [fly_boundary(declared, asked, flights) for declared in asked.boundary]
    flights.require_one()
    for flown in maps:
        name, title = _map_file(flown.declared), flown.declared.title or flown.declared.name
        files.write_map(pages.place(f"{name}.csv"), study, flown)
        pages.draw(name, title, partial(plots.draw_map, flown=flown, sigmas=asked.sigmas))
        pages.tables.append(files.map_table(flown))
        data["maps"][flown.declared.name] = files.map_data(flown)
    for found in boundaries:
        name, title = _boundary_file(found.declared), found.declared.title or found.declared.name
        files.write_boundary(pages.place(f"{name}.csv"), study, found, asked.sigmas)
        pages.draw(name, title, partial(plots.draw_boundaries, found={"": found}, sigmas=asked.sigmas))
        pages.tables.append(files.boundary_table(found))
        data["boundaries"][found.declared.name] = files.boundary_data(found)
    pages.notes += files.notes_of(flights.flown)
    if any(f.case.lateral_cg_m != 0.0 for f in flights.flown):
        pages.notes.append(NOT_TESTABLE)
    if asked.before is not None and boundaries:
        data["before"] = _before(Side(study, boundaries), asked, engine, progress, pages)
    return pages.found(data | {"notes": pages.notes})


def _map_file(declared: Map) -> str:
    return f"map_{declared.name}"


def _boundary_file(declared: Boundary) -> str:
    return f"boundary_{declared.name}"


def _files(study: Study) -> list[str]:
    """All that the part may write."""
    asked = _asked(study)
    names = [*map(_map_file, asked.map), *map(_boundary_file, asked.boundary)]
    sides = [
        f"{FOLDER}/{name}" for b in asked.boundary for name in (f"before_{b.name}.csv", f"before_after_{b.name}.png")
    ]
    return [f"{FOLDER}/{name}.{kind}" for name in names for kind in ("csv", "png")] + sides


ENVELOPE = Part(envelope_part, _files)


def _before(after: Side, asked: Envelope, engine: Engine, progress: Progress, pages: _Pages) -> dict[str, Any]:
    """The same boundaries with the vehicle `before`, beside those of the study's own."""
    from sim_heating.planning.envelope import plots  # matplotlib is slow to import

    study, named = after.study, asked.before or ""
    beside = study.path.parent / named
    other = load_study(study.path, beside if (beside / "vehicle.toml").is_file() else named)
    if other.hash == study.hash:
        pages.notes.append(f"before: {named} is the vehicle of the study itself; fly another one with --vehicle")
        return {}
    flights = Flights(other, engine, progress)
    before = Side(other, [fly_boundary(b.declared, asked, flights) for b in after.boundaries])
    for earlier, later in zip(before.boundaries, after.boundaries, strict=True):
        name = later.declared.name
        files.write_boundary(pages.place(f"before_{name}.csv"), other, earlier, asked.sigmas)
        sides = {f"before: {files.stamp_of(other)}": earlier, f"after: {files.stamp_of(study)}": later}
        title = f"{later.declared.title or name}, before and after"
        pages.draw(f"before_after_{name}", title, partial(plots.draw_boundaries, found=sides, sigmas=asked.sigmas))
    table, data = compare(before, after)
    pages.tables.append(table)
    return data


def next_flight_part(study: Study, folder: Path, engine: Engine, progress: Progress) -> Found:
    """Candidates for the next flight, ranked; the flights are those of the [envelope], each flown once."""
    from sim_heating.planning.envelope import plots  # matplotlib is slow to import

    asked, prospects, pages = _asked(study), _prospects(study), _Pages(study, folder)
    flights = Flights(study, engine, progress, _informed(prospects))
    boundaries = [fly_boundary(declared, asked, flights) for declared in asked.boundary]
    flights.require_one()
    if not boundaries:
        raise RunError(f"{study.path}, [next_flight]: needs an [[envelope.boundary]] whose uncertainty it is to shrink")
    ranked = rank(prospects, boundaries, asked.sigmas)
    pages.draw(RANKING, "what the next flight would tell", partial(plots.draw_ranking, ranked=ranked))
    pages.tables.append(_ranking_table(ranked))
    pages.notes += [line for p in prospects for line in p.notes]
    return pages.found(_ranking_data(ranked))


NEXT_FLIGHT = Part(next_flight_part, lambda _: (f"{FOLDER}/{RANKING}.png",))

_PROSPECTS: dict[str, list[Prospect]] = {}
"""What the candidates of the present study would tell, by its hash: both parts ask."""


def _prospects(study: Study) -> list[Prospect]:
    asked = study.declared.next_flight
    if asked is None:
        return []
    if study.hash not in _PROSPECTS:
        _PROSPECTS.clear()
        _PROSPECTS[study.hash] = [prospect(study, candidate) for candidate in asked.manoeuvre]
    return _PROSPECTS[study.hash]


def _informed(prospects: Sequence[Prospect]) -> Informed:
    told: dict[str, dict[str, Evidence]] = {}
    for p in prospects:
        for point, evidence in p.evidence.items():
            told.setdefault(point, {})[p.candidate.name] = evidence
    return told


def _ranking_table(ranked: Sequence[Ranked]) -> Table:
    names = list(ranked[0].sure)
    heads = ["manoeuvre", "read at", "sigma taken away"]
    heads += [f"{n}: {what}, now -> after" for n in names for what in ("sigma at the edges, K", "surely allowed")]
    rows = []
    for r in ranked:
        row = [r.prospect.candidate.name, ", ".join(r.prospect.evidence) or "-", f"{100.0 * r.shrunk:.0f} %"]
        for n in names:
            sigma = r.sigma_K.get(n)
            row += ["-" if sigma is None else f"{sigma[0]:.0f} -> {sigma[1]:.0f}"]
            row += [f"{r.sure[n][0]:.4g} -> {r.sure[n][1]:.4g}"]
        rows.append(tuple(row))
    return Table("Next flight: manoeuvres by how much of the boundaries' sigma they take away", heads, rows)


def _ranking_data(ranked: Sequence[Ranked]) -> dict[str, Any]:
    return {"manoeuvres": [
        {
            "name": r.prospect.candidate.name, "shrunk": r.shrunk, "sigma_K": r.sigma_K, "sure_area": r.sure,
            "bounds": {p: dict(s) for p, s in r.prospect.sigma.items()}, "notes": list(r.prospect.notes),
        }
        for r in ranked
    ]}  # fmt: skip


HEADS = ("boundary", "allowed", "before", "after", "opened", "limits before", "limits after")


@dataclass(frozen=True)
class Side:
    """A study with its boundaries."""

    study: Study
    boundaries: Sequence[FlownBoundary]


def compare(before: Side, after: Side) -> tuple[Table, dict[str, Any]]:
    """Areas of what is allowed before and after, as a table and for study.json."""
    rows = [row for pair in zip(before.boundaries, after.boundaries, strict=True) for row in _rows(*pair)]
    caption = f"Area allowed before ({files.revision_of(before.study)}) and after ({files.revision_of(after.study)})"
    data = {b.declared.name: files.boundary_data(b) for b in before.boundaries}
    return Table(caption, HEADS, rows), {"study": before.study.hash, **data}


def _rows(before: FlownBoundary, after: FlownBoundary) -> list[tuple[str, ...]]:
    """A boundary as the tables stand, and with them so many sigma hotter."""
    rows = []
    for which, said in ((MIDDLE, "as the tables stand"), (SURE, "surely")):
        a, b = before.area(which), after.area(which)
        change = f"{b - a:+.3g}" if a == 0.0 else f"{b - a:+.3g} ({100.0 * (b / a - 1.0):+.0f} %)"
        limits = [_limits(x, which) for x in (before, after)]
        rows.append((after.declared.name, said, f"{a:.4g}", f"{b:.4g}", change, *limits))
    return rows


def _limits(boundary: FlownBoundary, which: str) -> str:
    named = {n.removeprefix(files.CLOSED) for s in boundary.stretches for n in files.limits_of(s, which)}
    return ", ".join(sorted(named - {"", END_OF_STUDY}))
