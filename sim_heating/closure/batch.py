"""close-loop over many records: each by itself, in parallel processes, with a summary of all."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from sim_heating.base import files
from sim_heating.base.errors import InputError
from sim_heating.base.files.package import package_version
from sim_heating.base.files.paths import real_path
from sim_heating.base.parallel.batches import Job, run_batches
from sim_heating.base.progress import Progress, no_progress
from sim_heating.heating.effects import add_user_effects, effects
from sim_heating.inputs.record import DECLARATION, distinct_names, load_record, record_digest

SUMMARIES = JSON, CSV, PAGE = "summary.json", "summary.csv", "report.html"
LEDGER = "finished"
"""Folder of finished records, below the results."""


@dataclass(frozen=True)
class Task:
    """One record, the folder of its results, and what its declared model is fitted with; picklable.

    label : name of the record among those of the command
    """

    record: str
    out: str
    root: str | None = None
    names: tuple[str, ...] | None = None
    label: str = ""


def find_records(paths: Sequence[Path], root: Path | None = None) -> list[Path]:
    """Records among paths: a record's directory itself, or all directly below a directory.

    root   : folder that symbolic links among them may lead to, as `load_record` takes it
    raises : InputError where a directory holds none
    """
    records: list[Path] = []
    for path in paths:
        if path.is_dir() and not (path / DECLARATION).is_file():
            below = sorted(p.parent for p in path.glob(f"*/{DECLARATION}"))
            if not below:
                raise InputError(f"{path}: holds neither {DECLARATION} nor directories that do; give flight records")
            roots = files.roots_of(path / DECLARATION, root)
            for record in below:
                roots.check_link(record)
            records += below
        else:
            records.append(path)
    return records


def record_names(records: Sequence[Path], root: Path | None = None) -> list[str]:
    """Names of records by their directories; FLIGHT/NAME of those that have one name.

    root   : folder that symbolic links among them may lead to, as `load_record` takes it
    raises : InputError where two records of one name are of one flight
    """

    def flight(i: int) -> str:
        try:
            return load_record(records[i], root=root).flight
        except InputError:  # the record's own job reports it
            return real_path(records[i]).parent.name

    return distinct_names([real_path(p).name for p in records], flight)


def close_all(
    records: Sequence[Path],
    out: Path,
    *,
    names: Sequence[str] | None = None,
    root: Path | None = None,
    scheduler: str | None = None,
    workers: int | None = None,
    progress: Progress = no_progress,
) -> list[dict[str, Any]]:
    """Close the loop on every record into DIR/<record>, and write summary.json, summary.csv and report.html into DIR.

    A finished record is not done again while its inputs and the program are unchanged. One that fails has the reason in
    its row; the others go on.

    names     : dotted names that each declared model is fitted with, as `close_loop` takes them
    root      : folder that symbolic links in the records may lead to, as `load_record` takes it
    scheduler : address of a Dask scheduler; None for local processes
    workers   : number of local processes; None for one a core
    returns   : one row of the summary for each record, in their order
    raises    : InputError where the scheduler or a folder of results cannot be used
    """
    from sim_heating.closure.close import COMMAND, FILES
    from sim_heating.closure.report.batch import write_batch_page  # matplotlib is slow to import

    labels = record_names(records, root)
    jobs = [record_job(path, out / label, root, names, label) for path, label in zip(records, labels, strict=True)]
    with files.exclusive(out):
        # Before the work: a place that cannot hold results must not be found out after it.
        for folder, names in ((out, SUMMARIES), *((job.task.out, FILES) for job in jobs)):
            files.require_writable(folder, COMMAND, expected=names, inputs=records)
        try:
            outcome = run_batches(
                jobs,
                _close_record,
                out / LEDGER,
                scheduler=scheduler,
                workers=workers,
                is_current=results_are_there,
                progress=progress,
            )
        except KeyboardInterrupt:  # processes that were ended leave what they had begun to write
            files.settle_below(out)
            raise
        rows, residuals = [], []
        for label, job in zip(labels, jobs, strict=True):
            if job.id in outcome.done:
                finished = json.loads(outcome.done[job.id].read_text(encoding="utf-8"))
                rows.append(finished["row"])
                residuals.append(finished["residuals"])
            else:
                rows.append({"record": label, "failed": outcome.failed[job.id]})
                residuals.append(None)
        with files.output_directory(out, COMMAND, inputs=records) as folder:
            files.write_json(folder / JSON, {"format": "closure-summary/1", "records": rows})
            _write_summary_csv(folder / CSV, rows)
            write_batch_page(folder / PAGE, rows, residuals)
    return rows


def record_job(
    record: Path, out: Path, root: Path | None = None, names: Sequence[str] | None = None, label: str = ""
) -> Job:
    """A record's job, by default under its directory's name; its id depends on all that its result depends on."""
    label = label or real_path(record).name
    try:
        inputs = record_digest(load_record(record, root=root))
    except InputError:  # the job itself reports it
        inputs = "unreadable"
    digest = program_digest([inputs, label], names or ())
    return Job(
        f"{label.replace('/', '_')}-{digest[:12]}.json",
        Task(
            str(record), str(out), None if root is None else str(root), None if names is None else tuple(names), label
        ),
    )


def program_digest(inputs: Sequence[str], settings: Sequence[str] = ()) -> str:
    """Digest of everything that a result depends on: its inputs and settings, the program, user-defined effects.

    A finished part is done again after an update of the program or of an effect, and not otherwise.
    """
    digest = hashlib.sha256("|".join([*inputs, package_version(), *sorted(effects()), *settings]).encode())
    add_user_effects(digest)
    return digest.hexdigest()


def _close_record(task: Task) -> bytes:
    """Close the loop on one record and write its folder; summary row, residuals and digest of the folder as JSON."""
    from sim_heating.closure.close import close_loop, write_closed_loop
    from sim_heating.closure.report.batch import residual_history

    record = load_record(task.record, root=task.root)
    closed = close_loop(replace(record, label=task.label), task.names)
    write_closed_loop(closed, Path(task.out))
    finished = {
        "row": summary_row(closed.report),
        "residuals": residual_history(closed.report),
        "results": files.results_digest(task.out),
    }
    return json.dumps(finished).encode()


def results_are_there(job: Job, finished: bytes) -> bool:
    """Whether the folder of a finished job, `task.out`, still holds what was written into it."""
    return bool(json.loads(finished)["results"] == files.results_digest(job.task.out))


def summary_row(report: Any) -> dict[str, Any]:
    """A closure as a row of the summary."""
    row: dict[str, Any] = {
        "record": report.record.name,
        "control_point": report.record.declared.control_point,
        "effects": [e.name for e in report.effects],
        "finding": report.statement.finding,
        "named": report.statement.named,
        "not_effects": [f"{c.kind}: {c.what}" for c in report.statement.not_effects],
        "probability": report.statement.probability,
        "p_value": None if report.statement.adequacy is None else report.statement.adequacy.p_value,
        "noise_floor_K": report.noise_floor_K,
        "data_faults": [f.kind for f in report.faults],
        "fault_messages": [f.message for f in report.faults],
    }
    for name, prediction in (("predicted", report.predicted), ("before", report.before), ("after", report.after)):
        none = dict.fromkeys(("fit", "holdout"))
        for segment, errors in (none if prediction is None else prediction.segment_errors()).items():
            row[f"{name}_{segment}_rmse_K"] = None if errors is None else errors["rmse_K"]
    return row


ERROR_COLUMNS = tuple(
    f"{when}_{what}_rmse_K" for when in ("predicted", "before", "after") for what in ("fit", "holdout")
)


def _write_summary_csv(path: Path, rows: Sequence[dict[str, Any]]) -> None:
    """The numbers of the summary, one row a record."""
    columns: dict[str, Any] = {"record": [row["record"] for row in rows]}
    columns["effects"] = ["+".join(row["effects"]) if "effects" in row else "failed" for row in rows]
    columns["finding"] = [row.get("finding", "failed") for row in rows]
    columns["named"] = [row.get("named", "") for row in rows]
    for name in ("probability", "p_value", "noise_floor_K", *ERROR_COLUMNS):
        columns[name] = np.array([np.nan if row.get(name) is None else row[name] for row in rows])
    files.write_csv(path, columns)
