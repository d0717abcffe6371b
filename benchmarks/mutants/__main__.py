"""`python -m benchmarks.mutants`: run mutants, or one of them with all that it prints."""

from __future__ import annotations

import tempfile
from pathlib import Path

import click

from benchmarks.measure import table
from benchmarks.mutants import COUNT, LEDGER, SEED, inputs, run
from benchmarks.mutants.judge import mutant, run_numbers, write_mutant
from benchmarks.mutants.slips import run as run_slips
from benchmarks.mutants.subjects import command_text, execute


@click.command(help="Run damaged inputs of every format and count what becomes of them.")
@click.option("--count", type=click.IntRange(1), default=COUNT, show_default=True)
@click.option("--seed", type=int, default=SEED, show_default=True)
@click.option("--only", type=int, multiple=True, help="run these alone, with all that they print")
@click.option("--slips", type=click.IntRange(1), help="judge so many slips of the unit in shipped inputs instead")
def main(count: int, seed: int, only: tuple[int, ...], slips: int | None) -> None:
    """Run and print."""
    if slips is not None:
        click.echo(table(run_slips(slips, seed)))
        return
    if not only:
        click.echo(table(run(count, seed)))
        return
    for number in only:
        subject, command, file, done = mutant(inputs(), seed, number)
        click.echo(f"{number}: {file}: {done.what}\n$ {command_text(command)}")
        with tempfile.TemporaryDirectory() as work:
            folder = Path(work) / "case"
            write_mutant(inputs(), folder, subject, file, done)
            click.echo(f"exit status {execute(command, folder)}")
        for result in run_numbers(inputs(), seed, [number], LEDGER / "faults"):
            click.echo(f"-> {result.outcome} {result.message}\n")


if __name__ == "__main__":
    main()
