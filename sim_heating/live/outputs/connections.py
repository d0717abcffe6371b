"""Connections to the page that send nothing, or are too many, take nothing from the link."""

from __future__ import annotations

import asyncio

from uvicorn.protocols.http.h11_impl import H11Protocol


def limited_protocol(most: int, headers_s: float) -> type[H11Protocol]:
    """HTTP with a limit on connections, those of WebSockets among them, and on the time that a request takes to come.

    most      : connections at one time; more are closed as they are made
    headers_s : time from a connection, or from an answer on it, to the end of the headers of the next request [s]
    """

    class Limited(H11Protocol):
        def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
            super().connection_made(transport)
            if len(self.connections) > most:
                transport.abort()
            else:
                self._wait_for_headers()

        def on_response_complete(self) -> None:
            super().on_response_complete()
            self._wait_for_headers()

        def _wait_for_headers(self) -> None:
            self.loop.call_later(headers_s, self._close_without, self.cycle)

        def _close_without(self, earlier_cycle: object) -> None:
            """Close a connection on which no request has come since: its cycle is the one before, or none."""
            is_http = self.transport.get_protocol() is self  # and no WebSocket by now
            waits = self.cycle is earlier_cycle and (self.cycle is None or self.cycle.response_complete)
            if is_http and waits and not self.transport.is_closing():
                self.transport.abort()

    return Limited
