"""Jobs for the engine's tests: modules that worker processes can import."""

from __future__ import annotations

import os
import sys
import time
from functools import partial
from pathlib import Path

from sim_heating.base.parallel.batches import Job, run_batches


def square(notes: Path, task: int) -> bytes:
    """A slow square that leaves a note of each time it was computed."""
    time.sleep(0.05)
    (notes / f"{task}-{os.getpid()}-{time.monotonic_ns()}").touch()
    return f"{task * task}\n".encode()


def square_but_three(task: int) -> bytes:
    """Raises for 3."""
    if task == 3:
        raise ValueError("three\nis not for me")
    return f"{task * task}\n".encode()


def square_that_dies_once(notes: Path, task: int) -> bytes:
    """Takes its process with it the first time that it meets 3."""
    if task == 3 and not (notes / "died").exists():
        (notes / "died").touch()
        os._exit(9)
    return f"{task * task}\n".encode()


def square_that_kills(task: int) -> bytes:
    """Takes its process with it whenever it meets 3."""
    if task == 3:
        os._exit(9)
    return f"{task * task}\n".encode()


def wait_for(release: Path, task: int) -> bytes:
    """Leaves a note that it runs, and ends when the file `release` exists."""
    release.with_name(f"running-{task}").touch()
    while not release.exists():
        time.sleep(0.02)
    return b"done"


def jobs(count: int) -> list[Job]:
    """Numbered jobs."""
    return [Job(f"job-{k:03d}", k) for k in range(count)]


if __name__ == "__main__":
    out, notes, count, workers = Path(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3]), int(sys.argv[4])
    run_batches(jobs(count), partial(square, notes), out, workers=workers)
