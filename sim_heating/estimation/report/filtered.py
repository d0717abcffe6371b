"""Output of the filter of a fit with process noise: temperatures a priori, a posteriori and smoothed.

As figure 4 of the founding paper, a priori against a posteriori, together with the smoothed temperatures from all
samples (estimation/filter/smoother.py), all as indications of the sensors. Where the heating ratio has a disturbance,
its smoothed history.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from sim_heating.base.arrays import FloatArray
from sim_heating.base.files import write_csv
from sim_heating.base.report.figure import MEASURED, legend_above, new_figure, replaced_if_undrawable, save_figure
from sim_heating.estimation.filter.innovations import Innovations
from sim_heating.estimation.filter.smoother import Smoothed, smooth
from sim_heating.estimation.record_fit import FittedChannel, RecordFit
from sim_heating.estimation.report.plots import AFTER, plot_flown

FILES = CSV, PICTURE, RATIO_CSV = "filtered.csv", "filtered.png", "ratio_disturbance.csv"
PRIOR, POSTERIOR = "tab:orange", AFTER
SMOOTHED = "tab:green"
SIGMAS = 2.0
MOST_SENSORS = 5
"""Number of sensors that are drawn, outermost first; all are in the CSV."""


@dataclass(frozen=True, eq=False)
class FilteredSensor:
    """Temperatures of one sensor, (sample,) each.

    read_K, marched_K       : as recorded, and by the plain march, nothing assimilated [K]
    prior_K, prior_sigma_K  : before the readings of each time, with the standard deviation [K]
    posterior_K, posterior_sigma_K : after them [K]
    smoothed_K, smoothed_sigma_K   : given all readings [K]
    """

    channel: FittedChannel
    time_s: FloatArray
    read_K: FloatArray
    marched_K: FloatArray
    prior_K: FloatArray
    prior_sigma_K: FloatArray
    posterior_K: FloatArray
    posterior_sigma_K: FloatArray
    smoothed_K: FloatArray
    smoothed_sigma_K: FloatArray

    def columns(self) -> dict[str, FloatArray]:
        """Columns of a CSV, by name."""
        states = ("prior", "posterior", "smoothed")
        return {f"{n}{suffix}_K": getattr(self, f"{n}{suffix}_K") for n in states for suffix in ("", "_sigma")}


@dataclass(frozen=True, eq=False)
class FilteredHistory:
    """One record filtered and smoothed; `disturbed`: whether its heating ratio has a disturbance."""

    record_fit: RecordFit
    sensors: tuple[FilteredSensor, ...]
    smoothed: Smoothed
    disturbed: bool


def filtered_history(innovations: Innovations, values: FloatArray, record_fit: RecordFit) -> FilteredHistory:
    """One record of a fit filtered and smoothed at parameter values."""
    k = innovations.problem.record_fits.index(record_fit)
    track, filtered, order = innovations.filtered(values, k)
    smoothed, s = smooth(filtered), track.samples
    mean = [np.interp(s.time_s, smoothed.time_s, column) for column in smoothed.temperature_K.T]
    spread = [np.interp(s.time_s, smoothed.time_s, column) for column in smoothed.sigma_K.T]
    reading = np.arange(len(s.node))
    indicated = np.empty((6, len(order)))
    temperatures = [filtered.prior_K, filtered.posterior_K, np.array(mean)[s.node, reading]]
    # readings are in order of time for the filter, channels one after the other for a picture: `order` maps them
    indicated[0::2, order] = s.gain * temperatures + s.bias_K
    variances = [filtered.prior_variance_K2, filtered.posterior_variance_K2, np.array(spread)[s.node, reading] ** 2]
    indicated[1::2, order] = np.abs(s.gain) * np.sqrt(np.maximum(variances, 0.0))
    ends = np.cumsum([len(c.samples) for c in record_fit.channels])[:-1]
    marched = [m for m in innovations.problem.samples(values) if m.record_fit is record_fit]
    sensors = []
    for m, columns in zip(marched, np.split(indicated, ends, axis=1), strict=True):
        at = np.searchsorted(record_fit.record.time_s, m.time_s)
        read = record_fit.record.thermocouples[m.channel.sensor.column][at]
        sensors.append(FilteredSensor(m.channel, m.time_s, read, m.mean_K, *columns))
    return FilteredHistory(record_fit, tuple(sensors), smoothed, track.disturbance.density_1_s > 0.0)


def write_filtered(folder: Path, history: FilteredHistory) -> None:
    """Write filtered.csv, filtered.png and, where the ratio has a disturbance, ratio_disturbance.csv."""
    time_s, smoothed = history.record_fit.sample_s, history.smoothed
    columns: dict[str, FloatArray] = {"time_s": time_s}
    for s in history.sensors:
        for key, values in s.columns().items():
            columns[f"{s.channel.sensor.name}_{key}"] = np.full(len(time_s), np.nan)
            columns[f"{s.channel.sensor.name}_{key}"][s.channel.samples] = values
    write_csv(folder / CSV, columns, {"time_s": ".10g"} | {name: ".4f" for name in columns if name != "time_s"})
    if history.disturbed:
        columns = {"time_s": smoothed.time_s, "delta_ratio": smoothed.ratio, "sigma": smoothed.ratio_sigma}
        write_csv(folder / RATIO_CSV, columns)
    draw_filtered(folder / PICTURE, history)


@replaced_if_undrawable
def draw_filtered(path: Path, history: FilteredHistory) -> None:
    """Draw the temperatures of each sensor relative to the plain march, the ratio disturbance and the flight."""
    shown = sorted(history.sensors, key=lambda s: s.channel.sensor.depth_m)[:MOST_SENSORS]
    rows = len(shown) + history.disturbed + 1
    heights = [2.0] * len(shown) + [1.6] * history.disturbed + [1.0]
    figure, axes = new_figure(9.5, 1.7 * rows + 0.8, rows, sharex=True, height_ratios=heights)
    for a, s in zip(axes, shown, strict=False):
        _plot_sensor(a, s)
    legend_above(axes[0])
    if history.disturbed:
        a, smoothed = axes[len(shown)], history.smoothed
        _band(a, smoothed.time_s, smoothed.ratio, smoothed.ratio_sigma, SMOOTHED, step="post", drawstyle="steps-post")
        a.axhline(0.0, color="0.3", linewidth=0.8)
        a.set_ylabel("added to the\nheating ratio")
    record, t = history.record_fit.record, history.record_fit.sample_s
    plot_flown(axes[-1], record.conditions, float(t[0]), float(t[-1]))
    axes[-1].set_xlim(t[0], t[-1])
    axes[-1].set_xlabel(f"time, s; bands: {SIGMAS:g} sigma; dots: measured")
    figure.align_ylabels(axes)
    title = record.declared.title or record.declared.control_point
    save_figure(figure, path, f"{record.name}: {title}\nfiltered, minus the plain march at the values found", axes)


def _plot_sensor(a: Axes, s: FilteredSensor) -> None:
    t, base = s.time_s, s.marched_K
    a.plot(t, s.read_K - base, label="measured", rasterized=True, **MEASURED)
    _band(a, t, s.prior_K - base, s.prior_sigma_K, PRIOR, label="a priori")
    a.plot(t, s.posterior_K - base, color=POSTERIOR, linewidth=1.0, label="a posteriori")
    _band(a, t, s.smoothed_K - base, s.smoothed_sigma_K, SMOOTHED, label="smoothed")
    a.axhline(0.0, color="0.3", linewidth=0.8)
    shown = np.concatenate([s.read_K - base, s.prior_K - base, s.posterior_K - base, s.smoothed_K - base])
    margin = 0.08 * float(np.ptp(shown))
    a.set_ylim(float(shown.min()) - margin, float(shown.max()) + margin)
    a.set_ylabel(f"{s.channel.sensor.name}, K")


def _band(
    a: Axes, t: FloatArray, value: FloatArray, sigma: FloatArray, color: str, step: str | None = None, **line: Any
) -> None:
    low, high = value - SIGMAS * sigma, value + SIGMAS * sigma
    a.fill_between(t, low, high, color=color, alpha=0.22, linewidth=0, step=step)  # type: ignore[arg-type]
    a.plot(t, value, color=color, linewidth=1.0, **line)
