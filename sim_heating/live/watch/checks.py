"""Sensors that fail while a link runs: stuck, clipped, flickering, or away from their neighbours.

The checks see each reading once, in order of time, when no late sample can change it any more, and compare it with what
the estimator expected. What they decide is a function of the readings alone. A sensor that failed is left out from a
stated time on, a little after the reading that told, so that the decision does not depend on how the readings came.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from sim_heating.live.filtering.estimates import Innovation
from sim_heating.live.watch.sequential import score_of_word
from sim_heating.thermal.stack import Sensor

WINDOW = 60
"""Readings of a sensor that are looked at."""
STUCK_READINGS, STUCK_SIGMAS = 12, 8.0
"""Equal readings in a row from which on a sensor may be stuck; it is where the expected reading moves by a step of the
recorder and this many of its standard deviations, noise included, meanwhile [-]."""
FLICKER_OF, FLICKERS, FLICKER_SIGMAS = 20, 4, 6.0
"""Readings, how many of them may be this many standard deviations off [-], with others that agree in between."""
AGREES_SIGMAS = 3.0
"""Standard deviations within which a reading agrees with what is expected [-]."""
DRIFT_OF, DRIFT_SIGMAS, NEIGHBOUR_SIGMAS, NEIGHBOURS = 40, 9.0, 4.0, 2
"""Readings whose mean is off by so many of its own standard deviations [-], while those of at least so many other
sensors of the point are not off by NEIGHBOUR_SIGMAS."""
FLOOR_SIGMA_K = 0.02
"""Least noise that is assumed of a sensor [K]."""


@dataclass(frozen=True)
class Failure:
    """A sensor that failed.

    found_s : time of the reading that told [s];  from_s : from when on it is left out [s];  why : in one line
    wrong_s : from when on its readings are not trusted, before it was found [s]
    drifts  : whether it is away from its neighbours; what the model lacks can do that too
    """

    point: str
    sensor: str
    found_s: float
    from_s: float
    why: str
    wrong_s: float
    drifts: bool = False


@dataclass
class _Recent:
    """Last readings of a sensor: time [s], reading, expected reading [K], score [-], sigma of the expected one [K]."""

    rows: deque[tuple[float, float, float, float, float]] = field(default_factory=lambda: deque(maxlen=WINDOW))
    equal: int = 0
    least_K: float = math.inf
    most_K: float = -math.inf

    def take(self, row: tuple[float, float, float, float, float]) -> None:
        self.equal = self.equal + 1 if self.rows and self.rows[-1][1] == row[1] else 1
        self.rows.append(row)
        self.least_K, self.most_K = min(self.least_K, row[1]), max(self.most_K, row[1])

    @property
    def scores(self) -> list[float]:
        return [row[3] for row in self.rows]

    def mean_over(self, count: int) -> float | None:
        """Mean of the last scores over its own standard deviation [-]; None before there are so many. No single score
        counts as more than AGREES_SIGMAS: a spike is no drift."""
        last = np.clip(self.scores[-count:], -AGREES_SIGMAS, AGREES_SIGMAS)
        return None if len(last) < count else float(np.sum(last)) / math.sqrt(count)


class SensorChecks:
    """Checks of all sensors of a link, as their readings come.

    sensors : by control point and name;  lateness_s : how late a sample may come [s]
    """

    def __init__(self, sensors: Mapping[tuple[str, str], Sensor], lateness_s: float = 2.0) -> None:
        self.sensors, self.wait_s = dict(sensors), lateness_s + 1.0
        self.failures: list[Failure] = []
        self._recent: dict[tuple[str, str], _Recent] = {}
        self.undecided: dict[tuple[str, str], str] = {}
        self._failed: set[tuple[str, str]] = set()

    def take(self, read: Innovation, model_is_doubted: bool = False) -> Failure | None:
        """Take the next reading; the failure of its sensor, where this reading told it.

        model_is_doubted : whether the model is known not to agree with the readings: what it lacks can take one sensor
                           away from the others, as at the surface, and move what is expected of one that stays. None
                           is taken out for a drift then, nor as stuck where it was away before it stayed; such a one
                           is `undecided`, with the reason, as long as it looks like that
        """
        key = read.point, read.sensor
        if key in self._failed:
            return None
        recent = self._recent.setdefault(key, _Recent())
        score = score_of_word(read.innovation_K, read.variance_K2, read.predicted_variance_K2)
        sigma_K = math.sqrt(read.predicted_variance_K2)
        recent.take((read.time_s, read.read_K, read.predicted_K, score, sigma_K))
        why = self._stuck(key, recent) or self._flickers(recent)
        looked_at, is_drift = recent.equal if recent.equal >= STUCK_READINGS else FLICKER_OF, not why
        if is_drift:
            looked_at, why = DRIFT_OF, self._drifts(key, recent)
        if model_is_doubted and (is_drift or self._was_away(key, recent)):
            self._doubt(key, recent, why)
            return None
        if not why:
            return None
        wrong_s = list(recent.rows)[-looked_at:][0][0]
        from_s = read.time_s + self.wait_s
        self.take_out(Failure(*key, read.time_s, from_s, why, wrong_s, is_drift))
        return self.failures[-1]

    def _was_away(self, key: tuple[str, str], recent: _Recent) -> bool:
        """Whether a sensor that stays was away from what is expected before."""
        if recent.equal < STUCK_READINGS:
            return False
        _, read_K, expected_K, _, sigma_K = list(recent.rows)[-recent.equal :][0]
        return abs(read_K - expected_K) > self.sensors[key].lsb_K + AGREES_SIGMAS * max(FLOOR_SIGMA_K, sigma_K)

    def _doubt(self, key: tuple[str, str], recent: _Recent, why: str) -> None:
        """Note a sensor that looks as if it failed, and forget one that does not any more."""
        if why:
            self.undecided.setdefault(key, why)
        elif key in self.undecided and abs(recent.mean_over(DRIFT_OF) or 0.0) < NEIGHBOUR_SIGMAS:
            del self.undecided[key]

    def take_out(self, failure: Failure) -> None:
        """Enter the failure of a sensor, such as one that is reported elsewhere; it is checked no more."""
        self._failed.add((failure.point, failure.sensor))
        self.undecided.pop((failure.point, failure.sensor), None)
        self.failures.append(failure)

    def has_failed(self, point: str, sensor: str) -> bool:
        """Whether a sensor has failed."""
        return (point, sensor) in self._failed

    def _stuck(self, key: tuple[str, str], recent: _Recent) -> str:
        if recent.equal < STUCK_READINGS:
            return ""
        sensor, run = self.sensors[key], list(recent.rows)[-recent.equal :]
        expected = [row[2] for row in run]
        # while the estimate settles the expected reading moves by as much as it is uncertain
        sigma_K = max(FLOOR_SIGMA_K, *(row[4] for row in run))
        if max(expected) - min(expected) <= sensor.lsb_K + STUCK_SIGMAS * sigma_K:
            return ""
        (since_s, level, *_), away = run[0], expected[-1] - run[-1][1]
        at_end = (level >= recent.most_K and away > 0.0) or (level <= recent.least_K and away < 0.0)
        if at_end and recent.most_K > recent.least_K:
            return f"clips at {level:.1f} K since {since_s:.1f} s, {expected[-1]:.1f} K is expected"
        return f"stuck at {level:.1f} K since {since_s:.1f} s, {expected[-1]:.1f} K is expected"

    def _flickers(self, recent: _Recent) -> str:
        last = recent.scores[-FLICKER_OF:]
        off = [abs(z) > FLICKER_SIGMAS for z in last]
        if len(last) < FLICKER_OF or sum(off) < FLICKERS or not off[-1]:
            return ""
        # steadily off is a drift, or a model that is wrong: a flickering sensor agrees in between
        agrees = [abs(z) < AGREES_SIGMAS for z in last]
        returns = sum(1 for was_off, now in zip(off, agrees[1:], strict=False) if was_off and now)
        if returns < FLICKERS - 1:
            return ""
        return f"flickers: {sum(off)} of its last {FLICKER_OF} readings are more than {FLICKER_SIGMAS:g} sigma off"

    def _drifts(self, key: tuple[str, str], recent: _Recent) -> str:
        drift = recent.mean_over(DRIFT_OF)
        if drift is None or abs(drift) < DRIFT_SIGMAS:
            return ""
        others = [
            r.mean_over(DRIFT_OF) for k, r in self._recent.items() if k[0] == key[0] and k not in {key, *self._failed}
        ]
        agree = [m for m in others if m is not None and abs(m) < NEIGHBOUR_SIGMAS]
        if len(agree) < max(NEIGHBOURS, len(others)):
            return ""
        _, read_K, expected_K, *_ = np.transpose(list(recent.rows)[-DRIFT_OF:])
        by_K = float(np.mean(read_K - expected_K))
        return f"{by_K:+.1f} K away from what it and its neighbours gave before, and they are not"
