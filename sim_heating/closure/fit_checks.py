"""Faults of a record that a fit shows: heating wrong by a factor, another material, sensors that contradict each other.

`check_fit` examines the last fit and its residual heating, and fits again only where no heating explains a residual.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

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
from sim_heating.inputs.sensor_model import indicated_temperature

PLAUSIBLE_SCALES = (-0.4, 0.6)
"""Limits of the relative error of a whole table; beyond them reference heating or trajectory is wrong."""
CONTRADICTION_FLOORS = 2.5
"""A sensor with a residual of more than this many noise floors contradicts the others."""
MAX_OMITTED, RIVAL_GAIN_RATIO = 3, 3.0
"""Sensors omitted in turn; and the ratio of missing heating up to which a second one may be the contradicting one."""
DIFFUSIVITY_LIMITS = (0.5, 2.0)
"""Diffusivity over the declared one beyond which it is another material."""
CONDUCTIVITY_STARTS = (0.25, 1.0, 4.0)
INSULATION = ("stack.rsi.conductivity_factor", "stack.rsi.heat_capacity_factor")
QUICK = NewtonSettings(min_improvement=1e-2, min_step=3e-2, iterations=20)


class InsulationFit(NamedTuple):
    """Likeliest factors of the insulation's properties [-], and the RMS residual with them over the noise floor."""

    conductivity: float
    heat_capacity: float
    residual: float


def check_fit(problem: FitProblem, values: FloatArray, residual: ResidualHeating) -> list[DataFault]:
    """Faults that the last fit of one record shows, one at most.

    problem, values : the fit with all effects that were added, since what an effect explains is no fault
    residual        : its residual heating
    """
    rms = _rms_in_floors(problem, values)
    if rms < EXPLAINED:
        factor = magnitude_fault(problem, values)
        return [] if factor is None else [factor]
    # A residual that some heating explains is a finding for the search of effects, not a fault of the data.
    if all(s.after_rmse_K < CONTRADICTION_FLOORS * s.floor_K for s in residual.sensors):
        return []
    # Another material before a broken sensor: it contradicts every heating history just as a sensor does.
    insulation = _insulation_fit(problem, values)
    if insulation is not None and insulation.residual < EXPLAINED:
        return [v for v in (material_fault(problem, insulation, rms),) if v is not None]
    fault = contradicting_sensor(problem, values, residual)
    if fault is None and insulation is not None and insulation.residual < MAX_REMAINING * rms:
        fault = material_fault(problem, insulation, rms)
    return [] if fault is None else [fault]


def magnitude_fault(problem: FitProblem, values: FloatArray) -> DataFault | None:
    """A heating level that no error of a table explains."""
    record = problem.record_fits[0].record
    scale = problem.record_fits[0].values(values).get("ratio.scale")
    if scale is None or PLAUSIBLE_SCALES[0] < scale < PLAUSIBLE_SCALES[1]:
        return None
    return DataFault(
        TRAJECTORY,
        f"{record.name}: the heating is {1.0 + scale:.2g} times that of the declared table over its reference heating, "
        "throughout. No table has so large an error: check the reference heating (nose radius, units of density and "
        "of the film coefficient, the model that the ratio refers to) and the trajectory.",
    )


def contradicting_sensor(problem: FitProblem, values: FloatArray, residual: ResidualHeating) -> DataFault | None:
    """The sensor without which the others agree with a heating history; of several, the one that leaves the least
    heating missing. None where an offset or a gain explains its residual."""
    worst = sorted(residual.sensors, key=lambda s: -s.after_rmse_K / s.floor_K)
    consistent = []
    for sensor in worst[:MAX_OMITTED] if len(worst) > 1 else ():
        others = residual_heating(problem, values, without=[sensor.sensor.name])
        if all(s.after_rmse_K < AT_NOISE * s.floor_K for s in others.sensors):
            consistent.append((profiled_information(others).best_gain, sensor, others))
    if not consistent:
        return None
    gain, suspect, others = min(consistent, key=lambda found: found[0])
    t, deviation_K = _deviation_K(residual.record, others, suspect)
    line = np.polyfit(suspect.read_K - np.mean(suspect.read_K), deviation_K, 1)
    about_line_K = deviation_K - np.polyval(line, suspect.read_K - np.mean(suspect.read_K))
    # A deviation on a straight line over temperature is a bias or gain, which the search has as a candidate.
    if np.std(about_line_K) < AT_NOISE * suspect.floor_K:
        return None
    rivals = [o.sensor.name for g, o, _ in consistent if o is not suspect and g < RIVAL_GAIN_RATIO * gain]
    either = f" It may be {' or '.join(rivals)} instead: the record cannot distinguish them." if rivals else ""
    return DataFault(
        SENSOR,
        f"{residual.record.name}, sensor {suspect.sensor.name}: contradicts the others in a way that no heating can "
        f"explain; without it, a heating history explains them to within their noise. It "
        f"{_describe_deviation(t, deviation_K, suspect.floor_K)}. Set used = false.{either}",
        suspect.sensor.name,
    )


def _deviation_K(record: Record, others: ResidualHeating, suspect: SensorResidual) -> tuple[FloatArray, FloatArray]:
    """(sample,) times [s] and readings of a sensor minus those of the heating history of the others [K]."""
    node = others.mesh.sensors[[s.name for s in record.sensors].index(suspect.sensor.name)]
    T = np.interp(suspect.time_s, others.march_s, others.input.temperature_K[:, node])
    return suspect.time_s, suspect.read_K - indicated_temperature(suspect.sensor, T)


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


def _insulation_fit(problem: FitProblem, values: FloatArray) -> InsulationFit | None:
    """The fit with free conductivity and heat capacity of the insulation; None where it cannot be made."""
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
    # From several conductivities: a wrong unit may be off by more than a search from the declared value bridges.
    starts = np.array([[*start, k, 1.0] for k in CONDUCTIVITY_STARTS])
    log_likelihoods = other.log_likelihoods(starts)
    if not np.any(np.isfinite(log_likelihoods)):
        return None
    likeliest = starts[int(np.nanargmax(log_likelihoods))]
    fit = maximise(other.evaluate, other.parameters, likeliest, other.log_likelihoods, QUICK)
    if not np.isfinite(fit.log_likelihood):
        return None
    k, c = (other.record_fits[0].values(fit.values)[n] for n in INSULATION)
    return InsulationFit(k, c, _rms_in_floors(other, fit.values))


def material_fault(problem: FitProblem, insulation: InsulationFit, rms_before: float) -> DataFault | None:
    """Another insulation than declared, where its diffusivity differs by a large factor.

    rms_before : RMS residual of the fit with the declared insulation, over the noise floor
    """
    (k, c, rms), part = insulation, problem.record_fits[0]
    if DIFFUSIVITY_LIMITS[0] < k / c < DIFFUSIVITY_LIMITS[1]:
        return None
    layers = part.record.declared.stack.layer
    layer = layers[min(1, len(layers) - 1)].material
    return DataFault(
        MATERIAL,
        f"{part.record.name}: layer `{layer}` is another material than declared: conductivity {k:.2g} and heat "
        f"capacity {c:.2g} times the declared ones, diffusivity {k / c:.2g} times, reduce the residual from "
        f"{rms_before:.1f} to {rms:.1f} times the noise, and no heating history does. Check the material and its units "
        "before looking for an effect.",
    )


def _rms_in_floors(problem: FitProblem, values: FloatArray) -> float:
    """RMS of the residuals of a fit over the noise floor of each sensor."""
    squares, count = 0.0, 0
    for s in problem.samples(values):
        measured = s.record_fit.record.thermocouples[s.channel.sensor.column]
        read = measured[np.searchsorted(s.record_fit.record.time_s, s.time_s)]
        floor, within = s.channel.sensor.noise_floor_K(s.sigma_K), s.channel.intervals.is_finite
        squares += float(np.sum(((read - s.mean_K)[within] / floor) ** 2))
        count += int(np.count_nonzero(within))
    return float(np.sqrt(squares / count))
