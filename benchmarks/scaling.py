"""How cost grows with points, flights, samples and records; the loop closed on many records by two workers; what more
would give, on paper.

Exponents are slopes of log time against log size over a factor of eight; 1 is linear. The model of many workers is

    T(W) = T_0 + t + max(N t / (W eta), N s),

N records of t seconds each on W workers, T_0 the start of the workers, eta the efficiency measured with two workers,
their start included, s the seconds that scheduler and ledger need for each task, one after the other, measured with
tasks that do nothing. The last record of all is waited for, hence t. It assumes that a core of a cluster is as fast as
one here, that records are shared out one by one, and that the folder of results takes what W workers write.
"""

from __future__ import annotations

import multiprocessing
import os
import pickle
import shutil
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.dispersion import STUDY
from benchmarks.measure import Figure, save, span
from sim_heating.base.parallel.batches import Job, run_batches
from sim_heating.base.parallel.threads import march_threads, one_thread
from sim_heating.closure.batch import close_all, record_job
from sim_heating.estimation.problem import FitOptions, FitProblem, joint_reference
from sim_heating.inputs.record import load_record
from sim_heating.planning.dispersion.entry import SOBOL, Batch, DispersedEntry
from sim_heating.planning.dispersion.input_checks import check_inputs
from sim_heating.planning.study import load_study
from tests.support.problems import NOTHING, ensemble_of, entry, points

PRACTICE = Path(__file__).parents[1] / "scenarios" / "records" / "practice"
CLOSED = ("p01", "p06", "p08")
"""Records that the loop is closed on, each in copies under other names, one after the other: both workers then have
the same to do, and none waits for the other's last record, which among 1000 records nobody sees."""
COPIES, EMPTY_TASKS, ROUNDS = 6, 2000, 2
"""Copies of each record that two workers share: 1000 records repeat the start of the workers no more often."""
SIZES = (1, 2, 4, 8)
WORKERS, RECORDS = 1000, 100_000


def exponent(sizes: Sequence[float], task: Callable[[int], Callable[[], object]]) -> tuple[float, str]:
    """Slope of log processor time against log size, from the best of some rounds; the times as a note."""
    tasks = [task(k) for k in range(len(sizes))]
    best = np.full(len(sizes), np.inf)
    for _ in range(ROUNDS + 1):
        for k, run_one in enumerate(tasks):
            start = time.process_time()
            run_one()
            best[k] = min(best[k], time.process_time() - start)
    slope = np.polyfit(np.log(sizes), np.log(best), 1)[0]
    return float(slope), ", ".join(f"{n:g}: {1e3 * s:.1f} ms" for n, s in zip(sizes, best, strict=True))


def _exponents() -> list[Figure]:
    time_s, history = entry(1.0, 600.0)

    def of_points(k: int) -> Callable[[], object]:
        ensemble = ensemble_of(points(64 * SIZES[k]), 24)

        def march() -> None:
            ensemble.reset()
            ensemble.march(time_s, history, keep=NOTHING)

        return march

    study = load_study(STUDY)
    dispersed = DispersedEntry(replace(study, declared=study.declared.model_copy(update={"soak_s": 0.0})))
    check_inputs(dispersed)
    dispersed.fly(Batch(SOBOL, 0, 8))
    record = load_record(PRACTICE / "p06")
    mask = record.fit_mask()
    fitted = np.flatnonzero(mask)

    def of_samples(k: int) -> Callable[[], object]:
        # every 8th, 4th, 2nd sample, and every one; the march is the same
        chosen = np.zeros(len(mask), dtype=bool)
        chosen[fitted[:: SIZES[-1] // SIZES[k]]] = True
        names = ["ratio.scale", "ratio.d_alpha", "stack.coating.thickness_factor"]
        problem = FitProblem([record], names, joint_reference([record]), FitOptions(sample_masks=[chosen]))
        at = np.array([p.value for p in problem.parameters])
        state = {"at": at}

        def evaluate() -> None:
            # another vector each time: the march of the last one is kept
            state["at"] = state["at"] + 1e-9
            problem.evaluate(state["at"])

        return evaluate

    figures = []
    with one_thread(), march_threads(1):
        for what, sizes, task in (
            ("control points", [64 * n for n in SIZES], of_points),
            ("flights", [16 * n for n in SIZES], lambda k: lambda: dispersed.fly(Batch(SOBOL, 0, 16 * SIZES[k]))),
            ("samples", [len(fitted) * n // SIZES[-1] for n in SIZES], of_samples),
        ):
            value, note = exponent(sizes, task)
            figures.append(Figure(f"exponent of the cost in {what}", value, "", 1.05, note=note))
    return figures


def _nothing(task: int) -> bytes:
    """A task that takes no time, with a result of the size of a record's."""
    return bytes(2000)


def _copies(folder: Path, copies: int) -> list[Path]:
    """Copies of each record, those of one record next to each other."""
    for copy in range(copies):
        for name in CLOSED:
            shutil.copytree(PRACTICE / name, folder / f"{name}_{copy}")
    return sorted(folder.iterdir())


def _closed_s(records: Sequence[Path], workers: int) -> float:
    """Wall time [s] to close the loop on records."""
    with tempfile.TemporaryDirectory() as out:
        start = time.perf_counter()
        rows = close_all(records, Path(out) / "out", workers=workers)
        took = time.perf_counter() - start
    assert not any("failed" in row for row in rows), rows
    return took


def _at_once_s(records: Sequence[Path]) -> float:
    """Wall time [s] until two copies of this process have each closed the loop on records: the limit of the machine."""
    context = multiprocessing.get_context("fork")
    copies = [context.Process(target=_closed_s, args=(records, 1)) for _ in range(2)]
    start = time.perf_counter()
    for copy in copies:
        copy.start()
    for copy in copies:
        copy.join()
    took = time.perf_counter() - start
    assert all(copy.exitcode == 0 for copy in copies)
    return took


def _empty_s(tasks: int) -> float:
    """Wall time [s] of tasks that do nothing on two workers, their start included."""
    with tempfile.TemporaryDirectory() as out:
        start = time.perf_counter()
        run_batches([Job(f"t{k}", k) for k in range(tasks)], _nothing, Path(out), workers=2)
        return time.perf_counter() - start


def _on_paper(t: float, start: float, each: float, eta: float, workers: int, records: int) -> float:
    """Time [s] of the model."""
    return start + t + max(records * t / (workers * eta), records * each)


def run() -> list[Figure]:
    """Exponents, then one worker and two on the same records, then the engine alone, then the model."""
    figures = _exponents()
    with tempfile.TemporaryDirectory() as folder:
        records = _copies(Path(folder), COPIES)
        once = records[::COPIES]
        with march_threads(1), one_thread():
            _closed_s(once, 1)
        rounds = []
        for _ in range(ROUNDS):  # the runs side by side, for a machine whose speed drifts
            with march_threads(1), one_thread():
                alone, at_once = _closed_s(once, 1), _at_once_s(once)
            rounds.append((alone, at_once, _closed_s(records, 2)))
        moved = len(pickle.dumps(record_job(records[0], Path(folder) / "out").task))
        written = _results_bytes(records[0])
    few, many = _empty_s(EMPTY_TASKS // 10), _empty_s(EMPTY_TASKS)
    each = (many - few) / (EMPTY_TASKS - EMPTY_TASKS // 10)
    begin = few - EMPTY_TASKS // 10 * each
    one, _, two = np.median(rounds, axis=0).tolist()
    of_two = [COPIES * a / (2.0 * c) for a, _, c in rounds]
    of_machine = [a / b for a, b, _ in rounds]
    of_engine = [e / m for e, m in zip(of_two, of_machine, strict=True)]
    t, eta = one / len(once), min(float(np.median(of_two)), 1.0)
    far = _on_paper(t, begin, each, eta, WORKERS, RECORDS)
    figures += [
        Figure(f"loop closed on {len(once)} records, one process of one thread", one, "s"),
        Figure(f"loop closed on {len(records)} records, two workers, their start included", two, "s"),
        Figure("two workers over twice one process", float(np.median(of_two)), "", note=span(of_two)),
        Figure("two plain processes at once over twice one: the machine's own", float(np.median(of_machine)), "",
               note=f"{span(of_machine)}, {os.cpu_count()} cores"),
        Figure("the engine: the former over the latter", float(np.median(of_engine)), "", 0.9, True, span(of_engine)),
        Figure("start of two workers", begin, "s", note="of tasks of no work"),
        Figure("engine: scheduler and ledger, each task", 1e3 * each, "ms", note=f"{EMPTY_TASKS} tasks of no work"),
        Figure("engine: bytes of a task", float(moved), ""),
        Figure("bytes of the results of a record, written by its worker", written / 1e6, "MB"),
        Figure(f"on paper: {RECORDS} records, {WORKERS} workers", far, "s"),
        Figure(f"on paper: efficiency of {WORKERS} workers", RECORDS * t / (WORKERS * far), ""),
        Figure("on paper: workers that the engine keeps busy", t / each, "", note="t over s"),
    ]  # fmt: skip
    save("scaling", figures, {"rounds_s": rounds})
    return figures


def _results_bytes(record: Path) -> int:
    """Bytes that a worker writes for a record."""
    with tempfile.TemporaryDirectory() as out:
        close_all([record], Path(out) / "out", workers=1)
        return sum(p.stat().st_size for p in (Path(out) / "out").rglob("*") if p.is_file())


if __name__ == "__main__":
    run()
