"""Monte Carlo of the estimator: bias, coverage of 95% bounds and residual tests over thousands of noisy repetitions.

One draw of noise and one of recorder words for each repetition, 8-bit data at 1 Hz; everything else is the same. Bias
is counted in standard errors of the mean over the repetitions.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from multiprocessing import get_context

import numpy as np
from numpy.typing import NDArray

from benchmarks.measure import Figure, save
from sim_heating.estimation.fit import fit_bounds
from sim_heating.estimation.inference.newton import maximise
from sim_heating.estimation.inference.residual_tests import sensor_residuals
from tests.support.estimator_cases import CASES, Repeatable, repeatable

FloatArray = NDArray[np.float64]

REPETITIONS, BATCH = 2000, 50
PROCESSES = 2
MOST_STANDARD_ERRORS = 3.0
TESTED_AT, MOST_ODD = 0.05, 0.06
"""Rate of failed residual tests for a correct model; Ljung and Box's own size is 0.055 for a hundred white samples."""


@dataclass(frozen=True)
class Repetitions:
    """Results of the fits of one case.

    error, sigma, half_width : (repetition, parameter) estimate less truth, its bound, half width of its 95% interval
    white, normal            : (repetition, sensor) p-values of the residual tests
    """

    error: FloatArray
    sigma: FloatArray
    half_width: FloatArray
    white: FloatArray
    normal: FloatArray

    @property
    def covered(self) -> FloatArray:
        """(parameter,) share of intervals that contain the truth."""
        return np.mean(np.abs(self.error) < self.half_width, axis=0)

    @property
    def bias(self) -> FloatArray:
        """(parameter,) mean error in standard errors of the mean."""
        return self.error.mean(axis=0) / self.error.std(axis=0, ddof=1) * np.sqrt(len(self.error))

    @property
    def sigma_over_scatter(self) -> FloatArray:
        """(parameter,) root mean square of the stated sigma over the scatter of the estimates."""
        return np.sqrt(np.mean(self.sigma**2, axis=0)) / self.error.std(axis=0, ddof=1)


def joined(parts: Sequence[Repetitions]) -> Repetitions:
    """All repetitions of one case."""
    return Repetitions(*(np.concatenate([getattr(p, f) for p in parts]) for f in Repetitions.__dataclass_fields__))


def repeat(bench: Repeatable, seeds: Sequence[Sequence[int]]) -> Repetitions:
    """Measure, fit and test once for each seed."""
    problem, rows = bench.problem, []
    for seed in seeds:
        rng = np.random.default_rng(seed)
        bench.draw(rng)
        fit = maximise(problem.evaluate, problem.parameters, bench.truth, problem.log_likelihoods)
        if not fit.converged:
            raise RuntimeError(f"seed {seed}: {fit.describe()[0]}")
        found = fit_bounds(problem.samples(fit.values), fit)
        tests = [
            sensor_residuals(s.channel.sensor.name, s.time_s, s.channel.intervals, s.mean_K, s.sigma_K, rng)
            for s in problem.samples(fit.values)
        ]
        white = [t.whiteness.p_value for t in tests if t.whiteness]
        normal = [t.normality.p_value for t in tests if t.normality]
        rows.append((fit.values - bench.truth, found.sigma, found.half_width(), white, normal))
    return Repetitions(*(np.array(column) for column in zip(*rows, strict=True)))


@cache
def _bench(name: str) -> Repeatable:
    return repeatable(CASES[name])


def _batch(task: tuple[str, int]) -> tuple[str, Repetitions]:
    name, number = task
    first = number * BATCH
    of_case = list(CASES).index(name)
    return name, repeat(_bench(name), [(of_case, k) for k in range(first, first + BATCH)])


def run() -> list[Figure]:
    """Repeat all cases in two processes."""
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # for the processes to come, which share two cores
    tasks = [(name, k) for name in CASES for k in range(REPETITIONS // BATCH)]
    found: dict[str, list[Repetitions]] = {name: [] for name in CASES}
    with get_context("spawn").Pool(PROCESSES) as pool:
        for name, part in pool.imap_unordered(_batch, tasks):
            found[name].append(part)
    figures: list[Figure] = []
    for name, parts in found.items():
        figures += figures_of(name, list(CASES[name].truth), joined(parts))
    save("estimator_statistics", figures)
    return figures


def figures_of(case: str, parameters: Sequence[str], found: Repetitions) -> list[Figure]:
    """Bias and coverage of each parameter, and rate of failed residual tests."""
    n, figures = len(found.error), []
    for k, parameter in enumerate(parameters):
        at = f"{case}: {parameter}"
        mean, scatter = found.error[:, k].mean(), found.error[:, k].std(ddof=1)
        note = f"mean error {mean:.2g}, scatter {scatter:.3g}, stated sigma {found.sigma_over_scatter[k]:.3f} of it"
        figures += [
            Figure(f"{at}: bias, standard errors", abs(found.bias[k]), "", MOST_STANDARD_ERRORS, note=note),
            Figure(f"{at}: |coverage of 95% bounds - 0.95|", abs(found.covered[k] - 0.95), "", 0.02,
                   note=f"{found.covered[k]:.4f} of {n}"),
        ]  # fmt: skip
    for what, p in (("whiteness", found.white), ("normality", found.normal)):
        odd, at = float(np.mean(p < TESTED_AT)), f"{case}: residuals with p < {TESTED_AT} for {what}"
        figures.append(Figure(at, odd, "", MOST_ODD, note=f"{p.size} sensors and repetitions"))
    return figures
