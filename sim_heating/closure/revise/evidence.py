"""Evidence of a flight on a control point's ratio tables, from an estimate and the records behind it.

Along the flown path the fit gives the ratio as a function of the conditions: the declared table with magnitude and
derivatives of the linear model, and what effects add that a table can hold (table_effects.py). This function with the
covariance of its parameters is the evidence (flown_ratio.py). In turbulent flow the fit has the turbulent ratio
multiplied by the same relative change; where the transition of the fit is by a turbulent table, the samples inform the
laminar table by the laminar part 1 - G of the heating and the turbulent one by the turbulent part G.

The parameters of the linear model by a table with nodes n are P (W n - r_declared), the projection of
closure/prior/flown_path.py: so an estimate and a table are compared parameter by parameter.

A parameter that the table cannot represent (the derivative against a variable with one node) and one that is not of the
ratio are marginalised: their rows and columns of C are left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array, diags_array

from sim_heating.base.arrays import BoolArray, FloatArray
from sim_heating.base.conditions import RATIO_VARIABLES
from sim_heating.base.errors import InputError
from sim_heating.base.parameters import EFFECT_PREFIX, RATIO, SECOND_ORDER
from sim_heating.closure.prior.flown_path import (
    FlownPath,
    joined_paths,
    marched_path,
    projection,
    record_path,
    turbulent_over_laminar,
)
from sim_heating.closure.revise.flown_ratio import FlownRatio, shape_sigma
from sim_heating.closure.revise.table_effects import added_ratio, derivatives, is_of_table, label
from sim_heating.estimation.report.estimate_file import Estimate
from sim_heating.heating.effects import EffectUse, use
from sim_heating.heating.effects.transition import TRANSITION
from sim_heating.heating.ratio.table import RatioTable
from sim_heating.heating.ratio.uncertainty import Evidence, Posterior, basis, declared_ratio, node_weights
from sim_heating.inputs.points import check_reference
from sim_heating.inputs.record import Record
from sim_heating.inputs.vehicle import ControlPoint, Vehicle

OF_START = "initial."
"""Begin of the names of unknown temperatures at the start of a fit."""


@dataclass(frozen=True, eq=False)
class FlightEvidence:
    """An estimate as evidence on a control point's tables.

    evidence    : on the nodes of the laminar table, one row a parameter of the linear model
    at_zero     : (k,) what is taken off H n to have the parameters by a table with the nodes n
    P           : (k, sample) projection of a ratio along the path on the parameters
    path        : the samples behind it, those inside the table
    outside     : number of samples outside the table
    laminar     : the ratio of the fit where the flow was laminar; None where it never was, or nothing of the ratio was
                  estimated
    turbulent   : the ratio of the fit where it was turbulent; None where no turbulent table is revised
    in_table    : the effects of the fit that the ratio includes
    not_written : parameter -> why it is not in the table
    """

    evidence: Evidence
    at_zero: FloatArray
    P: FloatArray
    path: FlownPath
    outside: int
    laminar: FlownRatio | None
    turbulent: FlownRatio | None
    in_table: tuple[EffectUse, ...]
    not_written: dict[str, str]

    def parameters_of(
        self, laminar: Posterior, turbulent: Posterior | None, *, with_effects: bool
    ) -> tuple[FloatArray, FloatArray]:
        """(k,) values and (k,) sigmas of the parameters by tables, each in its unit.

        turbulent    : where a turbulent table is revised, else None
        with_effects : whether the tables include the effects that the estimate adds to them
        The errors of the two tables are taken to be one: their sigmas are added.
        """
        laminar_part = np.ones(len(self.path.x)) if self.turbulent is None else 1.0 - self.path.turbulent
        parts = [(laminar, laminar_part)]
        if turbulent is not None:
            parts.append((turbulent, self.path.turbulent / self.path.by_table))
        at_zero = self.at_zero if with_effects else self.P @ self.path.declared
        value, sigma = -at_zero, np.zeros(len(at_zero))
        for table, fraction in parts:
            rows = csr_array(self.P @ (diags_array(fraction) @ node_weights(table.prior.axes, self.path.x)).toarray())
            value = value + rows @ table.ratio.ravel()
            sigma = sigma + table.sigma_along(rows)
        return value, sigma

    @property
    def form_covariance(self) -> FloatArray:
        """(k, k) covariance of the parameters as tables with the form of the fit have them."""
        flown = self.laminar or self.turbulent
        k = len(self.evidence.names)
        return np.zeros((k, k)) if flown is None else flown.form_covariance(self.evidence.names)


def is_effect(label: str) -> bool:
    """Whether a parameter's label is that of an effect."""
    return label.startswith(EFFECT_PREFIX)


def ratio_names(estimate: Estimate) -> tuple[str, ...]:
    """The estimated parameters of the linear heating model, in the model's order."""
    return tuple(p.name for p in RATIO if p.name in estimate.parameters)


def flight_evidence(
    estimate: Estimate,
    records: Sequence[Record],
    vehicle: Vehicle,
    point: ControlPoint,
    laminar: RatioTable | None = None,
    turbulent: RatioTable | None = None,
) -> FlightEvidence:
    """The evidence of an estimate on the nodes of a control point's tables.

    records   : those behind the estimate, in its order
    laminar   : the point's table before any revision; by default the one in force
    turbulent : its turbulent table before any revision, where that is to be revised too
    raises    : InputError where the ratio is over another reference heating, the path leaves the table, or the records
                are not those of the estimate
    """
    _check_weighable(estimate, point)
    for record in records:
        check_reference(record, vehicle, point)
    names = ratio_names(estimate)
    others = [n for n in estimate.parameters if n not in names]
    path, outside = _path(estimate, records), 0
    in_table = _in_table(estimate, point, path)
    if names or in_table:
        path, outside = _inside(path, point)
    written = _representable(names, point)
    if not written and len(_without_table(others)) == len(others):
        raise InputError(f"the table of {point.name} has too few nodes for {', '.join(names)}; add nodes there")
    fit = _FittedRatio(estimate, written, in_table, records[0])
    by_table = turbulent is not None and _by_table(fitted_use(estimate, TRANSITION))
    laminar_part = np.where(by_table, 1.0 - path.turbulent, 1.0)
    P, rows = np.zeros((0, len(path.x))), np.zeros((0, point.ratio.ratio.size))
    if names:
        P = projection(names, path, fit.about)[[names.index(n) for n in written]]
        # H = P W, with the multilinear weights W
        rows = np.asarray((node_weights(point.ratio.axes, path.x).T @ (P * laminar_part).T).T)
    at_zero = P @ (path.declared + fit.added(path.x))
    value = P @ (laminar_part * fit.ratio(path.x, path.declared))
    nodes = np.flatnonzero(np.any(rows != 0.0, axis=0))
    evidence = Evidence(written, nodes, rows[:, nodes], value, estimate.covariance(written))
    tables = (laminar or point.ratio, turbulent if by_table else None)
    flown = _flown_ratios(fit, _marched(estimate, records), *tables) if written or in_table else (None, None)
    not_written = dict.fromkeys(set(names) - set(written), "the table has too few nodes for it")
    not_written |= dict.fromkeys(_without_table(others), "is neither of the ratio table nor an effect")
    return FlightEvidence(evidence, at_zero, P, path, outside, *flown, in_table, dict(sorted(not_written.items())))


def _without_table(names: Sequence[str]) -> list[str]:
    """Parameters besides those of the linear model that are of no effect, as those of sensors."""
    return [n for n in names if not is_effect(n)]


def _flown_ratios(
    fit: _FittedRatio, path: FlownPath, laminar: RatioTable, turbulent: RatioTable | None
) -> tuple[FlownRatio | None, FlownRatio | None]:
    """The laminar and the turbulent ratio of a fit; tables before any revision, None where the turbulent one stays."""
    by_table = turbulent is not None
    of_laminar = _flown(fit, path, laminar, by_table, is_turbulent=False)
    return of_laminar, None if turbulent is None else _flown(fit, path, turbulent, by_table, is_turbulent=True)


def _check_weighable(estimate: Estimate, point: ControlPoint) -> None:
    """Check that an estimate has something for a point's table, and that the two can be weighed against each other.

    raises : InputError that states what to do
    """
    if not estimate.converged:
        raise InputError(
            "the estimate did not converge, so nothing of it goes into a table; estimate again with fewer parameters"
        )
    if point.ratio.sigma is None:
        raise InputError(f"{point.declared.ratio_table}: has no sigma column to weigh the flight against; add one")
    names = ratio_names(estimate)
    if not names and not any(map(is_effect, estimate.parameters)):
        raise InputError(
            "the estimate holds no ratio parameter and no effect, and a vehicle's tables take no other; estimate one"
        )
    # The table enters the update by its own sigma; as the prior of the fit it would count twice.
    with_prior = next((n for n in names if estimate.parameters[n].prior_sigma is not None), None)
    if with_prior is not None:
        raise InputError(
            f"{with_prior} was estimated with a prior, which is the table itself; estimate it with a flat one"
        )


def _representable(names: Sequence[str], point: ControlPoint) -> tuple[str, ...]:
    """Parameters of the linear model that the nodes of a point's table can represent."""
    has_slope = [len(axis) > 1 for axis in point.ratio.axes]
    second = [has_slope[i] and has_slope[j] for i, j in SECOND_ORDER]
    possible = dict(zip((p.name for p in RATIO), (True, True, *has_slope, *second), strict=True))
    return tuple(n for n in names if possible[n])


def _evenly(count: int) -> BoolArray:
    """(count,) mask of at most `most_samples` samples."""
    most_samples = 240  # samples of the path that are kept as evidence, evenly chosen
    chosen = np.zeros(count, dtype=bool)
    chosen[:: -(-count // most_samples)] = True
    return chosen


def _by_table(transition: EffectUse | None) -> bool:
    """Whether a transition takes its turbulent ratio from a table."""
    return transition is not None and transition.by_name["by_table"] > 0.0


def _in_table(estimate: Estimate, point: ControlPoint, path: FlownPath) -> tuple[EffectUse, ...]:
    """The estimated effects that a ratio table can hold, and that the vehicle does not declare as effects."""
    declared = {u.effect.name for u in point.effects}
    labels = [n.removeprefix(EFFECT_PREFIX).rpartition(".")[0] for n in estimate.parameters if is_effect(n)]
    fitted = [fitted_use(estimate, name) for name in dict.fromkeys(labels) if name not in declared]
    return tuple(used for used in fitted if used is not None and is_of_table(used, path.x[_evenly(len(path.x))]))


@dataclass(frozen=True, eq=False)
class _FittedRatio:
    """The ratio of a fit as a function of the conditions.

    names    : parameters of the linear model that a table can represent
    in_table : effects that it takes
    record   : whose declared tables are multiplied; of several records the first, as they are of one point
    """

    estimate: Estimate
    names: tuple[str, ...]
    in_table: tuple[EffectUse, ...]
    record: Record

    @property
    def about(self) -> FloatArray:
        return self.estimate.reference_condition.values()

    def added(self, x: FloatArray) -> FloatArray:
        """(sample,) ratio that the effects add [-] at (sample, 5) conditions."""
        return sum((added_ratio(used, x, self.about) for used in self.in_table), start=np.zeros(len(x)))

    def ratio(self, x: FloatArray, declared: FloatArray) -> FloatArray:
        """(sample,) laminar ratio [-], with the (sample,) ratio of the declared table."""
        ratio = declared + self.added(x)
        if not self.names:
            return ratio
        return ratio + basis(self.names, x, self.about, declared) @ self.estimate.values(self.names)

    def laminar_at(self, x: FloatArray) -> FloatArray:
        """(sample,) laminar ratio [-] at any conditions."""
        return self.ratio(x, declared_ratio(self.record.ratio_table, x))

    def turbulent_at(self, x: FloatArray) -> FloatArray:
        """(sample,) turbulent ratio [-] at any conditions."""
        declared = declared_ratio(self.record.ratio_table, x)
        return self.ratio(x, declared) * turbulent_over_laminar(self.record, x, declared)

    def derivatives(self, x: FloatArray, declared: FloatArray) -> tuple[tuple[str, ...], FloatArray]:
        """Labels of the parameters, and (sample, k) the derivatives of the laminar ratio with respect to them.

        A parameter without a sigma, as one on its bound, is fixed.
        """
        estimates = self.estimate.parameters
        labels, columns = self.names, [basis(self.names, x, self.about, declared)] if self.names else []
        for used in self.in_table:
            by_label = {label(used, p.name): p.name for p in used.effect.parameters}
            free = {k: n for k, n in by_label.items() if k in estimates and estimates[k].sigma > 0.0}
            labels = (*labels, *free)
            columns.append(derivatives(used, tuple(free.values()), x, self.about))
        return labels, np.concatenate(columns, axis=1)


def _marched(estimate: Estimate, records: Sequence[Record]) -> FlownPath:
    """The samples on which the fitted temperatures of all records depend, at most `most_samples`."""
    transition, parts = fitted_use(estimate, TRANSITION), []
    for i, record in enumerate(records):
        record_span = [[float(record.time_s[0]), float(record.time_s[-1])]]
        segments = record.declared.segments.fit or record_span if estimate.segments is None else estimate.segments[i]
        start = estimate.starts[i] if estimate.starts is not None else None
        begin = float(record.conditions.time_s[0]) if start is None else start.time_s
        if start is None and any(n.startswith(OF_START) for n in estimate.parameters):
            begin = segments[0][0]
        parts.append(marched_path(record, segments, begin, transition))
    path = joined_paths(parts)
    return path.subset(_evenly(len(path.x)))


def _flown(
    fit: _FittedRatio, path: FlownPath, table: RatioTable, by_table: bool, *, is_turbulent: bool
) -> FlownRatio | None:
    """The ratio of a fit where the flow was laminar, or turbulent; None where it was so for too short a time.

    table    : before any revision;  by_table : whether a turbulent table takes what was turbulent
    """
    least_part = 0.002  # laminar, or turbulent, part of the heating of a sample that informs the table of it [-]
    least_weight = 1e-5  # weight of all samples together, of 1, below which a table is not informed
    # (dT/dr)^2 of a wall near radiation equilibrium at equal ratio; path.weight is the square of the heat flux.
    weight = path.weight**0.25
    weight = weight / np.sum(weight)
    fraction = np.ones(len(path.x))
    if by_table:
        fraction = path.turbulent if is_turbulent else 1.0 - path.turbulent
    weight, used = weight * fraction**2, fraction >= least_part
    for axis, x in zip(table.axes, path.x.T, strict=True):
        used &= (len(axis) == 1) | ((x >= axis[0]) & (x <= axis[-1]))
    if np.sum(weight[used]) < least_weight:
        return None
    path, weight = path.subset(used), weight[used]
    factor = path.by_table if is_turbulent else np.ones(len(path.x))
    labels, B = fit.derivatives(path.x, path.declared)
    return FlownRatio(
        labels,
        path.x,
        weight,
        factor * fit.ratio(path.x, path.declared),
        factor[:, None] * B,
        fit.estimate.covariance(labels),
        shape_sigma(table, path.x, weight),
        fit.turbulent_at if is_turbulent else fit.laminar_at,
    )


def _path(estimate: Estimate, records: Sequence[Record]) -> FlownPath:
    """The fitted samples of all records."""
    segments, transition = estimate.segments, fitted_use(estimate, TRANSITION)
    return joined_paths(
        [record_path(r, None if segments is None else segments[i], transition) for i, r in enumerate(records)]
    )


def fitted_use(estimate: Estimate, name: str) -> EffectUse | None:
    """An effect as it was in a fit, with the values that were estimated; None where the fit did not have it."""
    in_force = {e.name: e.parameters for e in estimate.effects}
    head = f"{EFFECT_PREFIX}{name}."
    estimated = {n.removeprefix(head): p.value for n, p in estimate.parameters.items() if n.startswith(head)}
    return use(name, in_force.get(name, {}) | estimated) if name in in_force or estimated else None


def _inside(path: FlownPath, point: ControlPoint) -> tuple[FlownPath, int]:
    """The samples inside the table's axes (an axis of one value has no outside), and how many lie outside."""
    outside_share = 0.1  # share of the fitted samples outside a table's axes above which it is not updated
    out = np.zeros(len(path.x), dtype=bool)
    for name, axis, x in zip(RATIO_VARIABLES, point.ratio.axes, path.x.T, strict=True):
        beyond = (len(axis) > 1) & ((x < axis[0]) | (x > axis[-1]))
        if np.mean(beyond) > outside_share:
            raise InputError(
                f"{point.declared.ratio_table}: {name} lay outside its {axis[0]:g} to {axis[-1]:g} for "
                f"{np.mean(beyond):.0%} of the fitted samples ({x.min():.4g} to {x.max():.4g}); extend the table first"
            )
        out |= beyond
    return path.subset(~out), int(np.count_nonzero(out))
