"""Measured temperatures to the heating that the model lacks: a correction history of the heating ratio with its sigma.

The inverse heat-conduction problem as Gaussian-process regression. The ratio carries a disturbance d, a first-order
Gauss-Markov process of covariance sigma^2 exp(-|t| / tau), linear between knots; all readings together are y = H(d) +
noise, H the march itself (estimation/filter/response.py). With A and b the information and score of the readings about
the d found,

    log L(d) = const + b' d - d' A d / 2,    mean (A + Q)^-1 b,    covariance (A + Q)^-1,

Q the tridiagonal precision of the process; the march is linearised anew until the readings no longer move. What
regularises is the noise model: of the density q = 2 sigma^2 / tau and the correlation time tau, those of the largest
marginal likelihood are taken,

    log p(y) = const + b' (A + Q)^-1 b / 2 + log det Q / 2 - log det (A + Q) / 2.

Recorder words count as intervals (estimation/inference/likelihood.py, Laplace's approximation).

Where no history explains the readings, sensors contradicting each other, the noise is larger than declared by a factor:
with S what the most probable history leaves, in variances of the N readings, log p then holds - N log(s) - S / (2 s^2)
and s^2 = S / N is the likeliest, never below 1.

Bandwidth: with v the variance that is left at a time, the frequency f above which the process has just this variance,

    v / sigma^2 = 1 - (2 / pi) atan(2 pi f tau),

not above half the rate of the knots: slower changes are seen as if all known, faster ones as if none. 0 where
the readings tell nothing. Half amplitude: the frequency at which a sine in the ratio comes back half as large.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag, cho_factor, cho_solve, lapack
from scipy.optimize import minimize

from sim_heating.base.arrays import FloatArray
from sim_heating.base.errors import InputError, RunError
from sim_heating.base.threads import one_thread
from sim_heating.estimation.filter.march import Disturbance, FilterTrack
from sim_heating.estimation.filter.response import Response, ResponseMarch
from sim_heating.estimation.inference.likelihood import Likelihood, Observed, likelihood
from sim_heating.march.point import initial_temperatures

DENSITIES_1_S = (1e-10, 1e-1)
"""Between these the density is looked for [1/s]: below, a ratio walks 3e-4 in a quarter of an hour."""
DENSITIES_TRIED = 10
CORRELATION_S = 30.0
"""Correlation time that the search starts from [s]; it ends between a spacing of knots and the length of the march."""
SEARCHED = 0.05
"""Log likelihood to which the search goes."""
MOST_KNOTS = 320
"""A march of more steps has a knot for several of them; faster changes within are not seen, nor in sigma."""
MOST_COARSE = 100
"""Knots on which density and correlation time are looked for."""
ROUNDS = 12
CHOSEN, SETTLED = 2.0, 0.2
"""Change of a reading over its noise below which noise model and derivatives stay as they are, and below which the
march is linear enough."""
EXCESS = 1.5
"""Noise is taken for larger than declared from this ratio of the variances on."""
GAINED, LEAST_SHARE = 0.1, 0.02
"""A step that gains less of the log posterior is none; parts of a step below the second are not tried."""
FREQUENCIES = 40


@dataclass(frozen=True, eq=False)
class UnknownInput:
    """The correction that the readings ask for.

    time_s       : (knot,) the correction is linear between them
    delta_ratio  : (knot,) what is to be added to the ratio, before effects that multiply it
    sigma        : (knot,) its standard deviation given all readings
    bandwidth_Hz : (knot,) frequency up to which it is resolved
    half_amplitude_Hz : frequency at which a sine throughout the march comes back half as large
    disturbance  : what the likelihood chose
    excess       : variance of the noise over the declared one, 1 where a history explains the readings
    gain_log_likelihood : log marginal likelihood above that without a disturbance
    temperature_K : (time, node) temperatures with the correction at the ends of the steps, the start first
    read_K       : (reading,) what the readings should show with it
    answer       : (reading, knot) how they answer to it
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
    excess: float
    gain_log_likelihood: float
    temperature_K: FloatArray
    read_K: FloatArray
    answer: FloatArray
    slope: FloatArray
    weight: FloatArray
    information: FloatArray
    score: FloatArray
    covariance: FloatArray


def unknown_input(
    track: FilterTrack, time_s: FloatArray, histories: FloatArray, disturbance: Disturbance | None = None
) -> UnknownInput:
    """The heating-ratio history that explains a point's readings.

    track       : the point with readings and start; its noise of the process and own disturbance are not used
    time_s      : (time,) steps [s];  histories : (flight, time, condition)
    disturbance : the stationary noise model of the correction; by the largest likelihood, where None
    raises      : InputError for a disturbance without correlation time, RunError where a step did not converge
    """
    if disturbance is not None and not (0.0 < disturbance.correlation_s < math.inf and disturbance.start_sigma > 0.0):
        raise InputError("unknown input: the disturbance must be stationary, its sigma and correlation time above 0")
    inverse = _Inverse(track, np.asarray(time_s, dtype=float), histories)
    with one_thread():
        return inverse.solved(disturbance)


def likeliest(track: FilterTrack, time_s: FloatArray, histories: FloatArray) -> Disturbance:
    """The stationary disturbance of the largest likelihood."""
    return unknown_input(track, time_s, histories).disturbance


def bandwidth_Hz(disturbance: Disturbance, sigma: FloatArray) -> FloatArray:
    """Frequency [Hz] above which the process has the variance that is left; of a random walk, q / (2 pi^2 v)."""
    left = np.maximum(sigma**2, 1e-300)
    if math.isinf(disturbance.correlation_s):
        return disturbance.density_1_s / (2.0 * np.pi**2 * left)
    stationary = 0.5 * disturbance.density_1_s * disturbance.correlation_s
    told = np.clip(1.0 - left / stationary, 0.0, 1.0 - 1e-12)
    return np.tan(0.5 * np.pi * told) / (2.0 * np.pi * disturbance.correlation_s)


def half_amplitude_Hz(time_s: FloatArray, information: FloatArray, covariance: FloatArray) -> float:
    """Frequency at which (A + Q)^-1 A leaves half of a sine; 0 where it leaves less of the slowest one."""
    span, spacing = np.ptp(time_s), np.median(np.diff(time_s))
    f = np.geomspace(1.0 / span, 0.5 / spacing, FREQUENCIES)
    waves = np.exp(2j * np.pi * np.outer(time_s, f))
    left = np.real(np.sum(np.conj(waves) * (covariance @ (information @ waves)), axis=0)) / len(time_s)
    below = np.flatnonzero(left < 0.5)
    if len(below) == 0:
        return float(f[-1])
    k = int(below[0])
    if k == 0:
        return 0.0
    part = (left[k - 1] - 0.5) / (left[k - 1] - left[k])
    return float(f[k - 1] * (f[k] / f[k - 1]) ** part)


def knots(time_s: FloatArray, most: int) -> FloatArray:
    """Middles of the steps, or of groups of as many steps as keep the knots at most so many."""
    steps = len(time_s) - 1
    ends = time_s[np.unique(np.append(np.arange(0, steps, math.ceil(steps / most)), steps))]
    return 0.5 * (ends[1:] + ends[:-1])


def weights(time_s: FloatArray, at_s: FloatArray) -> FloatArray:
    """(time, knot) of a correction that is linear between knots and held before the first and behind the last."""
    middle = np.clip(time_s, at_s[0], at_s[-1])
    found = np.zeros((len(middle), len(at_s)))
    if len(at_s) == 1:
        return found + 1.0
    left = np.clip(np.searchsorted(at_s, middle, side="right") - 1, 0, len(at_s) - 2)
    part, rows = (middle - at_s[left]) / np.diff(at_s)[left], np.arange(len(middle))
    found[rows, left], found[rows, left + 1] = 1.0 - part, part
    return found


def stationary(density_1_s: float, correlation_s: float) -> Disturbance:
    """A Gauss-Markov disturbance by its density."""
    return Disturbance.gauss_markov(math.sqrt(0.5 * density_1_s * correlation_s), correlation_s)


def precision(time_s: FloatArray, disturbance: Disturbance) -> tuple[FloatArray, float]:
    """(knot, knot) inverse covariance of the process at the knots, and the logarithm of its determinant."""
    decay = np.exp(-np.diff(time_s) / disturbance.correlation_s)
    free = -np.expm1(-2.0 * np.diff(time_s) / disturbance.correlation_s)
    Q = np.diag(np.append(1.0, 1.0 / free) + np.append(decay**2 / free, 0.0))
    rows = np.arange(len(decay))
    Q[rows, rows + 1] = Q[rows + 1, rows] = -decay / free
    variance = disturbance.start_sigma**2
    return Q / variance, float(-np.sum(np.log(free)) - len(time_s) * math.log(variance))


@dataclass(frozen=True, eq=False)
class _Point:
    """A march at one value u of the unknowns: start, then knots.

    answer : (reading, unknown) derivative of the readings at another value, where that is good enough
    """

    u: FloatArray
    response: Response
    scored: Likelihood
    answer: FloatArray | None

    @property
    def log_likelihood(self) -> float:
        return float(np.sum(self.scored.log_likelihood))


class _Inverse:
    """The readings of one point as a function of its start and of what is added to its ratio."""

    def __init__(self, track: FilterTrack, time_s: FloatArray, histories: FloatArray) -> None:
        self.track, self.knots = track, knots(time_s, MOST_KNOTS)
        self.weights = weights(0.5 * (time_s[1:] + time_s[:-1]), self.knots)
        self.coarse = knots(time_s, MOST_COARSE)
        self.to_coarse = weights(self.knots, self.coarse)
        self.march = ResponseMarch([track], time_s, histories)
        known = track.initial_K
        self.initial_K = initial_temperatures(track.model.construction, track.mesh) if known is None else known
        self.start = _factor(track.covariance_K2, track.mesh.nodes)
        self.extra = self.start.shape[1]
        s = track.samples
        self.observed, self.sigma_K = Observed(s.lower_K, s.upper_K), np.sqrt(s.variance_K2)

    def at(self, u: FloatArray, answer: FloatArray | None = None) -> _Point:
        """The march at u; with an answer that is good enough there, without its own."""
        added, start = self.weights @ u[self.extra :], self.initial_K + self.start @ u[: self.extra]
        response = self.march.respond([added], [start], derivative=answer is None)[0]
        return _Point(u, response, likelihood(self.observed, response.read_K, self.sigma_K), answer)

    def solved(self, given: Disturbance | None) -> UnknownInput:
        here = first = self.at(np.zeros(self.extra + len(self.knots)))
        chosen, excess, change = given or Disturbance(), 1.0, math.inf
        for _ in range(ROUNDS):
            G = here.response.matrix(self.weights, self.start) if here.answer is None else here.answer
            A = G.T @ (here.scored.information[:, np.newaxis] * G)
            b = G.T @ here.scored.score + A @ here.u
            if here is first:
                begun = A, b
            if given is None and (change > CHOSEN or excess > 1.0):
                chosen, excess = self._likeliest(here, A, b, None if here is first else chosen, excess)
            step = self._mean(A / excess, b / excess, chosen) - here.u
            change = float(np.max(np.abs(G @ step) / self._noise_K)) / math.sqrt(excess)
            same = G if change < CHOSEN else None
            there = None if change < SETTLED else self._advanced(here, step, chosen, excess, same)
            if there is None:
                break
            here = there
        without = self._log_marginal(first, begun[0] / excess, begun[1] / excess, None, excess)
        mean = here.u + (step if change < SETTLED else 0.0)
        return self._result(here, mean, G, A / excess, b / excess, chosen, excess, without)

    @property
    def _noise_K(self) -> FloatArray:
        width = self.observed.upper_K - self.observed.lower_K
        return np.sqrt(self.sigma_K**2 + np.where(np.isfinite(width), width, 0.0) ** 2 / 12.0)

    def _advanced(
        self, here: _Point, step: FloatArray, chosen: Disturbance, excess: float, answer: FloatArray | None
    ) -> _Point | None:
        """The march after as much of a step as raises likelihood times prior; None where no part of it does."""
        Q, _ = self._prior(self.knots, chosen)

        def value(p: _Point) -> float:
            return p.log_likelihood / excess - 0.5 * float(p.u @ Q @ p.u)

        share, now = 1.0, value(here)
        while share > LEAST_SHARE:
            try:
                there = self.at(here.u + share * step, answer)
            except RunError:
                share *= 0.25
                continue
            if value(there) > now:
                return there if value(there) > now + GAINED else None
            share *= 0.4
        return None

    def _prior(self, at_s: FloatArray, chosen: Disturbance) -> tuple[FloatArray, float]:
        """Precision of start and knots and the logarithm of its determinant."""
        own, log_det = precision(at_s, chosen)
        Q = np.eye(self.extra + len(at_s))
        Q[self.extra :, self.extra :] = own
        return Q, log_det

    def _mean(self, A: FloatArray, b: FloatArray, chosen: Disturbance) -> FloatArray:
        return np.asarray(cho_solve(cho_factor(A + self._prior(self.knots, chosen)[0]), b))

    def _likeliest(
        self, here: _Point, A: FloatArray, b: FloatArray, last: Disturbance | None, excess: float
    ) -> tuple[Disturbance, float]:
        """Noise model of the correction, and the noise of the readings over what is declared."""
        low = np.log([DENSITIES_1_S[0], float(np.min(np.diff(self.coarse), initial=np.inf))])
        high = np.log([DENSITIES_1_S[1], float(np.ptp(self.coarse))])
        if np.any(low >= high):
            raise InputError(f"{self.track.model.name}: a march of {len(self.knots)} knots is too short for an input")
        n = float(np.count_nonzero(here.scored.information > 0.0))
        left = 2.0 * (self._log_perfect - here.log_likelihood + float(b @ here.u)) - float(here.u @ A @ here.u)
        P = block_diag(np.eye(self.extra), self.to_coarse)
        fine, (A, b) = (A, b), (P.T @ A @ P, P.T @ b)

        def excess_of(explained: float) -> float:
            share = (left - 2.0 * explained) / n
            return share if share > EXCESS else 1.0

        def cost(logs: Sequence[float]) -> float:
            """Minus log evidence; the density is one over the excess."""
            q, tau = np.exp(np.clip(logs, low, high))
            explained, volume = _log_evidence(A, b, *self._prior(self.coarse, stationary(q, tau)))
            s2 = excess_of(explained)
            return 0.5 * n * math.log(s2) + 0.5 * (left - 2.0 * explained) / s2 - volume

        if last is None:
            tau = float(np.clip(math.log(CORRELATION_S), low[1], high[1]))
            tried = [[q, tau] for q in np.linspace(low[0], high[0], DENSITIES_TRIED)]
            start, stride = np.array(min(tried, key=cost)), 1.0
        else:
            start, stride = np.log([last.density_1_s / excess, last.correlation_s]), 0.4
        inward = np.where(start + stride > high, -stride, stride)
        simplex = start + np.array([[0.0, 0.0], [inward[0], 0.0], [0.0, inward[1]]])
        found = minimize(
            cost, start, method="Nelder-Mead",
            options={"initial_simplex": simplex, "fatol": SEARCHED, "xatol": 0.1, "maxfev": 60},
        )  # fmt: skip
        q, tau = np.exp(np.clip(found.x, low, high))
        excess = excess_of(_log_evidence(*fine, *self._prior(self.knots, stationary(float(q), float(tau))))[0])
        return stationary(float(q) * excess, float(tau)), excess

    @property
    def _log_perfect(self) -> float:
        """Log likelihood of readings that are just what they should be."""
        middle = 0.5 * (self.observed.lower_K + self.observed.upper_K)
        inner = np.isfinite(middle)
        within = Observed(self.observed.lower_K[inner], self.observed.upper_K[inner])
        return float(np.sum(likelihood(within, middle[inner], self.sigma_K[inner]).log_likelihood))

    def _log_marginal(
        self, here: _Point, A: FloatArray, b: FloatArray, chosen: Disturbance | None, excess: float
    ) -> float:
        """Laplace's log marginal likelihood about a march; with None, of the start alone."""
        u = here.u
        constant = here.log_likelihood / excess - float(b @ u) + 0.5 * float(u @ A @ u)
        if chosen is not None:
            return constant + sum(_log_evidence(A, b, *self._prior(self.knots, chosen)))
        if self.extra == 0:
            return here.log_likelihood / excess
        own = slice(self.extra)
        return constant + sum(_log_evidence(A[own, own], b[own], np.eye(self.extra), 0.0))

    def _result(
        self, here: _Point, u: FloatArray, G: FloatArray, A: FloatArray, b: FloatArray, chosen: Disturbance,
        excess: float, without: float,
    ) -> UnknownInput:  # fmt: skip
        whole = np.asarray(np.linalg.inv(A + self._prior(self.knots, chosen)[0]), dtype=np.float64)
        covariance = whole[self.extra :, self.extra :]
        sigma = np.sqrt(np.diag(covariance))
        information, score = _without_start(A, b, self.extra)
        spacing = np.min(np.diff(self.knots), initial=np.inf)
        return UnknownInput(
            self.knots, u[self.extra :], sigma, np.minimum(bandwidth_Hz(chosen, sigma), 0.5 / spacing),
            half_amplitude_Hz(self.knots, information, covariance), chosen, excess,
            self._log_marginal(here, A, b, chosen, excess) - without, here.response.temperature_K, here.response.read_K,
            G[:, self.extra :], here.scored.score / excess, here.scored.information / excess, information, score,
            covariance,
        )  # fmt: skip


def _log_evidence(A: FloatArray, b: FloatArray, Q: FloatArray, log_det_Q: float) -> tuple[float, float]:
    """b' (A + Q)^-1 b / 2 and (log det Q - log det (A + Q)) / 2."""
    factor, bad = lapack.dpotrf((A + Q).T, lower=1, overwrite_a=1)
    if bad:
        return -math.inf, -math.inf
    solved, _ = lapack.dpotrs(factor, b, lower=1)
    return 0.5 * float(b @ solved), 0.5 * log_det_Q - float(np.sum(np.log(np.diag(factor))))


def _without_start(A: FloatArray, b: FloatArray, extra: int) -> tuple[FloatArray, FloatArray]:
    """Information and score of the knots, the start N(0, 1) integrated out."""
    own, cross = A[extra:, extra:], A[extra:, :extra]
    gain = cross @ np.linalg.inv(A[:extra, :extra] + np.eye(extra))
    return own - gain @ cross.T, b[extra:] - gain @ b[:extra]


def _factor(covariance_K2: FloatArray | None, nodes: int) -> FloatArray:
    """(node, k) of which the square is a covariance, as few columns as it has directions."""
    if covariance_K2 is None:
        return np.zeros((nodes, 0))
    values, vectors = np.linalg.eigh(covariance_K2)
    there = values > 1e-12 * max(values[-1], 1e-300)
    return np.asarray(vectors[:, there] * np.sqrt(values[there]))
