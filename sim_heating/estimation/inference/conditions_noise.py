"""White noise of a record's conditions as white noise of its heating.

A filter of the trajectory leaves noise in the angle of attack, the density and the velocity of each row. The film
coefficient of laminar heating goes with rho^1/2 V, the enthalpy difference of a hypersonic flow with V^2, and the
heating ratio r with the angle of attack and log10 Re:

    n^2 = (ln r(alpha + s_alpha) - ln r)^2 + (s_rho / 2 + ln r(log10 Re + s_rho / ln 10) - ln r)^2 + (3 s_V)^2,

relative noise n [-] of the heating at each row, independent from row to row. The march integrates it: between knots a
distance h apart it has the same spectrum at low frequencies as independent values at the knots of variance

    v_k = sum_i phi_k(t_i) n_i^2 d_i^2 / h_k^2,     h_k = sum_i phi_k(t_i) d_i,

d_i [s] the share of row i and phi_k the hat function of knot k. These values join the unknowns of the model's error
(inference/model_error.py). Derived in docs/theory/model_error.md, equations 9 and 10.
"""

from __future__ import annotations

import math

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.estimation.inference.model_error import HeatingNoise
from sim_heating.estimation.inference.noise import LEAST_NOISE_K, noise_of_readings
from sim_heating.estimation.record_fit import RecordFit
from sim_heating.inputs.record import FlightNoise, Record
from sim_heating.march.history import march_points

NEGLIGIBLE = 1e-3
"""Relative noise of the heating [-] below which it is none."""


def conditions_noise(record: Record) -> FlightNoise | None:
    """Noise of the conditions of a record: as declared, else of a measured flight that of its columns.

    returns : one standard deviation of each; None where there is none

    The roughness of a column is that of third differences of neighbouring rows (`noise_of_readings`), so that a smooth
    column has none.
    """
    declared = record.declared.conditions.noise
    if declared is None and record.declared.measured and record.has_flow:
        flown, t = record.conditions, record.conditions.time_s
        density = np.log(np.maximum(flown["rho_kg_m3"], np.finfo(float).tiny))
        speed = np.log(np.maximum(flown["velocity_m_s"], 1.0))
        declared = FlightNoise(
            alpha_deg=_roughness(t, flown["alpha_deg"]),
            density_relative=min(_roughness(t, density), 1.0),
            velocity_relative=min(_roughness(t, speed), 0.5),
        )
    if declared is None or not any(declared.model_dump().values()):
        return None
    return declared


def _roughness(time_s: FloatArray, column: FloatArray) -> float:
    """Noise of a column in its own unit; 0 where it is smooth, or has too few rows to tell."""
    noise = noise_of_readings(time_s, column)
    return 0.0 if noise is None or noise <= LEAST_NOISE_K else noise


def heating_noise(record_fit: RecordFit, values: FloatArray) -> HeatingNoise | None:
    """Noise of the heating of a record that its conditions have; None where there is none.

    values : (parameter,) of the model;  raises : RunError where it cannot be marched

    Source: docs/theory/model_error.md, equation 9.
    """
    noise = conditions_noise(record_fit.record)
    if noise is None:
        return None
    flown, model = record_fit.conditions, record_fit.model_at(values)
    turned = flown.with_columns(alpha_deg=flown["alpha_deg"] + noise.alpha_deg)
    denser = flown.with_columns(log10_re=flown["log10_re"] + noise.density_relative / math.log(10.0))
    ratio, ratio_turned, ratio_denser = (h.ratio for h in march_points([model] * 3, [flown, turned, denser]))
    by_alpha, by_density = (np.log(np.abs(_over(r, ratio))) for r in (ratio_turned, ratio_denser))
    relative = np.sqrt(
        by_alpha**2 + (0.5 * noise.density_relative + by_density) ** 2 + (3.0 * noise.velocity_relative) ** 2
    )
    return HeatingNoise(flown.time_s, relative) if np.max(relative) > NEGLIGIBLE else None


def _over(changed: FloatArray, ratio: FloatArray) -> FloatArray:
    """(row,) a changed heating ratio over the ratio, 1 where there is none."""
    is_usable = np.isfinite(changed) & np.isfinite(ratio) & (np.abs(ratio) > 0.0) & (np.abs(changed) > 0.0)
    return np.divide(changed, ratio, out=np.ones_like(ratio), where=is_usable)
