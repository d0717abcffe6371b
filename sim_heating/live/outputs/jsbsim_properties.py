"""Estimates as properties of a running JSBSim, through its own input socket (`<input port="..."/>`).

JSBSim takes lines such as `set heating/V09T9527/surface_K 1234.5` and answers each with a prompt. Three things about it
(1.3.3) decide how it is written to:

- It sets properties that it has, and makes none. The first one that it lacks ends what it reads of that step.
- It reads once a step what has come, and drops a line that has come in part: lines go in parts that one packet of an
  Ethernet holds, each after the answers to the last.
- It takes one connection, and the next one only after a `quit`: a connection is kept while JSBSim is on hold.
"""

from __future__ import annotations

import asyncio
import math
from asyncio import StreamReader, StreamWriter
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING

from sim_heating.base.files.paths import os_error_reason
from sim_heating.live.outputs.lines import LARGEST_DATAGRAM
from sim_heating.live.outputs.published import Latest, Published
from sim_heating.live.state import State

if TYPE_CHECKING:
    from sim_heating.live.spec import Link

FIELDS = (
    "surface_K",
    "surface_sigma_K",
    "bondline_K",
    "bondline_sigma_K",
    "ratio",
    "ratio_sigma",
    "margin_K",
)
"""What is written of a control point, by its name in the state; what is not known keeps its last value in JSBSim."""
TIME = "time_s"
"""Flight time of the estimates, beside the control points: it stands still where nothing is written."""
PROMPT = b"JSBSim> "
DONE = ("", "set successful")
"""Answers to a value that was set, of earlier versions and of 1.3.3."""
ANSWER_S, RETRY_S, LEAVE_S = 5.0, 1.0, 2.0
"""Times [s]: without an answer until it is reported, between attempts to connect, to take leave."""


class JSBSimProperties:
    """Writes each state to a JSBSim, or as many as it takes; one that is not there is tried again.

    host, port : of its input socket
    prefix     : folder of the properties
    folders    : folder of each control point by its name
    remark     : called with one line where JSBSim is not there, goes away, does not answer or lacks a property
    """

    def __init__(
        self, host: str, port: int, prefix: str, folders: Mapping[str, str], remark: Callable[[str], None]
    ) -> None:
        self._host, self._port = host, port
        self._time = f"{prefix.rstrip('/')}/{TIME}"
        self._folders = dict(folders)
        self._remark = remark
        self._latest = Latest()
        self._last: Published | None = None
        self._is_ending = False
        self._is_told, self._is_connected = False, False
        self._task: asyncio.Task[None] | None = None

    @classmethod
    def of_link(cls, link: Link, remark: Callable[[str], None]) -> JSBSimProperties:
        """The output that `[output.jsbsim]` of a link declares; ValueError for a link without."""
        settings = link.declared.output.jsbsim
        if settings is None:
            raise ValueError(f"{link.path}: has no [output.jsbsim]")
        return cls(settings.host, settings.port, settings.prefix, link.property_folders, remark)

    def properties(self, state: State) -> list[tuple[str, float]]:
        """Names and values of what is known of a state.

        >>> from sim_heating.live.outputs.jsbsim_properties import JSBSimProperties
        >>> from sim_heating.live.state import PointState, State
        >>> output = JSBSimProperties("127.0.0.1", 5502, "heating", {"NOSE": "heating/NOSE"}, print)
        >>> output.properties(State(0, 2.5, 0.1, points={"NOSE": PointState(900.0, 5.0, 300.0, 1.0)}))[:2]
        [('heating/time_s', 2.5), ('heating/NOSE/surface_K', 900.0)]
        """
        values: list[tuple[str, float | None]] = [(self._time, state.time_s)]
        for name, point in state.points.items():
            values += [(f"{self._folders[name]}/{field}", getattr(point, field)) for field in FIELDS]
        return [(name, value) for name, value in values if value is not None and math.isfinite(value)]

    async def start(self) -> None:
        """Begin; the connection is made when there is an estimate to write."""
        self._task = asyncio.create_task(self._run())

    def publish(self, published: Published) -> None:
        """Give a state to JSBSim, when it takes it."""
        if published.state.time_s is not None and published.state.points:
            self._last = published
            self._latest.put(published)

    async def stop(self) -> None:
        """Write the last state where JSBSim still takes it, and close the connection."""
        if self._task is None:
            return
        self._is_ending = True
        if self._is_connected and self._last is not None:
            self._latest.put(self._last)
            await asyncio.wait({self._task}, timeout=LEAVE_S)
        self._task.cancel()
        await asyncio.gather(self._task, return_exceptions=True)

    def _tell_once(self, message: str) -> None:
        """A remark, until JSBSim answers again."""
        if not self._is_told:
            self._remark(f"JSBSim at {self._host}, port {self._port}, {message}")
            self._is_told = True

    async def _run(self) -> None:
        self._latest.put(await self._latest.take())  # a JSBSim that nothing came from yet need not be there
        while True:
            try:
                opening = asyncio.open_connection(self._host, self._port)
                reader, writer = await asyncio.wait_for(opening, ANSWER_S)
            except OSError as error:  # a time-out, too
                why = os_error_reason(error) or "no answer"
                self._tell_once(f"takes no connection ({why}); it is tried again: has it an <input> of this port?")
            else:
                try:
                    await self._write_to(reader, writer)
                    return
                except (OSError, EOFError, asyncio.LimitOverrunError):
                    self._tell_once("has gone; it is tried again")
                finally:
                    self._is_connected = False
                    writer.close()
            await asyncio.sleep(RETRY_S)

    async def _write_to(self, reader: StreamReader, writer: StreamWriter) -> None:
        """Write each state until the link ends; raises OSError or EOFError where JSBSim goes away."""
        await self._answer(reader)  # its greeting
        self._is_connected = True
        lacking: dict[str, str] = {}
        reported = 0
        while True:
            published = await self._latest.take()
            values = [(name, value) for name, value in self.properties(published.state) if name not in lacking]
            lacking |= await self._set(reader, writer, values)
            if len(lacking) > reported:
                self._tell_lacking(lacking)
                reported = len(lacking)
            if self._is_ending and published is self._last:
                writer.write(b"quit\n")
                await reader.read()
                return

    async def _set(
        self, reader: StreamReader, writer: StreamWriter, values: Sequence[tuple[str, float]]
    ) -> dict[str, str]:
        """Set properties; those that JSBSim refused with its answer."""
        refused: dict[str, str] = {}
        rest = [(name, f"set {name} {value:.9g}\n".encode()) for name, value in values]
        while rest:
            packet = _one_packet(rest)
            writer.write(b"".join(line for _, line in packet))
            await writer.drain()
            count = 0
            for name, _ in packet:
                answer = await self._answer(reader)
                count += 1
                if answer not in DONE:  # what comes after it in this part is not read
                    refused[name] = answer
                    break
            rest = rest[count:]
        return refused

    async def _answer(self, reader: StreamReader) -> str:
        """What JSBSim says before its next prompt, however long that takes: it may be on hold."""
        answering = asyncio.ensure_future(reader.readuntil(PROMPT))
        try:
            done, _ = await asyncio.wait({answering}, timeout=ANSWER_S)
            if not done:
                self._tell_once("does not answer; its properties stay as they are until it does")
            answer = await answering
        finally:
            answering.cancel()
        self._is_told = False
        return answer.removesuffix(PROMPT).decode("utf-8", errors="replace").strip()

    def _tell_lacking(self, lacking: Mapping[str, str]) -> None:
        (name, answer), *others = lacking.items()
        unlisted = f" and {len(others)} more" if others else ""
        self._remark(
            f"JSBSim at {self._host}, port {self._port}, does not set {name}{unlisted} ({answer}); declare what you "
            'need there, as <property value="0"> in the <run> of its script'
        )


def _one_packet(lines: Sequence[tuple[str, bytes]]) -> list[tuple[str, bytes]]:
    """The first lines that one packet of an Ethernet holds, at least one."""
    size, count = 0, 0
    for _, line in lines:
        size += len(line)
        if count and size > LARGEST_DATAGRAM:
            break
        count += 1
    return list(lines[:count])
