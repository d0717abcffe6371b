"""The campaign of STS-2 and STS-4 against its truth: estimates, findings, and what the revised tables predict.

Runs `benchmarks/flights/sts2_sts4.toml` as a user does. The truth is that of the two scenarios: ratios as
in the tables where no effect is stated, coatings thicker than declared, impingement on the OMS pods, a transition on
the lower surface. Errors of estimates are counted in their own bounds, also where an effect was not found.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.challenge.files import FLIGHTS
from benchmarks.measure import Figure, save

CAMPAIGN = FLIGHTS / "sts2_sts4.toml"
KEPT = "SIM_HEATING_CAMPAIGN"
"""Environment variable that names a folder for the results; a temporary one by default."""
WITHIN = 2.0
WORSE, NEAR_FIT, NEAR_FLOOR = 1.05, 1.15, 1.3
"""Goals: RMSE after over before on flights that check, after over the fit, after over the noise floor."""


def run() -> list[Figure]:
    """Run the campaign and compare it with the truth."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(os.environ.get(KEPT, folder)) / "campaign"
        start = time.perf_counter()
        subprocess.run([sys.executable, "-m", "sim_heating", "campaign", str(CAMPAIGN), "--out", str(out)], check=True)
        seconds = time.perf_counter() - start
        report = json.loads((out / "campaign.json").read_text())
        truths = {f["name"]: _truth(out / "records" / f["name"]) for f in report["flights"]}
    figures = [
        Figure("whole campaign, all cores", seconds, "s"),
        *_findings(report, truths),
        *_estimates(report, truths),
        *_tables(report),
    ]
    save("campaign", figures, {"report": {k: report[k] for k in ("closed", "updates", "refused", "omitted", "errors")}})
    return figures


def _truth(folder: Path) -> dict[str, Any]:
    return tomllib.loads((folder / "truth.toml").read_text())


def _effects(truth: Mapping[str, Any], point: str) -> dict[str, dict[str, float]]:
    """Effects that the truth has at a control point and no table has: name -> parameters."""
    return {e["name"]: e["parameters"] for e in truth["effect"] if point in e.get("control_points", [point])}


def _findings(report: Mapping[str, Any], truths: Mapping[str, Any]) -> Iterator[Figure]:
    """Records of which every missing effect is named, alone or in a set, and those with a name too many."""
    named = too_many = alone = 0
    for row in report["closed"]:
        truth = truths[row["flight"]]
        wanted = {*_effects(truth, row["control_point"])}
        wanted |= {"coating-thickness"} if "stack.coating.thickness_factor" in truth["parameters"] else set()
        sets = [set(part.split(" or ")) for part in row.get("named", "").split(" + ") if part]
        named += all(any(name in s for s in sets) for name in wanted)
        too_many += any(not s & wanted for s in sets)
        alone += all(len(s) == 1 for s in sets)
    n = len(report["closed"])
    yield Figure(
        "records whose effects are all named", named / max(n, 1), "", note=f"of {n}, {alone} with one name each"
    )
    yield Figure("records with an effect that is not there", too_many, "", note=f"of {n}")


def _estimates(report: Mapping[str, Any], truths: Mapping[str, Any]) -> Iterator[Figure]:
    """Errors of the estimates over their bounds, of single fits and of joint ones."""
    for kind in ("fits", "joint"):
        ratio, thermal = [], []
        for row in report[kind]:
            if "failed" in row or not row["converged"]:
                continue
            truth = truths[row["flights"][0]]
            if _effects(truth, row["control_point"]):
                continue
            for name, p in row["parameters"].items():
                if name.startswith("ratio.") and p["sigma"] > 0.0:
                    ratio.append(p["value"] / p["sigma"])
                elif name in truth["parameters"] and p["sigma"] > 0.0:
                    thermal.append((p["value"] - truth["parameters"][name]) / p["sigma"])
        what = "single flights" if kind == "fits" else "all flights together"
        for z, of in ((ratio, "ratio parameters"), (thermal, "coatings")):
            if z:
                within = float(np.mean(np.abs(z) <= WITHIN))
                yield Figure(f"{what}: {of} within {WITHIN:g} sigma", within, "", note=f"of {len(z)}, 0.95 is right")
    p_values = [row["agreement"]["p_value"] for row in report["joint"] if row.get("agreement")]
    if p_values:
        low = sum(p < 0.05 for p in p_values)
        yield Figure("joint fits with p < 0.05", low / len(p_values), "", note=f"of {len(p_values)}, 0.05 is right")


def _tables(report: Mapping[str, Any]) -> Iterator[Figure]:
    """RMSE of manoeuvres with the tables before and after, by kind of flight."""
    for check in (False, True):
        mine = [e for e in report["errors"] if e["check"] == check]
        if not mine:
            continue
        what = "flights that check" if check else "fitted flights"
        ratio = [e["after_K"] / e["before_K"] for e in mine]
        floors = [e["after_K"] / e["noise_floor_K"] for e in mine]
        yield Figure(
            f"{what}: RMSE after over before",
            float(np.median(ratio)),
            "",
            note=f"of {len(mine)}, worst {max(ratio):.2f}",
        )
        worse = sum(r > WORSE for r in ratio)
        yield Figure(
            f"{what}: manoeuvres predicted worse than {WORSE} of before", worse, "", 0.0, note=f"of {len(mine)}"
        )
        yield Figure(
            f"{what}: RMSE after", float(np.median(floors)), "floors", NEAR_FLOOR, note=f"worst {max(floors):.2f}"
        )
        fitted = [e["after_from_start_K"] / e["fit_K"] for e in mine if e["after_from_start_K"] is not None]
        if fitted:
            yield Figure(
                f"{what}: RMSE after over the fit",
                float(np.median(fitted)),
                "",
                NEAR_FIT,
                note=f"worst {max(fitted):.2f}",
            )
