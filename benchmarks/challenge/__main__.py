"""`python -m benchmarks.challenge`: write flight records, and next to them the truth of each."""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import time
from collections.abc import Sequence
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import click
import numpy as np

from benchmarks.challenge.files import toml_text
from benchmarks.challenge.record import WORLDS, make_and_write, whole_set


@click.command(help="Write flight records with known truth, and answers.toml next to them.")
@click.option("--count", type=click.IntRange(1), help="how many records; the whole set without")
@click.option("--seed", type=click.IntRange(0), required=True, help="the same seed makes the same records")
@click.option("--world", type=click.Choice(list(WORLDS)), default="exact", show_default=True, help="of the model")
@click.option("--classes", default="all", show_default=True, help="some of the world's, with commas")
@click.option("--out", type=click.Path(file_okay=False, path_type=Path), required=True, help="a new directory")
@click.option("--processes", type=click.IntRange(1), default=1, show_default=True)
def main(count: int | None, seed: int, world: str, classes: str, out: Path, processes: int) -> None:
    """Make and write."""
    known = WORLDS[world]
    names = list(known) if classes == "all" else chosen(classes, list(known))
    count = sum(known[name] for name in names) if count is None else count
    tasks = [(seed, number, of_class, out, world == "imperfect") for of_class, number in whole_set(count, names, world)]
    write_set(tasks, out, processes)


def chosen(asked: str, known: Sequence[str]) -> list[str]:
    """Classes with commas between them; a name that is not known is an error of the option."""
    names = [name.strip() for name in asked.split(",")]
    unknown = [name for name in names if name not in known]
    if unknown:
        raise click.BadParameter(f"`{unknown[0]}` is not a class; known: {', '.join(known)}, or all")
    return names


def write_set(tasks: Sequence[tuple[int, int, str, Path, bool]], out: Path, processes: int) -> None:
    """Make and write the records of all tasks in a directory that is new or empty; answers.toml grows with them."""
    if out.exists() and any(out.iterdir()):
        raise click.BadParameter(f"`{out}` is not empty; give a new directory")
    out.mkdir(parents=True, exist_ok=True)
    answers: dict[str, dict[str, Any]] = {}
    start, seconds = time.perf_counter(), []
    with get_context("spawn").Pool(processes) as pool:
        for name, answer, taken in pool.imap(make_and_write, tasks):
            answers[name] = answer
            seconds.append(taken)
            click.echo(f"{name:<12} {', '.join(answer['form']):<50} {answer['wall']:<13} {taken:6.1f} s")
            unfinished = out / "answers.toml.part"
            unfinished.write_text(toml_text(answers))
            unfinished.replace(out / "answers.toml")
    whole = time.perf_counter() - start
    click.echo(f"{len(tasks)} records in {whole:.0f} s; median {np.median(seconds):.1f} s a record and process")


if __name__ == "__main__":
    main()
