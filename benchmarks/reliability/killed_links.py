"""A link whose messages come from a file, killed at its file operations: nothing is lost, and it is gone on with.

As `kills` has it, but what a reader finds in between is a journal: the first messages, in their order. The same command
goes on from it, where the results are not there yet, and leaves the journal and the results of a link that nothing
disturbed.
"""

from __future__ import annotations

import random
from pathlib import Path
from tempfile import TemporaryDirectory

from benchmarks.journals import POINT, message, missing, wrong_units
from benchmarks.measure import Figure, Keep
from benchmarks.mutants.subjects import LINES
from sim_heating.base.errors import InputError
from sim_heating.base.files import results_digest, settle
from sim_heating.cli import main
from sim_heating.live.recording.journal import NAME, read_journal
from sim_heating.live.results.files import RESULT
from tests.support.kills import killed, operations

MESSAGES = 60
LINK = LINES.format(vehicle="orbiter", point=POINT)


def killed_links(kills: int | None, seed: int) -> dict[str, int]:
    """Kills of links at their file operations, each of a new link.

    kills   : at random operations; None for one at each
    returns : kills; links of which a reader found anything but the first messages, that could not be gone on with, that
              lost or doubled a message, whose readings have a wrong unit, or whose results are not whole
    """
    sent = [message(k) for k in range(MESSAGES)]
    tally = dict.fromkeys(("kills", "mixed", "not gone on with", "lost", "wrong units", "not whole"), 0)
    with TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "link.toml").write_text(LINK)
        (folder / "flight.jsonl").write_bytes(b"".join(line + b"\n" for line in sent))

        def follow(out: Path) -> None:
            assert main(["live", str(folder / "link.toml"), "--headless", "--out", str(out), "--quiet"]) == 0

        follow(folder / "first")  # with kernels loaded, the children do not load them again
        found = len(operations(lambda: follow(folder / "whole"), folder / "whole"))
        rng = random.Random(seed)
        numbers = range(found) if kills is None else sorted(rng.sample(range(found), min(kills, found)))
        for number in numbers:
            out = folder / f"{number}"
            tally["kills"] += killed(lambda: follow(out), out, number)  # noqa: B023
            tally["mixed"] += _bodies(out) != sent[: len(_bodies(out))]
            settle(out)  # as the next command does: results that were whole under another name are put in place
            if not (out / RESULT).is_file():
                try:
                    operations(lambda: follow(out), out)  # noqa: B023
                except RuntimeError:
                    tally["not gone on with"] += 1
                    continue
            bodies = _bodies(out)
            tally["lost"] += missing(sent, bodies) + missing(bodies, sent)
            tally["wrong units"] += wrong_units(out / "records")
            tally["not whole"] += results_digest(out) is None
    return tally


def _bodies(out: Path) -> list[bytes]:
    try:
        return [entry.body for entry in read_journal(out)] if (out / NAME).is_file() else []
    except InputError:  # nothing of it is written yet
        return []


def figures(kills: int | None, seed: int, keep: Keep) -> list[Figure]:
    """Killed links, and what went wrong."""
    counted = keep(f"killed links, {kills}", lambda: killed_links(kills, seed))
    note = ", ".join(f"{n} {what}" for what, n in counted.items() if what != "kills")
    return [
        Figure("kills of a link at its file operations", counted["kills"], ""),
        Figure("of these: anything lost, mixed or not gone on with", sum(counted.values()) - counted["kills"], "", 0.0,
               note=note),
    ]  # fmt: skip
