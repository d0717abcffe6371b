"""Temperatures and parameters of the control points while the flight is flown.

Frames and readings may come in any order within a window. Five objects have one job each:

    clock judge (clock_judge.py)            puts samples in order, and judges the clocks that they were stamped with
    stepper (stepper.py)                    takes frames, marches, and returns to snapshots
    spike gate (spikes.py)                  suspects a reading until the next one of its sensor
    re-linearisation (relinearisation.py)   filters the flight so far again about its estimate
    start (start.py)                        chooses the first temperatures

The estimate is a function of the samples alone, bit for bit, not of the order in which they came.

    estimator = LiveEstimator(VehiclePoints(load_vehicle("orbiter"), ["V09T9527"]), ["ratio.scale"])
    estimator.add(frame, reading)          # as they come
    estimator.advance()
    estimator.estimates()["V09T9527"].surface_K

Filter: docs/theory/filter.md, section "Parameters as the readings come".
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from sim_heating.base.errors import InputError
from sim_heating.base.files import suggestion
from sim_heating.base.kernels.block import LANES
from sim_heating.estimation.filter.online import PointEstimate, Prior
from sim_heating.live.filtering.clock_judge import ClockJudge
from sim_heating.live.filtering.estimates import Innovation, InnovationLog, LiveEstimate, LiveOptions, Notices
from sim_heating.live.filtering.marching import StepMarch, make_filters, warm_up
from sim_heating.live.filtering.parameters import check_estimated
from sim_heating.live.filtering.points import ConditionsOfFrame, LivePoint
from sim_heating.live.filtering.relinearisation import Relinearisation
from sim_heating.live.filtering.sensors import SensorTable
from sim_heating.live.filtering.spikes import NEAR_S, SpikeGate
from sim_heating.live.filtering.start import Profile, Start
from sim_heating.live.filtering.stepper import Stepper
from sim_heating.live.filtering.timeline import Counts, Placed, Repeated, Timeline
from sim_heating.live.types import Frame, Reading, Sample


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
        check_estimated({p.name: p.sensors for p in self.points}, names)
        self._sensors = SensorTable(self.points, names)
        self._gate = SpikeGate(self._sensors.sigma_K, self._sensors.recorders.lsb_K)
        # readings may come in any order: half of what is suspected between neighbours is looked at
        half_K = [0.5 * gate_K for gate_K in self._gate.gate_K]
        self.timeline = Timeline(self._sensors.numbers, self.options.lateness_s, self.options.jump_s, half_K)
        self.notices = Notices()
        self.clocks = ClockJudge(self.timeline, self._sensors.point_and_name, self.notices)
        filters, spare = (make_filters(self.points, self._sensors, priors or {}, self.options) for _ in range(2))
        self.stepper = Stepper(
            source,
            filters,
            StepMarch(self._sensors, self._gate, self.timeline, self.options),
            self.timeline,
            InnovationLog(self._sensors.point_and_name),
            self.options,
            self.notices,
        )
        self._relinearisation = Relinearisation(self.stepper, spare)
        self._start = Start(source, self._sensors, self.options, self.notices)
        self._wrong: dict[int, tuple[float, float]] = {}
        warm_up(filters)

    # Samples in ------------------------------------------------------------------------------------------------------

    def add(self, *samples: Sample) -> None:
        """Take samples in any order; `advance` filters them.

        raises : InputError for a point or sensor that the link does not have

        What is late, doubled, lost or on another clock is counted in `counts`; a jump of the clock is told in
        `messages`.
        """
        k = 0
        while k < len(samples):
            sample = samples[k]
            if isinstance(sample, Frame):
                k += 1
                if self._is_complete(sample):
                    self._add_out_of_order(sample)
            elif in_order := self.clocks.put_in_order(samples, k, self._now_s):
                k += len(in_order)
                for reading in in_order if self._gate.is_waiting else ():
                    self._decide(reading)
                self.stepper.is_due = True
            else:
                k += 1
                if (sample.point, sample.sensor) not in self._sensors.numbers:
                    raise InputError(self._unknown(sample.point, sample.sensor))
                self._add_out_of_order(sample)
            if self.timeline.late_sensors:
                self.clocks.tell_late(self.options.lateness_s)
            if self.timeline.repeated is not None and isinstance(sample, Frame):
                self._judge_repetition()

    @property
    def _now_s(self) -> float:
        """End of the last step [s]; minus infinity before the start."""
        return -math.inf if self.stepper.now is None else self.stepper.now.time_s

    def _is_complete(self, frame: Frame) -> bool:
        missing = [c for c in self.source.columns if c not in frame.values]
        if missing:
            self.notices.refuse(f"frame at {frame.time_s:g} s: no `{missing[0]}`; not used")
        return not missing

    def _add_out_of_order(self, sample: Sample) -> None:
        """Take a frame, or a reading that is not the next in order, and note what is to be filtered again."""
        placed, self.stepper.is_due = self.clocks.put(sample), True
        if placed is Placed.JUMPED:
            self._follow_jump()
        if placed not in (Placed.TAKEN, Placed.LATE) or self.stepper.now is None:
            return
        if isinstance(sample, Frame):
            self.stepper.note_frame(sample.time_s)
            return
        if self.stepper.has_passed(sample.time_s):
            # a late reading may decide on one that was suspected before it
            self.stepper.refilter_since(sample.time_s - (NEAR_S if self.timeline.differs_s else 0.0))
        self._decide(sample)

    def _decide(self, reading: Reading) -> None:
        """Filter suspected readings again, once one after them has come."""
        oldest_s = self.timeline.newest_s - self.options.lateness_s - NEAR_S
        number = self._sensors.numbers[reading.point, reading.sensor]
        self.stepper.refilter_since(self._gate.decide(number, reading.time_s, oldest_s))

    def _unknown(self, point: str, sensor: str) -> str:
        if point not in self.names:
            return f"reading: unknown control point `{point}`{suggestion(point, self.names)}"
        sensors = [s.name for s in self.points[self.names.index(point)].sensors]
        return f"reading: {point} has no sensor `{sensor}`{suggestion(sensor, sensors)}"

    # Clocks ----------------------------------------------------------------------------------------------------------

    def _follow_jump(self) -> None:
        """Go over to a new clock: a gap where it is a little ahead, else the state is taken over as it is."""
        jump, stepper = self.timeline.jump, self.stepper
        assert jump is not None
        if self.clocks.is_bridged(jump):
            self.timeline.follow(True)
            return
        self.advance()
        stepper.undo_provisional()
        if stepper.now is not None and (frames := self.timeline.frames_after(stepper.now.time_s)):
            stepper.step_to(frames[-1], frames[-1].time_s)  # the last ones of the old clock
        self.timeline.follow(False)
        if stepper.now is None:
            return
        # all that is to come follows from here; the filter does not know of time but by its steps
        first = self.timeline.frames[0]
        stepper.log.clear()
        self._relinearisation.give_up()
        stepper.go_on_from(first.time_s, stepper.values(first), stepper.conditions(first))

    def _judge_repetition(self) -> None:
        """Where times that came again have ended: follow the clock of all, or leave out sensors whose own went back."""
        ended = self.clocks.ended_repetition()
        if ended is None:
            return
        if self.clocks.went_back(ended):
            self._follow_back(ended)
            return
        for point, sensor in self.clocks.take_failed(ended):
            self.leave_out(point, sensor, ended.first_s)
            if self.stepper.has_passed(ended.first_s):
                self.stepper.refilter_since(ended.first_s)

    def _follow_back(self, ended: Repeated) -> None:
        """Go over to a clock that went back by little: from the state before it, over the time that came twice."""
        self.advance()
        jump, stepper = self.clocks.go_back(ended), self.stepper
        if stepper.now is None:
            return
        stepper.return_before(ended.first_s - ended.every_s)
        self._relinearisation.give_up()
        stepper.go_on_from(stepper.now.time_s + jump.by_s, stepper.now.values, stepper.now.vectors)
        stepper.is_due = True

    # Use of sensors --------------------------------------------------------------------------------------------------

    def leave_out(self, point: str, sensor: str, since_s: float, wrong_s: float | None = None) -> None:
        """Use no readings of a sensor from a time on [s]; they are still predicted.

        wrong_s : earlier time from which on they are not trusted [s]: `filter_again` takes them back from there on.
                  The running estimate does not, as when that could be done depends on when the samples came
        raises  : InputError for an unknown point or sensor
        """
        if (point, sensor) not in self._sensors.numbers:
            raise InputError(self._unknown(point, sensor))
        self._relinearisation.take_due()
        spans = self.stepper.march.left_out[self._sensors.numbers[point, sensor]].spans
        self.stepper.is_due = True
        if not (spans and spans[-1][1] == math.inf):
            spans.append((since_s, math.inf))
        if self.stepper.has_passed(since_s):
            # what is older than the window stays as it was filtered
            self.stepper.refilter_since(max(since_s, self.timeline.newest_s - self.options.lateness_s))
        if wrong_s is not None:
            self._wrong[self._sensors.numbers[point, sensor]] = (wrong_s, since_s)

    # Filtering -------------------------------------------------------------------------------------------------------

    def advance(self) -> None:
        """Filter all that is complete up to the newest frame."""
        stepper = self.stepper
        if stepper.now is None:
            start = self._start.make(self.timeline)
            if start is None:
                return
            self._relinearisation.begin(stepper.begin(*start, self._start.profiles), self._start.profiles)
        # where filters take over that have taken the flight again, a second round goes on from there
        while stepper.is_due:
            stepper.is_due = False
            stepper.go_back()
            stepper.undo_provisional()
            stepper.step_on()
            self._forget()

    def _forget(self) -> None:
        """Drop snapshots and samples that no sample to come can reach."""
        timeline, stepper = self.timeline, self.stepper
        window_s = min(timeline.newest_s - self.options.lateness_s, timeline.held_s, timeline.differs_from(NEAR_S))
        stepper.forget_moments(window_s)
        self._relinearisation.follow(stepper.moments[0].past)
        # filters that took over may stand before the window
        timeline.forget(min(stepper.moments[0].time_s, window_s), NEAR_S)

    def filter_again(self) -> bool:
        """Filter the whole flight so far again, linearised about the present estimate, at once; whether it was.

        What earlier readings said is then linearised about the estimate too, as in a fit of the whole record, and what
        sensors read after they had begun to fail is taken back; a flight of 1000 s takes some seconds. Nothing is done
        before the start, or where the clock jumped.
        """
        self.advance()
        self.stepper.undo_provisional()
        if not self.stepper.past.steps:
            return False
        has_wrong = bool(self._wrong)
        for n, span in self._wrong.items():
            self.stepper.march.left_out[n].spans.insert(0, span)
        self._wrong.clear()
        self._relinearisation.filter_all()
        self.advance()
        # the estimate that this was linearised about had those readings
        return self.filter_again() if has_wrong else True

    # Estimates -------------------------------------------------------------------------------------------------------

    @property
    def time_s(self) -> float | None:
        """Time of the newest frame that the estimate is of [s]; None before the start."""
        return None if self.stepper.now is None else max(self.stepper.now.time_s, self.timeline.newest_s)

    def estimates(self) -> dict[str, LiveEstimate]:
        """Estimates of all control points at the time of the newest frame, by name; empty before the start."""
        if self.stepper.now is None:
            return {}
        states = self.stepper.estimates()
        return {p.name: self._estimate(i, p, s) for i, (p, s) in enumerate(zip(self.points, states, strict=True))}

    def _estimate(self, i: int, point: LivePoint, state: PointEstimate) -> LiveEstimate:
        bond = point.mesh.bondline
        return LiveEstimate(
            float(state.temperature_K[0]),
            float(state.sigma_K[0]),
            float(state.temperature_K[bond]),
            float(state.sigma_K[bond]),
            self._sensors.predicted(i, point, state, self.stepper.filters[i // LANES]),
            state,
        )

    def start_of(self, point: str) -> Profile:
        """(node,) temperatures that a point began with [K], and their (node, node) covariance [K2].

        raises : InputError before the start
        """
        if self.stepper.now is None:
            raise InputError("the link has not begun: no start yet")
        return self._start.profiles[self.names.index(point)]

    def innovations(self) -> list[Innovation]:
        """Innovations since the last call, in order of time, of readings that no late sample can change any more."""
        stepper = self.stepper
        if stepper.now is None:
            return []
        until_s = min(self.timeline.newest_s - self.options.lateness_s, self.timeline.held_s)
        return stepper.log.hand_out(until_s, stepper.now.time_s, stepper.moments[0].logged)

    # What happened ---------------------------------------------------------------------------------------------------

    @property
    def messages(self) -> list[str]:
        """The last 100 messages to the user, in order."""
        return self.notices.messages

    @property
    def failed_clocks(self) -> list[tuple[str, str, float, str]]:
        """Point, sensor, time from which on [s] and reason of each sensor whose own clock went back."""
        return self.clocks.failed

    @property
    def counts(self) -> Counts:
        """Numbers of late, doubled, lost ... samples."""
        return self.timeline.counts

    @property
    def diverged(self) -> list[str]:
        """Names of the points whose filter diverged."""
        return [self.names[k * LANES + i] for k, f in enumerate(self.stepper.filters) for i in f.diverged]
