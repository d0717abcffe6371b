"""The sequential test of innovations on whole flights: false alarms, and the delay where something is missing."""

from __future__ import annotations

import math
import tomllib
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from scipy.stats import poisson

from benchmarks.challenge.record import make_and_write
from benchmarks.live_exact import NULL
from benchmarks.measure import Figure
from sim_heating.inputs.record import Record, load_record
from sim_heating.live.filtering.estimator import LiveEstimator
from sim_heating.live.filtering.points import RecordPoints
from sim_heating.live.types import Frame
from sim_heating.live.watch.checks import SensorChecks
from sim_heating.live.watch.sequential import Alarm, SequentialTest, score_of_word
from tests.support.live_streams import SIX, Progress, practice, samples_of_record
from tests.support.paths import PRACTICE

RATE, SEED, HOUR_S = 0.01, 26, 3600.0


@dataclass(frozen=True)
class Watched:
    """A flight whose innovations were tested as they came.

    alarm : the first one, None for none;  hours : of the flight;  removed : sensors that were taken out
    """

    name: str
    alarm: Alarm | None
    hours: float
    removed: tuple[str, ...]


def watch(record: Record, rate: float = RATE) -> Watched:
    """Follow a record with magnitude and derivatives estimated, sensors checked, innovations tested, as a link does."""
    e = LiveEstimator(RecordPoints([record]), SIX)
    point = record.declared.control_point
    checks = SensorChecks({(point, s.name): s for s in record.sensors})
    test, samples = SequentialTest(rate), samples_of_record(record)
    for sample in samples:
        e.add(sample)
        if not isinstance(sample, Frame):
            continue
        e.advance()
        for read in e.innovations():
            failure = checks.take(read)
            if failure is not None:
                e.leave_out(failure.point, failure.sensor, failure.from_s)
                test.leave_out(failure.point, failure.sensor)
            elif not (read.is_left_out or checks.has_failed(read.point, read.sensor)):
                score = score_of_word(read.innovation_K, read.variance_K2, read.predicted_variance_K2)
                test.take(read.time_s, read.point, read.sensor, score)
        if test.alarm is not None:
            break
    hours = (samples[-1].time_s - samples[0].time_s) / HOUR_S
    removed = tuple(f"{f.sensor}: {f.why}" for f in checks.failures)
    return Watched(record.name, test.alarm, hours, removed)


def null_flights(count: int, progress: Progress) -> list[Watched]:
    """Flights of another program without an undeclared effect, whose models are exact."""
    found: list[Watched] = []
    with TemporaryDirectory() as folder:
        for number in range(count):
            name, _, _ = make_and_write((SEED, number, "null", Path(folder), False))
            found.append(watch(load_record(Path(folder) / name)))
            progress(f"null flights: {len(found)} of {count}")
    return found


def delays() -> dict[str, tuple[str, float, float]]:
    """Effect of each practice record that has one, where it begins to act [s], and the delay of the alarm [s]."""
    answers = tomllib.loads((PRACTICE / "answers.toml").read_text())
    found = {}
    for name, answer in answers.items():
        if answer["effect"] == "none":
            continue
        begins_s = float(answer["active_windows_s"][0][0])
        alarm = watch(practice(name)).alarm
        found[name] = (answer["effect"], begins_s, math.inf if alarm is None else alarm.time_s - begins_s)
    return found


def alarms(nulls: int, progress: Progress) -> tuple[list[Figure], dict[str, object]]:
    """Rows of the table, and what each flight gave; nulls : number of null flights."""
    flights = null_flights(nulls, progress)
    fired = [f for f in flights if f.alarm is not None]
    expected = RATE * sum(f.hours for f in flights)
    late = delays()
    sound = {name: watch(practice(name)).alarm for name in NULL}
    wrong = [f"{name}: {alarm.text}" for name, alarm in sound.items() if alarm is not None]
    progress("practice records with an effect")
    median = float(np.median([d for _, _, d in late.values()]))
    never = [name for name, (_, _, d) in late.items() if math.isinf(d)]
    figures = [
        Figure("null flights with a false alarm", len(fired), "", float(poisson.ppf(0.99, expected)),
               note=f"of {nulls}; the stated rate allows {expected:.2f}, with a chance of 1 % so many as the bound"),
        Figure("practice records without an effect with a false alarm", len(wrong), "", 0.0, note=f"of {len(sound)}"),
        Figure("null flights in which a sound sensor is taken out", sum(bool(f.removed) for f in flights), "",
               note=f"of {nulls}"),
        Figure("practice records with an effect: median delay of the alarm", median, "s",
               note=f"{len(late)} records, {len(never)} without an alarm"),
    ]  # fmt: skip
    rows: dict[str, object] = {
        "false_alarms": [*(f"{f.name}: {f.alarm.text}" for f in fired if f.alarm is not None), *wrong],
        "taken_out": [f"{f.name}: {line}" for f in flights for line in f.removed],
        "delays": {
            name: {"effect": effect, "acts_from_s": t, "delay_s": None if math.isinf(d) else d}
            for name, (effect, t, d) in late.items()
        },
    }
    return figures, rows
