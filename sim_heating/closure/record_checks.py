"""Checks of a record before it is fitted: units of its clocks, another flight's temperatures, stuck or jumping sensors.

`check_record` examines the record and one march of its declared model, and states for each fault what shows it. A fault
that the later fit explains was none: `unresolved` keeps the others. Readings at an end of a recorder's range are left
out, since there they are constant whatever the sensor does.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.base.errors import RunError
from sim_heating.estimation.inference.likelihood import reading_intervals
from sim_heating.estimation.inference.observability import STUCK
from sim_heating.inputs.points import conditions_of_record, point_of_record
from sim_heating.inputs.record import Record
from sim_heating.inputs.sensor_model import indicated_temperature
from sim_heating.march.history import march_points
from sim_heating.simulation.predict import Prediction
from sim_heating.thermal.mesh import layer_diffusivities
from sim_heating.thermal.stack import Sensor

SENSOR, CLOCK, MATERIAL, TRAJECTORY = "broken sensor", "clock", "material", "trajectory"
UNITS = {"milliseconds": 1e-3, "minutes": 60.0, "hours": 3600.0}
"""Units of time that a clock may be in by mistake, in s."""
MIN_CORRELATION = 0.9
"""Correlation of measured and predicted temperatures that confirms another unit of a clock."""
MAX_SPAN_RATIO = 8.0
"""Spans of measurements and conditions that differ by more than this factor are on clocks of two units."""
DECELERATION_M_S2 = (0.05, 300.0)
"""Limits of the mean deceleration of an entry."""
SHIFT_S, SHIFT_STEP_S, MIN_SHIFT_S = 900.0, 10.0, 20.0
"""Largest shift of the measurements that is tried, step between shifts, and the least that indicates another flight
[s]."""
MIN_OVERLAP = 0.6
"""Part of the readings that have to lie within the conditions after a shift."""
MIN_ENTRY_SPEED_M_S = 1000.0
"""A record whose velocity stays below is a ground test."""
MAX_REMAINING = 0.5
"""A shift, or another material, is reported where it leaves less than this part of the residual."""
MIN_STUCK_SAMPLES = 30
JUMP_FLOORS, DIFFUSION_SAMPLES = 12.0, 3.0
"""A jump is at least this many noise floors from one sample to the next, at a depth that heat takes at least this many
sample intervals to reach."""
JUMP_WINDOW = 8
"""Samples before and after a jump through which a line is fitted."""
MAX_GAP = 1.5
"""Samples further apart than this many median intervals are not searched for a jump between them."""
EXPLAINED, AT_NOISE = 2.0, 1.6
"""Residual over the noise below which a record is explained, and below which a sensor is at its noise."""


@dataclass(frozen=True)
class DataFault:
    """An error of the data or of the declaration of a record, as distinct from a missing effect.

    kind    : "broken sensor", "clock", "material" or "trajectory"
    message : what is wrong, what shows it, what to do
    sensor  : name of the thermocouple concerned; None where the fault is not of a single one
    """

    kind: str
    message: str
    sensor: str | None = None


def check_record(record: Record) -> list[DataFault]:
    """Faults that a record shows before any fit: clocks, another flight's temperatures, stuck and jumping sensors.

    returns : a fault of its clocks alone where there is one, since nothing else can be examined then
    raises  : RunError where the declared model cannot be marched
    """
    # With the clock in another unit the comparisons below would all fail for the same reason.
    of_clock = clock_fault(record)
    if of_clock is not None:
        return [of_clock]
    flown_s, indicated_K = _declared_readings(record)
    shift = None if _is_ground_test(record) else time_shift_fault(record, flown_s, indicated_K)
    sensors = stuck_sensors(record, flown_s, indicated_K) + jumping_sensors(record)
    return sensors if shift is None else [shift, *sensors]


def clock_fault(record: Record) -> DataFault | None:
    """Clocks of measurements and conditions in different units; None where their spans agree or no unit fits."""
    read_s, flown_s = float(np.ptp(record.time_s)), float(np.ptp(record.conditions.time_s))
    if read_s <= 0.0 or flown_s <= 0.0 or 1.0 / MAX_SPAN_RATIO < read_s / flown_s < MAX_SPAN_RATIO:
        return None
    deceleration = float(np.ptp(record.conditions["velocity_m_s"])) / flown_s
    # the conditions are right where their clock makes a possible flight; the measurements' clock is then at fault
    conditions_right = _is_ground_test(record) or _is_entry(deceleration)
    for unit, seconds in UNITS.items():
        for factor in (seconds, 1.0 / seconds):
            if not 1.0 / MAX_SPAN_RATIO < factor * read_s / flown_s < 1.2:
                continue
            wrong = "thermocouples" if conditions_right else "flight conditions"
            found = unit if (factor == seconds) == conditions_right else f"s where the other file has {unit}"
            correlation = _correlation_at(record, factor, conditions_right)
            if correlation > MIN_CORRELATION:
                return DataFault(
                    CLOCK,
                    f"{record.name}: the clock of the {wrong} is in {found}: measurements span {read_s:.4g} and "
                    f"conditions {flown_s:.4g}; with one of them multiplied by "
                    f"{factor if conditions_right else 1.0 / factor:g}, measured and predicted temperatures agree "
                    f"(correlation {correlation:.2f}). Give time_s in s.",
                )
    return None


def _is_ground_test(record: Record) -> bool:
    return bool(record.conditions["velocity_m_s"].max() < MIN_ENTRY_SPEED_M_S)


def _is_entry(deceleration_m_s2: float) -> bool:
    return DECELERATION_M_S2[0] < deceleration_m_s2 < DECELERATION_M_S2[1]


def _correlation_at(record: Record, factor: float, conditions_right: bool) -> float:
    """Largest correlation, over the sensors, of measured and predicted temperatures with a clock in another unit.

    factor           : by which times of the measurements are multiplied, or those of the conditions divided
    conditions_right : whether it is the measurements' clock that is changed
    """
    flown, read = record.conditions, dict(record.thermocouples)
    if conditions_right:
        read["time_s"] = record.time_s * factor
    else:
        flown = flown.with_columns(time_s=flown.time_s / factor)
    other = replace(record, conditions=flown, thermocouples=read)
    try:
        t, indicated_K = _declared_readings(other)
    except RunError:
        return 0.0
    best = 0.0
    for measured, predicted in zip(other.temperatures_K(), indicated_K, strict=True):
        known = np.isfinite(measured) & (other.time_s >= t[0]) & (other.time_s <= t[-1])
        at = np.interp(other.time_s[known], t, predicted)
        if np.count_nonzero(known) > 10 and np.ptp(at) > 0.0 and np.ptp(measured[known]) > 0.0:
            best = max(best, float(np.corrcoef(measured[known], at)[0, 1]))
    return best


def _declared_readings(record: Record) -> tuple[FloatArray, FloatArray]:
    """(time,) times of the conditions [s] and (sensor, time) readings that the declared model predicts [K]."""
    history = march_points([point_of_record(record)], [conditions_of_record(record)])[0]
    pairs = zip(record.sensors, history.sensors_K, strict=True)
    return history.time_s, np.array([indicated_temperature(s, T) for s, T in pairs])


def time_shift_fault(record: Record, flown_s: FloatArray, indicated_K: FloatArray) -> DataFault | None:
    """Temperatures of a flight minutes earlier or later than the conditions.

    Measured temperatures are fitted by a + b (predicted, shifted in time), so that an error of the heating as a whole
    does not count.
    flown_s, indicated_K : (time,) [s] and (sensor, time) [K], readings that the declared model predicts
    """
    used = [i for i, s in enumerate(record.sensors) if s.used]
    read, t = _read_K(record)[used], record.time_s
    fitted = record.fit_mask()
    shifts = np.arange(-SHIFT_S, SHIFT_S + 1.0, SHIFT_STEP_S)
    error_K = np.array([_shape_error_K(s, t[fitted], read[:, fitted], flown_s, indicated_K[used]) for s in shifts])
    unshifted_K = _shape_error_K(0.0, t[fitted], read[:, fitted], flown_s, indicated_K[used])
    if not np.any(np.isfinite(error_K)) or not np.isfinite(unshifted_K):
        return None
    k = int(np.nanargmin(error_K))
    if abs(shifts[k]) < MIN_SHIFT_S or error_K[k] > MAX_REMAINING * unshifted_K:
        return None
    direction = "later" if shifts[k] > 0.0 else "earlier"
    return DataFault(
        TRAJECTORY,
        f"{record.name}: the temperatures are those of a flight {abs(shifts[k]):.0f} s {direction} than the "
        f"conditions: with that shift, prediction and measurement differ in shape by {error_K[k]:.1f} K instead of "
        f"{unshifted_K:.1f} K. No clock has so large an error; check trajectory and zero of time of the record.",
    )


def _shape_error_K(
    shift_s: float, t: FloatArray, read: FloatArray, flown_s: FloatArray, indicated: FloatArray
) -> float:
    """RMS about the line of measured over shifted predicted temperatures [K]; NaN for too little overlap."""
    at = t - shift_s
    inside = (at >= flown_s[0]) & (at <= flown_s[-1])
    if np.count_nonzero(inside) < MIN_OVERLAP * len(t):
        return float("nan")
    squares, count = 0.0, 0
    for measured, predicted in zip(read, indicated, strict=True):
        known = inside & np.isfinite(measured)
        x, y = np.interp(at[known], flown_s, predicted), measured[known]
        if len(y) < 10 or np.ptp(x) == 0.0:
            continue
        # The shape alone, free in level and scale: a wrong table must not be mistaken for another flight.
        x, y = x - np.mean(x), y - np.mean(y)
        squares, count = squares + max(float(y @ y - (x @ y) ** 2 / (x @ x)), 0.0), count + len(y)
    return float(np.sqrt(squares / count)) if count else float("nan")


def stuck_sensors(record: Record, flown_s: FloatArray, indicated_K: FloatArray) -> list[DataFault]:
    """Used sensors with constant readings while the declared model changes by many of their resolution steps.

    flown_s, indicated_K : (time,) [s] and (sensor, time) [K], readings that the declared model predicts
    """
    found = []
    for sensor, read, predicted in zip(record.sensors, _read_K(record), indicated_K, strict=True):
        known = np.isfinite(read) & (record.time_s >= flown_s[0]) & (record.time_s <= flown_s[-1])
        t, values = record.time_s[known], read[known]
        if not sensor.used or len(values) < MIN_STUCK_SAMPLES:
            continue
        ends = np.append(np.flatnonzero(np.diff(values) != 0.0), len(values) - 1)
        begins = np.append(0, ends[:-1] + 1)
        k = int(np.argmax(ends - begins))
        longest = slice(begins[k], ends[k] + 1)
        change = float(np.ptp(np.interp(t[longest], flown_s, predicted)))
        # A coarse word repeats itself over a slow change: not the constant reading is suspect, but one that should have
        # moved by many steps.
        step = max(sensor.lsb_K, sensor.noise_sigma_K or 1.0)
        if ends[k] - begins[k] + 1 >= MIN_STUCK_SAMPLES and change > STUCK * step:
            found.append(
                DataFault(
                    SENSOR,
                    f"{record.name}, sensor {sensor.name}: is stuck at {values[begins[k]]:.1f} K from "
                    f"{t[begins[k]]:.0f} to {t[ends[k]]:.0f} s, while the declared model changes by {change:.0f} K. "
                    "Set used = false, or end the fit before.",
                    sensor.name,
                )
            )
    return found


def jumping_sensors(record: Record) -> list[DataFault]:
    """Used sensors in depth whose level steps faster than heat diffuses to them.

    Lines through the JUMP_WINDOW samples before and after are compared at the middle between them.
    """
    found = []
    for sensor, read in zip(record.sensors, _read_K(record), strict=True):
        t, T = record.time_s[np.isfinite(read)], read[np.isfinite(read)]
        if (
            not sensor.used
            or len(T) < 4 * JUMP_WINDOW
            or not _is_deep(record, sensor.depth_m, float(np.median(np.diff(t))))
        ):
            continue
        floor, interval = _floor_K(sensor), np.diff(t)[JUMP_WINDOW - 1 : len(t) - JUMP_WINDOW]
        middle = t[JUMP_WINDOW - 1 : len(t) - JUMP_WINDOW] + 0.5 * interval
        # Lines and not means: the difference of two means took the steep steady rise of practice record p04 for a jump.
        before = _line_at(t[:-JUMP_WINDOW], T[:-JUMP_WINDOW], middle)
        step = _line_at(t[JUMP_WINDOW:], T[JUMP_WINDOW:], middle) - before
        # The first reading after a step has to leave the earlier line as well: a bend of the temperature alone opens a
        # gap between the two lines.
        distinct = np.abs(T[JUMP_WINDOW : len(T) - JUMP_WINDOW + 1] - before) > 0.5 * JUMP_FLOORS * floor
        sudden = np.where(distinct & (interval < MAX_GAP * np.median(np.diff(t))), np.abs(step), 0.0)
        k = int(np.argmax(sudden))
        if sudden[k] > JUMP_FLOORS * floor:
            found.append(
                DataFault(
                    SENSOR,
                    f"{record.name}, sensor {sensor.name}: jumps by {step[k]:+.1f} K at {t[k + JUMP_WINDOW]:.0f} s, "
                    "faster than heat reaches its depth. Set used = false, or end the fit before.",
                    sensor.name,
                )
            )
    return found


def _line_at(t: FloatArray, T: FloatArray, at_s: FloatArray) -> FloatArray:
    """(window,) value at one time each of least-squares lines through each JUMP_WINDOW consecutive samples."""
    t, T = (np.lib.stride_tricks.sliding_window_view(x, JUMP_WINDOW) for x in (t, T))
    centred, mean = t - np.mean(t, axis=1, keepdims=True), np.mean(T, axis=1)
    slope = np.sum(centred * T, axis=1) / np.sum(centred**2, axis=1)
    return np.asarray(mean + slope * (at_s - np.mean(t, axis=1)))


def _is_deep(record: Record, depth_m: float, period_s: float) -> bool:
    """Whether heat takes more than DIFFUSION_SAMPLES intervals to a depth."""
    return diffusion_time_s(record, depth_m) > DIFFUSION_SAMPLES * period_s


def diffusion_time_s(record: Record, depth_m: float) -> float:
    """Time that heat takes to a depth [s]: (sum of dx / sqrt(a) over layers)^2 / 4."""
    root_s, remaining_m = 0.0, depth_m
    for layer, a in zip(record.declared.stack.layer, layer_diffusivities(record.construction), strict=True):
        through = min(layer.thickness_m, remaining_m)
        root_s += through / np.sqrt(a)
        remaining_m -= through
    return float(0.25 * root_s**2)


def unresolved(faults: Sequence[DataFault], after: Prediction) -> list[DataFault]:
    """Faults found before a fit that its prediction does not explain.

    A fault of one sensor is explained where that sensor is at its noise, one of the whole record where all used ones
    are within EXPLAINED times theirs.
    """
    floors = np.array([_floor_K(s) for s in after.record.sensors])
    residual = np.where(np.isfinite(_read_K(after.record)), after.residual_K, np.nan) / floors[:, np.newaxis]

    def is_explained(fault: DataFault) -> bool:
        own = residual[[s.used if fault.sensor is None else s.name == fault.sensor for s in after.record.sensors]]
        known = own[np.isfinite(own)]
        limit = EXPLAINED if fault.sensor is None else AT_NOISE
        return len(known) > 0 and float(np.sqrt(np.mean(known**2))) < limit

    return [fault for fault in faults if not is_explained(fault)]


def _floor_K(sensor: Sensor) -> float:
    """Noise floor of a sensor [K]; its sigma is taken as 1 K where the record gives none."""
    return sensor.noise_floor_K(sensor.noise_sigma_K or 1.0)


def _read_K(record: Record) -> FloatArray:
    """(sensor, sample) measurements [K]; NaN where lost, or at an end of the recorder's range."""
    read = record.temperatures_K()
    classified = [reading_intervals(sensor, own) for sensor, own in zip(record.sensors, read, strict=True)]
    # A word at the end of the range states only a bound: taken as a reading it looked like a stuck sensor.
    return np.array([np.where(o.is_finite, T, np.nan) for o, T in zip(classified, read, strict=True)])
