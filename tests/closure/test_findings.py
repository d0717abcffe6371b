"""What a closed loop states: adequacy of a model, sets that cannot be distinguished, and what may not be named."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from sim_heating.base.files import read_json
from sim_heating.closure.close import ClosedLoop, close_loop
from sim_heating.closure.curves import curve_trials
from sim_heating.closure.report.record import write_closure
from sim_heating.closure.result import NotEffect, ParameterEstimate, Statement
from sim_heating.closure.search.admissibility import objections
from sim_heating.closure.search.hypothesis import NOT_PREDICTED, Hypothesis, conclude, fitted_anew, told_by_fewer
from sim_heating.closure.search.search import SearchResult
from sim_heating.closure.search.trials.candidates import NO_EFFECT
from sim_heating.closure.search.trials.trial_fit import base_trial
from sim_heating.closure.verdict.adequacy import Adequacy, assess, p_value, statistics
from sim_heating.closure.verdict.policy import POLICY
from sim_heating.estimation.fit import estimate
from sim_heating.estimation.inference.likelihood import ReadingIntervals
from sim_heating.estimation.inference.model_error import ErrorSize
from sim_heating.estimation.inference.newton import Status
from sim_heating.heating.effects import use
from sim_heating.heating.effects.curve import VALUES, curve_band
from sim_heating.inputs.record import load_record
from tests.support.few_candidates import searched_among
from tests.support.missing import record_with
from tests.support.paths import PRACTICE

ONSET = use("impingement-onset", {"alpha_onset_deg": 41.0, "slope": 0.002})


AMONG = ("time-skew", "alpha-curvature", "coating-thickness", "impingement-onset")
"""Candidates of two tests; `python -m benchmarks practice` searches the same records among all of them."""


@cache
def closed(name: str) -> ClosedLoop:
    """The loop closed on a practice record."""
    return close_loop(load_record(PRACTICE / name))


@cache
def searched() -> SearchResult:
    """The search of a record with one undeclared effect."""
    return searched_among(record_with([ONSET], 5)[0], ("impingement-onset", "alpha-curvature"))


def adequacy_of(record, effects=()) -> Adequacy:
    """Adequacy of the declared model, or with effects at their true values, magnitude and derivatives fitted."""
    fitted = estimate([record], effects=effects)
    return assess(fitted.samples())


@pytest.mark.thorough
@pytest.mark.parametrize(("name", "effect"), [("p05", "time-skew"), ("p06", "none")])
def test_the_effect_put_in_is_named_and_no_other(name: str, effect: str) -> None:
    """That of p08 is in test_close_loop.py."""
    found = closed(name).search if effect == "none" else searched_among(load_record(PRACTICE / name), AMONG)
    assert found.names == (effect,)
    assert found.conclusion.finding == ("none" if effect == "none" else "found")
    assert found.conclusion.best.adequate


@pytest.mark.thorough
def test_a_residual_that_follows_nothing_is_called_unknown() -> None:
    found = searched_among(load_record(PRACTICE / "p02"), AMONG)  # a sine in time, which is no effect of the library
    assert found.names == ("unknown",)
    assert found.none.excess_chi2 > 10.0
    curve = next(iter(curve_trials(base_trial(found.before))), None)
    assert curve is not None  # what the residual follows best is shown and not named
    assert curve.name not in found.names


@pytest.mark.thorough
def test_a_report_states_a_curve_and_its_file_and_has_neither_where_there_is_none(tmp_path: Path) -> None:
    plain, heights = closed("p06").report, dict.fromkeys(VALUES, 0.03)
    bent = use("curve", {"variable": 0.0, "low": 38.0, "high": 44.0} | heights)
    band = curve_band(bent.values, 1e-4 * np.eye(len(VALUES)), np.linspace(38.0, 44.0, 13))
    for name, found in (("plain", plain), ("curved", replace(plain, curve=band))):
        (tmp_path / name).mkdir()
        write_closure(found, tmp_path / name)
        written = read_json(tmp_path / name / "closure.json")["curve"]
        assert written == (None if found.curve is None else {"file": "curve.csv", "variable": "alpha_deg"})
        assert (tmp_path / name / "curve.csv").exists() is (found.curve is not None)
        stated = "departs with angle of attack" in (tmp_path / name / "report.html").read_text()
        assert stated is (found.curve is not None)


def test_the_true_model_is_adequate_and_a_model_without_the_effect_is_not() -> None:
    record, _ = record_with([ONSET], 5)
    true, without = adequacy_of(record, [ONSET]), adequacy_of(record)
    assert true.p_value > POLICY.adequate_p
    assert true.chi2_fit == pytest.approx(1.0, abs=0.1)
    assert abs(true.lag1) < 0.1
    assert without.p_value < 1e-3
    assert without.noise_scale == 1.0
    assert max(without.by_phase.values()) > 2.0 > max(true.by_phase.values())


def test_the_p_value_falls_continuously_with_the_statistic_and_is_never_zero() -> None:
    at = np.linspace(0.0, 30.0, 400)
    p = np.array([p_value(t) for t in at])
    assert p[0] == pytest.approx(1.0, abs=0.02)
    assert np.all(np.diff(p) <= 0.0)
    assert np.max(-np.diff(p)) < 0.15
    assert 0.0 < p[-1] < 1e-4


def test_records_judged_together_have_the_statistic_of_each_alone() -> None:
    record, _ = record_with([], 6)
    samples, rng = estimate([record]).samples(), np.random.default_rng(4)
    moved = [[replace(s, mean_K=s.mean_K + rng.normal(0.0, size * s.sigma_K, len(s.mean_K))) for s in samples]
             for size in (0.0, 1.0, 2.0)]  # fmt: skip
    together = []
    for channels in zip(*moved, strict=True):
        read = channels[0].channel.intervals
        either = ReadingIntervals(read.lower_K[:, np.newaxis], read.upper_K[:, np.newaxis])
        means_K = np.column_stack([s.mean_K for s in channels])
        together.append(replace(channels[0], mean_K=means_K, channel=replace(channels[0].channel, intervals=either)))
    np.testing.assert_allclose(statistics(together), [assess(one).statistic for one in moved], rtol=1e-12)


def test_white_noise_above_the_declared_one_has_no_structure_and_a_slow_error_of_the_same_size_has() -> None:
    record, _ = record_with([], 6)
    fitted = estimate([record])
    samples = fitted.samples()
    rng = np.random.default_rng(3)
    noisier = [replace(s, mean_K=s.mean_K + rng.normal(0.0, 2.0 * s.sigma_K, len(s.mean_K))) for s in samples]
    slow = [replace(s, mean_K=s.mean_K + 2.8 * s.sigma_K * np.sin(s.time_s / 40.0)) for s in samples]
    assert assess(noisier).noise_scale == pytest.approx(np.sqrt(5.0), rel=0.1)
    assert assess(noisier).p_value > POLICY.adequate_p
    assert p_value(assess(noisier).statistic) < 1e-3
    assert assess(slow).noise_scale == 1.0
    assert assess(slow).p_value < 1e-3


def test_what_is_named_has_converged_and_lies_on_no_bound() -> None:
    trial = searched().conclusion.best.last
    assert objections(trial) == ()
    stopped = replace(trial, fit=replace(trial.fit, status=Status.ITERATIONS, predicted_gain=5.0))
    assert any("did not converge" in line for line in objections(stopped))
    at = [u.parameter.name for u in trial.problem.unknowns].index("effect.impingement-onset.slope")
    values, on_bound = trial.fit.values.copy(), trial.fit.on_bound.copy()
    values[at], on_bound[at] = 0.2, True
    assert any(
        "on its bound" in line
        for line in objections(replace(trial, fit=replace(trial.fit, values=values, on_bound=on_bound)))
    )
    values = trial.fit.values.copy()
    values[at] = 1.5 * trial.fit.sigma[at]
    small = objections(replace(trial, delta_bic=0.0, fit=replace(trial.fit, values=values)))
    assert any("standard deviations from none" in line for line in small)


def renamed(h: Hypothesis, name: str, score: float, objections: tuple[str, ...] = ()) -> Hypothesis:
    """A hypothesis as another effect with its own score."""
    return replace(h, trials=(replace(h.last, name=name),), score=score, objections=objections)


def test_candidates_within_odds_of_twenty_are_a_set_and_others_are_not() -> None:
    none, best = searched().none, searched().conclusion.best
    both = conclude(none, [renamed(best, "coating-thickness", -500.0), renamed(best, "heat-capacity", -497.0)])
    assert both.finding == "one of"
    assert both.alternatives == (("coating-thickness", "heat-capacity"),)
    clear = conclude(none, [renamed(best, "coating-thickness", -500.0), renamed(best, "heat-capacity", -490.0)])
    assert clear.finding == "found"
    assert clear.rival == pytest.approx(10.0)


def test_an_inadmissible_form_is_disqualified_however_well_it_fits() -> None:
    none, best = searched().none, searched().conclusion.best
    better = renamed(best, "moisture", -90000.0, ("moisture: latent_J_kg is on its bound, 0",))
    found = conclude(none, [renamed(best, "coating-thickness", -500.0), better])
    assert found.alternatives == (("coating-thickness",),)
    assert conclude(none, [better]).finding == "unknown"


SIZE = ErrorSize(np.array([0.05]), np.array([200.0]), np.ones(1), np.zeros((1, 1, 1)), np.zeros((1, 1, 1)))
"""What readings say of the size of a model's error, of one size alone."""


@pytest.mark.parametrize(
    ("size", "least"),
    [
        (None, POLICY.min_gain_over_adequate),
        (replace(SIZE, sizes=np.zeros(1)), POLICY.min_gain_over_adequate),
        (SIZE, POLICY.min_gain),
    ],
    ids=["exact", "an error of the flight alone", "an error of the heating"],
)
def test_an_exact_model_that_explains_the_record_is_left_for_a_larger_gain(size, least) -> None:
    """Errors of form give a cause some gain, which an error of the heating takes up."""
    search = searched()
    adequate, not_so = (replace(h, trials=(replace(h.last, size=size),)) for h in (search.conclusion.best, search.none))
    assert adequate.adequate
    assert not not_so.adequate
    for none, needed in ((adequate, least), (not_so, POLICY.min_gain)):
        for beyond, is_named in ((-1.0, False), (1.0, True)):
            conclusion = conclude(none, [renamed(adequate, "transition", -needed - beyond)])
            assert (conclusion.alternatives == (("transition",),)) is is_named


def test_an_error_of_the_model_leaves_it_to_the_evidence_what_is_resembled() -> None:
    none = searched().none
    other = renamed(none, "transition", -50.0)  # explains nothing of the excess chi-square
    assert not other.adequate
    assert conclude(none, [other]).finding == "unknown"
    with_error = replace(other, trials=(replace(other.last, size=SIZE),))
    found = conclude(none, [with_error])
    assert (found.finding, found.alternatives) == ("partly", (("transition",),))


def test_objections_are_to_the_last_fit_of_a_hypothesis() -> None:
    best = searched().conclusion.best
    before = replace(best, objections=(NOT_PREDICTED[0], "its fit did not converge"))
    assert fitted_anew(before, best.last).objections == ()
    stopped = replace(best.last, fit=replace(best.last.fit, status=Status.ITERATIONS, predicted_gain=5.0))
    assert fitted_anew(best, stopped).objections == ("its fit did not converge",)


@pytest.mark.parametrize(("score_without", "is_named"), [(-40.0, True), (-48.0, False)])
def test_a_magnitude_whose_bound_is_wide_is_told_by_the_odds_over_a_model_without_it(score_without, is_named) -> None:
    best = searched().conclusion.best
    at = [u.parameter.name for u in best.last.problem.unknowns].index("effect.impingement-onset.slope")
    values = best.last.fit.values.copy()
    values[at] = 1.5 * best.last.fit.sigma[at]
    small = replace(best.last, delta_bic=0.0, fit=replace(best.last.fit, values=values))
    other = replace(best.last, name="emissivity", candidate=NO_EFFECT)
    both = replace(fitted_anew(replace(best, trials=(other, small)), small), score=-50.0)
    assert not both.admissible
    without = replace(best, trials=(other,), score=score_without)
    assert told_by_fewer(both, [without]).admissible is is_named


def test_a_finding_that_leaves_many_noise_floors_says_what_it_resembles() -> None:
    bad = Adequacy(1e-9, 5.0, 36.0, 0.6, 0.2, {"surface": 5.0}, {}, 40.0, False)
    text = Statement("partly", [["transition"]], bad, 0.7).in_words()
    assert text == "Partly: it resembles transition, which leaves 6.0 noise floors on the segments held out"


def test_causes_that_are_no_effect_are_listed_with_their_estimates() -> None:
    cause = NotEffect(
        "flight", "density of the flight conditions 8 % too low", {"f": ParameterEstimate(1.08, 0.01, "1")}
    )
    stated = Statement("found", [[cause.what]], not_effects=[cause])
    assert stated.in_words() == f"Found, and no aerothermal effect: {cause.what}"
    data = stated.as_json()
    assert data["not_effects"] == [
        {
            "kind": "flight", "what": cause.what, "parameters": {"f": {"value": 1.08, "sigma": 0.01, "unit": "1"}},
            "probability": None,
        }
    ]  # fmt: skip
