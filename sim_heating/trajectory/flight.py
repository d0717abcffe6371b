"""A flown trajectory, and how the frames of every source become flight conditions.

Source: docs/theory/equations.md, section 6."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import EXTRAS, FRAME, LINE_TOLERANCE, LINE_TOLERANCE_SHARE, STATE, Conditions
from sim_heating.base.errors import InputError
from sim_heating.heating.atmosphere import free_stream

OnFrame = Callable[[FloatArray], None]

ROW = FRAME + EXTRAS
"""Columns of one row as given to Sampler.add."""

ANGLE_COLUMNS = tuple(ROW.index(name) for name in ("bank_deg", "heading_deg", "longitude_deg"))
"""Columns of angles that wrap at 360 deg."""
_WATCHED = [ROW.index(name) for name in LINE_TOLERANCE]
_ALPHA = list(LINE_TOLERANCE).index("alpha_deg")
WIDEST_ALPHA_DEG = 2.0
"""Largest change of angle of attack [deg] between two frames that are kept, where frames lie between them. Recovery
enthalpy and dissociation at the edge of a point are curved in alpha: over 4 deg a straight line is 1.5 % of the
dissociation off, 0.14 K at a surface."""
_DISTANCE = np.array(list(LINE_TOLERANCE.values()))
_SHARE = np.array([LINE_TOLERANCE_SHARE.get(name, 0.0) for name in LINE_TOLERANCE])
REPORT_S = 20.0
"""Flight time between two progress reports [s]; events are known to the second."""
_TOLERANCE_S = 1e-7  # a host that sums its frame time is 1e-9 s off after 1000 s


class VehicleData(Protocol):
    """Data of a vehicle that the trajectory sources need; `inputs.vehicle.Vehicle` provides them.

    directory          : folder with its aero/, guidance.toml and jsbsim/
    reference_length_m : length of the Reynolds number [m]
    surfaces           : columns of the control surfaces on which its heating depends
    """

    @property
    def directory(self) -> Path: ...

    @property
    def reference_length_m(self) -> float: ...

    @property
    def surfaces(self) -> tuple[str, ...]: ...


@dataclass(frozen=True)
class Window:
    """Time window of a flown manoeuvre [s]."""

    kind: str
    start_s: float
    end_s: float


AFTER_MANOEUVRE_S = 5.0
"""Time after a manoeuvre [s] in which its frames are kept: control surfaces settle."""


@dataclass(frozen=True)
class Flight:
    """Sampled flight conditions, events as (time [s], text), and windows of the manoeuvres.

    frames : (frame, len(FRAME)) every frame of the simulation within its manoeuvres, in the order of conditions.FRAME,
             for pictures; none where the source has no other frames than its samples
    """

    conditions: Conditions
    events: list[tuple[float, str]] = field(default_factory=list)
    windows: list[Window] = field(default_factory=list)
    frames: FloatArray = field(default_factory=lambda: np.zeros((0, len(FRAME))))

    @property
    def manoeuvres_s(self) -> list[tuple[float, float]]:
        """Start and end of each manoeuvre [s]."""
        return [(w.start_s, w.end_s) for w in self.windows]

    def at_frame_rate(self) -> Conditions:
        """The columns of conditions.FRAME at the samples, and within manoeuvres at every frame of the simulation.

        Angles in [deg], jets [-]: the heating takes the samples, which are linear between them to LINE_TOLERANCE.

        Source: docs/theory/equations.md, section 6.
        """
        sampled = np.column_stack([self.conditions[n] for n in FRAME if n in self.conditions])
        names = [n for n in FRAME if n in self.conditions]
        every = np.concatenate([sampled, self.frames[:, [FRAME.index(n) for n in names]]])
        # a frame at the time of a sample, but for a rounding, is that sample
        _, first = np.unique(np.round(every[:, 0], 6), return_index=True)
        return Conditions({n: np.ascontiguousarray(every[first, i]) for i, n in enumerate(names)})


def frames_within(rows: Sequence[FloatArray], windows: Sequence[Window]) -> FloatArray:
    """(frame, len(FRAME)) frames of a flight, each number in the unit of its column, within a manoeuvre or shortly
    after one [s].

    rows : frames in the order of conditions.FRAME, or of ROW

    Source: docs/theory/equations.md, section 6.
    """
    if not rows or not windows:
        return np.zeros((0, len(FRAME)))
    frames = np.array(rows)[:, : len(FRAME)]
    inside = [(frames[:, 0] >= w.start_s) & (frames[:, 0] <= w.end_s + AFTER_MANOEUVRE_S) for w in windows]
    return frames[np.any(inside, axis=0)]


def check_samples(flight: Flight, sample_s: float) -> None:
    """Check that the samples of a flown trajectory cover it.

    sample_s : interval between the samples [s]
    raises   : InputError where the flight is shorter than the interval, or a manoeuvre begins after the last sample
    """
    time_s = flight.conditions.time_s
    if len(time_s) < 2:
        rule = "is longer than the flight, of which one sample is left; give a shorter interval"
        raise InputError(f"`sample_s`: {sample_s:g} s {rule}")
    late = [w for w in flight.windows if w.start_s > time_s[-1]]
    if late:
        rule = f"leaves the last sample at {time_s[-1]:g} s, before {late[0].kind} at {late[0].start_s:.4g} s"
        raise InputError(f"`sample_s`: {sample_s:g} s {rule}; give a shorter interval")


def conditions_from_rows(rows: FloatArray, length_m: float) -> Conditions:
    """Conditions in the contract's columns from (time, len(ROW)) rows [s], [m], [m/s], [deg], [kg/m3].

    Temperature, pressure, Mach and Reynolds number come from sim_heating.heating.atmosphere; bank, heading and
    longitude are made continuous, so that a value between two samples can be taken linearly (they may pass 180 deg).

    Source: US Standard Atmosphere 1976 for the temperature; docs/theory/equations_reference_heating.md, equations 1
    to 3.
    """
    columns = {name: np.ascontiguousarray(rows[:, i]) for i, name in enumerate(ROW)}
    # Conditions are interpolated linearly: a heading that passes north would sweep through all others in between.
    for i in ANGLE_COLUMNS:
        columns[ROW[i]] = np.unwrap(columns[ROW[i]], period=360.0)
    columns |= free_stream(columns["altitude_m"], columns["velocity_m_s"], columns["rho_kg_m3"], length_m)
    columns["qbar_Pa"] = 0.5 * columns["rho_kg_m3"] * columns["velocity_m_s"] ** 2
    order = STATE + tuple(name for name in columns if name not in STATE)
    return Conditions({name: columns[name] for name in order})


class Sampler:
    """Samples a source's frames at 0, sample_s, 2 sample_s, ... after the first one, linear between frames.

    Where a straight line between two samples misses a frame by more than LINE_TOLERANCE, as in a fast manoeuvre, frames
    between the samples are kept as well, as few as it takes (Douglas and Peucker 1973).
    Pass every frame to `add` as a float64 array in the order of ROW; it is copied where it is stored.
    """

    def __init__(self, sample_s: float, length_m: float) -> None:
        self.sample_s = sample_s
        self.length_m = length_m
        self._rows: list[FloatArray] = []
        self._between: list[FloatArray] = []
        self._samples = 0
        self._before = np.empty(len(ROW))
        self._next_s = -np.inf

    def add(self, row: FloatArray) -> None:
        """Add one frame, (len(ROW),) in the units of its columns; frames must be in order of time [s].

        Source: docs/theory/equations.md, section 6.
        """
        if row[0] >= self._next_s - _TOLERANCE_S:
            self._store(row)
        # A frame at the time of a sample is that sample.
        if row[0] > self._rows[-1][0] + _TOLERANCE_S:
            self._between.append(row.copy())
        self._before[:] = row

    def _store(self, row: FloatArray) -> None:
        if not self._rows:
            self._start_s = float(row[0])
            self._rows.append(row.copy())
            self._samples = 1
        else:
            while self._next_s <= row[0] + _TOLERANCE_S:
                sample = _interpolate_row(self._before, row, self._next_s)
                self._rows += [*_frames_off_the_line(self._rows[-1], self._between, sample), sample]
                self._between, self._samples = [], self._samples + 1
                # Multiples of the interval and not a running sum, whose rounding would drift over a long flight.
                self._next_s = self._start_s + self._samples * self.sample_s
        self._next_s = self._start_s + self._samples * self.sample_s

    def conditions(self) -> Conditions:
        """All samples so far ([s], [m], [m/s], [deg] ...), and the frames that were kept between them.

        Source: docs/theory/equations.md, section 6.
        """
        if not self._rows:
            raise InputError("trajectory: no frame was flown; the flight ends where it starts, change the stop")
        return conditions_from_rows(np.array(self._rows), self.length_m)


def _frames_off_the_line(first: FloatArray, between: list[FloatArray], last: FloatArray) -> list[FloatArray]:
    """Frames between two samples without which linear interpolation would miss one by more than LINE_TOLERANCE, or
    alpha move by more than WIDEST_ALPHA_DEG."""
    # A frame a rounding before the sample is the sample.
    frames = [row for row in between if row[0] < last[0] - _TOLERANCE_S]
    if not frames:
        return []
    rows = np.array([first, *frames, last])
    time, values = rows[:, 0], rows[:, _WATCHED]
    allowed = np.maximum(_DISTANCE + _SHARE * np.abs(values), np.finfo(float).tiny)
    kept, open_ends = [], [(0, len(rows) - 1)]
    while open_ends:
        i, j = open_ends.pop()
        if j - i < 2:
            continue
        fraction = ((time[i + 1 : j] - time[i]) / (time[j] - time[i]))[:, None]
        line = values[i] + fraction * (values[j] - values[i])
        distance = np.max(np.abs(values[i + 1 : j] - line) / allowed[i + 1 : j], axis=1)
        k = i + 1 + int(np.argmax(distance))
        # Along a straight line alpha may still move far, and what a point derives from it is curved.
        if distance[k - i - 1] <= 1.0 and abs(values[j, _ALPHA] - values[i, _ALPHA]) > WIDEST_ALPHA_DEG:
            k = (i + j) // 2
        elif distance[k - i - 1] <= 1.0:
            k = i
        if k > i:
            kept.append(k)
            open_ends += [(i, k), (k, j)]
    return list(rows[sorted(kept)])


def _interpolate_row(before: FloatArray, after: FloatArray, time_s: float) -> FloatArray:
    """Row at a time between two frames, linear; angles take the short way round."""
    # A sample may be due up to _TOLERANCE_S after the frame; it takes the frame and is not extrapolated.
    fraction = min((time_s - before[0]) / (after[0] - before[0]), 1.0)
    step = after - before
    for i in ANGLE_COLUMNS:
        step[i] = (step[i] + 180.0) % 360.0 - 180.0
    row = before + fraction * step
    row[0] = time_s
    return row
