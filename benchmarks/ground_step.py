"""Ground step test: identification of a thermocouple's stack and clock under a lamp. A measured board: kaowool.py.

The plug V09T9527 is lit for a minute with 10, 50 and 100 kW/m2; its truth is a coating 1.3 times as thick as declared,
insulation of 0.9 the conductivity, and a thermocouple clock that lags by 0.4 s.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from benchmarks.measure import Figure, save
from sim_heating.estimation.fit import estimate
from sim_heating.inputs.vehicle import load_vehicle
from sim_heating.simulation.ground_step import step_record

POINT = "V09T9527"
TRUTH = {"stack.coating.thickness_factor": 1.3, "stack.rsi.conductivity_factor": 0.9}
SKEW_S = 0.4
FLUXES_W_M2 = (10e3, 50e3, 100e3)


def run() -> list[Figure]:
    """Steps of three fluxes."""
    figures = list(_steps())
    save("ground_step", figures)
    return figures


def _steps() -> Iterator[Figure]:
    vehicle = load_vehicle("orbiter")
    true = TRUTH | {"clock.skew": SKEW_S}
    for flux in FLUXES_W_M2:
        record = step_record(vehicle, vehicle.control_point(POINT), flux, parameters=TRUTH, skew_s=SKEW_S)
        fitted = estimate([record], list(true))
        hottest = f"hottest thermocouple {np.nanmax(record.temperatures_K()):.0f} K"
        for name, value, sigma in zip(fitted.labels, fitted.fit.values, fitted.bounds.sigma, strict=True):
            unit = "s" if name == "clock.skew" else "1"
            what = f"{flux / 1e3:g} kW/m2: sigma of {name}"
            yield Figure(what, float(sigma), unit, note=f"{value:.3f}, true {true[name]:g}; {hottest}")
        rho = fitted.correlation[fitted.labels.index("clock.skew"), fitted.labels.index(next(iter(TRUTH)))]
        yield Figure(f"{flux / 1e3:g} kW/m2: correlation of skew and coating", float(rho), "")
