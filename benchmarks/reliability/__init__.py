"""What no unit test reaches: brokers, browsers, full file systems, clocks, damaged results, signals, killed links.

    python -m benchmarks reliability          # goes on where it was interrupted, from out/reliability
    python -m benchmarks.reliability --small
    python -m benchmarks.reliability --only signals     # and leaves the other rows of its results as they are

Each is drawn from a seed. Beside them stand `mutants`, `journals`, `kills`, `study_kills` and `concurrency`.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass
from pathlib import Path

from benchmarks.measure import RESULTS, Figure, kept, save
from benchmarks.reliability import flights, killed_links, results, signals

SEED = 5204


@dataclass(frozen=True)
class Sizes:
    """How often each is tried.

    payloads : hostile ones of a broker;  disks : that fill up;  moves : of a clock;  results : that are damaged
    kills    : of a link, None for one at each file operation;  signals : at random moments
    """

    payloads: int = 1000
    disks: int = 10
    moves: int = 30
    results: int = 30
    kills: int | None = 60
    signals: int = 210


SMALL = Sizes(payloads=200, disks=2, moves=10, results=6, kills=4, signals=14)


PARTS: dict[str, tuple[Callable[..., Iterable[Figure]], tuple[str, ...]]] = {
    "flights": (flights.figures, ("payloads", "disks", "moves")),
    "results": (results.figures, ("results",)),
    "kills": (killed_links.figures, ("kills",)),
    "signals": (signals.figures, ("signals",)),
}
"""What is run, in its order, and its sizes."""


def run(
    sizes: Sizes | None = None, seed: int = SEED, progress: Callable[[str], None] = print, only: str | None = None
) -> list[Figure]:
    """Run all, or one of PARTS, and save the results; saved rows of the other parts stay as they are then."""
    used = asdict(sizes or Sizes())
    keep = kept(Path("out") / "reliability" / f"seed_{seed}")
    figures = list[Figure]()
    for part in [only] if only else PARTS:
        of_part, names = PARTS[part]
        for figure in of_part(*(used[n] for n in names), seed, keep):
            progress(f"{figure.what}: {figure.value:g} {figure.note}".rstrip())
            figures.append(figure)
    if only is None:
        save("reliability", figures, {"seed": seed, "sizes": used})
        return figures
    saved, new = json.loads((RESULTS / "reliability.json").read_text()), {f.what: f for f in figures}
    rows = [Figure(**{k: v for k, v in row.items() if k != "verdict"}) for row in saved["figures"]]
    changed = {n: used[n] for n in PARTS[only][1]}
    save("reliability", [new.get(f.what, f) for f in rows], {"seed": seed, "sizes": saved["sizes"] | changed})
    return figures
