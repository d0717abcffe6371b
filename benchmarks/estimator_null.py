"""Records of another program without undeclared effects, fitted by default: coverage of the bounds.

The records are those of `benchmarks/generator` (finite volumes, backward differences, its own flights, walls and
recorders), derivatives about the generator's reference condition. Each is fitted as `estimate` does it, and once more
without the correction of the mesh. Coverage is compared with the lower end of the binomial 99% interval.
"""

from __future__ import annotations

import os
import tomllib
from collections.abc import Sequence
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from scipy.stats import binom

from benchmarks.generator.record import make_and_write
from benchmarks.measure import Figure, save
from sim_heating.base.files import toml_text
from sim_heating.base.parameters import SHORT_NAMES
from sim_heating.estimation.fit import estimate
from sim_heating.estimation.inference.newton import maximise
from sim_heating.estimation.report.report import sensor_residual_tests
from sim_heating.inputs.record import load_record

RECORDS, SEED, PROCESSES = 120, 20, 2
NAMES = ("ratio.scale", *(f"ratio.d_{short}" for short in SHORT_NAMES))


def made_and_fitted(number: int, out: Path) -> dict[str, Any]:
    """Make a record and fit it; errors over sigmas, and whether the truth is inside, by parameter."""
    name, answer, _ = make_and_write((SEED, number, "none", out))
    answer = tomllib.loads(toml_text(answer))
    fitted = estimate([load_record(out / name)], reference=answer["reference_condition"])
    if not fitted.fit.converged:
        raise RuntimeError(f"{name}: {fitted.fit.describe()[0]}")
    truth = np.array([answer["true_errors"][label.removeprefix("ratio.")] for label in fitted.labels])
    white = [r.whiteness.p_value for r in sensor_residual_tests(fitted) if r.whiteness]
    problem, half, sigma = fitted.problem, fitted.bounds.half_width(), fitted.bounds.sigma
    values = {"corrected": fitted.fit.values}
    for part in problem.record_fits:
        part.correction_K = 0.0
    values["uncorrected"] = maximise(problem.evaluate, problem.parameters, values["corrected"]).values
    return {
        "record": name,
        "coloured_noise": answer["noise_colour"][0] > 0.0,
        "white": white,
        "not_estimated": fitted.not_estimated,
        **{
            how: {
                label: {"error_over_sigma": float(e / s), "inside": bool(abs(e) < h)}
                for label, e, s, h in zip(fitted.labels, v - truth, sigma, half, strict=True)
            }
            for how, v in values.items()
        },
    }


def coverage(rows: Sequence[dict[str, Any]], how: str, name: str) -> tuple[int, int, float]:
    """Number of intervals that contain the truth, number of all, and the RMS of the error over sigma."""
    found = [row[how][name] for row in rows if name in row[how]]
    rms = float(np.sqrt(np.mean([f["error_over_sigma"] ** 2 for f in found]))) if found else float("nan")
    return sum(f["inside"] for f in found), len(found), rms


def figures_of(rows: Sequence[dict[str, Any]]) -> list[Figure]:
    """Coverage of every parameter with the correction of the mesh and without, and of the whiteness test."""
    figures = []
    for how in ("corrected", "uncorrected"):
        for name in NAMES:
            hits, n, rms = coverage(rows, how, name)
            low, high = (float(limit) / n for limit in binom.interval(0.99, n, 0.95))
            note = f"{hits} of {n}, 99% limits {low:.3f} to {high:.3f}; error over sigma {rms:.2f} rms"
            target = round(low, 4) if how == "corrected" else None
            figures.append(Figure(f"{name}: 95% bounds that hold, mesh {how}", hits / n, "", target, True, note))
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
