"""Thermocouple readings as recorded: sample times, noise, 8-bit words, losses, gaps of telemetry, segments."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
Generator = np.random.Generator
Windows = list[list[float]]


@dataclass(frozen=True)
class Recorder:
    """Sampling and noise of a record.

    time_s            : (sample,) as recorded
    jitter_s          : standard deviation of the true sample times about the recorded ones
    colour, colour_s  : share of the noise variance that is correlated, and over which time
    lost, gaps_s      : share of lost samples; times without any
    """

    time_s: FloatArray
    jitter_s: float
    colour: float
    colour_s: float
    lost: float
    gaps_s: Windows


def draw_recorder(rng: Generator, end_s: float, manoeuvres: Sequence[tuple[str, float, float]]) -> Recorder:
    """Mostly 1 Hz and white noise; a third begins with telemetry during the flight, as STS-4's did."""
    period = float(rng.choice([1.0, 1.0, 1.0, 1.0, 2.0, 0.5]))
    offset = round(float(rng.uniform(0.0, period)), 2) if rng.random() < 0.4 else 0.0
    gaps: Windows = []
    if rng.random() < 0.3:
        begin = manoeuvres[0][1] - 30.0 if manoeuvres else 0.4 * end_s
        gaps.append([0.0, round(float(rng.uniform(0.3, 1.0) * begin), 1)])
    for _ in range(int(rng.choice([0, 0, 1, 2]))):
        start = float(rng.uniform(0.3, 0.9) * end_s)
        gaps.append([round(start, 1), round(start + float(rng.uniform(2.0, 40.0)), 1)])
    lost = round(float(rng.uniform(0.002, 0.03)), 4) if rng.random() < 0.35 else 0.0
    return Recorder(np.round(np.arange(offset, end_s - 0.5, period), 2), 0.0, 0.0, 1.0, lost, gaps)


def coloured(rng: Generator, recorder: Recorder) -> Recorder:
    """Part of the noise correlated over some samples."""
    return replace(
        recorder, colour=round(float(rng.uniform(0.1, 0.35)), 3), colour_s=round(float(rng.uniform(1.5, 6.0)), 2)
    )


def jittered(rng: Generator, recorder: Recorder) -> Recorder:
    """Samples taken before or after the recorded times."""
    return replace(recorder, jitter_s=round(float(rng.uniform(0.05, 0.3)), 3))


def lsb_K(sensor: Mapping[str, Any]) -> float:
    """Step of the recorder word [K]; 0 without one."""
    if "bits" not in sensor:
        return 0.0
    low, high = sensor["range_K"]
    return float((high - low) / (2 ** sensor["bits"] - 1))


def floor_K(sensor: Mapping[str, Any]) -> float:
    """sqrt(sigma^2 + LSB^2 / 12) [K]."""
    return float(np.hypot(sensor["noise_sigma_K"], lsb_K(sensor) / np.sqrt(12.0)))


def draw_words(rng: Generator, sensors: Sequence[dict[str, Any]], hottest_K: FloatArray) -> None:
    """Noise within 40 % of the declared; a range that the readings exceed is raised, as a recorder's would be."""
    for sensor, T in zip(sensors, hottest_K, strict=True):
        sensor["noise_sigma_K"] = round(float(sensor["noise_sigma_K"] * rng.uniform(0.7, 1.4)), 2)
        top = next(
            (
                r
                for r in (sensor["range_K"][1], 866.0, 1200.0, 1533.0, 1811.0, 2400.0)
                if r > T + 25.0 + 0.1 * (T - 290.0)
            ),
            2400.0,
        )
        sensor["range_K"] = [255.0, max(top, sensor["range_K"][1])]


def sample_times(rng: Generator, recorder: Recorder) -> FloatArray:
    """(sample,) true times of the readings."""
    return np.maximum(recorder.time_s + recorder.jitter_s * rng.normal(size=len(recorder.time_s)), 0.0)


def unit_noise(rng: Generator, recorder: Recorder) -> FloatArray:
    """(sample,) of unit variance: white, and a first-order Markov part."""
    white, kicks = rng.normal(size=(2, len(recorder.time_s)))
    n = len(kicks)
    if recorder.colour == 0.0:
        return white
    memory = float(np.exp(-(recorder.time_s[1] - recorder.time_s[0]) / recorder.colour_s))
    slow = np.empty(n)
    slow[0] = kicks[0]
    for i in range(1, n):
        slow[i] = memory * slow[i - 1] + np.sqrt(1.0 - memory**2) * kicks[i]
    return np.sqrt(1.0 - recorder.colour) * white + np.sqrt(recorder.colour) * slow


def measure(
    rng: Generator, recorder: Recorder, sensors: Sequence[Mapping[str, Any]], indicated_K: FloatArray
) -> FloatArray:
    """(sample, sensor) recorded readings [K]; NaN is a lost sample."""
    t, read = recorder.time_s, np.empty_like(indicated_K)
    for i, sensor in enumerate(sensors):
        noisy = indicated_K[:, i] + sensor["noise_sigma_K"] * unit_noise(rng, recorder)
        if step := lsb_K(sensor):
            low, high = sensor["range_K"]
            noisy = low + np.rint((np.clip(noisy, low, high) - low) / step) * step
        lost = (rng.random(len(t)) < recorder.lost) | within(t, recorder.gaps_s)
        read[:, i] = np.where(lost, np.nan, np.round(noisy, 3))
    return read


def draw_segments(
    rng: Generator, recorder: Recorder, end_s: float, manoeuvres: Sequence[tuple[str, float, float]]
) -> dict[str, Windows] | None:
    """Segments to fit, and one or two held out, a second manoeuvre of a kind among them; None: all is fitted."""
    if rng.random() < 0.1:
        return None
    first = max([end for start, end in recorder.gaps_s if start == 0.0], default=float(rng.uniform(100.0, 320.0)))
    held: Windows = []
    kinds = [kind for kind, *_ in manoeuvres]
    repeated = [m for i, m in enumerate(manoeuvres) if m[0] in kinds[:i]]
    if repeated and rng.random() < 0.5:
        held.append([repeated[0][1] - 5.0, min(repeated[0][2] + 20.0, end_s - 5.0)])
    for _ in range(int(rng.integers(1, 3))):
        start = float(rng.uniform(first + 0.25 * (end_s - first), first + 0.9 * (end_s - first)))
        held.append([start, min(start + float(rng.uniform(30.0, 80.0)), end_s - 2.0)])
    rounded = [[round(a, 1), round(b, 1)] for a, b in held]
    return {"fit": [[round(first, 1), round(end_s, 1)]], "holdout": merged(rounded)}


def merged(windows: Sequence[Sequence[float]]) -> Windows:
    """Windows in order, those that overlap as one."""
    joined: Windows = []
    for start, end in sorted(map(list, windows)):
        if joined and start <= joined[-1][1]:
            joined[-1][1] = max(end, joined[-1][1])
        else:
            joined.append([start, end])
    return joined


def within(t: FloatArray, windows: Sequence[Sequence[float]]) -> NDArray[np.bool_]:
    """Which times lie in any of the windows, ends included."""
    inside = np.zeros(len(t), dtype=bool)
    for start, end in windows:
        inside |= (t >= start) & (t <= end)
    return inside


def used(sensors: Sequence[Mapping[str, Any]]) -> list[int]:
    """Numbers of the thermocouples that are fitted."""
    return [i for i, s in enumerate(sensors) if s.get("used", True)]
