"""Lists in which each reading stands behind the name of its sensor: ALMEMO, InfluxDB, Keysight, dataTaker.

    10:45:00 00: +0020.10 °C  wall               ALMEMO, below `DATUM: 05.03.24`
    rig,sensor=TC1 T=20.1 1714733100000000000    InfluxDB's line protocol
    +2.01E+01 C,+0.00E+00,101,0, ...             Keysight, with unit, time and channel
    D,081044,"JOB1",2024/05/03,10:45:00,0.000366,0;A,0,20.1,21.1;0072;9F1C    dataTaker's fixed format

sources: Ahlborn, ALMEMO manual, output of lists; InfluxData, line protocol reference; Keysight 34970A user's guide,
reading format; dataTaker DT80 user's manual, fixed-format mode
"""

from __future__ import annotations

import re
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import NamedTuple

from sim_heating.base.errors import InputError
from sim_heating.base.files import display_path
from sim_heating.heating.recorded.cells.block import Block
from sim_heating.heating.recorded.cells.numbers import shown_cell

ALMEMO_DATE = re.compile(r"\s*(?:\S+ +)?DATUM:\s*(\d\S*)\s*")
ALMEMO = re.compile(
    r"\s*(?:(\d{1,2}:\d{2}:\d{2}(?:[.,]\d+)?)\s+)?(\d{2}):\s*([+-]\s*\d[\d.,]*|-{2,})\s+(\S+)(?:\s+(.*))?"
)
"""Time, number of the channel, reading, unit, comment."""
_NAME, _VALUE = r'(?:[^\s,="\\]|\\.)+', r'(?:"(?:[^"\\]|\\.)*"|[^\s,"=]+)'
INFLUX = re.compile(rf"({_NAME}(?:,{_NAME}={_NAME})*) ({_NAME}={_VALUE}(?:,{_NAME}={_VALUE})*) (\d{{9,19}})")
"""Series, fields, and time since 1970."""
INFLUX_PART, INFLUX_NUMBER = re.compile(rf"({_NAME})=({_VALUE})"), re.compile(r"^([+-]?\d+)[iu]$")
_FLOAT = r"[+-]\d\.\d+E[+-]\d\d"
KEYSIGHT = re.compile(
    rf"({_FLOAT}) ([A-Za-z]+),(?:(\d{{4}}),(\d\d),(\d\d),(\d\d),(\d\d),(\d\d\.\d+)|({_FLOAT})),"
    r"(\d{3})(?:,[0-4])?(?:,|$)"
)
"""Reading, unit, date and time in numbers or seconds since the start, channel, alarm."""
DATATAKER = re.compile(r'D,\d+,"[^"]*",([\d/]+),(\d{1,2}:\d{2}:\d{2}),0(\.\d+),\d+;([A-Z]),(\d+),([^;]*);\d+;[\dA-F]+')
"""Date, time, its fraction, schedule, number of its first reading, readings."""
Lines = Sequence[tuple[int, str]]
"""Number and text of each line of the file."""
PROBED = 50
"""Lines by which it is found whether a text is such a list."""


class Reading(NamedTuple):
    """A reading: line of the file, time as it stands there, name of the sensor, unit, and the text of the number."""

    line: int
    stamp: str
    sensor: str
    unit: str
    cell: str


def list_block(path: Path, text: str) -> Block | None:
    """The block of a list, a row for each time and a column for each sensor; None for a text of another form.

    raises : InputError, one line, for a line that is none of the list
    """
    lines = [(i, line) for i, line in enumerate(text.splitlines(), 1) if line.strip()]
    for recorder, (pattern, read) in FORMS.items():
        if any(pattern.match(line) for _, line in lines[:PROBED]):
            readings = list(read(path, lines))
            return _block(path, recorder, readings) if readings else None
    return None


def _block(path: Path, recorder: str, readings: Sequence[Reading]) -> Block:
    units = {r.sensor: r.unit for r in reversed(readings)}
    for r in readings:
        if r.unit != units[r.sensor]:
            rule = f"`{r.sensor}` has the unit {r.unit}, and above {units[r.sensor]}; write one unit"
            raise InputError(f"{display_path(path)}, row {r.line}: {rule}")
    rows = ((r.line, r.stamp, r.sensor, r.cell) for r in readings)
    sensors, columns, lines = wide_columns(path, rows)
    stamps = list(dict.fromkeys(r.stamp for r in readings))
    units_of_columns = ("", *(units[s] for s in sensors))
    about = f"{recorder}, one row a time"
    return Block(path, ("time", *sensors), units_of_columns, (stamps, *columns), lines, about=about)


def wide_columns(
    path: Path, readings: Iterable[tuple[int, Hashable, str, str]]
) -> tuple[list[str], list[list[str]], tuple[int, ...]]:
    """Sensors, the cells of each over the times, empty where it has none, and the first line of each time.

    readings : line of the file, time, name of the sensor, text of the number
    raises   : InputError where a sensor has two readings at one time
    """
    rows: dict[Hashable, dict[str, str]] = {}
    sensors: dict[str, None] = {}
    lines: dict[Hashable, int] = {}
    for line, stamp, sensor, cell in readings:
        row = rows.setdefault(stamp, {})
        if sensor in row:
            rule = f"`{sensor}` has a second reading at one time; remove one"
            raise InputError(f"{display_path(path)}, row {line}: {rule}")
        row[sensor] = cell
        sensors[sensor] = None
        lines.setdefault(stamp, line)
    columns = [[row.get(sensor, "") for row in rows.values()] for sensor in sensors]
    return list(sensors), columns, tuple(lines.values())


def _matches(path: Path, lines: Lines, pattern: re.Pattern[str]) -> Iterator[tuple[int, re.Match[str]]]:
    """Lines of a list from its first reading on.

    raises : InputError for a line behind it that is no reading
    """
    is_begun = False
    for i, line in lines:
        match = pattern.fullmatch(line.strip())
        if match is None and is_begun and line[0] != "#":
            rule = "is no reading in the form of those above; mend or remove it"
            raise InputError(f"{display_path(path)}, row {i}: `{shown_cell(line.strip())}` {rule}")
        if match is not None:
            is_begun = True
            yield i, match


def _of_almemo(path: Path, lines: Lines) -> Iterator[Reading]:
    dates = {i: match[1] for i, line in lines if (match := ALMEMO_DATE.fullmatch(line))}
    readings = list(_matches(path, [row for row in lines if row[0] not in dates], ALMEMO))
    labels = _almemo_labels(match for _, match in readings)
    time = ""
    for i, match in readings:
        date, time = next((date for k, date in reversed(dates.items()) if k < i), ""), match[1] or time
        sensor = f"{match[2]} {labels[match[2]]}".strip()
        yield Reading(i, f"{date} {time}".strip(), sensor, match[4], match[3].replace(" ", ""))


def _almemo_labels(readings: Iterable[re.Match[str]]) -> dict[str, str]:
    """Channel -> the comment of all its readings; empty where they differ, as those of alarms do."""
    comments: dict[str, set[str]] = {}
    for match in readings:
        comments.setdefault(match[2], set()).add((match[5] or "").strip())
    return {channel: texts.pop() if len(texts) == 1 else "" for channel, texts in comments.items()}


def _of_influx(path: Path, lines: Lines) -> Iterator[Reading]:
    series = [(i, m[1], INFLUX_PART.findall(m[2]), m[3]) for i, m in _matches(path, lines, INFLUX)]
    tags = [{"": name.partition(",")[0]} | dict(INFLUX_PART.findall(name)) for _, name, _, _ in series]
    varying = _varying_tags(tags)
    is_value = all(field == "value" for _, _, fields, _ in series for field, _ in fields)
    for (i, _, fields, stamp), of_line in zip(series, tags, strict=True):
        parts = list(filter(None, map(of_line.get, varying)))
        for field, text in fields:
            sensor = " ".join(parts if parts and is_value else [*parts, field]).replace("\\", "")
            yield Reading(i, stamp, sensor, "", INFLUX_NUMBER.sub(r"\1", text).strip('"'))


def _varying_tags(tags: Sequence[Mapping[str, str]]) -> list[str]:
    """Tags that have more than one value, or that some lines lack."""
    return [k for k in dict.fromkeys(chain.from_iterable(tags)) if len({t.get(k) for t in tags}) > 1]


def _of_keysight(path: Path, lines: Lines) -> Iterator[Reading]:
    for i, line in lines:
        rest = line.strip()
        while rest:
            match = KEYSIGHT.match(rest)
            if match is None:
                rule = "is no reading with unit, time and channel as those above; mend or remove it"
                raise InputError(f"{display_path(path)}, row {i}: `{shown_cell(rest)}` {rule}")
            y, mo, d, h, mi, s = match.groups()[2:8]
            stamp = f"{y}-{mo}-{d} {h}:{mi}:{s}" if y else f"{match[9]} s"
            yield Reading(i, stamp, f"CH{match[10]}", match[2], match[1])
            rest = rest[match.end() :].lstrip()


def _of_datataker(path: Path, lines: Lines) -> Iterator[Reading]:
    for i, match in _matches(path, lines, DATATAKER):
        for k, cell in enumerate(match[6].split(","), int(match[5]) + 1):
            yield Reading(i, f"{match[1]} {match[2]}{match[3]}", f"{match[4]}{k}", "", cell.strip())


Read = Callable[[Path, Lines], Iterator[Reading]]
FORMS: dict[str, tuple[re.Pattern[str], Read]] = {
    "ALMEMO list": (re.compile(f"{ALMEMO.pattern}$"), _of_almemo),
    "InfluxDB line protocol": (re.compile(f"{INFLUX.pattern}\\s*$"), _of_influx),
    "Keysight list": (KEYSIGHT, _of_keysight),
    "dataTaker fixed format": (re.compile(f"{DATATAKER.pattern}\\s*$"), _of_datataker),
}
"""Recorder -> pattern of a line by which its list is known, and what reads it."""
