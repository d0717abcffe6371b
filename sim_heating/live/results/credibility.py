"""What supports the estimates of a link, factor by factor."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.base.files import file_digest
from sim_heating.credibility.facts.of_records import MODEL_ERROR_RATIO, of_several, ratio_uncertainty
from sim_heating.credibility.facts.sources import DeclaredInput, conditions_of_record, inputs_of_point, inputs_of_record
from sim_heating.credibility.facts.topics import topics_of_points, topics_of_record
from sim_heating.credibility.reviews import digest_of
from sim_heating.credibility.statement import LARGEST_SHARE, NO_READINGS, SIGMAS, Answer, Facts, Statement, assess
from sim_heating.credibility.validation.own_cases import samples_of
from sim_heating.credibility.validation.region import Samples
from sim_heating.heating.recorded.reading import lowered_confidence
from sim_heating.inputs.record import Record, load_record
from sim_heating.live.engine import LinkEngine
from sim_heating.live.filtering.points import LivePoint
from sim_heating.live.spec import Link, Replay
from sim_heating.live.state import PointState, State

RUNNING_FILTER = "running filter"
"""Topic of the estimate that goes on with the flight."""


def credibility_of_link(
    engine: LinkEngine, state: State, records: Mapping[str, Record], files: Mapping[str, Path]
) -> Statement:
    """The credibility statement of a link that has ended.

    state   : the last one
    records : what came, by control point; a point that is not among them has no conditions to compare
    files   : that the result was made from, in words
    """
    link = engine.link
    points = [p for p in engine.estimator.points if p.name in state.points] or list(engine.estimator.points)
    # of several points the statement's uncertainty is that of the one nearest to a limit
    points.sort(key=lambda p: _margin_K(state.points.get(p.name)))
    facts = of_several([_facts(engine, p, state, records.get(p.name)) for p in points])
    digests = {name: file_digest(path) for name, path in files.items() if path.is_file()}
    conditions = tuple(_conditions(link, engine.arrivals.has_model_density))
    return assess(replace(facts, conditions=conditions, files={**facts.files, **digests}))


def _facts(engine: LinkEngine, point: LivePoint, state: State, record: Record | None) -> Facts:
    link, vehicle, state_of_point = engine.link, engine.link.vehicle, state.points.get(point.name)
    if vehicle is not None:
        declared_point = vehicle.control_point(point.name)
        model, digest = inputs_of_point(vehicle, declared_point, point.model.effects), digest_of(vehicle)
        topics = topics_of_points(vehicle, [declared_point], [point.model])
        folder, name = vehicle.directory, f"vehicle {vehicle.name}"
    else:
        declared = link.records[point.name]
        model, digest = inputs_of_record(declared, point.model.effects), digest_of(declared)
        topics = topics_of_record(declared, point.model)
        folder, name = declared.directory, f"record {declared.name}"
    history = engine.followed.estimates(point.name)
    samples: tuple[Samples, ...] = ()
    if record is not None and history:
        t, flown = history["time_s"], record.conditions
        # after a clock that jumped, estimates of the other stretch have no conditions here
        is_usable = np.isfinite(history["surface_K"]) & (t >= flown.time_s[0]) & (t <= flown.time_s[-1])
        times, rows = np.unique(t[is_usable], return_index=True)
        if len(times) > 1:
            samples = (samples_of(flown.at(times), history["surface_K"][is_usable][rows]),)
    read = _readings(engine, point.name)
    sigma = {n: p.sigma for n, p in state_of_point.parameters.items()} if state_of_point is not None else {}
    return Facts(
        kind="link",
        topics=frozenset({*topics, RUNNING_FILTER, "sensitivities"}),
        model=tuple(dict.fromkeys(model)),
        conditions=(),
        files={name: digest},
        samples=samples,
        sigma=bool(sigma),
        uncertainty=None if record is None else ratio_uncertainty(sigma, [record], point.model.reference),
        consistent=_consistent(state, read),
        holds=_keeps_limits(point.name, state_of_point),
        varied=Answer(False, "no data were held out"),
        own_share=_share_of_rise(read),
        own_noise=_consistent(state, read) if len(read.read_K) else NO_READINGS,
        folder=folder,
        reviewed=digest,
    )


def _conditions(link: Link, has_model_density: bool) -> list[DeclaredInput]:
    """Where the flight conditions come from: what a replay sends again, or whoever sends them.

    has_model_density : whether their density is of the standard atmosphere, which lowers their confidence
    """
    confidence = lowered_confidence("") if has_model_density else ""
    inputs: list[DeclaredInput] = []
    for source in link.declared.source:
        if isinstance(source, Replay):
            first = (link.declared.records or [""])[0]
            record = load_record(link.file(source.record or first, "`record`"), root=link.root)
            inputs += conditions_of_record(record)
        else:
            # what flies and measures is beyond the link: it knows the address and no more
            inputs.append(DeclaredInput(f"telemetry of source {source.kind}", "", confidence, measured=True))
    return list(dict.fromkeys(inputs))


def _margin_K(point: PointState | None) -> float:
    """Distance of a control point to its limits at the end [K], infinite where it has none."""
    return math.inf if point is None or point.margin_K is None else point.margin_K


@dataclass(frozen=True, eq=False)
class _Readings:
    """Readings of the sensors of a point that did not fail.

    read_K     : (reading,) [K];  missed_K : (reading,) less what was expected before they were taken [K]
    normalised : (reading,) that over its standard deviation, noise and rounding included [-]
    """

    read_K: FloatArray
    missed_K: FloatArray
    normalised: FloatArray


def _readings(engine: LinkEngine, point: str) -> _Readings:
    failed = {f.sensor for f in engine.checks.failures if f.point == point}
    columns = [np.zeros((3, 0))]
    for name, columns_of in engine.followed.readings(point).items():
        if name not in failed:
            missed_K = columns_of["read_K"] - columns_of["expected_K"]
            sigma_K = np.hypot(columns_of["sigma_K"], engine.link.sensor(point, name).lsb_K / math.sqrt(12.0))
            columns.append(np.stack([columns_of["read_K"], missed_K, missed_K / sigma_K]))
    every = np.concatenate(columns, axis=1)
    return _Readings(*every[:, np.all(np.isfinite(every), axis=0)])


def _consistent(state: State, readings: _Readings) -> Answer:
    """Whether readings differ from what was expected by their noise, and nothing was found missing."""
    if state.missing.alarm:
        return Answer(False, state.missing.text)
    if not len(readings.normalised):
        return Answer(False, "no readings")
    rms = float(np.sqrt(np.mean(readings.normalised**2)))
    return Answer(rms <= MODEL_ERROR_RATIO, f"readings differ from what was expected by {rms:.2f} sigma (RMS)")


def _share_of_rise(readings: _Readings) -> Answer:
    """Whether what was expected of the readings misses them by a small part of their rise [K]."""
    if not len(readings.read_K):
        return NO_READINGS
    rise_K, rmse = float(np.ptp(readings.read_K)), float(np.sqrt(np.mean(readings.missed_K**2)))
    text = f"its own readings are missed by {rmse:.3g} K of a rise of {rise_K:.3g} K, each before it was taken"
    return Answer(rmse <= LARGEST_SHARE * rise_K, text)


def _keeps_limits(point: str, state: PointState | None) -> Answer:
    """Whether the surface keeps its limit at the end by two standard deviations."""
    if state is None or state.margin_K is None:
        return Answer(False, "no control point has a temperature limit")
    bound_K = SIGMAS * max(state.surface_sigma_K, state.bondline_sigma_K)
    text = f"{point}: margin {state.margin_K:.0f} K at the end, two sigma {bound_K:.2g} K"
    return Answer(state.margin_K > bound_K, text)
