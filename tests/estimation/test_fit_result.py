"""What a fit gives to a program and to a reader: values by name, criteria, text, tables."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import sim_heating as sh
from sim_heating.estimation.fit import FitResult
from sim_heating.estimation.report.remarks import CORRELATION, remarks
from tests.support.paths import PRACTICE

NAMES = ["ratio.scale", "ratio.d_alpha"]


@pytest.fixture(scope="module")
def fit() -> FitResult:
    return sh.estimate(PRACTICE / "p06", NAMES)


def test_a_value_has_its_sigma_by_name_and_as_a_pair(fit: FitResult) -> None:
    scale = fit.parameters["ratio.scale"]
    assert (scale.value, scale.sigma) == tuple(scale)
    np.testing.assert_allclose([p.sigma for p in fit.parameters.values()], np.sqrt(np.diag(fit.covariance)))
    assert fit.success
    assert fit.message == "converged"


def test_criteria_differ_by_their_penalties_alone(fit: FitResult) -> None:
    k = len(NAMES)
    assert fit.bic - fit.aic == pytest.approx(k * (np.log(fit.n) - 2.0))
    assert fit.aic == pytest.approx(2.0 * k - 2.0 * fit.fit.log_likelihood)
    assert fit.n == fit.after[0].segment_errors()["fit"]["n"]


def test_text_table_and_notebook_show_every_parameter(fit: FitResult) -> None:
    table = fit.to_dataframe()
    assert list(table.index) == NAMES
    assert table.loc["ratio.scale", "value"] == fit.parameters["ratio.scale"].value
    for name in NAMES:
        assert name in fit.report()
        assert name in fit._repr_html_()


def test_many_correlated_pairs_are_one_remark(fit: FitResult) -> None:
    """Three parameters of correlation 0.99: three pairs, one line."""
    three = sh.estimate(PRACTICE / "p06", [*NAMES, "ratio.d_elevon"])
    rho = np.full((3, 3), 0.99) + 0.01 * np.eye(3)
    sigma = three.bounds.sigma
    bounds = replace(three.bounds, covariance=rho * np.outer(sigma, sigma))
    (remark,) = [r for r in remarks(replace(three, bounds=bounds)) if r.kind == CORRELATION]
    assert remark.parameters == list(three.labels)
    assert remark.message.startswith("3 pairs have a correlation beyond 0.95: ratio.scale and ratio.d_alpha +0.990, ")
