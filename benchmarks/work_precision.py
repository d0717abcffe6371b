"""Error against time for one control point through the entry: this scheme, CVODES, scipy's BDF, Radau and LSODA."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.integrate import solve_ivp

from benchmarks import cvodes
from benchmarks.measure import RESULTS, Figure, one_thread, save
from benchmarks.ode import FloatArray, System, arguments, jacobian, rate, rate_in_numpy, system_of
from sim_heating.base.kernels.block import TIME
from sim_heating.march.ensemble import Ensemble
from sim_heating.march.point import PointModel
from sim_heating.thermal.assembly import SHARE
from sim_heating.thermal.frame import NOT_CONTROLLED_K, STEP_TOLERANCE_K
from sim_heating.thermal.mesh import Mesh
from tests.support.problems import entry, mesh_of, plug, prescribed

NODES = 24
OUTPUT_S = 20.0
STEPS_S = (0.125, 0.25, 0.5, 1.0, 2.0, 4.0)
DEFAULT_STEP_S = 1.0
MESHES, FINE_NODES = (14, 20, 28, 40, 64), 200
CVODES_TOLERANCES = (1e-3, 1e-4, 1e-5, 1e-6, 1e-7)
SCIPY = {
    "scipy BDF": ("BDF", False, (1e-4, 1e-5, 1e-6)),
    "scipy BDF, compiled right-hand side": ("BDF", True, (1e-3, 1e-4, 1e-5, 1e-6)),
    "scipy Radau, compiled right-hand side": ("Radau", True, (1e-3, 1e-4, 1e-5, 1e-6)),
    "scipy LSODA, compiled right-hand side": ("LSODA", True, (1e-3, 1e-4, 1e-5, 1e-6)),
}
"""Name -> method, whether right-hand side and matrix are compiled, tolerances."""
REFERENCE_TOLERANCE = 1e-10
OWN = "TR-BDF2 (this), undivided steps"
CONTROLLED = "TR-BDF2 (this), steps of 1 s divided to a tolerance"
STEP_TOLERANCES_K = (0.1, STEP_TOLERANCE_K, 0.005, 0.001)


@dataclass(frozen=True)
class Run:
    """One run of one method: its setting, largest error at any node and output time [K], shortest time taken [s]."""

    setting: float
    error_K: float
    time_s: float


def _timed(call: Callable[[], FloatArray], repeats: int) -> tuple[FloatArray, float]:
    best, result = np.inf, call()
    for _ in range(repeats):
        begun = time.perf_counter()
        result = call()
        best = min(best, time.perf_counter() - begun)
    return result, best


def marched(
    model: PointModel,
    mesh: Mesh,
    history: FloatArray,
    step_s: float,
    nodes: list[int] | None = None,
    tolerance_K: float = NOT_CONTROLLED_K,
) -> tuple[Callable[[], FloatArray], int]:
    """The march of one point at a step, undivided or divided to a tolerance, and its samples from output to output."""
    time_s = history[0, :, TIME]
    thin = max(round(step_s / (time_s[1] - time_s[0])), 1)
    ensemble = Ensemble([model], [mesh], step_s, tolerance_K=tolerance_K)
    keep = ensemble.node_offsets(0, nodes or None)
    samples, driving = time_s[::thin].copy(), history[:, ::thin].copy()

    def run() -> FloatArray:
        ensemble.reset()
        return ensemble.march(samples, driving, keep=keep)

    return run, round(OUTPUT_S / (samples[1] - samples[0]))


def by_scipy(system: System, method: str, tolerance: float, outputs_s: FloatArray, compiled: bool = True) -> FloatArray:
    """(output, node) temperatures by a method of scipy; compiled gives it a compiled right-hand side and matrix."""
    given = arguments(system)
    function = (lambda t, T: rate(t, T, given)) if compiled else rate_in_numpy(system)
    implicit = {"jac": lambda t, T: jacobian(t, T, given)} if compiled and method != "LSODA" else {}
    solution = solve_ivp(
        function, (0.0, outputs_s[-1]), system.start_K, method, outputs_s, rtol=tolerance, atol=tolerance, **implicit
    )
    return solution.y.T


def _equal_error(runs: list[Run], error_K: float) -> float:
    """Time that a method takes for an error [s], linear in logarithms between its runs, constant beyond them."""
    found = sorted(runs, key=lambda r: r.error_K)
    log_error, log_time = np.log([r.error_K for r in found]), np.log([r.time_s for r in found])
    return float(np.exp(np.interp(np.log(error_K), log_error, np.minimum.accumulate(log_time))))


def _in_time() -> tuple[dict[str, list[Run]], float]:
    """Errors of time integration alone, all methods on one system; and how far two references are apart [K]."""
    time_s, history = entry(1.0)
    model, driven = prescribed(history, plug())
    mesh = mesh_of(model, NODES)
    system = system_of(model, mesh, driven)
    outputs_s = np.arange(1, round(time_s[-1] / OUTPUT_S) + 1) * OUTPUT_S
    reference = by_scipy(system, "LSODA", REFERENCE_TOLERANCE, outputs_s)
    again = by_scipy(system, "BDF", 1e-8, outputs_s)
    runs: dict[str, list[Run]] = {OWN: []}
    for step_s in STEPS_S:
        march, every = marched(model, mesh, driven, step_s)
        out, seconds = _timed(march, 30)
        runs[OWN].append(Run(step_s, float(np.max(np.abs(out[every::every] - reference))), seconds))
    runs[CONTROLLED] = []
    for tolerance in STEP_TOLERANCES_K:
        march, every = marched(model, mesh, driven, DEFAULT_STEP_S, tolerance_K=tolerance)
        out, seconds = _timed(march, 30)
        runs[CONTROLLED].append(Run(tolerance, float(np.max(np.abs(out[every::every] - reference))), seconds))
    for name, (method, compiled, tolerances) in SCIPY.items():
        runs[name] = []
        for tolerance in tolerances:
            out, seconds = _timed(partial(by_scipy, system, method, tolerance, outputs_s, compiled), 1)
            runs[name].append(Run(tolerance, float(np.max(np.abs(out - reference))), seconds))
    if cvodes.casadi is not None:
        runs |= _cvodes(system, outputs_s, reference)
    return runs, float(np.max(np.abs(again - reference)))


def _cvodes(system: System, outputs_s: FloatArray, reference: FloatArray) -> dict[str, list[Run]]:
    """CVODES on the same system, and on the one with a diagonal mass matrix, which suits it, with its own reference."""
    runs: dict[str, list[Run]] = {}
    for name, mixing in (("CVODES", SHARE), ("CVODES, lumped mass", 0.0)):
        solve = cvodes.solver(system, mixing, outputs_s)
        exact = reference if mixing else solve(REFERENCE_TOLERANCE)
        runs[name] = []
        for tolerance in CVODES_TOLERANCES:
            out, seconds = _timed(partial(solve, tolerance), 3)
            runs[name].append(Run(tolerance, float(np.max(np.abs(out - exact))), seconds))
    return runs


def _in_space_and_time() -> dict[str, list[Run]]:
    """Errors of this scheme at surface and sensors, space and time together, against a fine mesh at fine steps."""
    _, history = entry(1.0)
    model, driven = prescribed(history, plug())

    def at_depths(nodes: int, step_s: float) -> tuple[Callable[[], FloatArray], int]:
        mesh = mesh_of(model, nodes)
        return marched(model, mesh, driven, step_s, [0, mesh.bondline, *mesh.sensors])

    fine, every = at_depths(FINE_NODES, 1.0 / 16.0)
    reference = fine()[every::every]
    runs: dict[str, list[Run]] = {}
    for nodes in MESHES:
        runs[f"{nodes} nodes"] = []
        for step_s in STEPS_S:
            march, every = at_depths(nodes, step_s)
            out, seconds = _timed(march, 10)
            runs[f"{nodes} nodes"].append(Run(step_s, float(np.max(np.abs(out[every::every] - reference))), seconds))
    return runs


def _draw(in_time: dict[str, list[Run]], in_both: dict[str, list[Run]]) -> None:
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, (left, right) = pyplot.subplots(1, 2, figsize=(11, 4.6), sharey=True, layout="constrained")
    for axes, all_runs, title in (
        (left, in_time, f"time integration alone, {NODES} nodes"),
        (right, in_both, "this scheme, space and time"),
    ):
        for name, runs in all_runs.items():
            axes.loglog([r.time_s * 1e3 for r in runs], [r.error_K for r in runs], "o-", label=name)
        axes.set(title=title, xlabel="time for one entry of 1500 s [ms]")
        axes.grid(alpha=0.3)
        axes.legend(fontsize=8)
    left.set_ylabel("largest error [K]")
    left.set_ylim(top=2e3)
    for run in in_time[OWN]:
        at = (run.time_s * 1e3, run.error_K)
        left.annotate(f"{run.setting:g} s", at, fontsize=7, xytext=(4, 3), textcoords="offset points")
    figure.savefig(RESULTS / "work_precision.png", dpi=130)


def run() -> list[Figure]:
    """Work against precision, and the ratios of times at the error of this scheme's default step."""
    RESULTS.mkdir(exist_ok=True)
    with one_thread():
        in_time, apart = _in_time()
        in_both = _in_space_and_time()
    own = next(r for r in in_time[CONTROLLED] if r.setting == STEP_TOLERANCE_K)
    undivided = next(r for r in in_time[OWN] if r.setting == DEFAULT_STEP_S)
    figures = [
        Figure("two references (LSODA 1e-10, BDF 1e-8) apart", apart, "K", 0.01),
        Figure(f"this scheme at {DEFAULT_STEP_S:g} s: error of time integration", own.error_K, "K", 0.2),
        Figure("the same with undivided steps", undivided.error_K, "K"),
        Figure("one point, a whole entry", own.time_s * 1e3, "ms", note="7 of 8 lanes idle"),
    ]
    ratios = {
        name: _equal_error(runs, own.error_K) / own.time_s
        for name, runs in in_time.items()
        if name not in (OWN, CONTROLLED)
    }
    peers = [ratios[name] for name in ratios if name.startswith("CVODES")]
    figures += [
        Figure(f"{name} / this scheme, at that error", r, "x", 100.0 if name == "scipy BDF" else None, True)
        for name, r in ratios.items()
    ]
    if peers:
        figures.append(Figure("the faster CVODES / this scheme, at that error", min(peers), "x", 8.0, True))
    else:
        figures.append(Figure("CVODES: casadi is not installed, skipped", float("nan"), ""))
    _draw(in_time, in_both)
    as_lists = {
        key: {name: [vars(r) for r in runs] for name, runs in found.items()}
        for key, found in (("time", in_time), ("space_and_time", in_both))
    }
    save("work_precision", figures, {"runs": as_lists})
    return figures
