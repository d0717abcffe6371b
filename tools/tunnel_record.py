"""A transient run in a hypersonic wind tunnel as a flight record: felt behind a stainless-steel leading edge.

    python -m tools.tunnel_record

writes scenarios/records/tunnel_plate; `python -m tools.format_pages` then names its schema in it. The stream is
constant; the plate is pitched up and back, as the founding paper's reference 10 did it. Stream and dimensions of the
plate are this project's. The truth has the interface of the plate, marched, and beside it a lag of 3 s, as the paper
reports it of the run; its felt has the declared coating.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from sim_heating.base.conditions import Conditions
from sim_heating.base.files import check, read_toml_dict
from sim_heating.heating.effects import use
from sim_heating.heating.ratio.table import RatioTable
from sim_heating.inputs.points import conditions_of_record, point_of_record
from sim_heating.inputs.record import Record, RecordFile, make_record, write_record
from sim_heating.inputs.sensor_model import SensorErrors, measure
from sim_heating.march.history import march_points, values_at

ROOT = Path(__file__).resolve().parent.parent
OUT = ROOT / "scenarios" / "records" / "tunnel_plate"
MATERIALS = {
    "frsi-coating": "orbiter/materials",
    "frsi-felt": "orbiter/materials",
    "al2024": "orbiter/materials",
    "ss304": "materials",
}
SEED = 10
LAG_S = 3.0
"""Lag that the founding paper reports of the tunnel's thermocouple [s]."""
VELOCITY_M_S, T_INF_K, RHO_KG_M3, WALL_K = 1230.0, 105.0, 0.02, 310.0
"""Stream of Mach 6 with a total temperature of 860 K, and the wall before the run."""
PITCH_DEG, RATE_DEG_S, AT_S, HOLD_S, END_S = (5.0, 15.0), 2.0, 120.0, 5.0, 170.0
SAMPLES_HZ = 10.0
FIT_S = (100.0, END_S)
"""The manoeuvre and the time about it, when the wall has long been in the stream [s]."""
COMMENT = """A transient run in a wind tunnel, synthetic: `python -m tools.tunnel_record`.
Felt behind a leading edge of stainless steel on a flat plate, pitched from 5 to 15 deg and back in a stream of Mach 6.
The truth lags by 3 s, which the record does not state; dimensions and heating of the plate are choices."""


def declaration() -> RecordFile:
    """What the record states."""
    files = {name: ROOT / "aircraft_data" / folder / f"{name}.toml" for name, folder in MATERIALS.items()}
    steel = {"initial": "uniform", "initial_K": WALL_K, "back": "adiabatic",
             "layer": [{"material": "ss304", "thickness_m": 0.003175}]}  # fmt: skip
    felt = [
        {"material": "frsi-coating", "thickness_m": 0.000178},
        {"material": "frsi-felt", "thickness_m": 0.0102},
        {"material": "al2024", "thickness_m": 0.0025},
    ]
    data: dict[str, Any] = {
        "format": "flight-record/1",
        "title": "felt behind a steel leading edge, pitched in a wind tunnel",
        "flight": "tunnel",
        "control_point": "TUNNEL_FRSI",
        "measured": False,
        "source": "synthetic; interface and transient: founding paper, references 10 and 11; dimensions: ours",
        "confidence": "C",
        "conditions": {"source": "constant stream of Mach 6, total temperature 860 K"},
        "thermocouples": {
            "sensor": [
                {"name": "T1", "column": "T1_K", "depth_m": 0.000178, "noise_sigma_K": 0.3, "bits": 12,
                 "range_K": [250.0, 800.0]},
            ]
        },
        "segments": {"fit": [list(FIT_S)]},
        "stack": steel | {"layer": felt, "surroundings_K": 295.0},
        "materials": {name: read_toml_dict(file) for name, file in files.items()},
        "heating": {
            "reference": "columns",
            "nose_radius_m": 0.3048,
            "wall_enthalpy": {"cp_J_kgK": 1004.5},
            "ratio_table": "ratio_table.csv",
            "interface": {
                "upstream": "steel", "step_m": 0.1524, "point_m": 0.2032, "footprint_m": 0.005, "flow": "laminar",
                "stack": steel | {"surroundings_K": 295.0},
                "source": "plate of 6 in. of steel, thermocouple 2 in. behind the step: ours",
            },
        },
    }  # fmt: skip
    return check(data, RecordFile, "tunnel record")


def stream() -> Conditions:
    """The run, a row each time the pitch rate changes and ten a second in the manoeuvre, one a second before."""
    low, high = PITCH_DEG
    up_s = (high - low) / RATE_DEG_S
    corners = np.array([0.0, AT_S, AT_S + up_s, AT_S + up_s + HOLD_S, AT_S + 2.0 * up_s + HOLD_S, END_S])
    t = np.union1d(np.arange(0.0, FIT_S[0]), np.arange(FIT_S[0], END_S + 0.05, 1.0 / SAMPLES_HZ).round(3))
    t = np.union1d(t, corners)
    one = np.ones_like(t)
    sound = np.sqrt(1.4 * 287.05 * T_INF_K)
    H_r = 1004.5 * T_INF_K + np.sqrt(0.71) * 0.5 * VELOCITY_M_S**2
    columns = {
        "time_s": t, "altitude_m": 0.0 * one, "velocity_m_s": VELOCITY_M_S * one, "mach": VELOCITY_M_S / sound * one,
        "alpha_deg": np.interp(t, corners, [low, low, high, high, low, low]), "beta_deg": 0.0 * one,
        "log10_re": 6.5 * one, "elevon_deg": 0.0 * one, "bodyflap_deg": 0.0 * one, "rho_kg_m3": RHO_KG_M3 * one,
        "T_inf_K": T_INF_K * one, "p_inf_Pa": RHO_KG_M3 * 287.05 * T_INF_K * one, "p_surface_Pa": 2000.0 * one,
        "h_ref_kg_m2_s": 0.12 * one, "H_r_J_kg": H_r * one,
    }  # fmt: skip
    return Conditions(columns)


def table() -> RatioTable:
    """Film coefficient of the plate over the reference: it rises linearly with the angle of attack."""
    alpha, zero = np.array([0.0, 20.0]), np.array([0.0])
    ratio = (0.1 + 0.02 * alpha).reshape(2, 1, 1, 1, 1)
    return RatioTable((alpha, zero, np.array([6.5]), zero, zero), ratio, None, {"source": "choice of this project"})


def make() -> Record:
    """March the truth and measure it."""
    declared, flown, t = declaration(), stream(), np.arange(FIT_S[0] - 10.0, END_S, 1.0 / SAMPLES_HZ).round(3)
    empty = make_record(declared, flown, {"time_s": t, "T1_K": np.full_like(t, WALL_K)}, table(), OUT)
    lag = use("nonisothermal-wall", {"lag_s": LAG_S, "lag_fraction": 1.0, "overshoot": 0.0})
    (history,) = march_points([point_of_record(empty, effects=(lag,))], [conditions_of_record(empty)], extra_times_s=t)
    (true,) = values_at(history.time_s, history.sensors_K, t)
    read = measure(empty.sensors[0], true, np.random.default_rng(SEED), SensorErrors(), np.zeros(len(t), dtype=bool), t)
    return make_record(declared, flown, {"time_s": t, "T1_K": read}, table(), OUT)


if __name__ == "__main__":
    write_record(make(), OUT, {"time_s": ".1f", "T1_K": ".3f"}, COMMENT)
