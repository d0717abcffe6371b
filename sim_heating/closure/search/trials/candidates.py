"""Candidates of the search: every effect that the record could identify, with the values to start from.

A candidate is an effect with a set of parameters to be estimated. Effects of clocks and sensors do not enter the march:
their parameters are those of the record.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from sim_heating.base.conditions import Conditions
from sim_heating.base.parameters import COMMON_LAG, EFFECT_PREFIX, SENSOR, Parameter
from sim_heating.estimation.inference.observability import CONSTANT_BELOW, constant_variables
from sim_heating.estimation.record_fit import error_definition, sensor_parameter
from sim_heating.heating.edge_flow import edge_flow_columns
from sim_heating.heating.effects import Effect, EffectUse, SearchStart, effects, use
from sim_heating.heating.effects.compiled import unusable_value
from sim_heating.heating.effects.transition import BY_RE_THETA, TRANSITION
from sim_heating.inputs.points import flow_of_record
from sim_heating.inputs.record import Record
from sim_heating.march.ensemble import condition_history
from sim_heating.thermal.stack import Sensor

SENSOR_EFFECT, LAG_EFFECT = "sensor-bias", "sensor-lag"
"""Names in a closure report of a wrong bias or gain of a thermocouple, and of a lag of one or of all of them."""
ONSET_NAME = "log10_re_onset"
"""Parameter that the search for a declared transition is started from several values of."""


class Form(NamedTuple):
    """The estimated parameters of a candidate, and the values of the others."""

    names: frozenset[str]
    fixed: frozenset[tuple[str, float]]

    def is_special_case_of(self, other: Form) -> bool:
        """Whether the other estimates all parameters that this one does, and more that are fixed here."""
        return self.names < other.names and other.fixed <= self.fixed


@dataclass(frozen=True, eq=False)
class Candidate:
    """One effect at one start, to be fitted on top of a model.

    name       : of the effect, as a closure report has it
    uses       : the effects that the march includes for it, with the values that it starts from
    names      : dotted names of the parameters that are estimated in addition to the model's
    start      : their values to start from
    active     : those that change the prediction at the start
    with_prior : those whose prior counts in the score; a parameter that is started from several values has none
    priors     : parameters that have another prior than the model's or their own, such as a flat one
    spans      : from the least to the largest value that parameters are started from, where these are several
    """

    name: str
    uses: tuple[EffectUse, ...]
    names: tuple[str, ...]
    start: Mapping[str, float]
    active: tuple[str, ...]
    with_prior: tuple[str, ...]
    priors: Mapping[str, Parameter] = field(default_factory=dict)
    spans: Mapping[str, float] = field(default_factory=dict)

    @property
    def model_names(self) -> tuple[str, ...]:
        """Names of the estimated parameters, those of the model that they set included."""
        effect = effects().get(self.name)
        set_by = [] if effect is None else zip(effect.parameters, effect.model_parameters, strict=False)
        prefix = f"{EFFECT_PREFIX}{self.name}."
        return (*self.names, *(of_model for parameter, of_model in set_by if f"{prefix}{parameter.name}" in self.names))

    @property
    def form(self) -> Form:
        """The form; candidates of one form differ in where they start."""
        values = {
            f"{EFFECT_PREFIX}{used.effect.name}.{p.name}": value
            for used in self.uses
            for p, value in zip(used.effect.parameters, used.values, strict=True)
        }
        return Form(frozenset(self.names), frozenset((n, v) for n, v in values.items() if n not in self.names))


NO_EFFECT = Candidate("none", (), (), {}, (), ())
"""Of the model itself, to which nothing is added."""


def candidates(
    record: Record, flown: Conditions, excluded: Sequence[str] = (), *, last_resort: bool = False
) -> list[Candidate]:
    """All candidates for a record, without the effects that are already in the model.

    flown : its conditions over the samples that are fitted
    excluded : names of the effects in the model
    last_resort : whether the candidates are those of last resort, and no others
    """
    if last_resort:
        chosen = (e for name, e in effects().items() if e.last_resort and name not in excluded)
        return [c for e in chosen for c in _effect_candidates(e, record, flown)]
    flown = _with_criteria(record, flown)
    tried = _declared_candidates(record, flown, excluded)
    for effect in _addable(record, excluded):
        if _is_usable(effect, flown):
            tried += _effect_candidates(effect, record, flown)
    if SENSOR_EFFECT not in excluded:
        tried += [c for sensor in record.used_sensors for c in _bias_candidates(sensor)]
    # the lag of a single one is that of all
    if LAG_EFFECT not in excluded and len(record.used_sensors) > 1:
        for sensor in record.used_sensors:
            lag = replace(SENSOR["tau_s"], name=sensor_parameter(sensor, "tau_s"), value=sensor.tau_s)
            tried += _lag_candidates(lag)
    return tried


def _addable(record: Record, excluded: Sequence[str]) -> list[Effect]:
    """Effects that a model can take in addition to those that it has and to those that the record declares."""
    # The ratio of a point has one lag: a second effect that lags cannot be added.
    lag_taken = any(effects()[name].lags for name in excluded if name in effects())
    # a declared transition may have another criterion than that of nature: the library's own takes its place
    declared = {used.effect.name for used in record.declared.heating.effects} - {TRANSITION}
    others = [effect for name, effect in effects().items() if name not in {*excluded, *declared}]
    return [e for e in others if not e.last_resort and not (e.lags and lag_taken)]


def _is_usable(effect: Effect, flown: Conditions) -> bool:
    """Whether the samples have what an effect needs, and a user's effect has a value all along them that a step can
    use; else that is a warning."""
    if not all(_varies(variable, flown) for variable in effect.needs):
        return False
    if effect.built_in or effect.needs_wall:
        return True
    fault = unusable_value(use(effect.name, {}), flown.time_s, condition_history(flown))
    if fault:
        warnings.warn(f"{fault}; it is not looked for", stacklevel=2)
    return not fault


def _with_criteria(record: Record, flown: Conditions) -> Conditions:
    """Conditions with Re_theta / M_e, an onset of transition that may be searched for where the point has an edge."""
    heating = record.declared.heating
    has_edge = heating.recovery_of_point.of_surface and heating.running_length_m is not None
    if not has_edge or any(used.effect.name == TRANSITION for used in heating.effects):
        return flown
    flow = flow_of_record(record, [use(TRANSITION, {"by_re_theta": 1.0})])
    return flown.with_columns(log10_re_theta_m=edge_flow_columns(flow, flown)["log10_re_theta_m"])


def _declared_candidates(record: Record, flown: Conditions, excluded: Sequence[str]) -> list[Candidate]:
    """Candidates that free what the record declares of an effect, from its values and from the starts of its search.

    Their priors are the declared ones: a declared effect is found where it differs from its declaration.
    """
    tried = []
    for used in record.declared.heating.effects:
        effect = used.effect
        starts = effect.starts_for(with_criterion(used, flown))
        if effect.name in excluded or not starts:
            continue
        free = {f"{EFFECT_PREFIX}{effect.name}.{p.name}": p.name for p in used.definitions if p.sigma > 0.0}
        names = tuple(free)
        for changed in ({}, *({ONSET_NAME: onset} for onset in _onsets(used, starts))):
            values = used.by_name | changed
            uses = (replace(used, values=tuple(values.values())),)
            start = {name: values[own] for name, own in free.items()}
            tried.append(Candidate(effect.name, uses, names, start, names, names))
    return tried


def _onsets(used: EffectUse, starts: Sequence[SearchStart]) -> list[float]:
    """Onsets of a declared transition to start from, ascending: a flight begins at Reynolds numbers far below any."""
    limits = {p.name: (p.lower, p.upper) for p in used.definitions}
    searched = [start.values[ONSET_NAME] for start in starts if ONSET_NAME in start.values]
    return sorted({_within(onset, limits[ONSET_NAME]) for onset in searched})


def with_criterion(used: EffectUse, flown: Conditions) -> Conditions:
    """Conditions in which the onset of a declared transition is searched for: its own criterion in place of log10 Re.

    used : the declared effect;  flown : conditions of the flight, with the column of the criterion
    """
    by_re_theta = used.effect.name == TRANSITION and used.values[BY_RE_THETA] > 0.0
    return flown.with_columns(log10_re=flown["log10_re_theta_m"]) if by_re_theta else flown


def _varies(variable: str, flown: Conditions) -> bool:
    """Whether a column of the conditions exists and varies over the fitted samples."""
    # standard deviation below which a flight condition other than the ratio variables counts as constant, in its unit
    constant = 1e-3
    return variable in flown and bool(np.std(flown[variable]) > CONSTANT_BELOW.get(variable, constant))


def _effect_candidates(effect: Effect, record: Record, flown: Conditions) -> list[Candidate]:
    """The candidates of one effect, without those of parameters that the record cannot identify."""
    if effect.acts_on_readings:
        names = effect.model_parameters
        if COMMON_LAG.name in names:
            return _lag_candidates(COMMON_LAG)
        return [Candidate(effect.name, (), names, {}, active=names, with_prior=names)]
    starts = effect.starts_for(flown)
    searched = _searched_parameters(starts)
    return [
        _candidate_at(effect, start, searched)
        for start in starts
        if not constant_variables(
            [model_name for name in start.names for model_name in _places(effect, name)], [record]
        )
    ]


def _places(effect: Effect, name: str) -> tuple[str, ...]:
    """Dotted names of the model parameters behind a parameter of an effect."""
    return tuple(
        p for p, parameter in zip(effect.model_parameters, effect.parameters, strict=False) if parameter.name == name
    )


def _searched_parameters(starts: Sequence[SearchStart]) -> dict[str, float]:
    """Parameters with several start values -> from the least to the largest of these, in the parameter's unit."""
    values: dict[str, set[float]] = {}
    for start in starts:
        for name in set(start.names) & set(start.values):
            values.setdefault(name, set()).add(start.values[name])
    return {name: max(several) - min(several) for name, several in values.items() if len(several) > 1}


def _candidate_at(effect: Effect, start: SearchStart, searched: Mapping[str, float]) -> Candidate:
    """The candidate of an effect at one start, its values within their bounds; searched : as above."""
    definitions = effect.search_definitions()
    limits = {p.name: (p.lower, p.upper) for p in definitions}
    used = use(effect.name, {name: _within(value, limits[name]) for name, value in start.values.items()})
    used = replace(used, declared=definitions)
    values = used.by_name
    prefix = f"{EFFECT_PREFIX}{effect.name}."
    first = {f"{prefix}{p}": values[p] for p in start.names}
    with_prior = tuple(f"{prefix}{p}" for p in start.names if p not in searched)
    active = tuple(f"{prefix}{p}" for p in effect.active_parameters(start.names, values))
    spans = {f"{prefix}{p}": searched[p] for p in start.names if p in searched}
    return Candidate(effect.name, (used,), tuple(first), first, active, with_prior, spans=spans)


def _within(value: float, limits: tuple[float, float]) -> float:
    """A value, or the limit that it exceeds."""
    return min(max(value, limits[0]), limits[1])


def _bias_candidates(sensor: Sensor) -> list[Candidate]:
    """A bias, a gain, or both of one thermocouple."""
    starts = [
        {sensor_parameter(sensor, error): error_definition(sensor, error).value for error in errors}
        for errors in (("bias",), ("gain",), ("bias", "gain"))
    ]
    return [Candidate(SENSOR_EFFECT, (), tuple(s), s, active=tuple(s), with_prior=tuple(s)) for s in starts]


def _lag_candidates(lag: Parameter) -> list[Candidate]:
    """An unknown lag, from the declared one and from others; lag : its parameter, with the declared value."""
    lag_sigma_s = 5.0
    # time constants that a lag is searched from besides the declared one [s], and the prior that keeps a step within
    # reason: a badly attached junction may lag by tens of seconds, and what a lag changes is far from linear in it
    lag_starts_s = (5.0, 20.0)
    names, priors = (lag.name,), {lag.name: replace(lag, sigma=lag_sigma_s)}
    starts = (lag.value, *(start for start in lag_starts_s if start > lag.value))
    return [Candidate(LAG_EFFECT, (), names, {lag.name: start}, names, names, priors) for start in starts]
