"""One thread for linear algebra, where matrices are small and where results must be reproducible byte by byte.

A BLAS that splits products of a few hundred rows over all cores waits for the slowest of them; with other work on the
machine (several records at once are such work) the wait costs ten times what the split saves. The split also changes
last digits: with the number of cores, with OMP_NUM_THREADS, and in a Dask worker, which has one thread.
"""

from __future__ import annotations

from contextlib import AbstractContextManager
from functools import cache

import scipy.linalg  # noqa: F401  its BLAS is not numpy's; both must be loaded before the search below
from threadpoolctl import ThreadpoolController


@cache
def _libraries() -> ThreadpoolController:
    return ThreadpoolController()


def one_thread() -> AbstractContextManager[object]:
    """Context in which BLAS uses one thread."""
    return _libraries().limit(limits=1, user_api="blas")
