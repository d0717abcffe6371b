"""The leading candidates of a round fitted to convergence, in their simplest and in their richest form.

Screening stops most candidates early, and starts many in a form with few parameters. Before any is named, or a further
effect is sought on top of it, the leading ones are fitted on: the form that led, and those in which all optional
parameters are free, from where the leading one is and from the most promising start of the richer form.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from sim_heating.base.errors import InputError
from sim_heating.closure.search.admissibility import objections
from sim_heating.closure.search.ranking import volume_penalty
from sim_heating.closure.search.trials import trial_fit
from sim_heating.closure.search.trials.candidates import Candidate, Form
from sim_heating.closure.search.trials.trial_fit import TrialFit, delta_bic, needed_log_likelihood
from sim_heating.closure.verdict.adequacy import assess
from sim_heating.closure.verdict.policy import EFFORT, POLICY
from sim_heating.estimation.inference.newton import NewtonSettings, Status
from sim_heating.estimation.side_by_side import maximise_together
from sim_heating.inputs.record import Record


def refine(
    base: TrialFit, trials: Sequence[TrialFit], tried: Sequence[Candidate], predicted: Sequence[float]
) -> list[TrialFit]:
    """Fit the leading candidates of a round to convergence, the likeliest first.

    base      : the model below;  trials : the best trial of each effect as the round left it
    tried     : all candidates of the round;  predicted : gain in log likelihood of each, predicted at its start
    """
    led = _leading(base, trials)
    nameable = {t.name for t in led if not objections(t)}
    forms = [form for t in led for form in _forms(base, t, tried, predicted)]
    by_name: dict[str, list[TrialFit]] = {}
    for contender in _contenders(base, forms, _fitted(base, forms, nameable)):
        by_name.setdefault(contender.name, []).append(contender)
    chosen = map(_best_form, by_name.values())
    return sorted((trial_fit.with_held_out(base, t) for t in chosen), key=lambda t: t.delta_bic)


def _best_form(rivals: Sequence[TrialFit]) -> TrialFit:
    """The best of the fitted forms of an effect.

    Of two of which one has the other's parameters and more, by BIC: a parameter that no reading tells costs nothing
    beside an error, and leaves a fit that hardly converges. Others by what their parameters cost there.
    """
    best = min(rivals, key=lambda t: (not t.admissible, t.delta_bic))
    names = {*best.candidate.names}
    others = [t for t in rivals if not (names <= {*t.candidate.names} or {*t.candidate.names} <= names)]
    return min([best, *others], key=lambda t: (not t.admissible, t.delta_bic + volume_penalty(t, t.candidate)))


def fit_converged(
    bases: Sequence[TrialFit],
    candidates: Sequence[Candidate],
    starts: Sequence[Mapping[str, float]],
    settings: Sequence[NewtonSettings] | NewtonSettings = trial_fit.CONVERGE,
) -> list[TrialFit]:
    """Candidates fitted to convergence, each on top of its own model from values by dotted name, all side by side.

    returns : by candidate, its trial, without samples held out
    """
    problems = [trial_fit.problem_with(*pair) for pair in zip(bases, candidates, strict=True)]
    fits = maximise_together(
        problems, [trial_fit.start_values(*p) for p in zip(problems, starts, strict=True)], settings
    )
    return [
        TrialFit(c.name, c, problem, None, fit, delta_bic(base, fit, c, 1.0))
        for base, c, problem, fit in zip(bases, candidates, problems, fits, strict=True)
    ]


def _leading(base: TrialFit, trials: Sequence[TrialFit]) -> list[TrialFit]:
    """The trials of a round that may be the cause, one of two causes, or a rival, the lowest BIC first."""
    gains = {t.name: t.fit.log_likelihood - base.fit.log_likelihood for t in trials}
    least = 0.0  # beside an error a jump gains most, and may be one of the error
    if not base.has_error:
        best = max(gains.values(), default=0.0)
        adequate = any(assess(t.fitted_samples).p_value >= POLICY.adequate_p for t in trials if gains[t.name] == best)
        least = min((POLICY.min_of_adequate if adequate else POLICY.min_of_best) * best, best - POLICY.rival_margin)
    return sorted((t for t in trials if gains[t.name] >= least), key=lambda t: t.delta_bic)[: EFFORT.causes]


class _Form(NamedTuple):
    """A form of an effect to be fitted: the trial of the form that led, its candidate, and the values to start from."""

    leading: TrialFit
    candidate: Candidate
    start: Mapping[str, float]

    @property
    def has_led(self) -> bool:
        """Whether it is the form that led."""
        return self.candidate is self.leading.candidate


def _fitted(base: TrialFit, forms: Sequence[_Form], nameable: Collection[str]) -> list[TrialFit]:
    """Forms fitted to convergence, or until they are behind; nameable : effects whose form that led may be named."""
    settings = [_settings(base, form, nameable) for form in forms]
    return fit_converged([base] * len(forms), [f.candidate for f in forms], [f.start for f in forms], settings)


def _settings(base: TrialFit, form: _Form, nameable: Collection[str]) -> NewtonSettings:
    """Settings of a fit that ends where a form falls far behind the one of its effect that led, which may be named.

    Such a fit takes the most steps of all, and nobody asks for its result.
    """
    if form.has_led or form.leading.name not in nameable:
        return trial_fit.CONVERGE
    needed = needed_log_likelihood(base, form.candidate, form.leading.delta_bic)
    return replace(trial_fit.CONVERGE, needed_log_likelihood=needed)


def _contenders(base: TrialFit, forms: Sequence[_Form], fitted: Sequence[TrialFit]) -> list[TrialFit]:
    """Fitted forms that can be marched and did not fall behind, but behind one that may not be named any more."""
    contenders = [_contender(t) for t in fitted]
    led = {form.leading.name: contender for form, contender in zip(forms, contenders, strict=True) if form.has_led}
    again = [k for k, t in enumerate(fitted) if t.fit.status is Status.BEHIND and not _may_be_named(led[t.name])]
    behind = [fitted[k] for k in again]
    starts = [trial_fit.fitted_values(t) for t in behind]
    for k, trial in zip(again, fit_converged([base] * len(again), [t.candidate for t in behind], starts), strict=True):
        contenders[k] = _contender(trial)
    return list(filter(None, contenders))


def _may_be_named(contender: TrialFit | None) -> bool:
    return contender is not None and contender.admissible


def _contender(trial: TrialFit) -> TrialFit | None:
    """A fitted candidate with the objections to it; None where it cannot be marched, or fell far behind."""
    if trial.fit.status is Status.BEHIND or not np.isfinite(trial.fit.log_likelihood):
        return None
    return replace(trial, objections=objections(trial))


def recorrected(trial: TrialFit, record: Record) -> TrialFit:
    """A trial with the mesh correction at its own values, fitted on from there; as it is where that cannot be marched.

    record : the record that the search has thinned

    The correction of all candidates is that at the declared model. Where an effect moves heating in seconds, or changes
    the wall, the error of its own march differs by more than the noise.
    """
    try:
        error_K, at_s = trial_fit.own_thinning_error(trial, record)
    except InputError:  # a broken sensor that one of the two leaves out
        return trial
    if not np.any(error_K):
        return trial
    again = trial_fit.fitted_on(trial_fit.corrected(trial, (error_K, at_s)), trial_fit.CONVERGE)
    return again if np.isfinite(again.fit.log_likelihood) else trial


def _forms(base: TrialFit, trial: TrialFit, tried: Sequence[Candidate], predicted: Sequence[float]) -> list[_Form]:
    """Forms of an effect to be fitted."""
    below, at = trial_fit.fitted_values(base), trial_fit.fitted_values(trial)
    led, forms = trial.candidate.form, [_Form(trial, trial.candidate, at)]
    for form, starts in list(_richest(trial.name, tried, predicted).items())[: EFFORT.rivals]:
        if led.is_special_case_of(form):
            forms.append(_Form(trial, starts[0], {**below, **starts[0].start, **at}))
        if form != led:
            forms += [_Form(trial, c, {**below, **c.start}) for c in starts[: EFFORT.starts]]
    return forms


def _richest(name: str, tried: Sequence[Candidate], predicted: Sequence[float]) -> dict[Form, list[Candidate]]:
    """By form of an effect that is no special case of another one, its candidates that can be marched, best first."""
    of_effect = sorted((k for k, c in enumerate(tried) if c.name == name), key=lambda k: -predicted[k])
    every, marched = {tried[k].form for k in of_effect}, dict[Form, list[Candidate]]()
    for k in of_effect:
        if np.isfinite(predicted[k]):
            marched.setdefault(tried[k].form, []).append(tried[k])
    return {form: starts for form, starts in marched.items() if not any(map(form.is_special_case_of, every))}
