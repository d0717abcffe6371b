"""What no unit test reaches: brokers, browsers, full file systems, clocks, damaged results, signals, killed links.

    python -m benchmarks reliability          # goes on where it was interrupted, from out/reliability
    python -m benchmarks.reliability --small

Each is drawn from a seed. Beside them stand `mutants`, `journals`, `kills`, `study_kills` and `concurrency`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

from benchmarks.measure import Figure, Keep, kept, save
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


def run(sizes: Sizes | None = None, seed: int = SEED, progress: Callable[[str], None] = print) -> list[Figure]:
    """Run all and save the results."""
    used = sizes or Sizes()
    keep = kept(Path("out") / "reliability" / f"seed_{seed}")
    figures = list[Figure]()
    for figure in _figures(used, seed, keep):
        progress(f"{figure.what}: {figure.value:g} {figure.note}".rstrip())
        figures.append(figure)
    save("reliability", figures, {"seed": seed, "sizes": asdict(used)})
    return figures


def _figures(sizes: Sizes, seed: int, keep: Keep) -> Iterator[Figure]:
    yield from flights.figures(sizes.payloads, sizes.disks, sizes.moves, seed, keep)
    yield from results.figures(sizes.results, seed, keep)
    yield from killed_links.figures(sizes.kills, seed, keep)
    yield from signals.figures(sizes.signals, seed, keep)
