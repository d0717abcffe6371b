"""A page of a link that is served while a test or a benchmark goes on."""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import Awaitable, Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import Any, TypeVar

from sim_heating.live.outputs.display import Display
from sim_heating.live.outputs.published import Output, Published
from sim_heating.live.outputs.server import PageServer
from sim_heating.live.state import State

T = TypeVar("T")


class Loop:
    """An event loop in a thread of its own, for the time of a block."""

    def __enter__(self) -> Loop:
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()

    def run(self, work: Awaitable[T]) -> T:
        """The result of a coroutine within the loop."""
        return asyncio.run_coroutine_threadsafe(_awaited(work), self._loop).result(30)

    def call(self, work: Callable[..., T], *args: Any) -> T:
        """The result of a function within the loop."""

        async def called() -> T:
            return work(*args)

        return self.run(called())


async def _awaited(work: Awaitable[T]) -> T:
    return await work


class Served:
    """An output that states are published to."""

    def __init__(self, loop: Loop, output: Output) -> None:
        self.loop, self.output = loop, output
        self.last = -1
        """Number of the latest state."""

    def publish(self, state: State) -> float:
        """Publish a state; the time that it took [s]."""
        published, self.last = Published(state), state.sequence
        return self.loop.call(self._timed, published)

    def _timed(self, published: Published) -> float:
        start = time.perf_counter()
        self.output.publish(published)
        return time.perf_counter() - start

    def play(self, states: Iterable[State], rate_hz: float) -> None:
        """Publish states at a rate."""
        due = time.monotonic()
        for state in states:
            self.publish(state)
            due += 1.0 / rate_hz
            time.sleep(max(0.0, due - time.monotonic()))


@contextmanager
def served(display: Display, **options: Any) -> Iterator[tuple[PageServer, Served]]:
    """A page server at a free port, and what publishes to it."""
    with Loop() as loop:
        server = PageServer(display, **{"port": 0, **options})
        loop.run(server.start())
        try:
            yield server, Served(loop, server)
        finally:
            loop.run(server.stop())
