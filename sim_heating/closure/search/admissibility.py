"""Whether a fitted effect may be named: converged, within its bounds and its declared scatter, and significant.

A form that fails here is no candidate, however much better it fits: a wrong model of the wall or of the flight is
often explained best by an effect with a value that no vehicle has.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np

from sim_heating.base.parameters import EFFECT_PREFIX, RECORD_PARAMETERS, SENSOR_PREFIX, Parameter, layer_parameter
from sim_heating.closure.search.heating_change import heating_change
from sim_heating.closure.search.trials.candidates import Candidate
from sim_heating.closure.search.trials.trial_fit import TrialFit, fitted_values, sample_count, values_without
from sim_heating.closure.verdict.policy import POLICY
from sim_heating.estimation.inference.newton import Status
from sim_heating.heating.effects import effects

OFF = "standard deviations off"


def objections(trial: TrialFit, effects_of: Sequence[Candidate] = (), told: Collection[str] = ()) -> tuple[str, ...]:
    """Why the effects of a trial may not be named, a line each; none where they may.

    effects_of : the candidates of its model; by default the last one alone
    told       : names of those that the record tells from none, as a fit without them shows
    """
    lines = _convergence(trial)
    for candidate in effects_of or (trial.candidate,):
        magnitude = [] if candidate.name in told else _magnitude(trial, candidate)
        lines += [f"{candidate.name}: {line}" for line in (*_values(trial, candidate), *magnitude)]
    return tuple(lines)


def _convergence(trial: TrialFit) -> list[str]:
    fit = trial.fit
    if fit.converged or (fit.status is not Status.NO_START and fit.predicted_gain < POLICY.settled_gain):
        return []
    return ["its fit did not converge"]


def _values(trial: TrialFit, candidate: Candidate) -> list[str]:
    """Objections to values: on a bound, or further from nominal than the declared scatter allows."""
    values, lines = fitted_values(trial), []
    names = [u.parameter.name for u in trial.problem.unknowns]
    for name, p in trial.definitions(candidate.names).items():
        value, short = values[name], name.rpartition(".")[2]
        if trial.fit.on_bound[names.index(name)] and not abs(value - p.value) <= POLICY.near_bound_sigmas * p.sigma:
            line = [f"{short} is on its bound, {value:g}"]
        elif name in candidate.with_prior and not _has_any_size(trial, name):
            line = _off(short, value, p)
        else:
            continue
        if line and not _cancels(trial, candidate, short, p.sigma):
            lines += line
    return lines


def _cancels(trial: TrialFit, candidate: Candidate, name: str, sigma: float) -> bool:
    """Whether a parameter is a magnitude of a form whose rise and fall cancel: by itself it says nothing of what the
    form does."""
    effect = effects().get(candidate.name)
    if effect is None or name not in effect.neutral:
        return False
    change = heating_change(trial, candidate)
    return change is not None and bool(np.max(np.abs(change)) <= POLICY.max_scatter_sigmas * sigma)


def _off(name: str, value: float, p: Parameter) -> list[str]:
    """A line where a value is further from the nominal one than the declared scatter allows."""
    off = abs(value - p.value)
    return (
        []
        if off <= POLICY.max_scatter_sigmas * p.sigma
        else [f"{name} = {value:.3g} is {off / p.sigma:.1f} {OFF} {p.value:g}"]
    )


def far_from_declared(trial: TrialFit, candidate: Candidate) -> list[str]:
    """Values of layers, clocks, sensors and additions to the ratio that are further off than they scatter, a line each.

    A declaration may be wrong by any amount: another lot, a clock that was set wrong, a broken thermocouple. What an
    effect adds to a ratio has no size of its own, as ratios themselves differ by two decades over a vehicle. As for a
    change of the record, such a value may be named where it explains the record, and not where it only resembles it.
    """
    values = fitted_values(trial)
    return [
        f"{candidate.name}: {line}"
        for name, p in trial.definitions(candidate.names).items()
        if name in candidate.with_prior and _has_any_size(trial, name)
        for line in _off(name.rpartition(".")[2], values[name], p)
    ]


def _has_any_size(trial: TrialFit, name: str) -> bool:
    """Whether a parameter is of a thing that the record declares, a factor of a layer, a clock or a thermocouple, or
    adds to the ratio."""
    if name in RECORD_PARAMETERS or name.startswith(SENSOR_PREFIX):
        return True
    _, _, effect_and_own = name.partition(EFFECT_PREFIX)
    effect, _, short = effect_and_own.partition(".")
    library = effects().get(effect)
    if library is None:
        return layer_parameter(name) is not None
    stands_for = dict(zip((p.name for p in library.parameters), library.model_parameters, strict=False))
    adds = library.mode == "add" and trial.record_fit.model.definition(name).unit.startswith("1")
    return adds or layer_parameter(stands_for.get(short, name)) is not None


def _magnitude(trial: TrialFit, candidate: Candidate) -> list[str]:
    """Objection to a magnitude that the record does not tell from none."""
    names = [u.parameter.name for u in trial.problem.unknowns]
    none = values_without(trial, candidate.name, candidate.names)
    if not none:
        return []
    index = [names.index(n) for n in none]
    off = trial.fit.values[index] - np.array(list(none.values()))
    free = ~trial.fit.on_bound[index]
    if not np.any(free):
        return []  # on its bound, an objection of its own, or of a form whose parts cancel
    covariance = trial.fit.covariance[np.ix_(index, index)][np.ix_(free, free)] * max(1.0, 1.0 + trial.excess_chi2)
    if not np.all(np.isfinite(covariance)):
        return ["the record does not determine its magnitude"]
    distance = float(np.sqrt(max(off[free] @ np.linalg.pinv(covariance) @ off[free], 0.0)))
    if candidate is trial.candidate:
        distance = max(distance, _gain_sigmas(trial))
    return [] if distance >= POLICY.min_sigmas else [f"its magnitude is {distance:.1f} standard deviations from none"]


def _gain_sigmas(trial: TrialFit) -> float:
    """Standard deviations that the likelihood gained by the last effect of a trial amounts to, sqrt(2 gain / c).

    Where an onset and a rise above it change together, their bounds at the values found say little of how far these are
    from none; what the likelihood loses there does.
    """
    if trial.delta_bic >= 0.0:
        return 0.0
    gained = len(trial.candidate.names) * float(np.log(sample_count(trial.problem))) - trial.delta_bic
    return float(np.sqrt(max(gained, 0.0) / max(1.0, 1.0 + trial.excess_chi2)))
