"""What is tried where the declared model does not explain a record: every effect that the record could tell of.

A candidate is an effect with a set of parameters to be estimated and the values to start from. Effects of clocks and
sensors have no place in the march: their parameters are those of the record.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from sim_heating.base.conditions import Conditions
from sim_heating.base.parameters import CLOCK_SKEW, EFFECT_PREFIX, SENSOR, SENSOR_PREFIX
from sim_heating.estimation.inference.observability import CONSTANT_BELOW, constant_variables
from sim_heating.heating.effects import Effect, EffectUse, SearchStart, effects, use
from sim_heating.inputs.record import Record

SENSOR_EFFECT = "sensor-bias"
"""What a closure report calls thermocouples that are off."""
CONSTANT = 1e-3
"""Standard deviation below which a flight condition other than the ratio variables counts as constant, in its unit."""


class Form(NamedTuple):
    """What is estimated, and the values of what is not."""

    names: frozenset[str]
    fixed: frozenset[tuple[str, float]]

    def within(self, other: Form) -> bool:
        """Whether the other estimates all that this one does, and more that has one value here."""
        return self.names < other.names and other.fixed <= self.fixed


@dataclass(frozen=True, eq=False)
class Candidate:
    """One thing to try.

    name  : of the effect, as a closure report has it
    uses  : the effects that the march carries for it, with the values that it starts from
    names : dotted names of what is estimated on top of what is estimated already
    start : their values to begin with
    felt  : those that change anything there
    prior : those whose prior says how likely a value is; what is sought from several starts is left out
    """

    name: str
    uses: tuple[EffectUse, ...]
    names: tuple[str, ...]
    start: Mapping[str, float]
    felt: tuple[str, ...]
    prior: tuple[str, ...]

    @property
    def form(self) -> Form:
        """Candidates of one form differ in where they start."""
        values = {
            f"{EFFECT_PREFIX}{used.effect.name}.{p.name}": value
            for used in self.uses
            for p, value in zip(used.effect.parameters, used.values, strict=True)
        }
        return Form(frozenset(self.names), frozenset((n, v) for n, v in values.items() if n not in self.names))


def candidates(record: Record, flown: Conditions, taken: Sequence[str] = ()) -> list[Candidate]:
    """All candidates for a record, without the effects that are in the model already.

    flown : its conditions over the samples that are fitted
    """
    lag_taken = any(effects()[name].lags for name in taken if name in effects())
    found = []
    for name, effect in effects().items():
        if name not in taken and not (effect.lags and lag_taken) and all(_varies(v, flown) for v in effect.needs):
            found += _of_effect(effect, record, flown)
    if SENSOR_EFFECT not in taken:
        found += _of_sensors(record)
    return found


def _varies(variable: str, flown: Conditions) -> bool:
    """Whether a column of the conditions exists and varies over the fitted samples."""
    return variable in flown and bool(np.std(flown[variable]) > CONSTANT_BELOW.get(variable, CONSTANT))


def _of_effect(effect: Effect, record: Record, flown: Conditions) -> list[Candidate]:
    if effect.acts_on_clock:
        names = (CLOCK_SKEW.name,)
        return [Candidate(effect.name, (), names, {}, felt=names, prior=names)]
    tries = effect.starts_for(flown)
    sought = _sought(tries)
    return [
        _of_try(effect, one, sought)
        for one in tries
        if not constant_variables([place for name in one.names for place in _places(effect, name)], [record])
    ]


def _places(effect: Effect, name: str) -> tuple[str, ...]:
    """The model's parameters that a parameter of an effect stands for."""
    return tuple(p for p, own in zip(effect.model_parameters, effect.parameters, strict=False) if own.name == name)


def _sought(tries: Sequence[SearchStart]) -> frozenset[str]:
    """Parameters that tries begin at several values of."""
    begun: dict[str, set[float]] = {}
    for one in tries:
        for name in set(one.names) & set(one.values):
            begun.setdefault(name, set()).add(one.values[name])
    return frozenset(name for name, values in begun.items() if len(values) > 1)


def _of_try(effect: Effect, one: SearchStart, sought: Collection[str]) -> Candidate:
    limits = {p.name: (p.lower, p.upper) for p in effect.parameters}
    used = use(
        effect.name, {name: min(max(value, limits[name][0]), limits[name][1]) for name, value in one.values.items()}
    )
    values = dict(zip((p.name for p in effect.parameters), used.values, strict=True))
    first = {f"{EFFECT_PREFIX}{effect.name}.{p}": values[p] for p in one.names}
    prior = tuple(f"{EFFECT_PREFIX}{effect.name}.{p}" for p in one.names if p not in sought)
    felt = tuple(f"{EFFECT_PREFIX}{effect.name}.{p}" for p in effect.active_parameters(one.names, values))
    return Candidate(effect.name, (used,), tuple(first), first, felt, prior)


def _of_sensors(record: Record) -> list[Candidate]:
    """Bias, gain, or both, of each sensor that is used, where there are two at least: of a single one neither is told
    from heating."""
    found = []
    for sensor in record.used_sensors if len(record.used_sensors) > 1 else []:
        for wrong in (("bias",), ("gain",), ("bias", "gain")):
            start = {f"{SENSOR_PREFIX}{sensor.name}.{what}": SENSOR[what].value for what in wrong}
            found.append(Candidate(SENSOR_EFFECT, (), tuple(start), start, felt=tuple(start), prior=tuple(start)))
    return found
