"""`sim-heating validate` says what a run would find out: triggers that are never met, effects that do not compile."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from sim_heating.base.errors import RunError
from sim_heating.base.files import read_csv_columns, write_csv
from sim_heating.cli import main
from sim_heating.inputs.scenario import load_scenario
from sim_heating.simulation.run import fly_scenario
from tests.support.gliding import gliding
from tests.support.paths import ROOT, SCENARIOS, TILE

SHORT = gliding(60.0, "V09T9527", vehicle="orbiter")
POPU = '\n[[trajectory.manoeuvre]]\nkind = "popu"\n'
RECORDED = """
format = "scenario/1"
title = "A recorded flight"
vehicle = "orbiter"
control_points = ["V09T9527"]
[trajectory]
source = "recorded"
file = "flight.csv"
"""
BROKEN_EFFECT = '''
"""Calls a function that does not exist."""
from sim_heating import Effect, Parameter, njit


@njit
def broken(B, c, p, wall_K):
    return undefined_function(B[p])


EFFECT = Effect("broken", "add", (Parameter("growth", "1", 0.0, 0.2, -1.0, 2.0, "x"),), broken, source="test")
'''


@pytest.fixture(autouse=True)
def workdir(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("SIM_HEATING_AIRCRAFT_DATA", str(ROOT / "aircraft_data"))
    return tmp_path


def validated(text: str, capsys: pytest.CaptureFixture[str]) -> tuple[int, str]:
    """Exit status and error lines of validating a scenario."""
    Path("scenario.toml").write_text(text)
    return main(["validate", "scenario.toml"]), capsys.readouterr().err


@pytest.mark.parametrize(
    ("trigger", "expected"),
    [
        ("at_time_s = 90.0", "manoeuvre 1: popu at 90 s: trigger never met; manoeuvre not flown; the flight goes from"),
        ("at_mach = 3.0", "manoeuvre 1: popu at Mach 3: trigger never met"),
        ("at_velocity_m_s = 7000.0", "manoeuvre 1: popu at 7000 m/s: trigger never met"),
        ("at_mach = 40.0", "`at_mach`: Mach 40 is not reached from 6800 m/s at 75000 m, at most 33.7"),
        ("at_velocity_m_s = 9000.0", "`at_velocity_m_s`: 9000 is not reached from 6800 m/s"),
    ],
)
@pytest.mark.parametrize("source", ["entry-3dof", "jsbsim"])
def test_a_trigger_that_is_never_met_is_an_error(
    source: str, trigger: str, expected: str, capsys: pytest.CaptureFixture[str]
) -> None:
    text = SHORT.replace('source = "entry-3dof"', f'source = "{source}"')
    status, error = validated(f"{text}{POPU}{trigger}\n", capsys)
    assert status == 2
    assert expected in error


def test_a_trigger_that_is_met_is_good(capsys: pytest.CaptureFixture[str]) -> None:
    assert validated(f"{SHORT}{POPU}at_time_s = 10.0\n", capsys) == (0, "")


def test_a_flight_that_leaves_the_atmosphere_is_an_error(capsys: pytest.CaptureFixture[str]) -> None:
    status, error = validated(
        SHORT.replace("velocity_m_s = 6800.0", "velocity_m_s = 12000.0").replace("time_s = 60.0", "time_s = 3000.0"),
        capsys,
    )
    assert status == 2
    assert "outside the atmosphere" in error


def test_a_flight_that_fails_names_its_scenario() -> None:
    text = SHORT.replace("velocity_m_s = 6800.0", "velocity_m_s = 12000.0").replace("time_s = 60.0", "time_s = 3000.0")
    Path("fast.toml").write_text(text)
    with pytest.raises(RunError, match=r"^fast\.toml: .* outside the atmosphere"):
        fly_scenario(load_scenario("fast.toml", root=ROOT))


def test_a_flight_without_an_end_is_told_which_keys_end_it(capsys: pytest.CaptureFixture[str]) -> None:
    status, error = validated(SHORT.replace("time_s = 60.0", ""), capsys)
    assert status == 2
    assert "scenario.toml, [trajectory]: 3-DOF entry: at" in error
    assert "or end the flight earlier by `mach`, `velocity_m_s`, `altitude_m` or `time_s` in [trajectory.stop]" in error


def test_the_recorded_flight_that_a_scenario_names_is_read(capsys: pytest.CaptureFixture[str]) -> None:
    flown = read_csv_columns(SCENARIOS / "data" / "sts107_early_entry.csv", ("time_s",)).columns
    write_csv("flight.csv", flown)
    assert validated(RECORDED, capsys) == (0, "")
    write_csv("flight.csv", {**flown, "altitude_m": flown["altitude_m"] / 1e3})
    status, error = validated(RECORDED, capsys)
    assert status == 2
    assert "flight.csv, row 2, column altitude_m" in error
    assert "looks like km" in error


def test_a_user_defined_effect_that_does_not_compile_is_an_error(
    workdir: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (workdir / "effects").mkdir()
    (workdir / "effects" / "broken.py").write_text(BROKEN_EFFECT)
    monkeypatch.setenv("SIM_HEATING_EFFECTS", str(workdir / "effects"))
    effect = '\n[[effect]]\nname = "broken"\nparameters = { growth = 0.1 }\n'
    status, error = validated(SHORT + effect, capsys)
    assert status == 2
    assert "effect `broken` (effects/broken.py)" in error
    assert "cannot be compiled" in error
    assert "Traceback" not in error


@pytest.mark.parametrize(
    ("name", "old", "new", "line"),
    [
        ("logger_layout.toml", 'decimal = ","', 'decimal = ";"', "logger_layout.toml: `decimal`"),
        ("fit_settings.toml", "[0.0, 0.3]", "[0.0]", "fit_settings.toml, [prior.clock]: `skew`: [0.0] is not a pair"),
        ("credibility.toml", "level = 2", "level = 5", "credibility.toml, [review] 1: `level`"),
    ],
)
def test_a_file_that_names_no_others_is_checked(
    name: str, old: str, new: str, line: str, capsys: pytest.CaptureFixture[str]
) -> None:
    text = (ROOT / "examples" / name).read_text()
    assert text.count(old) == 1
    Path(name).write_text(text)
    assert main(["validate", name]) == 0
    Path(name).write_text(text.replace(old, new))
    assert main(["validate", name]) == 2
    assert line in capsys.readouterr().err


def test_an_estimate_that_was_changed_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    shipped = ROOT / "docs" / "reference" / "formats" / "examples"
    assert main(["validate", str(shipped / "estimate.json")]) == 0
    Path("estimate.json").write_text((shipped / "estimate.json").read_text().replace("0", "1", 1))
    assert main(["validate", "estimate.json", str(shipped / "closure.json")]) == 2
    said = capsys.readouterr().err
    assert "estimate.json: " in said
    assert "closure.json: is a closure report; give an estimate.json" in said


@pytest.mark.parametrize(("path", "name"), [(TILE, "tile"), (ROOT / "aircraft_data" / "capsule", "capsule")])
def test_reviews_that_cannot_be_read_are_refused(path: Path, name: str, capsys: pytest.CaptureFixture[str]) -> None:
    """A computation would refuse them with its results."""
    shutil.copytree(path, name)
    shutil.copy(ROOT / "examples" / "credibility.toml", name)
    assert main(["validate", name]) == 0
    (Path(name) / "credibility.toml").write_text('format = "credibility/1"\nreviews = 1\n')
    assert main(["validate", name]) == 2
    assert "credibility.toml: unknown key `reviews`" in capsys.readouterr().err
