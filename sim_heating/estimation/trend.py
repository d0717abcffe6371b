"""Fits of consecutive short segments: the heating ratio over each, as a trend along the flight.

Each segment starts at the temperatures where the one before ended, with the uncertainty of its fit: the
covariance of the node temperatures, in its largest directions, is the prior of as many unknowns of the start
(docs/clocks_and_starts.md, equation 5). The temperatures of the refined mesh that corrects the predictions
(FitProblem.correct_meshes) pass from segment to segment as well.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import RATIO_VARIABLES
from sim_heating.base.errors import InputError, RunError
from sim_heating.base.progress import Progress, no_progress
from sim_heating.estimation.fit import FEWEST_SAMPLES
from sim_heating.estimation.inference.newton import Fit, maximise
from sim_heating.estimation.inference.observability import default_names
from sim_heating.estimation.problem import FitOptions, FitProblem, joint_reference
from sim_heating.estimation.record_fit import RecordFit, Start, march_times, start_unknowns
from sim_heating.heating.ratio.lookup import table_ratios_at
from sim_heating.inputs.record import Record
from sim_heating.march.linearised import LinearMarch, Track
from sim_heating.march.point import initial_temperatures
from sim_heating.thermal.mesh import halve_elements

DIRECTIONS = 4
"""Number of directions of the temperatures' covariance that are passed from a segment to the next."""
CONDITION_POINTS = 21
"""Number of points of a segment over which its mean condition is averaged."""


@dataclass(frozen=True, eq=False)
class Segment:
    """One short segment.

    start_s, end_s : its times [s];  samples : number of fitted samples
    condition      : means of the five ratio variables over it ([deg], log10 Re [-])
    ratio, sigma   : heating ratio at that mean condition, and its standard deviation [-]
    values, sigmas : of the estimated parameters, in their units
    """

    start_s: float
    end_s: float
    samples: int
    condition: tuple[float, ...]
    ratio: float
    sigma: float
    values: FloatArray
    sigmas: FloatArray


@dataclass(frozen=True, eq=False, repr=False)
class Trend:
    """Fits of the short segments of a record.

    record, names : record and parameters that were fitted;  segments : those that converged, in order of time
    left_out      : segments without a fit, with the reason
    warnings      : one line each
    """

    record: Record
    names: tuple[str, ...]
    segments: tuple[Segment, ...]
    left_out: tuple[str, ...]
    warnings: tuple[str, ...] = ()

    def __repr__(self) -> str:
        begin, end = self.segments[0].start_s, self.segments[-1].end_s
        return f"Trend({self.record.name}: {len(self.segments)} segments, {begin:g} to {end:g} s)"


def trend(
    record: Record,
    length_s: float,
    names: Sequence[str] | None = None,
    *,
    progress: Progress = no_progress,
) -> Trend:
    """Fit parameters, by default the magnitude of the ratio alone, to short segments of a record one after another.

    length_s : length of a segment [s]
    names    : dotted names of the parameters
    progress : called with the fraction done and a line of text
    returns  : the segments whose fit converged, each with the ratio at its mean condition [-] and its sigma
    raises   : InputError where no segment has enough samples, RunError where no fit of those that have converges

    The founding paper's sequence of five-second segments for the trend with Reynolds number ("Trends in Shuttle Entry
    Heating from the Correlation of Flight Test Maneuvers", figure 9). Source: docs/clocks_and_starts.md, equation 5.
    """
    if not 0.0 < length_s < np.inf:
        raise InputError(f"{record.name}: segments of {length_s:g} s; give a length in s above 0, for example 5")
    fitted = tuple(names) if names is not None else default_names([record])[:1]
    windows = _windows(record, length_s)
    interval_s = float(np.median(np.diff(record.time_s))) if len(record.time_s) > 1 else 0.0
    if length_s < interval_s:
        raise InputError(
            f"{record.name}: segments of {length_s:g} s are shorter than the {interval_s:g} s between samples"
        )
    if not windows:
        raise InputError(f"{record.name}: the fit segments contain no recorded time; give others")
    segments, left_out, not_converged, mesh_warnings = [], [], [], []
    start, last = None, None
    for k, (begin, end) in enumerate(windows):
        progress(k / len(windows), f"segments: {k + 1} of {len(windows)}, {begin:.0f} to {end:.0f} s")
        mask = record.fit_mask() & (record.time_s >= begin) & (record.time_s < end)
        count = int(np.count_nonzero(np.isfinite(record.temperatures_K(record.used_sensors)[:, mask])))
        # the next segment then starts from the last one that could be fitted, marched over the gap
        if count < max(FEWEST_SAMPLES, len(fitted)):
            left_out.append(f"{begin:g} to {end:g} s: {count} samples for {len(fitted)} parameters")
            continue
        if last is not None:
            start = _next_start(*last, begin)
        problem = FitProblem(
            [record], fitted, joint_reference([record]), FitOptions(starts=[start], sample_masks=[mask])
        )
        # the parameters change little from one segment to the next, so that the search begins near its end
        first = np.array([p.value for p in problem.parameters]) if last is None else _carried_values(problem, *last)
        fit = maximise(problem.evaluate, problem.parameters, first, problem.log_likelihoods)
        if fit.converged:
            problem.correct_meshes(fit.values)
            # one line of these is enough: every segment has the mesh of the record
            mesh_warnings += problem.mesh_warnings
            fit = maximise(problem.evaluate, problem.parameters, fit.values, problem.log_likelihoods)
        if not fit.converged or not np.all(np.isfinite(fit.covariance)):
            not_converged.append(f"{begin:g} to {end:g} s: {fit.describe()[0]}")
            left_out.append(not_converged[-1])
            continue
        last = (problem, fit)
        segments.append(_segment(record, problem, fit, begin, end, count))
    if not segments:
        nothing = f"{record.name}: no segment of {length_s:g} s can be fitted"
        raise RunError(f"{nothing}; {not_converged[0]}") if not_converged else InputError(f"{nothing}; {left_out[0]}")
    return Trend(record, fitted, tuple(segments), tuple(left_out), tuple(mesh_warnings[:1]))


def _windows(record: Record, length_s: float) -> list[tuple[float, float]]:
    """Start and end of the short segments within the fit segments."""
    first = max(record.time_s[0], record.conditions.time_s[0])
    last = min(record.time_s[-1], record.conditions.time_s[-1])
    windows = []
    for a, b in record.declared.segments.fit or [[first, last]]:
        begin, end = max(a, first), min(b, last)
        edges = np.arange(begin, end, length_s)
        windows += [(float(t), float(t + length_s)) for t in edges]
    return sorted(windows)


def _carried_values(problem: FitProblem, before: FitProblem, fit: Fit) -> FloatArray:
    """First values of a segment: those of the segment before it, without a change of its start."""
    last = dict(zip((u.label for u in before.unknowns), fit.values, strict=True))
    # unknowns of the start are deviations from the temperatures at the end of the segment before: they begin at 0
    carried = {*problem.record_fits[0].march_names, *problem.record_fits[0].sensor_names}
    return np.array([last[p.name] if p.name in carried else p.value for p in problem.parameters])


def _next_start(problem: FitProblem, fit: Fit, time_s: float) -> Start:
    """Start at a later time from a fit: temperatures [K], and the largest directions of their covariance."""
    record_fit = problem.record_fits[0]
    T, S = state_at(record_fit, fit.values, time_s)
    own = fit.covariance[
        np.ix_(record_fit.index[: record_fit.march_columns], record_fit.index[: record_fit.march_columns])
    ]
    values, vectors = np.linalg.eigh(own)
    # the svd of S C^(1/2) keeps the small directions that an eigendecomposition of S C S' would lose to rounding
    U, s, _ = np.linalg.svd(S @ (vectors * np.sqrt(np.maximum(values, 0.0))), full_matrices=False)
    count = min(DIRECTIONS, len(s))
    return Start(time_s, T, U[:, :count] * s[:count], start_unknowns(count), refined_at(record_fit, fit.values, time_s))


def state_at(record_fit: RecordFit, values: FloatArray, time_s: float) -> tuple[FloatArray, FloatArray]:
    """Node temperatures of a record at a time, and their sensitivities.

    values  : (parameter,);  time_s : [s]; before the start of the record, its initial temperatures
    returns : (node,) temperatures [K]; (node, unknown of the march) sensitivities [K] per unit of each unknown

    S_T of docs/clocks_and_starts.md, equation 5.
    """
    begin = record_fit.begin_s
    if time_s <= begin:
        profile = record_fit.initial_K(values)
        columns = (
            np.zeros((record_fit.mesh.nodes, record_fit.march_columns))
            if record_fit.start is None
            else record_fit.start.columns
        )
        if profile is None:
            profile = initial_temperatures(record_fit.model.construction, record_fit.mesh)
        return profile, columns
    time = _steps_to(record_fit, time_s)
    declared = record_fit.track(values)
    nodes = tuple(range(record_fit.mesh.nodes))
    track = Track(
        record_fit.model_at(values), record_fit.mesh, record_fit.march_names, np.array([time_s]), nodes,
        declared.initial_K, declared.initial_columns,
    )  # fmt: skip
    found = LinearMarch([track], time, record_fit.history(time)).march()[0]
    return found.temperature_K[:, 0], found.sensitivity[:, 0]


def refined_at(record_fit: RecordFit, values: FloatArray, time_s: float) -> FloatArray:
    """Node temperatures of a record at a time on its refined mesh, which has twice as many elements.

    values  : (parameter,);  time_s : [s]; before the start of the record, its initial temperatures
    returns : (node of the refined mesh,) [K]

    The next segment needs them for its mesh correction, docs/estimation_statistics.md, equation 31.
    """
    mesh, initial = halve_elements(record_fit.mesh), record_fit.refined_K(values)
    begin = record_fit.begin_s
    if time_s <= begin:
        return initial_temperatures(record_fit.model.construction, mesh) if initial is None else initial
    time = _steps_to(record_fit, time_s)
    track = Track(record_fit.model_at(values), mesh, (), np.array([time_s]), tuple(range(mesh.nodes)), initial)
    found = LinearMarch([track], time, record_fit.history(time)).march()[0]
    return found.temperature_K[:, 0]


def _steps_to(record_fit: RecordFit, time_s: float) -> FloatArray:
    """(step,) times of the march of a record [s] up to a time: those of its fit, and its samples beyond them."""
    plain = march_times(record_fit.conditions, record_fit.begin_s, time_s)
    return np.union1d(plain, record_fit.time_s[record_fit.time_s < plain[-1]])


def _segment(record: Record, problem: FitProblem, fit: Fit, begin: float, end: float, count: int) -> Segment:
    flown = record.conditions.at(np.linspace(begin, min(end, record.conditions.time_s[-1]), CONDITION_POINTS))
    condition = tuple(float(np.mean(flown[v])) for v in RATIO_VARIABLES)
    m = len(problem.record_fits[0].march_names)
    values, sigmas = fit.values[:m], fit.sigma[:m]
    size = 1.0
    if problem.record_fits[0].march_names[0] == "ratio.scale" and record.ratio_table is not None:
        size = float(table_ratios_at(record.ratio_table, np.array([condition]))[0])
    ratio = size * (1.0 + values[0]) if problem.record_fits[0].march_names[0] == "ratio.scale" else values[0]
    return Segment(begin, end, count, condition, float(ratio), float(abs(size) * sigmas[0]), values, sigmas)
