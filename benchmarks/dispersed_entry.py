"""The shipped dispersion of the nominal entry as its page quotes it: peaks, limits, what drives them, first order.

The study runs as its command does. Pictures of `docs/how_to/dispersions.md` are its own.
"""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click

from benchmarks.measure import Figure, save
from sim_heating.base.files import read_json
from sim_heating.cli import main

ROOT = Path(__file__).resolve().parent.parent
STUDY = ROOT / "scenarios" / "studies" / "dispersed_entry.toml"
PICTURES = ("dispersion_peaks.png", "dispersion_drivers.png", "dispersion_first_order.png")
TABLES, CONDUCTIVITY = "ratio tables", "stack.rsi.conductivity_factor"
OF_THE_FLIGHT = ("entry.", "air.", "aero.", "guidance.", "vehicle.")
"""Beginnings of the names of inputs that change the flight."""
MEDIAN, RARE = 0.5, 0.999


def run() -> list[Figure]:
    """Plan the study and keep what the page quotes."""
    with tempfile.TemporaryDirectory() as folder:
        if main(["--quiet", "plan", str(STUDY), "--out", folder]) != 0:
            raise click.ClickException(f"sim-heating plan {STUDY} failed")
        return kept(Path(folder))


def kept(results: Path) -> list[Figure]:
    """Save the figures of a finished study, and its pictures."""
    found = read_json(results / "study.json")["dispersion"]
    peaks = [_peak(p) for p in found["peaks"]]
    figures = [*_of_flights(found), *_of_drivers(peaks), *_of_first_order(peaks)]
    save("dispersed_entry", figures, {"peaks": peaks})
    for name in PICTURES:
        shutil.copy(results / name, ROOT / "docs" / "images" / name)
    return figures


def _peak(peak: Mapping[str, Any]) -> dict[str, Any]:
    """One peak: quantiles with their bounds [K], share of flights above the limit, total indices, first order."""
    quantile = {q["q"]: q for q in peak["quantiles"]}
    first = {q["q"]: q for q in peak["first_order"]["quantiles"]}
    return {
        "control_point": peak["control_point"],
        "quantity": peak["quantity"].removeprefix("peak "),
        "limit_K": peak["limit_K"],
        "median_K": quantile[MEDIAN]["value"],
        "rare_K": [quantile[RARE][k] for k in ("value", "low", "high")],
        "exceeded": [peak["exceeded"][k] for k in ("value", "low", "high")] if peak["exceeded"] else None,
        "total": {name: index["total"] for name, index in (peak["sobol_indices"] or {}).items()},
        "first_order_K": [first[MEDIAN]["difference_K"], first[RARE]["difference_K"]],
        "first_order_holds": [all(q["holds"] for q in first.values()), first[MEDIAN]["holds"]],
    }


def _of_flights(found: Mapping[str, Any]) -> list[Figure]:
    within, six = found["within_limits"], found["six_degrees_of_freedom"]
    farthest = max(found["outside_tables"], key=lambda e: e["farthest"], default={"flights": 0, "farthest": 0.0})
    note = f"{100 * within['low']:.2f} to {100 * within['high']:.2f}; {within['count']} of {within['flights']}"
    return [
        Figure("flights completed", 100 * found["completed"]["value"], "%", note=f"of {found['flights']}"),
        Figure("flights within all limits", 100 * within["value"], "%", note=note),
        Figure("flights outside a ratio table, most of a table", farthest["flights"], "",
               note=f"{farthest['farthest']:.2f} at most"),
        Figure("six degrees of freedom: largest difference of a peak surface temperature",
               max(six["largest_surface_K"].values()), "K", note=f"{six['flights']} flights"),
        Figure("six degrees of freedom: largest difference of a peak bondline temperature",
               max(six["largest_bondline_K"].values()), "K", note=f"{six['flights']} flights"),
    ]  # fmt: skip


def _of_drivers(peaks: list[dict[str, Any]]) -> list[Figure]:
    """Total indices: least and greatest of the tables, greatest of the conductivity and of what changes the flight."""
    figures = []
    for quantity in ("surface", "bondline"):
        mine = [p for p in peaks if p["quantity"] == quantity]
        tables = [p["total"][TABLES] for p in mine]
        figures.append(Figure(f"ratio tables, least total index, {quantity}", min(tables), ""))
        figures.append(Figure(f"ratio tables, greatest total index, {quantity}", max(tables), ""))
    for what, chosen in (("conductivity", (CONDUCTIVITY,)), ("an input of the flight", OF_THE_FLIGHT)):
        indices = [(p["total"][n], n, p) for p in peaks for n in p["total"] if n.startswith(chosen)]
        value, name, peak = max(indices, key=lambda i: i[0])
        note = f"{name}, {peak['control_point']} {peak['quantity']}"
        figures.append(Figure(f"{what}, greatest total index", value, "", note=note))
    return figures


def _of_first_order(peaks: list[dict[str, Any]]) -> list[Figure]:
    """Differences of first order from the counted quantiles, and where they are within the bounds."""
    figures = [Figure("first order: peaks with all quantiles reproduced", sum(p["first_order_holds"][0] for p in peaks),
                      "", note=f"of {len(peaks)}")]  # fmt: skip
    for quantity in ("surface", "bondline"):
        mine = [p for p in peaks if p["quantity"] == quantity]
        medians, rare = ([p["first_order_K"][i] for p in mine] for i in (0, 1))
        figures += [
            Figure(f"first order: median, {quantity}, coolest", min(medians), "K", note=f"{max(medians):.1f} hottest"),
            Figure(f"first order: 0.999 quantile, {quantity}, coolest", min(rare), "K",
                   note=f"{max(rare):.1f} hottest"),
            Figure(f"first order: medians reproduced, {quantity}", sum(p["first_order_holds"][1] for p in mine), "",
                   note=f"of {len(mine)}"),
        ]  # fmt: skip
    return figures
