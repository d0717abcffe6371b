"""Topics of an MQTT broker, through aiomqtt.

A body is the topic, a zero byte and the payload. A payload that is a JSON object gives its fields, and a number or text
gives a field of the topic's name; a payload of a topic alone has no time, so its time is that of `time_s` in an object.
"""

from __future__ import annotations

import asyncio
import os
from collections.abc import AsyncIterator, Callable, Mapping

from sim_heating.base.errors import InputError
from sim_heating.base.files.text import abbreviated
from sim_heating.live.sources.decoder import flat
from sim_heating.live.sources.extra import need_extra
from sim_heating.live.sources.json_lines import JsonDecoder
from sim_heating.live.spec import Mqtt

PASSWORD = "SIM_HEATING_MQTT_PASSWORD"
RETRY_S = 1.0
"""Time between attempts to reach a broker [s]."""


class MqttDecoder:
    """Decodes topics and payloads."""

    def __init__(self) -> None:
        self._json = JsonDecoder()

    def decode(self, body: bytes) -> Mapping[str, float | str] | None:
        """Fields of one payload; InputError where it is not JSON."""
        topic, separator, payload = body.partition(b"\0")
        if not separator:
            raise InputError("a message without a topic")
        if payload.lstrip()[:1] == b"{":
            return self._json.decode(payload)
        name, text = (item.decode("utf-8", errors="replace").strip() for item in (topic, payload))
        try:
            return flat({name: float(text)})
        except ValueError:
            raise InputError(f"topic {name}: {abbreviated(text)} is neither JSON nor a number") from None


async def bodies(settings: Mqtt, remark: Callable[[str], None]) -> AsyncIterator[bytes]:
    """Bodies of a broker's topics; a broker that goes away is reached again.

    remark : called with one line where the broker is lost or cannot be reached
    """
    need_extra("aiomqtt")
    import aiomqtt

    where, lost = f"MQTT broker {settings.host}:{settings.port}", False
    while True:
        try:
            password = os.environ.get(PASSWORD) if settings.user is not None else None
            async with aiomqtt.Client(
                settings.host, settings.port, username=settings.user, password=password
            ) as client:
                for topic in settings.topics:
                    await client.subscribe(topic, qos=1)
                if lost:
                    remark(f"{where} is reached again")
                lost = False
                async for message in client.messages:
                    payload = message.payload if isinstance(message.payload, bytes) else str(message.payload).encode()
                    yield str(message.topic).encode() + b"\0" + payload
        except aiomqtt.MqttError as error:
            if not lost:
                remark(f"{where} cannot be reached ({str(error).partition(chr(10))[0]}); trying again")
            lost = True
            await asyncio.sleep(RETRY_S)
