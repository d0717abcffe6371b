"""95 % bands of predicted temperatures, from everything that is uncertain about a prediction.

The point is marched with each independent error at one standard deviation, all side by side
(`credibility.facts.contributors.dispersed_temperatures`); the changes add in squares. Errors are

    wall, effects   declared standard deviations, as in the uncertainty of a peak
    ratio table     its sigma along the flight, of one sign all along
    estimate        the principal axes of an estimate's covariance, in place of the priors of its parameters
    model           the smooth relative error of the heating (docs/theory/model_error.md, equation 1)
    trajectory      the directions in which a recorded flight may be another (there, equation 2)

Several estimates that the evidence cannot tell apart, each with its weight, make a mixture of normal distributions.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import ndtr

from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import RATIO_VARIABLES, Conditions
from sim_heating.base.errors import InputError
from sim_heating.base.parameters import AT, EFFECT_PREFIX
from sim_heating.closure.prior.model_error import MEASURED_FLIGHT, flight_error, heating_error_prior
from sim_heating.closure.revise.evidence import fitted_use
from sim_heating.credibility.facts.contributors import SCALE, dispersed_temperatures, varied_models
from sim_heating.estimation.inference.error_likelihood import STEP, scaled_heating
from sim_heating.estimation.inference.model_error import HeatingErrorPrior, ModelError
from sim_heating.estimation.report.estimate_file import Estimate
from sim_heating.heating.edge_flow import EdgeFlow
from sim_heating.heating.effects import combined_uses, use
from sim_heating.heating.ratio.uncertainty import declared_ratio, declared_sigma
from sim_heating.inputs.points import conditions_of_record, flow_of_record, point_of_record
from sim_heating.inputs.record import Record
from sim_heating.inputs.sensor_model import SensorErrors, lags_s
from sim_heating.march.history import BAND_PROBABILITY, Band, sensed_temperatures, values_at
from sim_heating.march.point import PointModel
from sim_heating.simulation.predict import Prediction, predict
from sim_heating.simulation.run import RunResult

KNOTS_A_TIME = 3.0
"""Knots of the model's error in each of its correlation times."""
MODEL_PREFIXES = ("ratio.", "stack.", "back.", EFFECT_PREFIX)
"""Beginnings of the parameters of an estimate that another flight of its point has; clocks and sensors are of one."""


@dataclass(frozen=True)
class Member:
    """An estimate as one possible truth, with its weight."""

    estimate: Estimate | None
    weight: float = 1.0


DECLARED = (Member(None),)
"""The declared model alone."""


@dataclass(frozen=True, eq=False)
class Spread:
    """Temperatures of one member: mean and standard deviation (channel, time) [K], and that of the surface at its
    hottest time by source [K]."""

    mean_K: FloatArray
    sigma_K: FloatArray
    sources: dict[str, float]


def estimated_names(model: PointModel, estimate: Estimate) -> dict[str, str]:
    """Name in the model -> name in an estimate, of the parameters that the point has.

    raises : InputError where it has none of the estimate
    """
    split = ((n, *n.partition(AT)[::2]) for n in estimate.parameters)
    names = {own: n for n, own, owner in split if own.startswith(MODEL_PREFIXES) and owner in ("", model.name)}
    if not names:
        raise InputError(f"{model.name}: the estimate has no parameter of this control point")
    return names


def estimated_model(model: PointModel, estimate: Estimate, values: dict[str, float] | None = None) -> PointModel:
    """A point with the parameters and effects of an estimate.

    values : by name in the model, in place of the estimated ones
    raises : InputError for values that the point cannot have
    """
    names = estimated_names(model, estimate)
    at = {own: estimate.parameters[n].value for own, n in names.items()} | (values or {})
    plain = {n: v for n, v in at.items() if not n.startswith(EFFECT_PREFIX)}
    effects = []
    for name in dict.fromkeys([*(e.name for e in estimate.effects), *(n.split(".")[1] for n in at if n not in plain)]):
        fitted = fitted_use(estimate, name)
        head = f"{EFFECT_PREFIX}{name}."
        changed = {n.removeprefix(head): v for n, v in at.items() if n.startswith(head)}
        if fitted is not None:
            named = zip((p.name for p in fitted.effect.parameters), fitted.values, strict=True)
            effects.append(use(name, dict(named) | changed))
    reference = tuple(estimate.reference_condition.values().tolist())
    return replace(
        model,
        parameters=dict(model.parameters) | plain,
        effects=combined_uses(model.effects, effects),
        reference=reference,
    )


def _estimate_errors(model: PointModel, estimate: Estimate) -> Iterator[PointModel]:
    """Models one standard deviation along each principal axis of an estimate's covariance, within its bounds."""
    names = estimated_names(model, estimate)
    values = estimate.values(list(names.values()))
    sigma = np.array([estimate.parameters[n].sigma for n in names.values()])
    variance, axes = np.linalg.eigh(estimate.correlation_matrix(list(names.values())))
    fitted = estimated_model(model, estimate)
    limits = np.array([(d.lower, d.upper) for d in map(fitted.definition, names)])
    for v, axis in zip(np.maximum(variance, 0.0), axes.T, strict=True):
        step = np.sqrt(v) * sigma * axis
        there = next(
            (t for t in (values + step, values - step) if np.all((t >= limits[:, 0]) & (t <= limits[:, 1]))),
            np.clip(values + step, limits[:, 0], limits[:, 1]),
        )
        yield estimated_model(model, estimate, dict(zip(names, there.tolist(), strict=True)))


def _table_error(model: PointModel, flown: Conditions) -> Conditions | None:
    """The conditions with the heating one sigma of the table higher; None where the table states none."""
    if model.ratio is None or not all(name in flown for name in RATIO_VARIABLES):
        return None
    x = np.stack([flown[name] for name in RATIO_VARIABLES], axis=1)
    sigma, ratio = declared_sigma(model.ratio, x), declared_ratio(model.ratio, x)
    if sigma is None:
        return None
    relative = np.divide(sigma, ratio, out=np.zeros_like(ratio), where=ratio > 0.0)
    return flown.with_columns(h_ref_kg_m2_s=flown["h_ref_kg_m2_s"] * (1.0 + relative))


def spread(
    model: PointModel,
    flown: Conditions,
    estimate: Estimate | None = None,
    heating: HeatingErrorPrior | None = MEASURED_FLIGHT,
    flights: Sequence[Conditions] = (),
    longest_step_s: float = 1.0,
) -> Spread:
    """Mean and standard deviation of a point's temperatures along a flight.

    model   : as declared;  flown : conditions with its reference heating
    heating : of the smooth error of the heating; None for a model without one
    flights : conditions of flights one standard deviation off, on the same times
    raises  : RunError where a step did not converge
    """
    central = model if estimate is None else estimated_model(model, estimate)
    names = [] if estimate is None else list(estimated_names(model, estimate))
    hottest = int(np.argmax(flown["h_ref_kg_m2_s"] * flown["H_r_J_kg"]))
    labels, variants = list[str](), list[tuple[PointModel, Conditions]]()

    def add(label: str, changed: PointModel, along: Conditions) -> None:
        labels.append(label)
        variants.append((changed, along))

    for name, changed in varied_models(central, flown, hottest):
        if name != SCALE and not any(central.same_parameter(name, n) for n in names):
            add(name, changed, flown)
    of_ratio = any(n.startswith("ratio.") for n in names)
    table = None if of_ratio else _table_error(central, flown)
    if table is not None:
        add("ratio table", central, table)
    for changed in () if estimate is None else _estimate_errors(model, estimate):
        add("estimate", changed, flown)
    for other in flights:
        add("trajectory", central, other)
    first = len(variants)
    knots = np.zeros(0)
    if heating is not None and heating.relative > 0.0:
        count = int(np.ceil(np.ptp(flown.time_s) / heating.middle_s * KNOTS_A_TIME)) + 1
        knots = np.linspace(flown.time_s[0], flown.time_s[-1], max(count, 2))
        variants += [(central, c) for c in scaled_heating(flown, knots)]
    marched = dispersed_temperatures(central, flown, variants, longest_step_s)
    sensors = slice(2, None)
    marched[:, sensors] = [sensed_temperatures(central, flown.time_s, T) for T in marched[:, sensors]]
    changes = marched[1:] - marched[0]
    if len(knots):
        response = np.moveaxis(changes[first:], 0, -1) / STEP
        none = response[..., :0]
        error = ModelError(knots, flown.time_s, response, none, None, heating.relative, heating.middle_s)  # type: ignore[union-attr]
        changes = np.concatenate(
            [changes[:first], np.moveaxis(response @ (error.sigma * error.correlation_root), -1, 0)]
        )
        labels += ["model"] * len(knots)
    peak = int(np.argmax(marched[0, 0]))
    squares = dict.fromkeys(labels, 0.0)
    for label, change in zip(labels, changes[:, 0, peak], strict=True):
        squares[label] += float(change) ** 2
    ordered = dict(sorted(((n, s**0.5) for n, s in squares.items()), key=lambda item: -item[1]))
    return Spread(marched[0], np.sqrt(np.sum(changes**2, axis=0)), ordered)


def mixture_quantile(spreads: Sequence[Spread], weights: Sequence[float], probability: float) -> FloatArray:
    """(channel, time) temperature that a mixture of normal distributions is below with a probability [K]."""
    share = np.asarray(weights, dtype=float) / np.sum(weights)
    mean = np.array([s.mean_K for s in spreads])
    sigma = np.maximum([s.sigma_K for s in spreads], 1e-6)
    low, high = np.min(mean - 10.0 * sigma, axis=0), np.max(mean + 10.0 * sigma, axis=0)
    for _ in range(50):  # bisection: 20 sigma to 1e-14 of that
        middle = 0.5 * (low + high)
        below = np.tensordot(share, ndtr((middle - mean) / sigma), 1) < probability
        low, high = np.where(below, middle, low), np.where(below, high, middle)
    return np.asarray(0.5 * (low + high))


def _band(spreads: Sequence[Spread], members: Sequence[Member]) -> Band:
    weights = [m.weight for m in members]
    low, high = (
        mixture_quantile(spreads, weights, p) for p in (0.5 - 0.5 * BAND_PROBABILITY, 0.5 + 0.5 * BAND_PROBABILITY)
    )
    heaviest = spreads[int(np.argmax(weights))]
    sources = dict(heaviest.sources)
    if len(spreads) > 1:
        share, peak = np.asarray(weights) / np.sum(weights), int(np.argmax(heaviest.mean_K[0]))
        means = np.array([s.mean_K[0, peak] for s in spreads])
        sources["members"] = float(np.sqrt(share @ (means - share @ means) ** 2))
    return Band(low, high, sources)


def _other_flights(record: Record, times_s: FloatArray) -> list[Conditions]:
    """Conditions of the flights that a record's trajectory may have been, one standard deviation off each."""
    error = flight_error(record)
    if error is None:
        return []
    return [conditions_of_record(error.record(f)).at(times_s) for f in np.eye(len(error.directions))]


def predict_with_band(
    record: Record,
    members: Sequence[Member] = DECLARED,
    model: PointModel | None = None,
    flow: EdgeFlow | None = None,
) -> Prediction:
    """A prediction of a record with its 95 % band; the temperatures are those of the heaviest member.

    model, flow : in place of the record's own, before the estimates
    raises : as `predict`; InputError where an estimate is of another point
    """
    heaviest = max(members, key=lambda m: m.weight).estimate
    declared, errors = point_of_record(record) if model is None else model, dict[str, SensorErrors]()
    declared = declared.with_lags(lags_s(record.sensors, errors))
    central = declared if heaviest is None else estimated_model(declared, heaviest)
    found = predict(record, central, flow=flow or flow_of_record(record, central.effects))
    flown, t = found.conditions, record.time_s
    inside = t[(t >= flown.time_s[0]) & (t <= flown.time_s[-1])]
    times = np.union1d(flown.time_s, inside)
    others, prior = _other_flights(record, times), heating_error_prior(record)
    spreads = [spread(declared, flown.at(times), m.estimate, prior, others) for m in members]
    band = _band(spreads, members)
    at_samples = replace(band, low_K=values_at(times, band.low_K, t), high_K=values_at(times, band.high_K, t))
    return replace(found, history=replace(found.history, band=at_samples))


def with_bands(result: RunResult, members: Sequence[Member] = DECLARED) -> RunResult:
    """A run with the 95 % bands of all its control points; its flight counts as exact.

    An estimate acts at its control point alone; the temperatures of the run stay those of the declared model.
    """
    step_s = result.scenario.declared.heating.longest_step_s
    points = {}
    for name, point in result.points.items():
        spreads = []
        for member in members:
            estimate = member.estimate
            if estimate is not None and estimate.control_point not in (None, name):
                estimate = None
            spreads.append(spread(point.model, point.conditions, estimate, longest_step_s=step_s))
        points[name] = replace(point, history=replace(point.history, band=_band(spreads, members)))
    return replace(result, points=points)
