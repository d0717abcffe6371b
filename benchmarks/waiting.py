"""Whole commands in fresh processes, compiled kernels in the cache: wall and processor time beside goal and floor.

A floor is what no work on the package takes away: imports of the libraries that a command cannot do without, and a
first kernel from the cache. It is measured in the same rounds. The time that JSBSim itself takes for a flight, some 2 s
for the POPU, is not in it.
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from statistics import median

from benchmarks.measure import Figure, save

ROUNDS = 3
P06, POPU = "scenarios/records/practice/p06", "scenarios/popu_mach20.toml"
READING = "import click, rich.console, numpy, pydantic"
LIBRARIES = {
    "reads": READING,
    "computes": f"{READING}\nfrom sim_heating.heating.atmosphere import gravity\ngravity(0.0)",
    "draws": "import matplotlib.figure, matplotlib.backends.backend_agg, jinja2, PIL.Image",
}
"""Kind of work -> what a process that does it imports at least."""


@dataclass(frozen=True)
class Command:
    """A command with its goal [s] of wall time, and the kinds of work that make up its floor."""

    arguments: tuple[str, ...]
    goal_s: float
    work: tuple[str, ...] = ("reads",)
    writes: bool = False


COMMANDS = (
    Command(("--version",), 0.3, ()),
    Command(("validate", "aircraft_data/orbiter"), 0.6),
    Command(("validate", P06), 0.6),
    Command(("validate", POPU), 0.6, ("computes",)),
    Command(("predict", P06), 1.5, ("computes", "draws"), True),
    Command(("estimate", P06), 2.0, ("computes", "draws"), True),
    Command(("run", POPU), 4.0, ("computes", "draws"), True),
    Command(("synthesize", POPU), 3.5, ("computes",), True),
)


def _seconds(arguments: list[str]) -> tuple[float, float]:
    """Wall and processor time [s] of a process of Python."""
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}  # as a user has it
    before, start = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    subprocess.run([sys.executable, *arguments], check=True, capture_output=True, env=environment)
    wall, after = time.perf_counter() - start, resource.getrusage(resource.RUSAGE_CHILDREN)
    return wall, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def _timed(command: Command) -> tuple[float, float]:
    with tempfile.TemporaryDirectory() as folder:
        out = ["--out", str(Path(folder) / "out")] if command.writes else []
        return _seconds(["-m", "sim_heating", *command.arguments, *out])


def run() -> list[Figure]:
    """Time all commands; the first run of each, which may compile, does not count."""
    for command in COMMANDS:
        _timed(command)
    times: dict[Command, list[tuple[float, float]]] = {command: [] for command in COMMANDS}
    floors: dict[Command, list[float]] = {command: [] for command in COMMANDS}
    for _ in range(ROUNDS):
        for command in COMMANDS:
            times[command].append(_timed(command))
            floors[command].append(_seconds(["-c", "\n".join(LIBRARIES[kind] for kind in command.work)])[1])
    figures = []
    for command in COMMANDS:
        name = " ".join(command.arguments)
        wall, processor = (median(values) for values in zip(*times[command], strict=True))
        floor = median(floors[command])
        figures += [
            Figure(f"{name}, wall", wall, "s", command.goal_s),
            Figure(f"{name}, processor", processor, "s", note=f"libraries alone {floor:.2f} s"),
        ]
    save("waiting", figures)
    return figures
