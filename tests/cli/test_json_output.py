"""`--json` and `--quiet`: what programs read of every command, and what silence leaves."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import click
import numpy as np
import pytest

from sim_heating.base.files import read_json
from sim_heating.cli import COMMANDS, cli, main
from sim_heating.cli.output import CommandReport
from tests.support.json_output import run_json
from tests.support.paths import AIRCRAFT, ROOT, TILE


def commands(group: click.Group, *before: str) -> Iterator[tuple[tuple[str, ...], click.Command]]:
    """Every command with the words that call it."""
    context = click.Context(group)
    for name in group.list_commands(context):
        command = group.get_command(context, name)
        assert command is not None
        if isinstance(command, click.Group):
            yield from commands(command, *before, name)
        else:
            yield (*before, name), command


ALL = dict(commands(cli))


@pytest.mark.parametrize("words", ALL, ids=" ".join)
def test_every_command_states_wrong_usage_as_an_object(
    words: tuple[str, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    options = {option for parameter in ALL[words].params for option in parameter.opts}
    assert {"--json", "--quiet"} <= options
    assert main([*words, "--no-such-option", "--json"]) == 2
    output = capsys.readouterr()
    found = json.loads(output.out)
    assert (found["command"], found["status"], found["error"]["kind"]) == (" ".join(words), 2, "usage")
    assert output.err == f"error: {found['error']['message']}\n"


def test_json_of_a_prediction_has_its_files_and_its_summary(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    found = run_json(capsys, "predict", str(TILE), "--out", str(out))
    assert found["error"] is None
    assert found["directory"] == str(out)
    assert {Path(name) for name in found["files"]} == {path for path in out.iterdir() if path.name[0] != "."}
    assert found["results"] == read_json(out / "summary.json")


@pytest.mark.thorough
def test_several_records_are_predicted_into_one_object(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name in ("one", "two"):
        shutil.copytree(TILE, tmp_path / name)
    found = run_json(capsys, "predict", str(tmp_path / "one"), str(tmp_path / "two"), "--out", str(tmp_path / "out"))
    assert set(found["results"]["records"]) == {"one", "two"}
    assert all(Path(name).is_file() for name in found["files"])


def test_an_input_error_keeps_its_line_and_is_in_the_object(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--json", "validate", str(TILE), str(tmp_path / "none")]) == 2
    output = capsys.readouterr()
    found = json.loads(output.out)
    assert [path["is_good"] for path in found["results"]["paths"]] == [True, False]
    (problem,) = found["error"]["problems"]
    assert output.err == f"error: {problem}\n"
    assert found["error"]["kind"] == "input"


def test_written_tables_are_listed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    shutil.copytree(AIRCRAFT / "capsule", tmp_path / "capsule")
    found = run_json(capsys, "ratio-tables", str(tmp_path / "capsule"), "--root", str(tmp_path))
    assert found["files"]
    assert all(Path(name).is_file() for name in found["files"])


def test_what_others_print_on_standard_output_goes_to_standard_error(capfd: pytest.CaptureFixture[str]) -> None:
    report = CommandReport(["--json"])
    with report.standard_output_reserved():
        print("of a library in Python")
        os.write(1, b"of a library in C\n")
        subprocess.run([sys.executable, "-c", "print('of another process')"], check=True)
    report.print_json(0)
    output = capfd.readouterr()
    assert json.loads(output.out)["status"] == 0
    assert len(output.err.splitlines()) == 3


def test_a_number_that_is_not_finite_is_null(capsys: pytest.CaptureFixture[str]) -> None:
    report = CommandReport(["--json"])
    report.results = {"sigma": np.array([1.0, np.nan]), "margin_K": np.float64("inf"), "n": np.int64(3)}
    report.print_json(0)
    assert json.loads(capsys.readouterr().out)["results"] == {"sigma": [1.0, None], "margin_K": None, "n": 3}


@pytest.mark.thorough
def test_quiet_leaves_errors_and_warnings(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["predict", str(TILE), "--out", str(tmp_path / "out"), "--quiet"]) == 0
    output = capsys.readouterr()
    assert output.out == ""
    warnings = output.err.splitlines()
    assert all(line.startswith("warning: ") for line in warnings)
    assert any("log10_re lay outside the ratio tables of tile" in line for line in warnings)
    assert main(["--quiet", "validate", "nowhere"]) == 2
    assert capsys.readouterr() == ("", "error: nowhere: there is no such file\n")


def test_a_value_after_two_dashes_is_no_option(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["validate", "--", "--json"]) == 2
    assert capsys.readouterr() == ("", "error: --json: there is no such file\n")


@pytest.mark.thorough
def test_the_object_is_whole_in_a_process_of_its_own(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "sim_heating", "validate", str(TILE), "--json"]
    environment = os.environ | {"PYTHONPATH": str(ROOT), "PYTHONIOENCODING": "ascii"}
    done = subprocess.run(command, env=environment, cwd=tmp_path, capture_output=True, text=True, check=True)
    assert json.loads(done.stdout)["results"]["paths"][0]["kind"] == "record"


@pytest.mark.parametrize("name", COMMANDS)
def test_the_help_of_every_command_has_an_example_whose_files_exist(
    name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([name, "--help"]) == 0
    example = " ".join(capsys.readouterr().out.partition("Example: ")[2].split())
    assert example.startswith(f"sim-heating {name}")
    assert all((ROOT / word).exists() for word in example.split() if word.startswith("scenarios/"))
