"""Newton-Raphson on a log posterior: problems of known maximum, bounds, priors, unidentified directions."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from sim_heating.base.errors import InputError
from sim_heating.base.parameters import Parameter
from sim_heating.estimation.inference.newton import (
    Evaluate,
    Evaluation,
    Fit,
    NewtonSettings,
    Status,
    iteration,
    maximise,
    next_request,
)

FloatArray = NDArray[np.float64]
approx = pytest.approx


def parameters(n: int, **keys: float) -> list[Parameter]:
    """Parameters a, b, c ... with one prior and bounds."""
    return [Parameter(name, "1", **{"value": 0.0, **keys}) for name in "abcdef"[:n]]


def least_squares(residual, jacobian) -> Evaluate:
    """Log likelihood of unit normal residuals with the Gauss-Newton information."""

    def evaluate(p: FloatArray) -> Evaluation:
        r, J = residual(p), jacobian(p)
        return Evaluation(-0.5 * float(r @ r), -J.T @ r, J.T @ J)

    return evaluate


def line(design: FloatArray, data: FloatArray) -> Evaluate:
    """A linear model."""
    return least_squares(lambda p: design @ p - data, lambda p: design)


ROSENBROCK = least_squares(
    lambda p: np.array([10.0 * (p[1] - p[0] ** 2), 1.0 - p[0]]),
    lambda p: np.array([[-20.0 * p[0], 10.0], [-1.0, 0.0]]),
)
"""Maximum at (1, 1); Rosenbrock, Comput. J. 3 (1960)."""

POWELL = least_squares(
    lambda p: np.array(
        [p[0] + 10 * p[1], 5**0.5 * (p[2] - p[3]), (p[1] - 2 * p[2]) ** 2, 10**0.5 * (p[0] - p[3]) ** 2]
    ),
    lambda p: np.array(
        [
            [1.0, 10.0, 0.0, 0.0],
            [0.0, 0.0, 5**0.5, -(5**0.5)],
            [0.0, 2 * (p[1] - 2 * p[2]), -4 * (p[1] - 2 * p[2]), 0.0],
            [2 * 10**0.5 * (p[0] - p[3]), 0.0, 0.0, -2 * 10**0.5 * (p[0] - p[3])],
        ]
    ),
)
"""Maximum at 0, where the information has rank 2; Powell, Comput. J. 5 (1962)."""


def decay(time: FloatArray, data: FloatArray) -> Evaluate:
    """a exp(-b t) with unit noise."""
    return least_squares(
        lambda p: p[0] * np.exp(-p[1] * time) - data,
        lambda p: np.stack([np.exp(-p[1] * time), -p[0] * time * np.exp(-p[1] * time)], axis=1),
    )


def poisson(p: FloatArray) -> Evaluation:
    """Three counts: log likelihood n log(rate) - rate, without value for a negative rate."""
    with np.errstate(invalid="ignore"):
        value = 3.0 * np.log(p[0]) - p[0]
    return Evaluation(float(value), 3.0 / p - 1.0, np.array([[3.0 / p[0] ** 2]]))


def test_a_linear_model_is_solved_by_one_step() -> None:
    design = np.random.default_rng(1).normal(size=(20, 3))
    data = design @ [1.0, -2.0, 3.0] + np.random.default_rng(2).normal(size=20)
    fit = maximise(line(design, data), parameters(3))
    assert fit.iterations == 1
    assert fit.converged
    np.testing.assert_allclose(fit.values, np.linalg.lstsq(design, data)[0], rtol=1e-10)
    np.testing.assert_allclose(fit.covariance, np.linalg.inv(design.T @ design), rtol=1e-10)


def test_a_step_of_a_linear_model_gains_what_it_predicts() -> None:
    design = np.random.default_rng(1).normal(size=(20, 3))
    model, known = line(design, np.random.default_rng(2).normal(size=20)), parameters(3, sigma=2.0)
    begun = maximise(model, known, [1.0, 2.0, -1.0], NewtonSettings(iterations=0))
    found = maximise(model, known, begun.values)
    assert begun.predicted_gain == approx(found.log_posterior - begun.log_posterior, rel=1e-10)
    assert found.predicted_gain == approx(0.0, abs=1e-12)


def test_a_gaussian_prior_and_data_of_equal_weight_meet_halfway() -> None:
    prior = [Parameter("a", "1", 10.0, 2.0)]
    fit = maximise(line(np.array([[0.5]]), np.array([0.0])), prior)
    assert fit.values[0] == approx(5.0)
    assert fit.sigma[0] == approx(2.0 / math.sqrt(2.0))
    assert fit.prior_information[0] == approx(0.25)
    assert fit.information[0, 0] == approx(0.25)


def test_rosenbrocks_valley_is_followed_to_its_end() -> None:
    fit = maximise(ROSENBROCK, parameters(2), start=[-1.2, 1.0])
    assert fit.describe() == ["converged"]
    np.testing.assert_allclose(fit.values, [1.0, 1.0], atol=1e-6)


def test_powells_singular_maximum_is_reached() -> None:
    fit = maximise(POWELL, parameters(4), start=[3.0, -1.0, 0.0, 1.0])
    assert fit.converged
    np.testing.assert_allclose(fit.values, 0.0, atol=0.05)
    assert fit.log_likelihood == approx(0.0, abs=1e-6)


def test_distant_decay_is_reached_by_shorter_steps_all_uphill() -> None:
    time = np.linspace(0.0, 4.0, 30)
    evaluate = decay(time, 100.0 * np.exp(-0.7 * time))
    fit = maximise(evaluate, parameters(2, lower=-1.0, upper=1e3), start=[5.0, 4.0])
    assert fit.converged
    np.testing.assert_allclose(fit.values, [100.0, 0.7], rtol=1e-6)
    assert np.all(np.diff([evaluate(p).log_likelihood for p in fit.history]) > 0.0)


def test_a_ridge_that_bends_is_followed_in_few_steps_within_a_trust_radius() -> None:
    # (1 + scale) (1 + step S((T - K) / width)), almost all of it hot: only the product is determined well
    T = np.linspace(450.0, 1000.0, 400)
    sigma, truth = 1e-3, np.array([-0.4, 0.9, 600.0, 40.0])

    def rise(p: FloatArray) -> FloatArray:
        return np.asarray(1.0 / (1.0 + np.exp(-(T - p[2]) / p[3])))

    def ratio(p: FloatArray) -> FloatArray:
        return np.asarray((1.0 + p[0]) * (1.0 + p[1] * rise(p)) / sigma)

    def jacobian(p: FloatArray) -> FloatArray:
        slope = (1.0 + p[0]) * p[1] * rise(p) * (1.0 - rise(p)) / p[3]
        own = [1.0 + p[1] * rise(p), (1.0 + p[0]) * rise(p), -slope, -slope * (T - p[2]) / p[3]]
        return np.asarray(np.stack(own, axis=1) / sigma)

    def counted(p: FloatArray) -> Evaluation:
        evaluated.append(p)
        return least_squares(lambda p: ratio(p) - ratio(truth), jacobian)(p)

    evaluated: list[FloatArray] = []
    known = [
        Parameter("scale", "1", 0.0),
        Parameter("step", "1", 0.0, 0.6, -0.9, 3.0),
        Parameter("K", "K", 700.0, 1e3, 300.0, 2500.0),
        Parameter("width", "K", 60.0, 120.0, 1.0, 1e3),
    ]
    fit = maximise(counted, known, settings=NewtonSettings(trust_radius=0.4))
    assert fit.converged
    np.testing.assert_allclose(fit.values, truth, rtol=2e-2)
    assert len(evaluated) < 60


def test_candidates_come_in_one_batch_and_lead_to_the_same_maximum() -> None:
    asked: list[tuple[int, ...]] = []

    def several(candidates: FloatArray) -> FloatArray:
        asked.append(candidates.shape)
        return np.array([poisson(p).log_likelihood for p in candidates])

    one = maximise(poisson, parameters(1), start=[20.0])
    batch = maximise(poisson, parameters(1), start=[20.0], log_likelihoods=several)
    assert set(asked) == {(8, 1)}
    np.testing.assert_array_equal(one.history, batch.history)


def test_failed_steps_cost_one_derivative_evaluation() -> None:
    # with 0.4 of the information every whole step is 2.5 times too long, and lowers the likelihood
    design, fractions = np.array([[1.0, 0.3], [0.2, 2.0]]), (0.5, 0.1)
    exact = line(design, np.array([3.0, -1.0]))
    search = iteration(parameters(2), [0.0, 0.0], NewtonSettings(step_fractions=fractions))
    asked: list[FloatArray] = []
    request: FloatArray | Fit = next(search)
    while not isinstance(request, Fit):
        asked.append(request)
        if request.ndim == 2:
            request = next_request(search, np.array([exact(p).log_likelihood for p in request]))
        else:
            found = exact(request)
            request = next_request(search, Evaluation(found.log_likelihood, found.gradient, 0.4 * found.information))
    np.testing.assert_allclose(request.values, np.linalg.solve(design, [3.0, -1.0]), rtol=1e-3)
    first, *later = (k for k, vectors in enumerate(asked) if vectors.ndim == 2)
    assert len(asked[first]) == len(fractions)
    assert len(later) > 3
    # the next step is tried whole and in parts at once, as soon as the derivatives at the end of the last one are known
    assert [len(asked[k]) for k in later] == [1 + len(fractions)] * len(later)
    assert later == [first + 2 * k for k in range(1, len(later) + 1)]
    for k in (first, *later):
        assert any(np.array_equal(p, asked[k + 1]) for p in asked[k])


def test_maximum_beyond_a_bound_is_the_maximum_on_the_bound() -> None:
    design = np.array([[1.0, 0.5], [0.5, 1.0], [0.2, -0.3]])
    data = np.array([-3.0, 2.0, 0.1])
    fit = maximise(line(design, data), parameters(2, value=1.0, lower=0.0))
    assert fit.describe() == ["converged", "a is on its bound, 0"]
    assert fit.values[0] == 0.0
    assert fit.values[1] == approx(design[:, 1] @ data / (design[:, 1] @ design[:, 1]))
    assert fit.sigma.tolist() == approx([0.0, 1.0 / np.linalg.norm(design[:, 1])])


def test_a_parameter_leaves_a_bound_that_it_started_on() -> None:
    fit = maximise(line(np.eye(2), np.array([2.0, -1.0])), parameters(2, lower=0.0))
    np.testing.assert_allclose(fit.values, [2.0, 0.0])
    assert fit.on_bound.tolist() == [False, True]


@pytest.mark.parametrize("seed", range(8))
def test_bounded_linear_problems_agree_with_scipys(seed: int) -> None:
    from scipy.optimize import lsq_linear

    rng = np.random.default_rng(seed)
    design, data = rng.normal(size=(12, 5)) @ rng.normal(size=(5, 5)), 3.0 * rng.normal(size=12)
    fit = maximise(
        line(design, data),
        parameters(5, lower=-0.2, upper=0.3),
        settings=NewtonSettings(min_improvement=1e-14, min_step=1e-8),
    )
    expected = lsq_linear(design, data, (-0.2, 0.3), tol=1e-14).x
    assert fit.converged
    np.testing.assert_allclose(fit.values, expected, atol=1e-7)


def test_two_equal_columns_are_named_and_their_sum_is_found() -> None:
    x = np.linspace(-1.0, 1.0, 9)
    design = np.stack([x, x, np.ones(9)], axis=1)
    fit = maximise(line(design, 3.0 * x + 1.0), parameters(3))
    assert fit.describe() == ["converged", "the data do not separate a and b: they may change in opposite directions"]
    assert fit.values[0] + fit.values[1] == approx(3.0)
    assert np.isinf(fit.sigma[:2]).all()
    assert fit.sigma[2] == approx(1.0 / 3.0)


def test_a_parameter_without_effect_keeps_its_start_and_is_named() -> None:
    design = np.stack([np.ones(4), np.zeros(4)], axis=1)
    fit = maximise(line(design, np.full(4, 7.0)), parameters(2), start=[0.0, 5.0])
    assert fit.values.tolist() == approx([7.0, 5.0])
    assert fit.describe() == ["converged", "the data do not identify b"]


def test_a_prior_identifies_what_the_data_do_not() -> None:
    design = np.ones((4, 2))
    fit = maximise(line(design, np.full(4, 2.0)), [Parameter("a", "1", 0.0), Parameter("b", "1", 0.5, 0.1)])
    assert fit.describe() == ["converged"]
    np.testing.assert_allclose(fit.values, [1.5, 0.5])
    np.testing.assert_allclose(fit.sigma, [math.hypot(0.5, 0.1), 0.1])


def test_steps_into_what_the_model_cannot_evaluate_are_shortened() -> None:
    fit = maximise(poisson, parameters(1), start=[20.0])
    assert fit.converged
    assert fit.values[0] == approx(3.0, rel=1e-3)


def test_gradient_of_another_function_is_reported_as_divergence() -> None:
    def evaluate(p: FloatArray) -> Evaluation:
        return Evaluation(-0.5 * float(p @ p), 2.0 * p, np.eye(1))

    fit = maximise(evaluate, parameters(1), start=[1.0])
    assert fit.status is Status.STALLED
    assert "diverged" in fit.describe()[0]


def test_a_start_without_value_and_too_few_iterations_are_reported() -> None:
    nowhere = maximise(lambda p: Evaluation(math.nan, p, np.eye(1)), parameters(1))
    assert nowhere.status is Status.NO_START
    assert np.isnan(nowhere.sigma[0])
    short = maximise(poisson, parameters(1), start=[20.0], settings=NewtonSettings(iterations=1))
    assert short.status is Status.ITERATIONS
    assert short.iterations == 1


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"sigma": 0.0}, "a: prior 0 .- 0; give a finite value and a sigma above 0"),
        ({"value": math.nan}, "a: prior nan"),
        ({"lower": 1.0, "upper": -1.0}, "a: bounds 1 to -1"),
        ({"value": 3.0, "upper": 1.0}, "a: prior value 3 is outside its bounds"),
    ],
)
def test_an_invalid_prior_is_refused_by_name(keys: dict[str, float], message: str) -> None:
    with pytest.raises(InputError, match=message):
        maximise(ROSENBROCK, parameters(2, **keys))


def test_nothing_to_estimate_is_refused() -> None:
    with pytest.raises(InputError, match="name at least one"):
        maximise(ROSENBROCK, [])


def test_search_ends_early_where_the_needed_likelihood_is_out_of_reach():
    start = [3.0, -1.0, 0.0, 1.0]
    whole = maximise(POWELL, parameters(4), start)
    reached = np.array([POWELL(at).log_likelihood for at in whole.history])
    for needed in (whole.log_likelihood, reached[2], -math.inf):
        found = maximise(POWELL, parameters(4), start, settings=NewtonSettings(needed_log_likelihood=needed))
        assert found.converged
        assert np.array_equal(found.history, whole.history)

    needed = 10.0  # the likelihood has its maximum at 0
    behind = maximise(POWELL, parameters(4), start, settings=NewtonSettings(needed_log_likelihood=needed))
    assert behind.status is Status.BEHIND
    assert not behind.converged
    n = behind.iterations
    assert 3 <= n < whole.iterations
    assert np.array_equal(behind.history, whole.history[: n + 1])
    best_gain = [max(np.diff(reached[k - 3 : k + 1])) for k in range(3, n + 1)]
    within = [reached[k] + (NewtonSettings().iterations - k) * g >= needed for k, g in enumerate(best_gain, start=3)]
    assert within == [True] * (n - 3) + [False]


def kinked(normal: FloatArray, at: float, slope: float) -> Evaluate:
    """Two unit normal readings of (1, 2), less `slope` times how far normal . p is beyond `at`: an onset's ridge."""

    def evaluate(p: FloatArray) -> Evaluation:
        r, beyond = p - np.array([1.0, 2.0]), normal @ p - at
        L = -0.5 * float(r @ r) - slope * max(beyond, 0.0)
        return Evaluation(L, -r - slope * normal * (beyond > 0.0), np.eye(2))

    return evaluate


@pytest.mark.parametrize("normal", [(1.0, 0.0), (1.0, 1.0), (3.0, -0.5)])
@pytest.mark.parametrize("start", [(-3.0, 5.0), (4.0, -1.0)])
def test_a_maximum_at_a_kink_is_found_and_named(normal: tuple[float, float], start: tuple[float, float]) -> None:
    n = np.array(normal)
    at = float(n @ [1.0, 2.0]) - 0.7
    fit = maximise(kinked(n, at, slope=50.0), parameters(2), start)
    assert fit.status is Status.KINK
    assert fit.converged
    assert fit.describe() == ["converged; the likelihood has a kink here"]
    # the point of the ridge nearest to the readings
    np.testing.assert_allclose(fit.values, np.array([1.0, 2.0]) - 0.7 * n / (n @ n), atol=2e-3)


def test_a_kink_that_is_not_at_the_maximum_is_passed() -> None:
    fit = maximise(kinked(np.array([1.0, 0.0]), -1.0, slope=0.5), parameters(2), [-3.0, 0.0])
    assert fit.status is Status.CONVERGED
    np.testing.assert_allclose(fit.values, [0.5, 2.0], atol=1e-6)


def test_a_maximum_where_two_kinks_cross_is_found() -> None:
    def evaluate(p: FloatArray) -> Evaluation:
        one, other = kinked(np.array([1.0, 0.0]), 0.3, 20.0)(p), kinked(np.array([1.0, 1.0]), 1.5, 20.0)(p)
        L, g = one.log_likelihood + other.log_likelihood, one.gradient + other.gradient
        return Evaluation(L, g, 2.0 * np.eye(2))

    fit = maximise(evaluate, parameters(2), [-3.0, -3.0])
    assert fit.status is Status.KINK
    np.testing.assert_allclose(fit.values, [0.25, 1.25], atol=5e-3)
