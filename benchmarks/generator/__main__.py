"""`python -m benchmarks.generator`: write flight records, and next to them the effect put into each."""

from __future__ import annotations

import time
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import click
import numpy as np

from benchmarks.generator.families import FAMILIES
from benchmarks.generator.record import make_and_write
from sim_heating.base.files import toml_text, write_text_atomic


def effect_names(asked: str) -> list[str]:
    """`all` (the none excepted), `none`, or names separated by commas."""
    if asked == "all":
        return [name for name in FAMILIES if name != "none"]
    names = [name.strip() for name in asked.split(",")]
    unknown = [name for name in names if name not in FAMILIES]
    if unknown:
        raise click.BadParameter(f"`{unknown[0]}` is not an effect; known: {', '.join(FAMILIES)}, or all")
    return names


@click.command(help="Write flight records with known undeclared effects, and answers.toml next to them.")
@click.option("--count", type=click.IntRange(1), required=True, help="how many records")
@click.option("--seed", type=click.IntRange(0), required=True, help="the same seed makes the same records")
@click.option("--effects", default="all", show_default=True, help="none, all, or names with commas, taken in turn")
@click.option("--out", type=click.Path(file_okay=False, path_type=Path), required=True, help="a new directory")
@click.option("--processes", type=click.IntRange(1), default=1, show_default=True)
def main(count: int, seed: int, effects: str, out: Path, processes: int) -> None:
    """Make and write."""
    names = effect_names(effects)
    turn = np.random.default_rng([seed, 0]).permutation(len(names))
    tasks = [(seed, i, names[turn[i % len(names)]], out) for i in range(count)]
    answers: dict[str, dict[str, Any]] = {}
    start, seconds = time.perf_counter(), []
    with get_context("spawn").Pool(processes) as pool:
        for name, answer, taken in pool.imap(make_and_write, tasks):
            answers[name] = answer
            seconds.append(taken)
            click.echo(f"{name}  {answer['effect']:<22} {answer['form']:<20} {taken:6.1f} s")
            write_text_atomic(out / "answers.toml", toml_text(answers))
    whole = time.perf_counter() - start
    click.echo(f"{count} records in {whole:.0f} s; median {np.median(seconds):.1f} s a record and process")


if __name__ == "__main__":
    main()
