"""Two commands at once that write into one place: each ends whole or is refused in a line, and none is mixed.

Two processes of the program start together, several times for each pair, with a delay between them that grows from pair
to pair. What is there in the end must be whole, and what one of them, or both in turn, would have left alone.
"""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

import click

from benchmarks.measure import Figure, save
from sim_heating.base.files import MARKER, results_digest
from tests.support.kills import POINT, fit, inputs, snapshot

REPETITIONS = 4
DELAY_S = 0.4
"""Delay of the second process, times the number of the repetition [s]."""


def pairs() -> dict[str, tuple[str, str]]:
    """Pair -> the arguments of both commands; `PLACE` is the folder that both write into."""
    home = inputs()
    both = {
        name: tuple(f"{name} {home / flight}{suffix} --out PLACE/out{more}" for flight in ("before", "after"))
        for name, suffix, more in (
            ("run", ".toml", ""),
            ("synthesize", ".toml", ""),
            ("predict", "", ""),
            ("estimate", "", " --parameters ratio.scale"),
            ("plan", "_study.toml", " --workers 1"),
        )
    }
    update = f"update-tables {fit()} --vehicle PLACE/orbiter"
    export = f"fmu export {home / 'orbiter'} --out PLACE/out/a.fmu"
    return {
        **{name: (first, second) for name, (first, second) in both.items()},
        "two updates of one table": (update, update),
        "update and revert": (update, f"update-tables --vehicle PLACE/orbiter --revert {POINT}"),
        "fmu export": (f"{export} --fmi 2", f"{export} --fmi 3"),
    }


def start(arguments: str, place: Path) -> subprocess.Popen[str]:
    """Start a command."""
    command = [sys.executable, "-m", "sim_heating", *arguments.replace("PLACE", str(place)).split()]
    return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)


def race(pair: tuple[str, str], place: Path, delay_s: float) -> str:
    """Run both commands into a place; how it went, in words.

    delay_s : of the second
    """
    shutil.copytree(inputs() / "orbiter", place / "orbiter")
    first = start(pair[0], place)
    time.sleep(delay_s)
    second = start(pair[1], place)
    ended = [(run.communicate()[1], run.returncode) for run in (first, second)]
    lines = [[line for line in error.splitlines() if not line.endswith("...")] for error, _ in ended]
    for (_, status), found in zip(ended, lines, strict=True):
        if status not in (0, 2) or (status == 2 and len(found) != 1):
            return f"fault: status {status}, {len(found)} lines: {' '.join(found)[:200]}"
    done = sum(status == 0 for _, status in ended)
    made = sorted((place / "orbiter").rglob("revision_*.json"))
    if "update-tables" in pair[0]:
        reverted = "--revert" in pair[1] and ended[1][1] == 0
        numbers = [json.loads(p.read_text())["revision"] for p in made]
        if len(made) != done - 2 * reverted or len(set(numbers)) != len(numbers):
            return f"fault: {done} commands succeeded and there are {len(made)} revisions"
    elif (place / "out" / MARKER).exists() and results_digest(place / "out") is None:
        return "fault: the results are not whole"
    left = [name for name in snapshot(place) if name.endswith(".lock") or ".partial" in name]
    if left or done == 0:
        return f"fault: {done} succeeded, left behind: {', '.join(left)}"
    return "both, one after the other" if done == 2 else "one refused"


def run() -> list[Figure]:
    """Race all pairs."""
    rows: dict[str, dict[str, int]] = {}
    with tempfile.TemporaryDirectory() as name:
        for label, pair in pairs().items():
            counted: Counter[str] = Counter()
            for k in range(REPETITIONS):
                counted[race(pair, Path(name) / f"{len(rows)}_{k}", k * DELAY_S)] += 1
            rows[label] = dict(counted)
            click.echo(f"{label}: {rows[label]}")
    faults = sum(n for row in rows.values() for how, n in row.items() if how.startswith("fault"))
    figures = [
        Figure("pairs of commands", len(rows), ""),
        Figure("times that two ran at once", len(rows) * REPETITIONS, ""),
        Figure("lost, mixed or unclear results", faults, "", 0),
    ]
    save("concurrency", figures, {"pairs": rows})
    return figures
