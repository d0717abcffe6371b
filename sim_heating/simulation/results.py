"""Results of runs and predictions: tables for a person, CSV, and one self-describing NetCDF file.

NetCDF (through xarray) because time histories of many points and sensors share their axes, carry units and long
names, and are opened by MATLAB, Julia, Panoply, ncdump and spreadsheets with a plug-in; a table format would repeat
or split them.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import Conditions
from sim_heating.base.files import provenance_attributes, write_csv
from sim_heating.base.files.package import package_version
from sim_heating.base.report.table import Column, Table
from sim_heating.march.history import BAND_PROBABILITY, PointHistory, is_hot_structure
from sim_heating.thermal.stack import Sensor

if TYPE_CHECKING:
    import xarray as xr

UNITS = {
    "time_s": "s", "altitude_m": "m", "velocity_m_s": "m s-1", "mach": "1", "alpha_deg": "degree", "beta_deg": "degree",
    "log10_re": "1", "elevon_deg": "degree", "bodyflap_deg": "degree", "rho_kg_m3": "kg m-3", "T_inf_K": "K",
    "p_inf_Pa": "Pa", "p_surface_Pa": "Pa", "h_ref_kg_m2_s": "kg m-2 s-1", "H_r_J_kg": "J kg-1", "q_add_W_m2": "W m-2",
    "jets": "1", "bank_deg": "degree", "gamma_deg": "degree", "heading_deg": "degree", "latitude_deg": "degree_north",
    "longitude_deg": "degree_east", "qbar_Pa": "Pa", "axial_accel_g": "1", "convected_W_m2": "W m-2",
    "radiated_W_m2": "W m-2", "conducted_W_m2": "W m-2", "added_W_m2": "W m-2", "back_W_m2": "W m-2",
    "heat_load_J_m2": "J m-2",
}  # fmt: skip
"""Units of conditions and fluxes in the spelling of the CF conventions."""

TIME_ATTRIBUTES = {"units": "s", "standard_name": "time", "long_name": "time from the start of the flight"}
LONG_NAMES = {
    "altitude_m": "geometric altitude",
    "velocity_m_s": "speed relative to the air",
    "mach": "speed over the local speed of sound",
    "alpha_deg": "angle of attack",
    "beta_deg": "angle of sideslip",
    "log10_re": "base-10 logarithm of the Reynolds number on the reference length",
    "elevon_deg": "elevon deflection, positive trailing edge down",
    "bodyflap_deg": "body flap deflection, positive trailing edge down",
    "rho_kg_m3": "density of the free stream",
    "T_inf_K": "temperature of the free stream",
    "p_inf_Pa": "pressure of the free stream",
    "h_ref_kg_m2_s": "reference film coefficient, enthalpy based",
    "H_r_J_kg": "recovery enthalpy",
    "q_add_W_m2": "known additional absorbed heat flux",
    "jets": "firing of reaction jets, 0 to 1",
    "bank_deg": "bank angle about the velocity",
    "gamma_deg": "flight-path angle above the horizon",
    "heading_deg": "azimuth of the velocity",
    "latitude_deg": "geodetic latitude",
    "longitude_deg": "longitude, positive east",
    "qbar_Pa": "dynamic pressure",
    "axial_accel_g": "acceleration along the body axis over that of gravity",
    "surface_K": "temperature of the outer surface",
    "bondline_K": "temperature at the outer face of the last layer",
    "ratio": "heating ratio with all corrections and effects",
    "convected_W_m2": "convected heat flux into the surface, r h_ref (H_r - H_w)",
    "radiated_W_m2": "heat flux that the surface radiates",
    "conducted_W_m2": "heat flux conducted from the surface into the wall",
    "added_W_m2": "known additional heat flux into the surface",
    "back_W_m2": "heat flux that leaves at the back face",
    "heat_load_J_m2": "time integral of the convected heat flux",
    "surface_limit_K": "limit of the surface temperature",
    "bondline_limit_K": "limit of the bondline temperature",
    "surface_margin_K": "limit of the surface temperature less that temperature",
    "bondline_margin_K": "limit of the bondline temperature less that temperature",
    "sensor_K": "temperature of the sensor, behind its lag, without noise and quantisation",
    "p_surface_Pa": "pressure at the surface of the control point",
    **{
        f"{name}_{end}_K": f"{word} end of the 95 % band of the temperature of the {name}"
        for name in ("surface", "bondline", "sensor")
        for end, word in (("low", "lower"), ("high", "upper"))
    },
}


def write_temperatures_csv(path: Path, time_s: FloatArray, history: PointHistory, sensors: Sequence[Sensor]) -> None:
    """Write temperatures.csv of one control point: time_s, surface_K, bondline_K, then one column a sensor; then the
    ends of the 95 % band of each, where there is one."""
    columns = {"time_s": time_s, "surface_K": history.surface_K, "bondline_K": history.bondline_K}
    columns |= {s.column: values for s, values in zip(sensors, history.sensors_K, strict=True)}
    columns |= {} if history.band is None else history.band.columns([s.column for s in sensors])
    write_csv(path, columns, {"time_s": ".10g"} | {name: ".4f" for name in columns if name != "time_s"})


def write_heating_csv(path: Path, history: PointHistory, limits: Mapping[str, float | None]) -> None:
    """Write heating.csv of one control point: time_s, ratio, heat fluxes, heat load, margins to the limits that it has.

    limits : `surface_K` and `bondline_K` [K]
    """
    columns = {"time_s": history.time_s, "ratio": history.ratio, **history.heat.columns()}
    columns |= {name: values for name, values in _margins(history, limits).items() if np.any(np.isfinite(values))}
    write_csv(path, columns, {"time_s": ".10g"} | {name: ".7g" for name in columns if name != "time_s"})


def _margins(history: PointHistory, limits: Mapping[str, float | None]) -> dict[str, FloatArray]:
    """Margins of surface and bondline [K], (time,) each; NaN without a limit."""
    margins = {}
    for name, values in (("surface", history.surface_K), ("bondline", history.bondline_K)):
        limit = limits.get(f"{name}_K")
        margins[f"{name}_margin_K"] = (np.nan if limit is None else limit) - values
    return margins


def run_table(title: str, summary: Mapping[str, Any], rmse_K: Mapping[str, float]) -> Table:
    """Peak temperatures of a run and their margins to the limits, a row a control point; hot structure has no bondline.

    summary : as `run.summary` gives it
    rmse_K  : RMSE against measured histories [K] by control point; without any there is no such column
    """
    columns = [
        Column("control point", "control_point"),
        Column("peak surface", "peak_surface_K", ".0f", "K"),
        Column("at", "peak_surface_s", ".0f", "s"),
        Column("margin", "surface_margin_K", "+.0f", "K"),
        Column("peak bondline", "peak_bondline_K", ".0f", "K"),
        Column("margin", "bondline_margin_K", "+.0f", "K"),
    ]
    points = {name: _cells_of_point(point) for name, point in summary["control_points"].items()}
    if any("band" in point for point in points.values()):
        ends = ("surface", "bondline")
        columns += [Column(f"{name} margin at the band", f"{name}_margin_at_band_K", "+.0f", "K") for name in ends]
    if rmse_K:
        columns.append(Column("RMSE against measured", "rmse_K", ".1f", "K"))
        for name, point in points.items():
            point["rmse_K"] = rmse_K.get(name, "")
    rows = [[name, *(point.get(c.key) for c in columns[1:])] for name, point in points.items()]
    return Table(title, columns, rows)


def _cells_of_point(point: Mapping[str, Any]) -> dict[str, Any]:
    """Entries of a point of a run, with those of its band; the peak of a bondline in hot structure is none."""
    cells = {**point, **point.get("band", {})}
    if cells["bondline_margin_K"] is None and is_hot_structure(cells["peak_surface_K"], cells["peak_bondline_K"]):
        cells["peak_bondline_K"] = None
    return cells


def rmse_table(title: str, rmse_K: Mapping[str, float]) -> Table:
    """RMSE of a run against measured histories [K], a row a control point."""
    columns = [Column("control point"), Column("RMSE against measured", "rmse_K", ".1f", "K")]
    return Table(title, columns, [list(row) for row in rmse_K.items()])


def limits_in_words(summary: Mapping[str, Any]) -> str:
    """Which points of a run exceed their temperature limits, and by how much; with bands, those that do there too.

    summary : as `run.summary` gives it

    >>> from sim_heating.simulation.results import limits_in_words
    >>> points = {"NOSE": {"surface_margin_K": -12.0, "bondline_margin_K": 80.0}, "FIN": {"surface_margin_K": 9.0}}
    >>> limits_in_words({"control_points": points})
    '1 of 2 points with limits exceeds them: NOSE (surface by 12 K)'
    >>> points["FIN"]["band"] = {"surface_margin_at_band_K": -3.0}
    >>> limits_in_words({"control_points": points})
    '1 of 2 points with limits exceeds them: NOSE (surface by 12 K). At the upper end of the 95 % band 1 more: FIN \
(surface by 3 K)'
    """
    points = summary["control_points"]
    margins = {name: _margins_of_summary(point, "margin_K") for name, point in points.items()}
    count = sum(bool(of_point) for of_point in margins.values())
    if not count:
        return "No point has a temperature limit"
    exceeding = _excesses(margins)
    line = _line_of_limits(count, exceeding)
    at_band = {n: _margins_of_summary(p.get("band", {}), "margin_at_band_K") for n, p in points.items()}
    others = [text for name, text in _excesses(at_band).items() if name not in exceeding]
    if not others:
        return line
    more = f"{len(others)} more" if exceeding else f"{len(others)} exceed{'s' if len(others) == 1 else ''} them"
    return f"{line}. At the upper end of the {100.0 * BAND_PROBABILITY:.0f} % band {more}: {', '.join(others)}"


def _line_of_limits(count: int, exceeding: Mapping[str, str]) -> str:
    """How many of the points with limits exceed them, and which."""
    if exceeding:
        verb = "exceeds" if len(exceeding) == 1 else "exceed"
        return f"{len(exceeding)} of {count} points with limits {verb} them: {', '.join(exceeding.values())}"
    return f"All {count} points with limits keep them" if count > 1 else "The point keeps its limits"


def _margins_of_summary(point: Mapping[str, Any], kind: str) -> dict[str, float]:
    """Margins of surface and bondline to their limits [K], those that a point has; kind : end of their keys."""
    margins = {face: point.get(f"{face}_{kind}") for face in ("surface", "bondline")}
    return {face: margin for face, margin in margins.items() if margin is not None}


def _excesses(margins: Mapping[str, Mapping[str, float]]) -> dict[str, str]:
    """`NOSE (surface by 12 K)` of each point that exceeds a limit, by its name."""
    texts = {name: _excess_in_words(of_point) for name, of_point in margins.items()}
    return {name: f"{name} ({text})" for name, text in texts.items() if text}


def _excess_in_words(margins: Mapping[str, float]) -> str:
    """`surface by 12 K`: by how much a point exceeds its limits; empty where it keeps them."""
    return ", ".join(f"{face} by {-margin:.0f} K" for face, margin in margins.items() if margin < 0.0)


def prediction_table(summaries: Sequence[Mapping[str, Any]]) -> Table:
    """Errors of declared models against measured temperatures, a row a record.

    summaries : as `predict.summary` gives them
    """
    columns = [
        Column("record"),
        Column("control point", "control_point", is_text=True),
        Column("RMSE, fit", "fit_rmse_K", ".2f", "K"),
        Column("RMSE, holdout", "holdout_rmse_K", ".2f", "K"),
        Column("noise floor", "noise_floor_K", ".2f", "K"),
    ]
    rows: list[list[Any]] = [
        [s["record"], s["control_point"], *(s[k] and s[k]["rmse_K"] for k in ("fit", "holdout")), s["noise_floor_K"]]
        for s in summaries
    ]
    if any("band" in s for s in summaries):
        columns.append(Column("readings within the 95 % band", "within", ".0%"))
        rows = [[*row, s.get("band", {}).get("within")] for row, s in zip(rows, summaries, strict=True)]
    return Table("Declared model against measurement", columns, rows)


def _netcdf_name(name: str) -> str:
    """Name of a column in netCDF: without `/` and control characters, and not beginning with a sign.

    Source: NetCDF User's Guide, Object Names.
    """
    plain = re.sub(r"[\x00-\x1f/\x7f]", "_", name).strip()
    return plain if plain[:1].isalnum() or plain[:1] == "_" else f"_{plain}"


PER_POINT = ("control_point", "time")
"""Dimensions of the history of each control point."""


def _point_variables(
    points: Sequence[PointHistory], limits: Mapping[str, Mapping[str, float | None]]
) -> dict[str, Any]:
    """Variables of a data set: temperatures, ratio, heat and margins of each control point, and its limits."""
    data: dict[str, Any] = {
        key: (PER_POINT, np.array([getattr(p, key) for p in points]), _attributes(key))
        for key in ("surface_K", "bondline_K", "ratio")
    }
    heat = [p.heat.columns() | _margins(p, limits[p.name]) for p in points]
    data |= {key: (PER_POINT, np.array([h[key] for h in heat]), _attributes(key)) for key in heat[0]}
    for name in ("surface", "bondline"):
        limits_K = [limits[p.name].get(f"{name}_K") for p in points]
        values = np.array([np.nan if limit is None else limit for limit in limits_K])
        data[f"{name}_limit_K"] = ("control_point", values, _attributes(f"{name}_limit_K"))
    return data


def _band_variables(points: Sequence[PointHistory], *, has_sensors: bool) -> dict[str, Any]:
    """Variables of a data set: the bands of each control point, all of which have one, and of the sensors."""
    bands = [p.band.columns() for p in points if p.band is not None]
    data = {key: (PER_POINT, np.array([b[key] for b in bands]), _attributes(key)) for key in bands[0]}
    for end in ("low", "high") if has_sensors else ():
        of_sensors = np.concatenate([getattr(p.band, f"{end}_K")[2:] for p in points])
        data[f"sensor_{end}_K"] = (("sensor", "time"), of_sensors, _attributes(f"sensor_{end}_K"))
    return data


def _coordinates(
    flown: Conditions, points: Sequence[PointHistory], sensors: Mapping[str, Sequence[Sensor]]
) -> dict[str, Any]:
    """Coordinates of a data set: times, control points, sensors and the control point of each."""
    names = [s.name for p in points for s in sensors[p.name]]
    owners = [p.name for p in points for _ in sensors[p.name]]
    return {
        "time": ("time", flown.time_s, TIME_ATTRIBUTES),
        "control_point": ("control_point", [p.name for p in points], {"long_name": "name of the control point"}),
        "sensor": ("sensor", names, {"long_name": "name of the sensor"}),
        "sensor_control_point": ("sensor", owners, {"long_name": "control point of the sensor"}),
    }


def histories_dataset(
    flown: Conditions,
    points: Sequence[PointHistory],
    sensors: Mapping[str, Sequence[Sensor]],
    limits: Mapping[str, Mapping[str, float | None]],
    attributes: Mapping[str, str],
    film: Mapping[str, FloatArray],
) -> xr.Dataset:
    """All histories of a flight as one data set, with units, long names and its origin.

    flown      : conditions on the points' times
    sensors    : sensors of each point by its name;  limits : its `surface_K` and `bondline_K` [K]
    attributes : of the data set: title, vehicle, ...
    film       : reference heating, `h_ref_kg_m2_s` and `H_r_J_kg`, (control point, time) each
    """
    import xarray as xr  # slow to import, and wanted only where results are written

    coordinates = _coordinates(flown, points, sensors)
    names = coordinates["sensor"][1]
    data = _point_variables(points, limits)
    sensors_K = np.concatenate([p.sensors_K for p in points]) if names else np.zeros((0, len(flown)))
    data["sensor_K"] = (("sensor", "time"), sensors_K, _attributes("sensor_K"))
    if points and all(p.band is not None for p in points):
        data |= _band_variables(points, has_sensors=bool(names))
    columns = {_netcdf_name(name): name for name in flown.names if name not in ("time_s", *film)}
    data |= {key: ("time", flown[name], _attributes(name)) for key, name in columns.items()}
    data |= {name: (PER_POINT, values, _attributes(name)) for name, values in film.items()}
    origin = {"Conventions": "CF-1.10", "source": f"sim-heating {package_version()}", **provenance_attributes()}
    return xr.Dataset(data, coordinates, {**attributes, **origin})


def _attributes(name: str) -> dict[str, str]:
    of_point = next((unit for column, unit in UNITS.items() if name.endswith(f"_{column}")), None)
    unit = UNITS.get(name, of_point or ("K" if name.endswith("_K") else "1"))
    return {"units": unit, "long_name": LONG_NAMES.get(name, name.replace("_", " "))}
