"""Picture of a table update: heating ratio against each variable that was flown, with bands, as the founding paper's
figures 8 and 12: the table before, the flight's estimate where it flew, the table after."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from sim_heating.conditions import RATIO_VARIABLES, FloatArray
from sim_heating.parameters import SHORT
from sim_heating.plots import new_figure, save_figure
from sim_heating.table_update.evidence import basis, ratio_names
from sim_heating.table_update.posterior import Posterior, node_weights
from sim_heating.table_update.update import TableUpdate

LABELS = {
    "alpha_deg": "angle of attack, deg",
    "beta_deg": "sideslip, deg",
    "log10_re": "log10 of Reynolds number",
    "elevon_deg": "elevon, deg",
    "bodyflap_deg": "body flap, deg",
}
MARGIN = 1.0
"""How far beyond the flown excursion a panel goes, in excursions."""
SAMPLES = 241
BEFORE, FLOWN, AFTER = "0.45", "tab:orange", "tab:blue"


def draw_update(path: Path, update: TableUpdate) -> None:
    """One panel for each variable whose derivative was written (angle of attack where none was); bands are 2 sigma."""
    held = [i for i, s in enumerate(SHORT) if f"ratio.d_{s}" in update.informed.evidence.names] or [0]
    figure, axes = new_figure(1.5 + 4.7 * len(held), 4.8, 1, len(held), squeeze=False)
    for a, i in zip(axes[0], held, strict=True):
        _panel(a, update, i)
    axes[0, 0].set_ylabel("heating ratio (2 sigma bands)")
    axes[0, 0].legend(fontsize=8, loc="best")
    at = update.estimate.reference_condition
    where = ", ".join(f"{short} {getattr(at, v):.3g}" for short, v in zip(SHORT, RATIO_VARIABLES, strict=True))
    old = update.history.revision
    title = f"{update.point.name}: ratio table, revision {old} to {old + 1}\nabout {where}"
    save_figure(figure, path, title, axes)


def _panel(a: Axes, update: TableUpdate, i: int) -> None:
    axis, flown = update.history.table.axes[i], update.informed.path.x[:, i]
    width = MARGIN * (flown.max() - flown.min())
    low, high = max(axis[0], flown.min() - width), min(axis[-1], flown.max() + width)
    x = _line(update, i, np.linspace(low, high, SAMPLES))
    nodes = _line(update, i, axis[(axis >= low) & (axis <= high)])
    _table(a, i, update.before, x, nodes, "table before", BEFORE)
    _table(a, i, update.after, x, nodes, "table after", AFTER)
    inside = (x[:, i] >= flown.min()) & (x[:, i] <= flown.max())
    ratio, sigma = _estimated(update, x[inside])
    a.fill_between(x[inside, i], ratio - 2 * sigma, ratio + 2 * sigma, color=FLOWN, alpha=0.3, linewidth=0)
    a.plot(x[inside, i], ratio, color=FLOWN, linestyle="--", linewidth=1.6, label="flight estimate")
    a.set_xlabel(LABELS[RATIO_VARIABLES[i]])


def _line(update: TableUpdate, i: int, values: FloatArray) -> FloatArray:
    """(sample, 5) the reference condition with one variable replaced."""
    x = np.tile(update.estimate.reference_condition.values(), (len(values), 1))
    x[:, i] = values
    return x


def _table(a: Axes, i: int, table: Posterior, x: FloatArray, nodes: FloatArray, label: str, color: str) -> None:
    W = node_weights(table.prior.axes, x)
    ratio, sigma = W @ table.ratio.ravel(), table.sigma_along(W)
    a.fill_between(x[:, i], ratio - 2 * sigma, ratio + 2 * sigma, color=color, alpha=0.2, linewidth=0)
    a.plot(x[:, i], ratio, color=color, linewidth=1.6, label=label)
    a.plot(nodes[:, i], node_weights(table.prior.axes, nodes) @ table.ratio.ravel(), "o", color=color, markersize=4)


def _estimated(update: TableUpdate, x: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(sample,) ratio of the estimate over the first record's table, and its standard deviation."""
    names = ratio_names(update.estimate)
    table = update.records[0].ratio_table
    declared = np.zeros(len(x)) if table is None else node_weights(table.axes, x) @ table.ratio.ravel()
    B = basis(names, x, update.estimate.reference_condition.values(), declared)
    variance = np.sum((B @ update.estimate.covariance(names)) * B, axis=1)
    return declared + B @ update.estimate.values(names), np.sqrt(np.maximum(variance, 0.0))
