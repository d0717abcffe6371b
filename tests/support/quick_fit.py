"""A fit to one record from given starts, converged loosely: enough to compare many models."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.base.errors import RunError
from sim_heating.base.parameters import Parameter
from sim_heating.estimation.fit import fit_bounds, predict_fit
from sim_heating.estimation.inference.newton import Fit, NewtonSettings, maximise
from sim_heating.estimation.problem import FitOptions, FitProblem, joint_reference
from sim_heating.heating.effects import EffectUse
from sim_heating.inputs.record import Record
from sim_heating.simulation.predict import predict

SETTLED = NewtonSettings(min_improvement=1e-2, min_step=3e-2, iterations=20)


@dataclass(frozen=True, eq=False)
class Model:
    """A fitted model of one record."""

    problem: FitProblem
    fit: Fit

    @property
    def residual_K(self) -> FloatArray:
        """(sensor, sample) measured less predicted of the plain march, to the last sample fitted or held out."""
        return predict_fit(self.problem.record_fits[0], self.fit.values).residual_K

    @property
    def whole_residual_K(self) -> FloatArray:
        """(sensor, sample) measured less predicted over the whole record, of which the fit may cover little."""
        part = self.problem.record_fits[0]
        return predict(part.record, part.model_at(self.fit.values)).residual_K

    @property
    def values(self) -> dict[str, float]:
        """Values by name."""
        return dict(zip((u.label for u in self.problem.unknowns), self.fit.values, strict=True))

    @property
    def sigma(self) -> dict[str, float]:
        """Sigma by name, corrected for coloured residuals."""
        found = fit_bounds(self.problem.samples(self.fit.values), self.fit).sigma
        return dict(zip((u.label for u in self.problem.unknowns), found, strict=True))


def quick_fit(
    record: Record,
    names: Sequence[str],
    starts: Sequence[Mapping[str, float]] = ({},),
    *,
    effects: Sequence[EffectUse] = (),
    reference: tuple[float, ...] | None = None,
    priors: Mapping[str, Parameter] | None = None,
    flat: bool = True,
) -> Model:
    """The likeliest fit of all starts (values by name, nominal where not given).

    raises : RunError where no start can be marched
    """
    best: Model | None = None
    about = joint_reference([record]) if reference is None else reference
    for start in starts:
        problem = FitProblem(
            [record], names, about, FitOptions(effects=effects, priors=priors, prior_scale=np.inf if flat else 1.0)
        )
        first = np.array([start.get(p.name, p.value) for p in problem.parameters])
        try:
            fit = maximise(problem.evaluate, problem.parameters, first, problem.log_likelihoods, SETTLED)
            found = Model(problem, fit)
            np.asarray(found.residual_K)  # some values can be linearised about and not marched
        except RunError:
            continue
        if best is None or found.fit.log_likelihood > best.fit.log_likelihood:
            best = found
    if best is None:
        raise RunError(f"{record.name}: the model cannot be marched from any start")
    return best
