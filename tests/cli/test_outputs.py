"""No command removes or replaces a file that it did not write itself; two at once do not mix their results."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from contextlib import chdir
from pathlib import Path

import pytest

from sim_heating.cli import main
from tests.support.gliding import gliding
from tests.support.kills import bad, case, kill_and_judge, snapshot
from tests.support.paths import PRACTICE, TILE
from tests.support.systems import posix


@pytest.fixture(scope="module")
def flown_records(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a scenario, two records in a folder, and a record that `synthesize` wrote."""
    home = tmp_path_factory.mktemp("flown")
    (home / "short.toml").write_text(gliding(60.0, "V09T9527"))
    for name in ("p06", "p07"):
        shutil.copytree(PRACTICE / name, home / "records" / name)
    with chdir(home):
        assert main(["synthesize", "short.toml", "--out", "flown"]) == 0
    return home


INPUTS = [
    "predict flown --out flown",
    "predict flown --out .",
    "predict flown --out flown/predicted",
    "predict records/p06 records/p07 --out records",
    "predict records/p06 --out records",
    "estimate flown --out flown",
    "estimate records/p06 records/p07 --out records/p07",
    "estimate flown --segments 20 --out flown",
    "close-loop flown --out flown",
    "close-loop records --out records",
    "run short.toml --out .",
    "synthesize short.toml --out .",
    "measured-records short.toml --out .",
    "design short.toml --out .",
]


@pytest.mark.parametrize("command", INPUTS)
def test_results_are_refused_where_the_input_is_and_nothing_changes(
    command: str, workdir: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = snapshot(workdir)
    capsys.readouterr()
    assert main(command.split()) == 2
    errors = capsys.readouterr().err.splitlines()
    assert len(errors) == 1, errors
    assert "which results might replace; choose another directory" in errors[0]
    assert snapshot(workdir) == before


def test_one_command_does_not_replace_the_results_of_another(workdir: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = snapshot(workdir)
    assert main(["predict", "records/p06", "--out", "flown"]) == 2
    assert "flown: holds results of `synthesize`, which `predict` does not replace" in capsys.readouterr().err
    assert snapshot(workdir) == before


def test_a_changed_result_is_a_persons_file(workdir: Path, capsys: pytest.CaptureFixture[str]) -> None:
    record = workdir / "flown" / "record.toml"
    record.write_text(record.read_text() + "# checked by me\n")
    before = snapshot(workdir)
    assert main(["synthesize", "short.toml", "--out", "flown"]) == 2
    assert "record.toml was changed after sim-heating wrote it and is not replaced" in capsys.readouterr().err
    assert snapshot(workdir) == before


@pytest.mark.thorough
def test_two_commands_at_once_into_one_directory_do_not_mix_results(workdir: Path) -> None:
    runs = [
        subprocess.Popen(
            [sys.executable, "-m", "sim_heating", "predict", f"records/{name}", "--out", "out"],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
        )
        for name in ("p06", "p07")
    ]
    ended = [(run.communicate()[1], run.returncode) for run in runs]
    assert {status for _, status in ended} <= {0, 2}
    done = [name for name, (_, status) in zip(("p06", "p07"), ended, strict=True) if status == 0]
    assert done
    for error, status in ended:
        assert status == 0 or "another sim-heating process is writing there" in error
    alone = []
    for name in done:
        assert main(["predict", f"records/{name}", "--out", f"alone_{name}"]) == 0
        alone.append(snapshot(workdir / f"alone_{name}"))
    assert snapshot(workdir / "out") in alone


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("command", "fresh", "moments"),
    [
        ("predict", False, (3, 42)),
        ("synthesize", True, (9, 46)),
        ("fmu export", False, (8,)),
        ("new study", True, (4,)),
    ],
)
@posix
def test_command_killed_at_a_file_operation_leaves_whole_results(
    command: str, fresh: bool, moments: tuple[int, ...], tmp_path: Path
) -> None:
    """A sample; `python -m benchmarks kills` goes through all commands and all operations."""
    counted = kill_and_judge(case(command, fresh), moments, tmp_path)
    assert counted["kills"] == len(moments)
    assert bad(counted) == 0, counted


@pytest.mark.filterwarnings("default")
def test_force_replaces_files_of_these_names_and_no_other(workdir: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = workdir / "out"
    out.mkdir()
    (out / "summary.json").write_text("mine")
    (out / "notes.txt").write_text("mine too")
    assert main(["predict", str(TILE), "--out", "out"]) == 2
    assert main(["predict", str(TILE), "--out", "out", "--force"]) == 0
    assert "replaced summary.json, which `predict` had not written" in capsys.readouterr().err
    assert json.loads((out / "summary.json").read_text())["record"] == "tile"
    assert (out / "notes.txt").read_text() == "mine too"
    capsys.readouterr()
    assert main(["predict", str(TILE), "--out", "out", "--force"]) == 0  # its own results: nothing to state
    assert "replaced" not in capsys.readouterr().err


@pytest.mark.thorough
@pytest.mark.filterwarnings("default")
def test_force_replaces_results_of_another_command_but_no_changed_one(
    workdir: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = workdir / "out"
    assert main(["parameters", str(TILE), "--out", "out"]) == 0
    (out / "parameters.csv").write_text("mine now")
    assert main(["predict", str(TILE), "--out", "out"]) == 2
    assert main(["predict", str(TILE), "--out", "out", "--force"]) == 0
    assert "replaced parameters.json" in capsys.readouterr().err
    assert (out / "parameters.csv").read_text() == "mine now"
    assert not (out / "parameters.json").exists()
    assert main(["predict", str(TILE), "--out", "out"]) == 0  # they are its own results now
