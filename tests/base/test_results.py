"""Results are written whole or not at all, replace earlier ones and nothing else, and read back correctly."""

from __future__ import annotations

from pathlib import Path

import pytest

from sim_heating.base.errors import InputError, RunError
from sim_heating.base.files import (
    output_directory,
    read_csv_columns,
    toml_text,
    write_csv,
    write_json,
    write_text_atomic,
)


def interrupted(folder: Path) -> None:
    with output_directory(folder, "run") as partial:
        (partial / "a.csv").write_text("half")
        raise KeyboardInterrupt


def run(folder: Path, **files: str) -> None:
    with output_directory(folder, "run") as partial:
        for name, text in files.items():
            (partial / name).write_text(text)


def names(folder: Path) -> set[str]:
    return {p.name for p in folder.iterdir()}


def test_an_interrupted_run_leaves_no_directory_behind(tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt):
        interrupted(tmp_path / "new" / "out")
    assert names(tmp_path) == set()


def test_an_interrupted_run_leaves_earlier_results_as_they_were(tmp_path: Path) -> None:
    run(tmp_path / "out", a="1")
    with pytest.raises(KeyboardInterrupt):
        interrupted(tmp_path / "out")
    assert names(tmp_path / "out") == {"a", ".sim_heating.json"}
    assert (tmp_path / "out" / "a").read_text() == "1"


def test_a_second_run_replaces_the_results_of_the_first_and_nothing_else(tmp_path: Path) -> None:
    out = tmp_path / "out"
    run(out, a="1", b="1")
    (out / "notes.txt").write_text("mine")
    run(out, a="2")
    assert names(out) == {"a", "notes.txt", ".sim_heating.json"}
    assert (out / "a").read_text() == "2"


def test_a_file_of_other_origin_is_never_overwritten(tmp_path: Path) -> None:
    (tmp_path / "a").write_text("mine")
    with pytest.raises(
        InputError, match="a already exists and was not written by sim-heating; choose another directory"
    ):
        run(tmp_path, a="2", b="2")
    assert names(tmp_path) == {"a"}
    assert (tmp_path / "a").read_text() == "mine"


def test_results_that_cannot_all_be_moved_into_place_are_withdrawn(tmp_path: Path) -> None:
    out = tmp_path / "out"
    run(out, a="1", b="1")
    (out / "b").unlink()
    (out / "b").mkdir()
    with pytest.raises((InputError, OSError)):
        run(out, a="2", b="2")
    assert (out / "a").read_text() == "1"


def test_a_file_in_place_of_the_directory_is_reported(tmp_path: Path) -> None:
    (tmp_path / "out").write_text("")
    with pytest.raises(InputError, match="out: is a file; name a directory for the results"):
        run(tmp_path / "out", a="1")


def test_a_file_that_comes_into_the_directory_during_the_run_is_kept(tmp_path: Path) -> None:
    with output_directory(tmp_path / "out", "run") as folder:
        (tmp_path / "out" / "notes.txt").write_text("mine")
        write_text_atomic(folder / "results.txt", "found")
    assert (tmp_path / "out" / "notes.txt").read_text() == "mine"
    assert (tmp_path / "out" / "results.txt").read_text() == "found"


def test_a_directory_of_the_longest_name_is_made(tmp_path: Path) -> None:
    out = tmp_path / ("x" * 255)
    with output_directory(out, "run") as folder:
        write_text_atomic(folder / "results.txt", "found")
    assert (out / "results.txt").read_text() == "found"


def test_a_directory_of_a_longer_name_is_refused_before_the_work(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="results cannot be written"), output_directory(tmp_path / ("x" * 300), "run"):
        pytest.fail("there is no work to be done")


def test_a_file_is_written_whole_or_not_at_all(tmp_path: Path) -> None:
    write_text_atomic(tmp_path / "a", "old")
    with pytest.raises(UnicodeEncodeError):
        write_text_atomic(tmp_path / "a", "new \ud800")
    assert (tmp_path / "a").read_text() == "old"
    assert names(tmp_path) == {"a"}


def test_an_unwritable_place_is_reported(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot be written"):
        write_text_atomic(tmp_path / "file" / "a.csv", "x")


def test_nan_and_infinity_are_never_written(tmp_path: Path) -> None:
    with pytest.raises(RunError, match=r"fit\.rmse_K is nan"):
        write_json(tmp_path / "a.json", {"fit": {"rmse_K": float("nan")}})
    with pytest.raises(RunError, match="column T_K contains an infinite number"):
        write_csv(tmp_path / "a.csv", {"T_K": [1.0, float("inf")]})
    with pytest.raises(RunError, match=r"`a\.b` is nan"):
        toml_text({"a": {"b": float("nan")}})
    assert names(tmp_path) == set()


def test_windows_line_ends_a_byte_order_mark_and_quotes_are_read(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_bytes(b'\xef\xbb\xbf# source: me\r\n"time_s", x\r\n0,"1.5"\r\n1,2e0\r\n\r\n')
    table = read_csv_columns(tmp_path / "a.csv", ["time_s", "x"])
    assert table.header == {"source": "me"}
    assert table["x"].tolist() == [1.5, 2.0]
    assert table.lines.tolist() == [3, 4]
