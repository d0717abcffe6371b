"""The samples of a link in order of flight time, over a window: late, doubled, reordered and jumping ones sorted out.

What is kept does not depend on the order in which samples of the window came in. A sample that is older than the
newest frame by more than the window is too late. A frame far ahead of the clock, or behind it by more than the window,
is a damaged time or a new clock: the third of such frames in a row, in order among themselves, is a new clock.
"""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum

from sim_heating.live.types import Frame, Reading, Sample

CONFIRMED_BY = 3
"""Number of frames in a row that make a new clock."""
MOST_WAITING = 10_000
"""Number of readings that wait for a new clock, or ahead of the newest frame, at most."""

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
    """A jump of the clock: from the last frame on the old one to the first on the new one [s]."""

    from_s: float
    to_s: float

    @property
    def by_s(self) -> float:
        """Length of the jump [s], below 0 where the clock went back."""
        return self.to_s - self.from_s


@dataclass
class Counts:
    """Numbers of samples by what became of them, since the link came up.

    late, too_late, doubled, lost : readings and frames that came behind others, after the window, twice, as no number
    off_clock                     : samples on another clock that was not confirmed, or of an old one
    jumps                         : jumps of the clock
    lateness_s                    : largest lateness of a sample that was still used [s]
    """

    late: int = 0
    too_late: int = 0
    doubled: int = 0
    lost: int = 0
    off_clock: int = 0
    jumps: int = 0
    lateness_s: float = 0.0


Word = tuple[float, int, float]
"""A reading: flight time [s], number of the sensor, value [K]."""


@dataclass
class Timeline:
    """Samples of a window in order of time.

    sensors    : number of each sensor by point and name
    lateness_s : window [s]: how far behind the newest frame a sample may come
    jump_s     : how far ahead of the newest frame one may come [s], beyond which a new clock is suspected
    frames_s, frames : times [s] and frames of the window in order;  words : readings in order

    `counts` and `jump`, the last jump of the clock, tell what happened. conflict_s : time of the first sample that came
    again with another value [s], as after a clock that went back by less than the window; None for none.
    """

    sensors: Mapping[tuple[str, str], int]
    lateness_s: float = 2.0
    jump_s: float = 2.5
    frames_s: list[float] = field(default_factory=list)
    frames: list[Frame] = field(default_factory=list)
    words: list[Word] = field(default_factory=list)
    counts: Counts = field(default_factory=Counts)
    jump: Jump | None = None
    newest_s: float = -math.inf
    conflict_s: float | None = None
    _suspects: list[Frame] = field(default_factory=list)
    _aside: list[Word] = field(default_factory=list)
    _last_word_s: dict[int, float] = field(default_factory=dict)

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
        returns : number of readings that were taken, as `put` would have; the next one is for `put`
        """
        words, last_s, sensors = self.words, self._last_word_s, self.sensors
        first_s = max(after_s, self.newest_s - self.lateness_s)
        until_s = self.newest_s + self.jump_s if self.frames else LONGEST_S
        before = words[-1][:2] if words else (-math.inf, -1)
        for taken, reading in enumerate(readings):
            t, value_K = reading.time_s, reading.value_K
            number = sensors.get((reading.point, reading.sensor), -1)
            # No comparison holds of what is no number.
            in_time = first_s < t <= until_s and -math.inf < value_K < math.inf
            place = t, number
            if not (in_time and number >= 0 and place > before and t > last_s.get(number, -math.inf)):
                return taken
            words.append((t, number, value_K))
            last_s[number], before = t, place
        return len(readings)

    def _count(self, placed: Placed, time_s: float) -> None:
        counts = self.counts
        if placed is Placed.LATE:
            counts.late += 1
            counts.lateness_s = max(counts.lateness_s, self.newest_s - time_s)
        elif placed is Placed.TOO_LATE:
            counts.too_late += 1
        elif placed is Placed.DOUBLED:
            counts.doubled += 1
        elif placed is Placed.LOST:
            counts.lost += 1

    def _put_frame(self, frame: Frame) -> Placed:
        t = frame.time_s
        if not all(map(math.isfinite, (t, *frame.values.values()))):
            return Placed.LOST
        if self.frames and not self.newest_s - self.lateness_s <= t <= self.newest_s + self.jump_s:
            return self._suspect(frame)
        self._drop_suspects()
        if not self.frames or t > self.newest_s:
            self.frames_s.append(t)
            self.frames.append(frame)
            self.newest_s = t
            return Placed.TAKEN
        at = bisect_left(self.frames_s, t)
        if at < len(self.frames_s) and self.frames_s[at] == t:
            return self._again(t, self.frames[at].values == frame.values)
        self.frames_s.insert(at, t)
        self.frames.insert(at, frame)
        return Placed.LATE

    def _again(self, time_s: float, is_same: bool) -> Placed:
        if not is_same and self.conflict_s is None:
            self.conflict_s = time_s
        return Placed.DOUBLED

    def _suspect(self, frame: Frame) -> Placed:
        """A frame on another clock: it waits, until others follow it or the clock turns out to be as before."""
        behind = frame.time_s < self.newest_s
        if self._suspects and not 0.0 < frame.time_s - self._suspects[-1].time_s <= self.jump_s:
            self._drop_suspects()
        self._suspects.append(frame)
        if len(self._suspects) >= CONFIRMED_BY:
            self.counts.jumps += 1
            self.jump = Jump(self.newest_s, self._suspects[0].time_s)
            return Placed.JUMPED
        return Placed.TOO_LATE if behind else Placed.WAITING

    def _drop_suspects(self) -> None:
        if self._suspects or self._aside:
            self.counts.off_clock += len(self._suspects) + len(self._aside)
            self._suspects, self._aside = [], []

    def follow(self, bridged: bool) -> None:
        """Go over to the new clock.

        bridged : whether the frames before the jump stay, so that the time between is a gap; otherwise all that is on
                  the old clock is dropped
        """
        found, aside = self._suspects, self._aside
        self._suspects, self._aside = [], []
        first = found[0].time_s
        if not bridged:
            self.counts.off_clock += sum(1 for w in self.words if w[0] > self.newest_s)
            self.frames_s, self.frames, self.words = [], [], []
            self._last_word_s = {}
        self.newest_s = found[-1].time_s
        self.frames_s += [f.time_s for f in found]
        self.frames += found
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
            return Placed.TOO_LATE
        if self.frames and t > self.newest_s + self.jump_s:
            if len(self._aside) < MOST_WAITING:
                self._aside.append(word)
            else:
                self.counts.off_clock += 1
            return Placed.WAITING
        return self._insert(word)

    def _insert(self, word: Word) -> Placed:
        t, number, _ = word
        words, last = self.words, self._last_word_s.get(number, -math.inf)
        if not words or word[:2] > words[-1][:2]:
            words.append(word)
        else:
            at = bisect_left(words, (t, number, -math.inf))
            if at < len(words) and words[at][:2] == (t, number):
                return self._again(t, words[at] == word)
            words.insert(at, word)
        if t > last:
            self._last_word_s[number] = t
        # readings of a step may come behind its frame without being late: only one that a step has passed is
        return Placed.LATE if t <= self.newest_s and t < last else Placed.TAKEN

    def frames_after(self, time_s: float) -> list[Frame]:
        """Frames later than a time [s], in order."""
        return self.frames[bisect_right(self.frames_s, time_s) :]

    def words_between(self, after_s: float, until_s: float) -> list[Word]:
        """Readings later than one time and up to another [s], in order."""
        first = bisect_left(self.words, (math.nextafter(after_s, math.inf), -1, -math.inf))
        return self.words[first : bisect_left(self.words, (math.nextafter(until_s, math.inf), -1, -math.inf))]

    def forget(self, before_s: float) -> None:
        """Drop samples before a time [s]."""
        at = bisect_left(self.frames_s, before_s)
        if at > 0:
            del self.frames_s[:at], self.frames[:at]
        at = bisect_left(self.words, (before_s, -1, -math.inf))
        if at > 0:
            del self.words[:at]
