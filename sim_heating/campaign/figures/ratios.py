"""Heating ratios, figures 8 and 12: estimates of manoeuvres with their bounds, on the declared table."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import RATIO_VARIABLES
from sim_heating.base.parameters import SHORT_NAMES
from sim_heating.base.report.figure import new_figure
from sim_heating.campaign.figures.figure_file import PaperFigure, Statement, finished
from sim_heating.campaign.figures.flown_data import (
    FLAP,
    POPU,
    SIGMAS,
    FlownData,
    LeftOut,
    PointManoeuvre,
    fit_quality,
    plus_minus,
    ratio_part,
)
from sim_heating.estimation.fit import FitResult
from sim_heating.estimation.report.ratio_plot import LABELS, along_variable
from sim_heating.heating.ratio.uncertainty import basis, declared_ratio, declared_sigma, estimated_ratio
from sim_heating.inputs.record import Record

COLORS = ("tab:blue", "tab:orange", "tab:red")
SAMPLES = 121
WIDER = 0.35
"""How much farther than the excursions the table is drawn, over their range."""
FAR_ABOVE = 2.0
"""Factor between the largest ratios of two estimates from which the lower one has a panel of its own."""
PARTLY = 0.1
"""Declared intermittency from which the turbulent table is drawn for a manoeuvre [-]."""
D_ALPHA, D_ELEVON2 = "ratio.d_alpha", "ratio.d_elevon2"
ELEVON = RATIO_VARIABLES.index("elevon_deg")
TURBULENT_TIMES = 2.0
"""Ratio over that of laminar flow from which a flow counts as turbulent [-]."""
NEAR_NOISE = 1.2
"""RMSE over the noise floor up to which a straight line is valid [-]."""


def angle_of_attack(data: FlownData) -> PaperFigure:
    """Figure 8: heating ratio of the lower surface against angle of attack, the POPUs at Mach 20, 12 and 8."""
    title = f"lower surface {data.points['lower']}, heating ratio against angle of attack"
    drawn, estimates = _overlaid(8, title, data, "lower", POPU, (20.0, 12.0, 8.0), ("alpha",))
    jets = [
        f"{e.flown.label}: without the jets as an input "
        f"{plus_minus(*data.linear_fit(e.flown, 'alpha', jets=False).parameters[D_ALPHA])} per deg"
        for e in estimates
        if data.jet_names(e.flown)
    ]
    return replace(drawn, notes=(*drawn.notes, *jets), statements=_lower_statements(data, estimates))


def _lower_statements(data: FlownData, estimates: Sequence[Estimate]) -> tuple[Statement, ...]:
    """What the paper says of the derivatives in angle of attack at Mach 20, 12 and 8."""
    by_mach = {round(e.flown.manoeuvre.shuttle_mach): e for e in estimates}
    statements = []
    if (at_20 := by_mach.get(20)) is not None:
        slope, sigma = at_20.fit.parameters[D_ALPHA]
        tunnel, tunnel_sigma = _table_slope(at_20)
        floor, quality = at_20.flown.record.noise_floor_K(), _rmse(at_20.fit)
        statements += [
            Statement(
                74,
                "at Mach 20 the trend in angle of attack is that of the wind tunnel",
                f"{plus_minus(slope, sigma)} per deg, table {tunnel:.5f} +- {tunnel_sigma:.5f}",
                abs(slope - tunnel) < SIGMAS * np.hypot(sigma, tunnel_sigma),
            ),
            Statement(
                74,
                "a straight line in angle of attack is valid at Mach 20",
                f"RMSE {quality:.2f} K, noise {floor:.2f} K",
                quality < NEAR_NOISE * floor,
            ),
        ]
        if data.jet_names(at_20.flown):
            false, false_sigma = data.linear_fit(at_20.flown, "alpha", jets=False).parameters[D_ALPHA]
            statements.append(
                Statement(
                    67,
                    "pitch jets disturb the measured density, and so the derivative in angle of attack",
                    f"{plus_minus(false, false_sigma)} per deg without the jets as an input, "
                    f"{plus_minus(slope, sigma)} with them",
                    abs(false - slope) > SIGMAS * sigma,
                )
            )
        if (at_12 := by_mach.get(12)) is not None:
            lower, lower_sigma = at_12.fit.parameters[D_ALPHA]
            statements.append(
                Statement(
                    75,
                    "at Mach 12 the derivative in angle of attack is lower than at Mach 20",
                    f"{plus_minus(lower, lower_sigma)} per deg against {plus_minus(slope, sigma)}",
                    lower + np.hypot(lower_sigma, sigma) < slope,
                )
            )
        if (at_8 := by_mach.get(8)) is not None:
            middle = SAMPLES // 2
            statements.append(
                Statement(
                    77,
                    "at Mach 8 the ratio is larger than at Mach 20, and so is its bound",
                    f"{plus_minus(at_8.ratio[middle], at_8.sigma[middle])} against "
                    f"{plus_minus(at_20.ratio[middle], at_20.sigma[middle])}",
                    bool(at_8.ratio[middle] > at_20.ratio[middle] and at_8.sigma[middle] > at_20.sigma[middle]),
                )
            )
    return tuple(statements)


def _rmse(fit: FitResult) -> float:
    """RMSE of a fit [K]."""
    return float(fit.after[0].segment_errors()["fit"]["rmse_K"])


def _table_slope(e: Estimate) -> tuple[float, float]:
    """Slope of the declared table over the excursion of an estimate, and its standard deviation [1/deg].

    The error of a table is taken to be a factor, as its sigma is for the most part.
    """
    table = e.flown.record.ratio_table
    if table is None:
        return np.nan, np.nan
    ratio, sigma = declared_ratio(table, e.x), declared_sigma(table, e.x)
    slope = float(np.polyfit(e.x[:, 0], ratio, 1)[0])
    return slope, 0.0 if sigma is None else slope * float(np.mean(sigma / ratio))


def elevon(data: FlownData) -> PaperFigure:
    """Figure 12: heating ratio of the outboard elevon against its deflection, flap manoeuvres at Mach 21, 16, 12."""
    title = f"outboard elevon {data.points['elevon']}, heating ratio against deflection"
    drawn, estimates = _overlaid(12, title, data, "elevon", FLAP, (21.0, 16.0, 12.0), ("elevon", "elevon2"))
    return replace(drawn, statements=_elevon_statements(estimates))


def _elevon_statements(estimates: Sequence[Estimate]) -> tuple[Statement, ...]:
    """What the paper says of the elevon's heating at Mach 21, 16 and 12."""
    by_mach = {round(e.flown.manoeuvre.shuttle_mach): e for e in estimates}
    statements = []
    if (at_21 := by_mach.get(21)) is not None:
        curved, sigma = at_21.fit.parameters[D_ELEVON2]
        statements.append(
            Statement(
                80,
                "at Mach 21 elevon heating is nonlinear in deflection, of second order",
                f"second-order term {plus_minus(curved, sigma)} per deg2",
                curved > SIGMAS * sigma,
            )
        )
    if (at_16 := by_mach.get(16)) is not None:
        statements.append(
            Statement(
                82,
                "at Mach 16 the elevon's thermocouple does not respond, the derivative is zero",
                at_16.text,
                at_16.silent,
            )
        )
    if (at_12 := by_mach.get(12)) is not None:
        low, high = float(at_12.sigma[0]), float(at_12.sigma[at_12.x[:, ELEVON] >= 0.0].min())
        statements.append(
            Statement(
                83,
                "at Mach 12 the elevon's data correlate poorly at negative deflections",
                f"bound {low:.2g} at {at_12.x[0, ELEVON]:.1f} deg, {high:.2g} at best above 0",
                low > high,
            )
        )
        if at_21 is not None:
            times = float(np.median(at_12.ratio) / np.median(at_21.ratio))
            statements.append(
                Statement(
                    83,
                    "at Mach 12 the flow on the elevon is turbulent",
                    f"ratio {times:.1f} times that of Mach 21",
                    times > TURBULENT_TIMES,
                )
            )
    return tuple(statements)


@dataclass(frozen=True, eq=False)
class Estimate:
    """Estimate of one manoeuvre along one variable.

    flown, fit : the manoeuvre and its fit;  color : of its curves
    x          : (sample, 5) conditions over the excursion flown, the others at the reference of the fit
    ratio, sigma : (sample,) [-];  text : derivatives, with their bounds;  silent : none beyond its bound
    """

    flown: PointManoeuvre
    fit: FitResult
    color: str
    x: FloatArray
    ratio: FloatArray
    sigma: FloatArray
    text: str
    silent: bool


def _estimate(flown: PointManoeuvre, fit: FitResult, color: str, i: int) -> Estimate:
    """The estimate of a fit along variable i."""
    names, values, covariance = ratio_part(fit)
    reference = np.array(fit.problem.reference)
    x = along_variable(reference, i, np.linspace(*excursion(flown, RATIO_VARIABLES[i]), SAMPLES))
    ratio, sigma = estimated_ratio(names, values, covariance, reference, None, x)
    responding = [k for k, name in enumerate(names) if name.startswith(f"ratio.d_{SHORT_NAMES[i]}")]
    if not responding:
        return Estimate(flown, fit, color, x, ratio, sigma, f"no response to {LABELS[RATIO_VARIABLES[i]]}", True)
    units = ["deg2" if names[k].endswith("2") else "deg" for k in responding]
    parts = [
        f"{plus_minus(values[k], np.sqrt(covariance[k, k]))} per {unit}"
        for k, unit in zip(responding, units, strict=True)
    ]
    B = basis([names[k] for k in responding], x, reference, np.zeros(len(x)))
    change, bound = (
        B @ values[responding],
        np.sqrt(np.sum((B @ covariance[np.ix_(responding, responding)]) * B, axis=1)),
    )
    silent = not np.any(np.abs(change) > SIGMAS * bound)
    text = ("no significant response, " if silent else "") + ", ".join(parts)
    return Estimate(flown, fit, color, x, ratio, sigma, text, silent)


def _overlaid(
    number: int,
    title: str,
    data: FlownData,
    region: str,
    kinds: Sequence[str],
    machs: Sequence[float],
    terms: Sequence[str],
) -> tuple[PaperFigure, list[Estimate]]:
    """Estimates of several manoeuvres in one panel, and these, each with the declared table at its own conditions.

    Where some are far above others, these have a second panel.
    """
    i = SHORT_NAMES.index(terms[0])
    estimates, notes = _estimates(data, region, kinds, machs, terms)
    ends = np.array([e.x[[0, -1], i] for e in estimates])
    low, high = ends[:, 0].min(), ends[:, 1].max()
    wide = np.linspace(low - WIDER * (high - low), high + WIDER * (high - low), SAMPLES)
    least = min(e.ratio.max() for e in estimates)
    lower = [e for e in estimates if e.ratio.max() < FAR_ABOVE * least]
    panels = [estimates] if len(lower) == len(estimates) else [estimates, lower]
    drawn = new_figure((7.5, 11.5)[len(panels) - 1], 6.4, 1, len(panels), squeeze=False)
    tables: dict[str, dict[str, Any]] = {"table": {RATIO_VARIABLES[i]: wide}}
    for a, shown, with_band in zip(drawn[1][0], panels, (estimates[0], None), strict=False):
        for e in shown:
            _plot_estimate(a, e, i, wide, tables, data.turbulent_part(e.flown), band=e is with_band)
        a.set_xlabel(LABELS[RATIO_VARIABLES[i]])
        a.set_xlim(wide[0], wide[-1])
    drawn[1][0, 0].set_ylabel(ratio_label(estimates[0].flown.record))
    if len(panels) == 2:
        _enlarge(drawn[1][0, 1], lower, tables["table"])
    legend_below(drawn)
    notes += [f"{e.flown.label}: {e.text}; {fit_quality(e.fit)}" for e in estimates]
    return finished(number, title, drawn, tables, tuple(notes)), estimates


def _estimates(
    data: FlownData, region: str, kinds: Sequence[str], machs: Sequence[float], terms: Sequence[str]
) -> tuple[list[Estimate], list[str]]:
    """Estimates of the manoeuvres near Mach numbers, and why others are left out; LeftOut where all are."""
    data.records_of(region)
    estimates, notes = [], []
    for mach, color in zip(machs, COLORS, strict=True):
        try:
            flown = data.manoeuvre(region, kinds, mach)
            fit = data.linear_fit(flown, *terms)
            estimates.append(_estimate(flown, fit, color, SHORT_NAMES.index(terms[0])))
        except LeftOut as reason:
            notes.append(f"Mach {mach:g}: {reason}")
    if not estimates:
        raise LeftOut("; ".join(notes))
    return estimates, notes


def _enlarge(a: Axes, shown: Sequence[Estimate], tables: Mapping[str, FloatArray]) -> None:
    """Limit a panel to the bounds of its estimates and to their declared tables, by the key of the manoeuvre."""
    of_table = [tables[e.flown.key] for e in shown if e.flown.key in tables]
    low = min(float(np.min(e.ratio - SIGMAS * e.sigma)) for e in shown)
    high = max(float(np.max(e.ratio + SIGMAS * e.sigma)) for e in shown)
    low, high = min(low, np.min(of_table)), max(high, np.max(of_table))
    margin = 0.08 * (high - low)
    a.set_ylim(low - margin, high + margin)
    a.set_title("the same, enlarged", fontsize=10)


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


def excursion(flown: PointManoeuvre, variable: str) -> tuple[float, float]:
    """Lowest and highest value of a variable over the fit of a manoeuvre."""
    conditions, (begin, end) = flown.record.conditions, flown.segment_s
    values = conditions[variable][(conditions.time_s >= begin) & (conditions.time_s <= end)]
    return float(values.min()), float(values.max())


def ratio_label(record: Record) -> str:
    """Label of a heating ratio: declared recombination is not part of it."""
    catalytic = "" if record.declared.heating.catalysis is None else ", fully catalytic wall"
    return f"heating ratio{catalytic} (bands: 2 sigma)"


def legend_below(drawn: tuple[Figure, np.ndarray]) -> None:
    """A legend of the first axes below all of them."""
    figure, axes = drawn
    figure.legend(*axes.flat[0].get_legend_handles_labels(), loc="outside lower left", fontsize=8, frameon=False)
