"""The command `close-loop`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click
from rich.table import Table
from rich.text import Text

from sim_heating.base.errors import RunError
from sim_heating.cli.console import CONSOLE, ERRORS, OUT, PATH, print_outputs, progress_line


@click.command("close-loop")
@click.argument("records", type=PATH, nargs=-1, required=True)
@OUT
@click.option("--scheduler", metavar="ADDRESS", help="a Dask scheduler, as tcp://host:8786; default: local processes")
@click.option("--workers", type=click.IntRange(1), help="number of local processes; default: one a core")
def close_loop(records: tuple[Path, ...], out: Path, scheduler: str | None, workers: int | None) -> None:
    """Find what the declared model of flight RECORDS lacks, add it, and report the error before and after.

    RECORDS are directories of flight records, or directories that hold such; several are each treated by itself.
    """
    from sim_heating.base.files import require_writable
    from sim_heating.closure.batch import close_all, find_records, summary_row
    from sim_heating.closure.close import FILES, write_closed_loop
    from sim_heating.closure.close import close_loop as close_one
    from sim_heating.inputs.record import load_record

    found = find_records(records)
    if len(found) == 1:
        loaded = load_record(found[0])
        require_writable(out, FILES)
        with progress_line(loaded.name) as progress:
            closed = close_one(loaded, progress=progress)
            names = write_closed_loop(closed, out)
        CONSOLE.print(_shown([summary_row(closed.report)]))
        _tell(closed.report)
        print_outputs(out, names)
        return
    with progress_line("close-loop") as progress:
        rows = close_all(found, out, scheduler=scheduler, workers=workers, progress=progress)
    CONSOLE.print(_shown(rows))
    for row in rows:
        for line in row.get("verdicts", ()):
            CONSOLE.print(line)
    CONSOLE.print(f"Wrote {out}: summary.json, summary.csv, and a folder for each record")
    failed = [row for row in rows if "failed" in row]
    for row in failed:
        ERRORS.print(f"{row['record']}: {row['failed']}")
    if failed:
        raise RunError(f"{len(failed)} of {len(rows)} records failed; the others are done and kept")


def _shown(rows: list[dict[str, Any]]) -> Table:
    table = Table(title="What the declared models lack", title_justify="left")
    table.add_column("record", no_wrap=True)
    table.add_column("found", min_width=20)
    table.add_column("posterior", justify="right")
    for head in ("before, fit", "after, fit", "before, held out", "after, held out", "noise floor"):
        table.add_column(head, justify="right", max_width=8)
    errors = [f"{when}_{what}_rmse_K" for what in ("fit", "holdout") for when in ("before", "after")]
    for row in rows:
        if "failed" in row:
            table.add_row(row["record"], Text("failed", style="red"))
            continue
        cells = ["-" if row[key] is None else f"{row[key]:.2f} K" for key in (*errors, "noise_floor_K")]
        table.add_row(row["record"], _found(row), f"{row['posterior']:.3f}", *cells)
    return table


def _found(row: dict[str, Any]) -> Text:
    """What a row names; where the record itself is in doubt that comes first, and the effect is no finding."""
    effects = " + ".join(row["effects"])
    doubts = ", ".join(dict.fromkeys(row["doubts"]))
    return Text.assemble((doubts, "red"), f" ({effects})") if doubts else Text(effects)


def _tell(report: Any) -> None:
    """What a person should know beside the table."""
    for verdict in report.verdicts:
        CONSOLE.print(verdict.words)
    for effect in report.effects:
        told = ", ".join(_value(n, p) for n, p in effect.parameters.items())
        if told:
            CONSOLE.print(f"{effect.name}: {told}")
    if report.effects[0].name == "unknown":
        for line in report.evidence.proposal():
            CONSOLE.print(line)
    for line in report.warnings:
        CONSOLE.print(line)
    CONSOLE.print(f"Calibration: {report.false_alarm}")


def _value(name: str, parameter: Any) -> str:
    unit = "" if parameter.unit == "1" else f" {parameter.unit}"
    return f"{name} {parameter.value:.4g} +- {parameter.sigma:.2g}{unit}"
