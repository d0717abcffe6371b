"""Problems marched side by side are what each is alone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pytest

from sim_heating.base.parameters import Parameter
from sim_heating.estimation.inference.newton import Evaluation, NewtonSettings, Status, iteration, maximise
from sim_heating.estimation.problem import FitOptions, FitProblem, joint_reference
from sim_heating.estimation.side_by_side import JointMarch, iterate_together, maximise_together
from sim_heating.heating.effects import EffectUse, use
from sim_heating.inputs.record import in_segments
from tests.support.walls import practice_record

FITTED_S = [(690.0, 760.0)]
SOUGHT = (
    ((), ()),
    ((use("impingement-onset", {"alpha_onset_deg": 37.1}),), ("effect.impingement-onset.slope",)),
    ((use("emissivity", {"change_s": 700.0}),), ("effect.emissivity.emissivity_factor",)),
    ((use("nonisothermal-wall", {"decay_begin_s": 650.0}),), ()),
    ((), ("stack.coating.thickness_factor", "clock.skew")),
)
"""Effects on the ratio, on the emittance, with a lag; unknowns of the stack, moved to both sides, and of a clock."""


def problem(effects: Sequence[EffectUse] = (), more: Sequence[str] = ()) -> FitProblem:
    """Magnitude, alpha derivative and more from the first 760 s of a flight."""
    record, _ = practice_record("p06")
    chosen = [in_segments(record.time_s, FITTED_S)]
    names = ["ratio.scale", "ratio.d_alpha", *more]
    return FitProblem([record], names, joint_reference([record]), FitOptions(effects=effects, sample_masks=chosen))


def firsts(problems: Sequence[FitProblem]) -> list[np.ndarray]:
    return [np.array([p.value for p in each.parameters]) for each in problems]


@pytest.fixture
def problems() -> list[FitProblem]:
    return [problem(*each) for each in SOUGHT]


def test_evaluation_side_by_side_is_that_of_each_alone_to_the_last_bit(problems):
    together = JointMarch(problems).evaluate(firsts(problems))
    for found, (effects, more), at in zip(together, SOUGHT, firsts(problems), strict=True):
        alone = problem(effects, more).evaluate(at)
        assert found.log_likelihood == alone.log_likelihood
        assert np.array_equal(found.gradient, alone.gradient)
        assert np.array_equal(found.information, alone.information)


@pytest.mark.thorough
def test_problem_whose_march_fails_leaves_the_others_unchanged(problems):
    vectors = firsts(problems)
    well = JointMarch(problems).evaluate(vectors)
    vectors[1] = np.full_like(vectors[1], np.nan)
    found = JointMarch(problems).evaluate(vectors)
    assert [np.isfinite(f.log_likelihood) for f in found] == [True, False, True, True, True]
    assert all(found[k].log_likelihood == well[k].log_likelihood for k in (0, 2, 3, 4))


def test_fits_side_by_side_are_those_of_each_alone(problems):
    starts = firsts(problems)
    starts[3] = np.full_like(starts[3], np.nan)
    settings = NewtonSettings(iterations=3)
    fits = maximise_together(problems, starts, settings)
    assert fits[3].status is Status.NO_START
    for k in (0, 1, 2, 4):
        own = problem(*SOUGHT[k])
        alone = maximise(own.evaluate, own.parameters, starts[k], own.log_likelihoods, settings)
        assert np.array_equal(fits[k].history, alone.history)
        assert fits[k].status is alone.status


def test_more_problems_than_lanes_and_none_at_all():
    many = [problem() for _ in range(11)]
    at = firsts(many)
    found = JointMarch(many).evaluate([v + 1e-3 * k for k, v in enumerate(at)])
    assert len({f.log_likelihood for f in found}) == 11
    assert JointMarch([]).evaluate([]) == []
    assert maximise_together([]) == []


def counts(observed: int, rate: np.ndarray) -> Evaluation:
    """Poisson counts: log likelihood n log(rate) - rate, with its maximum at n."""
    with np.errstate(invalid="ignore"):
        value = observed * np.log(rate[0]) - rate[0]
    return Evaluation(float(value), observed / rate - 1.0, np.array([[observed / rate[0] ** 2]]))


def test_iteration_begins_where_another_has_ended():
    observed, at_once = [40, 12, 3, 5], []
    rate = Parameter("rate", "1", 1.0)
    searches = [iteration([rate], [12.0]) for _ in observed]

    def evaluate(vectors: Mapping[int, np.ndarray]) -> list[Evaluation]:
        at_once.append(tuple(vectors))
        return [counts(observed[k], v) for k, v in vectors.items()]

    def log_likelihoods(vectors: Mapping[int, np.ndarray]) -> list[np.ndarray]:
        return [np.array([counts(observed[k], v).log_likelihood for v in several]) for k, several in vectors.items()]

    fits = iterate_together(searches, iter(range(4)), 2, evaluate, log_likelihoods)
    assert at_once[0] == (0, 1)
    assert max(map(len, at_once)) == 2
    # the second is at its maximum from the beginning: its place is the third one's while the first goes on
    assert at_once[1] == (0, 2)
    for k, n in enumerate(observed):
        assert np.array_equal(fits[k].history, maximise(lambda v, n=n: counts(n, v), [rate], [12.0]).history)
