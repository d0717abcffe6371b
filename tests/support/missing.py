"""Records whose truth has effects that their declared model lacks, made from a practice flight by the march itself."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from sim_heating.heating.effects import EffectUse
from sim_heating.inputs.points import conditions_of_record, point_of_record
from sim_heating.inputs.record import Record
from sim_heating.inputs.sensor_model import measure
from sim_heating.march.history import PointHistory, march_points, values_at
from tests.support.walls import practice_record

FloatArray = NDArray[np.float64]


def record_with(
    effects: Sequence[EffectUse], seed: int, *, jets: Callable[[FloatArray], FloatArray] | None = None,
    lost: float = 0.0, skew_s: float = 0.0, practice: str = "p06", declared: Record | None = None,
    **parameters: float,
) -> tuple[Record, PointHistory]:  # fmt: skip
    """A practice flight whose truth has undeclared effects, parameters (`stack__rsi__...`) or clock skew, and the
    truth.

    The truth is marched on a mesh of half the elements; `jets` is flown and not recorded.
    declared : another record than that of the practice flight, with the clock of its readings
    """
    record = practice_record(practice)[0] if declared is None else declared
    conditions = conditions_of_record(record)
    t = conditions.time_s
    values = {name.replace("__", "."): value for name, value in parameters.items()}
    true = replace(point_of_record(record), effects=tuple(effects), parameters=values)
    shown = conditions if jets is None else conditions.with_columns(jets=jets(t))
    clock = record.time_s[(record.time_s - skew_s >= t[0]) & (record.time_s - skew_s <= t[-1])]
    history = march_points([true], [shown], extra_times_s=clock - skew_s, halvings=1)[0]
    rng = np.random.default_rng(seed)
    columns = {"time_s": clock}
    for sensor, T in zip(record.sensors, values_at(history.time_s, history.sensors_K, clock - skew_s), strict=True):
        columns[sensor.column] = measure(sensor, T, rng, None, rng.random(len(clock)) < lost)
    known = conditions if jets is None else conditions.with_columns(jets=0.0 * t)
    return replace(record, thermocouples=columns, conditions=known), history
