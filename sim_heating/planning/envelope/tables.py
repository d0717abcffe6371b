"""Maps and boundaries of an envelope as data and tables: CSV for programs, plain values for study.json, rows for a
page."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from sim_heating.base.files import write_csv
from sim_heating.base.report.table import Table
from sim_heating.closure.revise.revisions import FOLDER as REVISIONS
from sim_heating.planning.envelope.boundary import Allowed, Greatest
from sim_heating.planning.envelope.envelope import MIDDLE, PERHAPS, SURE, FlownBoundary, FlownMap, Stretch
from sim_heating.planning.envelope.margins import BONDLINE, ELEVON, SURFACE, TABLE, Evaluated
from sim_heating.planning.study import Study

WHICH = (MIDDLE, SURE, PERHAPS)
NOTHING = "nothing allowed"
CLOSED = f"{NOTHING}: "


def revision_of(study: Study) -> str:
    """The vehicle's revision, with the tables of it that flight data have revised."""
    revised = _revised(study)
    return f"revision {study.vehicle.revision}" + (f" with tables {', '.join(revised)}" if revised else "")


def _revised(study: Study) -> list[str]:
    return [
        f"{name} {p.ratio.header.get('revision', '?')}"
        for name, p in study.vehicle.control_points.items()
        if (study.vehicle.directory / REVISIONS / name).is_dir()
    ]


def stamp_of(study: Study) -> str:
    """What every picture names: how many tables are revised, and not which; the files beside it say."""
    count = len(_revised(study))
    told = f" with {count} revised table{'s' if count > 1 else ''}" if count else ""
    return f"{study.vehicle.name}, revision {study.vehicle.revision}{told}, study {study.hash}"


def about(study: Study, title: str) -> dict[str, str]:
    """Head of a CSV file."""
    return {
        "title": title, "study": f"{study.title}, {study.hash}", "vehicle": study.vehicle.name,
        "revision": revision_of(study),
    }  # fmt: skip


# Maps ----------------------------------------------------------------------------------------------------------------


def write_map(path: Path, study: Study, flown: FlownMap) -> None:
    """One row for each place and control point; a place that could not be flown has empty cells."""
    rows: list[dict[str, Any]] = []
    for place, flight in zip(flown.places, flown.flights, strict=True):
        for limited in study.points:
            name = limited.point.name
            row: dict[str, Any] = {**place, "control_point": name, "cross_range_km": flight.cross_range_km}
            for kind in (SURFACE, BONDLINE):
                m = flight.margins.get(f"{name} {kind}")
                row |= {
                    f"peak_{kind}_K": np.nan if m is None else m.value,
                    f"{kind}_sigma_K": np.nan if m is None else m.sigma,
                    f"{kind}_margin_K": np.nan if m is None else m.margin,
                }
            row["told"] = flight.error or "; ".join(o for o in flight.outside if o.startswith(name))
            rows.append(row)
    columns = {key: np.array([r[key] for r in rows]) for key in rows[0]}
    write_csv(path, columns, ".6g", about(study, flown.declared.title or flown.declared.name))


def map_data(flown: FlownMap) -> dict[str, Any]:
    """A map for study.json."""
    return {
        "axes": flown.declared.axes,
        "flights": [
            {"at": place, **flight_data(flight)} for place, flight in zip(flown.places, flown.flights, strict=True)
        ],
    }


def flight_data(flight: Evaluated) -> dict[str, Any]:
    """A flight for study.json: temperatures, the limits passed, where it leaves the tables."""
    if flight.error is not None:
        return {"error": flight.error}
    hot = {n: m for n, m in flight.margins.items() if m.unit == "K"}
    return {
        "cross_range_km": flight.cross_range_km,
        "duration_s": flight.duration_s,
        "peaks_K": {n: m.value for n, m in hot.items()},
        "sigma_K": {n: m.sigma for n, m in hot.items()},
        "margins_K": {n: m.margin for n, m in hot.items()},
        "passed": [n for n, m in flight.margins.items() if m.margin < 0.0],
        "outside_table": list(flight.outside),
    }


def map_table(flown: FlownMap) -> Table:
    """The least margin at each place."""
    rows = []
    for place, flight in zip(flown.places, flown.flights, strict=True):
        at = tuple(f"{v:g}" for v in place.values())
        least = flight.least
        if flight.error is not None or least is None:
            rows.append((*at, "", flight.error or "no limit", ""))
            continue
        name, m = least
        rows.append((*at, f"{m.margin:.1f} {m.unit}", name, f"{m.sigma:.1f} {m.unit}"))
    title = flown.declared.title or flown.declared.name
    heads = (*flown.declared.axes, "least margin", "limit", "sigma")
    return Table(f"Map: {title}", heads, rows)


# Boundaries ----------------------------------------------------------------------------------------------------------


def limits_of(stretch: Stretch, which: str = MIDDLE) -> tuple[str, str]:
    """What makes the low and the high end."""
    found: Allowed | Greatest | None = stretch.greatest[which] if stretch.greatest else stretch.allowed[which]
    if isinstance(found, Greatest):
        return "", found.limit
    closed = stretch.allowed[which]
    if found is None or closed.low is None or closed.high is None:
        why = NOTHING if closed.least_bad is None else f"{CLOSED}{closed.least_bad.limit}"
        return why, why
    return closed.low.limit, closed.high.limit


def boundary_rows(found: FlownBoundary) -> list[dict[str, Any]]:
    """One row for each stretch; what is not allowed is NaN."""
    rows = []
    for s in found.stretches:
        low_limit, high_limit = limits_of(s)
        row: dict[str, Any] = {} if found.declared.family is None else {found.declared.family: s.member}
        row |= {found.declared.along: s.along, "low_limit": low_limit, "high_limit": high_limit}
        if s.speed_m_s is not None:
            row["velocity_m_s"] = s.speed_m_s
        for which in WHICH:
            low, high = s.value(which)
            row[f"low_{which}"] = np.nan if low is None else low
            row[f"high_{which}"] = np.nan if high is None else high
        rows.append(row)
    return rows


def write_boundary(path: Path, study: Study, found: FlownBoundary, sigmas: float) -> None:
    """A boundary as CSV; `sure` is with the tables so many sigma hotter, `perhaps` cooler."""
    rows = boundary_rows(found)
    columns = {key: np.array([r[key] for r in rows]) for key in rows[0]}
    head = about(study, found.declared.title or found.declared.name)
    head |= {
        "across": found.declared.greatest or found.declared.across,
        "band": f"{sigmas:g} sigma of the ratio tables",
    }
    write_csv(path, columns, ".6g", head)


def boundary_data(found: FlownBoundary) -> dict[str, Any]:
    """A boundary for study.json."""
    rows = [{k: None if v != v else v for k, v in row.items()} for row in boundary_rows(found)]
    areas = {which: found.area(which) for which in WHICH}
    return {"across": found.declared.greatest or found.declared.across, "area": areas, "stretches": rows}


def boundary_table(found: FlownBoundary) -> Table:
    """A boundary for the page."""
    d = found.declared
    heads = (*([] if d.family is None else [d.family]), d.along, "allowed", "limits", "surely", "perhaps")
    rows = []
    for s in found.stretches:
        low, high = limits_of(s)
        limits = high if s.greatest or low == high else f"{low} | {high}"
        own = () if d.family is None else (f"{s.member:g}",)
        rows.append((*own, f"{s.along:g}", _interval(s, MIDDLE), limits, _interval(s, SURE), _interval(s, PERHAPS)))
    return Table(f"Boundary: {d.title or d.name}, {d.greatest or d.across}", heads, rows)


def _interval(stretch: Stretch, which: str) -> str:
    low, high = stretch.value(which)
    if low is None or high is None:
        return "-"
    return f"{high:.4g}" if stretch.greatest else f"{low:.4g} to {high:.4g}"


def notes_of(flights: Sequence[Evaluated]) -> tuple[str, ...]:
    """What a reader has to know of the flights: those not flown, and how many left a table, by where."""
    failed = [f"not flown: {f.error}" for f in flights if f.error is not None]
    no_trim = [f for f in flights if any(m.kind == ELEVON for _, m in f.passed_other)]
    trim = [] if not no_trim else [
        f"no trim within the elevon's travel: {len(no_trim)} flights, first {no_trim[0].case.told()}; not called safe"
    ]  # fmt: skip
    left: dict[str, list[Evaluated]] = {}
    for f in flights:
        for n, m in f.passed_other:
            if m.kind == TABLE:
                left.setdefault(n, []).append(f)
    outside = [_outside(name, own) for name, own in sorted(left.items())]
    return tuple(dict.fromkeys([*failed, *trim, *outside]))


def _outside(name: str, flights: Sequence[Evaluated]) -> str:
    """How far flights were outside one end of a ratio table."""
    farthest = min(flights, key=lambda f: f.margins[name].margin)
    m = farthest.margins[name]
    by = f"by {-m.margin:.3g} {m.unit}".rstrip()
    return f"outside the {name}: {len(flights)} flights, {by} at most ({farthest.case.told()}); not called safe"
