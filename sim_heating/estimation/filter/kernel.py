"""Extended Kalman filter on the node temperatures of lanes that march together; compiled.

The state of a lane is z = (T_0 .. T_(n-1), d): its node temperatures and a disturbance d of the heating ratio,
additive like ratio.d0 and constant over a step. With Phi the derivative of the step against its start and Gamma that
against d,

    z' = F z + w,    F = [Phi, Gamma; 0, decay],    P' = F P F' + Q,

where F is never formed. P = L L' with as few columns as its rank asks for, the columns of L are propagated with the
matrix of the step, and F P F' = (F L) (F L)': a start known along a few directions stays on a few directions. A
reading at the fraction x of a step is y = gain T(x) + bias + noise, T(x) the parabola through start, middle stage
and end plus the part x of the step's white noise, so that with R its row against z

    cov(z', T) = F L (R L)' + Q_x,    cov(T_i, T_j) = R_i L (R_j L)' + Q_x,

and all readings of a step are taken one after the other from the joint covariance of z' and themselves, without a
second march. A reading known as an interval matches the moments of the truncated normal (Curry, Estimation and Control
with Quantized Measurements, MIT Press 1970), which is a linear reading of variance S / (1 - v), v the fraction of S
that remains.

Sensitivities of the state go through an update as S+ = S - K dy/dp: the derivative of the gain itself is left out.
After a given time the covariances may be frozen: as long as readings lie where they did in the step before, its gains
are used again. Derived in docs/theory/filter.md, equations 1 to 14.
"""

from __future__ import annotations

import math

import numpy as np

from sim_heating.base.arrays import FloatArray, IntArray
from sim_heating.base.kernels.block import (
    D0,
    HEAD_ROWS,
    LAG_INPUT,
    LAG_PAST,
    LAG_VALUE,
    LANES,
    N_PARAMETERS,
    NODE_ROWS,
    PARAMETERS,
    PAST_ONSET,
    T_STAGE,
    T_START,
    T,
)
from sim_heating.base.kernels.jit import njit
from sim_heating.base.kernels.operations import call_step, pointer
from sim_heating.estimation.filter.arrays import (
    Blocks,
    FilterArrays,
    FrozenGains,
    LaneStep,
    Noise,
    Readings,
    SmootherHistory,
    State,
    StepReadings,
    Workspace,
)
from sim_heating.estimation.inference.truncated_normal import LOG_ROOT_2PI, truncated_normal
from sim_heating.march.frames import Flights, set_flight_conditions
from sim_heating.thermal.faces import COLDEST_K
from sim_heating.thermal.frame import EVALUATE_START, shift_conditions
from sim_heating.thermal.sensitivity import (
    PerturbedGroups,
    PerturbedOffsets,
    assemble_perturbed,
    begin_columns,
    content_columns,
    first_right_hand_side,
    parabola,
    parabola_rate,
    second_right_hand_side,
    solve_columns,
    start_from_copy,
)
from sim_heating.thermal.step import STAGE_WEIGHT, LaneGroup

(
    PRIOR,
    PRIOR_VARIANCE,
    POSTERIOR,
    POSTERIOR_VARIANCE,
    PREDICTED,
    PREDICTED_VARIANCE,
    INNOVATION,
    VARIANCE,
    LOG_LIKELIHOOD,
    N_OUT,
) = range(10)
"""Workspace of the output of a reading: temperature [K] and variance [K2] before and after all readings of its time;
prediction and variance, noise included, once those before it are taken; innovation [K] and its variance [K2]; log
likelihood. The sensitivities of its prediction follow."""
CONSTANT, PER_TEMPERATURE, PER_RATE = range(3)
"""Direct terms of a parameter in a reading: constant, times the temperature, times its rate."""
SAME_FRACTION = 1e-6
"""Fraction of a step within which two readings count as simultaneous, for frozen gains."""
MIN_GAIN = 1e-14
"""A reading that removes less than this fraction of its own variance is not used: its effect would be rounding."""
LEFT_OUT = 1e-14
"""Part of the largest variance of a temperature [-] below which what is left of the covariance is rounding."""


@njit
def propagate(X: Blocks, offsets: PerturbedOffsets, lane: int, forced: int, dt: float, w: Workspace) -> None:
    """Propagate columns of derivatives of the temperatures through one TR-BDF2 step, in place.

    X       : blocks of the perturbed lanes at start, middle stage and end
    offsets : where the perturbed lanes of this lane are
    forced  : number of columns, the first ones, whose parameters also act in the step (dT/dp); the others are products
              with Phi alone
    dt      : time step [s]
    w       : columns (node, column) in w.end, at the start on entry, at the end on return; w.middle: middle stage [K
              over the unit of the column]

    Derived in docs/theory/equations_march.md, equations 7 and 8.
    """
    ddt, width = STAGE_WEIGHT * dt, w.end.shape[1]
    count = offsets.nodes[lane] * width
    end, middle, e, f = pointer(w.end), pointer(w.middle), pointer(w.e), pointer(w.f)
    star, content, reduced = pointer(w.star), pointer(w.e_middle), pointer(w.reduced)
    begin_columns(pointer(X.start), offsets, lane, forced, end, e, f, 0, width)
    first_right_hand_side(e, f, dt, star, 0, count)
    solve_columns(pointer(X.middle), offsets, lane, forced, ddt, star, middle, 0, width, reduced)
    content_columns(pointer(X.middle), offsets, lane, forced, middle, content, 0, width)
    second_right_hand_side(e, content, star, 0, count)
    solve_columns(pointer(X.end), offsets, lane, forced, ddt, star, end, 0, width, reduced)


@njit
def _copy_matrix(source: FloatArray, out: FloatArray) -> None:
    """Copy a matrix number by number: numba's own assignment spends 4 s on compiling the message of its error."""
    for i in range(source.shape[0]):
        for j in range(source.shape[1]):
            out[i, j] = source[i, j]


@njit
def _add_forcing(gamma: Workspace, w: Workspace, column: int, amount: float, n: int) -> None:
    """Add the response to a disturbance `amount` [-] to a column; gamma.end[:, 0] is the response to 1."""
    for i in range(n):
        w.end[i, column] += gamma.end[i, 0] * amount
        w.middle[i, column] += gamma.middle[i, 0] * amount


@njit
def columns_of(w: Workspace, nodes: int, columns: int) -> Workspace:
    """The first numbers of a work space as one of so many nodes and columns, each column [K] over some unit.

    Its arrays are contiguous, as `propagate` wants them. The propagation is docs/theory/equations_march.md, equation 7.
    """
    count = nodes * columns
    return Workspace(
        w.end.ravel()[:count].reshape((nodes, columns)),
        w.middle.ravel()[:count].reshape((nodes, columns)),
        w.e.ravel()[:count].reshape((nodes, columns)),
        w.f.ravel()[:count].reshape((nodes, columns)),
        w.star.ravel()[:count].reshape((nodes, columns)),
        w.e_middle.ravel()[:count].reshape((nodes, columns)),
        w.reduced,
    )


@njit
def factorise_covariance(P: FloatArray, n: int, diagonal: FloatArray, L: FloatArray) -> int:
    """Factor of a covariance of low rank, P = L L', by elimination of the largest variance that is left.

    P        : (n + 1, n + 1) covariance of the temperatures [K2] and of the disturbance; its lower triangle is read
    diagonal : (n + 1,) work space
    L        : (column, n + 1) receives the columns of the factor as its rows [K], [-]
    returns  : number of columns; what is left has variances below LEFT_OUT of the largest one of a temperature

    Derived in docs/theory/filter.md, equation 4.
    """
    largest = 0.0
    for i in range(n):
        diagonal[i] = P[i, i]
        largest = max(largest, P[i, i])
    limit = LEFT_OUT * largest
    pivot, variance, rank = n, P[n, n], 0
    # The disturbance first: its unit is another one.
    if not variance > 0.0:
        pivot, variance = _largest(diagonal, n)
    while variance > (0.0 if pivot == n else limit):
        for i in range(pivot):
            L[rank, i] = P[pivot, i]
        for i in range(pivot, n + 1):
            L[rank, i] = P[i, pivot]
        for k in range(rank):
            factor = L[k, pivot]
            for i in range(n + 1):
                L[rank, i] -= factor * L[k, i]
        inverse = 1.0 / math.sqrt(variance)
        for i in range(n + 1):
            L[rank, i] *= inverse
        for i in range(n):
            diagonal[i] -= L[rank, i] * L[rank, i]
        if pivot < n:
            diagonal[pivot] = 0.0
        rank += 1
        if rank > n:
            break
        pivot, variance = _largest(diagonal, n)
    return rank


@njit
def _largest(diagonal: FloatArray, n: int) -> tuple[int, float]:
    """Number and value of the largest of n variances [K2]."""
    at = 0
    for i in range(1, n):
        if diagonal[i] > diagonal[at]:
            at = i
    return at, diagonal[at]


@njit
def first_pass(X: Blocks, offsets: PerturbedOffsets, step: LaneStep, state: State, L: FloatArray, w: Workspace) -> None:
    """Propagate Gamma, the sensitivities, the factor of the covariance and where wanted F through one step of a lane.

    X, offsets : blocks of the perturbed lanes, and where those of each lane are
    step       : the step; `rank` columns of L, `keep` for the columns of F
    state      : sensitivities at the start, unchanged
    L          : (column, node + 1) columns of the factor at the start as rows, P = L L'
    w          : receives columns at end and middle stage: Gamma [K], sensitivities [K over the parameter's unit], F L
                 [K], F

    Columns come in this order, so that those with forcing are the first. Derived in docs/theory/filter.md, equations 4
    and 11.
    """
    lane, n, m = step.lane, step.nodes, state.S.shape[2]
    first, identity = 1 + m, 1 + m + step.rank
    w.end[:, :] = 0.0
    for i in range(n):
        for k in range(m):
            w.end[i, 1 + k] = state.S[lane, i, k]
        for j in range(step.rank):
            w.end[i, first + j] = L[j, i]
        if step.keep:
            w.end[i, identity + i] = 1.0
    propagate(X, offsets, lane, 1 + m, step.dt, w)
    for k in range(m):
        _add_forcing(w, w, 1 + k, state.S[lane, n, k], n)
    for j in range(step.rank):
        _add_forcing(w, w, first + j, L[j, n], n)
    if step.keep:
        _add_forcing(w, w, identity + n, 1.0, n)


@njit
def read_column(w: Workspace, column: int, node: int, x: float, start: float) -> float:
    """Value of a column at a node and a fraction of a step, T(x) = w0 T_n + w1 T_(n + gamma) + w2 T_(n+1).

    x     : fraction of the step [-];  start : value of the column at the node at the start of the step

    Source: docs/theory/equations_march.md, equation 4.
    """
    w0, w1, w2 = parabola(x)
    return w0 * start + w1 * w.middle[node, column] + w2 * w.end[node, column]


@njit
def predict_readings(
    B: FloatArray, step: LaneStep, readings: Readings, state: State, L: FloatArray, w: Workspace, batch: StepReadings
) -> None:
    """Predict the readings of a step: temperatures, rates, sensitivities, rows, and rows times the factor.

    B        : block of the lane group, after the step;  step : the step
    readings : readings of all lanes;  state, L : at the start of the step
    w        : columns of the first pass
    batch    : receives temperature [K], rate [K/s], sensitivities, R L [K] and R of each reading of the step

    Derived in docs/theory/filter.md, equations 5 and 6, and docs/theory/equations_march.md, equation 5.
    """
    lane, n, m = step.lane, step.nodes, state.S.shape[2]
    identity = 1 + m + step.rank
    for q in range(step.number):
        node, x = readings.node[lane, step.first + q], batch.x[q]
        a = (HEAD_ROWS + node * NODE_ROWS) * LANES + lane
        T0, T1, T2 = B[a + T_START * LANES], B[a + T_STAGE * LANES], B[a + T * LANES]
        w0, w1, w2 = parabola(x)
        batch.mean[q] = w0 * T0 + w1 * T1 + w2 * T2
        w0, w1, w2 = parabola_rate(x, step.dt)
        batch.rate[q] = w0 * T0 + w1 * T1 + w2 * T2
        for k in range(m):
            batch.S[q, k] = read_column(w, 1 + k, node, x, state.S[lane, node, k])
        for j in range(step.rank):
            batch.projected[q, j] = read_column(w, 1 + m + j, node, x, L[j, node])
        if step.keep:
            for j in range(n + 1):
                batch.rows[q, j] = read_column(w, identity + j, node, x, 1.0 if j == node else 0.0)


@njit
def add_rows(out: FloatArray, size: int, shares: FloatArray, rows: FloatArray, count: int) -> None:
    """Add shares of several rows to a vector, out[k] += sum_j shares[j] rows[j, k], in the order of j.

    out : (size,) at least, changed;  shares : (count,), rows : (count, size) at least, products in its unit ([K2], [K])

    Four rows a time, so that the vector is read and written a quarter as often; the sums are those of one row after the
    other. Used for the products of docs/theory/filter.md, equations 4, 6, 8 and 11.
    """
    j = 0
    while j + 4 <= count:
        a, b, c, d = shares[j], shares[j + 1], shares[j + 2], shares[j + 3]
        for k in range(size):
            out[k] = out[k] + a * rows[j, k] + b * rows[j + 1, k] + c * rows[j + 2, k] + d * rows[j + 3, k]
        j += 4
    while j < count:
        for k in range(size):
            out[k] += shares[j] * rows[j, k]
        j += 1


@njit
def joint_covariance(
    step: LaneStep, readings: Readings, state: State, noise: Noise, L: FloatArray, w: Workspace, batch: StepReadings
) -> None:
    """Covariance of the state after a step, P' = F P F' + Q, and the joint covariance of its readings.

    step  : the step;  readings : of all lanes;  noise : of the process [K2/s], [1/s]
    L     : factor of P at the start, becomes F L;  w : columns of the first pass, F L among them
    state : the lower triangle of P becomes that of P', [K2] for the temperatures
    batch : receives cov(z', T) and cov(T_a, T_b) [K2]

    Derived in docs/theory/filter.md, equations 2, 4 and 6.
    """
    lane, n, m, rank = step.lane, step.nodes, state.S.shape[2], step.rank
    dt, decay, first, count = step.dt, step.decay, step.first, step.number
    P = state.P[lane]
    variance = P[n, n]
    for j in range(rank):
        for i in range(n):
            L[j, i] = w.end[i, 1 + m + j]
        L[j, n] *= decay
    for i in range(n + 1):
        for k in range(i + 1):
            P[i, k] = 0.0
        for j in range(rank):
            batch.scratch[j] = L[j, i]
        add_rows(P[i], i + 1, batch.scratch, L, rank)
        if i < n:
            P[i, i] += noise.nodes[lane, i] * dt
    P[n, n] = decay * decay * variance + noise.density_1_s[lane] * _noise_duration(noise.decay_1_s[lane], dt)
    for q in range(count):
        node, x = readings.node[lane, first + q], batch.x[q]
        batch.cross[q, : n + 1] = 0.0
        add_rows(batch.cross[q], n + 1, batch.projected[q], L, rank)
        # White noise of the node up to the reading is still in the node's temperature at the end of the step.
        batch.cross[q, node] += x * dt * noise.nodes[lane, node]
        for s in range(q + 1):
            covariance = 0.0
            for j in range(rank):
                covariance += batch.projected[q, j] * batch.projected[s, j]
            if readings.node[lane, first + s] == node:
                # Two readings of a node share the noise up to the earlier of them.
                covariance += min(x, batch.x[s]) * dt * noise.nodes[lane, node]
            batch.covariance[q, s] = batch.covariance[s, q] = covariance


@njit
def _noise_duration(decay_1_s: float, dt: float) -> float:
    """Integral of exp(-2 decay t) over a step [s]; dt for a random walk (docs/theory/filter.md, equation 2)."""
    return dt if decay_1_s == 0.0 else -math.expm1(-2.0 * decay_1_s * dt) / (2.0 * decay_1_s)


@njit
def innovation(lower: float, upper: float, mean: float, variance: float) -> tuple[float, float, float]:
    """Innovation, its variance and log likelihood of a reading whose prediction is N(mean, variance).

        nu = sqrt(S) E xi / (1 - var xi),    S / (1 - var xi),    log L = log Z

    lower, upper   : interval of the reading [K]; equal for an unrounded one, then nu = y - mean and S itself
    mean, variance : prediction [K] and its variance S, sensor noise included [K2]
    returns        : innovation [K], variance [K2], log likelihood [-]

    xi is standard normal, truncated to the interval, Z its probability. The unrounded reading given moves mean and
    variance as the interval does. Where 1 - var xi is below 1e-14 the variance is infinite: the reading has no effect.
    Source: Curry 1970; derived in docs/theory/filter.md, equations 9 and 10.
    """
    spread = math.sqrt(variance)
    if not lower < upper:
        z = (lower - mean) / spread
        return lower - mean, variance, -0.5 * z * z - LOG_ROOT_2PI - math.log(spread)
    log_z, x, _, gain, _, _, _ = truncated_normal(
        (lower - mean) / spread, (upper - mean) / spread, (upper - lower) / spread
    )
    # The word is open at one end and the prediction lies deep inside: the reading confirms it and adds nothing.
    if gain < MIN_GAIN:
        return 0.0, math.inf, log_z
    return x * spread / gain, variance / gain, log_z


@njit
def _condition_on(
    step: LaneStep,
    q: int,
    begun: int,
    readings: Readings,
    state: State,
    batch: StepReadings,
    z: FloatArray,
    transition: FloatArray,
    out: FloatArray,
) -> None:
    """Condition z and the readings of the step from number `begun` on, on reading number q of it.

    What it takes from P and from the sensitivities of z stays in `batch`: cov(z, T), which later readings change no
    more, its weight, 1 / S, and the sensitivities of its prediction in the place of those of its temperature.
    """
    lane, n, count, k = step.lane, step.nodes, step.number, step.first + q
    gain, m = readings.gain[lane, k], state.S.shape[2]
    batch.weight[q], batch.inverse[q] = 0.0, 0.0
    predicted = out[N_OUT:]
    for j in range(m):
        direct = readings.direct[lane, k, j]
        predicted[j] = gain * batch.S[q, j] + direct[CONSTANT]
        predicted[j] += direct[PER_TEMPERATURE] * batch.mean[q] + direct[PER_RATE] * batch.rate[q]
    out[PREDICTED] = gain * batch.mean[q] + readings.bias[lane, k]
    out[PREDICTED_VARIANCE] = gain * gain * batch.covariance[q, q] + readings.variance[lane, k]
    if not readings.lower[lane, k] <= readings.upper[lane, k]:
        return
    nu, variance, out[LOG_LIKELIHOOD] = innovation(
        readings.lower[lane, k], readings.upper[lane, k], out[PREDICTED], out[PREDICTED_VARIANCE]
    )
    out[INNOVATION], out[VARIANCE] = nu, variance
    # Copies: the loops below overwrite row q with its own update before they are done with the other readings.
    cross, covariance, inverse = batch.cross[q], batch.covariance[q].copy(), 1.0 / variance
    batch.weight[q], batch.inverse[q] = gain * gain * inverse, inverse
    for i in range(n + 1):
        z[i] += gain * cross[i] * inverse * nu
    if step.keep:
        _condition_rows(step, q, gain, inverse, covariance, batch, transition)
    for s in range(begun, count):
        change = gain * covariance[s] * inverse
        batch.mean[s] += change * nu
        for t in range(begun, count):
            batch.covariance[s, t] -= (gain * covariance[s]) * (gain * covariance[t]) * inverse
        if s > q:
            for i in range(n + 1):
                batch.cross[s, i] -= change * (gain * cross[i])
            for j in range(m):
                batch.S[s, j] -= change * predicted[j]
    for j in range(m):
        batch.S[q, j] = predicted[j]


@njit
def _condition_rows(
    step: LaneStep,
    q: int,
    gain: float,
    inverse: float,
    covariance: FloatArray,
    batch: StepReadings,
    transition: FloatArray,
) -> None:
    """Condition the transition and the rows of the later readings on reading number q, for a smoother."""
    for i in range(step.nodes + 1):
        change = gain * batch.cross[q, i] * inverse
        for j in range(step.nodes + 1):
            transition[i, j] -= change * (gain * batch.rows[q, j])
    for s in range(q + 1, step.number):
        change = gain * covariance[s] * inverse
        for i in range(step.nodes + 1):
            batch.rows[s, i] -= change * (gain * batch.rows[q, i])


@njit
def _condition_covariance(P: FloatArray, n: int, count: int, batch: StepReadings) -> None:
    """P+ = P' - sum g^2 / S cov(z, T) cov(z, T)' [K2] over the readings of a step, from the lower triangle to both."""
    for i in range(n + 1):
        for q in range(count):
            batch.scratch[q] = -(batch.weight[q] * batch.cross[q, i])
        add_rows(P[i], i + 1, batch.scratch, batch.cross, count)
    for i in range(n + 1):
        for j in range(i):
            P[j, i] = P[i, j]


@njit
def _condition_sensitivities(step: LaneStep, readings: Readings, state: State, batch: StepReadings) -> None:
    """S+ = S - sum g / S cov(z, T) dy/dp over the readings of a step (docs/theory/filter.md, equation 11)."""
    lane, n, count = step.lane, step.nodes, step.number
    S, column = state.S[lane], batch.column
    for q in range(count):
        gain, inverse = readings.gain[lane, step.first + q], batch.inverse[q]
        for i in range(n + 1):
            batch.projected[q, i] = gain * batch.cross[q, i] * inverse
    # column by column: a row has as many numbers as there are parameters, too few for the processor's vectors
    for j in range(S.shape[1]):
        for q in range(count):
            batch.scratch[q] = -batch.S[q, j]
        for i in range(n + 1):
            column[i] = S[i, j]
        add_rows(column, n + 1, batch.scratch, batch.projected, count)
        for i in range(n + 1):
            S[i, j] = column[i]


@njit
def take_readings(
    step: LaneStep,
    readings: Readings,
    state: State,
    batch: StepReadings,
    z: FloatArray,
    transition: FloatArray,
    history: SmootherHistory,
    out: FloatArray,
) -> None:
    """Update a lane by the readings of one step, in order of time.

        K = g cov(z', T) / S,    z+ = z' + K nu,    P+ = P' - S K K'

    step, readings      : the step; readings of all lanes
    state, batch        : covariances and sensitivities; readings of the step; updated
    z                   : (node + 1,) temperatures [K] and disturbance [-], updated
    transition, history : for a smoother, where `step.keep`
    out                 : (reading, column) receives for each reading temperature before and after all readings of its
                          time [K] with variances [K2], prediction, innovation, log likelihood, sensitivities

    A reading without an interval (NaN) is predicted and changes nothing. Derived in docs/theory/filter.md, equations 7
    to 14.
    """
    lane, first, count = step.lane, step.first, step.number
    begun = 0
    for q in range(count):
        k = first + q
        # Readings of one time share their a priori and a posteriori state, whatever the order in which they are taken.
        if readings.time_s[lane, k] != readings.time_s[lane, first + begun]:
            begun = q
        # A priori values of all sensors read at one time, before the first of them is taken.
        if begun == q:
            last = q
            while last + 1 < count and readings.time_s[lane, first + last + 1] == readings.time_s[lane, k]:
                last += 1
            for s in range(q, last + 1):
                out[first + s, PRIOR], out[first + s, PRIOR_VARIANCE] = batch.mean[s], batch.covariance[s, s]
        if step.keep:
            for j in range(step.nodes + 1):
                history.rows[lane, k, j] = readings.gain[lane, k] * batch.rows[q, j]
        _condition_on(step, q, begun, readings, state, batch, z, transition, out[k])
        for s in range(begun, q + 1):
            out[first + s, POSTERIOR], out[first + s, POSTERIOR_VARIANCE] = batch.mean[s], batch.covariance[s, s]
    _condition_sensitivities(step, readings, state, batch)
    _condition_covariance(state.P[lane], step.nodes, count, batch)


@njit
def _repeats(gains: FrozenGains, readings: Readings, lane: int, first: int, count: int, batch: StepReadings) -> bool:
    """Whether the readings of a step are at the nodes and fractions of those whose covariances are stored."""
    if gains.number[lane] != count:
        return False
    for q in range(count):
        if gains.node[lane, q] != readings.node[lane, first + q] or abs(gains.x[lane, q] - batch.x[q]) > SAME_FRACTION:
            return False
    return True


@njit
def _store_covariances(
    step: LaneStep, gains: FrozenGains, readings: Readings, state: State, batch: StepReadings
) -> None:
    """Store the covariances of a step for frozen gains."""
    lane, count = step.lane, step.number
    gains.number[lane] = count
    _copy_matrix(state.P[lane], gains.P[lane])
    for q in range(count):
        gains.node[lane, q], gains.x[lane, q] = readings.node[lane, step.first + q], batch.x[q]
    _copy_matrix(batch.cross[:count], gains.cross[lane, :count])
    _copy_matrix(batch.covariance[:count], gains.covariance[lane, :count])


@njit
def _reuse_covariances(step: LaneStep, gains: FrozenGains, state: State, batch: StepReadings) -> None:
    """Use the stored covariances for those of this step."""
    _copy_matrix(gains.P[step.lane], state.P[step.lane])
    _copy_matrix(gains.cross[step.lane, : step.number], batch.cross[: step.number])
    _copy_matrix(gains.covariance[step.lane, : step.number], batch.covariance[: step.number])


@njit
def filter_lane(
    B: FloatArray,
    X: Blocks,
    offsets: PerturbedOffsets,
    time_s: FloatArray,
    lane: int,
    k: int,
    first: int,
    f: FilterArrays,
    out: FloatArray,
) -> int:
    """Filter step k of one lane: covariance, sensitivities, readings, after its temperatures have been marched.

    B, X, offsets : block of the lane group, blocks of the perturbed lanes, where those of each lane are
    time_s        : (time,) steps [s];  lane, k : numbers of lane and step;  first : number of its next reading
    f             : arrays of the filter, updated
    out           : (reading, column) results of the readings
    returns       : number of the next reading

    A lane that diverges (a temperature at or below 1 K, or not finite) is marked and keeps the temperatures of its
    march. Derived in docs/theory/filter.md, equations 1 to 14.
    """
    readings, state, history, batch = f.readings, f.state, f.history, f.batch
    n, m = offsets.nodes[lane], state.S.shape[2]
    keep = history.mean.shape[1] > 0
    dt = time_s[k] - time_s[k - 1]
    decay = math.exp(-f.noise.decay_1_s[lane] * dt)
    count = 0
    while first + count < readings.number[lane] and readings.time_s[lane, first + count] <= time_s[k]:
        batch.x[count] = (readings.time_s[lane, first + count] - time_s[k - 1]) / dt
        count += 1
    # With frozen gains only Gamma and the sensitivities are propagated; F L is not needed.
    is_updated = time_s[k] <= f.gains.after_s[lane] or not _repeats(f.gains, readings, lane, first, count, batch)
    rank = factorise_covariance(state.P[lane], n, f.z, f.L) if is_updated else 0
    step = LaneStep(lane, n, dt, decay, first, count, rank, keep)
    w = columns_of(f.work, f.work.end.shape[0], 1 + m + rank + (n + 1 if keep else 0))
    first_pass(X, offsets, step, state, f.L, w)
    predict_readings(B, step, readings, state, f.L, w, batch)
    if is_updated:
        joint_covariance(step, readings, state, f.noise, f.L, w, batch)
        if f.gains.after_s[lane] < math.inf:
            _store_covariances(step, f.gains, readings, state, batch)
    else:
        _reuse_covariances(step, f.gains, state, batch)
    z, transition = f.z, f.transition
    for i in range(n):
        z[i] = B[(HEAD_ROWS + i * NODE_ROWS + T) * LANES + lane]
        for j in range(m):
            state.S[lane, i, j] = w.end[i, 1 + j]
    z[n] = decay * state.d[lane]
    for j in range(m):
        state.S[lane, n, j] *= decay
    if keep:
        # F column by column; that of d is Gamma, the last one of the first pass.
        transition[:, :] = 0.0
        for i in range(n):
            for j in range(n + 1):
                transition[i, j] = w.end[i, 1 + m + rank + j]
        transition[n, n] = decay
    take_readings(step, readings, state, batch, z, transition, history, out)
    if keep:
        history.mean[lane, k, : n + 1] = z[: n + 1]
        _copy_matrix(state.P[lane], history.covariance[lane, k])
        _copy_matrix(transition, history.transition[lane, k - 1])
    _put_back(B, lane, n, k, state, z)
    return first + count


@njit
def _put_back(B: FloatArray, lane: int, n: int, k: int, state: State, z: FloatArray) -> None:
    """Set the temperatures of a lane; where one is too cold or not finite, mark the lane as diverged instead."""
    for i in range(n + 1):
        if not (math.isfinite(z[i]) and (i == n or z[i] > COLDEST_K)):
            state.diverged[lane] = k
            return
    for i in range(n):
        B[(HEAD_ROWS + i * NODE_ROWS + T) * LANES + lane] = z[i]


@njit
def disturb(B: FloatArray, X: Blocks, perturbed: PerturbedGroups, lane: int, change: float) -> None:
    """Add to the heating ratio (ratio.d0) of a lane and of all its perturbed lanes.

    B, X    : block of the lane group and blocks of the perturbed lanes, changed
    perturbed : groups of perturbed lanes and the lane that each belongs to
    change  : of the ratio [-]

    The perturbed lanes need it as well, since derivatives are those at the disturbed ratio. Source:
    docs/theory/filter.md, equation 1.
    """
    B[PARAMETERS * LANES + lane * N_PARAMETERS + D0] += change
    for s in range(len(perturbed.source)):
        if perturbed.source[s] == lane:
            at = perturbed.groups[s // LANES, 0] + PARAMETERS * LANES + (s % LANES) * N_PARAMETERS + D0
            X.start[at] += change
            X.middle[at] += change
            X.end[at] += change


@njit
def _lag_before(X: Blocks, groups: IntArray, first: bool) -> None:
    """Give the perturbed lanes at the start of a step the memory of lag and hysteresis of the step before it."""
    for g in range(len(groups)):
        for s in range(groups[g, 0], groups[g, 0] + LANES):
            X.start[s + LAG_PAST * LANES] = 0.0 if first else 1.0
            for row in (LAG_VALUE, LAG_INPUT, PAST_ONSET):
                X.start[s + row * LANES] = X.end[s + row * LANES]


@njit
def _lag_now(X: Blocks, groups: IntArray, first: bool) -> None:
    """Give the perturbed lanes at the middle stage and the end this step's memory of lag and hysteresis."""
    for g in range(len(groups)):
        for s in range(groups[g, 0], groups[g, 0] + LANES):
            for row in (LAG_VALUE, LAG_INPUT, PAST_ONSET):
                now = s + (row + 2) * LANES
                if first:
                    X.end[now] = X.start[now]
                X.middle[now] = X.end[now]
                X.end[s + row * LANES] = X.end[now]
            X.end[s + LAG_PAST * LANES] = 1.0


@njit
def begin_march(group: LaneGroup, flights: Flights) -> None:
    """Set the first conditions of all lanes and evaluate heat contents [J/m2] and net heat [W/m2] of the nodes.

    group : the lane group, whose block changes;  flights : conditions of its lanes

    Source: docs/theory/equations_march.md, section 1.
    """
    set_flight_conditions(group.B, flights, 0)
    b, j, t = pointer(group.B), pointer(group.J), pointer(group.table)
    call_step(group.advance, b, j, t, group.dispatcher, EVALUATE_START)


@njit
def step_with_perturbed(
    group: LaneGroup,
    X: Blocks,
    perturbed: PerturbedGroups,
    offsets: PerturbedOffsets,
    flights: Flights,
    lanes: int,
    k: int,
    first: bool,
) -> None:
    """March step k of a lane group from updated temperatures and ratios, and assemble its perturbed lanes.

    group              : the nominal lanes, whose block changes
    X                  : blocks of the perturbed lanes, assembled at start, middle stage and end
    perturbed, offsets : groups of the perturbed lanes, and where those of each nominal lane are
    flights            : steps [s] and conditions
    lanes              : number of lanes that are filtered
    first              : whether it is the first step of the march, before which lag and hysteresis have no memory

    An update changes the temperatures, so that the net heat that the last step left does not hold: it is evaluated
    again, from the perturbed lanes at the start. Derived in docs/theory/equations_march.md, equations 6 and 7.
    """
    B, dt = group.B, flights.time_s[k] - flights.time_s[k - 1]
    b, j, t = pointer(B), pointer(group.J), pointer(group.table)
    _lag_before(X, perturbed.groups, first)
    # With 1 s for the time step the residual is heat content minus net heat, which gives the net heat.
    assemble_perturbed(group, X.start, perturbed, T, 2, 1.0)
    _lag_now(X, perturbed.groups, first)
    # Only lanes that are filtered: the padding has no perturbed lanes to start from.
    for lane in range(lanes):
        start_from_copy(B, lane, X.start, offsets.at[lane], offsets.nodes[lane])
    shift_conditions(b)
    set_flight_conditions(B, flights, k)
    call_step(group.advance, b, j, t, group.dispatcher, dt)
    ddt = STAGE_WEIGHT * dt
    assemble_perturbed(group, X.middle, perturbed, T_STAGE, 1, ddt)
    assemble_perturbed(group, X.end, perturbed, T, 2, ddt)


@njit
def filter_steps(
    group: LaneGroup,
    X: Blocks,
    perturbed: PerturbedGroups,
    offsets: PerturbedOffsets,
    flights: Flights,
    first: bool,
    f: FilterArrays,
    out: FloatArray,
) -> None:
    """Filter the lanes of one group through some steps of a flight, from the state that earlier ones have left.

    group                 : the nominal lanes, begun (`begin_march`) or marched up to the first of the times
    X, perturbed, offsets : blocks of the perturbed lanes, their groups, and where those of each nominal lane are
    flights               : ends of the steps, the present time first, and conditions
    first                 : whether the first of these steps is that of the march
    f                     : readings of these steps, filter state, process noise, frozen gains, history, work space
    out                   : (lane, reading, N_OUT + parameter) temperatures [K], variances [K2], innovations, log
                            likelihood, sensitivities; filled

    A lane that diverges is no longer filtered; the others go on. Derived in docs/theory/filter.md, equations 1 to 14.
    """
    state = f.state
    lanes = state.P.shape[0]
    next_reading = np.zeros(lanes, dtype=np.int64)
    for k in range(1, len(flights.time_s)):
        step_with_perturbed(group, X, perturbed, offsets, flights, lanes, k, first and k == 1)
        for lane in range(lanes):
            if state.diverged[lane] == 0:
                next_reading[lane] = filter_lane(
                    group.B, X, offsets, flights.time_s, lane, k, next_reading[lane], f, out[lane]
                )
                n = offsets.nodes[lane]
                # Only now: the disturbance is constant over a step, and the readings of step k act from k + 1 on.
                disturb(group.B, X, perturbed, lane, f.z[n] - state.d[lane])
                state.d[lane] = f.z[n]
