"""Links for tests, and what sends to them over real sockets."""

from __future__ import annotations

import asyncio
import json
import socket
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from sim_heating.base.conditions import Conditions
from sim_heating.inputs.record import Segments, load_record, write_record
from sim_heating.live.sources import open_source
from sim_heating.live.spec import Link, make_link
from sim_heating.live.types import Message
from tests.support.paths import ROOT

PLACE = ROOT / "scenarios" / "live" / "test.toml"
"""File that names of the links are relative to; it does not exist."""
FRAME = {
    "time_s": 0.0, "altitude_m": 74e3, "velocity_m_s": 6800.0, "alpha_deg": 40.0, "beta_deg": 0.0,
    "elevon_deg": 1.0, "bodyflap_deg": 15.0, "rho_kg_m3": 4.6e-5,
}  # fmt: skip
"""A message with flight conditions by the names and units of a record."""


def part_of_record(record: Path, begin_s: float, end_s: float, place: Path) -> Path:
    """Write the part of a record between two times [s], all of it to be fitted; the directory."""
    whole = load_record(record)

    def within(columns: Mapping[str, Any]) -> dict[str, Any]:
        t = columns["time_s"]
        return {name: values[(t >= begin_s) & (t <= end_s)] for name, values in columns.items()}

    part = replace(
        whole,
        declared=whole.declared.model_copy(update={"segments": Segments()}),
        conditions=Conditions(within(dict(whole.conditions.columns))),
        thermocouples=within(dict(whole.thermocouples)),
    )
    write_record(part, place)
    return place


def link(source: Mapping[str, Any] | None = None, root: Path | None = None, **keys: Any) -> Link:
    """A link of one control point with one source."""
    data = {"format": "link/1", "vehicle": "orbiter", "control_points": ["V09T9527"], **keys}
    if source is not None:
        data["source"] = [dict(source)]
    return make_link(data, PLACE, root=root)


def free_port(kind: socket.SocketKind = socket.SOCK_DGRAM) -> int:
    """A port that was free a moment ago."""
    with socket.socket(socket.AF_INET, kind) as own:
        own.bind(("127.0.0.1", 0))
        return int(own.getsockname()[1])


def json_lines(rows: Iterable[Mapping[str, Any]]) -> bytes:
    return b"".join(json.dumps(row).encode() + b"\n" for row in rows)


def messages_of(made: Link) -> list[Message]:
    """All messages of a link's source, which ends by itself."""

    async def main() -> list[Message]:
        return [m async for m in open_source(made, 0, print)]

    return asyncio.run(main())


def received(
    made: Link,
    count: int,
    send: Callable[[], Any] | None = None,
    remarks: list[str] | None = None,
    wait_s: float = 20.0,
) -> list[Message]:
    """The first messages of a link's source; `send` is called in a thread once the source is open."""

    async def main() -> list[Message]:
        found: list[Message] = []
        said = [] if remarks is None else remarks
        stream = open_source(made, 0, said.append).__aiter__()
        first = asyncio.ensure_future(stream.__anext__())
        await asyncio.sleep(0.05)  # the source opens at the first message that is asked for
        sending = None if send is None else asyncio.create_task(asyncio.to_thread(send))
        try:
            found.append(await asyncio.wait_for(first, wait_s))
            while len(found) < count:
                found.append(await asyncio.wait_for(stream.__anext__(), wait_s))
        except StopAsyncIteration:
            pass
        finally:
            await stream.aclose()
            if sending is not None:
                await sending
        return found

    return asyncio.run(main())


def example(name: str) -> Path:
    return Path(__file__).parent / "data" / name
