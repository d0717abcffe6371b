"""Tables of docs/reliability.md from the results of the benchmarks: `python -m benchmarks.reliability`.

A table stands between `<!-- results of NAME -->` and `<!-- end -->`. Where results/NAME.json does not exist, the page
says which command makes it.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from typing import Any

from benchmarks.measure import RESULTS

PAGE = RESULTS.parents[1] / "docs" / "reliability.md"
MARKED = re.compile(r"(<!-- results of ([\w, ]+) -->\n).*?(<!-- end -->)", re.DOTALL)
GOOD = ("accepted", "refused", "failed")


def main() -> None:
    """Rewrite the page."""
    PAGE.write_text(MARKED.sub(_block, PAGE.read_text()))


def _block(found: re.Match[str]) -> str:
    name, _, part = found[2].partition(", ")
    path = RESULTS / f"{name}.json"
    if not path.is_file():
        return f"{found[1]}Not run yet: `python -m benchmarks {name}`.\n{found[3]}"
    results = json.loads(path.read_text())
    text = {"formats": by_format, "slips": slips, "faults": faults, "commands": kills, "pairs": pairs}.get(
        part, figures
    )(results)
    return f"{found[1]}{text}{found[3]}"


def figures(results: Mapping[str, Any]) -> str:
    """The figures of any benchmark."""
    rows = [
        (f["what"], f"{f['value']:.6g} {f['unit']}".strip(), _bound(f), f["verdict"].lower())
        for f in results["figures"]
    ]
    return _table(("what", "found", "to be", "met"), rows)


def _bound(figure: Mapping[str, Any]) -> str:
    if figure["target"] is None:
        return ""
    return f"{'at least' if figure['at_least'] else 'at most'} {figure['target']:g}"


def by_format(results: Mapping[str, Any]) -> str:
    """Mutants by format and outcome."""
    rows = []
    for name, count in results["formats"].items():
        fault = sum(n for outcome, n in count.items() if outcome not in GOOD)
        rows.append((name, sum(count.values()), *(count.get(outcome, 0) for outcome in GOOD), fault))
    total = ("all", *(sum(row[i] for row in rows) for i in range(1, 6)))
    return _table(("format", "mutants", *GOOD, "faults"), [*rows, total])


def slips(results: Mapping[str, Any]) -> str:
    """Unit slips that were accepted, by quantity: times accepted of times tried, for each factor."""
    factors = ("1e-06", "0.001", "1000", "1e+06")
    rows = [
        (name, *("/".join(map(str, row[f])) if f in row else "" for f in factors))
        for name, row in results["accepted_scaled"].items()
    ]
    return _table(("format: quantity", *(f"x {f}" for f in factors)), rows)


def faults(results: Mapping[str, Any]) -> str:
    """Every fault."""
    rows = [(r["number"], r["file"], r["what"][:60], r["outcome"], r["message"][-120:]) for r in results["faults"]]
    return _table(("number", "file", "damage", "fault", "message"), rows) if rows else "None.\n"


def kills(results: Mapping[str, Any]) -> str:
    """Kills of each command, what a reader found after them, and what the same command left when it ran again."""
    columns = ("kills", "readers find: before", "readers find: after", "readers find: mixed", "again: same",
               "again: differs or refused")  # fmt: skip
    rows = [(name, *(row.get(c, 0) for c in columns)) for name, row in results["commands"].items()]
    return _table(("command", *columns), rows)


def pairs(results: Mapping[str, Any]) -> str:
    """How often two commands at once ended in which way."""
    ways = sorted({how for row in results["pairs"].values() for how in row})
    rows = [(name, *(row.get(how, 0) for how in ways)) for name, row in results["pairs"].items()]
    return _table(("pair", *ways), rows)


def _table(head: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    cells = [[str(c).replace("|", "\\|").replace("\n", " ").replace("<", "&lt;") for c in row] for row in (head, *rows)]
    lines = ["| " + " | ".join(row) + " |" for row in cells]
    return "\n".join([lines[0], "|" + "---|" * len(head), *lines[1:]]) + "\n"


if __name__ == "__main__":
    main()
