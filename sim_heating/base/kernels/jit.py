"""Compilation of all kernels in one way: strict IEEE arithmetic, no exceptions, cached where a cache can be written."""

from __future__ import annotations

import hashlib
import math
import os
import re
import shutil
import stat
import tempfile
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, TypeVar, cast

import numba
import numba.extending

from sim_heating.base.kernels.numba_private import (
    CFunctionCompiler,
    KernelCompiler,
    array_data,
    call_dispatcher_at,
    call_step_at,
    mantissa_and_exponent_bits,
    power_of_two_bits,
)

F = TypeVar("F", bound=Callable[..., object])

PACKAGE = Path(__file__).resolve().parents[2]
CACHE_AGE_S = 14 * 86400.0
"""Age [s] at which unused caches of other versions of the package are removed."""


_IMPORT = re.compile(r"^\s*(?:from|import) sim_heating\.([\w.]+)(?: import (?:\(([^)]*)\)|(.*)))?", re.MULTILINE)


def _modules(package: Path) -> dict[str, Path]:
    """File of each module and folder of a package, by its dotted name within it."""
    files = {path.relative_to(package).with_suffix("").parts: path for path in package.rglob("*.py")}
    return {".".join(parts[:-1] if parts[-1] == "__init__" else parts): path for parts, path in files.items()}


def _imported(path: Path, modules: Mapping[str, Path]) -> set[Path]:
    """Modules of the package that a module imports, by their absolute names."""
    found = set()
    for module, several, one in _IMPORT.findall(path.read_text(encoding="utf-8")):
        found |= {module, *(f"{module}.{name}" for name in re.findall(r"\w+", several + one))}
    return {modules[name] for name in found if name in modules}


def kernel_sources(package: Path = PACKAGE) -> list[Path]:
    """All sources of the compiled kernels: modules that import this one, what those import, and data files.

    package : folder of the package
    returns : paths in their order

    Imports are found by their absolute names in the text, since parsing all modules would cost a start a second
    (tests/base/test_kernel_cache.py compares with a parser). A relative import would not be found. The public face of
    the package names everything, the compiler included, and defines no kernel: it is none of them.
    """
    modules = _modules(package)
    imports = {path: _imported(path, modules) for name, path in modules.items() if name}
    waiting = [path for path, found in imports.items() if modules["base.kernels.jit"] in found]
    sources: set[Path] = set()
    while waiting:
        path = waiting.pop()
        if path not in sources:
            sources.add(path)
            waiting += imports[path]
    return sorted([*sources, *package.rglob("*.csv")])


def source_digest(package: Path = PACKAGE) -> str:
    """Digest of all sources of the compiled kernels and of the version of numba.

    package : folder of the package
    returns : 16 hexadecimal digits, of which the name of the cache folder is made

    numba keys its cache by the file of a function alone: a kernel that calls another one, or has a table as a constant,
    would keep its old code after a change in the other file.
    """
    digest = hashlib.sha256(numba.__version__.encode())
    for path in kernel_sources(package):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def _cache_folder() -> str:
    """A writable folder for the compiled kernels of this version only: in the user's cache, else temporary."""
    name = f"kernels-{source_digest()}"
    for home in (_user_cache(), _temporary_cache()):
        try:
            if home is None:
                continue
            folder = home / name
            folder.mkdir(parents=True, exist_ok=True)
            # Writing is tried: permissions alone do not show a full or read-only file system.
            with tempfile.TemporaryFile(dir=folder):
                folder.touch()
            for other in home.glob("kernels-*"):
                if time.time() - other.stat().st_mtime > CACHE_AGE_S:
                    shutil.rmtree(other, ignore_errors=True)
            return str(folder)
        except OSError:
            continue
    return tempfile.mkdtemp(prefix="sim_heating_kernels_")


def _user_cache() -> Path | None:
    """The user's cache; None for a user without a home, as in a container."""
    try:
        return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "sim_heating"
    except RuntimeError:
        return None


def _temporary_cache() -> Path | None:
    """A temporary folder that later processes of this user find again; None where others could write to it."""
    if not hasattr(os, "getuid"):
        return None
    folder = Path(tempfile.gettempdir()) / f"sim_heating-{os.getuid()}"
    with suppress(FileExistsError):
        folder.mkdir(mode=0o700)
    found = folder.lstat()
    is_private = stat.S_ISDIR(found.st_mode) and found.st_uid == os.getuid() and not found.st_mode & 0o077
    return folder if is_private else None


if "NUMBA_CACHE_DIR" not in os.environ:
    numba.config.CACHE_DIR = _cache_folder()  # type: ignore[attr-defined]

# Loops over a few lanes are unrolled before the loop vectoriser sees them; this pass packs them back into vectors. It
# reorders no arithmetic: results keep their bits.
numba.config.SLP_VECTORIZE = 1  # type: ignore[attr-defined]


_ARITHMETIC: Mapping[str, Any] = {"fastmath": False, "error_model": "numpy"}
"""Options of every kernel that decide its bits: no reassociation, no contraction, numpy's division by zero."""


def njit(function: F, inline: bool = False) -> F:
    """Compile a kernel: no fastmath (bit-equal interpreted, jitted and exported), numpy division, GIL released.

    inline : whether LLVM has to inline it into every caller (see `force_inline`)
    """
    kernel = numba.njit(cache=True, nogil=True, forceinline=inline, pipeline_class=KernelCompiler, **_ARITHMETIC)
    return cast(F, kernel(function))


def inline_always(function: F) -> F:
    """Inline a kernel into its single caller before that is compiled; it would otherwise be compiled twice.

    Not for a large one: numba copies all of it, twice, and again with every caller around it, in a time that grows as
    the square of its size.
    """
    return cast(F, numba.njit(inline="always", **_ARITHMETIC)(function))


def c_function(signature: Any, function: Any, cache: bool = True) -> Any:
    """Compile a kernel as a C function with a fixed address; where compilation is disabled, the function itself.

    signature : numba signature of the C function, such as STEP_SIGNATURE
    cache     : whether it goes into the cache on disk; not for closures
    """
    if numba.config.DISABLE_JIT:  # type: ignore[attr-defined]
        return function
    return numba.cfunc(signature, cache=cache, pipeline_class=CFunctionCompiler, **_ARITHMETIC)(function)


def force_inline(function: F) -> F:
    """Compile a kernel like njit and inline it wherever called: a loop over lanes with calls does not vectorise."""
    return njit(function, inline=True)


def pointer(array):  # type: ignore[no-untyped-def]
    """Data of a contiguous array as a kernel takes it: a C pointer when compiled, the array itself when interpreted.

    An exported library passes pointers as well. Indices into a pointer are never counted from its end, unlike those
    into an array: kernels on pointers vectorise across lanes and kernels on arrays do not.
    """
    return array


@numba.extending.overload(pointer, inline="always")
def _pointer_compiled(array):  # type: ignore[no-untyped-def]
    if isinstance(array, numba.types.Array):
        return lambda array: array_data(array)
    return None


def power_of_two(k: float) -> float:
    """2^k [-] of a whole number k from -1022 to 1023, given as a float; compiled, its bits are put together."""
    return math.ldexp(1.0, int(k)) if k == k else k


@numba.extending.overload(power_of_two, inline="always")
def _power_of_two_compiled(k):  # type: ignore[no-untyped-def]
    return lambda k: power_of_two_bits(k)


def split(x: float) -> tuple[float, float]:
    """m [-] from 0.5 to below 1 and k with x = m 2^k, for a normal x above 0; compiled, its bits are taken apart."""
    m, k = math.frexp(x)
    return m, float(k)


@numba.extending.overload(split, inline="always")
def _split_compiled(x):  # type: ignore[no-untyped-def]
    return lambda x: mantissa_and_exponent_bits(x)


def call_dispatcher(dispatcher, code, B, c, p, wall_K):  # type: ignore[no-untyped-def]
    """dispatcher(code, B, c, p, wall_K) [-]: the effect of a code, through the address of its dispatcher.

    wall_K : wall temperature [K];  code, B, c, p : as in heating/effects/compiled.py

    Interpreted, the dispatcher is the function itself. Passing an address to a kernel costs nothing; passing a function
    object costs 35 us a call.
    """
    return dispatcher(code, B, c, p, wall_K)


@numba.extending.overload(call_dispatcher, inline="always")
def _call_dispatcher_compiled(dispatcher, code, B, c, p, wall_K):  # type: ignore[no-untyped-def]
    if isinstance(dispatcher, numba.types.Integer):
        return lambda dispatcher, code, B, c, p, wall_K: call_dispatcher_at(dispatcher, code, B, c, p, wall_K)
    return None


def call_step(step, B, J, table, dispatcher, dt):  # type: ignore[no-untyped-def]
    """Call step(B, J, table, dispatcher, dt) through its address when compiled, as a function when interpreted; dt [s].

    The large compiled step is made once this way; a loop that called it by name would compile it into itself again.
    """
    step(B, J, table, dispatcher, dt)


@numba.extending.overload(call_step, inline="always")
def _call_step_compiled(step, B, J, table, dispatcher, dt):  # type: ignore[no-untyped-def]
    if isinstance(step, numba.types.Integer):
        return lambda step, B, J, table, dispatcher, dt: call_step_at(step, B, J, table, dispatcher, dt)
    return None


STEP_SIGNATURE = numba.types.void(
    numba.types.CPointer(numba.types.float64),
    numba.types.CPointer(numba.types.int64),
    numba.types.CPointer(numba.types.float64),
    numba.types.int64,
    numba.types.float64,
)
"""step(B, J, table, dispatcher, dt), dt [s], as a host's C code sees a compiled step."""


def address_of(function):  # type: ignore[no-untyped-def]
    """What a kernel takes for a function that it calls: the address of a compiled one, else the function itself."""
    return getattr(function, "address", function)
