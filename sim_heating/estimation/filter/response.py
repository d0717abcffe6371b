"""A point marched with a history added to its heating ratio, and the response of its readings to that history.

With d_k the addition in step k (like ratio.d0, constant over the step) and F = [Phi, Gamma] the derivative of the
step against its start and d_k,

    dT_(k+1) = Phi_k dT_k + Gamma_k d_k,    d(reading) = gain (row . [dT_k, d_k]),

row that of a reading within step k. Phi, Gamma and rows come from the factorised step itself, about the temperatures
that the added history makes. Derived in docs/theory/residual_heating.md, equations 1 and 2.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sim_heating.base.arrays import FloatArray, IntArray
from sim_heating.base.errors import RunError
from sim_heating.base.kernels.block import HEAD_ROWS, LANES, NODE_ROWS, T_STAGE, T_START, T
from sim_heating.base.kernels.jit import njit
from sim_heating.estimation.filter.arrays import Blocks, LaneStep, MarchOutput, Readings, State, Workspace, workspace
from sim_heating.estimation.filter.kernel import begin_march, disturb, first_pass, read_column, step_with_perturbed
from sim_heating.estimation.filter.march import FilterMarch, FilterTrack
from sim_heating.march.frames import Flights
from sim_heating.thermal.sensitivity import PerturbedGroups, PerturbedOffsets, parabola
from sim_heating.thermal.step import LaneGroup


@dataclass(frozen=True, eq=False)
class Response:
    """March of a point with a history added to its ratio.

    temperature_K : (time, node) at the ends of the steps, the start first [K]
    read_K        : (reading,) expected readings [K]
    transition    : (step, node, node + 1) [Phi, Gamma], [-] and [K]
    rows          : (reading, node + 1) derivative of each reading against the temperatures at the start of its step [-]
                    and d in it [K]
    step          : (reading,) number of the step
    """

    temperature_K: FloatArray
    read_K: FloatArray
    transition: FloatArray
    rows: FloatArray
    step: IntArray

    def matrix(self, weights: FloatArray, start: FloatArray | None = None) -> FloatArray:
        """Derivative of the readings against the start and the knots of the added history, all in one pass.

            dT_(k+1) = Phi_k dT_k + Gamma_k d_k,    dy = gain R (dT_k, d_k)

        weights : (step, knot) addition in each step for one unit at a knot [-], causal: its columns in order of time
        start   : (node, k) temperatures at the start for one unit of k more unknowns [K], or None
        returns : (reading, start | knot) dy/du [K]

        Columns of knots that lie ahead of a step are skipped. Derived in docs/theory/residual_heating.md, equations 1
        to 3.
        """
        nodes, extra = self.transition.shape[1], 0 if start is None else start.shape[1]
        columns = np.concatenate([np.zeros((len(weights), extra)), weights], axis=1)
        # Number of columns up to the last that acts in a step; those behind are 0 up to then and need no product.
        reached = columns.shape[1] - np.argmax(columns[:, ::-1] != 0.0, axis=1)
        # The last row of the state is d in the present step, so that [Phi, Gamma] is one product.
        state, answer = np.zeros((nodes + 1, columns.shape[1])), np.zeros((len(self.step), columns.shape[1]))
        if start is not None:
            state[:nodes, :extra] = start
        bounds = np.searchsorted(self.step, np.arange(len(weights) + 1))
        for k, (F, a) in enumerate(zip(self.transition, np.maximum.accumulate(reached), strict=True)):
            state[nodes, :a] = columns[k, :a]
            answer[bounds[k] : bounds[k + 1], :a] = self.rows[bounds[k] : bounds[k + 1]] @ state[:, :a]
            state[:nodes, :a] = F @ state[:, :a]
        return answer


class ResponseMarch(FilterMarch):
    """Up to LANES points on common times, each marched with a history of its own added to its ratio.

    points    : of their readings only times, nodes, gains and biases count
    time_s    : (time,) steps [s];  histories : (flight, time, condition)
    """

    def __init__(self, points: Sequence[FilterTrack], time_s: FloatArray, histories: FloatArray) -> None:
        super().__init__(points, time_s, histories)
        self._steps = [np.searchsorted(self.time_s[1:], p.samples.time_s) for p in self.points]

    def respond(
        self,
        added: Sequence[FloatArray],
        initial_K: Sequence[FloatArray | None] | None = None,
        *,
        derivative: bool = True,
    ) -> list[Response]:
        """March all points with histories added to their heating ratios.

        added      : (step,) of each point, addition to its ratio [-]
        initial_K  : (node,) of each point, temperatures at the start [K] in place of its own
        derivative : whether transition and rows are wanted; without them they are empty
        returns    : temperatures [K], expected readings [K] and derivatives of each point
        raises     : RunError where a step did not converge or a temperature is not a number

        Derived in docs/theory/residual_heating.md, equations 1 and 2.
        """
        n, lanes = int(self._nodes.max()), len(self.points)
        readings = self._readings(self.points, 0)
        count, steps = readings.time_s.shape[1], len(self.time_s) - 1
        add = np.zeros((lanes, steps))
        for i in range(lanes):
            add[self._lane_of[i]] = added[i]
        self._begin([p.initial_K for p in self.points] if initial_K is None else list(initial_K))
        columns = n + 1 if derivative else 0
        output = MarchOutput(
            np.zeros((lanes, steps + 1, n)),
            np.full((lanes, count), np.nan),
            np.zeros((lanes, steps, n, columns)),
            np.zeros((lanes, count, columns)),
        )
        group, X = self._copies()
        march_response(
            group, X, self._groups, self._offsets(1), self._flights, readings, add, workspace(n, n + 2), output
        )
        self._take_over(group.B)
        self.nominal.check()
        return [self._response(i, output, self._steps[i]) for i in range(lanes)]

    def _response(self, i: int, output: MarchOutput, step: IntArray) -> Response:
        point, lane = self.points[i], self._lane_of[i]
        nodes, s = point.mesh.nodes, point.samples
        z = slice(nodes + 1)
        response = Response(
            output.temperature_K[lane, :, :nodes],
            s.gain * output.read_K[lane, : len(step)] + s.bias_K,
            output.transition[lane, :, :nodes, z],
            s.gain[:, np.newaxis] * output.rows[lane, : len(step), z],
            step,
        )
        if not np.all(np.isfinite(response.read_K)):
            raise RunError(
                f"{point.model.name}: a filtered temperature is not a number; "
                "declare a larger noise_sigma_K, or start from values nearer to the declared ones"
            )
        return response


@njit
def march_response(
    group: LaneGroup,
    X: Blocks,
    perturbed: PerturbedGroups,
    offsets: PerturbedOffsets,
    flights: Flights,
    readings: Readings,
    added: FloatArray,
    w: Workspace,
    output: MarchOutput,
) -> None:
    """March one lane group with histories added to the heating ratios; the contents of blocks B and X are lost.

    group                 : the nominal lanes
    X, perturbed, offsets : blocks of the perturbed lanes, their groups, and where those of each nominal lane are
    flights               : steps of the march and conditions
    readings              : of all lanes;  added : (lane, step) addition to the ratio [-];  w : work space
    output                : receives temperatures [K], readings [K] and derivatives

    Derived in docs/theory/residual_heating.md, equations 1 and 2.
    """
    B, time_s, lanes = group.B, flights.time_s, added.shape[0]
    # A filter state without covariance and sensitivities: only Phi and Gamma are propagated.
    state = State(
        np.zeros((lanes, 0, 0)), np.zeros((lanes, w.end.shape[0], 0)), np.zeros(lanes), np.zeros(lanes, dtype=np.int64)
    )
    L, next_reading = np.zeros((0, 0)), np.zeros(lanes, dtype=np.int64)
    for lane in range(lanes):
        _copy_temperatures(B, lane, offsets.nodes[lane], output.temperature_K[lane, 0])
        disturb(B, X, perturbed, lane, added[lane, 0])
    begin_march(group, flights)
    for k in range(1, len(time_s)):
        step_with_perturbed(group, X, perturbed, offsets, flights, lanes, k, k == 1)
        dt = time_s[k] - time_s[k - 1]
        for lane in range(lanes):
            n = offsets.nodes[lane]
            step = LaneStep(lane, n, dt, 1.0, next_reading[lane], 0, 0, True)
            if output.transition.shape[3] > 0:
                first_pass(X, offsets, step, state, L, w)
                output.transition[lane, k - 1, :n, : n + 1] = w.end[:n, 1 : n + 2]
            next_reading[lane] = _read_step(B, w, step, time_s, k, readings, output)
            _copy_temperatures(B, lane, n, output.temperature_K[lane, k])
            # The difference to the step before: `disturb` adds, and no addition acts behind the last step.
            if k < len(time_s) - 1:
                disturb(B, X, perturbed, lane, added[lane, k] - added[lane, k - 1])


@njit
def _copy_temperatures(B: FloatArray, lane: int, n: int, out: FloatArray) -> None:
    """Copy the node temperatures of a lane [K] from its block."""
    for i in range(n):
        out[i] = B[(HEAD_ROWS + i * NODE_ROWS + T) * LANES + lane]


@njit
def _read_step(
    B: FloatArray, w: Workspace, step: LaneStep, time_s: FloatArray, k: int, readings: Readings, output: MarchOutput
) -> int:
    """Temperatures and rows of the readings of step k; returns the number of the next reading."""
    lane, q = step.lane, step.first
    while q < readings.number[lane] and readings.time_s[lane, q] <= time_s[k]:
        x, node = (readings.time_s[lane, q] - time_s[k - 1]) / step.dt, readings.node[lane, q]
        a = (HEAD_ROWS + node * NODE_ROWS) * LANES + lane
        w0, w1, w2 = parabola(x)
        output.read_K[lane, q] = w0 * B[a + T_START * LANES] + w1 * B[a + T_STAGE * LANES] + w2 * B[a + T * LANES]
        for j in range(min(step.nodes + 1, output.rows.shape[2])):
            output.rows[lane, q, j] = read_column(w, 1 + j, node, x, 1.0 if j == node else 0.0)
        q += 1
    return q
