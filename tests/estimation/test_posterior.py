"""A fit as a posterior for a sampler: density and gradient of likelihood and priors, and nothing beyond a bound."""

from __future__ import annotations

import numpy as np
import pytest

import sim_heating as sh
from tests.support.paths import SCENARIOS

NAMES = ["ratio.scale", "stack.emissivity_factor"]


@pytest.fixture(scope="module")
def fitted():
    return sh.estimate(SCENARIOS / "records" / "practice" / "p06", NAMES)


def test_the_posterior_is_highest_where_the_fit_ends_and_falls_as_its_bounds_say(fitted):
    problem = fitted.to_problem()
    sigma = np.sqrt(np.diag(fitted.bounds.white))
    best = float(problem.log_posterior(problem.start))
    beside = problem.log_posterior(problem.start + np.vstack([np.diag(sigma), -np.diag(sigma)]))
    assert np.all(beside < best)
    # one marginal sigma along an axis: half of (1 / (1 - rho^2)) or more
    rho = fitted.bounds.white[0, 1] / np.prod(sigma)
    np.testing.assert_allclose(beside - best, -0.5 / (1.0 - rho**2), rtol=0.1)


def test_the_gradient_is_that_of_the_log_posterior(fitted):
    problem = fitted.to_problem()
    sigma = np.sqrt(np.diag(fitted.bounds.white))
    at = problem.start + 2.0 * sigma
    steps = np.diag(0.05 * sigma)
    differences = problem.log_posterior(at + steps) - problem.log_posterior(at - steps)
    np.testing.assert_allclose(problem.gradient(at) * 0.1 * sigma, differences, rtol=0.02)


def test_nothing_is_marched_beyond_a_bound(fitted):
    problem = fitted.to_problem()
    assert problem.names == tuple(NAMES)
    assert list(problem.priors) == NAMES
    beyond = problem.start.copy()
    beyond[1] = problem.bounds[1, 1] + 0.1
    assert problem.log_posterior(beyond) == -np.inf


@pytest.mark.thorough
def test_a_sampler_gives_the_interval_of_the_profile(fitted):
    emcee = pytest.importorskip("emcee", reason="samplers need emcee: pip install 'sim-heating[docs]'")
    problem = fitted.to_problem()
    rng = np.random.default_rng(3)
    walkers = problem.start + rng.multivariate_normal(np.zeros(2), fitted.bounds.white, 16)
    sampler = emcee.EnsembleSampler(16, 2, problem.log_posterior, vectorize=True)
    sampler.random_state = np.random.RandomState(3).get_state()
    sampler.run_mcmc(walkers, 150)
    drawn = sampler.get_chain(discard=50, flat=True)[:, 0]
    sigma = float(np.sqrt(fitted.bounds.white[0, 0]))
    assert np.std(drawn) == pytest.approx(sigma, rel=0.2)
    assert np.mean(drawn) == pytest.approx(problem.start[0], abs=0.3 * sigma)
