"""What is tried where the declared model does not explain a record: every effect that the record could tell of.

A candidate is an effect with a set of parameters to be estimated and values to start from. Effects of clocks and sensors
have no place in the march: their parameters are those of the record.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from sim_heating.conditions import Conditions
from sim_heating.effects import Effect, EffectUse, effects, use
from sim_heating.estimation.informed import STILL, deviations
from sim_heating.parameters import CLOCK_SKEW, EFFECT_PREFIX, SECOND_ORDER, SENSOR_PREFIX, SHORT
from sim_heating.record import Record

SENSOR_EFFECT = "sensor-bias"
NEEDS = {
    "sideslip": "beta_deg", "alpha-curvature": "alpha_deg", "elevon-curvature": "elevon_deg",
    "bodyflap-curvature": "bodyflap_deg", "impingement-onset": "alpha_deg", "jet-interaction": "jets",
}  # fmt: skip
"""Variables that have to move for an effect to be seen."""


@dataclass(frozen=True, eq=False)
class Candidate:
    """One thing to try.

    name   : of the effect, as a closure report has it
    uses   : the effects that the march carries for it, with the values that it starts from
    names  : dotted names of what is estimated on top of what is estimated already
    starts : values of those to start from
    """

    name: str
    uses: tuple[EffectUse, ...]
    names: tuple[str, ...]
    starts: tuple[Mapping[str, float], ...]


def candidates(record: Record, flown: Conditions, taken: Sequence[str] = ()) -> list[Candidate]:
    """All candidates for a record, without the effects that are in the model already."""
    found = []
    for name, effect in effects().items():
        if name not in taken and _moves(name, record, flown):
            found += _of_effect(effect, record, flown)
    if SENSOR_EFFECT not in taken:
        found += _of_sensors(record)
    return found


def _moves(name: str, record: Record, flown: Conditions) -> bool:
    variable = NEEDS.get(name)
    if variable is None:
        return True
    if variable not in flown:
        return False
    return bool(np.std(flown[variable]) > STILL.get(variable, 1e-3))


def _of_effect(effect: Effect, record: Record, flown: Conditions) -> list[Candidate]:
    starts = effect.starts(flown) if effect.starts is not None else [{}]
    found = []
    for chosen in effect.estimated():
        if effect.places == (CLOCK_SKEW.name,):
            found.append(Candidate(effect.name, (), (CLOCK_SKEW.name,), ({CLOCK_SKEW.name: 0.0},)))
            continue
        if effect.name == "interaction" and not _both_move(chosen[0], record):
            continue
        names = tuple(f"{EFFECT_PREFIX}{effect.name}.{p}" for p in chosen)
        for start in _relevant(effect, starts, chosen):
            used = use(effect.name, start)
            values = dict(zip((p.name for p in effect.parameters), used.values, strict=True))
            first = {f"{EFFECT_PREFIX}{effect.name}.{p}": values[p] for p in chosen}
            found.append(Candidate(effect.name, (used,), names, (first,)))
    return found


def _relevant(effect: Effect, starts: Sequence[Mapping[str, float]], chosen: Sequence[str]) -> list[dict[str, float]]:
    """The starts that differ in what is estimated; a value that is not estimated is left nominal."""
    nominal = {p.name: p.value for p in effect.parameters}
    own = []
    for start in starts:
        kept = {k: v for k, v in start.items() if k in chosen or k.endswith(("_begin_s", "_K", "_deg"))}
        if kept not in own and not (nominal.keys() - start.keys() == set() and kept == {}):
            own.append(kept)
    return own or [{}]


def _both_move(name: str, record: Record) -> bool:
    """Whether both variables of a product term move."""
    moved = deviations([record])
    i, j = next((i, j) for i, j in SECOND_ORDER if name == f"d_{SHORT[i]}_{SHORT[j]}")
    limits = list(STILL.values())
    return bool(moved[i] > limits[i] and moved[j] > limits[j])


def _of_sensors(record: Record) -> list[Candidate]:
    """Bias, or gain, of each sensor that is used."""
    found = []
    for sensor in record.used_sensors:
        for what, value in (("bias", 0.0), ("gain", 1.0)):
            name = f"{SENSOR_PREFIX}{sensor.name}.{what}"
            found.append(Candidate(SENSOR_EFFECT, (), (name,), ({name: value},)))
    return found
