"""How many threads linear algebra takes: one, where its matrices are small, and where results are to be the same bytes.

A BLAS that splits products of a few hundred rows over all cores waits for the slowest of them: beside other work, and
several records side by side are other work, that costs ten times what it saves. How it splits them changes last digits
besides: with the number of cores, with OMP_NUM_THREADS, in a worker of Dask, which has one thread.
"""

from __future__ import annotations

from contextlib import AbstractContextManager
from functools import cache

import scipy.linalg  # noqa: F401  its BLAS is another than that of numpy, and both are looked for below
from threadpoolctl import ThreadpoolController


@cache
def _libraries() -> ThreadpoolController:
    return ThreadpoolController()


def one_thread() -> AbstractContextManager[object]:
    """Within the block, BLAS takes one thread."""
    return _libraries().limit(limits=1, user_api="blas")
