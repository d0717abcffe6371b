"""`python -m benchmarks.reliability`: run all, a sample of a few minutes, or as often as is stated."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, replace
from typing import Any

import click

from benchmarks.measure import table
from benchmarks.reliability import PARTS, SEED, SMALL, Sizes, run


def _size_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """An option for each size."""
    for field in reversed(fields(Sizes)):
        command = click.option(f"--{field.name}", type=click.IntRange(1), help=f"default: {field.default}")(command)
    return command


@click.command(help="Run what no unit test reaches, and print what went wrong.")
@click.option("--small", is_flag=True, help="sizes of a few minutes")
@click.option("--only", type=click.Choice([*PARTS]), help="this part alone; other rows of the results stay")
@click.option("--seed", type=int, default=SEED, show_default=True)
@_size_options
def main(small: bool, only: str | None, seed: int, **sizes: int | None) -> None:
    """Run and print."""
    stated = {name: count for name, count in sizes.items() if count is not None}
    click.echo(table(run(replace(SMALL if small else Sizes(), **stated), seed, click.echo, only)))


if __name__ == "__main__":
    main()
