"""The command `sim-heating campaign`."""

from __future__ import annotations

from pathlib import Path

import click

from sim_heating.base.errors import RunError
from sim_heating.cli.console import CONSOLE, OUT, PATH, ROOT, print_table, print_warning, progress_line
from sim_heating.cli.output import report_files, report_results


@click.command()
@click.argument("campaign_file", metavar="CAMPAIGN", type=PATH)
@OUT
@click.option("--scheduler", metavar="ADDRESS", help="a Dask scheduler, as tcp://host:8786; default: local processes")
@click.option("--workers", type=click.IntRange(1), help="number of local processes; default: one a core")
@ROOT
def campaign(campaign_file: Path, out: Path, scheduler: str | None, workers: int | None, root: Path | None) -> None:
    """Fit all flights of a CAMPAIGN file: fly or read, close the loop, fit each manoeuvre, revise the tables, report.

    What is finished in the directory of the results, and still current, is not done again.
    """
    from sim_heating.base.files import all_files_written
    from sim_heating.campaign.report import totals
    from sim_heating.campaign.run import run_campaign
    from sim_heating.campaign.spec import load_campaign

    loaded = load_campaign(campaign_file, root=root)
    with progress_line(loaded.title) as progress:
        result = run_campaign(loaded, out, scheduler=scheduler, workers=workers, progress=progress)
    print_table(totals(result))
    for line in (*result.omitted, *result.refused):
        print_warning(line)
    CONSOLE.print(f"Wrote {out}: report.html, campaign.json, fits.csv, errors.csv, and a folder for each part")
    report_files(out, all_files_written(out))
    report_results(out / "campaign.json")
    failed = [r for r in (*result.closed, *result.fits, *result.joint) if "failed" in r]
    if failed:
        raise RunError(f"{len(failed)} parts failed; the others are done and kept")
