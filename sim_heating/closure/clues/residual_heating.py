"""The residual of a fit as the heating that would explain it, and the residual that no heating explains.

The smoother of estimation/filter/heating_input.py on the samples and at the values of a fit: a history delta_ratio(t)
that, added to the heating ratio, makes the measured samples likely, with its sigma. A residual of the sensors beyond
that history is not due to heating at the surface: conduction, a sensor, a clock.

A record without reference heating, such as one under a lamp, has no heating ratio. There the history is an absorbed
flux, over the largest that the record declares: the march is given a reference heating of that flux, whatever the wall.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import Conditions
from sim_heating.base.files import write_csv
from sim_heating.estimation.filter.heating_input import UnknownInput, unknown_input
from sim_heating.estimation.filter.march import Disturbance, FilterTrack
from sim_heating.estimation.filter.records import filter_samples, lag_offset
from sim_heating.estimation.problem import FitProblem
from sim_heating.estimation.record_fit import FittedChannel, RecordFit
from sim_heating.inputs.record import Record
from sim_heating.march.ensemble import condition_history
from sim_heating.thermal.mesh import Mesh
from sim_heating.thermal.stack import Sensor

NAME = "residual_heating.csv"


@dataclass(frozen=True, eq=False)
class SensorResidual:
    """Residuals of one sensor, without and with the best heating history.

    time_s, read_K     : (sample,) as recorded
    before_K, after_K  : (sample,) measured minus predicted [K], without and with the history
    floor_K            : its noise floor [K]
    """

    sensor: Sensor
    time_s: FloatArray
    read_K: FloatArray
    before_K: FloatArray
    after_K: FloatArray
    floor_K: float

    @property
    def before_rmse_K(self) -> float:
        """RMS residual without the history [K]."""
        return float(np.sqrt(np.mean(self.before_K**2)))

    @property
    def after_rmse_K(self) -> float:
        """RMS residual with the history [K]."""
        return float(np.sqrt(np.mean(self.after_K**2)))

    def describe(self) -> str:
        """One line for a person."""
        times = self.after_rmse_K / self.floor_K
        residuals = (
            f"{self.sensor.name}: {self.before_rmse_K:.2f} K, {self.after_rmse_K:.2f} K with the best heating history"
        )
        if times < 1.3:
            return f"{residuals}, which is its noise ({self.floor_K:.2f} K)"
        return f"{residuals}, {times:.1f} times its noise: heating at the surface does not explain that part"


@dataclass(frozen=True, eq=False, repr=False)
class ResidualHeating:
    """The residual of one record as a heating ratio.

    input    : the history with its sigma, and the response of the readings to it
    sensors  : residuals of each used sensor, without and with it
    jacobian : (reading, parameter) sensitivities to the fitted parameters, readings in the order of `input`
    prior_information : (parameter,) 1 / sigma^2 of the fit's priors
    names    : (parameter,) labels of the fitted parameters
    span_s   : (2,) first and last time that was fitted
    march_s, mesh : (time,) and nodes of `input.temperature_K`
    flux_W_m2 : absorbed flux that a ratio of 1 stands for in a record without reference heating; None in any other
    """

    record: Record
    input: UnknownInput
    sensors: tuple[SensorResidual, ...]
    jacobian: FloatArray
    prior_information: FloatArray
    names: tuple[str, ...]
    span_s: tuple[float, float]
    march_s: FloatArray
    mesh: Mesh
    flux_W_m2: float | None = None

    @property
    def unit(self) -> str:
        """What delta_ratio is a multiple of, in words."""
        return "ratio" if self.flux_W_m2 is None else f"{1e-3 * self.flux_W_m2:.3g} kW/m2"

    @property
    def quantity(self) -> str:
        """What delta_ratio is, in words."""
        return "heating ratio" if self.flux_W_m2 is None else f"absorbed flux over {self.unit}"

    @property
    def time_s(self) -> FloatArray:
        """(knot,) times [s]."""
        return self.input.time_s

    @property
    def delta_ratio(self) -> FloatArray:
        """(knot,) missing heating ratio [-], to be added to the model's."""
        return self.input.delta_ratio

    @property
    def sigma(self) -> FloatArray:
        """(knot,) standard deviation of delta_ratio [-]."""
        return self.input.sigma

    @property
    def fitted(self) -> NDArray[np.bool_]:
        """(knot,) whether a knot lies within the times that were fitted."""
        return np.asarray((self.time_s >= self.span_s[0]) & (self.time_s <= self.span_s[1]))

    def as_json(self) -> dict[str, Any]:
        """Size, gain, bandwidth and sensors for closure.json."""
        here = self.fitted
        flux = {} if self.flux_W_m2 is None else {"flux_W_m2": self.flux_W_m2}
        return flux | {
            "rms_delta_ratio": float(np.sqrt(np.mean(self.delta_ratio[here] ** 2))),
            "median_sigma": float(np.median(self.sigma[here])),
            "gain_log_likelihood": self.input.gain_log_likelihood,
            "half_amplitude_Hz": self.input.half_amplitude_Hz,
            "median_bandwidth_Hz": float(np.median(self.input.bandwidth_Hz[here])),
            "noise_over_declared": float(np.sqrt(self.input.variance_factor)),
            "noise_model": {
                "sigma": self.input.disturbance.start_sigma,
                "correlation_s": self.input.disturbance.correlation_s,
            },
            "beyond_heating": [
                {
                    "sensor": s.sensor.name,
                    "before_rmse_K": s.before_rmse_K,
                    "after_rmse_K": s.after_rmse_K,
                    "noise_floor_K": s.floor_K,
                    "n": len(s.time_s),
                }
                for s in self.sensors
            ],
        }

    def __repr__(self) -> str:
        fitted = self.fitted
        rms = float(np.sqrt(np.mean(self.delta_ratio[fitted] ** 2)))
        return f"<ResidualHeating of {self.record.name}: {len(self.time_s)} knots, RMS {rms:.3g} of {self.unit}>"


def residual_heating(
    problem: FitProblem,
    values: FloatArray,
    disturbance: Disturbance | None = None,
    omitted: Collection[str] = (),
) -> ResidualHeating:
    """The heating history that explains the residual of one record of a fit.

    problem, values : the fit; its samples are the readings, its values the model
    disturbance     : noise model of the history; None for the likeliest one
    omitted         : names of sensors that are omitted
    raises          : RunError where the model cannot be marched
    """
    record_fit = problem.record_fits[0]
    shift, channels = record_fit.shift_s(values), [c for c in record_fit.channels if c.sensor.name not in omitted]
    # At the times shifted by the clock and with the correction for the mesh: what these explain is not missing heating.
    samples, order = filter_samples(
        channels,
        record_fit.sample_s + shift,
        record_fit.mesh,
        record_fit.sigma_K,
        record_fit.values(values),
        record_fit.correction_K,
        lag=lag_offset(record_fit, values, sensitive=False),
    )
    track = FilterTrack(record_fit.model_at(values), record_fit.mesh, samples, (), record_fit.initial_K(values))
    flown, flux = _with_reference_flux(record_fit.conditions.at(record_fit.time_s))
    history = condition_history(flown)[np.newaxis]
    smoothed = unknown_input(track, record_fit.time_s, history, disturbance)
    fitted = [s for s in problem.samples(values) if s.record_fit is record_fit and s.channel in channels]
    mean_K = np.concatenate([s.mean_K for s in fitted])
    with_K = np.empty_like(mean_K)
    with_K[order] = smoothed.read_K
    jacobian = np.concatenate([s.jacobian for s in fitted])[order]
    prior = np.array([p.sigma**-2.0 for p in problem.parameters])
    names = tuple(u.label for u in problem.unknowns)
    sensors = _sensor_residuals(record_fit, channels, mean_K, with_K)
    span = (float(record_fit.sample_s[0]), float(record_fit.sample_s[-1]))
    return ResidualHeating(
        record_fit.record, smoothed, sensors, jacobian, prior, names, span, record_fit.time_s, record_fit.mesh, flux
    )


def _with_reference_flux(flown: Conditions) -> tuple[Conditions, float | None]:
    """Conditions without reference heating, with one of the largest flux that they have; others as they are.

    returns : the conditions, and that flux [W/m2]; None where they have a reference heating
    """
    # recovery enthalpy of a reference heating that does not depend on the wall: that of a wall is negligible [J/kg]
    cold_wall_J_kg = 1e12
    flux_W_m2 = 1e4  # unit of a missing flux where the record declares none [W/m2]
    if np.any(flown["h_ref_kg_m2_s"] != 0.0):
        return flown, None
    flux = float(np.max(np.abs(flown["q_add_W_m2"]))) if "q_add_W_m2" in flown else 0.0
    flux = flux or flux_W_m2
    h_ref, H_r = np.full(len(flown), flux / cold_wall_J_kg), np.full(len(flown), cold_wall_J_kg)
    return flown.with_columns(h_ref_kg_m2_s=h_ref, H_r_J_kg=H_r), flux


def _sensor_residuals(
    record_fit: RecordFit, channels: Sequence[FittedChannel], mean_K: FloatArray, with_K: FloatArray
) -> tuple[SensorResidual, ...]:
    """Residuals of each channel, out of readings concatenated in the order of the channels."""
    ends = np.cumsum([len(c.samples) for c in channels])[:-1]
    residuals = []
    for c, before, after in zip(channels, np.split(mean_K, ends), np.split(with_K, ends), strict=True):
        t, floor = record_fit.sample_s[c.samples], c.sensor.noise_floor_K(float(record_fit.sigma_K[c.number]))
        read = record_fit.record.thermocouples[c.sensor.column][np.searchsorted(record_fit.record.time_s, t)]
        residuals.append(SensorResidual(c.sensor, t, read, read - before, read - after, floor))
    return tuple(residuals)


def write_residual_heating(path: Path, residual: ResidualHeating) -> None:
    """Write the history as CSV: time_s, delta_ratio, sigma; without reference heating delta_q_W_m2, sigma_W_m2."""
    if residual.flux_W_m2 is None:
        write_csv(path, {"time_s": residual.time_s, "delta_ratio": residual.delta_ratio, "sigma": residual.sigma})
        return
    q, sigma = residual.flux_W_m2 * residual.delta_ratio, residual.flux_W_m2 * residual.sigma
    write_csv(path, {"time_s": residual.time_s, "delta_q_W_m2": q, "sigma_W_m2": sigma})
