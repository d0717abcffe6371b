"""Steps of a running filter: takes frames, marches the control points, and keeps snapshots to go back to.

Steps end at frames; frames on a straight line are passed over, up to `wait_s`, as the plug-in does. A sample that
belongs before what has been filtered has one rule: the filter returns to the snapshot before it and filters on.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.base.errors import InputError
from sim_heating.base.kernels.block import LANES
from sim_heating.estimation.filter.online import FilterSnapshot, OnlineFilter, PointEstimate
from sim_heating.heating.effects.compiled import unusable_value
from sim_heating.live.filtering.estimates import InnovationLog, LiveOptions, Notices
from sim_heating.live.filtering.marching import StepMarch
from sim_heating.live.filtering.points import ConditionsOfFrame, line_tolerance
from sim_heating.live.filtering.timeline import Timeline
from sim_heating.live.types import Frame

TOGETHER = 32
"""Frames that are looked at together, whether they lie on a straight line."""


@dataclass(frozen=True, eq=False)
class Moment:
    """State of all filters after a step.

    time_s    : end of the step [s];  decided_s : time of the last frame that the choice of its end depended on [s]
    values    : (column,) of the frame at its end;  vectors : (point, condition) there
    snapshots : of the filters; none where the filter cannot return here
    logged    : number of steps until then;  past : number of steps until then that are kept to be taken again
    """

    time_s: float
    decided_s: float
    values: FloatArray
    vectors: FloatArray
    snapshots: tuple[FilterSnapshot, ...]
    logged: int
    past: int


class PastStep(NamedTuple):
    """A step that was taken, as it is to be taken again.

    frame     : at its end;  decided_s, logged : as of Moment;  vectors : (point, condition) at its end
    rows      : (reading, 4) its readings: time [s], number of the sensor, value [K], 1 where it may be a spike
    estimates : of the parameters after it, where they serve to begin again
    """

    frame: Frame
    decided_s: float
    logged: int
    vectors: FloatArray
    rows: FloatArray
    estimates: tuple[FloatArray, ...] | None


@dataclass
class Past:
    """Steps since the start, kept to be filtered again: after a first time, and whenever that time has doubled.

    steps   : those that were taken
    begun_s : start [s]; None where no steps are kept
    first_s : time since the start at which the flight is filtered again first [s], infinite for never
    """

    first_s: float
    begun_s: float | None = None
    steps: list[PastStep] = field(default_factory=list)

    def count_due(self, time_s: float) -> int:
        """How often the flight is to have been filtered again by a time [s]."""
        if self.begun_s is None or math.isinf(self.first_s):
            return 0
        ratio = (time_s - self.begun_s) / self.first_s
        return math.floor(math.log2(ratio)) + 1 if ratio >= 1.0 else 0

    def give_up(self) -> None:
        """Keep no steps any more, and none from now on."""
        self.steps, self.begun_s = [], None


class Stepper:
    """Filters of all points, taken from frame to frame, with snapshots to return to.

    source   : the control points, and what a frame is for them
    filters  : LANES points in each;  march : marches them
    timeline : samples in order;  notices : messages to the user

    now     : the last step; None before the start.  moments : snapshots in order of time, which can be returned to
    past    : steps since the start.  log : of innovations.  steps : number of steps taken
    is_due  : whether samples have come, or the filter went back, since the last step
    """

    def __init__(
        self,
        source: ConditionsOfFrame,
        filters: list[OnlineFilter],
        march: StepMarch,
        timeline: Timeline,
        log: InnovationLog,
        options: LiveOptions,
        notices: Notices,
    ) -> None:
        self.source, self.filters, self.march, self.timeline = source, filters, march, timeline
        self.log, self.options, self.notices = log, options, notices
        self.now: Moment | None = None
        self.moments: list[Moment] = []
        self.past = Past(options.again_s)
        self.steps, self.is_due = 0, False
        self._is_provisional = False
        self._diverged: set[str] = set()
        # frames since the last step, all on one straight line
        self._passed: list[Frame] = []
        # times of the first frame and of the first reading that came after they had been passed [s]
        self._late_s = (math.inf, math.inf)

    def begin(self, frame: Frame, vectors: FloatArray, profiles: Sequence[tuple[FloatArray, FloatArray]]) -> Moment:
        """Begin at a frame with (node,) temperatures [K] and their covariance [K2] of each point; the moment.

        vectors : (point, condition) at the frame
        """
        for k, f in enumerate(self.filters):
            lanes = slice(k * LANES, (k + 1) * LANES)
            chosen = profiles[lanes]
            f.begin(frame.time_s, vectors[lanes], [T for T, _ in chosen], [C for _, C in chosen])
        self.now = self.snapshot(frame.time_s, frame.time_s, self.values(frame), vectors)
        self.moments, self.is_due = [self.now], True
        self.past.begun_s = frame.time_s
        return self.now

    # Going back ------------------------------------------------------------------------------------------------------

    def note_frame(self, time_s: float) -> None:
        """Note that a frame has come: what it belongs before is filtered again."""
        if self.now is None:
            return
        if self._passed and time_s < self._passed[-1].time_s:
            self._passed = []
        if time_s <= self.now.decided_s:
            self._late_s = (min(self._late_s[0], time_s), self._late_s[1])

    def refilter_since(self, time_s: float) -> None:
        """Note that readings from a time on [s] are to be filtered again."""
        self._late_s = (self._late_s[0], min(self._late_s[1], time_s))

    def has_passed(self, time_s: float) -> bool:
        """Whether a step has been taken to a time [s], or beyond it."""
        return self.now is not None and time_s <= self.now.time_s

    def go_back(self) -> None:
        """Return to the last snapshot before the first sample that came late, where there is one."""
        frame_s, reading_s = self._late_s
        if frame_s == reading_s == math.inf:
            return
        self._late_s = (math.inf, math.inf)
        # one is older than the window, so that no sample that is taken comes before it
        usable = [moment for moment in self.moments if moment.decided_s < frame_s and moment.time_s < reading_s]
        self.moments = usable or self.moments[:1]
        self.return_to(self.moments[-1])

    def return_to(self, moment: Moment) -> None:
        """Take all filters back to a moment; the steps after it are forgotten."""
        for f, snapshot in zip(self.filters, moment.snapshots, strict=True):
            f.restore(snapshot)
        self.log.cut(moment.logged)
        del self.past.steps[moment.past :]
        self.now, self._is_provisional, self._passed = moment, False, []

    def return_before(self, time_s: float) -> None:
        """Return to the last snapshot that depends on no frame from a time on [s], or else to the first one."""
        before = next((moment for moment in reversed(self.moments) if moment.decided_s < time_s), self.moments[0])
        self.return_to(before)

    def go_on_from(self, time_s: float, values: FloatArray, vectors: FloatArray) -> None:
        """Call the present state that of another time [s]; nothing before it can be returned to.

        values, vectors : (column,) and (point, condition) of the frame there
        """
        for f in self.filters:
            f.now_s = time_s
        self.past.give_up()
        self.now = self.snapshot(time_s, time_s, values, vectors)
        self.moments, self._passed, self._late_s = [self.now], [], (math.inf, math.inf)

    def take_over(self, filters: list[OnlineFilter], step: PastStep) -> list[OnlineFilter]:
        """Go on with other filters, from a step of the past that they took last; the filters that worked until now."""
        before, self.filters = self.filters, filters
        self.now = self.snapshot(step.frame.time_s, step.decided_s, self.values(step.frame), step.vectors)
        self.moments, self._passed, self._is_provisional, self.is_due = [self.now], [], False, True
        return before

    def forget_moments(self, before_s: float) -> None:
        """Drop snapshots that no sample from a time on [s] can make the filter return to."""
        while len(self.moments) > 1 and self.moments[1].decided_s < before_s:
            self._release(self.moments.pop(0))

    def _release(self, moment: Moment) -> None:
        for f, snapshot in zip(self.filters, moment.snapshots, strict=True):
            f.done_with(snapshot)

    # Steps -----------------------------------------------------------------------------------------------------------

    def step_on(self) -> None:
        """Filter the frames since the last step."""
        assert self.now is not None
        new = self.timeline.frames_after(self._passed[-1].time_s if self._passed else self.now.time_s)
        frames, first, begin = [*self._passed, *new], len(self._passed), 0
        time_s, columns = np.array([f.time_s for f in frames]), self.source.columns
        values = np.array([[f.values[c] for c in columns] for f in frames])
        while first < len(frames):
            # the first one that has waited is the end of a step, where those before it lie on a straight line
            waited = time_s[first:] - self.now.time_s >= self.options.wait_s - 1e-9
            stop = first + int(np.argmax(waited)) if np.any(waited) else len(frames)
            last = min(stop + 1, first + TOGETHER, len(frames))
            bent = begin + self._first_off_line(time_s[begin:last], values[begin:last], first - begin)
            if bent < last:
                self.step_to(frames[bent - 1], frames[bent].time_s)
                begin = first = bent
            elif stop < last:
                self.step_to(frames[stop], frames[stop].time_s)
                begin = first = last
            else:
                first = last
        self._passed = frames[begin:]

    def _first_off_line(self, time_s: FloatArray, values: FloatArray, first: int) -> int:
        """Number of the first frame, from number `first` on, to which no straight line leads from the last step; that
        of frames for none.

        time_s, values : (frame,), (frame, column) since the last step
        """
        assert self.now is not None
        since, first = time_s - self.now.time_s, max(first, 1)  # no frame lies between the last step and the first one
        if first >= len(since):
            return len(since)
        fraction = since[:, np.newaxis] / since[first:]
        ends = values[first:] - self.now.values
        away = (values - self.now.values)[:, np.newaxis] - fraction[..., np.newaxis] * ends
        absolute, relative = line_tolerance(self.source.columns)
        tolerance = (absolute + relative * np.abs(values))[:, np.newaxis]
        before = np.arange(len(since))[:, np.newaxis] < np.arange(first, len(since))
        off = ((np.abs(away) > tolerance).any(axis=2) & before).any(axis=0)
        off |= since[first:] > self.options.wait_s + 1e-9
        return first + int(np.argmax(off)) if np.any(off) else len(since)

    def values(self, frame: Frame) -> FloatArray:
        """(column,) values of a frame."""
        return np.array([frame.values[c] for c in self.source.columns])

    def conditions(self, frame: Frame) -> FloatArray:
        """(point, condition) vectors of a frame; those of the last step where it is not plausible."""
        assert self.now is not None
        try:
            return self.source.conditions(frame)
        except InputError as error:
            self.notices.refuse(f"{error}; the conditions before are held")
            return self.now.vectors

    def step_to(self, frame: Frame, decided_s: float) -> None:
        """Filter up to a frame, and keep a snapshot where one is due.

        decided_s : time of the last frame that this choice depends on [s]
        """
        assert self.now is not None
        last, past = self.now, self.past
        vectors, rows = self.conditions(frame), self.march.readings_between(last.time_s, frame.time_s)
        self.log.append(self.march.march(self.filters, last.time_s, last.vectors, frame.time_s, vectors, rows))
        self._tell_diverged(last, frame.time_s, vectors)
        if past.begun_s is not None:
            is_due = past.count_due(last.time_s) < past.count_due(frame.time_s)
            estimates = tuple(e.values for f in self.filters for e in f.estimates()) if is_due else None
            past.steps.append(PastStep(frame, decided_s, self.log.count, vectors, rows, estimates))
        every_s = self.options.snapshot_s
        values = self.values(frame)
        if not self.moments or math.floor(frame.time_s / every_s) > math.floor(self.moments[-1].time_s / every_s):
            self.now = self.snapshot(frame.time_s, decided_s, values, vectors)
            self.moments.append(self.now)
        else:
            self.now = Moment(frame.time_s, decided_s, values, vectors, (), self.log.count, len(self.past.steps))
        if last.snapshots and not any(last is moment for moment in self.moments):
            self._release(last)
        self._passed = []
        self.steps += 1

    def _tell_diverged(self, last: Moment, time_s: float, vectors: FloatArray) -> None:
        """Tell of points that have diverged in a step, once, with the effect of a user that is at fault."""
        for i in (k * LANES + lane for k, f in enumerate(self.filters) for lane in f.diverged):
            point = self.source.points[i]
            if point.name in self._diverged:
                continue
            self._diverged.add(point.name)
            ends, history = np.array([last.time_s, time_s]), np.stack([last.vectors[i], vectors[i]])
            faults = (unusable_value(use, ends, history) for use in point.model.effects)
            fault = next(filter(None, faults), "a temperature of the estimate is below 1 K or not a number")
            self.notices.tell(f"{point.name}: {fault}; nothing is estimated there from {time_s:g} s on")

    def snapshot(self, time_s: float, decided_s: float, values: FloatArray, vectors: FloatArray) -> Moment:
        """The present state as a moment that can be returned to."""
        snapshots = tuple(f.snapshot() for f in self.filters)
        return Moment(time_s, decided_s, values, vectors, snapshots, self.log.count, len(self.past.steps))

    # Up to the newest frame ------------------------------------------------------------------------------------------

    def estimates(self) -> list[PointEstimate]:
        """Estimate of each point at the newest frame, although it may lie on a straight line to a later one."""
        assert self.now is not None
        frames = [] if self._is_provisional else self.timeline.frames_after(self.now.time_s)
        if frames:
            if not self.now.snapshots:
                self.now = self.snapshot(self.now.time_s, self.now.decided_s, self.now.values, self.now.vectors)
            now, vectors = self.now, self.conditions(frames[-1])
            rows = self.march.readings_between(now.time_s, frames[-1].time_s)
            self.march.march(self.filters, now.time_s, now.vectors, frames[-1].time_s, vectors, rows, False)
            self._is_provisional = True
        return [e for f in self.filters for e in f.estimates()]

    def undo_provisional(self) -> None:
        """Return to the last step, where an estimate was made beyond it."""
        if self._is_provisional:
            assert self.now is not None
            passed = self._passed
            self.return_to(self.now)
            self._passed = passed
