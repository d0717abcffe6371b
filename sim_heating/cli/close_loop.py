"""The command `sim-heating close-loop`."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import starmap
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

import sim_heating as sh
from sim_heating.base.errors import InputError, RunError
from sim_heating.cli import console
from sim_heating.cli.output import report_files, report_results

if TYPE_CHECKING:
    from sim_heating.closure.result import Closure, ParameterEstimate


@click.command("close-loop")
@click.argument("records", type=console.PATH, nargs=-1, required=True)
@console.OUT
@click.option(
    "--parameters",
    callback=console.comma_list,
    help="dotted names that the declared model is fitted with, separated by commas; default: magnitude and "
    "derivatives, none where there is no reference heating",
)
@click.option("--scheduler", metavar="ADDRESS", help="a Dask scheduler, as tcp://host:8786; default: local processes")
@click.option("--workers", type=click.IntRange(1), help="number of local processes; default: one a core")
@click.option("--joint", is_flag=True, help="also seek one cause in all records together, and what each adds to it")
@console.ROOT
def close_loop(
    records: tuple[Path, ...],
    out: Path,
    parameters: tuple[str, ...] | None,
    scheduler: str | None,
    workers: int | None,
    joint: bool,
    root: Path | None,
) -> None:
    """Identify the effect that the declared model of flight RECORDS lacks; report errors before and after.

    RECORDS are directories of flight records, or directories that hold such; each record is treated by itself, unless
    --joint is given: records of one control point, or of neighbouring points, then state what they have in common.
    """
    from sim_heating.base.files import all_files_written, require_writable
    from sim_heating.closure.batch import close_all, find_records, summary_row
    from sim_heating.closure.close import FILES

    directories = find_records(records, root)
    if joint:
        _require_one_process(scheduler, workers)
        _close_jointly(directories, out, parameters, root)
        return
    if len(directories) == 1:
        record = sh.load_record(directories[0], root=root)
        require_writable(out, "close-loop", expected=FILES, inputs=[record.directory])
        with console.progress_line(record.name) as progress:
            closed = sh.close_loop(record, parameters, progress=progress)
            names = sh.write_closed_loop(closed, out)
        _print_rows([summary_row(closed.report)])
        _print_details(closed.report)
        console.print_outputs(out, names, "closure.json")
        return
    with console.progress_line("close-loop") as progress:
        rows = close_all(
            directories, out, names=parameters, root=root, scheduler=scheduler, workers=workers, progress=progress
        )
    _print_rows(rows)
    for row in rows:
        for line in row.get("fault_messages", ()):
            console.print_warning(line)
    console.CONSOLE.print(f"Wrote {out}: summary.json, summary.csv, report.html, and a folder for each record")
    report_files(out, all_files_written(out))
    report_results(out / "summary.json")
    failed = [row for row in rows if "failed" in row]
    for row in failed:
        console.ERRORS.print(f"{row['record']}: {row['failed']}")
    if failed:
        raise RunError(f"{len(failed)} of {len(rows)} records failed; the others are done and kept")


def _require_one_process(scheduler: str | None, workers: int | None) -> None:
    if scheduler is not None or workers is not None:
        raise InputError("--joint: the records are searched in one process; leave out --scheduler and --workers")


def _close_jointly(directories: list[Path], out: Path, parameters: tuple[str, ...] | None, root: Path | None) -> None:
    """Close the loop on each record and on all together, write the files, and print what each adds."""
    from sim_heating.base.files import require_writable
    from sim_heating.closure.batch import summary_row
    from sim_heating.closure.close import FILES
    from sim_heating.closure.report.records import evidence_table
    from sim_heating.closure.result import JOINT_FILES
    from sim_heating.inputs.record import load_records

    loaded = load_records(directories, root=root)
    inputs = [record.directory for record in loaded]
    require_writable(out, "close-loop", expected=JOINT_FILES, inputs=inputs)
    for record in loaded:
        require_writable(out / record.name, "close-loop", expected=FILES, inputs=inputs)
    with console.progress_line("close-loop") as progress:
        closed = sh.close_loops(loaded, parameters, progress=progress)
        names = sh.write_joint_loop(closed, out)
    _print_rows([summary_row(loop.report) for loop in closed.loops])
    console.print_table(evidence_table(closed.report))
    report = closed.report
    console.CONSOLE.print(f"{report.in_words()}. {report.certainty()}")
    lines = [f"Not an aerothermal effect ({cause.kind}): {cause.what}" for cause in report.statement.not_effects]
    for effect in report.effects:
        if effect.parameters:
            lines.append(f"{effect.name}: {', '.join(starmap(_bound, effect.parameters.items()))}")
    lines += [f"To tell them apart: {line}" for line in report.statement.would_tell()]
    for line in (*lines, *report.remarks()):
        console.CONSOLE.print(line)
    for line in report.warnings:
        console.print_warning(line)
    console.print_outputs(out, names, "closure.json")


def _print_rows(rows: list[dict[str, Any]]) -> None:
    """Print the table of all records; the finding in red where the run failed or the data are faulty."""
    from sim_heating.closure.report.record import closures_table

    table = closures_table(rows)
    finding = [column.head for column in table.layout].index("finding")
    console.print_table(
        table, lambda i, k: "red" if k == finding and ("failed" in rows[i] or rows[i]["data_faults"]) else ""
    )


def _finding_lines(report: Closure) -> Iterator[str]:
    """Lines on what is found: the statement, other causes, what would tell them apart, parameters, proposals."""
    yield f"{report.statement.in_words()}. {report.statement.certainty()}"
    for cause in report.statement.not_effects:
        yield f"Not an aerothermal effect ({cause.kind}): {cause.what}"
    for line in report.statement.would_tell():
        yield f"To tell them apart: {line}"
    for effect in report.effects:
        if effect.parameters:
            yield f"{effect.name}: {', '.join(_bound(n, p) for n, p in effect.parameters.items())}"
    if report.effects[0].name == "unknown":
        yield from report.evidence.proposal()


def _print_details(report: Closure) -> None:
    """Print faults of the data, parameters of the effects, proposals and warnings of one record."""
    from sim_heating.estimation.report.remarks import further_warnings

    for fault in report.faults:
        console.print_warning(fault.message)
    for line in _finding_lines(report):
        console.CONSOLE.print(line)
    for remark in report.remarks:
        console.print_warning(remark.in_words)
    for line in further_warnings(report.warnings, report.remarks):
        console.print_warning(line)
    if report.false_alarm:
        console.CONSOLE.print(f"Calibration: {report.false_alarm}")


def _bound(name: str, parameter: ParameterEstimate) -> str:
    unit = "" if parameter.unit == "1" else f" {parameter.unit}"
    return f"{name} {parameter.value:.4g} +- {parameter.sigma:.2g}{unit}"
