"""The page of a link over an hour at 10 Hz, played faster, in a real browser: memory of page and server, and its time.

36 000 states of two control points and seven sensors are published as fast as 400 a second; the page draws five times a
second as it always does. Memory of the page is its JavaScript heap after garbage collection, and its nodes and
listeners; of the server, what its process has more than at a tenth of the hour. After the hour the page draws another
minute at 10 Hz, so that what each drawing leaves behind shows, too.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from benchmarks.measure import Figure, resident_kB, save
from sim_heating.live.state import PointState, State
from tests.support.chromium import Browser, OpenPage
from tests.support.live_states import Flown
from tests.support.served import Served, served

HOUR, BETWEEN, RATE_HZ = 36_000, 3_600, 400.0
AFTER = 300
DRAWN = "Number(document.documentElement.dataset.drawn || -1)"


def run() -> list[Figure]:
    """Play the hour."""
    flown = Flown.of()
    states = _for_ever(list(flown.states(flown.popu_s - 10.0, flown.popu_s + 50.0)))
    with served(flown.display) as (server, page), Browser() as browser:
        shown = browser.open(server.url)
        shown.call("Network.disable")
        shown.call("Performance.enable")
        seconds = _play(page, states, BETWEEN, RATE_HZ)
        early, resident = _memory(shown), resident_kB()
        seconds += _play(page, states, HOUR - BETWEEN, RATE_HZ)
        late, grown = _memory(shown), resident_kB() - resident
        drawings = _play(page, states, AFTER, 10.0), _memory(shown)
        behind = page.last - float(shown.evaluate(DRAWN))
        complaints = len(shown.complaints())
    figures = [
        Figure("JavaScript heap of the page after an hour", late["JSHeapUsedSize"] / 1e6, "MB", 30.0),
        Figure(
            "what it grew by from 6 minutes to an hour",
            (late["JSHeapUsedSize"] - early["JSHeapUsedSize"]) / 1e6,
            "MB",
            2.0,
        ),
        Figure("and in 30 s more at 10 Hz", (drawings[1]["JSHeapUsedSize"] - late["JSHeapUsedSize"]) / 1e6, "MB", 1.0),
        Figure("nodes of the page more than at 6 minutes", late["Nodes"] - early["Nodes"], "", 50),
        Figure("its listeners more than at 6 minutes", late["JSEventListeners"] - early["JSEventListeners"], "", 0),
        Figure("what the server grew by", grown / 1e3, "MB", 20.0),
        Figure("publishing of a state, 99th percentile", 1e3 * float(np.quantile(seconds, 0.99)), "ms", 10.0),
        Figure("states that the page is behind at the end", behind, "", 10),
        Figure("complaints of the browser", complaints, "", 0),
    ]
    save("live_page", figures)
    return figures


def _for_ever(states: list[State]) -> Iterator[State]:
    """States again and again, with flight times and numbers that go on."""
    length = len(states) * 0.1
    for number in itertools.count():
        turn, k = divmod(number, len(states))
        state, later = states[k], turn * length
        assert state.time_s is not None
        points = {name: _later(point, later) for name, point in state.points.items()}
        yield replace(state, sequence=number, time_s=state.time_s + later, points=points)


def _later(point: PointState, by_s: float) -> PointState:
    sensors = {
        name: replace(own, measured_s=None if own.measured_s is None else own.measured_s + by_s)
        for name, own in point.sensors.items()
    }
    return replace(point, sensors=sensors)


def _play(page: Served, states: Iterator[State], count: int, rate_hz: float) -> list[float]:
    due, seconds = time.monotonic(), []
    for state in itertools.islice(states, count):
        seconds.append(page.publish(state))
        due += 1.0 / rate_hz
        time.sleep(max(0.0, due - time.monotonic()))
    return seconds


def _memory(shown: OpenPage) -> dict[str, float]:
    """Metrics of the page after its garbage is collected."""
    time.sleep(1.0)
    for _ in range(2):
        shown.call("HeapProfiler.collectGarbage")
    return {m["name"]: m["value"] for m in shown.call("Performance.getMetrics")["metrics"]}
