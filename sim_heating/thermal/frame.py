"""The compiled frame: conditions that are linear in time, marched in as many steps as the error of a step demands.

A frame is one step of step.py wherever its error is tolerated. The error is that of the embedded formula of third order
(Hosea and Shampine, Appl. Numer. Math. 20 (1996) 21), here for the heat content and through Newton's matrix,

    A e = dt [(4 w - 1) / 3 F_n - 1/3 F(Y1) + 2 d / 3 F(Y2)],        A = dE/dT - d dt dF/dT,

and a step is tolerated where the largest |e| of the nodes is at most TOLERANCE. A lane whose error is larger begins its
step again with half the length: the frame is divided in two, either half again where it has to be, down to
1 / FINEST of the frame. The division of a lane depends on its own temperatures and conditions alone: all lanes are
stepped together, and each keeps the steps that are its own.

Derived in docs/theory/equations_thermal_step.md, equations 41 to 44.
"""

from __future__ import annotations

from functools import cache
from typing import Any

from sim_heating.base.arrays import FloatArray, IntArray
from sim_heating.base.kernels import block
from sim_heating.base.kernels.block import LANES, STAGE_ROWS
from sim_heating.base.kernels.jit import STEP_SIGNATURE, c_function, force_inline, inline_always, njit
from sim_heating.heating.film import heat_lanes
from sim_heating.heating.ratio.lookup import invalidate_cells
from sim_heating.thermal.assembly import REDUCED, assemble, heat_content
from sim_heating.thermal.faces import evaluate_faces, invalidate_walls
from sim_heating.thermal.step import (
    EXPLICIT_WEIGHT,
    GAMMA,
    STAGE_WEIGHT,
    close_node,
    close_step,
    evaluate_start,
    step,
    substitute_back,
)

EVALUATE_START = 0.0
"""Length [s] of a frame that only evaluates the start."""
STEP_TOLERANCE_K = 0.02
"""Largest error of one step at any node [K]. On an entry at steps of 1 s one step in a hundred exceeds it."""
NOT_CONTROLLED_K = 1e30
"""Tolerance [K] from which on no error is found: every frame is one step."""
FINEST = 1024
"""Parts into which a frame may be divided, a power of two. A step this short is accepted whatever its error."""


@force_inline
def _content_error(B: FloatArray, a: int, lane: int, dt: float) -> float:
    """Error of the heat content of a node after a step of dt [s] [J/m2], by the embedded formula.

    Written without F(Y1) and F(Y2), which a step does not store: docs/theory/equations_thermal_step.md, equation 42.
    """
    start, star = B[a + block.E_START * LANES + lane], B[a + block.E_STAR * LANES + lane]
    gain = heat_content(B, a + lane, block.STAGE_LEFT, block.STAGE_RIGHT) - star
    explicit = (4.0 / 3.0 * EXPLICIT_WEIGHT * dt) * B[a + block.NET * LANES + lane]
    return explicit - (star - start) * (1.0 / (3.0 * EXPLICIT_WEIGHT)) + gain * (2.0 / 3.0)


@inline_always
def _bound_errors(B: FloatArray, n: int, dt: float) -> None:
    """EXCESS of the last node: above 0 in a lane whose error may not be tolerated, whatever the neighbours conduct.

    |e| <= max |A e| / C for a matrix A whose rows sum to the heat capacity C or more. Here C is E / T, which a material
    has at least whose specific heat does not fall with temperature: the capacities of the last assembly depend on how
    often other lanes iterated. Derived in docs/theory/equations_thermal_step.md, equation 44.
    """
    tolerance = B[block.TOLERANCE * LANES]
    for lane in range(LANES):
        B[(block.SCALAR_ROWS + block.EXCESS) * LANES + lane] = 0.0
    for i in range(n):
        a = (block.HEAD_ROWS + i * block.NODE_ROWS) * LANES
        previous = a - block.NODE_ROWS * LANES
        for lane in range(LANES):
            content = B[a + block.STAGE_LEFT * LANES + lane] + B[a + block.STAGE_RIGHT * LANES + lane]
            error = abs(_content_error(B, a, lane, dt)) * B[a + block.T * LANES + lane]
            excess, largest = error - tolerance * content, B[previous + block.EXCESS * LANES + lane]
            B[a + block.EXCESS * LANES + lane] = excess if excess > largest else largest


@njit
def _filter_errors(B: FloatArray, J: IntArray, table: FloatArray, dispatcher, dt: float) -> None:
    """Error of the temperatures [K] of a step: LARGEST of node 0, from the matrix at the end of the step.

    With E* + A e for E* the residual at the end of the step is -A e, so that Newton's update is e itself; no lane takes
    it. Derived in docs/theory/equations_thermal_step.md, equation 43.
    """
    n = J[block.N_NODES]
    behind = (block.HEAD_ROWS + n * block.NODE_ROWS) * LANES
    for i in range(n):
        a = (block.HEAD_ROWS + i * block.NODE_ROWS) * LANES
        for lane in range(LANES):
            B[a + block.STAR_COPY * LANES + lane] = B[a + block.E_STAR * LANES + lane]
            B[a + block.E_STAR * LANES + lane] += _content_error(B, a, lane, dt)
    for lane in range(LANES):
        # Evaluating the faces writes the lag at the last temperature, not at that of the lane's own last iterate.
        B[block.BEFORE_LAG * LANES + lane] = B[(block.LAG_VALUE + block.END) * LANES + lane]
        B[(block.BEFORE_LAG + 1) * LANES + lane] = B[(block.LAG_INPUT + block.END) * LANES + lane]
    evaluate_faces(B, J, table, dispatcher, block.END, block.NO)
    assemble(B, J, table, STAGE_WEIGHT * dt, REDUCED)
    for lane in range(LANES):
        B[(block.LAG_VALUE + block.END) * LANES + lane] = B[block.BEFORE_LAG * LANES + lane]
        B[(block.LAG_INPUT + block.END) * LANES + lane] = B[(block.BEFORE_LAG + 1) * LANES + lane]
        B[block.ACTIVE * LANES + lane] = B[behind + block.MOVES * LANES + lane] = 0.0
        B[behind + block.LARGEST * LANES + lane] = 0.0
    substitute_back(B, n)
    for i in range(n):
        a = (block.HEAD_ROWS + i * block.NODE_ROWS) * LANES
        for lane in range(LANES):
            B[a + block.E_STAR * LANES + lane] = B[a + block.STAR_COPY * LANES + lane]


@inline_always
def _judge_lanes(B: FloatArray, J: IntArray, table: FloatArray, dispatcher, dt: float, last: bool) -> int:
    """Write which of the lanes that took part in a step tolerate its error (TOLERATED); number of those that do not.

    last : whether the step is the shortest and therefore tolerated, converged or not

    A lane that failed before in this march is not divided again: it has no result to improve.
    """
    doubtful, end = 0, (block.HEAD_ROWS + (J[block.N_NODES] - 1) * block.NODE_ROWS) * LANES
    if not last:
        _bound_errors(B, J[block.N_NODES], dt)
    for lane in range(LANES):
        B[block.TOLERATED * LANES + lane] = B[block.STEPPING * LANES + lane]
        judged = B[block.STEPPING * LANES + lane] > 0.0 and not last and B[block.BEFORE_FAILED * LANES + lane] == 0.0
        # `not <=`, so that a NaN counts as an error.
        if judged and (not B[end + block.EXCESS * LANES + lane] <= 0.0 or B[block.FAILED * LANES + lane] > 0.0):
            B[block.TOLERATED * LANES + lane] = 0.0
            doubtful += 1
    if doubtful > 0:
        _filter_errors(B, J, table, dispatcher, dt)
        for lane in range(LANES):
            rejected = (
                B[block.STEPPING * LANES + lane] > B[block.TOLERATED * LANES + lane]
                and B[block.FAILED * LANES + lane] == 0.0
            )
            if rejected and B[(block.HEAD_ROWS + block.LARGEST) * LANES + lane] <= B[block.TOLERANCE * LANES + lane]:
                B[block.TOLERATED * LANES + lane] = 1.0
                doubtful -= 1
    return doubtful


@inline_always
def _settle_lanes(B: FloatArray, n: int, dt: float, end: float) -> None:
    """Close a step of dt [s] in the lanes that tolerate it, return all others to where they were.

    end : part of the frame at which the step ends, of FINEST
    """
    for lane in range(LANES):
        if B[block.TOLERATED * LANES + lane] > 0.0:
            B[block.LAST_STEP * LANES + lane] = dt
            B[block.DONE * LANES + lane] = end
            B[block.STEPS * LANES + lane] += 1.0
            # The end of a step is the start of the next; a lane that does not tolerate it keeps its own start.
            for row in STAGE_ROWS:
                B[row * LANES + lane] = B[(row + 2) * LANES + lane]
        else:
            for k in range(4):
                B[(block.STAGE_IN + k) * LANES + lane] = B[(block.BEFORE_FACES + k) * LANES + lane]
            B[block.FAILED * LANES + lane] = B[block.BEFORE_FAILED * LANES + lane]
    for i in range(n):
        a = (block.HEAD_ROWS + i * block.NODE_ROWS) * LANES
        for lane in range(LANES):
            if B[block.TOLERATED * LANES + lane] > 0.0:
                close_node(B, a, lane, dt)
            else:
                B[a + block.T * LANES + lane] = B[a + block.T_START * LANES + lane]


@njit
def _solve_interval(B: FloatArray, J: IntArray, table: FloatArray, dispatcher, dt: float) -> None:
    """One step of dt [s] between the conditions of stages 0 and 2, not closed: heating at its stages, temperatures."""
    span = LANES * block.N_CONDITIONS
    first = block.C_STAGES * LANES
    for k in range(span):
        now, then = B[first + k], B[first + 2 * span + k]
        B[first + span + k] = now + GAMMA * (then - now)
    for stage in range(1, 3):
        heat_lanes(B, J, table, dispatcher, stage)
    step(B, J, table, dispatcher, dt)


@inline_always
def _select_interval(B: FloatArray, begin: int, end: int) -> None:
    """Let the lanes that stand at the beginning of a part of the frame take part, with the conditions at its ends.

    begin, end : of FINEST. Derived in docs/theory/equations_march.md, equation 1.
    """
    span = LANES * block.N_CONDITIONS
    stages = block.C_STAGES * LANES
    now, then = stages + block.FRAME_START * span, stages + block.FRAME_END * span
    before, after = begin * (1.0 / FINEST), end * (1.0 / FINEST)
    for lane in range(LANES):
        B[block.STEPPING * LANES + lane] = 0.0
        if B[block.DONE * LANES + lane] == begin:
            B[block.STEPPING * LANES + lane] = 1.0
            for c in range(lane * block.N_CONDITIONS, (lane + 1) * block.N_CONDITIONS):
                change = B[then + c] - B[now + c]
                B[stages + c] = B[now + c] + before * change
                # The last part takes the end itself, without rounding.
                B[stages + 2 * span + c] = B[then + c] if end == FINEST else B[now + c] + after * change


@njit
def _divide_frame(B: FloatArray, J: IntArray, table: FloatArray, dispatcher, dt: float) -> None:
    """March a frame of dt [s] whose single step is solved and judged, and not tolerated by all lanes, in shorter ones.

    Parts of the frame are visited as the nodes of a binary tree, in order of time: the first half of a part that a lane
    does not tolerate, then its second half. A lane takes part in those that begin where it stands.
    """
    span = LANES * block.N_CONDITIONS
    stages = block.C_STAGES * LANES
    for k in range(span):
        B[stages + block.FRAME_START * span + k] = B[stages + k]
        B[stages + block.FRAME_END * span + k] = B[stages + 2 * span + k]
    for lane in range(LANES):
        # The single step has counted the end of the frame; ends of its parts are not counted.
        B[block.COUNTED * LANES + lane] = B[block.OUTSIDE * LANES + lane]
        B[block.DONE * LANES + lane] = 0.0
    _settle_lanes(B, J[block.N_NODES], dt, float(FINEST))
    begin, length = 0, FINEST // 2
    while begin < FINEST:
        _select_interval(B, begin, begin + length)
        part_s = dt * (length * (1.0 / FINEST))
        _solve_interval(B, J, table, dispatcher, part_s)
        again = _judge_lanes(B, J, table, dispatcher, part_s, length == 1)
        _settle_lanes(B, J[block.N_NODES], part_s, float(begin + length))
        if again > 0:
            length = length // 2
        else:
            # The next part is the sibling of the longest one that ends here: its length is the last bit of its begin.
            begin += length
            length = begin & -begin
    for k in range(span):
        B[stages + 2 * span + k] = B[stages + block.FRAME_END * span + k]
    for lane in range(LANES):
        for row in STAGE_ROWS:
            B[(row + 2) * LANES + lane] = B[row * LANES + lane]
        B[block.OUTSIDE * LANES + lane] = B[block.COUNTED * LANES + lane]


@inline_always
def _count_negative_films(B: FloatArray) -> None:
    """Count the lanes whose film coefficient at the end of the frame is below 0, as their heating ratio is."""
    for lane in range(LANES):
        B[block.NEGATIVE * LANES + lane] += 1.0 if B[(block.FILM + block.END) * LANES + lane] < 0.0 else 0.0


@inline_always
def _evaluate_now(B: FloatArray, J: IntArray, table: FloatArray, dispatcher) -> None:
    """Take the condition vectors of stage 2 as those of the present time, and evaluate heat contents and flows."""
    invalidate_cells(B)
    invalidate_walls(B)
    for lane in range(LANES):
        B[block.LAG_PAST * LANES + lane] = 0.0
    heat_lanes(B, J, table, dispatcher, block.END)
    evaluate_start(B, J, table, dispatcher)
    _count_negative_films(B)


@inline_always
def _advance_frame(B: FloatArray, J: IntArray, table: FloatArray, dispatcher, dt: float) -> None:
    """Advance by dt [s] from the conditions of stage 0 (now) to those of stage 2 (then), linear between.

    Before it the caller shifts the vectors of stage 2 to stage 0 (`shift_conditions`) and writes new ones.
    """
    # The end of the last frame is the start of this one: nothing is evaluated twice.
    for row in STAGE_ROWS:
        for lane in range(LANES):
            B[row * LANES + lane] = B[(row + 2) * LANES + lane]
    for lane in range(LANES):
        B[block.LAG_PAST * LANES + lane] = 1.0
        B[block.STEPPING * LANES + lane] = 1.0
    _solve_interval(B, J, table, dispatcher, dt)
    if B[block.TOLERANCE * LANES] >= NOT_CONTROLLED_K or _judge_lanes(B, J, table, dispatcher, dt, False) == 0:
        close_step(B, J[block.N_NODES], dt)
    else:
        _divide_frame(B, J, table, dispatcher, dt)
    _count_negative_films(B)


def advance(B: FloatArray, J: IntArray, table: FloatArray, dispatcher, dt: float) -> None:
    """Advance a lane group by a frame of dt [s], or, with dt = EVALUATE_START, evaluate the start of a march.

    B     : block of the group, with the conditions of stages 0 and 2 written
    J     : its integers;  table : property and ratio tables;  dispatcher : address of the effect dispatcher
    dt    : [s]; EVALUATE_START at the start and after any change from outside, else above 0

    The frame is divided in the lanes whose error is above TOLERANCE. T_START and T_STAGE are those of the last step of
    some lane then: they define the parabola of the frame only where it is not controlled.
    One function for both, as they share most of their code, which is compiled once this way.
    Source: docs/theory/equations_thermal_step.md, equations 19 to 24, and 41 to 44 for the control of the step.
    """
    if dt == EVALUATE_START:
        _evaluate_now(B, J, table, dispatcher)
    else:
        _advance_frame(B, J, table, dispatcher, dt)


@njit
def shift_conditions(B: FloatArray) -> None:
    """Shift the conditions ([deg], [Pa], [J/kg] ...) at the end of the last frame to the start of the next: stage 2
    becomes stage 0.

    Source: docs/theory/equations_march.md, equation 3.
    """
    span = LANES * block.N_CONDITIONS
    first = block.C_STAGES * LANES
    for k in range(span):
        B[first + k] = B[first + 2 * span + k]


@cache
def compiled() -> Any:
    """`advance` as a C function, compiled when first asked for; jit.address_of gives what kernels take of it."""
    return c_function(STEP_SIGNATURE, advance)
