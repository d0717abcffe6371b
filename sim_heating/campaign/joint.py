"""Manoeuvres that several flights have in common, and whether their fits agree."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import chdtrc

from sim_heating.campaign.flights import CampaignFlight, Manoeuvre, numbered
from sim_heating.estimation.report.estimate_file import correlation_matrix


@dataclass(frozen=True)
class Group:
    """Manoeuvres of one kind and nearly one speed, flown in one or several flights.

    name    : that of the first
    members : name of the flight, and its manoeuvre
    """

    name: str
    members: tuple[tuple[str, Manoeuvre], ...]


def groups_of(flights: Sequence[CampaignFlight], tolerance: float) -> list[Group]:
    """Groups of the manoeuvres of all flights, in order of falling speed.

    tolerance : largest relative difference of the speed at the start from that of the group's fastest [-]
    """
    flown = sorted(((m, f.name) for f in flights for m in f.manoeuvres), key=lambda pair: -pair[0].velocity_m_s)
    groups: list[list[tuple[str, Manoeuvre]]] = []
    for manoeuvre, flight in flown:
        group = next((g for g in groups if _belongs(manoeuvre, flight, g, tolerance)), None)
        if group is None:
            groups.append([(flight, manoeuvre)])
        else:
            group.append((flight, manoeuvre))
    names: list[str] = []
    for g in groups:
        names.append(numbered(g[0][1].name, names))
    return [Group(name, tuple(g)) for name, g in zip(names, groups, strict=True)]


def _belongs(manoeuvre: Manoeuvre, flight: str, group: Sequence[tuple[str, Manoeuvre]], tolerance: float) -> bool:
    """Whether a manoeuvre is of a group: kind and speed agree, and its flight has no other one in it."""
    first = group[0][1]
    near = manoeuvre.velocity_m_s >= (1.0 - tolerance) * first.velocity_m_s
    return manoeuvre.kind == first.kind and near and flight not in [name for name, _ in group]


@dataclass(frozen=True)
class Agreement:
    """Whether the fits of single flights agree with their joint fit.

    chi_square : sum over flights of d^T C^-1 d, d the difference from the joint fit, C the covariance of the flight [-]
    degrees    : of freedom, (flights - 1) times the parameters in common
    p_value    : probability of more for flights that differ by their stated bounds alone
    """

    chi_square: float
    degrees: int
    p_value: float


def agreement(singles: Sequence[Mapping[str, Any]], joint: Mapping[str, Any]) -> Agreement | None:
    """Agreement of the rows of single fits with that of their joint fit, all about one reference condition.

    returns : None where they have no ratio parameter in common

    Estimates of one quantity scatter about their weighted mean as chi-square with (n - 1) k degrees of freedom (Rao,
    Linear Statistical Inference, section 4a); the joint fit is that mean as far as the model is linear.
    """
    common = [n for n in joint["parameters"] if n.startswith("ratio.") and all(n in s["parameters"] for s in singles)]
    if not common or len(singles) < 2:
        return None
    at = _values(joint, common)
    total = sum(
        float(d @ np.linalg.solve(_covariance(s, common), d)) for s in singles for d in [_values(s, common) - at]
    )
    degrees = (len(singles) - 1) * len(common)
    return Agreement(total, degrees, float(chdtrc(degrees, total)))


def _values(row: Mapping[str, Any], names: Sequence[str]) -> np.ndarray:
    return np.array([row["parameters"][n]["value"] for n in names])


def _covariance(row: Mapping[str, Any], names: Sequence[str]) -> np.ndarray:
    sigma = np.array([row["parameters"][n]["sigma"] for n in names])
    return correlation_matrix(row["correlation"], names) * np.outer(sigma, sigma)
