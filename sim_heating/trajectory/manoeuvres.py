"""Scripted manoeuvres: each is a polygon of offsets over the time since its trigger, on one channel.

A pushover-pullup, a pulse train and a sweep differ only in their polygons. The offset is added to what guidance or
trim commands at that moment, so it is continuous and never faster than the manoeuvre's own rate; the sum is clipped to
the limits of its channel. On one channel manoeuvres do not overlap: a later one waits for the end of the earlier.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sim_heating.jit import njit
from sim_heating.trajectory.flight import Window
from sim_heating.trajectory.spec import (
    BodyflapPulse,
    BodyflapSweep,
    ElevonPulse,
    ElevonSweep,
    JetFiring,
    Manoeuvre,
    Popu,
    SideslipDoublet,
)  # fmt: skip

FloatArray = NDArray[np.float64]
Polygon = list[tuple[float, float]]

ALPHA, BETA, ELEVON, BODYFLAP, JETS, PITCH = range(6)
"""Places in an array of offsets: degrees for the first four, 0 to 1 for jets, one of the next three for pitch."""

CLOSED, JETS_HOLD, OPEN = 0.0, 1.0, 2.0
"""Pitch axis: trimmed with the elevon; elevon frozen at its value and the jets hold alpha; nothing holds alpha."""

_TRIGGERS = ("at_time_s", "at_velocity_m_s", "at_mach")


class Offsets(NamedTuple):
    """What manoeuvres add to the commands now.

    pitch : CLOSED where the elevon trims as usual; JETS_HOLD where the elevon is the trimmed value at the start of the
            manoeuvre plus `elevon_deg` and reaction jets hold the angle of attack; OPEN where nothing holds it
    """

    alpha_deg: float = 0.0
    beta_deg: float = 0.0
    elevon_deg: float = 0.0
    bodyflap_deg: float = 0.0
    jets: float = 0.0
    pitch: float = CLOSED


def through(values: Iterable[tuple[float, float]], rate: float) -> Polygon:
    """Polygon from 0 through (value, hold_s) at a rate and back to 0."""
    time, last, points = 0.0, 0.0, [(0.0, 0.0)]
    for value, hold_s in (*values, (0.0, 0.0)):
        time += abs(value - last) / rate
        points.append((time, value))
        if hold_s > 0.0:
            time += hold_s
            points.append((time, value))
        last = value
    return _without_repeats(points)


def _without_repeats(points: Polygon) -> Polygon:
    return [p for i, p in enumerate(points) if i == 0 or p[0] > points[i - 1][0]]


def _popu(m: Popu) -> Polygon:
    down = (-m.down_deg, m.hold_s if m.hold_down_s is None else m.hold_down_s)
    up = (m.up_deg, m.hold_s if m.hold_up_s is None else m.hold_up_s)
    return through([down, up] if m.first == "down" else [up, down], m.rate_deg_s)


def _pulses(m: ElevonPulse | BodyflapPulse) -> Polygon:
    signs = [(-1.0) ** i if m.alternate else 1.0 for i in range(m.count)]
    return through([v for s in signs for v in ((s * m.amplitude_deg, m.hold_s), (0.0, m.pause_s))][:-1], m.rate_deg_s)


def _sweep(m: ElevonSweep | BodyflapSweep) -> Polygon:
    return through([(m.from_deg, 0.0), (m.to_deg, m.hold_s)], m.rate_deg_s)


def _doublet(m: SideslipDoublet) -> Polygon:
    return through([(m.amplitude_deg, m.hold_s), (-m.amplitude_deg, m.hold_s)], m.rate_deg_s)


def _firing(m: JetFiring) -> Polygon:
    return through([v for _ in range(m.count) for v in ((m.level, m.on_s), (0.0, m.off_s))][:-1], m.level / m.rise_s)


_SHAPES: dict[str, tuple[int, Callable[[Any], Polygon]]] = {
    "popu": (ALPHA, _popu),
    "elevon-pulse": (ELEVON, _pulses),
    "elevon-sweep": (ELEVON, _sweep),
    "bodyflap-pulse": (BODYFLAP, _pulses),
    "bodyflap-sweep": (BODYFLAP, _sweep),
    "sideslip-doublet": (BETA, _doublet),
    "jet-firing": (JETS, _firing),
}


def polygon(manoeuvre: Manoeuvre) -> Polygon:
    """[(seconds since trigger, offset), ...] of a manoeuvre, 0 at both ends."""
    return _SHAPES[manoeuvre.kind][1](manoeuvre)


def _pitch(manoeuvre: Manoeuvre) -> float:
    if getattr(manoeuvre, "alpha", "held") == "free":
        return OPEN
    return JETS_HOLD if manoeuvre.kind.startswith("elevon") else CLOSED


class Script(NamedTuple):
    """Manoeuvres as arrays: plan (manoeuvres, 6) of trigger, its value, channel, pitch, first and last point;
    points (points, 2) of time and offset."""

    plan: FloatArray
    points: FloatArray


def compile_script(manoeuvres: Sequence[Manoeuvre]) -> Script:
    """Arrays of a list of manoeuvres, in its order."""
    plan, points = [], []
    for m in manoeuvres:
        trigger = next(i for i, key in enumerate(_TRIGGERS) if getattr(m, key) is not None)
        shape = polygon(m)
        first, last = len(points), len(points) + len(shape) - 1
        plan.append([trigger, getattr(m, _TRIGGERS[trigger]), _SHAPES[m.kind][0], _pitch(m), first, last])
        points += shape
    return Script(np.array(plan, dtype=float).reshape(-1, 6), np.array(points, dtype=float).reshape(-1, 2))


@njit
def trigger_kernel(script: Script, started_s: FloatArray, before: FloatArray, now: FloatArray) -> None:
    """Set the start times of manoeuvres whose trigger lies between two frames; -1 stands for 'not started'.

    before, now : (3,) time [s], velocity [m/s], Mach [-]; the crossing is linear between them. Speed and Mach trigger
                  when they fall through the value, time when it passes it.
    """
    plan = script.plan
    for m in range(plan.shape[0]):
        if started_s[m] >= 0.0:
            continue
        which, value = int(plan[m, 0]), plan[m, 1]
        a, b = before[which], now[which]
        if which == 0 and b >= value:
            start = value
        elif which != 0 and a > value and b <= value:
            start = before[0] + (now[0] - before[0]) * (a - value) / (a - b)
        else:
            continue
        for other in range(plan.shape[0]):
            if started_s[other] >= 0.0 and plan[other, 2] == plan[m, 2]:
                start = max(start, started_s[other] + script.points[int(plan[other, 5]), 0])
        started_s[m] = start


@njit
def offsets_kernel(script: Script, started_s: FloatArray, time_s: float, out: FloatArray) -> None:
    """Write the offsets of all running manoeuvres at a time into out (6,)."""
    out[:] = 0.0
    plan, points = script.plan, script.points
    for m in range(plan.shape[0]):
        since = time_s - started_s[m]
        first, last = int(plan[m, 4]), int(plan[m, 5])
        if started_s[m] < 0.0 or since < 0.0 or since > points[last, 0]:
            continue
        out[PITCH] = max(out[PITCH], plan[m, 3])
        for i in range(first + 1, last + 1):
            if since <= points[i, 0]:
                share = (since - points[i - 1, 0]) / (points[i, 0] - points[i - 1, 0])
                out[int(plan[m, 2])] += points[i - 1, 1] + share * (points[i, 1] - points[i - 1, 1])
                break


class ManoeuvreScript:
    """The manoeuvres of one flight; ask it once a frame, in the order of time."""

    def __init__(self, manoeuvres: Sequence[Manoeuvre]) -> None:
        self.manoeuvres = tuple(manoeuvres)
        self.script = compile_script(self.manoeuvres)
        self.started_s = np.full(len(self.manoeuvres), -1.0)
        self._before = np.full(3, np.nan)
        self._now = np.empty(3)
        self._out = np.zeros(6)
        self._none = Offsets()

    def offsets(self, time_s: float, velocity_m_s: float, mach: float) -> Offsets:
        """Offsets at this frame; a trigger that lies between the last frame and this one starts at its own instant."""
        if not self.manoeuvres:
            return self._none
        self._now[:] = time_s, velocity_m_s, mach
        trigger_kernel(self.script, self.started_s, self._before, self._now)
        self._before[:] = self._now
        offsets_kernel(self.script, self.started_s, time_s, self._out)
        return Offsets(*self._out.tolist())

    def windows(self, until_s: float = np.inf) -> list[Window]:
        """When manoeuvres were flown, in the order of time; one that the end of the flight cut short ends there."""
        return windows(self.manoeuvres, self.script, self.started_s, until_s)

    def events(self, until_s: float = np.inf) -> list[tuple[float, str]]:
        """Start of each manoeuvre, and at the end of the flight those that were never reached."""
        return events(self.manoeuvres, self.started_s, until_s)


def windows(
    manoeuvres: Sequence[Manoeuvre], script: Script, started_s: FloatArray, until_s: float = np.inf
) -> list[Window]:
    """Windows of the started manoeuvres, by their start."""
    lengths = script.points[script.plan[:, 5].astype(int), 0]
    flown = [
        Window(m.kind, float(s), float(min(s + length, until_s)))
        for m, s, length in zip(manoeuvres, started_s, lengths, strict=True)
        if 0.0 <= s < until_s
    ]
    return sorted(flown, key=lambda w: w.start_s)


def events(
    manoeuvres: Sequence[Manoeuvre], started_s: FloatArray, until_s: float = np.inf
) -> list[tuple[float, str]]:
    """(time, text) of manoeuvres begun, and of those whose trigger was not reached."""
    found = []
    for m, s in zip(manoeuvres, started_s, strict=True):
        if 0.0 <= s < until_s:
            found.append((float(s), f"{m.kind} at {_trigger_text(m)}"))
        elif np.isfinite(until_s):
            found.append((float(until_s), f"{m.kind} at {_trigger_text(m)} was not reached"))
    return sorted(found, key=lambda e: e[0])


def _trigger_text(m: Manoeuvre) -> str:
    if m.at_velocity_m_s is not None:
        return f"{m.at_velocity_m_s:g} m/s"
    return f"Mach {m.at_mach:g}" if m.at_mach is not None else f"{m.at_time_s:g} s"
