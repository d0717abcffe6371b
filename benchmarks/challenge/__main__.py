"""`python -m benchmarks.challenge`: write flight records, and next to them the truth of each."""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from pathlib import Path

import click

from benchmarks.challenge.making import chosen, write_set
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
    names = list(known) if classes == "all" else chosen(classes, list(known), "a class")
    count = sum(known[name] for name in names) if count is None else count
    tasks = [(seed, number, of_class, out, world == "imperfect") for of_class, number in whole_set(count, names, world)]
    write_set(
        tasks,
        make_and_write,
        out,
        processes,
        lambda name, answer: f"{name:<12} {', '.join(answer['form']):<50} {answer['wall']:<13}",
    )


if __name__ == "__main__":
    main()
