"""Temperatures of control points along a flight, and what a flight meant for each of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import RATIO_VARIABLES, Conditions
from sim_heating.base.errors import InputError
from sim_heating.base.kernels.block import FILM
from sim_heating.march.ensemble import Ensemble, histories
from sim_heating.march.mesh_choice import pack
from sim_heating.march.point import PointModel
from sim_heating.thermal.mesh import Mesh, refined


@dataclass(frozen=True)
class PointHistory:
    """One control point along a flight.

    time_s     : (time,) [s]
    surface_K, bondline_K : (time,) [K]
    sensors_K  : (sensor, time) temperature at each sensor [K], without what its recorder does
    ratio      : (time,) heating ratio with all corrections and effects [-]; NaN where h_ref is 0
    """

    name: str
    time_s: FloatArray
    surface_K: FloatArray
    bondline_K: FloatArray
    sensors_K: FloatArray
    ratio: FloatArray


@dataclass(frozen=True)
class Outside:
    """How a flight left the axes of a ratio table: in which variable, for how long, how far, and first when."""

    variable: str
    duration_s: float
    farthest: float
    first_s: float


def march_points(
    models: Sequence[PointModel],
    flights: Sequence[Conditions],
    *,
    extra_times_s: ArrayLike = (),
    longest_step_s: float = 1.0,
    halvings: int = 0,
) -> list[PointHistory]:
    """Temperatures of all points from the initial ones of their stacks, along their conditions.

    flights       : conditions of each point, on common times
    extra_times_s : times [s] within the flight to step to as well; the conditions are linear to them
    halvings      : how often every element of the meshes is halved: each takes the error of the mesh to a quarter
    raises        : RunError where a step did not converge
    """
    ensemble = pack(models, longest_step_s)
    if halvings > 0:
        ensemble = Ensemble(models, [finer(mesh, halvings) for mesh in ensemble.meshes], longest_step_s)
    time = np.union1d(flights[0].time_s, np.asarray(extra_times_s, dtype=float))
    flown = [f.at(time) for f in flights] if len(time) > len(flights[0]) else list(flights)
    film = np.array([place.scalar(FILM + 2) for place in ensemble.places])
    out = ensemble.march(time, histories(flown), keep=np.concatenate([ensemble.outputs(), film]))
    return _split(ensemble, time, out, flown)


def finer(mesh: Mesh, halvings: int) -> Mesh:
    """A mesh with every element halved so often."""
    for _ in range(halvings):
        mesh = refined(mesh)
    return mesh


def _split(ensemble: Ensemble, time: FloatArray, out: FloatArray, flown: Sequence[Conditions]) -> list[PointHistory]:
    points, column = [], 0
    first_film = out.shape[1] - len(ensemble.models)
    for i, model in enumerate(ensemble.models):
        count = 2 + len(model.depths_m)
        own = out[:, column : column + count].T
        h_ref = flown[i]["h_ref_kg_m2_s"]
        ratio = np.divide(out[:, first_film + i], h_ref, out=np.full(len(time), np.nan), where=h_ref > 0.0)
        points.append(PointHistory(model.name, time, own[0], own[1], own[2:], ratio))
        column += count
    return points


def at_times(history_s: FloatArray, values: FloatArray, time_s: FloatArray) -> FloatArray:
    """Values (..., time) at times that the history holds; NaN at times outside it."""
    place = np.clip(np.searchsorted(history_s, time_s), 0, len(history_s) - 1)
    inside = (time_s >= history_s[0]) & (time_s <= history_s[-1])
    if not np.allclose(history_s[place][inside], time_s[inside], rtol=0.0, atol=1e-9):
        raise InputError("temperatures: a time was asked for at which no step ended")
    return np.where(inside, values[..., place], np.nan)


def outside_table(model: PointModel, flown: Conditions) -> list[Outside]:
    """Where a flight left the point's ratio table, whose edge value held there; axes of one value have no outside."""
    if model.ratio is None:
        return []
    span = np.gradient(flown.time_s) if len(flown) > 1 else np.zeros(1)
    found = []
    for variable, axis in zip(RATIO_VARIABLES, model.ratio.axes, strict=True):
        x = flown[variable]
        beyond = np.maximum(axis[0] - x, x - axis[-1])
        out = beyond > 0.0
        if len(axis) > 1 and np.any(out):
            first = float(flown.time_s[out][0])
            found.append(Outside(variable, float(np.sum(span[out])), float(np.max(beyond)), first))
    return found


def negative_ratio_s(history: PointHistory) -> float:
    """How long the heating ratio was negative [s]; it is never clipped."""
    if len(history.time_s) < 2:
        return 0.0
    return float(np.sum(np.gradient(history.time_s)[history.ratio < 0.0]))


def peak(time_s: FloatArray, temperature_K: FloatArray) -> tuple[float, float]:
    """Highest temperature [K] and its time [s]."""
    i = int(np.argmax(temperature_K))
    return float(temperature_K[i]), float(time_s[i])


def summary_of(
    history: PointHistory, limits: Mapping[str, float | None], outside: Sequence[Outside]
) -> dict[str, object]:
    """Peaks, margins to the limits (positive is below), and what was odd, as a results file holds them."""
    surface, at_s = peak(history.time_s, history.surface_K)
    bondline, bond_at_s = peak(history.time_s, history.bondline_K)
    surface_limit, bondline_limit = limits.get("surface_K"), limits.get("bondline_K")
    return {
        "peak_surface_K": surface,
        "peak_surface_s": at_s,
        "surface_margin_K": None if surface_limit is None else surface_limit - surface,
        "peak_bondline_K": bondline,
        "peak_bondline_s": bond_at_s,
        "bondline_margin_K": None if bondline_limit is None else bondline_limit - bondline,
        "outside_table": [vars(o) for o in outside],
        "negative_ratio_s": negative_ratio_s(history),
    }
