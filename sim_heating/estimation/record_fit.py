"""One record in a fit: where its march begins, the samples that are read, and parts marched side by side."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import Conditions
from sim_heating.base.kernels.block import LANES
from sim_heating.base.parameters import CLOCK_SKEW, Parameter
from sim_heating.estimation._observation import Channel
from sim_heating.inputs.record import Record
from sim_heating.march.ensemble import condition_history
from sim_heating.march.linearised import Linearised, LinearMarch, Track
from sim_heating.march.point import PointModel, initial_temperatures
from sim_heating.thermal.mesh import Mesh, on_mesh, refined

LONGEST_STEP_S = 1.0
"""No step of a fit's march is longer [s], where nothing else is asked for."""


@dataclass(frozen=True, eq=False)
class Start:
    """Where a march begins if not at the first row of the conditions with the declared temperatures.

    time_s   : time [s]
    profile  : (node,) temperatures [K]
    columns  : (node, k) how they change with k unknowns [K over their units], `unknowns` saying what those are
    refined  : temperatures [K] on the mesh of twice as many elements, for Problem.correct_meshes; by default those of
               the profile between its nodes
    covariance_K2 : (node, node) of the profile, for a fit with noise of the process; known, where None
    """

    time_s: float
    profile: FloatArray
    columns: FloatArray
    unknowns: tuple[Parameter, ...] = ()
    refined: FloatArray | None = None
    covariance_K2: FloatArray | None = None


StartMaker = Callable[[Record, PointModel, Mesh], Start]
"""How a start is made for a record, its model and its mesh."""


@dataclass(frozen=True, eq=False)
class Samples:
    """One channel at one parameter vector, for statistics and pictures.

    part, channel : whose;  time_s : (sample,) recorded times
    mean_K        : (sample,) indication that the model gives
    own           : (sample, unknown of the part) its sensitivities
    unknowns      : number of all unknowns
    sigma_K       : noise that is taken
    predicted_sigma_K : standard deviation of mean_K itself, (sample,) where a filter predicts
    """

    part: Part
    channel: Channel
    time_s: FloatArray
    mean_K: FloatArray
    own: FloatArray
    unknowns: int
    sigma_K: float
    predicted_sigma_K: FloatArray | float = 0.0

    @property
    def spread_K(self) -> FloatArray:
        """() or (sample,) standard deviation of a sample about mean_K."""
        return np.asarray(np.hypot(self.sigma_K, self.predicted_sigma_K))

    @property
    def jacobian(self) -> FloatArray:
        """(sample, unknown) sensitivities to all unknowns of the fit, 0 to those of other parts."""
        whole = np.zeros((len(self.mean_K), self.unknowns))
        whole[:, self.part.index] = self.own
        return whole


@dataclass(eq=False)
class Part:
    """One record in a fit.

    model      : the point at the values that are not estimated;  mesh : its mesh
    marched, other : dotted names of the unknowns of the march, and of clock and sensors
    index      : (unknown of the part,) place of each in the parameter vector: marched, start, other
    time_s     : (step,) the march;  sample_s : (sample,) times that are read
    correction_K : (sensor, sample) what a mesh without error adds to the march (Problem.correct_meshes)
    mesh_told  : what a person should know of it, or nothing
    """

    record: Record
    model: PointModel
    mesh: Mesh
    start: Start | None
    conditions: Conditions
    marched: tuple[str, ...]
    other: tuple[str, ...]
    index: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    time_s: FloatArray = field(default_factory=lambda: np.zeros(0))
    sample_s: FloatArray = field(default_factory=lambda: np.zeros(0))
    channels: list[Channel] = field(default_factory=list)
    sigma_K: dict[int, float] = field(default_factory=dict)
    correction_K: FloatArray | float = 0.0
    mesh_told: str = ""

    @cached_property
    def names(self) -> tuple[str, ...]:
        """All unknowns of the part in the order of `index`."""
        return (*self.marched, *(p.name for p in (self.start.unknowns if self.start else ())), *self.other)

    @property
    def read(self) -> int:
        """How many of the unknowns are columns of the march."""
        return len(self.names) - len(self.other)

    def values(self, vector: FloatArray) -> dict[str, float]:
        """The part's own values by their dotted names."""
        return dict(zip(self.names, vector[self.index], strict=True))

    def altered(self, vector: FloatArray) -> PointModel:
        """The model at a parameter vector."""
        return self.model.altered(dict(zip(self.marched, vector[self.index], strict=False)))

    def shift_s(self, vector: FloatArray) -> float:
        """What is added to the recorded times: T(t) = true T(t - skew)."""
        return -self.values(vector).get(CLOCK_SKEW.name, 0.0)

    def track(self, vector: FloatArray | None = None, *, sensitive: bool = True) -> Track:
        """The part as the march takes it; with a vector, from the initial temperatures that it says; without
        sensitivities where only temperatures are wanted."""
        names = self.marched if sensitive else ()
        if self.start is None:
            return Track(self.model, self.mesh, names, self.sample_s)
        columns = self.start.columns if sensitive else None
        return Track(self.model, self.mesh, names, self.sample_s, None, self.initial_K(vector), columns)

    def initial_K(self, vector: FloatArray | None) -> FloatArray | None:
        """(node,) temperatures [K] at the start; None for those that the stack declares."""
        if self.start is None:
            return None
        if vector is None or not self.start.unknowns:
            return self.start.profile
        at = self.index[len(self.marched) : self.read]
        return self.start.profile + self.start.columns @ vector[at]

    def refined_K(self, vector: FloatArray) -> FloatArray | None:
        """The same on the refined mesh."""
        initial, fine = self.initial_K(vector), refined(self.mesh)
        if initial is None or self.start is None:
            return None
        if self.start.refined is None:
            return on_mesh(initial, self.mesh, fine)
        return self.start.refined + on_mesh(initial - self.start.profile, self.mesh, fine)

    def corrected(self, found: Linearised) -> Linearised:
        """What the march gave, without the error of its mesh."""
        return replace(found, temperature_K=found.temperature_K + self.correction_K)


def side_by_side(parts: Iterable[Part]) -> list[list[Part]]:
    """Parts on common times, LANES at most in a group."""
    alike: dict[tuple[bytes, int], list[Part]] = {}
    for part in parts:
        alike.setdefault((part.time_s.tobytes(), part.mesh.nodes), []).append(part)
    return [group[k : k + LANES] for group in alike.values() for k in range(0, len(group), LANES)]


def march_of(group: Sequence[Part]) -> LinearMarch:
    """The linearised march of parts on common times."""
    tracks = [replace(part.track(), flight=i) for i, part in enumerate(group)]
    time = group[0].time_s
    histories = np.stack([condition_history(part.conditions.at(time)) for part in group])
    return LinearMarch(tracks, time, histories)


def set_out(
    march: LinearMarch, group: Sequence[Part], vectors: Sequence[FloatArray]
) -> tuple[list[float], list[FloatArray | None]]:
    """Put the parts of a march at parameter vectors, one each; gives what the march itself takes of them."""
    of_parts = list(zip(group, vectors, strict=True))
    march.set_models([part.altered(v) for part, v in of_parts])
    return [part.shift_s(v) for part, v in of_parts], [part.initial_K(v) for part, v in of_parts]


def march_times(
    conditions: Conditions, begin_s: float, end_s: float, longest_step_s: float = LONGEST_STEP_S
) -> FloatArray:
    """Steps from begin_s to the first sample of the conditions at or after end_s, none longer than longest_step_s."""
    flown = conditions.time_s
    last = min(int(np.searchsorted(flown, end_s)), len(flown) - 1)
    knots = np.union1d(flown[(flown >= begin_s) & (flown <= flown[last])], [begin_s])
    span = np.diff(knots)
    pieces = np.ceil(span / longest_step_s - 1e-9).astype(int)
    first = np.repeat(np.cumsum(pieces) - pieces, pieces)
    within = (np.arange(pieces.sum()) - first) * np.repeat(span / pieces, pieces)
    return np.append(np.repeat(knots[:-1], pieces) + within, knots[-1])


def declared_profile(part: Part) -> FloatArray:
    """(node,) temperatures [K] that the stack of a part declares."""
    return initial_temperatures(part.model.construction, part.mesh)
