"""Single readings far from those of the same sensor before and after them, as a disturbed sample of a recorder gives.

A reading is suspected where it is away from the one before it by many standard deviations, and the one after it, where
that is there already, comes back. Heating that is steep goes on, and a transition stays: neither comes back with the
next reading. Whether a suspected reading is used is for the filter: it is where it agrees with what is expected.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from sim_heating.live.timeline import Word

JUMP_SIGMAS = 8.0
"""Standard deviations of its noise by which a suspected reading is away from the one before it [-]."""
COMES_BACK = 0.5
"""Part of that jump by which the reading after a suspected one is away from it, to the other side, at least [-]."""
NEAR_S = 2.0
"""Time within which a reading is compared with those before and after it [s]."""
AWAY_SIGMAS = 6.0
"""Standard deviations, noise included, by which one that is left out is away from what is expected [-]."""


def suspected(words: Sequence[Word], from_s: float, gate_K: Sequence[float]) -> Mapping[tuple[float, int], bool]:
    """Readings later than a time [s] that look like single spikes, by time and sensor.

    words   : readings in order of time, from NEAR_S before that time on
    gate_K  : by sensor, how far a reading may be from the one before it [K]
    returns : whether the reading after it is there, which decides

    >>> suspected([(0.0, 0, 500.0), (1.0, 0, 580.0), (2.0, 0, 501.0), (3.0, 0, 502.0)], 0.0, [10.0])
    {(1.0, 0): True}
    >>> suspected([(0.0, 0, 500.0), (1.0, 0, 580.0), (2.0, 0, 640.0), (3.0, 0, 645.0)], 0.0, [10.0])
    {}
    >>> suspected([(0.0, 0, 500.0), (1.0, 0, 580.0)], 0.0, [10.0])
    {(1.0, 0): False}
    """
    found: dict[tuple[float, int], bool] = {}
    of_sensor: dict[int, list[Word]] = {}
    for word in words:
        of_sensor.setdefault(word[1], []).append(word)
    for n, own in of_sensor.items():
        for k in range(1, len(own)):
            (before_s, _, before_K), (t, _, read_K) = own[k - 1], own[k]
            jump_K = read_K - before_K
            if t <= from_s or t - before_s > NEAR_S or abs(jump_K) <= gate_K[n]:
                continue
            if k + 1 == len(own) or own[k + 1][0] - t > NEAR_S:
                found[t, n] = False
            elif (read_K - own[k + 1][2]) * jump_K >= COMES_BACK * jump_K**2:
                found[t, n] = True
    return found
