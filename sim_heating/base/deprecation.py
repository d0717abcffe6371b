"""Modules at their earlier places: they work for one release, with a warning that names what to use."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from importlib import import_module
from typing import Any


def moved_module(old: str, new: str, public_name: str) -> Callable[[str], Any]:
    """Warn that a module has moved; gives the `__getattr__` of the module that stands at its earlier place.

    old, new    : dotted names of the module, earlier and now
    public_name : what users import from `sim_heating` instead
    """
    warnings.warn(
        f"{old} is deprecated and goes with the next release; use `from sim_heating import {public_name}`",
        DeprecationWarning,
        stacklevel=3,
    )
    return lambda name: getattr(import_module(new), name)
