"""One real-time frame: what it costs for 16 and for 1000 control points, and that memory does not grow with time."""

from __future__ import annotations

import time
import tracemalloc
from pathlib import Path

import numpy as np

from benchmarks.measure import Figure, one_thread, save
from benchmarks.problems import NOTHING, ensemble_of, entry, points
from sim_heating.ensemble import Ensemble

RATE_HZ = 60.0
START_S, FRAMES, REPEATS = 800.0, 300, 40
NODES = 24


def _advancing(ensemble: Ensemble) -> float:
    """Shortest mean time of a frame [s], called from Python at 60 Hz in the middle of the entry."""
    time_s, history = entry(1.0)
    _, fine = entry(1.0 / RATE_HZ, START_S + FRAMES / RATE_HZ)
    count, middle = len(ensemble.models), int(START_S)
    ensemble.reset()
    ensemble.march(time_s[: middle + 1], history[:, : middle + 1], keep=NOTHING)
    start = ensemble.snapshot()
    frames = [np.repeat(row[np.newaxis], count, axis=0) for row in fine[0, -FRAMES:]]
    best = np.inf
    for _ in range(REPEATS):
        ensemble.restore(start)
        begun = time.perf_counter()
        for frame in frames:
            ensemble.advance(frame, 1.0 / RATE_HZ)
        best = min(best, (time.perf_counter() - begun) / FRAMES)
    return best


def _marching(ensemble: Ensemble) -> float:
    """Shortest mean time of the same frames [s] inside one compiled march."""
    time_s, history = entry(1.0)
    fine_s, fine = entry(1.0 / RATE_HZ, START_S + FRAMES / RATE_HZ)
    middle = int(START_S)
    ensemble.reset()
    ensemble.march(time_s[: middle + 1], history[:, : middle + 1], keep=NOTHING)
    start = ensemble.snapshot()
    best = np.inf
    for _ in range(REPEATS):
        ensemble.restore(start)
        begun = time.perf_counter()
        ensemble.march(fine_s[-FRAMES - 1 :], fine[:, -FRAMES - 1 :], keep=NOTHING)
        best = min(best, (time.perf_counter() - begun) / FRAMES)
    return best


def _resident_kB() -> float:
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith("VmRSS"):
            return float(line.split()[1])
    return float("nan")


def _memory(steps: int) -> tuple[float, float]:
    """Peak of Python's allocations and growth of the process [kB] over so many frames, no history kept."""
    ensemble = ensemble_of(points(64), NODES)
    _, history = entry(1.0)
    frames = np.repeat(history[0][:, np.newaxis], 64, axis=1)
    ensemble.begin(frames[0])
    ensemble.advance(frames[0], 0.1)
    before = _resident_kB()
    tracemalloc.start()
    for k in range(steps):
        ensemble.advance(frames[k * 1500 // steps], 1500.0 / steps)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    return peak / 1024.0, _resident_kB() - before


def run() -> list[Figure]:
    """Time frames of ensembles of 8, 16 and 1000 points and watch the memory of short and long runs."""
    with one_thread():
        advancing = {count: _advancing(ensemble_of(points(count), NODES)) for count in (1, 16, 1000)}
        marching = {count: _marching(ensemble_of(points(count), NODES)) for count in (1, 16)}
    short, long = _memory(1500), _memory(15000)
    figures = [
        Figure("frame of 16 points x 24 nodes at 60 Hz, called from Python", advancing[16] * 1e6, "us", 30.0),
        Figure("frame of 1000 points x 24 nodes, one thread", advancing[1000] * 1e3, "ms", 1.0),
        Figure("of the frame of 16 points: the compiled steps", marching[16] * 1e6, "us"),
        Figure("of the frame of 16 points: the Python call", (advancing[16] - marching[16]) * 1e6, "us"),
        Figure("frame of 1 point (a group of 8 lanes)", advancing[1] * 1e6, "us"),
        Figure("of the frame of 1 point: the compiled step", marching[1] * 1e6, "us"),
        Figure("Python's peak memory, 15000 over 1500 steps", long[0] / short[0], "", 1.05, note=f"{long[0]:.0f} kB"),
        Figure("growth of the process over 15000 steps", long[1], "kB", 512.0, note=f"{short[1]:.0f} kB over 1500"),
    ]
    save("frames", figures)
    return figures
