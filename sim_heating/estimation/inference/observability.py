"""Which parameters a record identifies, and the reason why others are omitted.

A derivative is identified where its variable changes over the fit segments, where no other parameter has the same
effect on all samples, and where its bound over the variable's own excursion is below the heating ratio itself
(docs/theory/estimation_statistics.md, equation 20). By default only those are estimated whose variable changes by more
than it is known to, and for which the ratio table has nodes.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np
from numpy.typing import NDArray

from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import RATIO_VARIABLES, SURFACES
from sim_heating.base.errors import InputError
from sim_heating.base.parameters import AT, LAYER, MODEL, SHORT_NAMES
from sim_heating.estimation.inference.identifiability import SINGULAR, covariance, directions
from sim_heating.heating.ratio.lookup import table_ratios_at
from sim_heating.heating.ratio.table import depends_on
from sim_heating.inputs.points import conditions_of_record, point_of_record
from sim_heating.inputs.record import Record
from sim_heating.simulation.predict import predict

CONSTANT_BELOW = {"alpha_deg": 0.05, "beta_deg": 0.02, "log10_re": 0.01, "elevon_deg": 0.05, "bodyflap_deg": 0.05}
"""Standard deviation over the fit segments below which a variable counts as constant, in its own unit."""
KNOWN_TO = {"alpha_deg": 0.1, "beta_deg": 0.1, "log10_re": 0.02, "elevon_deg": 0.1, "bodyflap_deg": 0.1}
"""Standard deviation of the error of a variable along a reconstructed trajectory, in its own unit: assumed. That of
log10 Re is 5 % of the density."""
FEWEST_STUCK = 10
STUCK = 10.0
"""Change of the declared model, in recorder steps or sigmas, above which a sensor with constant readings is stuck."""
MAGNITUDES = ("ratio.scale", "ratio.d0")
DERIVATIVES = tuple(f"ratio.d_{short}" for short in SHORT_NAMES)
EMITTANCE = "stack.emissivity_factor"
INFORMED_BELOW = 0.5
"""Bound over the standard deviation of the prior below which a record says something about a thermal parameter."""


def default_names(records: Sequence[Record]) -> tuple[str, ...]:
    """Parameters that are estimated by default: the magnitude and the five first derivatives.

    records : the records to be fitted jointly; of a control surface that none of them has there is no derivative

    `ratio.scale` where every record has a ratio table, else `ratio.d0` [-]; the derivatives are those of the founding
    paper, "Trends in Shuttle Entry Heating from the Correlation of Flight Test Maneuvers", equation 2.
    """
    surfaces = {name for r in records for name in r.surfaces}
    return heating_names(all(r.ratio_table is not None for r in records), surfaces)


def heating_names(with_table: bool, surfaces: Collection[str] = SURFACES) -> tuple[str, ...]:
    """Magnitude and first derivatives of a heating ratio, with a table or without one (`ratio.d0`, [-]).

    surfaces : columns of the control surfaces [deg] that the vehicle has
    """
    magnitude = MAGNITUDES[0] if with_table else MAGNITUDES[1]
    return (magnitude, *(n for n in DERIVATIVES if not is_of_absent_surface(n, surfaces)))


def is_of_absent_surface(name: str, surfaces: Collection[str]) -> bool:
    """Whether a parameter is a derivative against the deflection [deg] of a control surface that a vehicle has not.

    surfaces : columns of those that it has
    """
    against = {RATIO_VARIABLES[i] for i in variables_of(name)}
    return bool(against.intersection(SURFACES).difference(surfaces))


def deviations(records: Sequence[Record]) -> FloatArray:
    """(5,) standard deviation of each ratio variable over the fit segments of all records: the excursions flown.

    returns : alpha, beta [deg], log10 Re [-], elevon, bodyflap [deg]; zeros where no row lies in a fit segment

    Used in docs/theory/estimation_statistics.md, equation 20.
    """
    rows = [np.column_stack([r.conditions[v] for v in RATIO_VARIABLES])[fitted_rows(r)] for r in records]
    every = np.concatenate(rows)
    return np.std(every, axis=0) if len(every) else np.zeros(len(RATIO_VARIABLES))


def fitted_rows(record: Record) -> NDArray[np.bool_]:
    """(row,) whether each row of a record's conditions lies in a fit segment, between its first and last sample.

    record : conditions, samples and fit segments, times [s]

    Where no row does, those that enclose the samples, between which conditions are linear.
    """
    t, mask = record.conditions.time_s, record.fit_mask(record.conditions.time_s)
    # conditions without samples contain no information, whatever changes there
    samples = record.time_s[record.fit_mask()]
    rows = mask & (t >= samples.min(initial=np.inf)) & (t <= samples.max(initial=-np.inf))
    if len(samples) and not rows.any():
        rows[max(np.searchsorted(t, samples.min(), "right") - 1, 0) : np.searchsorted(t, samples.max()) + 1] = True
    return rows


def variables_of(name: str) -> tuple[int, ...]:
    """Indices of the ratio variables that a derivative is against; empty for any other parameter.

    name    : dotted name, with or without its record; `ratio.d_alpha_elevon` has two, `ratio.d_alpha2` has one
    returns : places [-] among alpha, beta, log10_re, elevon, bodyflap

    The names are those of docs/theory/equations.md, section 2.
    """
    stem = name.partition(AT)[0]
    if not stem.startswith("ratio.d_") or stem not in MODEL:
        return ()
    parts = stem.removeprefix("ratio.d_").split("_")
    return tuple(SHORT_NAMES.index(p.removesuffix("2")) for p in parts)


def constant_variables(names: Sequence[str], records: Sequence[Record]) -> dict[str, str]:
    """Derivatives against variables that are constant over the fit segments, with the reason for omitting them.

    names   : dotted names of parameters
    returns : name -> reason; the standard deviation is compared with 0.05 [deg] (beta 0.02 [deg], log10 Re 0.01 [-])

    First of the two criteria of docs/theory/estimation_statistics.md, equation 20.
    """
    sigma = deviations(records)
    at_rest = not np.any(sigma > 0.0)
    advice = "" if at_rest else "; a manoeuvre in it would identify the derivative"
    reasons = {}
    for name in names:
        for i in variables_of(name):
            if sigma[i] < CONSTANT_BELOW[RATIO_VARIABLES[i]]:
                variable = RATIO_VARIABLES[i]
                reasons[name] = (
                    f"{variable} is constant over the fit segments (standard deviation {sigma[i]:.2g}){advice}"
                )
    return reasons


def lacks_surface(name: str, records: Sequence[Record]) -> bool:
    """Whether a derivative is against the deflection of a control surface that the vehicle of the records lacks.

    name : dotted name of a parameter

    Of such a surface the whole record has the deflection 0 [deg], and no ratio table of it has nodes in the deflection.
    """
    columns = [RATIO_VARIABLES[i] for i in variables_of(name) if RATIO_VARIABLES[i] in SURFACES]
    return any(
        not (depends_on(c, r.ratio_table, r.turbulent) or np.any(r.conditions[c])) for c in columns for r in records
    )


def unsupported_derivatives(names: Sequence[str], records: Sequence[Record]) -> dict[str, str]:
    """Derivatives that are not estimated unless they are named, with the reason.

    names   : dotted names of parameters;  records : those that have them
    returns : name -> reason: the standard deviation of a variable, in [deg] or log10 Re [-], is not above the error to
              which a trajectory is known, or a ratio table has one node in it

    An error of a variable that is as large as its excursion halves the derivative (Fuller, "Measurement Error Models",
    1987). A table of one value declares no shape, and has no say. Source: docs/theory/estimation_statistics.md,
    equation 20a.
    """
    sigma = deviations(records)
    tables = [r.ratio_table for r in records if r.ratio_table is not None and r.ratio_table.ratio.size > 1]
    reasons: dict[str, str] = {}
    for name in names:
        for i in variables_of(name):
            variable = RATIO_VARIABLES[i]
            why = ""
            if sigma[i] <= KNOWN_TO[variable]:
                why = f"{variable} varies by {sigma[i]:.2g} (standard deviation) and is known to {KNOWN_TO[variable]:g}"
            elif any(len(table.axes[i]) == 1 for table in tables):
                why = f"the ratio table has one node in {variable} and cannot hold the derivative"
            if why:
                reasons.setdefault(name, f"{why}; name it to estimate it all the same")
    return reasons


def parameters_without_heating(names: Sequence[str], records: Sequence[Record]) -> dict[str, str]:
    """Parameters of the heating ratio where a record has no aerodynamic heating at all, with the reason.

    names   : dotted names of the parameters;  records : the records to be fitted
    returns : reason by name; empty where any record has h_ref other than 0

    The ratio enters the surface balance only as r h_ref (docs/theory/equations.md, section 1): with h_ref = 0 [kg/(m2
    s)] throughout, as in a ground step test, no temperature [K] depends on it.
    """
    if any(np.any(conditions_of_record(r)["h_ref_kg_m2_s"] != 0.0) for r in records):
        return {}
    reason = "h_ref is 0 throughout, so nothing depends on a heating ratio; name parameters of stack, clock or sensors"
    return {n: reason for n in names if n.startswith("ratio.")}


def default_thermal_names(records: Sequence[Record]) -> tuple[str, ...]:
    """Parameters that are estimated by default where no record has aerodynamic heating, as under a lamp: emittance,
    conductivity and heat capacity of each layer, by the layers' own names.

    records : the records to be fitted jointly; what is not a parameter of all of them is left out
    returns : names; all are factors [-] with priors, and those that the records do not inform are omitted
              (`uninformed`)

    The parameters: docs/equations_march.md, equations 9 and 10.
    """
    models = [point_of_record(r) for r in records]
    layers = dict.fromkeys(name for model in models for name in model.construction.stack.layer_names)
    factors = [f"stack.{layer}.{p.name}" for layer in layers for p in LAYER if not p.name.startswith("thickness")]
    return tuple(n for n in (EMITTANCE, *factors) if all(model.places.get(n, -1) >= 0 for model in models))


def uninformed(labels: Sequence[str], information: FloatArray, prior_sigma: FloatArray) -> dict[str, str]:
    """Parameters that records say hardly more about than their priors, with the reason for omitting them.

        sigma_k > 0.5 sigma_prior,k

    with the others estimated; the least informed is omitted first, as each omission lowers the bounds of the others.

    labels      : (parameter,) names of those that may be omitted, or empty for one that may not
    information : (parameter, parameter) of data and priors
    prior_sigma : (parameter,) standard deviations of the priors, each in its own unit ([-] for a factor)

    Bounds: docs/estimation_statistics.md, equation 19. The limit is a rule of this program.
    """
    remaining, reasons = [k for k, _ in enumerate(labels)], {}
    while remaining:
        sigma = np.sqrt(np.abs(np.diag(covariance(information[np.ix_(remaining, remaining)]))))
        over_prior = np.where([bool(labels[k]) for k in remaining], sigma / prior_sigma[remaining], 0.0)
        worst = int(np.argmax(over_prior))
        if not over_prior[worst] > INFORMED_BELOW:
            break
        k = remaining.pop(worst)
        reasons[labels[k]] = (
            f"its bound {sigma[worst]:.2g} is hardly below its prior's {prior_sigma[k]:.2g}, so the record does not "
            "inform it; name it to estimate it all the same"
        )
    return reasons


def mean_ratio(record: Record) -> float:
    """Mean of the declared ratio over the fit segments [-]; NaN where the record has no table.

    Scale r-bar of docs/theory/estimation_statistics.md, equation 20.
    """
    if record.ratio_table is None:
        return float("nan")
    rows = fitted_rows(record)
    x = np.column_stack([record.conditions[v] for v in RATIO_VARIABLES])[rows]
    if not len(x):
        return float("nan")
    return float(np.average(table_ratios_at(record.ratio_table, x), weights=record.conditions.duration_s[rows]))


def least_determined(
    labels: Sequence[str], information: FloatArray, ratio: FloatArray, excursion: FloatArray
) -> dict[str, str]:
    """The least determined derivative, with the reason, where it should be omitted; empty where all are identified.

        sigma_k prod_v std(x_v) > ratio

    Else the last parameter of infinite bound, if there is one.

    labels      : (parameter,) names
    information : (parameter, parameter) of data and priors
    ratio       : (parameter,) typical heating ratio of the records that have it [-]
    excursion   : (parameter, 5) standard deviations of the ratio variables in these, [deg] and [-]
    returns     : {name: reason} with one entry at most, as each omission changes the bounds of the others

    Source: docs/theory/estimation_statistics.md, equations 19 and 20.
    """
    singular = directions(information, list(labels), SINGULAR)
    sigma = np.sqrt(np.abs(np.diag(covariance(information))))
    worst, name, reason = 1.0, "", ""
    for k, label in enumerate(labels):
        variables = variables_of(label)
        if not variables:
            continue
        bound = float(np.nan_to_num(sigma[k] * np.prod(excursion[k, list(variables)]), nan=np.inf, posinf=np.inf))
        # false for a NaN ratio as well: without a scale no bound is too large
        if bound > worst * ratio[k]:
            worst, name = bound / ratio[k], label
            # the text shows the excursion, as a longer one is the remedy
            flown = " x ".join(f"{excursion[k, i]:.2g} of {RATIO_VARIABLES[i]}" for i in variables)
            reason = f"its bound over the excursion flown ({flown}) is {bound / ratio[k]:.1f} times the ratio itself"
            if singular:
                reason = f"{reason}; {singular[0].describe()}"
    unbounded = np.flatnonzero(~np.isfinite(sigma))
    if not name and singular and len(unbounded):
        name = labels[unbounded[-1]]
        reason = singular[0].describe()
    return {name: reason} if name else {}


def _is_still(read: FloatArray) -> bool:
    """Whether there are enough readings to call a sensor stuck, and all are equal."""
    finite = read[np.isfinite(read)]
    return len(finite) >= FEWEST_STUCK and bool(np.ptp(finite) == 0.0)


def without_stuck_sensors(record: Record) -> tuple[Record, list[str]]:
    """A record without the sensors that are stuck at one value although the declared model changes there.

    returns : the record, such sensors no longer used; one line for each, with its value [K]
    raises  : InputError where that is every used sensor

    A sensor is stuck where it has at least 10 readings, all equal, and the declared model changes by more than ten
    recorder steps or sigmas [K]. The criterion is a rule of this program, not of a publication.
    """
    mask, lines = record.fit_mask(), []
    readings = record.temperatures_K()[:, mask]
    still = [k for k, sensor in enumerate(record.sensors) if sensor.used and _is_still(readings[k])]
    if not still:  # the usual case, which needs no march
        return record, []
    indicated = predict(record, point_of_record(record)).indicated_K[:, mask]
    stuck = []
    for k in still:
        sensor, read, expected = record.sensors[k], readings[k], indicated[k]
        valid = np.isfinite(read) & np.isfinite(expected)
        if np.count_nonzero(valid) < FEWEST_STUCK:
            continue
        change = float(np.ptp(expected[valid]))
        if change > STUCK * max(sensor.lsb_K, sensor.noise_sigma_K or 1.0):
            stuck.append(sensor.name)
            lines.append(
                f"{record.name}, sensor {sensor.name}: stuck at {read[valid][0]:g} K in all "
                f"{np.count_nonzero(valid)} samples where the declared model changes by {change:.0f} K; not used"
            )
    if not stuck:
        return record, []
    if len(stuck) == len(record.used_sensors):
        raise InputError(f"{'; '.join(lines)}; no sensor remains to estimate from")
    used = [s.model_copy(update={"used": s.used and s.name not in stuck}) for s in record.sensors]
    return record.with_sensors(used), lines
