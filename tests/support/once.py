"""Folders that one of the processes of a test run fills and all of them read."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from filelock import FileLock


def made_once(factory: pytest.TempPathFactory, name: str, make: Callable[[Path], object]) -> Path:
    """A folder of the test run, filled by the first process that asks for it; the others wait.

    name : of the folder, one for all that is made by the same function
    make : fills an empty folder, from which nobody may remove or change anything later
    """
    root = factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        root = root.parent  # that of all processes
    place, made = root / "made_once" / name, root / "made_once" / f"{name}.made"
    place.parent.mkdir(exist_ok=True)
    with FileLock(made.with_suffix(".lock")):
        if not made.exists():
            shutil.rmtree(place, ignore_errors=True)  # of a process that failed to fill it
            place.mkdir()
            make(place)
            made.touch()
    return place
