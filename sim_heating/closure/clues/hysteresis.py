"""Hysteresis: different heating at the same angle on its way out and back.

The founding paper: heating at a given angle of attack is the same each time, so that a loop of the residual against the
variable that a manoeuvre moves is an error of the thermal model (coating thickness, a clock, a lag), not of the heating
table. The loop's area, the integral of delta_ratio dv around it, is linear in delta_ratio and so has a sigma. Its
significance is that of the term in dv/dt in

    delta_ratio = c0 + c1 v + c2 v^2 + (the other angles, linear) + c3 dv/dt

over the manoeuvre, by generalised least squares with the covariance of delta_ratio, the scatter about it included.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import stdtr

from sim_heating.base.arrays import FloatArray
from sim_heating.closure.clues.residual_heating import ResidualHeating
from sim_heating.closure.verdict.policy import POLICY
from sim_heating.estimation.inference.residual_tests import sidak_p_value

ANGLES = ("alpha_deg", "beta_deg", "elevon_deg", "bodyflap_deg")
MIN_EXCURSION_DEG = 1.0
"""Excursion of an angle from its median over the window that makes a manoeuvre."""


@dataclass(frozen=True, eq=False)
class HysteresisLoop:
    """The loop of residual heating against an angle over one manoeuvre.

    variable       : the angle;  start_s, end_s : of the manoeuvre
    area, sigma    : integral of delta_ratio dv around it, closed by a chord [deg]
    filled         : the area over that of the box around the loop, -1 to 1
    z              : of the term in dv/dt
    p_value        : of that term from noise and scatter, over all manoeuvres of the record
    """

    variable: str
    start_s: float
    end_s: float
    area: float
    sigma: float
    filled: float
    z: float
    p_value: float

    @property
    def significant(self) -> bool:
        """Whether noise alone is unlikely to make the loop."""
        return self.p_value < POLICY.significance and abs(self.filled) > 0.1

    def describe(self) -> str:
        """One line for a person."""
        return (
            f"Hysteresis against {self.variable} from {self.start_s:.0f} to {self.end_s:.0f} s: the loop fills "
            f"{abs(self.filled):.0%} of its box ({abs(self.z):.1f} sigma). This "
            "indicates an error of the thermal model, a clock or a lag, not of the heating table."
        )


def hysteresis_loops(residual: ResidualHeating, variables: Mapping[str, FloatArray]) -> list[HysteresisLoop]:
    """The manoeuvres of a record, in order of time.

    variables : (knot,) flight variables by name, of which the ANGLES are examined
    """
    t, d, covariance = residual.time_s, residual.delta_ratio, residual.input.covariance
    angles = {n: variables[n] for n in ANGLES if n in variables}
    spans = [(n, knots) for n, v in angles.items() for knots in manoeuvres(t, v) if np.all(residual.fitted[knots])]
    loops = []
    for name, knots in spans:
        v = angles[name]
        weights = _area_weights(v, knots)
        area, sigma = float(weights @ d), float(np.sqrt(weights @ covariance @ weights))
        others = [u[knots] for n, u in angles.items() if n != name and np.ptp(u[knots]) > 0.5 * MIN_EXCURSION_DEG]
        z, dof = _rate_term(t[knots], v[knots], others, d[knots], covariance[knots, knots])
        box = float(np.ptp(v[knots]) * np.ptp(d[knots]))
        single = float(2.0 * stdtr(dof, -abs(z))) if dof > 0 else 1.0
        corrected = sidak_p_value(single, len(spans))
        begin, end = float(t[knots][0]), float(t[knots][-1])
        loops.append(HysteresisLoop(name, begin, end, area, sigma, area / box if box > 0.0 else 0.0, z, corrected))
    return sorted(loops, key=lambda loop: loop.start_s)


def _rate_term(
    time_s: FloatArray, v: FloatArray, others: Sequence[FloatArray], d: FloatArray, covariance: FloatArray
) -> tuple[float, int]:
    """Student's t of the term in dv/dt, and its degrees of freedom: 0 where there are too few knots."""
    columns = [np.ones_like(v), v - np.mean(v), (v - np.mean(v)) ** 2, *(u - np.mean(u) for u in others)]
    X = np.column_stack([*columns, np.gradient(v, time_s)])
    dof = len(d) - X.shape[1]
    if dof < 1:
        return 0.0, 0
    X = X / np.linalg.norm(X, axis=0)
    root = np.linalg.cholesky(covariance + 1e-9 * np.trace(covariance) / len(d) * np.eye(len(d)))
    A, y = np.linalg.solve(root, X), np.linalg.solve(root, d)
    fit = np.linalg.lstsq(A, y, rcond=None)[0]
    # Never below 1: a residual that happens to be smooth is not better known than its covariance states.
    scatter = max(float(np.sum((y - A @ fit) ** 2)) / dof, 1.0)
    return float(fit[-1] / np.sqrt(np.linalg.pinv(A.T @ A)[-1, -1] * scatter)), dof


def manoeuvres(time_s: FloatArray, v: FloatArray) -> list[slice]:
    """Knots of each excursion of a variable from its median and back."""
    window_s, margin_s = 150.0, 6.0
    min_knots = 4  # knots that a loop has at least
    spacing = float(np.median(np.diff(time_s)))
    half = int(0.5 * window_s / spacing)
    windows = np.lib.stride_tricks.sliding_window_view(np.pad(v, half, mode="edge"), 2 * half + 1)
    displaced = np.abs(v - np.median(windows, axis=1)) > MIN_EXCURSION_DEG
    spans: list[list[int]] = []
    for k in np.flatnonzero(displaced):
        if spans and time_s[k] - time_s[spans[-1][1]] <= 2.0 * margin_s:
            spans[-1][1] = int(k)
        else:
            spans.append([int(k), int(k)])
    margin = int(np.ceil(margin_s / spacing))
    excursions = [slice(max(a - margin, 0), min(b + margin, len(v) - 1) + 1) for a, b in spans]
    return [s for s in excursions if s.stop - s.start >= min_knots and time_s[s.stop - 1] - time_s[s.start] <= window_s]


def _area_weights(v: FloatArray, knots: slice) -> FloatArray:
    """(knot,) weights whose product with delta_ratio is the area of the loop, closed by a chord."""
    row = np.zeros(len(v))
    closed = np.append(v[knots], v[knots][0])
    step = np.diff(closed)
    row[knots] = 0.5 * (step + np.roll(step, 1))
    return row
