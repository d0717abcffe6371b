"""Modules at their earlier places and arguments by their earlier names: they work for one release, with a warning."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from functools import wraps
from importlib import import_module
from typing import Any, ParamSpec, TypeVar

P = ParamSpec("P")
R = TypeVar("R")


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


def renamed_argument(old: str, new: str) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Decorate a function that also takes an argument by its earlier name, with a warning that names the new one."""

    def decorate(function: Callable[P, R]) -> Callable[P, R]:
        @wraps(function)
        def renamed(*arguments: P.args, **named: P.kwargs) -> R:
            if old in named:
                warnings.warn(
                    f"{function.__name__}: `{old}` is deprecated and goes with the next release; use `{new}`",
                    DeprecationWarning,
                    stacklevel=2,
                )
                named[new] = named.pop(old)
            return function(*arguments, **named)

        return renamed

    return decorate
