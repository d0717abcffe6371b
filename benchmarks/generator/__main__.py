"""`python -m benchmarks.generator`: write flight records, and next to them the effect put into each."""

from __future__ import annotations

from pathlib import Path

import click
import numpy as np

from benchmarks.challenge.making import chosen, write_set
from benchmarks.generator.families import FAMILIES
from benchmarks.generator.record import make_and_write


def effect_names(asked: str) -> list[str]:
    """`all` (the none excepted), `none`, or names separated by commas."""
    if asked == "all":
        return [name for name in FAMILIES if name != "none"]
    return chosen(asked, list(FAMILIES), "an effect")


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
    write_set(
        tasks,
        make_and_write,
        out,
        processes,
        lambda name, answer: f"{name}  {answer['effect']:<22} {answer['form']:<20}",
    )


if __name__ == "__main__":
    main()
