"""A flight over a control point, and the readings of its thermocouples with the effects of deviation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.challenge.deviation import HOT_K, NOTHING, Deviation
from benchmarks.challenge.point import VARIABLES
from benchmarks.generator.conduction import STEP_S, Forcing, build_wall, march, wall_enthalpy
from benchmarks.generator.flight import Flight, draw_flight
from benchmarks.generator.point import Point, draw_point
from sim_heating.base.conditions import Conditions
from sim_heating.heating.reference.models import reference_heating

FloatArray = NDArray[np.float64]
Generator = np.random.Generator

NOSE_RADIUS_M = 0.3048
FORMATS = {
    "time_s": ".2f", "altitude_m": ".1f", "velocity_m_s": ".2f", "mach": ".3f", "alpha_deg": ".4f", "beta_deg": ".4f",
    "log10_re": ".5f", "elevon_deg": ".4f", "bodyflap_deg": ".4f", "rho_kg_m3": ".6g", "T_inf_K": ".2f",
    "p_inf_Pa": ".6g", "p_surface_Pa": ".6g", "h_ref_kg_m2_s": ".7g", "H_r_J_kg": ".7g", "jets": ".3f",
    "axial_accel_g": ".4f",
}  # fmt: skip
"""Digits of conditions.csv; the truth is heated with the numbers in the file."""


@dataclass(frozen=True)
class Case:
    """A record's declaration, and its conditions on the steps of the march.

    recorded : columns of conditions.csv as in the file
    fine     : the same and h_ref, H_r every STEP_S, linear between the samples
    x        : (variable, time) of the heating ratio
    """

    flight: Flight
    point: Point
    heating: dict[str, Any]
    recorded: dict[str, FloatArray]
    fine: dict[str, FloatArray]
    x: FloatArray
    H_w: FloatArray

    @property
    def time_s(self) -> FloatArray:
        """(time,) steps of the march."""
        return self.fine["time_s"]

    @cached_property
    def hot(self) -> NDArray[np.bool_]:
        """(time,) where the reference heating is above a fifth of its peak."""
        q = self.fine["h_ref_kg_m2_s"] * self.fine["H_r_J_kg"]
        return np.asarray(q > 0.2 * np.max(q))

    @cached_property
    def r_0(self) -> float:
        """Mean declared ratio while it is hot."""
        return float(np.mean(self.point.ratio.declared(self.x)[self.hot]))

    def ratio(self, deviation: Deviation, scale: float, d: FloatArray) -> FloatArray:
        """(time,) the true heating ratio."""
        return (self.point.ratio.true(self.x, scale, d) + deviation.add) * deviation.multiply

    def temperatures(
        self,
        deviation: Deviation = NOTHING,
        scale: float | None = None,
        d: FloatArray | None = None,
        refine: float = 1.0,
    ) -> FloatArray:
        """(time, surface | sensors) temperatures [K] without sensor errors; the true scale and slopes unless given."""
        ratio = self.point.ratio
        r = self.ratio(deviation, ratio.scale if scale is None else scale, ratio.d if d is None else d)
        stack, materials = deviation.of_wall(self.point.stack, self.point.materials)
        thicker = stack["layer"][0]["thickness_m"] - self.point.stack["layer"][0]["thickness_m"]
        depths = [depth + thicker for depth in self.point.depths_m]
        wall = build_wall(stack, materials, depths, deviation.back, refine)
        centres, dx = wall.centres_m, wall.dx_m
        n = len(self.time_s)
        weights, share, diverted = deviation.deposit or (lambda z: 0.0 * z, 0.0, 0.0)
        deposit = weights(centres) * dx
        content, moisture = deviation.water or (lambda z: 0.0 * z, np.array([0.0, 0.0, 1.0, 1.0, 0.0]))
        forcing = Forcing(
            film=r * self.fine["h_ref_kg_m2_s"],
            H_r=self.fine["H_r_J_kg"],
            p=self.fine["p_surface_Pa"],
            eps_factor=np.broadcast_to(np.asarray(deviation.eps_factor, dtype=float), n).copy(),
            hot=np.broadcast_to(np.asarray(deviation.hot, dtype=float), len(HOT_K)).copy(),
            deposit=deposit / max(float(np.sum(deposit)), 1e-30),
            deposited=share,
            diverted=diverted,
            water=np.asarray(content(centres), dtype=float),
            moisture=moisture,
        )
        faces = [wall.face(depth) for depth in depths]
        return march(wall, forcing, self.H_w, self.point.stack["initial_K"], faces)

    def indicated(self, at_s: FloatArray, deviation: Deviation = NOTHING, **errors: Any) -> FloatArray:
        """(sample, sensor) readings [K] before noise: clock, bias and gain applied."""
        T = self.temperatures(deviation, **errors)[:, 1:]
        skew = np.interp(
            at_s, self.time_s, np.broadcast_to(np.asarray(deviation.skew_s, dtype=float), len(self.time_s))
        )
        read = np.column_stack([np.interp(at_s - skew, self.time_s, T[:, i]) for i in range(T.shape[1])])
        for change in deviation.read:
            read = change(at_s, read)
        return read


def draw_case(rng: Generator, kind: str, sensors: int, manoeuvres: Sequence[str]) -> Case:
    """A random flight over a random control point of this kind."""
    flight = draw_flight(rng, manoeuvres)
    columns = flight.columns
    warm = (columns["velocity_m_s"] < 7300.0) & (columns["time_s"] > 300.0)
    means = np.array([np.mean(columns[v][warm]) for v in VARIABLES])
    point = draw_point(rng, kind, sensors, means)
    every = int(rng.choice([10, 10, 10, 5, 2]))
    state = {name: values[::every] for name, values in columns.items()}
    state["p_surface_Pa"] = point.surface_pressure(state)
    recorded = _as_written(state)
    named = str(rng.choice(["columns", "sutton-graves", "detra-kemp-riddell", "fay-riddell"], p=[0.7, 0.1, 0.1, 0.1]))
    model = "fay-riddell" if named == "columns" and rng.random() < 0.3 else "sutton-graves"
    of = model if named == "columns" else named
    # Thin air is bridged at the point, whose ratio is that of the table.
    r = point.ratio.declared(np.array([recorded[v] for v in VARIABLES]))
    h_ref, H_r, _ = reference_heating(of, Conditions(recorded), nose_radius_m=NOSE_RADIUS_M, ratio=r)
    reference = {"h_ref_kg_m2_s": h_ref, "H_r_J_kg": H_r}
    if named == "columns":
        reference = _as_written(reference)
        recorded |= reference
    declared: Any = {"cp_J_kgK": 1004.5} if rng.random() < 0.6 else "equilibrium-air"
    heating = {
        "reference": named,
        "nose_radius_m": NOSE_RADIUS_M,
        "wall_enthalpy": declared,
        "ratio_table": "ratio_table.csv",
    }
    if rng.random() < 0.5 and "jets" not in [kind for kind, *_ in flight.manoeuvres]:
        recorded.pop("jets")
    if rng.random() < 0.4:
        recorded.pop("axial_accel_g")
    last = recorded["time_s"][-1]
    time = np.round(np.arange(round(last / STEP_S) + 1) * STEP_S, 1)
    fine = {name: np.interp(time, recorded["time_s"], values) for name, values in (recorded | reference).items()}
    x = np.array([fine[v] for v in VARIABLES])
    return Case(flight, point, heating, recorded, fine, x, wall_enthalpy(declared))


def _as_written(columns: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
    """Columns with the digits that the file will have."""
    return {name: np.array([float(format(v, FORMATS[name])) for v in values]) for name, values in columns.items()}
