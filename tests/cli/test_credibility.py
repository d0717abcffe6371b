"""`sim-heating credibility` as a user meets it: a statement, an own validation case, a signed review."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from sim_heating.cli import main
from tests.support.paths import ROOT

BOARD = ROOT / "scenarios" / "records" / "kaowool_board"


@pytest.fixture
def board(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy of the measured board under another name, in the working directory."""
    monkeypatch.chdir(tmp_path)
    shutil.copytree(BOARD, tmp_path / "plate_7")
    return Path("plate_7")


def statement(out: str) -> dict:
    return json.loads((Path(out) / "summary.json").read_text())["credibility"]


def test_a_prediction_states_its_credibility_and_the_command_shows_why(board: Path, capsys):
    assert main(["predict", str(board), "--out", "out"]) == 0
    assert "Credibility (self-assessment" in capsys.readouterr().out
    assert main(["credibility", "out"]) == 0
    shown = capsys.readouterr().out
    assert "not assessed" in shown
    assert "no statement of" in shown
    assert "material black-paint" in shown  # an estimate of confidence C


@pytest.mark.thorough
def test_an_own_case_joins_the_region_until_it_is_removed(board: Path, capsys):
    assert main(["predict", str(board), "--out", "before"]) == 0
    assert main(["credibility", "add", str(board)]) == 0
    assert main(["credibility", "add", str(board)]) == 2
    assert "--force" in capsys.readouterr().err
    assert main(["credibility", "add", str(board), "--force"]) == 0
    assert main(["credibility", "list"]) == 0
    assert "plate_7" in capsys.readouterr().out
    assert main(["predict", str(board), "--out", "after"]) == 0
    assert set(statement("before")["region"]["data_sets"]) == {"kaowool_board"}
    assert set(statement("after")["region"]["data_sets"]) == {"kaowool_board", "plate_7"}
    assert main(["credibility", "remove", "plate_8"]) == 2
    assert "did you mean `plate_7`" in capsys.readouterr().err
    assert main(["credibility", "remove", "plate_7"]) == 0
    assert not Path("validation/plate_7.json").exists()


def test_a_case_that_was_changed_by_hand_is_not_read(board: Path, capsys):
    assert main(["credibility", "add", str(board)]) == 0
    path = Path("validation/plate_7.json")
    path.write_text(path.read_text().replace('"rise_K": 5', '"rise_K": 9'))
    assert main(["credibility", "list"]) == 2
    assert "was changed after it was written" in capsys.readouterr().err


def test_synthetic_records_and_names_of_the_project_are_no_own_cases(board: Path, capsys):
    assert main(["credibility", "add", str(BOARD)]) == 2
    assert "the project has this data set already" in capsys.readouterr().err
    assert main(["credibility", "add", str(ROOT / "scenarios/records/practice/p06")]) == 2
    assert "only measurements validate" in capsys.readouterr().err


@pytest.mark.thorough
def test_a_review_counts_while_the_record_stays_as_it_is(board: Path, capsys):
    signed = ["--person", "A. Engineer", "--statement", "used for two plates before"]
    assert main(["credibility", "review", str(board), "--factor", "history", "--level", "2", *signed]) == 0
    assert main(["predict", str(board), "--out", "signed"]) == 0
    assert statement("signed")["factors"]["history"]["level"] == 2
    record = board / "record.toml"
    record.write_text(record.read_text().replace("initial_K = 290.3", "initial_K = 291.3"))
    assert main(["predict", str(board), "--out", "changed"]) == 0
    assert statement("changed")["factors"]["history"]["level"] is None
    capsys.readouterr()
    assert main(["credibility", "show", "signed", "--reviews", str(board / "credibility.toml"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["results"]["factors"]["history"]["level"] == 2
    assert main(["credibility", "review", str(board), "--factor", "histroy", "--level", "2", *signed]) == 2
    assert "did you mean `history`" in capsys.readouterr().err


def test_a_directory_without_a_statement_is_refused_with_what_to_do(board: Path, capsys):
    assert main(["credibility", str(board)]) == 2
    assert "is a flight record; name the directory of results" in capsys.readouterr().err
    Path("empty").mkdir()
    assert main(["credibility", "empty"]) == 2
    assert "no result with a credibility statement" in capsys.readouterr().err
    assert main(["credibility", "lst"]) == 2
    assert "add, list, remove" in capsys.readouterr().err.replace("rules, add", "add")
