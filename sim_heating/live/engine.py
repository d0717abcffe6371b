"""The engine of a link, without its network: messages in, states out.

    message -> journal -> mapping -> estimator -> checks, test of the innovations, look-ahead -> state

A message is in the journal before anything is made of it. The estimate is a function of the samples in the order of
their times, so that an engine that takes the messages of a journal again comes to the same numbers.
"""

from __future__ import annotations

import time
from collections import Counter, deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

from sim_heating.base.errors import InputError, RunError, one_line
from sim_heating.heating.atmosphere import free_stream_kernel
from sim_heating.live.journal import Journal, read_journal
from sim_heating.live.mapping import FieldMapping
from sim_heating.live.sources import decoder_of
from sim_heating.live.sources.decoder import message_of
from sim_heating.live.spec import Link
from sim_heating.live.state import (
    STALLED_S,
    LinkPhase,
    LinkState,
    MissingState,
    PointState,
    RemovedSensor,
    SensorState,
    State,
)
from sim_heating.live.types import Frame, Message, Reading, Sample

RATE_OVER_S = 5.0
"""Time over which rates are counted [s]."""
IN_A_ROW = 256
"""Messages that are taken before the estimator steps on and others may run."""
REMARKS = 12
"""Remarks that a state shows; all of them are in the summary."""
KEPT_REMARKS = 10_000
"""Remarks that are kept for the summary."""


class Estimator(Protocol):
    """What the engine asks of the estimator of all control points."""

    def add(self, *samples: Sample) -> None:
        """Take samples in any order."""

    def advance(self) -> None:
        """Take all steps that the samples complete."""


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
        for known in list(self._lines)[-REMARKS:]:
            if known[0] == line:
                known[1] += 1
                return
        self._lines.append([line, 1])

    def lines(self, last: int | None = None) -> list[str]:
        """The lines, oldest first."""
        chosen = list(self._lines) if last is None else list(self._lines)[-last:]
        return [line if count == 1 else f"{line} ({count} times)" for line, count in chosen]


def make_engine(link: Link, journal: Journal | None = None) -> LinkEngine:
    """The engine of a link with the estimator that its file declares."""
    return LinkEngine(link, None, journal)


class LinkEngine:
    """The engine of one link.

    link      : with its control points
    estimator : of all control points; None: what comes is kept and counted, and nothing is estimated
    journal   : that messages are kept in; None for none
    """

    def __init__(self, link: Link, estimator: Estimator | None = None, journal: Journal | None = None) -> None:
        self.link, self.estimator, self.journal = link, estimator, journal
        self.mapping = FieldMapping(link)
        self.remarks = Remarks()
        self.counts: Counter[str] = Counter()
        self._started_s = time.monotonic()
        self._last_message_s: float | None = None
        self._frames, self._readings = Rate(), Rate()
        self._latest_frame: Frame | None = None
        self._latest: dict[tuple[str, str], Reading] = {}
        self._sequence = 0
        self._named_absent = False
        self._journal_problem = ""
        self._phase: LinkPhase = "waiting"

    # Messages --------------------------------------------------------------------------------------------------------

    def take(self, message: Message, source: int = 0) -> None:
        """Keep a message, and give its samples to the estimator.

        source : number of its source in the link
        """
        if self.journal is not None:
            self.journal.append(message.body, source)
            self._tell_journal()
        self.give(message)

    def give(self, message: Message) -> None:
        """Give the samples of a message that is kept already to the estimator."""
        self._last_message_s = message.arrived_s
        self.counts["messages"] += 1
        if not message.values and not message.damaged:  # labels
            return
        try:
            samples = self.mapping.apply(message, self._damaged_part)
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
        if self.estimator is not None and samples:
            self.estimator.add(*samples)

    def resume(self, path: Any) -> dict[int, int]:
        """Take the messages of a journal that was cut off again, without writing them.

        path    : of the journal
        returns : number of bodies by source
        """
        decoders = [decoder_of(self.link, source) for source in self.link.declared.source]
        taken: Counter[int] = Counter()
        for entry in read_journal(path):
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
        if self.estimator is None:
            return
        try:
            self.estimator.advance()
        except (InputError, RunError) as error:
            self.remarks.add(f"estimate: {str(error).splitlines()[0]}")

    def end(self) -> None:
        """No more messages come."""
        self.advance()
        self._phase = "ended"

    def state(self) -> State:
        """The state now; states are numbered."""
        now = time.monotonic()
        self._sequence += 1
        return State(
            sequence=self._sequence - 1,
            time_s=None if self._latest_frame is None else self._latest_frame.time_s,
            wall_s=now - self._started_s,
            conditions=self._conditions(),
            points=dict(self._points()),
            link=self.link_state(now),
            removed=self._removed(),
            missing=self._missing(),
        )

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
        return {}

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
        return iter(())

    def _sensor_states(self, point: str) -> dict[str, SensorState]:
        found = {}
        for sensor in next(p.sensors for p in self.link.points if p.name == point):
            latest = self._latest.get((point, sensor.name))
            if latest is not None:
                found[sensor.name] = SensorState(latest.value_K, latest.time_s)
        return found

    def _removed(self) -> Sequence[RemovedSensor]:
        return ()

    def _missing(self) -> MissingState:
        return MissingState()
