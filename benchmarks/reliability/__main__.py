"""`python -m benchmarks.reliability`: run all, or a sample of a few minutes."""

from __future__ import annotations

import click

from benchmarks.measure import table
from benchmarks.reliability import SEED, SMALL, run


@click.command(help="Run what no unit test reaches, and print what went wrong.")
@click.option("--small", is_flag=True, help="sizes of a few minutes")
@click.option("--seed", type=int, default=SEED, show_default=True)
def main(small: bool, seed: int) -> None:
    """Run and print."""
    click.echo(table(run(SMALL if small else None, seed, click.echo)))


if __name__ == "__main__":
    main()
