"""Built-in 3-DOF entry: a point mass with trimmed aerodynamics over the rotating WGS84 ellipsoid, gravity with J2.

State in Earth-fixed Cartesian axes r, v (no singular pole), with w the Earth's rotation:

    dr/dt = v
    dv/dt = g(r) - 2 w x v - w x (w x r) + (L - D + Y) / m            fourth-order Runge-Kutta, fixed step
    D = q S CD along the air-relative velocity u = v - wind;   L = q S CL across it, turned by the bank angle

Lift and drag are those of the vehicle's tables in trim: at every stage the elevon takes out the pitching moment about the
centre of gravity. Below the tables' lowest Mach number the parabolic polar of aero/low_speed.csv takes over
(CL = CL_0 + CL_alpha alpha, CD = CD_0 + K CL^2), blended linearly from its highest Mach number. Angle of attack, bank and
control offsets are linear within a step, so they are continuous. Guidance acts once a step.

Attitude has no dynamics here: a manoeuvre with `alpha = "free"` keeps its scripted deflection and the angle holds.
Validity: continuum lift and drag throughout; above 95 km (Knudsen number on the length above 0.003) drag is low.

Everything a flight needs is in flat float64 arrays, and `step_kernel` allocates nothing: ten thousand flights are
ten thousand states and blocks, and the step can be exported.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sim_heating.atmosphere import HIGHEST_M, LOWEST_M, speed_of_sound_kernel, us76_kernel
from sim_heating.conditions import FRAME
from sim_heating.errors import InputError, RunError
from sim_heating.files import read_csv_columns
from sim_heating.jit import njit
from sim_heating.trajectory import guidance as gd
from sim_heating.trajectory import manoeuvres as mv
from sim_heating.trajectory.aero import Aero, Grid, load_aero
from sim_heating.trajectory.flight import ROW, Flight, OnFrame, Progress, Sampler, reference_length_m
from sim_heating.trajectory.guidance import clipped, guidance_kernel
from sim_heating.trajectory.manoeuvres import Script, offsets_kernel, trigger_kernel
from sim_heating.trajectory.schedules import pack, scheduled
from sim_heating.trajectory.spec import Initial, TrajectorySpec

FloatArray = NDArray[np.float64]

WGS84_MU_M3_S2 = 3.986004418e14
WGS84_RADIUS_M = 6378137.0
WGS84_FLATTENING = 1.0 / 298.257223563
WGS84_ROTATION_RAD_S = 7.292115e-5
WGS84_J2 = 1.08262982e-3
"""NIMA TR8350.2, third edition, table 3.1 and 3.3 (J2 from the normalised C20)."""
G0_M_S2 = 9.80665

(
    MU, J2, ROTATION, RADIUS, FLATTENING, MASS, AREA, ARM, CM_SHIFT, SHIFT_LOW, SHIFT_HIGH, ELEVON_LOW, ELEVON_HIGH,
    FLAP_LOW, FLAP_HIGH, FLAP_AXIS, CY_BETA, STOP_TIME, STOP_MACH, STOP_SPEED, STOP_ALTITUDE,
) = range(21)  # fmt: skip
DENSITY, WIND_NORTH, WIND_EAST, FLAP_SCHEDULE = 21, 23, 25, 27
"""Places in the block of a flight: scalars, then schedules."""

(
    T, X, Y, Z, VX, VY, VZ, ALPHA, BANK, BETA, D_ELEVON, D_FLAP, JETS, LAST_SPEED, LAST_MACH,
    EXPECTED_TIME, EXPECTED_SPEED, EXPECTED_MACH, MEMORY,
) = range(19)  # fmt: skip
STARTED = MEMORY + gd.MEMORY
"""Places in a flight's state; guidance memory from MEMORY, start times of manoeuvres from STARTED."""

K1 = gd.OBSERVED
OFFSETS = K1 + 3
NEXT = OFFSETS + 6
WORK = NEXT + 3
"""The scratch array of a step: what guidance sees, acceleration, offsets of manoeuvres, triggers at the step's end."""


class AeroTables(NamedTuple):
    """A vehicle's tables as the kernels read them, all on the Mach and alpha points of any of them.

    basic (mach, alpha, 3), elevon (mach, alpha, elevon_deg, 3), bodyflap (mach, alpha, bodyflap_deg, 3): CN, CA, Cm;
    low_speed (rows, 5): mach, CL_0, CL_alpha 1/deg, CD_0, K
    """

    mach: FloatArray
    alpha_deg: FloatArray
    elevon_deg: FloatArray
    bodyflap_deg: FloatArray
    basic: FloatArray
    elevon: FloatArray
    bodyflap: FloatArray
    low_speed: FloatArray


class Place(NamedTuple):
    """Where a Mach number and an angle of attack lie in the tables: corners and their weights."""

    i: int
    i1: int
    j: int
    j1: int
    w00: float
    w01: float
    w10: float
    w11: float


class Air(NamedTuple):
    """The air about the vehicle and the directions in it."""

    altitude_m: float
    up: tuple[float, float, float]
    wind: tuple[float, float, float]
    u: tuple[float, float, float]
    speed_m_s: float
    rho_kg_m3: float
    mach: float


@njit
def dot(a: tuple[float, float, float], b: tuple[float, float, float]) -> float:
    """Scalar product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@njit
def cross(a: tuple[float, float, float], b: tuple[float, float, float]) -> tuple[float, float, float]:
    """Vector product."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@njit
def geodetic(
    x: float, y: float, z: float, radius: float, flattening: float
) -> tuple[float, tuple[float, float, float]]:
    """Geodetic altitude [m] and the outward normal of the ellipsoid at a point.

    Bowring, Survey Review 23 (1976) 323-327, one step, in sines and cosines without an angle; below 1e-6 m to 200 km.
    """
    e2 = flattening * (2.0 - flattening)
    b = radius * (1.0 - flattening)
    p = math.sqrt(x * x + y * y)
    r = math.sqrt(p * p + z * z)
    s, c = z * (1.0 - flattening) * (1.0 + e2 / (1.0 - e2) * b / r), p * (1.0 - flattening) ** 2
    n = math.sqrt(s * s + c * c)
    s, c = s / n, c / n
    sine, cosine = z + e2 / (1.0 - e2) * b * s * s * s, p - e2 * radius * c * c * c
    n = math.sqrt(sine * sine + cosine * cosine)
    sine, cosine = sine / n, cosine / n
    altitude = p * cosine + z * sine - radius * math.sqrt(1.0 - e2 * sine * sine)
    east = max(p, 1e-9)
    return altitude, (cosine * x / east, cosine * y / east, sine)


@njit
def gravity(x: float, y: float, z: float, flight: FloatArray) -> tuple[float, float, float]:
    """Gravitation of an oblate Earth [m/s2], without the centrifugal part; central and J2 terms."""
    r2 = x * x + y * y + z * z
    k = -flight[MU] / (r2 * math.sqrt(r2))
    j = 1.5 * flight[J2] * flight[RADIUS] ** 2 / r2
    q = 5.0 * z * z / r2
    return k * x * (1.0 + j * (1.0 - q)), k * y * (1.0 + j * (1.0 - q)), k * z * (1.0 + j * (3.0 - q))


@njit
def air_at(x: float, y: float, z: float, vx: float, vy: float, vz: float, flight: FloatArray) -> Air:
    """Altitude, wind, air-relative velocity, density and Mach."""
    altitude, up = geodetic(x, y, z, flight[RADIUS], flight[FLATTENING])
    p = max(math.sqrt(x * x + y * y), 1e-9)
    north, east = scheduled(flight, WIND_NORTH, altitude), scheduled(flight, WIND_EAST, altitude)
    ce, se, cp = x / p, y / p, math.sqrt(up[0] * up[0] + up[1] * up[1])
    wind = (-se * east - up[2] * ce * north, ce * east - up[2] * se * north, cp * north)
    u = (vx - wind[0], vy - wind[1], vz - wind[2])
    speed = max(math.sqrt(dot(u, u)), 1e-6)
    temperature, _, rho = us76_kernel(altitude)
    rho *= scheduled(flight, DENSITY, altitude)
    return Air(altitude, up, wind, u, speed, rho, speed / speed_of_sound_kernel(temperature))


@njit
def place_of(aero: AeroTables, mach: float, alpha_deg: float) -> Place:
    """Corners and bilinear weights; held at the ends."""
    i, u = bracket_scan(aero.mach, mach)
    j, v = bracket_scan(aero.alpha_deg, alpha_deg)
    i1, j1 = min(i + 1, aero.mach.shape[0] - 1), min(j + 1, aero.alpha_deg.shape[0] - 1)
    return Place(i, i1, j, j1, (1.0 - u) * (1.0 - v), (1.0 - u) * v, u * (1.0 - v), u * v)


@njit
def bracket_scan(axis: FloatArray, x: float) -> tuple[int, float]:
    """Interval of x on a short rising axis and its place 0..1 within; held at the ends."""
    last = axis.shape[0] - 1
    i = 0
    while i < last - 1 and x >= axis[i + 1]:
        i += 1
    if last == 0:
        return 0, 0.0
    return i, clipped((x - axis[i]) / (axis[i + 1] - axis[i]), 0.0, 1.0)


@njit
def at_basic(table: FloatArray, p: Place, c: int) -> float:
    """Coefficient c of the basic table."""
    return (
        p.w00 * table[p.i, p.j, c] + p.w01 * table[p.i, p.j1, c]
        + p.w10 * table[p.i1, p.j, c] + p.w11 * table[p.i1, p.j1, c]
    )  # fmt: skip


@njit
def at_node(table: FloatArray, p: Place, k: int, c: int) -> float:
    """Coefficient c of a control's table at deflection node k."""
    return (
        p.w00 * table[p.i, p.j, k, c] + p.w01 * table[p.i, p.j1, k, c]
        + p.w10 * table[p.i1, p.j, k, c] + p.w11 * table[p.i1, p.j1, k, c]
    )  # fmt: skip


@njit
def control_at(table: FloatArray, axis: FloatArray, p: Place, deflection_deg: float, c: int) -> float:
    """Coefficient c of a control's table at a deflection."""
    k, w = bracket_scan(axis, deflection_deg)
    low = at_node(table, p, k, c)
    return low + w * (at_node(table, p, min(k + 1, axis.shape[0] - 1), c) - low)


@njit
def zero_moment(table: FloatArray, axis: FloatArray, p: Place, moment: float, arm: float) -> float:
    """Deflection at which moment + dCm + arm dCN of a control is 0; the table's end where there is none.

    The sum falls with deflection and is linear between nodes, so halving the nodes finds it exactly.
    """
    low, high = 0, axis.shape[0] - 1
    below = moment + at_node(table, p, low, 2) + arm * at_node(table, p, low, 0)
    above = moment + at_node(table, p, high, 2) + arm * at_node(table, p, high, 0)
    if below <= 0.0:
        return axis[low]
    if above >= 0.0:
        return axis[high]
    while high - low > 1:
        middle = (low + high) // 2
        value = moment + at_node(table, p, middle, 2) + arm * at_node(table, p, middle, 0)
        if value > 0.0:
            low, below = middle, value
        else:
            high, above = middle, value
    return axis[low] + below / (below - above) * (axis[high] - axis[low])


@njit
def trimmed_kernel(
    mach: float, alpha_deg: float, flap_deg: float, d_elevon_deg: float, flight: FloatArray, aero: AeroTables
) -> tuple[float, float, float]:
    """CN, CA and elevon [deg] with the elevon in trim plus an offset, within its travel."""
    p = place_of(aero, mach, alpha_deg)
    flaps = aero.bodyflap_deg
    cn = at_basic(aero.basic, p, 0) + control_at(aero.bodyflap, flaps, p, flap_deg, 0)
    ca = at_basic(aero.basic, p, 1) + control_at(aero.bodyflap, flaps, p, flap_deg, 1)
    cm = at_basic(aero.basic, p, 2) + control_at(aero.bodyflap, flaps, p, flap_deg, 2)
    shift = flight[CM_SHIFT] * clipped((mach - flight[SHIFT_LOW]) / (flight[SHIFT_HIGH] - flight[SHIFT_LOW]), 0.0, 1.0)
    trim = zero_moment(aero.elevon, aero.elevon_deg, p, cm + shift + flight[ARM] * cn, flight[ARM])
    low, high = flight[ELEVON_LOW], flight[ELEVON_HIGH]
    elevon = clipped(clipped(trim, low, high) + d_elevon_deg, low, high)
    cn += control_at(aero.elevon, aero.elevon_deg, p, elevon, 0)
    ca += control_at(aero.elevon, aero.elevon_deg, p, elevon, 1)
    return cn, ca, elevon


@njit
def polar_kernel(mach: float, alpha_deg: float, low_speed: FloatArray) -> tuple[float, float]:
    """CL and CD of the low-speed polar, its coefficients linear in Mach."""
    last = low_speed.shape[0] - 1
    i = 0
    while i < last - 1 and mach >= low_speed[i + 1, 0]:
        i += 1
    k = min(i + 1, last)
    u = clipped((mach - low_speed[i, 0]) / max(low_speed[k, 0] - low_speed[i, 0], 1e-9), 0.0, 1.0)
    cl0 = low_speed[i, 1] + u * (low_speed[k, 1] - low_speed[i, 1])
    slope = low_speed[i, 2] + u * (low_speed[k, 2] - low_speed[i, 2])
    cd0 = low_speed[i, 3] + u * (low_speed[k, 3] - low_speed[i, 3])
    induced = low_speed[i, 4] + u * (low_speed[k, 4] - low_speed[i, 4])
    cl = cl0 + slope * alpha_deg
    return cl, cd0 + induced * cl * cl


@njit
def lift_drag_kernel(
    mach: float, alpha_deg: float, flap_deg: float, d_elevon_deg: float, flight: FloatArray, aero: AeroTables
) -> tuple[float, float, float, float]:
    """CL, CD, CA and elevon [deg] in trim, over all Mach numbers."""
    s, c = math.sin(math.radians(alpha_deg)), math.cos(math.radians(alpha_deg))
    cn, ca, elevon = trimmed_kernel(mach, alpha_deg, flap_deg, d_elevon_deg, flight, aero)
    cl, cd = cn * c - ca * s, cn * s + ca * c
    rows, bottom = aero.low_speed.shape[0], aero.mach[0]
    if rows > 0 and mach < bottom:
        cl_low, cd_low = polar_kernel(mach, alpha_deg, aero.low_speed)
        top = aero.low_speed[rows - 1, 0]
        share = clipped((mach - top) / max(bottom - top, 1e-9), 0.0, 1.0)
        cl, cd = cl_low + share * (cl - cl_low), cd_low + share * (cd - cd_low)
    return cl, cd, cd * c - cl * s, elevon


@njit
def flap_kernel(flight: FloatArray, mach: float, speed: float, d_flap_deg: float) -> float:
    """Body flap [deg]: schedule plus offset, within its travel."""
    base = scheduled(flight, FLAP_SCHEDULE, mach if flight[FLAP_AXIS] == 0.0 else speed)
    return clipped(base + d_flap_deg, flight[FLAP_LOW], flight[FLAP_HIGH])


class Forces(NamedTuple):
    """Air, aerodynamics in trim, and dv/dt in rotating Earth-fixed axes [m/s2]."""

    air: Air
    cl: float
    cd: float
    ca: float
    elevon_deg: float
    bodyflap_deg: float
    acceleration_m_s2: tuple[float, float, float]


@njit
def forces_kernel(
    x: float, y: float, z: float, vx: float, vy: float, vz: float,
    alpha_deg: float, bank_deg: float, beta_deg: float, d_elevon_deg: float, d_flap_deg: float,
    flight: FloatArray, aero: AeroTables,
) -> Forces:  # fmt: skip
    """Everything that acts on the vehicle at a position and velocity."""
    air = air_at(x, y, z, vx, vy, vz, flight)
    gx, gy, gz = gravity(x, y, z, flight)
    w = flight[ROTATION]
    gx += w * (2.0 * vy + w * x)
    gy += w * (w * y - 2.0 * vx)
    V = air.speed_m_s
    flap = flap_kernel(flight, air.mach, V, d_flap_deg)
    cl, cd, ca, elevon = lift_drag_kernel(air.mach, alpha_deg, flap, d_elevon_deg, flight, aero)
    pressure = 0.5 * air.rho_kg_m3 * V * V * flight[AREA] / flight[MASS]
    e = (air.u[0] / V, air.u[1] / V, air.u[2] / V)
    side = cross(e, air.up)
    n = max(math.sqrt(dot(side, side)), 1e-9)
    lift = cross(side, e)
    s, c = math.sin(math.radians(bank_deg)), math.cos(math.radians(bank_deg))
    cy = flight[CY_BETA] * math.radians(beta_deg)
    up_force, side_force, drag = pressure * (cl * c - cy * s) / n, pressure * (cl * s + cy * c) / n, pressure * cd
    ax = gx - drag * e[0] + up_force * lift[0] + side_force * side[0]
    ay = gy - drag * e[1] + up_force * lift[1] + side_force * side[1]
    az = gz - drag * e[2] + up_force * lift[2] + side_force * side[2]
    return Forces(air, cl, cd, ca, elevon, flap, (ax, ay, az))


@njit
def observe_kernel(state: FloatArray, flight: FloatArray, aero: AeroTables, work: FloatArray, row: FloatArray) -> None:
    """Fill what guidance sees and the acceleration, work[:K1 + 3], and the frame's row (flight.ROW) at a state."""
    x, y, z, vx, vy, vz = state[X], state[Y], state[Z], state[VX], state[VY], state[VZ]
    f = forces_kernel(
        x, y, z, vx, vy, vz, state[ALPHA], state[BANK], state[BETA], state[D_ELEVON], state[D_FLAP], flight, aero
    )
    air, V, seen = f.air, f.air.speed_m_s, work[: gd.OBSERVED]
    work[K1], work[K1 + 1], work[K1 + 2] = f.acceleration_m_s2
    qbar = 0.5 * air.rho_kg_m3 * V * V
    per_mass = qbar * flight[AREA] / flight[MASS]
    p = max(math.sqrt(x * x + y * y), 1e-9)
    east = (air.u[1] * x - air.u[0] * y) / p
    north = (air.u[2] - dot(air.u, air.up) * air.up[2]) / max(math.sqrt(1.0 - air.up[2] ** 2), 1e-9)
    climb = air.up[0] * vx + air.up[1] * vy + air.up[2] * vz
    seen[gd.TIME], seen[gd.ALTITUDE], seen[gd.SPEED], seen[gd.MACH] = state[T], air.altitude_m, V, air.mach
    seen[gd.CLIMB], seen[gd.DRAG], seen[gd.LIFT] = climb, per_mass * f.cd, per_mass * f.cl
    seen[gd.NET_GRAVITY] = net_gravity(x, y, z, vx, vy, vz, climb, flight)
    seen[gd.QBAR], seen[gd.ALPHA_NOW] = qbar, state[ALPHA]
    seen[gd.HEADING] = math.degrees(math.atan2(east, north))
    seen[gd.LATITUDE], seen[gd.LONGITUDE] = math.degrees(math.asin(air.up[2])), math.degrees(math.atan2(y, x))
    row[0], row[1], row[2], row[3], row[4] = state[T], air.altitude_m, V, state[ALPHA], state[BETA]
    row[5], row[6], row[7], row[8], row[9] = f.elevon_deg, f.bodyflap_deg, air.rho_kg_m3, state[JETS], state[BANK]
    row[10] = math.degrees(math.asin(clipped(dot(air.u, air.up) / V, -1.0, 1.0)))
    row[11], row[12], row[13] = seen[gd.HEADING], seen[gd.LATITUDE], seen[gd.LONGITUDE]
    row[14] = per_mass * f.ca / G0_M_S2


@njit
def net_gravity(
    x: float, y: float, z: float, vx: float, vy: float, vz: float, climb: float, flight: FloatArray
) -> float:
    """g - V_i^2 / r [m/s2], V_i the horizontal inertial speed."""
    r2 = x * x + y * y + z * z
    ix, iy = vx - flight[ROTATION] * y, vy + flight[ROTATION] * x
    horizontal2 = max(ix * ix + iy * iy + vz * vz - climb * climb, 0.0)
    return flight[MU] / r2 - horizontal2 / math.sqrt(r2)


@njit
def command_kernel(
    state: FloatArray, flight: FloatArray, block: FloatArray, script: Script, work: FloatArray, dt_s: float
) -> tuple[float, float, float, float, float]:
    """Alpha, bank, beta, elevon and body-flap offsets to be reached at the end of a step; starts manoeuvres.

    Speed and Mach at the end of the step are extrapolated, so that a manoeuvre starts inside the step in which its
    trigger is passed and not after it.
    """
    seen, out, now = work[: gd.OBSERVED], work[OFFSETS:NEXT], work[NEXT:]
    guidance_kernel(block, state[MEMORY:STARTED], seen, dt_s)
    now[0] = state[T] + dt_s
    now[1] = 2.0 * seen[gd.SPEED] - state[LAST_SPEED]
    now[2] = 2.0 * seen[gd.MACH] - state[LAST_MACH]
    state[LAST_SPEED], state[LAST_MACH] = seen[gd.SPEED], seen[gd.MACH]
    trigger_kernel(script, state[STARTED:], state[EXPECTED_TIME : EXPECTED_MACH + 1], now)
    state[EXPECTED_TIME : EXPECTED_MACH + 1] = now
    offsets_kernel(script, state[STARTED:], now[0], out)
    state[JETS] = clipped(out[mv.JETS], 0.0, 1.0)
    alpha = clipped(state[MEMORY + gd.ALPHA_COMMAND] + out[mv.ALPHA], block[gd.ALPHA_LOW], block[gd.ALPHA_HIGH])
    return alpha, state[MEMORY + gd.BANK_COMMAND], out[mv.BETA], out[mv.ELEVON], out[mv.BODYFLAP]


@njit
def runge_kutta_step(
    state: FloatArray, flight: FloatArray, aero: AeroTables, dt_s: float, k1: FloatArray,
    alpha: float, bank: float, beta: float, d_elevon: float, d_flap: float,
) -> None:  # fmt: skip
    """Classical fourth-order step of position and velocity, controls linear from the state's to the given ones.

    k1 : (3,) acceleration at the beginning of the step, as observe_kernel left it
    """
    x, y, z, vx, vy, vz = state[X], state[Y], state[Z], state[VX], state[VY], state[VZ]
    kx, ky, kz, lx, ly, lz = vx, vy, vz, k1[0], k1[1], k1[2]
    sx, sy, sz, ax, ay, az = kx / 6.0, ky / 6.0, kz / 6.0, lx / 6.0, ly / 6.0, lz / 6.0
    for stage in range(1, 4):
        share, weight = (1.0, 1.0 / 6.0) if stage == 3 else (0.5, 1.0 / 3.0)
        h = share * dt_s
        px, py, pz = x + h * kx, y + h * ky, z + h * kz
        kx, ky, kz = vx + h * lx, vy + h * ly, vz + h * lz
        lx, ly, lz = forces_kernel(
            px, py, pz, kx, ky, kz,
            state[ALPHA] + share * (alpha - state[ALPHA]), state[BANK] + share * (bank - state[BANK]),
            state[BETA] + share * (beta - state[BETA]), state[D_ELEVON] + share * (d_elevon - state[D_ELEVON]),
            state[D_FLAP] + share * (d_flap - state[D_FLAP]), flight, aero,
        ).acceleration_m_s2  # fmt: skip
        sx, sy, sz = sx + weight * kx, sy + weight * ky, sz + weight * kz
        ax, ay, az = ax + weight * lx, ay + weight * ly, az + weight * lz
    state[X], state[Y], state[Z] = x + dt_s * sx, y + dt_s * sy, z + dt_s * sz
    state[VX], state[VY], state[VZ] = vx + dt_s * ax, vy + dt_s * ay, vz + dt_s * az
    state[ALPHA], state[BANK], state[BETA], state[D_ELEVON], state[D_FLAP] = alpha, bank, beta, d_elevon, d_flap
    state[T] += dt_s


@njit
def step_kernel(
    state: FloatArray, flight: FloatArray, block: FloatArray, script: Script, aero: AeroTables, dt_s: float,
    work: FloatArray, row: FloatArray,
) -> bool:  # fmt: skip
    """One step of one flight: row is the frame at the step's beginning; False, and no step, where the flight ends there.

    state : (STARTED + manoeuvres,) as made by `first_state`, moved on by dt_s
    flight: block of `flight_block`;  block: of `guidance.guidance_block`;  work: (WORK,);  row: (len(ROW),)
    """
    observe_kernel(state, flight, aero, work, row)
    seen = work[: gd.OBSERVED]
    if (
        state[T] >= flight[STOP_TIME] - 1e-9
        or seen[gd.ALTITUDE] <= flight[STOP_ALTITUDE]
        or seen[gd.SPEED] <= flight[STOP_SPEED]
        or (seen[gd.MACH] <= flight[STOP_MACH] and seen[gd.ALTITUDE] < 90.0e3)
    ):
        return False
    alpha, bank, beta, d_elevon, d_flap = command_kernel(state, flight, block, script, work, dt_s)
    runge_kutta_step(state, flight, aero, dt_s, work[K1:OFFSETS], alpha, bank, beta, d_elevon, d_flap)
    return True


@njit
def run_kernel(
    state: FloatArray, flight: FloatArray, block: FloatArray, script: Script, aero: AeroTables, dt_s: float,
    work: FloatArray, rows: FloatArray,
) -> tuple[int, bool]:  # fmt: skip
    """Steps until the flight ends or rows (frames, len(ROW)) are full; how many were filled, and whether it ended."""
    for k in range(rows.shape[0]):
        if not step_kernel(state, flight, block, script, aero, dt_s, work, rows[k]):
            return k + 1, True
    return rows.shape[0], False


def aero_tables(aero: Aero, vehicle_dir: Path) -> AeroTables:
    """Tables of a vehicle for the kernels, with aero/low_speed.csv where there is one."""
    path = Path(vehicle_dir) / "aero" / "low_speed.csv"
    low = np.zeros((0, 5))
    if path.exists():
        columns = read_csv_columns(path, LOW_SPEED)
        low = np.column_stack([columns[name] for name in LOW_SPEED])
        if np.any(np.diff(low[:, 0]) <= 0.0) or low[-1, 0] >= aero.basic.mach[0]:
            raise InputError(f"{path}: mach must rise and stay below {aero.basic.mach[0]:g}, where the tables begin")
    grids = (aero.basic, aero.elevon, aero.bodyflap)
    mach = np.unique(np.concatenate([g.mach for g in grids]))
    alpha = np.unique(np.concatenate([g.alpha_deg for g in grids]))
    basic, elevon, bodyflap = (refined(g, mach, alpha) for g in grids)
    basic = np.ascontiguousarray(basic[:, :, 0])
    controls = aero.elevon.deflection_deg, aero.bodyflap.deflection_deg
    return AeroTables(mach, alpha, *controls, basic, elevon, bodyflap, np.ascontiguousarray(low))


def refined(grid: Grid, mach: FloatArray, alpha: FloatArray) -> FloatArray:
    """Values of a table on finer Mach and alpha axes that contain its own: the same function, held at its ends."""
    by_mach = np.apply_along_axis(lambda v: np.interp(mach, grid.mach, v), 0, grid.values)
    return np.ascontiguousarray(np.apply_along_axis(lambda v: np.interp(alpha, grid.alpha_deg, v), 1, by_mach))


LOW_SPEED = ("mach", "CL_0", "CL_alpha_deg", "CD_0", "K")


def flown_aero(spec: TrajectorySpec, vehicle_dir: Path) -> Aero:
    """A vehicle's aerodynamics with the mass, centre of gravity and pitching-moment shift that a scenario flies."""
    state = spec.vehicle
    return load_aero(vehicle_dir).with_changes(
        mass_kg=state.mass_kg, cg_fraction=state.cg_fraction, cm_shift=state.cm_shift
    )


def flight_block(spec: TrajectorySpec, aero: Aero) -> FloatArray:
    """Planet, vehicle state, stop and dispersions of a flight in one block, see `schedules`."""
    file, stop, state = aero.file, spec.stop, spec.vehicle
    scalars = (
        WGS84_MU_M3_S2, WGS84_J2, WGS84_ROTATION_RAD_S, WGS84_RADIUS_M, WGS84_FLATTENING,
        aero.mass_kg, file.reference.area_m2, aero.arm, aero.cm_shift, *file.cm_shift.mach,
        *file.elevon.range_deg, *file.bodyflap.range_deg, 0.0 if state.bodyflap_against == "mach" else 1.0,
        file.lateral.CY_beta_rad, stop.time_s, stop.mach or 0.0, stop.velocity_m_s or 0.0,
        -np.inf if stop.altitude_m is None else stop.altitude_m,
    )  # fmt: skip
    d = spec.dispersions
    schedules = (d.density_factor or ((0.0, 1.0),), d.wind_north_m_s or (), d.wind_east_m_s or (), state.bodyflap_deg or ())
    return pack(scalars, schedules)


def first_state(initial: Initial, flight: FloatArray, block: FloatArray, manoeuvres: int) -> FloatArray:
    """State at time 0: Cartesian position and velocity, commands on schedule, no manoeuvre begun."""
    state = np.zeros(STARTED + manoeuvres)
    state[X : VX] = cartesian_m(initial, flight)
    state[VX : VX + 3] = velocity_m_s(initial, flight)
    air = air_at(*state[X : VX + 3], flight)
    state[MEMORY:STARTED] = gd.first_memory(block, air.mach, air.speed_m_s)
    state[ALPHA], state[BANK] = state[MEMORY + gd.ALPHA_COMMAND], state[MEMORY + gd.BANK_COMMAND]
    state[LAST_SPEED] = state[EXPECTED_SPEED] = air.speed_m_s
    state[LAST_MACH] = state[EXPECTED_MACH] = air.mach
    state[STARTED:] = -1.0
    return state


def cartesian_m(initial: Initial, flight: FloatArray) -> FloatArray:
    """Earth-fixed position [m] of a geodetic latitude, longitude and altitude."""
    lat, lon = math.radians(initial.latitude_deg), math.radians(initial.longitude_deg)
    e2 = flight[FLATTENING] * (2.0 - flight[FLATTENING])
    n = flight[RADIUS] / math.sqrt(1.0 - e2 * math.sin(lat) ** 2)
    p = (n + initial.altitude_m) * math.cos(lat)
    return np.array([p * math.cos(lon), p * math.sin(lon), (n * (1.0 - e2) + initial.altitude_m) * math.sin(lat)])


def velocity_m_s(initial: Initial, flight: FloatArray) -> FloatArray:
    """Earth-fixed velocity [m/s]: the given air-relative one plus the wind."""
    lat, lon = math.radians(initial.latitude_deg), math.radians(initial.longitude_deg)
    gamma, heading = math.radians(initial.gamma_deg), math.radians(initial.heading_deg)
    north = initial.velocity_m_s * math.cos(gamma) * math.cos(heading)
    east = initial.velocity_m_s * math.cos(gamma) * math.sin(heading)
    north += scheduled(flight, WIND_NORTH, initial.altitude_m)
    east += scheduled(flight, WIND_EAST, initial.altitude_m)
    up = initial.velocity_m_s * math.sin(gamma)
    horizontal, outward = -math.sin(lat) * north + math.cos(lat) * up, math.cos(lat) * north + math.sin(lat) * up
    return np.array([
        math.cos(lon) * horizontal - math.sin(lon) * east,
        math.sin(lon) * horizontal + math.cos(lon) * east,
        outward,
    ])  # fmt: skip


class Entry:
    """One 3-DOF flight: its state, its blocks, and its frames in chunks."""

    def __init__(self, spec: TrajectorySpec, vehicle_dir: Path) -> None:
        if spec.initial is None:
            raise InputError("trajectory: the 3-DOF entry needs [trajectory.initial]")
        aero = flown_aero(spec, vehicle_dir)
        self.dt_s = 1.0 / spec.rate_hz
        self.tables = aero_tables(aero, vehicle_dir)
        self.flight = flight_block(spec, aero)
        self.block = gd.guidance_block(gd.resolve_guidance(spec.guidance, vehicle_dir), spec.initial.bank_deg)
        self.script = mv.compile_script(spec.manoeuvre)
        self.state = first_state(spec.initial, self.flight, self.block, len(spec.manoeuvre))
        self.work = np.zeros(WORK)

    def run(self, frames: int) -> tuple[FloatArray, bool]:
        """The next frames (at most `frames`, len(ROW)), and whether the flight ended with the last of them."""
        rows = np.empty((frames, len(ROW)))
        filled, ended = run_kernel(
            self.state, self.flight, self.block, self.script, self.tables, self.dt_s, self.work, rows
        )
        return rows[:filled], ended


def fly(
    spec: TrajectorySpec, vehicle_dir: Path, *, on_frame: OnFrame | None = None, progress: Progress | None = None
) -> Flight:
    """Fly a scenario's trajectory with the built-in 3-DOF entry.

    on_frame : called after each frame with its values in the order of conditions.FRAME; the array is reused
    progress : called now and then with the fraction of the flight's energy or time spent, and a line of text
    raises   : InputError for a scenario or vehicle that cannot be flown, RunError where the flight leaves the atmosphere
               model or is no number
    """
    entry = Entry(spec, vehicle_dir)
    sampler = Sampler(spec.sample_s, reference_length_m(vehicle_dir))
    events: list[tuple[float, str]] = []
    first_speed, ended = float(entry.state[LAST_SPEED]), False
    while not ended:
        memory = entry.state[MEMORY:STARTED].copy()
        rows, ended = entry.run(CHUNK)
        _refuse_nonsense(rows)
        for row in rows:
            sampler.add(row)
            if on_frame is not None:
                on_frame(row[:FRAME_LENGTH])
        events += gd.guidance_events(float(rows[-1, 0]), memory[gd.SIGN], memory[gd.PHASE], entry.state[MEMORY:STARTED])
        if progress is not None:
            progress(_done(rows[-1], first_speed, spec), f"{rows[-1, 1] / 1e3:.1f} km, {rows[-1, 2]:.0f} m/s")
    end_s = float(rows[-1, 0])
    windows = mv.windows(spec.manoeuvre, entry.script, entry.state[STARTED:], end_s)
    events += mv.events(spec.manoeuvre, entry.state[STARTED:], end_s)
    return Flight(sampler.conditions(), sorted(events, key=lambda e: e[0]), windows)


CHUNK = 32
"""Frames between two looks at guidance for events and progress."""
FRAME_LENGTH = len(FRAME)


def _refuse_nonsense(rows: FloatArray) -> None:
    """A flight that left the model, or is no number, ends with an error and never with a silent value."""
    bad = ~np.all(np.isfinite(rows), axis=1) | (rows[:, 1] > HIGHEST_M) | (rows[:, 1] < LOWEST_M)
    if np.any(bad):
        row = rows[int(np.flatnonzero(bad)[0])]
        raise RunError(
            f"3-DOF entry: at {row[0]:.1f} s the vehicle is at {row[1]:.0f} m with {row[2]:.0f} m/s, outside the atmosphere "
            f"({LOWEST_M:.0f} to {HIGHEST_M:.0f} m); check the initial speed and path angle, and give a stop"
        )


def _done(row: FloatArray, first_speed: float, spec: TrajectorySpec) -> float:
    last = spec.stop.velocity_m_s or 300.0 * (spec.stop.mach or 0.0)
    by_speed = (first_speed - row[2]) / max(first_speed - last, 1.0)
    return float(min(max(by_speed, row[0] / spec.stop.time_s, 0.0), 1.0))
