"""Decorators of kernels: compiled by numba in one way, when they are first called.

Importing a kernel costs nothing: numba, which takes half a second to import, is imported by the first call of one
(compiler.py). What only reads and checks files lets the interpreter run the few that it needs (`for_values`).
"""

from __future__ import annotations

import functools
import os
import sys
from collections.abc import Callable
from types import FunctionType
from typing import Any, TypeVar, cast
from weakref import WeakValueDictionary

F = TypeVar("F", bound=Callable[..., object])

STEP_SIGNATURE = "void(CPointer(float64), CPointer(int64), CPointer(float64), int64, float64)"
"""step(B, J, table, dispatcher, dt), dt [s], as a host's C code sees a compiled step; in the words of numba."""


FEW_VALUES = 10_000
"""Values that the interpreter is done with long before the compiler would be loaded."""
_PACKAGE = f"{__name__.partition('.')[0]}."


class Kernel:
    """A function that numba compiles, or loads from the cache, when it is called for the first time.

    Within other kernels it stands for numba's dispatcher of it, whose attributes it has.
    """

    def __init__(self, make: Callable[[], Any], inlined_by: str = "") -> None:
        """make : gives the function to compile;  inlined_by : `numba`, `LLVM`, or empty (`compiler.kernel`)"""
        self._make, self._inlined_by = make, inlined_by

    @functools.cached_property
    def py_func(self) -> Any:
        """The function itself, as the interpreter runs it."""
        return self._make()

    @functools.cached_property
    def dispatcher(self) -> Any:
        """numba's dispatcher; where compilation is disabled, the function itself."""
        if is_interpreted():
            return self.py_func
        from sim_heating.base.kernels import compiler

        compiled = compiler.kernel(self.py_func, self._inlined_by)
        _KERNELS[id(compiled)] = self
        return compiled

    @property
    def _numba_type_(self) -> Any:
        """What numba takes the kernel for where another one calls it."""
        return self.dispatcher._numba_type_

    def __call__(self, *arguments: Any) -> Any:
        """The kernel's value."""
        return self.dispatcher(*arguments)

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__") or name in ("_make", "_inlined_by"):
            raise AttributeError(name)
        return getattr(self.dispatcher, name)

    def __reduce__(self) -> Any:
        # A kernel of the package by its name: another process then has its own, known as the package's, and loads what
        # is compiled. One of a user's file, which the other process may not find, with its code.
        module, name = self.__module__, self.__dict__.get("__qualname__", "")
        if module.startswith(_PACKAGE) and getattr(sys.modules.get(module), name, None) is self:
            return name
        return _kernel_with, (self.dispatcher,)


_KERNELS: WeakValueDictionary[int, Kernel] = WeakValueDictionary()
"""Kernels with a dispatcher, by its identity."""


def _kernel_with(dispatcher: Any) -> Kernel:
    """The kernel of a dispatcher that was pickled: the one of this process, or a new one in another process."""
    existing = _KERNELS.get(id(dispatcher))
    if existing is None:
        existing = _KERNELS[id(dispatcher)] = Kernel(lambda: dispatcher.py_func)
        existing.__dict__["dispatcher"] = dispatcher
    return existing


def is_interpreted() -> bool:
    """Whether NUMBA_DISABLE_JIT asks for kernels that the interpreter runs."""
    numba = sys.modules.get("numba")
    if numba is not None and hasattr(numba, "config"):
        return bool(numba.config.DISABLE_JIT)
    return os.environ.get("NUMBA_DISABLE_JIT", "0").strip() not in ("", "0")


def njit(function: F) -> F:
    """Compile a kernel: no fastmath (bit-equal interpreted, jitted and exported), numpy division, GIL released."""
    return _kernel_of(function, "")


def inline_always(function: F) -> F:
    """Inline a kernel into its single caller before that is compiled; it would otherwise be compiled twice.

    Not for a large one: numba copies all of it, twice, and again with every caller around it, in a time that grows as
    the square of its size.
    """
    return _kernel_of(function, "numba")


def force_inline(function: F) -> F:
    """Compile a kernel like njit and inline it wherever called: a loop over lanes with calls does not vectorise."""
    return _kernel_of(function, "LLVM")


def _kernel_of(function: F, inlined_by: str) -> F:
    if is_interpreted():
        return function
    return cast(F, functools.update_wrapper(Kernel(lambda: function, inlined_by), function))


def njit_of(make: Callable[[], F]) -> F:
    """A kernel over tables: `make` reads them and gives the function, when the kernel is first called.

    The tables are variables of `make` that the function closes over: as such they are part of the key of the compiled
    cache, and an edited table recompiles.
    """
    return cast(F, Kernel(make))


def c_function(signature: Any, function: Any, cache: bool = True) -> Any:
    """Compile a kernel as a C function with a fixed address; where compilation is disabled, the function itself.

    signature : numba signature of the C function, or its text, such as STEP_SIGNATURE
    cache     : whether it goes into the cache on disk; not for closures
    """
    if is_interpreted():
        return function
    from sim_heating.base.kernels import compiler

    return compiler.c_function(signature, function, cache)


@functools.cache
def interpreted(kernel: Callable[..., Any]) -> Callable[..., Any]:
    """The function that a kernel compiles, as the interpreter runs it, and with it the kernels that it calls; one of
    plain arithmetic also takes arrays."""
    function: Any = getattr(kernel, "py_func", kernel)
    names, module = function.__code__.co_names, function.__globals__
    called = {name: interpreted(module[name]) for name in names if isinstance(module.get(name), Kernel)}
    if not called:
        return cast(Callable[..., Any], function)
    return FunctionType(
        function.__code__, module | called, function.__name__, function.__defaults__, function.__closure__
    )


def for_values(kernel: F, count: int) -> F:
    """A kernel for a number of values: of few, the function that the interpreter runs, until the compiler is loaded.

    Both give the same bits. A check of a file calls a kernel for some columns and nothing else.
    """
    return cast(F, interpreted(kernel)) if count <= FEW_VALUES and "numba" not in sys.modules else kernel


def address_of(function):
    """What a kernel takes for a function that it calls: the address of a compiled one, else the function itself."""
    return getattr(function, "address", function)
