"""Maps and boundaries of an envelope as CSV files, as plain values for study.json, and as tables for the page."""

from __future__ import annotations

from collections.abc import Sequence
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np

from sim_heating.base.files import write_csv
from sim_heating.base.report.table import Column, Table
from sim_heating.closure.revise.revisions import FOLDER as REVISIONS
from sim_heating.planning.envelope import envelope
from sim_heating.planning.envelope.boundary import GreatestValue
from sim_heating.planning.envelope.margins import BONDLINE, ELEVON, SURFACE, TABLE, EvaluatedCase
from sim_heating.planning.study import Study

KINDS = (envelope.NOMINAL, envelope.CONSERVATIVE, envelope.OPTIMISTIC)
"""Kinds of a boundary, in the order of CSV columns."""
NOTHING = "nothing allowed"
CLOSED = f"{NOTHING}: "
"""Stands before the limit that closes a segment."""


def revision_label(study: Study) -> str:
    """Revision of the vehicle, and its ratio tables that were revised after flights."""
    revised = _revised_tables(study)
    return f"revision {study.vehicle.revision}" + (f" with tables {', '.join(revised)}" if revised else "")


def _revised_tables(study: Study) -> list[str]:
    return [
        f"{name} {p.ratio.header.get('revision', '?')}"
        for name, p in study.vehicle.control_points.items()
        if (study.vehicle.directory / REVISIONS / name).is_dir()
    ]


def picture_stamp(study: Study) -> str:
    """Vehicle, revision and study for a picture, with the number of revised tables; the CSV files name them."""
    count = len(_revised_tables(study))
    tables = f" with {count} revised table{'s' if count > 1 else ''}" if count else ""
    return f"{study.vehicle.name}, revision {study.vehicle.revision}{tables}, study {study.hash}"


def csv_header(study: Study, title: str) -> dict[str, str]:
    """Header of a CSV file: title, study, vehicle, revision."""
    return {
        "title": title,
        "study": f"{study.title}, {study.hash}",
        "vehicle": study.vehicle.name,
        "revision": revision_label(study),
    }


# Maps ----------------------------------------------------------------------------------------------------------------


def write_map(path: Path, study: Study, flown: envelope.FlownMap) -> None:
    """Write a map as CSV, one row for each place and control point; a place that could not be flown has empty cells."""
    rows: list[dict[str, Any]] = []
    count = 4 if has_bands(study) else 3
    for position, flight in zip(flown.positions, flown.flights, strict=True):
        for limited in study.points:
            name = limited.point.name
            row: dict[str, Any] = {**position, "control_point": name, "cross_range_km": flight.cross_range_km}
            for kind in (SURFACE, BONDLINE):
                m = flight.margins.get(f"{name} {kind}")
                numbers = (np.nan,) * 4 if m is None else (m.value, m.sigma, m.margin, m.at_band)
                keys = (f"peak_{kind}_K", f"{kind}_sigma_K", f"{kind}_margin_K", f"{kind}_margin_at_band_K")
                row |= dict(zip(keys[:count], numbers, strict=False))
            row["remarks"] = flight.error or "; ".join(o for o in flight.outside if o.startswith(name))
            rows.append(row)
    columns = {key: np.array([*map(itemgetter(key), rows)]) for key in rows[0]}
    write_csv(path, columns, ".6g", csv_header(study, flown.declared.heading))


def has_bands(study: Study) -> bool:
    """Whether the sigma of a study's temperatures is by all that is uncertain: margins are then stated at the band."""
    spec = study.declared.envelope
    return spec is not None and spec.bands


def map_data(flown: envelope.FlownMap, study: Study) -> dict[str, Any]:
    """A map for study.json."""
    return {
        "axes": flown.declared.axes,
        "flights": [
            {
                "entry": flown.declared.entry(position),
                "at": position,
                **flight_data(flight, bands=has_bands(study)),
            }
            for position, flight in zip(flown.positions, flown.flights, strict=True)
        ],
    }


def flight_data(flight: EvaluatedCase, *, bands: bool) -> dict[str, Any]:
    """A flight for study.json: temperatures, violated limits, where it leaves the ratio tables.

    bands : whether margins are stated at the 95 % band as well
    """
    if flight.error is not None:
        return {"error": flight.error}
    hot = {n: m for n, m in flight.margins.items() if m.unit == "K"}
    quantities = {"peaks_K": "value", "sigma_K": "sigma", "margins_K": "margin", "margins_at_band_K": "at_band"}
    if not bands:
        del quantities["margins_at_band_K"]
    return {
        "cross_range_km": flight.cross_range_km,
        "duration_s": flight.duration_s,
        **{key: {n: getattr(m, quantity) for n, m in hot.items()} for key, quantity in quantities.items()},
        "violated": [n for n, m in flight.margins.items() if m.margin < 0.0],
        "outside_table": list(flight.outside),
    }


def map_table(flown: envelope.FlownMap, study: Study) -> Table:
    """The margin that matters most of each entry of a map (`EvaluatedCase.least`), at the 95 % band too where it has
    one."""
    rows, bands = list[tuple[str, ...]](), has_bands(study)
    for position, flight in zip(flown.positions, flown.flights, strict=True):
        entry = flown.declared.entry(position)
        least = flight.least
        if flight.error is not None or least is None:
            rows.append((entry, "", flight.error or "no limit", "", *([""] if bands else [])))
            continue
        name, m = least
        at_band = [f"{m.at_band:.1f} {m.unit}"] if bands else []
        rows.append((entry, f"{m.margin:.1f} {m.unit}", name, f"{m.sigma:.1f} {m.unit}", *at_band))
    title = flown.declared.heading
    heads: list[Column | str] = ["entry", "least margin", Column("limit", is_text=True), "sigma"]
    heads += ["margin at the 95 % band"] if bands else []
    return Table(f"Map: {title}", heads, rows)


# Boundaries ----------------------------------------------------------------------------------------------------------


def edge_limits(segment: envelope.BoundarySegment, which: str = envelope.NOMINAL) -> tuple[str, str]:
    """Limits that make the low and the high end of a segment, or the limit that closes it."""
    greatest = segment.greatest.get(which)
    if isinstance(greatest, GreatestValue):
        return "", greatest.limit
    allowed = segment.allowed[which]
    if segment.greatest or allowed.low is None or allowed.high is None:
        why = NOTHING if allowed.least_violated is None else f"{CLOSED}{allowed.least_violated.limit}"
        return why, why
    return allowed.low.limit, allowed.high.limit


def boundary_rows(boundary: envelope.FlownBoundary) -> list[dict[str, Any]]:
    """One row for each segment; its ends are NaN where nothing is allowed."""
    rows, declared = [], boundary.declared
    for s in boundary.segments:
        low_limit, high_limit = edge_limits(s)
        row: dict[str, Any] = {} if declared.family is None else {declared.family: s.member}
        row |= {declared.along: s.position, "low_limit": low_limit, "high_limit": high_limit}
        if s.speed_m_s is not None:
            row["velocity_m_s"] = s.speed_m_s
        for which in KINDS:
            low, high = s.ends(which)
            row[f"low_{which}"] = np.nan if low is None else low
            row[f"high_{which}"] = np.nan if high is None else high
        rows.append(row)
    return rows


def write_boundary(path: Path, study: Study, boundary: envelope.FlownBoundary, sigmas: float) -> None:
    """Write a boundary as CSV: nominal, conservative (tables hotter by a number of sigma), optimistic (cooler)."""
    rows, declared = boundary_rows(boundary), boundary.declared
    columns = {key: np.array([r[key] for r in rows]) for key in rows[0]}
    header = csv_header(study, declared.heading)
    header |= {
        "across": declared.sought,
        "band": f"{sigmas:g} sigma of the ratio tables",
    }
    write_csv(path, columns, ".6g", header)


def boundary_data(boundary: envelope.FlownBoundary) -> dict[str, Any]:
    """A boundary for study.json."""
    rows = [{k: None if v != v else v for k, v in row.items()} for row in boundary_rows(boundary)]
    areas = {which: boundary.area(which) for which in KINDS}
    return {"across": boundary.declared.sought, "area": areas, "segments": rows}


def boundary_table(boundary: envelope.FlownBoundary) -> Table:
    """A boundary for the page."""
    d = boundary.declared
    limits_head = Column("limits", is_text=True)
    named = [d.along] if d.family is None else [d.family, d.along]
    heads: list[Column | str] = [*named, "allowed", limits_head, envelope.CONSERVATIVE, envelope.OPTIMISTIC]
    rows = []
    for s in boundary.segments:
        low, high = edge_limits(s)
        limits = high if s.greatest or low == high else f"{low} | {high}"
        member = () if d.family is None else (f"{s.member:g}",)
        nominal, conservative, optimistic = (_interval(s, which) for which in KINDS)
        rows.append((*member, f"{s.position:g}", nominal, limits, conservative, optimistic))
    return Table(f"Boundary: {d.heading}, {d.sought}", heads, rows)


def _interval(segment: envelope.BoundarySegment, which: str) -> str:
    low, high = segment.ends(which)
    if low is None or high is None:
        return "-"
    return f"{high:.4g}" if segment.greatest else f"{low:.4g} to {high:.4g}"


def flight_notes(flights: Sequence[EvaluatedCase]) -> tuple[str, ...]:
    """Notes on the flights: those that could not be flown, those without trim, and those that left a ratio table."""
    failed = [f"not flown: {f.error}" for f in flights if f.error is not None]
    by_end: dict[str, list[EvaluatedCase]] = {}
    for flight in flights:
        for name, m in flight.other_violations:
            if m.kind == TABLE:
                by_end.setdefault(name, []).append(flight)
    outside = [_excursion_note(name, excursions) for name, excursions in sorted(by_end.items())]
    return tuple(dict.fromkeys([*failed, *_trim_notes(flights), *outside]))


def _trim_notes(flights: Sequence[EvaluatedCase]) -> list[str]:
    no_trim = [f for f in flights if any(m.kind == ELEVON for _, m in f.other_violations)]
    if not no_trim:
        return []
    first = no_trim[0].case.describe()
    return [f"no trim within the elevon's travel: {len(no_trim)} flights, first {first}; not allowed"]


def _excursion_note(name: str, flights: Sequence[EvaluatedCase]) -> str:
    """Number of flights outside one end of a ratio table, and their largest distance from it."""
    farthest = min(flights, key=lambda f: f.margins[name].margin)
    m = farthest.margins[name]
    by = f"by {-m.margin:.3g} {m.unit}".rstrip()
    return f"outside the {name}: {len(flights)} flights, {by} at most ({farthest.case.describe()}); not allowed"
