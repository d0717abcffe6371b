"""Flights as tools write them: units of their names, and what follows from what they state."""

from __future__ import annotations

import math
import tempfile
from pathlib import Path

import numpy as np
from click.testing import CliRunner

from sim_heating.base.conditions import Conditions
from sim_heating.base.files import CsvTable
from sim_heating.cli import cli
from sim_heating.heating.atmosphere import CP_AIR, R_AIR
from sim_heating.heating.recorded.derive import derived_conditions
from sim_heating.heating.recorded.fields import ConditionField
from sim_heating.heating.recorded.plausible import implied_length_m
from sim_heating.heating.recorded.reading import local_pressure, read_flight
from sim_heating.heating.recorded.sounding import read_sounding
from sim_heating.heating.reference.models import reference_heating
from sim_heating.inputs.record import load_record
from sim_heating.live.sources.mapping import FieldMapping
from sim_heating.live.spec import make_link
from sim_heating.live.types import Frame, Message
from tests.support.paths import DATA, RECORDS
from tests.support.verification.row import Row, within

FLIGHTS = DATA / "flights"
COLUMNS = (
    "time_s", "altitude_m", "velocity_m_s", "mach", "log10_re", "rho_kg_m3", "T_inf_K", "p_inf_Pa", "p_surface_Pa",
)  # fmt: skip
SLUG_FT3 = 14.5939029372 / 0.3048**3
"""One slug/ft3 in kg/m3: 1 slug is 1 lbf s2/ft."""
LAPSE, POWER = 0.0065, 9.80665 * 28.9644 / (8314.32 * 0.0065)
"""Lapse rate [K/m] and exponent of pressure of the US Standard Atmosphere 1976 below 11 km."""


def standard_below_11_km(altitude_m: float) -> tuple[float, float]:
    """Temperature [K] and density [kg/m3] of the US Standard Atmosphere 1976, in closed form."""
    height = 6356766.0 * altitude_m / (6356766.0 + altitude_m)
    T = 288.15 - LAPSE * height
    p = 101325.0 * (T / 288.15) ** POWER
    return T, p / (R_AIR * T)


def rows() -> list[Row]:
    """All of this subject."""
    pressure = local_pressure(None)
    jsbsim, rocket, columns = (
        read_flight(FLIGHTS / f"{file}.csv", COLUMNS, pressure=pressure).table
        for file in ("jsbsim_out", "openrocket_descent", "own_columns_units_names")
    )
    fields = {
        "altitude_m": ConditionField(field="altitude", unit="km"),
        "velocity_m_s": ConditionField(field="velocity", unit="m/s"),
    }
    telemetry = read_flight(FLIGHTS / "telemetry_km.csv", COLUMNS, fields=fields, pressure=pressure).table
    warm = read_flight(
        FLIGHTS / "own_columns.csv", COLUMNS, sounding=read_sounding(FLIGHTS / "msis_profile.csv"), pressure=pressure
    ).table
    T, rho = standard_below_11_km(5041.31)
    exact, digits = "digits of a conversion", "definition of the unit"
    state = {"altitude_m": np.array([3e4]), "velocity_m_s": np.array([2e3]), "q_Pa": np.array([4e4])}
    of_q = derived_conditions(state).columns["rho_kg_m3"][0]
    flown = read_flight(FLIGHTS / "flight_conditions.csv", COLUMNS).table
    return [
        within(1e-9, "JSBSim export, `Altitude ASL (ft)`", 328083.99 * 0.3048, jsbsim["altitude_m"][0], "m", digits,
               exact),
        within(1e-9, "JSBSim export, `V_{Total} (ft/s)`", 4593.176 * 0.3048, jsbsim["velocity_m_s"][0], "m/s", digits,
               exact),
        within(1e-6, "JSBSim export, `Rho (slugs/ft^3)`", 1.180115e-3 * SLUG_FT3, jsbsim["rho_kg_m3"][-1], "kg/m3",
               digits, exact),
        within(1e-9, "OpenRocket export, density of its pressure and temperature", 50307.0 / (R_AIR * 243.15),
               rocket["rho_kg_m3"][-1], "kg/m3", "gas law", exact),
        within(1e-9, "telemetry in km, stated by `--field`", 5041.0, telemetry["altitude_m"][-1], "m", digits, exact),
        within(1e-4, "density beside an altitude of 5.04131 km", rho, columns["rho_kg_m3"][-1], "kg/m3",
               "US76, eqs. 23, 33a, closed form", "digits of the altitude in the file"),
        within(1e-4, "temperature beside an altitude of 5.04131 km", T, columns["T_inf_K"][-1], "K",
               "US76, eq. 23, closed form", "digits of the altitude in the file"),
        within(0.02, "density of a sounding 1.2 times as dense", 1.2 * rho, warm["rho_kg_m3"][-1], "kg/m3",
               "the profile's own levels, 5 km apart", "logarithms linear between levels"),
        within(1e-12, "density of q = 40 kPa at 2000 m/s", 0.02, of_q, "kg/m3", "2 q / V^2", "rounding"),
        within(0.01, "flux on a wall of 300 K, sphere of 0.3 m at 26 km and 2300 m/s",
               1.7415e-4 * math.sqrt(0.0331 / 0.3) * 2300.0**3, _cold_wall(flown), "W/m2",
               "Sutton and Graves 1971, k sqrt(rho / r) V^3", "enthalpy of the wall and of the air at rest"),
        *_of_a_link(),
        Row("readings that rise by 5 K/s from 300 K, start of the wall", 300.0, _start(), 1e-9, "K", "first reading",
            "the reading itself"),
    ]  # fmt: skip


def _of_a_link() -> list[Row]:
    """Frames of a link on a record whose messages state altitude, speed and angle of attack alone, in feet."""
    record = RECORDS / "sts96_480"
    followed = make_link({"format": "link/1", "records": [str(record)]}, record / "link.toml")
    mapping = FieldMapping(followed)
    named = {"Altitude (ft)": 30e3 / 0.3048, "vel_ft_s": 2e3 / 0.3048, "AoA (deg)": 40.0}
    kept = ("beta_deg", "elevon_deg", "bodyflap_deg", "jets", "h_ref_kg_m2_s", "H_r_J_kg", "T_surroundings_K")
    rest = {n: float(load_record(record).conditions[n][0]) for n in kept}
    frames = [
        sample.values
        for k in range(4)
        for sample in mapping.apply(Message(0.0, b"", {"time_s": float(k), **named, **rest}))
        if isinstance(sample, Frame)
    ]
    air = (("T_inf_K", 226.509, "K"), ("p_inf_Pa", 1197.0, "Pa"), ("rho_kg_m3", 1.8410e-2, "kg/m3"))
    a, mu = 301.71, 1.4753e-5
    length = implied_length_m(load_record(record).conditions.columns)
    assert length is not None  # the record has a Reynolds number
    rows = [
        within(1e-4, f"link without {name}, at 30 km in ft", value, frames[0][name], unit,
               "US76, Table I, 30,000 m", "digits of the table")
        for name, value, unit in air
    ]  # fmt: skip
    return [
        *rows,
        within(1e-4, "link without mach, 2000 m/s at 30 km", 2e3 / a, frames[0]["mach"], "", "US76, Table III",
               "digits of the table"),
        Row("link without log10_re, 2000 m/s at 30 km", math.log10(1.8410e-2 * 2e3 * length / mu),
            frames[0]["log10_re"], 1e-4, "", "US76, Tables I and III, the record's length", "digits of the tables"),
    ]  # fmt: skip


def _cold_wall(flown: CsvTable) -> float:
    """Flux [W/m2] of the reference heating on a wall of 300 K."""
    film = reference_heating("sutton-graves", Conditions(flown.columns), nose_radius_m=0.3)
    return float(film.h_ref_kg_m2_s[0] * (film.H_r_J_kg[0] - CP_AIR * 300.0))


def _start() -> float:
    """Initial temperature [K] of the record that `new record` makes of a wall heated from its first reading."""
    with tempfile.TemporaryDirectory() as folder:
        made = Path(folder) / "made"
        arguments = ["--csv", str(FLIGHTS / "flight_temps.csv"), "--layer", "copper 3 mm", "--depth", "TC1=back",
                     "--conditions", str(FLIGHTS / "flight_conditions.csv"), "--reference", "sutton-graves",
                     "--nose-radius", "0.3m", "--emissivity", "0.9", "--out", str(made)]  # fmt: skip
        CliRunner().invoke(cli, ["new", "record", *arguments], catch_exceptions=False)
        return float(load_record(made).declared.stack.initial_K or 0.0)
