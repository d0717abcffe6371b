"""close-loop on the ten practice records: how long it takes on one core, all candidates included.

Each is closed in this process ROUNDS times, and so is the whole command, a new process with imports, pictures and
report, on one core where the system can bind them to it; shortest times count. Findings are listed, not assessed.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path

from benchmarks.measure import Figure, save, spent_by_children_s

RECORDS = Path("scenarios") / "records" / "practice"
ROUNDS = 3


@dataclass(frozen=True)
class Row:
    """A record, effects named, and processor time of closing its loop and of the whole command [s]."""

    record: str
    named: str
    close_s: float
    command_s: float


def run() -> list[Figure]:
    """The time of each record, and the longest of both kinds."""
    folders = sorted(path for path in RECORDS.iterdir() if (path / "record.toml").is_file())
    with one_core():
        command_s(folders[0], rounds=1)  # kernels are compiled
        rows = [timed(folder) for folder in folders]
    longest, whole = max(rows, key=lambda r: r.close_s), max(rows, key=lambda r: r.command_s)
    figures = [
        *(Figure(f"{r.record}: {r.named}", r.close_s, "s") for r in rows),
        Figure("longest", longest.close_s, "s", 10.0, note=longest.record),
        Figure("longest whole command", whole.command_s, "s", note=whole.record),
    ]
    save("practice", figures, {"rows": [asdict(r) for r in rows]})
    return figures


@contextmanager
def one_core() -> Iterator[None]:
    """This process and its children on one core, where the system can do that."""
    if not hasattr(os, "sched_setaffinity"):
        yield
        return
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {min(before)})
    try:
        yield
    finally:
        os.sched_setaffinity(0, before)


def timed(folder: Path) -> Row:
    """Close the loop on a record, here and as a command."""
    from sim_heating.closure.close import close_loop
    from sim_heating.inputs.record import load_record

    record, seconds, named = load_record(folder), [], ""
    for _ in range(ROUNDS):
        start = time.process_time()
        named = " and ".join(close_loop(record).search.names)
        seconds.append(time.process_time() - start)
    return Row(folder.name, named, min(seconds), command_s(folder))


def command_s(folder: Path, rounds: int = ROUNDS) -> float:
    """Processor time [s] of `sim-heating close-loop` on a record."""
    times = []
    for _ in range(rounds):
        with tempfile.TemporaryDirectory() as out:
            begun = spent_by_children_s()
            command = [sys.executable, "-m", "sim_heating", "close-loop", str(folder), "--out", f"{out}/closed"]
            subprocess.run(command, check=True, capture_output=True)
            times.append(spent_by_children_s() - begun)
    return min(times)
