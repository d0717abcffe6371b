"""Measured temperatures to the heating that the model lacks: a correction history of the heating ratio with its sigma.

The inverse heat-conduction problem as Gaussian-process regression. The ratio carries a disturbance d, a first-order
Gauss-Markov process of covariance sigma^2 exp(-|t| / tau), linear between knots; all readings together are y = H(d) +
noise, H the march itself. With A and b the information and score of the readings about the estimate of d,

    log L(d) = const + b' d - d' A d / 2,    mean (A + Q)^-1 b,    covariance (A + Q)^-1,

Q the tridiagonal precision of the process; the march is linearised again until the readings no longer change. The
noise model regularises: of the density q = 2 sigma^2 / tau and the correlation time tau, those of the largest marginal
likelihood are taken,

    log p(y) = const + b' (A + Q)^-1 b / 2 + log det Q / 2 - log det (A + Q) / 2.

Recorder words count as intervals (Laplace's approximation).

Where no history explains the readings, because sensors contradict each other, the noise is larger than declared by a
factor: with X the normalised sum of squared residuals of the most probable history in N readings, log p contains
- N log(e) / 2 - X / (2 e), and the most likely variance factor is e = X / N; below 1.5 it is taken as 1.

Bandwidth: with v the variance that remains at a time, the frequency f above which the process has just this variance,

    v / sigma^2 = 1 - (2 / pi) atan(2 pi f tau),

not above half the rate of the knots: as if slower changes were all known and faster ones not at all; 0 where
the readings have no information. Half amplitude: the frequency at which a sine in the ratio comes back half as large.
Derived in docs/theory/residual_heating.md, equations 1 to 11.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag, cho_factor, cho_solve, lapack

from sim_heating.base.arrays import FloatArray
from sim_heating.base.errors import InputError, RunError
from sim_heating.base.kernels.axis import cells_of
from sim_heating.base.parallel.threads import one_thread
from sim_heating.estimation.filter.march import Disturbance, FilterTrack
from sim_heating.estimation.filter.response import Response, ResponseMarch
from sim_heating.estimation.inference.likelihood import Likelihood, ReadingIntervals, likelihood
from sim_heating.march.point import initial_temperatures

DENSITIES_1_S = (1e-10, 1e-1)
"""Range in which the density is searched [1/s]; at its lower end a ratio wanders by 3e-4 in a quarter of an hour."""
DENSITIES_SCANNED = 10
CORRELATION_S = 30.0
"""Correlation time at which the search starts [s]; bounds are the spacing of the knots and the length of the march."""
LIKELIHOOD_TOLERANCE = 0.05
"""Accuracy of the log likelihood in the search for the noise model."""
MAX_KNOTS = 320
"""A march of more steps has one knot for several of them; faster changes are neither resolved nor part of sigma."""
MAX_COARSE_KNOTS = 100
"""Largest number of knots on which density and correlation time are searched."""
MAX_ROUNDS = 12
MODEL_FIXED, CONVERGED = 2.0, 0.2
"""Change of a reading over its noise below which noise model and derivatives are kept, and below which the iteration
has converged."""
MIN_VARIANCE_FACTOR = 1.5
"""Variance factor above which noise counts as larger than declared; smaller ones occur by chance."""
MIN_IMPROVEMENT, MIN_STEP_FRACTION = 0.1, 0.02
"""Smallest gain in log posterior for which a step is accepted, and smallest fraction of a step that is tried."""
FREQUENCIES = 40


@dataclass(frozen=True, eq=False)
class UnknownInput:
    """Correction history of the heating ratio that explains the readings.

    time_s       : (knot,) [s]; the correction is linear between them
    delta_ratio  : (knot,) addition to the ratio, before effects that multiply it [-]
    sigma        : (knot,) its standard deviation given all readings [-]
    bandwidth_Hz : (knot,) frequency up to which it is resolved [Hz]
    half_amplitude_Hz : frequency at which a sine throughout the march comes back half as large [Hz]
    disturbance  : noise model of the correction, given or of the largest likelihood
    variance_factor : variance of the noise over the declared one [-], 1 where a history explains the readings
    gain_log_likelihood : log marginal likelihood above that without a disturbance
    temperature_K : (time, node) temperatures with the correction at the ends of the steps, the start first [K]
    read_K       : (reading,) expected readings with it [K]
    response_matrix : (reading, knot) derivative of the readings against it [K]
    slope, weight : (reading,) first and negative second derivative of the log likelihood against read_K [1/K, 1/K2]
    information, score : (knot, knot), (knot,) A and b of the readings, start integrated out
    covariance   : (knot, knot) of the correction given all readings
    """

    time_s: FloatArray
    delta_ratio: FloatArray
    sigma: FloatArray
    bandwidth_Hz: FloatArray
    half_amplitude_Hz: float
    disturbance: Disturbance
    variance_factor: float
    gain_log_likelihood: float
    temperature_K: FloatArray
    read_K: FloatArray
    response_matrix: FloatArray
    slope: FloatArray
    weight: FloatArray
    information: FloatArray
    score: FloatArray
    covariance: FloatArray


def unknown_input(
    track: FilterTrack, time_s: FloatArray, histories: FloatArray, disturbance: Disturbance | None = None
) -> UnknownInput:
    """Heating-ratio history that explains a point's readings, with its covariance.

        u = (A + Q)^-1 b,    cov = (A + Q)^-1

    track       : the point with readings [K] and start; its process noise and disturbance are not used
    time_s      : (time,) steps [s];  histories : (flight, time, condition)
    disturbance : stationary noise model of the correction; that of the largest marginal likelihood, where None
    returns     : correction [-] at the knots, sigma, resolution [Hz], and A, b for tests of its shape
    raises      : InputError for a disturbance without correlation time, or a march too short for a noise model;
                  RunError where a step did not converge

    Changes faster than half the rate of the knots (at most 320) are not resolved. Source: Rasmussen and Williams
    (2006), chapters 2 and 5; derived in docs/theory/residual_heating.md, equations 1 to 9.
    """
    if disturbance is not None and not (0.0 < disturbance.correlation_s < math.inf and disturbance.start_sigma > 0.0):
        raise InputError("unknown input: the disturbance must be stationary, its sigma and correlation time above 0")
    inverse = _InverseProblem(track, np.asarray(time_s, dtype=float), histories)
    with one_thread():
        return inverse.solve(disturbance)


def most_likely_disturbance(track: FilterTrack, time_s: FloatArray, histories: FloatArray) -> Disturbance:
    """Stationary disturbance of the heating ratio of the largest marginal likelihood: sigma [-], correlation time [s].

    track  : the point with readings and start;  time_s : (time,) steps [s];  histories : (flight, time, condition)
    raises : InputError for a march too short for a noise model, RunError where a step did not converge

    Source: Rasmussen and Williams (2006), chapter 5; docs/theory/residual_heating.md, equation 7.
    """
    return unknown_input(track, time_s, histories).disturbance


def bandwidth_Hz(disturbance: Disturbance, sigma: FloatArray) -> FloatArray:
    """Frequency above which the prior process has the variance that remains.

        f = tan(pi/2 (1 - v / sigma^2)) / (2 pi tau)

    disturbance : noise model of the correction;  sigma : (knot,) standard deviation given the readings, sqrt(v) [-]
    returns     : (knot,) [Hz]; 0 where the readings reduce nothing; q / (2 pi^2 v) for a random walk of density q

    A summary, as if slower changes were all known and faster ones not at all. Derived in
    docs/theory/residual_heating.md, equation 11.
    """
    remaining = np.maximum(sigma**2, 1e-300)
    if math.isinf(disturbance.correlation_s):
        return disturbance.density_1_s / (2.0 * np.pi**2 * remaining)
    stationary = 0.5 * disturbance.density_1_s * disturbance.correlation_s
    # Below 1: at full information the tangent would be infinite.
    explained = np.clip(1.0 - remaining / stationary, 0.0, 1.0 - 1e-12)
    return np.tan(0.5 * np.pi * explained) / (2.0 * np.pi * disturbance.correlation_s)


def half_amplitude_Hz(time_s: FloatArray, information: FloatArray, covariance: FloatArray) -> float:
    """Frequency at which a sine in the ratio is estimated half as large: Re[e* (A + Q)^-1 A e] / n = 1/2.

    time_s                  : (knot,) [s]
    information, covariance : (knot, knot) A of the readings and (A + Q)^-1
    returns                 : [Hz], interpolated in log f; 0 where even the slowest sine of the march comes back less
                              than half, half the rate of the knots where all come back more

    Derived in docs/theory/residual_heating.md, equation 10.
    """
    span, spacing = np.ptp(time_s), np.median(np.diff(time_s))
    f = np.geomspace(1.0 / span, 0.5 / spacing, FREQUENCIES)
    waves = np.exp(2j * np.pi * np.outer(time_s, f))
    amplitude = np.real(np.sum(np.conj(waves) * (covariance @ (information @ waves)), axis=0)) / len(time_s)
    below = np.flatnonzero(amplitude < 0.5)
    if len(below) == 0:
        return float(f[-1])
    k = int(below[0])
    if k == 0:
        return 0.0
    fraction = (amplitude[k - 1] - 0.5) / (amplitude[k - 1] - amplitude[k])
    return float(f[k - 1] * (f[k] / f[k - 1]) ** fraction)


def knot_times(time_s: FloatArray, most: int) -> FloatArray:
    """Knots of a correction history: middles of the steps, or of groups of steps so that there are at most `most`.

    time_s  : (time,) steps [s];  most : largest number of knots
    returns : (knot,) times [s]

    Derived in docs/theory/residual_heating.md, equation 3.
    """
    steps = len(time_s) - 1
    ends = time_s[np.unique(np.append(np.arange(0, steps, math.ceil(steps / most)), steps))]
    return 0.5 * (ends[1:] + ends[:-1])


def interpolation_weights(time_s: FloatArray, at_s: FloatArray) -> FloatArray:
    """Interpolation matrix of a correction that is linear between knots and constant beyond the outer ones.

    time_s, at_s : (time,) times wanted [s], (knot,) knots [s]
    returns      : (time, knot) weights [-], each row of sum 1

    Derived in docs/theory/residual_heating.md, equation 3.
    """
    middle = np.clip(time_s, at_s[0], at_s[-1])
    matrix = np.zeros((len(middle), len(at_s)))
    if len(at_s) == 1:
        return matrix + 1.0
    knot = cells_of(at_s, middle)
    fraction, rows = (middle - at_s[knot]) / np.diff(at_s)[knot], np.arange(len(middle))
    matrix[rows, knot], matrix[rows, knot + 1] = 1.0 - fraction, fraction
    return matrix


def stationary_disturbance(density_1_s: float, correlation_s: float) -> Disturbance:
    """Stationary Gauss-Markov disturbance by its density: sigma^2 = q tau / 2.

    density_1_s : q, variance that the driving noise adds in a second [1/s];  correlation_s : tau [s]

    Derived in docs/theory/filter.md, equation 3.
    """
    return Disturbance.gauss_markov(math.sqrt(0.5 * density_1_s * correlation_s), correlation_s)


def process_precision(time_s: FloatArray, disturbance: Disturbance) -> tuple[FloatArray, float]:
    """Inverse covariance Q of a first-order Gauss-Markov process at the knots, and the logarithm of its determinant.

        sigma^2 Q_jj = 1 / f_(j-1) + a_j^2 / f_j,    sigma^2 Q_j,j+1 = -a_j / f_j,    a = exp(-dt / tau),  f = 1 - a^2

    time_s      : (knot,) increasing [s];  disturbance : stationary, with sigma [-] and tau [s]
    returns     : (knot, knot) tridiagonal [-]; log det Q

    Derived in docs/theory/residual_heating.md, equation 5.
    """
    decay = np.exp(-np.diff(time_s) / disturbance.correlation_s)
    # expm1, since knots that are close in units of tau leave 1 - a^2 few digits.
    free = -np.expm1(-2.0 * np.diff(time_s) / disturbance.correlation_s)
    Q = np.diag(np.append(1.0, 1.0 / free) + np.append(decay**2 / free, 0.0))
    rows = np.arange(len(decay))
    Q[rows, rows + 1] = Q[rows + 1, rows] = -decay / free
    variance = disturbance.start_sigma**2
    return Q / variance, float(-np.sum(np.log(free)) - len(time_s) * math.log(variance))


@dataclass(frozen=True, eq=False)
class _MarchedInput:
    """March at one value u of the unknowns: start, then knots.

    response_matrix : (reading, unknown) derivative of the readings at a nearby value, where that is accurate enough
    """

    u: FloatArray
    response: Response
    scored: Likelihood
    response_matrix: FloatArray | None

    @property
    def log_likelihood(self) -> float:
        return float(np.sum(self.scored.log_likelihood))


class _InverseProblem:
    """The readings of one point as a function of its start and of what is added to its ratio."""

    def __init__(self, track: FilterTrack, time_s: FloatArray, histories: FloatArray) -> None:
        self.track, self.knots = track, knot_times(time_s, MAX_KNOTS)
        self.weights = interpolation_weights(0.5 * (time_s[1:] + time_s[:-1]), self.knots)
        self.coarse = knot_times(time_s, MAX_COARSE_KNOTS)
        self.to_coarse = interpolation_weights(self.knots, self.coarse)
        self.march = ResponseMarch([track], time_s, histories)
        declared_K = track.initial_K
        self.initial_K = (
            initial_temperatures(track.model.construction, track.mesh) if declared_K is None else declared_K
        )
        self.start = _covariance_factor(track.covariance_K2, track.mesh.nodes)
        self.extra = self.start.shape[1]
        s = track.samples
        self.observed, self.sigma_K = ReadingIntervals(s.lower_K, s.upper_K), np.sqrt(s.variance_K2)

    def at(self, u: FloatArray, response_matrix: FloatArray | None = None) -> _MarchedInput:
        """March at u; without its own derivative where one that is accurate enough there is given."""
        added, start = self.weights @ u[self.extra :], self.initial_K + self.start @ u[: self.extra]
        response = self.march.respond([added], [start], derivative=response_matrix is None)[0]
        return _MarchedInput(u, response, likelihood(self.observed, response.read_K, self.sigma_K), response_matrix)

    def solve(self, disturbance: Disturbance | None) -> UnknownInput:
        here = first = self.at(np.zeros(self.extra + len(self.knots)))
        chosen, factor, change = disturbance or Disturbance(), 1.0, math.inf
        for _ in range(MAX_ROUNDS):
            G = here.response.matrix(self.weights, self.start) if here.response_matrix is None else here.response_matrix
            A = G.T @ (here.scored.information[:, np.newaxis] * G)
            b = G.T @ here.scored.score + A @ here.u
            if here is first:
                begun = A, b
            # The noise model depends on the linearisation: it is estimated again only while the readings still change.
            if disturbance is None and (change > MODEL_FIXED or factor > 1.0):
                chosen, factor = self._most_likely(here, A, b, None if here is first else chosen, factor)
            step = self._mean(A / factor, b / factor, chosen) - here.u
            change = float(np.max(np.abs(G @ step) / self._noise_K)) / math.sqrt(factor)
            # Near the end the derivative hardly changes, and a march without it costs a fraction of one with it.
            same = G if change < MODEL_FIXED else None
            there = None if change < CONVERGED else self._line_search(here, step, chosen, factor, same)
            if there is None:
                break
            here = there
        without = self._log_marginal(first, begun[0] / factor, begun[1] / factor, None, factor)
        mean = here.u + (step if change < CONVERGED else 0.0)
        return self._result(here, mean, G, A / factor, b / factor, chosen, factor, without)

    @property
    def _noise_K(self) -> FloatArray:
        width = self.observed.upper_K - self.observed.lower_K
        return np.sqrt(self.sigma_K**2 + np.where(np.isfinite(width), width, 0.0) ** 2 / 12.0)

    def _line_search(
        self,
        here: _MarchedInput,
        step: FloatArray,
        chosen: Disturbance,
        factor: float,
        response_matrix: FloatArray | None,
    ) -> _MarchedInput | None:
        """March after the largest fraction of a step that raises likelihood times prior; None where no fraction
        does.
        """
        Q, _ = self._prior(self.knots, chosen)

        def value(p: _MarchedInput) -> float:
            return p.log_likelihood / factor - 0.5 * float(p.u @ Q @ p.u)

        fraction, now = 1.0, value(here)
        while fraction > MIN_STEP_FRACTION:
            try:
                there = self.at(here.u + fraction * step, response_matrix)
            except RunError:
                # A history that takes a temperature out of range: a shorter step than after a mere decrease.
                fraction *= 0.25
                continue
            if value(there) > now:
                return there if value(there) > now + MIN_IMPROVEMENT else None
            fraction *= 0.4
        return None

    def _prior(self, at_s: FloatArray, chosen: Disturbance) -> tuple[FloatArray, float]:
        """Precision of start and knots and the logarithm of its determinant."""
        knot_precision, log_det = process_precision(at_s, chosen)
        Q = np.eye(self.extra + len(at_s))
        Q[self.extra :, self.extra :] = knot_precision
        return Q, log_det

    def _mean(self, A: FloatArray, b: FloatArray, chosen: Disturbance) -> FloatArray:
        return np.asarray(cho_solve(cho_factor(A + self._prior(self.knots, chosen)[0]), b))

    def _most_likely(
        self, here: _MarchedInput, A: FloatArray, b: FloatArray, last: Disturbance | None, factor: float
    ) -> tuple[Disturbance, float]:
        """Noise model of the correction, and the variance of the readings' noise over the declared one."""
        from scipy.optimize import minimize  # slow to import

        low = np.log([DENSITIES_1_S[0], float(np.min(np.diff(self.coarse), initial=np.inf))])
        high = np.log([DENSITIES_1_S[1], float(np.ptp(self.coarse))])
        if np.any(low >= high):
            raise InputError(f"{self.track.model.name}: a march of {len(self.knots)} knots is too short for an input")
        # Readings without information (lost, or deep inside an open word) have none on the noise.
        n = float(np.count_nonzero(here.scored.information > 0.0))
        unexplained = 2.0 * (self._log_exact_fit - here.log_likelihood + float(b @ here.u)) - float(here.u @ A @ here.u)
        # The evidence is computed some sixty times; its cost grows as the cube of the knots.
        P = block_diag(np.eye(self.extra), self.to_coarse)
        fine, (A, b) = (A, b), (P.T @ A @ P, P.T @ b)

        def variance_factor_of(explained: float) -> float:
            variance_factor = (unexplained - 2.0 * explained) / n
            return variance_factor if variance_factor > MIN_VARIANCE_FACTOR else 1.0

        def cost(logs: Sequence[float]) -> float:
            """Minus log evidence; the density is that over the factor."""
            q, tau = np.exp(np.clip(logs, low, high))
            explained, volume = _log_evidence(A, b, *self._prior(self.coarse, stationary_disturbance(q, tau)))
            s2 = variance_factor_of(explained)
            return 0.5 * n * math.log(s2) + 0.5 * (unexplained - 2.0 * explained) / s2 - volume

        if last is None:
            tau = float(np.clip(math.log(CORRELATION_S), low[1], high[1]))
            tried = [[q, tau] for q in np.linspace(low[0], high[0], DENSITIES_SCANNED)]
            start, stride = np.array(min(tried, key=cost)), 1.0
        else:
            start, stride = np.log([last.density_1_s / factor, last.correlation_s]), 0.4
        inward = np.where(start + stride > high, -stride, stride)
        # Away from the upper bounds: the objective is clipped there, and a flat simplex would stop at once.
        simplex = start + np.array([[0.0, 0.0], [inward[0], 0.0], [0.0, inward[1]]])
        optimum = minimize(
            cost,
            start,
            method="Nelder-Mead",
            options={"initial_simplex": simplex, "fatol": LIKELIHOOD_TOLERANCE, "xatol": 0.1, "maxfev": 60},
        )
        q, tau = np.exp(np.clip(optimum.x, low, high))
        # Again on all knots: changes that a coarse history cannot follow would count as noise.
        factor = variance_factor_of(
            _log_evidence(*fine, *self._prior(self.knots, stationary_disturbance(float(q), float(tau))))[0]
        )
        return stationary_disturbance(float(q) * factor, float(tau)), factor

    @property
    def _log_exact_fit(self) -> float:
        """Log likelihood of readings equal to their predictions."""
        middle = self.observed.centre_K
        inner = np.isfinite(middle)
        return float(np.sum(likelihood(self.observed.select(inner), middle[inner], self.sigma_K[inner]).log_likelihood))

    def _log_marginal(
        self, here: _MarchedInput, A: FloatArray, b: FloatArray, chosen: Disturbance | None, factor: float
    ) -> float:
        """Laplace's log marginal likelihood about a march; with None, of the start alone."""
        u = here.u
        constant = here.log_likelihood / factor - float(b @ u) + 0.5 * float(u @ A @ u)
        if chosen is not None:
            return constant + sum(_log_evidence(A, b, *self._prior(self.knots, chosen)))
        if self.extra == 0:
            return here.log_likelihood / factor
        start = slice(self.extra)
        return constant + sum(_log_evidence(A[start, start], b[start], np.eye(self.extra), 0.0))

    def _result(
        self,
        here: _MarchedInput,
        u: FloatArray,
        G: FloatArray,
        A: FloatArray,
        b: FloatArray,
        chosen: Disturbance,
        factor: float,
        without: float,
    ) -> UnknownInput:
        full = np.asarray(np.linalg.inv(A + self._prior(self.knots, chosen)[0]), dtype=np.float64)
        covariance = full[self.extra :, self.extra :]
        sigma = np.sqrt(np.diag(covariance))
        information, score = _without_start(A, b, self.extra)
        spacing = np.min(np.diff(self.knots), initial=np.inf)
        bandwidth = np.minimum(bandwidth_Hz(chosen, sigma), 0.5 / spacing)
        half_amplitude = half_amplitude_Hz(self.knots, information, covariance)
        gain = self._log_marginal(here, A, b, chosen, factor) - without
        response, scored = here.response, here.scored
        readings = (response.temperature_K, response.read_K, G[:, self.extra :])
        of_readings = (scored.score / factor, scored.information / factor)
        size = (u[self.extra :], sigma, bandwidth, half_amplitude)
        of_knots = (information, score, covariance)
        return UnknownInput(self.knots, *size, chosen, factor, gain, *readings, *of_readings, *of_knots)


def _log_evidence(A: FloatArray, b: FloatArray, Q: FloatArray, log_det_Q: float) -> tuple[float, float]:
    """b' (A + Q)^-1 b / 2 and (log det Q - log det (A + Q)) / 2."""
    factor, bad = lapack.dpotrf((A + Q).T, lower=1, overwrite_a=1)
    if bad:
        return -math.inf, -math.inf
    solved, _ = lapack.dpotrs(factor, b, lower=1)
    return 0.5 * float(b @ solved), 0.5 * log_det_Q - float(np.sum(np.log(np.diag(factor))))


def _without_start(A: FloatArray, b: FloatArray, extra: int) -> tuple[FloatArray, FloatArray]:
    """Information and score of the knots, the start N(0, 1) integrated out."""
    of_knots, cross = A[extra:, extra:], A[extra:, :extra]
    gain = cross @ np.linalg.inv(A[:extra, :extra] + np.eye(extra))
    return of_knots - gain @ cross.T, b[extra:] - gain @ b[:extra]


def _covariance_factor(covariance_K2: FloatArray | None, nodes: int) -> FloatArray:
    """(node, k) of which the square is a covariance, as few columns as it has directions."""
    if covariance_K2 is None:
        return np.zeros((nodes, 0))
    # Not Cholesky: a covariance smooth in depth is singular to rounding.
    values, vectors = np.linalg.eigh(covariance_K2)
    there = values > 1e-12 * max(values[-1], 1e-300)
    return np.asarray(vectors[:, there] * np.sqrt(values[there]))
