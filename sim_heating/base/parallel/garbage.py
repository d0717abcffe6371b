"""How often a process of this program searches for cyclic garbage.

A search goes through the many objects of loaded modules. After every 700 new objects, as Python has it, the searches
take up to a tenth of a command; what they would free is little.
"""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager

ALLOCATIONS = 50_000
"""New objects after which garbage is searched for."""


def search_seldom() -> None:
    """Search for cyclic garbage seldom from now on: in a process that is this program's own."""
    gc.set_threshold(ALLOCATIONS)


@contextmanager
def without_search() -> Iterator[None]:
    """Context without searches for cyclic garbage, for one call that makes hundreds of thousands of objects to keep."""
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_enabled:
            gc.enable()
