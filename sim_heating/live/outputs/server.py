"""The page of a link, and its states for other displays, over HTTP and WebSocket.

    server = PageServer(display, port=8465)
    await server.start()
    server.publish(Published(state))
    await server.stop()

Everything can be read and nothing changed: the only word that a reader sends is which control point it shows. The
server listens on this machine alone unless another address is asked for; then readers need a token. Each reader has
room for one state: one that reads slowly misses states, and holds nobody back. Without a page there are `/state.json`
and `/metrics`.

| address | what |
|---|---|
| `/` | the page |
| `/static.json` | names, places, limits, sensors |
| `/history.json?point=P` | the past of a control point |
| `/curve.json?point=P` | its declared heating ratio against the angle of attack, at present |
| `/state.json`, `/lines` | the latest state; each state as it comes (WebSocket) |
| `/metrics` | Prometheus metrics |
| `/page` | what the page shows of each state (WebSocket) |
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
import hmac
import ipaddress
import json
import re
import secrets
import socket
from collections.abc import Awaitable, Callable, Iterator
from http.cookies import SimpleCookie
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import parse_qs, urlsplit

from sim_heating.base.errors import InputError
from sim_heating.live.outputs.display import Display, table_curve
from sim_heating.live.outputs.history import History, columns_json
from sim_heating.live.outputs.metrics import Metrics
from sim_heating.live.outputs.published import Latest, Published

if TYPE_CHECKING:
    from starlette.requests import Request
    from starlette.responses import Response
    from starlette.types import ASGIApp, Receive, Scope, Send
    from starlette.websockets import WebSocket

PORT = 8465
"""Where the page is, unless told otherwise."""
MOST_READERS = 64
"""Readers at one time; more are turned away."""
MOST_CONNECTIONS = 128
"""Connections at one time, with a page of six each for twenty browsers; more are closed at once."""
DESCRIPTORS_KEPT = 128
"""File descriptors that connections leave to the link, its sources and its journal."""
BACKLOG = 16
"""Connections that are accepted at a time: each takes a descriptor before it can be closed."""
HEADERS_S = 5.0
"""Time within which a connection has to send the headers of a request [s]."""
ON_ITS_WAY = 1 << 17
"""Bytes that may be on their way to a reader: what waits in a longer line is old when it arrives."""
LONGEST_WORD = 1024
"""Bytes that a reader may send in one message."""
SHORTEST_TOKEN = 16
"""Characters of a token: one that is shorter can be guessed."""

PAGE = Path(__file__).parents[1] / "page"
REPORT = Path(__file__).parents[2] / "base" / "report"
ASSETS = {
    "/": (PAGE / "live.html", "text/html; charset=utf-8"),
    "/live.css": (PAGE / "live.css", "text/css"),
    "/live.js": (PAGE / "live.js", "text/javascript"),
    "/look.css": (REPORT / "look.css", "text/css"),
    "/element.js": (REPORT / "element.js", "text/javascript"),
    "/chart.js": (REPORT / "chart.js", "text/javascript"),
    "/uPlot.css": (REPORT / "vendor" / "uPlot.min.css", "text/css"),
    "/uPlot.js": (REPORT / "vendor" / "uPlot.iife.min.js", "text/javascript"),
}
"""Files of the page, by address."""
HOST = re.compile(r"(?:\[[0-9A-Fa-f:.]+\]|[A-Za-z0-9._-]+)(?::[0-9]{1,5})?")
"""A name or an address with a port (RFC 3986, 3.2.2), as a request states whom it is for."""
POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; img-src data:; "
    "connect-src 'self' ws://{host} wss://{host}; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)


def is_loopback(host: str) -> bool:
    """Whether an address is reached from this machine alone."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return False


@contextlib.contextmanager
def _told_of_page(host: str, port: int) -> Iterator[None]:
    """Errors of an address as an InputError of one line."""
    try:
        yield
    except (OSError, OverflowError, UnicodeError) as error:
        if getattr(error, "errno", None) == errno.EADDRINUSE:
            raise InputError(f"page: port {port} of {host} is in use; give another by --port, or 0 for any") from None
        reason = getattr(error, "strerror", None) or str(error)
        problem = f"cannot listen at {host}, port {port}: {reason}"
        raise InputError(f"page: {problem}; give another --host or --port") from None


def listening_socket(host: str, port: int) -> socket.socket:
    """A socket that listens; port 0 takes a free one.

    raises : InputError for an address that is not of this machine, or a port in use
    """
    with _told_of_page(host, port):
        family, _, _, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        listener = socket.create_server(address, family=family)
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, ON_ITS_WAY)  # its connections inherit it
        return listener


def most_connections() -> int:
    """Connections that the page takes: fewer where a process may have few file descriptors."""
    try:
        from resource import RLIM_INFINITY, RLIMIT_NOFILE, getrlimit
    except ImportError:  # Windows
        return MOST_CONNECTIONS
    soft, _ = getrlimit(RLIMIT_NOFILE)
    return MOST_CONNECTIONS if soft == RLIM_INFINITY else max(min(MOST_CONNECTIONS, soft - DESCRIPTORS_KEPT), 8)


class PageServer:
    """Serves the page of a link.

    display : what the page shows besides the states
    host    : address to listen at; one that other machines reach needs a token
    port    : 0 takes a free one
    token   : what readers have to give; made where `host` needs one and None is given
    page    : whether there is a page, or the latest state and metrics alone
    raises  : InputError for a host that is none, and a token that can be guessed, or that no address can hold
    """

    def __init__(
        self,
        display: Display,
        *,
        host: str = "127.0.0.1",
        port: int = PORT,
        token: str | None = None,
        page: bool = True,
    ) -> None:
        with _told_of_page(host, port):
            socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)
        self.display, self.host, self.port = display, host, port
        if token is None and not is_loopback(host):
            token = secrets.token_urlsafe(SHORTEST_TOKEN)
        self.token = None if token is None else _checked_token(token)
        self.metrics = Metrics()
        self.has_page = page
        self._history = History()
        self._latest: Published | None = None
        self._readers: set[Latest] = set()
        self._served: asyncio.Task[None] | None = None

    @property
    def url(self) -> str:
        """Address of the page or else of the metrics, with its token; of this machine's name for all addresses."""
        host = self.host
        with contextlib.suppress(ValueError):
            if ipaddress.ip_address(host).is_unspecified:
                host = socket.gethostname()
        host = f"[{host}]" if ":" in host else host
        path = "" if self.has_page else "metrics"
        return f"http://{host}:{self.port}/{path}" + (f"?token={self.token}" if self.token else "")

    async def start(self) -> None:
        """Listen; raises InputError where the port cannot be used."""
        import uvicorn

        from sim_heating.live.outputs.connections import limited_protocol

        listener = listening_socket(self.host, self.port)
        self.port = listener.getsockname()[1]
        config = uvicorn.Config(
            self._guarded(self._application()),
            log_config=None,
            log_level="critical",
            access_log=False,
            lifespan="off",
            server_header=False,
            ws_max_size=LONGEST_WORD,
            ws_per_message_deflate=False,
            timeout_graceful_shutdown=1,
            http=limited_protocol(most_connections(), HEADERS_S),
            backlog=BACKLOG,
        )

        class Server(uvicorn.Server):
            @contextlib.contextmanager
            def capture_signals(self) -> Iterator[None]:  # signals belong to the program
                yield

        self._server = Server(config)
        self._served = asyncio.create_task(self._server.serve(sockets=[listener]))
        while not self._server.started:
            if self._served.done():
                self._served.result()
                raise InputError(f"page: the server at {self.host}, port {self.port}, did not start")
            await asyncio.sleep(0.01)

    def publish(self, published: Published) -> None:
        """Give a state to all readers; returns at once."""
        self._latest = published
        self.metrics.publish(published)
        if self.has_page:
            self._history.add(published.state)
        for reader in self._readers:
            reader.put(published)

    async def stop(self) -> None:
        """Take leave of the readers and stop listening."""
        if self._served is None:
            return
        await asyncio.sleep(0)  # the latest state is on its way
        self._server.should_exit = True
        with contextlib.suppress(asyncio.CancelledError):
            await self._served
        self._served = None

    # Who may read -------------------------------------------------------------------------------------------------

    def _guarded(self, inner: ASGIApp) -> ASGIApp:
        """Turns away who has no token, and pages of other sites: a browser that shows one may reach this machine."""
        from starlette.responses import PlainTextResponse, RedirectResponse
        from starlette.websockets import WebSocketClose

        async def guarded(scope: Scope, receive: Receive, send: Send) -> None:
            headers = {name.decode("latin-1").lower(): value.decode("latin-1") for name, value in scope["headers"]}
            refusal = self._refusal(scope, headers)
            if refusal is not None:
                can_answer = scope["type"] == "http" or "websocket.http.response" in scope.get("extensions", {})
                turned_away = PlainTextResponse(*refusal) if can_answer else WebSocketClose(1008)
                await turned_away(scope, receive, send)
                return
            if self.token and scope["type"] == "http" and _query(scope, "token") and scope["path"] == "/":
                answer = RedirectResponse("/", 303)  # the token leaves the address bar
                answer.set_cookie(self._cookie, self.token, httponly=True, samesite="strict")
                await answer(scope, receive, send)
                return
            await inner(scope, receive, send)

        return guarded

    @property
    def _cookie(self) -> str:
        return f"sim_heating_live_{self.port}"

    def _has_token(self, scope: Scope, headers: dict[str, str], token: str) -> bool:
        """Whether the address, the cookie or the header of a request holds the token."""
        cookie = SimpleCookie(headers.get("cookie", "")).get(self._cookie)
        stated = [
            _query(scope, "token"),
            "" if cookie is None else cookie.value,
            headers.get("authorization", "").removeprefix("Bearer "),
        ]
        return any(hmac.compare_digest(text.encode(), token.encode()) for text in stated)

    def _refusal(self, scope: Scope, headers: dict[str, str]) -> tuple[str, int] | None:
        """Text and status for who may not read; None for who may."""
        host, origin = headers.get("host", ""), headers.get("origin")
        if host and HOST.fullmatch(host) is None:  # it stands in the policy of the page, which `;` and blanks would end
            return "the host of this request is no name or address\n", 400
        try:
            site = None if origin is None else urlsplit(origin).netloc
        except ValueError:
            return "the origin of this request is no address\n", 400
        if self.token is None:
            if not is_loopback(host.rsplit(":", 1)[0]):
                return f"this page is at {self.url}\n", 421
        elif not self._has_token(scope, headers, self.token):
            return "this page needs its token: open the address that the program printed\n", 401
        if scope["type"] == "websocket" and site not in (None, host):
            return "not from another site\n", 403
        return None

    # What can be read ---------------------------------------------------------------------------------------------

    def _application(self) -> ASGIApp:
        from starlette.applications import Starlette
        from starlette.routing import Route, WebSocketRoute

        answers: dict[str, Callable[[Request], Awaitable[Response]]] = {
            "/state.json": self._state,
            "/metrics": self._metrics_text,
        }
        sockets: list[WebSocketRoute] = []
        if self.has_page:
            answers |= {"/static.json": self._static, "/history.json": self._history_of, "/curve.json": self._curve}
            answers |= dict.fromkeys(ASSETS, self._asset)
            sockets = [WebSocketRoute("/lines", self._lines), WebSocketRoute("/page", self._page_states)]
        routes = [Route(path, answer, methods=["GET"]) for path, answer in answers.items()]
        return Starlette(routes=[*routes, *sockets])

    async def _asset(self, request: Request) -> Response:
        path, kind = ASSETS[request.url.path]
        policy = POLICY.format(host=request.headers.get("host", ""))
        return _response(path.read_bytes(), kind, {"Content-Security-Policy": policy})

    async def _static(self, request: Request) -> Response:
        return _json_response(self.display.as_json())

    async def _history_of(self, request: Request) -> Response:
        columns = self._history.columns(request.query_params.get("point", ""))
        # written beside the link, which goes on meanwhile
        return await asyncio.to_thread(lambda: _json_response(columns_json(columns)))

    async def _curve(self, request: Request) -> Response:
        name = request.query_params.get("point", "")
        point = self.display.points.get(name)
        if point is None or point.table is None or self._latest is None:
            return _json_response({"alpha_deg": [], "ratio": []})
        state = self._latest.state
        declared = state.points[name].ratio_declared if name in state.points else None
        return _json_response(table_curve(point.table, state.conditions, declared))

    async def _state(self, request: Request) -> Response:
        line = "null" if self._latest is None else self._latest.line
        return _response(line.encode(), "application/json")

    async def _metrics_text(self, request: Request) -> Response:
        return _response(self.metrics.text(), self.metrics.content_type)

    async def _lines(self, websocket: WebSocket) -> None:
        await self._serve_reader(websocket, lambda published: published.line)

    async def _page_states(self, websocket: WebSocket) -> None:
        shown: str | None = None

        def show(point: str) -> None:
            nonlocal shown
            shown = point

        await self._serve_reader(websocket, lambda published: published.page(shown), show)

    async def _serve_reader(
        self, websocket: WebSocket, text_of: Callable[[Published], str], hear: Callable[[str], None] = lambda word: None
    ) -> None:
        """Send each state to a reader, or as many as it takes, until it has gone.

        text_of : what it is sent of a state;  hear : takes its words, after each of which it is sent the latest state
        """
        await websocket.accept()
        if len(self._readers) >= MOST_READERS:
            await websocket.close(1013, f"{MOST_READERS} readers are here already")
            return
        latest = Latest()

        def give_latest() -> None:
            if self._latest is not None:
                latest.put(self._latest)

        async def send() -> None:
            while True:
                await websocket.send_text(text_of(await latest.take()))

        async def listen() -> None:
            async for word in websocket.iter_text():
                hear(word)
                give_latest()

        give_latest()
        self._readers.add(latest)
        both = [asyncio.create_task(work()) for work in (send, listen)]
        try:
            await asyncio.wait(both, return_when=asyncio.FIRST_COMPLETED)
        finally:  # a reader that goes away, or sends what is no text, is no error
            self._readers.discard(latest)
            for task in both:
                task.cancel()
            await asyncio.gather(*both, return_exceptions=True)


def _checked_token(token: str) -> str:
    """A token as it is given; InputError for one that can be guessed, or that no address can hold."""
    if len(token) < SHORTEST_TOKEN or not re.fullmatch(r"[A-Za-z0-9._~-]*", token):
        raise InputError(
            f"page: a token has at least {SHORTEST_TOKEN} letters of English, digits or characters of . _ ~ -; give a "
            "longer one of these, or none for one that is made"
        )
    return token


def _query(scope: Scope, name: str) -> str:
    return parse_qs(scope.get("query_string", b"").decode("latin-1")).get(name, [""])[0]


def _json_response(value: Any) -> Response:
    return _response(json.dumps(value, separators=(",", ":"), allow_nan=False).encode(), "application/json")


def _response(body: bytes, kind: str, headers: dict[str, str] | None = None) -> Response:
    from starlette.responses import Response

    common = {"Cache-Control": "no-store", "X-Content-Type-Options": "nosniff", "Referrer-Policy": "no-referrer"}
    return Response(body, media_type=kind, headers=common | (headers or {}))
