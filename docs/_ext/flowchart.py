"""A small Mermaid flowchart (`A --> B`) as a picture: boxes in columns, each behind all that lead to it."""

from __future__ import annotations

import re
from graphlib import TopologicalSorter

WIDTH, HEIGHT, ACROSS, DOWN = 108, 30, 150, 54


def svg(mermaid: str) -> str:
    """The flowchart as SVG in the text of a page."""
    arrows = re.findall(r"(\w+) --> (\w+)", mermaid)
    before: dict[str, set[str]] = {}
    for a, b in arrows:
        before.setdefault(a, set())
        before.setdefault(b, set()).add(a)
    column: dict[str, int] = {}
    for name in TopologicalSorter(before).static_order():
        column[name] = max((column[a] + 1 for a in before[name]), default=0)
    rows: dict[int, list[str]] = {}
    for name in before:
        rows.setdefault(column[name], []).append(name)
    most = max(map(len, rows.values()))
    place = {
        name: (8 + ACROSS * k, 8 + DOWN * (i + (most - len(names)) / 2))
        for k, names in rows.items()
        for i, name in enumerate(names)
    }
    width, height = 16 + ACROSS * max(rows) + WIDTH, 16 + DOWN * (most - 1) + HEIGHT
    lines = []
    for a, b in arrows:
        (xa, ya), (xb, yb) = place[a], place[b]
        start, end = (xa + WIDTH, ya + HEIGHT / 2), (xb, yb + HEIGHT / 2)
        middle = (start[0] + end[0]) / 2
        lines.append(
            f'<path d="M{start[0]} {start[1]}C{middle} {start[1]} {middle} {end[1]} {end[0] - 5} {end[1]}" '
            'fill="none" stroke="currentColor" marker-end="url(#tip)"/>'
        )
    for name, (x, y) in place.items():
        lines.append(
            f'<rect x="{x}" y="{y}" width="{WIDTH}" height="{HEIGHT}" rx="5" fill="none" stroke="currentColor"/>'
            f'<text x="{x + WIDTH / 2}" y="{y + HEIGHT / 2 + 5}" text-anchor="middle" font-size="14" '
            f'fill="currentColor">{name}</text>'
        )
    tip = (
        '<defs><marker id="tip" markerWidth="7" markerHeight="7" refX="5" refY="3.5" orient="auto">'
        '<path d="M0 0L7 3.5L0 7Z" fill="currentColor"/></marker></defs>'
    )
    style = f"min-width:{width // 2}px;width:99%"
    head = (
        f'<div style="overflow-x:auto;margin:1.5em 0"><svg role="img" viewBox="0 0 {width} {height}" style="{style}">'
    )
    return f"{head}{tip}{''.join(lines)}</svg></div>\n"
