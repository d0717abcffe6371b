"""What a fit gives to a program and to a reader: values by name, criteria, text, tables."""

from __future__ import annotations

import numpy as np
import pytest

import sim_heating as sh
from sim_heating.estimation.fit import FitResult
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


def test_names_are_still_taken_with_a_warning(fit: FitResult) -> None:
    with pytest.warns(DeprecationWarning, match="`names` is deprecated .* use `parameters`"):
        again = sh.estimate(PRACTICE / "p06", names=NAMES)
    assert again.parameters == fit.parameters
