"""`sim-heating new record`: from the CSV file of a data logger to a record that goes through every command."""

from __future__ import annotations

import json
import re
import shutil
import warnings
from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result

from sim_heating.base.errors import InputError, UnusualWarning
from sim_heating.base.files import read_toml
from sim_heating.cli import cli, main
from sim_heating.closure.close import close_loop
from sim_heating.estimation.fit import estimate
from sim_heating.inputs.record import load_record
from sim_heating.templates.materials import find_material, layer_input
from sim_heating.templates.measured_csv import FLUX, TEMPERATURE, TIME, read_measured_csv
from sim_heating.templates.quantities import quantity
from sim_heating.thermal.stack import Material
from tests.support.paths import AIRCRAFT, RECORDS
from tests.support.plates import FLUX_W_M2, PLATE, plate_K, write_logger_file


@pytest.fixture(autouse=True)
def in_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def run(*arguments: str) -> Result:
    return CliRunner().invoke(cli, [str(a) for a in arguments])


def refused(*arguments: str) -> str:
    """The one line with which a command refuses its input."""
    result = run(*arguments)
    assert isinstance(result.exception, InputError), result.output
    assert "\n" not in str(result.exception)
    return str(result.exception)


@pytest.mark.thorough
def test_a_heated_plate_goes_from_a_logger_file_to_a_closed_loop_without_an_edit() -> None:
    """A plate with 6 % more heat capacity than the library's copper: every command runs, and finds the 6 %."""
    time_s = np.arange(0.0, 301.0, 5.0)
    noise = np.random.default_rng(3).normal(0.0, 0.3, len(time_s))
    write_logger_file(Path("temps.csv"), time_s, plate_K(time_s, heat_capacity=1.06) + noise)
    made = run("new", "record", "--csv", "temps.csv", *PLATE, "--out", "plate")
    assert made.exit_code == 0, made.exception
    for shown in ("semicolons, decimal comma", "TC 1", "degC", "most cells hold no number", "copper: Incropera"):
        assert shown in made.output.replace("°C", "degC")
    assert "good" in run("validate", "plate").output

    assert run("predict", "plate", "--out", "predicted").exit_code == 0
    page = Path("predicted/report.html").read_text()
    assert '"absorbed from the lamp or the sun"' in page  # all terms of the balance at the surface
    assert '"bondline"' not in page  # a wall of one layer is bonded to nothing
    assert run("estimate", "plate", "--out", "fit").exit_code == 0
    fit = json.loads(Path("fit/estimate.json").read_text())
    for name, true in (("stack.copper.heat_capacity_factor", 1.06), ("stack.emissivity_factor", 1.0)):
        found = fit["parameters"][name]
        assert abs(found["value"] - true) < 3.0 * found["sigma"] + 0.002
    assert "does not inform it" in fit["not_estimated"]["stack.copper.conductivity_factor"]
    assert fit["fit"]["rmse_K"] == pytest.approx(0.3, rel=0.25)

    assert run("close-loop", "plate", "--out", "closed").exit_code == 0
    closed = json.loads(Path("closed/closure.json").read_text())
    named = {closed["effect"]["name"], *(name for names in closed["alternatives"] for name in names)}
    assert "heat-capacity" in named
    assert closed["after"]["fit"]["rmse_K"] < 0.2 * closed["before"]["fit"]["rmse_K"]


@pytest.mark.thorough
def test_the_loop_is_closed_on_the_means_of_very_many_readings() -> None:
    """60,000 readings 5 ms apart, heat capacity 6 % more than declared: the means of three tell it as all would."""
    time_s = 0.005 * np.arange(60_000)
    T_K = plate_K(time_s, heat_capacity=1.06) + np.random.default_rng(3).normal(0.0, 0.3, len(time_s))
    rows = (f"{t:.3f},{T:.3f}" for t, T in zip(time_s, T_K, strict=True))
    Path("temps.csv").write_text("Time (s),TC 1 (K)\n" + "\n".join(rows) + "\n")
    assert run("new", "record", "--csv", "temps.csv", *PLATE, "--noise", "0.3K", "--out", "plate").exit_code == 0
    closed = close_loop("plate").report
    means = "plate: 60000 readings averaged by 3 neighbours to 20000, with the noise of the mean"
    assert means in closed.warnings
    assert closed.record.sensors[0].noise_sigma_K == pytest.approx(0.3 / np.sqrt(3.0))
    assert closed.effects[0].name == "heat-capacity"
    factor = closed.effects[0].parameters["heat_capacity_factor"]
    assert abs(factor.value - 1.06) < 3.0 * factor.sigma + 0.002


def test_a_lamp_of_unknown_flux_is_estimated() -> None:
    """ratio.d0 is the absorbed flux in units of 10 kW/m2 where heat capacity and emittance are as declared."""
    time_s = np.arange(0.0, 301.0, 3.0)
    write_logger_file(
        Path("temps.csv"), time_s, plate_K(time_s) + np.random.default_rng(3).normal(0.0, 0.3, len(time_s))
    )
    arguments = ["unknown" if a == "18 kW/m2" else a for a in PLATE]
    with warnings.catch_warnings():
        warnings.simplefilter("error", UnusualWarning)  # an enthalpy that stands for a lamp is no odd one of a flow
        made = run("new", "record", "--csv", "temps.csv", *arguments, "--out", "plate")
    assert made.exit_code == 0, made.exception
    assert "unknown flux from 10 to 130 s" in made.output
    assert "good" in run("validate", "plate").output
    found = estimate(["plate"])
    value, sigma = found.parameters["ratio.d0"]
    assert abs(1e4 * value - FLUX_W_M2) < 3e4 * sigma + 20.0
    assert found.fit.converged


@pytest.mark.parametrize(
    ("text", "last_s", "last_K"),
    [
        ("time_s,TC_K\n0,293.15\n1,294.15\n2,295.15\n", 2.0, 295.15),
        ("\ufefft [ms]\tT_plate [°C]\n0\t20\n500\t21\n1000\t22\n", 1.0, 295.15),
        ("Time (min);Temp (F)\n0;68,0\n0,5;86,0\n", 30.0, 303.15),
        ("clock,plate\n10:00:00,20.0\n10:00:30,25\n10:01:00,30\n", 60.0, 303.15),
        ("2024-05-01T10:00:00,20.0\n2024-05-01T10:00:30,25\n", 30.0, 298.15),
        ("# logger\n# 2 channels\nElapsed time/s, TC1/K\n0, 300\n0.1, 301\n", 0.1, 301.0),
        ("Date Time,Temp F\n5/1/2024 10:00:00,70\n5/1/2024 10:00:01,88\n", 1.0, 304.26111111111),
        ("0 293.15\n1 294.15\n2 295.15\n", 2.0, None),
    ],
)
def test_separators_units_and_clocks_of_loggers_are_recognised(text: str, last_s: float, last_K: float | None) -> None:
    Path("t.csv").write_text(text, encoding="utf-8")
    guessed = (
        pytest.warns(UserWarning, match="no unit is stated")
        if not re.search("_K|°C|F|/K|2024-05", text)
        else nullcontext()
    )
    with guessed:
        found = read_measured_csv(Path("t.csv"), temperatures=("column2",) if last_K is None else ())
    assert found.of_kind(TIME)[0].si[-1] == pytest.approx(last_s)
    if "2024-05" not in text:  # without names no column is a temperature
        assert found.of_kind(TEMPERATURE)[0].si[-1] == pytest.approx(last_K or 295.15)


def test_a_guess_is_shown_with_its_reason_and_an_option_prevails() -> None:
    Path("t.csv").write_text("t,plate,q\n0,20,0.0\n1,21,20.0\n2,22,20.0\n")
    with pytest.warns(UserWarning, match="no unit is stated") as told:
        guessed = {c.name: c for c in read_measured_csv(Path("t.csv")).columns}
    assert [str(w.message) for w in told] == [
        "t.csv, column t: no unit is stated: s assumed (--time-unit)",
        "t.csv, column plate: no unit is stated, and readings begin as in a room: degC assumed (--temperature-unit)",
    ]  # the flux is told of where it is used
    assert (guessed["plate"].unit, guessed["q"].unit, guessed["t"].unit) == ("degC", "kW/m2", "s")
    assert "begins at 21: degC assumed" in guessed["plate"].reason
    stated = read_measured_csv(Path("t.csv"), time_unit="min", temperature_unit="degF")
    assert stated.of_kind(TEMPERATURE)[0].si[0] == pytest.approx(266.483, abs=1e-3)
    assert stated.of_kind(TIME)[0].si[-1] == 120.0
    assert stated.of_kind(FLUX)[0].si[-1] == 20e3
    assert read_measured_csv(Path("t.csv"), period_s=0.5, temperature_unit="C").of_kind(TIME)[0].si[-1] == 1.0


def test_samples_without_a_number_are_lost_samples_and_not_zeros() -> None:
    Path("t.csv").write_text("time_s,TC1_K\n0,300\n1,Open TC\n2,\n3,303\n")
    column = read_measured_csv(Path("t.csv")).of_kind(TEMPERATURE)[0]
    assert np.isnan(column.si).tolist() == [False, True, True, False]
    assert "2 lost samples (Open TC)" in column.reason


def test_the_flux_of_a_lamp_is_told_as_absorbed_and_as_incident() -> None:
    time_s = np.arange(0.0, 301.0, 5.0)
    write_logger_file(Path("temps.csv"), time_s, plate_K(time_s))
    plate = ["new", "record", "--csv", "temps.csv", *PLATE[:4], "--emissivity", "0.8", "--lamp", "20 kW/m2"]
    shown = " ".join(run(*plate, "--lit", "10,130", "--absorptance", "0.9", "--out", "plate").output.split())
    assert "heated by 18000 W/m2 absorbed, 0.9 of 20000 W/m2, from 10 to 130 s" in shown
    shown = " ".join(run(*plate, "--lit", "10,500", "--out", "late").output.split())
    assert "20000 W/m2 absorbed, from 10 to 500 s, which is after the last reading, 300 s (--lit)" in shown


def test_a_lamp_may_be_a_column_of_the_file_or_a_file_of_its_own() -> None:
    Path("t.csv").write_text("time_s,TC_K,heat flux [kW/m2]\n0,300,0\n10,300,20\n20,310,20\n")
    arguments = (
        "--csv",
        "t.csv",
        "--layer",
        "stainless steel 304 2mm",
        "--depth",
        "TC=surface",
        "--absorptance",
        "0.9",
    )
    assert run("new", "record", *arguments, "--out", "a").exit_code == 0
    assert load_record("a").conditions["q_add_W_m2"][-1] == pytest.approx(18e3)
    Path("lamp.csv").write_text("time_s,flux_W_m2\n-5,0\n5,1000\n30,1000\n")
    assert run("new", "record", *arguments, "--lamp", "lamp.csv", "--out", "b").exit_code == 0
    assert load_record("b").conditions["q_add_W_m2"][-1] == pytest.approx(900.0)
    Path("short.csv").write_text("time_s,flux_W_m2\n0,1000\n5,1000\n")
    assert "covers 0 to 5 s" in refused("new", "record", *arguments, "--lamp", "short.csv", "--out", "c")
    assert "--lamp 20: has no unit; write" in refused("new", "record", *arguments, "--lamp", "20", "--out", "c")
    Path("torn.csv").write_text("time_s,flux_W_m2\n-5,0\n5,1000\n10,\n30,1000\n")
    line = refused("new", "record", *arguments, "--lamp", "torn.csv", "--out", "c")
    assert "torn.csv, row 4, column flux: holds no number; fill it" in line
    late = ("--lamp", "20 kW/m2", "--lit", "10000,130000")
    assert "the readings end at" in refused("new", "record", *arguments, *late, "--out", "c")


def test_a_tile_on_the_ground_takes_its_materials_from_the_library() -> None:
    """Porous insulation conducts by its pressure: that of the room, as a constant and no column."""
    Path("t.csv").write_text("time_s,T1_K,T2_K\n0,290,290\n60,700,300\n120,900,320\n")
    made = run(
        "new", "record", "--csv", "t.csv", "--layer", "RCG 0.38 mm", "--layer", "LI-900 2 in",
        "--layer", "Al 2024 0.1 in",
        "--depth", "T1=surface", "--depth", "T2=2.015in", "--lamp", "50kW/m2", "--out", "tile",
    )  # fmt: skip
    assert made.exit_code == 0, made.exception
    record = load_record("tile")
    assert [layer.material for layer in record.declared.stack.layer] == ["rcg", "li900", "al2024"]
    assert record.declared.stack.layer[1].thickness_m == 0.0508
    assert record.conditions["p_surface_Pa"][0] == pytest.approx(101325.0)
    assert record.conditions["q_add_W_m2"][0] == 50e3
    assert record.conditions.columns.keys() >= {"alpha_deg", "elevon_deg"}  # of a wall at rest, in no file


def test_a_flight_of_ones_own_takes_the_place_of_a_lamp() -> None:
    """Conditions of a flight, a stack of the library: the uncertainties in the file are no thermocouple."""
    flown = RECORDS / "sts96_480"
    arguments = (
        "--csv", flown / "thermocouples.csv", "--conditions", flown / "conditions.csv", "--layer", "RCG 12 mil",
        "--layer", "LI-900 2 in", "--layer", "al2024 0.1 in", "--depth", "STS96_480_surface=12mil", "--point", "TILE",
    )  # fmt: skip
    made = run("new", "record", *arguments, "--nose-radius", "1ft", "--out", "a")
    assert made.exit_code == 0, made.exception
    assert "surroundings at 0 K" in made.output
    record = load_record("a")
    assert [s.depth_m for s in record.sensors] == [pytest.approx(12 * 2.54e-5)]
    assert record.declared.heating.reference == "columns"
    said = refused("new", "record", *arguments, "--reference", "sutton-gravs", "--out", "b")
    assert said.startswith("--reference:")
    assert "did you mean `sutton-graves`?" in said


def test_depths_and_layers_that_are_missing_are_asked_for_on_a_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sim_heating.cli.new.record.interactive", lambda: True)
    Path("t.csv").write_text("time_s,TC_K\n0,300\n1,301\n2,302\n")
    answers = "copper 3 mm\n\nback\n2 kW/m2\n"
    made = CliRunner().invoke(cli, ["new", "record", "--csv", "t.csv", "--out", "a"], input=answers)
    assert made.exit_code == 0, made.exception
    assert load_record("a").sensors[0].depth_m == 0.003


def test_temperatures_of_ones_own_on_a_tile_that_has_flown() -> None:
    """Stack, flight and heating of a shipped record; one CSV file and no other edit. The noise is of a recorder."""
    flown = load_record(RECORDS / "sts96_480")
    T_C = flown.thermocouples["STS96_480_surface_K"] - 270.0
    rows = [f"{t:g};{T:.1f}" for t, T in zip(flown.time_s, T_C, strict=True)]
    Path("mine.csv").write_text("\n".join(["time [s];my tile [C]", *rows]))
    made = run("new", "record", "--csv", "mine.csv", "--like", RECORDS / "sts96_480", "--out", "mine")
    assert made.exit_code == 0, made.exception
    said = " ".join(made.output.split())
    assert "noise of my tile estimated (--noise 0.5K states it); the 6 K of sts96_480 are of its recorder" in said
    record = load_record("mine")
    assert [(s.column, s.depth_m, s.noise_sigma_K) for s in record.sensors] == [("my_tile_K", 0.000305, None)]
    assert record.thermocouples["my_tile_K"][0] == pytest.approx(T_C[0] + 273.15, abs=0.06)
    assert record.declared.heating == flown.declared.heating
    assert (record.declared.measured, record.declared.confidence) == (True, "")
    assert record.declared.source == "temperatures: mine.csv; stack, flight and heating: those of sts96_480"
    assert "confidence not stated" in said
    assert run("new", "record", "--csv", "mine.csv", "--like", "mine", "--synthetic", "--out", "made").exit_code == 0
    assert not load_record("made").declared.measured


def test_temperatures_in_a_shipped_record_are_replaced_by_one_file_and_one_name() -> None:
    shutil.copytree(RECORDS / "sts96_480", "mine")
    rows = Path("mine/thermocouples.csv").read_text().splitlines()[1::2]
    text = "\n".join(["time_s,TC1", *(",".join(row.split(",")[:2]) for row in rows)])
    Path("mine/thermocouples.csv").write_text(text)
    said = refused("validate", "mine")
    assert "no column `STS96_480_surface_K`; the file has `TC1`: change one of the names" in said
    declared = Path("mine/record.toml").read_text()
    Path("mine/record.toml").write_text(declared.replace("STS96_480_surface_K", "TC1"))
    assert "good" in run("validate", "mine").output
    assert len(load_record("mine").time_s) == len(rows)


def test_programs_get_what_was_made_as_one_object(capsys: pytest.CaptureFixture[str]) -> None:
    Path("t.csv").write_text("time_s,TC_K\n0,300\n1,301\n2,302\n")
    arguments = ["--csv", "t.csv", *PLATE[:2], "--depth", "TC=back", "--lamp", "2kW/m2", "--out", "a", "--json"]
    assert main(["new", "record", *arguments]) == 0
    found = json.loads(capsys.readouterr().out)
    assert {Path(f).name for f in found["files"]} >= {"record.toml", "conditions.csv", "thermocouples.csv"}
    assert found["results"]["next"][0].startswith("sim-heating predict")
    assert any("emittance" in line for line in found["results"]["assumed"])


PLAIN_PLATE = ("--layer", "copper 3 mm", "--depth", "TC=1mm", "--emissivity", "0.9")


def test_a_plate_that_cools_at_its_back_is_a_record() -> None:
    Path("t.csv").write_text("time_s,TC_K\n0,300\n1,301\n2,302\n")
    cooled = ("--back-film", "8W/m2K", "--back-temperature", "21degC")
    made = run("new", "record", "--csv", "t.csv", *PLAIN_PLATE, "--lamp", "2kW/m2", *cooled, "--out", "plate")
    assert made.exit_code == 0, made.output
    back = load_record("plate").declared.stack.back
    assert (back.h_W_m2K, back.T_K, back.emissivity) == (8.0, pytest.approx(294.15), 0.0)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--depth", "TC=1mm"), "--layer: is missing"),
        (("--layer", "coper 3 mm", "--depth", "TC=1mm"), "did you mean `copper`?"),
        (("--layer", "inconel 3 mm", "--depth", "TC=1mm"), "may be inconel-x, inconel625"),
        (("--layer", "copper 3", "--depth", "TC=1mm"), "the thickness has no unit"),
        (("--layer", "copper 3 kg", "--depth", "TC=1mm"), "`kg` is not a unit that converts to m"),
        (("--layer", "copper 3 mm"), "--depth TC=0.4mm"),
        (("--layer", "copper 3 mm", "--depth", "TC=4mm"), "outside the stack, which is 3 mm thick"),
        (("--layer", "copper 3 mm", "--depth", "TC=1"), "has no unit"),
        (("--layer", "copper 3 mm", "--depth", "TD=1mm"), "there is no such column in"),
        (("--layer", "copper 3 mm", "--depth", "TC=1mm"), "--lamp: is missing"),
        (("--layer", "copper 3 mm", "--depth", "TC=1mm", "--lamp", "20K"), "`K` is not a unit that converts to W/m2"),
        (("--layer", "copper 3 mm", "--depth", "TC=1mm", "--lamp", "flx"), "neither a flux"),
        (("--layer", "al2024 3 mm", "--depth", "TC=1mm", "--lamp", "2kW/m2"), "give --emissivity"),
        ((*PLAIN_PLATE, "--lamp", "1e12W/m2"), "--lamp: 1e+12 is not a flux in W/m2"),
        ((*PLAIN_PLATE, "--lamp", "2kW/m2", "--point", ""), "--point: "),
        ((*PLAIN_PLATE, "--conditions", "c.csv", "--reference", "fay"), '--reference: "fay" is not one of'),
        ((*PLAIN_PLATE, "--conditions", "c.csv", "--reference", "fay-riddell"), '"fay-riddell" needs --nose-radius'),
        (("--temperature", "TX"), "--temperature TX: there is no such column"),
        (("--time-unit", "mm"), "is not a unit of time"),
        (("--like", "x", "--lamp", "1kW/m2"), "--lamp: comes from the record of --like"),
        (("--like", "x", "--emissivity", "0.5"), "--emissivity: comes from the record of --like"),
        (("--like", "x", "--point", "plate"), "--point: comes from the record of --like"),
        ((*PLAIN_PLATE, "--conditions", "c.csv", "--lit", "0,1"), "--lit: is of a lamp"),
        ((*PLAIN_PLATE, "--lamp", "unknown", "--absorptance", "0.9"), "--absorptance: is of a known --lamp"),
    ],
)
def test_what_is_missing_or_wrong_is_said_in_one_line(arguments: tuple[str, ...], message: str) -> None:
    Path("t.csv").write_text("time_s,TC_K\n0,300\n1,301\n2,302\n")
    Path("c.csv").write_text(
        "time_s,altitude_m,velocity_m_s,alpha_deg,p_surface_Pa\n0,7e4,6e3,40,10\n2,7e4,6e3,40,10\n"
    )
    assert message in refused("new", "record", "--csv", "t.csv", *arguments, "--out", "out")
    assert not Path("out").exists()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("time_s,TC_K\n0,300\n1,301\n1,302\n", "row 4, column time: does not come after"),
        ("a,b\nx,y\n", "no rows of numbers"),
        ("time_s,TC_K\n0,300\n1,301,5\n2,302\n", "row 3: `1, 301, 5` does not have 2 cells"),
        ("u,v\n1,1\n1,2\n0,1\n", "no column is a time"),
        ("time_s,v\n1,1\n2,2\n3,1\n", "no column is a temperature"),
        ("time_s,TC\n1,-120\n2,-119\n3,-90\n", "in no unit that is known"),
    ],
)
def test_a_file_that_cannot_be_read_is_refused_with_its_row(text: str, message: str) -> None:
    Path("t.csv").write_text(text)
    assert message in refused("new", "record", "--csv", "t.csv", "--layer", "copper 3 mm", "--out", "out")


def test_materials_are_found_by_the_names_that_people_use() -> None:
    for name, own in (
        ("Copper", "copper"), ("LI-900", "li900"), ("RCG", "rcg"), ("aluminium 2024-T6", "al2024"),
        ("Aluminum 6061", "al6061"), ("kaowool", "kaowool-pm"),
        ("Stainless Steel 304", "ss304"), ("AISI 304", "ss304"), ("Inconel 625", "inconel625"),
        ("titanium 6Al-4V", "ti-6al-4v"),
    ):  # fmt: skip
        assert find_material(name)[0] == own, name
    assert layer_input('copper 0.125"').thickness_m == pytest.approx(3.175e-3)
    assert layer_input("LI-900, 15 mil").thickness_m == pytest.approx(3.81e-4)


@pytest.mark.parametrize("applied", ["0.63391 kg/m2", "633.91 g/m2", "0.063391 g/cm2"])
def test_a_coating_applied_by_weight_is_as_thick_as_its_density_says(applied: str) -> None:
    coating = layer_input(f"RCG {applied}")
    assert coating.thickness_m * coating.material.density_kg_m3 == pytest.approx(0.63391)


def test_every_general_material_states_its_source_and_can_be_an_outermost_layer() -> None:
    files = sorted((AIRCRAFT / "materials").glob("*.toml"))
    assert len(files) >= 8
    for file in files:
        material = read_toml(file, Material)
        assert material.source, file.name
        assert material.confidence in ("A", "B", "C"), file.name
        assert material.emissivity, file.name


def test_a_quantity_has_the_digits_that_were_typed() -> None:
    assert quantity("21 degC", "K", "--initial", "21degC") == 294.15
    assert quantity("0,4 mm", "m", "--depth", "0.4mm") == 4e-4
    assert quantity("1 BTU/ft2/s", "W/m2", "--lamp", "1kW/m2") == pytest.approx(11356.5, rel=1e-5)


LAMP = ("new", "record", "--csv", "t.csv", "--layer", "copper 3 mm", "--depth", "TC=back", "--lamp", "20kW/m2")


@pytest.mark.parametrize(
    ("option", "said"),
    [
        ("--surroundings=21", "--surroundings: `21` has no unit; write --surroundings 21degC"),
        ("--initial=21", "--initial: `21` has no unit; write --initial 21degC"),
        ("--back-temperature=0", "--back-temperature: `0` has no unit; write --back-temperature 21degC"),
        ("--noise=0.5", "--noise: `0.5` has no unit; write --noise 0.5K"),
        ("--initial=21K", "--initial 21K: is below 100 K and looks like Celsius"),
        ("--initial=-300degC", "--initial: `-300degC`: -26.85 is not a temperature in K"),
        ("--noise=-1K", "--noise: `-1K`: -1 is not a standard deviation of a temperature"),
        ("--emissivity=90", "--emissivity 90: must be from 0.001 to 1; is this %? write 0.9"),
        ("--layer=copper 30 m", "is not a thickness of a layer in m (1e-09 to 5); is this mm? write 0.03"),
    ],
)
def test_a_number_without_a_unit_or_out_of_range_is_refused_by_the_name_of_its_option(option: str, said: str) -> None:
    Path("t.csv").write_text("time_s,TC_K\n0,300\n1,301\n2,302\n")
    assert said in refused(*LAMP, option, "--out", "a")
    assert not Path("a").exists()


@pytest.mark.parametrize("lamp", ["20kW/m2", "unknown"])
@pytest.mark.parametrize("lit", [(), ("--lit", "0,2")])
def test_a_time_of_the_conditions_is_refused_by_the_row_of_the_readings(lamp: str, lit: tuple[str, ...]) -> None:
    Path("t.csv").write_text("time_s,TC_K\n0,300\n1,301\n2,302\n3000000,303\n")
    told = refused(*LAMP[:-1], lamp, *lit, "--out", "a")
    assert "t.csv, row 5, column time: 3e+06 is more than 1e+06 s after the first row" in told


@pytest.mark.parametrize("lit", [(), ("--lit", "0,2")])
def test_an_impossible_flux_is_refused_by_its_option(lit: tuple[str, ...]) -> None:
    Path("t.csv").write_text("time_s,TC_K\n0,300\n1,301\n2,302\n")
    assert refused(*LAMP[:-1], "20GW/m2", *lit, "--out", "a").startswith("--lamp: 2e+10 is not a flux in W/m2")


def test_temperatures_that_were_typed_are_among_what_was_used() -> None:
    Path("t.csv").write_text("time_s,TC_K\n0,300\n1,301\n2,302\n")
    made = run(*LAMP, "--surroundings", "21degC", "--initial", "26.85degC", "--noise", "1degC", "--out", "a")
    assert "surroundings at 294.15 K (--surroundings)" in made.output
    assert "wall at 300 K at the start (--initial)" in made.output
    assert load_record("a").sensors[0].noise_sigma_K == 1.0  # a difference of temperatures


def test_a_unit_that_contradicts_the_file_prevails_with_a_warning_that_names_both() -> None:
    Path("t.csv").write_text("time_s,TC [degC]\n0,20\n1,21\n2,22\n")
    said = r"t.csv, column TC: the file says degC, --temperature-unit says F; read as F"
    with pytest.warns(UserWarning, match=said):
        found = read_measured_csv(Path("t.csv"), temperature_unit="F")
    assert found.of_kind(TEMPERATURE)[0].si[0] == pytest.approx(266.483, abs=1e-3)
    read_measured_csv(Path("t.csv"), temperature_unit="C")  # another word for the same unit: no warning


def test_a_record_names_its_schema_and_no_machine() -> None:
    Path("t.csv").write_text("time_s,TC_K\n0,300\n1,301\n2,302\n")
    assert run(*LAMP, "--out", "a/b/c").exit_code == 0
    shutil.move("a/b/c", "moved")
    line = Path("moved/record.toml").read_text().partition("\n")[0]
    assert line == "#:schema record.schema.json"
