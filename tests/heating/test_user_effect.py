"""An effect in a file of one's own, outside the package: every command takes it up."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from sim_heating.base.errors import InputError
from sim_heating.base.files import read_csv_columns
from sim_heating.base.kernels.block import N_CONDITIONS
from sim_heating.cli import main
from sim_heating.closure.batch import record_job
from sim_heating.closure.search.candidates import candidates
from sim_heating.heating.effects import effects, flight
from sim_heating.inputs.points import conditions_of_record
from sim_heating.inputs.record import load_record
from sim_heating.inputs.scenario import load_scenario
from tests.support.paths import ROOT

POINT = "LOWER_FWD"
GROWTH = 0.15
SOURCE = '''
"""Heating grows with the angle of attack beyond what a table says, as its square."""

from sim_heating import Effect, Parameter, flight, njit


@njit
def steep(B, c, p, wall_K):
    return 1.0 + B[p] * (0.1 * (B[c + flight.alpha_deg] - 40.0)) ** 2


EFFECT = Effect(
    "own-steepness", "multiply", (Parameter("growth", "1", 0.0, 0.2, -1.0, 2.0, "at 10 deg from 40"),), steep,
    physics="test", source="test",
)
'''
SCENARIO = """
format = "scenario/1"
title = "Own effect"
vehicle = "orbiter"
control_points = ["{point}"]
{more}
[trajectory]
source = "entry-3dof"
[trajectory.initial]
altitude_m = 75000.0
velocity_m_s = 6500.0
gamma_deg = -0.5
heading_deg = 60.0
latitude_deg = 0.0
longitude_deg = 0.0
[trajectory.stop]
time_s = 300.0
[[trajectory.manoeuvre]]
kind = "popu"
at_time_s = 120.0
down_deg = 8.0
up_deg = 6.0
rate_deg_s = 1.0
hold_s = 4.0
[measurements]
seed = 1
"""
EFFECT = '[[{table}effect]]\nname = "own-steepness"\nparameters = {{ growth = {growth} }}\n'


@pytest.fixture(autouse=True)
def own_folder(tmp_path, monkeypatch):
    """A user's folder of effects, and the place where the user works."""
    folder = tmp_path / "effects"
    folder.mkdir()
    (folder / "steepness.py").write_text(SOURCE)
    monkeypatch.setenv("SIM_HEATING_EFFECTS", str(folder))
    monkeypatch.chdir(tmp_path)
    return folder


def scenario(name: str, more: str = "") -> str:
    Path(f"{name}.toml").write_text(SCENARIO.format(point=POINT, more=more))
    return f"{name}.toml"


def surface_K(folder: str) -> np.ndarray:
    return read_csv_columns(Path(folder) / "temperatures.csv", ("time_s", "surface_K"))["surface_K"]


def test_run_and_validate_take_it_from_a_scenario():
    plain, own = scenario("plain"), scenario("own", EFFECT.format(table="", growth=GROWTH))
    assert main(["validate", own]) == 0
    assert main(["run", plain, "--out", "plain"]) == 0
    assert main(["run", own, "--out", "own"]) == 0
    assert 5.0 < np.max(surface_K("own") - surface_K("plain")) < 200.0


def test_synthesize_hides_it_and_estimate_finds_it_again():
    assert main(["synthesize", scenario("truth", EFFECT.format(table="truth.", growth=GROWTH)), "--out", "record"]) == 0
    assert "own-steepness" not in Path("record/record.toml").read_text()
    names = "ratio.scale,ratio.d_alpha,effect.own-steepness.growth"
    assert main(["estimate", "record", "--parameters", names, "--out", "fit"]) == 0
    found = json.loads(Path("fit/estimate.json").read_text())["parameters"]["effect.own-steepness.growth"]
    assert abs(found["value"] - GROWTH) < 4.0 * found["sigma"] < 0.4 * GROWTH
    record = load_record("record")
    assert "own-steepness" in {c.name for c in candidates(record, conditions_of_record(record))}


def test_predict_takes_it_from_a_vehicle():
    assert main(["synthesize", scenario("truth", EFFECT.format(table="truth.", growth=GROWTH)), "--out", "record"]) == 0
    shutil.copytree(ROOT / "aircraft_data" / "orbiter", "orbiter")
    with Path(f"orbiter/control_points/{POINT}.toml").open("a") as file:
        file.write(f'\n[[effect]]\nname = "own-steepness"\nparameters = {{ growth = {GROWTH} }}\nsource = "test"\n')
    errors = []
    for options in ([], ["--vehicle", "orbiter"]):
        assert main(["predict", "record", "--out", f"p{len(options)}", *options]) == 0
        errors.append(json.loads(Path(f"p{len(options)}/summary.json").read_text())["fit"]["rmse_K"])
    assert errors[1] < 0.5 * errors[0]


CLOCK_EFFECT = """
from sim_heating import Effect, model_parameter

EFFECT = Effect("own-clock", "model", (model_parameter("recorder_lag_s", "clock.skew", sigma=2.0),))
"""


@pytest.mark.parametrize(
    ("needs", "flown", "looked_for"),
    [
        ((), {"mach": 8.0}, True),
        (("mach",), {}, True),
        (("mach",), {"mach": 8.0}, False),
        (("alpha_deg", "mach"), {"mach": 8.0}, False),
        (("axial_accel_g",), {}, False),
    ],
)
def test_an_effect_is_looked_for_only_where_the_variables_that_it_needs_vary(own_folder, needs, flown, looked_for):
    (own_folder / "steepness.py").write_text(SOURCE.replace("physics=", f"needs={needs}, physics="))
    record = load_record(ROOT / "scenarios" / "records" / "practice" / "p06")
    conditions = conditions_of_record(record).with_columns(**flown)
    assert ("own-steepness" in {c.name for c in candidates(record, conditions)}) is looked_for


def test_a_user_defined_clock_effect_is_looked_for_and_its_parameter_has_its_own_name(own_folder):
    (own_folder / "steepness.py").write_text(CLOCK_EFFECT)
    record = load_record(ROOT / "scenarios" / "records" / "practice" / "p06")
    (found,) = (c for c in candidates(record, conditions_of_record(record)) if c.name == "own-clock")
    assert found.names == ("clock.skew",)
    effect = effects()["own-clock"]
    assert effect.acts_on_clock
    assert effect.own_name("clock.skew") == "recorder_lag_s"


def test_a_file_that_is_wrong_is_told_with_its_line(own_folder, capsys):
    (own_folder / "broken.py").write_text("from sim_heating import Effect\n\nEFFECT = Effect(nme='x')\n")
    assert main(["run", scenario("plain"), "--out", "plain"]) == 0  # nobody asked for an effect
    assert main(["validate", scenario("own", EFFECT.format(table="", growth=GROWTH))]) == 2
    told = capsys.readouterr().err
    assert "broken.py, line 3: TypeError" in told
    assert "Traceback" not in told


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("EFFECT = 3\n", "EFFECT is a int; it must be an Effect"),
        ("def f(:\n", "line 1: SyntaxError"),
        ("import no_such_module\n", "line 1: ModuleNotFoundError: No module named 'no_such_module'$"),
        ("\nfrom sim_heating.moved import Effect\n", "line 2: .*; write `from sim_heating import Effect,"),
        ("from sim_heating.heating.effects import Try\n", "line 1: .*; write `from sim_heating import Effect,"),
        (
            "from sim_heating import Effect\nEFFECT = Effect('a', 'add', (), tries=3)\n",
            "`tries` is now `search_starts`",
        ),
        ("from sim_heating import Effect\nEFFECT = Effect('a', 'model', (), places=())\n", "with model_parameter"),
    ],
)
def test_what_is_no_effect_is_refused(own_folder, text, told):
    (own_folder / "wrong.py").write_text(text)
    with pytest.raises(InputError, match=told):
        effects()


def test_a_folder_that_is_not_there_is_told(monkeypatch, tmp_path, capsys):
    monkeypatch.setenv("SIM_HEATING_EFFECTS", str(tmp_path / "nowhere"))
    assert main(["validate", scenario("own", EFFECT.format(table="", growth=GROWTH))]) == 2
    assert "nowhere is not a directory" in capsys.readouterr().err


@pytest.mark.parametrize(
    "command", [["validate"], ["predict", "--out", "out"], ["estimate", "--out", "out"]], ids="".join
)
def test_every_command_is_told_of_it_whether_it_uses_effects_or_not(monkeypatch, tmp_path, capsys, command):
    monkeypatch.setenv("SIM_HEATING_EFFECTS", str(tmp_path / "nowhere"))
    assert main([*command, str(ROOT / "tests" / "data" / "records" / "tile")]) == 2
    told = capsys.readouterr().err.splitlines()
    assert told == [
        f"error: SIM_HEATING_EFFECTS: {tmp_path / 'nowhere'} is not a directory; name one that holds effects"
    ]


def test_study_is_told_of_a_folder_of_effects_that_is_not_there(monkeypatch, tmp_path, capsys):
    monkeypatch.setenv("SIM_HEATING_EFFECTS", str(tmp_path / "nowhere"))
    assert main(["validate", str(ROOT / "scenarios" / "studies" / "small_envelope.toml")]) == 2
    assert "SIM_HEATING_EFFECTS: " in (told := capsys.readouterr().err)
    assert "nowhere is not a directory" in told


def test_an_effect_that_has_the_name_of_another_is_refused_by_its_file(own_folder, capsys):
    own = scenario("own", EFFECT.format(table="", growth=GROWTH))
    (own_folder / "again.py").write_text(SOURCE)
    assert main(["validate", own]) == 2
    told = capsys.readouterr().err
    assert "steepness.py: " in told
    assert "again.py already has an effect `own-steepness`; give yours another name" in told
    (own_folder / "again.py").write_text(SOURCE.replace("own-steepness", "catalysis"))
    assert main(["validate", own]) == 2
    told = capsys.readouterr().err
    assert "again.py: the package already has an effect `catalysis`; give yours another name" in told


def test_the_example_peaks_at_its_mach_number_and_has_a_flight_to_try_it_on(monkeypatch):
    monkeypatch.setenv("SIM_HEATING_EFFECTS", str(ROOT / "examples" / "effects"))
    (hidden,) = load_scenario(ROOT / "examples" / "shock_passage.toml").effects("WING_LE", truth=True)
    effect, parameters = hidden.effect, np.array(hidden.values)
    rise, mach_there, _ = parameters
    flown = np.zeros(N_CONDITIONS)
    for mach, factor in ((mach_there, 1.0 + rise), (mach_there + 10.0, 1.0), (mach_there - 10.0, 1.0)):
        flown[flight.mach] = mach
        value = effect.kernel(np.concatenate([flown, parameters]), 0, N_CONDITIONS, 300.0)
        assert value == pytest.approx(factor, abs=1e-12)


INTERPRETED = """
from sim_heating import flight
from sim_heating.base.kernels.block import N_CONDITIONS
from sim_heating.heating.effects import effect
from sim_heating.heating.effects.compiled import effect_dispatcher
flown = [0.0] * N_CONDITIONS
flown[flight.mach] = 13.0
print(effect_dispatcher((effect("shock-passage"),)).function(0, [*flown, 0.25, 13.0, 1.5], 0, N_CONDITIONS, 300.0))
"""


def test_an_effect_is_heard_where_nothing_is_compiled():
    environment = os.environ | {
        "NUMBA_DISABLE_JIT": "1", "PYTHONPATH": str(ROOT), "SIM_HEATING_EFFECTS": str(ROOT / "examples" / "effects"),
    }  # fmt: skip
    command = [sys.executable, "-c", INTERPRETED]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    assert float(done.stdout) == 1.25


def test_a_record_is_closed_anew_where_an_effect_of_ones_own_has_changed(own_folder):
    record = ROOT / "scenarios" / "records" / "practice" / "p06"
    before = record_job(record, Path("out"))
    assert record_job(record, Path("out")) == before
    (own_folder / "steepness.py").write_text(SOURCE.replace("40.0", "38.0"))
    assert record_job(record, Path("out")).id != before.id
