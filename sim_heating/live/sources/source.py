"""The sources of a link by their kind."""

from __future__ import annotations

import time
from collections.abc import AsyncIterator, Callable, Sequence
from dataclasses import dataclass

from sim_heating.base.errors import InputError
from sim_heating.base.files import display_path
from sim_heating.inputs.record import Record, load_record, load_records
from sim_heating.live.sources import mqtt, network, replay
from sim_heating.live.sources.decoder import Decoder, message_of
from sim_heating.live.sources.jsbsim_socket import JSBSimDecoder
from sim_heating.live.sources.json_lines import JsonDecoder
from sim_heating.live.sources.mqtt import MqttDecoder
from sim_heating.live.sources.packets import PacketDecoder
from sim_heating.live.spec import JSBSimOutput, Link, Mqtt, Network, Packets, Replay, Source
from sim_heating.live.types import Message

Remark = Callable[[str], None]
"""Called with one line on a source: who has connected, what is lost."""


def decoder_of(link: Link, source: Source) -> Decoder:
    """The decoder of a source's bodies; InputError where an XTCE document does not parse."""
    if isinstance(source, JSBSimOutput):
        return JSBSimDecoder(source.fields)
    if isinstance(source, Packets):
        document = link.file(source.xtce, "[[source]]: `xtce`")
        return PacketDecoder(document, source.container, source.apid)
    return MqttDecoder() if isinstance(source, Mqtt) else JsonDecoder()


@dataclass(frozen=True)
class SourceStream:
    """An open source: an asynchronous iterator of its messages.

    number  : of the source in the link, from 0
    decoder : of its bodies
    bodies  : as they come
    """

    number: int
    decoder: Decoder
    bodies: AsyncIterator[bytes]

    async def __aiter__(self) -> AsyncIterator[Message]:
        async for body in self.bodies:
            found = message_of(self.decoder, body, time.monotonic())
            # what holds no values is kept in the journal all the same: labels are needed to read what follows them
            yield Message(time.monotonic(), body, {}) if found is None else found


def open_source(link: Link, number: int, remark: Remark) -> SourceStream:
    """Open a source of a link.

    remark : called with one line on its connections
    raises : InputError with one line where it cannot be opened; a port in use is found at the first message
    """
    source = link.declared.source[number]
    decoder = decoder_of(link, source)
    if isinstance(source, Replay):
        return SourceStream(number, decoder, replay.bodies(replayed_records(link, source), source.speed))
    if isinstance(source, Mqtt):
        return SourceStream(number, decoder, mqtt.bodies(source, remark))
    assert isinstance(source, Network)
    file = None if source.file is None else link.file(source.file, "[[source]]: `file`")
    cut = network.cut_packets if isinstance(source, Packets) else network.cut_lines
    return SourceStream(number, decoder, network.bodies(source, cut, remark, file))


def replayed_records(link: Link, source: Replay) -> Sequence[Record]:
    """The records that a source replays; InputError where there are none, or they cannot be read."""
    if source.record is not None:
        return [load_record(link.file(source.record, "[[source]]: `record`"))]
    if not link.records:
        raise InputError(f"{display_path(link.path)}, [[source]]: `record` is missing; name the record to replay")
    return load_records([link.records[name] for name in link.names])
