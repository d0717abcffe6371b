"""Checks of a record that no hypothesis of the search is: clocks in two units, heating wrong by a factor throughout, a
wall that is hot where the record begins.

Whatever else is wrong with the flight, the wall or the sensors of a record is a hypothesis (search/changes), weighed
with the effects.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.base.errors import RunError
from sim_heating.estimation.fit import rms_normalised_residual
from sim_heating.estimation.inference.noise import noise_of_readings
from sim_heating.estimation.problem import FitProblem
from sim_heating.inputs.first_readings import other_start
from sim_heating.inputs.points import conditions_of_record, point_of_record
from sim_heating.inputs.record import Record
from sim_heating.inputs.sensor_model import indicated_temperature
from sim_heating.march.history import march_points

CLOCK, TRAJECTORY, START = "clock", "trajectory", "start"
UNITS = {"milliseconds": 1e-3, "minutes": 60.0, "hours": 3600.0}
"""Units of time that a clock may be in by mistake, in s."""


@dataclass(frozen=True)
class DataFault:
    """An error of the data or of the declaration of a record, as distinct from a missing effect.

    kind    : "clock", "trajectory" or "start"
    message : what is wrong, what shows it, what to do
    """

    kind: str
    message: str


def clock_fault(record: Record) -> DataFault | None:
    """Clocks of measurements and conditions in different units; None where their spans agree or no unit fits."""
    min_correlation = 0.9  # correlation of measured and predicted temperatures that confirms another unit of a clock
    # spans of measurements and conditions that differ by more than this factor are on clocks of two units
    max_span_ratio = 8.0
    min_entry_speed_m_s = 1000.0  # velocity below which a record is a ground test [m/s]
    read_s, flown_s = float(np.ptp(record.time_s)), float(np.ptp(record.conditions.time_s))
    if read_s <= 0.0 or flown_s <= 0.0 or 1.0 / max_span_ratio < read_s / flown_s < max_span_ratio:
        return None
    deceleration = float(np.ptp(record.conditions["velocity_m_s"])) / flown_s
    # the conditions are right where their clock makes a possible flight; the measurements' clock is then at fault
    is_ground_test = bool(record.conditions["velocity_m_s"].max() < min_entry_speed_m_s)
    conditions_right = is_ground_test or 0.05 < deceleration < 300.0
    for unit, seconds in UNITS.items():
        for factor in (seconds, 1.0 / seconds):
            if not 1.0 / max_span_ratio < factor * read_s / flown_s < 1.2:
                continue
            wrong = "thermocouples" if conditions_right else "flight conditions"
            unit_text = unit if (factor == seconds) == conditions_right else f"s where the other file has {unit}"
            correlation = _correlation_at(record, factor, conditions_right)
            if correlation > min_correlation:
                return DataFault(
                    CLOCK,
                    f"{record.name}: the clock of the {wrong} is in {unit_text}: measurements span {read_s:.4g} and "
                    f"conditions {flown_s:.4g}; with one of them multiplied by "
                    f"{factor if conditions_right else 1.0 / factor:g}, measured and predicted temperatures agree "
                    f"(correlation {correlation:.2f}). Give time_s in s.",
                )
    return None


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
        t, indicated_K = declared_readings(other)
    except RunError:
        return 0.0
    best = 0.0
    for measured, predicted in zip(other.temperatures_K(), indicated_K, strict=True):
        both = np.isfinite(measured) & (other.time_s >= t[0]) & (other.time_s <= t[-1])
        at = np.interp(other.time_s[both], t, predicted)
        if np.count_nonzero(both) > 10 and np.ptp(at) > 0.0 and np.ptp(measured[both]) > 0.0:
            best = max(best, float(np.corrcoef(measured[both], at)[0, 1]))
    return best


def declared_readings(record: Record) -> tuple[FloatArray, FloatArray]:
    """(time,) times of the conditions [s] and (sensor, time) readings that the declared model predicts [K].

    raises : RunError where it cannot be marched
    """
    history = march_points([point_of_record(record)], [conditions_of_record(record)])[0]
    pairs = zip(record.sensors, history.sensors_K, strict=True)
    return history.time_s, np.array([indicated_temperature(s, T) for s, T in pairs])


def start_fault(record: Record) -> DataFault | None:
    """A record that begins with a hot wall and declares a cold one; else None."""
    other = other_start(record)
    return DataFault(START, other.in_words) if other is not None and other.is_hot else None


def magnitude_fault(problem: FitProblem, values: FloatArray) -> DataFault | None:
    """A heating level that no error of a table explains, of a fit that explains its record; else None."""
    max_residual = 2.0  # residual over the noise below which a record is explained
    # limits of the relative error of a whole table; beyond them reference heating or trajectory is wrong
    plausible_scales = (-0.4, 0.6)
    if rms_normalised_residual(problem.samples(values)) > max_residual:
        return None
    record = problem.record_fits[0].record
    scale = problem.record_fits[0].values(values).get("ratio.scale")
    if scale is None or plausible_scales[0] < scale < plausible_scales[1]:
        return None
    return DataFault(
        TRAJECTORY,
        f"{record.name}: the heating is {1.0 + scale:.2g} times that of the declared table over its reference heating, "
        "throughout. No table has so large an error: check the reference heating (nose radius, units of density and "
        "of the film coefficient, the model that the ratio refers to) and the trajectory.",
    )


def with_noise(record: Record) -> tuple[Record, list[str]]:
    """The record with a noise for each sensor that declares none, from its readings alone, and a line on each.

    With the noise of a misfit as that of the sensor every model would explain the record.
    """
    sigma_K: dict[str, float] = {}
    for sensor, T in zip(record.sensors, record.temperatures_K(record.sensors), strict=True):
        if sensor.noise_sigma_K is None:
            sigma = noise_of_readings(record.time_s, T, sensor.lsb_K)
            sigma_K |= {} if sigma is None else {sensor.name: float(f"{sigma:.3g}")}
    sensors = [s.model_copy(update={"noise_sigma_K": sigma_K.get(s.name, s.noise_sigma_K)}) for s in record.sensors]
    lines = [
        f"sensor {name}: no noise is declared; {sigma:g} K, from differences of neighbouring readings; declare "
        "noise_sigma_K where it is known"
        for name, sigma in sigma_K.items()
    ]
    return record.with_sensors(sensors) if sigma_K else record, lines
