"""Every command that writes, killed at every one of its file operations: what readers then see, and what is left.

    python -m benchmarks kills    # goes on where it was interrupted, from out/kills

How a command is killed and judged: tests/support/kills.py.
"""

from __future__ import annotations

import tempfile
from collections import Counter
from functools import partial
from pathlib import Path

import click

from benchmarks.measure import Figure, kept, save
from tests.support.kills import bad, case, kill_and_judge

COMMANDS = (
    "run", "synthesize", "predict", "estimate", "close-loop", "plan", "figures", "update-tables",
    "revert", "fmu export", "fmu export --ssp", "design", "campaign", "new record", "new scenario", "new vehicle",
    "new study", "new effect", "examples",
)  # fmt: skip
MOST = 40
"""Kills of a command at most, where it has more file operations."""


def run(most: int = MOST) -> list[Figure]:
    """Kill all commands, each at all its operations; at `most` of those of a command that has more, evenly spread."""
    keep, rows = kept(Path("out") / "kills"), dict[str, dict[str, int]]()
    for command in COMMANDS:
        for fresh in (False, True) if command not in ("update-tables", "revert") else (False,):
            label = f"{command}, {'new' if fresh else 'existing'} directory"
            rows[label] = keep(label, partial(_row, command, fresh, most))
            click.echo(f"{label}: {rows[label]}")
    figures = [
        Figure("commands and kinds of directory", len(rows), ""),
        Figure("file operations", sum(row["operations"] for row in rows.values()), ""),
        Figure("kills, one at each file operation", sum(row["kills"] for row in rows.values()), "",
               note=f"at {most} of those of a command that has more"),
        Figure("mixed results for a reader, or not the same results again", sum(map(bad, rows.values())), "", 0),
    ]  # fmt: skip
    save("kills", figures, {"commands": rows})
    return figures


def _row(command: str, fresh: bool, most: int) -> Counter[str]:
    with tempfile.TemporaryDirectory() as name:
        return kill_and_judge(case(command, fresh), None, Path(name), most)
