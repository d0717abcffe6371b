"""Judgement of clocks: which samples are in order, late, or on another clock."""

from __future__ import annotations

from collections.abc import Sequence

from sim_heating.live.filtering.estimates import Notices
from sim_heating.live.filtering.timeline import CONFIRMED_BY, Jump, Placed, Repeated, Timeline
from sim_heating.live.types import Reading, Sample

BRIDGED_S = 60.0
"""Longest time without frames [s] that is bridged; after a longer one the state is taken over as it was."""
CONFIRMED_WORDS = 2
"""Readings of a sensor that have to come again with other values before its clock has gone back."""


class ClockJudge:
    """Puts samples in order, and judges the clocks that they were stamped with.

    timeline     : samples in order
    sensor_names : point and name of each sensor, by its number
    notices      : messages to the user

    failed : point, sensor, time from which on [s] and reason of each sensor whose own clock went back
    """

    def __init__(self, timeline: Timeline, sensor_names: Sequence[tuple[str, str]], notices: Notices) -> None:
        self.timeline, self._sensor_names, self._notices = timeline, sensor_names, notices
        self.failed: list[tuple[str, str, float, str]] = []
        self._left_out: set[int] = set()
        self._has_told_conflict = False

    def put(self, sample: Sample) -> Placed:
        """Put a sample where it belongs; what became of it. A conflict is reported once."""
        placed = self.timeline.put(sample)
        conflict_s = self.timeline.conflict_s
        if placed is Placed.DOUBLED and conflict_s is not None and not self._has_told_conflict:
            self._has_told_conflict = True
            self._notices.tell(
                f"samples came again with other values, first at {conflict_s:g} s: a clock that went back, or two "
                "sources of one quantity; the first ones are used"
            )
        return placed

    def put_in_order(self, samples: Sequence[Sample], first: int, now_s: float) -> Sequence[Reading]:
        """Take readings, from number `first` of the samples on, that are in order and behind the last step; these.

        now_s : end of the last step [s]
        """
        last = first + 1
        while last < len(samples) and isinstance(samples[last], Reading):
            last += 1
        readings: Sequence[Reading] = samples[first:last]  # type: ignore[assignment]
        return readings[: self.timeline.put_readings(readings, now_s)]

    def tell_late(self, lateness_s: float) -> None:
        """Report which sensors come late after they had come in time; not of one that is left out for its clock.

        lateness_s : how late a sample may come and still be used [s]
        """
        for number, since_s, is_too_late in self.timeline.late_sensors:
            point, sensor = self._sensor_names[number]
            if number in self._left_out:
                continue
            late_s = lateness_s * (1.0 if is_too_late else 0.5)
            use = "are not used" if is_too_late else "are used by their times"
            self._notices.tell(
                f"{point}: readings of {sensor} after {since_s:g} s come more than {late_s:g} s late, one after the "
                f"other, and {use}: its clock went back, or it is sent late"
            )
        self.timeline.late_sensors.clear()

    def is_bridged(self, jump: Jump) -> bool:
        """Whether a jump of the clock is bridged as a gap, since it is a little ahead; reports it."""
        between = f"from {jump.from_s:g} to {jump.to_s:g} s"
        if 0.0 < jump.by_s <= BRIDGED_S:
            self._notices.tell(
                f"the clock jumped ahead {between}: the conditions did not go on as long; bridged as a gap"
                if jump.is_gap is False
                else f"no frames {between}: a gap{'' if jump.is_gap else ' or a jump of the clock'}; bridged"
            )
            return True
        way = "back" if jump.by_s < 0.0 else "ahead"
        self._notices.tell(
            f"the clock jumped {way} {between}; the state is taken over as it was, "
            "readings on the old clock are not used"
        )
        return False

    def ended_repetition(self) -> Repeated | None:
        """The times that came again, once they have ended; None before. Reports that they come again."""
        timeline = self.timeline
        now, ended = timeline.repeated, timeline.repeated_until_now()
        if ended is None:
            if timeline.is_two_sources:
                self._notices.tell("samples go on coming again with other values: two sources of one quantity")
            elif now is not None and now.samples >= CONFIRMED_BY and not self._has_told_conflict:
                self._has_told_conflict = True
                self._notices.tell(
                    f"samples come for times from {now.first_s:g} s on that have come already: a clock that went back, "
                    "or two sources of one quantity; which of them is told once that has ended"
                )
        elif ended.samples >= CONFIRMED_BY:  # the next such event is reported again
            self._has_told_conflict, timeline.conflict_s = False, None
        return ended

    def went_back(self, ended: Repeated) -> bool:
        """Whether the clock of all samples went back by the times that came again."""
        return ended.samples >= CONFIRMED_BY and self.timeline.is_of_frames(ended)

    def go_back(self, ended: Repeated) -> Jump:
        """Go over to a clock that went back by little; the jump."""
        jump = self.timeline.go_back(ended)
        self._notices.tell(
            f"the clock went back by about {-jump.by_s:.3g} s, from {jump.from_s:g} to {jump.to_s:g} s: samples came "
            f"again with other values; what came for {ended.first_s:g} to {ended.last_s:g} s is not used, and bridged"
        )
        return jump

    def take_failed(self, ended: Repeated) -> list[tuple[str, str]]:
        """Point and name of the sensors whose own clock went back by the times that came again, each of them once."""
        failed = []
        for number, count in ended.by_sensor.items():
            if count < CONFIRMED_WORDS or number in self._left_out:
                continue
            self._left_out.add(number)
            point, sensor = self._sensor_names[number]
            why = f"its clock went back: readings from {ended.first_s:g} s on came again with other values"
            self.failed.append((point, sensor, ended.first_s, why))
            self._notices.tell(f"{point}: {sensor}: {why}; it is left out")
            failed.append((point, sensor))
        return failed
