"""Parameters of a wall that change from flight to flight: emittance, coating, catalysis.

A parameter x walks from one flight to the next, and each flight k has its estimate y with standard deviation s:

    x_k = x_(k-1) + w,  w ~ N(0, sigma_w^2);    y_k = x_k + v,  v ~ N(0, s_k^2)                                  (1)

The Kalman filter (Kalman 1960) gives its value at each flight from that flight and those before it, and its value at
the next flight. The first flight has no value before it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import chdtrc

from sim_heating.base.files import toml_text
from sim_heating.base.parameters import AT


@dataclass(frozen=True)
class Walk:
    """A parameter of a control point along the flights.

    sigma_per_flight : standard deviation of its change from one flight to the next, in the unit of the parameter
    flights          : names, in order
    measured         : (flight,) value and standard deviation by the fits of each flight
    known            : (flight,) value and standard deviation with that flight and those before it
    next_value, next_sigma : what is known of the next flight before it is flown
    p_value          : probability of innovations as large as these or larger, for a parameter that walks so; None for
                       one flight
    """

    control_point: str
    parameter: str
    unit: str
    sigma_per_flight: float
    flights: tuple[str, ...]
    measured: tuple[tuple[float, float], ...]
    known: tuple[tuple[float, float], ...]
    next_value: float
    next_sigma: float
    p_value: float | None


def walk(
    measured: Sequence[tuple[float, float]], sigma_per_flight: float
) -> tuple[list[tuple[float, float]], float | None]:
    """Values along the flights by the filter of equation 1, and the p-value of the innovations.

    measured : estimates and their standard deviations, in the order of the flights
    returns  : value and standard deviation after each flight; p-value [-], None for one flight
    """
    value, variance = measured[0][0], measured[0][1] ** 2
    filtered, chi_square = [(value, float(np.sqrt(variance)))], 0.0
    for estimate, sigma in measured[1:]:
        variance += sigma_per_flight**2
        innovation, total = estimate - value, variance + sigma**2
        chi_square += innovation**2 / total
        value += variance / total * innovation
        variance *= sigma**2 / total
        filtered.append((value, float(np.sqrt(variance))))
    degrees = len(measured) - 1
    return filtered, float(chdtrc(degrees, chi_square)) if degrees else None


def walks_of_fits(rows: Sequence[Mapping[str, Any]], sigmas: Mapping[str, float], flights: Sequence[str]) -> list[Walk]:
    """Walks of the parameters that a campaign lets age, for each control point whose flights have estimates of them.

    rows    : usable rows of the fits of single flights
    sigmas  : standard deviation of the change per flight, by dotted name
    flights : names in the order in which they were flown
    """
    walks = []
    for point in dict.fromkeys(row["control_point"] for row in rows):
        for name, sigma_per_flight in sigmas.items():
            by_flight = _estimates_by_flight(rows, point, name)
            flown = [flight for flight in flights if flight in by_flight]
            if not flown:
                continue
            measured = [_weighted_mean(by_flight[flight]) for flight in flown]
            filtered, p_value = walk(measured, sigma_per_flight)
            value, sigma = filtered[-1]
            walks.append(
                Walk(
                    control_point=point,
                    parameter=name,
                    unit=by_flight[flown[0]][0]["unit"],
                    sigma_per_flight=sigma_per_flight,
                    flights=tuple(flown),
                    measured=tuple(measured),
                    known=tuple(filtered),
                    next_value=value,
                    next_sigma=float(np.hypot(sigma, sigma_per_flight)),
                    p_value=p_value,
                )
            )
    return walks


def next_flight_settings(walks: Sequence[Walk]) -> str:
    """A file of settings of `estimate` with what is known of the next flight, as priors of its parameters."""
    prior = {f"{w.parameter}{AT}{w.control_point}": [w.next_value, w.next_sigma] for w in walks}
    return toml_text(
        {"prior": prior}, "Parameters that age, as they are known before the next flight: estimate --settings FILE"
    )


def _estimates_by_flight(
    rows: Sequence[Mapping[str, Any]], point: str, name: str
) -> dict[str, list[Mapping[str, Any]]]:
    """Estimates of a parameter at a control point, by the flight that they are from."""
    by_flight: dict[str, list[Mapping[str, Any]]] = {}
    for row in rows:
        if row["control_point"] == point and name in row["parameters"]:
            by_flight.setdefault(row["flights"][0], []).append(row["parameters"][name])
    return by_flight


def _weighted_mean(estimates: Sequence[Mapping[str, Any]]) -> tuple[float, float]:
    """Mean of the manoeuvres of one flight by their information, and its standard deviation."""
    information = np.array([e["sigma"] for e in estimates]) ** -2.0
    values = np.array([e["value"] for e in estimates])
    return float(information @ values / information.sum()), float(information.sum() ** -0.5)
