"""Outputs of a link besides the page: who may read, slow readers, lines of JSON, metrics."""

from __future__ import annotations

import asyncio
import contextlib
import json
import shutil
import socket
import subprocess
import time
from dataclasses import replace
from urllib.error import HTTPError
from urllib.request import HTTPRedirectHandler, Request, build_opener

import numpy as np
import pytest
from prometheus_client.parser import text_string_to_metric_families
from websockets.asyncio.client import connect
from websockets.asyncio.server import serve
from websockets.exceptions import InvalidStatus

from sim_heating.base.errors import InputError
from sim_heating.live.outputs.display import Display, table_curve
from sim_heating.live.outputs.history import History
from sim_heating.live.outputs.lines import LARGEST_DATAGRAM, datagrams, lines_to
from sim_heating.live.outputs.published import Published
from sim_heating.live.outputs.server import PageServer, is_loopback
from sim_heating.live.state import RemovedSensor, State, plain
from tests.live.links import link
from tests.support.served import Loop, Served, served

NOTHING = Display("nothing", {})
PROMTOOL = shutil.which("promtool")
"""Prometheus's own check of its text format; None where it is not installed."""


class _NoRedirect(HTTPRedirectHandler):
    def redirect_request(self, *args):
        return None


def ask(url, method="GET", **headers):
    """Status, headers and text of an answer."""
    try:
        with build_opener(_NoRedirect).open(Request(url, method=method, headers=headers), timeout=10) as answer:
            return answer.status, answer.headers, answer.read().decode()
    except HTTPError as error:
        return error.code, error.headers, error.read().decode()


async def first_message(url, **options):
    async with connect(url, compression=None, **options) as reader:
        return json.loads(await reader.recv())


@pytest.fixture(scope="module")
def state(flown):
    """A state in the middle of the POPU."""
    *_, last = flown.states(flown.popu_s, flown.popu_s + 12.0)
    return last


# Who may read --------------------------------------------------------------------------------------------------------


def test_a_port_in_use_is_told_in_one_line():
    with socket.create_server(("127.0.0.1", 0)) as taken, Loop() as loop:
        port = taken.getsockname()[1]
        with pytest.raises(InputError, match=f"^page: port {port} of 127.0.0.1 is in use; give another by --port"):
            loop.run(PageServer(NOTHING, port=port).start())
        with pytest.raises(InputError, match=r"^page: cannot listen at 192\.0\.2\.1"):  # no machine has it
            loop.run(PageServer(NOTHING, host="192.0.2.1", port=0).start())


@pytest.mark.parametrize("host", ["a;b", "my machine", " localhost", "", "a\0b", "[::1]x"])
def test_a_host_that_is_none_is_refused_before_the_flight_is_followed(host):
    with pytest.raises(InputError, match=r"^page: cannot listen at .*; give another --host or --port"):
        PageServer(NOTHING, host=host)


def test_a_link_file_names_the_host_that_is_none():
    with pytest.raises(InputError, match=r"\[output\]: `host`: \"a;b\" is no name or address of a machine"):
        link(output={"host": "a;b"})


def test_other_machines_read_with_the_token_alone(state):
    with served(NOTHING, host="0.0.0.0") as (server, page):
        page.publish(state)
        here = f"http://127.0.0.1:{server.port}/"
        for path in ("", "state.json", "metrics", "static.json"):
            assert ask(here + path)[0] == 401
            assert ask(f"{here}{path}?token=guess")[0] == 401
        with pytest.raises(InvalidStatus):
            asyncio.run(first_message(f"ws://127.0.0.1:{server.port}/lines"))
        status, headers, _ = ask(f"{here}?token={server.token}")
        assert (status, headers["Location"]) == (303, "/")
        assert "HttpOnly" in headers["Set-Cookie"]
        cookie = headers["Set-Cookie"].partition(";")[0]
        assert ask(here, Cookie=cookie)[0] == 200
        assert ask(f"{here}metrics", Authorization=f"Bearer {server.token}")[0] == 200
        url = f"ws://127.0.0.1:{server.port}/lines?token={server.token}"
        assert asyncio.run(first_message(url))["sequence"] == state.sequence


def test_this_machine_needs_no_token_and_other_sites_get_nothing(state):
    assert is_loopback("127.0.0.1")
    assert is_loopback("::1")
    assert is_loopback("localhost")
    assert not is_loopback("0.0.0.0")
    with served(NOTHING) as (server, page):
        page.publish(state)
        assert "token" not in server.url
        assert ask(server.url)[0] == 200
        assert ask(server.url, Host="elsewhere.invalid")[0] == 421  # a name that was made to lead here
        for host in ("127.0.0.1; script-src *", "local host", "127.0.0.1:80:80", "[::1"):  # which the policy would hold
            assert ask(server.url, Host=host)[0] == 400
        assert ask(server.url, Origin="http://[bad")[0] == 400
        socket_url = f"ws://127.0.0.1:{server.port}/page"
        with pytest.raises(InvalidStatus):
            asyncio.run(first_message(socket_url, origin="http://elsewhere.invalid"))
        with pytest.raises(InvalidStatus) as no_address:
            asyncio.run(first_message(socket_url, origin="http://[bad"))
        assert no_address.value.response.status_code == 400
        own = f"http://127.0.0.1:{server.port}"
        assert asyncio.run(first_message(socket_url, origin=own))["sequence"] == state.sequence


def test_readers_change_nothing(state):
    with served(NOTHING) as (server, page):
        page.publish(state)
        for path in ("", "state.json", "static.json", "history.json", "curve.json", "metrics"):
            for method in ("POST", "PUT", "DELETE", "PATCH"):
                assert ask(server.url + path, method)[0] == 405
        assert json.loads(ask(f"{server.url}state.json")[2]) == plain(state)


def test_without_a_page_there_are_metrics_and_the_latest_state_alone(state):
    with served(NOTHING, page=False) as (server, page):
        page.publish(state)
        assert server.url == f"http://127.0.0.1:{server.port}/metrics"
        assert "sim_heating_surface_kelvin" in ask(server.url)[2]
        here = f"http://127.0.0.1:{server.port}/"
        assert json.loads(ask(f"{here}state.json")[2]) == plain(state)
        for path in ("", "static.json", "history.json", "curve.json", "live.js"):
            assert ask(here + path)[0] == 404
        with pytest.raises(InvalidStatus):
            asyncio.run(first_message(f"ws://127.0.0.1:{server.port}/lines"))


def test_a_token_that_is_given_is_the_one_that_readers_need(state):
    token = "a-token.of_mine~2026"
    with served(NOTHING, token=token, page=False) as (server, page):  # on this machine, too
        page.publish(state)
        url = f"http://127.0.0.1:{server.port}/metrics"
        assert server.url == f"{url}?token={token}"
        assert ask(url)[0] == 401
        assert ask(url, Authorization=f"Bearer {token}")[0] == 200
        assert ask(server.url)[0] == 200


@pytest.mark.parametrize("token", ["", "short", "fifteen-letters", "sixteen letters!", "käse-und-trauben-dazu"])
def test_a_token_that_can_be_guessed_or_does_not_fit_an_address_is_refused(token):
    with pytest.raises(InputError, match=r"^page: a token has at least 16 letters of English.*; give a longer"):
        PageServer(NOTHING, token=token)


# Connections that ask for nothing ------------------------------------------------------------------------------------


@pytest.mark.thorough
def test_idle_connections_are_few_and_closed_for_later_readers(state, monkeypatch):
    monkeypatch.setattr("sim_heating.live.outputs.server.most_connections", lambda: 8)
    monkeypatch.setattr("sim_heating.live.outputs.server.HEADERS_S", 0.5)
    with served(NOTHING) as (server, page), contextlib.ExitStack() as held:
        page.publish(state)
        half = [held.enter_context(socket.create_connection(("127.0.0.1", server.port))) for _ in range(40)]
        half[0].sendall(b"GET / HT")
        time.sleep(0.3)
        assert 1 <= sum(not _is_closed(one) for one in half) <= 8
        time.sleep(0.5)
        assert all(_is_closed(one) for one in half)
        assert ask(f"http://127.0.0.1:{server.port}/state.json")[0] == 200


def _is_closed(connection: socket.socket) -> bool:
    connection.setblocking(False)
    try:
        return connection.recv(1) == b""
    except BlockingIOError:
        return False
    except ConnectionError:
        return True


# Slow readers --------------------------------------------------------------------------------------------------------


@pytest.mark.thorough
def test_a_slow_reader_holds_nobody_back_and_sees_the_latest(state):
    """400 states, 8 MB, while one reader sleeps: the other has them as they come, the sleeper misses most."""
    states = [State(k, state.time_s, 0.0, state.conditions, state.points) for k in range(400)]

    async def read(url, until, wakes):
        seen = []
        narrow = socket.socket()
        narrow.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 16)
        narrow.connect(("127.0.0.1", server.port))
        async with connect(url, compression=None, max_queue=1, sock=narrow) as reader:
            await wakes.wait()
            async for line in reader:
                seen.append((json.loads(line)["sequence"], time.monotonic()))
                if seen[-1][0] >= until:
                    return seen
        return seen

    with served(NOTHING) as (server, page), Loop() as readers:
        url = f"ws://127.0.0.1:{server.port}/lines"
        now, later = asyncio.Event(), asyncio.Event()
        now.set()
        tasks = [asyncio.run_coroutine_threadsafe(read(url, 399, wakes), readers._loop) for wakes in (now, later)]
        time.sleep(0.5)
        longest = 0.0
        for k in states:
            longest = max(longest, page.publish(k))
            time.sleep(0.005)
        published = time.monotonic()
        readers.call(later.set)
        awake, asleep = (task.result(30) for task in tasks)
    assert longest < 0.5  # of a machine that does other things, too
    assert awake[-1][1] - published < 1.0
    assert len(awake) > 100
    assert asleep[-1][0] == 399
    assert len(asleep) < len(states) / 4  # what was on its way, and the latest


def test_a_reader_that_goes_away_is_forgotten(state):
    with served(NOTHING) as (server, page):
        page.publish(state)
        for _ in range(3):
            asyncio.run(first_message(f"ws://127.0.0.1:{server.port}/lines"))
        deadline = time.monotonic() + 5.0
        while server._readers and time.monotonic() < deadline:
            time.sleep(0.02)
        assert not server._readers


# Lines of JSON -------------------------------------------------------------------------------------------------------


def flat(value, path=""):
    if isinstance(value, dict):
        return {k: v for name, inner in value.items() for k, v in flat(inner, f"{path}/{name}".lstrip("/")).items()}
    if isinstance(value, list):
        return {k: v for i, inner in enumerate(value) for k, v in flat(inner, f"{path}[{i}]").items()}
    return {} if value is None else {path: value}


def test_datagrams_together_are_the_state(state):
    """Each fits a packet of an Ethernet and has the time; none is lost on a machine to itself."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as display, Loop() as loop:
        display.bind(("127.0.0.1", 0))
        display.settimeout(1.0)
        lines = lines_to(f"udp://127.0.0.1:{display.getsockname()[1]}")
        loop.run(lines.start())
        Served(loop, lines).publish(state)
        wanted, found = flat(Published(state).scalars), {}
        while len(found) < len(wanted) + 1:
            datagram = display.recv(65536)
            assert len(datagram) <= LARGEST_DATAGRAM
            found |= (part := json.loads(datagram))
            assert part["timestamp"] == part["time_s"] == state.time_s
        loop.run(lines.stop())
    assert found == wanted | {"timestamp": state.time_s}
    assert found["points/OE/surface_K"] == state.points["OE"].surface_K


@pytest.mark.thorough
def test_a_display_that_comes_late_and_restarts_gets_the_lines(state):
    received: list[dict] = []

    async def take(connection):
        received.append(json.loads(await connection.recv()))

    async def main():
        with socket.create_server(("127.0.0.1", 0)) as probe:
            port = probe.getsockname()[1]
        lines = lines_to(f"ws://127.0.0.1:{port}")
        await lines.start()
        for _ in range(2):
            async with serve(take, "127.0.0.1", port):
                count = len(received)
                while len(received) == count:
                    lines.publish(Published(state))
                    await asyncio.sleep(0.05)
        await lines.stop()

    asyncio.run(asyncio.wait_for(main(), 30))
    assert received[0]["timestamp"] == state.time_s
    assert received[-1]["points"]["OE"]["surface_K"] == state.points["OE"].surface_K


class AsPlotJuggler:
    """Series as PlotJuggler's parser of JSON makes them with `timestamp` as its field of time.

    From the first message on in which that is no number, it takes the time of arrival instead.
    """

    def __init__(self):
        self.series, self._has_stamp = {}, True

    def take(self, message, arrived_s):
        found = json.loads(message)
        stamp = found.get("timestamp")
        self._has_stamp = self._has_stamp and isinstance(stamp, int | float)
        for path, value in flat(found).items():
            if isinstance(value, int | float):
                self.series.setdefault(path, []).append((stamp if self._has_stamp else arrived_s, value))


def test_plotjuggler_display_has_flight_times_from_the_first_line_on(flown, state):
    """It listens from before the first sample on; nothing that it gets lacks a time."""
    states = [State(0, None, 0.1), State(1, None, 0.2), *flown.states(flown.popu_s, flown.popu_s + 0.5)]
    wanted = [(s.time_s, s.points["OE"].surface_K) for s in states[2:]]
    by_udp, by_socket = AsPlotJuggler(), AsPlotJuggler()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as display, Loop() as loop:
        display.bind(("127.0.0.1", 0))
        display.settimeout(0.5)
        lines = lines_to(f"udp://127.0.0.1:{display.getsockname()[1]}")
        loop.run(lines.start())
        for published in states:
            Served(loop, lines).publish(published)
        for _ in range(sum(len(datagrams(Published(s))) for s in states[2:])):
            by_udp.take(display.recv(2048), 1e9)  # as much of a datagram as it reads
        loop.run(lines.stop())

    async def by_web_socket():
        async def take(connection):
            async for message in connection:
                by_socket.take(message, 1e9)

        with socket.create_server(("127.0.0.1", 0)) as probe:
            port = probe.getsockname()[1]
        async with serve(take, "127.0.0.1", port):
            lines = lines_to(f"ws://127.0.0.1:{port}")
            await lines.start()
            for published in states:
                lines.publish(Published(published))
                await asyncio.sleep(0.05)
            while len(by_socket.series.get("points/OE/surface_K", ())) < 1:
                await asyncio.sleep(0.05)
            await lines.stop()

    asyncio.run(asyncio.wait_for(by_web_socket(), 30))
    assert by_udp.series["points/OE/surface_K"] == wanted
    assert set(by_socket.series["points/OE/surface_K"]) <= set(wanted)


@pytest.mark.parametrize("address", ["127.0.0.1:9870", "http://127.0.0.1:9870", "udp://127.0.0.1", "udp://h:99999"])
def test_an_address_that_is_none_of_a_display_is_told(address):
    with pytest.raises(InputError, match=r"^lines: .*give udp://HOST:PORT, ws://HOST:PORT"):
        lines_to(address)


# Metrics, past, tables -----------------------------------------------------------------------------------------------


def test_metrics_are_those_of_the_latest_state(state):
    with served(NOTHING) as (server, page):
        assert ask(f"{server.url}metrics")[2].strip() == ""
        page.publish(state)
        text = ask(f"{server.url}metrics")[2]
    samples = {
        (s.name, tuple(sorted(s.labels.items()))): s.value
        for f in text_string_to_metric_families(text)
        for s in f.samples
    }
    point = state.points["OE"]
    assert samples["sim_heating_surface_kelvin", (("point", "OE"),)] == point.surface_K
    assert samples["sim_heating_link_state", (("state", "live"),)] == 1.0
    assert samples["sim_heating_link_late_total", ()] == state.link.late
    scale = (("parameter", "ratio.scale"), ("point", "OE"), ("unit", "-"))
    assert samples["sim_heating_parameter", scale] == point.parameters["ratio.scale"].value
    future = (("future", "planned"), ("point", "OE"))
    assert samples["sim_heating_ahead_limit_probability", future] == point.ahead["planned"].probability


@pytest.mark.skipif(PROMTOOL is None, reason="needs promtool of Prometheus, which is not installed")
def test_prometheus_s_own_check_has_no_complaint_of_the_metrics(state):
    removed = RemovedSensor("OE", "OE_surface", 12.0, 'stuck at "1\\n"')
    with served(NOTHING) as (server, page):
        page.publish(replace(state, removed=[removed], missing=replace(state.missing, threshold=None)))
        status, headers, text = ask(f"{server.url}metrics")
    assert (status, headers.get_content_type()) == (200, "text/plain")
    checked = subprocess.run([PROMTOOL, "check", "metrics"], input=text, capture_output=True, text=True, timeout=60)
    assert (checked.returncode, checked.stdout + checked.stderr) == (0, "")


def test_the_past_is_bounded_and_its_latest_part_whole(state):
    past = History()
    for k in range(20_000):
        past.add(State(k, 0.1 * k, 0.0, state.conditions, {"OE": state.points["OE"]}))
    times = past.columns("OE")["time_s"]
    assert len(times) <= 2400
    assert times[0] == 0.0
    assert np.all(np.diff(times) > 0.0)
    assert np.diff(times)[-1000:] == pytest.approx(0.1)  # two minutes at 10 Hz as they came
    assert np.max(np.diff(times)) < 4.0
    assert past.columns("elsewhere") == {}


def test_the_drawn_table_meets_the_declared_ratio_at_present(flown, state):
    table = flown.display.points["OE"].table
    declared = state.points["OE"].ratio_declared
    curve = table_curve(table, state.conditions, declared)
    at = np.interp(state.conditions["alpha_deg"], curve["alpha_deg"], curve["ratio"])
    assert at == pytest.approx(declared, rel=1e-3)  # between drawn angles


def test_displays_of_the_link_are_told_of_sensors_by_their_place(flown):
    places = {name: own.near for name, own in flown.display.points["LS"].sensors.items()}
    assert places.pop("LS_surface") == "surface"
    assert places.pop("LS_bond") == "bondline"
    assert set(places.values()) == {"within"}
