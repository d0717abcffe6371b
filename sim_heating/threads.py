"""How many threads linear algebra takes: one, where its matrices are small.

A BLAS that splits products of a few hundred rows over all cores waits for the slowest of them: beside other work, and
several records side by side are other work, that costs ten times what it saves.
"""

from __future__ import annotations

from contextlib import AbstractContextManager
from functools import cache

from threadpoolctl import ThreadpoolController


@cache
def _libraries() -> ThreadpoolController:
    return ThreadpoolController()


def one_thread() -> AbstractContextManager[object]:
    """Within the block, BLAS takes one thread."""
    return _libraries().limit(limits=1, user_api="blas")
