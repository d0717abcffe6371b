"""Manoeuvre design: planned and optimal bounds, in JSBSim and against actual fits; other instruments."""

from __future__ import annotations

import time
from pathlib import Path

from benchmarks.measure import Figure, save
from sim_heating.estimation.design.report import DesignResult, design, draw_instruments, draw_sweeps, summary
from sim_heating.inputs.scenario import load_scenario

ROOT = Path(__file__).parent.parent
IMAGES = ROOT / "docs" / "images"
SCENARIOS = ("design_popu", "design_flap")
FITS = 400
AGREE = 0.10


def _figures(name: str, designed: DesignResult, took: float) -> list[Figure]:
    found = summary(designed)
    figures = [Figure(f"{name}: time", took, "s", note=f"{found['tried']} designs, {found['kept_limits']} keep limits")]
    for varied in found["varied"]:
        planned, best = (found[k]["manoeuvres"][varied["manoeuvre"] - 1][varied["key"]] for k in ("planned", "optimal"))
        figures.append(Figure(f"{name}: {varied['key']}, optimal", best, "", note=f"{planned:g} planned"))
    for parameter, p in found["parameters"].items():
        unit, after = p["unit"], ", ".join(f"{s:.3g} after {n}" for n, s in p["after_flights"].items())
        figures += [
            Figure(f"{name}: {parameter}, planned bound", p["planned_sigma"], unit),
            Figure(f"{name}: {parameter}, optimal bound", p["optimal_sigma"], unit, p["planned_sigma"], note=after),
        ]
        if found["checked"] is not None:
            flown = found["checked"]["optimal"]["sigma"][parameter]
            note = f"{flown:.4g} in {found['checked']['source']}"
            apart = abs(flown / p["optimal_sigma"] - 1.0)
            figures.append(Figure(f"{name}: {parameter}, bound off that in JSBSim", apart, "", AGREE, note=note))
        predicted, actual = (found["fitted"][k][parameter] for k in ("predicted", "rms_error"))
        note = f"{actual:.4g} in {found['fitted']['fits']} fits, {found['fitted']['failed']} failed"
        apart = abs(actual / predicted - 1.0)
        figures.append(Figure(f"{name}: {parameter}, bound off actual fits", apart, "", AGREE, note=note))
    base = designed.instruments[0].sigma
    figures += [
        Figure(
            f"{name}: {v.kind}: {v.change}, {parameter}", float(v.sigma[k] / base[k]), "", note="bound over declared"
        )
        for v in designed.instruments[1:]
        for k, parameter in enumerate(designed.targets)
    ]
    return figures


def run() -> list[Figure]:
    """Both shipped designs; draws the sweeps and instruments of each."""
    figures = []
    for name in SCENARIOS:
        start = time.perf_counter()
        designed = design(load_scenario(ROOT / "scenarios" / f"{name}.toml"), repetitions=FITS)
        figures += _figures(name, designed, time.perf_counter() - start)
        draw_sweeps(IMAGES / f"{name}_sweeps.png", designed)
        draw_instruments(IMAGES / f"{name}_instruments.png", designed)
    save("design", figures)
    return figures
