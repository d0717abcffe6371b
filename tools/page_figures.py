"""Figures that pages quote from benchmarks/results: checked, or written again after a benchmark has run.

python -m tools.page_figures            # lists figures that differ from their results; exit status 1 if any does
python -m tools.page_figures --write    # writes them into the pages

A figure stands between two comments, which a forge and the site do not show, in a sentence or in a cell of a table:

    <!-- result fmu "inputs set and doStep, C host" .1f -->13.0<!-- end -->
    <!-- result estimator_statistics "popu: ratio.scale: *coverage*" note 1 .3f -->0.950<!-- end -->
    <!-- result closure_calibration "/reliability/all/0/right" d -->12<!-- end -->

First the file, benchmarks/results/fmu.json. Then, in double quotes, the entry: the `what` of one of its figures, in
which * stands for any text; or a path into the file (a JSON pointer, which begins with / and counts from 0). `note N`
takes the number that is the Nth in the note of the figure, `text N` that in a text found by a path; a factor as in
`*1e3` multiplies. The last word is the format of Python in which the number is written; without one a text is written
as it is. Whole tables stand between `<!-- results of NAME, PART -->` and `<!-- end -->` (tools/page_tables.py,
reliability_tables.py, credibility.py).
"""

from __future__ import annotations

import difflib
import json
import re
from collections.abc import Iterator
from dataclasses import dataclass
from fnmatch import fnmatchcase
from functools import cache
from pathlib import Path
from typing import Any

import click

from benchmarks.measure import RESULTS
from sim_heating.base.files.text import write_text_atomic
from tools import credibility, page_tables, reliability_tables
from tools.page import DOCS, filled

MARKED = re.compile(r'(<!-- result (\w+) "([^"]+)"((?: [^\s>]+)*) -->)(.*?)(<!-- end -->)')
SPEC = re.compile(r"(?: (note|text) (\d+))?(?: \*(\S+))?(?: (\S+))?")
NUMBER = re.compile(r"[-+]?\d+(?:\.\d*)?(?:[eE][-+]?\d+)?")


@dataclass(frozen=True)
class Stale:
    """A figure of a page that differs from its result."""

    page: Path
    line: int
    key: str
    written: str
    result: str

    def __str__(self) -> str:
        where = f"{self.page.relative_to(DOCS.parent)}, line {self.line}: {self.key}: "
        return where + f"the page says {self.written or 'nothing'}, the result is {self.result}"


def pages() -> list[Path]:
    """Pages that may quote results."""
    built = DOCS / "_build"
    return [
        DOCS.parent / "README.md",
        DOCS.parent / "paper.md",
        *(p for p in sorted(DOCS.rglob("*.md")) if built not in p.parents),
    ]


def stale_figures(page: Path) -> list[Stale]:
    """Figures of a page that differ from their results."""
    return list(_differences(page, page.read_text()))


def updated(text: str) -> str:
    """Text of a page with every figure and table as the results have it now."""
    text = MARKED.sub(lambda m: f"{m[1]}{quoted(m[2], m[3], m[4])}{m[6]}", text)
    for tables in (reliability_tables, credibility, page_tables):
        text = filled(text, tables.table_of)
    return text


def quoted(name: str, key: str, spec: str = "") -> str:
    """One result as a page writes it.

    name : file in benchmarks/results, without its ending
    key : `what` of a figure, with * for any text, or a JSON pointer
    spec : what of it, and its format: `note 1 *1e3 .2f`, each part optional
    """
    parts = SPEC.fullmatch(spec.rstrip())
    if parts is None:
        raise ValueError(f"result {name} {key!r}: cannot read {spec.strip()!r}; write [note N] [*FACTOR] [FORMAT]")
    value = _entry(name, key, parts[1] == "note")
    if parts[2]:
        numbers = NUMBER.findall(str(value))
        if not 0 < int(parts[2]) <= len(numbers):
            raise ValueError(f"result {name} {key!r}: {value!r} has {len(numbers)} numbers, not {parts[2]}")
        value = float(numbers[int(parts[2]) - 1])
    if parts[3]:
        value = float(value) * float(parts[3])
    if parts[4] == "d":
        value = round(value)
    return format(value, parts[4] or "")


def _entry(name: str, key: str, note: bool) -> Any:
    """Value of an entry of a result file, or the note of a figure."""
    results = _results(name)
    if key.startswith("/"):
        value: Any = results
        for step in key[1:].split("/"):
            try:
                value = value[int(step)] if isinstance(value, list) else value[step.replace("~1", "/")]
            except (KeyError, IndexError, ValueError, TypeError):
                known = ", ".join(value) if isinstance(value, dict) else f"a {type(value).__name__}"
                raise ValueError(f"result {name} {key!r}: no {step!r} among {known}") from None
        return value
    found = [f for f in results["figures"] if f["what"] == key]
    found = found or [f for f in results["figures"] if "*" in key and fnmatchcase(f["what"], key.replace("[", "[[]"))]
    if len(found) != 1:
        names = [f["what"] for f in found] or difflib.get_close_matches(key, [f["what"] for f in results["figures"]])
        raise ValueError(f"result {name} {key!r}: {len(found)} figures; {'; '.join(names)}")
    return found[0]["note" if note else "value"]


@cache
def _results(name: str) -> dict[str, Any]:
    path = RESULTS / f"{name}.json"
    if not path.is_file():
        near = difflib.get_close_matches(name, [p.stem for p in RESULTS.glob("*.json")], 1)
        raise ValueError(f"result {name}: no file {name}.json in benchmarks/results{f'; {near[0]}?' if near else ''}")
    return json.loads(path.read_text())


def _differences(page: Path, text: str) -> Iterator[Stale]:
    for m in MARKED.finditer(text):
        result = quoted(m[2], m[3], m[4])
        if m[5] != result:
            yield Stale(page, text.count("\n", 0, m.start()) + 1, f"{m[2]} {m[3]!r}", m[5], result)
    lines, now = text.splitlines(), updated(text).splitlines()
    if len(lines) != len(now):
        yield Stale(page, 1, "tables", f"{len(lines)} lines", f"{len(now)} lines")
        return
    for n, (line, wanted) in enumerate(zip(lines, now, strict=True), 1):
        if line != wanted and not MARKED.search(line):
            yield Stale(page, n, "table", line, wanted)


@click.command(help="Check the figures that pages quote from benchmarks/results, or write them again.")
@click.option("--write", is_flag=True, help="Write them into the pages.")
def main(write: bool) -> None:
    """Check or write all pages."""
    count = 0
    for page in pages():
        stale = stale_figures(page)
        count += len(stale)
        for figure in stale:
            click.echo(str(figure))
        if write and stale:
            write_text_atomic(page, updated(page.read_text()))
    if count and not write:
        raise SystemExit(f"{count} figures differ from their results; python -m tools.page_figures --write")


if __name__ == "__main__":
    main()
