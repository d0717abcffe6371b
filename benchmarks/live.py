"""A link to a flight: speed, sameness with the batch filter and `estimate`, bad links, false alarms.

    python -m benchmarks.live                  # 1000 replays of each bad link, 100 null flights: about an hour
    python -m benchmarks.live --small          # the sizes of a few minutes
    python -m benchmarks.live --part speed     # one part; the others keep the figures that they have

Each part may be run by itself. The result tells the sizes of each, and how busy the machine was.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from dataclasses import asdict, dataclass

import click

from benchmarks.live_alarms import alarms
from benchmarks.live_bad import bad_links
from benchmarks.live_exact import exactness
from benchmarks.live_speed import speed
from benchmarks.measure import RESULTS, Figure, save, table
from tests.support.live_streams import Progress


@dataclass(frozen=True)
class Sizes:
    """Sizes of a run.

    flight_s : of the stream that is timed [s];  orders : other orders of the samples
    replays  : of each bad link;  packets : damaged ones;  kills : of one link;  nulls : flights without an effect
    """

    flight_s: float = 120.0
    orders: int = 8
    replays: int = 1000
    packets: int = 10_000
    kills: int = 5
    nulls: int = 100


SMALL = Sizes(flight_s=20.0, orders=2, replays=32, packets=10_000, kills=2, nulls=12)
Part = tuple[list[Figure], dict[str, object]]


def _speed(sizes: Sizes, progress: Progress) -> Part:
    progress(f"{sizes.flight_s:.0f} s of flight at 60 Hz")
    return speed(sizes.flight_s), {}


def _exact(sizes: Sizes, progress: Progress) -> Part:
    progress("the batch filter, other orders, estimates")
    figures, rows = exactness(sizes.orders)
    return figures, {"against_estimate": [asdict(row) for row in rows]}


def _bad(sizes: Sizes, progress: Progress) -> Part:
    return bad_links(sizes.replays, sizes.packets, sizes.kills, progress), {}


def _alarms(sizes: Sizes, progress: Progress) -> Part:
    return alarms(sizes.nulls, progress)


PARTS: dict[str, Callable[[Sizes, Progress], Part]] = {
    "speed": _speed,
    "exact": _exact,
    "bad links": _bad,
    "alarms": _alarms,
}


def run(sizes: Sizes | None = None, parts: tuple[str, ...] = tuple(PARTS), progress: Progress = print) -> list[Figure]:
    """Run parts and save them with the kept figures of the others."""
    used, kept = sizes or Sizes(), _kept()
    for name in parts:
        load = os.getloadavg()[0]
        figures, more = PARTS[name](used, progress)
        about = {"sizes": asdict(used), "processes_running_before": round(load, 1), **more}
        kept[name] = Kept(figures, about)
        _save(kept)
    return [f for name in parts for f in kept[name].figures]


@dataclass(frozen=True)
class Kept:
    """A part of the result: its figures, and what it was found with."""

    figures: list[Figure]
    about: dict[str, object]


def _save(kept: dict[str, Kept]) -> None:
    known = {name: kept[name] for name in PARTS if name in kept}
    more = {name: {"count": len(part.figures), **part.about} for name, part in known.items()}
    save("live", [f for part in known.values() for f in part.figures], {"parts": more})


def _kept() -> dict[str, Kept]:
    """Parts of the result that is there."""
    path = RESULTS / "live.json"
    if not path.exists():
        return {}
    content = json.loads(path.read_text())
    figures = [Figure(**{k: v for k, v in f.items() if k != "verdict"}) for f in content["figures"]]
    found = {}
    for name, about in content["parts"].items():
        count = about.pop("count")
        found[name] = Kept(figures[:count], about)
        figures = figures[count:]
    return found


@click.command(help=(__doc__ or "").partition("\n")[0])
@click.option("--part", "parts", multiple=True, type=click.Choice(list(PARTS)), help="part to run; all by default")
@click.option("--small", is_flag=True, help="sizes of a few minutes")
@click.option("--replays", type=click.IntRange(1), help="replays of each bad link; 1000 by default")
@click.option("--nulls", type=click.IntRange(1), help="flights without an effect; 100 by default")
def main(parts: tuple[str, ...], small: bool, replays: int | None, nulls: int | None) -> None:
    """Run and print."""
    given = {k: v for k, v in {"replays": replays, "nulls": nulls}.items() if v is not None}
    sizes = Sizes(**{**asdict(SMALL if small else Sizes()), **given})
    click.echo(table(run(sizes, parts or tuple(PARTS), click.echo)))


if __name__ == "__main__":
    main()
