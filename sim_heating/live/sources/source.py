"""The sources of a link by their kind."""

from __future__ import annotations

import time
from collections.abc import AsyncIterator, Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from sim_heating.base.errors import InputError, error_context
from sim_heating.base.files import display_path, raise_problems
from sim_heating.base.files.text import os_error_reason
from sim_heating.inputs.record import Record, load_record, load_records
from sim_heating.live.sources import mqtt, network, replay
from sim_heating.live.sources.decoder import Decoder, message_of
from sim_heating.live.sources.jsbsim_socket import JSBSimDecoder
from sim_heating.live.sources.json_lines import JsonDecoder
from sim_heating.live.sources.mapping import FieldMapping
from sim_heating.live.sources.mqtt import MqttDecoder
from sim_heating.live.sources.packets import PacketDecoder
from sim_heating.live.spec import JSBSimOutput, Link, Mqtt, Network, Packets, Replay, Source
from sim_heating.live.types import Message

FIRST_BYTES = 1 << 20
"""Bytes of a file in which its first message is looked for."""
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


def check_sources(link: Link, mapping: FieldMapping) -> None:
    """Open the files, documents and records that the sources name, and find in them what the mapping reads.

    raises : InputError with all that cannot be opened or decoded, and the fields that no source sends; sources whose
             fields are not known beforehand, as lines of a network, may send any
    """
    problems: list[str] = []
    sent: list[str] | None = []
    for source in link.declared.source:
        try:
            fields = _fields(link, source)
        except InputError as error:
            problems += error.problems
            continue
        sent = None if sent is None or fields is None else [*sent, *fields]
    raise_problems(problems)
    if sent:
        named = filter(None, (getattr(s, "xtce", None) or getattr(s, "record", None) for s in link.declared.source))
        mapping.check_sent(sent, ", ".join(dict.fromkeys(named)) or "its sources")


def _fields(link: Link, source: Source) -> Sequence[str] | None:
    """Fields that a source sends, after what it names has been opened; None where any may come."""
    decoder = decoder_of(link, source)
    if isinstance(source, Replay):
        return replay.fields_of(replayed_records(link, source))
    if isinstance(source, Network) and source.file is not None:
        _check_first(link.file(source.file, "[[source]]: `file`"), decoder, isinstance(source, Packets))
    if isinstance(decoder, PacketDecoder):
        return decoder.fields
    return source.fields or None if isinstance(source, JSBSimOutput) else None


def _check_first(path: Path, decoder: Decoder, is_packets: bool) -> None:
    """Read the first body of a file of bodies; InputError naming the file where it cannot be read or decoded."""
    try:
        with path.open("rb") as stream:
            begin = stream.read(FIRST_BYTES)
    except OSError as error:
        raise InputError(f"{display_path(path)}: {os_error_reason(error)}") from None
    cut = network.cut_packets if is_packets else network.cut_lines
    bodies = cut(bytearray(begin), len(begin) < FIRST_BYTES)
    with error_context(display_path(path)):
        if not bodies:
            raise InputError("holds no whole message; name the file that a source has written")
        decoder.decode(bodies[0])


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
            message = message_of(self.decoder, body, time.monotonic())
            # what holds no values is kept in the journal all the same: labels are needed to read what follows them
            yield Message(time.monotonic(), body, {}) if message is None else message


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
