"""The compiled time step of the thermal model, for eight control points (lanes) at once.

The heat content E of every node changes by what its neighbours conduct to it and what enters from outside,

    d/dt E = F(T),

both with their tridiagonal derivatives from assembly.py and faces.py.

One step is TR-BDF2 with gamma = 2 - sqrt(2) (Bank et al., IEEE Trans. CAD 4 (1985) 436; Hosea & Shampine, Appl. Numer.
Math. 20 (1996) 21): one-step, L-stable, second order, here written for E so that energy is conserved to rounding:

    E(Y1) = E_n + d dt (F_n + F(Y1)),                      at t_n + gamma dt,   d = gamma / 2
    E(Y2) = E_n + (w/d) (E(Y1) - E_n) + d dt F(Y2),        at t_n + dt,         w = sqrt(2) / 4

A lane stops iterating when its own update is below NEWTON_TOLERANCE_K, so that its bits do not depend on its
neighbours.

Plain Python on floats: interpreted (NUMBA_DISABLE_JIT=1) it is its own slow reference.
"""

from __future__ import annotations

import math
from functools import cache
from typing import Any

from sim_heating.base.arrays import FloatArray, IntArray
from sim_heating.base.kernels.block import (
    ACTIVE,
    ADDED,
    BACK_NODE,
    C_LEFT,
    C_RIGHT,
    C_STAGES,
    CURVE,
    DELTA,
    E_LEFT,
    E_RIGHT,
    E_STAR,
    E_START,
    END,
    ENERGY_IN,
    ENERGY_OUT,
    FAILED,
    FILM,
    GAPS,
    HEAD_ROWS,
    ITERATIONS,
    LAG_INPUT,
    LAG_PAST,
    LAG_VALUE,
    LANES,
    LARGEST,
    LAST_STEP,
    MOVES,
    N_CONDITIONS,
    N_NODES,
    NET,
    NODE_ROWS,
    PCOL,
    PFRAC,
    R_BASE,
    RATE,
    RECOVERY,
    RESIDUAL,
    SLOPE,
    SOURCE,
    STAGE_IN,
    STAGE_LEFT,
    STAGE_OUT,
    STAGE_RIGHT,
    T_STAGE,
    T_START,
    UPPER,
    T,
)
from sim_heating.base.kernels.jit import STEP_SIGNATURE, c_function, folded, inlined, njit
from sim_heating.heating.film import heat_lanes
from sim_heating.heating.ratio.lookup import forget_cells
from sim_heating.thermal.assembly import REDUCED, SHARE, WHOLE_ROWS, assemble, select_pressure
from sim_heating.thermal.faces import evaluate_faces, forget_walls

GAMMA = 2.0 - math.sqrt(2.0)
STAGE_WEIGHT = GAMMA / 2.0
EXPLICIT_WEIGHT = math.sqrt(2.0) / 4.0
BDF_WEIGHT = EXPLICIT_WEIGHT / STAGE_WEIGHT
NEWTON_TOLERANCE_K = 1e-4
"""Largest update at which a lane stops; convergence is quadratic, so what is left is below 1e-9 K."""
NEWTON_LIMIT = 25
COLDEST_K = 1.0
"""No iterate goes below this, and one that is no number becomes this: a failure, for its update is no number either."""
LONGEST_REACH = 2.0
"""The curvature of the last step is relied on for so many of its lengths: that of a very short one is rounding."""
BEGIN = 0.0
"""Length of a frame that does not move in time."""
STAGED = (FILM, RECOVERY, ADDED, PCOL, PFRAC, R_BASE, LAG_VALUE, LAG_INPUT)
"""Rows that hold one value a stage."""


@inlined
def _moved(B: FloatArray, a: int, lane: int) -> float:
    """Heat that enters a lane at the node at B[a] [W/m2], linearised over its last move as the balance of the stage
    has it."""
    return B[a + SOURCE * LANES + lane] + B[a + SLOPE * LANES + lane] * B[a + DELTA * LANES + lane]


@folded
def _keep_face_heat(B: FloatArray, J: IntArray) -> None:
    """Heat at the faces of the lanes that have just moved."""
    front = HEAD_ROWS * LANES
    for lane in range(LANES):
        moves = B[ACTIVE * LANES + lane] > 0.0
        heat = _moved(B, front, lane)
        B[STAGE_IN * LANES + lane] = heat if moves else B[STAGE_IN * LANES + lane]
    for lane in range(LANES):
        if B[ACTIVE * LANES + lane] > 0.0:
            B[STAGE_OUT * LANES + lane] = -_moved(B, (HEAD_ROWS + J[BACK_NODE + lane] * NODE_ROWS) * LANES, lane)
            if J[GAPS] == 1:
                for i in range(1, J[BACK_NODE + lane]):
                    B[STAGE_IN * LANES + lane] += _moved(B, front + i * NODE_ROWS * LANES, lane)


@njit
def _add_energy(B: FloatArray, weight: float) -> None:
    for lane in range(LANES):
        B[ENERGY_IN * LANES + lane] += weight * B[STAGE_IN * LANES + lane]
        B[ENERGY_OUT * LANES + lane] += weight * B[STAGE_OUT * LANES + lane]


@folded
def evaluate_start(B: FloatArray, J: IntArray, table: FloatArray, chain) -> None:  # type: ignore[no-untyped-def]
    """Heat contents and net heat of all nodes with the conditions of stage 2, as a step leaves them."""
    n = J[N_NODES]
    select_pressure(B, J, END)
    evaluate_faces(B, J, table, chain, END)
    for lane in range(LANES):
        B[STAGE_IN * LANES + lane] = B[(HEAD_ROWS + SOURCE) * LANES + lane]
        back = (HEAD_ROWS + J[BACK_NODE + lane] * NODE_ROWS) * LANES
        B[STAGE_OUT * LANES + lane] = -B[back + SOURCE * LANES + lane]
        if J[GAPS] == 1:
            for i in range(1, J[BACK_NODE + lane]):
                B[STAGE_IN * LANES + lane] += B[(HEAD_ROWS + i * NODE_ROWS + SOURCE) * LANES + lane]
    for i in range(n):
        for row in (E_STAR, STAGE_LEFT, STAGE_RIGHT):  # contents that are no numbers, of a failed step, would stay so
            for lane in range(LANES):
                B[(HEAD_ROWS + i * NODE_ROWS + row) * LANES + lane] = 0.0
    for ddt in range(2):  # with E* = 0 the residual is the heat content in no time, less the net heat in a second
        assemble(B, J, table, float(ddt), WHOLE_ROWS)
        for i in range(n):
            a = (HEAD_ROWS + i * NODE_ROWS) * LANES
            for lane in range(LANES):
                residual = B[a + RESIDUAL * LANES + lane]
                if ddt == 0:
                    B[a + E_START * LANES + lane] = residual
                else:
                    B[a + NET * LANES + lane] = B[a + E_START * LANES + lane] - residual


@njit
def _reach(B: FloatArray, dt: float) -> float:
    """How far into a step of dt the curvature of the last one is relied on [s]; 0 where there was none."""
    return min(dt, LONGEST_REACH * B[LAST_STEP * LANES])


@folded
def _start(B: FloatArray, n: int, dt: float) -> None:
    """First stage: E* = E_n + d dt F_n with the F_n that the last step has left, and a guess along its parabola."""
    ahead, bend = GAMMA * dt, (GAMMA * _reach(B, dt)) ** 2
    for i in range(n):
        a = (HEAD_ROWS + i * NODE_ROWS) * LANES
        for lane in range(LANES):
            content, net = B[a + E_START * LANES + lane], B[a + NET * LANES + lane]
            B[a + E_STAR * LANES + lane] = content + STAGE_WEIGHT * dt * net
            temperature = B[a + T * LANES + lane]
            B[a + T_START * LANES + lane] = temperature
            moved = ahead * B[a + RATE * LANES + lane] + bend * B[a + CURVE * LANES + lane]
            B[a + T * LANES + lane] = temperature + moved


@folded
def _finish(B: FloatArray, n: int, dt: float) -> None:
    """E_(n+1), F_(n+1) = (E_(n+1) - E*) / (d dt) of the implicit stage, and the parabola through start, stage and
    end."""
    to_stage, from_stage = GAMMA * dt, (1.0 - GAMMA) * dt
    for lane in range(LANES):
        B[LAST_STEP * LANES + lane] = dt
    for i in range(n):
        a = (HEAD_ROWS + i * NODE_ROWS) * LANES
        left, right = a - NODE_ROWS * LANES, a + NODE_ROWS * LANES
        for lane in range(LANES):
            own_left, own_right = B[a + STAGE_LEFT * LANES + lane], B[a + STAGE_RIGHT * LANES + lane]
            shared = B[right + STAGE_LEFT * LANES + lane] - own_right - own_left + B[left + STAGE_RIGHT * LANES + lane]
            content = own_left + own_right + SHARE * shared
            B[a + NET * LANES + lane] = (content - B[a + E_STAR * LANES + lane]) * (1.0 / (STAGE_WEIGHT * dt))
            B[a + E_START * LANES + lane] = content
            middle = B[a + T_STAGE * LANES + lane]
            before = (middle - B[a + T_START * LANES + lane]) * (1.0 / to_stage)
            after = (B[a + T * LANES + lane] - middle) * (1.0 / from_stage)
            curve = (after - before) * (1.0 / dt)
            B[a + CURVE * LANES + lane] = curve
            B[a + RATE * LANES + lane] = after + curve * from_stage


@folded
def _update(B: FloatArray, n: int) -> None:
    """Back substitution; lanes that are active (MOVES is 1, else 0) move, and their heat contents with them.

    The choice is arithmetic, exact for 1 and 0: a masked store would cost more than all the rest.
    """
    for i in range(n - 1, -1, -1):
        a = (HEAD_ROWS + i * NODE_ROWS) * LANES
        right = a + NODE_ROWS * LANES
        for lane in range(LANES):
            delta = B[a + DELTA * LANES + lane] - B[a + UPPER * LANES + lane] * B[right + DELTA * LANES + lane]
            B[a + DELTA * LANES + lane] = delta
            moves = B[right + MOVES * LANES + lane]
            stays = 1.0 - moves
            B[a + MOVES * LANES + lane] = moves
            after = B[a + T * LANES + lane] + moves * delta
            B[a + T * LANES + lane] = after if after > COLDEST_K else COLDEST_K
            after = B[a + E_LEFT * LANES + lane] + B[a + C_LEFT * LANES + lane] * delta
            B[a + STAGE_LEFT * LANES + lane] = moves * after + stays * B[a + STAGE_LEFT * LANES + lane]
            after = B[a + E_RIGHT * LANES + lane] + B[a + C_RIGHT * LANES + lane] * delta
            B[a + STAGE_RIGHT * LANES + lane] = moves * after + stays * B[a + STAGE_RIGHT * LANES + lane]
            largest, size = B[right + LARGEST * LANES + lane], abs(delta)
            B[a + LARGEST * LANES + lane] = largest if size <= largest else size


@folded
def _retire(B: FloatArray) -> int:
    """Take lanes whose update was small out of the iteration; how many are left in it."""
    left = 0
    for lane in range(LANES):
        if B[ACTIVE * LANES + lane] > 0.0:
            B[ITERATIONS * LANES + lane] += 1.0
            if B[(HEAD_ROWS + LARGEST) * LANES + lane] < NEWTON_TOLERANCE_K:
                B[ACTIVE * LANES + lane] = 0.0
            else:
                left += 1
    return left


@njit
def _solve_stage(B: FloatArray, J: IntArray, table: FloatArray, chain, stage: int, dt: float) -> None:  # type: ignore[no-untyped-def]
    """Newton iteration for E(Y) - E* - d dt F(Y) = 0, from the temperatures present."""
    n = J[N_NODES]
    behind = (HEAD_ROWS + n * NODE_ROWS) * LANES
    select_pressure(B, J, stage)
    for lane in range(LANES):
        B[ACTIVE * LANES + lane] = 1.0
    for _ in range(NEWTON_LIMIT):
        evaluate_faces(B, J, table, chain, stage)
        assemble(B, J, table, STAGE_WEIGHT * dt, REDUCED)
        for lane in range(LANES):
            B[behind + MOVES * LANES + lane] = B[ACTIVE * LANES + lane]
            B[behind + LARGEST * LANES + lane] = 0.0
        _update(B, n)
        _keep_face_heat(B, J)
        if _retire(B) == 0:
            return
    for lane in range(LANES):
        B[FAILED * LANES + lane] += B[ACTIVE * LANES + lane]


@folded
def _start_second_stage(B: FloatArray, n: int, dt: float) -> None:
    """E* = E_n + (w/d) (E(Y1) - E_n), and a guess along the first stage, bent as the last step was."""
    bend = (1.0 - GAMMA) * _reach(B, dt) ** 2
    for i in range(n):
        a = (HEAD_ROWS + i * NODE_ROWS) * LANES
        left, right = a - NODE_ROWS * LANES, a + NODE_ROWS * LANES
        for lane in range(LANES):
            own_left, own_right = B[a + STAGE_LEFT * LANES + lane], B[a + STAGE_RIGHT * LANES + lane]
            shared = B[right + STAGE_LEFT * LANES + lane] - own_right - own_left + B[left + STAGE_RIGHT * LANES + lane]
            start = B[a + E_START * LANES + lane]
            B[a + E_STAR * LANES + lane] = start + BDF_WEIGHT * (own_left + own_right + SHARE * shared - start)
            cold, warm = B[a + T_START * LANES + lane], B[a + T * LANES + lane]
            B[a + T_STAGE * LANES + lane] = warm
            B[a + T * LANES + lane] = cold + (warm - cold) * (1.0 / GAMMA) + bend * B[a + CURVE * LANES + lane]


@njit
def step(B: FloatArray, J: IntArray, table: FloatArray, chain, dt: float) -> None:  # type: ignore[no-untyped-def]
    """Advance the node temperatures of one lane group by dt [s] with the stage inputs that the scalar rows hold.

    B     : the block of the group; T, RATE, ENERGY_IN and ENERGY_OUT [J/m2], ITERATIONS and FAILED change
    J     : its integers
    table : property and ratio tables
    chain : the compiled effects (heating/effects/compiled.py)

    Heat contents and net heat at the start are those that the last step left (the method's last stage is its end):
    after a change of temperatures, parameters or conditions from outside, `_begin` evaluates them anew.
    """
    n = J[N_NODES]
    _add_energy(B, EXPLICIT_WEIGHT * dt)
    _start(B, n, dt)
    for stage in range(1, 3):
        if stage == 2:
            _start_second_stage(B, n, dt)
        _solve_stage(B, J, table, chain, stage, dt)
        _add_energy(B, (EXPLICIT_WEIGHT if stage == 1 else STAGE_WEIGHT) * dt)
    _finish(B, n, dt)


@folded
def _begin(B: FloatArray, J: IntArray, table: FloatArray, chain) -> None:  # type: ignore[no-untyped-def]
    """Take the condition vectors of stage 2 as those that hold now."""
    forget_cells(B)
    forget_walls(B)
    for lane in range(LANES):
        B[LAG_PAST * LANES + lane] = 0.0
    heat_lanes(B, J, table, chain, END)
    evaluate_start(B, J, table, chain)


@folded
def _advance(B: FloatArray, J: IntArray, table: FloatArray, chain, dt: float) -> None:  # type: ignore[no-untyped-def]
    """From the conditions that held to those in the vectors of stage 0 (now) and 2 (then) in dt [s], linear between.

    The caller has moved the vectors of stage 2 to stage 0 and written new ones (`hold` does the moving).
    """
    span = LANES * N_CONDITIONS
    first = C_STAGES * LANES
    for k in range(span):
        now, then = B[first + k], B[first + 2 * span + k]
        B[first + span + k] = now + GAMMA * (then - now)
    for row in STAGED:
        for lane in range(LANES):
            B[row * LANES + lane] = B[(row + 2) * LANES + lane]
    for lane in range(LANES):
        B[LAG_PAST * LANES + lane] = 1.0
    for stage in range(1, 3):
        heat_lanes(B, J, table, chain, stage)
    step(B, J, table, chain, dt)


def move(B: FloatArray, J: IntArray, table: FloatArray, chain, dt: float) -> None:  # type: ignore[no-untyped-def]
    """A frame of dt [s] (`_advance`); one of BEGIN at the start, and after any change from outside (`_begin`).

    One function, as most of what the two consist of is the same, and compiled once.
    """
    if dt == BEGIN:
        _begin(B, J, table, chain)
    else:
        _advance(B, J, table, chain, dt)


@njit
def hold(B: FloatArray) -> None:
    """The conditions at the end of the last frame become those at the start of the next."""
    span = LANES * N_CONDITIONS
    first = C_STAGES * LANES
    for k in range(span):
        B[first + k] = B[first + 2 * span + k]


@cache
def compiled() -> Any:
    """`move`, compiled when first asked for; jit.handle gives what a kernel takes of it."""
    return c_function(STEP_SIGNATURE, move)
