"""Docstrings of the physics: what computes a physical quantity names its units and where its equation is from."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator

from tests.support.structure import PACKAGE

PHYSICS = ("heating", "thermal", "march", "estimation/inference", "estimation/filter")
UNIT = re.compile(r"\[(?:-|1|(?:[^\]\s]|\s(?=[\w(])){0,30}(?:K|W|J|Pa|m|s|kg|deg)(?:[^\]]){0,20})\]")
SOURCE = re.compile(
    r"\bet al\b|\b(?:eq|eqs|equation|equations)\.? \(?[\dA-Z]|\b(?:section|chapter|table|page|figure|fig\.) \(?\d"
    r"|[A-Z][a-z]+,? (?:and [A-Z][a-z]+,? )?\(?(?:19|20)\d\d\b|\((?:19|20)\d\d\)|\bNASA\b|\bUS76\b"
)
NO_UNIT = {
    "write_order", "invalidate_cells", "cache_axis_cell", "lanes_outside_cell", "invalidate_walls", "pairs",
    "shift_conditions", "values", "aligned_zeros", "histories", "snapshot", "copy_columns", "declared_constants",
}  # fmt: skip
"""Functions that keep, move or invalidate numbers of any unit."""
NO_SOURCE = NO_UNIT | {
    # read, write, copy or select numbers
    "pack_table", "read_ratio_table", "write_ratio_table", "ratio_table_text", "parameters", "block", "integers",
    "node_temperatures", "lost", "within", "chosen", "read", "track_of_record", "over_midnight", "by_name",
    # lengths and indices of a declared stack
    "thickness_m", "interfaces_m", "bondline_m", "holds", "angle_deg", "cell", "cell_by_bisection",
}  # fmt: skip
"""Functions with numbers in their result and no equation."""


def documented() -> Iterator[tuple[str, str, ast.FunctionDef]]:
    """Public functions and methods of the physics folders that return numbers, kernels among them."""
    for folder in PHYSICS:
        for path in sorted((PACKAGE / folder).rglob("*.py")):
            tree = ast.parse(path.read_text())
            classes = [c for c in tree.body if isinstance(c, ast.ClassDef) and not c.name.startswith("_")]
            for owner in (tree, *classes):
                for f in owner.body:
                    if isinstance(f, ast.FunctionDef) and not f.name.startswith("_"):
                        yield path.relative_to(PACKAGE).as_posix(), f.name, f


def computes(f: ast.FunctionDef) -> bool:
    """Whether the result is numbers; a kernel writes them into its block and returns nothing."""
    kernel = any("jit" in ast.unparse(d) or "inline" in ast.unparse(d) for d in f.decorator_list)
    return kernel or f.returns is None or bool(re.search(r"\bfloat\b|FloatArray|np\.float64", ast.unparse(f.returns)))


def lacking(pattern: re.Pattern[str], excepted: set[str]) -> list[str]:
    return [
        f"{path}: {name}"
        for path, name, f in documented()
        if computes(f) and name not in excepted and not pattern.search(ast.get_docstring(f) or "")
    ]


def test_the_walk_finds_the_physics():
    assert sum(computes(f) for _, _, f in documented()) > 150


def test_a_quantity_has_a_unit():
    assert not lacking(UNIT, NO_UNIT)


def test_an_equation_has_a_source():
    assert not lacking(SOURCE, NO_SOURCE)


def test_a_public_function_has_a_docstring_that_stands_alone():
    wrong = [
        f"{path}: {name}"
        for path, name, f in documented()
        if not (text := ast.get_docstring(f)) or re.match(r"(The same|And|Of|Beside|That|Those|One that)\b", text)
    ]
    assert not wrong
