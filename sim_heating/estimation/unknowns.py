"""The unknowns of a fit: what is stated of parameters, and which of them are estimated for which records.

Parameters of heating and stack are those of a control point, shared by all its records; those of clocks, sensors and
initial profiles belong to one record. Names may have an owner (inputs/parameter_owners.py).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sim_heating.base.errors import InputError
from sim_heating.base.files import suggestion
from sim_heating.base.parameters import AT, CLOCK_SKEW, EFFECT_PREFIX, Parameter
from sim_heating.estimation.record_fit import (
    LONGEST_STEP_S,
    RecordFit,
    Start,
    StartMaker,
    parameter_definition,
    sensor_definition,
)
from sim_heating.heating.effects import EffectUse, use
from sim_heating.heating.effects.definition import ModelParameter
from sim_heating.heating.effects.recombination import RECOMBINATION
from sim_heating.inputs.parameter_owners import Owners, is_of_record
from sim_heating.inputs.points import flow_of_record, point_of_record
from sim_heating.inputs.record import Record
from sim_heating.march.point import PointModel, check_one_name
from sim_heating.thermal.frame import STEP_TOLERANCE_K


@dataclass(frozen=True)
class FitParameter:
    """One estimated parameter.

    label     : its name in results, with its record or control point where there are several
    parameter : definition, prior and bounds
    records   : indices of the records that have it
    tied      : labels of the parameters that it stands for, where these are tied
    """

    label: str
    parameter: Parameter
    records: tuple[int, ...]
    tied: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class FitOptions:
    """Options of a fit, all with defaults.

    Names are as in inputs/parameter_owners.py: plain, or with an owner behind @.

    effects        : in addition to the declared model, and to those that the names of parameters imply
    fixed          : name -> value of a parameter in place of the declared one, where it is not estimated
    priors         : name -> mean and standard deviation of another prior, infinite for a flat one; or a Parameter with
                     another prior or other bounds
    bounds         : name -> least and greatest value
    ties           : names of parameters that have one value, each a tie; a single name ties all that it covers
    prior_scale    : factor on the sigma of all other priors [-]; infinite for flat ones
    starts         : by record, start of its march, how that is made, or None for the declared one
    sample_masks   : (sample,) of each record, which of its samples are fitted; by default those of the fit segments
    longest_step_s : limit on the steps of the march [s]
    tolerance_K    : largest error of a step [K]; steps are divided for it once, at the values that the fit starts from
    """

    effects: Sequence[EffectUse] = ()
    fixed: Mapping[str, float] | None = None
    priors: Mapping[str, Parameter | tuple[float, float]] | None = None
    bounds: Mapping[str, tuple[float, float]] | None = None
    ties: Sequence[Sequence[str]] = ()
    prior_scale: float = 1.0
    starts: Sequence[Start | StartMaker | None] | None = None
    sample_masks: Sequence[NDArray[np.bool_]] | None = None
    longest_step_s: float = LONGEST_STEP_S
    tolerance_K: float = STEP_TOLERANCE_K

    @property
    def normal_priors(self) -> dict[str, tuple[float, float]]:
        """Means and standard deviations by name, each in the unit of the parameter ([-] for a ratio)."""
        return {n: p for n, p in (self.priors or {}).items() if not isinstance(p, Parameter)}


DEFAULT_OPTIONS = FitOptions()


class StatedParameters:
    """The parameters of some records as the options of a fit state them: fixed values, priors, bounds, ties.

    owners  : of the names, with all records of the fit
    options : with values, priors and bounds in the units of the parameters
    """

    def __init__(self, owners: Owners, options: FitOptions) -> None:
        self.owners, self.options = owners, options
        self.priors = {n: p for n, p in (options.priors or {}).items() if isinstance(p, Parameter)}

    def fixed(self, record: Record) -> dict[str, float]:
        """Dotted name -> value of what is fixed for a record."""
        return self.owners.stated(self.options.fixed or {}, record)

    def model(self, record: Record, names: Sequence[str], reference: tuple[float, ...]) -> PointModel:
        """The model of a record's point with its effects and with what is fixed in it.

        names     : dotted names of the parameters that are estimated
        reference : the condition that derivatives are about: alpha, beta [deg], log10 Re [-], elevon, bodyflap [deg]
        raises    : InputError for a fixed value beyond the limits of its parameter
        """
        fixed = self.fixed(record)
        declared = (*self.options.effects, *record.declared.heating.effects)
        implied = implied_effects((*names, *fixed), declared)
        model = point_of_record(record, effects=(*self.options.effects, *implied))
        for problem in without_action((*names, *fixed), record, model).values():
            raise InputError(problem)
        for name, value in fixed.items():
            p = parameter_definition(record, model, name)
            if not p.lower <= value <= p.upper:
                raise InputError(f"{name}: fixed at {value:g}, outside its limits {p.lower:g} to {p.upper:g}")
        of_point = {n: v for n, v in fixed.items() if not is_of_record(n)}
        check_one_name(model.name, model.places, [*of_point, *(n for n in names if not is_of_record(n))])
        return replace(model.with_parameters(of_point), reference=reference)

    def index(self, record_fits: Sequence[RecordFit]) -> list[FitParameter]:
        """The unknowns of all records; those of one point, and tied ones, are one. Sets the index of each record."""
        by_label: dict[str, FitParameter] = {}
        labels = []
        for i, record_fit in enumerate(record_fits):
            of_start = [p.name for p in record_fit.start.unknowns] if record_fit.start else []
            labels.append([self._label(name, record_fit.record, name in of_start) for name in record_fit.names])
            for name, label in zip(record_fit.names, labels[-1], strict=True):
                parameter = by_label.get(label) or FitParameter(label, self._parameter(record_fit, name), ())
                by_label[label] = replace(parameter, records=(*parameter.records, i))
        require_estimated(self.options, self.owners, list(by_label))
        unknowns, stands_for = self._tied(by_label)
        order = [u.label for u in unknowns]
        for record_fit, of_record in zip(record_fits, labels, strict=True):
            index = [order.index(stands_for.get(label, label)) for label in of_record]
            record_fit.index = np.array(index, dtype=np.int64)
        return unknowns

    def _label(self, name: str, record: Record, of_start: bool) -> str:
        if of_start:  # temperatures at a start are of a record, as its clock is
            return f"{name}{AT}{record.name}" if len(self.owners.records) > 1 else name
        return self.owners.label(name, record)

    def _tied(self, by_label: Mapping[str, FitParameter]) -> tuple[list[FitParameter], dict[str, str]]:
        """The unknowns with those that are tied made one, and the label of that one for each of them.

        The one has the definition and the prior of the first, and the narrowest of their bounds.
        raises : InputError where a tie has one parameter only, or parameters of two units
        """
        stands_for: dict[str, str] = {}
        groups: dict[str, list[str]] = {label: [label] for label in by_label}
        for names in self.options.ties:
            covered = [label for label in self.owners.labels(names) if label in by_label]
            joined = list(dict.fromkeys(m for label in covered for m in groups[stands_for.get(label, label)]))
            _check_tie(names, covered, [by_label[m].parameter for m in joined], joined)
            for m in joined:
                groups.pop(stands_for.get(m, m), None)
            called = names[0] if len(names) == 1 else joined[0]
            groups[called] = joined
            stands_for |= dict.fromkeys(joined, called)
        tied = set(stands_for.values())
        unknowns = [
            _tied_parameter(label, [by_label[m] for m in members], members) if label in tied else by_label[label]
            for label, members in groups.items()
        ]
        order = {label: i for i, label in enumerate(by_label)}
        return sorted(unknowns, key=lambda u: order[u.tied[0] if u.tied else u.label]), stands_for

    def _parameter(self, record_fit: RecordFit, name: str) -> Parameter:
        """Definition of an unknown of a record; its value is where the fit starts, and the mean of its prior."""
        for of_start in record_fit.start.unknowns if record_fit.start else ():
            if of_start.name == name:
                return of_start
        parameter = sensor_definition(record_fit.record, name)
        if parameter is None:
            # the fit starts at what the record declares, which is also the mean of the prior
            parameter = replace(record_fit.model.definition(name), value=record_fit.model.value(name))
        if self.options.prior_scale != 1.0:
            parameter = replace(parameter, sigma=self.options.prior_scale * parameter.sigma)
        parameter = self.owners.stated(self.priors, record_fit.record).get(name, parameter)
        if name == CLOCK_SKEW.name:
            span_s = record_fit.skew_span_s
            lower, upper = max(parameter.lower, -span_s), min(parameter.upper, span_s)
            parameter = replace(parameter, lower=lower, upper=upper)
        return replace(self._as_stated(name, parameter, record_fit.record), name=name)

    def _as_stated(self, name: str, parameter: Parameter, record: Record) -> Parameter:
        """A parameter with the normal prior and the bounds that are stated for it.

        raises : InputError where either is beyond the limits of the parameter, or they exclude each other
        """
        label = self.owners.label(name, record)
        prior = self.owners.stated(self.options.normal_priors, record).get(name)
        bounds = self.owners.stated(self.options.bounds or {}, record).get(name)
        limits = f"its limits {parameter.lower:g} to {parameter.upper:g}"
        if prior is not None:
            parameter = _with_prior(parameter, label, *prior)
        if bounds is None:
            return parameter
        lower, upper = bounds
        if not lower < upper:
            raise InputError(f"{label}: bounds {lower:g} to {upper:g}; give the lower one first")
        if not parameter.lower <= lower < upper <= parameter.upper:
            raise InputError(f"{label}: bounds {lower:g} to {upper:g} are beyond {limits}")
        if lower <= parameter.value <= upper or np.isinf(parameter.sigma):
            # the value of a flat prior is only where the search begins
            return replace(parameter, value=min(max(parameter.value, lower), upper), lower=lower, upper=upper)
        mean, sigma = parameter.value, parameter.sigma
        raise InputError(
            f"{label}: bounds {lower:g} to {upper:g} exclude the mean of its prior, {mean:g} +- {sigma:g}; give "
            "another prior as well"
        )


def _check_tie(
    names: Sequence[str], covered: Sequence[str], parameters: Sequence[Parameter], labels: Sequence[str]
) -> None:
    """Check that a tie makes like parameters one.

    covered : labels that the names of the tie cover; parameters, labels : all that become one
    raises  : InputError where it has one parameter only, or parameters of two units
    """
    tie = "=".join(names)
    if len(covered) < 2:
        raise InputError(f"{tie}: ties one parameter only; name another one to be equal to it")
    if len({parameter.unit for parameter in parameters}) > 1:
        stated = ", ".join(f"{m} [{parameter.unit}]" for m, parameter in zip(labels, parameters, strict=True))
        raise InputError(f"{tie}: their units differ: {stated}; only like parameters may be tied")


def _tied_parameter(label: str, tied: Sequence[FitParameter], members: Sequence[str]) -> FitParameter:
    """One unknown of tied ones, with the definition and prior of the first and the narrowest of their bounds."""
    records = sorted({i for unknown in tied for i in unknown.records})
    lower, upper = max(u.parameter.lower for u in tied), min(u.parameter.upper for u in tied)
    return FitParameter(label, replace(tied[0].parameter, lower=lower, upper=upper), tuple(records), tuple(members))


def require_estimated(options: FitOptions, owners: Owners, labels: Sequence[str]) -> None:
    """Check that priors, bounds and ties are of parameters that are estimated.

    labels : of these;  raises : InputError naming the first that is not
    """
    tied = [name for tie in options.ties for name in tie]
    for name in (*options.normal_priors, *(options.bounds or {}), *tied):
        if not set(owners.labels([name])) & set(labels):
            hint = suggestion(name, labels, otherwise="; name it among the parameters")
            raise InputError(f"`{name}`: is not estimated{hint}")


def _with_prior(parameter: Parameter, label: str, mean: float, sigma: float) -> Parameter:
    """A parameter with the normal prior that is stated for it.

    raises : InputError where sigma is not above 0, or the mean is outside the limits of the parameter
    """
    if not sigma > 0.0:
        raise InputError(f"{label}: prior {mean:g} +- {sigma:g}; give a sigma above 0")
    mean = parameter.value if np.isinf(sigma) else mean  # a flat prior has none: the search begins as declared
    if not parameter.lower <= mean <= parameter.upper:
        limits = f"its limits {parameter.lower:g} to {parameter.upper:g}"
        raise InputError(f"{label}: the mean of its prior, {mean:g}, is outside {limits}")
    return replace(parameter, value=mean, sigma=sigma)


def without_action(names: Sequence[str], record: Record, model: PointModel) -> dict[str, str]:
    """Parameters of effects that nothing computed for a record depends on, with what to name or declare instead.

    names : dotted names, of which those like `effect.NAME.PARAMETER` count;  model : of the record with these effects

    An effect on readings has no part in the march: its parameters are those of the record, `clock.skew` for instance.
    Recombination acts on the atoms of a flow that the record declares.
    """
    problems, recombines = {}, flow_of_record(record, model.effects).atoms != "none"
    for name in names:
        used = next((u for u in model.effects if name.startswith(f"{EFFECT_PREFIX}{u.effect.name}.")), None)
        if used is None:
            continue
        parameter = next((p for p in used.effect.parameters if name.endswith(f".{p.name}")), None)
        if used.effect.acts_on_readings and isinstance(parameter, ModelParameter):
            problems[name] = (
                f"`{name}`: acts on the readings of a record, not on its wall; name `{parameter.stands_for}`"
            )
        elif used.effect.name == RECOMBINATION and not recombines:
            problems[name] = (
                f"`{name}`: nothing recombines in {record.name}; declare the flow and its wall in [heating.catalysis], "
                "or name the parameters of effect `catalysis`"
            )
    return problems


def implied_effects(names: Sequence[str], present: Sequence[EffectUse] = ()) -> list[EffectUse]:
    """The effects that dotted parameter names imply and that are not present, at their nominal values.

    names : of which those like `effect.NAME.PARAMETER` count;  present : effects already in the model
    """
    names_present = {u.effect.name for u in present}
    implied = dict.fromkeys(n.split(".")[1] for n in names if n.startswith(EFFECT_PREFIX) and n.count(".") >= 2)
    return [use(name) for name in implied if name not in names_present]
