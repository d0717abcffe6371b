"""What has come in over a link: samples of its messages, how many and how often, and the latest of each."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass, field

from sim_heating.base.errors import InputError
from sim_heating.base.files import display_path
from sim_heating.live.filtering.plausible import FrameRemarks
from sim_heating.live.sources.mapping import FieldMapping
from sim_heating.live.spec import Link
from sim_heating.live.types import Frame, Message, Reading, Sample

RATE_OVER_S = 5.0
"""Time over which rates are counted [s]."""


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


class Arrivals:
    """Samples of the messages of a link, with what is counted of them.

    remark : takes a line on what is damaged or unusual

    counts         : messages, frames, readings, and what was damaged or lost
    last_message_s : when the last message came, by the monotonic clock [s]; None before the first
    frames, readings     : how often they come
    latest_frame, latest : the newest frame, and the newest reading of each sensor by point and name
    """

    def __init__(self, link: Link, remark: Callable[[str], None]) -> None:
        self._mapping, self._remark = FieldMapping(link), remark
        self._unusual = FrameRemarks(display_path(link.path))
        self.counts: Counter[str] = Counter()
        self.last_message_s: float | None = None
        self.frames, self.readings = Rate(), Rate()
        self.latest_frame: Frame | None = None
        self.latest: dict[tuple[str, str], Reading] = {}
        self._has_told_absent = False

    def samples(self, message: Message) -> list[Sample]:
        """Samples of a message; none of a damaged one, which is reported."""
        self.counts["messages"] += 1
        if not message.values and not message.damaged:  # labels
            return []
        try:
            samples = list(self._mapping.apply(message, self._tell_damaged))
            for line in self._mapping.take_notes():
                self._remark(line)
        except InputError as error:
            self._tell_damaged(error.problems[0])
            return []
        if not self._has_told_absent and (absent := self._mapping.never_sent()):
            self._has_told_absent = True
            for line in absent:
                self._remark(line)
        for sample in samples:
            if isinstance(sample, Frame):
                self._note_frame(sample, message.arrived_s)
            else:
                self._note_reading(sample, message.arrived_s)
        return samples

    @property
    def has_model_density(self) -> bool:
        """Whether the density of frames is that of the standard atmosphere."""
        return self._mapping.has_model_density

    def follow_clock(self, frame: Frame) -> None:
        """Take a frame for the latest, and no reading, as the clock jumped to it."""
        self.latest_frame = frame
        self.latest.clear()

    def _tell_damaged(self, line: str) -> None:
        self.counts["damaged"] += 1
        self._remark(f"damaged: {line}")

    def _note_frame(self, frame: Frame, arrived_s: float) -> None:
        self.frames.count(arrived_s)
        self.counts["frames"] += 1
        for line in self._unusual.add(frame):
            self._remark(line)
        if self.latest_frame is None or frame.time_s >= self.latest_frame.time_s:
            self.latest_frame = frame

    def _note_reading(self, reading: Reading, arrived_s: float) -> None:
        self.readings.count(arrived_s)
        self.counts["readings"] += 1
        if reading.value_K != reading.value_K:
            self.counts["lost"] += 1
            return
        before = self.latest.get((reading.point, reading.sensor))
        if before is None or reading.time_s >= before.time_s:
            self.latest[reading.point, reading.sensor] = reading
