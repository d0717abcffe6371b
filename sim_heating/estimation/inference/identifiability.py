"""Directions in parameter space that an information matrix identifies, and the covariance that follows from it.

With parameters scaled to unit information each, s_i = 1 / sqrt(M_ii), the scaled matrix has ones on its diagonal, and
the eigenvalue of a direction is the information on the parameters changed together over that on each alone: two
parameters of correlation rho have the eigenvalues 1 +- rho. A direction is singular where its eigenvalue is below
a threshold. Derived in docs/theory/estimation_statistics.md, equations 18 and 19.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sim_heating.base.arrays import FloatArray

SINGULAR = 1e-6
"""Scaled eigenvalue of an unidentified direction: its bound is a thousand times that of each parameter alone."""
ROUNDING = 1e-11
"""Scaled eigenvalue that rounding alone may produce in place of 0."""
NAMED_COMPONENT = 0.1
"""Component of a direction of unit length above which a parameter is named."""


@dataclass(frozen=True, eq=False)
class Direction:
    """A direction of the scaled parameters.

    eigenvalue : information along it, over that on each parameter alone [-]
    change     : (parameter,) change of the parameters along it, in their units, the largest scaled component positive
    members    : names of the parameters that change, the largest component first
    opposed    : whether some of them change in the direction opposite to the first

    Source: docs/theory/estimation_statistics.md, equation 19.
    """

    eigenvalue: float
    change: FloatArray
    members: tuple[str, ...]
    opposed: bool

    def describe(self) -> str:
        """One clause for a report, naming the parameters that the data do not separate."""
        if len(self.members) == 1:
            return f"the data do not identify {self.members[0]}"
        listed = " and ".join((", ".join(self.members[:-1]), self.members[-1]))
        how = "in opposite directions" if self.opposed else "together"
        return f"the data do not separate {listed}: they may change {how}"


def scale(information: FloatArray) -> FloatArray:
    """(parameter,) standard deviation of each parameter with all others known, s_i = 1 / sqrt(M_ii).

    information : (parameter, parameter) in the inverse units of the parameters ([-] for a ratio)
    returns     : in the units of the parameters; 1 where the diagonal is not positive

    Source: docs/theory/estimation_statistics.md, equation 19.
    """
    diagonal = np.diag(information)
    return 1.0 / np.sqrt(np.where(diagonal > 0.0, diagonal, 1.0))


def scaled_eigenvectors(information: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Eigenvalues and eigenvectors of the information scaled to ones on its diagonal, s_i M_ij s_j.

    information : (parameter, parameter), symmetrised first
    returns     : (parameter,) eigenvalues [-], increasing and not below 0; eigenvectors [-] as columns

    Source: docs/theory/estimation_statistics.md, equation 19.
    """
    s = scale(information)
    # unscaled, the eigenvalues would rank the units of the parameters: sigmas span 1e-5 to 1e2
    values, vectors = np.linalg.eigh(0.5 * (information + information.T) * np.outer(s, s))
    return np.maximum(values, 0.0), vectors


def directions(information: FloatArray, names: Sequence[str], threshold: float = SINGULAR) -> list[Direction]:
    """Directions whose scaled eigenvalue lies below a threshold, the least identified first.

    information : (parameter, parameter);  names : (parameter,)
    threshold   : threshold on the scaled eigenvalue [-]

    Source: docs/theory/estimation_statistics.md, equation 19.
    """
    values, vectors = scaled_eigenvectors(information)
    s = scale(information)
    return [_direction(float(v), vectors[:, k], s, names) for k, v in enumerate(values) if v < threshold]


def _direction(eigenvalue: float, vector: FloatArray, s: FloatArray, names: Sequence[str]) -> Direction:
    order = np.argsort(-np.abs(vector))
    # the sign of an eigenvector is arbitrary: it is fixed so that reports of similar fits agree
    vector = vector * np.sign(vector[order[0]])
    named = [i for i in order if abs(vector[i]) >= NAMED_COMPONENT]
    return Direction(eigenvalue, vector * s, tuple(names[i] for i in named), bool(np.any(vector[named] < 0.0)))


def covariance(information: FloatArray) -> FloatArray:
    """Covariance of parameters from their information: its inverse, through the scaled eigenvectors.

    information : (parameter, parameter) of data and priors ([-] for parameters without unit)
    returns     : (parameter, parameter); infinite variance and NaN covariances for parameters with a component in
                  a direction whose scaled eigenvalue is below ROUNDING

    Source: docs/theory/estimation_statistics.md, equations 18 and 19.
    """
    values, vectors = scaled_eigenvectors(information)
    identified = values > ROUNDING
    s = scale(information)
    inverse = (vectors[:, identified] / values[identified]) @ vectors[:, identified].T * np.outer(s, s)
    # a pseudo-inverse would report a small variance in directions without any information
    undetermined = np.sum(vectors[:, ~identified] ** 2, axis=1) > ROUNDING
    inverse[undetermined, :] = np.nan
    inverse[:, undetermined] = np.nan
    inverse[undetermined, undetermined] = np.inf
    return inverse


def predicted_gain(gradient: FloatArray, covariance: FloatArray) -> float:
    """Improvement of the log likelihood [-] that a whole Newton step predicts, g' C g / 2, along identified directions.

    gradient   : (parameter,) g
    covariance : (parameter, parameter) C; entries that are not finite count as 0

    Source: docs/theory/estimation_statistics.md, equation 17.
    """
    identified = np.where(np.isfinite(covariance), covariance, 0.0)
    return 0.5 * float(gradient @ identified @ gradient)


def correlation(covariance: FloatArray) -> FloatArray:
    """Correlation matrix [-] of a covariance, ones on its diagonal; NaN where a variance is not finite or 0.

    covariance : (parameter, parameter)

    Source: docs/theory/estimation_statistics.md, equation 18.
    """
    sigma = np.sqrt(np.diag(covariance))
    with np.errstate(invalid="ignore"):
        matrix = covariance / np.outer(sigma, sigma)
    np.fill_diagonal(matrix, 1.0)
    return matrix
