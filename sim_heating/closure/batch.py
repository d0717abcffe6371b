"""close-loop over many records: each by itself, on as many processes as there are, and a summary of all."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from sim_heating.base.errors import InputError
from sim_heating.base.files import output_directory, require_writable, write_csv, write_json
from sim_heating.base.files.package import package_version
from sim_heating.base.parallel import Job, run_batches
from sim_heating.base.progress import Progress, quiet
from sim_heating.estimation.report.estimate_file import inputs_hash
from sim_heating.heating.effects import effects, user_effect_files
from sim_heating.inputs.record import DECLARATION, load_record, require_distinct_records

SUMMARIES = JSON, CSV = "summary.json", "summary.csv"
LEDGER = "finished"
"""Folder of what is finished, below the results."""


@dataclass(frozen=True)
class Task:
    """One record and the folder of its results; picklable."""

    record: str
    out: str


def find_records(paths: Sequence[Path]) -> list[Path]:
    """Records among paths: a record's directory itself, or all below a directory that holds records.

    raises : InputError where there is none, or two have one name
    """
    found: list[Path] = []
    for path in paths:
        if path.is_dir() and not (path / DECLARATION).is_file():
            below = sorted(p.parent for p in path.glob(f"*/{DECLARATION}"))
            if not below:
                raise InputError(f"{path}: holds neither {DECLARATION} nor directories that do; give flight records")
            found += below
        else:
            found.append(path)
    require_distinct_records([p.resolve().name for p in found])
    return found


def close_all(
    records: Sequence[Path],
    out: Path,
    *,
    scheduler: str | None = None,
    workers: int | None = None,
    progress: Progress = quiet,
) -> list[dict[str, Any]]:
    """Close the loop on every record into DIR/<record>; a row of the summary for each, in their order.

    A record whose inputs and program are as when it was finished is not done again. One that fails leaves its reason in
    its row, and the others go on. Writes summary.json and summary.csv.

    raises : InputError where the scheduler or a folder of results cannot be used
    """
    from sim_heating.closure.close import FILES

    jobs = [record_job(path, out / path.resolve().name) for path in records]
    for folder, names in ((out, SUMMARIES), *((job.task.out, FILES) for job in jobs)):
        require_writable(folder, names)
    ended = run_batches(jobs, _one, out / LEDGER, scheduler=scheduler, workers=workers, progress=progress)
    rows = []
    for path, job in zip(records, jobs, strict=True):
        if job.id in ended.done:
            rows.append(json.loads(ended.done[job.id].read_text(encoding="utf-8")))
        else:
            rows.append({"record": path.resolve().name, "failed": ended.failed[job.id]})
    with output_directory(out) as folder:
        write_json(folder / JSON, {"format": "closure-summary/1", "records": rows})
        _write_table(folder / CSV, rows)
    return rows


def record_job(record: Path, out: Path) -> Job:
    """A record's job, named by all that its result depends on."""
    try:
        inputs = inputs_hash(load_record(record))
    except InputError:  # told by the job itself
        inputs = "unreadable"
    digest = hashlib.sha256("|".join([inputs, package_version(), *sorted(effects())]).encode())
    for path in user_effect_files():
        digest.update(path.read_bytes())
    return Job(f"{record.resolve().name}-{digest.hexdigest()[:12]}.json", Task(str(record), str(out)))


def _one(task: Task) -> bytes:
    """Close the loop on one record and write its folder; its row of the summary."""
    from sim_heating.closure.close import close_loop, write_closed_loop

    closed = close_loop(load_record(task.record))
    write_closed_loop(closed, Path(task.out))
    return json.dumps(summary_row(closed.report)).encode()


def summary_row(report: Any) -> dict[str, Any]:
    """A closure as a row of the summary."""
    row: dict[str, Any] = {
        "record": report.record.name,
        "control_point": report.record.declared.control_point,
        "effects": [e.name for e in report.effects],
        "posterior": report.effects[0].posterior,
        "noise_floor_K": report.noise_floor_K,
        "doubts": [v.kind for v in report.verdicts],
        "verdicts": [v.words for v in report.verdicts],
    }
    for name, prediction in (("predicted", report.predicted), ("before", report.before), ("after", report.after)):
        for what, errors in prediction.segment_errors().items():
            row[f"{name}_{what}_rmse_K"] = None if errors is None else errors["rmse_K"]
    return row


ERROR_COLUMNS = tuple(
    f"{when}_{what}_rmse_K" for when in ("predicted", "before", "after") for what in ("fit", "holdout")
)


def _write_table(path: Path, rows: Sequence[dict[str, Any]]) -> None:
    columns: dict[str, Any] = {"record": [row["record"] for row in rows]}
    columns["effects"] = ["+".join(row["effects"]) if "effects" in row else "failed" for row in rows]
    for name in ("posterior", "noise_floor_K", *ERROR_COLUMNS):
        columns[name] = np.array([np.nan if row.get(name) is None else row[name] for row in rows])
    write_csv(path, columns)
