"""Making of a whole set of records in several processes, with the truth of each in answers.toml."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import click
import numpy as np

from benchmarks.challenge.files import toml_text

Made = tuple[str, dict[str, Any], float]
"""Name of a record, its entry in answers.toml, and the time that it took [s]."""


def chosen(asked: str, known: Sequence[str], noun: str) -> list[str]:
    """Names with commas between them; a name that is not known is an error of the option."""
    names = [name.strip() for name in asked.split(",")]
    unknown = [name for name in names if name not in known]
    if unknown:
        raise click.BadParameter(f"`{unknown[0]}` is not {noun}; known: {', '.join(known)}, or all")
    return names


def write_set(
    tasks: Sequence[Any],
    make_and_write: Callable[[Any], Made],
    out: Path,
    processes: int,
    line: Callable[[str, dict[str, Any]], str],
) -> None:
    """Make and write the records of all tasks in a directory that is new or empty; answers.toml grows with them.

    line : of a record's name and answer, printed when it is written
    """
    if out.exists() and any(out.iterdir()):
        raise click.BadParameter(f"`{out}` is not empty; give a new directory")
    out.mkdir(parents=True, exist_ok=True)
    answers: dict[str, dict[str, Any]] = {}
    start, seconds = time.perf_counter(), []
    with get_context("spawn").Pool(processes) as pool:
        for name, answer, taken in pool.imap(make_and_write, tasks):
            answers[name] = answer
            seconds.append(taken)
            click.echo(f"{line(name, answer)} {taken:6.1f} s")
            unfinished = out / "answers.toml.part"
            unfinished.write_text(toml_text(answers))
            unfinished.replace(out / "answers.toml")
    whole = time.perf_counter() - start
    click.echo(f"{len(tasks)} records in {whole:.0f} s; median {np.median(seconds):.1f} s a record and process")
