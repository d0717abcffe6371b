"""The credibility statement as a section of a page, and as tables for a terminal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from sim_heating.base.report.page import Section
from sim_heating.base.report.table import Column, Table
from sim_heating.credibility.rules import rules
from sim_heating.credibility.validation.region import FLIGHT, ValidationCase

NOT_ASSESSED = "not assessed"
RANGES = (("mach", ".1f"), ("alpha_deg", ".1f"), ("log10_re", ".2f"), ("wall_K", ".0f"))
"""Variables of the region and the formats of their ends."""


def credibility_section(block: Mapping[str, Any]) -> Section:
    """Section of a page.

    block : as a result file holds it, `Statement.as_json`
    """
    text = [f"Levels 0 to 4, {block['basis']}."]
    tables = [factors_table(block), *contributions_table(block)]
    return Section("Credibility", text, points=points_of(block), tables=tables)


def points_of(block: Mapping[str, Any]) -> list[str]:
    """What a statement says besides levels, one line each: region, rows, estimates, reviews, problems."""
    judged = block["confidence_C"]
    points = [str(block["evidence"]["validation.half"]["finding"])]
    uncovered = block["verification"]["uncovered"]
    if uncovered:
        points.append(f"No verification row covers: {', '.join(uncovered)}")
    if judged:
        points.append(f"Estimates of confidence C: {', '.join(i['input'] for i in judged)}")
    points += [f"Review: {r['factor']} {r['level']}, {r['person']}, {r['date']}{_void(r)}" for r in block["reviews"]]
    return [f"{line[0].upper()}{line[1:]}." for line in points] + list(block["problems"])


def _void(review: Mapping[str, Any]) -> str:
    return "" if review["counts"] else "; does not count: what was reviewed has changed since"


def factors_table(block: Mapping[str, Any]) -> Table:
    """Level and reason of each factor."""
    titles = {f.name: f.title for f in rules().factors}
    rows = [
        [titles.get(name, name), NOT_ASSESSED if f["level"] is None else f"{f['level']} of 4", f["reason"]]
        for name, f in block["factors"].items()
    ]
    return Table("", [Column("factor"), Column("level", is_text=True), Column("reason", is_text=True)], rows)


def contributions_table(block: Mapping[str, Any]) -> list[Table]:
    """What the uncertainty of the main quantity comes from; no table where it is not known."""
    u = block["uncertainty"]
    if u is None:
        return []
    value = "" if u["value"] is None else f" {u['value']:.4g}"
    sigma = "" if not u["sigma"] else f", standard deviation {u['sigma']:.3g}"
    title = (
        f"{u['quantity'][0].upper()}{u['quantity'][1:]}:{value} {u['unit']}".rstrip(" :") + f"{sigma}; {u['method']}"
    )
    rows = [[n, c["sigma"], c["share"]] for n, c in u["contributions"].items()]
    columns = [
        Column("input"),
        Column(f"contribution, {u['unit']}".rstrip(", "), "sigma", ".3g"),
        Column("share of the variance", "share", ".0%"),
    ]
    return [Table(title, columns, rows)]


def rules_table() -> Table:
    """Every factor with the rule of each level."""
    rows: list[list[Any]] = []
    for factor in rules().factors:
        rows.append([factor.title, 0, factor.lowest])
        rows += [["", level.number, level.rule] for level in factor.levels]
    return Table(rules().basis, [Column("factor"), Column("level"), Column("rule", is_text=True)], rows)


def cases_table(cases: Sequence[ValidationCase]) -> Table:
    """Measured data sets with the errors of their predictions and the conditions that they cover."""
    columns = [
        Column("data set"),
        Column("kind", is_text=True),
        Column("RMSE", "rmse_K", ".3g", "K"),
        Column("largest", "max_abs_K", ".3g", "K"),
        Column("measured rise", "rise_K", ".3g", "K"),
        Column("Mach", is_text=True),
        Column("alpha, deg", is_text=True),
        Column("log10 Re", is_text=True),
        Column("wall, K", is_text=True),
        Column("added by", is_text=True),
    ]
    rows = [
        [
            c.name,
            c.kind,
            c.rmse_K,
            c.max_abs_K,
            c.rise_K,
            *(_range(c, n, form) for n, form in RANGES),
            "user" if c.of_user else "project",
        ]
        for c in cases
    ]
    return Table("Measured data sets, predicted with nothing fitted", columns, rows)


def _range(case: ValidationCase, name: str, form: str) -> str:
    """Least and greatest value of a variable that a data set covers; empty for one that it lacks."""
    if case.kind != FLIGHT and name != "wall_K":
        return ""
    ends = [band.limits[name] for band in case.bands]
    return f"{min(low for low, _ in ends):{form}} to {max(high for _, high in ends):{form}}"
