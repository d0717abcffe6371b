"""What looks like an effect and is none: a broken sensor, a clock in another unit, another material, another flight.

`before_fit` asks the record and one march of its declared model; `after_fit` asks a fit and its residual heating, and
refits only where something is left that no heating explains. Each verdict says by what it is seen.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sim_heating.closure.residual import ResidualHeating, SensorLeft, residual_heating
from sim_heating.closure.shapes import weights_of
from sim_heating.errors import RunError
from sim_heating.estimation.informed import STUCK
from sim_heating.estimation.newton import Settings, maximise
from sim_heating.estimation.problem import Problem
from sim_heating.points import conditions_of_record, point_of_record
from sim_heating.record import Record
from sim_heating.sensors import calibrated
from sim_heating.temperatures import march_points
from sim_heating.thermal.mesh import layer_diffusivities

FloatArray = NDArray[np.float64]

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
BETTER = 0.5
"""A shift, or another material, that leaves less than this part of the residual is told."""
SCALES = (-0.4, 0.6)
"""Relative errors of all tabulated ratios beyond these are no error of a table."""
FEWEST_STUCK = 30
BEYOND, AT_NOISE = 2.5, 1.6
"""A sensor beyond so many of its floors contradicts the others; those below the second are at their noise."""
MOST_LEFT_OUT, ALMOST = 3, 3.0
"""Sensors left out, one by one; and how much more heating may be missing without another for it to be named too."""
JUMP, SLOW = 12.0, 3.0
"""A sensor that jumps by so many floors from one sample to the next, at a depth that heat takes so many times longer to
reach."""
ABOUT = 8
"""Samples before and behind a jump whose medians are compared."""
EXPLAINED = 2.0
"""Residual over the noise below which a fit explains a record."""
FACTORS = (0.5, 2.0)
"""Diffusivity over the declared one beyond which it is another material."""
STARTS = (0.25, 1.0, 4.0)
INSULATION = ("stack.rsi.conductivity_factor", "stack.rsi.heat_capacity_factor")
QUICK = Settings(gain=1e-2, step=3e-2, iterations=20)


@dataclass(frozen=True)
class Verdict:
    """One finding.

    kind  : "broken sensor", "clock", "material", "trajectory"
    words : what is wrong, by what it is seen, what to do
    """

    kind: str
    words: str


# Before a fit --------------------------------------------------------------------------------------------------------


def before_fit(record: Record) -> list[Verdict]:
    """What the record itself tells: clocks, another flight's temperatures, a sensor that stands still.

    raises : RunError where the declared model cannot be marched
    """
    on_clock = clock(record)
    if on_clock is not None:
        return [on_clock]
    flown, indicated = _march(record)
    elsewhere = None if _on_ground(record) else shifted(record, flown, indicated)
    return ([] if elsewhere is None else [elsewhere]) + still(record, flown, indicated) + jumps(record)


def clock(record: Record) -> Verdict | None:
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
                return Verdict(
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


def shifted(record: Record, flown_s: FloatArray, indicated_K: FloatArray) -> Verdict | None:
    """Temperatures of a flight that is minutes earlier or later than the conditions say.

    Measured temperatures are fitted by a + b (predicted, moved by a shift), so that an error of the heating as a whole
    does not count.
    """
    used = [i for i, s in enumerate(record.sensors) if s.used]
    read, t = record.temperatures_K()[used], record.time_s
    asked = record.fit_mask()
    shifts = np.arange(-SHIFT_S, SHIFT_S + 1.0, SHIFT_STEP_S)
    left = np.array([_left_at(s, t[asked], read[:, asked], flown_s, indicated_K[used]) for s in shifts])
    now = _left_at(0.0, t[asked], read[:, asked], flown_s, indicated_K[used])
    if not np.any(np.isfinite(left)) or not np.isfinite(now):
        return None
    k = int(np.nanargmin(left))
    if abs(shifts[k]) < LEAST_SHIFT_S or left[k] > BETTER * now:
        return None
    word = "later" if shifts[k] > 0.0 else "earlier"
    return Verdict(
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


def still(record: Record, flown_s: FloatArray, indicated_K: FloatArray) -> list[Verdict]:
    """Sensors that stand still for a time in which the declared model moves them by many of their steps."""
    found = []
    for sensor, expected in zip(record.sensors, indicated_K, strict=True):
        read = record.thermocouples[sensor.column]
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
                Verdict(
                    SENSOR,
                    f"{record.name}, sensor {sensor.name}: stands still at {values[begins[k]]:.1f} K from "
                    f"{t[begins[k]]:.0f} to {t[ends[k]]:.0f} s, where the declared model moves it by {moves:.0f} K. It "
                    "is stuck; set used = false, or end the fit before.",
                )
            )
    return found


def jumps(record: Record) -> list[Verdict]:
    """Sensors in depth that jump beyond their steady rise, and stay, faster than heat diffuses to them."""
    found = []
    for sensor in record.used_sensors:
        read = record.thermocouples[sensor.column]
        known = np.isfinite(read)
        t, T = record.time_s[known], read[known]
        if len(T) < 4 * ABOUT or not _deep(record, sensor.depth_m, float(np.median(np.diff(t)))):
            continue
        floor = float(np.hypot(sensor.noise_sigma_K or 1.0, sensor.lsb_K / np.sqrt(12.0)))
        windows = np.median(np.lib.stride_tricks.sliding_window_view(T, ABOUT), axis=1)
        steps = np.diff(T)
        rise = np.median(np.lib.stride_tricks.sliding_window_view(steps, 2 * ABOUT - 1), axis=1)
        step = windows[ABOUT:] - windows[:-ABOUT] - ABOUT * rise
        alone = np.abs(steps[ABOUT - 1 : ABOUT - 1 + len(step)] - rise) > 0.5 * JUMP * floor
        sudden = np.where(alone, np.abs(step), 0.0)
        k = int(np.argmax(sudden))
        if sudden[k] > JUMP * floor:
            found.append(
                Verdict(
                    SENSOR,
                    f"{record.name}, sensor {sensor.name}: jumps by {step[k]:+.1f} K at {t[k + ABOUT]:.0f} s, faster "
                    "than heat reaches its depth. Set used = false, or end the fit before.",
                )
            )
    return found


def _deep(record: Record, depth_m: float, period_s: float) -> bool:
    """Whether heat takes SLOW times longer than a sample to a depth: (sum of dx / sqrt(a) over the layers)^2 / 4."""
    root_s, left = 0.0, depth_m
    for layer, a in zip(record.declared.stack.layer, layer_diffusivities(record.construction), strict=True):
        through = min(layer.thickness_m, left)
        root_s += through / np.sqrt(a)
        left -= through
    return bool(0.25 * root_s**2 > SLOW * period_s)


# After a fit ---------------------------------------------------------------------------------------------------------


def after_fit(problem: Problem, values: FloatArray, residual: ResidualHeating) -> list[Verdict]:
    """What the last fit of one record and its residual heating tell: magnitude, another material, sensors that
    contradict each other. What an effect explains is none of these: give the fit with all effects that were added."""
    left = _rms_in_floors(problem, values)
    if left < EXPLAINED:
        of_all = magnitude(problem, values)
        return [] if of_all is None else [of_all]
    if all(s.after_rmse_K < BEYOND * s.floor_K for s in residual.sensors):
        return []
    insulated = _insulation(problem, values)
    if insulated is not None and insulated[2] < EXPLAINED:
        return [v for v in (material(problem, insulated, left),) if v is not None]
    sensor = contradicting(problem, values, residual)
    if sensor is None and insulated is not None and insulated[2] < BETTER * left:
        sensor = material(problem, insulated, left)
    return [] if sensor is None else [sensor]


def magnitude(problem: Problem, values: FloatArray) -> Verdict | None:
    """Heating as a whole that no table is off by."""
    record = problem.parts[0].record
    scale = problem.parts[0].values(values).get("ratio.scale")
    if scale is None or SCALES[0] < scale < SCALES[1]:
        return None
    return Verdict(
        TRAJECTORY,
        f"{record.name}: the heating is {1.0 + scale:.2g} times that of the declared table over its reference heating, "
        "throughout. Tables are not off by so much: check the reference heating (nose radius, units of density and of "
        "the film coefficient, the model that the ratio is over) and the trajectory.",
    )


def contradicting(problem: Problem, values: FloatArray, residual: ResidualHeating) -> Verdict | None:
    """The one sensor without which the others agree with a heating history, unless an offset or a gain is all of it;
    of several, that without which the least heating is missing."""
    worst = sorted(residual.sensors, key=lambda s: -s.after_rmse_K / s.floor_K)
    tried = []
    for own in worst[:MOST_LEFT_OUT] if len(worst) > 1 else ():
        others = residual_heating(problem, values, without=own.sensor.name)
        if all(s.after_rmse_K < AT_NOISE * s.floor_K for s in others.sensors):
            tried.append((weights_of(others).best_gain, own, others))
    if not tried:
        return None
    gain, own, others = min(tried, key=lambda found: found[0])
    t, apart = _apart(residual.record, others, own)
    line = np.polyfit(own.read_K - np.mean(own.read_K), apart, 1)
    if np.std(apart - np.polyval(line, own.read_K - np.mean(own.read_K))) < AT_NOISE * own.floor_K:
        return None
    rivals = [o.sensor.name for g, o, _ in tried if o is not own and g < ALMOST * gain]
    either = f" Or it is {' or '.join(rivals)}: the record does not tell." if rivals else ""
    return Verdict(
        SENSOR,
        f"{residual.record.name}, sensor {own.sensor.name}: contradicts the others by what no heating can do: without "
        f"it a heating history explains them to their noise. It {_how(t, apart, own.floor_K)}. Set used = false."
        f"{either}",
    )


def _apart(record: Record, others: ResidualHeating, own: SensorLeft) -> tuple[FloatArray, FloatArray]:
    """Times and what a sensor shows beyond the heating that the others tell of, all its samples."""
    node = others.mesh.sensors[[s.name for s in record.sensors].index(own.sensor.name)]
    T = np.interp(own.time_s, others.march_s, others.input.temperature_K[:, node])
    return own.time_s, own.read_K - calibrated(own.sensor, T)


def _how(t: FloatArray, apart: FloatArray, floor_K: float) -> str:
    """A jump or a drift, whichever leaves less, in words."""
    begins = np.linspace(t[0], t[-1], 60)[:-3]
    forms: Mapping[str, Sequence[FloatArray]] = {
        "jumps": [(t > b).astype(float) for b in begins], "drifts": [np.maximum(t - b, 0.0) for b in begins],
    }  # fmt: skip
    best = ("", 0.0, 0.0, np.inf)
    for name, columns in forms.items():
        for begin, column in zip(begins, columns, strict=True):
            X = np.column_stack([np.ones_like(t), column])
            fit = np.linalg.lstsq(X, apart, rcond=None)[0]
            left = float(np.std(apart - X @ fit))
            if left < best[3]:
                best = (name, float(begin), float(fit[1]), left)
    name, begin, size, left = best
    if left > 0.5 * np.std(apart) and left > 3.0 * floor_K:
        return f"wanders by {np.std(apart):.1f} K (RMS)"
    if name == "jumps":
        return f"jumps by {size:+.1f} K at {begin:.0f} s"
    return f"drifts by {100.0 * size:+.2f} K in 100 s from {begin:.0f} s on"


def _insulation(problem: Problem, values: FloatArray) -> tuple[float, float, float] | None:
    """Factors of conductivity and heat capacity that are likeliest, and the residual with them over the noise; None
    where they cannot be fitted."""
    part = problem.parts[0]
    names = [n for n in part.names if n not in INSULATION]
    start = [part.values(values)[n] for n in names]
    other = Problem([part.record], [*names, *INSULATION], problem.reference, effects=part.model.effects, widened=np.inf)
    other.parts[0].sigma_K.update(part.sigma_K)
    first = np.array([[*start, k, 1.0] for k in STARTS])
    likely = other.log_likelihoods(first)
    if not np.any(np.isfinite(likely)):
        return None
    begin = first[int(np.nanargmax(likely))]
    fit = maximise(other.evaluate, other.parameters, begin, other.log_likelihoods, QUICK)
    if not np.isfinite(fit.log_likelihood):
        return None
    k, c = (other.parts[0].values(fit.values)[n] for n in INSULATION)
    return k, c, _rms_in_floors(other, fit.values)


def material(problem: Problem, insulated: tuple[float, float, float], before: float) -> Verdict | None:
    """Another insulation where its diffusivity is off by a large factor."""
    (k, c, left), part = insulated, problem.parts[0]
    if FACTORS[0] < k / c < FACTORS[1]:
        return None
    layers = part.record.declared.stack.layer
    layer = layers[min(1, len(layers) - 1)].material
    return Verdict(
        MATERIAL,
        f"{part.record.name}: layer `{layer}` is another material than declared: conductivity {k:.2g} and heat "
        f"capacity {c:.2g} times the declared ones, diffusivity {k / c:.2g} times, bring the residual from "
        f"{before:.1f} to {left:.1f} times the noise, and no heating history does. Check the material and its units "
        "before looking for an effect.",
    )


def _rms_in_floors(problem: Problem, values: FloatArray) -> float:
    """RMS of the residuals of a fit over the noise floor of each sensor."""
    squares, count = 0.0, 0
    for s in problem.samples(values):
        middle = s.part.record.thermocouples[s.channel.sensor.column]
        read = middle[np.searchsorted(s.part.record.time_s, s.time_s)]
        floor = np.hypot(s.sigma_K, s.channel.sensor.lsb_K / np.sqrt(12.0))
        squares, count = squares + float(np.sum(((read - s.mean_K) / floor) ** 2)), count + len(read)
    return float(np.sqrt(squares / count))
