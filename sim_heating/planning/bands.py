"""95 % bands of predicted temperatures, from everything that is uncertain about a prediction.

The point is marched with each independent error at one standard deviation, all side by side
(`credibility.facts.contributors.dispersed_temperatures`); the changes add in squares. Parameters of effects are at the
end of their own band, of which the change is a part of 1.96: that of an onset is as large as the rise there. Errors are

    wall, effects   declared standard deviations, as in the uncertainty of a peak
    ratio table     its sigma along the flight, of one sign all along
    estimate        the principal axes of an estimate's covariance, in place of the priors of its parameters
    model           the smooth relative error of the heating (docs/theory/model_error.md, equation 1)
    trajectory      the directions in which a recorded flight may be another (there, equation 2)

A wall that the fit of an estimate held, and that is other than declared, has given it other values: both change at
once, as `estimate` (considered.py). The size of the heating's error is what the fitted flights say, or that of its
prior. Several sizes, and several estimates that the evidence cannot tell apart, each with its weight, make a mixture of
normal distributions.
"""

from __future__ import annotations

import os
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.special import ndtr, ndtri

from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import RATIO_VARIABLES, Conditions
from sim_heating.base.errors import InputError, error_context
from sim_heating.base.files import check, display_path, read_toml, suggestion
from sim_heating.base.files.text import first_of
from sim_heating.base.parameters import AT, EFFECT_PREFIX, MODEL
from sim_heating.closure.prior.model_error import MEASURED_FLIGHT, other_flight, stated_error
from sim_heating.closure.revise.evidence import fitted_use
from sim_heating.credibility.facts.contributors import SCALE, dispersed_temperatures, varied_models
from sim_heating.estimation.inference.error_likelihood import STEP, scaled_heating
from sim_heating.estimation.inference.model_error import ErrorSize, HeatingErrorPrior
from sim_heating.estimation.report.estimate_file import Estimate, read_estimate
from sim_heating.heating.edge_flow import EdgeFlow
from sim_heating.heating.effects import EffectUse, combined_uses, use
from sim_heating.heating.ratio.uncertainty import declared_ratio, declared_sigma
from sim_heating.inputs.fit_settings import FitSettings
from sim_heating.inputs.points import conditions_of_record, flow_of_record, point_of_record
from sim_heating.inputs.record import Record
from sim_heating.inputs.sensor_model import SensorErrors, lags_s
from sim_heating.march.history import BAND_PROBABILITY, Band, sensed_temperatures, values_at
from sim_heating.march.point import PointModel
from sim_heating.planning.considered import Considered, considered, fitted_records
from sim_heating.simulation.predict import Prediction, predict
from sim_heating.simulation.run import RunResult

KNOTS_A_TIME, MOST_KNOTS = 2.0, 100
"""Knots of the model's error in each of its shortest correlation times, and their largest number."""
HEATED = 0.01
"""Part of the highest heating of a cold wall above which the model's error has knots of its own [-]."""
LEAST_TIME = 0.02
"""Weight of a correlation time below which the knots need not follow it [-]."""
LEAST_WEIGHT = 1e-3
"""Weight of a size of the heating's error below which it is left out [-]."""
EFFECT_STEP = float(ndtri(0.5 + 0.5 * BAND_PROBABILITY))
"""Standard deviations by which parameters of effects are off [-]: those at which a band ends."""
SHOWN = 6
"""Control points that a message names."""
MODEL_PREFIXES = ("ratio.", "stack.", "back.", EFFECT_PREFIX)
"""Beginnings of the parameters of an estimate that another flight of its point has; clocks and sensors are of one."""


@dataclass(frozen=True)
class Member:
    """An estimate as one possible truth, with its weight, and what it leaves open for another flight.

    considered : None where nothing but its own covariance is known
    source     : the file of its estimate, for messages
    """

    estimate: Estimate | None
    weight: float = 1.0
    considered: Considered | None = None
    source: str = "estimate"


def read_member(
    path: str | os.PathLike[str], weight: float = 1.0, root: str | os.PathLike[str] | None = None
) -> Member:
    """An estimate.json, or the one in a directory, or the priors of a file of settings, as a member.

    raises : InputError where it cannot be read, or the records that were fitted are not there or were changed
    """
    if Path(path).suffix == ".toml":
        return Member(priors_as_estimate(path), weight, source=display_path(path))
    estimate = read_estimate(path)
    known = considered(estimate, fitted_records(estimate, path, root))
    return Member(estimate, weight, known, display_path(path))


def priors_as_estimate(path: str | os.PathLike[str]) -> Estimate:
    """The priors of a file of settings, such as `next_flight.toml` of a campaign, as an estimate without records.

    raises : InputError where the file cannot be read, or states no prior, or one of a derivative, whose reference
             condition a model of another flight would need
    """
    priors = {n: p for n, p in read_toml(path, FitSettings).priors.items() if np.isfinite(p[1])}
    derivatives = [name for name in priors if name.startswith("ratio.d_")]
    if derivatives or not priors:
        rule = f"`{derivatives[0]}` is of a fit alone" if derivatives else "states no [mean, sigma] of a parameter"
        raise InputError(f"{display_path(path)}, [prior]: {rule}; give an estimate.json, or priors of the wall")
    parameters = {
        n: {"value": mean, "sigma": sigma, "unit": MODEL[own].unit if (own := n.partition(AT)[0]) in MODEL else ""}
        for n, (mean, sigma) in priors.items()
    }
    stated = {"format": "estimate/1", "records": [str(path)], "converged": True, "iterations": 0}
    anywhere = dict.fromkeys(RATIO_VARIABLES, 0.0)
    return check(stated | {"reference_condition": anywhere, "parameters": parameters}, Estimate, display_path(path))


DECLARED = (Member(None),)
"""The declared model alone."""


@dataclass(frozen=True, eq=False)
class Spread:
    """Temperatures of one member: mean and standard deviation (channel, time) [K], and that of the surface at its
    hottest time by source [K]; weight : of one of several sizes of the heating's error."""

    mean_K: FloatArray
    sigma_K: FloatArray
    sources: dict[str, float]
    weight: float = 1.0


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
    return replace(
        model,
        parameters=dict(model.parameters) | plain,
        effects=combined_uses(model.effects, _estimated_effects(estimate, at)),
        reference=tuple(estimate.reference_condition.values().tolist()),
    )


def _estimated_effects(estimate: Estimate, at: Mapping[str, float]) -> Iterator[EffectUse]:
    """Effects of an estimate; at : values of parameters by their names in the model."""
    named = (n.split(".")[1] for n in at if n.startswith(EFFECT_PREFIX))
    for name in dict.fromkeys([*(e.name for e in estimate.effects), *named]):
        fitted = fitted_use(estimate, name)
        head = f"{EFFECT_PREFIX}{name}."
        changed = {n.removeprefix(head): v for n, v in at.items() if n.startswith(head)}
        if fitted is not None:
            values = zip((p.name for p in fitted.effect.parameters), fitted.values, strict=True)
            yield use(name, dict(values) | changed)


def model_of_member(model: PointModel, member: Member) -> PointModel:
    """A point as it is by a member: as declared, or with the parameters and effects of the member's estimate.

    raises : InputError with the member's file, as `estimated_model`
    """
    if member.estimate is None:
        return model
    with error_context(member.source):
        return estimated_model(model, member.estimate)


def open_parameters(model: PointModel, member: Member) -> dict[str, tuple[str, float]]:
    """Name in the model -> label and value of what an estimate leaves open of a point, walls that its fit held among
    them."""
    estimate, known = member.estimate, member.considered
    assert estimate is not None  # asked for with one
    found = {n: (label, estimate.parameters[label].value) for n, label in estimated_names(model, estimate).items()}
    if known is None:
        return found
    fitted = estimated_model(model, estimate)
    for label in known.names[len(estimate.parameters) :]:
        name, _, owner = label.partition(AT)
        if owner in ("", model.name):
            found[name] = label, float(fitted.values[fitted.places[name]])
    return found


def open_covariance(member: Member, labels: Sequence[str]) -> FloatArray:
    """(label, label) covariance of what an estimate leaves open, each in its unit."""
    assert member.estimate is not None  # asked for with one
    if member.considered is None:
        return member.estimate.covariance(list(labels))
    at = [member.considered.names.index(label) for label in labels]
    return np.asarray(member.considered.covariance[np.ix_(at, at)])


def principal_steps(covariance: FloatArray) -> FloatArray:
    """(parameter, axis) steps of one standard deviation along the principal axes of a covariance, the largest first.

    Independent standard normal numbers times these have the covariance.
    """
    sigma = np.sqrt(np.diag(covariance))
    scale = np.where(sigma > 0.0, sigma, 1.0)
    variance, axes = np.linalg.eigh(covariance / np.outer(scale, scale))
    return np.asarray(sigma[:, np.newaxis] * axes * np.sqrt(np.maximum(variance, 0.0)))[:, ::-1]


def _estimate_errors(model: PointModel, member: Member) -> Iterator[PointModel]:
    """Models one standard deviation along each principal axis of what an estimate leaves open, within its bounds."""
    assert member.estimate is not None  # asked for with one
    found = open_parameters(model, member)
    at = np.array([value for _, value in found.values()])
    fitted = estimated_model(model, member.estimate)
    low, high = np.array([(d.lower, d.upper) for d in map(fitted.definition, found)]).T
    for step in principal_steps(open_covariance(member, [label for label, _ in found.values()])).T:
        there = next(
            (t for t in (at + step, at - step) if np.all((t >= low) & (t <= high))), np.clip(at + step, low, high)
        )
        yield estimated_model(model, member.estimate, dict(zip(found, there.tolist(), strict=True)))


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


def heating_sizes(prior: HeatingErrorPrior | None, member: Member) -> ErrorSize | None:
    """Sizes and correlation times of the heating's error: as the flights behind a member say, else as the prior has
    them; None without an error.

    Source: docs/theory/model_error.md, equation 5.
    """
    known = None if member.considered is None else member.considered.size
    if known is not None:
        return known
    if prior is None or prior.relative == 0.0:
        return None
    sizes, correlations, log_weight = prior.grid()
    return ErrorSize(sizes, correlations, np.ones(1), np.zeros((1, *log_weight.shape)), log_weight[np.newaxis])


def _errors_of_point(
    model: PointModel, flown: Conditions, member: Member, with_table: bool
) -> Iterator[tuple[str, PointModel, Conditions]]:
    """Label, model and conditions of each error of a point at one sigma: wall, effects (at EFFECT_STEP), ratio table,
    estimate."""
    if member.estimate is None:
        central, names = model, list[str]()
    else:
        central, names = estimated_model(model, member.estimate), list(open_parameters(model, member))
    hottest = int(np.argmax(flown["h_ref_kg_m2_s"] * flown["H_r_J_kg"]))
    for name, changed in varied_models(central, flown, hottest, EFFECT_STEP):
        if name != SCALE and not any(central.same_parameter(name, n) for n in names):
            yield name, changed, flown
    if with_table and not any(n.startswith("ratio.") for n in names):
        table = _table_error(central, flown)
        if table is not None:
            yield "ratio table", central, table
    if member.estimate is not None:
        yield from (("estimate", changed, flown) for changed in _estimate_errors(model, member))


def error_knots(flown: Conditions, sizes: ErrorSize) -> FloatArray:
    """Times [s] of the knots of the heating's error, KNOTS_A_TIME in its shortest correlation time while it is hot."""
    flux = flown["h_ref_kg_m2_s"] * flown["H_r_J_kg"]
    heated_s = flown.time_s[flux >= HEATED * np.max(flux)]
    likely = zip(sizes.correlations, np.sum(sizes.posterior_of_heating, axis=1), strict=True)
    shortest_s = min(correlation.time_s for correlation, p in likely if p > LEAST_TIME)
    count = int(np.ceil(np.ptp(heated_s) / shortest_s * KNOTS_A_TIME)) + 1
    return np.linspace(heated_s[0], heated_s[-1], min(max(count, 2), MOST_KNOTS))


def spreads(
    model: PointModel,
    flown: Conditions,
    member: Member = DECLARED[0],
    heating: HeatingErrorPrior | None = MEASURED_FLIGHT,
    flights: Sequence[Conditions] = (),
    longest_step_s: float = 1.0,
    *,
    with_table: bool = True,
) -> list[Spread]:
    """Mean and standard deviation of a point's temperatures along a flight, for each size of the heating's error.

    model   : as declared;  flown : conditions with its reference heating
    heating : prior of the smooth error of the heating; None for a model without one
    flights : conditions of flights one standard deviation off, on the same times
    with_table : whether the sigma of the ratio table counts
    raises  : RunError where a step did not converge
    """
    central = model_of_member(model, member)
    errors = [*_errors_of_point(model, flown, member, with_table), *(("trajectory", central, f) for f in flights)]
    labels, variants = [label for label, *_ in errors], [(changed, along) for _, changed, along in errors]
    first, sizes, knots = len(variants), heating_sizes(heating, member), np.zeros(0)
    if sizes is not None:
        knots = error_knots(flown, sizes)
        variants += [(central, c) for c in scaled_heating(flown, knots)]
    marched = dispersed_temperatures(central, flown, variants, longest_step_s)
    sensors = slice(2, None)
    marched[:, sensors] = [sensed_temperatures(central, flown.time_s, T) for T in marched[:, sensors]]
    changes = marched[1:] - marched[0]
    for label, change in zip(labels, changes[:first], strict=True):
        change /= EFFECT_STEP if label.startswith(EFFECT_PREFIX) else 1.0
    peak = int(np.argmax(marched[0, 0]))
    squares = dict.fromkeys(labels, 0.0)
    for label, change in zip(labels, changes[:first, 0, peak], strict=True):
        squares[label] += float(change) ** 2
    other = np.sum(changes[:first] ** 2, axis=0)
    by_size, weights, expected = [other], np.ones(1), 0.0
    if sizes is not None:
        by_size, weights = _with_model_error(other, changes[first:], knots, sizes)
        expected = float(sum(w * (s - other)[0, peak] for w, s in zip(weights, by_size, strict=True)))
        squares["model"] = expected
    ordered = dict(sorted(((n, s**0.5) for n, s in squares.items()), key=lambda item: -item[1]))
    return [Spread(marched[0], np.sqrt(s), ordered, float(w)) for s, w in zip(by_size, weights, strict=True)]


def _with_model_error(
    other_K2: FloatArray, changes_K: FloatArray, knots_s: FloatArray, known: ErrorSize
) -> tuple[list[FloatArray], FloatArray]:
    """(channel, time) variances for each size of the heating's error [K2], and (size,) weights.

    other_K2  : (channel, time) variance by all else
    changes_K : (knot, channel, time) change of the temperatures by STEP of the heating at each knot

    Source: docs/theory/model_error.md, equations 1, 1a and 5.
    """
    response, probability = np.moveaxis(changes_K, 0, -1) / STEP, known.posterior_of_heating
    roots = [correlation.root(knots_s) for correlation in known.correlations]
    by_time = np.array([np.sum((response @ root) ** 2, axis=-1) for root in roots])
    weights = np.sum(probability, axis=0)
    kept = np.flatnonzero(weights > LEAST_WEIGHT)
    variances = [
        other_K2 + known.sizes[k] ** 2 * np.tensordot(probability[:, k] / weights[k], by_time, 1) for k in kept
    ]
    return variances, weights[kept] / np.sum(weights[kept])


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


def band_of(of_members: Sequence[Sequence[Spread]], members: Sequence[Member]) -> Band:
    """The 95 % band of a mixture of members, each with its temperatures for each size of the heating's error."""
    every = [s for spread in of_members for s in spread]
    weights = [m.weight * s.weight for m, spread in zip(members, of_members, strict=True) for s in spread]
    low, high = (
        mixture_quantile(every, weights, p) for p in (0.5 - 0.5 * BAND_PROBABILITY, 0.5 + 0.5 * BAND_PROBABILITY)
    )
    heaviest = of_members[int(np.argmax([m.weight for m in members]))][0]
    sources = dict(heaviest.sources)
    if len(members) > 1:
        share, peak = np.array([m.weight for m in members]), int(np.argmax(heaviest.mean_K[0]))
        share = share / np.sum(share)
        means = np.array([spread[0].mean_K[0, peak] for spread in of_members])
        sources["members"] = float(np.sqrt(share @ (means - share @ means) ** 2))
    return Band(low, high, sources)


def _other_flights(record: Record, times_s: FloatArray) -> list[Conditions]:
    """Conditions of the flights that a record's trajectory may have been, one standard deviation off each."""
    other = other_flight(record)
    if other is None:
        return []
    return [conditions_of_record(other.record(f)).at(times_s) for f in np.eye(len(other.directions))]


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
    heaviest = max(members, key=lambda m: m.weight)
    declared, errors = point_of_record(record) if model is None else model, dict[str, SensorErrors]()
    declared = declared.with_lags(lags_s(record.sensors, errors))
    central = model_of_member(declared, heaviest)
    found = predict(record, central, flow=flow or flow_of_record(record, central.effects))
    flown, t = found.conditions, record.time_s
    inside = t[(t >= flown.time_s[0]) & (t <= flown.time_s[-1])]
    times = np.union1d(flown.time_s, inside)
    others, prior = _other_flights(record, times), stated_error(record).heating
    band = band_of([spreads(declared, flown.at(times), m, prior, others) for m in members], members)
    at_samples = replace(band, low_K=values_at(times, band.low_K, t), high_K=values_at(times, band.high_K, t))
    return replace(found, history=replace(found.history, band=at_samples))


def members_of_point(members: Sequence[Member], name: str) -> list[Member]:
    """The members for a control point: an estimate of others leaves it as declared, with its weight."""

    def is_of_point(estimate: Estimate) -> bool:
        owners = {label.partition(AT)[2] for label in estimate.parameters}
        return estimate.control_point in (None, name) and bool(owners & {"", name})

    return [m if m.estimate is None or is_of_point(m.estimate) else Member(None, m.weight) for m in members]


def require_points(members: Sequence[Member], names: Sequence[str], of_vehicle: Collection[str]) -> None:
    """Check the control points that estimates are of, by name: those of a run or a study, and all of the vehicle.

    raises : InputError with the member's file for an estimate of none of the run's points, or for a prior of a point
             that the vehicle does not have; parameters of a fit may also be of its records
    """
    for m in members:
        if m.estimate is None:
            continue
        owners = {label.partition(AT)[2] for label in m.estimate.parameters}
        of_points = {m.estimate.control_point} if m.estimate.control_point else owners
        absent = sorted(of_points - {"", *of_vehicle}) if m.considered is None else []
        if absent:
            raise InputError(f"{m.source}: the vehicle has no control point `{absent[0]}`{_hint(absent[0], names)}")
        if not {"", *names} & of_points:
            other = min(of_points)
            raise InputError(f"{m.source}: is of no control point of the run, but of `{other}`{_hint(other, names)}")


def _hint(name: str, names: Sequence[str]) -> str:
    """The control point that was probably meant, else those that there are."""
    return suggestion(name, names, otherwise=f"; points of the run: {first_of(names, SHOWN)}")


def with_bands(result: RunResult, members: Sequence[Member] = DECLARED) -> RunResult:
    """A run with the 95 % bands of all its control points; its flight counts as exact.

    An estimate acts at its control point alone; the temperatures of the run stay those of the declared model.
    raises : InputError for a member that is of none of the control points
    """
    require_points(members, list(result.points), result.scenario.vehicle.control_points)
    step_s = result.scenario.declared.heating.longest_step_s
    points = {}
    for name, point in result.points.items():
        own = members_of_point(members, name)
        found = [spreads(point.model, point.conditions, m, longest_step_s=step_s) for m in own]
        points[name] = replace(point, history=replace(point.history, band=band_of(found, own)))
    return replace(result, points=points)
