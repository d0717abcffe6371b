"""Threads: one for linear algebra, where matrices are small and results must be the same byte by byte; several for
marches side by side.

A BLAS that splits products of a few hundred rows over all cores waits for the slowest of them; with other work on the
machine (several records at once are such work) the wait costs ten times what the split saves. The split also changes
last digits: with the number of cores, with OMP_NUM_THREADS, and in a Dask worker, which has one thread.

Marches release Python's lock, and their results do not depend on how they are shared out: they run in one thread for
each core, except in a process that is one of several on its machine.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import cache
from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    from threadpoolctl import ThreadpoolController


R = TypeVar("R")


def core_count() -> int:
    """Number of cores that this process may use, which may be fewer than the machine has."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


_threads = core_count()


@cache
def _libraries() -> ThreadpoolController:
    import scipy.linalg  # noqa: F401  its BLAS is not numpy's; both must be loaded before the controller looks for them
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()


@contextmanager
def one_thread() -> Iterator[None]:
    """Context in which BLAS uses one thread; called, it is a decorator of a function that runs in it."""
    with _libraries().limit(limits=1, user_api="blas"):
        yield


def thread_count() -> int:
    """Number of threads that `in_threads` uses."""
    return _threads


@contextmanager
def march_threads(count: int) -> Iterator[None]:
    """Context in which `in_threads` uses so many threads: one in a process that shares its cores with others like it.

    count : 1 or more
    """
    global _threads
    before, _threads = _threads, count
    try:
        yield
    finally:
        _threads = before


def in_threads(task: Callable[[int], R], count: int) -> list[R]:
    """one(0), ..., one(count - 1), in threads where there are several."""
    if min(count, _threads) <= 1:
        return [task(k) for k in range(count)]
    with ThreadPoolExecutor(min(count, _threads)) as pool:
        return list(pool.map(task, range(count)))
