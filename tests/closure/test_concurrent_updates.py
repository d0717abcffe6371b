"""Several processes that revise one vehicle at once, and processes that are killed while they do."""

from __future__ import annotations

import random
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from sim_heating.base.errors import InputError
from sim_heating.base.files import exclusive
from sim_heating.closure.revise.revisions import TableHistory, read_history, revert
from sim_heating.closure.revise.update import prepare_update, write_update
from sim_heating.estimation.report.estimate_file import EstimatedParameter, read_estimate, write_estimate
from sim_heating.inputs.vehicle import load_vehicle
from tests.closure.test_update_tables import POINT, contents, edit, flown_records, update_and_write
from tests.support.kills import Case, bad, kill_and_judge
from tests.support.systems import posix

__all__ = ["flown_records"]

COATING = "effect.coating-thickness.coating_factor"
KILLS, SEED = 6, 20


def command(*arguments: str) -> subprocess.Popen[str]:
    """`sim-heating update-tables` in a process of its own."""
    return subprocess.Popen(
        [sys.executable, "-m", "sim_heating", "update-tables", *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def at_once(*commands: tuple[str, ...]) -> list[tuple[int, str, str]]:
    """Commands on ./orbiter that all wait until each has begun: exit status, output and errors of each."""
    with exclusive("orbiter"):
        started = [command("--vehicle", "./orbiter", *arguments) for arguments in commands]
        for process in started:
            assert process.stderr is not None
            line = process.stderr.readline()
            assert "waiting for another process that revises orbiter" in line
    found = [process.communicate() for process in started]
    return [(process.returncode, *texts) for process, texts in zip(started, found, strict=True)]


def history() -> TableHistory:
    return read_history(load_vehicle("./orbiter"), POINT)


def evidence_of() -> list[str]:
    """Records behind the table, the oldest revision first."""
    return [record.record for revision in history().revisions for record in revision.records]


@pytest.mark.thorough
def test_updates_at_once_become_revisions_one_after_the_other_each_counted_once(workdir: Path) -> None:
    found = at_once(("first.json",), ("second.json",), ("first.json",))
    assert sorted(status for status, _, _ in found) == [0, 0, 2], found
    assert next(errors for status, _, errors in found if status == 2).count("already and would count twice") == 1
    assert sorted(n for n in (2, 3) for _, out, _ in found if f"revision {n}; why" in out) == [2, 3]
    assert history().revision == 3
    assert sorted(evidence_of()) == ["first", "second"]


@pytest.mark.thorough
def test_an_update_and_a_revert_at_once_follow_one_another(workdir: Path) -> None:
    update_and_write("first.json")
    found = at_once(("second.json",), ("--revert", POINT))
    assert [status for status, _, _ in found] == [0, 0], found
    assert evidence_of() in (["first"], ["second"])


@pytest.mark.thorough
def test_an_update_of_a_table_that_was_changed_meanwhile_is_refused(workdir: Path) -> None:
    """Without the lock around the whole, as a program may call it."""
    update = prepare_update("second.json", "./orbiter")
    update_and_write("first.json")
    before = contents(workdir)
    for out in (None, Path("copies")):
        with pytest.raises(InputError, match="was changed while the update was worked out from revision 1"):
            write_update(update, out, {})
    assert contents(workdir) == before
    edit(Path(f"orbiter/control_points/{POINT}.toml"), lambda text: text + "# mine\n")
    with pytest.raises(InputError, match="was changed while the update was worked out"):
        write_update(prepare_update("second.json", "./orbiter"), None, {}) and write_update(update, None, {})


@pytest.mark.thorough
def test_a_vehicle_is_free_again_where_its_writer_was_killed(workdir: Path) -> None:
    code = (
        "import time; from sim_heating.base.files import exclusive\n"
        "with exclusive('orbiter'): print('locked', flush=True); time.sleep(600)"
    )
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE) as owner:
        assert owner.stdout is not None
        assert owner.stdout.readline()
        owner.kill()
    update_and_write("first.json")
    assert history().revision == 2
    assert not list(Path("orbiter").glob(".sim_heating*"))


@pytest.mark.thorough
def test_a_revert_leaves_no_folder_behind(workdir: Path) -> None:
    before = sorted(Path("orbiter").rglob("*"))
    update_and_write("first.json")
    revert(Path("orbiter"), POINT)
    assert sorted(Path("orbiter").rglob("*")) == before


@pytest.mark.thorough
@pytest.mark.parametrize("deed", ["update", "revert", "copy"])
@posix
def test_a_kill_at_any_file_operation_leaves_one_whole_revision_or_the_other(deed: str, workdir: Path) -> None:
    """A sample of `python -m benchmarks.kills`, with effects, whose file is replaced together with the table."""
    fit = read_estimate("first.json")
    coating = {COATING: EstimatedParameter(value=1.3, sigma=0.02, unit="1")}
    write_estimate("first.json", fit.model_copy(update={"parameters": fit.parameters | coating}))

    def update(folder: Path) -> None:
        write_update(prepare_update("first.json", folder / "orbiter"), None, {}, lambda path, _: path.write_bytes(b"p"))

    def revise_copy(folder: Path) -> None:
        write_update(prepare_update("first.json", "./orbiter"), folder / "copies", {})

    def prepare(folder: Path) -> None:
        shutil.copytree("orbiter", folder / "orbiter")
        if deed == "revert":
            update(folder)

    case = {
        "update": Case(prepare, update, "orbiter"),
        "revert": Case(prepare, lambda folder: revert(folder / "orbiter", POINT), "orbiter"),
        "copy": Case(lambda _: None, revise_copy, "copies", fresh=True),
    }[deed]
    (workdir / "kills").mkdir()
    counted = kill_and_judge(case, random.Random(SEED).sample(range(10**6), KILLS), workdir / "kills")
    assert counted["kills"] == KILLS
    assert bad(counted) == 0, counted
