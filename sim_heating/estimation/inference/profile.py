"""Interval of one parameter by the profile of the likelihood: where the others, refitted, leave it improbable.

    l(x) = log L / c + log prior at the values of the others that maximise log L + log prior,
    D(x) = 2 [max l - l(x)],     D = 3.84 at both ends of the 95 % interval,

3.84 the 95 % point of chi-square with one degree of freedom (S. S. Wilks, Ann. Math. Stat. 9 (1938) 60). c is the
variance of the estimate corrected for coloured residuals over that without the correction, by which a likelihood that
takes them as white is too steep (R. E. Chandler and S. Bate, "Inference for clustered data using the independence
loglikelihood", Biometrika 94 (2007) 167).

Sigma assumes that the likelihood is a parabola. At a kink, on a bound, and for an onset or a width that the flight
hardly tells, it is none: the profile is what it is. Where D stays below the limit up to a bound, the interval ends
there and is open. Derived in docs/theory/estimation_statistics.md, equation 26a.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import gammaincinv

from sim_heating.base.arrays import FloatArray
from sim_heating.base.files import finite_or_none
from sim_heating.base.parameters import Parameter
from sim_heating.estimation.inference.newton import Evaluation, Fit, maximise
from sim_heating.estimation.problem import FitProblem

LIMIT = 2.0 * float(gammaincinv(0.5, 0.95))
"""D at the ends of the 95 % interval [-], 3.84."""
FIRST_STEP, GROWTH = 0.7, 1.6
"""First step outward over sigma [-], and the factor on further steps while D rises by less than FLAT."""
FLAT = 0.5
MOST_STEPS, MOST_CLOSER = 16, 5
"""Steps on either side, and refinements of either end, at most."""
CLOSE = 0.05
"""Distance of D from the limit, over the limit [-], at which an end is found."""
SPAN_SHARE = 0.05
"""First step of a parameter without a sigma, over the span of its bounds [-]."""
LIKELIER = 0.1
"""Gain in log posterior over the fit [-] above which the profile has found a likelier value."""


@dataclass(frozen=True, eq=False)
class Profile:
    """The profile of the likelihood of one parameter.

    name, unit  : of the parameter
    value       : most probable value
    lower, upper : ends of the 95 % interval; infinite where nothing limits it
    lower_open, upper_open : whether an end is a bound, or infinite, which the record does not exclude
    values      : (point,) ascending;  deviance : (point,) D there [-]
    colour      : c [-]
    gain        : log posterior above that of the fit [-], where the profile found a likelier value
    """

    name: str
    unit: str
    value: float
    lower: float
    upper: float
    lower_open: bool
    upper_open: bool
    values: FloatArray
    deviance: FloatArray
    colour: float
    gain: float = 0.0

    def in_words(self) -> str:
        """Value and interval in a line."""
        unit = "" if self.unit == "1" else f" {self.unit}"
        ends = [_end(self.lower, self.lower_open), _end(self.upper, self.upper_open)]
        line = f"{self.name}: {self.value:.5g}{unit}, 95 % interval {ends[0]} to {ends[1]}{unit} by the profile"
        if self.gain > LIKELIER:
            line += f"; the profile is {self.gain:.1f} units of log likelihood above the fit: fit again from this value"
        return line

    def as_json(self) -> dict[str, Any]:
        """Its entry in estimate.json."""
        return {
            "value": self.value,
            "lower": finite_or_none(self.lower),
            "upper": finite_or_none(self.upper),
            "lower_open": self.lower_open,
            "upper_open": self.upper_open,
            "unit": self.unit,
            "limit": LIMIT,
            "colour": self.colour,
            "values": self.values.tolist(),
            "deviance": self.deviance.tolist(),
        }


def _end(value: float, is_open: bool) -> str:
    if not math.isfinite(value):
        return "no limit"
    return f"its bound {value:.5g}" if is_open else f"{value:.5g}"


def profile(problem: FitProblem, fit: Fit, name: str, colour: float) -> Profile:
    """The profile of the likelihood of one parameter of a fit, and its 95 % interval.

    problem  : with the noise that the fit ended with, which is held
    fit      : of this problem
    name     : label of the parameter
    colour   : variance of the estimate corrected for coloured residuals over that without the correction [-]

    Each refit begins with the values of its neighbour. Source: docs/theory/estimation_statistics.md, equation 26a.
    """
    walk = _Walk(problem, fit, fit.names.index(name), colour)
    ends = [walk.end(side) for side in (-1.0, 1.0)]
    values = np.array(sorted(walk.refits))
    log_posterior = np.array([walk.refits[v].log_posterior for v in values])
    best = int(np.argmax(log_posterior))
    (lower, lower_open), (upper, upper_open) = ends
    deviance, gain = np.array([walk.deviance(v) for v in values]), float(log_posterior[best] - fit.log_posterior)
    interval = (lower, upper, lower_open, upper_open)
    return Profile(name, walk.parameter.unit, float(values[best]), *interval, values, deviance, colour, gain)


@dataclass(frozen=True, eq=False)
class _Refit:
    """All (parameter,) values where one is held and the others are refitted, log posterior and log prior there [-]."""

    values: FloatArray
    log_posterior: float
    log_prior: float


class _Walk:
    """Refits along one parameter, outward from the values of a fit."""

    def __init__(self, problem: FitProblem, fit: Fit, index: int, colour: float) -> None:
        self.problem, self.at, self.colour = problem, index, colour
        self.parameters: Sequence[Parameter] = problem.parameters
        self.parameter = self.parameters[index]
        self.others = [p for k, p in enumerate(self.parameters) if k != index]
        self.begin = fit.values
        self.refits = {float(fit.values[index]): self._told(fit.values, fit.log_posterior)}
        variance = float(fit.covariance[index, index])
        is_bounded = math.isfinite(variance) and variance > 0.0
        span = self.parameter.upper - self.parameter.lower
        size = abs(self.parameter.value) or 1.0
        wide = math.sqrt(variance * colour) if is_bounded else 0.0
        self.step = FIRST_STEP * wide if is_bounded else SPAN_SHARE * (span if math.isfinite(span) else size)
        # along the ridge of a parabola the others move with the parameter
        self.ridge = fit.covariance[:, index] / variance if is_bounded else np.zeros_like(fit.values)
        self.ridge = np.where(np.isfinite(self.ridge), self.ridge, 0.0)

    def _told(self, values: FloatArray, log_posterior: float) -> _Refit:
        prior = sum(-0.5 * ((v - p.value) / p.sigma) ** 2 for v, p in zip(values, self.parameters, strict=True))
        return _Refit(values, log_posterior if math.isfinite(log_posterior) else -math.inf, float(prior))

    def _weighed(self, refit: _Refit) -> float:
        return (refit.log_posterior - refit.log_prior) / self.colour + refit.log_prior

    def deviance(self, value: float) -> float:
        """D at a value, whose refit is made where it is not known yet."""
        if value not in self.refits:
            self.refits[value] = self._refit(value)
        best = max(self._weighed(refit) for refit in self.refits.values())
        return 2.0 * (best - self._weighed(self.refits[value]))

    def _refit(self, value: float) -> _Refit:
        near = min(self.refits, key=lambda v: abs(v - value))
        start = self.refits[near].values + self.ridge * (value - near)
        k = self.at

        def with_value(rest: FloatArray) -> FloatArray:
            return np.insert(rest, k, value, axis=-1)

        log_prior = -0.5 * ((value - self.parameter.value) / self.parameter.sigma) ** 2
        if not self.others:
            alone = np.array([value])
            return self._told(alone, float(self.problem.log_likelihoods(alone[np.newaxis])[0]) + log_prior)

        def evaluate(rest: FloatArray) -> Evaluation:
            evaluation = self.problem.evaluate(with_value(rest))
            gradient, information = np.delete(evaluation.gradient, k), evaluation.information
            return Evaluation(evaluation.log_likelihood, gradient, np.delete(np.delete(information, k, 0), k, 1))

        def log_likelihoods(candidates: FloatArray) -> FloatArray:
            return self.problem.log_likelihoods(with_value(candidates))

        fits = [maximise(evaluate, self.others, np.delete(start, k), log_likelihoods)]
        if not math.isfinite(fits[0].log_posterior):  # the ridge led out of what can be marched
            first = np.delete(self.refits[near].values, k)
            fits.append(maximise(evaluate, self.others, first, log_likelihoods))
        return self._told(with_value(fits[-1].values), fits[-1].log_posterior + log_prior)

    def end(self, side: float) -> tuple[float, bool]:
        """An end of the interval, and whether it is a bound, or infinite, that the record does not exclude.

        side : -1 for the lower end, 1 for the upper one
        """
        bound = self.parameter.lower if side < 0.0 else self.parameter.upper
        inner, step, before = float(self.begin[self.at]), self.step, 0.0
        for _ in range(MOST_STEPS):
            if inner == bound:
                return bound, True
            outer = inner + side * step
            outer = max(outer, bound) if side < 0.0 else min(outer, bound)
            deviance = self.deviance(outer)
            if deviance > LIMIT:
                return self._between(inner, outer), False
            step *= GROWTH if deviance - before < FLAT else 1.0
            inner, before = outer, deviance
        if inner == bound:
            return bound, True
        return (bound if math.isfinite(bound) else side * math.inf), True

    def _between(self, inner: float, outer: float) -> float:
        """Where D passes the limit between two values, linear in its root."""
        for k in range(MOST_CLOSER):
            roots = [math.sqrt(max(self.deviance(v), 0.0)) for v in (inner, outer)]
            if not math.isfinite(roots[1]) or k % 3 == 2:
                middle = 0.5 * (inner + outer)
            else:
                middle = inner + (math.sqrt(LIMIT) - roots[0]) / (roots[1] - roots[0]) * (outer - inner)
            if middle in (inner, outer):
                return middle
            deviance = self.deviance(middle)
            if abs(deviance - LIMIT) < CLOSE * LIMIT:
                return middle
            inner, outer = (middle, outer) if deviance < LIMIT else (inner, middle)
        return 0.5 * (inner + outer)
