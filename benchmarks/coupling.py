"""Beside JSBSim: what the heating of ten control points adds to a frame; a coupled entry against real time."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np

from benchmarks.measure import Figure, in_turn, save
from sim_heating.conditions import FloatArray
from sim_heating.plugin import HeatingPlugin
from sim_heating.plugin_jsbsim import JSBSimHeating
from sim_heating.scenario import Scenario, load_scenario
from sim_heating.trajectory.flight import OnFrame
from sim_heating.trajectory.jsbsim import JSBSimEntry

SCENARIO = Path(__file__).parents[1] / "scenarios" / "popu_mach20.toml"
POINTS = 10
EVERY_THIRD_S = 0.05
"""Shortest thermal step [s] with which a 60 Hz host heats every third frame."""
AIRBORNE_S, FRAMES, ROUNDS, ENTRIES = 400.0, 600, 15, 3


def _entry(scenario: Scenario) -> JSBSimEntry:
    return JSBSimEntry(scenario.declared.trajectory, scenario.vehicle.directory)


def _plugin(scenario: Scenario, shortest_step_s: float = 0.0) -> HeatingPlugin:
    names = list(scenario.vehicle.control_points)[:POINTS]
    return HeatingPlugin(scenario.vehicle, names, shortest_step_s=shortest_step_s)


def _frames(entry: JSBSimEntry, count: int, on_frame: OnFrame) -> None:
    """So many frames of the host alone, without guidance."""
    host = entry.host
    for _ in range(count):
        host.step()
        on_frame(host.read_frame())


def _fly(entry: JSBSimEntry, on_frame: OnFrame | None, until_s: float = np.inf) -> None:
    """An entry from its start to a time or to its end."""
    if on_frame is not None:
        on_frame(entry.host.read_frame())
    while entry.host.time_s < until_s and not entry.ended():
        entry.command()
        for _ in range(entry.frames_a_command):
            entry.step(on_frame)


def _recorded(entry: JSBSimEntry) -> list[FloatArray]:
    """Frames as the host gives them."""
    frames: list[FloatArray] = []
    _frames(entry, FRAMES, lambda frame: frames.append(np.array(frame)))
    return frames


def _replay(heating: JSBSimHeating, frames: list[FloatArray]) -> None:
    for frame in frames:
        heating(frame)


def _whole_entry(scenario: Scenario, plugin: HeatingPlugin | None) -> tuple[float, JSBSimEntry]:
    """Wall time [s] of a whole entry, and the entry."""
    entry = _entry(scenario)
    heating = None if plugin is None else JSBSimHeating(entry.host, plugin)
    begun = time.perf_counter()
    _fly(entry, heating)
    return time.perf_counter() - begun, entry


def run() -> list[Figure]:
    """Time frames in the middle of an entry, then the whole entry with and without the plug-in."""
    scenario = load_scenario(SCENARIO)
    begun = time.perf_counter()
    plugin = _plugin(scenario)
    making_s = time.perf_counter() - begun
    entry = _entry(scenario)
    heating = JSBSimHeating(entry.host, plugin)
    _fly(entry, heating, AIRBORNE_S)
    frames = _recorded(entry)
    before = plugin.snapshot()
    replays = in_turn(
        {
            "read": lambda: [entry.host.read_frame() for _ in range(FRAMES)],
            "heating": lambda: _replay(heating, frames),
            "plug-in": lambda: [plugin.step(frame) for frame in frames],
        },
        ROUNDS,
        {name: lambda: plugin.restore(before) for name in ("heating", "plug-in")},
    )
    us = {name: replays.best(name) / FRAMES * 1e6 for name in replays.seconds}
    third = _plugin(scenario, EVERY_THIRD_S)
    alone, coupled, thirds = [], [], []
    for _ in range(ENTRIES):
        alone.append(_whole_entry(scenario, None)[0])
        wall_s, flown = _whole_entry(scenario, plugin)
        coupled.append(wall_s)
        thirds.append(_whole_entry(scenario, third)[0])
    flown_s, count = flown.host.time_s, flown.host.frames
    added, added_third = ((min(runs) - min(alone)) / count * 1e6 for runs in (coupled, thirds))
    nodes = [mesh.nodes for mesh in plugin.ensemble.meshes]
    shown = f"{POINTS} points of {min(nodes)} to {max(nodes)} nodes"
    figures = [
        Figure("added to a frame at 60 Hz, mean over the entry", added, "us", 10.0, note=shown),
        Figure("the same, heating with every third frame (shortest_step_s 0.05)", added_third, "us", 10.0, note=shown),
        Figure("the frame without heating, guidance included", min(alone) / count * 1e6, "us"),
        Figure("coupled entry, over real time", flown_s / min(coupled), "x", 500.0, True, f"{flown_s:.0f} s"),
        Figure("the same, heating with every third frame", flown_s / min(thirds), "x", 500.0, True),
        Figure("the same entry without heating, over real time", flown_s / min(alone), "x"),
        Figure("replayed without the host: reading a frame", us["read"], "us"),
        Figure("replayed: deriving conditions and the thermal step", us["plug-in"], "us"),
        Figure("replayed: publishing", us["heating"] - us["plug-in"], "us"),
        Figure("making the plug-in, meshes chosen, kernels loaded", making_s, "s"),
    ]
    save("coupling", figures)
    return figures
