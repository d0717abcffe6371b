"""A link that runs: sources, engine and outputs together until the sources end or the link is told to end.

The network and the outputs belong to an event loop, the engine to a thread of its own: a long step holds no source
back, and a slow reader of the page holds nobody back.
"""

from __future__ import annotations

import asyncio
import contextlib
import hashlib
import os
import signal
import warnings
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from sim_heating.base.errors import InputError
from sim_heating.base.files.paths import os_error_reason
from sim_heating.base.progress import SAME_REQUEST_S, Progress
from sim_heating.live.engine import IN_A_ROW, LinkEngine
from sim_heating.live.recording.journal import read_journal
from sim_heating.live.sources import Remark, SourceStream, open_source
from sim_heating.live.spec import Link, Network, Replay
from sim_heating.live.state import State
from sim_heating.live.types import Message

if TYPE_CHECKING:
    from sim_heating.live.outputs.published import Output

WAITING = 1024
"""Messages that wait for the engine; a replay waits for room, a network keeps what comes in its own inbox."""

Sources = Callable[[Link, int, Remark], SourceStream]
"""Opens a source of a link by its number."""


Waiting = Callable[[], contextlib.AbstractContextManager[Progress]]
"""Makes the progress of a wait, as a context."""


@dataclass(frozen=True)
class _Failed:
    error: BaseException


class _Faults:
    """Faults beside the flight as remarks: what is recorded does not depend on who looks at it.

    remark : called with one line
    """

    def __init__(self, remark: Remark) -> None:
        self._remark = remark

    def of_loop(self, loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        """Handler of the event loop: connections that the system refuses, tasks that failed."""
        error = context.get("exception")
        if isinstance(error, asyncio.CancelledError):  # of a connection that was open when the link ended
            return
        if isinstance(error, OSError):
            self._remark(f"connections: {os_error_reason(error)}; recording goes on")
        else:
            self._remark(f"connections: {context.get('message', '')} {error!r}; recording goes on")

    @contextlib.contextmanager
    def caught(self, activity: str) -> Iterator[None]:
        """An error within the block is a remark."""
        try:
            yield
        except Exception as error:
            self._remark(f"{activity}: {error!r}; recording goes on")


_Item = Message | _Failed | None
"""A message that is kept, why a source failed, or the end of one."""


class Stop(asyncio.Event):
    """A request to end a link by itself.

    has_begun : whether all is compiled that the first samples run, and sources are opened
    at_once   : whether it ends without waiting for a step of the engine, which its thread then ends alone
    """

    has_begun = at_once = False


async def run_link(
    engine: LinkEngine,
    outputs: Sequence[Output] = (),
    *,
    on_state: Callable[[State], None] | None = None,
    stop: asyncio.Event | None = None,
    resume: bool = False,
    open_sources: Sources = open_source,
    waiting: Waiting | None = None,
) -> State:
    """Run a link until its sources end.

    outputs  : that states are published to; started and stopped here
    on_state : called with each state
    stop     : ends the link when it is set; a `Stop` may also end it at once
    resume   : whether the engine's journal was cut off, and its messages are taken again first
    waiting  : progress of the wait for the candidates of an alarm, which `stop` ends, too; None for no such wait
    returns  : the last state
    raises   : InputError where a source or an output cannot be opened
    """
    link, stop = engine.link, stop or Stop()
    request = stop if isinstance(stop, Stop) else Stop()
    faults = _Faults(engine.remarks.add)
    loop, queue = asyncio.get_running_loop(), asyncio.Queue[_Item](WAITING)
    worker = ThreadPoolExecutor(1, thread_name_prefix="estimate")
    readers: list[asyncio.Task[None]] = []
    written: dict[int, Counter[bytes]] = defaultdict(Counter)
    started: list[Output] = []
    handled = loop.get_exception_handler()
    loop.set_exception_handler(faults.of_loop)
    try:
        await loop.run_in_executor(worker, engine.prepare)
        request.has_begun = True
        for output in outputs:
            await output.start()
            started.append(output)
        if resume and engine.journal is not None:
            for entry in read_journal(engine.journal.path):
                written[entry.source][_digest(entry.body)] += 1
        streams = [open_sources(link, i, engine.remarks.add) for i in range(len(link.declared.source))]
        if not streams:
            raise InputError(f"{link.path}: has no [[source]]; add one, or give --replay RECORD")
        readers = [asyncio.create_task(_read(engine, s, queue, _skipped(link, s.number, written))) for s in streams]
        publish = _publisher(engine, started, on_state, faults)
        publish(False)  # a reader that comes before the first sample finds a link that waits
        if written and engine.journal is not None:
            again = loop.run_in_executor(
                worker, engine.resume, engine.journal.path, sum(c.total() for c in written.values())
            )
            await _meanwhile(again, publish, loop.time())
        await _take_all(engine, queue, len(readers), worker, stop, publish)
        for task in readers:
            task.cancel()
        await _meanwhile(loop.run_in_executor(worker, _give, engine, _waiting(queue)), publish, loop.time())
        await loop.run_in_executor(worker, engine.end)
        if waiting is not None:
            await _weighed(engine, waiting, stop, publish)
        last = engine.state()
        _publish(last, started, on_state, faults)
        return last
    finally:
        for task in readers:
            task.cancel()
        await asyncio.gather(*readers, return_exceptions=True)
        for output in started:
            with faults.caught("ending a page or display"):
                await output.stop()
        worker.shutdown(wait=not request.at_once, cancel_futures=request.at_once)
        engine.stop()
        loop.set_exception_handler(handled)


async def _weighed(engine: LinkEngine, waiting: Waiting, stop: asyncio.Event, publish: Callable[[bool], None]) -> None:
    """Wait until the candidates of an alarm are weighed; a further request to end ends the wait."""
    if not engine.weigh():
        return
    loop = asyncio.get_running_loop()
    new_from_s = loop.time() + SAME_REQUEST_S
    assert engine.test.alarm is not None
    with waiting() as progress:
        while engine.weigh():
            progress(0.0, f"weighing what could be missing at {engine.test.alarm.point}; Ctrl-C ends without it")
            publish(False)
            if loop.time() < new_from_s:
                stop.clear()  # the request that ended the link
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(stop.wait(), 1.0 / engine.link.declared.output.rate_Hz)
                if loop.time() >= new_from_s:
                    engine.stop()
                    return


def _digest(body: bytes) -> bytes:
    return hashlib.blake2b(body, digest_size=16).digest()


def _skipped(link: Link, number: int, written: Mapping[int, Counter[bytes]]) -> Counter[bytes]:
    """Digests of bodies of a source that begins again with its first one, and that the journal has already."""
    source = link.declared.source[number]
    begins_again = isinstance(source, Replay) or (isinstance(source, Network) and source.transport == "file")
    return Counter(written.get(number)) if begins_again else Counter()


async def _read(engine: LinkEngine, stream: SourceStream, queue: asyncio.Queue[_Item], skip: Counter[bytes]) -> None:
    """Everything of one source into the journal and the queue, and how it ended."""
    try:
        async for message in stream:
            if skip and skip[digest := _digest(message.body)] > 0:
                skip[digest] -= 1
                continue
            engine.keep(message, stream.number)
            await queue.put(message)
    except Exception as error:
        await queue.put(_Failed(error))
        return
    await queue.put(None)


async def _take_all(
    engine: LinkEngine,
    queue: asyncio.Queue[_Item],
    sources: int,
    worker: ThreadPoolExecutor,
    stop: asyncio.Event,
    publish: Callable[[bool], None],
) -> None:
    """Give messages to the engine until all sources have ended, and publish its states at their rate."""
    loop = asyncio.get_running_loop()
    interval = 1.0 / engine.link.declared.output.rate_Hz
    due = loop.time()
    stopped = asyncio.ensure_future(stop.wait())
    try:
        while sources > 0 and not stop.is_set():
            wait_s = max(due - loop.time(), 0.0)
            first = await _next(queue, stopped, wait_s)
            batch: list[Message] = []
            while first is not _NOTHING:
                if isinstance(first, _Failed):
                    raise first.error
                if first is None:
                    sources -= 1
                else:
                    batch.append(first)
                if len(batch) >= IN_A_ROW or queue.empty():
                    break
                first = queue.get_nowait()
            if batch:
                due = await _meanwhile(loop.run_in_executor(worker, _give, engine, batch), publish, due, interval)
            if loop.time() >= due:
                publish(False)
                due = max(due + interval, loop.time())
    finally:
        stopped.cancel()


async def _meanwhile(
    work: asyncio.Future[Any], publish: Callable[[bool], None], due: float, interval: float = 0.1
) -> float:
    """Wait for the engine, and publish the health of the link while it is at work; when the next state is due."""
    loop = asyncio.get_running_loop()
    while not work.done():
        await asyncio.wait({work}, timeout=max(due - loop.time(), 0.0))
        if not work.done():
            publish(True)
            due = loop.time() + interval
    work.result()
    return due


_NOTHING: Any = object()


async def _next(queue: asyncio.Queue[_Item], stopped: asyncio.Future[Any], wait_s: float) -> Any:
    """The next item, or _NOTHING when the time is over or the link is told to end."""
    if not queue.empty():
        return queue.get_nowait()
    getter = asyncio.ensure_future(queue.get())
    done, _ = await asyncio.wait({getter, stopped}, timeout=wait_s, return_when=asyncio.FIRST_COMPLETED)
    if getter in done:
        return getter.result()
    getter.cancel()
    with contextlib.suppress(asyncio.CancelledError):
        return await getter  # an item that came at the same moment is not lost
    return _NOTHING


def _give(engine: LinkEngine, batch: Sequence[Message]) -> None:
    for message in batch:
        engine.give(message)
        if engine.is_behind:
            engine.advance()
    engine.advance()


def _waiting(queue: asyncio.Queue[_Item]) -> list[Message]:
    """Messages that wait for the engine; they are in the journal already."""
    messages: list[Message] = []
    while not queue.empty():
        item = queue.get_nowait()
        if isinstance(item, Message):
            messages.append(item)
    return messages


def _publisher(
    engine: LinkEngine, outputs: Sequence[Output], on_state: Callable[[State], None] | None, faults: _Faults
) -> Callable[[bool], None]:
    """What publishes the state now; with True the last one, with the link's health now, while the engine is busy."""

    def publish(is_busy: bool) -> None:
        _publish(engine.last_state() if is_busy else engine.state(), outputs, on_state, faults)

    return publish


def _publish(
    state: State, outputs: Sequence[Output], on_state: Callable[[State], None] | None, faults: _Faults
) -> None:
    if on_state is not None:
        on_state(state)
    if outputs:
        from sim_heating.live.outputs.published import Published

        published = Published(state)
        for output in outputs:
            with faults.caught("a page or display"):
                output.publish(published)


class _AtOnce(KeyboardInterrupt):
    """A link ends without its results; its journal keeps what came."""


STILL_AT_WORK = (
    "the estimate is still at work on what came; Ctrl-C again ends at once without results, which the same command "
    "then makes from the journal"
)


@contextlib.contextmanager
def _ending_signals(stop: Stop) -> Iterator[None]:
    """Ctrl-C and a request to end let the link end by itself, so that its results are written.

    Before it has begun, and at a second request that is not the same one, it ends at once by the handlers of before.
    """
    loop, before, waits = asyncio.get_running_loop(), dict[int, Any](), list[asyncio.TimerHandle]()

    def tell() -> None:
        if stop.is_set():
            warnings.warn(STILL_AT_WORK, stacklevel=2)

    def end(number: int) -> None:
        if stop.has_begun and not stop.is_set():
            stop.set()
            waits.append(loop.call_later(2.0 * SAME_REQUEST_S, tell))
        elif not stop.has_begun or loop.time() > waits[0].when() - SAME_REQUEST_S:
            handler, stop.at_once = before[number], True
            try:
                (handler if callable(handler) else signal.default_int_handler)(number, None)
            except KeyboardInterrupt:
                raise _AtOnce from None

    if os.name == "posix":
        for number in (signal.SIGINT, signal.SIGTERM):
            before[number] = signal.getsignal(number)
            try:
                loop.add_signal_handler(number, end, number)
            except (RuntimeError, ValueError):  # not the main thread, which alone handles signals
                before.pop(number)
    try:
        yield
    finally:
        for wait in waits:
            wait.cancel()
        for handled, handler in before.items():
            loop.remove_signal_handler(handled)
            signal.signal(handled, handler)


def run(engine: LinkEngine, outputs: Sequence[Output] = (), **options: Any) -> State:
    """Run a link in this thread until its sources end, or Ctrl-C; arguments, result and errors as `run_link`."""

    async def main() -> State:
        stop = Stop()
        with _ending_signals(stop):
            return await run_link(engine, outputs, stop=stop, **options)

    try:
        return asyncio.run(main())
    except _AtOnce:
        raise
    except KeyboardInterrupt:  # where signals cannot be handled within the loop
        engine.end()
        return engine.state()
