"""Live flights in bad surroundings: a broker of hostile payloads, a browser, a full file system, a clock that is set.

Each is a link in a process of its own, as `journals` has it. What must hold: every message is in the journal as it was
sent and in its order, nothing else is, every frame is followed, no reading has a wrong unit, nothing runs in the page,
nobody sees a traceback, and the process ends with 0.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import signal
import socket
import subprocess
import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from benchmarks.journals import POINT, Running, free_port, hostile, message, missing, reading_K, wrong_units
from benchmarks.measure import Figure, Keep
from sim_heating.inputs.record import load_record
from sim_heating.live.recording.journal import read_journal
from tests.support.chromium import CHROMIUM, Browser
from tests.support.served import Loop

# A broker ------------------------------------------------------------------------------------------------------------

MQTT = 'kind = "mqtt"\ntopics = ["flight/#"]\n'
TOPICS = ("flight/state", "flight", "flight/<script>x</script>", "flight/\u00e9\u4e2d\U0001f680", "flight/\u202eabc",
          "flight/" + 60 * "deep/", "flight/" + "x" * 2000, "flight/%s{0}", "flight/time_s", "flight/tc")  # fmt: skip
HELLO = "flight/hello"
PATIENCE_S = 120.0
"""Time within which a broker answers, and a journal holds what was sent [s]; a machine with other work is slow."""
PAGE_TEXTS = (
    "<script>document.documentElement.dataset.ran=1</script>",
    "\"><img src=x onerror='document.documentElement.dataset.ran=1'>",
    "</title></style></script><script>document.documentElement.dataset.ran=1</script>",
    "javascript:document.documentElement.dataset.ran=1",
    "<iframe srcdoc='<script>parent.document.documentElement.dataset.ran=1</script>'></iframe>",
    "<svg/onload=document.documentElement.dataset.ran=1>",
)
"""Texts that leave a mark in a page that does not escape them."""


@contextlib.contextmanager
def broker(port: int) -> Iterator[Loop]:
    """A real broker (amqtt) at a port, in a loop of its own, that anyone may use."""
    from amqtt.broker import Broker

    config = {
        "listeners": {"default": {"type": "tcp", "bind": f"127.0.0.1:{port}"}},
        "plugins": {"amqtt.plugins.authentication.AnonymousAuthPlugin": {"allow_anonymous": True}},
    }
    with Loop() as loop:

        async def begin() -> Any:
            made = Broker(config)
            await made.start()
            return made

        running = loop.run(begin())
        try:
            yield loop
        finally:
            loop.run(running.shutdown())


def payload(number: int, rng: np.random.Generator) -> tuple[str, bytes]:
    """A topic and a payload that are no message of the flight."""
    kind, topic = int(rng.integers(0, 6)), TOPICS[int(rng.integers(0, len(TOPICS)))]
    text = PAGE_TEXTS[int(rng.integers(0, len(PAGE_TEXTS)))]
    return topic, (
        hostile(number, rng),
        b"",
        b"\0" * int(rng.integers(1, 200)),
        b"{" + rng.integers(0, 256, int(rng.integers(1, 100_000)), np.uint8).tobytes(),
        json.dumps({"time_s": text, text: text, "tc": text}).encode(),
        text.encode(),
    )[kind]


async def _publish(port: int, sent: Sequence[tuple[str, bytes]]) -> None:
    import aiomqtt

    async with aiomqtt.Client("127.0.0.1", port, timeout=PATIENCE_S) as client:
        for topic, body in sent:
            await client.publish(topic, body, qos=1)


def hostile_topics(payloads: int, seed: int) -> dict[str, int]:
    """A flight by way of a broker, with hostile payloads and topics between its messages, and its page in a browser."""
    rng = np.random.default_rng((seed, payloads))
    good = max(payloads // 10, 100)
    with TemporaryDirectory() as folder, broker(port := free_port()):
        page = free_port()
        options = ["--port", str(page)] if CHROMIUM else ["--headless"]
        running = Running(Path(folder), port, source=MQTT, options=options)
        with contextlib.ExitStack() as shown:
            is_heard = _heard(running, port)
            sent = list[tuple[str, bytes]]()
            browsed = None
            if CHROMIUM:
                _listens(running, page)
                browsed = shown.enter_context(Browser()).open(f"http://127.0.0.1:{page}/")
            for k in range(good):
                part = [("flight/state", message(k)), *(payload(k, rng) for _ in range(max(payloads // good, 1)))]
                sent += part
                asyncio.run(_publish(port, part))
            running.holds(len(sent) + is_heard, PATIENCE_S)
            ran, complaints = 0, list[str]()
            if browsed is not None:
                drawn = "Number(document.documentElement.dataset.drawn || -1)"
                until_s = time.monotonic() + PATIENCE_S  # a machine with other work draws late
                while float(browsed.evaluate(drawn)) < 0 and time.monotonic() < until_s:
                    time.sleep(0.5)
                time.sleep(1.0)
                ran = int(browsed.evaluate("document.documentElement.dataset.ran") is not None)
                complaints = [
                    *browsed.complaints(),
                    *([] if float(browsed.evaluate(drawn)) >= 0 else ["nothing was drawn"]),
                ]
        status, told = running.ended(signal.SIGINT)
        bodies = [topic.encode() + b"\0" + body for topic, body in sent]
        found = [entry.body for entry in read_journal(running.out)][is_heard:]
        counts = json.loads((running.out / "live.json").read_text())["counts"] if status == 0 else {}
        return {
            "payloads": len(sent) - good,
            "lost": missing(bodies, found),
            "never sent": missing(found, bodies),
            "not followed": good - int(counts.get("frames", 0)),
            "wrong units": wrong_units(running.out / "records") if status == 0 else good,
            "tracebacks": int("Traceback" in told),
            "scripts that ran": ran,
            "complaints of the browser": len(complaints),
            "status": status,
        }


def _heard(running: Running, port: int) -> int:
    """Publish until the link has subscribed, however long its kernels take to load; how many messages it then holds.

    raises : RuntimeError where the link ends before
    """
    while running.process.poll() is None and not running.holds(1, 0.2):
        asyncio.run(_publish(port, [(HELLO, b"1")]))
    asyncio.run(_publish(port, [(HELLO, b"last")]))  # all before are in the journal when this one is
    while running.process.poll() is None:
        bodies = [entry.body for entry in read_journal(running.out)]
        if bodies[-1].endswith(b"last"):
            return len(bodies)
        time.sleep(0.1)
    raise RuntimeError(f"the link ends before the flight: {running.ended()[1]}")


def _listens(running: Running, port: int) -> None:
    """Wait until a link serves its page."""
    while running.process.poll() is None:
        with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", port), 1.0):
            return
        time.sleep(0.1)


# A full file system --------------------------------------------------------------------------------------------------

TMPFS_KIB = 1024


@contextlib.contextmanager
def small_disk(folder: Path) -> Iterator[Path | None]:
    """A file system of TMPFS_KIB in memory; None where this user may not mount one."""
    folder.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", f"size={TMPFS_KIB}k", "tmpfs", str(folder)]
    if subprocess.run(mount, capture_output=True, check=False).returncode != 0:
        yield None
        return
    try:
        yield folder
    finally:
        subprocess.run(["umount", "-l", str(folder)], check=False)


def full_disks(times: int, seed: int) -> dict[str, int]:
    """Flights whose file system fills up at a random message; from every second one something is removed later.

    returns : flights; messages; those that had room and are not in the journal, or are at another place; flights of
              which the loss was not told, or told where there was none; tracebacks
    """
    rng = np.random.default_rng((seed, times))
    tally = dict.fromkeys(("flights", "messages", "lost", "never sent", "untold", "tracebacks"), 0)
    with TemporaryDirectory() as folder:
        for number in range(times):
            (place := Path(folder) / f"{number}").mkdir()
            with small_disk(place / "disk") as disk:
                if disk is None:
                    continue
                _fill_up(place, disk, rng, is_emptied=number % 2 == 0, tally=tally)
    return tally


def _fill_up(place: Path, disk: Path, rng: np.random.Generator, *, is_emptied: bool, tally: dict[str, int]) -> None:
    port, before, after = free_port(), int(rng.integers(5, 40)), 40
    running = Running(place, port, out=disk / "out")
    source = running.connected()
    assert source is not None
    sent = [message(k) for k in range(before + after)]
    source.sendall(b"".join(line + b"\n" for line in sent[:before]))
    running.holds(before)
    with contextlib.suppress(OSError), (disk / "others").open("wb", buffering=0) as others:
        while True:
            others.write(b"x" * 512)
    source.sendall(b"".join(line + b"\n" for line in sent[before:]))
    time.sleep(1.0)
    if is_emptied:
        (disk / "others").unlink()
        running.holds(len(sent), 20.0)
    _, told = running.ended(signal.SIGINT)
    source.close()
    found = [entry.body for entry in read_journal(running.out)]
    tally["flights"] += 1
    tally["messages"] += len(sent)
    tally["lost"] += len(sent) - len(found) if is_emptied else before - min(before, len(found))
    tally["never sent"] += found != sent[: len(found)]
    says = "No space left on device" in " ".join(told.split())
    tally["untold"] += not says and (len(found) < len(sent) or not is_emptied)
    tally["tracebacks"] += "Traceback" in told


# A clock that is set -------------------------------------------------------------------------------------------------

FAKETIME = next((p for p in Path("/usr/lib").glob("*/faketime/libfaketime.so.1")), None)
"""Library that gives a process another time of day; None where it is not installed."""


def _kept(running: Running, sent: Sequence[bytes], status: int, told: str) -> dict[str, int]:
    """What a link that has ended kept of the messages that it was sent, one frame each, and how it ended."""
    bodies = [entry.body for entry in read_journal(running.out)]
    counts = json.loads((running.out / "live.json").read_text())["counts"] if status == 0 else {}
    return {
        "lost": missing(sent, bodies),
        "never sent": missing(bodies, sent),
        "not followed": len(sent) - int(counts.get("frames", 0)),
        "tracebacks": int("Traceback" in told),
        "status": status,
    }


def set_clocks(moves: int, seed: int) -> dict[str, int]:
    """A flight during which the time of day of its computer is set back and forth by up to a year.

    The engine counts on the monotonic clock, which nobody sets; entries of the journal have the time of day.
    """
    rng = np.random.default_rng((seed, moves))
    if FAKETIME is None:
        return {"moves": 0}
    with TemporaryDirectory() as folder:
        place, port, setting = Path(folder), free_port(), Path(folder) / "clock"
        setting.write_text("+0s")
        environment = {"LD_PRELOAD": str(FAKETIME), "FAKETIME_TIMESTAMP_FILE": str(setting), "FAKETIME_NO_CACHE": "1",
                       "FAKETIME_DONT_FAKE_MONOTONIC": "1"}  # fmt: skip
        running = Running(place, port, environment=environment)
        source = running.connected()
        assert source is not None
        sent = list[bytes]()
        for k in range(moves):
            setting.write_text(f"{int(rng.choice([-1, 1]) * 10.0 ** rng.uniform(0.0, 7.5)):+d}s")
            part = [message(k * 5 + i) for i in range(5)]
            sent += part
            source.sendall(b"".join(line + b"\n" for line in part))
            running.holds(len(sent))
        status, told = running.ended(signal.SIGINT)
        source.close()
        arrived = [entry.arrived_ns for entry in read_journal(running.out)]
        return {
            "moves": moves,
            "times that the clock of the journal went back": int(np.sum(np.diff(arrived) < 0)),
            **_kept(running, sent, status, told),
            "wrong units": wrong_units(running.out / "records") if status == 0 else len(sent),
        }


def set_stamps(moves: int, seed: int) -> dict[str, int]:
    """A flight whose own clock, the time in its messages, is set back and forth.

    The readings of a record are those that were sent, whatever time they have.
    """
    rng = np.random.default_rng((seed, moves))
    with TemporaryDirectory() as folder:
        running = Running(Path(folder), free_port())
        source = running.connected()
        assert source is not None
        sent, number = list[bytes](), 0
        for _ in range(moves):
            number = max(number + int(rng.choice([-1, 1]) * 10.0 ** rng.uniform(0.0, 4.0)), 0)
            for _ in range(20):
                number += 1
                sent.append(message(number))
            source.sendall(b"".join(line + b"\n" for line in sent[-20:]))
            running.holds(len(sent))
        status, told = running.ended(signal.SIGINT)
        source.close()
        return {
            "moves": moves,
            **_kept(running, sent, status, told),
            "wrong readings": _never_sent(running.out / "records") if status == 0 else len(sent),
        }


def _never_sent(records: Path) -> int:
    """Readings of all records that no message has."""
    sent = np.array([reading_K(n) for n in range(100)])
    readings = [
        column[np.isfinite(column)]
        for path in sorted(records.rglob("record.toml"))
        for name, column in load_record(path.parent).thermocouples.items()
        if name != "time_s"
    ]
    return sum(int(np.sum(np.min(np.abs(column[:, None] - sent), axis=1) > 1e-3)) for column in readings)


# Figures -------------------------------------------------------------------------------------------------------------


def figures(payloads: int, disks: int, moves: int, seed: int, keep: Keep) -> Iterator[Figure]:
    """All of them; what is counted has a goal of 0."""
    tried: dict[str, tuple[Callable[[int, int], dict[str, int]], int, str]] = {
        f"MQTT broker and page in a browser ({POINT})": (hostile_topics, payloads, "payloads"),
        "file systems that fill up in flight": (full_disks, disks, "flights"),
        "time of day that is set in flight": (set_clocks, moves, "moves"),
        "time in messages that is set": (set_stamps, moves, "moves"),
    }
    for title, (act, count, size) in tried.items():
        counted = keep(f"{title}, {count}", partial(act, count, seed))
        yield Figure(f"{title}: {size}", counted[size], "")
        faults = {n: c for n, c in counted.items() if n not in (size, "messages") and "went back" not in n}
        note = ", ".join(f"{c} {n}" for n, c in faults.items())
        yield Figure(f"{title}: faults", sum(abs(c) for c in faults.values()), "", 0.0, note=note)
