"""A large table of numbers is read as a whole, to the bits and the messages of one that is read cell by cell."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from sim_heating.base.errors import InputError
from sim_heating.base.files import csv_table, read_csv_columns

ROWS = 5000


def write(path: Path, **changed: str) -> Path:
    """A table of two columns with some cells changed, by `row3`."""
    rng = np.random.default_rng(1)
    rows = [f"{i * 0.1!r},{x!r}" for i, x in enumerate((300.0 + rng.standard_normal(ROWS)).tolist())]
    for name, text in changed.items():
        rows[int(name.removeprefix("row"))] = text
    path.write_text("# source: test\ntime_s,T_K\n" + "\n".join(rows) + "\n")
    return path


@pytest.fixture
def large(monkeypatch):
    monkeypatch.setattr(csv_table, "LARGE_TEXT", 1000)


def both(path: Path, monkeypatch) -> list[object]:
    """What is read, or the problems, as a whole and cell by cell."""
    found = []
    for limit in (1000, 10**9):
        monkeypatch.setattr(csv_table, "LARGE_TEXT", limit)
        try:
            table = read_csv_columns(path, ["time_s", "T_K"], allow_empty=["T_K"])
            found.append((table["time_s"].tobytes(), table["T_K"].tobytes(), table.lines.tolist(), table.header))
        except InputError as error:
            found.append(error.problems)
    return found


@pytest.mark.parametrize(
    "changed",
    [
        {},
        {"row7": "0.7,"},
        {"row7": ",300"},
        {"row7": "0.7,Open TC"},
        {"row7": "0.7,nan"},
        {"row7": "0.7,inf"},
        {"row7": "0.7"},
        {"row7": "0.7,300,5"},
        {"row7": ""},
        {"row7": '0.7,"300"'},
        {"row7": "0.7, 300 "},
        {"row7": "0.7,1_000"},
    ],
)
def test_a_large_table_is_read_as_a_small_one(tmp_path, monkeypatch, changed):
    whole, by_cell = both(write(tmp_path / "t.csv", **changed), monkeypatch)
    assert whole == by_cell


def test_a_large_table_has_a_fast_way(tmp_path, large, monkeypatch):
    monkeypatch.setattr(csv_table, "_cells", None)
    assert len(read_csv_columns(write(tmp_path / "t.csv"), ["time_s", "T_K"])) == ROWS
