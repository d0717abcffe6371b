"""Evidence on the cause of a residual heating: flight variables at lags, manoeuvres, steps in axial acceleration.

Correlations weigh each knot by 1 / sigma^2. Neighbours are not independent: the effective number of points is

    n_e = n / (1 + 2 sum_k rho_d(k) rho_v(k)),

rho the autocorrelations of the residual and of the variable (M. S. Bartlett, J. R. Stat. Soc. 98 (1935) 536), at most
the degrees of freedom that the readings resolve, and the p-value of a correlation is that of Student's t with n_e - 2
degrees of freedom, corrected for the number of variables and lags (Sidak).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any, TypeVar

import numpy as np
from scipy.special import stdtr

from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import DERIVED, HEATING, RATIO_VARIABLES, STATE
from sim_heating.base.errors import tell_left_out
from sim_heating.base.parallel.threads import one_thread
from sim_heating.closure.clues.axial_force import AxialStep, axial_steps
from sim_heating.closure.clues.hysteresis import HysteresisLoop, hysteresis_loops
from sim_heating.closure.clues.residual_heating import ResidualHeating
from sim_heating.closure.clues.shapes import (
    LAGS_S,
    TIME,
    ShapeFit,
    candidate_shapes,
    p_value,
    profiled_information,
    trials_factor,
)
from sim_heating.closure.verdict.policy import POLICY
from sim_heating.estimation.inference.residual_tests import sidak_p_value
from sim_heating.heating.reference.gas import wall_enthalpy_grid
from sim_heating.inputs.points import conditions_of_record, wall_enthalpy_of
from sim_heating.simulation.predict import Prediction

R = TypeVar("R")
S = TypeVar("S")
SHAPES = "shapes of the residual"
WALL, ENTHALPY = "wall_K", "wall_enthalpy_ratio"
GROUND_TRACK = ("latitude_deg", "longitude_deg", "heading_deg")
"""Columns of where over the Earth a flight is, which no heating follows."""


@dataclass(frozen=True)
class Correlation:
    """Weighted correlation of the residual heating with a variable, at the lag where it is largest.

    n_effective : effective number of independent points
    p_value     : of a correlation as large with an unrelated history, at this lag
    p_value_all : at any of the variables and lags examined
    """

    variable: str
    lag_s: float
    value: float
    n_effective: float
    p_value: float
    p_value_all: float


@dataclass(frozen=True)
class ActiveSpan:
    """A span in which the residual heating is significant.

    delta_ratio : its mean [-];  relative : mean over the model's ratio, NaN where that is unknown
    """

    start_s: float
    end_s: float
    delta_ratio: float
    relative: float


@dataclass(frozen=True)
class ResidualEvidence:
    """Evidence that a residual heating gives on its cause.

    correlations  : one for each variable, largest first
    shape_fits    : the best shape of each variable, largest gain first
    trials_factor : independent trials that the shapes amount to
    p_value       : of a shape as good from noise alone, corrected by the trials factor
    active        : spans, the largest first
    loops         : hysteresis in manoeuvres
    axial         : steps in axial acceleration; None where the record has none
    negative_s    : how long the ratio would have to be negative by more than `negative_sigmas` [s]; None where unknown
    unit          : what amplitudes are multiples of, in words
    left_out      : pieces that could not be made, with the reason; their fields are empty
    """

    correlations: tuple[Correlation, ...]
    shape_fits: tuple[ShapeFit, ...]
    trials_factor: float
    p_value: float
    active: tuple[ActiveSpan, ...]
    loops: tuple[HysteresisLoop, ...]
    axial: tuple[AxialStep, ...] | None
    negative_s: float | None = None
    unit: str = "ratio"
    left_out: Mapping[str, str] = field(default_factory=dict)

    def proposal(self) -> list[str]:
        """The evidence in lines for a person: which variable, at which lag, active when, how large."""
        if SHAPES in self.left_out:
            return [f"What the residual follows is left out ({self.left_out[SHAPES]})."]
        if not self.shape_fits or self.p_value > POLICY.significance:
            return ["As heating, the residual is no more than noise: it follows no variable of the flight."]
        best = self.shape_fits[0]
        lines = [*self._best_shape(best), *self._activity()]
        lines += self._hysteresis()
        significant = [s for s in self.axial or () if s.p_value < POLICY.significance and s.as_of_transition]
        return lines + [step.describe() + self._distance_from_edge(step) for step in significant]

    def _best_shape(self, best: ShapeFit) -> list[str]:
        """What the residual follows best, what it follows nearly as well, and what that means."""
        lines = [
            f"The residual follows {best.shape.describe()}: {best.amplitude:+.3g} of {self.unit} at its largest, "
            f"{abs(best.z):.0f} sigma; that is {best.share:.0%} of the gain of the best heating history."
        ]
        rivals = [f for f in self.shape_fits[1:] if f.share > 0.8 * best.share]
        if rivals:
            listed = "; ".join(f"{r.shape.describe()} ({r.share:.0%})" for r in rivals[:3])
            lines.append(f"Nearly as good: {listed}. The record cannot distinguish them.")
        if best.shape.form == "rate":
            lines.append(
                "A residual that follows a rate of change indicates coating, clock or lag error rather than a table "
                "error."
            )
        if self.negative_s:
            lines.append(
                f"The heating ratio would have to be negative for {self.negative_s:.0f} s, which no heating can be: "
                "examine conduction, sensors and clocks."
            )
        if best.share < 0.5:
            lines.append(
                "No variable explains half of it: the cause may be something that the record does not contain."
            )
        return lines

    def _activity(self) -> Iterator[str]:
        """When the residual differs from none, and by how much."""
        for span in self.active[:3]:
            size = f"{span.delta_ratio:+.3g}" + ("" if math.isnan(span.relative) else f" ({span.relative:+.0%})")
            yield f"Active from {span.start_s:.0f} to {span.end_s:.0f} s: {size} of {self.unit} on average."

    def _distance_from_edge(self, step: AxialStep) -> str:
        """How far in time a step in acceleration is from the nearest start or end of the missing heating."""
        edges = [edge for span in self.active for edge in (span.start_s, span.end_s)]
        if not edges:
            return ""
        nearest = min(edges, key=lambda edge: abs(edge - step.time_s))
        return f" The missing heating starts or ends {abs(nearest - step.time_s):.0f} s from there."

    def _hysteresis(self) -> list[str]:
        """The fullest significant loop, and how many there are."""
        significant = sorted((loop for loop in self.loops if loop.significant), key=lambda loop: -abs(loop.filled))
        if not significant:
            return []
        count = len(significant)
        count_line = f" {count} of {len(self.loops)} excursions of an angle show it." if count > 1 else ""
        return [significant[0].describe() + count_line]

    def as_json(self) -> dict[str, Any]:
        """Its contents for closure.json."""
        return {
            "correlations": [asdict(c) for c in self.correlations],
            "shapes": [
                {**asdict(f.shape), "amplitude": f.amplitude, "z": f.z, "gain": f.gain, "share": f.share}
                for f in self.shape_fits
            ],
            "trials_factor": self.trials_factor,
            "p_value": self.p_value,
            "active": [{k: None if v != v else v for k, v in asdict(a).items()} for a in self.active],
            "hysteresis": [asdict(loop) for loop in self.loops],
            "negative_ratio_s": self.negative_s,
            "axial_steps": None if self.axial is None else [asdict(s) for s in self.axial],
            **({"left_out": dict(self.left_out)} if self.left_out else {}),
        }


def residual_evidence(residual: ResidualHeating, ratio: FloatArray | None = None) -> ResidualEvidence:
    """All evidence of one residual heating.

    ratio : (knot,) the model's heating ratio, where it is known
    """
    # The split of a product among threads changes its last digits, and with them the report.
    with one_thread():
        return _evidence(residual, ratio)


def _evidence(residual: ResidualHeating, ratio: FloatArray | None) -> ResidualEvidence:
    variables, left_out = flight_variables(residual), dict[str, str]()

    def piece(title: str, make: Callable[[], R], substitute: S) -> R | S:
        try:
            return make()
        except Exception as error:
            left_out[title] = tell_left_out(f"evidence, {title}", error)
            return substitute

    varying = {n: v for n, v in variables.items() if np.ptp(v[residual.fitted]) > 0.0}
    fits, trials = piece(SHAPES, lambda: _shape_fits(residual, variables), ([], 1.0))
    return ResidualEvidence(
        correlations=tuple(piece("correlations", lambda: correlations(residual, varying), [])),
        shape_fits=tuple(fits),
        trials_factor=trials,
        p_value=p_value(fits[0].z, trials) if fits else 1.0,
        active=tuple(piece("active spans", lambda: active_spans(residual, ratio), [])),
        loops=tuple(piece("hysteresis", lambda: hysteresis_loops(residual, variables), [])),
        axial=piece("axial acceleration", lambda: axial_steps(residual.record), None),
        negative_s=piece("negative ratio", lambda: None if ratio is None else negative_s(residual, ratio), None),
        unit=residual.unit,
        left_out=left_out,
    )


def _shape_fits(residual: ResidualHeating, variables: Mapping[str, FloatArray]) -> tuple[list[ShapeFit], float]:
    """The best shape of each variable, the largest gain first, and the trials that all shapes amount to."""
    # largest amplitude of a shape, over the residual's own: a larger one cancels against fitted parameters
    max_amplitude = 3.0
    profiled = profiled_information(residual)
    shapes, columns = candidate_shapes(residual.time_s, variables)
    largest = max_amplitude * float(np.max(np.abs(residual.delta_ratio)))
    # A shape that nearly equals a derivative has a huge amplitude, which the derivative cancels: it explains nothing by
    # itself.
    fits = [f for f in profiled.fit_shapes(shapes, columns) if abs(f.amplitude) <= largest]
    names = dict.fromkeys(f.shape.variable for f in fits)
    best = [next(f for f in fits if f.shape.variable == name) for name in names]
    return best, trials_factor(profiled, columns)


def ratio_at(prediction: Prediction, time_s: FloatArray) -> FloatArray | None:
    """(time,) heating ratio of a prediction at other times; None where there is no aerodynamic heating."""
    history = prediction.history
    finite = np.isfinite(history.ratio)
    return np.interp(time_s, history.time_s[finite], history.ratio[finite]) if np.any(finite) else None


def negative_s(residual: ResidualHeating, ratio: FloatArray) -> float:
    """For how long ratio and correction together are negative by more than `negative_sigmas` [s]."""
    negative_sigmas = 2.0  # a ratio is negative where it is so by more than this many sigmas
    below = residual.fitted & (ratio + residual.delta_ratio < -negative_sigmas * residual.sigma)
    return float(np.sum(np.gradient(residual.time_s)[below]))


def flight_variables(residual: ResidualHeating) -> dict[str, FloatArray]:
    """(knot,) variables that a heating may depend on, by name.

    The ratio variables, jets, further columns of the record, wall temperature, its enthalpy over the recovery enthalpy,
    and time.
    """
    record, t = residual.record, residual.time_s
    flown = conditions_of_record(record).at(t)
    excluded = {*STATE, *HEATING, *DERIVED, *GROUND_TRACK, "q_add_W_m2"} - {"mach"}
    names = [*RATIO_VARIABLES, *(n for n in flown.names if n not in excluded and n not in RATIO_VARIABLES)]
    wall = np.interp(t, residual.march_s, residual.input.temperature_K[:, 0])
    kind = wall_enthalpy_of(record.declared.heating.wall_enthalpy)
    pressure = np.maximum(flown["p_surface_Pa"], 1e-3)
    H_w = np.diagonal(wall_enthalpy_grid(kind, wall, pressure))
    variables = {n: flown[n] for n in names} | {WALL: wall}
    # In a ground test nothing flows, and the ratio of enthalpies has no meaning.
    if np.all(flown["H_r_J_kg"] > 0.0):
        variables[ENTHALPY] = H_w / flown["H_r_J_kg"]
    return variables | {TIME: t}


def correlations(residual: ResidualHeating, variables: Mapping[str, FloatArray]) -> list[Correlation]:
    """The correlation with each variable at the lag where it is largest, largest first."""
    fitted = residual.fitted
    t, d, w = residual.time_s, residual.delta_ratio[fitted], residual.sigma[fitted] ** -2.0
    resolved = float(np.trace(residual.input.covariance @ residual.input.information))
    largest = []
    for name, v in variables.items():
        lags = (0.0,) if name == TIME else LAGS_S
        at_lags = [(_correlation(d, np.interp(t - lag, t, v)[fitted], w), lag) for lag in lags]
        value, lag = max(at_lags, key=lambda c: abs(c[0]))
        # A smoothed history has fewer independent points than knots: the trace counts those that the readings resolve.
        n = min(_effective_points(d, np.interp(t - lag, t, v)[fitted]), max(resolved, 3.0))
        largest.append((name, lag, value, n, _correlation_p_value(value, n)))
    # The largest over all lags and variables is reported: chance has had as many trials.
    trials = sum(1 if name == TIME else len(LAGS_S) for name in variables)
    corrected = [Correlation(*f, sidak_p_value(f[4], trials)) for f in largest]
    return sorted(corrected, key=lambda c: -abs(c.value))


def _correlation(d: FloatArray, v: FloatArray, w: FloatArray) -> float:
    """Weighted correlation coefficient of two series; 0 where one is constant."""
    d, v = d - np.average(d, weights=w), v - np.average(v, weights=w)
    size = math.sqrt(float(np.sum(w * d * d)) * float(np.sum(w * v * v)))
    return float(np.sum(w * d * v)) / size if size > 0.0 else 0.0


def _effective_points(d: FloatArray, v: FloatArray) -> float:
    """Bartlett's number of independent points of two series, at least 3."""
    n = len(d)
    sum_ = float(np.sum(_autocorrelation(d)[1:] * _autocorrelation(v)[1:]))
    return float(np.clip(n / max(1.0 + 2.0 * sum_, 1.0), 3.0, n))


def _autocorrelation(x: FloatArray) -> FloatArray:
    """(lag,) autocorrelation of a series, up to half its length."""
    x = x - np.mean(x)
    power = float(x @ x)
    lags = len(x) // 2
    if power == 0.0:
        return np.zeros(lags)
    spectrum = np.abs(np.fft.rfft(x, 2 * len(x))) ** 2
    return np.asarray(np.fft.irfft(spectrum)[:lags] / power)


def _correlation_p_value(r: float, n: float) -> float:
    """Two-sided p-value of a correlation r of n effective points."""
    r = min(abs(r), 1.0 - 1e-12)
    return float(2.0 * stdtr(n - 2.0, -r * math.sqrt((n - 2.0) / (1.0 - r * r))))


def active_spans(residual: ResidualHeating, ratio: FloatArray | None = None) -> list[ActiveSpan]:
    """Spans in which the history exceeds `active_sigmas` of its sigma, the largest first."""
    active_sigmas = 3.0  # a residual heating is active where it exceeds this many of its sigmas
    # active spans closer than the first are joined; spans shorter than the second are not reported [s]
    gap_s, min_span_s = 15.0, 5.0
    max_spans = 6
    t, d = residual.time_s, residual.delta_ratio
    beyond = residual.fitted & (np.abs(d) > active_sigmas * residual.sigma)
    spans: list[list[int]] = []
    for k in np.flatnonzero(beyond):
        if spans and t[k] - t[spans[-1][1]] <= gap_s and d[k] * d[spans[-1][1]] > 0.0:
            spans[-1][1] = int(k)
        else:
            spans.append([int(k), int(k)])
    half = 0.5 * float(np.median(np.diff(t)))
    active = []
    for first, last in spans:
        knots = slice(first, last + 1)
        over = float(np.mean(d[knots] / ratio[knots])) if ratio is not None and np.all(ratio[knots] > 0.0) else math.nan
        active.append(
            ActiveSpan(max(float(t[first]) - half, float(t[0])), float(t[last]) + half, float(np.mean(d[knots])), over)
        )
    long_enough = [a for a in active if a.end_s - a.start_s >= min_span_s]
    return _largest(long_enough)[:max_spans]


def _largest(spans: Sequence[ActiveSpan]) -> list[ActiveSpan]:
    """Spans in the order of their integrals of delta_ratio over time."""
    return sorted(spans, key=lambda a: -abs(a.delta_ratio) * (a.end_s - a.start_s))
