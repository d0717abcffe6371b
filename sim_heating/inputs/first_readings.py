"""First readings of a record against the temperatures that it declares at its start.

A march begins at the first row of the conditions with the declared temperatures. A record that begins in flight, when
the wall is hot, then has a start that is wrong by hundreds of kelvins, and every later temperature with it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sim_heating.inputs.record import Record
from sim_heating.inputs.sensor_model import indicated_temperature
from sim_heating.thermal.stack import Sensor

TOLERANCE_K = 50.0
"""Difference of a first reading from the declared start that is reported [K]."""
LATER_S = 50.0
"""Time after the first reading at which a start in depth is proposed [s]: the readings until then tell of it."""
FASTEST_K_S = 30.0
"""Rate [K/s] at which a wall may have changed between the first row of the conditions and the first reading."""


@dataclass(frozen=True)
class OtherStart:
    """A first reading that is not at the declared temperature.

    record, sensor : names
    time_s         : of the first reading within the conditions [s]
    reading_K, declared_K : read, and indicated at the declared start [K]
    """

    record: str
    sensor: str
    time_s: float
    reading_K: float
    declared_K: float

    @property
    def is_hot(self) -> bool:
        """Whether the record begins hotter than declared."""
        return self.reading_K > self.declared_K

    @property
    def in_words(self) -> str:
        """What differs, and what to do."""
        return (
            f"{self.record} begins {'hot' if self.is_hot else 'cold'}: sensor {self.sensor} first reads "
            f"{self.reading_K:.0f} K, at {self.time_s:g} s, and the declared start is {self.declared_K:.0f} K; "
            f"`estimate --start lost:{self.time_s + LATER_S:.0f}` fits the temperatures in depth at a later time, or "
            "declare `initial_profile` in [stack]"
        )


def other_start(record: Record) -> OtherStart | None:
    """The outermost used sensor whose first reading is not at the declared start; None where all begin there.

    A reading may differ by 50 K, and by 30 K more for each second that it comes after the first row of the conditions.
    """
    begin_s = record.conditions.time_s[0]
    for sensor in sorted(record.used_sensors, key=lambda s: s.depth_m):
        read, t = record.thermocouples[sensor.column], record.time_s
        readings = np.flatnonzero(np.isfinite(read) & (t >= begin_s))
        if len(readings) == 0:
            continue
        i = int(readings[0])
        declared_K, wait_s = declared_reading_K(record, sensor), float(t[i] - begin_s)
        if abs(float(read[i]) - declared_K) > TOLERANCE_K + FASTEST_K_S * wait_s:
            return OtherStart(record.name, sensor.name, float(t[i]), float(read[i]), declared_K)
    return None


def declared_reading_K(record: Record, sensor: Sensor) -> float:
    """What a sensor indicates at the declared start of a record [K]."""
    stack = record.declared.stack
    profile = stack.initial_profile
    start_K = stack.initial_K if profile is None else float(np.interp(sensor.depth_m, *np.array(profile).T))
    return float(indicated_temperature(sensor, np.array([start_K]))[0])
