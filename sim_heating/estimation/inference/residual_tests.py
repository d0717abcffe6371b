"""Residual tests of a fit: whether residuals are white, normal and of the declared size.

Tests take residuals that are N(0, 1) for the true model: those of likelihood.quantile_residuals, as the residual of a
rounded sample is not normal even where everything is right. Statistics: docs/theory/estimation_statistics.md,
equations 12, 27 and 28.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtr, chdtrc

from sim_heating.base.arrays import FloatArray
from sim_heating.base.errors import InputError
from sim_heating.estimation.inference.bounds import grid_index, lagged_sums, place_on_grid
from sim_heating.estimation.inference.likelihood import ReadingIntervals, quantile_residuals

FEWEST = 8
"""Number of samples below which nothing is tested."""
MOST_FOR_SHAPIRO = 5000
"""Number of samples up to which the p-value of Shapiro and Wilk is valid."""


@dataclass(frozen=True)
class HypothesisTest:
    """A test of one hypothesis.

    statistic : its value [-]
    dof       : degrees of freedom, or number of samples where it has none [-]
    p_value   : probability of a value at least as extreme where the hypothesis holds [-]
    """

    __test__ = False  # not one of pytest's

    statistic: float
    dof: float
    p_value: float


def chi_square(residual: FloatArray, fitted: float = 0.0) -> HypothesisTest:
    """Chi-square test of the size of residuals, two-sided: noise as declared gives n - p degrees of freedom.

    residual : (sample,) N(0, 1) for the true model [-], lost samples NaN
    fitted   : number p of parameters fitted to them [-]
    raises   : InputError where no degree of freedom remains

    Source: docs/theory/estimation_statistics.md, equation 27.
    """
    present = residual[np.isfinite(residual)]
    dof = present.size - fitted
    if dof <= 0.0:
        raise InputError(
            f"{present.size} samples for {fitted:g} fitted parameters leave no degree of freedom; fit fewer parameters"
        )
    total = float(present @ present)
    # two-sided: noise declared too large is as wrong as noise declared too small
    return HypothesisTest(total, dof, float(2.0 * min(chdtrc(dof, total), chdtr(dof, total))))


def whiteness(time_s: FloatArray, residual: FloatArray, lags: int | None = None) -> HypothesisTest:
    """Portmanteau test of autocorrelation up to a number of lags, without pairs across lost samples (NaN) and gaps.

        Q = (n + 2) / n sum_k n_k rho_k^2,    rho_k = mean of products k apart / mean square

    with n_k pairs k sampling intervals apart; chi-square with one degree of freedom a lag.

    time_s   : (sample,) increasing times [s]
    residual : (sample,) N(0, 1) for the true model [-], lost samples NaN
    lags     : largest k [-]; by default a fifth of the samples, 10 at most
    raises   : InputError for fewer than 8 samples, and for residuals that are all 0

    Source: G. M. Ljung and G. E. P. Box, "On a Measure of Lack of Fit in Time Series Models", Biometrika 65 (1978),
    where no sample is lost; docs/theory/estimation_statistics.md, equation 28.
    """
    present = np.isfinite(residual)
    n = int(np.count_nonzero(present))
    _require_samples(n)
    index, values = grid_index(time_s[present]), residual[present]
    power = float(values @ values) / n
    if power == 0.0:
        raise InputError("residuals are all 0, without noise to test for colour")
    # on a grid, lost samples are zeros: lagged products skip them, and lagged ones count the pairs
    e, occupied = place_on_grid(index, values), place_on_grid(index, np.ones(n))
    last = min(10, n // 5) if lags is None else lags
    pairs, products = 0.5 * (lagged_sums(occupied, last) @ occupied)[1:], 0.5 * (lagged_sums(e, last) @ e)[1:]
    paired = pairs > 0.0
    total = float(np.sum(products[paired] ** 2 / pairs[paired])) * (n + 2) / n / power**2
    used = int(np.count_nonzero(paired))
    return HypothesisTest(total, used, float(chdtrc(used, total)))


def normality(residual: FloatArray) -> HypothesisTest:
    """Shapiro and Wilk's test of the shape of residuals, mean and variance free; longer series are thinned evenly.

    residual : (sample,) [-], lost samples NaN
    raises   : InputError for fewer than 8 samples, and for residuals that are all equal

    Source: Shapiro and Wilk (1965) in the approximation of Royston (1995), whose p-value is valid up to 5000 samples.
    """
    from scipy.stats import shapiro  # half a second to import; most commands test no residuals

    present = residual[np.isfinite(residual)]
    _require_samples(present.size)
    if np.ptp(present) == 0.0:
        raise InputError(f"residuals are all {present[0]:g}, without noise to test for normality")
    thinned = present[:: math.ceil(present.size / MOST_FOR_SHAPIRO)]
    tested = shapiro(thinned)
    return HypothesisTest(float(tested.statistic), float(thinned.size), float(tested.pvalue))


def _require_samples(samples: int) -> None:
    if samples < FEWEST:
        raise InputError(
            f"{samples} samples are too few to test residuals, at least {FEWEST} are needed; fit a longer segment"
        )


@dataclass(frozen=True, eq=False)
class SensorResiduals:
    """Normalised residuals of one sensor.

    residual : (sample,) N(0, 1) for the true model [-], NaN for a lost sample
    mean, rms, n : over the samples that are not lost [-]
    whiteness, normality : tests, None where the samples are too few or have no noise
    """

    name: str
    residual: FloatArray
    mean: float
    rms: float
    n: int
    whiteness: HypothesisTest | None
    normality: HypothesisTest | None


def sensor_residuals(
    name: str,
    time_s: FloatArray,
    samples: ReadingIntervals,
    mean_K: FloatArray,
    sigma_K: FloatArray | float,
    rng: np.random.Generator,
) -> SensorResiduals:
    """Normalised residuals of a sensor's samples and their tests.

    time_s  : (sample,) increasing times [s]
    samples : (sample,) intervals [K]
    mean_K  : (sample,) predictions [K];  sigma_K : () or (sample,) noise [K]
    rng     : source of the draws of the quantile residuals
    raises  : InputError where every sample is lost

    Source: docs/theory/estimation_statistics.md, equations 12 and 28; Shapiro and Wilk (1965).
    """
    residual = quantile_residuals(samples, mean_K, sigma_K, rng)
    present = residual[np.isfinite(residual)]
    if present.size == 0:
        raise InputError(f"sensor {name}: every sample of the segment is lost; remove the sensor or the segment")
    white = normal = None
    if present.size >= FEWEST and np.ptp(present) > 0.0:
        white, normal = whiteness(time_s, residual), normality(residual)
    return SensorResiduals(
        name, residual, float(present.mean()), float(np.sqrt(np.mean(present**2))), int(present.size), white, normal
    )


def sidak_p_value(p_value: float, tests: float) -> float:
    """Probability that the best of some independent tests does as well by chance.

        1 - (1 - p)^n

    p_value : that of a single test [-]
    tests   : their number n [-], which need not be an integer
    returns : [-]

    Source: Z. Sidak, "Rectangular Confidence Regions for the Means of Multivariate Normal Distributions", J. Am. Stat.
    Assoc. 62 (1967).
    """
    # log1p and expm1 keep the digits of a small p; 1 - 1e-16 avoids log 0 for p = 1
    return float(-np.expm1(tests * np.log1p(-min(p_value, 1.0 - 1e-16))))
