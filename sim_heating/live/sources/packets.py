"""CCSDS space packets, described by an XTCE document, through space-packet-parser."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping, Sequence
from itertools import accumulate, takewhile
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from sim_heating.base.errors import InputError
from sim_heating.base.files import display_path, raise_problems, read_text, repeated_name
from sim_heating.base.files.xml import check_xml
from sim_heating.live.sources.extra import need_extra

SIZES = (None, *range(1, 65))
"""Bits of a number that is read; None where they are not known."""
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
        containers = list(getattr(self._definition, "containers", {}))
        if container not in containers:
            names = ", ".join(containers[:6]) or "none"
            raise InputError(f"{display_path(document)}: there is no container `{container}`; it has {names}")
        entries = list(_entries(self._definition, container))
        raise_problems([f"{display_path(document)}, {line}" for line in _size_problems(entries, container)])
        self.fields = tuple(dict.fromkeys(str(entry.name) for _, entry in entries))
        """Parameters that packets of the container, and of those that inherit from it, may have."""

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
        content = document.read_bytes()
        check_xml(content)
        definition = load_xtce(document)
        twice = next(_repeated(content), None)
    except Exception as error:  # lxml and the library raise errors of many kinds
        rule = f"is no XTCE document that can be read ({_first_line(error)})"
        raise InputError(f"{display_path(document)}: {rule}") from None
    if twice is not None:
        raise InputError(f"{display_path(document)}: {twice}")
    return definition


def _repeated(content: bytes) -> Iterator[str]:
    """What an XTCE document may define once and defines again, of which the library takes the last, or both."""
    for element in ElementTree.fromstring(content).iter():
        kind = _local(element.tag)
        if kind.endswith("Set"):
            names, has = _stated(element, "name"), f"{kind} defines"
        elif kind == "EntryList":
            names, has = _stated(element, "parameterRef"), "an EntryList has"
        else:
            tags = [_local(child.tag) for child in element]
            names = [tag for tag in tags if tag.endswith(("DataEncoding", "Set", "List", "MetaData"))]
            has = f"{kind} `{element.get('name', '')}` has"
        if (twice := repeated_name(names)) is not None:
            yield f"{has} {twice} twice; remove one"


def _stated(element: ElementTree.Element, key: str) -> list[str]:
    """What the elements within one state under a key."""
    return [f"`{child.attrib[key]}`" for child in element if key in child.attrib]


def _local(tag: object) -> str:
    return str(tag).rpartition("}")[2]


def _entries(definition: Any, name: str, enclosing: tuple[str, ...] = ()) -> Iterator[tuple[bool, Any]]:
    """Parameters of a container, of those in it, and of those that inherit from it, and whether each is in all packets.

    enclosing : containers that this one is in
    """
    container = definition.containers[name]
    for entry in container.entry_list:
        if not hasattr(entry, "entry_list"):
            yield not enclosing, entry
        elif entry.name not in enclosing:
            yield from ((is_common and not enclosing, e) for is_common, e in _entries(definition, entry.name, ()))
    for heir in container.inheritors:
        if heir not in enclosing:
            yield from ((False, e) for _, e in _entries(definition, heir, (*enclosing, name)))


def _bits(entry: Any) -> int | None:
    """Bits of a number; None for texts and for what has a length that other parameters state."""
    size = getattr(entry.parameter_type.encoding, "size_in_bits", None)
    return size if isinstance(size, int) else None


def _size_problems(entries: Sequence[tuple[bool, Any]], container: str) -> list[str]:
    """Numbers of sizes that no number has; a container that begins with no primary header, or has no whole bytes."""
    for _, entry in entries:
        if (bits := _bits(entry)) not in SIZES:
            return [f"parameter `{entry.name}`: a number of {bits} bits cannot be; correct `sizeInBits`"]
    sizes = [_bits(entry) for is_common, entry in entries if is_common]
    ends = list(accumulate(filter(None, takewhile(bool, sizes))))
    has_all_sizes = len(ends) == len(sizes)
    if (has_all_sizes or max(ends, default=0) > 8 * HEADER) and 8 * HEADER not in ends:
        rule = f"its parameters do not end at the {8 * HEADER} bits of a primary header; correct their sizes"
        return [f"container `{container}`: {rule}"]
    if len(ends) == len(entries) and ends[-1] % 8:
        return [f"container `{container}`: has {ends[-1]} bits, and packets are of whole bytes; correct their sizes"]
    return []


def _first_line(error: Exception) -> str:
    text = str(error) or type(error).__name__
    return text.splitlines()[0]


def _value(value: Any) -> float | str:
    if isinstance(value, (bytes, bytearray)):
        return value.hex()
    return value if isinstance(value, str) else float(value)
