"""Lines of JSON for other displays, over UDP or WebSocket, in the form that PlotJuggler reads.

    udp://HOST:PORT    its `UDP Server`, by default port 9870
    ws://HOST:PORT     its `WebSocket Server`, by default port 9871: the display listens, the link connects to it

Messages hold numbers by their path in the state, such as `points/V09T9527/surface_K`, without the time histories of the
look-ahead, and the flight time as `timestamp`, which PlotJuggler takes as time where it is told to. A message in which
that is no number would make it go over to the time of arrival for good: none is sent before the first flight time. The
whole state is served by `server.PageServer` at `/lines`.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import socket
from collections.abc import Iterator, Mapping
from typing import Any
from urllib.parse import urlsplit

from sim_heating.base.errors import InputError
from sim_heating.live.outputs.published import Latest, Output, Published

LARGEST_DATAGRAM = 1400
"""Bytes of a datagram: one packet of an Ethernet, and below the 2048 bytes that PlotJuggler reads."""


def lines_to(address: str) -> Output:
    """The output of an address.

    raises : InputError for one that is neither udp://HOST:PORT nor ws://HOST:PORT

    >>> from sim_heating.live.outputs.lines import lines_to
    >>> lines_to("udp://127.0.0.1:9870").address
    'udp://127.0.0.1:9870'
    """
    form = "give udp://HOST:PORT, ws://HOST:PORT or wss://HOST:PORT"
    try:
        parts = urlsplit(address)
        port = parts.port
    except ValueError:
        raise InputError(f"lines: `{address}` has no port between 0 and 65535; {form}") from None
    if parts.scheme == "udp" and parts.hostname and port:
        return UdpLines(parts.hostname, port)
    if parts.scheme in ("ws", "wss") and parts.hostname and port:
        return WebSocketLines(address)
    raise InputError(f"lines: `{address}` is no address of a display; {form}")


class UdpLines:
    """Sends each state in datagrams; whether somebody listens does not matter."""

    def __init__(self, host: str, port: int) -> None:
        self.address = f"udp://{host}:{port}"
        self._host, self._port = host, port
        self._socket: socket.socket | None = None
        self._to: Any = None
        self.dropped = 0
        """Datagrams that this machine could not take at once."""

    async def start(self) -> None:
        """Open the socket; raises InputError for a host that is not known."""
        loop = asyncio.get_running_loop()
        try:
            addresses = await loop.getaddrinfo(self._host, self._port, type=socket.SOCK_DGRAM)
        except OSError as error:
            raise InputError(f"lines: host of {self.address}: {error.strerror}; give its name or address") from None
        family, kind, protocol, _, self._to = addresses[0]
        self._socket = socket.socket(family, kind, protocol)
        self._socket.setblocking(False)
        with contextlib.suppress(OSError):  # an address such as 192.168.1.255 is that of all displays of a network
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)

    def publish(self, published: Published) -> None:
        """Send the state, where it has a flight time; what the network does not take at once is dropped."""
        if self._socket is None or published.state.time_s is None:
            return
        for datagram in datagrams(published):
            try:
                self._socket.sendto(datagram, self._to)
            except OSError:  # buffers are full, or nobody is there
                self.dropped += 1

    async def stop(self) -> None:
        """Close the socket."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None


class WebSocketLines:
    """Connects to a display that listens, and connects again when it has gone."""

    def __init__(self, address: str) -> None:
        self.address = address
        self._latest = Latest()
        self._task: asyncio.Task[None] | None = None

    async def start(self) -> None:
        """Begin to connect; a display that is not there yet is waited for."""
        self._task = asyncio.create_task(self._run())

    def publish(self, published: Published) -> None:
        """Give the state to the display, when it takes it; none before the first flight time."""
        if published.state.time_s is not None:
            self._latest.put(published)

    async def stop(self) -> None:
        """Close the connection."""
        if self._task is not None:
            self._task.cancel()
            await asyncio.gather(self._task, return_exceptions=True)

    async def _run(self) -> None:
        from websockets.asyncio.client import connect
        from websockets.exceptions import WebSocketException

        while True:
            with contextlib.suppress(OSError, WebSocketException, TimeoutError):
                async with connect(self.address, compression=None, open_timeout=5) as display:
                    while True:
                        await display.send((await self._latest.take()).scalar_line)
            await asyncio.sleep(1.0)


def datagrams(published: Published, largest: int = LARGEST_DATAGRAM) -> list[bytes]:
    """A state as objects of JSON of at most so many bytes: path -> value, each with its part and the flight time.

    A path is that of the state, such as `points/V09T9527/surface_K` or `removed[0]/why`; what is not known is left out,
    and a text is cut at a quarter of a datagram.
    """
    time_s = published.state.time_s
    head = f'{{"timestamp":{json.dumps(time_s)},"time_s":{json.dumps(time_s)}'
    finished: list[bytes] = []
    datagram = head
    for path, value in _leaves(published.scalars):
        if path == "time_s":
            continue
        text = value[: largest // 24] if isinstance(value, str) else value  # a character takes up to six bytes
        piece = f",{json.dumps(path)}:{json.dumps(text)}"
        if len(datagram) + len(piece) >= largest:
            finished.append((datagram + "}").encode())
            datagram = head
        datagram += piece
    return [*finished, (datagram + "}").encode()]


def _leaves(value: Any, path: str = "") -> Iterator[tuple[str, float | str]]:
    """Paths and values of all numbers, truths and texts within nested objects and lists."""
    if isinstance(value, Mapping):
        for name, inner in value.items():
            yield from _leaves(inner, f"{path}/{name}" if path else name)
    elif isinstance(value, list):
        for k, inner in enumerate(value):
            yield from _leaves(inner, f"{path}[{k}]")
    elif value is not None:
        yield path, value
