"""The model that candidates are added to, and one candidate fitted on top of it.

A search marches fewer nodes and conditions than a fit; what that and the mesh change at the declared model is taken
out. Segments that are held out are marched the same way, and never fitted: what a candidate makes of them is evidence.

A record as a search marches it: with no more samples of its conditions than those between which they are as good as
linear, and on half the nodes. What that changes is taken out where the search begins (search.py).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import Conditions
from sim_heating.base.errors import InputError, RunError
from sim_heating.base.parameters import CLOCK_SKEW, Parameter
from sim_heating.closure.search.candidates import Candidate
from sim_heating.estimation.fit import FitResult, lag1_autocorrelation, predict_fit, rms_normalised_residual
from sim_heating.estimation.inference.newton import Fit, NewtonSettings
from sim_heating.estimation.problem import SKEW_SPAN_S, FitOptions, FitProblem
from sim_heating.estimation.record_fit import RecordFit
from sim_heating.estimation.side_by_side import maximise_together
from sim_heating.heating.effects import EffectUse
from sim_heating.inputs.points import conditions_of_record
from sim_heating.inputs.record import Record
from sim_heating.simulation.predict import Prediction

AGREEMENT = 0.25
"""Part of their sample interval to which two recorders' clocks are taken to agree unless shown otherwise."""
WIDENED = 3.0
"""Priors of effects' parameters are this much wider in the search: enough to keep a first step within reason."""
NODES_PART, FEWEST_NODES = 1.0 / 3.0, 14
"""Nodes that a search marches, over those of a fit; and how many it has at least."""
QUICK = NewtonSettings(
    min_improvement=0.05,
    min_step=0.2,
    iterations=25,
    step_fractions=(0.5, 0.25, 0.1, 0.03, 0.01, 1e-3),
    trust_radius=0.4,
)


@dataclass(frozen=True, eq=False)
class TrialFit:
    """One candidate fitted on top of a model.

    problem   : over the samples that are fitted;  held_out : over those that are not, None where there are none
    delta_bic : its BIC minus that of the model without it, residuals taken as noise (c = 1)
    weighed   : the same with c of the best model, and with all else that speaks for or against it
    posterior : its probability among all candidates that it was weighed with
    """

    name: str
    candidate: Candidate
    problem: FitProblem
    held_out: FitProblem | None
    fit: Fit
    delta_bic: float = 0.0
    weighed: float = 0.0
    posterior: float = 0.0

    @property
    def prediction(self) -> Prediction:
        """The record at the values found."""
        return predict_fit(self.problem.record_fits[0], self.fit.values)

    @property
    def excess(self) -> float:
        """Mean square of the normalised residuals, beyond that of noise."""
        return rms_normalised_residual(self.problem.samples(self.fit.values)) ** 2 - 1.0

    @property
    def lasting(self) -> float:
        """What of them lasts from one sample to the next."""
        return lag1_autocorrelation(self.problem.samples(self.fit.values))

    @property
    def likelihood_held_out(self) -> float:
        """Log likelihood of the samples held out, at the values found; minus infinity where they cannot be marched."""
        if self.held_out is None:
            return 0.0
        found = self.held_out.evaluate(self.fit.values).log_likelihood
        return found if np.isfinite(found) else -np.inf

    @property
    def square_held_out(self) -> float:
        """Mean square of their normalised residuals; 0 where there are none, or they cannot be marched."""
        if self.held_out is None or self.likelihood_held_out == -np.inf:
            return 0.0
        return rms_normalised_residual(self.held_out.samples(self.fit.values)) ** 2


def base_trial(before: FitResult) -> TrialFit:
    """The declared model with its magnitude and derivatives, and a clock that may be a little off."""
    whole = before.problem.record_fits[0]
    start = {**dict(zip(whole.names, before.fit.values, strict=True)), CLOCK_SKEW.name: 0.0}
    fitted, held = whole.record.fit_mask(), whole.record.holdout_mask()
    quick = thin_record(whole.record, max(int(NODES_PART * whole.mesh.nodes), FEWEST_NODES))
    full = _over(before, whole.record, fitted | held)
    error_K, at_s = _changed_by_thinning(full, _over(before, quick, fitted | held, longest_step_s=MAX_STEP_S), start)

    def over(chosen: NDArray[np.bool_]) -> FitProblem:
        problem = _over(before, quick, chosen, longest_step_s=MAX_STEP_S)
        part = problem.record_fits[0]
        part.correction_K = error_K[:, np.isin(at_s, part.sample_s)]
        return problem

    problem = over(fitted)
    try:
        held_out = over(held) if np.any(held) else None
    except InputError:  # nothing was measured there
        held_out = None
    fit = maximise_together([problem], [start_values(problem, start)], QUICK)[0]
    return TrialFit("none", Candidate("none", (), (), {}, (), ()), problem, held_out, fit)


def _over(before: FitResult, record: Record, chosen: NDArray[np.bool_], **more: Any) -> FitProblem:
    """The declared model over some of the samples of a record, whole or thinned."""
    whole = before.problem.record_fits[0]
    interval = float(np.median(np.diff(whole.record.time_s)))
    off = min(AGREEMENT * interval, SKEW_SPAN_S)
    clock = {CLOCK_SKEW.name: replace(CLOCK_SKEW, lower=-off, upper=off)}
    names = (*whole.names, CLOCK_SKEW.name)
    problem = FitProblem(
        [record],
        names,
        before.problem.reference,
        FitOptions(priors=clock, prior_scale=WIDENED, sample_masks=[chosen], **more),
    )
    problem.record_fits[0].sigma_K.update(whole.sigma_K)
    return problem


def _changed_by_thinning(
    full: FitProblem, quick: FitProblem, start: Mapping[str, float]
) -> tuple[FloatArray, FloatArray]:
    """(sensor, sample) what the record as it is, on a mesh without error, adds to the thinned one, and the times."""
    at, part = start_values(full, start), full.record_fits[0]
    full.correct_meshes(at)
    try:
        exact, coarse = (p.record_fits[0].with_mesh_correction(p.marched(at)[0]).temperature_K for p in (full, quick))
    except RunError:  # a model so wrong that it cannot be marched everywhere: the quick march stands as it is
        return np.zeros((len(part.mesh.sensors), len(part.sample_s))), part.sample_s
    return exact - coarse, part.sample_s


def problem_with(base: TrialFit, candidate: Candidate) -> FitProblem:
    """The base's problem with a candidate's unknowns."""
    return candidate_problem(base, base.problem.record_fits[0], candidate, _names(base, candidate), prior_scale=WIDENED)


def held_out_problem_with(base: TrialFit, candidate: Candidate) -> FitProblem | None:
    """The same over the samples held out."""
    if base.held_out is None:
        return None
    part = base.held_out.record_fits[0]
    chosen = [part.record.holdout_mask()]
    return candidate_problem(base, part, candidate, _names(base, candidate), prior_scale=WIDENED, sample_masks=chosen)


def _names(base: TrialFit, candidate: Candidate) -> tuple[str, ...]:
    return tuple(dict.fromkeys((*base.problem.record_fits[0].names, *candidate.names)))


def candidate_problem(
    base: TrialFit, part: RecordFit, candidate: Candidate, names: Sequence[str], **more: Any
) -> FitProblem:
    """A part of the base with a candidate's effects beside those found, its noise, what is known of its mesh, and a
    clock that goes no further than in the base unless that is what the candidate moves."""
    uses = (*fitted_effects(base), *candidate.uses)
    priors: dict[str, Parameter] = dict(base.problem.priors)
    if CLOCK_SKEW.name in candidate.names:
        priors[CLOCK_SKEW.name] = replace(CLOCK_SKEW, lower=-SKEW_SPAN_S, upper=SKEW_SPAN_S)
    more |= {"effects": uses, "priors": priors, "longest_step_s": MAX_STEP_S}
    problem = FitProblem([part.record], names, base.problem.reference, FitOptions(**more))
    problem.record_fits[0].sigma_K.update(part.sigma_K)
    problem.record_fits[0].correction_K = part.correction_K
    return problem


def start_values(problem: FitProblem, start: Mapping[str, float]) -> FloatArray:
    """Values to start from, those of the priors where none are given."""
    return np.array([start.get(p.name, p.value) for p in problem.parameters])


def fitted_values(attempt: TrialFit) -> dict[str, float]:
    """Values found, by dotted name."""
    return dict(zip((u.parameter.name for u in attempt.problem.unknowns), attempt.fit.values, strict=True))


def fitted_effects(attempt: TrialFit) -> tuple[EffectUse, ...]:
    """The effects of an attempt's model at the values found."""
    return attempt.problem.record_fits[0].model_at(attempt.fit.values).effects


def sample_count(problem: FitProblem) -> int:
    """Number of its samples."""
    return sum(len(channel.samples) for part in problem.record_fits for channel in part.channels)


MAX_STEP_S = 2.0
"""Longest step between the samples that are kept [s]."""
TOLERANCES = {
    "alpha_deg": 0.1, "beta_deg": 0.1, "log10_re": 0.01, "elevon_deg": 0.2, "bodyflap_deg": 0.2, "jets": 0.02,
}  # fmt: skip
"""By how much a sample may lie off the line between those that are kept, in its own unit."""
HEATING = 0.002
"""And the heating of a cold wall, over the greatest of the flight."""


def thin_record(record: Record, nodes: int) -> Record:
    """The record with fewer samples of its conditions, and `nodes` nodes where it needs no more for its sensors."""
    flown = conditions_of_record(record)
    stack = record.declared.stack.model_copy(update={"nodes": nodes})
    declared = record.declared.model_copy(update={"stack": stack})
    return replace(record, declared=declared, conditions=record.conditions.at(flown.time_s[thinned_indices(flown)]))


def thinned_indices(flown: Conditions) -> NDArray[np.int64]:
    """(kept,) numbers of the samples that are kept, the first and the last among them."""
    t = flown.time_s
    heating = flown["h_ref_kg_m2_s"] * flown["H_r_J_kg"]
    greatest = float(np.max(np.abs(heating)))
    columns = [heating / (HEATING * greatest)] if greatest > 0.0 else []
    columns += [flown[name] / tolerance for name, tolerance in TOLERANCES.items() if name in flown]
    x = np.column_stack(columns)
    kept = [0]
    while kept[-1] < len(t) - 1:
        i = kept[-1]
        j = max(int(np.searchsorted(t, t[i] + MAX_STEP_S * (1.0 + 1e-9), side="right")) - 1, i + 1)
        while j > i + 1 and not _straight(t[i : j + 1], x[i : j + 1]):
            j -= 1
        kept.append(j)
    return np.array(kept, dtype=np.int64)


def _straight(t: FloatArray, x: FloatArray) -> bool:
    """Whether all samples lie within 1 of the line from the first to the last."""
    part = (t - t[0]) / (t[-1] - t[0])
    return bool(np.all(np.abs(x - x[0] - part[:, np.newaxis] * (x[-1] - x[0])) <= 1.0))
