"""A user-defined effect in a file outside the package: every command accepts it."""

from __future__ import annotations

import json
import os
import pickle
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import sim_heating as sh
from sim_heating.base.errors import InputError
from sim_heating.base.files import read_csv_columns
from sim_heating.cli import main
from sim_heating.closure.batch import record_job
from sim_heating.closure.search.trials.candidates import candidates
from sim_heating.heating.effects import Effect, effects, flight, model_parameter, use
from sim_heating.inputs.points import conditions_of_record, point_of_record
from sim_heating.inputs.record import load_record
from sim_heating.inputs.scenario import load_scenario
from sim_heating.simulation.predict import predict
from tests.support.paths import ROOT

POINT = "LOWER_FWD"
GROWTH = 0.15
SOURCE = '''
"""Heating that grows with the square of the angle of attack, in addition to its table."""

from sim_heating import Effect, Parameter, flight, njit


@njit
def steep(B, c, p, wall_K):
    return 1.0 + B[p] * (0.1 * (B[c + flight.alpha_deg] - 40.0)) ** 2


EFFECT = Effect(
    "alpha-growth", "multiply", (Parameter("growth", "1", 0.0, 0.2, -1.0, 2.0, "at 10 deg from 40"),), steep,
    physics="test", source="test",
)
'''
SCENARIO = """
format = "scenario/1"
title = "User-defined effect"
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
EFFECT = '[[{table}effect]]\nname = "alpha-growth"\nparameters = {{ growth = {growth} }}\n'


@pytest.fixture(autouse=True)
def effects_folder(tmp_path, monkeypatch):
    """A user's folder of effects, named in the environment; the working directory is the one above it."""
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


@pytest.mark.thorough
def test_run_and_validate_accept_it_in_a_scenario():
    plain, with_effect = scenario("plain"), scenario("with_effect", EFFECT.format(table="", growth=GROWTH))
    assert main(["validate", with_effect]) == 0
    assert main(["run", plain, "--out", "plain"]) == 0
    assert main(["run", with_effect, "--out", "with_effect"]) == 0
    assert 5.0 < np.max(surface_K("with_effect") - surface_K("plain")) < 200.0


@pytest.mark.thorough
def test_synthesize_puts_it_into_the_truth_and_estimate_recovers_it():
    assert main(["synthesize", scenario("truth", EFFECT.format(table="truth.", growth=GROWTH)), "--out", "record"]) == 0
    assert "alpha-growth" not in Path("record/record.toml").read_text()
    names = "ratio.scale,ratio.d_alpha,effect.alpha-growth.growth"
    assert main(["estimate", "record", "--parameters", names, "--out", "fit"]) == 0
    found = json.loads(Path("fit/estimate.json").read_text())["parameters"]["effect.alpha-growth.growth"]
    assert abs(found["value"] - GROWTH) < 4.0 * found["sigma"] < 0.4 * GROWTH
    record = load_record("record")
    assert "alpha-growth" in {c.name for c in candidates(record, conditions_of_record(record))}


@pytest.mark.thorough
def test_predict_applies_it_from_a_vehicle():
    assert main(["synthesize", scenario("truth", EFFECT.format(table="truth.", growth=GROWTH)), "--out", "record"]) == 0
    shutil.copytree(ROOT / "aircraft_data" / "orbiter", "orbiter")
    with Path(f"orbiter/control_points/{POINT}.toml").open("a") as file:
        file.write(f'\n[[effect]]\nname = "alpha-growth"\nparameters = {{ growth = {GROWTH} }}\nsource = "test"\n')
    errors = []
    for options in ([], ["--vehicle", "orbiter"]):
        assert main(["predict", "record", "--out", f"p{len(options)}", *options]) == 0
        errors.append(json.loads(Path(f"p{len(options)}/summary.json").read_text())["fit"]["rmse_K"])
    assert errors[1] < 0.5 * errors[0]


def test_a_prediction_with_one_goes_to_another_process(monkeypatch):
    """As one that `predict` marches in a copy: by name, as no import finds the functions of the user's file."""
    monkeypatch.setenv("SIM_HEATING_EFFECTS", str(ROOT / "examples" / "effects"))
    record = load_record(ROOT / "scenarios" / "records" / "practice" / "p06")
    kept = predict(record, point_of_record(record, effects=[use("shock-passage", {"rise": 0.4})]))
    sent = pickle.loads(pickle.dumps(kept))
    assert np.array_equal(sent.indicated_K, kept.indicated_K, equal_nan=True)
    assert sent.model.effects[0].effect is effects()["shock-passage"]
    assert sent.model.effects[0].effect.search_starts is not None


CLOCK_EFFECT = """
from sim_heating import Effect, model_parameter

EFFECT = Effect("recorder-lag", "model", (model_parameter("recorder_lag_s", "clock.skew", sigma=2.0),))
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
def test_an_effect_is_looked_for_only_where_the_variables_that_it_needs_vary(effects_folder, needs, flown, looked_for):
    (effects_folder / "steepness.py").write_text(SOURCE.replace("physics=", f"needs={needs}, physics="))
    record = load_record(ROOT / "scenarios" / "records" / "practice" / "p06")
    conditions = conditions_of_record(record).with_columns(**flown)
    assert ("alpha-growth" in {c.name for c in candidates(record, conditions)}) is looked_for


def test_a_user_defined_clock_effect_is_looked_for_and_its_parameter_has_its_own_name(effects_folder):
    (effects_folder / "steepness.py").write_text(CLOCK_EFFECT)
    record = load_record(ROOT / "scenarios" / "records" / "practice" / "p06")
    (found,) = (c for c in candidates(record, conditions_of_record(record)) if c.name == "recorder-lag")
    assert found.names == ("clock.skew",)
    effect = effects()["recorder-lag"]
    assert effect.acts_on_readings
    assert effect.own_name("clock.skew") == "recorder_lag_s"


def test_a_file_that_cannot_be_run_is_reported_with_its_line(effects_folder, capsys):
    (effects_folder / "broken.py").write_text("from sim_heating import Effect\n\nEFFECT = Effect(nme='x')\n")
    sh.run(scenario("plain"))  # uses no effect
    assert main(["validate", scenario("with_effect", EFFECT.format(table="", growth=GROWTH))]) == 2
    message = capsys.readouterr().err
    assert "broken.py, line 3: TypeError" in message
    assert "Traceback" not in message


def test_the_line_is_named_where_the_folder_is_relative_and_left_out_where_there_is_none(effects_folder, monkeypatch):
    monkeypatch.chdir(effects_folder)
    monkeypatch.setenv("SIM_HEATING_EFFECTS", ".")
    (effects_folder / "wrong.py").write_text("\nimport no_such_module\n")
    with pytest.raises(InputError, match=r"^wrong.py, line 2: ModuleNotFoundError"):
        effects()
    (effects_folder / "wrong.py").unlink()
    (effects_folder / "binary.py").write_bytes(b"x = '\0'\n")
    with pytest.raises(InputError, match=r"^binary.py: SyntaxError"):
        effects()


@pytest.mark.parametrize(
    ("text", "message"),
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
        (
            "from sim_heating import Effect\nEFFECT = Effect('a', 'model', (), needs=('machh',))\n",
            "`needs`: flight conditions have no column `machh`; did you mean `mach`",
        ),
    ],
)
def test_a_file_without_a_valid_effect_is_rejected(effects_folder, text, message):
    (effects_folder / "wrong.py").write_text(text)
    with pytest.raises(InputError, match=message):
        effects()


@pytest.mark.parametrize(
    ("old", "new", "hint"),
    [
        ("0.0, 0.2, -1.0, 2.0", "None, 0.2, -1.0, 2.0", "value=None.*the others numbers"),
        ("0.0, 0.2, -1.0, 2.0", "0.0, 0.2, float('nan'), 2.0", "bounds nan to 2"),
        ("0.0, 0.2, -1.0, 2.0", "5.0, 0.2, -1.0, 2.0", "the value within its bounds"),
        ('physics="test"', "physics=3", "`physics`: 3 is not a text"),
        ('physics="test"', "neutral=1.5", "`neutral`: 1.5 is not numbers by parameter"),
        ('physics="test"', "needs=[7]", r"`needs`: \[7\] is not names"),
        ('physics="test"', "search_starts=7", "`search_starts`: 7 is not a function"),
        ('"multiply"', '"times"', "'times' is not one of add, multiply, emittance, model"),
        ("EFFECT =", "raise SystemExit(3)\nEFFECT =", "SystemExit: 3"),
        ("steep(B, c, p, wall_K)", "steep(B, c, p)", r"steep\(B, c, p\) takes other .* write steep\(B, c, p, wall_K\)"),
        ("steep(B, c, p, wall_K)", "steep(alpha)", r"steep\(alpha\) takes other arguments than a kernel"),
    ],
)
def test_a_field_of_the_wrong_kind_is_refused_with_the_file(effects_folder, old, new, hint):
    assert old in SOURCE
    (effects_folder / "steep.py").write_text(SOURCE.replace(old, new))
    with pytest.raises(InputError, match=rf"steep\.py.*{hint}"):
        effects()


@pytest.mark.parametrize(
    ("old", "new", "what"),
    [
        ("@njit", "", "steep is not compiled; write @njit in the line above its `def`"),
        ("flight.alpha_deg", "flight.alpha", "flight has no `alpha`; did you mean `alpha_deg`?"),
        ("return 1.0 +", "1.0 +", "it returns nothing where a number is needed"),
        ("B[p]", "B[p + 1]", r"reads beyond its numbers: .* its parameters B\[p\] to B\[p \+ 0\]"),
    ],
)
def test_a_kernel_that_cannot_be_run_is_refused_with_what_to_write(effects_folder, capsys, old, new, what):
    (effects_folder / "steepness.py").write_text(SOURCE.replace(old, new))
    assert main(["validate", scenario("with_effect", EFFECT.format(table="", growth=GROWTH))]) == 2
    assert re.search(rf"effect `alpha-growth` \(.*steepness\.py\).*{what}", capsys.readouterr().err)


@pytest.mark.sample(1)
@pytest.mark.parametrize(
    ("value", "said"),
    [
        ("-1000.0 * B[p]", "is -150 at time_s 0; return a factor of 0 or above"),
        ("(B[c + flight.alpha_deg] - 60.0) ** 0.5", "is nan at time_s 0; return a factor of 0 or above"),
        ("math.sqrt(500.0 - wall_K)", "is nan at time_s 0 at a wall of 600 K; return a factor of 0 or above"),
    ],
)
def test_a_value_that_no_step_can_use_is_stated_with_effect_and_time(effects_folder, capsys, value, said):
    changed = re.sub(r"return .*", f"return {value}", SOURCE).replace("\nfrom", "\nimport math\n\nfrom", 1)
    if "wall_K" in value:
        changed = changed.replace("physics=", "needs_wall=True, physics=")
    (effects_folder / "steepness.py").write_text(changed)
    assert main(["run", scenario("with_effect", EFFECT.format(table="", growth=GROWTH)), "--out", "run"]) == 1
    message = capsys.readouterr().err
    assert re.search(rf"{POINT}: effect `alpha-growth` \(.*steepness\.py\): {re.escape(said)} for every input", message)


def with_root_of_negative(effects_folder: Path) -> None:
    """An effect that is no number below Mach 22, which most of a flight is."""
    source = re.sub(r"return .*", "return 1.0 + B[p] * math.sqrt(B[c + flight.mach] - 22.0)", SOURCE)
    (effects_folder / "steepness.py").write_text(source.replace("\nfrom", "\nimport math\n\nfrom", 1))


@pytest.mark.sample(1)
@pytest.mark.parametrize("noise", [(), ("--process-noise", "0.1")])
def test_an_estimate_names_the_effect_that_is_no_number(effects_folder, capsys, noise):
    with_root_of_negative(effects_folder)
    record, names = str(ROOT / "scenarios" / "records" / "practice" / "p06"), "ratio.scale,effect.alpha-growth.growth"
    assert main(["estimate", record, "--parameters", names, *noise, "--out", "fit"]) == 1
    assert re.search(r"failed: .*effect `alpha-growth` \(.*steepness\.py\): is nan at time_s", capsys.readouterr().err)
    assert not Path("fit").exists()


def test_a_search_leaves_out_an_effect_that_is_no_number_and_says_so(effects_folder):
    with_root_of_negative(effects_folder)
    record = load_record(ROOT / "scenarios" / "records" / "practice" / "p06")
    with pytest.warns(UserWarning, match=r"effect `alpha-growth` .*: is nan at time_s .*; it is not looked for"):
        tried = candidates(record, conditions_of_record(record))
    assert "alpha-growth" not in {c.name for c in tried}


STUDY = """
format = "study/1"
title = "User-defined effect"
vehicle = "orb"
control_points = ["{point}"]
[trajectory]{trajectory}
[dispersion]
flights = 8
scrambles = 2
index_flights = 4
[[dispersion.input]]
name = "entry.gamma_deg"
sigma = 0.02
"""


@pytest.mark.thorough
def test_a_study_names_the_effect_that_is_no_number(effects_folder, capsys):
    with_root_of_negative(effects_folder)
    shutil.copytree(ROOT / "aircraft_data" / "orbiter", "orb")
    declaration = Path("orb/vehicle.toml")
    declaration.write_text(declaration.read_text().replace('name = "orbiter"', 'name = "orb"'))
    with Path(f"orb/control_points/{POINT}.toml").open("a") as file:
        file.write('\n[[effect]]\nname = "alpha-growth"\nparameters = { growth = 0.1 }\nsource = "test"\n')
    trajectory = SCENARIO.split("[trajectory]")[1].split("[[trajectory.manoeuvre]]")[0]
    Path("study.toml").write_text(STUDY.format(point=POINT, trajectory=trajectory))
    assert main(["plan", "study.toml", "--out", "planned"]) == 1
    told = "".join(capsys.readouterr())
    assert re.search(rf"{POINT}: effect `alpha-growth` \(.*steepness\.py\): is nan at time_s", " ".join(told.split()))


@pytest.mark.thorough
def test_a_link_names_the_effect_that_is_no_number_and_goes_on(effects_folder, capsys):
    with_root_of_negative(effects_folder)
    shutil.copytree(ROOT / "aircraft_data" / "capsule", "capsule")
    with Path("capsule/control_points/FACE.toml").open("a") as file:
        file.write('\n[[effect]]\nname = "alpha-growth"\nparameters = { growth = 0.1 }\nsource = "test"\n')
    frames = [
        {"time_s": t, "altitude_m": 6e4, "velocity_m_s": 7000.0 - 40.0 * t, "alpha_deg": 20.0, "beta_deg": 0.0}
        for t in range(30)
    ]
    Path("t.jsonl").write_text("".join(json.dumps(frame) + "\n" for frame in frames))
    source = '[[source]]\nkind = "json-lines"\ntransport = "file"\nfile = "t.jsonl"\n'
    Path("link.toml").write_text(f'format = "link/1"\nvehicle = "capsule"\ncontrol_points = ["FACE"]\n{source}')
    assert main(["live", "link.toml", "--headless", "--out", "out"]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert re.search(
        r"FACE: effect `alpha-growth` \(.*steepness\.py\): is nan at time_s .*; nothing is estimated", said
    )


def test_lists_in_place_of_tuples_make_the_same_effect():
    values = {"name": "growth", "mode": "model"}
    parameter = model_parameter("factor", "stack.emissivity_factor")
    made = Effect(**values, parameters=[parameter], needs=["mach"])
    assert made == Effect(**values, parameters=(parameter,), needs=("mach",))
    assert len({made, made}) == 1


def test_a_missing_folder_is_reported(monkeypatch, tmp_path, capsys):
    monkeypatch.setenv("SIM_HEATING_EFFECTS", str(tmp_path / "nowhere"))
    assert main(["validate", scenario("with_effect", EFFECT.format(table="", growth=GROWTH))]) == 2
    assert "nowhere is not a directory" in capsys.readouterr().err


@pytest.mark.parametrize(
    "command", [["validate"], ["predict", "--out", "out"], ["estimate", "--out", "out"]], ids="".join
)
def test_every_command_reports_a_missing_folder_whether_it_uses_effects_or_not(monkeypatch, tmp_path, capsys, command):
    monkeypatch.setenv("SIM_HEATING_EFFECTS", str(tmp_path / "nowhere"))
    assert main([*command, str(ROOT / "tests" / "data" / "records" / "tile")]) == 2
    message = capsys.readouterr().err.splitlines()
    assert message == [
        f"error: SIM_HEATING_EFFECTS: {tmp_path / 'nowhere'} is not a directory; name one that holds effects"
    ]


def test_validating_a_study_reports_a_missing_folder(monkeypatch, tmp_path, capsys):
    monkeypatch.setenv("SIM_HEATING_EFFECTS", str(tmp_path / "nowhere"))
    assert main(["validate", str(ROOT / "scenarios" / "studies" / "small_envelope.toml")]) == 2
    assert "SIM_HEATING_EFFECTS: " in (message := capsys.readouterr().err)
    assert "nowhere is not a directory" in message


def test_an_effect_with_the_name_of_another_is_rejected_with_its_file(effects_folder, capsys):
    with_effect = scenario("with_effect", EFFECT.format(table="", growth=GROWTH))
    (effects_folder / "again.py").write_text(SOURCE)
    assert main(["validate", with_effect]) == 2
    message = capsys.readouterr().err
    assert "steepness.py: " in message
    assert "again.py already has an effect `alpha-growth`; give yours another name" in message
    (effects_folder / "again.py").write_text(SOURCE.replace("alpha-growth", "catalysis"))
    assert main(["validate", with_effect]) == 2
    message = capsys.readouterr().err
    assert "again.py: the package sim-heating already has an effect `catalysis`; give yours another name" in message


def test_the_example_peaks_at_its_mach_number_and_is_flown_by_its_scenario(monkeypatch):
    monkeypatch.setenv("SIM_HEATING_EFFECTS", str(ROOT / "examples" / "effects"))
    (hidden,) = load_scenario(ROOT / "examples" / "shock_passage.toml").effects("WING_LE", truth=True)
    effect, parameters = hidden.effect, np.array(hidden.values)
    rise, mach_there, _ = parameters
    flown = np.zeros(1 + max(v for v in vars(flight).values() if isinstance(v, int)))
    for mach, factor in ((mach_there, 1.0 + rise), (mach_there + 10.0, 1.0), (mach_there - 10.0, 1.0)):
        flown[flight.mach] = mach
        value = effect.kernel(np.concatenate([flown, parameters]), 0, len(flown), 300.0)
        assert value == pytest.approx(factor, abs=1e-12)


@pytest.mark.thorough
def test_the_loop_tells_a_separated_flow_before_the_elevon(tmp_path, monkeypatch):
    """The example with a source: beyond 0.7 of the deflection of Needham and Stollery heating is half as much again."""
    monkeypatch.setenv("SIM_HEATING_EFFECTS", str(ROOT / "examples" / "separation"))
    monkeypatch.chdir(tmp_path)
    assert main(["synthesize", str(ROOT / "examples" / "flow_separation.toml"), "--out", "separated"]) == 0
    assert main(["close-loop", "separated", "--workers", "1", "--out", "closed"]) == 0
    told = json.loads((tmp_path / "closed" / "closure.json").read_text())
    assert told["finding"] == "found"
    (cause,) = told["effects"]
    assert cause["name"] == "flow-separation"
    for name, truth in (("rise", 0.5), ("onset", 0.7), ("width", 0.5)):
        value, sigma = (cause["parameters"][name][key] for key in ("value", "sigma"))
        assert abs(value - truth) < 3.0 * sigma


def test_separation_begins_where_needham_and_stollery_saw_it(monkeypatch):
    """At Mach 10 and Re 1e6 a laminar flow separates before a wedge of 80 sqrt(10) / 1e6**0.25 = 8.0 deg."""
    monkeypatch.setenv("SIM_HEATING_EFFECTS", str(ROOT / "examples" / "separation"))
    kernel = effects()["flow-separation"].kernel
    flown = np.zeros(1 + max(v for v in vars(flight).values() if isinstance(v, int)))
    flown[flight.mach], flown[flight.log10_re] = 10.0, 6.0
    for elevon_deg, factor in ((8.0 - 5.0, 1.0), (8.0, 1.25), (8.0 + 5.0, 1.5)):
        flown[flight.elevon_deg] = elevon_deg
        value = kernel(np.concatenate([flown, [0.5, 1.0, 0.1]]), 0, len(flown), 300.0)
        assert value == pytest.approx(factor, abs=2e-3)


INTERPRETED = """
from sim_heating import flight
from sim_heating.heating.effects import effect
from sim_heating.heating.effects.compiled import effect_dispatcher
flown = [0.0] * 12
flown[flight.mach] = 13.0
print(effect_dispatcher((effect("shock-passage"),)).function(0, [*flown, 0.25, 13.0, 1.5], 0, len(flown), 300.0))
"""


def test_an_effect_acts_where_compilation_is_disabled():
    environment = os.environ | {
        "NUMBA_DISABLE_JIT": "1", "PYTHONPATH": str(ROOT), "SIM_HEATING_EFFECTS": str(ROOT / "examples" / "effects"),
    }  # fmt: skip
    command = [sys.executable, "-c", INTERPRETED]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    assert float(done.stdout) == 1.25


def test_a_record_is_closed_again_when_a_user_defined_effect_has_changed(effects_folder):
    record = ROOT / "scenarios" / "records" / "practice" / "p06"
    before = record_job(record, Path("out"))
    assert record_job(record, Path("out")) == before
    (effects_folder / "steepness.py").write_text(SOURCE.replace("40.0", "38.0"))
    assert record_job(record, Path("out")).id != before.id
