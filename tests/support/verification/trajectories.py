"""The built-in entry: closed forms, conserved quantities, and an own integration in inertial axes."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from sim_heating.heating.atmosphere import G0_M_S2, us76_kernel
from sim_heating.trajectory import entry3dof
from sim_heating.trajectory import guidance as gd
from sim_heating.trajectory import point_mass as pm
from sim_heating.trajectory.aero import Grid, load_aero
from sim_heating.trajectory.entry3dof import Entry
from sim_heating.trajectory.flight import ROW
from sim_heating.trajectory.schedules import pack
from sim_heating.trajectory.spec import Initial, TrajectorySpec
from sim_heating.trajectory.trimmed_aero import aero_block
from tests.support.paths import ORBITER
from tests.support.verification.row import Row, within

FloatArray = NDArray[np.float64]
VACUUM = {"density_factor": [[0.0, 1e-30]]}
STS107 = {
    "altitude_m": 120399.0, "velocity_m_s": 7486.0, "gamma_deg": -1.15, "heading_deg": 63.7,
    "latitude_deg": 30.83, "longitude_deg": -167.56,
}  # fmt: skip
"""Entry interface of STS-107: position and 'Mach' 24.56 (V / 1000 ft/s) published, path angle and heading fitted."""
SCALE_M, RHO0, BETA_KG_M2 = 7000.0, 1.4, 2000.0
"""Exponential atmosphere: scale height [m], density at 0 m [kg/m3]; ballistic coefficient m / (S CD) [kg/m2]."""
MU, RADIUS_M, FLATTENING, ROTATION, J2 = 3.986004418e14, 6378137.0, 1.0 / 298.257223563, 7.292115e-5, 1.08262982e-3
"""WGS84, NIMA TR8350.2; typed here a second time, so that the program's own constants are checked."""


def spec(source: str = "entry-3dof", **changes: object) -> TrajectorySpec:
    """A Shuttle entry with some keys of its [trajectory] table replaced."""
    table: dict[str, object] = {
        "source": source,
        "initial": STS107,
        "stop": {"velocity_m_s": 100.0, "altitude_m": 0.0},
        "vehicle": {"mass_kg": 105600.0},
    }
    return TrajectorySpec.model_validate(table | changes)


# Without air --------------------------------------------------------------------------------------------------------


def vacuum_orbit(rate_hz: float, seconds: float) -> tuple[FloatArray, FloatArray]:
    """States of an orbit without air, first and last."""
    rising = STS107 | {"gamma_deg": 0.3}
    stop = {"time_s": seconds}
    entry = Entry(spec(rate_hz=rate_hz, dispersions=VACUUM, initial=rising, sample_s=100.0, stop=stop), ORBITER)
    first = entry.state.copy()
    entry.run(round(seconds * rate_hz) + 1)
    return first, entry.state


def orbit_integrals(state: FloatArray) -> tuple[float, float]:
    """Energy in the rotating frame [J/kg] and axial angular momentum [m2/s] about an oblate Earth."""
    r, v = state[pm.X : pm.VX], state[pm.VX : pm.VX + 3]
    radius = np.linalg.norm(r)
    oblate = 1.0 - 0.5 * J2 * (RADIUS_M / radius) ** 2 * (3.0 * (r[2] / radius) ** 2 - 1.0)
    energy = 0.5 * v @ v - 0.5 * ROTATION**2 * (r[0] ** 2 + r[1] ** 2) - MU / radius * oblate
    return float(energy), float(r[0] * (v[1] + ROTATION * r[0]) - r[1] * (v[0] - ROTATION * r[1]))


def inertial(state: FloatArray) -> FloatArray:
    """Position [m] and velocity [m/s] in axes that coincide with the Earth-fixed ones at time 0, (6,)."""
    r, v = state[pm.X : pm.VX], state[pm.VX : pm.VX + 3]
    v = v + np.array([-ROTATION * r[1], ROTATION * r[0], 0.0])
    c, s = math.cos(ROTATION * state[pm.T]), math.sin(ROTATION * state[pm.T])
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    return np.concatenate((turn @ r, turn @ v))


def gravitation(r: FloatArray) -> FloatArray:
    """Gradient of the potential mu/r (1 - J2 (R/r)^2 P2(sin latitude)) [m/s2]."""
    d = float(np.linalg.norm(r))
    s2 = (r[2] / d) ** 2
    k = 1.5 * J2 * (RADIUS_M / d) ** 2
    return -MU / d**3 * r * (1.0 + k * (np.array([1.0, 1.0, 3.0]) - 5.0 * s2))


def orbits() -> list[Row]:
    """An orbit without air: integrals of the motion, own integration, precession of the node."""
    first, last = vacuum_orbit(1.0, 5400.0)
    before, after = np.array(orbit_integrals(first)), np.array(orbit_integrals(last))
    drift = after / before - 1.0
    fourth = "fourth order at steps of 1 s"
    rows = [
        Row(
            "orbit without air, 5400 s: relative change of the Jacobi energy",
            0.0,
            drift[0],
            1e-11,
            "-",
            "integral of the motion",
            fourth,
        ),
        Row(
            "the same: relative change of the axial momentum",
            0.0,
            drift[1],
            1e-11,
            "-",
            "integral of the motion",
            fourth,
        ),
    ]

    def rate(_: float, y: FloatArray) -> FloatArray:
        return np.concatenate((y[3:], gravitation(y[:3])))

    own = solve_ivp(rate, (0.0, float(last[pm.T])), inertial(first), "DOP853", rtol=1e-12, atol=1e-6)
    distance = float(np.linalg.norm(own.y[:3, -1] - inertial(last)[:3]))
    rows.append(
        Row(
            "the same: distance from an own integration in inertial axes",
            0.0,
            distance,
            0.01,
            "m",
            "Newton's law with J2, DOP853 at 1e-12",
            f"{fourth}: 3e-10 of the path",
        )
    )
    return rows


def kepler() -> list[Row]:
    """An orbit about a sphere: Kepler's equation."""
    seconds = 3000.0
    entry = Entry(spec(rate_hz=1.0, dispersions=VACUUM, initial=STS107 | {"gamma_deg": 0.3}, sample_s=100.0), ORBITER)
    entry.flight[pm.J2] = 0.0
    y = inertial(entry.state)
    entry.run(round(seconds))
    r, v = y[:3], y[3:]
    a = 1.0 / (2.0 / np.linalg.norm(r) - float(v @ v) / MU)
    n = math.sqrt(MU / a**3)
    c, s = 1.0 - np.linalg.norm(r) / a, float(r @ v) / math.sqrt(MU * a)
    # Difference x of eccentric anomalies: n t = x - c sin x + s (1 - cos x)
    x = brentq(lambda x: x - c * math.sin(x) + s * (1.0 - math.cos(x)) - n * seconds, 0.0, 10.0, xtol=1e-14)
    f = 1.0 - a / np.linalg.norm(r) * (1.0 - math.cos(x))
    g = seconds + (math.sin(x) - x) / n
    distance = float(np.linalg.norm(f * r + g * v - inertial(entry.state)[:3]))
    source = "Battin (1999), Lagrange coefficients of Kepler's equation"
    return [
        Row(
            "orbit about a sphere, 3000 s: distance from Kepler's",
            0.0,
            distance,
            0.01,
            "m",
            source,
            "fourth order at steps of 1 s: 3e-10 of the path",
        )
    ]


def ellipsoid() -> list[Row]:
    """Gravity and shape of the WGS84 ellipsoid."""
    block = entry_with(0.0, 0.0, STS107, 10.0).flight
    rotating = ROTATION**2 * RADIUS_M
    equator = -pm.gravity(RADIUS_M, 0.0, 0.0, block)[0] - rotating
    b = 6356752.3142
    pole = -pm.gravity(0.0, 0.0, b, block)[2]
    altitude = pm.geodetic(0.0, 0.0, b, RADIUS_M, FLATTENING)[0]
    source = "NIMA TR8350.2, table 3.4"
    is_ = "J4 and above left out: 3e-5"
    return [
        within(3e-5, "gravity at the equator", 9.7803253359, equator, "m/s2", source, is_),
        within(3e-5, "gravity at the pole", 9.8321849378, pole, "m/s2", source, is_),
        Row("altitude of the pole, 6356752.3142 m from the centre", 0.0, altitude, 1e-4, "m", source, "digits printed"),
    ]


# With air -----------------------------------------------------------------------------------------------------------


def exponential_density(altitude_m: float) -> float:
    """Density [kg/m3] of the exponential atmosphere."""
    return RHO0 * math.exp(-altitude_m / SCALE_M)


def entry_with(cl: float, cd: float, initial: dict[str, float], rate_hz: float, bank_deg: float = 0.0) -> Entry:
    """A body of constant lift and drag coefficient in the exponential atmosphere, its bank held."""
    start = initial | {"bank_deg": bank_deg}
    entry = Entry(spec(rate_hz=rate_hz, guidance={"alpha_deg": [[0.0, 0.0]]}, initial=start), ORBITER)
    point, none = np.zeros(1), Grid(np.zeros(1), np.zeros(1), np.zeros(1), np.zeros((1, 1, 1, 3)))
    constant = np.zeros((1, 1, 1, 3))
    constant[..., 0], constant[..., 1] = cl, cd
    body = replace(load_aero(ORBITER), basic=Grid(point, point, point, constant), elevon=none, bodyflap=none)
    entry.tables = aero_block(body, np.zeros((0, 5)))
    z = np.arange(0.0, 125001.0, 50.0)
    exponential = [(h, exponential_density(h) / us76_kernel(h)[2]) for h in z]
    entry.flight = pack(entry.flight[: pm.DENSITY].tolist(), [exponential, (), (), ()])
    entry.block[gd.START_DRAG] = math.inf
    return entry


def ballistic_entry(rate_hz: float) -> FloatArray:
    """Rows of a vertical fall of a body without lift through an exponential atmosphere, no gravity, no rotation."""
    fall = {"altitude_m": 120000.0, "velocity_m_s": 7000.0, "gamma_deg": -90.0, "heading_deg": 0.0, "latitude_deg": 0.0}
    entry = entry_with(0.0, 1.0, fall, rate_hz)
    cd = entry.flight[pm.MASS] / entry.flight[pm.AREA] / BETA_KG_M2
    entry = entry_with(0.0, cd, fall, rate_hz)
    entry.flight[[pm.MU, pm.J2, pm.ROTATION, pm.FLATTENING]] = 0.0
    entry.state = entry3dof.first_state(Initial(**fall), entry.flight, entry.block, 0)
    return entry.run(100000)[0]


def allen_eggers_speed(altitude_m: FloatArray) -> FloatArray:
    """V = V_e exp(-rho H / (2 beta sin gamma)); Allen and Eggers, NACA TR 1381 (1958), with gamma = 90 deg."""
    return 7000.0 * np.exp(-RHO0 * np.exp(-altitude_m / SCALE_M) * SCALE_M / (2.0 * BETA_KG_M2))


def ballistic() -> list[Row]:
    """A ballistic entry: speed against altitude and the peak of its deceleration."""
    fall = ballistic_entry(50.0)
    source = "Allen & Eggers, NACA TR 1381 (1958)"
    rows = []
    for k in (int(np.flatnonzero(fall[:, 1] < z)[0]) for z in (40e3, 15e3, 5e3)):
        z = fall[k, 1]
        expected = float(allen_eggers_speed(z))
        is_ = "atmosphere linear in its factor over 50 m: 1e-5"
        rows.append(
            within(1e-5, f"ballistic entry: speed at {z / 1e3:.2f} km", expected, fall[k, 2], "m/s", source, is_)
        )
    peak = float(np.max(fall[:, ROW.index("axial_accel_g")])) * G0_M_S2
    expected = 7000.0**2 / (2.0 * math.e * SCALE_M)
    rows.append(
        within(
            1e-4,
            "ballistic entry: greatest deceleration",
            expected,
            peak,
            "m/s2",
            f"{source}: V^2 / (2 e H)",
            "frames of 0.02 s about the peak",
        )
    )
    return rows


def own_flight(entry: Entry, cl: float, cd: float, bank_deg: float, seconds: float) -> FloatArray:
    """Inertial position and velocity after a time [s]: Newton's law in inertial axes, DOP853, geodesy by iteration."""
    load = entry.flight[pm.AREA] / entry.flight[pm.MASS]
    cosine, sine = math.cos(math.radians(bank_deg)), math.sin(math.radians(bank_deg))
    e2 = FLATTENING * (2.0 - FLATTENING)

    def rate(_: float, y: FloatArray) -> FloatArray:
        r, v = y[:3], y[3:]
        p = math.hypot(r[0], r[1])
        latitude = math.atan2(r[2], p * (1.0 - e2))
        for _ in range(6):
            curvature = RADIUS_M / math.sqrt(1.0 - e2 * math.sin(latitude) ** 2)
            altitude = p / math.cos(latitude) - curvature
            latitude = math.atan2(r[2], p * (1.0 - e2 * curvature / (curvature + altitude)))
        up = np.array([math.cos(latitude) * r[0] / p, math.cos(latitude) * r[1] / p, math.sin(latitude)])
        air = v - np.cross([0.0, 0.0, ROTATION], r)
        speed = np.linalg.norm(air)
        ahead = air / speed
        right = np.cross(ahead, up) / np.linalg.norm(np.cross(ahead, up))
        above = np.cross(right, ahead)
        q = 0.5 * exponential_density(altitude) * speed**2 * load
        return np.concatenate((v, gravitation(r) - q * cd * ahead + q * cl * (cosine * above + sine * right)))

    start = inertial(entry.state)
    return solve_ivp(rate, (0.0, seconds), start, "DOP853", rtol=1e-10, atol=1e-4).y[:, -1]


def lifting() -> list[Row]:
    """A lifting entry with its bank held, over the rotating ellipsoid: own integration in inertial axes."""
    rows = []
    for bank in (0.0, 60.0):
        initial = STS107 | {"altitude_m": 90e3, "velocity_m_s": 7000.0, "gamma_deg": -1.0}
        entry, seconds = entry_with(0.8, 0.8, initial, 10.0, bank), 300.0
        expected = own_flight(entry, 0.8, 0.8, bank, seconds)
        entry.run(round(10.0 * seconds))
        got = inertial(entry.state)
        name = f"lifting entry of 300 s, L/D 1, bank {bank:g} deg"
        source, is_ = (
            "Newton's law in inertial axes, DOP853 at 1e-10",
            "atmosphere linear in its factor over 50 m: 1e-6 of the drag",
        )
        distance = float(np.linalg.norm(got[:3] - expected[:3]))
        rows.append(
            Row(f"{name}: distance from an own integration", 0.0, distance, 1.0, "m", source, f"{is_}, over 2000 km")
        )
        speeds = [float(np.linalg.norm(y[3:])) for y in (expected, got)]
        rows.append(Row(f"{name}: inertial speed", speeds[0], speeds[1], 0.01, "m/s", source, is_))
    return rows


def glide() -> list[Row]:
    """Range of an equilibrium glide at full lift over a sphere at rest, height counted in the speed."""
    held = {"drag_m_s2": [[10.0, 1.0]], "start_drag_m_s2": 0.001, "bank_limits_deg": [0.0, 0.001]}
    still = {"altitude_m": 70500.0, "velocity_m_s": 6500.0, "gamma_deg": -0.1, "heading_deg": 90.0, "latitude_deg": 0.0}
    entry = Entry(spec(initial=still, guidance=held | {"alpha_deg": [[0.0, 40.0]]}), ORBITER)
    entry.flight[[pm.J2, pm.ROTATION, pm.FLATTENING]] = 0.0
    entry.state = entry3dof.first_state(Initial(**still), entry.flight, entry.block, 0)
    flown = entry.run(8000)[0]
    longitude = flown[:, ROW.index("longitude_deg")]
    a, b = (int(np.flatnonzero(flown[:, 2] < v)[0]) for v in (6000.0, 3000.0))
    r = RADIUS_M + 60000.0
    lift, drag, _ = load_aero(ORBITER).coefficients(20.0, 40.0, flown[a, 5], flown[a, 6])
    u = (flown[[a, b], 2] ** 2 + 2.0 * G0_M_S2 * (flown[[a, b], 1] - 60000.0)) * r / MU
    expected = 0.5 * r * lift / drag * math.log((1.0 - u[1]) / (1.0 - u[0])) / 1e3
    got = math.radians(longitude[b] - longitude[a]) * r / 1e3
    source = "Saenger: r/2 (L/D) ln((1 - V2^2/vc^2) / (1 - V1^2/vc^2))"
    return [
        within(
            1e-2,
            "equilibrium glide from 6 to 3 km/s: range",
            expected,
            got,
            "km",
            source,
            "small angles, mean radius: 1 %",
        )
    ]


def rows() -> list[Row]:
    """All of this subject."""
    return [row for part in (orbits, kepler, ellipsoid, ballistic, lifting, glide) for row in part()]
