"""Isolated outliers among the readings of a thermocouple, found from the readings alone.

A wall has heat capacity: its temperature cannot leave the line of its neighbours for one reading and be back with the
next. Reading i deviates by

    d_i = T_i - sum_j l_j(t_i) T_j,    j = i - 2, i - 1, i + 1, i + 2,

l_j Lagrange's polynomials, from the cubic through its neighbours. It is an outlier where |d_i| is more than LIMIT times
the scale of such deviations, in the whole record and near it; where the lines through the two readings on either side
are both beyond T_i, in one direction, which they are not at a corner of the temperature; and where neither neighbour
deviates as well. Two in a row are no outliers: they may be an event.

The scale is 1.4826 times the median of |d|, a tenth of a kelvin at least, and no less than what the declared noise and
the recorder's word give. Source of the scale: P. J. Rousseeuw and C. Croux, "Alternatives to the Median Absolute
Deviation", J. Am. Stat. Assoc. 88 (1993).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from sim_heating.base.arrays import BoolArray, FloatArray
from sim_heating.base.files import display_path
from sim_heating.estimation.inference.noise import NORMAL_MEDIAN
from sim_heating.inputs.record import Record
from sim_heating.thermal.stack import Sensor

LIMIT = 5.0
"""Deviation of an outlier over the scale of deviations [-]."""
LEAST_SCALE_K = 0.1
"""Least scale of deviations [K]."""
NEAR, FEWEST = 10, 12
"""Readings on either side that the scale nearby is of, and least number of readings among which outliers are sought."""
BEYOND, BACK = 0.5, 0.25
"""Distance of an outlier from the lines on either side, at least, and deviation of its neighbours without it, at most,
over its own deviation [-]."""
QUIET = 2.5
"""Deviation of its neighbours over the scale [-] that is none."""
ROOT_OF_WEIGHTS = math.sqrt(1.0 + 34.0 / 36.0)
"""Standard deviation of d over that of a reading, evenly spaced [-]."""
MOST_LISTED = 5
"""Outliers of one sensor that a line names one by one."""


@dataclass(frozen=True)
class Outlier:
    """One reading that is left out.

    record, sensor : names
    time_s         : [s];  reading_K, expected_K : as read, and by its neighbours [K]
    row            : of the file of measurements, names on its first; None for a record that is of no file
    """

    record: str
    sensor: str
    time_s: float
    reading_K: float
    expected_K: float
    row: int | None = None

    @property
    def in_words(self) -> str:
        """Reading, time and row."""
        row = "" if self.row is None else f" (row {self.row})"
        return f"{self.reading_K:.0f} K at {self.time_s:g} s{row}"

    def as_json(self) -> dict[str, Any]:
        """Its entry in estimate.json and closure.json."""
        return asdict(self)


def without_outliers(record: Record) -> tuple[Record, list[Outlier]]:
    """The record with isolated outliers of its used sensors as lost samples, and these.

    Source: docs/theory/estimation_statistics.md, equation 21a.
    """
    outliers: list[Outlier] = []
    columns: dict[str, FloatArray] = {}
    for sensor in record.used_sensors:
        read = record.thermocouples[sensor.column]
        away, expected_K = isolated(record.time_s, read, sensor)
        if not away.any():
            continue
        columns[sensor.column] = np.where(away, np.nan, read)
        rows = record.rows if len(record.rows) == len(read) else None
        outliers += [
            Outlier(
                record.name,
                sensor.name,
                float(record.time_s[i]),
                float(read[i]),
                float(expected_K[i]),
                None if rows is None else int(rows[i]),
            )
            for i in np.flatnonzero(away)
        ]
    return (replace(record, thermocouples={**record.thermocouples, **columns}), outliers) if outliers else (record, [])


def outlier_lines(outliers: Sequence[Outlier], files: Mapping[str, Record]) -> list[str]:
    """One line for each sensor with outliers: how many, which readings, of which rows of which file.

    files : records by their names
    """
    by_sensor: dict[tuple[str, str], list[Outlier]] = {}
    for outlier in outliers:
        by_sensor.setdefault((outlier.record, outlier.sensor), []).append(outlier)
    lines = []
    for (name, sensor), of_sensor in by_sensor.items():
        record = files[name]
        file = display_path(record.directory / record.declared.thermocouples.file)
        unlisted = f" and {len(of_sensor) - MOST_LISTED} more" if len(of_sensor) > MOST_LISTED else ""
        is_single = len(of_sensor) == 1
        count = (
            "1 isolated reading is an outlier and"
            if is_single
            else f"{len(of_sensor)} isolated readings are outliers and"
        )
        count += " is" if is_single else " are"
        listed = ", ".join(o.in_words for o in of_sensor[:MOST_LISTED])
        lines.append(f"{name}, sensor {sensor}: {count} left out: {listed}{unlisted} of {file}")
    return lines


def isolated(time_s: FloatArray, reading_K: FloatArray, sensor: Sensor) -> tuple[BoolArray, FloatArray]:
    """Which readings of a sensor are isolated outliers, and what their neighbours make of each.

    time_s, reading_K : (sample,) [s], [K]; NaN where a sample was lost
    sensor            : with its noise and word
    returns           : (sample,) mask, and (sample,) expected readings [K], NaN where they are not known

    Source: docs/theory/estimation_statistics.md, equation 21a.
    """
    away, expected_K = np.zeros(len(reading_K), dtype=bool), np.full(len(reading_K), np.nan)
    at = np.flatnonzero(np.isfinite(reading_K))
    t, T = time_s[at], reading_K[at]
    n = len(T)
    if n < FEWEST:
        return away, expected_K
    middle = np.arange(2, n - 2)
    by_neighbours = _polynomial(t, T, middle, (-2, -1, 1, 2))
    d = T[middle] - by_neighbours
    scale = _scales(d, T[middle], sensor)
    before = _polynomial(t, T, middle, (-2, -1))
    after = _polynomial(t, T, middle, (1, 2))
    sign = np.sign(d)
    beyond = np.minimum(sign * (T[middle] - before), sign * (T[middle] - after)) >= BEYOND * np.abs(d)
    far = (np.abs(d) > LIMIT * scale) & beyond
    for k in np.flatnonzero(far):
        i = middle[k]
        if not (3 <= i < n - 3):
            continue
        # the neighbours without it: one that deviates as well makes two in a row, an event
        one_before = abs(T[i - 1] - _polynomial(t, T, np.array([i - 1]), (-2, -1, 2, 3))[0])
        one_behind = abs(T[i + 1] - _polynomial(t, T, np.array([i + 1]), (-3, -2, 1, 2))[0])
        if max(one_before, one_behind) > max(QUIET * scale[k], BACK * abs(d[k])):
            continue
        away[at[i]], expected_K[at[i]] = True, by_neighbours[k]
    return away, expected_K


def _scales(d: FloatArray, T: FloatArray, sensor: Sensor) -> FloatArray:
    """(reading,) scale of the deviations [K], of the whole record and nearby, whichever is larger."""
    size = np.abs(d)
    padded = np.pad(size, NEAR, mode="reflect" if len(size) > NEAR else "edge")
    nearby = np.median(np.lib.stride_tricks.sliding_window_view(padded, 2 * NEAR + 1), axis=1)
    noise = np.hypot(sensor.noise_sigma_K or 0.0, sensor.growing_noise_K(T))
    declared = np.maximum(ROOT_OF_WEIGHTS * noise, 0.5 * sensor.lsb_K)
    return np.maximum(np.maximum(NORMAL_MEDIAN * np.maximum(nearby, np.median(size)), declared), LEAST_SCALE_K)


def _polynomial(t: FloatArray, T: FloatArray, index: np.ndarray, others: Sequence[int]) -> FloatArray:
    """(reading,) values at some readings of the polynomial through others, by their distances in the list."""
    total = np.zeros(len(index))
    for j in others:
        weight = np.ones(len(index))
        for m in others:
            if m != j:
                weight *= (t[index] - t[index + m]) / (t[index + j] - t[index + m])
        total += weight * T[index + j]
    return total
