"""Report of a campaign: one page, and its fits as CSV."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from sim_heating.base.files import write_text_atomic
from sim_heating.base.parameters import MODEL, RATIO
from sim_heating.base.report.figure import new_figure, save_figure
from sim_heating.base.report.page import Page, Picture, Section, write_page
from sim_heating.base.report.table import SORTABLE, Column, Table
from sim_heating.campaign.manoeuvre_fits import usable
from sim_heating.campaign.result import IMPROBABLE, CampaignResult
from sim_heating.closure.report.record import closures_table
from sim_heating.credibility.section import credibility_section

SUMMARY, FITS_CSV, ERRORS_CSV, PAGE = FILES = "campaign.json", "fits.csv", "errors.csv", "report.html"
NEXT_FLIGHT = "next_flight.toml"


def write_csvs(folder: Path, result: CampaignResult) -> None:
    """Write the fits and the errors of the tables as CSV files."""
    write_text_atomic(folder / FITS_CSV, fits_table(result).csv())
    write_text_atomic(folder / ERRORS_CSV, errors_table(result).csv())


def fits_table(result: CampaignResult) -> Table:
    """Every estimated parameter of every fit, a row a parameter."""
    columns = [
        Column("control point", "control_point"),
        Column("manoeuvre", is_text=True),
        Column("flights", is_text=True),
        Column("parameter", is_text=True),
        Column("value", format=".5g"),
        Column("sigma", format=".2g"),
        Column("unit", is_text=True),
        Column("RMSE", "rmse_K", ".2f", "K"),
        Column("noise floor", "noise_floor_K", ".2f", "K"),
    ]
    fitted = [r for r in (*result.fits, *result.joint) if "failed" not in r]
    rows = [
        [r["control_point"], r["group"], " ".join(r["flights"]), n, *_cells(p), r["rmse_K"], r["noise_floor_K"]]
        for r in fitted
        for n, p in r["parameters"].items()
        if not n.startswith("initial.")
    ]
    return Table("Fits", columns, rows, sortable=len(rows) > SORTABLE, choices=["control point", "parameter"])


def _cells(parameter: Mapping[str, Any]) -> list[Any]:
    return [parameter["value"], parameter["sigma"], parameter["unit"]]


def errors_table(result: CampaignResult) -> Table:
    """RMSE of every manoeuvre by the tables before and after, and by its own fit."""
    heads = {
        "before_from_start_K": "before",
        "after_from_start_K": "after",
        "fit_K": "fit",
        "before_K": "before, from entry",
        "after_K": "after, from entry",
        "noise_floor_K": "noise floor",
    }
    columns = [
        Column("flight"),
        Column("control point", "control_point", is_text=True),
        Column("manoeuvre", is_text=True),
        Column("use", is_text=True),
        *(Column(head, key, ".2f", "K") for key, head in heads.items()),
    ]
    rows = [
        [e["flight"], e["control_point"], e["manoeuvre"], "check" if e["check"] else "fitted", *(e[k] for k in heads)]
        for e in result.errors
    ]
    title = "RMSE of the manoeuvres with the tables before and after"
    return Table(
        title, columns, rows, sortable=len(rows) > SORTABLE, choices=["flight", "control point", "manoeuvre", "use"]
    )


def write_campaign_page(path: Path, result: CampaignResult) -> None:
    """Write the page of a campaign."""
    write_page(path, lambda: campaign_page(result))


def campaign_page(result: CampaignResult) -> Page:
    """Flights, findings, fits, their agreement, the revised tables and what they predict."""
    sections = [
        _flights_section(result),
        *_errors_section(result),
        *_tables_section(result),
        *_closed_section(result),
        *_joint_section(result),
        *_ageing_section(result),
        *_fits_sections(result),
        credibility_section(result.credibility.as_json()),
    ]
    vehicle = result.campaign.vehicle
    count = f"{_counted(len(result.flights), 'flight')}, {_counted(len(result.points), 'control point')}"
    subtitle = f"{vehicle.name}, revision {vehicle.revision}: {count}"
    return Page(result.campaign.title, subtitle, sections, _headline(result))


def _counted(count: int, noun: str) -> str:
    return f"{count} {noun}{'' if count == 1 else 's'}"


def _headline(result: CampaignResult) -> tuple[str, str]:
    """How many fits there are and what the tables predict, in a few words."""
    fitted = [r for r in (*result.fits, *result.joint) if not usable(r)]
    head = f"{len(fitted)} of {len(result.fits) + len(result.joint)} fits are within the noise of their thermocouples"
    if not result.errors:
        return head, ""
    parts = []
    for check, kind in ((False, "fitted flights"), (True, "flights that only check")):
        rows = [e for e in result.errors if e["check"] == check]
        if rows:
            before, after, floor = (
                float(np.median([e[k] for e in rows])) for k in ("before_K", "after_K", "noise_floor_K")
            )
            parts.append(
                f"{kind}: median RMSE of a manoeuvre {before:.2f} K with the tables before, {after:.2f} K with the "
                f"revised ones, noise floor {floor:.2f} K"
            )
    line = "; ".join(parts)
    return head, f"{line[0].upper()}{line[1:]}."


def _flights_section(result: CampaignResult) -> Section:
    columns = [
        Column("flight"),
        Column("use", is_text=True),
        Column("control points"),
        Column("manoeuvres", is_text=True),
    ]
    rows = [
        [
            f.name,
            "check" if f.name in result.checks else "fitted",
            len(f.records),
            ", ".join(m.name for m in f.manoeuvres),
        ]
        for f in result.flights
    ]
    text = [result.campaign.declared.note.strip()] if result.campaign.declared.note.strip() else []
    text.append(
        "The number after `mach` is the speed in 1000 ft/s at the start of a manoeuvre, as in the Shuttle's "
        "literature. Flights that check are not fitted: they show what the revised tables predict."
    )
    return Section(
        "Flights", text, points=result.omitted, tables=[Table("", columns, rows, sortable=len(rows) > SORTABLE)]
    )


def _closed_section(result: CampaignResult) -> list[Section]:
    if not result.closed:
        return []
    rows = [{**row, "record": f"{row['flight']}/{row['control_point']}"} for row in result.closed]
    text = (
        "Each whole record was searched for an effect that its declared model lacks. What was found is part of the "
        "model in the fits of its manoeuvres."
    )
    return [Section("What the declared models lack", [text], tables=[closures_table(rows)])]


def _fits_sections(result: CampaignResult) -> list[Section]:
    """A section for each control point that has fits."""
    return [section for point in result.points for section in _point_section(result, point)]


def _of_point(rows: Iterable[dict[str, Any]], point: str) -> list[dict[str, Any]]:
    return [row for row in rows if row["control_point"] == point]


def _point_section(result: CampaignResult, point: str) -> list[Section]:
    """Fits of one control point by manoeuvre, the flights together after the single ones, as a table and a picture."""
    every = _of_point([*result.fits, *result.joint], point)
    order = [g.name for g in result.groups]
    rows = sorted((r for r in every if "failed" not in r), key=lambda r: order.index(r["group"]))
    points = [f"{r['group']}, {_who(r)}: failed: {r['failed']}" for r in every if "failed" in r]
    if not rows:
        return [Section(f"Fits of {point}", points=points)] if points else []
    names = [p.name for p in RATIO if any(p.name in r["parameters"] for r in rows)]
    points += [f"{name} not estimated: {why} ({', '.join(w)})" for (name, why), w in _not_estimated(rows).items()]
    pictures = [Picture(_draw(point, names, rows), f"Estimates of {point} with bounds of 2 sigma")] if names else []
    tables = [_fit_table(rows, names), *_other_parameters(rows)]
    return [Section(f"Fits of {point}", points=points, tables=tables, pictures=pictures)]


def _fit_table(rows: Sequence[dict[str, Any]], names: Sequence[str]) -> Table:
    """Estimates of these parameters by fit, a remark where any fit has one; fits of several flights stand out."""
    columns = [
        Column("manoeuvre"),
        Column("flights", is_text=True),
        *(Column(n.removeprefix("ratio."), is_text=True) for n in names),
        Column("RMSE", format=".2f", unit="K"),
        Column("noise floor", format=".2f", unit="K"),
    ]
    cells = [[r["group"], _who(r), *(_bound(r, n) for n in names), r["rmse_K"], r["noise_floor_K"]] for r in rows]
    remarks = [usable(r) for r in rows]
    if any(remarks):
        columns.append(Column("remark", is_text=True))
        cells = [[*row, remark] for row, remark in zip(cells, remarks, strict=True)]
    strong = [i for i, r in enumerate(rows) if len(r["flights"]) > 1]
    return Table("", columns, cells, strong, sortable=len(cells) > SORTABLE)


def _who(row: Mapping[str, Any]) -> str:
    return f"{len(row['flights'])} flights together" if len(row["flights"]) > 1 else str(row["flights"][0])


def _bound(row: Mapping[str, Any], name: str) -> str:
    """An estimate with its sigma, as text; empty where it was not estimated."""
    p = row["parameters"].get(name)
    return "" if p is None else f"{p['value']:.4g} +- {p['sigma']:.2g}"


def _other_parameters(rows: Sequence[Mapping[str, Any]]) -> list[Table]:
    """Estimates that are neither of the ratio nor of the start."""
    cells = [
        [r["group"], _who(r), n, *_cells(p)]
        for r in rows
        for n, p in r["parameters"].items()
        if not n.startswith(("ratio.", "initial."))
    ]
    numbers = [Column("value", format=".4g"), Column("sigma", format=".2g"), Column("unit", is_text=True)]
    columns = [Column("manoeuvre"), Column("flights", is_text=True), Column("parameter", is_text=True), *numbers]
    return [Table("Effects and thermal parameters", columns, cells)] if cells else []


def _not_estimated(rows: Sequence[Mapping[str, Any]]) -> dict[tuple[str, str], list[str]]:
    """Manoeuvres in which a parameter was left out, by the parameter and the reason in the first fit of each."""
    first: dict[tuple[str, str], str] = {}
    for r in rows:
        for name, why in r["not_estimated"].items():
            first.setdefault((name, r["group"]), why.partition(";")[0])
    groups_of: dict[tuple[str, str], list[str]] = {}
    for (name, group), why in first.items():
        groups_of.setdefault((name, why), []).append(group)
    return groups_of


def _style(row: Mapping[str, Any]) -> dict[str, Any]:
    """Colour and width of the estimates of a fit."""
    if len(row["flights"]) > 1:
        return {"color": "tab:blue", "linewidth": 2.2}
    return {"color": "0.45" if not usable(row) else "tab:red", "linewidth": 1.1}


def _draw(point: str, names: Sequence[str], rows: Sequence[Mapping[str, Any]]) -> Figure:
    """Each parameter by manoeuvre, the single flights in grey and all together in colour."""
    groups = list(dict.fromkeys(r["group"] for r in rows))
    columns = min(len(names), 3)
    lines = -(-len(names) // columns)
    figure, axes = new_figure(
        1.5 + 3.4 * columns, 1.2 + 0.5 * len(groups) * lines + 0.9 * lines, lines, columns, squeeze=False, sharey=True
    )
    for a in axes.flat[len(names) :]:
        a.set_visible(False)
    for a, name in zip(axes.flat, names, strict=False):
        for k, group in enumerate(groups):
            fits = [r for r in rows if r["group"] == group and name in r["parameters"]]
            for i, r in enumerate(fits):
                p = r["parameters"][name]
                height = k + 0.7 * ((i + 0.5) / len(fits) - 0.5)
                a.errorbar(p["value"], height, xerr=2.0 * p["sigma"], fmt="o", markersize=3.5, **_style(r))
        unit = MODEL[name].unit
        a.set_xlabel(f"{name}" if unit == "1" else f"{name}, {unit}")
        a.axvline(0.0, color="0.7", linewidth=0.8)
        a.set_yticks(range(len(groups)), groups)
        a.set_ylim(len(groups) - 0.5, -0.5)
        a.locator_params(axis="x", nbins=4)
    kinds = "grey: one flight, red: one that revises no table, blue: all flights together"
    return save_figure(figure, None, f"{point}: estimates with 2 sigma ({kinds})", axes)


def _joint_section(result: CampaignResult) -> list[Section]:
    """Whether the flights agree."""
    rows = [r for r in result.joint if r.get("agreement")]
    if not rows:
        return []
    columns = [
        Column("control point"),
        Column("manoeuvre", is_text=True),
        Column("flights"),
        Column("chi-square", format=".1f"),
        Column("degrees of freedom"),
        Column("p-value", format=".2g"),
    ]
    cells = [
        [
            r["control_point"],
            r["group"],
            len(r["flights"]),
            *(r["agreement"][k] for k in ("chi_square", "degrees", "p_value")),
        ]
        for r in rows
    ]
    low = [i for i, r in enumerate(rows) if r["agreement"]["p_value"] < IMPROBABLE]
    text = (
        "The fits of single flights scatter about the fit of all together as their bounds say where the p-value is "
        f"not small. In {len(low)} of {len(rows)} it is below {IMPROBABLE:g}: flights differ by more than their bounds."
    )
    table = Table("", columns, cells, low, sortable=len(cells) > SORTABLE, choices=["control point", "manoeuvre"])
    return [Section("Do the flights agree?", [text], tables=[table])]


def _ageing_section(result: CampaignResult) -> list[Section]:
    """How parameters walk from flight to flight."""
    if not result.walks:
        return []
    columns = [
        Column("control point"),
        Column("parameter", is_text=True),
        Column("flight", is_text=True),
        Column("by this flight", format=".4g"),
        Column("sigma", format=".2g"),
        Column("with those before", format=".4g"),
        Column("sigma", "known_sigma", format=".2g"),
    ]
    rows = [
        [w.control_point, w.parameter, flight, *measured, *filtered]
        for w in result.walks
        for flight, measured, filtered in zip(w.flights, w.measured, w.known, strict=True)
    ]
    rows += [
        [w.control_point, w.parameter, "the next", math.nan, math.nan, w.next_value, w.next_sigma] for w in result.walks
    ]
    text = (
        "Each parameter walks from flight to flight by the declared standard deviation. The last rows are what is "
        "known before the next flight."
    )
    low = [w for w in result.walks if w.p_value is not None and w.p_value < IMPROBABLE]
    points = [
        f"{w.control_point}, {w.parameter}: the flights differ by more than their bounds and a walk of "
        f"{w.sigma_per_flight:g} per flight (p = {w.p_value:.1g})"
        for w in low
    ]
    return [Section("Ageing", [text], points, [Table("", columns, rows, sortable=len(rows) > SORTABLE)])]


def _tables_section(result: CampaignResult) -> list[Section]:
    if not result.updates and not result.refused:
        return []
    columns = [
        Column("control point"),
        Column("revision"),
        Column("manoeuvre", is_text=True),
        Column("flights"),
        Column("written", is_text=True),
        Column("chi-square", format=".1f"),
        Column("degrees of freedom"),
    ]
    before, after = ("control_point", "revision", "manoeuvre"), ("chi_square", "degrees_of_freedom")
    cells = [
        [*(u[k] for k in before), len(u["flights"]), ", ".join(u["parameters"]), *(u[k] for k in after)]
        for u in result.updates
    ]
    text = (
        "Each revision takes all evidence before it into account, so that their order does not matter. The chi-square "
        "is that of all evidence so far against the sigma that the table stated before any of it."
    )
    points = [f"Not used: {line}" for line in result.refused]
    return [Section("Revised tables", [text], points, [Table("", columns, cells, sortable=len(cells) > SORTABLE)])]


def _errors_section(result: CampaignResult) -> list[Section]:
    if not result.errors:
        return []
    text = (
        "Predictions with the tables, nothing fitted: from the temperatures at the start of the fit, and from entry "
        "interface, which takes the heating before the manoeuvre into account. Bold: more than 1.05 times the error "
        "before."
    )
    worse = [i for i, e in enumerate(result.errors) if e["after_K"] > 1.05 * e["before_K"]]
    points = [
        f"{u['control_point']}, {u['manoeuvre']}, {name}: not in revision {u['revision']}: {flown}, {loss:.2f} K"
        for u in result.updates
        for name, withheld in u["held"].items()
        for flown, loss in withheld["not_held"].items()
    ]
    return [Section("What the revised tables predict", [text], points, [replace(errors_table(result), strong=worse)])]


def totals(result: CampaignResult) -> Table:
    """Fits and errors in a few numbers, for a terminal."""
    rows = []
    for point in result.points:
        fits, joint = _of_point(result.fits, point), _of_point(result.joint, point)
        good = sum(not usable(r) for r in fits)
        errors = _of_point(result.errors, point)
        medians = [
            float(np.median([e[k] for e in errors])) if errors else math.nan
            for k in ("before_K", "after_K", "noise_floor_K")
        ]
        updates = _of_point(result.updates, point)
        rows.append([point, len(fits), good, len(joint), len(updates), *medians])
    columns = [
        Column("control point"),
        Column("fits"),
        Column("within noise"),
        Column("joint fits"),
        Column("revisions"),
        Column("tables before", format=".2f", unit="K"),
        Column("tables after", format=".2f", unit="K"),
        Column("noise floor", format=".2f", unit="K"),
    ]
    return Table("Campaign: fits, and median RMSE of the manoeuvres by the tables", columns, rows)
