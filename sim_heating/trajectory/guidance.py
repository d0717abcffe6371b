"""Entry guidance, common to all trajectory sources: angle of attack from a schedule, bank from drag and altitude rate.

Drag tracking, after the constant-drag and equilibrium-glide phases of the Shuttle's entry guidance (Harpold and
Graves (1979), "Shuttle Entry Guidance", J. Astronautical Sciences 27, 239-268), with the altitude-rate law

    altitude error   e       = Hs ln(D_ref / D)
    rate of D_ref    hdot_r  = -Hs (Ddot_ref / D_ref + 2 D / V - CDdot / CD)     Ddot_ref = -D dD_ref/dV
    command          hddot_c = -2 zeta w (hdot - hdot_r) - w^2 e
    bank             cos(bank) = (hddot_c + g - V_i^2 / r + D sin(gamma)) / (L cos(gamma))

where hdot_r is lowered by an integral of e that removes the error of the constant scale height Hs, and
CDdot / CD is that of the falling angle-of-attack schedule, see `drag_coefficient_rate`.
Above the highest velocity of the drag reference there is no e, and hdot_r is that of an equilibrium glide,
D proportional to g - V^2/r. Its sign changes at given velocities, or where the heading error to a target leaves the
deadband. Below `approach.below_mach` the same law with e = Hs ln(q_ref / q) is solved for the angle of attack (lift
taken proportional to it), and below `flare_altitude_m` the altitude rate falls exponentially to touch-down.

Inputs are the measurements of a navigation system; outputs are limited in magnitude and rate, so they are continuous.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import NamedTuple

import numpy as np
from pydantic import Field

from sim_heating.base.arrays import FloatArray
from sim_heating.base.errors import InputError
from sim_heating.base.files import check, display_path, read_toml
from sim_heating.base.kernels.jit import njit
from sim_heating.base.kernels.operations import pointer
from sim_heating.trajectory.schedules import pack, schedule_positions, schedule_slope, scheduled
from sim_heating.trajectory.spec import Approach, Guidance, GuidanceChanges

GUIDANCE = "guidance.toml"
"""File of a vehicle that holds its guidance."""
TOUCHDOWN_RATE_M_S = 1.0
"""Sink rate at the end of the flare [m/s]."""
FLARE_GAIN = 4.0
"""Frequency of the flare over that of the approach: the altitude rate follows within 2 s."""

(TIME, ALTITUDE, SPEED, MACH, CLIMB, DRAG, LIFT, NET_GRAVITY, QBAR, ALPHA_NOW, HEADING, LATITUDE, LONGITUDE) = range(13)
OBSERVED = 13

ALPHA_AXIS, ALPHA_LOW, ALPHA_HIGH, ALPHA_RATE, START_DRAG, FIRST_BANK, BANK_LOW, BANK_HIGH, BANK_RATE = range(9)
FIRST_SIGN, FREQUENCY, DAMPING, SCALE_HEIGHT, HAS_TARGET, TARGET_LATITUDE, TARGET_LONGITUDE, DEADBAND = range(9, 17)
APPROACH_MACH, APPROACH_LOW, APPROACH_HIGH, APPROACH_BANK, APPROACH_FREQUENCY, APPROACH_DAMPING = range(17, 23)
FLARE_ALTITUDE, FLARE_TIME = range(23, 25)
ALPHA_SCHEDULE, DRAG_SCHEDULE, REVERSALS, APPROACH_QBAR = schedule_positions(25, 4)

ALPHA_COMMAND, BANK_COMMAND, SIGN, PHASE, CLIMB_BIAS = range(5)
MEMORY = 5

INTEGRAL = 0.4
"""Gain of the integral of the altitude error over w^3; s^3 + 2 zeta w s^2 + w^2 s + 0.4 w^3 is stable if zeta > 0.2."""
LARGEST_BIAS_M_S = 30.0

COAST, GLIDE, TRACK, APPROACHING, FLARE = range(5)
PHASE_NAMES = ("coast", "equilibrium glide", "drag tracking", "approach", "flare")


class Observation(NamedTuple):
    """Measurements of one frame that guidance uses.

    altitude_rate_m_s : of the geodetic altitude, up positive
    drag_m_s2, lift_m_s2 : aerodynamic acceleration along and across the velocity relative to the air
    net_gravity_m_s2  : g - V_i^2 / r with V_i the horizontal inertial speed and r the distance from the Earth's centre
    heading_deg       : of the velocity relative to the air, from north, east positive
    """

    time_s: float
    altitude_m: float
    velocity_m_s: float
    mach: float
    altitude_rate_m_s: float
    drag_m_s2: float
    lift_m_s2: float
    net_gravity_m_s2: float
    qbar_Pa: float
    alpha_deg: float
    heading_deg: float = 0.0
    latitude_deg: float = 0.0
    longitude_deg: float = 0.0


def resolve_guidance(changes: GuidanceChanges, vehicle_dir: Path) -> Guidance:
    """Guidance of a flight (angles [deg], drag [m/s2]): <vehicle_dir>/guidance.toml with the scenario's keys in place
    of its own.

    raises : InputError where the file is damaged, or absent and the scenario does not give all that is needed
    """
    path = Path(vehicle_dir) / GUIDANCE
    of_vehicle = (
        load_guidance(vehicle_dir).model_dump(exclude={"format", "source", "confidence"}) if path.exists() else {}
    )
    of_scenario = changes.model_dump(exclude_none=True)
    # The two ways of reversing the bank exclude each other: that of a scenario replaces the vehicle's.
    if "target" in of_scenario or "reversals_m_s" in of_scenario:
        of_vehicle = {k: v for k, v in of_vehicle.items() if k not in ("target", "reversals_m_s")}
    merged = of_vehicle | of_scenario
    missing = [k for k in ("alpha_deg", "drag_m_s2") if merged.get(k) is None]
    if missing:
        raise InputError(f"{path}: file not found; give {' and '.join(missing)} in [trajectory.guidance]")
    return check(merged, Guidance, f"{display_path(path)} with [trajectory.guidance]")


class GuidanceFile(Guidance):
    """Contents of a vehicle's guidance.toml."""

    format: str = Field(pattern="^guidance/1$", description='"guidance/1"')
    source: str
    confidence: str


def load_guidance(vehicle_dir: Path) -> GuidanceFile:
    """Read `<vehicle_dir>/guidance.toml`: angles [deg], drag [m/s2], speeds [m/s].

    raises : InputError where it is missing or a key of it is wrong
    """
    return read_toml(Path(vehicle_dir) / GUIDANCE, GuidanceFile)


def guidance_block(g: Guidance, first_bank_deg: float = 0.0) -> FloatArray:
    """The flat block that `guidance_kernel` reads, see `schedules`; each number in the unit of its key of
    guidance.toml.

    first_bank_deg : bank about the velocity before the first command [deg]
    """
    # Without an approach, one below a Mach number that no flight reaches: the kernel needs no case for it.
    a = g.approach or Approach(below_mach=1e-9, qbar_Pa=((0.0, 1.0),))
    target = (1.0, g.target.latitude_deg, g.target.longitude_deg, g.target.deadband_deg) if g.target else (0.0,) * 4
    axis, first_sign = 0.0 if g.alpha_against == "mach" else 1.0, 1.0 if g.first_bank == "right" else -1.0
    alpha = [axis, *g.alpha_limits_deg, g.alpha_rate_deg_s]
    bank = [g.start_drag_m_s2, first_bank_deg, *g.bank_limits_deg, g.bank_rate_deg_s, first_sign]
    control = [g.frequency_rad_s, g.damping, g.scale_height_m, *target]
    approach = [a.below_mach, *a.alpha_limits_deg, a.bank_deg, a.frequency_rad_s, a.damping]
    scalars = (*alpha, *bank, *control, *approach, a.flare_altitude_m, a.flare_time_s)
    reversals = [(v, 0.0) for v in sorted(g.reversals_m_s)]
    return pack(scalars, [g.alpha_deg, g.drag_m_s2, reversals, a.qbar_Pa])


@njit
def first_memory_kernel(block: FloatArray, state: FloatArray, memory: int, mach: float, velocity_m_s: float) -> None:
    """Memory of guidance at the start of a flight: on the schedule's angle of attack and the first bank.

    block : of `guidance_block`;  mach [-], velocity_m_s [m/s] : at the start;  memory : position of its first number

    Source: Harpold and Graves (1979), as at the head.
    """
    state[memory + ALPHA_COMMAND] = scheduled(block, ALPHA_SCHEDULE, mach if block[ALPHA_AXIS] == 0.0 else velocity_m_s)
    state[memory + BANK_COMMAND], state[memory + SIGN] = block[FIRST_BANK], block[FIRST_SIGN]
    state[memory + PHASE], state[memory + CLIMB_BIAS] = COAST, 0.0


def first_memory(block: FloatArray, mach: float, velocity_m_s: float) -> FloatArray:
    """Memory of guidance at the start of a flight as a new array, (MEMORY,), at a Mach number [-] and a speed [m/s].

    Source: Harpold and Graves (1979), as at the head.
    """
    memory = np.zeros(MEMORY)
    first_memory_kernel(block, memory, 0, mach, velocity_m_s)
    return memory


@njit
def clip(x: float, low: float, high: float) -> float:
    """x within low and high, in the unit of the three ([deg], [m/s2] ...)."""
    return min(max(x, low), high)


@njit
def heading_error_deg(block: FloatArray, observed: FloatArray) -> float:
    """Heading minus the great-circle azimuth to the target [deg], -180 to 180; positive for a target to the left.

    Source: docs/theory/equations.md, section 6.
    """
    lat, there = math.radians(observed[LATITUDE]), math.radians(block[TARGET_LATITUDE])
    east = math.radians(block[TARGET_LONGITUDE] - observed[LONGITUDE])
    x = math.cos(lat) * math.sin(there) - math.sin(lat) * math.cos(there) * math.cos(east)
    azimuth = math.degrees(math.atan2(math.sin(east) * math.cos(there), x))
    return (observed[HEADING] - azimuth + 180.0) % 360.0 - 180.0


@njit
def bank_sign(block: FloatArray, observed: FloatArray, sign: float) -> float:
    """Side to bank to, 1 right or -1 left [-]: the first one, changed at each reversal velocity or when the heading
    leaves the deadband.

    Source: Harpold and Graves (1979), roll reversals.
    """
    if block[HAS_TARGET] != 0.0:
        error = heading_error_deg(block, observed)
        # Within the deadband the side is kept, so that the bank does not alternate about a target straight ahead.
        return -math.copysign(1.0, error) if abs(error) > block[DEADBAND] else sign
    start, points = int(block[REVERSALS]), int(block[REVERSALS + 1])
    passed = 0
    for i in range(points):
        if observed[SPEED] < block[start + i]:
            passed += 1
    return -block[FIRST_SIGN] if passed % 2 else block[FIRST_SIGN]


@njit
def vertical_lift(
    block: FloatArray, observed: FloatArray, climb_ref: float, error: float, w: float, zeta: float
) -> float:
    """Vertical component of lift over mass [m/s2] that brings altitude rate and altitude error to zero.

    climb_ref : reference altitude rate [m/s];  error : altitude error [m];  w : frequency [rad/s];  zeta : damping [-]
    Source: Harpold and Graves (1979), altitude-rate law; the head of this module has it.
    """
    demand = -2.0 * zeta * w * (observed[CLIMB] - climb_ref) - w * w * error
    # A steep dive would divide by a cosine near 0.
    sine = clip(observed[CLIMB] / max(observed[SPEED], 1.0), -0.9, 0.9)
    return (demand + observed[NET_GRAVITY] + observed[DRAG] * sine) / math.sqrt(1.0 - sine * sine)


@njit
def glide_lift(block: FloatArray, observed: FloatArray) -> float:
    """Vertical lift over mass [m/s2] above the drag reference: the altitude rate of an equilibrium glide, no altitude
    error.

    Source: Harpold and Graves (1979), equilibrium-glide phase.
    """
    V, D = max(observed[SPEED], 1.0), observed[DRAG]
    # At orbital speed the centrifugal force carries the vehicle and nothing remains to divide by.
    support = max(observed[NET_GRAVITY], 0.5)
    curvature = (9.8 - observed[NET_GRAVITY]) / support
    climb_ref = -block[SCALE_HEIGHT] * 2.0 * D / V * (1.0 + curvature)
    return vertical_lift(block, observed, max(climb_ref, -150.0), 0.0, block[FREQUENCY], block[DAMPING])


@njit
def drag_coefficient_rate(block: FloatArray, observed: FloatArray) -> float:
    """CDdot / CD [1/s] from the angle-of-attack schedule at the present deceleration.

    CD = CN sin(alpha) + CA cos(alpha) with CN going with sin(alpha) and CA constant, CA / CN = tan(atan(D / L) - alpha)

    Source: Harpold and Graves (1979), rate of the reference drag.

    Source: Harpold and Graves (1979), as at the head.
    """
    on_mach = block[ALPHA_AXIS] == 0.0
    x = observed[MACH] if on_mach else observed[SPEED]
    alpha = math.radians(max(scheduled(block, ALPHA_SCHEDULE, x), 5.0))
    tangent = math.tan(alpha)
    axial = max(math.tan(math.atan2(observed[DRAG], max(observed[LIFT], 1e-6)) - alpha), 0.0)
    normal_share = tangent / (tangent + axial)
    rate = -observed[DRAG] * (observed[MACH] / max(observed[SPEED], 1.0) if on_mach else 1.0)
    return 2.0 * normal_share / tangent * math.radians(schedule_slope(block, ALPHA_SCHEDULE, x)) * rate


@njit
def track_lift(block: FloatArray, state: FloatArray, memory: int, observed: FloatArray, dt_s: float) -> float:
    """Vertical lift over mass [m/s2] that follows the reference drag; advances the integral while the lift suffices.

    dt_s : since the last step [s]
    Source: Harpold and Graves (1979), drag tracking; the head of this module has the law.
    """
    V, D = max(observed[SPEED], 1.0), observed[DRAG]
    D_ref = scheduled(block, DRAG_SCHEDULE, V)
    slope = schedule_slope(block, DRAG_SCHEDULE, V)
    Hs, w, zeta = block[SCALE_HEIGHT], block[FREQUENCY], block[DAMPING]
    climb_ref = -Hs * (2.0 * D / V - D * slope / D_ref - drag_coefficient_rate(block, observed))
    climb_ref += state[memory + CLIMB_BIAS]
    error = Hs * math.log(D_ref / D)
    lift = vertical_lift(block, observed, climb_ref, error, w, zeta)
    # While the bank is saturated the error cannot be corrected, and an integral would wind up.
    if abs(lift) < observed[LIFT]:
        bias = state[memory + CLIMB_BIAS] - INTEGRAL * w * w / (2.0 * zeta) * error * dt_s
        state[memory + CLIMB_BIAS] = clip(bias, -LARGEST_BIAS_M_S, LARGEST_BIAS_M_S)
    return lift


@njit
def approach_lift(block: FloatArray, observed: FloatArray) -> float:
    """Vertical lift over mass [m/s2] that follows the reference dynamic pressure, and flares near the ground.

    At constant qbar the density rises as V falls, -hdot / Hs = -2 Vdot / V with Vdot = -D - g hdot / V, hence
    hdot = -2 Hs D V / (V^2 + 2 Hs g).
    """
    V, Hs = max(observed[SPEED], 1.0), block[SCALE_HEIGHT]
    w, zeta = block[APPROACH_FREQUENCY], block[APPROACH_DAMPING]
    # The flare follows a sink rate in proportion to altitude and never asks for a steeper descent than the present one.
    if observed[ALTITUDE] < block[FLARE_ALTITUDE]:
        climb_ref = -TOUCHDOWN_RATE_M_S - max(observed[ALTITUDE], 0.0) / block[FLARE_TIME]
        return vertical_lift(
            block, observed, max(climb_ref, min(observed[CLIMB], -TOUCHDOWN_RATE_M_S)), 0.0, FLARE_GAIN * w, zeta
        )
    climb_ref = -2.0 * Hs * observed[DRAG] * V / (V * V + 2.0 * Hs * max(observed[NET_GRAVITY], 0.0))
    error = Hs * math.log(scheduled(block, APPROACH_QBAR, observed[MACH]) / max(observed[QBAR], 1e-3))
    return vertical_lift(block, observed, climb_ref, error, w, zeta)


@njit
def phase_of(block: FloatArray, observed: FloatArray, phase: int) -> int:
    """Phase of guidance; it only advances, so that a gust cannot undo it.

    Source: Harpold and Graves (1979), as at the head.
    """
    now = COAST
    if observed[MACH] < block[APPROACH_MACH]:
        now = FLARE if observed[ALTITUDE] < block[FLARE_ALTITUDE] else APPROACHING
    elif observed[DRAG] > block[START_DRAG]:
        start, points = int(block[DRAG_SCHEDULE]), int(block[DRAG_SCHEDULE + 1])
        now = GLIDE if observed[SPEED] > block[start + points - 1] else TRACK
    return max(now, phase)


@njit
def entry_target(
    block: FloatArray, state: FloatArray, memory: int, observed: FloatArray, phase: int, sign: float, dt_s: float
) -> tuple[float, float]:
    """Angle of attack [deg] from the schedule and bank [deg] from the vertical lift, before rate limits.

    dt_s : since the last step [s];  phase, sign : of `phase_of`, `bank_sign`
    Source: Harpold and Graves (1979); the head of this module has the law.
    """
    alpha = scheduled(block, ALPHA_SCHEDULE, observed[MACH] if block[ALPHA_AXIS] == 0.0 else observed[SPEED])
    if phase == COAST:
        return alpha, block[FIRST_BANK]
    lift = glide_lift(block, observed) if phase == GLIDE else track_lift(block, state, memory, observed, dt_s)
    cosine = clip(lift / max(observed[LIFT], 1e-6), -1.0, 1.0)
    return alpha, sign * clip(math.degrees(math.acos(cosine)), block[BANK_LOW], block[BANK_HIGH])


@njit
def approach_target(block: FloatArray, observed: FloatArray, sign: float) -> tuple[float, float]:
    """Angle of attack [deg] for the vertical lift, and bank [deg], before rate limits."""
    bank = sign * block[APPROACH_BANK]
    if block[HAS_TARGET] != 0.0:
        bank = clip(-2.0 * heading_error_deg(block, observed), -block[APPROACH_BANK], block[APPROACH_BANK])
    required = approach_lift(block, observed) / math.cos(math.radians(bank))
    alpha = max(observed[ALPHA_NOW], 1.0) * required / max(observed[LIFT], 0.1)
    return clip(alpha, block[APPROACH_LOW], block[APPROACH_HIGH]), bank


@njit
def guidance_kernel(block: FloatArray, state: FloatArray, memory: int, observed: FloatArray, dt_s: float) -> None:
    """One step of guidance: the commands, MEMORY numbers of state from place `memory`, move by at most rate * dt_s
    [deg].

    observed : (OBSERVED,) in the order of Observed
    Source: Harpold and Graves (1979); docs/theory/equations.md, section 6.
    """
    phase = phase_of(block, observed, int(state[memory + PHASE]))
    sign = bank_sign(block, observed, state[memory + SIGN])
    if phase >= APPROACHING:
        alpha, bank = approach_target(block, observed, sign)
    else:
        alpha, bank = entry_target(block, state, memory, observed, phase, sign, dt_s)
    # Limits first, rates last: commands stay continuous where a phase changes.
    alpha = clip(alpha, block[ALPHA_LOW], block[ALPHA_HIGH])
    a, b = memory + ALPHA_COMMAND, memory + BANK_COMMAND
    state[a] += clip(alpha - state[a], -block[ALPHA_RATE] * dt_s, block[ALPHA_RATE] * dt_s)
    state[b] += clip(bank - state[b], -block[BANK_RATE] * dt_s, block[BANK_RATE] * dt_s)
    state[memory + SIGN] = sign
    state[memory + PHASE] = phase


@njit
def guidance_step(block: FloatArray, memory: FloatArray, observed: FloatArray, dt_s: float) -> None:
    """One step of dt_s [s] of guidance on a host's arrays, memory (MEMORY,), by `guidance_kernel`.

    Source: Harpold and Graves (1979), as at the head.
    """
    guidance_kernel(pointer(block), pointer(memory), 0, pointer(observed), dt_s)


class EntryGuidance:
    """Guidance of one flight, called by a host frame by frame.

    events : (time, text) of phases entered and reversals commanded
    """

    def __init__(self, guidance: Guidance, first_bank_deg: float = 0.0) -> None:
        self.block = guidance_block(guidance, first_bank_deg)
        self.events: list[tuple[float, str]] = []
        self._memory: FloatArray | None = None
        self._observed = np.zeros(OBSERVED)

    def command(self, observed: Observation) -> tuple[float, float]:
        """Angle of attack [deg] and bank about the velocity [deg], right positive, to be flown from this frame on.

        The rate limits act over the time since the last call; the first call returns the schedule and the first bank.

        Source: Harpold and Graves (1979), as at the head.
        """
        if self._memory is None:
            self._memory = first_memory(self.block, observed.mach, observed.velocity_m_s)
            self._observed[TIME] = observed.time_s
        dt_s = observed.time_s - self._observed[TIME]
        sign, phase = self._memory[SIGN], self._memory[PHASE]
        self._observed[:] = observed
        guidance_step(self.block, self._memory, self._observed, dt_s)
        if sign != self._memory[SIGN] or phase != self._memory[PHASE]:
            self.events += guidance_events(observed.time_s, sign, phase, self._memory)
        return float(self._memory[ALPHA_COMMAND]), float(self._memory[BANK_COMMAND])


def guidance_events(time_s: float, sign: float, phase: float, memory: FloatArray) -> list[tuple[float, str]]:
    """Events of guidance between two steps, (time [s], text): a new phase, a bank reversal.

    Source: Harpold and Graves (1979), as at the head.
    """
    events = []
    if phase != memory[PHASE]:
        events.append((time_s, PHASE_NAMES[int(memory[PHASE])]))
    if sign != memory[SIGN]:
        events.append((time_s, f"bank reversal to the {'right' if memory[SIGN] > 0.0 else 'left'}"))
    return events
