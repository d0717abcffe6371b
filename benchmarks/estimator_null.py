"""Records of another program without undeclared effects: coverage of the bounds.

The records are those of class `null` of `benchmarks/challenge` with exact models, derivatives about its reference
condition. Each is fitted with magnitude and all derivatives, which is what its truth differs in, once more without the
correction of the mesh, and with the parameters that `estimate` takes by default: derivatives that the record does not
inform or that the table cannot hold are left out; in the truth of these records hardly any of them acts. Coverage is
compared with the lower end of the binomial 99% interval.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from scipy.stats import binom

from benchmarks.challenge.record import make_and_write
from benchmarks.measure import Figure, save
from sim_heating.base.arrays import FloatArray
from sim_heating.base.parameters import SHORT_NAMES
from sim_heating.estimation.fit import FitResult, estimate
from sim_heating.estimation.inference.newton import maximise
from sim_heating.estimation.report.report import sensor_residual_tests
from sim_heating.inputs.record import load_record

RECORDS, SEED, PROCESSES = 120, 20, 2
NAMES = ("ratio.scale", *(f"ratio.d_{short}" for short in SHORT_NAMES))
HOW = {
    "corrected": "mesh corrected",
    "uncorrected": "mesh uncorrected",
    "default": "parameters by default",
}
"""Ways to fit, as rows and as figures name them."""


def made_and_fitted(number: int, out: Path) -> dict[str, Any]:
    """Make a record and fit it; errors over sigmas, and whether the truth is inside, by parameter."""
    name, answer, _ = make_and_write((SEED, number, "null", out, False))
    record, about = load_record(out / name), answer["reference_condition"]
    fitted, by_default = estimate([record], NAMES, reference=about), estimate([record], reference=about)
    if fitted.not_estimated:  # bounds of the others would be those of a model that excludes the truth
        raise RuntimeError(f"{name}: {', '.join(fitted.not_estimated)} cannot be estimated")
    for fit in (fitted.fit, by_default.fit):
        if not fit.converged:
            raise RuntimeError(f"{name}: {fit.describe()[0]}")
    white = [r.whiteness.p_value for r in sensor_residual_tests(fitted) if r.whiteness]
    row = {
        "record": name,
        "kind": answer["form"][0],
        "coloured_noise": answer["noise"][0] > 0.0,
        "white": white,
        "not_estimated": by_default.not_estimated,
        "corrected": errors(fitted, fitted.fit.values, answer["true_errors"]),
        "default": errors(by_default, by_default.fit.values, answer["true_errors"]),
    }
    problem = fitted.problem
    for part in problem.record_fits:
        part.correction_K = 0.0
    uncorrected = maximise(problem.evaluate, problem.parameters, fitted.fit.values).values
    return row | {"uncorrected": errors(fitted, uncorrected, answer["true_errors"])}


def errors(fitted: FitResult, values: FloatArray, true_errors: Mapping[str, float]) -> dict[str, dict[str, Any]]:
    """Error over sigma of each parameter, and whether its 95% bounds hold, at some values and a fit's bounds."""
    truth = np.array([true_errors[label.removeprefix("ratio.")] for label in fitted.labels])
    sigma, half = fitted.bounds.sigma, fitted.bounds.half_width()
    return {
        label: {"error_over_sigma": float(e / s), "inside": bool(abs(e) < h)}
        for label, e, s, h in zip(fitted.labels, values - truth, sigma, half, strict=True)
    }


def coverage(rows: Sequence[dict[str, Any]], how: str, name: str) -> tuple[int, int, float]:
    """Number of intervals that contain the truth, number of all, and the RMS of the error over sigma."""
    found = [row[how][name] for row in rows if name in row[how]]
    rms = float(np.sqrt(np.mean([f["error_over_sigma"] ** 2 for f in found]))) if found else float("nan")
    return sum(f["inside"] for f in found), len(found), rms


def figures_of(rows: Sequence[dict[str, Any]]) -> list[Figure]:
    """Coverage of every parameter by each way to fit, and of the whiteness test."""
    figures = []
    for how, named in HOW.items():
        for name in NAMES:
            hits, n, rms = coverage(rows, how, name)
            low, high = (float(limit) / n for limit in binom.interval(0.99, n, 0.95))
            note = f"{hits} of {n}, 99% limits {low:.3f} to {high:.3f}; error over sigma {rms:.2f} rms"
            target = round(low, 4) if how == "corrected" else None
            figures.append(Figure(f"{name}: 95% bounds that hold, {named}", hits / n, "", target, True, note))
    for colour in (False, True):
        p = np.array([p for row in rows if row["coloured_noise"] is colour for p in row["white"]])
        what = "coloured" if colour else "white"
        figures.append(Figure(f"residuals with p < 0.05 for whiteness, {what} noise", float(np.mean(p < 0.05)), "",
                              note=f"{len(p)} sensors"))  # fmt: skip
    return figures


def run() -> list[Figure]:
    """Make and fit all records in two processes."""
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # for the processes to come, which share two cores
    with TemporaryDirectory() as out, get_context("spawn").Pool(PROCESSES) as pool:
        rows = pool.map(partial(made_and_fitted, out=Path(out)), range(RECORDS), chunksize=4)
    figures = figures_of(rows)
    save("estimator_null", figures, {"seed": SEED, "records": rows})
    return figures
