"""Fits of several problems marched side by side: eight cost little more than one.

Candidates for a deficiency of a declared model are problems over one record that differ in effects and unknowns.
Records on common times share lane groups, whichever problem they belong to (record_fit.lane_groups); the likelihoods
remain separate.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice

from numpy.typing import ArrayLike

from sim_heating.base.arrays import FloatArray
from sim_heating.base.parallel.processes import in_turn
from sim_heating.base.parallel.threads import in_threads, thread_count
from sim_heating.estimation.fit_marches import LastMarches
from sim_heating.estimation.inference.newton import Evaluation, Fit, Iteration, NewtonSettings, iteration, next_request
from sim_heating.estimation.problem import FitProblem
from sim_heating.estimation.record_fit import RecordFit, group_march, lane_groups, set_parameters
from sim_heating.march.linearised import Linearised, LinearMarch


@dataclass(frozen=True, eq=False)
class _LaneGroup:
    """Records marched together; members : indices (problem, record) of each."""

    members: tuple[tuple[int, int], ...]
    record_fits: tuple[RecordFit, ...]
    march: LinearMarch


class JointMarch:
    """The marches of several problems.

    problems : what is evaluated; no problem twice
    """

    def __init__(self, problems: Sequence[FitProblem]) -> None:
        self.problems = tuple(problems)
        position = {record_fit: (i, k) for i, p in enumerate(problems) for k, record_fit in enumerate(p.record_fits)}
        # a group marches as many sensitivities in all lanes as its widest record has; the longest marches begin first
        ordered = sorted(position, key=lambda record_fit: -record_fit.march_columns)
        self._groups = [
            _LaneGroup(tuple(position[record_fit] for record_fit in group), tuple(group), group_march(group))
            for group in lane_groups(ordered, shares=thread_count())
        ]

    def march(self, vectors: Sequence[FloatArray]) -> list[bool]:
        """March each problem at its own parameter vector and store the result in it.

        vectors : by problem, (parameter,)
        returns : by problem, whether its march succeeded

        Nothing is marched where all problems already have results for these vectors.
        """
        # at the first evaluation after a screening all starts are marched already
        if all(problem.marches.has(vector) for problem, vector in zip(self.problems, vectors, strict=True)):
            return [True] * len(self.problems)

        def of_group(k: int) -> list[Linearised | None]:
            group = self._groups[k]
            return group.march.attempt(
                *set_parameters(group.march, group.record_fits, [vectors[i] for i, _ in group.members])
            )

        marched: list[dict[int, Linearised]] = [{} for _ in self.problems]
        for group, results in zip(self._groups, in_threads(of_group, len(self._groups)), strict=True):
            for (i, k), result in zip(group.members, results, strict=True):
                # one record that fails makes its own problem fail and no other in its lanes
                if result is not None:
                    marched[i][k] = result
        is_complete = [
            len(by_record) == len(problem.record_fits)
            for problem, by_record in zip(self.problems, marched, strict=True)
        ]
        for i, problem in enumerate(self.problems):
            if is_complete[i]:
                problem.marches.store(vectors[i], marched[i])
        return is_complete

    def evaluate(self, vectors: Sequence[FloatArray]) -> list[Evaluation]:
        """Evaluation of each problem at its own parameter vector, as FitProblem.evaluate returns it.

        vectors : by problem, (parameter,)
        returns : log likelihood [-], gradient and information of each; NaN log likelihood where its march failed

        Source: docs/theory/estimation_statistics.md, equation 14.
        """
        return [
            problem.evaluate(vector) if marched else problem.failed_evaluation()
            for problem, vector, marched in zip(self.problems, vectors, self.march(vectors), strict=True)
        ]


def maximise_together(
    problems: Sequence[FitProblem],
    starts: Sequence[ArrayLike | None] | None = None,
    settings: NewtonSettings | Sequence[NewtonSettings] | None = None,
) -> list[Fit]:
    """The fit of each problem as newton.maximise finds it, all iterated side by side.

    starts   : by problem, (parameter,) first values, each in its unit ([-] for a ratio); by default those of the priors
    settings : when to stop and how far to step, common to all or by problem
    returns  : by problem, its fit; one that did not converge has its status
    raises   : InputError for an invalid prior or bounds

    Source: docs/theory/estimation_statistics.md, equations 13 to 17.
    """
    begin = [None] * len(problems) if starts is None else list(starts)
    settings_of = settings if isinstance(settings, Sequence) else [settings] * len(problems)
    # of all problems first: a prior that is invalid is reported before any work
    every = [iteration(p.parameters, first, s) for p, first, s in zip(problems, begin, settings_of, strict=True)]
    # the richest first, as they mostly take the most steps: dealt out in turn, each process has its part of these
    order = sorted(range(len(problems)), key=lambda k: -len(problems[k].parameters))
    richest, searches = [problems[k] for k in order], [every[k] for k in order]

    def of_fractions(vectors: Mapping[int, FloatArray]) -> list[FloatArray]:
        requests = list(vectors.items())
        return in_threads(lambda i: richest[requests[i][0]].log_likelihoods(requests[i][1]), len(requests))

    def of_some(numbers: Iterator[int], count: int) -> dict[int, tuple[Fit, LastMarches]]:
        lanes = _Lanes(richest)
        fits = iterate_together(searches, numbers, count, lanes.evaluate, of_fractions)
        return {k: (fit, richest[k].marches.latest) for k, fit in fits.items()}

    outcomes = dict(zip(order, in_turn(of_some, len(order)), strict=True))
    for k, (_, marches) in outcomes.items():
        problems[k].marches.latest = marches
    return [outcomes[k][0] for k in range(len(problems))]


class _Lanes:
    """Some of several problems marched together, their lanes packed again where they are others than the last time."""

    def __init__(self, problems: Sequence[FitProblem]) -> None:
        self._problems = problems
        self._packed: tuple[int, ...] = ()
        self._together = JointMarch([])

    def evaluate(self, vectors: Mapping[int, FloatArray]) -> list[Evaluation]:
        """Evaluation at each (parameter,) vector, which is given by the number of its problem, in their order."""
        if tuple(vectors) != self._packed:
            self._packed = tuple(vectors)
            self._together = JointMarch([self._problems[k] for k in vectors])
        return self._together.evaluate(list(vectors.values()))


def iterate_together(
    searches: Sequence[Iteration],
    numbers: Iterator[int],
    count: int,
    evaluate: Callable[[Mapping[int, FloatArray]], Sequence[Evaluation]],
    log_likelihoods: Callable[[Mapping[int, FloatArray]], Sequence[FloatArray]],
) -> dict[int, Fit]:
    """The fits that some iterations end with, several evaluated side by side; a further one begins where one has ended.

    searches : all iterations;  numbers : of those that are taken, one after another;  count : how many at a time
    evaluate : from (parameter,) vectors by the number of their iteration, the evaluation at each, in their order
    log_likelihoods : from (candidate, parameter) vectors by number, the (candidate,) log likelihoods [-] of each, in
               their order
    returns  : fits by number

    Source: docs/theory/estimation_statistics.md, equations 13 to 17.
    """
    requests: dict[int, FloatArray] = {}
    fits: dict[int, Fit] = {}
    while True:
        requests |= {k: next(searches[k]) for k in islice(numbers, count - len(requests))}
        if not requests:
            return fits
        answers: dict[int, Evaluation | FloatArray] = dict(zip(requests, evaluate(requests), strict=True))
        while answers:
            for k, answer in answers.items():
                request = next_request(searches[k], answer)
                if isinstance(request, Fit):
                    fits[k] = request
                    del requests[k]
                else:
                    requests[k] = request
            fractions = {k: request for k, request in requests.items() if request.ndim == 2}
            answers = dict(zip(fractions, log_likelihoods(fractions), strict=True))
