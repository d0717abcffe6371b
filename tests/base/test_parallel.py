"""Batches of jobs: equal bytes wherever they are computed, and results that survive kills, deaths and errors."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

import pytest

from sim_heating.base.errors import InputError, RunError
from sim_heating.base.files import exclusive
from sim_heating.base.parallel import batches
from sim_heating.base.parallel.batches import Job, run_batches
from tests.support import batch_jobs
from tests.support.batch_jobs import jobs
from tests.support.paths import ROOT
from tests.support.systems import posix

pytest.importorskip("distributed", reason="many processes need Dask: pip install 'sim-heating[plan]'")

pytestmark = posix
SCRIPT = Path(batch_jobs.__file__)


def contents(folder):
    return {p.name: p.read_bytes() for p in sorted(folder.iterdir())}


@pytest.mark.thorough
def test_one_process_and_two_leave_the_same_bytes(tmp_path):
    (tmp_path / "notes").mkdir()
    function = partial(batch_jobs.square, tmp_path / "notes")
    for workers in (1, 2):
        outcome = run_batches(jobs(12), function, tmp_path / str(workers), workers=workers)
        assert list(outcome.done) == [j.id for j in jobs(12)]
        assert not outcome.failed
    assert contents(tmp_path / "1") == contents(tmp_path / "2")


@pytest.mark.sample(1)
@pytest.mark.parametrize("workers", [1, 2])
def test_a_job_that_raises_is_reported_and_the_others_continue(tmp_path, workers):
    outcome = run_batches(jobs(6), batch_jobs.square_but_three, tmp_path, workers=workers)
    assert outcome.failed == {"job-003": "ValueError: three is not for me"}
    assert sorted(outcome.done) == [f"job-{k:03d}" for k in (0, 1, 2, 4, 5)]
    again = run_batches(jobs(6), _square, tmp_path, workers=1)
    assert not again.failed
    assert again.done["job-003"].read_bytes() == b"9\n"
    assert not (tmp_path / "job-003.error").exists()


def _square(task):
    return f"{task * task}\n".encode()


@pytest.mark.thorough
def test_jobs_of_a_worker_that_dies_are_run_by_another(tmp_path):
    (tmp_path / "notes").mkdir()
    function = partial(batch_jobs.square_that_dies_once, tmp_path / "notes")
    outcome = run_batches(jobs(8), function, tmp_path / "out", workers=2)
    assert not outcome.failed
    assert len(outcome.done) == 8
    assert (tmp_path / "notes" / "died").exists()


@pytest.mark.thorough
def test_a_job_that_kills_every_worker_fails_alone(tmp_path):
    outcome = run_batches(jobs(6), batch_jobs.square_that_kills, tmp_path, workers=2)
    assert list(outcome.failed) == ["job-003"]
    assert "died" in outcome.failed["job-003"]
    assert len(outcome.done) == 5


@pytest.mark.thorough
def test_a_run_killed_at_any_moment_resumes_where_it_stopped(tmp_path):
    count, random_moments = 40, random.Random(5)
    whole = tmp_path / "whole"
    (tmp_path / "a").mkdir()
    run_batches(jobs(count), partial(batch_jobs.square, tmp_path / "a"), whole, workers=1)
    out, notes = tmp_path / "out", tmp_path / "b"
    kills = 0
    for _ in range(3):
        run = _start(out, notes, count, 2)
        before = _finished(out)
        wanted = before + random_moments.randint(1, 6)
        while run.poll() is None and _finished(out) < wanted:
            time.sleep(0.002)
        if run.poll() is None:
            time.sleep(random_moments.uniform(0.0, 0.05))
            os.killpg(run.pid, signal.SIGKILL)
            kills += 1
        run.wait()
    assert not run_batches(jobs(count), partial(batch_jobs.square, notes), out, workers=1).failed
    assert kills == 3
    done = contents(out)
    assert done == contents(whole)
    lost = len(list(notes.iterdir())) - count
    assert lost <= kills * 2 * 3  # what two workers had in hand at each kill


def _finished(out):
    return sum(1 for p in out.iterdir() if not p.name.startswith(".")) if out.exists() else 0


def _start(out, notes, count, workers):
    notes.mkdir(exist_ok=True)
    arguments = [sys.executable, str(SCRIPT), str(out), str(notes), str(count), str(workers)]
    path = os.pathsep.join([str(SCRIPT.parent.parent), os.environ.get("PYTHONPATH", "")])
    return subprocess.Popen(arguments, env=os.environ | {"PYTHONPATH": path}, start_new_session=True)


@pytest.mark.thorough
def test_the_processes_of_a_study_listen_on_this_machine_alone(tmp_path):
    """The kernel is asked for the open sockets of the study's whole process tree while its jobs run."""
    psutil = pytest.importorskip("psutil", reason="Dask brings psutil, which lists the sockets of a process")
    release, found = tmp_path / "release", []

    def look():
        try:
            _wait_until(lambda: (tmp_path / "running-0").exists() and (tmp_path / "running-1").exists())
            here = psutil.Process()
            sockets = [(p.pid, c) for p in (here, *here.children(recursive=True)) for c in p.net_connections("inet")]
            found.extend((pid, c.laddr.ip) for pid, c in sockets if c.laddr and not c.raddr)
        finally:
            release.touch()

    with ThreadPoolExecutor(1) as other:
        looked = other.submit(look)
        outcome = run_batches(jobs(2), partial(batch_jobs.wait_for, release), tmp_path / "out", workers=2)
        looked.result()
    assert not outcome.failed
    assert len({pid for pid, _ in found}) >= 3  # this process with the scheduler, and two workers
    assert {address for _, address in found} == {"127.0.0.1"}


def _wait_until(condition, limit_s=120.0):
    end = time.monotonic() + limit_s
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.02)


def test_an_absent_scheduler_is_one_clear_line(tmp_path, monkeypatch):
    monkeypatch.setattr(batches, "SCHEDULER_TIMEOUT_S", 1.0)
    with pytest.raises(InputError, match="no Dask scheduler answers there") as caught:
        run_batches(jobs(2), batch_jobs.square_but_three, tmp_path, scheduler="tcp://127.0.0.1:1")
    assert len(str(caught.value).splitlines()) == 1


def test_an_existing_scheduler_does_the_work(tmp_path):
    from distributed import LocalCluster

    with LocalCluster(n_workers=1, threads_per_worker=1, processes=False, dashboard_address="127.0.0.1:0") as cluster:
        outcome = run_batches(jobs(5), _square, tmp_path, scheduler=cluster.scheduler_address)
    assert [outcome.done[j.id].read_bytes() for j in jobs(5)] == [b"0\n", b"1\n", b"4\n", b"9\n", b"16\n"]


def test_a_lost_scheduler_is_one_line_and_finished_results_remain(tmp_path):
    from distributed import LocalCluster

    (tmp_path / "notes").mkdir()
    function, out = partial(batch_jobs.square, tmp_path / "notes"), tmp_path / "out"
    with LocalCluster(n_workers=1, threads_per_worker=1, processes=False, dashboard_address="127.0.0.1:0") as cluster:

        def lose(done, _text):
            if done > 0.0:
                cluster.close()

        with pytest.raises(RunError, match=r"lost with \d+ batches to go; run the command again") as caught:
            run_batches(jobs(12), function, out, scheduler=cluster.scheduler_address, progress=lose)
    assert len(str(caught.value).splitlines()) == 1
    kept = contents(out)
    assert 0 < len(kept) < 12
    assert run_batches(jobs(12), function, out, workers=1).failed == {}
    assert kept.items() <= contents(out).items()


def test_jobs_that_share_an_id_are_refused(tmp_path):
    with pytest.raises(InputError, match="is repeated"):
        run_batches([Job("a", 1), Job("a", 2)], _square, tmp_path, workers=1)


@pytest.mark.parametrize("damage", [b"", b"1", b"\xff", None], ids=["empty", "another", "not UTF-8", "removed"])
def test_a_finished_result_that_was_damaged_is_computed_again(tmp_path, damage):
    first = contents_of(run_batches(jobs(3), _square, tmp_path, workers=1))
    kept = (tmp_path / "job-000").stat().st_mtime_ns
    if damage is None:
        (tmp_path / ".job-001.sha256").unlink()
    else:
        (tmp_path / "job-001").write_bytes(damage)
    assert contents_of(run_batches(jobs(3), _square, tmp_path, workers=1)) == first
    assert (tmp_path / "job-000").stat().st_mtime_ns == kept


def test_a_finished_result_that_no_longer_holds_is_computed_again(tmp_path):
    run_batches(jobs(3), _square, tmp_path, workers=1)
    kept = {job.id: (tmp_path / job.id).stat().st_mtime_ns for job in jobs(3)}
    run_batches(jobs(3), _square, tmp_path, workers=1, is_current=lambda job, result: job.id != "job-002")
    assert [job.id for job in jobs(3) if (tmp_path / job.id).stat().st_mtime_ns != kept[job.id]] == ["job-002"]


@pytest.mark.thorough
def test_two_runs_on_one_ledger_are_not_mixed(tmp_path):
    with exclusive(tmp_path):
        code = (
            f"from tests.support.batch_jobs import *; run_batches(jobs(3), square_but_three, Path({str(tmp_path)!r}))"
        )
        second = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT)
    assert "another sim-heating process is writing there" in second.stderr


def contents_of(outcome):
    return {name: path.read_bytes() for name, path in outcome.done.items()}
