"""Sources over real sockets: each gives the messages that were sent, and a problem of its own is one line."""

from __future__ import annotations

import asyncio
import json
import socket
import subprocess
import sys
import time

import pytest

from sim_heating.base.errors import InputError
from sim_heating.live.sources import decoder_of, open_source
from sim_heating.live.sources.decoder import message_of
from tests.live.links import example, free_port, json_lines, link, received

ROWS = [{"time_s": k / 10.0, "alpha_deg": 40.0 + k} for k in range(20)]


def times(messages) -> list[float]:
    return [m.values["time_s"] for m in messages]


def send_udp(port: int, *datagrams: bytes) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as own:
        for data in datagrams:
            own.sendto(data, ("127.0.0.1", port))


def test_lines_of_json_come_in_datagrams_of_one_or_several():
    port = free_port()
    made = link({"kind": "json-lines", "port": port})
    found = received(made, 20, lambda: send_udp(port, *(json_lines(ROWS[k : k + 4]) for k in range(0, 20, 4))))
    assert times(found) == [row["time_s"] for row in ROWS]
    assert found[3].body == json.dumps(ROWS[3]).encode()


def test_lines_of_json_come_from_several_connections_in_pieces():
    port = free_port(socket.SOCK_STREAM)
    made = link({"kind": "json-lines", "transport": "tcp-server", "port": port})
    said: list[str] = []

    def send() -> None:
        for half in (ROWS[:10], ROWS[10:]):
            with socket.create_connection(("127.0.0.1", port)) as own:
                data = json_lines(half)
                for k in range(0, len(data), 7):
                    own.sendall(data[k : k + 7])
                time.sleep(0.1)

    assert times(received(made, 20, send, said)) == [row["time_s"] for row in ROWS]
    assert said[0].endswith("has connected")


def test_a_connection_that_is_open_at_the_end_of_a_link_is_no_error(caplog):
    port = free_port(socket.SOCK_STREAM)
    made = link({"kind": "json-lines", "transport": "tcp-server", "port": port})
    with socket.socket() as own:

        def send() -> None:
            own.connect(("127.0.0.1", port))
            own.sendall(json_lines(ROWS[:10]))

        received(made, 10, send)
    assert not caplog.records


@pytest.mark.thorough
def test_a_client_waits_for_its_server_and_connects_again():
    port = free_port(socket.SOCK_STREAM)
    made = link({"kind": "json-lines", "transport": "tcp-client", "port": port})
    said: list[str] = []

    def serve() -> None:
        time.sleep(0.2)
        with socket.create_server(("127.0.0.1", port)) as server:
            for half in (ROWS[:10], ROWS[10:]):
                peer, _ = server.accept()
                with peer:
                    peer.sendall(json_lines(half))

    assert times(received(made, 20, serve, said)) == [row["time_s"] for row in ROWS]
    assert any("Connect call failed" in line or "refused" in line for line in said)
    assert any("has closed the connection; trying again" in line for line in said)


def test_a_file_is_read_from_its_beginning_to_its_end(tmp_path):
    (tmp_path / "lines.json").write_bytes(json_lines(ROWS) + b'{"time_s": 9')  # cut off
    made = link({"kind": "json-lines", "transport": "file", "file": str(tmp_path / "lines.json")}, root=tmp_path)
    found = received(made, 100)
    assert times(found[:-1]) == [row["time_s"] for row in ROWS]
    assert "is not JSON" in found[-1].damaged


@pytest.mark.thorough
def test_standard_input_is_a_source():
    code = (
        "from tests.live.links import link, received\n"
        "found = received(link({'kind': 'json-lines', 'transport': 'stdin'}), 100)\n"
        "print([m.values['time_s'] for m in found])"
    )
    done = subprocess.run([sys.executable, "-c", code], input=json_lines(ROWS), capture_output=True, check=True)
    assert json.loads(done.stdout) == [row["time_s"] for row in ROWS]


def test_a_port_in_use_is_one_line():
    for transport, kind in (("udp", socket.SOCK_DGRAM), ("tcp-server", socket.SOCK_STREAM)):
        with socket.socket(socket.AF_INET, kind) as other:
            other.bind(("127.0.0.1", 0))
            if kind == socket.SOCK_STREAM:
                other.listen()
            port = other.getsockname()[1]
            with pytest.raises(InputError, match=f"port {port} of 127.0.0.1 is in use; end the other program") as told:
                received(link({"kind": "json-lines", "transport": transport, "port": port}), 1)
            assert len(told.value.problems) == 1


def test_an_address_of_another_machine_is_one_line():
    with pytest.raises(InputError, match=r"UDP port 5500 of 192\.0\.2\.1") as told:
        received(link({"kind": "json-lines", "host": "192.0.2.1"}), 1)
    assert len(told.value.problems) == 1


@pytest.mark.parametrize("body", [b"[1, 2]", b"hello", b'{"time_s": ', b"\xff\xfe", b"[" * 100_000, b"{}" * 3])
def test_what_is_no_json_object_is_a_damaged_message(body):
    made = link({"kind": "json-lines"})
    found = message_of(decoder_of(made, made.declared.source[0]), body, 0.0)
    assert 0 < len(found.damaged) < 700
    assert "\n" not in found.damaged


def test_nested_objects_and_lists_are_fields():
    made = link({"kind": "json-lines"})
    body = b'{"time_s": 1, "tc": [300.5, null], "air": {"rho": 1e-4}, "mode": "entry", "on": true}'
    values = dict(message_of(decoder_of(made, made.declared.source[0]), body, 0.0).values)
    assert str(values.pop("tc[1]")) == "nan"
    assert values == {"time_s": 1.0, "tc[0]": 300.5, "air.rho": 1e-4, "mode": "entry", "on": 1.0}


def test_ten_thousand_damaged_messages_are_ten_thousand_lines_and_no_crash():
    import random

    rng = random.Random(1)
    for kind in (
        {"kind": "json-lines"},
        {"kind": "jsbsim", "fields": ["Time", "a"]},
        {"kind": "mqtt", "topics": ["a"]},
    ):
        made = link(kind)
        decoder = decoder_of(made, made.declared.source[0])
        for _ in range(3400):
            body = rng.randbytes(rng.randrange(1, 60))
            found = message_of(decoder, body, 0.0)
            assert found is None or found.damaged or found.values is not None


# JSBSim --------------------------------------------------------------------------------------------------------------


def test_values_of_jsbsim_have_the_names_of_its_line_of_labels():
    made = link({"kind": "jsbsim"})
    decoder = decoder_of(made, made.declared.source[0])
    assert "labels has not come" in message_of(decoder, b"0.1, 5000", 0.0).damaged
    assert message_of(decoder, b"<LABELS> ,Time,altitude_ft", 0.0) is None
    assert message_of(decoder, b"         0.1,    4999.971", 0.0).values == {"Time": 0.1, "altitude_ft": 4999.971}
    assert "has 1 values for 2 labels" in message_of(decoder, b"0.2", 0.0).damaged


# CCSDS ---------------------------------------------------------------------------------------------------------------


def packets(count: int) -> list[bytes]:
    """Packets of APID 42: time in ms, altitude in ft, a recorder word."""
    import struct

    found = []
    for k in range(count):
        data = struct.pack(">IfH", 100 * k, 240000.0 - k, 200 + k % 50)
        found.append(struct.pack(">HHH", (1 << 11) * 0 | 42, 0xC000 | k % 16384, len(data) - 1) + data)
    return found


def ccsds(**keys):
    source = {"kind": "ccsds", "xtce": str(example("entry.xml")), **keys}
    return link(source)


def test_packets_come_by_udp_and_by_tcp_in_pieces():
    sent = packets(30)
    port = free_port()
    found = received(
        ccsds(port=port), 30, lambda: send_udp(port, *(b"".join(sent[k : k + 3]) for k in range(0, 30, 3)))
    )
    assert [m.values["TIME_MS"] for m in found] == [100.0 * k for k in range(30)]
    assert found[7].values["ALTITUDE_FT"] == 240000.0 - 7
    port = free_port(socket.SOCK_STREAM)

    def send() -> None:
        with socket.create_connection(("127.0.0.1", port)) as own:
            data = b"".join(sent)
            for k in range(0, len(data), 11):
                own.sendall(data[k : k + 11])

    found = received(ccsds(transport="tcp-server", port=port), 30, send)
    assert [m.body for m in found] == sent


def test_packets_of_other_applications_are_not_read():
    links = ccsds(apid=[42]), ccsds(apid=[7])
    found = [decoder_of(own, own.declared.source[0]).decode(packets(1)[0]) for own in links]
    assert found[0]["TIME_MS"] == 0.0
    assert found[1] is None


def test_a_packet_that_was_cut_off_or_has_other_contents_is_damaged():
    made = ccsds()
    decoder = decoder_of(made, made.declared.source[0])
    whole = packets(1)[0]
    assert message_of(decoder, whole, 0.0).damaged == ""
    assert "cut off" in message_of(decoder, whole[:-1], 0.0).damaged
    assert message_of(decoder, b"\x00", 0.0).damaged
    short = whole[:4] + (1).to_bytes(2, "big") + b"ab"
    assert "does not fit the XTCE document" in message_of(decoder, short, 0.0).damaged


def test_a_document_that_is_no_xtce_is_one_line(tmp_path):
    (tmp_path / "no.xml").write_text("<SpaceSystem><unclosed>")
    for name, problem in ((tmp_path / "no.xml", "is no XTCE document"), (tmp_path / "absent.xml", "absent.xml")):
        made = link({"kind": "ccsds", "xtce": str(name)}, root=tmp_path)
        with pytest.raises(InputError, match=problem) as told:
            open_source(made, 0, print)
        assert len(told.value.problems) == 1
    with pytest.raises(InputError, match="there is no container `Packet`; it has"):
        open_source(ccsds(container="Packet"), 0, print)


# MQTT ----------------------------------------------------------------------------------------------------------------


def test_topics_of_a_broker_are_a_source():
    amqtt = pytest.importorskip("amqtt.broker")
    aiomqtt = pytest.importorskip("aiomqtt")
    port = free_port(socket.SOCK_STREAM)
    made = link({"kind": "mqtt", "port": port, "topics": ["entry/#"]})
    said: list[str] = []

    async def main():
        config = {
            "listeners": {"default": {"type": "tcp", "bind": f"127.0.0.1:{port}"}},
            "plugins": {"amqtt.plugins.authentication.AnonymousAuthPlugin": {"allow_anonymous": True}},
        }
        stream = open_source(made, 0, said.append).__aiter__()
        first = asyncio.ensure_future(stream.__anext__())
        await asyncio.sleep(0.3)  # there is no broker yet
        broker = amqtt.Broker(config)
        await broker.start()
        found = []
        try:
            async with aiomqtt.Client("127.0.0.1", port) as client:
                while not first.done():
                    await client.publish("entry/state", json.dumps({"time_s": 0.5, "alpha_deg": 40.0}), qos=1)
                    await asyncio.sleep(0.2)
                found.append(await first)
                await client.publish("entry/tc/1", "512.5", qos=1)
                while not found[-1].body.startswith(b"entry/tc/1"):
                    found.append(await asyncio.wait_for(stream.__anext__(), 10.0))
        finally:
            await stream.aclose()
            await broker.shutdown()
        return found

    found = asyncio.run(asyncio.wait_for(main(), 60.0))
    assert found[0].values == {"time_s": 0.5, "alpha_deg": 40.0}
    assert found[-1].values == {"entry/tc/1": 512.5}
    assert any("cannot be reached" in line for line in said)
    assert any("is reached again" in line for line in said)


# Replay --------------------------------------------------------------------------------------------------------------


def test_a_broker_is_told_the_user_of_a_link(monkeypatch):
    monkeypatch.setenv("SIM_HEATING_MQTT_PASSWORD", "secret of a test")
    with socket.create_server(("127.0.0.1", 0)) as broker:
        source = {"kind": "mqtt", "port": broker.getsockname()[1], "topics": ["t"], "user": "flight-test"}

        async def first_packet() -> bytes:
            stream = open_source(link(source), 0, print).__aiter__()
            waiting = asyncio.ensure_future(stream.__anext__())
            own, _ = await asyncio.to_thread(broker.accept)
            try:
                return await asyncio.to_thread(own.recv, 1000)
            finally:
                own.close()
                waiting.cancel()

        connect = asyncio.run(first_packet())
    assert b"flight-test" in connect
    assert b"secret of a test" in connect


def test_a_replay_keeps_the_pace_it_is_told_to():
    made = link({"kind": "replay", "record": "../records/practice/p06", "speed": 100.0})
    begun = time.monotonic()
    found = received(made, 101)
    assert times(found) == [float(k) for k in range(101)]
    assert 0.95 < time.monotonic() - begun < 60.0  # 100 s at 100 times real time, on a machine however busy
    fast = link({"kind": "replay", "record": "../records/practice/p06", "speed": 0.0})
    assert len(received(fast, 10_000)) == 1454
