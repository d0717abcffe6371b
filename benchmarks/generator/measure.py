"""Thermocouples and recorder: sample times, noise (slightly coloured in some), words, lost samples, segments."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
Generator = np.random.Generator

RANGES_K = (477.0, 533.0, 644.0, 755.0, 866.0, 978.0, 1089.0, 1200.0, 1366.0, 1533.0, 1644.0, 1900.0, 2400.0)
"""Upper ends of recorder spans; the lower one is 255 K."""

FRINGE_S = 0.2


@dataclass(frozen=True)
class Recorder:
    """Sampling, noise and recorder words of a record.

    time_s   : (sample,) multiples of the march's step
    offset_s : of the first sample
    colour   : share of the noise variance that is correlated over colour_s
    """

    time_s: FloatArray
    offset_s: float
    colour: float
    colour_s: float
    lost: float
    gaps_s: list[list[float]]


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
    return Recorder(time, offset, round(colour, 3), round(float(rng.uniform(1.5, 5.0)), 2), round(lost, 4), gaps)


def add_words(rng: Generator, sensors: Sequence[dict[str, Any]], hottest_K: FloatArray) -> None:
    """Give each sensor of a record the same kind of recorder word over a span of its own, or none."""
    bits = int(rng.choice([0, 8, 8, 8, 8, 9, 10, 12]))
    for sensor, T in zip(sensors, hottest_K, strict=True):
        if bits:
            sensor["bits"] = bits
            sensor["range_K"] = [255.0, next(top for top in RANGES_K if top > T + 60.0)]


def lsb_K(sensor: dict[str, Any]) -> float:
    """Step of the recorder word [K], 0 without one."""
    if "bits" not in sensor:
        return 0.0
    low, high = sensor["range_K"]
    return float((high - low) / (2 ** sensor["bits"] - 1))


def floor_K(sensor: dict[str, Any]) -> float:
    """sqrt(sigma^2 + LSB^2 / 12) [K]."""
    return float(np.hypot(sensor["noise_sigma_K"], lsb_K(sensor) / np.sqrt(12.0)))


def measure(
    rng: Generator, recorder: Recorder, sensors: Sequence[dict[str, Any]], indicated_K: FloatArray
) -> FloatArray:
    """(sample, sensor) readings [K]; NaN is a lost sample."""
    t = recorder.time_s
    read = np.empty_like(indicated_K)
    for i, sensor in enumerate(sensors):
        noisy = indicated_K[:, i] + sensor["noise_sigma_K"] * _noise(rng, recorder)
        step = lsb_K(sensor)
        if step:
            low, high = sensor["range_K"]
            noisy = low + np.rint((np.clip(noisy, low, high) - low) / step) * step
        lost = rng.random(len(t)) < recorder.lost
        for start, end in recorder.gaps_s:
            lost |= (t >= start) & (t <= end)
        read[:, i] = np.where(lost, np.nan, np.round(noisy, 3))
    return read


def _noise(rng: Generator, recorder: Recorder) -> FloatArray:
    """Unit variance: white and, in part, first-order Markov."""
    t = recorder.time_s
    white = rng.normal(size=len(t))
    if recorder.colour == 0.0:
        return white
    memory = float(np.exp(-(t[1] - t[0]) / recorder.colour_s))
    slow, kicks = np.empty(len(t)), rng.normal(size=len(t))
    slow[0] = kicks[0]
    for i in range(1, len(t)):
        slow[i] = memory * slow[i - 1] + np.sqrt(1.0 - memory**2) * kicks[i]
    return np.sqrt(1.0 - recorder.colour) * white + np.sqrt(recorder.colour) * slow


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
    return {"fit": _rest(first, end_s, holdouts), "holdout": _merged(holdouts)}


def _merged(windows: Sequence[Sequence[float]]) -> list[list[float]]:
    merged: list[list[float]] = []
    for start, end in sorted(map(list, windows)):
        if merged and start <= merged[-1][1]:
            merged[-1][1] = max(end, merged[-1][1])
        else:
            merged.append([start, end])
    return merged


def _rest(first: float, last: float, holdouts: Sequence[Sequence[float]]) -> list[list[float]]:
    """Remainder of a span around windows, without short remnants."""
    fit, at = [], first
    for start, end in [*_merged(holdouts), [last + FRINGE_S, last + FRINGE_S]]:
        if start - FRINGE_S - at > 20.0:
            fit.append([round(at, 1), round(start - FRINGE_S, 1)])
        at = end + FRINGE_S
    return fit


def within(time_s: FloatArray, windows: Sequence[Sequence[float]]) -> NDArray[np.bool_]:
    """Which times lie in any of the windows, ends included."""
    inside = np.zeros(len(time_s), dtype=bool)
    for start, end in windows:
        inside |= (time_s >= start) & (time_s <= end)
    return inside
