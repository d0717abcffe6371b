"""Runs the example of every command's help in an empty folder, as a person does who has installed the package alone.

python -m tests.support.help_examples                    # all but the long ones; exit status 1 where one fails
python -m tests.support.help_examples validate predict   # those of these commands
"""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping
from pathlib import Path

EXAMPLE = re.compile(r"Example:\s+sim-heating\s+(.+?)\s*(?:\n\s*\n|\Z)", re.DOTALL)
FIRST = ("synthesize", "run", "estimate", "close-loop")
"""Commands whose examples write what those of others read."""
LONG = ("campaign", "design", "live", "credibility")
"""Commands run only where they are named: their examples take minutes, or as long as a flight, or are about a person's
own measurements."""
LAST = ("examples",)
"""Commands whose examples write files that those of others would read."""
TEMPERATURES = "time_s,surface_K,bond_K\n" + "".join(f"{t},{300 + 2 * t},{300 + 0.5 * t}\n" for t in range(0, 101, 5))
"""Readings that `new record --csv temperatures.csv` is about: a file that its reader has."""


def examples() -> Iterator[str]:
    """Arguments of the example of each command, those first that others need."""
    import click

    from sim_heating.cli import cli

    def walk(command: click.Command) -> Iterator[str]:
        texts = f"{command.help or ''}\n\n{command.epilog or ''}"
        yield from (" ".join(found.split()) for found in EXAMPLE.findall(texts))
        if isinstance(command, click.Group):
            context = click.Context(command)
            for name in command.list_commands(context):
                below = command.get_command(context, name)
                assert below is not None
                yield from walk(below)

    found = list(dict.fromkeys(walk(cli)))

    def place(line: str) -> int:
        word = line.split()[0]
        return FIRST.index(word) if word in FIRST else len(FIRST) + (word in LAST)

    yield from sorted(found, key=place)


def failures(folder: Path, only: tuple[str, ...] = (), environment: Mapping[str, str] | None = None) -> list[str]:
    """Run the examples in a folder; the last line of what each says that fails.

    only        : commands, by default all but the long ones
    environment : of the processes
    """
    (folder / "temperatures.csv").write_text(TEMPERATURES)
    wrong = []
    for line in examples():
        if line.split()[0] in LONG if not only else line.split()[0] not in only:
            continue
        start = time.perf_counter()
        done = subprocess.run(
            [sys.executable, "-m", "sim_heating", *shlex.split(line)],
            cwd=folder,
            capture_output=True,
            text=True,
            env=None if environment is None else dict(environment),
        )
        print(f"{time.perf_counter() - start:6.1f} s  {line}", flush=True)
        if done.returncode != 0:
            wrong.append(f"{line}: exit status {done.returncode}: {(done.stderr.strip() or 'nothing said')[-300:]}")
    return wrong


def main(only: tuple[str, ...]) -> int:
    """Run the examples of these commands in an empty folder; exit status."""
    with tempfile.TemporaryDirectory() as folder:
        wrong = failures(Path(folder), only, os.environ)
    print("\n".join(wrong) or "every example runs")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main(tuple(sys.argv[1:])))
