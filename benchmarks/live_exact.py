"""The running estimate against the batch filter, itself with samples in another order, and `estimate`."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from benchmarks.measure import Figure
from sim_heating.base.arrays import FloatArray
from sim_heating.estimation.filter.march import FilterMarch, FilterTrack
from sim_heating.estimation.filter.online import Prior
from sim_heating.estimation.fit import estimate
from sim_heating.estimation.inference.likelihood import reading_intervals
from sim_heating.estimation.record_fit import least_sigma_K
from sim_heating.inputs.points import conditions_of_record
from sim_heating.live.filtering.estimates import LiveOptions
from sim_heating.live.filtering.estimator import LiveEstimator
from sim_heating.live.filtering.parameters import default_prior
from sim_heating.live.filtering.points import RecordPoints
from sim_heating.live.types import Frame, Reading, Sample
from sim_heating.march.ensemble import condition_history
from tests.support.filter_samples import samples_on_grid
from tests.support.live_streams import SIX, BadLink, Flight, cut, known_flight, practice, samples_of_record

NULL = ("p06", "p07")
"""Practice records without an effect."""
ENOUGH_INFORMED = 0.5
"""A parameter is compared where the readings leave less than this of its prior standard deviation [-]."""
SEED, REORDERED_S = 7, 1.9
EXACT, LARGEST_APART, LARGEST_SIGMA_APART = 1e-9, 0.3, 0.15


def fed(e: LiveEstimator, samples: list[Sample]) -> LiveEstimator:
    """An estimator that was given samples one by one."""
    for sample in samples:
        e.add(sample)
        e.advance()
    return e


def final(e: LiveEstimator) -> list[FloatArray]:
    """Temperatures, standard deviations, values and covariances of all points."""
    found = [x.state for x in e.estimates().values()]
    return [a for s in found for a in (s.temperature_K, s.sigma_K, s.values, s.covariance)]


def prior_of(e: LiveEstimator, names: tuple[str, ...]) -> dict[str, Prior]:
    """Priors of the first point of an estimator that was given none."""
    return {n: default_prior(e.points[0].model, n) for n in names}


def apart_from_batch(flight: Flight, names: tuple[str, ...] = SIX) -> float:
    """Largest difference of values and covariance from the batch filter in one call, over the standard deviations [-].

    Both are linearised at the priors' means all along, and begin with the same temperatures.
    """
    options = LiveOptions(linearise_s=math.inf, again_s=math.inf, wait_s=0.0, start="readings", corrects_mesh=False)
    e = fed(LiveEstimator(flight.source, names, options=options), flight.samples)
    prior = prior_of(e, names)
    time_s = np.array([s.time_s for s in flight.samples if isinstance(s, Frame)])
    history = condition_history(conditions_of_record(flight.record).at(time_s))[np.newaxis]
    sensors = [s for s in flight.record.sensors if s.used]
    tracks = []
    for point in flight.source.points:
        own = [s for s in flight.samples if isinstance(s, Reading) and s.point == point.name]
        read = {(s.time_s, s.sensor): s.value_K for s in own}
        read_s = sorted({s.time_s for s in own})
        known = [reading_intervals(s, [read.get((t, s.name), math.nan) for t in read_s]) for s in sensors]
        nodes = [point.mesh.sensors[flight.record.sensors.index(s)] for s in sensors]
        sigma = [max(s.noise_sigma_K or 1.0, least_sigma_K(s)) for s in sensors]
        samples = samples_on_grid(read_s, nodes, [k.lower_K for k in known], sigma, [k.upper_K for k in known])
        profile, covariance = e.start_of(point.name)
        tracks.append(FilterTrack(point.model, point.mesh, samples, names, profile, covariance_K2=covariance))
    found = []
    for point, batch in zip(flight.source.points, FilterMarch(tracks, time_s, history).filter(), strict=True):
        expected = np.linalg.inv(np.diag([prior[n].sigma ** -2.0 for n in names]) + batch.information())
        sigma_p = np.sqrt(np.diag(expected))
        state = e.estimates()[point.name].state
        means = np.array([prior[n].mean for n in names])
        found.append(np.max(np.abs(state.covariance - expected) / np.outer(sigma_p, sigma_p)))
        found.append(np.max(np.abs(state.values - means - expected @ batch.score()) / sigma_p))
    return float(np.max(found))


def bits_apart(flight: Flight, orders: int) -> tuple[int, int]:
    """How many numbers of a final state differ after samples came in other orders, and how many samples were late."""
    straight = final(fed(LiveEstimator(flight.source, SIX), flight.samples))
    differ, late = 0, 0
    for seed in range(orders):
        link = BadLink(loss=0.0, doubled=0.0, late_s=REORDERED_S)
        e = fed(LiveEstimator(flight.source, SIX), link.arrive(flight.samples, np.random.default_rng((SEED, seed))))
        differ += sum(int(np.sum(a != b)) for a, b in zip(straight, final(e), strict=True))
        late += e.counts.late
    return differ, late


@dataclass(frozen=True)
class Compared:
    """A parameter at the end of a manoeuvre: running estimate less that of `estimate`, over the latter's standard
    deviation [-], and the ratio of the standard deviations [-].

    same_mesh : the difference from `estimate` without its correction of the mesh [-]
    informed  : part of its prior standard deviation that is left [-]
    """

    record: str
    end_s: float
    parameter: str
    apart: float
    sigma_ratio: float
    informed: float


def against_estimate(name: str, end_s: float, names: tuple[str, ...] = SIX) -> list[Compared]:
    """The running estimate of a practice record at a time [s] against `estimate` on the record until then.

    Both have the priors and the reference condition of the running one. Standard deviations are those for white
    residuals, which is what a filter has.
    """
    record = cut(practice(name), end_s)
    e = LiveEstimator(RecordPoints([record]), names)
    for sample in samples_of_record(record):
        e.add(sample)
        if isinstance(sample, Frame):
            e.advance()
    found, prior = next(iter(e.estimates().values())), prior_of(e, names)
    keys = ("alpha_deg", "beta_deg", "log10_re", "elevon_deg", "bodyflap_deg")
    reference = dict(zip(keys, e.points[0].model.reference, strict=True))
    fit = estimate(record, names, reference=reference, priors={n: (p.mean, p.sigma) for n, p in prior.items()})
    white = dict(zip(fit.labels, np.sqrt(np.diag(fit.bounds.white)).tolist(), strict=True))
    rows = []
    for label, fitted in zip(fit.labels, fit.fit.values.tolist(), strict=True):
        value, sigma = found.parameters[label]
        apart = (value - fitted) / white[label]
        rows.append(Compared(name, end_s, label, apart, sigma / white[label], sigma / prior[label].sigma))
    return rows


def manoeuvre_ends(name: str) -> list[float]:
    """Ends of the manoeuvres of a practice record, which are held out of fits, and of the record [s]."""
    record = practice(name)
    return [*(end for _, end in record.declared.segments.holdout), float(record.conditions.time_s[-1])]


def exactness(orders: int) -> tuple[list[Figure], list[Compared]]:
    """Rows of the table, and all comparisons with `estimate`; orders : number of other orders of the samples."""
    flight = known_flight("p06", 2, 400.0, 1.0, np.random.default_rng(SEED))
    differ, late = bits_apart(flight, orders)
    rows = [row for name in NULL for end_s in manoeuvre_ends(name) for row in against_estimate(name, end_s)]
    told = [row for row in rows if row.informed < ENOUGH_INFORMED]
    worst = max(told, key=lambda row: abs(row.apart))
    widest = max(told, key=lambda row: abs(row.sigma_ratio - 1.0))
    return [
        Figure("in order: values and covariance less the batch filter's, over sigma, largest", apart_from_batch(flight),
               "", EXACT, note="400 s of p06's flight, two points, six parameters, linearised at the priors"),
        Figure("out of order within the window: numbers of the final state that differ", differ, "", 0.0,
               note=f"{orders} orders, {late} late samples"),
        Figure("end of a manoeuvre, running estimate less `estimate` over sigma, largest", abs(worst.apart), "",
               LARGEST_APART, note=f"{worst.parameter} of {worst.record} at {worst.end_s:.0f} s; {len(told)} of "
               f"{len(rows)} values, those that the readings inform"),
        Figure("end of a manoeuvre, sigma over that of `estimate`, |ratio - 1|, largest", abs(widest.sigma_ratio - 1.0),
               "", LARGEST_SIGMA_APART, note=f"{widest.parameter} of {widest.record} at {widest.end_s:.0f} s"),
    ], rows  # fmt: skip
