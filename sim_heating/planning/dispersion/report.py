"""A dispersion as a part of a study: files, tables and pictures.

Pictures of a dispersion: peaks of all flights beside limits, first order beside counting, what drives each peak.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from sim_heating.base.files import write_text_atomic
from sim_heating.base.progress import Progress
from sim_heating.base.report.figure import new_figure, save_figure
from sim_heating.base.report.table import Column, Table
from sim_heating.planning.dispersion.march import QUANTITIES
from sim_heating.planning.dispersion.results import (
    FLIGHTS_FILE,
    Answer,
    Dispersed,
    data_of,
    disperse,
    merge,
    notes_of,
    place_of,
)
from sim_heating.planning.part import Engine, Found, Part, Picture, program_digest
from sim_heating.planning.study import Study

CSV = "dispersion.csv"
PEAKS, FIRST_ORDER, DRIVERS = (f"dispersion_{what}.png" for what in ("peaks", "first_order", "drivers"))
NO_BREAK = "\N{NO-BREAK SPACE}"
LEAST_INDEX = 0.01
"""Smallest total index that the table of what drives a peak names."""


def dispersion_part(study: Study, folder: Path, engine: Engine, progress: Progress) -> Found:
    """Fly a study's dispersion and write what it tells."""
    ledger = engine.ledger / f"dispersion-{study.hash}-{program_digest()}"
    found, files = disperse(
        study,
        ledger,
        scheduler=engine.scheduler,
        workers=engine.workers,
        progress=lambda f, text: progress(0.95 * f, text),
    )
    progress(0.96, "writing")
    merge(files["main"], folder / FLIGHTS_FILE)
    _write_csv(found, folder / CSV)
    title = f"{study.title}\n{study.stamp}"
    pictures = [Picture(PEAKS, "Peak temperatures of all flights, quantiles with bounds, limits.")]
    draw_distributions(folder / PEAKS, title, found)
    pictures.append(Picture(FIRST_ORDER, "Quantiles to first order beside those counted."))
    draw_first_order(folder / FIRST_ORDER, title, found)
    if any(a.indices is not None for a in found.answers):
        pictures.append(Picture(DRIVERS, "What drives each peak: total Sobol' indices."))
        draw_drivers(folder / DRIVERS, title, found)
    return Found(data_of(found), tuple(_tables(found)), tuple(pictures), tuple(_notes(found)))


DISPERSION = Part(dispersion_part, lambda _: (FLIGHTS_FILE, CSV, PEAKS, FIRST_ORDER, DRIVERS))


def _notes(found: Dispersed) -> list[str]:
    spec, kept, safe = found.entry.spec, found.kept, found.safe
    head = (
        f"{spec.flights} flights: all limits are kept with a probability of {kept.value:.4f} ({kept.low:.4f} to "
        f"{kept.high:.4f}, {spec.confidence:.0%}), within the ratio tables and trimmed as well {safe.value:.4f}"
    )
    return [head, *notes_of(found)]


def _tables(found: Dispersed) -> list[Table]:
    spec = found.entry.spec
    heads = ("control point", "mean", "sigma", *(f"{q:g} quantile" for q in spec.quantiles), "limit", "above it")
    rows = tuple(_row(a) for a in found.answers)
    caption = f"Peak temperatures [K] of {spec.flights} flights, in brackets bounds of {spec.confidence:.0%}"
    tables = [Table(caption, heads, rows)]
    first = tuple(
        (
            f"{a.point} {place_of(a)}", f"{a.first['mean_K']:.0f}", f"{a.first['sigma_K']:.1f}", f"{a.sigma_K:.1f}",
            *("-" if q["apart_K"] is None else f"{q['apart_K']:+.1f}" for q in a.first["quantiles"]),
            "yes" if a.first["holds"] else "no",
        )
        for a in found.answers
    )  # fmt: skip
    heads = ("control point", "mean flight", "sigma", "counted", *(f"{q:g} quantile" for q in spec.quantiles), "holds")
    caption = "First order through the sensitivities along the mean flight [K]: quantiles less those counted"
    tables.append(Table(caption, heads, first))
    driven = [(f"{a.point} {place_of(a)}", _drivers(found, a)) for a in found.answers if a.indices is not None]
    if driven:
        caption = f"What drives the peaks: total Sobol' indices above {LEAST_INDEX:g}, first-order index in brackets"
        tables.append(Table(caption, ("control point", Column("inputs", is_text=True)), driven))
    return tables


def _row(a: Answer) -> tuple[str, ...]:
    def bounds(low: float | None, high: float | None) -> str:
        ends = ("-" if end is None else f"{end:.0f}" for end in (low, high))
        return f" ({f'{NO_BREAK}to{NO_BREAK}'.join(ends)})"

    quantiles = [("-" if q.value is None else f"{q.value:.0f}") + bounds(q.low, q.high) for q in a.quantiles]
    e = a.exceeded
    above = "-" if e is None else f"{e.value:.4f} ({e.low:.4f}{NO_BREAK}to{NO_BREAK}{e.high:.4f})"
    limit = "-" if a.limit is None else f"{a.limit:.0f}"
    return (f"{a.point} {place_of(a)}", f"{a.mean_K:.0f}", f"{a.sigma_K:.1f}", *quantiles, limit, above)


def _drivers(found: Dispersed, a: Answer) -> str:
    assert a.indices is not None  # the caller's choice
    named = sorted(
        zip(found.entry.words, a.indices.total.tolist(), a.indices.first.tolist(), strict=True), key=lambda x: -x[1]
    )
    return "; ".join(f"{what} {t:.2f} ({f:.2f})" for (what, _), t, f in named if t > LEAST_INDEX)


def _write_csv(found: Dispersed, path: Path) -> None:
    """The quantiles as a table for programs."""
    study = found.entry.study
    header = {"vehicle": study.vehicle.name, "revision": study.vehicle.revision, "study": study.hash}
    lines = ["control_point,quantity,q,value_K,low_K,high_K,scatter_K,first_order_K"]
    for a in found.answers:
        for q, first in zip(a.quantiles, a.first["quantiles"], strict=True):
            cells = [q.value, q.low, q.high, q.scatter, first["value_K"]]
            told = ",".join("" if c is None else f"{c:.3f}" for c in cells)
            lines.append(f"{a.point},peak_{place_of(a)},{q.q:g},{told}")
    head = "".join(f"# {k}: {v}\n" for k, v in header.items())
    write_text_atomic(path, head + "\n".join(lines) + "\n")


SURFACE, BONDLINE = "tab:red", "tab:blue"
WIDTH = 0.38
"""Half width of a distribution in the picture."""
BINS = 40
HOLDS, FAILS = {"marker": "o", "color": "tab:green"}, {"marker": "X", "color": "tab:red"}


def draw_distributions(path: Path, title: str, found: Dispersed) -> None:
    """Distribution of each peak, one row a control point; surface left, bondline right."""
    points = [p.point.name for p in found.entry.points]
    figure, axes = new_figure(11.0, 2.1 + 0.55 * len(points), 1, 2, sharey=True)
    for ax, quantity, color in zip(axes, QUANTITIES, (SURFACE, BONDLINE), strict=True):
        for answer in (a for a in found.answers if a.quantity == quantity):
            _distribution(ax, points.index(answer.point), answer, found.values(answer), color)
        ax.set_xlabel(f"peak {quantity.removesuffix('_K')} temperature, K")
        _name_points(ax, points, found, quantity)
    axes[1].plot([], [], "k|", markersize=11, label="limit")
    axes[1].plot([], [], "o-", color="0.2", markersize=4, linewidth=1.2, label=_quantile_label(found))
    figure.legend(*axes[1].get_legend_handles_labels(), loc="outside lower center", ncols=2, fontsize=8)
    save_figure(figure, path, f"Peak temperatures of {found.entry.spec.flights} dispersed entries\n{title}", axes)


def _name_points(ax: Axes, points: list[str], found: Dispersed, quantity: str) -> None:
    """A row for each point; a wall of one layer has no bondline, and says so."""
    ax.set_yticks(range(len(points)), points)
    ax.set_ylim(len(points) - 0.4, -0.6)
    told = {a.point for a in found.answers if a.quantity == quantity}
    for row in (i for i, name in enumerate(points) if name not in told):
        ax.text(0.5, row, "one layer: no bondline", transform=ax.get_yaxis_transform(), fontsize=8, color="0.4",
                ha="center", va="center")  # fmt: skip


def _quantile_label(found: Dispersed) -> str:
    told = ", ".join(f"{q:g}" for q in found.entry.spec.quantiles)
    return f"quantiles {told} with bounds of {found.entry.spec.confidence:.0%}"


def _distribution(ax: Axes, row: int, answer: Answer, values: np.ndarray, color: str) -> None:
    known = values[np.isfinite(values)]
    count, edges = np.histogram(known, bins=BINS)
    middle, height = 0.5 * (edges[1:] + edges[:-1]), WIDTH * count / count.max()
    ax.fill_between(middle, row - height, row + height, color=color, alpha=0.35, linewidth=0, step="mid")
    for q in answer.quantiles:
        if q.value is None:
            continue
        ax.plot(q.value, row, "o", color="0.2", markersize=3.5)
        if q.low is not None and q.high is not None:
            ax.plot([q.low, q.high], [row, row], color="0.2", linewidth=1.2)
    if answer.limit is not None:
        ax.plot([answer.limit, answer.limit], [row - 0.42, row + 0.42], color="k", linewidth=1.6)


def draw_first_order(path: Path, title: str, found: Dispersed) -> None:
    """Quantiles to first order less those counted, over the scatter, against the bounds of the counted ones."""
    figure, axes = new_figure(11.0, 2.2 + 0.5 * len(found.entry.points), 1, 2, sharey=True)
    points = [p.point.name for p in found.entry.points]
    qs = found.entry.spec.quantiles
    for ax, quantity in zip(axes, QUANTITIES, strict=True):
        for a in (a for a in found.answers if a.quantity == quantity):
            row = points.index(a.point)
            for k, (q, first) in enumerate(zip(a.quantiles, a.first["quantiles"], strict=True)):
                y = row + 0.7 * (k - 0.5 * (len(qs) - 1)) / max(len(qs) - 1, 1)
                if q.value is None:
                    continue
                if q.low is not None and q.high is not None:
                    ax.plot(
                        [q.low - q.value, q.high - q.value], [y, y], color="0.7", linewidth=4, solid_capstyle="butt"
                    )
                ax.plot(first["apart_K"], y, markersize=5, linestyle="none", **(HOLDS if first["holds"] else FAILS))
        ax.axvline(0.0, color="0.3", linewidth=0.8)
        _name_points(ax, points, found, quantity)
        ax.set_xlabel(f"peak {quantity.removesuffix('_K')}: first order less counted, K")
    axes[0].plot([], [], color="0.7", linewidth=4, label="bounds of the counted quantile")
    axes[0].plot([], [], markersize=5, linestyle="none", label="first order, holds", **HOLDS)
    axes[0].plot([], [], markersize=5, linestyle="none", label="first order, does not hold", **FAILS)
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=3, fontsize=8)
    told = ", ".join(f"{q:g}" for q in qs)
    save_figure(figure, path, f"First order against counting, quantiles {told} from top to bottom\n{title}", axes)


def draw_drivers(path: Path, title: str, found: Dispersed) -> None:
    """Total Sobol' indices of every peak, as a map."""
    answers = [a for a in found.answers if a.indices is not None]
    words = [", ".join(told) for told in found.entry.words]
    total = np.array([a.indices.total for a in answers if a.indices is not None]).T
    figure, axes = new_figure(max(6.0 + 0.42 * len(answers), 9.0), 3.4 + 0.3 * len(words), 1)
    ax = axes[0]
    image = ax.imshow(np.clip(total, 0.0, 1.0), cmap="Blues", vmin=0.0, vmax=1.0, aspect="auto")
    for i, row in enumerate(total):
        for k, value in enumerate(row):
            if value >= 0.005:
                ax.text(k, i, f"{value:.2f}", ha="center", va="center", fontsize=7, color="w" if value > 0.55 else "k")
    ax.set_xticks(
        range(len(answers)), [f"{a.point} {place_of(a)}" for a in answers], rotation=45, ha="right",
        rotation_mode="anchor", fontsize=8,
    )  # fmt: skip
    ax.set_yticks(range(len(words)), words, fontsize=8)
    figure.colorbar(image, ax=ax, label="total Sobol' index")
    save_figure(figure, path, f"What drives the peaks\n{title}", np.array([]))
