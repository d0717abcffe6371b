"""A flight over a control point, and what its thermocouples indicate where the truth deviates from the declaration."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from benchmarks.challenge.air import LENGTH_M, R_AIR, reference_heating, viscosity, wall_enthalpy
from benchmarks.challenge.deviation import HOT_K, NOTHING, Deviation
from benchmarks.challenge.flight import Flight
from benchmarks.challenge.point import VARIABLES, Point, Ratio
from benchmarks.challenge.wall import Forcing, Wall, build, march

FloatArray = NDArray[np.float64]

FINE_S, COARSE_S = 0.2, 1.0
"""Steps of the truth, and of estimates of differences."""
COARSE = 0.35
"""Share of the elements in estimates of differences."""
FORMATS = {
    "time_s": ".2f",
    "altitude_m": ".1f",
    "velocity_m_s": ".2f",
    "mach": ".4f",
    "alpha_deg": ".4f",
    "beta_deg": ".4f",
    "log10_re": ".5f",
    "elevon_deg": ".4f",
    "bodyflap_deg": ".4f",
    "rho_kg_m3": ".7g",
    "T_inf_K": ".2f",
    "p_inf_Pa": ".7g",
    "p_surface_Pa": ".7g",
    "h_ref_kg_m2_s": ".8g",
    "H_r_J_kg": ".8g",
    "jets": ".3f",
    "axial_accel_g": ".5f",
}
"""Digits of conditions.csv; a truth without error of the flight is heated with the numbers in the file."""


@dataclass(frozen=True)
class Case:
    """What a record declares of a flight over a point, and the flight as it was.

    recorded, flown : columns of conditions.csv as in the file, and the true ones
    cp_J_kgK        : of air at the wall; None: of nitrogen and oxygen, which a record calls equilibrium air
    """

    flight: Flight
    point: Point
    ratio: Ratio
    recorded: dict[str, FloatArray]
    flown: dict[str, FloatArray]
    cp_J_kgK: float | None

    @cached_property
    def _histories(self) -> dict[tuple[float, bool], History]:
        return {}

    def at(self, step_s: float, true: bool = False) -> History:
        """The recorded or the true flight on the steps of a march."""
        true = true and self.flown is not self.recorded
        if (step_s, true) not in self._histories:
            columns = self.flown if true else self.recorded
            last = columns["time_s"][-1]
            t = np.arange(round(last / step_s) + 1) * step_s
            fine = {name: np.interp(t, columns["time_s"], values) for name, values in columns.items()}
            self._histories[step_s, true] = History(self, step_s, t, fine)
        return self._histories[step_s, true]

    def misrecorded(self, change: Callable[[dict[str, FloatArray]], dict[str, FloatArray]]) -> Case:
        """The same flight, recorded with other state; what is derived from the state is derived from the wrong one."""
        state = change({name: np.array(values) for name, values in self.flown.items()})
        return replace(self, recorded=columns_of(state, self.point, "jets" in self.flown))

    def recorded_again(self, change: Callable[[dict[str, FloatArray]], dict[str, FloatArray]]) -> Case:
        """The same flight, with a further error in what was recorded."""
        state = change({name: np.array(values) for name, values in self.recorded.items()})
        return replace(self, recorded=columns_of(state, self.point, "jets" in self.flown))

    @cached_property
    def r_0(self) -> float:
        """Mean declared ratio while it is hot."""
        history = self.at(COARSE_S)
        return float(np.mean(history.declared[history.hot]))


@dataclass(frozen=True)
class History:
    """The conditions of a case on the steps of a march."""

    case: Case
    step_s: float
    t: FloatArray
    columns: dict[str, FloatArray]

    @cached_property
    def x(self) -> FloatArray:
        """(variable, time) of the heating ratio."""
        return np.array([self.columns[v] for v in VARIABLES])

    @cached_property
    def declared(self) -> FloatArray:
        """(time,) tabulated ratio."""
        return self.case.ratio.declared(self.x)

    @cached_property
    def true_ratio(self) -> FloatArray:
        """(time,) ratio with the true scale and slopes."""
        ratio = self.case.ratio
        return ratio.true(self.x, ratio.scale, ratio.d, self.declared)

    @cached_property
    def hot(self) -> NDArray[np.bool_]:
        """(time,) where the reference heating is above a quarter of its peak."""
        q = self.columns["h_ref_kg_m2_s"] * self.columns["H_r_J_kg"]
        return np.asarray(q > 0.25 * np.max(q))

    def lagged(self, values: FloatArray, tau_s: float) -> FloatArray:
        """(time, ...) behind a first-order lag, at rest to begin with."""
        keep = float(np.exp(-self.step_s / max(tau_s, 1e-6)))
        return np.asarray(lfilter([1.0 - keep], [1.0, -keep], values - values[0], axis=0) + values[0])

    def temperatures(
        self, deviation: Deviation = NOTHING, scale: float | None = None, d: FloatArray | None = None
    ) -> FloatArray:
        """(time, surface | thermocouple) temperatures [K]; the true scale and slopes unless given."""
        case, ratio = self.case, self.case.ratio
        errors = (ratio.scale if scale is None else scale, ratio.d if d is None else d)
        r = (ratio.true(self.x, *errors, self.declared) + deviation.add) * deviation.multiply
        wall, depths = self._wall(deviation)
        n = len(self.t)
        weights, share, diverted = deviation.deposit or (np.zeros_like, 0.0, 0.0)
        deposit = wall.shares(weights)
        content, moisture = deviation.water or (np.zeros_like, np.array([0.0, 0.0, 1.0, 1.0, 0.0]))
        forcing = Forcing(
            film=r * self.columns["h_ref_kg_m2_s"],
            H_r=self.columns["H_r_J_kg"],
            log_p=np.log10(self.columns["p_surface_Pa"]),
            eps_factor=np.broadcast_to(np.asarray(deviation.eps_factor, dtype=float), n).copy(),
            hot=np.broadcast_to(np.asarray(deviation.hot, dtype=float), len(HOT_K)).copy(),
            hot_share=np.broadcast_to(np.asarray(deviation.hot_share, dtype=float), n).copy(),
            H_w=wall_enthalpy(case.cp_J_kgK),
            deposit=share * deposit / max(float(np.sum(deposit)), 1e-30),
            diverted=share * diverted,
            water=wall.shares(content),
            moisture=moisture,
            added=np.broadcast_to(np.asarray(deviation.added, dtype=float), n).copy(),
            side=wall.shares(deviation.side or np.zeros_like),
        )
        nodes = [wall.node(depth) for depth in depths]
        return march(wall, forcing, case.point.stack["initial_K"], nodes, self.step_s)

    def _wall(self, deviation: Deviation) -> tuple[Wall, list[float]]:
        """The true wall and the true depths of the thermocouples."""
        point = self.case.point
        stack, materials = deviation.of_wall(point.stack, point.materials)
        depths = [_moved(depth, point.stack, stack) if deviation.walls else depth for depth in point.depths_m]
        for sensor, shift in deviation.shifts_m:
            depths[sensor] += shift
        share = 1.0 if self.step_s < COARSE_S else COARSE
        return build(stack, materials, depths, deviation.back, share), depths

    def indicated(self, at_s: FloatArray, deviation: Deviation = NOTHING, **errors: Any) -> FloatArray:
        """(sample, sensor) what enters the recorder [K]: clock and errors of the thermocouples applied."""
        T = self.temperatures(deviation, **errors)[:, 1:]
        for change in deviation.read:
            T = change(self.t, T)
        skew = np.broadcast_to(np.asarray(deviation.skew_s, dtype=float), len(self.t))
        at = at_s - np.interp(at_s, self.t, skew)
        return np.column_stack([np.interp(at, self.t, column) for column in T.T])


def _moved(depth_m: float, old: Mapping[str, Any], new: Mapping[str, Any]) -> float:
    """Depth in a wall with other thicknesses: faces stay faces, within a layer the distance to its outer face holds."""
    faces = [np.cumsum([0.0, *(e["thickness_m"] for e in stack["layer"])]) for stack in (old, new)]
    i = int(np.searchsorted(faces[0], depth_m - 1e-9))
    if abs(faces[0][i] - depth_m) < 2e-9:
        return float(faces[1][i])
    return float(faces[1][i - 1] + depth_m - faces[0][i - 1])


def columns_of(state: Mapping[str, FloatArray], point: Point, jets: bool) -> dict[str, FloatArray]:
    """The columns of conditions.csv of a state, with the digits of the file."""
    rho, V, T = (state[name] for name in ("rho_kg_m3", "velocity_m_s", "T_inf_K"))
    h_ref, H_r = reference_heating(rho, V, T)
    derived = {
        "mach": V / np.sqrt(1.4 * R_AIR * T),
        "log10_re": np.log10(rho * V * LENGTH_M / viscosity(T)),
        "p_surface_Pa": point.surface_pressure(state),
        "h_ref_kg_m2_s": h_ref,
        "H_r_J_kg": H_r,
    }
    found = {name: {**state, **derived}[name] for name in FORMATS if jets or name != "jets"}
    return {name: np.array([float(format(v, FORMATS[name])) for v in values]) for name, values in found.items()}


def make_case(
    flight: Flight,
    point: Point,
    ratio_of: Callable[[FloatArray], Ratio],
    every: int,
    cp_J_kgK: float | None,
    jets: bool,
) -> Case:
    """A flight over a point, sampled at every so many of its steps; the ratio is made about its mean conditions."""
    state = {name: values[::every] for name, values in flight.state.items()}
    columns = columns_of(state, point, jets)
    heating = columns["h_ref_kg_m2_s"] * columns["H_r_J_kg"]
    warm = heating > 0.25 * np.max(heating)
    reference = np.array([round(float(np.mean(columns[v][warm])), 2) for v in VARIABLES])
    return Case(flight, point, ratio_of(reference), columns, columns, cp_J_kgK)
