"""Whole commands in fresh processes, kernels in the cache: wall and processor time with goal and floor.

A floor is what no work on the rest of the program takes away: imports of the libraries that a command cannot do
without and a first kernel from the cache, the compiled kernels that it calls, and JSBSim's own steps. Each is measured
in the same rounds, as processor time. A goal is the stated time or 1.3 times the floor, whichever is longer.

Machines differ, and one that others use changes by the hour: a plain loop of Python is timed in the same rounds.

The last lines are of a machine that has nothing compiled yet: the installation of the README's first command from
the clients' cache of wheels, its demonstration, and its tests. The tests are also stated over the plain loop, which is
timed while they run.
"""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from statistics import median

from benchmarks.measure import Figure, save, spent_by_children_s

ROUNDS = 3
GOAL_OVER_FLOOR = 1.3
ADDITIONS = 1_000_000
LOOP_EVERY_S = 10.0
"""Time between two of these loops while tests run [s]."""
DEMO_S, INSTALLED_S = 30.0, 60.0
"""Goals of the first demonstration ever on a machine, and of its installation [s]."""
ROOT = Path(__file__).parents[1]
P04, P06, P08 = (f"scenarios/records/practice/{name}" for name in ("p04", "p06", "p08"))
POPU = "scenarios/popu_mach20.toml"
READING = "import click, rich.console, numpy, pydantic"
LIBRARIES = {
    "reads": READING,
    "computes": f"{READING}\nfrom sim_heating.heating.atmosphere import gravity\ngravity(0.0)",
    "draws": "import matplotlib.figure, matplotlib.backends.backend_agg, jinja2, PIL.Image",
    "stores": "import netCDF4, xarray\nxarray.Dataset({'a': ('time', [0.0])})",
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
    Command(("run", POPU), 4.0, ("computes", "draws", "stores"), True),
    Command(("synthesize", POPU), 3.5, ("computes", "draws"), True),
    Command(("close-loop", P08), 4.0, ("computes", "draws"), True),
    Command(("close-loop", P04), 9.0, ("computes", "draws"), True),
)


def _seconds(arguments: list[str], changed: Mapping[str, str] | None = None) -> tuple[float, float]:
    """Wall and processor time [s] of a process of Python."""
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}  # as a user has it
    before, start = spent_by_children_s(), time.perf_counter()
    subprocess.run(
        [sys.executable, *arguments], check=True, capture_output=True, env=environment | dict(changed or {}), cwd=ROOT
    )
    return time.perf_counter() - start, spent_by_children_s() - before


def _timed(command: Command) -> tuple[float, float]:
    with tempfile.TemporaryDirectory() as folder:
        return _seconds(["-m", "sim_heating", *_with_output(command, Path(folder))])


def _with_output(command: Command, folder: Path) -> tuple[str, ...]:
    return (*command.arguments, *(("--out", str(folder / "out")) if command.writes else ()))


def _floor(command: Command) -> tuple[float, float, float]:
    """Processor time [s] of the libraries of a command, of its kernels, and of JSBSim in it."""
    imports = [LIBRARIES[kind] for kind in command.work]
    code = [*imports, "import os", "os._exit(0)"]  # ends as a command does
    libraries = _seconds(["-c", "\n".join(code)])[1]
    if not command.writes:
        return libraries, 0.0, 0.0
    with tempfile.TemporaryDirectory() as folder:
        found = Path(folder) / "floor.json"
        _seconds(["-m", "benchmarks.command_floor", str(found), *_with_output(command, Path(folder))])
        parts = json.loads(found.read_text())
    return libraries, parts["kernels_s"], parts["jsbsim_s"]


def _additions_s() -> float:
    """Processor time [s] of a plain loop."""
    start, total = time.process_time(), 0
    for k in range(ADDITIONS):
        total += k
    return time.process_time() - start


def _commands() -> list[Figure]:
    """Time all commands; the first run of each, which may compile, does not count."""
    for command in COMMANDS:
        _timed(command)
    times: dict[Command, list[tuple[float, float]]] = {command: [] for command in COMMANDS}
    floors: dict[Command, list[tuple[float, float, float]]] = {command: [] for command in COMMANDS}
    additions = []
    for _ in range(ROUNDS):
        additions.append(_additions_s())
        for command in COMMANDS:
            times[command].append(_timed(command))
            floors[command].append(_floor(command))
    figures = [Figure("the machine: a million additions in a loop of Python, processor", median(additions), "s")]
    for command in COMMANDS:
        name = " ".join(command.arguments)
        wall, processor = (median(values) for values in zip(*times[command], strict=True))
        libraries, kernels, jsbsim = (median(values) for values in zip(*floors[command], strict=True))
        floor = libraries + kernels + jsbsim
        figures += [
            Figure(f"{name}, wall", wall, "s", max(command.goal_s, GOAL_OVER_FLOOR * floor)),
            Figure(
                f"{name}, processor",
                processor,
                "s",
                note=f"floor {floor:.2f} s: libraries {libraries:.2f}, kernels {kernels:.2f}, JSBSim {jsbsim:.2f}",
            ),
            Figure(f"{name}, processor over floor", processor / floor, ""),
        ]
    return figures


def _without_compiled(home: Path) -> dict[str, str]:
    """The environment of a user who has nothing compiled yet, with an empty home."""
    home.mkdir()
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}
    return environment | {"HOME": str(home), "XDG_CACHE_HOME": str(home / ".cache"), "MPLCONFIGDIR": str(home / "mpl")}


def _tests() -> list[Figure]:
    """The README's tests, nothing compiled, in a clone of the committed state, with this interpreter."""
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "clone"
        subprocess.run(["git", "clone", "-q", str(ROOT), str(copy)], check=True)
        # processes that tests start anywhere take the clone's package, too, and not the one that is installed
        environment = _without_compiled(Path(folder) / "home") | {"PYTHONPATH": str(copy)}
        before, start = spent_by_children_s(), time.perf_counter()
        command = [sys.executable, "-m", "pytest", "-n", "auto"]
        loops = []
        with subprocess.Popen(command, cwd=copy, env=environment, stdout=subprocess.DEVNULL) as tests:
            while tests.poll() is None:
                loops.append(_additions_s())
                with contextlib.suppress(subprocess.TimeoutExpired):
                    tests.wait(LOOP_EVERY_S)
        if tests.returncode:
            raise RuntimeError(f"the tests of the README's command ended with {tests.returncode}")
        wall, processor, loop = time.perf_counter() - start, spent_by_children_s() - before, median(loops)
    return [
        Figure("tests of the README's command, nothing compiled, wall", wall, "s"),
        Figure("tests of the README's command, nothing compiled, processor", processor, "s"),
        Figure("tests of the README's command, wall over a million additions", wall / loop, ""),
        Figure("tests of the README's command, processor over a million additions", processor / loop, ""),
    ]


def _first_ever() -> list[Figure]:
    """The README's first command on a machine that has nothing compiled: installation, then demonstration [s]."""
    with tempfile.TemporaryDirectory() as folder:
        environment = Path(folder) / ".venv"
        python = str(environment / "bin" / "python")
        copy = Path(folder) / "clone"
        subprocess.run(["git", "clone", "-q", str(ROOT), str(copy)], check=True)
        start = time.perf_counter()
        subprocess.run([sys.executable, "-m", "venv", str(environment)], check=True)
        subprocess.run([python, "-m", "pip", "install", "-q", "-e", "."], check=True, cwd=copy, capture_output=True)
        installed = time.perf_counter() - start
        start = time.perf_counter()
        subprocess.run(
            [python, "-m", "sim_heating", "demo", "--out", str(Path(folder) / "out")],
            check=True,
            cwd=copy,
            capture_output=True,
            env=_without_compiled(Path(folder) / "home"),
        )
        demo = time.perf_counter() - start
    return [
        Figure("installation of the README's first command, wheels cached, wall", installed, "s", INSTALLED_S),
        Figure("first demonstration, nothing compiled, wall", demo, "s", DEMO_S),
    ]


def run() -> list[Figure]:
    """Commands with everything compiled, then the first one ever, then the tests."""
    figures = [*_commands(), *_first_ever(), *_tests()]
    save("waiting", figures)
    return figures
