"""The demo as a user runs it: what the pushover-pullup moves, and its own records predicted with the declared model.

The truth of the demo's records is the declared model, so that the errors of `predict` are those of noise and rounding.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import tomllib
from pathlib import Path

from benchmarks.measure import Figure, save, spent_by_children_s
from sim_heating.base.files.csv_table import read_csv_columns

MOVED = ("V07T9975", "NOSE_HRSI", "V09T9527")
"""Control points whose surface temperature during the manoeuvre is listed."""
PREDICTED = ("V09T9527", "V07T9730", "V07T9975", "BODYFLAP")
AFTER_S = 20.0
"""Time after the end of the manoeuvre within which its temperatures count."""


def run() -> list[Figure]:
    """Run the demo, and predict some of its records."""
    with tempfile.TemporaryDirectory() as folder:
        demo, predicted = Path(folder) / "demo", Path(folder) / "predicted"
        before = spent_by_children_s()
        _command("demo", "--out", str(demo))
        seconds = spent_by_children_s() - before
        _command("predict", *(str(demo / "records" / name) for name in PREDICTED), "--out", str(predicted))
        moved = {point: _moved_K(demo, point) for point in MOVED}
        summaries = {name: json.loads((predicted / name / "summary.json").read_text()) for name in PREDICTED}
    figures = [Figure("demo, kernels compiled: processor time", seconds, "s")]
    figures += [Figure(f"{point}: surface moves in the manoeuvre by", K, "K") for point, K in moved.items()]
    for name, summary in summaries.items():
        note = f"noise floor {summary['noise_floor_K']:.2f} K"
        figures.append(Figure(f"{name}: RMSE of the declared model", summary["fit"]["rmse_K"], "K", note=note))
    save("demo", figures)
    return figures


def _command(*arguments: str) -> None:
    subprocess.run([sys.executable, "-m", "sim_heating", *arguments], check=True, capture_output=True)


def _moved_K(demo: Path, point: str) -> float:
    """Highest less lowest surface temperature of a control point from the manoeuvre to shortly after it [K]."""
    manoeuvre = tomllib.loads((demo / "records" / PREDICTED[0] / "record.toml").read_text())["manoeuvre"][0]
    flown = read_csv_columns(demo / "popu" / point / "temperatures.csv", ["time_s", "surface_K"]).columns
    during = (flown["time_s"] >= manoeuvre["start_s"]) & (flown["time_s"] <= manoeuvre["end_s"] + AFTER_S)
    return float(flown["surface_K"][during].max() - flown["surface_K"][during].min())
