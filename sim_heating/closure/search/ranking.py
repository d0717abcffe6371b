"""Candidates weighed against each other by what their freedom would gain from noise alone.

    BIC = -2 log L / c + k log n,

k parameters estimated from n samples. c is the mean square of the best model's normalised residuals, at least 1: what
even the best model leaves is the scale on which differences count (quasi-likelihood; Burnham & Anderson, Model
Selection and Multimodel Inference, 2nd ed., sec. 2.5). To that are added

- two for the logarithm of the number of forms of an effect, and the squares of sigmas by which magnitudes are off what
  is declared as likely: neither many forms nor a value that nobody would expect come for nothing;
- -2 log L / c of the segments held out, at the values found without them; c is what the best model leaves there: how
  far forms reach beyond what they were fitted to.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from sim_heating.closure.search.candidates import Candidate, Form
from sim_heating.closure.search.trial_fit import TrialFit, fitted_values, sample_count
from sim_heating.estimation.inference.newton import Fit
from sim_heating.estimation.record_fit import sensor_definition


@dataclass(frozen=True, eq=False)
class SearchRound:
    """One pass over all candidates on top of a model.

    base, excess : that model, and its excess
    attempts     : the best attempt of each effect, best first
    posterior    : the probability of each with equal prior ones, `none` included
    passed       : effects not worth a fit, and the delta_bic that their best start promised
    """

    base: TrialFit
    excess: float
    attempts: tuple[TrialFit, ...]
    posterior: Mapping[str, float]
    passed: Mapping[str, float]


def score_round(
    base: TrialFit, attempts: Sequence[TrialFit], passed: Mapping[str, float], forms: Mapping[str, int]
) -> SearchRound:
    """The round; `forms` says how many forms of each effect were tried, which share its prior probability."""
    excess = base.excess
    if not attempts:
        return SearchRound(base, excess, (), {"none": 1.0}, passed)
    best = min(attempts, key=lambda a: a.delta_bic)
    c = max(1.0, 1.0 + min(excess, best.excess))
    held_out, c_held_out = base.likelihood_held_out, max(1.0, best.square_held_out)
    against = {
        a.name: delta_bic(base, a.fit, a.candidate, c)
        - 2.0 * (a.likelihood_held_out - held_out) / c_held_out
        + 2.0 * float(np.log(forms[a.name]))
        + prior_penalty(a)
        for a in attempts
    }
    posterior = posteriors({"none": 0.0, **against})
    told = [replace(a, weighed=against[a.name], posterior=posterior[a.name]) for a in attempts]
    return SearchRound(base, excess, tuple(sorted(told, key=lambda a: a.weighed)), posterior, passed)


def model_bic(attempt: TrialFit, best: TrialFit) -> float:
    """BIC of a whole model, its residuals on the scale of those of the best one, segments held out with theirs."""
    c, parameters = max(1.0, 1.0 + best.excess), len(attempt.problem.unknowns)
    held_out = attempt.likelihood_held_out / max(1.0, best.square_held_out)
    return -2.0 * (attempt.fit.log_likelihood / c + held_out) + parameters * float(
        np.log(sample_count(attempt.problem))
    )


def delta_bic(base: TrialFit, fit: Fit, candidate: Candidate, c: float) -> float:
    """BIC of a fit minus that of the model it is on top of."""
    gained = fit.log_likelihood - base.fit.log_likelihood
    return float(-2.0 * gained / c + len(candidate.names) * np.log(sample_count(base.problem)))


def posteriors(delta_bic: Mapping[str, float]) -> dict[str, float]:
    """Probability of each candidate with equal prior ones, exp(-BIC / 2) over their sum."""
    least = min(delta_bic.values())
    weight = {name: math.exp(-0.5 * (delta - least)) for name, delta in delta_bic.items()}
    total = sum(weight.values())
    return {name: w / total for name, w in weight.items()}


def prior_penalty(attempt: TrialFit) -> float:
    """By how much priors speak against the values found: the sum of squares of sigmas from what is declared."""
    part, found = attempt.problem.record_fits[0], fitted_values(attempt)
    known = {n: sensor_definition(part.record, n) or part.model.definition(n) for n in attempt.candidate.prior}
    return float(sum(((found[n] - p.value) / p.sigma) ** 2 for n, p in known.items()))


def count_forms(tried: Sequence[Candidate]) -> dict[str, int]:
    """How many forms of each effect there are, without those that are another one at one value of what it estimates."""
    forms: dict[str, set[Form]] = {}
    for c in tried:
        forms.setdefault(c.name, set()).add(c.form)
    return {name: sum(not any(f.within(g) for g in those) for f in those) for name, those in forms.items()}
