"""Tiles of STS-96 predicted before any fit: errors by phase of the entry.

`scenarios/sts96.toml` is flown with what the vehicle declares and marched at the four tiles. Each phase has the RMSE
and the mean of measured minus predicted surface temperature, and the radiated heat as a part of the predicted one. The
figures of docs/evidence/evidence.md.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from benchmarks.measure import Figure, save
from sim_heating.simulation.run import compare
from sim_heating.simulation.run import run as run_scenario

SCENARIO = Path(__file__).resolve().parent.parent / "scenarios" / "sts96.toml"
PHASES_S = {
    "all": (0.0, 2200.0),
    "55 to 350 s": (55.0, 350.0),
    "350 to 600 s": (350.0, 600.0),
    "600 to 1000 s": (600.0, 1000.0),
    "1000 to 1230 s": (1000.0, 1230.0),
    "1230 to 1650 s": (1230.0, 1650.0),
    "1650 to 2000 s": (1650.0, 2000.0),
}
"""First and last time of each phase [s]: cold start, peak, plateau, before and after transition, subsonic."""


def run() -> list[Figure]:
    """RMSE and mean of measured minus predicted of each tile and phase."""
    figures = []
    for found in compare(run_scenario(SCENARIO)):
        t = found.measured.time_s
        for phase, (first, last) in PHASES_S.items():
            within = (t >= first) & (t < last)
            residual, measured = found.residual_K[within], found.measured.temperature_K[within]
            mean = float(np.mean(residual))
            rmse = float(np.sqrt(np.mean(residual**2)))
            radiated = float(np.mean(measured**4) / np.mean((measured - residual) ** 4))
            note = f"mean {mean:+.0f} K; radiates {radiated:.2f} of the prediction"
            figures.append(Figure(f"{found.measured.label}, {phase}: RMSE", rmse, "K", note=note))
    save("tile_phases", figures)
    return figures
