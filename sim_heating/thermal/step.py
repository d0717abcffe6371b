"""The compiled time step of the thermal model, for eight control points (lanes) at once.

The heat content E of every node changes by what its neighbours conduct to it and what enters from outside,

    d/dt E = F(T),

both with their tridiagonal derivatives from assembly.py and faces.py.

One step is TR-BDF2 with gamma = 2 - sqrt(2) (Bank et al., IEEE Trans. CAD 4 (1985) 436; Hosea and Shampine, Appl.
Numer. Math. 20 (1996) 21): one-step, L-stable, second order, here written for E so that energy is conserved to rounding
(docs/theory/equations_thermal_step.md, equations 19 and 20):

    E(Y1) = E_n + d dt (F_n + F(Y1)),                      at t_n + gamma dt,   d = gamma / 2
    E(Y2) = E_n + (w/d) (E(Y1) - E_n) + d dt F(Y2),        at t_n + dt,         w = sqrt(2) / 4

A lane stops iterating when its own update is below NEWTON_TOLERANCE_K, so that its bits do not depend on its
neighbours.

Plain Python on floats: interpreted (NUMBA_DISABLE_JIT=1) it is its own slow reference.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from sim_heating.base.arrays import FloatArray, IntArray
from sim_heating.base.kernels import block
from sim_heating.base.kernels.block import LANES
from sim_heating.base.kernels.jit import force_inline, inline_always, njit
from sim_heating.thermal.assembly import REDUCED, WHOLE_ROWS, assemble, heat_content, select_pressure
from sim_heating.thermal.faces import COLDEST_K, evaluate_faces

GAMMA = 2.0 - math.sqrt(2.0)
"""Fraction of a step at which the middle stage is [-]. This value gives both stages the same matrix."""
STAGE_WEIGHT = GAMMA / 2.0
"""d = gamma / 2, implicit weight of either stage [-]."""
EXPLICIT_WEIGHT = math.sqrt(2.0) / 4.0
"""w, weight of start and middle stage over the whole step [-]; 2 w + d = 1."""
BDF_WEIGHT = EXPLICIT_WEIGHT / STAGE_WEIGHT
"""w / d, weight of the first stage's gain of heat in the second [-]."""
NEWTON_TOLERANCE_K = 1e-4
"""Largest update at which a lane stops [K]. Convergence is quadratic, so that the remaining error is below 1e-9 K."""
NEWTON_LIMIT = 60
"""Iterations after which a stage counts as failed; one is enough for most steps of an entry."""
FREE_ITERATIONS = 6
"""Iterations after which an update ends where the next piece of a property begins. At a narrow peak of specific heat
Newton's method would go to and fro over the peak for ever."""
BELOW = 1.0 - 1e-12
"""Factor on the lower end of a piece [-] that gives a temperature in the piece below."""
MAX_EXTRAPOLATION = 2.0
"""Multiple of the last step's length over which its curvature is extrapolated [-]: that of a very short step is mostly
rounding."""


class LaneGroup(NamedTuple):
    """One lane group with what its time step needs, as the compiled time loops take it.

    B, J       : block of the group and its integers (base/kernels/block.py)
    table      : property and ratio tables
    dispatcher : address of the effect dispatcher (heating/effects/compiled.py), or the function where interpreted
    advance    : address of frame.advance, or the function where interpreted
    """

    B: FloatArray
    J: IntArray
    table: FloatArray
    dispatcher: Any
    advance: Any


@force_inline
def _entering_heat(B: FloatArray, a: int, lane: int) -> float:
    """Heat that enters a lane at the node at B[a] [W/m2], linearised over its last update as Newton's system has it."""
    return B[a + block.SOURCE * LANES + lane] + B[a + block.SLOPE * LANES + lane] * B[a + block.DELTA * LANES + lane]


@inline_always
def _record_face_heat(B: FloatArray, J: IntArray) -> None:
    """Record the heat at the faces of the lanes just updated (docs/theory/equations_thermal_step.md, equation 30)."""
    front = block.HEAD_ROWS * LANES
    for lane in range(LANES):
        moves = B[block.ACTIVE * LANES + lane] > 0.0
        # Linearised, not evaluated again: the energy balance closes to rounding however large the last update was.
        heat = _entering_heat(B, front, lane)
        B[block.STAGE_IN * LANES + lane] = heat if moves else B[block.STAGE_IN * LANES + lane]
    for lane in range(LANES):
        if B[block.ACTIVE * LANES + lane] > 0.0:
            back = (block.HEAD_ROWS + J[block.BACK_NODE + lane] * block.NODE_ROWS) * LANES
            B[block.STAGE_OUT * LANES + lane] = -_entering_heat(B, back, lane)
            if J[block.GAPS] == 1:
                for i in range(1, J[block.BACK_NODE + lane]):
                    B[block.STAGE_IN * LANES + lane] += _entering_heat(B, front + i * block.NODE_ROWS * LANES, lane)


@njit
def _add_energy(B: FloatArray, weight: float) -> None:
    for lane in range(LANES):
        B[block.ENERGY_IN * LANES + lane] += weight * B[block.STAGE_IN * LANES + lane]
        B[block.ENERGY_OUT * LANES + lane] += weight * B[block.STAGE_OUT * LANES + lane]


@inline_always
def evaluate_start(B: FloatArray, J: IntArray, table: FloatArray, dispatcher) -> None:
    """Heat content [J/m2] and net heat [W/m2] of all nodes at the present temperatures, with the conditions of stage 2.

    B     : block of the lane group; E_START, NET, STAGE_IN and STAGE_OUT change
    J     : its integers;  table : property and ratio tables;  dispatcher : address of the effect dispatcher

    A step leaves the same quantities at its end; this evaluates them where no step precedes.
    Source: docs/theory/equations_thermal_step.md, equations 3, 4 and 22.
    """
    n = J[block.N_NODES]
    select_pressure(B, J, block.END)
    for lane in range(LANES):
        B[block.ACTIVE * LANES + lane] = 1.0
    evaluate_faces(B, J, table, dispatcher, block.END, block.NO)
    for lane in range(LANES):
        B[block.STAGE_IN * LANES + lane] = B[(block.HEAD_ROWS + block.SOURCE) * LANES + lane]
        back = (block.HEAD_ROWS + J[block.BACK_NODE + lane] * block.NODE_ROWS) * LANES
        B[block.STAGE_OUT * LANES + lane] = -B[back + block.SOURCE * LANES + lane]
        if J[block.GAPS] == 1:
            for i in range(1, J[block.BACK_NODE + lane]):
                a = (block.HEAD_ROWS + i * block.NODE_ROWS) * LANES
                B[block.STAGE_IN * LANES + lane] += B[a + block.SOURCE * LANES + lane]
    for i in range(n):
        # Contents that are no numbers, of a failed step, would stay so.
        for row in (block.E_STAR, block.STAGE_LEFT, block.STAGE_RIGHT):
            for lane in range(LANES):
                B[(block.HEAD_ROWS + i * block.NODE_ROWS + row) * LANES + lane] = 0.0
    for ddt in range(2):  # with E* = 0 the residual is the heat content in no time, less the net heat in a second
        assemble(B, J, table, float(ddt), WHOLE_ROWS)
        for i in range(n):
            a = (block.HEAD_ROWS + i * block.NODE_ROWS) * LANES
            for lane in range(LANES):
                residual = B[a + block.RESIDUAL * LANES + lane]
                if ddt == 0:
                    B[a + block.E_START * LANES + lane] = residual
                else:
                    B[a + block.NET * LANES + lane] = B[a + block.E_START * LANES + lane] - residual


@inline_always
def _write_extrapolation_times(B: FloatArray, dt: float) -> None:
    """Write into the ghost node the square of the time [s2] over which the last step's curvature is extrapolated.

    0 where there was no step. Lanes may have divided their last frame differently: each has a last step of its own.
    """
    for lane in range(LANES):
        time = min(dt, MAX_EXTRAPOLATION * B[block.LAST_STEP * LANES + lane])
        B[(block.SCALAR_ROWS + block.BEND2) * LANES + lane] = time * time


@inline_always
def _begin_first_stage(B: FloatArray, n: int, dt: float) -> None:
    """First stage: E* = E_n + d dt F_n with the F_n of the last step's end, and a guess along its parabola.

    docs/theory/equations_thermal_step.md, equations 19 and 24.
    """
    ahead = GAMMA * dt
    _write_extrapolation_times(B, dt)
    for i in range(n):
        a = (block.HEAD_ROWS + i * block.NODE_ROWS) * LANES
        previous = a - block.NODE_ROWS * LANES
        for lane in range(LANES):
            content, net = B[a + block.E_START * LANES + lane], B[a + block.NET * LANES + lane]
            B[a + block.E_STAR * LANES + lane] = content + STAGE_WEIGHT * dt * net
            temperature = B[a + block.T * LANES + lane]
            B[a + block.T_START * LANES + lane] = temperature
            bend = B[previous + block.BEND2 * LANES + lane]
            B[a + block.BEND2 * LANES + lane] = bend
            change = (
                ahead * B[a + block.RATE * LANES + lane] + (GAMMA * GAMMA * bend) * B[a + block.CURVE * LANES + lane]
            )
            B[a + block.T * LANES + lane] = temperature + change


@force_inline
def close_node(B: FloatArray, a: int, lane: int, dt: float) -> None:
    """End of a step at a node of a lane: E_(n+1), F_(n+1) = (E_(n+1) - E*) / (d dt), the parabola of the step.

    a : offset of the node in the block;  dt : length of the step [s]

    Source: docs/theory/equations_thermal_step.md, equations 22 and 23.
    """
    content = heat_content(B, a + lane, block.STAGE_LEFT, block.STAGE_RIGHT)
    B[a + block.NET * LANES + lane] = (content - B[a + block.E_STAR * LANES + lane]) * (1.0 / (STAGE_WEIGHT * dt))
    B[a + block.E_START * LANES + lane] = content
    middle = B[a + block.T_STAGE * LANES + lane]
    before = (middle - B[a + block.T_START * LANES + lane]) * (1.0 / (GAMMA * dt))
    after = (B[a + block.T * LANES + lane] - middle) * (1.0 / ((1.0 - GAMMA) * dt))
    # Second divided difference of the three points: half the second derivative.
    curve = (after - before) * (1.0 / dt)
    B[a + block.CURVE * LANES + lane] = curve
    B[a + block.RATE * LANES + lane] = after + curve * ((1.0 - GAMMA) * dt)


@inline_always
def close_step(B: FloatArray, n: int, dt: float) -> None:
    """End a step of all lanes: what `step` found is the start of the next one.

    n : number of nodes;  dt : length of the step [s]

    Source: docs/theory/equations_thermal_step.md, equations 22 and 23.
    """
    for lane in range(LANES):
        B[block.LAST_STEP * LANES + lane] = dt
        B[block.STEPS * LANES + lane] += 1.0
    for i in range(n):
        a = (block.HEAD_ROWS + i * block.NODE_ROWS) * LANES
        for lane in range(LANES):
            close_node(B, a, lane, dt)


@inline_always
def substitute_back(B: FloatArray, n: int) -> None:
    """Back substitution; lanes that are active (MOVES is 1, else 0) are updated, and their heat contents with them.

    B : block of the lane group, its rows eliminated; T [K], STAGE_LEFT, STAGE_RIGHT [J/m2] and LARGEST [K] change
    n : number of nodes

    The choice is arithmetic, exact for 1 and 0: a masked store would cost more than all the rest.
    Source: docs/theory/equations_thermal_step.md, equations 29 and 30.
    """
    for i in range(n - 1, -1, -1):
        a = (block.HEAD_ROWS + i * block.NODE_ROWS) * LANES
        right = a + block.NODE_ROWS * LANES
        for lane in range(LANES):
            delta = (
                B[a + block.DELTA * LANES + lane]
                - B[a + block.UPPER * LANES + lane] * B[right + block.DELTA * LANES + lane]
            )
            B[a + block.DELTA * LANES + lane] = delta
            moves = B[right + block.MOVES * LANES + lane]
            stays = 1.0 - moves
            B[a + block.MOVES * LANES + lane] = moves
            after = B[a + block.T * LANES + lane] + moves * delta
            B[a + block.T * LANES + lane] = after if after > COLDEST_K else COLDEST_K
            after = B[a + block.E_LEFT * LANES + lane] + B[a + block.C_LEFT * LANES + lane] * delta
            B[a + block.STAGE_LEFT * LANES + lane] = moves * after + stays * B[a + block.STAGE_LEFT * LANES + lane]
            after = B[a + block.E_RIGHT * LANES + lane] + B[a + block.C_RIGHT * LANES + lane] * delta
            B[a + block.STAGE_RIGHT * LANES + lane] = moves * after + stays * B[a + block.STAGE_RIGHT * LANES + lane]
            # `size <= largest` is false for NaN, and a NaN makes every update before it NaN: node 0 reports it.
            largest, size = B[right + block.LARGEST * LANES + lane], abs(delta)
            B[a + block.LARGEST * LANES + lane] = largest if size <= largest else size


@inline_always
def _end_in_next_piece(B: FloatArray, n: int) -> None:
    """Take back updates of iterating lanes to the end of the piece of the properties that they began in.

    Heat content grows with temperature, so that the solution is beyond that end, if not within the piece.
    """
    for i in range(n):
        a = (block.HEAD_ROWS + i * block.NODE_ROWS) * LANES
        for lane in range(LANES):
            if B[block.ACTIVE * LANES + lane] > 0.0:
                t = B[a + block.T * LANES + lane]
                low, high = B[a + block.LOW * LANES + lane], B[a + block.HIGH * LANES + lane]
                t = low * BELOW if t < low else t
                B[a + block.T * LANES + lane] = high if t > high else t


@inline_always
def _stop_converged_lanes(B: FloatArray) -> int:
    """Stop the iteration of lanes whose update was small.

    returns : number of lanes still iterating
    """
    iterating = 0
    for lane in range(LANES):
        if B[block.ACTIVE * LANES + lane] > 0.0:
            B[block.ITERATIONS * LANES + lane] += 1.0
            if B[(block.HEAD_ROWS + block.LARGEST) * LANES + lane] < NEWTON_TOLERANCE_K:
                B[block.ACTIVE * LANES + lane] = 0.0
            else:
                iterating += 1
    return iterating


@njit
def _solve_stage(B: FloatArray, J: IntArray, table: FloatArray, dispatcher, stage: int, dt: float) -> None:
    """Newton iteration for E(Y) - E* - d dt F(Y) = 0 from the present temperatures (equations 25 to 30)."""
    n = J[block.N_NODES]
    behind = (block.HEAD_ROWS + n * block.NODE_ROWS) * LANES
    select_pressure(B, J, stage)
    for lane in range(LANES):
        B[block.ACTIVE * LANES + lane] = B[block.STEPPING * LANES + lane]
    for iteration in range(NEWTON_LIMIT):
        evaluate_faces(B, J, table, dispatcher, stage, stage == block.END and iteration == 0)
        assemble(B, J, table, STAGE_WEIGHT * dt, REDUCED)
        for lane in range(LANES):
            # Passed from node to node through the rows, from the ghost behind: constant distances, no alias checks.
            B[behind + block.MOVES * LANES + lane] = B[block.ACTIVE * LANES + lane]
            B[behind + block.LARGEST * LANES + lane] = 0.0
        substitute_back(B, n)
        if iteration >= FREE_ITERATIONS:
            _end_in_next_piece(B, n)
        _record_face_heat(B, J)
        if _stop_converged_lanes(B) == 0:
            return
    for lane in range(LANES):
        B[block.FAILED * LANES + lane] += B[block.ACTIVE * LANES + lane]


@inline_always
def _begin_second_stage(B: FloatArray, n: int, dt: float) -> None:
    """Second stage: E* = E_n + (w/d) (E(Y1) - E_n), and a guess along the first stage with the last step's curvature.

    docs/theory/equations_thermal_step.md, equations 20 and 24.
    """
    _write_extrapolation_times(B, dt)
    for i in range(n):
        a = (block.HEAD_ROWS + i * block.NODE_ROWS) * LANES
        previous = a - block.NODE_ROWS * LANES
        for lane in range(LANES):
            start = B[a + block.E_START * LANES + lane]
            content = heat_content(B, a + lane, block.STAGE_LEFT, block.STAGE_RIGHT)
            B[a + block.E_STAR * LANES + lane] = start + BDF_WEIGHT * (content - start)
            cold, warm = B[a + block.T_START * LANES + lane], B[a + block.T * LANES + lane]
            B[a + block.T_STAGE * LANES + lane] = warm
            bend = B[previous + block.BEND2 * LANES + lane]
            B[a + block.BEND2 * LANES + lane] = bend
            curved = (1.0 - GAMMA) * bend * B[a + block.CURVE * LANES + lane]
            B[a + block.T * LANES + lane] = cold + (warm - cold) * (1.0 / GAMMA) + curved


@inline_always
def _note_start(B: FloatArray) -> None:
    """Note what a lane returns to if its step is repeated, beyond the rows of its nodes, which a step leaves."""
    for k in range(4 * LANES):
        B[block.BEFORE_FACES * LANES + k] = B[block.STAGE_IN * LANES + k]
    for lane in range(LANES):
        B[block.BEFORE_FAILED * LANES + lane] = B[block.FAILED * LANES + lane]


@njit
def step(B: FloatArray, J: IntArray, table: FloatArray, dispatcher, dt: float) -> None:
    """Solve both stages of a step of dt [s] with the stage inputs that the scalar rows hold; `close_step` ends it.

        E(Y1) = E_n + d dt (F_n + F(Y1)),    E(Y2) = E_n + (w/d) (E(Y1) - E_n) + d dt F(Y2)

    B          : block of the group; T [K], ENERGY_IN and ENERGY_OUT [J/m2], ITERATIONS and FAILED change in the lanes
                 that take part (STEPPING)
    J          : its integers
    table      : property and ratio tables
    dispatcher : address of the effect dispatcher (heating/effects/compiled.py)
    dt         : length of the step [s], above 0

    What the step began with is left as it was (T_START, E_START, NET, RATE, CURVE), so that it can be repeated.
    Heat contents and net heat at the start are those that the last step left, since the method's last stage is its end;
    after a change of temperatures, parameters or conditions from outside, frame.advance with EVALUATE_START has to
    evaluate them again. A lane that does not converge in NEWTON_LIMIT iterations is counted in FAILED; nothing is
    raised. Source: Hosea and Shampine (1996); docs/theory/equations_thermal_step.md, equations 19 to 24.
    """
    n = J[block.N_NODES]
    _note_start(B)
    # The start's share in the energies (equation 21): STAGE_IN and STAGE_OUT still hold the end of the last step.
    _add_energy(B, EXPLICIT_WEIGHT * dt)
    _begin_first_stage(B, n, dt)
    for stage in range(1, 3):
        if stage == 2:
            _begin_second_stage(B, n, dt)
        _solve_stage(B, J, table, dispatcher, stage, dt)
        _add_energy(B, (EXPLICIT_WEIGHT if stage == 1 else STAGE_WEIGHT) * dt)
