"""What readings say of the size of the error of their model, about a fitted model that is linear in its parameters.

With the residuals r, the sensitivities J and the responses S to the heating's error, all times the root of the
readings' information (equation 5f of docs/theory/model_error.md), S = Q B' has as many orthonormal columns Q as the
readings distinguish. The covariance C of equation 5 there is then 1 + s^2 Q K Q', with K = B' R B and R the correlation
matrix of the knots. Its eigenvalues k and eigenvectors V give

    C^-1 = (1 - Q Q') + Q V diag(1 / (1 + s^2 k)) V' Q',

two parts that are both positive, so that nothing is lost where the error takes up nearly all of a residual.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from sim_heating.base.arrays import BoolArray, FloatArray
from sim_heating.estimation.inference.breaks import ReadError, log_prior, with_breaks
from sim_heating.estimation.inference.error_likelihood import scored, scored_readings
from sim_heating.estimation.inference.model_error import AS_STATED, Correlation, ErrorSize, HeatingErrorPrior
from sim_heating.estimation.record_fit import LEAST_SEEN, PredictedSamples, RecordFit

SIZES_APART = 2
"""Places in the grid of sizes from one at which breaks are sought to the next."""
JITTER = 4.0 * float(np.finfo(float).eps)
"""Added to the diagonal of a scaled information for each of its unknowns, which no reading may tell [-]."""


def error_size(
    record_fit: RecordFit,
    samples: Sequence[PredictedSamples],
    towards_prior: tuple[FloatArray, FloatArray],
    free: BoolArray,
    prior: HeatingErrorPrior,
    scales: Mapping[float, float] = AS_STATED,
    of_flight: BoolArray | None = None,
    *,
    may_break: bool = False,
    held_out: Sequence[PredictedSamples] = (),
) -> ErrorSize:
    """What the readings say of the size of the heating's error and of the flight's, about a fitted model.

    record_fit    : the record with its error;  samples : its channels at the values of the fit, with sensitivities
    towards_prior : (parameter,) prior information of the parameters, and the distance of the means of their priors
    free          : (parameter,) whether a parameter may move from its value
    prior         : of the size
    scales        : factor on the standard deviations of the flight as stated [-] -> its prior probability [-]
    of_flight     : (parameter,) whether its prior is one of these standard deviations; None for no parameter
    may_break     : whether the error may start anew at some times, which are sought
    held_out      : the channels over readings that are not fitted, which count as well

    The model is linear in its parameters here, and a rounded reading counts as one with the noise of its rounding.
    Source: docs/theory/model_error.md, equations 5, 5a, 5c and 5d.
    """
    error = record_fit.model_error
    assert error is not None  # the caller's records have one
    may_break &= prior.relative > 0.0
    sizes, correlations, weights = prior.grid(may_break=may_break)
    seen = _seen(record_fit, samples, held_out, towards_prior, free, scales, of_flight, sizes)
    of_scale = np.log(list(scales.values()))[:, np.newaxis]
    entries: dict[Correlation, tuple[FloatArray, FloatArray]] = {}
    for correlation, weight in zip(correlations, weights, strict=True):
        of_prior = of_scale + weight
        if not may_break or correlation.smooth:
            entries[correlation] = seen.log_likelihood(correlation), of_prior
            continue
        start = replace(correlation, breaks_s=error.correlation.breaks_s)
        told = {seen.with_breaks(c, of_prior) for c in {correlation, start}}
        told |= {start} & {correlation, error.correlation}  # without breaks, or with those that the error has now
        for entry in sorted(told, key=lambda e: e.breaks_s):
            entries[entry] = seen.log_likelihood(entry), of_prior + log_prior(error.time_s, entry.breaks_s)
    likelihoods, of_priors = zip(*entries.values(), strict=True)
    return ErrorSize(
        sizes, tuple(entries), np.array(list(scales)), np.stack(likelihoods, axis=1), np.stack(of_priors, axis=1)
    )


@dataclass(frozen=True, eq=False)
class _SeenError:
    """What readings tell of the heating's error and of all other unknowns, times the root of their information.

    knots_s : (knot,) of the heating's error [s];  sizes : (size,) its standard deviations [-]
    root    : (knot, mode) B;  residual : (mode,) Q' r;  others : (mode, unknown) Q' J
    beside  : (unknown, unknown), (unknown,) and a number: J' J, J' r and r' r - 2 c of what is orthogonal to Q
    known   : (scale, unknown) information of the priors of the others;  distance : (unknown,) of their means
    drawn   : of the others, those that are the error's: the first ones;  log_scale : (scale,) sum of the logarithms of
              the factors on their standard deviations [-]

    Source: docs/theory/model_error.md, equation 5.
    """

    knots_s: FloatArray
    sizes: FloatArray
    root: FloatArray
    residual: FloatArray
    others: FloatArray
    beside: tuple[FloatArray, FloatArray, float]
    known: FloatArray
    distance: FloatArray
    drawn: int
    log_scale: FloatArray
    _log_likelihoods: dict[Correlation, FloatArray] = field(default_factory=dict, init=False)

    def log_likelihood(self, correlation: Correlation) -> FloatArray:
        """(scale, size) log likelihood, largest over the parameters, the errors integrated out [-]; worked out once.

        Source: docs/theory/model_error.md, equation 5.
        """
        if correlation not in self._log_likelihoods:
            self._log_likelihoods[correlation] = self._log_likelihood(correlation)
        return self._log_likelihoods[correlation]

    def _log_likelihood(self, correlation: Correlation) -> FloatArray:
        """(scale, size) as `log_likelihood`."""
        eigenvalues, V = np.linalg.eigh(self.root.T @ correlation.matrix(self.knots_s) @ self.root)
        added = self.sizes[:, np.newaxis] ** 2 * np.maximum(eigenvalues, 0.0)
        left = 1.0 / (1.0 + added)
        r, J = V.T @ self.residual, V.T @ self.others
        JJ, Jr, rr = self.beside
        M_read, g_read = JJ + (J.T * left[:, np.newaxis]) @ J, Jr + (left * r) @ J
        square_read = rr + left @ r**2 + np.sum(np.log1p(added), axis=1)
        known = self.known[:, np.newaxis]  # (scale, size, unknown)
        square = square_read + known @ self.distance**2
        lower = _root(M_read + known[..., np.newaxis] * np.eye(len(Jr)))
        gained = np.linalg.solve(lower, (g_read + known * self.distance)[..., np.newaxis])[..., 0]
        of_drawn = np.log(np.diagonal(lower, axis1=-2, axis2=-1))[..., : self.drawn]
        volume = 2.0 * (np.sum(of_drawn, axis=-1) + self.log_scale[:, np.newaxis])
        return np.asarray(-0.5 * (square - np.sum(gained**2, axis=-1) + volume))

    def with_breaks(self, correlation: Correlation, log_weight: FloatArray) -> Correlation:
        """A correlation with breaks as long as one more gains, at the size at which both gain most.

        log_weight : (scale, size) of the prior of both [-]

        With breaks a smaller size is more probable. They are sought at the most probable one without them, and at
        smaller ones as long as that is better. Source: docs/theory/model_error.md, equations 5c and 5d.
        """
        posterior = self.log_likelihood(correlation) + log_weight
        j, largest = np.unravel_index(int(np.argmax(posterior)), posterior.shape)
        best, likeliest = -math.inf, correlation
        for k in range(int(largest), -1, -SIZES_APART):
            gained, broken = with_breaks(self._read[j], self.knots_s, correlation, float(self.sizes[k]))
            if posterior[j, k] + gained <= best:
                break
            best, likeliest = posterior[j, k] + gained, broken
        return likeliest

    @cached_property
    def _read(self) -> list[ReadError]:
        """(scale,) what the readings say of the values at the knots, all else integrated out: equation 5d."""
        JJ, Jr, _ = self.beside
        each, X = [], self.others
        for known in self.known:
            lower = _root(JJ + X.T @ X + np.diag(known))
            white = np.linalg.solve(lower, X.T)
            mean = np.linalg.solve(lower, Jr + X.T @ self.residual + known * self.distance)
            of_readings = np.eye(len(X)) - white.T @ white
            information = self.root @ of_readings @ self.root.T
            each.append(ReadError(information, self.root @ (self.residual - white.T @ mean)))
        return each


def _root(information: FloatArray) -> FloatArray:
    """(..., unknown, unknown) lower roots of informations, each scaled to a diagonal of 1 for it."""
    diagonal = np.diagonal(information, axis1=-2, axis2=-1)
    scale = np.sqrt(np.where(diagonal > 0.0, diagonal, 1.0))
    count = information.shape[-1]
    scaled = information / (scale[..., np.newaxis] * scale[..., np.newaxis, :]) + count * JITTER * np.eye(count)
    return np.asarray(scale[..., np.newaxis] * np.linalg.cholesky(scaled))


def _quadratic(record_fit: RecordFit, samples: Sequence[PredictedSamples]) -> tuple[FloatArray, FloatArray, float]:
    """The log likelihood of fitted readings about their most probable error, to second order.

        sum_i log L_i(m_i + d) = c - sum_i (r_i - sqrt(W_i) d)^2 / 2

    record_fit : the record;  samples : its channels at the values of the fit
    returns    : (reading,) weights W [1/K2], 0 of one that tells nothing; (reading,) r [-]; c [-]

    Source: docs/theory/model_error.md, equation 5f.
    """
    least_weight = 1e-9  # of a word over the R^-1 of its readings [-]: within it the prediction may be anywhere
    assert record_fit.error_root_K is not None  # the caller's records have an error
    plain_K = [s.mean_K for s in samples]
    moved_K = record_fit.error_root_K @ scored_readings(record_fit, plain_K).error
    ends = np.cumsum(list(map(len, plain_K)))[:-1]
    total, v, W = scored(record_fit, [m + by for m, by in zip(plain_K, np.split(moved_K, ends), strict=True)])
    W = np.where(W * record_fit.reading_noise_K**2 > least_weight, W, 0.0)
    step = np.divide(v, np.sqrt(W), out=np.zeros_like(v), where=W > 0.0)
    return W, np.sqrt(W) * moved_K + step, total + 0.5 * float(step @ step)


def _whitening(root: FloatArray) -> tuple[Callable[[FloatArray], FloatArray], float]:
    """What multiplies values by C^(-1/2), and log det C / 2, of readings with the covariance C = 1 + E E' [-].

    root : (reading, unknown) E, of errors that neither the size of the heating's error nor that of the flight changes
    """
    U, s, _ = np.linalg.svd(root, full_matrices=False)
    taken = 1.0 - 1.0 / np.hypot(1.0, s)
    return lambda x: x - (U * taken) @ (U.T @ x), float(np.sum(np.log(np.hypot(1.0, s))))


def _seen(
    record_fit: RecordFit,
    samples: Sequence[PredictedSamples],
    held_out: Sequence[PredictedSamples],
    towards_prior: tuple[FloatArray, FloatArray],
    free: BoolArray,
    scales: Mapping[float, float],
    of_flight: BoolArray | None,
    sizes: FloatArray,
) -> _SeenError:
    """What the readings tell of both errors, with the arguments of `error_size` and (size,) sizes of the heating's [-].

    Directions of the heating's error that its largest size moves by less than `LEAST_SEEN` of the noise are left out.
    """
    error = record_fit.model_error
    assert error is not None  # the caller's records have one
    parts = [part.record_fit for part in (samples[0], *held_out[:1])]
    weight, r, fixed = _quadratic(record_fit, samples)
    if held_out:  # which may be many words off: a rounded reading counts as one with the noise of its rounding
        left_K = np.concatenate([s.channel.intervals.centre_K - s.mean_K for s in held_out])
        noise_K = parts[1].reading_noise_K
        weight = np.append(weight, np.where(np.isfinite(left_K), noise_K**-2.0, 0.0))
        r = np.append(r, left_K / noise_K)
    samples = [*samples, *held_out]
    S, F = (np.concatenate(of_parts) for of_parts in zip(*(part.error_responses_K for part in parts), strict=True))
    # parameters that the flight's error has are integrated out with it, and come next to it
    is_clock = np.zeros(len(free), dtype=bool) if of_flight is None else of_flight & free
    order = np.concatenate([np.flatnonzero(is_clock), np.flatnonzero(free & ~is_clock)])
    sensitivity = np.concatenate([s.sensitivity for s in samples])[:, order]
    is_read = weight > 0.0
    noise_K = 1.0 / np.sqrt(weight[is_read, np.newaxis])
    others = error.flight_K.shape[-1] - len(record_fit.flight_names)
    white, log_volume = _whitening(F[is_read, others:] / noise_K)
    r, S = white(r[is_read]), white(S[is_read] / noise_K)
    J = white(np.column_stack([F[:, :others], sensitivity])[is_read] / noise_K)
    drawn = others + int(np.count_nonzero(is_clock))
    factors = np.array(list(scales))[:, np.newaxis]
    wider = np.ones((len(scales), J.shape[1]))
    wider[:, :others] = factors / error.flight_scale
    wider[:, others:drawn] = factors
    Q, values, W = np.linalg.svd(S, full_matrices=False)
    is_seen = values * math.sqrt(len(error.time_s)) * sizes[-1] > LEAST_SEEN
    Q, B = Q[:, is_seen], W[is_seen].T * values[is_seen]
    Qr, QJ = Q.T @ r, Q.T @ J
    r, J = r - Q @ Qr, J - Q @ QJ
    return _SeenError(
        knots_s=error.time_s, sizes=sizes, root=B, residual=Qr, others=QJ,
        beside=(J.T @ J, J.T @ r, float(r @ r) - 2.0 * fixed + 2.0 * log_volume),
        known=np.append(np.ones(others), towards_prior[0][order]) / wider**2,
        distance=np.append(np.zeros(others), towards_prior[1][order]),
        drawn=drawn, log_scale=np.sum(np.log(wider), axis=1),
    )  # fmt: skip
