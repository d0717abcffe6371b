"""Shipped examples by their names, from a folder that holds none of them."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from sim_heating.cli import main
from sim_heating.cli.examples import example_path
from tests.support.paths import PRACTICE, SCENARIOS


@pytest.mark.parametrize(
    ("name", "file"),
    [
        ("popu_mach20", "popu_mach20.toml"),
        ("scenarios/popu_mach20.toml", "popu_mach20.toml"),
        ("practice/p08", "records/practice/p08"),
        ("practice", "records/practice"),
        ("small_envelope", "studies/small_envelope.toml"),
        ("sts2_sts4", "campaigns/sts2_sts4.toml"),
    ],
)
def test_an_example_is_found_by_its_name(name: str, file: str) -> None:
    assert example_path(name) == SCENARIOS / file


def test_a_shipped_example_is_taken_and_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["validate", "popu_mach20", "practice/p06"]) == 0
    errors = capsys.readouterr().err
    assert f"popu_mach20: not in this folder; the shipped example {SCENARIOS / 'popu_mach20.toml'} is taken" in errors


def test_a_file_of_the_current_folder_comes_before_an_example(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    shutil.copytree(PRACTICE / "p06", tmp_path / "practice" / "p06")
    assert main(["validate", "practice/p06"]) == 0
    assert "shipped" not in capsys.readouterr().err


def test_an_unknown_name_is_refused_as_a_path(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["run", "my_entry", "--out", "out"]) == 2
    assert "error: my_entry: there is no such file" in capsys.readouterr().err


@pytest.mark.parametrize(("name", "meant"), [("popu_mach2", "popu_mach20"), ("p08", "practice/p08")])
def test_a_misspelt_example_is_refused_with_the_one_that_was_meant(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], name: str, meant: str
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["validate", name]) == 2
    rule = f"{name}: is no file of this folder and no shipped example; did you mean `{meant}`?"
    assert rule in capsys.readouterr().err


def test_examples_are_copied_and_a_changed_copy_is_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["examples", "--out", "mine"]) == 0
    copy = tmp_path / "mine" / "scenarios" / "popu_mach20.toml"
    assert copy.read_bytes() == (SCENARIOS / "popu_mach20.toml").read_bytes()
    copy.write_text("changed")
    assert main(["examples", "--out", "mine"]) == 2
    assert "is not the shipped file" in capsys.readouterr().err
    assert copy.read_text() == "changed"
