"""The engine of a link, without its network: messages in, states out.

    message -> journal -> mapping -> estimator -> checks, test of the innovations, look-ahead -> state

A message is in the journal before anything is made of it. The estimate is a function of the samples in the order of
their times, so that an engine that takes the messages of a journal again comes to the same numbers.
"""

from __future__ import annotations

import math
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import islice
from typing import Any

from sim_heating.base.errors import InputError, RunError, error_context, one_line
from sim_heating.base.files import display_path, suggestion
from sim_heating.base.parameters import CLOCK_SKEW, SENSOR, SENSOR_PREFIX
from sim_heating.estimation.filter.online import Prior
from sim_heating.estimation.inference.observability import default_names, heating_names
from sim_heating.heating.atmosphere import free_stream_kernel
from sim_heating.live.ahead.look_ahead import AheadOfLink
from sim_heating.live.filtering.estimates import Innovation, LiveEstimate, LiveOptions
from sim_heating.live.filtering.estimator import LiveEstimator
from sim_heating.live.filtering.parameters import check_estimated
from sim_heating.live.filtering.plausible import FrameRemarks
from sim_heating.live.filtering.points import ConditionsOfFrame, LivePoint, RecordPoints, VehiclePoints
from sim_heating.live.recording.journal import Journal, read_journal
from sim_heating.live.results.followed import Followed
from sim_heating.live.sources import decoder_of
from sim_heating.live.sources.decoder import message_of
from sim_heating.live.sources.mapping import FieldMapping, clock_skew_s
from sim_heating.live.spec import Link
from sim_heating.live.state import (
    STALLED_S,
    LinkPhase,
    LinkState,
    MissingState,
    ParameterState,
    PointState,
    RemovedSensor,
    SensorState,
    State,
)
from sim_heating.live.types import Frame, Message, Reading, Sample, too_long
from sim_heating.live.watch.checks import Failure, SensorChecks
from sim_heating.live.watch.missing import Weighing
from sim_heating.live.watch.sequential import SequentialTest, score_of_word
from sim_heating.thermal.stack import Sensor

RATE_OVER_S = 5.0
"""Time over which rates are counted [s]."""
IN_A_ROW = 256
"""Messages that are taken before the estimator steps on and others may run."""
PREPARED_S = 6
"""Flight that is taken beforehand, a second beyond the wait for late samples and first readings [s]."""
HOT_K = 400.0
"""Reading of it: warmer than a wall declares, so that a start from readings is computed, too [K]."""
REMARKS = 12
"""Remarks that a state shows; all of them are in the summary."""
KEPT_REMARKS = 10_000
"""Remarks that are kept for the summary."""


@dataclass
class Rate:
    """Events a second over the last seconds."""

    over_s: float = RATE_OVER_S
    _times: deque[float] = field(default_factory=deque)

    def count(self, now_s: float, events: int = 1) -> None:
        """Enter events at a time [s]."""
        self._times.extend([now_s] * events)

    def per_s(self, now_s: float) -> float:
        """Rate at a time [1/s]."""
        while self._times and self._times[0] < now_s - self.over_s:
            self._times.popleft()
        if len(self._times) < 2:
            return 0.0
        span = max(now_s - self._times[0], 1e-3)
        return len(self._times) / min(max(span, 0.1), self.over_s)


class Remarks:
    """Lines on the link, each once in a row with the number of times."""

    def __init__(self) -> None:
        self._lines: deque[list[Any]] = deque(maxlen=KEPT_REMARKS)

    def add(self, line: str) -> None:
        """Add a line; one like the last is counted."""
        line = one_line(line)
        for known in islice(reversed(self._lines), REMARKS):
            if known[0] == line:
                known[1] += 1
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
        own, skew_s = link.declared.estimate, clock_skew_s(link)
        if not -own.jump_s < skew_s < own.lateness_s:
            raise InputError(
                f"`{CLOCK_SKEW.name}` = {skew_s:g} s: readings would belong outside the window in which samples are "
                f"waited for, from {-own.jump_s:g} to {own.lateness_s:g} s; raise `lateness_s` or `jump_s`"
            )
        check_estimated({p.name: p.sensors for p in link.points}, names)


def make_estimator(link: Link) -> LiveEstimator:
    """The estimator that a link file declares.

    raises : InputError for a parameter that a running estimate cannot have
    """
    check_estimate(link)
    own, names = link.declared.estimate, parameters_of(link)
    priors = {name: Prior(mean, sigma) for name, (mean, sigma) in own.prior.items()}
    with error_context(f"{display_path(link.path)}, [estimate]"):
        options = LiveOptions(
            lateness_s=own.lateness_s, jump_s=own.jump_s, linearise_s=own.linearise_s, start=own.start,
            ratio_noise=(own.wander, own.wander_s) if own.wander > 0.0 else None, corrects_mesh=own.corrects_mesh,
        )  # fmt: skip
        points: ConditionsOfFrame
        fixed = {name: value for name, value in own.fix.items() if name != CLOCK_SKEW.name}
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
        self.mapping = FieldMapping(link)
        self._unusual = FrameRemarks(display_path(link.path))
        self.remarks = Remarks()
        for line in [] if journal is None else journal.told:
            self.remarks.add(line)
        self.counts: Counter[str] = Counter()
        self._started_s = time.monotonic()
        self._last_message_s: float | None = None
        self._frames, self._readings = Rate(), Rate()
        self._latest_frame: Frame | None = None
        self._latest: dict[tuple[str, str], Reading] = {}
        sensors = {(p.name, s.name): s for p in link.points for s in p.sensors}
        self.checks = SensorChecks(sensors, link.declared.estimate.lateness_s)
        self.test = SequentialTest(link.declared.missing.false_alarms_per_hour)
        self.weighing = Weighing()
        self.followed = Followed()
        self._sequence = 0
        self._last = State(0, None, 0.0)
        self._limits = {name: _limits(link, name) for name in link.names}
        self.ahead = AheadOfLink(link, self.estimator, self._limits)
        names = parameters_of(link)
        self._units = {(p.name, name): _unit(p, name) for p in self.estimator.points for name in names}
        self._named_absent = False
        self._journal_problem = ""
        self._phase: LinkPhase = "waiting"

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
        return self._latest_frame is not None and self.followed.is_due(self._latest_frame.time_s)

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
        self._last_message_s = message.arrived_s
        if self.journal is not None and too_long(message.body) is None:
            self.journal.append(message.body, source)
            self._tell_journal()

    def give(self, message: Message) -> None:
        """Give the samples of a message that is kept already to the estimator."""
        self.counts["messages"] += 1
        if not message.values and not message.damaged:  # labels
            return
        try:
            samples = self.mapping.apply(message, self._damaged_part)
            for line in self.mapping.take_notes():
                self.remarks.add(line)
        except InputError as error:
            self.counts["damaged"] += 1
            self.remarks.add(f"damaged: {error.problems[0]}")
            return
        if not self._named_absent and (absent := self.mapping.never_sent()):
            self._named_absent = True
            for line in absent:
                self.remarks.add(line)
        for sample in samples:
            self._note(sample, message.arrived_s)
        jumps = self.estimator.counts.jumps
        self.estimator.add(*samples)
        if self.estimator.counts.jumps != jumps:  # what is newest is so by the new clock
            self._latest_frame = self.estimator.timeline.frames[-1]
            self._latest.clear()

    def resume(self, path: Any, most: int) -> dict[int, int]:
        """Take the messages of a journal that was cut off again, without writing them.

        path    : of the journal
        most    : number of messages that it had; what comes now is behind them
        returns : number of bodies by source
        """
        decoders = [decoder_of(self.link, source) for source in self.link.declared.source]
        taken: Counter[int] = Counter()
        for entry in islice(read_journal(path), most):
            taken[entry.source] += 1
            message = message_of(decoders[entry.source], entry.body, time.monotonic())
            if message is not None:
                self.give(message)
            if sum(taken.values()) % IN_A_ROW == 0:
                self.advance()
        self.advance()
        if taken:
            self.remarks.add(f"goes on from a journal of {sum(taken.values())} messages")
        return dict(taken)

    def _damaged_part(self, line: str) -> None:
        self.counts["damaged"] += 1
        self.remarks.add(f"damaged: {line}")

    def _tell_journal(self) -> None:
        assert self.journal is not None
        problem = self.journal.problem.partition(";")[0]
        if problem != self._journal_problem:
            self.remarks.add(self.journal.problem if problem else "the journal is written again; nothing was lost")
            self._journal_problem = problem

    def _note(self, sample: Sample, arrived_s: float) -> None:
        if isinstance(sample, Frame):
            self._frames.count(arrived_s)
            self.counts["frames"] += 1
            for line in self._unusual.add(sample):
                self.remarks.add(line)
            if self._latest_frame is None or sample.time_s >= self._latest_frame.time_s:
                self._latest_frame = sample
            return
        self._readings.count(arrived_s)
        self.counts["readings"] += 1
        if sample.value_K != sample.value_K:
            self.counts["lost"] += 1
            return
        before = self._latest.get((sample.point, sample.sensor))
        if before is None or sample.time_s >= before.time_s:
            self._latest[sample.point, sample.sensor] = sample

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
            alpha = math.nan if self._latest_frame is None else self._latest_frame.values.get("alpha_deg", math.nan)
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
        self.ahead.take(self._latest_frame)
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
        found = self.estimator.innovations()
        self.followed.add_readings(found)
        for read in found:
            known = len(self.checks.undecided)
            failure = self.checks.take(read, self.test.alarm is not None)
            if len(self.checks.undecided) > known:
                self.remarks.add(self._undecided())
            if failure is not None:
                self.estimator.leave_out(failure.point, failure.sensor, failure.from_s, failure.wrong_s)
                self.test.leave_out(failure.point, failure.sensor)
                self.remarks.add(_removed(failure).text)
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
        self._phase = "ended"

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
        now = time.monotonic()
        self._sequence += 1
        self._last = State(
            sequence=self._sequence - 1,
            time_s=self.estimator.time_s,
            wall_s=now - self._started_s,
            conditions=self._conditions(),
            points=dict(self._points()),
            link=self.link_state(now),
            removed=self._removed(),
            missing=self._missing(),
        )
        return self._last

    def last_state(self) -> State:
        """The last state with the health of the link now; for another thread while the engine is at work."""
        now = time.monotonic()
        self._sequence += 1
        self._last = replace(
            self._last, sequence=self._sequence - 1, wall_s=now - self._started_s, link=self.link_state(now)
        )
        return self._last

    def link_state(self, now_s: float) -> LinkState:
        """Health of the link at a time of the monotonic clock [s]."""
        since = 0.0 if self._last_message_s is None else max(now_s - self._last_message_s, 0.0)
        phase: LinkPhase = self._phase
        if phase != "ended":
            phase = "waiting" if self._last_message_s is None else "stalled" if since > STALLED_S else "live"
        own = self.counts
        return LinkState(
            state=phase,
            since_s=since if self._last_message_s is not None else now_s - self._started_s,
            frames_Hz=self._frames.per_s(now_s),
            readings_Hz=self._readings.per_s(now_s),
            damaged=own["damaged"],
            lost=own["lost"],
            messages=self.remarks.lines(REMARKS),
            **self._timeline_counts(),
        )

    def _timeline_counts(self) -> dict[str, Any]:
        """Counts of the estimator: late, too_late, doubled, jumps, and the largest lateness [s]."""
        own = self.estimator.counts
        return {name: getattr(own, name) for name in ("late", "too_late", "doubled", "jumps", "lateness_s")}

    def _conditions(self) -> Mapping[str, float]:
        frame = self._latest_frame
        if frame is None:
            return {}
        found = dict(frame.values)
        vehicle = self.link.vehicle
        if vehicle is not None:
            z, V, rho = (found[n] for n in ("altitude_m", "velocity_m_s", "rho_kg_m3"))
            names = ("T_inf_K", "p_inf_Pa", "mach", "log10_re")
            found |= dict(zip(names, free_stream_kernel(z, V, rho, vehicle.reference_length_m), strict=True))
            found["qbar_Pa"] = 0.5 * rho * V * V
        return found

    def _points(self) -> Iterator[tuple[str, PointState]]:
        for name, estimate in self.estimator.estimates().items():
            state = estimate.state
            limits = self._limits[name]
            now = {"surface_K": estimate.surface_K, "bondline_K": estimate.bondline_K}
            yield (
                name,
                PointState(
                    surface_K=estimate.surface_K,
                    bondline_K=estimate.bondline_K,
                    surface_sigma_K=estimate.surface_sigma_K,
                    bondline_sigma_K=estimate.bondline_sigma_K,
                    ratio=state.ratio,
                    ratio_declared=state.ratio_declared,
                    ratio_sigma=state.ratio_sigma,
                    sensors=self._sensor_states(name, estimate),
                    parameters={
                        p: ParameterState(value, sigma, self._units[name, p])
                        for p, (value, sigma) in estimate.parameters.items()
                    },
                    limits=limits,
                    margin_K=min((limit - now[what] for what, limit in limits.items()), default=None),
                    ahead=self.ahead.of(name).futures,
                    knock_off=self.ahead.of(name).knock_off,
                    knock_off_by_s=self.ahead.of(name).knock_off_by_s,
                ),
            )

    def _sensor_states(self, point: str, estimate: LiveEstimate) -> dict[str, SensorState]:
        found = {}
        for sensor in next(p.sensors for p in self.link.points if p.name == point):
            latest = self._latest.get((point, sensor.name))
            expected = estimate.sensors.get(sensor.name)
            found[sensor.name] = SensorState(
                None if latest is None else latest.value_K,
                None if latest is None else latest.time_s,
                None if expected is None else expected.predicted_K,
                None if expected is None else expected.sigma_K,
                not (why := self._why_out(point, sensor)),
                why,
            )
        return found

    def _why_out(self, point: str, sensor: Sensor) -> str:
        """Why a sensor does not update the estimate; "" where it does."""
        if not sensor.used:
            return "held back by its declaration"
        return next((f.why for f in self.checks.failures if (f.point, f.sensor) == (point, sensor.name)), "")

    def _removed(self) -> Sequence[RemovedSensor]:
        return [_removed(failure) for failure in self.checks.failures]

    def _undecided(self) -> str:
        """Which sensors look as if they failed, or as if the model were wrong, in one line; "" for none."""
        found = [f"{sensor} at {point} ({why})" for (point, sensor), why in self.checks.undecided.items()]
        if not found:
            return ""
        fails = "fails" if len(found) == 1 else "fail"
        return f"undecided whether {' and '.join(found)} {fails}, or the model lacks something there; still used"

    def _missing(self) -> MissingState:
        self._poll_weighing()
        alarm, found = self.test.alarm, self.weighing.last
        text = "no sign of a missing effect"
        if alarm is not None:
            text = alarm.text
            if self._phase != "ended":
                self.weigh()
            if undecided := self._undecided():
                text = f"{text}; {undecided}"
            if found is not None:
                when = f"on the record up to {found.until_s:.0f} s: " if found.finding else ""
                text = f"{text}; {when}{found.text}"
                text += f"; weighed again: {self.weighing.problem}" if self.weighing.problem else ""
                text += "; being weighed again" if self.weighing.busy else ""
            elif self.weighing.busy:
                text = f"{text}; candidates are being weighed"
            elif self._phase == "ended":
                text = f"{text}; no candidate was weighed before the end: `close-loop` weighs them on the record"
        return MissingState(
            alarm=alarm is not None,
            statistic=self.test.statistic,
            threshold=self.test.threshold,
            false_alarms_per_hour=self.test.false_alarms_per_hour,
            candidates=() if found is None else found.candidates,
            text=text,
        )


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
    own = link.vehicle.control_point(point).limits
    given = {"surface_K": own.surface_K, "bondline_K": own.bondline_K}
    return {name: limit for name, limit in given.items() if limit is not None}


def _left_out(read: Innovation) -> str:
    away = f"{abs(read.innovation_K):.0f} K from the prediction"
    return f"{read.point}: 1 reading of {read.sensor} at {read.time_s:.1f} s left out: {away}"


def _removed(failure: Failure) -> RemovedSensor:
    kept = f"; what it read from {failure.wrong_s:.1f} s on is taken back when the link ends"
    if failure.wrong_s >= failure.from_s:
        kept = ""
    return RemovedSensor(failure.point, failure.sensor, failure.from_s, failure.why + kept)


def _unit(point: LivePoint, name: str) -> str:
    """Unit of a parameter of a control point, or of one of its sensors."""
    if name == CLOCK_SKEW.name:
        return CLOCK_SKEW.unit
    if name.startswith(SENSOR_PREFIX):
        return SENSOR[name.rpartition(".")[2]].unit
    return point.model.definition(name).unit
