"""Likelihood of thermocouple samples for given predictions: of a reading, or of the recorder word it was rounded to.

With indicated temperature y ~ N(m, sigma^2), m the model's prediction after calibration [K],

    unrounded sample    log L = log N(y; m, sigma^2)
    recorder word       log L = log [Phi((b - m) / sigma) - Phi((a - m) / sigma)],   y was in [a, b),

the interval open at either end of the word's span. The derivatives of the second are moments of the truncated normal
(truncated_normal.py): score E x / sigma, information (1 - var x) / sigma^2, between 0 and that of an
unrounded sample, so that log L is concave in m. The moments themselves are the update of a normal prior by a rounded
sample: R. E. Curry, "Estimation and Control with Quantized Measurements" (MIT Press, 1970). Derived in
docs/theory/estimation_statistics.md, equations 3 to 12.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import log_ndtr, ndtri_exp

from sim_heating.base.arrays import FloatArray
from sim_heating.base.errors import InputError
from sim_heating.estimation.inference import truncated_normal
from sim_heating.thermal.stack import Sensor


@dataclass(frozen=True, eq=False)
class ReadingIntervals:
    """Intervals in which the noisy indicated temperatures of a sensor lay.

    lower_K, upper_K : (sample,) ends of the interval [K]; equal where nothing was rounded, infinite at the ends of a
                       word's span, NaN for a lost sample

    The interval of a recorder code is that of docs/theory/estimation_statistics.md, equation 4.
    """

    lower_K: FloatArray
    upper_K: FloatArray

    @property
    def is_lost(self) -> NDArray[np.bool_]:
        """(sample,) whether a sample was lost: its interval [K] is NaN."""
        return np.isnan(self.lower_K)

    @property
    def is_finite(self) -> NDArray[np.bool_]:
        """(sample,) whether the interval [K] of a sample is finite: neither lost nor at an end of the word's span."""
        return np.isfinite(self.upper_K - self.lower_K)

    @property
    def centre_K(self) -> FloatArray:
        """(sample,) middle of the interval [K]; not finite where a sample is lost or at an end of a word's span.

        Of the interval of docs/theory/estimation_statistics.md, equation 4.
        """
        with np.errstate(invalid="ignore"):
            return np.asarray(0.5 * (self.lower_K + self.upper_K))

    def select(self, mask: NDArray[np.bool_]) -> ReadingIntervals:
        """Intervals [K] of the samples that a boolean mask (sample,) selects."""
        return ReadingIntervals(self.lower_K[mask], self.upper_K[mask])


def reading_intervals(sensor: Sensor, reading_K: ArrayLike) -> ReadingIntervals:
    """Intervals of the indicated temperature that readings of a sensor represent.

        code k = rint((reading - R0) / LSB),   [a, b) = [R0 + (k - 1/2) LSB, R0 + (k + 1/2) LSB)

    sensor  : its recorder word, bits [-] and range_K = (R0, R1) [K]; without one a reading counts as unrounded
    reading_K : (sample,) readings [K]; one between two codes counts as the nearer, one outside the span as the end code
    returns : (sample,) intervals [K], open below at code 0 and above at the last code

    Source: docs/theory/estimation_statistics.md, equation 4.
    """
    reading = np.asarray(reading_K, dtype=float)
    if sensor.bits is None or sensor.range_K is None:
        return ReadingIntervals(reading, reading)
    return ReadingIntervals(*word_intervals(reading, sensor.range_K[0], sensor.lsb_K, 2.0**sensor.bits - 1.0))


def word_intervals(
    reading_K: FloatArray, lowest_K: FloatArray | float, lsb_K: FloatArray | float, last: FloatArray | float
) -> tuple[FloatArray, FloatArray]:
    """Ends of the intervals of the indicated temperature that readings of recorder words represent [K].

        code k = rint((reading - R0) / LSB),   [a, b) = [R0 + (k - 1/2) LSB, R0 + (k + 1/2) LSB)

    reading_K : (sample,) [K];  lowest_K, lsb_K : R0 and LSB [K];  last : last code [-]; NaN for an unrounded reading

    Source: docs/theory/estimation_statistics.md, equation 4.
    """
    # a reading that was converted to engineering units with other constants may lie between two codes
    code = np.clip(np.rint((reading_K - lowest_K) / lsb_K), 0.0, last)
    lower = np.where(code == 0.0, -math.inf, lowest_K + (code - 0.5) * lsb_K)
    upper = np.where(code == last, math.inf, lowest_K + (code + 0.5) * lsb_K)
    unrounded = np.isnan(last)
    return np.where(unrounded, reading_K, lower), np.where(unrounded, reading_K, upper)


def middle_K(lower_K: FloatArray, upper_K: FloatArray) -> FloatArray:
    """(reading,) middle of the interval of each reading [K], the finite end of an open one.

    Source: docs/theory/estimation_statistics.md, equation 12.
    """
    return np.where(np.isfinite(lower_K), np.where(np.isfinite(upper_K), 0.5 * (lower_K + upper_K), lower_K), upper_K)


@dataclass(frozen=True, eq=False)
class Likelihood:
    """Log likelihood of each sample and its derivatives; 0 for a lost sample, NaN where the prediction is NaN.

    Each has the shape that samples (sample,), predictions and sigma broadcast to.

    log_likelihood        : log density [1/K] of an unrounded sample, log probability [-] of a word
    score                 : d/dm [1/K]
    information           : -d2/dm2 [1/K2], observed
    score_log_sigma       : d/d log sigma [-]
    information_log_sigma : -d2/d(log sigma)2 [-], observed
    information_cross     : -d2/dm d log sigma [1/K], observed

    Source: docs/theory/estimation_statistics.md, equations 3 and 5 to 7.
    """

    log_likelihood: FloatArray
    score: FloatArray
    information: FloatArray
    score_log_sigma: FloatArray
    information_log_sigma: FloatArray
    information_cross: FloatArray


def likelihood(samples: ReadingIntervals, mean_K: ArrayLike, sigma_K: ArrayLike) -> Likelihood:
    """Log likelihood, score and information of each sample for given predictions and noise.

        score = E x / sigma,   information = (1 - var x) / sigma^2

    with x the standard normal variable truncated to the sample's interval, (y - m) / sigma where nothing was rounded.

    samples : (sample,) intervals [K]
    mean_K  : predictions m [K], of any shape that broadcasts with the samples
    sigma_K : noise [K], likewise
    returns : log likelihood and its derivatives against m and log sigma, in the broadcast shape
    raises  : InputError where sigma_K is not positive

    Source: derived in docs/theory/estimation_statistics.md, equations 3 to 7, after Louis (1982).
    """
    terms, sigma = _terms(samples, mean_K, sigma_K)
    mean, square = terms[..., truncated_normal.MEAN], terms[..., truncated_normal.SQUARE]
    of_samples = {
        "log_likelihood": terms[..., truncated_normal.LOG_Z],
        "score": mean / sigma,
        "information": terms[..., truncated_normal.GAIN] / sigma**2,
        "score_log_sigma": square,
        "information_log_sigma": 2.0 * (square + 1.0) - terms[..., truncated_normal.SPREAD],
        "information_cross": (2.0 * mean - terms[..., truncated_normal.SKEW]) / sigma,
    }
    return Likelihood(**{name: np.where(samples.is_lost, 0.0, values) for name, values in of_samples.items()})


def scores(
    samples: ReadingIntervals, mean_K: FloatArray, sigma_K: FloatArray | float
) -> tuple[float, FloatArray, FloatArray]:
    """Total log likelihood of samples, and score and information of each.

    Compiled for the inner loop of a fit with one noise for all samples; the values are those of `likelihood`.

    samples : (sample,) intervals [K]
    mean_K  : (sample,) predictions [K]
    sigma_K : () or (sample,) noise [K]
    returns : sum of log likelihoods; (sample,) scores [1/K]; (sample,) observed information [1/K2]; 0 for a lost sample
    raises  : InputError where sigma_K is not positive

    Source: docs/theory/estimation_statistics.md, equations 3 to 6.
    """
    if np.ndim(sigma_K):
        each = likelihood(samples, mean_K, sigma_K)
        return float(np.sum(each.log_likelihood)), each.score, each.information
    score, information = np.empty((2, len(mean_K)))
    total = truncated_normal.fill_scores(
        samples.lower_K, samples.upper_K, mean_K, float(_positive(sigma_K)), score, information
    )
    return total, score, information


def log_likelihood(samples: ReadingIntervals, mean_K: ArrayLike, sigma_K: ArrayLike) -> FloatArray:
    """Log likelihood of each sample, without derivatives; 0 for a lost one, NaN where the prediction is NaN.

    samples : (sample,) intervals [K]
    mean_K  : predictions [K];  sigma_K : noise [K]; both broadcast with the samples
    returns : log density of an unrounded sample, log probability of a word [-]
    raises  : InputError where sigma_K is not positive

    Source: docs/theory/estimation_statistics.md, equations 3 and 5.
    """
    terms, _ = _terms(samples, mean_K, sigma_K)
    return np.where(samples.is_lost, 0.0, terms[..., truncated_normal.LOG_Z])


def expected_information(sensor: Sensor, mean_K: ArrayLike, sigma_K: ArrayLike) -> FloatArray:
    """Fisher information of a sample on its mean, expected over its possible readings: for bounds before a flight.

        E I = sum_k P(code k) (E_k x)^2 / sigma^2,   1 / sigma^2 without a recorder word

    sensor  : its recorder word, if any
    mean_K  : predictions [K];  sigma_K : noise [K]; both broadcast
    returns : information [1/K2], between 0 and 1 / sigma_K^2, in the broadcast shape
    raises  : InputError where sigma_K is not positive

    Source: docs/theory/estimation_statistics.md, equation 11.
    """
    mean, sigma = np.broadcast_arrays(np.asarray(mean_K, dtype=float), _positive(sigma_K))
    if sensor.bits is None or sensor.range_K is None:
        return 1.0 / sigma**2
    # the lowest inner edge: below it and above the last edge lie the two codes of open intervals
    edge, step = sensor.range_K[0] + 0.5 * sensor.lsb_K, sensor.lsb_K
    gain = [
        truncated_normal.information_fraction((edge - m) / s, step / s, 2**sensor.bits - 1)
        for m, s in zip(mean.ravel(), sigma.ravel(), strict=True)
    ]
    return np.reshape(gain, mean.shape) / sigma**2


def quantile_residuals(
    samples: ReadingIntervals, mean_K: ArrayLike, sigma_K: ArrayLike, rng: np.random.Generator
) -> FloatArray:
    """Residuals over sigma that are N(0, 1) for the true model although the samples were rounded.

    An unrounded sample gives (y - m) / sigma [-], a word the normal quantile of a uniform draw between the
    probabilities of its ends.

    samples : (sample,) intervals [K]
    mean_K  : predictions [K];  sigma_K : noise [K]; both broadcast
    rng     : source of the uniform draws, one for each sample
    returns : residuals [-]; NaN for a lost sample
    raises  : InputError where sigma_K is not positive

    Source: P. K. Dunn and G. K. Smyth, "Randomized Quantile Residuals", J. Comput. Graph. Stat. 5 (1996);
    docs/theory/estimation_statistics.md, equation 12.
    """
    mean, sigma = np.asarray(mean_K, dtype=float), _positive(sigma_K)
    alpha, beta = (samples.lower_K - mean) / sigma, (samples.upper_K - mean) / sigma
    sign = np.where(alpha + beta > 0.0, -1.0, 1.0)  # the draw is made in the lower tail, where log Phi keeps its digits
    low, high = np.where(sign < 0.0, -beta, alpha), np.where(sign < 0.0, -alpha, beta)
    # equal ends: nothing was rounded, and alpha is the residual itself
    rounded = low < high
    draw = rng.random(alpha.shape)
    with np.errstate(invalid="ignore", divide="ignore"):
        logs = np.logaddexp(np.log(draw) + log_ndtr(high), np.log1p(-draw) + log_ndtr(low))
    return np.where(rounded, sign * np.clip(ndtri_exp(np.minimum(logs, 0.0)), low, high), alpha)


def _terms(samples: ReadingIntervals, mean_K: ArrayLike, sigma_K: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """(..., 7) terms of truncated_normal.py for the broadcast samples, and sigma in their shape [K]."""
    mean = np.asarray(mean_K, dtype=float)
    arrays = np.broadcast_arrays(samples.lower_K, samples.upper_K, mean, _positive(sigma_K))
    lower, upper, mean, sigma = (np.array(a, order="C") for a in arrays)
    terms = np.empty((mean.size, truncated_normal.N_TERMS))
    truncated_normal.fill_terms(lower.ravel(), upper.ravel(), mean.ravel(), sigma.ravel(), terms)
    return terms.reshape(*mean.shape, truncated_normal.N_TERMS), sigma


def _positive(sigma_K: ArrayLike) -> FloatArray:
    sigma = np.asarray(sigma_K, dtype=float)
    if not np.all(sigma > 0.0):
        raise InputError(f"noise sigma of {np.min(sigma):g} K: must be above 0; declare or estimate noise_sigma_K")
    return sigma
