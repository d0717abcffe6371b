"""Noise of a sensor from the residuals of a fit: maximum likelihood, also where rounding hides the noise.

    maximise  sum_i log L_i(sigma) + (p / 2) log(sigma^2 + step^2 / 12)

over sigma at the fitted predictions; the last term corrects for the p fitted parameters, which reduced the residuals
(without rounding sigma^2 = sum of squares / (n - p)). Limits are where the log likelihood has fallen by half the 95%
point of chi-square. Derived in docs/theory/estimation_statistics.md, equation 21.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.special import gammaincinv

from sim_heating.base.arrays import FloatArray
from sim_heating.base.errors import InputError
from sim_heating.estimation.inference.likelihood import ReadingIntervals, log_likelihood

FLOOR = 0.1
"""Least sigma over the step of a word: below it the likelihood of a sample is that of its interval alone."""
LIKELIHOOD_DROP = float(gammaincinv(0.5, 0.95))
"""Drop of the log likelihood at the 95% limits [-], 1.92."""
NORMAL_MEDIAN, CLIPPED_FROM = 1.4826, 3.5
"""Standard deviation of a normal variable over the median of its magnitude, and number of them that are clipped."""
STRIDES, MIN_DIFFERENCES, LEAST_NOISE_K = (1, 2, 4), 20, 1e-3
"""Distances of readings that differences are taken over, the least number of them, and the least noise [K]."""
POINTS = 32
"""Values of sigma on the first grid of the search."""


@dataclass(frozen=True)
class NoiseEstimate:
    """Estimated noise of a sensor [K].

    sigma_K          : the most likely one [K], at least a tenth of a step of the word
    lower_K, upper_K : 95% limits by the likelihood ratio [K]; lower_K is 0 where rounding hides how small the noise is

    Source: docs/theory/estimation_statistics.md, equation 21.
    """

    sigma_K: float
    lower_K: float
    upper_K: float

    @property
    def is_bounded_below(self) -> bool:
        """Whether the data bound the noise [K] from below, and not only from above.

        The likelihood has then dropped by 1.92 above a tenth of the recorder's step:
        docs/theory/estimation_statistics.md, equation 21.
        """
        return self.lower_K > 0.0

    def describe(self, sensor: str) -> str:
        """One line for a report: the noise of a named sensor with its limits [K], or its upper limit alone."""
        if self.is_bounded_below:
            return f"sensor {sensor}: noise {self.sigma_K:.3g} K ({self.lower_K:.3g} to {self.upper_K:.3g})"
        return f"sensor {sensor}: noise below {self.upper_K:.3g} K, hidden by rounding; declare noise_sigma_K"


def noise_of_readings(time_s: FloatArray, reading_K: FloatArray, step_K: float = 0.0) -> float | None:
    """Noise of a sensor from its readings alone, without a model: third divided differences of neighbouring readings.

    time_s, reading_K : (reading,) times [s], and temperatures [K], NaN where a sample was lost
    step_K            : step of the recorder's word [K]; 0 without one
    returns           : standard deviation [K], at least a tenth of a step; None from fewer than MIN_DIFFERENCES

    Of four readings the combination that any quadratic in time leaves at 0 is scaled to the variance of one
    reading. Its root mean square is the standard deviation, without those beyond 3.5 times 1.4826 times the
    median of its magnitude, the standard deviation of normal noise: switches of a lamp, and spikes. The largest
    of the values over every reading, every second and every fourth is taken: the noise of a recorder that
    averages is correlated from one reading to the next. What a temperature bends within four readings counts as
    noise, so that sparse readings give too much rather than too little. Source: the scale by the median,
    Rousseeuw and Croux, J. Am. Stat. Assoc. 88 (1993).
    """
    good = np.isfinite(reading_K)
    t, T = np.asarray(time_s)[good], np.asarray(reading_K)[good]
    scales = [[_difference_scale(t[start::k], T[start::k]) for start in range(k)] for k in STRIDES]
    means = [float(np.mean([s for s in by_start if s is not None])) for by_start in scales if None not in by_start]
    if not means:
        return None
    sigma = max(means)
    return max(math.sqrt(max(sigma**2 - step_K**2 / 12.0, 0.0)), FLOOR * step_K, LEAST_NOISE_K)


def _difference_scale(t: FloatArray, T: FloatArray) -> float | None:
    """Scale of third divided differences; None from too few."""
    count = len(t) - 3
    if count < MIN_DIFFERENCES:
        return None
    times = np.array([t[i : i + count] for i in range(4)])
    gaps = times[:, None, :] - times[None, :, :] + np.eye(4)[:, :, None]
    weights = 1.0 / np.prod(gaps, axis=1)
    weights /= np.sqrt(np.sum(weights**2, axis=0))
    z = sum(w * T[i : i + count] for i, w in enumerate(weights))
    scale = NORMAL_MEDIAN * float(np.median(np.abs(z)))
    return float(np.sqrt(np.mean(z[np.abs(z) <= CLIPPED_FROM * scale] ** 2)))


def estimate_noise(samples: ReadingIntervals, mean_K: FloatArray, fitted: float = 0.0) -> NoiseEstimate:
    """Maximum-likelihood noise of a sensor at given predictions, with 95% limits.

        sum_i log L_i(sigma) + (p / 2) log(sigma^2 + step^2 / 12)

    samples : (sample,) intervals [K]
    mean_K  : (sample,) predictions [K]
    fitted  : number p of parameters that these samples determined [-]; a share of it where other sensors took part
    raises  : InputError for too few samples, for samples all at an end of their word's span, and for samples that agree
              with the predictions in every digit

    Searched from a tenth of the recorder's step (1e-3 of the largest residual scale where nothing was rounded) to
    thirty times that scale. Source: docs/theory/estimation_statistics.md, equation 21.
    """
    present = ~samples.is_lost
    intervals, mean = samples.select(present), np.asarray(mean_K, dtype=float)[present]
    if len(mean) <= fitted + 1.0:
        raise InputError(
            f"{len(mean)} samples are too few to estimate noise in addition to {fitted:g} fitted parameters"
        )
    width = intervals.upper_K - intervals.lower_K
    if not np.isfinite(width).any():
        raise InputError("every sample is at an end of its word's span, which does not determine a noise; declare it")
    step = float(np.min(width))
    distance = np.maximum(np.maximum(intervals.lower_K - mean, mean - intervals.upper_K), 0.0)
    # a whole step on top of every residual: never below the true scale, so that the upper limit is bracketed
    largest = float(np.sqrt(np.mean((distance + step) ** 2)))
    if largest == 0.0:
        raise InputError("samples and predictions agree in every digit, which leaves no noise to estimate; declare it")

    def value(log_sigma: float) -> float:
        sigma = math.exp(log_sigma)
        correction = 0.5 * fitted * math.log(sigma**2 + step**2 / 12.0)
        return float(np.sum(log_likelihood(intervals, mean, sigma))) + correction

    least = FLOOR * step if step > 0.0 else 1e-3 * largest
    return _limits(value, math.log(least), math.log(30.0 * largest))


def _limits(value: Callable[[float], float], least: float, most: float) -> NoiseEstimate:
    """Maximum of a log likelihood over log sigma, and where it has dropped by LIKELIHOOD_DROP on either side."""
    from scipy.optimize import brentq, minimize_scalar  # slow to import

    # the likelihood of rounded samples need not have a single maximum in log sigma: grid first, then refine
    grid = np.linspace(least, most, POINTS)
    k = int(np.argmax([value(x) for x in grid]))
    around = (grid[max(k - 1, 0)], grid[min(k + 1, POINTS - 1)])
    optimum = minimize_scalar(lambda x: -value(x), bounds=around, method="bounded", options={"xatol": 1e-8})
    # a bounded search never returns the end of its interval itself
    best = float(optimum.x) if -optimum.fun > value(least) else least
    top = value(best)

    def above_limit(x: float) -> float:
        return value(x) - top + LIKELIHOOD_DROP

    lower = math.exp(brentq(above_limit, least, best)) if above_limit(least) < 0.0 else 0.0
    return NoiseEstimate(math.exp(best), lower, math.exp(brentq(above_limit, best, most)))
