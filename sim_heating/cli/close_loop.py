"""The command `sim-heating close-loop`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from sim_heating.base.errors import RunError
from sim_heating.cli.console import (
    CONSOLE,
    ERRORS,
    OUT,
    PATH,
    ROOT,
    comma_list,
    print_outputs,
    print_table,
    progress_line,
)

if TYPE_CHECKING:
    from sim_heating.closure.report import Closure, ParameterEstimate


@click.command("close-loop")
@click.argument("records", type=PATH, nargs=-1, required=True)
@OUT
@click.option(
    "--parameters",
    callback=comma_list,
    help="dotted names that the declared model is fitted with, separated by commas; default: magnitude and "
    "derivatives, none where there is no reference heating",
)
@click.option("--scheduler", metavar="ADDRESS", help="a Dask scheduler, as tcp://host:8786; default: local processes")
@click.option("--workers", type=click.IntRange(1), help="number of local processes; default: one a core")
@ROOT
def close_loop(
    records: tuple[Path, ...],
    out: Path,
    parameters: tuple[str, ...] | None,
    scheduler: str | None,
    workers: int | None,
    root: Path | None,
) -> None:
    """Identify the effect that the declared model of flight RECORDS lacks; report errors before and after.

    RECORDS are directories of flight records, or directories that hold such; each record is treated by itself.
    """
    from sim_heating.base.files import require_writable
    from sim_heating.closure.close import FILES, write_closed_loop
    from sim_heating.closure.close import close_loop as close_one
    from sim_heating.closure.several.batch import close_all, find_records, summary_row
    from sim_heating.inputs.record import load_record

    found = find_records(records, root)
    if len(found) == 1:
        record = load_record(found[0], root=root)
        require_writable(out, "close-loop", expected=FILES, inputs=[record.directory])
        with progress_line(record.name) as progress:
            closed = close_one(record, parameters, progress=progress)
            names = write_closed_loop(closed, out)
        _print_rows([summary_row(closed.report)])
        _print_details(closed.report)
        print_outputs(out, names)
        return
    with progress_line("close-loop") as progress:
        rows = close_all(
            found, out, names=parameters, root=root, scheduler=scheduler, workers=workers, progress=progress
        )
    _print_rows(rows)
    for row in rows:
        for line in row.get("fault_messages", ()):
            CONSOLE.print(line)
    CONSOLE.print(f"Wrote {out}: summary.json, summary.csv, and a folder for each record")
    failed = [row for row in rows if "failed" in row]
    for row in failed:
        ERRORS.print(f"{row['record']}: {row['failed']}")
    if failed:
        raise RunError(f"{len(failed)} of {len(rows)} records failed; the others are done and kept")


def _print_rows(rows: list[dict[str, Any]]) -> None:
    """Print the table of all records; what was found in red where the run failed or the data are faulty."""
    from sim_heating.closure.report import closures_table

    table = closures_table(rows)
    found = [column.head for column in table.layout].index("found")
    print_table(table, lambda i, k: "red" if k == found and ("failed" in rows[i] or rows[i]["data_faults"]) else "")


def _print_details(report: Closure) -> None:
    """Print faults of the data, parameters of the effects, proposals and warnings of one record."""
    for fault in report.faults:
        CONSOLE.print(fault.message)
    CONSOLE.print(f"{report.statement.in_words()}. {report.statement.certainty()}")
    for cause in report.statement.not_effects:
        CONSOLE.print(f"Not an aerothermal effect ({cause.kind}): {cause.what}")
    for effect in report.effects:
        if effect.parameters:
            CONSOLE.print(f"{effect.name}: {', '.join(_bound(n, p) for n, p in effect.parameters.items())}")
    if report.effects[0].name == "unknown":
        for line in report.evidence.proposal():
            CONSOLE.print(line)
    for line in report.warnings:
        CONSOLE.print(line)
    CONSOLE.print(f"Calibration: {report.false_alarm}")


def _bound(name: str, parameter: ParameterEstimate) -> str:
    unit = "" if parameter.unit == "1" else f" {parameter.unit}"
    return f"{name} {parameter.value:.4g} +- {parameter.sigma:.2g}{unit}"
