"""Ending signals at random moments of every command that takes long: exit status, object of `--json`, what is left.

Each command runs in a session and with temporary folders of its own. The signal comes at a moment between its start and
the time that it takes in whole. What must hold: the exit status is 128 and the signal's number, or that of a command
that had ended; standard output is the object of `--json` with that status; no process of the session is left, no
temporary folder, no lock or partial file; and what there is of results is whole.
"""

from __future__ import annotations

import contextlib
import json
import os
import random
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

from benchmarks.journals import SIGNALS, take_signals
from benchmarks.measure import Figure, Keep
from sim_heating.base.files import MARKER, results_digest
from tests.support.kills import CAMPAIGN, POINT, fit, inputs

PATIENCE_S, AFTERWARDS_S = 120.0, 10.0
"""Time after a signal within which a command ends, and after it the processes that it started [s]."""
LONGEST_S = 20.0
"""Latest moment of a signal to a link that follows a long flight [s]."""
TWO_MEASUREMENTS = 'scenario = "before.toml"\nseeds = [11, 12]'
"""The flight of the campaign."""


def commands() -> dict[str, str]:
    """Long commands by name; OUT is the folder of their results."""
    home = inputs()
    (home / "campaign.toml").write_text(CAMPAIGN.format(vehicle=home / "orbiter", point=POINT, flight=TWO_MEASUREMENTS))
    return {
        "run": f"run {home}/before.toml --out OUT",
        "synthesize": f"synthesize {home}/before.toml --out OUT",
        "predict": f"predict {home}/before --out OUT",
        "estimate": f"estimate {home}/before --out OUT --parameters ratio.scale",
        "close-loop": f"close-loop {home}/before --out OUT",
        "design": f"design {home}/before.toml --out OUT --evaluations 4",
        "plan": f"plan {home}/before_study.toml --out OUT --workers 2",
        "campaign": f"campaign {home}/campaign.toml --out OUT --workers 2",
        "figures": f"figures {home}/before --out OUT",
        "update-tables": f"update-tables {fit()} --vehicle {home}/orbiter --out OUT",
        "fmu export": f"fmu export {home}/orbiter --out OUT/a.fmu",
        "fmu export --ssp": f"fmu export {home}/orbiter --trajectory {home}/before.toml --ssp OUT/a.ssp",
        "new effect": "new effect shock --out OUT",
        "live": "live --demo --headless --out OUT",
    }


def session(leader: int) -> list[int]:
    """Processes of a session that live, by its leader's number."""
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):  # it has ended meanwhile
            state, _, _, number = (folder / "stat").read_text().rpartition(")")[2].split()[:4]
            if int(number) == leader and state != "Z":
                found.append(int(folder.name))
    return found


def start(arguments: str, place: Path) -> subprocess.Popen[bytes]:
    """A command with `--json` in a session of its own, which takes signals as one of a terminal does."""
    temporary = place / "tmp"
    temporary.mkdir(parents=True)
    command = [sys.executable, "-m", "sim_heating", *arguments.replace("OUT", str(place / "out")).split(), "--json"]

    with (place / "stdout").open("wb") as out, (place / "stderr").open("wb") as err:
        return subprocess.Popen(
            command, stdout=out, stderr=err, start_new_session=True, preexec_fn=take_signals,
            env=os.environ | {"TMPDIR": str(temporary)},
        )  # fmt: skip


def signalled(arguments: str, number: signal.Signals, moment_s: float, place: Path) -> list[str]:
    """Faults of a command that a signal reaches at a moment after its start; none where it ends as it should."""
    process = start(arguments, place)
    with contextlib.suppress(subprocess.TimeoutExpired):
        process.wait(moment_s)
    return faults_at(process, number, place)


def faults_at(process: subprocess.Popen[bytes], number: signal.Signals, place: Path) -> list[str]:
    """Faults of a command that `start` has begun, and that a signal reaches now.

    number : SIGINT goes to all processes of the terminal, the others to the command alone
    """
    if process.poll() is None:
        with contextlib.suppress(ProcessLookupError):
            (os.killpg if number == signal.SIGINT else os.kill)(process.pid, number)
    try:
        status = process.wait(PATIENCE_S)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
        return ["does not end"]
    return list(_faults(status, 128 + number, place)) + _left(process.pid, place)


def _faults(status: int, expected: int, place: Path) -> list[str]:
    faults = []
    if status not in (expected, 0):  # it may have done its work before the signal came, or none was sent
        faults.append(f"exit status {status}")
    try:
        if (told := json.loads((place / "stdout").read_text())["status"]) != status:
            faults.append(f"the object of --json says {told}, the process {status}")
    except (ValueError, KeyError, TypeError):
        faults.append("no object of --json")
    if "Traceback" in (place / "stderr").read_text():
        faults.append("traceback")
    return faults


def _left(leader: int, place: Path) -> list[str]:
    """Processes, temporary folders, locks, partial files and results that are not whole."""
    until = time.monotonic() + AFTERWARDS_S
    while (left := session(leader)) and time.monotonic() < until:
        time.sleep(0.1)
    faults = [f"{len(left)} processes are left"] if left else []
    for process in left:
        with contextlib.suppress(ProcessLookupError):
            os.kill(process, signal.SIGKILL)
    names = sorted(p.relative_to(place).as_posix() for p in (place / "tmp").iterdir())
    names += [
        p.relative_to(place).as_posix()
        for p in (place / "out").rglob("*")
        if p.name.endswith(".lock") or ".partial" in p.name
    ]
    if names:
        faults.append(f"left behind: {', '.join(names[:3])}")
    if (place / "out" / MARKER).exists() and results_digest(place / "out") is None:
        faults.append("results that are not whole")
    return faults


def signals(name: str, arguments: str, count: int, seed: int) -> list[str]:
    """Send signals to a command at random moments; faults, each with its signal and moment."""
    rng, told = random.Random(f"{seed}:{name}"), list[str]()
    with TemporaryDirectory() as folder:
        takes_s = duration_s(arguments, Path(folder) / "whole")
        for k in range(count):
            number, moment_s = rng.choice(SIGNALS), rng.uniform(0.1, takes_s)
            faults = signalled(arguments, number, moment_s, Path(folder) / f"{k}")
            told += [f"{name}, {number.name} after {moment_s:.2f} s: {fault}" for fault in faults]
    return told


def duration_s(arguments: str, place: Path) -> float:
    """Time that a command takes, at most LONGEST_S of a link that follows a long flight [s]."""
    begun = time.monotonic()
    process = start(arguments, place)
    with contextlib.suppress(subprocess.TimeoutExpired):
        process.wait(LONGEST_S)
    if process.poll() is None:
        process.send_signal(signal.SIGINT)
        process.wait()
    return min(time.monotonic() - begun, LONGEST_S)


def figures(count: int, seed: int, keep: Keep) -> list[Figure]:
    """Signals to each of the commands, `count` in all, and what went wrong."""
    each = -(-count // len(commands()))
    faults = list[str]()
    for name, arguments in commands().items():
        faults += keep(f"{each} signals to {name}", partial(signals, name, arguments, each, seed))
    return [
        Figure("signals at random moments", each * len(commands()), "", note=f"{each} to each command"),
        Figure("of these: wrong status, no object of --json, or anything left", len(faults), "", 0.0,
               note="; ".join(faults)[:2000]),
    ]  # fmt: skip
