"""Pictures of a dispersion: peaks of all flights beside limits, first order beside counting, what drives each peak."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from sim_heating.planning.dispersed_march import QUANTITIES
from sim_heating.planning.dispersion import Answer, Dispersed, place_of
from sim_heating.plots import new_figure, save_figure

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
