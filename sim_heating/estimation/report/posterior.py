"""A fit as a posterior that a sampler takes: log density, gradient, names, priors and bounds."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.estimation.inference.newton import Priors
from sim_heating.estimation.problem import FitProblem


@dataclass(frozen=True, eq=False)
class Posterior:
    """The posterior of a fit's parameters, each in its own unit, as emcee, PyMC or pocoMC call it.

    problem : of the fit;  start, covariance : most probable values, and their covariance corrected for colour

    The likelihood counts residuals as white. Where they are coloured, the samples scatter less than `covariance`.
    A normal prior is cut off at the bounds, without a change of its constant.
    """

    problem: FitProblem
    start: FloatArray
    covariance: FloatArray

    def __repr__(self) -> str:
        return f"<Posterior of {', '.join(self.names)}>"

    @property
    def names(self) -> tuple[str, ...]:
        """(parameter,) labels."""
        return tuple(u.label for u in self.problem.unknowns)

    @property
    def priors(self) -> Mapping[str, tuple[float, float]]:
        """Mean and standard deviation of each normal prior, in its unit ([-], [K] ...); an infinite one is flat.

        Source: docs/theory/estimation_statistics.md, equation 13.
        """
        return {u.label: (u.parameter.value, u.parameter.sigma) for u in self.problem.unknowns}

    @property
    def bounds(self) -> FloatArray:
        """(parameter, 2) least and greatest values, each in its unit ([-], [K] ...).

        Source: docs/theory/estimation_statistics.md, equation 13.
        """
        return np.stack([self._priors.lower, self._priors.upper], axis=1)

    @cached_property
    def _priors(self) -> Priors:
        return Priors.of(self.problem.parameters)

    def log_prior(self, values: FloatArray) -> FloatArray:
        """(...,) log density [-] of (..., parameter) values without its constant; -inf beyond a bound.

        Source: docs/theory/estimation_statistics.md, equation 13.
        """
        priors = self._priors
        inside = np.all((values >= priors.lower) & (values <= priors.upper), axis=-1)
        return np.where(inside, priors.log_prior(values), -np.inf)

    def log_likelihood(self, values: FloatArray) -> FloatArray:
        """(...,) log likelihood [-] of (..., parameter) values, marched side by side; -inf where a march fails.

        Source: docs/theory/estimation_statistics.md, equations 3 and 5.
        """
        values = np.asarray(values, dtype=float)
        found = self.problem.log_likelihoods(np.atleast_2d(values))
        return np.where(np.isfinite(found), found, -np.inf).reshape(values.shape[:-1])

    def log_posterior(self, values: FloatArray) -> FloatArray:
        """(...,) log density [-] of (..., parameter) values without its constant; -inf beyond a bound, unmarched.

        Source: docs/theory/estimation_statistics.md, equation 13.
        """
        values = np.asarray(values, dtype=float)
        density = np.atleast_1d(self.log_prior(values))
        allowed = np.isfinite(density)
        if np.any(allowed):
            density[allowed] += self.log_likelihood(np.atleast_2d(values)[allowed])
        return density.reshape(values.shape[:-1])

    def gradient(self, values: FloatArray) -> FloatArray:
        """(parameter,) gradient of the log posterior at (parameter,) values within the bounds, over [-], [K] ...

        Source: docs/theory/estimation_statistics.md, equation 14.
        """
        values = np.asarray(values, dtype=float)
        return self._priors.evaluation(values, self.problem.evaluate(values)).gradient
