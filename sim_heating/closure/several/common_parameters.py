"""Which parameters of a cause records may have in common: all of them, those of one control point, or none.

| parameter | may be common to |
|---|---|
| of the flow around the vehicle (`Effect.of_flow`), such as an onset | all records, of neighbouring points too |
| of a wall, of a table, of any other property of a point | the records of a control point |
| of a flight (`Effect.of_flight`), of a clock, of a thermocouple | none |

This is the widest that a parameter may be; the records decide how wide it is (joint_search.py).
"""

from __future__ import annotations

from collections.abc import Sequence

from sim_heating.base.parameters import EFFECT_PREFIX, RECORD_PARAMETERS, SENSOR_PREFIX
from sim_heating.heating.effects import effects
from sim_heating.inputs.record import Record

ALL, POINT, RECORD = LEVELS = ("all", "point", "record")
"""Whose one value of a parameter is, the widest first."""


def widest_level(name: str) -> str:
    """The widest level at which records may have a parameter in common.

    name : dotted name of a parameter of the model, a record or an effect
    """
    if name in RECORD_PARAMETERS or name.startswith(SENSOR_PREFIX):
        return RECORD
    for effect in effects().values():
        prefix = f"{EFFECT_PREFIX}{effect.name}."
        own = name.removeprefix(prefix) if name.startswith(prefix) else effect.own_name(name)
        if own is not None:
            return RECORD if own in effect.of_flight else ALL if own in effect.of_flow else POINT
    return POINT


def owner(level: str, record: Record, one_point: bool) -> str:
    """Owner of a parameter in a record, as `FitProblem.joined` takes it: empty for all records.

    one_point : whether all records are of one control point
    """
    if level == RECORD:
        return record.name
    return "" if level == ALL or one_point else record.declared.control_point


def narrower_levels(level: str, records: Sequence[Record]) -> list[str]:
    """Levels below one at which more values of a parameter are estimated; none where every record has its own."""
    points = [r.declared.control_point for r in records]
    found, one_point = [], len(set(points)) == 1
    owners = {owner(level, r, one_point) for r in records}
    for narrower in LEVELS[LEVELS.index(level) + 1 :]:
        own = {owner(narrower, r, one_point) for r in records}
        if len(own) > len(owners):
            found.append(narrower)
            owners = own
    return found
