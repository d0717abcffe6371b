"""The structure of the package as its imports show it, and the part of docs/development/architecture.md that is drawn
from it.

python -m tests.support.structure        # writes that part of the page again
"""

from __future__ import annotations

import ast
from functools import cache
from pathlib import Path

from tests.support.paths import ROOT

PACKAGE = ROOT / "sim_heating"
PAGE = ROOT / "docs" / "development" / "architecture.md"
FOLDERS = (
    "base", "heating", "thermal", "trajectory", "march", "inputs", "credibility", "simulation", "templates",
    "estimation", "closure", "live", "campaign", "planning", "formats", "cli",
)  # fmt: skip
"""Folders in the order of the data: each imports only from those before it."""
BEGIN, END = "<!-- drawn from the imports: python -m tests.support.structure -->\n", "<!-- end -->\n"


@cache
def modules() -> dict[str, Path]:
    """File of each module by its dotted name."""
    names = {p: ("sim_heating", *p.relative_to(PACKAGE).with_suffix("").parts) for p in PACKAGE.rglob("*.py")}
    return {".".join(n[:-1] if n[-1] == "__init__" else n): p for p, n in names.items()}


@cache
def imports(name: str) -> frozenset[str]:
    """Modules of the package that a module imports, in functions and for annotations too."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(modules()[name].read_text())):
        if isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{name}, line {node.lineno}: a relative import"
            found |= {f"{node.module}.{a.name}" for a in node.names} | {str(node.module)}
        elif isinstance(node, ast.Import):
            found |= {a.name for a in node.names}
    found &= set(modules())
    return frozenset(n for n in found if not any(other.startswith(n + ".") for other in found))


def folder(name: str) -> str | None:
    """Top-level folder of a module; None for the public face and what else stands at the root of the package."""
    parts = name.split(".")
    return parts[1] if len(parts) > 1 and parts[1] in FOLDERS else None


def folder_graph() -> dict[str, set[str]]:
    """Folders that each folder imports from."""
    graph: dict[str, set[str]] = {f: set() for f in FOLDERS}
    for name in modules():
        here = folder(name)
        if here is not None:
            graph[here] |= {f for f in map(folder, imports(name)) if f is not None and f != here}
    return graph


def reduced(graph: dict[str, set[str]]) -> dict[str, set[str]]:
    """The graph without arrows that a longer way replaces."""

    def reach(start: str) -> set[str]:
        return set().union(graph[start], *(reach(f) for f in graph[start]))

    return {f: to - set().union(set(), *(reach(t) for t in to)) for f, to in graph.items()}


def drawn() -> str:
    """The part of the page that is drawn from the imports: a diagram and a table of the folders."""
    arrows = [f"    {to} --> {f}" for f, uses in reduced(folder_graph()).items() for to in sorted(uses)]
    rows = []
    for f in FOLDERS:
        files = [p for p in (PACKAGE / f).rglob("*.py") if p.name != "__init__.py"]
        lines = sum(len(p.read_text().splitlines()) for p in files)
        about = (ast.get_docstring(ast.parse((PACKAGE / f / "__init__.py").read_text())) or "").split("\n\n")[0]
        rows.append(f"| `{f}` | {' '.join(about.split())} | {len(files)} | {lines / 1000:.1f} |")
    head = ["| folder | what it holds | files | thousand lines |", "|---|---|---|---|"]
    return "\n".join(["```mermaid", "flowchart LR", *arrows, "```", "", *head, *rows, ""])


def page(text: str) -> str:
    """The page with the drawn part as the imports are now."""
    before, rest = text.split(BEGIN)
    return before + BEGIN + drawn() + END + rest.split(END)[1]


if __name__ == "__main__":
    PAGE.write_text(page(PAGE.read_text()))
