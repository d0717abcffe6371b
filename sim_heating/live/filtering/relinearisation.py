"""The flight so far filtered again, linearised about its estimate: what earlier readings said is then said about it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from sim_heating.base.arrays import FloatArray
from sim_heating.base.kernels.block import LANES
from sim_heating.estimation.filter.online import OnlineFilter
from sim_heating.live.filtering.start import Profile
from sim_heating.live.filtering.stepper import Moment, Stepper

STEPS_AT_ONCE = 4
"""Steps of the past that are filtered again with each new one."""
LONGEST_S = 7200.0
"""Longest flight that is kept to be filtered again [s]."""


@dataclass
class SecondPass:
    """Filters that take the flight so far again, linearised about an estimate.

    informed    : number of steps whose readings that estimate has; up to there no other is better to linearise about
    steps_taken : number of steps filtered again;  due : number to filter again before the next step is final
    """

    filters: list[OnlineFilter]
    informed: int
    steps_taken: int = 0
    due: int = 0


class Relinearisation:
    """Filters the steps of the past again about a later estimate, and has those filters take over.

    stepper : whose past it is;  spare : filters of the same points, which take it again
    """

    def __init__(self, stepper: Stepper, spare: list[OnlineFilter]) -> None:
        self._stepper, self._spare = stepper, spare
        self._begun: Moment | None = None
        self._profiles: Sequence[Profile] = []
        self._final = 0
        self._second: SecondPass | None = None

    def begin(self, moment: Moment, profiles: Sequence[Profile]) -> None:
        """Note the moment of the start, and the temperatures of each point there."""
        self._begun, self._profiles = replace(moment, snapshots=()), profiles

    def give_up(self) -> None:
        """Filter nothing again any more."""
        self._stepper.past.give_up()
        self._final, self._second = 0, None

    def follow(self, end: int) -> None:
        """Go on with filtering again, as steps become final: those before number `end` of the past are.

        Steps of the second filters depend on the number of final steps alone, and so does the one at which they take
        over. Those that are due are taken one by one, so that no frame waits for all of them.
        """
        past = self._stepper.past
        if past.begun_s is None:
            return
        if self._second is not None and self._final >= end:
            self._take(self._second, min(self._second.steps_taken + 1, self._second.due))
        while self._final < end:
            self.take_due()
            step = past.steps[self._final]
            self._final += 1
            if step.estimates is not None:
                self._second = self._begin_again(step.estimates, self._final)
            if self._second is not None:
                self._second.due = min(self._second.steps_taken + STEPS_AT_ONCE, self._final)
                if self._second.due == self._final:
                    self.take_due()
                    self._take_over(self._second)
                    return
        if past.steps and past.steps[-1].frame.time_s - past.steps[0].frame.time_s > LONGEST_S:
            self.give_up()

    def take_due(self) -> None:
        """Take the steps that are due now, so that what changes from here on does not reach them."""
        if self._second is not None:
            self._take(self._second, self._second.due)

    def filter_all(self) -> bool:
        """Filter the whole flight so far again about the present estimate, at once; whether there was a past."""
        steps = self._stepper.past.steps
        if self._stepper.now is None or not steps:
            return False
        estimates = tuple(e.values for f in self._stepper.filters for e in f.estimates())
        second = self._begin_again(estimates, len(steps))
        self._take(second, len(steps))
        self._final = len(steps)
        self._take_over(second)
        return True

    def _begin_again(self, estimates: Sequence[FloatArray], informed: int) -> SecondPass:
        assert self._begun is not None
        for k, f in enumerate(self._spare):
            lanes = slice(k * LANES, (k + 1) * LANES)
            profiles, covariances = zip(*self._profiles[lanes], strict=True)
            f.begin(self._begun.time_s, self._begun.vectors[lanes], profiles, covariances, estimates[lanes])
        return SecondPass(self._spare, informed)

    def _take(self, second: SecondPass, end: int) -> None:
        """Take steps of the past with the second filters, up to before number `end`."""
        assert self._begun is not None
        steps, march = self._stepper.past.steps, self._stepper.march.march
        while second.steps_taken < end:
            k = second.steps_taken
            begin_s, before = self._begun.time_s, self._begun.vectors
            if k > 0:
                begin_s, before = steps[k - 1].frame.time_s, steps[k - 1].vectors
            step, is_new = steps[k], k >= second.informed
            march(second.filters, begin_s, before, step.frame.time_s, step.vectors, step.rows, linearise=is_new)
            second.steps_taken += 1

    def _take_over(self, second: SecondPass) -> None:
        """Go on with the second filters from the last step that they took; what came after it is taken again."""
        stepper = self._stepper
        last = stepper.past.steps[second.steps_taken - 1]
        del stepper.past.steps[second.steps_taken :]
        stepper.log.cut(last.logged)
        self._spare, self._second = stepper.take_over(second.filters, last), None
