"""Error of the model of a record, which no flight is without, integrated out of the likelihood.

The heating of a record is q (1 + e(t)): e is a stationary first-order Gauss-Markov (Ornstein-Uhlenbeck) process of
standard deviation s [-] and correlation time tau [s], linear between knots. Its flight is not quite the stated one, by
f standard deviations along each of some directions: another time, density, velocity or angle of attack. Both act
linearly on the readings,

    y = m(p) + S e + F f + noise,    e = L g,   L L' = s^2 exp(-|t_i - t_j| / tau),    u = (g, f) ~ N(0, 1),

with S = dT/de and F = dT/df [K], G = (S L, F). The likelihood of the parameters p is that of the readings with u
integrated out, by Laplace's approximation, which is exact for readings that are not rounded:

    log L(p) = max_u [sum_i log L_i(m_i + (G u)_i) - u' u / 2] - log det(1 + G' R^-1 G) / 2.

Its gradient and information against m are

    v(u),    W - W G (1 + G' W G)^-1 G' W,

v and W the score and the information of the readings at the most probable u (estimation/inference/likelihood.py).
Without an error every likelihood is as it was. Read in the order of time, the same model gives the innovations of the
readings and the prediction of those held out: a Kalman filter whose state is u. Derived in docs/theory/model_error.md,
equations 1 to 7; after M. C. Kennedy and A. O'Hagan, "Bayesian Calibration of Computer Models", J. R. Stat. Soc. B 63
(2001) 425.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Protocol

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.inputs.record import Record

SIZES = (0.0025, 0.005, 0.01, 0.015, 0.02, 0.03, 0.04, 0.06, 0.08, 0.11, 0.15, 0.2, 0.3)
"""Standard deviations of the heating's error [-] that its size is integrated over."""
FLIGHT_PREFIX = "flight."
"""Beginning of the names of the errors of a flight, where these are unknowns of a fit."""
MOST_NOISE_KNOTS = 150
"""Largest number of knots of white noise of the heating."""
JITTER = 1e-8
"""Added to the diagonal of a smooth correlation matrix, which rounding may make indefinite [-]."""
AS_STATED: Mapping[float, float] = {1.0: 1.0}
"""Prior of the factor on stated standard deviations where these are believed as they are."""
TIMES = 5
"""Correlation times that it is integrated over, evenly spaced on a logarithmic scale."""
STAYS = 20.0
"""Correlation time of an error that stays as it is until it starts anew, over the longest of its prior [-]."""


@dataclass(frozen=True)
class Correlation:
    """How far in time values of the heating's error are alike.

        exp(-x), or where it is smooth (1 + sqrt(5) x + 5 x^2 / 3) exp(-sqrt(5) x),    x = |t_i - t_j| / tau

    time_s : the correlation time tau [s];  smooth : whether the error has no corners
    breaks_s : times from which on it is independent of what it was before [s], of knots of the error

    Source: docs/theory/model_error.md, equations 1 and 1a; the second after B. Matern, Spatial Variation (1960).
    """

    time_s: float
    smooth: bool = False
    breaks_s: tuple[float, ...] = ()

    def root(self, at_s: FloatArray) -> FloatArray:
        """(knot, knot) lower root of the correlation matrix of the error at some times [s], [-].

        L / s of docs/theory/model_error.md, equation 1.
        """
        return np.asarray(np.linalg.cholesky(self.matrix(at_s)))

    def matrix(self, at_s: FloatArray) -> FloatArray:
        """(knot, knot) correlation matrix of the error at some times [s], [-].

        L L' / s^2 of docs/theory/model_error.md, equation 1, and that of equation 1a.
        """
        x = np.abs(at_s[:, np.newaxis] - at_s) / self.time_s
        if not self.smooth:
            part = np.searchsorted(self.breaks_s, at_s, side="right")
            return np.where(part[:, np.newaxis] == part, np.exp(-x), 0.0)
        y = math.sqrt(5.0) * x
        return np.asarray((1.0 + y + y**2 / 3.0) * np.exp(-y) + JITTER * np.eye(len(x)))


@dataclass(frozen=True)
class HeatingErrorPrior:
    """Prior of the smooth relative error of a record's heating.

    relative : scale of the half-normal prior of its standard deviation [-]
    shortest_s, longest_s : limits of the log-uniform prior of its correlation time [s]; equal where it is stated
    scales : factor on `relative` -> its probability [-]: a size that somebody states may be too small

    It may be smooth or have corners, which are equally probable. The defaults are those of a measured flight that
    states none: 5 % of the heating, from a manoeuvre's duration to parts of an entry, a choice.
    """

    relative: float = 0.05
    shortest_s: float = 15.0
    longest_s: float = 600.0
    scales: Mapping[float, float] = field(default_factory=lambda: AS_STATED)

    @property
    def middle(self) -> Correlation:
        """The correlation in the middle of the times on a logarithmic scale: docs/theory/model_error.md, equation 5."""
        return Correlation(math.sqrt(self.shortest_s * self.longest_s))

    def grid(self, *, may_break: bool = False) -> tuple[FloatArray, tuple[Correlation, ...], FloatArray]:
        """(size,) standard deviations [-], (correlation,) correlations, (correlation, size) logarithms of weights.

        may_break : whether it may start anew, and stay as it is until then where its correlation time is not stated

        Source: docs/theory/model_error.md, equations 1a, 5 and 5c.
        """
        sizes, ends = np.array(SIZES), np.log([self.shortest_s, self.longest_s])
        if self.relative == 0.0:  # the heating is exact, and something else is not
            return np.zeros(1), (self.middle,), np.zeros((1, 1))
        count = TIMES if self.longest_s > self.shortest_s else 1
        times_s = np.exp(ends[0] + (np.arange(count) + 0.5) / count * (ends[1] - ends[0]))
        correlations = [Correlation(float(tau), smooth) for smooth in (False, True) for tau in times_s]
        if may_break and count > 1:
            correlations.append(Correlation(STAYS * self.longest_s))
        edges = np.concatenate([[0.0], 0.5 * (sizes[1:] + sizes[:-1]), [1.5 * sizes[-1]]])
        c, p = np.array(list(self.scales)), np.array(list(self.scales.values()))
        half_normal = np.exp(-0.5 * (sizes[:, np.newaxis] / (c * self.relative)) ** 2) / c
        log_weight = np.log(np.diff(edges)) + np.log(half_normal @ p)
        log_weight -= np.logaddexp.reduce(log_weight) + math.log(len(correlations))
        return sizes, tuple(correlations), np.tile(log_weight, (len(correlations), 1))


class FlightError(Protocol):
    """Directions in which the flight of a record may be other than its conditions state."""

    @property
    def scale(self) -> float:
        """Factor on the standard deviations as stated [-]: c of docs/theory/model_error.md, equation 5a."""

    def of_scale(self, scale: float) -> FlightError:
        """This error with another factor on the standard deviations as stated [-].

        Source: docs/theory/model_error.md, equation 5a.
        """

    @property
    def directions(self) -> Sequence[tuple[str, float]]:
        """(direction,) what differs, as in a closure report, and its standard deviation in [s], [-] or [deg].

        f of docs/theory/model_error.md, equation 1.
        """

    def record(self, f: FloatArray) -> Record:
        """The record with the reference heating and the surface pressure of the flight that differs.

        f : (direction,) by how many standard deviations [-]

        Source: docs/theory/model_error.md, equation 2.
        """


@dataclass(frozen=True, eq=False)
class StatedError:
    """What the model of a record may be off before any reading.

    heating : prior of the error of its heating, None where that is exact;  flight : the error of its flight, likewise
    """

    heating: HeatingErrorPrior | None
    flight: FlightError | None


@dataclass(frozen=True, eq=False)
class CorrelatedNoise:
    """Noise of a sensor that changes slowly: a first-order Gauss-Markov process, linear between knots.

    time_s : (knot,) [s];  sigma_K : its standard deviation [K];  correlation_s : its correlation time [s]
    """

    time_s: FloatArray
    sigma_K: float
    correlation_s: float

    @cached_property
    def root_K(self) -> FloatArray:
        """(knot, knot) lower root of its covariance [K]: docs/theory/model_error.md, equation 8."""
        apart = np.abs(self.time_s[:, np.newaxis] - self.time_s)
        return np.asarray(self.sigma_K * np.linalg.cholesky(np.exp(-apart / self.correlation_s)))

    @property
    def white_K(self) -> float:
        """Size of what the line between two knots leaves of it [K]: docs/theory/model_error.md, equation 8."""
        return self.sigma_K * math.sqrt((self.time_s[1] - self.time_s[0]) / (3.0 * self.correlation_s))

    def at(self, time_s: FloatArray) -> FloatArray:
        """(reading, knot) what a unit of each unknown adds at some times [s], in [K]: equation 8 there."""
        hats = [np.interp(time_s, self.time_s, hat) for hat in np.eye(len(self.time_s))]
        return np.asarray(np.array(hats).T @ self.root_K)


@dataclass(frozen=True, eq=False)
class HeatingNoise:
    """Relative white noise of the heating of a record.

    time_s   : (row,) of the conditions [s];  relative : (row,) one standard deviation [-]
    """

    time_s: FloatArray
    relative: FloatArray

    @cached_property
    def share_s(self) -> FloatArray:
        """(row,) part of the time that each row stands for [s]: d of docs/theory/model_error.md, equation 10."""
        edges = np.concatenate([self.time_s[:1], 0.5 * (self.time_s[1:] + self.time_s[:-1]), self.time_s[-1:]])
        return np.diff(edges)

    def knots_s(self, first_s: float, last_s: float) -> FloatArray:
        """(knot,) times between which it is linear [s], as far apart as the rows are, or farther.

        Knots of docs/theory/model_error.md, equation 10.
        """
        row_s = float(np.median(np.diff(self.time_s)))
        count = min(max(math.ceil((last_s - first_s) / row_s) + 1, 2), MOST_NOISE_KNOTS)
        return np.linspace(first_s, last_s, count)

    def at_knots(self, knots_s: FloatArray) -> FloatArray:
        """(knot,) standard deviations of independent values at the knots [-].

        Source: docs/theory/model_error.md, equation 10.
        """
        hats = np.array([np.interp(self.time_s, knots_s, hat, 0.0, 0.0) for hat in np.eye(len(knots_s))])
        width_s = hats @ self.share_s
        variance = hats @ (self.relative * self.share_s) ** 2
        return np.sqrt(np.divide(variance, width_s**2, out=np.zeros_like(variance), where=width_s > 0.0))


@dataclass(frozen=True, eq=False)
class ModelError:
    """The error of the model of one record.

    time_s     : (knot,) of the heating's error [s]
    sample_s   : (sample,) times that the responses are for [s]
    heating_K  : (sensor, sample, knot) change of a reading for a relative error of 1 at a knot [K]
    flight_K   : (sensor, sample, direction) change of a reading for one standard deviation along a direction [K]
    flight     : the directions; None where the flight has no error
    sigma      : standard deviation of the heating's error [-];  correlation : how far in time it is alike
    noise      : of the sensors whose noise changes slowly, by their numbers
    heating_noise : white noise of the heating, which the noise of the conditions gives; None without any
    white_K    : (sensor, sample, value) change of a reading for one standard deviation of each value of the heating's
                 white noise [K]; None without any
    form_K     : (sensor, sample, value) that for each value of the errors that the forms of its causes have [K]; None
                 where these are exact

    The unknowns u are those of the heating, of the flight, of the noise of each sensor, of the heating's white noise
    and of the forms, in this order.
    """

    time_s: FloatArray
    sample_s: FloatArray
    heating_K: FloatArray
    flight_K: FloatArray
    flight: FlightError | None
    sigma: float
    correlation: Correlation
    noise: Mapping[int, CorrelatedNoise] = field(default_factory=dict)
    heating_noise: HeatingNoise | None = None
    white_K: FloatArray | None = None
    form_K: FloatArray | None = None

    @property
    def is_noise_alone(self) -> bool:
        """Whether only the conditions and the sensors have noise, and heating and flight are as the model has them."""
        return self.sigma == 0.0 and self.flight is None

    @cached_property
    def correlation_root(self) -> FloatArray:
        """(knot, knot) lower root of the correlation matrix of the heating's error [-].

        L / s of docs/theory/model_error.md, equations 1 and 1a.
        """
        return self.correlation.root(self.time_s)

    @property
    def flight_scale(self) -> float:
        """Factor on the standard deviations of the flight as stated [-]; 1 where the flight has no error.

        c of docs/theory/model_error.md, equation 5a.
        """
        return 1.0 if self.flight is None else self.flight.scale

    def of_size(self, sigma: float, correlation: Correlation, flight_scale: float | None = None) -> ModelError:
        """This error with another standard deviation [-] and correlation of the heating.

        flight_scale : factor on the standard deviations of the flight as stated [-]; by default as it is

        s and tau of docs/theory/model_error.md, equation 1, and c of equation 5a.
        """
        sized = replace(self, sigma=sigma, correlation=correlation)
        if self.flight is None or flight_scale in (None, self.flight_scale):
            return sized
        wider = flight_scale / self.flight_scale
        return replace(sized, flight=self.flight.of_scale(flight_scale), flight_K=wider * self.flight_K)

    def without_heating(self) -> ModelError:
        """The error of the flight and the noise alone: s = 0 in docs/theory/model_error.md, equation 1."""
        return replace(self.of_size(0.0, self.correlation), form_K=None)

    def heating(self, u: FloatArray) -> FloatArray:
        """(knot,) relative error of the heating [-] by the (unknown,) u of the error [-].

        e of docs/theory/model_error.md, equation 1.
        """
        return np.asarray(self.sigma * self.correlation_root @ u[: len(self.time_s)])

    @property
    def flight_names(self) -> tuple[str, ...]:
        """Names of the directions as unknowns of a fit, numbered where there are several of one kind.

        f of docs/theory/model_error.md, equation 1.
        """
        kinds = [name for name, _ in (self.flight.directions if self.flight else ())]
        numbers = [kinds[:k].count(name) for k, name in enumerate(kinds)]
        return tuple(
            f"{FLIGHT_PREFIX}{n}" + (f".{i + 1}" if kinds.count(n) > 1 else "")
            for n, i in zip(kinds, numbers, strict=True)
        )

    def along_flight(self, u: FloatArray) -> FloatArray:
        """(direction,) standard deviations along the flight's directions by the (unknown,) u of the error [-].

        f of docs/theory/model_error.md, equation 1.
        """
        return u[self.of_flight]

    @property
    def of_flight(self) -> slice:
        """Places of the flight's unknowns [-] among all u of docs/theory/model_error.md, equation 1."""
        first = len(self.time_s)
        return slice(first, first + self.flight_K.shape[-1])

    def at(self, sensor: int, time_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(reading, knot) response of a sensor, by its number, at some samples, and (reading, unknown) of all else [K].

        S and F of docs/theory/model_error.md, equation 1; F with the noise that changes slowly.
        """
        k = np.searchsorted(self.sample_s, time_s)
        others = [np.zeros((len(k), len(n.time_s))) if i != sensor else n.at(time_s) for i, n in self.noise.items()]
        others += [K[sensor, k] for K in (self.white_K, self.form_K) if K is not None]
        return self.heating_K[sensor, k], np.column_stack([self.flight_K[sensor, k], *others])


@dataclass(frozen=True, eq=False)
class ErrorSize:
    """What the readings of a record say of the size of its model's error, with a model of the record.

    sizes  : (size,) standard deviations of the heating's [-];  correlations : (correlation,) how far it is alike
    scales : (scale,) factors on the standard deviations of the flight as stated [-]
    log_likelihood : (scale, correlation, size) largest over the parameters, the error integrated out
    log_weight     : (scale, correlation, size) of the prior
    """

    sizes: FloatArray
    correlations: tuple[Correlation, ...]
    scales: FloatArray
    log_likelihood: FloatArray
    log_weight: FloatArray

    @property
    def evidence(self) -> float:
        """Log likelihood with size, correlation time and scale integrated out [-].

        Source: docs/theory/model_error.md, equation 5.
        """
        return float(np.logaddexp.reduce((self.log_likelihood + self.log_weight).ravel()))

    def at(self, error: ModelError) -> float:
        """Log likelihood at size, correlation and scale of an error, which are of the grid [-].

        Source: docs/theory/model_error.md, equation 5.
        """
        return float(self.log_likelihood[self._place(error)])

    def _place(self, error: ModelError) -> tuple[int, int, int]:
        """Place of an error in the grid."""
        j = int(np.argmin(np.abs(np.log(self.scales / error.flight_scale))))
        return j, self.correlations.index(error.correlation), int(np.argmin(np.abs(self.sizes - error.sigma)))

    def log_odds_of_likeliest(self, error: ModelError) -> float:
        """Log odds of the most probable size, correlation and scale over those of an error, which are of the grid [-].

        Source: docs/theory/model_error.md, equation 5.
        """
        log_posterior = self.log_likelihood + self.log_weight
        return float(np.max(log_posterior) - log_posterior[self._place(error)])

    @property
    def posterior(self) -> FloatArray:
        """(scale, correlation, size) probability of each [-]: docs/theory/model_error.md, equation 5."""
        return np.exp(self.log_likelihood + self.log_weight - self.evidence)

    @property
    def posterior_of_heating(self) -> FloatArray:
        """(correlation, size) probability [-] of each, whatever the flight's error.

        Source: docs/theory/model_error.md, equation 5.
        """
        return np.asarray(self.posterior.sum(axis=0))

    @property
    def likeliest(self) -> tuple[float, Correlation, float]:
        """Most probable standard deviation [-], correlation and scale of the flight's error [-].

        Source: docs/theory/model_error.md, equations 5 and 5a.
        """
        at = np.unravel_index(int(np.argmax(self.posterior)), self.posterior.shape)
        return float(self.sizes[at[2]]), self.correlations[at[1]], float(self.scales[at[0]])

    @property
    def log_likelihood_of_scale(self) -> FloatArray:
        """(scale,) log likelihood with size and correlation time integrated out [-].

        Source: docs/theory/model_error.md, equation 5a.
        """
        joint, prior = (
            np.logaddexp.reduce(x.reshape(len(self.scales), -1), axis=1)
            for x in (self.log_likelihood + self.log_weight, self.log_weight)
        )
        return np.asarray(joint - prior)

    @property
    def posterior_of_scale(self) -> dict[float, float]:
        """Probability [-] of each factor on the flight's sigmas: docs/theory/model_error.md, equation 5a."""
        return dict(zip(self.scales.tolist(), self.posterior.sum(axis=(1, 2)).tolist(), strict=True))

    @property
    def mean(self) -> float:
        """Mean of the standard deviation [-]: docs/theory/model_error.md, equation 5."""
        return float(self.posterior.sum(axis=(0, 1)) @ self.sizes)

    @property
    def rms(self) -> float:
        """Root mean square of the standard deviation [-]: docs/theory/model_error.md, equation 5."""
        return math.sqrt(float(self.posterior.sum(axis=(0, 1)) @ self.sizes**2))

    def limit(self, probability: float = 0.95) -> float:
        """Limit that the standard deviation is below with a probability [-]: docs/theory/model_error.md, equation 5."""
        upper = np.append(0.5 * (self.sizes[1:] + self.sizes[:-1]), 1.5 * self.sizes[-1])
        below = np.append(0.0, np.cumsum(self.posterior.sum(axis=(0, 1))))
        return float(np.interp(probability, below, np.append(0.0, upper)))
