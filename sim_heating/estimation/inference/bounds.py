"""Parameter bounds when residuals are coloured: the Cramer-Rao bound with the residuals' own autocovariance.

    cov = M^-1 [sum_i sum_j A_i c(i - j) A_j' + P] M^-1,     M = sum_i A_i A_i' + P,

with P the information of the priors, A_i = S_i sqrt(I_i), S_i the sensitivity (parameter,) of sample i and I_i its
information, 1 / R for an unrounded one; e_i = u_i / sqrt(I_i) is the residual in its own unit, from the score u_i, and
c its autocovariance, 1 at lag 0 and 0 elsewhere where the noise is white and as declared. R. E. Maine and K. W. Iliff,
"The Theory and Practice of Estimating the Accuracy of Dynamic Flight-Determined Coefficients", NASA
RP-1077 (1981); E. A. Morelli and V. Klein, "Accuracy of Aerodynamic Model Parameters Estimated from Flight Test Data",
J. Guid. Control Dyn. 20 (1997).

Residuals of a fit are less coloured than the noise: with Q = 1 - A M^-1 A' the sums over residuals at each lag
have the expectation sum_l c(l) tr(W_k Q T_l Q), T_l being 1 where two samples are l apart, W_k the same with weights
sqrt(I_i I_j); that linear system is solved for c. Lags end where autocorrelation does, with a flat-top taper:
D. N. Politis, "Adaptive Bandwidth Choice", J. Nonparametr. Stat. 15 (2003). Sensors count as independent of
each other. Derived in docs/theory/estimation_statistics.md, equations 22 to 26 (M is written N there).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import lstsq
from scipy.special import stdtrit

from sim_heating.base.arrays import FloatArray, IntArray
from sim_heating.base.errors import InputError
from sim_heating.estimation.inference.identifiability import covariance, scale

QUIET_LAGS = 5
"""Successive lags without significant autocorrelation that end the search."""
MAX_LAG_OF_SAMPLES = 0.2
"""Longest lag over the number of a channel's samples."""
MAX_LAG_OF_ROOT = 2.0
"""Longest lag over the square root of that number."""
MAX_LAG = 100
"""Longest lag; longer autocorrelation is not detected."""


@dataclass(frozen=True, eq=False)
class ChannelResiduals:
    """Residuals of one sensor in one segment, without lost samples.

    time_s      : (sample,) increasing [s]
    score       : (sample,) d log L / d mean [1/K], residual / sigma^2 where nothing is rounded
    information : (sample,) on the mean [1/K2], 1 / sigma^2 where nothing is rounded
    sensitivity : (sample, parameter) of the mean [K] to the parameters, each in its unit
    """

    name: str
    time_s: FloatArray
    score: FloatArray
    information: FloatArray
    sensitivity: FloatArray

    @property
    def weighted(self) -> FloatArray:
        """(sample, parameter) A_i = S_i sqrt(I_i): sensitivity [K] over the standard deviation 1 / sqrt(I_i) [K].

        Source: docs/theory/estimation_statistics.md, equation 22.
        """
        return self.sensitivity * np.sqrt(self.information)[:, None]


@dataclass(frozen=True, eq=False)
class CramerRaoBounds:
    """Bounds of parameters.

    covariance      : (parameter, parameter) corrected for colour
    white           : (parameter, parameter) inverse of the information, noise white and as declared
    dof             : degrees of freedom [-] of the residuals' spectrum at frequency 0, which the correction rests on
    autocovariance  : by channel, (lag,) of the residuals in their own unit [-], tapered

    Source: docs/theory/estimation_statistics.md, equations 22 to 26.
    """

    covariance: FloatArray
    white: FloatArray
    dof: float
    autocovariance: dict[str, FloatArray]

    @property
    def sigma(self) -> FloatArray:
        """(parameter,) standard deviations corrected for colour, in the units of the parameters ([-] for a ratio).

        Source: docs/theory/estimation_statistics.md, equation 22.
        """
        return np.sqrt(np.diag(self.covariance))

    def half_width(self) -> FloatArray:
        """(parameter,) half width of the interval that covers the truth with 95 % probability, by Student's t.

            sigma_j t_dof(0.975)

        returns : in the units of the parameters ([-] for a ratio)

        Below some ten degrees of freedom the interval covers less than stated. Source:
        docs/theory/estimation_statistics.md, equation 26.
        """
        return self.sigma * float(stdtrit(self.dof, 0.975))


def grid_index(time_s: FloatArray) -> IntArray:
    """Indices of samples on a grid of their median interval: gaps and lost samples leave grid points empty.

    time_s  : (sample,) increasing times [s]
    returns : (sample,) integers, 0 first; an interval counts as its nearest number of median intervals, 1 at least
    raises  : InputError where the times do not increase

    Neighbourhood in the sums of docs/theory/estimation_statistics.md, equation 23.
    """
    if len(time_s) < 2:
        return np.zeros(len(time_s), dtype=np.int64)
    steps = np.diff(time_s)
    if np.any(steps <= 0.0):
        raise InputError("sample times of a residual do not increase; sort them")
    # the median: a few gaps, however long, do not change it
    intervals = np.maximum(np.rint(steps / np.median(steps)), 1.0).astype(np.int64)
    return np.concatenate([[0], np.cumsum(intervals)])


def place_on_grid(index: IntArray, values: FloatArray) -> FloatArray:
    """Values at their grid points, 0 where there is no sample.

    index   : (sample,) of `grid_index` [-];  values : (sample, ...) in any unit
    returns : (point, ...) in the same unit

    With zeros in the gaps, the lagged sums of docs/theory/estimation_statistics.md, equation 23, need no bookkeeping.
    """
    placed = np.zeros((int(index[-1]) + 1 if len(index) else 0, *values.shape[1:]))
    placed[index] = values
    return placed


def lagged_sums(values: FloatArray, last: int) -> FloatArray:
    """Sums of the values one lag before and after each point of a grid; for lag 0 the values themselves.

    values  : (point,) in any unit;  last : largest lag in grid points [-]
    returns : (lag, point) T_l values, 0 to `last`

    Source: the matrices T_l of docs/theory/estimation_statistics.md, equation 23, applied to a vector.
    """
    windows = np.lib.stride_tricks.sliding_window_view(np.pad(values, last), 2 * last + 1)
    sums = (windows[:, last:] + windows[:, last::-1]).T
    sums[0] = values
    return sums


@dataclass(frozen=True, eq=False)
class _GriddedResiduals:
    """A channel on its grid. present is 1 where there is a sample, D = sqrt(I), A = D S, u the score."""

    present: FloatArray
    D: FloatArray
    A: FloatArray
    u: FloatArray

    @classmethod
    def of(cls, channel: ChannelResiduals) -> _GriddedResiduals:
        index = grid_index(channel.time_s)
        D, u = place_on_grid(index, np.sqrt(channel.information)), place_on_grid(index, channel.score)
        return cls(place_on_grid(index, np.ones(len(index))), D, place_on_grid(index, channel.weighted), u)

    def lagged(self, values: FloatArray, last: int) -> FloatArray:
        """(lag, point) T_l times values (point,), 0 where there is no sample."""
        return lagged_sums(values, last) * self.present

    def weighted_lagged(self, values: FloatArray, last: int) -> FloatArray:
        """(lag, point) W_l times values (point,)."""
        return lagged_sums(values * self.D, last) * self.D


def significant_lags(autocovariance: FloatArray, samples: int) -> int:
    """Number of lags beyond 0 that the taper reaches: twice the last one with a significant autocorrelation.

        significant: |c(l)| > 2 sqrt(log10(n) / n) |c(0)|

    autocovariance : (lag,) [-];  samples : their number n [-]
    returns        : at most the largest lag given; 0 for white residuals

    Source: Politis (2003), the rule of five insignificant lags.
    """
    longest = len(autocovariance) - 1
    limit = 2.0 * math.sqrt(math.log10(samples) / samples) * abs(autocovariance[0])
    last = 0
    for lag in range(1, longest + 1):
        if abs(autocovariance[lag]) > limit:
            last = lag
        elif lag - last >= QUIET_LAGS:
            break
    return min(2 * last, longest)


def taper_weights(lags: int) -> FloatArray:
    """(lag,) flat-top weights [-]: 1 to half the lags, then linearly to 0 one lag beyond the last.

    lags : largest lag L [-];  w(l) = min(1, 2 - 2 l / (L + 1))

    Source: Politis (2003); docs/theory/estimation_statistics.md, equation 24.
    """
    return np.clip(2.0 * (1.0 - np.arange(lags + 1) / (lags + 1.0)), 0.0, 1.0)


def autocovariances(channels: Sequence[ChannelResiduals], inverse: FloatArray) -> list[FloatArray]:
    """Autocovariance of each channel's residuals e, corrected for the colour that the fit removed; not tapered.

        E [u' T_k u] = sum_l c(l) tr(W_k Q T_l Q),   Q = 1 - A M^-1 A'

    channels : residuals and sensitivities by sensor
    inverse  : (parameter, parameter) M^-1
    returns  : for each channel (lag,) [-], 1 at lag 0 for noise as declared

    Solved twice: for the lags that a channel's length allows, and for those of them that are significant. A channel
    whose variance then is not above 0, as where the model is far from another channel's readings, has the plain
    autocovariance of its residuals.
    Source: docs/theory/estimation_statistics.md, equation 23.
    """
    gridded = [_GriddedResiduals.of(c) for c in channels]
    samples = [len(c.time_s) for c in channels]
    allowed = [longest_lag(n) for n in samples]
    broad = _solve_autocovariances(gridded, allowed, inverse)
    lags = [significant_lags(c, n) for c, n in zip(broad, samples, strict=True)]
    solved = _solve_autocovariances(gridded, lags, inverse)
    return [
        c if c[0] > 0.0 else _plain_autocovariance(g, last) for c, g, last in zip(solved, gridded, lags, strict=True)
    ]


def longest_lag(samples: int) -> int:
    """Longest lag of the autocovariance of a number of samples [-].

    Source: docs/theory/estimation_statistics.md, equation 24.
    """
    return int(min(MAX_LAG_OF_SAMPLES * samples, MAX_LAG_OF_ROOT * math.sqrt(samples), MAX_LAG))


def spectral_density(channel: ChannelResiduals) -> float:
    """Spectral density of residuals at frequency 0 over that of white noise as declared [-].

        S = c(0) + 2 sum_l w(l) c(l),   l > 0

    A slow change of the mean is distinguished from this: white noise of the same variance has S = c(0). Source:
    docs/theory/model_error.md, equation 5b; docs/theory/estimation_statistics.md, equation 24.
    """
    samples = len(channel.time_s)
    g = _GriddedResiduals.of(channel)
    c = _plain_autocovariance(g, longest_lag(samples))
    c = c[: significant_lags(c, samples) + 1]
    return float(2.0 * taper_weights(len(c) - 1) @ c - c[0])


def _plain_autocovariance(g: _GriddedResiduals, last: int) -> FloatArray:
    """(lag,) autocovariance [-] of a channel's residuals as they are, u' T_k u over its expectation for c = 1."""
    sums, pairs = lagged_sums(g.u, last) @ g.u, lagged_sums(g.D, last) @ g.D
    return sums / np.where(pairs > 0.0, pairs, 1.0)


def _solve_autocovariances(
    gridded: Sequence[_GriddedResiduals], lags: Sequence[int], inverse: FloatArray
) -> list[FloatArray]:
    """Autocovariances up to a number of lags a channel, from the expectation of the sums over residuals."""
    expectations = [_Expectation.of(g, last, inverse) for g, last in zip(gridded, lags, strict=True)]
    weighted = np.concatenate([e.weighted for e in expectations])
    system = weighted @ np.concatenate([e.plain for e in expectations]).T
    ends = np.cumsum([last + 1 for last in lags])
    for expectation, end, last in zip(expectations, ends, lags, strict=True):
        of_channel = slice(end - last - 1, end)
        # the product above couples all channels through the shared parameters; this term is each channel's own
        system[of_channel, of_channel] += expectation.uncoupled
    sums = np.concatenate([e.sums for e in expectations])
    # least squares: where parameters absorb a lag entirely the system is singular there
    solved = lstsq(system, sums, cond=1e-10, lapack_driver="gelsy")[0]
    return list(np.split(solved, ends[:-1]))


@dataclass(frozen=True, eq=False)
class _Expectation:
    """Factors of tr(W_k Q T_l Q) for one channel.

    sums     : (lag,) u' T_k u
    own      : (lag, lag) tr(W_k T_l) - 2 tr(W_k A M^-1 A' T_l)
    weighted : (lag, parameter x parameter) A' W_k A M^-1
    plain    : (lag, parameter x parameter) M^-1 A' T_l A
    """

    sums: FloatArray
    uncoupled: FloatArray
    weighted: FloatArray
    plain: FloatArray

    @classmethod
    def of(cls, g: _GriddedResiduals, last: int, inverse: FloatArray) -> _Expectation:
        # tr(W_k T_l) is 0 for different lags
        uncoupled = np.diag(lagged_sums(g.D, last) @ g.D)
        weighted, plain = [], []
        for a, projected in zip(g.A.T, inverse @ g.A.T, strict=True):
            rows, columns = g.weighted_lagged(projected, last), g.lagged(a, last)
            uncoupled -= 2.0 * rows @ columns.T
            weighted.append(rows @ g.A)
            plain.append(columns @ g.A @ inverse)
        flat = (last + 1, -1)
        return cls(
            lagged_sums(g.u, last) @ g.u,
            uncoupled,
            np.stack(weighted, axis=2).reshape(flat),
            np.stack(plain, axis=2).reshape(flat),
        )


def cramer_rao_bounds(
    channels: Sequence[ChannelResiduals], prior_information: FloatArray | float = 0.0
) -> CramerRaoBounds:
    """Bounds of the parameters of a fit, corrected for the colour of its residuals.

        cov = M^-1 [sum_i sum_j A_i c(i - j) A_j' + P] M^-1

    channels          : times [s], scores, information and sensitivities [K] at the fitted values, by sensor and segment
    prior_information : (parameter,) 1 / sigma^2, 0 for a flat prior
    returns           : corrected and white covariance, degrees of freedom, autocovariances
    raises            : InputError where there are no more samples than parameters

    Colour may widen a bound and never narrows it below that of white residuals of the same variance. Below some ten
    degrees of freedom the colour is poorly known, and intervals cover less than they state.
    Source: Maine and Iliff (1981), Morelli and Klein (1997); docs/theory/estimation_statistics.md, equations 22 to 25.
    """
    parameters = channels[0].sensitivity.shape[1] if channels else 0
    samples = sum(len(c.time_s) for c in channels)
    if samples <= parameters:
        raise InputError(f"{samples} samples for {parameters} parameters; fit a longer segment or fewer parameters")
    if parameters == 0:
        return CramerRaoBounds(np.zeros((0, 0)), np.zeros((0, 0)), float(samples), {})
    A = np.concatenate([c.weighted for c in channels])
    prior = np.diag(np.broadcast_to(prior_information, parameters))
    information = A.T @ A + prior
    white = covariance(information)
    # unidentified directions do not reduce the residuals
    inverse = np.where(np.isfinite(white), white, 0.0)
    autocovariance = autocovariances(channels, inverse)
    middle, free = prior.astype(float), 0.0
    tapered = {}
    for channel, c in zip(channels, autocovariance, strict=True):
        w = taper_weights(len(c) - 1)
        g = _GriddedResiduals.of(channel)
        filtered = np.stack([w * c @ g.lagged(a, len(c) - 1) for a in g.A.T], axis=1)
        # the truncated autocovariance need not be positive definite: the floor also keeps variances positive
        middle += _raise_to_floor(g.A.T @ filtered, c[0] * g.A.T @ g.A)
        # sum of squared weights over lags of both signs; a spectrum at frequency 0 has half the freedom of others
        free += len(channel.time_s) / (2.0 * float(w @ w) - 1.0)
        tapered[channel.name] = w * c
    corrected = inverse @ middle @ inverse
    corrected = np.where(np.isfinite(white), corrected, white)
    return CramerRaoBounds(corrected, white, max(free * (1.0 - parameters / samples), 1.0), tapered)


def _raise_to_floor(matrix: FloatArray, floor: FloatArray) -> FloatArray:
    """The matrix, raised in the directions where it is below another."""
    s = scale(floor)
    values, vectors = np.linalg.eigh((matrix - floor) * np.outer(s, s))
    raised = (vectors * np.maximum(values, 0.0)) @ vectors.T
    return floor + raised / np.outer(s, s)
