"""The state that a link publishes: one object at most ten times a second, for the page, for lines of JSON and metrics.

`state_json` gives the object as JSON has it; a number that is not known is null, never NaN. The field names are part of
the format: a display written by others reads them.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, is_dataclass
from typing import Any, Literal

import numpy as np

FUTURES = ("nominal", "held", "planned")
"""Futures of a look-ahead: the nominal trajectory, the present conditions held, a planned manoeuvre."""

LinkPhase = Literal["waiting", "live", "stalled", "ended"]
KnockOff = Literal["never needed", "by", "too late", "unknown"]

STALLED_S = 1.5
"""Time without a message [s] after which a link counts as stalled."""


@dataclass(frozen=True)
class SensorState:
    """A sensor: its latest reading, and the temperature that the model gives it.

    measured_K, measured_s : latest reading [K] and its flight time [s]; None before the first
    predicted_K, sigma_K   : predicted reading [K] and its standard deviation, noise of the sensor included [K]
    used, why              : whether it updates the estimate, and why not
    """

    measured_K: float | None = None
    measured_s: float | None = None
    predicted_K: float | None = None
    sigma_K: float | None = None
    used: bool = True
    why: str = ""


@dataclass(frozen=True)
class ParameterState:
    """An estimated parameter with its standard deviation, in its unit."""

    value: float
    sigma: float
    unit: str


@dataclass(frozen=True)
class AheadState:
    """One future of a control point.

    time_s                                   : (n,) flight times [s]
    surface_K, bondline_K and their _sigma_K : (n,) mean and standard deviation [K]
    peak_surface_K, peak_at_s                : highest surface temperature [K] and when [s]
    margin_K                                 : least distance to a limit [K]; negative where it is passed
    probability                              : that a limit is passed within the horizon
    """

    horizon_s: float
    time_s: Sequence[float]
    surface_K: Sequence[float]
    surface_sigma_K: Sequence[float]
    bondline_K: Sequence[float]
    bondline_sigma_K: Sequence[float]
    peak_surface_K: float
    peak_at_s: float
    margin_K: float | None = None
    probability: float | None = None


@dataclass(frozen=True)
class PointState:
    """A control point: temperatures [K], heating ratio, sensors, parameters, limits, futures.

    ratio, ratio_declared : estimated heating ratio and that of the declared model; None where not known
    margin_K           : least present distance to a limit [K]; None without limits
    knock_off_by_s     : latest flight time [s] at which stopping the manoeuvre still keeps the limits; None unless
                         `knock_off` is "by"
    """

    surface_K: float
    surface_sigma_K: float
    bondline_K: float
    bondline_sigma_K: float
    ratio: float | None = None
    ratio_declared: float | None = None
    ratio_sigma: float | None = None
    sensors: Mapping[str, SensorState] = field(default_factory=dict)
    parameters: Mapping[str, ParameterState] = field(default_factory=dict)
    limits: Mapping[str, float] = field(default_factory=dict)
    margin_K: float | None = None
    ahead: Mapping[str, AheadState] = field(default_factory=dict)
    knock_off_by_s: float | None = None
    knock_off: KnockOff = "unknown"


@dataclass(frozen=True)
class LinkState:
    """Health of the link.

    state       : waiting for the first message, live, stalled, or ended
    since_s     : time since the last message [s]
    lateness_s  : largest lateness of a sample that was still used [s]
    late        : samples that came out of order and were put where they belong
    too_late    : samples later than the stated lateness, not used
    doubled, damaged, lost, jumps : doubled samples, messages that could not be read, lost words, jumps of the clock
    messages    : the latest remarks on the link, oldest first
    """

    state: LinkPhase = "waiting"
    since_s: float = 0.0
    frames_Hz: float = 0.0
    readings_Hz: float = 0.0
    lateness_s: float = 0.0
    late: int = 0
    too_late: int = 0
    doubled: int = 0
    damaged: int = 0
    lost: int = 0
    jumps: int = 0
    messages: Sequence[str] = ()


@dataclass(frozen=True)
class RemovedSensor:
    """A sensor that was taken out, from which flight time on [s], and why."""

    point: str
    sensor: str
    since_s: float
    why: str

    @property
    def text(self) -> str:
        """In one line."""
        return f"{self.sensor} at {self.point} is taken out from {self.since_s:.1f} s on: {self.why}"


@dataclass(frozen=True)
class Candidate:
    """A missing effect that the record so far points to, with its probability; None where that is not calibrated."""

    what: str
    probability: float | None


@dataclass(frozen=True)
class MissingState:
    """The sequential test of the innovations.

    statistic, threshold : largest statistic of the control points, and the value at which it fires
    candidates           : what could be missing, the likeliest first; empty before the alarm
    """

    alarm: bool = False
    statistic: float | None = None
    threshold: float | None = None
    false_alarms_per_hour: float | None = None
    candidates: Sequence[Candidate] = ()
    text: str = "not tested yet"


@dataclass(frozen=True)
class State:
    """All that is published at one time.

    sequence   : counts the states of a link from 0
    time_s     : flight time of the estimate [s]; None before the first
    wall_s     : time since the link was started [s]
    conditions : column -> value of the latest frame, with the derived Mach number and Reynolds number
    points     : by name of the control point
    """

    sequence: int
    time_s: float | None
    wall_s: float
    conditions: Mapping[str, float] = field(default_factory=dict)
    points: Mapping[str, PointState] = field(default_factory=dict)
    link: LinkState = field(default_factory=LinkState)
    removed: Sequence[RemovedSensor] = ()
    missing: MissingState = field(default_factory=MissingState)


def plain(value: Any) -> Any:
    """A value as JSON has it: dataclasses as objects, arrays as lists, a number that is not finite as None."""
    if isinstance(value, (str, bool, int, type(None))):
        return value
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    if is_dataclass(value):
        return {f.name: plain(getattr(value, f.name)) for f in fields(value)}
    if isinstance(value, Mapping):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, (np.ndarray, np.generic)):
        return plain(value.tolist())
    return [plain(v) for v in value]


def state_json(state: State) -> str:
    """A state as one line of JSON.

    >>> from sim_heating.live.state import State, state_json
    >>> state_json(State(0, float("nan"), 0.1))[:45]
    '{"sequence":0,"time_s":null,"wall_s":0.1,"con'
    """
    return json.dumps(plain(state), separators=(",", ":"), allow_nan=False)
