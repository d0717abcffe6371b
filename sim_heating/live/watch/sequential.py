"""Sequential test of innovations: whether something is missing in the model, while the readings come.

Each series of innovations is tested against alternatives: a mean that is not 0, innovations that follow one another, a
variance that is too large. With l_n the log likelihood ratio of innovation n against an alternative, and dt_n the time
since the innovation before it, the statistic of Shiryaev and Roberts is

    R_n = (R_(n-1) + dt_n) exp(l_n).

Were the noise white, the expected value of exp(l_n) given all earlier readings would be at most 1 where nothing is
missing, so that R less the time is a supermartingale, and so is a mean R of many series and alternatives. The alarm at
R >= A then has a mean time to the first false alarm of A at least, whatever the rate of the readings (Pollak, Ann.
Statist. 13 (1985) 206; Roberts, Technometrics 8 (1966) 411).

The noise of a recorder may be slightly coloured: a share s of its variance is correlated over a time tau. The
likelihood that nothing is missing is therefore that of a mixture of J colours, COLOURS, which each sensor's own
readings weigh, beginning with equal weights. The likelihood of all readings is at least 1/J of that with any colour of
them, so that the mean time to the first false alarm is A/J at least with each: A is J over the stated rate of false
alarms. What is missing differs from a colour in that it stays, or is larger than the noise.

A recorder word tells an interval. Its score is the expected value of the standard normal innovation within it, for
which exp(l) is smaller still on average (Jensen's inequality, as exp(l) is convex in the innovation).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from sim_heating.base.arrays import FloatArray

MEANS = (0.25, 0.5, 1.0, 2.0, 4.0)
"""Means of the alternatives, to either side, over the standard deviation of an innovation [-]."""
COLOURS = ((0.0, 1.0), (0.1, 2.0), (0.1, 5.0), (0.25, 2.0), (0.25, 5.0))
"""Colours that noise may have: the share of its variance that is correlated [-], and over which time [s]."""
FOLLOWS = (0.25, 0.5)
"""Part of an innovation that the next one keeps, in the alternatives of innovations that follow one another [-]."""
VARIANCES = (2.0, 4.0)
"""Variances of the alternatives over what they ought to be [-]."""
LONGEST_WAIT_S = 60.0
"""Most that a pause between two readings adds to a statistic [s]: during a gap there is nothing to test."""
HOUR_S = 3600.0

_SHIFTS = np.array([sign * m for m in MEANS for sign in (1.0, -1.0)])
_SHARE, _TAU_S = np.array(COLOURS).T
_FOLLOWS, _VARIANCES = np.array(FOLLOWS), np.array(VARIANCES)
_KINDS = np.array(["mean"] * len(_SHIFTS) + ["order"] * len(_FOLLOWS) + ["variance"] * len(_VARIANCES))


@dataclass
class _Noise:
    """Noise of a sensor of unit variance, as a mixture of COLOURS, each followed by its Kalman filter.

    mean, variance : (colour,) of the correlated part, of unit variance, given the readings;  log_w : of the weights
    last_s         : time of the last reading [s]
    """

    mean: FloatArray = field(default_factory=lambda: np.zeros(len(COLOURS)))
    variance: FloatArray = field(default_factory=lambda: np.ones(len(COLOURS)))
    log_w: FloatArray = field(default_factory=lambda: np.full(len(COLOURS), -math.log(len(COLOURS))))
    last_s: float = -math.inf

    def take(self, time_s: float, score: float) -> float:
        """Logarithm of the density of a score as white noise over that as the mixture, given the earlier ones."""
        kept = np.exp(-max(time_s - self.last_s, 0.0) / _TAU_S)  # a clock may go back
        mean, variance = kept * self.mean, 1.0 - kept**2 * (1.0 - self.variance)
        S = _SHARE * variance + (1.0 - _SHARE)
        off = score - np.sqrt(_SHARE) * mean
        log_density = -0.5 * (np.log(S) + off**2 / S)
        joint = self.log_w + log_density
        mixture = float(np.logaddexp.reduce(joint))
        gain = np.sqrt(_SHARE) * variance / S
        self.mean, self.variance = mean + gain * off, variance - gain * np.sqrt(_SHARE) * variance
        self.log_w, self.last_s = joint - mixture, time_s
        return -0.5 * score**2 - mixture


@dataclass
class _Series:
    """Statistics of the innovations of one sensor, or of all sensors of a control point.

    log_R : (alternative,) logarithm of R over an hour;  largest : of them
    last_s, last : time [s] and score of the last innovation
    """

    log_R: FloatArray
    largest: float = -math.inf
    last_s: float = math.nan
    last: float = math.nan

    def take(self, time_s: float, score: float, over_noise: float) -> None:
        waited_s = min(max(time_s - self.last_s, 0.0), LONGEST_WAIT_S) if self.last_s == self.last_s else 0.0
        ratios = np.empty(len(_KINDS))
        n, m = len(_SHIFTS), len(_SHIFTS) + len(_FOLLOWS)
        ratios[:n] = _SHIFTS * score - 0.5 * _SHIFTS**2
        before = _FOLLOWS * (0.0 if self.last != self.last else self.last)
        ratios[n:m] = before * score - 0.5 * before**2
        ratios[m:] = -0.5 * np.log(_VARIANCES) + 0.5 * score**2 * (1.0 - 1.0 / _VARIANCES)
        if waited_s > 0.0:
            self.log_R = np.logaddexp(self.log_R, math.log(waited_s / HOUR_S))
        self.log_R = self.log_R + (ratios + over_noise)
        self.largest = float(np.max(self.log_R))
        self.last_s, self.last = time_s, score


@dataclass(frozen=True)
class Alarm:
    """A sequential test that fired.

    time_s : of the reading with which it fired [s]
    point  : control point with the largest statistic;  sensor : the sensor, "" where all of the point together have it
    kind   : what is wrong with the innovations: "mean", "order" (they follow one another) or "variance"
    """

    time_s: float
    point: str
    sensor: str
    kind: str

    @property
    def text(self) -> str:
        """What the readings show, in one line."""
        where = f"{self.sensor} at {self.point}" if self.sensor else f"the sensors at {self.point}"
        behaviour = {
            "mean": "away from what the model expects",
            "order": "away from what the model expects, one after the other to the same side",
            "variance": "scattered more than their noise",
        }[self.kind]
        return f"since {self.time_s:.1f} s readings of {where} are {behaviour}"


@dataclass
class SequentialTest:
    """Test of the innovations of all sensors of a link, as they come.

    false_alarms_per_hour : stated rate: where nothing is missing the mean time to the first alarm is at least its
                            inverse

    `take` gives it innovations in order of time. `alarm` is the first alarm since the start or `again`, or None.

    >>> import numpy as np
    >>> from sim_heating.live.watch.sequential import SequentialTest
    >>> test = SequentialTest(false_alarms_per_hour=0.01)
    >>> noise = np.random.default_rng(1).normal(size=600)
    >>> for i, z in enumerate(noise + np.where(np.arange(600) < 300, 0.0, 2.5)):
    ...     test.take(0.5 * i, "NOSE", "surface", z)
    >>> 150.0 < test.alarm.time_s < 165.0
    True
    """

    false_alarms_per_hour: float = 0.01
    alarm: Alarm | None = None
    _series: dict[tuple[str, str], _Series] = field(default_factory=dict)
    _noise: dict[tuple[str, str], _Noise] = field(default_factory=dict)

    @property
    def threshold(self) -> float:
        """Logarithm of the time that the statistic has to exceed, in hours."""
        return math.log(len(COLOURS) / self.false_alarms_per_hour)

    @property
    def statistic(self) -> float | None:
        """Logarithm of the mean of all R, in hours; None before the first two readings of a sensor."""
        if not self._series:
            return None
        rows = np.concatenate([s.log_R for s in self._series.values()])
        largest = float(np.max(rows))
        if not math.isfinite(largest):
            return None
        return largest + math.log(float(np.mean(np.exp(rows - largest))))

    def take(self, time_s: float, point: str, sensor: str, score: float) -> None:
        """Take one innovation.

        time_s : of the reading [s]; not before that of the last one
        score  : innovation over its standard deviation [-]; of a recorder word that of `score_of_word`
        """
        over_noise = self._noise.setdefault((point, sensor), _Noise()).take(time_s, score)
        for key in ((point, sensor), (point, "")):
            if key not in self._series:
                self._series[key] = _Series(np.full(len(_KINDS), -np.inf))
            self._series[key].take(time_s, score, over_noise)
        # the mean of all R is no larger than the largest, which is known without going through them
        if self.alarm is None and any(series.largest >= self.threshold for series in self._series.values()):
            statistic = self.statistic
            if statistic is not None and statistic >= self.threshold:
                self.alarm = self._largest(time_s)

    def _largest(self, time_s: float) -> Alarm:
        (point, sensor), series = max(self._series.items(), key=lambda item: item[1].largest)
        return Alarm(time_s, point, sensor, str(_KINDS[int(np.argmax(series.log_R))]))

    def leave_out(self, point: str, sensor: str) -> None:
        """Forget a sensor that was taken out, and with it what it told of its point."""
        self._noise.pop((point, sensor), None)
        self._series.pop((point, sensor), None)
        self._series.pop((point, ""), None)

    def again(self) -> None:
        """Begin again, after an alarm for instance; what is known of the noise stays."""
        self.alarm = None
        self._series.clear()


def score_of_word(innovation: float, innovation_variance: float, variance: float) -> float:
    """Expected standard normal innovation of a reading known as an interval, E xi; of an exact one, nu / sqrt(S).

    innovation, innovation_variance : nu and S / (1 - var xi) of docs/theory/filter.md, equation 10
    variance : S, variance of the expected reading with its noise

    From nu = sqrt(S) E xi / (1 - var xi), the same unit squared for both variances.
    """
    return innovation * math.sqrt(variance) / innovation_variance
