"""Shapes that a missing heating may have: a variable of the flight, in some form, at some lag; and how well each fits.

A history a f(t) added to the ratio changes the log likelihood of the readings, with all fitted parameters adjusted to
it, by

    b a - A a^2 / 2,    A = f' A~ f,  b = f' b~,    A~ = A - C N^-1 C',  b~ = b - C N^-1 g,

A, b information and score of the history (estimation/filter/heating_input.py), N, g those of the fitted parameters, C
the cross information. The best amplitude is b / A, its gain z^2 / 2 with z = b / sqrt(A), which is N(0, 1) where
nothing is missing. The effect of trying many shapes on the largest z^2 is simulated: b~ is then N(0, A~).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtr, chdtrc

from sim_heating.base.arrays import FloatArray
from sim_heating.closure.clues.residual_heating import ResidualHeating
from sim_heating.estimation.filter.heating_input import process_precision
from sim_heating.estimation.inference.residual_tests import sidak_p_value

LAGS_S = (-20.0, -10.0, -5.0, -2.0, 0.0, 2.0, 5.0, 10.0, 20.0, 40.0)
"""Lags of a shape behind its variable [s]; a thermocouple's clock rarely has a larger error."""
TIME = "time_s"


@dataclass(frozen=True)
class Shape:
    """A form of a flight variable, `lag_s` behind it.

    variable : its name
    form     : "linear", "square", "magnitude", "above", "step" or "rate"
    at       : threshold of "above" and "step", centre of "square"
    lag_s    : how much later than the variable [s]
    """

    variable: str
    form: str
    at: float = 0.0
    lag_s: float = 0.0

    def describe(self) -> str:
        """The shape in words."""
        v = self.variable
        lag = f", {abs(self.lag_s):g} s {'behind' if self.lag_s > 0 else 'ahead of'} it" if self.lag_s else ""
        forms = {
            "linear": f"{v}",
            "square": f"the square of {v} about {self.at:.4g}",
            "magnitude": f"the magnitude of {v}",
            "above": f"the excess of {v} over {self.at:.4g}",
            "step": f"a step at {v} = {self.at:.4g}",
            "rate": f"the rate of change of {v}",
        }
        return forms[self.form] + lag


@dataclass(frozen=True)
class ShapeFit:
    """The fit of a residual heating by one shape.

    amplitude : of the shape at its largest [-, heating ratio]
    z         : amplitude over its sigma
    gain      : of log likelihood
    share     : gain over that of the best history of any shape
    """

    shape: Shape
    amplitude: float
    z: float
    gain: float
    share: float


@dataclass(frozen=True, eq=False)
class ProfiledInformation:
    """Information and score of a heating history with all fitted parameters adjusted to it.

    information : (knot, knot) A~;  score : (knot,) b~
    best_gain   : of log likelihood, by the best history under its noise model
    """

    information: FloatArray
    score: FloatArray
    best_gain: float

    def fit_shapes(self, shapes: Sequence[Shape], columns: FloatArray) -> list[ShapeFit]:
        """Every shape fitted by itself, largest gain first; columns : (knot, shape) their histories."""
        power = np.einsum("ij,ij->j", columns, self.information @ columns)
        b = columns.T @ self.score
        resolved = power > 1e-12 * float(np.max(power, initial=0.0))
        z = np.divide(b, np.sqrt(np.maximum(power, 0.0)), out=np.zeros_like(b), where=resolved)
        amplitude = np.divide(b, power, out=np.zeros_like(b), where=resolved)
        fits = [
            ShapeFit(s, float(a), float(x), 0.5 * float(x) ** 2, self.share(0.5 * float(x) ** 2))
            for s, a, x in zip(shapes, amplitude, z, strict=True)
        ]
        return sorted(fits, key=lambda f: -f.gain)

    def share(self, gain: float) -> float:
        """Part of the best gain; 0 where no history gains anything."""
        return min(gain / self.best_gain, 1.0) if self.best_gain > 1.0 else 0.0


def profiled_information(residual: ResidualHeating) -> ProfiledInformation:
    """Information and score of the residual heating of a fit, with its parameters adjusted."""
    history, J = residual.input, residual.jacobian
    if J.shape[1] == 0:
        A, b = _without_level(history.information, history.score)
    else:
        weighted = history.weight[:, np.newaxis] * J
        C = history.response_matrix.T @ weighted
        N = J.T @ weighted + np.diag(residual.prior_information)
        # Scaled to ones on the diagonal: parameters have units from 1/deg to s.
        s = 1.0 / np.sqrt(np.maximum(np.diag(N), 1e-300))
        inverse = np.linalg.pinv(N * np.outer(s, s), rcond=1e-10, hermitian=True) * np.outer(s, s)
        # The fitted parameters follow any heating that is added: only what they cannot take up counts as evidence.
        A = history.information - C @ inverse @ C.T
        b = history.score - C @ inverse @ (J.T @ history.slope + C.T @ history.delta_ratio)
    Q, _ = process_precision(history.time_s, history.disturbance)
    return ProfiledInformation(A, b, 0.5 * float(b @ np.linalg.solve(A + Q, b)))


def _without_level(A: FloatArray, b: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Information and score with a constant heating adjusted to every history, as shapes have no mean.

    A fit of the flow's heating has a magnitude among its parameters; that of a wall without flow has none.
    """
    level = A.sum(axis=1)
    power = float(level.sum())
    if not power > 0.0:
        return A, b
    return A - np.outer(level, level) / power, b - level * float(b.sum()) / power


def trials_factor(profiled: ProfiledInformation, columns: FloatArray, seed: int = 0) -> float:
    """Number of independent trials that give the same largest z^2 from noise alone as all the shapes do.

    columns : (knot, shape) histories;  seed : of the simulated scores
    """
    draw_count = 400  # simulated scores behind the trials factor
    values, vectors = np.linalg.eigh(profiled.information)
    # Shapes overlap, so that their number says little about chance: the largest score of simulated noise replaces it.
    draws = (vectors * np.sqrt(np.maximum(values, 0.0))) @ np.random.default_rng(seed).normal(
        size=(len(values), draw_count)
    )
    power = np.einsum("ij,ij->j", columns, profiled.information @ columns)
    resolved = power > 1e-12 * float(np.max(power, initial=0.0))
    if not np.any(resolved):
        return 1.0
    z2 = (columns[:, resolved].T @ draws) ** 2 / power[resolved, np.newaxis]
    median = float(np.median(np.max(z2, axis=0)))
    return max(float(np.log(0.5) / np.log(chdtr(1, median))), 1.0)


def p_value(z: float, trials: float) -> float:
    """Probability of a |z| as large from noise alone in a number of independent trials."""
    single = float(chdtrc(1, z * z))
    return sidak_p_value(single, trials)


def candidate_shapes(time_s: FloatArray, variables: Mapping[str, FloatArray]) -> tuple[list[Shape], FloatArray]:
    """All shapes of the variables that are not constant.

    returns : shapes, and their histories (knot, shape), each of largest magnitude 1
    """
    min_relative_range = 1e-6  # range over magnitude below which a variable counts as constant
    shapes: list[Shape] = []
    columns: list[FloatArray] = []
    for name, v in variables.items():
        if np.ptp(v) <= min_relative_range * max(float(np.max(np.abs(v))), 1e-300):
            continue
        for form, at in _forms(name, v):
            for lag in (0.0,) if name == TIME else LAGS_S:
                values = _values(time_s, np.interp(time_s - lag, time_s, v), form, at)
                size = float(np.max(np.abs(values - np.mean(values))))
                if size > 0.0:
                    shapes.append(Shape(name, form, at, lag))
                    columns.append((values - np.mean(values)) / size)
    return shapes, np.array(columns).T.reshape(len(time_s), len(shapes))


def _forms(name: str, v: FloatArray) -> list[tuple[str, float]]:
    """Forms of a variable, each with its threshold or centre."""
    tried = np.unique(np.quantile(v, (0.2, 0.4, 0.6, 0.75, 0.9, 0.97)))
    thresholds = [float(q) for q in tried if np.min(v) < q < np.max(v)]
    steps = [("step", at) for at in thresholds]
    if name == TIME:
        return [("linear", 0.0), *(("step", float(q)) for q in np.quantile(v, np.linspace(0.04, 0.96, 24)))]
    forms = [
        ("linear", 0.0),
        ("square", float(np.mean(v))),
        ("rate", 0.0),
        *(("above", at) for at in thresholds),
        *steps,
    ]
    return [*forms, ("magnitude", 0.0)] if np.min(v) < 0.0 < np.max(v) else forms


def _values(time_s: FloatArray, v: FloatArray, form: str, threshold: float) -> FloatArray:
    """(knot,) a form of a variable."""
    sharpness = 0.02  # width of a step over the range of its variable
    if form == "square":
        return (v - threshold) ** 2
    if form == "magnitude":
        return np.abs(v)
    if form == "above":
        return np.maximum(v - threshold, 0.0)
    if form == "step":
        width = sharpness * np.ptp(v)
        return 0.5 + 0.5 * np.tanh((v - threshold) / width) if width > 0.0 else np.heaviside(v - threshold, 0.5)
    return np.gradient(v, time_s) if form == "rate" else v
