"""Report of a table update for a person: differences node by node, parameters, effects, errors, and a picture.

The picture shows the heating ratio against each variable that was flown, with bands, as figures 8 and 12 of the
founding paper: the table before, the flight's estimate where it flew, the table after.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import RATIO_VARIABLES, SURFACES
from sim_heating.base.parameters import EFFECT_PREFIX, SHORT_NAMES
from sim_heating.base.progress import Progress, no_progress
from sim_heating.base.report.figure import new_figure, replaced_if_undrawable, save_figure
from sim_heating.base.report.table import Column, Table
from sim_heating.closure.revise.errors import errors_before_and_after, held_fits
from sim_heating.closure.revise.evidence import OF_START, ratio_names
from sim_heating.closure.revise.revision_file import HeldFit, RevisionFile
from sim_heating.closure.revise.revisions import revising
from sim_heating.closure.revise.table_effects import added_ratio
from sim_heating.closure.revise.update import TableChange, TableUpdate, check_target, prepare_update, write_update
from sim_heating.closure.verdict.policy import POLICY
from sim_heating.estimation.report import ratio_plot
from sim_heating.heating.ratio.uncertainty import Posterior, estimated_ratio, node_weights
from sim_heating.inputs.record import Record, load_records
from sim_heating.inputs.vehicle import vehicle_directory


@dataclass(frozen=True, repr=False)
class UpdatedTables:
    """A table update with its errors before and after, and where it was written.

    update   : the estimate as evidence, the table before and after
    errors_K : by record, RMSE and largest error [K] of plain predictions before and after
    held     : record of the estimate -> how well the new tables hold the fit of it
    vehicle  : directory of the revised vehicle; None where nothing was written
    revision : what was written; None where nothing was
    """

    update: TableUpdate
    errors_K: dict[str, dict[str, Any]]
    held: dict[str, HeldFit]
    vehicle: Path | None = None
    revision: RevisionFile | None = None

    @property
    def nodes_changed(self) -> int:
        """Number of nodes of the laminar ratio table that change."""
        return int(np.count_nonzero(self.update.laminar.changed))

    def __repr__(self) -> str:
        number = "not written" if self.revision is None else f"revision {self.revision.revision}"
        return f"<UpdatedTables of {self.update.point.name}: {self.nodes_changed} nodes changed, {number}>"


def update_tables(
    fit: str | os.PathLike[str],
    vehicle: str | os.PathLike[str],
    out: str | os.PathLike[str] | None = None,
    *,
    records: Sequence[str | os.PathLike[str]] = (),
    point: str | None = None,
    checks: Sequence[Record | str | os.PathLike[str]] = (),
    dry_run: bool = False,
    accept_partly: bool = False,
    root: str | os.PathLike[str] | None = None,
    progress: Progress = no_progress,
) -> UpdatedTables:
    """Write the derivatives and effects of an estimate into a vehicle's tables, as a new revision with its evidence.

    fit     : an estimate.json, or the directory that holds it
    vehicle : name or directory of the vehicle
    out     : directory that takes a copy of the vehicle, which is revised; without it the vehicle itself is
    records : directories of the estimate's records, where they are no longer where the estimate states
    point   : the control point, where the estimate is of several
    checks  : further records to predict before and after
    dry_run : work everything out and write nothing
    accept_partly : take the fit of a closed loop that ends with `partly` or `unknown`
    root    : folder that the estimate may name records in, as `load_scenario` takes it; records elsewhere are read
              where they have the digest that the estimate states
    progress: called with the stage of the work, and where another process that revises the vehicle is waited for
    returns : the update, its errors before and after, what was written
    raises  : InputError where estimate and vehicle do not belong together, or the place cannot be written

    >>> from tempfile import TemporaryDirectory
    >>> import sim_heating as sh
    >>> scenario = sh.load_scenario("scenarios/recorded_sts107.toml")
    >>> with TemporaryDirectory() as folder:
    ...     files = sh.write_records(scenario, sh.synthesize(scenario), f"{folder}/records")
    ...     fit = sh.estimate(f"{folder}/records/V09T9527", ["ratio.scale"])
    ...     files = sh.write_fit(fit, f"{folder}/fit")
    ...     updated = sh.update_tables(f"{folder}/fit", "orbiter", f"{folder}/vehicles")
    >>> updated
    <UpdatedTables of V09T9527: 80 nodes changed, revision 2>
    """
    target = None if out is None else Path(out)
    if not dry_run:
        check_target(vehicle, target)
    in_place = not dry_run and target is None
    # Locked from the reading of the tables on: whoever comes second starts from what the first one has written.
    with revising(vehicle_directory(vehicle), progress) if in_place else nullcontext():
        update = prepare_update(fit, vehicle, records, point, root, accept_partly=accept_partly)
        progress(0.1, "predicting with the table before and after")
        errors = errors_before_and_after(update, load_records([*update.records, *checks], root=root))
        fits = held_fits(update)
        if dry_run:
            return UpdatedTables(update, errors, fits)
        content = {name: h.model_dump() for name, h in fits.items()}
        return UpdatedTables(update, errors, fits, *write_update(update, target, errors, draw_update, content))


def update_report(updated: UpdatedTables) -> Iterator[Table | str]:
    """The tables and lines of an update, in the order in which they are printed."""
    update = updated.update
    for change, table_name in zip(update.changes, ("ratio table", "turbulent ratio table"), strict=False):
        if change.is_change:
            yield _difference_table(update, change, table_name)
        else:
            yield f"{update.point.name}: no node of the {table_name} changes"
        for variable, positions in change.nodes_added.items():
            added = ", ".join(f"{p:g}" for p in positions)
            yield f"{table_name}: {'nodes' if len(positions) > 1 else 'a node'} added in {variable} at {added}"
    for used in update.flight.in_table:
        yield f"{EFFECT_PREFIX}{used.effect.name}: is in the ratio table, which has nodes where it bends"
    if update.flight.evidence.names:
        yield _parameters_table(update)
    if update.effects.written:
        yield _effects_table(update)
    yield _errors_table(updated.errors_K)
    yield _held_table(updated.held)
    yield from _not_held(updated.held)
    yield from _cautions(update)


def _difference_table(update: TableUpdate, changed: TableChange, table_name: str) -> Table:
    """The nodes that change most, by their sigma before."""
    max_rows = 16  # nodes that are shown; the revision's file contains all
    nodes = {name: np.array(values) for name, values in changed.changed_nodes().items()}
    change = np.abs(nodes["ratio_after"] - nodes["ratio_before"]) / np.maximum(nodes["sigma_before"], 1e-300)
    shown = np.sort(np.argsort(-change, kind="stable")[:max_rows])
    count = f"{len(change)} of {changed.table.ratio.size} nodes of the {table_name} change"
    some = f", the {len(shown)} that change most by their sigma" if len(shown) < len(change) else ""
    old, axes = update.history.revision, zip(SHORT_NAMES, RATIO_VARIABLES, changed.table.axes, strict=True)
    # a vehicle without a control surface has one node in its deflection
    named = {name: short for short, name, axis in axes if name not in SURFACES or len(axis) > 1}
    columns = [
        *(Column(short, name, "g") for name, short in named.items()),
        Column("ratio before", "ratio_before", ".5g"),
        Column("after", "ratio_after", ".5g"),
        Column("", "change"),
        Column("sigma before", "sigma_before", ".3g"),
        Column("after", "sigma_after", ".3g"),
    ]
    rows = []
    for i in shown:
        before, after = nodes["ratio_before"][i], nodes["ratio_after"][i]
        relative = f"{after / before - 1.0:+.1%}" if before > 0.0 else f"{after - before:+.3g}"
        at = (nodes[v][i] for v in named)
        rows.append([*at, before, after, relative, nodes["sigma_before"][i], nodes["sigma_after"][i]])
    return Table(f"{update.point.name}, revision {old} to {old + 1}: {count}{some}", columns, rows)


def _parameters_table(update: TableUpdate) -> Table:
    rows = [
        [name, *(_with_sigma(v, s) for v, s in zip(pairs[::2], pairs[1::2], strict=True))]
        for name, *pairs in update.parameter_comparison()
    ]
    columns = ["parameter", "estimate", "table before", "table after"]
    return Table("Each parameter: as estimated, and by the table", columns, rows)


def _with_sigma(value: float, sigma: float) -> str:
    """A value with its bound; a value that is only rounding is shown as 0."""
    rounding = 1e-6  # part of its sigma below which a value is only rounding
    return f"{value if abs(value) > rounding * sigma else 0.0:.4g} +- {sigma:.2g}"


def _effects_table(update: TableUpdate) -> Table:
    columns: list[Column | str] = [
        "effect",
        Column("parameter", is_text=True),
        "estimate",
        Column("before", format=".4g"),
        Column("after", format=".4g"),
    ]
    rows = []
    for effect in update.effects.changes():
        for name, value in effect["parameters"].items():
            estimated = update.parameters.get(f"{EFFECT_PREFIX}{effect['name']}.{name}")
            estimate = _with_sigma(estimated.value, estimated.sigma) if estimated else "fixed"
            before = None if effect["before"] is None else effect["before"][name]
            rows.append([effect["name"], name, estimate, before, value])
    return Table(f"Effects in {update.effects.path.name}", columns, rows)


def _errors_table(errors: dict[str, dict[str, Any]]) -> Table:
    columns: list[Column | str] = [
        "record",
        Column("fit, before", "fit_before_K", ".2f", "K"),
        Column("after", "fit_after_K", ".2f", "K"),
        Column("holdout, before", "holdout_before_K", ".2f", "K"),
        Column("after", "holdout_after_K", ".2f", "K"),
    ]
    rows = []
    for name, segments in errors.items():
        errors_of_record = [segments[segment][when] for segment in ("fit", "holdout") for when in ("before", "after")]
        rows.append([name, *(None if e is None else e["rmse_K"] for e in errors_of_record)])
    return Table("RMSE of plain predictions with the vehicle before and after", columns, rows)


def _held_table(fits: Mapping[str, HeldFit]) -> Table:
    columns: list[Column | str] = [
        "record",
        Column("noise floor", "noise_floor_K", ".2f", "K"),
        Column("fit", "fit_K", ".2f", "K"),
        Column("table before", "before_K", ".2f", "K"),
        Column("after", "after_K", ".2f", "K"),
        Column("after, from entry", "from_entry_K", ".2f", "K"),
    ]
    rows = [[n, h.noise_floor_K, h.fit_K, h.before_K, h.after_K, h.from_entry_K] for n, h in fits.items()]
    return Table("RMSE on the fitted samples, from where the fit began", columns, rows)


def _not_held(fits: Mapping[str, HeldFit]) -> Iterator[str]:
    """What of the fit the tables do not hold, with what it costs."""
    for name, h in fits.items():
        if not h.is_held:
            yield f"{name}: {h.after_K:.2f} K with the tables, {h.fit_K:.2f} K with the fit; not all of it is in them:"
        for cause, loss in sorted(h.not_held.items(), key=lambda item: -item[1]):
            yield f"{name}: not in the tables: {cause}, {loss:.2f} K"


def _cautions(update: TableUpdate) -> Iterator[str]:
    """Lines that a person should read before trusting the revision."""
    reported_shift = 1.0  # shift of an effect's parameter from the fit, in its sigma, above which it is reported
    for name, reason in update.not_written.items():
        if not name.startswith(OF_START):  # temperatures at the start are the flight's own
            yield f"{name}: not written, {reason}"
    for name, shift in update.effects.shift_sigmas.items():
        if shift > reported_shift:
            yield f"{name}: the table's sigma shifts it by {shift:.1f} sigma from the fit, by a linear estimate"
    for name in update.effects.not_fitted:
        yield (
            f"{name}: is declared at {update.point.name} and was not in the fit, whose ratio may include it too; "
            f"estimate with {EFFECT_PREFIX}{name}.*"
        )
    if update.flight.outside:
        yield f"{update.flight.outside} fitted samples lay outside the table and were omitted"
    for change in update.changes:
        yield from _cautions_of_table(change)


def _cautions_of_table(change: TableChange) -> Iterator[str]:
    if change.p_value < POLICY.contradicted_p:
        yield (
            "The flight is farther from the table than its sigma allows (chi-square "
            f"{change.chi_square:.1f} on {change.freedom}, p-value {change.p_value:.1g}): the sigma column or the "
            "estimate's bounds are too small"
        )
    negative = int(np.count_nonzero((change.table.ratio < 0.0) & (change.old.ratio >= 0.0)))
    if negative:
        nodes = "1 node becomes" if negative == 1 else f"{negative} nodes become"
        yield f"{nodes} negative, within what sigma allows, by correlation with others; see the picture"


@replaced_if_undrawable
def draw_update(path: Path, update: TableUpdate) -> None:
    """One panel for each variable whose derivative was written (angle of attack where none was); bands are 2 sigma."""
    variables = ratio_plot.panel_variables(update.flight.evidence.names)
    figure, axes = new_figure(1.5 + 4.7 * len(variables), 4.8, 1, len(variables), squeeze=False)
    for a, i in zip(axes[0], variables, strict=True):
        _panel(a, update, i)
    axes[0, 0].set_ylabel("heating ratio (2 sigma bands)")
    axes[0, 0].legend(fontsize=8, loc="best")
    old, where = update.history.revision, ratio_plot.describe_condition(update.estimate.reference_condition.values())
    save_figure(figure, path, f"{update.point.name}: ratio table, revision {old} to {old + 1}\nabout {where}", axes)


def _panel(a: Axes, update: TableUpdate, i: int) -> None:
    """Ratio against one variable: table before and after, and the estimate where it was flown.

    The estimate includes the effects that the table takes; its band is that of the linear model alone.
    """
    axis, flown = update.table.axes[i], update.flight.path.x[:, i]
    reference = update.estimate.reference_condition.values()
    x = ratio_plot.panel_conditions(i, reference, flown, axis)
    nodes = ratio_plot.along_variable(reference, i, axis[(axis >= x[0, i]) & (axis <= x[-1, i])])
    _plot_table(a, i, update.laminar.before, x, nodes, "table before", ratio_plot.BEFORE)
    _plot_table(a, i, update.laminar.after, x, nodes, "table after", ratio_plot.AFTER)
    inside = x[(x[:, i] >= flown.min()) & (x[:, i] <= flown.max())]
    names = ratio_names(update.estimate)
    values, covariance = update.estimate.values(names), update.estimate.covariance(names)
    declared = update.records[0].ratio_table
    ratio, sigma = estimated_ratio(names, values, covariance, reference, declared, inside)
    for used in update.flight.in_table:
        ratio = ratio + added_ratio(used, inside, reference)
    ratio_plot.plot_flight(a, inside[:, i], ratio, sigma)
    a.set_xlabel(ratio_plot.LABELS[RATIO_VARIABLES[i]])


def _plot_table(a: Axes, i: int, table: Posterior, x: FloatArray, nodes: FloatArray, label: str, color: str) -> None:
    """A posterior of the table with its band, and its nodes."""
    W = node_weights(table.prior.axes, x)
    ratio_plot.plot_band(a, x[:, i], W @ table.ratio.ravel(), table.sigma_along(W), label, color)
    a.plot(nodes[:, i], node_weights(table.prior.axes, nodes) @ table.ratio.ravel(), "o", color=color, markersize=4)
