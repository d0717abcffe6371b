"""Likelihood of thermocouple samples given what the model predicts: of a reading, or of the word it was rounded to.

With indicated temperature y ~ N(m, sigma^2), m the model's prediction after calibration,

    unrounded sample    log L = log N(y; m, sigma^2)
    recorder word       log L = log [Phi((b - m) / sigma) - Phi((a - m) / sigma)],   y was in [a, b),

the interval open at either end of the word's span. The derivatives of the second are moments of the truncated normal
(interval.py): score E x / sigma, information (1 - var x) / sigma^2, between 0 and that of an unrounded sample, so that
log L is concave in m. The moments themselves are the update of a normal prior by a rounded sample: R. E. Curry,
"Estimation and Control with Quantized Measurements" (MIT Press, 1970).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import log_ndtr, ndtri_exp

from sim_heating.base.arrays import FloatArray
from sim_heating.base.errors import InputError
from sim_heating.base.kernels.truncated_normal import (
    GAIN,
    LOG_Z,
    MEAN,
    N_TERMS,
    SKEW,
    SPREAD,
    SQUARE,
    VARIANCE,
    expected_gain,
    fill_scores,
    fill_terms,
)
from sim_heating.thermal.stack import Sensor


@dataclass(frozen=True, eq=False)
class Observed:
    """Where the noisy indicated temperatures of a sensor lay.

    lower_K, upper_K : (sample,) ends of the interval [K]; equal where nothing was rounded, infinite at the ends of a
                       word's span, NaN for a lost sample
    """

    lower_K: FloatArray
    upper_K: FloatArray

    @property
    def lost(self) -> NDArray[np.bool_]:
        """(sample,) which samples were lost."""
        return np.isnan(self.lower_K)

    @property
    def within(self) -> NDArray[np.bool_]:
        """(sample,) which samples were neither lost nor at an end of the word's span."""
        return np.isfinite(self.upper_K - self.lower_K)

    def chosen(self, mask: NDArray[np.bool_]) -> Observed:
        """The samples that a mask (sample,) chooses."""
        return Observed(self.lower_K[mask], self.upper_K[mask])


def observed(sensor: Sensor, read_K: ArrayLike) -> Observed:
    """What readings [K] of a sensor tell of its indicated temperature; a reading between two codes is of the nearer."""
    read = np.asarray(read_K, dtype=float)
    if sensor.bits is None or sensor.range_K is None:
        return Observed(read, read)
    last = 2.0**sensor.bits - 1.0
    code = np.clip(np.rint((read - sensor.range_K[0]) / sensor.lsb_K), 0.0, last)
    lower = np.where(code == 0.0, -math.inf, sensor.range_K[0] + (code - 0.5) * sensor.lsb_K)
    upper = np.where(code == last, math.inf, sensor.range_K[0] + (code + 0.5) * sensor.lsb_K)
    return Observed(lower, upper)


@dataclass(frozen=True, eq=False)
class Likelihood:
    """Log likelihood of each sample and its derivatives; 0 for a lost sample, NaN where the prediction is NaN.

    Each has the shape that samples (sample,), predictions and sigma broadcast to.

    log_likelihood        : log density [1/K] of an unrounded sample, log probability of a word
    score                 : d/dm [1/K]
    information           : -d2/dm2 [1/K2], observed
    score_log_sigma       : d/d log sigma
    information_log_sigma : -d2/d log sigma 2, observed
    information_cross     : -d2/dm d log sigma [1/K], observed
    """

    log_likelihood: FloatArray
    score: FloatArray
    information: FloatArray
    score_log_sigma: FloatArray
    information_log_sigma: FloatArray
    information_cross: FloatArray


def likelihood(samples: Observed, mean_K: ArrayLike, sigma_K: ArrayLike) -> Likelihood:
    """Log likelihood, score and information of each sample for predictions mean_K and noise sigma_K [K].

    raises : InputError where sigma_K is not positive
    """
    terms, sigma = _terms(samples, mean_K, sigma_K)
    mean, square = terms[..., MEAN], terms[..., SQUARE]
    of_samples = {
        "log_likelihood": terms[..., LOG_Z],
        "score": mean / sigma,
        "information": terms[..., GAIN] / sigma**2,
        "score_log_sigma": square,
        "information_log_sigma": 2.0 * (square + 1.0) - terms[..., SPREAD],
        "information_cross": (2.0 * mean - terms[..., SKEW]) / sigma,
    }
    return Likelihood(**{name: np.where(samples.lost, 0.0, values) for name, values in of_samples.items()})


def scores(samples: Observed, mean_K: FloatArray, sigma_K: float) -> tuple[float, FloatArray, FloatArray]:
    """Sum of the log likelihoods of samples (sample,) with one noise; score [1/K] and information [1/K2] of each as
    `likelihood` gives them.

    raises : InputError where sigma_K is not positive
    """
    score, information = np.empty((2, len(mean_K)))
    total = fill_scores(samples.lower_K, samples.upper_K, mean_K, float(_positive(sigma_K)), score, information)
    return total, score, information


def log_likelihood(samples: Observed, mean_K: ArrayLike, sigma_K: ArrayLike) -> FloatArray:
    """Log likelihood of each sample alone, for a line search; 0 for a lost sample, NaN where the prediction is NaN."""
    terms, _ = _terms(samples, mean_K, sigma_K)
    return np.where(samples.lost, 0.0, terms[..., LOG_Z])


def updated(samples: Observed, mean_K: ArrayLike, sigma_K: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Mean [K] and variance [K2] of the noisy indicated temperature itself, N(mean_K, sigma_K^2) before the sample.

    With mean_K = H T and sigma_K^2 = S = H P H' + R a quantised Kalman update follows: T + K (mean - H T) and
    P - K (S - variance) K', K = P H' / S. Where nothing was rounded that is the plain update. NaN for a lost sample.
    """
    terms, sigma = _terms(samples, mean_K, sigma_K)
    return np.asarray(mean_K, dtype=float) + terms[..., MEAN] * sigma, terms[..., VARIANCE] * sigma**2


def expected_information(sensor: Sensor, mean_K: ArrayLike, sigma_K: ArrayLike) -> FloatArray:
    """Fisher information of a sample on its mean [1/K2], expected over what may be read: for bounds before a flight."""
    mean, sigma = np.broadcast_arrays(np.asarray(mean_K, dtype=float), _positive(sigma_K))
    if sensor.bits is None or sensor.range_K is None:
        return 1.0 / sigma**2
    edge, step = sensor.range_K[0] + 0.5 * sensor.lsb_K, sensor.lsb_K
    gain = [
        expected_gain((edge - m) / s, step / s, 2**sensor.bits - 1)
        for m, s in zip(mean.ravel(), sigma.ravel(), strict=True)
    ]
    return np.reshape(gain, mean.shape) / sigma**2


def quantile_residuals(
    samples: Observed, mean_K: ArrayLike, sigma_K: ArrayLike, rng: np.random.Generator
) -> FloatArray:
    """Residuals over sigma that are N(0, 1) for the true model though the samples were rounded; NaN for a lost sample.

    An unrounded sample gives (y - m) / sigma, a word the normal quantile of a uniform draw between the probabilities of
    its ends. Source: Dunn and Smyth, "Randomized Quantile Residuals", J. Comput. Graph. Stat. 5 (1996).
    """
    mean, sigma = np.asarray(mean_K, dtype=float), _positive(sigma_K)
    alpha, beta = (samples.lower_K - mean) / sigma, (samples.upper_K - mean) / sigma
    sign = np.where(alpha + beta > 0.0, -1.0, 1.0)  # the draw is made in the lower tail, where log Phi keeps its digits
    low, high = np.where(sign < 0.0, -beta, alpha), np.where(sign < 0.0, -alpha, beta)
    rounded = low < high
    draw = rng.random(alpha.shape)
    with np.errstate(invalid="ignore", divide="ignore"):
        logs = np.logaddexp(np.log(draw) + log_ndtr(high), np.log1p(-draw) + log_ndtr(low))
    return np.where(rounded, sign * np.clip(ndtri_exp(np.minimum(logs, 0.0)), low, high), alpha)


def _terms(samples: Observed, mean_K: ArrayLike, sigma_K: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """(..., 7) terms of interval.py for the broadcast samples, and sigma in their shape."""
    mean = np.asarray(mean_K, dtype=float)
    parts = np.broadcast_arrays(samples.lower_K, samples.upper_K, mean, _positive(sigma_K))
    lower, upper, mean, sigma = (np.array(p, order="C") for p in parts)
    terms = np.empty((mean.size, N_TERMS))
    fill_terms(lower.ravel(), upper.ravel(), mean.ravel(), sigma.ravel(), terms)
    return terms.reshape(*mean.shape, N_TERMS), sigma


def _positive(sigma_K: ArrayLike) -> FloatArray:
    sigma = np.asarray(sigma_K, dtype=float)
    if not np.all(sigma > 0.0):
        raise InputError(f"noise sigma of {np.min(sigma):g} K: must be above 0; declare or estimate noise_sigma_K")
    return sigma
