"""What looks like an effect in a fit and is none: another magnitude or material, sensors that contradict each other.

`after_fit` asks the fit and its residual heating, and refits only where something is left that no heating explains.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.closure.clues.residual_heating import ResidualHeating, SensorResidual, residual_heating
from sim_heating.closure.clues.shapes import profiled_information
from sim_heating.closure.record_checks import (
    AT_NOISE,
    EXPLAINED,
    MATERIAL,
    MAX_REMAINING,
    SENSOR,
    TRAJECTORY,
    DataFault,
)
from sim_heating.estimation.inference.newton import NewtonSettings, maximise
from sim_heating.estimation.problem import FitOptions, FitProblem
from sim_heating.inputs.record import Record
from sim_heating.inputs.sensor_model import calibrated

SCALES = (-0.4, 0.6)
"""Relative errors of all tabulated ratios beyond these are no error of a table."""
BEYOND = 2.5
"""A sensor beyond so many of its floors contradicts the others."""
MOST_LEFT_OUT, ALMOST = 3, 3.0
"""Sensors left out, one by one; and how much more heating may be missing without another for it to be named too."""
FACTORS = (0.5, 2.0)
"""Diffusivity over the declared one beyond which it is another material."""
STARTS = (0.25, 1.0, 4.0)
INSULATION = ("stack.rsi.conductivity_factor", "stack.rsi.heat_capacity_factor")
QUICK = NewtonSettings(min_improvement=1e-2, min_step=3e-2, iterations=20)


def check_fit(problem: FitProblem, values: FloatArray, residual: ResidualHeating) -> list[DataFault]:
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
    if sensor is None and insulated is not None and insulated[2] < MAX_REMAINING * left:
        sensor = material(problem, insulated, left)
    return [] if sensor is None else [sensor]


def magnitude(problem: FitProblem, values: FloatArray) -> DataFault | None:
    """Heating as a whole that no table is off by."""
    record = problem.record_fits[0].record
    scale = problem.record_fits[0].values(values).get("ratio.scale")
    if scale is None or SCALES[0] < scale < SCALES[1]:
        return None
    return DataFault(
        TRAJECTORY,
        f"{record.name}: the heating is {1.0 + scale:.2g} times that of the declared table over its reference heating, "
        "throughout. Tables are not off by so much: check the reference heating (nose radius, units of density and of "
        "the film coefficient, the model that the ratio is over) and the trajectory.",
    )


def contradicting(problem: FitProblem, values: FloatArray, residual: ResidualHeating) -> DataFault | None:
    """The one sensor without which the others agree with a heating history, unless an offset or a gain is all of it;
    of several, that without which the least heating is missing."""
    worst = sorted(residual.sensors, key=lambda s: -s.after_rmse_K / s.floor_K)
    tried = []
    for own in worst[:MOST_LEFT_OUT] if len(worst) > 1 else ():
        others = residual_heating(problem, values, without=own.sensor.name)
        if all(s.after_rmse_K < AT_NOISE * s.floor_K for s in others.sensors):
            tried.append((profiled_information(others).best_gain, own, others))
    if not tried:
        return None
    gain, own, others = min(tried, key=lambda found: found[0])
    t, apart = _apart(residual.record, others, own)
    line = np.polyfit(own.read_K - np.mean(own.read_K), apart, 1)
    if np.std(apart - np.polyval(line, own.read_K - np.mean(own.read_K))) < AT_NOISE * own.floor_K:
        return None
    rivals = [o.sensor.name for g, o, _ in tried if o is not own and g < ALMOST * gain]
    either = f" Or it is {' or '.join(rivals)}: the record does not tell." if rivals else ""
    return DataFault(
        SENSOR,
        f"{residual.record.name}, sensor {own.sensor.name}: contradicts the others by what no heating can do: without "
        f"it a heating history explains them to their noise. It {_how(t, apart, own.floor_K)}. Set used = false."
        f"{either}",
        own.sensor.name,
    )


def _apart(record: Record, others: ResidualHeating, own: SensorResidual) -> tuple[FloatArray, FloatArray]:
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


def _insulation(problem: FitProblem, values: FloatArray) -> tuple[float, float, float] | None:
    """Factors of conductivity and heat capacity that are likeliest, and the residual with them over the noise; None
    where they cannot be fitted."""
    part = problem.record_fits[0]
    names = [n for n in part.names if n not in INSULATION]
    start = [part.values(values)[n] for n in names]
    other = FitProblem(
        [part.record],
        [*names, *INSULATION],
        problem.reference,
        FitOptions(effects=part.model.effects, prior_scale=np.inf),
    )
    other.record_fits[0].sigma_K.update(part.sigma_K)
    first = np.array([[*start, k, 1.0] for k in STARTS])
    likely = other.log_likelihoods(first)
    if not np.any(np.isfinite(likely)):
        return None
    begin = first[int(np.nanargmax(likely))]
    fit = maximise(other.evaluate, other.parameters, begin, other.log_likelihoods, QUICK)
    if not np.isfinite(fit.log_likelihood):
        return None
    k, c = (other.record_fits[0].values(fit.values)[n] for n in INSULATION)
    return k, c, _rms_in_floors(other, fit.values)


def material(problem: FitProblem, insulated: tuple[float, float, float], before: float) -> DataFault | None:
    """Another insulation where its diffusivity is off by a large factor."""
    (k, c, left), part = insulated, problem.record_fits[0]
    if FACTORS[0] < k / c < FACTORS[1]:
        return None
    layers = part.record.declared.stack.layer
    layer = layers[min(1, len(layers) - 1)].material
    return DataFault(
        MATERIAL,
        f"{part.record.name}: layer `{layer}` is another material than declared: conductivity {k:.2g} and heat "
        f"capacity {c:.2g} times the declared ones, diffusivity {k / c:.2g} times, bring the residual from "
        f"{before:.1f} to {left:.1f} times the noise, and no heating history does. Check the material and its units "
        "before looking for an effect.",
    )


def _rms_in_floors(problem: FitProblem, values: FloatArray) -> float:
    """RMS of the residuals of a fit over the noise floor of each sensor."""
    squares, count = 0.0, 0
    for s in problem.samples(values):
        middle = s.record_fit.record.thermocouples[s.channel.sensor.column]
        read = middle[np.searchsorted(s.record_fit.record.time_s, s.time_s)]
        floor, within = s.channel.sensor.noise_floor_K(s.sigma_K), s.channel.intervals.is_finite
        squares += float(np.sum(((read - s.mean_K)[within] / floor) ** 2))
        count += int(np.count_nonzero(within))
    return float(np.sqrt(squares / count))
