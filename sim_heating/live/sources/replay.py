"""A recorded flight sent again: its conditions and readings as messages, at the pace of the flight or faster.

Messages are lines of JSON with the names and units of the record, in the order of their times. A frame comes before a
reading of the same time.
"""

from __future__ import annotations

import asyncio
import json
import math
import time
from collections.abc import AsyncIterator, Iterator, Mapping, Sequence

from sim_heating.inputs.record import Record
from sim_heating.live.sources.mapping import default_fields
from sim_heating.live.types import TIME

EARLY_S = 0.002
"""Time before it is due at which a message is sent without waiting [s]; shorter waits are not kept by a system."""


def lines(records: Sequence[Record]) -> Iterator[tuple[float, bytes]]:
    """(flight time [s], line) of the messages of records of one flight, in the order of their times.

    The conditions are those of the first record. A sensor is sent by its column, and where two records have the same
    one by POINT.COLUMN.
    """
    first = records[0]
    rows: list[tuple[float, int, dict[str, float | None]]] = []
    flown = first.conditions.columns
    names = [name for name in flown if name != TIME]
    for values in zip(*(flown[name].tolist() for name in (TIME, *names)), strict=True):
        rows.append((values[0], 0, dict(zip((TIME, *names), values, strict=True))))
    for field, sensor_times, temperatures in _sensor_columns(records):
        for t, T in zip(sensor_times, temperatures, strict=True):
            rows.append((t, 1, {TIME: t, field: None if math.isnan(T) else T}))
    rows.sort(key=lambda row: (row[0], row[1]))
    for t, group in _grouped(rows):
        yield t, json.dumps(group, separators=(",", ":"), allow_nan=False).encode()


def sensor_fields(records: Sequence[Record]) -> dict[tuple[str, str], str]:
    """Field of each sensor in the lines of records, by control point and sensor."""
    return default_fields([(r.declared.control_point, s.name, s.column) for r in records for s in r.sensors])


def fields_of(records: Sequence[Record]) -> list[str]:
    """All fields that the lines of records have."""
    return [*records[0].conditions.names, *sensor_fields(records).values()]


def _sensor_columns(records: Sequence[Record]) -> Iterator[tuple[str, list[float], list[float]]]:
    fields = sensor_fields(records)
    for record in records:
        for sensor in record.sensors:
            field = fields[record.declared.control_point, sensor.name]
            yield field, record.time_s.tolist(), record.thermocouples[sensor.column].tolist()


def _grouped(
    rows: Sequence[tuple[float, int, Mapping[str, float | None]]],
) -> Iterator[tuple[float, dict[str, float | None]]]:
    """Conditions and readings of one time as one message."""
    time_s, group = math.nan, dict[str, float | None]()
    for t, _, values in rows:
        if t != time_s and group:
            yield time_s, group
            group = {}
        time_s = t
        group |= values
    if group:
        yield time_s, group


async def bodies(records: Sequence[Record], speed: float) -> AsyncIterator[bytes]:
    """The lines of records at a pace.

    speed : flight seconds a second; 0 as fast as they are taken
    """
    begun: tuple[float, float] | None = None
    for t, line in lines(records):
        if speed > 0.0:
            now = time.monotonic()
            if begun is None:
                begun = (now, t)
            wait_s = begun[0] + (t - begun[1]) / speed - now
            if wait_s > EARLY_S:
                await asyncio.sleep(wait_s)
        yield line
