"""Compilation of all kernels in one way: strict IEEE arithmetic, no exceptions, cached where a cache can be written.

Where several processes need a kernel that nobody has compiled, one compiles it and the others load what it made.

numba and the compiled operations take half a second to import: the decorators of jit.py import this module when the
first kernel is called.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numba
import numba.extending

from sim_heating.base.kernels import numba_private
from sim_heating.base.kernels.cache_folder import cache_folder
from sim_heating.base.kernels.operations import call_dispatcher, call_effect, call_step, pointer, power_of_two, split

if "NUMBA_CACHE_DIR" not in os.environ:
    numba.config.CACHE_DIR = cache_folder()  # type: ignore[attr-defined]
CACHE = Path(numba.config.CACHE_DIR)  # type: ignore[attr-defined]
"""Folder of compiled kernels and of the objects of exported libraries."""

# Loops over a few lanes are unrolled before the loop vectoriser sees them; this pass packs them back into vectors. It
# reorders no arithmetic: results keep their bits.
numba.config.SLP_VECTORIZE = 1  # type: ignore[attr-defined]


_ARITHMETIC: Mapping[str, Any] = {"fastmath": False, "error_model": "numpy"}
"""Options of every kernel that decide its bits: no reassociation, no contraction, numpy's division by zero."""
_CALLED: Mapping[str, Any] = {**_ARITHMETIC, "nogil": True, "no_cfunc_wrapper": True}
"""Options of a kernel that kernels or Python call; C calls none of them, `c_function` makes an entry of its own."""


COMPILATION_WAIT_S = 120.0
"""Longest wait [s] for another process that compiles the same kernel; it is then compiled here as well."""


@contextmanager
def compiled_by_one_process(function: Any) -> Iterator[None]:
    """Wait until no other process compiles or loads a function; where the folder takes no locks, there is no waiting.

    A kernel is compiled with those that it calls, each under its own lock. Calls have no circle, so neither have the
    processes that wait for each other.
    """
    from filelock import FileLock, Timeout  # costs 25 ms, which only a first kernel pays

    name = f"{function.__module__}.{function.__qualname__}:{function.__code__.co_firstlineno}"
    digest = hashlib.sha256(f"{function.__code__.co_filename} {name}".encode()).hexdigest()[:16]
    lock = FileLock(CACHE / f"{digest}.lock", timeout=COMPILATION_WAIT_S, is_singleton=True)
    with suppress(Timeout, OSError, NotImplementedError):
        lock.acquire()
    try:
        yield
    finally:
        lock.release()


def kernel(function: Any, inlined_by: str) -> Any:
    """numba's dispatcher of a kernel.

    inlined_by : `numba`, which copies the kernel into its callers before they are compiled; `LLVM`, which has to inline
                 it into every caller; or empty
    """
    if inlined_by == "numba":
        return numba.njit(inline="always", **_ARITHMETIC)(function)
    decorate = numba.njit(forceinline=inlined_by == "LLVM", **_CALLED)
    return numba_private.compile_within(compiled_by_one_process, decorate(function))


def c_function(signature: Any, function: Any, cache: bool) -> Any:
    """A kernel as a C function of numba."""
    compiled = numba.cfunc(signature, cache=cache, **_ARITHMETIC)
    if not cache:
        return compiled(function)
    with compiled_by_one_process(function):
        return compiled(function)


@numba.extending.overload(pointer, inline="always")
def _pointer_compiled(array):
    if isinstance(array, numba.types.Array):
        return lambda array: numba_private.array_data(array)
    return None


@numba.extending.overload(power_of_two, inline="always")
def _power_of_two_compiled(k):
    return lambda k: numba_private.power_of_two_bits(k)


@numba.extending.overload(split, inline="always")
def _split_compiled(x):
    return lambda x: numba_private.mantissa_and_exponent_bits(x)


@numba.extending.overload(call_dispatcher, inline="always")
def _call_dispatcher_compiled(dispatcher, code, B, c, p, wall_K):
    if isinstance(dispatcher, numba.types.Integer):
        return lambda dispatcher, code, B, c, p, wall_K: numba_private.call_dispatcher_at(
            dispatcher, code, B, c, p, wall_K
        )
    return None


@numba.extending.overload(call_effect, inline="always")
def _call_effect_compiled(kernel, B, c, p, wall_K):
    return lambda kernel, B, c, p, wall_K: numba_private.call_effect_at(kernel, B, c, p, wall_K)


@numba.extending.overload(call_step, inline="always")
def _call_step_compiled(step, B, J, table, dispatcher, dt):
    if isinstance(step, numba.types.Integer):
        return lambda step, B, J, table, dispatcher, dt: numba_private.call_step_at(step, B, J, table, dispatcher, dt)
    return None
