"""From fields of a message to frames and readings: names, units and recorder words as the link file declares them.

    value = factor field + offset                     by the units (sim_heating.heating.recorded.fields)
    rho   = 2 q / V^2                                 where a link has `q_Pa` in place of `rho_kg_m3`
    T     = c0 + c1 w + c2 w^2 + ...                  of a word w with a calibration, then by its unit
    T     = low + w LSB                               of a code w of a recorder that declares bits and range_K

A reading is one of the time by its clock, less the skew of that clock where the link declares one. A message with all
columns of flight conditions is a frame at once. Columns that come in several messages of one time
are gathered; where a later time comes first, the columns that are absent have their latest values.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

from sim_heating.base.errors import InputError
from sim_heating.base.files import COLDEST_K, celsius_rule, display_path, raise_problems, suggestion
from sim_heating.base.files.text import abbreviated
from sim_heating.base.files.units import Conversion
from sim_heating.base.limits import HOTTEST_K, LIMITS
from sim_heating.base.parameters import CLOCK_SKEW
from sim_heating.heating.recorded.fields import ConditionField, column_unit, unit_conversion, unit_of_name
from sim_heating.live.spec import Link, SensorField
from sim_heating.live.types import Frame, Message, Reading, Sample
from sim_heating.thermal.stack import Sensor

GRACE_MESSAGES = 50
"""Messages after which a field that never came is reported."""


def default_fields(sensors: Sequence[tuple[str, str, str]]) -> dict[tuple[str, str], str]:
    """Field of each sensor that has no entry in a link: its column, or POINT.COLUMN where several have that column.

    sensors : control point, name and column of each
    returns : by control point and name
    """
    columns = [column for _, _, column in sensors]
    return {
        (point, name): column if columns.count(column) == 1 else f"{point}.{column}" for point, name, column in sensors
    }


@dataclass(frozen=True)
class _Column:
    column: str
    field: str
    convert: Conversion
    low: float
    high: float
    rule: str


@dataclass(frozen=True)
class _Word:
    """A sensor's field: what makes a temperature of it."""

    point: str
    sensor: Sensor
    field: str
    time: str | None
    convert: Conversion
    calibration: tuple[float, ...] = ()
    codes: int = 0
    is_declared: bool = True

    def temperature_K(self, word: float) -> float:
        if self.codes:
            if not (0.0 <= word < self.codes and word == math.floor(word)):
                raise InputError(f"`{self.field}`: {word:g} is not a code of a recorder, 0 to {self.codes - 1}")
            assert self.sensor.range_K is not None
            return self.sensor.range_K[0] + word * self.sensor.lsb_K
        value = self.convert(_polynomial(self.calibration, word) if self.calibration else word)
        if value > HOTTEST_K:
            raise InputError(f"`{self.field}`: {value:g} K is not a temperature")
        if self.sensor.calibration is None and value < COLDEST_K:
            raise InputError(f"`{self.field}`: {value:g} K {celsius_rule()}")
        if self.sensor.bits is not None and self.sensor.range_K is not None:
            low, high = self.sensor.range_K
            if not low - self.sensor.lsb_K <= value <= high + self.sensor.lsb_K:
                raise InputError(f"`{self.field}`: {value:g} K is outside the recorder's {low:g} to {high:g} K")
        return value


def _polynomial(coefficients: Sequence[float], x: float) -> float:
    """c0 + c1 x + c2 x^2 + ... by Horner's rule."""
    value = 0.0
    for c in reversed(coefficients):
        value = value * x + c
    return value


@dataclass
class _Gathered:
    """Columns of one time that came in several messages."""

    time_s: float
    values: dict[str, float] = field(default_factory=dict)


class FieldMapping:
    """The mapping of a link.

    raises : InputError with one line a problem: units that do not fit, sensors that do not exist

    `apply(message)` gives the samples of a message; a part of it that cannot be used is reported to `remark`.
    """

    def __init__(self, link: Link) -> None:
        self.link = link
        declared, place = link.declared, display_path(link.path)
        self._time = declared.time.field
        self._seconds = unit_conversion(declared.time.unit, "s", f"{place}, [time]: `unit`")
        self._zero = declared.time.zero
        self._skew_s = clock_skew_s(link)
        # what a record has and no field gives is as it was at the start, as the pressure at a wall at rest
        first = next((link.records[name] for name in link.names if link.records), None)
        flown = {} if first is None else first.conditions.columns
        self._constants = {n: float(v[0]) for n, v in flown.items() if n not in ("time_s", *link.columns)} | {
            name: value.constant
            for name, value in declared.conditions.items()
            if isinstance(value, ConditionField) and value.constant is not None
        }
        self._columns, of_columns = _columns(link, place)
        self._words, of_words = _words(link, place)
        raise_problems([*of_columns, *of_words])
        self._latest: dict[str, float] = {}
        self._open: _Gathered | None = None
        self._seen: set[str] = set()
        self._sent: dict[str, None] = {}
        self._messages = 0

    @property
    def fields(self) -> dict[str, str]:
        """Field that the link needs or names -> what it is; a sensor that it does not name may be absent."""
        found = {self._time: "time"} | {c.field: c.column for c in self._columns}
        return found | {w.field: f"sensor {w.sensor.name} of {w.point}" for w in self._words if w.is_declared}

    def apply(self, message: Message, remark: Callable[[str], None] | None = None) -> list[Sample]:
        """Frames and readings of a message, in SI units.

        remark : called with one line for each part that cannot be used
        raises : InputError with one line where nothing of the message can be used
        """
        if message.damaged:
            raise InputError(message.damaged)
        values = message.values
        self._note(values)
        time_s = self._time_of(values, self._time)
        samples: list[Sample] = []
        problems: list[str] = []
        for make in (self._frames, self._readings):
            made, wrong = make(values, time_s)
            samples += made
            problems += wrong
        if problems and not samples:
            raise InputError(*problems)
        for line in problems:
            if remark is not None:
                remark(line)
        return samples

    def never_sent(self) -> list[str]:
        """One line for each mapped field that none of the first messages had; once, and empty before that many came."""
        if self._messages < GRACE_MESSAGES:
            return []
        return [
            f"field `{name}` ({what}) is not sent{suggestion(name, self._sent, otherwise='')}"
            for name, what in self.fields.items()
            if name not in self._seen
        ]

    def check_sent(self, names: Sequence[str], source: str) -> None:
        """Refuse a mapping of fields that a source does not send, where what it sends is known beforehand.

        names  : fields that are sent
        source : name of the source, for the message
        raises : InputError with one line a field
        """
        raise_problems(
            [
                f"{display_path(self.link.path)}: field `{name}` ({what}) is not sent by {source}"
                f"{suggestion(name, names)}"
                for name, what in self.fields.items()
                if name not in names
            ]
        )

    def _note(self, values: Mapping[str, float | str]) -> None:
        self._messages += 1
        if self._messages <= GRACE_MESSAGES:
            self._sent |= dict.fromkeys(values)
            self._seen |= set(self._sent) & set(self.fields)

    def _time_of(self, values: Mapping[str, float | str], name: str) -> float:
        if name not in values:
            raise InputError(f"time field `{name}` is missing; the message has {_names(values)}")
        return self._seconds(_number(values[name], name) - self._zero)

    def _frames(self, values: Mapping[str, float | str], time_s: float) -> tuple[list[Frame], list[str]]:
        given: dict[str, float] = {}
        for c in self._columns:
            if c.field not in values:
                continue
            try:
                value = c.convert(_number(values[c.field], c.field))
            except InputError as error:
                return [], [f"{error}; no frame at {time_s:g} s"]
            if not c.low <= value <= c.high:
                return [], [f"field `{c.field}`: {value:g} {c.rule}; no frame at {time_s:g} s"]
            given[c.column] = value
        if not given and self._columns:
            return [], []
        try:
            whole = len(given) == len(self._columns)
            return [self._frame(time_s, given)] if whole else self._gather(time_s, given), []
        except InputError as error:
            self._open = None
            return [], list(error.problems)

    def _gather(self, time_s: float, given: dict[str, float]) -> list[Frame]:
        """Frames of columns that come in several messages."""
        frames: list[Frame] = []
        waiting = self._open
        if waiting is not None and waiting.time_s != time_s:
            known = self._latest | waiting.values
            if len(known) == len(self._columns):
                frames.append(self._frame(waiting.time_s, known))
            waiting = None
        if waiting is None:
            waiting = _Gathered(time_s)
        waiting.values |= given
        self._latest |= given
        self._open = waiting
        if len(waiting.values) == len(self._columns):
            frames.append(self._frame(time_s, waiting.values))
            self._open = None
        return frames

    def _frame(self, time_s: float, given: Mapping[str, float]) -> Frame:
        """A frame; its density is 2 q / V^2 where the link has `q_Pa` and no `rho_kg_m3`.

        raises : InputError where that is none, at a speed or a dynamic pressure of 0
        """
        values = {**given, **self._constants}
        if "q_Pa" in given and "rho_kg_m3" not in values:
            V, q = values["velocity_m_s"], values["q_Pa"]
            if V <= 0.0 or q <= 0.0:
                raise InputError(f"q_Pa = {q:g} at {V:g} m/s gives no density; no frame at {time_s:g} s")
            values["rho_kg_m3"] = 2.0 * q / V**2
        return Frame(time_s, values)

    def _readings(self, values: Mapping[str, float | str], time_s: float) -> tuple[list[Reading], list[str]]:
        readings: list[Reading] = []
        problems: list[str] = []
        for w in self._words:
            if w.field not in values:
                continue
            try:
                at_s = time_s if w.time is None else self._time_of(values, w.time)
                word = _word(values[w.field], w.field)
                T = word if math.isnan(word) else w.temperature_K(word)
            except InputError as error:
                problems += error.problems
                continue
            readings.append(Reading(at_s - self._skew_s, w.point, w.sensor.name, T))
        return readings, problems


def clock_skew_s(link: Link) -> float:
    """By how much the clock of the thermocouples is known to lag behind that of the conditions [s].

    `clock.skew` in `fix`, or the mean of its prior where it is estimated: readings are put where they belong by it.
    """
    own = link.declared.estimate
    mean, _ = own.prior.get(CLOCK_SKEW.name, (CLOCK_SKEW.value, CLOCK_SKEW.sigma))
    return own.fix.get(CLOCK_SKEW.name, mean if CLOCK_SKEW.name in (own.parameters or ()) else 0.0)


def _names(values: Mapping[str, object]) -> str:
    return abbreviated(", ".join(values)) if values else "no field"


def _number(value: float | str, name: str) -> float:
    try:
        number = float(value)
    except (TypeError, ValueError):
        raise InputError(f"field `{name}`: {abbreviated(str(value))} is not a number") from None
    if not math.isfinite(number):
        raise InputError(f"field `{name}`: {number} is not a finite number")
    return number


def _word(value: float | str, name: str) -> float:
    """A sensor's word; NaN where the sample is lost: an empty text, or not a number by its own account."""
    if isinstance(value, str) and value.strip().lower() in ("", "nan", "null"):
        return math.nan
    if isinstance(value, float) and math.isnan(value):
        return math.nan
    return _number(value, name)


def _columns(link: Link, place: str) -> tuple[list[_Column], list[str]]:
    """The columns that come in fields, and problems of their units."""
    columns: list[_Column] = []
    problems: list[str] = []
    for name in link.columns:
        declared = link.declared.conditions.get(name, name)
        if isinstance(declared, ConditionField):
            if declared.field is None:
                continue
            source, unit = declared.field, declared.unit
        else:
            source, unit = declared, None
        own = column_unit(name)
        unit = unit_of_name(source, name) if unit is None and source != name else unit
        try:
            convert = unit_conversion(own if unit is None else unit, own, f"{place}, [conditions]: `{name}`")
        except InputError as error:
            problems += error.problems
            continue
        low, high, rule = LIMITS.get(name, (-math.inf, math.inf, ""))
        columns.append(_Column(name, source, convert, low, high, rule))
    return columns, problems


def _words(link: Link, place: str) -> tuple[list[_Word], list[str]]:
    """The sensors' fields, and problems of their names and units."""
    words: dict[tuple[str, str], _Word] = {}
    problems: list[str] = []
    for i, declared in enumerate(link.declared.sensor, start=1):
        where = f"{place}, [[sensor]] {i}"
        try:
            word = _declared_word(link, declared, where)
        except InputError as error:
            problems += error.problems
            continue
        if (word.point, word.sensor.name) in words:
            problems.append(f"{where}: `sensor`: {declared.sensor} is repeated; remove one")
        words[word.point, word.sensor.name] = word
    fields = default_fields([(p.name, s.name, s.column) for p in link.points for s in p.sensors])
    for point in link.points:
        for sensor in point.sensors:
            key = point.name, sensor.name
            words.setdefault(key, _Word(point.name, sensor, fields[key], None, Conversion(1.0, 0.0), is_declared=False))
    return list(words.values()), problems


def _declared_word(link: Link, declared: SensorField, where: str) -> _Word:
    found = [
        (point, sensor)
        for point in link.points
        for sensor in point.sensors
        if sensor.name == declared.sensor and declared.control_point in (None, point.name)
    ]
    if not found:
        known = [s.name for p in link.points for s in p.sensors]
        raise InputError(f"{where}: `sensor`: unknown sensor `{declared.sensor}`{suggestion(declared.sensor, known)}")
    if len(found) > 1:
        owners = ", ".join(point.name for point, _ in found)
        raise InputError(f"{where}: {owners} have a sensor {declared.sensor}; add `control_point`")
    point, sensor = found[0]
    if declared.codes and (sensor.bits is None or sensor.range_K is None):
        raise InputError(
            f"{where}: `codes`: {declared.sensor} declares no recorder; add `bits` and `range_K` to its declaration, "
            "or give `calibration`"
        )
    codes = 2**sensor.bits if declared.codes and sensor.bits is not None else 0
    convert = unit_conversion(declared.unit, "K", f"{where}: `unit`")
    calibration = tuple(declared.calibration or ())
    return _Word(point.name, sensor, declared.field, declared.time, convert, calibration, codes)
