"""Parts of libraries that are loaded for nothing by a command of this program, which does without them.

scipy imports all of numpy by name, and so its tools for tests and for Fortran; its optimisation imports geometry for
one method. matplotlib writes descriptions of the properties of all its classes, and imports axes in three dimensions.
xarray imports every kind of array that it can hold. Together they take up to a third of the imports of a command. A
program that imports this package has its libraries whole.
tests/base/test_unused_parts.py has a test for each: after a change of a library its name states what is loaded again.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from types import ModuleType

KINDS_OF_ARRAYS = ("dask", "pint", "pyarrow")
"""Libraries that xarray and pandas import where they are installed, for arrays of theirs."""
UNUSED = {"scipy": ("numpy.f2py", "numpy.testing"), "scipy.optimize": ("scipy.spatial",)}
"""What a module imports without using it; it is loaded when something of it is used."""


_is_own_process = False
"""Whether parts are left out here."""


def leave_out() -> None:
    """Leave unused parts out of libraries that are imported from now on, in a process that is this program's own."""
    global _is_own_process
    _is_own_process = True
    actions = {name: partial(_load_when_used, parts) for name, parts in UNUSED.items()}
    # of matplotlib's modules of things to draw the first one, whichever is asked for
    sys.meta_path.insert(0, _Watch({**actions, "matplotlib.lines": _strip_matplotlib}))


@contextmanager
def without(*names: str) -> Iterator[None]:
    """Context in which modules that are not loaded yet are not found; a library that asks for one in it does without.

    names : dotted names of modules

    Without effect in a process that is not this program's own (`leave_out`).
    """
    absent = [name for name in names if name not in sys.modules] if _is_own_process else []
    sys.modules.update(dict.fromkeys(absent))  # type: ignore[arg-type]  # None is what import takes for absent
    try:
        yield
    finally:
        for name in absent:
            if sys.modules.get(name) is None:
                sys.modules.pop(name, None)


class _Watch:
    """A finder of modules that finds none, and acts before some are loaded for the first time."""

    def __init__(self, actions: dict[str, Callable[[], None]]) -> None:
        self._actions = actions

    def find_spec(self, name: str, _path: object = None, _target: object = None) -> None:
        """Act before the module of a name is loaded."""
        action = self._actions.pop(name, None)
        if action is not None:
            action()


def _load_when_used(names: Sequence[str]) -> None:
    """Put modules into their packages that are loaded when something of theirs is used."""
    import importlib.util

    for name in names:
        spec = importlib.util.find_spec(name)
        if name not in sys.modules and spec is not None and spec.loader is not None:
            spec.loader = importlib.util.LazyLoader(spec.loader)
            module = importlib.util.module_from_spec(spec)
            sys.modules[name] = module
            spec.loader.exec_module(module)
            package, _, part = name.rpartition(".")
            setattr(sys.modules[package], part, module)


def _strip_matplotlib() -> None:
    """Have matplotlib describe no properties, and offer no axes in three dimensions."""
    import matplotlib.artist

    matplotlib.artist.kwdoc = lambda artist: ""
    absent = ModuleType("mpl_toolkits.mplot3d")
    absent.Axes3D = None  # type: ignore[attr-defined]
    sys.modules.setdefault(absent.__name__, absent)
