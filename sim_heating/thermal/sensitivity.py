"""The time step differentiated: sensitivity of every node temperature to any parameter, from the step's own matrix.

With G(T; p) = E(T; p) - d dt F(T; p) the two stages of a step (step.py) are G(Y1) = E_n + d dt F_n and
G(Y2) = E_n + (w/d) (E(Y1) - E_n), so that for S = dT/dp, e = dE/dp and f = dF/dp, all total
(docs/theory/equations_thermal_step.md, equations 31 and 32),

    A1 S1 = e_n + d dt f_n             - G_p(Y1),      A = dG/dT at the converged stage,
    A2 S2 = e_n + (w/d) (e(Y1) - e_n)  - G_p(Y2),      e = E_T S + E_p,
    f_(n+1) = (e(Y2) - e_n - (w/d) (e(Y1) - e_n)) / (d dt)

which is exact for the discrete model (implicit function theorem). A is assembled once at the temperatures of the stage;
every parameter costs one more right-hand side. G_p and E_p come from the model itself, evaluated in perturbed lanes:
one lane for each parameter with that parameter perturbed, or two, to either side, where G is not affine in it, all at
the temperatures of the nominal lane (equation 34). No equation so has a second, differentiated form; for affine
parameters the difference is exact to rounding. A parameter that acts at the faces only has G_p = -d dt dF/dp there and
E_p = 0, and its perturbed lane needs no rows.

Arrays of a lane: (node, parameter), parameters contiguous. They are passed as pointers: a view of an array costs more
than a column of one node.
"""

from __future__ import annotations

from functools import cache
from typing import Any, NamedTuple

import numpy as np

from sim_heating.base.arrays import FloatArray, IntArray
from sim_heating.base.kernels import block
from sim_heating.base.kernels.block import LANES
from sim_heating.base.kernels.jit import STEP_SIGNATURE, address_of, c_function, force_inline, njit
from sim_heating.base.kernels.operations import call_step, pointer
from sim_heating.heating.film import heat_perturbed_lanes
from sim_heating.heating.ratio.lookup import linear_ratio_derivative
from sim_heating.thermal.assembly import SHARE, WHOLE_ROWS, assemble, heat_content, select_pressure
from sim_heating.thermal.faces import evaluate_faces, evaluate_perturbed_faces
from sim_heating.thermal.step import BDF_WEIGHT, GAMMA, STAGE_WEIGHT, LaneGroup

NODE = block.NODE_ROWS * LANES
"""Numbers in the block from a node to the next."""
ACTS_NOWHERE, ACTS_AT_FACES, ACTS_ALONG_GAP, ACTS_IN_ROWS = range(4)
"""Where a parameter acts: not in the march; at the two faces; at the nodes along a gap as well; in whole rows."""
VECTOR = 4
"""Columns that are computed together; a march has whole vectors of them."""
OWN_PERTURBATION = -1
"""Marks a parameter whose perturbed lane has that parameter itself perturbed."""


class PerturbedGroups(NamedTuple):
    """Groups of perturbed lanes, and the functions that assemble them.

    ints        : their integers;  groups : offsets of their blocks and integers, as in march/frames.py
    assembled   : number of groups, the first ones, whose rows are assembled; of the others only the heat at the faces
    source      : (group * LANES,) nominal lane of each perturbed lane
    rows, faces : addresses of the compiled `rows_at` and `faces_at`, or the functions where interpreted
    """

    ints: IntArray
    groups: IntArray
    assembled: int
    source: IntArray
    rows: Any
    faces: Any


def no_perturbed_groups() -> PerturbedGroups:
    """Groups of a march without sensitivities."""
    nothing = np.zeros(0, dtype=np.int64)
    return PerturbedGroups(nothing, np.zeros((0, 4), dtype=np.int64), 0, nothing, *assembly_addresses())


class PerturbedOffsets(NamedTuple):
    """Offsets of the perturbed lanes of each nominal lane in their blocks.

    at      : (lane,) first number of node 0 of the unperturbed copy;  nodes : (lane,) node count
    plus, minus : (lane, parameter) that of the lanes with the parameter perturbed up and down, or of the copy again
    inverse : (lane, parameter) reciprocal of the difference, in 1 over the parameter's unit
    reach   : (lane, parameter) where the parameter acts: ACTS_NOWHERE, ACTS_AT_FACES ...
    linear  : (lane, parameter) index of a parameter of the linear heating ratio, whose perturbed lane has the ratio
              itself perturbed (heating/ratio/lookup.py, linear_ratio_derivative), or OWN_PERTURBATION
    """

    at: IntArray
    plus: IntArray
    minus: IntArray
    inverse: FloatArray
    reach: IntArray
    linear: IntArray
    nodes: IntArray


def rows_at(B: FloatArray, J: IntArray, table: FloatArray, dispatcher, ddt: float) -> None:
    """Rows of G = E - ddt F [J/m2] at the present temperatures of perturbed lanes, with the conditions of stage 2.

    B     : block of the perturbed lanes;  J : its integers;  table, dispatcher : as in step.step
    ddt   : d dt [s]; it takes the place of dt in the signature of a step

    Source: docs/theory/equations_thermal_step.md, equations 25 to 28 and 34.
    """
    heat_perturbed_lanes(B, J, table, dispatcher, block.END)
    select_pressure(B, J, block.END)
    evaluate_faces(B, J, table, dispatcher, block.END, block.NO)
    assemble(B, J, table, ddt, WHOLE_ROWS)


def faces_at(B: FloatArray, J: IntArray, table: FloatArray, dispatcher, ddt: float) -> None:
    """Heat from outside [W/m2] at the present temperatures of perturbed lanes, with the conditions of stage 2.

    ddt is not used: the signature is that of `rows_at`. Source: docs/theory/equations_thermal_step.md, equations 14 to
    16.
    """
    heat_perturbed_lanes(B, J, table, dispatcher, block.END)
    evaluate_perturbed_faces(B, J, table, dispatcher, block.END)


@cache
def _compiled_assembly() -> tuple[Any, Any]:
    """`rows_at` and `faces_at` as C functions, compiled when first asked for and kept, so that they stay alive."""
    return c_function(STEP_SIGNATURE, rows_at), c_function(STEP_SIGNATURE, faces_at)


def assembly_addresses() -> tuple[Any, Any]:
    """`rows_at` and `faces_at` as kernels take them: addresses, or the functions where nothing is compiled."""
    rows, faces = _compiled_assembly()
    return address_of(rows), address_of(faces)


@njit
def _copy_temperatures(B: FloatArray, X: FloatArray, start: int, source: IntArray, g: int, i: int, row: int) -> None:
    """Set node i of a group of perturbed lanes to the temperatures of the nominal lanes."""
    for s in range(LANES):
        at = (block.HEAD_ROWS + i * block.NODE_ROWS) * LANES
        X[start + at + block.T * LANES + s] = B[at + row * LANES + source[g * LANES + s]]


@njit
def assemble_perturbed(
    group: LaneGroup, X: FloatArray, perturbed: PerturbedGroups, row: int, stage: int, ddt: float
) -> None:
    """Set perturbed lanes to temperatures and conditions of their nominal lanes at a stage, and assemble their rows.

    group     : the nominal lanes, with tables that serve the perturbed lanes as well
    X         : blocks of the perturbed lanes, changed;  perturbed : their groups
    row       : row of the nominal block that holds the temperatures of the stage [K]
    stage     : stage whose conditions they take
    ddt       : d dt [s] of the rows

    Source: docs/theory/equations_thermal_step.md, equation 34.
    """
    B = group.B
    J, groups, source = perturbed.ints, perturbed.groups, perturbed.source
    for g in range(len(groups)):
        start, ints = groups[g, 0], groups[g, 2]
        # Where only the faces are evaluated, two nodes are enough, unless gaps take heat in at others.
        if g < perturbed.assembled or J[ints + block.GAPS] == 1:
            for i in range(J[ints + block.N_NODES]):
                _copy_temperatures(B, X, start, source, g, i, row)
        else:
            _copy_temperatures(B, X, start, source, g, 0, row)
            for s in range(LANES):
                _copy_temperatures(B, X, start, source, g, J[ints + block.BACK_NODE + s], row)
        for s in range(LANES):
            lane = source[g * LANES + s]
            # Once a step: the end of the last step is the past of lag and hysteresis at both stages of this one.
            if stage == 1:
                X[start + block.LAG_PAST * LANES + s] = 1.0
                for memory in (block.LAG_VALUE, block.LAG_INPUT, block.PAST_ONSET):
                    X[start + memory * LANES + s] = X[start + (memory + 2) * LANES + s]
            time_at = block.C_STAGES * LANES + lane * block.N_CONDITIONS + block.TIME
            X[start + block.C_STAGES * LANES + s * block.N_CONDITIONS + block.TIME] = B[time_at]
            to_condition = start + block.C_STAGES * LANES + (2 * LANES + s) * block.N_CONDITIONS
            from_condition = block.C_STAGES * LANES + (stage * LANES + lane) * block.N_CONDITIONS
            for c in range(block.N_CONDITIONS):
                X[to_condition + c] = B[from_condition + c]
            for pressure in (block.PCOL, block.PFRAC, block.AIR_PLACE):
                X[start + (pressure + block.END) * LANES + s] = B[(pressure + stage) * LANES + lane]
        x, j = pointer(X[start : groups[g, 1]]), pointer(J[ints : groups[g, 3]])
        assembly = perturbed.rows if g < perturbed.assembled else perturbed.faces
        call_step(assembly, x, j, pointer(group.table), group.dispatcher, ddt)


@njit
def start_from_copy(B: FloatArray, lane: int, X: FloatArray, at: int, n: int) -> None:
    """Heat content [J/m2] and net heat [W/m2] of a lane from its unperturbed copy at X[at].

    n : number of nodes; the copy is assembled with ddt = 1 s at the lane's present temperatures

    This is what `step.evaluate_start` does for all lanes, for one of them. Source:
    docs/theory/equations_thermal_step.md, equations 4 and 25 with kappa = 1 s.
    """
    for i in range(n):
        content = heat_content(X, at + i * NODE, block.E_LEFT, block.E_RIGHT)
        a = (block.HEAD_ROWS + i * block.NODE_ROWS) * LANES + lane
        B[a + block.E_START * LANES] = content
        B[a + block.NET * LANES] = content - X[at + i * NODE + block.RESIDUAL * LANES]


@njit
def _subtract_forcing(x, p: PerturbedOffsets, lane: int, forced: int, ddt: float, S, at: int, width: int) -> None:
    """S - G_p in the first `forced` columns, with the perturbed lanes assembled for ddt [s] (equation 34)."""
    n = p.nodes[lane]
    for k in range(forced):
        plus, minus, inverse, reach = p.plus[lane, k], p.minus[lane, k], p.inverse[lane, k], p.reach[lane, k]
        if reach == ACTS_IN_ROWS:
            for i in range(n):
                row = i * NODE + block.RESIDUAL * LANES
                S[at + i * width + k] -= (x[plus + row] - x[minus + row]) * inverse
        elif reach != ACTS_NOWHERE:
            if p.linear[lane, k] != OWN_PERTURBATION:
                inverse *= against_ratio(x, p.at[lane], p.linear[lane, k])
            # ACTS_AT_FACES: the first and the last node; ACTS_ALONG_GAP: every node.
            for i in range(0, n, n - 1 if reach == ACTS_AT_FACES else 1):
                row = i * NODE + block.SOURCE * LANES
                S[at + i * width + k] += ddt * ((x[plus + row] - x[minus + row]) * inverse)


@njit
def against_ratio(X: FloatArray, at: int, k: int) -> float:
    """Derivative of the linear heating ratio [-] against its parameter k, for the lane whose node 0 begins at X[at].

    Source: docs/theory/equations_march.md, equation 12.
    """
    first = at - block.HEAD_ROWS * LANES
    lane = first % LANES
    base = first - lane
    p = base + block.PARAMETERS * LANES + lane * block.N_PARAMETERS
    c = base + block.C_STAGES * LANES + (block.END * LANES + lane) * block.N_CONDITIONS
    return linear_ratio_derivative(X, p, c, X[first + block.CELL_WORK * LANES], k)


@force_inline
def _weighted_sum(to, at: int, a: float, x, i: int, b: float, y, j: int, c: float, z, k: int, width: int) -> None:
    """to = a x + b y + c z for rows of `width` numbers that begin at `at`, i, j and k; rows may be the same.

    Four numbers a time, all read before any is written: LLVM packs them into vectors, and asks at no row whether rows
    overlap.
    """
    for q in range(0, width - 3, VECTOR):
        x0, x1, x2, x3 = x[i + q], x[i + q + 1], x[i + q + 2], x[i + q + 3]
        y0, y1, y2, y3 = y[j + q], y[j + q + 1], y[j + q + 2], y[j + q + 3]
        z0, z1, z2, z3 = z[k + q], z[k + q + 1], z[k + q + 2], z[k + q + 3]
        r0, r1, r2, r3 = (
            a * x0 + b * y0 + c * z0,
            a * x1 + b * y1 + c * z1,
            a * x2 + b * y2 + c * z2,
            a * x3 + b * y3 + c * z3,
        )
        to[at + q], to[at + q + 1], to[at + q + 2], to[at + q + 3] = r0, r1, r2, r3
    for q in range(width - width % VECTOR, width):
        to[at + q] = a * x[i + q] + b * y[j + q] + c * z[k + q]


@force_inline
def _difference(to, at: int, a: float, x, i: int, b: float, y, j: int, width: int) -> None:
    """to = a x - b y for rows of `width` numbers, as `_weighted_sum`."""
    for q in range(0, width - 3, VECTOR):
        x0, x1, x2, x3 = x[i + q], x[i + q + 1], x[i + q + 2], x[i + q + 3]
        y0, y1, y2, y3 = y[j + q], y[j + q + 1], y[j + q + 2], y[j + q + 3]
        r0, r1, r2, r3 = a * x0 - b * y0, a * x1 - b * y1, a * x2 - b * y2, a * x3 - b * y3
        to[at + q], to[at + q + 1], to[at + q + 2], to[at + q + 3] = r0, r1, r2, r3
    for q in range(width - width % VECTOR, width):
        to[at + q] = a * x[i + q] - b * y[j + q]


@njit
def content_columns(x, p: PerturbedOffsets, lane: int, forced: int, S, e, at: int, width: int) -> None:
    """Total derivatives of the heat contents of a lane, e = E_T S + E_p.

    x         : pointer to the blocks of the perturbed lanes, assembled at the lane's temperatures;  p : their offsets
    forced    : number of leading columns with a partial derivative E_p; the others are initial temperatures
    S         : pointer to sensitivities of temperature [K] over the unit of each parameter
    e         : pointer to the result [J/m2] over that unit, overwritten
    at, width : the lane's (node, parameter) begin there, with so many numbers from a node to the next

    Source: docs/theory/equations_thermal_step.md, equation 32.
    """
    n = p.nodes[lane]
    for i in range(n):
        a, here = p.at[lane] + i * NODE, at + i * width
        inner = (1.0 - SHARE) * (x[a + block.C_LEFT * LANES] + x[a + block.C_RIGHT * LANES])
        from_left, from_right = SHARE * x[a - NODE + block.C_RIGHT * LANES], SHARE * x[a + NODE + block.C_LEFT * LANES]
        above, below = here - width if i > 0 else here, here + width if i < n - 1 else here
        _weighted_sum(e, here, inner, S, here, from_left, S, above, from_right, S, below, width)
    for k in range(forced):
        if p.reach[lane, k] == ACTS_IN_ROWS:
            plus, minus, inverse = p.plus[lane, k], p.minus[lane, k], p.inverse[lane, k]
            for i in range(n):
                raised = heat_content(x, plus + i * NODE, block.E_LEFT, block.E_RIGHT)
                lowered = heat_content(x, minus + i * NODE, block.E_LEFT, block.E_RIGHT)
                e[at + i * width + k] += (raised - lowered) * inverse


@njit
def begin_columns(x, p: PerturbedOffsets, lane: int, forced: int, S, e, f, at: int, width: int) -> None:
    """e [J/m2] and f [W/m2], over the unit of each parameter, from S [K]: after a start, or a change of S from outside.

        e = E_T S + E_p,    f = e - A S - G_p    with d dt = 1 s

    x         : pointer to the blocks of the perturbed lanes, assembled with ddt = 1 s;  p : their offsets
    forced    : number of leading columns with partial derivatives
    S, e, f   : pointers to (node, parameter) of the lane; e and f are overwritten
    at, width : as for `content_columns`

    Source: docs/theory/equations_thermal_step.md, equations 32 and 33.
    """
    n = p.nodes[lane]
    content_columns(x, p, lane, forced, S, e, at, width)
    for i in range(n):
        a, here = p.at[lane] + i * NODE, at + i * width
        diagonal = x[a + block.DIAGONAL * LANES]
        lower = x[a - NODE + block.LOWER * LANES] if i > 0 else 0.0
        entry = x[a + block.ENTRY * LANES] if i < n - 1 else 0.0
        above, below = here - width if i > 0 else here, here + width if i < n - 1 else here
        for k in range(width):
            f[here + k] = e[here + k] - diagonal * S[here + k] - lower * S[above + k] - entry * S[below + k]
    _subtract_forcing(x, p, lane, forced, 1.0, f, at, width)


@njit
def solve_columns(
    x, p: PerturbedOffsets, lane: int, forced: int, ddt: float, star, S, at: int, width: int, reduced
) -> None:
    """Solve A S = star - G_p for the sensitivities of a stage, with one elimination of the matrix for all parameters.

    x         : pointer to the blocks of the perturbed lanes, assembled with ddt [s], which hold A and G_p
    p         : their offsets
    forced    : number of leading columns with a partial derivative G_p
    star      : pointer to the right-hand sides [J/m2] over the unit of each parameter
    S         : pointer to the sensitivities [K] over that unit, overwritten
    at, width : as for `content_columns`, in both
    reduced   : pointer to (node,) work

    Source: docs/theory/equations_thermal_step.md, equations 29 and 31.
    """
    n = p.nodes[lane]
    copy_columns(star, S, at, n * width)
    _subtract_forcing(x, p, lane, forced, ddt, S, at, width)
    before = 0.0
    for i in range(n):
        a, here = p.at[lane] + i * NODE, at + i * width
        lower = x[a - NODE + block.LOWER * LANES] if i > 0 else 0.0
        pivot = 1.0 / (x[a + block.DIAGONAL * LANES] - lower * before)
        before = x[a + block.ENTRY * LANES] * pivot
        reduced[i] = before
        _difference(S, here, pivot, S, here, lower * pivot, S, here - width if i > 0 else here, width)
    for i in range(n - 2, -1, -1):
        here = at + i * width
        _difference(S, here, 1.0, S, here, reduced[i], S, here + width, width)


@njit
def copy_columns(source, target, at: int, count: int) -> None:
    """Copy `count` numbers that begin at `at`, from one pointer to another."""
    for k in range(at, at + count - 3, VECTOR):
        a, b, c, d = source[k], source[k + 1], source[k + 2], source[k + 3]
        target[k], target[k + 1], target[k + 2], target[k + 3] = a, b, c, d
    for k in range(at + count - count % VECTOR, at + count):
        target[k] = source[k]


@njit
def first_right_hand_side(e, f, dt: float, star, at: int, count: int) -> None:
    """Right-hand side of the first stage, e_n + d dt f_n [J/m2] over the unit of each parameter.

    e, f, star : pointers to columns [J/m2], [W/m2], [J/m2], each over that unit; star is overwritten
    dt         : [s];  at, count : first of the numbers concerned, and how many they are

    Source: docs/theory/equations_thermal_step.md, equation 31.
    """
    ddt = STAGE_WEIGHT * dt
    for k in range(at, at + count - 3, VECTOR):
        r0, r1, r2, r3 = (
            e[k] + ddt * f[k],
            e[k + 1] + ddt * f[k + 1],
            e[k + 2] + ddt * f[k + 2],
            e[k + 3] + ddt * f[k + 3],
        )
        star[k], star[k + 1], star[k + 2], star[k + 3] = r0, r1, r2, r3
    for k in range(at + count - count % VECTOR, at + count):
        star[k] = e[k] + ddt * f[k]


@njit
def second_right_hand_side(e, middle, star, at: int, count: int) -> None:
    """Right-hand side of the second stage, e_n + (w/d) (e(Y1) - e_n) [J/m2] over the unit of each parameter.

    e, middle, star : pointers to columns: e at the start and at the first stage, and the result, overwritten
    at, count       : first of the numbers concerned, and how many they are

    Source: docs/theory/equations_thermal_step.md, equation 31.
    """
    for k in range(at, at + count - 3, VECTOR):
        e0, e1, e2, e3 = e[k], e[k + 1], e[k + 2], e[k + 3]
        m0, m1, m2, m3 = middle[k], middle[k + 1], middle[k + 2], middle[k + 3]
        r0, r1 = e0 + BDF_WEIGHT * (m0 - e0), e1 + BDF_WEIGHT * (m1 - e1)
        r2, r3 = e2 + BDF_WEIGHT * (m2 - e2), e3 + BDF_WEIGHT * (m3 - e3)
        star[k], star[k + 1], star[k + 2], star[k + 3] = r0, r1, r2, r3
    for k in range(at + count - count % VECTOR, at + count):
        star[k] = e[k] + BDF_WEIGHT * (middle[k] - e[k])


@njit
def net_columns(e, star, dt: float, f, at: int, count: int) -> None:
    """Sensitivity of the net heat at the end of a step, f = (e - star) / (d dt) [W/m2] over the unit of each parameter.

    e, star, f : pointers to columns: e at the end, right-hand side of the second stage, result;  dt : [s]
    at, count  : first of the numbers concerned, and how many they are

    Source: docs/theory/equations_thermal_step.md, equation 32.
    """
    inverse = 1.0 / (STAGE_WEIGHT * dt)
    for k in range(at, at + count - 3, VECTOR):
        r0, r1, r2, r3 = e[k] - star[k], e[k + 1] - star[k + 1], e[k + 2] - star[k + 2], e[k + 3] - star[k + 3]
        f[k], f[k + 1], f[k + 2], f[k + 3] = r0 * inverse, r1 * inverse, r2 * inverse, r3 * inverse
    for k in range(at + count - count % VECTOR, at + count):
        f[k] = (e[k] - star[k]) * inverse


@njit
def parabola(x: float) -> tuple[float, float, float]:
    """Weights [-] of start, middle stage and end of a step in a value at the fraction x [-] of the step.

    Source: docs/theory/equations_thermal_step.md, equation 35.
    """
    return (x - GAMMA) * (x - 1.0) / GAMMA, x * (x - 1.0) / (GAMMA * (GAMMA - 1.0)), x * (x - GAMMA) / (1.0 - GAMMA)


@njit
def parabola_rate(x: float, dt: float) -> tuple[float, float, float]:
    """Weights of start, middle stage and end of a step of dt [s] in the rate of change [K/s] at its fraction x [-].

    Source: docs/theory/equations_thermal_step.md, equation 36.
    """
    start, middle = (2.0 * x - GAMMA - 1.0) / (GAMMA * dt), (2.0 * x - 1.0) / (GAMMA * (GAMMA - 1.0) * dt)
    return start, middle, (2.0 * x - GAMMA) / ((1.0 - GAMMA) * dt)
