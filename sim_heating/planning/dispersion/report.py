"""The dispersion of a study as files, tables and pictures.

Pictures: peaks of all flights with their limits, first-order quantiles against those counted, what drives each peak.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from sim_heating.base.files import write_text_atomic
from sim_heating.base.progress import Progress
from sim_heating.base.report.figure import new_figure, replaced_if_undrawable, save_figure
from sim_heating.base.report.table import Column, Table
from sim_heating.credibility.facts.contributors import combined
from sim_heating.credibility.statement import Answer, Facts
from sim_heating.planning.dispersion import results
from sim_heating.planning.dispersion.march import QUANTITIES
from sim_heating.planning.members import member_table
from sim_heating.planning.part import Engine, PartPicture, PartResult, StudyPart, program_digest
from sim_heating.planning.study import Study

CSV = "dispersion.csv"
MEMBERS = (
    "Each flight has one of these estimates, drawn by its weight, and its parameters by their covariance. At other "
    "control points an estimate's flights have what the vehicle declares"
)
PEAKS, FIRST_ORDER, DRIVERS = (f"dispersion_{picture}.png" for picture in ("peaks", "first_order", "drivers"))
WITHIN_TWO_SIGMA = 0.977
"""Probability of a normal deviation below two standard deviations [-]."""
NO_BREAK = "\N{NO-BREAK SPACE}"
LEAST_INDEX = 0.01
"""Smallest total index that the table of what drives a peak names."""


def dispersion_part(study: Study, folder: Path, engine: Engine, progress: Progress) -> PartResult:
    """Fly a study's dispersion and write its results below a folder."""
    ledger = engine.ledger / f"dispersion-{study.hash}-{program_digest()}"
    result, files = results.disperse(
        study,
        ledger,
        scheduler=engine.scheduler,
        workers=engine.workers,
        progress=lambda f, text: progress(0.95 * f, text),
    )
    progress(0.96, "writing")
    results.merge(files["main"], folder / results.FLIGHTS_FILE)
    vehicle = study.vehicle
    header = {"vehicle": vehicle.name, "revision": vehicle.revision, "study": study.hash}
    write_text_atomic(folder / CSV, quantile_table(result).csv(CSV_FORMATS, header))
    title = f"{study.title}\n{study.stamp}"
    pictures = [PartPicture(PEAKS, "Peak temperatures of all flights, quantiles with bounds, limits.")]
    draw_distributions(folder / PEAKS, title, result)
    pictures.append(PartPicture(FIRST_ORDER, "First-order quantiles against those counted."))
    draw_first_order(folder / FIRST_ORDER, title, result)
    if any(a.indices is not None for a in result.peaks):
        pictures.append(PartPicture(DRIVERS, "What drives each peak: total Sobol' indices."))
        draw_drivers(folder / DRIVERS, title, result)
    notes = tuple(_notes(result))
    return PartResult(results.data_of(result), tuple(_tables(result)), tuple(pictures), notes, topics=("trim",))


DISPERSION = StudyPart(dispersion_part, lambda _: (results.FLIGHTS_FILE, CSV, PEAKS, FIRST_ORDER, DRIVERS))


def with_dispersion(facts: Facts, data: Mapping[str, Any]) -> Facts:
    """Facts about a study with what its dispersion found: what drives the peak nearest to its limit, and how often
    limits are kept.

    data : as study.json holds it
    """
    peaks = [p for p in data["peaks"] if p["limit_K"] is not None] or data["peaks"]
    nearest = min(peaks, key=lambda p: (p["limit_K"] or 0.0) - p["mean_K"])
    indices = nearest.get("sobol_indices") or {}
    drivers = {name: nearest["sigma_K"] * max(i["total"], 0.0) ** 0.5 for name, i in indices.items()}
    quantity = f"{nearest['quantity']} of {nearest['control_point']}"
    uncertainty = combined(quantity, "K", nearest["mean_K"], drivers, "total Sobol' indices of the dispersed flights")
    kept = data["within_limits"]
    text = f"all limits kept in {kept['value']:.4f} of {data['flights']} flights, bound {kept['low']:.4f}"
    holds = Answer(kept["low"] >= WITHIN_TWO_SIGMA, text)
    return replace(facts, uncertainty=replace(uncertainty, sigma=nearest["sigma_K"]), holds=holds, varied=holds)


def _notes(result: results.DispersionResult) -> list[str]:
    spec, kept, kept_with_data = result.entry.spec, result.within_limits, result.within_limits_and_data
    head = (
        f"{spec.flights} flights: all limits are kept with a probability of {kept.value:.4f} ({kept.low:.4f} to "
        f"{kept.high:.4f}, {spec.confidence:.0%}); within the ratio tables and trimmed as well "
        f"{kept_with_data.value:.4f}"
    )
    return [head, *results.notes_of(result)]


# Tables --------------------------------------------------------------------------------------------------------------

CSV_FORMATS = {"q": "g"} | dict.fromkeys(("value_K", "low_K", "high_K", "scatter_K", "first_order_K"), ".3f")


def quantile_table(result: results.DispersionResult) -> Table:
    """Quantiles of every peak [K], counted and to first order, one row each."""
    heads = ("control_point", "quantity", "q", "value_K", "low_K", "high_K", "scatter_K", "first_order_K")
    rows = [
        (a.point, f"peak_{a.location}", q.q, q.value, q.low, q.high, q.scatter, first["value_K"])
        for a in result.peaks
        for q, first in zip(a.quantiles, a.first["quantiles"], strict=True)
    ]
    return Table("Quantiles of peak temperatures", heads, rows)


def _tables(result: results.DispersionResult) -> list[Table]:
    members = results.members_of(result)
    tables = [member_table(MEMBERS, members)] if members else []
    tables += [_peak_table(result), _first_order_table(result)]
    driven = [(f"{a.point} {a.location}", _drivers(result, a)) for a in result.peaks if a.indices is not None]
    if driven:
        title = (
            f"What drives the peaks: total Sobol' indices above {LEAST_INDEX:g}, in brackets their bounds of "
            f"{result.entry.spec.confidence:.0%} and the first order"
        )
        tables.append(Table(title, ("control point", Column("inputs", is_text=True)), driven))
    return tables


def _peak_table(result: results.DispersionResult) -> Table:
    spec = result.entry.spec
    columns: tuple[Column | str, ...] = (
        "control point",
        Column("mean", format=".0f"),
        Column("sigma", format=".1f"),
        *(f"{q:g} quantile" for q in spec.quantiles),
        Column("limit", format=".0f"),
        "above it",
    )
    rows = [
        (
            f"{a.point} {a.location}",
            a.mean_K,
            a.sigma_K,
            *(("-" if q.value is None else f"{q.value:.0f}") + _bounds(q.low, q.high) for q in a.quantiles),
            a.limit,
            _exceedance(a),
        )
        for a in result.peaks
    ]
    title = f"Peak temperatures [K] of {spec.flights} flights, in brackets bounds of {spec.confidence:.0%}"
    return Table(title, columns, rows)


def _bounds(low: float | None, high: float | None) -> str:
    ends = ("-" if end is None else f"{end:.0f}" for end in (low, high))
    return f" ({f'{NO_BREAK}to{NO_BREAK}'.join(ends)})"


def _exceedance(peak: results.PeakStatistics) -> str | None:
    e = peak.exceeded
    return None if e is None else f"{e.value:.4f} ({e.low:.4f}{NO_BREAK}to{NO_BREAK}{e.high:.4f})"


def _first_order_table(result: results.DispersionResult) -> Table:
    columns: tuple[Column | str, ...] = (
        "control point",
        Column("mean flight", format=".0f"),
        Column("sigma", format=".1f"),
        Column("counted", format=".1f"),
        *(Column(f"{q:g} quantile", format="+.1f") for q in result.entry.spec.quantiles),
        "holds",
    )
    rows = [
        (
            f"{a.point} {a.location}",
            a.first["mean_K"],
            a.first["sigma_K"],
            a.sigma_K,
            *(q["difference_K"] for q in a.first["quantiles"]),
            "yes" if a.first["holds"] else "no",
        )
        for a in result.peaks
    ]
    title = "First order through the sensitivities along the mean flight [K]: quantiles less those counted"
    return Table(title, columns, rows)


def _drivers(result: results.DispersionResult, peak: results.PeakStatistics) -> str:
    assert peak.indices is not None  # the caller's choice
    columns = (peak.indices.total, peak.indices.total_bounds, peak.indices.first)
    named = sorted(zip(result.entry.group_descriptions, *columns, strict=True), key=lambda x: -x[1])
    return "; ".join(
        f"{name} {t:.2f} ({low:.2f}{NO_BREAK}to{NO_BREAK}{high:.2f}, first {f:.2f})"
        for (name, _), t, (low, high), f in named
        if t > LEAST_INDEX
    )


# Pictures ------------------------------------------------------------------------------------------------------------

SURFACE, BONDLINE = "tab:red", "tab:blue"
WIDTH = 0.38
"""Half width of a distribution in the picture."""
BINS = 40
HOLDS: dict[str, Any] = {"marker": "o", "color": "tab:green"}
FAILS: dict[str, Any] = {"marker": "X", "color": "tab:red"}


@replaced_if_undrawable
def draw_distributions(path: Path, title: str, result: results.DispersionResult) -> None:
    """Draw the distribution of each peak, one row a control point; surfaces left, bondlines right."""
    points = [p.point.name for p in result.entry.points]
    figure, axes = new_figure(11.0, 2.1 + 0.55 * len(points), 1, 2, sharey=True)
    for ax, quantity, color in zip(axes, QUANTITIES, (SURFACE, BONDLINE), strict=True):
        for peak in (a for a in result.peaks if a.quantity == quantity):
            _distribution(ax, points.index(peak.point), peak, result.values(peak), color)
        ax.set_xlabel(f"peak {quantity.removesuffix('_K')} temperature, K")
        _name_points(ax, points, result, quantity)
    axes[1].plot([], [], "k|", markersize=11, label="limit")
    axes[1].plot([], [], "o-", color="0.2", markersize=4, linewidth=1.2, label=_quantile_label(result))
    figure.legend(*axes[1].get_legend_handles_labels(), loc="outside lower center", ncols=2, fontsize=8)
    save_figure(figure, path, f"Peak temperatures of {result.entry.spec.flights} dispersed entries\n{title}", axes)


def _name_points(ax: Axes, points: list[str], result: results.DispersionResult, quantity: str) -> None:
    """Label a row for each point; a wall of one layer has no bondline and is labelled so."""
    ax.set_yticks(range(len(points)), points)
    ax.set_ylim(len(points) - 0.4, -0.6)
    drawn = {a.point for a in result.peaks if a.quantity == quantity}
    for row in (i for i, name in enumerate(points) if name not in drawn):
        ax.text(
            0.5,
            row,
            "one layer: no bondline",
            transform=ax.get_yaxis_transform(),
            fontsize=8,
            color="0.4",
            ha="center",
            va="center",
        )


def _quantile_label(result: results.DispersionResult) -> str:
    named = ", ".join(f"{q:g}" for q in result.entry.spec.quantiles)
    return f"quantiles {named} with bounds of {result.entry.spec.confidence:.0%}"


def _distribution(ax: Axes, row: int, peak: results.PeakStatistics, values: np.ndarray, color: str) -> None:
    finite = values[np.isfinite(values)]
    count, edges = np.histogram(finite, bins=BINS)
    middle, height = 0.5 * (edges[1:] + edges[:-1]), WIDTH * count / count.max()
    ax.fill_between(middle, row - height, row + height, color=color, alpha=0.35, linewidth=0, step="mid")
    for q in peak.quantiles:
        if q.value is None:
            continue
        ax.plot(q.value, row, "o", color="0.2", markersize=3.5)
        if q.low is not None and q.high is not None:
            ax.plot([q.low, q.high], [row, row], color="0.2", linewidth=1.2)
    if peak.limit is not None:
        ax.plot([peak.limit, peak.limit], [row - 0.42, row + 0.42], color="k", linewidth=1.6)


def _draw_quantile(axes: Axes, y: float, counted: Any, first: Mapping[str, Any]) -> None:
    """Draw a quantile to first order less the counted one [K], on the bounds of that one."""
    if counted.value is None:
        return
    if counted.low is not None and counted.high is not None:
        ends = [counted.low - counted.value, counted.high - counted.value]
        axes.plot(ends, [y, y], color="0.7", linewidth=4, solid_capstyle="butt")
    axes.plot(first["difference_K"], y, markersize=5, linestyle="none", **(HOLDS if first["holds"] else FAILS))


@replaced_if_undrawable
def draw_first_order(path: Path, title: str, result: results.DispersionResult) -> None:
    """Draw first-order quantiles less those counted [K], on the bounds of the counted ones."""
    figure, axes = new_figure(11.0, 2.2 + 0.5 * len(result.entry.points), 1, 2, sharey=True)
    points = [p.point.name for p in result.entry.points]
    qs = result.entry.spec.quantiles
    for ax, quantity in zip(axes, QUANTITIES, strict=True):
        for a in (a for a in result.peaks if a.quantity == quantity):
            row = points.index(a.point)
            for k, (q, first) in enumerate(zip(a.quantiles, a.first["quantiles"], strict=True)):
                _draw_quantile(ax, row + 0.7 * (k - 0.5 * (len(qs) - 1)) / max(len(qs) - 1, 1), q, first)
        ax.axvline(0.0, color="0.3", linewidth=0.8)
        _name_points(ax, points, result, quantity)
        ax.set_xlabel(f"peak {quantity.removesuffix('_K')}: first order less counted, K")
    axes[0].plot([], [], color="0.7", linewidth=4, label="bounds of the counted quantile")
    axes[0].plot([], [], markersize=5, linestyle="none", label="first order, holds", **HOLDS)
    axes[0].plot([], [], markersize=5, linestyle="none", label="first order, does not hold", **FAILS)
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=3, fontsize=8)
    named = ", ".join(f"{q:g}" for q in qs)
    save_figure(figure, path, f"First order against counting, quantiles {named} from top to bottom\n{title}", axes)


@replaced_if_undrawable
def draw_drivers(path: Path, title: str, result: results.DispersionResult) -> None:
    """Draw the total Sobol' indices of every peak as a map."""
    peaks = [a for a in result.peaks if a.indices is not None]
    groups = [", ".join(name_and_size) for name_and_size in result.entry.group_descriptions]
    total = np.array([a.indices.total for a in peaks if a.indices is not None]).T
    figure, axes = new_figure(max(6.0 + 0.42 * len(peaks), 9.0), 3.4 + 0.3 * len(groups), 1)
    ax = axes[0]
    image = ax.imshow(np.clip(total, 0.0, 1.0), cmap="Blues", vmin=0.0, vmax=1.0, aspect="auto")
    for (i, k), value in np.ndenumerate(total):
        if value >= 0.005:
            ax.text(k, i, f"{value:.2f}", ha="center", va="center", fontsize=7, color="w" if value > 0.55 else "k")
    ax.set_xticks(
        range(len(peaks)),
        [f"{a.point} {a.location}" for a in peaks],
        rotation=45,
        ha="right",
        rotation_mode="anchor",
        fontsize=8,
    )
    ax.set_yticks(range(len(groups)), groups, fontsize=8)
    figure.colorbar(image, ax=ax, label="total Sobol' index")
    save_figure(figure, path, f"What drives the peaks\n{title}", np.array([]))
