"""The most informative manoeuvre within the limits: a Sobol set over the numbers that may vary, then Nelder and Mead.

The value of a design is the ratio of its bounds to the planned ones (information.design_criterion). Designs that exceed
a limit rank behind all that keep the limits, by how far they exceed them; the result is the best design that was flown
and keeps all limits.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError
from scipy.optimize import minimize
from scipy.stats import qmc

from sim_heating.base.arrays import FloatArray
from sim_heating.base.errors import InputError, RunError
from sim_heating.base.progress import Progress, no_progress
from sim_heating.estimation.design.information import Experiment, check_identified, design_criterion
from sim_heating.estimation.design.planned_flight import PlannedFlight, Planner
from sim_heating.estimation.inference.observability import constant_variables
from sim_heating.inputs.scenario import DesignVariable
from sim_heating.trajectory.spec import Manoeuvre

INFEASIBLE = 10.0
"""Value of a design that exceeds a limit, increased by how far; no other design has a larger one."""
TOLERANCES = {"_K": 10.0, "_deg": 1.0, "_Pa": 500.0, "_m": 500.0, "_s": 5.0}
"""Excesses over limits that count equally, by unit."""
TRIGGERS = ("at_velocity_m_s", "at_mach")
SPEEDS = (0.75, 1.05)
"""Range of speed or Mach number over the planned one, where a scenario names nothing to vary."""
SHAPES = (0.5, 2.0)
"""Range of the manoeuvre's amplitudes, rate and holds over the planned ones."""


@dataclass(frozen=True, eq=False)
class TriedDesign:
    """One design that was evaluated.

    x         : (vary,) numbers
    criterion : information.design_criterion, or INFEASIBLE and more [-];  feasible : whether it keeps the limits
    sigma     : (wanted,) bounds; NaN where it does not keep the limits
    """

    x: FloatArray
    criterion: float
    feasible: bool
    sigma: FloatArray


@dataclass(frozen=True, eq=False)
class BoundsSweep:
    """Bounds along one number about the best design.

    vary     : the number;  value : (point,) its values
    sigma    : (point, wanted) bounds;  feasible : (point,) whether the limits are kept
    """

    vary: DesignVariable
    value: FloatArray
    sigma: FloatArray
    feasible: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class DesignSearchResult:
    """The outcome of a search.

    names         : of the unknowns;  priors : standard deviations that differ from the parameters' own
    vary          : numbers that were varied
    planned, best : flights;  planned_experiment, best_experiment : their expected information
    designs       : all that were evaluated, in order
    """

    names: tuple[str, ...]
    priors: dict[str, float]
    vary: tuple[DesignVariable, ...]
    planned: PlannedFlight
    planned_experiment: Experiment
    best: PlannedFlight
    best_experiment: Experiment
    designs: tuple[TriedDesign, ...]


class DesignSearch:
    """Search over the designs of one scenario, with all that were evaluated."""

    def __init__(self, planner: Planner) -> None:
        self.planner, self.design = planner, planner.design
        self.manoeuvres = planner.scenario.declared.trajectory.manoeuvre
        self.vary = tuple(self.design.vary) or _default_vary(self.manoeuvres)
        self.planned = planner.fly(self.manoeuvres)
        if "manoeuvres reached" in self.planned.margins:
            raise InputError(
                f"{planner.scenario.path}, [[trajectory.manoeuvre]]: a trigger is never met in the 3-DOF flight; "
                "change it, or [trajectory.stop]"
            )
        # checked on the planned flight: the search would otherwise compare bounds that are all infinite
        constant = constant_variables(planner.targets, [planner.record(self.planned, planner.instruments)[0]])
        if constant:
            raise InputError(*(f"{planner.scenario.path}: {name}: {reason}" for name, reason in constant.items()))
        self.names = planner.names(self.planned)
        self.priors = planner.priors(self.names, self.planned)
        self.planned_experiment = planner.experiment(self.planned, self.names, self.priors)
        check_identified(self.planned_experiment, planner.targets)
        self.planned_covariance = self.planned_experiment.covariance(planner.targets)
        self.designs: list[TriedDesign] = []
        self.best: tuple[float, PlannedFlight, Experiment] | None = None

    @property
    def low(self) -> FloatArray:
        """(vary,) least values."""
        return np.array([v.low for v in self.vary])

    @property
    def high(self) -> FloatArray:
        """(vary,) greatest values."""
        return np.array([v.high for v in self.vary])

    def planned_values(self) -> FloatArray:
        """(vary,) values of the scenario."""
        return np.array([getattr(self.manoeuvres[v.manoeuvre - 1], v.key) for v in self.vary])

    def manoeuvres_at(self, x: FloatArray) -> tuple[Manoeuvre, ...]:
        """The manoeuvres with other values of the (vary,) numbers."""
        changes: list[dict[str, float]] = [{} for _ in self.manoeuvres]
        for v, value in zip(self.vary, x, strict=True):
            changes[v.manoeuvre - 1][v.key] = float(value)
        try:
            pairs = zip(self.manoeuvres, changes, strict=True)
            return tuple(type(m).model_validate({**m.model_dump(), **change}) for m, change in pairs)
        except ValidationError as error:
            first = error.errors()[0]
            raise InputError(
                f"{self.planner.scenario.path}, [design]: {first['loc'][-1]} = {first['input']}: {first['msg']}"
            ) from None

    def evaluate(self, x: FloatArray) -> TriedDesign:
        """Fly a design, and find its bounds if it keeps the limits."""
        flown = self.planner.fly(self.manoeuvres_at(x))
        unknown = np.full(len(self.planner.targets), np.nan)
        if not flown.feasible:
            # graded by the excess, so that the simplex finds its way back to designs within the limits
            tried = TriedDesign(x, INFEASIBLE + _limit_excess(flown), False, unknown)
        else:
            experiment = self.planner.experiment(flown, self.names, self.priors)
            covariance = experiment.covariance(self.planner.targets)
            value = min(design_criterion(self.design.criterion, covariance, self.planned_covariance), INFEASIBLE)
            tried = TriedDesign(x, value, True, np.sqrt(np.diag(covariance)))
            if self.best is None or value < self.best[0]:
                self.best = (value, flown, experiment)
        self.designs.append(tried)
        return tried

    def run(self, progress: Progress = no_progress) -> DesignSearchResult:
        """Search.

        raises : RunError where no design keeps the limits
        """
        total, span = self.design.evaluations, self.high - self.low

        def value(u: FloatArray) -> float:
            tried = self.evaluate(self.low + np.clip(u, 0.0, 1.0) * span)
            status = f"bounds {self.best[0]:.3f} of the planned ones" if self.best else "none within the limits yet"
            progress(min(len(self.designs) / total, 1.0), f"searching: {len(self.designs)} designs, {status}")
            return tried.criterion

        # the plan is the first design, so that the result is no worse than the plan where that keeps the limits
        value((self.planned_values() - self.low) / span)
        half = total // 2
        # a simplex needs more designs than it has corners; with fewer, all go to the Sobol set
        first_count = half if half > len(self.vary) + 1 else total - 1
        # a fixed seed: the same scenario gives the same design
        sobol = qmc.Sobol(len(self.vary), rng=np.random.default_rng(1))
        for u in sobol.random_base2(int(np.ceil(np.log2(max(first_count, 1)))))[:first_count]:
            value(u)
        remaining = total - len(self.designs)
        if remaining > len(self.vary):
            first = min(self.designs, key=lambda t: t.criterion)
            # from a corner of the box the first simplex would be clipped flat
            start = np.clip((first.x - self.low) / span, 0.05, 0.95)
            box = [(0.0, 1.0)] * len(self.vary)
            minimize(value, start, method="Nelder-Mead", bounds=box, options={"maxfev": remaining, "xatol": 1e-3})
        if self.best is None:
            raise RunError(f"design: {self._nearest()}")
        _, best, experiment = self.best
        return DesignSearchResult(
            self.names,
            self.priors,
            self.vary,
            self.planned,
            self.planned_experiment,
            best,
            experiment,
            tuple(self.designs),
        )

    def _nearest(self) -> str:
        closest = min(self.designs, key=lambda t: t.criterion)
        margins = self.planner.fly(self.manoeuvres_at(closest.x)).margins
        name, margin = min(margins.items(), key=lambda m: m[1] / _tolerance(m[0]))
        return (
            f"none of {len(self.designs)} designs keeps the limits; the nearest exceeds that of {name} by "
            f"{-margin:.3g}; widen the limits or the ranges that vary"
        )

    def sweep(self, result: DesignSearchResult, points: int) -> list[BoundsSweep]:
        """Bounds along each number about the best design, with the others at their best values."""
        best = np.array([getattr(result.best.manoeuvres[v.manoeuvre - 1], v.key) for v in self.vary])
        sweeps = []
        for k, v in enumerate(self.vary):
            values = np.unique(np.append(np.linspace(v.low, v.high, points), best[k]))
            flights = [
                self.planner.fly(self.manoeuvres_at(np.where(np.arange(len(best)) == k, x, best))) for x in values
            ]
            sigma = np.full((len(values), len(self.planner.targets)), np.nan)
            for i, flown in enumerate(flights):
                if "manoeuvres reached" not in flown.margins:
                    sigma[i] = self.planner.experiment(flown, self.names, self.priors).sigma(self.planner.targets)
            sweeps.append(BoundsSweep(v, values, sigma, np.array([f.feasible for f in flights])))
        return sweeps


def _tolerance(name: str) -> float:
    return next((t for end, t in TOLERANCES.items() if name.endswith(end)), 1.0)


def _limit_excess(flown: PlannedFlight) -> float:
    """Sum of the excesses of a flight over its limits, each over its tolerance [-]."""
    return float(sum(max(-margin, 0.0) / _tolerance(name) for name, margin in flown.margins.items()))


def _default_vary(manoeuvres: Sequence[Manoeuvre]) -> tuple[DesignVariable, ...]:
    """All numbers of the first manoeuvre: its speed within SPEEDS, its shape within SHAPES of the planned one."""
    variables = []
    for key, value in manoeuvres[0]:
        if isinstance(value, float) and value != 0.0 and key != "at_time_s":
            low, high = sorted(factor * value for factor in (SPEEDS if key in TRIGGERS else SHAPES))
            variables.append(DesignVariable(key=key, low=low, high=high))
    return tuple(variables)
