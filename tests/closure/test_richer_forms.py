"""Richer forms of effects found again in records that hold them, from where the search for them starts."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pytest

from sim_heating.closure.search.ranking import count_forms
from sim_heating.closure.search.trials.candidates import Candidate, candidates
from sim_heating.closure.search.trials.free_forms import free_form
from sim_heating.closure.search.trials.screening import predicted_gains
from sim_heating.closure.search.trials.trial_fit import (
    CONVERGE,
    TrialFit,
    base_trial,
    declared_fit,
    fitted_values,
    problem_with,
    sample_count,
    start_values,
)
from sim_heating.closure.verdict.adequacy import assess, p_value
from sim_heating.closure.verdict.policy import POLICY
from sim_heating.estimation.side_by_side import maximise_together
from sim_heating.heating.effects import use
from sim_heating.heating.effects.curve import ELEVON, KNOTS, VALUES
from sim_heating.inputs.points import conditions_of_record
from sim_heating.inputs.record import load_record
from tests.closure.test_close_loop import simulated_record
from tests.support.paths import PRACTICE

FORMS = {
    "conductivity": {"conductivity_factor": 1.1, "conductivity_slope": 3e-4, "conductivity_decade": -0.15},
    "catalysis": {
        "catalysis_step": 0.3, "catalysis_K": 700.0, "catalysis_width_K": 50.0, "fall_fraction": 0.7, "fall_K": 950.0,
    },
    "transition": {
        "log10_re_onset": 6.7, "alpha_sens": 0.03, "width": 0.02, "factor": 1.5, "hysteresis": 0.12,
    },
    "impingement-onset": {"alpha_onset_deg": 40.5, "slope": 0.01, "saturation": 0.6},
}  # fmt: skip
"""A form of each effect that a factor, a monotone rise, or one onset does not have. The manoeuvre after the onset of
that transition takes the flow back below it by less than the hysteresis."""
CERTAIN = 4.0
"""Standard deviations within which a value is found."""
STARTS = 3


@pytest.mark.thorough
@pytest.mark.parametrize("name", FORMS)
def test_a_richer_form_is_found_with_its_values_and_fits_better_than_the_simpler_one(name: str) -> None:
    truth = {f"effect.{name}.{key}": value for key, value in FORMS[name].items()}
    record = simulated_record(load_record(PRACTICE / "p06"), [use(name, FORMS[name])])
    base = base_trial(declared_fit(record))
    own = [c for c in candidates(record, conditions_of_record(record)) if c.name == name]
    gains = dict(zip(own, predicted_gains(base, own), strict=True))
    rich = sorted((c for c in own if set(c.names) == set(truth)), key=lambda c: -gains[c])[:STARTS]
    simple = sorted((c for c in own if set(c.names) < set(truth)), key=lambda c: -gains[c])[:STARTS]
    problems = [problem_with(base, c) for c in (*rich, *simple)]
    firsts = [
        start_values(p, {**fitted_values(base), **c.start}) for p, c in zip(problems, (*rich, *simple), strict=True)
    ]
    fits = maximise_together(problems, firsts, CONVERGE)
    best, simpler = (max(some, key=lambda f: f.log_likelihood) for some in (fits[: len(rich)], fits[len(rich) :]))
    # By BIC: more than half the logarithm of the number of samples for each parameter more.
    least = 0.5 * np.log(sample_count(base.problem)) * (len(best.names) - len(simpler.names))
    assert best.log_likelihood > simpler.log_likelihood + least
    found, sigma = (dict(zip(best.names, values, strict=True)) for values in (best.values, best.sigma))
    missed = {n: (found[n] - value) / sigma[n] for n, value in truth.items()}
    assert all(abs(sigmas) < CERTAIN for sigmas in missed.values()), missed


@pytest.mark.parametrize("name", FORMS)
def test_a_richer_form_of_an_effect_does_not_make_it_likelier_by_chance(name: str) -> None:
    """What is a special case of another form does not count: the price is that of the forms without these."""
    record = load_record(PRACTICE / "p06")
    own = [c for c in candidates(record, conditions_of_record(record)) if c.name == name]
    free = {n for n in FORMS[name] if n in ("conductivity_decade", "fall_fraction", "hysteresis", "saturation")}
    without = [c for c in own if not any(n.rpartition(".")[2] in free for n in c.names)]
    assert len(without) < len(own)
    assert count_forms(own)[name] <= count_forms(without)[name] + 1


@pytest.mark.thorough
def test_an_effect_of_another_form_explains_the_record_with_a_curve_under_its_own_name() -> None:
    """A rise with elevon deflection that is steeper on one side: a parabola explains most of it, and not all."""
    record = load_record(PRACTICE / "p10")
    elevon = conditions_of_record(record)["elevon_deg"]
    at = np.linspace(np.min(elevon), np.max(elevon), KNOTS)
    rise = 2e-4 * (at - 1.4) ** 2 * (1.0 + 0.8 * np.tanh((at - 1.4) / 3.0))
    bent = {"variable": ELEVON, "low": float(at[0]), "high": float(at[-1])}
    bent |= dict(zip(VALUES, rise.tolist(), strict=True))
    base = base_trial(declared_fit(simulated_record(record, [use("added-curve", bent)])))
    (library,) = (c for c in candidates(record, conditions_of_record(record)) if c.name == "elevon-curvature")
    own = fitted_trial(base, library, dict(library.start))
    free = free_form(base, own, fitted_values(own))
    assert free is not None
    found = fitted_trial(base, free, fitted_values(own) | dict(free.start))
    assert found.name == "elevon-curvature"
    assert 0.0 < own.excess_chi2 < (1.0 - POLICY.min_explained_by_library) * base.excess_chi2
    assert p_value(assess(own.problem.samples(own.fit.values)).statistic) < POLICY.adequate_p  # with the declared noise
    assert assess(found.problem.samples(found.fit.values)).p_value >= POLICY.adequate_p


def fitted_trial(base: TrialFit, candidate: Candidate, start: Mapping[str, float]) -> TrialFit:
    """A candidate fitted on top of the base to convergence."""
    problem = problem_with(base, candidate)
    fit = maximise_together([problem], [start_values(problem, {**fitted_values(base), **start})], CONVERGE)[0]
    return TrialFit(candidate.name, candidate, problem, None, fit)
