"""A declared table with a sigma: what it says of a fit, what leaves it, and what it keeps a fit from taking up."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import pytest

from sim_heating.base.conditions import RATIO_VARIABLES
from sim_heating.closure.prior.flown_path import FlownPath, projection, record_path
from sim_heating.closure.prior.table import (
    DEFAULT_SIGMA,
    TablePrior,
    _of_default_sigma,
    table_error,
    table_findings,
    table_prior,
    undeclared_derivatives,
)
from sim_heating.closure.search.search import search_effects
from sim_heating.closure.search.trials.trial_fit import (
    base_trial,
    declared_fit,
    delta_bic,
    fitted_values,
    table_log_prior,
)
from sim_heating.estimation.fit import estimate
from sim_heating.estimation.problem import joint_reference
from sim_heating.estimation.report.remarks import remarks
from sim_heating.heating.effects import use
from sim_heating.heating.ratio.table import RatioTable
from sim_heating.heating.ratio.uncertainty import CORRELATION_LENGTH, correlation
from sim_heating.inputs.record import Record, load_record
from tests.support.few_candidates import search_among
from tests.support.missing import record_with
from tests.support.paths import PRACTICE

ALPHA = np.array([15.0, 50.0])


def flown_with(nodes: Mapping[str, Sequence[float]], sigma: float | None, ratio: float = 0.09) -> Record:
    """Practice flight p06 on a table of one ratio, nodes in these variables, and a relative sigma."""
    axes = tuple(np.array(nodes.get(v, [0.0]), dtype=float) for v in RATIO_VARIABLES)
    table = np.full([len(a) for a in axes], ratio)
    errors = None if sigma is None else sigma * table
    return replace(load_record(PRACTICE / "p06"), ratio_table=RatioTable(axes, table, errors, {}))


def test_the_slope_of_a_line_between_two_nodes_has_the_sigma_of_their_difference() -> None:
    record = flown_with({"alpha_deg": ALPHA}, sigma=0.2)
    prior = table_prior(record, ["ratio.scale", "ratio.d_alpha"], joint_reference([record]))
    assert prior is not None
    rho = float(correlation("alpha_deg", np.ptp(ALPHA)))
    expected = 0.2 * 0.09 * np.sqrt(2.0 * (1.0 - rho)) / np.ptp(ALPHA)
    assert prior.sigma[1] == pytest.approx(expected, rel=1e-6)


def test_errors_common_to_all_nodes_are_an_error_of_the_magnitude_alone() -> None:
    record = flown_with({"alpha_deg": [30.0, 30.01]}, sigma=0.2)  # fully correlated
    prior = table_prior(record, ["ratio.scale", "ratio.d_logre"], joint_reference([record]))
    assert prior is not None
    assert prior.sigma == pytest.approx([0.2, 0.0], abs=1e-3)


def test_a_table_without_sigma_has_the_slope_of_smooth_errors() -> None:
    """d2 rho/dx2 at 0 is -12 / l2: over a short excursion the slope has sigma sqrt(12) / l."""
    x = np.zeros((200, 5))
    x[:, 0] = np.linspace(39.9, 40.1, 200)
    path = FlownPath(x, np.ones(200), np.full(200, 0.1), np.zeros(200), np.ones(200))
    T = _of_default_sigma(path, projection(["ratio.scale", "ratio.d_alpha"], path, np.array([40.0, 0, 0, 0, 0])))
    expected = [DEFAULT_SIGMA, DEFAULT_SIGMA * 0.1 * np.sqrt(12.0) / CORRELATION_LENGTH["alpha_deg"]]
    assert np.sqrt(np.diag(T)) == pytest.approx(expected, rel=0.02)


def test_a_derivative_is_left_out_where_a_table_with_a_sigma_has_one_node() -> None:
    names = ["ratio.scale", "ratio.d_alpha", "ratio.d_elevon"]
    found = undeclared_derivatives(flown_with({"alpha_deg": ALPHA}, sigma=0.2), names)
    assert list(found) == ["ratio.d_elevon"]
    assert "one node in elevon_deg" in found["ratio.d_elevon"]
    assert undeclared_derivatives(flown_with({"alpha_deg": ALPHA}, sigma=None), names) == {}


def test_the_path_of_a_record_without_sigma_is_that_of_its_fitted_samples() -> None:
    record = load_record(PRACTICE / "p06")
    assert len(record_path(record).x) == np.count_nonzero(record.fit_mask() & record.read_mask)


def test_a_wrong_alpha_derivative_is_named_with_its_value_and_a_right_table_is_not() -> None:
    declared = flown_with({"alpha_deg": ALPHA, "elevon_deg": [-10.0, 15.0]}, sigma=0.02)
    wanted, off = ["ratio.scale", "ratio.d_alpha"], 6e-4
    wrong, right = (
        table_findings(fit.fit, fit.bounds.covariance, table_prior(record, wanted, fit.problem.reference))
        for record in (record_with([], 4, declared=declared, ratio__d_alpha=error)[0] for error in (off, 0.0))
        for fit in [estimate([record], wanted)]
    )
    assert right == []
    (first,) = wrong
    value, sigma = first.parameters["ratio.d_alpha"]
    assert value == pytest.approx(off, abs=4.0 * sigma)
    assert first.what.startswith("the table's alpha derivative is too low by 0.0006/deg")
    assert first.p_value < 1e-3


def test_a_wrong_alpha_derivative_is_named_by_a_fit_with_its_prior() -> None:
    declared = flown_with({"alpha_deg": ALPHA, "elevon_deg": [-10.0, 15.0]}, sigma=0.02)
    wrong, right = (
        table_findings(
            fitted,
            fitted.covariance,
            table_prior(fit.problem.record_fits[0].record, fit.labels, fit.problem.reference),
        )
        for record in (record_with([], 4, declared=declared, ratio__d_alpha=error)[0] for error in (6e-4, 0.0))
        for fit in [declared_fit(record)]
        for fitted in [base_trial(fit).fit]
    )
    assert right == []
    assert wrong[0].what.startswith("the table's alpha derivative is too low by 0.00")
    assert wrong[0].p_value < 1e-3


def test_a_right_table_whose_errors_go_together_is_rarely_named_by_fits_with_separate_priors() -> None:
    rng, names, draws = np.random.default_rng(5), ("ratio.scale", "ratio.d_alpha"), 400
    T = np.array([[1.0, 0.99], [0.99, 1.0]])
    told = np.diag([30.0, 0.02])  # what the readings say of each by themselves
    C = np.linalg.inv(told + np.eye(2))
    fit = estimate([record_with([], 4, declared=flown_with({"alpha_deg": ALPHA}, sigma=0.02))[0]], names).fit
    named = 0
    for true in rng.multivariate_normal(np.zeros(2), T, draws):
        read = true + rng.normal(size=2) / np.sqrt(np.diag(told))
        of_draw = replace(fit, values=C @ told @ read, prior_information=np.ones(2))
        named += bool(table_findings(of_draw, C, TablePrior(names, T, stated=True)))
    assert named <= 0.02 * draws


def trimmed(record: Record) -> Record:
    """The record with an elevon that follows the angle of attack, as in a pushover-pullup of a trimmed flight."""
    flown = record.conditions
    return replace(
        record, conditions=flown.with_columns(elevon_deg=0.5 * (flown["alpha_deg"] - 38.0) + 1e-3 * flown["elevon_deg"])
    )


def test_an_elevon_that_follows_alpha_is_remarked_as_correlated_with_it() -> None:
    record = trimmed(record_with([], 4)[0])
    found = remarks(estimate([record], ["ratio.d_alpha", "ratio.d_elevon"]))
    assert [(r.kind, r.parameters) for r in found] == [("correlated", ["ratio.d_alpha", "ratio.d_elevon"])]


AMONG = ("impingement-onset", "alpha-curvature", "time-skew", "coating-thickness")
"""Candidates of two tests beside the derivatives of the table."""


@pytest.mark.thorough
def test_heating_above_an_onset_is_not_taken_up_by_a_derivative_that_the_table_excludes(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    search_among(monkeypatch, *AMONG)
    declared = trimmed(flown_with({"alpha_deg": ALPHA, "log10_re": [4.0, 7.0]}, sigma=0.25))
    onset = use("impingement-onset", {"alpha_onset_deg": 42.0, "slope": 0.004})
    record = record_with([onset], 4, declared=declared)[0]
    found = search_effects(record)
    assert "ratio.d_elevon" in found.before.not_estimated
    assert found.names == ("impingement-onset",)
    values = fitted_values(found.added[0])
    assert values["effect.impingement-onset.alpha_onset_deg"] == pytest.approx(42.0, abs=0.5)


@pytest.mark.thorough
def test_a_derivative_that_the_table_excludes_and_the_flight_has_is_found_as_an_error_of_the_table(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    search_among(monkeypatch, *AMONG)
    declared = flown_with({"alpha_deg": ALPHA, "log10_re": [4.0, 7.0]}, sigma=0.25)
    found = search_effects(record_with([], 4, declared=declared, ratio__d_elevon=5e-4)[0])
    best = found.conclusion.best
    assert best.kind == "table"
    value, sigma = (
        fitted_values(best.last)["ratio.d_elevon"],
        dict(zip(best.last.fit.names, best.last.fit.sigma, strict=True)),
    )
    assert value == pytest.approx(5e-4, abs=4.0 * sigma["ratio.d_elevon"])
    assert table_error("ratio.d_elevon", value) == f"the table's elevon derivative is too low by {value:.2g}/deg"


@pytest.mark.thorough
def test_an_estimate_that_returns_to_its_table_gains_the_prior_density() -> None:
    base = base_trial(declared_fit(record_with([], 4, ratio__d_alpha=4e-4)[0]))
    away = table_log_prior(base.fit)
    sigma = {p.name: p.sigma for p in base.problem.parameters}
    values = fitted_values(base)
    expected = -0.5 * sum((values[n] / s) ** 2 for n, s in sigma.items() if n.startswith("ratio."))
    assert away == pytest.approx(expected)
    returned = replace(base.fit, values=np.zeros_like(base.fit.values))
    assert delta_bic(base, returned, base.candidate, 1.0) == pytest.approx(2.0 * away)


@pytest.mark.thorough
def test_what_is_missing_does_not_drive_the_base_away_from_its_table() -> None:
    """Residuals of a transition are many noise levels, and flat priors fit them with slopes that no table has."""
    declared = flown_with({"alpha_deg": ALPHA, "log10_re": [4.0, 7.0], "beta_deg": [-4.0, 4.0]}, sigma=0.25)
    transition = use("transition", {"log10_re_onset": 6.0, "alpha_sens": 0.03, "width": 0.03, "factor": 3.0})
    before = declared_fit(record_with([transition], 4, declared=declared)[0])
    base = base_trial(before)
    assert base.excess_chi2 > 100.0
    wide = {p.name: p.sigma for p in base.problem.parameters if p.name.startswith("ratio.")}
    far = max(abs(before.parameters[n][0]) / s for n, s in wide.items() if n in before.parameters)
    near = max(abs(fitted_values(base)[n]) / s for n, s in wide.items())
    assert near < 0.5 * far
