"""One reading, or two in a row, far from those of the same sensor before and after, as a disturbed recorder gives.

Readings are suspected where they are away from the one before them by many standard deviations, and the one after them,
where that is there already, comes back. Heating that is steep goes on, and a transition stays: neither comes back with
the next reading but one. Whether a suspected reading is used is for the filter: it is where it agrees with what is
expected.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from sim_heating.live.filtering.timeline import Word

JUMP_SIGMAS = 8.0
"""Standard deviations of its noise by which a suspected reading is away from the one before it [-]."""
COMES_BACK = 0.5
"""Part of that jump by which the reading after suspected ones is away from them, to the other side, at least [-]."""
NEAR_S = 2.5
"""Time within which a reading is compared with those before and after it [s]; it holds two in a row at 1 Hz."""
AWAY_SIGMAS = 6.0
"""Standard deviations, noise included, by which one that is left out is away from what is expected [-]."""


def suspected(words: Sequence[Word], from_s: float, gate_K: Sequence[float]) -> Mapping[tuple[float, int], bool]:
    """Readings later than a time [s] that look like spikes, alone or two in a row, by time and sensor.

    words   : readings in order of time, from NEAR_S before that time on
    gate_K  : by sensor, how far a reading may be from the one before it [K]
    returns : whether the reading is there that decides

    >>> suspected([(0.0, 0, 500.0), (1.0, 0, 580.0), (2.0, 0, 501.0), (3.0, 0, 502.0)], 0.0, [10.0])
    {(1.0, 0): True}
    >>> suspected([(0.0, 0, 500.0), (1.0, 0, 580.0), (2.0, 0, 570.0), (3.0, 0, 503.0)], 0.0, [10.0])
    {(1.0, 0): True, (2.0, 0): True}
    >>> suspected([(0.0, 0, 500.0), (1.0, 0, 580.0), (2.0, 0, 640.0), (3.0, 0, 645.0), (4.0, 0, 647.0)], 0.0, [10.0])
    {}
    >>> suspected([(0.0, 0, 500.0), (1.0, 0, 580.0)], 0.0, [10.0])
    {(1.0, 0): False}
    """
    found: dict[tuple[float, int], bool] = {}
    of_sensor: dict[int, list[Word]] = {}
    for word in words:
        of_sensor.setdefault(word[1], []).append(word)
    for n, own in of_sensor.items():
        good, k = 0, 1  # the last reading that is no spike, and the next one
        while k < len(own):
            count, is_decided = _spikes(own[good], own[k : k + 3], gate_K[n])
            for t, _, _ in own[k : k + count]:
                if t > from_s:
                    found[t, n] = is_decided
            if not is_decided:
                good, count = k, 1
            k += count
    return found


def _spikes(before: Word, words: Sequence[Word], gate_K: float) -> tuple[int, bool]:
    """How many of some readings, behind one that is no spike, look like spikes, and whether that is decided."""
    for count in (1, 2):
        is_decided = (
            _come_back(before, words[:count], words[count : count + 1], gate_K) if count <= len(words) else None
        )
        if is_decided is not None:
            return count, is_decided
    return 0, False


def _come_back(before: Word, spikes: Sequence[Word], after: Sequence[Word], gate_K: float) -> bool | None:
    """Whether the reading after some is there and shows them to be spikes; None where they are none."""
    before_s, _, before_K = before
    away_K = [read_K - before_K for _, _, read_K in spikes]
    if spikes[-1][0] - before_s > NEAR_S or min(map(abs, away_K)) <= gate_K:
        return None
    if not after or after[0][0] - spikes[0][0] > NEAR_S:
        return False
    left_K = after[0][2] - before_K
    return True if all((own - left_K) * own >= COMES_BACK * own**2 for own in away_K) else None
