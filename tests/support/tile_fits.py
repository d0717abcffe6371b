"""Transition in the measured history of a tile, and a clock common to several tiles of a flight of unknown trajectory.

A record without its declared transition is fitted with the laminar model and its linear derivatives (before), then with
the effect `transition` on top (after), started at the Reynolds number of the steepest rise. The clock,

    recorded time = shift + stretch (time of the flight),

is fitted by Gauss-Newton with every tile's own parameters projected out; its sigma is that of leaving out a tile at a
time.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import Conditions
from sim_heating.base.errors import RunError
from sim_heating.base.parameters import Parameter
from sim_heating.estimation.inference.observability import constant_variables, default_names
from sim_heating.estimation.problem import FitOptions, FitProblem, joint_reference
from sim_heating.heating.effects import use
from sim_heating.inputs.record import Record
from sim_heating.inputs.scenario import Scenario
from sim_heating.simulation.measured_records import compared_records
from tests.support.quick_fit import Model, quick_fit

EFFECT = "effect.transition."
TRANSITION = tuple(EFFECT + name for name in ("log10_re_onset", "width", "factor"))
WIDTHS = (0.01, 0.03)
"""Widths of the rise in log10 Re that a fit is started with."""
FACTOR = 2.5
SHARPEST = Parameter(TRANSITION[1], "1", WIDTHS[0], lower=0.005, upper=1.0)
"""A rise within a second; the records resolve times to 2.75 s."""
RISE_S = 10.0
"""A rise is the change of temperature over twice this time."""
WINDOW_S = (-60.0, 200.0)
"""About the rise: where the errors before and after are compared."""
CLOCK_ROUNDS = 3
STEP_S, STEP_STRETCH = 1.0, 1e-3
"""Differences that sensitivities to the clock are taken with."""


@dataclass(frozen=True, eq=False)
class Tile:
    """Results of one record."""

    record: Record
    rise_s: float
    before: Model
    after: Model

    @property
    def onset_s(self) -> float:
        """When the flight passes the onset Reynolds number, on the record's clock."""
        return onset_time_s(self.record.conditions, self.after.values[TRANSITION[0]])

    def errors(self, residual_K: FloatArray) -> dict[str, float]:
        """RMSE [K] about the rise, over the fit segments and the held-out ones."""
        t = self.record.time_s - self.rise_s
        masks = {
            "window": (t >= WINDOW_S[0]) & (t <= WINDOW_S[1]),
            "fit": self.record.fit_mask(),
            "holdout": self.record.holdout_mask(),
        }
        return {name: rms(residual_K[mask]) for name, mask in masks.items()}


def rms(values: FloatArray) -> float:
    """Root mean square of the finite values."""
    return float(np.sqrt(np.nanmean(values**2)))


def rise_time_s(record: Record) -> float:
    """When the measured temperature is half way up its steepest rise within the fit segments [s]."""
    t, T = record.time_s, record.temperatures_K()[0]
    first, last = record.declared.segments.fit[0] if record.declared.segments.fit else (t[0], t[-1])
    at = np.arange(first + RISE_S, last - RISE_S, 1.0)
    T = np.interp(at, t, T)
    low = high = int(np.argmax(np.interp(at + RISE_S, at, T) - np.interp(at - RISE_S, at, T)))
    while T[low - 1] <= T[low]:
        low -= 1
    while T[high + 1] >= T[high]:
        high += 1
    return float(np.interp(0.5 * (T[low] + T[high]), T[low : high + 1], at[low : high + 1]))


def onset_time_s(flown: Conditions, log10_re: float, after_s: float = 600.0) -> float:
    """First time [s] after the entry has settled at which the flight is past a Reynolds number."""
    t, x = flown.time_s, flown["log10_re"]
    past = (t >= after_s) & (x >= log10_re)
    k = int(np.argmax(past))
    return float(np.interp(log10_re, x[k - 1 : k + 1], t[k - 1 : k + 1])) if np.any(past) else float("nan")


def laminar(record: Record) -> Record:
    """The record without its declared transition, as if nobody had foreseen one."""
    heating = record.declared.heating.model_copy(update={"transition": None})
    return replace(record, declared=record.declared.model_copy(update={"heating": heating}), turbulent=None)


def laminar_records(
    scenario: Scenario, flown: Conditions, *, shift_s: float = 0.0, stretch: float = 1.0
) -> dict[str, Record]:
    """Records of a scenario's measured histories without declared transition, along a flight with a clock [s], [-]."""
    found = compared_records(scenario, flown=flown, shift_s=shift_s, stretch=stretch)
    return {name: laminar(record) for name, record in found.items()}


# One tile ------------------------------------------------------------------------------------------------------------


def fitted(record: Record, reference: tuple[float, ...], starts: Sequence[Mapping[str, float]] = ({},)) -> Model:
    """The linear model, with transition where the starts name it; the best of all starts."""
    linear = [n for n in default_names([record]) if n not in constant_variables(default_names([record]), [record])]
    turbulent = TRANSITION[0] in starts[0]
    names, uses = (*linear, *(TRANSITION if turbulent else ())), [use("transition")] if turbulent else []
    return quick_fit(record, names, starts, effects=uses, reference=reference, priors={SHARPEST.name: SHARPEST})


def starts_at(record: Record, rise_s: float, warm: Mapping[str, float] | None = None) -> list[dict[str, float]]:
    """Transition at the Reynolds number of the rise, of several widths; `warm` are values of a further start."""
    log10_re = float(np.interp(rise_s, record.conditions.time_s, record.conditions["log10_re"]))
    cold = [dict(zip(TRANSITION, (log10_re, width, FACTOR), strict=True)) for width in WIDTHS]
    return cold if warm is None else [{**warm, TRANSITION[0]: log10_re}]


def tiles_of(records: Mapping[str, Record]) -> dict[str, Tile]:
    """Every record fitted before and after."""
    found = {}
    for name, record in records.items():
        reference, rise_s = joint_reference([record]), rise_time_s(record)
        before = fitted(record, reference)
        found[name] = Tile(record, rise_s, before, fitted(record, reference, starts_at(record, rise_s)))
    return found


def as_nominal(records: Mapping[str, Record], nominal: Mapping[str, Tile]) -> dict[str, Tile]:
    """Records of the same tiles along another flight, fitted before and after, also from the nominal values."""
    found = {}
    for name, record in records.items():
        reference, rise_s = joint_reference([record]), nominal[name].rise_s
        before = fitted(record, reference, [{}, nominal[name].before.values])
        warm = starts_at(record, rise_s, nominal[name].after.values)
        after = fitted(record, reference, [*warm, *starts_at(record, rise_s)[1:]])
        found[name] = Tile(record, rise_s, before, after)
    return found


# The clock -----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Clock:
    """Shift [s] and stretch common to all tiles, their sigma from leaving out a tile, and the tiles fitted with it."""

    shift_s: float
    stretch: float
    sigma: tuple[float, float]
    tiles: dict[str, Tile]


def fitted_clock(scenario: Scenario, flown: Conditions, tiles: dict[str, Tile], rounds: int = CLOCK_ROUNDS) -> Clock:
    """Gauss-Newton on shift and stretch; the tiles' own parameters are fitted again at every iteration."""
    clock, best = np.array([0.0, 1.0]), (np.inf, np.array([0.0, 1.0]), tiles, np.zeros((len(tiles), 2)))
    step = np.zeros(2)
    for _ in range(rounds):
        try:
            tiles = refitted(scenario, flown, clock, best[2])
        except RunError:
            tiles = {}
        misfit = sum(-2.0 * t.after.fit.log_likelihood for t in tiles.values()) if tiles else np.inf
        if misfit < best[0]:
            normal = [_normal_equations(scenario, flown, clock, name, tile) for name, tile in tiles.items()]
            A, b = (np.array([n[k] for n in normal]) for k in (0, 1))
            step = np.linalg.solve(A.sum(axis=0), b.sum(axis=0))
            without = np.array([np.linalg.solve(A.sum(0) - a, b.sum(0) - c) for a, c in zip(A, b, strict=True)])
            best = (misfit, clock, tiles, without)
        else:
            step = 0.5 * step
        clock = best[1] + step
    n = len(best[3])
    spread = np.sqrt((n - 1) / n * np.sum((best[3] - best[3].mean(axis=0)) ** 2, axis=0))
    return Clock(float(best[1][0]), float(best[1][1]), (float(spread[0]), float(spread[1])), best[2])


def refitted(scenario: Scenario, flown: Conditions, clock: FloatArray, tiles: Mapping[str, Tile]) -> dict[str, Tile]:
    """The tiles with another clock, from the values that they have."""
    records = laminar_records(scenario, flown, shift_s=clock[0], stretch=clock[1])
    found = {}
    for name, tile in tiles.items():
        reference = tile.after.problem.reference
        after = fitted(records[name], reference, starts_at(records[name], tile.rise_s, tile.after.values))
        found[name] = Tile(records[name], tile.rise_s, tile.before, after)
    return found


def _normal_equations(
    scenario: Scenario, flown: Conditions, clock: FloatArray, name: str, tile: Tile
) -> tuple[FloatArray, FloatArray]:
    """Normal equations of the clock from one tile, its own parameters projected out."""
    values = tile.after.fit.values
    here = tile.after.problem.samples(values)[0]
    columns = []
    for change in (np.array([STEP_S, 0.0]), np.array([0.0, STEP_STRETCH])):
        shift_s, stretch = clock + change
        moved = laminar_records(scenario, flown, shift_s=shift_s, stretch=stretch)[name]
        names, reference = list(tile.after.values), tile.after.problem.reference
        problem = FitProblem([moved], names, reference, FitOptions(effects=[use("transition")], prior_scale=np.inf))
        columns.append((problem.samples(values)[0].mean_K - here.mean_K) / np.max(change))
    sensitivity = np.array(columns).T
    own = here.sensitivity[:, np.any(here.sensitivity != 0.0, axis=0)]
    basis, _ = np.linalg.qr(own)
    residual = np.interp(here.time_s, tile.record.time_s, tile.record.temperatures_K()[0]) - here.mean_K
    projected = (sensitivity - basis @ (basis.T @ sensitivity)) / here.sigma_K
    return projected.T @ projected, projected.T @ (residual - basis @ (basis.T @ residual)) / here.sigma_K
