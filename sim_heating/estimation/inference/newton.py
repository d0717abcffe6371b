"""Newton-Raphson search for the most probable parameters within their bounds.

With log likelihood L(p), gradient g and information M (Gauss-Newton, or observed), priors N(value, sigma^2):

    (M + P) step = g + P (value - p),   P = diag(1 / sigma^2),   0 for a flat prior

on the parameters that are not fixed at a bound; the step is shortened until the posterior grows and is cut off at the
bounds (Bertsekas, "Projected Newton Methods for Optimization Problems with Simple Constraints", SIAM J. Control Optim.
20 (1982)). The whole step is tried first, and a few more from its end where it does not help (Chamberlain et al., "The
watchdog technique for forcing convergence", Math. Programming Study 16 (1982)); then all fractions of it in one call,
and from then on the whole step and its fractions together, until a whole step helps again.
Levenberg damping where M + P is singular, more where no fraction helps. Converged when a full step predicts an
improvement below `min_improvement` and changes no parameter by more than `min_step` of its sigma.

A likelihood may have a kink: an onset at an angle that was flown for long is one. There the gradient points uphill and
no step raises the posterior. The gradient just beyond then points back, and a change y of the gradient over so short a
step s is information across the kink,

    K = y y' / (y' s),   y = g(p) - g(p + s) - (M + P + K_before) s,

that joins M + P for the next steps: they follow the kink.
Converged where such a step is a small part of each sigma, or where no step helps and the whole one is that small.
Derived in docs/theory/estimation_statistics.md, equations 13 to 17a.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Generator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sim_heating.base.arrays import BoolArray, FloatArray, IntArray
from sim_heating.base.files import raise_problems
from sim_heating.base.parameters import Parameter
from sim_heating.estimation.inference.identifiability import (
    ROUNDING,
    SINGULAR,
    Direction,
    covariance,
    directions,
    predicted_gain,
    scale,
    scaled_eigenvectors,
)

FIRST_DAMPING = 1e-3
LARGEST_DAMPING = 1e6
MORE, LESS = 10.0, 0.1
WATCHED = 3
"""Further whole steps after one that lowered the posterior, before its fractions are tried. Where none helped, the next
step is tried together with its fractions.
"""
RECENT = 3
"""Steps whose largest gain is what each step left may gain, in `needed_log_likelihood`."""
SETTLED_STEP = 0.05
"""Step over the sigma of each parameter [-] at which a search in which no step helps has converged, on a kink or many
small ones."""
SHORTENINGS = 2
"""Times that a step which does not help is shortened to its smallest fraction, in search of a kink."""
MOST_CLOSER, NEAREST = 16, 0.02
"""Evaluations that a kink is found by at most, and how near to an end of what it is within, over its length [-]."""
SHORTER = 0.5
"""Factor on `trust_radius` after whole steps did not help; it grows back after they do."""


@dataclass(frozen=True, eq=False)
class Evaluation:
    """The log likelihood and its derivatives at one parameter vector.

    log_likelihood : its value [-]; not finite where the model cannot be evaluated
    gradient       : (parameter,) d/dp
    information    : (parameter, parameter) -d2/dp2 or its Gauss-Newton approximation, positive semidefinite

    Source: docs/theory/estimation_statistics.md, equation 14.
    """

    log_likelihood: float
    gradient: FloatArray
    information: FloatArray


Evaluate = Callable[[FloatArray], Evaluation]
"""(parameter,) -> Evaluation."""
LogLikelihoods = Callable[[FloatArray], FloatArray]
"""(candidate, parameter) -> (candidate,) log likelihoods, not finite where the model cannot be evaluated."""

StepCallback = Callable[[FloatArray, float], None]
"""Callback with the (parameter,) values and the log posterior after a step."""
Iteration = Generator[FloatArray, Any, "Fit"]
"""An iteration that yields what it needs: a (parameter,) vector, for which it is sent the Evaluation there, or
(candidate, parameter) vectors, for which it is sent their log likelihoods; it returns the fit.
"""


@dataclass(frozen=True)
class NewtonSettings:
    """When a search stops, how far it may step, and where it begins.

    min_improvement : of the log posterior [-] that a full step must predict for another iteration
    min_step        : change of a parameter over its sigma [-] that a full step must make for another iteration
    iterations      : largest number of steps
    step_fractions  : fractions of the full step [-]; the best is taken where the full step does not help
    trust_radius    : limit on the change of a parameter in one step, over the sigma of its prior [-], for a strongly
                      nonlinear model
    unlimited       : labels of parameters with a prior that `trust_radius` does not limit: the model is linear in them
    first_values    : label of a parameter -> value that the search begins with; the prior's value for all others
    needed_log_likelihood : [-] without which the fit is of no use: the search ends where it would not come to it even
                      if each step that is left gained as much as the largest of the last RECENT

    Source: docs/theory/estimation_statistics.md, equation 17 and the line search above it.
    """

    min_improvement: float = 1e-6
    min_step: float = 1e-3
    iterations: int = 50
    step_fractions: tuple[float, ...] = tuple(0.5**k for k in range(8))
    trust_radius: float = math.inf
    unlimited: tuple[str, ...] = ()
    first_values: Mapping[str, float] = field(default_factory=dict)
    needed_log_likelihood: float = -math.inf


class Status(Enum):
    """How an iteration ended."""

    CONVERGED = "converged"
    KINK = "converged; the likelihood has a kink here"
    ITERATIONS = "not converged within the iterations allowed; start nearer or allow more"
    STALLED = "diverged: no step, however short, raises the likelihood; its gradient or the model is not smooth here"
    BEHIND = "not converged: ended far below the likelihood that was needed"
    NO_START = "diverged: the model cannot be evaluated at the start"


@dataclass(frozen=True, eq=False, repr=False)
class Fit:
    """The most probable parameters.

    names         : (parameter,)
    values        : (parameter,) in the units of the parameters
    covariance    : (parameter, parameter) Cramer-Rao bound, inverse of information and prior on the parameters that
                    are not on a bound; 0 for those on one, infinite for those that the data do not identify
    log_likelihood, log_posterior : at the values [-]; the posterior without its constant
    information   : (parameter, parameter) of the data alone
    prior_information : (parameter,) 1 / sigma^2
    on_bound      : (parameter,) whether a parameter is fixed at a bound
    singular      : directions that data and priors together do not identify
    status        : how the search ended
    iterations    : steps taken
    predicted_gain : improvement of the log posterior [-] that Newton's next step predicts along the identified
                    directions
    history       : (iteration + 1, parameter) values, the start first

    Source: docs/theory/estimation_statistics.md, equations 13 to 18.
    """

    names: tuple[str, ...]
    values: FloatArray
    covariance: FloatArray
    log_likelihood: float
    log_posterior: float
    information: FloatArray
    prior_information: FloatArray
    on_bound: BoolArray
    singular: tuple[Direction, ...]
    status: Status
    iterations: int
    predicted_gain: float
    history: FloatArray

    def __repr__(self) -> str:
        estimates = zip(self.names, self.values, self.sigma, strict=True)
        values = ", ".join(f"{name}={value:.5g} +- {sigma:.2g}" for name, value, sigma in estimates)
        return f"Fit({values}; {self.status.name.lower()} after {self.iterations} iterations)"

    @property
    def converged(self) -> bool:
        """Whether the log posterior [-] has its maximum here, on a bound, along an unidentified direction or at a kink
        included.

        Criterion: docs/theory/estimation_statistics.md, equation 17.
        """
        return self.status in (Status.CONVERGED, Status.KINK)

    @property
    def sigma(self) -> FloatArray:
        """(parameter,) Cramer-Rao bounds, one standard deviation, in the units of the parameters ([-] for a ratio).

        Source: docs/theory/estimation_statistics.md, equation 18.
        """
        return np.sqrt(np.diag(self.covariance))

    def select(self, index: IntArray, names: Sequence[str]) -> Fit:
        """The fit of some of its parameters, in another order, the others held at their values.

        index : (selected,) indices of the parameters;  names : (selected,) what they are called

        Source: marginal covariance of docs/theory/estimation_statistics.md, equation 18.
        """
        return replace(
            self,
            names=tuple(names),
            values=self.values[index],
            covariance=self.covariance[np.ix_(index, index)],
            information=self.information[np.ix_(index, index)],
            prior_information=self.prior_information[index],
            on_bound=self.on_bound[index],
            history=self.history[:, index],
        )

    def describe(self) -> list[str]:
        """Lines for a report: the status, parameters on their bounds, directions that are not identified."""
        bounded = zip(self.names, self.values, self.on_bound, strict=True)
        return [
            self.status.value,
            *(f"{name} is on its bound, {value:g}" for name, value, on in bounded if on),
            *(direction.describe() for direction in self.singular),
        ]


@dataclass(frozen=True, eq=False)
class Priors:
    """Normal priors and bounds of parameters as arrays, each in its unit, and what they add to a likelihood.

    mean, information : (parameter,) of each prior, information 1 / sigma^2; lower, upper : (parameter,) bounds

    Source: docs/theory/estimation_statistics.md, equations 13 and 14.
    """

    mean: FloatArray
    information: FloatArray
    lower: FloatArray
    upper: FloatArray

    @classmethod
    def of(cls, parameters: Sequence[Parameter]) -> Priors:
        """The priors and bounds of parameters ([-], [K] ...).

        raises : InputError for an invalid prior or bounds

        Source: docs/theory/estimation_statistics.md, equation 13.
        """
        check_parameters(parameters)
        sigma = np.array([p.sigma for p in parameters], dtype=float)
        return cls(
            np.array([p.value for p in parameters], dtype=float),
            1.0 / sigma**2,
            np.array([p.lower for p in parameters], dtype=float),
            np.array([p.upper for p in parameters], dtype=float),
        )

    def log_prior(self, values: FloatArray) -> FloatArray:
        """Log prior density [-] of (..., parameter) values, without its constant.

        Source: docs/theory/estimation_statistics.md, equation 13.
        """
        return np.asarray(-0.5 * np.sum(self.information * (values - self.mean) ** 2, axis=-1))

    def evaluation(self, vector: FloatArray, likelihood: Evaluation) -> Evaluation:
        """Log posterior [-], gradient and information at a (parameter,) point, from those of the likelihood there.

        Source: docs/theory/estimation_statistics.md, equations 13 and 14.
        """
        return Evaluation(
            likelihood.log_likelihood + float(self.log_prior(vector)),
            likelihood.gradient + self.information * (self.mean - vector),
            likelihood.information + np.diag(self.information),
        )

    def on_bound(self, vector: FloatArray, gradient: FloatArray) -> BoolArray:
        """Parameters on a bound that the gradient would push beyond it."""
        # released as soon as the gradient points inwards again
        return ((vector <= self.lower) & (gradient <= 0.0)) | ((vector >= self.upper) & (gradient >= 0.0))


def check_parameters(parameters: Sequence[Parameter]) -> None:
    """Check the priors and bounds of parameters before a search.

    raises : InputError with one line for each invalid prior or pair of bounds, or where the list is empty

    A prior needs a finite value within lower < upper and sigma > 0; an infinite sigma is a flat prior.
    """
    problems = []
    for p in parameters:
        if not (math.isfinite(p.value) and p.sigma > 0.0):
            problems.append(f"{p.name}: prior {p.value:g} +- {p.sigma:g}; give a finite value and a sigma above 0")
        elif not p.lower < p.upper:
            problems.append(f"{p.name}: bounds {p.lower:g} to {p.upper:g}; give the lower one first")
        elif not p.lower <= p.value <= p.upper:
            problems.append(f"{p.name}: prior value {p.value:g} is outside its bounds {p.lower:g} to {p.upper:g}")
    if not parameters:
        problems.append("no parameter to estimate; name at least one")
    raise_problems(problems)


def maximise(
    evaluate: Evaluate,
    parameters: Sequence[Parameter],
    start: ArrayLike | None = None,
    log_likelihoods: LogLikelihoods | None = None,
    settings: NewtonSettings | None = None,
    on_step: StepCallback = lambda vector, log_posterior: None,
) -> Fit:
    """The most probable values of parameters with priors and bounds.

        (M + P) step = g + P (value - p)

    evaluate        : log likelihood [-], gradient and information at a parameter vector
    start           : (parameter,) first values, clipped to the bounds; by default those of settings and priors
    log_likelihoods : log likelihoods [-] of several parameter vectors at once; by default `evaluate` one after another
    settings        : when to stop and how far to step
    on_step         : called with values and log posterior after every step
    returns         : the fit; its `status` states whether the search converged, it does not raise where it did not
    raises          : InputError for an invalid prior or bounds

    Source: docs/theory/estimation_statistics.md, equations 13 to 17.
    """
    evaluate_all = log_likelihoods or (lambda values: np.array([evaluate(v).log_likelihood for v in values]))
    search = iteration(parameters, start, settings, on_step)
    request: FloatArray | Fit = next(search)
    while not isinstance(request, Fit):
        request = next_request(search, evaluate(request) if request.ndim == 1 else evaluate_all(request))
    return request


def iteration(
    parameters: Sequence[Parameter],
    start: ArrayLike | None = None,
    settings: NewtonSettings | None = None,
    on_step: StepCallback = lambda vector, log_posterior: None,
) -> Iteration:
    """The search of `maximise` as a generator, whose caller evaluates: so that many fits can be marched side by side.

    parameters : priors and bounds, each in its unit ([-] where it has none)
    start      : (parameter,) first values, clipped to the bounds; by default those of settings and priors
    yields     : (parameter,) vector, for which it is sent the Evaluation, or (candidate, parameter) vectors, for which
                 it is sent their log likelihoods [-]
    returns    : the fit, as the value of StopIteration
    raises     : InputError for an invalid prior or bounds

    Source: docs/theory/estimation_statistics.md, equations 13 to 17.
    """
    posterior = Priors.of(parameters)
    settings = settings or NewtonSettings()
    first = [settings.first_values.get(p.name, p.value) for p in parameters] if start is None else start
    vector = np.clip(np.asarray(first, dtype=float), posterior.lower, posterior.upper)
    names = tuple(p.name for p in parameters)
    limited = np.array([name not in settings.unlimited for name in names])
    search = _NewtonSearch(posterior, settings, vector, limited, on_step)
    status = yield from search.run()
    return search.fit(names, status)


def next_request(search: Iteration, answer: Evaluation | FloatArray) -> FloatArray | Fit:
    """What an iteration needs after an answer to its last request.

    answer  : the evaluation at its vector, or the (candidate,) log likelihoods [-] of its vectors
    returns : (parameter,) vector or (candidate, parameter) vectors, each value in the unit of its parameter ([-] where
              it has none); the fit where the iteration has ended

    Source: docs/theory/estimation_statistics.md, equations 13 to 17.
    """
    try:
        return search.send(answer)
    except StopIteration as ended:
        fit: Fit = ended.value
        return fit


class _NewtonSearch:
    """State of a search: current point, evaluation there, damping and trust."""

    def __init__(
        self,
        posterior: Priors,
        settings: NewtonSettings,
        vector: FloatArray,
        limited: BoolArray,
        on_step: StepCallback,
    ) -> None:
        self.posterior, self.settings, self.limited, self.on_step = posterior, settings, limited, on_step
        self.damping, self.trust, self.watched = 0.0, 1.0, WATCHED
        self.history = [vector]
        self.reached: list[float] = []
        """Log posterior at the start and after each step [-]."""
        self.kink = np.zeros((len(vector), len(vector)))
        """(parameter, parameter) information across the kinks that are met, equation 17a."""
        self.kink_at = vector
        """Where the last kink was met."""

    def move_to(self, vector: FloatArray, likelihood: Evaluation) -> None:
        self.at, self.likelihood = vector, likelihood
        self.evaluation = self.posterior.evaluation(vector, self.likelihood)
        self.on_bound = self.posterior.on_bound(vector, self.evaluation.gradient)

    def run(self) -> Generator[FloatArray, Any, Status]:
        start = self.history[0]
        self.move_to(start, (yield start))
        if not _finite(self.evaluation):
            return Status.NO_START
        self.reached.append(self.evaluation.log_likelihood)
        for _ in range(self.settings.iterations):
            step = self.step(self.damping, self.trust)
            if self.is_converged(step):
                if not np.any(self.kink):
                    return Status.CONVERGED
                if not (yield from self.leaves_kink()):
                    return Status.KINK
                continue
            if self.watched:
                is_whole = yield from self.take_whole_steps(step)
                accepted = is_whole or (yield from self.take_fraction(step)) > 0.0
            else:
                # along a bent valley whole steps keep failing: do not pay for one and its gradient before its fractions
                fraction = yield from self.take_fraction(step, whole_first=True)
                is_whole, accepted = fraction == 1.0, fraction > 0.0
            if not accepted:
                begin = self.at
                at_kink = yield from self.meets_kink(step)
                accepted = self.at is not begin
                if at_kink and not accepted:
                    continue
                if not accepted and self.is_settled():
                    return Status.CONVERGED if self.is_within_rounding() else Status.KINK
            self.trust = min(self.trust / SHORTER, 1.0) if is_whole else SHORTER * self.trust
            self.watched = WATCHED if is_whole else 0
            while not accepted and self.damping < LARGEST_DAMPING:
                self.damping = max(FIRST_DAMPING, MORE * self.damping)
                accepted = (yield from self.take_fraction(self.step(self.damping, self.trust))) > 0.0
            if not accepted:
                # no fraction helps at the maximum either, where the remaining gradient is rounding
                return Status.CONVERGED if self.is_within_rounding() else Status.STALLED
            self.history.append(self.at)
            self.reached.append(self.evaluation.log_likelihood)
            self.on_step(self.at, self.evaluation.log_likelihood)
            if not _finite(self.evaluation):
                return Status.STALLED
            if self.is_out_of_reach():
                return Status.BEHIND
            # damping dies out, so that the last steps are Newton's own and the end is quadratic
            self.damping *= LESS if self.damping > FIRST_DAMPING else 0.0
        if not self.is_converged(self.step(self.damping, self.trust)):
            return Status.ITERATIONS
        return Status.KINK if np.any(self.kink) else Status.CONVERGED

    def step(self, damping: float, trust: float) -> FloatArray:
        """(parameter,) damped step of the parameters that are not on a bound, the best one within the box.

        damping : Levenberg damping of the scaled information [-]
        trust   : fraction of `trust_radius` that the step may use [-]

        Source: docs/theory/estimation_statistics.md, equation 16.
        """
        step, free = np.zeros_like(self.at), ~self.on_bound
        if not free.any():
            return step
        information = (self.evaluation.information + self.kink)[np.ix_(free, free)]
        values, vectors = scaled_eigenvectors(information)
        s = scale(information)
        lifted = np.where(values > ROUNDING, values, 1.0)  # a singular direction goes uphill as far as one sigma alone
        root = np.sqrt(lifted + damping)
        target = vectors.T @ (s * self.evaluation.gradient[free]) / root
        step[free] = s * (vectors @ (target / root))
        lower, upper = (side[free] for side in self.box(trust))
        if np.any((step[free] < lower) | (step[free] > upper)):
            from scipy.optimize import lsq_linear  # slow to import

            # the same quadratic form in the box; a clipped free minimum leaves correlated parameters off theirs
            scaled = lsq_linear(root[:, np.newaxis] * vectors.T, target, (lower / s, upper / s), method="bvls")
            step[free] = np.clip(s * scaled.x, lower, upper)
        return step

    def box(self, trust: float) -> tuple[FloatArray, FloatArray]:
        """(parameter,) largest changes down and up.

        They end at the bounds, and at `trust` times `trust_radius` from where the first of a sequence of whole steps
        began.
        """
        if not np.isfinite(self.settings.trust_radius):
            unlimited = np.full_like(self.at, np.inf)
            return -unlimited, unlimited
        # the prior's sigma is the scale of the radius; a flat prior gives a parameter no limit
        prior = np.where(self.limited, self.posterior.information, 0.0)
        radius = trust * self.settings.trust_radius / np.sqrt(np.where(prior > 0.0, prior, np.finfo(float).tiny))
        begin = self.history[-1] - self.at
        return (
            np.maximum(self.posterior.lower - self.at, begin - radius),
            np.minimum(self.posterior.upper - self.at, begin + radius),
        )

    def is_converged(self, step: FloatArray) -> bool:
        """Whether the undamped step predicts a negligible improvement and is a small part of each sigma."""
        if self.damping > 0.0 or self.trust < 1.0:
            # a damped or shortened step is small because it was made small: convergence is judged on the full one
            step = self.step(0.0, 1.0)
        improvement = 0.5 * float(self.evaluation.gradient @ step)
        sigma = np.sqrt(np.diag(self.covariance()))
        small = np.abs(step) <= self.settings.min_step * np.where(self.on_bound, np.inf, sigma)
        # at a kink the gradient does not vanish: what a step across it promises says nothing
        return (improvement < self.settings.min_improvement or bool(np.any(self.kink))) and bool(np.all(small))

    def is_settled(self) -> bool:
        """Whether the undamped step, which does not help, is so small a part of each sigma that nothing is gained."""
        sigma = np.sqrt(np.diag(self.covariance()))
        step = np.abs(self.step(0.0, 1.0))
        return bool(np.all(step <= SETTLED_STEP * np.where(self.on_bound, np.inf, sigma)))

    def meets_kink(self, step: FloatArray) -> Generator[FloatArray, Any, bool]:
        """Whether the gradient turns about within the smallest fraction of a step that does not help.

        The kink is then found to `min_step` of each sigma, and the change of the gradient across it is information
        (equation 17a). Where so short a step helps it is taken.
        """
        fraction = min(self.settings.step_fractions)
        for k in range(1, SHORTENINGS + 1):
            candidate = np.clip(self.at + fraction**k * step, self.posterior.lower, self.posterior.upper)
            beyond = (candidate, (yield candidate))
            evaluation = self.posterior.evaluation(*beyond)
            if not _finite(evaluation):
                continue
            if evaluation.log_likelihood > self.evaluation.log_likelihood:
                self.move_to(*beyond)
                return False
            if self.evaluation.gradient @ step > 0.0 > evaluation.gradient @ step:
                return (yield from self.close_in(beyond))
        return False

    def close_in(self, outer: tuple[FloatArray, Evaluation]) -> Generator[FloatArray, Any, bool]:
        """Move to a kink between here and a point beyond it, and note the information across it."""
        ends = [(self.at, self.likelihood), outer]
        sigma = np.sqrt(np.diag(self.covariance()))
        for k in range(MOST_CLOSER):
            (a, of_a), (b, of_b) = ends
            if np.all(np.abs(b - a) <= self.settings.min_step * sigma):
                break
            before, after = self.posterior.evaluation(a, of_a), self.posterior.evaluation(b, of_b)
            up, down = float(before.gradient @ (b - a)), float(after.gradient @ (b - a))
            # where the tangents at both ends meet; every other time the middle
            t = (after.log_likelihood - before.log_likelihood - down) / (up - down) if k % 2 == 0 else 0.5
            between = a + np.clip(t, NEAREST, 1.0 - NEAREST) * (b - a)
            likelihood = yield between
            evaluation = self.posterior.evaluation(between, likelihood)
            if not _finite(evaluation):
                return False
            ends[0 if evaluation.gradient @ (b - a) > 0.0 else 1] = (between, likelihood)
        (a, of_a), (b, of_b) = ends
        before, after = self.posterior.evaluation(a, of_a), self.posterior.evaluation(b, of_b)
        if self.kink_at is not self.at:  # along a kink that was followed, the information may have changed
            self.kink = np.zeros_like(self.kink)
        self.move_to(*ends[0 if before.log_likelihood >= after.log_likelihood else 1])
        self.kink_at = self.at
        y = before.gradient - after.gradient - (self.evaluation.information + self.kink) @ (b - a)
        if y @ (b - a) <= 0.0:
            return False
        self.kink = self.kink + np.outer(y, y) / (y @ (b - a))
        self.damping, self.trust, self.watched = 0.0, 1.0, 0
        return True

    def leaves_kink(self) -> Generator[FloatArray, Any, bool]:
        """Whether a step that knows nothing of the kinks helps, where those along them have converged; it is taken."""
        before, kink = self.evaluation.log_likelihood, self.kink
        self.kink = np.zeros_like(kink)
        yield from self.take_fraction(self.step(0.0, 1.0))
        if self.evaluation.log_likelihood - before > self.settings.min_improvement:
            return True
        self.kink = kink
        return False

    def is_out_of_reach(self) -> bool:
        """Whether the steps that are left would not lead to the log likelihood that is needed, as far as gains tell."""
        steps = len(self.history) - 1
        if steps < RECENT:
            return False
        gain = max(after - before for before, after in pairwise(self.reached[-1 - RECENT :]))
        remaining = self.settings.iterations - steps
        return self.likelihood.log_likelihood + remaining * gain < self.settings.needed_log_likelihood

    def take_whole_steps(self, step: FloatArray) -> Generator[FloatArray, Any, bool]:
        """Take a whole step, cut off at the bounds, where it raises the posterior, which is the usual case.

        Where it does not, further whole steps from its end may: along a curved ridge every step leaves it a little.
        """
        begin, least = (self.at, self.likelihood), self.evaluation.log_likelihood
        for _ in range(1 + self.watched):
            # evaluated with gradient: if it is accepted, as mostly, the next step needs no further march
            candidate = np.clip(self.at + step, self.posterior.lower, self.posterior.upper)
            self.move_to(candidate, (yield candidate))
            if self.evaluation.log_likelihood > least:
                return True
            if not _finite(self.evaluation):
                break
            step = self.step(self.damping, self.trust)
        self.move_to(*begin)
        return False

    def take_fraction(self, step: FloatArray, *, whole_first: bool = False) -> Generator[FloatArray, Any, float]:
        """Take the best of the fractions of a step, cut off at the bounds.

        whole_first : take the whole step, where it raises the posterior, rather than a better fraction of it
        returns     : the fraction taken [-]; 0 where none raises the posterior
        """
        fractions = self.settings.step_fractions
        if whole_first:
            fractions = (1.0, *(f for f in fractions if f != 1.0))
        candidates = np.clip(self.at + np.array(fractions)[:, None] * step, self.posterior.lower, self.posterior.upper)
        reached = np.asarray((yield candidates), dtype=float) + self.posterior.log_prior(candidates)
        # a candidate that cannot be marched loses to any that can
        reached = np.where(np.isfinite(reached), reached, -np.inf)
        raises = reached > self.evaluation.log_likelihood
        if not np.any(raises):
            return 0.0
        best = 0 if whole_first and raises[0] else int(np.argmax(reached))
        self.move_to(candidates[best], (yield candidates[best]))
        return fractions[best]

    def is_within_rounding(self) -> bool:
        """Whether the improvement that an undamped step predicts is below the rounding of the log posterior."""
        improvement = 0.5 * float(self.evaluation.gradient @ self.step(0.0, self.trust))
        return improvement < max(self.settings.min_improvement, 1e-12 * abs(self.evaluation.log_likelihood))

    def covariance(self) -> FloatArray:
        """(parameter, parameter) bound on the parameters that are not on a bound; 0 for the others."""
        free = np.ix_(~self.on_bound, ~self.on_bound)
        bound = np.zeros_like(self.evaluation.information)
        bound[free] = covariance(self.evaluation.information[free])
        return bound

    def fit(self, names: tuple[str, ...], status: Status) -> Fit:
        broken = status is Status.NO_START or not _finite(self.evaluation)
        free = np.flatnonzero(~self.on_bound)
        information = self.evaluation.information[np.ix_(free, free)]
        singular = [] if broken else directions(information, [names[i] for i in free], SINGULAR)
        C = np.full_like(self.evaluation.information, np.nan) if broken else self.covariance()
        return Fit(
            names=names,
            values=self.at,
            covariance=C,
            log_likelihood=self.likelihood.log_likelihood,
            log_posterior=self.evaluation.log_likelihood,
            information=self.likelihood.information,
            prior_information=self.posterior.information,
            on_bound=self.on_bound,
            singular=tuple(singular),
            status=status,
            iterations=len(self.history) - 1,
            predicted_gain=0.0 if broken else predicted_gain(self.evaluation.gradient, C),
            history=np.array(self.history),
        )


def _finite(evaluation: Evaluation) -> bool:
    return bool(
        np.isfinite(evaluation.log_likelihood)
        and np.all(np.isfinite(evaluation.gradient))
        and np.all(np.isfinite(evaluation.information))
    )
