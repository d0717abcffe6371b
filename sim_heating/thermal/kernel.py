"""The compiled time step of the thermal model, for eight control points (lanes) at once.

In each layer rho c(T) dT/dt = d/dx( k(T, p) dT/dx ), linear elements in the heat content and in Kirchhoff's variable
theta = int k dT [W/m], which makes the flux through an element exact for k(T):

    d/dt E_i = q_(i-1) - q_i + source_i,      q_i = g_i (theta_i(T_i) - theta_i(T_(i+1))),     g_i = 1 / dx_i

The heat content [J/m2] of an element is shared between its nodes by the mean of the lumped and the consistent mass
matrix,

    E_i = M_L h(T_i) + M_R h(T_i) + SHARE [M_R (h(T_(i+1)) - h(T_i)) - M_L (h(T_i) - h(T_(i-1)))],    M = rho dx / 2,

whose second-order errors cancel where elements are equal (Goudreau & Taylor, Comp. Meth. Appl. Mech. Eng. 2 (1973) 69);
the sum over the nodes is the heat in the stack all the same. At the surface and at the back

    source_0     = film (H_r - H_w(T)) + q_add - eps(T) sigma (T^4 - T_sur^4),
    source_(n-1) = -h_b (T - T_b) - eps_b sigma (T^4 - T_b^4).

One step is TR-BDF2 with gamma = 2 - sqrt(2) (Bank et al., IEEE Trans. CAD 4 (1985) 436; Hosea & Shampine, Appl. Numer.
Math. 20 (1996) 21): one-step, L-stable, second order, here written for E so that energy is conserved to rounding:

    E(Y1) = E_n + d dt (F_n + F(Y1)),                      at t_n + gamma dt,   d = gamma / 2
    E(Y2) = E_n + (w/d) (E(Y1) - E_n) + d dt F(Y2),        at t_n + dt,         w = sqrt(2) / 4

A lane stops iterating when its own update is below NEWTON_TOLERANCE_K, so that its bits do not depend on its
neighbours.

Everything lives in one flat float64 block (layout.py). Loops over lanes touch rows of one node and its neighbours
only, at constant distances: that is what lets the compiler vectorise them without alias checks. What all nodes of a
lane share is handed on from node to node (FRACTION, MOVES, LARGEST). Plain Python on floats: interpreted
(NUMBA_DISABLE_JIT=1) it is its own slow reference.
"""

from __future__ import annotations

import math
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim_heating.heating_ratio.kernel import forget_cells
from sim_heating.jit import compiled_step, njit
from sim_heating.layout import (
    ACROSS,
    ACTIVE,
    ADDED,
    BACK_EPS,
    BACK_H,
    BACK_NODE,
    BACK_T,
    C_LEFT,
    C_RIGHT,
    C_STAGES,
    COLUMN,
    DELTA,
    DIAGONAL,
    E_LEFT,
    E_RIGHT,
    E_STAR,
    E_START,
    EMISSIVITY_TABLE,
    ENERGY_IN,
    ENERGY_OUT,
    ENTHALPY_TABLE,
    ENTRY,
    FACTOR_EPS,
    FAILED,
    FILM,
    FOOT,
    FOOT_LEFT,
    FRACTION,
    H_REF,
    HEAD_ROWS,
    HIGH,
    INTS_PER_NODE,
    IS_FACE,
    IS_INTERFACE,
    ITERATIONS,
    LANES,
    LARGEST,
    LOW,
    LOWER,
    M_LEFT,
    M_RIGHT,
    MATERIAL_TABLE,
    MOVES,
    N_CONDITIONS,
    N_NODES,
    N_PRESSURES,
    NET,
    NODE_INTS,
    NODE_ROWS,
    NOWHERE,
    PCOL,
    PFRAC,
    R_BASE,
    RATE,
    RECOVERY,
    RESIDUAL,
    SCALAR_ROWS,
    SLOPE,
    SOURCE,
    STAGE_IN,
    STAGE_LEFT,
    STAGE_OUT,
    STAGE_RIGHT,
    SURROUNDINGS4,
    T_START,
    THETA_RIGHT,
    UPPER,
    WALL_EFFECTS,
    G,
    T,
)
from sim_heating.surface_heating import heat_lanes, with_effects

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

SIGMA = 5.670374419e-8
"""Stefan-Boltzmann constant [W/(m2 K4)], CODATA 2018."""

GAMMA = 2.0 - math.sqrt(2.0)
STAGE_WEIGHT = GAMMA / 2.0
EXPLICIT_WEIGHT = math.sqrt(2.0) / 4.0
BDF_WEIGHT = EXPLICIT_WEIGHT / STAGE_WEIGHT

SHARE = 1.0 / 6.0
"""0 gives the lumped mass matrix, 1/3 the consistent one."""

NEWTON_TOLERANCE_K = 1e-4
"""Largest update at which a lane stops; convergence is quadratic, so what is left is below 1e-9 K."""
NEWTON_LIMIT = 25
WALL_DIFFERENCE_K = 0.5
"""Half the step over which an effect's dependence on the wall temperature is differenced, for Newton's matrix only."""
COLDEST_K = 1.0
"""No iterate goes below this, and one that is no number becomes this: a failure, for its update is no number either."""
FAR = 1e300
"""Bound of a bin that goes on for ever."""

STAGED = (FILM, RECOVERY, ADDED, PCOL, PFRAC, R_BASE)
"""Rows that hold one value a stage."""

BIN_K = 5.0
"""Width of a property-table bin [K]."""
BINS = 600
"""Bins of a property table; the last one goes on for ever."""
PIECE_HEAD = 3
"""Numbers before the polynomials of a piece: where it begins and ends, and its foot [K]."""


@njit
def _bin(temperature: float) -> int:
    """Property-table bin of a temperature [K]; the first where it is not a number (the step then reports a failure)."""
    scaled = temperature * (1.0 / BIN_K)
    if not scaled > 0.0:
        return 0
    return int(scaled) if scaled < BINS else BINS - 1


@njit
def _integral(value: float, first: float, slope: float, t: float) -> float:
    """value + integral from 0 to t of (first + slope t)."""
    return value + t * (first + 0.5 * slope * t)


@njit
def _gather(B: FloatArray, J: IntArray, table: FloatArray, a: int, lane: int, offset: int, into: int) -> int:
    """Copy the property polynomials about the temperature of a node beside it, for one element; gives their place."""
    piece = int(table[offset + _bin(B[a + T * LANES + lane])])
    row = offset + BINS + piece * (PIECE_HEAD + 3 + 3 * J[N_PRESSURES + lane])
    B[a + into * LANES + lane] = table[row + 2]
    for k in range(3):
        B[a + (into + 1 + k) * LANES + lane] = table[row + PIECE_HEAD + k]
    column = row + PIECE_HEAD + 3 + 3 * int(B[COLUMN * LANES + lane])
    for k in range(6):
        B[a + (into + 4 + k) * LANES + lane] = table[column + k]
    return row


@njit
def _refresh(B: FloatArray, J: IntArray, table: FloatArray, i: int) -> None:
    """Gather the polynomials of node i anew in the lanes that have left the piece that they hold for."""
    a = (HEAD_ROWS + i * NODE_ROWS) * LANES
    outside = 0
    for lane in range(LANES):
        t = B[a + T * LANES + lane]
        outside += 0 if (t >= B[a + LOW * LANES + lane] and t < B[a + HIGH * LANES + lane]) else 1
    if outside == 0:
        return
    node = NODE_INTS + i * INTS_PER_NODE
    for lane in range(LANES):
        t = B[a + T * LANES + lane]
        if not (t >= B[a + LOW * LANES + lane] and t < B[a + HIGH * LANES + lane]):
            row = _gather(B, J, table, a, lane, J[node + MATERIAL_TABLE + lane], FOOT)
            low, high = table[row], table[row + 1]
            if J[node + IS_INTERFACE] == 1:
                row = _gather(B, J, table, a, lane, J[node - INTS_PER_NODE + MATERIAL_TABLE + lane], FOOT_LEFT)
                low, high = max(low, table[row]), min(high, table[row + 1])
            B[a + LOW * LANES + lane] = low
            B[a + HIGH * LANES + lane] = high


@njit
def _properties(B: FloatArray, a: int, lane: int, foot: int, f: float) -> tuple[float, float, float, float]:
    """Enthalpy, specific heat, theta and k at the node's temperature, a fraction f between two pressure columns."""
    t = B[a + T * LANES + lane] - B[a + foot * LANES + lane]
    x = a + (foot + 1) * LANES + lane
    c0, c1 = B[x + LANES], B[x + 2 * LANES]
    theta_a, k_a, slope_a = B[x + 3 * LANES], B[x + 4 * LANES], B[x + 5 * LANES]
    theta0 = theta_a + f * (B[x + 6 * LANES] - theta_a)
    k0 = k_a + f * (B[x + 7 * LANES] - k_a)
    k1 = slope_a + f * (B[x + 8 * LANES] - slope_a)
    return _integral(B[x], c0, c1, t), c0 + c1 * t, _integral(theta0, k0, k1, t), k0 + k1 * t


@njit
def _write_row(
    B: FloatArray, a: int, lane: int, ddt: float,
    h_left: float, c_left: float, theta_left: float, k_left: float, h: float, c: float, theta: float, k: float,
) -> None:  # fmt: skip
    """Row of a node with its properties on either side; what its right neighbour adds is in that one's ACROSS and
    ENTRY.

    What crosses an element, heat conducted in d dt and heat content shared, is taken together.
    """
    left = a - NODE_ROWS * LANES
    m_left, m_right = B[a + M_LEFT * LANES + lane], B[a + M_RIGHT * LANES + lane]
    e_left, cap_left, e_right, cap_right = m_left * h_left, m_left * c_left, m_right * h, m_right * c
    g_left = ddt * B[left + G * LANES + lane]
    across = g_left * (B[left + THETA_RIGHT * LANES + lane] - theta_left)
    across += SHARE * (e_left - B[left + E_RIGHT * LANES + lane])
    entry = SHARE * cap_left - g_left * k_left
    lower = SHARE * cap_right - ddt * B[a + G * LANES + lane] * k
    B[a + E_LEFT * LANES + lane] = e_left
    B[a + C_LEFT * LANES + lane] = cap_left
    B[a + E_RIGHT * LANES + lane] = e_right
    B[a + C_RIGHT * LANES + lane] = cap_right
    B[a + THETA_RIGHT * LANES + lane] = theta
    B[a + ACROSS * LANES + lane] = across
    B[a + ENTRY * LANES + lane] = entry
    B[a + LOWER * LANES + lane] = lower
    B[a + DIAGONAL * LANES + lane] = cap_left + cap_right - entry - lower
    B[a + RESIDUAL * LANES + lane] = e_left + e_right - B[a + E_STAR * LANES + lane] - across


@njit
def _assemble(B: FloatArray, J: IntArray, table: FloatArray, i: int, ddt: float) -> None:
    """Row of node i at its present temperatures, heat from outside included."""
    a = (HEAD_ROWS + i * NODE_ROWS) * LANES
    left = a - NODE_ROWS * LANES
    _refresh(B, J, table, i)
    if J[NODE_INTS + i * INTS_PER_NODE + IS_INTERFACE] == 1:
        for lane in range(LANES):
            f = B[left + FRACTION * LANES + lane]
            B[a + FRACTION * LANES + lane] = f
            h_left, c_left, theta_left, k_left = _properties(B, a, lane, FOOT_LEFT, f)
            h, c, theta, k = _properties(B, a, lane, FOOT, f)
            _write_row(B, a, lane, ddt, h_left, c_left, theta_left, k_left, h, c, theta, k)
    else:
        for lane in range(LANES):
            f = B[left + FRACTION * LANES + lane]
            B[a + FRACTION * LANES + lane] = f
            h, c, theta, k = _properties(B, a, lane, FOOT, f)
            _write_row(B, a, lane, ddt, h, c, theta, k, h, c, theta, k)
    if J[NODE_INTS + i * INTS_PER_NODE + IS_FACE] == 1:
        for lane in range(LANES):
            B[a + RESIDUAL * LANES + lane] -= ddt * B[a + SOURCE * LANES + lane]
            B[a + DIAGONAL * LANES + lane] -= ddt * B[a + SLOPE * LANES + lane]


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
                B[(HEAD_ROWS + i * NODE_ROWS + HIGH) * LANES + lane] = NOWHERE


@njit
def _film(B: FloatArray, J: IntArray, chain, lane: int, stage: int, wall: float) -> tuple[float, float]:  # type: ignore[no-untyped-def]
    """Film coefficient of a lane whose effects ask for the wall temperature, and its slope against it."""
    h_ref = B[C_STAGES * LANES + (stage * LANES + lane) * N_CONDITIONS + H_REF]
    r = B[(R_BASE + stage) * LANES + lane]
    above = with_effects(B, J, chain, lane, stage, r, wall + WALL_DIFFERENCE_K)
    below = with_effects(B, J, chain, lane, stage, r, wall - WALL_DIFFERENCE_K)
    slope = (above - below) * (0.5 / WALL_DIFFERENCE_K)
    return h_ref * with_effects(B, J, chain, lane, stage, r, wall), h_ref * slope


@njit
def _emissivity(table: FloatArray, first: int, wall: float) -> tuple[float, float]:
    """Emittance and its slope [1/K]: linear between the points of the table, constant beyond its ends.

    The points are kept as they are, without bins: radiation feels a corner that is cut.
    """
    n = int(table[first])
    T_K, eps = first + 1, first + 1 + n
    if n == 1 or not wall > table[T_K]:
        return table[eps], 0.0
    if wall >= table[T_K + n - 1]:
        return table[eps + n - 1], 0.0
    i = 0
    while wall >= table[T_K + i + 1]:
        i += 1
    slope = (table[eps + i + 1] - table[eps + i]) / (table[T_K + i + 1] - table[T_K + i])
    return table[eps + i] + slope * (wall - table[T_K + i]), slope


@njit
def evaluate_surface(B: FloatArray, J: IntArray, table: FloatArray, chain, stage: int) -> None:  # type: ignore[no-untyped-def]
    """Heat that enters at the surface [W/m2] and its slope against the surface temperature [W/(m2 K)]."""
    a = HEAD_ROWS * LANES
    for lane in range(LANES):
        wall = B[a + T * LANES + lane]
        factor = B[FACTOR_EPS * LANES + lane]
        eps, eps_slope = _emissivity(table, J[EMISSIVITY_TABLE + lane], wall)
        j = _bin(wall)
        f = B[(PFRAC + stage) * LANES + lane]
        row = J[ENTHALPY_TABLE + lane] + 2 * (j * J[N_PRESSURES + lane] + int(B[(PCOL + stage) * LANES + lane]))
        cp_w = table[row + 1] + f * (table[row + 3] - table[row + 1])
        H_w = table[row] + f * (table[row + 2] - table[row]) + (wall - BIN_K * j) * cp_w
        film, film_slope = B[(FILM + stage) * LANES + lane], 0.0
        if J[WALL_EFFECTS + lane] > 0:
            film, film_slope = _film(B, J, chain, lane, stage, wall)
        driving = B[(RECOVERY + stage) * LANES + lane] - H_w
        cube = wall * wall * wall
        excess = cube * wall - B[SURROUNDINGS4 * LANES + lane]
        radiated = factor * eps * SIGMA * excess
        B[a + SOURCE * LANES + lane] = film * driving + B[(ADDED + stage) * LANES + lane] - radiated
        radiated = factor * SIGMA * (4.0 * eps * cube + eps_slope * excess)
        B[a + SLOPE * LANES + lane] = film_slope * driving - film * cp_w - radiated


@njit
def evaluate_back(B: FloatArray, J: IntArray) -> None:
    """Heat that enters at the back face [W/m2] and its slope against the temperature there [W/(m2 K)]."""
    for lane in range(LANES):
        a = (HEAD_ROWS + J[BACK_NODE + lane] * NODE_ROWS) * LANES
        inner, ambient = B[a + T * LANES + lane], B[BACK_T * LANES + lane]
        emitted = SIGMA * B[BACK_EPS * LANES + lane]
        h_b = B[BACK_H * LANES + lane]
        cube, square = inner * inner * inner, ambient * ambient
        B[a + SOURCE * LANES + lane] = -h_b * (inner - ambient) - emitted * (cube * inner - square * square)
        B[a + SLOPE * LANES + lane] = -h_b - 4.0 * emitted * cube


@njit
def _keep_face_heat(B: FloatArray, J: IntArray) -> None:
    """Heat at the faces of the lanes that have just moved, linearised over the move as the balance of the stage has
    it."""
    front = HEAD_ROWS * LANES
    for lane in range(LANES):
        if B[ACTIVE * LANES + lane] > 0.0:
            moved = B[front + SLOPE * LANES + lane] * B[front + DELTA * LANES + lane]
            B[STAGE_IN * LANES + lane] = B[front + SOURCE * LANES + lane] + moved
            back = (HEAD_ROWS + J[BACK_NODE + lane] * NODE_ROWS) * LANES
            moved = B[back + SLOPE * LANES + lane] * B[back + DELTA * LANES + lane]
            B[STAGE_OUT * LANES + lane] = -B[back + SOURCE * LANES + lane] - moved


@njit
def _add_energy(B: FloatArray, weight: float) -> None:
    for lane in range(LANES):
        B[ENERGY_IN * LANES + lane] += weight * B[STAGE_IN * LANES + lane]
        B[ENERGY_OUT * LANES + lane] += weight * B[STAGE_OUT * LANES + lane]


@njit
def evaluate_start(B: FloatArray, J: IntArray, table: FloatArray, chain) -> None:  # type: ignore[no-untyped-def]
    """Heat contents and net heat of all nodes with the conditions of stage 2, as a step leaves them."""
    n = J[N_NODES]
    _select_pressure(B, J, 2)
    evaluate_surface(B, J, table, chain, 2)
    evaluate_back(B, J)
    for lane in range(LANES):
        B[STAGE_IN * LANES + lane] = B[(HEAD_ROWS + SOURCE) * LANES + lane]
        back = (HEAD_ROWS + J[BACK_NODE + lane] * NODE_ROWS) * LANES
        B[STAGE_OUT * LANES + lane] = -B[back + SOURCE * LANES + lane]
    for ddt in range(
        2
    ):  # what crosses an element in no time is heat content shared, in a second conducted heat besides
        for i in range(n):
            _assemble(B, J, table, i, float(ddt))
        _assemble_behind(B, n)
        for i in range(n):
            a = (HEAD_ROWS + i * NODE_ROWS) * LANES
            right = a + NODE_ROWS * LANES
            for lane in range(LANES):
                crossing = B[right + ACROSS * LANES + lane] - B[a + ACROSS * LANES + lane]
                if ddt == 0:
                    own = B[a + E_LEFT * LANES + lane] + B[a + E_RIGHT * LANES + lane]
                    B[a + E_START * LANES + lane] = own + crossing
                    B[a + NET * LANES + lane] = crossing
                else:
                    conducted = B[a + NET * LANES + lane] - crossing
                    B[a + NET * LANES + lane] = conducted + B[a + SOURCE * LANES + lane]


@njit
def _start(B: FloatArray, n: int, dt: float) -> None:
    """First stage: E* = E_n + d dt F_n with the F_n that the last step has left, and a guess from its rate of
    change."""
    for i in range(n):
        a = (HEAD_ROWS + i * NODE_ROWS) * LANES
        for lane in range(LANES):
            content, net = B[a + E_START * LANES + lane], B[a + NET * LANES + lane]
            B[a + E_STAR * LANES + lane] = content + STAGE_WEIGHT * dt * net
            temperature = B[a + T * LANES + lane]
            B[a + T_START * LANES + lane] = temperature
            B[a + T * LANES + lane] = temperature + GAMMA * dt * B[a + RATE * LANES + lane]


@njit
def _finish(B: FloatArray, n: int, dt: float) -> None:
    """E_(n+1), F_(n+1) = (E_(n+1) - E*) / (d dt) of the implicit stage, and the rate of change."""
    for i in range(n):
        a = (HEAD_ROWS + i * NODE_ROWS) * LANES
        left, right = a - NODE_ROWS * LANES, a + NODE_ROWS * LANES
        for lane in range(LANES):
            own_left, own_right = B[a + STAGE_LEFT * LANES + lane], B[a + STAGE_RIGHT * LANES + lane]
            shared = B[right + STAGE_LEFT * LANES + lane] - own_right - own_left + B[left + STAGE_RIGHT * LANES + lane]
            content = own_left + own_right + SHARE * shared
            B[a + NET * LANES + lane] = (content - B[a + E_STAR * LANES + lane]) * (1.0 / (STAGE_WEIGHT * dt))
            B[a + E_START * LANES + lane] = content
            B[a + RATE * LANES + lane] = (B[a + T * LANES + lane] - B[a + T_START * LANES + lane]) * (1.0 / dt)


@njit
def _reduce(B: FloatArray, i: int) -> None:
    """Eliminate row i, whose right neighbour is assembled."""
    a = (HEAD_ROWS + i * NODE_ROWS) * LANES
    left, right = a - NODE_ROWS * LANES, a + NODE_ROWS * LANES
    for lane in range(LANES):
        lower = B[left + LOWER * LANES + lane]
        pivot = 1.0 / (B[a + DIAGONAL * LANES + lane] - lower * B[left + UPPER * LANES + lane])
        residual = B[a + RESIDUAL * LANES + lane] + B[right + ACROSS * LANES + lane]
        B[a + UPPER * LANES + lane] = B[right + ENTRY * LANES + lane] * pivot
        B[a + DELTA * LANES + lane] = -(residual + lower * B[left + DELTA * LANES + lane]) * pivot


@njit
def _assemble_behind(B: FloatArray, n: int) -> None:
    """What crosses to the ghost behind the last node: content that padding shares with it, nothing where there is
    none."""
    last = (HEAD_ROWS + (n - 1) * NODE_ROWS) * LANES
    for lane in range(LANES):
        B[last + (NODE_ROWS + ACROSS) * LANES + lane] = -SHARE * B[last + E_RIGHT * LANES + lane]


@njit
def _eliminate(B: FloatArray, J: IntArray, table: FloatArray, ddt: float) -> None:
    """Residual E - E* - d dt F and its tridiagonal matrix, each row reduced while its neighbour is being assembled."""
    n = J[N_NODES]
    for i in range(n + 1):
        if i < n:
            _assemble(B, J, table, i, ddt)
        else:
            _assemble_behind(B, n)
        if i > 0:
            _reduce(B, i - 1)


@njit
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
        evaluate_surface(B, J, table, chain, stage)
        evaluate_back(B, J)
        _eliminate(B, J, table, STAGE_WEIGHT * dt)
        for lane in range(LANES):
            B[behind + MOVES * LANES + lane] = B[ACTIVE * LANES + lane]
            B[behind + LARGEST * LANES + lane] = 0.0
        _update(B, n)
        _keep_face_heat(B, J)
        if _retire(B) == 0:
            return
    for lane in range(LANES):
        B[FAILED * LANES + lane] += B[ACTIVE * LANES + lane]


@njit
def _start_second_stage(B: FloatArray, n: int) -> None:
    """E* = E_n + (w/d) (E(Y1) - E_n), and a first guess along the first stage."""
    for i in range(n):
        a = (HEAD_ROWS + i * NODE_ROWS) * LANES
        left, right = a - NODE_ROWS * LANES, a + NODE_ROWS * LANES
        for lane in range(LANES):
            own_left, own_right = B[a + STAGE_LEFT * LANES + lane], B[a + STAGE_RIGHT * LANES + lane]
            shared = B[right + STAGE_LEFT * LANES + lane] - own_right - own_left + B[left + STAGE_RIGHT * LANES + lane]
            start = B[a + E_START * LANES + lane]
            B[a + E_STAR * LANES + lane] = start + BDF_WEIGHT * (own_left + own_right + SHARE * shared - start)
            cold = B[a + T_START * LANES + lane]
            B[a + T * LANES + lane] = cold + (B[a + T * LANES + lane] - cold) * (1.0 / GAMMA)


@njit
def step(B: FloatArray, J: IntArray, table: FloatArray, chain, dt: float) -> None:  # type: ignore[no-untyped-def]
    """Advance the node temperatures of one lane group by dt [s] with the stage inputs that the scalar rows hold.

    B     : the block of the group; T, RATE, ENERGY_IN and ENERGY_OUT [J/m2], ITERATIONS and FAILED change
    J     : its integers
    table : property and ratio tables
    chain : the compiled effects (effects/chain.py)

    Heat contents and net heat at the start are those that the last step left (the method's last stage is its end):
    after a change of temperatures, parameters or conditions from outside, `begin` evaluates them anew.
    """
    n = J[N_NODES]
    _add_energy(B, EXPLICIT_WEIGHT * dt)
    _start(B, n, dt)
    for stage in range(1, 3):
        if stage == 2:
            _start_second_stage(B, n)
        _solve_stage(B, J, table, chain, stage, dt)
        _add_energy(B, (EXPLICIT_WEIGHT if stage == 1 else STAGE_WEIGHT) * dt)
    _finish(B, n, dt)


def begin(B: FloatArray, J: IntArray, table: FloatArray, chain, dt: float) -> None:  # type: ignore[no-untyped-def]
    """Take the condition vectors of stage 2 as those that hold now: at the start, and after any change from outside.

    dt is not used; it makes the signature that of a step.
    """
    forget_cells(B)
    heat_lanes(B, J, table, chain, 2)
    evaluate_start(B, J, table, chain)


def advance(B: FloatArray, J: IntArray, table: FloatArray, chain, dt: float) -> None:  # type: ignore[no-untyped-def]
    """One frame: from the conditions that held to those in the vectors of stage 0 (now) and 2 (then), linear between.

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
    for stage in range(1, 3):
        heat_lanes(B, J, table, chain, stage)
    step(B, J, table, chain, dt)


@njit
def hold(B: FloatArray) -> None:
    """The conditions at the end of the last frame become those at the start of the next."""
    span = LANES * N_CONDITIONS
    first = C_STAGES * LANES
    for k in range(span):
        B[first + k] = B[first + 2 * span + k]


@cache
def compiled() -> tuple[Any, Any]:
    """`begin` and `advance`, compiled when first asked for; jit.handle gives what a kernel takes of them."""
    return compiled_step(begin), compiled_step(advance)
