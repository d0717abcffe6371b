"""A bad link: loss, lateness, doubled samples, a clock that jumps, damaged packets, a process that is killed."""

from __future__ import annotations

import json
import math
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from scipy.stats import binom

from benchmarks.measure import Figure
from sim_heating.base.arrays import FloatArray
from sim_heating.inputs.record import write_record
from sim_heating.live.engine import LinkEngine
from sim_heating.live.filtering.estimator import LiveEstimator
from sim_heating.live.filtering.timeline import Counts
from sim_heating.live.recording.journal import NAME
from sim_heating.live.sources.decoder import message_of
from sim_heating.live.sources.json_lines import JsonDecoder
from sim_heating.live.sources.replay import lines
from sim_heating.live.spec import make_link
from sim_heating.live.state import plain
from sim_heating.live.types import Frame
from tests.support.live_streams import PRIORS, SIX, BadLink, Flight, Progress, cut, known_flight, practice

TOGETHER = 16
"""Replays of one link, each a control point with a truth and a noise of its own."""
JUMP_AT_S, END_S, RECORD = 860.0, 958.0, "p07"
"""The clock jumps within the first manoeuvre; the flight ends with the second."""
LINKS = {
    "loss, lateness, doubled": BadLink(),
    "and a clock that jumps 3 s ahead": BadLink(jump_s=3.0, jump_at_s=JUMP_AT_S),
    "and a clock that jumps 3 s back": BadLink(jump_s=-3.0, jump_at_s=JUMP_AT_S),
}
TWO_SIDED_95 = 1.959964
WITHIN = 0.02
"""Coverage may be off by so much, or by what so many replays cannot tell [-]."""
SEED = 25


# Coverage ------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Replayed:
    """A link of TOGETHER replays at its end.

    error, sigma : (point, parameter) estimate less truth, and the standard deviation that was reported
    """

    error: FloatArray
    sigma: FloatArray
    counts: Counts
    lost: int
    messages: list[str]

    @property
    def tells_jump(self) -> bool:
        """Whether a message tells of the jump of the sender's clock."""
        spans = [re.search(r"from ([\d.]+) to ([\d.]+) s", m) for m in self.messages]
        times = [sorted(float(t) for t in span.groups()) for span in spans if span is not None]
        return any(begin <= JUMP_AT_S <= end for begin, end in times)

    @property
    def is_finite(self) -> bool:
        """Whether all that it told is a number."""
        return bool(np.all(np.isfinite(self.error)) and np.all(np.isfinite(self.sigma)) and np.all(self.sigma > 0.0))


def replayed(link: BadLink, number: int, end_s: float = END_S, count: int = TOGETHER) -> Replayed:
    """Replay a flight of known truth over a bad link; number : of the draw."""
    rng = np.random.default_rng((SEED, number))
    flight = known_flight(RECORD, count, end_s, 1.0, rng)
    return over(link, flight, rng)


def over(link: BadLink, flight: Flight, rng: np.random.Generator) -> Replayed:
    """A flight of known truth over a bad link."""
    e = LiveEstimator(flight.source, SIX, PRIORS)
    arriving = link.arrive(flight.samples, rng)
    for sample in arriving:
        e.add(sample)
        if isinstance(sample, Frame):
            e.advance()
    e.advance()
    found = [x.parameters for x in e.estimates().values()]
    value, sigma = (np.array([[p[n][i] for n in SIX] for p in found]) for i in (0, 1))
    places = {(s.time_s, getattr(s, "point", ""), getattr(s, "sensor", "")) for s in arriving}
    return Replayed(value - flight.truth, sigma, e.counts, len(flight.samples) - len(places), list(e.messages))


def coverage(rows: Sequence[Replayed], how: str, *, jumped: bool = False) -> list[Figure]:
    """Coverage of the 95 % bounds by parameter with its binomial limits, and what was told of the link."""
    error, sigma = (np.concatenate([getattr(r, name) for r in rows]) for name in ("error", "sigma"))
    n = len(error)
    low, high = (float(limit) / n for limit in binom.interval(0.99, n, 0.95))
    allowed = max(WITHIN, 0.95 - low)
    inside = np.mean(np.abs(error) < TWO_SIDED_95 * sigma, axis=0)
    rms = np.sqrt(np.mean((error / sigma) ** 2, axis=0))
    figures = [
        Figure(f"{how}: {name}, |coverage of 95 % bounds - 0.95|", abs(part - 0.95), "", round(allowed, 4),
               note=f"{part:.3f} of {n} replays, 99 % limits {low:.3f} to {high:.3f}; error over sigma {ratio:.2f} rms")
        for name, part, ratio in zip(SIX, inside.tolist(), rms.tolist(), strict=True)
    ]  # fmt: skip
    figures.append(Figure(f"{how}: least coverage of all parameters", float(np.min(inside)), "", note=f"{n} replays"))
    used = rows[0].counts
    figures.append(
        Figure(f"{how}: links that end with a value that is no number", sum(not r.is_finite for r in rows), "", 0.0,
               note=f"{len(rows)} links; the first: {rows[0].lost} samples lost, {used.late} late, "
               f"{used.doubled} doubled, {used.too_late} too late, {used.jumps} jumps")
    )  # fmt: skip
    if jumped:
        untold = sum(not r.tells_jump for r in rows)
        figures.append(Figure(f"{how}: links that do not tell the jump", untold, "", 0.0, note=f"of {len(rows)}"))
    return figures


def all_coverage(replays: int, progress: Progress) -> list[Figure]:
    """Rows of the table for all links; replays : of each."""
    figures = []
    for which, (how, link) in enumerate(LINKS.items()):
        rows = []
        for k in range(max(1, round(replays / TOGETHER))):
            rows.append(replayed(link, 1000 * which + k))
            progress(f"{how}: {TOGETHER * (k + 1)} of {replays} replays")
        figures += coverage(rows, how, jumped=link.jump_s != 0.0)
    return figures


# Damaged packets -----------------------------------------------------------------------------------------------------


def damaged(body: bytes, rng: np.random.Generator) -> bytes:
    """A packet that is damaged so that it can be reported: what is left of it says nothing that was not sent."""
    kind = int(rng.integers(0, 9))
    at = int(rng.integers(1, len(body) - 1))
    own: dict[str, Any] = json.loads(body)
    named = str(rng.choice([n for n in own if n != "time_s"]))
    return (
        body[:at],
        body[at:],
        bytes(rng.integers(128, 256, len(body)).astype(np.uint8)),
        bytes(len(body)),
        b"[" + body + b"]",
        json.dumps({**own, "time_s": None}).encode(),
        json.dumps({**own, "time_s": "noon"}).encode(),
        json.dumps({**own, named: "high"}).encode(),
        body.replace(b"}", b',"' + named.encode() + b'":1e999}'),
    )[kind]


def damaged_packets(packets: int, flight_s: tuple[float, float] = (0.0, 400.0)) -> dict[str, int]:
    """Damaged packets among the good ones of a flight: what became of them.

    returns : number of packets, of those that no count tells of, of crashes, and whether the final state differs from
              that of the good packets alone
    """
    record = cut(practice("p06"), flight_s[1])
    rng = np.random.default_rng((SEED, packets))
    with TemporaryDirectory() as folder:
        write_record(record, Path(folder) / "p06")
        data = {"format": "link/1", "records": ["p06"], "source": [{"kind": "replay", "speed": 0.0}]}
        link = make_link(data, Path(folder) / "link.toml")
    good = [body for _, body in lines([record])]
    each = math.ceil(packets / len(good))
    clean, engine = LinkEngine(link), LinkEngine(link)
    sent, crashes, silent = 0, 0, 0
    for body in good:
        _give(clean, body)
        _give(engine, body)
        for _ in range(min(each, packets - sent)):
            sent, before = sent + 1, _told(engine)
            try:
                _give(engine, damaged(body, rng))
            except Exception:
                crashes += 1
            silent += _told(engine) == before
    for e in (clean, engine):
        e.end()
    a, b = (json.dumps(plain(e.state().points)) for e in (clean, engine))
    return {"packets": sent, "silent": silent, "crashes": crashes, "differ": int(a != b)}


def _told(engine: LinkEngine) -> int:
    """What a link has counted as damaged, lost or doubled."""
    own, state = engine.counts, engine.estimator.counts
    return own["damaged"] + own["lost"] + state.lost + state.doubled


def _give(engine: LinkEngine, body: bytes) -> None:
    message = message_of(JsonDecoder(), body, time.monotonic())
    if message is not None:
        engine.give(message)
    engine.advance()


# Killed --------------------------------------------------------------------------------------------------------------


def killed(times: int, until_s: float = 300.0) -> dict[str, int]:
    """A replay whose process is killed and started again: kills, and final states that differ from one left alone."""
    with TemporaryDirectory() as folder:
        place = Path(folder)
        write_record(cut(practice("p06"), until_s), place / "p06")
        straight = _run_link(place, "straight", 0.0)
        kills = 0
        for k in range(times):
            running = _started(place, "killed", 40.0)
            kills += _kill_after(running, place / "killed" / NAME, 2000 * (k + 1))
        again = _run_link(place, "killed", 0.0)
    return {"kills": kills, "differ": int(straight != again)}


def _started(place: Path, out: str, speed: float) -> subprocess.Popen[bytes]:
    replay = ["--replay", str(place / "p06"), "--speed", str(speed), "--headless", "--out", str(place / out)]
    command = [sys.executable, "-m", "sim_heating", "live", *replay]
    return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, env=dict(os.environ))


def _run_link(place: Path, out: str, speed: float) -> str:
    """Points of the last state of a link that runs to its end."""
    running = _started(place, out, speed)
    _, problem = running.communicate()
    if running.returncode:
        raise RuntimeError(problem.decode())
    return json.dumps(json.loads((place / out / "live.json").read_text())["state"]["points"])


def _kill_after(running: subprocess.Popen[bytes], journal: Path, size: int) -> int:
    """Kill a link once its journal has grown by a number of bytes; whether it was still running."""
    begun = journal.stat().st_size if journal.exists() else 0
    while running.poll() is None:
        if journal.exists() and journal.stat().st_size > begun + size:
            running.send_signal(signal.SIGKILL)
            running.communicate()
            return 1
        time.sleep(0.02)
    running.communicate()
    return 0


def bad_links(replays: int, packets: int, kills: int, progress: Progress) -> list[Figure]:
    """Rows of the table."""
    figures = all_coverage(replays, progress)
    found = damaged_packets(packets)
    progress(f"{packets} damaged packets")
    figures += [
        Figure("damaged packets: crashes", found["crashes"], "", 0.0, note=f"{found['packets']} packets"),
        Figure("damaged packets: those that no count tells of", found["silent"], "", 0.0),
        Figure("damaged packets: final states that differ from that without them", found["differ"], "", 0.0),
    ]
    told = killed(kills)
    return [
        *figures,
        Figure("killed and started again: final states that differ from that of a link left alone", told["differ"], "",
               0.0, note=f"{told['kills']} kills of one link"),
    ]  # fmt: skip
