"""Check of predicted bounds by repeated fits of simulated readings, with truths drawn from the priors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.base.errors import RunError
from sim_heating.base.parameters import Parameter
from sim_heating.base.progress import Progress, no_progress
from sim_heating.estimation.design.information import Experiment
from sim_heating.estimation.inference.likelihood import reading_intervals
from sim_heating.estimation.inference.newton import maximise
from sim_heating.estimation.problem import FitOptions, FitProblem, joint_reference
from sim_heating.estimation.record_fit import Start
from sim_heating.heating.effects import EffectUse
from sim_heating.inputs.record import Record
from sim_heating.inputs.sensor_model import quantise
from sim_heating.thermal.stack import Sensor


@dataclass(frozen=True, eq=False)
class RepeatedFits:
    """Errors of repeated fits.

    names  : (parameter,);  error : (fit, parameter) estimate minus truth
    failed : number of fits that did not converge; they are not in `error`
    """

    names: tuple[str, ...]
    error: FloatArray
    failed: int

    def rms_error(self, names: Sequence[str]) -> FloatArray:
        """(names,) root mean square errors."""
        at = [self.names.index(n) for n in names]
        return np.sqrt(np.mean(self.error[:, at] ** 2, axis=0))


def repeated_fits(
    record: Record,
    experiment: Experiment,
    *,
    effects: Sequence[EffectUse] = (),
    start: Start | None = None,
    repetitions: int = 200,
    progress: Progress = no_progress,
) -> RepeatedFits:
    """Simulate and fit the readings of a record repeatedly, each time with another truth.

    experiment  : unknowns, without the factor on the surface pressure, and their priors
    effects     : in addition to the declared model;  start : of the march
    repetitions : number of fits
    raises      : RunError where no fit converges
    """
    seed = 1  # of the random numbers
    priors = {p.name: p for p in experiment.unknowns}
    of_start = {} if start is None else {u.name: priors[u.name] for u in start.unknowns}
    begin = None if start is None else replace(start, unknowns=tuple(of_start.values()))
    names = [n for n in experiment.names if n not in of_start]
    options = FitOptions(effects=effects, priors=priors, starts=[begin])
    problem = FitProblem([record], names, joint_reference([record]), options)
    parameters, record_fit = problem.parameters, problem.record_fits[0]
    rng = np.random.default_rng(seed)
    errors = []
    for k in range(repetitions):
        truth = draw_truth(parameters, rng)
        record_fit.channels = [
            replace(
                s.channel,
                intervals=reading_intervals(
                    s.channel.sensor, _simulated_readings(s.channel.sensor, s.mean_K, s.channel.noise_K(s.sigma_K), rng)
                ),
            )
            for s in problem.samples(truth)
        ]
        # from the prior means and not from the truth, as a fit to a flight would
        fit = maximise(problem.evaluate, parameters, log_likelihoods=problem.log_likelihoods)
        if fit.converged:
            errors.append(fit.values - truth)
        progress((k + 1) / repetitions, f"fits: {k + 1} of {repetitions}")
    if not errors:
        raise RunError(f"design: none of {repetitions} fits converged")
    return RepeatedFits(tuple(p.name for p in parameters), np.array(errors), repetitions - len(errors))


def draw_truth(parameters: Sequence[Parameter], rng: np.random.Generator) -> FloatArray:
    """(parameter,) a truth from the priors, drawn again where outside the bounds; the value itself for a flat prior."""
    values = []
    for p in parameters:
        value = p.value
        while np.isfinite(p.sigma):
            value = rng.normal(p.value, p.sigma)
            if p.lower < value < p.upper:
                break
        values.append(value)
    return np.array(values)


def _simulated_readings(
    sensor: Sensor, mean_K: FloatArray, sigma_K: FloatArray | float, rng: np.random.Generator
) -> FloatArray:
    return quantise(sensor, mean_K + rng.normal(0.0, sigma_K, len(mean_K)))
