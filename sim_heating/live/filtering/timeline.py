"""The samples of a link in order of flight time, over a window: late, doubled, reordered and jumping ones sorted out.

What is kept does not depend on the order in which samples of the window came in. A sample that is older than the
newest frame by more than the window is too late. A frame far ahead of the clock, or behind it by more than the window,
is a damaged time or a new clock: the third of such frames in a row, in order among themselves, is a new clock, or the
end of a gap. What is ahead by no more than a few lost frames is not far.

A clock that goes back by less looks like late samples, but for one thing: its samples come at times that are taken
already, with other values. Those times, from the first to the last, are as long as the jump, however late the samples
come. That they have ended is known once the newest frame has gone on by a window since the last of them came.
"""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from itertools import pairwise

from sim_heating.live.filtering.gaps import is_gap
from sim_heating.live.types import Frame, Reading, Sample

CONFIRMED_BY = 3
"""Number of frames in a row that make a new clock."""
MOST_WAITING = 10_000
"""Number of readings that wait for a new clock, or ahead of the newest frame, at most."""

LATE_IN_A_ROW, TOO_LATE_IN_A_ROW = 30, 5
"""Readings of a sensor, one after the other, that come late by half the window, or after it, until that is reported.
Of delays that are as long as they happen to be, to the length of the window, one in 2^30 does so."""
SAME_TIME = 0.01
"""Part of the time between two readings of a sensor within which a third one has the time of one of them [-]."""
MOST_APART = 1.5
"""Usual times between frames by which two may be apart without another one between them [-]."""
RECENT_FRAMES = 40
"""Frames over which the usual time between them is found."""
MOST_LOST = 4
"""Frames lost in a row behind which the next one is not far ahead."""

NOTHING_BEFORE = -math.inf, math.nan
"""Time [s] and value [K] of the reading before the first one of a sensor."""
LONGEST_NUMBER = math.inf
"""Larger than the number of any sensor."""
LONGEST_S = 1e300
"""A flight time that is finite, and none is longer [s]."""


class Placed(Enum):
    """What became of a sample that came in."""

    TAKEN = "taken in order"
    LATE = "late, put where it belongs"
    TOO_LATE = "too late, not used"
    DOUBLED = "doubled, not used"
    WAITING = "on another clock, waiting for more of it"
    JUMPED = "on a new clock, which the link follows from here on"
    LOST = "lost: not a number"


@dataclass(frozen=True)
class Jump:
    """A jump of the clock: from the last frame on the old one to the first on the new one [s].

    is_gap : whether the frames between are missing instead, as the conditions tell; None where they do not
    """

    from_s: float
    to_s: float
    is_gap: bool | None = False

    @property
    def by_s(self) -> float:
        """Length of the jump [s], below 0 where the clock went back."""
        return self.to_s - self.from_s


@dataclass
class Counts:
    """Numbers of samples by what became of them, since the link came up.

    late, too_late, doubled, lost : readings and frames that came behind others, after the window, twice, as no number
    off_clock                     : samples on another clock that was not confirmed, or of an old one
    jumps                         : jumps of the clock, and gaps that may be one
    lateness_s                    : largest lateness of a sample that was still used [s]
    """

    late: int = 0
    too_late: int = 0
    doubled: int = 0
    lost: int = 0
    off_clock: int = 0
    jumps: int = 0
    lateness_s: float = 0.0


@dataclass
class Repeated:
    """Times that came again with other values.

    first_s, last_s : the first and the last of them [s]
    samples   : number of samples with other values;  frames : and of frames among them
    by_sensor : number of such readings by sensor
    doubled_s : times of the frames that came again since, with whatever values [s]
    newest_s  : time of the newest frame when the last of them came [s]
    every_s   : usual time between frames before they came [s];  times_s : all of them [s]
    """

    first_s: float
    last_s: float
    newest_s: float
    every_s: float
    times_s: set[float] = field(default_factory=set)
    samples: int = 0
    frames: int = 0
    by_sensor: dict[int, int] = field(default_factory=dict)
    doubled_s: set[float] = field(default_factory=set)

    @property
    def length_s(self) -> float:
        """How far the clock went back [s]: over the times that came twice, to where the next one would be."""
        times = sorted(self.times_s)
        apart = min((b - a for a, b in pairwise(times)), default=self.every_s)
        frames = [t for t in self.doubled_s if self.first_s <= t <= self.last_s]
        of_frames = max(frames) - min(frames) + self.every_s if frames else 0.0
        return max(of_frames, self.last_s - self.first_s + min(apart, self.every_s))


Word = tuple[float, int, float]
"""A reading: flight time [s], number of the sensor, value [K]."""


@dataclass
class Timeline:
    """Samples of a window in order of time.

    sensors    : number of each sensor by point and name
    lateness_s : window [s]: how far behind the newest frame a sample may come
    jump_s     : how far ahead of the newest frame one may come [s], beyond which a new clock is suspected
    gate_K     : by sensor, by how much one reading may differ from the last that came, more than which is noted in
                 `differs_s`, the times [s]; twice as much from the one before it in time is noted in `jumps`, as time
                 [s] and number of the sensor; None for no such notes
    frames_s, frames : times [s] and frames of the window in order;  readings : in order

    `counts` and `jump`, the last jump of the clock, tell what happened. conflict_s : time of the first sample that came
    again with another value [s], as after a clock that went back by less than the window; None for none.
    """

    sensors: Mapping[tuple[str, str], int]
    lateness_s: float = 2.0
    jump_s: float = 2.5
    gate_K: Sequence[float] | None = None
    frames_s: list[float] = field(default_factory=list)
    frames: list[Frame] = field(default_factory=list)
    readings: list[Word] = field(default_factory=list)
    counts: Counts = field(default_factory=Counts)
    jump: Jump | None = None
    newest_s: float = -math.inf
    conflict_s: float | None = None
    repeated: Repeated | None = None
    is_two_sources: bool = False
    differs_s: list[float] = field(default_factory=list)
    jumps: list[tuple[float, int]] = field(default_factory=list)
    late_sensors: list[tuple[int, float, bool]] = field(default_factory=list)
    _in_time_s: dict[int, float] = field(default_factory=dict)
    _late: dict[int, list[float]] = field(default_factory=dict)
    _behind: tuple[float, float] = (math.inf, -math.inf)
    _suspects: list[Frame] = field(default_factory=list)
    _aside: list[Word] = field(default_factory=list)
    _last_word: dict[int, tuple[float, float]] = field(default_factory=dict)
    _last_K: dict[int, float] = field(default_factory=dict)

    def put(self, sample: Sample) -> Placed:
        """Put a sample where it belongs; what became of it.

        JUMPED: the first frames on a new clock are there, to be taken with `follow` once what was before the jump is
        done with.
        """
        if isinstance(sample, Frame):
            placed = self._put_frame(sample)
        else:
            placed = self._put_word(sample.time_s, self.sensors[sample.point, sample.sensor], sample.value_K)
        if placed is not Placed.TAKEN:
            self._count(placed, sample.time_s)
        return placed

    def put_readings(self, readings: Sequence[Reading], after_s: float) -> int:
        """Put readings at the end, as long as each is the next in order, which is by far the most frequent case.

        after_s : time [s] behind which they have to be
        returns : number of readings that were in order and are in the timeline; the next one is for `put`
        """
        ordered, last, sensors = self.readings, self._last_word, self.sensors
        first_s = max(after_s, self.newest_s - self.lateness_s)
        until_s = self.newest_s + self.jump_s if self.frames else LONGEST_S
        behind_s, behind = ordered[-1][:2] if ordered else (-math.inf, -1)
        gate_K, last_K = self.gate_K, self._last_K
        late_s, in_time_s = self.newest_s - 0.5 * self.lateness_s, self._in_time_s
        for count, reading in enumerate(readings):
            t, value_K = reading.time_s, reading.value_K
            number = sensors.get((reading.point, reading.sensor), -1)
            before_s, before_K = last.get(number, NOTHING_BEFORE)
            # No comparison holds of what is no number.
            if not (
                first_s < t <= until_s
                and t > before_s
                and number >= 0
                and -math.inf < value_K < math.inf
                and (t > behind_s or (t == behind_s and number > behind))
            ):
                return count
            ordered.append((t, number, value_K))
            if gate_K is not None:
                gate = gate_K[number]
                if abs(value_K - last_K.get(number, value_K)) > gate:
                    self.differs_s += (t if before_s == -math.inf else before_s), t
                if abs(value_K - before_K) > 2.0 * gate:
                    self.jumps.append((t, number))
                last_K[number] = value_K
            last[number] = t, value_K
            behind_s, behind = t, number
            if t > late_s:
                in_time_s[number] = t
            else:
                self._note_lateness(number, t)
        return len(readings)

    def _count(self, placed: Placed, time_s: float) -> None:
        counts = self.counts
        if placed is Placed.LATE:
            counts.late += 1
            counts.lateness_s = max(counts.lateness_s, self.newest_s - time_s)
        elif placed is Placed.TOO_LATE:
            counts.too_late += 1
            first_s, newest_s = self._behind
            before = first_s if newest_s >= self.newest_s - self.lateness_s else math.inf
            self._behind = min(before, time_s), self.newest_s
        elif placed is Placed.DOUBLED:
            counts.doubled += 1
        elif placed is Placed.LOST:
            counts.lost += 1

    def _put_frame(self, frame: Frame) -> Placed:
        t = frame.time_s
        if not all(map(math.isfinite, (t, *frame.values.values()))):
            return Placed.LOST
        if self.frames and not self.newest_s - self.lateness_s <= t <= self.newest_s + self.jump_s:
            if not self._is_behind_lost_ones(frame):
                return self._suspect(frame)
            self._take_waiting(t)
        self._drop_suspects()
        if not self.frames or t > self.newest_s:
            self.frames_s.append(t)
            self.frames.append(frame)
            self.newest_s = t
            return Placed.TAKEN
        at = bisect_left(self.frames_s, t)
        if at < len(self.frames_s) and self.frames_s[at] == t:
            if self.repeated is not None:
                self.repeated.doubled_s.add(t)
            return self._again(t, self.frames[at].values == frame.values)
        if self._is_between(frame, at):
            self._repeat(t)
        self.frames_s.insert(at, t)
        self.frames.insert(at, frame)
        return Placed.LATE

    def _again(self, time_s: float, is_same: bool, number: int | None = None) -> Placed:
        if not is_same:
            if self.conflict_s is None:
                self.conflict_s = time_s
            self._repeat(time_s, number)
        return Placed.DOUBLED

    def _repeat(self, time_s: float, number: int | None = None) -> None:
        """Enter a sample at a time that is taken; number : of its sensor, None for a frame."""
        if self.is_two_sources:
            return
        repeated = self.repeated
        if repeated is None:
            behind_s, newest_s = self._behind
            first_s = min(time_s, behind_s) if newest_s >= self.newest_s - self.lateness_s else time_s
            repeated = self.repeated = Repeated(first_s, time_s, self.newest_s, self.every_s)
        repeated.first_s, repeated.last_s = min(repeated.first_s, time_s), max(repeated.last_s, time_s)
        repeated.newest_s = self.newest_s
        repeated.times_s.add(time_s)
        repeated.samples += 1
        if number is None:
            repeated.frames += 1
            repeated.doubled_s.add(time_s)
        else:
            repeated.by_sensor[number] = repeated.by_sensor.get(number, 0) + 1

    def _is_between(self, frame: Frame, index: int) -> bool:
        """Whether a late frame falls between two that follow one another, and is not of their flight."""
        if not 0 < index < len(self.frames):
            return False
        before, after = self.frames[index - 1], self.frames[index]
        apart_s = after.time_s - before.time_s
        every_s = self.every_s if self.repeated is None else self.repeated.every_s
        if apart_s > MOST_APART * every_s:
            return False
        fraction = (frame.time_s - before.time_s) / apart_s
        return any(
            abs(value - (1.0 - fraction) * before.values[name] - fraction * after.values[name])
            > abs(after.values[name] - before.values[name]) + 1e-9 * abs(value)
            for name, value in frame.values.items()
            if name in before.values and name in after.values
        )

    @property
    def every_s(self) -> float:
        """Usual time between two frames [s], where some are missing or came late; 0 before there are two."""
        recent = self.frames_s[-RECENT_FRAMES:]
        apart = sorted(b - a for a, b in pairwise(recent))
        return apart[len(apart) // 4] if apart else 0.0

    @property
    def held_s(self) -> float:
        """Time from which on it is not known yet which clock samples are of [s]; infinite for none."""
        return math.inf if self.repeated is None else self.repeated.first_s

    def differs_from(self, near_s: float) -> float:
        """First time [s] of readings that differ, to which one that still may come, so much later, adds a neighbour."""
        if not self.differs_s:
            return math.inf
        reached_s = self.newest_s - self.lateness_s - near_s
        return min((t for t in self.differs_s if t > reached_s), default=math.inf)

    def repeated_until_now(self) -> Repeated | None:
        """The times that came again, once they have ended, and are reported thereby; None before, and for none.

        Those that go on for longer than a jump back can last are of two sources.
        """
        repeated = self.repeated
        if repeated is None:
            return None
        if repeated.last_s - repeated.first_s > self.lateness_s + self.jump_s:
            self.repeated, self.is_two_sources = None, True
            return None
        if self.newest_s < repeated.newest_s + self.lateness_s:
            return None
        self.repeated = None
        return repeated

    def is_of_frames(self, repeated: Repeated) -> bool:
        """Whether the frames went back too: one that came again differs, or most of them came again."""
        flown = bisect_right(self.frames_s, repeated.last_s) - bisect_left(self.frames_s, repeated.first_s)
        return repeated.frames > 0 or 2 * len(repeated.doubled_s) >= flown > 0

    def go_back(self, repeated: Repeated) -> Jump:
        """Leave out all samples up to the last time that came again, of which it is not known whose clock they have."""
        at, word = (
            bisect_right(self.frames_s, repeated.last_s),
            bisect_right(self.readings, (repeated.last_s, LONGEST_NUMBER)),
        )
        self.counts.off_clock += at + word
        self.counts.jumps += 1
        del self.frames_s[:at], self.frames[:at], self.readings[:word]
        self.jump = Jump(repeated.first_s + repeated.length_s, repeated.first_s)
        return self.jump

    def _suspect(self, frame: Frame) -> Placed:
        """A frame on another clock: it waits, until others follow it or the clock turns out to be as before."""
        behind = frame.time_s < self.newest_s
        if self._suspects and not 0.0 < frame.time_s - self._suspects[-1].time_s <= self.jump_s:
            self._drop_suspects()
        self._suspects.append(frame)
        if len(self._suspects) >= CONFIRMED_BY:
            first = self._suspects[0]
            missing = False if first.time_s < self.newest_s else is_gap(self.frames, first)
            self.counts.jumps += not missing
            self.jump = Jump(self.newest_s, first.time_s, missing)
            return Placed.JUMPED
        return Placed.TOO_LATE if behind else Placed.WAITING

    def _is_behind_lost_ones(self, frame: Frame) -> bool:
        """Whether a few frames before this one are lost, and nothing tells that the clock jumped instead."""
        t = frame.time_s
        if not self.newest_s < t <= self.newest_s + (MOST_LOST + MOST_APART) * self.every_s:
            return False
        goes_on = bool(self._suspects) and 0.0 < t - self._suspects[-1].time_s <= self.jump_s
        return not goes_on and is_gap(self.frames, frame) is not False

    def _take_waiting(self, until_s: float) -> None:
        """Take the readings that wait for frames, as far as a frame at a time reaches [s]."""
        waiting, self._aside = self._aside, []
        for word in waiting:
            if self.newest_s < word[0] <= until_s + self.jump_s:
                self._insert(word)
            else:
                self._aside.append(word)

    def _drop_suspects(self) -> None:
        if self._suspects or self._aside:
            self.counts.off_clock += len(self._suspects) + len(self._aside)
            self._suspects, self._aside = [], []

    def follow(self, bridged: bool) -> None:
        """Go over to the new clock.

        bridged : whether the frames before the jump stay, so that the time between is a gap; otherwise all that is on
                  the old clock is dropped
        """
        self.repeated = None
        suspects, aside = self._suspects, self._aside
        self._suspects, self._aside = [], []
        first = suspects[0].time_s
        if not bridged:
            self.counts.off_clock += sum(1 for w in self.readings if w[0] > self.newest_s)
            self.frames_s, self.frames, self.readings = [], [], []
            self._last_word, self.jumps = {}, []
            self._in_time_s = {}
        self.newest_s = suspects[-1].time_s
        self.frames_s += [f.time_s for f in suspects]
        self.frames += suspects
        for word in aside:
            if first - self.jump_s <= word[0] <= self.newest_s + self.jump_s:
                self._insert(word)
            else:
                self.counts.off_clock += 1

    def _put_word(self, t: float, number: int, value_K: float) -> Placed:
        # a difference that is no number: either of them is none
        if not math.isfinite(t - value_K):
            return Placed.LOST
        word = (t, number, value_K)
        if self.frames and t < self.newest_s - self.lateness_s:
            if self._suspects and t >= self._suspects[0].time_s - self.jump_s:
                self._aside.append(word)
                return Placed.WAITING
            self._note_lateness(number, t, True)
            return Placed.TOO_LATE
        if self.frames and t > self.newest_s + self.jump_s:
            if len(self._aside) < MOST_WAITING:
                self._aside.append(word)
            else:
                self.counts.off_clock += 1
            return Placed.WAITING
        return self._insert(word)

    def _note_lateness(self, number: int, time_s: float, is_too_late: bool = False) -> None:
        """Note a reading that came in time, or count those of its sensor that come late, one after the other."""
        if time_s > self.newest_s - 0.5 * self.lateness_s:
            self._in_time_s[number] = time_s
            return
        since_s = self._in_time_s.get(number)
        if since_s is None:
            return
        row = self._late.setdefault(number, [since_s, 0, 0])
        if row[0] != since_s:
            row[:] = since_s, 0, 0
        row[1] += 1
        row[2] += is_too_late
        if row[1] == LATE_IN_A_ROW or (is_too_late and row[2] == TOO_LATE_IN_A_ROW):
            self.late_sensors.append((number, since_s, is_too_late))

    def _insert(self, word: Word) -> Placed:
        t, number, value_K = word
        self._note_lateness(number, t)
        readings, (last_s, last_K) = self.readings, self._last_word.get(number, NOTHING_BEFORE)
        if not readings or word[:2] > readings[-1][:2]:
            readings.append(word)
        else:
            at = bisect_left(readings, (t, number, -math.inf))
            if at < len(readings) and readings[at][:2] == (t, number):
                return self._again(t, readings[at] == word, number)
            before, after = _neighbours(readings, number, at)
            if _has_time_of_another(word, before, after):
                self._repeat(t, number)
            self._note_jump(before, word)
            self._note_jump(word, after)
            readings.insert(at, word)
        if self.gate_K is not None:
            if abs(value_K - self._last_K.get(number, value_K)) > self.gate_K[number]:
                self.differs_s += min(last_s, t), t
            self._last_K[number] = value_K
        if t > last_s:
            self._note_jump((last_s, number, last_K), word)
            self._last_word[number] = t, value_K
        # readings of a step may come behind its frame without being late: only one that a step has passed is
        return Placed.LATE if t <= self.newest_s and t < last_s else Placed.TAKEN

    def _note_jump(self, earlier: Word | None, later: Word | None) -> None:
        """Note where two readings of a sensor, one after the other in time, are far apart."""
        if self.gate_K is None or earlier is None or later is None:
            return
        if abs(later[2] - earlier[2]) > 2.0 * self.gate_K[later[1]]:
            self.jumps.append((later[0], later[1]))

    def frames_after(self, time_s: float) -> list[Frame]:
        """Frames later than a time [s], in order."""
        return self.frames[bisect_right(self.frames_s, time_s) :]

    def readings_between(self, after_s: float, until_s: float) -> list[Word]:
        """Readings later than one time and up to another [s], in order."""
        first = bisect_left(self.readings, (math.nextafter(after_s, math.inf), -1, -math.inf))
        return self.readings[first : bisect_left(self.readings, (math.nextafter(until_s, math.inf), -1, -math.inf))]

    def forget(self, before_s: float, words_s: float = 0.0) -> None:
        """Drop samples before a time [s], readings so much before it [s]."""
        at = bisect_left(self.frames_s, before_s)
        if at > 0:
            del self.frames_s[:at], self.frames[:at]
        at = bisect_left(self.readings, (before_s - words_s, -1, -math.inf))
        if at > 0:
            del self.readings[:at]
        if self.differs_s:
            self.differs_s = [t for t in self.differs_s if t >= before_s - words_s]
        if self.jumps:
            self.jumps = [jump for jump in self.jumps if jump[0] >= before_s - words_s]


def _neighbours(readings: Sequence[Word], number: int, index: int) -> tuple[Word | None, Word | None]:
    """The readings of a sensor before and after an index among the readings of all; None where there is none."""
    before = next((readings[k] for k in range(index - 1, -1, -1) if readings[k][1] == number), None)
    return before, next((readings[k] for k in range(index, len(readings)) if readings[k][1] == number), None)


def _has_time_of_another(word: Word, earlier: Word | None, later: Word | None) -> bool:
    """Whether a late reading has the time of another of its sensor but for what a clock rounds, and differs."""
    if earlier is None or later is None:
        return False
    t, _, value_K = word
    nearest = min(earlier, later, key=lambda w: abs(w[0] - t))
    return abs(nearest[0] - t) < SAME_TIME * (later[0] - earlier[0]) and nearest[2] != value_K
