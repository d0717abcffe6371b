"""Flights as tools write them become records and scenarios: what follows is reported, what is absent asked at once."""

from __future__ import annotations

import os
import re
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner, Result

from sim_heating.base.errors import InputError
from sim_heating.base.files import read_csv_columns
from sim_heating.base.files.schema import schema_line
from sim_heating.cli import cli
from sim_heating.heating.atmosphere import us76
from sim_heating.inputs.points import conditions_of_record
from sim_heating.inputs.record import load_record
from sim_heating.templates.starters import practice_bell
from tests.support.paths import ROOT

FLIGHTS = ROOT / "tests" / "data" / "flights"
PLATE = ("--layer", "copper 3 mm", "--emissivity", "0.9")
SPHERE = ("--reference", "sutton-graves", "--nose-radius", "0.3m", "--ratio", "1")


@pytest.fixture(autouse=True)
def empty_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def run(*arguments: Any) -> Result:
    return CliRunner().invoke(cli, list(map(str, arguments)))


def record(*more: Any, csv: Path = FLIGHTS / "flight_temps.csv", column: str = "TC1") -> Result:
    return run("new", "record", "--csv", csv, *PLATE, "--depth", f"{column}=back", *more, "--out", "made")


def descent() -> Path:
    """Readings along the descent of the files."""
    times = np.arange(300.0, 359.5, 1.0)
    path = Path("t.csv")
    path.write_text("Time (s),TC1 (K)\n" + "".join(f"{t:g},{300.0 + 0.5 * (t - 300.0):.1f}\n" for t in times))
    return path


def test_a_sphere_in_flight_is_heated_by_704_kW_m2_on_a_cold_wall():
    """Sutton and Graves (1971), k = 1.7415e-4: k sqrt(rho / r) V^3 at 2300 m/s, 0.0331 kg/m3 and 0.3 m."""
    made = record("--conditions", FLIGHTS / "flight_conditions.csv", *SPHERE)
    assert made.exit_code == 0, made.exception
    flown = conditions_of_record(load_record("made"))
    cold_wall_J_kg = 1004.5 * 300.0
    q = flown["h_ref_kg_m2_s"][0] * (flown["H_r_J_kg"][0] - cold_wall_J_kg)
    assert q == pytest.approx(704e3, rel=0.01)


def test_a_wall_heated_from_the_first_reading_starts_there():
    made = record("--conditions", FLIGHTS / "flight_conditions.csv", *SPHERE)
    assert load_record("made").declared.stack.initial_K == 300.0
    assert "wall at 300 K at the start, the first reading, since it changes from there on" in made.output


NO_UNIT_OF_TIME = pytest.mark.filterwarnings("ignore:.*states no unit. s assumed:UserWarning")


def test_a_time_without_a_unit_is_a_warning():
    with pytest.warns(UserWarning, match="`Time` states no unit: s assumed"):
        record("--conditions", FLIGHTS / "jsbsim_out.csv", *SPHERE, csv=descent())


@NO_UNIT_OF_TIME
@pytest.mark.parametrize("file", ["jsbsim_out.csv", "own_columns.csv", "own_columns_units_names.csv"])
def test_a_descent_in_other_names_and_units_is_a_record(file: str):
    made = record("--conditions", FLIGHTS / file, *SPHERE, csv=descent())
    assert made.exit_code == 0, made.exception
    flown = load_record("made").conditions
    assert flown["altitude_m"][[0, -1]] == pytest.approx([100e3, 5041.3], rel=1e-4)
    assert flown["velocity_m_s"][[0, -1]] == pytest.approx([1400.0, 1167.54], rel=1e-4)
    assert "p_surface_Pa of the stagnation point, behind a normal shock" in made.output


@NO_UNIT_OF_TIME
def test_a_standard_density_lowers_the_confidence_of_a_record():
    record("--conditions", FLIGHTS / "own_columns.csv", *SPHERE, csv=descent())
    conditions = load_record("made").declared.conditions
    assert conditions.confidence == "C"
    assert conditions.uncertainty is not None
    assert conditions.uncertainty.density_relative == 0.15
    record("--conditions", FLIGHTS / "jsbsim_out.csv", *SPHERE, "--force", csv=descent())
    assert load_record("made").declared.conditions.confidence == ""


def test_a_sounding_is_the_air_of_the_day():
    sounding = FLIGHTS / "msis_profile.csv"
    made = record("--conditions", FLIGHTS / "own_columns.csv", "--atmosphere", sounding, *SPHERE, csv=descent())
    assert made.exit_code == 0, made.exception
    assert load_record("made").declared.conditions.confidence == ""
    assert load_record("made").conditions["rho_kg_m3"][-1] == pytest.approx(1.2 * 0.733, rel=0.03)


@NO_UNIT_OF_TIME
def test_all_that_a_telemetry_lacks_is_asked_at_once_and_then_works():
    telemetry = ("--conditions", FLIGHTS / "telemetry_km.csv", *SPHERE)
    refused = record(*telemetry, csv=descent())
    assert isinstance(refused.exception, InputError)
    (line,) = refused.exception.problems
    assert line.endswith(
        "needs the units of `velocity`, `altitude` and alpha_deg; give --field velocity_m_s=velocity:m/s "
        "--field altitude_m=altitude:km --field alpha_deg=NAME (or a constant, --field alpha_deg=0deg)"
    )
    stated = ("velocity_m_s=velocity:m/s", "altitude_m=altitude:km", "alpha_deg=0deg")
    made = record(*telemetry, *(x for text in stated for x in ("--field", text)), csv=descent())
    assert made.exit_code == 0, made.exception
    assert load_record("made").conditions["altitude_m"][0] == 100e3


@pytest.mark.parametrize(
    ("reference", "keys"),
    [
        (("eckert-turbulent", "--running-length", "0.8m"), {"running_length_m": 0.8}),
        (("swept-cylinder", "--nose-radius", "5cm", "--sweep", "45deg"), {"nose_radius_m": 0.05, "sweep_deg": 45.0}),
        (
            ("sutton-graves", "--nose-radius", "0.3m", "--recovery", "edge-laminar"),
            {"recovery": "edge-laminar", "local_angle_deg": 5.0},
        ),
    ],
)
def test_each_reference_heating_has_its_options(reference: tuple[str, ...], keys: dict[str, Any]):
    flight = ("--conditions", FLIGHTS / "flight_conditions.csv", "--local-angle", "5deg")
    made = record(*flight, "--reference", *reference, "--ratio", "1")
    assert made.exit_code == 0, made.exception
    heating = load_record("made").declared.heating
    assert {key: getattr(heating, key) for key in keys} == keys


def test_a_reference_without_its_length_names_the_option():
    refused = record("--conditions", FLIGHTS / "flight_conditions.csv", "--reference", "eckert-laminar")
    assert str(refused.exception) == '--reference: "eckert-laminar" needs --running-length; give it'


def test_options_of_a_flight_are_refused_without_one():
    for option in (("--atmosphere", "s.csv"), ("--field", "alpha_deg=0deg"), ("--running-length", "1m")):
        refused = record("--lamp", "2kW/m2", *option)
        assert str(refused.exception).startswith(f"{option[0]}: is of a flight; give --conditions")


@NO_UNIT_OF_TIME
def test_messages_on_a_flight_name_the_user_s_file_row_and_column():
    flight = (FLIGHTS / "jsbsim_out.csv").read_text().splitlines()
    k = [c.strip() for c in flight[0].split(",")].index("Rho (slugs/ft^3)")
    with pytest.warns(UserWarning, match=r"jsbsim_out\.csv, column Alpha \(deg\): is 0\.1 deg at most"):
        record("--conditions", FLIGHTS / "jsbsim_out.csv", *SPHERE, csv=descent())
    for density, said in (("-1", "-515.37"), ("9", "4638.41")):
        cells = flight[8].split(",")
        cells[k] = density
        Path("bad.csv").write_text("\n".join([*flight[:8], ",".join(cells), *flight[9:]]) + "\n")
        refused = record("--conditions", "bad.csv", *SPHERE, "--force", csv=descent())
        (line,) = [x for x in refused.exception.problems if "Rho" in x]
        assert line.startswith(f"bad.csv, row 9, column Rho (slugs/ft^3): {said}"), line


def test_a_field_without_numbers_is_named_where_its_column_is_asked_for():
    rows = (FLIGHTS / "own_columns.csv").read_text().splitlines()
    empty = [rows[0], *(",".join([*r.split(",")[:3], "NaN", r.split(",")[4]]) for r in rows[1:])]
    Path("f.csv").write_text("\n".join(empty).replace("alpha_deg", "AoA (deg)") + "\n")
    refused = record("--conditions", "f.csv", *SPHERE, csv=descent())
    assert "needs alpha_deg (`AoA (deg)` holds no numbers); give --field alpha_deg" in str(refused.exception)


# Records that exist ---------------------------------------------------------------------------------------------------


def test_a_record_without_air_derives_it_and_lowers_its_confidence():
    record("--conditions", FLIGHTS / "own_columns.csv", *SPHERE, csv=descent())
    text = Path("made/record.toml").read_text().replace('confidence = "C" ', 'confidence = "A" ')
    Path("made/record.toml").write_text(text)
    Path("made/conditions.csv").write_text((FLIGHTS / "own_columns.csv").read_text().replace("altitude_m", "alt_m"))
    with pytest.warns(UserWarning, match="rho_kg_m3 of the standard atmosphere"):
        found = load_record("made")
    assert found.declared.conditions.confidence == "B"
    assert found.conditions["altitude_m"][0] == 100e3


@NO_UNIT_OF_TIME
def test_altitudes_in_feet_in_a_column_of_metres_are_told():
    record("--conditions", FLIGHTS / "jsbsim_out.csv", *SPHERE, csv=descent())
    lines = Path("made/conditions.csv").read_text().splitlines()
    rows = [line.split(",") for line in lines]
    at = rows[0].index("altitude_m")
    for row in rows[1:]:
        row[at] = str(float(row[at]) / 0.3048)
    Path("made/conditions.csv").write_text("\n".join(map(",".join, rows)) + "\n")
    with pytest.raises(InputError, match=r"looks like ft: p_inf_Pa there is .* name the column `altitude_ft`"):
        load_record("made")


@pytest.mark.parametrize(("name", "of_us76"), [("p_inf_Pa", 1), ("rho_kg_m3", 2)])
def test_altitudes_in_feet_are_told_before_air_at_them_is_derived(name: str, of_us76: int) -> None:
    """At 45 km, whose feet are those of the thermosphere, where the air that is derived would be 300 K hotter."""
    z_m = 45e3 - 100.0 * np.arange(9)
    of_day = us76(z_m)[of_us76]
    lines = [f"{i},{z / 0.3048:.1f},2000,5,{x:.6g}" for i, (z, x) in enumerate(zip(z_m, of_day, strict=True))]
    Path("flight.csv").write_text("\n".join([f"time_s,altitude_m,velocity_m_s,alpha_deg,{name}", *lines]) + "\n")
    made = record("--conditions", "flight.csv", *SPHERE)
    said = rf"^flight\.csv, row 2, .* looks like ft: {name} there is .* at 45000 m"
    assert re.search(said, str(made.exception))


# Scenarios ------------------------------------------------------------------------------------------------------------

POD = ("--length", "2m", "--mass", "800kg", "--area", "3m2", "--nose-radius", "1.2m", "--point",
       "NOSE=RCG 0.4 mm / LI-900 60 mm / al2024 3 mm")  # fmt: skip


@pytest.mark.thorough
def test_a_trajectory_from_anywhere_stays_recorded(tmp_path: Path):
    assert run("new", "vehicle", *POD, "--out", "pod").exit_code == 0
    made = run("new", "scenario", "--vehicle", "pod", "--trajectory", FLIGHTS / "own_columns.csv", "--out", "flown")
    assert made.exit_code == 0, made.exception
    assert Path("flown/trajectory.csv").read_text().startswith("# source: recorded trajectory own_columns.csv\n")
    assert "rho_kg_m3 of the standard atmosphere at altitude_m" in made.output
    assert run("synthesize", "flown/scenario.toml", "--out", "flight").exit_code == 0
    conditions = tomllib.loads(Path("flight/record.toml").read_text())["conditions"]
    assert conditions["source"] == "recorded: trajectory.csv: recorded trajectory own_columns.csv"
    assert conditions["confidence"] == "C"


@NO_UNIT_OF_TIME
def test_a_scenario_states_fields_of_its_trajectory():
    assert run("new", "vehicle", *POD, "--out", "pod").exit_code == 0
    Path("t.csv").write_text((FLIGHTS / "telemetry_km.csv").read_text())
    stated = ("velocity_m_s=velocity:m/s", "altitude_m=altitude:km", "alpha_deg=-20deg", "beta_deg=0deg")
    fields = [x for text in stated for x in ("--field", text)]
    made = run("new", "scenario", "--vehicle", "pod", "--trajectory", "t.csv", *fields, "--out", "flown")
    assert made.exit_code == 0, made.exception
    declared = tomllib.loads(Path("flown/scenario.toml").read_text())["trajectory"]
    assert declared["fields"]["altitude_m"] == {"field": "altitude", "unit": "km"}
    assert declared["fields"]["alpha_deg"] == {"constant": -20.0}


def test_a_scenario_has_temperature_and_density_of_a_sounding():
    assert run("new", "vehicle", *POD, "--out", "pod").exit_code == 0
    flight, air = FLIGHTS / "own_columns.csv", FLIGHTS / "wyoming_sounding.txt"
    made = run("new", "scenario", "--vehicle", "pod", "--trajectory", flight, "--atmosphere", air, "--out", "flown")
    assert made.exit_code == 0, made.exception
    table = read_csv_columns("flown/trajectory.csv", ["time_s", "T_inf_K", "p_inf_Pa", "rho_kg_m3"])
    assert table["T_inf_K"][-1] == pytest.approx(us76(5041.3)[0] + 10.0, abs=0.3)
    assert table.header["confidence"] == "C"  # most of the flight is above the sounding
    assert table.header["source"].endswith("own_columns.csv, air of the sounding wyoming_sounding.txt")


def test_a_scenario_elsewhere_takes_its_root():
    os.makedirs("here/scenarios")
    os.makedirs("there")
    assert run("new", "vehicle", *POD, "--out", "there/pod").exit_code == 0
    made = run("new", "scenario", "--vehicle", "there/pod", "--out", "here/flown", "--root", ".")
    assert made.exit_code == 0, made.exception
    assert "sim-heating run here/flown/scenario.toml --out here/flown/run --root ." in made.output
    study = run("new", "study", "envelope", "--scenario", "here/flown/scenario.toml", "--out", "here/study")
    assert isinstance(study.exception, InputError)
    assert "name its folder with --root" in str(study.exception)
    study = run("new", "study", "envelope", "--scenario", "here/flown/scenario.toml", "--out", "here/study",
                "--root", ".")  # fmt: skip
    assert "sim-heating plan here/study/study.toml --out here/study/results --root ." in study.output
    bell = ("new", "effect", "nose-bell", "--vehicle", "there/pod", "--point", "NOSE", "--out", "here/effects")
    assert str(run(*bell).exception).startswith("here/effects/nose_bell.toml, `vehicle`: ")
    effect = run(*bell, "--root", ".")
    assert "sim-heating synthesize here/effects/nose_bell.toml --out practice --root ." in effect.output


def test_a_refused_scenario_leaves_no_trajectory():
    os.makedirs("here/scenarios")
    assert run("new", "vehicle", *POD, "--out", "pod").exit_code == 0
    flight, air = FLIGHTS / "own_columns.csv", FLIGHTS / "wyoming_sounding.txt"
    made = run("new", "scenario", "--vehicle", "pod", "--trajectory", flight, "--atmosphere", air,
               "--out", "here/flown")  # fmt: skip
    assert str(made.exception).startswith("here/flown/scenario.toml, `vehicle`: ")
    assert os.listdir("here") == ["scenarios"]


def test_a_vehicle_may_trim_at_a_negative_angle():
    made = run("new", "vehicle", *POD, "--alpha", "-20", "--out", "pod")
    assert made.exit_code == 0, made.exception
    assert run("new", "scenario", "--vehicle", "pod", "--out", "flown").exit_code == 0


def test_files_of_a_person_name_no_machine():
    assert schema_line("scenario") == "#:schema scenario.schema.json"


# Practice of an effect ------------------------------------------------------------------------------------------------


def test_a_practice_flight_is_centred_on_what_its_vehicle_flies():
    made = run("new", "effect", "nose-bell", "--variable", "alpha_deg", "--vehicle", "capsule", "--point", "FACE",
               "--out", "effects")  # fmt: skip
    assert made.exit_code == 0, made.exception
    text = Path("effects/nose_bell.toml").read_text()
    assert tomllib.loads(text)["truth"]["effect"][0]["parameters"]["centre"] == pytest.approx(20.0, abs=3.0)


def test_an_effect_that_a_practice_flight_does_not_show_is_refused():
    heat = np.full(100, 0.01)
    assert practice_bell(np.linspace(0.0, 25.0, 100), heat, (12.0, 2.0), (1.0, 30.0)) == (12.0, 2.0)
    assert practice_bell(np.linspace(0.0, 5.0, 100), heat, (12.0, 2.0), (1.0, 30.0)) == (2.5, 2.0)
    with pytest.raises(InputError, match="from 20 to 20"):
        practice_bell(np.full(100, 20.0), heat, (38.0, 3.0), (-10.0, 60.0))
