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
from sim_heating.trajectory.jsbsim import JSBSimEntry

SCENARIO = Path(__file__).parents[1] / "scenarios" / "popu_mach20.toml"
POINTS = 10
AIRBORNE_S, FRAMES, ROUNDS = 400.0, 600, 15


def _entry(scenario: Scenario) -> JSBSimEntry:
    return JSBSimEntry(scenario.declared.trajectory, scenario.vehicle.directory)


def _plugin(scenario: Scenario) -> HeatingPlugin:
    return HeatingPlugin(scenario.vehicle, list(scenario.vehicle.control_points)[:POINTS])


def _frames(entry: JSBSimEntry, count: int, on_frame: object = None) -> None:
    """So many frames of the host alone, without guidance."""
    host = entry.host
    for _ in range(count):
        host.step()
        if on_frame is not None:
            on_frame(host.read_frame())  # type: ignore[operator]


def _fly(scenario: Scenario, until_s: float = np.inf, heated: bool = True) -> tuple[JSBSimEntry, JSBSimHeating]:
    """An entry from the start, with the plug-in beside it, to a time or to its end."""
    entry = _entry(scenario)
    heating = JSBSimHeating(entry.host, _plugin(scenario))
    if heated:
        heating(entry.host.read_frame())
    while entry.host.time_s < until_s and not entry.ended():
        entry.command()
        for _ in range(entry.frames_a_command):
            entry.step(heating if heated else None)
    return entry, heating


def _recorded(entry: JSBSimEntry) -> list[FloatArray]:
    """Frames as the host gives them."""
    frames: list[FloatArray] = []
    _frames(entry, FRAMES, lambda frame: frames.append(np.array(frame)))
    return frames


def _replay(heating: JSBSimHeating, frames: list[FloatArray]) -> None:
    for frame in frames:
        heating(frame)


def _timed(scenario: Scenario, heated: bool) -> tuple[float, float]:
    """Wall time and simulated time [s] of a whole entry."""
    begun = time.perf_counter()
    entry, _ = _fly(scenario, heated=heated)
    return time.perf_counter() - begun, entry.host.time_s


def run() -> list[Figure]:
    """Time frames in the middle of an entry, then the whole entry with and without the plug-in."""
    scenario = load_scenario(SCENARIO)
    entry, heating = _fly(scenario, AIRBORNE_S)
    frames = _recorded(entry)
    before = heating.plugin.snapshot()
    times = in_turn(
        {
            "host": lambda: _frames(entry, FRAMES),
            "read": lambda: [entry.host.read_frame() for _ in range(FRAMES)],
            "heating": lambda: _replay(heating, frames),
            "plug-in": lambda: [heating.plugin.step(frame) for frame in frames],
        },
        ROUNDS,
        {name: lambda: heating.plugin.restore(before) for name in ("heating", "plug-in")},
    )
    us = {name: times.best(name) / FRAMES * 1e6 for name in times.seconds}
    alone, coupled = [], []
    for _ in range(3):
        alone.append(_timed(scenario, heated=False))
        coupled.append(_timed(scenario, heated=True))
    wall_s, flown_s = min(coupled)
    nodes = [mesh.nodes for mesh in heating.plugin.ensemble.meshes]
    figures = [
        Figure(
            f"added to a frame of {1.0 / (frames[1][0] - frames[0][0]):.0f} Hz by ten control points",
            us["read"] + us["heating"], "us", 10.0, note=f"{min(nodes)} to {max(nodes)} nodes",
        ),
        Figure("of that: reading the host's frame", us["read"], "us"),
        Figure("of that: deriving conditions and the thermal step", us["plug-in"], "us"),
        Figure("of that: publishing 20 properties", us["heating"] - us["plug-in"], "us"),
        Figure("JSBSim's own frame", us["host"], "us"),
        Figure("coupled entry, over real time", flown_s / wall_s, "x", 500.0, True, f"{flown_s:.0f} s"),
        Figure("the same entry without heating, over real time", flown_s / min(alone)[0], "x"),
    ]  # fmt: skip
    save("coupling", figures)
    return figures
