"""Faults of the recorder, and causes that no library has.

recorder  polynomial (a calibration that is not declared: quadratic | cubic) | clock-drift (linear | reset)
          | drop-outs (words at the bottom of the range | lost runs: nothing is missing) | jet-spikes (recorded density
          while jets fire: constant | growing with the length of a firing)
lacking   event (heating changed in one manoeuvre alone, while it lasts | from its start on | with a decay after it)
          | flux (added to convection: constant | radiation of the shock layer, rho^1.2 V^8.5 | from a time on)
          | lateral (lost sideways from the insulation | from the skin)
          | junction (lead-conduction towards the back | shunting, exp(T / 80 K) | cold-junction that warms
          | radiating, (T / 1000 K)^4)

Sources: radiation of the shock layer, Tauber and Sutton (1991), J. Spacecraft 28, 40 (exponents near 50 to 60 km);
thermocouples, ASTM MNL 12 (1993), ch. 9.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.challenge.case import Case, History
from benchmarks.challenge.deviation import Deviation
from benchmarks.challenge.faults import hot_time, nothing, one_sensor
from benchmarks.challenge.form import Family, Generator, Parameters, Unsuitable, sign
from benchmarks.challenge.on_wall import STEP, on_sensor, sensor_number
from benchmarks.challenge.point import FELTS, FLAPS, IN_DEPTH, TILES

FloatArray = NDArray[np.float64]
State = dict[str, FloatArray]

JUNCTIONS = ("lead-conduction", "shunting", "cold-junction", "radiating")


# Recorder ------------------------------------------------------------------------------------------------------------


def _draw_polynomial(rng: Generator, case: Case, form: str) -> dict[str, Any]:
    return one_sensor(rng, case, form) | {"bend_K": float(sign(rng) * rng.uniform(3.0, 25.0))}


def _polynomial(history: History, form: str, p: Parameters) -> Deviation:
    low, high = history.case.point.sensors[sensor_number(history.case, p)]["range_K"]

    def bent(t: FloatArray, T: FloatArray) -> FloatArray:
        x = (T - low) / (high - low)
        shape = 4.0 * x * (1.0 - x) if form == "quadratic" else 10.4 * x * (1.0 - x) * (1.0 - 2.0 * x)
        return np.asarray(T + p["bend_K"] * shape)

    return on_sensor(sensor_number(history.case, p), bent)


def _draw_drift(rng: Generator, case: Case, form: str) -> dict[str, Any]:
    return {"drift_s": float(sign(rng) * rng.uniform(2.0, 8.0)), "reset_s": hot_time(rng, case, 0.2, 0.8)}


def _drift(history: History, form: str, p: Parameters) -> Deviation:
    share = history.t / history.t[-1]
    if form == "reset":
        share = np.clip((history.t - p["reset_s"]) / 2.0, 0.0, 1.0)
    return Deviation(skew_s=p["drift_s"] * share)


def _draw_drop_outs(rng: Generator, case: Case, form: str) -> dict[str, Any]:
    return {"share": float(rng.uniform(0.004, 0.03)), "seed": int(rng.integers(1, 10**6))}


def _drop_outs(history: History, form: str, p: Parameters) -> Deviation:
    bottoms = [s["range_K"][0] for s in history.case.point.sensors]

    def after(t: FloatArray, T: FloatArray) -> FloatArray:
        rng, found = np.random.default_rng(p["seed"]), T.copy()
        for i, bottom in enumerate(bottoms):
            begun = np.flatnonzero(rng.random(len(t)) < p["share"])
            for at in begun[np.diff(begun, prepend=-9) > 1]:
                if form == "lost":
                    found[at : at + int(rng.integers(3, 30)), i] = np.nan
                elif np.isfinite(found[at, i]):
                    found[at, i] = bottom
        return found

    return Deviation(after=(after,))


def _draw_spikes(rng: Generator, case: Case, form: str) -> dict[str, Any]:
    history = case.at(STEP)
    if "jets" not in history.columns or float(np.sum(history.columns["jets"][history.hot])) < 6.0:
        raise Unsuitable
    return {"spike": float(rng.choice([-1.0, 1.0, 1.0]) * rng.uniform(0.1, 0.4))}


def _spikes(case: Case, form: str, p: Parameters, state: State) -> State:
    jets = state["jets"]
    if form == "growing":
        step = float(state["time_s"][1] - state["time_s"][0])
        since = np.zeros(len(jets))
        for i in range(1, len(jets)):
            since[i] = (since[i - 1] + step) * (jets[i] > 0.5)
        jets = jets * np.minimum(since / 3.0, 2.0)
    return state | {"rho_kg_m3": state["rho_kg_m3"] * np.maximum(1.0 + p["spike"] * jets, 0.2)}


# What no library has -------------------------------------------------------------------------------------------------


def _draw_event(rng: Generator, case: Case, form: str) -> dict[str, Any]:
    history = case.at(STEP)
    hot = history.t[history.hot]
    inside = [m for m in case.flight.manoeuvres if hot[0] < m[1] < hot[-1] - 20.0]
    if not inside:
        raise Unsuitable
    _, start, end = inside[int(rng.integers(len(inside)))]
    size = {"size": float(sign(rng) * rng.uniform(0.06, 0.3))}
    return size | {"start_s": float(start), "end_s": float(end), "decay_s": float(rng.uniform(20.0, 120.0))}


def _event(history: History, form: str, p: Parameters) -> Deviation:
    t = history.t
    share = np.clip((t - p["start_s"]) / 2.0, 0.0, 1.0)
    if form == "pulse":
        share = share * np.clip((p["end_s"] - t) / 2.0, 0.0, 1.0)
    elif form == "decaying":
        share = share * np.exp(-np.maximum(t - p["end_s"], 0.0) / p["decay_s"])
    return Deviation(multiply=1.0 + p["size"] * share)


def _draw_flux(rng: Generator, case: Case, form: str) -> dict[str, Any]:
    return {"flux_W_m2": float(rng.uniform(300.0, 6000.0)), "start_s": hot_time(rng, case, 0.2, 0.7)}


def _flux(history: History, form: str, p: Parameters) -> Deviation:
    if form == "constant":
        return Deviation(added=p["flux_W_m2"] * np.ones(len(history.t)))
    if form == "late":
        return Deviation(added=p["flux_W_m2"] * np.clip((history.t - p["start_s"]) / 3.0, 0.0, 1.0))
    shape = history.columns["rho_kg_m3"] ** 1.2 * history.columns["velocity_m_s"] ** 8.5
    return Deviation(added=p["flux_W_m2"] * shape / float(np.max(shape)))


def _draw_lateral(rng: Generator, case: Case, form: str) -> dict[str, Any]:
    return {"G_W_m3K": float(rng.uniform(20.0, 300.0) * (1.0 if form == "insulation" else 30.0))}


def _lateral(history: History, form: str, p: Parameters) -> Deviation:
    layers = history.case.point.stack["layer"]
    faces = np.cumsum([entry["thickness_m"] for entry in layers])
    low, high = (faces[0], faces[1]) if form == "insulation" else (faces[-2], faces[-1])
    return Deviation(side=lambda z: p["G_W_m3K"] * ((z > low) & (z < high)))


def _draw_junction(rng: Generator, case: Case, form: str) -> dict[str, Any]:
    drawn = one_sensor(rng, case, form)
    number = [s["name"] for s in case.point.sensors].index(drawn["sensor"])
    T = case.at(STEP).temperatures()[:, 1 + number]
    if form == "shunting":
        if np.max(T) < 850.0:
            raise Unsuitable
        return drawn | {"error_K": float(rng.uniform(5.0, 40.0)), "from_K": float(np.max(T))}
    return drawn | {"error_K": float(rng.uniform(4.0, 25.0)), "time_s": float(rng.uniform(150.0, 700.0))}


def _junction(history: History, form: str, p: Parameters) -> Deviation:
    def read(t: FloatArray, T: FloatArray) -> FloatArray:
        if form == "lead-conduction":
            return np.asarray(T - p["error_K"] * (T - T[0]) / 500.0)
        if form == "shunting":
            return np.asarray(T - p["error_K"] * np.exp((T - p["from_K"]) / 80.0))
        if form == "cold-junction":
            return np.asarray(T - p["error_K"] * -np.expm1(-t / p["time_s"]))
        return np.asarray(T - p["error_K"] * (T / 1000.0) ** 4)

    return on_sensor(sensor_number(history.case, p), read)


LACKING: dict[str, tuple[Family, ...]] = {
    "recorder": (
        Family(
            "polynomial",
            ("quadratic", "cubic"),
            _draw_polynomial,
            _polynomial,
            {"bend_K": (0.0, -80.0, 80.0)},
            effects=("sensor-bias",),
            kind="sensor",
        ),
        Family(
            "clock-drift",
            ("linear", "reset"),
            _draw_drift,
            _drift,
            {"drift_s": (0.0, -20.0, 20.0)},
            effects=("time-skew",),
            kind="flight",
        ),
        Family("drop-outs", ("words", "lost"), _draw_drop_outs, _drop_outs, effects=("none",), kind="sensor"),
        Family(
            "jet-spikes",
            ("constant", "growing"),
            _draw_spikes,
            nothing,
            {"spike": (0.0, -0.4, 1.5)},
            ("jets",),
            recorded=_spikes,
            effects=("jet-interaction",),
            kind="flight",
        ),
    ),
    "lacking": (
        Family("event", ("pulse", "held", "decaying"), _draw_event, _event, {"size": (0.0, -0.6, 1.0)}, ("popu",)),
        Family(
            "flux",
            ("constant", "shock-layer", "late"),
            _draw_flux,
            _flux,
            {"flux_W_m2": (0.0, 50.0, 60000.0)},
        ),
        Family(
            "lateral",
            ("insulation", "skin"),
            _draw_lateral,
            _lateral,
            {"G_W_m3K": (0.0, 1.0, 60000.0)},
            points=tuple(dict.fromkeys((*IN_DEPTH, *FELTS, "LOWER_MID", "WING_LOWER"))),
        ),
        Family(
            "junction",
            JUNCTIONS,
            _draw_junction,
            _junction,
            {"error_K": (0.0, 0.5, 150.0)},
            points=(*TILES, *FLAPS, *FELTS, "own-plug", "own-felt", "own-standoff"),
            effects=("sensor-bias",),
            kind="sensor",
        ),
    ),
}
"""Faults of the recorder, and causes that no library has, by class of record."""
