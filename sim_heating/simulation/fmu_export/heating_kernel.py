"""The heating plug-in as a function of its arrays (library.py), made of the functions that the simulator runs.

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
from sim_heating.base.kernels import block
from sim_heating.base.kernels.block import LANES
from sim_heating.base.kernels.jit import inline_always, njit
from sim_heating.base.kernels.lag import lag_step
from sim_heating.heating.edge_flow import LAMINAR_AT, LARGEST
from sim_heating.heating.film import emittance_factor
from sim_heating.heating.ratio.lookup import invalidate_cells, largest_ratio
from sim_heating.heating.reference.models import COLUMNS
from sim_heating.heating.reference.recovery import NO_INCIDENCE, point_recovery_kernel
from sim_heating.inputs.sensor_model import indicated_kernel
from sim_heating.march.frames import BLOCK_END, BLOCK_START, END_STAGE, INTS_END, INTS_START, begin_groups
from sim_heating.simulation import plugin_kernel
from sim_heating.simulation.fmu_export.parts import library
from sim_heating.simulation.fmu_export.parts.library import GOOD, I_HEAD, at
from sim_heating.thermal.elements import STACK_WIDTH, Elements, set_point
from sim_heating.thermal.faces import SIGMA, emittance

# Integers of the model, after those of library.py: numbers of entries, and places of arrays in R or N.
N_POINTS, N_ROWS, N_GROUPS, N_STATE, N_TABLE, N_INTS, N_SENSORS = range(I_HEAD, I_HEAD + 7)
GROUPS, LANE_POINTS, INTS, POINT_INTS, SENSOR_INTS = range(I_HEAD + 7, I_HEAD + 12)
STATE, TABLE, VECTORS, CONSTANTS, HOST, FRAMES, INPUTS_AT_STATE, RANGES = range(I_HEAD + 12, I_HEAD + 20)
OPTIONS, POINT_NUMBERS, WRITTEN, N_TABLES, STARTED_FROM, BETWEEN, VECTORS_THEN = range(I_HEAD + 20, I_HEAD + 27)
N_MODEL = 40
LONGEST_STEP = 0
"""Place in the options: longest thermal step [s]."""
F_Q_ADD, F_AROUND, F_H_REF, F_H_R = (len(FRAME) + k for k in range(4))
HOST_WIDTH = 16

# A point's integers: its group, first lane, number of lanes, number of elements, place of their layers in N, places of
# their lengths and densities in R, place of the bondline in the state, layer of insulation, node of the bondline,
# places of the slots of the elements in N and of their stretch in R.
P_GROUP, P_LANE, P_LANES, P_ELEMENTS, P_LAYERS, P_LENGTHS, P_DENSITIES = range(7)
P_BONDLINE, P_INSULATION, P_BOTTOM, P_SLOTS, P_STRETCH = range(7, 12)
POINT_INTS_WIDTH = 12
# A point's numbers: parameters as in a lane of the kernel (base/kernels/block.py), those of its stack, limits, outputs.
P_STACK = block.N_PARAMETERS
P_SURFACE_LIMIT, P_BONDLINE_LIMIT = P_STACK + STACK_WIDTH, P_STACK + STACK_WIDTH + 1
P_OUT = P_STACK + STACK_WIDTH + 2
PARAMETERS_WIDTH = P_STACK + STACK_WIDTH
"""First numbers of a point, whose copies at WRITTEN are those that its lanes hold."""
SURFACE, BONDLINE, RATIO, CONVECTED, RADIATED, ABSORBED, SURFACE_MARGIN, BONDLINE_MARGIN = range(8)
POINT_WIDTH = P_OUT + 8
# A sensor's integers: its place in the state, places of its numbers (gain, bias, indication, time constant, temperature
# behind its lag) and its calibration, place of the temperature [K] at its place at the start of a step.
S_PLACE, S_NUMBERS, S_CALIBRATION, S_COEFFICIENTS, S_BEFORE = range(5)
SENSOR_WIDTH = 5
S_GAIN, S_BIAS, S_INDICATED, S_TAU, S_LAGGED = range(5)

KEPT_NODE_ROWS = (block.T, block.RATE, block.E_START, block.NET, block.CURVE)
"""Rows of a node that belong to the state. All others follow from parameters, or are written in a step before they are
read, or are caches with bounds."""


@njit
def _first_out_of_range(values, ranges, n: int) -> int:
    """Number of the first input out of its range, GOOD where all are within."""
    for k in range(n):
        if not ranges[2 * k] <= values[k] <= ranges[2 * k + 1]:
            return k
    return GOOD


@inline_always
def _write_group_parameters(R, N, B: FloatArray, J: IntArray, g: int, every: bool) -> None:
    """Write the parameters of the points of a group into its block: of every point, or where they differ from those
    that it holds.
    """
    for i in range(N[N_POINTS]):
        point = at(N, N[POINT_INTS] + POINT_INTS_WIDTH * i)
        if point[P_GROUP] != g:
            continue
        numbers, written = at(R, N[POINT_NUMBERS] + POINT_WIDTH * i), at(R, N[WRITTEN] + PARAMETERS_WIDTH * i)
        differs = every
        for k in range(PARAMETERS_WIDTH):
            differs = differs or written[k] != numbers[k]
            written[k] = numbers[k]
        if not differs:
            continue
        n = point[P_ELEMENTS]
        layers, slots = carray(at(N, point[P_LAYERS]), n), carray(at(N, point[P_SLOTS]), n)
        lengths, densities = carray(at(R, point[P_LENGTHS]), n), carray(at(R, point[P_DENSITIES]), n)
        stack = carray(at(numbers, P_STACK), STACK_WIDTH)
        first, last = point[P_LANE], point[P_LANE] + point[P_LANES]
        heating = carray(numbers, block.N_PARAMETERS)
        stretch = carray(at(R, point[P_STRETCH]), n)
        elements = Elements(layers, lengths, densities, slots, stretch, point[P_INSULATION], point[P_BOTTOM])
        set_point(B, J, first, last, elements, stack, heating)


@njit
def _derive_vectors(R, N, T, inputs, time: float) -> None:
    """Condition vectors of all lanes from inputs."""
    n = N[N_ROWS]
    frame = carray(at(R, N[FRAMES]), len(FRAME))
    frame[plugin_kernel.F_TIME] = time
    for k in range(len(FRAME) - 1):
        frame[1 + k] = inputs[k]
    vectors = carray(at(R, N[VECTORS]), (n, block.N_CONDITIONS))
    numbers = carray(at(R, N[CONSTANTS]), (N[N_POINTS], plugin_kernel.POINT_WIDTH))
    points = plugin_kernel.PointConstants(numbers, carray(T, N[N_TABLES]))
    host = carray(at(R, N[HOST]), HOST_WIDTH)
    host[plugin_kernel.AROUND] = inputs[F_AROUND - 1]
    plugin_kernel.derive_conditions(frame, host, points, carray(at(N, N[LANE_POINTS]), n), vectors)
    for i in range(n):
        vectors[i, block.Q_ADD] = inputs[F_Q_ADD - 1]
        if host[plugin_kernel.CODE] == COLUMNS:
            vectors[i, block.H_REF] = inputs[F_H_REF - 1]
            # The host's enthalpy is that of the flow; a point with an edge recovers less of it.
            vectors[i, block.RECOVERY_ENTHALPY], vectors[i, block.RECOVERY_RISE], _ = point_recovery_kernel(
                inputs[F_H_R - 1],
                frame[plugin_kernel.F_VELOCITY],
                frame[plugin_kernel.F_ALPHA],
                frame[plugin_kernel.F_ELEVON],
                frame[plugin_kernel.F_BODYFLAP],
                numbers[at(N, N[LANE_POINTS])[i]],
                plugin_kernel.RECOVERY_AT,
                NO_INCIDENCE,
            )


@njit
def _begin(R, N, A, T, inputs, time: float) -> None:
    _derive_vectors(R, N, T, inputs, time)
    n = N[N_ROWS]
    groups = carray(at(N, N[GROUPS]), (N[N_GROUPS], 4))
    state, ints = carray(at(R, N[STATE]), N[N_STATE]), carray(at(N, N[INTS]), N[N_INTS])
    vectors = carray(at(R, N[VECTORS]), (n, block.N_CONDITIONS))
    numbers = carray(at(R, N[CONSTANTS]), (N[N_POINTS], plugin_kernel.POINT_WIDTH))
    points = plugin_kernel.PointConstants(numbers, carray(T, N[N_TABLES]))
    plugin_kernel.follow_upstream_walls(state, points, carray(at(N, N[LANE_POINTS]), n), vectors, 0, n)
    table = carray(at(T, N[TABLE]), N[N_TABLE])
    begin_groups(state, ints, table, A[0], A[1], groups, vectors)


@njit
def _advance(R, N, A, T, inputs, time: float, dt: float) -> None:
    """Advance to the conditions of inputs at a time, over dt [s], in thermal steps of at most LONGEST_STEP."""
    _derive_vectors(R, N, T, inputs, time)
    n = N[N_ROWS]
    groups = carray(at(N, N[GROUPS]), (N[N_GROUPS], 4))
    state, ints = carray(at(R, N[STATE]), N[N_STATE]), carray(at(N, N[INTS]), N[N_INTS])
    vectors = carray(at(R, N[VECTORS]), (n, block.N_CONDITIONS))
    then = carray(at(R, N[VECTORS_THEN]), (n, block.N_CONDITIONS))
    for i in range(n):
        for c in range(block.N_CONDITIONS):
            then[i, c] = vectors[i, c]
    steps = max(math.ceil(dt / R[N[OPTIONS] + LONGEST_STEP] - 1e-9), 1)
    table = carray(at(T, N[TABLE]), N[N_TABLE])
    numbers = carray(at(R, N[CONSTANTS]), (N[N_POINTS], plugin_kernel.POINT_WIDTH))
    points, lanes = plugin_kernel.PointConstants(numbers, carray(T, N[N_TABLES])), carray(at(N, N[LANE_POINTS]), n)
    plugin_kernel.advance_behind_walls(state, ints, table, A[0], A[1], groups, points, lanes, vectors, then, dt, steps)


@njit
def _hold_sensors(R, N) -> None:
    """Keep the temperatures at the places of the sensors at the start of a step, or of a part of it."""
    for s in range(N[N_SENSORS]):
        sensor = at(N, N[SENSOR_INTS] + SENSOR_WIDTH * s)
        R[sensor[S_BEFORE]] = R[N[STATE] + sensor[S_PLACE]]


@njit
def _lag_sensors(R, N, dt: float) -> None:
    """Advance the temperatures behind the lags of the sensors by dt [s]; at 0, the start, they are those in front."""
    for s in range(N[N_SENSORS]):
        sensor = at(N, N[SENSOR_INTS] + SENSOR_WIDTH * s)
        numbers, sensed = at(R, sensor[S_NUMBERS]), R[N[STATE] + sensor[S_PLACE]]
        if numbers[S_TAU] > 0.0 and dt > 0.0:
            sensed = lag_step(numbers[S_LAGGED], R[sensor[S_BEFORE]], sensed, dt / numbers[S_TAU])
        numbers[S_LAGGED] = sensed


@inline_always
def _advance_through(R, N, A, T, now, then) -> None:
    """Advance from the inputs at the start of a step to those at its end, a long one in parts as the plug-in does."""
    n, width = N[library.N_INPUTS], len(FRAME)
    first, last = carray(at(R, N[STARTED_FROM]), width), carray(at(R, N[FRAMES]), width)
    between, inputs = carray(at(R, N[BETWEEN]), width), at(R, N[BETWEEN] + 1)
    parts, time = plugin_kernel.parts_of_frame(R[library.NEXT] - R[library.NOW]), R[library.NOW]
    for k in range(1, parts):
        # `_derive_vectors` writes the frame that it derives from.
        for i in range(width - 1):
            first[1 + i], last[1 + i] = now[i], then[i]
        first[plugin_kernel.F_TIME], last[plugin_kernel.F_TIME] = R[library.NOW], R[library.NEXT]
        fraction = k / parts
        plugin_kernel.write_frame_between(first, last, fraction, between)
        for i in range(width - 1, n):
            inputs[i] = now[i] + fraction * (then[i] - now[i])
        # Surroundings of 0 K stand for declared ones, to which no line leads.
        if now[F_AROUND - 1] == 0.0 or then[F_AROUND - 1] == 0.0:
            inputs[F_AROUND - 1] = then[F_AROUND - 1]
        until = between[plugin_kernel.F_TIME]
        _hold_sensors(R, N)
        _advance(R, N, A, T, inputs, until, until - time)
        _lag_sensors(R, N, until - time)
        time = until
    _hold_sensors(R, N)
    _advance(R, N, A, T, then, R[library.NEXT], R[library.NEXT] - time)
    _lag_sensors(R, N, R[library.NEXT] - time)


@njit
def _follow_ratio_tables(R, N, T) -> None:
    """Write the ratio tables that the lanes use into the constants of the points, whose thin air they bridge."""
    for i in range(N[N_POINTS]):
        point = at(N, N[POINT_INTS] + POINT_INTS_WIDTH * i)
        ints = N[INTS] + N[N[GROUPS] + 4 * point[P_GROUP] + INTS_START]
        table = N[ints + block.RATIO_TABLE + point[P_LANE]]
        if table != block.NO_TABLE:
            numbers = at(R, N[CONSTANTS] + plugin_kernel.POINT_WIDTH * i + plugin_kernel.FLOW_AT)
            numbers[LAMINAR_AT], numbers[LARGEST] = table, largest_ratio(T, table)


@njit
def _write_parameters(R, N, every: bool) -> None:
    """Write the parameters into all groups: of every point, or where they differ from those that the lanes hold."""
    groups = carray(at(N, N[GROUPS]), (N[N_GROUPS], 4))
    state, ints = carray(at(R, N[STATE]), N[N_STATE]), carray(at(N, N[INTS]), N[N_INTS])
    for g in range(N[N_GROUPS]):
        B = state[groups[g, BLOCK_START] : groups[g, BLOCK_END]]
        _write_group_parameters(R, N, B, ints[groups[g, INTS_START] : groups[g, INTS_END]], g, every)


@inline_always
def _clear_counts(R, N) -> None:
    """Set the counters of all groups to 0."""
    groups = carray(at(N, N[GROUPS]), (N[N_GROUPS], 4))
    for g in range(N[N_GROUPS]):
        B = at(R, N[STATE] + groups[g, BLOCK_START])
        for row in block.COUNTERS:
            for lane in range(LANES):
                B[row * LANES + lane] = 0.0


@njit
def _write_outputs(R, N, A, T) -> int:
    """Write the outputs; number of the first point whose step did not converge, GOOD where all did."""
    outcome = GOOD
    # From the last point to the first: the outcome that remains is the first point that failed.
    for i in range(N[N_POINTS] - 1, -1, -1):
        point = at(N, N[POINT_INTS] + POINT_INTS_WIDTH * i)
        numbers = at(R, N[POINT_NUMBERS] + POINT_WIDTH * i)
        out = at(numbers, P_OUT)
        first = N[GROUPS] + 4 * point[P_GROUP]
        state, ints = at(R, N[STATE] + N[first]), at(N, N[INTS] + N[first + INTS_START])
        B, J = at(state, point[P_LANE]), at(ints, point[P_LANE])
        wall = B[(block.HEAD_ROWS + block.T) * LANES]
        h_ref = R[N[VECTORS] + (point[P_GROUP] * LANES + point[P_LANE]) * block.N_CONDITIONS + block.H_REF]
        excess = wall * wall * wall * wall - B[(block.STAGE_SURROUNDINGS4 + 2) * LANES]
        eps = B[block.FACTOR_EPS * LANES] * emittance(at(T, N[TABLE]), J[block.EMISSIVITY_TABLE], wall)
        if J[block.N_EMITTING] > 0:
            eps *= emittance_factor(state, ints, A[0], point[P_LANE], block.END, wall)
        out[SURFACE], out[BONDLINE] = wall, R[N[STATE] + point[P_BONDLINE]]
        out[RATIO] = B[(block.FILM + 2) * LANES] / h_ref if h_ref > 0.0 else 0.0
        out[RADIATED] = eps * SIGMA * excess
        out[ABSORBED] = B[block.STAGE_IN * LANES]
        out[CONVECTED] = out[ABSORBED] + out[RADIATED] - B[(block.ADDED + 2) * LANES]
        out[SURFACE_MARGIN] = numbers[P_SURFACE_LIMIT] - out[SURFACE]
        out[BONDLINE_MARGIN] = numbers[P_BONDLINE_LIMIT] - out[BONDLINE]
        if B[block.FAILED * LANES] != 0.0 or not math.isfinite(wall):
            outcome = i
    for s in range(N[N_SENSORS]):
        sensor = at(N, N[SENSOR_INTS] + SENSOR_WIDTH * s)
        numbers = at(R, sensor[S_NUMBERS])
        coefficients = carray(at(R, sensor[S_CALIBRATION]), sensor[S_COEFFICIENTS])
        numbers[S_INDICATED] = indicated_kernel(numbers[S_LAGGED], numbers[S_GAIN], numbers[S_BIAS], coefficients)
    return outcome


# Problems of the image, by number: an input out of range at the end of a step, at its start; a point whose step did not
# converge.


@inline_always
def _start(R, N, A, T) -> int:
    """Set the initial temperatures of the stacks, in the conditions of the inputs."""
    n = N[library.N_INPUTS]
    for k in range(n):
        R[N[library.INPUTS_NEXT] + k] = R[N[library.INPUTS] + k]
    inputs = at(R, N[library.INPUTS_NEXT])
    outside = _first_out_of_range(inputs, at(R, N[RANGES]), n)
    if outside != GOOD:
        return outside
    _write_parameters(R, N, True)
    _follow_ratio_tables(R, N, T)
    _clear_counts(R, N)
    _begin(R, N, A, T, inputs, R[library.NOW])
    for k in range(n):
        R[N[INPUTS_AT_STATE] + k] = inputs[k]
    _lag_sensors(R, N, 0.0)
    outcome = _write_outputs(R, N, A, T)
    return GOOD if outcome == GOOD else 2 * n + outcome


@inline_always
def _step(R, N, A, T) -> int:
    """Advance all points to the end of a step."""
    n = N[library.N_INPUTS]
    now, then, ranges = at(R, N[library.INPUTS_NOW]), at(R, N[library.INPUTS_NEXT]), at(R, N[RANGES])
    outside = _first_out_of_range(now, ranges, n)
    if outside != GOOD:
        return n + outside
    outside = _first_out_of_range(then, ranges, n)
    if outside != GOOD:
        return outside
    jumped = N[library.CHANGED] != 0
    if jumped:
        _write_parameters(R, N, True)
        _follow_ratio_tables(R, N, T)
    # Inputs that differ from those at the end of the last step are a jump: heat contents and net heat are evaluated
    # again.
    for k in range(n):
        jumped = jumped or R[N[INPUTS_AT_STATE] + k] != now[k]
    if jumped:
        _begin(R, N, A, T, now, R[library.NOW])
    _advance_through(R, N, A, T, now, then)
    for k in range(n):
        R[N[INPUTS_AT_STATE] + k] = then[k]
    outcome = _write_outputs(R, N, A, T)
    return GOOD if outcome == GOOD else 2 * n + outcome


@inline_always
def _resume(R, N, T) -> int:
    """Make the blocks agree with the kept rows of another instance (KEPT_ROWS of block.py, KEPT_NODE_ROWS)."""
    # Property polynomials stay: they hold for temperatures between their bounds, whichever instance asks.
    _write_parameters(R, N, False)
    _follow_ratio_tables(R, N, T)
    lanes = at(N, N[LANE_POINTS])
    groups = carray(at(N, N[GROUPS]), (N[N_GROUPS], 4))
    for g in range(N[N_GROUPS]):
        B = carray(at(R, N[STATE] + groups[g, BLOCK_START]), groups[g, BLOCK_END] - groups[g, BLOCK_START])
        J = at(N, N[INTS] + groups[g, INTS_START])
        # Of lanes that repeat a point the first one is kept.
        for lane in range(1, LANES):
            if lanes[g * LANES + lane] == lanes[g * LANES + lane - 1]:
                last = END_STAGE + lane * block.N_CONDITIONS
                for c in range(last, last + block.N_CONDITIONS):
                    B[c] = B[c - block.N_CONDITIONS]
                for row in block.KEPT_ROWS:
                    B[row * LANES + lane] = B[row * LANES + lane - 1]
                for i in range(J[block.N_NODES]):
                    for row in KEPT_NODE_ROWS:
                        a = (block.HEAD_ROWS + i * block.NODE_ROWS + row) * LANES + lane
                        B[a] = B[a - 1]
        # The instances may have different ratio tables.
        invalidate_cells(B)
        # Without gaps nobody writes the sources of inner nodes: they would remain those of an instance with gaps.
        for i in range(J[block.N_NODES] if J[block.GAPS] == 0 else 0):
            a = (block.HEAD_ROWS + i * block.NODE_ROWS) * LANES
            for lane in range(LANES):
                B[a + block.SOURCE * LANES + lane] = 0.0
                B[a + block.SLOPE * LANES + lane] = 0.0
    return GOOD


def advance(R, N, A, T) -> int:
    """The model, as library.py describes it."""
    if N[library.MODE] == library.RESUME:
        return _resume(R, N, T)
    if N[library.MODE] == library.START:
        return _start(R, N, A, T)
    return _step(R, N, A, T)
