"""Curves of last resort: what a residual follows, as a smooth factor on the heating with its band.

Where no effect is adequate, a spline in one variable (heating/effects/curve.py) is fitted together with the model, for
each variable in turn. It states no cause. It is what a table or an effect of one's own would have to contain.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from sim_heating.base.conditions import RATIO_VARIABLES
from sim_heating.base.files import write_csv
from sim_heating.closure.search.trials.candidates import Candidate, candidates
from sim_heating.closure.search.trials.screening import fit_in_stages, predicted_gains
from sim_heating.closure.search.trials.trial_fit import TrialFit, delta_bic, with_held_out
from sim_heating.heating.effects.curve import CURVE, FIRST, TIME, VARIABLE, VARIABLES, CurveBand, curve_band
from sim_heating.inputs.points import conditions_of_record

NAME = "curve.csv"
"""File of a curve beside a closure report."""


def curve_trials(base: TrialFit) -> list[TrialFit]:
    """A curve in each variable on top of a model, the best first.

    returns : trials, by BIC and the segments held out, each over the chi-square of the best; empty where a curve is in
              the model already. Time comes first only where it leaves less than half of what any other variable does:
              any residual is a function of time.
    """
    min_gain_share = 0.1  # part of the best predicted gain below which a curve is not fitted
    record = base.record_fit.record
    flown = conditions_of_record(record)
    everything = candidates(record, flown.at(flown.time_s[record.fit_mask(flown.time_s)]), last_resort=True)
    tried = [c for c in everything if c.name == CURVE]
    gains = predicted_gains(base, tried)
    least = min_gain_share * max(gains, default=0.0)
    chosen = [(c, gain) for c, gain in zip(tried, gains, strict=True) if gain > least]
    fits = fit_in_stages(
        [base] * len(chosen), [c for c, _ in chosen], [gain for _, gain in chosen], base.fit.log_likelihood
    )
    fits = [t for t in fits if np.isfinite(t.fit.log_likelihood)]
    return _ranked(base, [with_held_out(base, t) for t in fits])


def _ranked(base: TrialFit, trials: Sequence[TrialFit]) -> list[TrialFit]:
    """Trials with their scores, the best first and time as `curve_trials` states."""
    # excess chi-square that a curve in time may leave at most, over the least of the other variables, to be preferred
    max_excess_of_time = 0.5
    if not trials:
        return []
    c = max(1.0, 1.0 + min(t.excess_chi2 for t in trials))
    held_out = max(1.0, min((t.held_out_chi2 for t in trials if t.held_out_chi2 > 0.0), default=1.0))

    def score(t: TrialFit) -> float:
        gained = t.held_out_log_likelihood - base.held_out_log_likelihood
        return delta_bic(base, t.fit, t.candidate, c) - 2.0 * gained / held_out

    scored = sorted((replace(t, score=score(t)) for t in trials), key=lambda t: t.score)
    others = [t for t in scored if not _is_in_time(t.candidate)]
    if others and _is_in_time(scored[0].candidate):
        least = min(max(t.excess_chi2, 0.0) for t in others)
        if scored[0].excess_chi2 > max_excess_of_time * least:
            return [*others, scored[0]]
    return scored


def _is_in_time(candidate: Candidate) -> bool:
    (used,) = candidate.uses
    return used.values[VARIABLE] == TIME


def curve_of(trial: TrialFit) -> CurveBand:
    """The curve of a trial with its standard deviation, at 61 even points from its first knot to its last.

    It is 0 at the reference condition of the fit; at the middle of its knots where that has not its variable.
    trial  : one with a curve in its model
    raises : InputError where its covariance is not known
    """
    (used,) = (u for u in trial.record_fit.model_at(trial.fit.values).effects if u.effect.name == CURVE)
    names = [u.parameter.name for u in trial.problem.unknowns]
    at = [names.index(n) for n in trial.candidate.names]
    number, low, high = used.values[:FIRST]
    name, reference = VARIABLES[int(number)], dict(zip(RATIO_VARIABLES, trial.problem.reference, strict=True))
    about = float(np.clip(reference.get(name, 0.5 * (low + high)), low, high))
    return curve_band(used.values, trial.fit.covariance[np.ix_(at, at)], np.linspace(low, high, 61), about)


def curve_words(band: CurveBand) -> str:
    """What a curve says, in a line: its change where it is largest, its least, and the standard deviations of both."""
    high, low = int(np.argmax(band.value)), int(np.argmin(band.value))
    unit = "" if band.unit == "1" else f" {band.unit}"
    ends = [f"{band.value[i]:+.1%} +- {band.sigma[i]:.1%} at {band.at[i]:.4g}{unit}" for i in (low, high)]
    return f"the heating departs with {band.label}: {ends[0]}, {ends[1]}"


def write_curve(path: Path, band: CurveBand) -> None:
    """Write a curve as CSV: its variable, the relative change of the heating ratio [-], and its standard deviation."""
    columns = {band.variable: band.at, "relative_change": band.value, "sigma": band.sigma}
    write_csv(path, columns, header={"what": f"factor on the heating ratio less 1, against {band.label}"})
