"""Heating ratio against each variable that was flown, with bands, as figures 8, 12 and 14 of the founding paper."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import ArrayLike, NDArray

from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import RATIO_VARIABLES
from sim_heating.base.parameters import AT, RATIO, SHORT_NAMES, UNITS
from sim_heating.base.report.figure import new_figure, replaced_if_undrawable, save_figure
from sim_heating.estimation.fit import FitResult
from sim_heating.estimation.inference.observability import MAGNITUDES
from sim_heating.estimation.record_fit import RecordFit
from sim_heating.heating.ratio.uncertainty import declared_ratio, declared_sigma, estimated_ratio
from sim_heating.march.ensemble import condition_history

LABELS = {
    "alpha_deg": "angle of attack, deg",
    "beta_deg": "sideslip, deg",
    "log10_re": "log10 of Reynolds number",
    "elevon_deg": "elevon, deg",
    "bodyflap_deg": "body flap, deg",
}
MARGIN = 1.0
"""Distance that a panel extends beyond the flown excursion, in excursions."""
SAMPLES = 241
COLUMNS = 3
"""Maximum number of panels in a row."""
BEFORE, FLOWN, AFTER = "0.45", "tab:orange", "tab:blue"


def panel_variables(names: tuple[str, ...]) -> list[int]:
    """Indices of the variables whose derivatives are among the names; that of angle of attack where there is none."""
    return [i for i, s in enumerate(SHORT_NAMES) if f"ratio.d_{s}" in names] or [0]


def describe_condition(reference: FloatArray) -> str:
    """A condition as text, with units."""
    units = ("" if unit == "1" else f" {unit}" for unit in UNITS)
    return ", ".join(f"{n} {x:.3g}{unit}" for n, x, unit in zip(SHORT_NAMES, reference, units, strict=True))


def derivatives_about(names: Iterable[str], reference: ArrayLike) -> str:
    """What estimates of the ratio change, and the condition that derivatives are about; empty without estimates."""
    parameters = [n.partition(AT)[0] for n in names]
    lines = []
    if MAGNITUDES[0] in parameters:
        lines.append(f"The ratio is that of the declared table times 1 + {MAGNITUDES[0]}, plus the derivatives.")
    if any(n.startswith("ratio.d_") for n in parameters):
        lines.append(f"Derivatives are about {describe_condition(np.asarray(reference, dtype=float))}.")
    return " ".join(lines)


def along_variable(reference: FloatArray, i: int, values: FloatArray) -> FloatArray:
    """(sample, 5) conditions that differ in one variable."""
    x = np.tile(reference, (len(values), 1))
    x[:, i] = values
    return x


def panel_conditions(i: int, reference: FloatArray, flown: FloatArray, axis: FloatArray | None) -> FloatArray:
    """(sample, 5) the conditions of a panel: the flown excursion of variable i and MARGIN beyond, within a table.

    flown : (sample,) of the variable;  axis : of the table, or None
    """
    width = MARGIN * (flown.max() - flown.min())
    low, high = flown.min() - width, flown.max() + width
    if axis is not None and len(axis) > 1:
        low, high = max(axis[0], low), min(axis[-1], high)
    return along_variable(reference, i, np.linspace(low, high, SAMPLES))


def plot_band(a: Axes, x: FloatArray, ratio: FloatArray, sigma: FloatArray | None, label: str, color: str) -> None:
    """Plot a ratio with its band of 2 sigma."""
    if sigma is not None:
        a.fill_between(x, ratio - 2 * sigma, ratio + 2 * sigma, color=color, alpha=0.2, linewidth=0)
    a.plot(x, ratio, color=color, linewidth=1.6, label=label)


def plot_flight(a: Axes, x: FloatArray, ratio: FloatArray, sigma: FloatArray) -> None:
    """Plot the estimate of the flight with its band of 2 sigma, over the excursion flown."""
    a.fill_between(x, ratio - 2 * sigma, ratio + 2 * sigma, color=FLOWN, alpha=0.3, linewidth=0)
    a.plot(x, ratio, color=FLOWN, linestyle="--", linewidth=1.6, label="flight estimate")


def _panels(count: int) -> tuple[Figure, NDArray[Any]]:
    """A figure with so many panels of the heating ratio, (row, column), in rows of COLUMNS at most."""
    columns = min(count, COLUMNS)
    rows = -(-count // columns)
    figure, axes = new_figure(1.5 + 3.4 * columns, 0.8 + 3.4 * rows, rows, columns, squeeze=False)
    for a in axes.flat[count:]:
        a.set_visible(False)
    for a in axes[:, 0]:
        a.set_ylabel("heating ratio (2 sigma bands)")
    return figure, axes


@replaced_if_undrawable
def draw_ratio(path: Path, fitted: FitResult, record_fit: RecordFit) -> bool:
    """Draw declared table and flight estimate of a record's control point, a panel for each derivative.

    returns : whether there was a ratio parameter to draw, and a variable of the flight that it could be drawn against
    """
    ratio_names = {p.name for p in RATIO}
    chosen = {n: int(k) for n, k in zip(record_fit.names, record_fit.index, strict=True) if n in ratio_names}
    if not chosen:
        return False
    fixed = {n: v for n, v in record_fit.model.parameters.items() if n in ratio_names and n not in chosen}
    names, index = (*chosen, *fixed), list(chosen.values())
    reference = np.array(fitted.problem.reference)
    values = np.append(fitted.fit.values[index], list(fixed.values()))
    covariance = np.zeros((len(names), len(names)))  # what is fixed has no error
    covariance[: len(index), : len(index)] = fitted.bounds.covariance[np.ix_(index, index)]
    samples = np.unique(np.concatenate([record_fit.sample_s[c.samples] for c in record_fit.channels]))
    flown = condition_history(record_fit.conditions.at(samples))[:, : len(RATIO_VARIABLES)]
    variables = [i for i in panel_variables(names) if np.ptp(flown[:, i]) > 0.0]
    if not variables:
        return False
    table = record_fit.record.ratio_table
    figure, axes = _panels(len(variables))
    for a, i in zip(axes.flat, variables, strict=False):
        x = panel_conditions(i, reference, flown[:, i], None if table is None else table.axes[i])
        if table is not None:
            plot_band(a, x[:, i], declared_ratio(table, x), declared_sigma(table, x), "declared table", BEFORE)
        inside = x[(x[:, i] >= flown[:, i].min()) & (x[:, i] <= flown[:, i].max())]
        plot_flight(a, inside[:, i], *estimated_ratio(names, values, covariance, reference, table, inside))
        a.set_xlabel(LABELS[RATIO_VARIABLES[i]])
    axes[0, 0].legend(fontsize=8, loc="best")
    effects = " without the effects" if record_fit.model.effects else ""
    title = f"{record_fit.record.declared.control_point}: heating ratio{effects}\nabout {describe_condition(reference)}"
    save_figure(figure, path, title, axes)
    return True
