"""Effects on the wall, its surface, its back, its depth, and on the thermocouples.

catalysis            1 + step g,  g logistic in T_w | ramp in T_w | logistic in recovery enthalpy
emissivity           a factor | after a step | after a ramp | 1 + slope (T - 900 K)
coating-thickness    factor | factor, and a coating that conducts less
conductivity         factor | factor that grows with temperature
heat-capacity        of the insulation | of the coating | of the insulation, growing with temperature
radiative-conduction k_rad (T / 1000 K)^3 | ^4 | cubic from 600 K up | linear from there
backface-cooling     film | radiation | free convection, h ~ |T - T_b|^1/4 | both
gap-flow             share of the convective flux at depth z: exp(-z/d) | box | exp(-z/d), taken from the surface | bell
moisture             latent heat as capacity about the boiling point | evaporation at a rate | and condensing further in
sensor-bias          offset | gain | both
time-skew            constant | drifting clock
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

from benchmarks.challenge.deviation import HOT_K, Deviation
from benchmarks.challenge.form import Family, Generator, Parameters, Unsuitable, sign
from benchmarks.challenge.on_wall import (
    backface,
    biased,
    change_of,
    draw_backface,
    draw_gap,
    draw_sensor,
    reshaped,
    wet_capacity,
)
from benchmarks.challenge.point import times
from benchmarks.challenge.wall import along
from benchmarks.generator.case import Case
from benchmarks.generator.on_ratio import WINDWARD

FloatArray = NDArray[np.float64]

DENSE_K = np.arange(200.0, 2401.0, 40.0)
"""Where a property that is changed with temperature is tabulated."""

TILES = ("lower", "elevon", "flap")
INSULATED = (*TILES, "felt", "standoff")


# Surface -------------------------------------------------------------------------------------------------------------


def _draw_catalysis(rng: Generator, case: Case, form: str) -> dict[str, Any]:
    step = float(sign(rng) * rng.uniform(0.06, 0.4)) if rng.random() < 0.3 else float(rng.uniform(0.06, 0.5))
    if form == "enthalpy":
        H = case.fine["H_r_J_kg"][case.hot]
        middle = float(np.min(H) + rng.uniform(0.3, 0.7) * np.ptp(H))
        return {
            "catalysis_step": -abs(step),
            "enthalpy_J_kg": float(middle),
            "width_J_kg": float(rng.uniform(1e6, 4e6)),
        }
    T = case.temperatures()[:, 0]
    if np.max(T) < 750.0:
        raise Unsuitable
    middle = float(rng.uniform(600.0, np.max(T) - 40.0))
    return {"catalysis_step": step, "catalysis_K": float(middle), "catalysis_width_K": float(rng.uniform(20.0, 120.0))}


def _catalysis(case: Case, form: str, p: Parameters) -> Deviation:
    step = p["catalysis_step"]
    if form == "enthalpy":
        return Deviation(multiply=1.0 + step * expit((case.fine["H_r_J_kg"] - p["enthalpy_J_kg"]) / p["width_J_kg"]))
    past = (HOT_K - p["catalysis_K"]) / p["catalysis_width_K"]
    rise = np.clip(0.5 + past / 4.0, 0.0, 1.0) if form == "ramp" else expit(past)
    return Deviation(hot=step * rise)


def _draw_emissivity(rng: Generator, case: Case, form: str) -> dict[str, Any]:
    if form == "slope":
        return {"emissivity_slope": float(sign(rng) * rng.uniform(1e-4, 4e-4))}
    drawn = {"emissivity_factor": float(rng.uniform(0.75, 0.95))}
    if form == "constant":
        return drawn
    hot = np.flatnonzero(case.hot)
    drawn["change_s"] = float(case.time_s[hot[int(rng.uniform(0.25, 0.75) * len(hot))]])
    return drawn | ({"ramp_s": float(rng.uniform(20.0, 150.0))} if form == "ramp" else {})


def _emissivity(case: Case, form: str, p: Parameters) -> Deviation:
    if form == "slope":

        def sloped(declared: Any) -> Any:
            value = along(declared, DENSE_K) * (1.0 + p["emissivity_slope"] * (DENSE_K - 900.0))
            return np.column_stack((DENSE_K, np.clip(value, 0.1, 1.0))).tolist()

        return change_of(0, "emissivity", sloped)
    since = np.ones(len(case.time_s))
    if form != "constant":
        since = np.clip((case.time_s - p["change_s"]) / p.get("ramp_s", 0.1), 0.0, 1.0)
    return Deviation(eps_factor=1.0 + (p["emissivity_factor"] - 1.0) * since)


# Properties ----------------------------------------------------------------------------------------------------------


def _draw_coating(rng: Generator, case: Case, form: str) -> dict[str, Any]:
    thin, thick = rng.uniform(0.5, 0.85), rng.uniform(1.2, 2.0)
    return {"coating_factor": float(thin if rng.random() < 0.5 else thick)}


def _coating(case: Case, form: str, p: Parameters) -> Deviation:

    def apply(stack: dict[str, Any], materials: dict[str, Any]) -> None:
        outer = stack["layer"][0]
        outer["thickness_m"] *= p["coating_factor"]
        if form == "poor-conductor":
            glass = materials[outer["material"]]
            glass["conductivity_W_mK"] = times(glass["conductivity_W_mK"], 0.85, 4)

    return Deviation(walls=(apply,))


def _draw_factor(key: str, low: tuple[float, float], high: tuple[float, float]) -> Any:
    def draw(rng: Generator, case: Case, form: str) -> dict[str, Any]:
        name = "coating_heat_capacity_factor" if form == "coating" else key
        drawn = {name: float(rng.uniform(*low) if rng.random() < 0.5 else rng.uniform(*high))}
        return drawn | ({"growth": float(rng.uniform(0.2, 0.6))} if form == "growing" else {})

    return draw


def _changed(layer: int, key: str, factor: float, growth: float) -> Deviation:
    """A property times factor, the departure from one being `growth` larger at 1500 K than at 300 K."""

    def at(T: FloatArray) -> FloatArray:
        return 1.0 + (factor - 1.0) * (1.0 + growth * ((T - 300.0) / 1200.0 - 0.5))

    return change_of(layer, key, lambda table: reshaped(table, at, at_K=DENSE_K))


def _conductivity(case: Case, form: str, p: Parameters) -> Deviation:
    return _changed(1, "conductivity_W_mK", p["conductivity_factor"], p.get("growth", 0.0))


def _heat_capacity(case: Case, form: str, p: Parameters) -> Deviation:
    if form == "coating":
        return _changed(0, "specific_heat_J_kgK", p["coating_heat_capacity_factor"], 0.0)
    return _changed(1, "specific_heat_J_kgK", p["heat_capacity_factor"], p.get("growth", 0.0))


def _draw_radiative(rng: Generator, case: Case, form: str) -> dict[str, Any]:
    return {"k_rad": float(rng.uniform(0.01, 0.08))}


def _radiative(case: Case, form: str, p: Parameters) -> Deviation:
    T = DENSE_K / 1000.0
    forms = {
        "cubic": T**3,
        "quartic": T**4,
        "cubic-above": np.maximum(T**3 - 0.6**3, 0.0),
        "linear-above": np.maximum(T - 0.6, 0.0) / 0.4,
    }
    more = p["k_rad"] * forms[form]
    return change_of(1, "conductivity_W_mK", lambda k: reshaped(k, np.ones_like, more, DENSE_K))


# Back and depth ------------------------------------------------------------------------------------------------------


def _draw_backface(rng: Generator, case: Case, form: str) -> dict[str, Any]:
    if case.point.stack["back"] != "adiabatic":
        raise Unsuitable
    return draw_backface(rng, case, form)


def _gap(case: Case, form: str, p: Parameters) -> Deviation:
    layers, depth = case.point.stack["layer"], p["gap_depth_m"]
    inner = layers[0]["thickness_m"] + layers[1]["thickness_m"]

    def weights(z: FloatArray) -> FloatArray:
        inside = (z < inner).astype(float)
        if form == "box":
            return inside * (z < depth)
        if form == "bell":
            return np.asarray(inside * np.exp(-0.5 * ((z - depth) / (0.4 * depth)) ** 2))
        return np.asarray(inside * np.exp(-z / depth))

    return Deviation(deposit=(weights, p["gap_fraction"], 1.0 if form == "diverted" else 0.0))


def _draw_moisture(rng: Generator, case: Case, form: str) -> dict[str, Any]:
    drawn = {
        "water_kg_m3": float(rng.uniform(0.5, 6.0)),
        "latent_J_kg": 2.4e6,
        "boil_K": float(rng.uniform(325.0, 375.0)),
        "width_K": float(rng.uniform(6.0, 30.0)),
    }
    if form != "capacity":
        drawn["time_s"] = float(rng.uniform(4.0, 30.0))
    return drawn | ({"condensing": float(rng.uniform(0.2, 0.6))} if form == "migrating" else {})


def _moisture(case: Case, form: str, p: Parameters) -> Deviation:
    layers = case.point.stack["layer"]
    outer, inner = layers[0]["thickness_m"], layers[0]["thickness_m"] + layers[1]["thickness_m"]
    if form == "capacity":
        return wet_capacity(p["water_kg_m3"], p["latent_J_kg"], p["boil_K"], p["width_K"], DENSE_K)
    numbers = np.array([p["latent_J_kg"], p["boil_K"], p["width_K"], p["time_s"], p.get("condensing", 0.0)])
    return Deviation(water=(lambda z: p["water_kg_m3"] * ((z > outer) & (z < inner)), numbers))


# Thermocouples -------------------------------------------------------------------------------------------------------


def _draw_bias(rng: Generator, case: Case, form: str) -> dict[str, Any]:
    drawn = draw_sensor(rng, case)
    if form != "gain":
        drawn["bias_K"] = float(sign(rng) * rng.uniform(4.0, 20.0))
    if form != "offset":
        drawn["gain"] = float(1.0 + sign(rng) * rng.uniform(0.01, 0.05))
    return drawn


def _bias(case: Case, form: str, p: Parameters) -> Deviation:
    return biased(case, p)


def _draw_skew(rng: Generator, case: Case, form: str) -> dict[str, Any]:
    skew = float(sign(rng) * rng.uniform(0.6, 3.0))
    return {"skew_s": skew} | ({"drift_s": float(abs(skew) * rng.uniform(-0.3, 0.3))} if form == "drift" else {})


def _skew(case: Case, form: str, p: Parameters) -> Deviation:
    t = case.time_s
    return Deviation(skew_s=p["skew_s"] + p.get("drift_s", 0.0) * (t / t[-1] - 0.5))


ON_WALL = (
    Family("time-skew", ("constant", "drift"), _draw_skew, _skew, {"skew_s": (0.0, -4.0, 4.0)}),
    Family(
        "coating-thickness", ("factor", "poor-conductor"), _draw_coating, _coating, {"coating_factor": (1.0, 0.4, 2.2)}
    ),
    Family(
        "conductivity", ("factor", "growing"), _draw_factor("conductivity_factor", (0.7, 0.92), (1.08, 1.35)),
        _conductivity, {"conductivity_factor": (1.0, 0.65, 1.5)}, points=INSULATED, least_sensors=2,
    ),
    Family(
        "heat-capacity", ("insulation", "coating", "growing"),
        _draw_factor("heat_capacity_factor", (0.7, 0.92), (1.08, 1.35)), _heat_capacity,
        {"heat_capacity_factor": (1.0, 0.65, 1.5), "coating_heat_capacity_factor": (1.0, 0.4, 2.2)}, points=INSULATED,
        least_sensors=2,
    ),
    Family(
        "emissivity", ("constant", "step", "ramp", "slope"), _draw_emissivity, _emissivity,
        {"emissivity_factor": (1.0, 0.7, 1.0), "emissivity_slope": (0.0, -8e-4, 8e-4)},
    ),
    Family("sensor-bias", ("offset", "gain", "both"), _draw_bias, _bias,
           {"bias_K": (0.0, -40.0, 40.0), "gain": (1.0, 0.9, 1.1)}, least_sensors=2),
    Family("catalysis", ("logistic", "ramp", "enthalpy"), _draw_catalysis, _catalysis,
           {"catalysis_step": (0.0, -0.5, 1.0)}, points=(*WINDWARD, "standoff")),
    Family(
        "backface-cooling", ("film", "radiation", "free-convection", "both"), _draw_backface, backface,
        {"back_h_W_m2K": (0.0, 0.5, 40.0), "back_emissivity": (0.0, 0.05, 0.95)}, least_sensors=2,
    ),
    Family("gap-flow", ("exponential", "box", "diverted", "bell"), draw_gap, _gap,
           {"gap_fraction": (0.0, 2e-4, 0.15)}, points=INSULATED, least_sensors=3),
    Family("moisture", ("capacity", "evaporating", "migrating"), _draw_moisture, _moisture,
           {"water_kg_m3": (0.0, 0.05, 15.0)}, points=(*TILES, "felt"), least_sensors=3),
    Family("radiative-conduction", ("cubic", "quartic", "cubic-above", "linear-above"), _draw_radiative, _radiative,
           {"k_rad": (0.0, 1e-3, 0.2)}, points=(*TILES, "standoff"), least_sensors=3),
)  # fmt: skip
