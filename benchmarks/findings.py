"""close-loop on the shipped records, ten of practice and five measured: what it finds, and what remains.

Runs the command as a user does and keeps what `closure.json` of each record states. Findings of practice records are
listed beside their true effects, not assessed: ten are too few for a rate (`closure_challenge.py` counts rates).
"""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from benchmarks.measure import Figure, save
from sim_heating.base.files.toml import read_toml_dict

ROOT = Path(__file__).resolve().parent.parent
RECORDS = ROOT / "scenarios" / "records"
PRACTICE = RECORDS / "practice"
MEASURED = ("sts96_468", "sts96_480", "sts96_597", "sts96_730", "kaowool_board")
KEPT = "SIM_HEATING_FINDINGS"
"""Environment variable that names a folder for the results, where the command resumes; a temporary one by default."""


def run() -> list[Figure]:
    """Close the loop on all records and keep the findings."""
    records = [PRACTICE, *(RECORDS / name for name in MEASURED)]
    with tempfile.TemporaryDirectory() as folder:
        out = os.environ.get(KEPT, folder)
        command = [sys.executable, "-m", "sim_heating", "close-loop", *map(str, records), "--out", out]
        subprocess.run(command, check=True)
        summary = json.loads((Path(out) / "summary.json").read_text())["records"]
        closures = {r["record"]: json.loads((Path(out) / r["record"] / "closure.json").read_text()) for r in summary}
    truths = read_toml_dict(PRACTICE / "answers.toml")
    rows = {r["record"]: _row(r, closures[r["record"]], truths.get(r["record"], {}).get("effect", "")) for r in summary}
    figures = [Figure(name, row["noise_floors"], "floors", note=row["note"]) for name, row in rows.items()]
    save("findings", figures, {"rows": rows})
    return figures


def _row(summary: dict[str, Any], closure: dict[str, Any], true: str) -> dict[str, Any]:
    """What a page quotes of a closure: the finding, errors, and where most of the residual remains."""
    adequacy = closure["adequacy"]
    chi2 = adequacy["chi2_fit"] if adequacy["chi2_holdout"] is None else adequacy["chi2_holdout"]
    worst = max(adequacy["by_phase"], key=adequacy["by_phase"].get)
    keys = ("finding", "named", "effects", "not_effects", "probability", "p_value", "noise_floor_K")
    errors = {k: v for k, v in summary.items() if k.endswith("_rmse_K")}
    return {
        "true": true,
        **{k: summary[k] for k in keys},
        **errors,
        "noise_floors": math.sqrt(chi2),
        "most_remains": worst,
        "noise_floors_there": math.sqrt(adequacy["by_phase"][worst]),
        "note": f"{summary['finding']}: {summary['named'] or 'nothing'}" + (f"; true: {true}" if true else ""),
    }


if __name__ == "__main__":
    run()
