"""A design from scenario to files: design.json, bounds.csv and pictures."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim_heating.estimation.design import PRESSURE, Experiment, merit
from sim_heating.estimation.design_check import Repeated, repeated_fits
from sim_heating.estimation.design_flight import SEARCHED, Planned, Planner
from sim_heating.estimation.design_instruments import Variant, instrumentation
from sim_heating.estimation.design_search import Found, Search, Sweep
from sim_heating.files import output_directory, write_json, write_text_atomic
from sim_heating.progress import Progress, quiet
from sim_heating.results import package_version
from sim_heating.scenario import Scenario

FloatArray = NDArray[np.float64]

FILES = NAME, BOUNDS, DESIGN, SWEEPS, INSTRUMENTS = (
    "design.json", "bounds.csv", "design.png", "sweeps.png", "instruments.png"
)  # fmt: skip
SWEEP_POINTS = 7


@dataclass(frozen=True, eq=False)
class Checked:
    """Planned and best design flown with the scenario's own source: margins, and (wanted,) bounds."""

    source: str
    planned: Planned
    planned_sigma: FloatArray
    best: Planned
    best_sigma: FloatArray


@dataclass(frozen=True, eq=False)
class Designed:
    """A finished design.

    instruments : bounds of the best design with other instruments, as declared first
    checked     : by the scenario's own source where that is not the 3-DOF entry
    fitted      : errors of actual fits of the best design and the bounds for them, where they were asked for
    """

    scenario: Scenario
    planner: Planner
    found: Found
    sweeps: list[Sweep]
    instruments: list[Variant]
    checked: Checked | None
    fitted: tuple[Repeated, Experiment] | None

    @property
    def wanted(self) -> tuple[str, ...]:
        """Parameters that the manoeuvres are to tell."""
        return self.planner.wanted


def design(
    scenario: Scenario,
    *,
    repetitions: int = 0,
    progress: Progress = quiet,
) -> Designed:
    """Search the manoeuvres of a scenario, and what other instruments would buy.

    repetitions : actual fits of the best design against which its bounds are held
    raises      : InputError where there is nothing to design, RunError where no design keeps the limits
    """
    planner = Planner(scenario)
    progress(0.0, "flying as planned")
    search = Search(planner)
    found = search.run(lambda f, text: progress(0.6 * f, text))
    progress(0.6, "bounds along each number")
    sweeps = search.sweep(found, SWEEP_POINTS)
    progress(0.8, "other instruments")
    instruments = instrumentation(planner, found.best, found.names, found.priors)
    progress(0.85, "checking")
    fitted = None
    if repetitions:
        fitted = _fitted(planner, found, repetitions, lambda f, text: progress(0.9 + 0.1 * f, text))
    return Designed(scenario, planner, found, sweeps, instruments, _checked(planner, found), fitted)


def _checked(planner: Planner, found: Found) -> Checked | None:
    source = planner.scenario.declared.trajectory.source
    if source == SEARCHED["source"]:
        return None
    planned, best = (planner.fly(p.manoeuvres, searched=False) for p in (found.planned, found.best))
    sigma = [planner.experiment(p, found.names, found.priors).sigma(planner.wanted) for p in (planned, best)]
    return Checked(source, planned, sigma[0], best, sigma[1])


def _fitted(planner: Planner, found: Found, repetitions: int, progress: Progress) -> tuple[Repeated, Experiment]:
    """Actual fits of the best design, the surface pressure taken as known in them and in the bounds."""
    record, start = planner.record(found.best, planner.instruments)
    names = tuple(n for n in found.names if n != PRESSURE.name)
    told = planner.experiment(found.best, names, found.priors)
    fits = repeated_fits(record, told, effects=planner.effects, start=start, repetitions=repetitions, progress=progress)
    return fits, told


def summary(designed: Designed) -> dict[str, Any]:
    """The contents of design.json."""
    found, wanted, declared = designed.found, designed.wanted, designed.planner.design
    planned, best = found.planned_told, found.best_told
    return {
        "format": "design/1",
        "scenario": designed.scenario.title,
        "vehicle": designed.scenario.vehicle.name,
        "control_point": designed.planner.point.name,
        "criterion": declared.criterion,
        "criterion_over_planned": merit(declared.criterion, best.covariance(wanted), planned.covariance(wanted)),
        "unknowns": {p.name: p.sigma if np.isfinite(p.sigma) else None for p in best.unknowns},
        "parameters": {
            name: {
                "unit": best.unknowns[best.names.index(name)].unit,
                "planned_sigma": float(planned.sigma(wanted)[k]),
                "optimal_sigma": float(best.sigma(wanted)[k]),
                "after_flights": {str(n): float(best.sigma(wanted, n)[k]) for n in declared.flights},
            }
            for k, name in enumerate(wanted)
        },
        "planned": _flight(found.planned),
        "optimal": _flight(found.best),
        "varied": [v.model_dump() for v in found.vary],
        "tried": len(found.tried),
        "kept_limits": sum(t.feasible for t in found.tried),
        "instruments": [
            {"kind": v.kind, "what": v.what, "sigma": _by_name(wanted, v.sigma)} for v in designed.instruments
        ],
        "checked": _check_summary(designed),
        "fitted": _fit_summary(designed),
        "notes": notes(designed),
        "program": f"sim-heating {package_version()}",
    }


def _by_name(names: tuple[str, ...], sigma: FloatArray) -> dict[str, float | None]:
    """By name; None where nothing is told."""
    return {n: float(s) if np.isfinite(s) else None for n, s in zip(names, sigma, strict=True)}


def _flight(flown: Planned) -> dict[str, Any]:
    return {
        "manoeuvres": [m.model_dump(exclude_none=True) for m in flown.manoeuvres],
        "windows_s": [[w.start_s, w.end_s] for w in flown.flight.windows],
        "margins": flown.margins,
        "keeps_limits": flown.feasible,
    }


def _check_summary(designed: Designed) -> dict[str, Any] | None:
    checked = designed.checked
    if checked is None:
        return None
    pairs = {"planned": (checked.planned, checked.planned_sigma), "optimal": (checked.best, checked.best_sigma)}
    return {"source": checked.source} | {
        what: {"sigma": _by_name(designed.wanted, sigma), "keeps_limits": flown.feasible, "margins": flown.margins}
        for what, (flown, sigma) in pairs.items()
    }


def _fit_summary(designed: Designed) -> dict[str, Any] | None:
    if designed.fitted is None:
        return None
    fits, told = designed.fitted
    return {
        "fits": len(fits.error),
        "failed": fits.failed,
        "rms_error": _by_name(designed.wanted, fits.spread(designed.wanted)),
        "predicted": _by_name(designed.wanted, told.sigma(designed.wanted)),
    }


def notes(designed: Designed) -> list[str]:
    """What a person should know of a design, a line each."""
    lines = designed.planner.over_limit()
    if not designed.found.planned.feasible:
        lines += [f"as planned: {line}" for line in designed.found.planned.passed]
    checked = designed.checked
    if checked is not None and not checked.best.feasible:
        lines += [f"optimal, flown in {checked.source}: {line}" for line in checked.best.passed]
    return lines


def bounds_csv(designed: Designed) -> str:
    """Bounds of the wanted parameters, a line a parameter."""
    found, flights = summary(designed)["parameters"], designed.planner.design.flights
    head = ["parameter", "unit", "planned_sigma", "optimal_sigma", *(f"after_{n}_flights_sigma" for n in flights)]
    rows = [
        [name, p["unit"], *(f"{x:.6g}" for x in (p["planned_sigma"], p["optimal_sigma"], *p["after_flights"].values()))]
        for name, p in found.items()
    ]
    return "\n".join(",".join(row) for row in [head, *rows]) + "\n"


def write_design(designed: Designed, out: Path) -> list[str]:
    """Write design.json, bounds.csv and pictures; returns the names of the files."""
    from sim_heating.estimation.design_plots import draw_design, draw_instruments, draw_sweeps

    with output_directory(out) as folder:
        write_json(folder / NAME, summary(designed))
        write_text_atomic(folder / BOUNDS, bounds_csv(designed))
        draw_design(folder / DESIGN, designed)
        draw_sweeps(folder / SWEEPS, designed)
        draw_instruments(folder / INSTRUMENTS, designed)
        return sorted(p.name for p in folder.iterdir() if p.is_file())
