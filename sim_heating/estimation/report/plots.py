"""Pictures of a fit: measured against predicted, before and after."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from sim_heating.base.conditions import Conditions
from sim_heating.base.kernels.block import LOG10_RE
from sim_heating.base.report.chart import Chart
from sim_heating.base.report.figure import (
    ANGLES,
    MEASURED,
    legend_above,
    legend_label,
    mark_beyond,
    new_figure,
    replaced_if_undrawable,
    save_figure,
)
from sim_heating.base.report.page import Picture, SavedPicture
from sim_heating.estimation.inference.profile import LIMIT, Profile
from sim_heating.estimation.trend import Trend
from sim_heating.inputs.record import Record
from sim_heating.simulation.predict import Prediction
from sim_heating.simulation.report.charts import ModelCurve, record_chart, residual_limits, shown_span, with_rmse

BEFORE, AFTER = "tab:orange", "tab:blue"
DECLARED, FITTED = "declared", "declared model fitted"
"""Labels of the model before."""
DRAWN_ABOVE_DEG = 0.5
"""Range of an angle above which it is drawn."""
LAMP = "q_add_W_m2"


@replaced_if_undrawable
def draw_fit(
    path: Path, declared: Prediction, prediction: Prediction, *, label: str = DECLARED, filtered: bool = False
) -> None:
    """Draw each sensor with its residual below, declared and fitted, and the angles flown in the last panel.

    label    : of the model before
    filtered : whether the fit was one with process noise, of which the march draws the values alone

    Holdout segments are shaded.
    """
    record = prediction.record
    fitted = "fitted, plain march" if filtered else "fitted"
    figure, axes = fit_figure(record, [(declared, BEFORE, label), (prediction, AFTER, fitted)])
    title = record.declared.title or record.declared.control_point
    save_figure(figure, path, f"{record.name}: declared and fitted\n{title}", axes)


@replaced_if_undrawable
def draw_profiles(path: Path, profiles: Sequence[Profile], sigmas: Mapping[str, float]) -> None:
    """Draw D of each profile against the parameter, its 95 % interval shaded, and the parabola of its sigma.

    sigmas : one standard deviation of each parameter by its label, in its unit
    """
    figure, axes = new_figure(6.0, 2.9 * len(profiles) + 0.5, len(profiles))
    for a, p in zip(axes, profiles, strict=True):
        ends = [max(p.lower, p.values[0]), min(p.upper, p.values[-1])]
        a.axvspan(*ends, color="0.9", linewidth=0, label="95 % interval")
        a.plot(p.values, p.deviance, "o-", color=AFTER, markersize=3.5, linewidth=1.2, label="profile")
        sigma = sigmas.get(p.name, 0.0)
        if np.isfinite(sigma) and sigma > 0.0:
            x = np.linspace(p.values[0], p.values[-1], 200)
            a.plot(x, ((x - p.value) / sigma) ** 2, "--", color=BEFORE, linewidth=1.0, label="by sigma")
        a.axhline(LIMIT, color="0.3", linewidth=0.8)
        a.set_ylim(0.0, 2.0 * LIMIT)
        a.set_xlabel(p.name if p.unit == "1" else f"{p.name}, {p.unit}")
        a.set_ylabel("2 x fall of log likelihood")
        legend_above(a)
    save_figure(figure, path, "Profiles of the likelihood", axes)


def fit_figure(record: Record, curves: Sequence[tuple[Prediction, str, str]]) -> tuple[Figure, np.ndarray]:
    """Figure of measured temperatures and predictions, with the residuals of each sensor.

    curves : (prediction, colour, label); the second of three, or the first, sets the span of the residuals
    """
    shown, sensors = _shown_samples(record), [i for i, s in enumerate(record.sensors) if s.used]
    t, fitted = record.time_s[shown], record.fit_mask()
    heights = [2.0, 1.0] * len(sensors) + [1.0]
    figure, axes = new_figure(9.5, 2.4 * len(sensors) + 2.2, len(heights), sharex=True, height_ratios=heights)
    for k, i in enumerate(sensors):
        upper, lower = axes[2 * k], axes[2 * k + 1]
        upper.plot(t, record.temperatures_K()[i][shown], label="measured", rasterized=True, **MEASURED)
        for prediction, color, name in curves:
            residual = prediction.residual_K[i]
            label = legend_label(with_rmse(name, residual, fitted))
            upper.plot(t, prediction.indicated_K[i][shown], color=color, linewidth=1.3, label=label)
            lower.plot(t, residual[shown], ".", color=color, markersize=2.5, rasterized=True)
        lower.axhline(0.0, color="0.3", linewidth=0.8)
        scale = curves[1 if len(curves) > 2 else 0][0].residual_K[i][fitted]
        lower.set_ylim(*residual_limits(scale))
        for prediction, color, _ in curves:
            mark_beyond(lower, t, prediction.residual_K[i][shown], color)
        upper.set_ylabel(f"{record.sensors[i].name}\nindicated, K")
        lower.set_ylabel("residual, K")
        legend_above(upper)
    plot_flown(axes[-1], record.conditions, t[0], t[-1])
    axes[-1].set_xlabel("time, s" + ("; shaded: held out" if record.declared.segments.holdout else ""))
    for a in axes:
        shade_holdout(a, record)
    axes[-1].set_xlim(t[0], t[-1])
    figure.align_ylabels(axes)
    return figure, axes


def fit_chart(
    record: Record,
    curves: Sequence[tuple[Prediction, str, str]],
    picture: Picture | SavedPicture | None = None,
    *,
    temperatures: bool = True,
) -> Chart:
    """The chart of measured temperatures, predictions and residuals, for a page.

    curves       : (prediction, colour, label);  picture : in its place on paper
    temperatures : whether these are drawn, or the residuals alone
    """
    models = [ModelCurve(name, color, p.indicated_K, p.residual_K) for p, color, name in curves]
    return record_chart(record, models, picture, scale=1 if len(curves) > 2 else 0, temperatures=temperatures)


def shade_holdout(a: Axes, record: Record) -> None:
    """Shade the holdout segments in grey."""
    for start, end in record.declared.segments.holdout:
        a.axvspan(start, end, color="0.85", linewidth=0)


def _shown_samples(record: Record) -> NDArray[np.bool_]:
    """(sample,) those from some time before the first fitted or held-out sample to some time after the last."""
    start_s, end_s = shown_span(record)
    return np.asarray((record.time_s >= start_s) & (record.time_s <= end_s))


def plot_flown(a: Axes, conditions: Conditions, start_s: float, end_s: float) -> None:
    """Draw the angles that changed, or the known flux of a lamp where none did."""
    times = conditions.time_s[(conditions.time_s >= start_s) & (conditions.time_s <= end_s)]
    flown = conditions.at(times if len(times) else conditions.time_s)
    changed = {n: style for n, style in ANGLES.items() if np.ptp(flown[n]) > DRAWN_ABOVE_DEG}
    for name, (label, color) in changed.items():
        a.plot(flown.time_s, flown[name], color=color, label=label, linewidth=1.1)
    a.set_ylabel("deg")
    if not changed and LAMP in flown.columns:
        a.plot(flown.time_s, flown[LAMP] / 1e3, color="tab:red", label="known flux", linewidth=1.1)
        a.set_ylabel("kW/m2")
    if a.lines:
        legend_above(a)


def ratio_limits(trend: Trend) -> tuple[float, float] | None:
    """Limits of the ratio that show every segment which determines it; None where none does.

    Where h_ref is near 0, at the ends of an entry, the ratio of a segment is unknown to many times its value: one such
    segment would flatten all others.
    """
    ratio, sigma, declared = np.array([[s.ratio, s.sigma, s.declared] for s in trend.segments]).T.reshape(3, -1)
    determined = sigma < 0.5 * np.abs(ratio)
    if not np.any(determined):
        return None
    low, high = np.min((ratio - 2 * sigma)[determined]), np.max((ratio + 2 * sigma)[determined])
    # a line that the legend names lies within the axes
    low, high = min(low, np.min(declared)), max(high, np.max(declared))
    return float(low - 0.05 * (high - low)), float(high + 0.05 * (high - low))


@replaced_if_undrawable
def draw_trend(path: Path, trend: Trend) -> None:
    """Draw the heating ratio over short segments against time and Reynolds number, together with the declared table."""
    segments, record = trend.segments, trend.record
    middle = np.array([0.5 * (s.start_s + s.end_s) for s in segments])
    conditions = np.array([s.condition for s in segments])
    ratio, sigma = np.array([s.ratio for s in segments]), np.array([s.sigma for s in segments])
    declared = np.array([s.declared for s in segments])
    figure, axes = new_figure(10.5, 4.6, 1, 2, sharey=True)
    for a, x, label in ((axes[0], middle, "time, s"), (axes[1], conditions[:, LOG10_RE], "log10 of Reynolds number")):
        a.errorbar(x, ratio, 2.0 * sigma, fmt="o", color=AFTER, markersize=3, linewidth=0.8, label="segments, 2 sigma")
        if record.ratio_table is not None:
            order = np.argsort(x)
            a.plot(x[order], declared[order], color=BEFORE, linewidth=1.2, label="declared model, same conditions")
        a.set_xlabel(label)
    limits = ratio_limits(trend)
    if limits is not None:
        axes[0].set_ylim(*limits)
    axes[0].set_ylabel("heating ratio")
    axes[0].legend(fontsize=8, loc="best")
    length = segments[0].end_s - segments[0].start_s
    title = record.declared.title or record.declared.control_point
    save_figure(figure, path, f"{record.name}: segments of {length:g} s\n{title}", axes)
