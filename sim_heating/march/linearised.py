"""Points marched together with the sensitivities of their temperatures to any of their parameters.

At a sample between two steps temperatures and sensitivities are read from the parabola through the start, the middle
stage and the end of the step, which has the order of the step itself; a skew of clocks is then a continuous parameter.
Equations: docs/theory/equations_march.md, equations 4 to 15.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from sim_heating.base.arrays import FloatArray, IntArray
from sim_heating.base.errors import InputError, RunError
from sim_heating.base.kernels.block import D0, GAPS, HEAD_ROWS, LANES, NODE_ROWS, T_STAGE, T_START, T
from sim_heating.base.kernels.jit import njit
from sim_heating.base.kernels.operations import call_step, pointer
from sim_heating.base.parameters import EFFECT_PREFIX, RATIO
from sim_heating.heating.effects.compiled import unusable_value
from sim_heating.march.ensemble import Ensemble
from sim_heating.march.frames import Flights, set_flight_conditions
from sim_heating.march.point import PointModel, initial_temperatures
from sim_heating.thermal import sensitivity
from sim_heating.thermal.frame import EVALUATE_START, NOT_CONTROLLED_K, shift_conditions
from sim_heating.thermal.mesh import Mesh
from sim_heating.thermal.sensitivity import PerturbedGroups, PerturbedOffsets
from sim_heating.thermal.step import STAGE_WEIGHT, LaneGroup

PERTURBATION = 1e-5
"""Perturbation, over its scale, of a parameter in which the heat balance is not affine, to either side: curvature
then costs about 1e-10, rounding about 1e-11 of the balance itself, together about 1e-8 of a derivative."""
AFFINE_PERTURBATION = 1e-2
"""Perturbation, over its scale, of a parameter in which the heat balance is affine, to one side."""

LINEAR_RATIO = {p.name: k for k, p in enumerate(RATIO)}
"""Numbers of the parameters of the linear heating ratio in a lane's vector."""
RATIO_ITSELF = RATIO[D0].name
"""The parameter that is added to the ratio itself. The response to another one of the linear ratio is the response to
this one times its derivative of the ratio, unless a lag remembers earlier ratios."""


@dataclass(frozen=True)
class Track:
    """One control point, its mesh, and the samples and parameters at which temperatures and sensitivities are computed.

    model    : the point, `mesh` its mesh
    names    : (m,) dotted names of the parameters
    sample_s : (sample,) times [s], increasing, within the march
    nodes    : nodes that are read; those of the sensors where None
    initial_K, initial_columns : (node,) temperatures at the start [K], and (node, extra) their sensitivities to `extra`
               more parameters, which come after the others; as the stack declares, and none, where None
    flight   : number of the flight
    at_rest  : whether times before the march are read as its beginning: temperatures were as they are there
    table_errors : arrays of the shape of the ratio table [-]; sensitivities to the factors c in ratio + c error come
               after the named parameters
    named_columns : (node, m) sensitivities of the temperatures at the start to the named parameters; 0 where None
    """

    model: PointModel
    mesh: Mesh
    names: tuple[str, ...]
    sample_s: FloatArray
    nodes: tuple[int, ...] | None = None
    initial_K: FloatArray | None = None
    initial_columns: FloatArray | None = None
    flight: int = 0
    at_rest: bool = False
    table_errors: tuple[FloatArray, ...] = ()
    named_columns: FloatArray | None = None

    @property
    def read_nodes(self) -> tuple[int, ...]:
        """Nodes whose temperatures [K] are read: those of the track, by default those of the sensors."""
        return self.mesh.sensors if self.nodes is None else self.nodes

    @property
    def columns(self) -> int:
        """Number of sensitivities: named parameters, table errors, initial temperatures.

        Their right-hand sides are docs/theory/equations_march.md, equations 9 to 14.
        """
        extra = 0 if self.initial_columns is None else self.initial_columns.shape[1]
        return len(self.names) + len(self.table_errors) + extra


@dataclass(frozen=True)
class Linearised:
    """Temperatures of a track and their derivatives.

    temperature_K : (node read, sample) [K]
    rate_K_s      : (node read, sample) rate of change [K/s]
    sensitivity   : (node read, sample, parameter) dT/dp, in K over the unit of the parameter
    """

    temperature_K: FloatArray
    rate_K_s: FloatArray
    sensitivity: FloatArray


def _curved_in_ratio(model: PointModel) -> bool:
    """Whether the film is not affine in the heating ratio: an effect depends on the ratio which it multiplies."""
    return any(used.effect.reads_ratio for used in model.effects)


def perturbation(model: PointModel, name: str) -> tuple[float, bool]:
    """Perturbation of a parameter for its derivative, and whether it is applied to both sides.

    model   : the point;  name : dotted name of the parameter
    returns : 1e-2 of the scale, one-sided, where the heat balance is affine in the parameter (the difference is then
              exact to rounding); 1e-5 of it, to both sides, where it is not. In the unit of the parameter ([-], [K],
              [m] ...)

    The scale is the prior's standard deviation, else the larger of the value and 1. A curved parameter's derivative is
    good to about 1e-8. Derived in docs/theory/equations_march.md, equations 9 and 10.
    """
    definition, value = model.definition(name), abs(model.value(name))
    has_prior = 0.0 < definition.sigma < np.inf
    scale = definition.sigma if has_prior else max(value, 1.0)
    curved = (
        model.is_curved(name) or name.startswith(EFFECT_PREFIX) or (name in LINEAR_RATIO and _curved_in_ratio(model))
    )
    return (PERTURBATION if curved else AFFINE_PERTURBATION) * scale, curved


@dataclass(frozen=True)
class PerturbedLane:
    """One perturbed lane of a track: the nominal point, or that point with a parameter or its ratio table perturbed.

    columns : those of the parameter, or of all parameters of the linear ratio, which act as the ratio itself does
    name    : of the parameter, empty for the nominal point and for tables
    by      : perturbation, in the unit of the parameter; of tables in units of the error [-]
    both    : whether it is perturbed to both sides;  at_faces : whether it acts at the faces alone
    """

    track: int
    columns: tuple[int, ...] = ()
    name: str = ""
    by: float = 0.0
    both: bool = False
    at_faces: bool = False

    def model(self, track: Track, nominal: PointModel) -> PointModel:
        """Model of the perturbed lane, from the nominal one."""
        if self.name:
            return nominal.with_parameters({self.name: nominal.value(self.name) + self.by})
        if not self.columns or nominal.ratio is None:
            return nominal
        error = track.table_errors[self.columns[0] - len(track.names)]
        return replace(nominal, ratio=replace(nominal.ratio, ratio=nominal.ratio.ratio + self.by * error))


def _sides(both: bool) -> tuple[float, ...]:
    """Signs of the perturbations of a parameter."""
    return (1.0, -1.0) if both else (1.0,)


def _perturbed_lanes(i: int, track: Track) -> list[PerturbedLane]:
    """The perturbed lanes of a track, the nominal one first; none for a track without sensitivities."""
    lanes = [PerturbedLane(i)] if track.columns else []
    if shared := _sharing_columns(track):
        by, both = perturbation(track.model, RATIO_ITSELF)
        lanes += [PerturbedLane(i, shared, RATIO_ITSELF, side * by, both, at_faces=True) for side in _sides(both)]
    for column, name in enumerate(track.names):
        if column not in shared:
            (by, both), at_faces = perturbation(track.model, name), track.model.at_faces(name)
            lanes += [PerturbedLane(i, (column,), name, side * by, both, at_faces) for side in _sides(both)]
    return lanes + _lanes_of_table_errors(i, track)


def _sharing_columns(track: Track) -> tuple[int, ...]:
    """Sensitivities that follow from the one to the ratio itself, by one perturbed lane or two."""
    # A lag mixes earlier values of dr/dp into the present ratio, so that one lane cannot serve all parameters.
    if any(used.effect.lags for used in track.model.effects):
        return ()
    return tuple(k for k, name in enumerate(track.names) if name in LINEAR_RATIO)


def _lanes_of_table_errors(i: int, track: Track) -> list[PerturbedLane]:
    """The perturbed lanes of the errors of a track's ratio table."""
    tables = range(len(track.names), len(track.names) + len(track.table_errors))
    # Where the balance is affine in the ratio, a whole unit of the error gives the exact derivative.
    both = _curved_in_ratio(track.model)
    by = PERTURBATION if both else 1.0
    return [
        PerturbedLane(i, (column,), by=side * by, both=both, at_faces=True)
        for column in tables
        for side in _sides(both)
    ]


class Requested(NamedTuple):
    """Samples and sensitivities that are read of each lane.

    columns        : (lane,) number of sensitivities
    time_s         : (lane, sample) times [s];  samples : (lane,) their number
    nodes          : (lane, read) nodes that are read;  reads : (lane,) their number
    """

    columns: IntArray
    time_s: FloatArray
    samples: IntArray
    nodes: IntArray
    reads: IntArray


class LinearMarch:
    """Up to LANES tracks on common times, marched together with the sensitivities of their temperatures.

    tracks    : points with samples and parameters; values change with `set_models`, times and names stay
    time_s    : (time,) steps of the march [s]; conditions are linear between them
    histories : (flight, time, condition), in the units of the condition columns
    raises    : InputError for no track or for more than LANES

    The derivatives are those of the discrete march: docs/theory/equations_march.md, equations 6 to 14.
    """

    def __init__(self, tracks: Sequence[Track], time_s: FloatArray, histories: FloatArray) -> None:
        if not 0 < len(tracks) <= LANES:
            raise InputError(f"linear march: {len(tracks)} tracks; 1 to {LANES} go together")
        self.tracks = tuple(tracks)
        self.time_s = np.ascontiguousarray(time_s, dtype=float)
        self.histories = np.ascontiguousarray(histories, dtype=float)
        # The steps are those of `time_s`: perturbed lanes and sensitivities follow them.
        self.nominal = Ensemble(
            [t.model for t in self.tracks], [t.mesh for t in self.tracks], tolerance_K=NOT_CONTROLLED_K
        )
        self._lanes = [lane for i, track in enumerate(self.tracks) for lane in _perturbed_lanes(i, track)]
        self.perturbed = self._ensemble() if self._lanes else None
        self._cached_offsets: dict[tuple[int, int], PerturbedOffsets] = {}
        self._lane_of = np.array([p.lane for p in self.nominal.lane_offsets])
        self._nodes, flights = np.zeros((2, LANES), dtype=np.int64)
        for i, track in enumerate(self.tracks):
            self._nodes[self._lane_of[i]] = track.mesh.nodes
        for lane, i in enumerate(self.nominal.lanes):
            flights[lane] = self.tracks[i].flight
        self._flights = Flights(self.time_s, self.histories, flights)

    def _ensemble(self) -> Ensemble:
        """Ensemble of the perturbed lanes, those that need whole rows first.

        Groups of whole rows are filled up with lanes that need the faces alone.
        """
        tracks = [self.tracks[perturbed.track] for perturbed in self._lanes]
        models = [perturbed.model(track, track.model) for perturbed, track in zip(self._lanes, tracks, strict=True)]
        at_faces = np.array([perturbed.at_faces for perturbed in self._lanes])
        # A group costs the same with one lane as with eight: lanes at the faces alone fill the groups of whole rows.
        fillers = -np.count_nonzero(~at_faces) % LANES
        kinds = [int(kind) for kind in at_faces & (np.cumsum(at_faces) > fillers)]
        return Ensemble(models, [track.mesh for track in tracks], share_tables_with=self.nominal, kinds=kinds)

    @cached_property
    def _groups(self) -> PerturbedGroups:
        """The perturbed lanes as the kernel takes them."""
        e = self.perturbed
        if e is None:
            return sensitivity.no_perturbed_groups()
        owner = np.array([perturbed.track for perturbed in self._lanes])
        assembled = {
            offsets.group
            for offsets, perturbed in zip(e.lane_offsets, self._lanes, strict=True)
            if not perturbed.at_faces
        }
        source = self._lane_of[owner][e.lanes].astype(np.int64)
        return PerturbedGroups(e.ints, e.groups, len(assembled), source, *sensitivity.assembly_addresses())

    def _offsets(self, m: int) -> PerturbedOffsets:
        """Offsets of the perturbed lanes of each track, with m columns for each lane."""
        faces = sensitivity.ACTS_ALONG_GAP if self.nominal.memory.integers(0)[GAPS] == 1 else sensitivity.ACTS_AT_FACES
        if (m, faces) not in self._cached_offsets:
            self._cached_offsets[m, faces] = self._find_offsets(m, faces)
        return self._cached_offsets[m, faces]

    def _find_offsets(self, m: int, faces: int) -> PerturbedOffsets:
        at, inverse = np.zeros(LANES, dtype=np.int64), np.zeros((LANES, m))
        plus, minus, reach = np.zeros((3, LANES, m), dtype=np.int64)
        linear = np.full((LANES, m), sensitivity.OWN_PERTURBATION)
        lane_offsets = () if self.perturbed is None else self.perturbed.lane_offsets
        for perturbed, offsets in zip(self._lanes, lane_offsets, strict=True):
            lane, columns, first = self._lane_of[perturbed.track], list(perturbed.columns), offsets.node_0
            if not columns:
                # Equal on both sides by default: a column without a perturbed lane has no forcing.
                at[lane], plus[lane], minus[lane] = first, first, first
            elif perturbed.by < 0.0:
                minus[lane, columns] = first
            else:
                plus[lane, columns], inverse[lane, columns] = first, (0.5 if perturbed.both else 1.0) / perturbed.by
                reach[lane, columns] = faces if perturbed.at_faces else sensitivity.ACTS_IN_ROWS
                if perturbed.name == RATIO_ITSELF:
                    linear[lane, columns] = [LINEAR_RATIO[self.tracks[perturbed.track].names[k]] for k in columns]
        return PerturbedOffsets(at, plus, minus, inverse, reach, linear, self._nodes)

    def set_models(self, models: Sequence[PointModel]) -> None:
        """Give the points new parameter values, in all lanes, nominal and perturbed.

        models : one for each track, differing from the present one in values only ([-], [K], ... by parameter)

        Perturbations have the size of the first models: docs/theory/equations_march.md, equations 9 and 10.
        """
        for i, model in enumerate(models):
            self.nominal.set_model(i, model)
        if self.perturbed is not None:
            for k, perturbed in enumerate(self._lanes):
                self.perturbed.set_model(k, perturbed.model(self.tracks[perturbed.track], models[perturbed.track]))

    def set_values(self, i: int, values: Callable[[str, float], tuple[FloatArray, FloatArray]]) -> None:
        """Give a point new parameter values in all its lanes, without a model made for each; its tables stay.

        i      : number of the track
        values : of the stack and the heating, as of `PointWriter.set_values`, where the parameter of a name has a value
                 by so much larger; that of no name is the point itself

        Source: docs/theory/equations_march.md, equations 9 and 10.
        """
        self.nominal.writer.set_values(i, *values("", 0.0))
        if self.perturbed is not None:
            for k, perturbed in enumerate(self._lanes):
                if perturbed.track == i:
                    self.perturbed.writer.set_values(k, *values(perturbed.name, perturbed.by))

    def move(self, tracks: Sequence[Track], time_s: FloatArray, histories: FloatArray) -> None:
        """Go over to other steps, conditions, samples and starts.

        tracks    : the present ones with other `sample_s`, `initial_K`, `initial_columns` and `named_columns`; with
                    sensitivities where those have some
        time_s, histories : steps [s] and conditions, as for a new march
        raises    : InputError where a track is of another point, mesh, flight, or has other names

        What costs most of a new march stays: the lanes are packed already.
        """
        for old, new in zip(self.tracks, tracks, strict=True):
            same = old.model.construction is new.model.construction and old.mesh is new.mesh
            if not same or (old.names, old.flight) != (new.names, new.flight) or (not old.columns and new.columns):
                raise InputError(f"{new.model.name}: another point, mesh or parameters need a march of their own")
        self.tracks = tuple(tracks)
        self.time_s = np.ascontiguousarray(time_s, dtype=float)
        self.histories = np.ascontiguousarray(histories, dtype=float)
        self._flights = Flights(self.time_s, self.histories, self._flights.of_lane)

    def march(
        self, shifts_s: Sequence[float] | None = None, initial_K: Sequence[FloatArray | None] | None = None
    ) -> list[Linearised]:
        """March all tracks from their initial temperatures, with the sensitivities at their samples.

        shifts_s  : (track,) added to the sample times of each track [s], a clock skew for instance; 0 by default
        initial_K : (node,) temperatures at the start [K] of each track, in place of its own
        returns   : temperatures [K], rates [K/s] and sensitivities of each track
        raises    : InputError where a shifted sample lies outside the march, RunError where a step did not converge or
                    a sensitivity is not finite

        Derived in docs/theory/equations_march.md, equations 4 to 8.
        """
        results = self.attempt(shifts_s, initial_K)
        self._check_effects(results)
        self.nominal.check()
        return [self._checked(track, result) for track, result in zip(self.tracks, results, strict=True)]

    def _check_effects(self, results: Sequence[Linearised | None]) -> None:
        """Look for the reason of a failure in the effects that a user defined, as an ensemble does."""
        for track, result in zip(self.tracks, results, strict=True):
            for use in track.model.effects if result is None else ():
                if fault := unusable_value(use, self.time_s, self.histories[track.flight]):
                    raise RunError(f"{track.model.name}: {fault}")

    @staticmethod
    def _checked(track: Track, result: Linearised | None) -> Linearised:
        if result is None:
            raise RunError(
                f"{track.model.name}: a temperature or sensitivity of the march is not a number, or a temperature at "
                "its start is not above 0 K; start from values nearer to the declared ones, or fit fewer parameters"
            )
        return result

    def attempt(
        self, shifts_s: Sequence[float] | None = None, initial_K: Sequence[FloatArray | None] | None = None
    ) -> list[Linearised | None]:
        """March all tracks, with None in place of a track that failed; the others are unaffected by it.

        A track whose temperatures at the start are not above 0 K has failed: a search for them takes a shorter step.

        shifts_s  : (track,) added to the sample times of each track [s]; 0 by default
        initial_K : (node,) temperatures at the start [K] of each track, in place of its own
        returns   : temperatures [K], rates [K/s] and sensitivities of each track, or None
        raises    : InputError where a shifted sample lies outside the march

        Derived in docs/theory/equations_march.md, equations 4 to 8.
        """
        times = self._sample_times([0.0] * len(self.tracks) if shifts_s is None else shifts_s)
        started = self._begin([t.initial_K for t in self.tracks] if initial_K is None else initial_K)
        m = max(track.columns for track in self.tracks)
        requested = self._requested(times)
        reads, count = requested.nodes.shape[1], requested.time_s.shape[1]
        out = np.empty((len(self.tracks), reads, count, 2 + m))
        group = self.nominal.lane_group(0)
        if self.perturbed is not None:
            # Its tables are those of the nominal lanes and of the perturbed ratios behind them.
            group = group._replace(table=self.perturbed.table)
        march_linear(
            group,
            self._perturbed_state(),
            self._groups,
            self._offsets(m),
            self._flights,
            self._start_columns(m),
            requested,
            out,
        )
        failed = self.nominal.failed()
        return [None if failed[i] or not started[i] else self._result(i, out) for i in range(len(self.tracks))]

    def _sample_times(self, shifts_s: Sequence[float]) -> list[FloatArray]:
        """Times [s] at which each track is read.

        raises : InputError where one lies outside the march
        """
        times = []
        for track, shift in zip(self.tracks, shifts_s, strict=True):
            t = track.sample_s + shift
            times.append(np.maximum(t, self.time_s[0]) if track.at_rest else t)
            outside = np.count_nonzero((times[-1] < self.time_s[0]) | (times[-1] > self.time_s[-1]))
            if outside:
                raise InputError(f"{track.model.name}: {outside} samples lie outside the march; leave them out")
        return times

    def _begin(self, initial_K: Sequence[FloatArray | None]) -> list[bool]:
        """Set nominal and perturbed lanes to the start of the march.

        returns : by track, whether its temperatures are above 0 K; otherwise it begins as declared, and has failed
        """
        self.nominal.reset()
        if self.perturbed is not None:
            self.perturbed.counters.clear()
        started = [profile is None or bool(np.all(profile > 0.0)) for profile in initial_K]
        for i, profile in enumerate(initial_K):
            # The perturbed lanes take their temperatures from the nominal ones at every stage.
            if profile is not None and started[i]:
                self.nominal.set_profile(i, profile)
        return started

    def _perturbed_state(self) -> FloatArray:
        """Blocks of the perturbed lanes."""
        return np.zeros(0) if self.perturbed is None else self.perturbed.state

    def _start_columns(self, m: int) -> Columns:
        """Room for m sensitivities, in whole vectors of four, with those at the start in `end`."""
        size = (LANES, int(self._nodes.max()), -(-m // sensitivity.VECTOR) * sensitivity.VECTOR)
        columns = Columns(*np.zeros((len(Columns._fields), *size)))
        start = columns.end
        for i, track in enumerate(self.tracks):
            if track.initial_columns is not None:
                first = track.columns - track.initial_columns.shape[1]
                start[self._lane_of[i], : track.mesh.nodes, first : track.columns] = track.initial_columns
            if track.named_columns is not None:
                start[self._lane_of[i], : track.mesh.nodes, : len(track.names)] = track.named_columns
        return columns

    def _requested(self, times: Sequence[FloatArray]) -> Requested:
        """Samples that are read of each lane; a lane without a track has no samples and no columns."""
        columns, samples, reads = np.zeros((3, LANES), dtype=np.int64)
        sample_s = np.full((LANES, max(1, *(len(t) for t in times))), np.inf)
        nodes = np.zeros((LANES, max(1, *(len(t.read_nodes) for t in self.tracks))), dtype=np.int64)
        for i, (track, t) in enumerate(zip(self.tracks, times, strict=True)):
            lane = self._lane_of[i]
            columns[lane], samples[lane], reads[lane] = track.columns, len(t), len(track.read_nodes)
            sample_s[lane, : len(t)], nodes[lane, : len(track.read_nodes)] = t, track.read_nodes
        return Requested(columns, sample_s, samples, nodes, reads)

    def _result(self, i: int, out: FloatArray) -> Linearised | None:
        track = self.tracks[i]
        of_track = out[self._lane_of[i], : len(track.read_nodes), : len(track.sample_s), : 2 + track.columns]
        if not np.all(np.isfinite(of_track)):
            return None
        return Linearised(of_track[..., 0], of_track[..., 1], of_track[..., 2:])


def initial_profile(track: Track) -> FloatArray:
    """(node,) temperatures at the start of a track [K]: its own, else those that its stack declares.

    Source: docs/theory/equations_march.md, equation 23; its sensitivities are those of equation 14.
    """
    if track.initial_K is not None:
        return track.initial_K
    return initial_temperatures(track.model.construction, track.mesh)


class Columns(NamedTuple):
    """Sensitivities of the node temperatures in one step, each (LANES, node, width) [K over the parameter's unit], and
    the work space of their march, all of one size.

    start, middle, end : sensitivities at the start, the first stage and the end of the step
    e, f, star, content : heat content [J/m2], net heat [W/m2], right-hand side and heat content at the first stage
    """

    start: FloatArray
    middle: FloatArray
    end: FloatArray
    e: FloatArray
    f: FloatArray
    star: FloatArray
    content: FloatArray


@njit
def _read_samples(
    B: FloatArray, lane: int, begun_s: float, dt: float, S: Columns, requested: Requested, first: int, out: FloatArray
) -> int:
    """Temperatures, rates and sensitivities at the samples of a lane in one step; returns the next sample's number."""
    k, m = first, requested.columns[lane]
    while k < requested.samples[lane] and requested.time_s[lane, k] <= begun_s + dt:
        x = (requested.time_s[lane, k] - begun_s) / dt
        w0, w1, w2 = sensitivity.parabola(x)
        d0, d1, d2 = sensitivity.parabola_rate(x, dt)
        for j in range(requested.reads[lane]):
            i = requested.nodes[lane, j]
            a = (HEAD_ROWS + i * NODE_ROWS) * LANES + lane
            T0, T1, T2 = B[a + T_START * LANES], B[a + T_STAGE * LANES], B[a + T * LANES]
            out[lane, j, k, 0] = w0 * T0 + w1 * T1 + w2 * T2
            out[lane, j, k, 1] = d0 * T0 + d1 * T1 + d2 * T2
            for q in range(m):
                middle, end = S.middle[lane, i, q], S.end[lane, i, q]
                out[lane, j, k, 2 + q] = w0 * S.start[lane, i, q] + w1 * middle + w2 * end
        k += 1
    return k


@njit
def march_linear(
    group: LaneGroup,
    X: FloatArray,
    perturbed: PerturbedGroups,
    offsets: PerturbedOffsets,
    flights: Flights,
    S: Columns,
    requested: Requested,
    out: FloatArray,
) -> None:
    """March one lane group with the sensitivities of its lanes.

        A1 S1 = e + d dt f - G_p,    A2 S2 = e + (w/d) (e1 - e) - G_p

    group              : the nominal lanes, whose block changes, with tables that serve the perturbed lanes as well
    X                  : blocks of the perturbed lanes, changed
    perturbed, offsets : groups of the perturbed lanes, and where those of each nominal lane are
    flights            : steps of the march and conditions
    S                  : sensitivities, at the start of the march in `end`, and work space; changed
    requested          : samples and nodes
    out                : (LANES, node read, sample, 2 + m) temperature [K], rate [K/s], sensitivities; filled

    A lane that fails leaves numbers that are not finite in its own part of `out`. Derived in
    docs/theory/equations_march.md, equations 4 to 8.
    """
    B, time_s = group.B, flights.time_s
    b, j, t = pointer(B), pointer(group.J), pointer(group.table)
    n, width, m = S.end.shape[1], S.end.shape[2], offsets.plus.shape[1]
    count = n * width
    x, begun, stage, end = pointer(X), pointer(S.start), pointer(S.middle), pointer(S.end)
    # e and f are carried from step to step: the end of one is the start of the next, as for the temperatures.
    e, f, star, middle = pointer(S.e), pointer(S.f), pointer(S.star), pointer(S.content)
    work = np.zeros(n)
    reduced = pointer(work)
    next_sample = np.zeros(LANES, dtype=np.int64)
    set_flight_conditions(B, flights, 0)
    call_step(group.advance, b, j, t, group.dispatcher, EVALUATE_START)
    # With 1 s for the time step the rows give f as the difference of content and residual.
    sensitivity.assemble_perturbed(group, X, perturbed, T, 2, 1.0)
    for lane in range(LANES):
        if requested.columns[lane] > 0:
            sensitivity.begin_columns(x, offsets, lane, m, end, e, f, lane * count, width)
    for k in range(1, len(time_s)):
        dt = time_s[k] - time_s[k - 1]
        shift_conditions(b)
        set_flight_conditions(B, flights, k)
        call_step(group.advance, b, j, t, group.dispatcher, dt)
        ddt = STAGE_WEIGHT * dt
        # Nominal temperatures first: the perturbed lanes are assembled at the stages to which the step converged.
        sensitivity.assemble_perturbed(group, X, perturbed, T_STAGE, 1, ddt)
        for lane in range(LANES):
            if requested.columns[lane] > 0:
                at = lane * count
                sensitivity.copy_columns(end, begun, at, count)
                sensitivity.first_right_hand_side(e, f, dt, star, at, count)
                sensitivity.solve_columns(x, offsets, lane, m, ddt, star, stage, at, width, reduced)
                sensitivity.content_columns(x, offsets, lane, m, stage, middle, at, width)
        sensitivity.assemble_perturbed(group, X, perturbed, T, 2, ddt)
        for lane in range(LANES):
            if requested.columns[lane] > 0:
                at = lane * count
                sensitivity.second_right_hand_side(e, middle, star, at, count)
                sensitivity.solve_columns(x, offsets, lane, m, ddt, star, end, at, width, reduced)
                sensitivity.content_columns(x, offsets, lane, m, end, e, at, width)
                sensitivity.net_columns(e, star, dt, f, at, count)
        for lane in range(LANES):
            next_sample[lane] = _read_samples(B, lane, time_s[k - 1], dt, S, requested, next_sample[lane], out)
    # A pointer does not keep what it points to: the array is still needed here.
    work[0] = 0.0
