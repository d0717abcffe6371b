"""Steps in axial acceleration: on STS-4 it rose in a step where the boundary layer turned turbulent (Hertzler in the
founding paper), evidence of transition that needs no thermocouple.

The axial force coefficient C = a g / (rho V^2) (mass and area omitted) is fitted over a window about each time by a
line in time and the angles flown, without and with a step there. The statistic of a step is F = improvement over the
remaining mean square.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.special import fdtrc

from sim_heating.base.arrays import FloatArray
from sim_heating.inputs.record import Record

COLUMN = "axial_accel_g"
WINDOW = (25.0, 2.0, 20)
"""Half its length [s], how near to its ends no step is searched for [s], and its least number of samples."""
ANGLES = ("alpha_deg", "elevon_deg", "bodyflap_deg")


@dataclass(frozen=True)
class AxialStep:
    """A step in axial acceleration.

    time_s   : when
    relative : its size over the coefficient [-]
    p_value  : probability of one as large from noise, at any of the times searched
    """

    time_s: float
    relative: float
    p_value: float

    @property
    def as_of_transition(self) -> bool:
        """Whether it is as large as that of a boundary layer that changes."""
        return abs(self.relative) >= 0.01  # a transition raises the axial force by 5 % or more

    def describe(self) -> str:
        """One line for a person."""
        rises = "rises" if self.relative > 0.0 else "falls"
        return (
            f"Axial acceleration {rises} by {100.0 * abs(self.relative):.2g} % in a step at {self.time_s:.0f} s: "
            "independent evidence of a change of the boundary layer there."
        )


def axial_steps(record: Record) -> tuple[AxialStep, ...] | None:
    """The largest steps, more than half a window apart; None where the record has no axial acceleration."""
    min_acceleration_g = 1e-4  # smaller accelerations are taken to be noise of the accelerometer
    max_steps = 4
    flown = record.conditions
    if COLUMN not in flown:
        return None
    span = record.time_s[record.fit_mask() | record.holdout_mask()]
    t, a = flown.time_s, flown[COLUMN]
    judged = (
        (np.abs(a) > min_acceleration_g) & (t >= np.min(span, initial=np.inf)) & (t <= np.max(span, initial=-np.inf))
    )
    half_window_s, blind_s, min_samples = WINDOW
    if np.count_nonzero(judged) < min_samples:
        return ()
    t = t[judged]
    # Over twice the dynamic pressure: the acceleration itself varies with density and speed throughout.
    C = a[judged] / (flown["rho_kg_m3"] * flown["velocity_m_s"] ** 2)[judged]
    angles = np.column_stack([flown[n][judged] for n in ANGLES])
    scanned = [(*step, at) for at in 0.5 * (t[1:] + t[:-1]) if (step := _step(t, C, angles, at))[1] > 0]
    # The number of places, as far apart as a step is not searched for, at which noise could have shown a step.
    windows = max(np.ptp(t) / half_window_s, 1.0) * half_window_s / blind_s
    steps: list[AxialStep] = []
    for F, dof, size, at in sorted(scanned, key=lambda s: -s[0]):
        if all(abs(at - s.time_s) > half_window_s for s in steps):
            single = float(fdtrc(1, dof, F))
            steps.append(
                AxialStep(float(at), size, float(-math.expm1(windows * math.log1p(-min(single, 1.0 - 1e-16)))))
            )
        if len(steps) == max_steps:
            break
    return tuple(steps)


def _step(t: FloatArray, C: FloatArray, angles: FloatArray, step_s: float) -> tuple[float, int, float]:
    """F of a step at a time, its degrees of freedom (0 where the window is too short), and its relative size."""
    resolution = 1e-5  # least residual of a coefficient, relative to it: digits of a file are not noise
    half_window_s, blind_s, min_samples = WINDOW
    window = np.abs(t - step_s) <= half_window_s
    early, late = np.count_nonzero(window & (t < step_s - blind_s)), np.count_nonzero(window & (t > step_s + blind_s))
    if min(early, late) < min_samples // 2:
        return 0.0, 0, 0.0
    x = t[window] - step_s
    centred = angles[window] - np.mean(angles[window], axis=0)
    # Angles and a trend are fitted alongside, since a manoeuvre changes the axial force as a step would.
    columns = [np.ones_like(x), x, *(v for v in centred.T if np.ptp(v) > 1e-3)]
    without_step = np.column_stack(columns)
    y = C[window]
    residual_without = y - without_step @ np.linalg.lstsq(without_step, y, rcond=None)[0]
    with_step = np.column_stack([without_step, (x > 0.0).astype(float)])
    fit = np.linalg.lstsq(with_step, y, rcond=None)[0]
    residual = y - with_step @ fit
    dof = len(y) - with_step.shape[1]
    level = float(np.mean(np.abs(y)))
    floor = dof * (resolution * level) ** 2
    # The step never worsens the fit but by rounding; then F is 0, and p is 1.
    improvement = max(float(residual_without @ residual_without - residual @ residual), 0.0)
    return improvement / ((float(residual @ residual) + floor) / dof), dof, float(fit[-1]) / level
