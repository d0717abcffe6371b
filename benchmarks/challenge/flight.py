"""Flights along the shipped scenarios: a point mass that follows the Orbiter's drag and angle-of-attack schedules.

    dh/dt = V sin g,   dV/dt = -D/m - G sin g,   dg/dt = (L cos bank / m - (G - V^2/r - 2 w_E V sin psi) cos g) / V
    L, D = q S (C_N cos a -+ C_A sin a) of the longitudinal table; bank from h'' = -2 z w (h' - h*') - w^2 (h - h*)

with h* the altitude of the scheduled drag. The body flap is trimmed slowly to the scheduled elevon, and the elevon
trims what remains, so that it follows the angle of attack. Entry state, manoeuvres and reversals are the scenario's,
each dispersed by some per cent. There is no attitude dynamics: controls move at constant rates between their levels.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RegularGridInterpolator
from scipy.ndimage import gaussian_filter1d

from benchmarks.challenge.air import EARTH_M, G0, R_AIR, standard_air
from benchmarks.challenge.files import AIRCRAFT, nodes_of, read_csv, read_toml, scenario_file

FloatArray = NDArray[np.float64]
Generator = np.random.Generator
Knots = tuple[list[float], list[float]]

STEP_S = 0.5
EARTH_RAD_S = 7.292e-5
"""Rotation of the Earth; the Coriolis acceleration is that of the entry's first heading at the equator."""
FLIGHTS = (
    "sts2",
    "sts4",
    "popu_mach20",
    "popu_mach12",
    "popu_mach8",
    "flap_mach21",
    "flap_mach16",
    "flap_mach12",
    "design_flap",
    "all_manoeuvres",
    "entry_3dof",
    "nominal",
)
KINDS = ("popu", "bodyflap", "elevon", "sideslip", "jets")
"""What a manoeuvre moves; `of_kind` of a scenario's names."""
EXTRA: dict[str, dict[str, Any]] = {
    "popu": {"kind": "popu", "down_deg": 5.0, "up_deg": 5.0, "rate_deg_s": 1.0, "hold_s": 3.0},
    "bodyflap": {"kind": "bodyflap-pulse", "amplitude_deg": 8.0, "rate_deg_s": 3.0, "hold_s": 8.0},
    "elevon": {
        "kind": "elevon-pulse",
        "amplitude_deg": 6.0,
        "rate_deg_s": 3.0,
        "hold_s": 6.0,
        "count": 2,
        "pause_s": 8.0,
        "alternate": True,
    },
    "sideslip": {"kind": "sideslip-doublet", "amplitude_deg": 3.0, "rate_deg_s": 1.5, "hold_s": 6.0},
    "jets": {"kind": "jet-firing", "level": 1.0, "on_s": 4.0, "off_s": 6.0, "count": 4},
}
"""A manoeuvre that is added where a flight lacks what an effect needs to be seen."""


@dataclass(frozen=True)
class Flight:
    """A flight every STEP_S.

    state      : time_s, altitude_m, velocity_m_s, rho_kg_m3, T_inf_K, p_inf_Pa, axial_accel_g and the controls
    manoeuvres : (kind, start, end) [s]
    """

    name: str
    state: dict[str, FloatArray]
    manoeuvres: list[tuple[str, float, float]]


def of_kind(name: str) -> str:
    """The member of KINDS that a scenario's manoeuvre belongs to."""
    return "jets" if name == "jet-firing" else name.partition("-")[0]


def draw_flight(rng: Generator, needs: Sequence[str] = (), only: Sequence[str] = FLIGHTS) -> Flight:
    """A flight along one of the scenarios; manoeuvres that an effect needs are added where it has none of them."""
    name = str(rng.choice(list(only)))
    flown = deepcopy(read_toml(scenario_file(name))["trajectory"])
    manoeuvres = flown.get("manoeuvre", [])
    for kind in needs:
        if all(of_kind(m["kind"]) != kind for m in manoeuvres):
            manoeuvres.append(EXTRA[kind] | {"at_velocity_m_s": _free_velocity(rng, manoeuvres)})
    for m in manoeuvres:
        m["at_velocity_m_s"] += float(rng.uniform(-60.0, 60.0))
        size = float(rng.uniform(0.85, 1.2))
        for key in ("down_deg", "up_deg", "from_deg", "to_deg", "amplitude_deg"):
            if key in m:
                m[key] *= size
    return _fly(rng, name, flown["initial"], flown.get("guidance", {}), manoeuvres, flown["stop"].get("mach", 2.5))


def _free_velocity(rng: Generator, manoeuvres: Sequence[Mapping[str, Any]]) -> float:
    """A velocity that lies far from those of other manoeuvres."""
    for _ in range(30):
        V = float(rng.uniform(3000.0, 6700.0))
        if all(abs(V - m["at_velocity_m_s"]) > 450.0 for m in manoeuvres):
            break
    return V


def _profile(rng: Generator) -> Callable[[float], float]:
    """Density over that of the standard atmosphere, against altitude: 4 % (1 sigma) every 12 km."""
    knots_m = np.arange(0.0, 140e3, 12e3)
    factor = np.exp(gaussian_filter1d(0.05 * rng.normal(size=len(knots_m)), 0.7))
    altitudes = knots_m.tolist()
    values = factor.tolist()

    def at(h: float) -> float:
        i = min(max(bisect_right(altitudes, h) - 1, 0), len(altitudes) - 2)
        return float(values[i] + (values[i + 1] - values[i]) * (h - altitudes[i]) / 12e3)

    return at


@cache
def _altitude_tables() -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    h = np.arange(0.0, 125_001.0, 250.0)
    T, p, rho = np.array([standard_air(float(z)) for z in h]).T
    return h, np.log(rho), np.log(p), T


@cache
def _coefficients() -> tuple[Any, Any, Any]:
    """C_N, C_A, C_m of (mach, alpha); and of (mach, alpha, deflection) of elevon and body flap."""
    found = []
    for name, axes in (
        ("longitudinal", ("mach", "alpha_deg")),
        ("elevon", ("mach", "alpha_deg", "deflection_deg")),
        ("bodyflap", ("mach", "alpha_deg", "deflection_deg")),
    ):
        columns = read_csv(AIRCRAFT / "orbiter" / "aero" / f"{name}.csv")
        grids = [nodes_of(columns, axes, c) for c in ("CN", "CA", "Cm")]
        found.append(RegularGridInterpolator(grids[0][0], np.stack([g for _, g in grids], axis=-1)))
    return found[0], found[1], found[2]


@cache
def _hypersonic() -> tuple[list[float], list[float]]:
    """Lift and drag coefficient every degree at Mach 10, where they no longer depend on it."""
    alpha = np.arange(0.0, 50.5, 1.0)
    C_N, C_A, _ = _coefficients()[0](np.column_stack((np.full_like(alpha, 10.0), alpha))).T
    a = np.radians(alpha)
    return (C_N * np.cos(a) - C_A * np.sin(a)).tolist(), (C_N * np.sin(a) + C_A * np.cos(a)).tolist()


def knots_of(m: Mapping[str, Any]) -> Knots:
    """Times after the start [s] and deflections of a manoeuvre."""
    kind = m["kind"]
    if kind == "popu":
        down = (-m["down_deg"], m.get("hold_down_s", m.get("hold_s", 2.0)))
        up = (m["up_deg"], m.get("hold_up_s", m.get("hold_s", 2.0)))
        levels = [up, down] if m.get("first") == "up" else [down, up]
    elif kind == "bodyflap-sweep":
        levels = [(m["from_deg"], m["hold_s"]), (m["to_deg"], m["hold_s"])]
    elif kind == "sideslip-doublet":
        levels = [(m["amplitude_deg"], m["hold_s"]), (-m["amplitude_deg"], m["hold_s"])]
    elif kind == "jet-firing":
        levels = [level for _ in range(m["count"]) for level in ((m["level"], m["on_s"]), (0.0, m["off_s"]))]
    else:
        turns = [(-1.0) ** i if m.get("alternate") else 1.0 for i in range(m.get("count", 1))]
        pulses = [(turn * m["amplitude_deg"], m["hold_s"]) for turn in turns]
        levels = [level for pulse in pulses for level in (pulse, (0.0, m.get("pause_s", 5.0)))]
    rate = m.get("rate_deg_s", 2.0)
    t, x = [0.0], [0.0]
    for value, hold in [*levels, (0.0, 0.0)]:
        t += [t[-1] + max(abs(value - x[-1]) / rate, 0.2)]
        t += [t[-1] + hold]
        x += [value, value]
    return t, x


def _fly(
    rng: Generator,
    name: str,
    initial: Mapping[str, float],
    guidance: Mapping[str, Any],
    manoeuvres: Sequence[Mapping[str, Any]],
    last_mach: float,
) -> Flight:
    guided = read_toml(AIRCRAFT / "orbiter" / "guidance.toml") | dict(guidance)
    aero = read_toml(AIRCRAFT / "orbiter" / "aero" / "aero.toml")
    mass = aero["mass"]["mass_kg"] * rng.normal(1.0, 0.02)
    factor = _profile(rng)
    starts: dict[int, float] = {}
    rows = _descent(rng, initial, guided, manoeuvres, starts, mass / aero["reference"]["area_m2"], factor, last_mach)
    t, h, V, mach, alpha, CL, CD = np.array(rows).T
    state = {"time_s": t, "altitude_m": h, "velocity_m_s": V} | _air_along(h, np.array([factor(z) for z in h]))
    windows = [
        (of_kind(m["kind"]), starts[i], starts[i] + knots_of(m)[0][-1]) for i, m in enumerate(manoeuvres) if i in starts
    ]
    moved = {kind: np.zeros(len(t)) for kind in KINDS}
    for i, m in enumerate(manoeuvres):
        if i in starts:
            moved[of_kind(m["kind"])] += np.interp(t - starts[i], *knots_of(m))
    state |= _controls(rng, mach, alpha, moved, aero)
    axial = 0.5 * state["rho_kg_m3"] * V**2 / (mass / aero["reference"]["area_m2"])
    a = np.radians(state["alpha_deg"])
    state["axial_accel_g"] = axial * (CD * np.cos(a) - CL * np.sin(a)) / G0
    return Flight(name, state, windows)


def _air_along(h: FloatArray, factor: FloatArray) -> dict[str, FloatArray]:
    """Density, pressure and temperature that belong together: dp = -rho g dh, T changed as p / rho is."""
    z, log_rho, log_p, T = _altitude_tables()
    rho = np.exp(np.interp(h, z, log_rho)) * factor
    gravity = G0 * (EARTH_M / (EARTH_M + h)) ** 2
    standard = np.exp(np.interp(h, z, log_p))
    weight = 0.5 * (rho[1:] * gravity[1:] + rho[:-1] * gravity[:-1])
    p = standard[0] * factor[0] - np.concatenate(([0.0], np.cumsum(weight * np.diff(h))))
    T_inf = np.interp(h, z, T) * (p / standard) / factor
    return {"rho_kg_m3": rho, "T_inf_K": T_inf, "p_inf_Pa": p}


def _descent(
    rng: Generator,
    initial: Mapping[str, float],
    guided: Mapping[str, Any],
    manoeuvres: Sequence[Mapping[str, Any]],
    starts: dict[int, float],
    loading: float,
    factor: Callable[[float], float],
    last_mach: float,
) -> list[tuple[float, ...]]:
    """Rows of time, altitude, velocity, mach, alpha, lift and drag coefficient; starts of manoeuvres are filled in."""
    z, log_rho, _, T_of = (a.tolist() for a in _altitude_tables())
    CL_of, CD_of = _hypersonic()
    drag_V, drag = (list(v) for v in zip(*sorted(map(tuple, guided["drag_m_s2"])), strict=True))
    alpha_M, alpha_of = (list(v) for v in zip(*sorted(map(tuple, guided["alpha_deg"])), strict=True))
    shapes = [knots_of(m) for m in manoeuvres]
    size, w = float(rng.uniform(0.92, 1.08)), guided["frequency_rad_s"]
    h, V = initial["altitude_m"], initial["velocity_m_s"] + float(rng.uniform(-40.0, 40.0))
    g, t, bank = math.radians(initial["gamma_deg"] + float(rng.uniform(-0.05, 0.05))), 0.0, 0.0
    rows: list[tuple[float, ...]] = []
    while t < 2400.0:
        i = min(int(h / 250.0), len(z) - 2)
        s = h / 250.0 - i
        rho = math.exp(log_rho[i] + s * (log_rho[i + 1] - log_rho[i])) * factor(h)
        mach = V / math.sqrt(1.4 * R_AIR * (T_of[i] + s * (T_of[i + 1] - T_of[i])))
        if mach < last_mach:
            break
        alpha = _line(alpha_M, alpha_of, mach)
        for j, m in enumerate(manoeuvres):
            if j not in starts and m["at_velocity_m_s"] > V:
                starts[j] = t
            if j in starts and of_kind(m["kind"]) == "popu":
                alpha += _line(*shapes[j], t - starts[j])
        j = min(int(alpha), 49)
        CL = CL_of[j] + (alpha - j) * (CL_of[j + 1] - CL_of[j])
        CD = CD_of[j] + (alpha - j) * (CD_of[j + 1] - CD_of[j])
        q = 0.5 * rho * V * V / loading
        lift, slow = q * CL, q * CD
        rows.append((t, h, V, mach, alpha, CL, CD))
        G = G0 * (EARTH_M / (EARTH_M + h)) ** 2
        radius = EARTH_M + h
        wanted = _line(drag_V, drag, V) * size
        # altitude at which the drag is as scheduled, and its rate along the schedule
        h_wanted = h + 7000.0 * math.log(max(slow, 1e-6) / wanted)
        down = -7000.0 * 2.0 * slow / V + 7000.0 * slow * (_line(drag_V, drag, V + 25.0) * size - wanted) / (
            25.0 * wanted
        )
        rise = -2.0 * 0.9 * w * (V * math.sin(g) - down) - w * w * (h - h_wanted)
        G_eff = G - V * V / radius - 2.0 * EARTH_RAD_S * V * math.sin(math.radians(initial["heading_deg"]))
        cosine = (rise + G_eff) / max(lift, 1e-3)
        held = 0.0 if slow < 0.3 else math.acos(min(max(cosine, math.cos(math.radians(110.0))), 1.0))
        turns = sum(v > V for v in guided["reversals_m_s"])
        bank += min(max((-1.0) ** turns * held - bank, -0.0436), 0.0436)
        dV = -slow - G * math.sin(g)
        dg = (lift * math.cos(bank) - G_eff * math.cos(g)) / V
        middle_g = g + 0.5 * STEP_S * dg
        h += STEP_S * (V + 0.5 * STEP_S * dV) * math.sin(middle_g)
        V += STEP_S * dV
        g += STEP_S * dg
        t += STEP_S
    return rows


def _line(x: Sequence[float], y: Sequence[float], at: float) -> float:
    """A value of a table, constant beyond its ends."""
    i = bisect_right(x, at)
    if i == 0 or i == len(x):
        return y[0] if i == 0 else y[-1]
    s = (at - x[i - 1]) / (x[i] - x[i - 1])
    return y[i - 1] + s * (y[i] - y[i - 1])


def _smooth(rng: Generator, count: int, correlation_s: float) -> FloatArray:
    """A random history of unit variance with a given time scale."""
    values = gaussian_filter1d(rng.normal(size=count), correlation_s / STEP_S, mode="wrap")
    return np.asarray(values / max(float(np.std(values)), 1e-9))


def _controls(
    rng: Generator, mach: FloatArray, alpha: FloatArray, moved: Mapping[str, FloatArray], aero: Mapping[str, Any]
) -> dict[str, FloatArray]:
    """Angles of attack and sideslip, elevon and body flap [deg], jets [0..1]."""
    basic, elevon_of, flap_of = _coefficients()
    n, M = len(mach), np.clip(mach, 2.0, 10.0)
    alpha = np.clip(alpha + rng.uniform(0.02, 0.15) * _smooth(rng, n, 6.0), 0.0, 50.0)
    beta = moved["sideslip"] + rng.uniform(0.03, 0.15) * _smooth(rng, n, 5.0)
    lever = aero["mass"]["cg_fraction"] + rng.uniform(-0.003, 0.003) - aero["reference"]["moment_reference_fraction"]
    lever *= aero["reference"]["length_m"] / aero["reference"]["chord_m"]
    angles, x = np.arange(-35.0, 20.1, 2.5), np.column_stack((M, alpha))
    C_N, _, C_m = basic(x).T
    base = C_m + lever * C_N + rng.uniform(-0.005, 0.005)

    def moments(of: Any, deflections: FloatArray) -> FloatArray:
        each = [of(np.column_stack((x, np.full(n, d)))) for d in deflections]
        return np.array([e[:, 2] + lever * e[:, 0] for e in each])

    flaps = np.linspace(-11.7, 22.5, 12)
    of_flap, of_elevon = moments(flap_of, flaps), moments(elevon_of, angles)
    at_schedule = _columns_at(angles, of_elevon, np.full(n, aero["elevon"]["schedule_deg"]))
    trimmed = _root(flaps, base + at_schedule + of_flap)
    flap = gaussian_filter1d(trimmed, 40.0 / STEP_S) + moved["bodyflap"]
    flap = np.clip(flap, -11.7, 22.5)
    elevon = _root(angles, base + _columns_at(flaps, of_flap, flap) + of_elevon)
    elevon = gaussian_filter1d(elevon, 1.0 / STEP_S) + moved["elevon"] + rng.uniform(0.05, 0.3) * _smooth(rng, n, 10.0)
    jets = np.clip(moved["jets"], 0.0, 1.0)
    return {
        "alpha_deg": alpha,
        "beta_deg": beta,
        "elevon_deg": np.clip(elevon, -35.0, 20.0),
        "bodyflap_deg": flap,
        "jets": jets,
    }


def _columns_at(nodes: FloatArray, values: FloatArray, at: FloatArray) -> FloatArray:
    """(time,) linear interpolation in (node, time) at (time,)."""
    i = np.clip(np.searchsorted(nodes, at) - 1, 0, len(nodes) - 2)
    s, k = (at - nodes[i]) / (nodes[i + 1] - nodes[i]), np.arange(len(at))
    return np.asarray(values[i, k] + s * (values[i + 1, k] - values[i, k]))


def _root(nodes: FloatArray, moment: FloatArray) -> FloatArray:
    """(time,) deflection at which a moment that falls with it is 0, within the range of the nodes."""
    i = np.clip(np.sum(moment > 0.0, axis=0) - 1, 0, len(nodes) - 2)
    k = np.arange(moment.shape[1])
    s = moment[i, k] / (moment[i, k] - moment[i + 1, k])
    return np.asarray(nodes[i] + np.clip(s, 0.0, 1.0) * (nodes[i + 1] - nodes[i]))
