"""Results are written whole or not at all, replace earlier ones and nothing else, and read back correctly."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from sim_heating.base.errors import InputError, LeftOutWarning, RunError
from sim_heating.base.files import (
    MARKER,
    file_digest,
    output_directory,
    read_csv_columns,
    read_text,
    replace_files,
    require_writable,
    toml_text,
    with_digest,
    write_csv,
    write_json,
    write_text_atomic,
)
from tests.support.kills import Case, bad, kill_and_judge, killed, operations
from tests.support.systems import posix


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


@posix
def test_a_file_is_written_whole_or_not_at_all(tmp_path: Path) -> None:
    import resource  # which Windows lacks

    write_text_atomic(tmp_path / "a", "old")
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100, limits[1]))  # which acts as a full disk
    try:
        with pytest.raises(RunError, match=r"a: cannot be written \(File too large\)"):
            write_text_atomic(tmp_path / "a", "new" * 1000)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert (tmp_path / "a").read_text() == "old"
    assert names(tmp_path) == {"a"}


def test_an_unwritable_place_is_reported(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot be written"):
        write_text_atomic(tmp_path / "file" / "a.csv", "x")


def test_a_number_that_is_not_finite_costs_no_other_result(tmp_path: Path) -> None:
    with pytest.warns(LeftOutWarning, match=r"left out as not finite: steps\[1\]\.p_value is nan, size is inf"):
        write_json(tmp_path / "a.json", {"rmse_K": 1.5, "steps": [{}, {"p_value": float("nan")}], "size": np.inf})
    assert json.loads((tmp_path / "a.json").read_text()) == {
        "rmse_K": 1.5,
        "steps": [{}, {"p_value": None}],
        "size": None,
        "left_out": ["steps[1].p_value is nan", "size is inf"],
    }


def test_nan_and_infinity_are_never_written(tmp_path: Path) -> None:
    with pytest.raises(RunError, match=r"fit\.rmse_K is nan"):
        with_digest({"fit": {"rmse_K": float("nan")}})
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


# What is not replaced ------------------------------------------------------------------------------------------------


def test_a_result_that_a_person_changed_is_not_replaced(tmp_path: Path) -> None:
    out = tmp_path / "out"
    run(out, a="1", b="1")
    (out / "b").write_text("mine")
    with pytest.raises(InputError, match="b was changed after sim-heating wrote it and is not replaced"):
        run(out, a="2")
    assert (out / "a").read_text() == "1"
    assert (out / "b").read_text() == "mine"


def test_results_of_another_command_are_not_replaced(tmp_path: Path) -> None:
    run(tmp_path / "out", a="1")
    with (
        pytest.raises(InputError, match="holds results of `run`, which `predict` does not replace"),
        output_directory(tmp_path / "out", "predict"),
    ):
        pytest.fail("there is no work to be done")


def test_a_list_of_results_is_no_permission_to_leave_the_directory(tmp_path: Path) -> None:
    (tmp_path / "precious").write_text("mine")
    out = tmp_path / "out"
    out.mkdir()
    for name in ("../precious", str(tmp_path / "precious"), "a/../../precious"):
        files = {name: file_digest(tmp_path / "precious")}
        marker = {"format": "sim_heating-output/2", "command": "run", "files": files}
        (out / MARKER).write_text(json.dumps(marker))
        with pytest.raises(InputError, match="is not the name of a file in it"):
            run(out, a="2")
    assert (tmp_path / "precious").read_text() == "mine"


@posix
def test_a_symbolic_link_is_not_followed_to_replace_a_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)  # messages name files below it by their relative paths
    out, precious = tmp_path / "out", tmp_path / "precious"
    run(out, a="1")
    shutil.move(out / "a", precious)
    (out / "a").symlink_to(precious)
    with pytest.raises(InputError, match=r"^out/a: is a symbolic link"):
        run(out, a="2")
    assert precious.read_text() == "1"


@pytest.mark.parametrize("text", ["", "[]", "{", '{"format": "sim_heating-output/1", "files": ["a"]}', "\0"])
def test_a_list_of_results_that_cannot_be_verified_protects_everything(tmp_path: Path, text: str) -> None:
    run(tmp_path / "out", a="1")
    (tmp_path / "out" / MARKER).write_text(text)
    with pytest.raises(InputError, match="lists no results of this program that can be verified"):
        run(tmp_path / "out", a="2")
    assert (tmp_path / "out" / "a").read_text() == "1"


@pytest.mark.parametrize(
    ("given", "relation"), [("record", "is the input"), (".", "contains"), ("record/results", "lies in")]
)
def test_results_never_go_where_their_input_is(tmp_path: Path, given: str, relation: str) -> None:
    record = tmp_path / "record"
    run(record, a="1")  # written by this program, unchanged, and still an input
    with (
        pytest.raises(InputError, match=relation),
        output_directory(tmp_path / given, "run", inputs=[record]),
    ):
        pytest.fail("there is no work to be done")
    linked = tmp_path / "linked"
    linked.symlink_to(record)
    with pytest.raises(InputError, match="is the input"):
        require_writable(linked, "run", inputs=[record])
    assert names(record) == {"a", MARKER}


# One writer at a time, and kills -------------------------------------------------------------------------------------


@pytest.mark.thorough
def test_a_second_process_is_refused_while_the_first_writes(tmp_path: Path) -> None:
    out = tmp_path / "out"
    with output_directory(out, "run") as partial:
        code = f"from sim_heating.base.files import require_writable; require_writable({str(out)!r}, 'run')"
        second = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
        assert "another sim-heating process is writing there; wait until it ends" in second.stderr
        (partial / "a").write_text("1")
    assert names(out) == {"a", MARKER}
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0
    assert names(out) == {"a", MARKER}


FIRST, SECOND = {"a": "1", "sub/b": "1", "sub/gone": "1"}, {"a": "2", "sub/b": "2", "new/c": "2"}


def write_all(folder: Path, files: dict[str, str]) -> None:
    with output_directory(folder, "run") as partial:
        for name, text in files.items():
            write_text_atomic(partial / name, text)


@pytest.mark.thorough
@posix
def test_a_kill_at_any_file_operation_leaves_the_results_of_before_or_after(tmp_path: Path) -> None:
    counted = kill_and_judge(
        Case(lambda f: write_all(f / "out", FIRST), lambda f: write_all(f / "out", SECOND)), None, tmp_path
    )
    assert counted["kills"] > 20
    assert counted["readers find: before"] > 5
    assert counted["readers find: after"] > 5
    assert bad(counted) == 0


@pytest.mark.thorough
@posix
def test_a_kill_at_any_file_operation_of_a_replacement_in_place_leaves_all_or_nothing(tmp_path: Path) -> None:
    """Files of a person, replaced because that is asked for: a table and the file of its control point."""

    def prepare(folder: Path) -> None:
        replace_files(folder / "out", {"table.csv": "1", "points/point.toml": "1", "kept": "1"})

    def act(folder: Path) -> None:
        replace_files(folder / "out", {"table.csv": "2", "points/point.toml": "2", "old/1.csv": "1"}, ["gone"])

    counted = kill_and_judge(Case(prepare, act), None, tmp_path)
    assert counted["readers find: before"] > 5
    assert counted["readers find: after"] > 5
    assert bad(counted) == 0


@posix
def test_reading_a_file_finishes_the_replacement_that_a_kill_interrupted(tmp_path: Path) -> None:
    out = tmp_path / "out"
    write_all(out, FIRST)
    found = operations(lambda: write_all(out, SECOND), out)
    shutil.rmtree(out)
    write_all(out, FIRST)
    committed = max(i for i, line in enumerate(found) if line.startswith("os.rename") and "journal" in line)
    assert killed(lambda: write_all(out, SECOND), out, committed + 3)
    assert (out / ".sim_heating.partial").exists()
    assert read_text(out / "sub" / "b") == "2"
    assert read_text(out / "a") == "2"
    assert not (out / "sub" / "gone").exists()
    assert names(out) == {"a", "sub", "new", MARKER}


@posix
def test_a_file_that_came_after_the_kill_is_kept(tmp_path: Path) -> None:
    out = tmp_path / "out"
    write_all(out, FIRST)
    found = operations(lambda: write_all(tmp_path / "out", SECOND), out)
    shutil.rmtree(out)
    write_all(out, FIRST)
    committed = max(i for i, line in enumerate(found) if line.startswith("os.rename") and "journal" in line)
    assert killed(lambda: write_all(out, SECOND), out, committed + 1)
    (out / "new").mkdir()
    (out / "new" / "c").write_text("mine")
    with pytest.raises(InputError, match="new/c: already exists and was not written by sim-heating"):
        read_text(out / "a")
    assert (out / "new" / "c").read_text() == "mine"
    (out / "new" / "c").unlink()
    assert read_text(out / "a") == "2"


def test_a_damaged_journal_is_reported_and_nothing_is_removed(tmp_path: Path) -> None:
    out = tmp_path / "out"
    write_all(out, FIRST)
    staging = out / ".sim_heating.partial"
    (staging / "new").mkdir(parents=True)
    (staging / "new" / "a").write_text("2")
    for text in ("", "{}", '{"format": "sim_heating-journal/1", "state": "finish", "new": {"../x": "y"}, "old": {}}'):
        (staging / "journal.json").write_text(text)
        with pytest.raises(InputError, match=r"is damaged|is not the name of a file in it"):
            read_text(out / "a")
    assert (staging / "new" / "a").read_text() == "2"
    assert (out / "a").read_text() == "1"
