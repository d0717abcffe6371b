"""Flight conditions by the names and units of a file: each kind has its right values, what follows is reported."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim_heating.base.errors import InputError
from sim_heating.base.files.units import converted
from sim_heating.heating.atmosphere import GAMMA, R_AIR, us76
from sim_heating.heating.recorded.derive import derived_conditions
from sim_heating.heating.recorded.fields import ConditionField, column_unit, field_of_name
from sim_heating.heating.recorded.layout import read_fields
from sim_heating.heating.recorded.reading import OPTION, lowered_confidence, read_flight
from sim_heating.heating.recorded.sounding import read_sounding
from tests.support.paths import ROOT

FLIGHTS = ROOT / "tests" / "data" / "flights"
COLUMNS = ("time_s", "altitude_m", "velocity_m_s", "mach", "log10_re", "rho_kg_m3", "T_inf_K", "p_inf_Pa")
TELEMETRY = {
    "altitude_m": ConditionField(field="altitude", unit="km"),
    "velocity_m_s": ConditionField(field="velocity", unit="m/s"),
}


SAMPLES = [(10 * k, 400_000 - 3000 * k, 24_500 - 200 * k, 40.0 - 0.5 * k) for k in range(12)]
"""Time [s], altitude [ft], velocity [ft/s], angle of attack [deg] of an entry."""
HEAD = "Time (s){0}Altitude (ft){0}Velocity (ft/s){0}Alpha (deg)\n"


def german(text: str) -> str:
    return text.translate(str.maketrans(",.", ".,"))


@pytest.mark.parametrize(
    ("head", "row"),
    [
        (HEAD.format(","), lambda t, h, v, a: f'{t},"{h:,}","{v:,}",{a}'),
        (HEAD.format(";"), lambda t, h, v, a: f"{t};{h:,};{v:,};{a}"),
        (HEAD.format(";"), lambda t, h, v, a: german(f"{t};{h:,.1f};{v:,.1f};{a}")),
        (HEAD.format(" ").replace(" (", "("), lambda t, h, v, a: f"{t:.1E} {h:.6E} {v:.5E} {a:.3E}".replace("E", "D")),
        ("Time,Altitude,Velocity,Alpha\n", lambda t, h, v, a: f"{t} s,{h} ft,{v} ft/s,{a} deg"),
        (
            HEAD.format(",").replace(" (s)", ""),
            lambda t, h, v, a: f"2024-05-13 23:5{8 + t // 60}:{t % 60:02d},{h},{v},{a}",
        ),
        (
            HEAD.format(",").replace(" (s)", ""),
            lambda t, h, v, a: f"{23 + t // 60:02d}:{(59 + t // 60) % 60:02d}:{t % 60:02d},{h},{v},{a}".replace(
                "24:", "00:", 1
            ),
        ),
        ("Range file\nFlight 12, 2024\n\n" + HEAD.format(","), lambda t, h, v, a: f"{t},{h},{v},{a}"),
    ],
    ids=["quoted thousands", "thousands", "German", "Fortran", "units in cells", "dates", "clock", "lines above"],
)
def test_a_range_file_is_read_by_one_layout_of_its_cells(tmp_path, head, row):
    path = tmp_path / "range.txt"
    path.write_text(head + "".join(f"{row(*sample)}\n" for sample in SAMPLES))
    columns = read_flight(path, ("time_s", "altitude_m", "velocity_m_s", "alpha_deg")).table.columns
    for column, k, factor in (
        ("time_s", 0, 1.0),
        ("altitude_m", 1, 0.3048),
        ("velocity_m_s", 2, 0.3048),
        ("alpha_deg", 3, 1.0),
    ):
        np.testing.assert_allclose(columns[column], [factor * sample[k] for sample in SAMPLES], rtol=1e-5)


@pytest.mark.parametrize(
    ("head", "second", "said"),
    [
        (
            "Altitude (m)",
            "390000 ft",
            "row 2, column Altitude (m): `400000 ft` has another unit than the column states, `m`",
        ),
        ("Altitude", "118.9 km", "row 3, column Altitude: `118.9 km` is no number in the layout of the file"),
    ],
)
def test_a_condition_in_two_units_is_refused_with_its_cell(tmp_path, head, second, said):
    path = tmp_path / "range.csv"
    path.write_text(f"Time (s),{head},Velocity (m/s)\n0,400000 ft,7500\n10,{second},7400\n20,380000 ft,7300\n")
    with pytest.raises(InputError) as refusal:
        read_flight(path, ("time_s", "altitude_m", "velocity_m_s"))
    assert said in str(refusal.value)


# Each kind of file ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("file", "fields"),
    [
        ("openrocket_descent.csv", {}),
        ("jsbsim_out.csv", {}),
        ("telemetry_km.csv", TELEMETRY),
        ("own_columns.csv", {}),
        ("own_columns_units_names.csv", {}),
    ],
)
def test_each_layout_is_the_same_descent(file, fields):
    table = read_flight(FLIGHTS / file, COLUMNS, fields=fields).table
    for name, first, last in (
        ("time_s", 300.0, 359.0),
        ("altitude_m", 100e3, 5041.3),
        ("velocity_m_s", 1400.0, 1167.54),
    ):
        assert table[name][[0, -1]] == pytest.approx([first, last], rel=1e-4), name
    assert len(table) == 119


def test_density_of_a_rocket_export_follows_from_its_pressure():
    table = read_flight(FLIGHTS / "openrocket_descent.csv", COLUMNS).table
    assert table["T_inf_K"][-1] == pytest.approx(243.15)
    assert table["p_inf_Pa"][-1] == pytest.approx(50307.0)
    assert table["rho_kg_m3"][-1] == pytest.approx(50307.0 / (287.05287 * 243.15))


def test_density_in_slugs_of_a_simulator_is_kept():
    flight = read_flight(FLIGHTS / "jsbsim_out.csv", COLUMNS)
    assert flight.table["rho_kg_m3"][[0, -1]] == pytest.approx([1.13833e-6, 0.608206], rel=1e-5)
    assert not flight.has_model_density
    assert "`Time` states no unit: s assumed, as its steps and the change of altitude allow" in flight.notes


def test_density_beside_an_altitude_is_of_the_standard_atmosphere_and_told():
    flight = read_flight(FLIGHTS / "own_columns.csv", COLUMNS)
    assert flight.table["rho_kg_m3"] == pytest.approx(us76(flight.table["altitude_m"])[2])
    assert flight.has_model_density
    assert "rho_kg_m3 of the standard atmosphere at altitude_m" in flight.notes


def test_units_that_no_name_states_are_asked_in_one_line():
    with pytest.raises(InputError) as refused:
        read_flight(FLIGHTS / "telemetry_km.csv", (*COLUMNS, "alpha_deg"), statement=OPTION)
    (line,) = refused.value.problems
    assert "needs the units of `velocity`, `altitude` and alpha_deg" in line
    assert "--field velocity_m_s=velocity:m/s --field altitude_m=altitude:km --field alpha_deg=NAME" in line


def test_lines_of_json_are_read(tmp_path):
    lines = [{"time": t, "velocity_m_s": 1400.0, "altitude (km)": 90.0 - t, "stage": "entry"} for t in (0.0, 1.0, 2.0)]
    (tmp_path / "f.json").write_text("\n".join(map(json.dumps, lines)))
    flight = read_flight(tmp_path / "f.json", COLUMNS)
    assert flight.table["altitude_m"] == pytest.approx([90e3, 89e3, 88e3])
    assert "not used: `stage`" in flight.notes


@pytest.mark.parametrize("stamp", ["{t}", "2024-05-13 10:45:{t:02d}"])
def test_rows_from_the_newest_to_the_first_are_read_from_the_last(tmp_path, stamp):
    samples = [(stamp.format(t=t), 90.0 - t) for t in range(9, -1, -1)]
    head = "Time (s)" if stamp == "{t}" else "Date"
    (tmp_path / "f.csv").write_text(f"{head},alt_km,velocity_m_s\n" + "".join(f"{t},{z},1400\n" for t, z in samples))
    flight = read_flight(tmp_path / "f.csv", COLUMNS)
    assert flight.table["time_s"] == pytest.approx(np.arange(10.0))
    assert flight.table["altitude_m"] == pytest.approx(90e3 - 1e3 * np.arange(10.0))
    assert flight.table.lines[0] == 11
    assert "the rows run back in time: read from the last" in flight.notes


def test_a_clock_that_is_stated_to_be_the_time_is_read(tmp_path):
    """Two columns of clocks, and no field that is called time."""
    rows = "".join(f"13 May 2024 10:45:0{t}.000,2024-05-13 12:45:0{t},90,1400\n" for t in range(9))
    (tmp_path / "f.csv").write_text("Sat.UTCGregorian,local,alt_km,velocity_m_s\n" + rows)
    with pytest.raises(InputError, match="--field time_s=NAME"):
        read_flight(tmp_path / "f.csv", COLUMNS, statement=OPTION)
    flight = read_flight(tmp_path / "f.csv", COLUMNS, fields={"time_s": "Sat.UTCGregorian"})
    assert flight.table["time_s"] == pytest.approx(np.arange(9.0))


@pytest.mark.parametrize(
    ("head", "row"),
    [
        (
            "Sat.UTCGregorian              Sat.Altitude (km)  Sat.Speed (km/s)",
            "13 May 2024 10:45:{t:02.0f}.000    {z}    1.4",
        ),
        ("Time (UTCG),Alt (KM),Speed (KM/SEC)", "13 May 2024 10:45:{t:02.0f}.000,{z},1.4"),
        ("TIME (SEC),ALT (KM),VEL (FT/SEC)", "{t},{z},4593.1758530"),
        ('"Time\n(s)","Altitude\n(km)","Speed\n(m/s)"', "{t},{z},1400"),
        ("min,km,m/s\nTime,Altitude,Velocity", "{m:.9f},{z},1400"),
        ('VARIABLES = "Time (s)", "Altitude (km)"\n"Speed (m/s)"\nZONE I=9, DATAPACKING=POINT', "{t} {z} 1400.0"),
        ("GMT,Alt (km),V (m/s)", "134:10:45:{t:02.0f}.000,{z},1400"),
    ],
    ids=["wide blanks", "UTCG", "capitals", "names on two lines", "units above", "Tecplot", "day of the year"],
)
def test_a_simulator_s_list_is_read(tmp_path, head, row):
    (tmp_path / "f.txt").write_text(
        head + "\n" + "".join(row.format(t=float(t), m=t / 60.0, z=90.0 - t) + "\n" for t in range(9))
    )
    fields = {"altitude_m": "Sat.Altitude (km)", "velocity_m_s": "Sat.Speed (km/s)"} if "Sat" in head else {}
    table = read_flight(tmp_path / "f.txt", COLUMNS, fields=fields).table
    assert table["time_s"] == pytest.approx(np.arange(9.0), abs=1e-6)
    assert table["altitude_m"] == pytest.approx(90e3 - 1e3 * np.arange(9.0))
    assert table["velocity_m_s"] == pytest.approx(np.full(9, 1400.0))


def test_a_date_in_days_is_counted_from_the_first_row(tmp_path):
    rows = "".join(f"{30443.947916667 + t / 86400.0:.10f},{90 - t},1400\n" for t in range(9))
    (tmp_path / "f.csv").write_text("A1ModJulian,alt_km,velocity_m_s\n" + rows)
    flight = read_flight(
        tmp_path / "f.csv", COLUMNS, fields={"time_s": ConditionField(field="A1ModJulian", unit="day")}
    )
    assert flight.table["time_s"] == pytest.approx(np.arange(9.0), abs=1e-4)
    assert "`A1ModJulian` is a date: counted from the earliest row" in flight.assumed


@pytest.mark.parametrize("name", ["rho x 1e6 (kg/m3)", "rho_kg_m3*1e6", "rho (1e-6 kg/m3)"])
def test_a_density_with_a_factor_is_asked_and_not_replaced(tmp_path, name):
    (tmp_path / "f.csv").write_text(f"time_s,alt_km,velocity_m_s,{name}\n0,60,100,300\n1,60,100,300\n2,60,100,300\n")
    with pytest.raises(InputError, match=r"rho_kg_m3=rho.*:UNIT"):
        read_flight(tmp_path / "f.csv", COLUMNS, statement=OPTION)
    stated = {"rho_kg_m3": ConditionField(field=name, unit="mg/m3")}
    assert read_flight(tmp_path / "f.csv", COLUMNS, fields=stated).table["rho_kg_m3"] == pytest.approx([3e-4] * 3)


def test_nm_is_asked_for_in_a_flight():
    assert field_of_name("Alt (nm)").unit is None
    assert field_of_name("Alt (nmi)").convert.factor == pytest.approx(1852.0)


def test_names_of_a_trajectory_library_are_read(tmp_path):
    """The heads that RocketPy writes."""
    head = "# Time (s), Altitude ASL (m), Freestream Speed (m/s), Mach Number, Angle of Attack (°), Pressure (Pa)"
    (tmp_path / "f.csv").write_text(
        f"{head}\n0.0, 1000.0, 300.0, 0.9, 2.0, 90000\n1.0, 1290.0, 310.0, 0.93, 1.0, 87000\n"
    )
    table = read_flight(tmp_path / "f.csv", (*COLUMNS, "alpha_deg")).table
    assert table["alpha_deg"] == pytest.approx([2.0, 1.0])
    assert table["p_inf_Pa"] == pytest.approx([90000.0, 87000.0])


def test_semicolons_decimal_commas_and_a_row_of_units_are_read(tmp_path):
    (tmp_path / "f.csv").write_text("Time;Altitude;Velocity\ns;km;km/s\n0,0;60,5;7,1\n1,0;60,4;7,05\n")
    table = read_flight(tmp_path / "f.csv", COLUMNS).table
    assert table["altitude_m"] == pytest.approx([60500.0, 60400.0])
    assert table["velocity_m_s"] == pytest.approx([7100.0, 7050.0])


def test_two_altitudes_that_differ_are_asked(tmp_path):
    (tmp_path / "f.csv").write_text("time_s,alt_ft,alt_km,velocity_m_s\n0,1000,5,100\n1,1000,5,100\n")
    with pytest.raises(InputError, match="`alt_ft` and `alt_km` may both be altitude_m, and differ; name one: --field"):
        read_flight(tmp_path / "f.csv", COLUMNS)


def test_a_cell_without_a_number_is_named(tmp_path):
    (tmp_path / "f.csv").write_text("time_s,alt_km,velocity_m_s\n0,60,100\n1,,100\n")
    with pytest.raises(InputError, match="row 3, column alt_km: the cell holds no number"):
        read_flight(tmp_path / "f.csv", COLUMNS)


def test_a_unit_that_is_not_known_is_asked_and_never_dropped():
    assert field_of_name("Pressure [mV]").unit is None
    assert field_of_name("Altitude (MSL)").unit is None
    assert field_of_name("Altitude AGL (ft)") is None


# Spellings of units ---------------------------------------------------------------------------------------------------

SPELLINGS = {
    "altitude_m": (("altitude", "alt", "Altitude ASL", "h", "Height"), ("m", "ft", "km", "feet", "kft", "nmi", "mi")),
    "velocity_m_s": (
        ("velocity", "vel", "V", "Total velocity", "true airspeed", "V_{Total}"),
        ("m/s", "ft/s", "fps", "km/s", "knots", "kt", "kts", "mph", "km/h", "ft/sec"),
    ),
    "rho_kg_m3": (("rho", "density", "Air density"), ("kg/m3", "kg/m^3", "slug/ft3", "slugs/ft^3", "g/cm3", "lb/ft3")),
    "T_inf_K": (("T_inf", "Air temperature", "temp"), ("K", "degC", "°C", "degF", "degR", "R", "F", "C")),
    "p_inf_Pa": (("p_inf", "Air pressure", "P_{Ambient}"), ("Pa", "hPa", "kPa", "mbar", "psf", "psi", "atm")),
    "alpha_deg": (("alpha", "AoA", "Angle of attack"), ("deg", "rad", "°", "degrees")),
    "time_s": (("time", "Time", "t", "mission time"), ("s", "ms", "min", "h", "sec")),
    "q_Pa": (("q", "q bar", "Dynamic pressure"), ("kPa", "psf")),
}
"""Column -> names and units that tools write it with."""
WAYS = ("{name} ({unit})", "{name} [{unit}]", "{name}({unit})", "{name}, {unit}", "{name} {unit}")


@st.composite
def spelled(draw):
    column = draw(st.sampled_from(sorted(SPELLINGS)))
    names, units = SPELLINGS[column]
    name, unit = draw(st.sampled_from(names)), draw(st.sampled_from(units))
    ending = name.replace(" ", "_") + "_" + unit.replace("/", "_").replace("^", "")
    ways = [w.format(name=name, unit=unit) for w in WAYS] + ([] if "°" in unit or "{" in name else [ending])
    return column, unit, draw(st.sampled_from(ways))


@given(spelled())
def test_a_name_with_its_unit_is_that_column_in_that_unit(case):
    column, unit, name = case
    field = field_of_name(name)
    assert field is not None
    assert field.column == column
    assert field.convert == converted(unit, column_unit(column))


@given(st.sampled_from(sorted(SPELLINGS)), st.sampled_from(["mV", "counts", "V", "A", "bits", "Ohm"]))
def test_a_name_with_a_foreign_unit_is_never_read(column, unit):
    field = field_of_name(f"{SPELLINGS[column][0][0]} ({unit})")
    assert field is None or field.unit is None


# What follows from what is there --------------------------------------------------------------------------------------

STATE = {
    "altitude_m": np.array([30e3, 20e3]),
    "velocity_m_s": np.array([2000.0, 1500.0]),
    "T_inf_K": np.array([230.0, 215.0]),
    "rho_kg_m3": np.array([0.02, 0.09]),
}
STATE["p_inf_Pa"] = STATE["rho_kg_m3"] * R_AIR * STATE["T_inf_K"]
STATE["mach"] = STATE["velocity_m_s"] / np.sqrt(GAMMA * R_AIR * STATE["T_inf_K"])
STATE["q_Pa"] = 0.5 * STATE["rho_kg_m3"] * STATE["velocity_m_s"] ** 2


@pytest.mark.parametrize(
    ("name", "of"),
    [
        ("rho_kg_m3", ("q_Pa", "velocity_m_s")),
        ("rho_kg_m3", ("p_inf_Pa", "T_inf_K")),
        ("velocity_m_s", ("mach", "T_inf_K")),
        ("T_inf_K", ("p_inf_Pa", "rho_kg_m3", "velocity_m_s")),
        ("p_inf_Pa", ("rho_kg_m3", "T_inf_K", "velocity_m_s")),
        ("mach", ("velocity_m_s", "T_inf_K", "rho_kg_m3")),
    ],
)
def test_a_state_of_the_air_follows_from_two_others(name, of):
    found = derived_conditions({n: STATE[n] for n in ("altitude_m", *of)})
    assert found.columns[name] == pytest.approx(STATE[name])
    assert name not in found.of_model


def test_what_is_stated_is_never_replaced():
    found = derived_conditions({**STATE, "log10_re": np.array([5.0, 6.0])})
    for name in ("rho_kg_m3", "T_inf_K", "mach"):
        assert found.columns[name] is STATE[name]
    assert found.columns["log10_re"] == pytest.approx([5.0, 6.0])
    assert found.of_model == ()


def test_a_reynolds_number_is_that_of_its_reference_length():
    short, long = (derived_conditions(STATE, length_m=L).columns["log10_re"] for L in (1.0, 10.0))
    assert long - short == pytest.approx([1.0, 1.0])


def test_air_of_the_standard_atmosphere_lowers_the_confidence():
    assert [lowered_confidence(c) for c in ("A", "B", "C", "", "B: report 7")] == ["B", "C", "C", "C", "C: report 7"]


# Soundings ------------------------------------------------------------------------------------------------------------


def test_a_radiosonde_list_is_read_with_its_geopotential_heights():
    sounding = read_sounding(FLIGHTS / "wyoming_sounding.txt")
    z = np.array([1e3, 10e3, 25e3])
    standard = dict(zip(("T_inf_K", "p_inf_Pa", "rho_kg_m3"), us76(z), strict=True))
    air, notes = sounding.at(z, standard)
    assert air["T_inf_K"] == pytest.approx(standard["T_inf_K"] + 10.0, abs=0.3)
    assert air["p_inf_Pa"] == pytest.approx(standard["p_inf_Pa"], rel=0.01)
    assert notes == []


def test_a_profile_of_an_atmosphere_model_is_the_air_of_the_day():
    """1.2 times the standard density throughout, so that 1.2 times it is what a flight has."""
    flight = read_flight(FLIGHTS / "own_columns.csv", COLUMNS, sounding=read_sounding(FLIGHTS / "msis_profile.csv"))
    ratio = flight.table["rho_kg_m3"] / us76(flight.table["altitude_m"])[2]
    assert ratio == pytest.approx(1.2, rel=0.03)
    assert not flight.has_model_density


def test_above_a_sounding_the_standard_atmosphere_is_told():
    flight = read_flight(FLIGHTS / "own_columns.csv", COLUMNS, sounding=read_sounding(FLIGHTS / "wyoming_sounding.txt"))
    assert flight.has_model_density
    assert any("air above and below the sounding" in note for note in flight.notes)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("alt_km,T_K\n0,288\n10,220\n", "needs two of temperature, pressure and density"),
        ("alt,T_K,p_Pa\n0,288,1e5\n10,220,3e4\n", "needs the unit of `alt`"),
        ("alt_m,T_K,p_Pa\n0,288,1013\n10000,220,300\n", "check units of altitude, temperature and pressure"),
        ("alt_m,T_K,p_Pa\n0,15,1e5\n10000,-50,3e4\n", "T_inf_K is 15 at 0 m"),
    ],
)
def test_a_sounding_that_is_none_is_refused(tmp_path, text, message):
    (tmp_path / "s.csv").write_text(text)
    with pytest.raises(InputError, match=message):
        read_sounding(Path(tmp_path / "s.csv"))


def test_fields_that_are_no_condition_are_kept_apart():
    fields = read_fields(FLIGHTS / "openrocket_descent.csv")
    assert fields.unused == ("Vertical velocity (m/s)",)
    assert fields.empty == ("Angle of attack (°)",)


def test_a_column_of_clocks_without_a_name_is_the_time(tmp_path: Path) -> None:
    rows = "".join(f"2024-05-03T10:45:{2 * k:02d}Z,{7000 - k}\n" for k in range(9))
    (tmp_path / "flight.csv").write_text(f",Velocity (m/s)\n{rows}")
    fields = read_fields(tmp_path / "flight.csv")
    np.testing.assert_allclose(fields.columns["time_s"], 2.0 * np.arange(9.0))
