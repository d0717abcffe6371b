"""The OMS pod, figures 14 and 17: onset of impingement and dependence on Reynolds number, flight over wind tunnel."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import RATIO_VARIABLES
from sim_heating.base.report.figure import legend_above, new_figure
from sim_heating.campaign.figures.figure_file import PaperFigure, Statement, finished
from sim_heating.campaign.figures.flown_data import (
    COATING,
    LAG_TIME,
    ONSET,
    POPU,
    SIGMAS,
    SKEW,
    FlownData,
    LeftOut,
    PointManoeuvre,
    agrees,
    estimated,
    fit_quality,
    plus_minus,
)
from sim_heating.campaign.figures.ratios import COLORS, SAMPLES, excursion, legend_below, ratio_label
from sim_heating.estimation.fit import FitResult
from sim_heating.estimation.report.ratio_plot import LABELS, along_variable
from sim_heating.heating.effects import EffectUse
from sim_heating.heating.effects.compiled import values_along
from sim_heating.heating.ratio.lookup import table_ratios_at
from sim_heating.heating.ratio.table import RatioTable
from sim_heating.heating.ratio.uncertainty import declared_ratio, declared_sigma, estimated_ratio
from sim_heating.inputs.record import Record
from sim_heating.march.ensemble import condition_history

FITS = {
    "skew and coating": (SKEW, COATING),
    "clock skew": (SKEW,),
    "coating": (COATING,),
    "lag and coating": (LAG_TIME, COATING),
}
"""What is estimated with the onset -> names of these parameters. The first is the paper's."""
STYLES = ("-", "--", "-.", ":")
STEP = 0.01
"""Step of a difference quotient, in standard deviations of the parameter."""
RISING = 0.5
"""A table rises from its first node on whose slope is this part of the steepest."""
PAPER_ONSET_DEG, TUNNEL_ONSET_DEG, PAPER_SKEW_S, PAPER_MIL, USUAL_MIL = 37.0, 30.0, 3.0, 20.0, 7.0
MIL_M = 2.54e-5
RE = RATIO_VARIABLES.index("log10_re")
COMPARED_DEG = 35.0
"""Angle of attack at which the table's dependence on Reynolds number is compared [deg]."""


def onset_of_impingement(data: FlownData) -> PaperFigure:
    """Figure 14: onset of the impingement on the OMS pod, by flight with a time skew, on the wind tunnel's table."""
    flown = data.manoeuvre("pod", POPU, 20.0)
    record, table = flown.record, flown.record.ratio_table
    if table is None:
        raise LeftOut(f"{record.name}: its record declares no ratio table to find an onset on")
    fits = {name: data.impingement_fit(flown, *also) for name, also in FITS.items()}
    low, high = excursion(flown, "alpha_deg")
    reference = np.array(next(iter(fits.values())).problem.reference)
    wide = along_variable(reference, 0, np.linspace(low - 8.0, high + 3.0, SAMPLES))
    drawn = new_figure(8.0, 6.6, 1)
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
    for (other, fit), color, style in zip(fits.items(), (*COLORS, "tab:green"), STYLES, strict=True):
        value, bound = impinged_ratio(fit, record, x)
        if style == STYLES[0]:
            a.fill_between(x[:, 0], value - SIGMAS * bound, value + SIGMAS * bound, color=color, alpha=0.22, lw=0)
        description = _what(fit, record)
        a.plot(x[:, 0], value, style, color=color, linewidth=1.8, label=f"flight, {other} estimated: {description}")
        a.axvline(fit.parameters[ONSET][0], color=color, linewidth=0.8, linestyle=":")
        tables[other.replace(" ", "_")] = {"alpha_deg": x[:, 0], "ratio": value, "sigma": bound}
        notes.append(f"{flown.label}, {other} estimated: {description}; {fit_quality(fit)}")
    a.set_xlabel(LABELS["alpha_deg"])
    a.set_ylabel(ratio_label(record))
    a.set_xlim(wide[0, 0], wide[-1, 0])
    top = max(float(np.max(t["ratio"])) for t in tables.values())
    a.set_ylim(-0.05 * top, 1.25 * top)  # the band of the table is far wider
    legend_below(drawn)
    title = f"OMS pod {record.declared.control_point}, {flown.label}"
    return finished(14, title, drawn, tables, tuple(notes), _statements(fits, record, onset))


def _statements(fits: dict[str, FitResult], record: Record, onset: float) -> tuple[Statement, ...]:
    """What the paper says of onset, skew and coating, by the fit that has both as the paper's has."""
    fit = fits["skew and coating"]
    value, sigma = fit.parameters[ONSET]
    skew, skew_sigma = estimated(fit, SKEW)
    mil, mil_sigma = (v * record.declared.stack.layer[0].thickness_m / MIL_M for v in estimated(fit, COATING))
    alone = fits["coating"].after[0].segment_errors()["fit"]["rmse_K"]
    both = fit.after[0].segment_errors()["fit"]["rmse_K"]
    return (
        Statement(
            87,
            "impingement on the pod begins at 37 deg in flight, at 30 deg in the tunnel",
            f"onset {plus_minus(value, sigma)} deg; the table rises from {onset:g} deg",
            agrees(value, sigma, PAPER_ONSET_DEG, onset) and onset == TUNNEL_ONSET_DEG,
        ),
        Statement(
            37,
            "the readings of the pod correlate with a time skew of 3 s",
            f"skew {plus_minus(skew, skew_sigma)} s; RMSE {both:.2f} K with it, {alone:.2f} K without",
            agrees(skew, skew_sigma, PAPER_SKEW_S, 0.0) and both < alone,
        ),
        Statement(
            35,
            "a coating of 20 mil is estimated on the recoated felt, where 7 mil is usual",
            f"{plus_minus(mil, mil_sigma)} mil, estimated with the skew",
            agrees(mil, mil_sigma, PAPER_MIL, USUAL_MIL),
        ),
    )


def _what(fit: FitResult, record: Record) -> str:
    """Onset, and what was estimated with it, as text."""
    parts = []
    for label, (value, bound) in fit.parameters.items():
        name = label.partition("@")[0]
        if name == ONSET:
            parts.append(f"onset {plus_minus(value, bound)} deg")
        elif name in (SKEW, LAG_TIME):
            parts.append(f"{'skew' if name == SKEW else 'lag'} {plus_minus(value, bound)} s")
        elif name == COATING:
            mil = record.declared.stack.layer[0].thickness_m / MIL_M
            parts.append(f"coating {plus_minus(value * mil, bound * mil)} mil")
    return ", ".join(parts)


def tunnel_onset(table: RatioTable, reference: FloatArray) -> float:
    """Angle of attack from which a table rises [deg]: the first node with half of its steepest slope after it."""
    alpha = table.axes[0]
    ratio = table_ratios_at(table, along_variable(reference, 0, alpha))
    slopes = np.diff(ratio) / np.diff(alpha)
    return float(alpha[int(np.argmax(slopes > RISING * np.max(slopes)))])


def impinged_ratio(fit: FitResult, record: Record, x: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Ratio of a fit of magnitude and impingement along conditions, and its standard deviation by difference quotients.

    x : (sample, 5) conditions
    """
    used = next(u for u in fit.problem.record_fits[0].model.effects if u.effect.name == "impingement-onset")
    names = fit.problem.record_fits[0].names
    index = [k for k, name in enumerate(names) if name.startswith(("ratio.", f"effect.{used.effect.name}."))]
    chosen, values = [names[k] for k in index], fit.fit.values[index]
    covariance, reference = fit.bounds.covariance[np.ix_(index, index)], np.array(fit.problem.reference)
    table = fit.problem.record_fits[0].record.ratio_table

    def ratio(vector: FloatArray) -> FloatArray:
        of_ratio = [k for k, name in enumerate(chosen) if name.startswith("ratio.")]
        zeros = np.zeros((len(of_ratio), len(of_ratio)))
        names_of_ratio = [chosen[k] for k in of_ratio]
        linear, _ = estimated_ratio(names_of_ratio, vector[of_ratio], zeros, reference, table, x)
        return linear + _added(used, dict(zip(chosen, vector, strict=True)), record, x)

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
    declared = zip(used.effect.parameters, used.values, strict=True)
    arguments = [values.get(f"effect.{used.effect.name}.{p.name}", v) for p, v in declared]
    state = condition_history(record.conditions.at(record.conditions.time_s[:1]))[0]
    rows = np.tile(state, (len(x), 1))
    rows[:, : x.shape[1]] = x
    return values_along(replace(used, values=tuple(arguments)), rows, np.zeros(len(x)))


# Dependence on Reynolds number ---------------------------------------------------------------------------------------


def reynolds(data: FlownData) -> PaperFigure:
    """Figure 17: the pod's ratio below the onset against Reynolds number, by a joint fit of all POPUs of all flights.

    The dependence of the wind tunnel is that of the declared table.
    """
    popus = _popus(data)
    if len(popus) < 2:
        raise LeftOut("the pod was flown through fewer than two pushover-pullups, and one has one Reynolds number")
    table, fit = popus[0].record.ratio_table, data.joint_impingement_fit(popus)
    if table is None:
        raise LeftOut(f"{popus[0].record.name}: its record declares no ratio table to compare with")
    flown = np.array([float(np.mean(_inside(popu, "log10_re"))) for popu in popus])
    x = np.linspace(flown.min() - 0.05, flown.max() + 0.05, SAMPLES)
    reference = np.array(fit.problem.reference)
    reference[0] = COMPARED_DEG
    tunnel = declared_ratio(table, along_variable(reference, RE, x))
    tunnel = tunnel / np.interp(flown[0], x, tunnel)
    of_tunnel = float(np.polyfit(x, np.log(tunnel), 1)[0])
    slope, sigma = _per_decade(fit, float(flown[0] - reference[RE]))
    away = x - flown[0]
    drawn = new_figure(7.5, 5.2, 1)
    a = drawn[1][0]
    a.plot(x, tunnel, "--", color="0.35", label=f"declared table, the tunnel's: {of_tunnel:+.2f} a decade")
    label = f"flight: {plus_minus(slope, sigma)} a decade"
    a.plot(x, 1.0 + slope * away, color=COLORS[0], linewidth=1.8, label=label)
    band = SIGMAS * sigma * np.abs(away)
    a.fill_between(x, 1.0 + slope * away - band, 1.0 + slope * away + band, color=COLORS[0], alpha=0.22, linewidth=0)
    for popu, at in zip(popus, flown, strict=True):
        a.axvline(at, color="0.5", linewidth=0.8, linestyle=":")
        text = f"{popu.flight}, {popu.mach}"
        a.annotate(text, (at, 0.02), xycoords=("data", "axes fraction"), rotation=90, fontsize=8, ha="right")
    a.set_xlabel("log10 of Reynolds number")
    a.set_ylabel(f"heating ratio below the onset,\nover that of {popus[0].mach}")
    a.set_xlim(x[0], x[-1])
    legend_above(a)
    tables = {
        "": {"log10_re": x, "tunnel": tunnel, "flight": 1.0 + slope * away, "band": band},
        "manoeuvres": {"manoeuvre": [popu.label for popu in popus], "log10_re": flown},
    }
    here = f"{plus_minus(slope, sigma)} a decade in flight, {of_tunnel:+.2f} in the table"
    paper = "the pod's heating depends less on Reynolds number in flight than in the tunnel"
    statement = Statement(88, paper, here, slope + SIGMAS * sigma < of_tunnel)
    parts = [f"onset {plus_minus(*estimated(fit, ONSET))} deg", f"lag {plus_minus(*estimated(fit, LAG_TIME))} s"]
    mil = popus[0].record.declared.stack.layer[0].thickness_m / MIL_M
    parts.append(f"coating {plus_minus(*(v * mil for v in estimated(fit, COATING)))} mil")
    joint = f"{len(popus)} manoeuvres fitted together: {', '.join(parts)}; {fit.fit.status.value}"
    notes = (f"relative change of the ratio: {here}", joint)
    title = f"OMS pod {data.points['pod']}, heating below the onset against Reynolds number"
    return finished(17, title, drawn, tables, notes, (statement,))


def _popus(data: FlownData) -> list[PointManoeuvre]:
    """Every POPU of all flights with readings of the pod, the fastest first."""
    speeds = {m.shuttle_mach for f, _ in data.records_of("pod") for m in f.manoeuvres if m.kind in POPU}
    popus: list[PointManoeuvre] = []
    for mach in sorted(speeds, reverse=True):
        try:
            popus.append(data.manoeuvre("pod", POPU, mach))
        except LeftOut:
            continue
    return popus


def _inside(flown: PointManoeuvre, column: str) -> FloatArray:
    """Values of a column during the fit of a manoeuvre."""
    flight, (begin, end) = flown.record.conditions, flown.segment_s
    return flight[column][(flight.time_s >= begin) & (flight.time_s <= end)]


def _per_decade(fit: FitResult, from_reference: float) -> tuple[float, float]:
    """Change of the ratio below the onset a decade of Reynolds number, over that ratio, and its sigma [-].

    from_reference : log10 Re of the ratio that it is over, less that of the fit's reference
    """
    names = [name.partition("@")[0] for name in fit.problem.record_fits[0].names]
    index = [names.index("ratio.d0"), names.index("ratio.d_logre")]
    d0, d_logre = fit.fit.values[index]
    ratio = d0 + d_logre * from_reference
    gradient = np.array([-d_logre / ratio**2, 1.0 / ratio - d_logre * from_reference / ratio**2])
    return float(d_logre / ratio), float(np.sqrt(gradient @ fit.bounds.covariance[np.ix_(index, index)] @ gradient))
