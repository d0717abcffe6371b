"""Dispersed entries: 10,000 flights by 12 control points on two processes, against the kernels' own speed.

The loss of two processes against twice one is split: the same batches in two plain processes at once, without the
engine, show the loss due to the machine (memory, shared cores); the rest is due to the engine. As a machine's speed may
drift by more than the target, all four are measured in turn, some rounds, and the median of their ratios counts.
"""

from __future__ import annotations

import resource
import tempfile
import time
from dataclasses import replace
from multiprocessing import get_context
from multiprocessing.queues import Queue
from multiprocessing.synchronize import Barrier
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.measure import Figure, save, span
from benchmarks.waiting import GOAL_OVER_FLOOR
from sim_heating.base.kernels.block import LANES
from sim_heating.base.parallel.batches import Job, run_batches
from sim_heating.base.parallel.threads import one_thread
from sim_heating.march.mesh_choice import choose_meshes
from sim_heating.planning.dispersion.entry import BATCH, SOBOL, Batch, DispersedEntry
from sim_heating.planning.dispersion.flight import condition_kernel, entry_sampler
from sim_heating.planning.dispersion.input_checks import check_inputs
from sim_heating.planning.dispersion.march import LaneMarch
from sim_heating.planning.dispersion.statistics import deviations
from sim_heating.planning.study import load_study

FloatArray = NDArray[np.float64]

STUDY = Path(__file__).parent.parent / "scenarios" / "studies" / "dispersed_entry.toml"
FLIGHTS, SHORT = 10_000, 1_280
ROUNDS = 5
"""In turn: one process, two, one plain process, two at once."""
GOAL_S = 40.0
"""Goal of all flights [s], where GOAL_OVER_FLOOR times their kernels alone is no longer."""
FINE_STEP_S, FINE_SAMPLE_S = 0.25, 0.5
"""Steps that the study's are compared with [s]."""


def _jobs(flights: int) -> list[Job]:
    batches = [Batch(SOBOL, first, min(first + BATCH, flights)) for first in range(0, flights, BATCH)]
    return [Job(b.id, b) for b in batches]


def _cpu_s(entry: DispersedEntry) -> float:
    """Processor time of a flight in one process [s], whatever else the machine does: the best of some batches."""
    best = np.inf
    for k in range(4):
        start = time.process_time()
        entry(Batch(SOBOL, BATCH * k, BATCH * (k + 1)))
        best = min(best, (time.process_time() - start) / BATCH)
    return best


def _timed(entry: DispersedEntry, flights: int, workers: int) -> float:
    with tempfile.TemporaryDirectory() as folder:
        start = time.perf_counter()
        outcome = run_batches(_jobs(flights), entry, Path(folder), workers=workers)
        took = time.perf_counter() - start
    assert not outcome.failed, outcome.failed
    return took


def _rate_1_s(entry: DispersedEntry, workers: int) -> float:
    """Flights a second of a number of processes, SHORT for each, from when all of them are at work."""
    times_s: list[float] = []
    with tempfile.TemporaryDirectory() as folder:
        run_batches(
            _jobs(workers * SHORT),
            entry,
            Path(folder),
            workers=workers,
            progress=lambda fraction, text: times_s.append(time.perf_counter()),
        )
    steady = times_s[1 + 2 * workers : -1 : workers]
    return workers * BATCH * (len(steady) - 1) / (steady[-1] - steady[0])


def _plain_s(entry: DispersedEntry, processes: int) -> float:
    """Time [s] of the slowest of several plain processes at once for SHORT flights each, without the engine."""
    context = get_context("spawn")
    together, took = context.Barrier(processes), context.Queue()
    running = [context.Process(target=_flown_plainly, args=(entry, together, took)) for _ in range(processes)]
    for process in running:
        process.start()
    slowest = max(took.get() for _ in running)
    for process in running:
        process.join()
    return float(slowest)


def _flown_plainly(entry: DispersedEntry, together: Barrier, took: Queue[float]) -> None:
    with one_thread():
        entry(Batch(SOBOL, 0, BATCH))
        together.wait()
        start = time.perf_counter()
        for job in _jobs(SHORT):
            entry(job.task)
        took.put(time.perf_counter() - start)


def _efficiencies(entry: DispersedEntry) -> FloatArray:
    """(round, 2) of two processes over twice one: with the engine, and plain."""
    found = []
    for _ in range(ROUNDS):
        one, two = (_rate_1_s(entry, workers) for workers in (1, 2))
        found.append((two / (2.0 * one), _plain_s(entry, 1) / _plain_s(entry, 2)))
    return np.array(found)


def _memory_GiB() -> tuple[float, float]:
    """Largest resident memory of this process and of any other it started [GiB]."""
    own, others = (resource.getrusage(who).ru_maxrss for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return own / 2**20, others / 2**20


def _parts(entry: DispersedEntry) -> dict[str, float]:
    """Processor time [s] of a flight: flying, conditions, and the bare march of the kernels."""
    z = entry.rows(Batch(SOBOL, 0, LANES))
    deviation = deviations(entry.inputs, z)
    changes = [entry.flight_deviations(row) for row in deviation]
    best = dict.fromkeys(("flight", "conditions", "march", "kernel"), np.inf)
    lanes = entry.lanes
    for _ in range(5):
        t0 = time.process_time()
        flown = entry.sampler.fly(entry.inputs, changes)
        t1 = time.process_time()
        kept: list[tuple[np.ndarray, np.ndarray]] = []
        entry.march(flown, deviation, z, kept)
        t2 = time.process_time()
        time_s = lanes.times(int(flown.frame_counts.max()))
        histories = np.empty((len(lanes.stepped), LANES, len(time_s), kept[0][1].shape[-1]))
        condition_kernel(flown.rows, flown.frame_counts, lanes.host, lanes.constants, lanes.soak, time_s, histories)
        lanes.ensemble.reset()
        t3 = time.process_time()
        lanes.march_all(time_s, histories)
        t4 = time.process_time()
        for name, took in zip(best, (t1 - t0, t3 - t2, t2 - t1, t4 - t3), strict=True):
            best[name] = min(best[name], took / LANES)
    return best | {"steps": float(len(time_s))}


def _errors_K(entry: DispersedEntry) -> tuple[float, float]:
    """Largest difference of any peak of 16 flights from one in fine steps on the program's own meshes: surface,
    bondline."""
    z = entry.rows(Batch(SOBOL, 0, 16))
    deviation = deviations(entry.inputs, z)
    changes = [entry.flight_deviations(row) for row in deviation]
    study, found = entry.study, []
    fine = entry_sampler(study.base.declared.trajectory, study.vehicle.directory, FINE_STEP_S, FINE_SAMPLE_S)
    models = entry.lanes.models
    meshes = [mesh for mesh, _ in choose_meshes(models, FINE_SAMPLE_S)]
    marches = (
        (entry.sampler, entry.lanes),
        (fine, LaneMarch(study.vehicle, entry.points, models, meshes, FINE_SAMPLE_S, study.declared.soak_s)),
    )
    for sampler, lanes in marches:
        flown = sampler.fly(entry.inputs, changes)
        parts = [lanes.march(flown, k, [], [None] * len(entry.points)) for k in (0, LANES)]
        found.append([np.vstack([getattr(p, q) for p in parts]) for q in ("surface_K", "bondline_K")])
    apart = [np.abs(a - b) for a, b in zip(*found, strict=True)]
    layered = [mesh.bondline > 0 for mesh in entry.meshes]
    return float(np.max(apart[0])), float(np.max(apart[1][:, layered]))


def run() -> list[Figure]:
    """One process on some flights, two on all, both on the shipped study with its soak left out."""
    study = load_study(STUDY)
    bare = replace(study, declared=study.declared.model_copy(update={"soak_s": 0.0}))
    entry = DispersedEntry(bare)
    check_inputs(entry)
    entry.fly(Batch(SOBOL, 0, BATCH))
    ended = entry.sampler.fly(entry.inputs, [{}]).end_s[0]
    parts = _parts(entry)
    half, one = _timed(entry, SHORT // 2, 1), _timed(entry, SHORT, 1)
    two_short = _timed(entry, 2 * SHORT, 2)
    started = _timed(entry, 2 * BATCH, 2)
    two = _timed(entry, FLIGHTS, 2)
    own_GiB, other_GiB = _memory_GiB()
    efficiencies = _efficiencies(entry)
    engines = efficiencies[:, 0] / efficiencies[:, 1]
    points, steps = len(entry.points), parts["steps"]
    surface, bondline = _errors_K(DispersedEntry(study))
    with one_thread():
        cpu = _cpu_s(entry)
    floor = FLIGHTS / 2.0 * sum(parts[name] for name in ("flight", "conditions", "kernel"))
    what = f"{FLIGHTS} flights x {points} points x {ended:.0f} s"
    figures = [
        Figure(f"{what}, two processes, their start included", two, "s", max(GOAL_S, GOAL_OVER_FLOOR * floor),
               note=f"kernels alone on two cores {floor:.1f} s"),
        Figure("the same from the processor time of a flight", cpu * FLIGHTS / 2.0, "s", note="best of four batches"),
        Figure("processor time per point and second of flight", cpu * 1e6 / (points * ended), "us"),
        Figure(
            "processor time per point and thermal step", cpu * 1e6 / (points * steps), "us", note=f"{steps:.0f} steps"
        ),
        Figure("processor time over the bare march of the kernels", cpu / parts["kernel"], ""),
        Figure("a flight", 1e3 * cpu, "ms"),
        Figure("a flight: flying", 1e3 * parts["flight"], "ms"),
        Figure("a flight: conditions of all points", 1e3 * parts["conditions"], "ms"),
        Figure("a flight: bare march of the kernels", 1e3 * parts["kernel"], "ms"),
        Figure("one process, a flight by the clock", 1e3 * one / SHORT, "ms"),
        Figure("two processes over twice one process, their start left out", float(np.median(efficiencies[:, 0])), "",
               0.9, True, span(efficiencies[:, 0])),
        Figure("two plain processes at once over twice one, without the engine", float(np.median(efficiencies[:, 1])),
               "", note=f"the machine's own; {span(efficiencies[:, 1])}"),
        Figure("the engine: the former over the latter", float(np.median(engines)), "", 0.9, True, span(engines)),
        Figure("two processes, start and two batches", started, "s"),
        Figure("two processes, fewer flights", two_short, "s", note=f"{2 * SHORT} flights"),
        Figure("cost of twice the flights, one process", one / half, "", 2.1),
        Figure("memory of this process", own_GiB, "GiB", 2.0),
        Figure("memory of the largest other", other_GiB, "GiB", note="two of them"),
        Figure("all three together, at most", own_GiB + 2.0 * other_GiB, "GiB", 2.0),
        Figure("steps and meshes: largest error of a peak surface temperature", surface, "K", note="16 flights, soak"),
        Figure(
            "steps and meshes: largest error of a peak bondline temperature", bondline, "K", note="16 flights, soak"
        ),
    ]  # fmt: skip
    save("dispersion", figures)
    return figures


if __name__ == "__main__":
    run()
