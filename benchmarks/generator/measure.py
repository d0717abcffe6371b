"""Thermocouples and recorder: sample times, noise (slightly coloured in some), words, lost samples, segments."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.challenge.recorder import Recorder, merged, mixed

FloatArray = NDArray[np.float64]
Generator = np.random.Generator

RANGES_K = (477.0, 533.0, 644.0, 755.0, 866.0, 978.0, 1089.0, 1200.0, 1366.0, 1533.0, 1644.0, 1900.0, 2400.0)
"""Upper ends of recorder spans; the lower one is 255 K."""

FRINGE_S = 0.2


def draw_recorder(rng: Generator, end_s: float) -> Recorder:
    """Rate 0.5 to 2 Hz, mostly 1; samples at or between those of the conditions; some losses."""
    period = float(rng.choice([1.0, 1.0, 1.0, 1.0, 2.0, 0.5]))
    offset = round(float(rng.uniform(0.0, period)), 1) if rng.random() < 0.5 else 0.0
    time = np.round(np.arange(offset, end_s, period), 1)
    lost = float(rng.uniform(0.002, 0.03)) if rng.random() < 0.4 else 0.0
    gap_count = int(rng.integers(1, 3)) if rng.random() < 0.25 else 0
    starts = rng.uniform(0.3 * end_s, 0.9 * end_s, gap_count)
    gaps = [[round(float(s), 1), round(float(s + rng.uniform(4.0, 25.0)), 1)] for s in starts]
    colour = float(rng.uniform(0.05, 0.25)) if rng.random() < 0.15 else 0.0
    return Recorder(time, 0.0, round(colour, 3), round(float(rng.uniform(1.5, 5.0)), 2), round(lost, 4), gaps)


def add_words(rng: Generator, sensors: Sequence[dict[str, Any]], hottest_K: FloatArray) -> None:
    """Give each sensor of a record the same kind of recorder word over a span of its own, or none."""
    bits = int(rng.choice([0, 8, 8, 8, 8, 9, 10, 12]))
    for sensor, T in zip(sensors, hottest_K, strict=True):
        if bits:
            sensor["bits"] = bits
            sensor["range_K"] = [255.0, next(top for top in RANGES_K if top > T + 60.0)]


def unit_noise(rng: Generator, recorder: Recorder) -> FloatArray:
    """(sample,) noise of unit variance; the Markov part is drawn where there is one."""
    white = rng.normal(size=len(recorder.time_s))
    return mixed(recorder, white, rng.normal(size=len(white))) if recorder.colour else white


def draw_segments(
    rng: Generator, end_s: float, manoeuvres: Sequence[tuple[str, float, float]]
) -> dict[str, list[list[float]]] | None:
    """Fit segments from some time on, and windows held out, a repeated manoeuvre perhaps; None: all is fitted."""
    if rng.random() < 0.05:
        return None
    first = round(float(rng.uniform(0.0, 300.0)), 1)
    holdouts: list[list[float]] = []
    kinds = [kind for kind, *_ in manoeuvres]
    for kind, start, end in manoeuvres:
        if kinds.count(kind) > 1 and rng.random() < 0.5 and not holdouts:
            holdouts.append([round(start - 5.0, 1), round(min(end + 20.0, end_s - 1.0), 1)])
    for _ in range(int(rng.integers(1, 3))):
        start = round(float(rng.uniform(0.45, 0.9)) * end_s, 1)
        holdouts.append([start, round(min(start + float(rng.uniform(30.0, 90.0)), end_s - 1.0), 1)])
    return {"fit": _rest(first, end_s, holdouts), "holdout": merged(holdouts)}


def _rest(first: float, last: float, holdouts: Sequence[Sequence[float]]) -> list[list[float]]:
    """Remainder of a span around windows, without short remnants."""
    fit, at = [], first
    for start, end in [*merged(holdouts), [last + FRINGE_S, last + FRINGE_S]]:
        if start - FRINGE_S - at > 20.0:
            fit.append([round(at, 1), round(start - FRINGE_S, 1)])
        at = end + FRINGE_S
    return fit
