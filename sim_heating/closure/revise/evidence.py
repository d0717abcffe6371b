"""Evidence of a flight on the nodes of a control point's ratio table, from an estimate and the records behind it.

By the estimate, the ratio along the flown path is

    r(x_t) = r_declared(x_t) + sum_k b_k(x_t) theta_k,   theta = theta_hat +- C
    b = r_declared for ratio.scale, 1 for ratio.d0, dx_i, dx_i dx_j for the derivatives

and the table's own ratio along it is W n (multilinear weights). Both are compared as functions of the same few
parameters: W n - r_declared projected on b by least squares, weights O = (h_ref H_r)^2 as heat flux, gives the table's
own value of theta, P (W n - r_declared) with P = (B' O B)^-1 B' O. So H = P W, y = theta_hat + P r_declared, and the
rank of the evidence is the number of parameters, however many samples the path has: nothing is counted twice.

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
from sim_heating.estimation.report.estimate_file import Estimate
from sim_heating.heating.effects import EffectUse, use
from sim_heating.heating.effects.transition import TRANSITION
from sim_heating.heating.ratio.table import RatioTable
from sim_heating.heating.ratio.uncertainty import Evidence, basis, node_weights
from sim_heating.inputs.points import check_reference, conditions_of_record, intermittency_along
from sim_heating.inputs.record import Record, in_segments
from sim_heating.inputs.vehicle import ControlPoint, Vehicle

OUTSIDE_SHARE = 0.1
"""Share of the fitted samples outside a table's axes above which it is not updated."""
MIN_SINGULAR_VALUE = 1e-6
"""Singular value of the scaled basis below which two parameters cannot be distinguished along the path."""


@dataclass(frozen=True)
class FlownPath:
    """The fitted samples.

    x         : (sample, 5) ratio variables
    weight    : (sample,) weight in the projection [(W/m2)^2]
    declared  : (sample,) ratio of the record's own table [-], 0 without one
    turbulent : (sample,) intermittency of the transition in the fit [-], 0 without one
    """

    x: FloatArray
    weight: FloatArray
    declared: FloatArray
    turbulent: FloatArray

    def subset(self, chosen: BoolArray) -> FlownPath:
        """The chosen samples."""
        return FlownPath(*(getattr(self, f.name)[chosen] for f in fields(self)))


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
        H, at_zero = _projection(names, path, estimate.reference_condition.values(), point.ratio)
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
    parts = [_record_path(r, None if segments is None else segments[i], transition) for i, r in enumerate(records)]
    return FlownPath(*(np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(FlownPath)))


def fitted_use(estimate: Estimate, name: str) -> EffectUse | None:
    """An effect as it was in a fit, with the values that were estimated; None where the fit did not have it."""
    in_force = {e.name: e.parameters for e in estimate.effects}
    head = f"{EFFECT_PREFIX}{name}."
    estimated = {n.removeprefix(head): p.value for n, p in estimate.parameters.items() if n.startswith(head)}
    return use(name, in_force.get(name, {}) | estimated) if name in in_force or estimated else None


def _record_path(record: Record, segments: Sequence[Sequence[float]] | None, transition: EffectUse | None) -> FlownPath:
    """The fitted samples of one record; `segments` as the estimate states them, None for those of the record."""
    t = record.time_s
    fitted = record.fit_mask() if segments is None else in_segments(t, segments) & ~record.holdout_mask()
    fitted &= record.read_mask
    span = record.conditions.time_s[[0, -1]]
    t = t[fitted & (t >= span[0]) & (t <= span[1])]
    if len(t) == 0:
        raise InputError(f"{record.name}: no sample lies in the segments of the estimate; is it the record of the fit?")
    flown = conditions_of_record(record).at(t)
    x = np.stack([flown[v] for v in RATIO_VARIABLES], axis=1)
    table = record.ratio_table
    declared = np.zeros(len(t)) if table is None else node_weights(table.axes, x) @ table.ratio.ravel()
    # Weighted by the square of the heat flux, on which the temperatures depend.
    turbulent = np.zeros(len(t)) if transition is None else intermittency_along(transition, flown)
    return FlownPath(x, (flown["h_ref_kg_m2_s"] * flown["H_r_J_kg"]) ** 2, declared, turbulent)


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


def _projection(
    names: Sequence[str], path: FlownPath, reference: FloatArray, table: RatioTable
) -> tuple[FloatArray, FloatArray]:
    """(k, node) H = P W, and (k,) P r_declared."""
    B = basis(names, path.x, reference, path.declared)
    root = np.sqrt(path.weight / np.sum(path.weight))
    scale = np.sqrt(np.sum((B * root[:, None]) ** 2, axis=0))
    # Projected, not sampled: the rank is the number of parameters at any sampling rate. Pseudo-measurements along the
    # path were rejected, since their spacing and noise would be invented (decision 0006).
    U, s, V = np.linalg.svd(B * root[:, None] / np.where(scale > 0.0, scale, 1.0), full_matrices=False)
    if len(B) < len(names) or s[-1] < MIN_SINGULAR_VALUE:
        least = V[-1] if len(s) else np.ones(len(names))
        alike = " and ".join(n for n, v in zip(names, least, strict=True) if abs(v) > 0.3)
        raise InputError(f"the fitted samples cannot distinguish {alike}; are the records those of the estimate?")
    P = (V.T / s) @ U.T * root / scale[:, None]
    W = node_weights(table.axes, path.x)
    return np.asarray((W.T @ P.T).T), P @ path.declared


def _representable(names: Sequence[str], path: FlownPath, table: RatioTable) -> BoolArray:
    """(k,) whether the nodes can represent each parameter: a slope needs two, a curvature one within the excursion."""
    has_slope = [len(axis) > 1 for axis in table.axes]
    has_curvature = [np.any((a > x.min()) & (a < x.max())) for a, x in zip(table.axes, path.x.T, strict=True)]
    second = [has_curvature[i] if i == j else has_slope[i] and has_slope[j] for i, j in SECOND_ORDER]
    possible = dict(zip((p.name for p in RATIO), (True, True, *has_slope, *second), strict=True))
    return np.array([possible[name] for name in names], dtype=bool)
