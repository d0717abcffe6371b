"""A record of a million readings as one of some ten thousand: neighbours averaged where nothing moves between them.

    T_i = mean of n neighbours, at their mean time;   sigma of the mean = sigma / sqrt(n)

The mean over a straight line is its value at the mean time. A bend leaves T'' w^2 / 24 over the width w of a mean.
Where that is more than a part of its noise, fewer neighbours are averaged; means over the few bends left are dropped.
Noise that changes over a time (`noise_correlation_s`) is not smaller in a mean.

Conditions are averaged alike, and kept row by row where one of them jumps.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from sim_heating.base.arrays import BoolArray, FloatArray, IntArray
from sim_heating.base.conditions import Conditions
from sim_heating.inputs.record import Record
from sim_heating.thermal.stack import Sensor

LARGE, AIM = 50_000, 20_000
"""Number of readings from which a record is averaged, and about how many it has then."""
CONDITIONS_AIM = 5_000
BEND_SIGMA = 0.5
"""Bend of a mean from which it is left out, in standard deviations of its noise."""
MOST_BENT = 0.002
"""Part of the means that may be left out."""
SMALLEST_K = 1e-3
"""Least noise of a reading that is reckoned with [K]."""
JUMP_SHARE, JUMP_SIGMA = 2e-3, 6.0
"""Departure of a condition from the line through the means beside it, over its range and over its noise, from which its
rows are kept."""
FILLED = 0.5
"""Least part of the neighbours of a mean that are there."""
DITHER = 0.5
"""Least noise in counts of the recorder for a mean to be finer than a count."""


@dataclass(frozen=True)
class _Groups:
    """Neighbours that are averaged: each row of the table has the number of its group.

    first, count : (group,) first row, and number of rows
    """

    first: IntArray
    count: IntArray

    def mean(self, values: FloatArray) -> FloatArray:
        """(group,) mean of (row,) values in their unit, those that are NaN left out; NaN where half of them are."""
        there = np.isfinite(values)
        n = np.add.reduceat(there.astype(np.float64), self.first)
        total = np.add.reduceat(np.where(there, values, 0.0), self.first)
        return np.where(n >= FILLED * self.count, total / np.maximum(n, 1.0), np.nan)


def averaged_record(record: Record) -> tuple[Record, list[str]]:
    """A record with fewer readings and conditions, where it has very many, and one line on what was done.

    returns : the record itself, without a line, below LARGE readings
    """
    if len(record.time_s) < LARGE and len(record.conditions) < LARGE:
        return record, []
    averaged, lines = record, []
    if len(record.time_s) >= LARGE:
        averaged, line = _averaged_readings(averaged)
        lines.append(line)
    if len(record.conditions) >= LARGE:
        conditions = _averaged_conditions(record.conditions)
        lines.append(
            f"{record.name}: {len(record.conditions)} rows of conditions averaged to {len(conditions)}, all rows kept "
            "where one of them jumps"
        )
        averaged = replace(averaged, conditions=conditions)
    return averaged, lines


def _averaged_readings(record: Record) -> tuple[Record, str]:
    rows = len(record.time_s)
    noise = {s.column: _noise_K(record.thermocouples[s.column], s.noise_sigma_K) for s in record.sensors}
    coarse = [s for s in record.sensors if s.lsb_K > 0.0 and noise[s.column] < DITHER * s.lsb_K]
    not_averaged = f"{record.name}: {rows} readings, none averaged: {{}}; this takes long"
    if coarse:
        return record, not_averaged.format(f"{coarse[0].name} has less noise than a count")
    averages = _longest_averages(record, noise)
    if averages is None:
        return record, not_averaged.format("the temperature moves between neighbours")
    n, groups, means, bent = averages
    left_out = int(sum(map(np.count_nonzero, bent.values())))
    readings: Mapping[str, FloatArray] = {
        "time_s": groups.mean(record.time_s),
        **{column: np.where(bent[column], np.nan, values) for column, values in means.items()},
    }
    sensors = [_of_mean(s, n) for s in record.sensors]
    other = replace(record.with_sensors(sensors), thermocouples=readings)
    remark = f"; {left_out} means over a bend left out" if left_out else ""
    line = (
        f"{record.name}: {rows} readings averaged by {n} neighbours to {len(groups.first)}, with the noise of the mean"
    )
    return other, line + remark


def _longest_averages(
    record: Record, noise: Mapping[str, float]
) -> tuple[int, _Groups, dict[str, FloatArray], dict[str, BoolArray]] | None:
    """Means of as many neighbours as bend little, at most those of AIM means; None where pairs bend."""
    labels = record.fit_mask().astype(np.int8) + 2 * record.holdout_mask().astype(np.int8)
    n = math.ceil(len(record.time_s) / AIM)
    while n > 1:
        groups = _groups(labels, n)
        means = {s.column: groups.mean(record.thermocouples[s.column]) for s in record.sensors}
        bent = {column: _bent(mean, noise[column] / math.sqrt(n)) for column, mean in means.items()}
        if all(np.mean(b) <= MOST_BENT for b in bent.values()):
            return n, groups, means, bent
        n //= 2
    return None


def _of_mean(sensor: Sensor, n: int) -> Sensor:
    """The sensor as its means of n readings have it: no counts, and the noise of the mean where it is white."""
    sigma = sensor.noise_sigma_K
    if sigma is not None:
        sigma = math.hypot(sigma, sensor.lsb_K / math.sqrt(12.0))
        sigma = sigma if sensor.noise_correlation_s else sigma / math.sqrt(n)
    return sensor.model_copy(update={"noise_sigma_K": sigma, "bits": None, "range_K": None})


def _groups(labels: IntArray, n: int) -> _Groups:
    """Groups of n rows, of one segment each."""
    edges = np.flatnonzero(np.diff(labels)) + 1
    starts = np.concatenate(([0], edges))
    ends = np.concatenate((edges, [len(labels)]))
    first = np.concatenate([np.arange(a, b, n) for a, b in zip(starts, ends, strict=True)])
    return _Groups(first, np.diff(np.concatenate((first, [len(labels)]))))


def _noise_K(values: FloatArray, declared_K: float | None) -> float:
    """White noise of readings [K] by the differences of neighbours, robust against steps; no more than declared."""
    apart = np.abs(np.diff(values))
    apart = apart[np.isfinite(apart)]
    median = float(np.median(apart)) if apart.size else 0.0
    return max(min(median / (0.6745 * math.sqrt(2.0)), declared_K or math.inf), SMALLEST_K)


def _bent(means: FloatArray, sigma: float) -> BoolArray:
    """(group,) whether a mean differs by its bend from the value at its mean time: |second difference| / 24."""
    bend = np.zeros(len(means))
    bend[1:-1] = np.abs(np.diff(means, 2)) / 24.0
    return np.nan_to_num(bend) > BEND_SIGMA * sigma


def _averaged_conditions(conditions: Conditions) -> Conditions:
    """Conditions of means, with all rows of groups in which one of them departs from a line."""
    rows = len(conditions)
    n = math.ceil(rows / CONDITIONS_AIM)
    groups = _groups(np.zeros(rows, dtype=np.int64), n)
    t = groups.mean(conditions.time_s)
    means = {name: groups.mean(v) for name, v in conditions.columns.items() if name != "time_s"}
    jumps = np.zeros(len(t), dtype=bool)
    for name, mean in means.items():
        values = conditions[name]
        noise = float(np.median(np.abs(np.diff(values)))) / (0.6745 * math.sqrt(2.0))
        limit = max(JUMP_SHARE * float(np.ptp(values)), JUMP_SIGMA * noise / math.sqrt(n), 1e-300)
        apart = np.abs(mean[1:-1] - 0.5 * (mean[:-2] + mean[2:])) > limit
        jumps[1:-1] |= apart
        jumps[:-2] |= apart
        jumps[2:] |= apart
    jumps[[0, -1]] = True
    kept = np.repeat(jumps, groups.count)
    time_s = np.concatenate((conditions.time_s[kept], t[~jumps]))
    order = np.argsort(time_s)
    columns = {name: np.concatenate((conditions[name][kept], mean[~jumps]))[order] for name, mean in means.items()}
    return Conditions({"time_s": time_s[order], **columns})
