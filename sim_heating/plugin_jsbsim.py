"""The plug-in in JSBSim: temperatures as properties that its scripts, functions and outputs can read.

After each frame `heating/<control point>/surface-K` and `bondline-K` hold the temperatures [K] at the end of that
frame, with `sensors=True` also `heating/<control point>/<sensor>-K`; JSBSim's own systems see them in the next frame. A
plug-in with `shortest_step_s` publishes when it has stepped.
"""

from __future__ import annotations

import numpy as np

from sim_heating.conditions import FloatArray
from sim_heating.plugin import HeatingPlugin
from sim_heating.trajectory.jsbsim_host import JSBSimHost

ROOT = "heating"


class JSBSimHeating:
    """A plug-in that publishes into a JSBSim host.

    Use as the `on_frame` of a flight, or call `frame()` after each `host.step()`.
    """

    def __init__(self, host: JSBSimHost, plugin: HeatingPlugin, *, sensors: bool = False) -> None:
        self.host = host
        self.plugin = plugin
        published = _published(plugin, sensors)
        self._writers = [host.publish(f"{ROOT}/{point}/{what}-K").set_double_value for point, what, _ in published]
        self._places = np.array([place for _, _, place in published])
        self._started = False

    def __call__(self, frame: FloatArray) -> None:
        """Advance to a frame of the host (conditions.FRAME) and publish."""
        if self._started:
            self.plugin.step(frame)
        else:
            self.plugin.reset(frame)
            self._started = True
        if self.plugin.heated_s < frame[0]:
            return
        values = self.plugin.ensemble.state[self._places].tolist()
        for write, value in zip(self._writers, values, strict=True):
            write(value)

    def frame(self) -> None:
        """Read the host's last frame, advance to it and publish."""
        self(self.host.read_frame())


def _published(plugin: HeatingPlugin, sensors: bool) -> list[tuple[str, str, int]]:
    """(control point, quantity, place in the state) of everything that is published."""
    out = []
    ensemble = plugin.ensemble
    for point, mesh, place in zip(plugin.points, ensemble.meshes, ensemble.places, strict=True):
        out.append((point.name, "surface", place.temperature(0)))
        out.append((point.name, "bondline", place.temperature(mesh.bondline)))
        if sensors:
            pairs = zip(point.sensors, mesh.sensors, strict=True)
            out += [(point.name, sensor.name, place.temperature(node)) for sensor, node in pairs]
    return out
