"""Fitted effects as `[[effect]]` of a control point's file; everything else in the file stays.

An effect is written with all values that it had in the fit, estimated or not: with others the estimated ones would have
another meaning. A fitted effect replaces a declared one of the same name; the others stay.

The table's own sigma draws the ratio parameters theta to other values than the fit's. The effects' e follow by the
joint covariance of the fit, as the mean of a normal distribution given theta:

    e = e_hat + C_e,theta (C_theta + F)^-1 (theta_table - theta_hat),    within their bounds

with F the covariance with which a table has parameters at all, from the form that it may differ by (flown_ratio.py).

Source: Rasmussen and Williams, Gaussian Processes for Machine Learning (2006), eq. A.6.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tomlkit
from tomlkit.exceptions import TOMLKitError

from sim_heating.base.errors import InputError
from sim_heating.base.files import check, display_path, raw_text
from sim_heating.base.parameters import EFFECT_PREFIX, RECORD_PARAMETERS, SENSOR_PREFIX
from sim_heating.closure.revise.evidence import FlightEvidence, FlownPath, is_effect
from sim_heating.estimation.report.estimate_file import Estimate
from sim_heating.heating.effects import EffectUse, check_count, combined_uses, effect, use
from sim_heating.heating.effects.transition import TRANSITION
from sim_heating.heating.ratio.uncertainty import Posterior, node_weights
from sim_heating.inputs.vehicle import ControlPoint
from sim_heating.inputs.vehicle_files import ControlPointFile

OF_RECORD = "belongs to the record, not to the vehicle"
NOT_ESTIMATED = "was in the fit, but nothing of it was estimated"
BOM = "\ufeff"


@dataclass(frozen=True)
class FittedEffects:
    """The effects of a control point by a fit.

    path         : the control point's file;  raw : its text;  text : the new one, equal where nothing is written
    before       : the effects that it declares;  after : those that it will declare
    written      : names of the fitted ones
    shift_sigmas : estimated parameter -> its distance from the fit, in sigmas of the fit
    not_written  : estimated parameter or effect -> why it is not in the file
    not_fitted   : declared effects that the fit did not have
    """

    path: Path
    raw: str
    text: str
    before: tuple[EffectUse, ...]
    after: tuple[EffectUse, ...]
    written: tuple[str, ...]
    shift_sigmas: dict[str, float]
    not_written: dict[str, str]
    not_fitted: tuple[str, ...]

    def changes(self) -> list[dict[str, Any]]:
        """Each written effect: name, its values, and the declared ones before, None where it was not declared."""
        before, after = ({u.effect.name: u.by_name for u in uses} for uses in (self.before, self.after))
        return [{"name": n, "parameters": after[n], "before": before.get(n)} for n in self.written]


def effects_from_fit(
    estimate: Estimate,
    flight: FlightEvidence,
    table: Posterior,
    turbulent: Posterior | None,
    path: Path,
    point: ControlPoint,
    flown: str,
    file: str,
) -> FittedEffects:
    """The effects of one control point by an estimate, but for those that its ratio table takes.

    flight, table   : the estimate as evidence, and the ratio table updated by it
    turbulent       : the turbulent table updated by it, None where it stays
    path            : the control point's file
    flown, file     : records and times, and the revision's own file, for the `source` of an effect
    raises          : InputError where an effect is unknown, a value outside its bounds, or the file cannot be edited
    """
    in_table = {u.effect.name for u in flight.in_table}
    every = _values_given_table(estimate, flight, table, turbulent)
    given_table = {n: v for n, v in every.items() if _split_label(n)[0] not in in_table}
    estimated = _parameters_by_effect(given_table)
    of_fit = _without_table(estimate, estimated, in_table)
    stays = (flight.path, point, table) if turbulent is None else None
    fitted, not_written = _written_or_not(of_fit, estimate, estimated, stays)
    after = combined_uses(point.effects, fitted)
    check_count(after, point.name)
    raw = raw_text(path)
    declared = [_declaration(u, estimate, tuple(estimated[u.effect.name]), flown, file) for u in fitted]
    return FittedEffects(
        path=path,
        raw=raw,
        text=edit_effects(raw, declared, path) if fitted else raw,
        before=point.effects,
        after=after,
        written=tuple(u.effect.name for u in fitted),
        shift_sigmas=_shift_sigmas(estimate, given_table),
        not_written=not_written,
        not_fitted=tuple(u.effect.name for u in point.effects if u.effect.name not in of_fit),
    )


def _without_table(
    estimate: Estimate, estimated: Mapping[str, Mapping[str, float]], in_table: Collection[str]
) -> dict[str, EffectUse]:
    """The effects of a fit by name, with their estimated values, but for those that the ratio table takes."""
    in_force = {e.name: e.parameters for e in estimate.effects}
    names = [name for name in dict.fromkeys((*in_force, *estimated)) if name not in in_table]
    return {name: use(name, in_force.get(name, {}) | dict(estimated.get(name, {}))) for name in names}


def _written_or_not(
    of_fit: Mapping[str, EffectUse],
    estimate: Estimate,
    estimated: Mapping[str, Mapping[str, float]],
    stays: tuple[FlownPath, ControlPoint, Posterior] | None,
) -> tuple[list[EffectUse], dict[str, str]]:
    """The effects of a fit as they are written, and why its other parameters and effects are not.

    estimated : effect -> its estimated values;  stays : what a turbulent table that is not revised is weighed by
    """
    digits = 6  # significant digits of a written value, far below any sigma
    stems = (*RECORD_PARAMETERS, SENSOR_PREFIX)
    written, not_written = [], dict.fromkeys((n for n in estimate.parameters if n.startswith(stems)), OF_RECORD)
    for name, used in of_fit.items():
        if used.effect.acts_on_readings:
            not_written[f"{EFFECT_PREFIX}{name}"] = OF_RECORD
        elif name not in estimated:
            turbulent_left = "" if stays is None else _turbulent_left(used, *stays)
            not_written[f"{EFFECT_PREFIX}{name}"] = NOT_ESTIMATED + turbulent_left
        else:
            # Rounded before it is used, so that the errors reported for the revision are those of the file as written.
            values = used.by_name if stays is None else _on_revised_table(used, *stays)
            written.append(use(name, {n: float(f"{v:.{digits}g}") for n, v in values.items()}))
    return written, not_written


def _shift_sigmas(estimate: Estimate, values: Mapping[str, float]) -> dict[str, float]:
    """Distance of each value from that of the fit, in sigmas of the fit."""
    estimates = {n: estimate.parameters[n] for n in values}
    return {n: abs(values[n] - p.value) / p.sigma for n, p in estimates.items() if p.sigma > 0.0}


def _split_label(label: str) -> tuple[str, str]:
    """Effect and parameter that a label is of."""
    name, _, parameter = label.removeprefix(EFFECT_PREFIX).rpartition(".")
    return name, parameter


def _on_revised_table(used: EffectUse, path: FlownPath, point: ControlPoint, table: Posterior) -> dict[str, float]:
    """Parameters of an effect for the updated table.

    The factor of a transition by table is on turbulent over laminar, and in the fit on both with the fitted laminar
    ratio. Where the turbulent table cannot be revised, the factor takes the change of the laminar one.
    """
    values = used.by_name
    change = _laminar_change(used, path, point, table)
    if change == 1.0:
        return values
    label = f"{EFFECT_PREFIX}{TRANSITION}.factor"
    return values | {"factor": _within_bounds(label, values["factor"], values["factor"] * change)}


def _laminar_change(used: EffectUse, path: FlownPath, point: ControlPoint, table: Posterior) -> float:
    """Updated over declared laminar ratio [-] where a transition by table is turbulent; 1 for any other effect.

    sum(w Gamma r_table / r_declared) / sum(w Gamma),    w the square of the heat flux
    """
    weight = path.weight * path.turbulent * (path.declared > 0.0)
    if used.effect.name != TRANSITION or used.by_name["by_table"] == 0.0 or not np.any(weight > 0.0):
        return 1.0
    updated = node_weights(table.prior.axes, path.x) @ table.ratio.ravel()
    return float(np.average(updated / np.where(weight > 0.0, path.declared, 1.0), weights=weight))


def _turbulent_left(used: EffectUse, path: FlownPath, point: ControlPoint, table: Posterior) -> str:
    """What the turbulent table lacks where the fit changed laminar and turbulent heating together, as the end of a
    line.
    """
    noticed = 0.005  # change of the turbulent heating [-] from which a line says that it is not in the vehicle
    change = _laminar_change(used, path, point, table) - 1.0
    if abs(change) < noticed:
        return ""
    side = "above" if change > 0.0 else "below"
    return (
        f"; the fit's turbulent heating is {abs(change):.1%} {side} that of the turbulent table, which is not revised: "
        f"estimate {EFFECT_PREFIX}{TRANSITION}.factor as well"
    )


def _values_given_table(
    estimate: Estimate, flight: FlightEvidence, table: Posterior, turbulent: Posterior | None
) -> dict[str, float]:
    """Values of the effects' parameters given the ratio of the updated tables, by label."""
    ratio, effects = flight.evidence.names, tuple(n for n in estimate.parameters if is_effect(n))
    rho = estimate.correlation_matrix((*ratio, *effects))
    k = len(ratio)
    shift = flight.parameters_of(table, turbulent, with_effects=True)[0] - estimate.values(ratio)
    scale = np.array([estimate.parameters[n].sigma for n in ratio])
    per_scale = np.divide(1.0, scale, out=np.zeros(k), where=scale > 0.0)
    # What a table leaves of the form of the fit is no shift that effects would have to follow.
    seen = rho[:k, :k] + flight.form_covariance * np.outer(per_scale, per_scale)
    follow = rho[k:, :k] @ np.linalg.lstsq(seen, shift * per_scale, rcond=None)[0] if k else np.zeros(len(effects))
    sigma = np.array([estimate.parameters[n].sigma for n in effects])
    values = estimate.values(effects)
    return {
        n: _within_bounds(n, v, v + d)
        for n, v, d in zip(effects, values.tolist(), (sigma * follow).tolist(), strict=True)
    }


def _within_bounds(label: str, fitted: float, value: float) -> float:
    """A value within the bounds of its parameter; the fitted value always counts as within."""
    name, parameter = _split_label(label)
    limits = next((p for p in effect(name).parameters if p.name == parameter), None)
    if limits is None:
        return value
    # The shift towards the updated ratio is linear and may leave the bounds.
    return min(max(value, min(limits.lower, fitted)), max(limits.upper, fitted))


def _parameters_by_effect(values: Mapping[str, float]) -> dict[str, dict[str, float]]:
    """Effect -> its estimated values by parameter."""
    by_effect: dict[str, dict[str, float]] = {}
    for label, value in values.items():
        name, parameter = _split_label(label)
        by_effect.setdefault(name, {})[parameter] = value
    return by_effect


def _declaration(
    used: EffectUse, estimate: Estimate, estimated: Sequence[str], flown: str, file: str
) -> dict[str, Any]:
    """An effect as a control point's file declares it: the estimated values, and those that are not nominal."""
    nominal = {p.name: p.value for p in used.effect.parameters}
    parameters = {n: v for n, v in used.by_name.items() if n in estimated or v != nominal[n]}
    name = used.effect.name
    sigma = ", ".join(f"{n} +- {estimate.parameters[f'{EFFECT_PREFIX}{name}.{n}'].sigma:.2g}" for n in estimated)
    return {"name": name, "parameters": parameters, "source": f"flight {flown}; {sigma}; {file}"}


def edit_effects(raw: str, declared: Sequence[Mapping[str, Any]], path: Path) -> str:
    """A control point's file with these effects, each in place of one of its name or at the end; comments stay.

    raises : InputError where the file has a form that cannot be edited in this way
    """
    mark, text = (BOM, raw[1:]) if raw.startswith(BOM) else ("", raw)
    try:
        expected = tomlkit.parse(text).unwrap()
        expected["effect"] = [*expected.get("effect", [])]
        for new in declared:
            text = _with_effect(text, new)
            at = next(
                (i for i, e in enumerate(expected["effect"]) if e["name"] == new["name"]), len(expected["effect"])
            )
            expected["effect"][at : at + 1] = [dict(new)]
        edited = tomlkit.parse(text).unwrap()
    except TOMLKitError as error:
        raise InputError(f"{display_path(path)}: cannot be edited ({error}); write its [[effect]] by hand") from None
    # The edit is made on the text, to keep comments. Read back, it must differ in this effect and in nothing else.
    if edited != expected:
        raise InputError(
            f"{display_path(path)}: cannot take the effect without other changes; write its [[effect]] by hand"
        )
    check(edited, ControlPointFile, display_path(path))
    return mark + text


def _with_effect(text: str, declared: Mapping[str, Any]) -> str:
    """The text with one effect replaced, or appended."""
    document = tomlkit.parse(text)
    existing = next((e for e in document.get("effect", []) if e["name"] == declared["name"]), None)
    if existing is None:
        return text.rstrip() + _end_of_line(text) * 2 + _toml_block(declared).replace("\n", _end_of_line(text))
    existing["parameters"], existing["source"] = _parameters(declared), declared["source"]
    return tomlkit.dumps(document)


def _toml_block(declared: Mapping[str, Any]) -> str:
    """An effect as a new block of the file."""
    table = tomlkit.table()
    table.update({**declared, "parameters": _parameters(declared)})
    return "[[effect]]\n" + table.as_string()


def _parameters(declared: Mapping[str, Any]) -> Any:
    """The parameters of an effect as an inline table, with blanks within the braces."""
    return tomlkit.value("{ " + ", ".join(f"{n} = {float(v)!r}" for n, v in declared["parameters"].items()) + " }")


def _end_of_line(text: str) -> str:
    return "\r\n" if "\r\n" in text else "\n"
