"""Many independent jobs, run in this process or on Dask, with a ledger of finished results.

A job has an id, which is the name of its result's file in the ledger folder, and a task that is passed to a function;
the function returns the result as bytes, written whole or not at all, with their digest in a file `.ID.sha256`. Jobs
whose result agrees with its digest are not run again, so that a killed run resumes where it stopped: it loses only the
jobs in flight. A damaged result is computed again. Jobs of a worker that dies are run by
another. A job that raises leaves `ID.error` with the reason, and the others continue; the next run repeats it. Results
depend on the tasks alone: one process without Dask, many processes, or a cluster write the same bytes. Linear algebra
uses one thread in all of them.
"""

from __future__ import annotations

import asyncio
import hashlib
import logging
import pickle
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import lru_cache
from itertools import islice
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from sim_heating.base.errors import InputError, RunError
from sim_heating.base.files.paths import bytes_digest
from sim_heating.base.files.text import clear_partial_files, repeated_name, write_bytes_atomic, write_text_atomic
from sim_heating.base.files.transaction import exclusive
from sim_heating.base.parallel.threads import march_threads, one_thread
from sim_heating.base.progress import Progress, no_progress, signals_deferred

Work = Callable[[Any], bytes]

SCHEDULER_TIMEOUT_S, WORKER_TIMEOUT_S = 4.0, 10.0
"""Longest wait for a scheduler to answer, and then for its first worker [s]."""
LOOPBACK = "127.0.0.1"
"""Address on which local processes listen: whoever reaches a Dask scheduler can run code in its workers."""
IN_FLIGHT = 3
"""Jobs that a worker holds at a time, running or waiting; more would only fill its memory."""
MAX_WORKER_DEATHS = 3
"""Workers that may die while running one job before it is given up."""
LETHAL_JOB = "every worker that ran it died: out of memory, or killed"
ERROR_SUFFIX = ".error"
DASK_SETTINGS = {
    "distributed.scheduler.allowed-failures": MAX_WORKER_DEATHS,
    "distributed.worker.daemon": True,
    "distributed.worker.profile.enabled": False,
    "distributed.admin.tick.interval": "1s",
    "distributed.admin.system-monitor.interval": "10s",
    "distributed.nanny.pre-spawn-environ.MALLOC_TRIM_THRESHOLD_": None,
    "distributed.scheduler.http.routes": [],
    "distributed.worker.http.routes": [],
}
"""Dask's settings. Its profiler and its 50 checks a second of its own event loops take 3 % of a core from each worker,
its system monitor 1 % from this process. Its trim threshold of 64 kB makes glibc return every array to the system and
fetch it again, page by page. Nothing is served over HTTP: a study needs no dashboard, which would show its data."""


@dataclass(frozen=True)
class Job:
    """One independent piece of work.

    id   : name of its file in the ledger, unique
    task : argument of the function; must be picklable where there is more than one process
    """

    id: str
    task: Any


@dataclass(frozen=True)
class Outcome:
    """Results and failures of the jobs, in their order.

    done   : id -> file with its result
    failed : id -> reason of the failure, in one line
    """

    done: dict[str, Path]
    failed: dict[str, str]


def run_batches(
    jobs: Sequence[Job],
    function: Work,
    out: Path,
    *,
    scheduler: str | None = None,
    workers: int | None = None,
    is_current: Callable[[Job, bytes], bool] = lambda _job, _result: True,
    progress: Progress = no_progress,
) -> Outcome:
    """Run all jobs that have no result yet.

    function : task -> bytes; a function of a module, or functools.partial of one, where there is more than one process
    out      : ledger folder; its name must identify everything besides the tasks that the results depend on
    scheduler: address of a Dask scheduler; otherwise local processes are started
    workers  : number of local processes, all cores where None; 1 is this process, without Dask
    is_current : whether a result of an earlier run still holds, as what it refers to may have been removed since
    progress : called with the fraction done and a line of text
    raises   : InputError where jobs share an id, another process works on the same ledger, Dask is not installed, or no
               scheduler answers at the address;
               RunError where the scheduler is lost during the run; finished results remain
    """
    names = [job.id for job in jobs]
    if (name := repeated_name(names)) is not None:
        raise InputError(f"jobs: the id `{name}` is repeated; give each job its own")
    with exclusive(out):
        clear_partial_files(out)
        remaining = _without_result(jobs, out, is_current)
        done = len(jobs) - len(remaining)
        before = f", {done} of them finished before" if done else ""
        progress(done / max(len(jobs), 1), f"{len(jobs)} batches{before}")
        failed = {}
        for job_id, outcome in _running(remaining, function, scheduler, workers):
            _store_result(out, job_id, outcome)
            if isinstance(outcome, BaseException):
                failed[job_id] = error_line(outcome)
            done += 1
            progress(done / len(jobs), f"batches: {done} of {len(jobs)}")
    files = {name: out / name for name in names if name not in failed}
    return Outcome(files, {job.id: failed[job.id] for job in remaining if job.id in failed})


def _without_result(jobs: Sequence[Job], out: Path, is_current: Callable[[Job, bytes], bool]) -> list[Job]:
    """Jobs of which the ledger has no result that still holds."""
    return [j for j in jobs if (result := _stored_result(out, j.id)) is None or not is_current(j, result)]


def _running(
    jobs: Sequence[Job], function: Work, scheduler: str | None, workers: int | None
) -> Iterator[tuple[str, bytes | BaseException]]:
    """The id and the outcome of each job when it is done, as `run_batches` runs them."""
    if scheduler is None and (workers == 1 or len(jobs) <= 1):
        return _run_locally(jobs, function)
    return _run_on_dask(jobs, function, scheduler, workers)


def _store_result(out: Path, job_id: str, result: bytes | BaseException) -> None:
    error = out / f"{job_id}{ERROR_SUFFIX}"
    if isinstance(result, BaseException):
        write_text_atomic(error, error_line(result) + "\n")
    else:
        write_bytes_atomic(out / job_id, result)
        # Written after the result: one that a kill leaves without its digest is computed again.
        write_text_atomic(digest_path(out, job_id), f"{bytes_digest(result)}\n")
        error.unlink(missing_ok=True)


def _stored_result(out: Path, job_id: str) -> bytes | None:
    """A job's result of an earlier run; None where there is none, or it is not what was written."""
    try:
        result = (out / job_id).read_bytes()
        is_intact = digest_path(out, job_id).read_bytes() == f"{bytes_digest(result)}\n".encode()
    except OSError:
        return None
    return result if is_intact else None


def digest_path(out: Path, job_id: str) -> Path:
    """File of a result's digest: a result without it is not finished."""
    return out / f".{job_id}.sha256"


def error_line(error: BaseException) -> str:
    """An exception as one line, with its type unless it is an error of this package."""
    text = " ".join(str(error).split())
    return text if isinstance(error, InputError | RunError) else f"{type(error).__name__}: {text}"


def _run_locally(jobs: Sequence[Job], function: Work) -> Iterator[tuple[str, bytes | BaseException]]:
    for job in jobs:
        result: bytes | BaseException
        try:
            with one_thread():
                result = function(job.task)
        except Exception as error:
            result = error
        yield job.id, result


# On Dask ------------------------------------------------------------------------------------------------------------


def _run_on_dask(
    jobs: Sequence[Job], function: Work, scheduler: str | None, workers: int | None
) -> Iterator[tuple[str, bytes | BaseException]]:
    """Results as they arrive, a few jobs in flight for each worker.

    Dask blames the death of a worker on all jobs that it held. Jobs blamed too often are therefore repeated one by one,
    so that only the lethal one fails.
    """
    require_dask()
    from distributed import CancelledError, KilledWorker, as_completed
    from distributed.comm import CommClosedError

    pickled = _pickled(function)
    digest = hashlib.sha256(pickled).hexdigest()
    remaining = len(jobs)
    with _client(scheduler, workers) as client:

        def results_of(chosen: Sequence[Job], width: int, attempt: int) -> Iterator[tuple[Job, Any]]:
            waiting, by_key = iter(chosen), {f"{job.id}-{digest[:16]}-{attempt}": job for job in chosen}

            def submit(count: int) -> list[Any]:
                return [
                    client.submit(
                        _run_in_worker, digest, pickled, job.task, key=f"{job.id}-{digest[:16]}-{attempt}", pure=False
                    )
                    for job in islice(waiting, count)
                ]

            running = as_completed(submit(width), with_results=True, raise_errors=False)
            for future, result in running:
                if future.cancelled():
                    raise CancelledError(future.key)
                # of a failed job Dask returns type, error and traceback
                is_error = future.status == "error" and isinstance(result, tuple)
                yield by_key[future.key], result[1] if is_error else result
                running.update(submit(1))

        suspects = []
        try:
            for job, result in results_of(jobs, IN_FLIGHT * max(len(client.nthreads()), 1), 1):
                if isinstance(result, KilledWorker):
                    suspects.append(job)
                    continue
                remaining -= 1
                yield job.id, result
            for job, result in results_of(suspects, 1, 2):
                remaining -= 1
                yield job.id, RunError(LETHAL_JOB) if isinstance(result, KilledWorker) else result
        except (OSError, CommClosedError, CancelledError, asyncio.CancelledError):
            pass
    if remaining:
        raise RunError(f"the scheduler was lost with {remaining} batches to go; run the command again to resume")


def require_dask() -> None:
    """raises : InputError where Dask's `distributed` is not installed."""
    try:
        import distributed  # noqa: F401
    except ImportError:
        raise InputError(
            "Dask is not installed: pip install 'sim-heating[plan]', or use --workers 1 to run in this process"
        ) from None


def require_scheduler(address: str) -> None:
    """raises : InputError where no scheduler answers at an address, or one without a worker"""
    require_dask()
    with _client(address, None):
        pass


def _pickled(function: Work) -> bytes:
    import cloudpickle

    pickled: bytes = cloudpickle.dumps(function)
    return pickled


@lru_cache(maxsize=2)
def _unpickled(_digest: str, pickled: bytes) -> Work:
    function: Work = pickle.loads(pickled)
    return function


def _run_in_worker(digest: str, pickled: bytes, task: Any) -> bytes:
    """Run one task in a worker; the function is unpickled once a process."""
    function = _unpickled(digest, pickled)
    with one_thread(), march_threads(1):
        return function(task)


@contextmanager
def _client(scheduler: str | None, workers: int | None) -> Iterator[Any]:
    """A client of the scheduler at an address, or of local processes that end with it."""
    import dask
    from distributed import Client

    logging.getLogger("distributed").setLevel(logging.CRITICAL)
    with dask.config.set(DASK_SETTINGS):
        if scheduler is None:
            with ExitStack() as ending:
                with signals_deferred():  # processes half started would not be ended
                    # Workers that a signal ends leave their files behind.
                    files = ending.enter_context(_folder_of_workers())
                    ending.enter_context(dask.config.set({"temporary-directory": files}))  # the scheduler makes one
                    cluster = _local_processes(workers, files)
                    client = ending.enter_context(Client(ending.enter_context(cluster), set_as_default=False))
                    ending.enter_context(client.as_current())
                yield client
            return
        try:
            client = Client(scheduler, timeout=SCHEDULER_TIMEOUT_S, set_as_default=False)  # a refused one would stay it
        except (OSError, ValueError):
            raise InputError(
                f"--scheduler {scheduler}: no Dask scheduler answers there; start one, or omit the option"
            ) from None
        with client, client.as_current():
            try:
                client.wait_for_workers(1, timeout=WORKER_TIMEOUT_S)
            except TimeoutError:
                raise InputError(
                    f"--scheduler {scheduler}: the scheduler has no worker; start some with `dask worker`"
                ) from None
            yield client


def _folder_of_workers() -> TemporaryDirectory[str]:
    """A folder of the files of workers; RunError where none can be made."""
    try:
        return TemporaryDirectory(prefix="sim_heating_workers_", ignore_cleanup_errors=True)
    except OSError as error:
        raise _not_started(error) from None


def _not_started(cause: BaseException) -> RunError:
    return RunError(f"the worker processes did not start ({error_line(cause)}); use --workers 1 to run in this process")


def _local_processes(workers: int | None, files: str) -> Any:
    """A cluster of processes on this machine, without a dashboard and reachable from this machine alone.

    files  : folder of the files of its workers
    raises : RunError where the processes do not start
    """
    from distributed import LocalCluster

    # An address without a host would listen on all interfaces, and none at all would take the fixed port 8787.
    try:
        return LocalCluster(
            n_workers=workers,
            threads_per_worker=1,
            processes=True,
            host=LOOPBACK,
            dashboard_address=f"{LOOPBACK}:0",
            scheduler_kwargs={"dashboard": False},
            silence_logs=logging.CRITICAL,
            memory_limit=0,
            local_directory=files,
        )
    except (RuntimeError, OSError) as error:
        raise _not_started(error.__cause__ or error) from None
