"""Entries and manoeuvres: altitude over velocity is a corridor, velocity follows from drag, controls are drawn on top.

    dV/dt = -rho V^2 / (2 B) - g dh/dt / V,     h = H(V) below the pull-out, a cubic in time above it

No flight mechanics of a vehicle, but an entry of realistic speeds, densities and times; corridor, ballistic
coefficient, angle of attack and manoeuvres differ from record to record.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator
from scipy.ndimage import gaussian_filter1d

from sim_heating.heating.atmosphere import free_stream, us76_kernel

FloatArray = NDArray[np.float64]
Generator = np.random.Generator

CORRIDOR_KM_S = [0.6, 1.0, 1.8, 2.65, 3.9, 4.5, 5.5, 6.3, 7.0, 7.7]
CORRIDOR_KM = [26.0, 33.0, 42.0, 49.0, 57.0, 60.5, 66.0, 70.0, 74.0, 79.0]
"""Altitude over velocity of a Shuttle-type entry, between Mach 8 and 21 as it was flown; the rest is continued."""

INTERFACE_M = 121_920.0
G_M_S2 = 9.6
FINE_S = 0.1
REFERENCE_LENGTH_M = 32.77
MANOEUVRES = ("popu", "flap", "elevon", "sideslip", "jets", "combined")


@dataclass
class Flight:
    """A flight every FINE_S: time, state, controls; and its manoeuvres.

    columns    : name -> (time,), the columns of conditions.csv but for heating and surface pressure
    manoeuvres : (kind, start, end) [s]
    """

    columns: dict[str, FloatArray]
    manoeuvres: list[tuple[str, float, float]] = field(default_factory=list)

    def windows(self, kind: str) -> list[tuple[float, float]]:
        """Start and end of the manoeuvres of a kind [s]."""
        return [(start, end) for k, start, end in self.manoeuvres if k == kind]


def draw_flight(rng: Generator, kinds: Sequence[str]) -> Flight:
    """An entry with manoeuvres of these kinds, and perhaps one more."""
    ballistic = rng.uniform(330.0, 470.0)  # m / (CD S) [kg/m2]
    altitude, velocity = _descent(rng, ballistic)
    time = np.round(np.arange(len(altitude)) * FINE_S, 1)
    wanted = [*kinds, *(str(k) for k in rng.choice(MANOEUVRES, rng.integers(0, 2), replace=False))]
    wanted = wanted or [str(rng.choice(("popu", "flap")))]
    slots = _slots(rng, time, velocity, len(wanted))
    manoeuvres = [(kind, *slot) for kind, slot in zip(wanted, slots, strict=False)]
    controls = _controls(rng, time, velocity, manoeuvres)
    standard = np.array([us76_kernel(h)[2] for h in altitude[::10]])
    shear = rng.uniform(0.0, 0.04) * _smooth(rng, len(time), 30.0)
    rho = np.exp(np.interp(time, time[::10], np.log(standard)) + shear)
    derived = free_stream(altitude, velocity, rho, REFERENCE_LENGTH_M)
    axial_g = rng.uniform(0.25, 0.35) * 0.5 * rho * velocity**2 / ballistic / 9.80665
    state = {"time_s": time, "altitude_m": altitude, "velocity_m_s": velocity, **derived, "rho_kg_m3": rho}
    return Flight(state | controls | {"axial_accel_g": axial_g}, manoeuvres)


def _descent(rng: Generator, ballistic: float) -> tuple[FloatArray, FloatArray]:
    """Altitude [m] and velocity [m/s] every FINE_S from entry interface to a drawn last velocity."""
    V, h, t = rng.uniform(7400.0, 7750.0), INTERFACE_M, 0.0
    shift, last_V, longest_s = rng.uniform(-2500.0, 2500.0), rng.uniform(800.0, 2600.0), rng.uniform(1050.0, 1900.0)
    down_s, sink = rng.uniform(310.0, 400.0), -V * np.sin(np.radians(rng.uniform(1.1, 1.5)))
    pulled_out = _corridor_m(V) + shift
    rows = [(h, V)]
    while t < longest_s and last_V < V:
        drag = 0.5 * us76_kernel(h)[2] * V * V / ballistic
        t += 1.0
        if t <= down_s:
            s = t / down_s
            cubic = (1 - s) ** 2 * (1 + 2 * s) * INTERFACE_M + s * s * (3 - 2 * s) * pulled_out
            cubic += down_s * (s * (1 - s) ** 2 * sink + s * s * (1 - s) * 20.0)
            V -= drag + G_M_S2 * (cubic - h) / V
            h = cubic
        else:
            slope = (_corridor_m(V + 50.0) - _corridor_m(V - 50.0)) / 100.0
            change = -drag / (1.0 + G_M_S2 * slope / V)
            h += slope * change
            V += change
        rows.append((h, V))
    coarse = np.array(rows)
    fine = PchipInterpolator(np.arange(len(rows)), coarse)(np.arange(10 * (len(rows) - 1) + 1) * FINE_S)
    return np.ascontiguousarray(fine[:, 0]), np.ascontiguousarray(fine[:, 1])


def _corridor_m(V: float) -> float:
    return 1e3 * float(np.interp(V / 1e3, CORRIDOR_KM_S, CORRIDOR_KM))


def _slots(rng: Generator, time: FloatArray, velocity: FloatArray, count: int) -> list[tuple[float, float]]:
    """Starts and ends of manoeuvres where the vehicle is hot, without overlap, in drawn order."""
    hot = time[(velocity < 7250.0) & (velocity > max(1500.0, velocity[-1] + 100.0)) & (time > 330.0)]
    share = (hot[-1] - hot[0]) / count
    starts = hot[0] + share * (np.arange(count) + rng.uniform(0.05, 0.4, count))
    lengths = np.minimum(rng.uniform(25.0, 90.0, count), 0.55 * share)
    slots = [(round(float(s), 1), round(float(s + d), 1)) for s, d in zip(starts, lengths, strict=True)]
    return [slots[i] for i in rng.permutation(count)]


def _smooth(rng: Generator, count: int, correlation_s: float) -> FloatArray:
    """A random history of unit variance with a given time scale."""
    coarse = gaussian_filter1d(rng.normal(size=count // 10 + 2), correlation_s, mode="wrap")
    return np.interp(np.arange(count), 10.0 * np.arange(len(coarse)), coarse / max(float(np.std(coarse)), 1e-9))


def _held(time: FloatArray, start: float, end: float, levels: Sequence[float], rate: float) -> FloatArray:
    """From 0 through these levels in equal parts of a window, at a rate, and back to 0."""
    knots_t, knots = [start], [0.0]
    part = (end - start) / len(levels)
    for i, level in enumerate([*levels, 0.0]):
        begin = start + i * part
        ramp = min(abs(level - knots[-1]) / rate, 0.9 * part)
        knots_t += [begin + 1e-3, begin + 1e-3 + max(ramp, 0.1)]
        knots += [knots[-1], level]
    return np.interp(time, knots_t, knots)


def _controls(
    rng: Generator, time: FloatArray, velocity: FloatArray, manoeuvres: Sequence[tuple[str, float, float]]
) -> dict[str, FloatArray]:
    """alpha, beta, elevon, body flap [deg] and jets [0..1]: schedules, slow wander and the manoeuvres."""
    pitch_over = rng.uniform(1800.0, 4000.0)
    alpha = rng.uniform(38.0, 41.5) + np.minimum(0.0, (velocity - pitch_over) * rng.uniform(0.006, 0.012))
    alpha += rng.uniform(0.05, 0.4) * _smooth(rng, len(time), 12.0)
    beta = rng.uniform(0.02, 0.15) * _smooth(rng, len(time), 6.0)
    elevon = rng.uniform(-2.0, 3.0) + rng.uniform(0.3, 1.5) * _smooth(rng, len(time), 60.0)
    bodyflap = rng.uniform(5.0, 12.0) + rng.uniform(0.2, 1.0) * _smooth(rng, len(time), 80.0)
    jets = np.zeros(len(time))
    for kind, start, end in manoeuvres:
        if kind == "popu":
            moved = _popu(rng, time, start, end)
            alpha += moved
            elevon += rng.choice([0.0, 0.4, 0.7, -0.5], p=[0.25, 0.3, 0.25, 0.2]) * moved
            if rng.random() < 0.4:
                jets = np.maximum(jets, _pulses(rng, time, [start, 0.5 * (start + end), end]))
        elif kind == "flap":
            moved = _held(time, start, end, _levels(rng, (3.0, 8.0)), rng.uniform(1.0, 4.0))
            bodyflap += moved
            elevon -= rng.uniform(0.1, 0.5) * moved
        elif kind == "elevon":
            moved = _held(time, start, end, _levels(rng, (3.0, 8.0)), rng.uniform(1.0, 5.0))
            elevon += moved
            alpha += rng.uniform(-0.1, 0.1) * moved
        elif kind == "combined":
            alpha += _popu(rng, time, start, end)
            middle = 0.5 * (start + end)
            for first, last in ((start, middle), (middle, end)):
                elevon += _held(time, first, last, _levels(rng, (3.0, 8.0)), rng.uniform(1.0, 5.0))
            bodyflap += _held(time, start, end, _levels(rng, (3.0, 8.0)), rng.uniform(1.0, 4.0))
        elif kind == "sideslip":
            size = rng.uniform(1.5, 4.0)
            beta += _held(time, start, end, [size, -size * rng.uniform(0.7, 1.0)], rng.uniform(0.7, 2.0))
        else:
            at = np.sort(rng.uniform(start, end, rng.integers(6, 16)))
            jets = np.maximum(jets, _pulses(rng, time, at))
    smoothed = {"alpha_deg": alpha, "beta_deg": beta, "elevon_deg": elevon, "bodyflap_deg": bodyflap}
    lag = rng.uniform(2.0, 8.0)
    return {name: gaussian_filter1d(values, lag) for name, values in smoothed.items()} | {"jets": jets}


def _popu(rng: Generator, time: FloatArray, start: float, end: float) -> FloatArray:
    """A pushover and a pullup, or the pullup first, of unequal size."""
    size = rng.uniform(2.5, 6.5)
    levels = [-size, size * rng.uniform(0.6, 1.2)]
    return _held(time, start, end, levels if rng.random() < 0.7 else levels[::-1], rng.uniform(0.6, 2.0))


def _levels(rng: Generator, size: tuple[float, float]) -> list[float]:
    """A pulse, a doublet or a sweep in steps."""
    top = rng.uniform(*size)
    shapes = ([top], [-top], [top, -top], [0.5 * top, top, 0.5 * top, -0.5 * top], [-0.5 * top, 0.5 * top, top])
    return list(shapes[rng.integers(len(shapes))])


def _pulses(rng: Generator, time: FloatArray, at: Sequence[float] | FloatArray) -> FloatArray:
    """Firings of 2 to 8 s from these times on."""
    jets = np.zeros(len(time))
    for start in at:
        jets[(time >= start) & (time <= start + rng.uniform(2.0, 8.0))] = 1.0
    return jets
