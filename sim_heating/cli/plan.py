"""The command `sim-heating plan`."""

from __future__ import annotations

from pathlib import Path

import click

from sim_heating.base.errors import RunError
from sim_heating.cli.console import CONSOLE, ERRORS, OUT, PATH, ROOT, print_outputs, print_table, progress_line


@click.command()
@click.argument("study", type=PATH)
@OUT
@click.option("--scheduler", metavar="ADDRESS", help="a Dask scheduler, as tcp://host:8786; default: local processes")
@click.option("--workers", type=click.IntRange(1), help="number of local processes; default: one a core")
@click.option("--vehicle", help="fly this vehicle, by name or directory, instead of the study's own")
@ROOT
def plan(
    study: Path, out: Path, scheduler: str | None, workers: int | None, vehicle: str | None, root: Path | None
) -> None:
    """Plan missions with the tables: dispersions, envelopes, optimal entries of a study."""
    from sim_heating.planning.plan import plan as run_study
    from sim_heating.planning.study import load_study

    loaded = load_study(study, vehicle, root=root)
    with progress_line(loaded.title) as progress:
        planned = run_study(loaded, out, scheduler=scheduler, workers=workers, progress=progress)
    for result in planned.results.values():
        for table in result.tables:
            print_table(table)
        for note in result.notes:
            CONSOLE.print(note)
    print_outputs(out, planned.files, "study.json")
    for name, why in planned.failed.items():
        ERRORS.print(f"{name}: {why}")
    if planned.failed:
        done = f"; {', '.join(planned.results)} completed, results kept" if planned.results else ""
        raise RunError(f"{', '.join(planned.failed)}: no result{done}")
