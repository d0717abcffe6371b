"""Temperatures and parameters of the control points while the flight is flown.

Frames and readings may come in any order within a window. Steps of the filter end at frames; frames on a straight line
are passed over, up to `wait_s`, as the plug-in does. Where a sample belongs before what has been filtered, the filter
goes back to the last snapshot before it and filters again: the estimate is a function of the samples alone, bit for
bit, not of the order in which they came.

    estimator = LiveEstimator(VehiclePoints(load_vehicle("orbiter"), ["V09T9527"]), ["ratio.scale"])
    estimator.add(frame, reading)          # as they come
    estimator.advance()
    estimator.estimates()["V09T9527"].surface_K

Filter: docs/theory/filter.md, section "Parameters as the readings come".
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from sim_heating.base.arrays import BoolArray, FloatArray, IntArray
from sim_heating.base.errors import InputError, RunError
from sim_heating.base.files import suggestion
from sim_heating.base.kernels.block import LANES, N_CONDITIONS, P_SURFACE
from sim_heating.estimation.filter.lagging import LaggingFilter, online_filter
from sim_heating.estimation.filter.march import Disturbance, FilterTrack, Samples
from sim_heating.estimation.filter.online import (
    FilterSnapshot,
    Innovations,
    OnlineFilter,
    PointEstimate,
    PointReadings,
    Prior,
    no_readings,
    own_readings,
)
from sim_heating.estimation.inference.likelihood import middle_K
from sim_heating.estimation.starts import START_SIGMA_K
from sim_heating.live.filtering.estimates import Innovation, LiveEstimate, LiveOptions
from sim_heating.live.filtering.heated_start import reading_sigma_K, start_of_heated
from sim_heating.live.filtering.parameters import check_estimated, default_prior, is_of_march
from sim_heating.live.filtering.points import ConditionsOfFrame, LivePoint, line_tolerance
from sim_heating.live.filtering.sensors import LeftOut, SensorTable
from sim_heating.live.filtering.spikes import AWAY_SIGMAS, JUMP_SIGMAS, NEAR_S, suspected
from sim_heating.live.filtering.timeline import CONFIRMED_BY, Counts, Jump, Placed, Repeated, Timeline
from sim_heating.live.types import Frame, Reading, Sample
from sim_heating.march.point import initial_temperatures

BRIDGED_S = 60.0
"""Longest time without frames [s] that is bridged; after a longer one the state is taken over as it was."""
TOGETHER = 32
"""Frames that are looked at together, whether they lie on a straight line."""
AGAIN = 4
"""Steps of the past that are filtered again with each new one."""
LONGEST_AGAIN_S = 7200.0
"""Longest flight that is kept to be filtered again [s]."""
CONFIRMED_WORDS = 2
"""Readings of a sensor that have to come again with other values before its clock has gone back."""
START_AGREES = 4.0
"""Readings within this many standard deviations of the declared start confirm it [-]."""
GAP_ERROR_1_S, LARGEST_GAP_ERROR = 0.01, 0.3
"""Standard deviation of the heating over a gap, for each second of it, and at most, over the heating itself [1/s], [-]:
conditions that go straight from one end of the gap to the other are not those that were flown."""


_LOGGED = 8
"""Columns of what is logged of a reading: time [s], number of its sensor, then as Innovation from innovation_K on."""


@dataclass(frozen=True, eq=False)
class _Kept:
    """State of all filters after a step.

    time_s    : end of the step [s];  decided_s : time of the last frame that the choice of its end depended on [s]
    logged : number of steps until then;  past : number of steps until then that are kept to be taken again
    """

    time_s: float
    decided_s: float
    values: FloatArray
    vectors: FloatArray
    filters: tuple[FilterSnapshot, ...]
    logged: int
    past: int


class _Past(NamedTuple):
    """A step that was taken, as it is to be taken again.

    frame     : at its end;  decided_s, logged : as of _Kept;  vectors : (point, condition) at its end
    words     : (reading, 4) its readings;  at : estimates of the parameters after it, where they serve to begin again
    """

    frame: Frame
    decided_s: float
    logged: int
    vectors: FloatArray
    words: FloatArray
    at: tuple[FloatArray, ...] | None


@dataclass
class _Second:
    """Filters that take the flight so far again, linearised about an estimate.

    known : number of steps whose readings that estimate has; up to there no other is better to be linearised about
    taken, due : number of steps that they took, and that they are to have taken before the next step becomes final
    """

    filters: list[OnlineFilter]
    known: int
    taken: int = 0
    due: int = 0


class LiveEstimator:
    """Running estimate of temperatures and parameters at the control points of a link.

    source  : the control points, and what a frame is for them (live/filtering/points.py)
    names   : parameters to estimate, by their dotted names, also `sensor.NAME.bias`, `.gain` and `.drift`, of the point
              that has the sensor, and `clock.skew`, of each point; readings come with the mean of its prior taken out
    priors  : by name; those of the model, and wide ones for the heating ratio, where not given
    options : how it works
    raises  : InputError for an unknown parameter, or one that a running estimate cannot have

    One process, one thread. `add` takes samples, `advance` filters what is complete, `estimates` gives the state at the
    newest frame. Docs: docs/theory/filter.md, equations 17 to 23.
    """

    def __init__(
        self,
        source: ConditionsOfFrame,
        names: Sequence[str] = ("ratio.scale",),
        priors: Mapping[str, Prior] | None = None,
        options: LiveOptions | None = None,
    ) -> None:
        self.source, self.options = source, options or LiveOptions()
        self.points = source.points
        self.names = tuple(p.name for p in self.points)
        self._of_point = {p.name: i for i, p in enumerate(self.points)}
        check_estimated({p.name: p.sensors for p in self.points}, names)
        self._sensors = SensorTable(self.points, names)
        self._tracks, self._priors = zip(
            *(_track(p, self._sensors.names[i], priors or {}, self.options) for i, p in enumerate(self.points)),
            strict=True,
        )
        # the others take the flight so far again
        self.filters, self._spare = (
            [
                online_filter(
                    self._tracks[k : k + LANES],
                    self._priors[k : k + LANES],
                    self.options.corrects_mesh,
                    self._sensors.lagging(k),
                )
                for k in range(0, len(self.points), LANES)
            ]
            for _ in range(2)
        )
        self._apart, self._share = line_tolerance(source.columns)
        # readings may come in any order: half of what is suspected between neighbours is looked at
        self._gate_K = (JUMP_SIGMAS * self._sensors.sigma_K + np.nan_to_num(self._sensors.lsb)).tolist()
        half_K = [0.5 * gate for gate in self._gate_K]
        self.timeline = Timeline(self._sensors.numbers, self.options.lateness_s, self.options.jump_s, half_K)
        self.messages: list[str] = []
        self._told_conflict = False
        self.failed_clocks: list[tuple[str, str, float, str]] = []
        self._clocks_out: set[int] = set()
        self.refused = 0
        self._out = [LeftOut() for _ in self._sensors.sensors]
        self._wrong: dict[int, tuple[float, float]] = {}
        self._restart()
        self._warm_up()

    def _restart(self) -> None:
        self._past: list[_Past] = []
        self._final = 0
        self._second: _Second | None = None
        self._begun: _Kept | None = None
        self._begun_s: float | None = None
        self._starts: list[tuple[FloatArray, FloatArray]] = []
        self._now: _Kept | None = None
        self._kept: list[_Kept] = []
        self._provisional, self._changed = False, False
        # frames since the last step, all on one straight line
        self._passed: list[Frame] = []
        self._dirty = (math.inf, math.inf)
        # (reading, _LOGGED) of each step, in order of time and sensor, from step number `_log_from` on
        self._log: list[FloatArray] = []
        self._log_from = 0
        # times of suspected readings of a sensor whose next ones have not come, by its number
        self._undecided: dict[int, set[float]] = {}
        self._given_until = -math.inf
        self.steps = 0

    def _warm_up(self) -> None:
        """Compile, or read from the cache, all that a step runs, so that no sample waits for it."""
        still = np.zeros((len(self.points), N_CONDITIONS))
        still[:, P_SURFACE] = 1000.0
        for k, f in enumerate(self.filters):
            own = still[k * LANES : (k + 1) * LANES]
            f.begin(0.0, own, [np.full(p.mesh.nodes, 300.0) for p in f.points])
            f.step(np.array([1.0]), own[:, np.newaxis], no_readings(max(p.parameters for p in f.points)))
            f.linearise_again(0)
            f.estimates()

    # Samples in ------------------------------------------------------------------------------------------------------

    def add(self, *samples: Sample) -> None:
        """Take samples in any order; `advance` filters them.

        raises : InputError for a point or sensor that the link does not have

        What is late, doubled, lost or on another clock is counted in `counts`; a jump of the clock is told in
        `messages`.
        """
        at, count = 0, len(samples)
        while at < count:
            sample = samples[at]
            at += 1
            if isinstance(sample, Frame):
                if not self._plausible(sample):
                    continue
            elif taken := self._put_in_order(samples, at - 1):
                for reading in samples[at - 1 : at - 1 + taken] if self._undecided else ():
                    self._decide(reading)  # type: ignore[arg-type]
                at, self._changed = at - 1 + taken, True
                if self.timeline.late_sensors:
                    self._tell_late()
                continue
            elif (sample.point, sample.sensor) not in self._sensors.numbers:
                raise InputError(self._unknown(sample.point, sample.sensor))
            placed, self._changed = self.timeline.put(sample), True
            if placed is Placed.TAKEN or placed is Placed.LATE:
                self._mark(sample)
            elif placed is Placed.DOUBLED:
                self._tell_conflict()
            elif placed is Placed.JUMPED:
                self._follow()
            if self.timeline.late_sensors:
                self._tell_late()
            if self.timeline.repeated is not None and isinstance(sample, Frame):
                self._judge_repeated()

    def _put_in_order(self, samples: Sequence[Sample], first: int) -> int:
        """Take readings, from number `first` of the samples on, that are in order and need nothing filtered again."""
        last = first + 1
        while last < len(samples) and isinstance(samples[last], Reading):
            last += 1
        after_s = -math.inf if self._now is None else self._now.time_s
        return self.timeline.put_readings(samples[first:last], after_s)  # type: ignore[arg-type]

    def _tell_conflict(self) -> None:
        """Tell once that samples came again with other values."""
        at_s = self.timeline.conflict_s
        if at_s is not None and not self._told_conflict:
            self._told_conflict = True
            self._tell(
                f"samples came again with other values, first at {at_s:g} s: a clock that went back, or two sources of "
                "one quantity; the first ones are used"
            )

    def _tell_late(self) -> None:
        """Tell which sensors come late after they had come in time; not of one that is left out for its clock."""
        for number, since_s, is_too_late in self.timeline.late_sensors:
            point, sensor = self._sensors.place[number]
            if number in self._clocks_out:
                continue
            late_s = self.options.lateness_s * (1.0 if is_too_late else 0.5)
            use = "are not used" if is_too_late else "are used by their times"
            self._tell(
                f"{point}: readings of {sensor} after {since_s:g} s come more than {late_s:g} s late, one after the "
                f"other, and {use}: its clock went back, or it is sent late"
            )
        self.timeline.late_sensors.clear()

    def _judge_repeated(self) -> None:
        """Tell that times come again, and then why, once that is known: the clock of all went back, or of some."""
        now, found = self.timeline.repeated, self.timeline.repeated_until_now()
        if found is None:
            if self.timeline.is_two_sources:
                self._tell("samples go on coming again with other values: two sources of one quantity")
            elif now is not None and now.samples >= CONFIRMED_BY and not self._told_conflict:
                self._told_conflict = True
                self._tell(
                    f"samples come for times from {now.first_s:g} s on that have come already: a clock that went back, "
                    "or two sources of one quantity; which of them is told once that has ended"
                )
            return
        if found.samples >= CONFIRMED_BY:  # the next such event is told again
            self._told_conflict, self.timeline.conflict_s = False, None
        if found.samples >= CONFIRMED_BY and self.timeline.is_of_frames(found):
            self._follow_back(found)
            return
        for number, count in found.words.items():
            if count >= CONFIRMED_WORDS:
                self._leave_out_clock(number, found.first_s)

    def _follow_back(self, found: Repeated) -> None:
        """Go over to a clock that went back by little: from the state before it, over the time that came twice."""
        self.advance()
        jump = self.timeline.go_back(found)
        self._tell(
            f"the clock went back by about {-jump.by_s:.3g} s, from {jump.from_s:g} to {jump.to_s:g} s: samples came "
            f"again with other values; what came for {found.first_s:g} to {found.last_s:g} s is not used, and bridged"
        )
        if self._now is None:
            return
        before_s = found.first_s - found.every_s
        self._return_to(next((k for k in reversed(self._kept) if k.decided_s < before_s), self._kept[0]))
        begin_s = self._now.time_s + jump.by_s
        for f in self.filters:
            f.now_s = begin_s
        self._give_up_past()
        self._now = self._snapshot(begin_s, begin_s, self._now.values, self._now.vectors)
        self._kept, self._dirty, self._changed = [self._now], (math.inf, math.inf), True

    def _leave_out_clock(self, number: int, since_s: float) -> None:
        """Leave out a sensor whose own clock went back, from before that."""
        if number in self._clocks_out:
            return
        self._clocks_out.add(number)
        point, sensor = self._sensors.place[number]
        why = f"its clock went back: readings from {since_s:g} s on came again with other values"
        self.failed_clocks.append((point, sensor, since_s, why))
        self._tell(f"{point}: {sensor}: {why}; it is left out")
        self._change_use(point, sensor, since_s, True)
        if self._now is not None and since_s <= self._now.time_s:
            self._dirty = (self._dirty[0], min(self._dirty[1], since_s))

    def _plausible(self, frame: Frame) -> bool:
        missing = [c for c in self.source.columns if c not in frame.values]
        if missing:
            self.refused += 1
            self._tell(f"frame at {frame.time_s:g} s: no `{missing[0]}`; not used")
        return not missing

    def _mark(self, sample: Sample) -> None:
        """Remember what is to be filtered again."""
        if self._now is None:
            return
        frame, reading = self._dirty
        if isinstance(sample, Frame):
            if self._passed and sample.time_s < self._passed[-1].time_s:
                self._passed = []
            if sample.time_s <= self._now.decided_s:
                self._dirty = (min(frame, sample.time_s), reading)
        else:
            if sample.time_s <= self._now.time_s:
                self._dirty = (frame, min(reading, sample.time_s - self._touched(sample)))
            self._decide(sample)

    def _touched(self, late: Reading) -> float:
        """How long before a late reading one may be that it decides on [s]."""
        return NEAR_S if self.timeline.differs_s else 0.0

    def _decide(self, sample: Reading) -> None:
        """Filter suspected readings again, once one after them has come."""
        number = self._sensors.numbers[sample.point, sample.sensor]
        waiting = self._undecided.get(number)
        if not waiting:
            return
        decided = {at_s for at_s in waiting if at_s < sample.time_s <= at_s + NEAR_S}
        self._dirty = (self._dirty[0], min([self._dirty[1], *decided]))
        reached_s = self.timeline.newest_s - self.options.lateness_s - NEAR_S
        self._undecided[number] = {at_s for at_s in waiting - decided if at_s > reached_s}
        if not self._undecided[number]:
            del self._undecided[number]

    def _unknown(self, point: str, sensor: str) -> str:
        if point not in self._of_point:
            return f"reading: unknown control point `{point}`{suggestion(point, self._of_point)}"
        known = [s.name for s in self.points[self._of_point[point]].sensors]
        return f"reading: {point} has no sensor `{sensor}`{suggestion(sensor, known)}"

    def _tell(self, message: str) -> None:
        self.messages.append(message)
        del self.messages[:-100]

    def _follow(self) -> None:
        """Go over to a new clock: a gap where it is a little ahead, else the state is taken over as it is."""
        jump = self.timeline.jump
        assert jump is not None
        between = f"from {jump.from_s:g} to {jump.to_s:g} s"
        if 0.0 < jump.by_s <= BRIDGED_S:
            self._tell(
                f"the clock jumped ahead {between}: the conditions did not go on as long; bridged as a gap"
                if jump.is_gap is False
                else f"no frames {between}: a gap{'' if jump.is_gap else ' or a jump of the clock'}; bridged"
            )
            self.timeline.follow(True)
            return
        way = "back" if jump.by_s < 0.0 else "ahead"
        self._tell(
            f"the clock jumped {way} {between}; the state is taken over as it was, "
            "readings on the old clock are not used"
        )
        self.advance()
        self._undo_provisional()
        self._settle()
        self.timeline.follow(False)
        if self._now is None:
            return
        # all that is to come follows from here; the filter does not know of time but by its steps
        first = self.timeline.frames[0]
        for f in self.filters:
            f.now_s = first.time_s
        self._given_until = -math.inf
        self._log, self._log_from = [], 0
        self._passed = []
        self._give_up_past()
        self._now = self._snapshot(first.time_s, first.time_s, self._values(first), self._conditions(first))
        self._kept = [self._now]

    def _settle(self) -> None:
        """Take the last frames of an old clock."""
        if self._now is not None:
            frames = self.timeline.frames_after(self._now.time_s)
            if frames:
                self._commit(frames[-1], frames[-1].time_s)

    def leave_out(self, point: str, sensor: str, since_s: float, wrong_s: float | None = None) -> None:
        """Use no readings of a sensor from a time on [s]; they are still predicted.

        wrong_s : earlier time from which on they are not trusted [s]: `filter_again` takes them back from there on.
                  The running estimate does not, as when that could be done depends on when the samples came
        raises  : InputError for an unknown point or sensor
        """
        self._change_use(point, sensor, since_s, True)
        if wrong_s is not None:
            self._wrong[self._sensors.numbers[point, sensor]] = (wrong_s, since_s)

    def take_in(self, point: str, sensor: str, since_s: float) -> None:
        """Use the readings of a sensor again from a time on [s]."""
        self._change_use(point, sensor, since_s, False)

    def _change_use(self, point: str, sensor: str, since_s: float, out: bool) -> None:
        if (point, sensor) not in self._sensors.numbers:
            raise InputError(self._unknown(point, sensor))
        self._take_due()
        spans, self._changed = self._out[self._sensors.numbers[point, sensor]].spans, True
        if out and not (spans and spans[-1][1] == math.inf):
            spans.append((since_s, math.inf))
        elif not out and spans and spans[-1][1] == math.inf:
            spans[-1] = (spans[-1][0], math.nextafter(since_s, -math.inf))
        if self._now is not None and since_s <= self._now.time_s:
            # what is older than the window stays as it was filtered
            frame, reading = self._dirty
            self._dirty = (frame, min(reading, max(since_s, self.timeline.newest_s - self.options.lateness_s)))

    @property
    def counts(self) -> Counts:
        """Numbers of late, doubled, lost ... samples."""
        return self.timeline.counts

    @property
    def jump(self) -> Jump | None:
        """The last jump of the clock; None for none."""
        return self.timeline.jump

    # Filtering -------------------------------------------------------------------------------------------------------

    def advance(self) -> None:
        """Filter all that is complete up to the newest frame."""
        if self._now is None and not self._start():
            return
        assert self._now is not None
        if not self._changed:
            return
        while self._changed:
            self._changed = False
            self._go_back()
            self._undo_provisional()
            self._step_on()

    def _step_on(self) -> None:
        """Filter the frames since the last step; where filters take over that have taken the flight again, a second
        call goes on from there."""
        assert self._now is not None
        new = self.timeline.frames_after(self._passed[-1].time_s if self._passed else self._now.time_s)
        frames, first, at = [*self._passed, *new], len(self._passed), 0
        time_s, columns = np.array([f.time_s for f in frames]), self.source.columns
        values = np.array([[f.values[c] for c in columns] for f in frames])
        while first < len(frames):
            # the first one that has waited is the end of a step, where those before it lie on a straight line
            waited = time_s[first:] - self._now.time_s >= self.options.wait_s - 1e-9
            stop = first + int(np.argmax(waited)) if np.any(waited) else len(frames)
            last = min(stop + 1, first + TOGETHER, len(frames))
            bent = at + self._first_off_line(time_s[at:last], values[at:last], first - at)
            if bent < last:
                self._commit(frames[bent - 1], frames[bent].time_s)
                at = first = bent
            elif stop < last:
                self._commit(frames[stop], frames[stop].time_s)
                at = first = last
            else:
                first = last
        self._passed = frames[at:]
        self._forget()

    def _first_off_line(self, time_s: FloatArray, values: FloatArray, first: int) -> int:
        """Number of the first frame, from number `first` on, to which no straight line leads from the last step; that
        of frames for none.

        time_s, values : (frame,), (frame, column) since the last step
        """
        assert self._now is not None
        since, first = time_s - self._now.time_s, max(first, 1)  # a line to the first one has nothing beside it
        if first >= len(since):
            return len(since)
        part = since[:, np.newaxis] / since[first:]
        ends = values[first:] - self._now.values
        away = (values - self._now.values)[:, np.newaxis] - part[..., np.newaxis] * ends
        apart = (self._apart + self._share * np.abs(values))[:, np.newaxis]
        before = np.arange(len(since))[:, np.newaxis] < np.arange(first, len(since))
        off = ((np.abs(away) > apart).any(axis=2) & before).any(axis=0)
        off |= since[first:] > self.options.wait_s + 1e-9
        return first + int(np.argmax(off)) if np.any(off) else len(since)

    def _values(self, frame: Frame) -> FloatArray:
        return np.array([frame.values[c] for c in self.source.columns])

    def _commit(self, frame: Frame, decided_s: float) -> None:
        """Filter up to a frame, and keep a snapshot where one is due."""
        assert self._now is not None
        last = self._now
        vectors, words = self._conditions(frame), self._words(last.time_s, frame.time_s)
        self._log.append(self._take(self.filters, last.time_s, last.vectors, frame.time_s, vectors, words))
        if self._begun_s is not None:
            due = self._again_due(last.time_s) < self._again_due(frame.time_s)
            at = tuple(e.values for f in self.filters for e in f.estimates()) if due else None
            self._past.append(_Past(frame, decided_s, self._logged, vectors, words, at))
        every = self.options.snapshot_s
        values = self._values(frame)
        if not self._kept or math.floor(frame.time_s / every) > math.floor(self._kept[-1].time_s / every):
            self._now = self._snapshot(frame.time_s, decided_s, values, vectors)
            self._kept.append(self._now)
        else:
            self._now = _Kept(frame.time_s, decided_s, values, vectors, (), self._logged, len(self._past))
        if last.filters and not any(last is kept for kept in self._kept):
            self._done_with(last)
        self._passed = []
        self.steps += 1

    @property
    def _logged(self) -> int:
        """Number of steps whose innovations are, or were, logged."""
        return self._log_from + len(self._log)

    def _words(self, after_s: float, until_s: float) -> FloatArray:
        """(reading, 4) readings of a step: time [s], number of the sensor, value [K], 1 where it may be a spike."""
        words = self.timeline.words_between(after_s, until_s)
        found = np.zeros((len(words), 4))
        if words:
            found[:, :3] = words
        jumping = {n for t, n in self.timeline.jumps if after_s - NEAR_S < t <= until_s}
        if jumping:
            near = self.timeline.words_between(after_s - NEAR_S, until_s + NEAR_S)
            spikes = suspected([w for w in near if w[1] in jumping], after_s, self._gate_K)
            for k, (t, n, _) in enumerate(words):
                found[k, 3] = (t, n) in spikes
                if not spikes.get((t, n), True):
                    self._undecided.setdefault(n, set()).add(t)
        return found

    def _take(
        self, filters: Sequence[OnlineFilter], begin: float, before: FloatArray, end: float, vectors: FloatArray,
        words: FloatArray, linearise: bool = True,
    ) -> FloatArray:  # fmt: skip
        """Take a step from one time to another with its readings, in parts of `longest_step_s` at most.

        before, vectors : (point, condition) at both ends
        returns         : (reading, _LOGGED) what is logged of the readings
        """
        steps = max(1, math.ceil((end - begin) / self.options.longest_step_s - 1e-9))
        part = np.arange(1, steps + 1) / steps
        time_s = begin + part * (end - begin)
        time_s[-1] = end
        histories = before[:, np.newaxis] + part[:, np.newaxis] * (vectors - before)[:, np.newaxis]
        histories[:, -1] = vectors
        # conditions are known at the ends of a gap alone
        unknown = min(GAP_ERROR_1_S * (end - begin), LARGEST_GAP_ERROR) if steps > 1 else 0.0
        number, doubtful = words[:, 1].astype(np.int64), words[:, 3] > 0.0
        given, is_out = self._sensors.readings(words, filters, self._out), np.zeros(len(words), dtype=bool)
        read_K = middle_K(given.lower_K, given.upper_K)
        columns = np.empty((len(words), 4))
        for k, f in enumerate(filters):
            first = k * LANES
            along = histories[first : first + LANES]
            mine = np.flatnonzero((given.point >= first) & (given.point < first + LANES))
            own = own_readings(given, mine, first, f.most_parameters)
            if isinstance(f, LaggingFilter):
                own = f.behind_lags(time_s, along, own, number[mine])

            def filtered(given: PointReadings, f: OnlineFilter = f, along: FloatArray = along) -> Innovations:
                return f.gap(time_s, along, given, unknown) if unknown else f.step(time_s, along, given)

            if np.any(doubtful[mine]):
                found, is_out[mine] = self._without_spikes(f, filtered, own, number[mine], doubtful[mine], read_K[mine])
            else:
                found = filtered(own)
            columns[mine] = np.column_stack(found)
        predicted, variance = columns[:, 0], columns[:, 1]
        columns = np.column_stack([
            words[:, 0], words[:, 1], np.where(is_out, read_K - predicted, columns[:, 2]),
            np.where(is_out, variance, columns[:, 3]), predicted, variance, read_K, is_out,
        ])  # fmt: skip
        if linearise:
            self._linearise(filters, begin, end)
        return columns[np.isfinite(columns[:, 2])]

    def _without_spikes(
        self, f: OnlineFilter, filtered: Callable[[PointReadings], Innovations], given: PointReadings,
        numbers: IntArray, doubtful: BoolArray, read_K: FloatArray,
    ) -> tuple[Innovations, BoolArray]:  # fmt: skip
        """Take a step without the readings that may be spikes, and again with those of them that were expected.

        returns : innovations, and (reading,) which ones are left out
        """
        before = f.snapshot()
        found = filtered(given._replace(lower_K=np.where(doubtful, np.nan, given.lower_K)))
        half_lsb = 0.5 * np.nan_to_num(self._sensors.lsb[numbers])
        away = np.abs(read_K - found.predicted_K) - half_lsb > AWAY_SIGMAS * np.sqrt(found.variance_K2)
        is_out = doubtful & away
        if np.any(doubtful & ~is_out & np.isfinite(read_K)):
            f.restore(before)
            found = filtered(given._replace(lower_K=np.where(is_out, np.nan, given.lower_K)))
        f.done_with(before)
        return found, is_out

    # Filtered again --------------------------------------------------------------------------------------------------

    def _again_due(self, time_s: float) -> int:
        """How often the flight is to have been filtered again by a time."""
        if self._begun_s is None or math.isinf(self.options.again_s):
            return 0
        ratio = (time_s - self._begun_s) / self.options.again_s
        return math.floor(math.log2(ratio)) + 1 if ratio >= 1.0 else 0

    def _filter_again(self, until: int) -> None:
        """Go on with filtering again, as steps become final: those before number `until` of the past are.

        Steps of the second filters depend on the number of final steps alone, and so does the one at which they take
        over. Those that are due are taken one by one, so that no frame waits for all of them.
        """
        if self._second is not None and self._final >= until:
            self._take_again(self._second, min(self._second.taken + 1, self._second.due))
        while self._final < until:
            self._take_due()
            step = self._past[self._final]
            self._final += 1
            if step.at is not None:
                self._second = self._begin_again(step.at, self._final)
            if self._second is not None:
                self._second.due = min(self._second.taken + AGAIN, self._final)
                if self._second.due == self._final:
                    self._take_due()
                    self._take_over(self._second)
                    return
        if self._past and self._past[-1].frame.time_s - self._past[0].frame.time_s > LONGEST_AGAIN_S:
            self._give_up_past()

    def _take_due(self) -> None:
        if self._second is not None:
            self._take_again(self._second, self._second.due)

    def filter_again(self) -> bool:
        """Filter the whole flight so far again, linearised about the present estimate, at once; whether it was.

        What earlier readings said is then linearised about the estimate too, as in a fit of the whole record, and what
        sensors read after they had begun to fail is taken back; a flight of 1000 s takes some seconds. Nothing is done
        before the start, or where the clock jumped.
        """
        self.advance()
        self._undo_provisional()
        if self._now is None or not self._past:
            return False
        has_wrong = bool(self._wrong)
        for n, span in self._wrong.items():
            self._out[n].spans.insert(0, span)
        self._wrong.clear()
        estimates = tuple(e.values for f in self.filters for e in f.estimates())
        second = self._begin_again(estimates, len(self._past))
        self._take_again(second, len(self._past))
        self._final = len(self._past)
        self._take_over(second)
        self._changed = True
        self.advance()
        # the estimate that this was linearised about had those readings
        return self.filter_again() if has_wrong else True

    def _begin_again(self, at: Sequence[FloatArray], known: int) -> _Second:
        assert self._begun is not None
        filters = self._spare
        for k, f in enumerate(filters):
            own = slice(k * LANES, (k + 1) * LANES)
            profiles, covariances = zip(*self._starts[own], strict=True)
            f.begin(self._begun.time_s, self._begun.vectors[own], profiles, covariances, at[own])
        return _Second(filters, known)

    def _take_again(self, second: _Second, until: int) -> None:
        """Take steps of the past with the second filters, up to before number `until`."""
        assert self._begun is not None
        while second.taken < until:
            k = second.taken
            begin, before = self._begun.time_s, self._begun.vectors
            if k > 0:
                begin, before = self._past[k - 1].frame.time_s, self._past[k - 1].vectors
            step = self._past[k]
            end, is_new = step.frame.time_s, k >= second.known
            self._take(second.filters, begin, before, end, step.vectors, step.words, linearise=is_new)
            second.taken += 1

    def _take_over(self, second: _Second) -> None:
        """Go on with the second filters from the last step that they took; what came after it is taken again."""
        last = self._past[second.taken - 1]
        self._spare, self.filters, self._second = self.filters, second.filters, None
        del self._past[second.taken :], self._log[last.logged - self._log_from :]
        self._now = self._snapshot(last.frame.time_s, last.decided_s, self._values(last.frame), last.vectors)
        self._kept, self._passed, self._provisional, self._changed = [self._now], [], False, True

    def _give_up_past(self) -> None:
        self._past, self._final, self._second, self._begun_s = [], 0, None, None

    def _conditions(self, frame: Frame) -> FloatArray:
        """Condition vectors of a frame; those of the last one where it is not plausible."""
        assert self._now is not None
        try:
            return self.source.conditions(frame)
        except InputError as error:
            self.refused += 1
            self._tell(f"{error}; the conditions before are held")
            return self._now.vectors

    def _linearise(self, filters: Sequence[OnlineFilter], begin_s: float, end_s: float) -> None:
        """Linearise again those points whose time has come, one after the other over `linearise_s`."""
        every = self.options.linearise_s
        if not math.isfinite(every):
            return
        count = len(self.points)
        for i in range(count):
            phase = i / count
            if math.floor(end_s / every - phase) > math.floor(begin_s / every - phase):
                filters[i // LANES].linearise_again(i % LANES)

    def _snapshot(self, time_s: float, decided_s: float, values: FloatArray, vectors: FloatArray) -> _Kept:
        filters = tuple(f.snapshot() for f in self.filters)
        return _Kept(time_s, decided_s, values, vectors, filters, self._logged, len(self._past))

    def _go_back(self) -> bool:
        """Return to the last snapshot before the first sample that came late; whether there was one."""
        frame, reading = self._dirty
        if frame == reading == math.inf:
            return False
        self._dirty = (math.inf, math.inf)
        # one is older than the window, so that no sample that is taken comes before it
        usable = [k for k in self._kept if k.decided_s < frame and k.time_s < reading]
        self._kept = usable or self._kept[:1]
        self._return_to(self._kept[-1])
        return True

    def _return_to(self, kept: _Kept) -> None:
        for f, snapshot in zip(self.filters, kept.filters, strict=True):
            f.restore(snapshot)
        del self._log[kept.logged - self._log_from :], self._past[kept.past :]
        self._now, self._provisional, self._passed = kept, False, []

    def _done_with(self, kept: _Kept) -> None:
        for f, snapshot in zip(self.filters, kept.filters, strict=True):
            f.done_with(snapshot)

    def _forget(self) -> None:
        """Drop snapshots and samples that no sample to come can reach."""
        line = self.timeline
        window = min(line.newest_s - self.options.lateness_s, line.held_s, line.differs_from(NEAR_S))
        while len(self._kept) > 1 and self._kept[1].decided_s < window:
            self._done_with(self._kept.pop(0))
        if self._begun_s is not None:
            self._filter_again(self._kept[0].past)
        # filters that took over may stand before the window
        self.timeline.forget(min(self._kept[0].time_s, window), NEAR_S)

    # Start -----------------------------------------------------------------------------------------------------------

    def _start(self) -> bool:
        """Begin the filters once there is enough to begin them with; whether they are begun."""
        frames, options = self.timeline.frames, self.options
        if not frames:
            return False
        # late samples of the start are in by then
        begin, wait_s = frames[0], options.lateness_s + (0.0 if options.start == "declared" else options.start_s)
        if self.timeline.newest_s < begin.time_s + wait_s:
            return False
        words = self.timeline.words_between(-math.inf, begin.time_s + options.start_s)
        read = self._sensors.first_readings(words)
        try:
            vectors = self.source.conditions(begin)
        except InputError as error:
            self.refused += 1
            self._tell(f"{error}; the link begins later")
            self.timeline.forget(math.nextafter(begin.time_s, math.inf))
            return False
        self._starts = profiles = [self._profile(i, p, read, vectors[i]) for i, p in enumerate(self.points)]
        for k, f in enumerate(self.filters):
            own = profiles[k * LANES : (k + 1) * LANES]
            f.begin(begin.time_s, vectors[k * LANES : (k + 1) * LANES], [p for p, _ in own], [c for _, c in own])
        self._now = self._snapshot(begin.time_s, begin.time_s, self._values(begin), vectors)
        self._begun = replace(self._now, filters=())
        self._kept, self._begun_s, self._changed = [self._now], begin.time_s, True
        return True

    def start_of(self, point: str) -> tuple[FloatArray, FloatArray]:
        """(node,) temperatures that a point began with [K], and their (node, node) covariance [K2].

        raises : InputError before the start
        """
        if self._now is None:
            raise InputError("the link has not begun: no start yet")
        return self._starts[self._of_point[point]]

    def _profile(
        self, i: int, point: LivePoint, read: Mapping[int, float], conditions: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """(node,) temperatures at the start [K] and their covariance [K2]."""
        declared = initial_temperatures(point.model.construction, point.mesh)
        of_point = {n: k for k, n in enumerate(self._sensors.of_point[i])}
        found = {point.mesh.sensors[k]: read[n] for n, k in of_point.items() if n in read}
        apart = max((abs(T - declared[node]) for node, T in found.items()), default=0.0)
        known = [self._sensors.sigma_K[n] for n in of_point if n in read]
        exactly = declared, np.zeros((len(declared), len(declared)))
        if self.options.start == "declared" or (
            self.options.start == "auto" and apart <= START_AGREES * max([*known, START_SIGMA_K / START_AGREES])
        ):
            return exactly
        if not found:
            self._tell(f"{point.name}: no reading to start from; the declared temperatures are taken")
            return exactly
        try:
            profile, covariance = start_of_heated(point.model, point.mesh, found, conditions)
        except RunError as error:
            reason = str(error).splitlines()[0]
            self._tell(
                f"{point.name}: no heating conducts to its first readings ({reason}); the declared temperatures are "
                "taken"
            )
            return exactly
        miss_K = max(abs(T - float(profile[node])) for node, T in found.items())
        if miss_K > START_AGREES * reading_sigma_K(apart):
            self._tell(
                f"{point.name}: no history of heating agrees with its first readings; the start misses them by up to "
                f"{miss_K:.0f} K, and its bounds are as wide"
            )
        return profile, covariance

    # Estimates -------------------------------------------------------------------------------------------------------

    @property
    def time_s(self) -> float | None:
        """Time of the newest frame that the estimate is of [s]; None before the start."""
        return None if self._now is None else max(self._now.time_s, self.timeline.newest_s)

    def estimates(self) -> dict[str, LiveEstimate]:
        """Estimates of all control points at the time of the newest frame, by name; empty before the start."""
        if self._now is None:
            return {}
        self._step_provisionally()
        found = [e for f in self.filters for e in f.estimates()]
        return {p.name: self._of_one(i, p, e) for i, (p, e) in enumerate(zip(self.points, found, strict=True))}

    def _step_provisionally(self) -> None:
        """Filter up to the newest frame although it may lie on a straight line to a later one; undone afterwards."""
        assert self._now is not None
        frames = [] if self._provisional else self.timeline.frames_after(self._now.time_s)
        if frames:
            if not self._now.filters:
                self._now = self._snapshot(self._now.time_s, self._now.decided_s, self._now.values, self._now.vectors)
            now, vectors = self._now, self._conditions(frames[-1])
            words = self._words(now.time_s, frames[-1].time_s)
            self._take(self.filters, now.time_s, now.vectors, frames[-1].time_s, vectors, words, False)
            self._provisional = True

    def _undo_provisional(self) -> None:
        if self._provisional:
            assert self._now is not None
            passed = self._passed
            self._return_to(self._now)
            self._passed = passed

    def _of_one(self, i: int, point: LivePoint, state: PointEstimate) -> LiveEstimate:
        bond = point.mesh.bondline
        return LiveEstimate(
            float(state.temperature_K[0]), float(state.sigma_K[0]),
            float(state.temperature_K[bond]), float(state.sigma_K[bond]),
            self._sensors.predicted(i, point, state, self.filters[i // LANES]), state,
        )  # fmt: skip

    def innovations(self) -> list[Innovation]:
        """Innovations since the last call, in order of time, of readings that no late sample can change any more."""
        until = min(self.timeline.newest_s - self.options.lateness_s, self.timeline.held_s)
        if self._now is None or until <= self._given_until:
            return []
        final = self._logged_between(self._given_until, min(until, self._now.time_s))
        self._given_until = min(until, self._now.time_s)
        # those that no snapshot goes back to are needed no more
        gone = self._kept[0].logged - self._log_from
        if all(step[-1, 0] <= self._given_until for step in self._log[:gone] if len(step)):
            del self._log[:gone]
            self._log_from += gone
        numbers, place = final[:, 1].astype(int).tolist(), self._sensors.place
        columns = [final[:, k].tolist() for k in range(2, _LOGGED - 1)]
        points, sensors = [place[n][0] for n in numbers], [place[n][1] for n in numbers]
        return list(map(Innovation, final[:, 0].tolist(), points, sensors, *columns, (final[:, -1] > 0.0).tolist()))

    def _logged_between(self, after_s: float, until_s: float) -> FloatArray:
        """(reading, _LOGGED) what is logged later than one time and up to another [s], in order of time and sensor."""
        found: list[FloatArray] = []
        for step in reversed(self._log):
            if len(step) and step[-1, 0] <= after_s:
                break
            found.append(step[(step[:, 0] > after_s) & (step[:, 0] <= until_s)])
        return np.concatenate([np.zeros((0, _LOGGED)), *reversed(found)])

    @property
    def diverged(self) -> list[str]:
        """Names of the points whose filter diverged."""
        return [self.names[k * LANES + i] for k, f in enumerate(self.filters) for i in f.diverged]


def _track(
    point: LivePoint, names: tuple[str, ...], priors: Mapping[str, Prior], options: LiveOptions
) -> tuple[FilterTrack, dict[str, Prior]]:
    """A point as the filter takes it, and the priors of its parameters."""
    march = tuple(n for n in names if is_of_march(n))
    nothing = np.zeros(0)
    empty = Samples(nothing, np.zeros(0, dtype=np.int64), *(nothing,) * 5)
    wanders = Disturbance() if options.ratio_noise is None else Disturbance.gauss_markov(*options.ratio_noise)
    columns = np.zeros((point.mesh.nodes, len(names) - len(march)))
    track = FilterTrack(
        point.model, point.mesh, empty, march, None, columns if columns.shape[1] else None,
        noise_K2_s=options.node_noise_K_sqrt_s**2, disturbance=wanders,
    )  # fmt: skip
    return track, {n: priors[n] if n in priors else default_prior(point.model, n) for n in names}
