"""`python -m benchmarks [name ...]`: run the benchmarks named, all by default, and print one table."""

from __future__ import annotations

import importlib
import sys

import click

from benchmarks.measure import Figure, table

NAMES = (
    "verification", "c_loop", "work_precision", "frames", "coupling", "fmu", "optimal", "envelope",
    "end_to_end", "ground_step", "skew", "segments", "design",
    "estimator_speed", "estimator_null", "estimator_statistics", "process_noise", "residual", "sts96", "tile_phases",
    "tile_left_out", "coverage",
    "kaowool", "paper_figures", "dispersion", "dispersed_entry", "demo", "practice", "findings",
    "closure", "closure_challenge", "campaign",
    "live", "journals", "mutants", "kills", "study_kills", "concurrency", "reliability",
    "pages", "live_page",
    "live_hour",
    "waiting", "scaling", "layouts",
)  # fmt: skip


@click.command(help=f"Run benchmarks and print what they found. Names: {', '.join(NAMES)}; all by default.")
@click.argument("names", nargs=-1, type=click.Choice(NAMES))
def main(names: tuple[str, ...]) -> None:
    """Run and print."""
    missed: list[Figure] = []
    for name in names or NAMES:
        click.echo(f"\n{name}: {(importlib.import_module(f'benchmarks.{name}').__doc__ or '').splitlines()[0]}")
        figures = importlib.import_module(f"benchmarks.{name}").run()
        click.echo(table(figures))
        missed += [f for f in figures if f.verdict == "NO"]
    click.echo(f"\nresults in benchmarks/results; {len(missed)} of the targets missed")
    sys.exit(1 if missed else 0)


if __name__ == "__main__":
    main()
