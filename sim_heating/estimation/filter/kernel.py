"""Extended Kalman filter on the node temperatures of lanes that march together; compiled.

The state of a lane is z = (T_0 .. T_(n-1), d): its node temperatures and a disturbance d of the heating ratio that
holds for one step, additive like ratio.d0. With Phi the derivative of the step (thermal/sensitivity.py) and Gamma that
against d,

    z' = F z + w,    F = [Phi, Gamma; 0, decay],    P' = F P F' + Q,

where F is never formed: its products are columns propagated with the matrix of the step, M = F P, then F M'. A
reading at the fraction x of a step is y = gain T(x) + bias + noise, T(x) the parabola through start, middle stage
and end plus the part x of the step's white noise, so that with R its row against z

    cov(z, T) = P R',    cov(z', T) = F P R' + Q_x,    cov(T_i, T_j) = R_i P R_j' + Q_x,

and all readings of a step are taken one by one from the joint covariance of z' and themselves, without a second march.
A reading of which an interval is known matches the moments of the truncated normal (Curry, Estimation and Control with
Quantized Measurements, MIT Press 1970), which is a linear reading of variance S / (1 - v), v what is left of S.

Sensitivities of the state go through an update as S+ = S - K dy/dp: the gain's own derivative is left out. After a time
the covariances may be held: as long as readings lie where they did in the step before, its gains are taken again.
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
    N_CONDITIONS,
    N_PARAMETERS,
    NODE_ROWS,
    PARAMETERS,
    T_STAGE,
    T_START,
    T,
)
from sim_heating.base.kernels.jit import call_step, njit, raw
from sim_heating.base.kernels.truncated_normal import LOG_ROOT_2PI, truncated_normal
from sim_heating.estimation.filter.arrays import Blocks, Columns, Held, Joint, Kept, Noise, Readings, State
from sim_heating.march.frames import END_STAGE
from sim_heating.thermal.sensitivity import (
    Groups,
    Places,
    assemble_shadows,
    begin_columns,
    content_columns,
    first_star,
    parabola,
    parabola_rate,
    second_star,
    solve_columns,
    start_from_shadow,
)
from sim_heating.thermal.step import BEGIN, COLDEST_K, STAGE_WEIGHT, hold

(
    PRIOR, PRIOR_VARIANCE, POSTERIOR, POSTERIOR_VARIANCE, PREDICTED, PREDICTED_VARIANCE, INNOVATION, VARIANCE,
    LOG_LIKELIHOOD, N_OUT,
) = range(10)  # fmt: skip
"""What is told of a reading: temperature before and after all readings of its time; what it should show, noise
included, once those before it are taken; innovation and its variance; the sensitivities of its prediction follow."""
CONSTANT, PER_TEMPERATURE, PER_RATE = range(3)
"""What a parameter adds to the reading itself."""
SAME_PLACE = 1e-6
"""Readings this part of a step apart are at the same place in it."""
LEAST_GAIN = 1e-14
"""A reading that takes less of its own variance away tells nothing."""


@njit
def propagate(X: Blocks, p: Places, lane: int, forced: int, dt: float, w: Columns) -> None:
    """Take w.end from the start of a step to its end; its first `forced` columns have their parameters as forcing."""
    ddt = STAGE_WEIGHT * dt
    begin_columns(X.start, p, lane, forced, w.end, w.e, w.f)
    first_star(w.e, w.f, dt, w.star)
    solve_columns(X.middle, p, lane, forced, ddt, w.star, w.middle, w.reduced)
    content_columns(X.middle, p, lane, forced, w.middle, w.e_middle)
    second_star(w.e, w.e_middle, w.star)
    solve_columns(X.end, p, lane, forced, ddt, w.star, w.end, w.reduced)


@njit
def _add_forcing(gamma: Columns, w: Columns, column: int, amount: float, n: int) -> None:
    """Add the answer to a disturbance of so much to a column; gamma.end[:, 0] is that to 1."""
    for i in range(n):
        w.end[i, column] += gamma.end[i, 0] * amount
        w.middle[i, column] += gamma.middle[i, 0] * amount


@njit
def first_pass(X: Blocks, p: Places, lane: int, dt: float, state: State, whole: bool, keep: bool, w: Columns) -> None:
    """Columns of Gamma and sensitivities, on the whole those of F P as well and, where they are kept, of F itself."""
    n, m = p.nodes[lane], state.S.shape[2]
    first, identity, covariances = 1 + m, 1 + m + state.P.shape[1], n + 1 if whole else 0
    w.end[:, :] = 0.0
    for i in range(n):
        for k in range(m):
            w.end[i, 1 + k] = state.S[lane, i, k]
        for j in range(covariances):
            w.end[i, first + j] = state.P[lane, i, j]
        if keep:
            w.end[i, identity + i] = 1.0
    propagate(X, p, lane, 1 + m, dt, w)
    for k in range(m):
        _add_forcing(w, w, 1 + k, state.S[lane, n, k], n)
    for j in range(covariances):
        _add_forcing(w, w, first + j, state.P[lane, n, j], n)
    if keep:
        _add_forcing(w, w, identity + n, 1.0, n)


@njit
def read_column(w: Columns, column: int, node: int, x: float, start: float) -> float:
    """A column at a node and a fraction of the step, `start` being what it was there at the start."""
    w0, w1, w2 = parabola(x)
    return w0 * start + w1 * w.middle[node, column] + w2 * w.end[node, column]


@njit
def predict_readings(
    B: FloatArray, p: Places, lane: int, dt: float, r: Readings, first: int, count: int, state: State, whole: bool,
    keep: bool, w: Columns, joint: Joint,
) -> None:  # fmt: skip
    """Temperatures, sensitivities and rows of the readings of a step, and cov(z at its start, T)."""
    n, m = p.nodes[lane], state.S.shape[2]
    identity, covariances = 1 + m + state.P.shape[1], n + 1 if whole else 0
    for q in range(count):
        node, x = r.node[lane, first + q], joint.x[q]
        a = (HEAD_ROWS + node * NODE_ROWS) * LANES + lane
        T0, T1, T2 = B[a + T_START * LANES], B[a + T_STAGE * LANES], B[a + T * LANES]
        w0, w1, w2 = parabola(x)
        joint.mean[q] = w0 * T0 + w1 * T1 + w2 * T2
        w0, w1, w2 = parabola_rate(x, dt)
        joint.rate[q] = w0 * T0 + w1 * T1 + w2 * T2
        for k in range(m):
            joint.S[q, k] = read_column(w, 1 + k, node, x, state.S[lane, node, k])
        for j in range(covariances):
            joint.start[q, j] = read_column(w, 1 + m + j, node, x, state.P[lane, node, j])
            if keep:
                joint.rows[q, j] = read_column(w, identity + j, node, x, 1.0 if j == node else 0.0)


@njit
def second_pass(
    X: Blocks, p: Places, lane: int, dt: float, r: Readings, first: int, count: int, state: State, noise: Noise,
    decay: float, gamma: Columns, w: Columns, joint: Joint,
) -> None:  # fmt: skip
    """F (F P)' + Q, and the covariances of the readings with z at the end and with each other."""
    n, m, size = p.nodes[lane], state.S.shape[2], state.P.shape[1]
    w.end[:, :] = 0.0
    for i in range(n):
        for j in range(n):
            w.end[i, j] = gamma.end[j, 1 + m + i]
        w.end[i, n] = decay * state.P[lane, n, i]
        for q in range(count):
            w.end[i, size + q] = joint.start[q, i]
    propagate(X, p, lane, 0, dt, w)
    for j in range(n):
        _add_forcing(gamma, w, j, gamma.end[j, 1 + m + n], n)
    _add_forcing(gamma, w, n, decay * state.P[lane, n, n], n)
    for q in range(count):
        _add_forcing(gamma, w, size + q, joint.start[q, n], n)
    for q in range(count):
        node, x = r.node[lane, first + q], joint.x[q]
        for i in range(n):
            joint.cross[q, i] = w.end[i, size + q]
        joint.cross[q, n] = decay * joint.start[q, n]
        joint.cross[q, node] += x * dt * noise.nodes[lane, node]
        for s in range(count):
            covariance = read_column(w, size + s, node, x, joint.start[s, node])
            if r.node[lane, first + s] == node:
                covariance += min(x, joint.x[s]) * dt * noise.nodes[lane, node]
            joint.covariance[q, s] = covariance
    for i in range(n):
        for j in range(i + 1):
            state.P[lane, i, j] = 0.5 * (w.end[i, j] + w.end[j, i])
            state.P[lane, j, i] = state.P[lane, i, j]
        state.P[lane, i, i] += noise.nodes[lane, i] * dt
        state.P[lane, i, n] = state.P[lane, n, i] = w.end[i, n]
    state.P[lane, n, n] = decay * decay * state.P[lane, n, n] + noise.density_1_s[lane] * _span(
        noise.decay_1_s[lane], dt
    )


@njit
def _span(decay_1_s: float, dt: float) -> float:
    """Integral of exp(-2 decay t) over a step [s]."""
    return dt if decay_1_s == 0.0 else -math.expm1(-2.0 * decay_1_s * dt) / (2.0 * decay_1_s)


@njit
def innovation(lower: float, upper: float, mean: float, variance: float) -> tuple[float, float, float]:
    """Innovation, its variance and log likelihood of a reading whose prediction is N(mean, variance); of an interval,
    those of the unrounded reading that would move mean and variance as it does."""
    spread = math.sqrt(variance)
    if not lower < upper:
        z = (lower - mean) / spread
        return lower - mean, variance, -0.5 * z * z - LOG_ROOT_2PI - math.log(spread)
    log_z, x, _, gain, _, _, _ = truncated_normal(
        (lower - mean) / spread, (upper - mean) / spread, (upper - lower) / spread
    )
    if gain < LEAST_GAIN:
        return 0.0, math.inf, log_z
    return x * spread / gain, variance / gain, log_z


@njit
def _take(
    r: Readings, lane: int, k: int, q: int, count: int, n: int, state: State, z: FloatArray, joint: Joint,
    transition: FloatArray, keep: bool, out: FloatArray,
) -> None:  # fmt: skip
    """Take reading k, number q of its step: z, P and the readings of the step are conditioned on it."""
    gain, m = r.gain[lane, k], state.S.shape[2]
    predicted = out[N_OUT:]
    for j in range(m):
        direct = r.direct[lane, k, j]
        predicted[j] = gain * joint.S[q, j] + direct[CONSTANT]
        predicted[j] += direct[PER_TEMPERATURE] * joint.mean[q] + direct[PER_RATE] * joint.rate[q]
    out[PREDICTED] = gain * joint.mean[q] + r.bias[lane, k]
    out[PREDICTED_VARIANCE] = gain * gain * joint.covariance[q, q] + r.variance[lane, k]
    if not r.lower[lane, k] <= r.upper[lane, k]:
        return
    nu, variance, out[LOG_LIKELIHOOD] = innovation(
        r.lower[lane, k], r.upper[lane, k], out[PREDICTED], out[PREDICTED_VARIANCE]
    )  # fmt: skip
    out[INNOVATION], out[VARIANCE] = nu, variance
    cross, own = joint.cross[q].copy(), joint.covariance[q].copy()
    own_row, inverse = joint.rows[q].copy(), 1.0 / variance
    for i in range(n + 1):
        share = gain * cross[i] * inverse
        z[i] += share * nu
        for j in range(n + 1):
            state.P[lane, i, j] -= (gain * cross[i]) * (gain * cross[j]) * inverse
        for j in range(m):
            state.S[lane, i, j] -= share * predicted[j]
        if keep:
            for j in range(n + 1):
                transition[i, j] -= share * (gain * own_row[j])
    for s in range(count):
        share = gain * own[s] * inverse
        joint.mean[s] += share * nu
        for t in range(count):
            joint.covariance[s, t] -= (gain * own[s]) * (gain * own[t]) * inverse
        for i in range(n + 1):
            joint.cross[s, i] -= share * (gain * cross[i])
            joint.rows[s, i] -= share * (gain * own_row[i])
        for j in range(m):
            joint.S[s, j] -= share * predicted[j]


@njit
def take_readings(
    r: Readings, lane: int, first: int, count: int, n: int, state: State, z: FloatArray, joint: Joint,
    transition: FloatArray, kept: Kept, keep: bool, out: FloatArray,
) -> None:  # fmt: skip
    """Take the readings of a step in order of time; what is told of each goes to its row of `out`."""
    begun = 0
    for q in range(count):
        k = first + q
        if r.time_s[lane, k] != r.time_s[lane, first + begun]:
            begun = q
        if begun == q:
            last = q
            while last + 1 < count and r.time_s[lane, first + last + 1] == r.time_s[lane, k]:
                last += 1
            for s in range(q, last + 1):
                out[first + s, PRIOR], out[first + s, PRIOR_VARIANCE] = joint.mean[s], joint.covariance[s, s]
        if keep:
            for j in range(n + 1):
                kept.rows[lane, k, j] = r.gain[lane, k] * joint.rows[q, j]
        _take(r, lane, k, q, count, n, state, z, joint, transition, keep, out[k])
        for s in range(begun, q + 1):
            out[first + s, POSTERIOR], out[first + s, POSTERIOR_VARIANCE] = joint.mean[s], joint.covariance[s, s]


@njit
def _repeats(held: Held, r: Readings, lane: int, first: int, count: int, joint: Joint) -> bool:
    """Whether the readings of a step are at the places of those whose covariances are held."""
    if held.number[lane] != count:
        return False
    for q in range(count):
        if held.node[lane, q] != r.node[lane, first + q] or abs(held.x[lane, q] - joint.x[q]) > SAME_PLACE:
            return False
    return True


@njit
def _remember(held: Held, r: Readings, lane: int, first: int, count: int, state: State, joint: Joint) -> None:
    """Hold the covariances of a step."""
    held.number[lane], held.P[lane] = count, state.P[lane]
    for q in range(count):
        held.node[lane, q], held.x[lane, q] = r.node[lane, first + q], joint.x[q]
        held.cross[lane, q] = joint.cross[q]
        held.covariance[lane, q] = joint.covariance[q]


@njit
def _recall(held: Held, lane: int, count: int, state: State, joint: Joint) -> None:
    """Take the covariances held for those of this step."""
    state.P[lane] = held.P[lane]
    for q in range(count):
        joint.cross[q] = held.cross[lane, q]
        joint.covariance[q] = held.covariance[lane, q]


@njit
def filter_lane(
    B: FloatArray, X: Blocks, p: Places, lane: int, k: int, time_s: FloatArray, r: Readings, first: int,
    state: State, noise: Noise, held: Held, kept: Kept, u: Columns, w: Columns, v: Columns, joint: Joint,
    z: FloatArray, transition: FloatArray, out: FloatArray,
) -> int:  # fmt: skip
    """Covariance, sensitivities and readings of step k of one lane, whose temperatures have been marched; gives the
    number of the next reading."""
    n, m, size = p.nodes[lane], state.S.shape[2], state.P.shape[1]
    keep = kept.mean.shape[1] > 0
    dt = time_s[k] - time_s[k - 1]
    decay = math.exp(-noise.decay_1_s[lane] * dt)
    count = 0
    while first + count < r.number[lane] and r.time_s[lane, first + count] <= time_s[k]:
        joint.x[count] = (r.time_s[lane, first + count] - time_s[k - 1]) / dt
        count += 1
    whole = time_s[k] <= held.after_s[lane] or not _repeats(held, r, lane, first, count, joint)
    c = w if whole else u
    first_pass(X, p, lane, dt, state, whole, keep, c)
    predict_readings(B, p, lane, dt, r, first, count, state, whole, keep, c, joint)
    if whole:
        second_pass(X, p, lane, dt, r, first, count, state, noise, decay, w, v, joint)
        _remember(held, r, lane, first, count, state, joint)
    else:
        _recall(held, lane, count, state, joint)
    for i in range(n):
        z[i] = B[(HEAD_ROWS + i * NODE_ROWS + T) * LANES + lane]
        for j in range(m):
            state.S[lane, i, j] = c.end[i, 1 + j]
    z[n] = decay * state.d[lane]
    for j in range(m):
        state.S[lane, n, j] *= decay
    if keep:
        transition[:, :] = 0.0
        for i in range(n):
            for j in range(n + 1):
                transition[i, j] = w.end[i, 1 + m + size + j]
        transition[n, n] = decay
    take_readings(r, lane, first, count, n, state, z, joint, transition, kept, keep, out)
    if keep:
        kept.mean[lane, k, : n + 1] = z[: n + 1]
        kept.covariance[lane, k] = state.P[lane]
        kept.transition[lane, k - 1] = transition
    _put_back(B, lane, n, k, state, z)
    return first + count


@njit
def _put_back(B: FloatArray, lane: int, n: int, k: int, state: State, z: FloatArray) -> None:
    """Set the temperatures of a lane, unless one of them is none: the lane has diverged."""
    for i in range(n + 1):
        if not (math.isfinite(z[i]) and (i == n or z[i] > COLDEST_K)):
            state.diverged[lane] = k
            return
    for i in range(n):
        B[(HEAD_ROWS + i * NODE_ROWS + T) * LANES + lane] = z[i]


@njit
def disturb(B: FloatArray, X: Blocks, shadows: Groups, lane: int, change: float) -> None:
    """Add to ratio.d0 of a lane and of all its shadows."""
    B[PARAMETERS * LANES + lane * N_PARAMETERS + D0] += change
    for s in range(len(shadows.source)):
        if shadows.source[s] == lane:
            at = shadows.groups[s // LANES, 0] + PARAMETERS * LANES + (s % LANES) * N_PARAMETERS + D0
            X.start[at] += change
            X.middle[at] += change
            X.end[at] += change


@njit
def _lag_before(X: Blocks, groups: IntArray, first: bool) -> None:
    """A ratio that lags, as the shadows at the start have to remember it: from the start of the step before."""
    for g in range(len(groups)):
        for s in range(groups[g, 0], groups[g, 0] + LANES):
            X.start[s + LAG_PAST * LANES] = 0.0 if first else 1.0
            X.start[s + LAG_VALUE * LANES] = X.end[s + LAG_VALUE * LANES]
            X.start[s + LAG_INPUT * LANES] = X.end[s + LAG_INPUT * LANES]


@njit
def _lag_now(X: Blocks, groups: IntArray, first: bool) -> None:
    """And as those at the middle stage and the end have to: from the start of this step."""
    for g in range(len(groups)):
        for s in range(groups[g, 0], groups[g, 0] + LANES):
            for row in (LAG_VALUE, LAG_INPUT):
                now = s + (row + 2) * LANES
                if first:
                    X.end[now] = X.start[now]
                X.middle[now] = X.end[now]
                X.end[s + row * LANES] = X.end[now]
            X.end[s + LAG_PAST * LANES] = 1.0


@njit
def begin_march(
    B: FloatArray, J: IntArray, table: FloatArray, chain, move,  # type: ignore[no-untyped-def]
    histories: FloatArray, which: IntArray,
) -> None:  # fmt: skip
    """The first conditions of all lanes of a group."""
    for lane in range(LANES):
        for c in range(N_CONDITIONS):
            B[END_STAGE + lane * N_CONDITIONS + c] = histories[which[lane], 0, c]
    call_step(move, raw(B), raw(J), raw(table), chain, BEGIN)


@njit
def step_beside_shadows(
    B: FloatArray, J: IntArray, table: FloatArray, chain, move, rows, faces,  # type: ignore[no-untyped-def]
    X: Blocks, shadows: Groups,
    time_s: FloatArray, histories: FloatArray, which: IntArray, p: Places, lanes: int, k: int,
) -> None:  # fmt: skip
    """Step k of a group from temperatures and ratios that may have been changed, its shadows assembled at the start,
    the middle stage and the end."""
    dt = time_s[k] - time_s[k - 1]
    _lag_before(X, shadows.groups, k == 1)
    assemble_shadows(B, X.start, shadows, table, chain, rows, faces, T, 2, 1.0)
    _lag_now(X, shadows.groups, k == 1)
    for lane in range(lanes):
        start_from_shadow(B, lane, X.start, p.at[lane], p.nodes[lane])
    hold(raw(B))
    for lane in range(LANES):
        for c in range(N_CONDITIONS):
            B[END_STAGE + lane * N_CONDITIONS + c] = histories[which[lane], k, c]
    call_step(move, raw(B), raw(J), raw(table), chain, dt)
    ddt = STAGE_WEIGHT * dt
    assemble_shadows(B, X.middle, shadows, table, chain, rows, faces, T_STAGE, 1, ddt)
    assemble_shadows(B, X.end, shadows, table, chain, rows, faces, T, 2, ddt)


@njit
def march_filter(
    B: FloatArray, J: IntArray, table: FloatArray, chain, move, rows, faces,  # type: ignore[no-untyped-def]
    X: Blocks, shadows: Groups, time_s: FloatArray, histories: FloatArray, which: IntArray,
    p: Places, r: Readings, state: State, noise: Noise, held: Held, kept: Kept,
    u: Columns, w: Columns, v: Columns, joint: Joint, out: FloatArray,
) -> None:  # fmt: skip
    """Filter the lanes of one group; blocks B and X are changed and lost, arrays as FilterMarch makes them.

    out : (lane, reading, N_OUT + parameter)
    """
    lanes, size = state.P.shape[0], state.P.shape[1]
    z, transition = np.zeros(size), np.zeros((size, size))
    next_reading = np.zeros(lanes, dtype=np.int64)
    begin_march(B, J, table, chain, move, histories, which)
    for k in range(1, len(time_s)):
        step_beside_shadows(B, J, table, chain, move, rows, faces, X, shadows, time_s, histories, which, p, lanes, k)
        for lane in range(lanes):
            if state.diverged[lane] == 0:
                next_reading[lane] = filter_lane(
                    B, X, p, lane, k, time_s, r, next_reading[lane], state, noise, held, kept, u, w, v,
                    joint, z, transition, out[lane],
                )  # fmt: skip
                n = p.nodes[lane]
                disturb(B, X, shadows, lane, z[n] - state.d[lane])
                state.d[lane] = z[n]
