"""Tab completion, asked as a shell asks it."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from sim_heating.cli import main
from sim_heating.cli.completion import INSTALL, VARIABLE
from tests.support.paths import PRACTICE, ROOT, SCENARIOS


@pytest.fixture
def workdir(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a scenario, two records and a vehicle in it."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("SIM_HEATING_AIRCRAFT_DATA", str(ROOT / "aircraft_data"))
    shutil.copy(SCENARIOS / "capsule.toml", tmp_path)
    shutil.copytree(ROOT / "aircraft_data" / "capsule", tmp_path / "mine" / "pod")
    for name in ("p01", "p02"):
        shutil.copytree(PRACTICE / name, tmp_path / "flown" / name)
    return tmp_path


def completed(line: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """What a shell is offered after a line."""
    monkeypatch.setenv(VARIABLE, "bash_complete")
    monkeypatch.setenv("COMP_WORDS", line)
    monkeypatch.setenv("COMP_CWORD", str(len(line.split(" ")) - 1))
    capsys.readouterr()
    with pytest.raises(SystemExit):
        main([])
    return [item.partition(",")[2] for item in capsys.readouterr().out.splitlines() if item.startswith("plain,")]


@pytest.mark.parametrize(
    ("line", "offered"),
    [
        ("sim-heating est", ["estimate"]),
        ("sim-heating run c", ["capsule.toml"]),
        ("sim-heating estimate flown/", ["flown/p01", "flown/p02"]),
        ("sim-heating predict flown/p01 flown/p02 --vehicle or", ["orbiter"]),
        ("sim-heating validate mi", ["mine/pod"]),
        ("sim-heating new scenario --vehicle mi", ["mine/pod"]),
        ("sim-heating predict mi", []),
        ("sim-heating validate ca", ["capsule", "capsule.toml"]),
        ("sim-heating plan c", []),  # there is no study: the shell completes names of files
    ],
)
def test_commands_records_scenarios_and_vehicles_are_completed(
    line: str,
    offered: list[str],
    workdir: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    assert completed(line, capsys, monkeypatch) == offered


@pytest.mark.parametrize("shell", INSTALL)
def test_the_script_of_each_shell_is_printed(shell: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["completion", shell]) == 0
    assert VARIABLE in capsys.readouterr().out
