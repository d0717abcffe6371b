"""Cost of the covariance of the filter against approximations of it, and what each does to estimates and bounds.

The founding paper's case: the five-layer plug with 14 nodes, 5 thermocouples and 4 parameters, 1 s data, 300 s of an
entry with manoeuvres. Truth has white noise of the process on every node; each of 32 repetitions is fitted by
Gauss-Newton on the innovations with

    whole         the covariance of every step
    held          gains of one step used for all steps after 30 s
    none          no covariance: output error, noise of the process and of the start neglected

and with those of `covariance_approximations.py`, and compared: cost, estimates and bounds against the whole covariance,
error of the estimates over the stated bound. No approximation can cost less than `none`. `differenced` is the
covariance as the equations read: the derivative of the step by differences of one march for each node and the ratio,
dense products.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from benchmarks.covariance_approximations import APPROXIMATIONS, Case
from benchmarks.covariance_approximations import fitted as fitted_with
from benchmarks.measure import Figure, Task, in_turn, save
from benchmarks.problems import RECORD, plug
from sim_heating.base.kernels.block import LANES
from sim_heating.estimation.filter.march import Filtered, FilterMarch, FilterTrack, samples_on_grid
from sim_heating.inputs.points import conditions_of_record
from sim_heating.inputs.record import load_record
from sim_heating.march.ensemble import Ensemble, condition_history
from sim_heating.march.linearised import LinearMarch, Track
from sim_heating.march.point import PointModel
from sim_heating.thermal.mesh import Mesh, build_mesh

FloatArray = NDArray[np.float64]

DEPTHS = (0.0, 0.1, 0.25, 0.5, 1.0)
"""Thermocouples: parts of the way from the inner face of the coating to the record's deepest one."""
NAMES = ("ratio.scale", "ratio.d_alpha", "stack.coating.thickness_factor", "stack.rsi.conductivity_factor")
NODES, SIGMA_K, NOISE_K2_S, START_SIGMA_K = 14, 1.0, 0.05, 2.0
PART = slice(300, 601)
FREEZE_AFTER_S = 30.0
REPETITIONS, ITERATIONS, ROUNDS, SEED = 32, 5, 5, 20
DIFFERENCED_STEPS = 30


def point() -> PointModel:
    """The plug with five thermocouples."""
    model = plug()
    first, last = min(model.depths_m), max(model.depths_m)
    return replace(model, depths_m=tuple(first + part * (last - first) for part in DEPTHS))


def flight() -> tuple[FloatArray, FloatArray, FloatArray]:
    """Steps [s], (1, time, condition), and the temperatures that the declared point has where they begin."""
    conditions = conditions_of_record(load_record(RECORD))
    t, history = conditions.time_s, condition_history(conditions)[np.newaxis]
    model = point()
    before = Ensemble([model], [mesh_of(model)])
    before.march(t[: PART.start + 1], np.ascontiguousarray(history[:, : PART.start + 1]))
    return t[PART], np.ascontiguousarray(history[:, PART]), before.node_temperatures(0)


def mesh_of(model: PointModel, nodes: int = NODES) -> Mesh:
    """The mesh of the case, or a finer one."""
    return build_mesh(model.construction, np.array(model.depths_m), nodes, 1.0)


def truths(time_s: FloatArray, history: FloatArray, start_K: FloatArray, rng: np.random.Generator) -> FloatArray:
    """(repetition, node, step) temperatures with noise of start and process."""
    model = point()
    ensemble = Ensemble([model] * REPETITIONS, [mesh_of(model)] * REPETITIONS)
    profiles = start_K + rng.normal(0.0, START_SIGMA_K, (REPETITIONS, NODES))
    out = np.empty((REPETITIONS, NODES, len(time_s) - 1))
    for k in range(len(time_s) - 1):
        for i, profile in enumerate(profiles):
            ensemble.set_profile(i, profile)
        ensemble.march(time_s[k : k + 2], history[:, k : k + 2])
        profiles = np.array([ensemble.node_temperatures(i) for i in range(REPETITIONS)])
        profiles += rng.normal(0.0, math.sqrt(NOISE_K2_S * (time_s[k + 1] - time_s[k])), profiles.shape)
        out[:, :, k] = profiles
    return out


def tracks(time_s: FloatArray, start_K: FloatArray, truth: FloatArray, rng: np.random.Generator) -> list[FilterTrack]:
    """The repetitions as they are filtered with the whole covariance."""
    model, mesh = point(), mesh_of(point())
    found = []
    for run in truth:
        read = run[list(mesh.sensors)] + rng.normal(0.0, SIGMA_K, (len(mesh.sensors), len(time_s) - 1))
        samples = samples_on_grid(time_s[1:], mesh.sensors, read, SIGMA_K)
        covariance = START_SIGMA_K**2 * np.eye(mesh.nodes)
        found.append(FilterTrack(model, mesh, samples, NAMES, start_K, covariance_K2=covariance, noise_K2_s=NOISE_K2_S))
    return found


def altered(track: FilterTrack, how: str, begun_s: float) -> FilterTrack:
    """A repetition with an approximation."""
    if how == "held":
        return replace(track, freeze_after_s=begun_s + FREEZE_AFTER_S)
    return track if how == "whole" else replace(track, covariance_K2=None, noise_K2_s=0.0)


def fitted(points: list[FilterTrack], time_s: FloatArray, history: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(repetition, parameter) estimates and their stated sigmas, Gauss-Newton from the truth."""
    values, sigmas = [], []
    for k in range(0, len(points), LANES):
        some = points[k : k + LANES]
        march = FilterMarch(some, time_s, history)
        at = np.array([[p.model.value(n) for n in NAMES] for p in some])
        found: list[Filtered] = []
        for _ in range(ITERATIONS):
            march.set_models([
                p.model.with_parameters(dict(zip(NAMES, map(float, v), strict=True)))
                for p, v in zip(some, at, strict=True)
            ])  # fmt: skip
            found = march.filter()
            at = at + np.array([np.linalg.solve(f.information(), f.score()) for f in found])
        values += list(at)
        sigmas += [np.sqrt(np.diag(np.linalg.inv(f.information()))) for f in found]
    return np.array(values), np.array(sigmas)


def differenced(time_s: FloatArray, history: FloatArray, start_K: FloatArray) -> None:
    """The covariance of some steps by differences and dense products, readings omitted."""
    model, mesh = point(), mesh_of(point())
    n, by = mesh.nodes, 0.1
    ensemble = Ensemble([model] * (n + 1), [mesh] * (n + 1))
    P, profile = START_SIGMA_K**2 * np.eye(n), start_K
    for k in range(DIFFERENCED_STEPS):
        for i, moved in enumerate(profile + by * np.vstack([np.zeros(n), np.eye(n)])):
            ensemble.set_profile(i, moved)
        ensemble.march(time_s[k : k + 2], history[:, k : k + 2])
        after = np.array([ensemble.node_temperatures(i) for i in range(n + 1)])
        phi, profile = ((after[1:] - after[0]) / by).T, after[0]
        P = phi @ P @ phi.T + NOISE_K2_S * (time_s[k + 1] - time_s[k]) * np.eye(n)


def costs(time_s: FloatArray, history: FloatArray, start_K: FloatArray, points: list[FilterTrack]) -> list[Figure]:
    """Times of a full group of repetitions, and how they grow with the nodes."""
    steps, model, group = len(time_s) - 1, point(), points[:LANES]
    tasks: dict[str, Task] = {
        how: FilterMarch([altered(p, how, time_s[0]) for p in group], time_s, history).filter
        for how in ("whole", "held")
    }
    tracks = [Track(model, p.mesh, NAMES, time_s[1:], initial_K=start_K) for p in group]
    tasks["march"] = LinearMarch(tracks, time_s, history).march
    tasks["one"] = FilterMarch(group[:1], time_s, history).filter
    tasks["differenced"] = lambda: differenced(time_s, history, start_K)
    for nodes in (2 * NODES, 4 * NODES):
        mesh = mesh_of(model, nodes)
        nothing = samples_on_grid(time_s[1:], mesh.sensors, np.full((len(DEPTHS), steps), np.nan), SIGMA_K)
        bare = FilterTrack(model, mesh, nothing, noise_K2_s=NOISE_K2_S)
        tasks[f"P {nodes}"] = FilterMarch([bare] * LANES, time_s, history).filter
        tasks[f"S {nodes}"] = LinearMarch([Track(model, mesh, NAMES, time_s[1:])] * LANES, time_s, history).march
    times = in_turn(tasks, ROUNDS)

    def growth(what: str) -> float:
        return math.log2(times.ratio(f"{what} {4 * NODES}", f"{what} {2 * NODES}"))

    old = times.ratio("differenced", "whole") * LANES * steps / DIFFERENCED_STEPS
    return [
        Figure(
            "filter, 4 sensitivities, 5 thermocouples: one step of one point", times.best("one") / steps * 1e6, "us"
        ),
        Figure("the same of eight together, for each", times.best("whole") / steps / LANES * 1e6, "us"),
        Figure("with gains held, over it", times.ratio("held", "whole"), "x"),
        Figure("no covariance, temperatures and sensitivities alone, over it", times.ratio("march", "whole"), "x"),
        Figure("covariance differenced and dense, no sensitivities, over it", old, "x"),
        Figure("cost with the nodes, exponent from 28 to 56: covariance", growth("P"), "-", note="2 is quadratic"),
        Figure("the same: temperatures and sensitivities", growth("S"), "-", note="1 is linear"),
    ]


def run() -> list[Figure]:
    """Cost first, then what the approximations do to estimates."""
    time_s, history, start_K = flight()
    rng = np.random.default_rng(SEED)
    truth = truths(time_s, history, start_K, rng)
    points = tracks(time_s, start_K, truth, rng)
    figures = costs(time_s, history, start_K, points)
    found = {how: fitted([altered(p, how, time_s[0]) for p in points], time_s, history)
             for how in ("whole", "held", "none")}  # fmt: skip
    read = np.stack([p.samples.lower_K.reshape(-1, len(DEPTHS)) for p in points], axis=1)
    step_s = float(time_s[1] - time_s[0])
    case = Case(
        read, np.array(points[0].mesh.sensors), START_SIGMA_K**2 * np.eye(NODES), NOISE_K2_S * step_s, SIGMA_K**2
    )
    found |= {how: fitted_with(points, case, NAMES, how, time_s, history, ITERATIONS) for how in APPROXIMATIONS}
    values, sigmas = found["whole"]
    true = np.array([points[0].model.value(n) for n in NAMES])
    for how, (v, s) in found.items():
        scatter = float(np.sqrt(np.mean(((v - true) / s) ** 2)))
        figures.append(Figure(f"{how}: error of the estimates over the sigma stated, rms", scatter, "-"))
        if how != "whole":
            apart = float(np.sqrt(np.mean(((v - values) / sigmas) ** 2)))
            figures.append(Figure(f"{how}: estimates apart from those of the whole, rms", apart, "sigma"))
            figures.append(Figure(f"{how}: sigma stated over that of the whole", float(np.median(s / sigmas)), "x"))
    save("covariance", figures, {"repetitions": REPETITIONS, "parameters": list(NAMES)})
    return figures
