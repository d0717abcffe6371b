"""Noise of the process in a fit: bounds and scatter of output error and of the filter where the truth has such noise.

The POPU at Mach 20 of `estimator_cases.py` (8-bit words at 1 Hz, 5 thermocouples, 14 nodes, scale and alpha derivative,
from 50 s before the manoeuvre on), with a heating ratio that wanders by 1 % over 10 s, or white noise on every node. Of
each repetition three fits:

    output error   no noise of the process
    filter         on the innovations, levels those of the truth
    found          on the innovations, levels estimated with the parameters
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from multiprocessing import get_context

import numpy as np
from numpy.typing import NDArray

from benchmarks.measure import Figure, save
from sim_heating.estimation.filter.innovations import Innovations, fit_innovations
from sim_heating.estimation.filter.process_noise import CORRELATION, NODE, RATIO, ProcessNoise
from sim_heating.estimation.fit import fit_bounds
from sim_heating.estimation.inference.likelihood import reading_intervals
from sim_heating.estimation.inference.newton import Fit, maximise
from sim_heating.estimation.inference.residual_tests import sensor_residuals
from sim_heating.estimation.problem import FitProblem
from sim_heating.inputs.sensor_model import measure
from sim_heating.march.ensemble import Ensemble, condition_history
from sim_heating.march.point import initial_temperatures
from tests.support.estimator_cases import CASES, Repeatable, repeatable
from tests.support.problems import NOTHING

FloatArray = NDArray[np.float64]

CASE = "popu"
WANDERING = ProcessNoise(ratio_sigma=0.001, ratio_correlation_s=10.0)
WHITE = ProcessNoise(node_K_sqrt_s=0.3)
NOISES = {"ratio wanders": (WANDERING, (RATIO, CORRELATION)), "nodes": (WHITE, (NODE,))}
HOW = ("output error", "filter", "found")
REPETITIONS, BATCH, PROCESSES = 400, 20, 2
ODD = 0.05
LIMIT = 0.03
"""Where bounds are right, 99 of 100 counts of 400 are no farther from 0.95."""


@dataclass(frozen=True)
class Fits:
    """Results of one way of fitting.

    error, white, sigma, half_width : (repetition, parameter) estimate less truth; its bound for white residuals, the
                   corrected one, half width of the 95 % interval
    whiteness    : (repetition, sensor) p-values
    levels       : (repetition, level) of the noise that were estimated
    """

    error: FloatArray
    white: FloatArray
    sigma: FloatArray
    half_width: FloatArray
    whiteness: FloatArray
    levels: FloatArray

    @property
    def scatter(self) -> FloatArray:
        """(parameter,) standard deviation of the estimates."""
        return np.asarray(self.error.std(axis=0, ddof=1))

    def sigma_over_scatter(self, sigma: FloatArray) -> FloatArray:
        """(parameter,) root mean square of stated sigmas over the scatter."""
        return np.sqrt(np.mean(sigma**2, axis=0)) / self.scatter

    @property
    def covered(self) -> FloatArray:
        """(parameter,) share of the 95 % intervals that contain the truth."""
        return np.asarray(np.mean(np.abs(self.error) < self.half_width, axis=0))

    @property
    def bias(self) -> FloatArray:
        """(parameter,) mean error in standard errors of the mean."""
        return self.error.mean(axis=0) / self.scatter * np.sqrt(len(self.error))


def joined(parts: Sequence[Fits]) -> Fits:
    """All repetitions."""
    return Fits(*(np.concatenate([getattr(p, f) for p in parts]) for f in Fits.__dataclass_fields__))


def disturbed(
    bench: Repeatable, noise: ProcessNoise, runs: int, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """(run, step, node) true temperatures [K] after each step of a fit's march with noise of the process, and (run,
    step) addition to the heating ratio in it."""
    part = bench.problem.record_fits[0]
    t, history = part.time_s, condition_history(part.conditions.at(part.time_s))[np.newaxis]
    model, begun = part.model_at(bench.truth), part.initial_K(None)
    profiles = np.tile(initial_temperatures(part.model.construction, part.mesh) if begun is None else begun, (runs, 1))
    d = rng.normal(0.0, noise.ratio_sigma, runs)
    ensemble = Ensemble([model] * runs, [part.mesh] * runs)
    found, added = np.empty((runs, len(t) - 1, part.mesh.nodes)), np.empty((runs, len(t) - 1))
    for k, dt in enumerate(np.diff(t)):
        for i in range(runs):
            ensemble.set_model(i, model.with_parameters({"ratio.d0": model.value("ratio.d0") + d[i]}))
            ensemble.set_profile(i, profiles[i])
        ensemble.march(t[k : k + 2], history[:, k : k + 2], keep=NOTHING)
        profiles = np.array([ensemble.node_temperatures(i) for i in range(runs)])
        profiles += rng.normal(0.0, noise.node_K_sqrt_s * np.sqrt(dt), profiles.shape)
        added[:, k] = d
        decay = np.exp(-dt / noise.ratio_correlation_s)
        d = decay * d + rng.normal(0.0, noise.ratio_sigma * np.sqrt(1.0 - decay**2), runs)
        found[:, k] = profiles
    return found, added


def measure_all(problem: FitProblem, true_K: FloatArray, rng: np.random.Generator) -> None:
    """Read true temperatures (step, node) with the noise and the words of all sensors."""
    part = problem.record_fits[0]
    channels = []
    for c in part.channels:
        at = np.interp(part.sample_s[c.samples], part.time_s[1:], true_K[:, part.mesh.sensors[c.number]])
        channels.append(replace(c, intervals=reading_intervals(c.sensor, measure(c.sensor, at, rng))))
    part.channels = channels


def fits(
    bench: Repeatable, noise: ProcessNoise, unknown: tuple[str, ...], runs: int, seed: Sequence[int]
) -> list[Fits]:
    """Repetitions fitted in each way of HOW."""
    rng, problem = np.random.default_rng(seed), bench.problem
    rows: list[list[tuple[FloatArray, ...]]] = [[] for _ in HOW]
    for true_K in disturbed(bench, noise, runs, rng)[0]:
        measure_all(problem, true_K, rng)
        plain = maximise(problem.evaluate, problem.parameters, bench.truth, problem.log_likelihoods)
        rows[0].append(_row(bench, plain, problem, (), rng))
        for k, levels in enumerate(((), unknown), start=1):
            fit, innovations = fit_innovations(problem, replace(noise, estimated=levels), plain.values)
            rows[k].append(_row(bench, fit, innovations, unknown, rng))
    return [Fits(*(np.array(column) for column in zip(*row, strict=True))) for row in rows]


def _row(
    bench: Repeatable, fit: Fit, fitted: FitProblem | Innovations, levels: tuple[str, ...], rng: np.random.Generator
) -> tuple[FloatArray, ...]:
    """A row of Fits."""
    if not fit.converged:
        raise RuntimeError(fit.describe()[0])
    samples = fitted.samples(fit.values)
    found = fit_bounds(samples, fit)
    tests = [
        sensor_residuals(s.channel.sensor.name, s.time_s, s.channel.intervals, s.mean_K, s.spread_K, rng)
        for s in samples
    ]
    white = np.array([t.whiteness.p_value for t in tests if t.whiteness])
    own = [getattr(fitted.levels.noise, n) for n in levels] if isinstance(fitted, Innovations) else []
    error = fit.values - bench.truth
    return error, np.sqrt(np.diag(found.white)), found.sigma, found.half_width(), white, np.array(own)


@cache
def bench_of(case: str) -> Repeatable:
    """The fit, made once in each process."""
    return repeatable(CASES[case])


def _batch(task: tuple[str, int]) -> tuple[str, list[Fits]]:
    name, number = task
    return name, fits(bench_of(CASE), *NOISES[name], BATCH, (list(NOISES).index(name), number))


def run() -> list[Figure]:
    """Repeat both kinds of noise in two processes."""
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # for the processes to come, which share two cores
    tasks = [(name, k) for name in NOISES for k in range(REPETITIONS // BATCH)]
    found: dict[str, list[list[Fits]]] = {name: [] for name in NOISES}
    with get_context("spawn").Pool(PROCESSES) as pool:
        for name, of_batch in pool.imap_unordered(_batch, tasks):
            found[name].append(of_batch)
    figures: list[Figure] = []
    for name, batches in found.items():
        by_way = [joined(parts) for parts in zip(*batches, strict=True)]
        for how, of_way in zip(HOW, by_way, strict=True):
            figures += figures_of(f"{name}, {how}", list(CASES[CASE].truth), of_way, by_way[0])
        figures += levels_of(name, by_way[-1])
    save("process_noise", figures, {"repetitions": REPETITIONS})
    return figures


def figures_of(case: str, parameters: Sequence[str], found: Fits, plain: Fits) -> list[Figure]:
    """Bounds and scatter of each parameter; only those of the filter have targets."""
    figures, own = [], found is not plain
    for k, name in enumerate(parameters):
        at = f"{case}: {name}"
        ratios = [found.sigma_over_scatter(s)[k] for s in (found.white, found.sigma)]
        figures += [
            Figure(f"{at}, |coverage of 95% bounds - 0.95|", abs(found.covered[k] - 0.95), "", LIMIT if own else None,
                   note=f"{found.covered[k]:.3f}, bias of {found.bias[k]:.1f} standard errors"),
            Figure(f"{at}, sigma for white residuals over the scatter", ratios[0], "",
                   note=f"corrected for colour: {ratios[1]:.2f}"),
            Figure(f"{at}, scatter over that of output error", found.scatter[k] / plain.scatter[k], ""),
        ]  # fmt: skip
    odd = float(np.mean(found.whiteness < ODD))
    figures.append(Figure(f"{case}: sensors with p < {ODD} for whiteness", odd, ""))
    return figures


def levels_of(case: str, found: Fits) -> list[Figure]:
    """Levels found, compared with the true ones."""
    noise, names = NOISES[case]
    return [
        Figure(f"{case}: {name} found over the true one, median", float(np.median(found.levels[:, k])) / true, "",
               note="68 % from {:.2f} to {:.2f}".format(*np.quantile(found.levels[:, k] / true, [0.16, 0.84])))
        for k, name in enumerate(names)
        if (true := getattr(noise, name))
    ]  # fmt: skip
