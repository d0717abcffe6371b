"""What all decoders share: from a body to a message, and values as numbers or texts by field."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

from sim_heating.base.errors import InputError
from sim_heating.live.types import Message, too_long

MOST_FIELDS = 10_000
"""Fields of one message; a message with more is damaged."""


class Decoder(Protocol):
    """Decodes the bodies of one source, in the order in which they came."""

    def decode(self, body: bytes) -> Mapping[str, float | str] | None:
        """Field -> value as sent; None for a body that holds no values, as a line of labels.

        raises : InputError with one line where the body cannot be read
        """
        ...


def message_of(decoder: Decoder, body: bytes, arrived_s: float) -> Message | None:
    """The message of a body, damaged where it cannot be read or kept; None for a body without values."""
    if (problem := too_long(body)) is not None:
        return Message(arrived_s, body, {}, problem)
    try:
        values = decoder.decode(body)
    except InputError as error:
        return Message(arrived_s, body, {}, error.problems[0])
    return None if values is None else Message(arrived_s, body, values)


def flat(value: Any, name: str = "") -> dict[str, float | str]:
    """Nested objects and lists as one table of fields: `NAME.KEY`, `NAME[0]`; null is not a number.

    raises : InputError where there are too many fields
    """
    fields: dict[str, float | str] = {}
    waiting = [(name, value)]
    while waiting:
        path, item = waiting.pop()
        if isinstance(item, Mapping):
            waiting += [(f"{path}.{k}" if path else str(k), v) for k, v in item.items()]
        elif isinstance(item, (list, tuple)):
            waiting += [(f"{path}[{i}]", v) for i, v in enumerate(item)]
        elif item is None:
            fields[path] = float("nan")
        elif isinstance(item, str):
            fields[path] = item
        else:
            fields[path] = _as_float(item)
        if len(fields) + len(waiting) > MOST_FIELDS:
            raise InputError(f"a message of more than {MOST_FIELDS} fields")
    return fields


def _as_float(value: Any) -> float:
    try:
        return float(value)
    except OverflowError:
        return float("inf")
