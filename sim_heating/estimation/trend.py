"""Fits of consecutive short segments: the heating ratio over each, as a trend along the flight.

Each segment starts at the temperatures where the one before ended, with the uncertainty of its fit: the
covariance of the node temperatures, in its largest directions, is the prior of as many unknowns of the start
(docs/theory/clocks_and_starts.md, equation 5). Where readings were lost before a segment, or the ratio was not constant
over the one before, the heating until then is unknown and adds its directions (equation 6). The temperatures of the
refined mesh that corrects the predictions (FitProblem.correct_meshes) pass from segment to segment as well.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.special import chdtrc

from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import RATIO_VARIABLES
from sim_heating.base.errors import InputError, RunError
from sim_heating.base.parameters import RATIO, Parameter
from sim_heating.base.progress import Progress, no_progress
from sim_heating.estimation.fit import FEWEST_SAMPLES, lag1_autocorrelation, rms_normalised_residual
from sim_heating.estimation.inference.likelihood import quantile_residuals
from sim_heating.estimation.inference.newton import Fit, maximise
from sim_heating.estimation.inference.observability import default_names
from sim_heating.estimation.problem import FitOptions, FitProblem, joint_reference
from sim_heating.estimation.record_fit import RecordFit, Start, StartMaker, march_times, start_unknowns
from sim_heating.estimation.starts import lost_start, with_estimated_profile
from sim_heating.estimation.unknown_heating import after_unknown_heating, largest_directions, temperatures_at
from sim_heating.heating.ratio.uncertainty import basis, declared_ratio
from sim_heating.inputs.record import Record
from sim_heating.march.ensemble import Ensemble
from sim_heating.march.linearised import LINEAR_RATIO, RATIO_ITSELF, LinearMarch, Track
from sim_heating.march.point import initial_temperatures
from sim_heating.thermal.mesh import halve_elements

DIRECTIONS = 4
"""Number of directions of the temperatures' covariance that are passed from a segment to the next."""
LOST_DIRECTIONS = 10
"""Number of them where the heating since the segment before is unknown."""
LOST_INTERVALS = 3.0
"""Time without a reading, in median intervals of the record, after which the heating meanwhile is unknown."""
CONDITION_POINTS = 21
"""Number of points of a segment over which its mean condition is averaged."""
RATIO_STEP = 1e-3
"""Change of the linear ratio [-] for the derivative of the ratio with effects."""
MISFIT_PROBABILITY = 0.01
"""Probability of residuals below which those of a segment are not noise alone."""
MOST_COLOUR = 0.9
"""Largest lag-1 autocorrelation [-] that widens the bounds of such a segment."""


@dataclass(frozen=True, eq=False)
class Segment:
    """One short segment.

    start_s, end_s : its times [s];  samples : number of fitted samples
    condition      : means of the five ratio variables over it ([deg], log10 Re [-])
    ratio, sigma   : mean heating ratio over it, effects included, and its standard deviation [-]
    values, sigmas : of the estimated parameters, in their units
    declared       : mean of the declared ratio over it, effects included [-]
    misfit         : RMS of its residuals over that of noise [-], where that is significant, else 1; sigmas contain it
                     and the colour of those residuals
    """

    start_s: float
    end_s: float
    samples: int
    condition: tuple[float, ...]
    ratio: float
    sigma: float
    values: FloatArray
    sigmas: FloatArray
    declared: float
    misfit: float = 1.0


@dataclass(frozen=True, eq=False, repr=False)
class Trend:
    """Fits of the short segments of a record.

    record, names : record and parameters that were fitted;  segments : those that converged, in order of time
    left_out      : segments without a fit, with the reason
    covariance    : (segment, segment) of the ratios [-]: the start of each segment carries the errors of those before
    warnings      : one line each
    """

    record: Record
    names: tuple[str, ...]
    segments: tuple[Segment, ...]
    left_out: tuple[str, ...]
    covariance: FloatArray
    warnings: tuple[str, ...] = ()

    def __repr__(self) -> str:
        begin, end = self.segments[0].start_s, self.segments[-1].end_s
        return f"Trend({self.record.name}: {len(self.segments)} segments, {begin:g} to {end:g} s)"


@dataclass(frozen=True, eq=False)
class _Fitted:
    """The fit of a segment, and what the next one takes from it.

    fit        : its covariance contains the misfit;  last_s : time of its last reading [s]
    misfit     : as in Segment
    with_ratios : (unknown of the march, segment) covariance of its values with the ratios of all segments so far, its
                  own last
    """

    problem: FitProblem
    fit: Fit
    last_s: float
    misfit: float
    with_ratios: FloatArray

    @property
    def of_march(self) -> FloatArray:
        """(unknown, unknown) covariance of the unknowns of the march, those of its start included."""
        return _of_march(self.problem.record_fits[0], self.fit.covariance)


def trend(
    record: Record,
    length_s: float,
    names: Sequence[str] | None = None,
    *,
    start: Start | StartMaker | None = None,
    fixed: Mapping[str, float] | None = None,
    priors: Mapping[str, Parameter | tuple[float, float]] | None = None,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    reference: Mapping[str, float] | None = None,
    progress: Progress = no_progress,
) -> Trend:
    """Fit parameters, by default the magnitude of the ratio alone, to short segments of a record one after another.

    length_s  : length of a segment [s]
    names     : dotted names of the parameters
    start     : where the first segment starts, or what makes it (starts.STARTS); by default at the declared
                temperatures, and where readings begin later at the first of them, the heating until then unknown
    fixed     : values of parameters that are not estimated but differ from the declared ones
    priors    : name -> mean and standard deviation of another prior, infinite for a flat one; or a whole Parameter
    bounds    : name -> least and greatest value; priors and bounds hold for every segment
    reference : values of ratio variables that derivatives are about ([deg], [-]), where not the record's own
    progress  : called with the fraction done and a line of text
    returns   : the segments whose fit converged, each with its mean ratio [-] and the sigma of it
    raises    : InputError where no segment has enough samples, RunError where no fit of those that have converges

    The founding paper's sequence of five-second segments for the trend with Reynolds number ("Trends in Shuttle Entry
    Heating from the Correlation of Flight Test Maneuvers", figure 9). Source: docs/theory/clocks_and_starts.md,
    equations 5 to 7.
    """
    if not 0.0 < length_s < np.inf:
        raise InputError(f"{record.name}: segments of {length_s:g} s; give a length in s above 0, for example 5")
    fitted = tuple(names) if names is not None else default_names([record])[:1]
    interval_s = float(np.median(np.diff(record.time_s))) if len(record.time_s) > 1 else 0.0
    if length_s < interval_s:
        raise InputError(
            f"{record.name}: segments of {length_s:g} s are shorter than the {interval_s:g} s between samples"
        )
    about, longest_gap_s = joint_reference([record], reference), LOST_INTERVALS * interval_s
    begun = None if start is None else _made_start(record, fitted, about, fixed, start)
    windows = _windows(record, length_s, -np.inf if begun is None else begun.time_s)
    if not windows:
        raise InputError(f"{record.name}: the fit segments contain no recorded time; give others")
    segments: list[Segment] = []
    left_out: list[str] = []
    not_converged: list[str] = []
    mesh_warnings: list[str] = []
    first: Start | StartMaker | None
    last: _Fitted | None = None
    ratios = np.zeros((0, 0))
    for k, (begin, end) in enumerate(windows):
        progress(k / len(windows), f"segments: {k + 1} of {len(windows)}, {begin:.0f} to {end:.0f} s")
        mask = record.fit_mask() & (record.time_s >= begin) & (record.time_s < end)
        read_s = record.time_s[mask & record.read_mask]
        count = int(np.count_nonzero(np.isfinite(record.temperatures_K(record.used_sensors)[:, mask])))
        # the next segment then starts from the last one that could be fitted, marched over the gap
        if count < max(FEWEST_SAMPLES, len(fitted)):
            left_out.append(f"{begin:g} to {end:g} s: {count} samples for {len(fitted)} parameters")
            continue
        carried = np.zeros((0, 0))
        if last is not None:
            lost = read_s[0] - last.last_s > longest_gap_s
            begin = float(read_s[0]) if lost else begin
            first, carried = _next_start(last, begin, unknown=lost or last.misfit > 1.0)
        else:
            begin, first = _first_start(record, begun, begin, float(read_s[0]), length_s, longest_gap_s)
        options = FitOptions(fixed=fixed, priors=priors, bounds=bounds, starts=[first], sample_masks=[mask])
        problem = FitProblem([record], fitted, about, options)
        # the parameters change little from one segment to the next, so that the search begins near its end
        values = np.array([p.value for p in problem.parameters]) if last is None else _carried_values(problem, last)
        fit = maximise(problem.evaluate, problem.parameters, values, problem.log_likelihoods)
        if fit.converged:
            problem.correct_meshes(fit.values)
            # one line of these is enough: every segment has the mesh of the record
            mesh_warnings += problem.mesh_warnings
            fit = maximise(problem.evaluate, problem.parameters, fit.values, problem.log_likelihoods)
        if not fit.converged or not np.all(np.isfinite(fit.covariance)):
            not_converged.append(f"{begin:g} to {end:g} s: {fit.describe()[0]}")
            left_out.append(not_converged[-1])
            continue
        misfit, factor = _misfit(problem, fit)
        gain = _of_march(problem.record_fits[0], fit.covariance)
        fit = replace(fit, covariance=factor**2 * fit.covariance)
        segment, slope = _segment(record, problem, fit, begin, end, count, misfit)
        with_before = np.zeros((len(gain), len(segments)))
        if last is not None:
            of_start = len(problem.record_fits[0].march_names)
            with_before = gain[:, of_start:] @ carried @ last.with_ratios
        gradient = _of_march(problem.record_fits[0], fit.covariance) @ slope
        ratios = np.block([[ratios, (slope @ with_before)[:, np.newaxis]], [slope @ with_before, slope @ gradient]])
        last = _Fitted(problem, fit, float(read_s[-1]), misfit, np.column_stack([with_before, gradient]))
        segments.append(segment)
    if not segments:
        nothing = f"{record.name}: no segment of {length_s:g} s can be fitted"
        raise RunError(f"{nothing}; {not_converged[0]}") if not_converged else InputError(f"{nothing}; {left_out[0]}")
    warnings = (*mesh_warnings[:1], *_misfit_warnings(record, segments))
    return Trend(record, fitted, tuple(segments), tuple(left_out), ratios, warnings)


def _made_start(
    record: Record,
    names: Sequence[str],
    reference: tuple[float, ...],
    fixed: Mapping[str, float] | None,
    start: Start | StartMaker,
) -> Start:
    """The start of the first segment, its temperatures estimated."""
    problem = FitProblem([record], names, reference, FitOptions(fixed=fixed))
    of_record = problem.record_fits[0]
    first_start = start(record, of_record.model, of_record.mesh) if callable(start) else start
    return with_estimated_profile(first_start)


def _check_read_after(record: Record, start_s: float, read_s: float, length_s: float) -> None:
    """Check that readings follow a start within the length of a segment."""
    if read_s - start_s > length_s:
        raise InputError(
            f"{record.name}: the first reading after the start at {start_s:g} s is at {read_s:g} s, more than a "
            f"segment of {length_s:g} s later; start at {read_s:g} s, with `lost` where readings before it are missing"
        )


def _misfit(problem: FitProblem, fit: Fit) -> tuple[float, float]:
    """RMS of the residuals of a segment over that of noise [-], and the factor on the sigmas that it asks for [-].

        factor = misfit sqrt((1 + c) / (1 - c)),   c their lag-1 autocorrelation, from 0 to 0.9

    Both are 1 where noise explains the residuals: chi-square of residuals and of unknowns with a prior, on as many
    degrees of freedom as there are samples less parameters with a flat prior. Source: docs/theory/clocks_and_starts.md,
    equation 7.
    """
    samples = problem.samples(fit.values)
    count = sum(len(s.mean_K) for s in samples)
    means, rng = np.array([p.value for p in problem.parameters]), np.random.default_rng(0)
    # drawn within their words, residuals are normal: scores of coarse words have longer tails than chi-square allows
    residuals = [quantile_residuals(s.channel.intervals, s.mean_K, s.spread_K, rng) for s in samples]
    square = float(sum(np.sum(e**2) for e in residuals))
    square += float(np.sum(fit.prior_information * (fit.values - means) ** 2))
    free = count - int(np.count_nonzero(fit.prior_information == 0.0))
    if free < 1 or chdtrc(free, square) > MISFIT_PROBABILITY:
        return 1.0, 1.0
    misfit = float(np.sqrt(square / free))
    colour = lag1_autocorrelation(samples) / rms_normalised_residual(samples) ** 2
    colour = min(max(colour, 0.0), MOST_COLOUR)
    return misfit, misfit * float(np.sqrt((1.0 + colour) / (1.0 - colour)))


def _misfit_warnings(record: Record, segments: Sequence[Segment]) -> list[str]:
    """One line where noise does not explain the residuals of some segments."""
    poor = [s for s in segments if s.misfit > 1.0]
    if not poor:
        return []
    worst = max(poor, key=lambda s: s.misfit)
    return [
        f"{record.name}: noise does not explain the residuals of {len(poor)} of {len(segments)} segments, up to "
        f"{worst.misfit:.1f} times as large at {worst.start_s:g} to {worst.end_s:g} s: the ratio changes within them, "
        "and their bounds are widened; use shorter segments, or estimate or fix a derivative"
    ]


def _windows(record: Record, length_s: float, begin_s: float) -> list[tuple[float, float]]:
    """Start and end of the short segments within the fit segments, from begin_s on."""
    first = max(record.time_s[0], record.conditions.time_s[0], begin_s)
    last = min(record.time_s[-1], record.conditions.time_s[-1])
    windows = []
    for a, b in record.declared.segments.fit or [[first, last]]:
        begin, end = max(a, first), min(b, last)
        edges = np.arange(begin, end, length_s)
        windows += [(float(t), float(t + length_s)) for t in edges]
    return sorted(windows)


def _carried_values(problem: FitProblem, last: _Fitted) -> FloatArray:
    """First values of a segment: those of the segment before it, without a change of its start."""
    before = dict(zip((u.label for u in last.problem.unknowns), last.fit.values, strict=True))
    # unknowns of the start are deviations from the temperatures at the end of the segment before: they begin at 0
    carried = {*problem.record_fits[0].march_names, *problem.record_fits[0].sensor_names}
    return np.array([before[p.name] if p.name in carried else p.value for p in problem.parameters])


def _of_march(record_fit: RecordFit, covariance: FloatArray) -> FloatArray:
    """The part of a covariance that belongs to the unknowns of the march, those of its start included."""
    of_march = record_fit.index[: record_fit.march_columns]
    return covariance[np.ix_(of_march, of_march)]


def _first_start(
    record: Record, begun: Start | None, begin_s: float, read_s: float, length_s: float, longest_gap_s: float
) -> tuple[float, Start | StartMaker | None]:
    """Time at which the first segment begins [s], and where it starts: as stated, as declared, or heated unknown.

    begun  : the start that is stated, if one is
    read_s : time of the segment's first reading [s]
    """
    if begun is not None:
        _check_read_after(record, begun.time_s, read_s, length_s)
        return begin_s, begun
    if read_s - record.conditions.time_s[0] > longest_gap_s:
        return read_s, partial(lost_start, time_s=read_s)
    return begin_s, None


def _next_start(last: _Fitted, time_s: float, *, unknown: bool) -> tuple[Start, FloatArray]:
    """Start at a later time from the fit of a segment: temperatures [K], and the largest directions of their error.

    unknown : whether the heating is unknown: since the last reading, or over a segment whose ratio was not constant
    returns : the start; (unknown of the start, unknown of the march) derivative of the former to errors of the latter
    """
    record_fit, values = last.problem.record_fits[0], last.fit.values
    T, S = state_at(record_fit, values, time_s)
    eigenvalues, vectors = np.linalg.eigh(last.of_march)
    root = np.sqrt(np.maximum(eigenvalues, 0.0))
    spread, count = S @ (vectors * root), DIRECTIONS
    if unknown:
        begin = record_fit.begin_s if last.misfit > 1.0 else last.last_s
        spread, count = np.hstack([spread, _unknown_since(record_fit, values, begin, time_s)]), LOST_DIRECTIONS
    columns, of_unknowns = largest_directions(spread, count)
    inverse = np.divide(1.0, root, out=np.zeros_like(root), where=root > 0.0)
    carried = of_unknowns[:, : len(root)] @ (vectors * inverse).T
    start = Start(time_s, T, columns, start_unknowns(columns.shape[1]), refined_at(record_fit, values, time_s))
    return start, carried


def _unknown_since(record_fit: RecordFit, values: FloatArray, begin_s: float, time_s: float) -> FloatArray:
    """(node, direction) what unknown heating from a time on leaves in the temperatures of a record [K]."""
    begin = max(begin_s, record_fit.begin_s)
    initial = record_fit.initial_K(values) if begin == record_fit.begin_s else state_at(record_fit, values, begin)[0]
    steps = march_times(record_fit.conditions, begin, time_s)
    model = record_fit.model_at(values)
    return after_unknown_heating(model, record_fit.mesh, record_fit.conditions, steps, initial, time_s)[1]


def state_at(record_fit: RecordFit, values: FloatArray, time_s: float) -> tuple[FloatArray, FloatArray]:
    """Node temperatures of a record at a time, and their sensitivities.

    values  : (parameter,);  time_s : [s]; before the start of the record, its initial temperatures
    returns : (node,) temperatures [K]; (node, unknown of the march) sensitivities [K] per unit of each unknown

    S_T of docs/theory/clocks_and_starts.md, equation 5.
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
        record_fit.model_at(values),
        record_fit.mesh,
        record_fit.march_names,
        np.array([time_s]),
        nodes,
        declared.initial_K,
        declared.initial_columns,
    )
    marched = LinearMarch([track], time, record_fit.history(time)).march()[0]
    return marched.temperature_K[:, 0], marched.sensitivity[:, 0]


def refined_at(record_fit: RecordFit, values: FloatArray, time_s: float) -> FloatArray:
    """Node temperatures of a record at a time on its refined mesh, which has twice as many elements.

    values  : (parameter,);  time_s : [s]; before the start of the record, its initial temperatures
    returns : (node of the refined mesh,) [K]

    The next segment needs them for its mesh correction, docs/theory/estimation_statistics.md, equation 31.
    """
    mesh, initial = halve_elements(record_fit.mesh), record_fit.refined_K(values)
    begin = record_fit.begin_s
    if time_s <= begin:
        return initial_temperatures(record_fit.model.construction, mesh) if initial is None else initial
    time = _steps_to(record_fit, time_s)
    return temperatures_at(record_fit.model_at(values), mesh, list(record_fit.history(time)), time, initial, time_s)[0]


def _steps_to(record_fit: RecordFit, time_s: float) -> FloatArray:
    """(step,) times of the march of a record [s] up to a time: those of its fit, and its samples beyond them."""
    plain = march_times(record_fit.conditions, record_fit.begin_s, time_s)
    return np.union1d(plain, record_fit.time_s[record_fit.time_s < plain[-1]])


def _segment(
    record: Record, problem: FitProblem, fit: Fit, begin: float, end: float, count: int, misfit: float
) -> tuple[Segment, FloatArray]:
    """A segment with its mean ratio; (unknown of the march,) derivative of that ratio."""
    record_fit = problem.record_fits[0]
    points_s = np.linspace(begin, min(end, record.conditions.time_s[-1]), CONDITION_POINTS)
    flown = record.conditions.at(points_s)
    x = np.column_stack([flown[v] for v in RATIO_VARIABLES])
    table, factor = declared_ratio(record.ratio_table, x), np.ones(len(x))
    linear = basis([p.name for p in RATIO], x, np.array(problem.reference), table)
    model = record_fit.model_at(fit.values)
    ratio, declared = table + linear @ [model.value(p.name) for p in RATIO], table
    if model.effects:
        ratio, factor, declared = _ratios_with_effects(record_fit, fit.values, points_s)
    slope = np.zeros(record_fit.march_columns)
    for k, name in enumerate(record_fit.march_names):
        if name in LINEAR_RATIO:
            slope[k] = np.mean(factor * linear[:, LINEAR_RATIO[name]])
    sigma = float(np.sqrt(slope @ _of_march(record_fit, fit.covariance) @ slope))
    m, condition = len(record_fit.march_names), tuple(float(v) for v in np.mean(x, axis=0))
    segment = Segment(
        begin,
        end,
        count,
        condition,
        float(np.mean(ratio)),
        sigma,
        fit.values[:m],
        fit.sigma[:m],
        float(np.mean(declared)),
        misfit,
    )
    return segment, slope


def _ratios_with_effects(
    record_fit: RecordFit, values: FloatArray, points_s: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """(point,) heating ratio of a fit with its effects [-], its derivative to the linear ratio, and that declared.

    The ratio is film coefficient over h_ref of the march, as effects may depend on the temperature of the wall.
    """
    model = record_fit.model_at(values)
    raised_model = model.with_parameters({RATIO_ITSELF: model.value(RATIO_ITSELF) + RATIO_STEP})
    # without the values that a fit sets or fixes
    declared_model = replace(record_fit.model, parameters={})
    ensemble = Ensemble([model, raised_model, declared_model], [record_fit.mesh] * 3)
    initial = record_fit.initial_K(values)
    if initial is not None:
        for i in range(3):
            ensemble.set_profile(i, initial)
    time = np.union1d(march_times(record_fit.conditions, record_fit.begin_s, float(points_s[-1])), points_s)
    films = ensemble.march(time, record_fit.history(time), keep=ensemble.film_offsets())
    films = films[np.searchsorted(time, points_s)]
    fitted, raised, declared = films.T / record_fit.conditions.at(points_s)["h_ref_kg_m2_s"]
    return fitted, (raised - fitted) / RATIO_STEP, declared
