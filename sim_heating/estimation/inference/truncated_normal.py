"""A normal variable of which an interval is known: log probability and moments, for kernels and for likelihood.py.

For x ~ N(0, 1) in [alpha, beta], with x0 the point of the interval nearest to 0 and x = x0 + t,

    Z = Phi(beta) - Phi(alpha) = phi(x0) M0,     M_k = integral of t^k exp(-x0 t - t^2 / 2) dt,

every moment follows from the M_k: sums of positive terms over a smooth integrand that is 1 at its highest, so that
neither a far tail nor a narrow interval costs digits. Gauss-Legendre panels; the integrand is dropped where it
falls below 1e-20 of its highest. Wide intervals near the mean, which recorder words mostly are, lose no digits in
closed form: Z by erfc, then E x^(k+1) = k E x^(k-1) + (alpha^k phi(alpha) - beta^k phi(beta)) / Z. Derived in
docs/theory/estimation_statistics.md, equations 5 to 9. Identities of the moments with the derivatives of log Z: Louis,
"Finding the Observed Information Matrix when Using the EM Algorithm", J. R. Stat. Soc. B 44 (1982).
"""

from __future__ import annotations

import math

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.base.kernels.jit import njit

NEPERS = 46.0
"""Natural logarithm of the fall of the integrand at which it is dropped: exp(-46) = 1e-20."""
PANEL = 8.0
"""Width of a panel over the scale on which the integrand changes there."""
NODES, WEIGHTS = np.polynomial.legendre.leggauss(14)
ROOT_HALF = math.sqrt(0.5)
REMOTE = 40.0
"""The density is 0 from here on."""
LOG_ROOT_2PI = 0.5 * math.log(2.0 * math.pi)
NARROW = 0.02
"""Steps of a word below this, over sigma, are summed in closed form: the first term left out is step^6 / 1728."""
WIDE, NEAR = 1.0, 3.0
"""An interval at least so wide and no further from the mean is summed in closed form: three digits are lost at most."""
FAR = 10.0
"""A step of a word further from the mean than this, over sigma, has a probability below 1e-23."""

LOG_Z, MEAN, VARIANCE, GAIN, SQUARE, SKEW, SPREAD = range(7)
"""log Z; E x; var x; 1 - var x; E x^2 - 1; cov(x, x^2); var x^2."""
N_TERMS = 7


@njit
def weighted_density(x: float) -> float:
    """x phi(x) [-], phi the standard normal density; 0 at both infinities.

    Term of the closed form of E x^2, docs/theory/estimation_statistics.md, equation 9.
    """
    return 0.0 if abs(x) > REMOTE else x * math.exp(-0.5 * x * x - LOG_ROOT_2PI)


@njit
def truncated_normal(alpha: float, beta: float, width: float):
    """The seven terms [-] of a standard normal variable x truncated to [alpha, beta].

    alpha, beta : ends of the interval [-], either may be infinite;  alpha < beta
    width       : beta - alpha [-], computed from the interval itself: the difference of two remote ends has few digits
    returns     : log Z, E x, var x, 1 - var x, E x^2 - 1, cov(x, x^2), var x^2, in the order LOG_Z ... SPREAD

    Relative error about 1e-12 up to 50 sigma from the mean (tests/estimation/test_likelihood.py).
    Source: docs/theory/estimation_statistics.md, equations 8 and 9.
    """
    if alpha == -math.inf and beta == math.inf:
        return 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 2.0
    sign = 1.0
    if alpha + beta < 0.0:
        # mirrored to the upper half, where the point nearest to the mean is alpha or 0
        sign, alpha, beta = -1.0, -beta, -alpha
    if width >= WIDE and alpha <= NEAR:
        log_z, mean, variance, gain, square, skew, spread = wide_interval_terms(alpha, beta)
        return log_z, sign * mean, variance, gain, square, sign * skew, spread
    straddles = alpha < 0.0
    x0 = max(alpha, 0.0)
    # root of x0 t + t^2 / 2 = NEPERS, in the form that does not cancel for a large x0
    reach = 2.0 * NEPERS / (x0 + math.sqrt(x0 * x0 + 2.0 * NEPERS))
    low = max(alpha, -reach) if straddles else 0.0
    high = min(beta if straddles else width, reach)
    m0, m1, m2, m3, m4 = moments(x0, low, high)
    variance = m2 - m1 * m1
    skew = m3 - m1 * m2
    spread = m4 - m2 * m2
    mean = x0 + m1
    log_z = math.log(m0) - 0.5 * x0 * x0 - LOG_ROOT_2PI
    if straddles:
        # E x^2 - 1 from the ends: 1 - var x would cancel where the interval holds nearly all of the variable
        square = -(weighted_density(beta) + weighted_density(-alpha)) / math.exp(log_z)
        gain = mean * mean - square
    else:
        square = (x0 - 1.0) * (x0 + 1.0) + 2.0 * x0 * m1 + m2
        gain = 1.0 - variance
    return (
        log_z,
        sign * mean,
        variance,
        gain,
        square,
        sign * (2.0 * x0 * variance + skew),
        4.0 * x0 * x0 * variance + 4.0 * x0 * skew + spread,
    )


@njit
def wide_interval_terms(alpha: float, beta: float):
    """The seven terms [-] in closed form, for an interval with alpha + beta >= 0.

    alpha, beta : ends of the interval [-], beta - alpha >= WIDE and alpha <= NEAR; differences cancel digits outside
                  of that
    returns     : log Z, E x, var x, 1 - var x, E x^2 - 1, cov(x, x^2), var x^2

    Source: docs/theory/estimation_statistics.md, equation 9.
    """
    z = 0.5 * (math.erfc(alpha * ROOT_HALF) - math.erfc(beta * ROOT_HALF))
    p = math.exp(-0.5 * alpha * alpha - LOG_ROOT_2PI) / z
    b, q = (beta, math.exp(-0.5 * beta * beta - LOG_ROOT_2PI) / z) if beta < REMOTE else (0.0, 0.0)
    mean, square = p - q, alpha * p - b * q
    third = 2.0 * mean + alpha * alpha * p - b * b * q
    fourth = 3.0 * (1.0 + square) + alpha * alpha * alpha * p - b * b * b * q
    second = 1.0 + square
    return (
        math.log(z),
        mean,
        second - mean * mean,
        mean * mean - square,
        square,
        third - mean * second,
        fourth - second * second,
    )


@njit
def moments(x0: float, low: float, high: float):
    """M0, and M1 / M0 to M4 / M0 [-], of the weight exp(-x0 t - t^2 / 2) for t from low to high.

    x0        : point of the interval nearest to the mean [-], not below 0
    low, high : finite limits of t [-]; low is below 0 only for an interval that contains the mean

    Gauss-Legendre of 14 points on panels of PANEL scales. Source: docs/theory/estimation_statistics.md, equation 8.
    """
    # the integrand changes over 1 / x0 for a remote interval, over 1 for one at the mean
    panels = 1 + int((high - low) * max(1.0, x0) / PANEL)
    half = 0.5 * (high - low) / panels
    m0, m1, m2, m3, m4 = 0.0, 0.0, 0.0, 0.0, 0.0
    for panel in range(panels):
        centre = low + half * (2 * panel + 1)
        for k in range(len(NODES)):
            t = centre + half * NODES[k]
            w = WEIGHTS[k] * math.exp(-t * (x0 + 0.5 * t))
            m0 += w
            m1 += w * t
            m2 += w * t * t
            m3 += w * t * t * t
            m4 += w * t * t * t * t
    return m0 * half, m1 / m0, m2 / m0, m3 / m0, m4 / m0


@njit
def fill_terms(lower: FloatArray, upper: FloatArray, mean: FloatArray, sigma: FloatArray, terms: FloatArray) -> None:
    """Write the seven terms of each sample into `terms`; those of a normal density where the ends of its interval meet.

    lower, upper : (sample,) ends of the interval [K]
    mean, sigma  : (sample,) prediction and noise [K]
    terms        : (sample, 7) output [-], in the order LOG_Z ... SPREAD; log density [1/K] for an unrounded sample,
                   NaN where one of the inputs is NaN

    Source: docs/theory/estimation_statistics.md, equations 3 and 5 to 7.
    """
    for i in range(len(mean)):
        alpha, beta = (lower[i] - mean[i]) / sigma[i], (upper[i] - mean[i]) / sigma[i]
        # written so that NaN comes here as well
        if not (alpha < beta):
            terms[i, LOG_Z] = -0.5 * alpha * alpha - LOG_ROOT_2PI - math.log(sigma[i])
            terms[i, MEAN], terms[i, VARIANCE], terms[i, GAIN] = alpha, 0.0, 1.0
            terms[i, SQUARE], terms[i, SKEW], terms[i, SPREAD] = alpha * alpha - 1.0, 0.0, 0.0
            if alpha != beta:
                terms[i, :] = math.nan
            continue
        row = truncated_normal(alpha, beta, (upper[i] - lower[i]) / sigma[i])
        for k in range(len(row)):
            terms[i, k] = row[k]


@njit
def fill_scores(
    lower: FloatArray, upper: FloatArray, mean: FloatArray, sigma: float, score: FloatArray, information: FloatArray
) -> float:
    """Write score and information of each sample on its mean; return the sum of the log likelihoods [-].

    lower, upper, mean : (sample,) interval and prediction [K]
    sigma              : noise [K], one for all samples
    score, information : (sample,) outputs [1/K], [1/K2]; 0 for a lost sample

    Source: docs/theory/estimation_statistics.md, equations 3, 5 and 6.
    """
    total = 0.0
    for i in range(len(mean)):
        score[i], information[i] = 0.0, 0.0
        if math.isnan(lower[i]):
            continue
        alpha, beta = (lower[i] - mean[i]) / sigma, (upper[i] - mean[i]) / sigma
        if alpha < beta:
            log_z, x, _, gain, _, _, _ = truncated_normal(alpha, beta, (upper[i] - lower[i]) / sigma)
            total += log_z
            score[i], information[i] = x / sigma, gain / (sigma * sigma)
        else:
            total += -0.5 * alpha * alpha - LOG_ROOT_2PI - math.log(sigma)
            score[i], information[i] = alpha / sigma, 1.0 / (sigma * sigma)
    return total


@njit
def information_fraction(first: float, step: float, steps: int) -> float:
    """Information of a rounded sample on its mean over that of the unrounded sample [-]: E (E x)^2 over the words.

    first, step, steps : lowest inner edge [-], distance of the edges [-] (both over sigma, from the mean), number of
                         inner edges; the intervals beyond the outermost are open
    returns            : between 0 and 1 [-]

    For steps below NARROW the variance within one is s - s^2, s = step^2 / 12 (Sheppard), on average over x.
    Source: docs/theory/estimation_statistics.md, equation 11.
    """
    last = first + (steps - 1) * step
    total = word_information(-math.inf, first) + word_information(last, math.inf)
    if first > FAR or last < -FAR or steps < 2:
        return total
    if step < NARROW:
        log_z, mean, variance, _, _, _, _ = truncated_normal(first, last, last - first)
        s = step * step / 12.0
        return total + math.exp(log_z) * (mean * mean + variance - s * (1.0 - s))
    # only words within FAR of the mean: a fine word of many bits has thousands that cannot occur
    k = max(0, int((-FAR - first) / step))
    while k < steps - 1 and first + k * step < FAR:
        log_z, mean, _, _, _, _, _ = truncated_normal(first + k * step, first + (k + 1) * step, step)
        total += math.exp(log_z) * mean * mean
        k += 1
    return total


@njit
def word_information(alpha: float, beta: float) -> float:
    """Contribution Z (E x)^2 [-] of one word, an interval [alpha, beta] over sigma, to `expected_gain`.

    Source: docs/theory/estimation_statistics.md, equation 11.
    """
    log_z, mean, _, _, _, _, _ = truncated_normal(alpha, beta, beta - alpha)
    return math.exp(log_z) * mean * mean
