"""A ratio table updated by measurements of its nodes: exact linear-Gaussian posterior within the correlation length."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sim_heating.base.conditions import RATIO_VARIABLES
from sim_heating.base.errors import InputError
from sim_heating.heating.ratio.lookup import pack_table, table_ratio
from sim_heating.heating.ratio.table import RatioTable
from sim_heating.heating.ratio.uncertainty import (
    CORRELATION_LENGTH,
    Evidence,
    correlation,
    node_weights,
    posterior,
    prior_covariance,
)

AXES = tuple(
    np.array(a) for a in ([0.0, 20.0, 30.0, 40.0, 50.0], [0.0], [2.0, 6.0, 6.5, 7.0], [-10.0, 0.0, 10.0], [0.0])
)
SHAPE = tuple(len(a) for a in AXES)
NODES = int(np.prod(SHAPE))


def table(seed: int = 1, relative_sigma: float = 0.3) -> RatioTable:
    ratio = 0.05 + 0.1 * np.random.default_rng(seed).random(SHAPE)
    return RatioTable(AXES, ratio, relative_sigma * ratio)


def node(*place: int) -> int:
    return int(np.ravel_multi_index(place, SHAPE))


def reading(at: int, value: float, sigma: float) -> Evidence:
    """A measurement of one node."""
    return Evidence(("ratio.d0",), np.array([at]), np.ones((1, 1)), np.array([value]), np.array([[sigma**2]]))


def readings(seed: int, rows: int, weighed: int = 12, sigma: float = 0.004) -> Evidence:
    """Measurements of random combinations of some nodes, with correlated errors."""
    rng = np.random.default_rng(seed)
    nodes = np.sort(rng.choice(NODES, weighed, replace=False))
    root = sigma * rng.normal(size=(rows, rows))
    return Evidence(
        tuple(f"y{i}" for i in range(rows)),
        nodes,
        rng.normal(size=(rows, weighed)),
        0.1 * rng.normal(size=rows),
        root @ root.T + sigma**2 * np.eye(rows),
    )


# Exact cases ---------------------------------------------------------------------------------------------------------


def test_a_node_measured_without_error_takes_the_measured_value() -> None:
    prior, at = table(), node(3, 0, 1, 1, 0)
    after = posterior(prior, [reading(at, 0.2, 0.0)])
    assert after.ratio.ravel()[at] == pytest.approx(0.2, rel=1e-12)
    assert after.sigma.ravel()[at] == pytest.approx(0.0, abs=1e-9)


def test_nodes_beyond_the_correlation_length_in_any_variable_keep_their_bits() -> None:
    prior = table()
    after = posterior(prior, [reading(node(3, 0, 1, 1, 0), 0.2, 0.001)])
    far = np.zeros(SHAPE, dtype=bool)
    far[0] = True  # alpha: 40 deg away against 30
    far[:, :, 0] = True  # log10_re: 4 against 2
    assert prior.sigma is not None
    np.testing.assert_array_equal(after.ratio[far], prior.ratio[far])
    np.testing.assert_array_equal(after.sigma[far], prior.sigma[far])
    assert np.all(after.ratio[~far] != prior.ratio[~far])


def test_measured_node_and_its_neighbour_follow_the_two_variable_normal_distribution() -> None:
    prior, here, there = table(), node(3, 0, 1, 1, 0), node(4, 0, 1, 1, 0)
    assert prior.sigma is not None
    n, s = prior.ratio.ravel(), prior.sigma.ravel()
    y, e = 0.15, 0.01
    gain = s[here] ** 2 / (s[here] ** 2 + e**2)
    rho = float(correlation("alpha_deg", np.array([10.0]))[0])
    after = posterior(prior, [reading(here, y, e)])
    assert after.ratio.ravel()[here] == pytest.approx(n[here] + gain * (y - n[here]), rel=1e-12)
    assert after.sigma.ravel()[here] == pytest.approx(s[here] * e / np.hypot(s[here], e), rel=1e-12)
    moved = rho * s[there] / s[here] * gain * (y - n[here])
    assert after.ratio.ravel()[there] == pytest.approx(n[there] + moved, rel=1e-12)
    assert after.sigma.ravel()[there] == pytest.approx(s[there] * np.sqrt(1.0 - rho**2 * gain), rel=1e-12)


def test_correlation_10_degrees_off_is_that_of_wendlands_function() -> None:
    d = 10.0 / CORRELATION_LENGTH["alpha_deg"]
    assert correlation("alpha_deg", np.array([-10.0]))[0] == pytest.approx((1 - d) ** 3 * (1 + 3 * d), rel=1e-14)


def test_update_equals_the_information_form_of_bayes_theorem() -> None:
    prior, evidence = table(), readings(2, rows=4)
    every = np.arange(NODES)
    K = prior_covariance(prior, every, every)
    H = np.zeros((4, NODES))
    H[:, evidence.nodes] = evidence.H
    information = np.linalg.inv(K) + H.T @ np.linalg.solve(evidence.covariance, H)
    covariance = np.linalg.inv(information)
    mean = covariance @ (
        np.linalg.solve(K, prior.ratio.ravel()) + H.T @ np.linalg.solve(evidence.covariance, evidence.value)
    )
    after = posterior(prior, [evidence])
    np.testing.assert_allclose(after.ratio.ravel(), mean, rtol=1e-8)
    np.testing.assert_allclose(after.sigma.ravel(), np.sqrt(np.diag(covariance)), rtol=1e-7)


def test_order_of_evidence_does_not_matter() -> None:
    prior, first, second = table(), readings(3, 3), readings(4, 2)
    one, other = posterior(prior, [first, second]), posterior(prior, [second, first])
    np.testing.assert_allclose(one.ratio, other.ratio, rtol=1e-10)
    np.testing.assert_allclose(one.sigma, other.sigma, rtol=1e-8)
    assert one.chi_square == pytest.approx(other.chi_square, rel=1e-10)


def test_tables_drawn_from_the_prior_lie_within_the_bounds_as_often_as_they_should() -> None:
    prior, evidence, repetitions = table(), readings(5, rows=3), 300
    rng = np.random.default_rng(6)
    every = np.arange(NODES)
    truths = rng.multivariate_normal(prior.ratio.ravel(), prior_covariance(prior, every, every), repetitions)
    noise = rng.multivariate_normal(np.zeros(3), evidence.covariance, repetitions)
    chi_square, z = np.empty(repetitions), np.empty(repetitions)
    at = int(evidence.nodes[0])
    for i, (n, e) in enumerate(zip(truths, noise, strict=True)):
        after = posterior(prior, [replace(evidence, value=evidence.H @ n[evidence.nodes] + e)])
        chi_square[i] = after.chi_square
        z[i] = (n[at] - after.ratio.ravel()[at]) / after.sigma.ravel()[at]
    assert np.mean(chi_square) == pytest.approx(3.0, abs=3.0 * np.sqrt(6.0 / repetitions))  # its variance is 2 x 3
    assert np.mean(z**2) == pytest.approx(1.0, abs=3.0 * np.sqrt(2.0 / repetitions))


# What always holds ---------------------------------------------------------------------------------------------------


@settings(max_examples=50, deadline=None)
@given(seed=st.integers(0, 10**6), rows=st.integers(1, 6), sigma=st.floats(1e-6, 1e3))
def test_no_evidence_makes_any_node_less_certain(seed: int, rows: int, sigma: float) -> None:
    prior = table(seed)
    assert prior.sigma is not None
    after = posterior(prior, [readings(seed + 1, rows, sigma=sigma)])
    assert np.all(after.sigma <= prior.sigma)
    assert np.all(np.isfinite(after.ratio))


def test_a_node_without_uncertainty_keeps_its_value() -> None:
    prior = table()
    assert prior.sigma is not None
    prior.sigma[2, 0, 1, 1, 0] = 0.0
    after = posterior(prior, [reading(node(3, 0, 1, 1, 0), 0.3, 0.001)])
    assert after.ratio[2, 0, 1, 1, 0] == prior.ratio[2, 0, 1, 1, 0]


@settings(max_examples=30, deadline=None)
@given(st.lists(st.floats(-60.0, 60.0), min_size=2, max_size=12, unique=True))
def test_correlation_matrix_of_any_nodes_is_positive_semidefinite(places: list[float]) -> None:
    x = np.array(places)
    for name in RATIO_VARIABLES:
        assert np.linalg.eigvalsh(correlation(name, x[:, None] - x[None, :])).min() > -1e-12


@settings(max_examples=50, deadline=None)
@given(st.tuples(st.floats(-10, 60), st.floats(-5, 5), st.floats(1, 8), st.floats(-20, 20), st.floats(-20, 20)))
def test_weights_of_the_nodes_give_the_ratio_of_the_kernel(x: tuple[float, ...]) -> None:
    prior = table()
    W = node_weights(AXES, np.array([x]))
    assert W.sum() == pytest.approx(1.0, rel=1e-14)
    looked_up = table_ratio(pack_table(prior), 0, np.array(x), 0)
    assert float((W @ prior.ratio.ravel())[0]) == pytest.approx(looked_up, rel=1e-12)


# What is refused -----------------------------------------------------------------------------------------------------


def test_a_table_without_sigma_cannot_be_updated() -> None:
    with pytest.raises(InputError, match="no sigma column"):
        posterior(RatioTable(AXES, table().ratio), [reading(0, 0.1, 0.01)])


def test_two_exact_measurements_of_one_node_are_rejected() -> None:
    with pytest.raises(InputError, match="repeat one another"):
        posterior(table(), [reading(3, 0.1, 0.0), reading(3, 0.1, 0.0)])
