"""The engine of a link, without its network: messages in, states out.

    message -> journal -> mapping -> estimator -> checks, test of the innovations, look-ahead -> state

A message is in the journal before anything is made of it. The estimate is a function of the samples in the order of
their times, so that an engine that takes the messages of a journal again comes to the same numbers.
"""

from __future__ import annotations

import math
import time
from collections import Counter, deque
from collections.abc import Callable, Mapping
from functools import partial
from itertools import islice
from typing import Any

from sim_heating.base.errors import InputError, RunError, error_context, one_line
from sim_heating.base.files import display_path, suggestion
from sim_heating.base.parameters import CLOCK_SKEW
from sim_heating.estimation.filter.online import Prior
from sim_heating.estimation.inference.observability import default_names, heating_names
from sim_heating.heating.atmosphere import free_stream_kernel
from sim_heating.live.ahead.look_ahead import AheadOfLink
from sim_heating.live.filtering.estimates import Innovation, LiveOptions
from sim_heating.live.filtering.estimator import LiveEstimator
from sim_heating.live.filtering.parameters import check_estimated
from sim_heating.live.filtering.points import ConditionsOfFrame, RecordPoints, VehiclePoints
from sim_heating.live.outputs.present import REMARKS, PresentState, removed_sensor
from sim_heating.live.recording.journal import Journal, read_journal
from sim_heating.live.results.followed import Followed
from sim_heating.live.sources import decoder_of
from sim_heating.live.sources.arrivals import Arrivals
from sim_heating.live.sources.decoder import message_of
from sim_heating.live.sources.mapping import clock_skew_s
from sim_heating.live.spec import Link
from sim_heating.live.state import LinkState, State
from sim_heating.live.types import Frame, Message, Reading, too_long
from sim_heating.live.watch.checks import Failure, SensorChecks
from sim_heating.live.watch.missing import Weighing
from sim_heating.live.watch.sequential import SequentialTest, score_of_word

IN_A_ROW = 256
"""Messages that are taken before the estimator steps on and others may run."""
PREPARED_S = 6
"""Flight that is taken beforehand, a second beyond the wait for late samples and first readings [s]."""
HOT_K = 400.0
"""Reading of it: warmer than a wall declares, so that a start from readings is computed, too [K]."""
KEPT_REMARKS = 10_000
"""Remarks that are kept for the summary."""


class Remarks:
    """Lines on the link, each once in a row with the number of times."""

    def __init__(self) -> None:
        self._lines: deque[list[Any]] = deque(maxlen=KEPT_REMARKS)

    def add(self, line: str) -> None:
        """Add a line; one like the last is counted."""
        line = one_line(line)
        for entry in islice(reversed(self._lines), REMARKS):
            if entry[0] == line:
                entry[1] += 1
                return
        self._lines.append([line, 1])

    def lines(self, last: int | None = None) -> list[str]:
        """The lines, oldest first."""
        chosen = list(self._lines) if last is None else list(self._lines)[-last:]
        return [line if count == 1 else f"{line} ({count} times)" for line, count in chosen]


def parameters_of(link: Link) -> list[str]:
    """Names of what a link estimates: by default magnitude and derivatives of the heating ratio, as `estimate` does.

    Fewer would leave an error of a table's slope to the test of what is missing.
    """
    if link.declared.estimate.parameters:
        return link.declared.estimate.parameters
    # a control point of a vehicle has a table
    if link.vehicle is not None:
        return list(heating_names(True, link.vehicle.surfaces))
    return list(default_names(list(link.records.values())))


def check_estimate(link: Link) -> None:
    """Refuse parameters and priors that a running estimate cannot have, without making one.

    raises : InputError with one line
    """
    names = parameters_of(link)
    with error_context(f"{display_path(link.path)}, [estimate]"):
        if unknown := [name for name in link.declared.estimate.prior if name not in names]:
            raise InputError(f"`prior`: {unknown[0]} is not estimated{suggestion(unknown[0], names)}")
        if CLOCK_SKEW.name in link.declared.estimate.fix and CLOCK_SKEW.name in names:
            raise InputError(
                f"`{CLOCK_SKEW.name}` is in `fix` and in `parameters`; give what is known of it as the mean of its "
                "`prior`, and estimate it"
            )
        settings, skew_s = link.declared.estimate, clock_skew_s(link)
        if not -settings.jump_s < skew_s < settings.lateness_s:
            raise InputError(
                f"`{CLOCK_SKEW.name}` = {skew_s:g} s: readings would belong outside the window in which samples are "
                f"waited for, from {-settings.jump_s:g} to {settings.lateness_s:g} s; raise `lateness_s` or `jump_s`"
            )
        check_estimated({p.name: p.sensors for p in link.points}, names)


def make_estimator(link: Link) -> LiveEstimator:
    """The estimator that a link file declares.

    raises : InputError for a parameter that a running estimate cannot have
    """
    check_estimate(link)
    settings, names = link.declared.estimate, parameters_of(link)
    priors = {name: Prior(mean, sigma) for name, (mean, sigma) in settings.prior.items()}
    with error_context(f"{display_path(link.path)}, [estimate]"):
        options = LiveOptions(
            lateness_s=settings.lateness_s,
            jump_s=settings.jump_s,
            linearise_s=settings.linearise_s,
            start=settings.start,
            ratio_noise=(settings.wander, settings.wander_s) if settings.wander > 0.0 else None,
            corrects_mesh=settings.corrects_mesh,
        )
        points: ConditionsOfFrame
        fixed = {name: value for name, value in settings.fix.items() if name != CLOCK_SKEW.name}
        if link.vehicle is not None:
            points = VehiclePoints(link.vehicle, link.names, parameters=fixed)
        else:
            points = RecordPoints([link.records[name] for name in link.names], parameters=fixed)
        return LiveEstimator(points, names, priors, options)


class LinkEngine:
    """The engine of one link.

    link      : with its control points
    estimator : of all control points; the one that the link declares by default
    journal   : that messages are kept in; None for none
    """

    def __init__(self, link: Link, journal: Journal | None = None, estimator: LiveEstimator | None = None) -> None:
        self.link, self.journal = link, journal
        self.estimator = make_estimator(link) if estimator is None else estimator
        self.remarks = Remarks()
        for line in [] if journal is None else journal.notes:
            self.remarks.add(line)
        self.arrivals = Arrivals(link, self.remarks.add)
        sensors = {(p.name, s.name): s for p in link.points for s in p.sensors}
        self.checks = SensorChecks(sensors, link.declared.estimate.lateness_s)
        self.test = SequentialTest(link.declared.missing.false_alarms_per_hour)
        self.weighing = Weighing()
        self.followed = Followed()
        limits = {name: _limits(link, name) for name in link.names}
        self.ahead = AheadOfLink(link, self.estimator, limits)
        self._present = PresentState(
            link,
            self.estimator,
            self.arrivals,
            parameters_of(link),
            self.remarks.lines,
            self.checks,
            self.test,
            self.weighing,
            self.ahead,
            limits,
        )
        self._journal_problem = ""

    @property
    def counts(self) -> Mapping[str, int]:
        """Numbers of messages, frames and readings, and of what was damaged or lost."""
        return self.arrivals.counts

    def prepare(self) -> None:
        """Compile, or read from the cache, all that the first samples run; they and the page's port come after it.

        A flight of a few seconds is taken by another estimator of the same points, and forgotten.
        """
        probe = LiveEstimator(self.estimator.source, parameters_of(self.link))
        first = _still_frame(self.link)
        for time_s in range(PREPARED_S):
            probe.add(Frame(float(time_s), first))
            readings = [(p.name, s.name, HOT_K) for p in self.link.points for s in p.sensors]
            probe.add(*(Reading(float(time_s), *reading) for reading in readings))
            try:
                probe.advance()
            except (InputError, RunError):  # conditions that are none of this flight
                return
        if self.link.vehicle is not None:
            free_stream_kernel(70e3, 6800.0, 8e-5, self.link.vehicle.reference_length_m)

    # Messages --------------------------------------------------------------------------------------------------------

    @property
    def is_behind(self) -> bool:
        """Whether messages have come of a flight time at which an estimate is to be kept for the report."""
        return self.arrivals.latest_frame is not None and self.followed.is_due(self.arrivals.latest_frame.time_s)

    def take(self, message: Message, source: int = 0) -> None:
        """Keep a message, and give its samples to the estimator.

        source : number of its source in the link
        """
        self.keep(message, source)
        self.give(message)

    def keep(self, message: Message, source: int = 0) -> None:
        """Keep a message in the journal, at once when it comes: the estimator may be at work on those before it.

        One that is too long to be read back is not kept; `give` counts it as damaged.
        """
        self.arrivals.last_message_s = message.arrived_s
        if self.journal is not None and too_long(message.body) is None:
            self.journal.append(message.body, source)
            self._tell_journal()

    def give(self, message: Message) -> None:
        """Give the samples of a message that is kept already to the estimator."""
        samples, jumps = self.arrivals.samples(message), self.estimator.counts.jumps
        self.estimator.add(*samples)
        if self.estimator.counts.jumps != jumps:  # what is newest is so by the new clock
            self.arrivals.follow_clock(self.estimator.timeline.frames[-1])

    def resume(self, path: Any, most: int) -> dict[int, int]:
        """Take the messages of a journal that was cut off again, without writing them.

        path    : of the journal
        most    : number of messages that it had; what comes now is behind them
        returns : number of bodies by source
        """
        decoders = [decoder_of(self.link, source) for source in self.link.declared.source]
        counts: Counter[int] = Counter()
        for entry in islice(read_journal(path), most):
            counts[entry.source] += 1
            message = message_of(decoders[entry.source], entry.body, time.monotonic())
            if message is not None:
                self.give(message)
            if sum(counts.values()) % IN_A_ROW == 0:
                self.advance()
        self.advance()
        if counts:
            self.remarks.add(f"goes on from a journal of {sum(counts.values())} messages")
        return dict(counts)

    def _tell_journal(self) -> None:
        assert self.journal is not None
        problem = self.journal.problem.partition(";")[0]
        if problem != self._journal_problem:
            self.remarks.add(self.journal.problem if problem else "the journal is written again; nothing was lost")
            self._journal_problem = problem

    # States ----------------------------------------------------------------------------------------------------------

    def advance(self) -> None:
        """Take all steps that the samples so far complete."""
        self._estimate(self.estimator.advance)
        for line in self.estimator.messages:
            self.remarks.add(line)
        self.estimator.messages.clear()
        self._take_out_clocks()
        self._test_innovations()
        if self.followed.is_due(time_s := self.estimator.time_s) and time_s is not None:
            alpha = (
                math.nan
                if self.arrivals.latest_frame is None
                else self.arrivals.latest_frame.values.get("alpha_deg", math.nan)
            )
            self.followed.add_estimates(time_s, alpha, self.estimator.estimates())
        if self.ahead.due(self.estimator.time_s):
            self._look_ahead()

    def _estimate(self, work: Callable[[], object]) -> None:
        """Let the estimator work; an error is a remark, and the link goes on."""
        try:
            work()
        except (InputError, RunError, OSError) as error:
            self.remarks.add(f"estimate: {str(error).splitlines()[0]}")

    def _look_ahead(self) -> None:
        self.ahead.take(self.arrivals.latest_frame)
        if self.ahead.problem:
            self.remarks.add(self.ahead.problem)
            self.ahead.problem = ""

    def _take_out_clocks(self) -> None:
        """Take sensors whose own clock went back for failed ones."""
        for point, sensor, since_s, why in self.estimator.failed_clocks:
            if not self.checks.has_failed(point, sensor):
                self.checks.take_out(Failure(point, sensor, since_s, since_s, why, since_s))
                self.test.leave_out(point, sensor)
        self.estimator.failed_clocks.clear()

    def _test_innovations(self) -> None:
        """Check the sensors and test the model with the readings that no late sample can change any more."""
        innovations = self.estimator.innovations()
        self.followed.add_readings(innovations)
        for read in innovations:
            undecided = len(self.checks.undecided)
            failure = self.checks.take(read, self.test.alarm is not None)
            if len(self.checks.undecided) > undecided:
                self.remarks.add(self._present.undecided())
            if failure is not None:
                self.estimator.leave_out(failure.point, failure.sensor, failure.from_s, failure.wrong_s)
                self.test.leave_out(failure.point, failure.sensor)
                self.remarks.add(removed_sensor(failure).text)
            elif read.is_left_out:
                self.remarks.add(_left_out(read))
            elif not self.checks.has_failed(read.point, read.sensor):
                score = score_of_word(read.innovation_K, read.variance_K2, read.predicted_variance_K2)
                self.test.take(read.time_s, read.point, read.sensor, score)

    def end(self) -> None:
        """No more messages come."""
        self.advance()
        self._estimate(self._filter_again)
        self._look_ahead()  # from the last estimate, which depends on the samples alone
        self._present.phase = "ended"

    def weigh(self) -> bool:
        """Have the candidates of an alarm weighed in another process, when due; whether that is at work."""
        self._poll_weighing()
        alarm, now_s = self.test.alarm, self.estimator.time_s
        if alarm is None or now_s is None or self.journal is None:
            return False
        since_s = now_s - alarm.time_s
        if self.weighing.is_due(since_s):
            # whether a sensor drifts or the model lacks something, close-loop weighs itself
            left_out = [f.sensor for f in self.checks.failures if f.point == alarm.point and not f.drifts]
            self.weighing.weighed_from(since_s)
            start = partial(self.weighing.start, self.journal.path, alarm.point, left_out, root=self.link.root)
            self._estimate(start)
        return self.weighing.busy

    def _filter_again(self) -> None:
        """Linearise as a fit of the whole record would be, and take back what failing sensors read."""
        if not self.estimator.filter_again() and self.checks.failures:
            self.remarks.add("the clock jumped: what sensors read before they were taken out stays in the estimate")

    def _poll_weighing(self) -> None:
        """Take what was found; a process that died is a remark."""
        deaths = self.weighing.deaths
        self.weighing.poll()
        if self.weighing.deaths > deaths:
            self.remarks.add("the process that weighs candidates died; the link goes on")

    def stop(self) -> None:
        """End the process that weighs candidates, where there is one."""
        self.weighing.stop()

    def state(self) -> State:
        """The state now; states are numbered."""
        self._poll_weighing()
        if self.test.alarm is not None and self._present.phase != "ended":
            self.weigh()
        return self._present.state()

    def last_state(self) -> State:
        """The last state with the health of the link now; for another thread while the engine is at work."""
        return self._present.last_state()

    def link_state(self, now_s: float) -> LinkState:
        """Health of the link at a time of the monotonic clock [s]."""
        return self._present.link_state(now_s)


def _still_frame(link: Link) -> dict[str, float]:
    """Conditions to prepare with: those in the middle of a record, or of an entry."""
    if link.vehicle is None:
        flown = next(iter(link.records.values())).conditions
        return {name: float(flown[name][len(flown[name]) // 2]) for name in link.columns if name in flown}
    entry = {"altitude_m": 70e3, "velocity_m_s": 6500.0, "alpha_deg": 40.0, "rho_kg_m3": 8e-5}
    return {name: entry.get(name, 0.0) for name in link.columns}


def _limits(link: Link, point: str) -> dict[str, float]:
    """Temperature limits of a control point [K]; none of one that a record declares."""
    if link.vehicle is None:
        return {}
    declared = link.vehicle.control_point(point).limits
    limits = {"surface_K": declared.surface_K, "bondline_K": declared.bondline_K}
    return {name: limit for name, limit in limits.items() if limit is not None}


def _left_out(read: Innovation) -> str:
    away = f"{abs(read.innovation_K):.0f} K from the prediction"
    return f"{read.point}: 1 reading of {read.sensor} at {read.time_s:.1f} s left out: {away}"
