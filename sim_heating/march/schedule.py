"""Schedule of time steps that a fit keeps: the division that control of the step finds in a first march."""

from __future__ import annotations

import numpy as np

from sim_heating.base.arrays import FloatArray, IntArray
from sim_heating.base.errors import RunError
from sim_heating.base.kernels import block
from sim_heating.march.ensemble import Ensemble
from sim_heating.march.linearised import Track
from sim_heating.thermal.frame import FINEST, NOT_CONTROLLED_K, STEP_TOLERANCE_K


def divided_times(
    track: Track, time_s: FloatArray, history: FloatArray, tolerance_K: float = STEP_TOLERANCE_K
) -> FloatArray:
    """Times of a march with the ends of all steps into which control divides its intervals.

    track       : the point, its mesh and its temperatures at the start
    time_s      : (time,) ends of the undivided steps [s];  history : (flight, time, condition) along them
    tolerance_K : largest error of a step at any node [K]; from NOT_CONTROLLED_K on nothing is divided
    returns     : (time,) increasing [s], those given among them; those given alone where the march fails

    Temperatures and sensitivities of a march in these steps are smooth in its parameters, as those of a march whose
    division follows the parameters are not. Derived in docs/theory/equations_thermal_step.md, section 9.
    """
    if tolerance_K >= NOT_CONTROLLED_K:
        return time_s
    flown = history[track.flight]
    ensemble = Ensemble([track.model], [track.mesh], step_s=np.inf, tolerance_K=tolerance_K)
    _begin(ensemble, track)
    counted = np.array([ensemble.lane_offsets[0].scalar(block.STEPS)], dtype=np.int64)
    try:
        steps = ensemble.march(time_s, flown[np.newaxis], keep=counted)[:, 0]
    except RunError:
        return time_s
    divided = np.flatnonzero(np.diff(steps) > 1.0)
    if len(divided) == 0:
        return time_s
    _begin(ensemble, track)
    return np.union1d(time_s, _ends(ensemble, time_s, flown, divided))


def _begin(ensemble: Ensemble, track: Track) -> None:
    ensemble.reset()
    if track.initial_K is not None:
        ensemble.set_profile(0, track.initial_K)


def _ends(ensemble: Ensemble, time_s: FloatArray, flown: FloatArray, divided: IntArray) -> FloatArray:
    """Ends of the steps within the intervals that are divided, by halving each as the kernel does."""
    ends: list[float] = []
    ensemble.begin(flown[:1])
    for k in range(1, len(time_s)):
        if k - 1 in divided:
            ends += _halve(ensemble, time_s[k - 1 : k + 1], flown[k - 1 : k + 1])
        else:
            ensemble.advance(flown[k : k + 1], time_s[k] - time_s[k - 1])
    return np.array(ends)


def _halve(ensemble: Ensemble, span_s: FloatArray, ends: FloatArray) -> list[float]:
    """March an interval between two condition vectors (2, condition); ends of its steps [s], its own left out."""
    step_ends: list[float] = []
    begin, length = 0, FINEST
    while begin < FINEST:
        before, done = ensemble.snapshot(), ensemble.counters.steps[0]
        after = (begin + length) / FINEST
        then = ends[1] if begin + length == FINEST else ends[0] + after * (ends[1] - ends[0])
        ensemble.advance(then[np.newaxis], (span_s[1] - span_s[0]) * length / FINEST)
        if ensemble.counters.steps[0] - done > 1.0 and length > 1:
            ensemble.restore(before)
            length //= 2
        else:
            begin += length
            step_ends.append(float(span_s[0] + begin / FINEST * (span_s[1] - span_s[0])))
            length = begin & -begin
    return step_ends[:-1]
