"""A link to a flight that is being flown: what is measured, estimated and ahead, as the samples come in.

    from sim_heating import load_vehicle
    from sim_heating.live import Frame, LiveEstimator, Reading, VehiclePoints

    estimator = LiveEstimator(VehiclePoints(load_vehicle("orbiter"), ["V09T9527"]), ["ratio.scale"])
    estimator.add(frame, reading)                    # as they come, in any order
    estimator.advance()
    estimator.estimates()["V09T9527"].surface_K

or a whole link with its network: `run_link(LinkEngine(load_link("scenarios/live/jsbsim.toml")))`. Names are imported
when they are first used. Everything that is not in `__all__` may move between releases.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sim_heating.live.engine import LinkEngine as LinkEngine
    from sim_heating.live.filtering.estimator import LiveEstimator as LiveEstimator
    from sim_heating.live.filtering.points import VehiclePoints as VehiclePoints
    from sim_heating.live.outputs.jsbsim_properties import JSBSimProperties as JSBSimProperties
    from sim_heating.live.run import run_link as run_link
    from sim_heating.live.spec import load_link as load_link
    from sim_heating.live.state import State as State
    from sim_heating.live.types import Frame as Frame
    from sim_heating.live.types import Reading as Reading

_HOME = {
    "Frame": "types",
    "JSBSimProperties": "outputs.jsbsim_properties",
    "LinkEngine": "engine",
    "LiveEstimator": "filtering.estimator",
    "Reading": "types",
    "State": "state",
    "VehiclePoints": "filtering.points",
    "load_link": "spec",
    "run_link": "run",
}
"""Public name -> module that defines it."""

__all__ = list(_HOME)


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module `sim_heating.live` has no attribute `{name}`")
    return getattr(import_module(f"sim_heating.live.{_HOME[name]}"), name)


def __dir__() -> list[str]:
    return sorted(__all__)
