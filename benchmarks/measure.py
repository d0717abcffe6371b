"""Timing on a noisy machine: tasks to be compared run in turn, round by round; best times and median ratios count."""

from __future__ import annotations

import json
import platform
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim_heating.march import ensemble

RESULTS = Path(__file__).with_name("results")


@dataclass(frozen=True)
class Figure:
    """One line of the table; `target` is a bound on `value`, from above or (at_least) from below, or None."""

    what: str
    value: float
    unit: str
    target: float | None = None
    at_least: bool = False
    note: str = ""

    @property
    def verdict(self) -> str:
        """Whether the target is met."""
        if self.target is None:
            return ""
        kept = self.value >= self.target if self.at_least else self.value <= self.target
        return "yes" if kept else "NO"


@dataclass(frozen=True)
class Times:
    """Seconds of each round, by name, rounds in the same order."""

    seconds: Mapping[str, list[float]]

    def best(self, name: str) -> float:
        """Shortest of all rounds [s]."""
        return min(self.seconds[name])

    def ratio(self, name: str, over: str) -> float:
        """Median over the rounds of the ratio of two that ran side by side."""
        return float(np.median(np.array(self.seconds[name]) / np.array(self.seconds[over])))


Task = Callable[[], object]
Keep = Callable[[str, Callable[[], Any]], Any]
"""Name of a task and the task -> its result (`kept`)."""


def in_turn(tasks: Mapping[str, Task], rounds: int, prepare: Mapping[str, Task] | None = None) -> Times:
    """Run all tasks one after the other, `rounds` times; preparation is not timed."""
    seconds: dict[str, list[float]] = {name: [] for name in tasks}
    for _ in range(rounds):
        for name, task in tasks.items():
            if prepare and name in prepare:
                prepare[name]()
            start = time.perf_counter()
            task()
            seconds[name].append(time.perf_counter() - start)
    return Times(seconds)


def spent_by_children_s() -> float:
    """Processor time of all finished processes that this one started [s]."""
    import resource  # Unix alone; the tests import this module on Windows too

    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def resident_kB(process: int | str = "self") -> float:
    """Memory of a process, this one by default, that is in use [kB]; NaN where /proc does not tell."""
    path = Path(f"/proc/{process}/status")
    lines = path.read_text().splitlines() if path.exists() else []
    return next((float(line.split()[1]) for line in lines if line.startswith("VmRSS")), float("nan"))


@contextmanager
def one_thread() -> Iterator[None]:
    """Marches of an ensemble take one thread, however large."""
    before = ensemble.THREADED_POINT_STEPS
    ensemble.THREADED_POINT_STEPS = 10**18
    try:
        yield
    finally:
        ensemble.THREADED_POINT_STEPS = before


def span(values: Sequence[float] | NDArray[np.float64]) -> str:
    """Least and largest of a ratio that was measured in several rounds."""
    return f"{min(values):.2f} to {max(values):.2f} in {len(values)} rounds"


def table(figures: list[Figure]) -> str:
    """The figures as text, one a line."""
    lines = []
    for f in figures:
        bound = "" if f.target is None else f"{'>=' if f.at_least else '<='} {f.target:g}"
        lines.append(f"{f.what:<66}{f.value:>10.4g} {f.unit:<9}{bound:<9}{f.verdict:<4} {f.note}".rstrip())
    return "\n".join(lines)


def save(name: str, figures: list[Figure], more: Mapping[str, object] | None = None) -> Path:
    """Write the figures of a benchmark, and its further results, to results/<name>.json."""
    RESULTS.mkdir(exist_ok=True)
    path = RESULTS / f"{name}.json"
    content = {
        "machine": f"{platform.machine()}, {_processor()}",
        "figures": [{**asdict(f), "verdict": f.verdict} for f in figures],
        **(more or {}),
    }
    path.write_text(json.dumps(content, indent=1) + "\n")
    return path


def kept(folder: Path) -> Keep:
    """A function that runs a task, or reads what an earlier run that was interrupted has of it, by the task's name.

    Results are plain data. They are kept in a folder that is removed where the code has changed.
    """

    def keep(name: str, task: Callable[[], Any]) -> Any:
        path = folder / f"{name.replace('/', ' ')}.json"
        if not path.is_file():
            folder.mkdir(parents=True, exist_ok=True)
            partial = path.with_suffix(".partial")
            partial.write_text(json.dumps(task()))
            partial.replace(path)
        return json.loads(path.read_text())

    return keep


def _processor() -> str:
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.exists() else []
    names = [line.split(":")[1].strip() for line in lines if line.startswith("model name")]
    return f"{len(names)} x {names[0]}" if names else platform.processor()
