"""The plug-in in JSBSim: temperatures as properties that its scripts, functions and outputs can read.

After each frame `heating/<control point>/surface-K` and `bondline-K` hold the temperatures [K] at the end of that
frame, with `sensors=True` also `heating/<control point>/<sensor>-K`; JSBSim's own systems see them in the next frame.
"""

from __future__ import annotations

import operator
from collections import deque

from sim_heating.base.arrays import FloatArray
from sim_heating.simulation.plugin import HeatingPlugin
from sim_heating.simulation.plugin_kernel import GOOD
from sim_heating.trajectory.jsbsim.host import JSBSimHost

ROOT = "heating"


class JSBSimHeating:
    """A plug-in that publishes into a JSBSim host.

    Use as the `on_frame` of a flight, or call `frame()` after each `host.step()`.
    """

    def __init__(self, host: JSBSimHost, plugin: HeatingPlugin, *, sensors: bool = False) -> None:
        self.host = host
        self.plugin = plugin
        published = plugin.outputs if sensors else plugin.outputs[: 2 * len(plugin.names)]
        self._writers = [host.publish(f"{ROOT}/{point}/{output}-K").set_double_value for point, output in published]
        self._values = plugin.temperatures()[: len(published)]
        self._watch = plugin.watch
        self._started = False

    def __call__(self, frame: FloatArray) -> None:
        """Advance to a frame that the host has read, and publish; as HeatingPlugin.step."""
        if self._started:
            outcome = self._watch(frame)
            if outcome != GOOD:
                self.plugin.handle(frame, outcome)
        else:
            self.plugin.reset(frame)
            self._started = True
        # An iterator consumed without a loop in Python: this line runs at every frame of the host.
        deque(map(operator.call, self._writers, self._values.tolist()), maxlen=0)

    def frame(self) -> None:
        """Read the host's last frame, advance to it and publish."""
        self(self.host.read_frame())
