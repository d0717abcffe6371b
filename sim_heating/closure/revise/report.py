"""A table update as a person reads it: the difference node by node, parameters, effects, errors.

Picture of a table update: heating ratio against each variable that was flown, with bands, as the founding paper's
figures 8 and 12: the table before, the flight's estimate where it flew, the table after.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from rich.table import Table

from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import RATIO_VARIABLES
from sim_heating.base.parameters import EFFECT_PREFIX, SHORT_NAMES
from sim_heating.base.progress import Progress, no_progress
from sim_heating.base.report.figure import new_figure, save_figure
from sim_heating.closure.revise.evidence import ratio_names
from sim_heating.closure.revise.revisions import RevisionFile
from sim_heating.closure.revise.update import (
    SURPRISING,
    TableUpdate,
    changed_nodes,
    check_target,
    errors_before_and_after,
    prepare_update,
    write_update,
)
from sim_heating.estimation.report.ratio_plot import (
    AFTER,
    BEFORE,
    LABELS,
    along_variable,
    describe_condition,
    panel_conditions,
    panel_variables,
    plot_band,
    plot_flight,
)
from sim_heating.heating.ratio.uncertainty import Posterior, estimated_ratio, node_weights
from sim_heating.inputs.record import Record, load_record

ROWS = 16
"""Nodes that are shown; the revision's file holds all."""
ROUNDING = 1e-6
"""Part of its sigma below which a value is no more than rounding."""
DRAWN = 1.0
"""A parameter of an effect that the table draws farther from the fit, in its sigma, is told."""


@dataclass(frozen=True, repr=False)
class UpdatedTables:
    """A table update with its errors before and after, and where it was written.

    update   : the estimate as evidence, the table before and after
    errors_K : by record, RMSE and largest error [K] of plain predictions before and after
    vehicle  : directory of the revised vehicle; None where nothing was written
    revision : what was written; None where nothing was
    """

    update: TableUpdate
    errors_K: dict[str, dict[str, Any]]
    vehicle: Path | None = None
    revision: RevisionFile | None = None

    def __repr__(self) -> str:
        nodes = int(np.count_nonzero(self.update.changed))
        number = "not written" if self.revision is None else f"revision {self.revision.revision}"
        return f"<UpdatedTables of {self.update.point.name}: {nodes} nodes changed, {number}>"


def update_tables(
    fit: str | os.PathLike[str],
    vehicle: str | os.PathLike[str],
    out: str | os.PathLike[str] | None = None,
    *,
    records: Sequence[str | os.PathLike[str]] = (),
    point: str | None = None,
    checks: Sequence[Record | str | os.PathLike[str]] = (),
    dry_run: bool = False,
    progress: Progress = no_progress,
) -> UpdatedTables:
    """Write the derivatives and effects of an estimate into a vehicle's tables, as a new revision with its evidence.

    fit     : an estimate.json, or the directory that holds it
    vehicle : name or directory of the vehicle
    out     : directory that takes a copy of the vehicle, which is revised; without it the vehicle itself is
    records : directories of the estimate's records, where they are no longer where the estimate says
    point   : the control point, where the estimate is of several
    checks  : further records to predict before and after
    dry_run : work everything out and write nothing
    returns : the update, its errors before and after, what was written
    raises  : InputError where estimate and vehicle do not belong together, or the place cannot be written

    >>> import sim_heating as sh
    >>> sh.update_tables(estimate_directory, "orbiter", folder / "vehicles")
    0
    """
    target = None if out is None else Path(out)
    if not dry_run:
        check_target(vehicle, target)
    update = prepare_update(fit, vehicle, records, point)
    progress(0.1, "predicting with the table before and after")
    errors = errors_before_and_after(update, [*update.records, *map(load_record, checks)])
    if dry_run:
        return UpdatedTables(update, errors)
    return UpdatedTables(update, errors, *write_update(update, target, errors, draw_update))


def update_report(update: TableUpdate, errors: dict[str, dict[str, Any]]) -> Iterator[Table | str]:
    """What is printed of an update, one after the other."""
    if np.any(update.changed):
        yield _difference(update)
    else:
        yield f"{update.point.name}: no node of the ratio table changes"
    if update.informed.evidence.names:
        yield _parameters(update)
    if update.effects.written:
        yield _effects(update)
    yield _errors(errors)
    yield from _oddities(update)


def _difference(update: TableUpdate) -> Table:
    """The nodes that move most, by their sigma before."""
    nodes = {name: np.array(values) for name, values in changed_nodes(update).items()}
    moved = np.abs(nodes["ratio_after"] - nodes["ratio_before"]) / np.maximum(nodes["sigma_before"], 1e-300)
    shown = np.sort(np.argsort(-moved, kind="stable")[:ROWS])
    many = f"{len(moved)} of {update.table.ratio.size} nodes change"
    some = f", the {len(shown)} that move most by their sigma" if len(shown) < len(moved) else ""
    old = update.history.revision
    table = Table(title=f"{update.point.name}, revision {old} to {old + 1}: {many}{some}", title_justify="left")
    for head in (*SHORT_NAMES, "ratio before", "after", "", "sigma before", "after"):
        table.add_column(head, justify="right", no_wrap=True)
    for i in shown:
        before, after = nodes["ratio_before"][i], nodes["ratio_after"][i]
        at = (f"{nodes[v][i]:g}" for v in RATIO_VARIABLES)
        change = f"{after / before - 1.0:+.1%}" if before > 0.0 else f"{after - before:+.3g}"
        sigma = (f"{nodes[f'sigma_{w}'][i]:.3g}" for w in ("before", "after"))
        table.add_row(*at, f"{before:.5g}", f"{after:.5g}", change, *sigma)
    return table


def _parameters(update: TableUpdate) -> Table:
    table = Table(title="Each parameter: as estimated, and as the table has it", title_justify="left")
    table.add_column("parameter")
    for head in ("estimate", "table before", "table after"):
        table.add_column(head, justify="right", no_wrap=True)
    for name, *pairs in update.parameter_views():
        table.add_row(name, *(_with_sigma(v, s) for v, s in zip(pairs[::2], pairs[1::2], strict=True)))
    return table


def _with_sigma(value: float, sigma: float) -> str:
    """A value with its bound; what rounding leaves of 0 is 0."""
    return f"{value if abs(value) > ROUNDING * sigma else 0.0:.4g} +- {sigma:.2g}"


def _effects(update: TableUpdate) -> Table:
    name = update.effects.path.name
    table = Table(title=f"Effects in {name}", title_justify="left")
    for head in ("effect", "parameter"):
        table.add_column(head, no_wrap=True)
    for head in ("estimate", "before", "after"):
        table.add_column(head, justify="right", no_wrap=True)
    for effect in update.effects.changes():
        for parameter, value in effect["parameters"].items():
            estimated = update.parameters.get(f"{EFFECT_PREFIX}{effect['name']}.{parameter}")
            told = _with_sigma(estimated.value, estimated.sigma) if estimated else "held"
            before = "-" if effect["before"] is None else f"{effect['before'][parameter]:.4g}"
            table.add_row(effect["name"], parameter, told, before, f"{value:.4g}")
    return table


def _errors(errors: dict[str, dict[str, Any]]) -> Table:
    table = Table(title="RMSE of plain predictions with the vehicle before and after", title_justify="left")
    table.add_column("record")
    for head in ("fit, before", "after", "holdout, before", "after"):
        table.add_column(head, justify="right", no_wrap=True)
    for name, parts in errors.items():
        every = (parts[part][when] for part in ("fit", "holdout") for when in ("before", "after"))
        table.add_row(name, *("-" if e is None else f"{e['rmse_K']:.2f} K" for e in every))
    return table


def _oddities(update: TableUpdate) -> Iterator[str]:
    """What a person should know before trusting the revision."""
    for name, why in update.not_written.items():
        yield f"{name}: not written, {why}"
    for name, moved in update.effects.moved.items():
        if moved > DRAWN:
            yield f"{name}: the table's sigma draws it {moved:.1f} sigma from the fit, along straight lines"
    for name in update.effects.missing:
        yield (
            f"{name}: is declared at {update.point.name} and was not in the fit, whose ratio may hold it too; "
            f"estimate with {EFFECT_PREFIX}{name}.*"
        )
    if update.informed.left_out:
        yield f"{update.informed.left_out} fitted samples lay outside the table and were left out"
    if update.after.p_value < SURPRISING:
        n = len(update.after.innovation)
        yield (
            "The flight is farther from the table than its sigma allows (chi-square "
            f"{update.after.chi_square:.1f} on {n}, chance {update.after.p_value:.1g}): the sigma column or the "
            "estimate's bounds are too small"
        )
    negative = int(np.count_nonzero((update.table.ratio < 0.0) & (update.history.table.ratio >= 0.0)))
    if negative:
        yield f"{negative} nodes become negative, where little but the table's reach speaks for them; see the picture"


def draw_update(path: Path, update: TableUpdate) -> None:
    """One panel for each variable whose derivative was written (angle of attack where none was); bands are 2 sigma."""
    held = panel_variables(update.informed.evidence.names)
    figure, axes = new_figure(1.5 + 4.7 * len(held), 4.8, 1, len(held), squeeze=False)
    for a, i in zip(axes[0], held, strict=True):
        _panel(a, update, i)
    axes[0, 0].set_ylabel("heating ratio (2 sigma bands)")
    axes[0, 0].legend(fontsize=8, loc="best")
    old, where = update.history.revision, describe_condition(update.estimate.reference_condition.values())
    save_figure(figure, path, f"{update.point.name}: ratio table, revision {old} to {old + 1}\nabout {where}", axes)


def _panel(a: Axes, update: TableUpdate, i: int) -> None:
    axis, flown = update.history.table.axes[i], update.informed.path.x[:, i]
    reference = update.estimate.reference_condition.values()
    x = panel_conditions(i, reference, flown, axis)
    nodes = along_variable(reference, i, axis[(axis >= x[0, i]) & (axis <= x[-1, i])])
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
