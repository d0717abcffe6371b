"""A point mass over the rotating WGS84 ellipsoid, gravity with J2: the compiled step of the 3-DOF entry.

State in Earth-fixed Cartesian axes r, v (no singular pole), with w the Earth's rotation:

    dr/dt = v
    dv/dt = g(r) - 2 w x v - w x (w x r) + (L - D + Y) / m            fourth-order Runge-Kutta, fixed step
    D = q S CD along the air-relative velocity u = v - wind;   L = q S CL across it, turned by the bank angle

Angle of attack, bank and control offsets are linear within a step, so they are continuous. Guidance acts once a step.

Everything is in flat float64 arrays and `step_kernel` allocates nothing: ten thousand flights are ten thousand states
and blocks, and the step can be exported.

Source: docs/theory/equations.md, equations 35 and 36.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from sim_heating.base.arrays import FloatArray
from sim_heating.base.kernels.jit import njit
from sim_heating.base.kernels.operations import pointer
from sim_heating.heating.atmosphere import G0_M_S2, speed_of_sound_kernel, standard_sound_kernel, us76_kernel
from sim_heating.trajectory import guidance as gd
from sim_heating.trajectory import manoeuvres as mv
from sim_heating.trajectory.guidance import clip, first_memory_kernel, guidance_kernel
from sim_heating.trajectory.manoeuvres import offsets_kernel, trigger_kernel
from sim_heating.trajectory.schedules import schedule_positions, scheduled
from sim_heating.trajectory.spec import MACH_COUNTS_BELOW_M
from sim_heating.trajectory.trimmed_aero import lift_drag_kernel

WGS84_MU_M3_S2 = 3.986004418e14
WGS84_RADIUS_M = 6378137.0
WGS84_FLATTENING = 1.0 / 298.257223563
WGS84_ROTATION_RAD_S = 7.292115e-5
WGS84_J2 = 1.08262982e-3
"""NIMA TR8350.2, third edition, tables 3.1 and 3.3 (J2 from the normalised C20)."""

MU, J2, ROTATION, RADIUS, FLATTENING, MASS, AREA, FLAP_LOW, FLAP_HIGH, FLAP_AXIS, CY_BETA = range(6, 17)
STOP_TIME, STOP_MACH, STOP_SPEED, STOP_ALTITUDE = range(17, 21)
DENSITY, WIND_NORTH, WIND_EAST, FLAP_SCHEDULE = schedule_positions(21, 4)
"""Places in the block of a flight: scalars after those of `trimmed_aero`, then schedules."""

T, X, Y, Z, VX, VY, VZ, ALPHA, BANK, BETA, D_ELEVON, D_FLAP, JETS = range(13)
LAST_SPEED, LAST_MACH, EXPECTED_TIME, EXPECTED_SPEED, EXPECTED_MACH, MEMORY = range(13, 19)
STARTED = MEMORY + gd.MEMORY
"""Places in a flight's state; guidance memory from MEMORY, start times of manoeuvres from STARTED."""

K1 = gd.OBSERVED
OFFSETS = K1 + 3
NEXT = OFFSETS + 6
WORK = NEXT + 3
"""Scratch array of a step: observation of guidance, acceleration, offsets of manoeuvres, triggers at the step's end."""


class Air(NamedTuple):
    """The air about the vehicle and the directions in it."""

    altitude_m: float
    up: tuple[float, float, float]
    wind: tuple[float, float, float]
    u: tuple[float, float, float]
    speed_m_s: float
    rho_kg_m3: float
    mach: float


ALTITUDE_0, SPEED_0, GAMMA_0, HEADING_0, LATITUDE_0, LONGITUDE_0 = range(6)
INITIAL = 6
"""Numbers of a flight's initial state: altitude [m], speed relative to the air [m/s], four angles [deg]."""


@njit
def dot(a: tuple[float, float, float], b: tuple[float, float, float]) -> float:
    """Scalar product, in the product of the units of both; [m2/s2] of two velocities."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@njit
def cross(a: tuple[float, float, float], b: tuple[float, float, float]) -> tuple[float, float, float]:
    """Vector product, in the product of the units of both; [m2/s2] of two velocities."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@njit
def geodetic(
    x: float, y: float, z: float, radius: float, flattening: float
) -> tuple[float, tuple[float, float, float]]:
    """Geodetic altitude [m] and the outward normal of the ellipsoid at a point.

    Bowring, Survey Review 23 (1976) 323-327, one step, in sines and cosines without an angle; below 1e-6 m to 200 km.

    Source: docs/theory/equations.md, equation 35.
    """
    e2 = flattening * (2.0 - flattening)
    b = radius * (1.0 - flattening)
    p = math.sqrt(x * x + y * y)
    r = math.sqrt(p * p + z * z)
    # Bowring's formula with his later start value (Survey Review 28, 1985): one pass, no iteration, for any altitude.
    s, c = z * (1.0 - flattening) * (1.0 + e2 / (1.0 - e2) * b / r), p
    n = math.sqrt(s * s + c * c)
    s, c = s / n, c / n
    sine, cosine = z + e2 / (1.0 - e2) * b * s * s * s, p - e2 * radius * c * c * c
    n = math.sqrt(sine * sine + cosine * cosine)
    sine, cosine = sine / n, cosine / n
    # This form of the height has no division by the cosine or sine of the latitude, and holds at poles and equator.
    altitude = p * cosine + z * sine - radius * math.sqrt(1.0 - e2 * sine * sine)
    east = max(p, 1e-9)
    return altitude, (cosine * x / east, cosine * y / east, sine)


@njit
def gravity(x: float, y: float, z: float, flight: FloatArray) -> tuple[float, float, float]:
    """Gravitation of an oblate Earth [m/s2], without the centrifugal part; central and J2 terms.

    x, y, z : Earth-fixed position [m];  flight : block of `entry3dof.flight_block`
    Source: docs/theory/equations.md, equation 35; NIMA TR8350.2, tables 3.1 and 3.3.
    """
    r2 = x * x + y * y + z * z
    k = -flight[MU] / (r2 * math.sqrt(r2))
    j = 1.5 * flight[J2] * flight[RADIUS] ** 2 / r2
    q = 5.0 * z * z / r2
    return k * x * (1.0 + j * (1.0 - q)), k * y * (1.0 + j * (1.0 - q)), k * z * (1.0 + j * (3.0 - q))


@njit
def air_at(x: float, y: float, z: float, vx: float, vy: float, vz: float, flight: FloatArray) -> Air:
    """Altitude [m], wind and air-relative velocity [m/s], density [kg/m3] and Mach number [-].

    x, y, z, vx, vy, vz : Earth-fixed position [m] and velocity [m/s]
    Source: US Standard Atmosphere 1976, with the dispersions of the flight; Bowring (1976) for the altitude.
    """
    altitude, up = geodetic(x, y, z, flight[RADIUS], flight[FLATTENING])
    p = max(math.sqrt(x * x + y * y), 1e-9)
    north, east = scheduled(flight, WIND_NORTH, altitude), scheduled(flight, WIND_EAST, altitude)
    ce, se, cp = x / p, y / p, math.sqrt(up[0] * up[0] + up[1] * up[1])
    wind = (-se * east - up[2] * ce * north, ce * east - up[2] * se * north, cp * north)
    u = (vx - wind[0], vy - wind[1], vz - wind[2])
    speed = max(math.sqrt(dot(u, u)), 1e-6)
    _, p_standard, rho_standard = us76_kernel(altitude)
    mach = speed / speed_of_sound_kernel(p_standard, rho_standard)
    return Air(altitude, up, wind, u, speed, rho_standard * scheduled(flight, DENSITY, altitude), mach)


@njit
def flap_kernel(flight: FloatArray, mach: float, speed: float, d_flap_deg: float) -> float:
    """Body flap [deg]: schedule plus offset, within its travel.

    mach [-], speed [m/s] : the schedule is over one of them;  d_flap_deg : offset [deg]
    Source: docs/theory/equations.md, section 6.
    """
    base = scheduled(flight, FLAP_SCHEDULE, mach if flight[FLAP_AXIS] == 0.0 else speed)
    return clip(base + d_flap_deg, flight[FLAP_LOW], flight[FLAP_HIGH])


class Controls(NamedTuple):
    """Angle of attack, bank about the velocity, sideslip, and offsets of elevon and body flap [deg]."""

    alpha_deg: float
    bank_deg: float
    beta_deg: float
    d_elevon_deg: float
    d_flap_deg: float


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
    x: float,
    y: float,
    z: float,
    vx: float,
    vy: float,
    vz: float,
    controls: Controls,
    flight: FloatArray,
    aero: FloatArray,
) -> Forces:
    """Forces on the vehicle at an Earth-fixed position [m] and velocity [m/s].

    controls : angles [deg];  flight : block of `entry3dof.flight_block`;  aero : of `trimmed_aero.aero_block`
    returns  : air, coefficients [-], deflections [deg], dv/dt in rotating axes [m/s2]
    Source: docs/theory/equations.md, equations 35 and 36.
    """
    air = air_at(x, y, z, vx, vy, vz, flight)
    gx, gy, gz = gravity(x, y, z, flight)
    w = flight[ROTATION]
    # Coriolis and centrifugal acceleration of the rotating axes.
    gx += w * (2.0 * vy + w * x)
    gy += w * (w * y - 2.0 * vx)
    V = air.speed_m_s
    flap = flap_kernel(flight, air.mach, V, controls.d_flap_deg)
    cl, cd, ca, elevon = lift_drag_kernel(air.mach, controls.alpha_deg, flap, controls.d_elevon_deg, flight, aero)
    pressure = 0.5 * air.rho_kg_m3 * V * V * flight[AREA] / flight[MASS]
    e = (air.u[0] / V, air.u[1] / V, air.u[2] / V)
    side = cross(e, air.up)
    n = max(math.sqrt(dot(side, side)), 1e-9)
    lift = cross(side, e)
    s, c = math.sin(math.radians(controls.bank_deg)), math.cos(math.radians(controls.bank_deg))
    cy = flight[CY_BETA] * math.radians(controls.beta_deg)
    up_force, side_force, drag = pressure * (cl * c - cy * s) / n, pressure * (cl * s + cy * c) / n, pressure * cd
    ax = gx - drag * e[0] + up_force * lift[0] + side_force * side[0]
    ay = gy - drag * e[1] + up_force * lift[1] + side_force * side[1]
    az = gz - drag * e[2] + up_force * lift[2] + side_force * side[2]
    return Forces(air, cl, cd, ca, elevon, flap, (ax, ay, az))


@njit
def observe_kernel(
    state: FloatArray, flight: FloatArray, aero: FloatArray, work: FloatArray, row: FloatArray, angles: bool
) -> None:
    """Write the observation of guidance and the acceleration [m/s2], work[:K1 + 3], and the frame's row (flight.ROW).

    angles : whether heading, latitude, longitude and flight-path angle are asked for; otherwise they are left alone
    Source: docs/theory/equations.md, equations 35 and 36.
    """
    x, y, z, vx, vy, vz = state[X], state[Y], state[Z], state[VX], state[VY], state[VZ]
    controls = Controls(state[ALPHA], state[BANK], state[BETA], state[D_ELEVON], state[D_FLAP])
    f = forces_kernel(x, y, z, vx, vy, vz, controls, flight, aero)
    air, V, observed = f.air, f.air.speed_m_s, work
    work[K1], work[K1 + 1], work[K1 + 2] = f.acceleration_m_s2
    qbar = 0.5 * air.rho_kg_m3 * V * V
    per_mass = qbar * flight[AREA] / flight[MASS]
    climb = air.up[0] * vx + air.up[1] * vy + air.up[2] * vz
    observed[gd.TIME], observed[gd.ALTITUDE] = state[T], air.altitude_m
    observed[gd.SPEED], observed[gd.MACH] = V, air.mach
    observed[gd.CLIMB], observed[gd.DRAG], observed[gd.LIFT] = climb, per_mass * f.cd, per_mass * f.cl
    observed[gd.NET_GRAVITY] = net_gravity(x, y, z, vx, vy, vz, climb, flight)
    observed[gd.QBAR], observed[gd.ALPHA_NOW] = qbar, state[ALPHA]
    row[0], row[1], row[2], row[3], row[4] = state[T], air.altitude_m, V, state[ALPHA], state[BETA]
    row[5], row[6], row[7], row[8], row[9] = f.elevon_deg, f.bodyflap_deg, air.rho_kg_m3, state[JETS], state[BANK]
    row[14] = per_mass * f.ca / G0_M_S2
    if not angles:
        return
    p = max(math.sqrt(x * x + y * y), 1e-9)
    east = (air.u[1] * x - air.u[0] * y) / p
    north = (air.u[2] - dot(air.u, air.up) * air.up[2]) / max(math.sqrt(1.0 - air.up[2] ** 2), 1e-9)
    observed[gd.HEADING] = math.degrees(math.atan2(east, north))
    observed[gd.LATITUDE], observed[gd.LONGITUDE] = math.degrees(math.asin(air.up[2])), math.degrees(math.atan2(y, x))
    row[10] = math.degrees(math.asin(clip(dot(air.u, air.up) / V, -1.0, 1.0)))
    row[11], row[12], row[13] = observed[gd.HEADING], observed[gd.LATITUDE], observed[gd.LONGITUDE]


@njit
def position_kernel(initial: FloatArray, flight: FloatArray) -> tuple[float, float, float]:
    """Earth-fixed position [m] of a geodetic latitude, longitude and altitude.

    initial : (INITIAL,) altitude [m], speed [m/s], four angles [deg];  flight : block with the ellipsoid
    Source: NIMA TR8350.2 (2000), third edition, the WGS84 ellipsoid.

    Source: docs/theory/equations.md, equation 35.
    """
    lat, lon = math.radians(initial[LATITUDE_0]), math.radians(initial[LONGITUDE_0])
    e2 = flight[FLATTENING] * (2.0 - flight[FLATTENING])
    n = flight[RADIUS] / math.sqrt(1.0 - e2 * math.sin(lat) ** 2)
    p = (n + initial[ALTITUDE_0]) * math.cos(lat)
    return p * math.cos(lon), p * math.sin(lon), (n * (1.0 - e2) + initial[ALTITUDE_0]) * math.sin(lat)


@njit
def velocity_kernel(initial: FloatArray, flight: FloatArray) -> tuple[float, float, float]:
    """Earth-fixed velocity [m/s]: the given air-relative one plus the wind.

    initial : (INITIAL,) altitude [m], speed [m/s], four angles [deg];  flight : block with the winds [m/s]
    Source: docs/theory/equations.md, section 6.
    """
    lat, lon = math.radians(initial[LATITUDE_0]), math.radians(initial[LONGITUDE_0])
    gamma, heading = math.radians(initial[GAMMA_0]), math.radians(initial[HEADING_0])
    north = initial[SPEED_0] * math.cos(gamma) * math.cos(heading)
    east = initial[SPEED_0] * math.cos(gamma) * math.sin(heading)
    north += scheduled(flight, WIND_NORTH, initial[ALTITUDE_0])
    east += scheduled(flight, WIND_EAST, initial[ALTITUDE_0])
    up = initial[SPEED_0] * math.sin(gamma)
    horizontal, outward = -math.sin(lat) * north + math.cos(lat) * up, math.cos(lat) * north + math.sin(lat) * up
    return (
        math.cos(lon) * horizontal - math.sin(lon) * east,
        math.sin(lon) * horizontal + math.cos(lon) * east,
        outward,
    )


@njit
def first_state_kernel(
    initial: FloatArray, flight: FloatArray, block: FloatArray, manoeuvres: int, state: FloatArray
) -> None:
    """State at 0 s of a flight [s], [m], [m/s], [deg]: commands on schedule, no manoeuvre started.

    initial : (INITIAL,) altitude [m], speed [m/s], four angles [deg];  state : (STARTED + manoeuvres,) output
    Source: docs/theory/equations.md, section 6.
    """
    for i in range(STARTED):
        state[i] = 0.0
    for i in range(manoeuvres):
        state[STARTED + i] = -1.0
    state[X], state[Y], state[Z] = position_kernel(initial, flight)
    state[VX], state[VY], state[VZ] = velocity_kernel(initial, flight)
    speed = initial[SPEED_0]
    mach = speed / standard_sound_kernel(initial[ALTITUDE_0])
    first_memory_kernel(block, state, MEMORY, mach, speed)
    state[ALPHA], state[BANK] = state[MEMORY + gd.ALPHA_COMMAND], state[MEMORY + gd.BANK_COMMAND]
    state[LAST_SPEED] = state[EXPECTED_SPEED] = speed
    state[LAST_MACH] = state[EXPECTED_MACH] = mach


@njit
def net_gravity(
    x: float, y: float, z: float, vx: float, vy: float, vz: float, climb: float, flight: FloatArray
) -> float:
    """g - V_i^2 / r [m/s2], V_i the horizontal inertial speed.

    x, y, z, vx, vy, vz : Earth-fixed position [m] and velocity [m/s];  climb : altitude rate [m/s]
    Source: Harpold and Graves (1979), equilibrium glide.
    """
    r2 = x * x + y * y + z * z
    ix, iy = vx - flight[ROTATION] * y, vy + flight[ROTATION] * x
    horizontal2 = max(ix * ix + iy * iy + vz * vz - climb * climb, 0.0)
    return flight[MU] / r2 - horizontal2 / math.sqrt(r2)


@njit
def command_kernel(
    state: FloatArray, flight: FloatArray, block: FloatArray, script: FloatArray, work: FloatArray, dt_s: float
) -> Controls:
    """Controls [deg] to be reached at the end of a step of dt_s [s]; starts manoeuvres.

    Speed and Mach at the end of the step are extrapolated, so that a manoeuvre starts inside the step in which its
    trigger is passed and not after it.
    """
    guidance_kernel(block, state, MEMORY, work, dt_s)
    work[NEXT] = state[T] + dt_s
    # Speed and Mach at the end of the step, extrapolated: triggers are judged where the commands take effect.
    work[NEXT + 1] = 2.0 * work[gd.SPEED] - state[LAST_SPEED]
    work[NEXT + 2] = 2.0 * work[gd.MACH] - state[LAST_MACH]
    state[LAST_SPEED], state[LAST_MACH] = work[gd.SPEED], work[gd.MACH]
    trigger_kernel(script, state, STARTED, EXPECTED_TIME, work, NEXT)
    offsets_kernel(script, state, STARTED, work[NEXT], work, OFFSETS)
    state[JETS] = clip(work[OFFSETS + mv.JETS], 0.0, 1.0)
    alpha, bank = state[MEMORY + gd.ALPHA_COMMAND] + work[OFFSETS + mv.ALPHA], state[MEMORY + gd.BANK_COMMAND]
    beta, elevon, flap = work[OFFSETS + mv.BETA], work[OFFSETS + mv.ELEVON], work[OFFSETS + mv.BODYFLAP]
    return Controls(clip(alpha, block[gd.ALPHA_LOW], block[gd.ALPHA_HIGH]), bank, beta, elevon, flap)


@njit
def runge_kutta_step(
    state: FloatArray, flight: FloatArray, aero: FloatArray, work: FloatArray, dt_s: float, controls: Controls
) -> None:
    """Classical fourth-order step of position [m] and velocity [m/s], controls linear from the state's to the given
    ones.

    work : contains the acceleration at the beginning of the step, as observe_kernel left it
    Source: docs/theory/equations.md, equation 35.
    """
    alpha, bank, beta, d_elevon, d_flap = controls
    x, y, z, vx, vy, vz = state[X], state[Y], state[Z], state[VX], state[VY], state[VZ]
    # The first slope is the acceleration of the frame: its output and the step share one evaluation of the forces.
    kx, ky, kz, lx, ly, lz = vx, vy, vz, work[K1], work[K1 + 1], work[K1 + 2]
    sx, sy, sz, ax, ay, az = kx / 6.0, ky / 6.0, kz / 6.0, lx / 6.0, ly / 6.0, lz / 6.0
    for stage in range(1, 4):
        fraction, weight = (1.0, 1.0 / 6.0) if stage == 3 else (0.5, 1.0 / 3.0)
        h = fraction * dt_s
        px, py, pz = x + h * kx, y + h * ky, z + h * kz
        kx, ky, kz = vx + h * lx, vy + h * ly, vz + h * lz
        at_stage = Controls(
            state[ALPHA] + fraction * (alpha - state[ALPHA]),
            state[BANK] + fraction * (bank - state[BANK]),
            state[BETA] + fraction * (beta - state[BETA]),
            state[D_ELEVON] + fraction * (d_elevon - state[D_ELEVON]),
            state[D_FLAP] + fraction * (d_flap - state[D_FLAP]),
        )
        lx, ly, lz = forces_kernel(px, py, pz, kx, ky, kz, at_stage, flight, aero).acceleration_m_s2
        sx, sy, sz = sx + weight * kx, sy + weight * ky, sz + weight * kz
        ax, ay, az = ax + weight * lx, ay + weight * ly, az + weight * lz
    state[X], state[Y], state[Z] = x + dt_s * sx, y + dt_s * sy, z + dt_s * sz
    state[VX], state[VY], state[VZ] = vx + dt_s * ax, vy + dt_s * ay, vz + dt_s * az
    state[ALPHA], state[BANK], state[BETA], state[D_ELEVON], state[D_FLAP] = alpha, bank, beta, d_elevon, d_flap
    state[T] += dt_s


@njit
def advance_kernel(
    state: FloatArray,
    flight: FloatArray,
    block: FloatArray,
    script: FloatArray,
    aero: FloatArray,
    dt_s: float,
    work: FloatArray,
) -> None:
    """One step of dt_s [s] with the commands of guidance and manoeuvres; work as observe_kernel left it.

    Source: docs/theory/equations.md, equation 35.
    """
    runge_kutta_step(state, flight, aero, work, dt_s, command_kernel(state, flight, block, script, work, dt_s))


@njit
def step_kernel(
    state: FloatArray,
    flight: FloatArray,
    block: FloatArray,
    script: FloatArray,
    aero: FloatArray,
    dt_s: float,
    work: FloatArray,
    row: FloatArray,
    kept: bool,
) -> bool:
    """One step of one flight; row is the frame at its beginning. False, and no step, where the flight ends there.

    state : (STARTED + manoeuvres,) as made by `first_state_kernel`, advanced by dt_s [s]
    flight: block of `entry3dof.flight_block`;  block: of `guidance.guidance_block`;  work: (WORK,);  row: (len(ROW),)
    kept  : whether the row is stored; in another one the angles may be those of an earlier frame
    Source: docs/theory/equations.md, equations 35 and 36.
    """
    # Four inverse functions a frame, of which guidance reads angles for a target alone.
    observe_kernel(state, flight, aero, work, row, kept or block[gd.HAS_TARGET] != 0.0)
    if (
        state[T] >= flight[STOP_TIME] - 1e-9
        or work[gd.ALTITUDE] <= flight[STOP_ALTITUDE]
        or work[gd.SPEED] <= flight[STOP_SPEED]
        or (work[gd.MACH] <= flight[STOP_MACH] and work[gd.ALTITUDE] < MACH_COUNTS_BELOW_M)
    ):
        return False
    advance_kernel(state, flight, block, script, aero, dt_s, work)
    return True


@njit
def run_kernel(
    state: FloatArray,
    flight: FloatArray,
    block: FloatArray,
    script: FloatArray,
    aero: FloatArray,
    dt_s: float,
    work: FloatArray,
    rows: FloatArray,
) -> tuple[int, bool]:
    """Steps of dt_s [s] until the flight ends or rows (frames, len(ROW)) are full; the number of rows, and whether it
    ended.

    Source: docs/theory/equations.md, equations 35 and 36.
    """
    for k in range(rows.shape[0]):
        if not step_kernel(
            pointer(state),
            pointer(flight),
            pointer(block),
            pointer(script),
            pointer(aero),
            dt_s,
            pointer(work),
            pointer(rows[k]),
            True,
        ):
            return k + 1, True
    return rows.shape[0], False
