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
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Protocol

import numpy as np
from scipy.linalg import cho_solve, solve_triangular

from sim_heating.base.arrays import BoolArray, FloatArray
from sim_heating.base.kernels.block import LANES
from sim_heating.estimation.inference.likelihood import ReadingIntervals, scores
from sim_heating.inputs.points import conditions_of_record
from sim_heating.inputs.record import Record
from sim_heating.march.ensemble import condition_history
from sim_heating.march.linearised import LinearMarch

if TYPE_CHECKING:
    from sim_heating.estimation.record_fit import PredictedSamples, RecordFit

SPACING_S, MOST_KNOTS = 20.0, 100
"""Least distance of knots [s], a third of the shortest correlation time, and their largest number."""
STEP = 0.02
"""Relative change of the heating for the derivative of the readings [-]."""
SETTLED, MOST_STEPS = 0.01, 12
"""Change of u at which the inner iteration has converged [-], and its most steps."""
TOGETHER = 64
"""Readings that the filter takes at a time."""
SIZES = (0.0025, 0.005, 0.01, 0.015, 0.02, 0.03, 0.04, 0.06, 0.08, 0.11, 0.15, 0.2, 0.3)
"""Standard deviations of the heating's error [-] that its size is integrated over."""
TIMES = 4
"""Correlation times that it is integrated over, evenly spaced on a logarithmic scale."""


@dataclass(frozen=True)
class HeatingErrorPrior:
    """Prior of the smooth relative error of a record's heating.

    relative : scale of the half-normal prior of its standard deviation [-]
    shortest_s, longest_s : limits of the log-uniform prior of its correlation time [s]; equal where it is stated
    """

    relative: float
    shortest_s: float
    longest_s: float

    @property
    def middle_s(self) -> float:
        """Middle of the correlation times on a logarithmic scale [s]."""
        return math.sqrt(self.shortest_s * self.longest_s)

    def grid(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """(size,) standard deviations [-], (time,) correlation times [s], (time, size) logarithms of their weights."""
        sizes, ends = np.array(SIZES), np.log([self.shortest_s, self.longest_s])
        count = TIMES if self.longest_s > self.shortest_s else 1
        middles = ends[0] + (np.arange(count) + 0.5) / count * (ends[1] - ends[0])
        edges = np.concatenate([[0.0], 0.5 * (sizes[1:] + sizes[:-1]), [1.5 * sizes[-1]]])
        weight = np.diff(edges) * np.exp(-0.5 * (sizes / self.relative) ** 2)
        return sizes, np.exp(middles), np.tile(np.log(weight / weight.sum()) - math.log(count), (count, 1))


class FlightError(Protocol):
    """Directions in which the flight of a record may be other than its conditions state."""

    @property
    def directions(self) -> Sequence[tuple[str, float]]:
        """(direction,) what differs, as in a closure report, and its standard deviation in its unit."""

    def record(self, f: FloatArray) -> Record:
        """The record with the reference heating and the surface pressure of the flight that differs.

        f : (direction,) by how many standard deviations [-]
        """


@dataclass(frozen=True, eq=False)
class ModelError:
    """The error of the model of one record.

    time_s     : (knot,) of the heating's error [s]
    sample_s   : (sample,) times that the responses are for [s]
    heating_K  : (sensor, sample, knot) change of a reading for a relative error of 1 at a knot [K]
    flight_K   : (sensor, sample, direction) change of a reading for one standard deviation along a direction [K]
    flight     : the directions; None where the flight has no error
    sigma      : standard deviation of the heating's error [-];  correlation_s : its correlation time [s]
    """

    time_s: FloatArray
    sample_s: FloatArray
    heating_K: FloatArray
    flight_K: FloatArray
    flight: FlightError | None
    sigma: float
    correlation_s: float

    @cached_property
    def correlation_root(self) -> FloatArray:
        """(knot, knot) lower root of the correlation matrix exp(-|t_i - t_j| / tau) [-]."""
        apart = np.abs(self.time_s[:, np.newaxis] - self.time_s)
        return np.asarray(np.linalg.cholesky(np.exp(-apart / self.correlation_s)))

    def of_size(self, sigma: float, correlation_s: float) -> ModelError:
        """The same error with another standard deviation [-] and correlation time [s] of that of the heating."""
        return replace(self, sigma=sigma, correlation_s=correlation_s)

    def heating(self, u: FloatArray) -> FloatArray:
        """(knot,) relative error of the heating [-] by the (unknown,) standard unknowns of the error [-]."""
        return np.asarray(self.sigma * self.correlation_root @ u[: len(self.time_s)])

    def along_flight(self, u: FloatArray) -> FloatArray:
        """(direction,) standard deviations along the flight's directions by the (unknown,) u of the error [-]."""
        return u[len(self.time_s) :]

    def at(self, sensor: int, time_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(reading, knot) and (reading, direction) responses of a sensor, by its number, at some of the samples [K]."""
        k = np.searchsorted(self.sample_s, time_s)
        return self.heating_K[sensor, k], self.flight_K[sensor, k]


def model_error(
    record_fit: RecordFit, values: FloatArray, sigma: float, correlation_s: float, flight: FlightError | None = None
) -> ModelError:
    """The error of a record's model with the response of its readings, about the values of a fit.

    record_fit : a record of a fit, with all samples that are ever asked for
    values     : (parameter,) of the model
    sigma, correlation_s : of the heating's error, s [-] and tau [s]
    flight     : the error of the flight
    raises     : RunError where the model cannot be marched

    Responses are differences of marches: with the heating, by the flow and by lamps, scaled about one knot after the
    other, and along the flights that differ. Source: docs/theory/model_error.md, equation 2.
    """
    time_s = record_fit.time_s
    flown = record_fit.conditions.at(time_s)
    first, last = record_fit.begin_s, float(record_fit.sample_s[-1])
    count = min(max(math.ceil((last - first) / SPACING_S) + 1, 2), MOST_KNOTS)
    knots = np.linspace(first, last, count)
    heating = {n: flown[n] for n in ("h_ref_kg_m2_s", "q_add_W_m2") if n in flown}
    scales = (1.0 + STEP * np.interp(time_s, knots, hat) for hat in np.eye(count))
    others = [] if flight is None else [flight.record(f) for f in np.eye(len(flight.directions))]
    histories = [
        flown,
        *(flown.with_columns(**{n: scale * q for n, q in heating.items()}) for scale in scales),
        *(conditions_of_record(other).at(time_s) for other in others),
    ]
    T = _marched_K(record_fit, values, [condition_history(h) for h in histories])
    moved = np.moveaxis(T[1:] - T[0], 0, -1)
    return ModelError(
        knots, record_fit.sample_s, moved[..., :count] / STEP, moved[..., count:], flight, sigma, correlation_s
    )


def _marched_K(record_fit: RecordFit, values: FloatArray, histories: Sequence[FloatArray]) -> FloatArray:
    """(history, sensor, sample) temperatures of the thermocouples along several histories [K]."""
    track, shift, found = record_fit.track(values, sensitive=False), record_fit.shift_s(values), []
    for begin in range(0, len(histories), LANES):
        lanes = histories[begin : begin + LANES]
        tracks = [replace(track, flight=k) for k in range(len(lanes))]
        marched = LinearMarch(tracks, record_fit.time_s, np.stack(lanes)).march([shift] * len(lanes))
        found += [record_fit.sensed(m, values).temperature_K for m in marched]
    return np.array(found)


@dataclass(frozen=True, eq=False)
class ScoredReadings:
    """The likelihood of the readings of one record at some predictions, the error of the model integrated out.

    log_likelihood : [-];  score : (reading,) [1/K];  weight : (reading,) information W of the readings [1/K2]
    root           : (reading, unknown) G of the error [K], and the (unknown, unknown) lower root of 1 + G' R^-1 G; None
                     without an error
    error          : (unknown,) the most probable u [-]; empty without an error
    """

    log_likelihood: float
    score: FloatArray
    weight: FloatArray
    root: tuple[FloatArray, FloatArray] | None = None
    error: FloatArray = field(default_factory=lambda: np.zeros(0))

    def information(self, sensitivity: FloatArray) -> FloatArray:
        """(parameter, parameter) information by the (reading, parameter) sensitivities [K over the unit]."""
        weighed = sensitivity * self.weight[:, np.newaxis]
        whole = weighed.T @ sensitivity
        if self.root is None:
            return whole
        G, lower = self.root
        lost = solve_triangular(lower, G.T @ weighed, lower=True)
        return np.asarray(whole - lost.T @ lost)


def scored_readings(record_fit: RecordFit, means_K: Sequence[FloatArray]) -> ScoredReadings:
    """Log likelihood of the readings of a record, its score and information.

    means_K : by channel of the record, (reading,) predictions without an error [K]

    One step finds the most probable error of readings that are not rounded; the others take some more. Source:
    docs/theory/model_error.md, equations 3 and 4; without an error docs/theory/estimation_statistics.md, equations 3 to
    6.
    """
    G = record_fit.error_root_K
    if G is None:
        return ScoredReadings(*_scored(record_fit, means_K))
    ends = np.cumsum([len(m) for m in means_K])[:-1]

    def at(u: FloatArray) -> tuple[float, FloatArray, FloatArray]:
        total, score, weight = _scored(
            record_fit, [m + d for m, d in zip(means_K, np.split(G @ u, ends), strict=True)]
        )
        return total - 0.5 * float(u @ u), score, weight

    lower, volume = record_fit.error_factor
    u = np.zeros(G.shape[1])
    total, score, weight = at(u)
    for _ in range(MOST_STEPS if np.isfinite(total) else 0):
        step = cho_solve((lower, True), G.T @ score - u)
        there = at(u + step)
        # the sum is concave in u: a shorter step raises it
        while there[0] < total - SETTLED and np.max(np.abs(step)) > SETTLED:
            step = 0.5 * step
            there = at(u + step)
        u, (total, score, weight) = u + step, there
        if np.max(np.abs(step)) < SETTLED:
            break
    return ScoredReadings(total + volume, score, weight, (G, lower), u)


def _scored(record_fit: RecordFit, means_K: Sequence[FloatArray]) -> tuple[float, FloatArray, FloatArray]:
    """Log likelihood, (reading,) scores [1/K] and weights [1/K2] of the readings of all channels."""
    pairs = zip(record_fit.channels, means_K, strict=True)
    found = [scores(c.intervals, m, record_fit.sigma_K[c.number]) for c, m in pairs]
    return sum(s[0] for s in found), *(np.concatenate([s[k] for s in found]) for k in (1, 2))


@dataclass(frozen=True, eq=False)
class ErrorState:
    """What is known of u after some readings: mean (unknown,) and covariance (unknown, unknown) [-]."""

    mean: FloatArray
    covariance: FloatArray


def innovations(
    record_fit: RecordFit, samples: Sequence[PredictedSamples], state: ErrorState | None = None
) -> tuple[list[PredictedSamples], ErrorState | None]:
    """Predictions of the readings of one record, each from those before it, and what is then known of its error.

    record_fit : the record with its error;  samples : its channels, predicted without an error
    state      : from readings before; None for the prior
    returns    : channels with the mean and the standard deviation that the readings before give [K]; as they are
                 without an error

    A rounded reading counts as one with the noise of its rounding. Source: docs/theory/model_error.md, equation 6.
    """
    G, noise = record_fit.error_root_K, record_fit.reading_noise_K
    if G is None:
        return list(samples), None
    mean_K = np.concatenate([s.mean_K for s in samples])
    read = np.concatenate([_middle_K(s.channel.intervals) for s in samples])
    time_s = np.concatenate([record_fit.sample_s[s.channel.samples] for s in samples])
    n = G.shape[1]
    u, P = (np.zeros(n), np.eye(n)) if state is None else (state.mean, state.covariance)
    predicted, variance = np.empty(len(read)), np.empty(len(read))
    order = np.argsort(time_s, kind="stable")
    for group in np.array_split(order, max(len(order) // TOGETHER, 1)):
        known = group[np.isfinite(read[group])]
        lost = group[~np.isfinite(read[group])]  # a reading at the end of a word's span says little
        predicted[lost] = mean_K[lost] + G[lost] @ u
        variance[lost] = np.einsum("ij,jk,ik->i", G[lost], P, G[lost])
        if len(known) == 0:
            continue
        # the root of the readings' covariance, in the order of time, has what those before leave of each
        across = P @ G[known].T
        lower = np.linalg.cholesky(G[known] @ across + np.diag(noise[known] ** 2))
        white = solve_triangular(lower, read[known] - mean_K[known] - G[known] @ u, lower=True)
        left = np.diag(lower)
        predicted[known], variance[known] = read[known] - white * left, left**2 - noise[known] ** 2
        gain = solve_triangular(lower, across.T, lower=True)
        u, P = u + gain.T @ white, P - gain.T @ gain
    sigma = np.sqrt(np.maximum(variance, 0.0))
    ends = np.cumsum([len(s.mean_K) for s in samples])[:-1]
    channels = [
        replace(s, mean_K=m, predicted_sigma_K=d)
        for s, m, d in zip(samples, np.split(predicted, ends), np.split(sigma, ends), strict=True)
    ]
    return channels, ErrorState(u, P)


def _middle_K(intervals: ReadingIntervals) -> FloatArray:
    """(reading,) middles of the intervals [K]; not finite where a reading is lost or at an end of a word's span."""
    with np.errstate(invalid="ignore"):
        return np.asarray(0.5 * (intervals.lower_K + intervals.upper_K))


@dataclass(frozen=True, eq=False)
class ErrorSize:
    """What the readings of a record say of the size of its heating's error, with a model of the record.

    sizes  : (size,) standard deviations [-];  times_s : (time,) correlation times [s]
    log_likelihood : (time, size) largest over the parameters, the error integrated out
    log_weight     : (time, size) of the prior
    """

    sizes: FloatArray
    times_s: FloatArray
    log_likelihood: FloatArray
    log_weight: FloatArray

    @property
    def evidence(self) -> float:
        """Log likelihood with size and correlation time integrated out [-]."""
        return float(np.logaddexp.reduce((self.log_likelihood + self.log_weight).ravel()))

    def at(self, error: ModelError) -> float:
        """Log likelihood at the size and the correlation time of an error, which are of the grid [-]."""
        i = int(np.argmin(np.abs(np.log(self.times_s / error.correlation_s))))
        return float(self.log_likelihood[i, int(np.argmin(np.abs(self.sizes - error.sigma)))])

    @property
    def posterior(self) -> FloatArray:
        """(time, size) probability of each [-]."""
        return np.exp(self.log_likelihood + self.log_weight - self.evidence)

    @property
    def likeliest(self) -> tuple[float, float]:
        """Standard deviation [-] and correlation time [s] of the most probable pair."""
        at = np.unravel_index(int(np.argmax(self.posterior)), self.posterior.shape)
        return float(self.sizes[at[1]]), float(self.times_s[at[0]])

    @property
    def mean(self) -> float:
        """Mean of the standard deviation [-]."""
        return float(self.posterior.sum(axis=0) @ self.sizes)

    def limit(self, probability: float = 0.95) -> float:
        """Standard deviation below which it lies with a probability [-]."""
        return float(np.interp(probability, np.cumsum(self.posterior.sum(axis=0)), self.sizes))


def error_size(
    record_fit: RecordFit,
    samples: Sequence[PredictedSamples],
    towards_prior: tuple[FloatArray, FloatArray],
    free: BoolArray,
    prior: HeatingErrorPrior,
) -> ErrorSize:
    """What the readings say of the size of the heating's error, about a fitted model.

    record_fit    : the record with its error;  samples : its channels at the values of the fit, with sensitivities
    towards_prior : (parameter,) prior information of the parameters, and the distance of the means of their priors
    free          : (parameter,) whether a parameter may move from its value
    prior         : of the size

    The model is linear in its parameters here, and a rounded reading counts as one with the noise of its rounding. With
    s_k, U_k the singular values and left vectors of R^-1/2 S L / s, the covariance that the heating's error gives is
    1 + s^2 U diag(s_k^2) U'; that of the flight is integrated out with the parameters. Source:
    docs/theory/model_error.md, equation 5.
    """
    error = record_fit.model_error
    assert error is not None  # the caller's records have one
    noise = record_fit.reading_noise_K
    read = np.concatenate([_middle_K(s.channel.intervals) for s in samples])
    mean_K = np.concatenate([s.mean_K for s in samples])
    responses = [error.at(c.number, record_fit.sample_s[c.samples]) for c in record_fit.channels]
    S, F = (np.concatenate([r[k] for r in responses]) for k in (0, 1))
    sensitivity = np.concatenate([s.sensitivity for s in samples])[:, free]
    known = np.isfinite(read)
    scale = noise[known, np.newaxis]
    r, S = (read - mean_K)[known] / noise[known], S[known] / scale
    J = np.column_stack([F[known], sensitivity[known]]) / scale
    flight = F.shape[1]
    information = np.append(np.ones(flight), towards_prior[0][free])
    distance = np.append(np.zeros(flight), towards_prior[1][free])
    sizes, times_s, weights = prior.grid()
    found = np.empty(weights.shape)
    for i, tau in enumerate(times_s):
        U, singular, _ = np.linalg.svd(S @ error.of_size(1.0, tau).correlation_root, full_matrices=False)
        Ur, UJ = U.T @ r, U.T @ J
        for k, size in enumerate(sizes):
            variance = (size * singular) ** 2
            taken = variance / (1.0 + variance)
            M = J.T @ J - (UJ * taken[:, np.newaxis]).T @ UJ + np.diag(information)
            g = J.T @ r - UJ.T @ (taken * Ur) + information * distance
            square = float(r @ r - Ur @ (taken * Ur)) + float(information @ distance**2)
            step = np.linalg.lstsq(M, g, rcond=None)[0]
            volume = float(np.sum(np.log1p(variance))) + float(np.linalg.slogdet(M[:flight, :flight])[1])
            found[i, k] = -0.5 * (square - float(g @ step) + volume)
    return ErrorSize(sizes, times_s, found, weights)

