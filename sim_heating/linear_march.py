"""Points marched together with the sensitivity of their temperatures to any of their parameters.

At a sample between two steps temperatures and sensitivities are read from the parabola through the start, the middle
stage and the end of the step, which has the order of the step itself; a skew of clocks is then a continuous parameter.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim_heating.ensemble import Ensemble, PointModel, initial_temperatures
from sim_heating.errors import InputError, RunError
from sim_heating.heating_ratio.table import RatioTable
from sim_heating.jit import call_step, handle, njit, raw
from sim_heating.layout import HEAD_ROWS, LANES, N_CONDITIONS, NODE_ROWS, T_STAGE, T_START, T
from sim_heating.march import END_STAGE
from sim_heating.parameters import CURVED, EFFECT_PREFIX
from sim_heating.thermal.kernel import STAGE_WEIGHT, hold
from sim_heating.thermal.linear import (
    assemble_shadows,
    begin_columns,
    compiled_rows,
    content_columns,
    first_star,
    net_columns,
    parabola,
    parabola_rate,
    second_star,
    solve_columns,
)
from sim_heating.thermal.mesh import Mesh

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

MOVED = 1e-5
"""A parameter that is not affine is moved to either side by this part of its scale: rounding and curvature then cost
nine digits each."""
MOVED_AFFINE = 1e-2
"""And one that is affine, to one side, by this part of it."""


@dataclass(frozen=True)
class Track:
    """One point on its way through a flight.

    model    : the point, `mesh` its mesh
    names    : (m,) dotted names of the parameters whose sensitivities are wanted
    sample_s : (sample,) times [s] at which they are wanted, increasing, within the march
    nodes    : nodes at which they are wanted; those of the sensors where None
    initial_K, initial_columns : (node,) temperatures at the start, and (node, extra) their sensitivities to `extra`
               more parameters, which come after the others; as the stack declares, and none, where None
    flight   : number of the flight
    table_errors : each an array of the shape of the ratio table: the sensitivity to its factor c in ratio + c error
               comes after the named ones
    """

    model: PointModel
    mesh: Mesh
    names: tuple[str, ...]
    sample_s: FloatArray
    nodes: tuple[int, ...] | None = None
    initial_K: FloatArray | None = None
    initial_columns: FloatArray | None = None
    flight: int = 0
    table_errors: tuple[FloatArray, ...] = ()

    @property
    def read_nodes(self) -> tuple[int, ...]:
        """The nodes that are read."""
        return self.mesh.sensors if self.nodes is None else self.nodes

    @property
    def columns(self) -> int:
        """Number of sensitivities."""
        extra = 0 if self.initial_columns is None else self.initial_columns.shape[1]
        return len(self.names) + len(self.table_errors) + extra

    def tables_in_error(self) -> list[RatioTable]:
        """The ratio table with each of its errors added once."""
        table = self.model.ratio
        if table is None:
            return []
        return [replace(table, ratio=table.ratio + error) for error in self.table_errors]


@dataclass(frozen=True)
class Linearised:
    """What a track gave: temperature [K] and its rate [K/s], (node read, sample), and sensitivity (node read, sample,
    parameter) in K over the unit of the parameter."""

    temperature_K: FloatArray
    rate_K_s: FloatArray
    sensitivity: FloatArray


def moved(model: PointModel, name: str) -> tuple[float, bool]:
    """By how much a parameter is moved for its derivative, and whether to both sides."""
    definition, value = model.definition(name), abs(model.value(name))
    known = 0.0 < definition.sigma < np.inf
    scale = definition.sigma if known else max(value, 1.0)
    curved = name in CURVED or name.startswith(EFFECT_PREFIX)
    return (MOVED if curved else MOVED_AFFINE) * scale, curved


@dataclass
class _Shadows:
    """Where the shadows of one track stand: first number of the base's and of each parameter's lane, 1 / difference."""

    base: int
    plus: IntArray = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    minus: IntArray = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    inverse: FloatArray = field(default_factory=lambda: np.zeros(0))


class LinearMarch:
    """Up to LANES tracks on common times, marched and linearised together.

    tracks    : what is marched; parameters are changed with `set_models`, times and names stay
    time_s    : (time,) steps [s] that the march takes; conditions are linear between them
    histories : (flight, time, condition) as ensemble.condition_history gives them
    """

    def __init__(self, tracks: Sequence[Track], time_s: FloatArray, histories: FloatArray) -> None:
        if not 0 < len(tracks) <= LANES:
            raise InputError(f"linear march: {len(tracks)} tracks; 1 to {LANES} go together")
        self.tracks = tuple(tracks)
        self.time_s = np.ascontiguousarray(time_s, dtype=float)
        self.histories = np.ascontiguousarray(histories, dtype=float)
        self.base = Ensemble([t.model for t in self.tracks], [t.mesh for t in self.tracks])
        self._tables = [t.tables_in_error() for t in self.tracks]
        self._moves = [
            [moved(t.model, name) for name in t.names] + [(1.0, False)] * len(tables)
            for t, tables in zip(self.tracks, self._tables, strict=True)
        ]
        self._owner = [i for i, moves in enumerate(self._moves) for _ in range(1 + sum(1 + both for _, both in moves))]
        shadows = [m for i, t in enumerate(self.tracks) for m in self._altered(i, t.model)]
        self.shadows = Ensemble(shadows, [self.tracks[i].mesh for i in self._owner], beside=self.base)
        self.rows = handle(compiled_rows())
        self._place()

    def _altered(self, i: int, model: PointModel) -> list[PointModel]:
        """The base of a track and its shadows."""
        models = [model]
        for name, (by, both) in zip(self.tracks[i].names, self._moves[i], strict=False):
            value = model.value(name)
            models.append(model.altered({name: value + by}))
            if both:
                models.append(model.altered({name: value - by}))
        return models + [replace(model, ratio=table) for table in self._tables[i]]

    def _place(self) -> None:
        """Find out where the shadows stand."""
        first = [p.start + HEAD_ROWS * LANES + p.lane for p in self.shadows.places]
        self._lane_of = np.array([p.lane for p in self.base.places])
        self._places: list[_Shadows] = []
        k = 0
        for track, moves in zip(self.tracks, self._moves, strict=True):
            base, plus, minus, inverse = first[k], [], [], []
            k += 1
            for by, both in moves:
                plus.append(first[k])
                minus.append(first[k + 1] if both else base)
                inverse.append(0.5 / by if both else 1.0 / by)
                k += 2 if both else 1
            extra = track.columns - len(moves)
            self._places.append(
                _Shadows(
                    base,
                    np.array(plus + [base] * extra, dtype=np.int64),
                    np.array(minus + [base] * extra, dtype=np.int64),
                    np.array(inverse + [0.0] * extra),
                )
            )
        self._source = self._lane_of[np.array(self._owner)][self.shadows.lanes].astype(np.int64)
        self._nodes = np.zeros(LANES, dtype=np.int64)
        self._flights = np.zeros(LANES, dtype=np.int64)
        for i, track in enumerate(self.tracks):
            self._nodes[self._lane_of[i]] = track.mesh.nodes
        for lane, i in enumerate(self.base.lanes):
            self._flights[lane] = self.tracks[i].flight

    def set_models(self, models: Sequence[PointModel]) -> None:
        """Give the tracks' points other values of their parameters (PointModel.altered)."""
        k = 0
        for i, model in enumerate(models):
            self.base.set_model(i, model)
            for altered in self._altered(i, model):
                self.shadows.set_model(k, altered)
                k += 1

    def march(
        self, shifts_s: Sequence[float] | None = None, initial_K: Sequence[FloatArray | None] | None = None
    ) -> list[Linearised]:
        """March all tracks from their initial temperatures.

        shifts_s  : what is added to the sample times of each track [s]; nothing by default
        initial_K : temperatures at the start in place of those of each track
        raises   : InputError where a shifted sample lies outside the march, RunError where a step did not converge
        """
        shifts = [0.0] * len(self.tracks) if shifts_s is None else list(shifts_s)
        times = [track.sample_s + shift for track, shift in zip(self.tracks, shifts, strict=True)]
        for track, t in zip(self.tracks, times, strict=True):
            outside = np.count_nonzero((t < self.time_s[0]) | (t > self.time_s[-1]))
            if outside:
                raise InputError(f"{track.model.name}: {outside} samples lie outside the march; leave them out")
        self.base.reset()
        self.shadows.reset()
        for i, profile in enumerate([t.initial_K for t in self.tracks] if initial_K is None else initial_K):
            if profile is not None:
                self.base.set_profile(i, profile)
        m = max(track.columns for track in self.tracks)
        n = int(self._nodes.max())
        count = max(len(track.sample_s) for track in self.tracks)
        reads = max(len(track.read_nodes) for track in self.tracks)
        per_lane = self._per_lane(times, n, m, count, reads)
        out = np.full((LANES, reads, count, 2 + m), np.nan)
        march_linear(  # type: ignore[call-arg]
            self.base.block(0), self.base.integers(0), self.shadows.table, self.base.chain,
            self.base.begin_handle, self.base.advance_handle, self.rows,
            self.shadows.state, self.shadows.ints, self.shadows.groups, self._source, self._nodes,
            self.time_s, self.histories, self._flights, *per_lane, out,
        )  # fmt: skip
        self.base.check()
        return [self._result(i, out) for i in range(len(self.tracks))]

    def _per_lane(self, times: Sequence[FloatArray], n: int, m: int, count: int, reads: int) -> tuple[Any, ...]:
        """Arrays over the lanes; a lane without a track has no samples and no columns."""
        at = np.zeros(LANES, dtype=np.int64)
        plus, minus = np.zeros((2, LANES, m), dtype=np.int64)
        inverse = np.zeros((LANES, m))
        columns, samples, read = (np.zeros(LANES, dtype=np.int64) for _ in range(3))
        start = np.zeros((LANES, n, m))
        sample_s = np.full((LANES, max(count, 1)), np.inf)
        nodes = np.zeros((LANES, max(reads, 1)), dtype=np.int64)
        for i, (track, place) in enumerate(zip(self.tracks, self._places, strict=True)):
            lane, own = self._lane_of[i], track.columns
            at[lane], columns[lane], samples[lane] = place.base, own, len(track.sample_s)
            plus[lane, :own], minus[lane, :own], inverse[lane, :own] = place.plus, place.minus, place.inverse
            plus[lane, own:] = minus[lane, own:] = place.base
            sample_s[lane, : len(track.sample_s)] = times[i]
            read[lane] = len(track.read_nodes)
            nodes[lane, : len(track.read_nodes)] = track.read_nodes
            if track.initial_columns is not None:
                start[lane, : track.mesh.nodes, len(track.names) : own] = track.initial_columns
        return at, plus, minus, inverse, columns, start, sample_s, samples, nodes, read

    def _result(self, i: int, out: FloatArray) -> Linearised:
        track = self.tracks[i]
        own = out[self._lane_of[i], : len(track.read_nodes), : len(track.sample_s), : 2 + track.columns]
        if not np.all(np.isfinite(own)):
            raise RunError(f"{track.model.name}: a temperature or sensitivity is not a number")
        return Linearised(own[..., 0], own[..., 1], own[..., 2:])


def initial_profile(track: Track) -> FloatArray:
    """(node,) temperatures [K] at the start of a track."""
    if track.initial_K is not None:
        return track.initial_K
    return initial_temperatures(track.model.construction, track.mesh)


@njit
def _read_samples(
    B: FloatArray, lane: int, begun_s: float, dt: float, S_start: FloatArray, S_stage: FloatArray, S: FloatArray,
    sample_s: FloatArray, first: int, last: int, nodes: IntArray, read: int, m: int, out: FloatArray,
) -> int:  # fmt: skip
    """Temperatures, rates and sensitivities at the samples of a lane in one step; gives the next sample's number."""
    k = first
    while k < last and sample_s[k] <= begun_s + dt:
        x = (sample_s[k] - begun_s) / dt
        w0, w1, w2 = parabola(x)
        d0, d1, d2 = parabola_rate(x, dt)
        for j in range(read):
            i = nodes[j]
            a = (HEAD_ROWS + i * NODE_ROWS) * LANES + lane
            T0, T1, T2 = B[a + T_START * LANES], B[a + T_STAGE * LANES], B[a + T * LANES]
            out[j, k, 0] = w0 * T0 + w1 * T1 + w2 * T2
            out[j, k, 1] = d0 * T0 + d1 * T1 + d2 * T2
            for q in range(m):
                out[j, k, 2 + q] = w0 * S_start[i, q] + w1 * S_stage[i, q] + w2 * S[i, q]
        k += 1
    return k


@njit
def march_linear(
    B: FloatArray, J: IntArray, table: FloatArray, chain, begin, advance, rows,  # type: ignore[no-untyped-def]
    X: FloatArray, XJ: IntArray, groups: IntArray, source: IntArray, lane_nodes: IntArray,
    time_s: FloatArray, histories: FloatArray, which: IntArray,
    at: IntArray, plus: IntArray, minus: IntArray, inverse: FloatArray, columns: IntArray, start: FloatArray,
    sample_s: FloatArray, samples: IntArray, nodes: IntArray, read: IntArray, out: FloatArray,
) -> None:  # fmt: skip
    """March one group with the sensitivities of its lanes; arrays as LinearMarch makes them.

    start : (LANES, node, m) sensitivities at the start
    out   : (LANES, node read, sample, 2 + m)
    """
    b, j, t = raw(B), raw(J), raw(table)
    n, m = start.shape[1], start.shape[2]
    S, S_stage, S_start = start.copy(), np.zeros((LANES, n, m)), start.copy()
    e, f = np.zeros((LANES, n, m)), np.zeros((LANES, n, m))
    star, middle = np.zeros((LANES, n, m)), np.zeros((LANES, n, m))
    reduced = np.zeros(n)
    next_sample = np.zeros(LANES, dtype=np.int64)
    for lane in range(LANES):
        for c in range(N_CONDITIONS):
            B[END_STAGE + lane * N_CONDITIONS + c] = histories[which[lane], 0, c]
    call_step(begin, b, j, t, chain, 0.0)
    assemble_shadows(B, X, XJ, table, chain, rows, groups, source, lane_nodes, T, 2, 1.0)
    for lane in range(LANES):
        if columns[lane] > 0:
            begin_columns(
                X, at[lane], plus[lane], minus[lane], inverse[lane], lane_nodes[lane], S[lane], e[lane], f[lane]
            )
    for k in range(1, len(time_s)):
        dt = time_s[k] - time_s[k - 1]
        hold(b)
        for lane in range(LANES):
            for c in range(N_CONDITIONS):
                B[END_STAGE + lane * N_CONDITIONS + c] = histories[which[lane], k, c]
        call_step(advance, b, j, t, chain, dt)
        for stage in range(1, 3):
            row = T_STAGE if stage == 1 else T
            assemble_shadows(B, X, XJ, table, chain, rows, groups, source, lane_nodes, row, stage, STAGE_WEIGHT * dt)
            for lane in range(LANES):
                own = lane_nodes[lane]
                if columns[lane] > 0 and stage == 1:
                    S_start[lane] = S[lane]
                    first_star(e[lane], f[lane], dt, star[lane])
                    solve_columns(
                        X, at[lane], plus[lane], minus[lane], inverse[lane], own, star[lane], S_stage[lane], reduced
                    )
                    content_columns(
                        X, at[lane], plus[lane], minus[lane], inverse[lane], own, S_stage[lane], middle[lane]
                    )
                elif columns[lane] > 0:
                    second_star(e[lane], middle[lane], star[lane])
                    solve_columns(
                        X, at[lane], plus[lane], minus[lane], inverse[lane], own, star[lane], S[lane], reduced
                    )
                    content_columns(X, at[lane], plus[lane], minus[lane], inverse[lane], own, S[lane], e[lane])
                    net_columns(e[lane], star[lane], dt, f[lane])
        for lane in range(LANES):
            next_sample[lane] = _read_samples(
                B, lane, time_s[k - 1], dt, S_start[lane], S_stage[lane], S[lane], sample_s[lane], next_sample[lane],
                samples[lane], nodes[lane], read[lane], columns[lane], out[lane],
            )  # fmt: skip
