"""Heating ratios, figures 8, 12 and 14: estimates of manoeuvres with their bounds, on the declared table."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import RATIO_VARIABLES
from sim_heating.base.parameters import SHORT_NAMES
from sim_heating.base.report.figure import new_figure
from sim_heating.campaign.figures.figure_file import PaperFigure, finished
from sim_heating.campaign.figures.flown import (
    FLAP,
    POPU,
    FlownData,
    LeftOut,
    PointManoeuvre,
    fit_quality,
    plus_minus,
    ratio_part,
)
from sim_heating.estimation.fit import FitResult
from sim_heating.estimation.report.ratio_plot import LABELS, along_variable
from sim_heating.heating.effects import EffectUse
from sim_heating.heating.effects.compiled import values_along
from sim_heating.heating.ratio.lookup import table_ratios_at
from sim_heating.heating.ratio.table import RatioTable
from sim_heating.heating.ratio.uncertainty import basis, declared_ratio, declared_sigma, estimated_ratio
from sim_heating.inputs.record import Record
from sim_heating.march.ensemble import condition_history

COLORS = ("tab:blue", "tab:orange", "tab:red")
SAMPLES = 121
SIGMAS = 2.0
WIDER = 0.35
"""How much farther than the excursions the table is drawn, over their range."""
FAR_ABOVE = 2.0
"""Factor between the largest ratios of two estimates from which the lower one has a panel of its own."""
PARTLY = 0.1
"""Declared intermittency from which the turbulent table is drawn for a manoeuvre [-]."""
STEP = 0.01
"""Step of a difference quotient, in standard deviations of the parameter."""
RISING = 0.5
"""A table rises from its first node on whose slope is this part of the steepest."""
ONSET = "effect.impingement-onset.alpha_onset_deg"


def angle_of_attack(data: FlownData) -> PaperFigure:
    """Figure 8: heating ratio of the lower surface against angle of attack, the POPUs at Mach 20, 12 and 8."""
    flights = f"{data.points['lower']}, heating ratio against angle of attack"
    return _overlaid(8, f"lower surface {flights}", data, "lower", POPU, (20.0, 12.0, 8.0), ("alpha",))


def elevon(data: FlownData) -> PaperFigure:
    """Figure 12: heating ratio of the outboard elevon against its deflection, flap manoeuvres at Mach 21, 16, 12."""
    title = f"outboard elevon {data.points['elevon']}, heating ratio against deflection"
    return _overlaid(12, title, data, "elevon", FLAP, (21.0, 16.0, 12.0), ("elevon", "elevon2"))


@dataclass(frozen=True, eq=False)
class Estimate:
    """Estimate of one manoeuvre along one variable.

    flown, fit : the manoeuvre and its fit;  color : of its curves
    x          : (sample, 5) conditions over the excursion flown, the others at the reference of the fit
    ratio, sigma : (sample,) [-];  text : derivatives, with their bounds
    """

    flown: PointManoeuvre
    fit: FitResult
    color: str
    x: FloatArray
    ratio: FloatArray
    sigma: FloatArray
    text: str


def _estimate(flown: PointManoeuvre, fit: FitResult, color: str, i: int) -> Estimate:
    """The estimate of a fit along variable i."""
    names, values, covariance = ratio_part(fit)
    reference = np.array(fit.problem.reference)
    x = along_variable(reference, i, np.linspace(*_excursion(flown, RATIO_VARIABLES[i]), SAMPLES))
    ratio, sigma = estimated_ratio(names, values, covariance, reference, None, x)
    own = [k for k, name in enumerate(names) if name.startswith(f"ratio.d_{SHORT_NAMES[i]}")]
    if not own:
        return Estimate(flown, fit, color, x, ratio, sigma, f"no response to {LABELS[RATIO_VARIABLES[i]]}")
    units = ["deg2" if names[k].endswith("2") else "deg" for k in own]
    parts = [
        f"{plus_minus(values[k], np.sqrt(covariance[k, k]))} per {unit}" for k, unit in zip(own, units, strict=True)
    ]
    B = basis([names[k] for k in own], x, reference, np.zeros(len(x)))
    change, bound = B @ values[own], np.sqrt(np.sum((B @ covariance[np.ix_(own, own)]) * B, axis=1))
    silent = "" if np.any(np.abs(change) > SIGMAS * bound) else "no significant response, "
    return Estimate(flown, fit, color, x, ratio, sigma, silent + ", ".join(parts))


def _overlaid(
    number: int,
    title: str,
    data: FlownData,
    part: str,
    kinds: Sequence[str],
    machs: Sequence[float],
    terms: Sequence[str],
) -> PaperFigure:
    """Estimates of several manoeuvres in one panel, each with the declared table at its own conditions.

    Where some are far above others, these have a second panel.
    """
    i = SHORT_NAMES.index(terms[0])
    data.records_of(part)
    found, notes = [], []
    for mach, color in zip(machs, COLORS, strict=True):
        try:
            flown = data.manoeuvre(part, kinds, mach)
            found.append(_estimate(flown, data.linear_fit(flown, *terms), color, i))
        except LeftOut as reason:
            notes.append(f"Mach {mach:g}: {reason}")
    if not found:
        raise LeftOut("; ".join(notes))
    low, high = min(e.x[0, i] for e in found), max(e.x[-1, i] for e in found)
    wide = np.linspace(low - WIDER * (high - low), high + WIDER * (high - low), SAMPLES)
    least = min(e.ratio.max() for e in found)
    lower = [e for e in found if e.ratio.max() < FAR_ABOVE * least]
    panels = 2 if len(lower) < len(found) else 1
    drawn = new_figure(7.5 if panels == 1 else 11.5, 6.4, 1, panels, squeeze=False)
    tables: dict[str, dict[str, Any]] = {"table": {RATIO_VARIABLES[i]: wide}}
    for a, shown in zip(drawn[1][0], (found, lower), strict=False):
        for e in shown:
            _plot_estimate(a, e, i, wide, tables, data.turbulent_part(e.flown), band=shown is found and e is found[0])
        a.set_xlabel(LABELS[RATIO_VARIABLES[i]])
        a.set_xlim(wide[0], wide[-1])
    drawn[1][0, 0].set_ylabel(_ratio_label(found[0].flown.record))
    if panels == 2:
        shown_low = min(float(np.min(e.ratio - SIGMAS * e.sigma)) for e in lower)
        shown_high = max(float(np.max(e.ratio + SIGMAS * e.sigma)) for e in lower)
        tunnel = [v for n, v in tables["table"].items() if n in {e.flown.key for e in lower}]
        shown_low, shown_high = min(shown_low, np.min(tunnel)), max(shown_high, np.max(tunnel))
        margin = 0.08 * (shown_high - shown_low)
        drawn[1][0, 1].set_ylim(shown_low - margin, shown_high + margin)
        drawn[1][0, 1].set_title("the same, enlarged", fontsize=10)
    _legend_below(drawn)
    notes += [f"{e.flown.label}: {e.text}; {fit_quality(e.fit)}" for e in found]
    return finished(number, title, drawn, tables, tuple(notes))


def _plot_estimate(
    a: Axes,
    e: Estimate,
    i: int,
    wide: FloatArray,
    tables: dict[str, dict[str, Any]],
    turbulent: float | None,
    *,
    band: bool,
) -> None:
    """Plot an estimate with its bounds, and the declared tables at its conditions, with their band where `band`.

    turbulent : largest declared intermittency, None without declared transition; the table of turbulent flow is drawn
                where the declared flow is turbulent for a time
    """
    key, name = e.flown.key, RATIO_VARIABLES[i]
    x, columns = along_variable(np.array(e.fit.problem.reference), i, wide), tables["table"]
    for table, suffix, style in ((e.flown.record.ratio_table, "", "--"), (e.flown.record.turbulent, "_turbulent", ":")):
        if table is None or (suffix and (turbulent or 0.0) < PARTLY):
            continue
        ratio, sigma = declared_ratio(table, x), declared_sigma(table, x)
        columns[f"{key}{suffix}"] = ratio
        if band and sigma is not None:
            columns[f"{key}{suffix}_sigma"] = sigma
            a.fill_between(wide, ratio - SIGMAS * sigma, ratio + SIGMAS * sigma, color="0.6", alpha=0.16, linewidth=0)
        kind = "declared turbulent table" if suffix else "declared table"
        a.plot(wide, ratio, style, color=e.color, linewidth=1.1, label=f"{kind}, conditions of {e.flown.mach}")
    a.fill_between(
        e.x[:, i], e.ratio - SIGMAS * e.sigma, e.ratio + SIGMAS * e.sigma, color=e.color, alpha=0.25, linewidth=0
    )
    a.plot(e.x[:, i], e.ratio, color=e.color, linewidth=2.0, label=f"flight, {e.flown.label}: {e.text}")
    tables[key] = {name: e.x[:, i], "ratio": e.ratio, "sigma": e.sigma}


def _excursion(flown: PointManoeuvre, variable: str) -> tuple[float, float]:
    """Lowest and highest value of a variable over the fit of a manoeuvre."""
    conditions, (begin, end) = flown.record.conditions, flown.segment_s
    values = conditions[variable][(conditions.time_s >= begin) & (conditions.time_s <= end)]
    return float(values.min()), float(values.max())


def _ratio_label(record: Record) -> str:
    """Label of a heating ratio: declared recombination is not part of it."""
    catalytic = "" if record.declared.heating.catalysis is None else ", fully catalytic wall"
    return f"heating ratio{catalytic} (bands: 2 sigma)"


def _legend_below(drawn: tuple[Figure, np.ndarray]) -> None:
    """A legend of the first axes below all of them."""
    figure, axes = drawn
    figure.legend(*axes.flat[0].get_legend_handles_labels(), loc="outside lower left", fontsize=8, frameon=False)


# Flow impingement on the pod -----------------------------------------------------------------------------------------


def pod(data: FlownData) -> PaperFigure:
    """Figure 14: onset of the impingement on the OMS pod, by flight with a time skew, on the wind tunnel's table."""
    flown = data.manoeuvre("pod", POPU, 20.0)
    record, table = flown.record, flown.record.ratio_table
    if table is None:
        raise LeftOut(f"{record.name}: its record declares no ratio table to find an onset on")
    fits = {
        "clock skew": data.impingement_fit(flown, "clock.skew"),
        "coating": data.impingement_fit(flown, "stack.coating.thickness_factor"),
    }
    low, high = _excursion(flown, "alpha_deg")
    reference = np.array(next(iter(fits.values())).problem.reference)
    wide = along_variable(reference, 0, np.linspace(low - 8.0, high + 3.0, SAMPLES))
    drawn = new_figure(8.0, 6.2, 1)
    a = drawn[1][0]
    ratio, sigma = declared_ratio(table, wide), declared_sigma(table, wide)
    tables: dict[str, dict[str, Any]] = {"table": {"alpha_deg": wide[:, 0], "ratio": ratio}}
    if sigma is not None:
        tables["table"]["sigma"] = sigma
        a.fill_between(wide[:, 0], ratio - SIGMAS * sigma, ratio + SIGMAS * sigma, color="0.6", alpha=0.18, linewidth=0)
    onset = tunnel_onset(table, reference)
    a.plot(wide[:, 0], ratio, "--", color="0.35", linewidth=1.4, label=f"declared table: rises from {onset:g} deg")
    a.axvline(onset, color="0.35", linewidth=0.8, linestyle=":")
    notes = [f"declared table: rises from {onset:g} deg"]
    x = along_variable(reference, 0, np.linspace(low, high, SAMPLES))
    for (other, fit), color, style in zip(fits.items(), (COLORS[0], COLORS[1]), ("-", "-."), strict=True):
        value, bound = impinged_ratio(fit, record, x)
        a.fill_between(x[:, 0], value - SIGMAS * bound, value + SIGMAS * bound, color=color, alpha=0.22, linewidth=0)
        what = _onset_text(fit)
        a.plot(x[:, 0], value, style, color=color, linewidth=2.0, label=f"flight, {other} estimated: {what}")
        a.axvline(fit.parameters[ONSET][0], color=color, linewidth=0.8, linestyle=":")
        tables[other.replace(" ", "_")] = {"alpha_deg": x[:, 0], "ratio": value, "sigma": bound}
        notes.append(f"{flown.label}, {other} estimated: {what}; {fit_quality(fit)}")
    a.set_xlabel(LABELS["alpha_deg"])
    a.set_ylabel(_ratio_label(record))
    a.set_xlim(wide[0, 0], wide[-1, 0])
    top = max(float(np.max(t["ratio"])) for t in tables.values())
    a.set_ylim(-0.05 * top, 1.25 * top)  # the band of the table is far wider
    _legend_below(drawn)
    return finished(14, f"OMS pod {record.declared.control_point}, {flown.label}", drawn, tables, tuple(notes))


def _onset_text(fit: FitResult) -> str:
    """Onset, and the skew or the coating estimated with it, as text."""
    onset, sigma = fit.parameters[ONSET]
    parts = [f"onset {plus_minus(onset, sigma)} deg"]
    for name, (value, bound) in fit.parameters.items():
        if name.startswith("clock.skew"):
            parts.append(f"skew {plus_minus(value, bound)} s")
        elif name.startswith("stack.coating"):
            parts.append(f"{plus_minus(value, bound)} times as thick")
    return ", ".join(parts)


def tunnel_onset(table: RatioTable, reference: FloatArray) -> float:
    """Angle of attack from which a table rises [deg]: the first node with half of its steepest slope after it."""
    alpha = table.axes[0]
    ratio = table_ratios_at(table, along_variable(reference, 0, alpha))
    slopes = np.diff(ratio) / np.diff(alpha)
    return float(alpha[int(np.argmax(slopes > RISING * np.max(slopes)))])


def impinged_ratio(fit: FitResult, record: Record, x: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Ratio of a fit of table and impingement along conditions, and its standard deviation by difference quotients.

    x : (sample, 5) conditions
    """
    used = next(u for u in fit.problem.record_fits[0].model.effects if u.effect.name == "impingement-onset")
    names = fit.problem.record_fits[0].names
    index = [k for k, name in enumerate(names) if name.startswith(("ratio.", f"effect.{used.effect.name}."))]
    chosen, values = [names[k] for k in index], fit.fit.values[index]
    covariance, reference = fit.bounds.covariance[np.ix_(index, index)], np.array(fit.problem.reference)

    def ratio(at: FloatArray) -> FloatArray:
        of_ratio = [k for k, name in enumerate(chosen) if name.startswith("ratio.")]
        zeros = np.zeros((len(of_ratio), len(of_ratio)))
        own = [chosen[k] for k in of_ratio]
        linear, _ = estimated_ratio(own, at[of_ratio], zeros, reference, record.ratio_table, x)
        found = dict(zip(chosen, at, strict=True))
        return linear + _added(used, found, record, x)

    columns = []
    for k, sigma in enumerate(np.sqrt(np.diag(covariance))):
        step = STEP * max(float(sigma), 1e-9)
        up, down = values.copy(), values.copy()
        up[k] += step
        down[k] -= step
        columns.append((ratio(up) - ratio(down)) / (2.0 * step))
    B = np.stack(columns, axis=1)
    return ratio(values), np.sqrt(np.maximum(np.sum((B @ covariance) * B, axis=1), 0.0))


def _added(used: EffectUse, values: dict[str, float], record: Record, x: FloatArray) -> FloatArray:
    """(sample,) what an effect adds to the ratio, by its kernel, at the values of a fit."""
    given = zip(used.effect.parameters, used.values, strict=True)
    own = [values.get(f"effect.{used.effect.name}.{p.name}", v) for p, v in given]
    state = condition_history(record.conditions.at(record.conditions.time_s[:1]))[0]
    rows = np.tile(state, (len(x), 1))
    rows[:, : x.shape[1]] = x
    return values_along(replace(used, values=tuple(own)), rows, np.zeros(len(x)))
