"""The boundaries of a study on two revisions of a vehicle side by side: what flight data opened or closed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from sim_heating.page import Table
from sim_heating.planning import envelope_files as files
from sim_heating.planning.boundary import END_OF_STUDY
from sim_heating.planning.envelope import MIDDLE, SURE, FlownBoundary
from sim_heating.planning.study import Study

HEADS = ("boundary", "allowed", "before", "after", "opened", "limits before", "limits after")


@dataclass(frozen=True)
class Side:
    """A study with its boundaries."""

    study: Study
    boundaries: Sequence[FlownBoundary]


def compare(before: Side, after: Side) -> tuple[Table, dict[str, Any]]:
    """Areas of what is allowed before and after, as a table and for study.json."""
    rows = [row for pair in zip(before.boundaries, after.boundaries, strict=True) for row in _rows(*pair)]
    caption = f"Area allowed before ({files.revision_of(before.study)}) and after ({files.revision_of(after.study)})"
    data = {b.declared.name: files.boundary_data(b) for b in before.boundaries}
    return Table(HEADS, rows, caption), {"study": before.study.hash, **data}


def _rows(before: FlownBoundary, after: FlownBoundary) -> list[tuple[str, ...]]:
    """A boundary as the tables stand, and with them so many sigma hotter."""
    rows = []
    for which, said in ((MIDDLE, "as the tables stand"), (SURE, "surely")):
        a, b = before.area(which), after.area(which)
        change = f"{b - a:+.3g}" if a == 0.0 else f"{b - a:+.3g} ({100.0 * (b / a - 1.0):+.0f} %)"
        limits = [_limits(x, which) for x in (before, after)]
        rows.append((after.declared.name, said, f"{a:.4g}", f"{b:.4g}", change, *limits))
    return rows


def _limits(boundary: FlownBoundary, which: str) -> str:
    named = {n.removeprefix(files.CLOSED) for s in boundary.stretches for n in files.limits_of(s, which)}
    return ", ".join(sorted(named - {"", END_OF_STUDY}))
