"""Work shared out to copies of this process, one for each core: fits of candidates.

Python uses one core; a copy of the process has everything in memory that its share of the work needs. A copy writes no
file: it sends what it has made through a pipe, so that nothing remains of it where the command is ended.
"""

from __future__ import annotations

import ctypes
import os
import pickle
import signal
import sys
import threading
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from functools import partial
from typing import Any, TypeVar

from sim_heating.base.errors import InputError, RunError
from sim_heating.base.parallel.threads import march_threads, thread_count

R = TypeVar("R")
TURNS, LEAST_TOGETHER = 2, 2
"""How often a process takes numbers to work at together, and how many it takes at least."""
PROGRESS = "rich."
"""Modules whose threads may run while a process is copied: they show progress, and nothing waits for them."""


def in_processes(tasks: Sequence[Callable[[], R]]) -> list[R]:
    """Results of tasks, in their order, with the tasks shared out to this process and to copies of it.

    tasks : picklable results; they change nothing that this process needs. They are dealt out in turn, so that tasks
            next to each other should take alike long. An InputError or RunError in a copy is raised here; what fails
            otherwise or warns is done again here, where its error or warning is seen

    Each process marches in one thread. On other systems than Linux, and beside threads that may hold locks, all is done
    here.
    """
    return in_turn(lambda numbers, _: {k: tasks[k]() for k in numbers}, len(tasks))


def in_turn(task: Callable[[Iterator[int], int], Mapping[int, R]], count: int) -> list[R]:
    """Results number 0 to count - 1, in their order; numbers are dealt out in turn to this process and copies of it.

    task  : results, by number, of all numbers that it takes from an iterator; otherwise a task of `in_processes`. Its
            second argument is how many to work at in one batch
    count : number of results

    What is worked at together sets last digits: numbers dealt out by who is done first would be others every time.
    """
    shares = _processes_for(count)
    if shares == 1:
        by_number = dict(task(iter(range(count)), count))
    else:
        batch = max(LEAST_TOGETHER, -(-count // (TURNS * shares)))
        with march_threads(1):
            parts = _in_copies([partial(task, iter(range(k, count, shares)), batch) for k in range(shares)])
        by_number = {k: result for results in parts for k, result in results.items()}
    return [by_number[k] for k in range(count)]


def in_shares(task: Callable[[Sequence[int]], Sequence[R]], count: int) -> list[R]:
    """Results number 0 to count - 1, in their order, with the numbers shared out to this process and to copies of it.

    task  : results of some of the numbers, in the order of these; otherwise a task of `in_processes`
    count : number of results
    """

    def of_share(numbers: Iterator[int], _: int) -> dict[int, R]:
        share = list(numbers)
        return dict(zip(share, task(share), strict=True))

    return in_turn(of_share, count)


def _processes_for(count: int) -> int:
    """How many processes do a number of tasks, this one among them."""
    return max(1, min(count, thread_count())) if _can_be_copied() else 1


def _in_copies(tasks: Sequence[Callable[[], R]]) -> list[R]:
    """Results of shares: of the first here, of each other one in a copy, or here where the copy failed."""
    copies: list[_Copy] = []
    try:
        copies += [_Copy(task) for task in tasks[1:]]
        return [tasks[0](), *(copy.result() for copy in copies)]
    finally:
        for copy in copies:
            copy.end()


def _can_be_copied() -> bool:
    others = (t for t in threading.enumerate() if t is not threading.main_thread())
    is_main = threading.current_thread() is threading.main_thread()
    return sys.platform == "linux" and is_main and all(type(t).__module__.startswith(PROGRESS) for t in others)


class _Copy:
    """A copy of this process that does a share of the work."""

    def __init__(self, task: Callable[[], Any]) -> None:
        self._task = task
        reading, writing = os.pipe()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)  # of the threads of a BLAS, which a copy does not use
            self._process = os.fork()
        if self._process == 0:
            os.close(reading)
            _send_result(task, writing)
        os.close(writing)
        self._pipe = os.fdopen(reading, "rb")

    def result(self) -> Any:
        """What the copy has sent, or its error; else its share is done here."""
        outcome: Any = None
        with suppress(EOFError, pickle.UnpicklingError):  # of a copy that was killed
            outcome = pickle.load(self._pipe)
        _, status = os.waitpid(self._process, 0)
        self._process = 0
        if status != 0 or outcome is None:
            return self._task()
        result, error = outcome
        if error is not None:
            raise error
        return result

    def end(self) -> None:
        """End the copy where it still runs."""
        self._pipe.close()
        if self._process:
            with suppress(ProcessLookupError):
                os.kill(self._process, signal.SIGKILL)
            os.waitpid(self._process, 0)
            self._process = 0


def _send_result(task: Callable[[], Any], writing: int) -> None:
    """Do a share and send its result and its error; the process ends here, without what Python does at its end."""
    status = 1
    shown: list[object] = []
    try:
        _end_with_parent()
        warnings.showwarning = lambda *warning, **_details: shown.append(warning)
        with os.fdopen(writing, "wb") as pipe:
            outcome: tuple[Any, Exception | None]
            try:
                outcome = task(), None
            except (InputError, RunError) as error:
                outcome = None, error
            pickle.dump(outcome, pipe)
        status = int(bool(shown))
    finally:
        os._exit(status)


def _end_with_parent() -> None:
    """Have the kernel end this copy where the process that wants its results is killed."""
    PR_SET_PDEATHSIG = 1  # <sys/prctl.h>
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
