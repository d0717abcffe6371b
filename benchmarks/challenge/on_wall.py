"""Effects on the wall, its surface, its back, its depth, and on the thermocouples.

catalysis            1 + step g(T_w): logistic | ramp | hump (rises and falls) | Arrhenius, 2 exp(-T_a / T) scaled
emissivity           factor | step at a time | slope (T - 900 K) | ramp in time | step in temperature
coating-thickness    factor | and a coating that conducts less | and one that holds less heat
conductivity         factor | growing with temperature | at low pressure alone | of a cold layer alone
heat-capacity        of the insulation | of the coating | growing with temperature
radiative-conduction k_rad (T / 1000 K)^3 | ^4 | cubic from 600 K up
backface-cooling     film | radiation | free convection | both
gap-flow             share of the convective flux at depth z: exp(-z/d) | box | bell | taken from the surface
moisture             latent heat as capacity about the boiling point | evaporation at a rate | and condensing further in
sensor-bias          offset | gain | both
sensor-lag           first order | second order
time-skew            constant | drifting
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

from benchmarks.challenge.case import Case, History
from benchmarks.challenge.deviation import HOT_K, Deviation
from benchmarks.challenge.form import Family, Generator, Parameters, Unsuitable, sign
from benchmarks.challenge.point import FELTS, FLAPS, IN_DEPTH, TILES
from benchmarks.challenge.recorder import used
from benchmarks.challenge.wall import along

FloatArray = NDArray[np.float64]

DENSE_K = np.arange(140.0, 2401.0, 30.0)
INSULATED = (*TILES, *FLAPS, *FELTS, "own-plug", "own-felt", "own-standoff")
STEP = 1.0


def hottest_K(case: Case) -> float:
    """Highest temperature of the surface without effect."""
    return float(np.max(case.at(STEP).temperatures()[:, 0]))


def reshaped(
    table: Any,
    factor: Callable[[FloatArray], FloatArray],
    plus: FloatArray | float = 0.0,
    at_K: FloatArray = DENSE_K,
) -> Any:
    """A property at some temperatures, times a function of temperature, plus a term."""
    by = factor(at_K)
    if isinstance(table, Mapping):
        columns = [np.interp(at_K, table["T_K"], column) * by + plus for column in np.array(table["k"], dtype=float).T]
        return {"p_Pa": table["p_Pa"], "T_K": at_K.tolist(), "k": np.array(columns).T.tolist()}
    return np.column_stack((at_K, along(table, at_K) * by + plus)).tolist()


def growing(factor: float, growth: float) -> Callable[[FloatArray], FloatArray]:
    """A factor whose distance from 1 grows linearly with temperature from its value at 700 K."""
    return lambda T: np.maximum(1.0 + (factor - 1.0) * (1.0 + growth * (T - 700.0) / 700.0), 0.1)


def change_of(layer: int, key: str, change: Callable[[Any], Any]) -> Deviation:
    """A property of a layer's material changed; of a material that several layers share, in all of them."""

    def apply(stack: dict[str, Any], materials: dict[str, Any]) -> None:
        name = stack["layer"][layer]["material"]
        materials[name][key] = change(materials[name][key])

    return Deviation(walls=(apply,))


# Surface -------------------------------------------------------------------------------------------------------------


def _draw_catalysis(rng: Generator, case: Case, form: str) -> dict[str, Any]:
    top = hottest_K(case)
    if top < 750.0:
        raise Unsuitable
    step = float(rng.uniform(0.06, 0.45)) * (sign(rng) if rng.random() < 0.4 else 1.0)
    return {
        "catalysis_step": step,
        "catalysis_K": float(rng.uniform(600.0, top - 60.0)),
        "catalysis_width_K": float(rng.uniform(20.0, 110.0)),
    }


def _catalysis(history: History, form: str, p: Parameters) -> Deviation:
    s = (HOT_K - p["catalysis_K"]) / p["catalysis_width_K"]
    shape = {
        "logistic": expit(s),
        "ramp": np.clip(0.5 + s / 4.0, 0.0, 1.0),
        "hump": np.exp(-0.5 * (s / 1.5) ** 2),
        "arrhenius": np.minimum(0.5 * np.exp(6.0 * (1.0 - p["catalysis_K"] / HOT_K)), 3.0),
    }[form]
    return Deviation(hot=p["catalysis_step"] * shape)


def _draw_emissivity(rng: Generator, case: Case, form: str) -> dict[str, Any]:
    history = case.at(STEP)
    hot = history.t[history.hot]
    if form == "slope":
        return {"emissivity_slope": float(sign(rng) * rng.uniform(5e-5, 3e-4))}
    drawn = {"emissivity_factor": float(rng.uniform(0.82, 0.96))}
    if form in ("step", "ramp"):
        drawn |= {
            "change_s": float(rng.uniform(hot[0], hot[int(0.7 * len(hot))])),
            "ramp_s": float(rng.uniform(40.0, 200.0)),
        }
    if form == "hot":
        drawn |= {"change_K": float(hottest_K(case) - rng.uniform(60.0, 200.0))}
    return drawn


def _emissivity(history: History, form: str, p: Parameters) -> Deviation:
    if form == "slope":
        slope = p["emissivity_slope"]
        return change_of(
            0, "emissivity", lambda e: reshaped(e, lambda T: np.clip(1.0 + slope * (T - 900.0), 0.3, 1.15))
        )
    factor = p["emissivity_factor"]
    if form == "hot":
        at = p["change_K"]
        return change_of(
            0, "emissivity", lambda e: reshaped(e, lambda T: 1.0 + (factor - 1.0) * expit((T - at) / 15.0))
        )
    since = history.t - p.get("change_s", -1.0)
    share = {"constant": np.ones_like(since), "step": (since > 0.0).astype(float)}.get(form)
    share = np.clip(since / p["ramp_s"], 0.0, 1.0) if share is None else share
    return Deviation(eps_factor=1.0 + (factor - 1.0) * share)


# Coating, insulation -------------------------------------------------------------------------------------------------


def _factor(key: str, low: float, high: float) -> Callable[[Generator, Case, str], dict[str, Any]]:
    def draw(rng: Generator, case: Case, form: str) -> dict[str, Any]:
        name = "coating_" + key if form == "coating" else key
        value = float(rng.uniform(1.06, high) if rng.random() < 0.5 else rng.uniform(low, 0.94))
        return {name: value, "growth": float(rng.uniform(0.4, 1.2))}

    return draw


def _coating(history: History, form: str, p: Parameters) -> Deviation:
    factor = p["coating_factor"]

    def apply(stack: dict[str, Any], materials: dict[str, Any]) -> None:
        layer = stack["layer"][0]
        layer["thickness_m"] *= factor
        key = {"poor-conductor": "conductivity_W_mK", "light": "specific_heat_J_kgK"}.get(form)
        if key:
            material = materials[layer["material"]]
            material[key] = reshaped(material[key], lambda T: 0.9 + 0.0 * T)

    return Deviation(walls=(apply,))


def _conductivity(history: History, form: str, p: Parameters) -> Deviation:
    factor, growth = p["conductivity_factor"], p["growth"]

    def change(table: Any) -> Any:
        if form == "low-pressure" and isinstance(table, Mapping):
            by = 1.0 + (factor - 1.0) * 1.5 / (1.0 + np.array(table["p_Pa"]) / 500.0)
            return {**table, "k": (np.array(table["k"]) * by).tolist()}
        if form == "cold":
            return reshaped(table, lambda T: 1.0 + (factor - 1.0) * 1.5 * expit((650.0 - T) / 60.0))
        return reshaped(table, growing(factor, growth if form == "growing" else 0.0))

    return change_of(1, "conductivity_W_mK", change)


def _heat_capacity(history: History, form: str, p: Parameters) -> Deviation:
    if form == "coating":
        return change_of(
            0, "specific_heat_J_kgK", lambda c: reshaped(c, growing(p["coating_heat_capacity_factor"], 0.0))
        )
    growth = p["growth"] if form == "growing" else 0.0
    return change_of(1, "specific_heat_J_kgK", lambda c: reshaped(c, growing(p["heat_capacity_factor"], growth)))


def _radiative(history: History, form: str, p: Parameters) -> Deviation:
    T = DENSE_K / 1000.0
    more = {"cubic": T**3, "quartic": T**4, "cubic-above": np.maximum(T**3 - 0.216, 0.0)}[form]
    return change_of(1, "conductivity_W_mK", lambda k: reshaped(k, np.ones_like, p["k_rad"] * more))


# Back and depth ------------------------------------------------------------------------------------------------------


def draw_backface(rng: Generator, case: Any, form: str) -> dict[str, Any]:
    """What an insulated back loses heat to: its temperature, film coefficient and emissivity."""
    drawn = {"back_K": float(round(case.point.stack["initial_K"] + rng.uniform(-25.0, 5.0), 1))}
    if form != "radiation":
        drawn["back_h_W_m2K"] = float(rng.uniform(2.0, 15.0))
    if form in ("radiation", "both"):
        drawn["back_emissivity"] = float(rng.uniform(0.3, 0.9))
    return drawn


def backface(history: Any, form: str, p: Parameters) -> Deviation:
    """A back that loses heat."""
    exponent = 0.25 if form == "free-convection" else 0.0
    return Deviation(back=(p.get("back_h_W_m2K", 0.0), p["back_K"], p.get("back_emissivity", 0.0), exponent))


def draw_gap(rng: Generator, case: Any, form: str) -> dict[str, Any]:
    """Share of the convective flux that enters a gap, and how deep."""
    thick = case.point.stack["layer"][1]["thickness_m"]
    return {"gap_fraction": float(rng.uniform(0.002, 0.03)), "gap_depth_m": float(rng.uniform(0.15, 0.5) * thick)}


def _gap(history: History, form: str, p: Parameters) -> Deviation:
    layers, depth = history.case.point.stack["layer"], p["gap_depth_m"]
    inner = layers[0]["thickness_m"] + layers[1]["thickness_m"]

    def weights(z: FloatArray) -> FloatArray:
        shape = np.exp(-z / depth)
        if form == "box":
            shape = (z < depth).astype(float)
        elif form == "bell":
            shape = np.exp(-0.5 * ((z - depth) / (0.35 * depth)) ** 2)
        return np.asarray((z < inner) * shape)

    return Deviation(deposit=(weights, p["gap_fraction"], 1.0 if form == "diverted" else 0.0))


def _draw_moisture(rng: Generator, case: Case, form: str) -> dict[str, Any]:
    return {
        "water_kg_m3": float(rng.uniform(0.5, 6.0)),
        "boil_K": float(rng.uniform(325.0, 375.0)),
        "width_K": float(rng.uniform(6.0, 30.0)),
        "time_s": float(rng.uniform(4.0, 30.0)),
        "condensing": float(rng.uniform(0.2, 0.6)) if form == "migrating" else 0.0,
    }


def _moisture(history: History, form: str, p: Parameters) -> Deviation:
    layers, latent = history.case.point.stack["layer"], 2.4e6
    outer, inner = layers[0]["thickness_m"], layers[0]["thickness_m"] + layers[1]["thickness_m"]
    boil, width = p["boil_K"], p["width_K"]
    if form != "capacity":
        numbers = np.array([latent, boil, width, p["time_s"], p["condensing"]])
        return Deviation(water=(lambda z: p["water_kg_m3"] * ((z > outer) & (z < inner)), numbers))
    return wet_capacity(p["water_kg_m3"], latent, boil, width, DENSE_K)


def wet_capacity(water_kg_m3: float, latent_J_kg: float, boil_K: float, width_K: float, at_K: FloatArray) -> Deviation:
    """The latent heat of water in the insulation as a bell of its specific heat about the boiling point."""
    T = np.unique(np.concatenate((at_K, boil_K + width_K * np.linspace(-4.0, 4.0, 33))))
    bell = np.exp(-0.5 * ((T - boil_K) / width_K) ** 2) / (width_K * np.sqrt(2.0 * np.pi))

    def apply(stack: dict[str, Any], materials: dict[str, Any]) -> None:
        wet = materials[stack["layer"][1]["material"]]
        more = latent_J_kg * water_kg_m3 / wet["density_kg_m3"] * bell
        wet["specific_heat_J_kgK"] = np.column_stack((T, along(wet["specific_heat_J_kgK"], T) + more)).tolist()

    return Deviation(walls=(apply,))


# Thermocouples -------------------------------------------------------------------------------------------------------


def draw_sensor(rng: Generator, case: Any) -> dict[str, Any]:
    """One of the thermocouples that are fitted."""
    return {"sensor": case.point.sensors[int(rng.choice(used(case.point.sensors)))]["name"]}


def sensor_number(case: Any, p: Parameters) -> int:
    """Number of the thermocouple that parameters name."""
    return [s["name"] for s in case.point.sensors].index(p["sensor"])


def on_sensor(number: int, change: Callable[[FloatArray, FloatArray], FloatArray]) -> Deviation:
    """One thermocouple's indication changed: (times, temperatures) -> temperatures."""

    def read(t: FloatArray, T: FloatArray) -> FloatArray:
        changed = T.copy()
        changed[:, number] = change(t, T[:, number])
        return changed

    return Deviation(read=(read,))


def _draw_bias(rng: Generator, case: Case, form: str) -> dict[str, Any]:
    drawn = draw_sensor(rng, case)
    if form != "gain":
        drawn["bias_K"] = float(sign(rng) * rng.uniform(3.0, 15.0))
    if form != "offset":
        drawn["gain"] = float(1.0 + sign(rng) * rng.uniform(0.01, 0.05))
    return drawn


def _bias(history: History, form: str, p: Parameters) -> Deviation:
    return biased(history.case, p)


def biased(case: Any, p: Parameters) -> Deviation:
    """A thermocouple of a case with an offset and a gain."""
    return on_sensor(sensor_number(case, p), lambda t, T: p.get("gain", 1.0) * T + p.get("bias_K", 0.0))


def _draw_lag(rng: Generator, case: Case, form: str) -> dict[str, Any]:
    return draw_sensor(rng, case) | {"tau_s": float(rng.uniform(2.0, 12.0))}


def _lag(history: History, form: str, p: Parameters) -> Deviation:
    tau = p["tau_s"]
    if form == "second-order":
        return on_sensor(
            sensor_number(history.case, p), lambda t, T: history.lagged(history.lagged(T, 0.5 * tau), 0.5 * tau)
        )
    return on_sensor(sensor_number(history.case, p), lambda t, T: history.lagged(T, tau))


def _draw_skew(rng: Generator, case: Case, form: str) -> dict[str, Any]:
    skew = float(sign(rng) * rng.uniform(0.6, 3.5))
    return {"skew_s": skew, "drift_s": float(skew * rng.uniform(0.2, 0.6)) if form == "drift" else 0.0}


def _skew(history: History, form: str, p: Parameters) -> Deviation:
    return Deviation(skew_s=p["skew_s"] + p["drift_s"] * (history.t / history.t[-1] - 0.5))


ON_WALL = (
    Family("time-skew", ("constant", "drift"), _draw_skew, _skew, {"skew_s": (0.0, -5.0, 5.0)}),
    Family(
        "coating-thickness",
        ("factor", "poor-conductor", "light"),
        _factor("coating_factor", 0.6, 1.7),
        _coating,
        {"coating_factor": (1.0, 0.4, 2.2)},
        points=INSULATED,
    ),
    Family(
        "conductivity",
        ("factor", "growing", "low-pressure", "cold"),
        _factor("conductivity_factor", 0.7, 1.4),
        _conductivity,
        {"conductivity_factor": (1.0, 0.6, 1.7)},
        points=INSULATED,
    ),
    Family(
        "heat-capacity",
        ("insulation", "coating", "growing"),
        _factor("heat_capacity_factor", 0.7, 1.4),
        _heat_capacity,
        {"heat_capacity_factor": (1.0, 0.6, 1.7), "coating_heat_capacity_factor": (1.0, 0.4, 2.2)},
        points=INSULATED,
    ),
    Family(
        "emissivity",
        ("constant", "step", "slope", "ramp", "hot"),
        _draw_emissivity,
        _emissivity,
        {"emissivity_factor": (1.0, 0.65, 1.0), "emissivity_slope": (0.0, -6e-4, 6e-4)},
        points=(*TILES, *FLAPS),
    ),
    Family(
        "sensor-bias",
        ("offset", "gain", "both"),
        _draw_bias,
        _bias,
        {"bias_K": (0.0, -40.0, 40.0), "gain": (1.0, 0.9, 1.1)},
    ),
    Family("sensor-lag", ("first-order", "second-order"), _draw_lag, _lag, {"tau_s": (0.0, 0.5, 30.0)}),
    Family(
        "catalysis",
        ("logistic", "ramp", "hump", "arrhenius"),
        _draw_catalysis,
        _catalysis,
        {"catalysis_step": (0.0, -0.5, 1.2)},
        points=(*TILES, *FLAPS, "own-plug", "own-standoff"),
    ),
    Family(
        "backface-cooling",
        ("film", "radiation", "free-convection", "both"),
        draw_backface,
        backface,
        {"back_h_W_m2K": (0.0, 0.5, 60.0), "back_emissivity": (0.0, 0.05, 0.95)},
        points=(*IN_DEPTH, *FELTS),
    ),
    Family(
        "gap-flow",
        ("exponential", "box", "bell", "diverted"),
        draw_gap,
        _gap,
        {"gap_fraction": (0.0, 2e-4, 0.15)},
        points=IN_DEPTH,
    ),
    Family(
        "moisture",
        ("capacity", "evaporating", "migrating"),
        _draw_moisture,
        _moisture,
        {"water_kg_m3": (0.0, 0.05, 15.0)},
        points=("V09T9527", "own-plug", "own-felt"),
    ),
    Family(
        "radiative-conduction",
        ("cubic", "quartic", "cubic-above"),
        lambda rng, case, form: {"k_rad": float(rng.uniform(0.01, 0.08))},
        _radiative,
        {"k_rad": (0.0, 1e-3, 0.2)},
        points=("V09T9527", "own-plug", "own-standoff"),
    ),
)
