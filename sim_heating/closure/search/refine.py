"""The leading candidates of a round fitted to convergence, in their simplest and in their richest form.

Screening stops most candidates early, and starts many in a form with few parameters. Before any is named, or a further
effect is sought on top of it, the leading ones are fitted on: the form that led, and those in which all optional
parameters are free, from where the leading one is and from the most promising start of the richer form.
"""

from __future__ import annotations

from collections.abc import Sequence
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
from sim_heating.estimation.inference.newton import Fit, NewtonSettings, Status
from sim_heating.estimation.problem import FitProblem
from sim_heating.estimation.side_by_side import maximise_together
from sim_heating.inputs.record import Record


def refine(
    base: TrialFit, trials: Sequence[TrialFit], tried: Sequence[Candidate], predicted: Sequence[float]
) -> list[TrialFit]:
    """Fit the leading candidates of a round to convergence, the likeliest first.

    base      : the model below;  trials : the best trial of each effect as the round left it
    tried     : all candidates of the round;  predicted : gain in log likelihood of each, predicted at its start
    """
    gains = {t.name: t.fit.log_likelihood - base.fit.log_likelihood for t in trials}
    best = max(gains.values(), default=0.0)
    fraction = (
        POLICY.min_of_adequate if any(_is_adequate(t) for t in trials if gains[t.name] == best) else POLICY.min_of_best
    )
    led = sorted(
        (t for t in trials if gains[t.name] >= min(fraction * best, best - POLICY.rival_margin)),
        key=lambda t: t.delta_bic,
    )[: EFFORT.causes]
    forms = [(t, c, start) for t in led for c, start in _forms(base, t, tried, predicted)]
    problems = [problem_with(base, c) for _, c, _ in forms]
    firsts = [start_values(p, start) for p, (_, _, start) in zip(problems, forms, strict=True)]
    nameable = {t.name for t in led if not objections(t)}
    settings = [
        _unless_behind(base, t, c) if t.name in nameable and c is not t.candidate else CONVERGE for t, c, _ in forms
    ]
    fits = maximise_together(problems, firsts, settings)
    contenders = [_contender(base, c, p, fit) for (_, c, _), p, fit in zip(forms, problems, fits, strict=True)]
    # the form that others fell behind may be one that may not be named any more
    named = {t.name for (t, c, _), k in zip(forms, contenders, strict=True) if c is t.candidate and k and k.admissible}
    again = [k for k, (t, _, _) in enumerate(forms) if fits[k].status is Status.BEHIND and t.name not in named]
    continued = maximise_together([problems[k] for k in again], [fits[k].values for k in again], CONVERGE)
    for k, fit in zip(again, continued, strict=True):
        contenders[k] = _contender(base, forms[k][1], problems[k], fit)
    by_name: dict[str, list[TrialFit]] = {}
    for contender in filter(None, contenders):
        by_name.setdefault(contender.name, []).append(contender)
    chosen = [min(forms, key=lambda t: (not t.admissible, t.delta_bic)) for forms in by_name.values()]
    complete = [replace(t, held_out=held_out_problem_with(base, t.candidate)) for t in chosen]
    return sorted(complete, key=lambda t: t.delta_bic)


def _unless_behind(base: TrialFit, leading: TrialFit, candidate: Candidate) -> NewtonSettings:
    """Settings of a fit that ends where the candidate falls far behind another form of its effect, which may be named.

    Such a fit takes the most steps of all, and nobody asks for its result.
    """
    return replace(CONVERGE, needed_log_likelihood=needed_log_likelihood(base, candidate, leading.delta_bic))


def _contender(base: TrialFit, candidate: Candidate, problem: FitProblem, fit: Fit) -> TrialFit | None:
    """A candidate with its fit; None where it cannot be marched, or fell far behind."""
    if fit.status is Status.BEHIND or not np.isfinite(fit.log_likelihood):
        return None
    trial = TrialFit(candidate.name, candidate, problem, None, fit, delta_bic(base, fit, candidate, 1.0))
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


def _is_adequate(trial: TrialFit) -> bool:
    """Whether a trial explains the fitted samples to their noise."""
    return assess(trial.fitted_samples).p_value >= POLICY.adequate_p


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
