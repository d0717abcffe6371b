"""Evidence of a flight on the nodes of a control point's ratio table, from an estimate and the records behind it.

By the estimate, the parameters of the linear model along the flown path are theta_hat +- C; by the table, with nodes n,
they are P (W n - r_declared), the projection of closure/table_prior/flown_path.py. So H = P W,
y = theta_hat + P r_declared, and the rank of the evidence is the number of parameters, however many samples the path
has: nothing is counted twice.

A parameter that the table cannot represent (the derivative against a variable with one node, the curvature within one
cell) and one that is not of the ratio are marginalised: their rows and columns of C are left out. An estimate of
effects alone is evidence of rank 0: the table stays.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from sim_heating.base.arrays import BoolArray, FloatArray
from sim_heating.base.conditions import RATIO_VARIABLES
from sim_heating.base.errors import InputError
from sim_heating.base.parameters import EFFECT_PREFIX, RATIO, SECOND_ORDER
from sim_heating.closure.table_prior.flown_path import FlownPath, projection, record_path
from sim_heating.estimation.report.estimate_file import Estimate
from sim_heating.heating.effects import EffectUse, use
from sim_heating.heating.effects.transition import TRANSITION
from sim_heating.heating.ratio.table import RatioTable
from sim_heating.heating.ratio.uncertainty import Evidence, node_weights
from sim_heating.inputs.points import check_reference
from sim_heating.inputs.record import Record
from sim_heating.inputs.vehicle import ControlPoint, Vehicle

OUTSIDE_SHARE = 0.1
"""Share of the fitted samples outside a table's axes above which it is not updated."""


@dataclass(frozen=True)
class FlightEvidence:
    """An estimate as evidence on a table.

    evidence    : on the nodes of the table
    rows        : (k, node) the evidence's parameters as linear combinations of the nodes, less `at_zero`
    at_zero     : (k,) their values for a ratio of 0
    path        : the samples behind it, those inside the table
    outside     : number of samples outside the table
    not_written : parameter -> why it is not in the table
    """

    evidence: Evidence
    rows: FloatArray
    at_zero: FloatArray
    path: FlownPath
    outside: int
    not_written: dict[str, str]


def is_effect(label: str) -> bool:
    """Whether a parameter's label is that of an effect."""
    return label.startswith(EFFECT_PREFIX)


def ratio_names(estimate: Estimate) -> tuple[str, ...]:
    """The estimated parameters of the linear heating model, in the model's order."""
    return tuple(p.name for p in RATIO if p.name in estimate.parameters)


def flight_evidence(
    estimate: Estimate, records: Sequence[Record], vehicle: Vehicle, point: ControlPoint
) -> FlightEvidence:
    """The evidence of an estimate on the nodes of a control point's table.

    records : those behind the estimate, in its order
    raises  : InputError where the ratio is over another reference heating, the path leaves the table, or the records
              are not those of the estimate
    """
    if not estimate.converged:
        raise InputError(
            "the estimate did not converge, so nothing of it goes into a table; estimate again with fewer parameters"
        )
    if point.ratio.sigma is None:
        raise InputError(f"{point.declared.ratio_table}: has no sigma column to weigh the flight against; add one")
    names = ratio_names(estimate)
    others = [n for n in estimate.parameters if n not in names]
    effects = any(is_effect(n) for n in others)
    if not names and not effects:
        raise InputError(
            "the estimate holds no ratio parameter and no effect, and a vehicle's tables take no other; estimate one"
        )
    # The table enters the update by its own sigma; as the prior of the fit it would count twice.
    with_prior = next((n for n in names if estimate.parameters[n].prior_sigma is not None), None)
    if with_prior is not None:
        raise InputError(
            f"{with_prior} was estimated with a prior, which is the table itself; estimate it with a flat one"
        )
    for record in records:
        check_reference(record, vehicle, point)
    path, outside = _path(estimate, records), 0
    H, at_zero, representable = np.zeros((0, point.ratio.ratio.size)), np.zeros(0), np.zeros(0, dtype=bool)
    if names:
        path, outside = _inside(path, point)
        P = projection(names, path, estimate.reference_condition.values())
        # H = P W, with the multilinear weights W
        H = np.asarray((node_weights(point.ratio.axes, path.x).T @ P.T).T)
        at_zero = P @ path.declared
        representable = _representable(names, path, point.ratio)
    written = tuple(n for n, h in zip(names, representable, strict=True) if h)
    if not written and not effects:
        raise InputError(f"the table of {point.name} has too few nodes for {', '.join(names)}; add nodes there")
    rows = H[representable]
    nodes = np.flatnonzero(np.any(rows != 0.0, axis=0))
    value = estimate.values(written) + at_zero[representable]
    evidence = Evidence(written, nodes, rows[:, nodes], value, estimate.covariance(written))
    not_written = dict.fromkeys(set(names) - set(written), "the table has too few nodes for it")
    not_written |= dict.fromkeys((n for n in others if not is_effect(n)), "is neither of the ratio table nor an effect")
    return FlightEvidence(evidence, rows, at_zero[representable], path, outside, dict(sorted(not_written.items())))


def _path(estimate: Estimate, records: Sequence[Record]) -> FlownPath:
    """The fitted samples of all records."""
    segments, transition = estimate.segments, fitted_use(estimate, TRANSITION)
    parts = [record_path(r, None if segments is None else segments[i], transition) for i, r in enumerate(records)]
    return FlownPath(*(np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(FlownPath)))


def fitted_use(estimate: Estimate, name: str) -> EffectUse | None:
    """An effect as it was in a fit, with the values that were estimated; None where the fit did not have it."""
    in_force = {e.name: e.parameters for e in estimate.effects}
    head = f"{EFFECT_PREFIX}{name}."
    estimated = {n.removeprefix(head): p.value for n, p in estimate.parameters.items() if n.startswith(head)}
    return use(name, in_force.get(name, {}) | estimated) if name in in_force or estimated else None


def _inside(path: FlownPath, point: ControlPoint) -> tuple[FlownPath, int]:
    """The samples inside the table's axes (an axis of one value has no outside), and how many lie outside."""
    out = np.zeros(len(path.x), dtype=bool)
    for name, axis, x in zip(RATIO_VARIABLES, point.ratio.axes, path.x.T, strict=True):
        beyond = (len(axis) > 1) & ((x < axis[0]) | (x > axis[-1]))
        if np.mean(beyond) > OUTSIDE_SHARE:
            raise InputError(
                f"{point.declared.ratio_table}: {name} lay outside its {axis[0]:g} to {axis[-1]:g} for "
                f"{np.mean(beyond):.0%} of the fitted samples ({x.min():.4g} to {x.max():.4g}); extend the table first"
            )
        out |= beyond
    return path.subset(~out), int(np.count_nonzero(out))


def _representable(names: Sequence[str], path: FlownPath, table: RatioTable) -> BoolArray:
    """(k,) whether the nodes can represent each parameter: a slope needs two, a curvature one within the excursion."""
    has_slope = [len(axis) > 1 for axis in table.axes]
    has_curvature = [np.any((a > x.min()) & (a < x.max())) for a, x in zip(table.axes, path.x.T, strict=True)]
    second = [has_curvature[i] if i == j else has_slope[i] and has_slope[j] for i, j in SECOND_ORDER]
    possible = dict(zip((p.name for p in RATIO), (True, True, *has_slope, *second), strict=True))
    return np.array([possible[name] for name in names], dtype=bool)
