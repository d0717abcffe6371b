"""Hysteresis: the same angle heated differently on its way out and back.

The founding paper: heating at a given angle of attack is the same each time, so that a loop of the residual against the
variable that a manoeuvre moves is an error of the thermal model (coating thickness, a clock, a lag), not of the heating
table. The loop's area, the integral of delta_ratio dv around it, is linear in delta_ratio and so has a sigma. Its
significance is that of the term in dv/dt in

    delta_ratio = c0 + c1 v + c2 v^2 + (the other angles, linear) + c3 dv/dt

over the manoeuvre, by generalised least squares with the covariance of delta_ratio, the scatter about it included.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from scipy.ndimage import median_filter
from scipy.stats import t as student

from sim_heating.base.arrays import FloatArray
from sim_heating.closure.clues.residual_heating import ResidualHeating
from sim_heating.estimation.inference.residual_tests import sidak_p_value

ANGLES = ("alpha_deg", "beta_deg", "elevon_deg", "bodyflap_deg")
MOVED_DEG = 1.0
"""A manoeuvre takes an angle this far from its median over WINDOW_S."""
WINDOW_S, MARGIN_S = 150.0, 6.0
FEWEST = 4
"""Knots that a loop has at least."""
SURE, LEAST_FILLED = 0.01, 0.1
"""A loop is told where chance makes none like it and it is no line."""


@dataclass(frozen=True, eq=False)
class HysteresisLoop:
    """One manoeuvre.

    area, sigma : integral of delta_ratio dv around it, closed by a chord [ratio deg]
    filled      : the area over that of the box around the loop, -1 to 1
    z           : of the term in dv/dt;  chance : of that from noise and scatter, all manoeuvres looked at
    """

    variable: str
    start_s: float
    end_s: float
    area: float
    sigma: float
    filled: float
    z: float
    chance: float

    @property
    def significant(self) -> bool:
        """Whether noise alone does not make such a loop."""
        return self.chance < SURE and abs(self.filled) > LEAST_FILLED

    def words(self) -> str:
        """A line."""
        return (
            f"Hysteresis against {self.variable} from {self.start_s:.0f} to {self.end_s:.0f} s: the loop fills "
            f"{abs(self.filled):.0%} of its box ({abs(self.z):.1f} sigma). The thermal model, a clock or a lag is in "
            "error, not the heating table."
        )

    def numbers(self) -> dict[str, Any]:
        """For closure.json."""
        return asdict(self)


def hysteresis_loops(residual: ResidualHeating, variables: Mapping[str, FloatArray]) -> list[HysteresisLoop]:
    """The manoeuvres of a record, in order of time."""
    t, d, covariance = residual.time_s, residual.delta_ratio, residual.input.covariance
    angles = {n: variables[n] for n in ANGLES if n in variables}
    spans = [(n, own) for n, v in angles.items() for own in manoeuvres(t, v) if np.all(residual.fitted[own])]
    found = []
    for name, own in spans:
        v = angles[name]
        row = _around(v, own)
        area, sigma = float(row @ d), float(np.sqrt(row @ covariance @ row))
        others = [u[own] for n, u in angles.items() if n != name and np.ptp(u[own]) > 0.5 * MOVED_DEG]
        z, dof = _rate_term(t[own], v[own], others, d[own], covariance[own, own])
        box = float(np.ptp(v[own]) * np.ptp(d[own]))
        one = float(2.0 * student.sf(abs(z), dof)) if dof > 0 else 1.0
        several = sidak_p_value(one, len(spans))
        begin, end = float(t[own][0]), float(t[own][-1])
        found.append(HysteresisLoop(name, begin, end, area, sigma, area / box if box > 0.0 else 0.0, z, several))
    return sorted(found, key=lambda loop: loop.start_s)


def _rate_term(
    time_s: FloatArray, v: FloatArray, others: Sequence[FloatArray], d: FloatArray, covariance: FloatArray
) -> tuple[float, int]:
    """t of the term in dv/dt and its degrees of freedom, 0 where there are too few knots."""
    own = [np.ones_like(v), v - np.mean(v), (v - np.mean(v)) ** 2, *(u - np.mean(u) for u in others)]
    X = np.column_stack([*own, np.gradient(v, time_s)])
    dof = len(d) - X.shape[1]
    if dof < 1:
        return 0.0, 0
    X = X / np.linalg.norm(X, axis=0)
    root = np.linalg.cholesky(covariance + 1e-9 * np.trace(covariance) / len(d) * np.eye(len(d)))
    A, y = np.linalg.solve(root, X), np.linalg.solve(root, d)
    fit = np.linalg.lstsq(A, y, rcond=None)[0]
    scatter = max(float(np.sum((y - A @ fit) ** 2)) / dof, 1.0)
    return float(fit[-1] / np.sqrt(np.linalg.pinv(A.T @ A)[-1, -1] * scatter)), dof


def manoeuvres(time_s: FloatArray, v: FloatArray) -> list[slice]:
    """Knots of each excursion of a variable and back."""
    spacing = float(np.median(np.diff(time_s)))
    away = np.abs(v - median_filter(v, 2 * int(0.5 * WINDOW_S / spacing) + 1, mode="nearest")) > MOVED_DEG
    spans: list[list[int]] = []
    for k in np.flatnonzero(away):
        if spans and time_s[k] - time_s[spans[-1][1]] <= 2.0 * MARGIN_S:
            spans[-1][1] = int(k)
        else:
            spans.append([int(k), int(k)])
    wider = int(np.ceil(MARGIN_S / spacing))
    found = [slice(max(a - wider, 0), min(b + wider, len(v) - 1) + 1) for a, b in spans]
    return [s for s in found if s.stop - s.start >= FEWEST and time_s[s.stop - 1] - time_s[s.start] <= WINDOW_S]


def _around(v: FloatArray, own: slice) -> FloatArray:
    """(knot,) of which the product with delta_ratio is the area, the loop closed by a chord."""
    row = np.zeros(len(v))
    closed = np.append(v[own], v[own][0])
    step = np.diff(closed)
    row[own] = 0.5 * (step + np.roll(step, 1))
    return row
