"""Scripted manoeuvres: each is a polygon of offsets over the time since its trigger, on one channel.

A pushover-pullup, a pulse train and a sweep differ only in their polygons. The offset is added to the command of
guidance or trim, so it is continuous and never faster than the manoeuvre's own rate; the sum is clipped to
the limits of its channel. On one channel manoeuvres do not overlap: a later one waits for the end of the earlier.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.base.kernels.jit import njit
from sim_heating.trajectory import spec
from sim_heating.trajectory.flight import Window
from sim_heating.trajectory.spec import Manoeuvre

Polygon = list[tuple[float, float]]

ALPHA, BETA, ELEVON, BODYFLAP, JETS, PITCH = range(6)
"""Indices of an array of offsets: degrees for the first four, 0 to 1 for jets, one of the next three for pitch."""

CLOSED, JETS_HOLD, OPEN = 0.0, 1.0, 2.0
"""Pitch axis: trimmed with the elevon; elevon frozen at its value and the jets hold alpha; nothing holds alpha."""

SMALLEST = 1e-9
"""Degrees and seconds below which a difference is ignored."""

_TRIGGERS = ("at_time_s", "at_velocity_m_s", "at_mach")


class Offsets(NamedTuple):
    """Offsets that manoeuvres add to the commands of one frame.

    pitch : CLOSED where the elevon trims as usual; JETS_HOLD where the elevon is the trimmed value at the start of the
            manoeuvre plus `elevon_deg` and reaction jets hold the angle of attack; OPEN where nothing holds it
    """

    alpha_deg: float = 0.0
    beta_deg: float = 0.0
    elevon_deg: float = 0.0
    bodyflap_deg: float = 0.0
    jets: float = 0.0
    pitch: float = CLOSED


def polygon_through(values: Iterable[tuple[float, float]], rate: float) -> Polygon:
    """Polygon of (time [s], offset [deg] or [-]) from 0 through (value, hold_s) at a rate [deg/s] or [1/s] and back to
    0; moves below SMALLEST are ignored."""
    time, last, points = 0.0, 0.0, [(0.0, 0.0)]
    for value, hold_s in (*values, (0.0, 0.0)):
        # A move of no length would be an edge of no duration, and `offsets_kernel` divides by the duration.
        value = 0.0 if abs(value) < SMALLEST else value
        if abs(value - last) >= SMALLEST:
            time, last = time + abs(value - last) / rate, value
            points.append((time, value))
        if hold_s > SMALLEST:
            time += hold_s
            points.append((time, last))
    return points


def _popu(m: spec.Popu) -> Polygon:
    down = (-m.down_deg, m.hold_s if m.hold_down_s is None else m.hold_down_s)
    up = (m.up_deg, m.hold_s if m.hold_up_s is None else m.hold_up_s)
    return polygon_through([down, up] if m.first == "down" else [up, down], m.rate_deg_s)


def _pulses(m: spec.ElevonPulse | spec.BodyflapPulse) -> Polygon:
    # The pause after the last pulse is dropped below: it would only delay the next manoeuvre on the channel.
    signs = [(-1.0) ** i if m.alternate else 1.0 for i in range(m.count)]
    return polygon_through(
        [v for s in signs for v in ((s * m.amplitude_deg, m.hold_s), (0.0, m.pause_s))][:-1], m.rate_deg_s
    )


def _sweep(m: spec.ElevonSweep | spec.BodyflapSweep) -> Polygon:
    return polygon_through([(m.from_deg, 0.0), (m.to_deg, m.hold_s)], m.rate_deg_s)


def _doublet(m: spec.SideslipDoublet) -> Polygon:
    return polygon_through([(m.amplitude_deg, m.hold_s), (-m.amplitude_deg, m.hold_s)], m.rate_deg_s)


def _firing(m: spec.JetFiring) -> Polygon:
    return polygon_through(
        [v for _ in range(m.count) for v in ((m.level, m.on_s), (0.0, m.off_s))][:-1], m.level / m.rise_s
    )


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
    """Times since the trigger [s] and offsets ([deg], or [-] of jets) of a manoeuvre, 0 at both ends."""
    return _SHAPES[manoeuvre.kind][1](manoeuvre)


def commanded_variable(manoeuvre: Manoeuvre) -> str:
    """The command [deg] that a manoeuvre adds its offset to."""
    return Offsets._fields[_SHAPES[manoeuvre.kind][0]]


def _pitch(manoeuvre: Manoeuvre) -> float:
    if getattr(manoeuvre, "alpha", "held") == "free":
        return OPEN
    return JETS_HOLD if manoeuvre.kind.startswith("elevon") else CLOSED


COUNT, PLAN, ENTRY = 0, 1, 6
"""A script's block: the number of manoeuvres, ENTRY numbers for each from PLAN on, then points of (time, offset)."""

TRIGGER, VALUE, CHANNEL, PITCH_MODE, FIRST, LAST = range(6)
"""Numbers of one manoeuvre: trigger variable and value, channel, pitch mode, positions of its first and last point."""


def compile_script(manoeuvres: Sequence[Manoeuvre]) -> FloatArray:
    """A list of manoeuvres as one flat block, in its order: times [s], triggers [s], [m/s] or [-], offsets [deg]."""
    plan: list[float] = [len(manoeuvres)]
    points: list[float] = []
    for m in manoeuvres:
        trigger = next(i for i, key in enumerate(_TRIGGERS) if getattr(m, key) is not None)
        shape = polygon(m)
        first = PLAN + ENTRY * len(manoeuvres) + len(points)
        last = first + 2 * (len(shape) - 1)
        plan += [trigger, getattr(m, _TRIGGERS[trigger]), _SHAPES[m.kind][0], _pitch(m), first, last]
        points += [number for point in shape for number in point]
    return np.array(plan + points, dtype=float)


@njit
def trigger_kernel(script: FloatArray, state: FloatArray, started: int, before: int, now: FloatArray, at: int) -> None:
    """Set the start times of manoeuvres whose trigger lies between two frames; -1 means 'not started'.

    state  : start times [s] from position `started`; time [s], velocity [m/s], Mach [-] of the previous frame from
             `before`, which are then replaced by those of now
    now    : those of this frame, from position `at`; the crossing is linear between the two frames. Speed and
             Mach trigger when they fall through the value, time when it passes it.
    """
    for m in range(int(script[COUNT])):
        entry = PLAN + ENTRY * m
        which, value = int(script[entry + TRIGGER]), script[entry + VALUE]
        a, b = state[before + which], now[at + which]
        # Speed and Mach are passed from above. They are NaN before the first frame of a host, and NaN passes nothing.
        passed = b >= value if which == 0 else a > value >= b
        if passed and state[started + m] < 0.0:
            fraction = 0.0 if which == 0 else (a - value) / (a - b)
            # The instant of the crossing, not that of the frame: the manoeuvre does not depend on the frame rate.
            start = value if which == 0 else state[before] + (now[at] - state[before]) * fraction
            state[started + m] = earliest_start(script, state, started, script[entry + CHANNEL], start)
    for i in range(3):
        state[before + i] = now[at + i]


@njit
def earliest_start(script: FloatArray, state: FloatArray, started: int, channel: float, start_s: float) -> float:
    """The given start [s], or the end of the last manoeuvre on the same channel where that is later."""
    for m in range(int(script[COUNT])):
        entry = PLAN + ENTRY * m
        if state[started + m] >= 0.0 and script[entry + CHANNEL] == channel:
            start_s = max(start_s, state[started + m] + script[int(script[entry + LAST])])
    return start_s


@njit
def offsets_kernel(
    script: FloatArray, state: FloatArray, started: int, time_s: float, out: FloatArray, at: int
) -> None:
    """Write the offsets [deg], jets [-], of all running manoeuvres at a time [s] into out, six numbers from position
    `at`."""
    for i in range(6):
        out[at + i] = 0.0
    for m in range(int(script[COUNT])):
        entry = PLAN + ENTRY * m
        since = time_s - state[started + m]
        point, last = int(script[entry + FIRST]), int(script[entry + LAST])
        if state[started + m] < 0.0 or since < 0.0 or since > script[last] or point == last:
            continue
        while since > script[point + 2]:
            point += 2
        fraction = (since - script[point]) / (script[point + 2] - script[point])
        value = script[point + 1] + fraction * (script[point + 3] - script[point + 1])
        out[at + int(script[entry + CHANNEL])] += value
        # Of several manoeuvres at once the most open pitch mode prevails.
        out[at + PITCH] = max(out[at + PITCH], script[entry + PITCH_MODE])


class ManoeuvreScript:
    """The manoeuvres of one flight; `offsets` is called once a frame, in order of time."""

    def __init__(self, manoeuvres: Sequence[Manoeuvre]) -> None:
        self.manoeuvres = tuple(manoeuvres)
        self.script = compile_script(self.manoeuvres)
        self._lengths_s = [float(polygon(m)[-1][0]) for m in self.manoeuvres]
        self._state = np.concatenate([np.full(len(self.manoeuvres), -1.0), np.full(3, np.nan)])
        self._now = np.empty(3)
        self._out = np.zeros(6)
        self._none = Offsets()

    def offsets(self, time_s: float, velocity_m_s: float, mach: float) -> Offsets:
        """Offsets [deg], jets [-], at this frame; a trigger that lies between the last frame and this one starts at
        its own instant."""
        if not self.manoeuvres:
            return self._none
        self._now[:] = time_s, velocity_m_s, mach
        trigger_kernel(self.script, self._state, 0, len(self.manoeuvres), self._now, 0)
        offsets_kernel(self.script, self._state, 0, time_s, self._out, 0)
        return Offsets(*self._out.tolist())

    def active(self, time_s: float, after_s: float = 0.0) -> bool:
        """Whether a manoeuvre is flown at a time [s] for which `offsets` was called, or ended up to after_s [s] ago."""
        lasts = zip(self.started_s.tolist(), self._lengths_s, strict=True)
        return any(started >= 0.0 and time_s <= started + length + after_s for started, length in lasts)

    @property
    def started_s(self) -> FloatArray:
        """Start time of each manoeuvre [s], -1 where it has not begun."""
        return self._state[: len(self.manoeuvres)]

    def windows(self, until_s: float = np.inf) -> list[Window]:
        """Windows [s] of the flown manoeuvres in order of time; the end of the flight truncates them."""
        return manoeuvre_windows(self.manoeuvres, self.started_s, until_s)

    def events(self, until_s: float = np.inf) -> list[tuple[float, str]]:
        """Start [s] of each manoeuvre, and at the end of the flight those whose trigger was never met."""
        return manoeuvre_events(self.manoeuvres, self.started_s, until_s)


NOT_FLOWN = "trigger never met; manoeuvre not flown"
"""End of the text of a manoeuvre's event where the flight ended before its trigger."""


def manoeuvre_windows(manoeuvres: Sequence[Manoeuvre], started_s: FloatArray, until_s: float = np.inf) -> list[Window]:
    """Windows [s] of the started manoeuvres, by their start."""
    flown = [
        Window(m.kind, float(s), float(min(s + polygon(m)[-1][0], until_s)))
        for m, s in zip(manoeuvres, started_s, strict=True)
        if 0.0 <= s < until_s
    ]
    return sorted(flown, key=lambda w: w.start_s)


def manoeuvre_events(
    manoeuvres: Sequence[Manoeuvre], started_s: FloatArray, until_s: float = np.inf
) -> list[tuple[float, str]]:
    """Times [s] and texts of manoeuvres begun, and of those whose trigger was never met."""
    events = []
    for m, s in zip(manoeuvres, started_s, strict=True):
        if 0.0 <= s < until_s:
            events.append((float(s), f"{m.kind} at {trigger_text(m)}"))
        elif np.isfinite(until_s):
            events.append((float(until_s), f"{m.kind} at {trigger_text(m)}: {NOT_FLOWN}"))
    return sorted(events, key=lambda e: e[0])


def trigger_text(m: Manoeuvre) -> str:
    """What starts a manoeuvre, in words."""
    if m.at_velocity_m_s is not None:
        return f"{m.at_velocity_m_s:g} m/s"
    return f"Mach {m.at_mach:g}" if m.at_mach is not None else f"{m.at_time_s:g} s"
