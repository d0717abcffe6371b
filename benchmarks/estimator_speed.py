"""Time of a fit: the founding paper's case against an extended Kalman filter and least squares; growth; two cores."""

from __future__ import annotations

import os
import time
from dataclasses import replace
from functools import partial
from multiprocessing import get_context
from multiprocessing.synchronize import Barrier
from multiprocessing.synchronize import Event as EventType
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.estimator_peers import ExtendedKalmanFilter, Plain, by_filterpy, by_scipy, by_side_by_side, plain
from benchmarks.measure import Figure, Task, Times, in_turn, save
from sim_heating.base.kernels.block import LANES
from sim_heating.base.parallel.threads import march_threads
from sim_heating.estimation.filter.march import FilterMarch, FilterTrack
from sim_heating.estimation.fit import estimate
from sim_heating.estimation.inference.newton import maximise
from sim_heating.estimation.inference.observability import default_names
from sim_heating.estimation.problem import FitOptions, FitProblem, joint_reference
from sim_heating.estimation.side_by_side import JointMarch
from sim_heating.heating.effects import effects, use
from sim_heating.inputs.points import conditions_of_record
from sim_heating.inputs.record import Record, load_record
from sim_heating.march.ensemble import condition_history
from sim_heating.march.linearised import LinearMarch, Track
from tests.support.estimator_cases import CASES, record_of, start_at
from tests.support.filter_samples import samples_on_grid
from tests.support.problems import RECORD, mesh_of

FloatArray = NDArray[np.float64]

NAMES = ("ratio.scale", "ratio.d_alpha", "stack.coating.thickness_factor", "stack.rsi.conductivity_factor")
START_K2, PROCESS_K2_S = 1e-4, 1e-6
ITERATIONS, ROUNDS, FILTERPY_ROUNDS = 10, 7, 2
NODES = (14, 28, 56, 100)
REST_S = 2.0
"""Time [s] for another process to finish its work, or to be well within it."""
POINTS = 50
"""Control points of the joint fit."""


def gauss_newton(problem: FitProblem, start: FloatArray) -> FloatArray:
    """Ten iterations, without a test of convergence."""
    at = start.copy()
    prior = np.array([p.sigma**-2.0 for p in problem.parameters])
    for _ in range(ITERATIONS):
        found = problem.evaluate(at)
        at = at + np.linalg.solve(found.information + np.diag(prior), found.gradient + prior * (start - at))
    return at


def by_filter(point: Plain, values: FloatArray) -> FloatArray:
    """Ten iterations on the innovations of this program's Kalman filter with its sensitivities."""
    mesh, at = point.part.mesh, values.copy()
    samples = samples_on_grid(point.time_s[1:], mesh.sensors, point.read_K.T, point.sigma_K)
    track = FilterTrack(
        point.part.model, mesh, samples, point.names, point.start_K,
        covariance_K2=START_K2 * np.eye(mesh.nodes), noise_K2_s=PROCESS_K2_S,
    )  # fmt: skip
    march = FilterMarch([track], point.time_s, point.history[np.newaxis])
    for _ in range(ITERATIONS):
        march.set_models([point.model(at)])
        (found,) = march.filter()
        at = at + np.linalg.solve(found.information(), found.score())
    return at


def the_papers_case() -> list[Figure]:
    """All methods on one problem, in turn."""
    begin = start_at(replace(CASES["popu"], truth={}))  # the record is of the declared model
    record = record_of("popu")
    problem = FitProblem([record], NAMES, joint_reference([record]), FitOptions(starts=[begin]))
    start = np.array([p.value for p in problem.parameters])
    point = plain(problem.record_fits[0], NAMES)
    tasks = {
        "this": lambda: gauss_newton(problem, start),
        "filter": lambda: by_filter(point, start),
        "converged": lambda: maximise(problem.evaluate, problem.parameters, start, problem.log_likelihoods).values,
        "scipy": lambda: by_scipy(point, start),
        "lanes": lambda: by_side_by_side(point, start, ITERATIONS),
    }
    values = {name: task() for name, task in tasks.items()}
    sigma = np.sqrt(np.diag(np.linalg.inv(problem.evaluate(values["this"]).information)))
    times = in_turn(tasks, ROUNDS)
    whole = in_turn({"this": lambda: estimate([record], NAMES, starts=[begin])}, ROUNDS)
    steps = len(point.time_s) - 1
    shown = f"{len(point.nodes)} nodes, {len(point.sensors)} sensors, {len(NAMES)} parameters, {steps} steps"
    figures = [
        Figure("ten iterations, this", times.best("this") * 1e3, "ms", note=shown),
        Figure("a whole fit to a record in memory, bounds and predictions too", whole.best("this") * 1e3, "ms"),
        Figure("ten iterations on this program's Kalman filter", times.best("filter") * 1e3, "ms"),
        Figure("ten iterations by hand, differences side by side in lanes / this", times.ratio("lanes", "this"), "x"),
        Figure("until converged, this", times.best("converged") * 1e3, "ms"),
        Figure("scipy least_squares, differences on our march, until converged / this",
               times.ratio("scipy", "converged"), "x", 20.0, True),
    ]  # fmt: skip
    if ExtendedKalmanFilter is None:
        figures.append(Figure("filterpy is not installed, skipped", float("nan"), ""))
    else:
        figures += _against_filterpy(point, start, values, problem)
    apart = {name: float(np.max(np.abs(v - values["this"]) / sigma)) for name, v in values.items() if name != "this"}
    figures.append(
        Figure("largest difference of their estimates from these", max(apart.values()), "sigma",
               note=", ".join(f"{n} {a:.2f}" for n, a in apart.items()))
    )  # fmt: skip
    return figures


def _against_filterpy(
    point: Plain, start: FloatArray, values: dict[str, FloatArray], problem: FitProblem
) -> list[Figure]:
    times = in_turn(
        {
            "this": lambda: gauss_newton(problem, start),
            "filter": lambda: by_filter(point, start),
            "filterpy": lambda: values.update(filterpy=by_filterpy(point, start, ITERATIONS)),
        },
        FILTERPY_ROUNDS,
    )
    return [
        Figure("ten iterations, filterpy and finite differences", times.best("filterpy"), "s"),
        Figure("the same / this", times.ratio("filterpy", "this"), "x", 200.0, True),
        Figure("the same / this program's Kalman filter", times.ratio("filterpy", "filter"), "x"),
    ]


def growth() -> list[Figure]:
    """How one march grows with the nodes: with sensitivities, and with the covariance."""
    record = record_of("popu")
    part = FitProblem([record], NAMES, joint_reference([record])).record_fits[0]
    history = condition_history(part.conditions.at(part.time_s))[np.newaxis]
    tasks: dict[str, Task] = {}
    for nodes in NODES:
        mesh = mesh_of(part.model, nodes)
        nothing = samples_on_grid(part.time_s[1:], mesh.sensors[:1], np.full((1, len(part.time_s) - 1), np.nan), 1.0)
        tasks[f"S {nodes}"] = LinearMarch([Track(part.model, mesh, NAMES, part.sample_s)], part.time_s, history).march
        bare = FilterTrack(part.model, mesh, nothing, noise_K2_s=PROCESS_K2_S)
        tasks[f"P {nodes}"] = FilterMarch([bare], part.time_s, history).filter
    times = in_turn(tasks, ROUNDS)
    return [
        *(_growth(times, "S", "sensitivities", 1.0)),
        *(_growth(times, "P", "covariance", 2.0)),
    ]


def _growth(times: Times, key: str, what: str, order: float) -> list[Figure]:
    """Exponent of the cost between 28 and 100 nodes, and the cost at each count."""
    seconds = {n: times.best(f"{key} {n}") for n in NODES}
    exponent = np.polyfit(np.log(NODES[1:]), np.log([seconds[n] for n in NODES[1:]]), 1)[0]
    note = ", ".join(f"{n}: {s * 1e3:.1f} ms" for n, s in seconds.items())
    return [Figure(f"{what}: exponent of the cost in nodes", float(exponent), "", order + 0.1, note=note)]


class JointFit:
    """One iteration of a fit of fifty control points on one flight."""

    def __init__(self) -> None:
        self.problem = FitProblem(fifty(), NAMES, joint_reference([record_of("popu")]))
        self.at = np.array([p.value for p in self.problem.parameters])
        self.iteration(1)

    def iteration(self, threads: int) -> None:
        """A different vector each time, because the march of the last one is kept."""
        self.at = self.at + 1e-9
        with march_threads(threads):
            self.problem.evaluate(self.at)


def _beside(turn: Barrier, asked: EventType, done: EventType) -> None:
    """The joint fit in another process, one iteration after the other while it is asked for."""
    fit = JointFit()
    turn.wait()
    while not done.is_set():
        if asked.wait(0.05):
            fit.iteration(1)


def the_joint_fit() -> list[Figure]:
    """In one thread, in two, and in one while another process does the same, which shows the machine's limit."""
    fit, spawn = JointFit(), get_context("spawn")
    turn, asked, done = spawn.Barrier(2), spawn.Event(), spawn.Event()
    other = spawn.Process(target=_beside, args=(turn, asked, done))
    other.start()
    turn.wait()

    def beside() -> None:
        asked.set()
        fit.iteration(1)
        asked.clear()

    def rest_asked() -> None:
        asked.set()
        time.sleep(REST_S)

    tasks: dict[str, Task] = {"one": lambda: fit.iteration(1), "two": lambda: fit.iteration(2), "beside": beside}
    pause: dict[str, Task] = {"one": partial(time.sleep, REST_S), "beside": rest_asked}
    load = os.getloadavg()[0]
    times = in_turn(tasks, ROUNDS, pause)
    done.set()
    other.join()
    efficiency, given = times.ratio("one", "two") / 2.0, times.ratio("one", "beside")
    return [
        Figure("joint fit of 50 control points: one iteration, one thread", times.best("one") * 1e3, "ms"),
        Figure("the same on two threads: efficiency", efficiency, "", 0.9, True, note=f"load before {load:.1f}"),
        Figure("one thread alone / beside another process that does the same", given, "",
               note="efficiency of two processes that share nothing: the machine's own"),
        Figure("efficiency of two threads / that of two processes", efficiency / given, ""),
    ]  # fmt: skip


def fifty() -> list[Record]:
    """Fifty control points of one construction on the mesh chosen for it, each with a record of the whole flight."""
    record = record_of("popu")
    segments = record.declared.segments.model_copy(update={"fit": None})
    stack = record.declared.stack.model_copy(update={"nodes": None})
    return [
        replace(
            record,
            declared=record.declared.model_copy(
                update={"control_point": f"P{i}", "segments": segments, "stack": stack}
            ),
            directory=Path(f"p{i}"),
        )
        for i in range(POINTS)
    ]


def the_practice_record() -> list[Figure]:
    """A whole warm fit of a whole entry."""
    record = load_record(RECORD)
    times = in_turn({"this": lambda: estimate([record])}, ROUNDS)
    part = FitProblem([record], ["ratio.scale"], joint_reference([record])).record_fits[0]
    shown = f"{part.mesh.nodes} nodes, {len(part.time_s) - 1} steps, 6 parameters"
    return [Figure("a warm fit of a whole entry, practice record p06", times.best("this") * 1e3, "ms", note=shown)]


def side_by_side() -> list[Figure]:
    """One evaluation of eight problems over one record, each with another effect that the declared model may lack."""
    record = load_record(RECORD)
    names, about, flown = default_names([record]), joint_reference([record]), conditions_of_record(record)
    kernels = [e.name for e in effects().values() if e.kernel][: LANES - 1]
    problems = [FitProblem([record], [*names, "stack.coating.thickness_factor"], about)]
    for name in kernels:
        more = [f"effect.{name}.{p}" for p in effects()[name].starts_for(flown)[0].names]
        problems.append(FitProblem([record], [*names, *more], about, FitOptions(effects=[use(name)])))
    at, together = [np.array([p.value for p in problem.parameters]) for problem in problems], JointMarch(problems)
    moved = iter(range(10**9))

    def vectors() -> list[FloatArray]:
        k = next(moved)
        return [v + 1e-9 * k for v in at]

    times = in_turn(
        {
            "together": lambda: together.evaluate(vectors()),
            "alone": lambda: [p.evaluate(v) for p, v in zip(problems, vectors(), strict=True)],
        },
        ROUNDS,
    )
    shown = f"coating, {', '.join(kernels)}"
    return [
        Figure(
            "eight candidates over one record evaluated side by side", times.best("together") * 1e3, "ms", note=shown
        ),
        Figure("the same one after the other / side by side", times.ratio("alone", "together"), "x"),
    ]


def run() -> list[Figure]:
    """The paper's case, growth with the nodes, a whole entry, eight candidates, fifty points."""
    figures = [*the_papers_case(), *growth(), *the_practice_record(), *side_by_side(), *the_joint_fit()]
    save("estimator_speed", figures)
    return figures
