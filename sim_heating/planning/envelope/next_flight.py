"""What the next flight should test: manoeuvres ranked by how much they would shrink the uncertainty of the boundaries.

A candidate is flown in the base entry, and its thermocouples are read as estimation.design reads a planned flight:
the bounds of the heating-ratio parameters with everything else that is not known beside them. What an estimate with
these bounds would tell of a control point's table is found as `update-tables` finds it (table_update.evidence), and
with it the sigma of every peak temperature as it would be afterwards. The expected envelope keeps its middle; its
band shrinks.
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
from sim_heating.planning.envelope.envelope import MIDDLE, SURE, FlownBoundary, Stretch, stretch
from sim_heating.planning.envelope.margins import Margin
from sim_heating.planning.envelope.spec import Candidate
from sim_heating.planning.study import Study

BEFORE_S, AFTER_S = 20.0, 60.0
"""Samples that are read around a manoeuvre [s]."""
EMITTANCE = "stack.emissivity_factor"
"""Not known either: near radiation equilibrium it is all but the magnitude of the heating ratio."""
TOLD = 0.5
"""A derivative is estimated where its bound is below this part of what the table itself says of it."""


@dataclass(frozen=True)
class Prospect:
    """A candidate, flown in advance.

    evidence : control point -> what it would tell of the table
    sigma    : control point -> bounds of what would be estimated there
    notes    : why a control point would tell nothing, and what of the manoeuvre is beyond its limits, a line each
    """

    candidate: Candidate
    evidence: Mapping[str, Evidence]
    sigma: Mapping[str, Mapping[str, float]]
    notes: tuple[str, ...]


def prospect(study: Study, candidate: Candidate) -> Prospect:
    """What a candidate would tell of each of its control points.

    raises : InputError for a control point that there is not
    """
    evidence, sigma, notes = {}, {}, []
    for name in candidate.control_points:
        study.vehicle.control_point(name)
        try:
            evidence[name], sigma[name], lines = _told(study, candidate, name)
            notes += lines
        except (InputError, RunError) as error:
            notes.append(f"{candidate.name}, {name}: would tell nothing: {' '.join(str(error).split())}")
    return Prospect(candidate, evidence, sigma, tuple(dict.fromkeys(notes)))


def _told(study: Study, candidate: Candidate, point: str) -> tuple[Evidence, dict[str, float], list[str]]:
    trajectory = study.base.declared.trajectory.model_copy(update={"manoeuvre": tuple(candidate.flown)})
    design = Design(control_point=point, before_s=BEFORE_S, after_s=AFTER_S)
    declared = study.base.declared.model_copy(update={"trajectory": trajectory, "design": design})
    planner = Planner(replace(study.base, declared=declared))
    planned = planner.fly(candidate.flown)
    passed = [f"{candidate.name}: {line}" for line in planned.exceeded_limits]
    if "manoeuvres reached" in planned.margins:
        raise InputError("the flight ends before it")
    record, _ = planner.record(planned, planner.instruments)
    names, covariance = _bounds(planner, planned)
    estimate = Estimate(
        format="estimate/1", records=[str(record.directory)], converged=True, iterations=0,
        reference_condition=ReferenceCondition(**dict(zip(RATIO_VARIABLES, reference_of_record(record), strict=True))),
        parameters={
            n: EstimatedParameter(value=0.0, sigma=float(s), unit=MODEL[n].unit)
            for n, s in zip(names, np.sqrt(np.diag(covariance)), strict=True)
        },
        correlation=correlations(names, covariance), control_point=point,
    )  # fmt: skip
    informed = flight_evidence(estimate, [record], study.vehicle, study.vehicle.control_point(point))
    bounds = dict(zip(names, np.sqrt(np.diag(covariance)).tolist(), strict=True))
    return informed.evidence, bounds, passed


def _bounds(planner: Planner, planned: PlannedFlight) -> tuple[tuple[str, ...], np.ndarray]:
    """Ratio parameters that would be estimated, with flat priors, and their covariance."""
    bare = insulation_layer(planner.point.construction) == 0  # a wall of one layer has no coating
    every = [n for n in (*planner.names(planned), EMITTANCE) if not (bare and n.startswith(COATING_PREFIX))]
    table = planner.priors(every, planned)
    ratio = [n for n in every if n in MAGNITUDES or n.startswith("ratio.d_")]
    told = planner.experiment(planned, every, table)
    kept = [
        n for n, s in zip(ratio, told.sigma(ratio), strict=True) if n in MAGNITUDES or s < TOLD * table.get(n, np.inf)
    ]
    flat = dict.fromkeys(kept, np.inf)
    return tuple(kept), told.with_priors({**table, **flat}).covariance(kept)


# Ranking -------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Ranked:
    """A candidate's worth.

    sigma_K : boundary -> mean sigma of the temperatures that limit it, at its edges, now and after the manoeuvre
    sure    : boundary -> area of what is surely allowed, now and after
    shrunk  : mean over all edges of the part of sigma that it would take away; the local width of a band goes with it
    """

    prospect: Prospect
    sigma_K: dict[str, tuple[float, float]]
    sure: dict[str, tuple[float, float]]
    shrunk: float


def limiting(s: Stretch) -> list[Margin]:
    """The temperatures that make the edges of a stretch, or keep it closed, as the tables stand and surely; each once,
    as the flight nearest to its edge has it."""
    edges: list[tuple[float, str]] = []
    for which in (MIDDLE, SURE):
        g, a = s.greatest.get(which), s.allowed[which]
        own = (a.low, a.high, a.least_bad) if g is None else (g,)
        edges += [(e.at, e.limit) for e in own if e is not None and e.limit not in [limit for _, limit in edges]]
    found = []
    for at, limit in edges:
        known = [i for i, f in enumerate(s.flights) if limit in f.margins]
        if known:
            nearest = min(known, key=lambda i: abs(s.places[i] - at))
            found.append(s.flights[nearest].margins[limit])
    return [m for m in found if m.sigma > 0.0]


def after(boundary: FlownBoundary, manoeuvre: str, sigmas: float) -> FlownBoundary:
    """The boundary as it would be after a manoeuvre that finds the tables to be right."""
    declared = boundary.declared
    later = [stretch(declared, s.member, s.along, s.inside, s.flights, sigmas, manoeuvre) for s in boundary.stretches]
    return FlownBoundary(declared, tuple(later))


def rank(prospects: Sequence[Prospect], boundaries: Sequence[FlownBoundary], sigmas: float) -> list[Ranked]:
    """Candidates, the one that shrinks the bands most first."""
    found = []
    for p in prospects:
        name = p.candidate.name
        sigma, sure, parts = {}, {}, []
        for b in boundaries:
            edges = [m for s in b.stretches for m in limiting(s)]
            now, left = [m.sigma for m in edges], [m.after.get(name, m.sigma) for m in edges]
            parts += [1.0 - later / before for before, later in zip(now, left, strict=True)]
            if edges:
                sigma[b.declared.name] = (float(np.mean(now)), float(np.mean(left)))
            sure[b.declared.name] = (b.area(SURE), after(b, name, sigmas).area(SURE))
        found.append(Ranked(p, sigma, sure, float(np.mean(parts)) if parts else 0.0))
    return sorted(found, key=lambda r: -r.shrunk)
