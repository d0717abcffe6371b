"""The envelope and the next flight of a study as files, tables and pictures.

If the study names a vehicle `before`, the boundaries of both revisions are compared: what flight data opened or closed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from sim_heating.base.errors import RunError
from sim_heating.base.progress import Progress
from sim_heating.base.report.table import Column, Table
from sim_heating.heating.ratio.uncertainty import Evidence
from sim_heating.inputs.vehicle import vehicle_place
from sim_heating.planning.envelope import envelope, plots
from sim_heating.planning.envelope import tables as files
from sim_heating.planning.envelope.boundary import END_OF_STUDY
from sim_heating.planning.envelope.case import Case, held_alpha
from sim_heating.planning.envelope.next_flight import (
    ManoeuvreForecast,
    RankedManoeuvre,
    forecast_manoeuvre,
    rank_manoeuvres,
)
from sim_heating.planning.envelope.spec import Envelope, EnvelopeBoundary, EnvelopeMap
from sim_heating.planning.members import member_data, member_table
from sim_heating.planning.part import Engine, PartPicture, PartResult, StudyPart
from sim_heating.planning.study import Study, load_study

NOT_TESTABLE = (
    "lateral_cg_m: no manoeuvre holds sideslip long enough; the heating due to a lateral centre of gravity follows "
    "from the ratio tables alone and cannot be tested by a manoeuvre"
)
Draw = Callable[[Path, str], None]
"""Draws a picture: (path, title)."""
RANKING = "next_flight"
MEMBERS = (
    "Margins are by these estimates: a temperature is their mean by weight, and its band is that of their mixture. "
    "At other control points an estimate's weight goes to what the vehicle declares"
)


@dataclass
class _PartOutput:
    """Tables, pictures and notes of a part while it runs."""

    study: Study
    folder: Path
    tables: list[Table] = field(default_factory=list)
    pictures: list[PartPicture] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        (self.folder / envelope.FOLDER).mkdir(exist_ok=True)

    def path(self, name: str) -> Path:
        """Path of a file of the part."""
        return self.folder / envelope.FOLDER / name

    def draw(self, name: str, title: str, draw: Draw) -> None:
        """Draw a picture, with vehicle, revision and study in its title."""
        capitalised = f"{title[:1].upper()}{title[1:]}"
        draw(self.path(f"{name}.png"), f"{capitalised}\n{self.study.title}\n{files.picture_stamp(self.study)}")
        self.pictures.append(PartPicture(f"{envelope.FOLDER}/{name}.png", title))

    def result(self, data: dict[str, Any]) -> PartResult:
        """The result of the part."""
        return PartResult(data, tuple(self.tables), tuple(self.pictures), tuple(dict.fromkeys(self.notes)))


def _envelope_of(study: Study) -> Envelope:
    if study.declared.envelope is None:
        raise RunError(f"{study.path}, [next_flight]: needs an [envelope], whose uncertainty it reduces; add one")
    return study.declared.envelope


# Envelope ------------------------------------------------------------------------------------------------------------


def _guidance_notes(study: Study, cases: Sequence[Case]) -> Iterator[str]:
    """Notes of angles of attack that are held, and of what cannot be tested."""
    guidance = envelope.base_entry(study).guidance
    yield from filter(None, (held_alpha(case, guidance) for case in cases))
    if any(case.lateral_cg_m != 0.0 for case in cases):
        yield NOT_TESTABLE


def envelope_part(study: Study, folder: Path, engine: Engine, progress: Progress) -> PartResult:
    """Compute maps and boundaries of a study; if it names a vehicle `before`, also the boundaries of that one."""
    spec, output = _envelope_of(study), _PartOutput(study, folder)
    sigmas, revision, band = spec.sigmas, files.revision_label(study), _drawn_band(spec)
    flights = envelope.StudyFlights(study, engine, progress, _forecast_evidence(_forecasts(study)))
    data: dict[str, Any] = {
        "sigmas": sigmas,
        "revision": revision,
        "members": member_data(spec.member, study.members("envelope")),
    }
    data |= {"maps": {}, "boundaries": {}}
    if data["members"]:
        output.tables.append(member_table(MEMBERS, data["members"]))
    maps = [envelope.fly_map(declared, flights) for declared in spec.map]
    boundaries = [envelope.fly_boundary(declared, spec, flights) for declared in spec.boundary]
    flights.require_one()
    for flown in maps:
        name, title = _map_file(flown.declared), flown.declared.heading
        files.write_map(output.path(f"{name}.csv"), study, flown)
        output.draw(name, title, partial(plots.draw_map, flown=flown, band=band))
        output.tables.append(files.map_table(flown, study))
        data["maps"][flown.declared.name] = files.map_data(flown, study)
    for boundary in boundaries:
        name, title = _boundary_file(boundary.declared), boundary.declared.heading
        files.write_boundary(output.path(f"{name}.csv"), study, boundary, sigmas)
        output.draw(name, title, partial(plots.draw_boundaries, boundaries={"": boundary}, band=band))
        output.tables.append(files.boundary_table(boundary))
        data["boundaries"][boundary.declared.name] = files.boundary_data(boundary)
    output.notes += files.flight_notes(flights.flown)
    output.notes += _guidance_notes(study, [f.case for f in flights.flown])
    if spec.before is not None and boundaries:
        data["before"] = _compare_with_before(RevisionBoundaries(study, boundaries), spec, engine, progress, output)
    return output.result(data | {"notes": output.notes})


def _drawn_band(spec: Envelope) -> plots.DrawnBand:
    return plots.DrawnBand(spec.sigmas, by_tables=not spec.bands)


def _map_file(declared: EnvelopeMap) -> str:
    return f"map_{declared.name}"


def _boundary_file(declared: EnvelopeBoundary) -> str:
    return f"boundary_{declared.name}"


def _files(study: Study) -> list[str]:
    """Names of all files that the part may write."""
    spec = _envelope_of(study)
    names = [*map(_map_file, spec.map), *map(_boundary_file, spec.boundary)]
    compared = [
        f"{envelope.FOLDER}/{name}"
        for b in spec.boundary
        for name in (f"before_{b.name}.csv", f"before_after_{b.name}.png")
    ]
    return [f"{envelope.FOLDER}/{name}.{kind}" for name in names for kind in ("csv", "png")] + compared


ENVELOPE = StudyPart(envelope_part, _files)


# Before and after ----------------------------------------------------------------------------------------------------

HEADS = ("boundary", "allowed", "before", "after", "opened", "limits before", "limits after")


@dataclass(frozen=True)
class RevisionBoundaries:
    """Boundaries of a study on one revision of its vehicle."""

    study: Study
    boundaries: Sequence[envelope.FlownBoundary]


def _compare_with_before(
    current: RevisionBoundaries, spec: Envelope, engine: Engine, progress: Progress, output: _PartOutput
) -> dict[str, Any]:
    """Fly the boundaries with the vehicle `before` and compare them with those of the study's own vehicle."""
    study, named = current.study, spec.before or ""
    directory = vehicle_place(study.path, named, "[envelope]: `before`", study.root)
    other = load_study(study.path, directory, root=study.root)
    if other.hash == study.hash:
        output.notes.append(f"before: {named} is the vehicle of the study itself; fly another one with --vehicle")
        return {}
    flights = envelope.StudyFlights(other, engine, progress)
    before = RevisionBoundaries(other, [envelope.fly_boundary(b.declared, spec, flights) for b in current.boundaries])
    for earlier, later in zip(before.boundaries, current.boundaries, strict=True):
        name = later.declared.name
        files.write_boundary(output.path(f"before_{name}.csv"), other, earlier, spec.sigmas)
        both = {f"before: {files.picture_stamp(other)}": earlier, f"after: {files.picture_stamp(study)}": later}
        title = f"{later.declared.heading}, before and after"
        draw = partial(plots.draw_boundaries, boundaries=both, band=_drawn_band(spec))
        output.draw(f"before_after_{name}", title, draw)
    table, data = compare_areas(before, current)
    output.tables.append(table)
    return data


def compare_areas(old: RevisionBoundaries, new: RevisionBoundaries) -> tuple[Table, dict[str, Any]]:
    """Allowed areas before and after, as a table and for study.json."""
    rows = [row for pair in zip(old.boundaries, new.boundaries, strict=True) for row in _area_rows(*pair)]
    earlier, later = files.revision_label(old.study), files.revision_label(new.study)
    data = {b.declared.name: files.boundary_data(b) for b in old.boundaries}
    table = Table(f"Area allowed before ({earlier}) and after ({later})", HEADS, rows)
    return table, {"study": old.study.hash, **data}


def _area_rows(old: envelope.FlownBoundary, new: envelope.FlownBoundary) -> list[tuple[str, ...]]:
    """Rows of a boundary: nominal and conservative."""
    rows = []
    for which in (envelope.NOMINAL, envelope.CONSERVATIVE):
        a, b = old.area(which), new.area(which)
        change = f"{b - a:+.3g}" if a == 0.0 else f"{b - a:+.3g} ({100.0 * (b / a - 1.0):+.0f} %)"
        limits = [_limits(x, which) for x in (old, new)]
        rows.append((new.declared.name, which, f"{a:.4g}", f"{b:.4g}", change, *limits))
    return rows


def _limits(boundary: envelope.FlownBoundary, which: str) -> str:
    """Names of all limits that make an edge of a boundary."""
    named = {n.removeprefix(files.CLOSED) for s in boundary.segments for n in files.edge_limits(s, which)}
    return ", ".join(sorted(named - {"", END_OF_STUDY}))


# Next flight ---------------------------------------------------------------------------------------------------------


def next_flight_part(study: Study, folder: Path, engine: Engine, progress: Progress) -> PartResult:
    """Rank the candidates for the next flight; the flights are those of the [envelope], each flown once."""
    spec, forecasts, output = _envelope_of(study), _forecasts(study), _PartOutput(study, folder)
    flights = envelope.StudyFlights(study, engine, progress, _forecast_evidence(forecasts))
    boundaries = [envelope.fly_boundary(declared, spec, flights) for declared in spec.boundary]
    flights.require_one()
    if not boundaries:
        raise RunError(
            f"{study.path}, [next_flight]: needs an [[envelope.boundary]], whose uncertainty it reduces; add one"
        )
    ranked = rank_manoeuvres(forecasts, boundaries, spec.sigmas)
    output.draw(RANKING, "sigma after the next flight", partial(plots.draw_ranking, ranked=ranked))
    output.tables.append(_ranking_table(ranked))
    output.notes += [line for f in forecasts for line in f.notes]
    return output.result(_ranking_data(ranked))


NEXT_FLIGHT = StudyPart(next_flight_part, lambda _: (f"{envelope.FOLDER}/{RANKING}.png",))

_FORECASTS: dict[str, list[ManoeuvreForecast]] = {}
"""Forecasts of the present study by its hash, because both parts need them."""


def _forecasts(study: Study) -> list[ManoeuvreForecast]:
    next_flight = study.declared.next_flight
    if next_flight is None:
        return []
    if study.hash not in _FORECASTS:
        _FORECASTS.clear()
        _FORECASTS[study.hash] = [forecast_manoeuvre(study, candidate) for candidate in next_flight.manoeuvre]
    return _FORECASTS[study.hash]


def _forecast_evidence(forecasts: Sequence[ManoeuvreForecast]) -> envelope.ForecastEvidence:
    by_point: dict[str, dict[str, Evidence]] = {}
    for f in forecasts:
        for point, evidence in f.evidence.items():
            by_point.setdefault(point, {})[f.candidate.name] = evidence
    return by_point


def _ranking_table(ranked: Sequence[RankedManoeuvre]) -> Table:
    names = list(ranked[0].conservative_area)
    heads: list[Column | str] = ["manoeuvre", Column("read at", is_text=True), "sigma reduced by"]
    heads += [
        f"{n}: {quantity}, now -> after" for n in names for quantity in ("sigma at the edges, K", "conservative area")
    ]
    rows = []
    for r in ranked:
        name, points = r.forecast.candidate.name, ", ".join(r.forecast.evidence) or None
        row = [name, points, f"{100.0 * r.sigma_reduction:.0f} %"]
        for n in names:
            sigma, area = r.sigma_K.get(n), r.conservative_area[n]
            row += [None if sigma is None else f"{sigma[0]:.0f} -> {sigma[1]:.0f}"]
            row += [f"{area[0]:.4g} -> {area[1]:.4g}"]
        rows.append(tuple(row))
    return Table("Next flight: manoeuvres by how much they reduce the sigma of the boundaries", heads, rows)


def _ranking_data(ranked: Sequence[RankedManoeuvre]) -> dict[str, Any]:
    return {
        "manoeuvres": [
            {
                "name": r.forecast.candidate.name,
                "sigma_reduction": r.sigma_reduction,
                "sigma_K": r.sigma_K,
                "conservative_area": r.conservative_area,
                "bounds": {p: dict(s) for p, s in r.forecast.sigma.items()},
                "notes": list(r.forecast.notes),
            }
            for r in ranked
        ]
    }
