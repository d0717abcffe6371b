"""The leading candidates of a round fitted to convergence, in their simplest and in their richest form.

Screening stops most candidates early, and starts many in a form with few parameters. Before any is named, or a further
effect is sought on top of it, the leading ones are fitted on: the form that led, and those in which all optional
parameters are free, from where the leading one is and from the most promising start of the richer form.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from sim_heating.base.errors import InputError
from sim_heating.closure.search.admissibility import objections
from sim_heating.closure.search.ranking import delta_bic, needed_log_likelihood
from sim_heating.closure.search.trials.candidates import Candidate
from sim_heating.closure.search.trials.trial_fit import (
    CONVERGE,
    TrialFit,
    corrected,
    fitted_values,
    held_out_problem_with,
    own_thinning_error,
    problem_with,
    start_values,
)
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
    forms = [(t, c, start) for t in led for c, start in _forms(base, t, tried, predicted)]
    nameable = {t.name for t in led if not objections(t)}
    settings = [
        _unless_behind(base, t, c) if t.name in nameable and c is not t.candidate else CONVERGE for t, c, _ in forms
    ]
    fitted = fit_converged([base] * len(forms), [c for _, c, _ in forms], [start for *_, start in forms], settings)
    contenders = [_contender(t) for t in fitted]
    # the form that others fell behind may be one that may not be named any more
    named = {t.name for (t, c, _), k in zip(forms, contenders, strict=True) if c is t.candidate and k and k.admissible}
    again = [k for k, t in enumerate(fitted) if t.fit.status is Status.BEHIND and t.name not in named]
    continued = maximise_together([fitted[k].problem for k in again], [fitted[k].fit.values for k in again], CONVERGE)
    for k, fit in zip(again, continued, strict=True):
        trial = fitted[k]
        contenders[k] = _contender(replace(trial, fit=fit, delta_bic=delta_bic(base, fit, trial.candidate, 1.0)))
    by_name: dict[str, list[TrialFit]] = {}
    for contender in filter(None, contenders):
        by_name.setdefault(contender.name, []).append(contender)
    chosen = [min(rivals, key=lambda t: (not t.admissible, t.delta_bic)) for rivals in by_name.values()]
    complete = [replace(t, held_out=held_out_problem_with(base, t.candidate)) for t in chosen]
    return sorted(complete, key=lambda t: t.delta_bic)


def fit_converged(
    bases: Sequence[TrialFit],
    candidates: Sequence[Candidate],
    starts: Sequence[Mapping[str, float]],
    settings: Sequence[NewtonSettings] | NewtonSettings = CONVERGE,
) -> list[TrialFit]:
    """Candidates fitted to convergence, each on top of its own model from values by dotted name, all side by side.

    returns : by candidate, its trial, without samples held out
    """
    problems = [problem_with(*pair) for pair in zip(bases, candidates, strict=True)]
    fits = maximise_together(problems, [start_values(*p) for p in zip(problems, starts, strict=True)], settings)
    return [
        TrialFit(c.name, c, problem, None, fit, delta_bic(base, fit, c, 1.0))
        for base, c, problem, fit in zip(bases, candidates, problems, fits, strict=True)
    ]


def _leading(base: TrialFit, trials: Sequence[TrialFit]) -> list[TrialFit]:
    """The trials of a round that may be the cause, one of two causes, or a rival, the lowest BIC first."""
    gains = {t.name: t.fit.log_likelihood - base.fit.log_likelihood for t in trials}
    best = max(gains.values(), default=0.0)
    adequate = any(assess(t.fitted_samples).p_value >= POLICY.adequate_p for t in trials if gains[t.name] == best)
    least = min((POLICY.min_of_adequate if adequate else POLICY.min_of_best) * best, best - POLICY.rival_margin)
    return sorted((t for t in trials if gains[t.name] >= least), key=lambda t: t.delta_bic)[: EFFORT.causes]


def _unless_behind(base: TrialFit, leading: TrialFit, candidate: Candidate) -> NewtonSettings:
    """Settings of a fit that ends where the candidate falls far behind another form of its effect, which may be named.

    Such a fit takes the most steps of all, and nobody asks for its result.
    """
    return replace(CONVERGE, needed_log_likelihood=needed_log_likelihood(base, candidate, leading.delta_bic))


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
        error_K, at_s = own_thinning_error(trial, record)
    except InputError:  # a broken sensor that one of the two leaves out
        return trial
    again = corrected(trial, (error_K, at_s))
    fit = maximise_together([again.problem], [trial.fit.values], CONVERGE)[0]
    if not (np.any(error_K) and np.isfinite(fit.log_likelihood)):
        return trial
    delta = trial.delta_bic - 2.0 * (fit.log_likelihood - trial.fit.log_likelihood)
    return replace(again, fit=fit, delta_bic=delta)


def _forms(
    base: TrialFit, trial: TrialFit, tried: Sequence[Candidate], predicted: Sequence[float]
) -> list[tuple[Candidate, dict[str, float]]]:
    """Forms of an effect to be fitted, each with the values to start from."""
    below, at = fitted_values(base), fitted_values(trial)
    forms = [(trial.candidate, at)]
    of_effect = sorted((k for k, c in enumerate(tried) if c.name == trial.name), key=lambda k: -predicted[k])
    marched = [k for k in of_effect if np.isfinite(predicted[k])]
    richest = [
        tried[k].form for k in marched if not any(tried[k].form.is_special_case_of(tried[j].form) for j in of_effect)
    ]
    for form in list(dict.fromkeys(richest))[: EFFORT.rivals]:
        starts = [tried[k] for k in marched if tried[k].form == form]
        if trial.candidate.form.is_special_case_of(form):
            forms.append((starts[0], {**below, **starts[0].start, **at}))
        if form != trial.candidate.form:
            forms += [(c, {**below, **c.start}) for c in starts[: EFFORT.starts]]
    return forms
