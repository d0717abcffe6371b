"""The dispersed entry of a study, flown in batches: from the numbers of flights to peak temperatures, as Parquet.

A batch is BATCH flights of one design, marched LANES at a time. Its result depends only on the study and on the numbers
of its flights.
"""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from itertools import accumulate, pairwise
from typing import Any

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import RATIO_VARIABLES
from sim_heating.base.errors import InputError
from sim_heating.base.kernels.block import LANES
from sim_heating.inputs.points import conditions_at_point
from sim_heating.march.mesh_choice import NODE_COUNTS, mesh_of_nodes
from sim_heating.planning.bands import DECLARED, Member
from sim_heating.planning.dispersion.drawn_errors import DrawnError, drawn_errors
from sim_heating.planning.dispersion.drawn_members import DrawnMember, DrawnMembers
from sim_heating.planning.dispersion.flight import EntrySampler, SampledFlights, entry_sampler, input_labels
from sim_heating.planning.dispersion.march import FlightPeaks, LaneMarch, model_without_sensors
from sim_heating.planning.dispersion.member_march import MemberMarch, joined
from sim_heating.planning.dispersion.spec import FLIGHT_INPUTS, DispersedInput, Dispersion
from sim_heating.planning.dispersion.statistics import axis_rows, deviations, random_rows, saltelli_rows, sobol_rows
from sim_heating.planning.ratio_table_modes import table_modes
from sim_heating.planning.study import Study
from sim_heating.thermal.mesh import Mesh, halve_elements
from sim_heating.trajectory.flight import conditions_from_rows

BATCH = 64
"""Flights of a batch, a multiple of LANES; a power of two, so that a batch is a balanced part of its sequence."""
MESH_TOLERANCE_K = 0.3
"""Largest error of a peak of the planned flight by the mesh [K]: 4/3 of its change when every element is halved."""
DIFFERENCE = 0.1
"""Step of an input, to either side, for differences about the planned flight, in standard deviations."""
TABLES, MEMBERS, ERRORS = "ratio tables", "members", "model error"
"""Labels of the groups of a sensitivity index that are no inputs of the study."""
GROUP_SIZES = {
    TABLES: "their own sigma",
    MEMBERS: "by weight, and by their covariance",
    ERRORS: "smooth in time, as bands have it",
}
"""Label of such a group -> its size in words."""
SOBOL, RANDOM, INDEX, AXES, SPOT_CHECK = "sobol", "random", "index", "axes", "spot-check"
"""Designs: two for the statistics, then for sensitivity indices, differences, and six degrees of freedom."""


@dataclass(frozen=True)
class Batch:
    """Flights `start` to before `stop` of a design, and of one scramble if it has several."""

    design: str
    start: int
    stop: int
    scramble: int = 0

    @property
    def id(self) -> str:
        """Name of its file in the ledger."""
        return f"{self.design}-{self.scramble:04d}-{self.start:09d}.parquet"


@dataclass(frozen=True)
class NumberColumns:
    """Columns of a row of normal numbers, in this order.

    inputs  : one an input of the study
    modes   : of the ratio table of each point
    members : which member a flight has, and what that leaves open; empty without members
    errors  : of the error of the heating of each point; none where it is not drawn
    """

    inputs: slice
    modes: list[slice]
    members: slice
    errors: list[slice]

    @classmethod
    def of_counts(cls, inputs: int, modes: Sequence[int], members: int, errors: Sequence[int]) -> NumberColumns:
        """Columns by the number of each."""
        ends = accumulate([inputs, *modes, members, *errors], initial=0)
        first, *others = (slice(a, b) for a, b in pairwise(ends))
        return cls(first, others[: len(modes)], others[len(modes)], others[len(modes) + 1 :])

    @property
    def count(self) -> int:
        """Number of columns."""
        return (self.errors[-1] if self.errors else self.members).stop


class DispersedEntry:
    """The dispersed entry of a study; each process makes it from the study alone.

    raises : InputError where the study has no [dispersion]
    """

    def __init__(self, study: Study) -> None:
        if study.declared.dispersion is None:
            raise InputError(f"{study.path}: has no [dispersion]")
        self.study = study
        self.spec: Dispersion = study.declared.dispersion
        self.inputs: list[DispersedInput] = self.spec.input
        self.labels = input_labels(self.inputs)
        self.points = study.points
        self.point_names = [p.point.name for p in self.points]
        self.effects = [study.base.effects(p.point.name) for p in self.points]
        self.estimates: Sequence[Member] = study.members("dispersion") or DECLARED

    def __getstate__(self) -> dict[str, Any]:
        """The study, and the results that take long to compute if they are there: another process then has them."""
        # Meshes, modes and errors take long to compute; all else a process makes again from the study.
        return {key: self.__dict__[key] for key in ("study", "meshes", "modes", "errors") if key in self.__dict__}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__init__(state.pop("study"))  # type: ignore[misc]
        self.__dict__.update(state)

    def __repr__(self) -> str:
        return f"<DispersedEntry `{self.study.title}`: {len(self.inputs)} inputs, {len(self.points)} control points>"

    def __call__(self, batch: Batch) -> bytes:
        """The results of a batch flown as a point mass, as a Parquet file."""
        return parquet_bytes(self.fly(batch))

    # Computed once a process -----------------------------------------------------------------------------------------

    @cached_property
    def sampler(self) -> EntrySampler:
        """Sampler of the planned entry."""
        spec, directory = self.study.base.declared.trajectory, self.study.vehicle.directory
        return entry_sampler(spec, directory, self.spec.step_s, self.spec.thermal_step_s)

    @cached_property
    def planned(self) -> SampledFlights:
        """The planned flight, without deviations, in LANES copies.

        raises : InputError where it does not meet its stop
        """
        flown = self.sampler.fly(self.inputs, [{}] * LANES)
        if flown.outcome[0] != 0:
            raise InputError(
                f"{self.study.path}: the planned entry never meets its [trajectory.stop]: at {flown.end_s[0]:.0f} s it "
                "is still flying or has left the atmosphere; change the stop or the initial state"
            )
        return flown

    @cached_property
    def modes(self) -> list[FloatArray]:
        """(node, mode) error of the logarithm of each point's ratio table for a unit of each mode [-]."""
        # The errors of a table matter only where the entry flies: along the path they are a handful of numbers.
        rows = self.planned.rows[0, : self.planned.frame_counts[0]]
        path = conditions_from_rows(rows, self.study.vehicle.reference_length_m)
        x = np.stack([path[v] for v in RATIO_VARIABLES], axis=1)
        if self.spec.tables == 0.0:
            return [np.zeros((p.point.ratio.ratio.size, 0)) for p in self.points]
        return [table_modes(self.study.vehicle, p.point.name, x, self.spec.tables) for p in self.points]

    @cached_property
    def errors(self) -> list[list[DrawnError]]:
        """(member, point) smooth error of the heating; of no point where the study does not ask for it."""
        if not self.spec.model_error:
            return [[] for _ in self.members.each]
        rows, vehicle = self.planned.rows[0, : self.planned.frame_counts[0]], self.study.vehicle
        path = conditions_from_rows(rows, vehicle.reference_length_m)
        flown = [conditions_at_point(vehicle, p.point, path) for p in self.points]
        return [drawn_errors(m, flown) for m in self.members.each]

    @cached_property
    def columns(self) -> NumberColumns:
        """Columns of a row of normal numbers."""
        return NumberColumns.of_counts(
            len(self.inputs),
            [m.shape[1] for m in self.modes],
            self.members.columns,
            [max(e.columns for e in of_point) for of_point in zip(*self.errors, strict=True)],
        )

    @property
    def dimensions(self) -> int:
        """Number of independent normal numbers of a flight."""
        return self.columns.count

    @cached_property
    def members(self) -> DrawnMembers:
        """The members at the control points."""
        models = [
            model_without_sensors(self.study.vehicle, p, e) for p, e in zip(self.points, self.effects, strict=True)
        ]
        return DrawnMembers([DrawnMember(models, m) for m in self.estimates])

    @cached_property
    def groups(self) -> list[tuple[str, list[int]]]:
        """Label and columns of each group of a sensitivity index: every input, the ratio tables together, the members
        with what they leave open, and the errors of the heating together."""
        columns = self.columns
        groups = {TABLES: columns.modes, MEMBERS: [columns.members], ERRORS: columns.errors}
        together = [(label, [k for s in some for k in range(s.start, s.stop)]) for label, some in groups.items()]
        single = [(label, [k]) for k, label in enumerate(self.labels)]
        return [*single, *((label, numbers) for label, numbers in together if numbers)]

    @cached_property
    def group_descriptions(self) -> list[tuple[str, str]]:
        """Name of each group, and its size with the unit."""
        has_profiles = {i.name for i, label in zip(self.inputs, self.labels, strict=True) if label == f"{i.name}#1"}
        described = []
        for i, label in zip(self.inputs, self.labels, strict=True):
            named = i.title or (f"profile {int(label.rpartition('#')[2]) + 1}" if i.name in has_profiles else "")
            points = [] if i.name in FLIGHT_INPUTS else i.points_of(self.point_names)
            unit = self.lanes.models[points[0]].definition(i.name).unit if points else "1"
            described.append(i.model_copy(update={"title": named}).describe(unit))
        return [*described, *((label, GROUP_SIZES[label]) for label, _ in self.groups[len(described) :])]

    @cached_property
    def meshes(self) -> list[Mesh]:
        """For each point the coarsest mesh whose peaks along the planned flight are accurate to MESH_TOLERANCE_K."""
        heaviest = self.members.each[self.members.heaviest]
        chosen: dict[int, Mesh] = {}
        # Judged by the peaks of the planned flight and not by the pulse of `march.mesh_choice`: only peaks have to be
        # accurate here.
        for nodes in NODE_COUNTS:
            coarse = [mesh_of_nodes(m, nodes, self.spec.thermal_step_s) for m in heaviest.models]
            fine = [halve_elements(mesh) for mesh in coarse]
            on_coarse, on_fine = (self._planned_peaks(self._lanes(heaviest, meshes)) for meshes in (coarse, fine))
            change = np.abs(on_coarse - on_fine).max(axis=0)
            for p, mesh in enumerate(coarse):
                if change[p] < 0.75 * MESH_TOLERANCE_K:
                    chosen.setdefault(p, mesh)
            if len(chosen) == len(self.points):
                break
        return [chosen.get(p, mesh) for p, mesh in enumerate(coarse)]

    def _planned_peaks(self, lanes: LaneMarch) -> FloatArray:
        """(quantity, point) peaks along the planned flight [K]."""
        peaks = lanes.march(self.planned, 0, [], [None] * len(self.points))
        return np.array([peaks.surface_K[0], peaks.bondline_K[0]])

    def _lanes(self, member: DrawnMember, meshes: Sequence[Mesh]) -> LaneMarch:
        study, models = self.study, member.models
        return LaneMarch(study.vehicle, self.points, models, meshes, self.spec.thermal_step_s, study.declared.soak_s)

    @cached_property
    def marches(self) -> list[MemberMarch]:
        """The control points in lanes, as each member has them."""
        return [
            MemberMarch(m, self._lanes(m, self.meshes), self.inputs, errors)
            for m, errors in zip(self.members.each, self.errors, strict=True)
        ]

    @property
    def lanes(self) -> LaneMarch:
        """The control points in lanes, as the heaviest member has them."""
        return self.marches[self.members.heaviest].lanes

    @cached_property
    def planned_peaks(self) -> FloatArray:
        """(member, quantity, point) peaks along the planned flight [K]."""
        return np.array([self._planned_peaks(m.lanes) for m in self.marches])

    # Flying ----------------------------------------------------------------------------------------------------------

    def rows(self, batch: Batch) -> FloatArray:
        """(flight, dimension) standard normal numbers of a batch."""
        d, seed = self.dimensions, self.spec.seed
        if batch.design == AXES:
            return axis_rows(d, DIFFERENCE, batch.start, batch.stop)
        if batch.design == INDEX:
            groups = [columns for _, columns in self.groups]
            return saltelli_rows(groups, seed, self.spec.index_flights, batch.start, batch.stop)
        draw = random_rows if self.spec.sampling == RANDOM else sobol_rows
        return draw(d, seed, batch.scramble, batch.start, batch.stop)

    def fly(self, batch: Batch) -> dict[str, FloatArray]:
        """Columns of the results of a batch: deviations, outcomes of the flights, and peaks."""
        z = self.rows(batch)
        deviation = deviations(self.inputs, z)
        flown = self.sampler.fly(self.inputs, list(map(self.flight_deviations, deviation)))
        peaks = self.march(flown, deviation, z)
        member = self.members.numbers(z[:, self.columns.members])
        least, most = peaks.extent[:, 0], peaks.extent[:, 1]
        return {
            "scramble": np.full(len(z), float(batch.scramble)),
            "flight": np.arange(batch.start, batch.stop, dtype=float),
            **{f"input.{label}": deviation[:, k] for k, label in enumerate(self.labels)},
            **({"member": member.astype(float)} if self.spec.member else {}),
            **{
                f"model_error.{n}": np.choose(member, [e.sigma(z[:, c]) for e in of_point])
                for n, c, *of_point in zip(self.point_names, self.columns.errors, *self.errors, strict=False)
            },
            "outcome": flown.outcome.astype(float),
            "end_s": flown.end_s,
            "untrimmed_s": flown.untrimmed_s,
            **{f"least.{v}": least[:, k] for k, v in enumerate(RATIO_VARIABLES)},
            **{f"most.{v}": most[:, k] for k, v in enumerate(RATIO_VARIABLES)},
            **{f"negative.{n}": peaks.negative[:, k].astype(float) for k, n in enumerate(self.point_names)},
            **{f"surface_K.{n}": peaks.surface_K[:, k] for k, n in enumerate(self.point_names)},
            **{f"bondline_K.{n}": peaks.bondline_K[:, k] for k, n in enumerate(self.point_names)},
        }

    def flight_deviations(self, deviation: FloatArray) -> dict[str, float]:
        """Deviations of one row (input,) that change the flight, by label."""
        named = zip(self.inputs, self.labels, deviation.tolist(), strict=True)
        return {label: value for i, label, value in named if i.name in FLIGHT_INPUTS}

    def march(
        self,
        flown: SampledFlights,
        deviation: FloatArray,
        z: FloatArray,
        keep: list[tuple[FloatArray, FloatArray]] | None = None,
    ) -> FlightPeaks:
        """Peaks along flights, LANES at a time.

        deviation : (flight, input), each in the unit of its input;  z : (flight, dimension) normal numbers
        keep      : receives for each point surface and bondline (time, 2 LANES) [K] and the conditions (LANES, time,
                    condition); None for none
        """
        own = z[:, self.columns.members]
        member = self.members.numbers(own)
        flights, parts = [np.flatnonzero(member == k) for k in range(len(self.marches))], []
        for of_member, marched in zip(flights, self.marches, strict=True):
            if len(of_member):
                of_tables = [(m, z[of_member, c]) for m, c in zip(self.modes, self.columns.modes, strict=True)]
                of_errors = [z[of_member, c] for c in self.columns.errors]
                chosen = flown.chosen(of_member)
                parts.append(
                    marched.march(chosen, deviation[of_member], own[of_member, 1:], of_tables, of_errors, keep)
                )
        order, peaks = np.argsort(np.concatenate(flights)), joined(parts)
        return FlightPeaks(*(getattr(peaks, f.name)[order] for f in fields(FlightPeaks)))


def require_pyarrow() -> None:
    """Check that Parquet files can be written; raises InputError where pyarrow is not installed."""
    try:
        import pyarrow  # noqa: F401
    except ImportError:
        raise InputError("pyarrow is not installed: pip install 'sim-heating[plan]'") from None


def parquet_bytes(columns: Mapping[str, FloatArray]) -> bytes:
    """Columns as a Parquet file; the same bytes for the same numbers."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    buffer = io.BytesIO()
    pq.write_table(pa.table(dict(columns)), buffer, compression="zstd")
    return buffer.getvalue()
