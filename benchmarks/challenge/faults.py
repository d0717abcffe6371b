"""What no name of an effect covers: faults of wall, flight, sensors and table; and heating that no library has.

wall     other-material | skin-thickness | layer-density | capacity-shape | conductivity-shape | pressure-shape
         | bond-layer (thickness of strain isolation or adhesive) | contact (resistance that is not declared)
flight   velocity-drift (in 100 s; held | undone) | density-layer | density-scale | alpha-bias | alpha-smoothed
         | time-shift (of all | of the trajectory without the controls)
sensor   swap | unit (degC | degF) | stuck | clipped | drift | gain | depth | lag-change
table    alpha-derivative | elevon-derivative (several of the table's sigmas) | above-42 (15 % above 42 deg)
unknown  relay (hysteresis in alpha) | bumps in time | alpha-curve, re-curve (splines) | oscillation

A fault of the flight is in what was recorded: film coefficient, Reynolds number and surface pressure of the record
follow from the wrong state, the temperatures from the right one.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator
from scipy.ndimage import gaussian_filter1d

from benchmarks.challenge.case import Case, History
from benchmarks.challenge.deviation import Deviation
from benchmarks.challenge.form import Family, Generator, Parameters, Unsuitable, sign
from benchmarks.challenge.on_ratio import ALPHA, ELEVON, LOG_RE, departure, relay, spread
from benchmarks.challenge.on_wall import STEP, change_of, on_sensor, reshaped, sensor_number
from benchmarks.challenge.point import FELTS, FLAPS, IN_DEPTH, TILES, material
from benchmarks.challenge.recorder import used

FloatArray = NDArray[np.float64]
State = dict[str, FloatArray]

BOND = ("V09T9527", "LOWER_FWD", "LOWER_MID", "LOWER_AFT", "WING_LOWER", *FLAPS[:2])
"""Tiles with a thermocouple at the skin."""
OTHERS = {
    "li900": ("orbiter", "li2200"),
    "li2200": ("orbiter", "li900"),
    "frsi-felt": ("capsule", "alumina-fibre"),
    "alumina-fibre": ("orbiter", "li2200"),
}
"""Insulation that may be installed in place of another."""


def nothing(history: History, form: str, p: Parameters) -> Deviation:
    """No deviation of wall, heating or sensors: the fault is in the recorded flight."""
    return Deviation()


# Wall ----------------------------------------------------------------------------------------------------------------


def _drawn(low: float, high: float) -> Any:
    """A factor on either side of 1, with at least a fifth of the way to its ends."""

    def draw(rng: Generator, case: Case, form: str) -> dict[str, Any]:
        if rng.random() < 0.5:
            return {"factor": float(1.0 - rng.uniform(0.2, 1.0) * (1.0 - low))}
        return {"factor": float(1.0 + rng.uniform(0.2, 1.0) * (high - 1.0))}

    return draw


def _other_material(history: History, form: str, p: Parameters) -> Deviation:
    def apply(stack: dict[str, Any], materials: dict[str, Any]) -> None:
        name = stack["layer"][1]["material"]
        if name not in OTHERS:
            raise Unsuitable
        materials[name] = {**materials[name], **material(*OTHERS[name])}

    return Deviation(walls=(apply,))


def _thickness(number: int) -> Any:
    def act(history: History, form: str, p: Parameters) -> Deviation:
        def apply(stack: dict[str, Any], materials: dict[str, Any]) -> None:
            layer = number
            if form == "sip":
                layer = next(i for i, e in enumerate(stack["layer"]) if e["material"] == "nomex-sip")
            stack["layer"][layer]["thickness_m"] *= p["factor"]

        return Deviation(walls=(apply,))

    return act


def _density(history: History, form: str, p: Parameters) -> Deviation:
    layer = {"insulation": 1, "skin": -1}[form]
    return change_of(layer, "density_kg_m3", lambda rho: rho * p["factor"])


def _shape(key: str) -> Any:
    """A property right at one temperature and wrong on both sides of it, in opposite directions."""

    def act(history: History, form: str, p: Parameters) -> Deviation:
        tilt = p["factor"] - 1.0
        return change_of(1, key, lambda t: reshaped(t, lambda T: 1.0 + tilt * np.tanh((T - 600.0) / 200.0)))

    return act


def _pressure_shape(history: History, form: str, p: Parameters) -> Deviation:
    def change(table: Any) -> Any:
        if not isinstance(table, dict):
            raise Unsuitable
        by = 1.0 + (p["factor"] - 1.0) * np.tanh(np.log10(np.array(table["p_Pa"]) / 300.0))
        return {**table, "k": (np.array(table["k"]) * by).tolist()}

    return change_of(1, "conductivity_W_mK", change)


def _contact(history: History, form: str, p: Parameters) -> Deviation:
    def apply(stack: dict[str, Any], materials: dict[str, Any]) -> None:
        stack["layer"][1]["contact_m2K_W"] = p["contact_m2K_W"]

    return Deviation(walls=(apply,))


# Flight --------------------------------------------------------------------------------------------------------------


def hot_time(rng: Generator, case: Case, low: float, high: float) -> float:
    history = case.at(STEP)
    hot = history.t[history.hot]
    return round(float(hot[int(rng.uniform(low, high) * (len(hot) - 1))]), 1)


def _draw_velocity(rng: Generator, case: Case, form: str) -> dict[str, Any]:
    return {"size": float(sign(rng) * rng.uniform(0.02, 0.06)), "start_s": hot_time(rng, case, 0.1, 0.7)}


def _velocity(case: Case, form: str, p: Parameters, state: State) -> State:
    since = (state["time_s"] - p["start_s"]) / 100.0
    share = np.clip(since, 0.0, 1.0)
    if form == "undone":
        share = np.maximum(1.0 - np.abs(since - 1.0), 0.0)
    return state | {"velocity_m_s": state["velocity_m_s"] * (1.0 - p["size"] * share)}


def _draw_layer(rng: Generator, case: Case, form: str) -> dict[str, Any]:
    history = case.at(STEP)
    h = float(np.interp(hot_time(rng, case, 0.2, 0.8), history.t, history.columns["altitude_m"]))
    return {
        "size": float(sign(rng) * rng.uniform(0.08, 0.2)),
        "altitude_m": h,
        "width_m": float(rng.uniform(1500.0, 4000.0)),
    }


def _layer(case: Case, form: str, p: Parameters, state: State) -> State:
    bell = np.exp(-(((state["altitude_m"] - p["altitude_m"]) / p["width_m"]) ** 2))
    factor = 1.0 + p["size"] * bell
    wrong = {"rho_kg_m3": state["rho_kg_m3"] * factor}
    return state | wrong | ({"T_inf_K": state["T_inf_K"] / factor} if form == "consistent" else {})


def _density_scale(case: Case, form: str, p: Parameters, state: State) -> State:
    wrong = {"rho_kg_m3": state["rho_kg_m3"] * (1.0 + p["size"])}
    return state | wrong | ({"p_inf_Pa": state["p_inf_Pa"] * (1.0 + p["size"])} if form == "with-pressure" else {})


def _alpha_bias(case: Case, form: str, p: Parameters, state: State) -> State:
    return state | {"alpha_deg": np.maximum(state["alpha_deg"] + p["bias_deg"], 0.0)}


def _alpha_smoothed(case: Case, form: str, p: Parameters, state: State) -> State:
    step = float(state["time_s"][1] - state["time_s"][0])
    return state | {"alpha_deg": gaussian_filter1d(state["alpha_deg"], p["smoothed_s"] / step)}


def _shifted(case: Case, form: str, p: Parameters, state: State) -> State:
    t = state["time_s"]
    kept = ("time_s",) if form == "all" else ("time_s", "alpha_deg", "beta_deg", "elevon_deg", "bodyflap_deg", "jets")
    return {n: v if n in kept else np.interp(t - p["shift_s"], t, v) for n, v in state.items()}


# Sensors -------------------------------------------------------------------------------------------------------------


def _two(rng: Generator, case: Case, form: str) -> dict[str, Any]:
    count = len(used(case.point.sensors))
    if count < 2:
        raise Unsuitable
    i = int(rng.integers(0, count - 1))
    return {"sensor": case.point.sensors[i]["name"], "with": case.point.sensors[i + 1]["name"]}


def _swap(history: History, form: str, p: Parameters) -> Deviation:
    i, j = sensor_number(history.case, p), sensor_number(history.case, {"sensor": p["with"]})

    def read(t: FloatArray, T: FloatArray) -> FloatArray:
        order = list(range(T.shape[1]))
        order[i], order[j] = j, i
        return T[:, order]

    return Deviation(read=(read,))


def one_sensor(rng: Generator, case: Case, form: str) -> dict[str, Any]:
    sensors = [case.point.sensors[i] for i in used(case.point.sensors)]
    return {"sensor": str(rng.choice([s["name"] for s in sensors]))}


def _after(number: int, change: Any) -> Deviation:
    def after(t: FloatArray, T: FloatArray) -> FloatArray:
        changed = T.copy()
        changed[:, number] = change(t, T[:, number])
        return changed

    return Deviation(after=(after,))


def _unit(history: History, form: str, p: Parameters) -> Deviation:
    return _after(
        sensor_number(history.case, p), lambda t, T: T - 273.15 if form == "degC" else (T - 273.15) * 1.8 + 32.0
    )


def _draw_stuck(rng: Generator, case: Case, form: str) -> dict[str, Any]:
    return one_sensor(rng, case, form) | {"start_s": hot_time(rng, case, 0.15, 0.8)}


def _stuck(history: History, form: str, p: Parameters) -> Deviation:
    def change(t: FloatArray, T: FloatArray) -> FloatArray:
        known = np.flatnonzero(np.isfinite(T) & (t <= p["start_s"]))
        held = T[known[-1]] if len(known) else np.nan
        return np.where((t > p["start_s"]) & np.isfinite(T) & np.isfinite(held), held, T)

    return _after(sensor_number(history.case, p), change)


def _draw_clipped(rng: Generator, case: Case, form: str) -> dict[str, Any]:
    drawn = one_sensor(rng, case, form)
    i = [s["name"] for s in case.point.sensors].index(drawn["sensor"])
    T = case.at(STEP).temperatures()[:, 1 + i]
    return drawn | {"limit_K": float(np.max(T) - rng.uniform(0.04, 0.2) * np.ptp(T))}


def _clipped(history: History, form: str, p: Parameters) -> Deviation:
    return on_sensor(sensor_number(history.case, p), lambda t, T: np.minimum(T, p["limit_K"]))


def _draw_drift(rng: Generator, case: Case, form: str) -> dict[str, Any]:
    return one_sensor(rng, case, form) | {"drift_K": float(sign(rng) * rng.uniform(5.0, 30.0))}


def _drift(history: History, form: str, p: Parameters) -> Deviation:
    share = history.t / history.t[-1]
    if form == "hot":  # with the time spent hot, as a junction that deteriorates
        return on_sensor(
            sensor_number(history.case, p), lambda t, T: T + p["drift_K"] * np.cumsum(0.7 * np.max(T) < T) / len(t)
        )
    return on_sensor(sensor_number(history.case, p), lambda t, T: T + p["drift_K"] * share)


def _draw_gain(rng: Generator, case: Case, form: str) -> dict[str, Any]:
    return one_sensor(rng, case, form) | {"gain": float(1.0 + sign(rng) * rng.uniform(0.01, 0.06))}


def _gain(history: History, form: str, p: Parameters) -> Deviation:
    return on_sensor(sensor_number(history.case, p), lambda t, T: p["gain"] * T)


def _draw_depth(rng: Generator, case: Case, form: str) -> dict[str, Any]:
    layers = case.point.stack["layer"]
    outer, inner = layers[0]["thickness_m"], layers[0]["thickness_m"] + layers[1]["thickness_m"]
    within = [s["name"] for s in case.point.sensors if outer + 1e-9 < s["depth_m"] < inner - 1e-9]
    if not within:
        raise Unsuitable
    return {"sensor": str(rng.choice(within)), "deeper_m": float(sign(rng) * rng.uniform(5e-4, 3e-3))}


def _depth(history: History, form: str, p: Parameters) -> Deviation:
    point, number = history.case.point, sensor_number(history.case, p)
    depth = point.depths_m[number] + p["deeper_m"]
    if not 0.0 < depth < sum(e["thickness_m"] for e in point.stack["layer"]):
        raise Unsuitable
    return Deviation(shifts_m=((number, p["deeper_m"]),))


def _draw_lag_change(rng: Generator, case: Case, form: str) -> dict[str, Any]:
    drawn = one_sensor(rng, case, form)
    return drawn | {"tau_s": float(rng.uniform(4.0, 20.0)), "start_s": hot_time(rng, case, 0.2, 0.6)}


def _lag_change(history: History, form: str, p: Parameters) -> Deviation:
    share = np.clip((history.t - p["start_s"]) / 60.0, 0.0, 1.0)
    return on_sensor(sensor_number(history.case, p), lambda t, T: T + share * (history.lagged(T, p["tau_s"]) - T))


# Table ---------------------------------------------------------------------------------------------------------------


def _draw_slope(low: float, high: float) -> Any:
    return lambda rng, case, form: {"share_deg": float(sign(rng) * rng.uniform(low, high))}


def _slope(variable: int) -> Any:
    def act(history: History, form: str, p: Parameters) -> Deviation:
        return Deviation(add=p["share_deg"] * history.case.r_0 * departure(history, variable))

    return act


def _draw_above(rng: Generator, case: Case, form: str) -> dict[str, Any]:
    if np.max(spread(case, ALPHA)) < 43.5:
        raise Unsuitable
    return {"share": float(rng.uniform(0.12, 0.18)), "alpha_deg": 42.0}


def _above(history: History, form: str, p: Parameters) -> Deviation:
    past = np.clip((history.x[ALPHA] - p["alpha_deg"]) / 0.5, 0.0, 1.0)
    return Deviation(multiply=1.0 + p["share"] * past)


# What no library has -------------------------------------------------------------------------------------------------


def _draw_unknown(rng: Generator, case: Case, form: str) -> dict[str, Any]:
    return {
        "amplitude": float(rng.uniform(0.04, 0.15)),
        "seed": int(rng.integers(1, 10**6)),
        "period_s": float(rng.uniform(30.0, 160.0)),
        "phase": float(rng.uniform(0.0, 6.28)),
    }


def _relay(history: History, form: str, p: Parameters) -> Deviation:
    alpha = history.x[ALPHA]
    hot = alpha[history.hot]
    low, high = np.quantile(hot, [0.2, 0.2 + 0.7 * (p["phase"] / 6.28)])
    g = relay((alpha > max(high, low + 0.8)).astype(float), (alpha > low).astype(float))
    return Deviation(multiply=1.0 + p["amplitude"] * g)


def _bumps(history: History, form: str, p: Parameters) -> Deviation:
    rng = np.random.default_rng(p["seed"])
    hot = history.t[history.hot]
    at = rng.uniform(hot[0], hot[-1], int(rng.integers(2, 4)))
    shape = sum(np.exp(-0.5 * ((history.t - a) / (0.25 * p["period_s"])) ** 2) for a in at)
    return Deviation(multiply=1.0 + p["amplitude"] * shape)


def _curve(variable: int) -> Any:
    """A smooth curve through random values at eight places of a variable."""

    def act(history: History, form: str, p: Parameters) -> Deviation:
        x, rng = history.x[variable], np.random.default_rng(p["seed"])
        hot = x[history.hot]
        knots = np.linspace(float(np.min(hot)) - 0.5, float(np.max(hot)) + 0.5, 8)
        curve = PchipInterpolator(knots, rng.normal(size=8))
        return Deviation(multiply=np.maximum(1.0 + p["amplitude"] * curve(np.clip(x, knots[0], knots[-1])), 0.1))

    return act


def _oscillation(history: History, form: str, p: Parameters) -> Deviation:
    t, period = history.t, p["period_s"]
    faster = 1.0 + (0.5 * t / t[-1] if form == "chirp" else 0.0)
    return Deviation(multiply=1.0 + p["amplitude"] * np.sin(2.0 * np.pi * t / period * faster + p["phase"]))


AROUND_1 = {"factor": (1.0, 0.5, 2.0)}
AMPLITUDE = {"amplitude": (0.0, 0.0, 0.45)}

FAULTS: dict[str, tuple[Family, ...]] = {
    "wall": (
        Family(
            "other-material",
            ("insulation",),
            lambda rng, case, form: {},
            _other_material,
            points=(*TILES, *FLAPS, *FELTS, "own-plug", "own-standoff"),
        ),
        Family(
            "skin-thickness",
            ("factor",),
            _drawn(0.6, 1.7),
            _thickness(-1),
            AROUND_1,
            points=(*BOND, *FELTS, "own-plug", "own-felt", "own-standoff"),
        ),
        Family(
            "layer-density",
            ("insulation", "skin"),
            _drawn(0.6, 1.6),
            _density,
            AROUND_1,
            points=(*BOND, "own-felt"),
            effects=("heat-capacity",),
        ),
        Family(
            "capacity-shape",
            ("tilt",),
            _drawn(0.6, 1.4),
            _shape("specific_heat_J_kgK"),
            {"factor": (1.0, 0.3, 1.7)},
            points=(*IN_DEPTH, *TILES),
            effects=("heat-capacity",),
        ),
        Family(
            "conductivity-shape",
            ("tilt",),
            _drawn(0.6, 1.4),
            _shape("conductivity_W_mK"),
            {"factor": (1.0, 0.3, 1.7)},
            points=(*IN_DEPTH, *TILES),
            effects=("conductivity", "radiative-conduction"),
        ),
        Family(
            "pressure-shape",
            ("tilt",),
            _drawn(0.7, 1.3),
            _pressure_shape,
            {"factor": (1.0, 0.5, 1.5)},
            points=("V09T9527", "own-plug", "own-felt", *FELTS),
            effects=("conductivity",),
        ),
        Family("bond-layer", ("sip",), _drawn(0.4, 2.0), _thickness(1), {"factor": (1.0, 0.3, 3.0)}, points=BOND),
        Family(
            "contact",
            ("inner",),
            lambda rng, case, form: {"contact_m2K_W": float(rng.uniform(0.01, 0.15))},
            _contact,
            {"contact_m2K_W": (0.0, 0.001, 0.5)},
            points=(*BOND, "own-felt", "own-plug"),
        ),
    ),
    "flight": (
        Family(
            "velocity-drift",
            ("held", "undone"),
            _draw_velocity,
            nothing,
            {"size": (0.0, -0.1, 0.1)},
            recorded=_velocity,
        ),
        Family(
            "density-layer",
            ("density", "consistent"),
            _draw_layer,
            nothing,
            {"size": (0.0, -0.3, 0.3)},
            recorded=_layer,
        ),
        Family(
            "density-scale",
            ("density", "with-pressure"),
            lambda rng, case, form: {"size": float(sign(rng) * rng.uniform(0.08, 0.18))},
            nothing,
            recorded=_density_scale,
        ),
        Family(
            "alpha-bias",
            ("offset",),
            lambda rng, case, form: {"bias_deg": float(sign(rng) * rng.uniform(1.0, 3.0))},
            nothing,
            needs=("popu",),
            recorded=_alpha_bias,
        ),
        Family(
            "alpha-smoothed",
            ("gauss",),
            lambda rng, case, form: {"smoothed_s": float(rng.uniform(4.0, 15.0))},
            nothing,
            {"smoothed_s": (0.0, 1.0, 40.0)},
            ("popu",),
            recorded=_alpha_smoothed,
        ),
        Family(
            "time-shift",
            ("all",),
            lambda rng, case, form: {"shift_s": float(sign(rng) * rng.uniform(1.0, 8.0))},
            nothing,
            {"shift_s": (0.0, -15.0, 15.0)},
            recorded=_shifted,
            effects=("time-skew",),
        ),
        Family(
            "trajectory-shift",
            ("state",),
            lambda rng, case, form: {"shift_s": float(sign(rng) * rng.uniform(3.0, 12.0))},
            nothing,
            {"shift_s": (0.0, -30.0, 30.0)},
            ("popu",),
            recorded=_shifted,
        ),
    ),
    "sensor": (
        Family("swap", ("neighbours",), _two, _swap, points=(*IN_DEPTH, "V07T9975", "own-plate", "LOWER_MID")),
        Family("unit", ("degC", "degF"), one_sensor, _unit),
        Family("stuck", ("held",), _draw_stuck, _stuck),
        Family("clipped", ("top",), _draw_clipped, _clipped),
        Family(
            "drift", ("time", "hot"), _draw_drift, _drift, {"drift_K": (0.0, -80.0, 80.0)}, effects=("sensor-bias",)
        ),
        Family(
            "gain",
            ("factor",),
            _draw_gain,
            _gain,
            {"gain": (1.0, 0.85, 1.15)},
            effects=("sensor-bias",),
        ),
        Family("depth", ("deeper",), _draw_depth, _depth, {"deeper_m": (0.0, -3e-3, 4e-3)}, points=IN_DEPTH),
        Family(
            "lag-change",
            ("later",),
            _draw_lag_change,
            _lag_change,
            {"tau_s": (0.0, 1.0, 60.0)},
            effects=("sensor-lag",),
        ),
    ),
    "table": (
        Family(
            "alpha-derivative", ("linear",), _draw_slope(0.015, 0.04), _slope(ALPHA), needs=("popu",), is_slope=True
        ),
        Family(
            "elevon-derivative",
            ("linear",),
            _draw_slope(0.02, 0.05),
            _slope(ELEVON),
            needs=("elevon",),
            points=FLAPS,
            is_slope=True,
        ),
        Family(
            "above-42",
            ("step",),
            _draw_above,
            _above,
            needs=("popu",),
            points=("V09T9527", "LOWER_MID", "LOWER_FWD", "V07T9975"),
            effects=("impingement-onset", "alpha-curvature"),
        ),
    ),
    "unknown": (
        Family("relay", ("alpha",), _draw_unknown, _relay, AMPLITUDE, ("popu",)),
        Family("bumps", ("time",), _draw_unknown, _bumps, AMPLITUDE),
        Family("alpha-curve", ("spline",), _draw_unknown, _curve(ALPHA), AMPLITUDE, ("popu",)),
        Family("oscillation", ("sine", "chirp"), _draw_unknown, _oscillation, AMPLITUDE),
        Family("re-curve", ("spline",), _draw_unknown, _curve(LOG_RE), AMPLITUDE),
    ),
}
"""Faults and forms by class of record."""
