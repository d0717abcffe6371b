"""From fields of a message to frames and readings: names, units and recorder words as the link file declares them.

    value = factor field + offset                     by the units (sim_heating.heating.recorded.fields)
    rho, T, p, M, log10 Re, p of the surface          of columns that no field has (sim_heating.heating.recorded.derive)
    T     = c0 + c1 w + c2 w^2 + ...                  of a word w with a calibration, then by its unit
    T     = low + w LSB                               of a code w of a recorder that declares bits and range_K

A reading is one of the time by its clock, less the skew of that clock where the link declares one. A message with all
columns of flight conditions is a frame at once. Columns that come in several messages of one time
are gathered; where a later time comes first, the columns that are absent have their latest values.

A column without an entry in the link is the field of its own name, else the one field that is it by its name and unit;
`Time` of JSBSim's own output is in s.
One that does not come within the first seconds is derived from those that do, as in files, and that is reported. What
is sent is never replaced: where the field comes after all, it is used from then on.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from sim_heating.base.conditions import ACCOMPANYING, SURFACES
from sim_heating.base.errors import InputError
from sim_heating.base.files import COLDEST_K, celsius_rule, display_path, raise_problems, suggestion
from sim_heating.base.files.text import abbreviated
from sim_heating.base.files.units import Conversion
from sim_heating.base.limits import HOTTEST_K, LIMITS
from sim_heating.base.parameters import CLOCK_SKEW
from sim_heating.heating.recorded.derive import DerivedConditions, derived_conditions
from sim_heating.heating.recorded.fields import (
    ConditionField,
    FlightField,
    column_unit,
    field_of_name,
    unit_conversion,
    unit_of_name,
)
from sim_heating.heating.recorded.layout import declared_constants
from sim_heating.heating.recorded.plausible import implied_length_m
from sim_heating.heating.recorded.reading import implied_pressure, local_pressure, with_pressure
from sim_heating.heating.surface_pressure import PressureModel
from sim_heating.inputs.record import Record
from sim_heating.live.spec import Link, LinkPoint, SensorField
from sim_heating.live.types import TIME, Frame, Message, Reading, Sample
from sim_heating.thermal.stack import Sensor

GRACE_MESSAGES = 50
"""Messages after which a field that never came is reported."""
ABSENT_AFTER_S, ABSENT_TIMES = 2.0, 3
"""Flight time [s], and number of times with conditions, after which a column that did not come is absent."""
HELD = ("beta_deg", *SURFACES, "jets")
"""Columns that are as in the whole record, where they change there nowhere and are not sent."""
JSBSIM_TIME = "Time"
"""Label of the time [s] in JSBSim's own output, which states no unit."""
SOURCES = ("q_Pa", "qbar_Pa", "p_inf_Pa", "T_inf_K", "mach", "velocity_m_s", "altitude_m", "rho_kg_m3")
"""Columns from which others follow, also where a frame does not need them."""


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
            return self._decoded_K(word)
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

    def _decoded_K(self, word: float) -> float:
        if not (0.0 <= word < self.codes and word == math.floor(word)):
            raise InputError(f"`{self.field}`: {word:g} is not a code of a recorder, 0 to {self.codes - 1}")
        assert self.sensor.range_K is not None
        return self.sensor.range_K[0] + word * self.sensor.lsb_K


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


def _first_record(link: Link) -> Record | None:
    """The record of the first point; None for a link on a vehicle."""
    return link.records[link.names[0]] if link.records else None


def _require_density(q_Pa: float, speed_m_s: float) -> None:
    if speed_m_s <= 0.0 or q_Pa <= 0.0:
        raise InputError(f"q_Pa = {q_Pa:g} at {speed_m_s:g} m/s gives no density")


class ConditionFields:
    """Which fields of a link are flight conditions, and which columns follow from them.

    named    : fields that are the time, or of a sensor
    problems : one line for each unit of the link file that does not fit
    notes    : one line for each field that was found by its name, and for what is derived, not yet taken
    """

    def __init__(self, link: Link, named: Collection[str], constants: dict[str, float]) -> None:
        columns, self.problems = _columns(link, display_path(link.path))
        self.notes: list[str] = []
        self.is_settled = False
        self.has_model_density = False
        self._read = {c.column: c for c in columns}
        self._own = frozenset(self._read) - set(link.declared.conditions)
        self._needed = tuple(n for n in self._read if n not in self._own.intersection(ACCOMPANYING))
        self._sources: tuple[str, ...] = ()
        self._taken, self._constants = frozenset(named), constants
        has_only_q = "q_Pa" in self._read and "rho_kg_m3" not in {*self._read, *constants}
        self._derived: tuple[str, ...] = ("rho_kg_m3",) if has_only_q else ()
        self._seen: set[str] = set()
        self._length_m: float | None = None
        self._pressure, self._of_record = None, dict[str, float]()
        if (record := _first_record(link)) is not None:
            flown = record.conditions.columns
            self._length_m, self._pressure = implied_length_m(flown), _pressure_of(record)
            self._of_record = {n: float(flown[n][0]) for n in HELD if n in flown and np.ptp(flown[n]) == 0.0}

    @property
    def fields(self) -> dict[str, str]:
        """Field that has to come -> its column."""
        return {self._read[name].field: name for name in self._needed if name not in self._derived}

    @property
    def is_of_model(self) -> bool:
        """Whether the density of a frame is now of the standard atmosphere; `has_model_density`, whether one was."""
        return self.has_model_density and "rho_kg_m3" in self._derived

    def see(self, names: Collection[str]) -> None:
        """Take the names of fields that are sent: what comes by itself is no longer derived.

        A field of a column's own name prevails over one that is it by another name and its unit.
        """
        if self._seen.issuperset(names):
            return
        for name in [n for n in names if n not in {*self._seen, *self._taken}]:
            declared = FlightField(name, name, column_unit(name), Conversion(1.0, 0.0))
            flight_field = declared if name in self._own else field_of_name(name)
            if flight_field is None or flight_field.unit is None:
                continue
            if flight_field.column in self._own or self._may_give(flight_field):
                self._use(flight_field)
        self._seen |= set(names)

    def _may_give(self, flight_field: FlightField) -> bool:
        is_open = not self.is_settled and flight_field.column not in {*self._read, *self._constants}
        return flight_field.column in SOURCES and is_open

    def _use(self, flight_field: FlightField) -> None:
        name, column = flight_field.name, flight_field.column
        before = None if name == column else self._read.get(column)
        if before is not None and (before.field != column or column in self._seen):
            self.notes.append(
                f"`{name}` may be {column} as well as `{before.field}`, which is used; name one in [conditions]"
            )
            return
        self._read[column] = _Column(column, name, flight_field.convert, *_limits(column))
        if name != column and column in self._needed:
            self.notes.append(f"{column} from `{name}`, in {flight_field.unit or '1'}")
        if column in self._derived:
            self._derived = tuple(n for n in self._derived if n != column)
            self.notes.append(f"`{name}` is sent: {column} is no longer derived")

    def values(self, message: Mapping[str, float | str]) -> dict[str, float]:
        """Columns that a message has, in the unit that the name ends in.

        raises : InputError for a value that is no number, or cannot be
        """
        columns: dict[str, float] = {}
        for c in self._read.values():
            if c.field in message:
                value = c.convert(_number(message[c.field], c.field))
                if not c.low <= value <= c.high:
                    raise InputError(f"field `{c.field}`: {value:g} {c.rule}")
                columns[c.column] = value
        return columns

    def has_all(self, columns: Collection[str]) -> bool:
        """Whether columns are all that a frame is made of, those that follow from others left out."""
        return all(name in columns for name in (*self._needed, *self._sources) if name not in self._derived)

    def settle(self, latest: Mapping[str, float]) -> bool:
        """Take columns that have not come for absent; whether what is absent follows from what is there.

        latest : column -> latest value of those that came
        """
        if self.is_settled:
            return True
        absent = [name for name in self._needed if name not in latest]
        derived = self._follow(latest, absent)
        if not set(absent) <= set(derived.columns):
            return False
        self.is_settled, self._derived = True, tuple(dict.fromkeys((*self._derived, *absent)))
        if absent:
            self._note_absent(absent, derived, latest)
        kept = {*self._needed, *self._sources, *ACCOMPANYING}
        self._read = {n: c for n, c in self._read.items() if n in kept}
        return True

    def _note_absent(self, absent: Sequence[str], derived: DerivedConditions, latest: Mapping[str, float]) -> None:
        """Keep what absent columns follow from, and say how they do."""
        self._sources = tuple(n for n in self._read if n not in self._needed and n in latest and n in SOURCES)
        stated = {"rho_kg_m3", "q_Pa", "qbar_Pa"} & set(latest)
        self.has_model_density = bool(derived.of_model) and not stated
        grade = "; confidence of the conditions C" if self.has_model_density else ""
        self.notes.append(f"{', '.join(absent)} not sent: {'; '.join(derived.notes)}{grade}")

    def complete(self, latest: Mapping[str, float]) -> dict[str, float]:
        """All columns of a frame: those that came, constants, and those that follow.

        raises : InputError where a column does not follow, as a density at a speed of 0
        """
        used = {*self._needed, "q_Pa", *(self._own & {*ACCOMPANYING})}
        values = {n: v for n, v in latest.items() if n in used} | self._constants
        if not self._derived:
            return values
        if "rho_kg_m3" in self._derived and "q_Pa" in values:
            _require_density(values["q_Pa"], values.get("velocity_m_s", 1.0))
        derived = self._follow(latest, self._derived).columns
        if lacking := [name for name in self._derived if name not in derived]:
            raise InputError(f"{', '.join(lacking)} does not follow from what is sent")
        return values | {name: float(derived[name][0]) for name in self._derived}

    def lacking(self, names: Collection[str]) -> dict[str, str]:
        """Field -> column of those that do not come among the fields that are sent, and do not follow from them."""
        self.see(names)
        there = {n: 1.0 for n, c in self._read.items() if c.field in names}
        absent = [n for n in self._needed if n not in there]
        derived = self._follow(there, absent)
        return {field: n for field, n in self.fields.items() if n in absent and n not in derived.columns}

    def without_unit(self, column: str) -> str:
        """A field that is a column by its name, and states no unit; empty where none is."""
        for name in self._seen - self._taken:
            flight_field = field_of_name(name) if name != column else None
            if flight_field is not None and flight_field.column == column and flight_field.unit is None:
                return name
        return ""

    def _follow(self, latest: Mapping[str, float], names: Collection[str]) -> DerivedConditions:
        """The columns of one time with those that follow from them, as of a row of a file."""
        constant = {n: v for n, v in self._of_record.items() if n in names}
        row = {name: np.array([value]) for name, value in {**constant, **latest, **self._constants}.items()}
        derived = derived_conditions(row, length_m=self._length_m, requested={*names, "rho_kg_m3"})
        columns, of_pressure = with_pressure(derived.columns, names, self._pressure)
        of_record = [f"{', '.join(constant)} as in the whole record"] if constant else []
        return DerivedConditions(columns, (*of_record, *derived.notes, *of_pressure), derived.of_model)


def _times_of(names: Iterable[str]) -> list[FlightField]:
    """The fields that are a time by their names, with or without a unit."""
    return [f for n in names if (f := field_of_name(n)) is not None and f.column == TIME]


class FieldMapping:
    """The mapping of a link.

    raises : InputError with one line a problem: units that do not fit, sensors that do not exist

    `apply(message)` gives the samples of a message; a part of it that cannot be used is reported to `remark`.
    """

    def __init__(self, link: Link) -> None:
        self.link = link
        declared, file = link.declared, display_path(link.path)
        self._time = declared.time.field
        self._seconds = unit_conversion(declared.time.unit, "s", f"{file}, [time]: `unit`")
        self._zero = declared.time.zero
        self._skew_s = clock_skew_s(link)
        # what a record has and no field gives is as it was at the start, as the pressure at a wall at rest
        first = _first_record(link)
        flown = {} if first is None else first.conditions.columns
        constants = {n: float(v[0]) for n, v in flown.items() if n not in ("time_s", *link.columns)}
        constants |= declared_constants(declared.conditions)
        self._words, of_words = _words(link, file)
        clocks = [w.time for w in self._words if w.time is not None]
        named = {self._time, *clocks, *(w.field for w in self._words)}
        self._conditions = ConditionFields(link, named, constants)
        raise_problems([*self._conditions.problems, *of_words])
        self._latest: dict[str, float] = {}
        self._open: _Gathered | None = None
        self._held: list[_Gathered] = []
        self._times, self._first_s = 0, math.nan
        self._seen: set[str] = set()
        self._sent: dict[str, None] = {}
        self._messages = 0

    @property
    def fields(self) -> dict[str, str]:
        """Field that the link needs or names -> what it is; a sensor that it does not name may be absent."""
        fields = {self._time: "time"} | self._conditions.fields
        return fields | {w.field: f"sensor {w.sensor.name} of {w.point}" for w in self._words if w.is_declared}

    @property
    def has_model_density(self) -> bool:
        """Whether the density is of the standard atmosphere, and not of the day."""
        return self._conditions.has_model_density

    def take_notes(self) -> list[str]:
        """One line for each field that was found by its name, and for columns that are derived, since the last call."""
        notes, self._conditions.notes = self._conditions.notes, []
        return notes

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
            new, wrong = make(values, time_s)
            samples += new
            problems += wrong
        if problems and not samples:
            raise InputError(*problems)
        for line in problems:
            if remark is not None:
                remark(line)
        return samples

    def never_sent(self) -> list[str]:
        """One line for each mapped field that none of the first messages had; once, and empty before that many came."""
        if self._messages < GRACE_MESSAGES or self._held:
            return []
        lacking = self._conditions.lacking(self._sent)
        return [
            f"field `{name}` ({meaning}) is not sent{self._hint(name, meaning)}"
            for name, meaning in self.fields.items()
            if name not in self._seen and (name in lacking or name not in self._conditions.fields)
        ]

    def _hint(self, name: str, meaning: str) -> str:
        if unit_less := self._conditions.without_unit(meaning):
            return f"; `{unit_less}` states no unit: name it with its unit in [conditions]"
        if name == meaning and meaning in HELD:
            return f"; state a constant in [conditions], {meaning} = {{ constant = 0.0 }}"
        return suggestion(name, self._sent, otherwise="")

    def check_sent(self, names: Sequence[str], source: str) -> None:
        """Refuse a mapping of fields that a source does not send, where what it sends is known beforehand.

        names  : fields that are sent
        source : name of the source, for the message
        raises : InputError with one line a field
        """
        if self._time not in names:
            self._find_time(dict.fromkeys(names, 0.0))
        lacking = self._conditions.lacking(names)
        raise_problems(
            [
                f"{display_path(self.link.path)}: field `{name}` ({meaning}) is not sent by {source}"
                f"{suggestion(name, names)}"
                for name, meaning in self.fields.items()
                if name not in names and (name in lacking or name not in self._conditions.fields)
            ]
        )

    def _note(self, values: Mapping[str, float | str]) -> None:
        self._messages += 1
        self._conditions.see(values.keys())
        if self._messages <= GRACE_MESSAGES:
            self._sent |= dict.fromkeys(values)
            self._seen |= set(self._sent) & set(self.fields)

    def _time_of(self, values: Mapping[str, float | str], name: str) -> float:
        if name not in values and name == self._time:
            name = self._find_time(values)
        if name not in values:
            hint = ""
            if name == self._time and (times := _times_of(values)):
                hint = f' (name it in [time], as field = "{times[0].name}", unit = "s")'
            raise InputError(f"time field `{name}` is missing{hint}; the message has {_names(values)}")
        return self._seconds(_number(values[name], name) - self._zero)

    def _find_time(self, values: Mapping[str, float | str]) -> str:
        """The time field; of a link that names none, the one that is a time by its name and unit."""
        named = [f for f in _times_of(values) if f.unit]
        if not named and JSBSIM_TIME in values and any(s.kind == "jsbsim" for s in self.link.declared.source):
            named = [FlightField(JSBSIM_TIME, TIME, "s", Conversion(1.0, 0.0))]
        if len(named) != 1 or "time" in self.link.declared.model_fields_set:
            return self._time
        (flight_field,) = named
        self._time, self._seconds = flight_field.name, flight_field.convert
        self._conditions.notes.append(f"{TIME} from `{flight_field.name}`, in {flight_field.unit}")
        return self._time

    def _frames(self, values: Mapping[str, float | str], time_s: float) -> tuple[list[Frame], list[str]]:
        try:
            columns = self._conditions.values(values)
        except InputError as error:
            return [], [f"{error}; no frame at {time_s:g} s"]
        if not columns and self._conditions.fields:
            return [], []
        try:
            return self._gather(time_s, columns), []
        except InputError as error:
            self._open = None
            return [], list(error.problems)

    def _gather(self, time_s: float, columns: dict[str, float]) -> list[Frame]:
        """Frames of columns that come in several messages."""
        frames: list[Frame] = []
        waiting = self._open
        if waiting is not None and waiting.time_s != time_s:
            gathered = _Gathered(waiting.time_s, self._latest | waiting.values)
            if self._conditions.has_all(gathered.values):
                frames += [self._frame(g.time_s, g.values) for g in (*self._released(), gathered)]
            elif not self._conditions.is_settled:
                self._held.append(gathered)
                frames += [self._frame(g.time_s, g.values) for g in self._settled(time_s)]
            waiting = None
        if waiting is None:
            waiting = _Gathered(time_s)
        waiting.values |= columns
        self._latest |= columns
        self._open = waiting
        if self._conditions.has_all(waiting.values):
            gathered = _Gathered(time_s, self._latest | waiting.values)  # with what accompanies them
            frames += [self._frame(g.time_s, g.values) for g in (*self._released(), gathered)]
            self._open = None
            self._conditions.settle(self._latest)  # nothing is absent
        return frames

    def _settled(self, time_s: float) -> list[_Gathered]:
        """What waited for columns that are absent, once it is clear that they are."""
        self._times += 1
        self._first_s = time_s if math.isnan(self._first_s) else self._first_s
        if self._times < ABSENT_TIMES or abs(time_s - self._first_s) < ABSENT_AFTER_S:
            return []
        self._conditions.settle(self._latest)
        return self._released()

    def _released(self) -> list[_Gathered]:
        """What was held and is whole with what is derived; the rest is no frame."""
        waiting, self._held = self._held, []
        return [g for g in waiting if self._conditions.has_all(g.values)]

    def _frame(self, time_s: float, latest: Mapping[str, float]) -> Frame:
        """A frame with constants and with the columns that follow from those that came.

        raises : InputError where one does not, such as a density at a speed of 0
        """
        try:
            values = self._conditions.complete(latest)
        except InputError as error:
            raise InputError(f"{error}; no frame at {time_s:g} s") from None
        return Frame(time_s, values, self._conditions.is_of_model)

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


def _pressure_of(record: Record) -> PressureModel | None:
    """Model of the surface pressure of a record: at its declared angle, else as its column has it."""
    angle = record.declared.heating.local_angle_deg
    return implied_pressure(record.conditions) if angle is None else local_pressure(angle)


def clock_skew_s(link: Link) -> float:
    """By how much the clock of the thermocouples is known to lag behind that of the conditions [s].

    `clock.skew` in `fix`, or the mean of its prior where it is estimated: readings are put where they belong by it.
    """
    settings = link.declared.estimate
    mean, _ = settings.prior.get(CLOCK_SKEW.name, (CLOCK_SKEW.value, CLOCK_SKEW.sigma))
    return settings.fix.get(CLOCK_SKEW.name, mean if CLOCK_SKEW.name in (settings.parameters or ()) else 0.0)


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


def _limits(column: str) -> tuple[float, float, str]:
    """Least and greatest value of a column in its unit, and the rule that a message states."""
    return LIMITS.get(column, (-math.inf, math.inf, ""))


def _columns(link: Link, file: str) -> tuple[list[_Column], list[str]]:
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
        unit_of_column = column_unit(name)
        unit = unit_of_name(source, name) if unit is None and source != name else unit
        try:
            convert = unit_conversion(
                unit_of_column if unit is None else unit, unit_of_column, f"{file}, [conditions]: `{name}`"
            )
        except InputError as error:
            problems += error.problems
            continue
        columns.append(_Column(name, source, convert, *_limits(name)))
    return columns, problems


def _words(link: Link, file: str) -> tuple[list[_Word], list[str]]:
    """The sensors' fields, and problems of their names and units."""
    by_sensor: dict[tuple[str, str], _Word] = {}
    problems: list[str] = []
    for i, declared in enumerate(link.declared.sensor, start=1):
        where = f"{file}, [[sensor]] {i}"
        try:
            word = _declared_word(link, declared, where)
        except InputError as error:
            problems += error.problems
            continue
        if (word.point, word.sensor.name) in by_sensor:
            problems.append(f"{where}: `sensor`: {declared.sensor} is repeated; remove one")
        by_sensor[word.point, word.sensor.name] = word
    fields = default_fields([(p.name, s.name, s.column) for p in link.points for s in p.sensors])
    for point in link.points:
        for sensor in point.sensors:
            key = point.name, sensor.name
            by_sensor.setdefault(
                key, _Word(point.name, sensor, fields[key], None, Conversion(1.0, 0.0), is_declared=False)
            )
    return list(by_sensor.values()), problems


def _declared_sensor(link: Link, declared: SensorField, where: str) -> tuple[LinkPoint, Sensor]:
    """The sensor that a field is declared for, and its point.

    raises : InputError where there is none, or several points have one
    """
    sensors = [(point, sensor) for point in link.points for sensor in point.sensors]
    alike = [(p, s) for p, s in sensors if s.name == declared.sensor and declared.control_point in (None, p.name)]
    if not alike:
        hint = suggestion(declared.sensor, [sensor.name for _, sensor in sensors])
        raise InputError(f"{where}: `sensor`: unknown sensor `{declared.sensor}`{hint}")
    if len(alike) > 1:
        owners = ", ".join(point.name for point, _ in alike)
        raise InputError(f"{where}: {owners} have a sensor {declared.sensor}; add `control_point`")
    return alike[0]


def _declared_word(link: Link, declared: SensorField, where: str) -> _Word:
    point, sensor = _declared_sensor(link, declared, where)
    if declared.codes and (sensor.bits is None or sensor.range_K is None):
        raise InputError(
            f"{where}: `codes`: {declared.sensor} declares no recorder; add `bits` and `range_K` to its declaration, "
            "or give `calibration`"
        )
    codes = 2**sensor.bits if declared.codes and sensor.bits is not None else 0
    convert = unit_conversion(declared.unit, "K", f"{where}: `unit`")
    calibration = tuple(declared.calibration or ())
    return _Word(point.name, sensor, declared.field, declared.time, convert, calibration, codes)
