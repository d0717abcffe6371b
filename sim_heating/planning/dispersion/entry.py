"""A study's dispersed entry, ready to be flown in batches: from numbers of flights to peak temperatures, as Parquet.

A batch is BATCH flights of one design, LANES at a time through the thermal march. What it gives hangs on the study and
on the numbers of its flights alone.
"""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import RATIO_VARIABLES
from sim_heating.base.errors import InputError
from sim_heating.base.files import repeated_name
from sim_heating.base.kernels.block import LANES
from sim_heating.march.mesh_choice import LADDER, mesh_of_nodes
from sim_heating.planning.dispersion import statistics as sampling
from sim_heating.planning.dispersion.flight import LARGEST, Fleet, Flown, dispersed, fleet, fly_many, labels
from sim_heating.planning.dispersion.march import LaneMarch, Peaks, bare_model
from sim_heating.planning.dispersion.spec import FLIGHT_INPUTS, Dispersion, Input
from sim_heating.planning.ratio_table_modes import table_factors, table_modes
from sim_heating.planning.study import Study
from sim_heating.thermal.mesh import Mesh, refined
from sim_heating.trajectory.flight import conditions_from_rows

BATCH = 64
"""Flights of a batch, a whole number of LANES; a power of two, so that a batch is a balanced part of its sequence."""
MESH_TOLERANCE_K = 0.3
"""What halving every element may change of any peak of the planned flight [K], times 4/3, for a mesh to be taken."""
DIFFERENCE = 0.1
"""Standard deviations that an input is moved by, to either side, for differences about the planned flight."""
SOBOL, RANDOM, INDEX, AXES, TWICE = "sobol", "random", "index", "axes", "twice"
"""Designs: flights that count, of sensitivity indices, of differences, and those flown in six degrees of freedom."""


@dataclass(frozen=True)
class Batch:
    """Flights `start` to `stop` of a design, of one scramble where it has several."""

    design: str
    start: int
    stop: int
    scramble: int = 0

    @property
    def id(self) -> str:
        """Name of its file."""
        return f"{self.design}-{self.scramble:04d}-{self.start:09d}.parquet"


class DispersedEntry:
    """The dispersed entry of a study; made in each process from the study alone."""

    def __init__(self, study: Study) -> None:
        if study.declared.dispersion is None:
            raise InputError(f"{study.path}: has no [dispersion]")
        self.study = study
        self.spec: Dispersion = study.declared.dispersion
        self.inputs: list[Input] = self.spec.input
        self.labels = labels(self.inputs)
        self.points = study.points
        self.effects = [study.base.effects(p.point.name) for p in self.points]

    def __getstate__(self) -> dict[str, Any]:
        """The study, and what takes long to make, where it is made: another process need not make it again."""
        return {key: self.__dict__[key] for key in ("study", "meshes", "modes", "mode_columns") if key in self.__dict__}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__init__(state.pop("study"))  # type: ignore[misc]
        self.__dict__.update(state)

    def __call__(self, batch: Batch) -> bytes:
        """The results of a batch flown as a point mass, as a Parquet file."""
        return parquet_bytes(self.fly(batch))

    # What is made once a process -------------------------------------------------------------------------------------

    @cached_property
    def fleet(self) -> Fleet:
        """Flights of the planned entry."""
        spec, place = self.study.base.declared.trajectory, self.study.vehicle.directory
        return fleet(spec, place, self.spec.step_s, self.spec.thermal_step_s)

    @cached_property
    def planned(self) -> Flown:
        """The planned flight, without deviations, in LANES copies."""
        flown = fly_many(self.fleet, self.inputs, [{}] * LANES)
        if flown.outcome[0] != 0:
            raise InputError(
                f"{self.study.path}: the planned entry does not come to its [trajectory.stop]; at "
                f"{flown.end_s[0]:.0f} s it is still flying or out of the atmosphere"
            )
        return flown

    @cached_property
    def modes(self) -> list[FloatArray]:
        """(node, mode) errors of the logarithm of each point's ratio table, by a unit of each mode."""
        rows = self.planned.rows[0, : self.planned.filled[0]]
        path = conditions_from_rows(rows, self.study.vehicle.reference_length_m)
        x = np.stack([path[v] for v in RATIO_VARIABLES], axis=1)
        if self.spec.tables == 0.0:
            return [np.zeros((p.point.ratio.ratio.size, 0)) for p in self.points]
        return [table_modes(self.study.vehicle, p.point.name, x, self.spec.tables) for p in self.points]

    @cached_property
    def mode_columns(self) -> list[slice]:
        """Columns of a row of normal numbers that are each point's modes; those of the inputs come first."""
        ends = len(self.inputs) + np.cumsum([0, *(m.shape[1] for m in self.modes)])
        return [slice(int(a), int(b)) for a, b in pairwise(ends)]

    @property
    def dimensions(self) -> int:
        """Independent numbers of a flight."""
        return self.mode_columns[-1].stop

    @cached_property
    def groups(self) -> list[tuple[str, list[int]]]:
        """What sensitivity indices are of: each input, and the ratio tables together."""
        single = [(label, [k]) for k, label in enumerate(self.labels)]
        tables = list(range(len(self.inputs), self.dimensions))
        return [*single, *([("ratio tables", tables)] if tables else [])]

    @cached_property
    def words(self) -> list[tuple[str, str]]:
        """What the groups are, and how large with their unit."""
        several = {i.name for i, label in zip(self.inputs, self.labels, strict=True) if label == f"{i.name}#1"}
        told = []
        for i, label, places in zip(self.inputs, self.labels, self.places, strict=True):
            named = i.title or (f"profile {int(label.rpartition('#')[2]) + 1}" if i.name in several else "")
            unit = self.lanes.models[places[0][0]].definition(i.name).unit if places else "1"
            told.append(i.model_copy(update={"title": named}).told(unit))
        return [*told, ("ratio tables", "their own sigma")][: len(self.groups)]

    @cached_property
    def meshes(self) -> list[Mesh]:
        """Of each point the coarsest mesh whose peaks along the planned flight are right to MESH_TOLERANCE_K."""
        models = [bare_model(self.study.vehicle, p, e) for p, e in zip(self.points, self.effects, strict=True)]
        chosen: list[Mesh | None] = [None] * len(models)
        for nodes in LADDER:
            coarse = [mesh_of_nodes(m, nodes, self.spec.thermal_step_s) for m in models]
            fine = [refined(mesh) for mesh in coarse]
            apart = np.abs(self._planned_peaks(coarse) - self._planned_peaks(fine)).max(axis=0)
            chosen = [
                mesh if old is None and error < 0.75 * MESH_TOLERANCE_K else old
                for old, mesh, error in zip(chosen, coarse, apart, strict=True)
            ]
            if None not in chosen:
                break
        return [m if m is not None else last for m, last in zip(chosen, coarse, strict=True)]

    def _planned_peaks(self, meshes: Sequence[Mesh]) -> FloatArray:
        found = self._lanes(meshes).march(self.planned, 0, [], [None] * len(self.points))
        return np.array([found.surface_K[0], found.bondline_K[0]])

    def _lanes(self, meshes: Sequence[Mesh]) -> LaneMarch:
        return LaneMarch(
            self.study.vehicle, self.points, self.effects, meshes, self.spec.thermal_step_s, self.study.declared.soak_s
        )

    @cached_property
    def lanes(self) -> LaneMarch:
        """The control points in lanes."""
        return self._lanes(self.meshes)

    @cached_property
    def places(self) -> list[list[tuple[int, str, int]]]:
        """Where each input acts on the points: (point, kind, place); nowhere for an input of the flight."""
        return [[] if i.name in FLIGHT_INPUTS else self.places_of(i) for i in self.inputs]

    # Flying ----------------------------------------------------------------------------------------------------------

    def rows(self, batch: Batch) -> FloatArray:
        """(flight, dimension) standard normal numbers of a batch."""
        d, seed = self.dimensions, self.spec.seed
        if batch.design == AXES:
            return sampling.axis_rows(d, DIFFERENCE, batch.start, batch.stop)
        if batch.design == INDEX:
            groups = [columns for _, columns in self.groups]
            return sampling.saltelli_rows(groups, seed, self.spec.index_flights, batch.start, batch.stop)
        draw = sampling.random_rows if self.spec.sampling == RANDOM else sampling.sobol_rows
        return draw(d, seed, batch.scramble, batch.start, batch.stop)

    def fly(self, batch: Batch) -> dict[str, FloatArray]:
        """Deviations, how the flights went, and peaks, by column."""
        z = self.rows(batch)
        moved = sampling.deviations(self.inputs, z)
        flown = fly_many(self.fleet, self.inputs, [self.of_flight(row) for row in moved])
        peaks = self.march(flown, moved, z)
        names = [p.point.name for p in self.points]
        least, most = peaks.extent[:, 0], peaks.extent[:, 1]
        return {
            "scramble": np.full(len(z), float(batch.scramble)),
            "flight": np.arange(batch.start, batch.stop, dtype=float),
            **{f"input.{label}": moved[:, k] for k, label in enumerate(self.labels)},
            "outcome": flown.outcome.astype(float),
            "end_s": flown.end_s,
            "untrimmed_s": flown.untrimmed_s,
            **{f"least.{v}": least[:, k] for k, v in enumerate(RATIO_VARIABLES)},
            **{f"most.{v}": most[:, k] for k, v in enumerate(RATIO_VARIABLES)},
            **{f"negative.{n}": peaks.negative[:, k].astype(float) for k, n in enumerate(names)},
            **{f"surface_K.{n}": peaks.surface_K[:, k] for k, n in enumerate(names)},
            **{f"bondline_K.{n}": peaks.bondline_K[:, k] for k, n in enumerate(names)},
        }

    def of_flight(self, moved: FloatArray) -> dict[str, float]:
        """The deviations of one row that change the flight, by label."""
        named = zip(self.inputs, self.labels, moved.tolist(), strict=True)
        return {label: value for i, label, value in named if i.name in FLIGHT_INPUTS}

    def march(
        self, flown: Flown, moved: FloatArray, z: FloatArray, keep: list[tuple[FloatArray, FloatArray]] | None = None
    ) -> Peaks:
        """Peaks along flights, LANES at a time; deviations (flight, input) and normal numbers (flight, dimension).

        keep : as LaneMarch.march takes it
        """
        changes = [
            (p, kind, place, moved[:, k])
            for k, places in enumerate(self.places)
            for p, kind, place in places
        ]  # fmt: skip
        tables = [
            table_factors(m, z[:, c]) if m.shape[1] else None
            for m, c in zip(self.modes, self.mode_columns, strict=True)
        ]
        parts = [self.lanes.march(flown, first, changes, tables, keep) for first in range(0, len(z), LANES)]
        return Peaks(*(np.concatenate([getattr(p, key) for p in parts]) for key in Peaks.__dataclass_fields__))

    def check(self) -> None:
        """Everything that may be wrong with the inputs, before any flight.

        raises : InputError with one line a problem
        """
        require_pyarrow()
        problems = []
        for k, i in enumerate(self.inputs):
            try:
                self._check_input(i, k)
            except InputError as error:
                problems += [f"{self.study.path}, [dispersion], input {k + 1}: {line}" for line in error.problems]
        if (label := repeated_name(self.labels)) is not None:
            problems.append(f"{self.study.path}, [dispersion]: `{label}` is repeated; give it once")
        if problems:
            raise InputError(*problems)

    def _check_input(self, i: Input, k: int) -> None:
        low, high = (i.low, i.high) if i.sigma is None else (-LARGEST * i.sigma, LARGEST * i.sigma)
        assert low is not None  # Input says so
        assert high is not None
        for name in i.control_points or []:
            self.study.vehicle.control_point(name)
            if name not in (p.point.name for p in self.points):
                raise InputError(f"`{i.name}`: `{name}` is not among the study's control points")
        if i.name in FLIGHT_INPUTS:
            self._check_flight_input(i, self.labels[k], low, high)
            return
        if i.name.startswith("ratio.") and i.name != "ratio.scale":
            raise InputError(f"`{i.name}`: the sigma of the tables says how they err; disperse `ratio.scale`, or that")
        for p, _, _ in self.places_of(i):
            model = self.lanes.models[p]
            definition, value = model.definition(i.name), model.value(i.name)
            if not definition.lower <= value + low <= value + high <= definition.upper:
                raise InputError(
                    f"`{i.name}`: {value + low:g} to {value + high:g} leaves {definition.lower:g} to "
                    f"{definition.upper:g} at {model.name} ({LARGEST:g} sigma count); make it narrower, or uniform"
                )

    def places_of(self, i: Input) -> list[tuple[int, str, int]]:
        """Where an input acts on the points."""
        return [
            (p, *self.lanes.place_of(p, i.name))
            for p, point in enumerate(self.points)
            if i.control_points is None or point.point.name in i.control_points
        ]

    def _check_flight_input(self, i: Input, label: str, low: float, high: float) -> None:
        aero = self.fleet.aero
        for value in (low, high):
            spec = dispersed(self.fleet.base, self.inputs, {label: value})
            aero.with_changes(
                mass_kg=spec.vehicle.mass_kg, cg_fraction=spec.vehicle.cg_fraction, cm_shift=spec.vehicle.cm_shift
            )
            factors = [f for _, f in spec.dispersions.density_factor or ()]
            initial = spec.initial
            if i.name in ("aero.CN", "aero.CA"):
                factors.append(1.0 + value)
            if factors and min(factors) <= 0.0:
                raise InputError(
                    f"`{i.name}`: a deviation of {value:g} makes a factor of {min(factors):g}; make it smaller"
                )
            if initial is not None and not (initial.altitude_m > 0.0 and initial.velocity_m_s > 0.0):
                raise InputError(f"`{i.name}`: a deviation of {value:g} makes no entry; make it smaller")


def require_pyarrow() -> None:
    """raises : InputError where pyarrow is not installed."""
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
