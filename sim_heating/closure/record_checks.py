"""What a record itself tells before it is fitted: clocks, another flight's temperatures, a sensor that stands or jumps.

`before_fit` asks the record and one march of its declared model, and says of each doubt by what it is seen. What a fit
then explains was none: `standing` keeps the others. Readings at an end of a recorder's range are left out: they stand
still there whatever the sensor does.
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
from sim_heating.inputs.sensor_model import calibrated
from sim_heating.march.history import march_points
from sim_heating.simulation.predict import Prediction
from sim_heating.thermal.mesh import layer_diffusivities
from sim_heating.thermal.stack import Sensor

SENSOR, CLOCK, MATERIAL, TRAJECTORY = "broken sensor", "clock", "material", "trajectory"
UNITS = {"milliseconds": 1e-3, "minutes": 60.0, "hours": 3600.0}
"""Units that a clock may be in, in s."""
ALIKE = 0.9
"""Correlation of measured and predicted temperatures from which a clock in another unit is told."""
SPANS_APART = 8.0
"""Measurements and conditions of which one lasts this many times as long as the other are on two clocks."""
DECELERATION_M_S2 = (0.05, 300.0)
"""Mean deceleration of an entry lies between."""
SHIFT_S, SHIFT_STEP_S, LEAST_SHIFT_S = 900.0, 10.0, 20.0
"""How far measurements are moved against conditions, in which steps, and from where on it is another flight [s]."""
LEAST_OVERLAP = 0.6
SLOWEST_M_S = 1000.0
"""A record whose velocity stays below is no entry but a test on the ground."""
MAX_REMAINING = 0.5
"""What leaves less than this part of the residual is told: a shift, or another material."""
FEWEST_STUCK = 30
JUMP, SLOW = 12.0, 3.0
"""A sensor that jumps by so many floors from one sample to the next, at a depth that heat takes so many times longer to
reach."""
ABOUT = 8
"""Samples before and behind a jump, lines through which are compared."""
GAP = 1.5
"""Samples further apart than so many of their usual distances are not looked at for a jump between them."""
EXPLAINED, AT_NOISE = 2.0, 1.6
"""Residual over the noise below which a record is explained, and below which a sensor is at its noise."""


@dataclass(frozen=True)
class DataFault:
    """One finding.

    kind   : "broken sensor", "clock", "material", "trajectory"
    words  : what is wrong, by what it is seen, what to do
    sensor : the one that is meant, where it is a single one
    """

    kind: str
    words: str
    sensor: str | None = None


def check_record(record: Record) -> list[DataFault]:
    """What the record itself tells: clocks, another flight's temperatures, a sensor that stands still.

    raises : RunError where the declared model cannot be marched
    """
    on_clock = clock_fault(record)
    if on_clock is not None:
        return [on_clock]
    flown, indicated = _march(record)
    elsewhere = None if _on_ground(record) else time_shift_fault(record, flown, indicated)
    return (
        ([] if elsewhere is None else [elsewhere]) + stuck_sensors(record, flown, indicated) + jumping_sensors(record)
    )


def clock_fault(record: Record) -> DataFault | None:
    """Measurements and conditions on clocks of two units."""
    read, flown = float(np.ptp(record.time_s)), float(np.ptp(record.conditions.time_s))
    if read <= 0.0 or flown <= 0.0 or 1.0 / SPANS_APART < read / flown < SPANS_APART:
        return None
    slow = float(np.ptp(record.conditions["velocity_m_s"])) / flown
    trusted = _on_ground(record) or _is_entry(slow)
    for unit, seconds in UNITS.items():
        for factor in (seconds, 1.0 / seconds):
            if not 1.0 / SPANS_APART < factor * read / flown < 1.2:
                continue
            wrong = "thermocouples" if trusted else "flight conditions"
            own = unit if (factor == seconds) == trusted else f"s where the other file has {unit}"
            alike = _correlation_at(record, factor, trusted)
            if alike > ALIKE:
                return DataFault(
                    CLOCK,
                    f"{record.name}: the clock of the {wrong} is in {own}: measurements span {read:.4g} and conditions "
                    f"{flown:.4g}, and with one of them times {factor if trusted else 1.0 / factor:g} measured and "
                    f"predicted temperatures go together (correlation {alike:.2f}). Give time_s in s.",
                )
    return None


def _on_ground(record: Record) -> bool:
    return bool(record.conditions["velocity_m_s"].max() < SLOWEST_M_S)


def _is_entry(deceleration_m_s2: float) -> bool:
    return DECELERATION_M_S2[0] < deceleration_m_s2 < DECELERATION_M_S2[1]


def _correlation_at(record: Record, factor: float, trusted: bool) -> float:
    """Correlation of measured and predicted temperatures, the clock of the measurements (or that of the conditions)
    being of another unit; of the sensor where it is largest."""
    flown, read = record.conditions, dict(record.thermocouples)
    if trusted:
        read["time_s"] = record.time_s * factor
    else:
        flown = flown.with_columns(time_s=flown.time_s / factor)
    other = replace(record, conditions=flown, thermocouples=read)
    try:
        t, indicated = _march(other)
    except RunError:
        return 0.0
    best = 0.0
    for measured, expected in zip(other.temperatures_K(), indicated, strict=True):
        known = np.isfinite(measured) & (other.time_s >= t[0]) & (other.time_s <= t[-1])
        at = np.interp(other.time_s[known], t, expected)
        if np.count_nonzero(known) > 10 and np.ptp(at) > 0.0 and np.ptp(measured[known]) > 0.0:
            best = max(best, float(np.corrcoef(measured[known], at)[0, 1]))
    return best


def _march(record: Record) -> tuple[FloatArray, FloatArray]:
    """Times of the conditions and what each sensor should show there by the declared model (sensor, time)."""
    history = march_points([point_of_record(record)], [conditions_of_record(record)])[0]
    pairs = zip(record.sensors, history.sensors_K, strict=True)
    return history.time_s, np.array([calibrated(s, T) for s, T in pairs])


def time_shift_fault(record: Record, flown_s: FloatArray, indicated_K: FloatArray) -> DataFault | None:
    """Temperatures of a flight that is minutes earlier or later than the conditions say.

    Measured temperatures are fitted by a + b (predicted, moved by a shift), so that an error of the heating as a whole
    does not count.
    """
    used = [i for i, s in enumerate(record.sensors) if s.used]
    read, t = _read_K(record)[used], record.time_s
    asked = record.fit_mask()
    shifts = np.arange(-SHIFT_S, SHIFT_S + 1.0, SHIFT_STEP_S)
    left = np.array([_left_at(s, t[asked], read[:, asked], flown_s, indicated_K[used]) for s in shifts])
    now = _left_at(0.0, t[asked], read[:, asked], flown_s, indicated_K[used])
    if not np.any(np.isfinite(left)) or not np.isfinite(now):
        return None
    k = int(np.nanargmin(left))
    if abs(shifts[k]) < LEAST_SHIFT_S or left[k] > MAX_REMAINING * now:
        return None
    word = "later" if shifts[k] > 0.0 else "earlier"
    return DataFault(
        TRAJECTORY,
        f"{record.name}: the temperatures are those of a flight {abs(shifts[k]):.0f} s {word} than the conditions: "
        f"moved by that, prediction and measurement differ in shape by {left[k]:.1f} K instead of {now:.1f} K. No "
        "clock is off by so much; check which trajectory, or which zero of time, the record holds.",
    )


def _left_at(shift_s: float, t: FloatArray, read: FloatArray, flown_s: FloatArray, indicated: FloatArray) -> float:
    """RMS of what a line leaves of measured against moved predicted temperatures [K]; NaN for too little overlap."""
    at = t - shift_s
    inside = (at >= flown_s[0]) & (at <= flown_s[-1])
    if np.count_nonzero(inside) < LEAST_OVERLAP * len(t):
        return float("nan")
    squares, count = 0.0, 0
    for measured, expected in zip(read, indicated, strict=True):
        known = inside & np.isfinite(measured)
        x, y = np.interp(at[known], flown_s, expected), measured[known]
        if len(y) < 10 or np.ptp(x) == 0.0:
            continue
        x, y = x - np.mean(x), y - np.mean(y)
        squares, count = squares + max(float(y @ y - (x @ y) ** 2 / (x @ x)), 0.0), count + len(y)
    return float(np.sqrt(squares / count)) if count else float("nan")


def stuck_sensors(record: Record, flown_s: FloatArray, indicated_K: FloatArray) -> list[DataFault]:
    """Sensors that stand still for a time in which the declared model moves them by many of their steps."""
    found = []
    for sensor, read, expected in zip(record.sensors, _read_K(record), indicated_K, strict=True):
        known = np.isfinite(read) & (record.time_s >= flown_s[0]) & (record.time_s <= flown_s[-1])
        t, values = record.time_s[known], read[known]
        if not sensor.used or len(values) < FEWEST_STUCK:
            continue
        ends = np.append(np.flatnonzero(np.diff(values) != 0.0), len(values) - 1)
        begins = np.append(0, ends[:-1] + 1)
        k = int(np.argmax(ends - begins))
        own = slice(begins[k], ends[k] + 1)
        moves = float(np.ptp(np.interp(t[own], flown_s, expected)))
        step = max(sensor.lsb_K, sensor.noise_sigma_K or 1.0)
        if ends[k] - begins[k] + 1 >= FEWEST_STUCK and moves > STUCK * step:
            found.append(
                DataFault(
                    SENSOR,
                    f"{record.name}, sensor {sensor.name}: stands still at {values[begins[k]]:.1f} K from "
                    f"{t[begins[k]]:.0f} to {t[ends[k]]:.0f} s, where the declared model moves it by {moves:.0f} K. It "
                    "is stuck; set used = false, or end the fit before.",
                    sensor.name,
                )
            )
    return found


def jumping_sensors(record: Record) -> list[DataFault]:
    """Sensors in depth that jump, and stay, faster than heat diffuses to them: lines through the samples before and
    behind, up to the middle between, are apart."""
    found = []
    for sensor, read in zip(record.sensors, _read_K(record), strict=True):
        t, T = record.time_s[np.isfinite(read)], read[np.isfinite(read)]
        if not sensor.used or len(T) < 4 * ABOUT or not _deep(record, sensor.depth_m, float(np.median(np.diff(t)))):
            continue
        floor, apart = _floor_K(sensor), np.diff(t)[ABOUT - 1 : len(t) - ABOUT]
        middle = t[ABOUT - 1 : len(t) - ABOUT] + 0.5 * apart
        before = _line_at(t[:-ABOUT], T[:-ABOUT], middle)
        step = _line_at(t[ABOUT:], T[ABOUT:], middle) - before
        alone = np.abs(T[ABOUT : len(T) - ABOUT + 1] - before) > 0.5 * JUMP * floor
        sudden = np.where(alone & (apart < GAP * np.median(np.diff(t))), np.abs(step), 0.0)
        k = int(np.argmax(sudden))
        if sudden[k] > JUMP * floor:
            found.append(
                DataFault(
                    SENSOR,
                    f"{record.name}, sensor {sensor.name}: jumps by {step[k]:+.1f} K at {t[k + ABOUT]:.0f} s, faster "
                    "than heat reaches its depth. Set used = false, or end the fit before.",
                    sensor.name,
                )
            )
    return found


def _line_at(t: FloatArray, T: FloatArray, at_s: FloatArray) -> FloatArray:
    """(window,) least-squares lines through each ABOUT samples in a row, at one time each."""
    t, T = (np.lib.stride_tricks.sliding_window_view(x, ABOUT) for x in (t, T))
    about, mean = t - np.mean(t, axis=1, keepdims=True), np.mean(T, axis=1)
    slope = np.sum(about * T, axis=1) / np.sum(about**2, axis=1)
    return np.asarray(mean + slope * (at_s - np.mean(t, axis=1)))


def _deep(record: Record, depth_m: float, period_s: float) -> bool:
    """Whether heat takes SLOW times longer than a sample to a depth: (sum of dx / sqrt(a) over the layers)^2 / 4."""
    root_s, left = 0.0, depth_m
    for layer, a in zip(record.declared.stack.layer, layer_diffusivities(record.construction), strict=True):
        through = min(layer.thickness_m, left)
        root_s += through / np.sqrt(a)
        left -= through
    return bool(0.25 * root_s**2 > SLOW * period_s)


def unresolved(doubts: Sequence[DataFault], after: Prediction) -> list[DataFault]:
    """Those of the verdicts before a fit that its prediction does not clear: the sensor meant is not at its noise, or,
    where none is meant, the record is not explained."""
    floors = np.array([_floor_K(s) for s in after.record.sensors])
    residual = np.where(np.isfinite(_read_K(after.record)), after.residual_K, np.nan) / floors[:, np.newaxis]

    def cleared(doubt: DataFault) -> bool:
        own = residual[[s.used if doubt.sensor is None else s.name == doubt.sensor for s in after.record.sensors]]
        left = own[np.isfinite(own)]
        most = EXPLAINED if doubt.sensor is None else AT_NOISE
        return len(left) > 0 and float(np.sqrt(np.mean(left**2))) < most

    return [doubt for doubt in doubts if not cleared(doubt)]


def _floor_K(sensor: Sensor) -> float:
    """Noise floor of a sensor, of sigma 1 K where the record gives none."""
    return sensor.noise_floor_K(sensor.noise_sigma_K or 1.0)


def _read_K(record: Record) -> FloatArray:
    """(sensor, sample) measurements; NaN where lost, or at an end of the recorder's range."""
    read = record.temperatures_K()
    seen = [reading_intervals(sensor, own) for sensor, own in zip(record.sensors, read, strict=True)]
    return np.array([np.where(o.is_finite, T, np.nan) for o, T in zip(seen, read, strict=True)])
