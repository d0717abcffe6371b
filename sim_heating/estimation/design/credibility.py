"""What supports a design of manoeuvres, factor by factor."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from sim_heating.credibility.facts.contributors import peak_uncertainty
from sim_heating.credibility.facts.of_flight import facts_of_study
from sim_heating.credibility.facts.of_records import MODEL_ERROR_RATIO, ratio_uncertainty
from sim_heating.credibility.facts.sources import inputs_of_point
from sim_heating.credibility.facts.topics import topics_of_points, topics_of_trajectory
from sim_heating.credibility.statement import NOT_LOOKED_AT, SIGMAS, Answer, Statement, assess
from sim_heating.credibility.validation.own_cases import wall_readings
from sim_heating.estimation.design.check import RepeatedFits
from sim_heating.estimation.design.information import Experiment
from sim_heating.estimation.design.planned_flight import SEARCH_TRAJECTORY, PlannedFlight, Planner
from sim_heating.estimation.problem import joint_reference
from sim_heating.inputs.points import point_of_vehicle

NO_FITS = Answer(False, "no simulated fits of the design (--repetitions)")


def credibility_of_design(
    planner: Planner,
    best: PlannedFlight,
    experiment: Experiment,
    flights: Iterable[PlannedFlight],
    fitted: tuple[RepeatedFits, Experiment] | None,
) -> Statement:
    """The credibility statement of a design.

    best, experiment : the design and its expected information
    flights          : all flights of it, with the scenario's own source among them
    fitted           : errors of simulated fits and the bounds for them; None where none were made
    """
    scenario, point = planner.scenario, planner.point
    record = planner.record(best, planner.instruments)[0]
    samples = wall_readings(record)[1]
    facts = facts_of_study(scenario, scenario.files, [samples], [])
    model = point_of_vehicle(scenario.vehicle, point, effects=scenario.effects(point.name))
    searched = scenario.declared.trajectory.model_copy(update=SEARCH_TRAJECTORY)
    search = replace(scenario, declared=scenario.declared.model_copy(update={"trajectory": searched}))
    agree = _agree(fitted, planner.targets)
    facts_of_design = replace(
        facts,
        kind="design",
        topics=facts.topics
        | topics_of_points(scenario.vehicle, [point], [model])
        | topics_of_trajectory(search)
        | {"estimates", "sensitivities"},
        model=tuple(dict.fromkeys((*facts.model, *inputs_of_point(scenario.vehicle, point, model.effects)))),
        sigma=True,
        uncertainty=ratio_uncertainty(
            dict(zip(experiment.names, experiment.sigma(experiment.names).tolist(), strict=True)),
            [record],
            joint_reference([record]),
        ),
        consistent=agree,
        holds=_keeps_limits(planner, best, flights),
        varied=agree,
    )
    return assess(facts_of_design)


def _agree(fitted: tuple[RepeatedFits, Experiment] | None, names: tuple[str, ...]) -> Answer:
    """Whether errors of simulated fits, their truths drawn from all priors together, are as the bounds say."""
    if fitted is None:
        return NO_FITS
    fits, experiment = fitted
    largest = float(np.max(fits.rms_error(names) / experiment.sigma(names)))
    text = f"{len(fits.error)} simulated fits err by up to {largest:.2f} times the bounds"
    return Answer(largest <= MODEL_ERROR_RATIO and not fits.failed, f"{text}, {fits.failed} failed")


def _keeps_limits(planner: Planner, best: PlannedFlight, flights: Iterable[PlannedFlight]) -> Answer:
    """Whether every flight of a design keeps its limits, and the point's surface does by two standard deviations."""
    exceeded = [line for flight in flights for line in flight.exceeded_limits]
    if exceeded:
        return Answer(False, exceeded[0])
    scenario, point = planner.scenario, planner.point
    model = point_of_vehicle(scenario.vehicle, point, effects=scenario.effects(point.name))
    flown = best.conditions
    hottest_s = float(flown.time_s[np.argmax(flown["h_ref_kg_m2_s"] * flown["H_r_J_kg"])])
    highest = peak_uncertainty(model, flown, hottest_s)
    if highest is None or highest.value is None:
        return NOT_LOOKED_AT
    margin_K, bound_K = point.limits.surface_K - highest.value, SIGMAS * highest.sigma
    text = f"all limits are kept; surface of {point.name}: margin {margin_K:.0f} K, two sigma {bound_K:.0f} K"
    return Answer(margin_K > bound_K, text)
