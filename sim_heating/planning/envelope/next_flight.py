"""Ranking of manoeuvres for the next flight by how much they would reduce the uncertainty of the boundaries.

A candidate is flown in the base entry, and its thermocouples are read as estimation/design/planned_flight.py reads a
planned flight: this gives Cramer-Rao bounds of the heating-ratio parameters, all other unknown parameters included. The
evidence of an estimate with these bounds on the ratio table of a control point is that of `update-tables`
(closure/revise/evidence.py), and with it follows the sigma of every peak temperature after the flight. The expected
boundary stays where it is; its band becomes narrower.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from sim_heating.base.conditions import RATIO_VARIABLES
from sim_heating.base.errors import InputError, RunError
from sim_heating.base.parameters import MODEL
from sim_heating.closure.revise.evidence import flight_evidence
from sim_heating.estimation.design.planned_flight import PlannedFlight, Planner
from sim_heating.estimation.inference.observability import MAGNITUDES
from sim_heating.estimation.report.estimate_file import Estimate, EstimatedParameter, ReferenceCondition, correlations
from sim_heating.heating.ratio.uncertainty import Evidence
from sim_heating.inputs.points import reference_of_record
from sim_heating.inputs.scenario import Design
from sim_heating.march.point import COATING_PREFIX, insulation_layer
from sim_heating.planning.envelope import envelope
from sim_heating.planning.envelope.margins import Margin
from sim_heating.planning.envelope.spec import ManoeuvreCandidate
from sim_heating.planning.study import Study

BEFORE_S, AFTER_S = 20.0, 60.0
"""Interval in which samples are read, before and after a manoeuvre [s]."""
EMITTANCE = "stack.emissivity_factor"
"""Also unknown: near radiation equilibrium its effect is almost that of the magnitude of the heating ratio."""
INFORMATIVE = 0.5
"""A derivative is estimated where its bound is below this part of its sigma from the table itself."""


@dataclass(frozen=True)
class ManoeuvreForecast:
    """Forecast of a candidate, from a simulated flight.

    evidence : control point -> evidence that it would give on the ratio table
    sigma    : control point -> bounds of the parameters that would be estimated there
    notes    : one line each: why a control point would give no evidence, and limits that the manoeuvre exceeds
    """

    candidate: ManoeuvreCandidate
    evidence: Mapping[str, Evidence]
    sigma: Mapping[str, Mapping[str, float]]
    notes: tuple[str, ...]


def forecast_manoeuvre(study: Study, candidate: ManoeuvreCandidate) -> ManoeuvreForecast:
    """Forecast the evidence of a candidate on each of its control points.

    raises : InputError where a control point does not exist
    """
    evidence, sigma, notes = {}, {}, []
    for name in candidate.control_points:
        study.vehicle.control_point(name)
        try:
            evidence[name], sigma[name], lines = _forecast_point(study, candidate, name)
            notes += lines
        except (InputError, RunError) as error:
            notes.append(f"{candidate.name}, {name}: would give no evidence: {' '.join(str(error).split())}")
    return ManoeuvreForecast(candidate, evidence, sigma, tuple(dict.fromkeys(notes)))


def _forecast_point(
    study: Study, candidate: ManoeuvreCandidate, point: str
) -> tuple[Evidence, dict[str, float], list[str]]:
    """Evidence on one control point, bounds of the parameters, and limits that the manoeuvre exceeds."""
    trajectory = study.base.declared.trajectory.model_copy(update={"manoeuvre": tuple(candidate.flown)})
    design = Design(control_point=point, before_s=BEFORE_S, after_s=AFTER_S)
    declared = study.base.declared.model_copy(update={"trajectory": trajectory, "design": design})
    planner = Planner(replace(study.base, declared=declared))
    planned = planner.fly(candidate.flown)
    exceeded = [f"{candidate.name}: {line}" for line in planned.exceeded_limits]
    if "manoeuvres reached" in planned.margins:
        raise InputError("the flight ends before the manoeuvre; fly it earlier")
    record, _ = planner.record(planned, planner.instruments)
    names, covariance = _bounds(planner, planned)
    estimate = Estimate(
        format="estimate/1",
        records=[str(record.directory)],
        converged=True,
        iterations=0,
        reference_condition=ReferenceCondition(**dict(zip(RATIO_VARIABLES, reference_of_record(record), strict=True))),
        parameters={
            n: EstimatedParameter(value=0.0, sigma=float(s), unit=MODEL[n].unit)
            for n, s in zip(names, np.sqrt(np.diag(covariance)), strict=True)
        },
        correlation=correlations(names, covariance),
        control_point=point,
    )
    informed = flight_evidence(estimate, [record], study.vehicle, study.vehicle.control_point(point))
    bounds = dict(zip(names, np.sqrt(np.diag(covariance)).tolist(), strict=True))
    return informed.evidence, bounds, exceeded


def _bounds(planner: Planner, planned: PlannedFlight) -> tuple[tuple[str, ...], np.ndarray]:
    """Ratio parameters that would be estimated, with flat priors, and their covariance."""
    bare = insulation_layer(planner.point.construction) == 0  # a wall of one layer has no coating
    every = [n for n in (*planner.names(planned), EMITTANCE) if not (bare and n.startswith(COATING_PREFIX))]
    table = planner.priors(every, planned)
    ratio = [n for n in every if n in MAGNITUDES or n.startswith("ratio.d_")]
    information = planner.experiment(planned, every, table)
    estimated = [
        n
        for n, s in zip(ratio, information.sigma(ratio), strict=True)
        if n in MAGNITUDES or s < INFORMATIVE * table.get(n, np.inf)
    ]
    # The table is the prior of the update that follows: in the estimate it would count twice.
    flat = dict.fromkeys(estimated, np.inf)
    return tuple(estimated), information.with_priors({**table, **flat}).covariance(estimated)


# Ranking -------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class RankedManoeuvre:
    """A candidate with the reduction of uncertainty that it would bring.

    sigma_K           : boundary -> mean sigma [K] of the temperatures that make its edges, now and after the manoeuvre
    conservative_area : boundary -> area of the conservative boundary, now and after
    sigma_reduction   : mean over all edges of the relative reduction of sigma [-]; the local width of a band follows it
    """

    forecast: ManoeuvreForecast
    sigma_K: dict[str, tuple[float, float]]
    conservative_area: dict[str, tuple[float, float]]
    sigma_reduction: float


def limiting_margins(s: envelope.BoundarySegment) -> list[Margin]:
    """Margins with a sigma that make the nominal and conservative edges of a segment, or close it.

    Each limit appears once, with the margin of the flight nearest to its edge.
    """
    edges: dict[str, float] = {}
    for which in (envelope.NOMINAL, envelope.CONSERVATIVE):
        g, a = s.greatest.get(which), s.allowed[which]
        for edge in (a.low, a.high, a.least_violated) if g is None else (g,):
            if edge is not None:
                edges.setdefault(edge.limit, edge.at)
    margins = []
    for limit, at in edges.items():
        having_limit = [i for i, f in enumerate(s.flights) if limit in f.margins]
        if having_limit:
            nearest = min(having_limit, key=lambda i: abs(s.positions[i] - at))
            margin = s.flights[nearest].margins[limit]
            if margin.sigma > 0.0:
                margins.append(margin)
    return margins


def boundary_after(boundary: envelope.FlownBoundary, manoeuvre: str, sigmas: float) -> envelope.FlownBoundary:
    """The boundary as it would be after a manoeuvre that confirms the tables."""
    declared = boundary.declared
    later = (
        envelope.boundary_segment(declared, s.member, s.position, s.inside, s.flights, sigmas, manoeuvre)
        for s in boundary.segments
    )
    return envelope.FlownBoundary(declared, tuple(later))


def rank_manoeuvres(
    forecasts: Sequence[ManoeuvreForecast], boundaries: Sequence[envelope.FlownBoundary], sigmas: float
) -> list[RankedManoeuvre]:
    """Rank candidates, the largest reduction of sigma first."""
    ranked = []
    for forecast in forecasts:
        name = forecast.candidate.name
        sigma, area, reductions = {}, {}, []
        for b in boundaries:
            edges = [m for s in b.segments for m in limiting_margins(s)]
            now, after = [m.sigma for m in edges], [m.sigma_after.get(name, m.sigma) for m in edges]
            reductions += [1.0 - later / before for before, later in zip(now, after, strict=True)]
            if edges:
                sigma[b.declared.name] = (float(np.mean(now)), float(np.mean(after)))
            later_boundary = boundary_after(b, name, sigmas)
            area[b.declared.name] = (b.area(envelope.CONSERVATIVE), later_boundary.area(envelope.CONSERVATIVE))
        ranked.append(RankedManoeuvre(forecast, sigma, area, float(np.mean(reductions)) if reductions else 0.0))
    return sorted(ranked, key=lambda r: -r.sigma_reduction)
