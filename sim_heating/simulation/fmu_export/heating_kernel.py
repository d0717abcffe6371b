"""The heating plug-in as a function of two arrays (library.py), made of the functions that the simulator runs.

Inputs are what a host gives in a frame (conditions.FRAME without the time), the added flux, and, where the reference
heating is the host's own, h_ref and H_r. A step goes from the conditions at its start to those at its end. Where the
conditions at the start are not those at the end of the step before, they have jumped: the thermal step starts from
them without extrapolating.
"""

from __future__ import annotations

import math

from numba import carray

from sim_heating.base.arrays import FloatArray, IntArray
from sim_heating.base.conditions import FRAME
from sim_heating.base.kernels.block import (
    ADDED,
    EMISSIVITY_TABLE,
    END,
    ENERGY_IN,
    ENERGY_OUT,
    FACTOR_EPS,
    FAILED,
    FILM,
    H_REF,
    HEAD_ROWS,
    ITERATIONS,
    LANES,
    N_CONDITIONS,
    N_EMITTING,
    N_PARAMETERS,
    NEGATIVE,
    OUTSIDE,
    Q_ADD,
    RECOVERY_ENTHALPY,
    STAGE_IN,
    SURROUNDINGS4,
    T,
)
from sim_heating.base.kernels.jit import inline_always, njit
from sim_heating.heating.film import emittance_factor
from sim_heating.heating.reference.models import COLUMNS
from sim_heating.heating.surface_pressure import PRESSURE_WIDTH
from sim_heating.inputs.sensor_model import indicated_kernel
from sim_heating.march.frames import (
    BLOCK_END,
    BLOCK_START,
    INTS_END,
    INTS_START,
    advance_groups,
    begin_groups,
)
from sim_heating.simulation.fmu_export.library import (
    BEGINS,
    CHANGED,
    GOOD,
    INPUTS,
    INPUTS_NEXT,
    INPUTS_NOW,
    N_INPUTS,
    NEXT,
    NOW,
    at,
)
from sim_heating.simulation.plugin_kernel import CODE, F_TIME, derive_conditions
from sim_heating.thermal.elements import EPS_BEHIND, Elements, set_point
from sim_heating.thermal.faces import SIGMA, emittance

# Integers of the model, after those of library.py: numbers of entries, and places of arrays in R or N.
(
    N_POINTS, N_ROWS, N_GROUPS, N_STATE, N_TABLE, N_INTS, N_SENSORS,
    GROUPS, LANE_POINTS, INTS, POINT_INTS, SENSOR_INTS,
    STATE, TABLE, VECTORS, PRESSURES, HOST, FRAMES, INPUTS_AT_STATE, RANGES, OPTIONS, POINT_NUMBERS, CALIBRATIONS,
) = range(8, 31)  # fmt: skip
N_MODEL = 32
LONGEST_STEP = 0
"""Place in the options: longest thermal step [s]."""
F_Q_ADD, F_H_REF, F_H_R = len(FRAME), len(FRAME) + 1, len(FRAME) + 2
FRAME_WIDTH = len(FRAME) + 3
HOST_WIDTH = 16
LONGEST_COMMUNICATION_S = 600.0
"""Longest communication step [s]; longer ones are refused, as of a clock in other units."""

# A point's integers: its group, first lane, number of lanes, number of elements, place of their layers in N, places of
# their lengths and densities in R, place of the bondline in the state, layer of insulation, node of the bondline.
(
    P_GROUP, P_LANE, P_LANES, P_ELEMENTS, P_LAYERS, P_LENGTHS, P_DENSITIES, P_BONDLINE, P_INSULATION, P_BOTTOM,
) = range(10)  # fmt: skip
POINT_INTS_WIDTH = 10
STACK_WIDTH = EPS_BEHIND + 1
# A point's numbers: parameters as in a lane of the kernel (base/kernels/block.py), those of its stack, limits, outputs.
P_STACK = N_PARAMETERS
P_SURFACE_LIMIT, P_BONDLINE_LIMIT = P_STACK + STACK_WIDTH, P_STACK + STACK_WIDTH + 1
P_OUT = P_STACK + STACK_WIDTH + 2
SURFACE, BONDLINE, RATIO, CONVECTED, RADIATED, ABSORBED, SURFACE_MARGIN, BONDLINE_MARGIN = range(8)
POINT_WIDTH = P_OUT + 8
# A sensor's integers: its place in the state, places of its numbers (gain, bias, indication) and its calibration.
S_PLACE, S_NUMBERS, S_CALIBRATION, S_COEFFICIENTS = range(4)
S_GAIN, S_BIAS, S_INDICATED = range(3)


@njit
def _first_out_of_range(values, ranges, n: int) -> int:  # type: ignore[no-untyped-def]
    """Number of the first input out of its range, GOOD where all are within."""
    for k in range(n):
        if not ranges[2 * k] <= values[k] <= ranges[2 * k + 1]:
            return k
    return GOOD


@inline_always
def _write_group_parameters(R, N, B: FloatArray, J: IntArray, g: int) -> None:  # type: ignore[no-untyped-def]
    """Write the parameters of all points of a group into its block."""
    for i in range(N[N_POINTS]):
        point = at(N, N[POINT_INTS] + POINT_INTS_WIDTH * i)
        if point[P_GROUP] != g:
            continue
        numbers = at(R, N[POINT_NUMBERS] + POINT_WIDTH * i)
        n = point[P_ELEMENTS]
        layers = carray(at(N, point[P_LAYERS]), n)
        lengths, densities = carray(at(R, point[P_LENGTHS]), n), carray(at(R, point[P_DENSITIES]), n)
        stack = carray(at(numbers, P_STACK), STACK_WIDTH)
        first, last = point[P_LANE], point[P_LANE] + point[P_LANES]
        heating = carray(numbers, N_PARAMETERS)
        elements = Elements(layers, lengths, densities, point[P_INSULATION], point[P_BOTTOM])
        set_point(B, J, first, last, elements, stack, heating)


@njit
def _derive_vectors(R, N, inputs, time: float) -> None:  # type: ignore[no-untyped-def]
    """Condition vectors of all lanes from inputs."""
    n = N[N_ROWS]
    frame = carray(at(R, N[FRAMES]), len(FRAME))
    frame[F_TIME] = time
    for k in range(len(FRAME) - 1):
        frame[1 + k] = inputs[k]
    vectors = carray(at(R, N[VECTORS]), (n, N_CONDITIONS))
    points = carray(at(R, N[PRESSURES]), (N[N_POINTS], PRESSURE_WIDTH + 1))
    host = carray(at(R, N[HOST]), HOST_WIDTH)
    derive_conditions(frame, host, points, carray(at(N, N[LANE_POINTS]), n), vectors)
    for i in range(n):
        vectors[i, Q_ADD] = inputs[F_Q_ADD - 1]
        if host[CODE] == COLUMNS:
            vectors[i, H_REF], vectors[i, RECOVERY_ENTHALPY] = inputs[F_H_REF - 1], inputs[F_H_R - 1]


@njit
def _begin(R, N, A, inputs, time: float) -> None:  # type: ignore[no-untyped-def]
    _derive_vectors(R, N, inputs, time)
    groups = carray(at(N, N[GROUPS]), (N[N_GROUPS], 4))
    state, ints = carray(at(R, N[STATE]), N[N_STATE]), carray(at(N, N[INTS]), N[N_INTS])
    vectors = carray(at(R, N[VECTORS]), (N[N_ROWS], N_CONDITIONS))
    table = carray(at(R, N[TABLE]), N[N_TABLE])
    begin_groups(state, ints, table, A[0], A[1], groups, vectors)


@inline_always
def _advance(R, N, A, inputs, time: float, dt: float) -> None:  # type: ignore[no-untyped-def]
    _derive_vectors(R, N, inputs, time)
    groups = carray(at(N, N[GROUPS]), (N[N_GROUPS], 4))
    state, ints = carray(at(R, N[STATE]), N[N_STATE]), carray(at(N, N[INTS]), N[N_INTS])
    vectors = carray(at(R, N[VECTORS]), (N[N_ROWS], N_CONDITIONS))
    steps = max(math.ceil(dt / R[N[OPTIONS] + LONGEST_STEP] - 1e-9), 1)
    table = carray(at(R, N[TABLE]), N[N_TABLE])
    advance_groups(state, ints, table, A[0], A[1], groups, vectors, dt, steps)


@njit
def _write_parameters(R, N) -> None:  # type: ignore[no-untyped-def]
    """Write the parameters into all groups."""
    groups = carray(at(N, N[GROUPS]), (N[N_GROUPS], 4))
    state, ints = carray(at(R, N[STATE]), N[N_STATE]), carray(at(N, N[INTS]), N[N_INTS])
    for g in range(N[N_GROUPS]):
        B = state[groups[g, BLOCK_START] : groups[g, BLOCK_END]]
        _write_group_parameters(R, N, B, ints[groups[g, INTS_START] : groups[g, INTS_END]], g)


@inline_always
def _clear_counts(R, N) -> None:  # type: ignore[no-untyped-def]
    """Set the counters of all groups to 0."""
    groups = carray(at(N, N[GROUPS]), (N[N_GROUPS], 4))
    for g in range(N[N_GROUPS]):
        B = at(R, N[STATE] + groups[g, BLOCK_START])
        for row in (FAILED, ITERATIONS, OUTSIDE, NEGATIVE, ENERGY_IN, ENERGY_OUT):
            for lane in range(LANES):
                B[row * LANES + lane] = 0.0


@njit
def _write_outputs(R, N, A) -> int:  # type: ignore[no-untyped-def]
    """Write the outputs; number of the first point whose step did not converge, GOOD where all did."""
    outcome = GOOD
    # From the last point to the first: the outcome that remains is the first point that failed.
    for i in range(N[N_POINTS] - 1, -1, -1):
        point = at(N, N[POINT_INTS] + POINT_INTS_WIDTH * i)
        numbers = at(R, N[POINT_NUMBERS] + POINT_WIDTH * i)
        out = at(numbers, P_OUT)
        first = N[GROUPS] + 4 * point[P_GROUP]
        block, ints = at(R, N[STATE] + N[first]), at(N, N[INTS] + N[first + INTS_START])
        B, J = at(block, point[P_LANE]), at(ints, point[P_LANE])
        wall = B[(HEAD_ROWS + T) * LANES]
        h_ref = R[N[VECTORS] + (point[P_GROUP] * LANES + point[P_LANE]) * N_CONDITIONS + H_REF]
        excess = wall * wall * wall * wall - B[SURROUNDINGS4 * LANES]
        eps = B[FACTOR_EPS * LANES] * emittance(at(R, N[TABLE]), J[EMISSIVITY_TABLE], wall)
        if J[N_EMITTING] > 0:
            eps *= emittance_factor(block, ints, A[0], point[P_LANE], END, wall)
        out[SURFACE], out[BONDLINE] = wall, R[N[STATE] + point[P_BONDLINE]]
        out[RATIO] = B[(FILM + 2) * LANES] / h_ref if h_ref > 0.0 else 0.0
        out[RADIATED] = eps * SIGMA * excess
        out[ABSORBED] = B[STAGE_IN * LANES]
        out[CONVECTED] = out[ABSORBED] + out[RADIATED] - B[(ADDED + 2) * LANES]
        out[SURFACE_MARGIN] = numbers[P_SURFACE_LIMIT] - out[SURFACE]
        out[BONDLINE_MARGIN] = numbers[P_BONDLINE_LIMIT] - out[BONDLINE]
        if B[FAILED * LANES] != 0.0 or not math.isfinite(wall):
            outcome = i
    for s in range(N[N_SENSORS]):
        sensor = at(N, N[SENSOR_INTS] + 4 * s)
        numbers = at(R, sensor[S_NUMBERS])
        coefficients = carray(at(R, sensor[S_CALIBRATION]), sensor[S_COEFFICIENTS])
        numbers[S_INDICATED] = indicated_kernel(
            R[N[STATE] + sensor[S_PLACE]], numbers[S_GAIN], numbers[S_BIAS], coefficients
        )
    return outcome


# Problems of the image, by number: an input out of range at the end of a step, at its start; a step too long; a point
# whose step did not converge.


@inline_always
def _start(R, N, A) -> int:  # type: ignore[no-untyped-def]
    """Set the initial temperatures of the stacks, in the conditions of the inputs."""
    n = N[N_INPUTS]
    for k in range(n):
        R[N[INPUTS_NEXT] + k] = R[N[INPUTS] + k]
    given = at(R, N[INPUTS_NEXT])
    outside = _first_out_of_range(given, at(R, N[RANGES]), n)
    if outside != GOOD:
        return outside
    _write_parameters(R, N)
    _clear_counts(R, N)
    _begin(R, N, A, given, R[NOW])
    for k in range(n):
        R[N[INPUTS_AT_STATE] + k] = given[k]
    outcome = _write_outputs(R, N, A)
    return GOOD if outcome == GOOD else 2 * n + 1 + outcome


@inline_always
def _step(R, N, A) -> int:  # type: ignore[no-untyped-def]
    """Advance all points to the end of a step."""
    n, dt = N[N_INPUTS], R[NEXT] - R[NOW]
    now, then, ranges = at(R, N[INPUTS_NOW]), at(R, N[INPUTS_NEXT]), at(R, N[RANGES])
    outside = _first_out_of_range(now, ranges, n)
    if outside != GOOD:
        return n + outside
    outside = _first_out_of_range(then, ranges, n)
    if outside != GOOD:
        return outside
    # `not <=`: a step that is NaN is refused as well.
    if not dt <= LONGEST_COMMUNICATION_S:
        return 2 * n
    jumped = N[CHANGED] != 0
    if jumped:
        _write_parameters(R, N)
    # Inputs that differ from those at the end of the last step are a jump: heat contents and net heat are evaluated
    # again.
    for k in range(n):
        jumped = jumped or R[N[INPUTS_AT_STATE] + k] != now[k]
    if jumped:
        _begin(R, N, A, now, R[NOW])
    _advance(R, N, A, then, R[NEXT], dt)
    for k in range(n):
        R[N[INPUTS_AT_STATE] + k] = then[k]
    outcome = _write_outputs(R, N, A)
    return GOOD if outcome == GOOD else 2 * n + 1 + outcome


def advance(R, N, A) -> int:  # type: ignore[no-untyped-def]
    """The model, as library.py describes it."""
    if N[BEGINS] == 1:
        return _start(R, N, A)
    return _step(R, N, A)
