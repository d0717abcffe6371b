"""What an effect does to the heating along a record."""

from __future__ import annotations

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.base.errors import RunError
from sim_heating.closure.search.trials.candidates import Candidate
from sim_heating.closure.search.trials.trial_fit import TrialFit, fitted_effects
from sim_heating.heating.effects import effects
from sim_heating.march.ensemble import condition_history


def heating_change(trial: TrialFit, candidate: Candidate) -> FloatArray | None:
    """(sample,) relative change of the heating by an effect that multiplies it, over the samples of its record [-].

    None for any other effect, for one that depends on what was before, and where the record cannot be marched.
    """
    effect = effects().get(candidate.name)
    if effect is None or effect.kernel is None or effect.mode != "multiply" or effect.lags:
        return None
    used = next(u for u in fitted_effects(trial) if u.effect.name == candidate.name)
    try:
        marched = trial.prediction
    except RunError:
        return None
    t, covered = marched.history.time_s, marched.conditions.time_s
    # readings by a clock that is off may be taken beyond the ends of the conditions
    read = np.isfinite(marched.history.surface_K) & (t >= covered[0]) & (t <= covered[-1])
    flown = condition_history(marched.conditions.at(t[read]))
    wall_K = marched.history.surface_K[read]
    factors = [
        effect.kernel(np.array([*row, *used.values]), 0, len(row), T) for row, T in zip(flown, wall_K, strict=True)
    ]
    return np.array(factors or [1.0]) - 1.0
