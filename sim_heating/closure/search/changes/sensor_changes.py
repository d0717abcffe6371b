"""Changes of the sensors that no effect is: swapped, in another unit, stuck, clipped, drifting, misplaced or broken.

Bias, gain and lag of a thermocouple are effects by name (candidates.py). What a cheap look at the readings and at the
fit without the change rules out is not offered: a sensor at its noise is not broken, two such sensors are not swapped.

Readings that a change makes worthless are taken out of the record, but not for nothing. Those of a stuck or clipped
thermocouple have their noise about the level that they keep; of clipped ones it remains that the temperature was not
short of it. Those of a broken one are scattered about the prediction of the model with their own root mean square,

    log L = sum_i log N(y_i; m_i, s^2),   s^2 = mean (y_i - m_i)^2

so that any cause that explains them is likelier. What is read off the readings counts as estimated: log(n) / 2 each.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from itertools import chain, combinations, starmap
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sim_heating.base.arrays import BoolArray, FloatArray, IntArray
from sim_heating.base.errors import RunError
from sim_heating.base.parameters import SENSOR, Parameter
from sim_heating.closure.clues.residual_heating import ResidualHeating, SensorResidual, residual_heating
from sim_heating.closure.search.trials.change import RecordChange
from sim_heating.closure.search.trials.trial_fit import TrialFit, declared_values, sample_count
from sim_heating.estimation.filter.heating_input import MAX_COARSE_KNOTS, interpolation_weights
from sim_heating.estimation.inference.likelihood import reading_intervals, scores
from sim_heating.estimation.inference.observability import STUCK
from sim_heating.estimation.problem import FitProblem
from sim_heating.estimation.record_fit import PredictedSamples, sensor_parameter
from sim_heating.inputs.record import Record
from sim_heating.inputs.sensor_model import indicated_temperature
from sim_heating.thermal.mesh import layer_diffusivities
from sim_heating.thermal.stack import Sensor

UNITS: Mapping[str, tuple[float, float]] = {
    "in degC, read as K": (-273.15, 1.0),
    "in degF, read as K": (-459.67, 1.0 / (5.0 / 9.0)),
    "in K, read as degC": (273.15, 1.0),
    "in K, read as degF": (459.67 * (5.0 / 9.0), 5.0 / 9.0),
}
"""Recorded over true temperature, c0 [K] and c1 [-], of a column in another unit or converted from one by mistake."""
AT_NOISE = 1.6
"""Residual over the noise below which a sensor is at its noise."""
OTHERS_MOVE = 3.0
"""Steps of its recorder that another sensor moves by while one is stuck, and the model where one is clipped."""


def sensor_changes(base: TrialFit) -> list[RecordChange]:
    """The changes of the sensors of a record that the model fitted to it does not rule out.

    base : the model, fitted to the record as declared

    Units, and readings that are equal for long, are seen in the readings themselves: a sensor with these is not
    examined further.
    """
    units, constant = unit_changes(base), constant_readings(base)
    seen = {*chain.from_iterable(units), *(name for _, name in constant)}
    in_readings = [*chain.from_iterable(units.values()), *(change for change, _ in constant)]
    return [*in_readings, *_changes_of_misfits(base, seen)]


def _changes_of_misfits(base: TrialFit, seen: Collection[str]) -> list[RecordChange]:
    """Changes of the sensors that the residuals do not rule out; seen : names of those with a fault in the readings."""
    # RMS of the normalised residuals of a sensor from which on it may be swapped, misplaced or broken
    misfit_floors = 2.0
    record, channels = base.record_fit.record, base.problem.samples(base.fit.values)
    others = [s for s in channels if s.channel.sensor.name not in seen]
    misfits = [
        s.channel.sensor for s in others if _rms_K(s) > misfit_floors * s.channel.sensor.noise_floor_K(s.sigma_K)
    ]
    return [
        *starmap(swap, combinations(misfits, 2)),
        *(drift(record, s.channel.sensor) for s in others if len(channels) > 1),
        *(depth(record, s) for s in misfits),
        *(broken_sensors(base) if misfits and len(others) == len(channels) > 1 else []),
    ]


def _rms_K(s: PredictedSamples) -> float:
    """RMS of the residuals of a channel [K], without readings at an end of the recorder's range; 0 without others."""
    read = _read_K(s)
    residual_K = (read - s.mean_K)[np.isfinite(read)]
    return float(np.sqrt(np.mean(residual_K**2))) if len(residual_K) else 0.0


def _read_K(s: PredictedSamples) -> FloatArray:
    """(sample,) readings of a channel [K], the middle of a recorder's word; NaN at an end of its range."""
    intervals = s.channel.intervals
    return np.asarray(np.where(intervals.is_finite, intervals.centre_K, np.nan))


# Swap, unit, drift, depth ---------------------------------------------------------------------------------------------


def _with_sensors(record: Record, changed: Callable[[Sensor], dict[str, object]]) -> Record:
    """The record with other declarations of its sensors."""
    return record.with_sensors([s.model_copy(update=changed(s)) for s in record.sensors])


def swap(a: Sensor, b: Sensor) -> RecordChange:
    """Each of two thermocouples is where the other is declared; recorders and columns stay as they are."""

    def apply(record: Record, _: float) -> Record:
        others = {a.name: b, b.name: a}

        def changed(s: Sensor) -> dict[str, object]:
            other = others.get(s.name)
            return {} if other is None else {"depth_m": other.depth_m, "tau_s": other.tau_s}

        return _with_sensors(record, changed)

    text = f"{a.name} and {b.name} swapped"
    return RecordChange("sensor", text, None, apply, lambda _: text)


def unit_changes(base: TrialFit) -> dict[frozenset[str], list[RecordChange]]:
    """Columns in another unit, by the names of their sensors: of all where all first readings say so, else of each."""
    record = base.record_fit.record
    used, changes = record.used_sensors, dict[frozenset[str], list[RecordChange]]()
    for text, line in UNITS.items():
        suspects = [s for s in used if _starts_nearer(record, s, line)]
        all_sensors = len(suspects) == len(used) > 1
        for sensors in [suspects] if all_sensors else [[s] for s in suspects]:
            names = "all thermocouples" if all_sensors else sensors[0].name
            changes.setdefault(frozenset(s.name for s in sensors), []).append(unit(base, sensors, names, text, line))
    return changes


def _starts_nearer(record: Record, sensor: Sensor, line: tuple[float, float]) -> bool:
    """Whether the first reading of a sensor is much nearer to the declared start in another unit."""
    # least distance of the first reading from the declared start that another unit is tried for [K], and the part of it
    # that may remain with the other unit [-]
    min_unit_error_K, unit_share = 20.0, 0.25
    stack, read = record.declared.stack, record.thermocouples[sensor.column]
    first = read[np.isfinite(read)][:1]
    if len(first) == 0:
        return False
    start_K = stack.initial_K
    if stack.initial_profile is not None:
        start_K = float(np.interp(sensor.depth_m, *np.array(stack.initial_profile).T))
    declared = sensor.calibration or [0.0, 1.0]
    expected = float(np.polynomial.Polynomial(declared)(start_K or 0.0))
    error_K = abs(float(first[0]) - expected)
    remaining_K = abs((float(first[0]) - line[0]) / line[1] - expected)
    return error_K > min_unit_error_K and remaining_K < unit_share * error_K


def unit(base: TrialFit, sensors: Sequence[Sensor], names: str, text: str, line: tuple[float, float]) -> RecordChange:
    """Columns of sensors that hold c0 + c1 T.

    sensors : of the columns;  names : of them, in words;  text : the unit in words;  line : c0 [K] and c1 [-]
    """
    sensor_names, (c0, c1) = {s.name for s in sensors}, line

    def apply(record: Record, _: float) -> Record:
        read = {s.column: (record.thermocouples[s.column] - c0) / c1 for s in record.sensors if s.name in sensor_names}
        return replace(record, thermocouples={**record.thermocouples, **read})

    def scale(problem: FitProblem | None) -> float:
        """Log of the density of unrounded readings in their own unit over that in K."""
        channels = problem.record_fits[0].channels if problem else []
        count = sum(len(c.samples) for c in channels if c.sensor.name in sensor_names and c.sensor.bits is None)
        return -count * math.log(c1)

    change_text, scales = f"{names} {text}", (scale(base.problem), scale(base.held_out))
    return RecordChange("sensor", change_text, None, apply, lambda _: change_text, known_log_likelihood=scales)


def drift(record: Record, sensor: Sensor) -> RecordChange:
    """A bias that grows from the first sample on, at a rate in K/s."""
    max_drift = 10.0  # largest drift that is tried, over the usual one [-]
    span_s = float(np.ptp(record.time_s))

    def apply(stated: Record, rate_K_s: float) -> Record:
        read = stated.thermocouples[sensor.column] - rate_K_s * (stated.time_s - stated.time_s[0])
        changed = replace(stated, thermocouples={**stated.thermocouples, sensor.column: read})
        return _with_sensors(changed, lambda s: {"bits": None} if s.name == sensor.name else {})

    def describe(rate_K_s: float) -> str:
        return f"{sensor.name} drifts by {rate_K_s * span_s:+.2g} K in {span_s:.0f} s"

    name, largest = sensor_parameter(sensor, "drift"), max_drift * SENSOR["drift"].sigma
    parameter = replace(SENSOR["drift"], name=name, lower=-largest, upper=largest)
    return RecordChange("sensor", f"drift of {sensor.name}", parameter, apply, describe, in_model=True)


def depth(record: Record, sensor: Sensor) -> RecordChange:
    """A thermocouple that is deeper than declared, or less deep, in m."""
    # usual error of the depth of a thermocouple, and the largest that is tried [m]
    depth_sigma_m, farthest_m = 5e-4, 0.01
    behind_m = record.declared.stack.thickness_m - sensor.depth_m
    error_parameter = Parameter(
        "depth_error_m", "m", 0.0, depth_sigma_m, -min(sensor.depth_m, farthest_m), min(behind_m, farthest_m),
        "true depth less the declared one",
    )  # fmt: skip

    def apply(stated: Record, error_m: float) -> Record:
        return _with_sensors(stated, lambda s: {"depth_m": s.depth_m + error_m} if s.name == sensor.name else {})

    def describe(error_m: float) -> str:
        return f"{sensor.name} {1e3 * abs(error_m):.2g} mm {'deeper' if error_m > 0.0 else 'less deep'} than declared"

    starts = tuple(x for x in (-4e-3, -1.5e-3, 1.5e-3, 4e-3) if error_parameter.lower < x < error_parameter.upper)
    return RecordChange("sensor", f"depth of {sensor.name}", error_parameter, apply, describe, starts)


# Readings that are worthless ------------------------------------------------------------------------------------------


def constant_readings(base: TrialFit) -> list[tuple[RecordChange, str]]:
    """Sensors whose readings do not change for long while the declared model and another sensor do.

    returns : changes, and the names of the sensors whose fault is certain, else empty. A sensor may be clipped at a
              range that is not declared where these are its largest or its least readings, which is certain where they
              are equal for long; else it is stuck where they are that
    """
    min_constant = 30  # readings that are equal one after the other from which on a sensor may be stuck or clipped
    record, changes = base.record_fit.record, list[tuple[RecordChange, str]]()
    # The fitted model may follow readings that do not change.
    try:
        declared = base.problem.samples(declared_values(base.problem))
    except RunError:  # a declared model that cannot be marched tells nothing
        return []
    for s in declared:
        sensor, t, read = s.channel.sensor, record.time_s, record.thermocouples[s.channel.sensor.column]
        run, step_K = _longest_constant(read), max(sensor.lsb_K, s.sigma_K)
        stuck = len(run) >= min_constant and _is_still(declared, s, read, t[run], STUCK * step_K)
        recovers = run[-1] < np.flatnonzero(np.isfinite(read))[-1]
        clipped = clipped_readings(read, s.sigma_K, sensor.lsb_K)
        if (
            clipped
            and (recovers or not stuck)
            and _is_still(declared, s, read, t[clipped.longest], OTHERS_MOVE * step_K)
        ):
            changes.append((_clip(base, s, read, clipped), sensor.name if stuck else ""))
        elif stuck:
            text = f"{sensor.name} stuck at {read[run[0]]:.1f} K from {t[run[0]]:.0f} to {t[run[-1]]:.0f} s"
            lost = np.isin(np.arange(len(read)), run)
            changes.append((_without(base, {sensor.name: lost}, text, float(read[run[0]])), sensor.name))
    return changes


def _is_still(
    channels: Sequence[PredictedSamples], s: PredictedSamples, read: FloatArray, run_s: FloatArray, least_K: float
) -> bool:
    """Whether a run of readings does not follow what the declared model and another sensor show, within its range.

    run_s : (run,) times [s];  least_K : by which the declared model changes in that time
    """
    inside = s.mean_K[(s.time_s >= run_s[0]) & (s.time_s <= run_s[-1])]
    level = read[np.isin(s.record_fit.record.time_s, run_s)]
    in_range = bool(reading_intervals(s.channel.sensor, np.array([np.median(level)])).is_finite[0])
    changes = len(inside) > 1 and bool(np.ptp(inside) > least_K)
    return in_range and changes and _others_move(channels, s.channel.sensor, (run_s[0], run_s[-1]))


def _others_move(channels: Sequence[PredictedSamples], stuck: Sensor, span_s: tuple[float, float]) -> bool:
    """Whether another sensor changes between two times [s]; true of a record that has no other."""
    others, (begin_s, end_s) = [s for s in channels if s.channel.sensor is not stuck], span_s
    for s in others:
        inside = _read_K(s)[(s.time_s >= begin_s) & (s.time_s <= end_s)]
        finite = inside[np.isfinite(inside)]
        if len(finite) and np.ptp(finite) > OTHERS_MOVE * max(s.channel.sensor.lsb_K, 2.0 * s.sigma_K):
            return True
    return not others


def _longest_constant(read: FloatArray) -> IntArray:
    """(run,) indices of the longest run of equal readings; lost ones within it do not end it."""
    finite = np.flatnonzero(np.isfinite(read))
    ends = np.append(np.flatnonzero(np.diff(read[finite]) != 0.0), len(finite) - 1)
    begins = np.append(0, ends[:-1] + 1)
    k = int(np.argmax(ends - begins))
    return np.asarray(finite[begins[k] : ends[k] + 1])


class ClippedReadings(NamedTuple):
    """Readings at an end of a range: whether the upper one, (reading,) which they are, (run,) indices of the longest
    run."""

    upper: bool
    which: BoolArray
    longest: IntArray


def clipped_readings(read: FloatArray, sigma_K: float, lsb_K: float) -> ClippedReadings | None:
    """The largest readings, or else the least, where they may be clipped before the noise; None where they may not.

    read : (reading,) readings [K], NaN where lost;  sigma_K, lsb_K : noise and word [K]

    They are constant but for noise and rounding, in one run or in several, such as before and after a manoeuvre. The
    least ones have to be reached: before a flight a wall is at rest. A broad maximum may look the same: whether the
    model without these readings explains the others, and is beyond them here, is for the fit to say.
    """
    level_floors = 6.0  # noise floors that readings on one level are within
    min_length = 15  # least length of a run that readings are clipped in
    even_sigmas = 5.0  # standard deviations by which the means of thirds of a run may differ
    finite = np.flatnonzero(np.isfinite(read))
    if len(finite) < min_length:
        return None
    floor_K = math.hypot(sigma_K, lsb_K / math.sqrt(12.0))
    for sign in (1.0, -1.0):
        y = sign * read[finite]
        level = float(np.median(y[y >= np.max(y) - level_floors * floor_K]))
        runs = _runs_at(y, level, floor_K)
        longest = max(runs, key=len)
        n = len(longest)
        if n < min_length or (sign < 0.0 and longest[0] == 0):
            continue
        # a level between two words is read as either
        scatter_K, largest_K = float(np.std(y[longest])), math.hypot(sigma_K, 0.5 * lsb_K)
        means = [float(np.mean(y[third])) for third in np.array_split(longest, 3)]
        if scatter_K < largest_K * (1.0 + 3.0 / math.sqrt(2.0 * n)) and np.ptp(means) <= even_sigmas * scatter_K * (
            math.sqrt(6.0 / n)
        ):
            which = np.zeros(len(read), dtype=bool)
            which[finite] = y >= level
            for run in runs:
                which[finite[run[0]] : finite[run[-1]] + 1] = True
            return ClippedReadings(sign > 0.0, which & np.isfinite(read), finite[longest])
    return None


def _runs_at(y: FloatArray, level: float, floor_K: float) -> list[IntArray]:
    """Runs of readings at a level, from the first to the last that is not below it by its noise; a few outliers do not
    end one.
    """
    clipped_floors = 3.0  # noise floors within which clipped readings are at the level
    most_outliers = 2  # readings one after the other that may be outside
    at = np.flatnonzero(y >= level - clipped_floors * floor_K)
    runs = []
    for run in np.split(at, np.flatnonzero(np.diff(at) > most_outliers + 1) + 1):
        high = run[y[run] >= level - floor_K]
        if len(high) > 1:
            runs.append(np.arange(high[0], high[-1] + 1))
    return runs or [at]


def _clip(base: TrialFit, s: PredictedSamples, read: FloatArray, clipped: ClippedReadings) -> RecordChange:
    """Readings at an end of the range that is not declared: the true ones are there or beyond.

    Their noise is about the likeliest level. What the model has to say of them is that it is not short of it:
    the end of the recorder's range becomes the word of that level (reading_intervals).
    """
    fine_word = 0.05  # word of a clipped thermocouple whose recorder has none, over its noise
    sensor, which = s.channel.sensor, clipped.which
    lsb_K, bits = sensor.lsb_K or fine_word * s.sigma_K, sensor.bits or 32
    intervals = reading_intervals(sensor, read[which])
    middle_K = float(np.median(read[which]))
    levels = middle_K + lsb_K * np.linspace(-1.0, 1.0, 41)
    level_K = float(max(levels, key=lambda x: scores(intervals, np.full(np.count_nonzero(which), x), s.sigma_K)[0]))
    end_K, span_K = middle_K + lsb_K * round((level_K - middle_K) / lsb_K), lsb_K * (2.0**bits - 1.0)
    range_K = [end_K - span_K, end_K] if clipped.upper else [end_K, end_K + span_K]

    def apply(record: Record, _: float) -> Record:
        at_end = np.where(which, end_K, record.thermocouples[sensor.column])
        changed = replace(record, thermocouples={**record.thermocouples, sensor.column: at_end})
        return _with_sensors(changed, lambda x: {"bits": bits, "range_K": range_K} if x.name == sensor.name else {})

    text = f"{sensor.name} clipped at {level_K:.0f} K, which is no declared end of its range"
    change = _without(base, {sensor.name: which}, text, level_K)
    # readings without a word have a density; those that are rounded to a fine one, a probability
    fine = [0.0 if sensor.bits else -math.log(lsb_K) * _count(p, sensor, which) for p in (base.problem, base.held_out)]
    log_likelihoods = tuple(a + b for a, b in zip(change.known_log_likelihood, fine, strict=True))
    return replace(change, apply=apply, known_log_likelihood=(log_likelihoods[0], log_likelihoods[1]))


def _count(problem: FitProblem | None, sensor: Sensor, lost: BoolArray) -> int:
    """Samples of a sensor in a problem without those lost."""
    if problem is None:
        return 0
    record_fit = problem.record_fits[0]
    at = record_fit.record.time_s[lost]
    channels = [c for c in record_fit.channels if c.sensor.name == sensor.name]
    return sum(int(np.count_nonzero(~np.isin(record_fit.sample_s[c.samples], at))) for c in channels)


def broken_sensors(base: TrialFit) -> list[RecordChange]:
    """Readings that carry no information: of each sensor whose readings show it, else of two.

    None where some heating explains all sensors: that is a missing effect and no broken sensor.
    """
    # sensors that may be broken, those that contradict a common heating most; and how many of them together, where none
    # alone is
    max_omitted, max_broken = 3, 2
    # noise floors beyond which the residual of a sensor contradicts the heating that explains the others
    contradiction_floors = 2.5
    residual = _heating_without(base, [])
    if residual is None:
        return []
    suspects = sorted(residual.sensors, key=lambda s: -s.after_rmse_K / s.floor_K)[:max_omitted]
    if suspects[0].after_rmse_K < contradiction_floors * suspects[0].floor_K:
        return []
    for count in range(1, min(max_broken, len(residual.sensors) - 1) + 1):
        changes = [_broken(base, c) for c in combinations(suspects, count)]
        if any(changes):
            return [change for change in changes if change is not None]
    return []


def _broken(base: TrialFit, suspects: Sequence[SensorResidual]) -> RecordChange | None:
    """The change without some sensors; None where their readings do not show a fault."""
    names = [s.sensor.name for s in suspects]
    others = _heating_without(base, names)
    if others is None or not _are_broken(others, suspects):
        return None
    deviations = [
        f"{s.sensor.name} {_describe_deviation(s.time_s, deviation_from(others, s), s.floor_K)}" for s in suspects
    ]
    text = f"{' and '.join(names)} broken"
    return _without(base, dict.fromkeys(names), text, description=f"{text}: {', '.join(deviations)}")


def _are_broken(others: ResidualHeating, suspects: Sequence[SensorResidual]) -> bool:
    """Whether a heating explains all other sensors to their noise, and the readings of each of these show a fault.

    A reading that heat cannot cause at its depth shows it by itself. Otherwise two other sensors have to show what the
    heating was, one of them at least as deep, which confirms the wall as well; the readings have to contradict that
    heating by changes that are slow enough to be resolved. A ripple that is faster may be heating.
    """
    if not all(s.after_rmse_K < AT_NOISE * s.floor_K for s in others.sensors):
        return False
    deepest_m = max(s.sensor.depth_m for s in others.sensors)
    confirmed = len(others.sensors) > 1 and not _deviate_alike(others, suspects)
    return all(
        is_too_rough(others, s) or (confirmed and s.sensor.depth_m <= deepest_m and is_resolved(others, s))
        for s in suspects
    )


def _heating_without(base: TrialFit, names: Collection[str]) -> ResidualHeating | None:
    """The heating that explains the sensors but for some; None where it cannot be found, its march failing."""
    try:
        return residual_heating(base.problem, base.fit.values, omitted=names)
    except RunError:
        return None


def _deviate_alike(others: ResidualHeating, suspects: Sequence[SensorResidual]) -> bool:
    """Whether two sensors deviate in the same way: a wrong wall, and not two faults."""
    min_correlation = 0.5  # correlation from which on two sensors deviate in the same way
    if len(suspects) < 2:
        return False
    a, b = suspects
    of_a, of_b = deviation_from(others, a), np.interp(a.time_s, b.time_s, deviation_from(others, b))
    return bool(abs(np.corrcoef(of_a, of_b)[0, 1]) > min_correlation)


def is_resolved(others: ResidualHeating, suspect: SensorResidual) -> bool:
    """Whether a sensor deviates from the heating that others show by changes no faster than a heating may have.

    The deviation is nearly all in lines between times as far apart as those of the coarse history.
    """
    max_fast_share = 0.25  # part of the mean square of a deviation that may be faster than the history of a heating
    deviation_K = deviation_from(others, suspect)
    at_s = np.linspace(suspect.time_s[0], suspect.time_s[-1], MAX_COARSE_KNOTS)
    weights = interpolation_weights(suspect.time_s, at_s)
    faster_K = deviation_K - weights @ np.linalg.lstsq(weights, deviation_K, rcond=None)[0]
    return bool(np.sum(faster_K**2) < max_fast_share * np.sum(deviation_K**2))


def is_too_rough(others: ResidualHeating, suspect: SensorResidual) -> bool:
    """Whether readings change faster than heat reaches the depth of their thermocouple.

    In half the time that heat takes, a temperature at that depth is nearly a parabola in time. Compared with the
    prediction, since the heating, or a layer that conducts better than declared, may bend it a little.
    """
    rougher = 3.0  # how much rougher than the prediction readings may be
    least_samples = 8  # that half the time of diffusion has to hold
    record, t = others.record, suspect.time_s
    span_s = 0.5 * _diffusion_time_s(record, suspect.sensor.depth_m)
    if span_s < least_samples * float(np.median(np.diff(t))):
        return False
    predicted_K = suspect.read_K - deviation_from(others, suspect)
    allowed_K = max(AT_NOISE * suspect.floor_K, rougher * _roughness_K(t, predicted_K, span_s, least_samples))
    return _roughness_K(t, suspect.read_K, span_s, least_samples) > allowed_K


def _diffusion_time_s(record: Record, depth_m: float) -> float:
    """Time that heat takes to a depth [s]: (sum of dx / sqrt(a) over layers)^2 / 4."""
    root_s, remaining_m = 0.0, depth_m
    for layer, a in zip(record.declared.stack.layer, layer_diffusivities(record.construction), strict=True):
        through = min(layer.thickness_m, remaining_m)
        root_s += through / np.sqrt(a)
        remaining_m -= through
    return float(0.25 * root_s**2)


def _roughness_K(t: FloatArray, values_K: FloatArray, span_s: float, least_samples: int) -> float:
    """RMS about a parabola in each span of a history [K]."""
    squares, count = 0.0, 0
    for span in np.array_split(np.arange(len(t)), max(math.ceil(float(np.ptp(t)) / span_s), 1)):
        if len(span) > least_samples:
            x = (t[span] - t[span[0]]) / span_s
            about_K = values_K[span] - np.polyval(np.polyfit(x, values_K[span], 2), x)
            squares, count = squares + float(about_K @ about_K), count + len(span) - 3
    return math.sqrt(squares / count) if count else 0.0


def deviation_from(others: ResidualHeating, suspect: SensorResidual) -> FloatArray:
    """(sample,) readings of a sensor less what the heating that others show gives there [K]."""
    node = others.mesh.sensors[[s.name for s in others.record.sensors].index(suspect.sensor.name)]
    T_K = np.interp(suspect.time_s, others.march_s, others.input.temperature_K[:, node])
    return np.asarray(suspect.read_K - indicated_temperature(suspect.sensor, T_K))


def _describe_deviation(t: FloatArray, deviation_K: FloatArray, floor_K: float) -> str:
    """A deviation in words: a jump or a drift, whichever fits better, or neither."""
    begins = np.linspace(t[0], t[-1], 60)[:-3]
    forms: Mapping[str, Sequence[FloatArray]] = {
        "jumps": [(t > b).astype(float) for b in begins], "drifts": [np.maximum(t - b, 0.0) for b in begins],
    }  # fmt: skip
    best = ("", 0.0, 0.0, np.inf)
    for name, columns in forms.items():
        for begin, column in zip(begins, columns, strict=True):
            X = np.column_stack([np.ones_like(t), column])
            fit = np.linalg.lstsq(X, deviation_K, rcond=None)[0]
            remaining = float(np.std(deviation_K - X @ fit))
            if remaining < best[3]:
                best = (name, float(begin), float(fit[1]), remaining)
    name, begin, size, remaining = best
    if remaining > 0.5 * np.std(deviation_K) and remaining > 3.0 * floor_K:
        return f"wanders by {np.std(deviation_K):.1f} K (RMS)"
    if name == "jumps":
        return f"jumps by {size:+.1f} K at {begin:.0f} s"
    return f"drifts by {100.0 * size:+.2f} K in 100 s from {begin:.0f} s on"


def _without(
    base: TrialFit,
    lost: Mapping[str, NDArray[np.bool_] | None],
    text: str,
    level_K: float | None = None,
    description: str = "",
) -> RecordChange:
    """Readings that are taken out of the record.

    lost    : by name of the sensor, (sample,) which of its readings; None for all
    level_K : about which they have their noise; None where they scatter about the model fitted to the record as
              declared
    description   : the change in words, with what shows it; else the text
    """

    def apply(record: Record, _: float) -> Record:
        read = dict(record.thermocouples)
        for s in record.sensors:
            if s.name in lost:
                which = lost[s.name]
                read[s.column] = np.where(True if which is None else which, np.nan, read[s.column])
        return replace(record, thermocouples=read)

    fitted = base.problem.samples(base.fit.values) if level_K is None else []
    rms_K = {s.channel.sensor.name: _rms_K(s) for s in fitted}
    log_likelihoods = [
        0.0 if problem is None else _log_likelihood_of(problem, base.fit.values, lost, rms_K, level_K)
        for problem in (base.problem, None if base.held_out_chi2 == 0.0 else base.held_out)
    ]
    cost = 0.5 * math.log(sample_count(base.problem)) * (len(lost) if level_K is None else 2)
    return RecordChange(
        "sensor",
        text,
        None,
        apply,
        lambda _: description or text,
        known_log_likelihood=(log_likelihoods[0] - cost, log_likelihoods[1]),
        broken=tuple(name for name, which in lost.items() if which is None),
    )


def _log_likelihood_of(
    problem: FitProblem,
    values: FloatArray,
    lost: Mapping[str, NDArray[np.bool_] | None],
    rms_K: Mapping[str, float],
    level_K: float | None,
) -> float:
    """Log likelihood of the readings of a problem that a change takes out, at the estimates.

    rms_K : scatter about the predictions by sensor;  level_K : about which readings have their noise; else None
    """
    total, record = 0.0, problem.record_fits[0].record
    for s in problem.samples(values):
        name = s.channel.sensor.name
        if name not in lost:
            continue
        which = lost[name]
        at = np.isin(s.time_s, record.time_s if which is None else record.time_s[which])
        intervals = s.channel.intervals.select(at)
        mean_K = s.mean_K[at] if level_K is None else np.full(np.count_nonzero(at), level_K)
        total += scores(intervals, mean_K, rms_K.get(name, s.sigma_K))[0]
    return total
