"""A control point drawn at random: wall, declared heating ratio, its true errors, thermocouples.

    r = r_table(x) (1 + scale) + sum d_v (v - v_0)      multilinear table, constant beyond its ends

The derivative errors are those of a tunnel table: some per cent in size, some tenths of a per cent per degree in slope.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.challenge.point import Ratio, material, times

FloatArray = NDArray[np.float64]
Generator = np.random.Generator

SLOPE_ERRORS = (0.003, 0.002, 0.02, 0.005, 0.002)
"""Standard deviation of the derivative errors as a share of the ratio, by variable."""

KINDS = ("lower", "elevon", "flap", "felt", "standoff", "metals")


@dataclass(frozen=True)
class Point:
    """Wall, ratio and sensors as a record declares them; `kind` is one of KINDS."""

    kind: str
    name: str
    stack: dict[str, Any]
    materials: dict[str, Any]
    sensors: list[dict[str, Any]]
    ratio: Ratio
    pressure: tuple[float, float, float]

    @property
    def depths_m(self) -> list[float]:
        """Depths of the sensors."""
        return [s["depth_m"] for s in self.sensors]

    def surface_pressure(self, columns: Mapping[str, FloatArray]) -> FloatArray:
        """p_inf + q (factor 2 sin^2(alpha + inclination + share of the elevon))."""
        factor, inclination, share = self.pressure
        angle = np.radians(np.maximum(columns["alpha_deg"] + inclination + share * columns["elevon_deg"], 1.0))
        q = 0.5 * columns["rho_kg_m3"] * columns["velocity_m_s"] ** 2
        return columns["p_inf_Pa"] + q * factor * 1.84 * np.sin(angle) ** 2


def _jittered(rng: Generator, vehicle: str, name: str) -> dict[str, Any]:
    """A material of the same class, a few per cent apart in every property."""
    properties = deepcopy(material(vehicle, name))
    properties["density_kg_m3"] = float(f"{properties['density_kg_m3'] * rng.normal(1.0, 0.02):.4g}")
    for key in ("specific_heat_J_kgK", "conductivity_W_mK"):
        properties[key] = times(properties[key], float(np.clip(rng.normal(1.0, 0.06), 0.8, 1.2)), 4)
    if "emissivity" in properties:
        factor = min(rng.normal(1.0, 0.02), 0.99 / max(v for _, v in properties["emissivity"]))
        properties["emissivity"] = times(properties["emissivity"], factor, 4)
    return properties


def _layers(rng: Generator, kind: str) -> list[tuple[str, str, str, float]]:
    """(vehicle, file, name in the record, thickness [m]) from outside inward."""
    o, c, mm = "orbiter", "capsule", 1e-3
    skin = (o, "al2024", "al2024", rng.uniform(1.5, 4.0) * mm)
    bond = (o, "rtv560", "rtv", 0.2 * mm)
    if kind in ("lower", "elevon", "flap"):
        coating = (o, "rcg", "rcg", rng.uniform(0.28, 0.5) * mm)
        tile = (o, "li900", "li900", rng.uniform(22.0, 65.0) * mm)
        return [coating, tile, bond, (o, "nomex-sip", "sip", rng.choice([2.3, 4.1]) * mm), bond, skin]
    if kind == "felt":
        felt = (o, "frsi-felt", "nomex-felt", rng.uniform(6.0, 15.0) * mm)
        return [(o, "frsi-coating", "dc92", rng.uniform(0.18, 0.5) * mm), felt, bond, skin]
    if kind == "standoff":
        outer = (c, "inconel-x", "inconel-x", rng.uniform(0.5, 1.2) * mm)
        fibre = (c, "alumina-fibre", "alumina-fibre", rng.uniform(12.0, 30.0) * mm)
        return [outer, fibre, (c, "ti-6al-4v", "ti-6al-4v", rng.uniform(1.0, 2.5) * mm)]
    outer = (c, "inconel-x", "inconel-x", rng.uniform(0.5, 1.5) * mm)
    return [outer, (c, "ti-6al-4v", "ti-6al-4v", rng.uniform(2.5, 6.0) * mm)]


SIZES = {"lower": (0.05, 0.14), "elevon": (0.07, 0.15), "flap": (0.05, 0.12), "felt": (0.004, 0.012),
         "standoff": (0.012, 0.045), "metals": (0.004, 0.015)}  # fmt: skip
"""Heating ratio over a sphere of 1 ft, by kind: limited by what its wall survives."""


def draw_point(rng: Generator, kind: str, sensors: int, means: FloatArray) -> Point:
    """A control point of a kind with a number of sensors, about the mean conditions (variable,) of the flight."""
    layers = _layers(rng, kind)
    materials = {name: _jittered(rng, vehicle, file) for vehicle, file, name, _ in layers}
    thickness = [float(f"{t:.3g}") for *_, t in layers]
    entries: list[dict[str, Any]] = [
        {"material": name, "thickness_m": t} for (_, _, name, _), t in zip(layers, thickness, strict=True)
    ]
    if kind == "metals":
        entries[0]["contact_m2K_W"] = float(rng.choice([0.0, 2e-5, 1e-4]))
    back: Any = "adiabatic"
    if rng.random() < 0.1:
        back = {"h_W_m2K": round(rng.uniform(0.5, 4.0), 2), "T_K": 290.0, "emissivity": 0.2}
    stack = {
        "surroundings_K": float(rng.choice([0.0, 0.0, 3.0, 200.0])),
        "initial": "uniform",
        "initial_K": round(rng.uniform(265.0, 312.0), 1),
        "back": back,
        "layer": entries,
    }
    name = f"{kind[:2].upper()}{rng.integers(100, 999)}"
    pressure = (float(rng.uniform(0.9, 1.05)) if kind != "felt" else 0.05, rng.uniform(-4.0, 4.0), 0.0)
    if kind == "elevon":
        pressure = (pressure[0], pressure[1], 1.0)
    found = _sensors(rng, name, kind, thickness, sensors)
    return Point(kind, name, stack, materials, found, _draw_ratio(rng, kind, means), pressure)


def _sensors(rng: Generator, name: str, kind: str, thickness: Sequence[float], count: int) -> list[dict[str, Any]]:
    """At the inner face of the coating, at the bondline, then in depth."""
    first = thickness[0]
    bond = sum(thickness[:-1]) if kind != "metals" else first + 0.9 * thickness[1]
    places = {"surface": first, "bond": bond} if count > 1 else {"surface": first}
    inner = max(count - 2, 0)
    shares = np.sort(rng.uniform(0.04, 0.85, 8))[:: max(8 // max(inner, 1), 1)][:inner]
    for i, share in enumerate(shares):
        places[f"depth{i + 1}"] = first + float(share) * thickness[1]
    ordered = sorted(places.items(), key=lambda item: item[1])
    sigma = float(np.exp(rng.uniform(np.log(0.3), np.log(3.0))))
    return [
        {
            "name": f"{name}_{label}",
            "column": f"{name}_{label}_K",
            "depth_m": float(f"{depth:.6g}") if label not in ("surface", "bond") else depth,
            "noise_sigma_K": round(float(np.clip(sigma * rng.uniform(0.7, 1.4), 0.3, 3.0)), 2),
            "used": True,
        }
        for label, depth in ordered
    ]


def _axes(rng: Generator, kind: str) -> tuple[FloatArray, ...]:
    alpha = np.array([float(a) for a in (20, 25, 30, 35, 40, 45, 50) if a in (20, 50) or rng.random() < 0.7])
    beta = np.array([0.0]) if rng.random() < 0.4 else np.array([-4.0, 0.0, 4.0])
    log_re = np.array([float(a) for a in (2.0, 4.5, 5.5, 6.0, 6.5, 7.0, 7.6) if a in (2.0, 7.6) or rng.random() < 0.7])
    elevon = np.array([-15.0, -5.0, 0.0, 5.0, 15.0]) if kind in ("elevon", "flap") else np.array([-12.0, 2.0, 12.0])
    flap = np.array([-5.0, 5.0, 12.0, 22.0]) if kind == "flap" or rng.random() < 0.5 else np.array([10.0])
    return alpha, beta, log_re, elevon, flap


def _draw_ratio(rng: Generator, kind: str, means: FloatArray) -> Ratio:
    """A smooth function of the five variables on its grid, and errors in size and slopes."""
    axes = _axes(rng, kind)
    a, b, re, e, f = np.meshgrid(*axes, indexing="ij")
    low, high = SIZES[kind]
    lower = kind in ("lower", "elevon", "flap")
    slope = rng.uniform(0.5, 1.5) if lower else rng.uniform(-0.5, 3.0)
    table = np.exp(rng.uniform(np.log(low), np.log(high))) * (np.sin(np.radians(a + 5.0)) / 0.707) ** slope
    table *= 10.0 ** (rng.normal(-0.03, 0.03) * (re - 6.0)) * (1.0 + rng.normal(0.0, 0.004) * b)
    strong = kind == "elevon"
    table *= 1.0 + (rng.uniform(0.01, 0.025) if strong else rng.normal(0.0, 0.003)) * e
    table *= 1.0 + (rng.uniform(0.005, 0.02) if kind == "flap" else rng.normal(0.0, 0.002)) * (f - 10.0)
    table *= 1.0 + rng.normal(0.0, 0.01, table.shape) if rng.random() < 0.3 else 1.0
    reference = np.array([round(float(m), 1) for m in means])
    r_0 = float(np.median(table))
    d = r_0 * np.array(SLOPE_ERRORS) * rng.normal(size=5)
    if rng.random() < 0.5:
        d[1] = 0.0
    scale = float(np.clip(rng.normal(0.0, 0.06), -0.15, 0.15))
    rounded = np.array([float(f"{v:.5g}") for v in table.ravel()]).reshape(table.shape)
    return Ratio(axes, rounded, None, round(scale, 5), np.array([float(f"{v:.4g}") for v in d]), reference)
