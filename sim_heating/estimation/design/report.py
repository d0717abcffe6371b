"""A design from scenario to files: design.json, bounds.csv, pictures and a page.

The pictures show the planned and the optimal manoeuvre, the bounds along each number, and those with other instruments.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.ticker import LogLocator, NullLocator, StrMethodFormatter

from sim_heating.base.arrays import FloatArray
from sim_heating.base.files import finite_or_none, output_directory, write_json, write_text_atomic
from sim_heating.base.files.package import package_version
from sim_heating.base.parameters import PRESSURE_FACTOR
from sim_heating.base.progress import Progress, no_progress
from sim_heating.base.report.figure import ANGLES, new_figure, replaced_if_undrawable, save_figure
from sim_heating.base.report.page import Page, SavedPicture, Section, write_page
from sim_heating.base.report.table import Column, Table
from sim_heating.credibility.section import credibility_section
from sim_heating.credibility.statement import Statement
from sim_heating.estimation.design.check import RepeatedFits, repeated_fits
from sim_heating.estimation.design.credibility import credibility_of_design
from sim_heating.estimation.design.information import Experiment, design_criterion
from sim_heating.estimation.design.instruments import InstrumentVariant, instrumentation
from sim_heating.estimation.design.locations import Location, as_json, locations
from sim_heating.estimation.design.planned_flight import SEARCH_TRAJECTORY, PlannedFlight, Planner
from sim_heating.estimation.design.search import BoundsSweep, DesignSearch, DesignSearchResult
from sim_heating.inputs.scenario import Scenario, load_scenario, with_design
from sim_heating.simulation.run import MANOEUVRE_VARIABLE
from sim_heating.trajectory.flight import Window

FILES = NAME, BOUNDS, DESIGN, SWEEPS, INSTRUMENTS, PAGE = (
    "design.json",
    "bounds.csv",
    "design.png",
    "sweeps.png",
    "instruments.png",
    "report.html",
)
SWEEP_POINTS = 7


@dataclass(frozen=True, eq=False)
class SourceCheck:
    """Planned and best design flown with the scenario's own source: margins, and (wanted,) bounds."""

    source: str
    planned: PlannedFlight
    planned_sigma: FloatArray
    best: PlannedFlight
    best_sigma: FloatArray


@dataclass(frozen=True, eq=False, repr=False)
class DesignResult:
    """A finished design.

    instruments : bounds of the best design with other instruments, as declared first
    locations   : the scenario's control points by what one thermocouple there tells of the best design, the best first
    checked     : flown with the scenario's own source, where that is not the 3-DOF entry
    fitted      : errors of simulated fits of the best design and the bounds for them, where requested
    """

    scenario: Scenario
    planner: Planner
    search: DesignSearchResult
    sweeps: list[BoundsSweep]
    instruments: list[InstrumentVariant]
    locations: list[Location]
    checked: SourceCheck | None
    fitted: tuple[RepeatedFits, Experiment] | None

    def __repr__(self) -> str:
        bounds = zip(self.targets, self.search.best_experiment.sigma(self.targets), strict=True)
        sigmas = ", ".join(f"sigma({name})={sigma:.2g}" for name, sigma in bounds)
        return f"<DesignResult of {self.planner.point.name}: {sigmas}; {len(self.search.designs)} designs>"

    @property
    def targets(self) -> tuple[str, ...]:
        """Parameters that the manoeuvres are to estimate."""
        return self.planner.targets

    @cached_property
    def credibility(self) -> Statement:
        """What supports the design, factor by factor."""
        best = self.search.best
        flown = (best,) if self.checked is None else (best, self.checked.best)
        return credibility_of_design(self.planner, best, self.search.best_experiment, flown, self.fitted)


def design(
    scenario: Scenario | str | os.PathLike[str],
    *,
    evaluations: int | None = None,
    repetitions: int = 0,
    progress: Progress = no_progress,
) -> DesignResult:
    """Search the most informative manoeuvres of a scenario, and the bounds with other instruments.

    scenario    : a scenario with [design], or the path of its file
    evaluations : number of designs that the search evaluates; by default the scenario's
    repetitions : number of simulated fits of the best design that check its bounds
    raises      : InputError where there is nothing to design, RunError where no design keeps the limits

    >>> import sim_heating as sh
    >>> sh.design("scenarios/design_first_look.toml", evaluations=4)
    <DesignResult of BODYFLAP: sigma(ratio.d_elevon)=0.00012; 4 designs>
    """
    scenario = load_scenario(scenario)
    if evaluations is not None:
        scenario = with_design(scenario, {"evaluations": evaluations})
    planner = Planner(scenario)
    progress(0.0, "flying as planned")
    search = DesignSearch(planner)
    result = search.run(lambda f, text: progress(0.6 * f, text))
    progress(0.6, "bounds along each number")
    sweeps = search.sweep(result, SWEEP_POINTS)
    progress(0.8, "other instruments")
    instruments = instrumentation(planner, result.best, result.names, result.priors)
    places = locations(planner, result.best)
    progress(0.85, "checking")
    fitted = None
    if repetitions:
        fitted = _repeat_fits(planner, result, repetitions, lambda f, text: progress(0.9 + 0.1 * f, text))
    checked = _check_with_source(planner, result)
    return DesignResult(scenario, planner, result, sweeps, instruments, places, checked, fitted)


def _check_with_source(planner: Planner, result: DesignSearchResult) -> SourceCheck | None:
    source = planner.scenario.declared.trajectory.source
    if source == SEARCH_TRAJECTORY["source"]:
        return None
    planned, best = (planner.fly(p.manoeuvres, searched=False) for p in (result.planned, result.best))
    sigma = [planner.experiment(p, result.names, result.priors).sigma(planner.targets) for p in (planned, best)]
    return SourceCheck(source, planned, sigma[0], best, sigma[1])


def _repeat_fits(
    planner: Planner, result: DesignSearchResult, repetitions: int, progress: Progress
) -> tuple[RepeatedFits, Experiment]:
    """Simulated fits of the best design, with the surface pressure known in them and in the bounds."""
    record, start = planner.record(result.best, planner.instruments)
    # a fit is linear in the factor on the surface pressure: known in both, that cannot spoil the comparison
    names = tuple(n for n in result.names if n != PRESSURE_FACTOR.name)
    experiment = planner.experiment(result.best, names, result.priors)
    fits = repeated_fits(
        record, experiment, effects=planner.effects, start=start, repetitions=repetitions, progress=progress
    )
    return fits, experiment


def summary(designed: DesignResult) -> dict[str, Any]:
    """The contents of design.json."""
    result, names, declared = designed.search, designed.targets, designed.planner.design
    planned, best = result.planned_experiment, result.best_experiment
    return {
        "format": "design/1",
        "scenario": designed.scenario.title,
        "vehicle": designed.scenario.vehicle.name,
        "control_point": designed.planner.point.name,
        "criterion": declared.criterion,
        "criterion_over_planned": design_criterion(
            declared.criterion, best.covariance(names), planned.covariance(names)
        ),
        "unknowns": {p.name: finite_or_none(p.sigma) for p in best.unknowns},
        "parameters": {
            name: {
                "unit": best.unknowns[best.names.index(name)].unit,
                "planned_sigma": float(planned.sigma(names)[k]),
                "optimal_sigma": float(best.sigma(names)[k]),
                "after_flights": {str(n): float(best.sigma(names, n)[k]) for n in declared.flights},
            }
            for k, name in enumerate(names)
        },
        "planned": _flight(result.planned),
        "optimal": _flight(result.best),
        "varied": [v.model_dump() for v in result.vary],
        "tried": len(result.designs),
        "kept_limits": sum(t.feasible for t in result.designs),
        "instruments": [
            {"kind": v.kind, "what": v.change, "sigma": _by_name(names, v.sigma)} for v in designed.instruments
        ],
        "locations": [as_json(at, names) for at in designed.locations],
        "interfaces": designed.planner.interfaces(result.best.flight),
        "checked": _check_summary(designed),
        "fitted": _fit_summary(designed),
        "notes": notes(designed),
        "program": f"sim-heating {package_version()}",
        "credibility": designed.credibility.as_json(),
    }


def _by_name(names: tuple[str, ...], sigma: FloatArray) -> dict[str, float | None]:
    """By name; None where a parameter is not identified."""
    return {n: finite_or_none(s) for n, s in zip(names, sigma, strict=True)}


def _flight(flown: PlannedFlight) -> dict[str, Any]:
    return {
        "manoeuvres": [m.model_dump(exclude_none=True) for m in flown.manoeuvres],
        "windows_s": [[w.start_s, w.end_s] for w in flown.flight.windows],
        "margins": flown.margins,
        "keeps_limits": flown.feasible,
    }


def _check_summary(designed: DesignResult) -> dict[str, Any] | None:
    checked = designed.checked
    if checked is None:
        return None
    pairs = {"planned": (checked.planned, checked.planned_sigma), "optimal": (checked.best, checked.best_sigma)}
    return {"source": checked.source} | {
        which: {"sigma": _by_name(designed.targets, sigma), "keeps_limits": flown.feasible, "margins": flown.margins}
        for which, (flown, sigma) in pairs.items()
    }


def _fit_summary(designed: DesignResult) -> dict[str, Any] | None:
    if designed.fitted is None:
        return None
    fits, experiment = designed.fitted
    return {
        "fits": len(fits.error),
        "failed": fits.failed,
        "rms_error": _by_name(designed.targets, fits.rms_error(designed.targets)),
        "predicted": _by_name(designed.targets, experiment.sigma(designed.targets)),
    }


def notes(designed: DesignResult) -> list[str]:
    """Notes on limits that a design or its plan exceeds, one line each."""
    lines = designed.planner.over_limit()
    if not designed.search.planned.feasible:
        lines += [f"as planned: {line}" for line in designed.search.planned.exceeded_limits]
    checked = designed.checked
    if checked is not None and not checked.best.feasible:
        lines += [f"optimal, flown in {checked.source}: {line}" for line in checked.best.exceeded_limits]
    return lines


def changes(contents: dict[str, Any]) -> list[str]:
    """What the search varied, as planned and at its optimum, one line each.

    contents : of design.json
    """
    lines = []
    for varied in contents["varied"]:
        number, key = varied["manoeuvre"], varied["key"]
        planned, best = (contents[which]["manoeuvres"][number - 1] for which in ("planned", "optimal"))
        lines.append(
            f"manoeuvre {number}, {planned['kind']}: {key} {planned[key]:.4g} planned, {best[key]:.4g} optimal"
        )
    return lines


def bounds_table(designed: DesignResult, flights: Sequence[int]) -> Table:
    """Standard deviations of the wanted parameters: as planned, optimal, and after several optimal flights.

    flights : numbers of flights
    """
    columns = [
        Column("parameter"),
        Column("unit", is_text=True),
        Column("as planned", "planned_sigma", ".3g"),
        Column("optimal", "optimal_sigma", ".3g"),
        *(Column(f"{n} flight{'s' if n != 1 else ''}", f"after_{n}_flights_sigma", ".3g") for n in flights),
    ]
    rows = [
        [name, p["unit"], p["planned_sigma"], p["optimal_sigma"], *(p["after_flights"][str(n)] for n in flights)]
        for name, p in summary(designed)["parameters"].items()
    ]
    point = designed.planner.point.name
    return Table(f"{designed.scenario.title}: {point}, one standard deviation", columns, rows)


def write_design(designed: DesignResult, out: str | os.PathLike[str]) -> list[str]:
    """Write design.json, bounds.csv, pictures and report.html; returns the names of the files."""

    with output_directory(out, "design", inputs=designed.scenario.files) as folder:
        write_json(folder / NAME, summary(designed))
        write_text_atomic(folder / BOUNDS, bounds_table(designed, designed.planner.design.flights).csv(".6g"))
        draw_design(folder / DESIGN, designed)
        draw_sweeps(folder / SWEEPS, designed)
        draw_instruments(folder / INSTRUMENTS, designed)
        write_page(folder / PAGE, lambda: design_page(designed, folder))
        return sorted(p.name for p in folder.iterdir() if p.is_file())


def design_page(designed: DesignResult, folder: Path) -> Page:
    """The report of a design as a page; its pictures are in a folder."""
    contents = summary(designed)
    bounds = replace(bounds_table(designed, designed.planner.design.flights), title="One standard deviation.")
    instruments = replace(instruments_table(designed), title="One standard deviation.", sortable=True)
    count = f"{contents['tried']} designs tried, {contents['kept_limits']} keep the limits."
    pictures = {
        DESIGN: "Manoeuvres and the outermost thermocouple, as planned and optimal.",
        SWEEPS: "Bounds along each number over those of the optimal design; open marks exceed a limit.",
        INSTRUMENTS: "Bounds with other instruments over those with the declared ones.",
    }
    shown = [SavedPicture(folder / name, caption) for name, caption in pictures.items()]
    sections = [
        Section("Bounds", [count], [*changes(contents), *notes(designed)], [bounds], shown[:2]),
        Section("Instruments", tables=[instruments], pictures=shown[2:]),
        *([Section("Locations", tables=[locations_table(designed)])] if designed.locations else []),
        credibility_section(contents["credibility"]),
    ]
    subtitle = f"{designed.scenario.vehicle.name}, control point {designed.planner.point.name}: manoeuvre design"
    return Page(designed.scenario.title, subtitle, sections)


def instruments_table(designed: DesignResult) -> Table:
    """Standard deviations of the wanted parameters by the optimal design, a row for each set of instruments."""
    columns = [
        Column("instruments"),
        Column("what", is_text=True),
        *(Column(n, format=".3g") for n in designed.targets),
    ]
    base = designed.instruments[0].sigma
    rows = [
        [v.kind, v.change, *(_bound(sigma, declared) for sigma, declared in zip(v.sigma, base, strict=True))]
        for v in designed.instruments
    ]
    return Table("Instruments: one standard deviation", columns, rows)


def locations_table(designed: DesignResult) -> Table:
    """Control points by what one thermocouple there tells of the optimal manoeuvres, the best first."""
    columns = [
        Column("control point"),
        Column("thermocouple", is_text=True),
        Column("ratio", format=".3g"),
        *(Column(f"bound of {n}", format=".2g") for n in designed.targets),
        Column("over the ratio, to the first design's point", format=".2f"),
        Column("surface below its limit, K", format=".0f"),
    ]
    rows = [
        [
            at.control_point,
            at.sensor.name if at.is_installed else "none yet, below the coating",
            at.ratio,
            *(float(s) if np.isfinite(s) else "not identified" for s in at.sigma),
            at.over_declared if np.isfinite(at.over_declared) else "not identified",
            at.surface_margin_K,
        ]
        for at in designed.locations
    ]
    return Table("One thermocouple at each control point, the most informative first.", columns, rows)


NOT_IDENTIFIED = 1000.0
"""Bound over that with the declared instruments from which a parameter is called not identified."""


def _bound(sigma: float, declared: float) -> float | str:
    """A bound, or in words that there is none."""
    return float(sigma) if sigma < NOT_IDENTIFIED * declared else "not identified"


PLANNED, OPTIMAL = "tab:orange", "tab:blue"
MARKS = ("o", "s", "^", "D", "v")
LABELS = {
    "at_velocity_m_s": "speed at the start, m/s",
    "at_mach": "Mach number at the start",
    "from_deg": "from, deg",
    "to_deg": "to, deg",
    "rate_deg_s": "rate, deg/s",
    "hold_s": "hold, s",
    "down_deg": "down, deg",
    "up_deg": "up, deg",
    "amplitude_deg": "amplitude, deg",
}


@replaced_if_undrawable
def draw_design(path: Path, designed: DesignResult) -> None:
    """Draw the variable of each manoeuvre and the outermost thermocouple's temperature, as planned and optimal."""
    result, count = designed.search, len(designed.search.planned.manoeuvres)
    figure, axes = new_figure(8.5, 3.0 * (count + 1), count + 1)
    for flown, experiment, color, label in (
        (result.planned, result.planned_experiment, PLANNED, "planned"),
        (result.best, result.best_experiment, OPTIMAL, "optimal"),
    ):
        for k, window in enumerate(flown.flight.windows):
            variable = MANOEUVRE_VARIABLE[window.kind]
            speed = float(flown.flight.conditions.at([window.start_s])["velocity_m_s"][0])
            t, y = _around_window(
                flown, window, variable, designed.planner.design.before_s, designed.planner.design.after_s
            )
            axes[k].plot(t, y, color=color, label=f"{label}, at {speed:.0f} m/s")
            axes[k].set_ylabel(f"{ANGLES.get(variable, ('jets', ''))[0]}{', deg' if variable in ANGLES else ''}")
            axes[k].set_xlabel("time from the start of the manoeuvre, s")
        outermost = min(experiment.channels, key=lambda c: c.sensor.depth_m)
        since = outermost.time_s - flown.flight.windows[0].start_s
        axes[-1].plot(since, outermost.mean_K, ".-", color=color, label=label)
    axes[-1].set_ylabel(f"{outermost.sensor.name}, K")
    axes[-1].set_xlabel("time from the start of the first manoeuvre, s")
    for a in axes:
        a.legend(fontsize=8)
    save_figure(
        figure, path, f"{designed.scenario.title}\n{designed.planner.point.name}: as planned, and optimal", axes
    )


def _around_window(
    flown: PlannedFlight, window: Window, variable: str, before_s: float, after_s: float
) -> tuple[np.ndarray, np.ndarray]:
    t = flown.conditions.time_s
    shown = (t >= window.start_s - before_s) & (t <= window.end_s + after_s)
    return t[shown] - window.start_s, flown.conditions[variable][shown]


@replaced_if_undrawable
def draw_sweeps(path: Path, designed: DesignResult) -> None:
    """Draw the bounds along each varied number over those of the optimal design; open marks exceed a limit."""
    sweeps, best = designed.sweeps, designed.search.best_experiment.sigma(designed.targets)
    columns = min(3, len(sweeps))
    rows = -(-len(sweeps) // columns)
    figure, axes = new_figure(3.9 * columns, 3.2 * rows + 0.6, rows, columns, sharey=True, squeeze=False)
    for a, sweep in zip(axes.ravel(), sweeps, strict=False):
        for k, name in enumerate(designed.targets):
            y, color = sweep.sigma[:, k] / best[k], f"C{k}"
            a.plot(sweep.value, y, color=color, linewidth=1.2, label=name)
            for kept, face in ((True, color), (False, "white")):
                at = sweep.feasible == kept
                a.plot(sweep.value[at], y[at], MARKS[k % len(MARKS)], color=color, markerfacecolor=face, markersize=5)
        manoeuvre = designed.search.best.manoeuvres[sweep.vary.manoeuvre - 1]
        chosen = getattr(manoeuvre, sweep.vary.key)
        a.axvline(chosen, color="0.4", linestyle=":", linewidth=1.0)
        a.set_xlabel(f"{manoeuvre.kind}: {LABELS.get(sweep.vary.key, sweep.vary.key)}")
        a.set_yscale("log")
        a.yaxis.set_major_locator(LogLocator(subs=(1.0, 1.5, 2.0, 3.0, 5.0, 7.0)))
        a.yaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
        a.yaxis.set_minor_locator(NullLocator())
    for a in axes.ravel()[len(sweeps) :]:
        a.set_visible(False)
    for a in axes[:, 0]:
        a.set_ylabel("bound over that of the optimal design")
    axes[0, 0].legend(fontsize=8)
    title = f"{designed.scenario.title}\nbounds about the optimal design (dotted); open: exceeds a limit"
    save_figure(figure, path, title, axes)


@replaced_if_undrawable
def draw_instruments(path: Path, designed: DesignResult) -> None:
    """Draw the bounds with other instruments over those with the declared ones."""
    base, others = designed.instruments[0].sigma, designed.instruments[1:]
    figure, axes = new_figure(8.5, 0.33 * len(others) * max(1, len(designed.targets) * 0.7) + 1.8, 1)
    height = 0.8 / len(base)
    rows = np.arange(len(others))[::-1]
    ratio = np.array([v.sigma / base for v in others])
    highest = 1.15 * float(np.max(ratio[np.isfinite(ratio) & (ratio < 10.0)], initial=1.0))
    for k, name in enumerate(designed.targets):
        shown = np.where(ratio[:, k] < highest, ratio[:, k], highest)
        axes[0].barh(rows - k * height, shown, height, color=f"C{k}", label=name)
        for row, value, at in zip(rows, ratio[:, k], shown, strict=True):
            text = f"{value:.2f}" if value < NOT_IDENTIFIED else "not identified"
            # over the line at 1, which would cross it
            paper = {"facecolor": "white", "edgecolor": "none", "pad": 0.5}
            axes[0].annotate(
                text, (at, row - k * height), (3, 0), textcoords="offset points", va="center", fontsize=7.5, bbox=paper
            )
    axes[0].axvline(1.0, color="0.3", linewidth=0.9)
    axes[0].set_xlim(0.0, 1.2 * highest)
    axes[0].set_yticks(rows - 0.5 * height * (len(base) - 1), [f"{v.kind}: {v.change}" for v in others], fontsize=8)
    axes[0].set_xlabel("bound over that with the declared instruments")
    axes[0].legend(fontsize=8, loc="best")
    save_figure(figure, path, f"{designed.scenario.title}\nbounds with other instruments", axes)
