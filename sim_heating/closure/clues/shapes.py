"""Shapes that a missing heating may have: a variable of the flight, in some form, at some lag; and how well each fits.

A history a f(t) added to the ratio changes the log likelihood of the readings, everything that the fit estimates
adjusting to it, by

    b a - A a^2 / 2,    A = f' A~ f,  b = f' b~,    A~ = A - C N^-1 C',  b~ = b - C N^-1 g,

A, b information and score of the history (estimation/filter/heating_input.py), N, g those of the fitted parameters, C
across. The best amplitude is b / A, its gain z^2 / 2 with z = b / sqrt(A), which is N(0, 1) where nothing is missing.
What looking at many shapes adds to the largest z^2 is simulated: b~ is then N(0, A~).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from sim_heating.base.arrays import FloatArray
from sim_heating.closure.clues.residual_heating import ResidualHeating
from sim_heating.estimation.filter.heating_input import precision
from sim_heating.estimation.inference.residual_tests import sidak_p_value

LAGS_S = (-20.0, -10.0, -5.0, -2.0, 0.0, 2.0, 5.0, 10.0, 20.0, 40.0)
"""How much later than its variable a shape is [s]; a thermocouple's clock is rarely off by more."""
QUANTILES = (0.2, 0.4, 0.6, 0.75, 0.9, 0.97)
"""Thresholds tried, as parts of the time that a variable is below them."""
SHARPNESS = 0.02
"""Width of a step over the range of its variable."""
MOVES = 1e-6
"""A variable that moves less, over its size, does not move."""
DRAWS = 400
TIME = "time_s"


@dataclass(frozen=True)
class Shape:
    """One history: a form of a variable, `lag_s` behind it.

    form : "linear", "square", "magnitude", "above", "step" or "rate";  at : threshold of "above" and "step"
    """

    variable: str
    form: str
    at: float = 0.0
    lag_s: float = 0.0

    def words(self) -> str:
        """What it is."""
        v = self.variable
        lag = f", {abs(self.lag_s):g} s {'behind' if self.lag_s > 0 else 'ahead of'} it" if self.lag_s else ""
        forms = {
            "linear": f"{v}", "square": f"the square of {v} about {self.at:.4g}", "magnitude": f"the magnitude of {v}",
            "above": f"what {v} is above {self.at:.4g}", "step": f"a step at {v} = {self.at:.4g}",
            "rate": f"the rate of change of {v}",
        }  # fmt: skip
        return forms[self.form] + lag


@dataclass(frozen=True)
class ShapeFit:
    """How a history follows a shape.

    amplitude : of the shape at its largest [ratio];  z : over its sigma;  gain : of log likelihood
    share     : of what the best history of any shape gains
    """

    shape: Shape
    amplitude: float
    z: float
    gain: float
    share: float


@dataclass(frozen=True, eq=False)
class ProfiledInformation:
    """A~, b~, and the gain of the best history under its noise model."""

    information: FloatArray
    score: FloatArray
    best_gain: float

    def weigh(self, shapes: Sequence[Shape], columns: FloatArray) -> list[ShapeFit]:
        """Each shape (knot, shape), largest gain first."""
        power = np.einsum("ij,ij->j", columns, self.information @ columns)
        b = columns.T @ self.score
        told = power > 1e-12 * float(np.max(power, initial=0.0))
        z = np.divide(b, np.sqrt(power), out=np.zeros_like(b), where=told)
        amplitude = np.divide(b, power, out=np.zeros_like(b), where=told)
        found = [
            ShapeFit(s, float(a), float(x), 0.5 * float(x) ** 2, self.share(0.5 * float(x) ** 2))
            for s, a, x in zip(shapes, amplitude, z, strict=True)
        ]
        return sorted(found, key=lambda f: -f.gain)

    def share(self, gain: float) -> float:
        """Part of the best gain; 0 where there is none."""
        return min(gain / self.best_gain, 1.0) if self.best_gain > 1.0 else 0.0


def profiled_information(residual: ResidualHeating) -> ProfiledInformation:
    """Information and score of a history with everything that was fitted adjusting to it."""
    found, J = residual.input, residual.jacobian
    if J.shape[1] == 0:
        A, b = found.information, found.score
    else:
        weighted = found.weight[:, np.newaxis] * J
        C = found.answer.T @ weighted
        N = J.T @ weighted + np.diag(residual.prior_information)
        s = 1.0 / np.sqrt(np.maximum(np.diag(N), 1e-300))
        inverse = np.linalg.pinv(N * np.outer(s, s), rcond=1e-10, hermitian=True) * np.outer(s, s)
        A = found.information - C @ inverse @ C.T
        b = found.score - C @ inverse @ (J.T @ found.slope + C.T @ found.delta_ratio)
    Q, _ = precision(found.time_s, found.disturbance)
    return ProfiledInformation(A, b, 0.5 * float(b @ np.linalg.solve(A + Q, b)))


def trials_factor(weights: ProfiledInformation, columns: FloatArray, seed: int = 0) -> float:
    """Number of independent looks that give the same largest z^2 on noise alone as all the shapes do."""
    values, vectors = np.linalg.eigh(weights.information)
    draws = (vectors * np.sqrt(np.maximum(values, 0.0))) @ np.random.default_rng(seed).normal(size=(len(values), DRAWS))
    power = np.einsum("ij,ij->j", columns, weights.information @ columns)
    told = power > 1e-12 * float(np.max(power, initial=0.0))
    if not np.any(told):
        return 1.0
    z2 = (columns[:, told].T @ draws) ** 2 / power[told, np.newaxis]
    middle = float(np.median(np.max(z2, axis=0)))
    return max(float(np.log(0.5) / np.log(chi2.cdf(middle, 1))), 1.0)


def p_value(z: float, independent_looks: float) -> float:
    """Probability of a |z| as large from noise alone in so many looks."""
    one = float(chi2.sf(z * z, 1))
    return sidak_p_value(one, independent_looks)


def candidate_shapes(time_s: FloatArray, variables: Mapping[str, FloatArray]) -> tuple[list[Shape], FloatArray]:
    """All shapes of the variables that move, and their histories (knot, shape), each of largest magnitude 1."""
    found: list[Shape] = []
    columns: list[FloatArray] = []
    for name, v in variables.items():
        if np.ptp(v) <= MOVES * max(float(np.max(np.abs(v))), 1e-300):
            continue
        for form, at in _forms(name, v):
            for lag in (0.0,) if name == TIME else LAGS_S:
                values = _values(time_s, np.interp(time_s - lag, time_s, v), form, at)
                size = float(np.max(np.abs(values - np.mean(values))))
                if size > 0.0:
                    found.append(Shape(name, form, at, lag))
                    columns.append((values - np.mean(values)) / size)
    return found, np.array(columns).T.reshape(len(time_s), len(found))


def _forms(name: str, v: FloatArray) -> list[tuple[str, float]]:
    ends = [float(q) for q in np.unique(np.quantile(v, QUANTILES)) if np.min(v) < q < np.max(v)]
    steps = [("step", at) for at in ends]
    if name == TIME:
        return [("linear", 0.0), *(("step", float(q)) for q in np.quantile(v, np.linspace(0.04, 0.96, 24)))]
    forms = [("linear", 0.0), ("square", float(np.mean(v))), ("rate", 0.0), *(("above", at) for at in ends), *steps]
    return [*forms, ("magnitude", 0.0)] if np.min(v) < 0.0 < np.max(v) else forms


def _values(time_s: FloatArray, v: FloatArray, form: str, at: float) -> FloatArray:
    if form == "square":
        return (v - at) ** 2
    if form == "magnitude":
        return np.abs(v)
    if form == "above":
        return np.maximum(v - at, 0.0)
    if form == "step":
        return 0.5 + 0.5 * np.tanh((v - at) / (SHARPNESS * np.ptp(v)))
    return np.gradient(v, time_s) if form == "rate" else v
