"""Starts of a fit on the same flights: error of the estimates against time spent, by way and time of starting.

Two practice flights with known truth, magnitude and derivatives fitted over all segments from 50 s before the first
pushover-pullup on, or earlier. Errors are over the bounds of the fit from entry interface, so that ways are compared in
one unit, and over each fit's own bounds.
"""

from __future__ import annotations

import time
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.measure import Figure, save
from benchmarks.tile import PRACTICE
from sim_heating.base.report.figure import new_figure, save_figure
from sim_heating.estimation.fit import FitResult, estimate
from sim_heating.estimation.record_fit import StartMaker
from sim_heating.estimation.starts import STARTS
from sim_heating.inputs.record import Record, load_record

PICTURE = Path(__file__).parent.parent / "docs" / "images" / "starts_compared.png"
FLIGHTS = {"p06": 690.0, "p07": 676.0}
"""Practice records and the time [s] at which the first manoeuvre begins."""
BEFORE_S = (50.0, 150.0, 300.0)
ROUNDS = 2


@dataclass(frozen=True)
class Result:
    """One start: errors by parameter over the bounds from entry interface and over its own; shortest time [s]."""

    over_best: dict[str, float]
    over_own: dict[str, float]
    seconds: float


def rms(errors: dict[str, float]) -> float:
    """Root mean square over the parameters."""
    return float(np.sqrt(np.mean(np.square(list(errors.values())))))


def _timed(record: Record, about: dict[str, float], start: StartMaker | None) -> tuple[FitResult, float]:
    seconds = []
    for _ in range(ROUNDS):
        begun = time.perf_counter()
        fit = estimate([record], reference=about, starts=[start])
        seconds.append(time.perf_counter() - begun)
    return fit, min(seconds)


def compare(name: str) -> dict[str, Result]:
    """Every way of STARTS at every time, and from entry interface, on one flight."""
    record = load_record(PRACTICE / name)
    with open(PRACTICE / name / "truth.toml", "rb") as file:
        truth = tomllib.load(file)
    ways = {"declared": None} | {
        f"{way}, {before:g} s before": partial(start, time_s=FLIGHTS[name] - before)
        for way, start in STARTS.items()
        for before in BEFORE_S
    }
    found: dict[str, Result] = {}
    best: dict[str, float] = {}
    for way, start in ways.items():
        fit, seconds = _timed(record, truth["reference_condition"], start)
        own = {n: float(s) for n, s in zip(fit.labels, fit.bounds.sigma, strict=True) if n.startswith("ratio.")}
        best = best or own
        error = {n: float(fit.fit.values[fit.labels.index(n)]) - truth["parameters"].get(n, 0.0) for n in own}
        over_best, over_own = ({n: e / sigma[n] for n, e in error.items() if n in sigma} for sigma in (best, own))
        found[way] = Result(over_best, over_own, seconds)
    return found


def draw(path: Path, results: dict[str, dict[str, Result]], ways: Sequence[str]) -> None:
    """Error of all parameters against time spent, a mark a start: over the best bounds, and over its own."""
    figure, axes = new_figure(10.0, 4.6, 1, 2, sharey=True)
    colors = dict(zip(ways, ("0.2", "tab:orange", "tab:blue", "tab:green", "tab:purple"), strict=False))
    for a, of, title in zip(
        axes, ("over_best", "over_own"), ("bounds from entry interface", "own bounds"), strict=True
    ):
        for marker, found in zip("os", results.values(), strict=True):
            for way, r in found.items():
                a.plot(r.seconds, rms(getattr(r, of)), marker, color=colors[way.split(",")[0]])
        for kind, color in colors.items():
            a.plot([], [], "o", color=color, label=kind)
        a.axhline(1.0, color="0.5", linewidth=0.8)
        a.set_yscale("log")
        a.set_xlabel("time of the fit, s")
        a.set_title(f"over {title}", fontsize=10)
    axes[0].set_ylabel("RMS error of magnitude and derivatives")
    axes[0].legend(fontsize=8)
    save_figure(figure, path, f"Starts of a fit: {', '.join(results)} (circles, squares), 50 to 300 s before", axes)


def run() -> list[Figure]:
    """Both flights, all starts."""
    results = {name: compare(name) for name in FLIGHTS}
    draw(PICTURE, results, ["declared", *STARTS])
    figures = []
    for name, found in results.items():
        for way, r in found.items():
            note = f"over its own bounds {rms(r.over_own):.2f}; {r.seconds:.2f} s"
            figures.append(
                Figure(f"{name}, {way}: RMS error over the bounds of declared", rms(r.over_best), "", note=note)
            )
    save("initial", figures)
    return figures
