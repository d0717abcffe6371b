"""The one way kernels are compiled: strict IEEE arithmetic, no exceptions, cached where a cache can be written."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable
from typing import TypeVar

import numba
import numba.extending

F = TypeVar("F", bound=Callable[..., object])


def _cache_is_writable(folder: str) -> bool:
    try:
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError:
        return False


def _ensure_cache_folder() -> None:
    """numba refuses to decorate with cache=True where no cache folder can be written; give it a temporary one."""
    package = os.path.dirname(os.path.abspath(__file__))
    home = os.path.expanduser("~")
    if "NUMBA_CACHE_DIR" in os.environ or _cache_is_writable(package) or _cache_is_writable(home):
        return
    numba.config.CACHE_DIR = tempfile.mkdtemp(prefix="sim_heating_numba_")


_ensure_cache_folder()

# Loops over a few lanes are unrolled before the loop vectoriser sees them; this pass packs them back into vectors. It
# reorders no arithmetic: results keep their bits.
numba.config.SLP_VECTORIZE = 1


def njit(function: F) -> F:
    """Compile a kernel: no fastmath (bit-equal interpreted, jitted and exported), numpy division, GIL released."""
    return numba.njit(cache=True, fastmath=False, error_model="numpy", nogil=True)(function)


@numba.extending.intrinsic
def _data_pointer(_typing_context: object, array: numba.types.Array):  # type: ignore[no-untyped-def]
    pointer = numba.types.CPointer(array.dtype)

    def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
        return context.make_array(signature.args[0])(context, builder, args[0]).data

    return pointer(array), codegen


def raw(array):  # type: ignore[no-untyped-def]
    """The data of a contiguous array as a kernel takes it: a bare C pointer when compiled, the array itself interpreted.

    A pointer is what an exported library hands over as well, and its index arithmetic knows no negative indices, which
    an array's does: kernels on pointers vectorise across lanes and kernels on arrays do not.
    """
    return array


@numba.extending.overload(raw, inline="always")
def _raw_compiled(array):  # type: ignore[no-untyped-def]
    if isinstance(array, numba.types.Array):
        return lambda array: _data_pointer(array)
    return None
