"""Temperature histories of control points along a flight, their peaks and margins, and excursions from ratio tables."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import RATIO_VARIABLES, Conditions
from sim_heating.base.errors import InputError
from sim_heating.base.files.text import first_of
from sim_heating.base.kernels.lag import lag_columns
from sim_heating.heating.ratio.lookup import NODE_SLACK
from sim_heating.march.ensemble import Ensemble, histories
from sim_heating.march.mesh_choice import meshes_on_flights
from sim_heating.march.point import PointModel
from sim_heating.march.surface_heat import SurfaceHeat, surface_heat
from sim_heating.thermal.frame import STEP_TOLERANCE_K
from sim_heating.thermal.mesh import Mesh, halve_elements

HOT_STRUCTURE = 0.95
"""Ratio of bondline to surface peak from which a point is hot structure, which has no bondline."""
BAND_PROBABILITY = 0.95
"""Probability that a temperature lies within its band [-]."""


@dataclass(frozen=True)
class Band:
    """Where temperatures lie with a probability of 95 % at each time, by all that is uncertain.

    low_K, high_K : (channel, time) of surface, bondline and sensors in their order [K]
    sources       : standard deviation of the surface at its hottest time that comes from each source [K]
    """

    low_K: FloatArray
    high_K: FloatArray
    sources: Mapping[str, float]

    def columns(self, sensors: Sequence[str] = ()) -> dict[str, FloatArray]:
        """(time,) columns `surface_low_K`, `surface_high_K` and so on [K]; sensors : column of each, in their order.

        Quantiles of planning/bands.py, whose model error is docs/theory/model_error.md, equation 1.
        """
        names = [c.removesuffix("_K") for c in ("surface_K", "bondline_K", *sensors)]
        ends = (("low", self.low_K), ("high", self.high_K))
        return {f"{name}_{end}_K": T[i] for i, name in enumerate(names) for end, T in ends}


@dataclass(frozen=True)
class PointHistory:
    """Temperatures and heating ratio of one control point along a flight.

    time_s     : (time,) [s]
    surface_K, bondline_K : (time,) [K]; the bondline is the outer face of the last layer
    sensors_K  : (sensor, time) temperature of each thermocouple [K], behind its lag, without its errors, noise and
                 quantisation
    ratio      : (time,) heating ratio with all corrections and effects [-]; NaN where h_ref is 0
    heat       : heat fluxes at the surface [W/m2] and heat load [J/m2], at the same times
    nodes      : number of nodes of the mesh
    mesh_error_K : estimate of the largest error that the mesh leaves in a temperature [K]; None where a march on the
                   refined mesh did not converge
    band         : where the temperatures lie with 95 %; None where none was asked for
    """

    name: str
    time_s: FloatArray
    surface_K: FloatArray
    bondline_K: FloatArray
    sensors_K: FloatArray
    ratio: FloatArray
    heat: SurfaceHeat
    nodes: int
    mesh_error_K: float | None
    band: Band | None = None


@dataclass(frozen=True)
class TableExcursion:
    """Excursion of a flight beyond one axis of a ratio table, where the edge value is held.

    variable   : name of the axis
    duration_s : time spent outside [s]
    farthest   : largest distance beyond the axis, in the unit of the variable
    first_s    : time of the first sample outside [s]
    """

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
    tolerance_K: float = STEP_TOLERANCE_K,
    halvings: int = 0,
) -> list[PointHistory]:
    """Temperature histories of control points along their flights, from the initial temperatures of their stacks.

    models         : control points;  flights : flight conditions of each, on common times
    extra_times_s  : further times within the flight to step to [s]; conditions are linear to them
    longest_step_s : longest time step [s]
    tolerance_K    : largest error of a time step at any node [K]; a point divides its steps for it
    halvings       : how often every element of the chosen meshes is halved; each halving quarters the mesh error
    returns        : one history for each point, at the flight's times and the extra ones
    raises         : RunError where a step did not converge

    The heating ratio is recovered as film coefficient over h_ref, fluxes from the balance of the surface. Derived in
    docs/theory/equations_march.md, equations 1, 16 and 18.
    """
    chosen = meshes_on_flights(models, flights, longest_step_s)
    meshes = [halve_repeatedly(mesh, halvings) for mesh, _ in chosen]
    errors_K = [None if error is None else 0.25**halvings * error for _, error in chosen]
    ensemble = Ensemble(models, meshes, longest_step_s, tolerance_K=tolerance_K)
    time = np.union1d(flights[0].time_s, np.asarray(extra_times_s, dtype=float))
    # Interpolated only where a time was added: the samples themselves are taken as they are.
    flown = [f.at(time) for f in flights] if len(time) > len(flights[0]) else list(flights)
    keep = np.concatenate([ensemble.outputs(), ensemble.film_offsets(), *ensemble.heat_offsets()])
    out = ensemble.march(time, histories(flown), keep=keep)
    return _point_histories(ensemble, time, out, flown, errors_K)


def halve_repeatedly(mesh: Mesh, halvings: int) -> Mesh:
    """Mesh with every element halved `halvings` times; the error of second order [K] falls to a quarter each time.

    Derived in docs/theory/equations_march.md, equation 16.
    """
    for _ in range(halvings):
        mesh = halve_elements(mesh)
    return mesh


def _point_histories(
    ensemble: Ensemble,
    time: FloatArray,
    out: FloatArray,
    flown: Sequence[Conditions],
    mesh_errors_K: Sequence[float | None],
) -> list[PointHistory]:
    points, column = [], 0
    films, entering, leaving, surroundings = np.split(out[:, -4 * len(ensemble.models) :], 4, axis=1)
    for i, model in enumerate(ensemble.models):
        count = 2 + len(model.depths_m)
        of_point = out[:, column : column + count].T
        h_ref = flown[i]["h_ref_kg_m2_s"]
        ratio = np.divide(films[:, i], h_ref, out=np.full(len(time), np.nan), where=h_ref > 0.0)
        sensed, nodes = sensed_temperatures(model, time, of_point[2:]), ensemble.meshes[i].nodes
        heat = surface_heat(model, flown[i], of_point[0], entering[:, i], leaving[:, i], surroundings[:, i])
        points.append(
            PointHistory(model.name, time, of_point[0], of_point[1], sensed, ratio, heat, nodes, mesh_errors_K[i])
        )
        column += count
    return points


def sensed_temperatures(model: PointModel, time: FloatArray, temperature_K: FloatArray) -> FloatArray:
    """(sensor, time) temperatures of the thermocouples [K], which start at that of their places.

    temperature_K : (sensor, time) at their places [K]

    Derived in docs/theory/equations_march.md, equation 18.
    """
    if not any(model.lags_s):
        return temperature_K
    sensors = zip(temperature_K, model.lags_s, strict=True)
    return np.array([lag_columns(time, T[:, np.newaxis], tau, True)[:, 0] for T, tau in sensors])


def values_at(history_s: FloatArray, values: FloatArray, time_s: FloatArray) -> FloatArray:
    """Values of a history at given times that it contains; nothing is interpolated.

    history_s : (step,) times of the history [s];  values : (..., step), temperatures [K] for instance
    time_s    : (time,) times to read [s]
    returns   : (..., time), NaN at times outside the history
    raises    : InputError for a time inside the history that is more than 1e-9 s before the next of its times

    Every sample time is an end of a step: docs/theory/equations_march.md, equation 2.
    """
    index = np.clip(np.searchsorted(history_s, time_s), 0, len(history_s) - 1)
    inside = (time_s >= history_s[0]) & (time_s <= history_s[-1])
    if not np.allclose(history_s[index][inside], time_s[inside], rtol=0.0, atol=1e-9):
        raise InputError("temperatures: no step ended at one of the times; use sample times of the march")
    return np.where(inside, values[..., index], np.nan)


def table_excursions(model: PointModel, flown: Conditions) -> list[TableExcursion]:
    """Excursions of a flight beyond the axes of a point's ratio table, one for each axis that it left.

    flown   : conditions of the flight
    returns : variable, duration [s], largest distance in the unit of the variable, time of the first [s]; no entry for
              a point without a table. Off an axis of a single value is more than NODE_SLACK from it

    Derived in docs/theory/equations_march.md, equations 19 and 20.
    """
    if model.ratio is None or model.ratio.ratio.size == 1:  # a constant has no outside
        return []
    span = flown.duration_s if len(flown) > 1 else np.zeros(1)
    excursions = []
    for variable, axis in zip(RATIO_VARIABLES, model.ratio.axes, strict=True):
        x = flown[variable]
        beyond = np.maximum(axis[0] - x, x - axis[-1])
        out = beyond > (NODE_SLACK if len(axis) == 1 else 0.0)
        if np.any(out):
            first = float(flown.time_s[out][0])
            excursions.append(TableExcursion(variable, float(np.sum(span[out])), float(np.max(beyond)), first))
    return excursions


def negative_ratio_s(history: PointHistory) -> float:
    """Time during which the heating ratio was negative [s]; it is reported and never clipped.

    history : times [s] and heating ratio [-] of a point

    Samples where h_ref is 0 have no ratio and do not count. Derived in docs/theory/equations_march.md, equation 19.
    """
    if len(history.time_s) < 2:
        return 0.0
    return float(np.sum(np.gradient(history.time_s)[history.ratio < 0.0]))


def peak(time_s: FloatArray, values: FloatArray) -> tuple[float, float]:
    """Highest value of a history, a temperature [K] for instance, and the time when it first occurs [s].

    time_s, values : (time,) [s], [K] or [W/m2]

    The maximum is that of docs/theory/equations_march.md, equation 21.
    """
    i = int(np.argmax(values))
    return float(values[i]), float(time_s[i])


def point_summary(
    history: PointHistory, limits: Mapping[str, float | None], outside: Sequence[TableExcursion]
) -> dict[str, object]:
    """Peaks, margins to the temperature limits and excursions of one control point, as a results file contains them.

    history : temperatures of the point [K]
    limits  : `surface_K` and `bondline_K`, limits [K]; a limit that is None or absent has no margin
    outside : excursions beyond the ratio table
    returns : peaks [K], [W/m2] and their times [s], limits and margins limit minus peak [K], positive below the limit,
              heat load [J/m2], excursions, time of negative ratio [s], and whether a bondline with a limit still rises

    Derived in docs/theory/equations_march.md, equations 19 to 21.
    """
    surface, at_s = peak(history.time_s, history.surface_K)
    bondline, bond_at_s = peak(history.time_s, history.bondline_K)
    surface_limit, bondline_limit = limits.get("surface_K"), limits.get("bondline_K")
    flux, flux_at_s = peak(history.time_s, history.heat.convected_W_m2)
    return {
        "peak_surface_K": surface,
        "peak_surface_s": at_s,
        "surface_margin_K": None if surface_limit is None else surface_limit - surface,
        "peak_bondline_K": bondline,
        "peak_bondline_s": bond_at_s,
        "bondline_rises": bool(
            bondline_limit is not None
            and bond_at_s == history.time_s[-1]
            and history.bondline_K[-1] > history.bondline_K[0]
        ),
        "bondline_margin_K": None if bondline_limit is None else bondline_limit - bondline,
        "surface_limit_K": surface_limit,
        "bondline_limit_K": bondline_limit,
        "peak_convected_W_m2": flux,
        "peak_convected_s": flux_at_s,
        "heat_load_J_m2": float(history.heat.heat_load_J_m2[-1]),
        "outside_table": [vars(o) for o in outside],
        "negative_ratio_s": negative_ratio_s(history),
        "nodes": history.nodes,
        "mesh_error_K": history.mesh_error_K,
        **_summary_of_band(history, surface_limit, bondline_limit),
    }


def _summary_of_band(history: PointHistory, *limits: float | None) -> dict[str, object]:
    """Highest temperatures of the 95 % band, margins to the limits at them, and sources; nothing without a band."""
    if history.band is None:
        return {}
    found: dict[str, object] = {}
    for name, high, limit in zip(("surface", "bondline"), history.band.high_K, limits, strict=False):
        found[f"peak_{name}_high_K"] = float(np.max(high))
        found[f"{name}_margin_at_band_K"] = None if limit is None else limit - float(np.max(high))
    return {"band": {**found, "sources_K": dict(history.band.sources)}}


def is_hot_structure(peak_surface_K: float, peak_bondline_K: float) -> bool:
    """Whether what lies under the outer layers gets nearly as hot as the surface [K]."""
    return peak_bondline_K >= HOT_STRUCTURE * peak_surface_K


def range_lines(points: Mapping[str, Mapping[str, Any]], shown: int | None = None) -> list[str]:
    """Heating ratios [-] below 0, and variables that lay outside ratio tables: a line each, with all points of it.

    points : `point_summary`, or that of a prediction, by name;  shown : how many points a line names; None for all
    """
    negative = {n: p["negative_ratio_s"] for n, p in points.items() if p["negative_ratio_s"] > 0.0}
    lines = []
    if negative:
        longest = f"{'up to ' if len(negative) > 1 else ''}{max(negative.values()):.0f} s"
        lines.append(f"The heating ratio of {first_of(list(negative), shown)} was negative for {longest}")
    for variable, by_name in _outside_tables(points).items():
        longest_s, farthest = (max(o[key] for o in by_name.values()) for key in ("duration_s", "farthest"))
        unit = " deg" if variable.endswith("_deg") else ""
        lines.append(
            f"{variable} lay outside the ratio tables of {first_of(list(by_name), shown)}, up to {longest_s:.0f} s and "
            f"{farthest:.3g}{unit} beyond; the edge value was held (details in summary.json)"
        )
    return lines


def _outside_tables(points: Mapping[str, Mapping[str, Any]]) -> dict[str, dict[str, Mapping[str, Any]]]:
    """Variable -> point -> how far and how long it lay outside the point's ratio table."""
    outside: dict[str, dict[str, Mapping[str, Any]]] = {}
    for name, point in points.items():
        for o in point["outside_table"]:
            outside.setdefault(o["variable"], {})[name] = o
    return outside


def rising_bondlines(points: Mapping[str, Mapping[str, Any]], shown: int | None = None) -> list[str]:
    """A line that names the points whose bondline [K] is hottest at the end of a flight, if there are any.

    points : `point_summary` by name;  shown : how many points it names; None for all

    Heat soaks on into a structure after a flight, so that the margin of such a bondline is no bound.
    """
    rising = [name for name, p in points.items() if p["bondline_rises"]]
    if not rising:
        return []
    return [
        f"The bondline of {first_of(rising, shown)} still rises at the end, and its margin is that so far: end the "
        "flight later (`[trajectory.stop]`), or `plan` with `soak_s`"
    ]
