"""One record in a fit: start of its march, the samples that are read, and grouping of records marched side by side."""

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
"""Default limit on the steps of a fit's march [s]."""


@dataclass(frozen=True, eq=False)
class Start:
    """Start of a march that does not begin at the first row of the conditions with the declared temperatures.

    time_s   : time [s]
    profile  : (node,) temperatures [K]
    columns  : (node, k) their sensitivities [K] to k unknowns of the start, which `unknowns` defines
    refined  : temperatures [K] on the mesh of twice as many elements, for Problem.correct_meshes; by default those of
               the profile between its nodes
    covariance_K2 : (node, node) of the profile [K2], for a fit with noise of the process; exactly known where None

    Kinds of start: docs/clocks_and_starts.md, equations 2 to 5.
    """

    time_s: float
    profile: FloatArray
    columns: FloatArray
    unknowns: tuple[Parameter, ...] = ()
    refined: FloatArray | None = None
    covariance_K2: FloatArray | None = None


StartMaker = Callable[[Record, PointModel, Mesh], Start]
"""Makes a start for a record, its model and its mesh."""


@dataclass(frozen=True, eq=False)
class Samples:
    """One channel at one parameter vector, for statistics and pictures.

    part, channel : to which it belongs
    time_s        : (sample,) recorded times [s]
    mean_K        : (sample,) predicted indication [K]
    own           : (sample, unknown of the part) its sensitivities [K] per unit of each unknown
    unknowns      : number of all unknowns
    sigma_K       : noise of the sensor [K]
    predicted_sigma_K : standard deviation [K] of mean_K itself, (sample,) where a filter predicts
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
        """() or (sample,) standard deviation [K] of a sample about mean_K: sensor and prediction together.

        Square root of S_i of docs/estimation_statistics.md, equation 32.
        """
        return np.asarray(np.hypot(self.sigma_K, self.predicted_sigma_K))

    @property
    def jacobian(self) -> FloatArray:
        """(sample, unknown) sensitivities [K] to all unknowns of the fit, 0 to those of other parts.

        S_i of docs/estimation_statistics.md, equation 14.
        """
        whole = np.zeros((len(self.mean_K), self.unknowns))
        whole[:, self.part.index] = self.own
        return whole


@dataclass(eq=False)
class Part:
    """One record in a fit.

    record     : the flight record
    model      : the point at the values that are not estimated;  mesh : its mesh
    start      : where the march begins; None for the first row of the conditions
    conditions : flight conditions of the record, reference heating included
    marched, other : dotted names of the unknowns of the march, and of clock and sensors
    index      : (unknown of the part,) place of each in the parameter vector: marched, start, other
    time_s     : (step,) times of the march [s];  sample_s : (sample,) times that are read [s]
    channels   : fitted samples by sensor
    sigma_K    : noise [K] by number of the sensor
    correction_K : (sensor, sample) difference [K] of the limit of fine meshes from the march (Problem.correct_meshes)
    mesh_told  : warning about the mesh, or empty
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
        """Names of all unknowns of the part in the order of `index`: march, start, clock and sensors."""
        return (*self.marched, *(p.name for p in (self.start.unknowns if self.start else ())), *self.other)

    @property
    def read(self) -> int:
        """Number of the unknowns that are columns of the march."""
        return len(self.names) - len(self.other)

    def values(self, vector: FloatArray) -> dict[str, float]:
        """Values of the part's unknowns by their dotted names, each in its unit ([-] for ratios, [s] for the skew)."""
        return dict(zip(self.names, vector[self.index], strict=True))

    def altered(self, vector: FloatArray) -> PointModel:
        """Model of the point with the parameters of heating and stack at a parameter vector (parameter,)."""
        return self.model.altered(dict(zip(self.marched, vector[self.index], strict=False)))

    def shift_s(self, vector: FloatArray) -> float:
        """Time [s] that is added to the recorded times: recorded T(t) = true T(t - skew), so it is minus the skew.

        Source: docs/clocks_and_starts.md, equation 1.
        """
        return -self.values(vector).get(CLOCK_SKEW.name, 0.0)

    def track(self, vector: FloatArray | None = None, *, sensitive: bool = True) -> Track:
        """Input of the linearised march for this part.

        vector    : (parameter,) for the initial temperatures [K] where the start has unknowns
        sensitive : whether sensitivities to the unknowns are marched as well as temperatures
        """
        names = self.marched if sensitive else ()
        if self.start is None:
            return Track(self.model, self.mesh, names, self.sample_s)
        columns = self.start.columns if sensitive else None
        return Track(self.model, self.mesh, names, self.sample_s, None, self.initial_K(vector), columns)

    def initial_K(self, vector: FloatArray | None) -> FloatArray | None:
        """(node,) temperatures [K] at the start, profile + columns @ unknowns; None for those that the stack declares.

        Source: docs/clocks_and_starts.md, equations 4 and 5.
        """
        if self.start is None:
            return None
        if vector is None or not self.start.unknowns:
            return self.start.profile
        at = self.index[len(self.marched) : self.read]
        return self.start.profile + self.start.columns @ vector[at]

    def refined_K(self, vector: FloatArray) -> FloatArray | None:
        """(node,) temperatures [K] at the start on the refined mesh; None for those that the stack declares.

        The unknowns of the start move both meshes alike. Needed for docs/estimation_statistics.md, equation 31.
        """
        initial, fine = self.initial_K(vector), refined(self.mesh)
        if initial is None or self.start is None:
            return None
        if self.start.refined is None:
            return on_mesh(initial, self.mesh, fine)
        # only the change by the unknowns is interpolated; the profile itself is known on the fine mesh
        return self.start.refined + on_mesh(initial - self.start.profile, self.mesh, fine)

    def corrected(self, found: Linearised) -> Linearised:
        """March with the error of its mesh [K] taken out; sensitivities stay those of the mesh.

        Source: docs/estimation_statistics.md, equation 31.
        """
        return replace(found, temperature_K=found.temperature_K + self.correction_K)


def side_by_side(parts: Iterable[Part]) -> list[list[Part]]:
    """Groups of parts on common times and with meshes of one size, LANES parts at most in a group."""
    alike: dict[tuple[bytes, int], list[Part]] = {}
    for part in parts:
        # lanes of a kernel share steps and array sizes
        alike.setdefault((part.time_s.tobytes(), part.mesh.nodes), []).append(part)
    return [group[k : k + LANES] for group in alike.values() for k in range(0, len(group), LANES)]


def march_of(group: Sequence[Part]) -> LinearMarch:
    """Linearised march of a group of parts on common times, one lane each."""
    tracks = [replace(part.track(), flight=i) for i, part in enumerate(group)]
    time = group[0].time_s
    histories = np.stack([condition_history(part.conditions.at(time)) for part in group])
    return LinearMarch(tracks, time, histories)


def set_out(
    march: LinearMarch, group: Sequence[Part], vectors: Sequence[FloatArray]
) -> tuple[list[float], list[FloatArray | None]]:
    """Set the models of a march to parameter vectors, one for each of its parts.

    vectors : by part, (parameter,)
    returns : time shifts [s] and initial temperatures [K] (None: as declared), as the march takes them

    Time shift: docs/clocks_and_starts.md, equation 1.
    """
    of_parts = list(zip(group, vectors, strict=True))
    march.set_models([part.altered(v) for part, v in of_parts])
    return [part.shift_s(v) for part, v in of_parts], [part.initial_K(v) for part, v in of_parts]


def march_times(
    conditions: Conditions, begin_s: float, end_s: float, longest_step_s: float = LONGEST_STEP_S
) -> FloatArray:
    """(step,) times [s] of a march, from begin_s to the first sample of the conditions at or after end_s.

    conditions     : all of their samples in between are steps, as conditions are linear only between samples
    longest_step_s : longer intervals are divided evenly into steps no longer than this [s]
    """
    flown = conditions.time_s
    last = min(int(np.searchsorted(flown, end_s)), len(flown) - 1)
    knots = np.union1d(flown[(flown >= begin_s) & (flown <= flown[last])], [begin_s])
    span = np.diff(knots)
    # 1e-9: an interval of the longest step exactly, but for rounding, is one step
    pieces = np.ceil(span / longest_step_s - 1e-9).astype(int)
    first = np.repeat(np.cumsum(pieces) - pieces, pieces)
    within = (np.arange(pieces.sum()) - first) * np.repeat(span / pieces, pieces)
    return np.append(np.repeat(knots[:-1], pieces) + within, knots[-1])


def declared_profile(part: Part) -> FloatArray:
    """(node,) temperatures [K] that the stack of a part declares."""
    return initial_temperatures(part.model.construction, part.mesh)
