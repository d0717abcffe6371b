"""Figure 9: the heating ratio over sequential five-second segments against Reynolds number, over two references.

The derivative against angle of attack is fixed at that of the manoeuvre's fit; the ratio of a segment is the one at the
angle of attack that the fit is about. Over the turbulent flat plate of Eckert the same film coefficient is divided by
another reference film coefficient.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes

from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import Conditions
from sim_heating.base.kernels.block import ALPHA, LOG10_RE
from sim_heating.base.report.figure import legend_above, mark_beyond, new_figure
from sim_heating.campaign.figures import flown_data
from sim_heating.campaign.figures.figure_file import PaperFigure, Statement, finished
from sim_heating.estimation.fit import FitResult
from sim_heating.estimation.trend import Trend
from sim_heating.heating.ratio.uncertainty import declared_ratio
from sim_heating.heating.reference.models import reference_heating
from sim_heating.inputs.points import conditions_of_record
from sim_heating.inputs.record import Record

COLORS = {flown_data.STAGNATION: "tab:blue", flown_data.ECKERT: "tab:red"}
NAMES = {flown_data.STAGNATION: "stagnation point", flown_data.ECKERT: "turbulent flat plate, Eckert"}
DETERMINED = 0.5
"""Relative standard deviation up to which a segment sets the limits of the axes [-]."""


def reynolds_trend(data: flown_data.FlownData, mach: float = 8.0) -> PaperFigure:
    """Figure 9: trend with Reynolds number about the POPU of a speed in units of 1000 ft/s."""
    flown = data.manoeuvre("lower", flown_data.POPU, mach)
    fit = data.linear_fit(flown, "alpha")
    if "ratio.d_alpha" not in fit.parameters:
        raise flown_data.LeftOut(
            f"{flown.label}: its fit gives no alpha derivative to fix; {fit.not_estimated['ratio.d_alpha']}"
        )
    trend = data.segments(flown)
    reference = np.array(fit.problem.reference)
    ratio, sigma = (np.array([getattr(s, name)[0] for s in trend.segments]) for name in ("values", "sigmas"))
    conditions = np.array([s.condition for s in trend.segments])
    at_reference = conditions.copy()
    at_reference[:, ALPHA] = reference[ALPHA]
    scale, shown = _scales(data, flown, trend, float(reference[ALPHA]))
    drawn = new_figure(5.6 * len(shown) + 0.4, 5.0, 1, len(shown), squeeze=False)
    table: dict[str, Any] = {
        "start_s": np.array([s.start_s for s in trend.segments]),
        "end_s": np.array([s.end_s for s in trend.segments]),
        "log10_re": conditions[:, LOG10_RE],
        "alpha_deg": conditions[:, ALPHA],
    }
    notes = []
    for a, name in zip(drawn[1].flat, shown, strict=True):
        factor, key = scale[name], name.replace("-", "_")
        table |= {f"{key}_ratio": ratio * factor, f"{key}_sigma": sigma * factor}
        _plot_segments(a, table["log10_re"], ratio * factor, sigma * factor, name)
        declared = _plot_tables(a, flown.record, at_reference, factor)
        table |= {f"{key}_table{kind}": of_table for kind, of_table in declared.items()}
        _limit(a, table["log10_re"], ratio * factor, sigma * factor, list(declared.values()))
        legend_above(a)
        notes.append(_trend_text(table["log10_re"], ratio * factor, sigma * factor, name))
    d_alpha, bound = fit.parameters["ratio.d_alpha"]
    notes.append(f"d_alpha fixed at {flown_data.plus_minus(d_alpha, bound)} per deg; {flown_data.fit_quality(fit)}")
    notes += [f"left out: {line}" for line in trend.left_out]
    title = (
        f"heating ratio of {data.points['lower']} in segments of {flown_data.LENGTH_S:g} s, {flown.label}, at "
        f"{reference[ALPHA]:.1f} deg"
    )
    return finished(9, title, drawn, {"": table}, tuple(notes), _statements(fit, ratio, sigma, notes[0]))


def _plot_tables(a: Axes, record: Record, conditions: FloatArray, factor: FloatArray) -> dict[str, FloatArray]:
    """Plot the declared tables of a record at the conditions of segments, times a factor; these by kind."""
    drawn = {}
    for table, kind, style in ((record.ratio_table, "", "--"), (record.turbulent, "_turbulent", ":")):
        if table is not None:
            drawn[kind] = declared_ratio(table, conditions) * factor
            label = f"declared {'turbulent ' if kind else ''}table"
            a.plot(conditions[:, LOG10_RE], drawn[kind], style, color="0.35", label=label)
    return drawn


def _statements(fit: FitResult, ratio: FloatArray, sigma: FloatArray, trend_text: str) -> tuple[Statement, ...]:
    """What the paper says of the Reynolds-number derivative, and of segments in its place."""
    derivative, bound = fit.parameters.get("ratio.d_logre", (0.0, np.inf))
    lacking = not np.isfinite(bound)
    text = (
        f"not estimated: {fit.not_estimated['ratio.d_logre']}"
        if lacking
        else f"{flown_data.plus_minus(derivative, bound)} a decade"
    )
    return (
        Statement(
            78,
            "a Reynolds-number derivative cannot be estimated in the short manoeuvre",
            text,
            lacking or abs(derivative) < flown_data.SIGMAS * bound,
        ),
        Statement(
            79,
            "segments of five seconds with the derivative in angle of attack fixed show a trend with Re",
            trend_text,
            abs(ratio[-1] - ratio[0]) > flown_data.SIGMAS * float(np.hypot(sigma[0], sigma[-1])),
        ),
    )


def _scales(
    data: flown_data.FlownData, flown: flown_data.PointManoeuvre, trend: Trend, alpha_deg: float
) -> tuple[dict[str, FloatArray], list[str]]:
    """(segment,) factors from the record's reference film coefficient to each that is shown, and these.

    alpha_deg : angle of attack of the ratios, and so of the plate
    """
    conditions = conditions_of_record(flown.record)
    length = flown.record.declared.heating.running_length_m
    scale = {flown_data.STAGNATION: np.ones(len(trend.segments))}
    if flown_data.ECKERT in data.references:
        if length is None:
            raise flown_data.LeftOut(
                f"{flown.record.name}: its record states no running_length_m, which {flown_data.ECKERT} needs; give it "
                f"in [heating], or choose --reference {flown_data.STAGNATION}"
            )
        inclined = conditions.with_columns(alpha_deg=np.full(len(conditions), alpha_deg))
        film = reference_heating(flown_data.ECKERT, inclined, running_length_m=length).h_ref_kg_m2_s
        factor = conditions["h_ref_kg_m2_s"] / film
        scale[flown_data.ECKERT] = np.array([_mean(conditions, factor, s.start_s, s.end_s) for s in trend.segments])
    return scale, list(data.references)


def _mean(conditions: Conditions, values: FloatArray, start_s: float, end_s: float) -> float:
    """Mean of a history between two times."""
    t = np.linspace(start_s, min(end_s, float(conditions.time_s[-1])), 21)
    return float(np.mean(np.interp(t, conditions.time_s, values)))


def _plot_segments(a: Axes, x: FloatArray, ratio: FloatArray, sigma: FloatArray, name: str) -> None:
    a.errorbar(
        x,
        ratio,
        flown_data.SIGMAS * sigma,
        fmt="o-",
        color=COLORS[name],
        markersize=4,
        linewidth=0.9,
        capsize=2.0,
        label="segments, 2 sigma",
    )
    a.set_xlabel("log10 of Reynolds number")
    a.set_ylabel(f"heating ratio over the {NAMES[name]}")


def _limit(a: Axes, x: FloatArray, ratio: FloatArray, sigma: FloatArray, tables: list[FloatArray]) -> None:
    """Limits by the tables and the well-determined segments; the others are marked at the edge."""
    good = sigma < DETERMINED * np.abs(ratio)
    ends = [ratio[good] - flown_data.SIGMAS * sigma[good], ratio[good] + flown_data.SIGMAS * sigma[good], *tables]
    values = np.concatenate([ratio, *ends]) if not np.any(good) else np.concatenate(ends)
    margin = 0.06 * float(np.ptp(values))
    a.set_ylim(float(values.min()) - margin, float(values.max()) + margin)
    mark_beyond(a, x, ratio, "0.3")


def _trend_text(x: FloatArray, ratio: FloatArray, sigma: FloatArray, name: str) -> str:
    """Weighted straight line through the segments as text."""
    weight = 1.0 / np.maximum(sigma, 1e-3 * np.max(np.abs(ratio))) ** 2
    mean_x, mean_r = np.average(x, weights=weight), np.average(ratio, weights=weight)
    slope = float(np.sum(weight * (x - mean_x) * (ratio - mean_r)) / np.sum(weight * (x - mean_x) ** 2))
    return (
        f"over the {NAMES[name]}: {ratio[0]:.3g} +- {sigma[0]:.2g} at log10 Re {x[0]:.2f} to {ratio[-1]:.3g} +- "
        f"{sigma[-1]:.2g} at {x[-1]:.2f}; {slope / mean_r:+.1f} of the mean per decade"
    )
