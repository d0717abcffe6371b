"""Candidates ranked by the Bayesian information criterion.

    BIC = -2 log L / c - 2 log p + k log n,

k parameters estimated from n samples. p is the prior density of the declared table at its magnitude and derivatives: a
candidate with which they return to the table gains that. c is the reduced chi-square of the best model, at least 1:
what even the best model leaves is the scale on which differences count (quasi-likelihood; Burnham & Anderson, Model
Selection and Multimodel Inference, 2nd ed., sec. 2.5). The score adds

- two for the logarithm of the number of forms of an effect, and the price of the sigmas by which magnitudes are off
  their priors (scatter_price): many forms, and values that nobody would expect, have their price;
- -2 log L / c of the segments held out, at the values found without them, with the c of the best model there: how well
  a form extends beyond the data that it was fitted to. They judge a model whose heating or flight has an error, and
  choose none.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from sim_heating.base.parameters import CLOCK_SKEW
from sim_heating.closure.search.trials.candidates import Candidate, Form
from sim_heating.closure.search.trials.trial_fit import TrialFit, delta_bic, is_of_table, sample_count, table_log_prior
from sim_heating.closure.verdict.policy import POLICY


@dataclass(frozen=True, eq=False, repr=False)
class SearchRound:
    """One pass over all candidates on top of a model.

    base             : that model
    trials           : the best trial fit of each effect, best first
    screened_out     : effects that were not fitted, with the BIC difference that their best start predicts
    tried, predicted : all candidates, and the gain in log likelihood of each that its start predicts
    forms            : number of forms of each effect that were tried
    """

    base: TrialFit
    trials: tuple[TrialFit, ...]
    screened_out: Mapping[str, float]
    tried: tuple[Candidate, ...] = ()
    predicted: tuple[float, ...] = ()
    forms: Mapping[str, int] = field(default_factory=dict)

    def __repr__(self) -> str:
        best = ", ".join(f"{t.name} {t.score:+.1f}" for t in self.trials[:3])
        return f"<SearchRound: excess chi2 {self.base.excess_chi2:.3g}; {best or 'no candidate fitted'}>"


def scored_trials(base: TrialFit, trials: Sequence[TrialFit], forms: Mapping[str, int]) -> tuple[TrialFit, ...]:
    """The trial fits of a round with their scores against each other, the best first.

    base  : the model that they are on top of
    forms : number of forms of each effect that were tried, which share its prior probability
    """
    if not trials:
        return ()
    best = min(trials, key=lambda t: t.delta_bic)
    # Chi-square counts the error of every model as noise: differences in likelihood are on the scale of the best one.
    c = max(1.0, 1.0 + min(base.excess_chi2, best.excess_chi2))
    held_out, c_held_out = base.held_out_log_likelihood, max(1.0, best.held_out_chi2)
    # BIC; samples held out; the number of forms, so that an effect with ten is not found ten times as easily;
    # magnitudes against their priors: an emittance that falls to a third can imitate transition, but coatings do not do
    # that.
    scores = [
        delta_bic(base, t.fit, t.candidate, c)
        - 2.0 * (t.held_out_log_likelihood - held_out) / c_held_out
        + 2.0 * float(np.log(forms[t.name]))
        + prior_penalty(t, t.candidate)
        for t in trials
    ]
    scored = [replace(t, score=score) for t, score in zip(trials, scores, strict=True)]
    return tuple(sorted(scored, key=lambda t: t.score))


def model_bic(trial: TrialFit, best: TrialFit, common_names: Collection[str] = ()) -> float:
    """BIC of a whole model with the segments held out, residuals on the scale of those of the best model.

    best         : of the models that are compared; where it has an error of a size of its own, samples held out judge
                   models and choose none
    common_names : of parameters that are in common with other records, which are not counted here
    """
    fit = trial.record_fit
    held_out = 0.0 if best.size is not None else trial.held_out_log_likelihood / best.held_out_scale
    # Those with the prior of the table are common to all models; a model that frees one of them has one more.
    counted = [u for u in trial.problem.unknowns if not is_of_table(u.parameter)]
    parameters = sum(u.parameter.name not in {*common_names, *fit.flight_names} for u in counted)
    log_posterior = trial.log_evidence / best.scale + held_out + table_log_prior(trial.fit)
    return -2.0 * log_posterior + parameters * float(np.log(sample_count(trial.problem)))


def posteriors(delta_bic: Mapping[str, float]) -> dict[str, float]:
    """Probability of each candidate with equal prior ones, exp(-BIC / 2) over their sum."""
    lowest = min(delta_bic.values())
    weight = {name: math.exp(-0.5 * (delta - lowest)) for name, delta in delta_bic.items()}
    total = sum(weight.values())
    return {name: w / total for name, w in weight.items()}


def prior_penalty(trial: TrialFit, candidate: Candidate) -> float:
    """What the estimates of an effect of a trial's model cost by their distances from their priors [BIC]."""
    return sum(map(scatter_price, trial.deviations_of(candidate.with_prior)))


def volume_penalty(trial: TrialFit, candidate: Candidate) -> float:
    """What the parameters of an effect of a model with an error cost by Laplace's approximation, over their k log n.

        -sum log min(w, 1) - k log n

    w the eigenvalues of W^-1 V W^-1, above 1 where the readings tell nothing, V the covariance of those that are not on
    a bound, W their prior standard deviations: of a place that was searched for, such as an onset, D / sqrt(2 pi), D
    from the least to the largest place that the search starts from. k does not count the clock, which every model has.
    An error of the heating pays for its breaks in the same way; an exact model has BIC alone.

    Source: docs/theory/model_error.md, equation 5e.
    """
    if not trial.has_error:
        return 0.0
    widths = {n: p.sigma for n, p in trial.definitions(candidate.with_prior).items()}
    widths |= {n: span / math.sqrt(2.0 * math.pi) for n, span in candidate.spans.items()}
    free = [
        k for k, (n, bound) in enumerate(zip(trial.fit.names, trial.fit.on_bound, strict=True))
        if not bound and 0.0 < widths.get(n, math.inf) < math.inf
    ]  # fmt: skip
    names = [trial.fit.names[k] for k in free]
    W = np.array([widths[n] for n in names])
    left = trial.fit.covariance[np.ix_(free, free)] / np.outer(W, W)
    is_told = np.isfinite(np.diag(left))
    left = np.linalg.eigvalsh(left[np.ix_(is_told, is_told)])
    counted = sum(n != CLOCK_SKEW.name for n in names)
    told = -float(np.sum(np.log(np.clip(left, np.finfo(float).tiny, 1.0))))
    return told - counted * float(np.log(sample_count(trial.problem)))


def scatter_price(deviation: float) -> float:
    """What a value costs, in units of BIC, by its distance from the declared one in standard deviations [-].

        d^2 up to D,    D^2 + 2 log(d / D) beyond

    D = `Policy.max_scatter_sigmas`. A normal distribution as far as things scatter, beyond it one that is even in
    log(d): what is wrong by more is wrong for a reason of its own, and may be wrong by any order of magnitude.
    """
    if deviation <= POLICY.max_scatter_sigmas:
        return deviation**2
    return float(POLICY.max_scatter_sigmas**2 + 2.0 * np.log(deviation / POLICY.max_scatter_sigmas))


def count_forms(tried: Sequence[Candidate]) -> dict[str, int]:
    """Number of forms of each effect, without those that are special cases of another."""
    forms: dict[str, set[Form]] = {}
    for c in tried:
        forms.setdefault(c.name, set()).add(c.form)
    return {name: sum(not any(f.is_special_case_of(g) for g in those) for f in those) for name, those in forms.items()}
