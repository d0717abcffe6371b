"""Optimal entries: Betts' published cross-range, and the Orbiter's below its control points' temperature limits."""

from __future__ import annotations

import tempfile
import time
from dataclasses import replace
from functools import partial
from pathlib import Path

import click
import numpy as np

from benchmarks.measure import Figure, save
from sim_heating.base.arrays import FloatArray
from sim_heating.inputs.points import conditions_at_point, point_of_vehicle
from sim_heating.inputs.scenario import load_scenario
from sim_heating.march.history import march_points
from sim_heating.planning.limited_point import LimitedPoint
from sim_heating.planning.optimal.of_scenario import optimal_table
from sim_heating.planning.optimal.report import draw_optimal
from sim_heating.planning.optimal.search import COARSEST, OptimalEntry, fly_optimal
from sim_heating.planning.optimal.spec import OptimalStudy, load_optimal_study
from sim_heating.planning.soak import with_soak
from sim_heating.planning.study import load_study
from sim_heating.templates.starters import write_new_study
from tests.support.betts import MESH_TOLERANCE, PUBLISHED, solve_betts

ROOT = Path(__file__).parent.parent
STUDIES = ROOT / "scenarios" / "studies"
DRAWS = 1000
PICTURE = ROOT / "docs" / "images" / "optimal_entry.png"


def _betts_figures(case: str) -> list[Figure]:
    latitude_deg, time_s = PUBLISHED[case]
    start = time.perf_counter()
    motions = solve_betts(case)
    last, took = motions[-1], time.perf_counter() - start
    reached = float(np.degrees(last.goal))
    note = f"{reached:.4f} deg in {last.duration_s:.2f} s; published {latitude_deg} deg in {time_s} s"
    name = f"Betts, {'heating limited' if case == 'limited' else 'free'}"
    return [
        Figure(f"{name}: cross-range off the published one", abs(reached / latitude_deg - 1.0), "", 1e-3, note=note),
        Figure(
            f"{name}: mesh error", float(np.max(last.errors)), "", MESH_TOLERANCE, note=f"{len(last.errors)} intervals"
        ),
        Figure(f"{name}: time", took, "s", note=f"{len(motions)} meshes"),
    ]


def _last_change_deg(entry: OptimalEntry) -> float:
    """Change of the cross-range [deg] from the last mesh but one to the last."""
    last = entry.rounds[-1]
    before = [r.cross_range_deg for r in entry.rounds if r.intervals < last.intervals]
    return last.cross_range_deg - before[-1]


def _entry_figures(name: str, entry: OptimalEntry, took: float) -> list[Figure]:
    margins = [m for p in entry.peaks for m in p.margins() if np.isfinite(m)]
    figures = [
        Figure(f"{name}: cross-range", entry.cross_range_deg, "deg", note=f"{entry.motion.duration_s:.0f} s"),
        Figure(f"{name}: time", took, "s", note=f"{len(entry.rounds)} rounds, {len(entry.motion.errors)} intervals"),
        Figure(f"{name}: mesh error", float(np.max(entry.motion.errors)), "", COARSEST),
        Figure(f"{name}: change of cross-range with the last finer mesh", _last_change_deg(entry), "deg"),
    ]
    if entry.notes:
        figures.append(Figure(f"{name}: notes", len(entry.notes), "", note="; ".join(entry.notes)))
    if margins:
        figures += [
            Figure(f"{name}: least margin, marched", min(margins), "K", 0.0, True, note=entry.status),
            Figure(f"{name}: least margin, marched", min(margins), "K", entry.study.declared.tolerance_K),
        ]
    for nominal, peak in zip(entry.nominal, entry.peaks, strict=True):
        note = f"bondline {peak.bondline_K:.1f}; as tables stand {nominal.surface_K:.1f}, {nominal.bondline_K:.1f} K"
        figures.append(Figure(f"{name}: peak surface of {peak.point}", peak.surface_K, "K", note=note))
    return figures


def peaks_with_drawn_tables(entry: OptimalEntry, draws: int, seed: int, longest_step_s: float) -> FloatArray:
    """(surface and bondline, point, draw) peak temperatures [K] of a flown entry and its soak, each time with another
    ratio table of each point.

    draws, seed    : a standard normal number each, times the table's sigma, is added to all nodes of a table
    longest_step_s : of the conditions and of the marches [s]
    """
    flown = entry.conditions.at(np.arange(0.0, entry.motion.duration_s, longest_step_s))
    shifts = np.random.default_rng(seed).standard_normal((len(entry.study.points), draws))
    peaks = np.empty((2, *shifts.shape))
    for i, (limited, shift) in enumerate(zip(entry.study.points, shifts, strict=True)):
        model, table = point_of_vehicle(entry.study.vehicle, limited.point), limited.point.ratio
        assert table.sigma is not None
        # Where sigma is as large as the ratio itself, far draws make it negative, and with it the film: the wall would
        # run away. No heating at all is as cool as a limit needs to know.
        ratios = [np.maximum(table.ratio + z * table.sigma, 0.0) for z in shift]
        drawn = [replace(model, ratio=replace(table, ratio=ratio)) for ratio in ratios]
        conditions = conditions_at_point(entry.study.vehicle, limited.point, flown)
        conditions = with_soak(conditions, entry.study.declared.soak_s)
        histories = march_points(drawn, [conditions] * draws, longest_step_s=longest_step_s)
        peaks[:, i] = [
            [float(np.max(h.surface_K)) for h in histories],
            [float(np.max(h.bondline_K)) for h in histories],
        ]
    return peaks


def _probability_figures(name: str, entry: OptimalEntry) -> list[Figure]:
    """How often all limits are kept, where each table is off by its sigma times one normal number."""
    points = entry.study.points
    bondlines = [np.inf if p.bondline_K is None else p.bondline_K for p in points]
    limits = np.array([[p.surface_K for p in points], bondlines])
    kept = np.all(peaks_with_drawn_tables(entry, DRAWS, 11, 4.0) <= limits[:, :, np.newaxis], axis=(0, 1))
    asked = entry.study.declared.probability
    assert asked is not None
    least = asked - 3.0 * float(np.sqrt(asked * (1.0 - asked) / DRAWS))
    note = f"{DRAWS} draws of the tables; asked {asked:g} or more"
    return [Figure(f"{name}: limits kept", float(np.mean(kept)), "", least, True, note=note)]


def without_limits(study: OptimalStudy) -> OptimalStudy:
    """A study with the temperatures of its points computed and not limited."""
    points = tuple(LimitedPoint(p.point, np.inf, None) for p in study.points)
    return replace(study, points=points, declared=study.declared.model_copy(update={"probability": None}))


def first_study() -> OptimalStudy:
    """The study that `sim-heating new study optimal` makes of scenarios/entry_3dof.toml, with all of its points."""
    path = ROOT / "scenarios" / "entry_3dof.toml"
    scenario = load_scenario(path)
    table = optimal_table(scenario, scenario.names)
    with tempfile.TemporaryDirectory() as folder:
        made = write_new_study(folder, "optimal", path, optimal=table.values, above=table.above, check=load_study)
        study = load_study(made).optimal()
    assert study is not None
    return study


def run() -> list[Figure]:
    """Both cases of Betts, then the shipped studies and a new one; draws the first with the flight without limits."""
    figures = [*_betts_figures("free"), *_betts_figures("limited")]
    limited = load_optimal_study(STUDIES / "optimal_entry.toml")
    studies = {
        "without limits": without_limits(limited),
        "limited": limited,
        "limited, 0.9 sure": load_optimal_study(STUDIES / "optimal_entry_sure.toml"),
        "a new study of entry_3dof": first_study(),
    }
    entries = {}
    for name, study in studies.items():
        start = time.perf_counter()
        entries[name] = fly_optimal(study, progress=partial(click.echo, err=True))
        figures += _entry_figures(f"Orbiter, {name}", entries[name], time.perf_counter() - start)
    figures += _probability_figures("Orbiter, limited, 0.9 sure", entries["limited, 0.9 sure"])
    drawn = {name: entries[name] for name in ("limited", "without limits")}
    draw_optimal(PICTURE, limited.title, drawn)
    save("optimal", figures)
    return figures
