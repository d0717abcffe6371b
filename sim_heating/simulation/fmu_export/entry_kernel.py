"""The 3-DOF entry as a function of its arrays (library.py), made of the kernels that `trajectory.entry3dof` runs.

A communication step is one frame of the entry, or several equal ones, each at most `frame_s` long. Angle of attack and
bank are commanded by guidance and manoeuvres inside or, with PILOT = HOST, by the inputs, which are reached at the end
of a step along a straight line. The host ends the flight.
"""

from __future__ import annotations

import math

from sim_heating.base.kernels.jit import inline_always, njit
from sim_heating.heating.atmosphere import HIGHEST_M
from sim_heating.simulation.fmu_export.parts import library
from sim_heating.simulation.fmu_export.parts.library import GOOD, I_HEAD, at
from sim_heating.trajectory import point_mass
from sim_heating.trajectory.entry3dof import DEEPEST_M
from sim_heating.trajectory.manoeuvres import CHANNEL, ENTRY, PITCH_MODE, PLAN, TRIGGER

(PILOT, MANOEUVRES, CHOICES, INITIAL, FLIGHT, GUIDANCE, SCRIPT, AERO, STATE, WORK, ROW, OPTIONS) = range(
    I_HEAD, I_HEAD + 12
)
"""Integers of the model after those of library.py: who commands, the number of manoeuvres, and the places of arrays: of
the choices (three a manoeuvre) in N, of the aerodynamic tables in T, of all others in R."""
N_MODEL = 24
INSIDE, HOST = 1, 2
"""Values of PILOT: guidance and manoeuvres inside, or the host through the inputs."""
TRIGGER_CHOICE, CHANNEL_CHOICE, PITCH_CHOICE = range(3)
CHOICES_EACH = 3
FRAME_S = 0
"""Place in the options: longest frame [s]."""

IN_ALPHA, IN_BANK, IN_BETA, IN_ELEVON, IN_BODYFLAP, IN_JETS = range(6)
"""Inputs, in the order of their places."""

TOO_HIGH, TOO_LOW, NOT_FINITE = range(3)
"""Problems of the image, by number."""
ALTITUDE_IN_ROW, SPEED_IN_ROW = 1, 2


@njit
def _choose(R, N) -> None:
    """Write trigger, channel and pitch mode of each manoeuvre into its script."""
    for m in range(N[MANOEUVRES]):
        choices, entry = at(N, N[CHOICES] + CHOICES_EACH * m), N[SCRIPT] + PLAN + ENTRY * m
        R[entry + TRIGGER] = choices[TRIGGER_CHOICE] - 1.0
        R[entry + CHANNEL] = choices[CHANNEL_CHOICE] - 1.0
        R[entry + PITCH_MODE] = choices[PITCH_CHOICE] - 1.0


@njit
def _observe(R, N, tables) -> int:
    """Write the frame and what guidance uses; its problem, GOOD without one."""
    row = at(R, N[ROW])
    point_mass.observe_kernel(at(R, N[STATE]), at(R, N[FLIGHT]), at(tables, N[AERO]), at(R, N[WORK]), row, True)
    if not (math.isfinite(row[ALTITUDE_IN_ROW]) and math.isfinite(row[SPEED_IN_ROW])):
        return NOT_FINITE
    if row[ALTITUDE_IN_ROW] > HIGHEST_M:
        return TOO_HIGH
    if row[ALTITUDE_IN_ROW] < DEEPEST_M:
        return TOO_LOW
    return GOOD


@njit
def _follow_inputs(R, N, tables, fraction: float, dt: float) -> None:
    """One frame with the commands of the inputs, a share of the way through the communication step at its end."""
    state, before, after = at(R, N[STATE]), at(R, N[library.INPUTS_NOW]), at(R, N[library.INPUTS_NEXT])
    alpha = before[IN_ALPHA] + fraction * (after[IN_ALPHA] - before[IN_ALPHA])
    bank = before[IN_BANK] + fraction * (after[IN_BANK] - before[IN_BANK])
    beta = before[IN_BETA] + fraction * (after[IN_BETA] - before[IN_BETA])
    elevon = before[IN_ELEVON] + fraction * (after[IN_ELEVON] - before[IN_ELEVON])
    flap = before[IN_BODYFLAP] + fraction * (after[IN_BODYFLAP] - before[IN_BODYFLAP])
    # The inputs themselves: before + (after - before) may differ from them in the last bit.
    if fraction == 1.0:
        alpha, bank, beta = after[IN_ALPHA], after[IN_BANK], after[IN_BETA]
        elevon, flap = after[IN_ELEVON], after[IN_BODYFLAP]
    state[point_mass.JETS] = min(max(after[IN_JETS], 0.0), 1.0)
    controls = point_mass.Controls(alpha, bank, beta, elevon, flap)
    point_mass.runge_kutta_step(state, at(R, N[FLIGHT]), at(tables, N[AERO]), at(R, N[WORK]), dt, controls)


@inline_always
def _start(R, N, tables) -> int:
    """Set the initial state on the schedule of guidance."""
    for k in range(N[library.N_INPUTS]):
        R[N[library.INPUTS_NEXT] + k] = R[N[library.INPUTS] + k]
    _choose(R, N)
    state = at(R, N[STATE])
    point_mass.first_state_kernel(at(R, N[INITIAL]), at(R, N[FLIGHT]), at(R, N[GUIDANCE]), N[MANOEUVRES], state)
    # A host may start at a time other than 0.
    state[point_mass.T] = R[library.NOW]
    return _observe(R, N, tables)


@inline_always
def _step(R, N, tables) -> int:
    """Advance the flight to the end of a communication step."""
    length = R[library.NEXT] - R[library.NOW]
    frames = max(math.ceil(length / R[N[OPTIONS] + FRAME_S] - 1e-9), 1)
    dt, outcome = length / frames, GOOD
    state = at(R, N[STATE])
    for frame in range(frames):
        if N[PILOT] == HOST:
            _follow_inputs(R, N, tables, (frame + 1.0) / frames, dt)
        else:
            flight, guidance, script = at(R, N[FLIGHT]), at(R, N[GUIDANCE]), at(R, N[SCRIPT])
            point_mass.advance_kernel(state, flight, guidance, script, at(tables, N[AERO]), dt, at(R, N[WORK]))
        # The host's own time, so that the rounding of the frames does not accumulate.
        if frame == frames - 1:
            state[point_mass.T] = R[library.NEXT]
        outcome = _observe(R, N, tables)
        if outcome != GOOD:
            return outcome
    return outcome


def advance(R, N, A, tables) -> int:
    """The model, as library.py describes it; all of its R and N is kept, so that nothing is to be done to resume."""
    if N[library.MODE] == library.RESUME:
        return GOOD
    if N[library.MODE] == library.START:
        return _start(R, N, tables)
    return _step(R, N, tables)
