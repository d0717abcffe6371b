"""A gap in the frames, or a clock that jumped ahead: the conditions tell how long it was.

Over a gap altitude, speed and density go on as they did before; where the clock jumped they do so for less. Neither the
numbers of the frames nor the time of their arrival is asked: what is told of a flight depends on its samples alone.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from sim_heating.live.types import Frame

FRAMES = 40
"""Frames before it that a rate of change is taken from."""
STEADY = 0.05
"""Root mean square of what a steady column leaves a straight line by, over its change along that line, at most [-]."""
LONGEST_OVER = 30.0
"""Time over which a rate is taken to last, over the time in which it was found [-]."""
OF_GAP, OF_JUMP = 0.8, 0.7
"""Part of the time by the clock that passed by the conditions: at least in a gap, and at most where it jumped [-]."""
LONG_OVER, OF_LONG_GAP, OF_LONG_JUMP = 2.0, 0.6, 0.3
"""Part of the time that passed by the conditions, at least in a long gap and at most where the clock jumped far [-].

A time is long beyond LONG_OVER times that in which the rates were found: they change meanwhile."""


def passed_s(frames: Sequence[Frame], next_frame: Frame) -> float | None:
    """The time [s] in which the conditions go on from the last frames to one after them; None where none is steady.

    The median of the columns that changed steadily before.

    >>> from sim_heating.live.types import Frame
    >>> flown = [Frame(0.5 * k, {"altitude_m": 7e4 - 30.0 * 0.5 * k}) for k in range(9)]
    >>> passed_s(flown, Frame(9.0, {"altitude_m": 7e4 - 30.0 * 5.0}))
    1.0
    """
    recent = frames[-FRAMES:]
    if len(recent) < 3:
        return None
    time_s = np.array([f.time_s for f in recent]) - recent[-1].time_s
    passed = []
    for name in recent[-1].values:
        if name not in next_frame.values or any(name not in f.values for f in recent):
            continue
        values = np.array([f.values[name] for f in recent])
        slope, at_last = np.polyfit(time_s, values, 1)
        off = float(np.sqrt(np.mean((values - at_last - slope * time_s) ** 2)))
        if off < STEADY * abs(slope * time_s[0]):
            passed.append((next_frame.values[name] - at_last) / slope)
    return float(round(np.median(passed), 6)) if passed else None


def is_gap(frames: Sequence[Frame], next_frame: Frame) -> bool | None:
    """Whether frames are missing between the last ones and one after them, rather than a clock that jumped ahead.

    None where the conditions do not tell: none of them is steady, or the time is long over that in which they are seen.
    """
    if len(frames) < 3:
        return None
    apart_s = next_frame.time_s - frames[-1].time_s
    seen_s = frames[-1].time_s - frames[max(0, len(frames) - FRAMES)].time_s
    passed = passed_s(frames, next_frame)
    if passed is None or not math.isfinite(passed) or apart_s > LONGEST_OVER * seen_s:
        return None
    of_gap, of_jump = (OF_LONG_GAP, OF_LONG_JUMP) if apart_s > LONG_OVER * seen_s else (OF_GAP, OF_JUMP)
    ratio = passed / apart_s
    return True if ratio >= of_gap else False if ratio <= of_jump else None
