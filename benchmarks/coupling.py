"""Alongside JSBSim: what the heating of ten control points adds to a frame; a coupled entry against real time."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from benchmarks.measure import Figure, in_turn, save
from sim_heating.base.arrays import FloatArray
from sim_heating.inputs.scenario import Scenario, load_scenario
from sim_heating.simulation.plugin import LONGEST_WAIT_S, HeatingPlugin
from sim_heating.simulation.plugin_jsbsim import JSBSimHeating
from sim_heating.trajectory.flight import OnFrame
from sim_heating.trajectory.jsbsim.entry import JSBSimEntry

SCENARIO = Path(__file__).parents[1] / "scenarios" / "popu_mach20.toml"
POINTS = 10
AIRBORNE_S, FRAMES, ROUNDS, ENTRIES = 400.0, 600, 15, 5


def _entry(scenario: Scenario) -> JSBSimEntry:
    return JSBSimEntry(scenario.declared.trajectory, scenario.vehicle)


def _plugin(scenario: Scenario, longest_wait_s: float = LONGEST_WAIT_S) -> HeatingPlugin:
    names = list(scenario.vehicle.control_points)[:POINTS]
    return HeatingPlugin(scenario.vehicle, names, longest_wait_s=longest_wait_s)


def _frames(entry: JSBSimEntry, count: int, on_frame: OnFrame) -> None:
    """A number of frames of the host alone, without guidance."""
    host = entry.host
    for _ in range(count):
        host.step()
        on_frame(host.read_frame())


def _fly(entry: JSBSimEntry, on_frame: OnFrame | None, until_s: float = np.inf) -> list[float]:
    """An entry from its start to a time or to its end; the time [s] when each command began, and the end."""
    begun = [time.perf_counter()]
    if on_frame is not None:
        on_frame(entry.host.read_frame())
    while entry.host.time_s < until_s and not entry.ended():
        entry.command()
        for _ in range(entry.frames_a_command):
            entry.step(on_frame)
        begun.append(time.perf_counter())
    return begun


def _recorded(entry: JSBSimEntry) -> list[FloatArray]:
    """Frames as the host gives them."""
    frames: list[FloatArray] = []
    _frames(entry, FRAMES, lambda frame: frames.append(np.array(frame)))
    return frames


def _replay(heating: Callable[[FloatArray], object], frames: list[FloatArray]) -> None:
    for frame in frames:
        heating(frame)


def _whole_entries(scenario: Scenario, plugins: Mapping[str, HeatingPlugin | None]) -> dict[str, float]:
    """Wall time of a whole entry [s] with each plug-in, or with none.

    Each is flown ENTRIES times, in turn, the same frames every time. Of each tenth of a second of the flight, from
    command to command, the shortest counts: a busy machine interrupts a flight of two seconds, seldom its tenths.
    """
    shortest: dict[str, FloatArray] = {}
    for _ in range(ENTRIES):
        for name, plugin in plugins.items():
            entry = _entry(scenario)
            heating = None if plugin is None else JSBSimHeating(entry.host, plugin)
            took = np.diff(_fly(entry, heating))
            shortest[name] = np.minimum(shortest.get(name, took), took)
    return {name: float(np.sum(took)) for name, took in shortest.items()}


def _apart_K(scenario: Scenario, one: HeatingPlugin, other: HeatingPlugin) -> tuple[float, JSBSimEntry]:
    """Largest difference between the temperatures of two plug-ins over all frames of an entry [K], and the entry."""
    entry = _entry(scenario)
    frames: list[FloatArray] = []
    _fly(entry, lambda frame: frames.append(frame.copy()))
    largest = 0.0
    for i, frame in enumerate(frames):
        for plugin in (one, other):
            if i == 0:
                plugin.reset(frame)
            else:
                plugin.step(frame)
        largest = max(largest, float(np.max(np.abs(one.temperatures() - other.temperatures()))))
    return largest, entry


def run() -> list[Figure]:
    """Time frames in the middle of an entry, then the whole entry with and without the plug-in."""
    scenario = load_scenario(SCENARIO)
    begun = time.perf_counter()
    plugin = _plugin(scenario)
    making_s = time.perf_counter() - begun
    every = _plugin(scenario, 0.0)
    entry = _entry(scenario)
    heating, heating_every = JSBSimHeating(entry.host, plugin), JSBSimHeating(entry.host, every)

    def heat_both(frame: FloatArray) -> None:
        heating(frame)
        heating_every(frame)

    _fly(entry, heat_both, AIRBORNE_S)
    frames = _recorded(entry)
    before, before_every = plugin.snapshot(), every.snapshot()
    replays = in_turn(
        {
            "read": lambda: [entry.host.read_frame() for _ in range(FRAMES)],
            "heating": lambda: _replay(heating, frames),
            "plug-in": lambda: _replay(plugin.step, frames),
            "every": lambda: _replay(every.step, frames),
        },
        ROUNDS,
        {
            "heating": lambda: plugin.restore(before),
            "plug-in": lambda: plugin.restore(before),
            "every": lambda: every.restore(before_every),
        },
    )
    us = {name: replays.best(name) / FRAMES * 1e6 for name in replays.seconds}
    wall_s = _whole_entries(scenario, {"alone": None, "coupled": plugin, "every": every})
    apart_K, flown = _apart_K(scenario, plugin, every)
    added = {name: (wall_s[name] - wall_s["alone"]) / flown.host.frames * 1e6 for name in wall_s}
    faster = {name: flown.host.time_s / wall_s[name] for name in wall_s}
    nodes = [mesh.nodes for mesh in plugin.ensemble.meshes]
    shown = f"{POINTS} points of {min(nodes)} to {max(nodes)} nodes"
    figures = [
        Figure("added to a frame at 60 Hz, mean over the entry", added["coupled"], "us", 10.0, note=shown),
        Figure("the same, a thermal step with every frame (longest_wait_s 0)", added["every"], "us"),
        Figure("the frame without heating, guidance included", wall_s["alone"] / flown.host.frames * 1e6, "us"),
        Figure("coupled entry, over real time", faster["coupled"], "x", 500.0, True, f"{flown.host.time_s:.0f} s"),
        Figure("the same, a thermal step with every frame", faster["every"], "x"),
        Figure("the same entry without heating, over real time", faster["alone"], "x"),
        Figure("largest difference of any temperature between the two", apart_K, "K", 0.02),
        Figure("replayed without the host: reading a frame", us["read"], "us"),
        Figure("replayed: looking at a frame, thermal steps", us["plug-in"], "us"),
        Figure("replayed: a thermal step with every frame", us["every"], "us"),
        Figure("replayed: publishing", us["heating"] - us["plug-in"], "us"),
        Figure("making the plug-in, meshes chosen, kernels loaded", making_s, "s"),
    ]
    save("coupling", figures)
    return figures
