"""Every command that writes, killed at every one of its file operations: what readers then see, and what is left.

    python -m benchmarks kills    # goes on where it was interrupted, from out/kills
    python -m benchmarks.kills --most 12 --command campaign --command "new record"    # and leaves the others' rows

How a command is killed and judged: tests/support/kills.py.
"""

from __future__ import annotations

import json
import tempfile
from collections import Counter
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import click

from benchmarks.measure import RESULTS, Figure, kept, save, table
from tests.support.kills import bad, case, kill_and_judge

COMMANDS = (
    "run", "synthesize", "predict", "estimate", "close-loop", "plan", "figures", "update-tables",
    "revert", "fmu export", "fmu export --ssp", "design", "campaign", "new record", "new scenario", "new vehicle",
    "new study", "new effect", "examples",
)  # fmt: skip
MOST = 40
"""Kills of a command at most, where it has more file operations."""


def run(most: int = MOST, commands: Sequence[str] = COMMANDS) -> list[Figure]:
    """Kill commands, each at all its operations; at `most` of those of a command that has more, evenly spread.

    Saved rows of other commands stay as they are.
    """
    keep, saved = kept(Path("out") / "kills"), RESULTS / "kills.json"
    rows: dict[str, dict[str, int]] = json.loads(saved.read_text())["commands"] if saved.is_file() else {}
    for command in commands:
        for fresh in (False, True) if command not in ("update-tables", "revert") else (False,):
            label = f"{command}, {'new' if fresh else 'existing'} directory"
            rows[label] = keep(f"{label}, {most}", partial(_row, command, fresh, most))
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


@click.command(help="Kill commands at their file operations, and print what went wrong.")
@click.option("--most", type=click.IntRange(2), default=MOST, show_default=True, help="kills of a command at most")
@click.option("--command", "commands", type=click.Choice(COMMANDS), multiple=True, help="these; repeat; default: all")
def main(most: int, commands: tuple[str, ...]) -> None:
    """Run and print."""
    click.echo(table(run(most, commands or COMMANDS)))


if __name__ == "__main__":
    main()
