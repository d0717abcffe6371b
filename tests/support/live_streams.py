"""Streams of samples to try a link with: recorded flights, flights of known truth, and what a bad link does."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

import sim_heating as sh
from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import FRAME, Conditions
from sim_heating.base.kernels.block import LANES
from sim_heating.estimation.filter.march import FilterMarch, FilterTrack
from sim_heating.estimation.filter.online import Prior
from sim_heating.inputs.points import conditions_of_record
from sim_heating.inputs.record import Record, Segments, load_record
from sim_heating.live.filtering.points import LivePoint, RecordPoints
from sim_heating.live.types import Frame, Reading, Sample
from sim_heating.march.ensemble import condition_history
from sim_heating.thermal.stack import Sensor
from tests.support.filter_samples import samples_on_grid
from tests.support.paths import PRACTICE

SIX = ("ratio.scale", "ratio.d_alpha", "ratio.d_beta", "ratio.d_logre", "ratio.d_elevon", "ratio.d_bodyflap")
"""Magnitude and derivatives of the heating ratio."""
EIGHT = (*SIX, "stack.rsi.conductivity_factor", "stack.emissivity_factor")
PRIORS = {
    "ratio.scale": Prior(0.0, 0.05), "ratio.d_alpha": Prior(0.0, 3e-4), "ratio.d_beta": Prior(0.0, 3e-4),
    "ratio.d_logre": Prior(0.0, 3e-3), "ratio.d_elevon": Prior(0.0, 5e-4), "ratio.d_bodyflap": Prior(0.0, 3e-4),
}  # fmt: skip
"""What the parameters of flights of known truth are drawn from, and what the estimator is told of them."""


@cache
def practice(name: str) -> Record:
    """A practice record."""
    return load_record(PRACTICE / name)


def cut(record: Record, end_s: float) -> Record:
    """A record up to a time [s], all of it to be fitted."""

    def until(columns: dict[str, FloatArray]) -> dict[str, FloatArray]:
        return {name: values[columns["time_s"] <= end_s] for name, values in columns.items()}

    return replace(
        record,
        declared=record.declared.model_copy(update={"segments": Segments()}),
        conditions=Conditions(until(dict(record.conditions.columns))),
        thermocouples=until(dict(record.thermocouples)),
    )


def frames_of(conditions: Conditions, time_s: FloatArray) -> list[Frame]:
    """Frames at these times [s], conditions linear in between."""
    at = conditions.at(time_s)
    names = [n for n in at.names if n != "time_s"]
    columns = np.column_stack([at[n] for n in names]).tolist()
    return [Frame(t, dict(zip(names, row, strict=True))) for t, row in zip(time_s.tolist(), columns, strict=True)]


def samples_of_record(record: Record, end_s: float = np.inf) -> list[Sample]:
    """Frames and readings of a record up to a time [s], in order; of one time the readings first."""
    flown = record.conditions.time_s
    frames = frames_of(record.conditions, flown[flown <= end_s])
    point = record.declared.control_point
    readings = [
        Reading(t, point, s.name, T)
        for s in record.sensors
        for t, T in zip(record.time_s.tolist(), record.thermocouples[s.column].tolist(), strict=True)
        if t <= end_s
    ]
    return in_order([*frames, *readings])


def in_order(samples: Sequence[Sample]) -> list[Sample]:
    """Samples in order of time; of one time the readings first."""
    return sorted(samples, key=lambda s: (s.time_s, isinstance(s, Frame)))


class SamePoints:
    """Control points of one wall on one flight, distinguished by their names: what a link of many points estimates.

    record : declares wall, sensors and conditions;  count : number of points
    """

    def __init__(self, record: Record, count: int, nodes: int | None = None) -> None:
        self._one = RecordPoints([record], nodes)
        only = self._one.points[0]
        self.points: tuple[LivePoint, ...] = tuple(replace(only, name=f"P{i:02d}") for i in range(count))
        self.columns = self._one.columns

    def conditions(self, frame: Frame) -> FloatArray:
        """(point, condition) conditions of a frame."""
        return np.repeat(self._one.conditions(frame), len(self.points), axis=0)

    def histories(self, flown: Mapping[str, FloatArray]) -> FloatArray:
        """(point, time, condition) conditions along a flight, given by its columns."""
        return np.repeat(self._one.histories(flown), len(self.points), axis=0)


def word_K(sensor: Sensor, T_K: FloatArray) -> FloatArray:
    """Readings of a recorder that rounds to its nearest word [K]."""
    if sensor.bits is None or sensor.range_K is None:
        return T_K
    code = np.clip(np.rint((T_K - sensor.range_K[0]) / sensor.lsb_K), 0.0, 2.0**sensor.bits - 1.0)
    return np.asarray(sensor.range_K[0] + code * sensor.lsb_K)


@dataclass(frozen=True, eq=False)
class Flight:
    """A flight of known truth.

    source : control points, all of one wall;  record : that declares it
    truth  : (point, parameter) values of SIX
    samples : frames, and words of the recorder, in order
    """

    source: SamePoints
    record: Record
    truth: FloatArray
    samples: list[Sample]


def known_flight(name: str, count: int, end_s: float, every_s: float, rng: np.random.Generator) -> Flight:
    """The flight of a practice record with walls whose heating is drawn from PRIORS, and new noise.

    count : number of points;  end_s : end of the flight [s];  every_s : between frames, and between readings [s]
    """
    record, source = practice(name), SamePoints(practice(name), count)
    time_s = np.arange(record.conditions.time_s[0], end_s + 1e-9, every_s)
    truth = np.array([[rng.normal(PRIORS[n].mean, PRIORS[n].sigma) for n in SIX] for _ in range(count)])
    history = condition_history(conditions_of_record(record).at(time_s))[np.newaxis]
    sensors = [s for s in record.sensors if s.used]
    nodes = [source.points[0].mesh.sensors[record.sensors.index(s)] for s in sensors]
    nothing = samples_on_grid(time_s[1:], nodes, np.full((len(nodes), len(time_s) - 1), np.nan), 1.0)
    tracks = [
        FilterTrack(p.model.with_parameters(dict(zip(SIX, row, strict=True))), p.mesh, nothing, ())
        for p, row in zip(source.points, truth.tolist(), strict=True)
    ]
    marches = [FilterMarch(tracks[k : k + LANES], time_s, history) for k in range(0, count, LANES)]
    readings = []
    for point, told in zip(source.points, [f for m in marches for f in m.filter()], strict=True):
        T = told.predicted_K.reshape(len(time_s) - 1, len(sensors))
        for k, sensor in enumerate(sensors):
            read = word_K(sensor, T[:, k] + rng.normal(0.0, sensor.noise_sigma_K or 1.0, len(T)))
            readings += [
                Reading(t, point.name, sensor.name, v) for t, v in zip(time_s[1:].tolist(), read.tolist(), strict=True)
            ]
    return Flight(source, record, truth, in_order([*frames_of(record.conditions, time_s), *readings]))


@dataclass(frozen=True)
class BadLink:
    """What a link does to its samples on the way.

    loss, doubled : parts of the samples that are lost, and that come twice, a second time with a delay of its own [-]
    late_s        : delay of each, uniform from 0 to this [s]
    jump_s, jump_at_s : jump of the clock of the sender, and when [s]; both 0 for none
    """

    loss: float = 0.05
    doubled: float = 0.05
    late_s: float = 2.0
    jump_s: float = 0.0
    jump_at_s: float = 0.0

    def arrive(self, samples: Sequence[Sample], rng: np.random.Generator) -> list[Sample]:
        """Samples as they arrive, in order of arrival; the first frame and the readings with it are never touched."""
        first_s = next(s.time_s for s in samples if isinstance(s, Frame))
        safe = np.array([s.time_s <= first_s for s in samples])
        copies = np.where(rng.random(len(samples)) < self.doubled, 2, 1)
        copies[(rng.random(len(samples)) < self.loss) & ~safe] = 0
        which = np.repeat(np.arange(len(samples)), copies)
        delay = np.where(safe[which], 0.0, rng.uniform(0.0, self.late_s, len(which)))
        sent = np.array([s.time_s for s in samples])[which]
        order = np.argsort(sent + delay, kind="stable")
        return [self._stamped(samples[k]) for k in which[order]]

    def _stamped(self, sample: Sample) -> Sample:
        """A sample with the time of the sender's clock."""
        if self.jump_s == 0.0 or sample.time_s < self.jump_at_s:
            return sample
        return replace(sample, time_s=sample.time_s + self.jump_s)


def orbiter_of(count: int) -> tuple[sh.Vehicle, list[str]]:
    """The Orbiter with this many control points like V09T9527, five thermocouples each, and their names."""
    vehicle = sh.load_vehicle("orbiter")
    plug = vehicle.control_point("V09T9527")
    names = [f"P{i:02d}" for i in range(count)]
    return replace(vehicle, control_points={n: replace(plug, name=n) for n in names}), names


def flown_frames(begin_s: float, end_s: float, rate_Hz: float) -> list[Frame]:
    """Frames of a host: the columns that it gives, along the entry of a practice record."""
    conditions = practice("p08").conditions
    time_s = begin_s + np.arange(round((end_s - begin_s) * rate_Hz) + 1) / rate_Hz
    known = [n for n in FRAME if n in conditions.names]
    return [Frame(f.time_s, {n: f.values[n] for n in known if n != "time_s"}) for f in frames_of(conditions, time_s)]


Progress = Callable[[str], None]
"""Called with a line of text."""
