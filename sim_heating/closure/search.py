"""From a record that its declared model does not explain to the effect that does.

The declared model's magnitude and derivatives are fitted first. Then every candidate is fitted together with them, its
likelihood weighed by what its freedom would gain from noise alone,

    BIC = -2 log L + k log n,

and the best is added where it is better than none by more than GAIN; that is repeated until nothing is. Most starts of
a candidate need not be fitted: the gain that its linearisation at the start promises tells which are worth it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim_heating.closure.candidates import Candidate, candidates
from sim_heating.effects import EffectUse
from sim_heating.errors import RunError
from sim_heating.estimation.estimate import Fitted, estimate, predict_at
from sim_heating.estimation.newton import Fit, Settings, maximise
from sim_heating.estimation.problem import Problem
from sim_heating.points import conditions_of_record
from sim_heating.predict import Prediction
from sim_heating.record import Record

FloatArray = NDArray[np.float64]
Progress = Callable[[float, str], None]

GAIN = 10.0
"""How much lower the BIC of an effect has to be than that of none."""
STARTS_FITTED = 2
"""Starts of a candidate's variant that are fitted, the most promising ones."""
MOST_EFFECTS = 3
QUICK = Settings(gain=1e-3, step=1e-2, iterations=25)


@dataclass(frozen=True, eq=False)
class Attempt:
    """One candidate fitted on top of a model.

    bic : of the fit;  delta_bic : that minus that of the model without it
    """

    name: str
    candidate: Candidate
    problem: Problem
    fit: Fit
    bic: float
    delta_bic: float

    @property
    def prediction(self) -> Prediction:
        """The record at the values found."""
        return predict_at(self.problem.parts[0], self.fit.values)


@dataclass(frozen=True, eq=False)
class Round:
    """One pass over all candidates: the model that it began with, and the best attempt of each effect, best first."""

    bic: float
    attempts: tuple[Attempt, ...]

    @property
    def best(self) -> Attempt | None:
        """The best attempt, if any was fitted."""
        return self.attempts[0] if self.attempts else None


@dataclass(frozen=True, eq=False)
class Search:
    """What was found in one record.

    before : the declared model's fit;  rounds : the passes;  added : the attempts whose effects were added, in order
    """

    record: Record
    before: Fitted
    rounds: tuple[Round, ...]
    added: tuple[Attempt, ...]


def search(record: Record, *, progress: Progress = lambda fraction, text: None) -> Search:
    """Look for what the declared model of a record lacks.

    raises : InputError, RunError where not even the declared model can be fitted
    """
    progress(0.02, "declared model")
    before = estimate([record])
    names = tuple(u.parameter.name for u in before.problem.unknowns)
    start = dict(zip(names, before.fit.values, strict=True))
    uses: tuple[EffectUse, ...] = ()
    bic = information_criterion(before.problem, before.fit)
    rounds: list[Round] = []
    added: list[Attempt] = []
    while len(added) < MOST_EFFECTS:
        share = len(added) / MOST_EFFECTS

        def tell(fraction: float, text: str, share: float = share) -> None:
            progress(0.05 + 0.9 * (share + fraction / MOST_EFFECTS), f"effect {len(added) + 1}: {text}")

        found = one_round(record, before, names, uses, start, [a.name for a in added], bic, tell)
        rounds.append(found)
        best = found.best
        if best is None or best.delta_bic > -GAIN:
            break
        added.append(best)
        bic, names = best.bic, (*names, *best.candidate.names)
        uses = fitted_uses(best)
        start = dict(zip((u.parameter.name for u in best.problem.unknowns), best.fit.values, strict=True))
    return Search(record, before, tuple(rounds), tuple(added))


def information_criterion(problem: Problem, fit: Fit) -> float:
    """BIC of a fit."""
    n = sum(len(c.samples) for part in problem.parts for c in part.channels)
    return -2.0 * fit.log_likelihood + len(problem.unknowns) * float(np.log(n))


def fitted_uses(attempt: Attempt) -> tuple[EffectUse, ...]:
    """The effects of an attempt's model at the values found."""
    return attempt.problem.parts[0].altered(attempt.fit.values).effects


def one_round(
    record: Record, before: Fitted, names: Sequence[str], uses: tuple[EffectUse, ...], start: Mapping[str, float],
    taken: Sequence[str], bic: float, progress: Progress,
) -> Round:  # fmt: skip
    """Fit every candidate on top of a model and keep the best attempt of each effect."""
    tried = candidates(record, conditions_of_record(record), taken)
    promises: dict[tuple[str, tuple[str, ...]], list[tuple[float, Candidate, Problem, FloatArray]]] = {}
    for k, candidate in enumerate(tried):
        progress(0.5 * k / len(tried), f"weighing {candidate.name}")
        problem = _problem(record, before, (*names, *candidate.names), (*uses, *candidate.uses))
        first = _first(problem, {**start, **candidate.starts[0]})
        promise = promised(problem, first)
        if promise is not None:
            promises.setdefault((candidate.name, candidate.names), []).append((promise, candidate, problem, first))
    best: dict[str, Attempt] = {}
    for k, ((name, _), starts) in enumerate(promises.items()):
        progress(0.5 + 0.5 * k / len(promises), f"fitting {name}")
        for _, candidate, problem, first in sorted(starts, key=lambda s: -s[0])[:STARTS_FITTED]:
            fit = maximise(problem.evaluate, problem.parameters, first, problem.log_likelihoods, QUICK)
            if not np.isfinite(fit.log_likelihood):
                continue
            found = information_criterion(problem, fit)
            if name not in best or found < best[name].bic:
                best[name] = Attempt(name, candidate, problem, fit, found, found - bic)
    return Round(bic, tuple(sorted(best.values(), key=lambda a: a.bic)))


def _problem(record: Record, before: Fitted, names: Sequence[str], uses: Sequence[EffectUse]) -> Problem:
    problem = Problem([record], names, before.problem.reference, effects=uses, flat=True)
    problem.parts[0].sigma_K.update(before.problem.parts[0].sigma_K)
    return problem


def _first(problem: Problem, start: Mapping[str, float]) -> FloatArray:
    return np.array([start.get(p.name, p.value) for p in problem.parameters])


def promised(problem: Problem, first: FloatArray) -> float | None:
    """Log likelihood that the linearisation at the start promises; None where the model cannot be marched there."""
    try:
        found = problem.evaluate(first)
    except RunError:
        return None
    if not np.isfinite(found.log_likelihood):
        return None
    s = 1.0 / np.sqrt(np.maximum(np.diag(found.information), 1e-300))
    scaled = found.information * np.outer(s, s)
    step, *_ = np.linalg.lstsq(scaled, s * found.gradient, rcond=1e-8)
    return found.log_likelihood + 0.5 * float((s * found.gradient) @ step)

