"""What a flight would tell before anyone flies it: bounds from the estimator's own sensitivities.

With S_i the sensitivity of sample i to all unknowns and I_i the information that its reading is expected to carry
(likelihood.expected_information: a rounded word carries less than the temperature it was rounded from),

    M = sum_i S_i I_i S_i' + P,   P = diag(1 / sigma_prior^2),   cov = M^-1 (Cramer and Rao)

Unknowns of one flight (clock, sensors, initial temperatures) are taken out of it, M_s|p = M_ss - M_sp M_pp^-1 M_ps, and
what is left adds up over flights. Criteria: D, the volume of the ellipsoid of the wanted parameters, and A, their mean
square bound over a given one (Atkinson, Donev and Tobias, "Optimum Experimental Designs, with SAS", 2007, ch. 10).

The surface pressure, which the conductivity of porous insulation follows, may be unknown by a factor: its sensitivity
is the difference of two marches. Noise is independent from sample to sample.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sim_heating.base.arrays import FloatArray
from sim_heating.base.errors import InputError
from sim_heating.base.parameters import CLOCK_SKEW, SENSOR_PREFIX, Parameter
from sim_heating.estimation.inference.identifiability import covariance
from sim_heating.estimation.inference.likelihood import expected_information
from sim_heating.estimation.inference.observability import variables_of
from sim_heating.estimation.problem import Problem, joint_reference
from sim_heating.estimation.record_fit import Samples, Start
from sim_heating.heating.effects import EffectUse
from sim_heating.inputs.record import Record
from sim_heating.thermal.stack import Sensor

PRESSURE = Parameter(
    "conditions.p_surface_factor", "1", 1.0, 0.3, 0.1, 10.0, "surface pressure over the one that is computed"
)
"""What a pressure measurement at the control point would tell; within 30 % without one."""
PRESSURE_MOVED = 0.05
"""Either side on which the pressure is marched for its sensitivity."""
LEVELS = 8
"""Places between two codes of a word at which a temperature is taken to lie, before it is known."""
PRIVATE = ("initial.", CLOCK_SKEW.name, SENSOR_PREFIX)
"""How names begin of what one flight does not share with another."""


@dataclass(frozen=True, eq=False)
class Seen:
    """What a sensor would show: (sample,) times [s] and readings [K], (sample, parameter) sensitivities, noise [K]."""

    sensor: Sensor
    time_s: FloatArray
    mean_K: FloatArray
    jacobian: FloatArray
    sigma_K: float

    def information(self, levels: int) -> FloatArray:
        """(parameter, parameter) expected of all samples, the mean over `levels` places between two codes."""
        moved = self.mean_K + self.sensor.lsb_K * np.arange(levels)[:, np.newaxis] / levels
        weight = np.mean(expected_information(self.sensor, moved, self.sigma_K), axis=0)
        return (self.jacobian * weight[:, np.newaxis]).T @ self.jacobian


@dataclass(frozen=True, eq=False)
class Experiment:
    """What one flight would tell of its unknowns.

    unknowns : with their priors before the flight, in the order of the sensitivities
    channels : by sensor
    levels   : 1 where the temperatures are taken as they are predicted, more where they are not known to a code
    """

    unknowns: tuple[Parameter, ...]
    channels: tuple[Seen, ...]
    levels: int = LEVELS

    @property
    def names(self) -> tuple[str, ...]:
        """Dotted names of the unknowns."""
        return tuple(p.name for p in self.unknowns)

    def place(self, wanted: Sequence[str]) -> list[int]:
        """Places of some parameters among the unknowns."""
        return [self.names.index(name) for name in wanted]

    def with_priors(self, sigma: Mapping[str, float]) -> Experiment:
        """The same with other standard deviations before the flight."""
        changed = tuple(replace(p, sigma=sigma.get(p.name, p.sigma)) for p in self.unknowns)
        return replace(self, unknowns=changed)

    def with_bits(self, bits: int | None) -> Experiment:
        """The same with other recorder words on every sensor that has one."""
        changed = [
            replace(c, sensor=c.sensor.model_copy(update={"bits": bits})) if c.sensor.bits is not None else c
            for c in self.channels
        ]
        return replace(self, channels=tuple(changed))

    def without(self, sensors: Collection[str]) -> Experiment:
        """The same without some thermocouples."""
        return replace(self, channels=tuple(c for c in self.channels if c.sensor.name not in sensors))

    def information(self) -> FloatArray:
        """(parameter, parameter) of the samples alone."""
        nothing = np.zeros((len(self.unknowns), len(self.unknowns)))
        return sum((c.information(self.levels) for c in self.channels), start=nothing)

    def covariance(self, wanted: Sequence[str], flights: int = 1) -> FloatArray:
        """(wanted, wanted) bound on some parameters after a number of like flights."""
        shared = np.array([not name.startswith(PRIVATE) for name in self.names])
        prior = np.array([p.sigma**-2.0 for p in self.unknowns])
        if flights == 1:
            whole, at = covariance(self.information() + np.diag(prior)), self.place(wanted)
        else:
            own = np.flatnonzero(shared)
            told = flights * taken_out(self.information(), prior, ~shared) + np.diag(prior[own])
            whole, at = covariance(told), [int(np.flatnonzero(own == k)[0]) for k in self.place(wanted)]
        return whole[np.ix_(at, at)]

    def sigma(self, wanted: Sequence[str], flights: int = 1) -> FloatArray:
        """(wanted,) bounds on some parameters, one standard deviation; infinite where nothing is told."""
        return np.sqrt(np.diag(self.covariance(wanted, flights)))


def taken_out(information: FloatArray, prior: FloatArray, private: NDArray[np.bool_]) -> FloatArray:
    """Information of one flight on what it shares with others, whatever its private unknowns are.

    information : (parameter, parameter) of the samples;  prior : (parameter,) 1 / sigma^2;  private : (parameter,)
    """
    s, p = np.flatnonzero(~private), np.flatnonzero(private)
    if len(p) == 0:
        return information
    cross = information[np.ix_(p, s)]
    own = information[np.ix_(p, p)] + np.diag(prior[p])
    scale = 1.0 / np.sqrt(np.maximum(np.diag(own), np.finfo(float).tiny))
    known = np.linalg.lstsq(own * np.outer(scale, scale), scale[:, np.newaxis] * cross, rcond=1e-12)[0]
    return information[np.ix_(s, s)] - (scale[:, np.newaxis] * cross).T @ known


def merit(criterion: str, found: FloatArray, planned: FloatArray) -> float:
    """A covariance (wanted, wanted) against the planned one as one ratio of bounds: 1 as planned, below 1 better.

    D : (det found / det planned)^(1 / 2k);   A : root mean square of the bounds over the planned ones
    infinite where something is not told
    """
    if not np.all(np.isfinite(found)):
        return np.inf
    s = np.sqrt(np.diag(planned))
    if criterion == "A":
        return float(np.sqrt(np.mean(np.diag(found) / s**2)))
    change = np.linalg.slogdet(found / np.outer(s, s))[1] - np.linalg.slogdet(planned / np.outer(s, s))[1]
    return float(np.exp(0.5 * change / len(s)))


def experiment(
    record: Record,
    names: Sequence[str],
    *,
    effects: Sequence[EffectUse] = (),
    start: Start | None = None,
    reference: Mapping[str, float] | None = None,
) -> Experiment:
    """What a record's flight conditions, sensors and sample times would tell; its readings are not looked at.

    names    : dotted names of what is unknown, PRESSURE's too; what `start` leaves unknown comes on top
    raises   : InputError where the record has no sample within its fit segments, RunError where a march failed
    """
    about = joint_reference([record], reference)
    marched = [n for n in names if n != PRESSURE.name]
    problem = Problem([record], marched, about, effects=effects, starts=[start])
    unknowns = tuple(replace(u.parameter, name=u.label) for u in problem.unknowns)
    values = np.array([p.value for p in unknowns])
    found = problem.samples(values)
    columns = [s.jacobian for s in found]
    if PRESSURE.name in names:
        unknowns = (*unknowns, PRESSURE)
        slopes = _pressure_slopes(record, about, effects, start)
        columns = [np.column_stack([c, slope]) for c, slope in zip(columns, slopes, strict=True)]
    pairs = zip(found, columns, strict=True)
    return Experiment(unknowns, tuple(Seen(s.channel.sensor, s.time_s, s.mean_K, c, s.sigma_K) for s, c in pairs))


def _pressure_slopes(
    record: Record, about: tuple[float, ...], effects: Sequence[EffectUse], start: Start | None
) -> list[FloatArray]:
    """By channel, (sample,) change of the indications [K] with the factor on the surface pressure."""
    known = None if start is None else replace(start, columns=start.columns[:, :0], unknowns=())
    sides: list[list[Samples]] = []
    for factor in (1.0 + PRESSURE_MOVED, 1.0 - PRESSURE_MOVED):
        pressure = factor * record.conditions["p_surface_Pa"]
        moved = replace(record, conditions=record.conditions.with_columns(p_surface_Pa=pressure))
        sides.append(Problem([moved], [], about, effects=effects, starts=[known]).samples(np.zeros(0)))
    return [(high.mean_K - low.mean_K) / (2.0 * PRESSURE_MOVED) for high, low in zip(*sides, strict=True)]


def would_buy(
    names: Sequence[str], information: FloatArray, prior: FloatArray, larger: float = 2.0, longer: float = 2.0
) -> dict[str, dict[str, float]]:
    """What more of a flown manoeuvre would make of each derivative's bound, as a factor on it.

    `larger`: excursions of that variable about the reference times `larger`, all else as it was; the temperatures are
    linear in a derivative times its excursion. `longer`: as many more samples of the same kind.

    information : (parameter, parameter) of the samples;  prior : (parameter,) 1 / sigma^2
    """
    now = np.sqrt(np.diag(covariance(information + np.diag(prior))))
    long = np.sqrt(np.diag(covariance(longer * information + np.diag(prior))))
    found = {}
    for k, name in enumerate(names):
        variables = variables_of(name)
        if not variables or not np.isfinite(now[k]):
            continue
        factor = np.array([larger ** _common(variables, variables_of(n)) for n in names])
        large = np.sqrt(np.diag(covariance(information * np.outer(factor, factor) + np.diag(prior))))
        found[name] = {"larger": float(large[k] / now[k]), "longer": float(long[k] / now[k])}
    return found


def _common(moved: Sequence[int], of: Sequence[int]) -> int:
    """How often the variables that are moved stand in a derivative."""
    return sum(i in moved for i in of)


def check_wanted(found: Experiment, wanted: Sequence[str]) -> None:
    """Refuse parameters of which the planned flight tells nothing.

    raises : InputError naming them
    """
    sigma = found.sigma(wanted)
    prior = [found.unknowns[k].sigma for k in found.place(wanted)]
    nothing = [n for n, s, p in zip(wanted, sigma, prior, strict=True) if not (np.isfinite(s) and s < 0.999 * p)]
    if nothing:
        raise InputError(
            f"design: the flight as planned tells nothing of {', '.join(nothing)}; plan a manoeuvre that moves its "
            "variable, or leave it out of `parameters`"
        )
