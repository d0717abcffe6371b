"""Readings that are none: codes of recorders, and single readings far off their neighbours.

A reading is far off where it lies outside those of its six neighbours by more than SIGMAS times the robust scale of
such distances (1.4826 times their median) and by more than those neighbours differ among themselves.

source of the scale: Huber, Robust Statistics, section 5.1 (median absolute deviation); fault words: Keysight 34970A
user's guide (overload 9.9E+37), Maxim MAX31855 (full scale 2047.75 degC at an open input), DS18B20 (85 degC at power
on)
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from sim_heating.base.arrays import BoolArray, FloatArray

OVERLOAD = 1e30
"""A larger magnitude is the overload of a recorder, in any unit."""
_NINES = (999.0, 999.9, 9999.0, 9999.9, 99999.0)
_FULL_SCALES = (2048.0, 2047.0, 2047.75, 2047.9375, 1372.0, 1370.0, 32767.0, -32768.0, 65535.0, 6553.5, 3276.7, -127.0)
OPEN = (*_FULL_SCALES, *_NINES)
"""Readings of a converter whose input is open or at the end of its range, and rows of nines of loggers."""
POWER_ON = 85.0
"""The first readings of a converter that has measured nothing yet."""
DROPPED = (0.0, POWER_ON)
"""Readings of a converter that gave none, which may as well be true ones."""
SIGMAS, LEAST, SMALLEST = 12.0, 3.0, 1.0
"""Distance from which a reading is far off: in robust scales, in spans of its neighbours, and in the file's unit."""
SIDE = 3
"""Neighbours on each side."""


def lost_codes(values: FloatArray, codes: Sequence[float]) -> BoolArray:
    """(row,) whether a reading is one of the codes, or an overload."""
    is_lost: BoolArray = np.abs(values) >= OVERLOAD
    for code in codes:
        is_lost |= np.isclose(values, code, rtol=1e-6, atol=1e-9)
    return is_lost


def fault_codes(values: FloatArray) -> BoolArray:
    """(row,) whether a reading is the code of a converter in fault: one of its values, far off the readings around it.

    A run of a code is compared with the readings on both sides; one at an end, of an open input alone, with that of one
    side. The value at power on may also come first, where the readings behind it are lower and do not fall on.
    """
    is_fault = np.zeros(len(values), dtype=bool)
    for code in (*OPEN, *DROPPED):
        is_code = np.isclose(values, code, rtol=0.0, atol=1e-9)
        others = np.flatnonzero(np.isfinite(values) & ~is_code)
        if not is_code.any() or len(others) < 3:
            continue
        # a steady heating leaves nothing in second differences, whose noise is larger by the root of 3
        steady, moving = (1.4826 * float(np.median(np.abs(np.diff(values[others], n)))) for n in (2, 1))
        for i in np.flatnonzero(is_code):
            is_fault[i] = _is_fault(code, int(np.searchsorted(others, i)), values[others], steady, moving)
    return is_fault


def _is_fault(code: float, k: int, others: FloatArray, steady: float, moving: float) -> bool:
    """Whether a code that comes before reading k of the others is one of a fault.

    steady, moving : noise of the others under a steady heating, and with what moves them
    """
    sides = [others[j] for j in (k - 1, k) if 0 <= j < len(others)]
    is_at_end = len(sides) < 2
    if is_at_end and code in DROPPED and not _is_at_power_on(code, k, others):
        return False
    scale = moving if is_at_end and code in OPEN else min(moving, steady / math.sqrt(3.0))
    apart = abs(sides[0] - sides[-1])
    return bool(min(abs(x - code) for x in sides) > max(SIGMAS * scale, LEAST * apart, 10.0 * SMALLEST))


def _is_at_power_on(code: float, k: int, others: FloatArray) -> bool:
    """Whether a code comes before k other readings as that of power on does: first, and these do not fall on."""
    return bool(code == POWER_ON and k == 0 and others[0] < min(code, others[1]))


def far_off(values: FloatArray) -> BoolArray:
    """(row,) whether a reading is far off its neighbours. Lost ones, NaN, have none."""
    is_far = np.zeros(len(values), dtype=bool)
    finite = np.flatnonzero(np.isfinite(values))
    if len(finite) < 2 * SIDE + 3:
        return is_far
    v = values[finite]
    around = np.stack([_shifted(v, k) for k in (*range(-SIDE, 0), *range(1, SIDE + 1))])
    ordered = np.sort(around, axis=0)  # NaN beyond the ends last
    count = np.sum(np.isfinite(around), axis=0)
    each = np.arange(len(v))
    middle = 0.5 * (ordered[(count - 1) // 2, each] + ordered[count // 2, each])  # their median
    # without the most extreme one, which may be another bad reading; at the ends neighbours stand on one side, and
    # count
    inner = count == 2 * SIDE
    low = np.where(inner, ordered[1], ordered[0])
    high = ordered[np.where(inner, count - 2, count - 1), each]
    distance = np.abs(v - middle)
    scale = 1.4826 * float(np.median(distance))
    outside = np.maximum(low - v, v - high)
    is_far[finite] = (outside > np.maximum(SIGMAS * scale, SMALLEST)) & (outside > LEAST * (high - low))
    return is_far


def _shifted(values: FloatArray, by: int) -> FloatArray:
    """Values so many places on, NaN beyond the ends."""
    shifted = np.full(len(values), np.nan)
    if by > 0:
        shifted[:-by] = values[by:]
    else:
        shifted[-by:] = values[:by]
    return shifted
