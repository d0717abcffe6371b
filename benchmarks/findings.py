"""Findings of close-loop that pages quote: the ten practice records, and the four measured tiles of STS-96.

Each record is closed by the command, as a reader of the page does it. Findings are kept, not assessed; the time that
they take is that of `practice`.
"""

from __future__ import annotations

import math
import tempfile
import tomllib
from pathlib import Path
from typing import Any

import click

from benchmarks.measure import Figure, save
from sim_heating.base.files import read_json
from sim_heating.cli import main

RECORDS = Path(__file__).resolve().parent.parent / "scenarios" / "records"
TILES = ("sts96_468", "sts96_480", "sts96_597", "sts96_730")


def run() -> list[Figure]:
    """Close the loop on every record."""
    answers = tomllib.loads((RECORDS / "practice" / "answers.toml").read_text(encoding="utf-8"))
    practice = [{**closed(RECORDS / "practice" / name), "truth": answers[name]["effect"]} for name in sorted(answers)]
    tiles = [closed(RECORDS / name) for name in TILES]
    figures = [
        Figure(f"{r['record']}: RMSE of the fit segments after", r["after_K"]["fit"], "K", note=r["finding"])
        for r in (*practice, *tiles)
    ]
    save("findings", figures, {"practice": practice, "sts96": tiles})
    return figures


def closed(record: Path) -> dict[str, Any]:
    """What the command finds in one record, as pages quote it."""
    with tempfile.TemporaryDirectory() as out:
        if main(["--quiet", "close-loop", str(record), "--out", out]) != 0:
            raise click.ClickException(f"sim-heating close-loop {record} failed")
        found = read_json(Path(out) / "closure.json")
    adequacy = found["adequacy"]
    phase, chi2 = max(adequacy["by_phase"].items(), key=lambda p: p[1])
    return {
        "record": record.name,
        "finding": found["finding"],
        "alternatives": found["alternatives"],
        "probability": found["probability"],
        "p_value": adequacy["p_value"],
        "before_K": {kind: found["before"][kind]["rmse_K"] for kind in ("fit", "holdout")},
        "after_K": {kind: found["after"][kind]["rmse_K"] for kind in ("fit", "holdout")},
        "noise_floor_K": found["noise_floor_K"],
        "floors_holdout": math.sqrt(adequacy["chi2_holdout"]),
        "most": {"phase": phase, "floors": math.sqrt(chi2)},
    }
