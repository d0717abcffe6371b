"""What a residual heating goes with: variables of the flight at lags, manoeuvres, a step in axial acceleration.

Correlations weigh each knot by 1 / sigma^2. Neighbours are not independent: the effective number of points is

    n_e = n / (1 + 2 sum_k rho_d(k) rho_v(k)),

rho the autocorrelations of the residual and of the variable (M. S. Bartlett, J. R. Stat. Soc. 98 (1935) 536), at most
the degrees of freedom that the readings resolve, and the chance of a correlation as large is that of Student's t with
n_e - 2. The look-elsewhere is that over variables and lags (Sidak).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from scipy.stats import t as student

from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import HEATING, RATIO_VARIABLES, STATE
from sim_heating.base.threads import one_thread
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
from sim_heating.estimation.inference.residual_tests import sidak_p_value
from sim_heating.heating.reference.gas import wall_enthalpy_grid
from sim_heating.inputs.points import conditions_of_record, wall_enthalpy_of
from sim_heating.simulation.predict import Prediction

WALL, ENTHALPY = "wall_K", "wall_enthalpy_ratio"
ACTIVE = 3.0
"""A residual heating is active where it exceeds so many of its sigmas."""
GAP_S, SHORTEST_S = 15.0, 5.0
"""Active spans closer than this are one; shorter ones are not told [s]."""
MOST_SPANS = 6
SIGNS = 2.0
LARGEST = 3.0
"""A shape that would have to be larger than so many times the history cancels against what was fitted: no proposal."""
SIGNIFICANCE_LEVEL = 0.01
"""A chance below this is called significant."""


@dataclass(frozen=True)
class Correlation:
    """Weighted correlation of the residual heating with a variable at the lag where it is largest.

    chance : of one as large from a history that has nothing to do with it, at this lag;  chance_all : at any variable
             and lag looked at
    """

    variable: str
    lag_s: float
    value: float
    n_effective: float
    chance: float
    chance_all: float


@dataclass(frozen=True)
class ActiveSpan:
    """A span in which the residual heating exceeds its sigma.

    delta_ratio : mean;  relative : over the model's ratio, NaN where that is unknown
    """

    start_s: float
    end_s: float
    delta_ratio: float
    relative: float


@dataclass(frozen=True)
class ResidualEvidence:
    """What a residual heating tells.

    correlations : a variable each, largest first
    followed     : the best shape of each variable, largest gain first
    looks        : independent looks that the shapes make
    chance       : of a shape as good from noise alone, looks included
    active       : spans, the largest first
    loops        : hysteresis in manoeuvres
    axial        : steps in axial acceleration; None where the record has none
    negative_s   : how long the ratio would have to be negative, by more than SIGNS sigma; None where it is not known
    """

    correlations: tuple[Correlation, ...]
    followed: tuple[ShapeFit, ...]
    looks: float
    chance: float
    active: tuple[ActiveSpan, ...]
    loops: tuple[HysteresisLoop, ...]
    axial: tuple[AxialStep, ...] | None
    negative_s: float | None = None

    def proposal(self) -> list[str]:
        """What a person would look at next, a line each: which variable, at which lag, active when, how large."""
        if not self.followed or self.chance > SIGNIFICANCE_LEVEL:
            return ["Nothing is left that noise would not leave."]
        best = self.followed[0]
        lines = [
            f"What is left goes with {best.shape.words()}: {best.amplitude:+.3g} of ratio at its largest, "
            f"{abs(best.z):.0f} sigma; that is {best.share:.0%} of what any heating history would explain."
        ]
        rivals = [f for f in self.followed[1:] if f.share > 0.8 * best.share]
        if rivals:
            told = "; ".join(f"{r.shape.words()} ({r.share:.0%})" for r in rivals[:3])
            lines.append(f"Nearly as well: {told}. The record does not tell these apart.")
        if best.shape.form == "rate":
            lines.append(
                "A heating that follows a rate of change is the mark of coating, clock or lag, not of a table."
            )
        if self.negative_s:
            lines.append(
                f"For {self.negative_s:.0f} s the heating ratio would have to be negative: no heating does that; look "
                "at conduction, sensors and clocks."
            )
        if best.share < 0.5:
            lines.append("No variable explains half of it: look for something that the record does not hold.")
        for span in self.active[:3]:
            size = f"{span.delta_ratio:+.3g}" + ("" if math.isnan(span.relative) else f" ({span.relative:+.0%})")
            lines.append(f"Active from {span.start_s:.0f} to {span.end_s:.0f} s: {size} of ratio on average.")
        lines += self._hysteresis()
        lines += [step.words() + self._with(step) for step in self.axial or () if step.chance < SIGNIFICANCE_LEVEL]
        return lines

    def _with(self, step: AxialStep) -> str:
        """How far a step in acceleration is from where the residual heating sets in or ends."""
        edges = [edge for span in self.active for edge in (span.start_s, span.end_s)]
        if not edges:
            return ""
        nearest = min(edges, key=lambda edge: abs(edge - step.time_s))
        return f" The missing heating sets in or ends {abs(nearest - step.time_s):.0f} s from there."

    def _hysteresis(self) -> list[str]:
        told = sorted((loop for loop in self.loops if loop.significant), key=lambda loop: -abs(loop.filled))
        if not told:
            return []
        more = f" {len(told)} of {len(self.loops)} excursions of an angle show it." if len(told) > 1 else ""
        return [told[0].words() + more]

    def numbers(self) -> dict[str, Any]:
        """For closure.json."""
        return {
            "correlations": [asdict(c) for c in self.correlations],
            "follows": [
                {**asdict(f.shape), "amplitude": f.amplitude, "z": f.z, "gain": f.gain, "share": f.share}
                for f in self.followed
            ],
            "independent_looks": self.looks,
            "chance_from_noise": self.chance,
            "active": [{k: None if v != v else v for k, v in asdict(a).items()} for a in self.active],
            "hysteresis": [loop.numbers() for loop in self.loops],
            "negative_ratio_s": self.negative_s,
            "axial_steps": None if self.axial is None else [asdict(s) for s in self.axial],
        }


def residual_evidence(residual: ResidualHeating, ratio: FloatArray | None = None) -> ResidualEvidence:
    """Everything above for one residual heating.

    ratio : (knot,) the model's heating ratio, where it is known
    """
    with one_thread():
        return _evidence(residual, ratio)


def _evidence(residual: ResidualHeating, ratio: FloatArray | None) -> ResidualEvidence:
    here = residual.fitted
    t, variables = residual.time_s, flight_variables(residual)
    weights = profiled_information(residual)
    tried, columns = candidate_shapes(t, variables)
    largest = LARGEST * float(np.max(np.abs(residual.delta_ratio)))
    found = [f for f in weights.weigh(tried, columns) if abs(f.amplitude) <= largest]
    names = dict.fromkeys(f.shape.variable for f in found)
    best = [next(f for f in found if f.shape.variable == name) for name in names]
    several = trials_factor(weights, columns)
    return ResidualEvidence(
        tuple(correlations(residual, {n: v for n, v in variables.items() if np.ptp(v[here]) > 0.0})),
        tuple(best), several, p_value(best[0].z, several) if best else 1.0,
        tuple(active_spans(residual, ratio)), tuple(hysteresis_loops(residual, variables)),
        axial_steps(residual.record),
        None if ratio is None else negative_s(residual, ratio),
    )  # fmt: skip


def ratio_at(prediction: Prediction, time_s: FloatArray) -> FloatArray | None:
    """The heating ratio of a prediction at other times; None where there is no aerodynamic heating."""
    history = prediction.history
    known = np.isfinite(history.ratio)
    return np.interp(time_s, history.time_s[known], history.ratio[known]) if np.any(known) else None


def negative_s(residual: ResidualHeating, ratio: FloatArray) -> float:
    """How long ratio and correction together are negative [s], by more than SIGNS sigma."""
    below = residual.fitted & (ratio + residual.delta_ratio < -SIGNS * residual.sigma)
    return float(np.sum(np.gradient(residual.time_s)[below]))


def flight_variables(residual: ResidualHeating) -> dict[str, FloatArray]:
    """(knot,) what a heating may depend on: the ratio variables, jets, further columns of the record, wall temperature
    and enthalpy over the recovery enthalpy, time."""
    record, t = residual.record, residual.time_s
    flown = conditions_of_record(record).at(t)
    known = {*STATE, *HEATING, "q_add_W_m2"} - {"mach"}
    names = [*RATIO_VARIABLES, *(n for n in flown.names if n not in known and n not in RATIO_VARIABLES)]
    wall = np.interp(t, residual.march_s, residual.input.temperature_K[:, 0])
    kind = wall_enthalpy_of(record.declared.heating.wall_enthalpy)
    pressure = np.maximum(flown["p_surface_Pa"], 1e-3)
    H_w = np.diagonal(wall_enthalpy_grid(kind, wall, pressure))
    found = {n: flown[n] for n in names} | {WALL: wall}
    if np.all(flown["H_r_J_kg"] > 0.0):
        found[ENTHALPY] = H_w / flown["H_r_J_kg"]
    return found | {TIME: t}


def correlations(residual: ResidualHeating, variables: Mapping[str, FloatArray]) -> list[Correlation]:
    """Each variable at the lag of its largest correlation, largest first."""
    here = residual.fitted
    t, d, w = residual.time_s, residual.delta_ratio[here], residual.sigma[here] ** -2.0
    resolved = float(np.trace(residual.input.covariance @ residual.input.information))
    found = []
    for name, v in variables.items():
        lags = (0.0,) if name == TIME else LAGS_S
        tried = [(_correlation(d, np.interp(t - lag, t, v)[here], w), lag) for lag in lags]
        value, lag = max(tried, key=lambda c: abs(c[0]))
        n = min(_effective(d, np.interp(t - lag, t, v)[here]), max(resolved, 3.0))
        found.append((name, lag, value, n, _chance(value, n)))
    several = sum(1 if name == TIME else len(LAGS_S) for name in variables)
    told = [Correlation(*f, sidak_p_value(f[4], several)) for f in found]
    return sorted(told, key=lambda c: -abs(c.value))


def _correlation(d: FloatArray, v: FloatArray, w: FloatArray) -> float:
    d, v = d - np.average(d, weights=w), v - np.average(v, weights=w)
    size = math.sqrt(float(np.sum(w * d * d)) * float(np.sum(w * v * v)))
    return float(np.sum(w * d * v)) / size if size > 0.0 else 0.0


def _effective(d: FloatArray, v: FloatArray) -> float:
    """Bartlett's number of independent points of two series, at least 3."""
    n = len(d)
    sum_ = float(np.sum(_autocorrelation(d)[1:] * _autocorrelation(v)[1:]))
    return float(np.clip(n / max(1.0 + 2.0 * sum_, 1.0), 3.0, n))


def _autocorrelation(x: FloatArray) -> FloatArray:
    x = x - np.mean(x)
    power = float(x @ x)
    lags = len(x) // 2
    if power == 0.0:
        return np.zeros(lags)
    spectrum = np.abs(np.fft.rfft(x, 2 * len(x))) ** 2
    return np.asarray(np.fft.irfft(spectrum)[:lags] / power)


def _chance(r: float, n: float) -> float:
    r = min(abs(r), 1.0 - 1e-12)
    return float(2.0 * student.sf(r * math.sqrt((n - 2.0) / (1.0 - r * r)), n - 2.0))


def active_spans(residual: ResidualHeating, ratio: FloatArray | None = None) -> list[ActiveSpan]:
    """Spans in which the history exceeds ACTIVE sigma, the largest first."""
    t, d = residual.time_s, residual.delta_ratio
    beyond = residual.fitted & (np.abs(d) > ACTIVE * residual.sigma)
    spans: list[list[int]] = []
    for k in np.flatnonzero(beyond):
        if spans and t[k] - t[spans[-1][1]] <= GAP_S and d[k] * d[spans[-1][1]] > 0.0:
            spans[-1][1] = int(k)
        else:
            spans.append([int(k), int(k)])
    half = 0.5 * float(np.median(np.diff(t)))
    found = []
    for first, last in spans:
        own = slice(first, last + 1)
        over = float(np.mean(d[own] / ratio[own])) if ratio is not None and np.all(ratio[own] > 0.0) else math.nan
        found.append(
            ActiveSpan(max(float(t[first]) - half, float(t[0])), float(t[last]) + half, float(np.mean(d[own])), over)
        )
    told = [a for a in found if a.end_s - a.start_s >= SHORTEST_S]
    return _largest(told)[:MOST_SPANS]


def _largest(spans: Sequence[ActiveSpan]) -> list[ActiveSpan]:
    return sorted(spans, key=lambda a: -abs(a.delta_ratio) * (a.end_s - a.start_s))
