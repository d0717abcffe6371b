"""Speed of a link: 16 control points of five thermocouples with eight parameters each, on one core."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any
from unittest.mock import patch

import numpy as np

import sim_heating as sh
from benchmarks.measure import Figure
from sim_heating.base.arrays import FloatArray
from sim_heating.estimation.filter import online
from sim_heating.live.ahead.futures import FlownPath, Futures
from sim_heating.live.ahead.look_ahead import LookAhead
from sim_heating.live.filtering.estimates import LiveOptions
from sim_heating.live.filtering.estimator import LiveEstimator
from sim_heating.live.filtering.points import RecordPoints, VehiclePoints
from sim_heating.live.types import Frame, Reading, Sample
from sim_heating.trajectory.flight import Window
from tests.support.live_streams import EIGHT, SIX, flown_frames, orbiter_of, practice, samples_of_record, word_K

POINTS, FRAMES_HZ, READINGS_HZ, BEGIN_S, SEED = 16, 60, 10, 800.0, 3
NOT_COUNTED_S = 5.0
"""Beginning of the stream that is not counted: the estimator starts within it [s]."""
LARGEST_MS = 20.0
LARGEST_AHEAD_MS = {60.0: 50.0, 600.0: 500.0}
LOOKS = 15
FASTEST = 100.0


@dataclass(frozen=True, eq=False)
class Stream:
    """What comes to a link with each frame: readings first, where there are any.

    plain_s : (frame,) time of the plug-in's step of the same points, without an estimate [s]
    """

    source: VehiclePoints
    batches: list[list[Sample]]
    plain_s: FloatArray

    @property
    def frames(self) -> list[Frame]:
        """Frames alone."""
        return [b[-1] for b in self.batches if isinstance(b[-1], Frame)]


def stream(flight_s: float, points: int = POINTS) -> Stream:
    """Frames at 60 Hz along an entry, words of all thermocouples at 10 Hz as the plug-in with them predicts."""
    vehicle, names = orbiter_of(points)
    plugin, rng = sh.HeatingPlugin(vehicle, names), np.random.default_rng(SEED)
    sensors = vehicle.control_point(names[0]).sensors
    frames = flown_frames(BEGIN_S, BEGIN_S + flight_s, FRAMES_HZ)
    plugin.reset({"time_s": frames[0].time_s, **frames[0].values})
    batches, plain = [], []
    for k, frame in enumerate(frames):
        given = {"time_s": frame.time_s, **frame.values}
        begun = time.perf_counter()
        if k:
            plugin.step(given)
        plain.append(time.perf_counter() - begun)
        batch: list[Sample] = []
        if k % (FRAMES_HZ // READINGS_HZ) == 0:
            shown = plugin.sensors_K  # by the sensor's name: walls and flow of all points are the same
            for name in names:
                noise = rng.normal(0.0, 1.0, len(sensors))
                batch += [
                    Reading(frame.time_s, name, s.name, float(word_K(s, np.asarray(shown[s.name] + e))))
                    for s, e in zip(sensors, noise, strict=True)
                ]
        batches.append([*batch, frame])
    return Stream(VehiclePoints(vehicle, names), batches, np.array(plain))


def estimator(given: Stream) -> LiveEstimator:
    """The estimator of a stream, begun from its first readings."""
    return LiveEstimator(given.source, EIGHT, options=LiveOptions(start="readings"))


def latencies(given: Stream) -> tuple[FloatArray, FloatArray]:
    """(frame,) wall and processor time from samples in to estimates out [s]."""
    e, wall, busy = estimator(given), [], []
    for batch in given.batches:
        begun, worked = time.perf_counter(), time.thread_time()
        e.add(*batch)
        e.advance()
        e.estimates()
        e.innovations()
        wall.append(time.perf_counter() - begun)
        busy.append(time.thread_time() - worked)
    return np.array(wall), np.array(busy)


def waiting_too(call_s: FloatArray) -> FloatArray:
    """(frame,) time from a frame's arrival to its estimate [s] where frames come at their rate, one after the other."""
    done, found = 0.0, []
    for k, taken in enumerate(call_s.tolist()):
        done = max(done, k / FRAMES_HZ) + taken
        found.append(done - k / FRAMES_HZ)
    return np.array(found)


def replay(e: LiveEstimator, given: Stream) -> None:
    """Give an estimator the stream as fast as it goes, a second of flight [s] at a time."""
    for k in range(0, len(given.batches), FRAMES_HZ):
        for batch in given.batches[k : k + FRAMES_HZ]:
            e.add(*batch)
        e.advance()
        e.innovations()
    e.estimates()


def replay_speed(given: Stream) -> float:
    """Flight time over processor time of a replay as fast as it goes, a second of flight at a time [-]."""
    e = estimator(given)
    worked = time.process_time()
    replay(e, given)
    return (given.frames[-1].time_s - given.frames[0].time_s) / (time.process_time() - worked)


def share_of_kernel(given: Stream) -> float:
    """Part of the processor time of a replay that the compiled filter itself takes [-]: what is left is Python's."""
    kernel, taken = online.run_online, []

    def timed(*arguments: Any) -> None:
        begun = time.thread_time()
        kernel(*arguments)
        taken.append(time.thread_time() - begun)

    with patch.object(online, "run_online", timed):
        e = estimator(given)
        taken.clear()
        worked = time.thread_time()
        replay(e, given)
        return sum(taken) / (time.thread_time() - worked)


def record_speed(name: str = "p06") -> float:
    """Flight time over processor time of a practice record of one point, magnitude and derivatives estimated [-]."""
    record = practice(name)
    e, samples = LiveEstimator(RecordPoints([record]), SIX), samples_of_record(record)
    worked = time.process_time()
    for sample in samples:
        e.add(sample)
        if isinstance(sample, Frame):
            e.advance()
    e.estimates()
    return (samples[-1].time_s - samples[0].time_s) / (time.process_time() - worked)


def seconds_ahead(given: Stream, horizons_s: Sequence[float], rounds: int) -> dict[float, FloatArray]:
    """(round,) wall time of one look-ahead of all points [s] by its horizon [s], on three futures with covariance.

    The planned flight has a pull-up by 5 deg from 10 to 40 s from now; the limits are such that none is near.
    """
    e = estimator(given)
    for batch in given.batches:
        e.add(*batch)
    e.advance()
    now, estimates = given.frames[-1], e.estimates()
    frames = flown_frames(now.time_s, now.time_s + max(horizons_s) + 10.0, 1)
    time_s = np.array([f.time_s for f in frames])
    nominal = {n: np.array([f.values[n] for f in frames]) for n in frames[0].values} | {"time_s": time_s}
    window = Window("popu", now.time_s + 10.0, now.time_s + 40.0)
    pull_up = np.interp(time_s, np.linspace(window.start_s, window.end_s, 4), [0.0, 5.0, 5.0, 0.0])
    planned = nominal | {"alpha_deg": nominal["alpha_deg"] + pull_up}
    futures = Futures(given.source.columns, FlownPath(nominal), FlownPath(planned), [window], {"alpha_deg": 1.0})
    limits = {p.name: {"surface_K": 2500.0, "bondline_K": 700.0} for p in given.source.points}
    found = {}
    for horizon_s in horizons_s:
        ahead = LookAhead(given.source, limits, futures, horizon_s)
        ahead.predict(estimates, now)  # packed
        taken = []
        for _ in range(rounds):
            begun = time.perf_counter()
            told = ahead.predict(estimates, now)
            taken.append(time.perf_counter() - begun)
            if len(next(iter(told.values())).futures) != 3:
                raise RuntimeError("a future is missing")
        found[horizon_s] = np.array(taken)
    return found


def speed(flight_s: float) -> list[Figure]:
    """Rows of the table; flight_s : of the stream that is timed [s]."""
    short = stream(2.0 * NOT_COUNTED_S)
    latencies(short)  # compiled
    given = stream(flight_s)
    wall, busy = (times[round(NOT_COUNTED_S * FRAMES_HZ) :] for times in latencies(given))
    plain_s = float(np.mean(given.plain_s[1:]))
    read = np.array([len(b) > 1 for b in given.batches])[round(NOT_COUNTED_S * FRAMES_HZ) :]
    queued = waiting_too(wall)
    ahead = seconds_ahead(short, (60.0, 600.0), LOOKS)
    size = f"{POINTS} points x 5 sensors x {len(EIGHT)} parameters"
    p50, p99 = (1e3 * np.percentile(busy, q) for q in (50, 99))
    return [
        Figure(f"{size}: samples in to estimate out, processor time p50", p50, "ms", note=f"{FRAMES_HZ} Hz frames, "
               f"{READINGS_HZ} Hz readings, {flight_s:.0f} s of flight"),
        Figure(f"{size}: samples in to estimate out, processor time p99", p99, "ms", LARGEST_MS),
        Figure(f"{size}: samples in to estimate out, wall p50", 1e3 * float(np.median(wall)), "ms"),
        Figure(f"{size}: samples in to estimate out, wall p99", 1e3 * float(np.percentile(wall, 99)), "ms", LARGEST_MS),
        Figure(f"{size}: the same with waiting for the frame before, wall p99", 1e3 * float(np.percentile(queued, 99)),
               "ms", LARGEST_MS),
        Figure(f"{size}: frames with readings, wall p99", 1e3 * float(np.percentile(wall[read], 99)), "ms", LARGEST_MS),
        Figure(f"{size}: wall time over that of the plug-in's steps of the same points", float(np.mean(wall)) / plain_s,
               "", note=f"the plug-in: {1e6 * plain_s:.0f} us a frame"),
        Figure(f"{size}: replay over real time, on one core", replay_speed(given), "x", FASTEST, True),
        Figure(f"{size}: part of the time of that replay in the compiled filter", share_of_kernel(given), ""),
        *(
            Figure(f"{POINTS} points: look-ahead of {h:.0f} s on three futures with covariance, median",
                   1e3 * float(np.median(taken)), "ms", LARGEST_AHEAD_MS[h],
                   note=f"shortest of {LOOKS}: {1e3 * np.min(taken):.0f} ms")
            for h, taken in ahead.items()
        ),
        Figure("one point of a practice record, six parameters: replay over real time", record_speed(), "x", FASTEST,
               True, note="p06 at its own rate, 1 Hz"),
    ]  # fmt: skip
