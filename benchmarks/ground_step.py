"""Ground step test: what a lamp tells of a thermocouple's stack and clock, and how far that goes on a measured board.

The plug V09T9527 is lit for a minute with 10, 50 and 100 kW/m2; its truth is a coating 1.3 times as thick as declared,
insulation of 0.9 the conductivity, and a thermocouple clock that lags by 0.4 s. The board is the record
scenarios/records/kaowool_board, fitted with factors of the plain model; `convection` is a film coefficient to the gas,
which the plain model has as a heating ratio over h_ref = 1 kg/(m2 s).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.measure import Figure, save
from sim_heating.conditions import FloatArray
from sim_heating.estimation.estimate import Fitted, estimate
from sim_heating.files import read_csv_columns
from sim_heating.ground_step import step_record
from sim_heating.predict import predict
from sim_heating.record import Heating, Record, load_record
from sim_heating.vehicle import load_vehicle

BOARD = Path(__file__).resolve().parent.parent / "scenarios" / "records" / "kaowool_board"
POINT = "V09T9527"
TRUTH = {"stack.coating.thickness_factor": 1.3, "stack.rsi.conductivity_factor": 0.9}
SKEW_S = 0.4
FLUXES_W_M2 = (10e3, 50e3, 100e3)
CONDUCTIVITY, HEAT = "stack.rsi.conductivity_factor", "stack.rsi.heat_capacity_factor"
EMISSIVITY, BACK, CONVECTION = "stack.emissivity_factor", "back.h_W_m2K", "ratio.d0"
TRIED = (
    (CONDUCTIVITY,),
    (HEAT,),
    (EMISSIVITY,),
    (BACK,),
    (CONDUCTIVITY, HEAT, EMISSIVITY, BACK),
    (CONVECTION,),
    (CONDUCTIVITY, HEAT, CONVECTION, BACK),
)
REPEATS = ("U2_5p72mm_K", "U2_11p44mm_K", "U2_17p16mm_K")
EARLY_S = (60.0, 150.0)
LATE_S = 900.0
GAS_HEAT_J_KGK, GAS_K = 1040.0, 298.15
"""Nitrogen: specific heat, and temperature at sample height in the middle of what the source gives."""


def run() -> list[Figure]:
    """Steps of three fluxes, then the board."""
    figures = [*_steps(), *_board()]
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


def _board() -> Iterator[Figure]:
    record = load_record(BOARD)
    table = read_csv_columns(BOARD / record.declared.thermocouples.file, REPEATS)
    for column in REPEATS:
        spread = float(np.sqrt(np.mean((0.5 * table[column]) ** 2)))
        yield Figure(f"board, standard uncertainty of repeated tests, {column}", spread, "K", note="root mean square")
    yield from _errors("board, as declared", record, predict(record).residual_K, "")
    for names in TRIED:
        fitted = estimate([_in_gas(record) if CONVECTION in names else record], names)
        short = ", ".join(n.removeprefix("stack.").removeprefix("rsi.").removesuffix("_factor") for n in names)
        short = short.replace(CONVECTION, "convection")
        yield from _errors(f"board, {short}", record, fitted.after[0].residual_K, _values(fitted))


def _values(fitted: Fitted) -> str:
    found = []
    for name, value, sigma in zip(fitted.labels, fitted.fit.values, fitted.bounds.sigma, strict=True):
        scale, unit = (GAS_HEAT_J_KGK, " W/(m2 K)") if name == CONVECTION else (1.0, "")
        found.append(f"{name.rsplit('.', 1)[-1]} {value * scale:.3g} +- {sigma * scale:.2g}{unit}")
    return ", ".join(found)


def _errors(what: str, record: Record, residual_K: FloatArray, note: str) -> Iterator[Figure]:
    t = record.time_s
    early, late = (t >= EARLY_S[0]) & (t <= EARLY_S[1]), t >= LATE_S
    for i, sensor in enumerate(record.sensors):
        own = residual_K[i]
        bias = f"mean {np.mean(own[early]):+.1f} K early, {np.mean(own[late]):+.1f} K late"
        more = f"; {note}" if note and i == 0 else ""
        yield Figure(
            f"{what}: RMSE {sensor.depth_m * 1e3:.2f} mm", float(np.sqrt(np.mean(own**2))), "K", note=bias + more
        )


def _in_gas(record: Record) -> Record:
    """The board with convection to the gas, as a ratio over h_ref = 1: its film coefficient is ratio.d0 times cp."""
    heating = Heating.model_validate({"reference": "columns", "wall_enthalpy": {"cp_J_kgK": GAS_HEAT_J_KGK}})
    flown = record.conditions.with_columns(h_ref_kg_m2_s=1.0, H_r_J_kg=GAS_HEAT_J_KGK * GAS_K)
    return replace(record, declared=record.declared.model_copy(update={"heating": heating}), conditions=flown)
