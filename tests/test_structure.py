"""The order of the package: folders in the direction of the data, imports from earlier folders only, no circles."""

from __future__ import annotations

import ast
import re
from graphlib import CycleError, TopologicalSorter
from itertools import pairwise

import pytest

from tests.support.paths import ROOT
from tests.support.structure import FOLDERS, PACKAGE, PAGE, folder, imports, modules, page


def test_every_folder_of_the_package_is_in_the_order_of_the_data():
    assert {p.parent.name for p in PACKAGE.glob("*/__init__.py")} == set(FOLDERS)


@pytest.mark.parametrize("here", FOLDERS)
def test_a_folder_imports_only_from_those_before_it(here):
    wrong = [
        f"{name} imports {other}"
        for name in modules()
        if folder(name) == here
        for other in imports(name)
        if folder(other) not in FOLDERS[: FOLDERS.index(here) + 1]
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


def test_closing_a_loop_imports_no_page():
    """Pages stand above what they show; what writes them imports them when it writes."""
    pages = {f"sim_heating.closure.report.{n}" for n in ("record", "records", "batch", "plots")}
    wrong = [
        f"{name} imports {node.module}"
        for name in set(modules()) - pages
        if folder(name) == "closure" and not name.startswith("sim_heating.closure.revise")
        for node in ast.parse(modules()[name].read_text()).body
        if isinstance(node, ast.ImportFrom) and (node.module in pages or "base.report" in str(node.module))
    ]
    assert not wrong, "\n".join(wrong)


ASIDE = {"tests/support": ("tests.support",), "benchmarks": ("tests.support", "benchmarks"),
         "tools": ("tests.support", "benchmarks", "tools")}  # fmt: skip
"""Code beside the package -> what it may import there: tools use benchmarks, which use what the tests share."""


@pytest.mark.parametrize("place", ASIDE)
def test_benchmarks_and_tools_build_on_what_tests_share(place):
    wrong = [
        f"{path.relative_to(ROOT)} imports {node.module}"
        for path in sorted((ROOT / place).rglob("*.py"))
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.ImportFrom) and str(node.module).partition(".")[0] in ("tests", "benchmarks", "tools")
        if not str(node.module).startswith(ASIDE[place])
    ]
    assert not wrong, "\n".join(wrong)


@pytest.mark.parametrize("place", ["benchmarks", "tools"])
def test_every_module_beside_the_package_is_in_the_table_of_its_folder(place):
    listed = (ROOT / place / "README.md").read_text()
    modules_there = {p.stem for p in (ROOT / place).glob("*.py")} | {
        p.parent.name for p in (ROOT / place).glob("*/*.py")
    }
    assert not {n for n in modules_there - {"__init__", "__main__"} if f"`{n}`" not in listed}


def test_the_picture_of_the_architecture_is_that_of_the_imports():
    """Written again by `python -m tests.support.structure`."""
    text = PAGE.read_text()
    lines = [line for line in page(text).splitlines() if "-->" in line]
    assert [line for line in text.splitlines() if "-->" in line] == lines


def test_modules_that_texts_name_exist():
    """In code that a test or a benchmark hands to another process, in docstrings and on pages."""
    wrong = []
    pages = list((ROOT / "docs").rglob("*.md"))
    code = [
        p
        for folder in ("sim_heating", "tests", "benchmarks", "tools", "examples")
        for p in (ROOT / folder).rglob("*.py")
    ]
    for path in (ROOT / "README.md", *pages, *code):
        for name in re.findall(r"\b(?:from|import) (sim_heating(?:\.\w+)+)", path.read_text()):
            if name not in modules() and path.name != "test_user_effect.py":  # which imports what is gone
                wrong.append(f"{path.relative_to(ROOT)}: {name}")
    assert not wrong, "\n".join(wrong)


LOCAL_TIME = re.compile(
    r"datetime\.now\(\)|\.today\(|fromtimestamp\((?!.*UTC)|localtime|mktime|[^_s]ctime\(|asctime|tz_localize|utcnow"
)
"""Calls whose result depends on the time zone of the machine."""
DAY_OF_REVIEW = ("cli/credibility.py", "datetime.date.today(")
"""The day that a reviewer signs at is that of the place where he is."""


def test_only_the_day_of_a_review_depends_on_the_time_zone():
    found = [
        (path.relative_to(PACKAGE).as_posix(), line)
        for path in sorted(PACKAGE.rglob("*.py"))
        for line in path.read_text(encoding="utf-8").splitlines()
        if LOCAL_TIME.search(line)
    ]
    assert [(name, DAY_OF_REVIEW[1] in line) for name, line in found] == [(DAY_OF_REVIEW[0], True)]
