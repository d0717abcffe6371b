"""Facts about the flight of a scenario, from which its credibility follows."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import Conditions
from sim_heating.base.files import display_path, file_digest
from sim_heating.credibility.facts.contributors import band_uncertainty, declares_sigma, peak_uncertainty
from sim_heating.credibility.facts.sources import conditions_of_scenario, inputs_of_point
from sim_heating.credibility.facts.topics import topics_of_points, topics_of_trajectory
from sim_heating.credibility.reviews import digest_of
from sim_heating.credibility.statement import NOT_LOOKED_AT, SIGMAS, Answer, Facts, greatest_error_K
from sim_heating.credibility.validation.own_cases import samples_of
from sim_heating.credibility.validation.region import FLIGHT, Samples
from sim_heating.inputs.points import point_of_vehicle
from sim_heating.inputs.scenario import Scenario
from sim_heating.inputs.vehicle import ControlPoint, Vehicle
from sim_heating.march.history import PointHistory, peak
from sim_heating.march.point import PointModel

Limits = Mapping[str, Mapping[str, float | None]]


def facts_of_flight(
    scenario: Scenario,
    models: Sequence[PointModel],
    flights: Sequence[Conditions],
    histories: Sequence[PointHistory],
    limits: Limits,
) -> Facts:
    """Facts about a flown scenario.

    models, flights, histories : of each control point: model, conditions with its reference heating, temperatures [K]
    limits                     : `surface_K` and `bondline_K` by control point [K], None where there is none
    """
    vehicle = scenario.vehicle
    points = [vehicle.control_point(m.name) for m in models]
    model_inputs = [i for p, m in zip(points, models, strict=True) for i in inputs_of_point(vehicle, p, m.effects)]
    critical = _critical(histories, limits)
    hottest_s = peak(histories[critical].time_s, histories[critical].surface_K)[1]
    uncertainty = band_uncertainty(histories[critical]) or peak_uncertainty(
        models[critical], flights[critical], hottest_s, scenario.declared.heating.longest_step_s
    )
    digest = digest_of(vehicle)
    return Facts(
        kind="run",
        topics=frozenset(topics_of_points(vehicle, points, models) | topics_of_trajectory(scenario)),
        model=tuple(dict.fromkeys(model_inputs)),
        conditions=tuple(conditions_of_scenario(scenario)),
        files={display_path(scenario.path): file_digest(scenario.path), f"vehicle {vehicle.name}": digest},
        samples=tuple(samples_of(f, h.surface_K) for f, h in zip(flights, histories, strict=True)),
        mesh_error_K=greatest_error_K(h.mesh_error_K for h in histories),
        sigma=all(h.band or declares_sigma(m, f) for m, f, h in zip(models, flights, histories, strict=True)),
        uncertainty=uncertainty,
        holds=_holds(histories, limits, critical, None if uncertainty is None else uncertainty.sigma),
        folder=vehicle.directory,
        reviewed=digest,
    )


def facts_of_study(
    scenario: Scenario, files: Sequence[Path], samples: Sequence[Samples], topics: Iterable[str] = ()
) -> Facts:
    """Facts about a study: flights of a vehicle that were computed to plan one.

    scenario : the base entry;  files : that the study was made from;  samples : conditions of its nominal flight
    topics   : of what the study computes besides
    """
    vehicle, digest = scenario.vehicle, digest_of(scenario.vehicle)
    points = [vehicle.control_point(name) for name in scenario.names]
    models = [point_of_vehicle(vehicle, p, effects=scenario.effects(p.name)) for p in points]
    model_inputs = [i for p, m in zip(points, models, strict=True) for i in inputs_of_point(vehicle, p, m.effects)]
    return Facts(
        kind="study",
        topics=frozenset({*topics_of_points(vehicle, points, models), *topics_of_trajectory(scenario), *topics}),
        model=tuple(dict.fromkeys(model_inputs)),
        conditions=tuple(conditions_of_scenario(scenario)),
        files={display_path(p): file_digest(p) for p in files if p.is_file()} | {f"vehicle {vehicle.name}": digest},
        samples=tuple(samples) or (Samples(FLIGHT, {}, np.zeros(0)),),
        sigma=all(m.ratio is not None and m.ratio.sigma is not None for m in models),
        folder=vehicle.directory,
        reviewed=digest,
    )


def facts_of_model(
    vehicle: Vehicle,
    points: Sequence[ControlPoint],
    models: Sequence[PointModel],
    flown: Conditions,
    surfaces_K: Sequence[FloatArray],
) -> Facts:
    """Facts about a model that a host will fly: of a reference flight, whose conditions are no measurement.

    points, models : of the vehicle;  flown : conditions with mach and log10_re;  surfaces_K : of each point, (time,)
    """
    digest = digest_of(vehicle)
    inputs = [i for p, m in zip(points, models, strict=True) for i in inputs_of_point(vehicle, p, m.effects)]
    return Facts(
        kind="run",
        topics=frozenset(topics_of_points(vehicle, points, models)),
        model=tuple(dict.fromkeys(inputs)),
        conditions=(),
        files={f"vehicle {vehicle.name}": digest},
        samples=tuple(samples_of(flown, surface) for surface in surfaces_K),
        sigma=all(m.ratio is not None and m.ratio.sigma is not None for m in models),
        folder=vehicle.directory,
        reviewed=digest,
    )


def _critical(histories: Sequence[PointHistory], limits: Limits) -> int:
    """The point with the least margin to its surface limit; where none has a limit, the hottest."""

    def margin(h: PointHistory) -> float:
        limit = limits.get(h.name, {}).get("surface_K")
        return (0.0 if limit is None else limit) - float(h.surface_K.max())

    limited = [i for i, h in enumerate(histories) if limits.get(h.name, {}).get("surface_K") is not None]
    return min(limited or range(len(histories)), key=lambda i: margin(histories[i]))


def _holds(histories: Sequence[PointHistory], limits: Limits, critical: int, sigma_K: float | None) -> Answer:
    """Whether all temperatures keep their limits, and the most critical surface does by two standard deviations."""
    margins = {
        f"{h.name} {part_of_wall}": limit - float(values.max())
        for h in histories
        for part_of_wall, values in (("surface", h.surface_K), ("bondline", h.bondline_K))
        if (limit := limits.get(h.name, {}).get(f"{part_of_wall}_K")) is not None
    }
    if not margins or sigma_K is None:
        return NOT_LOOKED_AT
    least = min(margins, key=lambda name: margins[name])
    critical_margin = margins.get(f"{histories[critical].name} surface", margins[least])
    text = (
        f"least margin {margins[least]:.0f} K ({least}); two sigma of the surface of {histories[critical].name}: "
        f"{SIGMAS * sigma_K:.0f} K, its margin {critical_margin:.0f} K"
    )
    return Answer(margins[least] > 0.0 and critical_margin > SIGMAS * sigma_K, text)
