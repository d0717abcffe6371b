"""The order of the package: folders in the direction of the data, imports from earlier folders only, no circles."""

from __future__ import annotations

import ast
from functools import cache
from graphlib import CycleError, TopologicalSorter
from itertools import pairwise

import pytest

from tests.support.paths import ROOT

PACKAGE = ROOT / "sim_heating"
FOLDERS = (
    "base", "heating", "thermal", "trajectory", "march", "inputs", "simulation", "estimation", "closure", "planning",
    "cli",
)  # fmt: skip
"""Folders in the order of the data: each imports only from those before it."""
ENTRIES = 12
"""Most entries of a folder, `__init__.py` and data aside."""
LONG = {"heating/effects": 24, "trajectory": 14}
"""Folders that may have more: the catalogue of effects, and the sources of trajectories."""


@cache
def modules():
    """File of each module by its dotted name."""
    names = {p: ("sim_heating", *p.relative_to(PACKAGE).with_suffix("").parts) for p in PACKAGE.rglob("*.py")}
    return {".".join(n[:-1] if n[-1] == "__init__" else n): p for p, n in names.items()}


@cache
def imports(name):
    """Modules of the package that a module imports, in functions and for annotations too."""
    found = set()
    for node in ast.walk(ast.parse(modules()[name].read_text())):
        if isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{name}, line {node.lineno}: a relative import"
            found |= {f"{node.module}.{a.name}" for a in node.names} | {node.module}
        elif isinstance(node, ast.Import):
            found |= {a.name for a in node.names}
    found &= set(modules())
    return {n for n in found if not any(other.startswith(n + ".") for other in found)}


def folder(name):
    """Number of a module's folder in the order of the data; None for the package's public face."""
    parts = name.split(".")
    return FOLDERS.index(parts[1]) if len(parts) > 1 and parts[1] in FOLDERS else None


def test_every_folder_of_the_package_is_in_the_order_of_the_data():
    assert {p.parent.name for p in PACKAGE.glob("*/__init__.py")} == set(FOLDERS)


@pytest.mark.parametrize("here", FOLDERS)
def test_a_folder_imports_only_from_those_before_it(here):
    wrong = [
        f"{name} imports {other}"
        for name in modules()
        if folder(name) == FOLDERS.index(here)
        for other in imports(name)
        if folder(other) is None or folder(other) > folder(name)
    ]
    assert not wrong, "\n".join(wrong)


def test_no_files_import_each_other_in_a_circle():
    graph = {name: imports(name) for name in modules()}
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as circle:
        pytest.fail(" -> ".join(circle.args[1]))


def test_no_subfolders_import_each_other_in_a_circle():
    """Files that stand directly in a folder may use its subfolders and be used by them; subfolders stay in an order."""
    home = {name: path.parent.relative_to(PACKAGE).as_posix() for name, path in modules().items()}
    graph = {place: set() for place in home.values() if "/" in place}
    for name, place in home.items():
        if place in graph:
            graph[place] |= {home[n] for n in imports(name) if home[n] in graph} - {place}
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as circle:
        pytest.fail("\n".join(f"{b} imports {a}" for a, b in pairwise(circle.args[1])))


def test_no_folder_has_more_entries_than_a_reader_takes_in():
    for place in {p.parent for p in modules().values()} - {PACKAGE}:
        entries = [p for p in place.iterdir() if p.suffix == ".py" or (p / "__init__.py").exists()]
        name = place.relative_to(PACKAGE).as_posix()
        assert len(entries) - 1 <= LONG.get(name, ENTRIES), name
