"""CCSDS space packets, described by an XTCE document, through space-packet-parser."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from sim_heating.base.errors import InputError
from sim_heating.base.files import display_path, read_text
from sim_heating.live.sources.extra import need_extra

HEADER = 6
"""Bytes of a primary header; its last two hold the length of what follows less one (CCSDS 133.0-B-2, 4.1.3.5)."""


def packet_length(data: bytes | bytearray) -> int | None:
    """Bytes of the packet that begins the data; None where its header is not complete."""
    return HEADER + int.from_bytes(data[4:6], "big") + 1 if len(data) >= HEADER else None


class PacketDecoder:
    """Decodes packets.

    document  : the XTCE document
    container : name of its root container
    apid      : application process identifiers that are read; all where None
    raises    : InputError where the document does not parse or lacks the container

    Values are calibrated as the document states; a parameter of the raw words has no calibrator there.
    """

    def __init__(self, document: Path, container: str = "CCSDSPacket", apid: Sequence[int] | None = None) -> None:
        self._definition = _definition(document)
        self._container, self._apid = container, None if apid is None else frozenset(apid)
        known = list(getattr(self._definition, "containers", {}))
        if container not in known:
            names = ", ".join(known[:6]) or "none"
            raise InputError(f"{display_path(document)}: there is no container `{container}`; it has {names}")

    def decode(self, body: bytes) -> Mapping[str, float | str] | None:
        """Values of one packet by parameter; None for one of another identifier; InputError where it is damaged."""
        length = packet_length(body)
        if length is None or length != len(body):
            stated = "no whole header" if length is None else f"a header of a packet of {length}"
            raise InputError(f"a packet of {len(body)} bytes has {stated} bytes; it was cut off, or is no CCSDS packet")
        apid = int.from_bytes(body[:2], "big") & 0x7FF
        if self._apid is not None and apid not in self._apid:
            return None
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # a remark on each packet of a length that the document does not state
                packet = self._definition.parse_bytes(body, root_container_name=self._container)
        except Exception as error:  # the library raises errors of many kinds on bits that fit no container
            raise InputError(f"packet of APID {apid} does not fit the XTCE document ({_first_line(error)})") from None
        return {str(name): _value(value) for name, value in packet.items()}


def _definition(document: Path) -> Any:
    need_extra("space_packet_parser")
    from space_packet_parser import load_xtce

    read_text(document)  # a file that is absent, a directory or not text has the message of all files
    try:
        return load_xtce(document)
    except Exception as error:  # lxml and the library raise errors of many kinds
        rule = f"is no XTCE document that can be read ({_first_line(error)})"
        raise InputError(f"{display_path(document)}: {rule}") from None


def _first_line(error: Exception) -> str:
    text = str(error) or type(error).__name__
    return text.splitlines()[0]


def _value(value: Any) -> float | str:
    if isinstance(value, (bytes, bytearray)):
        return value.hex()
    return value if isinstance(value, str) else float(value)
