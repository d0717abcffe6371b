"""A tile through one pushover-pullup, as a record: the case of the benchmarks on clocks and starts.

A lower-surface tile of practice record materials is heated at a constant rate until its surface is near radiation
equilibrium, then flies a doublet of the angle of attack. Its temperatures are the program's own, so that errors of
a fit are due to clocks, starts and noise alone.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cache

import numpy as np
from numpy.typing import NDArray

from sim_heating.base.conditions import Conditions
from sim_heating.base.files import check
from sim_heating.inputs.points import point_of_record
from sim_heating.inputs.record import Record, RecordFile, load_record, make_record
from sim_heating.inputs.sensor_model import SensorErrors, measure
from sim_heating.simulation.predict import predict
from tests.support.paths import PRACTICE

FloatArray = NDArray[np.float64]

MIL_M = 2.54e-5
END_S, POPU_S, PERIOD_S = 400.0, 320.0, 40.0
FIT_S = (300.0, 390.0)
SIGMA_BOLTZMANN, EMITTANCE, H_R_J_KG = 5.670374e-8, 0.85, 2.5e7
CP_J_KGK = 1004.5
RATIO, D_ALPHA = 0.05, 0.001
"""True ratio at an angle of attack of 40 deg, and its derivative [1/deg]."""
PRESSURE_PA = 500.0
FINE_NODES = 150
"""Nodes of the truth; a fit is corrected for the error of its own mesh."""


@dataclass(frozen=True)
class Tile:
    """The varied quantities.

    coating_mil : coating, and depth of the thermocouple beneath
    surface_K   : radiation equilibrium before the manoeuvre
    skew_s      : by how much the thermocouple's clock lags, unstated
    tau_s       : time constant of its first-order lag, unstated
    period_s    : of the doublet
    offset_s    : time after the whole second at which it samples, stated
    noise_K     : its noise; bits : of its recorder, over 255 to 1644 K
    """

    coating_mil: float = 15.0
    surface_K: float = 1100.0
    skew_s: float = 0.0
    tau_s: float = 0.0
    period_s: float = PERIOD_S
    offset_s: float = 0.0
    noise_K: float = 0.0
    bits: int | None = None
    truth: Mapping[str, float] = field(default_factory=dict)
    seed: int = 1


@cache
def _practice() -> Record:
    return load_record(PRACTICE / "p06")


def conditions(tile: Tile) -> Conditions:
    """Constant but for the doublet of the angle of attack."""
    t = np.arange(0.0, END_S + 1.0)
    if tile.period_s < PERIOD_S:
        t = np.union1d(t, np.arange(POPU_S, POPU_S + tile.period_s, 0.25))
    phase = (t - POPU_S) / tile.period_s
    doublet = np.where((phase > 0.0) & (phase < 1.0), np.sin(2.0 * np.pi * phase), 0.0)
    flux = EMITTANCE * SIGMA_BOLTZMANN * tile.surface_K**4
    h_ref = flux / (RATIO * (H_R_J_KG - CP_J_KGK * tile.surface_K))
    columns = {c: np.full(len(t), np.mean(v)) for c, v in _practice().conditions.columns.items()}
    columns |= {"time_s": t, "alpha_deg": 40.0 + 5.0 * doublet, "h_ref_kg_m2_s": np.full(len(t), h_ref)}
    columns |= {"H_r_J_kg": np.full(len(t), H_R_J_KG), "p_surface_Pa": np.full(len(t), PRESSURE_PA)}
    return Conditions(columns | {"jets": np.zeros(len(t))})


def declaration(tile: Tile) -> RecordFile:
    """The practice tile with this coating and one thermocouple beneath it."""
    data = _practice().declared.model_dump(exclude_unset=True)
    sensor = {"name": "TC", "column": "TC_K", "depth_m": tile.coating_mil * MIL_M, "noise_sigma_K": tile.noise_K or 1.0}
    if tile.bits is not None:
        sensor |= {"bits": tile.bits, "range_K": [255.0, 1644.0]}
    data["thermocouples"]["sensor"] = [sensor]
    data["stack"]["layer"][0]["thickness_m"] = tile.coating_mil * MIL_M
    data["heating"] = {"reference": "columns", "wall_enthalpy": {"cp_J_kgK": CP_J_KGK}}
    data["segments"] = {"fit": [list(FIT_S)]}
    data["reference_condition"] = {"alpha_deg": 40.0}
    return check(data, RecordFile, "tile")


def record(tile: Tile) -> Record:
    """The tile's flight as a record."""
    flown, declared = conditions(tile), declaration(tile)
    t = flown.time_s[(flown.time_s >= 20.0) & (flown.time_s <= END_S - 20.0)] + tile.offset_s
    bare = make_record(declared, flown, {"time_s": t, "TC_K": np.full(len(t), 300.0)}, None, "tile")
    truth = {"ratio.d0": RATIO, "ratio.d_alpha": D_ALPHA, **tile.truth}
    model = replace(point_of_record(bare, truth), nodes=FINE_NODES)
    exact = predict(bare, model, skew_s=tile.skew_s, errors={"TC": SensorErrors(tau_s=tile.tau_s)}).indicated_K[0]
    read = exact
    if tile.noise_K > 0.0:
        read = measure(bare.sensors[0], exact, np.random.default_rng(tile.seed))
    return make_record(declared, flown, {"time_s": t, "TC_K": read}, None, "tile")


NOISE_8_BIT = Tile(noise_K=1.0, bits=8)
"""As the Orbiter's recorder had it."""
