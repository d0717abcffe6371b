"""A control point of the Orbiter, or a wall of our own, as a record declares it; and its true errors.

r = r_table(x) (1 + scale) + sum d_v (v - v_0)      multilinear table, constant beyond its ends
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RegularGridInterpolator

from benchmarks.challenge.files import AIRCRAFT, nodes_of, read_csv, read_toml

FloatArray = NDArray[np.float64]
Generator = np.random.Generator

VARIABLES = ("alpha_deg", "beta_deg", "log10_re", "elevon_deg", "bodyflap_deg")
DERIVATIVES = ("d_alpha", "d_beta", "d_logre", "d_elevon", "d_bodyflap")
SLOPES = (0.003, 0.002, 0.02, 0.004, 0.002)
"""Standard deviation of the errors in slope as a share of the ratio [1/deg, 1/deg, 1, 1/deg, 1/deg]."""
SCALE = 0.07
LEAST_SIGMA = 0.15
"""Sigma of a table over its ratio below which errors in slope are as much smaller, to stay within it."""
TILES = ("V09T9527", "LOWER_FWD", "LOWER_MID", "LOWER_AFT", "WING_LOWER", "STS96_468", "STS96_480", "STS96_597")
FLAPS = ("V07T9730", "BODYFLAP", "STS96_730")
FELTS = ("V07T9975", "V07T9976", "LEE_UPPER", "LEE_FUSELAGE")
OWN = ("own-plug", "own-felt", "own-standoff", "own-plate")
POINTS = (*TILES, *FLAPS, *FELTS, *OWN)
IN_DEPTH = ("V09T9527", "own-plug", "own-felt", "own-standoff")
"""Points with three thermocouples or more."""


@dataclass(frozen=True)
class Ratio:
    """A declared table and its true errors about a reference condition.

    axes, table, sigma : as in ratio_table.csv; a table may state no sigma
    scale, d           : errors of the table's size [1] and slopes [1/deg, 1/deg, 1, 1/deg, 1/deg]
    """

    axes: Sequence[FloatArray]
    table: FloatArray
    sigma: FloatArray | None
    scale: float
    d: FloatArray
    reference: FloatArray

    def declared(self, x: FloatArray) -> FloatArray:
        """(time,) tabulated ratio at (variable, time)."""
        many = [i for i, axis in enumerate(self.axes) if len(axis) > 1]
        inside = np.array([np.clip(x[i], self.axes[i][0], self.axes[i][-1]) for i in many]).T
        return np.asarray(RegularGridInterpolator([self.axes[i] for i in many], self.table.squeeze())(inside))

    @property
    def columns(self) -> dict[str, FloatArray]:
        """The columns of ratio_table.csv."""
        grid = np.meshgrid(*self.axes, indexing="ij")
        found = {v: g.ravel() for v, g in zip(VARIABLES, grid, strict=True)} | {"ratio": self.table.ravel()}
        return found if self.sigma is None else found | {"sigma": self.sigma.ravel()}

    def true(self, x: FloatArray, scale: float, d: FloatArray, declared: FloatArray | None = None) -> FloatArray:
        """(time,) the linear heating model at (variable, time); `declared` where the tabulated ratio is at hand."""
        declared = self.declared(x) if declared is None else declared
        return declared * (1.0 + scale) + d @ (x - self.reference[:, np.newaxis])


@dataclass(frozen=True)
class Point:
    """Wall, thermocouples and surface pressure as declared.

    pressure : "newtonian" with inclination, share of elevon and of body flap [deg]; or "fraction" of the stagnation's
    """

    name: str
    stack: dict[str, Any]
    materials: dict[str, Any]
    sensors: list[dict[str, Any]]
    pressure: tuple[str, float, float, float]

    @property
    def depths_m(self) -> list[float]:
        """Depths of the thermocouples."""
        return [s["depth_m"] for s in self.sensors]

    def surface_pressure(self, state: Mapping[str, FloatArray]) -> FloatArray:
        """(time,) [Pa]"""
        q = 0.5 * state["rho_kg_m3"] * state["velocity_m_s"] ** 2
        model, first, elevon, flap = self.pressure
        if model == "fraction":
            return np.asarray(state["p_inf_Pa"] + first * 1.84 * q)
        angle = state["alpha_deg"] + first + elevon * state["elevon_deg"] + flap * state["bodyflap_deg"]
        return np.asarray(state["p_inf_Pa"] + 1.84 * q * np.sin(np.radians(np.maximum(angle, 1.0))) ** 2)


@cache
def material(vehicle: str, name: str) -> dict[str, Any]:
    """Properties of a material's file."""
    declared = read_toml(AIRCRAFT / vehicle / "materials" / f"{name}.toml")
    found = deepcopy(material(vehicle, declared["based_on"])) if "based_on" in declared else {}
    for key in ("density_kg_m3", "emissivity", "specific_heat_J_kgK", "conductivity_W_mK"):
        if key in declared:
            found[key] = declared[key]
        if factor := declared.get(key.rpartition("_W_")[0] + "_factor" if "_W_" in key else ""):
            found[key] = times(found[key], factor)
    return found


def times(table: Any, factor: float, digits: int = 5) -> Any:
    """A property table, [[T_K, value], ...] or { p_Pa, T_K, k }, times a factor."""
    if isinstance(table, Mapping):
        return {**table, "k": [[float(f"{factor * v:.{digits}g}") for v in row] for row in table["k"]]}
    return [[T, float(f"{factor * v:.{digits}g}")] for T, v in table]


def draw_point(rng: Generator, name: str) -> Point:
    """A control point by name: thickness of the insulation within 8 %, fewer thermocouples now and then."""
    if name in OWN:
        return _own(rng, name)
    declared = read_toml(AIRCRAFT / "orbiter" / "control_points" / f"{name}.toml")
    stack, sensors = deepcopy(declared["stack"]), deepcopy(declared["sensor"])
    for i, s in enumerate(sensors):
        s.pop("rate_hz", None)
        if i and s["depth_m"] > stack["layer"][0]["thickness_m"] + stack["layer"][1]["thickness_m"] - 1e-9:
            s["at_back"] = True
    grown = float(f"{stack['layer'][1]['thickness_m'] * rng.uniform(0.92, 1.08):.4g}")
    for s in sensors:
        if s.pop("at_back", False):
            s["depth_m"] = float(f"{s['depth_m'] + grown - stack['layer'][1]['thickness_m']:.8g}")
    stack["layer"][1]["thickness_m"] = grown
    sensors = [s for s in sensors if s["depth_m"] <= sum(e["thickness_m"] for e in stack["layer"])]
    model = declared["pressure"]
    pressure = (
        ("fraction", model["fraction"], 0.0, 0.0)
        if "fraction" in model
        else (
            "newtonian",
            model.get("inclination_deg", 0.0),
            model.get("elevon_factor", 0.0),
            model.get("bodyflap_factor", 0.0),
        )
    )
    names = {e["material"] for e in stack["layer"]}
    return Point(name, stack, {n: deepcopy(material("orbiter", n)) for n in sorted(names)}, sensors, pressure)


def _own(rng: Generator, name: str) -> Point:
    """Walls that the vehicle does not have: a plug with four thermocouples, felt, metal over fibre, two plates."""
    u = rng.uniform
    layers = {
        "own-plug": [
            ("orbiter", "rcg", u(2.6e-4, 5e-4)),
            ("orbiter", "li2200", u(0.03, 0.06)),
            ("orbiter", "rtv560", 1.9e-4),
            ("orbiter", "al2024", u(1.5e-3, 3e-3)),
        ],
        "own-felt": [
            ("orbiter", "frsi-coating", u(1.5e-4, 3e-4)),
            ("orbiter", "frsi-felt", u(0.008, 0.014)),
            ("orbiter", "rtv560", 1.9e-4),
            ("orbiter", "al2024", u(1.5e-3, 3e-3)),
        ],
        "own-standoff": [
            ("capsule", "inconel-x", u(5e-4, 1e-3)),
            ("capsule", "alumina-fibre", u(0.015, 0.03)),
            ("capsule", "ti-6al-4v", u(1e-3, 2.5e-3)),
        ],
        "own-plate": [("capsule", "inconel-x", u(6e-4, 1.4e-3)), ("capsule", "ti-6al-4v", u(2.5e-3, 5e-3))],
    }[name]
    thickness = [float(f"{t:.4g}") for *_, t in layers]
    faces = np.concatenate(([0.0], np.cumsum(thickness)))
    shares = {"own-plug": [0.1, 0.35], "own-felt": [0.25, 0.6], "own-standoff": [0.2, 0.6], "own-plate": []}[name]
    depths = [thickness[0], *(thickness[0] + s * thickness[1] for s in shares), float(faces[-2])]
    if name == "own-plate":
        depths = [0.0, thickness[0]]
    tops = {
        "own-plug": (1533.0, 1366.0, 1089.0, 477.0),
        "own-felt": (811.0, 700.0, 600.0, 477.0),
        "own-standoff": (1366.0, 1200.0, 866.0, 700.0),
        "own-plate": (1089.0, 1089.0),
    }[name]
    sensors = [
        {
            "name": f"{name}-{i + 1}",
            "column": f"T{i + 1}_K",
            "depth_m": float(f"{depth:.8g}"),
            "noise_sigma_K": 1.0,
            "bits": 8,
            "range_K": [255.0, top],
        }
        for i, (depth, top) in enumerate(zip(depths, tops, strict=True))
    ]
    stack: dict[str, Any] = {
        "surroundings_K": 0.0,
        "initial": "uniform",
        "initial_K": round(float(u(278.0, 302.0)), 1),
        "back": "adiabatic",
        "layer": [{"material": n, "thickness_m": t} for (_, n, _), t in zip(layers, thickness, strict=True)],
    }
    if name == "own-plate" and rng.random() < 0.5:
        stack["layer"][0]["contact_m2K_W"] = float(f"{u(1e-4, 6e-4):.3g}")
    inclination = {"own-plug": 0.0, "own-felt": 0.01, "own-standoff": -15.0, "own-plate": 0.01}[name]
    pressure = ("fraction" if inclination == 0.01 else "newtonian", inclination, 0.0, 0.0)
    return Point(name, stack, {n: deepcopy(material(v, n)) for v, n, _ in layers}, sensors, pressure)


def draw_ratio(
    rng: Generator, name: str, reference: FloatArray, wide: bool = False, share: float | None = None
) -> Ratio:
    """The declared table of a point and its errors, within its sigma; `wide`: close to it.

    share : sigma over the ratio, in place of the declared one
    """
    if name in OWN:
        axes, table = _own_table(rng, name)
        sigma = 0.15 * table
    else:
        columns = read_csv(AIRCRAFT / "orbiter" / "ratio_tables" / f"{name}.csv")
        axes, table = nodes_of(columns, VARIABLES, "ratio")
        sigma = nodes_of(columns, VARIABLES, "sigma")[1]
    if share is not None:
        sigma = share * table
    middle = tuple(int(np.argmin(np.abs(axis - x))) for axis, x in zip(axes, reference, strict=True))
    r, relative = float(table[middle]), float(sigma[middle] / table[middle])
    spread = min(0.5 * relative, SCALE) * (2.0 if wide else 1.0)
    scale = float(np.clip(rng.normal(0.0, spread), -2.0 * spread, 2.0 * spread))
    size = min(relative / LEAST_SIGMA, 1.0) * (1.8 if wide else 1.0)
    d = r * np.array(SLOPES) * size * np.clip(rng.normal(size=5), -2.0, 2.0)
    # on an axis with one node a table states that the ratio does not depend on the variable
    d *= [len(axis) > 1 for axis in axes]
    digits = np.array([float(f"{v:.4g}") for v in d])
    return Ratio(axes, table, np.maximum(sigma, 1e-5), round(scale, 5), digits, reference)


def _own_table(rng: Generator, name: str) -> tuple[list[FloatArray], FloatArray]:
    axes = [
        np.array(a, dtype=float)
        for a in ([10, 25, 35, 40, 45, 50], [-4, 0, 4], [2, 5.5, 6.2, 6.8, 7.4, 8.2], [-20, 0, 15], [-11.7, 5, 22.5])
    ]
    a, b, re, e, f = np.meshgrid(*axes, indexing="ij")
    size = {
        "own-plug": (0.07, 0.13),
        "own-felt": (0.006, 0.012),
        "own-standoff": (0.02, 0.05),
        "own-plate": (0.005, 0.011),
    }[name]
    table = rng.uniform(*size) * (np.sin(np.radians(a + 4.0)) / np.sin(np.radians(44.0))) ** rng.uniform(0.4, 1.6)
    table *= 1.0 - rng.uniform(0.0, 0.04) * (re - 6.0)
    table *= (1.0 + 0.003 * rng.normal() * b) * (1.0 + 0.004 * rng.normal() * e) * (1.0 + 0.003 * rng.normal() * f)
    return axes, np.array([float(f"{v:.5g}") for v in table.ravel()]).reshape(table.shape)
