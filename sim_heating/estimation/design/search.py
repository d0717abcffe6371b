"""The most informative manoeuvre within the limits: a Sobol set over the numbers that may vary, then Nelder and Mead.

What a design is worth is the ratio of its bounds to the planned ones (design.merit). Whatever breaks a limit ranks
behind whatever keeps all, by how far it breaks them; the best design that was flown and keeps all limits is the answer.
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
from sim_heating.estimation.design.information import Experiment, check_wanted, design_criterion
from sim_heating.estimation.design.planned_flight import PlannedFlight, Planner
from sim_heating.estimation.inference.observability import constant_variables
from sim_heating.inputs.scenario import DesignVariable
from sim_heating.trajectory.spec import Manoeuvre

INFEASIBLE = 10.0
"""Worth of a design that breaks a limit, and more by how far; no other is worse."""
TOLERANCES = {"_K": 10.0, "_deg": 1.0, "_Pa": 500.0, "_m": 500.0, "_s": 5.0}
"""By how much limits are broken alike, by their unit."""
TRIGGERS = ("at_velocity_m_s", "at_mach")
SPEEDS = (0.75, 1.05)
"""Part of the planned speed or Mach number that is tried where a scenario names nothing to vary."""
SHAPES = (0.5, 2.0)
"""And of the manoeuvre's amplitudes, rate and holds."""


@dataclass(frozen=True, eq=False)
class TriedDesign:
    """One design: (vary,) numbers, its worth, whether it keeps the limits, and (wanted,) bounds where it does."""

    x: FloatArray
    merit: float
    feasible: bool
    sigma: FloatArray


@dataclass(frozen=True, eq=False)
class BoundsSweep:
    """Bounds along one number about the best design: (point,) values, (point, wanted) bounds, which keep the limits."""

    vary: DesignVariable
    value: FloatArray
    sigma: FloatArray
    feasible: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class DesignSearchResult:
    """The outcome of a search.

    names    : what is unknown;  priors : standard deviations that are not the parameters' own
    vary     : what was varied;  planned, best : flights, and what they would tell
    tried    : all designs, in their order
    """

    names: tuple[str, ...]
    priors: dict[str, float]
    vary: tuple[DesignVariable, ...]
    planned: PlannedFlight
    planned_told: Experiment
    best: PlannedFlight
    best_told: Experiment
    tried: tuple[TriedDesign, ...]


class DesignSearch:
    """Tries designs of one scenario, and remembers all it tried."""

    def __init__(self, planner: Planner) -> None:
        self.planner, self.design = planner, planner.design
        self.manoeuvres = planner.scenario.declared.trajectory.manoeuvre
        self.vary = tuple(self.design.vary) or _default_vary(self.manoeuvres)
        self.planned = planner.fly(self.manoeuvres)
        if "manoeuvres reached" in self.planned.margins:
            raise InputError(
                f"{planner.scenario.path}: a manoeuvre is not reached in the 3-DOF flight; change what triggers it"
            )
        unmoved = constant_variables(planner.wanted, [planner.record(self.planned, planner.instruments)[0]])
        if unmoved:
            raise InputError(*(f"{planner.scenario.path}: {name}: {why}" for name, why in unmoved.items()))
        self.names = planner.names(self.planned)
        self.priors = planner.priors(self.names, self.planned)
        self.planned_told = planner.experiment(self.planned, self.names, self.priors)
        check_wanted(self.planned_told, planner.wanted)
        self.planned_covariance = self.planned_told.covariance(planner.wanted)
        self.tried: list[TriedDesign] = []
        self.best: tuple[float, PlannedFlight, Experiment] | None = None

    @property
    def low(self) -> FloatArray:
        """(vary,) least values."""
        return np.array([v.low for v in self.vary])

    @property
    def high(self) -> FloatArray:
        """(vary,) greatest values."""
        return np.array([v.high for v in self.vary])

    def as_planned(self) -> FloatArray:
        """(vary,) values of the scenario."""
        return np.array([getattr(self.manoeuvres[v.manoeuvre - 1], v.key) for v in self.vary])

    def altered(self, x: FloatArray) -> tuple[Manoeuvre, ...]:
        """The manoeuvres with (vary,) other numbers."""
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

    def attempt(self, x: FloatArray) -> TriedDesign:
        """Fly a design and find what it would tell, where it keeps the limits."""
        flown = self.planner.fly(self.altered(x))
        nothing = np.full(len(self.planner.wanted), np.nan)
        if not flown.feasible:
            found = TriedDesign(x, INFEASIBLE + _limit_violation(flown), False, nothing)
        else:
            told = self.planner.experiment(flown, self.names, self.priors)
            covariance = told.covariance(self.planner.wanted)
            worth = min(design_criterion(self.design.criterion, covariance, self.planned_covariance), INFEASIBLE)
            found = TriedDesign(x, worth, True, np.sqrt(np.diag(covariance)))
            if self.best is None or worth < self.best[0]:
                self.best = (worth, flown, told)
        self.tried.append(found)
        return found

    def run(self, progress: Progress = no_progress) -> DesignSearchResult:
        """Search.

        raises : RunError where no design keeps the limits
        """
        total, span = self.design.evaluations, self.high - self.low

        def worth(u: FloatArray) -> float:
            found = self.attempt(self.low + np.clip(u, 0.0, 1.0) * span)
            told = f"bounds {self.best[0]:.3f} of the planned ones" if self.best else "none within the limits yet"
            progress(min(len(self.tried) / total, 1.0), f"searching: {len(self.tried)} designs, {told}")
            return found.merit

        worth((self.as_planned() - self.low) / span)
        half = total // 2
        several = half if half > len(self.vary) + 1 else total - 1
        sobol = qmc.Sobol(len(self.vary), rng=np.random.default_rng(1))
        for u in sobol.random_base2(int(np.ceil(np.log2(max(several, 1)))))[:several]:
            worth(u)
        left = total - len(self.tried)
        if left > len(self.vary):
            first = min(self.tried, key=lambda t: t.merit)
            start = np.clip((first.x - self.low) / span, 0.05, 0.95)
            box = [(0.0, 1.0)] * len(self.vary)
            minimize(worth, start, method="Nelder-Mead", bounds=box, options={"maxfev": left, "xatol": 1e-3})
        if self.best is None:
            raise RunError(f"design: {self._nearest()}")
        _, best, told = self.best
        return DesignSearchResult(
            self.names, self.priors, self.vary, self.planned, self.planned_told, best, told, tuple(self.tried)
        )

    def _nearest(self) -> str:
        closest = min(self.tried, key=lambda t: t.merit)
        missed = self.planner.fly(self.altered(closest.x)).margins
        name, margin = min(missed.items(), key=lambda m: m[1] / _tolerance(m[0]))
        return (
            f"none of {len(self.tried)} designs keeps the limits; the nearest passes that of {name} by {-margin:.3g}; "
            "widen the limits or what may vary"
        )

    def sweep(self, found: DesignSearchResult, points: int) -> list[BoundsSweep]:
        """Bounds along each number about the best design, the others as they are there."""
        best = np.array([getattr(found.best.manoeuvres[v.manoeuvre - 1], v.key) for v in self.vary])
        sweeps = []
        for k, v in enumerate(self.vary):
            values = np.unique(np.append(np.linspace(v.low, v.high, points), best[k]))
            told = [self.planner.fly(self.altered(np.where(np.arange(len(best)) == k, x, best))) for x in values]
            sigma = np.full((len(values), len(self.planner.wanted)), np.nan)
            for i, flown in enumerate(told):
                if "manoeuvres reached" not in flown.margins:
                    sigma[i] = self.planner.experiment(flown, self.names, self.priors).sigma(self.planner.wanted)
            sweeps.append(BoundsSweep(v, values, sigma, np.array([f.feasible for f in told])))
        return sweeps


def _tolerance(name: str) -> float:
    return next((t for end, t in TOLERANCES.items() if name.endswith(end)), 1.0)


def _limit_violation(flown: PlannedFlight) -> float:
    """By how much a flight breaks its limits."""
    return float(sum(max(-margin, 0.0) / _tolerance(name) for name, margin in flown.margins.items()))


def _default_vary(manoeuvres: Sequence[Manoeuvre]) -> tuple[DesignVariable, ...]:
    """All numbers of the first manoeuvre: its speed within SPEEDS, its shape within SHAPES of the planned one."""
    found = []
    for key, value in manoeuvres[0]:
        if isinstance(value, float) and value != 0.0 and key != "at_time_s":
            low, high = sorted(part * value for part in (SPEEDS if key in TRIGGERS else SHAPES))
            found.append(DesignVariable(key=key, low=low, high=high))
    return tuple(found)
