"""A study on two processes, killed with them at random moments: what is finished is kept, and the same bytes follow.

`kills` kills one process at each of its file operations. Here `sim-heating plan` runs with two workers and its whole
process group is killed; one process goes on. A reader must find no summary without its page, no batch that was finished
may be computed again, and the results must be the bytes of a study that nothing disturbed.
"""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import click

from benchmarks.measure import Figure, save
from sim_heating.planning.plan import PAGE, SUMMARY
from tests.support.kills import inputs, readable, snapshot
from tests.support.studies import finished_batches

KILLS = 20
FLIGHTS = 48
MOST_BATCHES = 6
"""Finished batches after which a kill comes, at most; the study has a few more."""


def start(study: Path, out: Path, workers: int) -> subprocess.Popen[bytes]:
    """The command in a session of its own, so that its workers can be killed with it."""
    command = [
        sys.executable,
        "-m",
        "sim_heating",
        "plan",
        str(study),
        "--out",
        str(out),
        "--workers",
        str(workers),
        "--quiet",
    ]
    return subprocess.Popen(command, start_new_session=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def kill_once(study: Path, out: Path, batches: int, wait_s: float) -> bool:
    """Start a study and kill it, some time after a number of its batches is finished; whether it still ran."""
    run = start(study, out, 2)
    while run.poll() is None and len(finished_batches(out)) < batches:
        time.sleep(0.005)
    time.sleep(wait_s)
    running = run.poll() is None
    if running:
        os.killpg(run.pid, signal.SIGKILL)
    run.wait()
    return running


def run() -> list[Figure]:
    """Kill a study at random moments after its first batch, and let one process go on."""
    moments, faults, kills = random.Random(1), list[str](), 0
    with tempfile.TemporaryDirectory() as name:
        study = inputs() / "long_study.toml"
        text = (inputs() / "after_study.toml").read_text()
        study.write_text(text.replace("flights = 12", f"flights = {FLIGHTS}").replace("scrambles = 3", "scrambles = 6"))
        assert start(study, Path(name) / "whole", 2).wait() == 0
        whole = readable(snapshot(Path(name) / "whole"))
        for number in range(KILLS):
            out = Path(name) / f"killed_{number}"
            kills += kill_once(study, out, moments.randint(0, MOST_BATCHES), moments.uniform(0.0, 0.3))
            if (out / SUMMARY).exists() and not (out / PAGE).exists():
                faults.append(f"kill {number}: a summary without its page")
            kept = finished_batches(out)
            if start(study, out, 1).wait() != 0 or readable(snapshot(out)) != whole:
                faults.append(f"kill {number}: other results")
            if {p: t for p, t in finished_batches(out).items() if p in kept} != kept:
                faults.append(f"kill {number}: a finished batch was computed again")
            click.echo(f"{number + 1} of {KILLS}: {len(kept)} batches kept, {len(faults)} faults")
    figures = [
        Figure("kills of a study on two processes", kills, "", note=f"of {KILLS} runs; the others had ended"),
        Figure(
            "of these, anything but the same bytes without computing twice", len(faults), "", 0, note="; ".join(faults)
        ),
    ]
    save("study_kills", figures)
    return figures
