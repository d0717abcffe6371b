"""Times at which the error of a heating starts anew, as that of a trajectory that was put together from arcs.

Between knots k and k + 1, a distance h apart, a first-order Gauss-Markov process of standard deviation s has the
precision 1 / (s^2 (1 - a^2)) [[a^2, -a], [-a, 1]] with a = exp(-h / tau). Where it starts anew that is 1 / s^2 of the
later knot alone. One break changes the information of all unknowns at these two knots only, so that its gain in log
evidence follows from their covariance:

    gain = z log(1 - a^2) / 2 - log det(1 + z D C) / 2 - z m' (1 + z D C)^-1 D m / 2,
    D = a / (s^2 (1 - a^2)) [[-a, 1], [1, -a]],

with C (2, 2) the covariance of the two values and m (2,) their means before, z = 1 for a break that is added and -1 for
one that is removed. Derived in docs/theory/model_error.md, equation 5d.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dpotri

from sim_heating.base.arrays import FloatArray
from sim_heating.estimation.inference.model_error import Correlation

PIECES = 5
"""Pieces of an interval between knots in which an error starts anew."""
MOST_BREAKS = 40
"""Most times at which the error of a record is taken to start anew."""


class ReadError(NamedTuple):
    """What readings say of the values of the heating's error at its knots, all other unknowns integrated out.

    information : (knot, knot) of the readings;  score : (knot,) at values of 0
    """

    information: FloatArray
    score: FloatArray


def log_prior(knots_s: FloatArray, breaks_s: Sequence[float]) -> float:
    """Log probability of breaks at some knots, each further one half as probable, wherever it is.

        -(n + 1) log 2 + log n! + n log(h / T)

    knots_s : (knot,) of the error, h apart where none are nearer, T from the first to the last [s];  breaks_s : n knots

    Knots within an interval are alternatives for one break. The likeliest stands for their sum, so that a break costs
    the same however its interval is divided. Source: docs/theory/model_error.md, equation 5c.
    """
    before = np.arange(np.count_nonzero(np.isin(knots_s[1:], breaks_s)))
    return -math.log(2.0) + float(np.sum(_log_odds_of_further(knots_s, before)))


def _log_odds_of_further(knots_s: FloatArray, before: NDArray[np.int64]) -> FloatArray:
    """(break,) log prior odds of one break more somewhere in an interval between knots, over none there [-].

    knots_s : (knot,) of the error [s];  before : (break,) breaks there are besides
    """
    return np.asarray(np.log(0.5 * (before + 1) * np.max(np.diff(knots_s)) / (knots_s[-1] - knots_s[0])))


def finer_knots(knots_s: FloatArray, breaks_s: Sequence[float]) -> FloatArray:
    """(knot,) of an error with the intervals about its breaks divided: between knots it is linear, and jumps are not.

    knots_s : (knot,) [s];  breaks_s : from which on the error is new, at knots or between them [s]

    Source: docs/theory/model_error.md, equation 5d and what follows it.
    """
    broken, last = np.searchsorted(knots_s, breaks_s), len(knots_s) - 1
    beside = {k for b in broken.tolist() for k in (b - 1, b, b + 1) if 1 <= k <= last}
    within = [np.linspace(knots_s[k - 1], knots_s[k], PIECES + 1) for k in beside]
    return np.unique(np.concatenate([knots_s, *within]))


def with_breaks(
    read: ReadError, knots_s: FloatArray, correlation: Correlation, sigma: float
) -> tuple[float, Correlation]:
    """The gain in log evidence by other breaks, their prior included, and the correlation with them [-].

    knots_s : (knot,) of the error [s];  correlation : as it is, with its breaks;  sigma : of the error [-]

    The break whose addition or removal gains most is added or removed, as long as that gains. With z = 1 for one that
    is added and -1 for one that is removed, it changes the information by z E D E', with E (knot, 2) the two knots
    beside it, and the covariance P of the knots by -z P E (1 + z D C)^-1 D E' P.

    Source: docs/theory/model_error.md, equations 5c and 5d.
    """
    least_gain = 1e-6  # below it two breaks could be added and removed in turn [-]
    a = np.exp(-np.diff(knots_s) / correlation.time_s)
    D = (a / (sigma**2 * (1.0 - a**2)))[:, np.newaxis, np.newaxis] * np.stack(
        [np.stack([-a, np.ones_like(a)], axis=-1), np.stack([np.ones_like(a), -a], axis=-1)], axis=-2
    )
    is_broken = np.isin(knots_s[1:], correlation.breaks_s)
    P = _covariance(read.information, np.where(is_broken, 0.0, a), sigma)
    mean, gained = P @ read.score, 0.0
    before, k = np.arange(len(a)), np.arange(1, len(a) + 1)
    while True:
        z, count = np.where(is_broken, -1.0, 1.0), int(np.count_nonzero(is_broken))
        C = np.stack([P[before, before], P[before, k], P[before, k], P[k, k]], axis=-1).reshape(-1, 2, 2)
        m = np.stack([mean[:-1], mean[1:]], axis=-1)[..., np.newaxis]
        zD = z[:, np.newaxis, np.newaxis] * D
        inner = np.eye(2) + zD @ C
        change = np.linalg.solve(inner, zD)
        lost = (np.swapaxes(m, 1, 2) @ change @ m)[:, 0, 0]
        with np.errstate(invalid="ignore", divide="ignore"):
            gain = 0.5 * (z * np.log1p(-(a**2)) - np.log(np.linalg.det(inner)) - lost)
        gain += z * _log_odds_of_further(knots_s, count - is_broken.astype(int))
        is_possible = np.isfinite(gain) & (is_broken | (count < MOST_BREAKS))
        gain = np.where(is_possible, gain, -np.inf)
        best = int(np.argmax(gain))
        if gain[best] <= least_gain:
            break
        gained += float(gain[best])
        is_broken[best] = not is_broken[best]
        beside = P[:, best : best + 2]
        mean = mean - beside @ (change[best] @ m[best, :, 0])
        P = P - beside @ change[best] @ beside.T
    return gained, replace(correlation, breaks_s=tuple(knots_s[1:][is_broken].tolist()))


def _covariance(information: FloatArray, a: FloatArray, sigma: float) -> FloatArray:
    """(knot, knot) covariance of a first-order error of the standard deviation sigma [-], given readings.

    information : (knot, knot) of the readings;  a : (interval,) correlation of neighbouring values, 0 at a break [-]

    Source: the inverse of docs/theory/model_error.md, equation 1, which is tridiagonal.
    """
    inverse = 1.0 / (sigma**2 * (1.0 - a**2))
    total, knots = information.copy(), np.arange(len(a) + 1)
    total[knots[0], knots[0]] += sigma**-2.0
    total[knots[1:], knots[1:]] += inverse
    total[knots[:-1], knots[:-1]] += a**2 * inverse
    total[knots[:-1], knots[1:]] -= a * inverse
    total[knots[1:], knots[:-1]] -= a * inverse
    scale = 1.0 / np.sqrt(np.diag(total))
    covariance, _ = dpotri(np.linalg.cholesky(total * np.outer(scale, scale)), lower=True)
    covariance = np.tril(covariance) + np.tril(covariance, -1).T
    return np.asarray(covariance * np.outer(scale, scale))
