"""The declared model along the conditions of a flight record, nothing fitted."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.special import ndtri

from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import Conditions
from sim_heating.base.errors import InputError, failure_context
from sim_heating.base.files import display_path, output_directory, write_json
from sim_heating.base.files.package import package_version
from sim_heating.credibility.facts.of_records import facts_of_record
from sim_heating.credibility.statement import Facts, Statement, assess
from sim_heating.heating.edge_flow import EdgeFlow
from sim_heating.heating.reference.models import beyond_range
from sim_heating.inputs.points import conditions_of_record, flow_of_record, point_of_record
from sim_heating.inputs.record import Record, Sensor, load_record, pooled_rmse_K
from sim_heating.inputs.sensor_model import SensorErrors, indicated_temperature, lags_s
from sim_heating.march.history import (
    BAND_PROBABILITY,
    PointHistory,
    TableExcursion,
    march_points,
    negative_ratio_s,
    table_excursions,
    values_at,
)
from sim_heating.march.point import PointModel
from sim_heating.simulation.results import prediction_table, write_heating_csv, write_temperatures_csv

FILES = TABLE, HEATING, SUMMARY, PICTURE, PAGE = (
    "temperatures.csv",
    "heating.csv",
    "summary.json",
    "prediction.png",
    "report.html",
)
"""Files that a prediction writes."""


if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.figure import Figure

    from sim_heating.simulation.report.charts import ModelCurve


@dataclass(frozen=True, repr=False)
class Prediction:
    """Temperatures of a record's declared model at the record's own sample times.

    history     : at the times of the measurements; NaN where they lie outside the conditions
    indicated_K : (sensor, sample) indication of each sensor, calibration applied, without noise
    residual_K  : (sensor, sample) measured minus indicated
    outside     : excursions beyond the ratio table
    model, conditions : of the control point, as marched
    """

    record: Record
    history: PointHistory
    indicated_K: FloatArray
    residual_K: FloatArray
    outside: tuple[TableExcursion, ...]
    model: PointModel
    conditions: Conditions

    def facts(self, kind: str = "prediction", *, with_peak: bool = True) -> Facts:
        """Facts from which the credibility of a result of this kind follows.

        with_peak : whether the uncertainty of the highest surface temperature is computed
        """
        return facts_of_record(
            kind, self.record, self.model, self.conditions, self.history, self.residual_K, with_peak=with_peak
        )

    @cached_property
    def credibility(self) -> Statement:
        """What supports the prediction, factor by factor."""
        return assess(self.facts())

    @property
    def within_band(self) -> float | None:
        """Share of the readings of used sensors within the band, noise and rounding included; None without a band."""
        band, record = self.history.band, self.record
        if band is None:
            return None
        used = [i for i, s in enumerate(record.sensors) if s.used]
        noise = reading_noise_K([record.sensors[i] for i in used])[:, np.newaxis]
        low, high = (x[2:][used] for x in (band.low_K, band.high_K))
        read = self.history.sensors_K[used] + self.residual_K[used]
        known = np.isfinite(read) & np.isfinite(low)
        half = np.hypot(0.5 * (high - low), ndtri(0.5 + 0.5 * BAND_PROBABILITY) * noise)
        return float(np.mean(np.abs(read - 0.5 * (low + high))[known] <= half[known])) if np.any(known) else None

    def segment_errors(self) -> dict[str, Any]:
        """rmse_K, max_abs_K and n over the fit and the holdout segments, pooled over the used sensors; None where a
        segment holds no sample."""
        residual = self.residual_K[[i for i, sensor in enumerate(self.record.sensors) if sensor.used]]
        masks = {"fit": self.record.fit_mask(), "holdout": self.record.holdout_mask()}
        return {name: pooled_rmse_K(residual, mask) for name, mask in masks.items()}

    def __repr__(self) -> str:
        errors = pooled_rmse_K(self.residual_K)
        rmse = "no sample within the conditions" if errors is None else f"RMSE {errors['rmse_K']:.2f} K"
        return f"<Prediction of {self.record.name}: {len(self.record.sensors)} sensors, {rmse}>"

    def to_xarray(self) -> xr.Dataset:
        """Measured and predicted temperatures [K] of each sensor at the record's sample times [s]."""
        import xarray as xr  # slow to import

        measured = self.record.temperatures_K()
        data = {
            "measured_K": measured,
            "indicated_K": self.indicated_K,
            "residual_K": self.residual_K,
        }
        coordinates = {"sensor": [s.name for s in self.record.sensors], "time": self.record.time_s}
        return xr.Dataset({k: (("sensor", "time"), v, {"units": "K"}) for k, v in data.items()}, coordinates)

    def plot(self) -> Figure:
        """Each sensor, measured and predicted, with the residual below."""
        return self.draw(None)

    def draw(self, path: Path | None) -> Figure:
        """The picture of `plot`, saved to a path where one is given."""
        from sim_heating.simulation.report.charts import with_rmse  # matplotlib is slow to import
        from sim_heating.simulation.report.plots import draw_prediction

        record, fitted = self.record, self.record.fit_mask()
        names = [with_rmse(s.name, r, fitted) for s, r in zip(record.sensors, self.residual_K, strict=True)]
        title = f"{record.name}: declared model\n{record.declared.title or record.declared.control_point}"
        readings = record.temperatures_K()
        return draw_prediction(path, title, self.history.time_s, names, readings, self.indicated_K, self.history.band)


def predict(
    record: Record | str | os.PathLike[str],
    model: PointModel | None = None,
    *,
    flow: EdgeFlow | None = None,
    skew_s: float = 0.0,
    errors: Mapping[str, SensorErrors] | None = None,
) -> Prediction:
    """Temperatures that the declared model gives at a record's sensors, nothing fitted.

    record : a flight record, or its directory
    model  : another model than the declared one
    flow   : what its effects ask of the flow at the edge of the point; by default by what the record declares of it
    skew_s : by how much the thermocouples' clock lags [s];  errors : gain, bias, lag and drift of sensors, by name
    raises : InputError where no sample lies within the conditions, or the record's own model lacks a heating ratio;
             RunError where a step did not converge

    >>> import sim_heating as sh
    >>> sh.predict("scenarios/records/practice/p06")
    <Prediction of p06: 2 sensors, RMSE 9.57 K>
    """
    record = load_record(record)
    if model is None:
        record.require_ratio()
    model, faults = point_of_record(record) if model is None else model, errors or {}
    model = model.with_lags(lags_s(record.sensors, faults))
    conditions = conditions_of_record(record, flow or flow_of_record(record, model.effects))
    t, span = record.time_s - skew_s, conditions.time_s[[0, -1]]
    inside_s = t[(t >= span[0]) & (t <= span[1])]
    if len(inside_s) == 0:
        raise InputError(f"{record.name}: no measurement lies within the conditions ({span[0]:g} to {span[1]:g} s)")
    with failure_context(display_path(record.directory)):
        marched = march_points([model], [conditions], extra_times_s=inside_s)[0]
    history = replace(_resampled(marched, t), time_s=record.time_s)
    pairs, since_s = zip(record.sensors, history.sensors_K, strict=True), record.time_s - record.time_s[0]
    indicated = np.array([indicated_temperature(s, values, faults.get(s.name), since_s) for s, values in pairs])
    residual = record.temperatures_K() - indicated
    return Prediction(
        record, history, indicated, residual, tuple(table_excursions(model, conditions)), model, conditions
    )


def reading_noise_K(sensors: Sequence[Sensor]) -> FloatArray:
    """(sensor,) standard deviation of a reading about the temperature of its sensor, rounding included [K].

    A sensor that declares no noise has its rounding alone. Source: docs/theory/model_error.md, equation 1.
    """
    return np.array([np.hypot(s.noise_sigma_K or 0.0, s.lsb_K / np.sqrt(12.0)) for s in sensors])


def _resampled(marched: PointHistory, time_s: FloatArray) -> PointHistory:
    def at_samples(values: FloatArray) -> FloatArray:
        return values_at(marched.time_s, values, time_s)

    return replace(
        marched,
        time_s=time_s,
        surface_K=at_samples(marched.surface_K),
        bondline_K=at_samples(marched.bondline_K),
        sensors_K=at_samples(marched.sensors_K),
        ratio=at_samples(marched.ratio),
        heat=replace(marched.heat, **{name: at_samples(values) for name, values in marched.heat.columns().items()}),
    )


def summary(prediction: Prediction) -> dict[str, object]:
    """Content of summary.json: errors over fit and holdout segments, pooled over the used sensors."""
    record = prediction.record
    by_sensor = {
        s.name: pooled_rmse_K(prediction.residual_K[i], record.fit_mask()) for i, s in enumerate(record.sensors)
    }
    floor = None
    if all(s.noise_sigma_K is not None for s in record.used_sensors):
        floor = record.noise_floor_K()
    return {
        "format": "predict-summary/1",
        "program": f"sim-heating {package_version()}",
        "record": record.name,
        "control_point": record.declared.control_point,
        **prediction.segment_errors(),
        "noise_floor_K": None if floor is None or not np.isfinite(floor) else floor,
        "sensors": by_sensor,
        "outside_table": [vars(o) for o in prediction.outside],
        "beyond_reference": beyond_range(record.declared.heating.reference, record.conditions),
        "negative_ratio_s": negative_ratio_s(prediction.history),
        **band_summary(prediction),
        "nodes": prediction.history.nodes,
        "mesh_error_K": prediction.history.mesh_error_K,
        "credibility": prediction.credibility.as_json(),
    }


def band_summary(prediction: Prediction) -> dict[str, object]:
    """`band` of summary.json: share of the readings within it, its half width, and what it comes from."""
    band = prediction.history.band
    if band is None:
        return {}
    half = 0.5 * (band.high_K - band.low_K)
    return {
        "band": {
            "probability": BAND_PROBABILITY,
            "within": prediction.within_band,
            "half_width_K": {
                s.name: float(np.nanmax(w)) for s, w in zip(prediction.record.sensors, half[2:], strict=True)
            },
            "sources_K": dict(band.sources),
        }
    }


def write_prediction(prediction: Prediction, out: str | os.PathLike[str]) -> list[str]:
    """Write temperatures.csv, heating.csv, summary.json, a picture and a page; returns the names of the files."""
    from sim_heating.base.report.page import write_page  # matplotlib is slow to import
    from sim_heating.simulation.report.pages import prediction_page

    record, history = prediction.record, prediction.history
    with output_directory(out, "predict", inputs=[record.directory]) as folder:
        write_temperatures_csv(folder / TABLE, history.time_s, history, record.sensors)
        write_heating_csv(folder / HEATING, history, {})
        contents = summary(prediction)
        write_json(folder / SUMMARY, contents)
        prediction.draw(folder / PICTURE)
        write_page(
            folder / PAGE, lambda: prediction_page(contents, record, history, _curve(prediction), folder / PICTURE)
        )
        return sorted(p.name for p in folder.iterdir() if p.is_file())


def write_predictions_page(predictions: Sequence[Prediction], out: str | os.PathLike[str]) -> Path:
    """Write report.html over several predictions, whose own files lie in a folder each, named as its record.

    returns : its name within the directory
    """
    from sim_heating.base.report.page import write_page  # matplotlib is slow to import
    from sim_heating.simulation.report.pages import predictions_page

    table = prediction_table([summary(p) for p in predictions])
    with output_directory(out, "predict", inputs=[p.record.directory for p in predictions]) as folder:
        write_page(folder / PAGE, lambda: predictions_page(table, [(p.record, _curve(p)) for p in predictions]))
    return Path(PAGE)


def _curve(prediction: Prediction) -> ModelCurve:
    from sim_heating.simulation.report.charts import ModelCurve
    from sim_heating.simulation.report.pages import PREDICTED

    return ModelCurve("predicted", PREDICTED, prediction.indicated_K, prediction.residual_K)
