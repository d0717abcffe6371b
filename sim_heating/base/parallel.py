"""The engine for everything that is many independent jobs: Dask processes, and a ledger of what is finished.

A job has an id, which is the name of its result's file in the ledger folder, and a task that is handed to a function;
the function gives the result as bytes, written whole or not at all. Jobs whose file is there are not done again, so
that a run that was killed goes on where it was: it loses the jobs that were in flight and nothing else. A worker that
dies has its jobs done by another. A job that raises leaves `ID.error` with the reason, and the others go on; the next
run tries it again. Results depend on the tasks alone, not on how many processes there are: one process without Dask,
many, or somebody's cluster leave the same bytes. Linear algebra takes one thread in all of them.
"""

from __future__ import annotations

import asyncio
import hashlib
import logging
import pickle
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from itertools import islice
from pathlib import Path
from typing import Any

from sim_heating.base.errors import InputError, RunError
from sim_heating.base.files.text import repeated_name, write_bytes_atomic, write_text_atomic
from sim_heating.base.progress import Progress, no_progress
from sim_heating.base.threads import one_thread

Work = Callable[[Any], bytes]

ANSWER_S, WORKER_S = 4.0, 10.0
"""How long a scheduler, and then its first worker, is waited for [s]."""
IN_FLIGHT = 3
"""Jobs a worker has at a time, the next ones waiting beside the one at work; more would only fill its memory."""
DEATHS = 3
"""Workers that may die over one job before it is given up."""
LETHAL = "every worker that took it up died over it: out of memory, or killed"
ERROR = ".error"
SETTINGS = {
    "distributed.scheduler.allowed-failures": DEATHS,
    "distributed.worker.daemon": True,
    "distributed.worker.profile.enabled": False,
    "distributed.admin.tick.interval": "1s",
    "distributed.admin.system-monitor.interval": "10s",
    "distributed.nanny.pre-spawn-environ.MALLOC_TRIM_THRESHOLD_": None,
}
"""Of Dask. Its profiler and its 50 looks a second at its own event loops take 3 % of a core from each worker, its looks
at the state of the system 1 % from this process.
Its trim threshold of 64 kB has glibc give every array back to the system and fetch it anew, page by page."""


@dataclass(frozen=True)
class Job:
    """One independent piece of work.

    id   : name of its file in the ledger, unique
    task : what the function is given; it has to be picklable where there is more than one process
    """

    id: str
    task: Any


@dataclass(frozen=True)
class Outcome:
    """What became of the jobs, in their order.

    done   : id -> file with its result
    failed : id -> why there is none, in one line
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
    progress: Progress = no_progress,
) -> Outcome:
    """Do all jobs that have no result yet.

    function : task -> bytes; a function of a module, or functools.partial of one, where there is more than one process
    out      : ledger folder; it has to be named by what the results depend on beside the tasks
    scheduler: address of a Dask scheduler; otherwise local processes are started
    workers  : number of local processes, all cores where None; 1 is this process, without Dask
    progress : told the fraction done and a line of text
    raises   : InputError where jobs share an id, Dask is not installed, or nobody answers at the scheduler's address;
               RunError where the scheduler is lost on the way; what is finished stays
    """
    names = [job.id for job in jobs]
    if (name := repeated_name(names)) is not None:
        raise InputError(f"jobs: the id `{name}` is repeated; give each job its own")
    left = [job for job in jobs if not (out / job.id).is_file()]
    told = _Counted(len(jobs), len(jobs) - len(left), progress)
    alone = scheduler is None and (workers == 1 or len(left) <= 1)
    results = _here(left, function) if alone else _spread(left, function, scheduler, workers)
    for job_id, result in results:
        _keep(out, job_id, result)
        told.one_more()
    done = {name: out / name for name in names if (out / name).is_file()}
    failed = {n: (out / f"{n}{ERROR}").read_text(encoding="utf-8").strip() for n in names if n not in done}
    return Outcome(done, failed)


@dataclass
class _Counted:
    """Progress in jobs."""

    jobs: int
    done: int
    progress: Progress

    def __post_init__(self) -> None:
        before = f", {self.done} of them done before" if self.done else ""
        self.progress(self.done / max(self.jobs, 1), f"{self.jobs} batches{before}")

    def one_more(self) -> None:
        self.done += 1
        self.progress(self.done / self.jobs, f"batches: {self.done} of {self.jobs}")


def _keep(out: Path, job_id: str, result: bytes | BaseException) -> None:
    error = out / f"{job_id}{ERROR}"
    if isinstance(result, BaseException):
        write_text_atomic(error, one_line(result) + "\n")
    else:
        write_bytes_atomic(out / job_id, result)
        error.unlink(missing_ok=True)


def one_line(error: BaseException) -> str:
    """An exception as one line; errors of ours speak for themselves."""
    text = " ".join(str(error).split())
    return text if isinstance(error, InputError | RunError) else f"{type(error).__name__}: {text}"


def _here(jobs: Sequence[Job], function: Work) -> Iterator[tuple[str, bytes | BaseException]]:
    for job in jobs:
        yield job.id, _attempt(function, job.task)


def _attempt(function: Work, task: Any) -> bytes | BaseException:
    try:
        with one_thread():
            return function(task)
    except Exception as error:
        return error


# On Dask ------------------------------------------------------------------------------------------------------------


def _spread(
    jobs: Sequence[Job], function: Work, scheduler: str | None, workers: int | None
) -> Iterator[tuple[str, bytes | BaseException]]:
    """Results as they come, a few jobs in flight for each worker.

    A worker that dies takes the reputation of the jobs waiting beside the lethal one with it: those that have seen too
    many deaths are tried again one by one, so that only the lethal one fails.
    """
    require_dask()
    from distributed import CancelledError, KilledWorker, as_completed
    from distributed.comm import CommClosedError

    packed = _packed(function)
    digest = hashlib.sha256(packed).hexdigest()
    left = len(jobs)
    with _client(scheduler, workers) as client:

        def flown(some: Sequence[Job], width: int, attempt: int) -> Iterator[tuple[Job, Any]]:
            waiting, by_key = iter(some), {f"{job.id}-{digest[:16]}-{attempt}": job for job in some}

            def submit(count: int) -> list[Any]:
                return [
                    client.submit(_call, digest, packed, job.task, key=f"{job.id}-{digest[:16]}-{attempt}", pure=False)
                    for job in islice(waiting, count)
                ]

            flying = as_completed(submit(width), with_results=True, raise_errors=False)
            for future, result in flying:
                if future.cancelled():
                    raise CancelledError(future.key)
                yield by_key[future.key], (_raised(result) if future.status == "error" else result)
                flying.update(submit(1))

        suspects = []
        try:
            for job, result in flown(jobs, IN_FLIGHT * max(len(client.nthreads()), 1), 1):
                if isinstance(result, KilledWorker):
                    suspects.append(job)
                    continue
                left -= 1
                yield job.id, result
            for job, result in flown(suspects, 1, 2):
                left -= 1
                yield job.id, RunError(LETHAL) if isinstance(result, KilledWorker) else result
        except (OSError, CommClosedError, CancelledError, asyncio.CancelledError):
            pass
    if left:
        raise RunError(f"the scheduler was lost with {left} batches to go; run the command again and it goes on there")


def require_dask() -> None:
    """raises : InputError where Dask's `distributed` is not installed."""
    try:
        import distributed  # noqa: F401
    except ImportError:
        raise InputError(
            "Dask is not installed: pip install 'sim-heating[plan]', or take --workers 1 for this process alone"
        ) from None


def require_scheduler(address: str) -> None:
    """raises : InputError where no scheduler answers at an address, or one without a worker"""
    require_dask()
    with _client(address, None):
        pass


def _raised(result: Any) -> BaseException:
    """The error of a job: Dask gives it as (type, error, traceback)."""
    return result[1] if isinstance(result, tuple) else result


def _packed(function: Work) -> bytes:
    import cloudpickle

    packed: bytes = cloudpickle.dumps(function)
    return packed


@lru_cache(maxsize=2)
def _unpacked(_digest: str, packed: bytes) -> Work:
    function: Work = pickle.loads(packed)
    return function


def _call(digest: str, packed: bytes, task: Any) -> bytes:
    """In a worker: the function, unpacked once a process, on a task."""
    function = _unpacked(digest, packed)
    with one_thread():
        return function(task)


@contextmanager
def _client(scheduler: str | None, workers: int | None) -> Iterator[Any]:
    """A client of the scheduler at an address, or of local processes that end with it."""
    import dask
    from distributed import Client

    logging.getLogger("distributed").setLevel(logging.CRITICAL)
    with dask.config.set(SETTINGS):
        if scheduler is None:
            with _local_processes(workers) as cluster, Client(cluster) as client:
                yield client
            return
        try:
            client = Client(scheduler, timeout=ANSWER_S)
        except (OSError, ValueError):
            raise InputError(
                f"--scheduler {scheduler}: no Dask scheduler answers there; start one, or leave the option out"
            ) from None
        with client:
            try:
                client.wait_for_workers(1, timeout=WORKER_S)
            except TimeoutError:
                raise InputError(f"--scheduler {scheduler}: has no worker; start some with `dask worker`") from None
            yield client


def _local_processes(workers: int | None) -> Any:
    """A cluster of processes on this machine; RunError where they do not come up."""
    from distributed import LocalCluster

    try:
        return LocalCluster(
            n_workers=workers, threads_per_worker=1, processes=True, dashboard_address=":0",
            silence_logs=logging.CRITICAL, memory_limit=0,
        )  # fmt: skip
    except (RuntimeError, OSError) as error:
        cause = error.__cause__ or error
        raise RunError(
            f"the worker processes did not start ({one_line(cause)}); take --workers 1 for this process alone"
        ) from None
