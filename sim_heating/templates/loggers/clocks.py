"""Dates and times of day in cells, as seconds: arithmetic on what the cells state, in no time zone of a machine.

One layout holds for all cells of a column: the order of day and month, hours or minutes first, and the meaning of a
fourth number are decided by all of them together; where two readings remain that differ, the layout is asked for.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from sim_heating.base.arrays import FloatArray
from sim_heating.base.errors import InputError

DAY_S = 86400.0
ORDERS = {"day-first": "day first", "month-first": "month first", "year-first": "year first"}
"""Value of the option --dates -> in words."""
ANY_ORDER = "in any order"
"""Of dates whose order changes no time between rows."""
CLOCKS = ("hh:mm", "mm:ss", "hh:mm:ss", "hh:mm:ss:ms", "dd:hh:mm:ss", "hhmmss")
"""Layouts of times of day that --time-unit may state."""
LONGEST_STEP_S = 1e4
"""A longer time between rows is logged by nobody [s]."""
MONTHS = {
    name: k
    for k, names in enumerate(
        ("jan", "feb", "mar mrz mär", "apr", "may mai", "jun", "jul", "aug", "sep", "oct okt", "nov", "dec dez"), 1
    )
    for name in names.split()
}  # fmt: skip
ZONES = {
    "z": 0, "utc": 0, "gmt": 0, "bst": 1, "cet": 1, "mez": 1, "cest": 2, "mesz": 2, "est": -5, "edt": -4, "cst": -6,
    "cdt": -5, "mst": -7, "mdt": -6, "pst": -8, "pdt": -7,
}  # fmt: skip
"""Names of offsets from UTC [h]; they matter where they change within a file."""
DATE = (
    r"(?:(?P<a>\d{1,4})(?P<mark>[-/. ])(?P<b>\d{1,2}|[^\W\d]{3,9}\.?)(?:(?P=mark)|, ?)(?P<c>\d{2,4})"
    r"|(?P<named>[^\W\d]{3,9})\.? (?P<nd>\d{1,2}),? (?P<ny>\d{4})|(?P<basic>\d{8}))"
)
TIME = (
    r"(?:(?P<days>\d{1,4}) (?:days?,? )?)?(?P<h>\d{1,4}):(?P<m>\d{1,2})(?::(?P<s>\d{1,2})(?::(?P<x>\d{1,3}))?)?"
    r"(?:[.,](?P<f>\d{1,9}))?"
)
BASIC_TIME = r"(?P<bt>\d{4}(?:\d{2})?)(?:[.,](?P<bf>\d{1,9}))?"
HALF = r"(?: ?(?P<half>[AaPp])\.?[Mm]\.?)?"
OFFSET = r"(?: ?(?P<zone>[A-Za-z]{1,4})?(?P<offset>[+\u2212-]\d{2}(?::?\d{2})?)?)"
STAMP = re.compile(
    rf"'?(?:[A-Za-z]{{2,9}},? +)?{DATE}(?:(?:[T_-]|,? +|(?<=\d{{4}}):)(?:{TIME}|{BASIC_TIME}){HALF}{OFFSET})?"
)
OF_DAY = re.compile(rf"'?{TIME}{HALF}{OFFSET}")
ALL_BASIC = re.compile(r"(?:19|20)\d{12}(?:[.,]\d+)?")
"""Date and time as one number, yyyymmddhhmmss."""


@dataclass(frozen=True)
class Clock:
    """Times of a column.

    seconds  : (row,) from the first day of the file, or from midnight [s]; NaN where a cell holds none
    day_s    : that first day, from 1970 on [s]; None where the cells hold no date
    has_time : whether the cells hold more than a date
    layout   : in words
    is_span  : whether hours may count on beyond a day, as of a stop watch
    """

    seconds: FloatArray
    day_s: float | None
    has_time: bool
    layout: str


def clock_of(cells: Sequence[str], location: str, dates: str | None = None, unit: str | None = None) -> Clock | None:
    """Times that the cells of a column state; None where most of them are no clock in any layout that is known.

    location : `file, column x`, for messages
    dates    : order of dates as in ORDERS, where it is stated
    unit     : layout of the time of day as in CLOCKS, where it is stated
    raises   : InputError, one line with a cell and the option that decides, where several layouts fit
    """
    series = pd.Series(list(cells), dtype=object)
    full = series != ""
    if not full.any():
        return None
    joined = series[full]
    if joined.map(lambda c: ALL_BASIC.fullmatch(c) is not None).all():
        series = series.map(lambda c: f"{c[:8]}T{c[8:]}" if c else c)
    for pattern in (STAMP, OF_DAY):
        matches = series.map(pattern.fullmatch)
        hit = matches.notna()
        if hit.sum() > 0.5 * full.sum():
            parts = {
                name: [m[name] if m is not None else None for m in matches.where(hit, None)]
                for name in pattern.groupindex
            }
            return _clock(parts, np.asarray(hit), series, location, dates, unit)
    return None


def _clock(
    parts: dict[str, list[str | None]],
    hit: np.ndarray,
    cells: pd.Series,
    location: str,
    dates: str | None,
    unit: str | None,
) -> Clock:
    rows = np.flatnonzero(hit)
    time_s, has_time, layout = _time_of_day(parts, rows, cells, location, unit)
    seconds = np.full(len(cells), np.nan)
    offset_s, zoned = _offsets(parts, rows)
    if "a" not in parts:
        if np.any(np.diff(offset_s) != 0.0):
            time_s = time_s - offset_s
        seconds[rows] = time_s
        return Clock(seconds, None, True, layout)
    day, order = _days(parts, rows, time_s - offset_s, cells, location, dates)
    first = float(day[0])
    seconds[rows] = (day - first) * DAY_S + time_s - (offset_s if zoned else 0.0)
    return Clock(seconds, first * DAY_S, has_time, f"dates {order}{', ' + layout if has_time else ''}")


def _numbers(texts: list[str | None], rows: np.ndarray, default: float = 0.0) -> FloatArray:
    return np.array([float(texts[i] or default) for i in rows])


def _time_of_day(
    parts: dict[str, list[str | None]], rows: np.ndarray, cells: pd.Series, location: str, unit: str | None
) -> tuple[FloatArray, bool, str]:
    """Seconds of the day, whether there are any, and their layout in words."""
    if "bt" in parts and any(parts["bt"][i] for i in rows):
        texts = [(parts["bt"][i] or "000000").ljust(6, "0") for i in rows]
        fraction = np.array([float(f"0.{parts['bf'][i] or 0}") for i in rows])
        time_s = np.array([3600.0 * int(t[:2]) + 60.0 * int(t[2:4]) + int(t[4:6]) for t in texts]) + fraction
        return time_s, True, "clock hhmmss"
    if not any(parts["h"][i] for i in rows):
        return np.zeros(len(rows)), False, ""
    a, b, c = (_numbers(parts[n], rows) for n in "hms")
    fraction = np.array([float(f"0.{parts['f'][i] or 0}") for i in rows])
    days = _numbers(parts["days"], rows)
    third = np.array([parts["s"][i] is not None for i in rows])
    fourth = np.array([parts["x"][i] is not None for i in rows])
    half = np.array([(parts["half"][i] or "").lower() for i in rows])
    has_date = "a" in parts
    if np.any(third != third[0]) or np.any(fourth != fourth[0]):
        mixed = next(
            i for i, k in zip(rows, third if np.any(third != third[0]) else fourth, strict=True) if k != third[0]
        )
        raise InputError(
            f"{location}: `{cells[mixed]}` has another layout than `{cells[rows[0]]}`; one file has one layout "
            "of its clock"
        )
    layout = "clock hh:mm:ss"
    if fourth[0]:
        x = _numbers(parts["x"], rows)
        digits = {len(parts["x"][i] or "") for i in rows}
        is_ms = unit == "hh:mm:ss:ms" or (unit != "dd:hh:mm:ss" and (3 in digits or x.max() > 59.0))
        is_days = unit == "dd:hh:mm:ss" or (
            not is_ms
            and not has_date
            and (any(parts["f"][i] for i in rows) or any(len(parts["h"][i] or "") == 3 for i in rows))
        )
        if not is_ms and not is_days:
            raise InputError(
                f"{location}: `{cells[rows[0]]}` may be hh:mm:ss:ms or dd:hh:mm:ss; state --time-unit hh:mm:ss:ms or "
                "--time-unit dd:hh:mm:ss"
            )
        if is_ms:
            fraction = x / 1000.0
            layout = "clock hh:mm:ss:ms"
        else:
            days, a, b, c = a, b, c, x
            layout = "clock dd:hh:mm:ss"
    elif not third[0]:
        minutes_first = any(parts["f"][i] for i in rows) or (a.max() > 23.0 and not has_date)
        if unit == "mm:ss" or (unit is None and minutes_first and not has_date):
            a, b, c = np.zeros(len(a)), a, b
            layout = "clock mm:ss"
        elif unit == "hh:mm" or has_date or any(half):
            layout = "clock hh:mm"
        elif unit in (None, *CLOCKS):
            raise InputError(
                f"{location}: `{cells[rows[0]]}` may be hours and minutes or minutes and seconds; state "
                "--time-unit hh:mm or "
                "--time-unit mm:ss"
            )
    if np.any(b > 59.0) and layout != "clock mm:ss":
        i = rows[int(np.argmax(b > 59.0))]
        raise InputError(f"{location}: `{cells[i]}` is no time of day; mend the cell, or state --time-unit mm:ss")
    if np.any(c >= 61.0):
        raise InputError(f"{location}: `{cells[rows[int(np.argmax(c >= 61.0))]]}` is no time of day; mend the cell")
    if any(half):
        if np.any(a > 12.0) or not all(half):
            i = rows[int(np.argmax((a > 12.0) | (half == "")))]
            raise InputError(f"{location}: `{cells[i]}` is no time of day with AM or PM; mend the cell")
        a = np.where(a == 12.0, 0.0, a) + np.where(half == "p", 12.0, 0.0)
        layout += ", AM and PM"
    return days * DAY_S + 3600.0 * a + 60.0 * b + c + fraction, True, layout


def _offsets(parts: dict[str, list[str | None]], rows: np.ndarray) -> tuple[FloatArray, bool]:
    """Offsets from UTC [s], and whether they are stated."""
    offset_s = np.zeros(len(rows))
    stated = False
    for k, i in enumerate(rows):
        text, zone = parts["offset"][i], (parts["zone"][i] or "").lower()
        if text:
            digits = re.sub(r"\D", "", text).ljust(4, "0")
            offset_s[k] = (3600.0 * int(digits[:2]) + 60.0 * int(digits[2:])) * (-1.0 if text[0] != "+" else 1.0)
            stated = True
        elif zone in ZONES:
            offset_s[k] = 3600.0 * ZONES[zone]
            stated = True
    return offset_s, stated


def _days(
    parts: dict[str, list[str | None]],
    rows: np.ndarray,
    time_s: FloatArray,
    cells: pd.Series,
    location: str,
    dates: str | None,
) -> tuple[FloatArray, str]:
    """Days since 1970, and the order of the dates in words."""
    if parts["basic"][rows[0]]:
        texts = [parts["basic"][i] or "00000000" for i in rows]
        split = [np.array([float(t[p]) for t in texts]) for p in (slice(0, 4), slice(4, 6), slice(6, 8))]
        return _checked(_day(*split), rows, cells, location), "yyyymmdd"
    if parts["named"][rows[0]]:
        month = np.array([float(MONTHS.get((parts["named"][i] or "")[:3].lower(), 0)) for i in rows])
        day, year = _numbers(parts["nd"], rows), _numbers(parts["ny"], rows)
        return _checked(_day(year, month, day), rows, cells, location), "with names of months"
    a, c = _numbers(parts["a"], rows), _numbers(parts["c"], rows)
    middle = [parts["b"][i] or "" for i in rows]
    long_a, long_c = (any(len(parts[n][i] or "") > 2 for i in rows) for n in "ac")
    if not middle[0].isdigit():
        month = np.array([float(MONTHS.get(text[:3].lower(), 0)) for text in middle])
        day, year = (c, a) if long_a else (a, c)
        return _checked(_day(year, month, day), rows, cells, location), "with names of months"
    b = np.array([float(text) if text.isdigit() else np.nan for text in middle])
    readings = {"year-first": (a, b, c), "day-first": (c, b, a), "month-first": (c, a, b)}
    if long_a:
        readings = {"year-first": readings["year-first"]}
    elif long_c:
        readings.pop("year-first")
    if parts["mark"][rows[0]] == "." and not long_a:
        readings = {"day-first": readings["day-first"]}
    if dates is not None:
        if dates not in readings:
            raise InputError(f"{location}: `{cells[rows[0]]}` is not a date with the {ORDERS[dates]}; correct --dates")
        readings = {dates: readings[dates]}
    days = {order: _day(*numbers) for order, numbers in readings.items()}
    if len(days) == 1:
        order, day = next(iter(days.items()))
        return _checked(day, rows, cells, location), ORDERS[order]
    valid = {order: day for order, day in days.items() if not np.any(np.isnan(day))}
    if not valid:
        raise InputError(
            f"{location}: `{_odd_date(a, b, rows, cells)}` has no order of day and month that all dates have; "
            "mend the dates"
        )
    # readings between which the times do not tell are one, as where all rows are of one day
    distinct: list[str] = []
    for order, day in valid.items():
        span = (day - day[0]) * DAY_S + time_s
        if not any(np.array_equal(span, (valid[o] - valid[o][0]) * DAY_S + time_s) for o in distinct):
            distinct.append(order)
    is_stated = len(valid) == 1
    if len(distinct) > 1:
        is_stated = True
        steps = {o: np.diff(valid[o] * DAY_S + time_s) for o in distinct}
        usual = [o for o, step in steps.items() if np.all(step > -DAY_S / 24.0) and np.all(step <= LONGEST_STEP_S)]
        if len(usual) != 1:
            options = " or ".join(f"--dates {o}" for o in distinct)
            raise InputError(
                f"{location}: `{cells[rows[0]]}` may be read with the {ORDERS[distinct[0]]} or not; state {options}"
            )
        distinct = usual
    return valid[distinct[0]], ORDERS[distinct[0]] if is_stated else ANY_ORDER


def _odd_date(a: FloatArray, b: FloatArray, rows: np.ndarray, cells: pd.Series) -> str:
    """A date that contradicts the order of the first one."""
    odd = np.flatnonzero((a > 12.0) != (a[0] > 12.0))
    return str(cells[rows[int(odd[0]) if len(odd) else 0]])


def _day(year: FloatArray, month: FloatArray, day: FloatArray) -> FloatArray:
    """Days since 1970-01-01; NaN where there is no such date. Years of two digits are 1970 to 2069."""
    year = np.where(year < 70.0, year + 2000.0, np.where(year < 100.0, year + 1900.0, year))
    good = (month >= 1.0) & (month <= 12.0) & (day >= 1.0) & (day <= 31.0) & (year >= 1900.0) & (year <= 2200.0)
    y, m, d = (np.where(good, x, s).astype(np.int64) for x, s in ((year, 1970.0), (month, 1.0), (day, 1.0)))
    months = (y - 1970) * 12 + m - 1
    first = months.astype("datetime64[M]").astype("datetime64[D]")
    last = (months + 1).astype("datetime64[M]").astype("datetime64[D]")
    good &= d <= (last - first).astype(np.int64)
    return np.where(good, first.astype(np.int64) + d - 1.0, np.nan)


def _checked(day: FloatArray, rows: np.ndarray, cells: pd.Series, location: str) -> FloatArray:
    bad = np.flatnonzero(np.isnan(day))
    if len(bad):
        raise InputError(f"{location}: `{cells[rows[bad[0]]]}` is no date; mend the cell, or state --dates")
    return day


def with_colons(cells: Sequence[str]) -> list[str]:
    """Times of day as hhmmss, such as 94502 or 104500.5, with their colons; other cells as they are."""
    written = []
    for cell in cells:
        match = re.fullmatch(r"(\d{1,6})([.,]\d+)?", cell)
        padded = match[1].zfill(6) if match else ""
        written.append(f"{padded[:2]}:{padded[2:4]}:{padded[4:]}{match[2] or ''}" if match else cell)
    return written


def may_be_hhmmss(values: FloatArray) -> bool:
    """Whether numbers may be times of day as hhmmss: all are such times, and seconds stop at 59 where steps go on."""
    minutes, seconds = values // 100.0 % 100.0, values % 100.0
    if (
        not np.all((values >= 0.0) & (values < 240000.0) & (minutes < 60.0) & (seconds < 60.0))
        or values.max() < 10000.0
    ):
        return False
    read = np.diff(3600.0 * (values // 10000.0) + 60.0 * minutes + seconds)
    steps = np.diff(values)
    return bool(np.any(steps != read) and np.ptp(read) < np.ptp(steps))


def over_midnight(seconds: FloatArray) -> tuple[FloatArray, int]:
    """Times of day with a day added at each midnight, which is a step back of more than half a day; and how many."""
    unwrapped = seconds.copy()
    finite = np.flatnonzero(np.isfinite(seconds))
    wraps = np.concatenate(([0], np.cumsum(np.diff(seconds[finite]) < -0.5 * DAY_S)))
    unwrapped[finite] += DAY_S * wraps
    return unwrapped, int(wraps[-1]) if len(wraps) else 0
