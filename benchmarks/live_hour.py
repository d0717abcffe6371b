"""A link and its page for an hour by the clock: lines of JSON at 10 Hz over UDP, a real browser, memory each minute.

    python -m benchmarks.live_hour                 # an hour
    python -m benchmarks.live_hour --minutes 5

The link is a program of its own, as a user starts it, and so is the browser. What flies is an entry of a practice
record, stretched to the time that there is; thermocouples are those that the plug-in predicts, with noise. Memory of
the browser's tab is that of its process, and its JavaScript heap after garbage collection. `python -m benchmarks
live_page` plays an hour of states to the page alone in two minutes.
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click
import numpy as np

import sim_heating as sh
from benchmarks.measure import Figure, resident_kB, save, table
from sim_heating.base.conditions import FRAME
from sim_heating.live.types import Frame
from tests.support.chromium import Browser, OpenPage
from tests.support.live_streams import frames_of, practice, word_K

POINTS = ("V09T9527", "LOWER_MID")
RATE_HZ, SAMPLED_S, SEED = 10.0, 60.0, 5
BEGIN_S, END_S = 400.0, 1400.0
"""Part of the entry that is flown [s]."""
SETTLED = 10
"""Minutes at the beginning that are not counted, and over which the level at the end is taken."""
DRAWN = "Number(document.documentElement.dataset.drawn || -1)"
PHASE = "document.getElementById('phase').dataset.phase"
LINK = """
format = "link/1"
title = "An hour at 10 Hz"
vehicle = "orbiter"
control_points = {points}

[[source]]
kind = "json-lines"
transport = "udp"
port = {port}

[estimate]
parameters = ["ratio.scale", "ratio.d_alpha"]

[ahead]
scenario = "{scenario}"
horizon_s = 60.0
"""


def run(minutes: int = 60) -> list[Figure]:
    """Fly, and sample memory each minute."""
    with tempfile.TemporaryDirectory() as folder, _link(Path(folder)) as (link, port, page_port), Browser() as browser:
        shown = browser.open(f"http://127.0.0.1:{page_port}/")
        shown.call("Network.disable")
        shown.call("Performance.enable")
        tab = next(p["id"] for p in browser.call("SystemInfo.getProcessInfo")["processInfo"] if p["type"] == "renderer")
        stop, sent = threading.Event(), [0]
        sender = threading.Thread(target=_send, args=(port, minutes * SAMPLED_S, stop, sent))
        sender.start()
        try:
            samples = list(_sampled(minutes, link.pid, tab, page_port, shown))
        finally:
            stop.set()
            sender.join()
        complaints = len(shown.complaints())
    figures = _figures(samples, complaints, sent[0])
    save("live_hour", figures, {"minutes": minutes, "samples": samples})
    return figures


def _figures(samples: list[dict[str, float]], complaints: int, sent: int) -> list[Figure]:
    def grown(name: str) -> float:
        """From the level after the first minutes to that at the end."""
        values = [s[name] for s in samples]
        width = min(SETTLED, len(values) // 3)
        return float(np.median(values[-width:]) - np.median(values[width : 2 * width]))

    last = samples[-1]
    return [
        Figure("time that the page was open", last["minute"], "min"),
        Figure("frames that were sent", sent, ""),
        Figure("the page shows a state that is behind the link's by at most", max(s["behind"] for s in samples), ""),
        Figure("minutes in which the page was not live", sum(1.0 - s["live"] for s in samples), "", 0),
        Figure("tab: process", last["tab_MB"], "MB"),
        Figure("tab: process, grown", grown("tab_MB"), "MB", 10.0),
        Figure("tab: JavaScript heap", last["heap_MB"], "MB", 30.0),
        Figure("tab: JavaScript heap, grown", grown("heap_MB"), "MB", 2.0),
        Figure("tab: nodes, grown", grown("nodes"), "", 50),
        Figure("tab: listeners, grown", grown("listeners"), "", 0),
        Figure("link: process", last["link_MB"], "MB"),
        Figure("link: process, grown", grown("link_MB"), "MB"),
        Figure("link: processor time over time", last["link_busy"], ""),
        Figure("complaints of the browser", complaints, "", 0),
    ]


@contextlib.contextmanager
def _link(folder: Path) -> Iterator[tuple[subprocess.Popen[bytes], int, int]]:
    """A link that runs, its UDP port and that of its page."""
    port, page_port = _free(socket.SOCK_DGRAM), _free(socket.SOCK_STREAM)
    scenario = Path(__file__).parents[1] / "scenarios" / "popu_mach20.toml"
    file = folder / "hour.toml"
    file.write_text(LINK.format(points=json.dumps(POINTS), port=port, scenario=scenario))
    command = [sys.executable, "-m", "sim_heating", "live", str(file), "--port", str(page_port), "--out"]
    with (folder / "said.txt").open("wb") as said:
        process = subprocess.Popen([*command, str(folder / "out")], stdout=said, stderr=said)
        try:
            _state(page_port, within_s=120.0)
            yield process, port, page_port
        finally:
            process.send_signal(signal.SIGINT)
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(60)
            process.send_signal(signal.SIGINT)  # where it weighs candidates, it is not waited for
            process.wait(120)


def _free(kind: socket.SocketKind) -> int:
    with socket.socket(socket.AF_INET, kind) as own:
        own.bind(("127.0.0.1", 0))
        return int(own.getsockname()[1])


def _state(page_port: int, within_s: float = 10.0) -> dict[str, Any]:
    """The link's latest state, by its address."""
    until = time.monotonic() + within_s
    while True:
        try:
            with urllib.request.urlopen(f"http://127.0.0.1:{page_port}/state.json", timeout=5.0) as answer:
                return dict(json.load(answer))
        except OSError:
            if time.monotonic() > until:
                raise
        time.sleep(0.2)


def _send(port: int, flight_s: float, stop: threading.Event, sent: list[int]) -> None:
    """Frames and readings at their rate by the clock, until told to stop."""
    begun = time.monotonic()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as own:
        for k, line in enumerate(_lines(flight_s)):
            if stop.wait(max(0.0, begun + k / RATE_HZ - time.monotonic())):
                return
            own.sendto(line, ("127.0.0.1", port))
            sent[0] = k + 1


def _lines(flight_s: float) -> Iterator[bytes]:
    """A line of JSON for each frame, with a word of each thermocouple."""
    vehicle, rng = sh.load_vehicle("orbiter"), np.random.default_rng(SEED)
    plugin = sh.HeatingPlugin(vehicle, list(POINTS))
    sensors = {s.name: s for name in POINTS for s in vehicle.control_point(name).sensors}
    for k, frame in enumerate(_stretched(flight_s)):
        given = {"time_s": frame.time_s, **frame.values}
        if k:
            plugin.step(given)
        else:
            plugin.reset(given)
        read = {s: v + rng.normal(0.0, sensors[s].noise_sigma_K or 1.0) for s, v in plugin.sensors_K.items()}
        words = {f"{s}_K": float(word_K(sensors[s], np.asarray(v))) for s, v in read.items()}
        yield json.dumps({**given, **words}).encode()


def _stretched(flight_s: float) -> Iterator[Frame]:
    """Frames of a host along the entry, which takes a minute longer than the link is watched."""
    conditions = practice("p08").conditions
    time_s = np.arange(0.0, flight_s + SAMPLED_S, 1.0 / RATE_HZ)
    known = [n for n in FRAME if n in conditions.names and n != "time_s"]
    flown = frames_of(conditions, np.linspace(BEGIN_S, END_S, len(time_s)))
    for t, frame in zip(time_s.tolist(), flown, strict=True):
        yield Frame(t, {n: frame.values[n] for n in known})


def _sampled(minutes: int, link: int, tab: int, page_port: int, shown: OpenPage) -> Iterator[dict[str, float]]:
    """Memory of link and tab, and how far the page has come, after each minute."""
    begun, busy = time.monotonic(), _busy_s(link)
    for minute in range(1, minutes + 1):
        time.sleep(max(0.0, begun + minute * SAMPLED_S - time.monotonic()))
        resident = resident_kB(tab)
        drawn, number = float(shown.evaluate(DRAWN)), float(_state(page_port)["sequence"])
        for _ in range(2):
            shown.call("HeapProfiler.collectGarbage")
        heap = {m["name"]: m["value"] for m in shown.call("Performance.getMetrics")["metrics"]}
        yield {
            "minute": minute, "link_MB": resident_kB(link) / 1e3, "tab_MB": resident / 1e3,
            "heap_MB": heap["JSHeapUsedSize"] / 1e6, "nodes": heap["Nodes"], "listeners": heap["JSEventListeners"],
            "behind": number - drawn, "live": float(shown.evaluate(PHASE) == "live"),
            "link_busy": (_busy_s(link) - busy) / (time.monotonic() - begun),
        }  # fmt: skip


def _busy_s(process: int) -> float:
    """Processor time that a process has taken [s]."""
    fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


@click.command(help=(__doc__ or "").partition("\n")[0])
@click.option("--minutes", type=click.IntRange(3), default=60, help="time that the page is open")
def main(minutes: int) -> None:
    """Run and print."""
    click.echo(table(run(minutes)))


if __name__ == "__main__":
    main()
