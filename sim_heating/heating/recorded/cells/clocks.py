"""Dates and times of day in cells, as seconds: arithmetic on what the cells state, in no time zone of a machine.

One layout holds for all cells of a column: the order of day and month, hours or minutes first, and the meaning of a
fourth number are decided by all of them together; where two readings remain that differ, the layout is asked for.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pandas as pd

from sim_heating.base.arrays import FloatArray
from sim_heating.base.errors import InputError
from sim_heating.heating.recorded.cells.text import DOTTED_AFTER_DATE, western

DAY_S = 86400.0
HOUR_S = 3600.0
ORDERS = {"day-first": "day first", "month-first": "month first", "year-first": "year first"}
"""Value of the option --dates -> in words."""
GROUPS_OF_ORDER = {"year-first": "abc", "day-first": "cba", "month-first": "cab"}
"""Groups of DATE that hold year, month and day."""
DIGITS_OF_BASIC = (slice(0, 4), slice(4, 6), slice(6, 8))
"""Year, month and day in yyyymmdd."""
ANY_ORDER = "in any order"
"""Of dates whose order changes no time between rows."""
MINUTES = "clock mm:ss"
"""Layout of minutes and seconds, in words."""
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
}
_EUROPE = {"z": 0, "utc": 0, "gmt": 0, "bst": 1, "cet": 1, "mez": 1, "cest": 2, "mesz": 2}
_AMERICA = {"est": -5, "edt": -4, "cst": -6, "cdt": -5, "mst": -7, "mdt": -6, "pst": -8, "pdt": -7}
ZONES = {**_EUROPE, **_AMERICA}
"""Names of offsets from UTC [h]; they matter where they change within a file."""
DATE = (
    r"(?:(?P<a>\d{1,4})\.?(?P<mark>[-/. ])(?P<b>\d{1,2}|[^\W\d]{3,9}\.?)(?:(?P=mark)|, ?)"
    r"(?P<c>\d{2,4}|(?:(?<=\d{4}[-/.]\d[-/.])|(?<=\d{4}[-/.]\d{2}[-/.]))\d)"  # 2024/3/5
    r"|(?P<named>[^\W\d]{3,9})\.? (?P<nd>\d{1,2}),? (?P<ny>\d{4})|(?P<ordinal>\d{4}[-/:]?\d{3})|(?P<basic>\d{8}))"
)
TIME = (
    r"(?:(?P<days>\d{1,4})(?:[ /]| ?d(?:ays?)?,? ))?"
    r"(?P<h>\d{1,4}):(?P<m>\d{1,2})(?::(?P<s>\d{1,2})(?::(?P<x>\d{1,3}))?)?"
    r"(?:[.,](?P<f>\d{1,9}))?"
)
BASIC_TIME = r"(?P<bt>\d{4}(?:\d{2})?)(?:[.,](?P<bf>\d{1,9}))?"
HALF = r"(?: ?(?P<half>[AaPp])\.? ?[Mm]\.?)?"
OFFSET = r"(?: ?(?P<zone>[A-Za-z]{1,4})?(?P<offset>[+\u2212-]\d{2}(?::?\d{2})?)?)"
STAMP = re.compile(
    rf"'?(?:[A-Za-z]{{2,9}},? +)?{DATE}(?:(?:[T_-]|,? +|(?<=\d{{3}}):)(?:{TIME}|{BASIC_TIME}){HALF}{OFFSET})?"
)
DOTTED = re.compile(r"(\d{1,2})\.(\d{2})(\.\d{2})?(?:,\d+)?")
"""Time of day with points in place of colons, or a number, or a date."""
OF_DAY = re.compile(rf"'?{TIME}{HALF}{OFFSET}")
CTIME = re.compile(r"([A-Za-z]{3}) +(\d{1,2}) (\d{1,2}:\d{2}:\d{2})( [A-Z]{3,4})? (\d{4})$")
"""The end of a stamp with the year last, `Mon May 13 10:45:00 CEST 2024`."""
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


def clock_of(
    cells: Sequence[str],
    location: str,
    dates: str | None = None,
    unit: str | None = None,
    dates_option: str = "--dates",
) -> Clock | None:
    """Times that the cells of a column state; None where most of them are no clock in any layout that is known.

    location : `file, column x`, for messages
    dates    : order of dates as in ORDERS, where it is stated
    unit     : layout of the time of day as in CLOCKS, where it is stated
    dates_option : what states the order of dates, for messages
    raises   : InputError, one line with a cell and the option that decides, where several layouts fit
    """
    # blanks of no break stand before `a.m.` in stamps of spreadsheets
    plain = (western(cell).replace("\u00a0", " ").replace("\u202f", " ") for cell in cells)
    written, usual = pd.Series(list(cells), dtype=object), (CTIME.sub(r"\1 \2 \5 \3\4", cell) for cell in plain)
    series = pd.Series([DOTTED_AFTER_DATE.sub(r"\1:\2:\3", cell) for cell in usual], dtype=object)
    full = series != ""
    if not full.any():
        return None
    joined = series[full]
    if _are_dotted(joined):
        series = series.map(lambda c: c.replace(".", ":"))
    if joined.map(lambda c: ALL_BASIC.fullmatch(c) is not None).all():
        series = series.map(lambda c: f"{c[:8]}T{c[8:]}" if c else c)
    for pattern in (STAMP, OF_DAY):
        matches = series.map(pattern.fullmatch)
        hit = matches.notna()
        if hit.sum() > 0.5 * full.sum():
            groups, rows = _groups(pattern, matches.where(hit, None)), np.flatnonzero(np.asarray(hit))
            return _clock(_Cells(groups, rows, written, location, dates_option), dates, unit)
    return None


def _groups(pattern: re.Pattern[str], matches: pd.Series) -> dict[str, list[str | None]]:
    """The texts of each group of a pattern; None where it does not match."""
    return {name: [None if m is None else m[name] for m in matches] for name in pattern.groupindex}


def _are_dotted(cells: pd.Series) -> bool:
    """Whether cells are times of day with points for colons: three numbers that are dates in no order."""
    matches = list(map(DOTTED.fullmatch, cells))
    if not all(match and match[3] for match in matches):
        return False
    first, second = (max(int(match[k]) for match in matches if match) for k in (1, 2))
    return first < 24 and second < 60 and second > (31 if first <= 12 else 12)


class _Cells(NamedTuple):
    """Cells of a column in which a pattern finds a time.

    groups   : group of the pattern -> its text in each cell; None where the cell has none
    rows     : those whose cells match
    texts    : of all cells, as the file has them;  location : `file, column x`, for messages
    dates_option : what states the order of dates, for messages
    """

    groups: dict[str, list[str | None]]
    rows: np.ndarray
    texts: pd.Series
    location: str
    dates_option: str

    def strings(self, group: str) -> list[str]:
        """Text of a group in each row; empty where there is none."""
        return [self.groups[group][i] or "" for i in self.rows]

    def numbers(self, group: str) -> FloatArray:
        """Number of a group in each row; 0 where there is none."""
        return np.array([float(text or 0.0) for text in self.strings(group)])

    def fractions(self, group: str) -> FloatArray:
        """Decimals that a group holds, as a number below 1."""
        return np.array([float(f"0.{text or 0}") for text in self.strings(group)])

    def is_there(self, group: str) -> list[bool]:
        """Whether each row has a group, which may be empty."""
        return [self.groups[group][i] is not None for i in self.rows]

    @property
    def have_dates(self) -> bool:
        """Whether the pattern is one of dates."""
        return "a" in self.groups

    def problem(self, rule: str, k: int = 0) -> InputError:
        """An error about the cell of the row number k of `rows`."""
        return InputError(f"{self.location}: `{self.texts[self.rows[k]]}` {rule}")


class _Fields(NamedTuple):
    """Numbers of times of day, (row,) each: days, hours, minutes, seconds, fraction of a second."""

    days: FloatArray
    hours: FloatArray
    minutes: FloatArray
    seconds: FloatArray
    fraction: FloatArray


def _clock(cells: _Cells, dates: str | None, unit: str | None) -> Clock:
    rows = cells.rows
    time_s, has_time, layout = _time_of_day(cells, unit)
    seconds = np.full(len(cells.texts), np.nan)
    offset_s, zoned = _offsets(cells)
    if not cells.have_dates:
        if np.any(np.diff(offset_s) != 0.0):
            time_s = time_s - offset_s
        seconds[rows] = time_s
        return Clock(seconds, None, True, layout)
    day, order = _days(cells, time_s - offset_s, dates)
    first = float(day[0])
    seconds[rows] = (day - first) * DAY_S + time_s - (offset_s if zoned else 0.0)
    return Clock(seconds, first * DAY_S, has_time, f"dates {order}{', ' + layout if has_time else ''}")


def _time_of_day(cells: _Cells, unit: str | None) -> tuple[FloatArray, bool, str]:
    """Seconds of the day, whether there are any, and their layout in words."""
    if "bt" in cells.groups and any(cells.strings("bt")):
        texts = [(text or "000000").ljust(6, "0") for text in cells.strings("bt")]
        whole_s = np.array([3600.0 * int(t[:2]) + 60.0 * int(t[2:4]) + int(t[4:6]) for t in texts])
        return whole_s + cells.fractions("bf"), True, "clock hhmmss"
    if not any(cells.strings("h")):
        return np.zeros(len(cells.rows)), False, ""
    _require_one_layout(cells)
    time, layout = _fields(cells, unit)
    leaps = (time.hours == 23.0) & (time.minutes == 59.0) & (time.seconds >= 60.0)
    for wrong, rule in (
        ((time.minutes > 59.0) & (layout != MINUTES), "is no time of day; mend the cell, or state --time-unit mm:ss"),
        (time.seconds >= 61.0, "is no time of day; mend the cell"),
        (leaps, "may be a leap second or midnight; mend the cell, or give --period"),
    ):
        if np.any(wrong):
            raise cells.problem(rule, int(np.argmax(wrong)))
    if any(cells.strings("half")):
        time, layout = time._replace(hours=_hours_of_halves(cells, time.hours)), f"{layout}, AM and PM"
    seconds = time.days * DAY_S + 3600.0 * time.hours + 60.0 * time.minutes + time.seconds + time.fraction
    return seconds, True, layout


def _require_one_layout(cells: _Cells) -> None:
    """raises : InputError where some times have a third or a fourth number and others have none"""
    for group in ("s", "x"):
        is_there = cells.is_there(group)
        if True in is_there and False in is_there:
            mixed = is_there.index(not is_there[0])
            rule = f"has another layout than `{cells.texts[cells.rows[0]]}`; one file has one layout of its clock"
            raise cells.problem(rule, mixed)


def _fields(cells: _Cells, unit: str | None) -> tuple[_Fields, str]:
    """Numbers of the times, and their layout in words."""
    days, hours, minutes, seconds = (cells.numbers(group) for group in ("days", "h", "m", "s"))
    time = _Fields(days, hours, minutes, seconds, cells.fractions("f"))
    if cells.is_there("x")[0]:
        return _of_four_numbers(cells, unit, time)
    return (time, "clock hh:mm:ss") if cells.is_there("s")[0] else _of_two_numbers(cells, unit, time)


def _of_four_numbers(cells: _Cells, unit: str | None, time: _Fields) -> tuple[_Fields, str]:
    """Times of four numbers, which end in milliseconds or begin with days."""
    last, digits = cells.numbers("x"), {*map(len, cells.strings("x"))}
    is_ms = unit == "hh:mm:ss:ms" or (unit != "dd:hh:mm:ss" and (3 in digits or last.max() > 59.0))
    if is_ms:
        return time._replace(fraction=last / 1000.0), "clock hh:mm:ss:ms"
    counts_days = any(cells.strings("f")) or any(len(text) == 3 for text in cells.strings("h"))
    if unit == "dd:hh:mm:ss" or (not cells.have_dates and counts_days):
        return _Fields(time.hours, time.minutes, time.seconds, last, time.fraction), "clock dd:hh:mm:ss"
    rule = "may be hh:mm:ss:ms or dd:hh:mm:ss; state --time-unit hh:mm:ss:ms or --time-unit dd:hh:mm:ss"
    raise cells.problem(rule)


def _of_two_numbers(cells: _Cells, unit: str | None, time: _Fields) -> tuple[_Fields, str]:
    """Times of two numbers: hours and minutes, or minutes and seconds."""
    minutes_first = not cells.have_dates and (any(cells.strings("f")) or time.hours.max() > 23.0)
    if unit == "mm:ss" or (unit is None and minutes_first):
        shifted = time._replace(hours=np.zeros(len(time.hours)), minutes=time.hours, seconds=time.minutes)
        return shifted, MINUTES
    if unit == "hh:mm" or cells.have_dates or any(cells.strings("half")):
        return time, "clock hh:mm"
    if unit in (None, *CLOCKS):
        rule = "may be hours and minutes or minutes and seconds; state --time-unit hh:mm or --time-unit mm:ss"
        raise cells.problem(rule)
    return time, "clock hh:mm:ss"


def _hours_of_halves(cells: _Cells, hours: FloatArray) -> FloatArray:
    """Hours of the day from those of AM and PM.

    raises : InputError where an hour is beyond 12, or has neither
    """
    half = np.array([text.lower() for text in cells.strings("half")])
    bad = (hours > 12.0) | (half == "")
    if np.any(bad):
        raise cells.problem("is no time of day with AM or PM; mend the cell", int(np.argmax(bad)))
    return np.where(hours == 12.0, 0.0, hours) + np.where(half == "p", 12.0, 0.0)


def _offsets(cells: _Cells) -> tuple[FloatArray, bool]:
    """Offsets from UTC [s], and whether they are stated."""
    offset_s = np.zeros(len(cells.rows))
    stated = False
    for k, (text, zone) in enumerate(zip(cells.strings("offset"), cells.strings("zone"), strict=True)):
        if text:
            digits = re.sub(r"\D", "", text).ljust(4, "0")
            offset_s[k] = (3600.0 * int(digits[:2]) + 60.0 * int(digits[2:])) * (-1.0 if text[0] != "+" else 1.0)
            stated = True
        elif zone.lower() in ZONES:
            offset_s[k] = 3600.0 * ZONES[zone.lower()]
            stated = True
    return offset_s, stated


def _days(cells: _Cells, time_s: FloatArray, dates: str | None) -> tuple[FloatArray, str]:
    """Days since 1970, and the order of the dates in words."""
    plain = _unambiguous_days(cells)
    if plain is not None:
        return _checked(plain[0], cells), plain[1]
    numbers = _date_numbers(cells)
    orders = _possible_orders(cells, dates)
    days = {order: _day(*(numbers[group] for group in GROUPS_OF_ORDER[order])) for order in orders}
    if len(days) == 1:
        order, day = next(iter(days.items()))
        return _checked(day, cells), ORDERS[order]
    valid = {order: day for order, day in days.items() if not np.any(np.isnan(day))}
    if not valid:
        rule = "has no order of day and month that all dates have; mend the dates"
        raise cells.problem(rule, _odd_date(numbers["a"]))
    distinct = _distinct_orders(valid, time_s)
    if len(distinct) > 1:
        order = _usual_order(cells, valid, distinct, time_s)
        return valid[order], ORDERS[order]
    return valid[distinct[0]], ORDERS[distinct[0]] if len(valid) == 1 else ANY_ORDER


def _months(names: Sequence[str]) -> FloatArray:
    return np.array([float(MONTHS.get(name[:3].lower(), 0)) for name in names])


def _unambiguous_days(cells: _Cells) -> tuple[FloatArray, str] | None:
    """Days since 1970 of dates with names of months, or in eight digits, and their layout in words; else None."""
    first = int(cells.rows[0])
    for group, days in (("basic", _basic_days), ("ordinal", _ordinal_days), ("named", _named_days)):
        if cells.groups[group][first]:
            return days(cells)
    if not (cells.groups["b"][first] or "").isdigit():
        first_number, last_number = cells.numbers("a"), cells.numbers("c")
        year, day = (first_number, last_number) if _is_year(cells, "a") else (last_number, first_number)
        return _day(year, _months(cells.strings("b")), day), "with names of months"
    return None


def _basic_days(cells: _Cells) -> tuple[FloatArray, str]:
    texts = [text or "00000000" for text in cells.strings("basic")]
    return _day(*(np.array([float(t[p]) for t in texts]) for p in DIGITS_OF_BASIC)), "yyyymmdd"


def _ordinal_days(cells: _Cells) -> tuple[FloatArray, str]:
    texts = [text or "0000000" for text in cells.strings("ordinal")]
    year, number = (np.array([float(t[part]) for t in texts]) for part in (slice(4), slice(-3, None)))
    first_day, after = (_day(y, np.ones(len(y)), np.ones(len(y))) for y in (year, year + 1.0))
    return np.where((number >= 1.0) & (number <= after - first_day), first_day + number - 1.0, np.nan), "yyyy-ddd"


def _named_days(cells: _Cells) -> tuple[FloatArray, str]:
    year, day = cells.numbers("ny"), cells.numbers("nd")
    return _day(year, _months(cells.strings("named")), day), "with names of months"


def _is_year(cells: _Cells, group: str) -> bool:
    return any(len(text) > 2 for text in cells.strings(group))


def _date_numbers(cells: _Cells) -> dict[str, FloatArray]:
    """The three numbers of dates, by group; NaN where the second is none."""
    middle = np.array([float(text) if text.isdigit() else np.nan for text in cells.strings("b")])
    return {"a": cells.numbers("a"), "b": middle, "c": cells.numbers("c")}


def _possible_orders(cells: _Cells, dates: str | None) -> list[str]:
    """Orders that dates of three numbers may have: by a year of four digits, a point between them, or as stated.

    dates  : order that is stated; None where none is
    raises : InputError where that is impossible
    """
    year_first = _is_year(cells, "a")
    orders = ["year-first"] if year_first else ["day-first", "month-first"]
    if not year_first and not _is_year(cells, "c"):
        orders.insert(0, "year-first")
    if cells.groups["mark"][int(cells.rows[0])] == "." and not year_first:
        orders = ["day-first"]
    if dates is not None and dates not in orders:
        raise cells.problem(f"is not a date with the {ORDERS[dates]}; correct {cells.dates_option}")
    return orders if dates is None else [dates]


def _distinct_orders(valid: dict[str, FloatArray], time_s: FloatArray) -> list[str]:
    """Orders between which the times tell; those of equal times, as where all rows are of one day, count as one."""
    distinct: dict[str, FloatArray] = {}
    for order, day in valid.items():
        span = (day - day[0]) * DAY_S + time_s
        if not any(np.array_equal(span, other) for other in distinct.values()):
            distinct[order] = span
    return list(distinct)


def _usual_order(cells: _Cells, valid: dict[str, FloatArray], distinct: list[str], time_s: FloatArray) -> str:
    """The order whose times go on as those of a recorder do.

    raises : InputError where several do, or none
    """
    steps = {o: np.diff(valid[o] * DAY_S + time_s) for o in distinct}
    usual = [o for o, step in steps.items() if np.all(step > -DAY_S / 24.0) and np.all(step <= LONGEST_STEP_S)]
    if len(usual) != 1:
        options = " or ".join(f"--dates {o}" for o in distinct)
        raise cells.problem(f"may be read with the {ORDERS[distinct[0]]} or not; state {options}")
    return usual[0]


def _odd_date(first_number: FloatArray) -> int:
    """Row number of a date that contradicts the order of the first one."""
    odd = np.flatnonzero((first_number > 12.0) != (first_number[0] > 12.0))
    return int(odd[0]) if len(odd) else 0


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


def _checked(day: FloatArray, cells: _Cells) -> FloatArray:
    bad = np.flatnonzero(np.isnan(day))
    if len(bad):
        raise cells.problem("is no date; mend the cell, or state --dates", int(bad[0]))
    return day


def with_colons(cells: Sequence[str], layout: str) -> list[str]:
    """Times of day with their colons: of hhmmss, such as 94502 or 104500.5, or of another layout with points, such as
    10.45. Other cells stay as they are."""
    if layout != "hhmmss":
        return [cell.replace(".", ":") if DOTTED.fullmatch(cell) else cell for cell in cells]
    written = []
    for cell in cells:
        match = re.fullmatch(r"(\d{1,6})([.,]\d+)?", cell)
        padded = match[1].zfill(6) if match else ""
        written.append(f"{padded[:2]}:{padded[2:4]}:{padded[4:]}{match[2] or ''}" if match else cell)
    return written


def possible_clock(values: FloatArray) -> str:
    """Layout of times of day, hhmmss or hh:mm, that numbers may be: all are such times, and their last two digits stop
    at 59 where steps go on. Empty where there is none."""
    hundredths = np.round(100.0 * values, 6)
    for layout, numbers, least, end in (("hhmmss", values, 1e4, 24e4), ("hh:mm", hundredths, 0.0, 2400.0)):
        minutes, last = numbers // 100.0 % 100.0, numbers % 100.0
        are_times = np.all((numbers >= 0.0) & (numbers < end) & (minutes < 60.0) & (last < 60.0))
        if not are_times or numbers.max() < least or (layout == "hh:mm" and np.any(last % 1.0)):
            continue
        read, steps = np.diff(3600.0 * (numbers // 1e4) + 60.0 * minutes + last), np.diff(numbers)
        if np.any(steps != read) and np.ptp(read) < np.ptp(steps):
            return layout
    return ""


def over_midnight(clock: Clock) -> tuple[FloatArray, str]:
    """Times of a clock without a date [s], with a day added at each midnight; and a note, empty where there is none.

    A step back of more than half a day is a midnight. Minutes and seconds, as spreadsheets show them, begin anew with
    each hour: a step back of more than half an hour is one.
    """
    seconds = clock.seconds
    unwrapped = seconds.copy()
    finite = np.flatnonzero(np.isfinite(seconds))
    has_no_hours = clock.layout == MINUTES and bool(np.all(seconds[finite] < HOUR_S))
    period = HOUR_S if has_no_hours else DAY_S
    wraps = np.concatenate(([0], np.cumsum(np.diff(seconds[finite]) < -0.5 * period)))
    unwrapped[finite] += period * wraps
    passed, added = ("the hour", "an hour") if has_no_hours else ("midnight", "a day")
    often = "once: {} is added there" if wraps[-1] == 1 else f"{wraps[-1]} times: {{}} is added at each"
    return unwrapped, f"passes {passed} {often.format(added)}" if wraps[-1] else ""
