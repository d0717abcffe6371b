"""Times at which the error of a heating starts anew, as that of a trajectory that was put together from arcs.

Between knots k and k + 1, a distance h apart, a first-order Gauss-Markov process of standard deviation s has the
precision 1 / (s^2 (1 - a^2)) [[a^2, -a], [-a, 1]] with a = exp(-h / tau). Where it starts anew that is 1 / s^2 of the
later knot alone. One break changes the information of all unknowns at these two knots only, so that its gain in log
evidence follows from their covariance:

    gain = log(1 - a^2) / 2 - log det(1 + D C) / 2 - m' (1 + D C)^-1 D m / 2,
    D = a / (s^2 (1 - a^2)) [[-a, 1], [1, -a]],

with C (2, 2) the covariance of the two values and m (2,) their means before. Derived in docs/theory/model_error.md,
equation 5d.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sim_heating.base.arrays import BoolArray, FloatArray
from sim_heating.estimation.inference.model_error import Correlation

PIECES = 5
"""Pieces of an interval between knots in which an error starts anew."""
MOST_BREAKS = 40
"""Most times at which the error of a record is taken to start anew."""


class ReadUnknowns(NamedTuple):
    """What readings say of the heating's error and of all other unknowns, linear in both.

    information : (unknown, unknown) of the readings and of the priors of the others, the knots' values last, in
                  equation 5 of docs/theory/model_error.md J' J with S' S
    score       : (unknown,) at values of 0
    """

    information: FloatArray
    score: FloatArray


def log_prior(knots_s: FloatArray, breaks_s: Sequence[float]) -> float:
    """Log probability of breaks in the intervals before some knots, each further one half as probable, wherever it is.

        -(n + 1) log 2 + log n! + sum log(h_i / T)

    knots_s : (knot,) of the error, T from the first to the last [s];  breaks_s : n knots, h_i after the one before [s]

    Source: docs/theory/model_error.md, equation 5c.
    """
    log_odds = _log_odds_of_further(knots_s, np.arange(len(breaks_s)), np.isin(knots_s[1:], breaks_s))
    return -math.log(2.0) + float(np.sum(log_odds))


def _log_odds_of_further(knots_s: FloatArray, before: NDArray[np.int64] | int, chosen: BoolArray | slice) -> FloatArray:
    """(interval,) log prior odds of a further break in some intervals between knots, over none there [-].

    knots_s : (knot,) of the error [s];  before : breaks there are besides;  chosen : of the intervals
    """
    h = np.diff(knots_s)[chosen]
    return np.asarray(np.log(0.5 * (before + 1) * h / (knots_s[-1] - knots_s[0])))


def finer_knots(knots_s: FloatArray, breaks_s: Sequence[float]) -> FloatArray:
    """(knot,) of an error with the intervals about its breaks divided: between knots it is linear, and jumps are not.

    knots_s : (knot,) [s];  breaks_s : of them, those from which on the error is new

    Source: docs/theory/model_error.md, equation 5d and what follows it.
    """
    broken, last = np.flatnonzero(np.isin(knots_s, breaks_s)), len(knots_s) - 1
    beside = {k for b in broken.tolist() for k in (b - 1, b, b + 1) if 1 <= k <= last}
    within = [np.linspace(knots_s[k - 1], knots_s[k], PIECES + 1) for k in beside]
    return np.unique(np.concatenate([knots_s, *within]))


def one_more_break(
    read: ReadUnknowns, knots_s: FloatArray, correlation: Correlation, sigma: float
) -> tuple[float, Correlation]:
    """The gain in log evidence by the likeliest further break, its prior included, and the correlation with it [-].

    knots_s : (knot,) of the error [s];  correlation : as it is, with its breaks;  sigma : of the error [-]

    Source: docs/theory/model_error.md, equations 5c and 5d.
    """
    a = np.exp(-np.diff(knots_s) / correlation.time_s)
    is_broken = np.isin(knots_s[1:], correlation.breaks_s)
    first = len(read.score) - len(knots_s)
    information = read.information.copy()
    knots = np.arange(first, len(read.score))
    diagonal, beside = precision(np.where(is_broken, 0.0, a))
    information[knots, knots] += diagonal / sigma**2
    information[knots[:-1], knots[1:]] += beside / sigma**2
    information[knots[1:], knots[:-1]] += beside / sigma**2
    scale = 1.0 / np.sqrt(np.diag(information))
    covariance = np.linalg.inv(information * np.outer(scale, scale)) * np.outer(scale, scale)
    mean = covariance @ read.score
    k = knots[:-1]
    C = np.stack([covariance[k, k], covariance[k, k + 1], covariance[k, k + 1], covariance[k + 1, k + 1]], axis=-1)
    C, m = C.reshape(-1, 2, 2), np.stack([mean[k], mean[k + 1]], axis=-1)[..., np.newaxis]
    D = (a / (sigma**2 * (1.0 - a**2)))[:, np.newaxis, np.newaxis] * np.stack(
        [np.stack([-a, np.ones_like(a)], axis=-1), np.stack([np.ones_like(a), -a], axis=-1)], axis=-2
    )
    inner = np.eye(2) + D @ C
    volume = np.linalg.det(inner)
    lost = (np.swapaxes(m, 1, 2) @ np.linalg.solve(inner, D @ m))[:, 0, 0]
    with np.errstate(invalid="ignore", divide="ignore"):
        gain = 0.5 * (np.log1p(-(a**2)) - np.log(volume) - lost)
    gain = np.where(is_broken | ~np.isfinite(gain), -np.inf, gain)
    gain += _log_odds_of_further(knots_s, len(correlation.breaks_s), slice(None))
    best = int(np.argmax(gain))
    breaks = tuple(sorted((*correlation.breaks_s, float(knots_s[best + 1]))))
    return float(gain[best]), replace(correlation, breaks_s=breaks)


def precision(a: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(knot,) diagonal of the inverse correlation matrix of a first-order process, and (interval,) beside it [-].

    a : (interval,) correlation of neighbouring values, 0 where the process starts anew

    Source: the inverse of exp(-|t_i - t_j| / tau) of docs/theory/model_error.md, equation 1, which is tridiagonal.
    """
    inverse = 1.0 / (1.0 - a**2)
    diagonal = np.ones(len(a) + 1)
    diagonal[1:] = inverse
    diagonal[:-1] += a**2 * inverse
    return diagonal, -a * inverse
