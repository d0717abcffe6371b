"""Tables of docs/evidence/reliability.md from the results of the benchmarks, written by `tools.page_figures`.

A table stands between `<!-- results of NAME -->` and `<!-- end -->`. Where results/NAME.json does not exist, the page
says which command makes it.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from benchmarks.measure import RESULTS
from tools.page import markdown_table

NAMES = ("mutants", "unit_slips", "kills", "concurrency", "journals", "reliability")
"""Benchmarks that have tables here."""
GOOD = ("accepted", "told", "refused", "failed")


def table_of(marked: str) -> str | None:
    """The table of a marked part of a page: `NAME`, or `NAME, PART`; None for a benchmark without tables here."""
    name, _, part = marked.partition(", ")
    if name not in NAMES:
        return None
    path = RESULTS / f"{name}.json"
    if not path.is_file():
        return f"Not run yet: `python -m benchmarks {name}`.\n"
    results = json.loads(path.read_text())
    by_part = {"formats": by_format, "quantities": slips, "faults": faults, "factors": factors}
    by_part |= {"goals": goals, "pairs": pairs}
    return by_part.get(part, figures)(results)


def figures(results: Mapping[str, Any]) -> str:
    """The figures of any benchmark."""
    rows = [(f["what"], f"{f['value']:.6g} {f['unit']}".strip(), _bound(f)) for f in results["figures"]]
    return markdown_table(("what", "found", "goal"), rows)


def factors(results: Mapping[str, Any]) -> str:
    """The figures of slips, and in a sentence those of each factor."""
    of_factors = [f for f in results["figures"] if f["what"].startswith("of ")]
    rest = [f for f in results["figures"] if f not in of_factors]
    shares = ", ".join(f"{f['what'].removeprefix('of ')}: {f['value']:.0f} %" for f in of_factors)
    return f"{figures({'figures': rest})}\nRefused or told by factor: {shares}.\n"


def _bound(figure: Mapping[str, Any]) -> str:
    if figure["target"] is None:
        return ""
    missed = "" if figure["verdict"] == "yes" else ", missed"
    return f"{'at least' if figure['at_least'] else 'at most'} {figure['target']:g}{missed}"


def by_format(results: Mapping[str, Any]) -> str:
    """Mutants by format and outcome."""
    rows = []
    for name, count in results["formats"].items():
        fault = sum(n for outcome, n in count.items() if outcome not in GOOD)
        rows.append((name, sum(count.values()), *(count.get(outcome, 0) for outcome in GOOD), fault))
    total = ("all", *(sum(row[i] for row in rows) for i in range(1, 7)))
    return markdown_table(("format", "mutants", *GOOD, "faults"), [*rows, total])


def slips(results: Mapping[str, Any]) -> str:
    """Slips of the unit that were accepted without a word, by quantity, with the reason."""
    by_reason: dict[str, list[str]] = {}
    for name, row in results["by_quantity"].items():
        count = "" if row["accepted"] == 1 else f" {row['accepted']}/{row['tried']}"
        by_reason.setdefault(row["reason"], []).append(f"`{name}`{count}")
    return "".join(f"- {reason}: {', '.join(names)}\n" for reason, names in by_reason.items())


def faults(results: Mapping[str, Any]) -> str:
    """Every fault."""
    rows = [(r["number"], r["file"], r["what"][:60], r["outcome"], r["message"][-120:]) for r in results["faults"]]
    return markdown_table(("number", "file", "damage", "fault", "message"), rows) if rows else "None.\n"


def pairs(results: Mapping[str, Any]) -> str:
    """How often each thing was tried, and how many faults there were: figures that follow each other."""
    tried, found = results["figures"][::2], results["figures"][1::2]
    rows = [(t["what"], f"{t['value']:g}", f"{f['value']:g}") for t, f in zip(tried, found, strict=True)]
    return markdown_table(("what", "tried", "faults"), rows)


def goals(results: Mapping[str, Any]) -> str:
    """How many figures have a goal, and those that miss it."""
    stated = [f for f in results["figures"] if f["target"] is not None]
    missed = [(f["what"], f"{f['value']:g}", f"{f['target']:g}") for f in stated if f["verdict"] != "yes"]
    return markdown_table(("figure", "found", "goal"), [("figures with a goal", str(len(stated)), ""), *missed])
