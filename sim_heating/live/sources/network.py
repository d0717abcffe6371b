"""Bytes from a network, standard input or a file, cut into bodies: lines, or packets by their length.

A datagram holds whole bodies. A stream is cut where a line or packet ends; what a connection leaves unfinished is a
damaged body of its own, so that nothing that came is lost without a word.
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
import os
import socket
import sys
import threading
from collections import deque
from collections.abc import AsyncIterator, Callable
from pathlib import Path

from sim_heating.base.errors import InputError
from sim_heating.base.files import display_path
from sim_heating.base.files.paths import os_error_reason
from sim_heating.live.sources.packets import packet_length
from sim_heating.live.spec import Network

LONGEST_LINE = 1 << 20
"""Bytes of a line; what is longer is passed on in pieces, which are damaged lines."""
READ = 1 << 16
RECEIVE_BUFFER = 1 << 22
"""Bytes of datagrams that the system keeps while the link is busy."""
WAITING = 100_000
"""Bodies that wait for the link; later ones are dropped, and counted."""
BACKLOG = 16
"""Connections that are accepted at a time: each takes a file descriptor before it can be turned away."""
MOST_CONNECTIONS = 64
"""Connections to a source at one time; more are closed."""
RETRY_S = 1.0
"""Time between attempts to connect [s]."""

Cut = Callable[[bytearray, bool], list[bytes]]
"""Takes the whole bodies from the front of a buffer; with True, all that is left."""


def cut_lines(buffer: bytearray, is_end: bool) -> list[bytes]:
    """Whole lines, without their ends and without blank ones."""
    *lines, rest = bytes(buffer).split(b"\n")
    if is_end or len(rest) > LONGEST_LINE:
        lines, rest = [*lines, rest], b""
    buffer[:] = rest
    return [line for line in lines if line.strip()]


def cut_packets(buffer: bytearray, is_end: bool) -> list[bytes]:
    """Whole CCSDS packets by the length in their headers."""
    packets: list[bytes] = []
    while (length := packet_length(buffer)) is not None and len(buffer) >= length:
        packets.append(bytes(buffer[:length]))
        del buffer[:length]
    if is_end and buffer:
        packets.append(bytes(buffer))
        buffer.clear()
    return packets


class Inbox:
    """Bodies that came and wait to be taken."""

    def __init__(self, remark: Callable[[str], None]) -> None:
        self._bodies: deque[bytes] = deque()
        self._ready = asyncio.Event()
        self._remark = remark
        self._has_ended = False
        self.dropped = 0

    def put(self, bodies: list[bytes]) -> None:
        """Add bodies."""
        room = WAITING - len(self._bodies)
        if len(bodies) > room:
            if self.dropped == 0:
                self._remark(f"more comes than the link can take: messages beyond {WAITING} that wait are dropped")
            self.dropped += len(bodies) - room
        self._bodies.extend(bodies[:room])
        self._ready.set()

    def end(self) -> None:
        """No more bodies come."""
        self._has_ended = True
        self._ready.set()

    async def __aiter__(self) -> AsyncIterator[bytes]:
        while True:
            while self._bodies:
                yield self._bodies.popleft()
            if self._has_ended:
                return
            self._ready.clear()
            await self._ready.wait()


async def bodies(
    settings: Network, cut: Cut, remark: Callable[[str], None], file: Path | None = None
) -> AsyncIterator[bytes]:
    """Bodies of a transport, from its opening on.

    cut    : `cut_lines` or `cut_packets`
    remark : called with one line where a connection is made, lost, or cannot be made
    file   : path of transport = "file"
    raises : InputError where a port is in use, an address is not of this machine, or the file cannot be read
    """
    inbox = Inbox(remark)
    opened = _OPEN[settings.transport](settings, cut, remark, inbox, file)
    async with opened:
        async for body in inbox:
            yield body


@contextlib.asynccontextmanager
async def _udp(
    settings: Network, cut: Cut, remark: Callable[[str], None], inbox: Inbox, _: Path | None
) -> AsyncIterator[None]:
    class Datagrams(asyncio.DatagramProtocol):
        def datagram_received(self, data: bytes, addr: object) -> None:
            inbox.put(cut(bytearray(data), True))

    bound = _bound(settings, socket.SOCK_DGRAM)
    bound.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER)
    transport, _protocol = await asyncio.get_running_loop().create_datagram_endpoint(Datagrams, sock=bound)
    try:
        yield
    finally:
        transport.close()


def _bound(settings: Network, kind: socket.SocketKind) -> socket.socket:
    """A socket at the address of the settings; InputError in one line where it is not to be had."""
    name = "UDP" if kind == socket.SOCK_DGRAM else "TCP"
    where = f"{name} port {settings.port} of {settings.host}"
    try:
        family, *_, address = socket.getaddrinfo(settings.host, settings.port, type=kind)[0]
        bound = socket.socket(family, kind)
    except OSError as error:
        raise InputError(f"{where}: {os_error_reason(error)}; name an address of this machine in `host`") from None
    try:
        if kind == socket.SOCK_STREAM and os.name == "posix":
            bound.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # a port that waits to be closed is free
        bound.setblocking(False)
        bound.bind(address)
    except OSError as error:
        bound.close()
        in_use = error.errno in (errno.EADDRINUSE, getattr(errno, "WSAEADDRINUSE", errno.EADDRINUSE))
        rule = "is in use; end the other program, or change `port`" if in_use else f"{os_error_reason(error)}"
        raise InputError(f"{where} {rule}") from None
    return bound


@contextlib.asynccontextmanager
async def _tcp_server(
    settings: Network, cut: Cut, remark: Callable[[str], None], inbox: Inbox, _: Path | None
) -> AsyncIterator[None]:
    tasks: set[asyncio.Task[None]] = set()

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        task = asyncio.current_task()
        assert task is not None
        if len(tasks) >= MOST_CONNECTIONS:
            remark(f"{MOST_CONNECTIONS} have connected already; one more is turned away")
            writer.transport.abort()
            return
        tasks.add(task)
        peer = ":".join(map(str, (writer.get_extra_info("peername") or ("?",))[:2]))
        remark(f"{peer} has connected")
        try:
            await _read(reader, cut, inbox)
            remark(f"{peer} has closed its connection")
        except OSError as error:
            remark(f"connection of {peer} is lost ({os_error_reason(error)})")
        except asyncio.CancelledError:
            pass  # the link ends; before Python 3.12 a cancelled task of a server is printed as an error
        finally:
            tasks.discard(task)
            writer.close()

    server = await asyncio.start_server(serve, sock=_bound(settings, socket.SOCK_STREAM), backlog=BACKLOG)
    try:
        yield
    finally:
        server.close()
        for task in list(tasks):
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


async def _read(reader: asyncio.StreamReader, cut: Cut, inbox: Inbox) -> None:
    """Everything of one connection; what is unfinished at its end is a body too."""
    buffer = bytearray()
    try:
        while data := await reader.read(READ):
            buffer += data
            inbox.put(cut(buffer, False))
    finally:
        inbox.put(cut(buffer, True))


@contextlib.asynccontextmanager
async def _tcp_client(
    settings: Network, cut: Cut, remark: Callable[[str], None], inbox: Inbox, _: Path | None
) -> AsyncIterator[None]:
    where = f"{settings.host}:{settings.port}"

    async def connect() -> None:
        reported = ""
        while True:
            try:
                reader, writer = await asyncio.open_connection(settings.host, settings.port)
                remark(f"connected to {where}")
                reported = ""
                try:
                    await _read(reader, cut, inbox)
                    remark(f"{where} has closed the connection; trying again")
                finally:
                    writer.close()
            except OSError as error:
                line = f"{where}: {os_error_reason(error)}; trying again"
                if line != reported:
                    remark(line)
                reported = line
            await asyncio.sleep(RETRY_S)

    task = asyncio.create_task(connect())
    try:
        yield
    finally:
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)


@contextlib.asynccontextmanager
async def _descriptor(number: int, cut: Cut, inbox: Inbox, name: str) -> AsyncIterator[None]:
    """A file or pipe, read in a thread of its own: a pipe is read while the link waits for nothing else."""
    loop, has_room = asyncio.get_running_loop(), threading.Semaphore(64)

    def put(data: list[bytes]) -> None:
        inbox.put(data)
        has_room.release()

    def read() -> None:
        buffer = bytearray()
        with contextlib.suppress(RuntimeError):  # the loop has been closed
            while True:
                has_room.acquire()
                try:
                    data = os.read(number, READ)
                except OSError:
                    data = b""
                buffer += data
                loop.call_soon_threadsafe(put, cut(buffer, not data))
                if not data:
                    loop.call_soon_threadsafe(inbox.end)
                    return

    threading.Thread(target=read, name=f"read {name}", daemon=True).start()
    yield


@contextlib.asynccontextmanager
async def _stdin(
    settings: Network, cut: Cut, remark: Callable[[str], None], inbox: Inbox, _: Path | None
) -> AsyncIterator[None]:
    async with _descriptor(sys.stdin.fileno(), cut, inbox, "standard input"):
        yield


@contextlib.asynccontextmanager
async def _file(
    settings: Network, cut: Cut, remark: Callable[[str], None], inbox: Inbox, file: Path | None
) -> AsyncIterator[None]:
    assert file is not None
    try:
        number = os.open(file, os.O_RDONLY | getattr(os, "O_BINARY", 0))
    except OSError as error:
        raise InputError(f"{display_path(file)}: {os_error_reason(error)}; correct `file`") from None
    async with _descriptor(number, cut, inbox, display_path(file)):
        yield


_OPEN = {"udp": _udp, "tcp-server": _tcp_server, "tcp-client": _tcp_client, "stdin": _stdin, "file": _file}
