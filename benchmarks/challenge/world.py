"""What the model of a record does not know apart from any cause: errors of its heating, its flight and its recorder.

heating    q (1 + e(t)), e of 1 to 15 %: spline, cubic through independent values 20 to 400 s apart
           | steps, independent values of arcs of a trajectory that last as long, 4 s from one to the next
flight     recorded with another clock (shift, stretch), velocity, angle of attack, and density: log-density spline in
           altitude through independent values 4 to 12 km apart
recorder   polynomial of second degree (declared) | clock that drifts | lost runs, and words at the bottom of the range
           | density, derived from the axial force, that spikes when jets fire
declared   rightly | small (a third) | not: measured = true, confidence C

All errors but lost samples and declared polynomials are drawn from N(0, sigma^2) along known directions, so that the
true noise of the readings is known: `unknown`. Nothing of it is a cause: with no deviation besides, `none` is right.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from benchmarks.challenge.case import COARSE_S, Case, History
from benchmarks.challenge.deviation import Deviation
from benchmarks.challenge.judge import Bench

FloatArray = NDArray[np.float64]
Generator = np.random.Generator
State = dict[str, FloatArray]

HEATING = ("spline", "steps")
DECLARED = ("rightly", "small", "not")
TOO_SMALL = 1.0 / 3.0
"""Declared over true standard deviations where they are declared too small."""
RELATIVE, LASTS_S = (0.01, 0.15), (20.0, 400.0)
FLIGHT = {
    "time_shift_s": (0.3, 8.0),
    "time_stretch": (2e-4, 4e-3),
    "velocity_relative": (0.001, 0.006),
    "alpha_deg": (0.1, 1.0),
    "density_relative": (0.02, 0.12),
}
"""Ranges of the standard deviations of a flight's errors, log-uniform."""
DENSITY_M = (4000.0, 12000.0)
DRIFT_S, SPIKE = 1.0, 0.15
"""Standard deviations of the clock's drift over a record [s], of the density's error while jets fire [-]."""
ARC_S = 4.0
"""Time from the error of one arc to that of the next."""
POLYNOMIAL = ((-6.0, 6.0), (0.98, 1.02), (-1.5e-5, 1.5e-5))
"""Ranges of the coefficients of a declared calibration [K, 1, 1/K]."""
LEAST = 0.3
"""Least factor on the heating."""
SMALL_STEP = 0.02
"""Relative error of the heating that responses are differences over."""


@dataclass(frozen=True)
class World:
    """Errors of a record's model.

    heating          : a member of HEATING, or empty
    relative, knots  : their standard deviation [-]; times of the values [s]
    values           : (knot,) relative errors of the heating
    flight           : error -> (standard deviation, value); of the density the standard deviation alone
    altitudes, layer : (knot,) altitudes [m], logarithms of recorded over true density there
    drift_s, spike   : standard deviation and value of the clock's drift, of the density's error while jets fire
    polynomials      : number of a sensor -> declared calibration
    drop_outs        : seed of lost runs and of words at the bottom of the range, 0 for none
    declared         : a member of DECLARED
    """

    heating: str = ""
    relative: float = 0.0
    knots: FloatArray = field(default_factory=lambda: np.zeros(0))
    values: FloatArray = field(default_factory=lambda: np.zeros(0))
    flight: dict[str, tuple[float, float]] = field(default_factory=dict)
    altitudes: FloatArray = field(default_factory=lambda: np.zeros(0))
    layer: FloatArray = field(default_factory=lambda: np.zeros(0))
    drift_s: tuple[float, float] = (0.0, 0.0)
    spike: tuple[float, float] = (0.0, 0.0)
    polynomials: dict[int, list[float]] = field(default_factory=dict)
    drop_outs: int = 0
    declared: str = DECLARED[0]

    # What is true -----------------------------------------------------------------------------------------------

    def shapes(self, t: FloatArray) -> FloatArray:
        """(time, knot) relative error of the heating where one value is 1."""
        if self.heating == "spline":
            return np.asarray(CubicSpline(self.knots, np.eye(len(self.knots)), bc_type="natural")(t))
        edges = 0.5 * (self.knots[1:] + self.knots[:-1])
        at = np.concatenate(([self.knots[0]], np.column_stack((edges - ARC_S / 2, edges + ARC_S / 2)).ravel()))
        rows = np.repeat(np.eye(len(self.knots)), 2, axis=0)[: len(at)]
        return np.array([np.interp(t, at, row) for row in rows.T]).T

    def error(self, t: FloatArray) -> FloatArray:
        """(time,) relative error of the heating."""
        return self.shapes(t) @ self.values if self.heating else np.zeros(len(t))

    def deviation(self, history: History) -> Deviation:
        """How the truth deviates from the declaration by errors of heating and recorder."""
        read = tuple(partial(_calibrated, number, c) for number, c in self.polynomials.items())
        sensors = history.case.point.sensors
        lost = partial(_dropped, self.drop_outs, [s["range_K"][0] for s in sensors])
        return Deviation(
            multiply=np.maximum(1.0 + self.error(history.t), LEAST),
            skew_s=self.drift_s[1] * (history.t / history.t[-1] - 0.5),
            read=read,
            after=(lost,) if self.drop_outs else (),
        )

    def recorded(self, case: Case) -> Case:
        """The case as it was recorded with the errors of the flight."""
        for name, (_, value) in self.flight.items():
            if name != "density_relative":
                case = case.recorded_again(partial(_misrecorded, name, value))
        if len(self.altitudes):
            case = case.recorded_again(partial(_denser, self.altitudes, self.layer))
        if self.spike[1]:
            case = case.recorded_again(partial(_spiked, self.spike[1]))
        return case

    # What is known of it ----------------------------------------------------------------------------------------

    def unknown(self, bench: Bench, *, phases: int = 1) -> FloatArray | None:
        """(reading, mode) responses over the floors to one standard deviation of each error; None without any.

        phases : places of the knots that the covariance of the heating's error is the mean of, the true one first:
                 with several, as it is to somebody who does not know when an arc ends
        """
        history, plain = bench.case.at(COARSE_S), bench.plain_K
        modes = []
        if self.heating:
            apart = self.knots[1] - self.knots[0]
            longer = np.append(self.knots, self.knots[-1] + apart)
            placed = [self] + [replace(self, knots=longer - k / phases * apart) for k in range(1, phases)]
            for shape in np.hstack([world.shapes(history.t) for world in placed]).T:
                moved = history.indicated(bench.t, Deviation(multiply=1.0 + SMALL_STEP * shape)) - plain
                modes.append(moved * self.relative / (SMALL_STEP * np.sqrt(phases)))
        modes += [other.at(COARSE_S).indicated(bench.t) - plain for other in self._other_flights(bench.case)]
        if self.drift_s[0]:
            skew = self.drift_s[0] * (history.t / history.t[-1] - 0.5)
            modes.append(history.indicated(bench.t, Deviation(skew_s=skew)) - plain)
        return np.column_stack([bench.over_floors(m) for m in modes]) if modes else None

    def _other_flights(self, case: Case) -> list[Case]:
        """The case recorded with one standard deviation of each error of the flight."""
        changes: list[Callable[[State], State]] = []
        for name, (sigma, _) in self.flight.items():
            if name == "density_relative":
                rows = sigma * np.eye(len(self.altitudes))
                changes += [partial(_denser, self.altitudes, row) for row in rows]
            else:
                changes.append(partial(_misrecorded, name, sigma))
        if self.spike[0]:
            changes.append(partial(_spiked, self.spike[0]))
        return [case.recorded_again(change) for change in changes]

    # What is declared of it -------------------------------------------------------------------------------------

    def declare(self, declared: dict[str, Any], end_s: float) -> dict[str, Any]:
        """The declaration of a record with what it says of its model's errors."""
        if self.declared == "not":
            return declared | {"measured": True, "conditions": declared["conditions"] | {"confidence": "C"}}
        share = 1.0 if self.declared == "rightly" else TOO_SMALL
        found = dict(declared)
        sigmas = {name: sigma for name, (sigma, _) in self.flight.items()}
        if self.drift_s[0]:
            sigmas["time_stretch"] = float(np.hypot(sigmas.get("time_stretch", 0.0), self.drift_s[0] / end_s))
        if sigmas:
            uncertainty = {name: float(f"{share * sigma:.4g}") for name, sigma in sigmas.items()}
            if len(self.altitudes):
                uncertainty["density_scale_m"] = float(f"{self.altitudes[1] - self.altitudes[0]:.5g}")
            found["conditions"] = declared["conditions"] | {"uncertainty": uncertainty}
        if self.heating:
            relative = {"relative": float(f"{share * self.relative:.4g}")}
            found["heating"] = declared["heating"] | {"uncertainty": relative}
        return found

    def answer(self, history: History) -> dict[str, Any]:
        """Its entry in answers.toml."""
        e = self.error(history.t)[history.hot]
        found: dict[str, Any] = {
            "heating": self.heating,
            "relative": self.relative,
            "lasts_s": float(self.knots[1] - self.knots[0]) if self.heating else 0.0,
            "rms_while_hot": round(float(np.sqrt(np.mean(e**2))), 5),
            "declared": self.declared,
            "drift_s": self.drift_s[1],
            "spike": self.spike[1],
            "calibrated": len(self.polynomials),
            "drop_outs": bool(self.drop_outs),
        }
        values = {name: value for name, (_, value) in self.flight.items() if name != "density_relative"}
        if len(self.altitudes):
            values["density_rms"] = round(float(np.sqrt(np.mean(self.layer**2))), 5)
        return found | {"flight": values, "sigma": {name: sigma for name, (sigma, _) in self.flight.items()}}


# Drawing -------------------------------------------------------------------------------------------------------------


def draw_world(rng: Generator, case: Case, of_class: str, number: int) -> World:
    """Errors of a record; of class `error` one kind alone, or nothing and called measured; of the others a mixture."""
    declared = DECLARED[(number + number // 6) % 3]
    world = World(declared=declared)
    if of_class == "error":
        kind = (*HEATING, "flight", "nothing")[number % 4]
        if kind == "nothing":
            return replace(world, declared="not")
        world = replace(world, declared=DECLARED[(number // 4) % 3])
        return _with_flight(rng, world, case) if kind == "flight" else _with_heating(rng, world, case, kind)
    if rng.random() < 0.85:
        world = _with_heating(rng, world, case, str(rng.choice(HEATING)))
    if rng.random() < 0.6 or not world.heating:
        world = _with_flight(rng, world, case)
    if rng.random() < 0.25:
        world = replace(world, drift_s=(DRIFT_S, _digits(DRIFT_S * rng.normal())))
    if rng.random() < 0.25:
        world = replace(world, drop_outs=int(rng.integers(1, 10**6)))
    fires = "jets" in case.flown and float(np.max(case.flown["jets"])) > 0.5
    if fires and rng.random() < 0.4:
        world = replace(world, spike=(SPIKE, _digits(SPIKE * rng.normal())))
    if rng.random() < 0.25:
        drawn = [rng.uniform(*np.array(POLYNOMIAL).T) for _ in case.point.sensors]
        world = replace(world, polynomials={i: [_digits(c) for c in cs] for i, cs in enumerate(drawn)})
    return world


def _digits(value: float) -> float:
    return float(f"{value:.5g}")


def _log_uniform(rng: Generator, limits: Sequence[float]) -> float:
    return _digits(np.exp(rng.uniform(*np.log(limits))))


def _with_heating(rng: Generator, world: World, case: Case, kind: str) -> World:
    relative, apart = _log_uniform(rng, RELATIVE), _log_uniform(rng, LASTS_S)
    knots = np.arange(0.0, float(case.flown["time_s"][-1]) + apart, apart)
    return replace(world, heating=kind, relative=relative, knots=knots, values=relative * rng.normal(size=len(knots)))


def _with_flight(rng: Generator, world: World, case: Case) -> World:
    sigmas = {name: _log_uniform(rng, limits) for name, limits in FLIGHT.items()}
    flight = {name: (sigma, _digits(sigma * rng.normal())) for name, sigma in sigmas.items()}
    h = case.flown["altitude_m"]
    altitudes = np.arange(float(np.min(h)), float(np.max(h)) + DENSITY_M[1], _log_uniform(rng, DENSITY_M))
    layer = sigmas["density_relative"] * rng.normal(size=len(altitudes))
    return replace(world, flight=flight, altitudes=altitudes, layer=layer)


# Changes of what is recorded -----------------------------------------------------------------------------------------


def _misrecorded(name: str, value: float, state: State) -> State:
    """The recorded state with another clock, velocity or angle of attack."""
    t = state["time_s"]
    if name == "velocity_relative":
        return state | {"velocity_m_s": state["velocity_m_s"] * (1.0 + value)}
    if name == "alpha_deg":
        return state | {"alpha_deg": np.maximum(state["alpha_deg"] + value, 0.0)}
    later = value if name == "time_shift_s" else value * (t - t[len(t) // 2])
    return {n: v if n == "time_s" else np.interp(t - later, t, v) for n, v in state.items()}


def _denser(altitudes: FloatArray, layer: FloatArray, state: State) -> State:
    """The recorded state with another density; the pressure was measured, the temperature follows."""
    factor = np.exp(CubicSpline(altitudes, layer, bc_type="natural")(state["altitude_m"]))
    return state | {"rho_kg_m3": state["rho_kg_m3"] * factor, "T_inf_K": state["T_inf_K"] / factor}


def _spiked(size: float, state: State) -> State:
    """The recorded state with a density that is wrong while jets fire."""
    return state | {"rho_kg_m3": state["rho_kg_m3"] * (1.0 + size * state["jets"])}


def _calibrated(number: int, c: Sequence[float], t: FloatArray, T: FloatArray) -> FloatArray:
    """What a sensor indicates by its declared calibration."""
    found = T.copy()
    found[:, number] = c[0] + c[1] * T[:, number] + c[2] * T[:, number] ** 2
    return found


def _dropped(seed: int, bottoms_K: Sequence[float], t: FloatArray, T: FloatArray) -> FloatArray:
    """Readings with isolated words at the bottom of the range, never two in a row, and with runs that are lost."""
    rng, found = np.random.default_rng(seed), T.copy()
    for i, bottom in enumerate(bottoms_K):
        for at in rng.choice(len(t) - 2, size=int(rng.integers(1, 4)), replace=False) + 1:
            if np.isfinite(T[at, i]) and found[at - 1, i] != bottom and found[at + 1, i] != bottom:
                found[at, i] = bottom
        for start in rng.uniform(t[0], t[-1], int(rng.integers(0, 3))):
            found[(t >= start) & (t <= start + rng.uniform(3.0, 40.0)), i] = np.nan
    return found
