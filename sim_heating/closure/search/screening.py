"""Which candidates are fitted on top of a model, and how far.

Candidates begin where they have no effect yet. There the gain of a candidate is known from its sensitivities alone;
the best starts of each are then fitted, LANES of them side by side, those that fall behind for some steps only.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.base.parameters import EFFECT_PREFIX
from sim_heating.closure.search.candidates import Candidate, Form
from sim_heating.closure.search.trial_fit import QUICK, TrialFit, candidate_problem, fitted_values, start_values
from sim_heating.estimation.inference.identifiability import covariance, predicted_gain
from sim_heating.estimation.inference.likelihood import scores
from sim_heating.estimation.inference.newton import Fit, Status
from sim_heating.estimation.problem import FitProblem
from sim_heating.estimation.record_fit import PredictedSamples
from sim_heating.estimation.side_by_side import JointMarch, maximise_together

STARTS_FITTED = 2
"""Starts of a set of parameters that are fitted, the most promising ones."""
NEAR = 0.5
"""Part of the best promise from which on several starts of a candidate are fitted."""
BEHIND = 0.25
"""Part of the best promise below which a candidate is not fitted."""
WORTH = 5.0
"""By how much a promised gain in log likelihood may fall short of what its parameters cost."""
STAGES = (
    (0.0, replace(QUICK, iterations=4)), (0.9, replace(QUICK, iterations=8)), (0.5, replace(QUICK, iterations=8)),
    (0.8, QUICK),
)  # fmt: skip
"""Part of the best gain that a candidate has to have reached to be fitted further, and how far."""
PATIENCE = 0.8
"""Part of the best gain from which on what a candidate promised at first keeps it in the second stage."""
HOPE = 3.0
"""Steps like the next one that keep a candidate, if their promises would make it the best; one in the last stage."""
CLOSE = 5.0
"""By how much its log likelihood may stay behind the best where it is fitted to the end."""


def predicted_gains(base: TrialFit, tried: Sequence[Candidate]) -> list[float]:
    """Gain in log likelihood that the linearisation of each candidate at its start promises, the base's parameters
    moving with it; minus infinity where the model cannot be marched there.

    The base's own sensitivities hold for all: a candidate begins without any effect, or little.
    """
    part, start = base.problem.record_fits[0], fitted_values(base)
    fixed = {n: start[n] for n in part.march_names if not n.startswith(EFFECT_PREFIX)}
    problems = [
        candidate_problem(base, part, c, tuple(dict.fromkeys((*part.sensor_names, *c.felt))), fixed=fixed)
        for c in tried
    ]
    firsts = [start_values(p, {**start, **c.start}) for p, c in zip(problems, tried, strict=True)]
    known = np.concatenate([s.sensitivity for s in base.problem.samples(base.fit.values)])
    inner = known[:, [k for k, n in enumerate(part.names) if n not in part.sensor_names]]
    marched, scored = JointMarch(problems).march(firsts), _Scored()
    return [
        _promise(problem, first, inner, scored) - base.fit.log_likelihood if done else -np.inf
        for problem, first, done in zip(problems, firsts, marched, strict=True)
    ]


class _Scored(dict[tuple[int, bytes], tuple[float, FloatArray, FloatArray]]):
    """likelihood.scores of channels, each prediction scored once: before they act, many candidates predict the same."""

    def of(self, s: PredictedSamples) -> tuple[float, FloatArray, FloatArray]:
        """Those of one channel."""
        key = s.channel.number, s.mean_K.tobytes()
        if key not in self:
            self[key] = scores(s.channel.intervals, s.mean_K, s.sigma_K)
        return self[key]


def _promise(problem: FitProblem, first: FloatArray, known: FloatArray, scored: _Scored) -> float:
    """Log likelihood that a Gauss-Newton step promises; `known` (sample, parameter): the base's sensitivities."""
    everything = problem.samples(first)
    found = [scored.of(s) for s in everything]
    score, weight = np.concatenate([f[1] for f in found]), np.concatenate([f[2] for f in found])
    own = np.concatenate([s.sensitivity for s in everything])
    gradient, information = score @ own, weight @ own**2
    lower = np.array([p.lower for p in problem.parameters])
    upper = np.array([p.upper for p in problem.parameters])
    held = ((first <= lower) & (gradient <= 0.0)) | ((first >= upper) & (gradient >= 0.0))
    J = np.column_stack([known, own[:, ~held & (information > 0.0)]])
    M = J.T @ (J * weight[:, np.newaxis])
    return sum(f[0] for f in found) + predicted_gain(J.T @ score, covariance(M))


def select_candidates(tried: Sequence[Candidate], gains: Sequence[float], n: int) -> list[int]:
    """Which candidates are fitted: the most promising starts of each form, but none that promises much less than the
    best, or too little to be worth its parameters."""
    most = max(gains, default=0.0)
    count: dict[Form, int] = {}
    chosen = []
    for i in sorted(range(len(tried)), key=lambda i: -gains[i]):
        form = tried[i].form
        allowed = STARTS_FITTED if gains[i] > NEAR * most else 1
        worth = gains[i] > max(BEHIND * most, 0.5 * np.log(n) * len(tried[i].names) - WORTH)
        if worth and count.get(form, 0) < allowed:
            count[form] = count.get(form, 0) + 1
            chosen.append(i)
    return chosen


def fit_in_stages(
    problems: Sequence[FitProblem], firsts: Sequence[FloatArray], reached: float, promised: Sequence[float]
) -> list[Fit]:
    """Fit all a little way, those that came near the best gain over `reached` further, or promised as much, and the
    best to the end, but for those that are not going to reach the best."""
    fits = maximise_together(problems, firsts, STAGES[0][1])
    history = [_gains(fits, reached)]
    for stage, (within, settings) in enumerate(STAGES[1:], start=1):
        best = float(np.max(history[-1], initial=0.0))
        near, step = history[-1] >= within * best, np.array([f.predicted_gain for f in fits])
        if stage == 1:
            near |= (np.array(promised) >= PATIENCE * best) | (history[-1] + HOPE * step >= best)
        elif stage == 2:
            near &= history[-1] + HOPE * step >= best - CLOSE
        else:
            near &= np.minimum(_hoped(history), history[-1] + step) >= best - CLOSE
        again = [k for k in range(len(fits)) if near[k] and fits[k].status is Status.ITERATIONS]
        further = maximise_together([problems[k] for k in again], [fits[k].values for k in again], settings)
        for k, fit in zip(again, further, strict=True):
            fits[k] = fit
        history.append(_gains(fits, reached))
    return fits


def _gains(fits: Sequence[Fit], reached: float) -> FloatArray:
    return np.nan_to_num([f.log_likelihood - reached for f in fits], nan=-np.inf)


def _hoped(history: Sequence[FloatArray]) -> FloatArray:
    """Where gains end if each stage adds the same part of what the one before it did, twice that allowed."""
    with np.errstate(invalid="ignore", divide="ignore"):
        before, last = history[-2] - history[-3], history[-1] - history[-2]
        more = np.where(last < before, last**2 / (before - last), np.where(last > 0.0, np.inf, 0.0))
    return history[-1] + 2.0 * np.nan_to_num(more, nan=np.inf, posinf=np.inf)
