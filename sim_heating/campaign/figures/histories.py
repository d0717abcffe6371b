"""Time histories about manoeuvres, figures 5, 6, 7, 10, 11 and 13: measured, predicted, fitted; the angles beneath."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import Conditions
from sim_heating.base.report.figure import ANGLES, MEASURED, legend_above, mark_beyond, new_figure
from sim_heating.campaign.figures import flown_data
from sim_heating.campaign.figures.figure_file import PaperFigure, Statement, finished
from sim_heating.campaign.figures.ratios import NEAR_NOISE, TURBULENT_TIMES, excursion
from sim_heating.closure.clues.axial_force import COLUMN as AXIAL
from sim_heating.estimation.fit import FitResult
from sim_heating.estimation.report.plots import AFTER, BEFORE, DRAWN_ABOVE_DEG
from sim_heating.estimation.report.ratio_plot import along_variable
from sim_heating.heating.effects.transition import TRANSITION
from sim_heating.heating.ratio.uncertainty import declared_ratio, estimated_ratio
from sim_heating.inputs.record import Record
from sim_heating.simulation.report.plots import AFTER_S, BEFORE_S

LAMINAR = "0.55"
DIFFERENT_K = 5.0
"""Difference above which the declared model without its transition is drawn as well [K]."""
ALPHA = "alpha_deg"
LOST_S = 2.0
"""Time without readings at the start of a manoeuvre from which they were lost [s]."""
LARGE = 5.0
"""Difference over the noise floor that counts as a response [-]."""
DEFLECTIONS = ("elevon_deg", "bodyflap_deg")
AXIAL_BEFORE_S, AXIAL_STEP_DEG = 20.0, 0.1
"""Time before a manoeuvre from which the axial force is looked at [s]; angles tried for a step, how far apart [deg]."""
TURNING_DEG, NEAR_TURNING_DEG = 44.0, 1.5
"""Angle of attack of the paper above which the lower surface is turbulent at Mach 12, and how near to it agrees."""
LEAST_SPAN_K = 4.0
"""Least half height of a panel of residuals [K]."""


@dataclass(frozen=True, eq=False)
class Panel:
    """One manoeuvre of a figure with its fit."""

    flown: flown_data.PointManoeuvre
    fit: FitResult


def lower_surface(number: int, mach: float) -> Any:
    """Drawing of figure 5, 6 or 7: the lower surface in the POPU of a speed in units of 1000 ft/s."""

    def draw(data: flown_data.FlownData) -> PaperFigure:
        flown = data.manoeuvre("lower", flown_data.POPU, mach)
        panel = Panel(flown, data.linear_fit(flown, "alpha"))
        drawn = _draw(number, "lower surface", data, [panel])
        return replace(drawn, statements=LOWER_STATEMENTS[number](data, panel))

    return draw


def elevon(number: int, shown: Sequence[tuple[tuple[str, ...], float]]) -> Any:
    """Drawing of figure 10 or 11: the outboard elevon in manoeuvres given by kinds and speed."""

    def draw(data: flown_data.FlownData) -> PaperFigure:
        panels = []
        for kinds, mach in shown:
            flown = data.manoeuvre("elevon", kinds, mach)
            # a POPU is trimmed with the elevon, which the point is on
            terms = ("elevon", "elevon2") if kinds == flown_data.FLAP else ("alpha", "elevon")
            panels.append(Panel(flown, data.linear_fit(flown, *terms)))
        return _draw(number, "outboard elevon", data, panels)

    return draw


def pod(data: flown_data.FlownData) -> PaperFigure:
    """Figure 13: the side of the OMS pod in the Mach 20 POPU."""
    flown = data.manoeuvre("pod", flown_data.POPU, 20.0)
    drawn = _draw(13, "OMS pod", data, [Panel(flown, data.impingement_fit(flown, flown_data.SKEW, flown_data.COATING))])
    t, residual = _residual(data, flown)
    inside = (t >= flown.manoeuvre.start_s) & (t <= flown.manoeuvre.end_s)
    swing, floor = float(np.nanmax(residual[inside]) - np.nanmin(residual[inside])), flown.record.noise_floor_K()
    statement = Statement(
        87,
        "the pod responds to the Mach 20 manoeuvre unlike its tables",
        f"measured less declared changes by {swing:.0f} K in the manoeuvre, noise {floor:.1f} K",
        swing > LARGE * floor,
    )
    return replace(drawn, statements=(statement,))


def _residual(data: flown_data.FlownData, flown: flown_data.PointManoeuvre) -> tuple[FloatArray, FloatArray]:
    """(sample,) times of a record [s], and its outermost readings less the declared laminar model [K]."""
    i, _ = flown.outermost
    laminar = data.declared(flown.record, [TRANSITION]).indicated_K[i]
    return flown.record.time_s, flown.record.temperatures_K()[i] - laminar


def _at_mach_20(data: flown_data.FlownData, panel: Panel) -> tuple[Statement, ...]:
    """The fit of the lower surface holds the readings of the laminar manoeuvre."""
    rmse, floor = panel.fit.after[0].segment_errors()["fit"]["rmse_K"], panel.flown.record.noise_floor_K()
    return (
        Statement(
            56,
            "a ratio that is linear over a short manoeuvre correlates the readings at Mach 20",
            f"RMSE {rmse:.2f} K, noise {floor:.2f} K",
            rmse < NEAR_NOISE * floor,
        ),
    )


def _at_mach_12(data: flown_data.FlownData, panel: Panel) -> tuple[Statement, ...]:
    """Telemetry, hotter than laminar above 44 deg, step of the axial force."""
    flown, flight = panel.flown, panel.flown.record.conditions
    t, residual = _residual(data, flown)
    read = np.isfinite(residual) & (t >= flown.manoeuvre.start_s) & (t <= flown.manoeuvre.end_s)
    first = float(t[read][0])
    angle, next_angle = np.interp([first, first + 1.0], flight.time_s, flight[ALPHA])
    lost = first > flown.manoeuvre.start_s + LOST_S
    above = read & (np.interp(t, flight.time_s, flight[ALPHA]) > TURNING_DEG)
    hotter, floor = float(np.max(residual[above], initial=0.0)), flown.record.noise_floor_K()
    step = axial_step(flown.record, (flown.manoeuvre.start_s - AXIAL_BEFORE_S, flown.manoeuvre.end_s))
    return (
        Statement(
            63,
            "telemetry of the Mach 12 manoeuvre begins in its pushover",
            f"first reading {first - flown.manoeuvre.start_s:.0f} s after its start, at {angle:.1f} deg",
            bool(lost and next_angle < angle),
        ),
        Statement(
            75,
            "above 44 deg the lower surface is hotter than laminar heating makes it",
            f"up to {hotter:.0f} K hotter, noise {floor:.1f} K",
            hotter > LARGE * floor,
        ),
        Statement(
            76,
            "the axial force rises in a step above 44 deg and falls back below it",
            "no accelerometer"
            if step is None
            else f"{step.relative:+.1%} (sigma {step.sigma:.1%}) above {step.alpha_deg:.1f} deg",
            step is not None
            and step.relative > flown_data.SIGMAS * step.sigma
            and abs(step.alpha_deg - TURNING_DEG) < NEAR_TURNING_DEG,
        ),
    )


@dataclass(frozen=True)
class AxialStep:
    """A step of the axial force with angle of attack: its place [deg], its size and sigma over the force [-]."""

    alpha_deg: float
    relative: float
    sigma: float


def axial_step(record: Record, span_s: tuple[float, float]) -> AxialStep | None:
    """The step of the axial force coefficient at an angle of attack that explains most of a manoeuvre.

        a g / (rho V^2) = polynomial of second order in alpha, lines in time and deflections + step (alpha > alpha_s)

    span_s  : of the manoeuvre [s]
    returns : None without an accelerometer

    The flow turns and turns back at one angle, so that both passages have one step. The accelerometer's data are not
    those of the thermocouples: where these were lost, it was read. Source: Hertzler in the founding paper.
    """
    flight = record.conditions
    if AXIAL not in flight:
        return None
    inside = (flight.time_s >= span_s[0]) & (flight.time_s <= span_s[1])
    t, alpha = flight.time_s[inside], flight[ALPHA][inside]
    C = flight[AXIAL][inside] / (flight["rho_kg_m3"] * flight["velocity_m_s"] ** 2)[inside]
    C = C / np.mean(C)
    smooth = [t**0, t - t.mean(), alpha - alpha.mean(), (alpha - alpha.mean()) ** 2]
    smooth += [v - v.mean() for v in (flight[n][inside] for n in DEFLECTIONS) if np.ptp(v) > DRAWN_ABOVE_DEG]
    best, least = None, np.inf
    for at in np.arange(np.quantile(alpha, 0.1), np.quantile(alpha, 0.9), AXIAL_STEP_DEG):
        A = np.stack([*smooth, np.asarray(alpha > at, dtype=float)], axis=1)
        coefficients = np.linalg.lstsq(A, C, rcond=None)[0]
        misfit = float(np.sum((C - A @ coefficients) ** 2))
        if misfit < least:
            variance = misfit / (len(C) - A.shape[1]) * np.linalg.inv(A.T @ A)[-1, -1]
            best, least = AxialStep(float(at), float(coefficients[-1]), float(np.sqrt(variance))), misfit
    return best


def _at_mach_8(data: flown_data.FlownData, panel: Panel) -> tuple[Statement, ...]:
    """Turbulent flow all through: the ratio is far above the laminar table's at every angle flown."""
    flown, fit = panel.flown, panel.fit
    table = flown.record.ratio_table
    if table is None:
        return ()
    names, values, covariance = flown_data.ratio_part(fit)
    reference = np.array(fit.problem.reference)
    x = along_variable(reference, 0, np.linspace(*excursion(flown, ALPHA), 21))
    ratio, _ = estimated_ratio(names, values, covariance, reference, None, x)
    times = ratio / declared_ratio(table, x)
    rmse, floor = fit.after[0].segment_errors()["fit"]["rmse_K"], flown.record.noise_floor_K()
    return (
        Statement(
            77,
            "the flow is turbulent all through the Mach 8 manoeuvre",
            f"ratio {times.min():.1f} to {times.max():.1f} times the laminar table's; RMSE {rmse:.2f} K, noise "
            f"{floor:.2f} K",
            times.min() > TURBULENT_TIMES,
        ),
    )


LOWER_STATEMENTS = {5: _at_mach_20, 6: _at_mach_12, 7: _at_mach_8}
"""Number of a figure of the lower surface -> its statements."""


def _draw(number: int, where: str, data: flown_data.FlownData, panels: Sequence[Panel]) -> PaperFigure:
    """One column of panels a manoeuvre."""
    title = f"{where} {panels[0].flown.record.declared.control_point}, {' and '.join(p.flown.label for p in panels)}"
    drawn = new_figure(
        8.0 if len(panels) == 1 else 11.5, 7.0, 3, len(panels), squeeze=False, sharex="col", height_ratios=[2.6, 1, 1.4]
    )
    tables: dict[str, dict[str, Any]] = {}
    notes = []
    for column, panel in zip(drawn[1].T, panels, strict=True):
        suffix = panel.flown.key if len(panels) > 1 else ""
        tables |= _plot_panel(column, data, panel, suffix)
        notes.append(
            f"{panel.flown.label}, {panel.flown.record.declared.control_point}: {flown_data.fit_quality(panel.fit)}"
        )
    return finished(number, title, drawn, tables, tuple(notes))


def _plot_panel(axes: np.ndarray, data: flown_data.FlownData, panel: Panel, suffix: str) -> dict[str, dict[str, Any]]:
    """Plot one manoeuvre from top to bottom; the tables of what is drawn."""
    flown, record = panel.flown, panel.flown.record
    i, sensor = flown.outermost
    begin, end = flown.manoeuvre.start_s - BEFORE_S, flown.manoeuvre.end_s + AFTER_S
    shown = (record.time_s >= begin) & (record.time_s <= end)
    t = record.time_s[shown]
    columns = {"time_s": t, "measured_K": record.temperatures_K()[i][shown]}
    columns["declared_K"] = data.declared(record).indicated_K[i][shown]
    if data.turbulent_part(flown) is not None:
        laminar = data.declared(record, [TRANSITION]).indicated_K[i][shown]
        if np.nanmax(np.abs(laminar - columns["declared_K"])) > DIFFERENT_K:
            columns["declared_laminar_K"] = laminar
    columns["fitted_K"] = panel.fit.after[0].indicated_K[i][shown]
    columns["residual_K"] = columns["measured_K"] - columns["fitted_K"]
    top, middle, bottom = axes
    top.plot(t, columns["measured_K"], label=f"measured, {sensor.name}", **MEASURED)
    top.plot(t, columns["declared_K"], color=BEFORE, linewidth=1.3, label="declared tables")
    if "declared_laminar_K" in columns:
        laminar = columns["declared_laminar_K"]
        top.plot(t, laminar, color=LAMINAR, linewidth=1.3, linestyle="--", label="declared, laminar")
    top.plot(t, columns["fitted_K"], color=AFTER, linewidth=1.5, label="fitted")
    top.set_ylabel("thermocouple, K")
    legend_above(top)
    _plot_residual(middle, t, columns["residual_K"])
    angles = _plot_angles(bottom, record.conditions, begin, end)
    firing = record.conditions.at(t)["jets"] if "jets" in record.conditions else np.zeros(len(t))
    if np.any(firing > 0.0):
        columns["jets"] = firing
        fires = middle.fill_between(
            t,
            0.0,
            1.0,
            where=firing > 0.5,
            transform=middle.get_xaxis_transform(),
            color="tab:purple",
            alpha=0.18,
            linewidth=0,
            label="pitch jets fire",
        )
        middle.legend(handles=[fires], fontsize=8, loc="upper right")
    for a in axes:
        a.axvspan(flown.manoeuvre.start_s, flown.manoeuvre.end_s, color="tab:orange", alpha=0.14, linewidth=0)
        a.set_xlim(begin, end)
    bottom.set_xlabel("time, s; shaded: manoeuvre")
    return {suffix: columns, f"{suffix}_angles".lstrip("_"): angles}


def _plot_residual(a: Axes, t: np.ndarray, residual: np.ndarray) -> None:
    a.plot(t, residual, ".", color=AFTER, markersize=3.5)
    a.axhline(0.0, color="0.3", linewidth=0.8)
    magnitude = np.abs(residual[np.isfinite(residual)])
    span = max(LEAST_SPAN_K, 1.4 * float(np.percentile(magnitude, 97.0))) if len(magnitude) else LEAST_SPAN_K
    a.set_ylim(-span, span)
    mark_beyond(a, t, residual, AFTER)
    a.set_ylabel("measured\n- fitted, K")


def _plot_angles(a: Axes, conditions: Conditions, begin: float, end: float) -> dict[str, FloatArray]:
    """Plot the angles that change, at all times of the conditions, deflections on the right; their table."""
    inside = (conditions.time_s >= begin) & (conditions.time_s <= end)
    columns = {"time_s": conditions.time_s[inside]}
    moving = [name for name in ANGLES if np.ptp(conditions[name][inside]) > DRAWN_ABOVE_DEG]
    on_the_right = moving[1:] if moving[:1] == [ALPHA] else []
    other = a.twinx() if on_the_right else a
    lines = []
    for name in moving:
        label, color = ANGLES[name]
        columns[name] = conditions[name][inside]
        axis, style = (other, "--") if name in on_the_right else (a, "-")
        lines += axis.plot(columns["time_s"], columns[name], style, color=color, linewidth=1.3, label=label)
    a.set_ylabel(f"{ANGLES[ALPHA][0]}, deg" if ALPHA in moving else "deg")
    if on_the_right:
        other.set_ylabel("deflections, deg\n(dashed)")
    if lines:
        legend_above(a, handles=lines)
    return columns
