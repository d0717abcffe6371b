"""The demonstration: an entry flown in JSBSim in a thread of this process, measured and sent as lines of JSON.

The plug-in marches the truth beside the flight, from entry interface on. What is sent begins shortly before the first
manoeuvre, as when a link comes up in mid-flight: flight conditions ten times and thermocouple words once in a second of
flight. Until then the flight goes as fast as it can.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import threading
import time
from collections.abc import AsyncIterator

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import FRAME
from sim_heating.base.errors import InputError, RunError
from sim_heating.base.files.package import data_folders
from sim_heating.inputs.scenario import Scenario
from sim_heating.inputs.sensor_model import measure
from sim_heating.live.sources.json_lines import JsonDecoder
from sim_heating.live.sources.network import Inbox
from sim_heating.live.sources.source import Remark, SourceStream
from sim_heating.live.spec import Link, load_link
from sim_heating.simulation.plugin import HeatingPlugin

TRUE_SCALE = 0.06
"""What the tables lack: the true heating ratio is so much above them [-]."""
SPEED = 10.0
"""Flight seconds a second."""
BEFORE_M_S = 150.0
"""Speed above that of the first manoeuvre at which the link comes up [m/s]: some 100 s before it."""
FRAMES_HZ, READINGS_HZ = 10.0, 1.0
EARLY_S = 1e-6


def demo_link() -> Link:
    """The link of the demonstration; InputError where the scenarios are not found."""
    for folder in data_folders("scenarios"):
        if (folder / "live" / "demo.toml").is_file():
            return load_link(folder / "live" / "demo.toml")
    raise InputError("scenarios/live/demo.toml: not found here; run the demonstration in a checkout of the project")


class DemoFlight:
    """The flight, and what is sent of it.

    speed : flight seconds a second from the first line on; 0 as fast as it can
    """

    def __init__(self, link: Link, speed: float, inbox: Inbox, loop: asyncio.AbstractEventLoop) -> None:
        if link.scenario is None or link.vehicle is None:
            raise InputError("demonstration: the link names no scenario to fly")
        self._scenario: Scenario = link.scenario
        self._points = link.points
        self._speed, self._inbox, self._loop = speed, inbox, loop
        self._plugin = HeatingPlugin(link.vehicle, link.names, parameters={"ratio.scale": TRUE_SCALE})
        self._rng = np.random.default_rng(1)
        self._begun: tuple[float, float] | None = None
        self._next_frame_s = self._next_reading_s = 0.0
        self._ended = threading.Event()
        manoeuvres = self._scenario.declared.trajectory.manoeuvre
        speeds = [m.at_velocity_m_s for m in manoeuvres if m.at_velocity_m_s is not None]
        self._begin_m_s = max(speeds, default=np.inf) + BEFORE_M_S

    def start(self) -> None:
        """Begin to fly."""
        threading.Thread(target=self._fly, name="flight", daemon=True).start()

    def stop(self) -> None:
        """End the flight at its next frame."""
        self._ended.set()

    def _fly(self) -> None:
        spec, vehicle = self._scenario.declared.trajectory, self._scenario.vehicle
        with contextlib.suppress(RuntimeError):  # of a loop that is closed
            try:
                if spec.source == "jsbsim":
                    from sim_heating.trajectory.jsbsim.entry import fly
                else:
                    from sim_heating.trajectory.entry3dof import fly  # type: ignore[assignment]
                fly(spec, vehicle, on_frame=self._on_frame)
            except _StoppedError:
                pass
            except (InputError, RunError) as error:
                self._put({"problem": str(error).splitlines()[0]})
            self._loop.call_soon_threadsafe(self._inbox.end)

    def _on_frame(self, frame: FloatArray) -> None:
        if self._ended.is_set():
            raise _StoppedError
        if np.isnan(self._plugin.time_s):
            self._plugin.reset(frame)
        else:
            self._plugin.step(frame)
        now_s = float(frame[0])
        if self._begun is None:
            if float(frame[FRAME.index("velocity_m_s")]) > self._begin_m_s:
                return
            self._begun = time.monotonic(), now_s
            self._next_frame_s = self._next_reading_s = now_s
        if now_s < self._next_frame_s - EARLY_S:
            return
        if self._speed > 0.0:
            begun, since_s = self._begun
            self._ended.wait(max(begun + (now_s - since_s) / self._speed - time.monotonic(), 0.0))
        self._next_frame_s += 1.0 / FRAMES_HZ
        values = dict(zip(FRAME, frame.tolist(), strict=True))
        if now_s >= self._next_reading_s - EARLY_S:
            self._next_reading_s += 1.0 / READINGS_HZ
            values |= self._words()
        self._put(values)

    def _words(self) -> dict[str, float]:
        """Words of all thermocouples now, with noise and rounding of the recorder [K]."""
        true = self._plugin.sensors_K
        return {
            s.column: float(measure(s, np.array([true[s.name]]), self._rng)[0])
            for point in self._points
            for s in point.sensors
        }

    def _put(self, values: dict[str, float] | dict[str, str]) -> None:
        line = json.dumps(values, separators=(",", ":")).encode()
        self._loop.call_soon_threadsafe(self._inbox.put, [line])


class _StoppedError(Exception):
    """Ends a flight from within its frame."""


def flight_source(speed: float):
    """A function that opens the only source of the demonstration, from a link, its number and a remark."""

    def opened(link: Link, number: int, remark: Remark) -> SourceStream:
        async def bodies() -> AsyncIterator[bytes]:
            inbox = Inbox(remark)
            flight = DemoFlight(link, speed, inbox, asyncio.get_running_loop())
            remark(f"{link.title}: flying to the manoeuvre")
            flight.start()
            try:
                async for body in inbox:
                    yield body
            finally:
                flight.stop()

        return SourceStream(number, JsonDecoder(), bodies())

    return opened
