"""The compiled time step of the thermal model, for eight control points (lanes) at once.

In each layer rho c(T) dT/dt = d/dx( k(T, p) dT/dx ), finite volumes about nodes (linear elements, lumped heat content):

    d/dt E_i(T_i) = q_(i-1) - q_i,      q_i = g_i (theta_i(T_i) - theta_i(T_(i+1)))

with E_i [J/m2] the heat content of the two half elements at node i, theta = int k dT [W/m] (Kirchhoff's variable, so the
element flux is exact for k(T)) and g_i = (conductivity factor) / dx_i [1/m]. At the surface

    q_(-1) = film (H_r - H_w(T_0)) + q_add - eps(T_0) sigma (T_0^4 - T_sur^4),

at the back q_(n-1) = h_b (T - T_b) + eps_b sigma (T^4 - T_b^4). One step is TR-BDF2 with gamma = 2 - sqrt(2) (Bank et al.,
IEEE Trans. CAD 4 (1985) 436; Hosea & Shampine, Appl. Numer. Math. 20 (1996) 21): one-step, L-stable, second order, here
written for E so that energy is conserved to the residual of the Newton iteration:

    E(Y1)  = E_n + d dt (F_n + F(Y1)),                      at t_n + gamma dt,   d = gamma / 2
    E(Y2)  = E_n + (w/d) (E(Y1) - E_n) + d dt F(Y2),        at t_n + dt,         w = sqrt(2) / 4

A lane stops iterating when its own update is below NEWTON_TOLERANCE_K, so that its bits do not depend on its neighbours.

Everything lives in one flat float64 block, row after row of LANES numbers: HEAD_ROWS rows of scalars, then NODE_ROWS rows
a node. Loops over lanes touch rows of one node and its neighbours only, at constant distances: that is what lets the compiler
vectorise them without alias checks. What all nodes of a lane share is handed on from node to node (FRACTION, MOVES, LARGEST). Plain Python on floats: interpreted (NUMBA_DISABLE_JIT=1) it is its own slow reference.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from sim_heating.jit import njit
from sim_heating.layout import (
    ACTIVE,
    ADDED,
    BACK_EPS,
    BACK_FLUX,
    BACK_H,
    BACK_SLOPE,
    BACK_T,
    BASE,
    C_STAGES,
    COLUMN,
    DELTA,
    E_STAGE,
    E_STAR,
    E_START,
    ENERGY_IN,
    ENERGY_OUT,
    FACTOR_EPS,
    FAILED,
    FILM,
    FRACTION,
    H_REF,
    HEAD_ROWS,
    INTS_PER_NODE,
    ITERATIONS,
    K_LEFT,
    K_RIGHT,
    LANES,
    LARGEST,
    M_LEFT,
    M_RIGHT,
    MOVES,
    N_CONDITIONS,
    N_NODES,
    N_PRESSURES,
    NODE_INTS,
    NODE_ROWS,
    NOWHERE,
    PCOL,
    PFRAC,
    POLYNOMIAL,
    POLYNOMIAL_LEFT,
    R_BASE,
    RATE,
    RECOVERY,
    SCALAR_ROWS,
    STAGE_IN,
    STAGE_OUT,
    SURFACE_FLUX,
    SURFACE_SLOPE,
    SURFACE_TABLE,
    SURROUNDINGS4,
    T_START,
    THETA_LEFT,
    THETA_RIGHT,
    UPPER,
    WALL_EFFECTS,
    C,
    E,
    G,
    T,
)
from sim_heating.surface_heating import heat_lane, with_effects

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

SIGMA = 5.670374419e-8
"""Stefan-Boltzmann constant [W/(m2 K4)], CODATA 2018."""

GAMMA = 2.0 - math.sqrt(2.0)
STAGE_WEIGHT = GAMMA / 2.0
EXPLICIT_WEIGHT = math.sqrt(2.0) / 4.0
BDF_WEIGHT = EXPLICIT_WEIGHT / STAGE_WEIGHT

NEWTON_TOLERANCE_K = 1e-4
"""Largest update at which a lane stops; convergence is quadratic, so what is left is below 1e-9 K."""
NEWTON_LIMIT = 25
WALL_DIFFERENCE_K = 0.5
"""Half the step over which an effect's dependence on the wall temperature is differenced, for Newton's matrix only."""
COLDEST_K = 1.0
"""No iterate goes below this; a converged temperature there is a failure that the caller sees."""

STAGED = (FILM, RECOVERY, ADDED, PCOL, PFRAC, R_BASE)
"""Rows that hold one value a stage."""

BIN_K = 5.0
"""Width of a property-table bin [K]."""
BINS = 600
"""Bins of a property table; the last one goes on for ever."""


@njit
def _bin(temperature: float) -> int:
    """Property-table bin of a temperature [K]; the first where it is not a number (the step then reports its failure)."""
    scaled = temperature * (1.0 / BIN_K)
    if not scaled > 0.0:
        return 0
    return int(scaled) if scaled < BINS else BINS - 1


@njit
def _integral(value: float, first: float, slope: float, t: float) -> float:
    """value + integral from 0 to t of (first + slope t)."""
    return value + t * (first + 0.5 * slope * t)


@njit
def _gather(B: FloatArray, J: IntArray, table: FloatArray, i: int, offsets: int, into: int) -> None:
    """Copy the property polynomials about the present temperatures of node i beside it, for one of its two elements."""
    width = 3 + 3 * J[N_PRESSURES]
    a = (HEAD_ROWS + i * NODE_ROWS) * LANES
    for lane in range(LANES):
        j = _bin(B[a + T * LANES + lane])
        row = J[offsets + lane] + j * width
        B[a + BASE * LANES + lane] = BIN_K * j
        for k in range(3):
            B[a + (into + k) * LANES + lane] = table[row + k]
        row += 3 + 3 * int(B[COLUMN * LANES + lane])
        for k in range(6):
            B[a + (into + 3 + k) * LANES + lane] = table[row + k]


@njit
def _refresh(B: FloatArray, J: IntArray, table: FloatArray, i: int) -> None:
    """Gather the polynomials of node i anew where one of its lanes has left the bin that they hold for."""
    a = (HEAD_ROWS + i * NODE_ROWS) * LANES
    outside = 0
    for lane in range(LANES):
        t = B[a + T * LANES + lane] - B[a + BASE * LANES + lane]
        outside += 0 if (t >= 0.0 and t < BIN_K) else 1
    if outside > 0:
        node = NODE_INTS + i * INTS_PER_NODE
        if J[node] == 1:
            _gather(B, J, table, i, node - INTS_PER_NODE + 1, POLYNOMIAL_LEFT)
        _gather(B, J, table, i, node + 1, POLYNOMIAL)


@njit
def evaluate_nodes(B: FloatArray, J: IntArray, table: FloatArray) -> None:
    """Heat contents, capacities, Kirchhoff variables and conductivities of all nodes at their present temperatures."""
    for i in range(J[N_NODES]):
        a = (HEAD_ROWS + i * NODE_ROWS) * LANES
        _refresh(B, J, table, i)
        left = a - NODE_ROWS * LANES
        for lane in range(LANES):
            f = B[left + FRACTION * LANES + lane]
            B[a + FRACTION * LANES + lane] = f
            t = B[a + T * LANES + lane] - B[a + BASE * LANES + lane]
            x = a + POLYNOMIAL * LANES + lane
            c0, c1 = B[x + LANES], B[x + 2 * LANES]
            theta0, k0, k1 = _between(B, x, f)
            mass = B[a + M_RIGHT * LANES + lane] + B[a + M_LEFT * LANES + lane]
            theta, k = _integral(theta0, k0, k1, t), k0 + k1 * t
            B[a + E * LANES + lane] = mass * _integral(B[x], c0, c1, t)
            B[a + C * LANES + lane] = mass * (c0 + c1 * t)
            B[a + THETA_RIGHT * LANES + lane] = theta
            B[a + K_RIGHT * LANES + lane] = k
            B[a + THETA_LEFT * LANES + lane] = theta
            B[a + K_LEFT * LANES + lane] = k
        if J[NODE_INTS + i * INTS_PER_NODE] == 1:
            _evaluate_interface(B, a)


@njit
def _between(B: FloatArray, x: int, f: float) -> tuple[float, float, float]:
    """theta, k and its slope at the foot of a bin, a fraction f of the way between two pressure columns."""
    theta_a, k_a, slope_a = B[x + 3 * LANES], B[x + 4 * LANES], B[x + 5 * LANES]
    theta_b, k_b, slope_b = B[x + 6 * LANES], B[x + 7 * LANES], B[x + 8 * LANES]
    return theta_a + f * (theta_b - theta_a), k_a + f * (k_b - k_a), slope_a + f * (slope_b - slope_a)


@njit
def _evaluate_interface(B: FloatArray, a: int) -> None:
    """The same for a node between two materials, whose right half is there already."""
    for lane in range(LANES):
        t = B[a + T * LANES + lane] - B[a + BASE * LANES + lane]
        x = a + POLYNOMIAL * LANES + lane
        y = a + POLYNOMIAL_LEFT * LANES + lane
        m_left, m_right = B[a + M_LEFT * LANES + lane], B[a + M_RIGHT * LANES + lane]
        h_left = _integral(B[y], B[y + LANES], B[y + 2 * LANES], t)
        h_right = _integral(B[x], B[x + LANES], B[x + 2 * LANES], t)
        B[a + E * LANES + lane] = m_left * h_left + m_right * h_right
        c_left = B[y + LANES] + B[y + 2 * LANES] * t
        c_right = B[x + LANES] + B[x + 2 * LANES] * t
        B[a + C * LANES + lane] = m_left * c_left + m_right * c_right
        theta0, k0, k1 = _between(B, y, B[a + FRACTION * LANES + lane])
        B[a + THETA_LEFT * LANES + lane] = _integral(theta0, k0, k1, t)
        B[a + K_LEFT * LANES + lane] = k0 + k1 * t


@njit
def _select_pressure(B: FloatArray, J: IntArray, stage: int) -> None:
    """Set the pressure of a stage; where a lane's moved to another pair of columns, drop the polynomials gathered."""
    changed = 0
    for lane in range(LANES):
        B[(SCALAR_ROWS + FRACTION) * LANES + lane] = B[(PFRAC + stage) * LANES + lane]
        if B[COLUMN * LANES + lane] != B[(PCOL + stage) * LANES + lane]:
            changed += 1
            B[COLUMN * LANES + lane] = B[(PCOL + stage) * LANES + lane]
    if changed > 0:
        for i in range(J[N_NODES]):
            for lane in range(LANES):
                B[(HEAD_ROWS + i * NODE_ROWS + BASE) * LANES + lane] = NOWHERE


@njit
def _film(B: FloatArray, J: IntArray, chain, lane: int, stage: int, wall: float) -> tuple[float, float]:  # type: ignore[no-untyped-def]
    """Film coefficient of a lane whose effects ask for the wall temperature, and its slope against it, by difference."""
    h_ref = B[(C_STAGES + stage * N_CONDITIONS) * LANES + lane * N_CONDITIONS + H_REF]
    r = B[(R_BASE + stage) * LANES + lane]
    above = with_effects(B, J, chain, lane, stage, r, wall + WALL_DIFFERENCE_K)
    below = with_effects(B, J, chain, lane, stage, r, wall - WALL_DIFFERENCE_K)
    slope = (above - below) * (0.5 / WALL_DIFFERENCE_K)
    return h_ref * with_effects(B, J, chain, lane, stage, r, wall), h_ref * slope


@njit
def evaluate_faces(B: FloatArray, J: IntArray, table: FloatArray, chain, stage: int) -> None:  # type: ignore[no-untyped-def]
    """Flux into the surface and out of the back [W/m2] and their slopes against the face temperatures [W/(m2 K)]."""
    width = 2 + 3 * J[N_PRESSURES]
    for lane in range(LANES):
        wall = B[(HEAD_ROWS + T) * LANES + lane]
        j = _bin(wall)
        t = wall - BIN_K * j
        row = J[SURFACE_TABLE + lane] + j * width
        eps = B[FACTOR_EPS * LANES + lane] * (table[row] + t * table[row + 1])
        eps_slope = B[FACTOR_EPS * LANES + lane] * table[row + 1]
        f = B[(PFRAC + stage) * LANES + lane]
        row += 2 + 3 * int(B[(PCOL + stage) * LANES + lane])
        cp_w = table[row + 1] + f * (table[row + 4] - table[row + 1])
        H_w = table[row] + f * (table[row + 3] - table[row]) + t * cp_w
        film, film_slope = B[(FILM + stage) * LANES + lane], 0.0
        if J[WALL_EFFECTS + lane] > 0:
            film, film_slope = _film(B, J, chain, lane, stage, wall)
        driving = B[(RECOVERY + stage) * LANES + lane] - H_w
        cube = wall * wall * wall
        excess = cube * wall - B[SURROUNDINGS4 * LANES + lane]
        B[SURFACE_FLUX * LANES + lane] = film * driving + B[(ADDED + stage) * LANES + lane] - eps * SIGMA * excess
        slope = film_slope * driving - film * cp_w - SIGMA * (4.0 * eps * cube + eps_slope * excess)
        B[SURFACE_SLOPE * LANES + lane] = slope
    _evaluate_back(B, J[N_NODES])


@njit
def _evaluate_back(B: FloatArray, n: int) -> None:
    back = (HEAD_ROWS + (n - 1) * NODE_ROWS + T) * LANES
    for lane in range(LANES):
        inner, ambient = B[back + lane], B[BACK_T * LANES + lane]
        emitted = SIGMA * B[BACK_EPS * LANES + lane]
        h_b = B[BACK_H * LANES + lane]
        cube, square = inner * inner * inner, ambient * ambient
        B[BACK_FLUX * LANES + lane] = h_b * (inner - ambient) + emitted * (cube * inner - square * square)
        B[BACK_SLOPE * LANES + lane] = h_b + 4.0 * emitted * cube


@njit
def _keep_face_fluxes(B: FloatArray, n: int) -> None:
    """Face fluxes of the lanes that have just moved, linearised over that move as the balance of the stage has them."""
    back = (HEAD_ROWS + (n - 1) * NODE_ROWS + DELTA) * LANES
    front = (HEAD_ROWS + DELTA) * LANES
    for lane in range(LANES):
        if B[ACTIVE * LANES + lane] > 0.0:
            moved = B[SURFACE_SLOPE * LANES + lane] * B[front + lane]
            B[STAGE_IN * LANES + lane] = B[SURFACE_FLUX * LANES + lane] + moved
            moved = B[BACK_SLOPE * LANES + lane] * B[back + lane]
            B[STAGE_OUT * LANES + lane] = B[BACK_FLUX * LANES + lane] + moved


@njit
def _add_energy(B: FloatArray, weight: float, into: int, out: int) -> None:
    for lane in range(LANES):
        B[ENERGY_IN * LANES + lane] += weight * B[into * LANES + lane]
        B[ENERGY_OUT * LANES + lane] += weight * B[out * LANES + lane]


@njit
def _start(B: FloatArray, J: IntArray, table: FloatArray, chain, dt: float) -> None:  # type: ignore[no-untyped-def]
    """Explicit part of the first stage: E_n, E* = E_n + d dt F_n, and a first guess from the last rate of change."""
    n = J[N_NODES]
    _select_pressure(B, J, 0)
    evaluate_nodes(B, J, table)
    evaluate_faces(B, J, table, chain, 0)
    _add_energy(B, EXPLICIT_WEIGHT * dt, SURFACE_FLUX, BACK_FLUX)
    for i in range(n):
        a = (HEAD_ROWS + i * NODE_ROWS) * LANES
        left = a - NODE_ROWS * LANES
        for lane in range(LANES):
            net = 0.0
            if i > 0:
                net = B[left + G * LANES + lane] * (B[left + THETA_RIGHT * LANES + lane] - B[a + THETA_LEFT * LANES + lane])
            else:
                net = B[SURFACE_FLUX * LANES + lane]
            if i < n - 1:
                right = a + NODE_ROWS * LANES
                net -= B[a + G * LANES + lane] * (B[a + THETA_RIGHT * LANES + lane] - B[right + THETA_LEFT * LANES + lane])
            else:
                net -= B[BACK_FLUX * LANES + lane]
            e = B[a + E * LANES + lane]
            temperature = B[a + T * LANES + lane]
            B[a + E_START * LANES + lane] = e
            B[a + E_STAR * LANES + lane] = e + STAGE_WEIGHT * dt * net
            B[a + T_START * LANES + lane] = temperature
            B[a + T * LANES + lane] = temperature + GAMMA * dt * B[a + RATE * LANES + lane]


@njit
def _eliminate(B: FloatArray, n: int, ddt: float) -> None:
    """Forward sweep: residual E - E* - d dt F and its tridiagonal matrix, row by row, reduced as it is built."""
    for i in range(n):
        a = (HEAD_ROWS + i * NODE_ROWS) * LANES
        left = a - NODE_ROWS * LANES
        right = a + NODE_ROWS * LANES
        if i == 0:
            for lane in range(LANES):
                g = ddt * B[a + G * LANES + lane]
                out = g * (B[a + THETA_RIGHT * LANES + lane] - B[right + THETA_LEFT * LANES + lane])
                residual = (
                    B[a + E * LANES + lane]
                    - B[a + E_STAR * LANES + lane]
                    + out
                    - ddt * B[SURFACE_FLUX * LANES + lane]
                )
                diagonal = (
                    B[a + C * LANES + lane]
                    + g * B[a + K_RIGHT * LANES + lane]
                    - ddt * B[SURFACE_SLOPE * LANES + lane]
                )
                pivot = 1.0 / diagonal
                B[a + UPPER * LANES + lane] = -g * B[right + K_LEFT * LANES + lane] * pivot
                B[a + DELTA * LANES + lane] = -residual * pivot
        elif i < n - 1:
            for lane in range(LANES):
                g_left = ddt * B[left + G * LANES + lane]
                g = ddt * B[a + G * LANES + lane]
                into = g_left * (B[left + THETA_RIGHT * LANES + lane] - B[a + THETA_LEFT * LANES + lane])
                out = g * (B[a + THETA_RIGHT * LANES + lane] - B[right + THETA_LEFT * LANES + lane])
                residual = B[a + E * LANES + lane] - B[a + E_STAR * LANES + lane] + out - into
                lower = -g_left * B[left + K_RIGHT * LANES + lane]
                diagonal = (
                    B[a + C * LANES + lane]
                    + g_left * B[a + K_LEFT * LANES + lane]
                    + g * B[a + K_RIGHT * LANES + lane]
                    - lower * B[left + UPPER * LANES + lane]
                )
                pivot = 1.0 / diagonal
                B[a + UPPER * LANES + lane] = -g * B[right + K_LEFT * LANES + lane] * pivot
                B[a + DELTA * LANES + lane] = -(residual + lower * B[left + DELTA * LANES + lane]) * pivot
        else:
            for lane in range(LANES):
                g_left = ddt * B[left + G * LANES + lane]
                into = g_left * (B[left + THETA_RIGHT * LANES + lane] - B[a + THETA_LEFT * LANES + lane])
                residual = (
                    B[a + E * LANES + lane]
                    - B[a + E_STAR * LANES + lane]
                    + ddt * B[BACK_FLUX * LANES + lane]
                    - into
                )
                lower = -g_left * B[left + K_RIGHT * LANES + lane]
                diagonal = (
                    B[a + C * LANES + lane]
                    + g_left * B[a + K_LEFT * LANES + lane]
                    + ddt * B[BACK_SLOPE * LANES + lane]
                    - lower * B[left + UPPER * LANES + lane]
                )
                B[a + DELTA * LANES + lane] = -(residual + lower * B[left + DELTA * LANES + lane]) / diagonal


@njit
def _update(B: FloatArray, n: int) -> None:
    """Back substitution; lanes that are active move, and their heat content with them."""
    for i in range(n - 1, -1, -1):
        a = (HEAD_ROWS + i * NODE_ROWS) * LANES
        right = a + NODE_ROWS * LANES
        for lane in range(LANES):
            delta = B[a + DELTA * LANES + lane] - B[a + UPPER * LANES + lane] * B[right + DELTA * LANES + lane]
            B[a + DELTA * LANES + lane] = delta
            moves = B[right + MOVES * LANES + lane]
            B[a + MOVES * LANES + lane] = moves
            active = moves > 0.0
            cold, content = B[a + T * LANES + lane], B[a + E_STAGE * LANES + lane]
            moved = cold + delta
            moved = moved if moved > COLDEST_K else COLDEST_K
            B[a + T * LANES + lane] = moved if active else cold
            moved = B[a + E * LANES + lane] + B[a + C * LANES + lane] * delta
            B[a + E_STAGE * LANES + lane] = moved if active else content
            largest, size = B[right + LARGEST * LANES + lane], abs(delta)
            B[a + LARGEST * LANES + lane] = largest if size <= largest else size


@njit
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
    _select_pressure(B, J, stage)
    for lane in range(LANES):
        B[ACTIVE * LANES + lane] = 1.0
    for _ in range(NEWTON_LIMIT):
        evaluate_nodes(B, J, table)
        evaluate_faces(B, J, table, chain, stage)
        _eliminate(B, n, STAGE_WEIGHT * dt)
        for lane in range(LANES):
            B[behind + MOVES * LANES + lane] = B[ACTIVE * LANES + lane]
            B[behind + LARGEST * LANES + lane] = 0.0
        _update(B, n)
        _keep_face_fluxes(B, n)
        if _retire(B) == 0:
            return
    for lane in range(LANES):
        B[FAILED * LANES + lane] += B[ACTIVE * LANES + lane]


@njit
def _start_second_stage(B: FloatArray, n: int) -> None:
    for i in range(n):
        a = (HEAD_ROWS + i * NODE_ROWS) * LANES
        for lane in range(LANES):
            start = B[a + E_START * LANES + lane]
            B[a + E_STAR * LANES + lane] = start + BDF_WEIGHT * (B[a + E_STAGE * LANES + lane] - start)
            cold = B[a + T_START * LANES + lane]
            B[a + T * LANES + lane] = cold + (B[a + T * LANES + lane] - cold) * (1.0 / GAMMA)


@njit
def step(B: FloatArray, J: IntArray, table: FloatArray, chain, dt: float) -> None:  # type: ignore[no-untyped-def]
    """Advance the node temperatures of one lane group by dt [s] with the stage inputs that the scalar rows hold.

    B     : the block of the group; T, RATE, ENERGY_IN and ENERGY_OUT [J/m2], ITERATIONS and FAILED change
    J     : its integers
    table : property and ratio tables
    chain : the compiled effects (effects/chain.py)
    """
    n = J[N_NODES]
    _start(B, J, table, chain, dt)
    _solve_stage(B, J, table, chain, 1, dt)
    _add_energy(B, EXPLICIT_WEIGHT * dt, STAGE_IN, STAGE_OUT)
    _start_second_stage(B, n)
    _solve_stage(B, J, table, chain, 2, dt)
    _add_energy(B, STAGE_WEIGHT * dt, STAGE_IN, STAGE_OUT)
    for i in range(n):
        a = (HEAD_ROWS + i * NODE_ROWS) * LANES
        for lane in range(LANES):
            B[a + RATE * LANES + lane] = (B[a + T * LANES + lane] - B[a + T_START * LANES + lane]) * (1.0 / dt)


@njit
def begin(B: FloatArray, J: IntArray, table: FloatArray, chain) -> None:  # type: ignore[no-untyped-def]
    """Take the condition vectors of stage 2 as those that hold now: after a reset, or when parameters have changed."""
    wall = (HEAD_ROWS + T) * LANES
    for lane in range(LANES):
        heat_lane(B, J, table, chain, lane, 2, B[wall + lane])


@njit
def advance(B: FloatArray, J: IntArray, table: FloatArray, chain, dt: float) -> None:  # type: ignore[no-untyped-def]
    """One frame: from the conditions that held to those in the vectors of stage 0 (now) and 2 (then), linear between.

    The caller has moved the vectors of stage 2 to stage 0 and written new ones (`hold` does the moving).
    """
    wall = (HEAD_ROWS + T) * LANES
    span = LANES * N_CONDITIONS
    first = C_STAGES * LANES
    for k in range(span):
        now, then = B[first + k], B[first + 2 * span + k]
        B[first + span + k] = now + GAMMA * (then - now)
    for row in STAGED:
        for lane in range(LANES):
            B[row * LANES + lane] = B[(row + 2) * LANES + lane]
    for lane in range(LANES):
        heat_lane(B, J, table, chain, lane, 1, B[wall + lane])
        heat_lane(B, J, table, chain, lane, 2, B[wall + lane])
    step(B, J, table, chain, dt)


@njit
def hold(B: FloatArray) -> None:
    """The conditions at the end of the last frame become those at the start of the next."""
    span = LANES * N_CONDITIONS
    first = C_STAGES * LANES
    for k in range(span):
        B[first + k] = B[first + 2 * span + k]
