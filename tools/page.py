"""Tables of results in pages of docs, between `<!-- results of NAME -->` and `<!-- end -->`."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence

from benchmarks.measure import RESULTS

DOCS = RESULTS.parents[1] / "docs"
MARKED = re.compile(r"(<!-- results of ([\w, ]+) -->\n).*?(<!-- end -->)", re.DOTALL)


def filled(text: str, text_of: Callable[[str], str | None]) -> str:
    """Text of a page with each marked part replaced by the text that belongs to its name, where that is not None."""

    def replaced(found: re.Match[str]) -> str:
        new = text_of(found[2])
        return found[0] if new is None else f"{found[1]}{new}{found[3]}"

    return MARKED.sub(replaced, text)


def markdown_table(head: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """A table of a page; cells are escaped."""
    cells = [[str(c).replace("|", "\\|").replace("\n", " ").replace("<", "&lt;") for c in row] for row in (head, *rows)]
    lines = ["| " + " | ".join(row) + " |" for row in cells]
    return "\n".join([lines[0], "|" + "---|" * len(head), *lines[1:]]) + "\n"
