"""What data tell apart: directions in parameter space that an information matrix sees, in words.

With parameters scaled to unit information each, s_i = 1 / sqrt(M_ii), the scaled matrix has ones on its diagonal and
the eigenvalue of a direction says by how much less the data tell of the parameters moved together than of each alone:
two parameters of correlation rho have the eigenvalues 1 +- rho. A direction is singular where its eigenvalue is below
a threshold.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sim_heating.base.arrays import FloatArray

SINGULAR = 1e-6
"""Scaled eigenvalue of a direction that cannot be told: a bound a thousand times that of each parameter alone."""
ROUNDING = 1e-11
"""Scaled eigenvalue that rounding alone may make of 0."""
PART = 0.1
"""Part in a direction of unit length from which on a parameter is named."""


@dataclass(frozen=True, eq=False)
class Direction:
    """A direction of the scaled parameters.

    eigenvalue : information along it, over that on each parameter alone
    move       : (parameter,) change of the parameters along it, in their units, the largest scaled part positive
    members    : names of the parameters that move, the largest part first
    opposed    : whether some of them move against the first
    """

    eigenvalue: float
    move: FloatArray
    members: tuple[str, ...]
    opposed: bool

    def words(self) -> str:
        """The direction as a person would say it."""
        if len(self.members) == 1:
            return f"the data do not inform {self.members[0]}"
        listed = " and ".join((", ".join(self.members[:-1]), self.members[-1]))
        how = "against each other" if self.opposed else "together"
        return f"{listed} move {how} without the data telling"


def scale(information: FloatArray) -> FloatArray:
    """(parameter,) change of each parameter that its own information tells, 1 / sqrt(M_ii); 1 where there is none."""
    own = np.diag(information)
    return 1.0 / np.sqrt(np.where(own > 0.0, own, 1.0))


def scaled_eigenvectors(information: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Eigenvalues, increasing, and eigenvectors as columns of the information scaled to ones on its diagonal."""
    s = scale(information)
    values, vectors = np.linalg.eigh(0.5 * (information + information.T) * np.outer(s, s))
    return np.maximum(values, 0.0), vectors


def directions(information: FloatArray, names: Sequence[str], below: float = SINGULAR) -> list[Direction]:
    """Directions whose scaled eigenvalue lies below a threshold, least told first."""
    values, vectors = scaled_eigenvectors(information)
    s = scale(information)
    return [_direction(float(v), vectors[:, k], s, names) for k, v in enumerate(values) if v < below]


def _direction(eigenvalue: float, vector: FloatArray, s: FloatArray, names: Sequence[str]) -> Direction:
    order = np.argsort(-np.abs(vector))
    vector = vector * np.sign(vector[order[0]])
    parts = [i for i in order if abs(vector[i]) >= PART]
    return Direction(eigenvalue, vector * s, tuple(names[i] for i in parts), bool(np.any(vector[parts] < 0.0)))


def covariance(information: FloatArray) -> FloatArray:
    """Inverse of an information matrix; infinite variance, NaN covariance for parameters that it does not tell."""
    values, vectors = scaled_eigenvectors(information)
    told = values > ROUNDING
    s = scale(information)
    inverse = (vectors[:, told] / values[told]) @ vectors[:, told].T * np.outer(s, s)
    untold = np.sum(vectors[:, ~told] ** 2, axis=1) > ROUNDING
    inverse[untold, :] = np.nan
    inverse[:, untold] = np.nan
    inverse[untold, untold] = np.inf
    return inverse


def promised_gain(gradient: FloatArray, covariance: FloatArray) -> float:
    """Gain in log likelihood that a whole Newton step promises along the directions that are told."""
    told = np.where(np.isfinite(covariance), covariance, 0.0)
    return 0.5 * float(gradient @ told @ gradient)


def correlation(covariance: FloatArray) -> FloatArray:
    """Correlation matrix of a covariance, ones on its diagonal; NaN where a variance is not finite."""
    sigma = np.sqrt(np.diag(covariance))
    with np.errstate(invalid="ignore"):
        matrix = covariance / np.outer(sigma, sigma)
    np.fill_diagonal(matrix, 1.0)
    return matrix
