"""Picture of a table update: heating ratio against each variable that was flown, with bands, as the founding paper's
figures 8 and 12: the table before, the flight's estimate where it flew, the table after."""

from __future__ import annotations

from pathlib import Path

from matplotlib.axes import Axes

from sim_heating.conditions import RATIO_VARIABLES, FloatArray
from sim_heating.estimation.ratio import estimated_ratio
from sim_heating.estimation.ratio_plot import (
    AFTER,
    BEFORE,
    LABELS,
    about,
    line,
    panel_variables,
    plot_band,
    plot_flight,
    plotted,
)
from sim_heating.plots import new_figure, save_figure
from sim_heating.table_update.evidence import ratio_names
from sim_heating.table_update.posterior import Posterior, node_weights
from sim_heating.table_update.update import TableUpdate


def draw_update(path: Path, update: TableUpdate) -> None:
    """One panel for each variable whose derivative was written (angle of attack where none was); bands are 2 sigma."""
    held = panel_variables(update.informed.evidence.names)
    figure, axes = new_figure(1.5 + 4.7 * len(held), 4.8, 1, len(held), squeeze=False)
    for a, i in zip(axes[0], held, strict=True):
        _panel(a, update, i)
    axes[0, 0].set_ylabel("heating ratio (2 sigma bands)")
    axes[0, 0].legend(fontsize=8, loc="best")
    old, where = update.history.revision, about(update.estimate.reference_condition.values())
    save_figure(figure, path, f"{update.point.name}: ratio table, revision {old} to {old + 1}\nabout {where}", axes)


def _panel(a: Axes, update: TableUpdate, i: int) -> None:
    axis, flown = update.history.table.axes[i], update.informed.path.x[:, i]
    reference = update.estimate.reference_condition.values()
    x = plotted(i, reference, flown, axis)
    nodes = line(reference, i, axis[(axis >= x[0, i]) & (axis <= x[-1, i])])
    _table(a, i, update.before, x, nodes, "table before", BEFORE)
    _table(a, i, update.after, x, nodes, "table after", AFTER)
    inside = x[(x[:, i] >= flown.min()) & (x[:, i] <= flown.max())]
    names = ratio_names(update.estimate)
    values, covariance = update.estimate.values(names), update.estimate.covariance(names)
    declared = update.records[0].ratio_table
    plot_flight(a, inside[:, i], *estimated_ratio(names, values, covariance, reference, declared, inside))
    a.set_xlabel(LABELS[RATIO_VARIABLES[i]])


def _table(a: Axes, i: int, table: Posterior, x: FloatArray, nodes: FloatArray, label: str, color: str) -> None:
    W = node_weights(table.prior.axes, x)
    plot_band(a, x[:, i], W @ table.ratio.ravel(), table.sigma_along(W), label, color)
    a.plot(nodes[:, i], node_weights(table.prior.axes, nodes) @ table.ratio.ravel(), "o", color=color, markersize=4)
