"""Predicted bounds of a flight before it is flown, from the estimator's own sensitivities.

With S_i the sensitivity of sample i to all unknowns and I_i the information that its reading is expected to carry
(likelihood.expected_information: a rounded word carries less than the temperature it was rounded from),

    M = sum_i S_i I_i S_i' + P,   P = diag(1 / sigma_prior^2),   cov = M^-1 (Cramer and Rao)

Unknowns of one flight (clock, sensors, initial temperatures) are marginalised, M_s|p = M_ss - M_sp M_pp^-1 M_ps, and
the result adds up over flights. Criteria: D, the volume of the ellipsoid of the wanted parameters, and A, their mean
square bound over a given one (Atkinson, Donev and Tobias, "Optimum Experimental Designs, with SAS", 2007, ch. 10).

The surface pressure, which the conductivity of porous insulation follows, may be unknown by a factor: its sensitivity
is the difference of two marches. Noise is independent from sample to sample. Derived in
docs/how_to/manoeuvre_design.md, equations 1 to 6.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sim_heating.base.arrays import FloatArray
from sim_heating.base.errors import InputError
from sim_heating.base.parameters import PRESSURE_FACTOR, RECORD_PARAMETERS, SENSOR_PREFIX, Parameter
from sim_heating.estimation.inference.identifiability import covariance
from sim_heating.estimation.inference.likelihood import expected_information
from sim_heating.estimation.inference.observability import variables_of
from sim_heating.estimation.problem import FitOptions, FitProblem, joint_reference
from sim_heating.estimation.record_fit import Start
from sim_heating.heating.effects import EffectUse
from sim_heating.inputs.record import Record
from sim_heating.thermal.stack import Sensor

LEVELS = 8
"""Number of levels between two codes of a word over which an unknown temperature is averaged."""
PRIVATE = ("initial.", *(n for n in RECORD_PARAMETERS if n != PRESSURE_FACTOR.name), SENSOR_PREFIX)
"""Prefixes of the names of unknowns that one flight does not share with another; the error of a computed pressure is
that of its model, and comes again."""


@dataclass(frozen=True, eq=False)
class PredictedChannel:
    """Predicted samples of one sensor.

    sensor   : its declaration
    time_s   : (sample,) [s];  mean_K : (sample,) predicted indications [K]
    jacobian : (sample, parameter) sensitivities [K] per unit of each parameter
    sigma_K  : () or (sample,) noise [K]
    """

    sensor: Sensor
    time_s: FloatArray
    mean_K: FloatArray
    jacobian: FloatArray
    sigma_K: FloatArray | float

    def information(self) -> FloatArray:
        """(parameter, parameter) expected information of all samples of the sensor.

            sum_i S_i S_i' mean_j E I(m_i + j LSB / LEVELS)

        Source: docs/how_to/manoeuvre_design.md, equations 1 and 2.
        """
        # where a temperature lies between two codes is not known before a flight: an average over the step
        mean_K = self.mean_K + self.sensor.lsb_K * np.arange(LEVELS)[:, np.newaxis] / LEVELS
        weight = np.mean(expected_information(self.sensor, mean_K, self.sigma_K), axis=0)
        return (self.jacobian * weight[:, np.newaxis]).T @ self.jacobian


@dataclass(frozen=True, eq=False)
class Experiment:
    """Expected information of one flight on its unknowns.

    unknowns : with their priors before the flight, in the order of the sensitivities
    channels : predicted samples by sensor

    Source: docs/how_to/manoeuvre_design.md, equations 1 to 3.
    """

    unknowns: tuple[Parameter, ...]
    channels: tuple[PredictedChannel, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """Dotted names of the unknowns, in the order of the sensitivities."""
        return tuple(p.name for p in self.unknowns)

    def indices(self, names: Sequence[str]) -> list[int]:
        """Indices of some parameters among the unknowns."""
        return [self.names.index(name) for name in names]

    def with_priors(self, sigma: Mapping[str, float]) -> Experiment:
        """Copy with other standard deviations before the flight.

        sigma : dotted name -> standard deviation, in the unit of the parameter ([-] for a ratio); others stay

        P of docs/how_to/manoeuvre_design.md, equation 1.
        """
        changed = tuple(replace(p, sigma=sigma.get(p.name, p.sigma)) for p in self.unknowns)
        return replace(self, unknowns=changed)

    def with_bits(self, bits: int | None) -> Experiment:
        """Copy with recorder words of this number of bits [-] on every sensor that has one; None for no rounding.

        The span stays, so that the step [K] follows; its information, docs/theory/estimation_statistics.md,
        equation 11.
        """
        changed = [
            replace(c, sensor=c.sensor.model_copy(update={"bits": bits})) if c.sensor.bits is not None else c
            for c in self.channels
        ]
        return replace(self, channels=tuple(changed))

    def without(self, sensors: Collection[str]) -> Experiment:
        """Copy without some thermocouples, by their names."""
        return replace(self, channels=tuple(c for c in self.channels if c.sensor.name not in sensors))

    def information(self) -> FloatArray:
        """(parameter, parameter) expected information of the samples alone, without priors ([-] for ratios).

        Source: docs/how_to/manoeuvre_design.md, equations 1 and 2.
        """
        nothing = np.zeros((len(self.unknowns), len(self.unknowns)))
        return sum((c.information() for c in self.channels), start=nothing)

    def covariance(self, names: Sequence[str], flights: int = 1) -> FloatArray:
        """(names, names) Cramer-Rao bound on some parameters after a number of such flights.

            flights = 1: (M + P)^-1;   else (n M_s|p + P_ss)^-1, private unknowns of each flight marginalised

        names   : dotted names; shared between flights where there are several
        flights : number n of flights [-]
        returns : in products of the parameters' units; infinite variance where a parameter is not identified

        Source: docs/how_to/manoeuvre_design.md, equations 1 and 3.
        """
        shared = np.array([not name.startswith(PRIVATE) for name in self.names])
        prior = np.array([p.sigma**-2.0 for p in self.unknowns])
        # one flight needs no elimination, and its private unknowns may then be wanted as well
        if flights == 1:
            bounds, at = covariance(self.information() + np.diag(prior)), self.indices(names)
        else:
            shared_at = np.flatnonzero(shared)
            total = flights * marginalise(self.information(), prior, ~shared) + np.diag(prior[shared_at])
            bounds, at = covariance(total), [int(np.flatnonzero(shared_at == k)[0]) for k in self.indices(names)]
        return bounds[np.ix_(at, at)]

    def sigma(self, names: Sequence[str], flights: int = 1) -> FloatArray:
        """(names,) bounds on some parameters, one standard deviation; infinite where one is not identified.

        names   : dotted names;  flights : number of such flights [-]
        returns : each in the unit of its parameter

        Source: docs/how_to/manoeuvre_design.md, equations 1 and 3.
        """
        return np.sqrt(np.diag(self.covariance(names, flights)))


def marginalise(information: FloatArray, prior: FloatArray, private: NDArray[np.bool_]) -> FloatArray:
    """Information of one flight on the unknowns that it shares with others, its private ones marginalised.

        M_s|p = M_ss - M_sp (M_pp + P_pp)^-1 M_ps

    information : (parameter, parameter) of the samples ([-] for parameters without unit)
    prior       : (parameter,) 1 / sigma^2;  private : (parameter,) boolean mask
    returns     : (shared, shared); least squares where a private unknown is not identified at all

    Source: docs/how_to/manoeuvre_design.md, equation 3.
    """
    s, p = np.flatnonzero(~private), np.flatnonzero(private)
    if len(p) == 0:
        return information
    cross = information[np.ix_(p, s)]
    private_information = information[np.ix_(p, p)] + np.diag(prior[p])
    # scaled to ones on the diagonal: private unknowns have units from s to K
    scale = 1.0 / np.sqrt(np.maximum(np.diag(private_information), np.finfo(float).tiny))
    solved = np.linalg.lstsq(private_information * np.outer(scale, scale), scale[:, np.newaxis] * cross, rcond=1e-12)[0]
    return information[np.ix_(s, s)] - (scale[:, np.newaxis] * cross).T @ solved


def design_criterion(criterion: str, bounds: FloatArray, planned: FloatArray) -> float:
    """Bounds of a design over those of the plan as one ratio [-]: 1 for the plan, below 1 for a better design.

        D : (det bounds / det planned)^(1 / 2k);   A : root mean square of the bounds over the planned ones

    criterion       : "D" or "A"
    bounds, planned : (parameter, parameter) covariances
    returns         : infinite where a parameter is not identified

    Source: Atkinson, Donev and Tobias (2007), chapter 10; docs/how_to/manoeuvre_design.md, equation 5.
    """
    if not np.all(np.isfinite(bounds)):
        return np.inf
    s = np.sqrt(np.diag(planned))
    if criterion == "A":
        return float(np.sqrt(np.mean(np.diag(bounds) / s**2)))
    # over the planned sigmas, so that the determinants do not depend on units and do not underflow
    change = np.linalg.slogdet(bounds / np.outer(s, s))[1] - np.linalg.slogdet(planned / np.outer(s, s))[1]
    return float(np.exp(0.5 * change / len(s)))


def experiment(
    record: Record,
    names: Sequence[str],
    *,
    effects: Sequence[EffectUse] = (),
    start: Start | None = None,
) -> Experiment:
    """Expected information of a record's flight conditions, sensors and sample times; its readings are not used.

    names     : dotted names of the unknowns
    effects   : in addition to the declared model
    start     : start of the march; its unknowns are added to `names`
    returns   : predictions [K] and sensitivities at the prior means
    raises    : InputError where the record has no sample within its fit segments, RunError where a march failed

    Source: docs/how_to/manoeuvre_design.md, equations 1, 2 and 4.
    """
    problem = FitProblem([record], names, joint_reference([record]), FitOptions(effects=effects, starts=[start]))
    unknowns = tuple(replace(u.parameter, name=u.label) for u in problem.unknowns)
    predicted = problem.samples(np.array([p.value for p in unknowns]))
    channels = [
        PredictedChannel(s.channel.sensor, s.time_s, s.mean_K, s.jacobian, s.channel.noise_K(s.sigma_K))
        for s in predicted
    ]
    return Experiment(unknowns, tuple(channels))


def sensitivity_to_effort(
    names: Sequence[str], information: FloatArray, prior: FloatArray
) -> dict[str, dict[str, float]]:
    """Factor on each derivative's bound with twice the excursions or twice the samples of a flown manoeuvre.

        larger : M_jk -> 2^(n_j + n_k) M_jk, excursions of that derivative's variables twice as large
        longer : M -> 2 M, twice as many samples of the same kind

    names       : (parameter,);  information : (parameter, parameter) of the samples;  prior : (parameter,) 1 / sigma^2
    returns     : derivative -> new bound over the old one [-], by "larger" and "longer"; unidentified ones are omitted

    n_j counts the scaled variables in parameter j, a squared one once. Temperatures are linear in a derivative times
    its excursion. Source: docs/how_to/manoeuvre_design.md, equation 6.
    """
    now = np.sqrt(np.diag(covariance(information + np.diag(prior))))
    long = np.sqrt(np.diag(covariance(2.0 * information + np.diag(prior))))
    factors = {}
    for k, name in enumerate(names):
        variables = variables_of(name)
        if not variables or not np.isfinite(now[k]):
            continue
        # a derivative times its excursion is what the march sees: larger excursions scale the columns of the
        # information
        factor = np.array([2.0 ** sum(i in variables for i in variables_of(n)) for n in names])
        large = np.sqrt(np.diag(covariance(information * np.outer(factor, factor) + np.diag(prior))))
        factors[name] = {"larger": float(large[k] / now[k]), "longer": float(long[k] / now[k])}
    return factors


def check_identified(planned: Experiment, names: Sequence[str]) -> None:
    """Check that the planned flight identifies the wanted parameters.

    raises : InputError naming those whose bound is infinite or not below 0.999 of their prior's sigma [-]

    Bounds: docs/how_to/manoeuvre_design.md, equation 1.
    """
    sigma = planned.sigma(names)
    prior = [planned.unknowns[k].sigma for k in planned.indices(names)]
    unidentified = [n for n, s, p in zip(names, sigma, prior, strict=True) if not (np.isfinite(s) and s < 0.999 * p)]
    if unidentified:
        raise InputError(
            f"design: the flight as planned does not identify {', '.join(unidentified)}; plan a manoeuvre that changes "
            "its variable, or remove it from `parameters`"
        )
