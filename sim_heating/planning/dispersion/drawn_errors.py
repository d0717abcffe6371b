"""The smooth error of the heating of dispersed flights: how large it is, how far in time it is alike, and its values.

The heating of a flight is q (1 + e(t)), e = s L g linear between knots, as the bands of a prediction have it. Its
standard deviation s and its correlation L L' are drawn together, by what the flights behind an estimate say of them,
else by their prior; g are independent standard normal numbers. Each control point has an error of its own: how alike
two of them are is not known. Source: docs/theory/model_error.md, equations 1, 1a and 5.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from sim_heating.base.arrays import FloatArray, IntArray
from sim_heating.base.conditions import Conditions
from sim_heating.closure.prior.model_error import MEASURED_FLIGHT
from sim_heating.estimation.inference.model_error import ErrorSize
from sim_heating.planning.bands import error_knots, heating_sizes
from sim_heating.planning.dispersion.drawn_members import DrawnMember
from sim_heating.planning.dispersion.statistics import choices


@dataclass(frozen=True, eq=False)
class DrawnError:
    """The error of the heating of one control point.

    sizes   : standard deviations and correlations with their probabilities
    knots_s : (knot,) times between which it is linear [s]; it holds its first and its last value outside them
    """

    sizes: ErrorSize
    knots_s: FloatArray

    @property
    def columns(self) -> int:
        """Number of normal numbers of a flight: which size and correlation it has, then one a knot."""
        return 1 + len(self.knots_s)

    @cached_property
    def _roots(self) -> FloatArray:
        """(correlation, knot, knot) lower roots of the correlation matrices [-]."""
        return np.array([correlation.root(self.knots_s) for correlation in self.sizes.correlations])

    def _drawn(self, z: FloatArray) -> tuple[IntArray, IntArray]:
        """(flight,) numbers of the correlation and of the size of each flight."""
        probability = self.sizes.posterior_of_heating
        correlation, size = np.unravel_index(choices(probability.ravel(), z[:, 0]), probability.shape)
        return np.asarray(correlation), np.asarray(size)

    def sigma(self, z: FloatArray) -> FloatArray:
        """(flight,) standard deviation of the error that each flight has [-].

        z : (flight, number) standard normal numbers, `columns` of them or more
        """
        return np.asarray(self.sizes.sizes[self._drawn(z)[1]])

    def at_knots(self, z: FloatArray) -> FloatArray:
        """(flight, knot) relative error of the heating [-]; z : as of `sigma`."""
        root = self._roots[self._drawn(z)[0]]
        return self.sigma(z)[:, np.newaxis] * np.einsum("fij,fj->fi", root, z[:, 1 : self.columns])

    def of_all_sizes(self, slope: FloatArray) -> FloatArray:
        """Slopes [K] that have the variance by every size and correlation, by their probabilities.

        slope : (quantity, knot) of a peak, for a unit of the number of each knot with the likeliest size [K]
        """
        planned = np.zeros((1, self.columns))
        (correlation,), (sigma,) = self._drawn(planned)[0], self.sigma(planned)
        if sigma == 0.0:
            return slope
        response = np.linalg.solve(self._roots[correlation].T, slope.T).T / sigma  # to a unit of the error at a knot
        by_correlation = np.array([np.sum((response @ root) ** 2, axis=-1) for root in self._roots])
        variance = np.tensordot(self.sizes.posterior_of_heating @ self.sizes.sizes**2, by_correlation, 1)
        planned_variance = np.sum(slope**2, axis=-1)
        ratio = np.divide(variance, planned_variance, out=np.zeros_like(variance), where=planned_variance > 0.0)
        return np.asarray(slope * np.sqrt(ratio)[:, np.newaxis])


def drawn_errors(member: DrawnMember, flown: Sequence[Conditions]) -> list[DrawnError]:
    """The error of the heating of each control point of a member; flown : conditions of each along the planned flight.

    It has the size that the band of `run` has.
    """
    errors = []
    for of_point, conditions in zip(member.of_points, flown, strict=True):
        sizes = heating_sizes(MEASURED_FLIGHT, of_point)
        assert sizes is not None  # the prior has a size
        errors.append(DrawnError(sizes, error_knots(conditions, sizes)))
    return errors
