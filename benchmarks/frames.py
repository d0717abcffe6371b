"""One real-time frame: what it costs for 16 and for 1000 control points, and that memory does not grow with time."""

from __future__ import annotations

import tracemalloc

import numpy as np

from benchmarks.measure import Figure, in_turn, one_thread, resident_kB, save
from tests.support.problems import NOTHING, ensemble_of, entry, points

RATE_HZ = 60.0
START_S, FRAMES, REPEATS = 800.0, 300, 40
NODES = 24


def _frame_times(count: int) -> tuple[float, float]:
    """Shortest mean time [s] of a frame at 60 Hz in the middle of the entry: called from Python, and within a march."""
    ensemble = ensemble_of(points(count), NODES)
    time_s, history = entry(1.0)
    fine_s, fine = entry(1.0 / RATE_HZ, START_S + FRAMES / RATE_HZ)
    until = int(START_S) + 1
    ensemble.march(time_s[:until], history[:, :until], keep=NOTHING)
    start = ensemble.snapshot()
    fine_s, fine = fine_s[-FRAMES - 1 :], fine[:, -FRAMES - 1 :]
    frames = [np.repeat(row[np.newaxis], count, axis=0) for row in fine[0, 1:]]

    def called() -> None:
        for frame in frames:
            ensemble.advance(frame, 1.0 / RATE_HZ)

    def marched() -> None:
        ensemble.march(fine_s, fine, keep=NOTHING)

    def back() -> None:
        ensemble.restore(start)

    times = in_turn({"called": called, "marched": marched}, REPEATS, {"called": back, "marched": back})
    return times.best("called") / FRAMES, times.best("marched") / FRAMES


def _memory(steps: int) -> tuple[float, float]:
    """Peak of Python's allocations and growth of the process [kB] over a number of frames, without a history."""
    ensemble = ensemble_of(points(64), NODES)
    _, history = entry(1.0)
    frames = np.repeat(history[0][:, np.newaxis], 64, axis=1)
    ensemble.begin(frames[0])
    ensemble.advance(frames[0], 0.1)
    before = resident_kB()
    tracemalloc.start()
    for k in range(steps):
        ensemble.advance(frames[k * 1500 // steps], 1500.0 / steps)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    return peak / 1024.0, resident_kB() - before


def run() -> list[Figure]:
    """Time frames of ensembles of 1, 16 and 1000 points and watch the memory of short and long runs."""
    with one_thread():
        times = {count: _frame_times(count) for count in (1, 16, 1000)}
    short, long = _memory(1500), _memory(15000)
    figures = [
        Figure("frame of 16 points x 24 nodes at 60 Hz, called from Python", times[16][0] * 1e6, "us", 30.0),
        Figure("frame of 1000 points x 24 nodes, one thread", times[1000][0] * 1e3, "ms", 1.0),
        Figure("of the frame of 16 points: the Python call", (times[16][0] - times[16][1]) * 1e6, "us"),
        Figure("frame of 1 point (a group of 8 lanes)", times[1][0] * 1e6, "us"),
        Figure("of the frame of 1 point: the compiled step", times[1][1] * 1e6, "us"),
        Figure("Python's peak memory, 15000 over 1500 steps", long[0] / short[0], "", 1.05, note=f"{long[0]:.0f} kB"),
        Figure("growth of the process over 15000 steps", long[1], "kB", 512.0, note=f"{short[1]:.0f} kB over 1500"),
    ]
    save("frames", figures)
    return figures
