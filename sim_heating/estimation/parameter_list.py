"""The parameters that exist for a record or a scenario, and those that a record can identify.

A parameter's bound is the Cramer-Rao bound of the record's readings at the declared model, for white noise
(docs/theory/estimation_statistics.md, equations 14 and 18): with all other parameters known; with the heating that
`estimate` fits by default estimated as well; and with all other parameters as uncertain as their priors state. The
parameter's own prior is left out, so that the bound can be compared with it. Coloured residuals, as those of a model
that does not fit the readings, make the bounds of a fit larger.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.base.errors import RunError
from sim_heating.base.files import output_directory, write_json, write_text_atomic
from sim_heating.base.files.text import first_of
from sim_heating.base.parameters import (
    CLOCK_SKEW,
    EFFECT_PREFIX,
    RECORD_PARAMETERS,
    SENSOR,
    SENSOR_PREFIX,
    STACK_PREFIX,
    Parameter,
    layer_parameter,
)
from sim_heating.base.progress import Progress, no_progress
from sim_heating.base.report.table import Column, Table
from sim_heating.estimation.fit import first_values
from sim_heating.estimation.inference import observability
from sim_heating.estimation.inference.identifiability import covariance
from sim_heating.estimation.inference.noise import noise_of_readings
from sim_heating.estimation.problem import FitProblem, joint_reference
from sim_heating.estimation.record_fit import SKEW_SPAN_S
from sim_heating.estimation.unknowns import FitOptions, without_action
from sim_heating.heating.effects import EffectUse, use
from sim_heating.inputs.points import point_of_record, point_of_vehicle
from sim_heating.inputs.record import Record, Sensor, load_record
from sim_heating.inputs.scenario import Scenario
from sim_heating.march.point import PointModel, insulation_layer

FORMAT = "parameters/1"
COMMAND = "parameters"
FILES = JSON, CSV = "parameters.json", "parameters.csv"
BOUND_OVER_PRIOR = 0.5
"""Bound over the sigma of the prior [-] below which a record identifies a parameter: it then adds at least four times
the information that was there before."""
CONFOUNDED = 0.9
"""Correlation of two parameters' effects on the readings [-] above which they are named as confounded."""
LEAST_INFORMATION = 1e-6
"""Square of the wanted bound over that of a parameter alone [-] below which no reading depends on the parameter."""
LEAST_EXCURSION = 1e-12
NO_EFFECT = "no reading depends on it at the declared values"
DECLARED_EXACTLY = "declared as known exactly, with a sigma of 0"
INSULATION = "stack.rsi."
"""Beginning of the names of parameters by the role of a layer."""
SHOWN_POINTS = 4
"""Control points that the title of a table names."""
YES, JOINTLY, WEAKLY, NO = "yes", "with others known", "weakly", "no"


@dataclass(frozen=True)
class ListedParameter:
    """One parameter of a record or a control point.

    name         : dotted name
    other_names  : further names of the same parameter, such as that of a layer by its own name
    belongs_to   : the heating ratio, a layer, the back face, the record's clock, a sensor or an effect
    unit         : contract unit, "1" where it has none
    nominal      : declared value, which is also the mean of the prior
    prior_sigma  : standard deviation of the prior; infinite for a flat one
    lower, upper : bounds
    text         : description
    sigma_alone  : bound from the record's readings with all other parameters known, in the unit; None without a record
    sigma_with_heating : bound where the heating that is fitted by default is estimated as well
    sigma_with_all : bound where, in addition, all others are as uncertain as their priors state
    identified   : `yes`: by the last of these; `with others known`: by the one before alone; `weakly`: a derivative
                   that is estimated where it is named; `no`; None without a record
    reason       : why not
    confounded_with : names and correlations [-] of parameters whose effects on the readings are like its own, above 0.9
    """

    name: str
    other_names: tuple[str, ...]
    belongs_to: str
    unit: str
    nominal: float
    prior_sigma: float
    lower: float
    upper: float
    text: str
    sigma_alone: float | None = None
    sigma_with_heating: float | None = None
    sigma_with_all: float | None = None
    identified: str | None = None
    reason: str = ""
    confounded_with: tuple[tuple[str, float], ...] = ()

    def as_json(self) -> dict[str, Any]:
        """Entry of parameters.json; what is infinite or unknown is None."""
        return {
            "name": self.name,
            "other_names": list(self.other_names),
            "belongs_to": self.belongs_to,
            "unit": self.unit,
            "nominal": self.nominal,
            "prior_sigma": _finite(self.prior_sigma),
            "lower": _finite(self.lower),
            "upper": _finite(self.upper),
            "text": self.text,
            "sigma_alone": _finite(self.sigma_alone),
            "sigma_with_heating": _finite(self.sigma_with_heating),
            "sigma_with_all": _finite(self.sigma_with_all),
            "identified": self.identified,
            "reason": self.reason,
            "confounded_with": dict(self.confounded_with),
        }


@dataclass(frozen=True, repr=False)
class ParameterList:
    """The parameters of a record, or of one control point of a scenario.

    control_point : name
    parameters    : by what they belong to, from the heating inwards
    record        : name of the record that identifies them; None for a scenario
    """

    control_point: str
    parameters: tuple[ListedParameter, ...]
    record: str | None = None

    def __repr__(self) -> str:
        identified = sum(p.identified == YES for p in self.parameters)
        identified_by = "" if self.record is None else f", {identified} identified by {self.record}"
        return f"<ParameterList of {self.control_point}: {len(self.parameters)} parameters{identified_by}>"

    def __getitem__(self, name: str) -> ListedParameter:
        """The parameter of a name, by which a layer may be called too.

        raises : KeyError where there is none
        """
        for parameter in self.parameters:
            if name == parameter.name or name in parameter.other_names:
                return parameter
        raise KeyError(name)


def parameter_list(
    record: Record | str | os.PathLike[str],
    *,
    effects: Sequence[str] = (),
    reference: Mapping[str, float] | None = None,
    progress: Progress = no_progress,
) -> ParameterList:
    """Every parameter that exists for a flight record, with prior and bounds, and whether the record identifies it.

    Of a control surface that never moves and that the heating does not depend on there is no derivative.

    record    : a record or its directory
    effects   : names of effects that the record does not declare, listed at their nominal values
    reference : values of ratio variables that derivatives are about ([deg], [-]), where not the record's own
    progress  : called with the fraction done and a line of text
    returns   : the parameters, each with its unit
    raises    : InputError for a record or effect that cannot be used, RunError where its model cannot be marched

    Bounds: docs/theory/estimation_statistics.md, equations 14, 18 and 20; for white noise, at the declared model.

    >>> import sim_heating as sh
    >>> found = sh.parameter_list("scenarios/records/practice/p06")
    >>> found["ratio.d_alpha"].identified, found["ratio.d_beta"].identified
    ('yes', 'no')
    """
    loaded, _ = observability.without_stuck_sensors(load_record(record))
    uses = tuple(use(name) for name in effects)
    model = point_of_record(loaded, effects=uses)
    listed = _listed(model, loaded.used_sensors)
    idle = without_action([p.name for p in listed], loaded, model)
    listed = [
        p for p in listed if p.name not in idle and not observability.is_of_absent_surface(p.name, loaded.surfaces)
    ]
    progress(0.0, "sensitivities of the readings")
    return ParameterList(loaded.declared.control_point, _judged(listed, loaded, uses, reference), loaded.name)


def scenario_parameters(scenario: Scenario, *, effects: Sequence[str] = ()) -> list[ParameterList]:
    """Every parameter that exists at each control point of a scenario, with prior and bounds.

    A vehicle without a control surface has no derivatives against its deflection.

    effects : names of effects that the vehicle does not declare, listed at their nominal values
    returns : one list a control point, each parameter with its unit ([-], [K] ...)
    raises  : InputError for an unknown effect
    """
    uses = tuple(use(name) for name in effects)
    lists = []
    for name in scenario.names:
        point = scenario.vehicle.control_point(name)
        model = point_of_vehicle(scenario.vehicle, point, effects=(*scenario.effects(name), *uses))
        listed = _listed(model, point.sensors)
        surfaces = scenario.vehicle.surfaces
        lists.append(
            ParameterList(name, tuple(p for p in listed if not observability.is_of_absent_surface(p.name, surfaces)))
        )
    return lists


# What exists ----------------------------------------------------------------------------------------------------------


def _listed(model: PointModel, sensors: Sequence[Sensor]) -> list[ListedParameter]:
    """All parameters of a model and its sensors, without bounds from readings."""
    of_record = RECORD_PARAMETERS | {CLOCK_SKEW.name: replace(CLOCK_SKEW, lower=-SKEW_SPAN_S, upper=SKEW_SPAN_S)}
    return [
        *_of_heating_and_wall(model),
        *_of_effects(model),
        *(_entry(p, p.value, "thermocouples and clock") for p in of_record.values()),
        *_of_sensors(sensor for sensor in sensors if sensor.used),
    ]


def _name_without_coating(same: Sequence[str]) -> str:
    """The name of a parameter with several, of a wall without a coating, whose layers have no roles; empty for none."""
    name = same[:2][-1] if same[0].startswith(INSULATION) else same[0]
    return "" if name.startswith("stack.coating.") else name


def _of_heating_and_wall(model: PointModel) -> Iterator[ListedParameter]:
    """Parameters of the ratio and the stack, each once, with its other names."""
    absent = observability.MAGNITUDES[1] if model.ratio is not None else observability.MAGNITUDES[0]
    names: dict[int, list[str]] = {}
    for name, entry in model.places.items():
        if entry >= 0:
            names.setdefault(entry, []).append(name)
    has_coating = insulation_layer(model.construction) > 0
    for same in names.values():
        name = same[0] if has_coating else _name_without_coating(same)
        if name in (absent, ""):
            continue
        others = tuple(n for n in same if n != name)
        yield _entry(model.definition(name), model.value(name), _owner(name, model), others, name)


def _of_effects(model: PointModel) -> Iterator[ListedParameter]:
    """Parameters of the effects of a point."""
    for used in model.effects:
        for parameter in used.effect.parameters:
            name = f"{EFFECT_PREFIX}{used.effect.name}.{parameter.name}"
            yield _entry(model.definition(name), model.value(name), f"effect {used.effect.name}", name=name)


def _of_sensors(sensors: Iterable[Sensor]) -> Iterator[ListedParameter]:
    """Parameters of thermocouples, each at its declared value."""
    for sensor in sensors:
        for kind, parameter in SENSOR.items():
            nominal = sensor.tau_s if kind == "tau_s" else parameter.value
            name = f"{SENSOR_PREFIX}{sensor.name}.{kind}"
            yield _entry(parameter, nominal, f"thermocouple {sensor.name}", name=name)


def _entry(
    p: Parameter, nominal: float, belongs_to: str, other_names: tuple[str, ...] = (), name: str = ""
) -> ListedParameter:
    return ListedParameter(name or p.name, other_names, belongs_to, p.unit, nominal, p.sigma, p.lower, p.upper, p.text)


def _owner(name: str, model: PointModel) -> str:
    """What a parameter of heating or stack belongs to."""
    layers, insulation = model.construction.stack.layer_names, insulation_layer(model.construction)
    if name.startswith("ratio."):
        return "heating ratio"
    if name.startswith("back."):
        return "back face"
    if name == f"{STACK_PREFIX}contact_factor":
        return "contacts of the layers"
    if name.startswith("stack.coating.") or name == "stack.emissivity_factor":
        return f"layer {layers[0]}, the outermost"
    matched = layer_parameter(name)
    layer = layers[insulation] if matched is None or matched[0] == "rsi" else matched[0]
    return f"layer {layer}{', the insulation' if insulation > 0 and layer == layers[insulation] else ''}"


# What a record identifies ---------------------------------------------------------------------------------------------


def _judged(
    listed: Sequence[ListedParameter],
    record: Record,
    effects: Sequence[EffectUse],
    reference: Mapping[str, float] | None,
) -> tuple[ListedParameter, ...]:
    """The parameters with their bounds from a record, and whether it identifies them."""
    names = [p.name for p in listed]
    problem = FitProblem([record], names, joint_reference([record], reference), FitOptions(effects))
    labels = [u.parameter.name for u in problem.unknowns]
    begin = first_values(problem, {})
    _set_noise(problem, dict(zip(labels, begin, strict=True)))
    evaluation = problem.evaluate(begin)
    if not np.isfinite(evaluation.log_likelihood):
        problem.samples(begin)  # says what failed
        raise RunError(f"{record.name}: the declared model cannot be marched along it; see `sim-heating predict`")
    order = [labels.index(name) for name in names]
    information = evaluation.information[np.ix_(order, order)]
    return _with_bounds(listed, information, record, begin[order])


def _set_noise(problem: FitProblem, values: Mapping[str, float]) -> None:
    """Set the noise of sensors that declare none to that of their readings, or of the residuals of the declared model.

    The latter holds the model's error too, and is taken where readings are too few to tell their noise.
    """
    (record_fit,) = problem.record_fits
    record, undeclared = record_fit.record, [c for c in record_fit.channels if c.sensor.noise_sigma_K is None]
    noise_K = {
        c.number: noise_of_readings(record.time_s, record.temperatures_K([c.sensor])[0], c.sensor.lsb_K)
        for c in undeclared
    }
    record_fit.sigma_K |= {number: sigma for number, sigma in noise_K.items() if sigma is not None}
    if None not in noise_K.values():
        return
    # without a table the declared model has no heating
    magnitude = list(values.keys() & {observability.MAGNITUDES[1]})
    declared = FitProblem([record], magnitude, problem.reference, problem.options)
    declared.update_noise(np.array([values[n] for n in magnitude]))
    misfit = declared.record_fits[0].sigma_K
    record_fit.sigma_K |= {number: misfit[number] for number, sigma in noise_K.items() if sigma is None}


def _with_bounds(
    listed: Sequence[ListedParameter], information: FloatArray, record: Record, values: FloatArray
) -> tuple[ListedParameter, ...]:
    """The parameters with bounds from the information of a record.

    information : (parameter, parameter) of the readings
    values      : (parameter,) at which it was computed
    """
    names = [p.name for p in listed]
    impossible = observability.constant_variables(names, [record]) | observability.parameters_without_heating(
        names, [record]
    )
    doubtful = observability.unsupported_derivatives(names, [record])
    limits = _wanted_bounds(listed, record, values)
    # rounding of a march gives parameters without any effect a trace of information
    informed = np.diag(information) * limits**2 > LEAST_INFORMATION  # never where the sigma of a prior is 0
    alone = 1.0 / np.sqrt(np.where(informed, np.diag(information), 1.0))
    rho = information * np.outer(alone, alone)
    usable = [k for k, n in enumerate(names) if informed[k] and n not in impossible]
    fitted = [k for k in usable if names[k] in observability.default_names([record]) and names[k] not in doubtful]
    with_all = _marginal_sigmas(information, [p.prior_sigma for p in listed], usable, fitted)

    def bounded(k: int, p: ListedParameter) -> ListedParameter:
        if k not in usable:
            why = impossible.get(p.name, DECLARED_EXACTLY if p.prior_sigma == 0.0 else NO_EFFECT)
            return replace(p, identified=NO, reason=why)
        chosen = list(dict.fromkeys([k, *fitted]))
        with_heating = float(np.sqrt(covariance(information[np.ix_(chosen, chosen)])[0, 0]))
        near = sorted((j for j in usable if j != k and abs(rho[k, j]) > CONFOUNDED), key=lambda j: -abs(rho[k, j]))
        identified, reason = YES if with_all[k] < limits[k] else JOINTLY, ""
        if not (with_all[k] < limits[k] or with_heating < limits[k]):
            identified, reason = NO, _too_wide(p, with_heating / float(limits[k]))
        elif p.name in doubtful:
            identified, reason = WEAKLY, doubtful[p.name]
        return replace(
            p,
            sigma_alone=float(alone[k]),
            sigma_with_heating=with_heating,
            sigma_with_all=float(with_all[k]),
            identified=identified,
            reason=reason,
            confounded_with=tuple((names[j], float(rho[k, j])) for j in near),
        )

    return tuple(bounded(k, p) for k, p in enumerate(listed))


def _marginal_sigmas(
    information: FloatArray, prior_sigma: Sequence[float], usable: Sequence[int], fitted: Sequence[int]
) -> FloatArray:
    """(parameter,) bound of each parameter where all others are as uncertain as their priors state.

        sigma_k^-2 = 1 / C_kk - prior_k^-2,    C = (M + diag(prior^-2))^-1

    usable : parameters that the readings depend on;  fitted : those among them that are unknown without a prior, the
             heating; of other parameters without a prior none is unknown but the one whose bound it is
    """
    sigmas = np.full(len(prior_sigma), np.inf)
    prior = np.array([0.0 if sigma == 0.0 else sigma**-2.0 for sigma in prior_sigma])
    known_before = [k for k in usable if prior[k] > 0.0 or k in fitted]
    for k in usable:
        chosen = known_before if k in known_before else [*known_before, k]
        C = covariance(information[np.ix_(chosen, chosen)] + np.diag(prior[chosen]))
        at = chosen.index(k)
        gained = 1.0 / C[at, at] - prior[k]
        sigmas[k] = gained**-0.5 if gained > 0.0 else np.inf
    return sigmas


def _wanted_bounds(listed: Sequence[ListedParameter], record: Record, values: FloatArray) -> FloatArray:
    """(parameter,) bound below which a parameter counts as identified, in its unit.

    Half the sigma of its prior; for a flat one the heating ratio, for a derivative over the excursion flown
    (docs/theory/estimation_statistics.md, equation 20).
    """
    d0 = [abs(v) for p, v in zip(listed, values, strict=True) if p.name == observability.MAGNITUDES[1]]
    ratio, excursion = d0[0] if d0 else observability.mean_ratio(record), observability.deviations([record])
    limits = []
    for p in listed:
        variables = list(observability.variables_of(p.name))
        if math.isfinite(p.prior_sigma):
            limits.append(BOUND_OVER_PRIOR * p.prior_sigma)
        elif variables:
            limits.append(ratio / max(float(np.prod(excursion[variables])), LEAST_EXCURSION))
        elif p.name in observability.MAGNITUDES:
            limits.append(1.0 if p.name == observability.MAGNITUDES[0] else ratio)
        else:  # of a user-defined effect
            limits.append(BOUND_OVER_PRIOR * max(abs(p.nominal), min(p.upper - p.lower, 1.0)))
    return np.array(limits)


def _too_wide(p: ListedParameter, bound: float) -> str:
    """Why a record does not identify a parameter that its readings depend on.

    bound : over the wanted bound [-]
    """
    if math.isfinite(p.prior_sigma):
        return f"its bound is {BOUND_OVER_PRIOR * bound:.2g} times the sigma of its prior"
    return f"its bound over the excursion flown is {bound:.2g} times the ratio itself"


# Files and tables -----------------------------------------------------------------------------------------------------


def contents(lists: Sequence[ParameterList]) -> dict[str, Any]:
    """Contents of parameters.json."""
    return {
        "format": FORMAT,
        "lists": [
            {
                "control_point": of_point.control_point,
                "record": of_point.record,
                "parameters": [p.as_json() for p in of_point.parameters],
            }
            for of_point in lists
        ],
    }


def write_parameters(
    lists: Sequence[ParameterList],
    out: str | os.PathLike[str],
    inputs: Sequence[str | os.PathLike[str]] = (),
) -> list[str]:
    """Write parameters.json and parameters.csv into a directory; returns their names.

    inputs : files and directories that must not be in it
    """
    with output_directory(out, COMMAND, expected=FILES, inputs=inputs) as folder:
        write_json(folder / JSON, contents(lists))
        write_text_atomic(folder / CSV, _all_in_one(lists).csv())
    return list(FILES)


def parameter_tables(lists: Sequence[ParameterList]) -> list[Table]:
    """Tables for a reader: one for each thing that has parameters; what control points have in common appears once."""
    groups: dict[tuple[str, tuple[ListedParameter, ...]], list[str]] = {}
    for of_point in lists:
        for owner in dict.fromkeys(p.belongs_to for p in of_point.parameters):
            listed = tuple(p for p in of_point.parameters if p.belongs_to == owner)
            groups.setdefault((owner, listed), []).append(of_point.control_point)
    tables = []
    for (owner, listed), points in groups.items():
        where = (
            ""
            if len(lists) == 1
            else f": all {len(lists)} control points"
            if len(points) == len(lists)
            else f": {first_of(points, SHOWN_POINTS)}"
        )
        tables.append(Table(f"{owner[0].upper()}{owner[1:]}{where}", *_rows(listed, lists[0].record is not None)))
    return tables


def _rows(listed: Sequence[ListedParameter], judged: bool) -> tuple[list[Column], list[list[Any]]]:
    columns = [
        Column("parameter"),
        Column("nominal", is_text=True),
        Column("prior", is_text=True),
        Column("bounds", is_text=True),
    ]

    def stated(p: ListedParameter) -> list[Any]:
        return [p.name, _nominal(p), _prior(p), _bounds(p)]

    if not judged:
        return [*columns, Column("meaning", is_text=True)], [[*stated(p), p.text] for p in listed]
    columns += [Column("sigma", format=".2g"), Column("identified", is_text=True), Column("remark", is_text=True)]
    reasons = {(p.identified, p.reason) for p in listed}
    if len(listed) > 1 and len(reasons) == 1 and listed[0].reason and not any(p.confounded_with for p in listed):
        ends = f"{listed[0].name} to {listed[-1].name}, all {len(listed)}"  # each would have the same line
        return columns, [[ends, "", "", "", None, listed[0].identified, listed[0].reason]]
    return columns, [[*stated(p), _finite(p.sigma_with_heating), p.identified, _remark(p)] for p in listed]


def _remark(p: ListedParameter) -> str:
    """What is most like a parameter, by its last name where the rest is the same, or why it is not identified."""
    if not p.confounded_with:
        return p.reason
    (name, rho), *others = p.confounded_with
    owner = f"{p.name.rpartition('.')[0]}."
    return f"like {name.removeprefix(owner)} ({rho:+.2f}){f', {len(others)} more' if others else ''}"


def _all_in_one(lists: Sequence[ParameterList]) -> Table:
    """All lists as one table, for CSV."""
    keys = [k for k in ListedParameter.__dataclass_fields__ if k not in ("other_names", "confounded_with")]
    rows = [
        [
            of_point.control_point,
            *(_cell(getattr(p, k)) for k in keys),
            " ".join(p.other_names),
            " ".join(f"{n}:{rho:.3f}" for n, rho in p.confounded_with),
        ]
        for of_point in lists
        for p in of_point.parameters
    ]
    return Table("Parameters", ["control_point", *keys, "other_names", "confounded_with"], rows)


def _cell(value: Any) -> Any:
    """A value in CSV: empty where it is infinite or unknown."""
    return _finite(value) if isinstance(value, float) else value


def _nominal(p: ListedParameter) -> str:
    return f"{p.nominal:g}{'' if p.unit == '1' else f' {p.unit}'}"


def _prior(p: ListedParameter) -> str:
    return f"+- {p.prior_sigma:g}" if math.isfinite(p.prior_sigma) else "flat"


def _bounds(p: ListedParameter) -> str:
    if not (math.isfinite(p.lower) or math.isfinite(p.upper)):
        return "none"
    return f"{p.lower:g} to {p.upper:g}"


def _finite(value: float | None) -> float | None:
    return value if value is not None and math.isfinite(value) else None
