"""Steps in axial acceleration: on STS-4 it rose discretely where the boundary layer turned turbulent (Hertzler in the
founding paper), evidence of a transition that no thermocouple is needed for.

The axial force coefficient C = a g / (rho V^2) (mass and area left out) is fitted over a window about each time by a
line in time and the angles flown, without and with a step there; F = improvement over what is left tells a step.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.stats import f as fisher

from sim_heating.base.arrays import FloatArray
from sim_heating.inputs.record import Record

COLUMN = "axial_accel_g"
HALF_WINDOW_S = 25.0
FEWEST = 20
"""Samples that a window has at least."""
BLIND_S = 2.0
"""A step this near an end of its window is not looked for."""
LEAST_G = 1e-4
"""Below this acceleration, noise of an accelerometer is all there is."""
ANGLES = ("alpha_deg", "elevon_deg", "bodyflap_deg")
MOST = 4
RESOLUTION = 1e-5
"""What is left over of a coefficient counts as at least this part of it: digits in a file are no noise."""


@dataclass(frozen=True)
class AxialStep:
    """One step.

    time_s   : when;  relative : size over the coefficient;  chance : of one as large by noise, all times looked at
    """

    time_s: float
    relative: float
    chance: float

    def words(self) -> str:
        """A line."""
        rises = "rises" if self.relative > 0.0 else "falls"
        return (
            f"Axial acceleration {rises} by {abs(self.relative):.1%} in a step at {self.time_s:.0f} s: independent "
            "evidence of a boundary layer that changes there."
        )


def axial_steps(record: Record) -> tuple[AxialStep, ...] | None:
    """The largest steps, apart by more than half a window; None where the record has no axial acceleration."""
    flown = record.conditions
    if COLUMN not in flown:
        return None
    span = record.time_s[record.fit_mask() | record.holdout_mask()]
    t, a = flown.time_s, flown[COLUMN]
    known = (np.abs(a) > LEAST_G) & (t >= np.min(span, initial=np.inf)) & (t <= np.max(span, initial=-np.inf))
    if np.count_nonzero(known) < FEWEST:
        return ()
    t = t[known]
    C = a[known] / (flown["rho_kg_m3"] * flown["velocity_m_s"] ** 2)[known]
    angles = np.column_stack([flown[n][known] for n in ANGLES])
    scan = [(_step(t, C, angles, at), at) for at in 0.5 * (t[1:] + t[:-1])]
    tried = [(F, dof, size, at) for (F, dof, size), at in scan if dof > 0]
    windows = max(np.ptp(t) / HALF_WINDOW_S, 1.0) * HALF_WINDOW_S / BLIND_S
    found: list[AxialStep] = []
    for F, dof, size, at in sorted(tried, key=lambda s: -s[0]):
        if all(abs(at - s.time_s) > HALF_WINDOW_S for s in found):
            one = float(fisher.sf(F, 1, dof))
            found.append(AxialStep(float(at), size, float(-math.expm1(windows * math.log1p(-min(one, 1.0 - 1e-16))))))
        if len(found) == MOST:
            break
    return tuple(found)


def _step(t: FloatArray, C: FloatArray, angles: FloatArray, at: float) -> tuple[float, int, float]:
    """F of a step at a time, its degrees of freedom (0 where the window is too short), and its relative size."""
    own = np.abs(t - at) <= HALF_WINDOW_S
    early, late = np.count_nonzero(own & (t < at - BLIND_S)), np.count_nonzero(own & (t > at + BLIND_S))
    if min(early, late) < FEWEST // 2:
        return 0.0, 0, 0.0
    x = t[own] - at
    moved = angles[own] - np.mean(angles[own], axis=0)
    columns = [np.ones_like(x), x, *(v for v in moved.T if np.ptp(v) > 1e-3)]
    base = np.column_stack(columns)
    y = C[own]
    without = y - base @ np.linalg.lstsq(base, y, rcond=None)[0]
    whole = np.column_stack([base, (x > 0.0).astype(float)])
    fit = np.linalg.lstsq(whole, y, rcond=None)[0]
    left = y - whole @ fit
    dof = len(y) - whole.shape[1]
    level = float(np.mean(np.abs(y)))
    floor = dof * (RESOLUTION * level) ** 2
    gained = float(without @ without - left @ left)
    return gained / ((float(left @ left) + floor) / dof), dof, float(fit[-1]) / level
