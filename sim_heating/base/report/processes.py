"""Pictures drawn by copies of this process, one for each core.

Drawing is Python, which uses one core; a copy of the process has everything in memory that a picture needs. A copy
writes no file: it sends what it has made through a pipe, so that nothing remains of it where the command is ended.
"""

from __future__ import annotations

import os
import pickle
import signal
import sys
import threading
import warnings
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import TypeVar

from sim_heating.base.threads import thread_count

R = TypeVar("R")
PROGRESS = "rich."
"""Modules whose threads may run while a process is copied: they show progress, and nothing waits for them."""


def in_processes(tasks: Sequence[Callable[[], R]]) -> list[R]:
    """Results of tasks, in their order, with the tasks shared out to this process and to copies of it.

    tasks : picklable results; they change nothing that this process needs. One that fails or warns in a copy is done
            again here, where its error or warning is seen

    On other systems than Linux, and beside threads that may hold locks, all is done here.
    """
    shares = max(1, min(len(tasks), thread_count())) if _can_be_copied() else 1
    copies = [_Copy(tasks[k::shares]) for k in range(1, shares)]
    try:
        own = [task() for task in tasks[::shares]]
        found = {0: own} | {k: copy.results() for k, copy in enumerate(copies, start=1)}
    finally:
        for copy in copies:
            copy.end()
    return [found[i % shares][i // shares] for i in range(len(tasks))]


def _can_be_copied() -> bool:
    others = (t for t in threading.enumerate() if t is not threading.main_thread())
    is_main = threading.current_thread() is threading.main_thread()
    return sys.platform == "linux" and is_main and all(type(t).__module__.startswith(PROGRESS) for t in others)


class _Copy:
    """A copy of this process that does some tasks."""

    def __init__(self, tasks: Sequence[Callable[[], object]]) -> None:
        self._tasks = tasks
        reading, writing = os.pipe()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)  # of the threads of a BLAS, which a copy does not use
            self._process = os.fork()
        if self._process == 0:
            os.close(reading)
            _send_results(tasks, writing)
        os.close(writing)
        self._pipe = os.fdopen(reading, "rb")

    def results(self) -> list:  # type: ignore[type-arg]
        """What the copy has sent; else the tasks are done here."""
        sent = self._pipe.read()
        _, status = os.waitpid(self._process, 0)
        self._process = 0
        return pickle.loads(sent) if status == 0 else [task() for task in self._tasks]

    def end(self) -> None:
        """End the copy where it still runs."""
        self._pipe.close()
        if self._process:
            with suppress(ProcessLookupError):
                os.kill(self._process, signal.SIGKILL)
            os.waitpid(self._process, 0)
            self._process = 0


def _send_results(tasks: Sequence[Callable[[], object]], writing: int) -> None:
    """Do tasks and send their results; the process ends here, without anything that Python does at its end."""
    status = 1
    try:
        warnings.simplefilter("error")
        sent = pickle.dumps([task() for task in tasks])
        with os.fdopen(writing, "wb") as pipe:
            pipe.write(sent)
        status = 0
    finally:
        os._exit(status)
